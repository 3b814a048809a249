"""Play between the halves of the coupling: near the middle the spring carries less torque, or none.

    Q1 = s k1t clamp(th1, -g, g)

Source: Nordin and Gutman (2002), Automatica 38, 1633 (dead zone); Lovejoy coupling of Augustine (2013), pp. 7 and 33.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane, tanh


@lane
def dead_zone(t, th1, th2, w1, w2, z1, z2, p, rig):
    """No spring torque within the play."""
    return rig.k1t * min(max(th1, -p[0]), p[0]), 0.0


@lane
def rounded(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A play whose flanks take up the load gradually."""
    return rig.k1t * p[0] * tanh(th1 / max(p[0], 1e-9)), 0.0


@lane
def partial(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Some of the springs keep contact within the play."""
    return p[1] * rig.k1t * min(max(th1, -p[0]), p[0]), 0.0


PLAY = EffectParameter(
    "play", "rad", "Half the width of the dead zone.", HalfNormal(0.006),
    "Jaw couplings of this size have up to some tenths of a degree of play.", 0.0,
)  # fmt: skip

EFFECT = Effect(
    name="coupling_backlash",
    site="ground1",
    needs=("spring",),
    title="play in the spring to ground",
    summary="The spring to ground has play: about its middle position it carries no torque.",
    looks_like="The period grows as the motion decays, and the acceleration has a flat step at each zero crossing.",
    hides_behind=("k1t", "drag"),
    source="Nordin and Gutman (2002), Automatica 38, 1633; Augustine (2013), pp. 7 and 33.",
    variants=(
        Variant(
            name="dead_zone",
            formula="Q1 = k1t clamp(th1, -g, g)",
            parameters=(PLAY,),
            torque=dead_zone,
            couples="bodies",
            starts=((0.0005,), (0.002,), (0.006,)),
        ),
        Variant(
            name="rounded",
            formula="Q1 = k1t g tanh(th1/g)",
            parameters=(PLAY,),
            torque=rounded,
            couples="bodies",
            starts=((0.0005,), (0.002,), (0.006,)),
        ),
        Variant(
            name="partial",
            formula="Q1 = s k1t clamp(th1, -g, g)",
            parameters=(
                EffectParameter(
                    "play", "rad", "Half the width in which part of the springs is loose.", LogNormal(0.01, 3.0),
                    "Springs settle and loosen over a fraction of the working angle, known to a factor of three.",
                ),
                EffectParameter(
                    "share", "1", "Share of the stiffness that is lost within the play.", HalfNormal(0.3),
                    "One of several springs out of contact takes about a third of the stiffness away.", 0.0,
                ),
            ),
            torque=partial,
            couples="bodies",
            starts=((0.005, 0.05), (0.01, 0.3), (0.03, 0.1)),
        ),
    ),
)  # fmt: skip
