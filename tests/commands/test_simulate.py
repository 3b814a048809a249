"""`simulate`: defaults of the contract, settings, and sentences for what cannot be."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

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


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"case": "V"}, "no such case"),
        ({"settings": ["muu=1"]}, "did you mean 'mu'"),
        ({"settings": ["mu=a"]}, "no number"),
        ({"settings": ["mu"]}, "NAME=VALUE"),
        ({"settings": ["mu=nan"]}, "finite"),
        ({"effect": "stick"}, "did you mean 'stick_slip'"),
        ({"settings": ["stick_slip.excess=1"]}, "--effect stick_slip"),
        ({"rate": 0.0}, "positive"),
        ({"duration": -1.0}, "positive"),
        ({"settings": ["primary_inertia=-1"]}, "cannot be simulated"),
    ],
)
def test_bad_input_gets_a_sentence(tmp_path, arguments, told):
    with pytest.raises(InputError, match=told):
        simulate_record(**({"case": "IV"} | arguments), out=tmp_path / "F.csv")


def test_all_faults_are_told_at_once(tmp_path):
    with pytest.raises(InputError) as caught:
        simulate_record("IV", settings=["muu=1", "nu=x"], effect="stick", out=tmp_path / "F.csv")
    assert len(caught.value.faults) == 3
