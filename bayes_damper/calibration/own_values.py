"""What each trial may have for itself: how much it scatters, and how it acts on motion or readings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RELEASE = "release_time"
RELATIVE = ("k1t", "k2t", "c1t", "c3t", "c2t", "mu", "drag", "drag_ratio")
COUPLED_ONLY = ("k2t", "c2t", "c3t", "mu", "drag_ratio")
READINGS = ("gain", "offset", "drift", "hum")  # of each channel
INPUT = "input"  # with a number: noise of a measured input, by what it does to all channels
DRIFT_WAVES = 3  # half periods of the fastest cosine that a drift may have over a record
BASELINE_WAVES = 12  # the same of a baseline that single records show


@dataclass(frozen=True)
class Size:
    """How much one thing scatters from trial to trial.

    sd : what fits use, the root of the posterior mean of its square; low, high : shortest interval holding 90 % of the
    probability; typical : scale of its prior; gained : nats of the repeats' likelihood by the likeliest size over none;
    middle : of a normal distribution with the central 90 % of own values, over all likely sizes; 0 if not known;
    waves : of a drift, half periods of its fastest cosine over a record; mean : of times of release, s, about which
    they lie; hertz : frequency of a hum, Hz.
    """

    name: str
    sd: float
    low: float
    high: float
    typical: float
    gained: float = 0.0
    waves: int = DRIFT_WAVES
    mean: float = 0.0
    hertz: float = 0.0
    middle: float = 0.0

    @property
    def columns(self) -> tuple[tuple[str, float], ...]:
        """Names and standard deviations of the nuisances that it makes in each trial."""
        if self.name.startswith("drift"):
            return tuple((f"{self.name}_{k}", self.sd / k) for k in range(1, self.waves + 1))
        if self.name.startswith("hum"):
            return tuple((f"{self.name}_{self.hertz:.2f}{phase}", self.sd) for phase in "cs")
        return ((nuisance(self.name), self.sd),)


@dataclass(frozen=True)
class Scatter:
    """The sizes of all that may scatter."""

    sizes: tuple[Size, ...] = ()

    @property
    def from_trial_to_trial(self) -> tuple[Size, ...]:
        """The sizes that single records do not show: all but those of baselines."""
        return tuple(s for s in self.sizes if not (s.name.startswith("drift") and s.waves == BASELINE_WAVES))

    def sd(self, name: str) -> float:
        """Size of one of them, 0 if it does not scatter."""
        return next((size.sd for size in self.sizes if size.name == name), 0.0)

    def mean(self, name: str) -> float:
        """What one of them lies about."""
        return next((size.mean for size in self.sizes if size.name == name), 0.0)

    def columns(self, coupled: bool) -> list[tuple[str, float]]:
        """Names and standard deviations of the nuisances of a trial."""
        return [
            column
            for size in self.sizes
            if coupled or (size.name not in COUPLED_ONLY and not size.name.endswith("2"))
            for column in size.columns
        ]


NO_SCATTER = Scatter()


def nuisance(name: str) -> str:
    """Name of the nuisance that scatters."""
    return f"ln_{name}" if name in RELATIVE else name


def middle_of(name: str) -> float:
    """Mean of a nuisance, in units of its size: a time is never negative, so its prior is half a normal one."""
    return math.sqrt(2.0 / math.pi) if name == RELEASE else 0.0


def of_readings(name: str) -> bool:
    """Whether a nuisance acts on the readings, not on the motion."""
    return name.startswith((*READINGS, INPUT))


def channel_of(name: str) -> int:
    """Channel, from 0, of a nuisance of the readings; -1 for noise of an input, which shows in all."""
    return -1 if name.startswith(INPUT) else int(name.partition("_")[0][-1]) - 1


def half_periods(name: str) -> int:
    """Of the cosine of a drift, over its record."""
    return int(name.partition("_")[2])


def wave(name: str, times: Array) -> Array:
    """Shape in time, of mean square 1: an offset, a half-period cosine of a drift, a cosine or sine of a hum.

    times : (n,), or (trials, n) of clocks of their own.
    """
    if name.startswith("offset"):
        return np.ones_like(times)
    if name.startswith("hum"):
        turns = float(name.partition("_")[2][:-1]) * times
        return np.asarray(math.sqrt(2.0) * (np.cos if name.endswith("c") else np.sin)(2.0 * math.pi * turns))
    since = times - times[..., :1]
    return np.asarray(
        math.sqrt(2.0) * np.cos(half_periods(name) * math.pi * since / np.maximum(since[..., -1:], 1e-300))
    )
