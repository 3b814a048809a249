"""Records of the small rig with a law of torque that nobody declares, by scipy: no code shared with the package."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from small_rig import NOISE, RIG, STIFFNESSES

from bayes_damper.calibration import Experiment, TrialRecord

Law = Callable[[float, float, float], float]
"""(angle, velocity, time) at its site -> N m."""


def solved(site: str, law: Law, k1t: float, theta0: float, coupled: bool, times: np.ndarray) -> np.ndarray:
    """Accelerations (channels, n), rad/s^2, without noise."""
    p = RIG

    def rhs(t: float, s: np.ndarray) -> list[float]:
        th1, th2, w1, w2 = s
        q1 = q2 = joint = 0.0
        if site in ("ground1", "bearings"):
            q1 = law(th1, w1, t)
        if coupled:
            pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(th1 - th2) / (2.0 * p["r"]))
            joint = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2)
            joint += p["mu"] * pull * p["R"] * math.tanh(p["nu"] * (w1 - w2))
            q2 = law(th2, w2, t) if site in ("ground2", "bearings") else 0.0
            joint -= law(th1 - th2, w1 - w2, t) if site == "interface" else 0.0
        a1 = (q1 - joint - p["c1t"] * w1 - k1t * th1 - p["drag"] * math.tanh(p["nu"] * w1)) / p["J1"]
        a2 = (q2 + joint - p["c3t"] * w2 - p["drag"] * math.tanh(p["nu"] * w2)) / p["J2"] if coupled else 0.0
        return [w1, w2, a1, a2]

    start = [theta0, theta0 if coupled else 0.0, 0.0, 0.0]
    s = solve_ivp(rhs, (0.0, times[-1]), start, "LSODA", times, rtol=1e-8, atol=1e-10, max_step=2e-3).y
    return np.array([rhs(t, s[:, i])[2:] for i, t in enumerate(times)]).T[: 1 + coupled]


def measured_with(site: str, law: Law, seed: int = 1, repeats: int = 3, samples: int = 500) -> Experiment:
    """Two cases in both configurations, half a second; the last repeat of each is held out."""
    rng = np.random.default_rng(seed)
    times = np.arange(samples) / 1000.0
    trials = []
    for case, k, theta0 in (("I", 0, 0.1), ("IV", 1, 0.08)):
        for coupled in (False, True):
            for number in range(1, repeats + 1):
                released = theta0 * (1.0 + 0.01 * rng.standard_normal())
                y = solved(site, law, STIFFNESSES[k], released, coupled, times)
                y = y + NOISE * rng.standard_normal(y.shape)
                about = (f"{case} {coupled} {number}", case, coupled, number, times, y, k, theta0, 0.01 * theta0)
                trials.append(TrialRecord(*about, heldout=number == repeats))
    constants = {name: (RIG[name], 0.0) for name in ("J1", "J2", "R", "r", "N0")}
    return Experiment(constants, tuple((k, 0.0) for k in STIFFNESSES), tuple(trials))
