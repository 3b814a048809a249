"""From motion to readings: the accelerometers, the logger's clock, and what can be wrong with them.

Filters are linear state-space systems advanced exactly for readings that are linear between the points of the fine
grid, at rest before the release; delays and clock errors read the fine grid between its points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import expm

from . import codes


@dataclass(frozen=True)
class Disturbance:
    """One thing that is wrong: code of its kind, amplitude p0, shape numbers p1, p2, p3."""

    code: int
    p: tuple[float, float, float, float]


@njit(cache=True)
def _advance(
    A: NDArray[np.float64],
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    c: NDArray[np.float64],
    d: float,
    u: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Output of x' = A x + (0, 1) u, y = c x + d u for u linear between samples, at rest before the first."""
    y = np.empty(u.size)
    x0 = x1 = 0.0
    y[0] = d * u[0]
    for i in range(1, u.size):
        n0 = A[0, 0] * x0 + A[0, 1] * x1 + before[0] * u[i - 1] + after[0] * u[i]
        n1 = A[1, 0] * x0 + A[1, 1] * x1 + before[1] * u[i - 1] + after[1] * u[i]
        x0, x1 = n0, n1
        y[i] = c[0] * x0 + c[1] * x1 + d * u[i]
    return y


def _filtered(y: NDArray[np.float64], num: Sequence[float], den: Sequence[float], step: float) -> NDArray[np.float64]:
    """(num[0] s^2 + num[1] s + num[2]) / (s^2 + den[0] s + den[1]) in controllable form, exact for a linear input."""
    block = np.zeros((4, 4))  # state, input, slope of the input
    block[:2, :2] = [[0.0, 1.0], [-den[1], -den[0]]]
    block[1, 2] = 1.0
    block[2, 3] = 1.0
    power = expm(block * step)
    after = power[:2, 3] / step
    before = power[:2, 2] - after
    c = np.array([num[2] - num[0] * den[1], num[1] - num[0] * den[0]])
    A = np.ascontiguousarray(power[:2, :2])
    out: NDArray[np.float64] = _advance(A, before, after, c, num[0], np.ascontiguousarray(y))
    return out


def _low_pass(y: NDArray[np.float64], tau: float, step: float) -> NDArray[np.float64]:
    """Two real poles, the second six times as fast as the first."""
    slow, fast = 1.0 / tau, 6.0 / tau
    return _filtered(y, [0.0, 0.0, slow * fast], [slow + fast, slow * fast], step)


def _high_pass(y: NDArray[np.float64], corner: float, step: float) -> NDArray[np.float64]:
    """Two zeros at nought, poles at the corner (rad/s) and at an eighth of it."""
    low = corner / 8.0
    return _filtered(y, [1.0, 0.0, 0.0], [corner + low, corner * low], step)


def _resonance(y: NDArray[np.float64], share: float, wn: float, zeta: float, step: float) -> NDArray[np.float64]:
    mount = _filtered(y, [0.0, 0.0, wn * wn], [2.0 * zeta * wn, wn * wn], step)
    return y + share * (mount - y)


@njit(cache=True)
def _play(y: NDArray[np.float64], half: float) -> NDArray[np.float64]:
    """What a follower with the play +-half shows of y, at 0 before the first."""
    out = np.empty(y.size)
    at = 0.0
    for i in range(y.size):
        at = min(max(at, y[i] - half), y[i] + half)
        out[i] = at
    return out


def _quiet(y: NDArray[np.float64], threshold: float, hold: float, step: float) -> NDArray[np.bool_]:
    """Where y has stayed within +-threshold for longer than `hold`, s; the time runs from the first reading on."""
    at = np.arange(y.size)
    last = np.maximum.accumulate(np.where(np.abs(y) > threshold, at, 0))
    out: NDArray[np.bool_] = (at - last) * step > hold
    return out


WAX_STRENGTH = 300.0  # rad/s^2, more than any record of the thesis's rig asks of the wax


@njit(cache=True)
def _on_wax(y: NDArray[np.float64], limit: float, pace: float, step: float) -> NDArray[np.float64]:
    """What an accelerometer on wax reads of y: all of it within +-limit, then it slides until it has caught up.

    While it slides at the speed v the wax bears limit + pace |v| in the direction of v; v' = y - what it bears.
    """
    out = np.empty(y.size)
    v = 0.0
    way = 0.0
    for i in range(y.size):
        if i > 0 and way != 0.0:
            drive = 0.5 * (y[i - 1] + y[i]) - way * limit
            v = (v * (1.0 - 0.5 * step * pace) + step * drive) / (1.0 + 0.5 * step * pace)
            if v * way <= 0.0:
                v = 0.0
                way = 0.0
        if way == 0.0 and abs(y[i]) > limit:
            way = 1.0 if y[i] > 0.0 else -1.0
        out[i] = y[i] if way == 0.0 else way * limit + pace * v
    return out


