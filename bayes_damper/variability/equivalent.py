"""The linear rig that comes closest to a nonlinear one: effective k2t and c2t as the thesis fitted them (pp. 19-20).

The recipe: c1t of the linear model is what the log decrement of the uncoupled record gives (eqs. 11 and 12), c3t = c1t;
then k2t and c2t are those with which the linear 2DOF model (eq. 17), released from the same angle, comes closest to the
primary's coupled record by least squares, every millisecond from `FIRST` to `LAST` after release, the instant of
release itself left out. Dry friction and drag have no other way to show than in k2t and c2t. On another rig `stretch`
brings these times to its own pace, so that they stay the first two periods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.published.features import features
from bayes_damper.rig.linear import LinearRig, damping_coefficient, damping_ratio_of_decrement, free_response
from bayes_damper.runs.contents.variability import LINEAR_NAMES
from bayes_damper.simulation.model import Model, Quantity

Array = NDArray[np.float64]
FIRST, LAST = 1e-3, 0.25
TIMES: Array = np.asarray(np.arange(round(FIRST * 1e3), round(LAST * 1e3) + 1) * 1e-3, dtype=np.float64)
"""Sample times of the fit, s: the first two periods of the thesis's rig, in which all motion is."""
PERIOD = 0.1225
"""Period of the primary of the thesis's rig, s: geometric mean of its two springs."""
NAMES = LINEAR_NAMES
_FEATURE_TIMES: Array = np.concatenate([np.linspace(0.0, 1e-3, 11), np.arange(2, 651) * 1e-3])
_LOWEST, _HIGHEST = np.log(1e-3), np.log(20.0)
_ITERATIONS = 12
_STARTS = tuple((k, c) for k in (0.02, 0.08, 0.25, 0.8, 3.0) for c in (0.1, 0.3, 0.8, 2.0))
"""Where the search may begin: k2t over k1t, and c2t over sqrt(k1t J1); the best of these does."""


@dataclass(frozen=True)
class Equivalent:
    """ln k2t and ln c2t of n fits, (n, 2); misfit (n,), rms over the record's own rms; inside (n,): within bounds."""

    log_values: Array
    misfit: Array
    inside: NDArray[np.bool_]


def bearing_damping(
    values: Mapping[str, Array],
    normal_force: Literal["linear", "constant"] = "linear",
    restoring: Literal["linear", "pendulum"] = "linear",
    stretch: float = 1.0,
) -> Array:
    """c1t of the linear model, (n,) N m s/rad, by the thesis's recipe: from the uncoupled record's log decrement."""
    times = stretch * _FEATURE_TIMES
    record = Model(False, normal_force, restoring).simulate(_rig(values, False), times).y[:, 0]
    decrement = features(times, record, 6e-4 * stretch).log_decrement
    c1t = damping_coefficient(damping_ratio_of_decrement(decrement), values["k1t"], values["J1"])
    # Where drag stops the rig before a second peak there is no decrement: half critical damping is as good as any.
    return np.where(np.isfinite(c1t), c1t, damping_coefficient(0.5, values["k1t"], values["J1"]))


def equivalent(
    values: Mapping[str, Array],
    normal_force: Literal["linear", "constant"] = "linear",
    restoring: Literal["linear", "pendulum"] = "linear",
    quantity: Quantity = "acceleration",
    stretch: float = 1.0,
) -> Equivalent:
    """Effective k2t and c2t of nonlinear rigs: name -> (n,) parameters in SI, theta0 the angle of release in rad."""
    times = stretch * TIMES
    record = Model(True, normal_force, restoring).simulate(_rig(values, True), times, quantity=quantity).y[:, 0]
    return fit_linear(record, values, bearing_damping(values, normal_force, restoring, stretch), quantity, times)


def fit_linear(
    record: Array, values: Mapping[str, Array], c1t: Array, quantity: Quantity, times: Array = TIMES
) -> Equivalent:
    """k2t and c2t of the linear rig closest to records (n, n_times) of the primary, by damped Gauss-Newton steps."""
    n = len(record)
    fixed = {name: np.broadcast_to(values[name], (n,)) for name in ("J1", "J2", "k1t", "theta0")}
    fixed["c1t"] = fixed["c3t"] = np.broadcast_to(c1t, (n,))
    for name in ("k3t", "J12"):
        fixed[name] = np.broadcast_to(values.get(name, np.zeros(1)), (n,))
    unit = np.stack([np.log(fixed["k1t"]), 0.5 * np.log(fixed["k1t"] * fixed["J1"])], axis=1)
    starts = np.log(np.array(_STARTS))

    def linear(log_values: Array) -> Array:
        return linear_record(fixed, log_values, times, quantity)

    costs = np.stack([np.sum((linear(unit + x) - record) ** 2, axis=1) for x in starts])
    best, cost = _descend(record, linear, unit, starts[np.nan_to_num(costs, nan=np.inf).argmin(axis=0)])
    scale = np.sqrt(np.mean(record**2, axis=1))
    inside = np.all((best > _LOWEST + 0.01) & (best < _HIGHEST - 0.01), axis=1)
    return Equivalent(best + unit, np.sqrt(cost / record.shape[1]) / scale, inside & np.isfinite(cost))


