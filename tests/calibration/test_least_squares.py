"""Descents: which starts are followed to their end, and what is differentiated once only."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_damper.calibration import Experiment, Noise, Problem, TrialRecord, calibrate
from bayes_damper.calibration.groups import Switches
from bayes_damper.calibration.heldout import freed
from bayes_damper.calibration.least_squares import _bend, calibrate_each, essence, restored, summarise
from bayes_damper.calibration.own_values import RELEASE, Scatter, Size
from bayes_damper.calibration.unknowns import Coordinate
from bayes_damper.effects import EFFECTS
from bayes_damper.priors.distributions import LogNormal, LogUniform, Normal, Uniform
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.simulation.model import Model

CONSTANTS = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0}
TRUE = {"c1t": 0.011, "drag": 0.005, "nu": 40.0, "k1t": 6.2, "theta0": 0.1}
CUBIC = EFFECTS["spring_cubic"].variants[0]


@pytest.fixture(scope="module")
def problem():
    times = np.arange(300) * 1e-3
    y = Model(False).simulate(CONSTANTS | TRUE, times).y[0]
    e = 2.0 * np.random.default_rng(4).standard_normal((2, *y.shape))
    trials = tuple(TrialRecord(f"I{k}", "I", False, k, times, y + e[k - 1], 0, 0.1, 1e-3) for k in (1, 2))
    experiment = Experiment({n: (x, 0.0) for n, x in CONSTANTS.items()}, ((6.2, 0.0),), trials)
    scatter = Scatter((Size("offset1", 0.5, 0.0, 1.0, 0.5), Size("gain1", 0.002, 0.0, 1.0, 0.002)))
    noise = Noise((2.0,), (0.3,), (0.1,))
    return Problem(experiment, noise=noise, switches=Switches(scatter=scatter))


def counted(monkeypatch):
    """Costs of the points at which problems are differentiated."""
    made = []
    linearise = Problem.linearise

    def count(self, q, eta, **options):
        made.append(np.array(q))
        return linearise(self, q, eta, **options)

    monkeypatch.setattr(Problem, "linearise", count)
    return made


def test_a_start_that_comes_to_where_another_was_is_not_followed(problem, monkeypatch):
    # The curve of friction, which these readings hardly show, is known: else two starts end a tenth of its sd apart.
    known = replace(problem.experiment, priors={"tail": 0.5})
    problem = Problem(known, noise=problem.noise, switches=problem.switches)
    alone = calibrate(problem, [problem.prior_mean()])
    made = counted(monkeypatch)
    calibrate(problem, [problem.prior_mean()])
    once = len(made)
    start = problem.prior_mean()
    start[0] += 0.28
    twice = calibrate(problem, [problem.prior_mean(), start])
    assert abs(twice.cost - alone.cost) < 0.05

    assert len(made) - 2 * once <= once // 2


def test_no_start_is_followed_that_stays_far_above_a_target(problem, monkeypatch):
    """Not even where it could still improve on another start of its own model, which stays as far above."""
    starts = [problem.prior_mean() + shift for shift in (1.5, 0.5)]
    ends = [calibrate(problem, [s], anneal=False, finish=False).cost for s in starts]
    made = counted(monkeypatch)
    calibrate(problem, starts, anneal=False, target=min(ends) - 1e7)
    assert len(made) <= 2 * 3 + 1
    assert not calibrate(problem, starts, anneal=False, target=min(ends) - 1e7).linear.central


def test_a_fit_from_another_process_is_not_differentiated_again(problem, monkeypatch):
    fit = calibrate(problem.with_effect(CUBIC))
    sent = essence(fit)
    monkeypatch.setattr(Problem, "simulate", None)
    again = restored(problem.with_effect(CUBIC), sent)
    assert again.log_evidence == fit.log_evidence
    assert np.array_equal(again.covariance, fit.covariance)


@pytest.mark.parametrize("allowed", [1, 2])
def test_fits_side_by_side_are_those_one_after_the_other(problem, allowed):
    fit = calibrate(problem)
    starts = [(fit.q + shift, fit.eta) for shift in (0.5, -0.5)]
    alone = [calibrate(problem, [q], eta=eta, anneal=False) for q, eta in starts]
    with kernel_threads(allowed):
        beside = calibrate_each(problem, starts, anneal=False)
        again = calibrate(problem)
    assert again.cost == fit.cost
    assert np.array_equal(again.q, fit.q)
    for one, other in zip(alone, beside, strict=True):
        assert one.cost == other.cost
        assert one.log_evidence == other.log_evidence
        assert np.array_equal(one.q, other.q)
        assert np.array_equal(one.covariance, other.covariance)


def test_the_bend_of_a_bounded_value_is_the_curvature_that_gauss_newton_leaves_out():
    """Of a record that is linear in a uniform value, or in the logarithm of a scale: by the normal density's slope."""
    priors = {"a": Uniform(1.0, 3.0), "b": LogUniform(1.0, 3.0), "c": LogNormal(2.0, 1.5), "d": Normal(0.0, 1.0)}
    known = SimpleNamespace(coordinates=[Coordinate(name, "nominal", prior) for name, prior in priors.items()])
    for z in (-2.0, 0.7):
        q = np.full(4, z)
        for pull in (5.0, -5.0):
            bend = _bend(known, q, q + pull)
            assert bend == pytest.approx([max(-z * pull, 0.0)] * 2 + [0.0, 0.0], rel=1e-3, abs=1e-6)


