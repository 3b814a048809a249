"""How far answers hang on their priors: by importance weights on the draws there are, without a new fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayes_damper.runs.contents.fit import PriorEntry, WidthEntry
from bayes_damper.sampling.arviz_adapter import pareto_k

Array = NDArray[np.float64]
WIDTHS = {"half": 0.5, "double": 2.0}
"""Factors on the width of a prior."""
DATA_DECIDE, PRIOR_DECIDES = 0.3, 0.8
"""Shares of the prior's variance that are left: below the first the data decide, from the other on the prior."""
_REACHED = 0.5  # the same, up to which draws lie where a wider prior would let them go
RELIABLE = 0.05  # effective share of the draws below which only a new fit can show it
_TAIL = 0.5  # Pareto k of the weights from which a spread is carried by the few draws that lie farthest out


def decided_by(share: float) -> str:
    """Who decided about a parameter of whose prior variance this share is left: data, prior, or both."""
    return "data" if share < DATA_DECIDE else "data and prior" if share < PRIOR_DECIDES else "prior"


def of_standard_draws(names: Sequence[str], points: Array) -> dict[str, PriorEntry]:
    """Each prior half and twice as wide, the others as they are, from draws (n, len(names)) in standard coordinates.

    There every prior is a unit Gaussian, so that a width of w weighs a draw z with exp(-(1 / w^2 - 1) z^2 / 2). Returns
    name -> {"prior_share", "decided_by", "half", "double"}, the last two with the shift of the mean in standard
    deviations, the ratio of the standard deviations, which other parameter moves most and how far, and whether there
    are enough effective draws to believe it.
    """
    centre, sd = points.mean(axis=0), np.maximum(points.std(axis=0), 1e-300)
    scaled = (points - centre) / sd
    shares = [float(min(1.0, x**2)) for x in sd]

    def other(i: int, width: float) -> WidthEntry:
        log_weights = -0.5 * (width**-2 - 1.0) * points[:, i] ** 2
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        means = weights @ scaled
        others = [k for k in range(len(names)) if k != i]
        most = max(others, key=lambda k: abs(means[k]), default=i)
        effective = float(1.0 / np.sum(weights**2)) / len(points)
        return {
            "shift": float(means[i]),
            "width": math.sqrt(max(float(weights @ (scaled[:, i] - means[i]) ** 2), 0.0)),
            "moves_most": names[most],
            "shift_of_that": float(means[most]),
            "effective_share": effective,
            # Where the prior decides, on one side at least, few draws lie where a wider one would let them go.
            "reliable": effective > RELIABLE and (width < 1.0 or (shares[i] <= _REACHED and pareto_k(weights) < _TAIL)),
        }

    return {
        name: {
            "prior_share": share, "decided_by": decided_by(share),
            "half": other(i, WIDTHS["half"]), "double": other(i, WIDTHS["double"]),
        }
        for i, (name, share) in enumerate(zip(names, shares, strict=True))
    }  # fmt: skip


def text(table: Mapping[str, PriorEntry]) -> list[str]:
    """A few lines for the terminal: what hangs on a prior, the most hanging first; all else in one sentence."""
    moved = {name: max(abs(row["half"]["shift"]), abs(row["double"]["shift"])) for name, row in table.items()}
    shown = [n for n in sorted(moved, key=lambda n: -moved[n]) if moved[n] > 0.1 or table[n]["decided_by"] == "prior"]
    if not shown:
        return ["  No parameter moves by more than 0.1 standard deviations when a prior is half or twice as wide."]
    lines = ["  A prior half / twice as wide moves its parameter by so many standard deviations (others: below 0.1):"]
    doubtful = False
    wide = max(28, *(len(name) + 1 for name in shown))
    for name in shown:
        row = table[name]
        cells = " / ".join(f"{w['shift']:+.2f}{'' if w['reliable'] else '?'}" for w in (row["half"], row["double"]))
        doubtful = doubtful or "?" in cells
        mark = "   the prior decides" if row["decided_by"] == "prior" else ""
        lines.append(f"  {name:{wide}s}{cells}{mark}")
    return [*lines, "  ?: the draws are too few for a sure figure; fit with that prior to know"] if doubtful else lines
