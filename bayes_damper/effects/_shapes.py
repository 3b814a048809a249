"""Shapes that several effects share: how far the faces overlap, their pull, and the nominal friction between them."""

from __future__ import annotations

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
