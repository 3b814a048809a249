"""Motion of the rig: a fixed-step fourth-order Runge-Kutta scheme, the bristles of the interface stepped exponentially.

The nominal equations (angles th, velocities w, primary 1, secondary 2, phi = th1 - th2, v = w1 - w2):

    J1 a1 = -c1 w1 - k1 th1 - d tanh(nu w1) - T + Q1
    J2 a2 = -c3 w2          - d tanh(nu w2) + T + Q2
    T     = k2 phi + c2 v + mu N R tanh(nu v),    N = N0 max(0, 1 - R |phi| / (2 r))

Uncoupled, T is left out and the secondary does not exist. A disturbance adds torques Q, scales the pull N or the
friction, or replaces tanh(nu v) by a bristle. Up to two disturbances act at once; each has an amplitude p0, three shape
numbers p1, p2, p3 and two memories.
"""

# Kernels: numba infers the types, and all of a family take the same arguments.
# ruff: noqa: ANN001, ANN201, ARG001
# mypy: disallow-untyped-defs=False

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from . import codes

RIG_FIELDS = ("J1", "J2", "k1t", "c1t", "c3t", "k2t", "c2t", "mu", "N0", "R", "r", "drag", "nu", "theta0")
J1, J2, K1, C1, C3, K2, C2, MU, N0, BAR, FACE, DRAG, NU, TH0 = range(14)

SPRING_CUBIC, SPRING_BOTTOMING = codes.SPRING_CUBIC, codes.SPRING_BOTTOMING
COUPLING_BACKLASH, COUPLING_HYSTERESIS = codes.COUPLING_BACKLASH, codes.COUPLING_HYSTERESIS
STIFFNESS_DRIFT, KNOCK, BASE_MOTION = codes.STIFFNESS_DRIFT, codes.KNOCK, codes.BASE_MOTION
FLEXIBLE_SHAFT, CLAMP_PLAY = codes.FLEXIBLE_SHAFT, codes.CLAMP_PLAY
ONE_SIDED_SPRING, STIFFNESS_RIPPLE = codes.ONE_SIDED_SPRING, codes.STIFFNESS_RIPPLE
CLAMP_SLIP, COIL_FRICTION = codes.CLAMP_SLIP, codes.COIL_FRICTION
SPRING_CREEP, LEAF_BREAK, SNAPPING_LEAF = codes.SPRING_CREEP, codes.LEAF_BREAK, codes.SNAPPING_LEAF
VIRGIN_RUBBER, BREATHING_COIL, HEALING_RUBBER = codes.VIRGIN_RUBBER, codes.BREATHING_COIL, codes.HEALING_RUBBER
HOOKED_COIL, YIELDING_ANCHOR = codes.HOOKED_COIL, codes.YIELDING_ANCHOR
BEARING_STRIBECK, QUADRATIC_DRAG = codes.BEARING_STRIBECK, codes.QUADRATIC_DRAG
MISALIGNMENT_DRAG = codes.MISALIGNMENT_DRAG
GREASE_THIXOTROPY, BEARING_RUNOUT, WAKE_DRAG = codes.GREASE_THIXOTROPY, codes.BEARING_RUNOUT, codes.WAKE_DRAG
ONE_WAY_DRAG, RACE_DENT = codes.ONE_WAY_DRAG, codes.RACE_DENT
DRY_RUNNING, FLUTED_RACE, OIL_STARVATION = codes.DRY_RUNNING, codes.FLUTED_RACE, codes.OIL_STARVATION
THIN_FILM, LOOSE_RING = codes.THIN_FILM, codes.LOOSE_RING
SEAL_FLUTTER, ROLLING_JOURNAL = codes.SEAL_FLUTTER, codes.ROLLING_JOURNAL
AIR_HAMMER, SKIDDING_BALLS, GREASE_WALLS = codes.AIR_HAMMER, codes.SKIDDING_BALLS, codes.GREASE_WALLS
STICK_SLIP, FRICTION_DISPLACEMENT, MAGNET_CUBIC = codes.STICK_SLIP, codes.FRICTION_DISPLACEMENT, codes.MAGNET_CUBIC
EDDY_OVERLAP, MAGNET_FADE, INTERFACE_RELAXATION = codes.EDDY_OVERLAP, codes.MAGNET_FADE, codes.INTERFACE_RELAXATION
NORMAL_FORCE_LAW, MAGNETIC_COGGING = codes.NORMAL_FORCE_LAW, codes.MAGNETIC_COGGING
FACE_WOBBLE, ASYMMETRIC_MAGNET = codes.FACE_WOBBLE, codes.ASYMMETRIC_MAGNET
FACE_STOP, PULL_TILT = codes.FACE_STOP, codes.PULL_TILT
AXIAL_BOUNCE, FACE_GRAIN, REST_ADHESION = codes.AXIAL_BOUNCE, codes.FACE_GRAIN, codes.REST_ADHESION
GROOVED_FACES, GAP_CREEP = codes.GROOVED_FACES, codes.GAP_CREEP
COMBED_TEFLON, FLOATING_WASHER = codes.COMBED_TEFLON, codes.FLOATING_WASHER
SHORTED_LOOP, CHARGED_TEFLON = codes.SHORTED_LOOP, codes.CHARGED_TEFLON
SIDEWAYS_SHAKE, WORN_THROUGH = codes.SIDEWAYS_SHAKE, codes.WORN_THROUGH
IRON_WHISKERS, TURNED_MAGNET = codes.IRON_WHISKERS, codes.TURNED_MAGNET
STRAY_IRON, SECOND_KNOCK, BAR_PADDLE = codes.STRAY_IRON, codes.SECOND_KNOCK, codes.BAR_PADDLE
UNBALANCED_BAR, GUARD_RUB, CABLE_PULL = codes.UNBALANCED_BAR, codes.GUARD_RUB, codes.CABLE_PULL
CABLE_LOOP, FOAM_BUMPER = codes.CABLE_LOOP, codes.FOAM_BUMPER
BAR_WHIP, DRAUGHT = codes.BAR_WHIP, codes.DRAUGHT
FRAME_EDDIES, SLIDING_RIDER, LEAKY_BELLOWS = codes.FRAME_EDDIES, codes.SLIDING_RIDER, codes.LEAKY_BELLOWS
DROPPED_NUT, HANGING_WEIGHT = codes.DROPPED_NUT, codes.HANGING_WEIGHT
RINGING_COIL, DRIPPING_HOSE, RIDING_ARM = codes.RINGING_COIL, codes.DRIPPING_HOSE, codes.RIDING_ARM
RELEASE_RAMP, RELEASE_DRAG, RELEASE_REBOUND = codes.RELEASE_RAMP, codes.RELEASE_DRAG, codes.RELEASE_REBOUND
SECOND_JAW, LATE_SECONDARY, STICKY_PAD = codes.SECOND_JAW, codes.LATE_SECONDARY, codes.STICKY_PAD
SOLENOID_PULL, TRAILING_THREAD, VENTING_CYLINDER = codes.SOLENOID_PULL, codes.TRAILING_THREAD, codes.VENTING_CYLINDER
RING_SMOOTH = 0.01  # rad/s, over which the friction of a loose ring turns
FLUTTER_SMOOTH = 0.05  # rad/s, over which a seal begins or ends to flutter
FOLLOW = 5e-4  # s, within which a farthest point is taken over
SKID_TIME = 2e-3  # s, within which balls begin or cease to skid
WEAR_EDGE = 0.004  # rad of sliding, over which the last of the Teflon goes
CORD_LOSS = 0.05  # damping ratio of a weight on its cord
HOOK_TIME = 1e-3  # s, within which coils hook or come loose
WALL_EDGE = 5e-4  # rad, over which a wall of grease begins to resist
TEAR_TIME = 5e-4  # s, within which torn whiskers shorten
COIL_REACH = 0.03  # rad, over which a magnet's flux passes a coil
DROP_TIME = 4e-3  # s, for which a falling drop pushes


