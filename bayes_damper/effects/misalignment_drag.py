"""The magnet pulls the shafts askew, and the bearings drag more while it does.

    Q = -a mu N R s(nu w),    -a mu N0 R s(nu w)    or    -c (N/N0) w    on each inertia, coupled trials only

Source: Augustine (2013), pp. 9 and 33 (one-sided magnets misalign the shafts).
"""

from __future__ import annotations

from bayes_damper.effects._shapes import pull
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.vector_math import lane, smooth_sign


@lane
def with_pull(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Dry drag in proportion to the pull of the moment."""
    side = p[0] * rig.mu * rig.N0 * rig.R * pull(th1 - th2, rig)
    return -side * smooth_sign(rig.nu * w1, rig.tail), -side * smooth_sign(rig.nu * w2, rig.tail)


@lane
def constant(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Dry drag that is there whenever the magnet is."""
    side = p[0] * rig.mu * rig.N0 * rig.R
    return -side * smooth_sign(rig.nu * w1, rig.tail), -side * smooth_sign(rig.nu * w2, rig.tail)


@lane
def viscous(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Viscous drag in proportion to the pull of the moment; p is the damping over that of the bearings."""
    side = p[0] * rig.c1t * pull(th1 - th2, rig)
    return -side * w1, -side * w2


SHARE = EffectParameter(
    "share", "1", "Extra drag of each bearing over the friction torque between the faces.", HalfNormal(0.3),
    "Bronze on steel rubs more than Teflon, but at the radius of the shaft, an order of magnitude below the bar's.",
    0.0,
)  # fmt: skip

EFFECT = Effect(
    name="misalignment_drag",
    site="bearings",
    title="bearing drag from the pull of the magnet",
    summary="The bearings drag more the harder the magnet pulls them askew.",
    looks_like="Coupled trials lose more energy than uncoupled ones and the interface explain, on both bodies alike.",
    hides_behind=("drag", "mu", "c1t", "c3t"),
    source="Augustine (2013), pp. 9 and 33.",
    needs=("coupled", "magnet"),
    variants=(
        Variant(
            name="with_pull",
            formula="Q = -a mu N R s(nu w)",
            parameters=(SHARE,),
            torque=with_pull,
            starts=((0.01,), (0.1,), (0.4,)),
        ),
        Variant(
            name="constant",
            formula="Q = -a mu N0 R s(nu w)",
            parameters=(SHARE,),
            torque=constant,
            couples="bodies",
            starts=((0.01,), (0.1,), (0.4,)),
        ),
        Variant(
            name="viscous",
            formula="Q = -a c1t (N/N0) w",
            parameters=(
                EffectParameter(
                    "share", "1", "Extra viscous damping of each bearing over c1t.", HalfNormal(1.0),
                    "Side load may double the damping of a bearing.", 0.0,
                ),
            ),
            torque=viscous,
            starts=((0.05,), (0.5,), (2.0,)),
        ),
    ),
)  # fmt: skip
