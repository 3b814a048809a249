"""Kinds that were reserved for the third to seventh proofs and are known since, each against a second implementation.

Each is written out once more and integrated by an adaptive method, or laid on the nominal record, or integrated behind
it, where it is of the sensors.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from withheld_reference import (
    K1,
    NU,
    RIG,
    TH0,
    TIMES,
    assert_level_one_is_reached,
    assert_motion_agrees,
    fine_record,
    kinds,
    opposite,
    simulate,
    step,
)

J1, J2 = RIG["J1"], RIG["J2"]


def slider(z, w):
    return 1.0 - step(z * np.sign(w), 1.0, 0.05)


def bumper(x):
    deep = max(0.0, -0.02 - x[1])
    return 6.0 * deep**1.5 * max(0.0, 1.0 - 0.3 * x[3])


def jaw(t):
    share = 1.0 if t < 0.012 else (0.0 if t > 0.014 else math.cos(0.5 * math.pi * (t - 0.012) / 0.002) ** 2)
    return 0.05 * K1 * TH0 * share


def dry(z, w):
    return -0.03 * (1.0 - math.exp(-z / 0.2)) * math.tanh(NU * w)


def spell(t, w):
    share = math.sin(math.pi * (t - 0.05) / 0.2) ** 2 if 0.05 < t < 0.25 else 0.0
    return -0.03 * share * math.tanh(NU * w)


def settled(t):
    return 0.3 * (1.0 - math.exp(-t / 0.15))


def gust(t, w):
    u = -3.0 * (1.0 + 0.6 * math.sin(20.0 * t)) - w
    return 0.004 * math.copysign(u * u, u)


def bent(x):
    """Torque of the bending mode on the rest of the bar over (share of J2) (100 rad/s)^2."""
    return x[4] + 2.0 * 0.01 / 100.0 * x[5]


def bending(x, d):
    """(Torque on the rest of the bar, rates of bend and its speed); the bar's acceleration from its own balance."""
    q = 0.05 * RIG["J2"] * 1e4 * bent(x)
    T = RIG["k2t"] * (x[0] - x[1]) + RIG["c2t"] * (x[2] - x[3]) + d
    a2 = (T - RIG["c3t"] * x[3] - RIG["drag"] * math.tanh(NU * x[3]) + q) / (0.95 * RIG["J2"])
    return 0.0, q, x[5], -1e4 * bent(x) - a2


def held(x):
    """Rate of the buckled share: buckles beyond 0.03 rad, springs back below 0.018 rad, within a millisecond."""
    return 1e3 * (step(x[0], 0.03, 1e-3) * (1.0 - x[4]) - (1.0 - step(x[0], 0.018, 1e-3)) * x[4])


def film(z, w):
    """Torque on a shaft whose film is z thick, and the film's growth."""
    return -0.03 * (1.0 - z) * math.tanh(NU * w), (1.0 - z) * abs(w) / 0.04 - z / 0.1


def ring(z, w, inertia):
    """Torque of a ring of speed z on its shaft and the ring's acceleration; a tenth of the inertia, slides at 40."""
    a = 40.0 * math.tanh(100.0 * (w - z))
    return -0.1 * inertia * a, a


def nap(x, d):
    v = x[2] - x[3]
    return opposite(-0.4 * d * v / math.hypot(v, 0.05))


def washer(x, d):
    """Torques of a washer with 6 mrad of play; its way over the play."""
    v = x[2] - x[3]
    free = 1.0 - step(x[4] * np.sign(v), 1.0, 0.05)
    return *opposite(-0.8 * d * (1.0 - free)), v * free / 0.006


def flung(x, d):
    """Torque on J2 that a growing inertia stands for, from its angular momentum, and the rider's speed."""
    T = RIG["k2t"] * (x[0] - x[1]) + RIG["c2t"] * (x[2] - x[3]) + d
    rest = T - RIG["c3t"] * x[3] - RIG["drag"] * math.tanh(NU * x[3])
    pace = (1.0 - x[4]) * x[3] ** 2 / 0.6
    a2 = (rest - RIG["J2"] * 0.1 * pace * x[3]) / (RIG["J2"] * (1.0 + 0.1 * x[4]))
    return 0.0, RIG["J2"] * a2 - rest, pace


def both(first, second):
    """(torque, rate) of the primary's and the secondary's part as torques, then rates."""
    return first[0], second[0], first[1], second[1]


