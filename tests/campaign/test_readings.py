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
