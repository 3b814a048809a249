"""How much of a disturbance no nominal rig can hide, against noise and scatter; the amplitude for a wanted level.

Level: root mean square, over all conditions, channels and readings, of (noise-free record - best nominal one) over
sqrt(noise^2 + scatter^2). The nominal fit is free in mu, k2t, c2t, drag, nu, c1t, c3t and in each condition's release
angle and instant; `scatter` is what the drawn scatter of the trials does to their records, in root mean square, once
each record's angle and instant are fitted.

visible_chi2: the noise-free chi2 of all trials against the white noise that is left when the declared constants and
each trial's scattered values may move within their standard deviations: what data of this laboratory can show at best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .kinds import Kind
from .laboratory import Case, Laboratory
from .motion import Disturbance, record

Array = NDArray[np.float64]

FITTED = ("friction", "k2", "c2", "drag", "nu", "c1", "c3")
ALONE = ("drag", "nu", "c1")
MOST_TIMES = 500
TOL = 1e-7
ROUNDS = 12


@dataclass(frozen=True)
class Condition:
    """One case and configuration: times at which it is looked at, how many trials and readings these stand for."""

    case: Case
    coupled: bool
    times: Array
    trials: int
    thinning: float

    @property
    def channels(self) -> int:
        """One or two."""
        return 2 if self.coupled else 1


def conditions(lab: Laboratory) -> list[Condition]:
    """Every case and configuration, at no more than MOST_TIMES instants each."""
    grid = replace(lab, clock="even").times(np.random.default_rng(0))[1:]  # at 0 a record may be held yet
    step = max(1, math.ceil(grid.size / MOST_TIMES))
    return [
        Condition(case, coupled, grid[::step], n, grid.size / grid[::step].size)
        for case in lab.cases
        for coupled, n in case.trials.items()
    ]


@dataclass(frozen=True)
class _Free:
    """A number that a fit may move: where it acts (None: everywhere), its standard deviation, how it acts."""

    name: str
    condition: int | None
    sd: float
    step: float


class Fit:
    """The nominal model of a laboratory, with the numbers a fit may move."""

    def __init__(self, lab: Laboratory, seen: Sequence[Condition], with_scatter: bool) -> None:
        self.lab, self.seen = lab, seen
        fitted = FITTED if lab.bodies == 2 else ALONE
        self.free = [_Free(name, None, math.inf, 1e-4) for name in fitted]
        if with_scatter:
            springs = sorted({c.case.k1 for c in seen})
            constants = ["J1", "J2", "face"] if lab.bodies == 2 else ["J1"]
            share = {
                "J1": lab.shares["J1"],
                "J2": lab.shares["J2"],
                "face": math.hypot(lab.shares["R"], lab.shares["r"]),
            }
            self.free += [_Free(name, None, share[name], 1e-4) for name in constants if share[name] > 0.0]
            if lab.shares["k1t"] > 0.0:
                self.free += [_Free(f"spring{i}", None, lab.shares["k1t"], 1e-4) for i in range(len(springs))]
            self.springs = springs
        for i, c in enumerate(seen):
            for name, sd in lab.scatter.items():
                number = {"1": 0, "2": 1}.get(name[-1]) if name[:-1] in ("gain", "offset", "drift") else 0
                acts = c.coupled or (name in ("k1t", "c1t", "drag", "theta0", "instant", "ramp") or number == 0)
                if not acts or (name in ("k2t", "c2t", "c3t", "mu") and not c.coupled):
                    continue
                if name in ("theta0", "instant"):
                    # Where a level is looked for, angle and instant are free.
                    wide = 0.05 if name == "theta0" else lab.interval
                    size = sd * (1.0 if name == "theta0" else lab.interval) if with_scatter else wide
                elif not with_scatter:
                    continue
                else:
                    size = sd * (lab.sigma[int(number or 0)] if name[:-1] in ("offset", "drift") else 1.0)
                if size > 0.0:
                    step = {"instant": 1e-3 / lab.W, "ramp": 1e-3 / lab.W}.get(name, 1e-4)
                    step = lab.sigma[int(number or 0)] if name[:-1] in ("offset", "drift") else step
                    self.free.append(_Free(name, i, size / math.sqrt(c.trials) if with_scatter else size, step))
        self.sd = np.array([f.sd for f in self.free])

    def one(self, i: int, x: Array) -> Array:
        """Noise-free readings of condition i, (channels, n)."""
        c, lab = self.seen[i], self.lab
        own: dict[str, float] = {}
        factor: dict[str, float] = {}
        for f, value in zip(self.free, x, strict=True):
            if f.condition is None:
                factor[f.name] = math.exp(value)
            elif f.condition == i:
                own[f.name] = float(value)
        ramp = 0.0 if lab.scatter.get("ramp", 0.0) == 0.0 else lab.scatter["ramp"]
        own["ramp"] = max(ramp + own.get("ramp", 0.0), 0.0)
        rig = lab.rig(c.case, c.coupled, own)
        for name, value in factor.items():
            if name.startswith("spring"):
                if self.springs[int(name[6:])] == c.case.k1:
                    rig["k1"] *= value
            else:
                rig[name] *= value
        y = record(rig, c.times, (), own.get("instant", 0.0), TOL)
        return add_sensor_scatter(y, c.times, own)

    def acts(self, f: _Free, i: int) -> bool:
        """Whether a number matters for condition i."""
        if f.condition is not None:
            return f.condition == i
        return self.seen[i].coupled or f.name in (*ALONE, "J1") or f.name.startswith("spring")

    def residual(self, x: Array, data: Sequence[Array], noise: Sequence[float]) -> list[Array]:
        """(data - model) / noise of each condition, flat."""
        out = []
        for i, y in enumerate(data):
            r = y - self.one(i, x)
            out.append((r / np.array(noise[: r.shape[0]])[:, None]).ravel())
        return out

    def jacobian(self, x: Array, noise: Sequence[float]) -> list[Array]:
        """Derivative of each condition's model over the noise, (n_free, n)."""
        out = []
        for i in range(len(self.seen)):
            base = self.one(i, x)
            scale = np.array(noise[: base.shape[0]])[:, None]
            rows = np.zeros((len(self.free), base.size))
            for j, f in enumerate(self.free):
                if self.acts(f, i):
                    moved = x.copy()
                    moved[j] += f.step
                    rows[j] = ((self.one(i, moved) - base) / f.step / scale).ravel()
            out.append(rows)
        return out

    def weights(self) -> Array:
        """How many readings each of a condition's stands for."""
        return np.array([c.trials * c.thinning for c in self.seen])

    def best(
        self, data: Sequence[Array], noise: Sequence[float], x: Array | None = None
    ) -> tuple[Array, float, list[Array]]:
        """The best numbers, their cost (chi2 with the pulls), residuals; damped Gauss-Newton from x or the truth."""
        x = np.zeros(len(self.free)) if x is None else x.copy()
        w = self.weights()
        r = self.residual(x, data, noise)

        def cost_of(x: Array, r: list[Array]) -> float:
            return float(sum(wi * (ri @ ri) for wi, ri in zip(w, r, strict=True)) + np.sum((x / self.sd) ** 2))

        cost, damping = cost_of(x, r), 1e-3
        for _ in range(ROUNDS):
            J = self.jacobian(x, noise)
            H = sum(wi * Ji @ Ji.T for wi, Ji in zip(w, J, strict=True)) + np.diag(self.sd**-2.0)
            b = sum(wi * Ji @ ri for wi, Ji, ri in zip(w, J, r, strict=True)) - x / self.sd**2
            scale = np.diag(H) + 1e-12 * np.diag(H).max()
            gained = 0.0
            for _ in range(8):
                dx = np.linalg.solve(H + damping * np.diag(scale), b)
                dx = np.clip(dx, -0.7, 0.7)
                trial = np.clip(x + dx, -7.0, 7.0)
                rn = self.residual(trial, data, noise)
                cn = cost_of(trial, rn)
                if cn < cost:
                    gained, x, r, cost = cost - cn, trial, rn, cn
                    damping = max(damping / 6.0, 1e-9)
                    break
                damping *= 7.0
            if gained < 3e-3 * cost or cost < 1e-3:
                break
        return x, cost, r