@njit(cache=True)
def lens_area(x: float) -> float:
    """Overlap of two equal discs whose centres lie x diameters apart, as a share of one disc."""
    if x >= 1.0:
        return 0.0
    return 2.0 / math.pi * (math.acos(x) - x * math.sqrt(1.0 - x * x))


@njit(cache=True)
def washer_free(z, v):
    """1 while a washer at z of its play (-1 to 1) moves with the face that slides at v, 0 once it is at its pin."""
    return 0.5 * (1.0 - math.tanh((math.copysign(z, z * v) - 1.0) / 0.05))


@njit(cache=True)
def flux_slope(s):
    """Slope of the flux through a loop at s widths from its middle, 0 there."""
    return s * math.exp(-0.5 * s * s)


@njit(cache=True)
def flutter_rate(z, speed, begin, end):
    """Rate of the share z of a lip that beats: from the speed `begin` on, until it falls below `end`, within 1 ms."""
    on = 0.5 * (1.0 + math.tanh((speed - begin) / FLUTTER_SMOOTH))
    off = 0.5 * (1.0 - math.tanh((speed - end) / FLUTTER_SMOOTH))
    return (on * (1.0 - z) - off * z) / 1e-3


@njit(cache=True)
def skid_rate(z, a, begin):
    """Rate of the share z of the balls that skid: those that the acceleration a, beyond `begin`, leaves behind."""
    return (0.5 * (1.0 + math.tanh((abs(a) - begin) / (0.1 * begin))) - z) / SKID_TIME


@njit(cache=True)
def cord_tension(stretch, speed, wn, weight):
    """Tension of a cord over the weight that hangs on it: 1 at rest, never below 0; weight as an acceleration."""
    return max(0.0, 1.0 + (wn * wn * stretch + 2.0 * CORD_LOSS * wn * speed) / weight)


@njit(cache=True)
def hooked(t, begin, span):
    """1 from the instant `begin` on for the time `span`, else 0."""
    return 0.5 * (math.tanh((t - begin) / HOOK_TIME) - math.tanh((t - begin - span) / HOOK_TIME))


@njit(cache=True)
def wall_drag(beyond, speed, nu):
    """Drag of a wall of grease, over its largest, where a shaft ploughs `beyond` its channel."""
    return math.tanh(max(0.0, beyond) / WALL_EDGE) * math.tanh(nu * speed)


@njit(cache=True)
def coil_flux(th, at):
    """Slope of the flux through a coil at the angle `at`, over its largest, as the magnet stands at th."""
    s = (th - at) / COIL_REACH
    return math.exp(-0.5 * s * s)


@njit(cache=True)
def pull_and_friction(code, t, th1, th2, z0, p0, p1, p2, p3, g):
    """Factors (of the magnet's pull N, of the coefficient of friction) that one disturbance causes."""
    phi = abs(th1 - th2)
    x = g[BAR] * phi / (2.0 * g[FACE])
    if code == NORMAL_FORCE_LAW:  # pull of an opening air gap: hyperbolic on top of the linear loss
        return 1.0 / max(0.05, 1.0 + p0 * x), 1.0
    if code == FRICTION_DISPLACEMENT:  # friction that saturates with the displacement
        return 1.0, 1.0 + p0 * (1.0 - math.exp(-phi / p1))
    if code == MAGNET_FADE:  # pull dies exponentially with the heat z0 (1 = energy at release in case II)
        return math.exp(-p0 * z0), 1.0
    if code == PULL_TILT:  # faces that close on one side
        return max(0.0, 1.0 + p0 * math.tanh((th1 - th2) / p1)), 1.0
    if code == FACE_WOBBLE:  # a face that is not square to its shaft
        return max(0.0, 1.0 + p0 * math.sin(p1 * th2 + p2)), 1.0
    if code == AXIAL_BOUNCE:  # the shafts ring along their axis after the release, and the air gap with them
        return max(0.0, 1.0 + p0 * math.exp(-t / p2) * math.sin(p1 * t)), 1.0
    if code == GAP_CREEP:  # Teflon that yields under the magnet
        return 1.0 + p0 * (1.0 - math.exp(-t / p1)), 1.0
    return 1.0, 1.0


