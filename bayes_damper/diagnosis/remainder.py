"""What a fit leaves unexplained: tests of its residuals that need no library of effects.

What the repeats of one case share is the model's fault. So the whitened residuals of repeats are averaged, and the
periodogram of the mean is held against that of white noise, Exp(1): a smooth excess at low frequency (torques that are
missing), a narrow line or band (a resonance, a hum), or an event in time. Lines that keep no phase from trial to trial
drop out of the mean and are looked for in the single records.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import gamma

from bayes_damper.calibration import Calibration, Experiment

Array = NDArray[np.float64]

# Frequencies are those of the primary on its spring, times:
CORNERS = (1.8, 4.8, 12.0, 30.0)  # of the generic spectra tried
LOW_BAND = 12.0  # torques that act on inertias show below
BAND_WIDTH = 0.6  # of the bands of the omnibus test
STRENGTHS = np.geomspace(0.05, 3e4, 28)


@dataclass(frozen=True)
class Remainder:
    """Evidence that something is left, in nats, and how much.

    generic : gain of a generic smooth discrepancy over none, its strength and corner chosen and paid for;
    line : -ln p of the strongest line or band over the smooth spectrum, looks paid for; low_excess : chi-square of the
    mean residuals at low frequency beyond its expectation, low_sd its standard deviation under noise; peak_hz : where
    the strongest line lies; own_hz : frequency of the primary on its spring.
    """

    generic: float
    line: float
    peak_hz: float
    low_excess: float
    low_sd: float
    excess: float
    own_hz: float = 1.0

    @property
    def strength(self) -> float:
        """The larger of both kinds of evidence, nats."""
        return max(self.generic, self.line)


def repeats_of(fit: Calibration) -> list[list[int]]:
    """Trials of the fit in sets of repeats: same case, configuration, release angle and sample times.

    Records that start in motion have no repeats: no two begin alike.
    """
    sets: dict[tuple[object, ...], list[int]] = {}
    for i in fit.problem.trials:
        t = fit.problem.experiment.trials[i]
        alone = i if fit.problem.experiment.start == "free" else -1
        sets.setdefault((*t.conditions, t.times.tobytes(), alone), []).append(i)
    return list(sets.values())


def own_frequency(experiment: Experiment) -> float:
    """Frequency of the primary on its spring, Hz: the median over the springs."""
    springs = float(np.median([k for k, _ in experiment.stiffnesses]))
    return math.sqrt(springs / experiment.constants["J1"][0]) / (2.0 * math.pi)


def whitened_records(fit: Calibration) -> dict[int, Array]:
    """Whitened, weighted residuals of each fitted trial, (channels, n): unit variance under the noise model."""
    out = {}
    for block in fit.linear.blocks:
        channels = block.group.y.shape[1]
        for k, i in enumerate(block.group.trials):
            out[i] = block.r[k].reshape(channels, -1)
    return out


def readings_of_change(before: Calibration, after: Calibration) -> float:
    """How many readings of a record carry the change that one fit makes over another, inf if there is none.

    (sum d^2)^2 / sum d^4 over the whitened changes d of a channel: its number of readings for a change spread evenly, 1
    for a single reading; mean over records, weighted by sum d^2.
    """
    old, new = whitened_records(before), whitened_records(after)
    d2 = np.concatenate([np.sum((new[i] - old[i]) ** 2, axis=1) for i in old if i in new])
    d4 = np.concatenate([np.sum((new[i] - old[i]) ** 4, axis=1) for i in old if i in new])
    some = d4 > 0.0
    total = float(d2[some].sum())
    return float(np.sum(d2[some] ** 3 / d4[some])) / total if total > 0.0 else math.inf


def remainder_of(fit: Calibration) -> Remainder:
    """Tests of what a fit leaves."""
    records = whitened_records(fit)
    known = {i: b.group.weight[k] > 0.0 for b in fit.linear.blocks for k, i in enumerate(b.group.trials)}
    own = own_frequency(fit.problem.experiment)
    power: list[tuple[Array, Array]] = []
    shared: list[tuple[Array, Array]] = []
    for members in repeats_of(fit):
        stack = np.array([records[i] for i in members])
        mean = stack.sum(axis=0) / math.sqrt(len(members))
        times = fit.problem.experiment.trials[members[0]].times
        dt = float(np.median(np.diff(times))) if times.size > 1 else 1.0
        f = np.asarray(np.fft.rfftfreq(mean.shape[1], dt)[1:-1], float)
        for channel in range(mean.shape[0]):
            # Missing readings bring no power: without them a gap would drown in what they should have brought.
            kept = [max(int(np.count_nonzero(known[i][channel])), 1) for i in members]
            shared.append((f, np.abs(np.fft.rfft(mean[channel])[1:-1]) ** 2 / np.mean(kept)))
            for k in range(len(members)):
                power.append((f, np.abs(np.fft.rfft(stack[k, channel])[1:-1]) ** 2 / kept[k]))
    if not shared or shared[0][0].size < 8:
        return Remainder(0.0, 0.0, 0.0, 0.0, 1.0, fit.excess, own)
    generic, level, corner = _generic(shared, own)
    # A peak of a smooth excess is no line: what the smooth spectrum explains is taken out first.
    smooth = level if generic > 0.0 else 0.0
    line, peak = _lines([(f, p / (1.0 + smooth * _shape(f, corner))) for f, p in shared], own)
    single, single_peak = _lines([(f, p / (1.0 + smooth * _shape(f, corner))) for f, p in power], own)
    if single > line:
        line, peak = single, single_peak
    low = float(sum(np.sum(p[f < LOW_BAND * own] - 1.0) for f, p in shared))
    count = sum(int(np.sum(f < LOW_BAND * own)) for f, _ in shared)
    # Each ordinate is Exp(1); an uncertain noise level adds to the spread of the sum.
    low_sd = math.sqrt(count + (0.01 * count) ** 2)
    return Remainder(generic, line, peak, 2.0 * low, 2.0 * low_sd, fit.excess, own)


def _shape(f: Array, corner: float) -> Array:
    """Spectrum of a smooth discrepancy at frequencies f, 1 at the lowest."""
    return np.asarray(1.0 / (1.0 + (f / corner) ** 4))


def _generic(spectra: Sequence[tuple[Array, Array]], own: float) -> tuple[float, float, float]:
    """Gain of the best smooth spectrum, nats, looks paid for; its strength and its corner, Hz."""
    best, strength, where = 0.0, 0.0, CORNERS[0] * own
    f = np.concatenate([s[0] for s in spectra])
    p = np.concatenate([s[1] for s in spectra])
    for corner in (own * c for c in CORNERS):
        level = 1.0 + STRENGTHS[:, None] * _shape(f, corner)
        gain = np.sum(p * (1.0 - 1.0 / level) - np.log(level), axis=1)
        k = int(np.argmax(gain))
        if gain[k] > best:
            best, strength, where = float(gain[k]), float(STRENGTHS[k]), corner
    return best - math.log(len(CORNERS) * 4.0), strength, where


def _lines(spectra: Sequence[tuple[Array, Array]], own: float) -> tuple[float, float]:
    """-ln p of the strongest line or narrow band of the sum over records of the same frequencies, looks paid for."""
    sums: dict[bytes, list[Array]] = {}
    grids: dict[bytes, Array] = {}
    for f, p in spectra:
        sums.setdefault(f.tobytes(), []).append(p)
        grids[f.tobytes()] = f
    best, where = -math.inf, 0.0
    looks = 0
    for key, rows in sums.items():
        f = grids[key]
        total = np.sum(rows, axis=0)
        spacing = f[1] - f[0]
        wide = max(1, round(BAND_WIDTH * own / spacing))
        for width in sorted({1, wide}):
            m = f.size // width
            band = total[: m * width].reshape(m, width).sum(axis=1)
            looks += m
            minus_log_p = -gamma.logsf(band, a=len(rows) * width)
            k = int(np.argmax(minus_log_p))
            if minus_log_p[k] > best:
                best, where = float(minus_log_p[k]), float(f[k * width : (k + 1) * width].mean())
    return min(best, 1e6) - math.log(max(looks, 1)), where
