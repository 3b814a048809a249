"""A pull of the magnet that falls otherwise than linearly with the offset of the faces.

    N -> N o^e,    N + s (N0 A(phi) - N)    or    N + s (N0 exp(-(q phi)^2) - N)

o is the overlap of eq. 20, A the common area of two circles over that of one. Source: Augustine (2013), p. 24 (linear
law, assumed); Vokoun et al. (2009), J. Magn. Magn. Mater. 321, 3758 (pull of cylinder magnets and their offset).
"""

from __future__ import annotations

from bayes_damper.effects._shapes import friction, overlap, pull
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import LogNormal, Normal, Uniform
from bayes_damper.rig.vector_math import exp, lane, log, smooth_sign


@lane
def power(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Pull times a power of the overlap."""
    phi = th1 - th2
    q = friction(phi, w1 - w2, rig) * (exp(p[0] * log(max(overlap(phi, rig), 1e-3))) - 1.0)
    return -q, q


@lane
def lens(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Pull in proportion to the common area of two circles (a fit to the lens formula, error below 1e-4)."""
    phi = th1 - th2
    o = overlap(phi, rig)
    x = 1.0 - o
    area = exp(1.5 * log(o)) * (1.0 + x * (0.226600 + x * (-0.033177 + x * 0.007268)))
    q = rig.mu * rig.N0 * rig.R * smooth_sign(rig.nu * (w1 - w2), rig.tail) * p[0] * (area - pull(phi, rig))
    return -q, q


@lane
def bell(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Pull that falls as a Gaussian of the relative angle."""
    phi = th1 - th2
    x = p[1] * phi
    q = rig.mu * rig.N0 * rig.R * smooth_sign(rig.nu * (w1 - w2), rig.tail) * p[0] * (exp(-x * x) - pull(phi, rig))
    return -q, q


SHARE = EffectParameter(
    "share", "1", "How far the law lies from the linear one (0) to this one (1).", Uniform(0.0, 1.5),
    "Anything between the two laws, and somewhat beyond.", 0.0,
)  # fmt: skip

EFFECT = Effect(
    name="normal_force_law",
    site="interface",
    title="other law of the magnet's pull",
    summary="The pull of the magnet falls otherwise than linearly with the offset of the faces.",
    looks_like="Jumps at reversals of sliding whose height varies with the relative angle, but not as the overlap.",
    hides_behind=("mu", "R", "r"),
    source="Augustine (2013), p. 24; Vokoun et al. (2009), J. Magn. Magn. Mater. 321, 3758.",
    needs=("coupled", "magnet"),
    alike=frozenset({"friction_displacement"}),
    variants=(
        Variant(
            name="power",
            formula="N o^e",
            parameters=(
                EffectParameter(
                    "exponent", "1", "Exponent of the overlap beyond that of the law.", Normal(0.5, 0.8, -0.7, 6.0),
                    "Pull goes with the square of the flux, so exponents of one to two and more are expected.", 0.0,
                ),
            ),
            torque=power,
            couples="interface",
            starts=((0.05,), (1.0,), (-0.4,), (2.0,)),
        ),
        Variant(
            name="lens",
            formula="N + s (N0 A(phi) - N)",
            parameters=(SHARE,),
            torque=lens,
            couples="interface",
            starts=((0.05,), (1.0,)),
        ),
        Variant(
            name="bell",
            formula="N + s (N0 exp(-(q phi)^2) - N)",
            parameters=(
                SHARE,
                EffectParameter(
                    "narrowness", "1/rad", "Inverse of the angle that leaves a third of the pull.", LogNormal(5.0, 2.0),
                    "Between the offset at which faces of 25 mm at a radius of 0.1 m part, and half of it.",
                ),
            ),
            torque=bell,
            couples="interface",
            starts=((0.1, 5.0), (1.0, 3.0), (1.0, 5.0), (1.0, 9.0)),
        ),
    ),
)  # fmt: skip
