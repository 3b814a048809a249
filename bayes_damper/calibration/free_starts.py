"""Trials that start in motion: which of them repeat each other, and which are releases of their own."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import combinations

import numpy as np

from bayes_damper.calibration.experiment import Experiment, lone

ALIKE = 0.1  # by how much one free start may swing further than another that it repeats: hands let go that differently
APART = 1.1  # times what it still swings at its end is what another begins with, where they are releases of their own


def swinging_alike(experiment: Experiment, among: Sequence[int]) -> dict[int, tuple[Hashable, float]]:
    """Sets of trials under the same conditions of which none swings further than another by more than ALIKE."""
    trials = experiment.trials
    reach = {i: float(np.nanmax(trials[i].y[0]) - np.nanmin(trials[i].y[0])) for i in among}
    out: dict[int, tuple[Hashable, float]] = {}
    for i in sorted(reach, key=reach.__getitem__):
        sets = (key for key in out.values() if key[0] == trials[i].conditions and reach[i] < (1.0 + ALIKE) * key[1])
        out[i] = next(sets, (trials[i].conditions, reach[i]))
    return out


def released_apart(experiment: Experiment) -> bool:
    """Whether one trial still swings further at its beginning than another at its end: no stretches of one decay."""
    spans: dict[Hashable, list[tuple[float, float]]] = {}
    for t in experiment.trials:
        late = t.y[0, 2 * t.times.size // 3 :]
        if np.isfinite(late).any():
            begins, ends = (float(np.nanmax(y) - np.nanmin(y)) for y in (t.y[0], late))
            spans.setdefault(t.conditions, []).append((begins, ends))
    return any(
        min(one[0], other[0]) > APART * max(one[1], other[1])
        for same in spans.values()
        for one, other in combinations(same, 2)
    )


def single_releases(experiment: Experiment, among: Sequence[int]) -> bool:
    """Whether each of some trials was released, and none repeats another."""
    if experiment.start == "rest":
        return lone(experiment, among)
    alike = swinging_alike(experiment, among)
    return len(set(alike.values())) == len(alike) and released_apart(experiment)
