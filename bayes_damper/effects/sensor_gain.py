"""The gain of one channel is off.

    m = (1 + e) y    on channel 1 or on channel 2

Source: Augustine (2013), p. 10 (accelerometers PCB 288D01; such sensors are calibrated to some per cent).
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.vector_math import lane


@lane
def channel1(h, u1, u2, y1, y2, s1, s2, p, first):
    """The primary's channel."""
    return (1.0 + p[0]) * y1, y2, s1, s2


@lane
def channel2(h, u1, u2, y1, y2, s1, s2, p, first):
    """The secondary's channel."""
    return y1, (1.0 + p[0]) * y2, s1, s2


PARAMETERS = (
    EffectParameter(
        "error", "1", "Relative error of the gain.", Normal(0.0, 0.05, -0.9, 2.0),
        "Sensitivities, mounting radii and tilt add up to some per cent.", 0.0,
    ),
)  # fmt: skip

EFFECT = Effect(
    name="sensor_gain",
    site="sensor",
    title="wrong scale of one channel",
    summary="One channel reads too much or too little by a constant factor.",
    looks_like="One channel is off by a factor at all times; the other one fits.",
    hides_behind=("theta0", "J2", "mu"),
    source="Augustine (2013), p. 10; Wilson (2005), Sensor Technology Handbook, ch. 5.",
    exact=True,
    variants=(
        Variant(
            name="channel1",
            formula="m1 = (1 + e) y1",
            parameters=PARAMETERS,
            sense=channel1,
            starts=((0.05,), (-0.05,), (0.002,)),
        ),
        Variant(
            name="channel2",
            formula="m2 = (1 + e) y2",
            parameters=PARAMETERS,
            sense=channel2,
            starts=((0.05,), (-0.05,), (0.002,)),
            uncoupled=False,
        ),
    ),
)
