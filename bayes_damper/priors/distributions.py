"""The one-dimensional distributions that priors are made of.

Each is a small frozen record with its log density, quantile function and draws; priors.py reads them from TOML.
`coordinate` says in which coordinate a parameter moves best: "log" for scales, else "linear".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

Array = NDArray[np.float64]
Coordinate = Literal["linear", "log"]
_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


def _between(x: Array, lower: float, upper: float) -> Array:
    """As `numpy.clip`, which takes several times as long for short arrays."""
    return np.minimum(np.maximum(x, lower), upper)


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
        return _between(x, self.lower, self.upper)


@dataclass(frozen=True)
class LogScale:
    """A positive quantity that is known within a factor: ln x is symmetric about ln median, with scale ln factor."""

    median_value: float
    factor: float
    coordinate: Coordinate = "log"

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, math.inf


@dataclass(frozen=True)
class LogNormal(LogScale):
    """ln x is Gaussian about ln median with sd ln factor: two thirds of the mass lie within a factor `factor`."""

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
class LogStudent(LogScale):
    """ln x is Student's t with four degrees of freedom, about ln median with scale ln factor.

    As `LogNormal` near the median (63 % of the mass within a factor `factor`), with tails that a value may lie in: four
    scales out is one draw in 60, not one in 16 000. With four degrees of freedom quantiles have a closed form.
    """

    def logpdf(self, x: ArrayLike) -> Array:
        x = np.asarray(x, float)
        scale = math.log(self.factor)
        with np.errstate(divide="ignore", invalid="ignore"):
            ln = np.log(x)
            t = (ln - math.log(self.median_value)) / scale
            value = math.log(0.375 / scale) - 2.5 * np.log1p(0.25 * t**2) - ln
        return np.where(x > 0.0, value, -np.inf)

    def ppf(self, u: ArrayLike) -> Array:
        return from_standard(self, ndtri(np.asarray(u, float)))


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


# Standard coordinates: z = Phi^-1(F(x)), in which every prior is a unit Gaussian.

_FARTHEST = 37.0  # standard deviations beyond which a standard coordinate is not followed
_FARTHEST_T = 100.0  # scales beyond which a Student's t is not followed: factors of 1e47 for a scale of 3


def from_standard(distribution: Distribution, z: ArrayLike) -> Array:
    """The value x whose quantile in `distribution` is that of `z` in a unit Gaussian; accurate far into both tails."""
    y: Array = _between(np.asarray(z, float), -_FARTHEST, _FARTHEST)
    tailed = isinstance(distribution, LogStudent)
    if isinstance(distribution, LogScale):
        t = _student(y) if tailed else y
        return np.asarray(distribution.median_value * np.exp(math.log(distribution.factor) * t))
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
    return np.asarray(distribution.ppf(ndtr(_between(y, -8.0, 8.0))))


def columns_from_standard(distributions: Sequence[Distribution], z: Array) -> Array:
    """Values (k, n) of k distributions at standard coordinates z (n, k): `from_standard`, many columns in one go."""
    kinds = _kinds(tuple(distributions))
    y = _between(z.T, -_FARTHEST, _FARTHEST)
    x = np.empty(y.shape)
    if kinds.scales.size:
        t = y[kinds.scales]
        t[kinds.tailed] = _student(t[kinds.tailed])
        x[kinds.scales] = kinds.medians * np.exp(kinds.widths * t)
    if kinds.cut.size:
        with np.errstate(divide="ignore", invalid="ignore"):
            far = -ndtri_exp(log_ndtr(-y[kinds.cut]) + kinds.log_masses)
        x[kinds.cut] = np.maximum(kinds.means + kinds.sds * far, kinds.lowest)
    for i in kinds.others:
        x[i] = from_standard(distributions[i], y[i])
    return x


@dataclass(frozen=True)
class _Kinds:
    """Which of several distributions are of one kind, and their constants as columns (m, 1)."""

    scales: NDArray[np.intp]
    tailed: NDArray[np.bool_]  # which of `scales` have the tails of Student's t
    medians: Array
    widths: Array
    cut: NDArray[np.intp]
    means: Array
    sds: Array
    lowest: Array
    log_masses: Array
    others: tuple[int, ...]


@lru_cache(maxsize=64)
def _kinds(distributions: tuple[Distribution, ...]) -> _Kinds:
    scales = [(i, d) for i, d in enumerate(distributions) if isinstance(d, LogScale)]
    cut = [
        (i, d)
        for i, d in enumerate(distributions)
        if isinstance(d, Normal) and math.isfinite(d.lower) and math.isinf(d.upper)
    ]
    taken = {i for i, _ in (*scales, *cut)}
    return _Kinds(
        np.array([i for i, _ in scales], np.intp),
        np.array([isinstance(d, LogStudent) for _, d in scales], np.bool_),
        np.array([[d.median_value] for _, d in scales]),
        np.array([[math.log(d.factor)] for _, d in scales]),
        np.array([i for i, _ in cut], np.intp),
        np.array([[d.mean] for _, d in cut]),
        np.array([[d.sd] for _, d in cut]),
        np.array([[d.lower] for _, d in cut]),
        np.array([[log_ndtr((d.mean - d.lower) / d.sd)] for _, d in cut]),
        tuple(i for i in range(len(distributions)) if i not in taken),
    )


def to_standard(distribution: Distribution, x: ArrayLike) -> Array:
    """The standard coordinate of the value `x`, cut to +-8 where both ends of the distribution are: the inverse."""
    x = np.asarray(x, float)
    tailed = isinstance(distribution, LogStudent)
    if isinstance(distribution, LogScale):
        t = np.log(x / distribution.median_value) / math.log(distribution.factor)
        return _of_student(t) if tailed else np.asarray(t)
    if isinstance(distribution, HalfNormal):
        distribution = Normal(0.0, distribution.sd, lower=0.0)
    if isinstance(distribution, Normal):
        u = (x - distribution.mean) / distribution.sd
        a = (distribution.lower - distribution.mean) / distribution.sd
        b = (distribution.upper - distribution.mean) / distribution.sd
        if math.isinf(a) and math.isinf(b):
            return np.asarray(u)
        if math.isinf(b):
            return _above(u, a)
        if math.isinf(a):
            return -_above(-u, -b)
        low, high = ndtr(a), ndtr(b)
        share = (ndtr(u) - low) / (high - low)
    elif isinstance(distribution, LogUniform):
        share = np.log(np.maximum(x, distribution.lower) / distribution.lower) / math.log(
            distribution.upper / distribution.lower
        )
    else:
        low, high = distribution.support
        share = (x - low) / (high - low)
    return np.asarray(np.clip(ndtri(np.clip(share, 0.0, 1.0)), -8.0, 8.0))


def widths_out(distribution: Distribution, z: ArrayLike) -> Array:
    """How many widths (of a scale: factors) from the median: |z|, but in a tail that is heavier than a Gaussian one."""
    z = np.asarray(z, float)
    return np.asarray(np.abs(_student(z) if isinstance(distribution, LogStudent) else z))


def _student(z: Array) -> Array:
    """Student's t with four degrees of freedom whose quantile is that of z in a unit Gaussian.

    Both tails by their own mass p: cos a = 2 sqrt(p (1 - p)), t^2 / 4 = cos(a / 3) / cos a - 1 (Shaw, 2006, J. Comput.
    Finance 9).
    """
    tail = ndtr(-np.abs(z))
    cosine = 2.0 * np.sqrt(tail * (1.0 - tail))
    third = np.arctan2(1.0 - 2.0 * tail, cosine) / 3.0
    with np.errstate(divide="ignore"):
        t = 2.0 * np.sqrt(2.0 * np.sin(2.0 * third) * np.sin(third) / cosine)
    return np.asarray(np.copysign(np.minimum(t, _FARTHEST_T), z))


def _of_student(t: Array) -> Array:
    """Standard coordinate of a Student's t with four degrees of freedom: the inverse."""
    t = _between(np.asarray(t), -_FARTHEST_T, _FARTHEST_T)
    sine = np.abs(t) / np.sqrt(4.0 + t**2)
    tail = (4.0 / (4.0 + t**2) / (1.0 + sine)) ** 2 * (2.0 + sine) / 4.0
    return np.asarray(np.copysign(ndtri(tail), t))


def _above(u: Array, a: float) -> Array:
    """Standard coordinate of values u of a unit Gaussian that is cut below at a: each tail by its own mass."""
    with np.errstate(divide="ignore", invalid="ignore"):
        upper = -ndtri_exp(np.minimum(log_ndtr(-np.maximum(u, a)) - log_ndtr(-a), 0.0))
        lower = ndtri(np.clip((ndtr(u) - ndtr(a)) / ndtr(-a), 0.0, 1.0))
    return np.asarray(np.clip(np.where(upper > 0.0, upper, lower), -_FARTHEST, _FARTHEST))
