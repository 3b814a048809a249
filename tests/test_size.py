"""Memory grows with the size of a campaign, not with its square, nor with the points and shapes asked for at once."""

from __future__ import annotations

import tomllib
import tracemalloc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from campaigns import CAMPAIGN_TOML
from small_rig import measured

from bayes_damper.calibration import Problem, calibrate, derivatives, forecast, normal_equations, posterior, problem
from bayes_damper.campaign import Constant, Trial, head_from_table
from bayes_damper.campaign.plausibility import look_at_repeats
from bayes_damper.diagnosis import response, search, sets, sites, where
from bayes_damper.diagnosis.search import Candidate, Screen, offered
from bayes_damper.effects import EFFECTS


@pytest.fixture(scope="module")
def fit():
    return calibrate(Problem(measured(repeats=3, duration=0.15)), anneal=False)


def test_repeats_are_compared_with_memory_in_proportion_to_their_number():
    head = head_from_table(tomllib.loads(CAMPAIGN_TOML), "campaign.toml", [])
    times = np.arange(1000) / 1000.0
    rng = np.random.default_rng(1)
    k1t, theta0 = Constant(10.2), Constant(0.08)
    records = [np.cos(60.0 * times)[None] + 0.01 * rng.standard_normal((1, 1000)) for _ in range(100)]
    trials = [Trial(f"{k}.csv", "I", "uncoupled", k, k1t, theta0, times, y) for k, y in enumerate(records)]
    warnings: list[str] = []
    tracemalloc.start()
    look_at_repeats(head, trials, warnings)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 8 * sum(y.nbytes for y in records)  # all pairs of repeats at once: 100 times
    assert not warnings


def test_points_of_a_posterior_are_evaluated_in_turns_with_the_same_results(fit, monkeypatch):
    target = posterior.RecordPosterior(fit)
    points = target.start + 0.1 * np.random.default_rng(1).standard_normal((64, target.ndim))
    at_once = target.log_likelihood(points)
    monkeypatch.setattr(posterior, "READINGS_AT_ONCE", 6000)
    sizes = recorded(monkeypatch, Problem, "simulate")
    assert np.array_equal(target.log_likelihood(points), at_once)
    assert max(sizes) <= 6000 < 0.5 * at_once.size / 8 * 300


def test_matrices_of_what_each_trial_has_for_itself_are_held_in_turns_with_the_same_draws(fit, monkeypatch):
    target = posterior.RecordPosterior(fit)
    points = target.start + 0.1 * np.random.default_rng(1).standard_normal((64, target.ndim))
    value, drawn = target.evaluated(points, np.random.default_rng(2))
    monkeypatch.setattr(posterior, "READINGS_AT_ONCE", 6000)
    held = []
    original = target._evaluated

    def noted(*args):
        found = original(*args)
        held.append(weakref.ref(found[2]))
        return found

    monkeypatch.setattr(target, "_evaluated", noted)
    most = 0
    monkeypatch.setattr(np.linalg, "cholesky", lambda A, of=np.linalg.cholesky: counted(A) and of(A))

    def counted(A):
        nonlocal most
        most = max(most, sum(x() is not None for x in held))
        return True

    again, drawn_again = target.evaluated(points, np.random.default_rng(2))
    assert np.array_equal(again, value)
    assert all(np.array_equal(drawn_again[i], d) for i, d in drawn.items())
    assert len(held) > 10
    assert most == 1


def test_candidates_are_compared_in_turns_with_the_same_results(fit, monkeypatch):
    q = fit.q + 0.1 * np.random.default_rng(1).standard_normal((40, fit.problem.size))
    own = {i: np.tile(v, (40, 1)) for i, v in fit.eta.items()}
    at_once = fit.problem.costs(q, own)
    monkeypatch.setattr(problem, "READINGS_AT_ONCE", 3000)
    sizes = recorded(monkeypatch, Problem, "simulate")
    assert np.array_equal(fit.problem.costs(q, own), at_once)
    assert max(sizes) <= 3000


def recorded(monkeypatch, owner, name):
    """Sizes of the arrays that a function returns from now on."""
    sizes: list[int] = []
    original = getattr(owner, name)

    def noted(*args, **kwargs):
        found = original(*args, **kwargs)
        sizes.append(found.size)
        return found

    monkeypatch.setattr(owner, name, noted)
    return sizes