def _descend(record: Array, linear: Callable[[Array], Array], unit: Array, x: Array) -> tuple[Array, Array]:
    """Levenberg-Marquardt on all records at once: x (n, 2) in units, and the sum of squares (n,)."""
    damping = np.full(len(x), 1e-2)
    y = linear(x + unit)
    cost = np.sum((y - record) ** 2, axis=1)
    for _ in range(_ITERATIONS):
        J = np.stack([(linear(x + unit + 1e-4 * step) - y) / 1e-4 for step in np.eye(2)], axis=1)
        H = J @ J.transpose(0, 2, 1)
        g = np.einsum("nkt,nt->nk", J, y - record)
        H = H + (damping[:, None, None] * H + 1e-12 * np.trace(H, axis1=1, axis2=2)[:, None, None]) * np.eye(2)
        move = np.clip(-np.linalg.solve(H, g[..., None])[..., 0], -1.0, 1.0)
        trial = np.clip(x + move, _LOWEST, _HIGHEST)
        y_new = linear(trial + unit)
        new = np.sum((y_new - record) ** 2, axis=1)
        better = new < cost
        done = np.all(np.where(better, cost - new, 0.0) < 1e-7 * cost)
        x = np.where(better[:, None], trial, x)
        y = np.where(better[:, None], y_new, y)
        cost = np.where(better, new, cost)
        damping = np.where(better, damping * 0.2, np.minimum(damping * 10.0, 1e6))
        if done and np.all(better | (damping > 1e2)):
            break
    return x, cost


def linear_record(fixed: Mapping[str, Array], log_values: Array, times: Array, quantity: Quantity) -> Array:
    """The primary's record (n, n_times) of linear rigs with these ln k2t, ln c2t (n, 2)."""
    rig = LinearRig(
        fixed["J1"], fixed["J2"], fixed["k1t"], fixed["c1t"], np.exp(log_values[:, 0]), np.exp(log_values[:, 1]),
        fixed["c3t"], fixed["k3t"], fixed["J12"],
    )  # fmt: skip
    motion = free_response(rig, fixed["theta0"], times)
    return {"acceleration": motion.acceleration, "velocity": motion.velocity, "displacement": motion.angle}[quantity][
        :, 0
    ]


def _rig(values: Mapping[str, Array], coupled: bool) -> dict[str, Array]:
    names = {"J1", "k1t", "c1t", "drag", "nu", "tail", "theta0"}
    names |= {"J2", "J12", "k3t", "c3t", "k2t", "c2t", "mu", "N0", "R", "r"} if coupled else set()
    return {name: value for name, value in values.items() if name in names}


def feature_scatter(
    values: Mapping[str, Array],
    log_values: Array,
    c1t: Array,
    errors: Mapping[str, float],
    prior_sd: tuple[float, float],
) -> Array:
    """Variance (n, 2) that standard errors of the coupled features give ln k2t and ln c2t of the linear model.

    Features of the linear record at (ln k2t, ln c2t) (n, 2), their derivatives, and weighted least squares to first
    order; prior_sd bounds what the features do not determine.
    """
    n = len(log_values)
    fixed = {name: np.broadcast_to(values[name], (n,)) for name in ("J1", "J2", "k1t", "theta0")}
    fixed |= {"c1t": c1t, "c3t": c1t, "k3t": np.zeros(n), "J12": np.zeros(n)}

    def measured(x: Array) -> Array:
        found = features(_FEATURE_TIMES, linear_record(fixed, x, _FEATURE_TIMES, "acceleration"), 6e-4)
        return np.stack([getattr(found, name) / error for name, error in errors.items()], axis=1)

    slopes = [(measured(log_values + 0.02 * e) - measured(log_values - 0.02 * e)) / 0.04 for e in np.eye(2)]
    J = np.nan_to_num(np.stack(slopes, axis=2))
    information = J.transpose(0, 2, 1) @ J + np.diag(np.array(prior_sd) ** -2.0)
    return np.asarray(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
