"""Sets of effects: fitted exactly, found together where each hides the other, weighed under what they leave."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_rig import measured, vane_on_a_pendulum, variant

from bayes_damper.calibration import (
    Experiment,
    Noise,
    Problem,
    TrialRecord,
    calibrate,
    calibrate_nominal,
    coordinate_of,
    summarise,
)
from bayes_damper.calibration.unlearnt import gained_over_sizes
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis import sets as sets_module
from bayes_damper.diagnosis.budget import _divided, answers_of, borne_out, budget_of, foreign_alone, idle_alone
from bayes_damper.diagnosis.formula import widened
from bayes_damper.diagnosis.response import motions
from bayes_damper.diagnosis.search import Candidate, generics_of, offered, search
from bayes_damper.diagnosis.sensitivity import sensitivity_of_sets
from bayes_damper.diagnosis.sets import (
    SetFit,
    SetProblem,
    _fitted,
    _grown,
    _without_one,
    better,
    columns_at,
    grown,
    log_prior,
    mended_alone,
    mends,
    probabilities,
    proposals,
    set_fit,
    sharpened,
    support,
    weighed,
)
from bayes_damper.diagnosis.shares import Closed, Products
from bayes_damper.diagnosis.verdict import Answers, Left, borne_by_sets
from bayes_damper.effects import EFFECTS
from bayes_damper.priors.distributions import LogNormal
from bayes_damper.simulation.composition import compose
from bayes_damper.simulation.model import Model


def member(effect, name=None):
    return EFFECTS[effect], variant(effect, name)


def swinging(number, amplitude, duration, heldout=False):
    """A pendulum with dry friction and square drag, from a start in motion; nothing viscous to speak of."""
    times = np.arange(0.0, duration, 0.02)
    both = compose(variant("bearing_drag"), variant("quadratic_drag"))
    model = Model(coupled=False, restoring="pendulum", longest_step=8e-3, effect=both)
    rig = {"J1": 1.0, "k1t": 64.0, "c1t": 0.004, "drag": 0.0, "nu": 100.0, "theta0": amplitude}
    values = {"first.drag": 0.15, "first.smoothing": 100.0, "second.coefficient": 0.004}
    y = model.simulate(rig, times, quantity="displacement", effect=values).y[0]
    # A law that no formula has: a slow error ten times the sensor's noise.
    y = (
        y
        + 3e-4 * np.sin(8.0 * times + 0.3 * times**1.5)
        + 2e-5 * np.random.default_rng(number).standard_normal(y.shape)
    )
    return TrialRecord(f"trial {number}", f"case {number}", False, 1, times, y, 0, heldout=heldout)


@pytest.fixture(scope="module")
def hidden():
    trials = (swinging(1, 1.4, 24.0), swinging(2, 0.3, 6.0, heldout=True))
    experiment = Experiment(
        {"J1": (1.0, 0.0)}, ((64.0, 4.0),), trials, "displacement", restoring="pendulum", start="free",
        priors={"c1t": LogNormal(0.02, 6.0)},
    )  # fmt: skip
    return calibrate_nominal(experiment, nominal="linear")


def pool_of(fit):
    names = {"bearing_drag", "quadratic_drag", "sensor_gain", "spring_cubic"}
    return [m for m in offered(fit.problem.experiment, "linear", EFFECTS) if m[0].name in names]


def test_two_effects_that_hide_each_other_are_screened_together(hidden):
    """Beside the viscous term each alone gains far less than both."""
    columns = columns_at(hidden, hidden, pool_of(hidden), ())
    one, two = (proposals(columns, (n,), 1)[0] for n in (1, 2))
    assert {columns.members[k][0].name for k in two.columns} == {"bearing_drag", "quadratic_drag"}
    assert two.explained > 1.3 * one.explained
    assert min(two.amplitudes) > 0.0


def test_a_descent_follows_terms_that_stand_for_each_other(hidden):
    """Drag goes up as the viscous damping goes down: a valley that is straight in their values, bent in coordinates."""
    members = (member("bearing_drag"), member("quadratic_drag"))
    sharper = replace(hidden.problem.noise, innovation=(2e-3,))
    problem = SetProblem(hidden.problem, members, exact=True).with_noise(sharper)
    values = (0.15, 100.0, 0.004)
    own = [
        coordinate_of(p.prior, x) for p, x in zip((p for _, v in members for p in v.parameters), values, strict=True)
    ]
    bent, straight = (
        calibrate(problem, [np.r_[hidden.q, own]], eta=hidden.eta, anneal=False, most=25, finish=False, straight=along)
        for along in (False, True)
    )
    assert straight.converged
    assert straight.cost < 40.0
    assert straight.cost < 0.6 * bent.cost  # the other one stops on the way
    assert straight.parameters["effect.0.drag"][0] > 1.5 * bent.parameters["effect.0.drag"][0]
    assert straight.parameters["c1t"][0] < hidden.parameters["c1t"][0]


def test_the_motion_of_a_set_is_the_one_that_its_effects_damp(hidden):
    problem = SetProblem(hidden.problem, (member("bearing_drag"), member("quadratic_drag")), exact=True)
    fit = summarise(problem, np.r_[hidden.q, 0.5, 0.0, 0.5], hidden.eta, True, 0, central=False)
    (motion,) = motions(fit)
    (record,) = fit.simulated().values()
    np.testing.assert_allclose(motion.th1[:, motion.at], record, atol=0.01 * np.abs(record).max())
    (bare,) = hidden.simulated().values()
    assert np.abs(bare - record).max() > 0.1 * np.abs(record).max()  # what it would be without them
    spread = np.sqrt(np.diag(widened(fit, ["bearings"]).covariance / fit.covariance))
    assert spread[problem.names.index("effect.0.drag")] > 1.1  # another formula of either effect changes its size


@pytest.mark.slow
def test_both_are_present_whatever_is_left(hidden):
    """What stays unexplained is ten times the noise, and does not speak against what is found."""
    pool = pool_of(hidden)
    sets = grown(hidden, [], pool)
    assert sets[0].names >= {"bearing_drag", "quadratic_drag"}
    weights = probabilities(sets, len({e.name for e, _ in pool}))
    for name in ("bearing_drag", "quadratic_drag"):
        assert sum(p for names, p in weights.items() if name in names) > 0.9
    values = sets[0].fit.parameters
    k = next(k for k, (e, _) in enumerate(sets[0].members) if e.name == "bearing_drag")
    assert 0.1 < values[f"effect.{k}.drag"][0] < 0.17
    assert values["c1t"][0] < 0.5 * hidden.parameters["c1t"][0], "what the viscous term had taken goes back"


def test_a_set_that_shares_a_kernel_is_the_composed_formula():
    base = Problem(measured(1, repeats=1))
    members = (member("inertia_error"), member("quadratic_drag"), member("sensor_gain"))
    problem = SetProblem(base, members, exact=True)
    assert [n for n in problem.names if n.startswith("effect.")] == [
        "effect.0.error", "effect.1.coefficient", *(f"effect.2.{p.name}" for p in members[2][1].parameters)
    ]  # fmt: skip
    q = np.zeros((1, problem.size))
    q[0, base.size :] = [0.7, -0.4, *([0.6] * (problem.size - base.size - 2))]
    group = next(g for g in base.groups if g.coupled)
    eta = np.zeros((1, len(group.nuisances)))
    once = problem.simulate(group, np.array([0]), q, eta)
    other = SetProblem(base, members[::-1], exact=True)
    turned = np.zeros((1, other.size))
    for i, name in enumerate(problem.names):
        if name.startswith("effect."):
            _, k, parameter = name.split(".")
            turned[0, other.names.index(f"effect.{2 - int(k)}.{parameter}")] = q[0, i]
    np.testing.assert_allclose(other.simulate(group, np.array([0]), turned, eta), once, rtol=1e-9, atol=1e-9)
    alone = np.zeros((1, base.size + 1))
    alone[0, -1] = -0.4
    drag = base.with_effect(members[1][1]).simulate(group, np.array([0]), alone, eta)
    assert np.abs(once - drag).max() > 1.0


@pytest.mark.parametrize("changed", [
    lambda p: p.changed(trials=p.trials[:1]), lambda p: p.for_trials(p.trials[:1]), lambda p: p.with_noise(p.noise),
    lambda p: p.reweighted({p.trials[0]: 0.5}),
])  # fmt: skip
def test_a_set_keeps_its_effects_whatever_else_is_changed(changed):
    problem = SetProblem(Problem(measured(1, repeats=1)), [member("inertia_error"), member("quadratic_drag")], True)
    assert changed(problem).names[-2:] == problem.names[-2:] == ("effect.0.error", "effect.1.coefficient")


def test_each_effect_is_left_out_of_the_best_set_from_where_that_lies():
    members = [member("inertia_error"), member("quadratic_drag"), member("sensor_gain")]
    problem = SetProblem(Problem(measured(1, repeats=1)), members, exact=True)
    q = np.arange(float(problem.size))
    smaller = _without_one(SetFit(problem.members, SimpleNamespace(problem=problem, q=q), 0.0, 0.0, 1.0))
    assert [[e.name for e, _ in members] for members, _ in smaller] == [
        ["quadratic_drag", "sensor_gain"], ["inertia_error", "sensor_gain"], ["inertia_error", "quadratic_drag"]
    ]  # fmt: skip
    n = problem.base.size
    np.testing.assert_array_equal(smaller[1][1], np.delete(q, n + 1))
    single = problem.base.with_effect(members[0][1])
    ((none, start),) = _without_one(SetFit(members[:1], SimpleNamespace(problem=single, q=q[: n + 1]), 0.0, 0.0, 1.0))
    assert none == ()
    np.testing.assert_array_equal(start, q[:n])
    assert _without_one(SetFit((), SimpleNamespace(problem=problem.base), 0.0, 0.0, 1.0)) == []


def test_a_set_that_explains_less_than_one_it_holds_is_fitted_from_there(monkeypatch):
    """No set explains less than a part of it: the descent ended in another valley."""
    problem = Problem(measured(1, repeats=1))
    sharp = problem.noise.__class__((0.5,) * 2, (0.0,) * 2, (0.0,) * 2)
    base = SetFit((), SimpleNamespace(problem=problem.with_noise(sharp), eta="of the base", misses=5.0), 0.0, 0.0, 1.0)
    nominal = Calibrated(problem, eta="of the nominal model")
    ends = {3: 9.0, 1: 4.0}  # by the number of starts
    fitted = []

    def fit(nominal, members, starts):
        fitted.append((nominal.eta, nominal.problem.noise.innovation, list(starts)))
        return SimpleNamespace(misses=ends[len(starts)])

    monkeypatch.setattr(sets_module, "_fitted", fit)
    monkeypatch.setattr(sets_module, "squares_of", lambda _, fit: fit.misses)
    assert _grown(nominal, base, (), [1, 2, 3, 4]).misses == 4.0
    assert fitted[1] == ("of the base", (0.5, 0.5), [4])
    ends[1] = 11.0
    assert _grown(nominal, base, (), [1, 2, 3, 4]).misses == 9.0
    ends[3] = 3.0
    assert _grown(nominal, base, (), [1, 2, 3, 4]).misses == 3.0
    assert len(fitted) == 5, "what explains more than the base is not fitted again"


def test_single_effects_under_another_noise_are_not_weighed_beside_the_others():
    """One far behind the leader keeps the noise of before, by which it would explain a thousand nats."""
    nominal = calibrate(Problem(measured(1, duration=0.1, configurations=(False,))), most=4, anneal=False)
    loud = Noise((50.0,) * 2, (0.0,) * 2, (0.0,) * 2)
    found = []
    for name, noise in (("spring_cubic", nominal.problem.noise), ("quadratic_drag", loud)):
        effect, formula = member(name)
        problem = nominal.problem.with_noise(noise).with_effect(formula)
        fit = calibrate(problem, [np.append(nominal.q, 0.1)], eta=nominal.eta, anneal=False, most=4)
        found.append(Candidate(effect, formula, (), fit, 1.0))
    assert {s.names for s in grown(nominal, found, [])} == {frozenset(), frozenset({"spring_cubic"})}


@dataclass(frozen=True)
class Calibrated:
    problem: Problem
    eta: str


def stub(names, plain, squares, pieces=40.0, formulas=1):
    members = tuple((SimpleNamespace(name=n, variants=(None,) * formulas), SimpleNamespace(name=n)) for n in names)
    fit = SimpleNamespace(problem=SimpleNamespace(coordinates=()), q=())
    return SetFit(members, fit, plain, squares, pieces)


def test_what_all_sets_leave_sets_the_scale_of_evidence():
    """A tenth less of a large remainder is worth what as many independent pieces of it are, not its chi-square."""
    clean = weighed([stub((), -500.0, 0.0), stub(("a",), 0.0, 0.0)])
    assert clean[0].evidence == pytest.approx(500.0)
    rough = weighed([stub((), 0.0, 1e6), stub(("a",), 0.0, 0.9e6)])
    assert rough[0].evidence == pytest.approx(20.0 * math.log(1.0 / 0.9), rel=1e-3)


def test_what_is_called_noise_of_the_sensors_says_nothing_for_a_set():
    """The same residuals, white with the tails of Student's t: judged over the noise that their middle shows, and over
    all of their variance. To call them noise explains nothing."""
    times = np.arange(0.0, 1.0, 0.002)
    w, g = math.sqrt(600.0), 0.5
    # x'' + 2 g x' + (w^2 + g^2) x = 0
    y = 0.02 * np.exp(-g * times) * (np.cos(w * times) + g / w * np.sin(w * times))
    error = np.random.default_rng(5).standard_t(3.0, times.size)
    trial = TrialRecord("1", "", False, 1, times, (y + 2e-5 * error)[None], 0, 0.02, 1e-5)
    experiment = Experiment({"J1": (1.0, 0.0)}, ((w**2 + g**2, 2.0),), (trial,), "displacement")
    total = 2e-5 * float(error.std())
    zero = (0.0,)
    narrow = Noise((total,), zero, zero, sensor=(0.8 * total,))
    fit = calibrate(Problem(experiment, nominal="linear", noise=narrow), anneal=False)
    wide = Noise((total,), zero, zero, sensor=(total,))
    same = summarise(fit.problem.with_noise(wide), fit.q, fit.eta, True, 0)
    assert same.chi2 == pytest.approx(times.size, rel=0.05)
    for first, second in ((fit, same), (same, fit)):
        found = weighed([set_fit((), first), set_fit((member("spring_cubic"),), second)])
        assert all(s.evidence == pytest.approx(0.0, abs=1e-6) for s in found)
    drag = member("quadratic_drag")
    assert not better(set_fit((drag,), same), set_fit((drag,), fit), 100.0)


@pytest.mark.slow
def test_a_set_leaves_what_it_does_with_the_sizes_of_scatter_that_it_makes_likely():
    """A drift of the bearings' law stands for a vane's drag if each release has its own damping, four times the usual.

    Most of its evidence was of such sizes, and what it left that of the usual ones: on one rig it had 120 nats where
    the vane, which leaves less than half as much, had 79.
    """
    experiment = vane_on_a_pendulum()
    nominal = calibrate_nominal(experiment)
    found = search(nominal, generics_of(experiment))
    usual = found[0].fit.problem.switches.scatter.sd("c1t")
    drift = next(s for s in grown(nominal, found, []) if s.members)
    assert drift.fit.problem.switches.scatter.sd("c1t") > 1.5 * usual
    assert gained_over_sizes(drift.fit.problem, drift.fit.linear.normal()) < 3.0


def test_of_two_fits_of_a_set_the_one_that_leaves_less_is_kept():
    """The sharper noise of a better fit narrows its posterior, which lowers the plain evidence."""
    stalled, ended = stub(("a", "b"), -46.4, 3.3e7), stub(("a", "b"), -47.9, 2.3e7)
    assert better(ended, stalled, 36.0)
    assert not better(stalled, ended, 36.0)
    assert better(stub(("a",), -46.4, 0.0), stub(("a",), -47.9, 0.0), 36.0)


def test_an_effect_that_gains_nothing_costs_its_prior():
    sets = weighed([stub((), 0.0, 0.0), stub(("a",), 30.0, 0.0), stub(("a", "b"), 30.0, 0.0)])
    weights = probabilities(sets, 20)
    assert weights[frozenset("a")] == pytest.approx(0.95, abs=0.01)
    assert log_prior(("a", "b"), 20) == pytest.approx(2.0 * math.log(1.0 / 19.0))
    assert log_prior(("bearing_drag", "interface_friction"), 20) == pytest.approx(math.log(1.0 / 19.0))


def test_formulas_share_the_prior_of_their_effect():
    """Chance takes up more of the noise by one of five formulas than by one alone."""
    sets = [stub((), 0.0, 0.0), stub(("a",), 3.0, 0.0), *(stub(("b",), 3.0, 0.0, formulas=5) for _ in range(4))]
    weights = probabilities(weighed(sets), 20)
    assert weights[frozenset("b")] == pytest.approx(0.8 * weights[frozenset("a")])


def test_an_effect_is_borne_by_the_sets_that_hold_it_against_several_others_and_a_drift():
    """Other single effects are no reason against it, since they are weighed as answers of their own."""
    sets = {(): 0.02, ("a",): 0.1, ("b",): 0.38, ("b", "c"): 0.3, ("unknown",): 0.2}
    held = support({frozenset(names): p for names, p in sets.items()})
    assert held == pytest.approx({"a": 0.1 / 0.6, "b": 0.68 / 0.88, "c": 0.3 / 0.5})
    assert support({frozenset(): 0.9, frozenset("a"): 0.1}) == {"a": 1.0}


def test_what_a_set_without_the_effect_explains_better_is_unknown():
    before = Answers({"none": 0.1, "unknown": 0.1, "a": 0.7, "b": 0.05, "c": 0.05}, 1.0, Left(0.0, 0.0), 0.1)
    after = borne_by_sets(before, {"a": 0.01, "b": 1.0}).probabilities
    assert after == pytest.approx({"none": 0.1, "unknown": 0.793, "a": 0.007, "b": 0.05, "c": 0.05})
    assert borne_by_sets(before, {"a": 1.0}) == before
    none = borne_by_sets(before, {"a": 0.0}).probabilities["a"]
    assert none > 0.0  # as no answer ever is
    paired = replace(before, pair=0.6, pair_effects=("a", "b"))
    assert borne_by_sets(paired, {"a": 0.5, "b": 0.9}).pair == pytest.approx(0.3)


def test_a_second_effect_that_mends_the_first_ones_formula_is_none():
    """What a Stribeck curve leaves of bristles is a few per cent of what it explains, and another law takes it up."""
    assert mends(100.0, 4000.0, exact=False)
    assert not mends(300.0, 4000.0, exact=False)
    assert not mends(100.0, 4000.0, exact=True)
    assert not mends(100.0, 4000.0, exact=False, home=0.0)
    assert mends(math.nan, 4000.0, exact=False)


@pytest.mark.parametrize(
    ("left", "mended"),
    [
        ({"": 100.0, "a": 2.2, "b": 99.0, "ab": 0.3}, True),  # "b" takes up what the formula of "a" is off by
        ({"": 100.0, "a": 30.0, "b": 99.0, "ab": 5.0}, False),
        ({"": 100.0, "a": 99.0, "b": 99.0, "ab": 24.0}, False),  # they hide each other
    ],
)
def test_without_repeats_a_second_effect_has_to_explain_more_than_a_formula_is_off_by(left, mended):
    """A clean sensor shows to the last digit that friction is no tanh: scale and lag of the sensor had .99 for that."""
    known = [SimpleNamespace(members=tuple(names), names=frozenset(names), fit=names) for names in ("", "a", "b")]
    assert mended_alone(left.__getitem__, known, known, "ab") is mended


def test_shares_of_effects_that_hide_each_other_sum_to_one():
    """Neither closes anything alone, both together 80 %: each gets half of it."""
    place = {frozenset[str](): 0, frozenset("a"): 1, frozenset("b"): 2, frozenset("ab"): 3}
    left = np.array([1.0, 1.0, 1.0, 0.2])
    draws = np.tile(left, (50, 1))
    shares, beyond, unexplained, leading = _divided(
        ["a", "b"], place, left, draws, left / 0.8, Products(left[:, None], draws, "repeats")
    )
    assert shares["a"].median == pytest.approx(0.4)
    assert sum(s.median for s in shares.values()) + unexplained.median == pytest.approx(1.0)
    assert sum(leading.values()) == pytest.approx(1.0)
    assert beyond["a"] == pytest.approx((0.8, 0.0, 1.0), abs=1e-12)


def test_a_small_effect_that_is_bent_to_do_the_work_of_a_large_one_stands_beside_it():
    """Alone it makes the gap larger where it was not fitted; beside the large one it closes all that is left."""
    place = {frozenset[str](): 0, frozenset("a"): 1, frozenset("b"): 2, frozenset("ab"): 3}
    left = np.array([1.0, 0.02, 2.5, 0.0])
    draws = left + 0.001 * np.random.default_rng(1).standard_normal((200, 4))
    draws[:, 0] = 1.0
    fitted = np.array([1.0, 0.02, 0.6, 0.0])
    shares, beyond, *_ = _divided(["a", "b"], place, left, draws, fitted, Products(left[:, None], draws, "repeats"))
    assert shares["a"].median == pytest.approx(0.99)
    assert shares["b"].median == pytest.approx(0.01)
    share, error, reach = beyond["b"]
    assert (share, reach) == pytest.approx((0.02, 0.04))
    assert borne_out(share, error, 0.9, reach) == pytest.approx(0.9, abs=0.01)


def test_held_out_trials_take_away_what_closes_nothing_there_and_add_nothing():
    """A clear share leaves an effect as it was; one of nothing, or a negative one, does not."""
    assert borne_out(0.7, 0.05, 0.95) == 0.95
    assert borne_out(0.02, 0.005, 0.95) == 0.95
    assert borne_out(1.2, 0.01, 0.96) == 0.96
    assert 0.85 < borne_out(0.2, 0.2, 0.95) <= 0.95
    assert borne_out(0.0, 0.02, 0.83) < 0.4
    assert borne_out(0.0, 0.001, 0.98) < 0.2
    assert borne_out(-0.1, 0.03, 0.83) < 0.02
    assert borne_out(-9.0, 0.01, 0.96) < 1e-6


def test_a_small_effect_is_kept_where_held_out_trials_show_as_much_as_one_of_its_size_can():
    """0.012 +- 0.009 of the gap is little beside 1, and just what an effect with 0.015 where it was fitted gives."""
    assert borne_out(0.012, 0.009, 0.88) < 0.5
    assert borne_out(0.012, 0.009, 0.88, 0.03) == pytest.approx(0.88, abs=0.01)
    assert borne_out(0.0, 0.005, 0.88, 0.03) < 0.85
    assert borne_out(0.0, 0.001, 0.88, 0.03) < 0.5
    assert borne_out(-0.02, 0.009, 0.88, 0.03) < 0.4
    assert borne_out(0.6, 0.01, 0.88, 0.03) == pytest.approx(0.88, abs=0.01)
    for share in (-0.01, 0.0, 0.01):
        assert borne_out(share, 0.5, 0.88, 0.03) == pytest.approx(0.88, abs=0.02)


def test_an_effect_that_makes_the_gap_much_larger_is_not_kept_for_the_size_of_its_error():
    """Residuals 300 times as large: the share is -1e5 with an error as large, and it closes nothing."""
    rng = np.random.default_rng(4)
    values = np.array([rng.uniform(0.5, 1.5, 6), 1e5 * rng.lognormal(0.0, 1.5, 6)])
    picked = rng.multinomial(6, np.full(6, 1 / 6), 2000)
    found = Products(values, picked @ values.T, "neighbours")
    fitted = np.array([1.0, 0.0])
    shares, beyond, *_ = _divided(["a"], {frozenset(): 0, frozenset("a"): 1}, *found.shares(), fitted, found)
    assert shares["a"].median < -1e4
    assert np.std(found.shares()[1][:, 1]) > 1e4
    share, error, _ = beyond["a"]
    assert borne_out(share, error, 0.99) < 1e-6


def test_the_next_best_set_is_judged_where_one_fails(monkeypatch):
    """Not a smaller one alone: another set may explain the same, or fail as well."""
    told = {"a": (-1.0, 0.01), "b": (0.9, 0.02), "c": (-0.5, 0.01)}

    def shares(nominal, best, sets, heldout, rng):
        of = {n: Closed(told[n][0], (0.0, 1.0), "repeats") for n in best.names}
        return of, {n: (*told[n], 1.0) for n in best.names}, Closed(0.2, (0.1, 0.3), "repeats"), {}

    monkeypatch.setattr("bayes_damper.diagnosis.budget._shares", shares)
    monkeypatch.setattr("bayes_damper.diagnosis.budget._coordinates", lambda best, effect: {})
    nominal = SimpleNamespace(problem=SimpleNamespace(experiment=SimpleNamespace(heldout=(1,))))
    known = {(): -60.0, ("a",): 0.0, ("c",): -5.0, ("b",): -20.0, ("a", "b"): -4.0}
    sets = weighed([stub(names, plain, 0.0) for names, plain in known.items()])
    budget = budget_of(nominal, sets, 20, dict.fromkeys((s.names for s in sets), 0.02))
    assert [part.name for part in budget.absent] == ["a", "c"]
    assert [part.name for part in budget.parts] == ["b"]
    assert budget.best.names == {"b"}


@pytest.mark.parametrize("first", [(), ("unknown",)])
def test_where_the_gap_shows_the_best_named_set_divides_it(monkeypatch, first):
    """Although no name is likelier than an unknown cause."""

    def shares(nominal, best, sets, heldout, rng):
        of = {n: Closed(0.87, (0.8, 0.9), "neighbours") for n in best.names}
        return of, dict.fromkeys(best.names, (0.87, 0.02, 1.0)), Closed(0.13, (0.1, 0.2), "neighbours"), {}

    monkeypatch.setattr("bayes_damper.diagnosis.budget._shares", shares)
    monkeypatch.setattr("bayes_damper.diagnosis.budget._coordinates", lambda best, effect: {})
    nominal = SimpleNamespace(problem=SimpleNamespace(experiment=SimpleNamespace(heldout=(1,))))
    known = {(): -8.0, ("a",): -1.0, ("b",): -1.2, ("c",): -30.0} | {first: 0.0}
    sets = weighed([stub(names, plain, 0.0) for names, plain in known.items()])
    foreign = dict.fromkeys((s.names for s in sets), 0.02)
    assert not budget_of(nominal, sets, 20, foreign).parts
    (part,) = budget_of(nominal, sets, 20, foreign, shows=True).parts
    assert part.name == "a"
    assert part.present < 0.5
    assert part.share.median == 0.87


def test_an_effect_that_closes_nothing_on_held_out_trials_leaves_the_budget(monkeypatch):
    told = {"a": (0.8, 0.02), "b": (-0.1, 0.03)}

    def shares(nominal, best, sets, heldout, rng):
        of = {n: Closed(told[n][0], (told[n][0] - 0.1, told[n][0] + 0.1), "repeats") for n in best.names}
        return of, {n: (*told[n], 1.0) for n in best.names}, Closed(0.2, (0.1, 0.3), "repeats"), {}

    monkeypatch.setattr("bayes_damper.diagnosis.budget._shares", shares)
    monkeypatch.setattr("bayes_damper.diagnosis.budget._coordinates", lambda best, effect: {})
    nominal = SimpleNamespace(problem=SimpleNamespace(experiment=SimpleNamespace(heldout=(1,))))
    known = {(): -60.0, ("a",): -10.0, ("b",): -70.0, ("a", "b"): 0.0}
    sets = weighed([stub(names, plain, 0.0) for names, plain in known.items()])
    foreign = dict.fromkeys((s.names for s in sets), 0.02)
    budget = budget_of(nominal, sets, 20, foreign)
    assert [part.name for part in budget.parts] == ["a"]
    assert [part.name for part in budget.absent] == ["b"]
    assert budget.best.names == {"a"}
    assert budget.parts[0].present == pytest.approx(0.98, abs=1e-3)
    assert budget.absent[0].present < 0.1
    told["b"] = (0.05, 0.01)
    assert {part.name for part in budget_of(nominal, sets, 20, foreign).parts} == {"a", "b"}
    told["a"] = (0.0, 0.001)
    assert not {part.name for part in budget_of(nominal, sets, 20, foreign).parts} & {"a"}


def test_the_answer_is_what_has_the_largest_share():
    sets = weighed([stub((), -50.0, 0.0), stub(("a",), 0.0, 0.0)])
    best = sets[0]
    quiet = Left(0.0, 0.0, lone=True)

    def verdict(leading, left=0.1, none=quiet):
        budget = SimpleNamespace(best=best, parts=(), leading=leading)
        return answers_of(budget, sets, ["a", "b"], {}, {best.names: left}, none, quiet)

    assert verdict({"a": 1.0}).verdict == "a"
    assert verdict({"a": 1.0}).probabilities["a"] > 0.9
    assert verdict({"a": 0.2, "unknown": 0.8}).verdict == "unknown"
    loud = Left(40.0, 1.0, lone=True)
    assert verdict({"a": 1.0}, 0.95).verdict == "none", "it closes next to nothing, and noise accounts for the rest"
    assert verdict({"a": 1.0}, 0.95, loud).verdict == "unknown", "noise does not account for the rest"
    assert idle_alone(0.95, quiet) > 0.8
    assert max(idle_alone(0.95, loud), idle_alone(0.1, quiet)) < 0.01
    assert foreign_alone(0.05) < foreign_alone(0.5) < foreign_alone(1.0) == pytest.approx(0.15 / 0.7)


def test_a_larger_set_speaks_for_the_effect_that_has_more_evidence_alone():
    """The budget's set of one is likelier a priori, and the larger ones with a little more evidence agree with it."""
    known = {(): -50.0, ("a",): 0.0, ("b",): -40.0, ("a", "b"): 2.0}
    sets = weighed([stub(names, plain, 0.0) for names, plain in known.items()])
    budget = SimpleNamespace(best=sets[1], parts=(), leading={"a": 1.0})
    quiet = Left(0.0, 0.0, lone=True)
    shares = {s.names: 0.05 for s in sets}
    for evidence, verdict in (({"a": 50.0, "b": 10.0}, "a"), ({"a": 10.0, "b": 50.0}, "b")):
        only = [s for s in sets if len(s.members) != 1]  # as where few sets are weighed again
        assert answers_of(budget, only, ["a", "b"], evidence, shares, quiet, quiet).verdict == verdict