def rubber(x):
    """Torque of rubber that is a tenth stiffer 10 mrad around its farthest points, which it takes over in 0.5 ms."""
    angle, left, right = x[0], x[4], x[5]
    short = right - angle if angle >= 0.0 else left + angle
    virgin = 1.0 if short < 0.0 else math.exp(-short / 0.01)
    return -0.1 * K1 * angle * virgin, 0.0, 2e3 * max(0.0, -angle - left), 2e3 * max(0.0, angle - right)


def coil(x):
    """Torque that a shortened coil lacks; its bounce at 90 rad/s, 2 % damped."""
    return 0.1 * K1 * x[0] * x[4], 0.0, x[5], 8100.0 * (100.0 * x[0] ** 2 - x[4]) - 3.6 * x[5]


def lip(z, w):
    """Drag of a lip that beats from 1.2 to 0.36 rad/s; rate of its share."""
    speed = abs(w)
    return -0.03 * z * math.tanh(NU * w), 1e3 * (
        step(speed, 1.2, 0.05) * (1.0 - z) - (1.0 - step(speed, 0.36, 0.05)) * z
    )


def rolled(x, d):
    """Torques that stand for inertias 1 + 0.1 sin(20 th + phase): J' w^2 + J a = J' w^2 / 2 + rest."""
    T = RIG["k2t"] * (x[0] - x[1]) + RIG["c2t"] * (x[2] - x[3]) + d
    rests = (
        -RIG["c1t"] * x[2] - K1 * x[0] - RIG["drag"] * math.tanh(NU * x[2]) - T,
        -RIG["c3t"] * x[3] - RIG["drag"] * math.tanh(NU * x[3]) + T,
    )
    out = []
    for inertia, phase, th, w, rest in zip((J1, J2), (1.0, 4.0), x[:2], x[2:4], rests, strict=True):
        now, ahead, behind = (inertia * (1.0 + 0.1 * math.sin(20.0 * (th + h) + phase)) for h in (0.0, 1e-5, -1e-5))
        a = (rest - 0.5 * (ahead - behind) / 2e-5 * w * w) / now
        out.append(inertia * a - rest)
    return tuple(out)


def turn(x):
    """Torques and current of a closed turn, flux exp(-s^2 / 2) at s = phi / 25 mrad, time constant 8 ms."""
    s = (x[0] - x[1]) / 0.025
    slope = s * math.exp(-0.5 * s * s)
    return *opposite(-4.0 * slope * x[4]), slope * (x[2] - x[3]) - x[4] / 0.008


def charge(x):
    """Torques and charge of the Teflon: built within 0.06 rad, lost within 0.2 s; the faces' shared area by a chord."""
    v = x[2] - x[3]
    half = 2.0 * math.acos(min(1.0, RIG["R"] * abs(x[0] - x[1]) / (2.0 * RIG["r"])))  # angle of the shared lens
    area = (half - math.sin(half)) / math.pi
    return *opposite(-0.1 * x[4] ** 2 * area * math.tanh(NU * v)), (1.0 - x[4]) * abs(v) / 0.06 - x[4] / 0.2


def bellows(x):
    """Torque on the secondary and compression of a bellows that draws in four times as easily as it blows out."""
    wide = 20.0 if x[4] < 0.0 else 5.0
    return 0.0, -0.5 * x[4], x[3] - wide * x[4] * (x[4] ** 2 + 1e-6) ** -0.25


def thread(x):
    """Torque of a thread of 0.09 rad that is drawn further wherever the bar is beyond its farthest point."""
    beyond = max(0.0, x[4] - x[0])
    return 0.05 * math.tanh(1e4 * beyond) * (1.0 - step(TH0 - x[0], 0.09, 2e-3)), 0.0, -2e3 * beyond


def worked(x):
    """Torque that worked rubber lacks; bonds broken by 0.3 rad of work, healed within 0.15 s."""
    return 0.2 * K1 * x[0] * (1.0 - 1.0 / (1.0 + x[4])), 0.0, abs(x[2]) / 0.3 - x[4] / 0.15


def collapse(t, w):
    """Drag of a film that collapses 12 times a second: sin^4 y = 3/8 - cos 2y / 2 + cos 4y / 8."""
    y = 12.0 * math.pi * t + 0.7
    return -0.03 * (0.375 - 0.5 * math.cos(2.0 * y) + 0.125 * math.cos(4.0 * y)) * math.tanh(NU * w)