def test_a_site_map_takes_the_trials_slice_by_slice(fit, monkeypatch):
    whole = sites.site_map(fit)
    monkeypatch.setattr(response, "SLICE", 300)
    sizes = recorded(monkeypatch, sites, "_columns")
    sliced = sites.site_map(fit)
    assert len(sizes) == 6  # two uncoupled trials of 150 readings at a time, coupled ones one by one
    assert len(set(sizes)) == 1
    for site, value in whole.log_evidence.items():
        assert sliced.log_evidence[site] == pytest.approx(value, abs=1e-6)
    assert sliced.leaders[sliced.best].columns.tolist() == whole.leaders[whole.best].columns.tolist()


def test_a_site_map_is_the_same_with_however_many_trials_at_once(fit, monkeypatch):
    found = []
    for readings in (1_000_000, 300):
        monkeypatch.setattr(response, "AT_ONCE", readings)
        with monkeypatch.context() as noted:
            sizes = recorded(noted, sites, "_columns")
            found.append((sites.site_map(fit), len(sizes)))
    (whole, few), (turns, many) = found
    assert many > few
    for site, value in whole.log_evidence.items():
        assert turns.log_evidence[site] == pytest.approx(value, rel=1e-9)
    for a, b in zip(whole.torque, turns.torque, strict=True):
        assert a.trial == b.trial
        np.testing.assert_allclose(b.torque, a.torque, rtol=0.0, atol=1e-7 * np.abs(a.torque).max())


def test_responses_to_every_formula_are_held_for_a_few_trials_at_a_time(fit, monkeypatch):
    pool = offered(fit.problem.experiment, "nonlinear", {n: EFFECTS[n] for n in ("spring_cubic", "stiffness_error")})
    whole = sets.columns_at(fit, fit, pool, ())
    monkeypatch.setattr(sets, "AT_ONCE", 300)
    sizes = recorded(monkeypatch, Screen, "response")
    sliced = sets.columns_at(fit, fit, pool, ())
    assert max(sizes) <= 300 * max(len(variant.starts) for _, variant in pool)
    assert (sliced.members, sliced.signed) == (whole.members, whole.signed)
    np.testing.assert_allclose(sliced.points, whole.points, rtol=1e-9)
    for name in ("gram", "product", "absorbed"):
        a, b = getattr(sliced, name), getattr(whole, name)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(b).max())


def test_a_slice_of_the_trials_lies_in_the_array_of_all(fit):
    for block in fit.linear.sliced(300).blocks:
        assert np.shares_memory(block.full, block.J)
        assert np.array_equal(block.full, np.concatenate([block.J, block.T, block.r[:, None, :]], axis=1))


def test_short_torques_are_tried_in_turns_with_the_same_results(fit, monkeypatch):
    moved = response.motions(fit)
    instants = np.linspace(0.01, 0.1, 7)
    at_once = where._pulses(fit, moved, "interface", instants, np.full(7, 0.01))
    monkeypatch.setattr(where, "AT_ONCE", 2 * max(m.y.size for m in moved))
    sizes = recorded(monkeypatch, where, "whiten")
    in_turns = where._pulses(fit, moved, "interface", instants, np.full(7, 0.01))
    assert max(sizes) <= where.AT_ONCE
    for a, b in zip(at_once, in_turns, strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-9)


def test_what_is_held_of_linearised_problems_is_limited_and_made_again_the_same(fit, monkeypatch):
    many = [fit.problem.linearise(fit.q, fit.eta) for _ in range(6)]
    kept = many[0].blocks
    monkeypatch.setattr(normal_equations, "MOST_BYTES", 3 * many[0].given.nbytes)
    assert [linear.given.nbytes > 0 for linear in many if linear.blocks] == [True] * 6
    assert [linear.given.nbytes > 0 for linear in many] == [False] * 3 + [True] * 3
    for a, b in zip(kept, many[0].blocks, strict=True):
        assert all(np.array_equal(x, y) for x, y in ((a.J, b.J), (a.T, b.T), (a.r, b.r)))


def test_motions_take_the_room_of_what_can_be_made_again(fit, monkeypatch):
    many = [fit.problem.linearise(fit.q, fit.eta) for _ in range(4)]
    for linear in many:
        assert linear.blocks
    size = many[0].given.nbytes
    moved = response.motions(replace(fit, linear=many[3]))
    assert all(linear.given.nbytes for linear in many), "there is room for all"
    monkeypatch.setattr(normal_equations, "MOST_BYTES", 2 * size + sum(m.nbytes for m in moved))
    response.motions(replace(fit, linear=many[3]))
    assert [linear.given.nbytes > 0 for linear in many] == [False, False, True, True]
    monkeypatch.setattr(normal_equations, "MOST_BYTES", 0)
    response.motions(replace(fit, linear=many[3]))
    assert [linear.given.nbytes > 0 for linear in many] == [False] * 3 + [True], "of the fit itself, it is in use"