@njit(cache=True)
def torques(code, t, th1, th2, w1, w2, z0, z1, p0, p1, p2, p3, g, pull, coupled):
    """Torques (Q1, Q2) in N m that one disturbance adds; pull = N in newtons."""
    nu = g[NU]
    if code < 20:
        if code == SPRING_CUBIC:  # hyperbolic sine, hardening or softening
            return -p0 * g[K1] * (math.sinh(p1 * th1) / p1 - th1), 0.0
        if code == SPRING_BOTTOMING:  # a stop with a soft lip of width p2
            over = (abs(th1) - p1) / p2
            soft = over if over > 30.0 else math.log1p(math.exp(over))
            return -math.copysign(p0 * p2 * soft, th1) * math.tanh(abs(th1) / (0.2 * p1)), 0.0
        if code == COUPLING_BACKLASH:  # rubber spider: in the gap a share p1 of the stiffness is left
            return g[K1] * (1.0 - p1) * min(max(th1, -p0), p0), 0.0
        if code == COUPLING_HYSTERESIS:  # Bouc-Wen, z0 in -1..1
            return -p0 * z0, 0.0
        if code == STIFFNESS_DRIFT:
            return p0 * g[K1] * th1 * (1.0 - math.exp(-t / p1)), 0.0
        if code == KNOCK:  # half a sine at the instant p1 for the time p2
            s = (t - p1) / p2
            return (p0 * math.sin(math.pi * s) if 0.0 < s < 1.0 else 0.0), 0.0
        if code == FLEXIBLE_SHAFT:  # a share of J1 on a shaft of its own: twist z0, rate z1
            share = p0 * g[J1] / (1.0 - p0)
            return share * (p1 * p1 * z0 + 2.0 * p2 * p1 * z1), 0.0
        if code == CLAMP_PLAY:  # the same share held by a clamp with slack p2 on either side
            share = p0 * g[J1] / (1.0 - p0)
            reach = z0 - min(max(z0, -p2), p2)
            return share * (p1 * p1 * reach + 0.1 * p1 * z1 * (1.0 if reach != 0.0 else 0.1)), 0.0
        if code == BASE_MOTION:  # the table swings after the recoil
            return g[K1] * p0 * math.exp(-t / p2) * math.sin(p1 * t), 0.0
        if code == ONE_SIDED_SPRING:  # stiffer on one side, soft corner of width p1
            return -p0 * g[K1] * 0.5 * (th1 + math.sqrt(th1 * th1 + p1 * p1) - p1), 0.0
        if code == STIFFNESS_RIPPLE:  # a machine next to the rig pulls the spring to and fro
            return -p0 * g[K1] * th1 * math.sin(p1 * t + p2), 0.0
        if code == CLAMP_SLIP:  # the spring's clamp slips at the instant p1: another angle of rest from then on
            return p0 * g[K1] * 0.5 * (1.0 + math.tanh((t - p1) / p2)), 0.0
        if code == COIL_FRICTION:  # coils rub on each other as hard as the spring is wound
            return -p0 * g[K1] * abs(th1) * math.tanh(p1 * w1), 0.0
        if code == SPRING_CREEP:  # the spring's seat relaxes, and had done so while the rig was held
            return -p0 * g[K1] * z0, 0.0
        if code == LEAF_BREAK:  # one leaf of the spring breaks at the instant p1
            return p0 * g[K1] * th1 * 0.5 * (1.0 + math.tanh((t - p1) / p2)), 0.0
        if code == SNAPPING_LEAF:  # a leaf buckles on the way out and springs back on the way in (z0 = share buckled)
            return p0 * z0, 0.0
        if code == VIRGIN_RUBBER:  # stiffer where it has not been stretched yet: Mullins (z = farthest, either side)
            slack = (z0 if th1 < 0.0 else z1) - abs(th1)
            return -p0 * g[K1] * th1 * math.exp(-max(0.0, slack) / p1), 0.0
        if code == BREATHING_COIL:  # the coil shortens as it is wound, bounces along its axis and softens (z0, z1)
            return p0 * g[K1] * th1 * z0, 0.0
        return 0.0, 0.0
    if code < 40:
        if code == BEARING_STRIBECK:  # Lorentzian hump above the kinetic drag
            a = p0 * g[DRAG]
            return (-a * math.tanh(nu * w1) / (1.0 + (w1 / p1) ** 2), -a * math.tanh(nu * w2) / (1.0 + (w2 / p1) ** 2))
        if code == QUADRATIC_DRAG:  # turbulent above the speed p1, laminar below
            return -p0 * w1 * math.sqrt(w1 * w1 + p1 * p1), -p0 * w2 * math.sqrt(w2 * w2 + p1 * p1)
        if code == MISALIGNMENT_DRAG:  # side load; the two bearings share it unequally
            side = p0 * (pull / g[N0]) if coupled else 0.0
            return (
                -side * nu * w1 / math.sqrt(1.0 + (nu * w1) ** 2),
                -side * p1 * nu * w2 / math.sqrt(1.0 + (nu * w2) ** 2),
            )
        if code == GREASE_THIXOTROPY:  # grease that thins with the angle swept, z0
            return -p0 * w1 * math.exp(-z0 / p1), -p0 * w2 * math.exp(-z0 / p1)
        if code == BEARING_RUNOUT:  # drag that depends on where the shaft stands
            return (
                -p0 * (1.0 + math.sin(p1 * th1 + p2)) * math.tanh(nu * w1),
                -p0 * (1.0 + math.sin(p1 * th2 + p3)) * math.tanh(nu * w2),
            )
        if code == WAKE_DRAG:  # air set in motion: drag remembers w abs(w)
            return -p0 * z0, -p0 * z1
        if code == ONE_WAY_DRAG:  # a seal whose lip drags one way only
            return -p0 * 0.5 * (1.0 + math.tanh(nu * w1)), -p0 * 0.5 * (1.0 + math.tanh(nu * w2))
        if code == RACE_DENT:  # balls climb out of a dent at the angle p1, width p2
            s1, s2 = (th1 - p1) / p2, (th2 - p1) / p2
            return -p0 * s1 * math.exp(-0.5 * s1 * s1), -p0 * s2 * math.exp(-0.5 * s2 * s2)
        if code == DRY_RUNNING:  # grease wrung out by rolling: dry drag that grows with the angle swept, z
            return (
                -p0 * (1.0 - math.exp(-z0 / p1)) * math.tanh(nu * w1),
                -p0 * (1.0 - math.exp(-z1 / p1)) * math.tanh(nu * w2),
            )
        if code == FLUTED_RACE:  # washboard of the races, as stray currents burn it
            return p0 * math.sin(p1 * th1 + p2), p0 * math.sin(p1 * th2 + p3)
        if code == OIL_STARVATION:  # the oil's supply fails for a spell
            s = (t - p1) / p2
            a = p0 * math.sin(math.pi * s) ** 2 if 0.0 < s < 1.0 else 0.0
            return -a * math.tanh(nu * w1), -a * math.tanh(nu * w2)
        if code == THIN_FILM:  # dry drag as far as the oil's film, z, is missing
            return -p0 * (1.0 - z0) * math.tanh(nu * w1), -p0 * (1.0 - z1) * math.tanh(nu * w2)
        if code == LOOSE_RING:  # a share of each inertia slides on its shaft above the acceleration p1; its speed is z
            share = p0 * p1 / (1.0 - p0)
            return (
                -share * g[J1] * math.tanh((w1 - z0) / RING_SMOOTH),
                -share * g[J2] * math.tanh((w2 - z1) / RING_SMOOTH),
            )
        if code == SEAL_FLUTTER:  # a lip beats on its shaft from one speed on, until a lower one (z = share that beats)
            return -p0 * z0 * math.tanh(nu * w1), -p0 * z1 * math.tanh(nu * w2)
        if code == ROLLING_JOURNAL:  # half the slope of an inertia that depends on the angle, times the squared speed
            return (
                -0.5 * p0 * g[J1] * p1 * math.cos(p1 * th1 + p2) * w1 * w1,
                -0.5 * p0 * g[J2] * p1 * math.cos(p1 * th2 + p3) * w2 * w2,
            )
        if code == AIR_HAMMER:  # the film of air collapses again and again, and the shafts touch
            a = p0 * math.sin(0.5 * p1 * t + p2) ** 4
            return -a * math.tanh(nu * w1), -a * math.tanh(nu * w2)
        if code == SKIDDING_BALLS:  # balls that cannot follow the acceleration skid (z = share that does)
            return -p0 * z0 * math.tanh(nu * w1), -p0 * z1 * math.tanh(nu * w2)
        if code == GREASE_WALLS:  # grease stands at the ends of the channel (z = its half length) and flows back
            return -p0 * wall_drag(abs(th1) - z0, w1, nu), -p0 * wall_drag(abs(th2) - z1, w2, nu)
        return 0.0, 0.0
    if code < 60:
        if not coupled:  # there is no interface
            return 0.0, 0.0
        phi = th1 - th2
        if code == MAGNET_CUBIC:  # field of a small magnet: falls off as (1 + (phi/b)^2)^(-3/2)
            q = -p0 * g[K2] * phi * ((1.0 + (phi / p1) ** 2) ** -1.5 - 1.0)
            return q, -q
        if code == EDDY_OVERLAP:  # square of the area that two discs share
            a = lens_area(g[BAR] * abs(phi) / (2.0 * g[FACE]))
            q = -p0 * a * a * (w1 - w2)
            return q, -q
        if code == INTERFACE_RELAXATION:  # two Maxwell arms, times p1 and 3 p1
            q = -p0 * (z0 + 0.3 * z1)
            return q, -q
        if code == MAGNETIC_COGGING:
            q = -p0 * math.sin(p1 * phi)
            return q, -q
        if code == ASYMMETRIC_MAGNET:
            q = -p0 * g[K2] * math.sqrt(phi * phi + 1e-6)
            return q, -q
        if code == FACE_STOP:  # pins between the faces, play p1 either side
            q = -p0 * (phi - min(max(phi, -p1), p1))
            return q, -q
        if code == FACE_GRAIN:  # a grain in the Teflon ploughs where it meets the other face
            v = w1 - w2
            q = -p0 * math.exp(-(((phi - p1) / p2) ** 2)) * v / math.sqrt(v * v + 9e-4)
            return q, -q
        if code == REST_ADHESION:  # faces that cling after a rest, until torn apart (z0 = share torn)
            q = -p0 * phi * (1.0 - z0)
            return q, -q
        if code == GROOVED_FACES:  # tool marks of both faces that mesh and part as they turn on each other
            q = -p0 * (1.0 + math.sin(p1 * phi + p2)) * math.tanh(nu * (w1 - w2))
            return q, -q
        if code == GAP_CREEP:  # the magnet's stiffness follows its pull
            q = -p0 * g[K2] * phi * (1.0 - math.exp(-t / p1))
            return q, -q
        if code == COMBED_TEFLON:  # a nap that resists one way of sliding more than the other
            v = w1 - w2
            q = -p0 * g[MU] * pull * g[BAR] * math.tanh(nu * v) * v / math.sqrt(v * v + p1 * p1)
            return q, -q
        if code == FLOATING_WASHER:  # a washer rubs too, once it has met its pin (z0 = -1 or 1)
            v = w1 - w2
            q = -p0 * g[MU] * pull * g[BAR] * math.tanh(nu * v) * (1.0 - washer_free(z0, v))
            return q, -q
        if code == SHORTED_LOOP:  # current z0 of a closed turn whose flux is largest at phi = 0
            q = -p0 * z0 * flux_slope(phi / p1)
            return q, -q
        return 0.0, 0.0
    if code == UNBALANCED_BAR:
        return 0.0, p0 * math.sin(th2 + p1)
    if code == GUARD_RUB:  # secondary rubs at its guard beyond the angle p1
        s = (th2 - p1) / 0.004
        return 0.0, -p0 * math.tanh(nu * w2) * 0.5 * (1.0 + math.tanh(s))
    if code == CABLE_PULL:  # the accelerometer's cable, stiffer the more it is bent, with loss
        return 0.0, -p0 * (th2 * abs(th2) / 0.1 + p1 * w2)
    if code == STRAY_IRON:  # the secondary's magnet and a bolt of the frame at the angle p1
        s = (th2 - p1) / p2
        return 0.0, -p0 * s / (1.0 + s * s) ** 2
    if code == SECOND_KNOCK:
        s = (t - p1) / p2
        return 0.0, (p0 * math.sin(math.pi * s) if 0.0 < s < 1.0 else 0.0)
    if code == BAR_PADDLE:  # the secondary's bar stirs the air
        return 0.0, -p0 * w2 * abs(w2)
    if code == CABLE_LOOP:  # strands of the cable slip on each other: two elastic sliders
        return 0.0, -0.5 * p0 * (z0 + z1)
    if code == FOAM_BUMPER:  # the far end of the swing meets foam: Hunt and Crossley's contact
        deep = -p1 - th2
        return 0.0, (p0 * deep**1.5 * max(0.0, 1.0 - p2 * w2) if deep > 0.0 else 0.0)
    if code == BAR_WHIP:  # a share of J2 on the bending bar: bend z0, rate z1
        share = p0 * g[J2] / (1.0 - p0)
        return 0.0, share * (p1 * p1 * z0 + 2.0 * p2 * p1 * z1)
    if code == DRAUGHT:  # the room's air blows on the bar in gusts
        u = p1 * (1.0 + 0.6 * math.sin(p2 * t)) - w2
        return 0.0, p0 * u * abs(u)
    if code == FRAME_EDDIES:  # currents in a plate of the frame that the secondary's magnet passes at the angle p1
        s = (th2 - p1) / p2
        return 0.0, -p0 * w2 / (1.0 + s * s) ** 2
    if code == SLIDING_RIDER:  # takes up angular momentum while it moves outwards (z0 = share of its way)
        return 0.0, -p0 * g[J2] * (1.0 - z0) * w2**3 / p1
    if code == LEAKY_BELLOWS:  # a dust bellows pumps air through a hole and a valve (z0 = how far it is compressed)
        return 0.0, -p0 * z0
    if code == HANGING_WEIGHT:  # a weight on a cord draws the secondary to one side and bounces (z0 = cord's stretch)
        return 0.0, -p3 * p0 * cord_tension(z0, p3 * w2 - z1, p1, p2)
    if code == HEALING_RUBBER:  # the coupling's rubber softens as it is worked and hardens at rest (z0 = bonds broken)
        return p0 * g[K1] * th1 * z0 / (1.0 + z0), 0.0
    if code == HOOKED_COIL:  # two coils hook for a while: one more spring, at rest where they met (z0 = its twist)
        return -p0 * g[K1] * z0, 0.0
    if code == YIELDING_ANCHOR:  # the spring's far end slides in its clamp under too much torque (z0 = its angle)
        return g[K1] * z0, 0.0
    if code == IRON_WHISKERS:  # filings bridge the gap, tear, and bridge it anew (z0 = stretch, z1 = share torn)
        if not coupled:
            return 0.0, 0.0
        q = -p0 * z0 / p1
        return q, -q
    if code == TURNED_MAGNET:  # the magnet turns in its seat: another middle of its pull and its stiffness
        if not coupled:
            return 0.0, 0.0
        phi = th1 - th2
        moved = p0 * 0.5 * (1.0 + math.tanh((t - p1) / p2))
        near, now = abs(phi), abs(phi - moved)
        gained = max(0.0, 1.0 - g[BAR] * now / (2.0 * g[FACE])) - max(0.0, 1.0 - g[BAR] * near / (2.0 * g[FACE]))
        q = g[K2] * moved - g[MU] * g[N0] * gained * g[BAR] * math.tanh(nu * (w1 - w2))
        return q, -q
    if code == RINGING_COIL:  # the secondary's magnet passes a coil with a capacitor (z0 = its charge, z1 = current)
        return 0.0, -p0 * coil_flux(th2, p3) * z1
    if code == DRIPPING_HOSE:  # drops fall on the secondary, one every p1 from p2 on
        s = ((t - p2) % p1) / DROP_TIME if t > p2 else 0.0
        return 0.0, (p0 * math.sin(math.pi * s) ** 2 if s < 1.0 else 0.0)
    if code == SIDEWAYS_SHAKE:  # the faces shake across their sliding too, so friction points elsewhere
        if not coupled:
            return 0.0, 0.0
        v = w1 - w2
        speed = math.hypot(v, p0 * math.sin(p1 * t) * math.exp(-t / p2))
        lost = 1.0 - abs(v) / speed if speed > 0.0 else 0.0
        q = g[MU] * pull * g[BAR] * math.tanh(nu * v) * lost
        return q, -q
    if code == WORN_THROUGH:  # after so much sliding the Teflon is gone and metal rubs (z0 = way slid)
        if not coupled:
            return 0.0, 0.0
        gone = 0.5 * (1.0 + math.tanh((z0 - p1) / WEAR_EDGE))
        q = -p0 * gone * g[MU] * pull * g[BAR] * math.tanh(nu * (w1 - w2))
        return q, -q
    if code == CHARGED_TEFLON:  # rubbing charges the Teflon, the charge z0 draws the faces together
        if not coupled:
            return 0.0, 0.0
        q = -p0 * z0 * z0 * lens_area(g[BAR] * abs(th1 - th2) / (2.0 * g[FACE])) * math.tanh(nu * (w1 - w2))
        return q, -q
    if code == RELEASE_REBOUND:  # the pad springs back and touches the bar again
        s = (t - p1) / p2
        return (-p0 * math.sin(math.pi * s) ** 2 if 0.0 < s < 1.0 else 0.0), 0.0
    if code == RELEASE_RAMP:  # half a cosine
        if t < p0:
            return g[K1] * g[TH0] * 0.5 * (1.0 + math.cos(math.pi * t / p0)), 0.0
        return 0.0, 0.0
    if code == RELEASE_DRAG:  # the pad slides along the bar while it retreats
        return -p0 * math.exp(-t / p1) * math.tanh(50.0 * w1), 0.0
    if code == SECOND_JAW:  # one jaw lets go at once, the other at p1 within p2
        s = min(max((t - p1) / p2, 0.0), 1.0)
        return p0 * g[K1] * g[TH0] * 0.5 * (1.0 + math.cos(math.pi * s)), 0.0
    if code == LATE_SECONDARY:  # the pad still brakes the secondary bar for the time p0
        return 0.0, (-2.0 * w2 * (1.0 - (t / p0) ** 8) if t < p0 else 0.0)
    if code == STICKY_PAD:  # the pad clings to the bar and is stretched until it tears off (z0 = share torn)
        return p0 * (g[TH0] - th1) * (1.0 - z0), 0.0
    if code == SOLENOID_PULL:  # remanent iron of the actuator draws the bar back to where it was held
        return p0 / (1.0 + max(0.0, g[TH0] - th1) / p1) ** 2, 0.0
    if code == TRAILING_THREAD:  # the cut thread is drawn through its eye, taut only beyond the farthest point, z0
        inside = 0.5 * (1.0 - math.tanh((g[TH0] - th1 - p1) / 2e-3))
        return p0 * math.tanh(max(0.0, z0 - th1) / 1e-4) * inside, 0.0
    if code == VENTING_CYLINDER:  # the actuator's air blows on the bars until its cylinder is empty
        jet = p0 * max(0.0, 1.0 - t / p1) ** 2
        return jet, p2 * jet
    return 0.0, 0.0


