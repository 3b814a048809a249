"""A restoring torque of the magnet that is not in proportion to the relative angle.

    T += b phi^3,    k2t a phi^3    or    k2t phi (exp(-(q phi)^2) - 1)

Source: Furlani (2001), Permanent Magnet and Electromechanical Devices, sec. 4.7 (coupled poles).
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, Normal
from bayes_damper.rig.vector_math import exp, lane


@lane
def cubic(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A cubic torque, whatever k2t is."""
    phi = th1 - th2
    q = p[0] * phi * phi * phi
    return -q, q


@lane
def share(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A cubic torque in proportion to k2t."""
    phi = th1 - th2
    q = rig.k2t * p[0] * phi * phi * phi
    return -q, q


@lane
def fading(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A torque that vanishes once the poles are apart."""
    phi = th1 - th2
    x = p[0] * phi
    q = rig.k2t * phi * (exp(-x * x) - 1.0)
    return -q, q


EFFECT = Effect(
    name="magnet_cubic",
    site="interface",
    title="magnet whose restoring torque is not linear",
    summary="The restoring torque of the magnet is not in proportion to the relative angle.",
    looks_like="A slow swing of both bodies against each other whose period depends on its amplitude.",
    hides_behind=("k2t", "mu"),
    source="Furlani (2001), Permanent Magnet and Electromechanical Devices, sec. 4.7.",
    needs=("coupled", "magnet"),
    variants=(
        Variant(
            name="cubic",
            formula="T = ... + b phi^3",
            parameters=(
                EffectParameter(
                    "cubic", "N m/rad^3", "Cubic stiffness between the bodies.", Normal(0.0, 60.0),
                    "At 0.15 rad as much as a k2t of 1 to 2 N m/rad gives, of either sign.", 0.0,
                ),
            ),
            torque=cubic,
            couples="interface",
            starts=((30.0,), (-30.0,), (2.0,)),
        ),
        Variant(
            name="share",
            formula="T = ... + k2t a phi^3",
            parameters=(
                EffectParameter(
                    "cubic", "1/rad^2", "Cubic stiffness between the bodies over k2t.", Normal(0.0, 40.0),
                    "At 0.15 rad a change of the torque by all of it is about one standard deviation.", 0.0,
                ),
            ),
            torque=share,
            couples="interface",
            starts=((20.0,), (-15.0,), (1.0,)),
        ),
        Variant(
            name="fading",
            formula="T = ... + k2t phi (exp(-(q phi)^2) - 1)",
            parameters=(
                EffectParameter(
                    "narrowness", "1/rad", "Inverse of the relative angle at which it has faded.", HalfNormal(6.0),
                    "Faces of 25 mm at a radius of 0.1 m part at 0.25 rad, so the torque fades near that.", 0.0,
                ),
            ),
            torque=fading,
            couples="interface",
            starts=((1.0,), (4.0,), (8.0,)),
        ),
    ),
)  # fmt: skip
