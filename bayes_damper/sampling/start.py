"""Where the walkers start: at an optimum, as a cloud of the posterior's own local shape; never at draws of the prior.

Walkers that start all over the prior get stranded on ragged posteriors; a cloud at the optimum does not. Everything
here compares values about one nat apart and takes no derivative, so that a ragged target does no harm.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from bayes_damper.errors import InputError
from bayes_damper.sampling.moves import StudentT
from bayes_damper.sampling.sequential import Path, Whole, systematic, temper

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]
_PASSES = 3


@dataclass(frozen=True)
class Start:
    """Optimum `point` (ndim,), local `covariance` (ndim, ndim), `log_prob` there; `others` (k, ndim), further optima
    within a few nats, found by repeated searches; `evaluations` spent.
    """

    point: Array
    covariance: Array
    log_prob: float
    others: Array
    evaluations: int
    population: Array = field(default_factory=lambda: np.empty((0, 0)))
    """A sample of the posterior (m, ndim) to take walkers from, where an annealed start found one."""


def find_start(
    target: LogDensity, draws: Array, rng: np.random.Generator, *, searches: int = 2, generations: int = 150
) -> Start:
    """The highest point found of a log density, and its shape there.

    target : (n, ndim) -> (n,), -inf allowed; draws : (n, ndim) from the prior, which tell where to search.
    `searches` independent runs of differential evolution, each from the better half of its share of the draws.
    Raises InputError when the log density is not finite at any draw.
    """
    counted = _Counted(target)
    points = np.asarray(draws, dtype=float)
    values = counted(points)
    if not np.any(np.isfinite(values)):
        raise InputError(
            f"The posterior is zero at all {len(points)} points drawn from the prior: widen the prior, or look whether "
            "units or release angles of the data are what the prior expects."
        )
    bounds = _box(points[np.isfinite(values)], points)
    found = [
        _search(counted, points[i::searches], values[i::searches], bounds, rng, generations) for i in range(searches)
    ]
    shaped = [_local_shape(counted, point, bounds) for point in found]
    shaped.sort(key=lambda item: -item[2])
    point, covariance, best = shaped[0]
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    others = [p for p, _, v in shaped[1:] if v > best - 8.0 and np.linalg.norm(root @ (p - point)) > 1.0]
    ndim = points.shape[1]
    return Start(point, covariance, best, np.array(others).reshape(-1, ndim), counted.evaluations)


def annealed_start(
    log_prior: LogDensity, path: Path, draws: Array, rng: np.random.Generator, *, each: int = 4
) -> Start:
    """A population led from draws of the prior, (n, ndim), to the posterior by a likelihood that is tempered.

    For posteriors with several modes or long arms, where a cloud about one optimum would take long to find the rest.
    It has n / `each` particles, each at up to `each` times, which stand together: a mixture learnt from one half of the
    population must not know single members of the other (`fit_mixture`).

    Raises InputError when the likelihood is zero at all draws.
    """
    ndim = draws.shape[1]
    found = temper(
        Whole(ndim, lambda _, count: draws[:count], log_prior, path), rng, len(draws) // each, kept=each,
        first=len(draws),
    )  # fmt: skip
    points, total = found.points, found.log_likelihood[:, 0] + log_prior(found.points)
    best = int(np.argmax(total))
    return Start(
        points[best], np.cov(points.T).reshape(ndim, ndim), float(total[best]), np.empty((0, ndim)),
        found.evaluations, points,
    )  # fmt: skip


def resampled_start(
    target: LogDensity, point: Array, covariance: Array, rng: np.random.Generator, *, draws: int = 1024, rounds: int = 4
) -> Start:
    """A sample of a posterior that is nearly the Gaussian of a best fit: weighted draws about it, resampled.

    In each round `draws` come from a Student t: first that of the best fit, then one with the mean and the covariance
    that the draws so far have by their weights. A draw's weight is its density over that of all proposals together, so
    that draws of every round count (Veach and Guibas 1995). It ends when as many count as one round has.

    As many members are taken as draws count, so that few are copies of one another, and copies stand together: a
    mixture learnt from one half of the population must not know single members of the other half (`fit_mixture`).

    Where fewer than a tenth of all draws count, the start is the cloud about the optimum instead.
    """
    ndim, freedom = len(point), 6.0
    enough = draws // 4  # that a covariance is learnt from
    counted = _Counted(target)
    best = float(counted(point[None])[0])
    start = Start(point, covariance, best, np.empty((0, ndim)), counted.evaluations)
    shapes = [StudentT(point, 1.21 * covariance, freedom)]
    points, height = np.empty((0, ndim)), np.empty(0)
    for turn in range(rounds):
        fresh = shapes[-1].draw(rng, draws)
        points = np.concatenate([points, fresh])
        height = np.concatenate([height, counted(fresh)])
        start = replace(start, evaluations=counted.evaluations)
        if np.count_nonzero(np.isfinite(height)) < enough:
            return start
        log_weight = height - np.logaddexp.reduce([shape.log_density(points) for shape in shapes], axis=0)
        weight, count = _normalised(log_weight)
        if count >= draws or turn == rounds - 1:
            break
        known = weight
        power = 1.0
        while count < enough and power > 1e-3:  # weights drawn together until they tell a shape
            power *= 0.7
            known, count = _normalised(power * log_weight)
        centre = known @ points
        white = (points - centre) * np.sqrt(known)[:, None]
        shapes.append(StudentT(centre, white.T @ white, freedom))
    weight, count = _normalised(log_weight)
    if count < 0.1 * len(points):
        return start
    members = min(int(count), draws)
    return replace(start, population=points[systematic(weight, members, rng)])


def _normalised(log_weight: Array) -> tuple[Array, float]:
    """Weights that sum to 1, and how many draws of equal weight would tell as much."""
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return weight, float(1.0 / np.sum(weight**2))


def cloud(
    target: LogDensity, start: Start, walkers: int, rng: np.random.Generator, turn: int = 0
) -> tuple[Array, Array]:
    """Starting points (walkers, ndim) of one ensemble and their log densities (walkers,), all finite.

    Members of the start's population, where it has one. Else normal draws with the local covariance about the optimum
    (about another for some `turn`s, where there is one), none more than a sensible depth below it; drawn closer in when
    too few are good.
    """
    if len(start.population) >= walkers:
        chosen = start.population[rng.choice(len(start.population), walkers, replace=False)]
        return chosen, np.asarray(target(chosen), dtype=float)
    ndim = len(start.point)
    centres = np.vstack([start.point[None], start.others])
    centre = centres[turn % len(centres)]
    depth = start.log_prob - 3.0 * ndim - 20.0
    root = np.linalg.cholesky(start.covariance)
    scale = 1.0
    kept = np.empty((0, ndim))
    values = np.empty(0)
    for _ in range(40):
        points = centre + scale * rng.standard_normal((2 * walkers, ndim)) @ root.T
        height = np.asarray(target(points), dtype=float)
        good = height > depth
        kept = np.concatenate([kept, points[good]])[:walkers]
        values = np.concatenate([values, height[good]])[:walkers]
        if len(kept) == walkers:
            return kept, values
        scale *= 0.7
    raise InputError(
        "No finite posterior density around the optimum: the posterior is a single spike; check the prior."
    )


class _Counted:
    """A log density that counts its points and takes NaN for -inf."""

    def __init__(self, target: LogDensity) -> None:
        self.target = target
        self.evaluations = 0

    def __call__(self, points: Array) -> Array:
        self.evaluations += len(points)
        values = np.asarray(self.target(points), dtype=float)
        return np.where(np.isnan(values), -np.inf, values)


def _box(inside: Array, draws: Array) -> tuple[Array, Array]:
    """A box around what the prior reaches, a quarter wider where that is not known to be empty."""
    low, high = draws.min(axis=0), draws.max(axis=0)
    margin = 0.25 * (inside.max(axis=0) - inside.min(axis=0)) + 1e-12
    return low - margin, high + margin


def _search(
    target: _Counted, draws: Array, values: Array, box: tuple[Array, Array], rng: np.random.Generator, generations: int
) -> Array:
    """Best point (ndim,) of one run of scipy's differential evolution, whole generations at once."""
    low, high = box
    size = 16 * int(np.ceil(max(32, 6 * draws.shape[1]) / 16))
    order = np.argsort(-values)[:size]
    population = draws[order]
    if len(population) < size:
        spare = low + (high - low) * rng.random((size - len(population), len(low)))
        population = np.concatenate([population, spare])

    def cost(columns: Array) -> Array:
        return np.asarray(np.minimum(-target(np.atleast_2d(columns.T)), 1e300))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = differential_evolution(
            cost,
            list(zip(low, high, strict=True)),
            init=population,
            vectorized=True,
            updating="deferred",
            polish=False,
            maxiter=generations,
            tol=0.0,
            atol=0.5,
            mutation=(0.4, 0.9),
            recombination=0.9,
            seed=np.random.RandomState(rng.integers(2**32)),
        )
    return np.asarray(found.x, dtype=float)


