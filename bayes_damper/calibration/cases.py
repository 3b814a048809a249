"""Damping that differs from case to case, each of which has a spring of its own.

Another spring brings its own losses: at the same loss factor the viscous constant goes with sqrt(k1t J1), and what
clamps it changes too. Where all trials share one c1t, an effect of the bearings or of the spring takes its place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayes_damper.calibration.least_squares import Calibration, calibrate

DAMPING = "c1t"


def with_damping_of_each_case(fit: Calibration, target: float = -math.inf) -> Calibration | None:
    """The fit with a c1t of its own for each case; None where cases share a spring, or c1t is not one free number.

    target : a cost that another model has reached, as in `calibrate`.
    """
    problem = fit.problem
    experiment = problem.experiment
    springs = {experiment.trials[i].case: experiment.trials[i].k1t for i in problem.trials}
    if DAMPING not in problem.names or len(springs) < 2 or len(set(springs.values())) < len(springs):
        return None
    other = problem.changed(experiment=replace(experiment, levels={**experiment.levels, DAMPING: "case"}))
    known = dict(zip(problem.names, fit.q, strict=True))
    start = np.array([known[c.parameter if c.parameter == DAMPING else c.name] for c in other.coordinates])
    # One damping for all may have brought dry friction into another valley: it is sought from its usual values too.
    usual = np.where([c.role == "nominal" for c in other.coordinates], 0.0, start)
    return calibrate(other, [start, usual], eta=fit.eta, anneal=False, target=target)


def damping_in_words(fit: Calibration) -> list[str]:
    """A sentence on the c1t of each case, where each has its own."""
    found = {c.case: fit.parameters[c.name][0] for c in fit.problem.coordinates if c.parameter == DAMPING and c.case}
    if not found:
        return []
    listed = ", ".join(f"{value:.3g} in case {case}" for case, value in found.items())
    return [
        f"The damping {DAMPING} differs from case to case: {listed} (SI units). Each case, with a spring of its own, has "
        "its own value; no cause is named for it."
    ]
