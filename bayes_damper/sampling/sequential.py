"""Sequential Monte Carlo: draws of a posterior and its evidence at once, by a likelihood that is tempered.

The particles start as draws of the prior; at each stage the temperature, from 0 at the prior to 1 at the posterior, is
raised until half of the places count, particles are drawn anew by their weights, and moved by Metropolis steps block by
block until they have forgotten where they stood (Del Moral, Doucet and Jasra 2006, J. R. Stat. Soc. B 68:411). The
product of the mean weights is the evidence. Every place that a particle went through on its way counts in the next
stage, not the last alone (waste-free; Dau and Chopin 2022, J. R. Stat. Soc. B 84:114): where steps are short, as on a
thin and bent posterior, that is what keeps places apart. At the full temperature the particles go on until each unknown
by itself is forgotten. Unlike a chain this needs no start, finds several modes, and works for a hierarchy of forty
unknowns.

Here are the engine and what it asks of a target; how steps are proposed is in sampling/steps.py.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.errors import InputError
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling.steps import Guided, Shaped, Steps

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_FEWEST_SWEEPS, _MOST_SWEEPS = 3, 30
_LAST = 10
"""Most sweeps at the full temperature over those of a stage on the way."""
_FORGOTTEN, _FORGOTTEN_AT_LAST = 0.1, 0.25
"""Correlation of the particles with their places at the start of a stage below which they have moved enough: the mean
over the unknowns at a stage on the way, the largest at the full temperature."""
_MOST_HELD = 0.95
"""Correlation with their places at which particles count as standing still."""
_KEPT = 30
"""Most places of a particle that are kept of a stage."""
_FIRST = 8
"""Draws of the prior for each particle."""
_LEARNT = 4000
"""Most places that steps are learnt from."""
_PARTS, _PARTS_AT_LAST = 4, 12
"""Most parts of the mixtures that steps are learnt as, on the way and at the full temperature."""
_MOST_STAGES = 400
_COUNT = 0.5
"""Share of the places that are to count at the next temperature."""

_Halves = tuple[list[Steps], list[Steps]]
_Slopes = dict[tuple[int, int], Array]


@dataclass(frozen=True)
class Block:
    """Coordinates that are moved together, and the parts of the likelihood that they change.

    followers : blocks (or other sets of coordinates that the target counts after its blocks) whose straight
    coordinates follow along the regression line of the particles, such as each case's own when the inertia that divides
    all of them moves. given : coordinates at rest on which the block's place hangs: most steps are then those of a
    mixture learnt from both, for what those leave of the block can be far thinner than the block's own cloud, and bent
    (an empty array: of the block alone). steps : how steps are proposed in place of these, made anew for each run.
    """

    columns: Index
    parts: Index
    followers: tuple[int, ...] = ()
    given: Index | None = None
    steps: Callable[[], Steps] | None = None

    def own_steps(self) -> Steps:
        """How its steps are proposed."""
        return (self.steps or (Shaped if self.given is None else Guided))()


class Target(Protocol):
    """A prior that can be drawn from, and a likelihood in parts (one a case), each a function of all coordinates."""

    @property
    def ndim(self) -> int:
        """Number of coordinates."""

    @property
    def parts(self) -> int:
        """Number of parts."""

    @property
    def blocks(self) -> Sequence[Block]:
        """How the coordinates are moved."""

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draws of the prior, (count, ndim)."""

    def log_prior(self, points: Array) -> Array:
        """Log density of the prior at points (n, ndim), (n,), up to a constant."""

    def measure(self, points: Array, parts: Index) -> Array:
        """What it takes to know of the chosen parts at points (n, ndim), computed once: (n, len(parts), k)."""

    def tried(self, points: Sequence[Array], parts: Index) -> Array:
        """As `measure`, each part at points of its own (n, ndim) or all at the same ones: (n, len(parts), k)."""

    def height(self, measured: Array, parts: Index, temperature: float) -> Array:
        """Tempered log likelihood (n, len(parts)) of what was measured: all of it at 1, and none at 0."""

    def at(self, temperature: float) -> Target:
        """The same with coordinates that are straight at this temperature."""

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


