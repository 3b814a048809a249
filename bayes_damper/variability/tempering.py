"""Sequential Monte Carlo: draws of a posterior and its evidence at once, by a likelihood that bears little by little.

All coordinates have unit Gaussian priors. The particles start as draws of the prior; at each stage the power of the
likelihood, or what else leads from nothing to all of it, is raised until half of the places count, particles are drawn
anew by their weights, and moved by Metropolis steps block by block until they have forgotten where they stood. The
product of the mean weights is the evidence. Every place that a particle went through on its way counts in the next
stage, not the last alone (waste-free; Dau and Chopin 2022, J. R. Statist. Soc. B 84:114): where steps are short, as on
a thin and bent posterior, that is what keeps places apart. At the full power the particles go on until each unknown by
itself is forgotten. Unlike a chain this needs no start, finds several modes, and works for a hierarchy of forty
unknowns.
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
_GUIDED = ("draw", "near", "along", "near", "along")
_SHAPED = ("cloud", "along")
"""Kinds of steps, in turn, of a block that has a guide, and of one that has a Gaussian of the cloud's shape."""


@dataclass(frozen=True)
class Block:
    """Coordinates that are moved together, and the parts of the likelihood that they change.

    followers : blocks (or other sets of coordinates that the target counts after its blocks) whose straight
    coordinates follow along the regression line of the particles, such as each case's own when the inertia that divides
    all of them moves. given :
    coordinates at rest on which the block's place hangs: most steps are then those of a `Guide` learnt from both, for
    what those leave of the block can be far thinner than the block's own cloud, and bent.
    """

    columns: Index
    parts: Index
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

    def measure(self, points: Array, parts: Index) -> Array:
        """What it takes to know of the chosen parts at points (n, ndim), computed once: (n, len(parts), k)."""

    def tried(self, points: Sequence[Array], parts: Index, power: float, least: Array) -> Array:
        """As `measure`, each part at points of its own (n, ndim) or all at the same ones: (n, len(parts), k).

        nan may stand where the height at this power is below `least` for certain: that of each part if `least` is (n,
        len(parts)), that of their sum if it is (n,). What is found out before all is simulated need not be simulated to
        the end.
        """

    def height(self, measured: Array, parts: Index, power: float) -> Array:
        """Log likelihood (n, len(parts)) of what was measured as far as it bears, from 0 (not at all) to 1."""

    def at(self, power: float) -> Target:
        """The same with coordinates that are straight at this power."""

    def straight(self, points: Array, block: int) -> Array:
        """A block's coordinates (n, k) in which steps are taken: bent ridges made straight."""

    def log_volume(self, points: Array, block: int) -> Array:
        """Log of the volume of a block's coordinates over that of its straight ones, (n,), up to a constant."""

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
    nominal, everything = target, np.arange(target.parts)
    trail = rng.standard_normal((1, _FIRST * particles, target.ndim))
    known = target.measure(trail[0], everything)[None]
    power, log_z, variance, stages, worst, left = 0.0, 0.0, 0.0, 0, 0.0, 1.0
    steps = dict.fromkeys(range(len(target.blocks)), 0.6)
    last = False
    while not last:
        shape = trail.shape[:2]  # (times, chains)
        places, measured = trail.reshape(-1, target.ndim), known.reshape(-1, *known.shape[2:])
        now = _height(target, measured, everything, power).sum(axis=1) if power else np.zeros(len(places))
        if not np.any(np.isfinite(_height(target, measured, everything, 1.0).sum(axis=1))):
            raise InputError("the likelihood is zero at all draws of the prior: widen the priors, or check the units")
        stages += 1
        if stages > _MOST_STAGES:
            raise InputError("the posterior is too narrow for tempering; use the records' Laplace version")
        last = power == 1.0
        rise = 1.0 if last else _next_power(target, measured, now, power)
        weights = np.zeros(len(places)) if last else _gain(_height(target, measured, everything, rise), now)
        whole = float(logsumexp(weights))
        log_z += whole - math.log(len(places))
        share = np.exp(weights - whole)
        # Places of one particle resemble each other: the error is that of independent particles.
        chains = share.reshape(shape).sum(axis=0)
        variance += max(float(len(chains) * np.sum(chains**2)) - 1.0, 0.0) / len(chains)
        chosen = _systematic(share, particles, rng)
        lessons = places[_systematic(share, min(_LEARNT, len(places)), rng)]
        power = rise
        target = nominal.at(power)
        learnt = _learn(target, lessons, _PARTS_AT_LAST if power == 1.0 else _PARTS)
        trail, known, mean, left = _move(target, places[chosen], measured[chosen], power, steps, learnt, last, rng)
        worst = max(worst, mean)
        last = last or (power == 1.0 and not settle)
        if tell is not None:
            tell(power, "moving on at full power" if last else f"likelihood at power {power:.3g}")
    times = np.linspace(0, len(trail) - 1, min(kept, len(trail)) + 1).round().astype(int)[1:]
    points, measured = trail[times].reshape(-1, target.ndim), known[times].reshape(-1, *known.shape[2:])
    value = _height(target, measured, everything, 1.0)
    return Tempered(points, value, log_z, math.sqrt(variance), stages, worst, left)


