"""Forecasts of held-out trials: the initial state inferred from their first two periods only, the rest predicted.

Inferring a trial's own state from all of its readings hides errors of frequency and damping: it fits them half away.
Here nothing later than the first two periods is used. With q the shared unknowns, eta the trial's own, J and T the
derivatives of its first whitened readings by either and H = 1 + T T', the own ones follow the shared ones by

    d eta = -H^-1 T J' dq,

so that the first periods stay explained, and are free beyond that with covariance H^-1. The spread of a forecast is
that of q as the fit left it, of eta, of the sensors' noise, and of what the same forecast misses beyond these on the
trials that were fitted, as a share of how far each swings in its first periods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from bayes_damper.calibration import Calibration, Experiment, Group, Problem, predict, unseeing
from bayes_damper.calibration.derivatives import READINGS_AT_ONCE, RELEASE_STEP
from bayes_damper.calibration.own_values import RELEASE
from bayes_damper.runs.contents.diagnosis import ForecastEntry, Forecasts, ForecastSides, TrialForecast

Array = NDArray[np.float64]

PERIODS = 2.0  # of a held-out trial, from which its own state is inferred
BANDS = (0.5, 0.9)  # shares of readings that the reported bands are to hold
LEAST_READINGS = 8  # before and after
STEP = 2e-3  # of a standard coordinate, in derivatives


@dataclass(frozen=True, eq=False)
class Forecast:
    """One trial: what a fit says of its readings after the first periods.

    trial: index in the experiment; seen_s: duration used, s; swing (channels,): standard deviation of the readings in
    it; times (n,) of the rest, s; reading, centre, sd (channels, n), in the unit of the readings; reading is nan where
    one is missing.
    """

    trial: int
    seen_s: float
    swing: Array
    times: Array
    reading: Array
    centre: Array
    sd: Array

    @property
    def miss(self) -> Array:
        """Reading minus forecast, (channels, n)."""
        return self.reading - self.centre

    def inside(self, share: float) -> NDArray[np.bool_]:
        """Which readings lie in the band that is to hold `share` of them, (channels, n); a missing one does not."""
        return np.abs(self.miss) <= 0.5 * self.width(share)

    def width(self, share: float) -> Array:
        """Of the band that is to hold `share` of the readings, (channels, n)."""
        return 2.0 * float(ndtri(0.5 + 0.5 * share)) * self.sd


@dataclass(frozen=True, eq=False)
class Averaged(Forecast):
    """One trial by several answers: centre and sd are those of the mixture, bands hold its central part.

    weights (answers,): probabilities, of sum 1; centres, sds (answers, channels, n).
    """

    weights: Array
    centres: Array
    sds: Array

    def inside(self, share: float) -> NDArray[np.bool_]:
        """Which readings lie in the central band that is to hold `share` of them, (channels, n)."""
        below = np.einsum("k,kcn->cn", self.weights, ndtr((self.reading - self.centres) / self.sds))
        return np.asarray(np.abs(below - 0.5) <= 0.5 * share)

    def width(self, share: float) -> Array:
        """Of the band that is to hold `share` of the readings, (channels, n)."""
        return self._quantile(0.5 + 0.5 * share) - self._quantile(0.5 - 0.5 * share)

    def _quantile(self, level: float) -> Array:
        """By bisection between the quantiles of the parts, (channels, n)."""
        each = self.centres + float(ndtri(level)) * self.sds
        low, high = each.min(axis=0), each.max(axis=0)
        for _ in range(50):
            middle = 0.5 * (low + high)
            below = np.einsum("k,kcn->cn", self.weights, ndtr((middle - self.centres) / self.sds)) < level
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray(0.5 * (low + high))


def averaged(parts: Sequence[tuple[float, Forecast]]) -> Averaged:
    """Forecasts of one trial by several answers, each with its probability (any positive factor), as one."""
    weights = np.array([p for p, _ in parts])
    weights = weights / weights.sum()
    first = parts[0][1]
    centres, sds = (np.array([getattr(f, name) for _, f in parts]) for name in ("centre", "sd"))
    centre = np.einsum("k,kcn->cn", weights, centres)
    variance = np.einsum("k,kcn->cn", weights, sds**2 + (centres - centre) ** 2)
    return Averaged(
        first.trial,
        first.seen_s,
        first.swing,
        first.times,
        first.reading,
        centre,
        np.sqrt(variance),
        weights,
        centres,
        sds,
    )


def summary(forecasts: Sequence[Forecast]) -> ForecastEntry:
    """Of one trial or several: rms (all readings, and each channel), share of the readings inside each band, width.

    width90 : median width of the 90 % band.
    """
    miss = [np.concatenate([f.miss[c] for f in forecasts if c < len(f.miss)]) for c in range(_channels(forecasts))]
    every = np.concatenate(miss)
    known = float(np.isfinite(every).sum())
    widths = np.concatenate([f.width(0.9).ravel() for f in forecasts])
    return {
        "rms": _rms(every),
        "rms_by_channel": [_rms(m) for m in miss],
        "coverage50": _inside(forecasts, 0.5) / known,
        "coverage90": _inside(forecasts, 0.9) / known,
        "width90": float(np.median(widths)),
    }


def _inside(forecasts: Sequence[Forecast], band: float) -> int:
    return sum(int(f.inside(band).sum()) for f in forecasts)


def forecast(fit: Calibration, trials: Sequence[int], periods: float = PERIODS) -> dict[int, Forecast]:
    """The forecasts of trials, by trial; those with too few readings before or after are left out.

    periods : of the primary (`period_of`), from which a trial's own state is inferred.
    """
    fit = unseeing(fit)
    return _ahead(fit, trials, periods, _missed(fit, periods)) if trials else {}


def forecasts(
    before: Calibration,
    after: Calibration | None,
    answers: Sequence[tuple[float, Calibration]] = (),
    periods: float = PERIODS,
) -> Forecasts:
    """Entry `forecast` of diagnosis.json: held-out trials by the nominal model and with the answer, one by one and all.

    answers : the probability of each answer and its fit; where there are several, "averaged" weighs their forecasts
    (Hoeting, Madigan, Raftery and Volinsky, 1999, Stat. Sci. 14, 382, equation 1). Beside each other forecast stands
    `rms_whole`: what is missed where a trial's state is inferred from all of its readings, as by a least-squares fit
    of that trial. Empty without a held-out trial that is long enough.
    """
    experiment = before.problem.experiment
    found = {
        name: forecast(fit, experiment.heldout, periods)
        for name, fit in (("before", before), ("after", after))
        if fit is not None
    }
    if len(answers) > 1 and found["before"]:
        known = {id(fit): found[name] for name, fit in (("before", before), ("after", after)) if fit is not None}
        each = [(p, known.get(id(fit)) or forecast(fit, experiment.heldout, periods)) for p, fit in answers]
        found["averaged"] = {i: averaged([(p, own[i]) for p, own in each]) for i in found["before"]}
    whole = {
        name: {i: experiment.trials[i].y - p.model for i, p in predict(unseeing(fit), tuple(found[name])).items()}
        for name, fit in (("before", before), ("after", after))
        if fit is not None and found[name]
    }
    rows: list[TrialForecast] = []
    for i, first in found["before"].items():
        t = experiment.trials[i]
        sides = {name: summary([those[i]]) for name, those in found.items()}
        for name in whole:
            sides[name]["rms_whole"] = _rms(whole[name][i])
        rows.append({
            "file": t.label, "case": t.case, "configuration": "coupled" if t.coupled else "uncoupled",
            "trial": t.number, "seen_s": first.seen_s, "readings": int(np.isfinite(first.reading).sum()),
            **cast("ForecastSides", sides),
        })  # fmt: skip
    if not rows:
        return {}
    together = {name: summary(list(those.values())) for name, those in found.items()}
    for name, residuals in whole.items():
        together[name]["rms_whole"] = _rms(np.concatenate([r.ravel() for r in residuals.values()]))
    return {"periods": periods, "bands": list(BANDS), **cast("ForecastSides", together), "trials": rows}


def period_of(fit: Calibration, trial: int) -> float:
    """Period in which the primary mainly swings in fitted trials like this one, s; the trial itself is not asked.

    Like it: same configuration and spring, or at least the same configuration. Without any, the period of the primary
    on its spring.
    """
    e = fit.problem.experiment
    t = e.trials[trial]
    like = [e.trials[i] for i in fit.problem.trials if e.trials[i].coupled == t.coupled]
    like = [other for other in like if other.k1t == t.k1t] or like
    found = [p for p in (_main_period(other.times, other.y[0]) for other in like) if p is not None]
    if found:
        return float(np.median(found))
    return 2.0 * math.pi * math.sqrt(e.constants["J1"][0] / e.stiffnesses[t.k1t][0])


def _main_period(times: Array, y: Array) -> float | None:
    """Period of the strongest line of a record, s; None where it is no shorter than two thirds of the record."""
    known = np.isfinite(y)
    if int(known.sum()) < LEAST_READINGS:
        return None
    grid = np.linspace(times[0], times[-1], times.size)
    even = np.interp(grid, times[known], y[known])
    size = 8 * grid.size
    power = np.abs(np.fft.rfft(even - even.mean(), size))
    frequency = np.fft.rfftfreq(size, float(grid[1] - grid[0]))
    power[frequency * float(times[-1] - times[0]) < 1.5] = 0.0
    strongest = int(power.argmax())
    return 1.0 / float(frequency[strongest]) if power[strongest] > 0.0 else None


def _ahead(fit: Calibration, trials: Sequence[int], periods: float, missed: Array | None) -> dict[int, Forecast]:
    """Forecasts whose spread holds that of all unknowns, the noise, and a miss of the model.

    missed (channels,): share of a trial's swing. None: only the spread of each trial's own state.
    """
    floor = np.array(fit.problem.noise.floor)
    problem = fit.problem
    experiment = problem.experiment
    seen: dict[int, float] = {}
    for i in trials:
        t = experiment.trials[i]
        seen[i] = _released(experiment, i) + periods * period_of(fit, i)
        known = np.isfinite(t.y).any(axis=0)
        if min(int((known & (t.times <= seen[i])).sum()), int((known & (t.times > seen[i])).sum())) < LEAST_READINGS:
            del seen[i]
    if not seen:
        return {}
    part = _begun(problem, seen)
    swing = {i: np.nanstd(part.experiment.trials[i].y, axis=1) for i in seen}
    own = {i: p.eta for i, p in predict(replace(fit, problem=part), list(seen)).items()}
    follow, spread, cut = {}, {}, {}
    for block in part.linearise(fit.q, own).blocks:
        for k, i in enumerate(block.group.trials):
            J, T = block.J[k], block.T[k]
            H = np.linalg.inv(T @ T.T + np.eye(len(T)))
            follow[i], spread[i], cut[i] = -H @ T @ J.T, H, (block.group, k)
    out = {}
    for group in (some for whole in problem.grouped(tuple(seen)) for _, some in whole.turns(READINGS_AT_ONCE)):
        scaled = {i: _scaled(*cut[i], group, k) for k, i in enumerate(group.trials)}
        eta = np.array([scaled[i][0] + scaled[i][1] @ own[i] for i in group.trials]).reshape(len(group.trials), -1)
        base, by_q, by_eta = _slopes(problem, group, fit.q, eta)
        for k, i in enumerate(group.trials):
            t = experiment.trials[i]
            _, factors = scaled[i]
            state = np.einsum("wcn,wm->mcn", by_eta[k], factors)
            variance = np.einsum("mcn,ml,lcn->cn", state, spread[i], state)
            variance = variance + np.sum(by_eta[k][~factors.any(axis=1)] ** 2, axis=0)  # of these nothing is seen yet
            if missed is not None:
                along = by_q[k] + np.einsum("mcn,mk->kcn", state, follow[i])
                variance = variance + np.einsum("kcn,kl,lcn->cn", along, fit.covariance, along)
                count = len(variance)
                variance = variance + ((missed[:count] * swing[i]) ** 2)[:, None] + t.noise(floor[:count]) ** 2
            rest = t.times > seen[i]
            out[i] = Forecast(
                i, seen[i] - _released(experiment, i), swing[i], t.times[rest], t.y[:, rest], base[k][:, rest],
                np.sqrt(np.maximum(variance[:, rest], 0.0)),
            )  # fmt: skip
    return out


def _missed(fit: Calibration, periods: float) -> Array:
    """What forecasts of the fitted trials miss beyond noise and the spread of their own state, a share of the swing.

    (channels,); where no fitted trial is long enough, what the fit leaves on them.
    """
    floor = np.array(fit.problem.noise.floor)
    rows = [(f.miss, f.sd, f.swing) for f in _ahead(fit, fit.problem.trials, periods, None).values()]
    if not rows:
        trials = fit.problem.experiment.trials
        rows = [(r, np.zeros_like(r), np.nanstd(trials[i].y, axis=1)) for i, r in fit.residuals().items()]
    out = np.zeros(floor.size)
    for c in range(floor.size):
        here = [(m[c] ** 2 - sd[c] ** 2 - floor[c] ** 2, swing[c]) for m, sd, swing in rows if c < len(m)]
        squares = np.concatenate([square for square, _ in here]) if here else np.zeros(1)
        swings = np.concatenate([np.full(square.size, swing**2) for square, swing in here]) if here else np.ones(1)
        out[c] = math.sqrt(max(float(np.nanmean(squares)) / max(float(np.mean(swings)), 1e-300), 0.0))
    return out


def _released(experiment: Experiment, trial: int) -> float:
    """When the motion of a record begins, s on its clock."""
    first = float(experiment.trials[trial].times[0])
    return first if experiment.start == "free" else max(first, 0.0)


def _begun(problem: Problem, seen: dict[int, float]) -> Problem:
    """The problem of only these trials, each cut at an instant of its clock; unknowns and priors stay."""
    trials = list(problem.experiment.trials)
    factors = dict(problem.factors)
    for i, end in seen.items():
        t = trials[i]
        keep = t.times <= end
        trials[i] = t.at(keep)
        if i in factors and np.ndim(factors[i]) > 0:
            factors[i] = factors[i][..., keep]
    out = copy(problem)
    out.experiment, out.factors, out.trials = replace(problem.experiment, trials=tuple(trials)), factors, tuple(seen)
    out._groups = {}  # noqa: SLF001 (a copy of its own)
    out.groups = out.grouped(out.trials)
    return out


def _scaled(begun: Group, k: int, whole: Group, w: int) -> tuple[Array, Array]:
    """Shift (whole,) and factors (whole, cut) that take a cut trial's nuisances to those of the whole one.

    Their priors differ, and of a free start a short record has fewer waves of a drift: the others stay at their means.
    """
    seen = {name: (n, mean[k], sd[k]) for n, (name, mean, sd) in enumerate(begun.nuisances)}
    shift, factors = np.zeros(len(whole.nuisances)), np.zeros((len(whole.nuisances), len(seen)))
    for m, (name, mean, sd) in enumerate(whole.nuisances):
        if name in seen:
            n, mean_cut, sd_cut = seen[name]
            shift[m], factors[m, n] = (mean_cut - mean[w]) / sd[w], sd_cut / sd[w]
    return shift, factors


def _slopes(problem: Problem, group: Group, q: Array, eta: Array) -> tuple[Array, Array, Array]:
    """Readings (trials, channels, n), and their derivatives by shared (trials, size, ...) and own unknowns."""
    n, m = eta.shape
    steps = np.full((n, q.size + m), STEP)
    for i, (name, _, sd) in enumerate(group.nuisances):
        if name in ("delay", RELEASE):
            steps[:, q.size + i] = (1e-6 if name == "delay" else RELEASE_STEP) / sd
    copies = 1 + q.size + m
    moves = np.concatenate([np.zeros((n, 1, q.size + m)), steps[:, :, None] * np.eye(q.size + m)], axis=1)
    moves = moves.reshape(n * copies, -1)
    y = problem.simulate(
        group,
        np.repeat(np.arange(n), copies),
        q + moves[:, : q.size],
        np.repeat(eta, copies, axis=0) + moves[:, q.size :],
    )
    y = y.reshape(n, copies, *y.shape[1:])
    slopes = np.nan_to_num((y[:, 1:] - y[:, :1]) / steps[:, :, None, None])
    return y[:, 0], slopes[:, : q.size], slopes[:, q.size :]


def _channels(forecasts: Sequence[Forecast]) -> int:
    return max(len(f.reading) for f in forecasts)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.nanmean(x**2)))
