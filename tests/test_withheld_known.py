"""Kinds that were reserved for the third proof and have been known since, each against a second implementation.

Each is written out once more and integrated by an adaptive method, or laid on the nominal record where it is of the
sensors.
"""

import math

import numpy as np
import pytest
from withheld_reference import (
    K1,
    NU,
    RIG,
    TH0,
    TIMES,
    assert_level_one_is_reached,
    assert_motion_agrees,
    kinds,
    opposite,
    simulate,
    step,
)


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
}


@pytest.mark.parametrize("name", list(MOTIONS))
def test_motion_agrees_with_an_adaptive_method(name):
    assert_motion_agrees(name, *MOTIONS[name])


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


@pytest.mark.slow
@pytest.mark.parametrize("name", [*MOTIONS, "clock_jump", "dead_band", "unequal_halves"])
@pytest.mark.parametrize("late", [0.0, 5e-4])
def test_level_one_is_reached(name, late):
    assert_level_one_is_reached(name, kinds.KINDS[name].signs[-1], late)
