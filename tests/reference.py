"""An independent solution of the equations of motion, for tests: classical Runge-Kutta with libm's tanh and tiny steps.

Shares nothing with the package. The step keeps h L <= 0.05, where L bounds the slope of the friction; checked against
scipy's DOP853 in test_integrator.py.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

BASE = {
    "J1": 3.015e-3, "J2": 2.474e-3, "J12": 0.0, "k1t": 6.2, "k3t": 0.0, "c1t": 0.01, "c3t": 0.01, "k2t": 1.0,
    "c2t": 0.03, "mu": 0.009, "N0": 100.0, "R": 0.1, "r": 0.0127, "drag": 0.015, "nu": 100.0, "tail": 0.0,
    "theta0": np.radians(5.0),
}  # fmt: skip
NAMES = tuple(BASE)


@njit
def _sign(x, tail):
    """The parabola in `tail` through three curves at 0, 1/2 and 1."""
    curves = math.tanh(x), x / math.sqrt(1.0 + x * x), 2.0 / math.pi * math.atan(0.5 * math.pi * x)
    middle = curves[1] - 0.5 * (curves[0] + curves[2])
    return curves[0] + tail * (curves[2] - curves[0]) + 4.0 * tail * (1.0 - tail) * middle


@njit
def _forces(q, x, torque, coupled, linear, pendulum):
    J1, J2, J12, k1, k3, c1, c3, k2, c2, mu, N0, R, r, d, nu, tail = q[:16]
    th1, th2, w1, w2 = x[0], x[1], x[2], x[3]
    g1 = math.sin(th1) if pendulum else th1
    tau1 = torque - c1 * w1 - k1 * g1 - d * _sign(nu * w1, tail)
    if not coupled:
        return tau1 / J1, 0.0
    g2 = math.sin(th2) if pendulum else th2
    phi = th1 - th2
    N = N0 * max(0.0, 1.0 - R * abs(phi) / (2.0 * r)) if linear else N0
    T = k2 * phi + c2 * (w1 - w2) + mu * N * R * _sign(nu * (w1 - w2), tail)
    tau1 -= T
    tau2 = T - c3 * w2 - k3 * g2 - d * _sign(nu * w2, tail)
    det = J1 * J2 - J12 * J12
    return (J2 * tau1 - J12 * tau2) / det, (J1 * tau2 - J12 * tau1) / det


@njit
def _solve(q, x0, times, torque, coupled, linear, pendulum, longest):
    n = times.size
    out = np.zeros((3, 2, n))
    x = x0.copy()
    k = np.zeros((4, 4))
    for i in range(n):
        a1, a2 = _forces(q, x, torque[i], coupled, linear, pendulum)
        out[0, 0, i], out[0, 1, i] = a1, a2
        out[1, 0, i], out[1, 1, i] = x[2], x[3]
        out[2, 0, i], out[2, 1, i] = x[0], x[1]
        if i == n - 1:
            break
        gap = times[i + 1] - times[i]
        steps = math.ceil(gap / longest)
        h = gap / steps
        for s in range(steps):
            for j in range(4):
                c = (0.0, 0.5, 0.5, 1.0)[j]
                y = x + (c * h) * k[j - 1] if j > 0 else x
                u = torque[i] + (torque[i + 1] - torque[i]) * (s + c) / steps
                a1, a2 = _forces(q, y, u, coupled, linear, pendulum)
                k[j, 0], k[j, 1], k[j, 2], k[j, 3] = y[2], y[3], a1, a2
            x = x + h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
    return out


def solve(parameters, times, *, coupled=True, linear=True, pendulum=False, torque=None, start=None):
    """Accelerations, velocities and angles of one vector, (3, 2, n_times); released at times[0]."""
    p = BASE | parameters
    q = np.array([p[name] for name in NAMES], float)
    friction = p["mu"] * p["N0"] * p["R"] if coupled else 0.0
    slope = p["nu"] * (friction * (1.0 / p["J1"] + 1.0 / p["J2"]) + p["drag"] / min(p["J1"], p["J2"]))
    x0 = np.array([p["theta0"], p["theta0"], 0.0, 0.0] if start is None else start, float)
    if not coupled:
        x0[1] = x0[3] = 0.0
    u = np.zeros(np.size(times)) if torque is None else np.asarray(torque, float)
    return _solve(q, x0, np.asarray(times, float), u, coupled, linear, pendulum, min(2e-5, 0.05 / (slope + 1e-9)))


def draw(n, seed):
    """n vectors over the prior's box, nu log-uniform 5 to 3000: name -> (n,)."""
    rng = np.random.default_rng(seed)
    return {
        "k1t": rng.uniform(5.0, 12.0, n), "c1t": rng.uniform(0.003, 0.03, n), "c3t": rng.uniform(0.003, 0.03, n),
        "k2t": rng.uniform(0.0, 3.0, n), "c2t": rng.uniform(0.0, 0.12, n), "mu": rng.uniform(0.004, 0.015, n),
        "drag": rng.uniform(0.003, 0.03, n), "theta0": np.radians(rng.uniform(2.0, 8.0, n)),
        "nu": np.exp(rng.uniform(np.log(5.0), np.log(3000.0), n)),
    }  # fmt: skip