@njit(cache=True)
def memory_rates(code, t, th1, th2, w1, w2, a1, a2, z0, z1, p0, p1, p2, p3, g, friction):
    """Rates of the two memories of one disturbance; friction = dry friction torque of the interface, N m."""
    if code == COUPLING_HYSTERESIS:  # Bouc-Wen with n = 2; p1 = angle of yield, p2 = beta of beta + gamma = 1
        return w1 * (1.0 - z0 * z0 * ((1.0 - p2) + math.copysign(p2, w1 * z0))) / p1, 0.0
    if code == FLEXIBLE_SHAFT:
        return z1, -p1 * p1 * z0 - 2.0 * p2 * p1 * z1 - a1
    if code == CLAMP_PLAY:
        reach = z0 - min(max(z0, -p2), p2)
        return z1, -p1 * p1 * reach - 0.1 * p1 * z1 * (1.0 if reach != 0.0 else 0.1) - a1
    if code == GREASE_THIXOTROPY:
        return abs(w1), 0.0
    if code == WAKE_DRAG:
        return (w1 * abs(w1) - z0) / p1, (w2 * abs(w2) - z1) / p1
    if code == MAGNET_FADE:
        v = w1 - w2
        return (friction * v + g[C2] * v * v) / 0.049, 0.0
    if code == INTERFACE_RELAXATION:
        v = w1 - w2
        return v - z0 / p1, v - z1 / (3.0 * p1)
    if code == DRY_RUNNING:
        return abs(w1), abs(w2)
    if code == REST_ADHESION:
        return (1.0 - z0) / 1e-3 * 0.5 * (1.0 + math.tanh((abs(th1 - th2) / p1 - 1.0) / 0.05)), 0.0
    if code == CABLE_LOOP:  # each slider gives way at z = 1; the second needs three times the angle
        free0 = 0.5 * (1.0 - math.tanh((math.copysign(z0, z0 * w2) - 1.0) / 0.05))
        free1 = 0.5 * (1.0 - math.tanh((math.copysign(z1, z1 * w2) - 1.0) / 0.05))
        return w2 * free0 / p1, w2 * free1 / (3.0 * p1)
    if code == SPRING_CREEP:
        return w1 - z0 / p1, 0.0
    if code == BAR_WHIP:
        return z1, -p1 * p1 * z0 - 2.0 * p2 * p1 * z1 - a2
    if code == STICKY_PAD:
        return (1.0 - z0) / 1e-3 * 0.5 * (1.0 + math.tanh(((g[TH0] - th1) / p1 - 1.0) / 0.05)), 0.0
    if code == SNAPPING_LEAF:  # within a millisecond, beyond p1 or below p1 - p2
        out = 0.5 * (1.0 + math.tanh((th1 - p1) / 1e-3))
        back = 0.5 * (1.0 - math.tanh((th1 - p1 + p2) / 1e-3))
        return (out * (1.0 - z0) - back * z0) / 1e-3, 0.0
    if code == THIN_FILM:
        return (1.0 - z0) * abs(w1) / p1 - z0 / p2, (1.0 - z1) * abs(w2) / p1 - z1 / p2
    if code == LOOSE_RING:
        return p1 * math.tanh((w1 - z0) / RING_SMOOTH), p1 * math.tanh((w2 - z1) / RING_SMOOTH)
    if code == FLOATING_WASHER:
        return (w1 - w2) / p1 * washer_free(z0, w1 - w2), 0.0
    if code == SLIDING_RIDER:
        return (1.0 - z0) * w2 * w2 / p1, 0.0
    if code == VIRGIN_RUBBER:
        return max(0.0, -th1 - z0) / FOLLOW, max(0.0, th1 - z1) / FOLLOW
    if code == BREATHING_COIL:
        return z1, p1 * p1 * ((th1 / 0.1) ** 2 - z0) - 2.0 * p2 * p1 * z1
    if code == SEAL_FLUTTER:
        return flutter_rate(z0, abs(w1), p1, p1 * p2), flutter_rate(z1, abs(w2), p1, p1 * p2)
    if code == SHORTED_LOOP:
        return (w1 - w2) * flux_slope((th1 - th2) / p1) - z0 / p2, 0.0
    if code == CHARGED_TEFLON:
        return (1.0 - z0) * abs(w1 - w2) / p1 - z0 / p2, 0.0
    if code == LEAKY_BELLOWS:  # flow as the root of the pressure, in through the valve p2 times as easily as out
        return w2 - p1 * (p2 if z0 < 0.0 else 1.0) * z0 / math.sqrt(math.sqrt(z0 * z0 + 1e-6)), 0.0
    if code == TRAILING_THREAD:
        return -max(0.0, z0 - th1) / FOLLOW, 0.0
    if code == HEALING_RUBBER:
        return abs(w1) / p1 - z0 / p2, 0.0
    if code == SKIDDING_BALLS:
        return skid_rate(z0, a1, p1), skid_rate(z1, a2, p1)
    if code == WORN_THROUGH:
        return abs(w1 - w2), 0.0
    if code == HANGING_WEIGHT:  # the weight, at the speed z1, falls freely while the cord is slack
        stretching = p3 * w2 - z1
        return stretching, p2 * (cord_tension(z0, stretching, p1, p2) - 1.0)
    if code == HOOKED_COIL:
        share = hooked(t, p1, p2)
        return share * w1 - (1.0 - share) * z0 / HOOK_TIME, 0.0
    if code == YIELDING_ANCHOR:
        load = g[K1] * (th1 - z0)
        return p0 * math.copysign(max(0.0, abs(load) - p1), load), 0.0
    if code == GREASE_WALLS:
        return (
            max(0.0, abs(th1) - z0) / FOLLOW - z0 / p1,
            max(0.0, abs(th2) - z1) / FOLLOW - z1 / p1,
        )
    if code == IRON_WHISKERS:  # torn beyond the stretch p1 until three tenths of it are left
        return (1.0 - z1) * (w1 - w2) - z1 * z0 / TEAR_TIME, flutter_rate(z1, abs(z0) / p1, 1.0, 0.3)
    if code == RINGING_COIL:
        return z1, coil_flux(th2, p3) * w2 - p1 * p1 * z0 - 2.0 * p2 * p1 * z1
    if code == RIDING_ARM:
        return (1.0 - z0) / 1e-3 * 0.5 * (1.0 + math.tanh(((g[TH0] - th1) / p1 - 1.0) / 0.05)), 0.0
    return 0.0, 0.0


