"""Records as the fits take them: the release found, clocks set, gaps on a grid. Held against motions in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayes_damper.calibration.experiment import TrialRecord, release_window
from bayes_damper.campaign.records import LARGE, Release, common_grid, evened, picks, release_of

OMEGA, ANGLE, STEP = 45.0, 0.1, 1e-3
READ = {
    "acceleration": lambda t: np.where(t < 0.0, 0.0, -ANGLE * OMEGA**2 * np.cos(OMEGA * t)),
    "velocity": lambda t: np.where(t < 0.0, 0.0, -ANGLE * OMEGA * np.sin(OMEGA * t)),
    "displacement": lambda t: np.where(t < 0.0, ANGLE, ANGLE * np.cos(OMEGA * t)),
}
REACH = {"acceleration": ANGLE * OMEGA**2, "velocity": ANGLE * OMEGA, "displacement": ANGLE}


def record(quantity, times, release, noise=0.01, seed=1):
    """Readings of an undamped rig let go at `release`."""
    y = READ[quantity](times - release)
    return y + noise * REACH[quantity] * np.random.default_rng(seed).standard_normal(times.size)


@pytest.mark.parametrize("quantity", READ)
@pytest.mark.parametrize("release", [0.0, 0.0004, -0.0006])
def test_a_release_near_the_nominal_instant_is_left_to_the_fit(quantity, release):
    """Within a step of t = 0 nothing is cut and no clock is set."""
    times = STEP * np.arange(300)
    assert release_of(times, record(quantity, times, release), quantity, ANGLE, OMEGA) == Release()


@pytest.mark.parametrize("quantity", READ)
def test_readings_before_the_nominal_release_are_cut(quantity):
    """A logger that ran before tells nothing of the rig by its first readings."""
    times = STEP * np.arange(-40, 300)
    first, shift, _ = release_of(times, record(quantity, times, 0.0), quantity, ANGLE, OMEGA)
    assert (times[first], shift) == (0.0, 0.0)


@pytest.mark.parametrize("quantity", READ)
@pytest.mark.parametrize("after", [0.1, 0.5, 0.9])  # the first reading after t = 0, in steps
@pytest.mark.parametrize("release", [-0.45, 0.0, 0.45])
def test_a_held_reading_before_the_release_bounds_it(quantity, after, release):
    """Wherever between two readings the clock puts 0: the window of a fit holds the instant."""
    times = STEP * (np.arange(-40, 300) + after)
    late = STEP * (after - 0.5 + release)  # within the step that the first reading after t = 0 ends
    y = record(quantity, times, late, noise=0.003)
    first, shift, _ = release_of(times, y, quantity, ANGLE, OMEGA)
    assert (first, shift) == (39, 0.0)
    low, high = release_window(TrialRecord("a", "I", False, 1, times[first:], y[None, first:], 0, ANGLE, 0.0), quantity)
    assert low <= late <= high
    assert high - low < 3.01 * STEP


@pytest.mark.parametrize("quantity", READ)
@pytest.mark.parametrize("release", [0.0153, 0.0478])
def test_a_clock_that_is_off_is_set_by_the_motion(quantity, release):
    """The new clock is within a step of the release, and the held reading before it is kept."""
    times = STEP * np.arange(400)
    first, shift, _ = release_of(times, record(quantity, times, release, noise=0.003), quantity, ANGLE, OMEGA)
    assert times[first] == shift
    assert abs(release - shift) <= 1.5 * STEP


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("late", [0.003, 0.006, 0.0105])
def test_a_motion_that_begins_a_little_late_may_be_slow_instead(quantity, late):
    """A gentle beginning was taken for a late one in those of a campaign's records whose noise was low enough."""
    times = STEP * np.arange(400)
    first, shift, doubt = release_of(times, record(quantity, times, late, noise=0.001), quantity, ANGLE, OMEGA)
    assert (first, shift) == (0, 0.0)
    assert late < doubt < late + (3.0 if quantity == "velocity" else 8.0) * STEP


