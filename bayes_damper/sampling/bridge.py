"""Evidence of a model from the draws of its posterior, by bridge sampling.

All in natural logarithms (nats). The log density must be that of the normalised prior times the normalised likelihood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logit, logsumexp

from bayes_damper.errors import InputError
from bayes_damper.sampling.convergence import autocorrelation_time
from bayes_damper.sampling.moves import StudentT

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
_FREEDOM = 6.0


@dataclass(frozen=True)
class Evidence:
    """Log evidence with its standard error; `health` is the effective share of the proposal's draws (below 0.05:
    distrust); `spread` is the difference of the two independent halves.
    """

    log_z: float
    error: float
    health: float
    spread: float
    evaluations: int

    @property
    def trusted(self) -> bool:
        """Whether the halves agree and enough proposals count."""
        return self.health >= 0.05 and self.spread <= 5.0 * max(2.0 * self.error, 0.01)

    @property
    def sentence(self) -> str:
        """The answer and its health in words."""
        return self.words()

    def words(self, constant: float = 0.0) -> str:
        """The same of a density that is larger by exp(constant)."""
        sentence = (
            f"Log evidence {self.log_z + constant:.3f} +- {self.error:.3f} nats; {self.health:.0%} of the proposals "
            "count."
        )
        if not self.trusted:
            sentence += " Distrust it: the posterior is unlike any Student t."
        return sentence


def bridge(
    target: LogDensity,
    draws: Array,
    log_prob: Array,
    rng: np.random.Generator,
    *,
    bounds: tuple[Array, Array] | None = None,
    proposals: int = 8000,
) -> Evidence:
    """Log evidence by bridge sampling (Meng and Wong 1996, Statistica Sinica 6:831).

    draws : (ensembles, steps, walkers, ndim) and log_prob : (ensembles, steps, walkers) of a converged run, two
    ensembles or more; bounds : (lower, upper), each (ndim,), infinite where there is none: bounded coordinates are
    unfolded by a logit or a logarithm. A Student t is fitted to half of the ensembles in these coordinates and
    bridged with the
    other half, then the other way round; the answer is the mean of both.
    """
    if len(draws) < 2:
        raise InputError("The evidence needs two ensembles or more: one half fits the proposal, the other checks it.")
    ndim = draws.shape[-1]
    map_ = _Unfolding(*(bounds or (np.full(ndim, -np.inf), np.full(ndim, np.inf))))
    half = len(draws) // 2
    groups = [slice(0, half), slice(half, None)]
    parts = []
    for own, other in (groups, groups[::-1]):
        parts.append(_one_bridge(target, map_, draws[own], draws[other], log_prob[other], rng, proposals // 2))
    log_z = float(np.mean([p[0] for p in parts]))
    error = float(np.sqrt(sum(p[1] ** 2 for p in parts)) / 2)
    health = min(p[2] for p in parts)
    spread = abs(parts[0][0] - parts[1][0])
    return Evidence(log_z, error, health, spread, 2 * (proposals // 2))


class _Unfolding:
    """Coordinates without bounds: logit between two bounds, logarithm beside one, as they are without."""

    def __init__(self, lower: Array, upper: Array) -> None:
        self.lower, self.upper = np.asarray(lower, float), np.asarray(upper, float)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        self.both, self.below, self.above = low & high, low & ~high, high & ~low

    def unfold(self, x: Array) -> Array:
        u = x.copy()
        b, lo, hi = self.both, self.below, self.above
        share = (x[:, b] - self.lower[b]) / (self.upper[b] - self.lower[b])
        u[:, b] = logit(np.clip(share, 1e-15, 1 - 1e-15))
        u[:, lo] = np.log(np.maximum(x[:, lo] - self.lower[lo], 1e-300))
        u[:, hi] = np.log(np.maximum(self.upper[hi] - x[:, hi], 1e-300))
        return u

    def fold(self, u: Array) -> tuple[Array, Array]:
        """Points and log of the volume factor dx / du of each, (n, ndim) and (n,)."""
        x = u.copy()
        b, lo, hi = self.both, self.below, self.above
        width = self.upper[b] - self.lower[b]
        x[:, b] = self.lower[b] + width * expit(u[:, b])
        x[:, lo] = self.lower[lo] + np.exp(np.minimum(u[:, lo], 700.0))
        x[:, hi] = self.upper[hi] - np.exp(np.minimum(u[:, hi], 700.0))
        volume = (np.log(width) + log_expit(u[:, b]) + log_expit(-u[:, b])).sum(axis=1)
        return x, volume + u[:, lo].sum(axis=1) + u[:, hi].sum(axis=1)


def _one_bridge(
    target: LogDensity, map_: _Unfolding, fit: Array, use: Array, heights: Array, rng: np.random.Generator, count: int
) -> tuple[float, float, float]:
    """Log evidence, its standard error, effective share of proposals, from one half fitted and the other used."""
    ndim = fit.shape[-1]
    known = map_.unfold(fit.reshape(-1, ndim))
    covariance = np.atleast_2d(np.cov(known.T))
    shape = StudentT(known.mean(axis=0), covariance * (_FREEDOM - 1.0) / _FREEDOM, _FREEDOM)
    points = map_.unfold(use.reshape(-1, ndim))
    chain = heights.reshape(-1) + map_.fold(points)[1] - shape.log_density(points)  # log of target over proposal
    fresh = shape.draw(rng, count)
    folded, volume = map_.fold(fresh)
    values = np.asarray(target(folded), dtype=float)
    proposed = np.where(np.isnan(values), -np.inf, values) + volume - shape.log_density(fresh)
    tau = float(np.nanmean(autocorrelation_time(chain.reshape(heights.shape))))
    size = max(len(chain) / tau, 2.0)  # effective
    share = size / (size + count)
    log_z = float(logsumexp(proposed) - np.log(count))
    for _ in range(200):
        up = logsumexp(proposed - np.logaddexp(np.log(share) + proposed, np.log1p(-share) + log_z)) - np.log(count)
        down = logsumexp(-np.logaddexp(np.log(share) + chain, np.log1p(-share) + log_z)) - np.log(len(chain))
        change, log_z = float(up - down) - log_z, float(up - down)
        if abs(change) < 1e-10:
            break
    f1 = np.exp(proposed - log_z - np.logaddexp(np.log(share) + proposed - log_z, np.log1p(-share)))
    f2 = np.exp(-np.logaddexp(np.log(share) + chain - log_z, np.log1p(-share)))
    error = np.sqrt(f1.var() / f1.mean() ** 2 / count + f2.var() / f2.mean() ** 2 / size)
    weights = np.exp(proposed - proposed.max())
    return log_z, float(error), float(weights.sum() ** 2 / (weights**2).sum() / count)
