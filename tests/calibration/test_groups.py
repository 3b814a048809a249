"""Trials with clocks of their own: simulated together, and the same as each by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_rig import measured

from bayes_damper.calibration import Problem, Switches, calibrate
from bayes_damper.calibration.groups import Bundle
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.diagnosis.search import Screen


@pytest.fixture(scope="module", params=["rest", "free"])
def jittered(request):
    """Four repeats of two cases, coupled and not, each read at times of its own; one has a reading less."""
    drawn, rng = measured(2, repeats=3, duration=0.2, rate=500.0), np.random.default_rng(4)
    trials = []
    for k, t in enumerate(drawn.trials):
        times = t.times + np.concatenate([[0.0], 4e-4 * rng.uniform(-1.0, 1.0, t.times.size - 1)]) + 1e-3 * (k % 2)
        trials.append(replace(t, times=times, heldout=False))
    trials[1] = trials[1].at(slice(None, -1))
    return replace(drawn, trials=tuple(trials), quantity="velocity", start=request.param)


@pytest.fixture(scope="module")
def problem(jittered):
    drift = Size("drift1", 0.01, 0.0, 0.0, 0.01)
    return Problem(jittered, switches=Switches(scatter=Scatter((drift,))))


def by_itself(problem):
    """The problem with each group in a bundle of its own."""
    alone = problem.changed()
    alone._bundles[tuple(map(id, alone.groups))] = [Bundle(g, ((slice(0, len(g.trials)), g),)) for g in alone.groups]
    return alone


def test_trials_share_a_bundle_if_they_have_equally_many_readings(problem):
    assert len(problem.groups) == 12
    sizes = sorted(len(bundle.whole.trials) for bundle in problem.bundles)
    assert sizes == [1, 5, 6], "coupled trials, uncoupled ones, and that with a reading less"
    for bundle in problem.bundles:
        for at, group in bundle.parts:
            assert bundle.whole.trials[at] == group.trials
            np.testing.assert_array_equal(np.atleast_2d(bundle.whole.times)[at][0], group.times)


def test_costs_and_derivatives_are_those_of_each_trial_by_itself(problem):
    rng, alone = np.random.default_rng(5), by_itself(problem)
    q = 0.3 * rng.standard_normal((3, problem.size))
    eta = {i: 0.3 * rng.standard_normal((3, v.size)) for i, v in problem.no_nuisance().items()}
    together, apart = problem.costs_of_trials(q, eta), alone.costs_of_trials(q, eta)
    for i, cost in together.items():
        np.testing.assert_allclose(cost, apart[i], rtol=1e-12)
    first = {i: v[0] for i, v in eta.items()}
    for central in (False, True):
        here, there = (p.linearise(q[0], first, central=central).blocks for p in (problem, alone))
        assert [b.group.trials for b in here] == [b.group.trials for b in there]
        for a, b in zip(here, there, strict=True):
            for name in ("r", "J", "T", "eta"):
                np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-9)


def test_responses_are_those_of_each_trial_by_itself(problem):
    fit = calibrate(problem, anneal=False, most=2, finish=False)
    screen, q = Screen(fit), np.stack([fit.q, fit.q + 0.01])
    for block, change in zip(screen.linear.blocks, screen.responses(fit.problem, q), strict=True):
        np.testing.assert_allclose(change, screen.response(block, fit.problem, q), rtol=1e-9, atol=1e-9)
