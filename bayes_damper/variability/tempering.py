"""Sequential Monte Carlo: draws of a posterior and its evidence at once, by raising the likelihood from power 0 to 1.

All coordinates have unit Gaussian priors. The particles start as draws of the prior; at each stage the power of the
likelihood is raised until half of the places count, particles are drawn anew by their weights, and moved by Metropolis
steps block by block until they have forgotten where they stood. The product of the mean weights is the evidence. Every
place that a particle went through on its way counts in the next stage, not the last alone (waste-free; Dau and Chopin
2022, J. R. Statist. Soc. B 84:114): where steps are short, as on a thin and bent posterior, that is what keeps places
apart. At the full power the particles go on until each unknown by itself is forgotten. Unlike a chain this needs no
start, finds several modes, and works for a hierarchy of forty unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.errors import InputError
from bayes_damper.variability.guide import Guide

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_FEWEST_SWEEPS, _MOST_SWEEPS = 3, 30
_LAST_SWEEPS = 10 * _MOST_SWEEPS
"""Most sweeps at the full power."""
_FORGOTTEN = 0.25
"""Correlation of the particles with their places at the start of a stage below which they have moved enough: the mean
over the unknowns at a stage on the way, the largest at the full power."""
_KEPT = 30
"""Most places of a particle that are kept of a stage."""
_FIRST = 8
"""Draws of the prior for each particle."""
_LEARNT = 4000
"""Most places that steps are learnt from."""
_PARTS, _PARTS_AT_LAST = 4, 12
"""Most parts of a guide's mixture, on the way and at the full power."""
_MOST_STAGES = 400


@dataclass(frozen=True)
class Block:
    """Coordinates that are moved together, and the parts of the likelihood that they change.

    carried : coordinates that follow along the regression line of the particles. followers : blocks whose straight
    coordinates follow in that way, such as each case's own when the inertia that divides all of them moves. given :
    coordinates at rest on which the block's place hangs: most steps are then those of a `Guide` learnt from both, for
    what those leave of the block can be far thinner than the block's own cloud, and bent.
    """

    columns: Index
    parts: Index
    carried: Index | None = None
    followers: tuple[int, ...] = ()
    given: Index | None = None


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

    def unknowns(self, points: Array) -> Array:
        """What is asked for, (n, k): the quantities that the particles must forget."""


@dataclass(frozen=True)
class Tempered:
    """What `temper` finds.

    points (n, ndim), equally weighted: each particle at several times of the last stage, the latest last;
    log_likelihood (n, parts); log evidence with its standard error (from the weights' spread over the particles, stage
    by stage); stages; forgotten: worst mean correlation that a stage left; last: largest correlation of an unknown with
    its place before the last stage.
    """

    points: Array
    log_likelihood: Array
    log_z: float
    error: float
    stages: int
    forgotten: float
    last: float


def temper(
    target: Target,
    rng: np.random.Generator,
    particles: int = 512,
    tell: Callable[[float, str], None] | None = None,
    kept: int = 1,
    settle: bool = True,
) -> Tempered:
    """Draws and evidence of a target; `kept` places of each particle are returned.

    settle : whether the particles go on at the full power; False where the evidence is all that is asked for.

    Raises
    ------
    InputError
        if the likelihood is zero at all draws of the prior, or its peak is too narrow to be reached.
    """
    trail = rng.standard_normal((1, _FIRST * particles, target.ndim))
    heights = _clean(target.log_likelihood(trail[0], np.arange(target.parts)))[None]
    power, log_z, variance, stages, worst, left = 0.0, 0.0, 0.0, 0, 0.0, 1.0
    steps = dict.fromkeys(range(len(target.blocks)), 0.6)
    last = False
    while not last:
        total = heights.sum(axis=2)  # (times, chains)
        if not np.any(np.isfinite(total)):
            raise InputError("the likelihood is zero at all draws of the prior: widen the priors, or check the units")
        stages += 1
        if stages > _MOST_STAGES:
            raise InputError("the posterior is too narrow for tempering; use the records' Laplace version")
        last = power == 1.0
        rise = 1.0 if last else _next_power(total.ravel(), power)
        weights = np.zeros(total.shape) if last else (rise - power) * np.where(np.isfinite(total), total, -np.inf)
        whole = float(logsumexp(weights))
        log_z += whole - math.log(weights.size)
        share = np.exp(weights - whole)
        # Places of one particle resemble each other: the error is that of independent particles.
        chains = total.shape[1]
        variance += max(float(chains * np.sum(share.sum(axis=0) ** 2)) - 1.0, 0.0) / chains
        places, depths = trail.reshape(-1, target.ndim), heights.reshape(-1, target.parts)
        chosen = _systematic(share.ravel(), particles, rng)
        points, value = places[chosen], depths[chosen]
        known = places[_systematic(share.ravel(), min(_LEARNT, len(places)), rng)]
        power = rise
        learnt = _learn(target, known, _PARTS_AT_LAST if power == 1.0 else _PARTS)
        trail, heights, mean, left = _move(target, points, value, power, steps, learnt, last, rng)
        worst = max(worst, mean)
        last = last or (power == 1.0 and not settle)
        if tell is not None:
            tell(power, "moving on at full power" if last else f"likelihood at power {power:.3g}")
    times = np.linspace(0, len(trail) - 1, min(kept, len(trail)) + 1).round().astype(int)[1:]
    points, value = trail[times].reshape(-1, target.ndim), heights[times].reshape(-1, target.parts)
    return Tempered(points, value, log_z, math.sqrt(variance), stages, worst, left)


