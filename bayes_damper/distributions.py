"""The one-dimensional distributions that priors are made of.

Each is a small frozen record with its log density, quantile function and draws; priors.py reads them from TOML.
`coordinate` tells the samplers in which coordinate a parameter moves best: "log" for scales, else "linear".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtr, ndtri

Array = NDArray[np.float64]
Coordinate = Literal["linear", "log"]
_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


class Distribution(Protocol):
    """What every distribution offers."""

    coordinate: Coordinate

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest possible value."""
        ...

    def logpdf(self, x: ArrayLike) -> Array:
        """Normalised log density, -inf outside the support; the shape of `x`."""
        ...

    def ppf(self, u: ArrayLike) -> Array:
        """Quantiles of the probabilities `u`; the shape of `u`."""
        ...


@dataclass(frozen=True)
class Normal:
    """Gaussian, cut at `lower` and `upper` where given."""

    mean: float
    sd: float
    lower: float = -math.inf
    upper: float = math.inf
    coordinate: Coordinate = "linear"

    @property
    def support(self) -> tuple[float, float]:
        return self.lower, self.upper

    def _log_mass(self) -> float:
        a, b = (self.lower - self.mean) / self.sd, (self.upper - self.mean) / self.sd
        if a > 0.0:  # both in the upper tail: mirror, where log_ndtr is accurate
            a, b = -b, -a
        return float(log_ndtr(b) + np.log1p(-np.exp(log_ndtr(a) - log_ndtr(b))))

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        inside = (x >= self.lower) & (x <= self.upper)
        value = -0.5 * ((x - self.mean) / self.sd) ** 2 - math.log(self.sd) - _LOG_ROOT_2PI - self._log_mass()
        return np.where(inside, value, -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        low, high = ndtr((self.lower - self.mean) / self.sd), ndtr((self.upper - self.mean) / self.sd)
        return np.clip(self.mean + self.sd * ndtri(low + np.asarray(u, float) * (high - low)), self.lower, self.upper)


@dataclass(frozen=True)
class LogNormal:
    """ln x is Gaussian about ln median with sd ln factor: two thirds of the mass lie within a factor `factor`."""

    median_value: float
    factor: float
    coordinate: Coordinate = "log"

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, math.inf

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        sd = math.log(self.factor)
        with np.errstate(divide="ignore", invalid="ignore"):
            ln = np.log(x)
            value = -0.5 * ((ln - math.log(self.median_value)) / sd) ** 2 - math.log(sd) - _LOG_ROOT_2PI - ln
        return np.where(x > 0.0, value, -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        return self.median_value * np.exp(math.log(self.factor) * ndtri(np.asarray(u, float)))


@dataclass(frozen=True)
class HalfNormal:
    """The positive half of a Gaussian about zero."""

    sd: float
    coordinate: Coordinate = "linear"

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, math.inf

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        value = -0.5 * (x / self.sd) ** 2 + math.log(2.0 / self.sd) - _LOG_ROOT_2PI
        return np.where(x >= 0.0, value, -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        return self.sd * ndtri(0.5 + 0.5 * np.asarray(u, float))


@dataclass(frozen=True)
class Uniform:
    """Constant between `lower` and `upper`."""

    lower: float
    upper: float
    coordinate: Coordinate = "linear"

    @property
    def support(self) -> tuple[float, float]:
        return self.lower, self.upper

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        return np.where((x >= self.lower) & (x <= self.upper), -math.log(self.upper - self.lower), -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        return self.lower + (self.upper - self.lower) * np.asarray(u, float)


@dataclass(frozen=True)
class LogUniform:
    """ln x is uniform between ln lower and ln upper."""

    lower: float
    upper: float
    coordinate: Coordinate = "log"

    @property
    def support(self) -> tuple[float, float]:
        return self.lower, self.upper

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = -np.log(x) - math.log(math.log(self.upper / self.lower))
        return np.where((x >= self.lower) & (x <= self.upper), value, -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        return self.lower * (self.upper / self.lower) ** np.asarray(u, float)


def median(distribution: Distribution) -> float:
    """The median of a distribution."""
    return float(distribution.ppf(0.5))


def sample(distribution: Distribution, rng: np.random.Generator, size: int | tuple[int, ...]) -> Array:
    """Independent draws of shape `size`."""
    return distribution.ppf(rng.random(size))
