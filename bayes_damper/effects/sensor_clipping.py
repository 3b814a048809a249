"""The range of a channel ends.

    m = clamp(y, -L, L)    or, rounded,    m = y / (1 + (y/L)^8)^(1/8)

Source: Wilson (2005), Sensor Technology Handbook, ch. 4.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import LogUniform
from bayes_damper.rig.vector_math import exp, lane, log


@lane
def rounded(y, level):
    """A reading that approaches the level gradually."""
    x = y / level
    square = x * x
    fourth = square * square
    return y * exp(-0.125 * log(1.0 + fourth * fourth))


@lane
def both(h, u1, u2, y1, y2, s1, s2, p, first):
    """Both channels end sharply at the same level."""
    return min(max(y1, -p[0]), p[0]), min(max(y2, -p[0]), p[0]), s1, s2


@lane
def both_rounded(h, u1, u2, y1, y2, s1, s2, p, first):
    """Both channels saturate at the same level."""
    return rounded(y1, p[0]), rounded(y2, p[0]), s1, s2


@lane
def channel1(h, u1, u2, y1, y2, s1, s2, p, first):
    """The primary's channel ends sharply."""
    return min(max(y1, -p[0]), p[0]), y2, s1, s2


@lane
def channel2(h, u1, u2, y1, y2, s1, s2, p, first):
    """The secondary's channel ends sharply."""
    return y1, min(max(y2, -p[0]), p[0]), s1, s2


PARAMETERS = (
    EffectParameter(
        "level", "reading", "Largest reading that the channel can show.", LogUniform(2.0, 20000.0),
        "Any level from a hundredth of usual peaks to a hundred times them; beyond the peaks it does nothing.", 20000.0,
    ),
)  # fmt: skip
STARTS = ((240.0,), (200.0,), (160.0,), (110.0,), (70.0,), (30.0,))

EFFECT = Effect(
    name="sensor_clipping",
    site="sensor",
    title="sensor range that ends too early",
    summary="The range of the channels ends below the largest readings.",
    looks_like="Flat tops at one level in the first swings of the strongest trials.",
    hides_behind=("theta0", "mu"),
    source="Wilson (2005), Sensor Technology Handbook, ch. 4.",
    variants=(
        Variant(name="both", formula="m = clamp(y, -L, L)", parameters=PARAMETERS, sense=both, starts=STARTS),
        Variant(
            name="both_rounded",
            formula="m = y/(1 + (y/L)^8)^(1/8)",
            parameters=PARAMETERS,
            sense=both_rounded,
            starts=STARTS,
        ),
        Variant(name="channel1", formula="m1 = clamp(y1, -L, L)", parameters=PARAMETERS, sense=channel1, starts=STARTS),
        Variant(
            name="channel2",
            formula="m2 = clamp(y2, -L, L)",
            parameters=PARAMETERS,
            sense=channel2,
            starts=((120.0,), (80.0,), (50.0,), (30.0,)),
            uncoupled=False,
        ),
    ),
)