def skid(x, d):
    """Drags of balls that skid above 60 rad/s^2; rates of their shares, from the balances of both bars."""
    T = RIG["k2t"] * (x[0] - x[1]) + RIG["c2t"] * (x[2] - x[3]) + d
    q = [-0.03 * z * math.tanh(NU * w) for z, w in zip(x[4:6], x[2:4], strict=True)]
    a1 = (q[0] - RIG["c1t"] * x[2] - K1 * x[0] - RIG["drag"] * math.tanh(NU * x[2]) - T) / J1
    a2 = (q[1] - RIG["c3t"] * x[3] - RIG["drag"] * math.tanh(NU * x[3]) + T) / J2
    return *q, *(500.0 * (step(abs(a), 60.0, 6.0) - z) for a, z in zip((a1, a2), x[4:6], strict=True))


def shaken(t, x, d):
    """Torques that turn the friction by the angle between sliding and the faces' whole velocity."""
    v = x[2] - x[3]
    across = 2.0 * math.exp(-t / 0.2) * math.sin(150.0 * t)
    return opposite(d * (1.0 - abs(math.cos(math.atan2(across, v)))))


def bare_metal(x, d):
    """Torques of friction that is 0.8 stronger after 0.1 rad; the way slid."""
    return *opposite(-0.8 * d * step(x[4], 0.1, 0.004)), abs(x[2] - x[3])


def lighter(t, x, d):
    """Torque that stands for the secondary without the fifth that has fallen off."""
    T = RIG["k2t"] * (x[0] - x[1]) + RIG["c2t"] * (x[2] - x[3]) + d
    rest = T - RIG["c3t"] * x[3] - RIG["drag"] * math.tanh(NU * x[3])
    return 0.0, rest * (J2 / (J2 - 0.2 * J2 * step(t, 0.15, 0.001)) - 1.0)


def weight(x):
    """Torque of a weight that falls at 120 rad/s^2 on a cord of 130 rad/s; its height and speed are followed."""
    height, speed = x[4:6]
    bar, pace = TH0 - x[1], -x[3]  # the cord runs over the side -1
    tension = max(0.0, 120.0 + 130.0**2 * (bar - height) + 13.0 * (pace - speed))
    return 0.0, 0.04 * tension / 120.0, speed, tension - 120.0


def jet(t):
    left = max(0.0, 0.12 - t) / 0.12
    return 0.1 * left * left, -0.03 * left * left


