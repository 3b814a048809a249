"""Rate-independent hysteresis in the coupling: part of its torque depends on the history of the angle.

    Dahl:      Q1 = -F z,                  dz/dt = (w1 - |w1| z) / d
    Bouc-Wen:  Q1 = a k1t (th1 - d z),     dz/dt = (w1 - (|w1| z |z| + w1 z^2) / 2) / d

Memory: F z / k1t or a d z, in rad, so that it vanishes with the effect.

z = L (1 - exp(-theta0/d)) or L tanh(theta0/d) at release: L = 1 if the coupling was just wound up from its middle
position, 0 if it has relaxed since. Source: Dahl (1968), Aerospace TOR-158; Wen (1976), J. Eng. Mech. 102, 249.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal, Uniform
from bayes_damper.rig.vector_math import exp, lane, tanh


@lane
def dahl(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction torque between the halves of the coupling."""
    return -rig.k1t * z1, 0.0


@lane
def dahl_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rate of that torque over k1t."""
    return (w1 * p[0] / rig.k1t - abs(w1) * z1) / p[1], 0.0


@lane
def dahl_start(p, rig):
    """State after winding up to the release angle from rest."""
    wound = 1.0 - exp(-abs(rig.theta0) / p[1])
    return p[2] * p[0] / rig.k1t * (wound if rig.theta0 >= 0.0 else -wound), 0.0


@lane
def bouc_wen(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A share of the spring that yields."""
    return rig.k1t * (p[0] * th1 - z1), 0.0


@lane
def bouc_wen_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Rate of the torque that yields, over k1t (exponent 2, beta = gamma)."""
    return p[0] * w1 - 0.5 * (abs(w1) * z1 * abs(z1) + w1 * z1 * z1) / (max(p[0], 1e-9) * p[1] * p[1]), 0.0


@lane
def bouc_wen_start(p, rig):
    """State after winding up to the release angle from rest."""
    return p[2] * p[0] * p[1] * tanh(rig.theta0 / p[1]), 0.0


ANGLE = EffectParameter(
    "angle", "rad", "Angle over which the torque turns round after a reversal.", LogNormal(0.02, 3.0),
    "Between full sliding at once and no sliding within the motion; known to a factor of three.",
)  # fmt: skip
WOUND = EffectParameter(
    "wound", "1", "How much of the winding up is left at release.", Uniform(0.0, 1.0),
    "How the rig was brought to its angle, and how long it waited there, is not recorded.",
)  # fmt: skip

EFFECT = Effect(
    name="coupling_hysteresis",
    site="ground1",
    needs=("spring",),
    title="hysteresis of the spring to ground",
    summary="Part of the torque of the spring to ground lags behind its angle, however slow the motion.",
    looks_like="More damping of small motions than drag explains, and a stiffer spring the smaller the motion.",
    hides_behind=("drag", "k1t", "c1t"),
    source="Dahl (1968), Aerospace Corp. TOR-158; Wen (1976), J. Eng. Mech. Div. 102, 249; Augustine (2013), p. 33.",
    variants=(
        Variant(
            name="dahl",
            formula="Q1 = -F z, dz/dt = (w1 - |w1| z)/d",
            parameters=(
                EffectParameter(
                    "torque", "N m", "Torque of the sliding coupling.", HalfNormal(0.05),
                    "Like the other dry friction of the rig: a few per cent of the spring torque at release.", 0.0,
                ),
                ANGLE,
                WOUND,
            ),
            torque=dahl,
            rate=dahl_rate,
            start=dahl_start,
            memory=1,
            memory_scale=(0.005,),
            starts=((0.005, 0.005, 0.5), (0.02, 0.005, 0.5), (0.02, 0.02, 0.9), (0.03, 0.06, 0.1), (0.002, 0.02, 0.9)),
        ),
        Variant(
            name="bouc_wen",
            formula="Q1 = a k1t (th1 - d z), dz/dt = (w1 - (|w1| z |z| + w1 z^2)/2)/d",
            parameters=(
                EffectParameter(
                    "share", "1", "Share of the stiffness that yields.", HalfNormal(0.3),
                    "The springs carry most of the torque; the rest, contacts that slide, may be some tenths.", 0.0,
                ),
                ANGLE,
                WOUND,
            ),
            torque=bouc_wen,
            rate=bouc_wen_rate,
            start=bouc_wen_start,
            memory=1,
            memory_scale=(0.005,),
            starts=((0.02, 0.02, 0.5), (0.1, 0.005, 0.5), (0.1, 0.02, 0.9), (0.1, 0.06, 0.1), (0.3, 0.02, 0.5)),
        ),
    ),
)  # fmt: skip
