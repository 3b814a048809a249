"""Campaigns without repeats: what an answer leaves there.

Without repeats nothing separates a wrong model from correlated noise; sums of squares on held-out readings against the
noise of the sensors show what is left. Which effects are present is decided on fitted readings alone (sets.py), so that
held-out ones can score it. A single record with nothing held out has its second half in place of repeats: a name counts
as far as a fit to the first half predicts it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bayes_damper.calibration import Calibration, calibrate
from bayes_damper.calibration.noise import tails_of
from bayes_damper.diagnosis.gap import OUT_OF_REACH, squares_of_trials
from bayes_damper.diagnosis.outliers import without
from bayes_damper.diagnosis.remainder import odd_shapes
from bayes_damper.diagnosis.shares import products_of
from bayes_damper.diagnosis.verdict import RULE, Left, Rule

REDUCIBLE = 2.0  # times the sensors' noise that a trial's sum of squares must be for its share to count


def left_alone(nominal: Calibration, fit: Calibration, rule: Rule = RULE) -> Left:
    """What an answer leaves of trials without repeats, by their sums of squares against the noise of the sensors.

    That noise, from the readings' fast content, is the floor here. The share is the mean over trials: the swing of
    largest amplitude, where models err most, does not decide alone. Heavy tails of the noise belong to the floor: what
    an answer leaves shows them, but not what the nominal model leaves, in which events of a gap are as rare and large.
    Nor does noise account for a declared constant that the nominal model takes far out of its reach.
    Where no trial stands out of that noise, sums of squares say little of the share, and products of residuals in which
    noise averages out (shares.py) give it if they can.
    """
    before, floor = squares_of_trials(nominal)
    if fit is nominal:
        left = left_of_squares(before, before, floor, rule)
        return replace(left, nats=left.nats + 0.5 * sum(z**2 for z in nominal.pulled.values() if abs(z) > OUT_OF_REACH))
    after, _ = squares_of_trials(fit)
    sds = fit.problem.noise.floor
    residuals, trials = fit.residuals(), nominal.problem.experiment.trials
    tails = tails_of(
        [r[c] / sds[c] for r in residuals.values() for c in range(len(r))],
        readings=[trials[i].y[c] for i, r in residuals.items() for c in range(len(r))],
    )
    left = replace(left_of_squares(before, after, tails * floor, rule), odd=odd_shapes(fit))
    heldout = nominal.problem.experiment.heldout
    if not heldout or (before > REDUCIBLE * floor).any():
        return left
    closed = products_of([nominal, fit], heldout).closed(1).median
    return left if closed is None else replace(left, share=min(max(1.0 - closed, 0.0), 1.0))


def leaving(nominal: Calibration) -> Callable[[Calibration], Left]:
    """What a fit leaves, for trials without repeats: `left_alone`, and for a single record `left_of_the_rest` too."""
    problem = nominal.problem
    single = len(problem.trials) == 1 and not problem.experiment.heldout
    return partial(left_of_the_rest, nominal, _rest(nominal)) if single else partial(left_alone, nominal)


def left_of_the_rest(nominal: Calibration, before: tuple[float, float], fit: Calibration) -> Left:
    """As `left_alone`, with at least the share that a fit to the first half of a single record leaves of the second.

    before : what the nominal model leaves of that, and what noise does, as by `_rest`. Where no gap stands out there,
    nothing shows whether the answer holds beyond what it was fitted to, and all of the record counts.
    """
    whole = left_alone(nominal, fit)
    if fit is nominal or before[0] <= REDUCIBLE * before[1]:
        return whole
    after, floor = _rest(fit)
    return replace(whole, share=max(whole.share, min(max((after - floor) / (before[0] - floor), 0.0), 1.0)))


def _rest(fit: Calibration) -> tuple[float, float]:
    """Squares, over the sensors' variance, that a fit to the first half of a record leaves of the rest; of noise alone.

    The other way round a rig that starts free has no known beginning.
    """
    problem = fit.problem
    (i,) = problem.trials
    y = problem.experiment.trials[i].y
    hidden = np.broadcast_to(np.arange(y.shape[1]) >= y.shape[1] // 2, y.shape)
    own = problem.changed(experiment=without(problem.experiment, {i: hidden}))
    begun = calibrate(own, [fit.q], eta=fit.eta, anneal=False)
    seen = hidden & np.isfinite(y)
    sds = np.array(problem.noise.floor)[: len(y)]
    residual = (y - begun.simulated()[i]) / problem.experiment.trials[i].noise(sds)
    return float(np.sum(residual[seen] ** 2)), float(seen.sum())


def left_of_squares(before: np.ndarray, after: np.ndarray, floor: np.ndarray, rule: Rule = RULE) -> Left:
    """The same from sums of squares of each trial (trials,) before and after, and those of the noise alone."""
    total = float(floor.sum())
    ratio = float(after.sum()) / total if total > 0.0 else 1.0
    nats = rule.strength * math.log(max(ratio, 1e-9)) / math.log(rule.lone_ratio)
    large = before > REDUCIBLE * floor
    if large.any():
        share = float(np.mean(np.clip((after - floor)[large] / (before - floor)[large], 0.0, 1.0)))
    else:
        reducible = float(before.sum()) - total
        share = min(max((float(after.sum()) - total) / reducible, 0.0), 1.0) if reducible > 0.0 else 1.0
    return Left(nats, share, lone=True)
