"""From parameters to a posterior: the only door between the physics and the samplers.

A posterior takes points (n, ndim) in standard coordinates: each free parameter x of prior distribution F is replaced
by z = Phi^-1(F(x)), so that the prior of z is a unit Gaussian whatever that of x, all coordinates are unbounded and of
like size, and the log prior is -z^2/2. That suits ensemble moves, bridge sampling and nested sampling alike.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import (
    Distribution,
    LogNormal,
    Normal,
    columns_from_standard,
    from_standard,
    to_standard,
)
from bayes_damper.published.features import Features, features
from bayes_damper.published.measurements import Published
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.simulation.model import Model
from bayes_damper.simulation.outcome import count_outcomes

Array = NDArray[np.float64]
_LOG_2PI = math.log(2.0 * math.pi)
_FARTHEST = 40.0
"""From a sheet, in its coordinate: where no prior leaves any density, and sinh is still finite."""


@dataclass(frozen=True)
class Shared:
    """Two scale parameters of which the data see a weighted sum: x / x_unit + y / y_unit.

    Their posterior bends like an L where the data determine the sum but not the shares. In the coordinates
    ln(sum) and ln(ratio of the shares) it is straight, and the change has Jacobian 1.
    """

    x: str
    y: str
    x_unit: float
    y_unit: float


@dataclass(frozen=True)
class Sheet:
    """A parameter of normal prior that one measured number fixes, given all others, far better than the prior does.

    The posterior is then a thin sheet, curved where `centre` is no linear function of the others, with the heavy tails
    of the number's error about it. Sampled is y in x = centre + width sinh(y): the sheet is flat and about as thick as
    other coordinates are wide. centre : all parameters by name -> (n,), independent of this one; width : in its unit.
    Where the prior is cut, x is what an uncut one would have in its place.
    """

    name: str
    width: float
    centre: Callable[[Mapping[str, Array]], Array]


def _spring(period: float, values: Mapping[str, Array]) -> Array:
    """The spring that gives an undamped period, N m/rad."""
    return np.asarray(values["J1"] * (2.0 * math.pi / period) ** 2)


def _angle(acceleration: float, values: Mapping[str, Array]) -> Array:
    """The release angle that gives the coupled rig an acceleration when t_min has passed, rad."""
    without = acceleration + taken_by_friction(acceleration, values)
    return np.asarray(without * values["J1"] / values["k1t"])


def taken_by_friction(acceleration: float, values: Mapping[str, Array]) -> Array:
    """By how much the coupled rig's acceleration would be higher without friction when t_min has passed, rad/s^2."""
    speed = acceleration * values["t_min"]
    dry = (values["drag"] + values["mu"] * values["N0"] * values["R"]) * np.tanh(values["nu"] * speed)
    return np.asarray((dry + (values["c1t"] + values["c2t"]) * speed) / values["J1"])


