"""The design with the largest expected insertion loss, and the parameter that the answer hangs on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats.qmc import Sobol

from bayes_damper.errors import InputError
from bayes_damper.tuning.acting import Acting
from bayes_damper.tuning.draws import NONLINEAR, Draws
from bayes_damper.tuning.performance import Design, Performance, linear_performance, sweep

Array = NDArray[np.float64]
BOUNDS = {"J2": (0.1, 2.0), "k2t": (0.25, 4.0), "R": (0.5, 2.0), "c2t": (0.05, 20.0)}
"""Where the best design is sought if nothing else is said: factors on what the rig has at present."""
FREE = ("J2", "k2t", "R")
"""What the search for the best design changes if nothing else is said."""
TRIED = (32, 16, 8)
"""Designs that are tried at each amplitude, in turns."""
_WORTH = 0.2  # dB by which a design must be better to count as better
_OPTIMISED_DRAWS = 100  # the search for the best design uses so many; its result is judged by all


@dataclass(frozen=True)
class Optimum:
    """The design of highest expected insertion loss (linear model) and what limits it."""

    design: Design
    performance: Performance
    at_bound: tuple[str, ...]


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
    space = Space.of(draws, start, usual_bounds(draws) if bounds is None else bounds)
    edges = space.edges
    some = {name: column[:_OPTIMISED_DRAWS] for name, column in draws.items()}

    def objective(x: Array) -> float:
        loss = linear_performance(some, space.design(x)).insertion_loss
        known = np.isfinite(loss)
        return -float(loss[known].mean()) if known.any() else 1e3

    corners = [np.array(c) for c in itertools.product(*((0.8 * a + 0.2 * b, 0.2 * a + 0.8 * b) for a, b in edges))]
    runs = [
        minimize(objective, x, method="L-BFGS-B", bounds=edges, options={"maxiter": 40})
        for x in (space.middle, *corners)
    ]
    best = min(runs, key=lambda run: float(run.fun))
    found = space.design(np.asarray(best.x, dtype=np.float64))
    return Optimum(found, linear_performance(draws, found), space.at_bound(best.x))


@dataclass(frozen=True)
class Space:
    """The designs within bounds: a point of logarithms of what is free, within `edges` (n_free, 2), is a design.

    middle : the point of the rig as it is; radius : at present, where one variable stands for k2t R^2.
    """

    start: Design
    bounds: Mapping[str, tuple[float, float]]
    names: tuple[str, ...]
    edges: Array
    middle: Array
    radius: float | None

    @classmethod
    def of(cls, draws: Draws, start: Design, bounds: Mapping[str, tuple[float, float]]) -> Space:
        """The space about a start.

        Raises
        ------
        InputError
            if nothing is free, a name cannot be, or bounds do not rise from above zero.
        """
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
        now = {name: middle_of(draws, name) for name in BOUNDS}
        box = {name: (math.log(low), math.log(high)) for name, (low, high) in bounds.items()}
        together = "k2t" in box and "R" in box and start.bar_inertia == 0.0
        if together:
            radius = box.pop("R")
            start = replace(start, R=None)
            reach = [2.0 * (x - math.log(now["R"])) for x in radius]
            box["k2t"] = (box["k2t"][0] + min(reach[0], 0.0), box["k2t"][1] + max(reach[1], 0.0))
        edges = np.array(list(box.values()))
        middle = np.clip(np.log([max(now[name], 1e-12) for name in box]), edges[:, 0], edges[:, 1])
        return cls(start, bounds, tuple(box), edges, middle, now["R"] if together else None)

    def design(self, x: Array) -> Design:
        """The design at a point."""
        found = dict(zip(self.names, (float(v) for v in np.exp(x)), strict=True))
        if self.radius is not None:
            product = found["k2t"]
            found["k2t"] = float(np.clip(product, *self.bounds["k2t"]))
            if found["k2t"] != product:
                found["R"] = self.radius * math.sqrt(product / found["k2t"])
        return replace(self.start, **found)

    def at_bound(self, x: Array) -> tuple[str, ...]:
        """What lies at a bound in the design at a point."""
        near = 1e-3 * (self.edges[:, 1] - self.edges[:, 0])
        inside = (self.edges[:, 0] + near < x) & (x < self.edges[:, 1] - near)
        return tuple(
            "k2t R^2" if self.radius is not None and name == "k2t" else name
            for name, within in zip(self.names, inside, strict=True)
            if not within
        )


def best_driven(
    draws: Draws,
    designs: Sequence[Design],
    bounds: Mapping[str, tuple[float, float]],
    amplitude: float,
    acting: Acting | None = None,
) -> tuple[Design, tuple[str, ...]]:
    """The design with the highest loss of the nonlinear rig, of those given and `TRIED` others, and what is at a bound.

    amplitude : of the exciting torque, N m.
    What is not free is as in the first of `designs`. The others lie evenly within the bounds, then twice more closely
    about the best of them. The rig is the middle of the draws, so that all are integrated at once. A design that was
    given is kept unless another is better by `_WORTH`.
    """
    space = Space.of(draws, designs[0], bounds)
    middle = {name: np.array([np.median(column)]) for name, column in draws.items()}

    def heights(tried: Sequence[Design]) -> Array:
        several = [design.apply(middle) for design in tried]
        stacked = {name: np.concatenate([draws[name] for draws in several]) for name in middle}
        return np.nan_to_num(sweep(stacked, amplitude, True, acting).highest()[1], nan=np.inf)

    low, high = space.edges.T
    even = Sobol(len(space.names), scramble=False).random(max(TRIED))
    centre, points, found = 0.5 * (low + high), np.empty((0, low.size)), np.empty(0)
    for width, n in zip((1.0, 0.25, 0.06), TRIED, strict=True):
        points = np.concatenate([points, np.clip(centre + width * (high - low) * (even[:n] - 0.5), low, high)])
        found = np.concatenate([found, heights([space.design(x) for x in points[-n:]])])
        centre = points[np.argmin(found)]
    given = heights(designs)
    k = int(np.argmin(given))
    if found.min() * 10.0 ** (_WORTH / 20.0) < given[k]:
        return space.design(centre), space.at_bound(centre)
    return designs[k], ()


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