def test_other_choices_weigh_the_most_probable_sets_again_and_all_where_none_is_fitted_again(monkeypatch):
    """Not those of most evidence: sets of three have some more of it, and are less likely a priori. Where nothing
    changes the answer is the same to the last digit."""
    many = [("a", "b"), ("a", "c"), ("b", "c"), ("a", "b", "c"), ("a", "b", "d")]
    known = {(): -50.0, ("a",): 0.0} | dict.fromkeys(many, 1.0)
    sets = weighed([stub(names, plain, 0.0) for names, plain in known.items()])
    monkeypatch.setattr(
        "bayes_damper.diagnosis.sensitivity.Quadratic.of", lambda fit: SimpleNamespace(log_evidence=lambda **how: 0.0)
    )
    others = [("nothing", (), 1.0), ("without trial 1", [0], 1.0)]
    monkeypatch.setattr("bayes_damper.diagnosis.sensitivity._other_choices", lambda nominal, most: others)
    monkeypatch.setattr("bayes_damper.diagnosis.sensitivity._again", lambda fit, without, straight: fit)
    asked = []

    def fitted_again(members, fit):
        asked.append({e.name for e, _ in members})
        return next(s for s in sets if s.members is members)

    monkeypatch.setattr("bayes_damper.diagnosis.sensitivity.set_fit", fitted_again)
    budget = SimpleNamespace(best=next(s for s in sets if s.names == {"a"}), parts=(), leading={"a": 1.0})
    quiet = Left(0.0, 0.0, lone=True)

    def answered(sets):
        shares = {s.names: 0.05 for s in sets}
        return answers_of(budget, sets, ["a", "b", "c", "d"], {"a": 50.0}, shares, quiet, quiet)

    nothing, choice = sensitivity_of_sets(None, sets, answered, "a", 20)
    assert nothing.of_leading == answered(sets).probabilities["a"]
    assert choice.verdict == "a"
    assert choice.of_leading == pytest.approx(answered(sets).probabilities["a"], abs=0.05)
    assert asked == [{"a"}, {"a", "b"}, {"a", "c"}, {"b", "c"}, set()]