def _local_shape(target: _Counted, point: Array, box: tuple[Array, Array]) -> tuple[Array, Array, float]:
    """Point (moved up where something higher is met), covariance and log density, by scans along the axes.

    Each pass scans from the point along every axis of the present shape to where the log density has fallen by half a
    nat, takes the mixed differences at that distance, and turns the axes to the eigenvectors of the covariance found.
    """
    ndim = len(point)
    span = box[1] - box[0]
    axes = np.diag(span)  # columns: direction times reach
    best = float(target(point[None])[0])
    covariance = np.diag(span**2)
    for _ in range(_PASSES):
        point, best, width = _scan(target, point, best, axes)
        steps = axes * width
        curvature = _mixed_differences(target, point, best, steps)
        size, turn = np.linalg.eigh(curvature)
        size = np.clip(size, 0.05, None)  # in units of the scanned width, 1 = as wide as the scan found
        axes = steps @ turn / np.sqrt(size)
        covariance = axes @ axes.T
    point, best, width = _scan(target, point, best, axes)
    axes = axes * np.clip(width, 0.1, 4.0)
    covariance = axes @ axes.T
    return point, covariance + np.diag(np.diag(covariance)) * 1e-9 + np.eye(ndim) * 1e-300, best


def _scan(target: _Counted, point: Array, best: float, axes: Array) -> tuple[Array, float, Array]:
    """Climbs to the best point of a scan along each column of `axes`; then the standard deviation along each, (ndim,).

    Distances 4 .. 1e-7 of the column, both ways. The standard deviation is the distance at which a parabola through the
    optimum and the inner end of the outermost stretch that falls beyond two nats has fallen by half a nat.
    """
    ndim = len(point)
    reach = 4.0 * 2.0 ** -np.arange(26.0)
    both = np.concatenate([reach, -reach])
    for _ in range(2):
        points = point + (both[:, None, None] * axes.T[None]).reshape(-1, ndim)
        values = target(points)
        drop = best - values.reshape(2, len(reach), ndim)
        if values.max() <= best:
            break
        point, best = points[values.argmax()], float(values.max())
    near = drop < 2.0  # (side, reach, axis), reach from far to near
    outer = np.where(near.any(axis=1), near.argmax(axis=1), len(reach) - 1)
    beyond = np.maximum(outer - 1, 0)
    fallen = np.take_along_axis(drop, beyond[:, None, :], axis=1)[:, 0]
    far = reach[beyond] / np.sqrt(np.maximum(2.0 * np.where(np.isfinite(fallen), fallen, 1e300), 0.25))
    return point, best, np.sqrt(np.prod(np.maximum(far, 0.5 * reach[outer]), axis=0))


def _mixed_differences(target: _Counted, point: Array, best: float, steps: Array) -> Array:
    """Minus the second differences of the log density for the columns of `steps`, (ndim, ndim), diagonal 1."""
    ndim = len(point)
    rows, columns = np.triu_indices(ndim, 1)
    signs = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
    moves = signs[:, 0, None, None] * steps.T[rows] + signs[:, 1, None, None] * steps.T[columns]
    drop = best - target(point + moves.reshape(-1, ndim)).reshape(4, -1)
    drop = np.clip(drop, -1.0, 8.0)
    curvature = np.eye(ndim)
    mixed = (drop[0] + drop[1] - drop[2] - drop[3]) / 4.0
    curvature[rows, columns] = curvature[columns, rows] = np.clip(mixed, -0.999, 0.999)
    return curvature
