"""How the simulation of one parameter vector ended, in words. The numbers are those of the kernel's status."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike


class Outcome(IntEnum):
    """Status of one simulated parameter vector; `sentence` says what it means and what to do."""

    COMPLETED = 0
    NOT_FINITE_INPUT = 1
    STEP_UNDERFLOW = 2
    NOT_FINITE_RECORD = 3

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.COMPLETED: "the whole record was simulated.",
    Outcome.NOT_FINITE_INPUT: "a parameter was not a finite number, or an inertia, the smoothing constant or a radius "
    "was not positive; narrow the prior to values that a rig can have.",
    Outcome.STEP_UNDERFLOW: "the equations were too stiff for the integrator to finish; narrow the prior of nu, or of "
    "the stiffness that makes the motion so fast.",
    Outcome.NOT_FINITE_RECORD: "the motion grew without bound; narrow the prior of the parameter that feeds energy in.",
}


def count_outcomes(outcomes: ArrayLike) -> dict[str, int]:
    """How many vectors ended in each way: name of the outcome -> count; outcomes that did not occur are left out."""
    counts = np.bincount(np.asarray(outcomes, int), minlength=len(Outcome)).tolist()
    return {outcome.name: count for outcome, count in zip(Outcome, counts, strict=True) if count}
