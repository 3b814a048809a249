"""A learnt law as an effect: its torque, its file, and what is refused. Records against scipy, not against itself."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import reference
from campaigns import write_synthetic
from numpy.polynomial.chebyshev import chebval
from scipy.integrate import solve_ivp

from bayes_damper.calibration.experiment import laws_on
from bayes_damper.campaign import load_campaign
from bayes_damper.cli import main
from bayes_damper.effects import _law, effects_sha256, load_effects
from bayes_damper.effects._law import ORDER, Law, Term, read_law, written
from bayes_damper.errors import InputError
from bayes_damper.simulation.model import Model

RANGES = {"angle": (-0.09, 0.06), "speed": (-4.0, 5.0), "time": (0.0, 0.3)}
RIG = {"kind": "torsional", "J1": 3.015e-3, "J2": 2.474e-3}
TERMS = (("dry", "angle"), ("angle", "speed"), ("one", "time"), ("speed", "angle"))
TIMES = np.arange(301) * 1e-3


def law_at(site="interface", bodies="both", terms=TERMS, **more):
    rng = np.random.default_rng(5)
    made = tuple(Term(c, along, tuple(0.01 * rng.standard_normal(ORDER) / np.arange(1, 13))) for c, along in terms)
    roots = tuple(map(tuple, 1e-3 * rng.standard_normal((3, ORDER * len(made)))))
    return Law(site, bodies, RANGES, 40.0, made, roots, RIG, "made here", **more)


def by_hand(law, x, v, t, nu):
    """The torque at one place, from the words of the file alone."""
    total = 0.0
    for term in law.terms:
        low, high = RANGES[term.along]
        at = {"angle": x, "speed": v, "time": t}[term.along]
        u = 2.0 * (min(max(at, low), high) - low) / (high - low) - 1.0
        if term.along == "speed":
            w = min(max(at, low), high) / 5.0
            u = 1.2 * w / (0.2 + abs(w))
        share = {"angle": x / 0.09, "speed": v / 5.0}.get(term.carrier, 1.0)
        carrier = math.tanh(nu * v) if term.carrier == "dry" else min(max(share, -1.0), 1.0)
        total += carrier * chebval(u, term.coefficients)
    return total


def solved(law, p, size):
    """Both accelerations by scipy, with the law's torque at its site."""
    p = reference.BASE | p

    def rhs(t, s):
        th1, th2, w1, w2 = s
        q = np.zeros(2)
        if law.site == "interface":
            f = size * by_hand(law, th1 - th2, w1 - w2, t, p["nu"])
            q[:] = -f, f
        elif law.site == "ground2":
            q[1] = size * by_hand(law, th2, w2, t, p["nu"])
        else:
            q[0] = size * by_hand(law, th1, w1, t, p["nu"])
            q[1] = size * by_hand(law, th2, w2, t, p["nu"]) if law.bodies == "both" else 0.0
        pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(th1 - th2) / (2.0 * p["r"]))
        joint = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2)
        joint += p["mu"] * pull * p["R"] * math.tanh(p["nu"] * (w1 - w2))
        a1 = (q[0] - joint - p["c1t"] * w1 - p["k1t"] * th1 - p["drag"] * math.tanh(p["nu"] * w1)) / p["J1"]
        a2 = (q[1] + joint - p["c3t"] * w2 - p["drag"] * math.tanh(p["nu"] * w2)) / p["J2"]
        return [w1, w2, a1, a2]

    start = [p["theta0"], p["theta0"], 0.0, 0.0]
    s = solve_ivp(rhs, (0.0, TIMES[-1]), start, "LSODA", TIMES, rtol=1e-9, atol=1e-11, max_step=1e-3).y
    return np.array([rhs(t, s[:, i])[2:] for i, t in enumerate(TIMES)]).T