@njit(cache=True)
def bristle_goal(v, nu, excess, speed, yield_angle):
    """(steady deflection, rate in 1/s) of the bristles at the sliding velocity v; deflection 1 = kinetic friction."""
    hump = 1.0 + excess * math.exp(-((v / speed) ** 2))
    s = nu * abs(v)
    curve = hump * math.tanh(s)
    pace = abs(v) / curve if s > 1e-9 else 1.0 / (hump * nu)
    return math.copysign(curve, v), pace / max(yield_angle, 1e-300)


@njit(cache=True)
def accelerations(t, th1, th2, w1, w2, z, bristle, k, P, g, coupled, rates):
    """(a1, a2) at one instant; fills `rates` (4,) of the memories. `bristle` replaces tanh(nu v) when k says so."""
    nu = g[NU]
    m1 = -g[C1] * w1 - g[K1] * th1 - g[DRAG] * math.tanh(nu * w1)
    m2 = 0.0
    pull = 0.0
    friction = 0.0
    if coupled:
        phi = th1 - th2
        v = w1 - w2
        pull = g[N0] * max(0.0, 1.0 - g[BAR] * abs(phi) / (2.0 * g[FACE]))
        rough = 1.0
        sticky = False
        for i in range(2):
            if k[i] >= 40 and k[i] < 60:
                n, f = pull_and_friction(k[i], t, th1, th2, z[2 * i], P[i, 0], P[i, 1], P[i, 2], P[i, 3], g)
                pull *= n
                rough *= f
                sticky = sticky or k[i] == STICK_SLIP
        slide = bristle if sticky else math.tanh(nu * v)
        friction = g[MU] * rough * pull * g[BAR] * slide
        T = g[K2] * phi + g[C2] * v + friction
        m1 -= T
        m2 = T - g[C3] * w2 - g[DRAG] * math.tanh(nu * w2)
    for i in range(2):
        if k[i] > 0:
            q1, q2 = torques(
                k[i], t, th1, th2, w1, w2, z[2 * i], z[2 * i + 1], P[i, 0], P[i, 1], P[i, 2], P[i, 3], g, pull, coupled
            )
            m1 += q1
            m2 += q2
    a1 = m1 / g[J1]
    a2 = m2 / g[J2] if coupled else 0.0
    for i in range(2):
        if k[i] == SLIDING_RIDER:
            a2 /= 1.0 + P[i, 0] * z[2 * i]
        elif k[i] == ROLLING_JOURNAL:
            a1 /= 1.0 + P[i, 0] * math.sin(P[i, 1] * th1 + P[i, 2])
            a2 /= 1.0 + P[i, 0] * math.sin(P[i, 1] * th2 + P[i, 3])
        elif k[i] == DROPPED_NUT:  # a share of J2 falls off at an instant
            a2 /= 1.0 - P[i, 0] * 0.5 * (1.0 + math.tanh((t - P[i, 1]) / P[i, 2]))
        elif k[i] == RIDING_ARM:  # the release's arm rides on the primary until it falls off (z = share that has)
            a1 /= 1.0 + P[i, 0] * (1.0 - z[2 * i])
    for i in range(2):
        if k[i] > 0:
            r0, r1 = memory_rates(
                k[i],
                t,
                th1,
                th2,
                w1,
                w2,
                a1,
                a2,
                z[2 * i],
                z[2 * i + 1],
                P[i, 0],
                P[i, 1],
                P[i, 2],
                P[i, 3],
                g,
                friction,
            )
            rates[2 * i] = r0
            rates[2 * i + 1] = r1
    return a1, a2


