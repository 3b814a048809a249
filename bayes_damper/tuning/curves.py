"""What the tuning figures show: the loss over J2 and R, and frequency responses, with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.rig import linear
from bayes_damper.tuning.draws import Draws
from bayes_damper.tuning.optimum import middle_of
from bayes_damper.tuning.performance import SWEPT, Design, Driven, linear_performance, linear_rig, probability_of

Array = NDArray[np.float64]
CURVES: Mapping[str, tuple[float, float]] = {"J2": (0.1, 2.0), "R": (0.5, 2.0)}
"""What the tuning curves go over, as factors on the rig's present J2 and R."""
_CURVE_POINTS = 25
_EVEN, _CLOSE = 161, 21  # frequencies of a response: over all the range, and among the resonances of the draws


@dataclass(frozen=True)
class Curve:
    """Insertion loss of the linear model over one quantity of the design: its values (n,), mean and central 90 % of the
    loss in dB, and the probability of the target, each (n,).
    """

    values: Array
    mean: Array
    low: Array
    high: Array
    probability: Array


def tuning_curves(
    draws: Draws, design: Design, target_db: float, over: Sequence[str] = tuple(CURVES)
) -> dict[str, Curve]:
    """Insertion loss against J2 and R about a design, all else as in the design; `over` : which of them."""
    out = {}
    for name in over:
        low, high = CURVES[name]
        present = middle_of(draws, name)
        values = np.union1d(present * np.geomspace(low, high, _CURVE_POINTS), getattr(design, name) or present)
        if name == "J2":
            values = values[values >= design.bar_inertia]
        found = [linear_performance(draws, replace(design, **{name: float(x)})) for x in values]
        losses = np.array([p.insertion_loss for p in found])
        low_loss, _, high_loss = quantiles(losses)
        finite = np.isfinite(losses)
        mean = np.where(finite, losses, 0.0).sum(axis=1) / np.where(finite.any(axis=1), finite.sum(axis=1), np.nan)
        reached = np.array([probability_of(p, target_db) for p in found])
        out[name] = Curve(values, mean, low_loss, high_loss, reached)
    return out


@dataclass(frozen=True)
class Band:
    """Quantiles 5, 50 and 95 % of an accelerance over the posterior; each (n_frequencies,)."""

    frequency_hz: Array
    low: Array
    median: Array
    high: Array


def _band(frequency: Array, accelerance: Array) -> Band:
    return Band(frequency, *quantiles(accelerance.T))


def quantiles(x: Array) -> Array:
    """Quantiles 5, 50 and 95 % over the draws, the last axis: (3, n); nan where no draw has a value."""
    finite = np.isfinite(x)
    some = np.asarray(finite.any(axis=-1))
    found = np.nanquantile(np.where(finite, x, np.where(some[:, None], np.nan, 0.0)), [0.05, 0.5, 0.95], axis=-1)
    return np.where(some, found, np.nan)


def frequency_responses(draws: Draws, designs: Mapping[str, Design]) -> dict[str, Band]:
    """Bands of the linear model's accelerance without a secondary ("uncoupled") and with each design."""
    without = {"uncoupled": dict(draws) | {k: np.zeros_like(draws[k]) for k in ("k2t", "c2t")}}
    out = {}
    for name, values in (without | {name: d.apply(draws) for name, d in designs.items()}).items():
        rig = linear_rig(values)
        frequency = _frequencies(draws, linear.resonances(rig).frequency_hz)
        out[name] = _band(frequency, linear.accelerance(rig, frequency)[:, 0])
    return out


def driven_responses(draws: Draws, found: Driven) -> dict[str, Band]:
    """The same of the nonlinear rig, from the sweeps that its losses were taken from."""
    out = {}
    for name, swept in found.sweeps.items():
        frequency = _frequencies(draws, swept.resonances())
        out[name] = _band(frequency, swept.at(frequency))
    return out


def _frequencies(draws: Draws, resonances: Array) -> Array:
    """Frequencies to draw at: an even grid, and where the resonances of the draws lie."""
    own = float(np.median(linear.natural_frequency(draws["k1t"], draws["J1"])))
    known = resonances[np.isfinite(resonances)]
    close = np.quantile(known, np.linspace(0.0, 1.0, _CLOSE)) if known.size else np.array([own])
    even = np.geomspace(min(SWEPT[0] * own, 0.9 * close[0]), max(SWEPT[1] * own, 1.1 * close[-1]), _EVEN)
    return np.unique(np.concatenate([even, close]))
