"""The keys of an import table, each with its type, what it means and its default, and the record of one trial's.

A key is a field of `ReaderOptions` ([reader], or any of [[trials]]) or of `TrialOptions` ([[trials]] alone); the help
of `init`, the notes of import.toml, the reference and `checked_keys` read it there. Tables become records in
`trials_of`; what reads and converts files takes those.
"""

# ruff: noqa: RUF009 (a key is a field)
from __future__ import annotations

import difflib
import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Self, get_args, get_origin, get_type_hints

from bayes_damper.errors import InputError
from bayes_damper.inputs import collected, real, shown

Column = str | int
Words = tuple[str, ...]
Numbers = tuple[float, ...]
FROM_OPTIONS = "import"  # where a table is called that no file holds
_LONGEST_SLUG = 80
_REQUIRED = ("source", "case", "configuration", "k1t")
MEASUREMENT = (
    "quantity", "frame", "input", "noise_std", "sensor_range", "sensor_bandwidth", "offset_std", "scale_std", "lag_std",
)  # fmt: skip


def _key(meaning: str, default: Any = None, least: float | None = None) -> Any:
    """A key of the table with its meaning, its default and the smallest number that it takes."""
    return field(default=default, metadata={"meaning": meaning, "least": least})


@dataclass(frozen=True, kw_only=True)
class ReaderOptions:
    """How files are read and their columns become readings; None for what is not given."""

    delimiter: str = _key("column separator: 'auto' (default), ',', ';', 'tab' or 'space'", "auto")
    decimal: str | None = _key("decimal mark, '.' or ',' (default: detected)")
    skip_lines: int | None = _key(
        "lines to skip before the column names, or before the numbers (default: detected)", least=0
    )
    header: bool = _key("whether a line of column names precedes the numbers (default: detected)", True)
    time: Column | None = _key("column of the time, by name or number from 1; without one, sample_rate gives the times")
    time_unit: str | None = _key("unit of the time: s (default), ms, us, min")
    sample_rate: float | None = _key("sample rate, Hz, if there is no time column")
    clock: Numbers | None = _key(
        "reading of each file's clock at one common instant, s, if each channel has its own file"
    )
    columns: tuple[Column, ...] = _key(
        "columns of the channels, body 1 (the primary) first, by name or number from 1", ()
    )
    units: Words | None = _key(
        "units of the channels, one or one each (default: as in the file, else SI); mV or V with sensitivity"
    )
    sensitivity: Words | None = _key("sensitivity if voltages were recorded, one per channel, e.g. '100 mV/g'")
    torque: Column | None = _key("column of a measured torque (force) on the primary")
    torque2: Column | None = _key("column of a measured torque (force) on the secondary")
    torque_unit: str | None = _key("unit of the torque (force): N m (default), N mm, mN m; N, kN, mN")
    ground: Column | None = _key("column of the measured motion of the ground")
    ground_unit: str | None = _key(
        "its unit: rad/s^2, deg/s^2 or rad, deg, ...; m/s^2, g, ... or m, mm, ... (default: as in the file)"
    )
    motion: Column | None = _key(
        "column of the motion imposed on the primary; the first of 'columns' is then the reaction, in N m (N)"
    )
    motion_unit: str | None = _key("unit of 'motion', as for ground_unit")
    pivot: Column | None = _key("column of the sideways acceleration of a pendulum's pivot")
    pivot_unit: str | None = _key("unit of the pivot's acceleration: m/s^2 (default), g, ...")
    mounting_radius: float | Numbers | None = _key(
        "distance of tangential sensors from the axis, m, one or per channel"
    )
    sideways: bool = _key(
        "lengths are sideways positions, as in a video: the angle is asin(x / mounting radius), from where it hangs",
        False,
    )
    sign: Numbers | None = _key("1 or -1 per channel: -1 for a sensor mounted the other way round")
    offset: str | float | tuple[str | float, ...] = _key(
        "offset to subtract: 'none' (default), 'mean', 'tail' (end), 'head' (before the release), or raw numbers",
        "none",
    )
    matlab_time: Words = _key("names of the time arrays in a .mat file, in order; a field as 'name.field'", ())
    matlab_data: Words = _key(
        "names of the data arrays in a .mat file, channels along the shorter side or each in an array of its own", ()
    )
    group: str = _key("prefix of the channel names to take, if a TDMS, MDF4, HDF5 or UFF file has several clocks", "")
    wrap: Numbers | None = _key(
        "value at which a raw channel wraps around, 0 for none: 360 (deg), 65536 (16-bit counter)"
    )
    scale: Numbers | None = _key(
        "size of one raw count in 'units', per channel: 0.0879 (deg per count), 0.35 (mm per pixel)"
    )
    start: float | None = _key("cut readings before this time of the raw clock, s")
    end: float | None = _key("cut readings after this time of the raw clock, s")
    release: str | float = _key(
        "where t = 0 is: 'start' (default), 'find', 'first_peak', or s on the raw clock", "start"
    )
    before: float | None = _key("time to keep before the release, s", least=0.0)
    every: int = _key("keep every N-th reading", 1, least=1)

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Self:
        """The record of a table that has been checked; what is no key of it is left out."""
        names = {f.name for f in fields(cls)}
        given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items() if k in names}
        return cls(**given)

    @property
    def inputs(self) -> dict[str, Column]:
        """The columns of measured inputs that are given."""
        given = {"torque": self.torque, "torque2": self.torque2, "ground": self.ground, "motion": self.motion,
                 "pivot": self.pivot}  # fmt: skip
        return {name: column for name, column in given.items() if column is not None}


