"""Where the scatter of the effective linear k2t and c2t over the cases comes from.

With E(x, conditions) the ln of the effective value (equivalent.py) of a rig with parameters x, released under a case's
conditions (angle, spring), and x-bar the mean of the cases' parameters in standard coordinates, each draw gives

    E(x_c, conditions_c) = A_c + D_c,   A_c = E(x-bar, conditions_c)   the same rig seen at another amplitude,
                                        D_c = the rest                 a real difference between the cases,

and a fit to measurements adds their scatter M_c. Variances over the cases (divisor cases - 1) of A and D, the mean of
the variances M, and twice the covariance of A and D add up to what one expects to see. Shares are those of the first
three among themselves. The intervals are those of the partly pooled posterior: how sure so few cases make it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.runs.contents.variability import (
    Band,
    DecompositionEntry,
    EffectiveCase,
    EffectiveCurve,
    EffectiveEntry,
    Interval,
    LinearName,
    PartEntry,
)
from bayes_damper.sampling.arviz_adapter import hdi
from bayes_damper.simulation.model import Quantity
from bayes_damper.variability.equivalent import FIRST, LAST, NAMES, TIMES, Equivalent, equivalent

Array = NDArray[np.float64]
Values = Mapping[str, Array]
_CURVE_DRAWS, _CURVE_POINTS = 48, 8


@dataclass(frozen=True)
class CaseDraws:
    """Draws of one case: its parameters, the same with the cases' mean x-bar, and both from the prior; name -> (n,)."""

    values: Values
    reference: Values
    prior_values: Values
    prior_reference: Values


@dataclass(frozen=True)
class Sets:
    """All that `decompose` needs.

    cases : case -> draws; energies : case -> initial energy, J; measured : case -> (k2t, c2t) that a linear fit to the
    measurements gave, or none; rounding : variance of ln k2t and ln c2t by the rounding of those; measured_variance :
    (case, effective draws) -> variances (n, 2); curve : label -> (energies (k,), parameters name -> (draws * k,));
    stretch : of the times of the linear fit (equivalent.py).
    """

    cases: Mapping[str, CaseDraws]
    energies: Mapping[str, float]
    measured: Mapping[str, tuple[float, float]]
    rounding: tuple[float, float]
    scatter: Mapping[str, Callable[[Array], Array]]
    curve: Mapping[str, tuple[Array, Values]]
    normal_force: Literal["linear", "constant"] = "linear"
    restoring: Literal["linear", "pendulum"] = "linear"
    quantity: Quantity = "acceleration"
    measurement: str = ""
    stretch: float = 1.0


@dataclass(frozen=True)
class Decomposition:
    """effective: per case and as curves; parts: k2t, c2t -> component -> median, interval, share; method in words."""

    effective: EffectiveEntry
    parts: dict[LinearName, DecompositionEntry]
    method: str


def decompose(sets: Sets) -> Decomposition:
    """The scatter of the effective values over the cases, taken apart."""

    def effective(values: Values) -> Equivalent:
        return equivalent(values, sets.normal_force, sets.restoring, sets.quantity, sets.stretch)

    seen = {c: effective(d.values) for c, d in sets.cases.items()}
    total = np.stack([e.log_values for e in seen.values()])  # (cases, n, 2)
    same = np.stack([effective(d.reference).log_values for d in sets.cases.values()])
    prior = np.stack([effective(d.prior_values).log_values for d in sets.cases.values()])
    prior_same = np.stack([effective(d.prior_reference).log_values for d in sets.cases.values()])
    noise = np.stack([sets.scatter[c](seen[c].log_values) for c in sets.cases]).mean(axis=0)
    parts: dict[LinearName, DecompositionEntry] = {}
    for k, name in enumerate(NAMES):
        a, d = same[:, :, k], total[:, :, k] - same[:, :, k]
        pieces = {
            "friction_at_another_amplitude": a.var(axis=0, ddof=1),
            "measurement_scatter": noise[:, k],
            "real_difference": d.var(axis=0, ddof=1),
        }
        whole = sum(pieces.values(), np.zeros(a.shape[1]))
        found = {key: _part(value, whole) for key, value in pieces.items()}
        before = (prior[:, :, k] - prior_same[:, :, k]).var(axis=0, ddof=1)
        found["real_difference"]["before_the_data"] = summary(before)
        joint = 2.0 * np.sum((a - a.mean(axis=0)) * (d - d.mean(axis=0)), axis=0) / (len(a) - 1)
        largest = np.argmax(np.stack(list(pieces.values())), axis=0)
        rows: DecompositionEntry = {
            "friction_at_another_amplitude": found["friction_at_another_amplitude"],
            "measurement_scatter": found["measurement_scatter"],
            "real_difference": found["real_difference"],
            "covariance": summary(joint),
            "expected_total": summary(whole + joint),
            "probability_largest": {key: float(np.mean(largest == i)) for i, key in enumerate(pieces)},
        }
        if len(sets.measured) > 1:
            measured = np.log([sets.measured[c][k] for c in sets.cases if c in sets.measured])
            rows["measured"] = float(np.var(measured, ddof=1))
            rows["measured_percentile"] = float(100.0 * np.mean(whole + joint < rows["measured"]))
            rows["rounding_of_the_measured"] = sets.rounding[k]
        parts[name] = rows
    return Decomposition(_effective(sets, seen, effective), parts, _method(sets))


