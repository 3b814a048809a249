"""Which noise a fit works with: chosen by the data or by the user, and held against two floors.

Three figures are compared for each channel: what repeats of one trial do not share, the fast content of the readings
(no motion of the rig is that fast), and what the fit leaves. Where the fit leaves clearly more than the repeats differ
by, the model misses something; with the repeats' noise alone the posterior would be far too narrow. Then the noise is
learnt from what is left. All n repeats of a set show the same misfit, so for the parameters that they share it does not
average out: with d the misfit and e the noise, the mean of the repeats has covariance K_d + K_e / n. Giving each repeat
the covariance K_e + n K_d, independently, has the same effect, and sqrt(n) times the mean residual is a sample of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.optimize import minimize
from scipy.special import gammaln

from bayes_damper.calibration import (
    Calibration,
    Experiment,
    Group,
    Noise,
    calibrate,
    calibrate_nominal,
    default_starts,
    drawn_starts,
    evenly_sampled,
    learn_noise,
    rough_noise,
    spectrum_bins,
    summarise,
    whittle,
)
from bayes_damper.calibration.experiment import lone, repeats_by_reading
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.noise import rounding
from bayes_damper.calibration.noise_level import TRUSTED
from bayes_damper.runs.contents.fit import ChannelEntry, NoiseEntry

Array = NDArray[np.float64]
Kind = Literal["gaussian", "student", "ar"]
KINDS = ("auto", "gaussian", "student", "ar")
CLEARLY = 8.0  # nats by which another noise has to describe the residuals better
SURELY = 12.0  # the same where the residuals have no more power than that noise: a colour alone
STANDARD_ERRORS = 3.0  # by which they have more
REPORTED_CORRELATION = 0.05  # of neighbouring residuals from which it is reported
APART = 1.5  # times the residual power of its repeats from which a trial is unlike them
SURE = 8.0  # standard errors by which it must be so
CUT = 4.0  # innovations beyond which a reading counts no further where noise is learnt
RESTARTED = 300.0  # by which the cost of a start may exceed another's after its first stage
ROUNDED = 1.2  # times its standard deviation up to which what is left of a channel is its rounding
ORDERS = (4, 8, 16, 32)  # of autoregressions tried where something is left


@dataclass(frozen=True)
class ChannelNoise:
    """Figures of one channel, in the unit of its readings: None where there are no repeats.

    repeats : sd of what repeats do not share; fast : sd of the fast content; left : rms of the residuals; correlation :
    of neighbouring residuals; used : sd of the noise that the fit works with; widened : what is left exceeds the noise,
    which is learnt from it.
    """

    repeats: float | None
    fast: float
    left: float
    correlation: float
    used: float
    widened: bool


@dataclass(frozen=True)
class Unlike:
    """A trial that its repeats do not resemble: power, its mean square residual over theirs; alone: it has a single
    repeat, so that either of the two may be the odd one.
    """

    trial: int
    power: float
    alone: bool


@dataclass(frozen=True, eq=False)
class FittedNoise:
    """A best fit with the noise it was made under.

    kind : gaussian (white), ar (correlated) or student; freedom : best degrees of freedom of Student's t, inf if not
    that; power : mean square innovation of each channel at the best fit, 1 for a noise that describes each trial;
    unlike : trials unlike their repeats, which count with the weight that their own residuals deserve.
    """

    fit: Calibration
    kind: Kind
    chosen: bool
    channels: tuple[ChannelNoise, ...]
    freedom: float
    power: tuple[float, ...]
    unlike: tuple[Unlike, ...] = ()

    def to_json(self, unit: str) -> NoiseEntry:
        """The entry `noise` of summary.json."""
        rows: list[ChannelEntry] = []
        asked = self.kind == "ar" and not self.chosen
        for number, c in enumerate(self.channels, 1):
            floor = c.repeats or c.fast
            known = "repeats" if c.repeats else "fast content"
            rows.append(
                {
                    "channel": number,
                    "unit": unit,
                    "repeats": c.repeats,
                    "fast_content": c.fast,
                    "left": c.left,
                    "left_over_floor": c.left / floor if floor > 0.0 else None,
                    "correlation": c.correlation,
                    "used": c.used,
                    "learnt_from": "residuals" if c.widened else "residuals, as asked" if asked else known,
                }
            )
        return {
            "model": self.kind,
            "chosen_by": "data" if self.chosen else "user",
            "freedom": self.freedom if math.isfinite(self.freedom) else None,
            "channels": rows,
        }

    def sentences(self, unit: str) -> list[str]:
        """What a reader of the results has to know about the noise."""
        out = []
        for number, c in enumerate(self.channels, 1):
            floor = c.repeats or c.fast
            source = "repeats differ by" if c.repeats else "the fast content is"
            if c.widened and self.chosen:
                cause = (
                    "the model misses something" if c.repeats else "the model misses something, or the noise is slow"
                )
                shown = (
                    f"residuals are correlated by {c.correlation:.2f} from reading to reading"
                    if abs(c.correlation) >= REPORTED_CORRELATION
                    else "residuals have more slow content than white noise"
                )
                out.append(
                    f"Channel {number}: the residual is {c.left:.3g} {unit}, but {source} only {floor:.3g}; {shown}: "
                    f"{cause}. The noise was estimated from the residuals, which widens all intervals; `diagnose` "
                    "looks for the cause."
                )
        if self.kind == "student":
            out.append(
                f"The residuals have outliers: Student's t noise with about {self.freedom:.2g} degrees of freedom."
            )
        return out


def fit_with_noise(
    experiment: Experiment,
    kind: str = "auto",
    report: Callable[[str], None] = lambda _: None,
    begin: Calibration | None = None,
    on_excess: Callable[[bool], None] = lambda _: None,
) -> FittedNoise:
    """The best fit under the noise asked for: "gaussian" (white), "student", "ar" or "auto".

    report : called with each stage; begin : a fit to begin with, of a model with an effect for example; default the
    nominal model's; on_excess : called as soon as the fit is known to leave more than the noise, with whether repeats
    show that noise.
    """
    first = calibrate_nominal(experiment) if begin is None else begin
    if sensor := first.problem.noise.sensor:
        # What the model leaves is separated from the noise of the sensors below, with its colour.
        first = _again(first, Noise(sensor, (0.0,) * len(sensor), (0.0,) * len(sensor)))
    fit, unlike = _own_weights(first)
    repeats = _repeats(fit)
    if kind == "gaussian":
        report("white noise")
        fit = _again(fit, _white(fit))
        none = [False] * len(repeats)
        return _described(fit, "gaussian", False, repeats, none, math.inf, unlike, none, sensor)
    freedom, gain = _tails(fit)
    heavy = kind == "student" or (kind == "auto" and gain > CLEARLY)
    if heavy:
        report("outliers found: reducing their weight")
        fit = _robust(fit, freedom)
        freedom, _ = _tails(fit)
    wide = exceeded = [False] * len(repeats)
    if kind in ("auto", "ar"):
        learnt, exceeded = _learn_from_what_is_left(fit, always=False)
        wide, exceeded = exceeded, [e and not _rounded(fit, c) for c, e in enumerate(exceeded)]
        if kind == "ar":
            learnt, wide = _learn_from_what_is_left(fit, always=True)
        if any(wide):
            if any(exceeded):
                on_excess(any(r is not None for r, e in zip(repeats, exceeded, strict=True) if e))
            report("estimating the noise from the residuals")
            for _ in range(2):
                fit = _anew(fit, learnt)
                learnt, _ = _learn_from_what_is_left(fit, always=True, only=wide)
            fit = _again(fit, learnt)
    chosen: Kind = "ar" if any(wide) or kind == "ar" else "student" if heavy else "gaussian"
    if chosen == "gaussian" and any(p != 0.0 for p in fit.problem.noise.phi):
        chosen = "ar"
    freedom = freedom if chosen == "student" else math.inf
    return _described(fit, chosen, kind == "auto", repeats, wide, freedom, unlike, exceeded, sensor)


def _rounded(fit: Calibration, channel: int) -> bool:
    """Whether a channel that errs by its rounding alone leaves no more: correlated, where the motion is slow."""
    sd = rounding(fit.problem.experiment, channel)
    if sd == 0.0:
        return False
    left = [r[channel] for r in fit.residuals().values() if channel < len(r)]
    return math.sqrt(float(np.nanmean(np.square(np.concatenate(left))))) < ROUNDED * sd


# Trials unlike their repeats ----------------------------------------------------------------------------------------


def _own_weights(fit: Calibration, rounds: int = 2) -> tuple[Calibration, tuple[Unlike, ...]]:
    """The fit with trials unlike their repeats weighed by their own residuals, and which those are."""
    found: tuple[Unlike, ...] = ()
    for _ in range(rounds):
        found = unlike_repeats(fit)
        if not found:
            return fit, ()
        problem = fit.problem
        wanted = {u.trial: 1.0 / math.sqrt(u.power) for u in found}
        known = problem.factors
        change = {i: np.asarray(wanted.get(i, 1.0) / known.get(i, 1.0)) for i in {*wanted, *known}}
        fit = calibrate(problem.reweighted(change), [fit.q], eta=fit.eta, anneal=False)
        fit = _again(fit, learn_noise(fit))
    return fit, found


def unlike_repeats(fit: Calibration) -> tuple[Unlike, ...]:
    """Trials whose residuals are clearly larger than those of the repeats of the same case and configuration."""
    experiment = fit.problem.experiment
    known = fit.problem.factors
    powers = {i: p / float(np.mean(np.square(known.get(i, 1.0)))) for i, p in trial_powers(fit).items()}
    sets: dict[tuple[Any, ...], list[int]] = {}
    for i in fit.problem.trials:
        t = experiment.trials[i]
        sets.setdefault(t.conditions, []).append(i)
    found = []
    for members in sets.values():
        left = list(members)
        # At most half of a set can be odd.
        for _ in range(max(1, (len(members) - 1) // 2)):
            if len(left) < 2:
                break
            worst = max(left, key=lambda i: powers[i])
            middle = float(np.median([powers[i] for i in left if i != worst]))
            readings = int(np.isfinite(experiment.trials[worst].y).sum())
            ratio = powers[worst] / max(middle, 1e-300)
            # Residuals of a misfit are correlated: their power is known less well than that of white noise.
            error = math.sqrt(2.0 * max(powers[worst], 1.0) / max(readings, 1) * (1.0 + 1.0 / (len(left) - 1)))
            if ratio < APART or ratio - 1.0 < SURE * error:
                break
            found.append(Unlike(worst, ratio, len(members) == 2))
            left.remove(worst)
    return tuple(found)


def _described(
    fit: Calibration,
    kind: Kind,
    chosen: bool,
    repeats: Sequence[float | None],
    wide: Sequence[bool],
    freedom: float,
    unlike: tuple[Unlike, ...],
    exceeded: Sequence[bool],
    sensor: Sequence[float],
) -> FittedNoise:
    problem = fit.problem
    fast = sensor or rough_noise(problem.experiment, problem.trials).total
    residuals, trust = fit.residuals(), trust_of(problem.groups)
    channels = []
    for c, used in enumerate(problem.noise.total):
        values, products = [], []
        for i, r in residuals.items():
            if c < r.shape[0]:
                x = np.where(trust[i][c] > TRUSTED, r[c], np.nan)
                values.append(x[np.isfinite(x)])
                both = x[1:] * x[:-1]
                products.append(both[np.isfinite(both)])
        x = np.concatenate(values) if values else np.zeros(1)
        square = float(np.mean(x**2)) if x.size else 0.0
        lagged = float(np.mean(np.concatenate(products))) if products and sum(p.size for p in products) else 0.0
        # Without repeats the first noise has been learnt from what is left already.
        learnt = exceeded[c] or (repeats[c] is None and square > (1.5 * fast[c]) ** 2)
        correlation = lagged / square if square else 0.0
        channels.append(ChannelNoise(repeats[c], fast[c], math.sqrt(square), correlation, used, learnt))
    power = tuple(p if w else 1.0 for p, w in zip(_power(fit), wide, strict=True))
    return FittedNoise(fit, kind, chosen, tuple(channels), freedom, power, unlike)


def _again(fit: Calibration, noise: Noise) -> Calibration:
    """The fit under another noise, from where it is."""
    return calibrate(fit.problem.with_noise(noise), [fit.q], eta=fit.eta, anneal=False)


def _innovations(fit: Calibration) -> list[Array]:
    """Whitened residuals of the readings that count, by channel; trials unlike their repeats left out."""
    found: list[list[Array]] = [[] for _ in fit.problem.noise.total]
    for block in fit.linear.blocks:
        weight = block.group.weight * _like(fit, block.group)[:, None, None]
        r = block.r.reshape(weight.shape)
        for c in range(weight.shape[1]):
            found[c].append(r[:, c][weight[:, c] > 0.0])
    return [np.concatenate(parts) if parts else np.zeros(0) for parts in found]


def _like(fit: Calibration, group: Group) -> Array:
    """1 for the trials of a group that count fully, 0 for those unlike their repeats."""
    return np.array([float(i not in fit.problem.factors) for i in group.trials])


def _power(fit: Calibration) -> list[float]:
    counts = np.zeros(len(fit.problem.noise.total))
    for group in fit.problem.groups:
        trust = group.trust * _like(fit, group)[:, None, None]
        counts[: trust.shape[1]] += np.sum(trust**2, axis=(0, 2))
    return [
        float(np.sum(x**2)) / max(n, 1.0) if x.size else 1.0 for x, n in zip(_innovations(fit), counts, strict=True)
    ]


def _repeats(fit: Calibration) -> list[float | None]:
    """Sd of each channel's noise from repeats, None where there are none."""
    experiment = fit.problem.experiment
    if lone(experiment, fit.problem.trials):
        return [None] * len(fit.problem.noise.total)
    sets: dict[tuple[Any, ...], int] = {}
    for i in fit.problem.trials:
        t = experiment.trials[i]
        key = t.conditions_and_length
        sets[key] = sets.get(key, 0) + 1
    total = learn_noise(fit).total
    known = [any(n > 1 and (coupled or c == 0) for (_, coupled, *_), n in sets.items()) for c in range(len(total))]
    return [sd if yes else None for sd, yes in zip(total, known, strict=True)]