@dataclass(frozen=True, kw_only=True)
class TrialOptions(ReaderOptions):
    """One of [[trials]] with what [reader] says for all of them; where : its place, for sentences."""

    where: str
    source: str | Words = _key("raw file, or one for each channel, primary first", MISSING)
    sha256: str | Words | None = _key("its checksum (one for each file), compared where given")
    file: str = _key("record to write, e.g. trials/a1.csv", MISSING)
    case: str = _key("label of the case", MISSING)
    configuration: str = _key("uncoupled or coupled", MISSING)
    trial: int = _key("number within case and configuration", MISSING)
    k1t: float | str = _key("spring to ground, N m/rad (N/m), or 'estimate' from the strongest frequency", MISSING)
    k1t_std: float = _key("standard uncertainty of k1t", 0.0, least=0.0)
    theta0: float | None = _key("release angle, deg (displacement, mm)")
    theta0_std: float | None = _key("standard uncertainty of theta0, deg (mm)")
    holdout: bool = _key("true: not fitted, only used to test the model", False)


@dataclass(frozen=True)
class Key:
    """What a table may hold under a key.

    types : of a value; items : of the entries of a list; least : the smallest number.
    """

    types: tuple[type, ...]
    meaning: str
    items: tuple[type, ...] = ()
    least: float | None = None


_KINDS: dict[Any, tuple[type, ...]] = {float: (int, float), NoneType: ()}


def _kinds(members: Sequence[Any]) -> tuple[type, ...]:
    """What a table holds where a record has one of these types: a list for a tuple, a whole number for any number."""
    return tuple(k for m in members for k in ((list,) if get_origin(m) is tuple else _KINDS.get(m, (m,))))