def move_on(target: Target, points: Array, known: Array, rng: np.random.Generator) -> Array:
    """Places (n', ndim) that draws of a target, (n, ndim), go through until each unknown is forgotten.

    known : places (m, ndim) that resemble draws, to learn steps from.
    """
    measured = target.measure(points, np.arange(target.parts))
    steps = dict.fromkeys(range(len(target.blocks)), 0.3)
    learnt = _learn(target, known[-_LEARNT:], _PARTS_AT_LAST)
    trail, _, _, _ = _move(target, points, measured, 1.0, steps, learnt, True, rng)
    return trail.reshape(-1, target.ndim)


def _height(target: Target, measured: Array, parts: Index, power: float) -> Array:
    value = target.height(measured, parts, power)
    return np.where(np.isnan(value), -np.inf, value)


def _gain(risen: Array, now: Array) -> Array:
    """How much higher the sum of parts (n, parts) is than before (n,); -inf where it vanishes."""
    total = risen.sum(axis=1)
    return np.where(np.isfinite(total), total - np.where(np.isfinite(now), now, 0.0), -np.inf)


def _next_power(target: Target, measured: Array, now: Array, power: float) -> float:
    """The power at which half of the places that can count do, at most 1."""
    some = np.linspace(0, len(now) - 1, min(len(now), _LEARNT)).astype(int)
    measured, now, everything = measured[some], now[some], np.arange(target.parts)

    def count(rise: float) -> float:
        gain = _gain(_height(target, measured, everything, rise), now)
        if not np.any(np.isfinite(gain)):
            return 0.0
        w = np.exp(gain - gain.max())
        return float(w.sum() ** 2 / (w**2).sum())

    goal = 0.5 * np.isfinite(_gain(_height(target, measured, everything, 1.0), now)).sum()
    if count(1.0) >= goal:
        return 1.0
    low, high = power, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if count(middle) >= goal else (low, middle)
    return max(low, power + 1e-12)


def _systematic(share: Array, n: int, rng: np.random.Generator) -> Index:
    places = (rng.random() + np.arange(n)) / n
    return rng.permutation(np.minimum(np.searchsorted(np.cumsum(share), places), len(share) - 1))


def _move(
    target: Target, points: Array, measured: Array, power: float, steps: dict[int, float], learnt: _Learnt,
    last: bool, rng: np.random.Generator,
) -> tuple[Array, Array, float, float]:  # fmt: skip
    """Metropolis sweeps over all blocks until the particles have forgotten their places.

    Returns their places (times, n, ndim) and what was measured (times, n, parts, k), and the mean and the largest
    correlation of an unknown with its place at the start.
    """
    begin = target.unknowns(points)
    trail, known = [], []
    mean = largest = 1.0
    groups = _groups(target.blocks)
    for sweep in range(_LAST_SWEEPS if last else _MOST_SWEEPS):
        for group in groups:
            kinds = [ways[sweep % len(ways)] for ways in (_GUIDED if i in learnt.guides else _SHAPED for i in group)]
            points, measured, accepted = _step(target, group, points, measured, power, kinds, steps, learnt, rng)
            for i, kind, share in zip(group, kinds, accepted, strict=True):
                if kind == "cloud":
                    steps[i] = float(np.clip(steps[i] * math.exp(0.6 * (share - 0.3)), 0.03, 1.0))
        points = target.refresh(points, rng)
        trail.append(points)
        known.append(measured)
        if sweep + 1 >= _FEWEST_SWEEPS:
            left = _memory(begin, target.unknowns(points))
            mean, largest = float(left.mean()), float(left.max())
            # Of few particles chance alone leaves some unknown this much.
            if largest < max(_FORGOTTEN, 3.0 / math.sqrt(len(points))) if last else mean < _FORGOTTEN:
                break
    # At the full power the first half leads away from where the particles began, which few of them may have shared.
    first = len(trail) // 2 if last else 0
    some = np.linspace(first, len(trail) - 1, min(_KEPT, len(trail) - first)).round().astype(int)
    return np.stack([trail[i] for i in some]), np.stack([known[i] for i in some]), mean, largest


def _memory(before: Array, now: Array) -> Array:
    """Correlation between two sets of places (n, k), of each unknown, (k,)."""
    a, b = before - before.mean(axis=0), now - now.mean(axis=0)
    return np.asarray(np.sum(a * b, axis=0) / np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0) + 1e-300))


@dataclass(frozen=True)
class _Learnt:
    """What is learnt from places before a stage, and fixed in it.

    guides : of the blocks that hang on others; slopes : of what moves along with a block on its own coordinates.
    """

    guides: Mapping[int, Guide]
    slopes: Mapping[tuple[int, int], Array]