# name -> amplitude, shape, torques and rates of the memories, start of the memories
MOTIONS = {
    "clamp_slip": (0.004, (0.2, 0.004, 0.0), lambda t, x, d: (0.004 * K1 * step(t, 0.2, 0.004), 0.0), ()),
    "coil_friction": (0.04, (30.0, 0.0, 0.0), lambda t, x, d: (-0.04 * K1 * abs(x[0]) * math.tanh(30 * x[2]), 0.0), ()),
    "dry_running": (
        0.03,
        (0.2, 0.0, 0.0),
        lambda t, x, d: (dry(x[4], x[2]), dry(x[5], x[3]), abs(x[2]), abs(x[3])),
        (0.0, 0.0),
    ),
    "fluted_race": (
        0.006,
        (110.0, 1.0, 4.0),
        lambda t, x, d: (0.006 * math.sin(110 * x[0] + 1), 0.006 * math.sin(110 * x[1] + 4)),
        (),
    ),
    "axial_bounce": (
        0.5,
        (170.0, 0.4, 0.0),
        lambda t, x, d: opposite(-d * 0.5 * math.exp(-t / 0.4) * math.sin(170 * t)),
        (),
    ),
    "face_grain": (
        0.05,
        (0.02, 0.006, 0.0),
        lambda t, x, d: opposite(
            -0.05 * math.exp(-(((x[0] - x[1] - 0.02) / 0.006) ** 2)) * (x[2] - x[3]) / math.hypot(x[2] - x[3], 0.03)
        ),
        (),
    ),
    "rest_adhesion": (
        10.0,
        (0.01, 0.0, 0.0),
        lambda t, x, d: (
            *opposite(-10 * (x[0] - x[1]) * (1 - x[4])),
            1e3 * (1 - x[4]) * step(abs(x[0] - x[1]) / 0.01, 1.0, 0.05),
        ),
        (0.0,),
    ),
    "cable_loop": (
        0.03,
        (0.006, 0.0, 0.0),
        lambda t, x, d: (
            0.0,
            -0.015 * (x[4] + x[5]),
            x[3] * slider(x[4], x[3]) / 0.006,
            x[3] * slider(x[5], x[3]) / 0.018,
        ),
        (1.0, 1.0),
    ),
    "foam_bumper": (6.0, (0.02, 0.3, 0.0), lambda t, x, d: (0.0, bumper(x)), ()),
    "second_jaw": (0.05, (0.012, 0.002, 0.0), lambda t, x, d: (jaw(t), 0.0), ()),
    "late_secondary": (
        0.012,
        (0.0, 0.0, 0.0),
        lambda t, x, d: (0.0, -2.0 * x[3] * max(0.0, 1.0 - (t / 0.012) ** 8)),
        (),
    ),
    "spring_creep": (
        0.05,
        (0.03, 0.0, 0.0),
        lambda t, x, d: (-0.05 * K1 * x[4], 0.0, x[2] - x[4] / 0.03),
        (0.0,),
    ),
    "leaf_break": (
        0.05,
        (0.2, 0.002, 0.0),
        lambda t, x, d: (0.05 * K1 * x[0] * step(t, 0.2, 0.002), 0.0),
        (),
    ),
    "oil_starvation": (0.03, (0.05, 0.2, 0.0), lambda t, x, d: (spell(t, x[2]), spell(t, x[3])), ()),
    "grooved_faces": (
        0.02,
        (200.0, 1.0, 0.0),
        lambda t, x, d: opposite(-0.02 * (1.0 + math.sin(200 * (x[0] - x[1]) + 1)) * math.tanh(NU * (x[2] - x[3]))),
        (),
    ),
    "gap_creep": (
        0.3,
        (0.15, 0.0, 0.0),
        lambda t, x, d: opposite(-settled(t) * (RIG["k2t"] * (x[0] - x[1]) + d)),
        (),
    ),
    "bar_whip": (0.05, (100.0, 0.01, 0.0), lambda t, x, d: bending(x, d), (0.0, 0.0)),
    "draught": (0.004, (-3.0, 20.0, 0.0), lambda t, x, d: (0.0, gust(t, x[3])), ()),
    "sticky_pad": (
        15.0,
        (0.004, 0.0, 0.0),
        lambda t, x, d: (
            15.0 * (TH0 - x[0]) * (1.0 - x[4]),
            0.0,
            1e3 * (1.0 - x[4]) * step((TH0 - x[0]) / 0.004, 1.0, 0.05),
        ),
        (0.0,),
    ),
    "snapping_leaf": (0.03, (0.03, 0.012, 0.0), lambda t, x, d: (0.03 * x[4], 0.0, held(x)), (1.0,)),
    "thin_film": (0.03, (0.04, 0.1, 0.0), lambda t, x, d: both(film(x[4], x[2]), film(x[5], x[3])), (0.0, 0.0)),
    "loose_ring": (
        0.1,
        (40.0, 0.0, 0.0),
        lambda t, x, d: both(ring(x[4], x[2], RIG["J1"]), ring(x[5], x[3], RIG["J2"])),
        (0.0, 0.0),
    ),
    "combed_teflon": (0.4, (0.05, 0.0, 0.0), lambda t, x, d: nap(x, d), ()),
    "floating_washer": (0.8, (0.006, 0.0, 0.0), lambda t, x, d: washer(x, d), (0.0,)),
    "frame_eddies": (
        0.05,
        (-0.02, 0.015, 0.0),
        lambda t, x, d: (0.0, -0.05 * x[3] * (1.0 + ((x[1] + 0.02) / 0.015) ** 2) ** -2.0),
        (),
    ),
    "sliding_rider": (0.1, (0.6, 0.0, 0.0), lambda t, x, d: flung(x, d), (0.0,)),
    "solenoid_pull": (
        0.06,
        (0.04, 0.0, 0.0),
        lambda t, x, d: (0.06 * (0.04 / (0.04 + max(0.0, TH0 - x[0]))) ** 2, 0.0),
        (),
    ),
    "virgin_rubber": (0.1, (0.01, 0.0, 0.0), lambda t, x, d: rubber(x), (0.0, TH0)),
    "breathing_coil": (0.1, (90.0, 0.02, 0.0), lambda t, x, d: coil(x), (100.0 * TH0**2, 0.0)),
    "seal_flutter": (
        0.03,
        (1.2, 0.3, 0.0),
        lambda t, x, d: tuple(q for pair in zip(lip(x[4], x[2]), lip(x[5], x[3]), strict=True) for q in pair),
        (0.0, 0.0),
    ),
    "rolling_journal": (0.1, (20.0, 1.0, 4.0), lambda t, x, d: rolled(x, d), ()),
    "shorted_loop": (4.0, (0.025, 0.008, 0.0), lambda t, x, d: turn(x), (0.0,)),
    "charged_teflon": (0.1, (0.06, 0.2, 0.0), lambda t, x, d: charge(x), (0.0,)),
    "leaky_bellows": (0.5, (5.0, 4.0, 0.0), lambda t, x, d: bellows(x), (0.0,)),
    "trailing_thread": (0.05, (0.09, 0.0, 0.0), lambda t, x, d: thread(x), (TH0,)),
    "healing_rubber": (0.2, (0.3, 0.15, 0.0), lambda t, x, d: worked(x), (0.0,)),
    "air_hammer": (
        0.03,
        (24.0 * math.pi, 0.7, 0.0),
        lambda t, x, d: (collapse(t, x[2]), collapse(t, x[3])),
        (),
    ),
    "skidding_balls": (0.03, (60.0, 0.0, 0.0), lambda t, x, d: skid(x, d), (0.0, 0.0)),
    "sideways_shake": (2.0, (150.0, 0.2, 0.0), shaken, ()),
    "worn_through": (0.8, (0.1, 0.0, 0.0), lambda t, x, d: bare_metal(x, d), (0.0,)),
    "dropped_nut": (0.2, (0.15, 0.001, 0.0), lighter, ()),
    "hanging_weight": (0.04, (130.0, 120.0, -1.0), lambda t, x, d: weight(x), (0.0, 0.0)),
    "venting_cylinder": (0.1, (0.12, -0.3, 0.0), lambda t, x, d: jet(t), ()),
}
CHANGED = {
    "bar_whip": {"J2": 0.95 * RIG["J2"]},
    "loose_ring": {"J1": 0.9 * RIG["J1"], "J2": 0.9 * RIG["J2"]},
}
READINGS = (
    "clock_jump",
    "dead_band",
    "unequal_halves",
    "echo",
    "gauge_friction",
    "range_switch",
    "converter_pair",
    "slipping_wax",
    "zero_shift",
    "leaning_axis",
    "field_pickup",
)


