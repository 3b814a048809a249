# ruff: noqa: ARG001  (every torque of an effect has the same arguments, needed or not)
"""Two links in series: an inertial coupling that falls with the angle between them.

    J1 a1 + J12 cos(phi) a2 = torques1 - J12 sin(phi) w2^2
    J12 cos(phi) a1 + J2 a2 = torques2 + J12 sin(phi) w1^2,    phi = th1 - th2

with the torques of rig/equations.py: Lagrange's equations of a double pendulum in absolute angles (Goldstein, Poole and
Safko, Classical Mechanics, 3rd ed., problem 1.22). The integrator has a constant inertia matrix, so what the true one
adds is written as a torque, in which the accelerations are those of the true matrix: exact, not a correction to first
order. An effect's own torque takes part.

The second link turns on the first, not on the ground: only the first has a bearing with drag to ground. Dry friction of
the joint between the links is that of the interface; c3t is what the air adds. The air feels the speed with which the
second link moves through it, and the first one carries it:

    v = w2 + b w1,    Q2 = -c3t v,    Q1 = -b c3t v,    b = (J12 / J2) cos(phi)

J12 / J2 is the length of the first link over the distance of the second one's centre of percussion from its joint: v is
the speed of that centre, across the link, over this distance. A drag along the link in proportion to its mass has
exactly this Q2 and this cross term; what it adds to Q1 beyond is in proportion to w1 and belongs to c1t.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from bayes_damper.effects.base import Kernel, Variant
from bayes_damper.rig.equations import Rig, friction_torques, smooth_torques
from bayes_damper.rig.vector_math import TANH_SCALE, cos, lane, sin, smooth_sign

Values = tuple[float, float, float, float]


@lane
def _none(
    t: float, th1: float, th2: float, w1: float, w2: float, z1: float, z2: float, p: Values, rig: Rig
) -> tuple[float, float]:
    """No torque of an effect."""
    return 0.0, 0.0


def _linked_torque(inner: Kernel, pendulum: bool, own_friction: bool) -> Kernel:
    """Torque of an effect `inner` and of the moving links; own_friction: it brings its own between the faces."""

    @lane
    def torque(
        t: float, th1: float, th2: float, w1: float, w2: float, z1: float, z2: float, p: Values, rig: Rig
    ) -> tuple[float, float]:
        q1, q2 = inner(t, th1, th2, w1, w2, z1, z2, p, rig)
        tau1, tau2 = smooth_torques(
            th1, th2, w1, w2, rig.k1t, rig.k3t, rig.c1t, rig.c3t, rig.k2t, rig.c2t, True, pendulum
        )
        friction = 0.0 if own_friction else rig.mu * rig.N0 * rig.R
        held1, held2 = friction_torques(
            th1, th2, w1, w2, friction, rig.slope, rig.drag, rig.drag, TANH_SCALE * rig.nu, rig.tail, True, True
        )
        tau1 = tau1 - held1
        tau2 = tau2 - held2
        without = rig.drag * smooth_sign(rig.nu * w2, rig.tail)  # no bearing to ground there
        across = rig.J12 * cos(th1 - th2)
        turning = rig.J12 * sin(th1 - th2)
        lever = across / rig.J2
        f1 = tau1 + q1 - turning * w2 * w2 - lever * rig.c3t * (w2 + lever * w1)
        f2 = tau2 + without + q2 + turning * w1 * w1 - rig.c3t * lever * w1
        inverse = 1.0 / (rig.J1 * rig.J2 - across * across)
        a1 = (rig.J2 * f1 - across * f2) * inverse
        a2 = (rig.J1 * f2 - across * f1) * inverse
        return rig.J1 * a1 + rig.J12 * a2 - tau1, rig.J12 * a1 + rig.J2 * a2 - tau2

    return torque


@cache
def linked(variant: Variant | None, pendulum: bool) -> Variant:
    """The variant (None: no effect) on a rig of two links, ready for the integrator."""
    if variant is None:
        return Variant("links", "two links in series", (), torque=_linked_torque(_none, pendulum, False))
    inner = _none if variant.torque is None else variant.torque
    return replace(variant, torque=_linked_torque(inner, pendulum, variant.replaces_friction), couples="all")


@cache
def _first_alone(inner: Kernel) -> Kernel:
    """Torque of a bearing effect on the first link only."""

    @lane
    def torque(
        t: float, th1: float, th2: float, w1: float, w2: float, z1: float, z2: float, p: Values, rig: Rig
    ) -> tuple[float, float]:
        return inner(t, th1, th2, w1, w2, z1, z2, p, rig)[0], 0.0

    return torque


@cache
def _carried(inner: Kernel) -> Kernel:
    """Torques of a drag of the air, the second link's at the speed that the first one adds to."""

    @lane
    def torque(
        t: float, th1: float, th2: float, w1: float, w2: float, z1: float, z2: float, p: Values, rig: Rig
    ) -> tuple[float, float]:
        lever = rig.J12 / rig.J2 * cos(th1 - th2)
        q1, q2 = inner(t, th1, th2, w1, w2 + lever * w1, z1, z2, p, rig)
        return q1 + lever * q2, q2

    return torque


def of_links(variant: Variant) -> Variant:
    """The variant of an effect in the bearings on a rig of two links.

    There is one bearing to ground, the first link's. Drag of the air acts on both links, and the first one carries the
    second through it.
    """
    if variant.torque is None:
        return variant
    if variant.in_air:
        return replace(variant, torque=_carried(variant.torque), couples="all")
    return replace(variant, torque=_first_alone(variant.torque))