@pytest.mark.parametrize(
    ("site", "bodies"),
    [
        ("interface", "both"),
        *(
            pytest.param(site, bodies, marks=pytest.mark.slow)  # a kernel each, compiled in seconds
            for site, bodies in (
                ("ground1", "primary"),
                ("bearings", "both"),
                ("bearings", "primary"),
                ("ground2", "both"),
            )
        ),
    ],
)
def test_records_are_those_of_scipy_with_the_torque_of_the_file(site, bodies, tmp_path):
    path = tmp_path / "law.toml"
    path.write_text(written(law_at(site, bodies if site == "bearings" else "both")))
    effect = load_effects(path)[f"learnt_{site}"]
    p = {"nu": 30.0, "theta0": 0.1}
    y = Model(effect=effect.variants[0]).simulate(reference.BASE | p, TIMES, effect={"size": 0.7}).y[0]
    exact = solved(effect.law if site != "ground1" else law_at(site, "primary"), p, 0.7)
    bare = Model().simulate(reference.BASE | p, TIMES).y[0]
    peak = np.abs(exact).max()
    assert np.abs(bare - exact).max() > 0.02 * peak
    assert np.abs(y - exact).max() < 2e-4 * peak
    nothing = Model(effect=effect.variants[0]).simulate(reference.BASE | p, TIMES, effect={"size": 0.0}).y[0]
    assert np.abs(nothing - bare).max() < 1e-12 * peak


def test_a_law_that_is_learnt_moves_as_the_one_that_is_kept():
    law = law_at("bearings")
    rng = np.random.default_rng(2)
    directions = 0.01 * rng.standard_normal((12, ORDER * len(law.terms)))
    p = rng.standard_normal(12)
    kernel = _law.free_law(law.terms, law.ranges, directions)
    c = (p @ directions).reshape(-1, ORDER)
    kept = Law(
        law.site, "both", law.ranges, 40.0,
        tuple(Term(t.carrier, t.along, tuple(x)) for t, x in zip(law.terms, c, strict=True)),
    )  # fmt: skip
    rig = type("Rig", (), {"nu": 40.0})
    for t, x, v in ((0.1, 0.02, -1.0), (0.5, -0.2, 9.0), (0.0, 0.0, 0.0)):
        value = _in_python(kernel)(t, x, v, 0.0, tuple(p), rig)
        assert value == pytest.approx(kept.torque(np.array([x]), np.array([v]), np.array([t]))[0][0], abs=1e-12)
        assert value == pytest.approx(by_hand(kept, x, v, t, 40.0), abs=1e-12)


def _in_python(kernel):
    """The kernel as a plain function, with the kernels that it calls."""
    plain = kernel.py_func
    if plain.__closure__:
        for cell in plain.__closure__:
            if hasattr(cell.cell_contents, "py_func"):
                cell.cell_contents = _in_python(cell.cell_contents)
    return plain


def test_a_law_keeps_its_last_value_and_its_band():
    law = law_at()
    near = np.array([[0.06], [5.0], [0.3]])
    far = np.array([[0.5], [50.0], [9.0]])
    near[0] += 0.03  # x as a carrier reaches to its largest size, 0.09
    assert law.torque(*far)[0] == pytest.approx(law.torque(*near)[0], abs=1e-9)
    draws = np.random.default_rng(0).standard_normal((4000, 3)) @ np.array(law.roots)
    spread = np.std(law.basis(*near) @ draws.T)
    assert law.torque(*near)[1][0] == pytest.approx(spread, rel=0.05)


def test_a_file_gives_back_the_law(tmp_path):
    formulas = (("-0.02 v|v|", 0.75), ("0.3 x^2 v", 0.125))
    law = law_at(
        "bearings", "primary", beside=("bearing_drag",), closes=(0.8, 0.7, 0.9), formulas=formulas, shape_only=0.125
    )  # fmt: skip
    path = tmp_path / "bearings.toml"
    path.write_text(written(law))
    back = read_law(path)
    assert (back.site, back.bodies, back.beside, back.closes) == ("bearings", "primary", ("bearing_drag",), law.closes)
    assert (back.formulas, back.shape_only) == (formulas, 0.125)
    x = np.linspace(-0.1, 0.1, 50)
    for own, again in zip(law.torque(x, 30.0 * x, x + 0.1), back.torque(x, 30.0 * x, x + 0.1), strict=True):
        assert again == pytest.approx(own, abs=1e-9)


