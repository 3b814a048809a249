"""campaign.toml: the rig and the measurement, checked."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_damper.campaign.files import nearest_name, read_text
from bayes_damper.campaign.structure import (
    MEASUREMENT_NUMBERS,
    MEASUREMENT_SPREADS,
    MEASUREMENT_WORDS,
    RIG_NUMBERS,
    RIG_WORDS,
    SCATTER_RELATIVE,
    SCATTER_SIZES,
    TO_SI,
    TRIAL_COLUMNS,
    Constant,
    Measurement,
    Rig,
)
from bayes_damper.errors import InputError
from bayes_damper.inputs import collected, real, shown, toml_file, toml_of

TomlValue = Any  # whatever a TOML file can hold: checked by those who take it
_SINGLE = {"sample_rate": "one number, in Hz", "duration": "one number, in s", "every": "one whole number"}
_MOST_APART = 1e6  # a ratio of inertias, or of springs, beyond which one of them does not act
_LARGEST_RADIUS = 10.0  # m, of a rig in a laboratory
_MOST_UNKNOWN = 20
_TOP = ("name", "description", "source", "caveats", "rig", "measurement", "scatter")
_TABLES = {"rig": (*RIG_WORDS, *RIG_NUMBERS),
           "measurement": (*MEASUREMENT_WORDS, *MEASUREMENT_NUMBERS, *MEASUREMENT_SPREADS),
           "scatter": (*SCATTER_RELATIVE, *SCATTER_SIZES)}  # fmt: skip


@dataclass
class Head:
    """What campaign.toml says; `broken` when a fault leaves its numbers without meaning."""

    name: str
    description: str
    source: str
    caveats: tuple[str, ...]
    rig: Rig
    measurement: Measurement
    broken: bool
    notes: list[str] = field(default_factory=list)
    scatter: dict[str, float] = field(default_factory=dict)


def read_head(folder: Path, faults: list[str], digest: hashlib._Hash) -> Head | None:
    """campaign.toml, read and checked; None, and a fault, if it cannot be read at all."""
    name = "campaign.toml"
    if not (folder / name).exists():
        faults.append(f"{folder}: holds no {name}; `bayes-damper init` makes a campaign from logger files")
        return None
    text = read_text(folder / name, name, faults, digest)
    if text is None:
        return None
    with collected(faults):
        return head_from_table(toml_of(text, name), name, faults)
    return None


def head_from_table(table: Mapping[str, Any], name: str, faults: list[str]) -> Head:
    """Checks the keys of a campaign.toml that was read into `table`; faults are appended."""
    before = len(faults)
    for key in _few(table, _TOP, name, faults):
        if key not in _TOP:
            home = next((table for table, keys in _TABLES.items() if key in keys), None)
            hint = (
                nearest_name(key, _TOP)
                if home is None
                else f"it belongs into the table [{home}]: write it below that line"
            )
            faults.append(f"{name}: unknown key '{key}'; {hint}")
    words = {key: _text(table, key, name, faults) for key in ("name", "description", "source")}
    if "name" not in table:
        faults.append(f"{name}: key 'name' is missing; give the campaign a name, name = \"...\"")
    caveats = table.get("caveats", [])
    if not isinstance(caveats, list) or not all(isinstance(c, str) for c in caveats):
        faults.append(f"{name}: 'caveats' must be a list of sentences in quotes")
        caveats = []
    rig = _read_rig(_subtable(table, "rig", name, faults), name, faults)
    measurement = _read_measurement(_subtable(table, "measurement", name, faults), name, faults)
    scatter = _read_scatter(_subtable(table, "scatter", name, faults), rig.kind, name, faults)
    broken = len(faults) > before
    return Head(
        words["name"], words["description"], words["source"], tuple(caveats), rig, measurement, broken, scatter=scatter
    )


def _few(table: Mapping[str, Any], valid: Sequence[str], where: str, faults: list[str]) -> list[str]:
    """The keys of a table to look at: of those that are not valid no more than anybody reads."""
    unknown = [key for key in table if key not in valid]
    if len(unknown) > _MOST_UNKNOWN:
        faults.append(f"{where}: {len(unknown)} unknown keys; the first {_MOST_UNKNOWN} are named")
    left = set(unknown[_MOST_UNKNOWN:])
    return [key for key in table if key not in left]


def _name_unknown(table: Mapping[str, Any], valid: Sequence[str], where: str, faults: list[str]) -> None:
    """A fault for each key that is not valid."""
    unknown = [key for key in _few(table, valid, where, faults) if key not in valid]
    faults += [f"{where}: unknown key '{key}'; {nearest_name(key, valid)}" for key in unknown]


def _text(table: Mapping[str, Any], key: str, name: str, faults: list[str]) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or (key == "name" and key in table and not value.strip()):
        faults.append(f"{name}: '{key}' must be text in quotes, not {shown(value)}")
        return ""
    return value


def _subtable(table: Mapping[str, Any], key: str, name: str, faults: list[str]) -> Mapping[str, Any]:
    value = table.get(key, {})
    if key == "rig" and key not in table:
        faults.append(f"{name}: table [rig] is missing; it must give at least primary_inertia")
    if not isinstance(value, dict):
        faults.append(f"{name}: '{key}' must be a table, [{key}], not {shown(value)}")
        return {}
    return value


def _read_words(
    table: Mapping[str, Any], words: Mapping[str, tuple[str, ...]], where: str, faults: list[str]
) -> dict[str, str]:
    found = {}
    for key, valid in words.items():
        value = table.get(key, valid[0])
        if not isinstance(value, str) or value not in valid:
            faults.append(
                f"{where}: {key} = {shown(value)} is not one of {', '.join(valid)}; {nearest_name(shown(value), valid)}"
            )
            value = valid[0]
        found[key] = value
    return found


def _read_rig(table: Mapping[str, Any], name: str, faults: list[str]) -> Rig:
    where = f"{name} [rig]"
    _name_unknown(table, _TABLES["rig"], where, faults)
    words = _read_words(table, RIG_WORDS, where, faults)
    numbers = {
        key: constant
        for key in RIG_NUMBERS
        if key in table and (constant := constant_from(table[key], f"{where}: {key}", faults)) is not None
    }
    for key, constant in numbers.items():
        _check_constant(key, constant, words["kind"], where, faults)
    if table and "primary_inertia" not in table:
        faults.append(
            f"{where}: key 'primary_inertia' is missing; give J1 in kg m^2 (kg), or 1 when all is per unit inertia"
        )
    if words["kind"] == "translational":
        numbers.setdefault("bar_radius", Constant(1.0))
        if numbers["bar_radius"] != Constant(1.0):
            faults.append(f"{where}: bar_radius is 1 on a translational rig; remove the key")
    numbers.setdefault("primary_inertia", Constant(1.0))
    return Rig(**numbers, **words)  # type: ignore[arg-type]


def constant_from(value: TomlValue, where: str, faults: list[str]) -> Constant | None:
    """A `Constant` from a number or a table {value, std}; None, and a fault, when it is neither."""
    std: Any = 0.0
    if isinstance(value, dict):
        for key in value:
            if key not in ("value", "std"):
                faults.append(f"{where}: unknown key '{key}'; {nearest_name(key, ('value', 'std'))}")
        if "value" not in value:
            faults.append(f"{where}: key 'value' is missing; write {{ value = ..., std = ... }}")
            return None
        value, std = value["value"], value.get("std", 0.0)
    before = len(faults)
    with collected(faults):
        value = real(value, where, "a number or { value = ..., std = ... }")
    with collected(faults):
        std = real(std, f"{where}: std")
    if len(faults) == before and std < 0.0:
        faults.append(f"{where}: std = {std!r} is negative; give a standard uncertainty of 0 or more")
    return Constant(value, std) if len(faults) == before else None


def _check_constant(key: str, constant: Constant, kind: str, where: str, faults: list[str]) -> None:
    value = constant.value
    if key in ("primary_inertia", "secondary_inertia", "bar_radius", "magnet_radius") and value <= 0.0:
        faults.append(f"{where}: {key} = {value!r} must be positive; give it in SI units")
    if key in ("magnet_pull", "ground2_stiffness") and value < 0.0:
        faults.append(f"{where}: {key} = {value!r} must not be negative; give it in SI units")
    if key in ("bar_radius", "magnet_radius") and value > _LARGEST_RADIUS and kind == "torsional":
        faults.append(f"{where}: {key} = {value!r} m is not a laboratory rig; it looks like millimetres, give metres")


def _read_measurement(table: Mapping[str, Any], name: str, faults: list[str]) -> Measurement:
    where = f"{name} [measurement]"
    _name_unknown(table, _TABLES["measurement"], where, faults)
    words = _read_words(table, MEASUREMENT_WORDS, where, faults)
    tuples = {k: _positives(table[k], f"{where}: {k}", faults) for k in MEASUREMENT_NUMBERS if k in table}
    tuples |= {k: _positives(table[k], f"{where}: {k}", faults, zero=True) for k in MEASUREMENT_SPREADS if k in table}
    single: dict[str, float | None] = {}
    for key, wanted in _SINGLE.items():
        found = tuples.pop(key, None)
        if found is not None and (len(found) != 1 or (key == "every" and found[0] != round(found[0]))):
            faults.append(f"{where}: {key} must be {wanted}")
        single[key] = found[0] if found else None
    every = single.pop("every")
    return Measurement(**words, **tuples, **single, every=None if every is None else round(every))  # type: ignore[arg-type]


def _read_scatter(table: Mapping[str, Any], kind: str, name: str, faults: list[str]) -> dict[str, float]:
    """Sizes of [scatter] by name, in SI units; the release angle is given in the unit that trials.csv has."""
    where = f"{name} [scatter]"
    angle = TRIAL_COLUMNS[kind][2]
    valid = (*SCATTER_RELATIVE, *SCATTER_SIZES, angle)
    found = {}
    for key in _few(table, valid, where, faults):
        if key not in valid:
            faults.append(f"{where}: nothing that scatters is called '{key}'; {nearest_name(key, valid)}")
            continue
        with collected(faults):
            size = real(table[key], f"{where}: {key}", "one number, a standard deviation from trial to trial")
            if size < 0.0:
                faults.append(
                    f"{where}: {key} = {size!r} is negative; give a standard deviation, 0 where it is the same"
                )
            elif key in SCATTER_RELATIVE and size >= 1.0:
                faults.append(f"{where}: {key} = {size!r} is relative: half a percent is 0.005; give it below 1")
            else:
                found["theta0" if key == angle else key] = size * (TO_SI[kind] if key == angle else 1.0)
    return found


def _positives(value: TomlValue, where: str, faults: list[str], zero: bool = False) -> tuple[float, ...] | None:
    values = value if isinstance(value, list) else [value]
    if not 1 <= len(values) <= 2:
        faults.append(f"{where} has {len(values)} entries; give one number, or one per channel")
        return None
    found = []
    for given in values:
        with collected(faults):
            number = real(given, where, "a number, or one number per channel")
            found.append(number)
            if not (number > 0.0 or (zero and number == 0.0)):
                faults.append(f"{where} = {number!r} must be {'0 or more' if zero else 'positive'}")
                return None
    return tuple(found) if len(found) == len(values) else None


def per_channel(values: tuple[float, ...] | None, coupled: bool) -> tuple[float, ...] | None:
    """Values for both channels: one given stands for both where there are two."""
    if values is None or len(values) == 2 or not coupled:
        return values
    return values * 2


def check_rig(folder: Path, rig: Rig, coupled: bool, faults: list[str]) -> None:
    """Adds as faults what rig and trials need and the file lacks."""
    where = "campaign.toml [rig]"
    if not coupled:
        return

    def lacks(key: str) -> bool:  # what is there and wrong is not missing
        return getattr(rig, key) is None and not any(fault.startswith(f"{where}: {key}") for fault in faults)

    if lacks("secondary_inertia"):
        faults.append(
            f"{where}: secondary_inertia is missing; a coupled trial needs J2 in kg m^2 (kg) "
            "(init: --secondary-inertia)"
        )
    elif rig.secondary_inertia is None:
        pass
    elif (most := abs(rig.inertial_coupling.value) + rig.inertial_coupling.std) and (
        most**2 >= rig.primary_inertia.value * rig.secondary_inertia.value
    ):
        faults.append(
            f"{where}: inertial_coupling, with its std, must be smaller than sqrt(J1 J2): no rig has such an inertia "
            "matrix"
        )
    elif min(rig.primary_inertia.value, rig.secondary_inertia.value) > 0.0:
        ratio = rig.secondary_inertia.value / rig.primary_inertia.value
        if not 1.0 / _MOST_APART <= ratio <= _MOST_APART:
            faults.append(
                f"{where}: secondary_inertia is {ratio:.3g} times primary_inertia: of two bodies so far apart one "
                "cannot show the other; give both in the same unit"
            )
    if _friction_fixed_at_zero(folder):
        return
    needed = {"bar_radius": "R, m", "magnet_pull": "N0, N, the force that presses the faces together"}
    if rig.normal_force == "linear":
        needed["magnet_radius"] = "r, m"
    for key, unit in needed.items():
        if lacks(key):
            faults.append(
                f"{where}: {key} ({unit}) is missing; a coupled trial needs it for the friction between the bodies, "
                "mu N0 R; where nothing rubs, write mu = 0.0 into a file priors.toml in the campaign's folder"
            )


def _friction_fixed_at_zero(folder: Path) -> bool:
    """Whether the campaign's own priors.toml fixes mu at 0; the prior reader reports a file that cannot be read."""
    try:
        table = toml_file(folder / "priors.toml", "")
    except (FileNotFoundError, InputError):
        return False
    for found in (table.get("mu"), *(t.get("mu") for t in table.values() if isinstance(t, dict))):
        value = found.get("value") if isinstance(found, dict) else found
        if isinstance(value, int | float) and not isinstance(value, bool) and value == 0:
            return True
    return False
