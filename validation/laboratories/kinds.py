"""What can be wrong in a laboratory: each kind with its site, its formula in words, and its range.

`library` kinds carry the name of an effect of the package's library under a formula of their own; `foreign` kinds are
in no library. Angles are over the largest release angle A, speeds over A W, times over 1/W or periods 2 pi / W.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .motion import Disturbance

Rng = np.random.Generator


@dataclass(frozen=True)
class Kind:
    """One kind: code in motion.py, what it needs of a rig, where the search of its amplitude starts and ends.

    signs : drawn one of; shape : draws p1, p2, ...; twins : names that agree with it to first order; definition : the
    library can have no other formula, or one that differs in the last per cent alone.
    """

    name: str
    code: int
    site: str
    formula: str
    scale: float
    limit: float
    shape: Callable[[Rng], tuple[float, ...]] = lambda _: ()
    signs: tuple[float, ...] = (1.0,)
    least: float = 0.0
    coupled: bool = False
    fading: bool = False
    twins: tuple[str, ...] = ()
    definition: bool = False

    @property
    def standing(self) -> str:
        """Whether the package's library has the name."""
        return "library" if self.code < 40 else "foreign"

    def at(self, amplitude: float, shape: tuple[float, ...]) -> Disturbance:
        """The disturbance of this amplitude and shape."""
        return Disturbance(self.code, (float(amplitude), *shape))


def _log(r: Rng, low: float, high: float) -> float:
    return float(np.exp(r.uniform(np.log(low), np.log(high))))


def _flat(r: Rng, low: float, high: float) -> float:
    return float(r.uniform(low, high))


def _channel(r: Rng, *of: float) -> float:
    return float(of[int(r.integers(len(of)))])


