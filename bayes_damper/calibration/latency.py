"""Clocks that are off by the same time in all trials: a trigger's latency.

Where repeats show no difference of the instants, releases lie where the clock puts them, and what makes all of them
late is left to the effects of release and sensors. But every trigger takes its time, and a fraction of a sampling step
does to the records what a short ramp or a fast filter does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_damper.calibration.experiment import prior_of_instants
from bayes_damper.calibration.least_squares import Calibration, calibrate
from bayes_damper.calibration.scatter import carried, placed

AS_LATE = ("release", "sensor")  # sites of effects that may do to the records what a late release does
STARTS = (0.0, 0.5, 1.0)  # sampling steps after t = 0, from which the instant is looked for


def with_latency(fit: Calibration) -> Calibration | None:
    """The fit with one instant of release for all trials, within about a sampling step of t = 0.

    None where nothing is released, or instants are free or declared.
    """
    problem = fit.problem
    e = problem.experiment
    trials = [e.trials[i] for i in problem.trials]
    if e.start != "rest" or problem.switches.delay or "delay" in e.levels or not any(t.theta0 for t in trials):
        return None
    common = replace(
        e, levels={**e.levels, "delay": "campaign"}, priors={**e.priors, "delay": prior_of_instants(e)}
    )  # fmt: skip
    other = problem.changed(experiment=common, factors=None)
    at = other.names.index("delay")
    starts = [np.insert(fit.q, at, late) for late in STARTS]
    return calibrate(other, starts, eta=carried(fit, other), anneal=False)


def latency_of(fit: Calibration) -> float:
    """The instant of release of a fit that has one for all trials, s."""
    return fit.parameters["delay"][0]


def with_own_instants(fit: Calibration, late: Calibration) -> Calibration:
    """The fit with an instant of each trial's own, beginning where all trials together put it."""
    free = fit.problem.changed(switches=replace(fit.problem.switches, delay=True))
    eta = placed(free, carried(fit, free), "delay", latency_of(late))
    start = np.array([x for name, x in zip(late.problem.names, late.q, strict=True) if name != "delay"])
    return calibrate(free, [start], eta=eta, anneal=False)


def latency_in_words(late: Calibration) -> str:
    """A sentence on releases that are all late by the same time."""
    ms = 1e3 * latency_of(late)
    return (
        f"All releases are {abs(ms):.2g} ms {'later' if ms > 0.0 else 'earlier'} than t = 0, which explains the "
        "records better than any effect of release or sensors: the trigger takes its time. The fit allows for it; no "
        "cause is named for it."
    )