def _white(fit: Calibration) -> Noise:
    """White noise of the size that the fit leaves."""
    noise = fit.problem.noise
    channels = range(len(noise.total))
    flat = Noise(noise.total, tuple(0.0 for _ in channels), tuple(0.0 for _ in channels))
    left = [math.sqrt(p) for p in _power(_again(fit, flat))]
    return replace(flat, innovation=tuple(s * x for s, x in zip(noise.total, left, strict=True)))


def _anew(fit: Calibration, noise: Noise) -> Calibration:
    """The fit under a noise of another kind: where the best valley under the one before may be another one."""
    found = _again(fit, noise)
    starts = [*default_starts(found.problem), *drawn_starts(found.problem)]
    other = calibrate(found.problem, starts, give_up=RESTARTED, target=found.cost)
    return other if other.cost < found.cost else found


# Outliers -----------------------------------------------------------------------------------------------------------


def student_log_density(w: Array, freedom: Any) -> Array:
    """Logarithm of Student's t density of w, relative to the constant 1 / sqrt(2 pi) of a Gaussian."""
    half = 0.5 * (freedom + 1.0)
    norm = gammaln(half) - gammaln(0.5 * freedom) - 0.5 * np.log(0.5 * freedom)
    return np.asarray(norm - half * np.log1p(w**2 / freedom))