@dataclass(frozen=True)
class Coordinates:
    """Free parameters with their priors, fixed ones, and ones tied to another.

    free : name -> prior; fixed : name -> value; tied : name -> name of a free or fixed parameter whose value it takes;
    shared : pairs of lognormal free parameters that are sampled as sum and ratio; sheets : what is sampled as its
    distance from where the other parameters put it; one may depend on those before it.
    """

    free: Mapping[str, Distribution]
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)
    shared: tuple[Shared, ...] = ()
    sheets: tuple[Sheet, ...] = ()

    def __post_init__(self) -> None:
        for name, other in self.tied.items():
            if other not in self.free and other not in self.fixed:
                raise InputError(f"{name} is tied to {other!r}, which is neither a free nor a fixed parameter")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the coordinates."""
        return tuple(self.free)

    @property
    def ndim(self) -> int:
        """Number of free parameters."""
        return len(self.free)

    @cached_property
    def _lines(self) -> list[tuple[int, int, float, float, float, float]]:
        """Of each shared pair: its two columns, and the constants of ln(x / x_unit) = a + b z for both."""
        lines = []
        for pair in self.shared:
            i, j = self.names.index(pair.x), self.names.index(pair.y)
            x, y = self.free[pair.x], self.free[pair.y]
            if not (isinstance(x, LogNormal) and isinstance(y, LogNormal)):
                continue  # another prior: leave the two as they are
            lines.append((i, j, math.log(x.median_value / pair.x_unit), math.log(x.factor),
                          math.log(y.median_value / pair.y_unit), math.log(y.factor)))  # fmt: skip
        return lines

    @cached_property
    def _sheets(self) -> list[tuple[int, Sheet, Normal]]:
        """Of each sheet: its column, itself, and its prior; those that are not free or not normal are left out."""
        found = []
        for sheet in self.sheets:
            prior = self.free.get(sheet.name)
            if isinstance(prior, Normal):  # another prior: leave it as it is
                found.append((self.names.index(sheet.name), sheet, prior))
        return found

    def standard(self, points: Array) -> Array:
        """Standard coordinates (n, ndim) of points as they are sampled: shared pairs taken apart, sheets put back."""
        points = np.atleast_2d(points)
        return self.placed(points)[0] if self._lines or self._sheets else points

    def placed(self, points: Array) -> tuple[Array, dict[str, Array]]:
        """Both of points (n, ndim) as they are sampled: standard coordinates (n, ndim), and all parameters by name."""
        z = np.array(points, ndmin=2)
        for i, j, a, b, c, d in self._lines:
            ratio = z[:, j].copy()
            first = z[:, i] - np.logaddexp(0.0, ratio)  # ln(x / x_unit)
            z[:, i] = (first - a) / b
            z[:, j] = (first + ratio - c) / d
        away = {i: z[:, i].copy() for i, _, _ in self._sheets}
        given = self._of_standard(z)
        for i, sheet, prior in self._sheets:
            off = sheet.width * np.sinh(np.clip(away[i], -_FARTHEST, _FARTHEST))
            z[:, i] = (sheet.centre(given) + off - prior.mean) / prior.sd
            given[sheet.name] = from_standard(prior, z[:, i])
        return z, given | {name: given[other] for name, other in self.tied.items()}

    def sampled(self, z: Array) -> Array:
        """Points as they are sampled (n, ndim) from standard coordinates: the inverse of `standard`."""
        points = np.atleast_2d(z).copy()
        sheets = self._sheets
        given = self._of_standard(points) if sheets else {}
        for i, sheet, prior in sheets:
            points[:, i] = np.arcsinh((prior.mean + prior.sd * points[:, i] - sheet.centre(given)) / sheet.width)
        for i, j, a, b, c, d in self._lines:
            first, second = a + b * points[:, i], c + d * points[:, j]
            points[:, i] = np.logaddexp(first, second)
            points[:, j] = second - first
        return points

    def values(self, points: Array) -> dict[str, Array]:
        """All parameters at points (n, ndim) as they are sampled: name -> (n,)."""
        return self.placed(points)[1]

    def _of_standard(self, z: Array) -> dict[str, Array]:
        given = dict(zip(self.names, columns_from_standard(tuple(self.free.values()), z), strict=True))
        given |= {name: np.full(len(z), value) for name, value in self.fixed.items()}
        return given | {name: given[other] for name, other in self.tied.items()}

    def points(self, values: Mapping[str, Any]) -> Array:
        """Points (n, ndim), as they are sampled, of parameter values: the inverse of `values`."""
        columns = [np.atleast_1d(to_standard(prior, values[name])) for name, prior in self.free.items()]
        return self.sampled(np.stack(np.broadcast_arrays(*columns), axis=-1))

    def log_prior(self, points: Array, z: Array | None = None) -> Array:
        """Log prior density in the sampled coordinates, (n,); z : standard coordinates of the points, where known."""
        z = self.standard(points) if z is None else z
        value: Array = -0.5 * (np.sum(z**2, axis=1) + self.ndim * _LOG_2PI)
        # ln x and ln y in terms of sum and ratio have Jacobian 1; z in terms of ln x has 1 / b.
        value = value - sum(math.log(b * d) for _, _, _, b, _, d in self._lines)
        for i, sheet, prior in self._sheets:
            y = np.atleast_2d(points)[:, i]
            value = value + np.logaddexp(y, -y) + math.log(0.5 * sheet.width / prior.sd)  # ln cosh
        return value

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Points drawn from the prior, (n, ndim)."""
        return self.sampled(rng.standard_normal((n, self.ndim)))


@dataclass(frozen=True)
class Datum:
    """One published measurement: a feature of one configuration with its standard error from n trials."""

    configuration: str
    quantity: str
    value: float
    standard_error: float
    n: int = 3

    @property
    def name(self) -> str:
        return f"{self.quantity} ({self.configuration})"


def data_of(published: Published, case: str) -> tuple[Datum, ...]:
    """The published numbers of one case.

    Raises
    ------
    InputError
        if there is no such case.
    """
    rows = published.of_case(case)
    return tuple(Datum(m.configuration, m.quantity, m.value, m.standard_error, m.n) for m in rows)


