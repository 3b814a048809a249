"""What stands for causes that no effect of the library names: laws of the nominal rig that change while a trial runs.

A slow drift is imitated almost perfectly by effects that grow or fade with the amplitude, so that tests of the
remainder miss it. As a candidate of its own it wins only where it explains better than each of them; its probability
counts for the answer `unknown`.
"""

from __future__ import annotations

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.vector_math import lane, smooth_sign


@lane
def drifting(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Each nominal torque times the time since release: spring, bearings, coupling, friction of the faces."""
    phi = th1 - th2
    v = w1 - w2
    spring = p[0] * rig.k1t * th1
    bearing1 = p[1] * (rig.c1t * w1 + rig.drag * smooth_sign(rig.nu * w1, rig.tail))
    bearing2 = p[1] * (rig.c3t * w2 + rig.drag * smooth_sign(rig.nu * w2, rig.tail))
    pull = rig.mu * rig.N0 * rig.R * max(0.0, 1.0 - rig.slope * abs(phi))
    joint = p[2] * (rig.k2t * phi + rig.c2t * v) + p[3] * pull * smooth_sign(rig.nu * v, rig.tail)
    return -t * (spring + bearing1 + joint), t * (joint - bearing2)


def _rate(name: str, of: str) -> EffectParameter:
    return EffectParameter(
        name, "1/s", f"Relative change per second of the torque of {of}.", Normal(0.0, 0.3),
        "Within a trial of a second a law may well change by a third, hardly by more.", 0.0,
    )  # fmt: skip


DRIFT = Effect(
    name="unknown",
    site="ground1",
    summary="A law of the nominal rig changes while a trial runs, for a reason that the library does not name.",
    looks_like="Early and late swings that no single set of parameters fits.",
    hides_behind=("k1t", "c1t", "drag"),
    source="Own formula: first order of any slow change.",
    variants=(
        Variant(
            name="drift",
            formula="Q = -t (a1 k1t th1 + a2 bearings + a3 coupling + a4 friction)",
            parameters=(
                _rate("spring", "the spring to ground"), _rate("bearings", "the bearings"),
                _rate("coupling", "the coupling"), _rate("friction", "the faces"),
            ),
            torque=drifting,
            timed=True,
            starts=(
                (0.05, 0.0, 0.0, 0.0), (0.0, 0.2, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), (0.0, 0.0, 0.0, 0.3),
                (-0.05, 0.0, 0.0, 0.0), (0.0, -0.2, 0.0, 0.0), (0.0, 0.0, -0.2, 0.0), (0.0, 0.0, 0.0, -0.3),
            ),
        ),
    ),
)  # fmt: skip