class UnitPrior:
    """A target's prior: a unit Gaussian in all `ndim` coordinates."""

    ndim: int

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draws of the prior, (count, ndim)."""
        return rng.standard_normal((count, self.ndim))

    def log_prior(self, points: Array) -> Array:
        """Log density of the prior, (n,), up to a constant."""
        return np.asarray(-0.5 * np.sum(points**2, axis=1))


class Plain(ABC):
    """A target whose blocks are moved in their own coordinates, and nothing is refreshed."""

    blocks: Sequence[Block]

    @abstractmethod
    def measure(self, points: Array, parts: Index) -> Array:
        """What it takes to know of the chosen parts at points (n, ndim): (n, len(parts), k)."""

    @abstractmethod
    def height(self, measured: Array, parts: Index, temperature: float) -> Array:
        """Tempered log likelihood (n, len(parts)) of what was measured."""

    def tried(self, points: Sequence[Array], parts: Index) -> Array:
        """As `measure`, which is asked once where all parts are tried at the same points."""
        if all(x is points[0] for x in points):
            return self.measure(points[0], parts)
        return np.concatenate([self.measure(x, parts[[k]]) for k, x in enumerate(points)], axis=1)

    def at(self, temperature: float) -> Self:
        """Itself."""
        del temperature
        return self

    def log_volume(self, points: Array, block: int) -> Array:
        """Nothing changes volume."""
        del block
        return np.zeros(len(points))

    def straight(self, points: Array, block: int) -> Array:
        """The block's columns."""
        return points[:, self.blocks[block].columns]

    def bent(self, points: Array, block: int, steps: Array) -> Array:
        """The points with the block's columns replaced."""
        points = points.copy()
        points[:, self.blocks[block].columns] = steps
        return points

    def refresh(self, points: Array, rng: np.random.Generator) -> Array:
        """The points as they are."""
        del rng
        return points

    def unknowns(self, points: Array) -> Array:
        """All coordinates."""
        return points


class Path(Protocol):
    """How a likelihood comes to bear little by little."""

    def measure(self, points: Array) -> Array:
        """What it takes to know of points (n, ndim), computed once: (n, k)."""

    def height(self, measured: Array, temperature: float) -> Array:
        """Tempered log likelihood (n,) of what was measured: all of it at 1, and none at 0."""


@dataclass(frozen=True)
class Powers:
    """The usual path: powers of the likelihood."""

    log_likelihood: Callable[[Array], Array]

    def measure(self, points: Array) -> Array:
        """The log likelihood itself."""
        return np.asarray(self.log_likelihood(points), float)[:, None]

    def height(self, measured: Array, temperature: float) -> Array:
        """Its power."""
        return power_of(measured[:, 0], temperature)


def power_of(value: Array, temperature: float) -> Array:
    """A power of a likelihood by its log; nought stays nought at power 0."""
    return np.where(value > -np.inf, temperature * np.maximum(value, -1e300), -np.inf)


class Whole(Plain):
    """A target in one piece: a prior to draw from, a path to the posterior, and one block of all coordinates."""

    parts = 1

    def __init__(
        self, ndim: int, draw: Callable[[np.random.Generator, int], Array], log_prior: Callable[[Array], Array],
        path: Path,
    ) -> None:  # fmt: skip
        self.ndim, self.draw, self.log_prior, self._path = ndim, draw, log_prior, path
        self.blocks = [Block(np.arange(ndim), np.arange(1), given=np.arange(0))]

    def measure(self, points: Array, parts: Index) -> Array:
        """What the path takes to know, (n, 1, k)."""
        del parts
        return np.asarray(self._path.measure(points), float)[:, None]

    def height(self, measured: Array, parts: Index, temperature: float) -> Array:
        """The path's, (n, 1)."""
        del parts
        return self._path.height(measured[:, 0], temperature)[:, None]