def _members(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if isinstance(hint, UnionType) else (hint,)


def _keys_of(cls: type[ReaderOptions]) -> dict[str, Key]:
    """The keys that the fields of a record are."""
    out, hints = {}, get_type_hints(cls)
    for f in fields(cls):
        members = _members(hints[f.name])
        items = next((_members(get_args(m)[0]) for m in members if get_origin(m) is tuple), ())
        if f.metadata:
            out[f.name] = Key(_kinds(members), items=_kinds(items), **f.metadata)
    return out


READER = _keys_of(ReaderOptions)
TRIAL = {name: key for name, key in _keys_of(TrialOptions).items() if name not in READER}
INIT = {
    "pattern": Key(
        (str,), "how file names are built, e.g. 'case{case}_{configuration}_{trial}'; also {theta0} and {k1t}"
    ),
    "words": Key((list,), "words for the configurations in file names, e.g. free=uncoupled magnet=coupled"),
    "sheet": Key((str,), "CSV table of the trials: a column file or case, and other options as columns"),
    "files_per_trial": Key((int,), "2 if each channel has its own file, the primary's first"),
}
"""Options of `init` alone: how trials differ from each other."""


def trials_of(table: Mapping[str, Any], name: str, faults: list[str]) -> list[TrialOptions]:
    """The trials of an import table, numbered; adds to `faults` where two are one.

    Raises
    ------
    InputError
        with these faults and one sentence for every key that is missing or cannot be.
    """
    reader, rows = table.get("reader", {}), table.get("trials", [])
    if not isinstance(reader, dict) or not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
        raise InputError([*faults, f"{name}: write [reader] as one table and [[trials]] once for each trial"])
    faults += checked_keys(reader, READER, f"{name} [reader]")
    if not rows:
        faults.append(f"{name}: no [[trials]]; write one for each record")
    places = []
    for i, row in enumerate(rows, start=1):
        where = f"{name} [[trials]] number {i}"
        faults += checked_keys(row, TRIAL | READER, where)
        faults += [f"{where}: key '{key}' is missing" for key in _REQUIRED if key not in row]
        if name == FROM_OPTIONS and "source" in row:  # options of the command line make no table that anybody has seen
            sources = row["source"] if isinstance(row["source"], list) else [row["source"]]
            where = ", ".join(Path(str(source)).name for source in sources)
        places.append(where)
    if faults:
        raise InputError(gathered(faults))
    out: list[TrialOptions] = []
    seen: dict[tuple[str, str, int], str] = {}
    counts = Counter[tuple[str, str]]()
    for row, where in zip(rows, places, strict=True):
        case, configuration = row["case"], row["configuration"]
        counts[case, configuration] += 1
        number = row.get("trial", counts[case, configuration])
        if "trial" in row:
            key = (case, configuration, number)
            if key in seen:
                there = f"trial {number} of {case} {configuration} is there already ({seen[key]})"
                faults.append(f"{where}: {there}; give each trial of a case its own number")
            seen[key] = where
        own = {"where": where, "trial": number, "file": f"trials/{_slug(case)}_{configuration}_{number}.csv"}
        out.append(TrialOptions.of(own | reader | row))
    return out


def checked_keys(table: Mapping[str, Any], valid: Mapping[str, Key], where: str) -> list[str]:
    """What is wrong with the keys of READER, TRIAL, ... in a table, or with their values."""
    faults = []
    for key, value in table.items():
        known = valid.get(key)
        if known is None:
            near = difflib.get_close_matches(key[:60], valid, 1, 0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"valid keys: {', '.join(valid)}"
            faults.append(f"{where}: unknown key '{key}'; {hint}")
        elif not _is_one_of(value, known.types):
            numbers = float in known.types and list not in known.types
            wanted = "a number with a decimal point" if numbers else "of another type"
            faults.append(f"{where}: {key} = {shown(value)}, which must be {wanted}: {known.meaning}")
        elif key == "decimal" and value not in (".", ","):
            faults.append(f"{where}: decimal = {shown(value)} is none of '.' and ','")
        elif value == "":
            faults.append(f"{where}: {key} is empty; leave the key out, or give {known.meaning}")
        items, meaning = (known.items, known.meaning) if known is not None else ((), "")
        for part in value if items and isinstance(value, list) else ():
            if not _is_one_of(part, items):
                faults.append(f"{where}: {key} holds {shown(part)}, which cannot be: {meaning}")
        for number in value if isinstance(value, list) else [value]:
            with collected(faults):
                if isinstance(number, int | float) and not isinstance(number, bool):
                    real(number, f"{where}: {key}")
    return faults + [
        f"{where}: {key} = {shown(value)} is too small; give at least {least}"
        for key, least in ((name, known.least) for name, known in valid.items() if known.least is not None)
        if isinstance(value := table.get(key), int | float) and not value >= least
    ]


def _is_one_of(value: object, types: tuple[type, ...]) -> bool:
    return isinstance(value, types) and (not isinstance(value, bool) or bool in types)


def _slug(text: str) -> str:
    """A label as part of a file's name, which no system takes at any length."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", text) or "case"
    long = f"{plain[:_LONGEST_SLUG]}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
    return plain if len(plain) <= _LONGEST_SLUG else long


def gathered(faults: Sequence[str]) -> list[str]:
    """Faults or notes once each; one that three files or more have in common as one sentence."""
    files: dict[str, list[str]] = {}
    for fault in dict.fromkeys(faults):
        name, mark, rest = fault.partition(": ")
        files.setdefault(rest if mark else fault, []).append(name if mark else "")
    out = []
    for rest, names in files.items():
        if len(names) > 2:
            out.append(f"{names[0]} and {len(names) - 1} other files: {rest}")
        else:
            out += [f"{name}: {rest}" if name else rest for name in names]
    return out
