"""The independent rig of the withheld campaigns: right motion, honest levels, readable files, no common code."""

import ast
import csv
import gzip
import importlib.util
import json
import math
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[2]
HOME = ROOT / "data" / "withheld"
SIMULATOR = ROOT / "validation" / "simulator"


def load():
    spec = importlib.util.spec_from_file_location("withheld_make", SIMULATOR / "make.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["withheld_make"] = module
    spec.loader.exec_module(module)
    return module


make = load()
from rig import campaign, codes, equations, gap, kinds, sensors, sets, simulate  # noqa: E402

NOMINAL = {"mu": 0.006, "k2t": 1.2, "c2t": 0.08, "drag": 0.005, "nu": 60.0, "c1t": 0.011, "c3t": 0.009}
RIG = campaign.DECLARED | NOMINAL | {"k1t": 10.2, "theta0": np.radians(4.7)}
TIMES = np.arange(1000) * 1e-3


def reference(extra=None, memory=0, start=None, rig=RIG, friction=None):
    """Coupled accelerations at TIMES by multistep methods of varying order, the equations written out once more."""
    g = rig

    def rhs(t, x):
        th1, th2, w1, w2 = x[:4].tolist()
        phi, v = th1 - th2, w1 - w2
        pull = g["N0"] * max(0.0, 1.0 - g["R"] * abs(phi) / (2 * g["r"]))
        slide = math.tanh(g["nu"] * v) if friction is None else x[4]
        dry = g["mu"] * pull * g["R"] * slide
        coupling = g["k2t"] * phi + g["c2t"] * v + dry
        q1, q2, rates = (0.0, 0.0, []) if extra is None else extra(t, x, dry)
        if friction is not None:
            rates = [friction(v, x[4])]
        a1 = (-g["c1t"] * w1 - g["k1t"] * th1 - g["drag"] * math.tanh(g["nu"] * w1) - coupling + q1) / g["J1"]
        a2 = (-g["c3t"] * w2 - g["drag"] * math.tanh(g["nu"] * w2) + coupling + q2) / g["J2"]
        return w1, w2, a1, a2, *rates

    x0 = np.zeros(4 + memory) if start is None else np.array(start)
    x0[:2] = g["theta0"]
    out = solve_ivp(rhs, (0.0, TIMES[-1]), x0, "LSODA", TIMES, rtol=1e-10, atol=1e-12, max_step=2e-4)
    return np.array([rhs(t, x)[2:4] for t, x in zip(out.t, out.y.T, strict=True)]).T


@pytest.fixture(scope="module")
def nominal():
    return reference()


def test_nominal_motion_agrees_with_an_adaptive_method(nominal):
    ours = simulate.record(RIG, True, TIMES)
    assert np.abs(ours - nominal).max() < 1e-3  # of a peak of 160 rad/s^2


def test_uncoupled_rig_is_the_first_line_alone():
    rig = RIG | {"drag": 0.0}
    y = simulate.record(rig, False, TIMES)[0]
    wn, decay = np.sqrt(rig["k1t"] / rig["J1"]), rig["c1t"] / (2 * rig["J1"])
    root = -decay + 1j * np.sqrt(wn**2 - decay**2)  # th = Re(A exp(root t)), th(0) = theta0, w(0) = 0
    A = rig["theta0"] * (1 + 1j * root.real / root.imag)
    assert np.abs(y - np.real(A * root**2 * np.exp(root * TIMES))).max() < 1e-5


def test_hysteresis_agrees_with_an_adaptive_method(nominal):
    size, yielding, beta = 0.03, 0.01, 0.55

    def extra(_, x, __):
        z, w = x[4], x[2]
        rate = w / yielding * (1 - z * z * (beta * np.sign(w * z) + 1 - beta))
        return -size * z, 0.0, [rate]

    start = [0, 0, 0, 0, np.tanh(RIG["theta0"] / yielding)]
    d = sensors.Disturbance(codes.COUPLING_HYSTERESIS, (size, yielding, beta, 0.0))
    ours = simulate.record(RIG, True, TIMES, [d])
    assert np.abs(ours - reference(extra, 1, start)).max() < 0.02
    assert np.abs(ours - nominal).max() > 5.0


def test_magnet_fade_agrees_with_an_adaptive_method():
    rate = 3.0
    g = RIG

    def faded(t, x):
        th1, th2, w1, w2, heat = x.tolist()
        phi, v = th1 - th2, w1 - w2
        pull = g["N0"] * math.exp(-rate * heat) * max(0.0, 1.0 - g["R"] * abs(phi) / (2 * g["r"]))
        dry = g["mu"] * pull * g["R"] * math.tanh(g["nu"] * v)
        T = g["k2t"] * phi + g["c2t"] * v + dry
        a1 = (-g["c1t"] * w1 - g["k1t"] * th1 - g["drag"] * math.tanh(g["nu"] * w1) - T) / g["J1"]
        a2 = (-g["c3t"] * w2 - g["drag"] * math.tanh(g["nu"] * w2) + T) / g["J2"]
        return [w1, w2, a1, a2, (dry * v + g["c2t"] * v * v) / 0.049]

    x0 = [g["theta0"], g["theta0"], 0.0, 0.0, 0.0]
    out = solve_ivp(faded, (0.0, TIMES[-1]), x0, "LSODA", TIMES, rtol=1e-10, atol=1e-12, max_step=2e-4)
    theirs = np.array([faded(t, x)[2:4] for t, x in zip(out.t, out.y.T, strict=True)]).T
    d = sensors.Disturbance(codes.MAGNET_FADE, (rate, 0.0, 0.0, 0.0))
    assert np.abs(simulate.record(RIG, True, TIMES, [d]) - theirs).max() < 2e-3


def test_bristles_agree_with_an_adaptive_method(nominal):
    excess, speed, share = 0.8, 0.3, 2e-4

    def rate(v, b):
        curve = math.tanh(RIG["nu"] * abs(v)) * (1 + excess * math.exp(-((v / speed) ** 2)))
        pace = abs(v) / curve if abs(v) > 1e-12 else 1 / (RIG["nu"] * (1 + excess))
        return pace / (excess * share) * (math.copysign(1.0, v) * curve - b)

    d = sensors.Disturbance(codes.STICK_SLIP, (excess, speed, share, 0.0))
    ours = simulate.record(RIG, True, TIMES, [d])
    theirs = reference(None, 1, None, RIG, rate)
    difference = ours - theirs
    assert np.sqrt(np.mean(difference**2)) < 0.02
    assert np.abs(ours - nominal).max() > 5.0


@pytest.mark.parametrize("name", list(kinds.KINDS))
def test_a_vanishing_disturbance_leaves_the_nominal_rig(name):
    kind = kinds.KINDS[name]
    shape = kind.shape(np.random.default_rng(3))
    for coupled in (False, True):
        bare = simulate.record(RIG, coupled, TIMES)
        for size in (0.0, 1e-9 * kind.scale):
            y = simulate.record(RIG, coupled, TIMES, [kind.at(size, shape)])
            # behind a filter the very first reading is that of the held rig, however fast the filter is
            first = 1 if name == "sensor_bandwidth" and size > 0 else 0
            # bristles follow one step behind
            loose = 0.1 if name == "stick_slip" and size > 0 else 1e-5
            assert np.abs((y - bare)[:, first:]).max() < loose


@pytest.mark.parametrize("name", list(kinds.KINDS))
def test_every_disturbance_changes_the_records(name):
    kind = kinds.KINDS[name]
    d = kind.at(min(kind.scale, kind.limit), kind.shape(np.random.default_rng(4)))
    changed = max(
        np.abs(simulate.record(RIG, c, TIMES, [d]) - simulate.record(RIG, c, TIMES)).max() for c in (False, True)
    )
    assert changed > 0.2


@pytest.mark.parametrize("name", [n for n, k in sorted(kinds.KINDS.items()) if k.site == "interface"])
def test_interface_kinds_leave_the_uncoupled_rig_alone(name):
    """Without the secondary there are no faces: the uncoupled record is that of the nominal rig."""
    kind = kinds.KINDS[name]
    d = kind.at(min(kind.scale, kind.limit), kind.shape(np.random.default_rng(5)))
    np.testing.assert_array_equal(simulate.record(RIG, False, TIMES, [d]), simulate.record(RIG, False, TIMES))


def test_the_list_of_kinds_holds_every_required_one():
    assert set(kinds.names("library")) == {
        "spring_cubic",
        "spring_bottoming",
        "coupling_backlash",
        "coupling_hysteresis",
        "stiffness_error",
        "bearing_stribeck",
        "quadratic_drag",
        "misalignment_drag",
        "stick_slip",
        "friction_displacement",
        "magnet_cubic",
        "eddy_overlap",
        "magnet_fade",
        "interface_relaxation",
        "normal_force_law",
        "inertia_error",
        "release_ramp",
        "release_offset",
        "sensor_gain",
        "sensor_delay",
        "sensor_bandwidth",
        "sensor_highpass",
        "sensor_clipping",
    }
    assert len(kinds.names("development")) >= 6
    assert len(kinds.names("reserved")) >= 6
    everything = [k.code for k in kinds.KINDS.values()]
    assert len(set(everything)) == len(everything)
    for standing in ("development", "reserved"):
        sites = {kinds.KINDS[n].site for n in kinds.names(standing)}
        assert sites == {"ground1", "bearings", "interface", "ground2", "release", "sensor"}


def test_a_filter_step_response_is_the_textbook_one():
    step, tau = 1e-5, 2e-3
    t = np.arange(2000) * step
    y = sensors._low_pass(np.ones(t.size), tau, step)
    fast = tau / 6
    assert np.abs(y - (1 - (tau * np.exp(-t / tau) - fast * np.exp(-t / fast)) / (tau - fast))).max() < 1e-9
    y = sensors._high_pass(np.ones(t.size), 40.0, step)
    assert np.abs(y - (40 * np.exp(-40 * t) - 5 * np.exp(-5 * t)) / 35).max() < 1e-9


def test_late_and_early_loggers_shift_the_record():
    at = np.arange(100) * 1e-3
    bare = simulate.record(RIG, True, np.arange(2000) * 5e-5)
    late = simulate.record(RIG, True, at, release=-4e-4)
    assert np.abs(late - bare[:, 8::20][:, :100]).max() < 1e-3
    early = simulate.record(RIG, True, at, release=4e-4)
    assert np.abs(early[:, 0]).max() == 0.0
    assert np.abs(early[:, 1:] - bare[:, 12::20][:, :99]).max() < 1e-3


def conditions():
    return [
        gap.Condition(coupled, RIG | {"k1t": k, "theta0": np.radians(a)})
        for coupled in (False, True)
        for _, k, a in campaign.CASES
    ]


def test_level_is_what_the_best_nominal_fit_leaves():
    kind = kinds.KINDS["quadratic_drag"]
    times = np.arange(500) * 1e-3
    shape = (0.4, 0.0, 0.0)
    size, level = gap.amplitude_for(kind, shape, 1.0, 0.5, conditions(), times)
    assert level == pytest.approx(0.5, rel=0.05)
    model = gap.Nominal(conditions(), times)
    data = np.concatenate(gap.truth(conditions(), times, [kind.at(size, shape)]))
    fit = least_squares(
        lambda x: np.concatenate(model.all(x)) - data, model.start(), x_scale="jac", diff_step=1e-4, max_nfev=25
    )
    assert np.sqrt(2 * fit.cost / data.size) / gap.NOISE == pytest.approx(level, rel=0.03)


def test_a_nominal_truth_leaves_no_gap():
    times = np.arange(300) * 1e-3
    model = gap.Nominal(conditions(), times)
    x = model.start()
    x[0] += 0.2
    x[4] -= 0.3
    assert model.fit(gap.truth(conditions(), times, []), x)[1].level < 2e-3


def visible(name, size):
    kind = kinds.KINDS[name]
    times = np.arange(400) * 1e-3
    wrong = [kind.at(size, kind.shape(np.random.default_rng(1)))]
    fit = gap.gap_of(conditions(), times, wrong, 5e-4)
    declared = campaign.DECLARED | {"k1t0": 6.2, "k1t1": 10.2}
    shares = campaign.HARD_SHARES | {"k1t": campaign.K1T_SHARE}
    left = gap.visible_chi2(conditions(), times, wrong, fit, declared, shares, 5e-4, campaign.TRIALS)
    return left, campaign.TRIALS * sum(float(r @ r) for r in fit.residuals) / gap.NOISE**2


def test_innovations_of_the_drawn_noise_are_white():
    """Unit variance at every frequency, and what is slow counts less than what is fast, as the spectrum of it says."""
    drawn = np.array([campaign.noise_draw(np.random.default_rng(k), 4000, True, 0) for k in range(40)]) / gap.NOISE
    white = gap.innovations(drawn)[:, 200:]
    power = np.mean(np.abs(np.fft.rfft(white, axis=1)) ** 2, axis=0)[1:-1] / white.shape[1]
    for band in np.array_split(power, 6):
        assert band.mean() == pytest.approx(1.0, abs=0.06)
    times = np.arange(4000) * 1e-3
    slow, fast = (np.sum(gap.innovations(np.sin(2.0 * np.pi * hertz * times)) ** 2) for hertz in (5.0, 300.0))
    assert slow < 0.3 * fast


def test_an_inertia_within_its_declaration_is_told_as_hidden():
    left, exact = visible("inertia_error", 0.02)
    assert exact > 100.0
    assert left < 6.0  # about one prior standard deviation of J2


def test_a_knock_stays_visible_when_constants_move():
    left, exact = visible("knock", 0.1)
    assert 0.3 * exact < left < 1.2 * exact


def read(path):
    with gzip.open(path, "rt") as text:
        rows = list(csv.reader(text))
    return rows[0], np.array(rows[1:], float)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("withheld")
    out = folder / "campaigns"
    code = make.main(
        [
            "--kind",
            "easy",
            "--kind",
            "hard",
            "--effect",
            "knock",
            "--effect",
            "none",
            "--level",
            "1",
            "--seed",
            "5",
            "--duration",
            "0.4",
            "--salt",
            "grain",
            "--out",
            str(out),
            "--quiet",
        ]
    )
    assert code == 0
    return out, json.loads((folder / "campaigns_key.json").read_text())


def test_campaigns_have_the_promised_files_and_columns(made):
    out, key = made
    assert len(key["campaigns"]) == 4
    assert sorted(p.name for p in out.iterdir()) == sorted(key["campaigns"])
    for name, entry in key["campaigns"].items():
        settings = tomllib.loads((out / name / "campaign.toml").read_text())
        assert settings["name"] == name
        uncertain = isinstance(settings["rig"]["primary_inertia"], dict)
        assert uncertain == (entry["kind"] == "hard")
        rows = list(csv.DictReader((out / name / "trials.csv").read_text().splitlines()))
        assert len(rows) == 24
        assert ("k1t_std_n_m_per_rad" in rows[0]) == (entry["kind"] == "hard")
        for row in rows:
            head, values = read(out / name / row["file"])
            wanted = ["time_s", "alpha1_rad_s2"] + (["alpha2_rad_s2"] if row["configuration"] == "coupled" else [])
            assert head == wanted
            assert values.shape == (400, len(wanted))
            if entry["kind"] == "hard":
                assert np.all(values[:, 1:] / 0.25 == np.round(values[:, 1:] / 0.25))


def test_nothing_in_a_campaign_tells_its_cause(made):
    out, key = made
    assert len(key["campaigns"]) == 4
    for name, entry in key["campaigns"].items():
        files = [path for path in (out / name).rglob("*") if path.is_file()]
        assert len(files) > 24
        for path in files:
            raw = path.read_bytes()
            text = gzip.decompress(raw).decode() if path.suffix == ".gz" else raw.decode()
            assert str(entry["seed"]) not in text
            for kind in kinds.KINDS:
                assert kind not in text
            if path.suffix == ".gz":
                assert raw[3] & 8 == 0  # no file name in the header
                assert raw[4:8] == bytes(4)  # and no time


def test_the_key_tells_the_truth(made):
    out, key = made
    truths = [entry["truth"] for entry in key["campaigns"].values()]
    assert sorted(truths) == ["knock", "knock", "none", "none"]
    for name, entry in key["campaigns"].items():
        if entry["truth"] == "none":
            assert entry["level"] == 0.0
            assert entry["site"] == "none"
            continue
        assert entry["truth"] == "knock"
        assert entry["site"] == "ground1"
        assert entry["standing"] == "development"
        assert entry["level"] == pytest.approx(1.0, rel=0.06)
        assert entry["visible_chi2"] > 1000.0
        disturbance = entry["disturbances"][0]
        d = kinds.KINDS["knock"].at(disturbance["amplitude"], tuple(disturbance["shape"]))
        k1t = entry["constants"].pop("k1t")
        rows = list(csv.DictReader((out / name / "trials.csv").read_text().splitlines()))
        for row, trial in zip(rows, entry["trials"], strict=True):
            own = {"k1t": k1t[row["k1t_n_m_per_rad"]], "theta0": trial["theta0_rad"]}
            rig = entry["constants"] | entry["nominal"] | own
            rig["mu"] = trial["mu"]
            y = simulate.record(rig, row["configuration"] == "coupled", np.arange(400) * 1e-3, [d], trial["release_s"])
            values = read(out / name / row["file"])[1][:, 1:].T
            for c, sd in enumerate((2.0, 2.8 if entry["kind"] == "hard" else 2.0)[: len(y)]):
                assert np.std(values[c] - y[c]) == pytest.approx(sd, rel=0.25)


def test_same_order_and_salt_give_the_same_files(made, tmp_path):
    out, key = made
    name = next(n for n, e in key["campaigns"].items() if e["kind"] == "hard" and e["truth"] == "none")
    order = campaign.Order("hard", (), 0.0, key["campaigns"][name]["seed"], 0.4)
    campaign.make_campaign(order, tmp_path, "grain")
    for path in (out / name).rglob("*"):
        if path.is_file():
            assert (tmp_path / name / path.relative_to(out / name)).read_bytes() == path.read_bytes()
    assert campaign.folder_name(order, "another grain") != name


def test_hard_noise_is_coloured_and_the_second_channel_noisier():
    rng = np.random.default_rng(1)
    first, second = (campaign.noise_draw(rng, 100_000, True, c) for c in (0, 1))
    assert np.std(first) == pytest.approx(2.0, rel=0.03)
    assert np.std(second) == pytest.approx(2.8, rel=0.03)
    assert np.corrcoef(first[1:], first[:-1])[0, 1] == pytest.approx(0.2 * 0.9, abs=0.02)


def test_orders_are_shuffled_have_own_seeds_and_refuse_unknown_names():
    wanted = sets.orders(("easy",), ("library", "none*3", "pairs", "knock+sensor_gain"), (0.5, 1.0), 9, pairs=4)
    assert len(wanted) == 2 * (23 + 4 + 1) + 3
    assert len({o.seed for o in wanted}) == len(wanted)
    assert [o.effects for o in wanted[:23]] != [(n,) for n in kinds.names("library")]
    assert sum(len(o.effects) == 2 for o in wanted) == 10
    with pytest.raises(ValueError, match="no disturbance or group is called 'knok'"):
        sets.orders(("easy",), ("knok",), (0.5,), 1)
    with pytest.raises(ValueError, match="no disturbance is called"):
        campaign.make_campaign(campaign.Order("easy", ("knok",), 0.5, 1), Path("nowhere"), "salt")


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def test_generator_and_package_share_no_code():
    own = sorted(SIMULATOR.rglob("*.py"))
    allowed = {"rig", "numpy", "scipy", "numba"} | sys.stdlib_module_names
    assert len(own) > 6
    for path in own:
        for name in imports(path):
            assert name.startswith(".") or name.split(".")[0] in allowed
    for path in (ROOT / "bayes_damper").rglob("*.py"):
        for name in imports(path):
            assert name.split(".")[0] != "rig"
            assert "withheld_make" not in name
            assert name.split(".")[0] != "data"


def test_rig_array_follows_the_named_fields():
    assert equations.rig_array(RIG)[equations.RIG_FIELDS.index("k1t")] == RIG["k1t"]
    assert tuple(equations.RIG_FIELDS[i] for i in (equations.NU, equations.TH0, equations.BAR)) == ("nu", "theta0", "R")