def test_a_release_marked_too_late_is_found_too():
    """The motion begins before the nominal instant: the trigger came late."""
    times = STEP * np.arange(-60, 300)
    _, shift, _ = release_of(times, record("acceleration", times, -0.0205), "acceleration", ANGLE, OMEGA)
    assert -0.0215 <= shift <= -0.0205


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("release", [0.0, 0.06])
def test_among_much_noise_a_release_is_found_by_how_the_motion_began(quantity, release):
    """The first reading that stands out from the noise comes a fifth of a swing after the release."""
    times = STEP * np.arange(400)
    found = [release_of(times, record(quantity, times, release, 0.09, k), quantity, ANGLE, OMEGA) for k in range(20)]
    if not release:
        assert found == [Release()] * 20
    else:
        assert np.max(np.abs([x.shift - release for x in found])) <= 0.1 * 2.0 * math.pi / OMEGA


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("release", [0.0, 0.004, 0.008, 0.06])
def test_the_range_of_a_release_among_noise_holds_it(quantity, release):
    """A clock set by chance put sound trials five steps off, farther than the fit could bring them back."""
    times = STEP * np.arange(400)
    widths = []
    for seed in range(200):
        y = record(quantity, times, release, 0.05, seed)
        first, shift, doubt = release_of(times, y, quantity, ANGLE, OMEGA)
        trial = TrialRecord("a", "I", False, 1, times[first:] - shift, y[None, first:], 0, ANGLE, 0.0, doubt=doubt)
        low, high = release_window(trial, quantity)
        assert shift == 0.0 or release > 0.0
        if doubt or release in (0.0, 0.06):
            assert low <= release - shift <= high
        widths.append(high - low)
    assert np.median(widths) < 0.3 * 2.0 * math.pi / OMEGA


def test_a_rig_that_never_moves_or_starts_in_motion_keeps_its_clock():
    """What cannot be told is left as it is."""
    times = STEP * np.arange(200)
    noise = np.random.default_rng(2).standard_normal(200)
    assert release_of(times, noise, "acceleration", ANGLE, OMEGA) == Release()
    later = times + 0.05
    assert release_of(later, record("velocity", later, 0.0), "velocity", ANGLE, OMEGA) == Release()


def test_records_with_gaps_share_a_grid():
    """Lost readings leave holes in one even grid, whatever their place; the readings stay where they were."""
    even = 0.0005 * np.arange(1000)
    keep = [np.r_[0:300, 360:1000], np.r_[0:700, 760:980]]
    found = common_grid([even[k] for k in keep])
    assert found is not None
    grid, places = found
    assert np.allclose(grid, even)
    for k, place in zip(keep, places, strict=True):
        assert np.array_equal(place, k)


def test_no_grid_is_made_up():
    """Equal clocks need none; uneven ones, and clocks half a step apart, have none."""
    even = 1e-3 * np.arange(200)
    rng = np.random.default_rng(3)
    assert common_grid([even, even]) is None
    assert common_grid([even, even + 0.5e-3]) is None
    assert common_grid([np.sort(rng.uniform(0.0, 0.2, 200)), even]) is None
    assert common_grid([even[:10], np.r_[even[:10], 5.0 + even[:10]]]) is None
    assert math.isclose(common_grid([even, even[:150]])[0][-1], even[-1])


def test_readings_are_picked_only_where_there_are_many_and_they_come_fast():
    """Six natural periods a second: 20 kHz are 3300 readings a period, of which 150 are left in a large campaign."""
    period = 1.0 / 6.0
    assert picks([LARGE // 2, LARGE // 2], [5e-5, 5e-5], period, False) == [1, 1]
    assert picks([LARGE, LARGE], [5e-5, 1e-3], period, False) == [22, 1]
    assert picks([200, 200], [5e-5, 1e-3], period, True) == [33, 1]


def test_rounded_stamps_of_even_clocks_are_what_they_were_before():
    """Three records of one logger, each with its own phase, one that lacks readings: within a thirtieth of a step."""
    even = [np.arange(n) / 29.97 + phase for n, phase in ((117, 0.0), (90, 0.011), (60, 0.017))]
    even[1] = np.delete(even[1], [20, 21, 60])
    found = evened([np.round(t, 2) for t in even])
    for t, true in zip(found, even, strict=True):
        assert np.max(np.abs(t - true)) < 0.03 / 29.97


def test_records_that_one_trigger_started_keep_their_instants_in_common():
    """Repeats of different length: their readings still lie on one grid, bit for bit."""
    long, short = evened([np.round(np.arange(n) / 47.3, 2) for n in (300, 200)])
    assert np.array_equal(long[:200], short)


@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_clocks_that_show_their_instants_stay(jitter):
    """Even ones, and one that jitters by more than its stamps are rounded."""
    clock = np.round(np.arange(200) / 250.0 + jitter * np.random.default_rng(1).uniform(-0.4, 0.4, 200), 5)
    assert np.array_equal(evened([clock])[0], clock)
