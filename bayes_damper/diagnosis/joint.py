"""The published features of all cases under one formula: likelihood, evidence and posterior.

One set of shared parameters explains all cases: the sharpest test there is, because a formula must explain every case
with the same numbers. Each case has a spring and a release angle of its own. These two are integrated out by
quadrature for every point of the shared parameters, the features being linear in them over the few per cent that
matter; what is left has a dozen unknowns and, because the errors have heavy tails, narrow modes: which numbers are
the outliers. Importance sampling meets those by chance. So the evidence of a formula is taken on a way from a density
that is known to the posterior, in stages short enough that half of the draws count at each (sequential Monte Carlo: Del
Moral, Doucet and Jasra 2006, J. R. Stat. Soc. B 68, 411). The way begins at a Student t that was fitted to the nominal
posterior, times the prior of what the formula adds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, from_standard
from bayes_damper.priors.distributions import median as median_of
from bayes_damper.priors.files import PriorSet
from bayes_damper.published.posterior import (
    EFFECT_PREFIX,
    Coordinates,
    Datum,
    FeaturePosterior,
    damping_pairs,
    feature_times,
)
from bayes_damper.rig.kernels import compiled
from bayes_damper.sampling.moves import StudentT
from bayes_damper.sampling.sequential import Powers, Whole, temper

Array = NDArray[np.float64]
LONGEST = 0.3
"""Seconds of a record that are simulated at most: the second lobe ends after 1.25 periods of 0.11 to 0.15 s."""
OWN = ("k1t", "theta0")
"""Parameters that each case has for itself."""
BLUR = "blur"
"""Coordinate of a generic discrepancy: its size relative to the feature."""
_STEPS = (0.01, 0.02)  # relative changes of spring and angle that give the slopes
_NEAR = 0.02  # a spring that must move by more than this to give the measured period is simulated again
_TRIES = 4
_SPRINGS = np.linspace(-4.0, 4.0, 25)
_ANGLES = np.linspace(-3.6, 3.6, 41)
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
        own = {} if self.variant is None else {EFFECT_PREFIX + p.name: p.prior for p in self.variant.parameters}
        return own if self.blur is None else own | {BLUR: self.blur}


@compiled()
def _integrate(
    centre: Array, springs: Array, angles: Array, measured: Array, scale: Array, dof: float,
    nodes_u: Array, weight_u: Array, nodes_v: Array, weight_v: Array, out: Array,
) -> None:  # fmt: skip
    """Integral over spring and angle of the product of Student densities, without their constants, (n,).

    centre, springs, angles, scale : (n, k), features at the centre, their slopes, their errors.
    """
    n, k = centre.shape
    power, freedom = -0.5 * (dof + 1.0), 1.0 / dof
    off, with_angle = np.empty(k), np.empty(k)
    for i in range(n):
        total = 0.0
        for j in range(k):
            with_angle[j] = angles[i, j] / scale[i, j]
        for a in range(nodes_u.size):
            for j in range(k):
                off[j] = (centre[i, j] + springs[i, j] * nodes_u[a] - measured[j]) / scale[i, j]
            part = 0.0
            for b in range(nodes_v.size):
                product = 1.0
                for j in range(k):
                    t = off[j] + with_angle[j] * nodes_v[b]
                    product *= 1.0 + freedom * t * t
                # Three trials each, as published: a root costs a tenth of a power.
                part += weight_v[b] * (1.0 / (product * math.sqrt(product)) if dof == 2.0 else product**power)
            total += weight_u[i, a] * part
        out[i] = total


@dataclass(frozen=True)
class Predicted:
    """Features of one case about its best spring: at the centre, and their slopes with ln k1t and theta0 / theta0_0.

    Each (n, k); spring : (n,) k1t at the centre, N m/rad.
    """

    centre: Array
    springs: Array
    angles: Array
    spring: Array


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

    data : case -> its published numbers; priors : of the nominal parameters; plain : whether coordinates are the unit
    Gaussians of the priors, without sums and ratios of dampings; tolerance : factor on the integrator's.

    Raises
    ------
    InputError
        if k1t or theta0 has no prior, or the numbers come from different numbers of trials.
    """

    def __init__(
        self, data: Mapping[str, Sequence[Datum]], priors: PriorSet, formula: Formula, normal_force: str = "linear",
        *, plain: bool = False, tolerance: float = 1.0,
    ) -> None:  # fmt: skip
        self.formula = formula
        self.data = {case: tuple(rows) for case, rows in data.items()}
        self.cases = tuple(self.data)
        dofs = {d.n - 1.0 for rows in self.data.values() for d in rows}
        if len(dofs) != 1:
            raise InputError("published numbers of different numbers of trials cannot be diagnosed together")
        self.dof = dofs.pop()
        own = {case: priors.for_case(case) for case in self.cases}
        first = own[self.cases[0]]
        for case in self.cases:
            missing = [name for name in OWN if name not in own[case].free]
            if missing:
                raise InputError(f"priors {priors.name!r}: {missing[0]} needs a prior with a width in case {case}")
        free = {name: prior for name, prior in first.free.items() if name not in OWN} | formula.extras
        pairs = () if plain else damping_pairs(first.medians())
        self.coordinates = Coordinates(
            free, first.fixed, first.tied, tuple(p for p in pairs if p.x in free and p.y in free)
        )
        self.own = {case: {name: own[case].free[name] for name in OWN} for case in self.cases}
        self.models = {
            case: FeaturePosterior(
                rows,
                self.coordinates,
                normal_force,
                case,
                effect=formula.variant,
                times=feature_times(rows, LONGEST),
                tolerance=tolerance,
            )
            for case, rows in self.data.items()
        }

    @property
    def ndim(self) -> int:
        """Number of shared unknowns."""
        return self.coordinates.ndim

    def predict(self, points: Array, case: str) -> Predicted:
        """Features of one case at points (n, ndim), about the spring that gives the measured uncoupled period."""
        values = self.coordinates.values(points)
        values.pop(BLUR, None)
        rows = self.data[case]
        n, k = len(points), len(rows)
        which = next((j for j, d in enumerate(rows) if (d.configuration, d.quantity) == ("uncoupled", "period")), None)
        angle = median_of(self.own[case]["theta0"])
        if which is None:
            spring = np.full(n, median_of(self.own[case]["k1t"]))
        else:
            spring = np.asarray(values["J1"]) * (2.0 * math.pi / rows[which].value) ** 2
        centre, springs, angles = (np.full((n, k), np.nan) for _ in range(3))
        left = np.arange(n)
        logs = np.array([d.quantity != "log_decrement" for d in rows])
        for _ in range(_TRIES):
            some = {name: np.tile(x[left], 3) for name, x in values.items()}
            m = left.size
            some["k1t"] = np.concatenate([spring[left], spring[left] * (1.0 + _STEPS[0]), spring[left]])
            some["theta0"] = np.repeat([angle, angle, angle * (1.0 + _STEPS[1])], m)
            found = self.models[case].predict_from(some)
            found[:, logs] = np.log(found[:, logs])
            base = found[:m]
            slope_k = (found[m : 2 * m] - base) / math.log1p(_STEPS[0])
            slope_a = (found[2 * m :] - base) / _STEPS[1]
            shift = np.zeros(m) if which is None else (math.log(rows[which].value) - base[:, which]) / slope_k[:, which]
            shift = np.clip(np.nan_to_num(shift), -0.5, 0.5)
            near = np.abs(shift) < _NEAR
            moved = base + slope_k * np.where(near, shift, 0.0)[:, None]
            moved[:, logs] = np.exp(moved[:, logs])
            slope_k[:, logs] *= moved[:, logs]
            slope_a[:, logs] *= moved[:, logs]
            centre[left], springs[left], angles[left] = moved, slope_k, slope_a
            spring[left] *= np.exp(shift)
            left = left[~near]
            if left.size == 0:
                break
        else:
            centre[left] = np.nan  # no spring gives the measured period
        return Predicted(centre, springs, angles, spring)

    @cached_property
    def _nodes(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """Of each case: relative changes of the spring, their widths, relative changes of the angle, their weights."""
        out = {}
        for case, rows in self.data.items():
            period = [d for d in rows if (d.configuration, d.quantity) == ("uncoupled", "period")]
            reach = 2.0 * period[0].standard_error / period[0].value if period else 0.1
            u = reach * np.sinh(_SPRINGS)
            width = reach * np.cosh(_SPRINGS) * (_SPRINGS[1] - _SPRINGS[0])
            prior = self.own[case]["theta0"]
            v = from_standard(prior, _ANGLES) / median_of(prior) - 1.0
            weight = np.exp(-0.5 * _ANGLES**2) * (_ANGLES[1] - _ANGLES[0]) / math.sqrt(2.0 * math.pi)
            out[case] = (u, width, v, weight)
        return out

    def scales(self, points: Array, case: str, centre: Array) -> Array:
        """Errors of the features (n, k): as published, plus the generic discrepancy."""
        rows = self.data[case]
        scale = np.tile([d.standard_error for d in rows], (len(points), 1))
        if self.formula.blur is not None:
            blur = self.coordinates.values(points)[BLUR]
            for j, d in enumerate(rows):
                if (d.configuration, d.quantity) in self.formula.blurred:
                    scale[:, j] = np.hypot(scale[:, j], np.nan_to_num(blur * centre[:, j]))
        return scale

    def case_likelihood(
        self, points: Array, case: str, predicted: Predicted, configurations: tuple[str, ...] = ("uncoupled", "coupled")
    ) -> Array:
        """Log likelihood of the numbers of one case, spring and angle integrated out, (n,); of some configurations."""
        rows = self.data[case]
        keep = [j for j, d in enumerate(rows) if d.configuration in configurations]
        u, width, v, weight = self._nodes[case]
        springs = predicted.spring[:, None] * np.exp(u)
        density = np.exp(self.own[case]["k1t"].logpdf(springs)) * springs * width
        scale = self.scales(points, case, predicted.centre)
        total = np.empty(len(points))
        measured = np.array([rows[j].value for j in keep])
        centre, slope_k, slope_a, width_of = (
            np.ascontiguousarray(a[:, keep]) for a in (predicted.centre, predicted.springs, predicted.angles, scale)
        )
        _integrate(centre, slope_k, slope_a, measured, width_of, self.dof, u, density, v, weight, total)
        nu = self.dof
        constant = float(gammaln((nu + 1.0) / 2.0) - gammaln(nu / 2.0) - 0.5 * math.log(nu * math.pi))
        with np.errstate(divide="ignore"):
            value = np.log(total) + len(keep) * constant - np.log(width_of).sum(axis=1)
        return np.where(np.isfinite(value), value, -np.inf)

    def features(
        self, points: Array, case: str, rng: np.random.Generator, configurations: tuple[str, ...]
    ) -> tuple[Array, Array]:
        """Features of one case (n, k) and its spring (n,).

        Spring and angle are drawn from what the numbers of some configurations say about them.
        """
        features, spring, _ = self._drawn(points, case, rng, configurations)
        return features, spring

    def own_draws(self, points: Array, case: str, rng: np.random.Generator) -> dict[str, Array]:
        """Spring and release angle of a case, drawn from what all its numbers say about them: name -> (n,)."""
        _, spring, angle = self._drawn(points, case, rng, ("uncoupled", "coupled"))
        return dict(zip(OWN, (spring, angle), strict=True))

    def _drawn(
        self, points: Array, case: str, rng: np.random.Generator, configurations: tuple[str, ...]
    ) -> tuple[Array, Array, Array]:
        """Features of one case (n, k), its spring and its release angle (n,), nan where nothing has the features."""
        predicted = self.predict(points, case)
        rows = self.data[case]
        keep = [j for j, d in enumerate(rows) if d.configuration in configurations]
        u, width, v, weight = self._nodes[case]
        springs = predicted.spring[:, None] * np.exp(u)
        scale = self.scales(points, case, predicted.centre)
        features = np.full(predicted.centre.shape, np.nan)
        chosen, angle = np.full((2, len(points)), np.nan)
        for i in np.flatnonzero(np.isfinite(predicted.centre).all(axis=1)):
            f = (
                predicted.centre[i] + predicted.springs[i] * u[:, None, None] + predicted.angles[i] * v[:, None]
            )  # (springs, angles, k)
            t = (f[..., keep] - np.array([rows[j].value for j in keep])) / scale[i, keep]
            density = np.exp(-0.5 * (self.dof + 1.0) * np.log1p(t**2 / self.dof).sum(axis=-1)) * weight
            density *= (np.exp(self.own[case]["k1t"].logpdf(springs[i])) * springs[i] * width)[:, None]
            total = density.sum()
            if not total > 0.0:
                continue
            place = rng.choice(density.size, p=density.ravel() / total)
            features[i], chosen[i] = f.reshape(-1, f.shape[-1])[place], springs[i, place // len(v)]
            angle[i] = median_of(self.own[case]["theta0"]) * (1.0 + v[place % len(v)])
        return features, chosen, angle

    def log_likelihood(self, points: Array) -> Array:
        """Log likelihood of each case, (n, cases)."""
        return np.stack([self.case_likelihood(points, c, self.predict(points, c)) for c in self.cases], axis=1)

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


def simulated(joint: Joint, rng: np.random.Generator, tries: int = 200) -> dict[str, tuple[Datum, ...]]:
    """Numbers as the formula would have given them: everything drawn from its prior, published standard errors.

    Drawn again where a record has no second peak, because such numbers would not have been published.

    Raises
    ------
    InputError
        if no draw of the prior has all features.
    """
    for _ in range(tries):
        values = joint.coordinates.values(joint.coordinates.draw(rng, 1))
        blur = values.pop(BLUR, np.zeros(1))
        out: dict[str, tuple[Datum, ...]] = {}
        for case, rows in joint.data.items():
            own = {name: from_standard(joint.own[case][name], rng.standard_normal(1)) for name in OWN}
            features = joint.models[case].predict_from(values | own)[0]
            scale = np.array([
                math.hypot(d.standard_error, float(blur[0]) * f)
                if (d.configuration, d.quantity) in joint.formula.blurred else d.standard_error
                for d, f in zip(rows, features, strict=True)
            ])  # fmt: skip
            measured = features + scale * rng.standard_t(joint.dof, len(rows))
            out[case] = tuple(replace(d, value=float(x)) for d, x in zip(rows, measured, strict=True))
        if all(math.isfinite(d.value) and d.value > 0.0 for rows in out.values() for d in rows):
            return out
    raise InputError(f"{joint.formula.family}: none of {tries} draws of the prior shows all features")
