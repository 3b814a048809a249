"""Motion and readings of a drawn rig: equations, disturbances and sensors as one system, stepped by Dormand and Prince.

States: angles th1, th2, speeds w1, w2, then six for each disturbance (memory of a mechanism, or filters of a sensor).
Whatever is told of a disturbance is dimensionless: angles over the largest release angle A, times over 1/W, W the
angular frequency of the primary. A translational rig has the same equations in m, kg and N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIELDS = (
    *("J1", "J2", "k1", "k3", "c1", "c3", "k2", "c2", "friction", "drag", "nu", "face", "fading"),
    *("law", "pendulum", "quantity", "coupled", "theta0", "A", "W", "kref", "ramp"),
)
"""Numbers of a rig, in the order of its vector.

k1, c1, k2, ... : k1t, c1t, k2t of the nominal equations; friction : mu N0 R; face : R / (2 r); fading : 1 if the pull
falls with the overlap; law : 0 tanh(x), 1 x / sqrt(1 + x^2), 2 (2/pi) atan(pi x / 2); quantity : order of the
derivative that is measured; kref : the stiffest spring of the laboratory; ramp : s in which the actuator lets go.
"""
J1, J2, K1, K3, C1, C3, K2, C2, FRICTION, DRAG, NU, FACE, FADING = range(13)
LAW, PENDULUM, QUANTITY, COUPLED, THETA0, A_, W_, KREF, RAMP = range(13, 22)
MEMORY = 8
NUMBERS = 5  # amplitude and shape of a disturbance


@dataclass(frozen=True)
class Disturbance:
    """Something that is wrong: code of its kind, amplitude p[0], shape p[1:]."""

    code: int
    p: tuple[float, ...]


def vector(rig: dict[str, float]) -> Array:
    """The numbers of a rig in the order of FIELDS."""
    return np.array([float(rig[name]) for name in FIELDS])


@njit(cache=True)
def smooth_sign(x: float, law: float) -> float:
    """The sign of x, made smooth by one of three laws with slope 1 at rest."""
    if law == 0.0:
        return math.tanh(x)
    if law == 1.0:
        return x / math.sqrt(1.0 + x * x)
    return math.atan(0.5 * math.pi * x) / (0.5 * math.pi)


@njit(cache=True)
def _sign(x: float) -> float:
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


@njit(cache=True)
def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(max(x, -40.0), 40.0)))


@njit(cache=True)
def _sech(x: float) -> float:
    return 1.0 / math.cosh(min(abs(x), 300.0))


@njit(cache=True)
def _slider(w: float, z: float, d: float) -> float:
    """Rate of a spring that slides once stretched by d."""
    return w * (1.0 - _logistic((_sign(w) * z / d - 1.0) / 0.04))


@njit(cache=True)
def _yielding(z: float, v: float, most: float) -> float:
    """How much of a bristle's motion is sliding: none below 0.7 of its largest deflection, all of it at that."""
    if z * v <= 0.0 or abs(z) <= 0.7 * most:
        return 0.0
    if abs(z) >= most:
        return 1.0
    return 0.5 + 0.5 * math.sin(math.pi * (abs(z) - 0.85 * most) / (0.3 * most))


