"""Synthetic campaigns whose truth is drawn from the prior that the fit assumes.

Short and of few trials, so that hundreds can be fitted: one case, two trials, a quarter of a second at 400 Hz. Two
kinds in turn:

- "lone": an uncoupled and a coupled trial, without repeats.
- "repeats": two repeats of a coupled trial.

In both, each trial has its own release angle and instant of release, each coupled one its own friction; the magnet's
pull and the stiffness are uncertain as declared, and the fit is told the prior of the noise.
Records come from reference.py, which shares nothing with the package's integrator, and white noise is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import reference
from numpy.typing import NDArray

from bayes_damper.calibration import FRICTION_SPREAD, Experiment, TrialRecord, default_priors
from bayes_damper.priors.distributions import LogNormal, LogScale, from_standard, to_standard
from bayes_damper.simulation.model import Model

Array = NDArray[np.float64]
KINDS = ("lone", "repeats")
FAINT = "faint"
"""Lone campaigns of which the noise leaves little: here the priors decide much."""
FACTOR = 2.7  # of the widest priors: rigs that are drawn from them swing, and friction acts
RATE = 400.0
TIMES = np.arange(100) / RATE
CONSTANTS = {"J1": (3.015e-3, 0.0), "J2": (2.474e-3, 0.0), "R": (0.1, 0.0), "r": (0.0127, 0.0), "N0": (100.0, 3.0)}
STIFFNESS = (10.2, 0.1)
ANGLE, ANGLE_SD = math.radians(4.7), 0.004 * math.radians(4.7)
NOISE = {**dict.fromkeys(KINDS, LogNormal(2.0, 1.5)), FAINT: LogNormal(40.0, 1.5)}
"""Prior of each channel's noise, rad/s^2."""


@dataclass(frozen=True)
class Campaign:
    """What was measured, and what was true: values of the rig and the noise, and of each trial's own unknowns."""

    experiment: Experiment
    truth: dict[str, float]
    own: tuple[dict[str, float], ...]


def campaign(kind: str, seed: int, number: int) -> Campaign:
    """Synthetic campaign `number` of a kind."""
    rng = np.random.default_rng([seed, (*KINDS, FAINT).index(kind), number])
    configurations = (True, True) if kind == "repeats" else (False, True)
    noise = NOISE[kind]
    blank = tuple(
        TrialRecord(f"{kind} {k}", "IV", coupled, k + 1, TIMES, np.ones((1 + coupled, TIMES.size)), 0, ANGLE, ANGLE_SD)
        for k, coupled in enumerate(configurations)
    )
    experiment = Experiment(CONSTANTS, (STIFFNESS,), blank, priors={"sigma1": noise, "sigma2": noise})
    narrow = {
        name: LogNormal(prior.median_value, min(prior.factor, FACTOR))
        for name, prior in default_priors(experiment).items()
        if isinstance(prior, LogScale) and name != "nu"
    }
    experiment = replace(experiment, priors={**experiment.priors, **narrow})
    truth = {
        name: float(from_standard(prior, rng.standard_normal()))
        for name, prior in (default_priors(experiment) | narrow).items()
    }
    truth |= {name: value + sd * rng.standard_normal() for name, (value, sd) in CONSTANTS.items()}
    truth["k1t"] = STIFFNESS[0] + STIFFNESS[1] * rng.standard_normal()
    truth |= {f"sigma{c}": float(from_standard(noise, rng.standard_normal())) for c in (1, 2)}
    own, trials = [], []
    for trial in blank:
        values = {"theta0": ANGLE + ANGLE_SD * rng.standard_normal(), "delay": _lateness(rng)}
        if trial.coupled:
            values["ln_mu"] = FRICTION_SPREAD * rng.standard_normal()
        y = record(truth, values, trial.coupled)
        sigma = np.array([truth["sigma1"], truth["sigma2"]])[: len(y), None]
        trials.append(replace(trial, y=y + sigma * rng.standard_normal(y.shape)))
        own.append(values)
    return Campaign(replace(experiment, trials=tuple(trials)), truth, tuple(own))


def _lateness(rng: np.random.Generator) -> float:
    """Instant of release before the first reading, s: Gaussian about the middle of a sample, and inside it."""
    while True:
        share = 0.5 + 0.35 * rng.standard_normal()
        if 0.02 < share < 0.98:
            return -float(share) / RATE


def record(truth: dict[str, float], own: dict[str, float], coupled: bool) -> Array:
    """Noise-free accelerations of one trial at TIMES, (channels, n), by the reference solver."""
    values = {name: truth[name] for name in reference.NAMES if name in truth}
    values |= {"theta0": own["theta0"], "mu": truth["mu"] * math.exp(own.get("ln_mu", 0.0))}
    times = np.concatenate([[own["delay"]], TIMES])
    y = reference.solve(values, times, coupled=coupled)[0, : 1 + coupled]
    return y[:, times.size - TIMES.size :]


def log_prior(made: Campaign, values: dict[str, Array]) -> Array:
    """Log prior density in standard coordinates, (n,), of n sets of values; constants left out."""
    known = default_priors(made.experiment) | dict(made.experiment.priors)
    square = sum(to_standard(prior, values[name]) ** 2 for name, prior in known.items() if name in values)
    declared = CONSTANTS | {"k1t": STIFFNESS}
    square += sum(((values[n] - x) / sd) ** 2 for n, (x, sd) in declared.items() if sd > 0.0 and n in values)
    return np.asarray(-0.5 * square)


def log_prior_own(own: list[dict[str, Array]]) -> Array:
    """The same of what each trial has for itself, but for the instants of release: those of a campaign lie within a
    sample, to the fit they are normal.
    """
    square = sum(
        ((mine["theta0"] - ANGLE) / ANGLE_SD) ** 2 + (mine.get("ln_mu", 0.0) / FRICTION_SPREAD) ** 2 for mine in own
    )
    return np.asarray(-0.5 * square)


def log_likelihood(made: Campaign, values: dict[str, Array], own: list[dict[str, Array]]) -> Array:
    """Log density of all readings, (n,), for n sets of values and of each trial's own: written out, no fit involved."""
    total = np.zeros(len(values["mu"]))
    for trial, mine in zip(made.experiment.trials, own, strict=True):
        rig = {name: values.get(name, value) for name, (value, _) in CONSTANTS.items()}
        rig |= {name: values[name] for name in ("k1t", "k2t", "c1t", "c2t", "c3t", "drag", "nu")}
        rig["mu"] = values["mu"] * np.exp(mine.get("ln_mu", 0.0))
        rig |= {"theta0": mine.get("theta0", ANGLE), "delay": mine.get("delay", 0.0)}
        residual = Model(trial.coupled).simulate(rig, TIMES).y - trial.y
        for c in range(len(trial.y)):
            sigma = values[f"sigma{c + 1}"]
            total += -0.5 * np.sum(residual[:, c] ** 2, axis=1) / sigma**2 - TIMES.size * np.log(sigma)
    return total