def _tails(fit: Calibration) -> tuple[float, float]:
    """Best degrees of freedom of Student's t for the innovations, and nats by which it beats a Gaussian.

    Each channel has its own size under either.
    """
    channels = [x for x in _innovations(fit) if x.size > 20]
    if not channels:
        return 30.0, 0.0
    normal = sum(-0.5 * x.size * (1.0 + math.log(float(np.mean(x**2)))) for x in channels)

    def minus_log(p: Array) -> float:
        freedom = 1.5 + math.exp(min(p[0], 6.0))
        return -sum(
            float(np.sum(student_log_density(x / math.exp(s), freedom))) - x.size * float(s)
            for x, s in zip(channels, p[1:], strict=True)
        )

    size = [math.log(1.4826 * float(np.median(np.abs(x))) + 1e-12) for x in channels]
    found = minimize(minus_log, np.array([1.5, *size]), method="Nelder-Mead", options={"xatol": 1e-2, "fatol": 1e-2})
    return 1.5 + math.exp(min(float(found.x[0]), 6.0)), float(-found.fun) - normal


def _robust(fit: Calibration, freedom: float, rounds: int = 2) -> Calibration:
    """The fit with each reading weighed as Student's t does; noise, weights and derivatives are then the usual ones."""
    for _ in range(rounds):
        problem = fit.problem
        used: dict[int, Array] = {}
        for block in fit.linear.blocks:
            w = block.r.reshape(block.group.weight.shape)
            u = np.sqrt((freedom + 1.0) / (freedom + w**2))
            used |= {i: np.minimum(u[k], 1.0) for k, i in enumerate(block.group.trials)}
        weighted = problem.reweighted(used)
        lighter = calibrate(weighted, [fit.q], eta=fit.eta, anneal=False, finish=False)
        fit = summarise(problem, lighter.q, lighter.eta, lighter.converged, lighter.iterations)
    # The size of the noise without its outliers.
    scale = [1.4826 * float(np.median(np.abs(x))) if x.size else 1.0 for x in _innovations(fit)]
    noise = replace(
        fit.problem.noise, innovation=tuple(s * x for s, x in zip(fit.problem.noise.innovation, scale, strict=True))
    )
    return summarise(fit.problem.with_noise(noise), fit.q, fit.eta, fit.converged, fit.iterations)


