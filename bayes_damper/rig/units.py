"""Units of the parameters of effects on the rig that they are found on.

Effects declare them for a torsional rig (N m, rad), and those on the scale of a sensor as `reading`; parameters.py does
the same for the parameters of the model.
"""

from __future__ import annotations

from bayes_damper.rig.parameters import unit_of


def effect_unit(declared: str, kind: str = "torsional", quantity: str = "acceleration") -> str:
    """Unit of an effect's parameter on this kind of rig, from the one that the effect declares."""
    if declared == "reading":
        return unit_of("sigma1", kind, quantity)
    return declared.replace("N m", "N").replace("rad", "m") if kind == "translational" else declared