def test_what_is_the_same_for_every_fit_follows_the_noise(problem):
    """Derivatives by offsets are kept with the trials: not beyond a change of what they are weighed by."""
    q, eta = problem.prior_mean(), problem.no_nuisance()
    names = [name for name, _, _ in problem.groups[0].nuisances]
    first = problem.linearise(q, eta).blocks[0].T[:, names.index("offset1")].copy()
    again = problem.linearise(q + 0.3, eta).blocks[0].T[:, names.index("offset1")]
    white = replace(problem.noise, phi=(0.0,), theta=(0.0,))
    other = problem.with_noise(white).linearise(q, eta).blocks[0].T[:, names.index("offset1")]
    assert np.array_equal(first, again)
    weight = problem.groups[0].weight[:, 0]
    assert np.allclose(other, 0.5 * weight / 2.0, rtol=1e-12)
    assert math.isclose(first[0, 100] / other[0, 100], (1.0 - 0.3) / (1.0 - 0.1), rel_tol=1e-6)


def test_normal_equations_are_those_of_the_arrays_that_a_block_has(problem):
    """Derivatives and residuals lie in one array, which counts no more where one of them is changed."""
    block = problem.linearise(problem.prior_mean(), problem.no_nuisance()).blocks[0]
    assert np.shares_memory(block.full, block.J)
    changes = {"r": 2.0 * block.r, "J": block.J[:, ::-1], "T": np.zeros_like(block.T)}
    for name, array in changes.items():
        other = replace(block, **{name: array})
        assert np.array_equal(other.full, np.concatenate([other.J, other.T, other.r[:, None, :]], axis=1))


def test_own_values_caught_in_another_valley_are_found_again(problem):
    """Those of one trial of two: its instant is late, and its gain makes up for some of that."""
    fit = calibrate(problem)
    assert freed(fit, 25) is fit
    names = [name for name, _, _ in problem.groups[0].nuisances]
    caught = {i: v.copy() for i, v in fit.eta.items()}
    caught[1][names.index("delay")] = problem.groups[0].upper[1, names.index("delay")]
    caught[1][names.index("gain1")] = -20.0
    spoilt = summarise(problem, fit.q, caught, True, 1)
    assert spoilt.cost > fit.cost + 1000.0
    assert freed(spoilt, 25).cost < fit.cost + 0.1


@pytest.mark.parametrize("slow", [False, True])
def test_a_descent_that_a_jump_holds_up_keeps_releases_between_their_readings(problem, slow):
    """The reading at 0 jumps where a release begins after it; one that takes time begins before its instant."""
    size = Size(RELEASE, 1e-3, 0.0, 1.0, 1e-3)
    switches = Switches(scatter=Scatter((*problem.switches.scatter.sizes, size) if slow else ()))
    (group,) = problem.changed(switches=switches).groups
    names = [name for name, _, _ in group.nuisances]
    k = names.index("delay")
    _, middle, half = group.nuisances[k]
    taken = 2e-4 if slow else 0.0
    eta = np.zeros((2, len(names)))
    if slow:
        _, mean, sd = group.nuisances[names.index(RELEASE)]
        eta[:, names.index(RELEASE)] = (taken - mean) / sd
    eta[:, k] = (np.array([-2e-8, -3e-4]) + taken - middle) / half
    low, high = group.between_readings(eta)
    assert middle + half * high[:, k] - taken == pytest.approx(0.0, abs=1e-9)
    assert np.all((low <= eta) & (eta <= high))
    if slow:
        assert np.array_equal(low[:, names.index(RELEASE)], eta[:, names.index(RELEASE)])
