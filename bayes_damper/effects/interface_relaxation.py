"""A viscoelastic arm across the interface: spring and dashpot in series (Maxwell).

    T += k z,    dz/dt = (w1 - w2) - z / tau;    with a second arm of ten times the time for a broad spectrum

Memory: k z / k1t, in rad, so that it vanishes with the effect.

Source: Findley, Lai and Onaran (1976), Creep and Relaxation of Nonlinear Viscoelastic Materials, sec. 5.3.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import lane


@lane
def one_arm(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Torque of one arm."""
    q = rig.k1t * z1
    return -q, q


@lane
def one_arm_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rate of the arm's torque, over k1t."""
    return (w1 - w2) * p[0] / rig.k1t - z1 / p[1], 0.0


@lane
def two_arms(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Torque of two arms of half the stiffness each."""
    q = rig.k1t * (z1 + z2)
    return -q, q


@lane
def two_arms_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rates of the arms' torques, over k1t."""
    stretched = 0.5 * (w1 - w2) * p[0] / rig.k1t
    return stretched - z1 / p[1], stretched - 0.1 * z2 / p[1]


PARAMETERS = (
    EffectParameter(
        "stiffness", "N m/rad", "Stiffness of the arm.", HalfNormal(1.5),
        "As large as the coupling stiffnesses that the thesis fits, 1 to 3 N m/rad (Table 9, p. 20).", 0.0,
    ),
    EffectParameter(
        "time", "s", "Time in which the arm relaxes.", LogNormal(0.02, 4.0),
        "Shorter it is a dashpot, longer a spring; in between, near the period over 2 pi, it is neither.",
    ),
)  # fmt: skip
STARTS = ((0.05, 0.02), (0.5, 0.004), (0.5, 0.015), (0.5, 0.05), (0.5, 0.2), (2.0, 0.015))

EFFECT = Effect(
    name="interface_relaxation",
    site="interface",
    title="viscoelastic coupling between the bodies",
    summary="A viscoelastic arm, a spring and a dashpot in series, acts between the bodies.",
    looks_like="Coupling that is stiff for quick and soft for slow relative motion, with damping in between.",
    hides_behind=("k2t", "c2t"),
    source="Findley, Lai and Onaran (1976), Creep and Relaxation of Nonlinear Viscoelastic Materials, sec. 5.3.",
    needs=("coupled",),
    variants=(
        Variant(
            name="one_arm",
            formula="T = ... + k z, dz/dt = w1 - w2 - z/tau",
            parameters=PARAMETERS,
            torque=one_arm,
            couples="interface",
            rate=one_arm_rate,
            memory=1,
            memory_scale=(0.005,),
            starts=STARTS,
        ),
        Variant(
            name="two_arms",
            formula="T = ... + k (z1 + z2)/2, dz1/dt = w1 - w2 - z1/tau, dz2/dt = w1 - w2 - z2/(10 tau)",
            parameters=PARAMETERS,
            torque=two_arms,
            couples="interface",
            rate=two_arms_rate,
            memory=2,
            memory_scale=(0.005, 0.005),
            starts=STARTS,
        ),
    ),
)