@pytest.mark.slow
def test_without_repeats_each_choice_weighs_the_sets_again():
    """Fits under noise of their own are not left out: without a trial the named effects stay, on what is left."""
    trials = (swinging(1, 1.4, 24.0), swinging(3, 1.2, 24.0), swinging(2, 0.3, 6.0, heldout=True))
    experiment = Experiment(
        {"J1": (1.0, 0.0)}, ((64.0, 4.0),), trials, "displacement", restoring="pendulum", start="free",
        priors={"c1t": LogNormal(0.02, 6.0)},
    )  # fmt: skip
    nominal = calibrate_nominal(experiment, nominal="linear")
    members = (member("bearing_drag"), member("quadratic_drag"))
    problem = SetProblem(nominal.problem, members, exact=True)
    values = (0.15, 100.0, 0.004)
    own = [
        coordinate_of(p.prior, x) for p, x in zip((p for _, v in members for p in v.parameters), values, strict=True)
    ]
    fit = sharpened(calibrate(problem, [np.r_[nominal.q, own]], eta=nominal.eta, anneal=False, straight=True))
    assert fit.problem.noise != nominal.problem.noise
    sets = weighed([set_fit((), nominal), set_fit(members, fit)])
    parts = [SimpleNamespace(name=e.name) for e, _ in members]
    budget = SimpleNamespace(best=sets[0], parts=parts, leading={"bearing_drag": 1.0})
    quiet = Left(0.0, 0.0, lone=True)
    asked = []

    def answered(sets):
        asked.append({s.fit.problem.trials for s in sets})
        return answers_of(budget, sets, ["bearing_drag", "quadratic_drag"], {}, {sets[0].names: 0.02}, quiet, quiet)

    choices = sensitivity_of_sets(nominal, sets, answered, "bearing_drag", 2)
    assert [c.what for c in choices] == [
        "prior widths halved", "prior widths doubled", "without case case 1", "without case case 3"
    ]  # fmt: skip
    assert asked[:2] == [{(0, 1)}] * 2
    assert asked[2:] == [{(1,)}, {(0,)}]
    assert all(c.verdict == "bearing_drag" and c.of_leading > 0.9 for c in choices)


