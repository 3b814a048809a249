"""Campaigns without repeats: what an answer is worth there, and what it leaves.

Without repeats nothing tells a wrong model from correlated noise, and formulas enough are offered for one of them to
follow the error of the fitted readings. Held-out readings are the judge then. Given the fit, what they gain under an
effect is a Bayes factor of its own, with the fitted readings spent on the priors (Berger and Pericchi 1996, J. Am.
Statist. Assoc. 91, 109); an answer counts no more than the weaker of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_damper.calibration import Calibration, calibrate, error_level, learn_noise, predict
from bayes_damper.diagnosis.gap import squares_of_trials
from bayes_damper.diagnosis.pairs import Pair, refitted
from bayes_damper.diagnosis.search import Candidate
from bayes_damper.diagnosis.verdict import RULE, Left, Rule

SHARPER = 1.015  # ratio of noise levels from which evidences are taken again under the smaller one
REDUCIBLE = 2.0  # times the sensors' noise that a trial's sum of squares must be for its share to count


def held_out_gain(nominal: Calibration, fit: Calibration) -> float:
    """Nats by which a fit predicts the held-out readings better than the nominal one; inf if none are held out.

    Errors grow with the swing, so the level of each trial and channel is its own and unknown: half of its effective
    readings (those of the residuals that are the more correlated) times the log ratio of the sums of squares.
    """
    heldout = nominal.problem.experiment.heldout
    if not heldout:
        return math.inf
    gain = 0.0
    before, after = (predict(model, heldout) for model in (nominal, fit))
    for i in heldout:
        for r0, r1 in zip(before[i].residual, after[i].residual, strict=True):
            pair = [r[np.isfinite(r)] for r in (r0, r1)]
            squares = [float(r @ r) for r in pair]
            levels = [error_level([r]) for r in pair]
            if min(*squares, *levels) > 0.0:
                effective = min(ss / level**2 for ss, level in zip(squares, levels, strict=True))
                gain += 0.5 * effective * math.log(squares[0] / squares[1])
    return gain if math.isfinite(gain) else -math.inf


def corroborated(nominal: Calibration, found: Sequence[Candidate]) -> list[Candidate]:
    """Candidates whose evidence is at most what the held-out readings gain, best first."""
    out = [
        c
        if c.fit is None or not c.log_evidence > 0.0
        else replace(c, log_evidence=min(c.log_evidence, held_out_gain(nominal, c.fit)))
        for c in found
    ]
    return sorted(out, key=lambda c: -c.log_evidence)


def corroborated_pairs(nominal: Calibration, pairs: Sequence[Pair]) -> list[Pair]:
    """The same of pairs."""
    out = []
    for p in pairs:
        less = max(0.0, p.log_evidence - held_out_gain(nominal, p.fit)) if p.log_evidence > 0.0 else 0.0
        out.append(replace(p, log_evidence=p.log_evidence - less, gain=p.gain - less))
    return sorted(out, key=lambda p: -p.log_evidence)


def with_pairs_noise(
    nominal: Calibration, found: Sequence[Candidate], pairs: Sequence[Pair]
) -> tuple[Calibration, list[Candidate], list[Pair]]:
    """Nominal model, fitted candidates and pairs under the error level that the best pair leaves, where it is smaller.

    The level stands for the error of the model, so any better model is asked what it leaves.
    """
    if not pairs or not pairs[0].gain > 0.0:
        return nominal, list(found), list(pairs)
    noise = learn_noise(pairs[0].fit)
    old = nominal.problem.noise.innovation
    if max(a / b for a, b in zip(old, noise.innovation, strict=True)) < SHARPER:
        return nominal, list(found), list(pairs)

    def again(fit: Calibration) -> Calibration:
        return calibrate(fit.problem.with_noise(noise), [fit.q], eta=fit.eta, anneal=False, most=12)

    fresh = again(nominal)
    singles = []
    for c in found:
        fit = None if c.fit is None else again(c.fit)
        value = c.log_evidence if fit is None else fit.log_evidence - fresh.log_evidence
        singles.append(replace(c, fit=fit, log_evidence=value))
    singles = corroborated(fresh, singles)
    both = [refitted(fresh, p, again(p.fit), singles) for p in pairs]
    return fresh, singles, corroborated_pairs(fresh, [p for p in both if p is not None])


def left_alone(nominal: Calibration, fit: Calibration, rule: Rule = RULE) -> Left:
    """What an answer leaves of trials without repeats, by their sums of squares against the noise of the sensors.

    That noise, from the readings' fast content, is the floor here. The share is the mean over trials: the swing of
    largest amplitude, where models err most, does not decide alone.
    """
    before, floor = squares_of_trials(nominal)
    after, _ = squares_of_trials(fit)
    return left_of_squares(before, after, floor, rule)


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
