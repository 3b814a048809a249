"""Trials that share a simulation: their readings, weights and each trial's own unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.rig.inputs import Inputs

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Group:
    """Training trials that can share one simulation: same configuration, times and inputs."""

    coupled: bool
    trials: tuple[int, ...]
    times: Array
    inputs: Inputs | None
    y: Array  # (trials, channels, n), missing readings 0
    weight: Array  # the same shape; 0 where missing
    first_weight: Array
    nuisances: tuple[tuple[str, Array, Array], ...]  # name, prior mean and sd for each trial
    lower: Array  # (trials, m) bounds of eta
    upper: Array

    def weights(self, annealed: bool) -> Array:
        """Weights of the residuals; annealed: samples beside friction reversals count little, for a smoother cost."""
        return self.first_weight if annealed else self.weight

    def only(self, at: slice) -> Group:
        """The group of some of its trials."""
        return replace(
            self, trials=self.trials[at], y=self.y[at], weight=self.weight[at], first_weight=self.first_weight[at],
            nuisances=tuple((name, mean[at], sd[at]) for name, mean, sd in self.nuisances), lower=self.lower[at],
            upper=self.upper[at],
        )  # fmt: skip
