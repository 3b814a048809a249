"""Where residuals exceed the noise: an event is found in time, looks are paid for, places are named."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from small_rig import NOISE, knock, measured, variant

from bayes_damper.calibration import calibrate_nominal
from bayes_damper.diagnosis.response import motions
from bayes_damper.diagnosis.where import (
    Repeats,
    _exceeds,
    _in_channels,
    _in_frequency,
    _in_time,
    _kept,
    find_event,
    holm,
    locate,
)


def repeats(rng, sets=4, n=500):
    """Sets of two repeats of pure noise."""
    out = []
    for k in range(sets):
        single = rng.standard_normal((2, 2, n))
        mean = single.sum(axis=0) / np.sqrt(2.0)
        out.append(
            Repeats(str(k), True, (2 * k, 2 * k + 1), (1, 2), np.arange(n) * 1e-3, mean, single, np.ones((2, n)))
        )
    return out


@pytest.mark.parametrize(("start", "length"), [(0.3, 0.010), (0.1503, 0.004)])
def test_a_knock_is_found_within_three_milliseconds(start, length):
    fit = calibrate_nominal(measured(7, torque=knock(start, length, 0.05)))
    event = find_event(fit)
    assert event is not None
    assert event.site == "ground1"
    assert event.start_s == pytest.approx(start, abs=0.003)
    assert event.instant_s == pytest.approx(start + 0.5 * length, abs=0.002)
    assert event.impulse == pytest.approx(0.05 * length * 2.0 / np.pi, rel=0.15)
    assert event.local
    found = locate(fit, events=False)
    first = found.time[0].to_json()
    assert first["end_s"] > start
    assert first["p_value"] < 1e-6
    assert {"case", "trial", "channel", "start_s", "end_s"} <= set(first)


def test_a_knock_of_a_rig_twenty_times_as_slow_is_found():
    """All inertias 400 times as large: the same swings take twenty times as long, the knock half a second."""
    start, length, times = 0.3, 0.025, 20.0
    quick = measured(7, torque=knock(start, length, 0.02))
    slow = replace(
        quick,
        constants={n: (v * times**2 if n in ("J1", "J2") else v, sd) for n, (v, sd) in quick.constants.items()},
        trials=tuple(replace(t, times=t.times * times, y=t.y / times**2) for t in quick.trials),
    )
    event = find_event(calibrate_nominal(slow))
    assert event is not None
    assert event.site == "ground1"
    assert event.start_s == pytest.approx(start * times, abs=0.06)
    assert event.instant_s == pytest.approx((start + 0.5 * length) * times, abs=0.04)
    assert event.impulse == pytest.approx(0.02 * length * times * 2.0 / np.pi, rel=0.15)


def test_a_law_that_is_wrong_everywhere_is_no_local_event():
    fit = calibrate_nominal(measured(8, effect=variant("quadratic_drag"), values={"coefficient": 0.3}))
    event = find_event(fit)
    assert event is None or not event.local
    found = locate(fit, events=False).to_json()
    assert found["case"]["I uncoupled"]["p_value"] < 0.01
    assert found["phase_space"]
    assert set(found["phase_space"][0]["coordinates"]) in ({"th1", "w1"}, {"th2", "w2"}, {"phi", "slip"})


def test_an_interface_law_shows_in_the_coupled_cases_only():
    fit = calibrate_nominal(measured(4, effect=variant("magnet_cubic", "cubic"), values={"cubic": 300.0}))
    cases = locate(fit, events=False).to_json()["case"]
    assert cases["I coupled"]["p_value"] < 1e-3
    assert cases["I uncoupled"]["p_value"] > 0.05
    assert cases["IV uncoupled"]["p_value"] > 0.05


def test_a_hum_is_found_at_its_frequency():
    fit = calibrate_nominal(measured(9, sensor=lambda t, y: y + 1.5 * np.sin(2.0 * np.pi * 120.0 * t)))
    strongest = locate(fit, events=False).frequency[0].to_json()
    assert strongest["low_hz"] < 120.0 < strongest["high_hz"]
    assert strongest["p_value"] < 1e-6


@pytest.mark.parametrize(
    "looks", [_in_time, pytest.param(_in_frequency, marks=pytest.mark.slow)], ids=["time", "frequency"]
)
def test_noise_yields_an_entry_in_few_campaigns(looks):
    """At most 5 % of campaigns without a gap have any entry of a kind: 100 campaigns, thousands of looks each."""
    rng = np.random.default_rng(11)
    alarms = sum(bool(_kept(list(looks(repeats(rng))))) for _ in range(100))
    assert alarms <= 11


def test_noise_gives_even_p_values_of_channels():
    rng = np.random.default_rng(12)
    p = [entry.p_value for _ in range(150) for entry in _in_channels(repeats(rng, n=300))]
    assert 0.3 < np.mean(p) < 0.7
    assert 0.01 < np.mean(np.array(p) < 0.1) < 0.2


def test_exceedance_is_the_chi_square_law_for_few_readings():
    x = np.array([5.0, 20.0, 40.0])
    assert np.allclose(_exceeds(x, np.full(3, 10.0)), chi2(10).sf(x), rtol=0.05)


def test_holm_by_hand():
    """Sorted 0.01, 0.02, 0.04 times 3, 2, 1, never decreasing."""
    assert holm([0.04, 0.01, 0.02]) == pytest.approx([0.04, 0.03, 0.04])
    assert holm([0.9, 0.8]).max() <= 1.0


@pytest.mark.slow
def test_a_long_record_is_searched_in_little_memory() -> None:
    long = measured(4, cases=(("I", 0, 0.1),), configurations=(False,), repeats=1, duration=14.0)
    fit = calibrate_nominal(long)
    moved = motions(fit)
    tracemalloc.start()
    try:
        find_event(fit, moved)
        assert tracemalloc.get_traced_memory()[1] < 200e6  # 14 000 readings against hundreds of instants
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_without_repeats_power_is_measured_against_the_noise_of_the_sensors():
    """There the noise of a fit holds the model's own error: a gap had power -0.85 above it, with p = 1."""
    found = {}
    for size in (0.0, 0.6):
        lone = measured(8, effect=variant("quadratic_drag"), values={"coefficient": size}, repeats=1)
        fit = calibrate_nominal(lone)
        found[size] = locate(fit, events=False).to_json()["channel"]["1"]
        left = np.concatenate([r[0] for r in fit.residuals().values()])
        assert bool(fit.problem.noise.sensor) == (size > 0.0)
    assert found[0.0]["p_value"] > 0.05
    assert found[0.6]["p_value"] < 1e-3
    assert found[0.6]["excess_over_noise"] > 0.5 * ((left.std() / NOISE) ** 2 - 1.0)


def test_noise_that_few_readings_show_gives_even_p_values():
    """The variance of the noise, by which residuals are divided, is off by as much as `spread` says."""
    rng, spread, p = np.random.default_rng(5), 0.2, []
    for _ in range(300):
        found = repeats(rng, sets=1, n=300)[0]
        off = np.sqrt(rng.chisquare(2.0 / spread**2) / (2.0 / spread**2))
        p += [e.p_value for e in _in_channels([replace(found, mean=found.mean / off, spread=spread)])]
    assert 0.4 < np.mean(p) < 0.6
    assert 0.05 < np.mean(np.array(p) < 0.1) < 0.15
