"""`simulate`: defaults of the contract, settings, and sentences for what cannot be."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest
from campaigns import write_synthetic
from scipy.integrate import solve_ivp

from bayes_damper import examples
from bayes_damper.campaign import load_campaign
from bayes_damper.commands.simulate import simulate_record
from bayes_damper.errors import InputError


def _read(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def test_defaults_are_those_of_the_contract(tmp_path):
    result = simulate_record("IV", out=tmp_path / "F.csv")
    used = tomllib.loads((tmp_path / "F.toml").read_text())
    expected = {"J2": 2.474e-3, "R": 0.10, "r": 0.0127, "k1t": 10.2, "N0": 100.0, "J1": 3.015e-3}
    assert {key: pytest.approx(used[key], rel=1e-12) for key in expected} == expected
    record = _read(result.path)
    assert record.dtype.names == ("time_s", "alpha1_rad_s2", "alpha2_rad_s2")
    assert record["time_s"].size == 1001
    # Released at rest: alpha1(0) = -k1t theta0 / J1 (eq. 16, p. 15).
    assert record["alpha1_rad_s2"][0] == pytest.approx(-10.2 * np.radians(4.7) / 3.015e-3, rel=1e-9)


def test_settings_reach_the_simulation(tmp_path):
    simulate_record("I", coupled=False, settings=["drag=0", "c1t=0", "primary_inertia=0.004"], out=tmp_path / "u.csv")
    record = _read(tmp_path / "u.csv")
    omega = np.sqrt(6.2 / 0.004)
    exact = -(omega**2) * np.radians(5.7) * np.cos(omega * record["time_s"])
    np.testing.assert_allclose(record["alpha1_rad_s2"], exact, atol=2e-4 * np.abs(exact).max())


def test_an_effect_changes_the_record_and_is_noted(tmp_path):
    simulate_record("IV", out=tmp_path / "a.csv")
    simulate_record("IV", effect="spring_cubic", settings=["spring_cubic.k3=200"], out=tmp_path / "b.csv")
    used = tomllib.loads((tmp_path / "b.toml").read_text())
    assert used["effect"]["name"] == "spring_cubic"
    assert 200.0 in used["effect"].values()
    assert np.abs(_read(tmp_path / "a.csv")["alpha1_rad_s2"] - _read(tmp_path / "b.csv")["alpha1_rad_s2"]).max() > 1.0


def test_the_rig_of_a_campaign_is_simulated_in_its_units_without_a_fit(tmp_path):
    """A cart at its declared constants, with the rate and duration of its records; the rest as --set says."""
    cart = examples(tmp_path / "cart").folder
    campaign = load_campaign(cart)
    trial = next(t for t in campaign.trials if t.case == "small")
    k1, x0, mass, k3 = trial.k1t.value, trial.theta0.value, campaign.rig.primary_inertia.value, 2.0e5
    settings = ["drag=0", "c1t=2.5", f"spring_cubic.k3={k3}"]
    found = simulate_record("small", campaign=cart, settings=settings, effect="spring_cubic", out=tmp_path / "F.csv")
    record = _read(found.path)
    assert record.dtype.names == ("time_s", "a1_m_s2")
    assert record["time_s"].size == pytest.approx(trial.times.size, abs=10)
    assert np.diff(record["time_s"]) == pytest.approx(np.median(np.diff(trial.times)))
    exact = solve_ivp(
        lambda _, y: [y[1], -(k1 * y[0] + k3 * y[0] ** 3 + 2.5 * y[1]) / mass], (0.0, record["time_s"][-1]), [x0, 0.0],
        t_eval=record["time_s"], rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    x, v = exact.y
    a = -(k1 * x + k3 * x**3 + 2.5 * v) / mass
    np.testing.assert_allclose(record["a1_m_s2"], a, atol=5e-4 * np.abs(a).max())
    text = (tmp_path / "F.toml").read_text()
    used = tomllib.loads(text)
    assert (used["campaign"], used["kind"], used["configuration"]) == (str(cart), "translational", "uncoupled")
    assert "k3 = 200000.0  # N/m^3" in text
    assert f"k1t = {k1}  # N/m\n" in text
    with pytest.raises(InputError, match=r"there is no such case; .* has .*small"):
        simulate_record("huge", campaign=cart, out=tmp_path / "G.csv")
    with pytest.raises(InputError, match="--effect stick_slip: this rig cannot have it: it needs coupled"):
        simulate_record(campaign=cart, effect="stick_slip", out=tmp_path / "G.csv")


def test_a_tied_parameter_of_a_campaign_follows_the_one_that_it_is_tied_to(tmp_path):
    """As in a fit, where that one has its prior's median, and where --set changes it."""
    campaign = write_synthetic(tmp_path / "rig", duration=0.3)
    reason = 'reason = "two bearings of one kind"'
    (campaign / "priors.toml").write_text(
        f'[c1t]\nunit = "N m s/rad"\ndist = "lognormal"\nmedian = 0.02\nfactor = 1.5\n{reason}\n\n'
        f'[c3t]\nunit = "N m s/rad"\ndist = "tied"\nto = "c1t"\n{reason}\n'
    )
    for settings, damping in ([], 0.02), (["c1t=0.03"], 0.03):
        simulate_record(campaign=campaign, settings=settings, out=tmp_path / "F.csv")
        used = tomllib.loads((tmp_path / "F.toml").read_text())
        assert used["configuration"] == "coupled"
        assert (used["c1t"], used["c3t"]) == pytest.approx((damping, damping))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"case": "V"}, "no such case"),
        ({"settings": ["kind=translational"]}, "bayes-damper simulate FOLDER"),
        ({"settings": ["muu=1"]}, "did you mean 'mu'"),
        ({"settings": ["mu=a"]}, "no number"),
        ({"settings": ["mu"]}, "NAME=VALUE"),
        ({"settings": ["mu=nan"]}, "finite"),
        ({"effect": "stick"}, "did you mean 'stick_slip'"),
        ({"settings": ["stick_slip.excess=1"]}, "--effect stick_slip"),
        ({"rate": 0.0}, "positive"),
        ({"duration": -1.0}, "positive"),
        ({"duration": 1e-9}, "2 to ten million samples"),
        ({"settings": ["primary_inertia=-1"]}, "must be above 0"),
        ({"settings": ["nu=0"]}, "must be above 0"),
        ({"settings": ["mu=-0.1"]}, "must be 0 or more"),
        ({"settings": ["c1t=-0.5"]}, "must be 0 or more"),
        ({"settings": ["k2t=1e300"]}, "k2t = 1e.300 is beyond reason"),
        ({"settings": ["nu=1e300"]}, "nu = 1e.300 is beyond reason"),
        ({"settings": ["k1t=1e-40"]}, "k1t = 1e-40 is beyond reason"),
        ({"settings": ["k2t=1e9"]}, "k2t=1e9 is 2e.08 times what the thesis's rig has, 5 N m/rad; no rig like it"),
        ({"settings": ["theta0=1e5"]}, "theta0=1e5 is .* no rig like it has so much: .* not in degrees"),
        ({"settings": ["J12=0.00274"]}, "J12: must be smaller than sqrt.J1 J2."),
        ({"settings": ["tail=50"]}, "tail: curves of friction have -1 to 2"),
        ({"effect": "spring_cubic", "settings": ["spring_cubic.k3=1e40"]}, "spring_cubic.k3 = 1e.40 is beyond reason"),
        (
            {"effect": "spring_cubic", "settings": ["spring_cubic.k3=1e12"]},
            "cannot be simulated: the equations were too stiff for the integrator to finish; see what --set gives",
        ),
    ],
)
def test_bad_input_gets_a_sentence(tmp_path, arguments, told):
    with pytest.raises(InputError, match=told):
        simulate_record(**({"case": "IV"} | arguments), out=tmp_path / "F.csv")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"settings": ["theta0=4.7"]}, "57.3 times what the thesis's rig has, 0.08203 rad.*not in degrees"),
        ({"settings": ["primary_inertia=3.015"]}, r"primary_inertia=3.015 is 1e\+03 times"),
        ({"settings": ["bar_radius=100"]}, r"1e\+03 times what the thesis's rig has, 0.1 m;"),
        ({"settings": ["J2=2.474e-6"]}, "0.001 times what the thesis's rig has"),
        ({"rate": 20.0}, "2.2 readings: too few to show it; raise --rate"),
        ({"settings": ["delay=5"]}, "the release, at 5 s, comes after the record's end at 1 s: nothing moves"),
        ({"settings": ["theta0=0.5", "drag=0", "mu=0", "nu=1e4", "N0=10"]}, None),
    ],
)
def test_numbers_of_another_unit_are_used_with_a_warning(tmp_path, given, said):
    result = simulate_record("IV", **given, out=tmp_path / "F.csv")
    assert len(result.warnings) == (said is not None), result.warnings
    assert said is None or re.search(said, result.warnings[0])