SHIFT_TIME = 0.02  # s, within which an overload of one unit moves the zero by one unit


@njit(cache=True)
def _zero_shift(y: NDArray[np.float64], threshold: float, tau: float, step: float) -> NDArray[np.float64]:
    """How far the zero has moved: what exceeds the threshold either way, summed up and forgotten within tau, s."""
    out = np.empty(y.size)
    out[0] = 0.0
    keep = math.exp(-step / tau)
    for i in range(1, y.size):
        before, now = max(0.0, abs(y[i - 1]) - threshold), max(0.0, abs(y[i]) - threshold)
        out[i] = keep * out[i - 1] + 0.5 * step * (keep * before + now) / SHIFT_TIME
    return out


GRAVITY = 98.1  # rad/s^2, over the radius of 0.1 m at which the accelerometers sit


def _lean(angle: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    """Gravity along the sensor's axis on a bar at this angle, where down is `heading` away; zeroed while held."""
    out: NDArray[np.float64] = GRAVITY * (np.sin(angle + heading) - np.sin(angle[0] + heading))
    return out


def _induced(motion: NDArray[np.float64], at: float, reach: float) -> NDArray[np.float64]:
    """Voltage of a loop of cable that the magnet passes at phi = at, over that at the relative speed of 1 rad/s."""
    s = (motion[:, 0] - motion[:, 1] - at) / reach
    out: NDArray[np.float64] = (motion[:, 2] - motion[:, 3]) / (1.0 + s * s) ** 1.5
    return out


@njit(cache=True)
def _envelope(y: NDArray[np.float64], tau: float, step: float) -> NDArray[np.float64]:
    """How large y has been of late: mean of its size over the past tau, s, 0 before the release."""
    out = np.empty(y.size)
    out[0] = 0.0
    keep = math.exp(-step / tau)
    for i in range(1, y.size):
        out[i] = keep * out[i - 1] + (1.0 - keep) * 0.5 * (abs(y[i - 1]) + abs(y[i]))
    return out


SLOPE = 1e5  # rad/s^3, of an amplifier of unit slowness


@njit(cache=True)
def _slewed(y: NDArray[np.float64], slope: float, step: float) -> NDArray[np.float64]:
    """What an amplifier shows of y that can change by `slope` a second at most, from the first reading on."""
    out = np.empty(y.size)
    out[0] = y[0]
    most = slope * step
    for i in range(1, y.size):
        out[i] = min(max(y[i], out[i - 1] - most), out[i - 1] + most)
    return out


def soft_limit(y: NDArray[np.float64], limit: float, sharpness: float) -> NDArray[np.float64]:
    """Readings that bend over to +-limit (rad/s^2)."""
    return y / (1.0 + np.abs(y / limit) ** sharpness) ** (1.0 / sharpness)


FULL_SCALE = 280.0  # rad/s^2, near the largest acceleration of case IV


def readings(
    motion: NDArray[np.float64],
    step: float,
    coupled: bool,
    times: NDArray[np.float64],
    disturbances: Sequence[Disturbance],
    release: float = 0.0,
    phase: float = 0.0,
) -> NDArray[np.float64]:
    """Noise-free readings (channels, n_times), rad/s^2, at `times` (s, the record's clock).

    motion : (n, 6) th1, th2, w1, w2, a1, a2 every `step` seconds from the release; `release` : s, its instant on the
    record's clock (negative where the logger starts late); before it the accelerometers read nothing.
    phase : of the mains in this record, rad.
    """
    channels = [motion[:, 4], motion[:, 5]] if coupled else [motion[:, 4]]
    speeds = [motion[:, 2], motion[:, 3]]
    lags = [0.0, 0.0]
    bend = 0.0
    for d in disturbances:
        a, p1, p2, p3 = d.p
        which = [c for c in range(len(channels)) if int(p1) in (c, 2)]
        if d.code == codes.SENSOR_GAIN:
            for c in which:
                channels[c] = channels[c] * (1.0 + a)
        elif d.code == codes.SENSOR_DELAY:
            for c in which:
                lags[c] += a
        elif d.code == codes.SENSOR_BANDWIDTH and a > 0.0:
            channels = [_low_pass(y, a, step) for y in channels]
        elif d.code == codes.SENSOR_HIGHPASS and a > 0.0:
            channels = [_high_pass(y, a, step) for y in channels]
        elif d.code == codes.SENSOR_CLIPPING and a > 0.0:
            for c in which:
                channels[c] = soft_limit(channels[c], FULL_SCALE / a, p2)
        elif d.code == codes.MOUNT_RESONANCE:
            for c in range(len(channels)):
                if int(p3) in (c, 2):
                    channels[c] = _resonance(channels[c], a, p1, p2, step)
        elif d.code == codes.CHANNEL_CROSSTALK and coupled:
            channels[1] = channels[1] + a * channels[0]
        elif d.code == codes.CLOCK_DRIFT:
            bend += a
        elif d.code == codes.QUANTISER_FAULT:
            for c in which:
                channels[c] = channels[c] + a * (np.floor(channels[c] / p2) % 2.0)
        elif d.code == codes.CROSS_AXIS:
            for c in range(len(channels)):
                channels[c] = channels[c] + a * (1.0, p2)[c] * speeds[c] ** 2
        elif d.code == codes.CURVED_GAIN:
            for c in which:
                channels[c] = channels[c] * (1.0 + a * (channels[c] / FULL_SCALE) ** 2)
        elif d.code == codes.SAGGING_GAIN:
            for c in which:
                channels[c] = channels[c] * (1.0 - a * (1.0 - np.exp(-np.arange(channels[c].size) * step / p2)))
        elif d.code == codes.DEAD_BAND:
            for c in which:
                channels[c] = channels[c] - np.clip(channels[c], -a, a)
        elif d.code == codes.UNEQUAL_HALVES:
            for c in which:
                channels[c] = channels[c] + a * np.abs(channels[c])
        elif d.code == codes.ECHO:
            fine = np.arange(motion.shape[0]) * step
            for c in which:
                channels[c] = channels[c] + a * np.interp(fine - p2, fine, channels[c], left=0.0)
        elif d.code == codes.GAUGE_FRICTION:
            for c in which:
                channels[c] = _play(channels[c], a)
        elif d.code == codes.RANGE_SWITCH:
            for c in which:
                channels[c] = channels[c] * (1.0 + a * _quiet(channels[c], p2, p3, step))
        elif d.code == codes.SLIPPING_WAX and a > 0.0:
            for c in which:
                channels[c] = _on_wax(channels[c], WAX_STRENGTH / (1.0 + a), p2, step)
        elif d.code == codes.ZERO_SHIFT:
            for c in which:
                channels[c] = channels[c] + a * _zero_shift(channels[c], p2, p3, step)
        elif d.code == codes.LEANING_AXIS:
            channels = [y + a * _lean(motion[:, c], p2) for c, y in enumerate(channels)]
        elif d.code == codes.FIELD_PICKUP and coupled:
            for c in which:
                channels[c] = channels[c] + a * _induced(motion, p2, p3)
        elif d.code == codes.AUTO_GAIN:
            for c in which:
                channels[c] = channels[c] / (1.0 + a * _envelope(channels[c], p2, step) / FULL_SCALE)
        elif d.code == codes.SLOW_AMPLIFIER and a > 0.0:
            for c in which:
                channels[c] = _slewed(channels[c], SLOPE / a, step)
    since = times - release
    since = since + bend * since * np.abs(since)
    for d in disturbances:
        if d.code == codes.CLOCK_JUMP:
            since = np.where(times >= d.p[2], since + d.p[0], since)
    grid = np.arange(motion.shape[0]) * step
    out = np.empty((len(channels), times.size))
    for c, y in enumerate(channels):
        at = since - lags[c]
        out[c] = np.where(at > -1e-9, np.interp(at, grid, y), 0.0)
    for d in disturbances:
        if d.code == codes.MAINS_HUM:
            for c in range(len(channels)):
                out[c] += d.p[0] * (1.0, d.p[2])[c] * np.sin(2.0 * np.pi * d.p[1] * times + phase + 0.4 * c)
        for c in [c for c in range(len(channels)) if int(d.p[1]) in (c, 2)]:
            if d.code == codes.WARMING_OFFSET:
                out[c] += d.p[0] * (1.0 - np.exp(-times / d.p[2]))
            elif d.code == codes.LOGGER_HOLD:
                held = np.flatnonzero((times >= d.p[2]) & (times < d.p[2] + d.p[0]))
                out[c, held] = np.interp(d.p[2], times, out[c])
            elif d.code == codes.CONVERTER_PAIR:
                out[c] *= 1.0 + 0.5 * d.p[0] * np.where(np.arange(times.size) % 2, -1.0, 1.0)
    return out
