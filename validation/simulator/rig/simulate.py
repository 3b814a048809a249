"""One record of the rig: constants and disturbances to noise-free readings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from . import codes
from .equations import integrate, rig_array
from .sensors import Disturbance, readings

SENSOR_CODES = range(80, 120)
FINE_STEP = 2e-5  # s, of the records that are written
# nothing at amplitude 0
VANISHING = (codes.FLEXIBLE_SHAFT, codes.CLAMP_PLAY, codes.BAR_WHIP, codes.STICK_SLIP, codes.RELEASE_RAMP)
SEARCH_STEP = 1e-4  # s, of the searches for an amplitude; 0.002 rad/s^2 from the fine one


def disturbed_start(
    rig: dict[str, float], coupled: bool, disturbances: Sequence[Disturbance]
) -> tuple[dict[str, float], NDArray[np.float64]]:
    """Constants and start (8,) after the disturbances that act on these have acted."""
    rig = dict(rig)
    start = np.zeros(8)
    start[0] = rig["theta0"]
    start[1] = rig["theta0"] if coupled else 0.0
    for i, d in enumerate(disturbances):
        a, p1 = d.p[0], d.p[1]
        if d.code == codes.STIFFNESS_ERROR:
            rig["k1t"] *= 1.0 + a
        elif d.code == codes.INERTIA_ERROR:
            rig["J2"] *= 1.0 + a
        elif d.code in (codes.FLEXIBLE_SHAFT, codes.CLAMP_PLAY):
            rig["J1"] *= 1.0 - a
        elif d.code == codes.LOOSE_RING:
            rig["J1"] *= 1.0 - a
            rig["J2"] *= 1.0 - a
        elif d.code == codes.BAR_WHIP:
            rig["J2"] *= 1.0 - a
        elif d.code == codes.RELEASE_OFFSET and coupled:
            start[1] += a
        elif d.code == codes.RELEASE_PUSH:
            start[2] += a
            start[3] += a * p1 if coupled else 0.0
        elif d.code == codes.COUPLING_HYSTERESIS:  # pushed slowly from 0 to theta0
            start[4 + 2 * i] = np.tanh(rig["theta0"] / p1)
        elif d.code == codes.CABLE_LOOP:
            start[4 + 2 * i : 6 + 2 * i] = np.minimum(1.0, rig["theta0"] / np.array([p1, 3.0 * p1]))
        elif d.code == codes.SNAPPING_LEAF:  # wound beyond p1, it has buckled
            start[4 + 2 * i] = 1.0 if rig["theta0"] > p1 else 0.0
        elif d.code == codes.VIRGIN_RUBBER:  # wound once to theta0, never the other way
            start[5 + 2 * i] = rig["theta0"]
        elif d.code == codes.BREATHING_COIL:  # held at rest, as short as the angle makes it
            start[4 + 2 * i] = (rig["theta0"] / 0.1) ** 2
        elif d.code == codes.TRAILING_THREAD:
            start[4 + 2 * i] = rig["theta0"]
        elif d.code == codes.GREASE_WALLS:  # ploughed once, up to where the rig is held
            start[4 + 2 * i : 6 + 2 * i] = rig["theta0"]
    return rig, start


def motion(
    rig: dict[str, float],
    coupled: bool,
    disturbances: Sequence[Disturbance],
    duration: float,
    step: float,
    keep: int = 1,
) -> NDArray[np.float64]:
    """Motion (n, 6) th1, th2, w1, w2, a1, a2 every keep * step seconds from the release."""
    rig, start = disturbed_start(rig, coupled, disturbances)
    acting = np.zeros(2, np.int64)
    numbers = np.zeros((2, 4))
    for i, d in enumerate(disturbances):
        numbers[i] = d.p
        least = {codes.RELEASE_RAMP: step}.get(d.code, 0.0)  # a ramp shorter than a step is none
        fading = d.code in VANISHING and d.p[0] <= least
        acting[i] = 0 if d.code in SENSOR_CODES or fading else d.code
    path: NDArray[np.float64] = integrate(
        rig_array(rig), acting, numbers, start, coupled, step, round(duration / step), keep
    )
    return path


def record(
    rig: dict[str, float],
    coupled: bool,
    times: NDArray[np.float64],
    disturbances: Sequence[Disturbance] = (),
    release: float = 0.0,
    phase: float = 0.0,
    step: float = FINE_STEP,
) -> NDArray[np.float64]:
    """Noise-free readings (channels, n_times), rad/s^2, at `times` (s); see `sensors.readings`."""
    duration = float(times[-1]) - min(release, 0.0) + 0.06
    path = motion(rig, coupled, disturbances, duration, step)
    return readings(path, step, coupled, times, disturbances, release, phase)