@njit(cache=True)
def derivative(t: float, x: Array, g: Array, codes: NDArray[np.int64], P: Array, out: Array) -> None:
    """Rates of all states at the time t (s since the release), into `out`."""
    a, w0, law, nu = g[A_], g[W_], g[LAW], g[NU]
    coupled = g[COUPLED] > 0.0
    th1, th2, w1, w2 = x[0], x[1], x[2], x[3]
    j1, j2, k1 = g[J1], g[J2], g[K1]
    period = 2.0 * math.pi / w0
    phi, v = th1 - th2, w1 - w2
    apart = g[FACE] * abs(phi)
    pull = max(0.0, 1.0 - apart) if g[FADING] > 0.0 else 1.0
    grip = 1.0
    drag1 = drag2 = g[DRAG]
    q1 = q2 = extra = bristle = hold = 0.0
    bristles = False
    for i in range(codes.size):
        c, s = codes[i], 4 + MEMORY * i
        p0, p1, p2, p3 = P[i, 0], P[i, 1], P[i, 2], P[i, 3]
        for k in range(MEMORY):
            out[s + k] = 0.0
        if c == 1:  # spring_cubic
            b = p1 / a
            if p0 >= 0.0:
                q1 -= p0 * k1 * (math.tan(min(max(b * th1, -1.4), 1.4)) / b - th1)
            else:
                q1 += p0 * k1 * (math.tanh(b * th1) / b - th1)
        elif c == 2:  # spring_bottoming
            beyond = abs(th1) / a - p1
            if beyond > 0.0:
                q1 -= p0 * k1 * a * beyond**2 * _sign(th1)
        elif c == 3:  # coupling_backlash
            h = p1 * p0 * a
            near, far = p0 * a * (1.0 - p3), p0 * a * (1.0 + p3)
            closed = math.sqrt((th1 + near) ** 2 + h * h) - math.sqrt((th1 - far) ** 2 + h * h)
            q1 += 0.5 * p2 * k1 * (closed - math.sqrt(near * near + h * h) + math.sqrt(far * far + h * h))
        elif c == 4:  # coupling_hysteresis
            d = p1 * a
            q1 -= p0 * k1 * a * (0.6 * x[s] / d + 0.4 * x[s + 1] / (3.0 * d))
            out[s], out[s + 1] = _slider(w1, x[s], d), _slider(w1, x[s + 1], 3.0 * d)
        elif c == 5:  # stiffness_error
            if p0 >= 0.0:
                k1 = k1 / (1.0 + p0 * k1 / g[KREF])
            else:
                k1 = k1 * (1.0 - p0 * math.sqrt(g[KREF] / k1))
        elif c == 6:  # bearing_stribeck
            drag1 += p0 * g[DRAG] * _sech(w1 / (p1 * a * w0))
            drag2 += p0 * g[DRAG] * _sech(w2 / (p1 * a * w0))
        elif c == 7:  # quadratic_drag
            q1 -= p0 * j1 * w0 * w0 * a * abs(w1 / (a * w0)) ** 1.75 * _sign(w1)
            q2 -= p1 * p0 * j1 * w0 * w0 * a * abs(w2 / (a * w0)) ** 1.75 * _sign(w2)
        elif c == 8:  # misalignment_drag
            side = p0 * g[FRICTION] * math.sqrt(max(0.0, 1.0 - apart * apart)) if coupled else 0.0
            drag1 += side
            drag2 += p1 * side
        elif c == 9:  # stick_slip
            d = p0 * p2 * a
            most = d * (1.0 + p0 * _sech(v / (p1 * a * w0)))
            out[s] = v * (1.0 - _yielding(x[s], v, most) * x[s] * _sign(v) / most)
            bristle = x[s] / d + 0.02 * out[s] / (p1 * a * w0)
            bristles = True
        elif c == 10:  # friction_displacement
            grip *= 1.0 + p0 * math.tanh((phi / (p1 * a)) ** 2)
        elif c == 11:  # magnet_cubic
            b = p1 / a
            extra += g[K2] * p0 * (math.sin(b * phi) / b - phi)
        elif c == 12:  # eddy_overlap
            extra += p0 * j2 * w0 * v / (1.0 + (phi / (p1 * a)) ** 2) ** 2
        elif c == 13:  # magnet_fade
            pull /= 1.0 + p0 * x[s]
        elif c == 14:  # interface_relaxation
            for k in range(3):
                share = 0.5 if k == 0 else (0.3 if k == 1 else 0.2)
                extra += p0 * j2 * w0 * w0 * share * x[s + k]
                out[s + k] = v - x[s + k] * w0 / (p1 * 4.0**k)
        elif c == 15:  # normal_force_law
            pull = max(0.0, 1.0 - min(apart, 1.0) ** (1.0 + p0))
        elif c == 16:  # inertia_error
            if p0 >= 0.0:
                wa = p1 * w0
                arm = p0 * j2 * (wa * wa * (x[s] - th2) + 0.04 * wa * (x[s + 1] - w2))
                q2 += arm
                out[s] = x[s + 1]
                out[s + 1] = -(wa * wa * (x[s] - th2) + 0.04 * wa * (x[s + 1] - w2))
            else:
                j2 = j2 * (1.0 + p0)
        elif c == 17:  # release_ramp
            left = 1.0 - t * w0 / p0 if p0 > 0.0 else 0.0
            if left > 0.0:
                hold = max(hold, left / (1.0 + p1 * (1.0 - left)))
        elif c == 40:  # lost_spring
            k1 = k1 * (1.0 - p0 * _logistic((t - p1 * period) / (0.01 * period)))
        elif c == 41:  # shaken_spring
            q1 -= k1 * p0 * math.sin(p1 * w0 * t + p2) * th1
        elif c == 42:  # soft_frame
            wb = p1 * w0
            q1 += k1 * x[s]
            out[s] = x[s + 1]
            out[s + 1] = p0 * k1 / j1 * (th1 - x[s]) - wb * wb * x[s] - 0.03 * wb * x[s + 1]
        elif c == 43:  # bent_shaft
            drag1 += p0 * g[DRAG] * 0.5 * (1.0 + math.sin(p1 * th1 / a + p2))
        elif c == 44:  # drag_settling
            drag1 += p0 * g[DRAG] * math.exp(-x[s] / p1)
            drag2 += p0 * g[DRAG] * math.exp(-x[s + 1] / p1)
            out[s], out[s + 1] = abs(w1) / a, abs(w2) / a
        elif c == 45:  # pull_in_time
            pull *= 1.0 + p0 * (1.0 - math.exp(-t / (p1 * period)))
        elif c == 46:  # friction_by_speed
            grip *= 1.0 + p0 * math.log1p(abs(v) / (p1 * a * w0))
        elif c == 47:  # face_detent
            extra += p0 * j2 * w0 * w0 * a * math.sin(p1 * phi / a)
        elif c == 48:  # secondary_stop
            into = -p1 - th2 / a
            if into > 0.0:
                q2 += max(0.0, p0 * j2 * w0 * w0 * a * into * (1.0 - 0.3 * w2 / (a * w0)))
        elif c == 49:  # sloshing
            wb = p1 * w0
            pushed = wb * wb * (x[s] - th2) + 2.0 * p2 * wb * (x[s + 1] - w2)
            q2 += p0 * j2 * pushed
            out[s] = x[s + 1]
            out[s + 1] = -pushed
        elif c == 50:  # draught
            q2 += p0 * j2 * w0 * w0 * a * math.exp(-t / (p1 * period))
        elif c == 52:  # second_touch
            inside = (t / period - p1) / p2
            if 0.0 < inside < 1.0:
                q1 += p0 * k1 * a * math.sin(math.pi * inside)
    spring = math.sin(th1) if g[PENDULUM] > 0.0 else th1
    if g[RAMP] > 0.0 and t < g[RAMP]:
        r = t / g[RAMP]
        hold = max(hold, 1.0 - r * r * (3.0 - 2.0 * r))  # there is one actuator, whatever keeps it
    if hold > 0.0:
        q1 += g[K1] * (math.sin(g[THETA0]) if g[PENDULUM] > 0.0 else g[THETA0]) * hold
    dry = 0.0
    if coupled:
        shape = bristle if bristles else smooth_sign(nu * v, law)
        dry = g[FRICTION] * grip * pull * shape
        torque = g[K2] * phi + g[C2] * v + dry + extra
    else:
        torque = 0.0
    out[0], out[1] = w1, w2
    out[2] = (q1 - g[C1] * w1 - k1 * spring - drag1 * smooth_sign(nu * w1, law) - torque) / j1
    if coupled:
        away = math.sin(th2) if g[PENDULUM] > 0.0 else th2
        out[3] = (q2 - g[C3] * w2 - g[K3] * away - drag2 * smooth_sign(nu * w2, law) + torque) / j2
    else:
        out[1] = out[3] = 0.0
    for i in range(codes.size):
        c, s = codes[i], 4 + MEMORY * i
        p0, p1 = P[i, 0], P[i, 1]
        if c == 13:  # heat of the dry friction, over what it takes to slide by A
            out[s] = max(0.0, dry * v) / (g[FRICTION] * a)
        elif c == 21:  # sensor_bandwidth: Bessel's polynomial of fourth order, in units of its delay
            wn = w0 / p0 / 2.1139
            for k in range(2):
                y = x[k] if g[QUANTITY] == 0.0 else (x[2 + k] if g[QUANTITY] == 1.0 else out[2 + k])
                r = s + 4 * k
                out[r] = wn * x[r + 1]
                out[r + 1] = wn * x[r + 2]
                out[r + 2] = wn * x[r + 3]
                out[r + 3] = wn * (105.0 * (y - x[r]) - 105.0 * x[r + 1] - 45.0 * x[r + 2] - 10.0 * x[r + 3])
        elif c == 22:  # sensor_highpass: Butterworth's polynomial of third order
            wn = p0 * w0
            for k in range(2):
                y = x[k] if g[QUANTITY] == 0.0 else (x[2 + k] if g[QUANTITY] == 1.0 else out[2 + k])
                r = s + 3 * k
                out[r] = wn * x[r + 1]
                out[r + 1] = wn * x[r + 2]
                out[r + 2] = wn * (y - x[r] - 2.0 * x[r + 1] - 2.0 * x[r + 2])
        elif c in (20, 54):
            for k in range(2):
                y = x[k] if g[QUANTITY] == 0.0 else (x[2 + k] if g[QUANTITY] == 1.0 else out[2 + k])
                s1, s2 = x[s + 2 * k], x[s + 2 * k + 1]
                if c == 20:  # sensor_delay
                    out[s + 2 * k] = (y - s1) * 2.0 * w0 / p0 if p0 > 0.0 else 0.0
                else:  # mount_resonance
                    wn, zeta = p1 * w0, P[i, 2]
                    out[s + 2 * k] = s2
                    out[s + 2 * k + 1] = wn * wn * (y - s1) - 2.0 * zeta * wn * s2


