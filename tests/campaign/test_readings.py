"""What the readings of one channel look like."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaigns import decay

from bayes_damper.campaign.readings import find_first_peak, find_release, flat_tops_of

TIMES = np.arange(-200, 1200) / 1000.0


def wave(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(len(TIMES))
    return decay(TIMES, math.radians(4.7), 10.2, 0.031) + noise


def test_release_and_first_peak_are_found() -> None:
    assert find_release(TIMES, wave()) == pytest.approx(0.0, abs=0.0015)
    period = 2.0 * math.pi * math.sqrt(3.015e-3 / 10.2)
    late = 0.3 * period < TIMES
    assert find_first_peak(TIMES[late], wave()[late]) == pytest.approx(0.5 * period, abs=0.02 * period)


@pytest.mark.parametrize("held", [0.0, 0.05, 0.6])
def test_the_first_peak_is_not_where_a_hand_still_holds_the_rig(held: float) -> None:
    times = np.arange(0.0, 8.0, 1.0 / 60.0)
    after = np.maximum(times - held, 0.0)
    y = np.round(90.0 * np.exp(-0.1 * after) * np.cos(2.0 * math.pi * after), 1)
    y[times < 0.5 * held] += 0.4  # a hand is not still
    assert find_first_peak(times, y) == pytest.approx(held + 0.5 if held else 0.0, abs=0.01)


def test_a_reading_in_the_middle_is_a_crossing_too() -> None:
    times = np.arange(0.0, 4.0, 0.025)
    y = np.cos(2.0 * math.pi * (times - 0.1)).round(6)  # 0 at 0.35, 0.85, ...: readings, as of a coarse encoder
    y[times > 0.36] *= 1.3
    assert np.count_nonzero(y == 0.0) > 4
    assert find_first_peak(times, y) == pytest.approx(0.1, abs=0.01)


def test_a_channel_that_is_held_at_first_is_not_clipped_whatever_its_noise():
    """The first of its readings is not always among the largest."""
    times = np.arange(1000) * 1e-3
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(0.0, 2e-3, times.size)
        y = np.where(times < 0.08, 1.0, np.exp(-3.0 * (times - 0.08)) * np.cos(45.0 * (times - 0.08))) + noise
        assert flat_tops_of(times, y, 2e-3, 45.0, True) == []


@pytest.mark.parametrize(("step", "noise", "decay", "n"), [(5.1e-3, 1.5e-3, 0.2, 1500), (1.3e-3, 2e-4, 0.05, 400)])
def test_rounded_readings_that_turn_round_in_noise_are_not_clipped_and_cut_ones_are(step, noise, decay, n):
    """Readings of two steps alternate at such a turn; few are equal where they are as many as the steps."""
    times = np.linspace(0.0, 5.0, n)
    omega, found = 2.0 * math.pi, 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        y = 0.2 * np.exp(-decay * times) * np.sin(omega * times + rng.uniform(0.0, 6.0)) + rng.normal(0.0, noise, n)
        rounded = step * np.round(y / step)
        found += len(flat_tops_of(times, rounded, noise, omega, False))
        cut = np.minimum(rounded, step * np.round(0.1 / step))
        if n > 1000:  # a few readings to a swing show no flat top
            assert len(flat_tops_of(times, cut, noise, omega, False)) == 1
    assert found <= 1
