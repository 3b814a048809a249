"""The springs of the coupling bottom out: beyond a stop angle an extra stiffness acts.

    Q1 = -s k1t (th1 - g)                      for th1 > g,   mirrored for th1 < -g
    Q1 = -s k1t g ((th1 - g) / g)^1.5          where rounded bodies touch (Hertz)

Source: Augustine (2013), pp. 11 and 33 (name only); Shaw and Holmes (1983), J. Sound Vib. 90, 129 (piecewise linear);
Johnson (1985), Contact Mechanics, sec. 4.2 (Hertz: force as the power 3/2 of the approach).
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import exp, lane, log


@lane
def both_sides(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Stops on both sides, as much stiffer as the springs are."""
    return -p[1] * rig.k1t * (max(th1 - p[0], 0.0) + min(th1 + p[0], 0.0)), 0.0


@lane
def same_stop(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Stops on both sides whose stiffness does not depend on which springs are mounted."""
    return -p[1] * (max(th1 - p[0], 0.0) + min(th1 + p[0], 0.0)), 0.0


@lane
def release_side(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A stop on the side that the rig is released from."""
    side = 1.0 if rig.theta0 >= 0.0 else -1.0
    return -p[1] * rig.k1t * side * max(side * th1 - p[0], 0.0), 0.0


@lane
def far_side(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A stop on the side opposite to the release."""
    side = -1.0 if rig.theta0 >= 0.0 else 1.0
    return -p[1] * rig.k1t * side * max(side * th1 - p[0], 0.0), 0.0


@lane
def contact(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Stops on both sides that are rounded bodies: soft where they begin to touch."""
    side = 1.0 if th1 >= 0.0 else -1.0
    return -p[1] * rig.k1t * side * p[0] * exp(1.5 * log(max(abs(th1) / p[0] - 1.0, 0.0))), 0.0


ANGLE = EffectParameter(
    "angle", "rad", "Angle at which the stop begins.", LogNormal(0.06, 2.0),
    "A stop is felt if it lies within the motion, and not if far below it: half of a usual release angle, factor 2.",
)  # fmt: skip
SHARE = EffectParameter(
    "share", "1", "Extra stiffness over k1t.", HalfNormal(3.0),
    "A spring with closed coils is a few times as stiff; a hard metal stop would show as an impact.", 0.0,
)  # fmt: skip
STIFFNESS = EffectParameter(
    "stiffness", "N m/rad", "Extra stiffness beyond the stop.", HalfNormal(24.0),
    "A few times the stiffness of the springs, as for the share.", 0.0,
)  # fmt: skip
STARTS = tuple((angle, share) for angle in (0.03, 0.06, 0.09) for share in (0.1, 1.5))

EFFECT = Effect(
    name="spring_bottoming",
    site="ground1",
    title="stop that stiffens the spring to ground",
    summary="Beyond a stop angle the spring to ground becomes stiffer.",
    looks_like="Sharper and earlier reversals while the angle is large, nothing once the motion is small.",
    hides_behind=("k1t", "theta0"),
    source="Augustine (2013), pp. 11 and 33; Shaw and Holmes (1983), J. Sound Vib. 90, 129; Johnson (1985), ch. 4.",
    variants=(
        Variant(
            name="both_sides",
            formula="Q1 = -s k1t (max(th1 - g, 0) + min(th1 + g, 0))",
            parameters=(ANGLE, SHARE),
            torque=both_sides,
            couples="bodies",
            starts=STARTS,
        ),
        Variant(
            name="same_stop",
            formula="Q1 = -ks (max(th1 - g, 0) + min(th1 + g, 0))",
            parameters=(ANGLE, STIFFNESS),
            torque=same_stop,
            couples="bodies",
            starts=tuple((angle, 8.0 * share) for angle, share in STARTS),
        ),
        Variant(
            name="release_side",
            formula="Q1 = -s k1t max(th1 - g, 0)",
            parameters=(ANGLE, SHARE),
            torque=release_side,
            couples="bodies",
            starts=STARTS,
        ),
        Variant(
            name="contact",
            formula="Q1 = -s k1t g sgn(th1) max(|th1| / g - 1, 0)^1.5",
            parameters=(ANGLE, SHARE),
            torque=contact,
            couples="bodies",
            starts=STARTS,
        ),
        Variant(
            name="far_side",
            formula="Q1 = -s k1t min(th1 + g, 0)",
            parameters=(ANGLE, SHARE),
            torque=far_side,
            couples="bodies",
            starts=STARTS,
        ),
    ),
)