def test_derivatives_of_a_screening_and_of_a_site_map_end_with_them(fit, monkeypatch):
    alive: list[int] = []
    made: list[weakref.ref] = []

    class Noted(Screen):
        def __init__(self, fit):
            super().__init__(fit)
            made.append(weakref.ref(self))

    def fitted(nominal, effect, variant, screens, *_):
        alive.append(sum(ref() is not None for ref in made))
        return Candidate(effect, variant, screens, None, 0.0)

    monkeypatch.setattr(search, "Screen", Noted)
    monkeypatch.setattr(search, "fit_variant", fitted)
    search.search(fit, offered(fit.problem.experiment, "nonlinear", EFFECTS)[:1])
    assert len(made) == 1
    assert set(alive) == {0}
    assert sites.site_map(fit).fit is fit  # not the one in slices, which holds them


def test_a_screening_responds_in_turns_with_the_same_results(fit, monkeypatch):
    screen, q = Screen(fit), fit.q + 0.1 * np.arange(3.0)[:, None]
    whole = screen.responses(fit.problem, q)
    monkeypatch.setattr(search, "READINGS_AT_ONCE", 1000)
    for a, b in zip(whole, screen.responses(fit.problem, q), strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_held_at_an_end_lies_in_one_array_with_the_rest(fit):
    at_end = [replace(b, group=replace(b.group, lower=b.eta, upper=b.eta + 1.0)) for b in fit.linear.blocks]
    for b, held in zip(at_end, fit.linear.with_blocks(tuple(at_end)).pinned().blocks, strict=True):
        pressed = np.einsum("jmd,jd->jm", b.T, b.r) + b.eta > 0.0
        assert pressed.any()
        np.testing.assert_array_equal(held.T, np.where(pressed[:, :, None], 0.0, b.T))
        np.testing.assert_array_equal(held.J, b.J)
        assert np.shares_memory(held.full, held.J)


def test_trials_are_forecast_in_turns_with_the_same_results(monkeypatch):
    long = calibrate(Problem(measured(repeats=3, duration=0.6)), anneal=False)
    whole = forecast.forecast(long, long.problem.trials)
    monkeypatch.setattr(forecast, "READINGS_AT_ONCE", 1)
    turns = forecast.forecast(long, long.problem.trials)
    assert len(whole) > 4
    for i, one in whole.items():
        np.testing.assert_array_equal(one.centre, turns[i].centre)
        np.testing.assert_allclose(one.sd, turns[i].sd, rtol=1e-9)


def test_problems_of_one_experiment_share_their_readings(fit):
    other = fit.problem.changed(factors=dict.fromkeys(fit.problem.trials, 0.5))
    for a, b in zip(fit.problem.groups, other.groups, strict=True):
        assert a.y is b.y
        np.testing.assert_array_equal(0.5 * a.weights(False), b.weights(False))


def test_trials_are_differentiated_in_turns_with_the_same_results(fit, monkeypatch):
    at_once = fit.problem.linearise(fit.q, fit.eta, central=True).blocks
    monkeypatch.setattr(derivatives, "READINGS_AT_ONCE", 600)
    in_turns = fit.problem.linearise(fit.q, fit.eta, central=True).blocks
    for a, b in zip(at_once, in_turns, strict=True):
        assert a.group is b.group
        assert all(np.array_equal(x, y) for x, y in ((a.J, b.J), (a.T, b.T), (a.r, b.r), (a.eta, b.eta)))
        assert np.shares_memory(b.full, b.J), "lies in one array, without a copy"


def test_a_descent_holds_the_derivatives_of_one_step(monkeypatch):
    alive: list[int] = []
    made: list[weakref.ref] = []
    original = Problem.linearise

    def noted(self, *args, **kwargs):
        alive.append(sum(ref() is not None for ref in made))
        linear = original(self, *args, **kwargs)
        made.append(weakref.ref(linear))
        return linear

    monkeypatch.setattr(Problem, "linearise", noted)
    calibrate(Problem(measured(repeats=1, duration=0.1)), anneal=False, finish=False)
    assert len(alive) > 3
    assert max(alive) == 0


def test_derivatives_of_many_trials_are_never_held_twice(monkeypatch):
    monkeypatch.setattr(derivatives, "READINGS_AT_ONCE", 600)
    problem = Problem(measured(repeats=30, duration=0.15))
    point, own = problem.prior_mean(), problem.no_nuisance()
    problem.linearise(point, own).normal()  # compiled
    tracemalloc.start()
    blocks = problem.linearise(point, own).blocks
    held, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    largest = max(block.nbytes for block in blocks)
    assert most < held + 0.5 * largest, "the turns of one group beside the whole of it: once more"
