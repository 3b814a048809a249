"""Where the walkers start: at an optimum, as a cloud of the posterior's own local shape; never at draws of the prior.

Walkers that start all over the prior get stranded on ragged posteriors; a cloud at the optimum does not.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import InputError
from bayes_damper.sampling.moves import StudentT
from bayes_damper.sampling.sequential import Path, Whole, systematic, temper

LOG = logging.getLogger(__name__)
Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]


@dataclass(frozen=True)
class Start:
    """Optimum `point` (ndim,), local `covariance` (ndim, ndim), and `log_prob` there; `evaluations` spent."""

    point: Array
    covariance: Array
    log_prob: float
    evaluations: int
    population: Array = field(default_factory=lambda: np.empty((0, 0)))
    """A sample of the posterior (m, ndim) to take walkers from, where an annealed start found one."""


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
        points[best], np.cov(points.T).reshape(ndim, ndim), float(total[best]), found.evaluations,
        points,
    )  # fmt: skip


def resampled_start(
    target: LogDensity, point: Array, covariance: Array, rng: np.random.Generator, *, draws: int = 1024, rounds: int = 8
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
    start = Start(point, covariance, best, counted.evaluations)
    shapes = [StudentT(point, 1.21 * covariance, freedom)]
    points, height = np.empty((0, ndim)), np.empty(0)
    for turn in range(rounds):
        fresh = shapes[-1].draw(rng, draws)
        points = np.concatenate([points, fresh])
        height = np.concatenate([height, counted(fresh)])
        start = replace(start, evaluations=counted.evaluations)
        if (possible := np.count_nonzero(np.isfinite(height))) < enough:
            return _without_sample(start, f"only {possible} of {len(points)} draws about it are possible")
        log_weight = height - np.logaddexp.reduce([shape.log_density(points) for shape in shapes], axis=0)
        weight, count = _normalised(log_weight)
        if count >= draws or turn == rounds - 1:
            break
        known = weight
        power = 1.0
        while count < enough and power > 1e-3:  # weights drawn together until they tell a shape
            power *= 0.7
            known, count = _normalised(power * log_weight)
        if count < enough:  # of the others none counts at all, as where the noise is declared far too small
            return _without_sample(start, f"{len(points)} draws about it show no shape, {count:.3g} of them count")
        centre = known @ points
        white = (points - centre) * np.sqrt(known)[:, None]
        shapes.append(StudentT(centre, white.T @ white, freedom))
    weight, count = _normalised(log_weight)
    if count < 0.1 * len(points):
        return _without_sample(start, f"of {len(points)} draws about it only {count:.3g} count")
    members = min(int(count), draws)
    return replace(start, population=points[systematic(weight, members, rng)])


def _without_sample(start: Start, why: str) -> Start:
    """The start without a sample, with the reason in the log."""
    LOG.info("walkers start as a cloud about the best fit: %s", why)
    return start


def _normalised(log_weight: Array) -> tuple[Array, float]:
    """Weights that sum to 1, and how many draws of equal weight would tell as much."""
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return weight, float(1.0 / np.sum(weight**2))


def cloud(target: LogDensity, start: Start, walkers: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Starting points (walkers, ndim) of one ensemble and their log densities (walkers,), all finite.

    Members of the start's population, where it has one. Else normal draws with the local covariance about the optimum,
    none more than a sensible depth below it; drawn closer in when too few are good.
    """
    if len(start.population) >= walkers:
        chosen = start.population[rng.choice(len(start.population), walkers, replace=False)]
        return chosen, np.asarray(target(chosen), dtype=float)
    ndim = len(start.point)
    depth = start.log_prob - 3.0 * ndim - 20.0
    root = np.linalg.cholesky(start.covariance)
    scale = 1.0
    kept = np.empty((0, ndim))
    values = np.empty(0)
    for _ in range(40):
        points = start.point + scale * rng.standard_normal((2 * walkers, ndim)) @ root.T
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
