"""Dry friction between the faces, for a nominal model without dry friction there.

    T += F (N/N0) tanh(n v)    or    F tanh(n v),    v = w1 - w2

Source: Augustine (2013), eqs. 18 and 20, pp. 23-24.
"""

from __future__ import annotations

from bayes_damper.effects._shapes import overlap
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane, tanh


@lane
def with_overlap(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction under a pull that is linear in the overlap."""
    q = p[0] * overlap(th1 - th2, rig) * tanh(p[1] * (w1 - w2))
    return -q, q


@lane
def constant(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction under a constant pull."""
    q = p[0] * tanh(p[1] * (w1 - w2))
    return -q, q


PARAMETERS = (
    EffectParameter(
        "torque", "N m", "Friction torque at full overlap.", HalfNormal(0.15),
        "The thesis's mu = 0.009 at 100 N and 0.1 m is 0.09 N m.", 0.0,
    ),
    EffectParameter(
        "smoothing", "s/rad", "Smoothing constant of the reversal.", LogNormal(60.0, 3.0),
        "Reversal within a hundredth of the largest speed, known to a factor of three.",
    ),
)  # fmt: skip
STARTS = ((0.003, 60.0), (0.05, 20.0), (0.05, 100.0), (0.15, 60.0))

EFFECT = Effect(
    name="interface_friction",
    site="interface",
    title="dry friction between the bodies",
    summary="There is dry friction between the faces.",
    looks_like="Both accelerations jump against each other at each reversal of sliding, in coupled trials only.",
    hides_behind=("c2t", "k2t"),
    source="Augustine (2013), eqs. 18 and 20, pp. 23-24.",
    needs=("coupled", "no_rubbing"),
    variants=(
        Variant(
            name="with_overlap",
            formula="T = ... + F (N/N0) tanh(n v)",
            parameters=PARAMETERS,
            torque=with_overlap,
            couples="interface",
            needs=("magnet",),
            starts=STARTS,
        ),
        Variant(
            name="constant",
            formula="T = ... + F tanh(n v)",
            parameters=PARAMETERS,
            torque=constant,
            couples="interface",
            starts=STARTS,
        ),
    ),
)
