"""The thesis's own models: its linear and its nonlinear rig, and quantities derived from them in several places."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, least_squares

from bayes_damper.published.features import Features, features
from bayes_damper.rig import linear
from bayes_damper.rig.linear import LinearRig
from bayes_damper.thesis.printed import (
    BAR_RADIUS,
    CASE_IV_DAMPING,
    CASES,
    INERTIA,
    MAGNET_PULL,
    MAGNET_RADIUS,
    SECONDARY_FREQUENCY,
    T_MIN,
    printed_case,
)

Array = NDArray[np.float64]

J1 = 1e-6 * float(INERTIA)
TIMES = np.linspace(0.0, 0.6, 601)
EARLY_TIMES = np.concatenate([np.linspace(0.0, 1e-3, 21), np.arange(2, 601) * 1e-3])
"""Sample times with a fine first millisecond, in which dry friction lowers the acceleration."""
FINE = np.linspace(0.0, 1.0, 1001)


def secondary_inertia(frequency_hz: ArrayLike = float(SECONDARY_FREQUENCY), k2t: ArrayLike = 1.0) -> Array:
    """J2 (kg m^2) from the only number that depends on it: 3.2 Hz at k2t = 1 N m/rad (p. 27)."""
    return np.asarray(np.asarray(k2t) / (2.0 * np.pi * np.asarray(frequency_hz)) ** 2, dtype=np.float64)


def linear_rig(case: str, c1t: float | None = CASE_IV_DAMPING, **changes: ArrayLike) -> LinearRig:
    """The thesis's linear model of a case (Table 9); `c1t` None takes the case's own damping ratio (Tables 3, 6)."""
    p = printed_case(case)
    if c1t is None:
        c1t = float(linear.damping_coefficient(float(p.ratio[0]), float(p.k1t), J1))
    values: dict[str, ArrayLike] = {
        "J1": J1, "J2": secondary_inertia(), "k1t": float(p.k1t), "c1t": c1t, "k2t": float(p.k2t),
        "c2t": float(p.c2t), "c3t": c1t,
    }  # fmt: skip
    return LinearRig(**(values | changes))


def linear_features(rig: LinearRig, theta0: ArrayLike, t_min: float = T_MIN) -> Features:
    """Features of the linear model's record, released at `theta0` (rad)."""
    return features(TIMES, linear.free_response(rig, theta0, TIMES).acceleration[:, 0], t_min)


def nonlinear_rig(mu: ArrayLike, **changes: ArrayLike) -> dict[str, ArrayLike]:
    """Parameters of the thesis's nonlinear model (eqs. 18-20, p. 24) of case IV, for `Model.simulate`.

    What is printed nowhere has working values: R = 0.10 m, r = 0.0127 m, drag 0, nu = 50 s/rad.
    """
    p = printed_case("IV")
    values: dict[str, ArrayLike] = {
        "J1": J1, "J2": secondary_inertia(), "k1t": float(p.k1t), "c1t": CASE_IV_DAMPING, "c3t": CASE_IV_DAMPING,
        "k2t": 0.0, "c2t": 0.0, "mu": mu, "N0": MAGNET_PULL, "R": BAR_RADIUS, "r": MAGNET_RADIUS, "drag": 0.0,
        "nu": 50.0, "theta0": np.deg2rad(float(p.theta0)),
    }  # fmt: skip
    unknown = sorted(set(changes) - set(values))
    if unknown:
        raise KeyError(f"{unknown[0]} is no parameter of the nonlinear model")
    return values | changes


def pairs_against_energy(values: Sequence[float]) -> int:
    """In how many of the pairs of cases the value falls as the energy rises."""
    energies = [float(printed_case(c).energy) for c in CASES]
    return sum(
        (e - f) * (v - w) < 0 for (e, v), (f, w) in itertools.combinations(zip(energies, values, strict=True), 2)
    )


def delay_of_peak(case: str) -> float:
    """Time after release at which the linear model, started at the printed bound, has the printed peak, s."""
    p = printed_case(case)
    theta0 = float(p.bound) * J1 / float(p.k1t)
    t = np.linspace(0.0, 3e-3, 601)
    alpha = -linear.free_response(linear_rig(case), theta0, t).acceleration[0, 0]
    return float(np.interp(-float(p.model_acceleration), -alpha, t))


def effective_coupling(case: str) -> tuple[float, float, float]:
    """k2t and c2t with which the linear model comes nearest to the measured coupled decrement and period.

    Returns k2t (N m/rad), c2t (N m s/rad) and the root mean square misfit in standard errors. Tables 6, 7 (pp. 17-18).
    """
    p = printed_case(case)

    def misfit(x: Array) -> Array:
        found = linear_features(linear_rig(case, k2t=np.exp(x[0]), c2t=np.exp(x[1])), np.deg2rad(float(p.theta0)))
        pairs = (
            (found.log_decrement[0], p.coupled_decrement, 1.0),
            (found.period[0], p.coupled_period, 1e3),
        )
        values = [(unit * value - float(m)) / float(e) for value, (m, e), unit in pairs]
        return np.array(np.nan_to_num(values, nan=1e3))

    starts = itertools.product(np.log([0.3, 3.0, 12.0]), np.log([0.02, 0.08, 0.3]))
    bounds = (np.log([1e-3, 1e-3]), np.log([50.0, 2.0]))
    runs = [least_squares(misfit, start, bounds=bounds, diff_step=1e-4) for start in starts]
    best = min(runs, key=lambda run: run.cost)
    k2t, c2t = np.exp(best.x)
    return float(k2t), float(c2t), float(np.sqrt(best.cost))


def solve_for(function: Callable[[float], float], target: float, low: float, high: float) -> float | None:
    """The argument between `low` and `high` where `function` is `target`: first crossing on a fine grid, or None."""
    grid = np.geomspace(low, high, 200)
    gap = np.array([function(x) for x in grid]) - target
    crossing = np.flatnonzero(np.isfinite(gap[:-1]) & np.isfinite(gap[1:]) & (gap[:-1] * gap[1:] <= 0.0))
    if crossing.size == 0:
        return None
    return float(brentq(lambda x: function(x) - target, grid[crossing[0]], grid[crossing[0] + 1], xtol=1e-14))
