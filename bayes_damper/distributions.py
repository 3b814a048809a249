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
from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

Array = NDArray[np.float64]
Coordinate = Literal["linear", "log"]
_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


class Distribution(Protocol):
    """What every distribution offers."""

    @property
    def coordinate(self) -> Coordinate:
        """The coordinate in which a sampler moves best."""
        ...

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
        x = self.mean + self.sd * ndtri(low + np.asarray(u, float) * (high - low))
        return np.asarray(np.clip(x, self.lower, self.upper))


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
        return np.asarray(self.median_value * np.exp(math.log(self.factor) * ndtri(np.asarray(u, float))))


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
        return np.asarray(self.sd * ndtri(0.5 + 0.5 * np.asarray(u, float)))


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


# Standard coordinates: z = Phi^-1(F(x)), in which every prior is a unit Gaussian.

_FARTHEST = 37.0  # standard deviations beyond which a standard coordinate is not followed


def from_standard(distribution: Distribution, z: ArrayLike) -> Array:
    """The value x whose quantile in `distribution` is that of `z` in a unit Gaussian; accurate far into both tails."""
    y: Array = np.clip(np.asarray(z, float), -_FARTHEST, _FARTHEST)
    if isinstance(distribution, LogNormal):
        return np.asarray(distribution.median_value * np.exp(math.log(distribution.factor) * y))
    if isinstance(distribution, HalfNormal):
        # x / sd = -Phi^-1(Phi(-y) / 2): the upper tail is a lower tail of half its mass.
        with np.errstate(divide="ignore", invalid="ignore"):
            far = -ndtri_exp(log_ndtr(-y) - math.log(2.0))
        return np.asarray(distribution.sd * np.where(y > -5.0, far, math.sqrt(math.pi / 2.0) * ndtr(y)))
    if isinstance(distribution, Normal):
        a = (distribution.lower - distribution.mean) / distribution.sd
        b = (distribution.upper - distribution.mean) / distribution.sd
        if math.isinf(a) and math.isinf(b):
            return np.asarray(distribution.mean + distribution.sd * y)
        if math.isinf(b):  # cut below only: mirror, so that the far tail keeps its digits
            with np.errstate(divide="ignore", invalid="ignore"):
                x = -ndtri_exp(log_ndtr(-y) + log_ndtr(-a))
            return np.asarray(np.maximum(distribution.mean + distribution.sd * x, distribution.lower))
        if math.isinf(a):
            with np.errstate(divide="ignore", invalid="ignore"):
                x = ndtri_exp(log_ndtr(y) + log_ndtr(b))
            return np.asarray(np.minimum(distribution.mean + distribution.sd * x, distribution.upper))
    return np.asarray(distribution.ppf(ndtr(np.clip(y, -8.0, 8.0))))


def to_standard(distribution: Distribution, x: ArrayLike) -> Array:
    """The standard coordinate of the value `x`, cut to +-8 where there is no closed form: the inverse of the above."""
    x = np.asarray(x, float)
    if isinstance(distribution, LogNormal):
        return np.asarray(np.log(x / distribution.median_value) / math.log(distribution.factor))
    if isinstance(distribution, Normal) and math.isinf(distribution.lower) and math.isinf(distribution.upper):
        return np.asarray((x - distribution.mean) / distribution.sd)
    low, high = np.full(x.shape, -8.0), np.full(x.shape, 8.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = from_standard(distribution, middle) > x
        high, low = np.where(above, middle, high), np.where(above, low, middle)
    return np.asarray(0.5 * (low + high))
