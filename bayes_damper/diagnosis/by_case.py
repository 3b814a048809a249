"""Which parameter of the nominal model would explain a gap if each case had a value of its own."""

from __future__ import annotations

import numpy as np

from bayes_damper.calibration import Calibration
from bayes_damper.calibration.cases import SHOWS_FROM, values_of_cases, with_own_in_each_case
from bayes_damper.diagnosis.search import Screen

FITTED = 2  # parameters that promise most, fitted with a value for each case


def gains_by_case(fit: Calibration) -> dict[str, float]:
    """Parameter -> nats that a value of its own in each case gains in the linearised problem."""
    problem = fit.problem
    screen = Screen(fit)
    of_block = [[problem.experiment.trials[i].case for i in block.group.trials] for block in screen.linear.blocks]
    cases = list(dict.fromkeys(case for those in of_block for case in those))
    gains = {}
    for i, c in enumerate(problem.coordinates):
        if c.role != "nominal" or c.case is not None or len(cases) < 2:
            continue
        columns = [
            np.array([block.J[:, i] * (np.array(own) == case)[:, None] for case in cases[1:]])
            for block, own in zip(screen.linear.blocks, of_block, strict=True)
        ]
        length, product = screen.project(columns)
        # The difference of two values, each with a prior of variance 1, has the variance 2.
        gains[c.name] = 0.5 * float(product @ np.linalg.solve(length + 0.5 * np.eye(len(product)), product))
    return gains


def differing_in_words(fit: Calibration, best: float) -> list[str]:
    """A sentence on the parameter that explains more than any effect if it differs from case to case.

    best : log evidence of the best effect over the nominal model.
    """
    gains = gains_by_case(fit)
    promising = sorted((name for name in gains if gains[name] > SHOWS_FROM), key=lambda name: -gains[name])[:FITTED]
    fits = {name: own for name in promising if (own := with_own_in_each_case(fit, name)) is not None}
    if not fits:
        return []
    name = max(fits, key=lambda n: fits[n].log_evidence)
    if not fits[name].log_evidence - fit.log_evidence > max(best, 0.0) + SHOWS_FROM:
        return []
    listed = values_of_cases(fits[name], name)
    said = (
        f"A value of {name} for each case would explain the records better than any effect does: {listed} (SI units). "
        "Was something changed between the cases?"
    )
    return [said]
