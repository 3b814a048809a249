"""The columns of a logger file before any conversion: how they are found, by name or number, and their units."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import InputError

Array = NDArray[np.float64]
TIME_NAMES = re.compile(
    r"(t|time|zeit|temps|tiempo|tempo|x_value|timestamp|elapsed|seconds|sec|clock)\b.*", re.IGNORECASE
)
_BEHIND = r"(?:rad|mrad|deg|mm|cm|um|m)(?:_s2?)?|n_m|g|mg|ms|us|s|rpm"
"""Units that a name ends with, as in x_mm, alpha1_rad_s2, t_ms; one letter that may mean something else is none."""
_AFTER = re.compile(r"\S(?:\s+/\s*|,\s*|\s+in\s+)(\S.*)$")
"""A unit behind a spaced slash, a comma or `in`, as in `x / mm`, `Position, mm` and `Time in s`."""
_FORCE = re.compile(r"([mk]?N)\s*[.*·⋅]?\s*(m?m)")
"""A torque's unit with or without a mark between its parts, as in Nm, N*m and mN·m."""
_MISREAD = str.maketrans({"²": "^2", "µ": "u", "μ": "u", "°": "deg"})
COUNTED = ("px", "pixel", "pixels", "count", "counts", "lsb", "tick", "ticks")
"""What an encoder or a video gives in place of a unit."""
_UNITS = {
    "s", "ms", "us", "min", "sec", "seconds", "g", "mg", "m/s^2", "mm/s^2", "cm/s^2", "um/s^2", "rad/s^2", "deg/s^2",
    "m/s", "mm/s", "cm/s", "um/s", "rad/s", "mrad/s", "deg/s", "rpm", "m", "cm", "mm", "um", "rad", "mrad", "deg",
    "rev", "v", "mv", "n", "kn", "mn", "n m", "nm", "n mm", "mn m", "hz",
}  # fmt: skip


@dataclass(frozen=True)
class LoggerFile:
    """Columns of one file before any conversion.

    names, units : empty where the file has none, "" where it has none for one column; table : (n, n_columns), nan where
    a reading is missing; notes : sentences about what was left out.
    """

    names: tuple[str, ...]
    table: Array
    units: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def index(self, column: str | int, where: str) -> int:
        """Number from 0 of a column, by its name (without its unit, in any case of letters, will do) or number from 1.

        Raises
        ------
        InputError
            if there is none, or more than one.
        """
        width = self.table.shape[1]
        if isinstance(column, int):
            if not 1 <= column <= width:
                raise InputError(f"{where}: column {column} is missing, the file has {width}; count from 1")
            return column - 1
        plain = [_without_unit(name) for name in self.names]
        wanted = column.strip().lower()
        tries = (
            [n == column for n in self.names],
            [n.lower() == wanted for n in self.names],
            [p == wanted for p in plain],
            # Loggers put unit and run behind a name: "Position (m) Run #1".
            [re.match(re.escape(wanted) + r"\b", n.strip().lower()) is not None for n in self.names] if wanted else [],
        )
        for found in tries:
            if sum(found) > 1:
                raise InputError(f"{where}: {sum(found)} columns are called '{column}'; give their numbers from 1")
            if any(found):
                return found.index(True)
        near = nearest(column, self.names)
        number = "name or number the columns" if self.names else "give its number from 1"
        hint = f"did you mean '{near}'?" if near else number
        raise InputError(f"{where}: column '{column}' is missing, the file has {self.described()}; {hint}")

    def described(self) -> str:
        """The columns, for a sentence."""
        return ", ".join(self.names) or f"{self.table.shape[1]} columns without names"

    def unit(self, column: int) -> str | None:
        """The unit that the file gives for a column (from 0), as the tables of units write it; None for none."""
        if self.units and self.units[column]:
            return self.units[column]
        if not self.names:
            return None
        name = self.names[column].strip().strip('"')
        found = re.search(r"[\[(]([^\[\]()]+(?:\([^()]*\))?)[\])]\s*$", name) or re.search(_AFTER, name)
        if found:
            return unit_of(found[1])
        # A run behind name and unit, as in "Position (cm) Run #1".
        if found := re.search(r"[\[(]([^\[\]()]+)[\])]\s*(?:run|trial|lauf|#)[\s\w#:.-]*$", name, re.IGNORECASE):
            return unit_of(found[1])
        # Physics writes the quantity over its unit, Angle/rad or v/m/s; which Speed m/s, m/s and rev/s do not.
        before, _, over = name.partition("/")
        words = before.split()
        alone = len(words) == 1 and len(words[0]) == 1  # a symbol, as in s/m
        if words and over and unit_of(name) is None and (alone or unit_of(words[-1]) is None):
            return unit_of(over)
        behind = re.search(rf"(?<=[^_\W])_({_BEHIND})$", name)
        return unit_of(behind[1].replace("n_m", "N m").replace("_", "/")) if behind else None

    def column(self, i: int) -> str:
        """A column for a sentence: its number, and its name where it has one."""
        return f"column {i + 1}" + (f" ({self.names[i]})" if self.names else "")

    def called_time(self, i: int) -> bool:
        """Whether a column (from 0) is called after the time."""
        return i < len(self.names) and bool(TIME_NAMES.fullmatch(self.names[i].strip().strip('"')))

    def time_column(self) -> int | None:
        """The column (from 0) that is called after the time, or the first if it alone rises steadily; else None."""
        called = next((i for i in range(len(self.names)) if self.called_time(i)), None)
        if called is not None:
            return called
        first = self.table[:, 0]
        rises = len(first) > 2 and np.isfinite(first).all() and bool((np.diff(first) > 0.0).all())
        return 0 if rises and self.table.shape[1] > 1 else None


def unit_of(text: str) -> str | None:
    """A unit as the tables of units write it, from what stands in a file: "m/s²" and "(m/s2)" are "m/s^2"."""
    plain = text.strip().strip("[]() ").translate(_MISREAD).replace("**", "^")
    plain = re.sub(r"(?<=/s)2$|(?<=/sec)2$", "^2", plain).replace("/sec", "/s").replace("m/s/s", "m/s^2")
    if force := _FORCE.fullmatch(plain):
        plain = " ".join(x for x in force.groups() if x)
    plain = {"sec": "s", "seconds": "s", "G": "g", "g's": "g"}.get(plain, plain)
    return plain if plain.lower() in _UNITS or plain.lower() in COUNTED else None


def nearest(word: str, names: Sequence[str]) -> str | None:
    """The name that is meant: the shortest that has the word in it, or the most alike, whole or without its path."""
    word = word.strip().lower()[:60]
    if holding := [n for n in names if len(word) > 1 and word in n.lower()]:
        return min(holding, key=len)
    known = {n.lower().rpartition(".")[2]: n for n in names} | {n.lower(): n for n in names}
    near = difflib.get_close_matches(word, known, 1, 0.4)
    return known[near[0]] if near else None


def _without_unit(name: str) -> str:
    return re.sub(r"\s*[\[(][^\[\]]*[\])]\s*$", "", name).strip().lower()


def known_units(name: str, columns: Sequence[str], units: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """The units of columns as the tables of units write them, "" for an unknown one, and a note on each of these."""
    known = tuple(unit_of(unit) or "" for unit in units)
    return known, [
        f"{name}: the unit '{unit}' of {column} is not known; give it with --units."
        for column, unit, plain in zip(columns, units, known, strict=True)
        if unit.strip() and not plain
    ]
