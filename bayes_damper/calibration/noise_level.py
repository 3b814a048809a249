"""The noise of the sensors learnt from a fit: its level and its colour, from what repeats do not share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_damper.calibration.experiment import lone, repeats
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.least_squares import Calibration
from bayes_damper.calibration.noise import Noise, fast_level, rounding

Array = NDArray[np.float64]
STEADY = 4.0  # steps of a clock, longest over shortest but for a tenth, up to which correlation is counted in readings
TRUSTED = 0.9  # weight of a reading from which it shows the noise
LEAST_LINES = 50.0  # independent ones of the spectra of all trials, from which colour stands out from chance
CHANCE = 3.0  # standard deviations by which what is left may exceed the sensors' noise by chance
WHITE_ENOUGH = 1.3  # largest ratio of residuals without repeats to the noise of the sensors up to which they are noise


def _rounding_alike(fit: Calibration, channel: int) -> float:
    """How much more the mean of repeats errs by rounding, as variance, than if each of them were rounded at random.

    Repeats released from nearly the same angle pass each step at nearly the same instants, so that their errors of
    rounding are nearly the same; differences of repeats do not show them, and what repeats share looks like a gap.
    The errors are those that the model's own motion would have, read from the same zero in all of them; 1 for
    independent ones, n for n repeats alike.
    """
    problem = fit.problem
    step = problem.experiment.rounding_step(channel)
    simulated = fit.simulated()
    alike = alone = 0.0
    for group in problem.groups:
        if channel >= group.y.shape[1]:
            continue
        for members in repeats([problem.experiment.trials[i] for i in group.trials]):
            known = (group.weight[members, channel] > 0.0).any(axis=0)
            y = np.array([simulated[group.trials[k]][channel] for k in members])[:, known] / step
            error = y - np.round(y)
            alike += float(np.sum(error.sum(axis=0) ** 2))
            alone += float(np.sum(error**2))
    return max(1.0, alike / alone) if alone > 0.0 else 1.0


def error_level(residuals: Sequence[Array]) -> float:
    """Level, as of white noise, at which residuals with correlated errors carry the information that they do carry.

    Half of sum P^2 / sum P over the lines P of the periodograms: the variance times the sum of all squared
    autocorrelations (Bayley and Hammersley, 1946, J. R. Stat. Soc. Suppl. 8, 184: n readings say as much of a variance
    as n over that sum independent ones do). For white residuals it is their standard deviation.
    """
    lines = [np.abs(np.fft.rfft(r - r.mean())[1:-1]) ** 2 / r.size for r in residuals if r.size > 8]
    if not lines:
        return 0.0
    power = np.concatenate(lines)
    total = float(power.sum())
    return math.sqrt(0.5 * float(power @ power) / total) if total > 0.0 else 0.0


def _white_enough(readings: int, sds: float = 1.0) -> float:
    """Ratio of `error_level` to the noise of the sensors up to which nothing speaks for correlated errors.

    sds : standard deviations of that ratio: from n readings the former is known to sqrt(1 / n), the latter, from a
    median of differences, to sqrt(2 / n). One for the noise of a fit: white noise that exceeds it loses some per cent
    of sharpness; colour taken for white noise would be taken for a gap.
    """
    return min(1.0 + sds * math.sqrt(3.0 / max(readings, 1)), WHITE_ENOUGH)


def noise_alone(noise: Noise, readings: int) -> bool:
    """Whether a fit that shows this noise leaves no more than the noise of the sensors, as far as readings tell."""
    sensor = noise.sensor or noise.total
    return all(x < _white_enough(readings, CHANCE) * s for x, s in zip(noise.total, sensor, strict=True))


def learn_noise(fit: Calibration) -> Noise:
    """Noise of each channel from what the repeats do not share; without repeats, from the residuals.

    What the repeats share is the model's fault, not noise: it drops out of the differences. Colour is only claimed
    where it raises the likelihood by more than 3 nats. Without repeats the residuals' fast content is the noise of the
    sensors, and nothing separates the rest from a model that is wrong in a way that would repeat. Posteriors and
    evidences must allow for that error, so the noise is then white at the `error_level` of the residuals.

    A channel that errs by its rounding alone has at least the noise of that, as far as repeats share it.
    """
    noise = _unshared_noise(fit)
    least = _rounding_floors(fit)
    noise = _not_below(noise, least)
    problem = fit.problem
    if not lone(problem.experiment, problem.trials):
        return noise
    found = fit.residuals()
    weights = trust_of(problem.groups)
    levels, sensors, white = [], [], []
    for c, total in enumerate(noise.total):
        kept = {i: _trusted(weights[i][c]) for i, r in found.items() if c < r.shape[0]}
        used = [found[i][c][mask] for i, mask in kept.items()]
        # Lines leak from a large slow error into the fast ones of a short record; differences do not.
        fast = fast_level(used, readings=[problem.experiment.trials[i].y[c][mask] for i, mask in kept.items()])
        sensors.append(max(min(fast, total) if fast > 0.0 else total, least[c]))
        levels.append(max(sensors[-1], error_level(used)))
        white.append(levels[-1] < _white_enough(sum(r.size for r in used)) * sensors[-1])
    if all(white):
        return noise
    zero = (0.0,) * len(levels)
    return Noise(tuple(levels), zero, zero, sensor=tuple(sensors))


def _trusted(weights: Array) -> NDArray[np.bool_]:
    """Readings of a record that the fit trusts; all that it uses at all, where those are not half of them.

    Those within a release or an event, which no formula gives exactly, err by more than noise.
    """
    trusted, used = weights > TRUSTED, weights > 0.0
    return trusted if 2 * np.count_nonzero(trusted) > np.count_nonzero(used) else used


def _rounding_floors(fit: Calibration) -> list[float]:
    """Least noise of each channel, (channels,): 0 where it errs by more than its rounding."""
    floors = [rounding(fit.problem.experiment, c) for c in range(len(fit.problem.noise.innovation))]
    return [sd * math.sqrt(_rounding_alike(fit, c)) if sd > 0.0 else 0.0 for c, sd in enumerate(floors)]


def _not_below(noise: Noise, least: Sequence[float]) -> Noise:
    """The noise with white noise of the least level where a channel has less."""
    innovation, phi, theta = list(noise.innovation), list(noise.phi), list(noise.theta)
    for c, (total, floor) in enumerate(zip(noise.total, least, strict=True)):
        if total < floor:
            innovation[c], phi[c], theta[c] = floor, 0.0, 0.0
    return Noise(tuple(innovation), tuple(phi), tuple(theta))


def _unshared_noise(fit: Calibration) -> Noise:
    problem = fit.problem
    e = problem.experiment
    residuals = fit.residuals()
    channels = len(problem.noise.innovation)
    sets: dict[tuple[Any, ...], list[int]] = {}
    for i in problem.trials:
        t = e.trials[i]
        sets.setdefault(t.conditions, []).append(i)
    weights = trust_of(problem.groups)
    innovation: list[float] = []
    phis: list[float] = []
    thetas: list[float] = []
    for c in range(channels):
        spectra: dict[int, list[Array]] = {}
        counts: dict[int, float] = {}
        lone: dict[int, list[Array]] = {}
        for members in sets.values():
            usable = [i for i in members if c < residuals[i].shape[0] and weights[i][c].max(initial=0.0) > TRUSTED]
            lengths = {residuals[i].shape[1] for i in usable}
            if not usable:
                continue
            stack = [np.nan_to_num(residuals[i][c]) for i in usable]
            if len(usable) > 1 and len(lengths) == 1:
                deviation = np.array(stack) - np.mean(stack, axis=0)
                keep = np.min([weights[i][c] for i in usable], axis=0) > TRUSTED
                deviation = deviation[:, keep] * math.sqrt(len(usable) / (len(usable) - 1.0))
                for d in deviation:
                    power = np.abs(np.fft.rfft(d)) ** 2 / d.size
                    spectra.setdefault(d.size, []).append(power[1:])
                    counts[d.size] = counts.get(d.size, 0.0) + (len(usable) - 1.0) / len(usable)
            else:
                for i, d in zip(usable, stack, strict=True):
                    keep = _trusted(weights[i][c])
                    power = np.abs(np.fft.rfft(np.where(keep, d, 0.0))) ** 2 / max(np.count_nonzero(keep), 1)
                    lone.setdefault(d.size, []).append(power[power.size // 3 :])
        if spectra and sum(len(v) for v in spectra.values()) > 1:
            a, p, theta = _fit_spectrum(spectra, counts, all(_steady(e.trials[i].times) for i in problem.trials))
        elif lone:
            values = np.concatenate([x for v in lone.values() for x in v])
            a, p, theta = math.sqrt(float(np.mean(np.minimum(values, 12.0 * np.median(values))))), 0.0, 0.0
        else:
            a, p, theta = problem.noise.innovation[c], 0.0, 0.0
        innovation.append(max(a, 1e-300))
        phis.append(p)
        thetas.append(theta)
    return Noise(tuple(innovation), tuple(phis), tuple(thetas))


def evenly_sampled(times: Array) -> bool:
    """Whether the samples are evenly spaced, to 2 %."""
    gaps = np.diff(times)
    return bool(gaps.size > 0 and gaps.max() < 1.02 * gaps.min() + 1e-12)


def _steady(times: Array) -> bool:
    """Whether a reading is about one step of the clock: most steps within a factor of four of one another.

    Correlation is counted in readings. On a clock that jitters or slows down it differs from step to step, and the
    average is what the noise is given; to take it for white would call every slow error of a sensor a gap.
    """
    low, high = np.quantile(np.diff(times), (0.05, 0.95)) if times.size > 2 else (0.0, 0.0)
    return bool(0.0 < high <= STEADY * low)


def _fit_spectrum(
    spectra: Mapping[int, list[Array]], counts: Mapping[int, float], colour: bool
) -> tuple[float, float, float]:
    """Whittle fit of a white plus an AR(1) process: sd of the innovations, phi, theta of the ARMA(1, 1) they form."""
    omega, power, count = spectrum_bins(spectra, counts)
    white = float(np.sum(count * power) / np.sum(count))
    if not colour or float(np.sum(count)) < LEAST_LINES:
        return math.sqrt(white), 0.0, 0.0
    return whittle(omega, power, count)


def spectrum_bins(spectra: Mapping[int, list[Array]], counts: Mapping[int, float]) -> tuple[Array, Array, Array]:
    """Angular frequency, mean power and count of every bin of spectra by record length (without their mean)."""
    bins = []
    for n, powers in spectra.items():
        mean = np.mean(powers, axis=0)
        omega = 2.0 * np.pi * np.arange(1, mean.size + 1) / n
        bins.append((omega[:-1], mean[:-1], counts[n]))
    omega = np.concatenate([b[0] for b in bins])
    power = np.concatenate([b[1] for b in bins])
    count = np.concatenate([np.full(b[0].size, b[2]) for b in bins])
    return omega, power, count


def whittle(
    omega: Array, power: Array, count: Array, farthest: float = 0.99, starts: Sequence[float] = (2.0,)
) -> tuple[float, float, float]:
    """Whittle fit of a white plus an AR(1) process to power at omega: innovation, phi, theta of their ARMA(1, 1).

    White where colour raises the likelihood by less than 3 nats. farthest : largest phi; starts : logits of phi.
    """
    white = float(np.sum(count * power) / np.sum(count))

    def minus_log(x: Array) -> float:
        a, b, phi = math.exp(x[0]), math.exp(x[1]), farthest / (1.0 + math.exp(-x[2]))
        s = a + b / (1.0 + phi * phi - 2.0 * phi * np.cos(omega))
        return float(np.sum(count * (np.log(s) + power / s)))

    flat = float(np.sum(count * (math.log(white) + power / white)))
    begun = [np.array([math.log(0.8 * white), math.log(0.04 * white), x]) for x in starts]
    options = {"maxiter": 400, "xatol": 1e-3, "fatol": 1e-3}
    tried = [minimize(minus_log, start, method="Nelder-Mead", options=options) for start in begun]
    found = min(tried, key=lambda t: float(t.fun))
    if flat - float(found.fun) < 3.0:
        return math.sqrt(white), 0.0, 0.0
    a, b, phi = math.exp(found.x[0]), math.exp(found.x[1]), farthest / (1.0 + math.exp(-found.x[2]))
    # a |1 - phi z|^2 + b = s^2 |1 - theta z|^2; a may be next to nothing, where all of the spectrum is steep
    both = a * (1.0 + phi * phi) + b
    square = 0.5 * (both + math.sqrt(max(both * both - (2.0 * a * phi) ** 2, 0.0)))
    return math.sqrt(square), phi, a * phi / square
