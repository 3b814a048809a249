"""The spring of the coupling hardens or softens with its angle.

    Q1 = -k3 th1^3    or    Q1 = -k1t a th1^3

Source: Kovacic and Brennan (2011), The Duffing Equation, ch. 2; springs named as variable in Augustine (2013), p. 33.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.vector_math import lane


@lane
def same_for_all(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A cubic torque that does not depend on which springs are mounted."""
    return -p[0] * th1 * th1 * th1, 0.0


@lane
def share_of_spring(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A cubic torque that grows with the stiffness of the springs mounted."""
    return -rig.k1t * p[0] * th1 * th1 * th1, 0.0


EFFECT = Effect(
    name="spring_cubic",
    site="ground1",
    title="spring to ground that hardens or softens",
    summary="The torque of the spring to ground grows faster or slower than its angle.",
    looks_like="The period changes while the motion decays, and the first peak is too high or too low for it.",
    hides_behind=("k1t", "theta0"),
    source="Kovacic and Brennan (2011), The Duffing Equation, ch. 2; Augustine (2013), p. 33.",
    variants=(
        Variant(
            name="same_for_all",
            formula="Q1 = -k3 th1^3",
            parameters=(
                EffectParameter(
                    "k3", "N m/rad^3", "Cubic stiffness, positive when hardening.", Normal(0.0, 160.0),
                    "At 0.1 rad a change by 20 % of the spring torque is one standard deviation, of either sign.", 0.0,
                ),
            ),
            torque=same_for_all,
            couples="bodies",
            starts=((40.0,), (-40.0,), (2.0,)),
        ),
        Variant(
            name="share_of_spring",
            formula="Q1 = -k1t a th1^3",
            parameters=(
                EffectParameter(
                    "a", "1/rad^2", "Cubic stiffness over k1t, positive when hardening.", Normal(0.0, 20.0),
                    "At 0.1 rad a change of the torque by 20 % is one standard deviation, of either sign.", 0.0,
                ),
            ),
            torque=share_of_spring,
            couples="bodies",
            starts=((5.0,), (-5.0,), (0.25,)),
        ),
    ),
)  # fmt: skip
