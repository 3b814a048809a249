"""One laboratory: its rig, its cases and trials, its clock and noise, and how much of it scatters from trial to trial.

Every number is drawn from one generator of random numbers, in a fixed order, so that a seed makes the same laboratory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
Rng = np.random.Generator

TYPICAL = {
    "k1t": 2e-3,
    "k2t": 2e-3,
    "c1t": 0.05,
    "c3t": 0.05,
    "c2t": 0.05,
    "mu": 0.05,
    "drag": 0.05,
    "gain1": 2e-3,
    "gain2": 2e-3,
    "offset1": 0.5,
    "offset2": 0.5,
    "drift1": 0.5,
    "drift2": 0.5,
    "theta0": 0.01,
    "instant": 0.2,
    "ramp": 2e-4,
}
"""Typical standard deviation from trial to trial: relative; offsets and drifts over the noise; the release angle over
itself; the instant over the interval of readings; the ramp's time in s, drawn between 0 and twice that."""
ABSENT = 0.3  # how often a scatter is absent
DECADE = 0.5  # half of it, in powers of ten
ALONE = ("k1t", "c1t", "drag", "gain1", "offset1", "drift1", "theta0", "instant", "ramp")
LAWS = ("tanh", "algebraic", "arctangent")
QUANTITIES = ("displacement", "velocity", "acceleration")
NOISES = ("white", "coloured", "heavy-tailed", "quantised")
MOST_READINGS = {"record": 4000, "campaign": 40_000}


@dataclass(frozen=True)
class Case:
    """Trials with one spring and one release angle; k1 : true, declared : k1t as declared; trials per configuration."""

    label: str
    k1: float
    declared: float
    theta0: float
    trials: dict[bool, int]


@dataclass(frozen=True)
class Laboratory:
    """A drawn laboratory; see `draw` for what each field holds."""

    kind: str
    true: dict[str, float]
    declared: dict[str, float]
    shares: dict[str, float]
    nominal: dict[str, float]
    normal_force: str
    restoring: str
    law: str
    quantity: str
    cases: tuple[Case, ...]
    A: float
    W: float
    periods: float
    per_period: float
    clock: str
    noise: str
    sigma: tuple[float, float]
    noise_shape: float
    scatter: dict[str, float]
    trend: dict[str, float] = field(default_factory=dict)

    @property
    def bodies(self) -> int:
        """One or two."""
        return 2 if any(True in case.trials for case in self.cases) else 1

    @property
    def repeats(self) -> bool:
        """Whether at least half of the cases and configurations have repeats."""
        counts = [n for case in self.cases for n in case.trials.values()]
        return 2 * sum(n > 1 for n in counts) >= len(counts)

    @property
    def strength(self) -> float:
        """Geometric mean of the scatters over the typical ones, of those present; 0 where none is."""
        shares = [math.log(sd / TYPICAL[name]) for name, sd in self.scatter.items() if sd > 0.0]
        return math.exp(sum(shares) / len(shares)) if shares else 0.0

    @property
    def interval(self) -> float:
        """Mean time between readings, s."""
        return 2.0 * math.pi / (self.W * self.per_period)

    def rig(self, case: Case, coupled: bool, own: dict[str, float] | None = None) -> dict[str, float]:
        """The numbers motion.py needs for a trial of a case; `own` : deviations of that trial by name (relative)."""
        d = dict.fromkeys(TYPICAL, 0.0) | (own or {})
        n, t = self.nominal, self.true
        face = t["R"] / (2.0 * t["r"]) if self.bodies == 2 else 0.0
        return {
            "J1": t["J1"],
            "J2": t["J2"],
            "k1": case.k1 * (1.0 + d["k1t"]),
            "k3": t["k3t"],
            "c1": n["c1t"] * (1.0 + d["c1t"]),
            "c3": n["c3t"] * (1.0 + d["c3t"]),
            "k2": n["k2t"] * (1.0 + d["k2t"]),
            "c2": n["c2t"] * (1.0 + d["c2t"]),
            "friction": n["mu"] * t["N0"] * t["R"] * (1.0 + d["mu"]),
            "drag": n["drag"] * (1.0 + d["drag"]),
            "nu": n["nu"],
            "face": face,
            "fading": float(self.normal_force == "linear"),
            "law": float(LAWS.index(self.law)),
            "pendulum": float(self.restoring == "pendulum"),
            "quantity": float(QUANTITIES.index(self.quantity)),
            "coupled": float(coupled),
            "theta0": case.theta0 * (1.0 + d["theta0"]),
            "A": self.A,
            "W": self.W,
            "kref": max(c.k1 for c in self.cases),
            "ramp": d["ramp"],
        }

    def times(self, rng: Rng) -> Array:
        """Instants of the readings of one record, s, from 0."""
        n = max(24, round(self.periods * self.per_period)) + 1
        even = np.arange(n) * self.interval
        if self.clock == "jittered":
            return np.sort(even + self.interval * np.concatenate([[0.0], rng.uniform(-0.3, 0.3, n - 1)]))
        if self.clock == "slowing":  # readings twice as dense at first as at the end
            u = np.linspace(0.0, 1.0, n)
            return even[-1] * (2.0 * u + u * u) / 3.0
        return even

    def own_values(self, rng: Rng, place: float) -> dict[str, float]:
        """Deviations of one trial; place : -1 to 1, where it stands in the order of all trials."""
        out = {}
        for name, sd in self.scatter.items():
            z = float(rng.standard_normal())
            flat = float(rng.uniform(0.0, 2.0))
            share = self.trend.get(name, 0.0)
            z = math.sqrt(1.0 - share**2) * z + share * math.sqrt(3.0) * place
            if name == "ramp":
                out[name] = sd * flat
            elif name == "instant":
                out[name] = min(max(sd * z, -0.9), 0.9) * self.interval
            elif name[:-1] in ("offset", "drift"):
                out[name] = sd * z * self.sigma[int(name[-1]) - 1]
            else:
                out[name] = max(sd * z, -0.9)
        return out

    def noise_of(self, rng: Rng, n: int, channel: int) -> Array:
        """Noise of one record of one channel, in the record's unit; a quantised channel is rounded after that."""
        sigma = self.sigma[channel]
        white: Array = rng.standard_normal(n)
        if self.noise == "coloured":
            keep = math.exp(-2.0 * math.pi / (self.per_period * self.noise_shape))
            kicks = rng.standard_normal(n) * math.sqrt(1.0 - keep**2)
            kicks[0] /= math.sqrt(1.0 - keep**2)
            return sigma * (math.sqrt(0.65) * white + math.sqrt(0.35) * lfilter([1.0], [1.0, -keep], kicks))
        if self.noise == "heavy-tailed":
            nu = self.noise_shape
            return sigma * math.sqrt((nu - 2.0) / nu) * rng.standard_t(nu, n)
        return sigma * white

    def quantum(self, channel: int) -> float:
        """Step of the converter, 0 where it is too fine to matter."""
        return self.noise_shape * self.sigma[channel] if self.noise == "quantised" else 0.0

    def facts(self) -> dict[str, object]:
        """What the key holds of the laboratory beside its numbers."""
        return {
            "bodies": self.bodies,
            "repeats": self.repeats,
            "scatter_strength": self.strength,
            "scatter_class": "none" if self.strength == 0.0 else "strong" if self.strength > 1.0 else "weak",
            "law": self.law,
            "noise": self.noise,
            "clock": self.clock,
            "quantity": self.quantity,
            "kind": self.kind,
            "frequency_hz": self.W / (2.0 * math.pi),
            "periods": self.periods,
            "readings_a_period": self.per_period,
        }