def test_a_file_changed_by_hand_is_refused_until_its_check_is_deleted(tmp_path):
    path = tmp_path / "interface.toml"
    text = written(law_at())
    path.write_text(text.replace("nu = 4.0", "nu = 8.0"))
    with pytest.raises(InputError, match=r"was changed after it was written.*delete its table \[check\]"):
        load_effects(path)
    path.write_text(text.replace("nu = 4.0", "nu = 8.0").partition("[check]")[0])
    assert load_effects(path)["learnt_interface"].law.nu == 80.0
    path.write_text(text.replace("\n", "\r\n"))
    assert load_effects(path)["learnt_interface"].law.nu == 40.0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("bayes-damper/law/1", "bayes-damper/law/9", "is no learnt law"),
        ('site = "interface"', 'site = "roof"', "site 'roof'"),
        ('site = "interface"\n', "", "site is missing"),
        ("[ranges]\nangle = [-", "[ranges]\nangle = [", "must rise"),
        ('carrier = "dry"', 'carrier = "wet"', "carrier 'wet'"),
        ("coefficients = [", "coefficients = [0.0, ", "must be 12 numbers"),
        ("coefficients = [", "coefficients = [nan, ", "must be 12"),
        ("nu = 4.0", "nu = inf  # 4.0", "must be finite"),
        ("[rig]", "rig = 3\n[rigs]", "rig = 3"),
        ("[[term]]", "[[terms]]", "term is missing"),
        ("schema =", "schema", "not valid TOML"),
        ("[rig]", 'formulas = ["v"]\n[rig]', "pairs of a formula and its probability"),
        ("[rig]", 'formulas = [["v", nan]]\n[rig]', "probability of v"),
    ],
)
def test_a_broken_file_ends_in_a_sentence(old, new, told, tmp_path):
    path = tmp_path / "interface.toml"
    text = written(law_at()).partition("[check]")[0]
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=told.replace("[", r"\[")):
        load_effects(path)


def test_a_folder_may_hold_laws_effects_and_other_files(tmp_path):
    for site in ("interface", "bearings"):
        (tmp_path / f"{site}.toml").write_text(written(law_at(site)))
    (tmp_path / "campaign.toml").write_text('name = "no law"\n')
    before = effects_sha256(tmp_path)
    assert sorted(load_effects(tmp_path)) == ["learnt_bearings", "learnt_interface"]
    assert load_effects(tmp_path)["learnt_interface"].needs == ("coupled",)
    (tmp_path / "campaign.toml").write_text('name = "another"\n')
    assert effects_sha256(tmp_path) == before
    assert effects_sha256(tmp_path / "bearings.toml") != effects_sha256(tmp_path / "interface.toml")
    (tmp_path / "again.toml").write_text(written(law_at("bearings", closes=(0.5, 0.4, 0.6))))
    with pytest.raises(InputError, match="there is an effect learnt_bearings already"):
        load_effects(tmp_path)


def test_simulate_takes_a_law_and_says_where_it_does_not_reach(tmp_path, capsys):
    path = tmp_path / "interface.toml"
    path.write_text(written(law_at(beside=("magnet_fade",))))
    call = ["simulate", "--effects", str(path), "--effect", "learnt_interface", "--out", str(tmp_path / "y.csv")]
    assert main([*call, "--json"]) == 0
    told = " ".join(json.loads(capsys.readouterr().out)["warnings"])
    assert "learnt for times from 0 to 0.3; here there are 0 to 1, where it holds its last value" in told
    assert "learnt beside magnet_fade" in told
    assert main([*call, "--duration", "0.02"]) == 0
    assert "times" not in capsys.readouterr().out
    assert main([*call, "--set", "J1=0.006"]) == 2
    assert "learnt on a rig with J1 = 0.003015, and this one has 0.006" in capsys.readouterr().err
    path.write_text(path.read_text().replace("magnet_fade", "stick_slip"))
    assert main(call) == 2
    assert "was changed after it was written" in capsys.readouterr().err


def test_laws_of_other_rigs_are_refused_and_short_ones_warned_of(tmp_path, capsys):
    campaign = write_synthetic(tmp_path / "campaign", repeats=2)
    law = law_at("bearings")
    path = tmp_path / "bearings.toml"
    path.write_text(written(law))
    loaded = load_campaign(campaign)
    told = laws_on(load_effects(path), loaded)
    assert len(told) == 2
    assert "angles from -0.09 to 0.06; here there are -0.082 to 0.082" in told[0]
    assert "times from 0 to 0.3; here there are 0 to 1" in told[1]
    path.write_text(written(replace(law, ranges=RANGES | {"time": (0.0, 2.0), "angle": (-0.1, 0.1)})))
    assert laws_on(load_effects(path), loaded) == []
    path.write_text(written(replace(law, rig={"kind": "translational", "J1": 0.003})))
    for command in (["diagnose"], ["fit", "--effect", "learnt_bearings"]):
        assert (
            main([command[0], str(campaign), *command[1:], "--effects", str(path), "--out", str(tmp_path / "o")]) == 2
        )
        assert "was learnt on a translational rig, and this one is torsional" in capsys.readouterr().err
        assert not (tmp_path / "o").exists()  # said before anything is fitted
