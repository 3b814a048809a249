"""The names of all model parameters with symbol, unit and meaning: one place that every file and message agrees with.

Angles are in radians here and everywhere inside; files may give degrees where they say so.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

OF_EFFECT = "effect."
"""Begins the name of a parameter that belongs to an effect."""
OTHER_UNIT = 30.0
"""Times what the rig has, or a part of it, from which a number looks like one in another unit (degrees for radians are
57, thousandths 1000): such a number is reported, and used."""


@dataclass(frozen=True)
class Parameter:
    """One number of the model: its name in files, its symbol in equations, SI unit and meaning."""

    name: str
    symbol: str
    unit: str
    meaning: str


_ALL = (
    Parameter("mu", "mu", "1", "coefficient of friction between the bodies"),
    Parameter("k2t", "k2t", "N m/rad", "stiffness of the coupling between the bodies"),
    Parameter("c2t", "c2t", "N m s/rad", "damping of the coupling between the bodies"),
    Parameter("drag", "d", "N m", "bearing drag torque, each bearing"),
    Parameter("drag_ratio", "d2/d", "1", "drag of the secondary's bearing over that of the primary's"),
    Parameter("nu", "nu", "s/rad", "sharpness with which dry friction changes its sign"),
    Parameter("tail", "tail", "1", "curve of dry friction, from 0 for a tanh to 1 for an arctangent"),
    Parameter("c1t", "c1t", "N m s/rad", "viscous damping of the primary's bearing"),
    Parameter("c3t", "c3t", "N m s/rad", "viscous damping of the secondary's bearing"),
    Parameter("theta0", "theta0", "rad", "release angle"),
    Parameter("delay", "t0", "s", "instant of the true release on the record's clock"),
    Parameter("release_time", "T", "s", "time over which the torque that holds the primary falls to nothing"),
    Parameter("sigma1", "sigma1", "rad/s^2", "noise of the primary's channel"),
    Parameter("sigma2", "sigma2", "rad/s^2", "noise of the secondary's channel"),
    Parameter("noise_freedom", "f", "1", "degrees of freedom of Student's t noise: few where there are outliers"),
    Parameter("J1", "J1", "kg m^2", "moment of inertia of the primary"),
    Parameter("J2", "J2", "kg m^2", "moment of inertia of the secondary"),
    Parameter("J12", "J12", "kg m^2", "inertial coupling of the two bodies"),
    Parameter("k1t", "k1t", "N m/rad", "stiffness of the spring from the primary to ground"),
    Parameter("k3t", "k3t", "N m/rad", "stiffness of the spring from the secondary to ground"),
    Parameter("R", "R", "m", "radius at which the magnets sit on the bars"),
    Parameter("r", "r", "m", "radius of the magnet's face"),
    Parameter("N0", "N0", "N", "pull of the magnet at full overlap"),
    Parameter("theta2_0", "theta2_0", "rad", "angle of the secondary at release"),
    Parameter("omega1_0", "omega1_0", "rad/s", "velocity of the primary at release"),
    Parameter("omega2_0", "omega2_0", "rad/s", "velocity of the secondary at release"),
    Parameter("t_min", "t_min", "s", "time after release from which a peak of a published record counts"),
    Parameter("friction_torque", "mu N0 R", "N m", "friction torque between the faces at full overlap"),
    Parameter("friction_torque_per_inertia", "mu N0 R/J1", "rad/s^2", "friction torque over the primary's inertia"),
)
PARAMETERS: dict[str, Parameter] = {p.name: p for p in _ALL}
"""Every parameter by name."""

RIG_KEYS: dict[str, str] = {
    "primary_inertia": "J1",
    "secondary_inertia": "J2",
    "inertial_coupling": "J12",
    "bar_radius": "R",
    "magnet_radius": "r",
    "magnet_pull": "N0",
    "ground2_stiffness": "k3t",
}
"""Keys of `[rig]` in a campaign.toml -> parameter names."""

TRANSLATIONAL_UNITS: dict[str, str] = {
    "1": "1",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m": "N",
    "s/rad": "s/m",
    "rad": "m",
    "rad/s": "m/s",
    "rad/s^2": "m/s^2",
    "kg m^2": "kg",
    "s": "s",
    "m": "m",
    "N": "N",
}
"""Unit of a torsional rig -> unit of the same parameter of a translational one."""


READING_UNITS: dict[str, str] = {"acceleration": "rad/s^2", "velocity": "rad/s", "displacement": "rad"}
"""Measured quantity -> unit of its readings on a torsional rig."""


def unit_of(name: str, kind: str = "torsional", quantity: str = "acceleration") -> str:
    """Unit of a parameter; "" if it is none of ours. Suffixes in brackets (``k1t[6.2]``, ``theta0[2]``) are ignored.

    kind : of the rig; quantity : that is measured, which is the unit of the noise.
    """
    parameter = PARAMETERS.get(name.partition("[")[0])
    if parameter is None:
        return ""
    unit = READING_UNITS[quantity] if parameter.name in ("sigma1", "sigma2") else parameter.unit
    return TRANSLATIONAL_UNITS.get(unit, unit) if kind == "translational" else unit


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """The valid name most like `name`, None if none is: for error sentences. Case does not count."""
    names = list(valid)
    if same := [v for v in names if v.lower() == name.lower()]:
        return same[0]
    found = difflib.get_close_matches(name.lower()[:60], [v.lower() for v in names], n=1, cutoff=0.5)
    return next(v for v in names if v.lower() == found[0]) if found else None


def hint(name: str, valid: Iterable[str]) -> str:
    """A remedy for an unknown name: the nearest valid one, or all of them."""
    names = list(valid)
    close = nearest(name, names)
    return f"did you mean {close!r}?" if close else "valid names are " + ", ".join(names)