@pytest.mark.parametrize("name", list(MOTIONS))
def test_motion_agrees_with_an_adaptive_method(name):
    assert_motion_agrees(name, *MOTIONS[name], **CHANGED.get(name, {}))


def test_readings_are_what_each_fault_makes_of_the_nominal_ones():
    bare = simulate.record(RIG, True, TIMES)
    finer = simulate.record(RIG, True, TIMES + 5e-4)
    jump = simulate.record(RIG, True, TIMES, [kinds.KINDS["clock_jump"].at(5e-4, (2.0, 0.1, 0.0))])
    late = TIMES >= 0.1
    np.testing.assert_array_equal(jump[:, ~late], bare[:, ~late])
    assert np.abs(jump - finer)[:, late].max() < 1e-6
    dead = simulate.record(RIG, True, TIMES, [kinds.KINDS["dead_band"].at(7.0, (1.0, 0.0, 0.0))])
    np.testing.assert_array_equal(dead[0], bare[0])
    assert np.abs(dead[1] - np.sign(bare[1]) * np.maximum(np.abs(bare[1]) - 7.0, 0.0)).max() < 1e-9
    halves = simulate.record(RIG, True, TIMES, [kinds.KINDS["unequal_halves"].at(-0.04, (0.0, 0.0, 0.0))])
    assert np.abs(halves[0] - np.where(bare[0] > 0, 0.96, 1.04) * bare[0]).max() < 0.01 * np.abs(bare).max()
    np.testing.assert_array_equal(halves[1], bare[1])


def test_an_echo_is_the_record_once_more():
    bare = simulate.record(RIG, True, TIMES)
    y = simulate.record(RIG, True, TIMES, [kinds.KINDS["echo"].at(-0.1, (1.0, 0.015, 0.0))])
    np.testing.assert_array_equal(y[0], bare[0])
    np.testing.assert_allclose(y[1, :15], bare[1, :15], atol=1e-9)
    np.testing.assert_allclose(y[1, 16:], bare[1, 16:] - 0.1 * bare[1, 1:-15], atol=1e-6)


