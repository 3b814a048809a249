"""Dry drag in both bearings, for a nominal model without dry friction.

    Q = -d tanh(n w) on each inertia

Source: Augustine (2013), eq. 19, p. 23.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane, tanh


@lane
def dry(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Coulomb drag, smoothed."""
    return -p[0] * tanh(p[1] * w1), -p[0] * tanh(p[1] * w2)


EFFECT = Effect(
    name="bearing_drag",
    site="bearings",
    title="dry drag in the bearings",
    summary="The bearings have dry drag.",
    looks_like="The decay is nearly a straight line and ends abruptly, in uncoupled trials too.",
    hides_behind=("c1t", "c3t"),
    source="Augustine (2013), eq. 19, p. 23.",
    needs=("linear_nominal",),
    variants=(
        Variant(
            name="dry",
            formula="Q = -d tanh(n w)",
            parameters=(
                EffectParameter(
                    "drag", "N m", "Drag torque of each bearing.", HalfNormal(0.05),
                    "A few per cent of the spring torque at release, or the rig would hardly swing.", 0.0,
                ),
                EffectParameter(
                    "smoothing", "s/rad", "Smoothing constant of the reversal.", LogNormal(60.0, 3.0),
                    "Reversal within a hundredth of the largest speed, known to a factor of three.",
                ),
            ),
            torque=dry,
            couples="bodies",
            starts=((0.001, 60.0), (0.02, 20.0), (0.02, 100.0), (0.06, 60.0)),
        ),
    ),
)  # fmt: skip
