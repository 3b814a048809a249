"""Trials that a fit has not seen, and fits that have seen them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_rig import measured

from bayes_damper.calibration import Problem, Switches, calibrate, fitted_to_all, predict, unseeing


@pytest.mark.parametrize(("repeats", "all_of_them"), [(1, False), (2, True), (3, False)])
def test_models_are_fitted_to_held_out_trials_where_nothing_else_would_repeat(repeats, all_of_them):
    experiment = fitted_to_all(measured(repeats=repeats, duration=0.1))
    assert experiment.fits_all is all_of_them
    assert len(experiment.training) == (4 * (repeats - 1) or 4) * (2 if all_of_them else 1)
    assert len(experiment.heldout) == (4 if repeats > 1 else 0)


def test_a_trial_without_a_repeat_keeps_the_others_held_out():
    experiment = measured(repeats=2, duration=0.1)
    assert not fitted_to_all(replace(experiment, trials=experiment.trials[:-1])).fits_all
    assert not fitted_to_all(replace(experiment, start="free")).fits_all


@pytest.fixture(scope="module")
def of_pairs():
    """The nominal fit to both trials of each case."""
    experiment = fitted_to_all(measured(3, repeats=2, duration=0.25, configurations=(False,)))
    problem = Problem(experiment, switches=Switches(delay=False, friction=False))
    return calibrate(problem, anneal=False)


def test_held_out_figures_come_from_a_fit_without_those_trials(of_pairs):
    experiment = of_pairs.problem.experiment
    fit = unseeing(of_pairs)
    assert fit.problem.trials == (0, 2)
    apart, switches = replace(experiment, fits_all=False), Switches(delay=False, friction=False)
    own = calibrate(Problem(apart, noise=of_pairs.problem.noise, switches=switches), anneal=False)
    assert fit.cost == pytest.approx(own.cost, abs=0.2)
    sd = np.sqrt(np.diag(own.covariance))
    assert np.abs((fit.q - own.q) / sd).max() < 0.1
    assert unseeing(of_pairs) is fit
    assert unseeing(fit) is fit
    assert predict(fit, experiment.heldout)[1].chi2 > float(
        of_pairs.linear.blocks[0].r[1] @ of_pairs.linear.blocks[0].r[1]
    )
