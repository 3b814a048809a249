"""Ensemble moves for emcee, without Python loops over walkers.

Each has the method that emcee asks of a move, so that it is emcee's `EnsembleSampler` that samples; what is ours is the
proposal.
One step updates the two halves of the ensemble in turn, each from the other (Foreman-Mackey et al. 2013), halves drawn
afresh at each step. The walkers of a half are proposed, evaluated and decided upon as arrays, and the target is called
directly with the whole half, which leaves emcee a few microseconds per walker less to do.

emcee's own `DESnookerMove` (3.1.6) is not used: it loops over the walkers, and it does not keep a Gaussian target
(tests/test_moves.py): it projects with delta / sqrt(|delta|) in place of the unit vector, a length that changes with
the state and that its acceptance rule does not make up for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

Array = NDArray[np.float64]
_TINY = 1e-300
_MOST_TURNS = 60
_NO_GAIN = 1e-2  # nats per draw from one turn to the next


class HalvesMove(ABC):
    """A step that moves each half of the ensemble with the help of the other, which is at rest meanwhile.

    A variant supplies `proposal` alone. `tried` and `taken` count proposals and acceptances, `undefined` the points
    where the target was NaN (never accepted).
    """

    def __init__(self) -> None:
        self.tried = 0
        self.taken = 0
        self.undefined = 0

    @abstractmethod
    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:
        """New points for `moving` (n, ndim), and log of the ratio of reverse to forward proposal density, (n,) or 0."""

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:  # emcee's own types
        """One step of emcee: moves both halves of `state` in place; returns it and who moved, (walkers,) bool."""
        coords, log_prob, random = state.coords, state.log_prob, model.random
        walkers = len(coords)
        order = random.permutation(walkers)
        first, second = order[: walkers // 2], order[walkers // 2 :]
        accepted = np.zeros(walkers, dtype=bool)
        for moving, resting in ((first, second), (second, first)):
            points, log_ratio = self.proposal(coords[moving], coords[resting], random)
            proposed = np.asarray(model.log_prob_fn(points), dtype=float)
            gain = log_ratio + proposed - log_prob[moving]
            take = gain > -random.standard_exponential(len(moving))  # a NaN compares as false
            self.tried += len(moving)
            self.taken += int(np.count_nonzero(take))
            self.undefined += int(np.count_nonzero(np.isnan(proposed)))
            moved = moving[take]
            coords[moved] = points[take]
            log_prob[moved] = proposed[take]
            accepted[moved] = True
        return state, accepted


class DifferentialEvolution(HalvesMove):
    """x' = x + gamma (z1 - z2), z1 and z2 two other walkers (ter Braak 2006, Statistics and Computing 16:239).

    gamma : 2.38 / sqrt(2 ndim) by default, times exp(spread * standard normal); gamma = 1 jumps between modes, since
    the difference of two walkers in two modes then leads from one mode into the other.
    The factor does not depend on the state, so the proposal is symmetric.
    """

    def __init__(self, gamma: float | None = None, spread: float = 0.0) -> None:
        super().__init__()
        self.gamma = gamma
        self.spread = spread

    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:
        count, ndim = moving.shape
        first, second, _ = _distinct(random, count, len(resting))
        gamma = 2.38 / np.sqrt(2.0 * ndim) if self.gamma is None else self.gamma
        factor = gamma * np.exp(self.spread * random.standard_normal((count, 1)))
        return moving + factor * (resting[first] - resting[second]), 0.0


class Snooker(HalvesMove):
    """A step along the line to a third walker, as long as the distance of two more walkers seen along that line.

    x' = x + gamma u (u . (z1 - z2)), u = (x - z) / |x - z|, accepted with the extra factor (|x' - z| / |x - z|)^(d-1)
    (ter Braak and Vrugt 2008, Statistics and Computing 18:435, eq. 4; gamma = 1.7 by default, uniform on 1.2..2.2 as
    there).
    """

    def __init__(self, low: float = 1.2, high: float = 2.2) -> None:
        super().__init__()
        self.low = low
        self.high = high

    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:
        count, ndim = moving.shape
        first, second, third = _distinct(random, count, len(resting))
        line = moving - resting[third]
        square = np.maximum(np.einsum("ij,ij->i", line, line), _TINY)
        along = np.einsum("ij,ij->i", line, resting[first] - resting[second])
        gamma = self.low + (self.high - self.low) * random.random_sample(count)
        stretch = 1.0 + gamma * along / square  # (n,) x' - z = stretch (x - z)
        points = resting[third] + stretch[:, None] * line
        return points, (ndim - 1) * np.log(np.maximum(np.abs(stretch), _TINY))


class Independence(HalvesMove):
    """Draws from a fixed mixture of Student t distributions that resembles the target, whatever the walker's own place.

    shares : (k,) weights that sum to 1; centres : (k, ndim); covariances : (k, ndim, ndim) scale matrices; freedom :
    degrees of freedom, small for heavy tails. All are fixed before the draws that count: a proposal that kept learning
    would break detailed balance.
    """

    def __init__(self, shares: Array, centres: Array, covariances: Array, freedom: float = 6.0) -> None:
        super().__init__()
        self.shares = np.asarray(shares, dtype=float)
        self.shapes = [StudentT(c, s, freedom) for c, s in zip(centres, covariances, strict=True)]

    def log_density(self, points: Array) -> Array:
        """Log density of the mixture at points (n, ndim), (n,)."""
        each = [np.log(w) + shape.log_density(points) for w, shape in zip(self.shares, self.shapes, strict=True)]
        return np.asarray(np.logaddexp.reduce(each, axis=0))

    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:  # noqa: ARG002
        owner = np.searchsorted(np.cumsum(self.shares)[:-1], random.random_sample(len(moving)), side="right")
        points = np.empty_like(moving)
        for k, shape in enumerate(self.shapes):
            mine = owner == k
            if mine.any():
                points[mine] = shape.draw(random, int(mine.sum()))
        return points, self.log_density(moving) - self.log_density(points)


def fit_mixture(draws: Array, most: int = 12) -> tuple[Array, Array, Array]:
    """Shares (k,), centres (k, ndim) and covariances (k, ndim, ndim) of a Gaussian mixture fitted to draws (n, ndim).

    k is 1, 4 or `most`, whichever fitted to the first half of the draws predicts the second half best: not every other
    draw, for neighbours in time may be one and the same point, and would reward a mixture that knows it by heart.
    """
    ndim = draws.shape[1]
    spread = np.maximum(draws.std(axis=0), 1e-300)
    white = (draws - draws.mean(axis=0)) / spread
    first, second = white[: len(white) // 2], white[len(white) // 2 :]
    options = [k for k in (1, 4, most) if k * 4 * ndim <= len(first)] or [1]
    scores = [float(np.logaddexp.reduce(_terms(second, *_normals(first, k)), axis=1).mean()) for k in options]
    shares, centres, covariances = _normals(white, options[int(np.argmax(scores))])
    return shares, draws.mean(axis=0) + centres * spread, covariances * spread[:, None] * spread


def _normals(points: Array, k: int) -> tuple[Array, Array, Array]:
    """Shares, centres and covariances of k normal distributions by expectation and maximisation, from centres spread
    as in k-means++ (Arthur and Vassilvitskii 2007). Cut short after some turns: it still proposes well.

    Each covariance counts as if 2 ndim draws more had that of the parts on average (an inverse Wishart prior): a part
    of few draws otherwise fits these and nothing else (Fraley and Raftery 2007, J. Classification 24:155).
    """
    n, ndim = points.shape
    rng = np.random.default_rng(0)
    chosen = points[rng.integers(n)][None]
    square = np.full(n, np.inf)
    nearest = np.zeros(n, dtype=np.intp)
    for i in range(k):
        distance = ((points - chosen[i]) ** 2).sum(axis=1)
        nearest[distance < square] = i
        square = np.minimum(square, distance)
        total = np.cumsum(square)
        chosen = np.vstack([chosen, points[min(int(np.searchsorted(total, rng.random() * total[-1])), n - 1)]])
    belongs = np.eye(k)[nearest]
    last = -np.inf
    for _ in range(_MOST_TURNS if k > 1 else 1):
        counts = belongs.sum(axis=0) + 1e-9
        centres = belongs.T @ points / counts[:, None]
        weighted = (belongs[:, :, None] * points[:, None, :]).reshape(n, k * ndim)
        covariances = (weighted.T @ points).reshape(k, ndim, ndim) / counts[:, None, None]
        covariances += 1e-6 * np.eye(ndim) - centres[:, :, None] * centres[:, None, :]
        shares = np.maximum(counts / n, 1e-6)
        shares /= shares.sum()
        if k == 1:
            break
        known = (counts / (counts + 2.0 * ndim))[:, None, None]
        covariances = known * covariances + (1.0 - known) * np.tensordot(shares, covariances, 1)
        terms = _terms(points, shares, centres, covariances)
        highest = terms.max(axis=1)
        belongs = np.exp(terms - highest[:, None])
        total = belongs.sum(axis=1)
        belongs /= total[:, None]
        level = highest + np.log(total)
        if level.mean() - last < _NO_GAIN:
            break
        last = float(level.mean())
    return shares, centres, covariances


def _terms(points: Array, shares: Array, centres: Array, covariances: Array) -> Array:
    """Log of share times density of each normal distribution at each point, (n, k)."""
    k, ndim = centres.shape
    root = np.linalg.cholesky(covariances)
    inverse = np.linalg.inv(root)
    white = points @ inverse.reshape(k * ndim, ndim).T - np.einsum("kij,kj->ki", inverse, centres).ravel()
    square = np.square(white).reshape(len(points), k, ndim).sum(axis=2)
    size = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + 0.5 * ndim * np.log(2.0 * np.pi)
    return np.asarray(np.log(shares) - size - 0.5 * square)


class StudentT:
    """Multivariate Student t: centre (ndim,), scale matrix (ndim, ndim), degrees of freedom."""

    def __init__(self, centre: Array, covariance: Array, freedom: float) -> None:
        self.centre = np.array(centre, dtype=float)
        self.covariance = np.array(covariance, dtype=float)
        self.freedom = float(freedom)
        self._root = np.linalg.cholesky(self.covariance)
        self._inverse_root = np.linalg.inv(self._root)
        ndim = len(self.centre)
        half = 0.5 * self.freedom
        self._constant = float(
            gammaln(half + 0.5 * ndim)
            - gammaln(half)
            - 0.5 * ndim * np.log(np.pi * self.freedom)
            - np.log(np.diag(self._root)).sum()
        )

    def draw(self, random: np.random.RandomState | np.random.Generator, count: int) -> Array:
        """`count` points, (count, ndim)."""
        normal = random.standard_normal((count, len(self.centre)))
        scale = np.sqrt(self.freedom / (2.0 * random.standard_gamma(0.5 * self.freedom, count)))
        return np.asarray(self.centre + (normal * scale[:, None]) @ self._root.T)

    def log_density(self, points: Array) -> Array:
        """Log density of each of the points (n, ndim), (n,)."""
        white = (points - self.centre) @ self._inverse_root.T
        square = np.einsum("ij,ij->i", white, white)
        power = -0.5 * (self.freedom + len(self.centre))
        return np.asarray(self._constant + power * np.log1p(square / self.freedom))


def _distinct(random: np.random.RandomState, count: int, size: int) -> tuple[Array, Array, Array]:
    """Three integer arrays (count,), each triple three different numbers below size, all equally likely."""
    draw = random.random_sample((3, count))
    first = (draw[0] * size).astype(np.intp)
    second = (draw[1] * (size - 1)).astype(np.intp)
    second += second >= first
    low, high = np.minimum(first, second), np.maximum(first, second)
    third = (draw[2] * (size - 2)).astype(np.intp)
    third += third >= low
    third += third >= high
    return first, second, third
