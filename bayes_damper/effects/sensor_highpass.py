"""AC coupling: the channels lose slow content.

    m = y - s,    ds/dt = rate (y - s),    s = 0 at release

Source: Doebelin (2004), Measurement Systems, sec. 3.3; piezoelectric accelerometers as in Augustine (2013), p. 10.
"""

from __future__ import annotations

from bayes_damper.effects._filters import low_pass
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
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
