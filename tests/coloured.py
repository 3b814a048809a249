"""Small campaigns with correlated errors and known truth, and where the truth lies in the posterior of their fit."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import small_rig
from draws import sampled, weighted
from numpy.typing import NDArray
from scipy.signal import lfilter
from small_rig import measured

from bayes_damper.calibration import Experiment
from bayes_damper.calibration.correlated_noise import fit_with_noise
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.priors.distributions import LogNormal, to_standard

Array = NDArray[np.float64]
NAMES = ("k2t", "c2t", "c1t", "c3t", "mu", "drag", "nu")


def autoregression(rng: np.random.Generator, shape: tuple[int, ...], phi: float, sd: float) -> Array:
    """A first-order autoregression along the last axis, stationary from its first value on."""
    raw = rng.standard_normal((*shape[:-1], shape[-1] + 200))
    return np.asarray(sd * np.sqrt(1.0 - phi**2) * lfilter([1.0], [1.0, -phi], raw, axis=-1)[..., 200:])


def campaign(
    seed: int, kind: str, repeats: int, phi: float = 0.95, sd: float = 6.0
) -> tuple[Experiment, dict[str, float], np.random.Generator]:
    """A campaign whose truth is drawn from its priors, that truth, and the generator that drew it.

    Nothing scatters from trial to trial, and the campaign says so.

    kind : "white"; "own", an autoregression in each trial beside the white noise; "shared", the same one in all
    repeats, as a model that is wrong leaves.
    """
    rng = np.random.default_rng(seed)
    priors = {name: LogNormal(small_rig.RIG[name], 1.5) for name in NAMES}
    truth = {name: float(prior.ppf(rng.random())) for name, prior in priors.items()}
    shared: dict[tuple[int, ...], Array] = {}

    def sensor(_times: Array, y: Array) -> Array:
        if kind == "white":
            return y
        error = autoregression(rng, y.shape, phi, sd)
        return y + (error if kind == "own" else shared.setdefault(y.shape, error))

    with mock.patch.dict(small_rig.RIG, truth):
        experiment = measured(seed, sensor=sensor, cases=[("IV", 1, 0.08)], duration=0.4, repeats=repeats)
    return replace(experiment, priors=priors, scatter=dict.fromkeys(TYPICAL, 0.0)), truth, rng


def covered(seed: int, kind: str, repeats: int, mode: str = "auto") -> Array:
    """Probability that the posterior puts below the truth of each nominal parameter of a `campaign`, (7,).

    The posterior is that of RecordPosterior, by weighted draws, or by the sampler where too few of them count.
    """
    experiment, truth, rng = campaign(seed, kind, repeats)
    priors = experiment.priors
    found = fit_with_noise(experiment, mode)
    posterior = RecordPosterior(
        found.fit, power=found.power, freedom=found.freedom if found.kind == "student" else None
    )
    drawn = weighted(posterior, rng, 2000)
    points = drawn[0] if drawn is not None else sampled(posterior, rng, seed).flat()
    at = [(posterior.names.index(name), float(to_standard(priors[name], truth[name]))) for name in NAMES]
    return np.array([float(np.mean(points[:, i] < x)) for i, x in at])


def share_inside(ranks: Array, share: float) -> float:
    """How many of the truths lie in the central interval that holds `share` of the posterior."""
    return float(np.mean(np.abs(ranks - 0.5) < 0.5 * share))
