"""Channels under a wrong name: exchanged between the bodies, or reversed in sign.

No law of the rig is wrong there, and no formula comes near it, so what the site map makes of it misleads. As an answer
it has no free parameter: the nominal model is fitted to the records as they would have been, under the same noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, calibrate

Array = NDArray[np.float64]

POOR = 0.1  # share of a channel's squares that the nominal model must leave for its wiring to be doubted


@dataclass(frozen=True)
class Wiring:
    """What mends the records; gain in log evidence over the nominal model (nats), shares of the squares left."""

    words: str
    gain: float
    before: float
    after: float

    def sentence(self) -> str:
        """For the notes."""
        return (
            f"With {self.words} the nominal model's residual falls from {self.before:.0%} to {self.after:.1%} of the "
            "readings' power: check the wiring, the names of the columns and the signs."
        )


def _exchanged(y: Array) -> Array:
    return y[::-1]


def _first(y: Array) -> Array:
    return np.concatenate([-y[:1], y[1:]])


def _second(y: Array) -> Array:
    return np.concatenate([y[:1], -y[1:]])


def _both(y: Array) -> Array:
    return -y


WAYS: tuple[tuple[str, Callable[[Array], Array]], ...] = (
    ("the two channels exchanged", _exchanged),
    ("the sign of channel 2 reversed", _second),
    ("the sign of channel 1 reversed", _first),
    ("the signs of all channels reversed", _both),
)


def miswired(nominal: Calibration) -> Wiring | None:
    """The way of wiring under which the nominal model fits best, if it fits badly as the records are.

    Of one body that starts free nothing shows the sign; of two it shows which way they swing together.
    """
    experiment = nominal.problem.experiment
    if experiment.start != "rest" and not experiment.coupled:
        return None
    before = _left(nominal)
    if not before > POOR:
        return None
    best: Wiring | None = None
    for words, change in WAYS:
        fit = _fitted(nominal, change)
        found = Wiring(words, float(fit.log_evidence - nominal.log_evidence), before, _left(fit))
        if found.after < POOR * before and found.gain > (0.0 if best is None else best.gain):
            best = found
    return best


def _fitted(nominal: Calibration, change: Callable[[Array], Array]) -> Calibration:
    problem = nominal.problem
    experiment: Experiment = problem.experiment

    def moved(of_readings: Array | None) -> Array | None:
        return None if of_readings is None else np.abs(change(of_readings))

    trials = tuple(
        replace(t, y=np.ascontiguousarray(change(t.y)), weight=moved(t.weight), spread=moved(t.spread))
        for t in experiment.trials
    )
    again = problem.changed(experiment=replace(experiment, trials=trials), effect=None, factors=None)
    return calibrate(again, most=15, finish=False)


def _left(fit: Calibration) -> float:
    """Share of a channel's sum of squares that a fit leaves, beyond the noise; the worst channel's."""
    residuals = fit.residuals()
    worst = 0.0
    for c, sd in enumerate(fit.problem.noise.floor):
        pairs = [(r[c], fit.problem.experiment.trials[i].y[c]) for i, r in residuals.items() if c < r.shape[0]]
        left = sum(float(np.nansum(r**2) - np.isfinite(r).sum() * sd**2) for r, _ in pairs)
        total = sum(float(np.nansum((y - np.nanmean(y)) ** 2)) for _, y in pairs)
        worst = max(worst, left / total if total > 0.0 else 0.0)
    return worst
