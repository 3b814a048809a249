"""Readings that one trial does not share with its repeats: bursts and spikes of the measurement, no gap of the model.

What the model lacks shows in every repeat. A reading far off in one trial, where the repeats of the same case are all
within the noise, is the measurement's own; such readings are left out before anything is judged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment
from bayes_damper.diagnosis.remainder import repeats_of

FAR, NEAR = 7.0, 3.5  # robust standard deviations: of the reading, and of its repeats
LATE = 2.0  # samples by which the instant of a release or of a friction reversal may differ between repeats
MOST = 0.1  # share of a record beyond which it is not a matter of single readings


def outlying(fit: Calibration) -> dict[int, NDArray[np.bool_]]:
    """Readings to leave out: trial -> (channels, n), only trials that have any."""
    residuals = fit.residuals()
    trials = fit.problem.experiment.trials
    out = {}
    for members in repeats_of(fit):
        if len(members) < 2:
            continue
        r = np.array([residuals[i] for i in members])
        with np.errstate(invalid="ignore"):
            scale = 1.4826 * np.nanmedian(np.abs(r), axis=(0, 2))
            z = np.abs(r) / np.maximum(scale, 1e-300)[None, :, None]
        for k, i in enumerate(members):
            others = np.nan_to_num(np.delete(z, k, axis=0), nan=np.inf).max(axis=0)
            step = np.abs(np.gradient(np.nan_to_num(trials[i].y - r[k]), axis=1))
            step = np.maximum(step, np.maximum(np.roll(step, 1, axis=1), np.roll(step, -1, axis=1)))
            far = (np.nan_to_num(z[k]) > FAR) & (others < NEAR) & (np.abs(r[k]) > LATE * step)
            far[:, :2] = False  # the release itself
            if 0.0 < far.mean() < MOST:
                out[i] = far
    return out


def without(experiment: Experiment, far: dict[int, NDArray[np.bool_]]) -> Experiment:
    """The experiment without those readings."""
    trials = list(experiment.trials)
    for i, mask in far.items():
        trials[i] = replace(trials[i], y=np.where(mask, np.nan, trials[i].y))
    return replace(experiment, trials=tuple(trials))


def told(experiment: Experiment, far: dict[int, NDArray[np.bool_]]) -> list[str]:
    """What was left out, a sentence for each trial."""
    out = []
    for i, mask in far.items():
        t = experiment.trials[i]
        times = t.times[mask.any(axis=0)]
        if mask.sum() == 1:
            told = f"one reading at {times.min():.4g} s is far from those of its repeats; it was left out as a fault"
        else:
            told = (
                f"{int(mask.sum())} readings between {times.min():.4g} s and {times.max():.4g} s are far from those of "
                "its repeats; they were left out as faults"
            )
        out.append(f"{t.label}: {told} of the measurement.")
    return out
