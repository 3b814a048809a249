"""Drawn laboratories: right motion, honest levels, the promised draws, files that repeat, no common code."""

import ast
import gzip
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from bayes_damper.campaign import load_campaign

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT))

from validation.laboratories import campaign, gap, kinds, laboratory, motion  # noqa: E402
from validation.laboratories.__main__ import main  # noqa: E402

HOME = ROOT / "validation" / "laboratories"


def laboratories(n, seed=1, **given):
    rng = np.random.default_rng(seed)
    return [laboratory.draw(rng, **given) for _ in range(n)]


def two_bodies(**changes):
    """A rig with every term of the nominal equations."""
    lab = next(x for x in laboratories(50, 4, bodies=2) if x.normal_force == "linear" and x.true["k3t"])
    return replace(lab, **{"law": "tanh", "restoring": "linear", "quantity": "acceleration"} | changes)


LAB = two_bodies()
CASE = LAB.cases[0]
TIMES = np.linspace(0.0, 4.0 * 2.0 * np.pi / LAB.W, 300)
RIG = LAB.rig(CASE, True)


# Motion ---------------------------------------------------------------------------------------------------------------

LAWS = {
    "tanh": math.tanh,
    "algebraic": lambda x: x / math.sqrt(1.0 + x * x),
    "arctangent": lambda x: 2.0 / math.pi * math.atan(math.pi * x / 2.0),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("restoring", ["linear", "pendulum"])
def test_nominal_motion_is_that_of_the_equations_of_the_contract(law, restoring):
    """Written once more from the campaign's own constants, with a stiff method of another family."""
    lab = two_bodies(law=law, restoring=restoring)
    n, t, s = lab.nominal, lab.true, LAWS[law]
    k1, turn = lab.cases[0].k1, math.sin if restoring == "pendulum" else lambda x: x

    def rates(_, x):
        th1, th2, w1, w2 = x
        phi, v = th1 - th2, w1 - w2
        pull = t["N0"] * max(0.0, 1.0 - t["R"] * abs(phi) / (2.0 * t["r"]))
        T = n["k2t"] * phi + n["c2t"] * v + n["mu"] * pull * t["R"] * s(n["nu"] * v)
        a1 = -(n["c1t"] * w1 + k1 * turn(th1) + n["drag"] * s(n["nu"] * w1) + T) / t["J1"]
        a2 = -(n["c3t"] * w2 + t["k3t"] * turn(th2) + n["drag"] * s(n["nu"] * w2) - T) / t["J2"]
        return w1, w2, a1, a2

    x0 = [lab.cases[0].theta0, lab.cases[0].theta0, 0.0, 0.0]
    out = solve_ivp(rates, (0.0, TIMES[-1]), x0, "LSODA", TIMES, rtol=1e-10, atol=1e-13, max_step=0.05 / lab.W)
    expected = np.array([rates(0.0, x)[2:] for x in out.y.T]).T
    found = motion.record(lab.rig(lab.cases[0], True), TIMES)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_linear_primary_alone_follows_the_closed_form():
    lab = two_bodies(quantity="displacement")
    rig = lab.rig(lab.cases[0], False) | {"drag": 0.0}
    wn = math.sqrt(rig["k1"] / rig["J1"])
    zeta = rig["c1"] / (2.0 * rig["J1"] * wn)
    wd = wn * math.sqrt(1.0 - zeta**2)
    swing = np.cos(wd * TIMES) + zeta * wn / wd * np.sin(wd * TIMES)
    expected = rig["theta0"] * np.exp(-zeta * wn * TIMES) * swing
    assert np.abs(motion.record(rig, TIMES)[0] - expected).max() < 1e-7 * rig["theta0"]


@pytest.mark.parametrize("name", list(kinds.KINDS))
def test_every_kind_is_stepped_as_by_another_method(name):
    kind = kinds.KINDS[name]
    d = [kind.at(kind.scale * kind.signs[-1], kind.shape(np.random.default_rng(2)))]
    codes, numbers = motion.packed(d)
    g = motion.vector(RIG)

    def rates(t, x):
        out = np.zeros_like(x)
        motion.derivative(t, x, g, codes, numbers, out)
        return out

    short = TIMES[:120]
    x0 = motion.start(g, codes, numbers)
    out = solve_ivp(rates, (0.0, short[-1]), x0, "DOP853", short, rtol=1e-9, atol=1e-13, max_step=0.1 / LAB.W)
    shown = [motion.shown(t, x, rates(t, x), g, codes, numbers, False) for t, x in zip(out.t, out.y.T, strict=True)]
    expected = np.array(shown).T
    assert np.abs(motion.record(RIG, short, d) - expected).max() < 2e-6 * np.abs(expected).max()


@pytest.mark.parametrize("name", list(kinds.KINDS))
def test_every_kind_changes_the_records_and_vanishes(name):
    kind = kinds.KINDS[name]
    shape = kind.shape(np.random.default_rng(3))
    base = motion.record(RIG, TIMES)[:, 1:]  # at the release itself a ramp still holds, and a filter still rests
    peak = np.abs(base).max()
    size, most = (1e-3, 1e-2) if kind.site == "sensor" else (1e-6, 1e-3)
    for sign in kind.signs:
        change = motion.record(RIG, TIMES, [kind.at(2.0 * sign * kind.scale, shape)])[:, 1:] - base
        assert np.abs(change).max() > 1e-4 * peak
        if name != "stick_slip":  # bristles have no null
            faint = motion.record(RIG, TIMES, [kind.at(sign * size, shape)])[:, 1:] - base
            assert np.abs(faint).max() < most * peak


@pytest.mark.parametrize("name", [n for n, k in kinds.KINDS.items() if k.site == "interface"])
def test_interface_kinds_leave_the_primary_alone(name):
    kind = kinds.KINDS[name]
    rig = LAB.rig(CASE, False)
    wrong = [kind.at(kind.scale, kind.shape(np.random.default_rng(1)))]
    base = motion.record(rig, TIMES)
    assert np.abs(motion.record(rig, TIMES, wrong) - base).max() < 1e-7 * np.abs(base).max()


def test_held_before_the_release_and_late_by_the_instant():
    late = 7.0 * (TIMES[1] - TIMES[0])
    y = motion.record(RIG, TIMES, (), late)
    assert np.all(y[:, :7] == 0.0)
    assert np.allclose(y[:, 7:], motion.record(RIG, TIMES)[:, :-7], rtol=0.0, atol=1e-6 * np.abs(y).max())
    angle = motion.record(RIG | {"quantity": 0.0}, TIMES, (), late)
    assert np.all(angle[:, :7] == RIG["theta0"])


def test_a_ramp_lets_go_slowly():
    slow = motion.record(RIG | {"ramp": 0.2 / LAB.W}, TIMES)
    assert slow[0, 0] == pytest.approx(0.0, abs=1e-9 * np.abs(slow).max())
    assert abs(motion.record(RIG, TIMES)[0, 0]) > 0.1 * np.abs(slow).max()


# Draws ----------------------------------------------------------------------------------------------------------------


def test_a_slow_release_and_a_trials_own_ramp_hold_the_rig_once():
    rig = RIG | {"ramp": 2e-3 / LAB.W, "quantity": 2.0}
    times = np.linspace(0.0, 0.3 / LAB.W, 60)
    slow = [motion.Disturbance(17, (0.2,))]
    peak = np.abs(motion.record(rig, times)[0]).max()
    assert np.abs(motion.record(rig, times[times < 2e-3 / LAB.W], slow)[0]).max() < 0.05 * peak
    assert np.abs(motion.record(rig, times, slow)[0]).max() < 1.05 * peak


def test_laboratories_are_drawn_over_the_promised_ranges():
    labs = laboratories(400)
    f = np.array([x.W / (2.0 * np.pi) for x in labs])
    assert 0.5 <= f.min() < 0.6
    assert 25.0 < f.max() <= 30.0
    two = [x for x in labs if x.bodies == 2]
    ratio = np.array([x.declared["J2"] / x.declared["J1"] for x in two])
    assert 0.299 < ratio.min() < 0.35
    assert 2.6 < ratio.max() <= 3.01
    quality = np.array([x.true["J1"] * x.W * x.A / (x.nominal["c1t"] * x.A + 4.0 * x.nominal["drag"] / (np.pi * x.W))
                        for x in labs])  # fmt: skip
    assert 2.99 < quality.min() < 4.0
    assert 250.0 < quality.max() < 301.0
    assert {x.kind for x in labs} == {"torsional", "translational"}
    for attribute, of in (("quantity", laboratory.QUANTITIES), ("law", laboratory.LAWS), ("noise", laboratory.NOISES)):
        assert {getattr(x, attribute) for x in labs} == set(of)
    assert {len(x.cases) for x in labs} == {1, 2, 3, 4, 5}
    assert {n for x in labs for c in x.cases for n in c.trials.values()} == set(range(1, 9))
    assert 0.6 < len(two) / len(labs) < 0.8
    assert all(3.0 <= x.periods <= 60.0 and 20.0 <= x.per_period <= 300.0 for x in labs)
    assert all(x.periods * x.per_period * sum(n for c in x.cases for n in c.trials.values()) <= 40_001 for x in labs)


def test_each_scatter_is_absent_or_within_half_a_decade_of_the_typical_one():
    labs = laboratories(300, 2)
    for name, typical in laboratory.TYPICAL.items():
        sizes = np.array([x.scatter[name] for x in labs if name in x.scatter])
        there = sizes[sizes > 0.0] / typical
        assert 0.2 < np.mean(sizes == 0.0) < 0.4
        assert 0.316 < there.min() < 0.4
        assert 2.5 < there.max() < 3.17
    assert {x.facts()["scatter_class"] for x in labs} >= {"weak", "strong"}
    (one,) = laboratories(1, 3, strength=2.0, repeats=True, bodies=1)
    assert one.strength == pytest.approx(2.0)
    assert (one.bodies, one.repeats) == (1, True)
    assert "mu" not in one.scatter


def test_trials_scatter_as_their_laboratory_says():
    lab = replace(LAB, scatter=dict(laboratory.TYPICAL), trend={"drag": 1.0})
    rng = np.random.default_rng(1)
    places = np.linspace(-1.0, 1.0, 2001)
    owns = [lab.own_values(rng, float(place)) for place in places]
    for name in ("k1t", "mu", "gain2", "theta0"):
        assert np.std([o[name] for o in owns]) == pytest.approx(laboratory.TYPICAL[name], rel=0.08)
    assert np.std([o["offset2"] for o in owns]) == pytest.approx(0.5 * lab.sigma[1], rel=0.08)
    assert np.corrcoef([o["drag"] for o in owns], places)[0, 1] > 0.999
    ramps = np.array([o["ramp"] for o in owns])
    assert 0.0 <= ramps.min() < ramps.max() <= 4e-4


@pytest.mark.parametrize("noise", laboratory.NOISES)
def test_noise_has_the_size_and_the_colour_of_its_laboratory(noise):
    shape = {"white": 0.0, "coloured": 0.4, "heavy-tailed": 5.0, "quantised": 1.0}[noise]
    lab = replace(LAB, noise=noise, noise_shape=shape, per_period=100.0)
    z = lab.noise_of(np.random.default_rng(1), 40_000, 1) / lab.sigma[1]
    assert np.std(z) == pytest.approx(1.0, rel=0.05)
    lag = np.mean(z[1:] * z[:-1])
    assert (lag > 0.2) == (noise == "coloured")
    assert (np.mean(z**4) > 4.0) == (noise == "heavy-tailed")
    y = campaign.add_noise(np.zeros((2, 50)), lab, np.random.default_rng(2))
    step = lab.sigma[0]
    assert np.allclose(y[0] / step, np.round(y[0] / step)) == (noise == "quantised")


@pytest.mark.parametrize("clock", ["even", "jittered", "slowing"])
def test_clocks_run_forward_over_the_whole_record(clock):
    lab = replace(LAB, clock=clock)
    times = lab.times(np.random.default_rng(1))
    assert times[0] == 0.0
    assert np.all(np.diff(times) > 0.0)
    assert times[-1] == pytest.approx(2.0 * np.pi / LAB.W * LAB.periods, rel=0.05)
    assert (np.ptp(np.diff(times)) > 0.3 * lab.interval) == (clock != "even")


# Levels ---------------------------------------------------------------------------------------------------------------


def quiet(**changes):
    """A laboratory of two cases without any scatter, constants known, few readings."""
    lab = two_bodies(
        scatter=dict.fromkeys(laboratory.TYPICAL, 0.0), shares=dict.fromkeys(("J1", "J2", "R", "r", "k1t"), 0.0),
        periods=6.0, per_period=25.0, clock="even",
    )  # fmt: skip
    first = replace(lab.cases[0], trials={False: 2, True: 2})
    second = replace(first, label="II", theta0=0.6 * first.theta0, k1=0.7 * first.k1)
    return replace(lab, cases=(first, second), **changes)


def test_the_level_is_what_another_fit_leaves():
    """SciPy's trust-region search over the same numbers, from a start of its own, in steps of its own."""
    lab = quiet()
    seen = gap.conditions(lab)
    kind = kinds.KINDS["spring_cubic"]
    size, level = gap.amplitude_for(lab, seen, kind, (0.9,), 1.0, 1.0, 0.0)
    assert level == pytest.approx(1.0, rel=0.1)
    data = [motion.record(lab.rig(c.case, c.coupled), c.times, [kind.at(size, (0.9,))]) for c in seen]

    def left(x):
        out = []
        for i, (c, y) in enumerate(zip(seen, data, strict=True)):
            rig = lab.rig(c.case, c.coupled)
            for j, name in enumerate(("friction", "k2", "c2", "drag", "nu", "c1", "c3")):
                rig[name] *= math.exp(x[j])
            rig["theta0"] *= 1.0 + x[7 + 2 * i]
            model = motion.record(rig, c.times, (), x[8 + 2 * i] * lab.interval)
            sigma = np.array(lab.sigma[: y.shape[0]])[:, None]
            out += [((y - model) / sigma).ravel(), [x[7 + 2 * i] / 0.05, x[8 + 2 * i]]]
        return np.concatenate(out)

    found = least_squares(left, np.full(15, 0.02), diff_step=1e-5, x_scale=0.1)
    n = sum(y.size for y in data)
    assert math.sqrt(2.0 * found.cost / n) == pytest.approx(level, rel=0.05)


def test_a_sound_rig_leaves_nothing_and_scatter_makes_a_gap_harder_to_see():
    lab = quiet()
    seen = gap.conditions(lab)
    assert gap.gap_of(lab, seen, (), 0.0).level < 1e-3
    kind = kinds.KINDS["spring_cubic"]
    wrong = [kind.at(0.2, (0.9,))]
    assert gap.gap_of(lab, seen, wrong, 0.0).level == pytest.approx(2.0 * gap.gap_of(lab, seen, wrong, 3.0**0.5).level)
    loose = replace(lab, scatter=lab.scatter | {"k1t": 2e-3, "theta0": 0.01})
    assert gap.visible_chi2(loose, seen, wrong) < gap.visible_chi2(lab, seen, wrong)


def test_what_a_declaration_allows_is_not_visible():
    """A factor on the only spring, within its declared deviation, costs its pull and no more."""
    lab = quiet()
    lab = replace(lab, cases=lab.cases[:1], shares=lab.shares | {"k1t": 0.02})
    seen = gap.conditions(lab)
    wrong = [kinds.KINDS["stiffness_error"].at(0.01, ())]
    assert gap.visible_chi2(lab, seen, wrong) == pytest.approx((math.log(1.01) / 0.02) ** 2, rel=0.05)
    exact = replace(lab, shares=lab.shares | {"k1t": 0.0})
    assert gap.visible_chi2(exact, seen, wrong) > 100.0


def test_scatter_is_measured_beyond_angle_and_instant():
    lab = quiet()
    seen = gap.conditions(lab)
    none = dict.fromkeys(laboratory.TYPICAL, 0.0)
    turned = [[none | {"theta0": 0.003, "instant": 0.05 * lab.interval}] for _ in seen]
    offset = [[none | {"offset1": lab.sigma[0], "offset2": lab.sigma[1]}] for _ in seen]
    assert gap.scatter_rms(lab, seen, turned) < 0.1
    assert gap.scatter_rms(lab, seen, offset) == pytest.approx(1.0, rel=0.1)


# Files ----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    home = tmp_path_factory.mktemp("labs")
    wanted = campaign.orders(("none*4", "library*2", "foreign", "library+foreign"), seed=11)
    key = campaign.write_set(wanted, home / "set", home / "set_key.json", salt="salt")
    return home, wanted, key


def test_campaigns_can_be_read_and_hold_what_the_key_says(made):
    home, wanted, key = made
    assert len(key["campaigns"]) == len(wanted) == 8
    for name, entry in key["campaigns"].items():
        loaded = load_campaign(home / "set" / name)
        assert len(loaded.trials) == len(entry["trials"])
        assert entry["laboratory"]["bodies"] == 1 + any(t.coupled for t in loaded.trials)
        assert loaded.measurement.quantity == entry["laboratory"]["quantity"]
        assert entry["kind"] == "laboratory"
    truths = sorted(e["truth"] for e in key["campaigns"].values())
    assert truths.count("none") == 4
    assert truths.count("pair") == 1
    for entry in key["campaigns"].values():
        assert (entry["level"] == 0.0) is (entry["truth"] == "none")
        if entry["truth"] not in ("none", "pair"):
            assert entry["visible_chi2"] > 0.0
            assert entry["level"] == pytest.approx(entry["level_wanted"], rel=0.3)


def test_records_are_the_model_with_noise_of_the_declared_size(made):
    home, _, key = made
    name, entry = next((n, e) for n, e in key["campaigns"].items() if e["truth"] == "none")
    order = campaign.Order(**(entry["order"] | {"causes": ()}))
    lab = laboratory.draw(np.random.default_rng([order.seed, 20231]))
    row = entry["trials"][0]
    lines = gzip.decompress((home / "set" / name / row["file"]).read_bytes()).decode().splitlines()
    table = np.array([[float(v) for v in line.split(",")] for line in lines[1:]]).T
    coupled = table.shape[0] == 3
    own = dict(row)
    y = motion.record(lab.rig(lab.cases[0], coupled, own), table[0], (), own["instant"])
    left = table[1:] - gap.add_sensor_scatter(y, table[0], own)
    assert np.std(left[0]) == pytest.approx(lab.sigma[0], rel=0.35)


def test_nothing_in_a_campaign_shows_its_cause(made):
    home, _, key = made
    assert len(key["campaigns"]) == 8
    for name, entry in key["campaigns"].items():
        text = "".join(p.read_text() for p in (home / "set" / name).glob("*.*"))
        assert "[rig]" in text
        assert not [n for n in kinds.KINDS if n in text]
        assert str(entry["order"]["seed"]) not in text
        assert "salt" not in text


def test_a_key_makes_the_same_bytes_again(made, tmp_path):
    home, _, key = made
    small = min(key["campaigns"], key=lambda n: sum(p.stat().st_size for p in (home / "set" / n).rglob("*.gz")))
    key = key | {"campaigns": {small: key["campaigns"][small]}}
    (tmp_path / "key.json").write_text(json.dumps(key))
    assert main(["--again", str(tmp_path / "key.json"), "--out", str(tmp_path / "again")]) == 0
    files = [p for p in (home / "set" / small).rglob("*") if p.is_file()]
    assert len(files) > 2
    for path in files:
        assert (tmp_path / "again" / small / path.relative_to(home / "set" / small)).read_bytes() == path.read_bytes()
    assert json.loads((tmp_path / "again_key.json").read_text())["campaigns"] == json.loads(
        json.dumps(key["campaigns"])
    )


def test_orders_are_shuffled_and_unknown_names_are_refused(capsys, tmp_path):
    a = campaign.orders(("none*30", "library*30"), 1, level=2.0)
    assert [o.level for o in a] != sorted(o.level for o in a)
    assert len({o.seed for o in a}) == 60
    assert {o.level for o in a} == {0.0, 2.0}
    with pytest.raises(ValueError, match="no kind is called 'knok'"):
        campaign.orders(("knok",), 1)
    with pytest.raises(SystemExit):
        main(["knok", "--out", str(tmp_path)])
    with pytest.raises(SystemExit):
        main([])
    assert main(["--list"]) == 0
    assert "sloshing" in capsys.readouterr().out


def test_a_rig_of_one_body_is_not_offered_the_other_ones_faults():
    assert not {"magnet_fade", "sloshing", "crosstalk"} & {
        *kinds.names("library", coupled=False), *kinds.names("foreign", coupled=False),
    }  # fmt: skip
    assert "normal_force_law" not in kinds.names("library", fading=False)


# Independence ---------------------------------------------------------------------------------------------------------


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def test_laboratories_and_package_share_no_code():
    own = sorted(HOME.rglob("*.py"))
    allowed = {"numpy", "scipy", "numba"} | sys.stdlib_module_names
    assert len(own) > 6
    for path in own:
        for name in imports(path):
            assert name.startswith(".") or name.split(".")[0] in allowed
    for path in (ROOT / "bayes_damper").rglob("*.py"):
        assert not [name for name in imports(path) if name.split(".")[0] == "validation"]