FEATURE_QUANTITIES = ("log_decrement", "period", "max_acceleration")

FEATURE_TIMES: Array = np.concatenate([np.linspace(0.0, 1e-3, 21), np.arange(2, 451) * 1e-3])
"""Sample times of a simulated record from which features are taken, s: fine where the first peak is, then 1 kHz."""


def feature_times(data: Sequence[Datum], longest: float = math.inf) -> Array:
    """Sample times that the features of these data need, s: twice the longest measured period, `longest` at most.

    A record's second lobe ends after one and a quarter of its own periods; one that takes half as long again as any
    measured record has no features.
    """
    periods = [d.value for d in data if d.quantity == "period"]
    end = min(2.0 * max(periods, default=math.inf), longest)
    return FEATURE_TIMES if math.isinf(end) else FEATURE_TIMES[end >= FEATURE_TIMES]


_SOON = 1.45
"""Measured periods after which uncoupled records have their features: the second lobe ends after one and a quarter."""


def _some(x: Any, which: NDArray[np.intp], n: int) -> Array:
    """Some of n values, or of the one that they all are."""
    return np.broadcast_to(np.asarray(x, float), (n,))[which]


class FeaturePosterior:
    """Posterior of one thesis case from its published features (log decrement, damped period, maximum acceleration).

    A standard error from n = 3 trials makes (measured - true) / error Student-t with n - 1 degrees of freedom, so
    the likelihood has heavy tails. Peak and decrement are computed from one simulated record by the definition of
    features.py, so that they share the first peak as the measured ones do.

    effect : a formula that the rig follows beside the nominal ones; its parameters are among the coordinates as
    "effect.NAME". times : of the simulated records, s; by default those that the data need. tolerance : factor on the
    integrator's: at 10 features keep to 1 % of the published standard errors, for two thirds of the time.
    """

    def __init__(
        self,
        data: Sequence[Datum],
        coordinates: Coordinates,
        normal_force: str = "linear",
        case: str = "",
        *,
        effect: Variant | None = None,
        times: Array | None = None,
        tolerance: float = 1.0,
    ) -> None:
        self.data = tuple(data)
        self.coordinates = coordinates
        self.case = case
        self.times = feature_times(self.data) if times is None else times
        self.tolerance = tolerance
        self.models = {
            name: Model(coupled=name == "coupled", normal_force=normal_force, effect=effect)  # type: ignore[arg-type]
            for name in dict.fromkeys(d.configuration for d in self.data)
        }
        self.outcomes: Counter[str] = Counter()

    @property
    def names(self) -> tuple[str, ...]:
        return self.coordinates.names

    @property
    def ndim(self) -> int:
        return self.coordinates.ndim

    def predict(self, points: Array) -> Array:
        """The features that the model gives at points (n, ndim), in the order of the data: (n, n_data), nan if none."""
        return self.predict_from(self.coordinates.values(points))

    def predict_from(self, parameters: Mapping[str, Array]) -> Array:
        """The features that the model gives for parameter values (n,) by name: (n, n_data), nan if none."""
        found = {name: self.features_of(name, parameters) for name in self.models}
        return np.stack([getattr(found[d.configuration], d.quantity) for d in self.data], axis=1)

    def features_of(self, configuration: str, parameters: Mapping[str, Array]) -> Features:
        """All features of the records of one configuration for parameter values (n,) by name, each (n,)."""
        values = dict(parameters)
        t_min = values.pop("t_min")
        changes = {name: values.pop(name) for name in list(values) if name.startswith(OF_EFFECT)}
        effect = {name.removeprefix(OF_EFFECT): x for name, x in changes.items()}
        found = self._seen(configuration, values, effect, t_min, self._soon[configuration])
        left = np.flatnonzero(~found.valid)
        if left.size == 0 or self._soon[configuration].size == self.times.size:
            return found
        # What takes longer than the measured rig did, or has no second peak at all.
        n = len(found.valid)
        some = {name: _some(x, left, n) for name, x in values.items()}
        changes = {name: _some(x, left, n) for name, x in effect.items()}
        later = self._seen(configuration, some, changes, _some(t_min, left, n), self.times)
        for name in vars(found):
            getattr(found, name)[left] = getattr(later, name)
        return found

    def _seen(
        self, configuration: str, values: Mapping[str, Array], effect: Mapping[str, Array], t_min: Array, times: Array
    ) -> Features:
        """Features of records of so many sample times."""
        simulation = self.models[configuration].simulate(values, times, effect=effect, tolerance=self.tolerance)
        self.outcomes.update(count_outcomes(simulation.outcome))
        return features(times, simulation.y[:, 0], t_min)

    @cached_property
    def _soon(self) -> dict[str, Array]:
        """Sample times in which a record of each configuration mostly has its features: of a coupled one, all."""
        ends = dict.fromkeys(self.models, math.inf)
        ends |= {d.configuration: _SOON * d.value for d in self.data if d.name == "period (uncoupled)"}
        return {name: self.times[self.times <= end] for name, end in ends.items()}

    def misfits(self, points: Array) -> Array:
        """Distances of the features from the data in standard errors, (n, n_data); nan where the record has none."""
        return self._off(self.predict(points))

    def _off(self, features: Array) -> Array:
        """Distances of features (n, n_data) from the data in standard errors."""
        value = np.array([d.value for d in self.data])
        error = np.array([d.standard_error for d in self.data])
        return np.asarray((features - value) / error)

    def densities(self, misfits: Array, width: float = 1.0) -> Array:
        """Log density of each datum at such distances, (n, n_data), if all errors were `width` times as large."""
        error = np.array([d.standard_error for d in self.data])
        dof = np.array([d.n - 1.0 for d in self.data])
        norm = gammaln((dof + 1.0) / 2.0) - gammaln(dof / 2.0) - 0.5 * np.log(dof * math.pi) - np.log(error * width)
        density = norm - 0.5 * (dof + 1.0) * np.log1p((misfits / width) ** 2 / dof)
        return np.where(np.isfinite(density), density, -np.inf)

    def log_likelihood(self, points: Array) -> Array:
        """Log density of each datum, (n, n_data); -inf where the simulated record has no such feature."""
        return self.densities(self.misfits(points))

    def __call__(self, points: Array) -> Array:
        """Log posterior density (normalised prior times likelihood) in standard coordinates, (n,)."""
        points = np.atleast_2d(points)
        z, values = self.coordinates.placed(points)
        density = self.densities(self._off(self.predict_from(values))).sum(axis=1)
        return np.asarray(self.coordinates.log_prior(points, z) + density)


