"""What can be wrong with the rig: every kind of disturbance, its site, how its shape is drawn and how strong it can be.

`standing` tells how a kind may be used. "library": named in the library of candidate effects. "development": outside
the library, may be looked at while the diagnosis is being developed. "reserved": outside the library and kept for the
final proof; nothing may be tuned on it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import codes
from .sensors import Disturbance

Shape = tuple[float, float, float]


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance.

    scale : amplitude at which the search starts; limit : largest amplitude with a meaning, `lowest` : most negative
    one, `least` : smallest size with a meaning;
    signs : the signs that are drawn; shape : draws p1, p2, p3; twins : names of the kinds that agree with it to first
    order; coupled_only : it leaves the uncoupled records as they are.
    """

    name: str
    code: int
    site: str
    standing: str
    scale: float
    limit: float
    shape: Callable[[np.random.Generator], Shape]
    unit: str
    meaning: str
    signs: tuple[float, ...] = (1.0,)
    lowest: float = 0.0
    least: float = 0.0
    twins: tuple[str, ...] = ()

    def at(self, amplitude: float, shape: Shape) -> Disturbance:
        """The disturbance of this amplitude and shape."""
        return Disturbance(self.code, (float(amplitude), *shape))

    def bound(self, sign: float) -> float:
        """Largest size of the amplitude for that sign."""
        return self.limit if sign > 0 else -self.lowest


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _flat(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _pick(rng: np.random.Generator, *values: float) -> float:
    return float(values[int(rng.integers(len(values)))])


def _no_shape(_: np.random.Generator) -> Shape:
    return (0.0, 0.0, 0.0)


KINDS: dict[str, Kind] = {
    k.name: k
    for k in (
        # ground 1
        Kind(
            "spring_cubic",
            codes.SPRING_CUBIC,
            "ground1",
            "library",
            0.1,
            8.0,
            lambda r: (_flat(r, 6.0, 12.0), 0.0, 0.0),
            "1",
            "share of k1t that follows sinh(p1 th)/p1 - th",
            (1.0, -1.0),
            -2.0,
        ),
        Kind(
            "spring_bottoming",
            codes.SPRING_BOTTOMING,
            "ground1",
            "library",
            1.0,
            200.0,
            lambda r: (_flat(r, 0.030, 0.075), _flat(r, 0.0008, 0.003), 0.0),
            "N m/rad",
            "stiffness of a stop at the angle p1 with a lip of width p2, rad",
        ),
        Kind(
            "coupling_backlash",
            codes.COUPLING_BACKLASH,
            "ground1",
            "library",
            1e-3,
            0.02,
            lambda r: (_flat(r, 0.0, 0.15), 0.0, 0.0),
            "rad",
            "half of the gap, a share p1 of k1t left inside",
        ),
        Kind(
            "coupling_hysteresis",
            codes.COUPLING_HYSTERESIS,
            "ground1",
            "library",
            0.01,
            0.2,
            lambda r: (_log(r, 0.003, 0.02), _flat(r, 0.4, 0.6), 0.0),
            "N m",
            "Bouc-Wen torque, n = 2, angle of yield p1, beta = p2",
        ),
        Kind(
            "stiffness_error",
            codes.STIFFNESS_ERROR,
            "ground1",
            "library",
            0.01,
            0.3,
            _no_shape,
            "1",
            "k1t of every case off by this share",
            (1.0, -1.0),
            -0.3,
        ),
        # bearings
        Kind(
            "bearing_stribeck",
            codes.BEARING_STRIBECK,
            "bearings",
            "library",
            0.5,
            6.0,
            lambda r: (_log(r, 0.2, 1.0), 0.0, 0.0),
            "1",
            "static drag above kinetic, Lorentzian of speed p1, rad/s",
        ),
        Kind(
            "quadratic_drag",
            codes.QUADRATIC_DRAG,
            "bearings",
            "library",
            1e-3,
            0.05,
            lambda r: (_flat(r, 0.1, 0.8), 0.0, 0.0),
            "N m s^2/rad^2",
            "turbulent drag, laminar below p1, rad/s",
        ),
        Kind(
            "misalignment_drag",
            codes.MISALIGNMENT_DRAG,
            "bearings",
            "library",
            5e-3,
            0.3,
            lambda r: (_flat(r, 0.7, 1.3), 0.0, 0.0),
            "N m",
            "side load at full pull; p1 = secondary over primary",
        ),
        # interface
        Kind(
            "stick_slip",
            codes.STICK_SLIP,
            "interface",
            "library",
            0.1,
            4.0,
            lambda r: (_log(r, 0.1, 0.6), _log(r, 1e-5, 2e-4), 0.0),
            "1",
            "static above kinetic friction: bristles, Stribeck speed p1, yield angle p0 p2",
        ),
        Kind(
            "friction_displacement",
            codes.FRICTION_DISPLACEMENT,
            "interface",
            "library",
            0.5,
            6.0,
            lambda r: (_flat(r, 0.06, 0.2), 0.0, 0.0),
            "1",
            "mu (1 + p0 (1 - exp(-|phi|/p1)))",
            twins=("normal_force_law",),
        ),
        Kind(
            "magnet_cubic",
            codes.MAGNET_CUBIC,
            "interface",
            "library",
            0.5,
            1.5,
            lambda r: (_flat(r, 0.10, 0.25), 0.0, 0.0),
            "1",
            "share of k2t with a dipole's fall-off at p1 rad",
            (1.0, -1.0),
            -5.0,
        ),
        Kind(
            "eddy_overlap",
            codes.EDDY_OVERLAP,
            "interface",
            "library",
            0.02,
            1.0,
            _no_shape,
            "N m s/rad",
            "damping times the square of the shared area of two discs",
        ),
        Kind(
            "magnet_fade",
            codes.MAGNET_FADE,
            "interface",
            "library",
            0.5,
            6.0,
            _no_shape,
            "1",
            "pull exp(-p0 E), E = heat over 49 mJ",
        ),
        Kind(
            "interface_relaxation",
            codes.INTERFACE_RELAXATION,
            "interface",
            "library",
            0.1,
            10.0,
            lambda r: (_log(r, 0.008, 0.05), 0.0, 0.0),
            "N m/rad",
            "two Maxwell arms of times p1 and 3 p1, s",
        ),
        Kind(
            "normal_force_law",
            codes.NORMAL_FORCE_LAW,
            "interface",
            "library",
            0.5,
            12.0,
            _no_shape,
            "1",
            "pull divided by 1 + p0 x, x = R |phi| / (2 r)",
            twins=("friction_displacement",),
        ),
        # ground 2
        Kind(
            "inertia_error",
            codes.INERTIA_ERROR,
            "ground2",
            "library",
            0.02,
            0.5,
            _no_shape,
            "1",
            "J2 off by this share",
            (1.0, -1.0),
            -0.4,
        ),
        # release
        Kind(
            "release_ramp",
            codes.RELEASE_RAMP,
            "release",
            "library",
            1e-3,
            0.03,
            _no_shape,
            "s",
            "the holding torque dies as half a cosine within this time",
            least=3e-4,
        ),
        Kind(
            "release_offset",
            codes.RELEASE_OFFSET,
            "release",
            "library",
            2e-3,
            0.08,
            _no_shape,
            "rad",
            "th2(0) - th1(0)",
            (1.0, -1.0),
            -0.08,
        ),
        # sensor
        Kind(
            "sensor_gain",
            codes.SENSOR_GAIN,
            "sensor",
            "library",
            0.03,
            0.5,
            lambda r: (_pick(r, 1.0, 1.0, 0.0), 0.0, 0.0),
            "1",
            "gain of channel p1 off by this share",
            (1.0, -1.0),
            -0.5,
        ),
        Kind(
            "sensor_delay",
            codes.SENSOR_DELAY,
            "sensor",
            "library",
            1e-3,
            0.01,
            lambda r: (_pick(r, 0.0, 1.0), 0.0, 0.0),
            "s",
            "lag of channel p1",
        ),
        Kind(
            "sensor_bandwidth",
            codes.SENSOR_BANDWIDTH,
            "sensor",
            "library",
            5e-4,
            0.02,
            _no_shape,
            "s",
            "two poles of times p0 and p0 / 6",
            least=1e-4,
        ),
        Kind(
            "sensor_highpass",
            codes.SENSOR_HIGHPASS,
            "sensor",
            "library",
            1.0,
            40.0,
            _no_shape,
            "rad/s",
            "two poles at p0 and p0 / 8",
        ),
        Kind(
            "sensor_clipping",
            codes.SENSOR_CLIPPING,
            "sensor",
            "library",
            1.2,
            30.0,
            lambda r: (_pick(r, 0.0, 1.0, 2.0), _pick(r, 24.0, 60.0), _pick(r, 0.0, 1.0)),
            "1",
            "range = 280 rad/s^2 / p0 on channel p1 (2 = both); p3 = 1: the noise is clipped too",
        ),
        # outside the library, for development
        Kind(
            "stiffness_drift",
            codes.STIFFNESS_DRIFT,
            "ground1",
            "development",
            0.02,
            0.5,
            lambda r: (_flat(r, 0.2, 0.8), 0.0, 0.0),
            "1",
            "k1t falls by this share with the time p1, s",
            (1.0, -1.0),
            -0.5,
        ),
        Kind(
            "knock",
            codes.KNOCK,
            "ground1",
            "development",
            0.1,
            5.0,
            lambda r: (_flat(r, 0.12, 0.6), _flat(r, 0.004, 0.015), 0.0),
            "N m",
            "half a sine on the primary at p1 for p2, s",
            (1.0, -1.0),
            -5.0,
        ),
        Kind(
            "flexible_shaft",
            codes.FLEXIBLE_SHAFT,
            "ground1",
            "development",
            0.02,
            0.6,
            lambda r: (2.0 * np.pi * _log(r, 15.0, 60.0), _flat(r, 0.01, 0.04), 0.0),
            "1",
            "share of J1 on a flexible piece of the shaft, p1 rad/s, damping ratio p2",
        ),
        Kind(
            "grease_thixotropy",
            codes.GREASE_THIXOTROPY,
            "bearings",
            "development",
            5e-3,
            0.2,
            lambda r: (_flat(r, 0.1, 0.5), 0.0, 0.0),
            "N m s/rad",
            "extra viscosity that dies with the angle swept",
        ),
        Kind(
            "magnetic_cogging",
            codes.MAGNETIC_COGGING,
            "interface",
            "development",
            0.01,
            0.5,
            lambda r: (_flat(r, 40.0, 110.0), 0.0, 0.0),
            "N m",
            "torque of p1 poles a radian, both signs",
            (1.0, -1.0),
            -0.5,
        ),
        Kind(
            "unbalanced_bar",
            codes.UNBALANCED_BAR,
            "ground2",
            "development",
            0.02,
            0.5,
            lambda r: (_flat(r, 0.4, 1.4), 0.0, 0.0),
            "N m",
            "weight torque of the secondary bar, at rest at p1 rad",
            (1.0, -1.0),
            -0.5,
        ),
        Kind(
            "release_push",
            codes.RELEASE_PUSH,
            "release",
            "development",
            0.05,
            3.0,
            lambda r: (_flat(r, -0.5, 1.0), 0.0, 0.0),
            "rad/s",
            "w1(0); w2(0) = p1 w1(0)",
            (1.0, -1.0),
            -3.0,
        ),
        Kind(
            "mains_hum",
            codes.MAINS_HUM,
            "sensor",
            "development",
            1.0,
            30.0,
            lambda r: (_pick(r, 50.0, 60.0), _flat(r, 0.5, 1.5), 0.0),
            "rad/s^2",
            "hum of p1 Hz; p2 = channel 2 over channel 1; phase of its own in every record",
        ),
        Kind(
            "mount_resonance",
            codes.MOUNT_RESONANCE,
            "sensor",
            "development",
            0.1,
            1.0,
            lambda r: (2.0 * np.pi * _log(r, 60.0, 200.0), _flat(r, 0.01, 0.04), _pick(r, 0.0, 1.0, 2.0)),
            "1",
            "share of the reading through a resonance p1 rad/s, damping ratio p2",
        ),
        Kind(
            "channel_crosstalk",
            codes.CHANNEL_CROSSTALK,
            "sensor",
            "development",
            0.02,
            0.5,
            _no_shape,
            "1",
            "share of channel 1 in channel 2",
            (1.0, -1.0),
            -0.5,
        ),
        # outside the library, reserved for the proof
        Kind(
            "clamp_play",
            codes.CLAMP_PLAY,
            "ground1",
            "reserved",
            0.02,
            0.6,
            lambda r: (2.0 * np.pi * _log(r, 30.0, 80.0), _log(r, 0.0005, 0.003), 0.0),
            "1",
            "share of J1 held with slack p2, rad; p1 rad/s when closed",
        ),
        Kind(
            "base_motion",
            codes.BASE_MOTION,
            "ground1",
            "reserved",
            2e-3,
            0.05,
            lambda r: (2.0 * np.pi * _flat(r, 13.0, 35.0), _flat(r, 0.1, 0.4), 0.0),
            "rad",
            "the ground swings at p1 rad/s, decays within p2 s",
            (1.0, -1.0),
            -0.05,
        ),
        Kind(
            "bearing_runout",
            codes.BEARING_RUNOUT,
            "bearings",
            "reserved",
            3e-3,
            0.1,
            lambda r: (_flat(r, 20.0, 60.0), _flat(r, 0.0, 6.28), _flat(r, 0.0, 6.28)),
            "N m",
            "drag that depends on where the shaft stands",
        ),
        Kind(
            "wake_drag",
            codes.WAKE_DRAG,
            "bearings",
            "reserved",
            2e-3,
            0.1,
            lambda r: (_log(r, 0.015, 0.05), 0.0, 0.0),
            "N m s^2/rad^2",
            "air that remembers w |w| for p1 s",
        ),
        Kind(
            "face_wobble",
            codes.FACE_WOBBLE,
            "interface",
            "reserved",
            0.2,
            1.0,
            lambda r: (_flat(r, 15.0, 40.0), _flat(r, 0.0, 6.28), 0.0),
            "1",
            "pull times 1 + p0 sin(p1 th2 + p2)",
        ),
        Kind(
            "asymmetric_magnet",
            codes.ASYMMETRIC_MAGNET,
            "interface",
            "reserved",
            0.05,
            0.9,
            _no_shape,
            "1",
            "k2t p0 |phi|",
            (1.0, -1.0),
            -0.9,
        ),
        Kind(
            "guard_rub",
            codes.GUARD_RUB,
            "ground2",
            "reserved",
            0.01,
            1.0,
            lambda r: (_flat(r, 0.015, 0.05), 0.0, 0.0),
            "N m",
            "the secondary rubs beyond p1, rad",
        ),
        Kind(
            "cable_pull",
            codes.CABLE_PULL,
            "ground2",
            "reserved",
            0.05,
            5.0,
            lambda r: (_flat(r, 0.0, 0.01), 0.0, 0.0),
            "N m/rad",
            "cable of the secondary accelerometer",
        ),
        Kind(
            "release_drag",
            codes.RELEASE_DRAG,
            "release",
            "reserved",
            0.05,
            1.0,
            lambda r: (_flat(r, 0.006, 0.02), 0.0, 0.0),
            "N m",
            "the pad slides along the bar, gone within p1 s",
        ),
        Kind(
            "clock_drift",
            codes.CLOCK_DRIFT,
            "sensor",
            "reserved",
            2e-3,
            0.1,
            _no_shape,
            "1/s",
            "the logger's clock runs ahead by p0 t^2",
            (1.0, -1.0),
            -0.1,
        ),
        Kind(
            "quantiser_fault",
            codes.QUANTISER_FAULT,
            "sensor",
            "reserved",
            2.0,
            30.0,
            lambda r: (_pick(r, 0.0, 1.0, 2.0), _flat(r, 12.0, 40.0), 0.0),
            "rad/s^2",
            "one bit of the converter adds too much: steps every p2",
        ),
        Kind(
            "cross_axis",
            codes.CROSS_AXIS,
            "sensor",
            "reserved",
            0.3,
            10.0,
            lambda r: (0.0, _flat(r, -1.0, 1.0), 0.0),
            "1",
            "centripetal acceleration p0 w^2 in the reading",
            (1.0, -1.0),
            -10.0,
        ),
    )
}


def names(*standings: str) -> list[str]:
    """Names of the kinds of these standings, in the order of the list."""
    return [k.name for k in KINDS.values() if k.standing in standings]
