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
from collections.abc import Collection, Mapping, Sequence
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
BLUR = "blur"
"""Parameter of a generic discrepancy: its size relative to the feature."""
TOLERANCE = 10.0
"""Factor on the integrator's tolerance: features then err by less than 1 % of the published standard errors."""
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
_FEW_SPRINGS = np.linspace(-4.0, 4.0, 11)
_ANGLES = np.linspace(-3.6, 3.6, 121)
_EXPONENTS = {"log_decrement": -0.75, "max_acceleration": 1.0, "period": -0.5}
"""How features change with the spring, d ln feature / d ln k1t, to 0.3 or so: viscous damping counts for half as much
with a stiffer one, dry friction for all of it."""


class _Angles(NamedTuple):
    """Of n points: spring (n,) and the size of a discrepancy (n, 1, 1); smooth features at the middle angle and how
    they change with the relative one, (n, k); to which record each of `_ANGLES` belongs; what the accelerations there
    are above the smooth ones, (n, parts), and the other coupled features, (n, parts, 2), both with nan for none.

    Without coupled records the last three and the last of the smooth features are missing.
    """

    spring: Array
    blur: Array
    smooth: Array
    slopes: Array
    owner: NDArray[np.intp] | None = None
    above: Array | None = None
    rough: Array | None = None