def add_sensor_scatter(y: Array, times: Array, own: dict[str, float]) -> Array:
    """Readings with a trial's own gains, offsets and slow drifts."""
    slow = 0.5 * (1.0 - np.cos(math.pi * times / times[-1]))
    out = y.copy()
    for c in range(y.shape[0]):
        gain, offset, drift = (own.get(f"{name}{c + 1}", 0.0) for name in ("gain", "offset", "drift"))
        out[c] = (1.0 + gain) * y[c] + offset + drift * slow
    return out


def truth(lab: Laboratory, seen: Sequence[Condition], wrong: Sequence[Disturbance]) -> list[Array]:
    """Noise-free records of every condition with what is wrong; scattered is the mean of the ramp alone."""
    ramp = {"ramp": lab.scatter.get("ramp", 0.0)}
    return [record(lab.rig(c.case, c.coupled, ramp), c.times, wrong, 0.0, TOL) for c in seen]


def scatter_rms(lab: Laboratory, seen: Sequence[Condition], owns: Sequence[Sequence[dict[str, float]]]) -> float:
    """What the drawn scatter does to the records over the noise, angle and instant of each record fitted."""
    fit = Fit(lab, seen, with_scatter=False)
    x0 = np.zeros(len(fit.free))
    base = truth(lab, seen, ())
    total, n = 0.0, 0
    for i, (c, J) in enumerate(zip(seen, fit.jacobian(x0, lab.sigma), strict=True)):
        mine = [j for j, f in enumerate(fit.free) if f.condition == i]
        basis = np.linalg.qr(J[mine].T)[0] if mine else np.zeros((base[i].size, 0))
        for own in owns[i]:
            y = record(lab.rig(c.case, c.coupled, own), c.times, (), own.get("instant", 0.0), TOL)
            d = (add_sensor_scatter(y, c.times, own) - base[i]) / np.array(lab.sigma[: c.channels])[:, None]
            flat = d.ravel()
            flat = flat - basis @ (basis.T @ flat)
            total, n = total + float(flat @ flat), n + flat.size
    return math.sqrt(total / n)


