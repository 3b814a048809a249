"""Bearing drag that is larger at rest than in motion.

    Q = -f drag S(w) s(nu w) on each inertia,    S = exp(-(w/ws)^2)   or   exp(-|w|/ws)

Source: Armstrong-Helouvry et al. (1994), Automatica 30, 1083; Bo and Pavelescu (1982), Wear 82, 277 (exponential).
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import exp, lane, smooth_sign


@lane
def gaussian(t, th1, th2, w1, w2, z1, z2, p, rig):
    """An excess that falls as a Gaussian of the speed."""
    excess = rig.drag * p[0]
    x1 = w1 / p[1]
    x2 = w2 / p[1]
    return -excess * exp(-x1 * x1) * smooth_sign(rig.nu * w1, rig.tail), -excess * exp(-x2 * x2) * smooth_sign(
        rig.nu * w2, rig.tail
    )


@lane
def exponential(t, th1, th2, w1, w2, z1, z2, p, rig):
    """An excess that falls exponentially with the speed."""
    excess = rig.drag * p[0]
    return (
        -excess * exp(-abs(w1) / p[1]) * smooth_sign(rig.nu * w1, rig.tail),
        -excess * exp(-abs(w2) / p[1]) * smooth_sign(rig.nu * w2, rig.tail),
    )


PARAMETERS = (
    EffectParameter(
        "excess", "1", "Static above kinetic drag, over kinetic drag.", HalfNormal(1.0),
        "Static friction of dry and starved bearings is up to about twice the kinetic one.", 0.0,
    ),
    EffectParameter(
        "speed", "rad/s", "Speed over which the excess is lost.", LogNormal(0.4, 3.0),
        "Between creeping and the largest speed of the motion; known to a factor of three.",
    ),
)  # fmt: skip
STARTS = ((0.5, 0.1), (0.5, 0.3), (0.5, 1.0), (0.5, 2.5), (1.5, 0.3), (0.02, 0.4))

EFFECT = Effect(
    name="bearing_stribeck",
    site="bearings",
    title="drag in the bearings that is larger at low speed",
    summary="The drag of both bearings is larger at low speed than at high speed.",
    looks_like="The last swings die faster than the first ones foretell, in uncoupled trials too.",
    hides_behind=("drag", "nu", "c1t", "c3t"),
    source="Armstrong-Helouvry et al. (1994), Automatica 30, 1083; Bo and Pavelescu (1982), Wear 82, 277.",
    variants=(
        Variant(
            name="gaussian",
            formula="Q = -f drag exp(-(w/ws)^2) s(nu w)",
            parameters=PARAMETERS,
            torque=gaussian,
            couples="bodies",
            starts=STARTS,
        ),
        Variant(
            name="exponential",
            formula="Q = -f drag exp(-|w|/ws) s(nu w)",
            parameters=PARAMETERS,
            torque=exponential,
            couples="bodies",
            starts=STARTS,
        ),
    ),
)
