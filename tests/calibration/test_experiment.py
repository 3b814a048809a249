"""Which trials repeat each other, reading by reading."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from campaigns import write_synthetic
from small_rig import measured

from bayes_damper.calibration.experiment import Experiment, TrialRecord, experiment_of, gridded, repeats_by_reading
from bayes_damper.campaign import load_campaign


def with_clocks(experiment, jitter):
    """Each trial read by a clock of its own, which strays by so many steps at most."""
    rng = np.random.default_rng(3)

    def times(t):
        own = jitter * np.median(np.diff(t.times)) * rng.uniform(-1.0, 1.0, t.times.size)
        return np.sort(t.times + np.concatenate([[0.0], own[1:]]))

    return replace(experiment, trials=tuple(replace(t, times=times(t)) for t in experiment.trials))


def test_trials_read_by_uneven_clocks_repeat_each_other():
    even = measured(repeats=3, duration=0.15)
    among = range(len(even.trials))
    sets = repeats_by_reading(even, among)
    assert {len(s) for s in sets} == {3}
    assert repeats_by_reading(with_clocks(even, 0.3), among) == sets
    assert {len(s) for s in repeats_by_reading(with_clocks(even, 3.0), among)} == {1}
    assert {len(s) for s in repeats_by_reading(replace(even, start="free"), among)} == {1}


def test_free_starts_that_begin_at_other_times_have_grids_of_their_own():
    """A record in parts keeps its clock: on a common grid the second part began with readings that are missing."""
    times = np.delete(np.arange(0.0, 4.0, 0.02), 7)
    trials = tuple(
        TrialRecord(str(k), "A", False, k, times + begins, np.cos(5.0 * times)[None], 0)
        for k, begins in enumerate((0.0, 12.0, 12.0))
    )
    first, *later = gridded(Experiment({"J1": (1.0, 0.0)}, ((25.0, 0.0),), trials, "displacement", start="free")).trials
    assert first.times[0] == 0.0
    for t in later:
        assert t.times[0] == 12.0
        assert np.array_equal(t.times, later[0].times)
        assert np.flatnonzero(np.isnan(t.y[0])).tolist() == [7]


@pytest.mark.parametrize(("late", "shifts"), [((0.4, 0.4, 0.6), 0), ((0.4, 0.6, 0.6), 2), ((0.0, 0.0, 3.0), 1)])
def test_clocks_are_set_to_beginnings_that_may_be_slow_only_where_most_records_have_one(tmp_path, late, shifts):
    """Of two records behind one slow sensor one was set and the other not, which a ramp and stops explained: 0.98."""
    campaign = load_campaign(write_synthetic(tmp_path, repeats=3))
    alone = [t for t in campaign.trials if not t.coupled][:3]
    omega = math.sqrt(alone[0].k1t.value / campaign.rig.primary_inertia.value)
    times = np.arange(4000) * 0.005 / omega
    noise = 1e-5 * np.random.default_rng(1).standard_normal(times.size)
    trials = tuple(
        replace(t, times=times, channels=(t.theta0.value * np.cos(np.maximum(omega * times - x, 0.0)) + noise)[None])
        for t, x in zip(alone, late, strict=True)
    )
    displacements = replace(campaign.measurement, quantity="displacement")
    read = experiment_of(replace(campaign, trials=trials, measurement=displacements)).trials
    assert sum(bool(np.isnan(t.y).any()) for t in read) == shifts  # what began earlier is cut, and the grid is filled
