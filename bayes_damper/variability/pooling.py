"""What cases share: one value for all, a value each, or values scattered about a common mean.

In standard coordinates (each case's prior a unit Gaussian) parameter p of case c is

    z_cp = sqrt(1 - s_p^2) m_p + s_p e_cp,      m_p, e_cp ~ N(0, 1),      0 <= s_p <= 1,

so that every case has the same prior whatever s is, and the three answers differ in nothing but what they share:
`shared` s = 0, `separate` s = 1, `partial` s_p uniform between 0 and 1 and inferred. For a lognormal prior the scatter
of ln x over cases is s times ln of the prior's factor. Parameters that belong to the campaign (the rig's constants)
have one value for all cases in each of the three; what belongs to one case (release angle, spring) is its own.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, LogNormal, from_standard, to_standard
from bayes_damper.runs.contents.variability import Pooling
from bayes_damper.sampling.arviz_adapter import pareto_k
from bayes_damper.sampling.sequential import Block, Path, Plain, UnitPrior, power_of, temper

Array = NDArray[np.float64]
Index = NDArray[np.intp]
POOLINGS: tuple[Pooling, ...] = ("shared", "separate", "partial")
_REFRESHES = 8
_SCALES = (0.02, 0.1, 0.4)
"""Sizes of the steps along a scaling, in ln f."""
_LEVELS = (1500, 50_000)
"""Draws of a case that are used again: the second number where the weights of the first cannot be trusted."""
_FEWEST_OF_ONE = 30
"""Effective draws below which the likelihood of a population is known to no better than a fifth of a nat."""
_LARGEST = 100_000
"""Weights that are computed at once."""


class Straightener(Protocol):
    """A change of a case's coordinates (n, len(names)) that makes bent ridges straight; what is common stays."""

    def at(self, power: float) -> Straightener:
        """The one that suits a likelihood that bears so far."""

    def sampled(self, z: Array) -> Array:
        """Straight coordinates of standard ones."""

    def standard(self, points: Array) -> Array:
        """The inverse."""

    def log_volume(self, points: Array) -> Array:
        """Log of the volume of standard coordinates over that of straight ones at these, (n,), up to a constant."""


@dataclass(frozen=True)
class CaseLikelihood:
    """One case: names of its coordinates, and its likelihood in them."""

    name: str
    names: tuple[str, ...]
    path: Path
    straightener: Straightener | None = None


@dataclass(frozen=True)
class Scaling:
    """A change that no reading shows: each named parameter x becomes x f^power, whatever f.

    A free decay gives torques per inertia and friction as mu N0 R only, so there are directions in which the posterior
    is the prior: steps along them cost no simulation. priors : of the named parameters.
    """

    powers: Mapping[str, float]
    priors: Mapping[str, Distribution]


@dataclass(frozen=True)
class _View:
    """Coordinates that are moved together: as they are, or `pooled` and `own` ones of a case in its straight form.

    middle : the mean of the cases' values, which they all follow (m moves, e rests); scatter : s, that mean at rest.
    """

    columns: Index
    case: int = -1
    pooled: bool = False
    own: bool = False
    middle: bool = False
    scatter: bool = False


@dataclass(frozen=True)
class Columns:
    """Where the unknowns of a hierarchy stand: m and s of what is pooled, what is common, e and own of each."""

    m: Index
    s: Index
    common: Index
    e: list[Index]
    own: list[Index]


