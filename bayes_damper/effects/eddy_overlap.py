"""Damping between the bodies that grows with the overlap of the faces, as eddy currents make it.

    c2t -> c2t (1 - a + a o^n),    o = overlap of the faces, n = 1 or 2

Source: Sodano et al. (2006), J. Sound Vib. 292, 815 (damping with the square of the flux through the conductor).
"""

from __future__ import annotations

from bayes_damper.effects._shapes import overlap
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Uniform
from bayes_damper.rig.vector_math import lane


@lane
def linear(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Damping in proportion to the overlap."""
    q = rig.c2t * (w1 - w2) * p[0] * (overlap(th1 - th2, rig) - 1.0)
    return -q, q


@lane
def squared(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Damping in proportion to the square of the overlap."""
    o = overlap(th1 - th2, rig)
    q = rig.c2t * (w1 - w2) * p[0] * (o * o - 1.0)
    return -q, q


PARAMETERS = (
    EffectParameter(
        "share", "1", "Share of c2t that comes and goes with the overlap.", Uniform(0.0, 1.0),
        "None to all of the damping may be due to eddy currents.", 0.0,
    ),
)  # fmt: skip

EFFECT = Effect(
    name="eddy_overlap",
    site="interface",
    title="damping that follows the overlap of the faces",
    summary="The damping between the bodies is largest where their faces overlap most.",
    looks_like="Sliding is damped strongly while the bars are aligned and hardly where they are apart.",
    hides_behind=("c2t", "mu"),
    source="Sodano, Bae, Inman and Belvin (2006), J. Sound Vib. 292, 815.",
    needs=("coupled", "magnet"),
    variants=(
        Variant(
            name="linear",
            formula="c2t (1 - a + a o)",
            parameters=PARAMETERS,
            torque=linear,
            couples="interface",
            starts=((0.05,), (0.5,), (0.95,)),
        ),
        Variant(
            name="squared",
            formula="c2t (1 - a + a o^2)",
            parameters=PARAMETERS,
            torque=squared,
            couples="interface",
            starts=((0.05,), (0.5,), (0.95,)),
        ),
    ),
)