def test_all_faults_are_told_at_once(tmp_path):
    with pytest.raises(InputError) as caught:
        simulate_record("IV", settings=["muu=1", "nu=x"], effect="stick", out=tmp_path / "F.csv")
    assert len(caught.value.faults) == 3


def test_inputs_of_a_file_drive_the_record(tmp_path):
    times = np.arange(0.0, 0.3, 1e-3)
    columns = {"torque1_n_m": 0.2 * np.sin(40 * times), "torque2_n_m": 0.1 * np.cos(30 * times)}
    columns["ground_rad_s2"] = 20.0 * np.sin(25 * times)
    path = tmp_path / "inputs.csv"
    header = ",".join(["time_s", *columns])
    np.savetxt(path, np.column_stack([times, *columns.values()]), delimiter=",", header=header, comments="")
    rig = ["theta0=0", "mu=0", "drag=0", "J12=1e-4"]
    found = simulate_record(settings=rig, inputs=path, out=tmp_path / "record.csv")
    names = (tmp_path / "record.csv").read_text().partition("\n")[0].split(",")
    assert names == ["time_s", "alpha1_rad_s2", "alpha2_rad_s2", *columns]
    table = np.loadtxt(tmp_path / "record.csv", delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 0], times)
    # The linear rig in absolute coordinates, its angles and velocities and those of the ground as one state.
    v = found.values
    mass = np.linalg.inv([[v["J1"], v["J12"]], [v["J12"], v["J2"]]])
    K = [[-v["k1t"] - v["k2t"], v["k2t"], v["k1t"]], [v["k2t"], -v["k2t"], 0.0]]
    C = [[-v["c1t"] - v["c2t"], v["c2t"], v["c1t"]], [v["c2t"], -v["c2t"] - v["c3t"], v["c3t"]]]

    def bodies(t: float, x: np.ndarray) -> np.ndarray:
        push = [np.interp(t, times, columns[name]) for name in ("torque1_n_m", "torque2_n_m")]
        return mass @ (np.array(K) @ x[:3] + np.array(C) @ x[3:] + push)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[3:], bodies(t, x), [np.interp(t, times, columns["ground_rad_s2"])]])

    states = solve_ivp(rates, (0.0, times[-1]), np.zeros(6), "DOP853", times, rtol=1e-9, atol=1e-12, max_step=1e-3).y
    exact = np.array([bodies(t, x) for t, x in zip(times, states.T, strict=True)])
    assert np.abs(table[:, 1:3] - exact).max() < 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("header", "options", "words"),
    [
        ("time_s,torque3_n_m", {}, "expected a column time_s and some of torque1_n_m"),
        ("time_s,torque2_n_m", {"coupled": False}, "acts on the secondary"),
        ("time_s,ground_rad", {"settings": ["restoring=pendulum"]}, "gravity"),
    ],
)
def test_inputs_that_cannot_act_are_told(tmp_path, header, options, words):
    path = tmp_path / "inputs.csv"
    path.write_text(header + "\n" + "\n".join(f"{k / 1000},{k % 5}" for k in range(20)) + "\n")
    with pytest.raises(InputError, match=words):
        simulate_record(inputs=path, out=tmp_path / "record.csv", **options)
