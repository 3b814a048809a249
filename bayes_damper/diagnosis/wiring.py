"""Channels under a wrong name: exchanged between the bodies, or reversed in sign.

No law of the rig is wrong there, and no formula comes near it, so what the site map makes of it misleads. As an answer
it has no free parameter: the nominal model is fitted to the records as they would have been, under the same noise or,
where no repeats show the noise, each under what it leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, calibrate, grown
from bayes_damper.calibration.nominal import broad_noise
from bayes_damper.calibration.scatter import carried
from bayes_damper.diagnosis.sets import set_fit, sharpened, weighed

Array = NDArray[np.float64]

POOR = 0.02  # share of a channel's squares that the nominal model must leave for its wiring to be doubted
MENDED = 0.1  # of that, what the right wiring may leave


@dataclass(frozen=True)
class Wiring:
    """What mends the records.

    gain : in log evidence over the nominal model, nats; after, before : shares of the squares left.
    """

    words: str
    gain: float
    after: float
    before: float

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
FREE_WAYS = (WAYS[0], ("the sign of channel 1 or of channel 2 reversed", _second))
"""Of two bodies that start free: what all channels together reverse, nothing shows."""


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
    for words, change in WAYS if experiment.start == "rest" else FREE_WAYS:
        found = Wiring(words, *_mended(nominal, change, before), before)
        if found.after < MENDED * before and found.gain > (0.0 if best is None else best.gain):
            best = found
    return best


def _mended(nominal: Calibration, change: Callable[[Array], Array], before: float) -> tuple[float, float]:
    """Gain of the records as they would have been over those that there are, nats, and the share of squares left.

    before : the share that the nominal model leaves of the records as they are.
    """
    problem = nominal.problem
    mended = _rewired(problem.experiment, change)
    again = problem.changed(experiment=mended, effect=None, factors=None)
    alone = bool(problem.noise.sensor)
    if alone:  # the noise is what the nominal fit leaves, which fits nothing
        again = again.with_noise(broad_noise(mended, problem.trials))
    # Over many periods the cost has a valley for each cycle, and the nominal fit lies in a wrong one.
    begun = grown(mended, again)
    starts, eta = ((), None) if begun is None else ((begun.q,), carried(begun, again))
    fit = calibrate(again, starts, eta=eta, most=15, finish=False)
    if not alone or not _left(fit) < before:
        return fit.log_evidence - nominal.log_evidence, _left(fit)
    fit = sharpened(fit)
    sets = weighed([set_fit((), nominal), set_fit((), fit)])
    return next(s.evidence for s in sets if s.fit is fit), _left(fit)


def _rewired(experiment: Experiment, change: Callable[[Array], Array]) -> Experiment:
    def moved(of_readings: Array | None) -> Array | None:
        return None if of_readings is None else np.abs(change(of_readings))

    trials = tuple(
        replace(t, y=np.ascontiguousarray(change(t.y)), weight=moved(t.weight), spread=moved(t.spread))
        for t in experiment.trials
    )
    return replace(experiment, trials=trials)


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
