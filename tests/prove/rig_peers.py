"""Least squares, pysindy and PINTS on the measured rigs: what each says of the gap, and what it forecasts.

Least squares (scipy, lmfit) and PINTS call this package's simulation, so that only the inference differs; pysindy
regresses accelerations, as it does. Every held-out trial begins with the state that its first two periods give, and
what a peer knows of its own error is white noise at the level of its residuals, or of its own likelihood.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from bayes_damper.calibration import Calibration, Experiment, Noise, calibrate_nominal, predict
from bayes_damper.calibration.forecast import PERIODS, _ahead, period_of, summary

Array = NDArray[np.float64]


class Stacked:
    """One fit as a function of one vector: shared unknowns, then each trained trial's own; all readings in a row."""

    def __init__(self, fit: Calibration) -> None:
        self.fit, self.problem = fit, fit.problem
        self.start = np.concatenate([fit.q, *(fit.eta[i] for i in self.problem.trials)])
        self.sizes = [len(fit.eta[i]) for i in self.problem.trials]

    def model(self, x: Array) -> list[Array]:
        """Readings (channels, n) of each trained trial."""
        out, first = [], self.problem.size
        for i, m in zip(self.problem.trials, self.sizes, strict=True):
            group = self.problem.grouped((i,))[0]
            out.append(
                self.problem.simulate(group, np.array([0]), x[None, : self.problem.size], x[None, first : first + m])[0]
            )
            first += m
        return out

    def misses(self, x: Array) -> Array:
        """Model minus reading, (channels * n of all trials,); large and finite where the simulation fails."""
        trials = self.problem.experiment.trials
        rows = []
        for i, y in zip(self.problem.trials, self.model(x), strict=True):
            known = np.isfinite(trials[i].y)
            rows.append(y[known] - trials[i].y[known])
        return np.nan_to_num(np.concatenate(rows), nan=10.0, posinf=10.0, neginf=-10.0)

    def with_white(self, x: Array, covariance: Array, level: float) -> Calibration:
        """The fit at x, as somebody sees it who takes what is left for white noise."""
        channels = len(self.problem.noise.phi)
        zero = (0.0,) * channels
        problem = self.problem.with_noise(Noise((level,) * channels, zero, zero))
        size = self.problem.size
        return replace(self.fit, problem=problem, q=x[:size], covariance=covariance[:size, :size])


def ahead(fit: Calibration) -> dict[str, Any]:
    """Forecasts of the held-out trials with no error of the model allowed for."""
    experiment = fit.problem.experiment
    found = _ahead(fit, experiment.heldout, PERIODS, np.zeros(len(fit.problem.noise.phi)))
    if not found:
        return {"trials": {}}
    whole = {i: float(np.sqrt(np.nanmean(p.residual**2))) for i, p in predict(fit, tuple(found)).items()}
    rows = {
        experiment.trials[i].label: summary([f]) | {"number": experiment.trials[i].number, "rms_whole": whole[i]}
        for i, f in found.items()
    }
    return {"trials": rows} | summary(list(found.values()))


def criterion(square: float, n: int, k: int) -> float:
    """Schwarz's criterion of k unknowns that leave a sum of squares in n readings, noise level unknown."""
    return n * math.log(square / n) + k * math.log(n)


def scipy_squares(fit: Calibration) -> dict[str, Any]:
    """`scipy.optimize.least_squares`, and what its Jacobian says of the spread."""
    stacked = Stacked(fit)
    found = least_squares(stacked.misses, stacked.start, x_scale="jac", max_nfev=60, diff_step=1e-4)
    n, k = found.fun.size, found.x.size
    level = float(np.sqrt(found.fun @ found.fun / (n - k)))
    covariance = level**2 * np.linalg.pinv(found.jac.T @ found.jac)
    told = ahead(stacked.with_white(found.x, covariance, level))
    return {"rms": level, "bic": criterion(2.0 * found.cost, n, k), "forecast": told}


def lmfit_squares(fit: Calibration) -> dict[str, Any]:
    """`lmfit.minimize`: its own covariance and criterion."""
    import lmfit

    stacked = Stacked(fit)
    parameters = lmfit.Parameters()
    for i, x in enumerate(stacked.start):
        parameters.add(f"x{i}", value=float(x))

    def misses(p: Any) -> Array:
        return stacked.misses(np.array([p[f"x{i}"].value for i in range(stacked.start.size)]))

    found = lmfit.minimize(misses, parameters, method="leastsq", epsfcn=1e-8, max_nfev=3000)
    x = np.array([found.params[f"x{i}"].value for i in range(stacked.start.size)])
    level = math.sqrt(found.redchi)
    covariance = found.covar if hasattr(found, "covar") and found.covar is not None else np.zeros((x.size, x.size))
    return {"rms": level, "bic": float(found.bic), "forecast": ahead(stacked.with_white(x, covariance, level))}