class CaseFeatures:
    """Likelihood of the published numbers of one case, its spring and its release angle integrated out.

    data : its six numbers, all from as many trials; priors : of the case, those of k1t and theta0 with a width; law :
    a formula that the rig follows beside the nominal ones, or in place of one; tolerance : factor on the integrator's;
    parts : coupled records a point; blurred : (configuration, quantity) of the features whose error the parameter
    `BLUR` adds to, relative to the feature; pilot : whether the highest coupled acceleration, before the angle is cut,
    comes from a record of its own, for formulas by which what friction takes of it cannot be reckoned.

    Raises
    ------
    InputError
        if k1t or theta0 has no prior, a number is missing, or they come from different numbers of trials.
    """

    def __init__(
        self, case: str, data: Sequence[Datum], priors: PriorSet, normal_force: str = "linear",
        law: Variant | None = None, tolerance: float = 1.0, parts: int = _PARTS,
        blurred: Collection[tuple[str, str]] = (), pilot: bool = False,
    ) -> None:  # fmt: skip
        if len({d.n for d in data}) != 1 or {d.name for d in data} != set(_NUMBERS):
            raise InputError(
                f"case {case}: {', '.join(_NUMBERS)} are needed, all from the same number of trials; "
                f"given are {', '.join(f'{d.name} of {d.n}' for d in data)}"
            )
        missing = [name for name in OWN if name not in priors.free]
        if missing:
            raise InputError(f"priors {priors.name!r}: {missing[0]} needs a prior with a width in case {case}")
        self.case, self._freedom, self._parts, self._pilot = case, data[0].n - 1.0, parts, pilot
        self.data = tuple(sorted(data, key=lambda d: _NUMBERS.index(d.name)))
        self._blurred = [(d.configuration, d.quantity) in blurred for d in self.data]
        self.own = {name: priors.free[name] for name in OWN}
        free = {name: prior for name, prior in priors.free.items() if name not in OWN}
        self.coordinates = Coordinates(free, priors.fixed, priors.tied)
        self.posterior = FeaturePosterior(
            self.data, self.coordinates, normal_force, case, effect=law, times=feature_times(self.data, LONGEST),
            tolerance=tolerance,
        )  # fmt: skip
        self._angle = median(self.own["theta0"])

    def log_likelihood(self, z: Array) -> Array:
        """Log likelihood of all numbers at points (n, ndim) in standard coordinates, (n,)."""
        return self.log_density(self.coordinates.values(z))

    def log_density(self, values: Mapping[str, Array], coupled: bool = True) -> Array:
        """Log likelihood for parameters (n,) by name, (n,); coupled : of all numbers, else of the uncoupled rig's."""
        seen = self._seen(values, coupled)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(sum(self._density(seen, u).sum(axis=1) * over for u, over in self._over(seen))))

    def own_draws(
        self, values: Mapping[str, Array], rng: np.random.Generator, coupled: bool = True
    ) -> dict[str, Array]:
        """Spring and angle, drawn from what the numbers say of them, given all others by name: name -> (n,).

        coupled : whether all numbers do, or those of the uncoupled rig alone.
        """
        seen = self._seen(values, coupled)
        relative = from_standard(self.own["theta0"], _ANGLES)
        known, rows = np.isfinite(seen.spring), np.arange(len(seen.spring))
        if self._blurred[_PERIOD]:
            shifts = [(u, self._density(seen, u) * over[:, None]) for u, over in self._over(seen)]
            which = _chosen(np.stack([density.sum(axis=1) for _, density in shifts], axis=1), rng)
            angle = relative[_chosen(np.stack([density for _, density in shifts])[which, rows], rng)]
            spring = seen.spring * np.exp(np.stack([u for u, _ in shifts])[which, rows])
        else:
            angle = relative[_chosen(self._density(seen), rng)]
            u, density = self._springs(seen, _SPRINGS)
            spring = seen.spring * np.exp(np.broadcast_to(u, density.shape)[rows, _chosen(density, rng)])
        return {"k1t": np.where(known, spring, np.nan), "theta0": np.where(known, angle, np.nan)}

    def predict(self, values: Mapping[str, Array]) -> Array:
        """Features for parameters by name, spring and angle among them, in the order of the data: (n, n_data)."""
        return self.posterior.predict_from({name: x for name, x in values.items() if name != BLUR})

    def scales(self, values: Mapping[str, Array], features: Array) -> Array:
        """Errors of features (n, n_data): as published, and with the discrepancy where there is one."""
        blur = np.asarray(values.get(BLUR, np.zeros(len(features))))
        every = [self._scale(features[:, j], j, blur) for j in range(len(self.data))]
        return np.stack(np.broadcast_arrays(*every, features[:, 0])[:-1], axis=1)

    def _seen(self, values: Mapping[str, Array], coupled: bool) -> _Angles:
        """What records show: one of the uncoupled rig, some of the coupled one."""
        values = dict(values)
        blur = np.reshape(values.pop(BLUR, np.zeros(len(values["J1"]))), (-1, 1, 1))
        spring, features = self._about(values)
        # Friction takes the same from a peak at any angle, and dry friction the same from each cycle.
        start = spring * self._angle / values["J1"]
        dry = np.minimum(4.0 * values["drag"] / (spring * self._angle), features[:, _DECREMENT])
        smooth = np.stack([features[:, _DECREMENT], features[:, _HIGHEST]], axis=1)
        slopes = np.stack([-dry, start], axis=1)
        if not coupled:
            return _Angles(spring, blur, smooth, slopes)
        peak, slope = start - taken_by_friction(self.data[_PEAK].value, values), start
        which = np.flatnonzero(np.isfinite(smooth).all(axis=1))
        if self._pilot and which.size:
            # What the formula makes of the acceleration is taken as a factor on it.
            found = np.full(len(peak), np.nan)
            found[which] = self._coupled(values, which, spring, np.zeros((len(spring), 1)))[:, 0, _PEAK]
            peak, slope = found, start * found / np.maximum(peak, 0.1 * start)
        smooth = np.concatenate([smooth, peak[:, None]], axis=1)
        slopes = np.concatenate([slopes, slope[:, None]], axis=1)
        known = _Angles(spring, blur, smooth, slopes)
        owner, middle = self._cut(self._over_angles(known))
        places = self._relative[middle]
        above, rough = np.full(places.shape, np.nan), np.full((*places.shape, len(_ROUGH)), np.nan)
        which = np.flatnonzero(np.isfinite(smooth).all(axis=1))
        if which.size:
            found = self._coupled(values, which, spring, places)
            above[which] = found[..., _PEAK] - (smooth[which, -1:] + slopes[which, -1:] * places[which])
            rough[which] = found[..., _ROUGH]
        return known._replace(owner=owner, above=above, rough=rough)

    def _over(self, seen: _Angles) -> list[tuple[Array, Array]]:
        """Changes of the logarithm of the spring, (n,), and what each counts, (n,).

        As long as the period fixes the spring there is one: nothing but the period changes with it by what matters.
        """
        if not self._blurred[_PERIOD]:
            whole = np.nan_to_num(self._springs(seen, _SPRINGS)[1].sum(axis=1))
            return [(np.zeros(len(whole)), whole)]
        u, density = self._springs(seen, _FEW_SPRINGS)
        return list(zip(u.T, np.nan_to_num(density).T, strict=True))

    def _density(self, seen: _Angles, shift: Array | None = None) -> Array:
        """Likelihood times prior at each of `_ANGLES`, (n, angles), all but the uncoupled period's.

        shift : change of the logarithm of the spring, (n,).
        """
        weights = self._over_angles(seen, shift)
        if seen.rough is not None and seen.owner is not None:
            rough = seen.rough
            if shift is not None:
                rough = rough * np.exp(shift[:, None, None] * [_EXPONENTS[self.data[j].quantity] for j in _ROUGH])
            parts = np.prod([self._student(rough[..., k], j, seen.blur[..., 0]) for k, j in enumerate(_ROUGH)], axis=0)
            weights = weights * np.take_along_axis(np.nan_to_num(parts), seen.owner, axis=1)
        return np.where(np.isfinite(weights), weights, 0.0)

    def _over_angles(self, seen: _Angles, shift: Array | None = None) -> Array:
        """Prior times likelihood of the smooth features alone, (n, angles)."""
        smooth = seen.smooth[:, :, None] + seen.slopes[:, :, None] * self._relative
        if seen.above is not None and seen.owner is not None:
            smooth[:, -1] += np.take_along_axis(np.nan_to_num(seen.above), seen.owner, axis=1)
        which = _SMOOTH[: smooth.shape[1]]
        if shift is not None and np.any(shift):
            powers = np.array([_EXPONENTS[self.data[j].quantity] for j in which])
            smooth = smooth * np.exp(shift[:, None] * powers)[:, :, None]
        weight = np.exp(-0.5 * _ANGLES**2) * (_ANGLES[1] - _ANGLES[0]) / math.sqrt(2.0 * math.pi)
        product = np.prod([self._student(smooth[:, k], j, seen.blur[..., 0]) for k, j in enumerate(which)], axis=0)
        return np.asarray(weight * product)

    def _cut(self, weights: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Parts of equal weight: to which each angle belongs, and the angle in the middle of each."""
        whole = np.cumsum(weights, axis=1)
        share = (whole - 0.5 * weights) / whole[:, -1:]
        share = np.where(np.isfinite(share), share, (np.arange(len(_ANGLES)) + 0.5) / len(_ANGLES))
        middles = (np.arange(self._parts) + 0.5) / self._parts
        owner = np.minimum((share * self._parts).astype(np.intp), self._parts - 1)
        return owner, np.minimum((share[:, None] < middles[:, None]).sum(axis=2), len(_ANGLES) - 1)

    def _coupled(self, values: Mapping[str, Array], which: NDArray[np.intp], spring: Array, places: Array) -> Array:
        """Features of the coupled rig at some of the points and their angles (n, angles): (n, angles, n_data)."""
        count = places.shape[1]
        found = np.full((len(which) * count, len(self.data)), np.nan)
        some = {name: np.repeat(x[which], count) for name, x in values.items()}
        some |= {"k1t": np.repeat(spring[which], count), "theta0": self._angle * (1.0 + places[which].ravel())}
        self._fill(found, some, "coupled", np.arange(len(found)))
        return found.reshape(len(which), count, -1)

    def _scale(self, feature: Array, j: int, blur: Array) -> Array | float:
        """Error of one number where a feature has these values."""
        error = self.data[j].standard_error
        return np.hypot(error, blur * feature) if self._blurred[j] else error

    def _student(self, feature: Array, j: int, blur: Array) -> Array:
        """Density of one number at a feature."""
        nu, scale = self._freedom, self._scale(feature, j, blur)
        constant = math.exp(float(gammaln(0.5 * nu + 0.5) - gammaln(0.5 * nu))) / math.sqrt(nu * math.pi)
        inside = 1.0 + ((feature - self.data[j].value) / scale) ** 2 / nu
        # Three trials each, as published: a root costs a tenth of a power.
        power = inside * np.sqrt(inside) if nu == 2.0 else inside ** (0.5 * (nu + 1.0))
        return np.asarray(constant / scale / power)

    def _springs(self, seen: _Angles, nodes: Array) -> tuple[Array, Array]:
        """Changes of the logarithm of the spring from the one that gives the uncoupled period, as far as that leaves
        it open, and prior times likelihood of that period there, (n, nodes) or (1, nodes), and (n, nodes).
        """
        period = self.data[_PERIOD]
        reach = 2.0 * np.asarray(self._scale(np.array([period.value]), _PERIOD, seen.blur[..., 0])) / period.value
        if self._blurred[_PERIOD]:
            low, high = np.log(from_standard(self.own["k1t"], np.array([-1.0, 1.0])))
            reach = 1.0 / np.hypot(1.0 / reach, 2.0 / (high - low))
        u, width = reach * np.sinh(nodes), reach * np.cosh(nodes) * (nodes[1] - nodes[0])
        springs = seen.spring[:, None] * np.exp(u)
        density = np.exp(self.own["k1t"].logpdf(springs)) * springs * width
        return u, density * self._student(period.value * np.exp(_EXPONENTS["period"] * u), _PERIOD, seen.blur[..., 0])

    @cached_property
    def _relative(self) -> Array:
        """Relative changes of the angle from its middle, at `_ANGLES` standard deviations."""
        return np.asarray(from_standard(self.own["theta0"], _ANGLES) / self._angle - 1.0)

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
        found = self.posterior.features_of(configuration, values)
        for j, d in enumerate(self.data):
            if d.configuration == configuration:
                out[which, j] = getattr(found, d.quantity)


def _chosen(density: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """A column for each row of (n, k), by its density."""
    share = np.cumsum(density, axis=1)
    place = np.sum(share < rng.random((len(share), 1)) * share[:, -1:], axis=1)
    return np.asarray(np.minimum(place, density.shape[1] - 1), np.intp)
