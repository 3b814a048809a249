"""What a fit leaves unexplained: tests of its residuals that need no library of effects.

What the repeats of one case share is the model's fault. So the whitened residuals of repeats are averaged, and the
periodogram of the mean is held against that of white noise, Exp(1): a smooth excess at low frequency (torques that are
missing), a narrow line or band (a resonance, a hum), or an event in time.

What repeats do not share is the laboratory's, not the model's. Trials are what is independent, so the mean is held
against what the repeats do differ by, where that is more than the noise, at the frequencies where it is, and at all
of them where the sensors of one case and configuration were noisier than those of the others; a trial without repeats
among others that have some, against its own fast readings, for its noise need not be theirs. Lines that keep no phase
from trial to trial drop out of the mean and are looked for in the single records: above the frequencies of the rig's
own motion, which differs from trial to trial with whatever scatters, and in more than one record. A trial that
differs from its repeats by more than anything that scatters accounts for is reported by its name (`unlike`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.special import gammaincc

from bayes_damper.calibration import Calibration, Experiment
from bayes_damper.calibration.experiment import repeats_by_reading
from bayes_damper.calibration.unknowns import Coordinate
from bayes_damper.priors.distributions import LogNormal, LogStudent, from_standard

Array = NDArray[np.float64]

# Frequencies are those of the primary on its spring, times:
CORNERS = (1.8, 4.8, 12.0, 30.0)  # of the generic spectra tried
LOW_BAND = 12.0  # torques that act on inertias show below
BAND_WIDTH = 0.6  # of the bands of the omnibus test
STRENGTHS = np.geomspace(0.05, 3e4, 28)
ALONE_FROM = 3.0  # lines of single records count above it
SMOOTHED = 60.0  # degrees of freedom over which what repeats do not share is averaged
UNLIKE_BY, UNLIKE_SURE = 0.2, 6.0  # of the noise's power, and in standard deviations: a trial unlike its repeats


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
    """Trials of the fit in sets of repeats that were read at the same instants."""
    return repeats_by_reading(fit.problem.experiment, fit.problem.trials)


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


def odd_shapes(fit: Calibration) -> float:
    """Nats by which the shapes that a fit gives its effects speak for something else that the effects imitate.

    Lognormal priors of parameters of shape say what such effects are like: the damping ratio of a filter, the speed
    over which friction falls. What only imitates an effect may have them far away, with the tails of a `LogStudent` of
    the same median and factor. Only what lies far out counts: three factors as 1.5 nats, ten as 40.
    """
    return sum(oddness(c, z) for c, z in zip(fit.problem.coordinates, fit.q, strict=True))


def oddness(c: Coordinate, z: float) -> float:
    """The same of one coordinate; 0 if it is no parameter of shape."""
    if not c.shape or not isinstance(c.prior, LogNormal):
        return 0.0
    x, imitated = from_standard(c.prior, z), LogStudent(c.prior.median_value, c.prior.factor)
    return max(float(imitated.logpdf(x) - c.prior.logpdf(x)), 0.0)


def remainder_of(fit: Calibration) -> Remainder:
    """Tests of what a fit leaves."""
    records = whitened_records(fit)
    known = {i: b.group.weight[k] > 0.0 for b in fit.linear.blocks for k, i in enumerate(b.group.trials)}
    own = own_frequency(fit.problem.experiment)
    power: list[tuple[Array, Array]] = []
    shared: list[tuple[Array, Array]] = []
    by_itself: list[bool] = []
    unshared: list[tuple[Array, Array]] = []
    for members in repeats_of(fit):
        stack = np.array([records[i] for i in members])
        mean = stack.sum(axis=0) / math.sqrt(len(members))
        times = fit.problem.experiment.trials[members[0]].times
        dt = float(np.median(np.diff(times))) if times.size > 1 else 1.0
        f = np.asarray(np.fft.rfftfreq(mean.shape[1], dt)[1:-1], float)
        for channel in range(mean.shape[0]):
            # Missing readings bring no power: without them a gap would drown in what they should have brought.
            kept = [max(int(np.count_nonzero(known[i][channel])), 1) for i in members]
            apart = np.fft.rfft(helmert(len(members)) @ stack[:, channel])[:, 1:-1]
            differ = np.abs(apart) ** 2 / np.mean(kept)
            noisier = _broad_level(differ.ravel())
            shared.append((f, np.abs(np.fft.rfft(mean[channel])[1:-1]) ** 2 / (np.mean(kept) * noisier)))
            by_itself.append(len(members) == 1)
            for k in range(len(members)):
                power.append((f, np.abs(np.fft.rfft(stack[k, channel])[1:-1]) ** 2 / kept[k]))
            unshared += [(f, p / noisier) for p in differ]
    if not shared or shared[0][0].size < 8:
        return Remainder(0.0, 0.0, 0.0, 0.0, 1.0, fit.excess, own)
    floors = _floors(unshared)
    shared = [
        (f, p / (_own_floor(f, p, own) if unshared and no_other else floors.get(f.tobytes(), 1.0)))
        for (f, p), no_other in zip(shared, by_itself, strict=True)
    ]
    generic, level, corner = _generic(shared, own)
    # A peak of a smooth excess is no line: what the smooth spectrum explains is taken out first.
    smooth = level if generic > 0.0 else 0.0
    line, peak = _lines([(f, p / (1.0 + smooth * _shape(f, corner))) for f, p in shared], own)
    alone = [(f, p / (1.0 + smooth * _shape(f, corner))) for f, p in power]
    if unshared:
        single, single_peak = _lines(_of_several([(f, np.where(f > ALONE_FROM * own, p, 0.0)) for f, p in alone]), own)
    else:
        single, single_peak = _lines(alone, own)
    if single > line:
        line, peak = single, single_peak
    low = float(sum(np.sum(p[f < LOW_BAND * own] - 1.0) for f, p in shared))
    count = sum(int(np.sum(f < LOW_BAND * own)) for f, _ in shared)
    # Each ordinate is Exp(1); an uncertain noise level adds to the spread of the sum.
    low_sd = math.sqrt(count + (0.01 * count) ** 2)
    return Remainder(generic, line, peak, 2.0 * low + _taken_up(fit), 2.0 * low_sd, fit.excess, own)


def _taken_up(fit: Calibration) -> float:
    """Chi-square that the own values of trials take out of the mean of each set of repeats, where noise is all."""
    taken: dict[int, float] = {}
    for block in fit.linear.blocks:
        gram = block.T @ block.T.transpose(0, 2, 1)
        share = np.linalg.solve(np.eye(gram.shape[1]) + gram, gram)
        taken |= dict(zip(block.group.trials, np.trace(share, axis1=1, axis2=2), strict=True))
    return float(sum(np.mean([taken[i] for i in members]) for members in repeats_of(fit)))


def _floors(unshared: Sequence[tuple[Array, Array]]) -> dict[bytes, Array]:
    """Power of what repeats do not share over the noise where it is clearly more, else 1; by grid of frequencies."""
    rows: dict[bytes, list[Array]] = {}
    for f, p in unshared:
        rows.setdefault(f.tobytes(), []).append(p)
    out = {}
    for key, powers in rows.items():
        mean = np.mean(powers, axis=0)
        wide = min(max(1, math.ceil(SMOOTHED / (2.0 * len(powers)))) | 1, mean.size)
        level = np.convolve(mean, np.ones(wide), "same") / np.convolve(np.ones(mean.size), np.ones(wide), "same")
        sd = math.sqrt(1.0 / (wide * len(powers)))  # of a mean of so many Exp(1)
        out[key] = np.where(level > 1.0 + 2.0 * sd, level, 1.0)
    return out


def _own_floor(f: Array, p: Array, own: float) -> float:
    """Power of a single record over the noise, beyond the frequencies of torques, where it is clearly more, else 1."""
    return _broad_level(p[f > LOW_BAND * own])


def _broad_level(power: Array) -> float:
    """Level of a spectrum over the noise where it is clearly more, else 1.

    The median of Exp(1) is ln 2, with a standard deviation of 1 / sqrt(n); neither a line nor what scatters slowly
    changes it.
    """
    if power.size < SMOOTHED / 2.0:
        return 1.0
    level = float(np.median(power)) / math.log(2.0)
    return level if level > 1.0 + 2.0 / (math.log(2.0) * math.sqrt(power.size)) else 1.0


def _of_several(spectra: Sequence[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    """The spectra without, at each frequency, the strongest record of each kind: what a single trial has is its own."""
    rows: dict[bytes, list[tuple[Array, Array]]] = {}
    for f, p in spectra:
        rows.setdefault(f.tobytes(), []).append((f, p))
    out = []
    for found in rows.values():
        sorted_powers = np.sort([p for _, p in found], axis=0)
        out += [(found[0][0], p) for p in sorted_powers[: max(len(found) - 1, 1)]]
    return out


@dataclass(frozen=True)
class Unlike:
    """A trial that differs from its repeats: power of the difference over that of the noise, less 1."""

    trial: int
    excess: float


def unlike(fit: Calibration) -> list[Unlike]:
    """Trials that differ from their repeats by more than noise and what is known to scatter, the worst first."""
    records = whitened_records(fit)
    out = []
    for members in repeats_of(fit):
        if len(members) < 2:
            continue
        stack = np.array([records[i] for i in members])
        deviation = (stack - stack.mean(axis=0)) * math.sqrt(len(members) / (len(members) - 1.0))
        for i, d in zip(members, deviation, strict=True):
            n = max(int(np.count_nonzero(d)), 1)
            excess = float(np.sum(d**2)) / n - 1.0
            if excess > UNLIKE_BY and excess > UNLIKE_SURE * math.sqrt(2.0 / n):
                out.append(Unlike(i, excess))
    return sorted(out, key=lambda u: -u.excess)


def unlike_in_words(fit: Calibration) -> list[str]:
    """A sentence for each set of repeats that differ, naming the trials."""
    found = unlike(fit)
    trials = fit.problem.experiment.trials
    out = []
    for members in repeats_of(fit):
        odd = [u for u in found if u.trial in members]
        if odd and (len(odd) > 1 or len(members) > 2):
            names = ", ".join(trials[u.trial].label for u in odd)
            differ = "differ" if len(odd) > 1 else "differs"
            others = "each other" if len(odd) == len(members) else "the repeats"
            out.append(
                f"{names}: {differ} from {others} by up to {math.sqrt(odd[0].excess):.2g} times the noise, more than "
                "the known scatter. Repeats do not share this difference, so it comes from how single trials were run; "
                "no cause is named for it."
            )
    return out


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
            with np.errstate(divide="ignore"):
                minus_log_p = -np.log(gammaincc(len(rows) * width, band))
            k = int(np.argmax(minus_log_p))
            if minus_log_p[k] > best:
                best, where = float(minus_log_p[k]), float(f[k * width : (k + 1) * width].mean())
    return min(best, 1e6) - math.log(max(looks, 1)), where
