"""The thesis recomputed: Tables 1-12 and Figures 2, 6, 8, 10-13 from its own equations and constants.

`recompute()` sets every printed number beside the computed one, with a verdict, and reports where the thesis
contradicts itself: with the evidence, with the parameter value that the printed number would need, and with what speaks
for or against that value. Nothing is tuned to make numbers meet. Source: A. S. Augustine, Development of a Magnetically
Coupled Mass Damper, The Ohio State University, 2013; tables and pages as printed there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from bayes_damper.thesis.contradictions import Contradiction, Needed, contradictions
from bayes_damper.thesis.figures import Figure, figures
from bayes_damper.thesis.printed import CASES, printed_case
from bayes_damper.thesis.rig import effective_coupling, linear_rig, nonlinear_rig, secondary_inertia
from bayes_damper.thesis.tables import table

__all__ = [
    "CASES", "Contradiction", "Figure", "Needed", "Recomputation", "effective_coupling", "linear_rig",
    "nonlinear_rig", "printed_case", "recompute", "secondary_inertia",
]  # fmt: skip


@dataclass(frozen=True)
class Recomputation:
    """Everything recomputed.

    table : where, page, quantity, unit, printed, computed, low, high, difference, verdict, explanation; low and high
    span what the rounding of the printed inputs allows.
    """

    table: pd.DataFrame
    contradictions: tuple[Contradiction, ...]
    figures: Mapping[str, Figure]


def recompute() -> Recomputation:
    """Recomputes Tables 1-12 and Figures 2, 6, 8, 10-13, and lists the contradictions; takes seconds."""
    return Recomputation(table(), contradictions(), figures())