class Hierarchy(UnitPrior):
    """The joint posterior of several cases under one pooling: a target for `temper`.

    pooled : parameters that the pooling is about; common : those with one value for all cases; all others of a case
    are its own; scalings : changes of a case's parameters that its likelihood does not see, each for every case.
    Columns: m (pooled), s (as Phi^-1(s), only `partial`), common, then for each case e and its own.
    """

    def __init__(
        self, cases: Sequence[CaseLikelihood], pooling: Pooling, pooled: Sequence[str], common: Sequence[str] = (),
        scalings: Sequence[Sequence[Scaling]] = (),
    ) -> None:  # fmt: skip
        self.cases, self.pooling = tuple(cases), pooling
        self.scalings = [tuple(each) for each in scalings]
        self.pooled, self.common = tuple(pooled), tuple(common)
        for case in self.cases:
            missing = [name for name in (*self.pooled, *self.common) if name not in case.names]
            if missing:
                raise InputError(f"case {case.name} has no parameter {missing[0]!r} that could be compared")
        p = len(self.pooled)
        start = 0

        def take(count: int) -> Index:
            nonlocal start
            start += count
            return np.arange(start - count, start)

        m, s = take(p if pooling != "separate" else 0), take(p if pooling == "partial" else 0)
        shared = take(len(self.common))
        each = [(take(p if pooling != "shared" else 0), take(len(c.names) - p - len(self.common))) for c in self.cases]
        self.columns = Columns(m, s, shared, [e for e, _ in each], [own for _, own in each])
        self.ndim, self.parts = start, len(self.cases)
        # Of each case: where what is pooled stands among its names, and the rest, and the columns of the latter.
        self._sources: list[tuple[Index, Index, Index]] = []
        for case, own_columns in zip(self.cases, self.columns.own, strict=True):
            places = [case.names.index(name) for name in self.pooled]
            constants = [case.names.index(name) for name in self.common]
            rest = [i for i in range(len(case.names)) if i not in (*places, *constants)]
            columns_of = np.concatenate([self.columns.common, own_columns])
            self._sources.append((np.array(places), np.array([*constants, *rest]), columns_of))
        everything = np.arange(self.parts)
        population = np.concatenate([self.columns.m, self.columns.s])
        numbers = range(self.parts)
        # What all cases hang on, then each case's own.
        columns = [self.columns.m, self.columns.s, self.columns.common]
        columns += [np.concatenate([self.columns.e[c], self.columns.own[c]]) for c in numbers]
        middle = _View(self.columns.m, self.parts // 2, pooled=True, middle=pooling == "partial")
        views = [middle, _View(self.columns.s, scatter=True), _View(self.columns.common)]
        views += [_View(columns[3 + c], c, pooled=pooling != "shared", own=True) for c in numbers]
        kept = [k for k, x in enumerate(columns) if len(x)]
        place = {k: i for i, k in enumerate(kept)}
        of_cases = tuple(place[k] for k in range(3, len(columns)) if k in place)
        self._views = [views[k] for k in kept]
        own = of_cases
        if pooling == "partial":
            own = tuple(len(kept) + c for c in numbers)
            self._views += [_View(self.columns.own[c], c, own=True) for c in numbers]
        self.blocks: list[Block] = []
        for k in kept:
            if k == 0:
                given = np.concatenate([self.columns.common, self.columns.s])
                block = Block(columns[k], everything, followers=own, given=given)
            elif k == 1:
                block = Block(columns[k], everything, followers=own)
            elif k == 2:
                first = (place[0],) if 0 in place else ()
                block = Block(columns[k], everything, followers=(*first, *of_cases))
            else:
                block = Block(columns[k], np.array([k - 3]), given=np.concatenate([self.columns.common, population]))
            self.blocks.append(block)

    @property
    def owned_columns(self) -> list[tuple[int, Index]]:
        """Where the unit Gaussians stand that the pooled values are made of: (number of the case, columns); 0 for m."""
        found = [(0, self.columns.m), *enumerate(self.columns.e)]
        return [(case, columns) for case, columns in found if len(columns)]

    def at(self, power: float) -> Hierarchy:
        """The same with coordinates that are straight where the likelihood bears so far."""
        found = copy(self)
        found.cases = tuple(
            case if case.straightener is None else replace(case, straightener=case.straightener.at(power))
            for case in self.cases
        )
        return found

    def _places_of(self, view: _View) -> list[int]:
        """Where a view's coordinates stand among those of its case."""
        names = self.cases[view.case].names
        places = [names.index(name) for name in self.pooled] if view.pooled else []
        if view.own:
            places += [i for i, name in enumerate(names) if name not in self.pooled and name not in self.common]
        return places

    def straight(self, points: Array, block: int) -> Array:
        """A block's coordinates with the case's values in straight form."""
        view = self._views[block]
        curve = self.cases[view.case].straightener if view.case >= 0 else None
        if view.middle:
            middle = self._middle(points)
            return (
                middle if curve is None else curve.sampled(self._with(points, view, middle))[:, self._places_of(view)]
            )
        if curve is None:
            return points[:, view.columns]
        return curve.sampled(self.coordinates(points, view.case))[:, self._places_of(view)]

    def bent(self, points: Array, block: int, steps: Array) -> Array:
        """The points with a block's coordinates replaced."""
        view = self._views[block]
        points = points.copy()
        curve = self.cases[view.case].straightener if view.case >= 0 else None
        if view.middle:
            if curve is not None:
                steps = curve.standard(self._with(points, view, steps))[:, self._places_of(view)]
            s = self.scatter(points)
            points[:, view.columns] += (steps - self._middle(points)) / np.sqrt(1.0 - s**2)
            return points
        if view.scatter:
            middle = self._middle(points)
            points[:, view.columns] = steps
            s = self.scatter(points)
            points[:, self.columns.m] = (
                middle - s * np.mean([points[:, e] for e in self.columns.e], axis=0)
            ) / np.sqrt(1.0 - s**2)
            return points
        if curve is None:
            points[:, view.columns] = steps
            return points
        places = self._places_of(view)
        whole = self.coordinates(points, view.case)
        if not view.pooled:
            whole = curve.sampled(whole)
        whole[:, places] = steps
        z = curve.standard(whole)[:, places]
        if view.pooled and self.pooling == "partial":
            p, s = len(self.pooled), self.scatter(points)
            z[:, :p] = (z[:, :p] - np.sqrt(1.0 - s**2) * points[:, self.columns.m]) / s
        points[:, view.columns] = z
        return points

    def _middle(self, points: Array) -> Array:
        """The mean of the cases' values, (n, pooled)."""
        return np.asarray(np.mean([self.values(points, c) for c in range(self.parts)], axis=0))

    def _with(self, points: Array, view: _View, values: Array) -> Array:
        """Coordinates of a view's case with other pooled values."""
        whole = self.coordinates(points, view.case)
        whole[:, self._places_of(view)] = values
        return whole

    def log_volume(self, points: Array, block: int) -> Array:
        """Log of the volume of a block's coordinates over that of its straight ones, (n,), up to a constant."""
        view = self._views[block]
        if view.scatter:  # m goes with the mean of the values over sqrt(1 - s^2)
            return np.asarray(-0.5 * np.log1p(-(self.scatter(points) ** 2)).sum(axis=1))
        curve = self.cases[view.case].straightener if view.case >= 0 else None
        if curve is None or not view.own:
            return np.zeros(len(points))
        return curve.log_volume(curve.sampled(self.coordinates(points, view.case)))

    def scatter(self, points: Array) -> Array:
        """Scatter s of each pooled parameter, (n, pooled)."""
        fixed = {"shared": 0.0, "separate": 1.0}
        if self.pooling in fixed:
            return np.full((len(points), len(self.pooled)), fixed[self.pooling])
        return np.asarray(np.minimum(np.maximum(ndtr(points[:, self.columns.s]), 1e-6), 1.0 - 1e-12))

    def means(self, points: Array) -> Array:
        """Common mean m of each pooled parameter of a `shared` or `partial` hierarchy, (n, pooled)."""
        return points[:, self.columns.m]

    def values(self, points: Array, case: int) -> Array:
        """Standard coordinates of the pooled parameters of one case, (n, pooled)."""
        if self.pooling == "shared":
            return points[:, self.columns.m]
        if self.pooling == "separate":
            return points[:, self.columns.e[case]]
        s = self.scatter(points)
        return np.sqrt(1.0 - s**2) * points[:, self.columns.m] + s * points[:, self.columns.e[case]]

    def coordinates(self, points: Array, case: int) -> Array:
        """Standard coordinates of everything that one case depends on, in the order of its names."""
        z = np.empty((len(points), len(self.cases[case].names)))
        pooled, rest, columns = self._sources[case]
        z[:, pooled], z[:, rest] = self.values(points, case), points[:, columns]
        return z

    def unknowns(self, points: Array) -> Array:
        """What is pooled: the cases' values, mean and scatter of a population, and what is common."""
        if self.pooling == "shared":
            return points[:, np.concatenate([self.columns.m, self.columns.common])]
        columns = [self.values(points, case) for case in range(self.parts)]
        if self.pooling == "partial":
            columns += [self.means(points), self.scatter(points)]
        return np.concatenate([*columns, points[:, self.columns.common]], axis=1)

    @property
    def labels(self) -> list[str]:
        """What `unknowns` are, in words."""
        if self.pooling == "shared":
            return [*self.pooled, *self.common]
        labels = [f"{name} of case {case.name}" for case in self.cases for name in self.pooled]
        if self.pooling == "partial":
            labels += [f"{what} of {name}" for what in ("mean", "scatter") for name in self.pooled]
        return [*labels, *self.common]

    def measure(self, points: Array, parts: Index) -> Array:
        """What it takes to know of the chosen cases, (n, len(parts), k)."""
        return np.stack([self.cases[c].path.measure(self.coordinates(points, c)) for c in parts], axis=1)

    def tried(self, points: Sequence[Array], parts: Index) -> Array:
        """As `measure`, each case at points of its own."""
        z = [self.coordinates(x, c) for x, c in zip(points, parts, strict=True)]
        return np.stack([self.cases[c].path.measure(x) for x, c in zip(z, parts, strict=True)], axis=1)

    def height(self, measured: Array, parts: Index, power: float) -> Array:
        """Log likelihood of the chosen cases as far as it bears, (n, len(parts))."""
        return np.stack([self.cases[c].path.height(measured[:, k], power) for k, c in enumerate(parts)], axis=1)

    def log_likelihood(self, points: Array, parts: Index) -> Array:
        """Log likelihood of the chosen cases, (n, len(parts))."""
        return self.height(self.measure(points, parts), parts, 1.0)

    def refresh(self, points: Array, rng: np.random.Generator) -> Array:
        """Points moved where no likelihood changes, so that this costs nothing: along the scalings, then m and s."""
        for each in self.scalings:
            together = any(name in self.common for name in each[0].powers)
            for cases in [range(self.parts)] if together else [[c] for c in range(self.parts)]:
                points = step_along(self, points, each, rng.choice(_SCALES, len(points)), cases, rng)
        return new_population(self, points, rng) if self.pooling == "partial" else points


def new_population(h: Hierarchy, points: Array, rng: np.random.Generator) -> Array:
    """New m and s of each parameter of a `partial` hierarchy, the cases' values held.

    e = (z - sqrt(1 - s^2) m) / s follows, the volume factor is s^-cases.
    """
    points = points.copy()
    z = np.stack([h.values(points, c) for c in range(h.parts)])  # (cases, n, pooled)

    def log_density(m: Array, u: Array) -> Array:
        s = np.clip(ndtr(u), 1e-6, 1.0 - 1e-12)
        e = (z - np.sqrt(1.0 - s**2) * m) / s
        return np.asarray(-0.5 * (m**2 + u**2 + np.sum(e**2, axis=0)) - h.parts * np.log(s))

    m, u = points[:, h.columns.m], points[:, h.columns.s]
    now = log_density(m, u)
    for i in range(_REFRESHES):
        size = (0.15, 0.5, 1.5)[i % 3]
        m_new, u_new = m + size * rng.standard_normal(m.shape), u + size * rng.standard_normal(u.shape)
        new = log_density(m_new, u_new)
        taken = np.log(rng.random(m.shape)) < new - now
        m, u, now = np.where(taken, m_new, m), np.where(taken, u_new, u), np.where(taken, new, now)
    s = np.clip(ndtr(u), 1e-6, 1.0 - 1e-12)
    points[:, h.columns.m], points[:, h.columns.s] = m, u
    for c, columns in enumerate(h.columns.e):
        points[:, columns] = (z[c] - np.sqrt(1.0 - s**2) * m) / s
    return points


def step_along(
    h: Hierarchy,
    points: Array,
    each: Sequence[Scaling],
    size: float | Array,
    cases: Iterable[int],
    rng: np.random.Generator,
) -> Array:
    """One Metropolis step of some cases together along a scaling, given for each: prior and volume decide."""
    new, step, gain = points.copy(), size * rng.standard_normal(len(points)), np.zeros(len(points))
    moved: set[int] = set()
    s = h.scatter(points)
    for c in cases:
        places = _columns_of(h, c)
        for name, power in each[c].powers.items():
            prior, column = each[c].priors[name], places[name]
            if column in moved:
                continue
            moved.add(column)
            if name in h.pooled and isinstance(prior, LogNormal):
                shift = power * step / math.log(prior.factor)
                if h.pooling == "partial":
                    # All cases: their mean moves. One: its own deviation.
                    own = s[:, h.pooled.index(name)]
                    shift = shift / (np.sqrt(1.0 - own**2) if column in h.columns.m else own)
                new[:, column] += shift
                gain += 0.5 * (points[:, column] ** 2 - new[:, column] ** 2)
            else:
                x = from_standard(prior, points[:, column])
                scaled = x * np.exp(power * step)
                with np.errstate(invalid="ignore", divide="ignore"):
                    new[:, column] = to_standard(prior, scaled)
                    gain += prior.logpdf(scaled) - prior.logpdf(x) + power * step
    gain = np.where(np.all(np.isfinite(new), axis=1), gain, -np.inf)
    taken = np.log(rng.random(len(points))) < gain
    return np.where(taken[:, None], new, points)


def _columns_of(h: Hierarchy, case: int) -> dict[str, int]:
    """The column that moves each parameter of a case, and only that: name -> column."""
    together = any(name in h.common for each in h.scalings for name in each[case].powers)
    values = h.columns.m if h.pooling == "shared" or (h.pooling == "partial" and together) else h.columns.e[case]
    places = dict(zip(h.pooled, values.tolist(), strict=True))
    places |= dict(zip(h.common, h.columns.common.tolist(), strict=True))
    rest = [name for name in h.cases[case].names if name not in places]
    return places | dict(zip(rest, h.columns.own[case].tolist(), strict=True))


@dataclass(frozen=True)
class Direct:
    """Partial pooling without the draws of a fit: what `recycle` is held against.

    mean, scatter (n, pooled): draws of m and s; values: case -> (n, pooled); log_z: log evidence of `partial` over that
    of `separate`, with its error; apart: standard deviations by which the means of its own repeats differ.
    """

    mean: Array
    scatter: Array
    values: Mapping[str, Array]
    log_z: float
    error: float
    apart: float = 0.0


# Draws of single cases, used again -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recycled:
    """The hierarchy from draws of single cases by importance weights.

    mean, scatter (n, pooled): draws of m and s; values: case -> (n, pooled); ess, pareto_k: case -> effective number
    of its draws and shape of the tail of their weights, averaged over all populations: what the posterior of the
    case's values rests on; ess_of_one: case -> effective number of its draws under a single population (median over
    populations); in both a place that a chain did not leave for a while is one draw; used: largest number of draws of a
    case; log_z: log evidence of `partial` over that of `separate`, with its error.
    """

    mean: Array
    scatter: Array
    values: Mapping[str, Array]
    ess: Mapping[str, float]
    pareto_k: Mapping[str, float]
    ess_of_one: Mapping[str, float]
    used: int
    log_z: float
    error: float

    @property
    def reliable(self) -> bool:
        """Whether all cases' weights can be trusted: Pareto k below 0.7, and no population rests on a few draws."""
        return min(self.ess_of_one.values()) >= _FEWEST_OF_ONE and all(k < 0.7 for k in self.pareto_k.values())


@dataclass(frozen=True)
class _Draws:
    """Draws of one case, none twice: z (n, pooled), and how often each was drawn."""

    z: Array
    times: Array


def _distinct(z: Array) -> _Draws:
    places, times = np.unique(z, axis=0, return_counts=True)
    return _Draws(places, times.astype(float))


class _Powers(UnitPrior, Plain):
    """A likelihood in parts of which powers are taken."""

    @abstractmethod
    def log_likelihood(self, points: Array, parts: Index) -> Array:
        """Log likelihood of the chosen parts at points (n, ndim): (n, len(parts))."""

    def measure(self, points: Array, parts: Index) -> Array:
        """The log likelihood itself."""
        return self.log_likelihood(points, parts)[:, :, None]

    def height(self, measured: Array, parts: Index, temperature: float) -> Array:
        """Its power."""
        del parts
        return power_of(measured[:, :, 0], temperature)


class _Population(_Powers):
    """m and s alone: the cases' values are summed over their draws."""

    def __init__(self, draws: Sequence[_Draws]) -> None:
        self.draws = draws
        self.powers = [np.concatenate([(d.z**2).T, d.z.T, np.ones((1, len(d.z)))]) for d in draws]
        self.shift = [np.log(d.times / d.times.sum()) for d in draws]
        self.pooled = draws[0].z.shape[1]
        self.ndim, self.parts = 2 * self.pooled, len(draws)
        everything = np.arange(self.parts)
        pairs = [Block(np.array([i, self.pooled + i]), everything) for i in range(self.pooled)]
        self.blocks = [Block(np.arange(self.ndim), everything), *pairs]

    def log_weights(self, points: Array, part: int) -> Array:
        """Log of what each draw of a case adds to the likelihood of each population, (n, draws)."""
        m = points[:, : self.pooled]
        s = np.clip(ndtr(points[:, self.pooled :]), 1e-6, 1.0 - 1e-12)
        a, precision = np.sqrt(1.0 - s**2) * m, s**-2
        height = -0.5 * np.sum(a**2 * precision, axis=1) - np.log(s).sum(axis=1)
        factors = np.concatenate([0.5 * (1.0 - precision), a * precision, height[:, None]], axis=1)
        return np.asarray(factors @ self.powers[part] + self.shift[part])

    def log_likelihood(self, points: Array, parts: Index) -> Array:
        """Log of the sum of each case's weights, (n, len(parts)); a few populations at a time."""
        out = np.empty((len(points), len(parts)))
        for k, c in enumerate(parts):
            size = max(1, _LARGEST // len(self.draws[c].z))
            for i in range(0, len(points), size):
                weights = self.log_weights(points[i : i + size], c)
                top = weights.max(axis=1)
                weights -= top[:, None]
                # Single precision: six digits of a weight are enough, and four times as fast.
                total = np.exp(weights.astype(np.float32)).sum(axis=1, dtype=np.float64)
                out[i : i + size, k] = top + np.log(total)
        return out


def recycle(
    draws: Mapping[str, Array], rng: np.random.Generator, particles: int = 256, levels: Sequence[int] = _LEVELS
) -> Recycled:
    """Partial pooling from each case's own draws (n, pooled) in standard coordinates.

    A case's draws belong to its posterior under the unit Gaussian prior; under a population (m, s) each counts by the
    ratio of the population's density to that prior's (Hogg, Myers and Bovy 2010, ApJ 725:2166). A narrow population in
    p dimensions holds a share of about s^p of the draws: where the weights of a few draws cannot be trusted, more are
    taken, as `levels` says, up to all there are. So far nothing is simulated anew.
    """
    found = None
    for level in levels:
        some = {name: z[np.linspace(0, len(z) - 1, min(len(z), level)).astype(int)] for name, z in draws.items()}
        found = _recycled({name: _distinct(z) for name, z in some.items()}, rng, particles)
        if found.reliable or all(len(z) <= level for z in draws.values()):
            break
    if found is None:
        raise InputError("recycle needs at least one level of draws")
    return found


def _recycled(draws: Mapping[str, _Draws], rng: np.random.Generator, particles: int) -> Recycled:
    target = _Population(list(draws.values()))
    found = temper(target, rng, particles)
    values: dict[str, Array] = {}
    ess: dict[str, float] = {}
    of_one: dict[str, float] = {}
    tails: dict[str, float] = {}
    for c, (name, case) in enumerate(draws.items()):
        n = len(case.z)
        picked, alone, whole = np.empty(len(found.points), dtype=np.intp), np.empty(len(found.points)), np.zeros(n)
        for i, point in enumerate(found.points):
            log_weights = target.log_weights(point[None], c)[0]
            share = np.exp(log_weights - logsumexp(log_weights))
            whole += share / len(found.points)
            alone[i] = 1.0 / float(np.sum(share**2))
            # One draw of the case for each population, by its weights.
            picked[i] = min(int(np.searchsorted(np.cumsum(share), rng.random())), n - 1)
        ess[name], of_one[name] = 1.0 / float(np.sum(whole**2)), float(np.median(alone))
        # The tail is that of the weights, which how long a chain stayed at a place has no part in.
        each = np.repeat(whole / case.times, case.times.astype(int))
        tails[name], values[name] = pareto_k(each), case.z[picked]
    return Recycled(
        found.points[:, : target.pooled],
        np.clip(ndtr(found.points[:, target.pooled :]), 1e-6, 1.0 - 1e-12),
        values,
        ess,
        tails,
        of_one,
        round(max(float(case.times.sum()) for case in draws.values())),
        found.log_z,
        math.sqrt(found.error**2 + sum(1.0 / x for x in of_one.values())),
    )


# Cases whose likelihood is Gaussian -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class GaussianCase:
    """A case by its Laplace approximation: posterior mean (k,) and covariance (k, k) in standard coordinates, and its
    log evidence.
    """

    name: str
    names: tuple[str, ...]
    mean: Array
    covariance: Array
    log_z: float


@dataclass(frozen=True)
class GaussianPosterior:
    """Evidence, and the mean (cases, pooled) and joint covariance of the cases' values, of one pooling."""

    log_z: float
    mean: Array
    covariance: Array
    common: Array


class GaussianHierarchy:
    """The same hierarchy in closed form, for cases that thousands of readings determine to a few per cent.

    Given s the unknowns (values of all cases, constants common to them) are jointly Gaussian.
    """

    def __init__(self, cases: Sequence[GaussianCase], pooled: Sequence[str], common: Sequence[str] = ()) -> None:
        self.cases, self.pooled, self.common = tuple(cases), tuple(pooled), tuple(common)
        p, c = len(self.pooled), len(self.cases)
        self.size = p * c + len(self.common)
        self.A = np.zeros((self.size, self.size))
        self.b = np.zeros(self.size)
        self.height = 0.0
        for i, case in enumerate(self.cases):
            keep = [k for k, name in enumerate(case.names) if name in self.pooled or name in self.common]
            names = [case.names[k] for k in keep]
            # What is neither is integrated out: the marginal posterior over the marginal prior.
            covariance, mean = case.covariance[np.ix_(keep, keep)], case.mean[keep]
            precision = np.linalg.inv(covariance)
            place = [
                i * p + self.pooled.index(name) if name in self.pooled else p * c + self.common.index(name)
                for name in names
            ]
            natural = precision @ mean
            likelihood = precision - np.eye(len(keep))
            values, vectors = np.linalg.eigh(0.5 * (likelihood + likelihood.T))
            self.A[np.ix_(place, place)] += vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
            self.b[place] += natural
            log_det = float(np.linalg.slogdet(covariance)[1])
            self.height += case.log_z - 0.5 * float(natural @ mean) - 0.5 * log_det

    def _prior(self, s: Array) -> Array:
        """Prior covariances (n, size, size) for scatters s (n, pooled)."""
        p, c = len(self.pooled), len(self.cases)
        prior = np.tile(np.eye(self.size), (len(s), 1, 1))
        for j in range(p):
            index = np.arange(c) * p + j
            square = s[:, j, None, None] ** 2
            prior[:, index[:, None], index[None, :]] = (1.0 - square) + square * np.eye(c)
        return prior

    def log_evidence(self, s: Array) -> Array:
        """Log evidence (n,) for fixed scatters s (n, pooled)."""
        prior = self._prior(s)
        system = np.eye(self.size) + self.A @ prior
        mean = np.einsum("nij,nj->ni", prior, np.linalg.solve(system, np.tile(self.b, (len(s), 1))[..., None])[..., 0])
        return np.asarray(self.height + 0.5 * mean @ self.b - 0.5 * np.linalg.slogdet(system)[1])

    def given(self, s: Array) -> GaussianPosterior:
        """Evidence and posterior for fixed scatter s (pooled,)."""
        prior = self._prior(np.asarray(s, float)[None])[0]
        system = np.eye(self.size) + self.A @ prior
        covariance = prior @ np.linalg.inv(system)
        covariance = 0.5 * (covariance + covariance.T)
        mean = covariance @ self.b
        log_z = self.height + 0.5 * float(self.b @ mean) - 0.5 * float(np.linalg.slogdet(system)[1])
        split = len(self.pooled) * len(self.cases)
        return GaussianPosterior(log_z, mean[:split].reshape(len(self.cases), -1), covariance, mean[split:])

    def draw(self, s: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """One draw for each row of s (n, pooled): values (n, cases, pooled) and common (n, common)."""
        drawn = np.empty((len(s), self.size))
        for i, row in enumerate(s):
            found = self.given(row)
            size, turn = np.linalg.eigh(found.covariance)
            mean = np.concatenate([found.mean.ravel(), found.common])
            drawn[i] = mean + turn @ (np.sqrt(np.maximum(size, 0.0)) * rng.standard_normal(self.size))
        split = len(self.pooled) * len(self.cases)
        return drawn[:, :split].reshape(len(s), len(self.cases), -1), drawn[:, split:]

    def direct(self, rng: np.random.Generator, particles: int = 256) -> Direct:
        """Draws of the partly pooled model, and its evidence over that of separate cases."""
        log_z, error, s = self.partial(rng, particles)
        values, _ = self.draw(s, rng)
        # The common mean given the cases' values: a Gaussian in each parameter.
        a, precision = np.sqrt(1.0 - s**2), np.maximum(s, 1e-6) ** -2
        spread = 1.0 / (1.0 + len(self.cases) * a**2 * precision)
        mean = spread * a * precision * values.sum(axis=1) + np.sqrt(spread) * rng.standard_normal(s.shape)
        named = {case.name: values[:, c] for c, case in enumerate(self.cases)}
        return Direct(mean, s, named, log_z - self.given(np.ones(len(self.pooled))).log_z, error)

    def partial(self, rng: np.random.Generator, particles: int = 256) -> tuple[float, float, Array]:
        """Log evidence with s inferred, its error, and draws of s (n, pooled)."""
        target = _Scatter(self)
        found = temper(target, rng, particles)
        return target.offset + found.log_z, found.error, ndtr(found.points)


class _Scatter(_Powers):
    """s alone, everything else integrated out in closed form."""

    def __init__(self, hierarchy: GaussianHierarchy) -> None:
        self.hierarchy = hierarchy
        self.ndim, self.parts = len(hierarchy.pooled), 1
        self.offset = hierarchy.given(np.ones(self.ndim)).log_z
        only = np.zeros(1, dtype=np.intp)
        self.blocks = [Block(np.arange(self.ndim), only), *(Block(np.array([i]), only) for i in range(self.ndim))]

    def log_likelihood(self, points: Array, parts: Index) -> Array:
        del parts
        return (self.hierarchy.log_evidence(ndtr(points)) - self.offset)[:, None]