@dataclass(frozen=True)
class Tempered:
    """What `temper` finds.

    points (n, ndim), equally weighted: each particle at several times of the last stage, which stand together;
    log_likelihood (n, parts); log evidence with its standard error (from what the descendants of each draw of the prior
    added to it, wider by what particles hold of their places); stages; forgotten: worst mean correlation that a stage
    left; last: largest correlation of an unknown with its place before the last stage; evaluations: points at which the
    likelihood was asked for.
    """

    points: Array
    log_likelihood: Array
    log_z: float
    error: float
    stages: int
    forgotten: float
    last: float
    evaluations: int


@dataclass
class _State:
    """A run between two stages.

    trail, known : where the particles were in the last one (times, particles, ndim), and what was measured there;
    family : the draw of the prior that each descends from; influence : of each draw of the prior, what its descendants
    added to the log evidence, which is what the evidence varies by (after Lee and Whiteley 2018, Biometrika 105:609);
    variance : the same if every stage's particles were new ones; held : mean correlation of an unknown with its place
    that the last stage left, worst that any did; left : largest that the last one left.
    """

    trail: Array
    known: Array
    family: Index
    influence: Array
    temperature: float = 0.0
    log_z: float = 0.0
    variance: float = 0.0
    stages: int = 0
    worst: float = 0.0
    held: float = 0.0
    left: float = 1.0
    last: bool = False
    evaluations: int = 0


def temper(
    target: Target,
    rng: np.random.Generator,
    particles: int = 512,
    report: Callable[[float, str], None] | None = None,
    kept: int = 1,
    settle: bool = True,
    *,
    first: int | None = None,
    sweeps: int = _MOST_SWEEPS,
    checkpoint: Checkpoint | None = None,
    start: Array | None = None,
) -> Tempered:
    """Draws and evidence of a target; `kept` places of each particle are returned.

    settle : whether the particles go on at the full temperature; False where the evidence is all that is asked for.
    first : draws of the prior that it begins with, 8 a particle by default. sweeps : most of a stage, which ends when
    the particles have forgotten their places. checkpoint : goes on from the state it holds, if any, to the same result,
    and saves into it between stages. start : draws (times, chains, ndim) of prior times likelihood at temperature 0, in
    place of draws of the prior: what is found is then the log evidence over that at temperature 0.

    Raises
    ------
    InputError
        if the likelihood is zero at all draws of the prior, its peak is too narrow to be reached, or the checkpoint is
        another run's.
    """
    steps = _steps_of(target)
    if checkpoint is not None:
        about = {"ndim": target.ndim, "particles": particles, "settle": settle, "sweeps": sweeps}
        checkpoint = checkpoint.bound_to({name: str(x) for name, x in about.items()})
    run = None if checkpoint is None else _restored(checkpoint, steps, rng)
    if run is None:
        trail = target.draw(rng, _FIRST * particles if first is None else first)[None] if start is None else start
        size = trail.shape[1]
        known = target.measure(trail.reshape(-1, target.ndim), np.arange(target.parts))
        known = known.reshape(*trail.shape[:2], *known.shape[1:])
        run = _State(trail, known, np.arange(size), np.zeros(size), evaluations=trail.shape[0] * size)
    while not run.last:
        if checkpoint is not None and checkpoint.due():
            _save(checkpoint, run, steps, rng)
        settling = run.temperature == 1.0
        _stage(run, target, steps, particles, settle, sweeps, rng, counts=start is not None)
        if report is not None:
            report(
                run.temperature, "moving on at full power" if settling else f"likelihood at power {run.temperature:.3g}"
            )
    trail, known = run.trail, run.known
    times = np.linspace(0, len(trail) - 1, min(kept, len(trail)) + 1).round().astype(int)[1:]
    points, measured = _by_chain(trail[times]), _by_chain(known[times])
    value = _height(target, measured, np.arange(target.parts), 1.0)
    error = math.sqrt(max(run.variance, float(np.sum(run.influence**2))))
    return Tempered(points, value, run.log_z, error, run.stages, run.worst, run.left, run.evaluations)