def _learn(target: Target, known: Array, most: int) -> _Learnt:
    """From places (n, ndim)."""
    guides: dict[int, Guide] = {}
    slopes: dict[tuple[int, int], Array] = {}
    for i, block in enumerate(target.blocks):
        straight = target.straight(known, i)
        if block.given is not None:
            places = np.concatenate([straight, known[:, block.given]], axis=1)
            guides[i] = Guide(places, len(block.columns), most)
        slopes |= {(i, j): _slopes(straight, target.straight(known, j)) for j in block.followers}
    return _Learnt(guides, slopes)


def _groups(blocks: Sequence[Block]) -> list[list[int]]:
    """Blocks that follow each other and have nothing to do with each other, so that they can be moved at once."""
    groups: list[list[int]] = []
    for i, block in enumerate(blocks):
        apart = groups and all(_apart(block, blocks[j]) for j in groups[-1])
        groups = [*groups[:-1], [*groups[-1], i]] if apart else [*groups, [i]]
    return groups


def _apart(a: Block, b: Block) -> bool:
    given = [x.given if x.given is not None else np.zeros(0, np.intp) for x in (a, b)]
    shared = (np.intersect1d(a.parts, b.parts), np.intersect1d(a.columns, b.columns),
              np.intersect1d(a.columns, given[1]), np.intersect1d(b.columns, given[0]))  # fmt: skip
    return not a.followers and not b.followers and len(a.parts) == len(b.parts) == 1 and not any(map(len, shared))


def _step(
    target: Target, group: Sequence[int], points: Array, measured: Array, power: float, kinds: Sequence[str],
    sizes: Mapping[int, float], learnt: _Learnt, rng: np.random.Generator,
) -> tuple[Array, Array, list[float]]:  # fmt: skip
    """One Metropolis step for all particles in each block of a group, half after half.

    kinds : see `_proposed`. Returns the points, what was measured, and the share of steps taken of each block.
    """
    points, measured = points.copy(), measured.copy()
    halves = np.array_split(rng.permutation(len(points)), 2)
    blocks = [target.blocks[i] for i in group]
    accepted = np.zeros(len(group))
    # Blocks of one part each are judged apart, a single one by the sum of its parts.
    judged = [np.array([k]) for k in range(len(group))] if len(group) > 1 else [np.arange(len(blocks[0].parts))]
    parts = np.concatenate([block.parts for block in blocks])
    for own, other in (halves, halves[::-1]):
        steps = [
            _proposed(target, i, points[own], points[other], kind, sizes[i], learnt, rng)
            for i, kind in zip(group, kinds, strict=True)
        ]
        there = [x for block, (x, _) in zip(blocks, steps, strict=True) for _ in block.parts]
        heights = _height(target, measured[np.ix_(own, parts)], parts, power)
        now = np.stack([heights[:, k].sum(axis=1) for k in judged], axis=1)
        gain = np.stack([gain for _, gain in steps], axis=1)
        # The random number first: most steps that are refused show it before they are simulated to the end.
        least = np.log(rng.random(gain.shape)) - gain + now
        least = np.where(np.isnan(least), np.inf, least)
        fresh = target.tried(there, parts, power, least if len(group) > 1 else least[:, 0])
        heights = _height(target, fresh, parts, power)
        for j, (block, (moved, _), k) in enumerate(zip(blocks, steps, judged, strict=True)):
            taken = heights[:, k].sum(axis=1) > least[:, j]
            columns = np.arange(target.ndim) if block.followers else block.columns
            points[np.ix_(own[taken], columns)] = moved[np.ix_(taken, columns)]
            measured[np.ix_(own[taken], block.parts)] = fresh[np.ix_(taken, k)]
            accepted[j] += int(taken.sum())
    return points, measured, (accepted / len(points)).tolist()


def _proposed(
    target: Target, which: int, here: Array, others: Array, kind: str, size: float, learnt: _Learnt,
    rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """Where a step of one block leads from `here`, by the shape of `others`, and what its acceptance owes to that.

    kind : "draw" and "near", a fresh draw and a step of the block's guide; "cloud", a step that keeps a Gaussian of the
    others' mean and covariance, as `size` allows; "along", one along the difference of two of them.
    """
    block = target.blocks[which]
    x = target.straight(here, which)
    if kind in ("draw", "near") and block.given is not None:
        guide, given = learnt.guides[which], here[:, block.given]
        proposed, gain = (guide.draw if kind == "draw" else guide.step)(x, given, rng)
    elif kind == "along":
        proposed = x + _difference(target.straight(others, which), len(here), rng)
        gain = np.zeros(len(here))
    else:
        proposed, gain = _about(target.straight(others, which), x, size, rng)
    there = target.bent(here, which, proposed)
    # What moves along is sheared: volume is kept in straight coordinates, and the way back is the same.
    for follower in block.followers:
        moved = target.straight(here, follower) + (proposed - x) @ learnt.slopes[which, follower]
        there = target.bent(there, follower, moved)
    for k in (which, *block.followers):
        gain = gain + target.log_volume(there, k) - target.log_volume(here, k)
    return there, gain + 0.5 * (np.sum(here**2, axis=1) - np.sum(there**2, axis=1))


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
