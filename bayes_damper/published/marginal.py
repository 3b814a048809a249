"""The published features of one case, its spring and its release angle integrated out.

Neither is known as well as it decides the features, and neither says anything of the parameters that cases may share.

- The spring is known to 0.3 % from the uncoupled period. Over that, nothing else moves by what matters: its integral
  stands apart.
- The angle is known to 2 % beforehand, and to 0.3 to 3 % from the highest accelerations, which grow with it in
  proportion but for what friction takes off. Decrement and period of the coupled rig do not: a jag of dry friction that
  just reaches across zero makes the period jump by half. Drawn out linearly from two angles they would meet the
  measured ones where no record does, and what looks for high likelihoods finds just those places: at draws of such a
  posterior it was too high by 0.4 to 0.9 nats on average, by 8 at worst. So what the smooth features leave of the angle
  is cut into parts of equal weight, and one coupled record is simulated in the middle of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import from_standard, median
from bayes_damper.priors.files import PriorSet
from bayes_damper.published.posterior import Coordinates, Datum, FeaturePosterior, feature_times, taken_by_friction

Array = NDArray[np.float64]
OWN = ("k1t", "theta0")
"""Parameters that each case has for itself."""
LONGEST = 0.3
"""Seconds of a record that are simulated at most: the second lobe ends after 1.25 periods of 0.11 to 0.15 s."""
_NUMBERS = (
    "period (uncoupled)", "log_decrement (uncoupled)", "max_acceleration (uncoupled)", "max_acceleration (coupled)",
    "log_decrement (coupled)", "period (coupled)",
)  # fmt: skip
_PERIOD, _DECREMENT, _HIGHEST, _PEAK, *_ROUGH = range(6)
_SMOOTH = [_DECREMENT, _HIGHEST, _PEAK]
_PARTS = 4
"""Coupled records a point: parts that the angle is cut into."""
_NEAR = 0.005
"""A spring that must move by more than this to give the measured period is simulated again."""
_TRIES = 4
_SPRINGS = np.linspace(-4.0, 4.0, 33)
_ANGLES = np.linspace(-3.6, 3.6, 121)
_EXPONENTS = {"log_decrement": -0.75, "max_acceleration": 1.0}
"""How features change with the spring, d ln feature / d ln k1t, to 0.3 or so: viscous damping counts for half as much
with a stiffer one, dry friction for all of it."""


class _Angles(NamedTuple):
    """Of n points: spring (n,) and integral over it (n,); smooth features at the middle angle and how they change with
    the relative one, (n, k); angles of the records (n, parts), and to which of them each of `_ANGLES` belongs; what the
    accelerations there are above the smooth ones, and the density of the other coupled features, both (n, parts).
    """

    spring: Array
    over_springs: Array
    smooth: Array
    slopes: Array
    places: Array
    owner: NDArray[np.intp]
    above: Array
    rough: Array


class CaseFeatures:
    """Likelihood of the published numbers of one case, its spring and its release angle integrated out.

    data : its six numbers, all from as many trials; priors : of the case, those of k1t and theta0 with a width; law :
    exchanges a formula of the model; tolerance : factor on the integrator's; parts : coupled records a point.

    Raises
    ------
    InputError
        if k1t or theta0 has no prior, a number is missing, or they come from different numbers of trials.
    """

    def __init__(
        self, case: str, data: Sequence[Datum], priors: PriorSet, normal_force: str = "linear",
        law: Variant | None = None, tolerance: float = 1.0, parts: int = _PARTS,
    ) -> None:  # fmt: skip
        if len({d.n for d in data}) != 1 or {d.name for d in data} != set(_NUMBERS):
            raise InputError(
                f"case {case}: {', '.join(_NUMBERS)} are needed, all from the same number of trials; "
                f"given are {', '.join(f'{d.name} of {d.n}' for d in data)}"
            )
        missing = [name for name in OWN if name not in priors.free]
        if missing:
            raise InputError(f"priors {priors.name!r}: {missing[0]} needs a prior with a width in case {case}")
        self.case, self._freedom, self._parts = case, data[0].n - 1.0, parts
        self.data = tuple(sorted(data, key=lambda d: _NUMBERS.index(d.name)))
        self.own = {name: priors.free[name] for name in OWN}
        free = {name: prior for name, prior in priors.free.items() if name not in OWN}
        self.coordinates = Coordinates(free, priors.fixed, priors.tied)
        self._posterior = FeaturePosterior(
            self.data, self.coordinates, normal_force, case, effect=law, times=feature_times(self.data, LONGEST),
            tolerance=tolerance,
        )  # fmt: skip
        self._angle = median(self.own["theta0"])

    def log_likelihood(self, z: Array) -> Array:
        """Log likelihood of all numbers at points (n, ndim) in standard coordinates, (n,)."""
        seen = self._seen(self.coordinates.values(z))
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self._density(seen).sum(axis=1) * seen.over_springs))

    def own_draws(self, values: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Array]:
        """Spring and angle, drawn from what the numbers say of them, given all others by name: name -> (n,)."""
        seen = self._seen(values)
        relative = from_standard(self.own["theta0"], _ANGLES)
        angle = relative[_chosen(self._density(seen), rng)]
        density, u = self._spring_density(seen.spring), self._springs[0]
        spring = seen.spring * np.exp(u[_chosen(density, rng)])
        known = np.isfinite(seen.spring)
        return {"k1t": np.where(known, spring, np.nan), "theta0": np.where(known, angle, np.nan)}

    def predict(self, values: Mapping[str, Array]) -> Array:
        """Features for parameters by name, spring and angle among them, in the order of the data: (n, n_data)."""
        return self._posterior.predict_from(values)

    def _seen(self, values: Mapping[str, Array]) -> _Angles:
        """What records show: one of the uncoupled rig, some of the coupled one."""
        spring, features = self._about(values)
        # Friction takes the same from a peak at any angle, and dry friction the same from each cycle.
        start = spring * self._angle / values["J1"]
        dry = np.minimum(4.0 * values["drag"] / (spring * self._angle), features[:, _DECREMENT])
        taken = taken_by_friction(self.data[_PEAK].value, values)
        smooth = np.stack([features[:, _DECREMENT], features[:, _HIGHEST], start - taken], axis=1)
        slopes = np.stack([-dry, start, start], axis=1)
        owner, middle = self._cut(self._over_angles(smooth[:, :, None] + slopes[:, :, None] * self._relative))
        places = self._relative[middle]
        above, rough = np.zeros(places.shape), np.zeros(places.shape)
        which = np.flatnonzero(np.isfinite(smooth).all(axis=1))
        if which.size:
            found = self._coupled(values, which, spring, places)
            above[which] = np.nan_to_num(found[..., _PEAK] - (smooth[which, -1:] + slopes[which, -1:] * places[which]))
            rough[which] = np.nan_to_num(np.prod([self._student(found[..., j], j) for j in _ROUGH], axis=0))
        over = np.nan_to_num(self._spring_density(spring).sum(axis=1))
        return _Angles(spring, over, smooth, slopes, places, owner, above, rough)

    def _density(self, seen: _Angles) -> Array:
        """Likelihood times prior at each of `_ANGLES`, (n, angles)."""
        smooth = seen.smooth[:, :, None] + seen.slopes[:, :, None] * self._relative
        smooth[:, -1] += np.take_along_axis(seen.above, seen.owner, axis=1)
        found = self._over_angles(smooth) * np.take_along_axis(seen.rough, seen.owner, axis=1)
        return np.where(np.isfinite(found), found, 0.0)

    def _over_angles(self, smooth: Array) -> Array:
        """Prior times likelihood of the smooth features (n, k, angles) alone, (n, angles)."""
        weight = np.exp(-0.5 * _ANGLES**2) * (_ANGLES[1] - _ANGLES[0]) / math.sqrt(2.0 * math.pi)
        return np.asarray(weight * np.prod([self._student(smooth[:, k], j) for k, j in enumerate(_SMOOTH)], axis=0))

    def _cut(self, weights: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Parts of equal weight: to which each angle belongs, and the angle in the middle of each."""
        whole = np.cumsum(weights, axis=1)
        share = (whole - 0.5 * weights) / whole[:, -1:]
        share = np.where(np.isfinite(share), share, (np.arange(len(_ANGLES)) + 0.5) / len(_ANGLES))
        middles = (np.arange(self._parts) + 0.5) / self._parts
        owner = np.minimum((share * self._parts).astype(np.intp), self._parts - 1)
        return owner, np.minimum((share[:, None] < middles[:, None]).sum(axis=2), len(_ANGLES) - 1)

    def _coupled(self, values: Mapping[str, Array], which: NDArray[np.intp], spring: Array, places: Array) -> Array:
        """Features of the coupled rig at some of the points and their angles, (n, parts, n_data)."""
        found = np.full((len(which) * self._parts, len(self.data)), np.nan)
        some = {name: np.repeat(x[which], self._parts) for name, x in values.items()}
        some |= {"k1t": np.repeat(spring[which], self._parts), "theta0": self._angle * (1.0 + places[which].ravel())}
        self._fill(found, some, "coupled", np.arange(len(found)))
        return found.reshape(len(which), self._parts, -1)

    def _student(self, feature: Array, j: int) -> Array:
        """Density of one number at a feature."""
        nu, d = self._freedom, self.data[j]
        constant = math.exp(float(gammaln(0.5 * nu + 0.5) - gammaln(0.5 * nu))) / math.sqrt(nu * math.pi)
        inside = 1.0 + ((feature - d.value) / d.standard_error) ** 2 / nu
        # Three trials each, as published: a root costs a tenth of a power.
        power = inside * np.sqrt(inside) if nu == 2.0 else inside ** (0.5 * (nu + 1.0))
        return np.asarray(constant / d.standard_error / power)

    def _spring_density(self, spring: Array) -> Array:
        """Prior times likelihood of the uncoupled period about the spring that gives it, (n, nodes)."""
        u, width = self._springs
        springs = spring[:, None] * np.exp(u)
        density = np.exp(self.own["k1t"].logpdf(springs)) * springs * width
        return np.asarray(density * self._student(self.data[_PERIOD].value * np.exp(-0.5 * u), _PERIOD))

    @cached_property
    def _relative(self) -> Array:
        """Relative changes of the angle from its middle, at `_ANGLES` standard deviations."""
        return np.asarray(from_standard(self.own["theta0"], _ANGLES) / self._angle - 1.0)

    @cached_property
    def _springs(self) -> tuple[Array, Array]:
        """Relative changes of the spring, and their widths."""
        period = self.data[_PERIOD]
        reach = 2.0 * period.standard_error / period.value
        return reach * np.sinh(_SPRINGS), reach * np.cosh(_SPRINGS) * (_SPRINGS[1] - _SPRINGS[0])

    def _about(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """The spring that gives the measured period, (n,), nan if none does, and the uncoupled features there."""
        n, measured = len(values["J1"]), self.data[_PERIOD].value
        features, left = np.full((n, len(self.data)), np.nan), np.arange(n)
        spring = np.asarray(values["J1"]) * (2.0 * math.pi / measured) ** 2
        for _ in range(_TRIES):
            some = {name: x[left] for name, x in values.items()}
            self._fill(
                features, some | {"k1t": spring[left], "theta0": np.full(left.size, self._angle)}, "uncoupled", left
            )
            shift = np.clip(2.0 * np.log(features[left, _PERIOD] / measured), -0.5, 0.5)
            spring[left] *= np.exp(shift)  # nan where the record has no period
            near = np.abs(shift) < _NEAR
            for j in (_DECREMENT, _HIGHEST):
                features[left[near], j] *= np.exp(_EXPONENTS[self.data[j].quantity] * shift[near])
            left = left[np.abs(shift) >= _NEAR]
            if left.size == 0:
                break
        spring[left] = np.nan
        return spring, features

    def _fill(self, out: Array, values: Mapping[str, Array], configuration: str, which: NDArray[np.intp]) -> None:
        """Puts the features of one configuration into their columns of some rows of `out` (n, n_data)."""
        found = self._posterior.features_of(configuration, values)
        for j, d in enumerate(self.data):
            if d.configuration == configuration:
                out[which, j] = getattr(found, d.quantity)


def _chosen(density: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """A column for each row of (n, k), by its density."""
    share = np.cumsum(density, axis=1)
    place = np.sum(share < rng.random((len(share), 1)) * share[:, -1:], axis=1)
    return np.asarray(np.minimum(place, density.shape[1] - 1), np.intp)
