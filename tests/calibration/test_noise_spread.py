"""Noise that is stronger where a rig moves more: whether it is found, how strong, and what a fit makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_rig import NOISE, measured

from bayes_damper.calibration import Experiment, calibrate_nominal
from bayes_damper.calibration.heldout import predict
from bayes_damper.calibration.noise_spread import with_spread

MOST = 4.0  # times the noise of a rig at rest that is added at the largest reading


def _shaken(experiment: Experiment, share: float = MOST, seed: int = 5) -> Experiment:
    """The experiment with noise in addition that follows the size of each reading, smoothed over an envelope."""
    rng, trials = np.random.default_rng(seed), []
    top = max(float(np.abs(t.y[0]).max()) for t in experiment.trials)
    for t in experiment.trials:
        size = np.array([np.maximum.accumulate(np.abs(row)[::-1])[::-1] for row in t.y])  # the largest still to come
        trials.append(replace(t, y=t.y + share * NOISE * size / top * rng.standard_normal(t.y.shape)))
    return replace(experiment, trials=tuple(trials))


@pytest.fixture(scope="module")
def plain() -> Experiment:
    return measured(3, repeats=3, duration=0.4)


@pytest.fixture(scope="module")
def shaken(plain: Experiment) -> Experiment:
    return _shaken(plain)


def test_steady_noise_is_left_alone(plain: Experiment) -> None:
    fit = calibrate_nominal(plain)
    assert all(t.spread is None for t in fit.problem.experiment.trials)
    assert with_spread(fit) is None


def test_each_reading_has_its_own_noise(shaken: Experiment) -> None:
    """Known noise: residuals over it are as large early as late, and its level is the one that was added."""
    fit = calibrate_nominal(shaken)
    trials = fit.problem.experiment.trials
    top = max(float(np.abs(t.y[0]).max()) for t in shaken.trials)
    for i, residual in fit.residuals().items():
        t = shaken.trials[i]
        early, late = (np.std(part[:, 5:]) for part in np.array_split(residual, 2, axis=1))
        assert early / late == pytest.approx(1.0, abs=0.25)
        size = np.array([np.maximum.accumulate(np.abs(row)[::-1])[::-1] for row in t.y])
        true = NOISE * np.sqrt(1.0 + (MOST * size / top) ** 2)
        told = trials[i].noise(np.array(fit.problem.noise.total)[: len(t.y)])
        assert np.median(told / true) == pytest.approx(1.0, abs=0.2)
        raw = t.y - fit.simulated()[i]
        assert residual == pytest.approx(raw / trials[i].spread)


def test_a_held_out_trial_has_the_noise_that_the_fitted_ones_show(shaken: Experiment) -> None:
    fit = calibrate_nominal(shaken)
    for p in predict(fit, shaken.heldout).values():
        assert p.chi2 / p.n_data == pytest.approx(1.0, abs=0.25)
        early, late = (np.std(part[:, 5:]) for part in np.array_split(p.residual, 2, axis=1))
        assert early / late == pytest.approx(1.0, abs=0.35)