def _stage(
    run: _State, nominal: Target, steps: _Halves, particles: int, settle: bool, sweeps: int,
    rng: np.random.Generator, counts: bool = False,
) -> None:  # fmt: skip
    """Takes a run to the next temperature, or lets it settle at the full one.

    counts : whether the likelihood at temperature 0 does.
    """
    everything, (times, chains) = np.arange(nominal.parts), run.trail.shape[:2]
    order = rng.permutation(chains)
    places, measured = _by_chain(run.trail[:, order]), _by_chain(run.known[:, order])
    now = _height(nominal, measured, everything, run.temperature).sum(axis=1)
    now = now if run.temperature or counts else np.zeros(len(places))
    if not np.any(np.isfinite(_height(nominal, measured, everything, 1.0).sum(axis=1))):
        raise InputError(
            f"the likelihood is zero at all {len(places)} points drawn from the prior: widen the prior, or look "
            "whether units or release angles of the data are what the prior expects"
        )
    run.stages += 1
    if run.stages > _MOST_STAGES:
        raise InputError("the posterior is too narrow for tempering; use the records' Laplace version")
    if run.temperature == 1.0:
        run.last, weights = True, np.zeros(len(places))
    else:
        some = np.linspace(0, len(places) - 1, min(len(places), _LEARNT)).astype(int)

        def gain(to: float, which: Index | slice) -> Array:
            return _gain(_height(nominal, measured[which], everything, to), now[which])

        run.temperature = next_temperature(lambda to: gain(to, some), run.temperature)
        weights = gain(run.temperature, slice(None))
    whole = float(logsumexp(weights))
    run.log_z += whole - math.log(len(places))
    share = np.exp(weights - whole)
    # What particles hold of their places they hold of the errors that put them there, from stage to stage.
    widen = math.sqrt((1.0 + run.held) / (1.0 - run.held))
    each = widen * (share.reshape(chains, times).sum(axis=1) - 1.0 / chains)
    run.family = run.family[order]
    run.influence += np.bincount(run.family, each, len(run.influence))
    run.variance += float(np.sum(each**2))
    chosen, lessons = (systematic(share, n, rng) for n in (particles, min(_LEARNT, len(places))))
    run.family = run.family[chosen // times]
    target = nominal.at(run.temperature)
    slopes = _learn(target, places[lessons], steps, _PARTS_AT_LAST if run.temperature == 1.0 else _PARTS)
    run.trail, run.known, run.held, run.left, asked = _move(
        target, places[chosen], measured[chosen], run.temperature, steps, slopes,
        _LAST * sweeps if run.last else sweeps, run.last, rng,
    )  # fmt: skip
    run.evaluations += asked
    run.held = min(max(run.held, 0.0), _MOST_HELD)
    run.worst = max(run.worst, run.held)
    run.last = run.last or (run.temperature == 1.0 and not settle)


def _steps_of(target: Target) -> _Halves:
    """How steps are proposed in each block, for each half of the particles."""
    first, second = ([block.own_steps() for block in target.blocks] for _ in range(2))
    return first, second


def _by_chain(trail: Array) -> Array:
    """Places of all chains one after the other, from (times, chains, ...)."""
    return np.swapaxes(trail, 0, 1).reshape(-1, *trail.shape[2:])


def next_temperature(gain: Callable[[float], Array], now: float) -> float:
    """The temperature above `now`, at most 1, at which half of the places that can count do.

    gain : temperature -> (n,), how much higher the log likelihood is there than now; -inf where it vanishes.
    """

    def count(to: float) -> float:
        risen = gain(to)
        if not np.any(np.isfinite(risen)):
            return 0.0
        w = np.exp(risen - risen.max())
        return float(w.sum() ** 2 / (w**2).sum())

    goal = _COUNT * np.isfinite(gain(1.0)).sum()
    if count(1.0) >= goal:
        return 1.0
    low, high = now, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if count(middle) >= goal else (low, middle)
    return max(low, now + 1e-12)


def systematic(share: Array, count: int, rng: np.random.Generator) -> Index:
    """Indices (count,) of members drawn by their shares (n,) of 1: systematic resampling, in the members' order."""
    places = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(share), places), len(share) - 1)


def memory(before: Array, now: Array) -> Array:
    """Correlation between two sets of places (n, k), of each unknown, (k,)."""
    a, b = before - before.mean(axis=0), now - now.mean(axis=0)
    return np.asarray(np.sum(a * b, axis=0) / np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0) + 1e-300))