def _effective(sets: Sets, seen: Mapping[str, Equivalent], effective: Callable[[Values], Equivalent]) -> EffectiveEntry:
    cases: dict[str, EffectiveCase] = {}
    for case, e in seen.items():
        k2t, c2t = (summary(np.exp(e.log_values[:, k])) for k in range(len(NAMES)))
        row: EffectiveCase = {
            "k2t": k2t,
            "c2t": c2t,
            "energy_j": sets.energies[case],
            "misfit": float(np.median(e.misfit)),
            "inside": float(e.inside.mean()),
        }
        if case in sets.measured:
            row["measured"] = dict(zip(NAMES, sets.measured[case], strict=True))
        cases[case] = row
    curves: dict[str, EffectiveCurve] = {}
    for label, (energies, values) in sets.curve.items():
        x = np.exp(effective(values).log_values).reshape(-1, len(energies), 2)
        curves[label] = {"energy_j": energies.tolist(), "k2t": _band(x[:, :, 0]), "c2t": _band(x[:, :, 1])}
    return {"cases": cases, "curves": curves}


def _part(values: Array, whole: Array) -> PartEntry:
    found = summary(values)
    return {"median": found["median"], "hdi90": found["hdi90"], "share": summary(values / whole)}


def _band(x: Array) -> Band:
    """Of draws (n, points)."""
    low, high = np.quantile(x, (0.05, 0.95), axis=0)
    return {"median": np.median(x, axis=0).tolist(), "low": low.tolist(), "high": high.tolist()}


def _method(sets: Sets) -> str:
    return (
        f"Effective k2t and c2t: least squares of the linear 2DOF model (eq. 17) to the primary's coupled record, "
        f"{1e3 * sets.stretch * FIRST:.3g} to {1e3 * sets.stretch * LAST:.3g} ms after release, {len(TIMES)} readings; "
        f"c1t = c3t from the uncoupled log decrement (eqs. 11, 12). Variances of their logarithms over the cases. "
        f"{sets.measurement}"
    )


def summary(values: Array) -> Interval:
    """Median and 90 % interval of draws, those that are not finite left out."""
    kept = np.asarray(values)[np.isfinite(values)]
    if len(kept) < 2:
        return {"median": math.nan, "hdi90": [math.nan, math.nan]}
    return {"median": float(np.median(kept)), "hdi90": list(hdi(kept))}


def mean_over_cases(points: Sequence[Array]) -> Array:
    """x-bar: the mean of the cases' pooled coordinates, (n, pooled)."""
    return np.asarray(np.mean(np.stack(list(points)), axis=0))


def curve_values(values: Values, k1t: float, energies: Array) -> dict[str, Array]:
    """Parameters of each draw (n,) released with each energy (k,), J, from a spring k1t: name -> (n * k,)."""
    n = len(values["J1"])
    out = {name: np.repeat(x, len(energies)) for name, x in values.items()}
    out["k1t"] = np.full(n * len(energies), k1t)
    out["theta0"] = np.sqrt(2.0 * np.tile(energies, n) / k1t)
    return out


def curves_of(
    values: Values, springs: Mapping[str, float], energies: Collection[float]
) -> dict[str, tuple[Array, dict[str, Array]]]:
    """For each spring k1t, by its label, energies about those of the cases and the parameters of some draws there."""
    grid = np.geomspace(0.6 * min(energies), 1.3 * max(energies), _CURVE_POINTS)
    some = {name: x[:_CURVE_DRAWS] for name, x in values.items()}
    return {label: (grid, curve_values(some, k1t, grid)) for label, k1t in springs.items()}
