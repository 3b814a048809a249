"""Units and words of parameters and effects on the rig that they are found on.

Effects declare them for a torsional rig (N m, rad), and those on the scale of a sensor as `reading`; parameters.py does
the same for the parameters of the model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from bayes_damper.errors import InputError
from bayes_damper.rig.parameters import PARAMETERS, READING_UNITS, unit_of


def effect_unit(declared: str, kind: str = "torsional", quantity: str = "acceleration") -> str:
    """Unit of an effect's parameter on this kind of rig, from the one that the effect declares."""
    if declared == "reading":
        return unit_of("sigma1", kind, quantity)
    return declared.replace("N m", "N").replace("rad", "m") if kind == "translational" else declared


BODIES = {"torsional": ("the primary", "the secondary"), "translational": ("body 1", "body 2")}
"""What the two bodies of a rig are called where a person reads: carts and masses go by number, as x1 and m2 do."""
_STRAIGHT = {
    "the primary inertia": "the mass of body 1", "the secondary inertia": "the mass of body 2", "the primary": "body 1",
    "the secondary": "body 2", "primary": "body 1", "secondary": "body 2",
    "moment of inertia": "mass", "moments of inertia": "masses", "inertia": "mass", "inertias": "masses",
    "bearing drag torque": "drag force", "torque": "force", "torques": "forces",
    "release angle": "release displacement", "angle": "displacement", "angles": "displacements",
    "turned against": "moved against", "bars": "bodies", "turn": "travel", "angular": "",
    "th1": "x1", "th2": "x2", "w": "v", "w1": "v1", "w2": "v2", "ws": "vs", "Q": "F", "Q1": "F1", "Q2": "F2",
    "theta0": "x0", "theta1": "x1", "theta2": "x2",
}  # fmt: skip
_PLAIN = {"the faces": "the bodies", "faces": "bodies"}


def in_words_of(text: str, kind: str = "torsional", magnet: bool = True) -> str:
    """A text about a torsional rig with a magnet in the words of another rig: force for torque, mass for inertia.

    text : a title, a meaning, a formula or a note, in which names of files stay as they are; kind : of the rig;
    magnet : whether it has one.
    """
    words = (_STRAIGHT if kind == "translational" else {}) | ({} if magnet else _PLAIN)
    parts = re.split(r"(\S*/\S+\.\w+)", text)  # every second one is the name of a file
    for word in sorted(words, key=len, reverse=True):
        for old, new in ((word, words[word]), (word[0].upper() + word[1:], words[word].capitalize())):
            parts[::2] = [re.sub(rf"\b{re.escape(old)}\b(?! \d)", new, part) for part in parts[::2]]
    return "".join(parts)


_SPOKEN = [word for word in _STRAIGHT if word != "turn" and not re.fullmatch(r"[wQ]\w?|\w+\d", word)]  # no symbols


def sentence_of(sentence: str, kind: str = "torsional") -> str:
    """A message in the words of a rig of this kind; names of files, columns and keys stay as they are written."""
    for word in sorted(_SPOKEN, key=len, reverse=True) if kind == "translational" else ():
        for old, new in ((word, _STRAIGHT[word]), (word[0].upper() + word[1:], _STRAIGHT[word].capitalize())):
            sentence = re.sub(rf"(?<![\w'`/.\\-]){re.escape(old)}(?![\w'`/\\-]|\.\w)", new, sentence)
    return sentence


def plain_meaning(name: str, unit: str = "") -> str:
    """What a parameter is, in the words of the rig that its unit belongs to; "" where the library does not know it."""
    known = PARAMETERS.get(name.partition("[")[0])
    if known is None:
        return ""
    units = {kind: {unit_of(name, kind, quantity) for quantity in READING_UNITS} for kind in BODIES}
    slides = unit in units["translational"] - units["torsional"]
    return in_words_of(known.meaning, "translational" if slides else "torsional")


def kind_by(damping: str) -> str:
    """The kind of rig on which c1t has this unit."""
    return "translational" if damping == unit_of("c1t", "translational") else "torsional"


MOTION = {"torsional": (math.degrees(1.0), "deg"), "translational": (1e3, "mm")}
"""Kind of rig -> factor and unit in which a person reads how far the primary moves."""


def motion_in_words(reach: float, kind: str = "torsional") -> str:
    """How far a body moves, from rad (m): "12 deg", "58 mm"."""
    factor, unit = MOTION[kind]
    return f"{factor * reach:.3g} {unit}"


CHOSEN = {
    "J2": "J2", "k2t": "k2t", "c2t": "c2t", "R": "R", "friction_torque": "friction_torque", "magnet_pull": "N0",
    "bar_inertia": "J2",
}  # fmt: skip
"""What a design may set -> the parameter whose unit it has."""


def design_in_words(design: Mapping[str, float | None], kind: str = "torsional") -> str:
    """What a design sets, each with its unit: "J2 = 0.17 kg, k2t = 86 N/m"; design : as in tune.json."""
    chosen = {name: design.get(name) for name in CHOSEN}
    said = {
        in_words_of(name.replace("_", " "), kind): f"{value:.4g} {unit_of(CHOSEN[name], kind)}"
        for name, value in chosen.items()
        if value is not None and (value or name != "bar_inertia")
    }
    return ", ".join(f"{name} = {value}" for name, value in said.items())


@contextmanager
def spoken_of(kind: object) -> Iterator[None]:
    """Lets what is wrong with what the user gave be said in the words of a rig of this kind.

    Raises
    ------
    InputError
        the one raised inside, its sentences in those words.
    """
    try:
        yield
    except InputError as error:
        if kind != "translational":
            raise
        raise InputError([type(fault)(sentence_of(fault, str(kind))) for fault in error.faults]) from None