def _height(target: Target, measured: Array, parts: Index, temperature: float) -> Array:
    value = target.height(measured, parts, temperature)
    return np.where(np.isnan(value), -np.inf, value)


def _gain(risen: Array, now: Array) -> Array:
    """How much higher the sum of parts (n, parts) is than before (n,); -inf where it vanishes."""
    total = risen.sum(axis=1)
    return np.where(np.isfinite(total), total - np.where(np.isfinite(now), now, 0.0), -np.inf)


_ARRAYS = ("trail", "known", "family", "influence")


def _restored(checkpoint: Checkpoint, steps: _Halves, rng: np.random.Generator) -> _State | None:
    saved = checkpoint.load()
    if saved is None:
        return None
    arrays, record = saved
    rng.bit_generator.state = record["random"]
    for each, size in zip((*steps[0], *steps[1]), record["sizes"], strict=True):
        each.size = size
    return _State(arrays["trail"], arrays["known"], arrays["family"], arrays["influence"], **record["run"])


def _save(checkpoint: Checkpoint, run: _State, steps: _Halves, rng: np.random.Generator) -> None:
    record: dict[str, Any] = {
        "run": {name: value for name, value in vars(run).items() if name not in _ARRAYS},
        "sizes": [each.size for half in steps for each in half],
        "random": rng.bit_generator.state,
    }
    checkpoint.save({name: getattr(run, name) for name in _ARRAYS}, record)


def _learn(target: Target, lessons: Array, steps: _Halves, most: int) -> tuple[_Slopes, _Slopes]:
    """What steps are to be in a stage, from places (n, ndim) before it: fixed in it.

    Each half of the particles learns from the other half's places: a mixture that knows the very particles which it
    moves holds on to them, and the posterior would be theirs. Returns for each half the slopes of what moves along with
    a block on its own coordinates.
    """
    first, second = ({}, {})  # type: tuple[_Slopes, _Slopes]
    middle = len(lessons) // 2
    for known, own, slopes in ((lessons[middle:], steps[0], first), (lessons[:middle], steps[1], second)):
        for i, (block, each) in enumerate(zip(target.blocks, own, strict=True)):
            straight = target.straight(known, i)
            each.learn(straight, known[:, _given(block)], most)
            slopes |= {(i, j): _slopes(straight, target.straight(known, j)) for j in block.followers}
    return first, second


def _move(
    target: Target, points: Array, measured: Array, temperature: float, steps: _Halves,
    slopes: tuple[_Slopes, _Slopes], most: int, last: bool, rng: np.random.Generator,
) -> tuple[Array, Array, float, float, int]:  # fmt: skip
    """At `most` so many Metropolis sweeps over all blocks, until the particles have forgotten their places.

    Returns their places (times, n, ndim) and what was measured (times, n, parts, k), the mean and the largest
    correlation of an unknown with its place at the start, and the points asked for.
    """
    begin = target.unknowns(points)
    trail, known, asked = [], [], 0
    mean = largest = 1.0
    groups = _groups(target.blocks)
    for sweep in range(most):
        for group in groups:
            points, measured = _step(target, group, points, measured, temperature, sweep, steps, slopes, rng)
        asked += len(groups) * len(points)
        points = target.refresh(points, rng)
        trail.append(points)
        known.append(measured)
        if sweep + 1 >= _FEWEST_SWEEPS:
            left = memory(begin, target.unknowns(points))
            mean, largest = float(left.mean()), float(left.max())
            # Of few particles chance alone leaves some unknown this much.
            if largest < max(_FORGOTTEN_AT_LAST, 3.0 / math.sqrt(len(points))) if last else mean < _FORGOTTEN:
                break
    # At the full temperature the first half leads away from where the particles began, which few may have shared.
    first = len(trail) // 2 if last else 0
    some = np.linspace(first, len(trail) - 1, min(_KEPT, len(trail) - first)).round().astype(int)
    return np.stack([trail[i] for i in some]), np.stack([known[i] for i in some]), mean, largest, asked