def move_on(target: Target, points: Array, known: Array, rng: np.random.Generator) -> Array:
    """Places (n', ndim) that draws of a target, (n, ndim), go through until each unknown is forgotten.

    known : places (m, ndim) that resemble draws, to learn steps from.
    """
    value = _clean(target.log_likelihood(points, np.arange(target.parts)))
    steps = dict.fromkeys(range(len(target.blocks)), 0.3)
    learnt = _learn(target, known[-_LEARNT:], _PARTS_AT_LAST)
    trail, _, _, _ = _move(target, points, value, 1.0, steps, learnt, True, rng)
    return trail.reshape(-1, target.ndim)


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


def _systematic(share: Array, n: int, rng: np.random.Generator) -> Index:
    places = (rng.random() + np.arange(n)) / n
    return rng.permutation(np.minimum(np.searchsorted(np.cumsum(share), places), len(share) - 1))


def _move(
    target: Target, points: Array, value: Array, power: float, steps: dict[int, float], learnt: _Learnt,
    last: bool, rng: np.random.Generator,
) -> tuple[Array, Array, float, float]:  # fmt: skip
    """Metropolis sweeps over all blocks until the particles have forgotten their places.

    Returns their places (times, n, ndim) and log likelihoods (times, n, parts), and the mean and the largest
    correlation of an unknown with its place at the start.
    """
    begin = target.unknowns(points)
    trail, heights = [], []
    mean = largest = 1.0
    for sweep in range(_LAST_SWEEPS if last else _MOST_SWEEPS):
        for i in range(len(target.blocks)):
            # In turn; a block has either a guide or a Gaussian of the cloud's shape.
            kind = ("draw", "near", "along")[sweep % 3] if i in learnt.guides else ("cloud", "along")[sweep % 2]
            points, value, accepted = _step(target, i, points, value, power, kind, steps[i], learnt, rng)
            if kind == "cloud":
                steps[i] = float(np.clip(steps[i] * math.exp(0.6 * (accepted - 0.3)), 0.03, 1.0))
        points = target.refresh(points, rng)
        trail.append(points)
        heights.append(value)
        if sweep + 1 >= _FEWEST_SWEEPS:
            left = _memory(begin, target.unknowns(points))
            mean, largest = float(left.mean()), float(left.max())
            # Of few particles chance alone leaves some unknown this much.
            if largest < max(_FORGOTTEN, 3.0 / math.sqrt(len(points))) if last else mean < _FORGOTTEN:
                break
    # At the full power the first half leads away from where the particles began, which few of them may have shared.
    first = len(trail) // 2 if last else 0
    some = np.linspace(first, len(trail) - 1, min(_KEPT, len(trail) - first)).round().astype(int)
    return np.stack([trail[i] for i in some]), np.stack([heights[i] for i in some]), mean, largest


def _memory(before: Array, now: Array) -> Array:
    """Correlation between two sets of places (n, k), of each unknown, (k,)."""
    a, b = before - before.mean(axis=0), now - now.mean(axis=0)
    return np.asarray(np.sum(a * b, axis=0) / np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0) + 1e-300))


@dataclass(frozen=True)
class _Learnt:
    """What is learnt from places before a stage, and fixed in it.

    guides : of the blocks that hang on others; slopes : of what moves along with a block, its carried coordinates (-1)
    or another block, on its own.
    """

    guides: Mapping[int, Guide]
    slopes: Mapping[tuple[int, int], Array]


def _learn(target: Target, known: Array, most: int) -> _Learnt:
    """From places (n, ndim)."""
    guides, slopes = {}, {}
    straight = [target.straight(known, i) for i in range(len(target.blocks))]
    for i, block in enumerate(target.blocks):
        if block.given is not None:
            places = np.concatenate([straight[i], known[:, block.given]], axis=1)
            guides[i] = Guide(places, len(block.columns), most)
        if block.carried is not None and len(block.carried):
            slopes[i, -1] = _slopes(straight[i], known[:, block.carried])
        slopes |= {(i, j): _slopes(straight[i], straight[j]) for j in block.followers}
    return _Learnt(guides, slopes)