def test_common_parameters_are_known_by_a_noise_as_a_fit_under_it_knows_them(hidden):
    """Against the Laplace evidence of the same point linearised under that noise; effects keep what they add."""
    noise = hidden.problem.noise
    finer = replace(noise, innovation=tuple(0.1 * x for x in noise.innovation))
    alone = set_fit((), hidden)
    under = summarise(hidden.problem.with_noise(finer), hidden.q, hidden.eta, True, 0)
    informed = -(under.log_evidence + 0.5 * under.cost) + hidden.log_evidence + 0.5 * hidden.cost
    assert alone.known_by(np.array(finer.innovation)) - alone.known_by(alone.noise) == pytest.approx(informed, rel=1e-4)
    problem = SetProblem(hidden.problem, (member("quadratic_drag"),), True)
    q = np.concatenate([hidden.q, [-5.0]])  # next to none of it
    with_drag = set_fit(problem.members, summarise(problem, q, hidden.eta, True, 0))
    assert with_drag.known_by(alone.noise) == pytest.approx(alone.known_by(alone.noise), rel=1e-3)


def test_a_single_effect_left_of_a_pair_is_fitted_as_single_effects_are(hidden):
    """Under the names that its row of the result asks for."""
    drag = member("quadratic_drag")
    start = np.concatenate([hidden.q, [-2.0]])
    found = _fitted(hidden, (drag,), [start])
    assert [n for n in found.problem.names if n.startswith("effect")] == [
        f"effect.{p.name}" for p in drag[1].parameters
    ]