@njit(cache=True)
def integrate(g, k, P, start, coupled, step, steps, keep):
    """Motion from release, every `keep` steps of `step` seconds.

    g : (14,) rig constants in the order of RIG_FIELDS; k : (2,) codes; P : (2, 4) their numbers;
    start : (8,) th1, th2, w1, w2 and the four memories.
    Returns (steps // keep + 1, 6): th1, th2, w1, w2, a1, a2.
    """
    out = np.empty((steps // keep + 1, 6))
    th1, th2, w1, w2 = start[0], start[1], start[2], start[3]
    z = start[4:8].copy()
    zs = np.empty(4)
    r1 = np.zeros(4)
    r2 = np.zeros(4)
    r3 = np.zeros(4)
    r4 = np.zeros(4)
    slot = -1
    for i in range(2):
        if k[i] == STICK_SLIP:
            slot = i
    excess, speed, yielding = 0.0, 1.0, 1.0
    if slot >= 0:
        excess, speed, yielding = P[slot, 0], P[slot, 1], P[slot, 0] * P[slot, 2]
    nu = g[NU]
    bristle = 0.0
    b2 = b3 = b4 = 0.0
    h = 0.5 * step
    for j in range(steps + 1):
        t = j * step
        a1, a2 = accelerations(t, th1, th2, w1, w2, z, bristle, k, P, g, coupled, r1)
        if j % keep == 0:
            o = j // keep
            out[o, 0], out[o, 1], out[o, 2], out[o, 3], out[o, 4], out[o, 5] = th1, th2, w1, w2, a1, a2
        if j == steps:
            break
        u1, u2 = w1 + h * a1, w2 + h * a2
        for i in range(4):
            zs[i] = z[i] + h * r1[i]
        if slot >= 0:
            goal, pace = bristle_goal(u1 - u2, nu, excess, speed, yielding)
            b2 = goal + (bristle - goal) * math.exp(-pace * h)
        p1, p2 = accelerations(t + h, th1 + h * w1, th2 + h * w2, u1, u2, zs, b2, k, P, g, coupled, r2)
        v1, v2 = w1 + h * p1, w2 + h * p2
        for i in range(4):
            zs[i] = z[i] + h * r2[i]
        if slot >= 0:
            goal, pace = bristle_goal(v1 - v2, nu, excess, speed, yielding)
            b3 = goal + (bristle - goal) * math.exp(-pace * h)
        q1, q2 = accelerations(t + h, th1 + h * u1, th2 + h * u2, v1, v2, zs, b3, k, P, g, coupled, r3)
        x1, x2 = w1 + step * q1, w2 + step * q2
        for i in range(4):
            zs[i] = z[i] + step * r3[i]
        if slot >= 0:
            goal, pace = bristle_goal(v1 - v2, nu, excess, speed, yielding)
            b4 = goal + (bristle - goal) * math.exp(-pace * step)
        e1, e2 = accelerations(t + step, th1 + step * v1, th2 + step * v2, x1, x2, zs, b4, k, P, g, coupled, r4)
        th1 += step / 6.0 * (w1 + 2.0 * u1 + 2.0 * v1 + x1)
        th2 += step / 6.0 * (w2 + 2.0 * u2 + 2.0 * v2 + x2)
        w1 += step / 6.0 * (a1 + 2.0 * p1 + 2.0 * q1 + e1)
        w2 += step / 6.0 * (a2 + 2.0 * p2 + 2.0 * q2 + e2)
        for i in range(4):
            z[i] += step / 6.0 * (r1[i] + 2.0 * r2[i] + 2.0 * r3[i] + r4[i])
        if slot >= 0:
            middle, pace = bristle_goal(v1 - v2, nu, excess, speed, yielding)
            goal, _ = bristle_goal(w1 - w2, nu, excess, speed, yielding)
            if pace * step < 5.0:
                goal = middle
            bristle = goal + (bristle - goal) * math.exp(-pace * step)
    return out


def rig_array(values: dict[str, float]) -> NDArray[np.float64]:
    """Rig constants by name (SI) as the array that `integrate` takes."""
    return np.array([values[name] for name in RIG_FIELDS])
