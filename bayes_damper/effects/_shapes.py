"""What effects share: overlap and pull of the faces, the friction between them, and how a law acts at its site."""

from __future__ import annotations

from bayes_damper.effects.base import Kernel
from bayes_damper.rig.equations import normal_force_ratio
from bayes_damper.rig.vector_math import lane, smooth_sign


@lane
def overlap(phi, rig):
    """Share of the faces' width that overlaps at the relative angle phi, 1 to 0 (eq. 20, p. 24), whatever the pull."""
    return normal_force_ratio(phi, rig.R / (2.0 * rig.r))


@lane
def pull(phi, rig):
    """N / N0 of the nominal rig at the relative angle phi: the overlap, or 1 where the rig's pull is constant."""
    return normal_force_ratio(phi, rig.slope)


@lane
def friction(phi, slip, rig):
    """Nominal friction torque between the faces, mu N R s(nu slip), under the rig's own law of the pull (N m)."""
    return rig.mu * rig.N0 * rig.R * pull(phi, rig) * smooth_sign(rig.nu * slip, rig.tail)


def plus(first: Kernel, second: Kernel) -> Kernel:
    """Sum of two laws (t, x, v, z, p, rig) -> torque."""

    @lane
    def both(t, x, v, z, p, rig):
        return first(t, x, v, z, p, rig) + second(t, x, v, z, p, rig)

    return both


def at_site(site: str, bodies: str, law: Kernel, memory: bool = False) -> Kernel:
    """The torque hook of a law (t, x, v, z, p, rig) -> torque at its site; memory : the rate hook of one of dz/dt."""

    @lane
    def on_each(t, th1, th2, w1, w2, z1, z2, p, rig):
        return law(t, th1, w1, z1, p, rig), law(t, th2, w2, z2, p, rig)

    @lane
    def on_primary(t, th1, th2, w1, w2, z1, z2, p, rig):
        return law(t, th1, w1, z1, p, rig), 0.0

    @lane
    def between(t, th1, th2, w1, w2, z1, z2, p, rig):
        q = law(t, th1 - th2, w1 - w2, z1, p, rig)
        return -q, q

    @lane
    def on_secondary(t, th1, th2, w1, w2, z1, z2, p, rig):
        return 0.0, law(t, th2, w2, z1, p, rig)

    @lane
    def rate_between(t, th1, th2, w1, w2, z1, z2, p, rig):
        return law(t, th1 - th2, w1 - w2, z1, p, rig), 0.0

    @lane
    def rate_of_secondary(t, th1, th2, w1, w2, z1, z2, p, rig):
        return law(t, th2, w2, z1, p, rig), 0.0

    if site == "interface":
        return rate_between if memory else between
    if site == "ground2":
        return rate_of_secondary if memory else on_secondary
    return on_each if site == "bearings" and bodies == "both" else on_primary
