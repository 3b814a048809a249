"""Tests of what a fit leaves: what repeats share is the model's, what a trial has alone is the laboratory's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_rig import NOISE, measured

from bayes_damper.calibration import Calibration, calibrate_nominal
from bayes_damper.diagnosis.remainder import remainder_of, unlike, unlike_in_words


def fitted(waves: list[float], omega: float) -> Calibration:
    """Five repeats of each case, with a wave of its own size in each trial."""
    drawn = measured(3, configurations=(False,), repeats=6)
    trials = []
    for k, t in enumerate(drawn.trials):
        trials.append(replace(t, y=t.y + NOISE * waves[k % len(waves)] * np.sin(omega * t.times)))
    return calibrate_nominal(replace(drawn, trials=tuple(trials)))


def test_a_line_of_one_trial_is_no_gap_but_is_reported_by_its_name():
    fit = fitted([0.0, 0.0, 3.0, 0.0, 0.0, 0.0] + 6 * [0.0], 900.0)
    found = remainder_of(fit)
    assert found.strength < 8.0
    (odd,) = unlike(fit)
    trial = fit.problem.experiment.trials[odd.trial]
    assert trial.number == 3
    assert odd.excess > 1.0
    (sentence,) = unlike_in_words(fit)
    assert trial.label in sentence


def test_a_line_without_phase_in_every_trial_is_found():
    signs = [1.0, -1.0, 1.0, -1.0, 1.0, 1.0]
    found = remainder_of(fitted([0.6 * s for s in signs], 900.0))
    assert found.line > 12.0
    assert 2.0 * np.pi * found.peak_hz == pytest.approx(900.0, rel=0.03)


def test_a_wave_that_repeats_share_is_found():
    assert remainder_of(fitted([0.6], 100.0)).strength > 30.0


def test_the_noise_of_a_trial_without_repeats_is_its_own():
    """Outliers of its repeats are found and left out, its own are not: it seemed to have a gap of every frequency."""
    drawn = measured(3, configurations=(False,), repeats=5)
    rng = np.random.default_rng(1)
    alone = drawn.trials[5]
    noisy = replace(alone, y=alone.y + NOISE * rng.standard_normal(alone.y.shape))
    fit = calibrate_nominal(replace(drawn, trials=(*drawn.trials[:5], noisy)))
    wave = 0.4 * NOISE * np.sin(100.0 * noisy.times)
    shared = tuple(replace(t, y=t.y + wave) for t in (*drawn.trials[:5], noisy))
    assert remainder_of(fit).strength < 5.0
    assert remainder_of(calibrate_nominal(replace(drawn, trials=shared))).strength > 20.0


def test_a_case_with_noisier_sensors_has_no_gap():
    """The mean of few noisy repeats beside many quiet ones, as of sensors that err in proportion to their range."""
    drawn = measured(3, configurations=(False,), repeats=6)
    rng = np.random.default_rng(1)
    case = drawn.trials[0].case
    drawn = replace(drawn, trials=tuple(t for t in drawn.trials if t.case != case or t.number < 4 or t.heldout))
    own = [1.7 * NOISE * rng.standard_normal(t.y.shape) * (t.case == case) for t in drawn.trials]
    noisy = replace(drawn, trials=tuple(replace(t, y=t.y + x) for t, x in zip(drawn.trials, own, strict=True)))
    wave = [0.6 * NOISE * np.sin(100.0 * t.times) for t in drawn.trials]
    shared = tuple(replace(t, y=t.y + w) for t, w in zip(noisy.trials, wave, strict=True))
    assert remainder_of(calibrate_nominal(noisy)).strength < 6.0
    assert remainder_of(calibrate_nominal(replace(drawn, trials=shared))).strength > 20.0