def _step(
    target: Target, which: int, points: Array, value: Array, power: float, kind: str, size: float,
    learnt: _Learnt, rng: np.random.Generator,
) -> tuple[Array, Array, float]:  # fmt: skip
    """One Metropolis step of a block for all particles, half after half: each half moves by the shape of the other.

    kind : "draw" and "near", a fresh draw and a step of the block's guide; "cloud", a step that keeps a Gaussian of the
    other half's mean and covariance, as `size` allows; "along", one along the difference of two particles of that half.
    """
    block = target.blocks[which]
    n = len(points)
    points, value = points.copy(), value.copy()
    halves = np.array_split(rng.permutation(n), 2)
    accepted = 0
    for own, other in (halves, halves[::-1]):
        x, reference = target.straight(points[own], which), target.straight(points[other], which)
        if kind in ("draw", "near") and block.given is not None:
            guide, given = learnt.guides[which], points[np.ix_(own, block.given)]
            proposed, correction = (guide.draw if kind == "draw" else guide.step)(x, given, rng)
        elif kind == "along":
            proposed, correction = x + _difference(reference, len(own), rng), np.zeros(len(own))
        else:
            proposed, correction = _about(reference, x, size, rng)
        candidate = target.bent(points[own], which, proposed)
        # What moves along is sheared: volume is kept, and the way back is the same.
        if (which, -1) in learnt.slopes:
            candidate[:, block.carried] += (proposed - x) @ learnt.slopes[which, -1]
        for follower in block.followers:
            moved = target.straight(points[own], follower) + (proposed - x) @ learnt.slopes[which, follower]
            candidate = target.bent(candidate, follower, moved)
        fresh = _clean(target.log_likelihood(candidate, block.parts))
        gain = power * (fresh.sum(axis=1) - value[np.ix_(own, block.parts)].sum(axis=1))
        gain = gain + correction + 0.5 * (np.sum(points[own] ** 2, axis=1) - np.sum(candidate**2, axis=1))
        taken = np.log(rng.random(len(own))) < gain
        points[own[taken]] = candidate[taken]
        value[np.ix_(own[taken], block.parts)] = fresh[taken]
        accepted += int(taken.sum())
    return points, value, accepted / n


def _difference(reference: Array, n: int, rng: np.random.Generator) -> Array:
    """Steps (n, k) along differences of two particles, half of them in some coordinates only, of all sizes.

    What is left of a ridge's bend takes short ones.
    """
    k = reference.shape[1]
    first, second = (reference[rng.integers(len(reference), size=n)] for _ in range(2))
    some = rng.random((n, k)) < np.where(rng.random(n) < 0.5, 1.0, rng.random(n))[:, None]
    some[np.arange(n), rng.integers(k, size=n)] = True
    gamma = 2.38 / np.sqrt(2.0 * some.sum(axis=1)) * np.exp(rng.uniform(-3.0, 0.3, n))
    return np.asarray(some * (gamma[:, None] * (first - second) + 1e-3 * rng.standard_normal((n, k))))


def _about(reference: Array, x: Array, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Steps from x (n, k) that keep a Gaussian of the mean and covariance of `reference` (m, k).

    Returns where they lead, and what the acceptance owes to that Gaussian.
    """
    mean = reference.mean(axis=0)
    m, k = reference.shape
    covariance = np.cov(reference.T).reshape(k, k)
    # Shrunk towards the diagonal: few particles, many coordinates.
    share = min(0.2, 0.2 * k / m)
    covariance = (1.0 - share) * covariance + share * np.diag(np.diag(covariance)) + 1e-9 * np.eye(k)
    root = np.linalg.cholesky(covariance)
    proposed = mean + math.sqrt(1.0 - size**2) * (x - mean) + size * rng.standard_normal(x.shape) @ root.T
    inverse = np.linalg.inv(root).T
    squares = [np.sum(((z - mean) @ inverse) ** 2, axis=1) for z in (proposed, x)]
    return proposed, 0.5 * (squares[0] - squares[1])


def _slopes(x: Array, y: Array) -> Array:
    """Regression of y (n, j) on x (n, k): (k, j), drawn slightly towards zero where places are few."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    gram = x.T @ x
    return np.asarray(
        np.linalg.solve(gram + (1e-9 + 2.0 / len(x)) * np.trace(gram) / len(gram) * np.eye(len(gram)), x.T @ y)
    )