@njit(cache=True)
def _of_channel(which: float, k: int) -> bool:
    return which == 2.0 or int(which) == k


@njit(cache=True)
def shown(t: float, x: Array, rates: Array, g: Array, codes: NDArray[np.int64], P: Array, still: bool) -> tuple:
    """What the two channels show of the states: truth, then each sensor disturbance in turn."""
    a, w0 = g[A_], g[W_]
    full = a * w0 ** g[QUANTITY]
    y = np.empty(2)
    for k in range(2):
        if g[QUANTITY] == 0.0:
            y[k] = x[k]
        elif g[QUANTITY] == 1.0:
            y[k] = 0.0 if still else x[2 + k]
        else:
            y[k] = 0.0 if still else rates[2 + k]
    for i in range(codes.size):
        c, s = codes[i], 4 + MEMORY * i
        p0, p1, p2 = P[i, 0], P[i, 1], P[i, 2]
        before = y[0]
        for k in range(2):
            if c == 19 and _of_channel(p1, k):  # sensor_gain
                y[k] += p0 * (y[k] + 0.1 * abs(y[k]))
            elif c == 20 and _of_channel(p1, k) and p0 > 0.0:  # sensor_delay
                y[k] = 2.0 * x[s + 2 * k] - y[k]
            elif c == 21:  # sensor_bandwidth
                y[k] = x[s + 4 * k]
            elif c == 22:  # sensor_highpass
                r = s + 3 * k
                y[k] = y[k] - x[r] - 2.0 * x[r + 1] - 2.0 * x[r + 2]
            elif c == 23 and _of_channel(p1, k):  # sensor_clipping
                limit = full / p0
                over = abs(y[k]) / limit - p2
                if over > 0.0:
                    y[k] = limit * _sign(y[k]) * (1.0 - (1.0 - p2) * math.exp(-over / (1.0 - p2)))
            elif c == 53:  # crosstalk
                y[k] += p0 * y[1] * 0.3 if k == 0 else p0 * before
            elif c == 54:  # mount_resonance
                y[k] += p0 * (x[s + 2 * k] - y[k])
            elif c == 55 and _of_channel(p1, k):  # curved_sensor
                y[k] += p0 * y[k] * y[k] / full
            elif c == 56 and _of_channel(p1, k):  # warming_gain
                y[k] *= 1.0 + p0 * (1.0 - math.exp(-max(t, 0.0) * w0 / (2.0 * math.pi * p2)))
    return y[0], y[1]


