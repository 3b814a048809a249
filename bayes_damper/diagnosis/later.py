"""Whether a gap is made at the beginning of the records alone: the nominal model on what follows.

What a release does, and what held the rig does when it touches it again, is over after a few periods. From there on
the motion is that of the nominal model, begun with any angle and velocity, while a law that is wrong stays wrong. The
linearised responses of the site map cannot show that where the gap is large: the motion that they follow is then none
that the rig made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, calibrate_nominal
from bayes_damper.diagnosis.response import Pieces, in_slices, in_turns, motions
from bayes_damper.diagnosis.shapes import TOUCHES
from bayes_damper.diagnosis.sites import TEMPERING, Hypothesis, SiteMap, acts_in, best_evidence, pieces_of

Array = NDArray[np.float64]

LEAST = 1.0  # periods that a record must last after the beginning is cut off
READINGS = 20  # of each channel that must be left
GONE, SEEN = 3.0, 10.0  # nats of a gap, up to which it counts as none, and from which as one
PREDICTED = 0.5  # share of the gap that a hypothesis must gain to have predicted it


@dataclass(frozen=True, eq=False)
class Later:
    """What the nominal model leaves of the records without their first periods, begun with any angle and velocity.

    gap : evidence of the best site over no gap, nats; pieces : the shapes of the whole records' site map on what is
    left of them, by (case, coupled).
    """

    gap: float
    pieces: Pieces

    def against(self, hypotheses: Sequence[tuple[Hypothesis, Array]]) -> Array:
        """Nats, at most 0, that speak against each hypothesis with these amounts (k,) of its columns.

        No gap here speaks against a cause elsewhere than at the release, as far as its amounts would make one. A gap
        that any of them predicts speaks against all at the release, and for no other: shapes and amounts are too
        inexact for more. Tempered as differences between sites are (`shares_of`).
        """
        gains, expected = self._gains(hypotheses)
        if self.gap <= GONE:
            return np.asarray(np.minimum(gains, 0.0) / (1.0 + TEMPERING * expected))
        predicted = self.gap > SEEN and float(gains.max()) > PREDICTED * self.gap
        released = np.array([h.site == "release" for h, _ in hypotheses])
        return np.where(released & predicted, -self.gap / (1.0 + TEMPERING * self.gap), 0.0)

    def _gains(self, hypotheses: Sequence[tuple[Hypothesis, Array]]) -> tuple[Array, Array]:
        """Nats that each hypothesis gains here, and that it would if it were right; at the release, 0 of both."""
        along, expected = np.zeros(len(hypotheses)), np.zeros(len(hypotheses))
        judged = {
            only: self.pieces.on([key for key in self.pieces.names if acts_in(only, *key)])
            for only in dict.fromkeys(h.only for h, _ in hypotheses)
        }
        for k, (h, amounts) in enumerate(hypotheses):
            if h.site != "release":
                on, which = judged[h.only], h.columns
                along[k] = on.product[which] @ amounts
                expected[k] = 0.5 * amounts @ on.gram[np.ix_(which, which)] @ amounts
        return along - expected, expected

    def in_words(self) -> str | None:
        """A sentence where the gap is gone."""
        if self.gap > GONE:
            return None
        return (
            f"From {TOUCHES[1]:g} periods after the release on, the nominal model leaves no gap: what it lacks happens "
            "at the release or soon after it."
        )


def continued(found: SiteMap, report: Callable[[str], None]) -> Later | None:
    """The nominal fit to what follows the first periods, beside the site map of whole records.

    None where little follows, or nothing is released.
    """
    fit = found.fit
    experiment = _without_beginning(fit, found.scale.omega)
    if experiment is None:
        return None
    report("fitting the nominal model to what follows the first periods")
    later = calibrate_nominal(experiment, nominal=fit.problem.nominal)
    sliced = in_slices(later)
    moved = motions(sliced)
    sliced, moved = in_turns(sliced, moved)
    moved = [replace(m, since=m.since + max(float(m.grid[0]), 0.0)) for m in moved]
    pieces, vocabulary = pieces_of(sliced, moved, found.scale)
    return Later(best_evidence(pieces.on(), vocabulary), pieces)


def _without_beginning(fit: Calibration, omega: float) -> Experiment | None:
    """The experiment without the first periods of each record, begun there with any angle and velocity."""
    experiment = fit.problem.experiment
    if experiment.start != "rest" or any(not t.theta0 or t.inputs is not None for t in experiment.trials):
        return None
    period = 2.0 * math.pi / omega
    begin = TOUCHES[1] * period
    cut = tuple(replace(t.at(t.times >= begin), theta0=0.0, theta0_sd=0.0, doubt=0.0) for t in experiment.trials)
    for t in cut:
        if np.any(np.sum(np.isfinite(t.y), axis=1) < READINGS) or t.times[-1] < begin + LEAST * period:
            return None
    return replace(experiment, start="free", trials=cut)
