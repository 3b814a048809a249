"""A coefficient of friction that depends on the relative angle of the bars.

    mu -> mu (1 + a |phi|)    or    mu (1 + b phi^2),    never below zero

Source: Augustine (2013), p. 22 (named, not modelled).
"""

from __future__ import annotations

from bayes_damper.effects._shapes import friction
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.vector_math import lane


@lane
def linear(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A change in proportion to the relative angle."""
    phi = th1 - th2
    q = friction(phi, w1 - w2, rig) * max(p[0] * abs(phi), -1.0)
    return -q, q


@lane
def quadratic(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A change in proportion to the square of the relative angle."""
    phi = th1 - th2
    q = friction(phi, w1 - w2, rig) * max(p[0] * phi * phi, -1.0)
    return -q, q


EFFECT = Effect(
    name="friction_displacement",
    site="interface",
    title="friction that depends on the relative angle",
    summary="The coefficient of friction depends on how far the bars are turned against each other.",
    looks_like="Jumps at reversals of sliding whose height varies with the relative angle, but not as the overlap.",
    hides_behind=("mu", "R", "r"),
    source="Augustine (2013), p. 22.",
    needs=("coupled", "magnet"),
    alike=frozenset({"normal_force_law"}),
    variants=(
        Variant(
            name="linear",
            formula="mu (1 + a |phi|)",
            parameters=(
                EffectParameter(
                    "slope", "1/rad", "Relative change of mu per relative angle.", Normal(2.0, 5.0),
                    "At the largest relative angles, 0.1 to 0.2 rad, mu may double; wear at the middle makes growth "
                    "the likelier sign.", 0.0,
                ),
            ),
            torque=linear,
            couples="interface",
            starts=((3.0,), (-2.0,), (0.2,), (8.0,)),
        ),
        Variant(
            name="quadratic",
            formula="mu (1 + b phi^2)",
            parameters=(
                EffectParameter(
                    "curvature", "1/rad^2", "Relative change of mu per squared relative angle.", Normal(15.0, 40.0),
                    "The same range as for the linear law at 0.15 rad.", 0.0,
                ),
            ),
            torque=quadratic,
            couples="interface",
            starts=((30.0,), (-15.0,), (1.0,)),
        ),
    ),
)  # fmt: skip