@njit(cache=True)
def start(g: Array, codes: NDArray[np.int64], P: Array) -> Array:
    """States at the release."""
    x = np.zeros(4 + MEMORY * codes.size)
    x[0] = g[THETA0]
    x[1] = g[THETA0] if g[COUPLED] > 0.0 else 0.0
    for i in range(codes.size):
        c, s = codes[i], 4 + MEMORY * i
        p0, p1, p2 = P[i, 0], P[i, 1], P[i, 2]
        if c == 18 and g[COUPLED] > 0.0:  # release_offset
            x[1] += p0 * g[A_] * math.sqrt(abs(g[THETA0]) / g[A_])
        elif c == 51:  # release_kick
            x[2] += p0 * g[A_] * g[W_]
            x[3] += p1 * p0 * g[A_] * g[W_] if g[COUPLED] > 0.0 else 0.0
    for i in range(codes.size):
        c, s = codes[i], 4 + MEMORY * i
        p0, p1, p2 = P[i, 0], P[i, 1], P[i, 2]
        if c == 4:  # wound up to the release angle, a share p2 of it not yet crept away
            d = p1 * g[A_]
            x[s] = p2 * min(g[THETA0], d)
            x[s + 1] = p2 * min(g[THETA0], 3.0 * d)
        elif c in (16, 49):
            x[s] = x[1]
        elif c == 42:
            x[s] = p0 * g[K1] / g[J1] * x[0] / (p0 * g[K1] / g[J1] + (p1 * g[W_]) ** 2)
        elif 20 <= c <= 22 or c == 54:  # settled at the reading at rest
            for k in range(2):
                x[s + (4 if c == 21 else 3 if c == 22 else 2) * k] = x[k] if g[QUANTITY] == 0.0 else 0.0
    return x