def test_a_gauge_with_friction_follows_its_turning_points():
    """Behind the readings by p0 on the way, still while they return through twice as much."""
    half = 6.0
    bare = simulate.record(RIG, True, TIMES)
    fine = simulate.record(RIG, True, np.arange(50 * TIMES.size) * simulate.FINE_STEP)[1]
    y = simulate.record(RIG, True, TIMES, [kinds.KINDS["gauge_friction"].at(half, (1.0, 0.0, 0.0))])
    np.testing.assert_array_equal(y[0], bare[0])
    shown = [fine[0] - math.copysign(half, fine[0])]
    turn, way = fine[0], math.copysign(1.0, fine[0])  # farthest reading on the present way
    for reading in fine[1:]:
        if way * (reading - turn) > 0.0:
            turn = reading
        elif way * (turn - reading) > 2.0 * half:
            turn, way = reading, -way
        shown.append(turn - way * half)
    assert abs(y[1, 0]) < 1e-9  # at the release it stands in the middle of its play
    assert np.abs(y[1] - np.array(shown)[::50])[1:].max() < 1e-6


def test_a_logger_changes_its_range_once_the_readings_have_stayed_small():
    """Within the threshold for longer than the hold, counted on a fine record reading by reading."""
    threshold, hold = 60.0, 0.05
    kind = kinds.KINDS["range_switch"]
    bare = simulate.record(RIG, True, TIMES)
    fine = simulate.record(RIG, True, np.arange(50 * TIMES.size) * simulate.FINE_STEP)[1]
    y = simulate.record(RIG, True, TIMES, [kind.at(0.2, (1.0, threshold, hold))])
    gain, since = [], 0
    for reading in fine:
        since = 0 if abs(reading) > threshold else since + 1
        gain.append(1.2 if since > round(hold / simulate.FINE_STEP) else 1.0)
    gain = np.array(gain)[::50]
    assert 0 < np.count_nonzero(gain == 1.2) < TIMES.size
    np.testing.assert_array_equal(y[0], bare[0])
    np.testing.assert_allclose(y[1], gain * bare[1], atol=1e-6)


def test_a_pair_of_converters_reads_by_turns():
    bare = simulate.record(RIG, True, TIMES)
    y = simulate.record(RIG, True, TIMES, [kinds.KINDS["converter_pair"].at(-0.1, (0.0, 0.0, 0.0))])
    np.testing.assert_array_equal(y[1], bare[1])
    np.testing.assert_allclose(y[0, ::2], 0.95 * bare[0, ::2])
    np.testing.assert_allclose(y[0, 1::2], 1.05 * bare[0, 1::2])


def test_a_loop_without_current_to_lose_is_a_nonlinear_spring():
    """A superconducting turn (time constant endless) keeps its flux: torque -p0 p1 F F', F = 1 - exp(-s^2 / 2)."""
    width, size = 0.025, 4.0

    def kept(t, x, d):
        s = (x[0] - x[1]) / width
        fallen = math.exp(-0.5 * s * s)
        return opposite(-size * width * (1.0 - fallen) * s * fallen)

    assert_motion_agrees("shorted_loop", size, (width, 1e9, 0.0), kept, ())


def test_an_accelerometer_on_wax_reads_what_the_wax_bears_until_it_has_caught_up():
    """Sliding found by events: it begins where the limit is passed and ends where the sensor has the bar's speed."""
    limit, pace = 40.0, 60.0
    wrong = [kinds.KINDS["slipping_wax"].at(300.0 / limit - 1.0, (0.0, pace, 0.0))]
    at, fine = fine_record()
    bare = simulate.record(RIG, True, TIMES)
    y = simulate.record(RIG, True, TIMES, wrong)
    theirs, now, slides = bare[0].copy(), 0.0, []
    while True:
        over = np.flatnonzero((at >= now) & (np.abs(fine[0]) > limit))
        if not over.size:
            break
        begin, way = at[over[0]], math.copysign(1.0, fine[0, over[0]])

        def rate(t, v, way=way):
            return [np.interp(t, at, fine[0]) - way * limit - pace * v[0]]

        def caught_up(t, v, way=way, begin=begin):
            return way * v[0] if t > begin + 1e-4 else 1.0

        caught_up.terminal = True
        path = solve_ivp(
            rate, (begin, at[-1]), [0.0], "DOP853", dense_output=True, events=caught_up, max_step=1e-4, rtol=1e-8
        )
        now = path.t[-1]
        during = (begin <= TIMES) & (now > TIMES)
        theirs[during] = way * limit + pace * path.sol(TIMES[during])[0]
        slides.append((begin, now))
    assert len(slides) > 3
    edges = np.min(np.abs(TIMES[:, None] - np.array(slides).ravel()), axis=1) < 5e-5
    assert np.count_nonzero(edges[1:]) < 5
    np.testing.assert_array_equal(y[1], bare[1])
    assert np.abs(y[0] - theirs)[~edges].max() < 0.05
    assert y[0, 0] == -limit
    coarse = simulate.record(
        RIG,
        True,
        TIMES,
        wrong,
        step=simulate.SEARCH_STEP,
    )
    near = np.min(np.abs(TIMES[:, None] - np.array(slides).ravel()), axis=1) < 2.5e-4
    assert np.abs(coarse[0] - theirs)[~near].max() < 0.3


