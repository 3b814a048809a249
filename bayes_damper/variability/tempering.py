"""Sequential Monte Carlo: draws of a posterior and its evidence at once, by raising the likelihood from power 0 to 1.

All coordinates have unit Gaussian priors. The particles start as draws of the prior; at each stage the power of the
likelihood is raised until half of the particles count, they are drawn anew by their weights, and moved by Metropolis
steps block by block until they have forgotten where they stood. The product of the mean weights is the evidence. Unlike
a chain this needs no start, finds several modes, and works for a hierarchy of forty unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_FEWEST_SWEEPS, _MOST_SWEEPS = 3, 30
_FORGOTTEN = 0.25
"""Correlation of the particles with their places at the start of a stage below which they have moved enough."""
_MOST_STAGES = 400


@dataclass(frozen=True)
class Block:
    """Coordinates that are moved together, and the parts of the likelihood that they change.

    carried : coordinates that follow along the regression line of the particles, such as each case's spring when the
    inertia that divides all springs moves.
    """

    columns: Index
    parts: Index
    carried: Index | None = None


class Target(Protocol):
    """A likelihood in parts (one a case), each a function of all coordinates."""

    @property
    def ndim(self) -> int:
        """Number of coordinates."""

    @property
    def parts(self) -> int:
        """Number of parts."""

    @property
    def blocks(self) -> Sequence[Block]:
        """How the coordinates are moved."""

    def log_likelihood(self, points: Array, parts: Index) -> Array:
        """Log likelihood of the chosen parts at points (n, ndim): (n, len(parts))."""

    def straight(self, points: Array, block: int) -> Array:
        """A block's coordinates (n, k) in which steps are taken: bent ridges made straight, with constant volume."""

    def bent(self, points: Array, block: int, steps: Array) -> Array:
        """The points with a block's coordinates replaced by what `straight` gives as `steps` (n, k)."""

    def refresh(self, points: Array, rng: np.random.Generator) -> Array:
        """Points moved so that prior and likelihood together stay as they are, at no cost; may do nothing."""


@dataclass(frozen=True)
class Tempered:
    """points (n, ndim), equally weighted; log_likelihood (n, parts); log evidence with its standard error (from the
    weights' spread stage by stage); stages; forgotten: worst correlation that a stage left.
    """

    points: Array
    log_likelihood: Array
    log_z: float
    error: float
    stages: int
    forgotten: float


def temper(
    target: Target,
    rng: np.random.Generator,
    particles: int = 512,
    tell: Callable[[float, str], None] | None = None,
) -> Tempered:
    """Draws and evidence of a target.

    Raises
    ------
    InputError
        if the likelihood is zero at all draws of the prior, or its peak is too narrow to be reached.
    """
    everything = np.arange(target.parts)
    points = rng.standard_normal((particles, target.ndim))
    value = _clean(target.log_likelihood(points, everything))
    power, log_z, variance, stages, worst = 0.0, 0.0, 0.0, 0, 0.0
    steps = dict.fromkeys(range(len(target.blocks)), 0.6)
    while power < 1.0:
        total = value.sum(axis=1)
        if not np.any(np.isfinite(total)):
            raise InputError("the likelihood is zero at all draws of the prior: widen the priors, or check the units")
        stages += 1
        if stages > _MOST_STAGES:
            raise InputError("the posterior is too narrow for tempering; use the records' Laplace version")
        rise = _next_power(total, power)
        weights = (rise - power) * np.where(np.isfinite(total), total, -np.inf)
        log_z += float(logsumexp(weights) - math.log(particles))
        share = np.exp(weights - logsumexp(weights))
        variance += float(particles * np.sum(share**2) - 1.0) / particles
        chosen = _systematic(share, rng)
        points, value, power = points[chosen], value[chosen], rise
        points, value, left = _move(target, points, value, power, steps, rng)
        worst = max(worst, left)
        if tell is not None:
            tell(power, f"likelihood at power {power:.3g}")
    return Tempered(points, value, log_z, math.sqrt(variance), stages, worst)


def _clean(value: Array) -> Array:
    return np.where(np.isnan(value), -np.inf, value)


def _next_power(total: Array, power: float) -> float:
    """The power at which half of the particles count, at most 1."""

    def count(rise: float) -> float:
        w = (rise - power) * total
        w = np.exp(w - w.max())
        return float(w.sum() ** 2 / (w**2).sum())

    finite = np.where(np.isfinite(total), total, -np.inf)
    total = np.where(np.isfinite(finite), finite, finite[np.isfinite(finite)].min() - 1e6)
    goal = 0.5 * len(total)
    if count(1.0) >= goal:
        return 1.0
    low, high = power, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if count(middle) >= goal else (low, middle)
    # A few points of zero likelihood may already be more than half: go on with what there is.
    return max(low, power + 1e-12)


