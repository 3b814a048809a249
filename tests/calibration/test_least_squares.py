"""Descents: which starts are followed to their end, and what is differentiated once only."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_damper.calibration import Experiment, Noise, Problem, TrialRecord, calibrate
from bayes_damper.calibration.groups import Switches
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.diagnosis.search import essence, restored
from bayes_damper.effects import EFFECTS
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
    alone = calibrate(problem, [problem.prior_mean()])
    made = counted(monkeypatch)
    calibrate(problem, [problem.prior_mean()])
    once = len(made)
    start = problem.prior_mean()
    start[0] += 0.3
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