# What the fit leaves ------------------------------------------------------------------------------------------------


def _learn_from_what_is_left(
    fit: Calibration, always: bool, only: Sequence[bool] | None = None
) -> tuple[Noise, list[bool]]:
    """Noise that describes sqrt(n) times the mean residual of n repeats, for the channels where it must.

    always : for every channel (or those of `only`), even if the present noise would do.
    """
    problem = fit.problem
    noise = problem.noise
    innovation, phi, theta = list(noise.innovation), list(noise.phi), list(noise.theta)
    longer = list(noise.longer or ((),) * len(innovation))
    even = all(evenly_sampled(problem.experiment.trials[i].times) for i in problem.trials)
    repeats = max(len(members) for members in repeats_by_reading(problem.experiment, problem.trials))
    changed = []
    for c in range(len(innovation)):
        series = _mean_residuals(fit, c)
        if not series or (only is not None and not only[c]):
            changed.append(False)
            continue
        if even:
            new, gain = _spectral(series, noise, c)
        else:
            new, gain = _uneven([x for x, _ in series], noise.total[c])
        least = CLEARLY if _beyond(series, noise.total[c], repeats) > STANDARD_ERRORS else SURELY
        if not always and gain < least:
            changed.append(False)
            continue
        innovation[c], phi[c], theta[c], longer[c] = new
        changed.append(True)
    found = Noise(tuple(innovation), tuple(phi), tuple(theta), tuple(longer) if any(longer) else ())
    return found, changed