def _systematic(share: Array, rng: np.random.Generator) -> Index:
    places = (rng.random() + np.arange(len(share))) / len(share)
    return np.minimum(np.searchsorted(np.cumsum(share), places), len(share) - 1)


def _move(
    target: Target, points: Array, value: Array, power: float, steps: dict[int, float], rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Metropolis sweeps over all blocks until the particles have forgotten their places."""
    begin = points.copy()
    left = 1.0
    for sweep in range(_MOST_SWEEPS):
        for i in range(len(target.blocks)):
            points, value, accepted = _step(target, i, points, value, power, steps[i], sweep % 2 == 1, rng)
            if sweep % 2 == 0:
                steps[i] = float(np.clip(steps[i] * math.exp(0.6 * (accepted - 0.3)), 0.03, 1.0))
        points = target.refresh(points, rng)
        if sweep + 1 >= _FEWEST_SWEEPS:
            left = _memory(begin, points)
            if left < _FORGOTTEN:
                break
    return points, value, left


def _memory(before: Array, now: Array) -> float:
    """Mean over the coordinates of the correlation between two sets of places, after resampling."""
    a, b = before - before.mean(axis=0), now - now.mean(axis=0)
    return float(np.mean(np.sum(a * b, axis=0) / np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0) + 1e-300)))


def _step(
    target: Target, which: int, points: Array, value: Array, power: float, size: float, differences: bool,
    rng: np.random.Generator,
) -> tuple[Array, Array, float]:  # fmt: skip
    """One Metropolis step of a block for all particles, half after half: each half moves by the shape of the other.

    Either a step that keeps a Gaussian of the other half's mean and covariance (as `size` allows), or a step along the
    difference of two particles of the other half.
    """
    block = target.blocks[which]
    n, k = len(points), len(block.columns)
    points, value = points.copy(), value.copy()
    halves = np.array_split(rng.permutation(n), 2)
    accepted = 0
    for own, other in (halves, halves[::-1]):
        x, reference = target.straight(points[own], which), target.straight(points[other], which)
        correction = np.zeros(len(own))
        if differences:
            first, second = (reference[rng.integers(len(other), size=len(own))] for _ in range(2))
            # Steps of all sizes: what is left of a ridge's bend takes short ones.
            gamma = 2.38 / math.sqrt(2.0 * k) * np.exp(rng.uniform(-3.0, 0.3, len(own)))
            proposed = x + gamma[:, None] * (first - second) + 1e-3 * rng.standard_normal(x.shape)
        else:
            mean = reference.mean(axis=0)
            # Shrunk towards the diagonal: few particles, many coordinates.
            covariance = np.cov(reference.T).reshape(k, k)
            covariance = 0.95 * covariance + 0.05 * np.diag(np.diag(covariance)) + 1e-9 * np.eye(k)
            root = np.linalg.cholesky(covariance)
            noise = rng.standard_normal(x.shape) @ root.T
            proposed = mean + math.sqrt(1.0 - size**2) * (x - mean) + size * noise
            inverse = np.linalg.inv(root)
            correction = 0.5 * (
                np.sum(((proposed - mean) @ inverse.T) ** 2, axis=1) - np.sum(((x - mean) @ inverse.T) ** 2, axis=1)
            )
        candidate = target.bent(points[own], which, proposed)
        if block.carried is not None and len(block.carried):
            # A shear: volume is kept, and the way back is the same.
            slopes = _slopes(reference, points[np.ix_(other, block.carried)])
            candidate[:, block.carried] += (proposed - x) @ slopes
        fresh = _clean(target.log_likelihood(candidate, block.parts))
        gain = power * (fresh.sum(axis=1) - value[np.ix_(own, block.parts)].sum(axis=1))
        gain = gain + correction + 0.5 * (np.sum(points[own] ** 2, axis=1) - np.sum(candidate**2, axis=1))
        taken = np.log(rng.random(len(own))) < gain
        points[own[taken]] = candidate[taken]
        value[np.ix_(own[taken], block.parts)] = fresh[taken]
        accepted += int(taken.sum())
    return points, value, accepted / n


def _slopes(x: Array, y: Array) -> Array:
    """Regression of y (n, j) on x (n, k): (k, j), drawn slightly towards zero."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    gram = x.T @ x
    return np.asarray(np.linalg.solve(gram + (1e-9 + 0.02 * np.trace(gram) / len(gram)) * np.eye(len(gram)), x.T @ y))