BOTH = (1.0, -1.0)
KINDS: dict[str, Kind] = {
    k.name: k
    for k in (
        Kind("spring_cubic", 1, "ground1", "share p0 of k1t follows tan(p1 x)/p1 - x, or tanh where softer", 0.1, 3.0,
             lambda r: (_flat(r, 0.6, 1.1),), BOTH),
        Kind("spring_bottoming", 2, "ground1", "contact of a cone beyond the angle p1: p0 k1t A (|x| - p1)^2", 0.5,
             200.0, lambda r: (_flat(r, 0.4, 0.85),)),
        Kind("coupling_backlash", 3, "ground1", "share p2 of k1t is lost from p0 (p3 - 1) to p0 (p3 + 1), round by p1",
             0.02, 0.3, lambda r: (_flat(r, 0.1, 0.5), _flat(r, 0.5, 1.0), _flat(r, 0.2, 0.6))),
        Kind("coupling_hysteresis", 4, "ground1", "two springs that slide at p1 and 3 p1, share p2 still wound up",
             0.01, 0.3, lambda r: (_log(r, 0.05, 0.4), _flat(r, 0.0, 1.0))),
        Kind("stiffness_error", 5, "ground1", "a spring in series, share p0 of the stiffest; stiffer: as sqrt(k1t)",
             0.01, 0.3, signs=BOTH, definition=True),
        Kind("bearing_stribeck", 6, "bearings", "drag (1 + p0 sech(w / p1))", 0.5, 8.0,
             lambda r: (_log(r, 0.03, 0.3),)),
        Kind("quadratic_drag", 7, "bearings", "turbulent skin: |w|^1.75, secondary over primary p1", 5e-3, 0.5,
             lambda r: (_flat(r, 0.5, 1.5),)),
        Kind("misalignment_drag", 8, "bearings", "drag by the side load sqrt(1 - x^2), x = distance of the faces",
             0.1, 3.0, lambda r: (_flat(r, 0.7, 1.3),), coupled=True),
        Kind("stick_slip", 9, "interface", "bristles yield at 0.7 to 1 of p0 p2, static excess p0 sech(v/p1)", 0.3,
              4.0, lambda r: (_log(r, 0.03, 0.3), _log(r, 0.003, 0.03)), least=0.05, coupled=True),
        Kind("friction_displacement", 10, "interface", "mu (1 + p0 tanh((phi/p1)^2))", 0.5, 6.0,
             lambda r: (_flat(r, 0.4, 1.5),), coupled=True, twins=("normal_force_law",)),
        Kind("magnet_cubic", 11, "interface", "share p0 of k2t follows sin(p1 phi)/p1 - phi", 0.3, 4.0,
             lambda r: (_flat(r, 0.7, 1.6),), BOTH, coupled=True),
        Kind("eddy_overlap", 12, "interface", "damping over (1 + (phi/p1)^2)^2", 0.03, 1.0,
             lambda r: (_flat(r, 0.4, 1.5),), coupled=True),
        Kind("magnet_fade", 13, "interface", "pull over 1 + p0 E, E = heat of the friction", 0.1, 10.0, coupled=True),
        Kind("interface_relaxation", 14, "interface", "three Maxwell arms of times p1, 4 p1, 16 p1", 0.1, 3.0,
             lambda r: (_log(r, 0.3, 3.0),), coupled=True),
        Kind("normal_force_law", 15, "interface", "pull 1 - x^(1 + p0), x = distance of the faces", 0.5, 5.0,
             coupled=True, fading=True, twins=("friction_displacement",)),
        Kind("inertia_error", 16, "ground2", "share p0 of J2 more, on an arm that rings at p1; or less", 0.02, 0.4,
             lambda r: (_flat(r, 6.0, 12.0),), BOTH, coupled=True, definition=True),
        Kind("release_ramp", 17, "release", "the holding torque falls as (1 - x)/(1 + p1 x), x = t/p0", 0.05, 1.0,
             lambda r: (_flat(r, -0.5, 3.0),)),
        Kind("release_offset", 18, "release", "th2(0) = th1(0) + p0 A sqrt(theta0 / A)", 0.02, 0.5, signs=BOTH,
             coupled=True, definition=True),
        Kind("sensor_gain", 19, "sensor", "m = y + p0 (y + |y|/10), channel p1", 0.02, 0.4,
             lambda r: (_channel(r, 0.0, 1.0),), BOTH, coupled=True, definition=True),
        Kind("sensor_delay", 20, "sensor", "an all-pass of first order that lags by p0, channel p1", 0.03, 0.6,
             lambda r: (_channel(r, 0.0, 1.0),), coupled=True),
        Kind("sensor_bandwidth", 21, "sensor", "Bessel low-pass of fourth order, corner 1/p0, both channels", 0.05,
             1.0, least=0.004),
        Kind("sensor_highpass", 22, "sensor", "Butterworth high-pass of third order, corner p0, both channels", 0.05,
             1.0, least=1e-3),
        Kind("sensor_clipping", 23, "sensor", "range over p0, exponential beyond p2 of it, channel p1 (2: both)", 1.0,
             8.0, lambda r: (_channel(r, 0.0, 2.0), _flat(r, 0.85, 0.95)), least=0.5),
        Kind("lost_spring", 40, "ground1", "share p0 of the spring unhooks after p1 periods", 0.02, 0.6,
             lambda r: (_flat(r, 0.7, 2.2),)),
        Kind("shaken_spring", 41, "ground1", "stiffness shaken at p1 W by share p0, phase p2", 0.03, 0.6,
             lambda r: (_flat(r, 0.25, 0.8), _flat(r, 0.0, 6.28))),
        Kind("soft_frame", 42, "ground1", "the spring stands on a frame that rings at p1 W, mass J1 / p0", 0.02, 1.0,
             lambda r: (_log(r, 1.6, 5.0),)),
        Kind("bent_shaft", 43, "bearings", "drag of the primary by its angle, p1 waves over A, phase p2", 1.0, 20.0,
             lambda r: (_flat(r, 2.0, 7.0), _flat(r, 0.0, 6.28))),
        Kind("drag_settling", 44, "bearings", "drag (1 + p0 exp(-angle swept / p1))", 1.0, 40.0,
             lambda r: (_log(r, 2.0, 12.0),)),
        Kind("pull_in_time", 45, "interface", "pull (1 + p0 (1 - exp(-t/p1)))", 0.2, 8.0,
             lambda r: (_log(r, 0.7, 4.0),), coupled=True),
        Kind("friction_by_speed", 46, "interface", "mu (1 + p0 ln(1 + |v|/p1))", 0.2, 8.0,
             lambda r: (_log(r, 0.02, 0.3),), coupled=True),
        Kind("face_detent", 47, "interface", "torque sin(p1 phi) between the faces", 0.01, 1.0,
             lambda r: (_flat(r, 4.0, 10.0),), BOTH, coupled=True),
        Kind("secondary_stop", 48, "ground2", "contact of the secondary beyond -p1, with losses", 0.3, 100.0,
             lambda r: (_flat(r, 0.2, 0.6),), coupled=True),
        Kind("sloshing", 49, "ground2", "share p0 of J2 on a spring that rings at p1 W, damping ratio p2", 0.03, 0.6,
             lambda r: (_log(r, 0.8, 3.0), _log(r, 0.02, 0.1)), coupled=True),
        Kind("draught", 50, "ground2", "torque one way that dies within p1 periods", 0.02, 2.0,
             lambda r: (_log(r, 0.4, 3.0),), BOTH, coupled=True),
        Kind("release_kick", 51, "release", "both bodies start at speeds p0 and p1 p0", 0.03, 1.0,
             lambda r: (_flat(r, -1.0, 1.0),), BOTH),
        Kind("second_touch", 52, "release", "the actuator touches again after p1 periods for p2", 0.05, 3.0,
             lambda r: (_flat(r, 0.55, 1.6), _flat(r, 0.05, 0.2)), BOTH),
        Kind("crosstalk", 53, "sensor", "share p0 of channel 1 in channel 2, a third of that back", 0.02, 0.5,
             signs=BOTH, coupled=True),
        Kind("mount_resonance", 54, "sensor", "share p0 through a resonance p1 W, damping ratio p2", 0.1, 1.0,
             lambda r: (_log(r, 3.0, 8.0), _log(r, 0.015, 0.06))),
        Kind("curved_sensor", 55, "sensor", "m = y + p0 y^2, channel p1 (2: both)", 0.02, 0.6,
             lambda r: (_channel(r, 0.0, 2.0),), BOTH),
        Kind("warming_gain", 56, "sensor", "gain 1 + p0 (1 - exp(-t/p2)), channel p1 (2: both)", 0.02, 0.6,
             lambda r: (_channel(r, 0.0, 2.0), _log(r, 0.7, 4.0)), BOTH),
    )
}  # fmt: skip


def names(standing: str, coupled: bool = True, fading: bool = True) -> list[str]:
    """Names of the kinds of a standing that such a rig can have, in the order of the list."""
    return [
        k.name
        for k in KINDS.values()
        if k.standing == standing and (coupled or not k.coupled) and (fading or not k.fading)
    ]
