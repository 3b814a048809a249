"""The design with the largest expected insertion loss, and the parameter that the answer hangs on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_damper.errors import InputError
from bayes_damper.tuning.draws import NONLINEAR, Draws
from bayes_damper.tuning.performance import Design, Performance, linear_performance

Array = NDArray[np.float64]
BOUNDS = {"J2": (0.1, 2.0), "k2t": (0.25, 4.0), "R": (0.5, 2.0), "c2t": (0.05, 20.0)}
"""Where the best design is sought if nothing else is said: factors on what the rig has at present."""
FREE = ("J2", "k2t", "R")
"""What the search for the best design changes if nothing else is said."""
_OPTIMISED_DRAWS = 100  # the search for the best design uses so many; its result is judged by all


@dataclass(frozen=True)
class Optimum:
    """The design of highest expected insertion loss (linear model) and what limits it."""

    design: Design
    performance: Performance
    at_bound: tuple[str, ...]

    @property
    def expected(self) -> float:
        """Mean insertion loss, dB."""
        return float(np.nanmean(self.performance.insertion_loss))


def usual_bounds(draws: Draws, names: Sequence[str] = FREE) -> dict[str, tuple[float, float]]:
    """Where the best design is sought if nothing else is said: `BOUNDS` times the rig's present medians, if not 0.

    Raises
    ------
    InputError
        if one of the names cannot be optimised.
    """
    if faults := _not_free(names):
        raise InputError(faults)
    middle = {name: middle_of(draws, name) for name in names}
    return {name: (BOUNDS[name][0] * x, BOUNDS[name][1] * x) for name, x in middle.items() if x > 0.0}


def _not_free(names: Iterable[str]) -> list[str]:
    """Sentences on names that the search for the best design cannot change."""
    *most, last = BOUNDS
    return [
        f"{name}: only {', '.join(most)} and {last} can be optimised; leave it out"
        for name in names
        if name not in BOUNDS
    ]


def best_design(
    draws: Draws, start: Design | None = None, bounds: Mapping[str, tuple[float, float]] | None = None
) -> Optimum:
    """Maximises the expected insertion loss of the linear model over J2, k2t, R and c2t.

    bounds : name -> lowest and highest value (SI) of those of "J2", "k2t", "R", "c2t" that are free; the others stay as
    in `start`. By default the first three are free within `BOUNDS` times the rig's present medians. As long as no bar
    grows with R, only k2t R^2 enters: the radius is then changed only where k2t alone does not reach far enough.
    """
    start = start or Design()
    now = {name: middle_of(draws, name) for name in BOUNDS}
    if bounds is None:
        bounds = usual_bounds(draws)
    faults = _not_free(bounds)
    faults += [
        f"{name}: its bounds {low:g} and {high:g} must be above zero and rise"
        for name, (low, high) in bounds.items()
        if not 0.0 < low < high
    ]
    if not bounds:
        faults.append(f"bounds: nothing is free; name at least one of {', '.join(BOUNDS)}")
    if faults:
        raise InputError(faults)
    box = {name: (math.log(low), math.log(high)) for name, (low, high) in bounds.items()}
    together = "k2t" in box and "R" in box and start.bar_inertia == 0.0
    if together:  # one variable stands for k2t R^2
        radius = box.pop("R")
        start = replace(start, R=None)
        reach = [2.0 * (x - math.log(now["R"])) for x in radius]
        box["k2t"] = (box["k2t"][0] + min(reach[0], 0.0), box["k2t"][1] + max(reach[1], 0.0))
    names, edges = tuple(box), np.array(list(box.values()))

    def design(x: Array) -> Design:
        found = dict(zip(names, (float(v) for v in np.exp(x)), strict=True))
        if together:
            product = found["k2t"]
            found["k2t"] = float(np.clip(product, *bounds["k2t"]))
            if found["k2t"] != product:
                found["R"] = now["R"] * math.sqrt(product / found["k2t"])
        return replace(start, **found)

    some = {name: column[:_OPTIMISED_DRAWS] for name, column in draws.items()}

    def objective(x: Array) -> float:
        loss = linear_performance(some, design(x)).insertion_loss
        known = np.isfinite(loss)
        return -float(loss[known].mean()) if known.any() else 1e3

    middle = np.clip(np.log([max(now[name], 1e-12) for name in names]), edges[:, 0], edges[:, 1])
    corners = [np.array(c) for c in itertools.product(*((0.8 * a + 0.2 * b, 0.2 * a + 0.8 * b) for a, b in edges))]
    runs = [
        minimize(objective, x, method="L-BFGS-B", bounds=edges, options={"maxiter": 40}) for x in (middle, *corners)
    ]
    best = min(runs, key=lambda run: float(run.fun))
    found = design(np.asarray(best.x, dtype=np.float64))
    near = 1e-3 * (edges[:, 1] - edges[:, 0])
    at_bound = tuple(
        "k2t R^2" if together and name == "k2t" else name
        for i, name in enumerate(names)
        if not edges[i, 0] + near[i] < best.x[i] < edges[i, 1] - near[i]
    )
    return Optimum(found, linear_performance(draws, found), at_bound)


def shares_of_variance(draws: Draws, answer: Array) -> dict[str, float]:
    """Share of the answer's variance that each parameter explains by itself, highest first.

    By regression on a cubic in the parameter's rank: between 0 and 1; correlated parameters share what they explain.
    Parameters that do not vary, or are tied to an earlier one, are left out.
    """
    known = np.isfinite(answer)
    out: dict[str, float] = {}
    for name in NONLINEAR:
        x = draws[name][known]
        tied = any(np.array_equal(draws[other], draws[name]) for other in out)
        if tied or x.size < 20 or np.ptp(x) <= 1e-12 * np.abs(x).max():
            continue
        rank = (np.argsort(np.argsort(x)) + 0.5) / x.size
        basis = np.vander(2.0 * rank - 1.0, 4)
        y = answer[known] - answer[known].mean()
        fit = basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        total = float(np.mean(y**2))
        out[name] = float(np.clip(1.0 - np.mean((y - fit) ** 2) / total, 0.0, 1.0)) if total > 0.0 else 0.0
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def middle_of(draws: Draws, name: str) -> float:
    """Median of a parameter over the draws."""
    return float(np.median(draws[name]))
