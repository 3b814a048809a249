"""Which trials repeat each other, reading by reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_rig import measured

from bayes_damper.calibration.experiment import repeats_by_reading


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
