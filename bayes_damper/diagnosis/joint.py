"""The published features of all cases under one formula: likelihood, evidence and posterior.

One set of shared parameters explains all cases: the sharpest test there is, because a formula must explain every case
with the same numbers. Each case has a spring and a release angle of its own, integrated out for every point of the
shared parameters as `variability` does (published/marginal.py); what is left has a dozen unknowns and, because the
errors have heavy tails, narrow modes: which numbers are the outliers. Importance sampling meets those by chance. So the
evidence of a formula is taken on a way from a density that is known to the posterior, in stages short enough that half
of the draws count at each (sequential Monte Carlo: Del Moral, Doucet and Jasra 2006, J. R. Stat. Soc. B 68, 411). The
way begins at a Student t that was fitted to the nominal posterior, times the prior of what the formula adds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, median
from bayes_damper.priors.files import PriorSet
from bayes_damper.published.marginal import BLUR, OWN, TOLERANCE, CaseFeatures
from bayes_damper.published.posterior import Coordinates, Datum, damping_pairs
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.sampling.moves import StudentT
from bayes_damper.sampling.sequential import Powers, Whole, temper

Array = NDArray[np.float64]
_FREEDOM = 6.0
_WIDER = 1.15  # sds of a proposal over those of the draws that it is fitted to


@dataclass(frozen=True)
class Formula:
    """One explanation of the published numbers.

    family : "none", "unknown" or the name of an effect; variant : the effect's formula; blurred : (configuration,
    quantity) of the features whose error a generic discrepancy adds to, relative to the feature and with prior `blur`.
    """

    family: str
    name: str
    text: str
    sites: tuple[str, ...] = ()
    variant: Variant | None = None
    blurred: frozenset[tuple[str, str]] = frozenset()
    blur: Distribution | None = None

    @property
    def extras(self) -> dict[str, Distribution]:
        """Priors of what the formula adds to the nominal parameters."""
        own = {} if self.variant is None else {OF_EFFECT + p.name: p.prior for p in self.variant.parameters}
        return own if self.blur is None else own | {BLUR: self.blur}


class Target(Protocol):
    """What the evidence is taken of."""

    formula: Formula

    @property
    def ndim(self) -> int:
        """Number of unknowns."""

    def log_target(self, points: Array) -> Array:
        """Log of prior times likelihood at points (n, ndim): (n,)."""


class Joint:
    """All cases under one formula. Points (n, ndim) of the shared parameters are in `coordinates`.

    data : case -> its published numbers; priors : of the nominal parameters.

    Raises
    ------
    InputError
        if k1t or theta0 has no prior, a number is missing, or they come from different numbers of trials.
    """

    def __init__(self, data: Mapping[str, Sequence[Datum]], priors: PriorSet, formula: Formula) -> None:
        self.formula = formula
        own = {case: priors.for_case(case) for case in data}
        self.cases = {
            case: CaseFeatures(
                case, rows, own[case], law=formula.variant, tolerance=TOLERANCE, blurred=formula.blurred,
                pilot=formula.variant is not None,
            )
            for case, rows in data.items()
        }  # fmt: skip
        freedoms = {d.n - 1.0 for case in self.cases.values() for d in case.data}
        if len(freedoms) != 1:
            raise InputError("published numbers of different numbers of trials cannot be diagnosed together")
        self.dof = freedoms.pop()
        first = next(iter(own.values()))
        free = {name: prior for name, prior in first.free.items() if name not in OWN} | formula.extras
        pairs = tuple(p for p in damping_pairs(first.medians()) if p.x in free and p.y in free)
        self.coordinates = Coordinates(free, first.fixed, first.tied, pairs)

    @property
    def ndim(self) -> int:
        """Number of shared unknowns."""
        return self.coordinates.ndim

    def features(self, points: Array, case: str, rng: np.random.Generator, coupled: bool = True) -> tuple[Array, Array]:
        """Features of one case (n, k) and its spring (n,), nan where nothing has the features.

        Spring and angle are drawn from what its numbers say about them; coupled : all of them, else the uncoupled.
        """
        values = self.coordinates.values(points)
        own = self.cases[case].own_draws(values, rng, coupled)
        features = self.cases[case].predict(values | {name: np.nan_to_num(x, nan=1e-3) for name, x in own.items()})
        return np.where(np.isfinite(own["k1t"])[:, None], features, np.nan), own["k1t"]

    def at_the_middle(self, points: Array, case: str) -> Array:
        """Features of one case at the middle of its spring's and angle's priors, (n, k)."""
        own = {name: np.full(len(points), median(prior)) for name, prior in self.cases[case].own.items()}
        return self.cases[case].predict(self.coordinates.values(points) | own)

    def log_likelihood(self, points: Array) -> Array:
        """Log likelihood of each case, (n, cases)."""
        values = self.coordinates.values(points)
        return np.stack([case.log_density(values) for case in self.cases.values()], axis=1)

    def log_target(self, points: Array) -> Array:
        """Log of prior times likelihood of the shared parameters, (n,)."""
        return np.asarray(self.coordinates.log_prior(points) + self.log_likelihood(points).sum(axis=1))


@dataclass(frozen=True)
class Weighed:
    """A formula with its evidence.

    points (n, ndim) and log weights (n,) of the posterior (weights sum to 1); log evidence with its standard error;
    ess : effective number of points.
    """

    target: Target
    points: Array
    log_weights: Array
    log_z: float
    error: float
    ess: float

    @property
    def joint(self) -> Joint:
        """The target, where it is that of published numbers."""
        assert isinstance(self.target, Joint)
        return self.target

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Equally weighted points, (count, ndim)."""
        return self.points[rng.choice(len(self.points), count, p=np.exp(self.log_weights))]


