"""The missing law, learnt: how much of the gap it closes, its shape, its files, and where none is offered."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from small_rig import measured, variant
from test_sets import swinging

from bayes_damper.calibration import Experiment, calibrate, calibrate_nominal
from bayes_damper.diagnosis.budget import Budget, Part
from bayes_damper.diagnosis.law import TERMS, best_terms, learn, used_coordinates, worth_offering
from bayes_damper.diagnosis.response import Projected
from bayes_damper.diagnosis.sets import SetProblem, set_fit
from bayes_damper.diagnosis.shares import NO_SHARE, Closed
from bayes_damper.diagnosis.sites import site_map
from bayes_damper.effects import EFFECTS, load_effects
from bayes_damper.effects._law import ORDER, Term
from bayes_damper.effects.base import EffectParameter, Variant
from bayes_damper.priors.distributions import LogNormal, Normal
from bayes_damper.rig.vector_math import lane, sin


@lane
def teeth(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Teeth between the faces, a kind that the library does not have."""
    q = p[0] * sin(70.0 * (th1 - th2))
    return -q, q


A = EffectParameter("a", "N m", "Torque of the teeth.", Normal(0.0, 0.1), "Own assumption for tests.", 0.0)
TEETH = Variant("teeth", "-a sin(70 phi)", (A,), torque=teeth, couples="interface", starts=((0.01,),), uncoupled=False)
SIZE = 0.02


def without_effects(fit):
    """The budget of a gap that no effect explains."""
    return Budget(set_fit((), fit), (), NO_SHARE, {}, {})


@pytest.fixture(scope="module")
def found():
    fit = calibrate_nominal(measured(4, effect=TEETH, values={"a": SIZE}))
    place = site_map(fit, torque=False)
    return fit, place, learn(fit, without_effects(fit), "unknown", place, "teeth", rng=np.random.default_rng(1))


@pytest.mark.slow
def test_a_law_outside_the_library_is_learnt_at_its_site(found):
    fit, _, learnt = found
    law = learnt.law
    assert (law.site, law.campaign, law.beside) == ("interface", "teeth", ())
    assert learnt.closes.hdi90[0] > 0.85
    assert learnt.closes.median < 1.1
    assert learnt.of_the_rest == learnt.closes
    assert 3.0 < learnt.freedom <= 12.0
    assert learnt.fit.chi2 < fit.chi2 - 500.0
    # Its shape along the angle, at rest, where the readings are: what is straight belongs to k2t.
    x = np.linspace(0.7 * law.ranges["angle"][0], 0.7 * law.ranges["angle"][1], 60)
    mine = law.torque(x, 0.0 * x, 0.0 * x)[0]
    true = SIZE * np.sin(70.0 * x)
    straight = np.stack([np.ones_like(x), x], axis=1)
    mine, true = (y - straight @ np.linalg.lstsq(straight, y, rcond=None)[0] for y in (mine, true))
    assert mine @ true / np.linalg.norm(mine) / np.linalg.norm(true) > 0.95
    assert np.linalg.norm(mine) / np.linalg.norm(true) == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_its_files_are_an_effect_that_closes_the_gap_and_tables_that_agree(found, tmp_path):
    _, _, learnt = found
    learnt.write(tmp_path)
    shown = learnt.to_json()
    effect = load_effects(tmp_path / shown["file"])[shown["effect"]]
    again = calibrate_nominal(measured(9, effect=TEETH, values={"a": SIZE}))  # other noise, other releases
    q = np.array([*again.q, 0.0])  # the size at its prior mean, 1
    with_law = again.problem.with_effect(effect.variants[0])
    names = [n for n in learnt.fit.problem.names if not n.startswith("effect.")]
    q[[again.problem.names.index(n) for n in names]] = learnt.fit.q[: len(names)]
    assert with_law.costs(q[None], {i: v[None] for i, v in again.eta.items()})[0] < again.cost - 300.0
    home = tmp_path / "learnt"
    with (home / "interface_table.csv").open() as file:
        rows = list(csv.DictReader(file))
    used = used_coordinates(learnt.law.terms)
    units = {"angle": "angle_rad", "speed": "speed_rad_s", "time": "time_s"}
    at = {n: np.array([float(r[units[n]]) for r in rows]) for n in used}
    nothing = np.zeros(len(rows))
    value, sd = effect.law.torque(*(at.get(n, nothing) for n in units))
    np.testing.assert_allclose([float(r["torque_n_m"]) for r in rows], value, atol=1e-7)
    np.testing.assert_allclose([float(r["torque_sd_n_m"]) for r in rows], sd, atol=1e-7)
    with (home / "interface.csv").open() as file:
        assert {r["along"] for r in csv.DictReader(file)} == {t.along for t in learnt.law.terms}
    cart = replace(learnt, law=replace(learnt.law, rig={"kind": "translational"}))
    assert {"force_n", "force_sd_n"} <= set(cart._table()[0]) <= {
        "position_m", "speed_m_s", "time_s", "force_n", "force_sd_n", "readings_nearby"
    }  # fmt: skip


