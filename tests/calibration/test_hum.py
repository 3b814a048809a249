"""Mains hum: found where it is, followed in each trial, and no gap."""

from __future__ import annotations

import re

import numpy as np
import pytest
from small_rig import measured

from bayes_damper.calibration import calibrate_nominal
from bayes_damper.calibration.hum import mains_in
from bayes_damper.calibration.scatter import scatter_in_words
from bayes_damper.diagnosis.remainder import remainder_of

TIMES = np.arange(0.0, 2.0, 2e-3)


def decays(seed, hum=0.0, hertz=50.0, records=6):
    """Noisy decays at 5 Hz, with a line of any phase."""
    rng = np.random.default_rng(seed)
    swing = 40.0 * np.exp(-TIMES) * np.cos(2.0 * np.pi * 5.0 * TIMES)
    phases = rng.uniform(0.0, 2.0 * np.pi, records)
    noise = rng.standard_normal((records, TIMES.size))
    return [
        (TIMES, swing + e + hum * np.sin(2.0 * np.pi * hertz * TIMES + p)) for e, p in zip(noise, phases, strict=True)
    ]


@pytest.mark.parametrize("hertz", [50.0, 60.0, 49.93, 60.04])
def test_a_line_of_the_mains_is_found_with_its_frequency(hertz):
    assert mains_in(decays(1, 0.5, hertz), 5.0) == pytest.approx(hertz, abs=0.03)


def test_without_one_and_beside_a_rig_as_quick_nothing_is_found():
    assert all(mains_in(decays(seed), 5.0) is None for seed in range(40))
    assert mains_in(decays(1, 0.5), 20.0) == pytest.approx(50.0, abs=0.03)
    assert mains_in(decays(1, 0.5), 40.0) is None
    assert mains_in([(TIMES[:15], y[:15]) for _, y in decays(1, 5.0)], 5.0) is None


def test_a_second_mode_at_that_frequency_dies_away_and_is_none():
    mode = 5.0 * np.exp(-2.0 * TIMES) * np.cos(2.0 * np.pi * 50.0 * TIMES)
    assert mains_in([(t, y + mode) for t, y in decays(1)], 20.0) is None


def test_hum_of_another_phase_in_each_trial_is_followed_and_is_no_gap():
    """1.5 times the noise at 50.02 Hz: it was a line of the remainder, and an unknown cause at the sensors (.995)."""
    phase = np.random.default_rng(2)

    def picked_up(times, y):
        return y + 3.0 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 50.02 * times + phase.uniform(0.0, 2.0 * np.pi))

    fit = calibrate_nominal(measured(4, sensor=picked_up, configurations=(False,), repeats=4, duration=0.8))
    size = next(s for s in fit.problem.switches.scatter.sizes if s.name == "hum1")
    assert size.sd == pytest.approx(3.0 / np.sqrt(2.0), rel=0.4)
    assert fit.problem.noise.total[0] == pytest.approx(2.0, rel=0.1)
    assert remainder_of(fit).line < 8.0
    assert any(re.search(r"mains: (50|49\.9\d|50\.\d+) Hz, 1\.\d times", words) for words in scatter_in_words(fit))
