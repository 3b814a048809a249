"""The sensors follow the motion with a lag: a low-pass in the channels.

    tau dm/dt = y - m                                  in both channels, in one, or in both with a lag of T
    tau^2 d2m/dt2 + 2 zeta tau dm/dt = y - m           in both channels: two poles
    the same of r with tau dr/dt = y - r               in both channels: three poles

Source: Doebelin (2004), Measurement Systems, sec. 3.3 (instruments of first and second order).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_damper.effects._filters import follow, follow2, follow3, low_pass
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane


@lane
def both(h, u1, u2, y1, y2, s1, s2, p, first):
    """The same low-pass in both channels."""
    m1 = follow(h, u1, y1, s1, p[0], first)
    m2 = follow(h, u2, y2, s2, p[0], first)
    return m1, m2, m1, m2


@lane
def both_settled(h, u1, u2, y1, y2, s1, s2, p, first):
    """The same low-pass in both channels, started at the first reading after the release."""
    m1 = y1 if first > 0.5 else low_pass(h, u1, y1, s1, p[0])
    m2 = y2 if first > 0.5 else low_pass(h, u2, y2, s2, p[0])
    return m1, m2, m1, m2


@lane
def two_poles(h, u1, u2, y1, y2, s1, s2, v1, v2, p, first):
    """The same low-pass of second order in both channels."""
    m1, n1 = follow2(h, u1, y1, s1, v1, p[0], p[1], first)
    m2, n2 = follow2(h, u2, y2, s2, v2, p[0], p[1], first)
    return m1, m2, m1, m2, n1, n2


@lane
def three_poles(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, p, first):
    """The same low-pass of third order in both channels."""
    m1, n1, r1 = follow3(h, u1, y1, s1, v1, r1, p[0], p[1], first)
    m2, n2, r2 = follow3(h, u2, y2, s2, v2, r2, p[0], p[1], first)
    return m1, m2, m1, m2, n1, n2, r1, r2


@lane
def channel1(h, u1, u2, y1, y2, s1, s2, p, first):
    """A low-pass in the primary's channel."""
    m1 = follow(h, u1, y1, s1, p[0], first)
    return m1, y2, m1, s2


@lane
def channel2(h, u1, u2, y1, y2, s1, s2, p, first):
    """A low-pass in the secondary's channel."""
    m2 = follow(h, u2, y2, s2, p[0], first)
    return y1, m2, s1, m2


def lag(p: Mapping[str, Any]) -> tuple[Any, Any]:
    """The part of a filter's delay that the first order leaves out, in both channels."""
    return p["lag"], p["lag"]


TIME = EffectParameter(
    "time", "s", "Time constant of the filter.", HalfNormal(0.003),
    "Corner frequencies of conditioners lie from some 50 Hz up, time constants from 3 ms down.", 0.0,
)  # fmt: skip
DAMPING = EffectParameter(
    "damping", "1", "Damping ratio of the filter.", LogNormal(0.8, 1.35),
    "Filters of data loggers of second (third) order: Butterworth 0.71 (0.5), Bessel 0.87 (0.72), equal stages 1.",
)  # fmt: skip
STARTS = ((0.00005,), (0.0005,), (0.002,), (0.005,))

EFFECT = Effect(
    name="sensor_bandwidth",
    site="sensor",
    title="sensors that are too slow",
    summary="The sensors are too slow to follow quick changes of the motion.",
    looks_like="Jumps and the first peak are rounded and late, slow content is right.",
    hides_behind=("nu", "delay"),
    source="Doebelin (2004), Measurement Systems, sec. 3.3.",
    variants=(
        Variant(
            name="both",
            formula="tau dm/dt = y - m in both channels, from the reading at rest",
            parameters=(TIME,),
            sense=both,
            late=1.0,
            starts=STARTS,
        ),
        Variant(
            name="both_settled",
            formula="tau dm/dt = y - m in both channels, from the first reading",
            parameters=(TIME,),
            sense=both_settled,
            starts=STARTS,
        ),
        Variant(
            name="lagged",
            formula="tau dm/dt = y(t - T) - m in both channels, from the reading at rest",
            parameters=(
                TIME,
                EffectParameter(
                    "lag", "s", "Lag in addition to that of the first order.", HalfNormal(0.001),
                    "Filters of higher order lag by about another time constant.", 0.0,
                ),
            ),
            sense=both,
            lag=lag,
            late=1.0,
            starts=((0.00005, 0.00005), (0.0005, 0.0003), (0.001, 0.001), (0.003, 0.001)),
        ),
        Variant(
            name="two_poles",
            formula="tau^2 d2m/dt2 + 2 zeta tau dm/dt = y - m in both channels, from the reading at rest",
            parameters=(TIME, DAMPING),
            sense=two_poles,
            sensor_states=2,
            late=1.6,
            starts=tuple((time, zeta) for zeta in (0.6, 1.0) for (time,) in STARTS),
        ),
        Variant(
            name="three_poles",
            formula="tau^2 d2m/dt2 + 2 zeta tau dm/dt = r - m, tau dr/dt = y - r in both channels, from rest",
            parameters=(TIME, DAMPING),
            sense=three_poles,
            sensor_states=3,
            late=2.5,
            starts=tuple((time, zeta) for zeta in (0.5, 0.75) for (time,) in STARTS),
        ),
        Variant(
            name="channel1",
            formula="tau dm1/dt = y1 - m1",
            parameters=(TIME,),
            sense=channel1,
            starts=STARTS,
        ),
        Variant(
            name="channel2",
            formula="tau dm2/dt = y2 - m2",
            parameters=(TIME,),
            sense=channel2,
            starts=STARTS,
            uncoupled=False,
        ),
    ),
)  # fmt: skip