def proposal(points: Array, log_weights: Array | None = None) -> StudentT:
    """A Student t of the place and shape of weighted points, slightly wider."""
    share = None if log_weights is None else np.exp(log_weights - logsumexp(log_weights))
    mean = np.average(points, axis=0, weights=share)
    covariance = np.atleast_2d(np.cov(points.T, aweights=share))
    covariance = covariance + 1e-6 * np.diag(np.diag(covariance)) + 1e-10 * np.eye(len(mean))
    return StudentT(mean, covariance * _WIDER**2 * (_FREEDOM - 2.0) / _FREEDOM, _FREEDOM)


def beginning(known: StudentT, joint: Joint) -> StudentT:
    """The proposal that an effect's evidence begins with: the nominal posterior, and the prior of what is added."""
    extra = joint.ndim - len(known.centre)
    mean = np.concatenate([known.centre, np.zeros(extra)])
    covariance = np.eye(joint.ndim)
    covariance[: len(known.centre), : len(known.centre)] = known.covariance
    return StudentT(mean, covariance, known.freedom)


def learn(target: Target, begin: StudentT, rng: np.random.Generator, rounds: int, count: int) -> list[StudentT]:
    """Proposals of rounds of `count` draws, each but the first fitted to all draws before; one more than rounds.

    Raises
    ------
    InputError
        if the likelihood is zero at every draw.
    """
    proposals = [begin]
    points = np.empty((0, target.ndim))
    heights = np.empty(0)
    for _ in range(rounds):
        fresh = proposals[-1].draw(rng, count)
        points = np.concatenate([points, fresh])
        heights = np.concatenate([heights, target.log_target(fresh)])
        if not np.any(np.isfinite(heights)):
            raise InputError(
                f"{target.formula.family} ({target.formula.name}): the likelihood is zero at all {len(heights)} points "
                "tried: widen the priors, or look whether the numbers have the units that they say"
            )
        weights = heights - _mixture(proposals, points)
        proposals.append(proposal(points, _flattened(weights, 10.0 * target.ndim)))
    return proposals


def weigh_formula(
    target: Target, begin: StudentT, rng: np.random.Generator, *, count: int = 192, sweeps: int = 8
) -> Weighed:
    """Evidence and posterior of one formula, on the way from `begin` to it.

    count : draws carried along; sweeps : most Metropolis sweeps a stage, which ends when the draws have forgotten where
    they stood. The effective number of draws is discounted by what the last stage left them to remember.

    Raises
    ------
    InputError
        if the likelihood is zero at every draw.
    """

    def over(points: Array) -> Array:
        return target.log_target(points) - begin.log_density(points)

    way = Whole(target.ndim, begin.draw, begin.log_density, Powers(over))
    try:
        found = temper(way, rng, count, kept=sweeps, settle=False, sweeps=sweeps)
    except InputError as error:
        raise InputError(f"{target.formula.family} ({target.formula.name}): {error}") from error
    size = len(found.points)
    ess = count * max(1.0 - found.forgotten, 0.0) / (1.0 + found.forgotten)
    return Weighed(target, found.points, np.full(size, -math.log(size)), found.log_z, found.error, ess)


def _mixture(proposals: Sequence[StudentT], points: Array) -> Array:
    """Log density of all proposals together, each with the same share."""
    return np.asarray(logsumexp([p.log_density(points) for p in proposals], axis=0) - math.log(len(proposals)))


def from_prior(joint: Joint) -> StudentT:
    """The proposal that a search begins with when nothing is known: the prior."""
    return proposal(joint.coordinates.draw(np.random.default_rng(0), 4096))


def _effective(log_weights: Array) -> float:
    share = np.exp(log_weights - logsumexp(log_weights))
    return float(1.0 / np.sum(share**2))


def _flattened(log_weights: Array, least: float) -> Array:
    """Log weights raised to the power, at most 1, at which `least` draws are effective."""
    finite = np.where(np.isfinite(log_weights), log_weights, -1e9)
    finite = finite - finite.max()
    if _effective(finite) >= least:
        return np.asarray(finite)
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _effective(middle * np.maximum(finite, -1e6)) >= least else (low, middle)
    return np.asarray(low * np.maximum(finite, -1e6))
