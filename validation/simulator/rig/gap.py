"""The gap a disturbance leaves: what no nominal fit with exact constants can hide, and the amplitude for a wanted gap.

Level = root mean square of (noise-free truth - best nominal fit) over the noise, all records and channels together.
The fit is a damped Gauss-Newton search with finite differences over mu, k2t, c2t, drag, nu, c1t, c3t (logarithms) and
one free release angle a record.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .kinds import Kind, Shape
from .sensors import Disturbance
from .simulate import SEARCH_STEP, motion, record

FITTED = ("mu", "k2t", "c2t", "drag", "nu", "c1t", "c3t")
FITTED_UNCOUPLED = ("drag", "nu", "c1t")
NOISE = 2.0  # rad/s^2
AR_SHARE, AR_PHI = 0.2, 0.9  # hard kind: share of the variance that is an AR(1) process, and its coefficient
CHANNEL_2 = 1.4  # hard kind: noise of the second channel over that of the first


@dataclass(frozen=True)
class Condition:
    """One configuration: is it coupled, the rig's constants with the release angle theta0 (rad) of that case."""

    coupled: bool
    rig: dict[str, float]
    phase: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Best nominal fit: parameters by name, release angles (rad), level, residuals of each condition."""

    parameters: dict[str, float]
    angles: NDArray[np.float64]
    level: float
    residuals: list[NDArray[np.float64]]


class Nominal:
    """The nominal model on a set of conditions, with its derivatives."""

    def __init__(self, conditions: Sequence[Condition], times: NDArray[np.float64], late: float = 0.0) -> None:
        self.conditions = list(conditions)
        self.times = times
        self.late = late
        self.skip = round(late / SEARCH_STEP)
        self.keep = round(float(times[1] - times[0]) / SEARCH_STEP)
        self.size = times.size * sum(2 if c.coupled else 1 for c in self.conditions)

    def one(self, i: int, q: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
        """Readings of condition i as one vector."""
        c = self.conditions[i]
        rig = c.rig | dict(zip(FITTED, np.exp(q).tolist(), strict=True)) | {"theta0": angle}
        if self.skip:
            path = motion(rig, c.coupled, (), float(self.times[-1]) + self.late, SEARCH_STEP)[self.skip :: self.keep]
        else:
            path = motion(rig, c.coupled, (), float(self.times[-1]), SEARCH_STEP, self.keep)
        return path[:, 4:6].T.ravel() if c.coupled else path[:, 4]

    def all(self, x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Readings of every condition; x = logarithms of FITTED, then angles."""
        return [self.one(i, x[:7], x[7 + i]) for i in range(len(self.conditions))]

    def jacobian(self, x: NDArray[np.float64], base: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """(size, 7 + conditions) forward differences."""
        out = np.zeros((self.size, x.size))
        row = 0
        for i, c in enumerate(self.conditions):
            rows = slice(row, row + base[i].size)
            row += base[i].size
            for j, name in enumerate(FITTED):
                if c.coupled or name in FITTED_UNCOUPLED:
                    q = x[:7].copy()
                    q[j] += 1e-4
                    out[rows, j] = (self.one(i, q, x[7 + i]) - base[i]) / 1e-4
            h = 1e-4 * abs(x[7 + i])
            out[rows, 7 + i] = (self.one(i, x[:7], x[7 + i] + h) - base[i]) / h
        return out

    def start(self) -> NDArray[np.float64]:
        """Parameters of the conditions themselves."""
        rig = self.conditions[0].rig
        return np.array([np.log(rig[n]) for n in FITTED] + [c.rig["theta0"] for c in self.conditions])

    def fit(
        self, data: list[NDArray[np.float64]], x: NDArray[np.float64], rounds: int = 40
    ) -> tuple[NDArray[np.float64], Fit]:
        """Damped Gauss-Newton search from x; returns (x, Fit)."""
        y = np.concatenate(data)
        low = np.concatenate([np.log([1e-6, 1e-3, 1e-5, 1e-6, 2.0, 1e-6, 1e-6]), np.full(len(data), 1e-3)])
        high = np.concatenate([np.log([1.0, 1e3, 10.0, 1.0, 2e3, 1.0, 1.0]), np.full(len(data), 0.5)])
        base = self.all(x)
        r = y - np.concatenate(base)
        cost = float(r @ r)
        damping = 1e-3
        for _ in range(rounds):
            J = self.jacobian(x, base)
            A = J.T @ J
            b = J.T @ r
            scale = np.diag(A) + 1e-9 * np.diag(A).max() + 1e-30
            gained = 0.0
            for _ in range(8):
                dx = np.linalg.solve(A + damping * np.diag(scale), b)
                dx[:7] = np.clip(dx[:7], -0.7, 0.7)
                trial = np.clip(x + dx, low, high)
                new = self.all(trial)
                rn = y - np.concatenate(new)
                cn = float(rn @ rn)
                if cn < cost:
                    gained = cost - cn
                    x, base, r, cost = trial, new, rn, cn
                    damping = max(damping / 5.0, 1e-9)
                    break
                damping *= 6.0
            if gained < 2e-3 * cost:
                break
        edges = np.cumsum([0] + [d.size for d in data])
        residuals = [r[a:b] for a, b in pairwise(edges.tolist())]
        names = dict(zip(FITTED, np.exp(x[:7]).tolist(), strict=True))
        return x, Fit(names, x[7:], float(np.sqrt(cost / self.size)) / NOISE, residuals)


def truth(
    conditions: Sequence[Condition],
    times: NDArray[np.float64],
    disturbances: Sequence[Disturbance],
    late: float = 0.0,
) -> list[NDArray[np.float64]]:
    """Noise-free readings of every condition, each as one vector."""
    return [record(c.rig, c.coupled, times, disturbances, -late, c.phase, SEARCH_STEP).ravel() for c in conditions]


def gap_of(
    conditions: Sequence[Condition],
    times: NDArray[np.float64],
    disturbances: Sequence[Disturbance],
    late: float = 0.0,
) -> Fit:
    """Best nominal fit to these disturbances, from the true parameters and from another smoothing constant."""
    model = Nominal(conditions, times, late)
    data = truth(conditions, times, disturbances, late)
    x0 = model.start()
    soft = x0.copy()
    soft[4] = np.log(30.0) if x0[4] > np.log(55.0) else np.log(90.0)
    return min((model.fit(data, x)[1] for x in (x0, soft)), key=lambda f: f.level)


UNCERTAIN = ("J1", "J2", "R", "r")


def innovations(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Readings (..., n) in a basis where the hard kind's noise of unit variance is white and of unit variance.

    White and AR(1) noise together are an ARMA(1, 1) process, whose moving average follows from its spectrum:
    s^2 |1 - theta z|^2 = (1 - AR_SHARE) |1 - AR_PHI z|^2 + AR_SHARE (1 - AR_PHI^2).
    """
    white = 1.0 - AR_SHARE
    level = white * (1.0 + AR_PHI**2) + AR_SHARE * (1.0 - AR_PHI**2)
    half = 0.5 * level / (white * AR_PHI)
    theta = half - np.sqrt(half**2 - 1.0)
    out: NDArray[np.float64] = lfilter([1.0, -AR_PHI], [1.0, -theta], y, axis=-1)
    return out / np.sqrt(white * AR_PHI / theta)


def visible_chi2(
    conditions: Sequence[Condition],
    times: NDArray[np.float64],
    disturbances: Sequence[Disturbance],
    fit: Fit,
    declared: dict[str, float],
    shares: dict[str, float],
    late: float,
    trials: int,
    rounds: int = 12,
) -> float:
    """What is left of the gap when the declared constants may move too: noise-free chi2 of all trials, not below 0.

    The nominal fit is taken up at `fit` and freed in the constants `declared` (their relative sd in `shares`; k1t by
    "k1t", one for each value), and for each condition in the release angle, the friction (3 %) and the start of the
    logger (0.35 ms), all with their priors. The noise is that of the hard kind: coloured, and more of it in channel 2.
    An upper bound: the search is local.
    About half of it is the log evidence that the true effect can gain over the nominal model.
    """
    n = len(conditions)
    stiffnesses = sorted({c.rig["k1t"] for c in conditions})
    offsets = 7 + n  # then constants, k1t values, friction and start of each condition
    shift = offsets + len(UNCERTAIN) + len(stiffnesses)
    fine = np.arange(round((float(times[-1]) + late) / SEARCH_STEP) + 30) * SEARCH_STEP
    truth_y = truth(conditions, times, disturbances, late)
    noises = NOISE * np.array([1.0, CHANNEL_2])

    def one(i: int, x: NDArray[np.float64]) -> NDArray[np.float64]:
        c = conditions[i]
        rig = c.rig | dict(zip(FITTED, np.exp(x[:7]).tolist(), strict=True)) | {"theta0": float(x[7 + i])}
        for j, name in enumerate(UNCERTAIN):
            rig[name] = declared[name] * float(np.exp(x[offsets + j]))
        which = stiffnesses.index(c.rig["k1t"])
        rig["k1t"] = declared[f"k1t{which}"] * float(np.exp(x[offsets + len(UNCERTAIN) + which]))
        rig["mu"] *= float(np.exp(x[shift + i]))
        path = motion(rig, c.coupled, (), float(fine[-1]), SEARCH_STEP)
        at = np.maximum(times + late + x[shift + n + i], 0.0)
        columns = (4, 5) if c.coupled else (4,)
        y = np.stack([np.interp(at, fine[: path.shape[0]], path[:, k]) for k in columns])
        error = (y - truth_y[i].reshape(y.shape)) / noises[: y.shape[0], None]
        return np.sqrt(trials) * innovations(error).ravel()

    mean = np.zeros(shift + 2 * n)
    sd = np.full(mean.size, np.inf)
    mean[7 : 7 + n] = [c.rig["theta0"] for c in conditions]
    sd[7 : 7 + n] = 0.01 * mean[7 : 7 + n] / np.sqrt(trials)
    sd[offsets : offsets + len(UNCERTAIN)] = [shares[name] for name in UNCERTAIN]
    sd[offsets + len(UNCERTAIN) : shift] = shares["k1t"]
    sd[shift : shift + n] = 0.03 / np.sqrt(trials)
    sd[shift + n :] = 0.35e-3 / np.sqrt(trials)
    x = mean.copy()
    x[:7] = np.log([fit.parameters[name] for name in FITTED])
    x[7 : 7 + n] = fit.angles
    true = np.zeros(mean.size)
    for j, name in enumerate(UNCERTAIN):
        true[offsets + j] = np.log(conditions[0].rig[name] / declared[name])
        x[offsets + j] = true[offsets + j]
    for j, k in enumerate(stiffnesses):
        true[offsets + len(UNCERTAIN) + j] = np.log(k / declared[f"k1t{j}"])
        x[offsets + len(UNCERTAIN) + j] = true[offsets + len(UNCERTAIN) + j]
    steps = np.full(mean.size, 1e-4)
    steps[shift + n :] = 1e-6

    def residual(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([*(one(i, x) for i in range(n)), (x - mean) / sd])

    def touches(i: int, j: int) -> bool:
        if j < 7:
            return conditions[i].coupled or FITTED[j] in FITTED_UNCOUPLED
        if j >= offsets and j < shift:
            first = j in (offsets, *range(offsets + len(UNCERTAIN), shift))
            return conditions[i].coupled or first
        return (j - 7) % n == i if j < offsets else (j - shift) % n == i

    r = residual(x)
    cost = float(r @ r)
    damping = 1e-3
    for _ in range(rounds):
        J = np.zeros((r.size, x.size))
        row = 0
        for i in range(n):
            base = one(i, x)
            for j in range(x.size):
                if touches(i, j):
                    moved = x.copy()
                    moved[j] += steps[j]
                    J[row : row + base.size, j] = (one(i, moved) - base) / steps[j]
            row += base.size
        J[row:] = np.diag(1.0 / sd)
        A = J.T @ J
        b = -(J.T @ r)
        gained = 0.0
        for _ in range(8):
            dx = np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12 * np.diag(A).max()), b)
            dx[:7] = np.clip(dx[:7], -0.7, 0.7)
            new = residual(x + dx)
            if float(new @ new) < cost:
                gained = cost - float(new @ new)
                x, r, cost = x + dx, new, float(new @ new)
                damping = max(damping / 5.0, 1e-9)
                break
            damping *= 6.0
        if gained < 0.02 * cost:
            break
    finite = np.isfinite(sd) & (true != 0.0)
    return max(0.0, cost - float(np.sum((true[finite] / sd[finite]) ** 2)))


def amplitude_for(
    kind: Kind,
    shape: Shape,
    sign: float,
    level: float,
    conditions: Sequence[Condition],
    times: NDArray[np.float64],
    late: float = 0.0,
    tolerance: float = 0.03,
) -> tuple[float, float]:
    """(size of the amplitude, level reached).

    late : s by which the loggers start after the release. The level falls short where the kind's limit stops it and is
    exceeded where its least amplitude is already too much.
    """
    model = Nominal(conditions, times, late)
    x0 = model.start()
    base = model.all(x0)
    Q, _ = np.linalg.qr(model.jacobian(x0, base))
    flat = np.concatenate(base)
    root = float(np.sqrt(model.size)) * NOISE
    bound = kind.bound(sign)

    def data_at(s: float) -> list[NDArray[np.float64]]:
        return truth(conditions, times, [kind.at(sign * s, shape)], late)

    def estimate(s: float) -> float:
        d = np.concatenate(data_at(s)) - flat
        return float(np.linalg.norm(d - Q @ (Q.T @ d))) / root

    warm = x0

    def exact(s: float) -> float:
        nonlocal warm
        data = data_at(s)
        fits = [model.fit(data, x) for x in ((x0,) if warm is x0 else (x0, warm))]
        warm, best = min(fits, key=lambda f: f[1].level)
        return best.level

    s = _solve(estimate, min(kind.scale, bound), level, bound, 0.05, 8)[0]
    s = max(s, kind.least)
    if s == kind.least and (reached := exact(s)) > level:
        return s, reached
    return _solve(exact, s, level, bound, tolerance, 7)


def _solve(
    f: Callable[[float], float], s: float, wanted: float, bound: float, tolerance: float, rounds: int
) -> tuple[float, float]:
    """Secant and bisection in logarithms for f(s) = wanted, s in (0, bound]; returns the best (s, f(s)) seen."""
    seen: list[tuple[float, float]] = []
    low, high = 0.0, np.inf
    for _ in range(rounds):
        value = f(s)
        if not np.isfinite(value):
            value = np.inf
        seen.append((s, value))
        if abs(value / wanted - 1.0) < tolerance or (s >= bound and value < wanted):
            break
        if value < wanted:
            low = max(low, s)
        else:
            high = min(high, s)
        slope = 1.0
        if len(seen) > 1 and np.isfinite(value) and np.isfinite(seen[-2][1]) and seen[-2][0] != s:
            slope = np.log(max(value, 1e-12) / max(seen[-2][1], 1e-12)) / np.log(s / seen[-2][0])
        slope = min(max(slope, 0.3), 4.0)
        step = np.clip(np.log(wanted / max(value, 1e-12)) / slope, -3.0, 3.0)
        new = s * float(np.exp(step))
        if not low < new < high:
            new = float(np.sqrt(low * high)) if low > 0.0 and np.isfinite(high) else new
        s = min(new, bound)
    finite = [v for v in seen if np.isfinite(v[1])]
    if not finite:
        raise ArithmeticError("no amplitude of this disturbance gives a finite motion")
    return min(finite, key=lambda v: abs(np.log(max(v[1], 1e-12) / wanted)))
