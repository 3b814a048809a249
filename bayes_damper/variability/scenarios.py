"""What the answer hangs on: the same structures under other priors, another law of friction, and without one case.

Little begins anew: the draws of a structure under the assumptions as they are become those under others on a way from
the one posterior to the other, and the evidence changes by what that way gains (sampling by a sequence of densities, as
from the prior to the posterior; Del Moral, Doucet and Jasra 2006, J. R. Stat. Soc. B 68:411). Where the two resemble
each other, which they mostly do, that takes a stage or two.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.priors.distributions import Distribution, LogNormal
from bayes_damper.sampling.sequential import UnitPrior
from bayes_damper.variability.pooling import Hierarchy

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Kind = Literal["width", "law", "without"]


@dataclass(frozen=True)
class Scenario:
    """One assumption changed: `width` on the log factors and log ranges of what is pooled, another `law` of friction,
    or a case `without` whose measurements the rest is fitted.
    """

    name: str
    words: str
    kind: Kind
    width: float = 1.0
    case: str = ""


def scenarios(cases: Sequence[str]) -> list[Scenario]:
    """All that are tried."""
    found = [
        Scenario("half", "priors half as wide", "width", width=0.5),
        Scenario("double", "priors twice as wide", "width", width=2.0),
        Scenario("law", "x / sqrt(1 + x^2) in place of tanh", "law"),
    ]
    return found + [Scenario(f"without-{case}", f"without case {case}", "without", case=case) for case in cases]


def widened(priors: Mapping[str, Any], names: Sequence[str], width: float) -> dict[str, Any]:
    """A prior set (as `PriorSet.to_dict` gives it) with the log factors of some parameters `width` times as large.

    The range of a log-uniform one becomes so many times as long, about its geometric middle.
    """
    found = {key: dict(entry) if isinstance(entry, Mapping) else entry for key, entry in priors.items()}
    for name in names:
        entry = found[name]
        if entry.get("dist") in ("lognormal", "logstudent"):
            entry["factor"] = float(entry["factor"]) ** width
        elif entry.get("dist") == "loguniform":
            low, high = float(entry["lower"]), float(entry["upper"])
            middle, reach = math.sqrt(low * high), (high / low) ** (0.5 * width)
            entry["lower"], entry["upper"] = middle / reach, middle * reach
    return found


class Bridge(UnitPrior):
    """A way from the posterior of one hierarchy to that of another with the same coordinates: a target for `temper`.

    before, after : the two, the same object where only a case is left out; without : that case's number, or -1; ratio :
    of the prior widths of `after` over `before`, for each pooled parameter (pooled,).
    """

    def __init__(
        self, before: Hierarchy, after: Hierarchy, without: int = -1, ratio: Array | None = None, power: float = 0.0
    ) -> None:
        self._before, self._after, self._without, self._power = before, after, without, power
        self._ratio = np.ones(len(after.pooled)) if ratio is None else ratio
        self._widened = bool(np.any(self._ratio != 1.0))
        self._two = before is not after and not self._widened
        self.ndim, self.parts, self.blocks = after.ndim, after.parts, after.blocks
        self._straight = after.at(1.0)
        self.unknowns = after.unknowns
        self.straight, self.bent = self._straight.straight, self._straight.bent
        self.log_volume = self._straight.log_volume

    def at(self, power: float) -> Bridge:
        """The same at another power."""
        return Bridge(self._before, self._after, self._without, self._ratio, power)

    def start(self, points: Array) -> Array:
        """Draws (..., ndim) of `before` in the coordinates of `after`: the same values under priors of other widths."""
        found = points.copy()
        for _, columns in self._after.owned_columns:
            found[..., columns] /= self._ratio
        return found

    def measure(self, points: Array, parts: Index) -> Array:
        """Misfits of the one or of both, and what the change of the prior does, (n, len(parts), k)."""
        found = [self._after.measure(points, parts)]
        if self._two:
            found.append(self._before.measure(points, parts))
        found.append(np.stack([self._tilt(points, c) for c in parts], axis=1)[:, :, None])
        return np.concatenate(found, axis=2)

    def tried(self, points: Sequence[Array], parts: Index) -> Array:
        """As `measure`, each part at points of its own."""
        return np.concatenate([self.measure(x, parts[[k]]) for k, x in enumerate(points)], axis=1)

    def height(self, measured: Array, parts: Index, power: float) -> Array:
        """Log likelihood and change of the prior, from `before` at 0 to `after` at 1."""
        k = (measured.shape[2] - 1) // 2 if self._two else measured.shape[2] - 1
        found = self._after.height(measured[:, :, :k], parts, 1.0)
        if self._two:
            old = self._before.height(measured[:, :, k : 2 * k], parts, 1.0)
            found = _between(old, found, power)
        if self._without >= 0:
            found = np.where(parts == self._without, _between(found, np.zeros_like(found), power), found)
        return found + (1.0 - power) * measured[:, :, -1]

    def refresh(self, points: Array, rng: np.random.Generator) -> Array:
        """Along what no likelihood sees, where the prior is that of `after`."""
        return points if self._widened and self._power < 1.0 else self._after.refresh(points, rng)

    def _tilt(self, points: Array, case: int) -> Array:
        """Log of the prior of `before` over that of `after`, of the columns that are a case's own; m with 0."""
        value = np.zeros(len(points))
        if not self._widened:
            return value
        for owner, columns in self._after.owned_columns:
            if owner == case:
                x = points[:, columns]
                value += np.sum(0.5 * x**2 * (1.0 - self._ratio**2) + np.log(self._ratio), axis=1)
        return value


def _between(old: Array, new: Array, power: float) -> Array:
    """(1 - power) old + power new, where what does not count may be without value."""
    if power <= 0.0:
        return old
    return new if power >= 1.0 else (1.0 - power) * old + power * new


def ratio_of(before: Mapping[str, Distribution], after: Mapping[str, Distribution], pooled: Sequence[str]) -> Array:
    """How many times as wide each pooled parameter's lognormal prior is in `after`; 1 for those of another kind."""
    pairs = [(before[n], after[n]) for n in pooled]
    return np.array([
        math.log(b.factor) / math.log(a.factor) if isinstance(a, LogNormal) and isinstance(b, LogNormal) else 1.0
        for a, b in pairs
    ])  # fmt: skip