@njit(cache=True)
def path(times: Array, g: Array, codes: NDArray[np.int64], P: Array, tol: float) -> Array:
    """What the channels show at `times` (s since the release, ascending; before it the rig is held), (2, n).

    tol : error allowed in a step, over the size of each state at release. The fifth-order pair of Dormand and Prince,
    from reading to reading. NaN where no step is small enough.
    """
    x = start(g, codes, P)
    n = x.size
    out = np.empty((2, times.size))
    scale = np.empty(n)
    for k in range(n):
        scale[k] = max(g[A_], abs(x[k])) if k < 2 else (g[A_] * g[W_] if k < 4 else 0.0)
    for i in range(codes.size):
        s = 4 + MEMORY * i
        c = codes[i]
        for k in range(MEMORY):
            size = g[A_]
            if c in (13, 44):
                size = 1.0
            elif c == 9:
                size = P[i, 0] * P[i, 2] * g[A_]
            elif c in (16, 42, 49) and k == 1:
                size = g[A_] * g[W_]
            elif 20 <= c <= 22 or c == 54:
                size = g[A_] * g[W_] ** g[QUANTITY] * (1.0 if k % 2 == 0 or c in (21, 22) else g[W_])
            scale[s + k] = size
    k1, k2, k3, k4 = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    k5, k6, k7, y = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    t = 0.0
    h = 1e-3 / g[W_]
    derivative(t, x, g, codes, P, k1)
    for m in range(times.size):
        goal = times[m]
        if goal < 0.0:
            out[0, m], out[1, m] = shown(goal, x, k1, g, codes, P, True)
            continue
        while t < goal:
            last = t + h * 1.000001 >= goal
            step = goal - t if last else h
            for k in range(n):
                y[k] = x[k] + step * 0.2 * k1[k]
            derivative(t + 0.2 * step, y, g, codes, P, k2)
            for k in range(n):
                y[k] = x[k] + step * (3.0 / 40.0 * k1[k] + 9.0 / 40.0 * k2[k])
            derivative(t + 0.3 * step, y, g, codes, P, k3)
            for k in range(n):
                y[k] = x[k] + step * (44.0 / 45.0 * k1[k] - 56.0 / 15.0 * k2[k] + 32.0 / 9.0 * k3[k])
            derivative(t + 0.8 * step, y, g, codes, P, k4)
            for k in range(n):
                y[k] = x[k] + step * (
                    19372.0 / 6561.0 * k1[k] - 25360.0 / 2187.0 * k2[k] + 64448.0 / 6561.0 * k3[k]
                    - 212.0 / 729.0 * k4[k]
                )  # fmt: skip
            derivative(t + 8.0 / 9.0 * step, y, g, codes, P, k5)
            for k in range(n):
                y[k] = x[k] + step * (
                    9017.0 / 3168.0 * k1[k] - 355.0 / 33.0 * k2[k] + 46732.0 / 5247.0 * k3[k] + 49.0 / 176.0 * k4[k]
                    - 5103.0 / 18656.0 * k5[k]
                )  # fmt: skip
            derivative(t + step, y, g, codes, P, k6)
            for k in range(n):
                y[k] = x[k] + step * (
                    35.0 / 384.0 * k1[k] + 500.0 / 1113.0 * k3[k] + 125.0 / 192.0 * k4[k]
                    - 2187.0 / 6784.0 * k5[k] + 11.0 / 84.0 * k6[k]
                )  # fmt: skip
            derivative(t + step, y, g, codes, P, k7)
            error = 0.0
            for k in range(n):
                e = step * (
                    71.0 / 57600.0 * k1[k] - 71.0 / 16695.0 * k3[k] + 71.0 / 1920.0 * k4[k]
                    - 17253.0 / 339200.0 * k5[k] + 22.0 / 525.0 * k6[k] - 1.0 / 40.0 * k7[k]
                ) / (tol * scale[k])  # fmt: skip
                error = max(error, abs(e)) if abs(e) < 1e10 else 1e10
            if error <= 1.0:
                t = goal if last else t + step
                for k in range(n):
                    x[k] = y[k]
                    k1[k] = k7[k]
            change = min(4.0, max(0.1, 0.9 * max(error, 1e-10) ** -0.2))
            if not (last and error <= 1.0 and change > 1.0 and step < h):
                h = step * change
            if h * g[W_] < 1e-12:
                out[:, m:] = np.nan
                return out
        out[0, m], out[1, m] = shown(t, x, k1, g, codes, P, False)
    return out


def packed(disturbances: Sequence[Disturbance]) -> tuple[NDArray[np.int64], Array]:
    """Codes and numbers as the compiled code needs them."""
    numbers = np.zeros((len(disturbances), NUMBERS))
    for row, d in zip(numbers, disturbances, strict=True):
        row[: len(d.p)] = d.p
    return np.array([d.code for d in disturbances], np.int64), numbers


def record(
    rig: dict[str, float],
    times: Array,
    disturbances: Sequence[Disturbance] = (),
    instant: float = 0.0,
    tol: float = 1e-9,
) -> Array:
    """Noise-free readings (channels, n_times) at `times` (s, the record's clock), released at `instant`."""
    y: Array = path(np.asarray(times, float) - instant, vector(rig), *packed(disturbances), tol)
    return y if rig["coupled"] else y[:1]