def cart(number, release, heldout=False):
    """A cart on a spring that hardens, with dry friction, by scipy: displacement, m, to 0.02 mm."""

    def rate(_, x):
        return x[1], (-620.0 * x[0] - 6e4 * x[0] ** 3 - 1.1 * x[1] - 0.15 * np.tanh(x[1] / 0.003)) / 1.8

    times = np.arange(0.0, 3.0, 0.005)
    y = solve_ivp(rate, (0.0, 3.0), (release, 0.0), "LSODA", times, rtol=1e-9, atol=1e-11).y[0]
    y = y + 2e-5 * np.random.default_rng(number).standard_normal(y.size)
    return TrialRecord(f"{number}.csv", f"from {release}", False, 1, times, y[None], 0, release, 2e-4, heldout=heldout)


@pytest.mark.slow
def test_a_spring_that_hardens_is_named_from_two_single_trials():
    """It leaves nothing but the sensor's noise; that its parameters are known the better for it must not count against
    it beside a nominal model that misses the records by half of their size."""
    trials = (cart(1, 0.03), cart(2, 0.012), cart(3, 0.02, heldout=True))
    experiment = Experiment({"J1": (1.8, 0.002)}, ((620.0, 12.0),), trials, "displacement")
    near = {name: e for name, e in EFFECTS.items() if e.site in ("ground1", "bearings")}  # its rivals
    found = diagnose(experiment, effects=near)
    assert found.verdict == "spring_cubic"
    assert found.answers.probabilities["spring_cubic"] > 0.9
    noise = found.to_json()["noise"]
    assert noise["sd"] == pytest.approx([found.gap.noise_rms])
    assert noise["level"][0] > 10.0 * noise["sd"][0], "it stands for what the model misses, too"
    assert found.budget is not None
    assert found.budget.parts[0].share.median > 0.99