def _beyond(series: Sequence[tuple[Array, Array]], noise: float, repeats: int) -> float:
    """By how many standard errors the mean residuals of sets of repeats have more power than their noise, inf alone.

    What repeats differ by shows the noise with an error of its own.
    """
    if repeats < 2:
        return math.inf
    known = np.concatenate([x[x != 0.0] for x, _ in series])
    error = math.sqrt((1.0 + 1.0 / (repeats - 1)) / (2.0 * known.size))
    return (math.sqrt(float(np.mean(known**2))) / noise - 1.0) / error


def _mean_residuals(fit: Calibration, channel: int) -> list[tuple[Array, Array]]:
    """sqrt(n) times the mean residual over each set of n repeats, outliers cut, (n_times,) each.

    With it the share of its power at each frequency that the fitted unknowns have left there.
    """
    problem = fit.problem
    total = problem.noise.total
    residuals, weights = fit.residuals(), trust_of(problem.groups)
    free = _left_free(fit, channel)
    out = []
    for members in repeats_by_reading(problem.experiment, problem.trials):
        members = [i for i in members if channel < len(weights[i]) and weights[i][channel].max() > TRUSTED]  # noqa: PLW2901
        if not members:
            continue
        stack = np.array([np.nan_to_num(residuals[i][channel]) for i in members])
        keep = np.min([weights[i][channel] for i in members], axis=0) > TRUSTED
        if keep.sum() < 60:
            continue
        # Of three repeats or more the middle one shows what they share; else what is usual over time must do.
        centre = np.median(stack, axis=0) if len(members) > 2 else np.zeros(stack.shape[1])
        spread = 1.4826 * float(np.median(np.abs(stack - centre)[:, keep]))
        spread = max(spread, (1e-3 if len(members) > 2 else 1.0) * total[channel])
        stack = np.clip(stack, centre - CUT * spread, centre + CUT * spread)
        mean = math.sqrt(len(members)) * np.where(keep, stack.mean(axis=0), 0.0)
        out.append((mean, np.maximum(1.0 - _absorbed(free, members), 0.2)))
    return out


def _left_free(fit: Calibration, channel: int) -> dict[int, tuple[Array, Array]]:
    """What the unknowns can follow in a trial's whitened residuals of a channel: (size, n) and (m, n) of unit weight.

    Their own uncertainty times their derivatives: of the shared unknowns, with the trial's nuisances taken out, and of
    the nuisances.
    """
    root = np.linalg.cholesky(fit.covariance)
    out = {}
    for block, H, TJ, _ in fit.linear.normal().parts:
        n_times = block.group.times.size
        part = slice(channel * n_times, (channel + 1) * n_times)
        if block.r.shape[1] < part.stop:
            continue
        for k, i in enumerate(block.group.trials):
            J, T = block.J[k], block.T[k]
            if len(T):
                J = J - TJ[k].T @ np.linalg.solve(H[k], T)
                T = np.linalg.inv(np.linalg.cholesky(H[k])) @ T
            out[i] = root.T @ J[:, part], T[:, part]
    return out