def _log(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _pick(rng: Rng, of: tuple[str, ...], p: tuple[float, ...]) -> str:
    return of[int(rng.choice(len(of), p=p))]


def draw(rng: Rng, strength: float | None = None, repeats: bool | None = None, bodies: int | None = None) -> Laboratory:
    """A laboratory.

    strength : of every scatter over the typical one, in place of a draw; repeats, bodies : in place of a draw.

    Frequency 0.5 to 30 Hz, quality factor 3 to 300 (dry friction takes up to 0.6 of the loss at the largest angle),
    inertias 0.3 to 3, both log-uniform; constants declared exactly (0.3 of laboratories) or within 0.3 to 2 %.
    """
    translational = rng.random() < 0.35
    w0 = 2.0 * math.pi * _log(rng, 0.5, 30.0)
    a = _log(rng, 2e-3, 3e-2) if translational else math.radians(_log(rng, 1.5, 12.0))
    two = rng.random() < 0.7
    two = two if bodies is None else bodies == 2
    declared = {"J1": _round(_log(rng, 0.1, 5.0) if translational else _log(rng, 3e-4, 3e-2))}
    declared["J2"] = _round(declared["J1"] * _log(rng, 0.3, 3.0))
    declared["R"] = 1.0 if translational else _round(_log(rng, 0.05, 0.25))
    declared["r"] = _round(0.5 * declared["R"] * a * _log(rng, 1.3, 5.0))
    exact = rng.random() < 0.3
    size = _log(rng, 3e-3, 2e-2)
    shares = dict.fromkeys(("J1", "J2", "R", "r", "k1t"), 0.0 if exact else size)
    if translational:
        shares["R"] = 0.0
    true = {name: value * (1.0 + shares[name] * float(rng.standard_normal())) for name, value in declared.items()}
    ground2 = rng.random() < 0.15
    declared["k3t"] = true["k3t"] = _round(true["J2"] * (w0 * _log(rng, 0.2, 0.7)) ** 2) if ground2 else 0.0

    quality = _log(rng, 3.0, 300.0)
    dry = float(rng.uniform(0.05, 0.6))
    loss = true["J1"] * w0 / quality
    w2 = w0 * _log(rng, 0.3, 2.0)
    mu = _log(rng, 0.002, 0.03)
    slide = true["J2"] * w0**2 * a * _log(rng, 0.01, 0.2)
    declared["N0"] = true["N0"] = _round(slide / (mu * true["R"]))
    nominal = {
        "mu": mu,
        "k2t": true["J2"] * w2**2,
        "c2t": 2.0 * _log(rng, 0.02, 0.3) * true["J2"] * w2,
        "drag": 0.25 * math.pi * dry * loss * w0 * a,
        "nu": _log(rng, 5.0, 60.0) / (a * w0),
        "c1t": (1.0 - dry) * loss,
        "c3t": (1.0 - dry) * loss * _log(rng, 0.4, 2.5),
    }
    normal_force = "linear" if rng.random() < 0.8 else "constant"
    restoring = "pendulum" if not translational and rng.random() < 0.1 else "linear"

    springs = [1.0, _log(rng, 0.5, 0.85)]
    counts = {"repeats": repeats, "n": int(rng.integers(1, 9)), "uneven": rng.random() < 0.3}
    alone_too = rng.random() < 0.7
    cases = []
    k_true = [w0**2 * true["J1"] * s for s in springs]
    k_said = [k / (1.0 + shares["k1t"] * float(rng.standard_normal())) for k in k_true]
    for i in range(int(rng.integers(1, 6))):
        which = int(rng.integers(2)) if i else 0
        angle = a if i == 0 else a * float(rng.uniform(0.35, 1.0))
        said = math.degrees(angle) if not translational else 1e3 * angle
        said = _round(said)
        theta0 = math.radians(said) if not translational else 1e-3 * said
        trials = {c: _trials(rng, counts) for c in (([False] if alone_too else []) + [True] if two else [False])}
        cases.append(Case(["I", "II", "III", "IV", "V"][i], k_true[which], _round(k_said[which]), theta0, trials))

    quantity = _pick(rng, QUANTITIES, (0.3, 0.25, 0.45))
    peak = a * w0 ** QUANTITIES.index(quantity)
    sigma = peak / _log(rng, 40.0, 1500.0)
    noise = _pick(rng, NOISES, (0.4, 0.25, 0.2, 0.15))
    shape = {
        "white": 0.0,
        "coloured": _log(rng, 0.05, 0.5),
        "heavy-tailed": float(rng.uniform(3.0, 6.0)),
        "quantised": _log(rng, 0.3, 1.5),
    }[noise]
    for _ in range(200):
        periods, per_period = _log(rng, 3.0, 60.0), _log(rng, 20.0, 300.0)
        record = periods * per_period
        if (
            record <= MOST_READINGS["record"]
            and record * sum(n for c in cases for n in c.trials.values()) <= MOST_READINGS["campaign"]
        ):
            break
    else:
        periods, per_period = 5.0, 40.0
    scatter = {}
    for name, typical in TYPICAL.items():
        there, power = rng.random() >= ABSENT, float(rng.uniform(-DECADE, DECADE))
        if name in ALONE or two:
            scatter[name] = typical * 10.0**power if there else 0.0
            if strength is not None:
                scatter[name] = typical * strength
    trend = {}
    if rng.random() < 0.15:
        name = str(rng.choice(["k1t", "c1t", "drag", *(["mu", "k2t"] if two else [])]))
        trend[name] = float(rng.uniform(0.6, 1.0))
    return Laboratory(
        kind="translational" if translational else "torsional",
        true=true,
        declared=declared,
        shares=shares,
        nominal=nominal,
        normal_force=normal_force,
        restoring=restoring,
        law=_pick(rng, LAWS, (0.34, 0.33, 0.33)),
        quantity=quantity,
        cases=tuple(cases),
        A=a,
        W=w0,
        periods=periods,
        per_period=per_period,
        clock=_pick(rng, ("even", "jittered", "slowing"), (0.6, 0.25, 0.15)),
        noise=noise,
        sigma=(sigma, sigma * _log(rng, 0.7, 1.5)),
        noise_shape=shape,
        scatter=scatter,
        trend=trend,
    )


def _round(x: float) -> float:
    """To four digits, as a data sheet has it."""
    return float(f"{x:.4g}")


def _trials(rng: Rng, counts: dict[str, object]) -> int:
    n = int(counts["n"])  # type: ignore[call-overload]
    if counts["uneven"]:
        n = int(rng.integers(1, 9))
    if counts["repeats"] is not None:
        n = max(n, 3) if counts["repeats"] else 1
    return n