def test_an_overload_moves_the_zero_and_is_forgotten():
    threshold, tau = 15.0, 0.05
    at, fine = fine_record()
    bare = simulate.record(RIG, True, TIMES)
    y = simulate.record(RIG, True, TIMES, [kinds.KINDS["zero_shift"].at(-0.2, (1.0, threshold, tau))])

    def rate(t, z):
        return [max(0.0, abs(np.interp(t, at, fine[1])) - threshold) / 0.02 - z[0] / tau]

    path = solve_ivp(rate, (0.0, TIMES[-1]), [0.0], "DOP853", TIMES, rtol=1e-8, atol=1e-8, max_step=2e-4)
    np.testing.assert_array_equal(y[0], bare[0])
    assert np.abs(y[1] - bare[1]).max() > 2.0
    np.testing.assert_allclose(y[1], bare[1] - 0.2 * path.y[0], atol=1e-3)


def test_a_leaning_axis_shows_gravity_as_the_bars_turn():
    """The sensor's axis, turned with the bar, times the direction of gravity, zeroed at the release angle."""
    heading = 0.5
    bare = simulate.record(RIG, True, TIMES)
    path = simulate.motion(RIG, True, (), TIMES[-1], simulate.FINE_STEP, 50)
    y = simulate.record(RIG, True, TIMES, [kinds.KINDS["leaning_axis"].at(-0.3, (0.0, heading, 0.0))])
    down = 9.81 / 0.1 * np.array([np.sin(heading), np.cos(heading)])
    for c in range(2):
        along = np.array([np.cos(path[:, c]), np.sin(path[:, c])]).T @ down
        assert np.abs(y[c] - bare[c]).max() > 2.0
        np.testing.assert_allclose(y[c], bare[c] - 0.3 * (along - along[0]), atol=1e-6)


def test_a_cable_near_the_magnet_reads_the_rate_of_its_flux():
    """Flux of a loop at phi = 5 mrad, reach 30 mrad, differentiated; nothing without the secondary."""
    at, reach = 0.005, 0.03
    wrong = [kinds.KINDS["field_pickup"].at(4.0, (1.0, at, reach))]
    bare = simulate.record(RIG, True, TIMES)
    path = simulate.motion(RIG, True, (), TIMES[-1] + 1e-3, simulate.FINE_STEP)
    s = (path[:, 0] - path[:, 1] - at) / reach
    voltage = np.gradient(reach * s / np.sqrt(1.0 + s * s), simulate.FINE_STEP)
    y = simulate.record(RIG, True, TIMES, wrong)
    np.testing.assert_array_equal(y[0], bare[0])
    assert np.abs(y[1] - bare[1]).max() > 2.0
    np.testing.assert_allclose(y[1, 1:], bare[1, 1:] + 4.0 * voltage[50 : 50 * TIMES.size : 50], atol=1e-3)
    alone = simulate.record(RIG, False, TIMES)
    np.testing.assert_array_equal(simulate.record(RIG, False, TIMES, wrong), alone)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sign"), [(n, s) for n in (*MOTIONS, *READINGS) for s in kinds.KINDS[n].signs])
@pytest.mark.parametrize("late", [pytest.param(0.0, marks=pytest.mark.prove), 5e-4])
def test_level_one_is_reached(name, sign, late):
    assert_level_one_is_reached(name, sign, late)
