"""AC coupling: the channels lose slow content.

    m = y - s,    ds/dt = rate (y - s),    s = 0 at release                               in both channels, or in one
    d2m/dt2 + 2 zeta rate dm/dt + rate^2 m = d2y/dt2,    m = y at release                 in both channels: two poles

Source: Doebelin (2004), Measurement Systems, sec. 3.3; piezoelectric accelerometers as in Augustine (2013), p. 10.
Geophones, whose mass stands still above their own frequency, are of second order (Havskov and Alguacil 2016,
Instrumentation in Earthquake Seismology, ch. 2), and so are two AC couplings in a row.
"""

from __future__ import annotations

from bayes_damper.effects._filters import low_pass, low_pass2
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane


@lane
def slow(h, u, y, s, rate):
    """Slow part of a reading at the end of a step h (s); rate = 1/tau."""
    return low_pass(h * rate, u, y, s, 1.0)


@lane
def both(h, u1, u2, y1, y2, s1, s2, p, first):
    """AC coupling of both channels."""
    s1 = slow(h, u1, y1, s1, p[0])
    s2 = slow(h, u2, y2, s2, p[0])
    return y1 - s1, y2 - s2, s1, s2


@lane
def fast2(h, u, y, s, v, rate, zeta):
    """Reading without its slow part, and the two states of that, at the end of a step h (s); rate = 1/tau."""
    s, v = low_pass2(h * rate, u, y, s, v, 1.0, zeta)
    return y - s - 2.0 * zeta * v, s, v


@lane
def two_poles(h, u1, u2, y1, y2, s1, s2, v1, v2, p, first):
    """The same high-pass of second order in both channels."""
    m1, s1, v1 = fast2(h, u1, y1, s1, v1, p[0], p[1])
    m2, s2, v2 = fast2(h, u2, y2, s2, v2, p[0], p[1])
    return m1, m2, s1, s2, v1, v2


@lane
def channel1(h, u1, u2, y1, y2, s1, s2, p, first):
    """AC coupling of the primary's channel."""
    s1 = slow(h, u1, y1, s1, p[0])
    return y1 - s1, y2, s1, s2


@lane
def channel2(h, u1, u2, y1, y2, s1, s2, p, first):
    """AC coupling of the secondary's channel."""
    s2 = slow(h, u2, y2, s2, p[0])
    return y1, y2 - s2, s1, s2


PARAMETERS = (
    EffectParameter(
        "rate", "1/s", "Inverse of the time constant: 2 pi times the corner frequency.", HalfNormal(8.0),
        "Piezoelectric sensors and AC inputs have corners from far below 1 Hz to some Hz.", 0.0,
    ),
)  # fmt: skip
STARTS = ((0.1,), (1.0,), (4.0,), (12.0,))

EFFECT = Effect(
    name="sensor_highpass",
    site="sensor",
    title="channels that lose slow content",
    summary="The channels are AC coupled and lose slow content.",
    looks_like="After a strong first swing the record dips below its middle line and creeps back; phases lead.",
    hides_behind=("c1t", "delay"),
    source="Doebelin (2004), Measurement Systems, sec. 3.3.",
    variants=(
        Variant(
            name="both", formula="m = y - s, ds/dt = rate (y - s)", parameters=PARAMETERS, sense=both, starts=STARTS
        ),
        Variant(
            name="two_poles",
            formula="d2m/dt2 + 2 zeta rate dm/dt + rate^2 m = d2y/dt2 in both channels, m = y at release",
            parameters=(
                EffectParameter(
                    "rate",
                    "1/s",
                    "Angular frequency of the corner.",
                    HalfNormal(30.0),
                    "Geophones have corners of 1 to 15 Hz, two AC couplings in a row lower ones.",
                    0.0,
                ),
                EffectParameter(
                    "damping",
                    "1",
                    "Damping ratio of the filter.",
                    LogNormal(0.8, 1.35),
                    "Geophones with their damping resistor 0.6 to 0.7, Butterworth 0.71, two equal AC couplings 1.",
                ),
            ),
            sense=two_poles,
            sensor_states=2,
            starts=tuple((rate, zeta) for zeta in (0.7, 1.0) for rate in (0.1, 1.0, 4.0, 12.0, 40.0)),
        ),
        Variant(
            name="channel1",
            formula="m1 = y1 - s, ds/dt = rate (y1 - s)",
            parameters=PARAMETERS,
            sense=channel1,
            starts=STARTS,
        ),
        Variant(
            name="channel2",
            formula="m2 = y2 - s, ds/dt = rate (y2 - s)",
            parameters=PARAMETERS,
            sense=channel2,
            starts=STARTS,
            uncoupled=False,
        ),
    ),
)
