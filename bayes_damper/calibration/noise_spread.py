"""Noise that is stronger where a rig moves more: of a clock that jitters, of a camera, of a joint that rattles.

Within a record its variance is s^2 + (b A)^2, A the rms of the readings over about a period: two numbers of a channel,
from fast content of what the model leaves, where they describe it better than one. Each reading then counts as its
own noise has it; taken as equally noisy, the first swings of such records look like a gap.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_damper.calibration.experiment import Experiment, TrialRecord, repeats_by_reading
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.least_squares import Calibration
from bayes_damper.calibration.noise_level import TRUSTED
from bayes_damper.campaign.readings import resolution_of

Array = NDArray[np.float64]
ORDER = 4  # of the differences that leave of residuals the fast content, as in `noise.fast_level`
LEAST = 16  # readings, at least, whose differences show one level
ONE_LEVEL = 0.17
"""Independent readings that one reading stands for: of the logarithm of a median of absolute values the variance is
1.36 / n and not 1 / (2 n), and neighbouring differences of the fourth order are correlated (2.2 readings in one)."""
CLEARLY = 8.0  # nats by which two numbers have to describe a channel's levels better than one


def with_spread(fit: Calibration) -> Experiment | None:
    """The experiment with the spread of each reading's noise over that of its channel; None where none shows.

    Of 1 / spread^2 the mean over all fitted readings of a channel is 1.
    """
    experiment, spreads = fit.problem.experiment, {}
    if any(t.spread is not None for t in experiment.trials):
        return None
    swings = [_swing(experiment, t) for t in experiment.trials]
    for c in range(len(fit.problem.noise.total)):
        if not any(experiment.rounding[c : c + 1]) and (share := _share_of_swing(fit, swings, c)) is not None:
            spreads[c] = share
    if not spreads:
        return None
    rows = [np.ones(t.y.shape) for t in experiment.trials]
    for c, share in spreads.items():
        having = [i for i, row in enumerate(rows) if c < len(row)]
        for i in having:
            rows[i][c] = np.sqrt(1.0 + (share * swings[i][c]) ** 2)
        fitted = [rows[i][c][np.isfinite(experiment.trials[i].y[c])] for i in fit.problem.trials if i in having]
        mean = math.sqrt(float(np.mean(np.concatenate(fitted) ** -2.0)))
        for i in having:
            rows[i][c] *= mean
    trials = (replace(t, spread=row) for t, row in zip(experiment.trials, rows, strict=True))
    return replace(experiment, trials=tuple(trials))


def spread_of(experiment: Experiment) -> list[float]:
    """Largest over smallest standard deviation of the noise within each channel, (channels,): 1 where it is steady."""
    rows = [t.spread for t in experiment.trials if t.spread is not None]
    return [
        max((float(row[c].max() / row[c].min()) for row in rows if c < len(row)), default=1.0)
        for c in range(max(len(t.y) for t in experiment.trials))
    ]


def spread_in_words(experiment: Experiment) -> list[str]:
    """What noise that grows with the motion does to the weights of readings, a sentence for each such channel."""
    return [
        f"The noise of channel {c} is up to {ratio:.1f} times as strong where the rig moves most as at rest, as from "
        "an uneven clock, a camera or a loose sensor; readings count accordingly."
        for c, ratio in enumerate(spread_of(experiment), 1)
        if ratio > 1.0
    ]


def _swing(experiment: Experiment, trial: TrialRecord) -> Array:
    """Rms of the readings over about a period around each, (channels, n)."""
    n = trial.times.size
    width = min(_period(experiment, trial), n)
    first = np.maximum(np.arange(n) - width // 2, 0)
    last = np.minimum(np.arange(n) - width // 2 + width, n)

    def within(x: Array) -> Array:
        """Sum over the window around each reading; x (channels, n)."""
        sums = np.concatenate([np.zeros((len(x), 1)), np.cumsum(x, axis=1)], axis=1)
        return np.asarray(sums[:, last] - sums[:, first])

    known = np.isfinite(trial.y)
    mean = np.nansum(trial.y, axis=1) / np.maximum(known.sum(axis=1), 1)
    squares = within(np.where(known, trial.y - mean[:, None], 0.0) ** 2)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / np.maximum(within(known.astype(np.float64)), 1.0)))


def _period(experiment: Experiment, trial: TrialRecord) -> int:
    """Readings in a period of the primary on its spring, at least those that show one level."""
    step = float(np.median(np.diff(trial.times))) if trial.times.size > 1 else 1.0
    return max(LEAST, round(2.0 * math.pi / experiment.omegas[trial.k1t] / max(step, 1e-300)))


def _share_of_swing(fit: Calibration, swings: list[Array], channel: int) -> float | None:
    """What b is over s for a channel; None where one level describes it as well."""
    problem = fit.problem
    residuals, trust = fit.residuals(), trust_of(problem.groups)
    levels: list[tuple[float, float, float]] = []  # square, of the swing, readings
    for members in repeats_by_reading(problem.experiment, problem.trials):
        having = [i for i in members if channel < len(residuals[i])]
        if not having:
            continue
        n = len(having)
        rows = np.array([np.where(trust[i][channel] > TRUSTED, residuals[i][channel], np.nan) for i in having])
        # What repeats share is the model's.
        rows = rows if n == 1 else (rows - rows.mean(axis=0)) * math.sqrt(n / (n - 1.0))
        width = _period(problem.experiment, problem.experiment.trials[having[0]])
        fast = np.diff(rows, n=ORDER, axis=1) / math.sqrt(math.comb(2 * ORDER, ORDER))
        for i, row in zip(having, fast, strict=True):
            for first in range(0, row.size - LEAST + 1, width):
                part = row[first : first + width]
                known = np.abs(part[np.isfinite(part) & (part != 0.0)])
                if known.size >= LEAST:
                    swing = swings[i][channel][first : first + width]
                    square = (1.4826 * float(np.median(known))) ** 2
                    levels.append((square, float(np.mean(swing**2)), known.size * (1.0 - (n > 1) / n)))
    if len(levels) < 3:
        return None
    square, swing2, count = np.array(levels).T
    count *= 0.5 * ONE_LEVEL
    usual, most = float(np.average(square, weights=count)), float(swing2.max())

    def minus_log(variance: Array) -> float:
        return float(np.sum(count * (np.log(variance / usual) + square / variance)))

    def of(x: Array) -> float:
        return minus_log(usual * (math.exp(x[0]) + math.exp(x[1]) * swing2 / most))

    found = min(
        (minimize(of, np.array(start), method="Nelder-Mead") for start in ((-0.7, -0.7), (-3.0, 1.0))),
        key=lambda f: float(f.fun),
    )
    if minus_log(np.full(square.size, usual)) - float(found.fun) < CLEARLY:
        return None
    read = [t.y[channel] for t in problem.experiment.trials if channel < len(t.y)]
    if float(np.median([resolution_of(y[np.isfinite(y)]) for y in read])) > math.sqrt(usual):
        return None  # what is rounded to steps shows no noise where it moves less than one
    return math.exp(0.5 * (found.x[1] - found.x[0])) / math.sqrt(most)
