"""Parameters that differ from case to case.

Another spring brings its own losses: at the same loss factor the viscous constant goes with sqrt(k1t J1), and what
clamps it changes too. Where all trials share one c1t, an effect of the bearings or of the spring takes its place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayes_damper.calibration.least_squares import Calibration, calibrate

DAMPING = "c1t"
SHOWS_FROM = 3.0  # nats of evidence: odds of 20


def with_own_in_each_case(fit: Calibration, name: str, target: float = -math.inf) -> Calibration | None:
    """The fit with a value of that parameter for each case; None where it is no free number that cases share.

    target : a cost that another model has reached, as in `calibrate`.
    """
    problem = fit.problem
    if name not in problem.names:
        return None
    levels = {**problem.experiment.levels, name: "case"}
    other = problem.changed(experiment=replace(problem.experiment, levels=levels))
    own = [c.parameter == name for c in other.coordinates]
    if sum(own) < 2:
        return None
    known = dict(zip(problem.names, fit.q, strict=True))
    start = np.array([known[name if c.parameter == name else c.name] for c in other.coordinates])
    # One value for all may have brought dry friction into another valley: it is sought from its usual values too.
    usual = np.where([c.role == "nominal" for c in other.coordinates], 0.0, start)
    return calibrate(other, [start, usual], eta=fit.eta, anneal=False, target=target)


def with_damping_of_each_case(fit: Calibration, target: float = -math.inf) -> Calibration | None:
    """The fit with a c1t for each case; None where cases share a spring, or c1t is no free number that cases share."""
    trials = [fit.problem.experiment.trials[i] for i in fit.problem.trials]
    springs = {t.case: t.k1t for t in trials}
    return with_own_in_each_case(fit, DAMPING, target) if len(set(springs.values())) == len(springs) else None


def values_of_cases(fit: Calibration, name: str) -> str:
    """The values of a parameter that each case has of its own, in words; empty if they share one."""
    found = {c.case: fit.parameters[c.name][0] for c in fit.problem.coordinates if c.parameter == name and c.case}
    return ", ".join(f"{value:.3g} in case {case}" for case, value in found.items())


def damping_in_words(fit: Calibration) -> list[str]:
    """A sentence on the c1t of each case, where each has its own."""
    listed = values_of_cases(fit, DAMPING)
    said = (
        f"The damping {DAMPING} differs from case to case: {listed} (SI units). Each case, with a spring of its own, "
        "has its own value; no cause is named for it."
    )
    return [said] if listed else []


def one_damping_in_words(fit: Calibration) -> list[str]:
    """A sentence where all cases of a fit share a c1t and should not."""
    own = with_damping_of_each_case(fit, fit.cost)
    if own is None or own.log_evidence < fit.log_evidence + SHOWS_FROM:
        return []
    said = (
        f"The damping {DAMPING} differs from case to case: {values_of_cases(own, DAMPING)} (SI units). All cases "
        "together have one value here, which is right for none of them; use the fits of the cases."
    )
    return [said]