@pytest.mark.slow
def test_none_is_offered_where_nothing_is_missing_or_no_torque_is(found):
    fit, place, _ = found
    bare = calibrate_nominal(measured(2))
    where = site_map(bare, torque=False)
    assert learn(bare, without_effects(bare), "none", where) is None
    # If the verdict calls a cause although there is none, what is learnt from noise closes nothing.
    assert learn(bare, without_effects(bare), "unknown", replace(where, probabilities={"interface": 1.0})) is None
    assert learn(fit, without_effects(fit), "unknown", replace(place, probabilities={"sensor": 1.0})) is None
    assert learn(fit, without_effects(fit), "spring_cubic", place) is None


@pytest.mark.slow
def test_a_law_stands_beside_the_effects_that_are_present(found):
    fit, place, _ = found
    member = (EFFECTS["quadratic_drag"], variant("quadratic_drag"))
    problem = SetProblem(fit.problem, [member], exact=False)
    both = calibrate(problem, [np.append(fit.q, 0.0)], eta=fit.eta, anneal=False)
    part = Part(member, 0.9, NO_SHARE, problem.parameters_of("quadratic_drag"))
    budget = Budget(set_fit([member], both), (part,), Closed(0.9, (0.7, 1.0), "repeats"), {"interface": 1.0}, {})
    learnt = learn(fit, budget, "quadratic_drag", place)
    assert learnt.law.beside == ("quadratic_drag",)
    assert learnt.of_the_rest.hdi90[0] > 0.8
    nothing_left = replace(budget, unexplained=Closed(0.02, (-0.1, 0.1), "repeats"))
    assert learn(fit, nothing_left, "quadratic_drag", place) is None


def test_a_law_that_closes_next_to_nothing_is_no_law():
    """Beside an effect that closes 98 % of the gap something may still be learnt, with certainty, and be of no use."""
    assert not worth_offering(Closed(0.003, (0.002, 0.004), "repeats"))
    assert not worth_offering(Closed(0.3, (-0.1, 0.7), "repeats"))
    assert not worth_offering(NO_SHARE)
    assert worth_offering(Closed(0.05, (0.03, 0.07), "repeats"))


def columns_of(true, noise=0.0, seed=0):
    """Columns of all terms as random responses, and their product with what the `true` terms make."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((len(TERMS) * ORDER, 4000))
    size = np.zeros(len(TERMS) * ORDER)
    for term, coefficients in true.items():
        k = TERMS.index(term) * ORDER
        size[k : k + len(coefficients)] = coefficients
    r = size @ columns + noise * rng.standard_normal(columns.shape[1])
    gram = columns @ columns.T
    return Projected(gram, columns @ r, np.diag(gram).copy(), np.zeros((3, len(size))))


def test_the_terms_that_made_the_gap_are_chosen_and_none_for_noise():
    chosen, gain = best_terms(columns_of({("dry", "angle"): (0.5, 0.3), ("speed", "angle"): (0.4,)}, 1.0), 1.0)
    assert {TERMS[c.term] for c in chosen} == {("dry", "angle"), ("speed", "angle")}
    assert gain > 300.0
    assert best_terms(columns_of({}, 1.0), 1.0) == ([], 0.0)


def test_time_comes_in_only_where_it_is_clearly_better():
    """A law of the angle and one of time that do the same: the one that says something of another release."""
    both = columns_of({("one", "angle"): (0.5, 0.3)}, 1.0)
    same = np.arange(len(TERMS) * ORDER)
    k, other = (TERMS.index(t) * ORDER for t in (("one", "angle"), ("one", "time")))
    same[other : other + ORDER] = np.arange(k, k + ORDER)
    twice = Projected(both.gram[np.ix_(same, same)], both.product[same], both.raw[same], both.absorbed)
    assert [TERMS[c.term] for c in best_terms(twice, 1.0)[0]] == [("one", "angle")]
    of_time = columns_of({("one", "time"): (0.5, 0.3)}, 1.0)
    assert TERMS[best_terms(of_time, 1.0)[0][0].term] == ("one", "time")


def test_coordinates_that_a_law_uses():
    zero = (0.0,) * ORDER
    assert used_coordinates((Term("dry", "angle", zero),)) == ["angle", "speed"]
    assert used_coordinates((Term("angle", "time", zero),)) == ["angle", "time"]
    assert used_coordinates((Term("one", "speed", zero),)) == ["speed"]


@pytest.mark.slow
def test_without_repeats_a_law_is_learnt_again_under_the_noise_that_it_leaves():
    """Dry friction and square drag on a pendulum, whose fit took them for damping and for noise."""
    trials = (swinging(1, 1.4, 24.0), swinging(2, 0.3, 6.0, heldout=True))
    experiment = Experiment(
        {"J1": (1.0, 0.0)}, ((64.0, 4.0),), trials, "displacement", restoring="pendulum", start="free",
        priors={"c1t": LogNormal(0.02, 6.0)},
    )  # fmt: skip
    fit = calibrate_nominal(experiment, nominal="linear")
    learnt = learn(fit, without_effects(fit), "unknown", site_map(fit, torque=False))
    assert learnt.law.site == "bearings"
    assert learnt.fit.problem.noise.innovation[0] < 0.3 * fit.problem.noise.innovation[0]
    assert learnt.closes.median > 0.2, "0.05 under the nominal fit's noise"
    left, before = (float(np.nanstd(f.residuals()[0])) for f in (learnt.fit, fit))
    assert left < 0.3 * before