def _groups(blocks: Sequence[Block]) -> list[list[int]]:
    """Blocks that follow each other and have nothing to do with each other, so that they can be moved at once."""
    groups: list[list[int]] = []
    for i, block in enumerate(blocks):
        apart = groups and all(_apart(block, blocks[j]) for j in groups[-1])
        groups = [*groups[:-1], [*groups[-1], i]] if apart else [*groups, [i]]
    return groups


def _given(block: Block) -> Index:
    return block.given if block.given is not None else np.zeros(0, np.intp)


def _apart(a: Block, b: Block) -> bool:
    shared = (np.intersect1d(a.parts, b.parts), np.intersect1d(a.columns, b.columns),
              np.intersect1d(a.columns, _given(b)), np.intersect1d(b.columns, _given(a)))  # fmt: skip
    return not a.followers and not b.followers and len(a.parts) == len(b.parts) == 1 and not any(map(len, shared))


def _step(
    target: Target, group: Sequence[int], points: Array, measured: Array, temperature: float, sweep: int,
    steps: _Halves, slopes: tuple[_Slopes, _Slopes], rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """One Metropolis step for all particles in each block of a group, half after half: points, what was measured."""
    points, measured = points.copy(), measured.copy()
    halves = np.array_split(np.arange(len(points)), 2)
    blocks = [target.blocks[i] for i in group]
    # Blocks of one part each are judged apart, a single one by the sum of its parts.
    judged = [np.array([k]) for k in range(len(group))] if len(group) > 1 else [np.arange(len(blocks[0].parts))]
    parts = np.concatenate([block.parts for block in blocks])
    for own, other, ways, slope in zip(halves, halves[::-1], steps, slopes, strict=True):
        proposed = [_proposed(target, i, points[own], points[other], sweep, ways[i], slope, rng) for i in group]
        there = [x for block, (x, _) in zip(blocks, proposed, strict=True) for _ in block.parts]
        heights = _height(target, measured[np.ix_(own, parts)], parts, temperature)
        now = np.stack([heights[:, k].sum(axis=1) for k in judged], axis=1)
        gain = np.stack([gain for _, gain in proposed], axis=1)
        least = np.log(rng.random(gain.shape)) - gain + now
        least = np.where(np.isnan(least), np.inf, least)
        fresh = target.tried(there, parts)
        heights = _height(target, fresh, parts, temperature)
        for j, (i, block, (moved, _), k) in enumerate(zip(group, blocks, proposed, judged, strict=True)):
            taken = heights[:, k].sum(axis=1) > least[:, j]
            columns = np.arange(target.ndim) if block.followers else block.columns
            points[np.ix_(own[taken], columns)] = moved[np.ix_(taken, columns)]
            measured[np.ix_(own[taken], block.parts)] = fresh[np.ix_(taken, k)]
            ways[i].heed(sweep, float(taken.mean()))
    return points, measured


def _proposed(
    target: Target, which: int, here: Array, others: Array, sweep: int, steps: Steps,
    slopes: _Slopes, rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """Where a step of one block leads from `here`, and what its acceptance owes to that and to the prior, (n,)."""
    block = target.blocks[which]
    x = target.straight(here, which)
    proposed, gain = steps.propose(sweep, x, here[:, _given(block)], lambda: target.straight(others, which), rng)
    there = target.bent(here, which, proposed)
    # What moves along is sheared: volume is kept in straight coordinates, and the way back is the same.
    for follower in block.followers:
        moved = target.straight(here, follower) + (proposed - x) @ slopes[which, follower]
        there = target.bent(there, follower, moved)
    for k in (which, *block.followers):
        gain = gain + target.log_volume(there, k) - target.log_volume(here, k)
    return there, gain + (target.log_prior(there) - target.log_prior(here))


def _slopes(x: Array, y: Array) -> Array:
    """Regression of y (n, j) on x (n, k): (k, j), drawn slightly towards zero where places are few."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    gram = x.T @ x
    return np.asarray(
        np.linalg.solve(gram + (1e-9 + 2.0 / len(x)) * np.trace(gram) / len(gram) * np.eye(len(gram)), x.T @ y)
    )