@dataclass(frozen=True)
class ShrinkingErrors:
    """A path from no likelihood to all of it: standard errors that shrink from infinite to what they are.

    Powers of a likelihood with heavy tails would do worse: they leave narrow peaks as narrow, with little mass until
    the last, so that few places or none represent what meets several numbers at once.
    """

    posterior: FeaturePosterior

    def measure(self, points: Array) -> Array:
        """Distances from the data in standard errors."""
        return self.posterior.misfits(points)

    def height(self, measured: Array, temperature: float) -> Array:
        """Log density at such distances if errors were 1 / temperature times as large."""
        return np.asarray(self.posterior.densities(measured, 1.0 / max(temperature, 1e-9)).sum(axis=1))


def damping_pairs(values: Mapping[str, float]) -> tuple[Shared, ...]:
    """Viscous and dry damping that one feature cannot distinguish: at the bearings, and between the faces.

    A cycle's log decrement is pi c / sqrt(k J) from a viscous torque and about 4 d / (k theta0) from a dry one
    (energy lost per cycle over twice the energy); the same for the interface, seen from the primary.
    """
    stiffness, inertia, angle = values["k1t"], values["J1"], values["theta0"]
    viscous, dry = math.sqrt(stiffness * inertia) / math.pi, stiffness * angle / 4.0
    return (
        Shared("c1t", "drag", viscous, dry),
        Shared("c2t", "mu", viscous, dry / (values["N0"] * values["R"])),
    )


def feature_sheets(data: Sequence[Datum], values: Mapping[str, float]) -> tuple[Sheet, ...]:
    """The spring from the uncoupled period, the release angle from the coupled rig's highest acceleration.

    values : typical ones, for the widths. With the error of two degrees of freedom that three trials leave, the density
    of y falls as cosh^-2 if the width is that of sqrt(2) standard errors.
    """
    known = {d.name: d for d in data}
    found = []
    spring = values["k1t"]
    if (period := known.get("period (uncoupled)")) is not None:
        spring = values["J1"] * (2.0 * math.pi / period.value) ** 2
        width = math.sqrt(8.0) * spring * period.standard_error / period.value
        found.append(Sheet("k1t", width, partial(_spring, period.value)))
    if (peak := known.get("max_acceleration (coupled)")) is not None:
        width = math.sqrt(2.0) * values["J1"] * peak.standard_error / spring
        found.append(Sheet("theta0", width, partial(_angle, peak.value)))
    return tuple(found)