@dataclass(frozen=True)
class Gap:
    """What a disturbance leaves: level, rms over the noise, best nominal numbers over the true ones."""

    level: float
    rms: float
    numbers: dict[str, float]


def gap_of(lab: Laboratory, seen: Sequence[Condition], wrong: Sequence[Disturbance], scatter: float) -> Gap:
    """The gap of these disturbances; scatter : of `scatter_rms`."""
    fit = Fit(lab, seen, with_scatter=False)
    data = truth(lab, seen, wrong)
    if not all(np.all(np.isfinite(y)) for y in data):
        return Gap(math.inf, math.inf, {})
    x, _, r = fit.best(data, lab.sigma)
    w = fit.weights()
    total = sum(wi * float(ri @ ri) for wi, ri in zip(w, r, strict=True))
    rms = math.sqrt(total / sum(wi * ri.size for wi, ri in zip(w, r, strict=True)))
    moved = {f.name: math.exp(v) for f, v in zip(fit.free, x, strict=True) if f.condition is None}
    return Gap(rms / math.hypot(1.0, scatter), rms, moved)


def visible_chi2(lab: Laboratory, seen: Sequence[Condition], wrong: Sequence[Disturbance]) -> float:
    """Noise-free chi2 that scatter, declared constants and nominal parameters leave of the disturbances, all trials."""
    fit = Fit(lab, seen, with_scatter=True)
    return fit.best(truth(lab, seen, wrong), lab.sigma)[1]


def amplitude_for(
    lab: Laboratory,
    seen: Sequence[Condition],
    kind: Kind,
    shape: tuple[float, ...],
    sign: float,
    level: float,
    scatter: float,
) -> tuple[float, float]:
    """(size of the amplitude, level it reaches): wanted within 10 %, or as near as the kind's limits allow."""
    fit = Fit(lab, seen, with_scatter=False)
    x0 = np.zeros(len(fit.free))
    w = np.sqrt(fit.weights())
    J = np.concatenate([wi * Ji for wi, Ji in zip(w, fit.jacobian(x0, lab.sigma), strict=True)], axis=1)
    J = np.concatenate([J, np.diag(1.0 / fit.sd)], axis=1)
    basis = np.linalg.qr(J.T)[0]
    base = truth(lab, seen, ())
    size = sum(w[i] ** 2 * y.size for i, y in enumerate(base))

    def linear(s: float) -> float:
        data = truth(lab, seen, [kind.at(sign * s, shape)])
        d = [
            wi * ((y - b) / np.array(lab.sigma[: b.shape[0]])[:, None]).ravel()
            for wi, y, b in zip(w, data, base, strict=True)
        ]
        flat = np.concatenate([*d, np.zeros(len(fit.free))])
        flat = flat - basis @ (basis.T @ flat)
        found = float(np.linalg.norm(flat)) / math.sqrt(size) / math.hypot(1.0, scatter)
        return found if math.isfinite(found) else math.inf

    def exact(s: float) -> float:
        return gap_of(lab, seen, [kind.at(sign * s, shape)], scatter).level

    s = _solve(linear, kind.scale, level, kind.least, kind.limit, 0.05, 9)[0]
    return _solve(exact, s, level, kind.least, kind.limit, 0.1, 5)


def _solve(f, s: float, wanted: float, least: float, most: float, tolerance: float, rounds: int) -> tuple[float, float]:  # noqa: ANN001
    """Secant steps in logarithms for f(s) = wanted, s in [least, most]; the best (s, f(s)) seen."""
    seen: list[tuple[float, float]] = []
    low, high = max(least, 1e-9), most
    for _ in range(rounds):
        value = f(s)
        seen.append((s, value))
        if abs(value / wanted - 1.0) < tolerance or (s >= most and value < wanted) or (s <= low and value > wanted):
            break
        if value < wanted:
            low = max(low, s)
        else:
            high = min(high, s)
        slope = 1.0
        if len(seen) > 1 and math.isfinite(seen[-2][1]) and math.isfinite(value) and seen[-2][0] != s:
            slope = math.log(max(value, 1e-12) / max(seen[-2][1], 1e-12)) / math.log(s / seen[-2][0])
        slope = min(max(slope, 0.4), 4.0)
        step = math.log(wanted / max(value, 1e-12)) / slope if math.isfinite(value) else -1.5
        s = s * math.exp(min(max(step, -2.5), 2.5))
        s = min(max(s, least, 1e-9), most)
        if not low <= s <= high:
            s = math.sqrt(low * high)
    return min(seen, key=lambda v: abs(math.log(max(v[1], 1e-12) / wanted)) if math.isfinite(v[1]) else 1e9)