def pints_chains(fit: Calibration, iterations: int = 1000, seconds: float = 90.0) -> dict[str, Any]:
    """PINTS: an AR(1) likelihood, its adaptive sampler from the best fit, three chains of which two thirds count.

    iterations : of each chain, fewer where they would take more than `seconds`.
    """
    import pints

    stacked = Stacked(fit)
    start = least_squares(stacked.misses, stacked.start, x_scale="jac", max_nfev=60, diff_step=1e-4)
    level = float(np.std(start.fun))
    begun = time.perf_counter()
    for _ in range(20):
        stacked.misses(start.x)
    iterations = min(iterations, max(100, int(20.0 * seconds / 3.0 / (time.perf_counter() - begun))))

    class Forward(pints.ForwardModel):  # type: ignore[misc]
        def n_parameters(self) -> int:
            return int(stacked.start.size)

        def simulate(self, parameters: Any, times: Any) -> Array:
            return np.asarray(readings + stacked.misses(np.asarray(parameters, float)))

    trials = fit.problem.experiment.trials
    readings = np.concatenate([trials[i].y[np.isfinite(trials[i].y)] for i in fit.problem.trials])
    problem = pints.SingleOutputProblem(Forward(), np.arange(readings.size, dtype=float), readings)
    likelihood = pints.AR1LogLikelihood(problem)
    lag = float(np.corrcoef(start.fun[1:], start.fun[:-1])[0, 1])
    centre = np.concatenate([start.x, [min(lag, 0.98), level * math.sqrt(1.0 - min(lag, 0.98) ** 2)]])
    reach = np.concatenate([np.full(start.x.size, 6.0) + np.abs(start.x), [0.0, 0.0]])
    low, high = centre - reach, centre + reach
    low[-2:], high[-2:] = (-1.0, 0.0), (1.0, 10.0 * level)
    posterior = pints.LogPosterior(likelihood, pints.UniformLogPrior(low, high))
    np.random.seed(1)  # noqa: NPY002 (the only seed that PINTS takes)
    rng = np.random.default_rng(1)
    covariance = np.zeros((centre.size, centre.size))
    # Coordinates have unit Gaussian priors: what the readings do not tell is no wider than that.
    covariance[:-2, :-2] = np.linalg.inv(start.jac.T @ start.jac / level**2 + np.eye(start.x.size))
    covariance[[-2, -1], [-2, -1]] = 1e-6, (0.01 * level) ** 2
    root = np.linalg.cholesky(covariance)
    starts = [np.clip(centre + 0.3 * root @ rng.standard_normal(centre.size), low + 1e-9, high - 1e-9)
              for _ in range(3)]  # fmt: skip
    controller = pints.MCMCController(posterior, 3, starts, sigma0=root @ root.T, method=pints.HaarioBardenetACMC)
    controller.set_max_iterations(iterations)
    controller.set_log_to_screen(False)
    chains = controller.run()[:, iterations // 3 :]
    flat = chains.reshape(-1, centre.size)
    mean, covariance = flat.mean(axis=0), np.cov(flat.T)
    rho = float(mean[-2])
    white = float(mean[-1]) / math.sqrt(max(1.0 - rho**2, 1e-6))
    return {
        "rms": float(np.std(stacked.misses(mean[:-2]))),
        "rho": rho,
        "r_hat": float(np.max(pints.rhat(chains))),
        "forecast": ahead(stacked.with_white(mean[:-2], covariance[:-2, :-2], white)),
    }


# pysindy --------------------------------------------------------------------------------------------------------------


def _terms(coupled: bool, pendulum: bool) -> tuple[list[str], Callable[[Array], Array]]:
    """Names of the terms, and their values (n, terms) at states (n, 2 or 4): angles, then speeds."""
    bend = np.sin if pendulum else np.array
    word = "sin th{}" if pendulum else "x{}"

    def one(x: Array) -> Array:
        th, w = x.T
        return np.column_stack([np.ones_like(th), bend(th), w, np.sign(w), w * np.abs(w), th**3])

    def two(x: Array) -> Array:
        a, b, u, v = x.T
        return np.column_stack([
            np.ones_like(a), bend(a), bend(b), u, v, np.sign(u), np.sign(v), np.sign(u - v), u * np.abs(u),
            v * np.abs(v),
        ])  # fmt: skip

    if coupled:
        both = [word.format(1), word.format(2)]
        return ["1", *both, "w1", "w2", "sign w1", "sign w2", "sign(w1-w2)", "w1|w1|", "w2|w2|"], two
    return ["1", word.format(""), "w", "sign w", "w|w|", "th^3"], one


def sindy(fit: Calibration) -> dict[str, Any]:
    """pysindy's thresholded least squares on smoothed derivatives; the threshold with the best Schwarz criterion."""
    import pysindy

    e = fit.problem.experiment
    coupled = e.trials[fit.problem.trials[0]].coupled
    names, terms = _terms(coupled, e.restoring == "pendulum")
    states, rates = [], []
    for i in fit.problem.trials:
        t = e.trials[i]
        known = np.isfinite(t.y).all(axis=0)
        step = float(np.median(np.diff(t.times)))
        grid = np.arange(t.times[known][0], t.times[known][-1], step)
        window = 2 * int(0.11 * period_of(fit, i) / step) + 5
        y = np.array([np.interp(grid, t.times[known], c[known]) for c in t.y])
        w = savgol_filter(y, window, 4, deriv=1, delta=step)
        a = savgol_filter(y, window, 4, deriv=2, delta=step)
        inner = slice(window, -window)
        states.append(np.vstack([y, w]).T[inner])
        rates.append(a.T[inner])
    x, a = np.concatenate(states), np.concatenate(rates)
    library = terms(x)
    best: tuple[float, Array] | None = None
    for threshold in (0.0, 1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0):
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-9, normalize_columns=False)
        optimizer.fit(library, a)
        c = np.asarray(optimizer.coef_)
        left = a - library @ c.T
        score = sum(criterion(float(r @ r), r.size, int(np.count_nonzero(k))) for r, k in zip(left.T, c, strict=True))
        if best is None or score < best[0]:
            best = (score, c)
    assert best is not None
    c = best[1]
    half = a.shape[1]

    def run(start: Array, times: Array) -> Array:
        def rate(_: float, s: Array) -> Array:
            return np.concatenate([s[half:], (terms(s[None]) @ c.T)[0]])

        with np.errstate(all="ignore"):
            found = solve_ivp(rate, (times[0], times[-1]), start, "RK45", times, rtol=1e-5, atol=1e-7, max_step=0.02)
        y = np.full((half, times.size), np.nan)
        y[:, : found.y.shape[1]] = found.y[:half]
        return y

    rows: dict[str, Any] = {}
    squares, count = 0.0, 0
    for i in e.heldout:
        t = e.trials[i]
        first = t.times <= t.times[0] + PERIODS * period_of(fit, i)

        def misses(s: Array, t: Any = t, first: Any = first) -> Array:
            return np.nan_to_num(((run(s, t.times[first]) - t.y[:, first])[np.isfinite(t.y[:, first])]), nan=10.0)

        slope = [np.polyfit(t.times[:7] - t.times[0], c[:7], 1)[0] for c in t.y]
        own = least_squares(misses, [*t.y[:, 0], *slope], max_nfev=12)
        y = run(own.x, t.times)[:, ~first]
        miss = t.y[:, ~first] - y
        miss = miss[np.isfinite(t.y[:, ~first])]
        left = float(np.sqrt(np.mean(miss**2)))
        rows[t.label] = {"rms": left if math.isfinite(left) else None}
        squares, count = squares + float(np.sum(miss**2)), count + miss.size
    kept = [[n for n, v in zip(names, row, strict=True) if v != 0.0] for row in c]
    rms = math.sqrt(squares / count) if count and math.isfinite(squares) else None
    return {"kept": kept, "forecast": {"rms": rms, "trials": rows}}


PEERS: dict[str, Callable[[Calibration], dict[str, Any]]] = {
    "scipy": scipy_squares,
    "lmfit": lmfit_squares,
    "PINTS": pints_chains,
}


def all_of(experiment: Experiment) -> dict[str, Any]:
    """What each installed peer says: "peer, model" -> its numbers; the model is "viscous" or "dry"."""
    fits = {
        name: calibrate_nominal(experiment, nominal=kind)
        for name, kind in (("viscous", "linear"), ("dry", "nonlinear"))
    }
    out: dict[str, Any] = {}
    for peer, says in PEERS.items():
        for model in ("dry",) if peer == "PINTS" else ("viscous", "dry"):
            try:
                out[f"{peer}, {model}"] = says(fits[model])
            except ImportError:
                break
    with suppress(ImportError):
        out["pysindy"] = sindy(fits["viscous"])
    return out
