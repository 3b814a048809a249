"""Friction between the faces that is larger at rest than in sliding, or that first bends before it slides.

    Stribeck:  Q = f mu N R S(v) s(nu v),  S = exp(-(v/vs)^2) or exp(-|v|/vs),  v = w1 - w2
    bristle:   T = mu N R (z + s dz/dt),  dz/dt = (v - |v| z / G(v)) / d,  G = 1 + f exp(-(v/vs)^2)

The bristle (LuGre) replaces the nominal friction and tends to it for small d, s and f. Source: Augustine (2013), p. 22;
Canudas de Wit et al. (1995), IEEE Trans. Autom. Control 40, 419; Armstrong-Helouvry et al. (1994), Automatica 30, 1083.
"""

from __future__ import annotations

from bayes_damper.effects._shapes import friction, pull
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import exp, lane


@lane
def gaussian(t, th1, th2, w1, w2, z1, z2, p, rig):
    """An excess that falls as a Gaussian of the sliding speed."""
    v = w1 - w2
    q = p[0] * friction(th1 - th2, v, rig) * exp(-(v / p[1]) * (v / p[1]))
    return -q, q


@lane
def exponential(t, th1, th2, w1, w2, z1, z2, p, rig):
    """An excess that falls exponentially with the sliding speed."""
    v = w1 - w2
    q = p[0] * friction(th1 - th2, v, rig) * exp(-abs(v) / p[1])
    return -q, q


@lane
def bristle_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rate of the bristles' deflection, without static excess; p = deflection, damping."""
    v = w1 - w2
    return (v - abs(v) * z1) / p[0], 0.0


@lane
def bristle(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Torque of bristles without static excess."""
    v = w1 - w2
    q = rig.mu * rig.N0 * rig.R * pull(th1 - th2, rig) * (z1 + p[1] * (v - abs(v) * z1) / p[0])
    return -q, q


@lane
def lugre_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rate of the bristles' deflection; p = deflection, damping, static excess, speed."""
    v = w1 - w2
    return (v - abs(v) * z1 / (1.0 + p[2] * exp(-(v / p[3]) * (v / p[3])))) / p[0], 0.0


@lane
def lugre(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Torque of bristles with static excess."""
    v = w1 - w2
    rate = (v - abs(v) * z1 / (1.0 + p[2] * exp(-(v / p[3]) * (v / p[3])))) / p[0]
    q = rig.mu * rig.N0 * rig.R * pull(th1 - th2, rig) * (z1 + p[1] * rate)
    return -q, q


EXCESS = EffectParameter(
    "excess", "1", "Static above kinetic friction, over kinetic friction.", HalfNormal(0.7),
    "Static friction of Teflon on metal is up to about twice the kinetic one.", 0.0,
)  # fmt: skip
SPEED = EffectParameter(
    "speed", "rad/s", "Sliding speed over which the excess is lost.", LogNormal(0.3, 3.0),
    "Between creeping and the largest sliding speed of the motion; known to a factor of three.",
)  # fmt: skip
DEFLECTION = EffectParameter(
    "deflection", "rad", "Deflection at which the bristles slide.", LogNormal(0.002, 3.0),
    "Strips of a millimetre shear by a tenth to a few tenths of it at a radius of 0.1 m; known to a factor of three.",
)  # fmt: skip
DAMPING = EffectParameter(
    "damping", "s", "Damping over stiffness of the bristles.", LogNormal(0.001, 4.0),
    "A small share of the period: bristles do not ring for long, nor do they add a viscous torque of note.",
)  # fmt: skip
LUGRE_EXCESS = EffectParameter("excess", "1", EXCESS.meaning, EXCESS.prior, EXCESS.reason)
STRIBECK_STARTS = ((0.3, 0.1), (0.3, 0.3), (0.3, 1.0), (0.3, 2.5), (1.0, 0.2), (0.01, 0.3))

EFFECT = Effect(
    name="stick_slip",
    site="interface",
    title="sticking between the faces",
    summary="The faces stick: friction is larger at rest than in sliding, or gives way elastically before it slides.",
    looks_like="Short phases in which both bodies move together, with a jump in both accelerations where they end.",
    hides_behind=("mu", "nu", "k2t", "c2t"),
    source="Canudas de Wit et al. (1995), IEEE Trans. Autom. Control 40, 419; Augustine (2013), p. 22.",
    needs=("coupled", "magnet"),
    variants=(
        Variant(
            name="gaussian",
            formula="Q2 = -Q1 = f mu N R exp(-(v/vs)^2) s(nu v)",
            parameters=(EXCESS, SPEED),
            torque=gaussian,
            couples="interface",
            starts=STRIBECK_STARTS,
        ),
        Variant(
            name="exponential",
            formula="Q2 = -Q1 = f mu N R exp(-|v|/vs) s(nu v)",
            parameters=(EXCESS, SPEED),
            torque=exponential,
            couples="interface",
            starts=STRIBECK_STARTS,
        ),
        Variant(
            name="bristle",
            formula="T = mu N R (z + s dz/dt), dz/dt = (v - |v| z)/d",
            parameters=(DEFLECTION, DAMPING),
            torque=bristle,
            couples="interface",
            rate=bristle_rate,
            memory=1,
            memory_scale=(0.3,),
            replaces_friction=True,
            starts=((0.0005, 0.0003), (0.002, 0.0003), (0.002, 0.003), (0.008, 0.001)),
        ),
        Variant(
            name="lugre",
            formula="T = mu N R (z + s dz/dt), dz/dt = (v - |v| z/(1 + f exp(-(v/vs)^2)))/d",
            parameters=(DEFLECTION, DAMPING, LUGRE_EXCESS, SPEED),
            torque=lugre,
            couples="interface",
            rate=lugre_rate,
            memory=1,
            memory_scale=(0.3,),
            replaces_friction=True,
            starts=(
                (0.002, 0.001, 0.3, 0.3), (0.0005, 0.0003, 0.5, 0.1),
                (0.002, 0.001, 0.5, 1.0), (0.006, 0.001, 0.8, 0.3),
            ),
        ),
    ),
)  # fmt: skip