def _absorbed(free: Mapping[int, tuple[Array, Array]], members: Sequence[int]) -> Array:
    """Share of white power at each frequency (without 0) that the unknowns take from the mean of some repeats."""
    n = len(members)
    shared = np.mean([free[i][0] for i in members], axis=0) * math.sqrt(n)
    size = shared.shape[1]
    power = (np.abs(np.fft.rfft(shared, axis=1)) ** 2).sum(axis=0)
    for i in members:
        power = power + (np.abs(np.fft.rfft(free[i][1], axis=1)) ** 2).sum(axis=0) / n
    return np.asarray(power[1:] / size)


_Process = tuple[float, float, float, tuple[float, ...]]


def _spectral(series: Sequence[tuple[Array, Array]], noise: Noise, channel: int) -> tuple[_Process, float]:
    """White plus AR(1), or a longer autoregression where that is clearly better; nats gained over the present noise."""
    spectra: dict[int, list[Array]] = {}
    for x, left in series:
        spectra.setdefault(x.size, []).append((np.abs(np.fft.rfft(x)) ** 2 / x.size)[1:] / left)
    omega, power, count = spectrum_bins(spectra, {n: float(len(p)) for n, p in spectra.items()})

    def height(density: Array) -> float:
        return -float(np.sum(count * (np.log(density) + power / density)))

    before = height(noise.density(channel, omega))
    s, p, t = whittle(omega, power, count, 0.999, (0.5, 2.0, 4.0))
    best: _Process = (s, p, t, ())
    score = height(Noise((s,), (p,), (t,)).density(0, omega))
    longest = min(x.size for x, _ in series)
    covariance = np.zeros(ORDERS[-1] + 1)
    for x, left in series:
        amplitudes = np.fft.rfft(x)
        amplitudes[1:] /= np.sqrt(left)
        padded = np.fft.rfft(np.fft.irfft(amplitudes, x.size), 2 * x.size)
        full = np.fft.irfft(np.abs(padded) ** 2)[: covariance.size]
        covariance[: full.size] += full / sum(y.size for y, _ in series)
    covariance[0] *= 1.0 + 1e-9
    gained = score - before
    points = float(np.sum(count))
    least = score
    for order in ORDERS:
        if 20 * order > longest:
            break
        a = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        sd = math.sqrt(max(float(covariance[0] - a @ covariance[1 : order + 1]), 1e-300))
        found = height(Noise((sd,), (0.0,), (0.0,), (tuple(a),)).density(0, omega))
        penalised = found - 0.5 * (order - 2) * math.log(points)
        if penalised > least + CLEARLY:
            best, least, gained = (sd, 0.0, 0.0, tuple(float(v) for v in a)), penalised, penalised - before
    # Less than the present noise is no gap: parameters absorb some of it.
    return best, gained if float(np.mean(power)) > float(np.mean(noise.density(channel, omega))) else 0.0


def _uneven(series: Sequence[Array], sd: float) -> tuple[_Process, float]:
    """Where sampling is uneven there are no spectra: white noise as strong as the correlated one is slowly."""
    square = float(np.mean(np.concatenate(series) ** 2))
    lagged = float(np.mean(np.concatenate([x[1:] * x[:-1] for x in series])))
    r = min(max(lagged / square, 0.0), 0.98)
    points = sum(x.size for x in series)
    gain = 0.5 * points * (square / sd**2 - 1.0 - math.log(square / sd**2)) if square > sd**2 else 0.0
    gain -= 0.5 * points * math.log1p(-(r**2)) if r > 3.0 / math.sqrt(points) else 0.0
    return (math.sqrt(square * (1.0 + r) / (1.0 - r)), 0.0, 0.0, ()), gain


def trial_powers(fit: Calibration) -> Mapping[int, float]:
    """Mean square innovation of each trial's readings."""
    out = {}
    for block in fit.linear.blocks:
        weight = block.group.weight
        r = block.r.reshape(weight.shape)
        for k, i in enumerate(block.group.trials):
            counted = weight[k] > 0.0
            out[i] = float(np.mean(r[k][counted] ** 2)) if counted.any() else 1.0
    return out
