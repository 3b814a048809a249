"""Parameters that go on changing over a campaign: grease that warms up, faces that wear in.

Where cases are measured one after the other, such a change makes them differ, and an effect that depends on what else
differs between cases, the amplitude say, takes its place. Repeats of one case show it by themselves: their own values
follow their order. The parameter is then x exp(b u), u from -1/2 for the first trial of the table to 1/2 for the last,
and its own values scatter about that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayes_damper.calibration.cases import SHOWS_FROM
from bayes_damper.calibration.least_squares import Calibration, calibrate
from bayes_damper.calibration.nominal import calibrate_nominal
from bayes_damper.calibration.own_values import RELATIVE
from bayes_damper.calibration.scatter import SURE_OF_TREND, change_over_campaign, trend_with_order


def with_trends(fit: Calibration, report: Callable[[str], None]) -> Calibration:
    """The fit with all trends that repeats show and the trials in the order of their table confirm."""
    while (found := _with_trend(fit)) is not None:
        report("a parameter follows the order of the trials; fitting the nominal model again with its trend")
        fit = calibrate_nominal(found.problem.experiment, nominal=fit.problem.nominal, begin=found, report=report)
    return fit


def _with_trend(fit: Calibration) -> Calibration | None:
    """The fit with one more trend, that which repeats show best; None where there is none, or the cases refute it."""
    problem = fit.problem
    experiment, sizes = problem.experiment, problem.switches.scatter.sizes
    tested = [
        (*trend_with_order(fit, size), size)
        for size in sizes
        if size.name in RELATIVE and size.name not in experiment.trends
    ]
    r, p_value, size = min(tested, key=lambda each: each[1], default=(0.0, 1.0, None))
    if size is None or not 0.5 * p_value < SURE_OF_TREND:  # in that direction
        return None
    # Of places that are spread evenly over the campaign, a trend has the usual standard deviation at this slope.
    trends = {**experiment.trends, size.name: math.sqrt(12.0) * size.typical}
    other = problem.changed(experiment=replace(experiment, trends=trends))
    known = dict(zip(problem.names, fit.q, strict=True))
    start = np.array([known.get(name, 0.0) for name in other.names])
    found = calibrate(other, [start], eta=fit.eta, anneal=False)
    same_way = r * change_over_campaign(found, size.name) > 0.0
    return found if same_way and found.log_evidence > fit.log_evidence + SHOWS_FROM else None
