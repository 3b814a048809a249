"""Drag that grows with the square of the speed, as that of bars in air.

    Q = -b J w |w| on each inertia, with J1 for both or with each one's own inertia, or on one of them alone

Source: Batchelor (1967), An Introduction to Fluid Dynamics, sec. 5.11; Nelson and Olsson (1986), Am. J. Phys. 54, 112.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.vector_math import lane


@lane
def alike(t, th1, th2, w1, w2, z1, z2, p, rig):
    """The same coefficient on both bars."""
    return -p[0] * rig.J1 * w1 * abs(w1), -p[0] * rig.J1 * w2 * abs(w2)


@lane
def by_inertia(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A coefficient in proportion to each bar's inertia."""
    return -p[0] * rig.J1 * w1 * abs(w1), -p[0] * rig.J2 * w2 * abs(w2)


@lane
def first(t, th1, th2, w1, w2, z1, z2, p, rig):
    """On the primary alone, as where it bears a plate or a sail."""
    return -p[0] * rig.J1 * w1 * abs(w1), 0.0


@lane
def second(t, th1, th2, w1, w2, z1, z2, p, rig):
    """On the secondary alone."""
    return 0.0, -p[0] * rig.J2 * w2 * abs(w2)


PARAMETERS = (
    EffectParameter(
        "coefficient", "1/rad", "Torque over inertia and squared speed.", HalfNormal(0.6),
        "At 0.6 a swing of 0.1 rad loses about 8 % of its amplitude to it in half a turn, as much as to all measured "
        "damping; free bars in air have less.", 0.0,
    ),
)  # fmt: skip

EFFECT = Effect(
    name="quadratic_drag",
    site="bearings",
    title="drag that grows with the square of the speed",
    summary="The inertias, or one of them, feel a drag that grows with the square of their speed.",
    looks_like="Large swings decay faster than small ones, most in the cases with the largest release angle.",
    hides_behind=("c1t", "c3t", "drag"),
    source="Nelson and Olsson (1986), Am. J. Phys. 54, 112.",
    variants=(
        Variant(
            name="alike",
            formula="Q1 = -b J1 w1 |w1|, Q2 = -b J1 w2 |w2|",
            parameters=PARAMETERS,
            torque=alike,
            couples="bodies",
            in_air=True,
            starts=((0.02,), (0.2,), (0.8,)),
        ),
        Variant(
            name="by_inertia",
            formula="Q1 = -b J1 w1 |w1|, Q2 = -b J2 w2 |w2|",
            parameters=PARAMETERS,
            torque=by_inertia,
            couples="bodies",
            in_air=True,
            starts=((0.02,), (0.2,), (0.8,)),
        ),
        Variant(
            name="first",
            formula="Q1 = -b J1 w1 |w1|",
            parameters=PARAMETERS,
            torque=first,
            couples="bodies",
            needs=("coupled",),
            in_air=True,
            starts=((0.02,), (0.2,), (0.8,)),
        ),
        Variant(
            name="second",
            formula="Q2 = -b J2 w2 |w2|",
            parameters=PARAMETERS,
            torque=second,
            couples="bodies",
            uncoupled=False,
            in_air=True,
            starts=((0.02,), (0.2,), (0.8,)),
        ),
    ),
)
