"""The actuator lets go over a finite time: its holding torque decays.

    Q1 = k1t theta0 f(t/T),    f(x) = 1 - x,    (1 + cos(pi x))/2,    (1 - x)^n    (0 beyond x = 1)    or    exp(-x)

Times count from a microsecond before the release, so that T = 0 is the sudden release. Source:
Augustine (2013), p. 10 (pneumatic actuator); Inman (2014), Engineering Vibration, sec. 3.2.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal, LogNormal
from bayes_damper.rig.vector_math import cos, exp, lane, log


@lane
def linear(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A torque that falls at a constant rate."""
    return rig.k1t * rig.theta0 * max(0.0, 1.0 - (t + 1e-6) / max(p[0], 1e-6)), 0.0


@lane
def cosine(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A torque that falls along half a cosine."""
    x = min((t + 1e-6) / max(p[0], 1e-6), 1.0)
    return rig.k1t * rig.theta0 * 0.5 * (1.0 + cos(3.141592653589793 * x)), 0.0


@lane
def exponential(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A torque that leaks away."""
    return rig.k1t * rig.theta0 * exp(-(t + 1e-6) / max(p[0], 2e-8)), 0.0


@lane
def power(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A torque that falls fast at first (n > 1), as pressure does that drives its own outflow, or last (n < 1)."""
    left = max(0.0, 1.0 - (t + 1e-6) / max(p[0], 1e-6))
    return rig.k1t * rig.theta0 * exp(p[1] * log(left)), 0.0


TIME = EffectParameter(
    "time", "s", "Time over which the torque falls.", HalfNormal(0.004),
    "A valve and a light rod clear the bar within some milliseconds; no release is instantaneous.", 0.0,
)  # fmt: skip
STARTS = ((0.0003,), (0.001,), (0.003,), (0.008,))

EFFECT = Effect(
    name="release_ramp",
    site="release",
    title="release that takes time",
    summary="The actuator lets go of the primary over a finite time.",
    looks_like="The first acceleration peak is lower and later than after a sudden release; then the phase is off.",
    hides_behind=("delay", "theta0"),
    source="Augustine (2013), p. 10; Inman (2014), Engineering Vibration, sec. 3.2.",
    variants=(
        Variant(
            name="linear",
            formula="Q1 = k1t theta0 max(0, 1 - t/T)",
            parameters=(TIME,),
            torque=linear,
            couples="bodies",
            timed=True,
            lets_go="time",
            late=0.5,
            starts=STARTS,
        ),
        Variant(
            name="cosine",
            formula="Q1 = k1t theta0 (1 + cos(pi min(t/T, 1)))/2",
            parameters=(TIME,),
            torque=cosine,
            couples="bodies",
            timed=True,
            lets_go="time",
            late=0.5,
            starts=STARTS,
        ),
        Variant(
            name="exponential",
            formula="Q1 = k1t theta0 exp(-t/T)",
            parameters=(TIME,),
            torque=exponential,
            couples="bodies",
            timed=True,
            lets_go="time",
            late=0.5,
            starts=STARTS,
        ),
        Variant(
            name="power",
            formula="Q1 = k1t theta0 max(0, 1 - t/T)^n",
            parameters=(
                TIME,
                EffectParameter(
                    "exponent",
                    "1",
                    "Exponent of the fall.",
                    LogNormal(1.5, 1.5),
                    "From 1, a constant rate, to 2, pressure behind an orifice, which falls as a square.",
                ),
            ),
            torque=power,
            couples="bodies",
            timed=True,
            lets_go="time",
            late=0.5,
            starts=tuple((time, n) for n in (0.7, 1.5) for (time,) in STARTS),
        ),
    ),
)
