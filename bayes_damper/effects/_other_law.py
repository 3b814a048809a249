"""Dry friction by another smooth law than tanh, to see what hangs on the choice.

    tanh(nu w)  ->  nu w / sqrt(1 + (nu w)^2)

in the bearings and between the faces. Both rise from zero with the slope nu and end at 1; this one gets there slowly,
as 1 - 1 / (2 x^2), so that friction goes on to rise with speed. The thesis chose tanh without a reason (eqs. 18-19).
It is no effect of the library: nothing is added, a formula is exchanged.
"""

from __future__ import annotations

from bayes_damper.effects._shapes import pull
from bayes_damper.effects.base import Variant
from bayes_damper.rig.vector_math import exp, lane, log, tanh


@lane
def more(x):
    """How much more than tanh(x) the other law gives."""
    return x * exp(-0.5 * log(1.0 + x * x)) - tanh(x)


@lane
def torque(t, th1, th2, w1, w2, z1, z2, p, rig):
    """The other law's torques less those of tanh."""
    bearing1, bearing2 = rig.drag * more(rig.nu * w1), rig.drag * more(rig.nu * w2)
    face = rig.mu * rig.N0 * rig.R * pull(th1 - th2, rig) * more(rig.nu * (w1 - w2))
    return -bearing1 - face, -bearing2 + face


OTHER_LAW = Variant("other_law", "tanh(x) -> x / sqrt(1 + x^2)", (), torque=torque)
