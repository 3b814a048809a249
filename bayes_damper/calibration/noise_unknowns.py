"""What is unknown of the noise of records: which trials and channels share a standard deviation, and its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Group, Problem
from bayes_damper.calibration.experiment import trial_label
from bayes_damper.priors.distributions import Distribution, LogNormal, from_standard, to_standard

Array = NDArray[np.float64]
NOISE_PRIOR = LogNormal(1.0, 1.5)
"""Prior of each channel's noise relative to its estimate: thousands of readings decide, not this."""
DECLARED_NOISE = 1.1
"""Factor within which a declared noise_std is believed."""


@dataclass(frozen=True)
class Sigma:
    """One unknown noise: of a channel (from 0), in all trials or in some; prior of its standard deviation."""

    name: str
    channel: int
    trials: frozenset[int]
    prior: Distribution


class NoiseUnknowns:
    """The unknown standard deviations of a problem's noise, at the level that the priors give them.

    sigmas : each of them; groups : of the trials that are fitted, in the order in which `scale` has their trials.
    """

    def __init__(self, problem: Problem, groups: Sequence[Group]) -> None:
        self._experiment, self._total, self._groups = problem.experiment, problem.noise.total, tuple(groups)
        self.channels = max(group.y.shape[1] for group in groups)
        self.sigmas = self._found(groups)
        trials = [i for group in groups for i in group.trials]
        # Which unknown noise each trial and channel has, -1 where it is fixed.
        self._which = np.array([[self._sigma_of(c, i) for c in range(self.channels)] for i in trials])
        self._known = np.array([[self._fixed_scale(c, i) for c in range(self.channels)] for i in trials])

    def source(self, channel: int) -> tuple[str, int]:
        """The parameter that holds a channel's noise, and the channel whose estimate it goes by."""
        name = f"sigma{channel + 1}"
        other = self._experiment.ties.get(name)
        return (name, channel) if other is None else (other, int(other.removeprefix("sigma")) - 1)

    def prior(self, name: str, channel: int, case: str) -> Distribution | float:
        """Prior of the noise's standard deviation: that of the prior file, of campaign.toml, or a wide one."""
        e = self._experiment
        own = e.case_priors.get(name, {})
        if case in own or name in e.priors:
            return own[case] if case in own else e.priors[name]
        if e.noise_sd:
            return LogNormal(e.noise_sd[min(channel, len(e.noise_sd) - 1)], DECLARED_NOISE)
        return LogNormal(NOISE_PRIOR.median_value * self._total[channel], NOISE_PRIOR.factor)

    def _found(self, groups: Sequence[Group]) -> tuple[Sigma, ...]:
        e = self._experiment
        found = []
        for channel in range(self.channels):
            name = f"sigma{channel + 1}"
            if name in e.ties:
                continue
            users = [c for c in range(self.channels) if self.source(c)[0] == name]
            trials = [i for group in groups if group.y.shape[1] > min(users) for i in group.trials]
            level = "case" if name in e.case_priors else e.levels.get(name, "campaign")
            keys = {
                i: {"campaign": "", "case": f"[{e.trials[i].case}]", "trial": f"[{trial_label(e.trials[i])}]"}[level]
                for i in trials
            }
            if len(set(keys.values())) == 1 and level == "case":
                keys = dict.fromkeys(trials, "")
            for key in dict.fromkeys(keys.values()):
                members = [i for i in trials if keys[i] == key]
                prior = self.prior(name, channel, e.trials[members[0]].case)
                if not isinstance(prior, float | int):
                    found.append(Sigma(f"{name}{key}", channel, frozenset(members), prior))
        return tuple(found)

    def _sigma_of(self, channel: int, trial: int) -> int:
        source = self.source(channel)[1]
        hits = [k for k, s in enumerate(self.sigmas) if s.channel == source and trial in s.trials]
        return hits[0] if hits else -1

    def _fixed_scale(self, channel: int, trial: int) -> float:
        name, source = self.source(channel)
        prior = self.prior(name, source, self._experiment.trials[trial].case)
        return float(prior) / self._total[channel] if isinstance(prior, float | int) else 1.0

    @property
    def start(self) -> list[float]:
        """The estimates, in standard coordinates."""
        return [float(np.clip(to_standard(s.prior, self._total[s.channel]), -8.0, 8.0)) for s in self.sigmas]

    def variances(self, readings: Sequence[Array]) -> list[float]:
        """Of each unknown, in standard coordinates, by the number of readings of each group: (trials, channels)."""
        found = []
        for s, at in zip(self.sigmas, self.start, strict=True):
            count = 0.0
            for group, counted in zip(self._groups, readings, strict=True):
                rows = [j for j, i in enumerate(group.trials) if i in s.trials]
                channels = [c for c in range(counted.shape[1]) if self.source(c)[1] == s.channel]
                count += sum(counted[rows, c].sum() for c in channels)
            up, down = from_standard(s.prior, at + 1e-3), from_standard(s.prior, at - 1e-3)
            slope = float(np.log(up / down)) / 2e-3  # of ln sigma
            found.append(1.0 / (2.0 * count * slope**2 + 1.0))
        return found

    def scale(self, points: Array) -> Array:
        """Noise of each trial and channel relative to its estimate, (n, trials, channels), of points (n, sigmas)."""
        out = np.tile(self._known, (len(points), 1, 1))
        for k, s in enumerate(self.sigmas):
            value = from_standard(s.prior, points[:, k])
            rows, channels = np.nonzero(self._which == k)
            out[:, rows, channels] = value[:, None] / np.array(self._total)[channels]
        return out
