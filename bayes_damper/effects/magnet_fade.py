"""A magnet whose pull falls with the heat that the interface has dissipated.

    N -> N max(0, 1 - a E)   or   N exp(-a E),    dE/dt = friction power;    or all of T falls so, with all its losses

Memory: a E. Source: Augustine (2013), p. 35 (named, not modelled); Furlani (2001), ch. 1 (loss with temperature).
"""

from __future__ import annotations

from bayes_damper.effects._shapes import friction
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.vector_math import exp, lane


@lane
def linear(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Pull that falls linearly with the heat."""
    q = -friction(th1 - th2, w1 - w2, rig) * min(z1, 1.0)
    return -q, q


@lane
def linear_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction power times the loss that it causes."""
    return p[0] * friction(th1 - th2, w1 - w2, rig) * (w1 - w2) * max(1.0 - z1, 0.0), 0.0


@lane
def exponential(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Pull that falls exponentially with the heat."""
    q = friction(th1 - th2, w1 - w2, rig) * (exp(-z1) - 1.0)
    return -q, q


@lane
def exponential_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction power times the loss that it causes."""
    return p[0] * friction(th1 - th2, w1 - w2, rig) * (w1 - w2) * exp(-z1), 0.0


@lane
def whole(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction, stiffness and damping of the interface fall together."""
    slip = w1 - w2
    nominal = friction(th1 - th2, slip, rig) + rig.k2t * (th1 - th2) + rig.c2t * slip
    q = nominal * (exp(-z1) - 1.0)
    return -q, q


@lane
def whole_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Power lost in friction and damping times the loss of pull that it causes."""
    slip = w1 - w2
    return p[0] * (friction(th1 - th2, slip, rig) + rig.c2t * slip) * slip * exp(-z1), 0.0


PARAMETERS = (
    EffectParameter(
        "loss", "1/(N m rad)", "Relative loss of pull per heat dissipated.", HalfNormal(20.0),
        "A trial dissipates some 30 mJ: at one standard deviation the pull halves within it; heat of the whole bulk "
        "would do far less, that of a thin face more.", 0.0,
    ),
)  # fmt: skip
STARTS = ((0.5,), (5.0,), (20.0,))

EFFECT = Effect(
    name="magnet_fade",
    site="interface",
    title="magnet that loses pull as it heats",
    summary="The pull of the magnet falls with the heat that the interface dissipates.",
    looks_like="Friction between the bodies that is strong in the first swings and weak in the last.",
    hides_behind=("mu", "c2t"),
    source="Augustine (2013), p. 35; Furlani (2001), Permanent Magnet and Electromechanical Devices, ch. 1.",
    needs=("coupled", "magnet"),
    variants=(
        Variant(
            name="linear",
            formula="N max(0, 1 - a E), dE/dt = friction power",
            parameters=PARAMETERS,
            torque=linear,
            couples="interface",
            rate=linear_rate,
            memory=1,
            memory_scale=(0.3,),
            starts=STARTS,
            wears=True,
        ),
        Variant(
            name="exponential",
            formula="N exp(-a E), dE/dt = friction power",
            parameters=PARAMETERS,
            torque=exponential,
            couples="interface",
            rate=exponential_rate,
            memory=1,
            memory_scale=(0.3,),
            starts=STARTS,
            wears=True,
        ),
        Variant(
            name="whole",
            formula="T exp(-a E), dE/dt = power lost in T",
            parameters=PARAMETERS,
            torque=whole,
            couples="interface",
            rate=whole_rate,
            memory=1,
            memory_scale=(0.3,),
            starts=STARTS,
            wears=True,
        ),
    ),
)
