"""Are ranks uniform? Simulation-based calibration (Talts et al. 2018, arXiv:1804.06788).

If truths are drawn from the prior and data from the truths, the rank of each truth among L independent draws of its
posterior is uniform on 0..L. Whether a set of ranks looks so is judged by its cumulative distribution against a band
that holds it at all L points at once (Saeilynoja, Buerkner and Vehtari 2022, Statistics and Computing 32:32); the band
is found by simulation here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, binom

Array = NDArray[np.float64]
DRAWS = 99
"""Posterior draws L that each truth is ranked among."""


def counts(ranks: Sequence[int], draws: int = DRAWS) -> NDArray[np.int64]:
    """How many ranks lie below 1, 2, ... L: the cumulative distribution, (L,)."""
    return np.searchsorted(np.sort(np.asarray(ranks)), np.arange(1, draws + 1), side="left")


def extremity(below: NDArray[np.int64], n: int, draws: int = DRAWS) -> Array:
    """Twice the smallest tail probability that any point of a cumulative distribution (..., L) of n ranks has."""
    p = np.arange(1, draws + 1) / (draws + 1.0)
    low, high = binom.cdf(below, n, p), binom.sf(below - 1, n, p)
    return np.asarray(2.0 * np.minimum(low, high).min(axis=-1))


@cache
def _null(n: int, draws: int = DRAWS, simulations: int = 20_000) -> Array:
    """Sorted extremities of n uniform ranks."""
    rng = np.random.default_rng(20221)
    parts = []
    for _ in range(simulations // 1000):
        histogram = rng.multinomial(n, np.full(draws + 1, 1.0 / (draws + 1)), size=1000)
        parts.append(extremity(np.cumsum(histogram, axis=1)[:, :-1], n, draws))
    return np.sort(np.concatenate(parts))


def p_value(ranks: Sequence[int], draws: int = DRAWS) -> float:
    """Probability that uniform ranks stray at least as far, at the point where they stray farthest."""
    null = _null(len(ranks), draws)
    found = float(extremity(counts(ranks, draws), len(ranks), draws))
    return float((1 + np.searchsorted(null, found * (1.0 + 1e-9), side="right")) / (1 + null.size))


def band(n: int, level: float = 0.95, draws: int = DRAWS) -> tuple[Array, Array]:
    """Lowest and highest counts (L,) of the simultaneous band of n ranks."""
    gamma = float(np.quantile(_null(n, draws), 1.0 - level))
    p = np.arange(1, draws + 1) / (draws + 1.0)
    return binom.ppf(gamma / 2.0, n, p), binom.isf(gamma / 2.0, n, p)


def coverage(ranks: Sequence[int], share: float, draws: int = DRAWS) -> tuple[int, float, float]:
    """How many truths lie in their central interval of `share`, and the 95 % interval of the true rate (Clopper and
    Pearson 1934).
    """
    outside = round((draws + 1) * (1.0 - share) / 2.0)
    r = np.asarray(ranks)
    hits, n = int(np.count_nonzero((r >= outside) & (r <= draws - outside))), len(r)
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits > 0 else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return hits, low, high


def least_of(p_values: Sequence[float]) -> float:
    """Probability that the least of so many independent p-values is as small (Sidak); conservative if they are not."""
    return float(-np.expm1(len(p_values) * np.log1p(-min(*p_values, 1.0 - 1e-12))))
