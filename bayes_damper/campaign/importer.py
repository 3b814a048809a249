"""From a pile of logger files (CSV, text, MATLAB) to a campaign folder.

What is done to the raw files stands in one table, `import.toml`, so that it can be repeated and checked: which columns,
which units, where the release lies, which stretches become trials. `import_records` carries it out and ends with
the same check as every command; `init_campaign` makes the table from options.

    name, description, source, caveats, [rig], [measurement]     as in campaign.toml
    [reader]                                                     the keys of READER: defaults for all trials
    [[trials]]                                                   the keys of TRIAL, and any of READER
"""

from __future__ import annotations

import csv
import hashlib
import itertools
import math
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from bayes_damper import campaign as campaigns
from bayes_damper.campaign import Campaign, Constant, Measurement, Rig, Trial
from bayes_damper.campaign import readings as look
from bayes_damper.campaign.import_options import (
    LEAST_KNOWN,
    NOTHING_RUBS,
    READER,
    TRIAL,
    checked_keys,
    file_names,
    spec_from_options,
    spec_text,
)
from bayes_damper.campaign.logger_files import COUNTED, LoggerFile, read_file, unit_of
from bayes_damper.campaign.trials_table import inside
from bayes_damper.errors import InputError
from bayes_damper.inputs import file_bytes, resolved, shown, text_of, toml_file
from bayes_damper.rig.parameters import unit_of as unit_of_parameter
from bayes_damper.rig.units import sentence_of, spoken_of

Array = NDArray[np.float64]

_LONGEST_SLUG = 80
_NAMED = 12
"""Files that a sentence names one by one."""
_FEWEST = 10
"""Readings that a record must have."""
_STILL = 12.0
"""Reach of a record that rests, in standard deviations of its noise, at most."""
_GRAVITY = 9.80665
_DEGREE = math.pi / 180.0
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_TANGENTIAL = {
    "displacement": _LENGTHS,
    "velocity": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    "acceleration": {
        **{f"{unit}/s^2": factor for unit, factor in _LENGTHS.items()},
        "g": _GRAVITY,
        "mg": 1e-3 * _GRAVITY,
    },
}
_ANGULAR = {
    "displacement": {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "rev": 2.0 * math.pi},
    "velocity": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "rpm": math.pi / 30.0},
    "acceleration": {"rad/s^2": 1.0, "deg/s^2": _DEGREE},
}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}
_FEWEST_AT_REST = 8  # readings before a release of which a mean is taken
_FEWEST_PERIODS = 2.0  # of an oscillation which the weighted mean of a tail takes out but for 5 %
_SWINGS = 0.2  # share of the record's range in its last quarter
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_INPUT_KEYS = ("torque", "torque2", "ground", "motion", "pivot")
_PLURAL = {"displacement": "displacements", "velocity": "velocities", "acceleration": "accelerations"}
_INPUT = {
    "torsional": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "translational": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
}


def import_records(
    spec: str | Path | Mapping[str, Any], folder: str | Path, raw: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Writes the campaign that an import table describes; gives its folder.

    spec : path of an import.toml, or its content as a mapping; raw : folder of the raw files, by default that of the
    table; overwrite : replace the campaign that `folder` holds. A priors.toml beside the table goes along. Nothing is
    written unless the result passes the check of every command.

    Raises
    ------
    InputError
        with one sentence for every fault of the table, of the raw files, or of the campaign that comes out.
    """
    table, name, home = _spec_table(spec)
    beside = home / "priors.toml"
    priors = file_bytes(beside) if not isinstance(spec, Mapping) and beside.exists() else None
    return _write(table, name, Path(folder), Path(raw) if raw is not None else home, priors, overwrite)


def _write(
    table: Mapping[str, Any], name: str, folder: Path, raw: Path, priors: bytes | None, overwrite: bool
) -> Path:  # fmt: skip
    """The campaign of an import table with its priors.toml, if it passes the check of every command."""
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder, or --overwrite to replace it")
    rig = table.get("rig")
    with spoken_of(rig.get("kind") if isinstance(rig, Mapping) else None):
        built = _build(table, name, raw)
    with tempfile.TemporaryDirectory() as scratch:
        draft = campaigns.write_campaign(Path(scratch) / "campaign", built)
        text = (draft / "campaign.toml").read_text(encoding="utf-8")
        note = "# Written by `bayes-damper init`; every key may be edited. SI units.\n"
        (draft / "campaign.toml").write_text(note + text, encoding="utf-8")
        if priors is not None:
            (draft / "priors.toml").write_bytes(priors)
        try:
            campaigns.load_campaign(draft)
        except InputError as error:  # what is wrong with the readings may be what they were taken for
            large = any("the readings imply" in fault for fault in error.faults)
            taken = [caveat for caveat in built.caveats if large and _UNNAMED in caveat]
            raise InputError([*error.faults, *taken]) from None
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    return folder


def records_in(folder: str | Path) -> tuple[str, ...]:
    """The records that are there of those that a folder's trials.csv names, whatever else is wrong with it."""
    path = Path(folder) / "trials.csv"
    try:
        rows = list(csv.DictReader(text_of(file_bytes(path), str(path)).splitlines()))
    except (OSError, InputError, csv.Error):
        return ()
    named = dict.fromkeys((row.get("file") or "").strip() for row in rows)
    return tuple(name for name in named if name and (Path(folder) / name).is_file())


def left_over(folder: str | Path, before: Sequence[str]) -> list[str]:
    """A sentence on records of the former campaign of a folder (`records_in` it) that the new one does not name.

    They stay: only their owner knows whether they are to be had elsewhere.
    """
    now = {resolved(Path(folder) / name) for name in records_in(folder)}
    stale = [name for name in before if (Path(folder) / name).is_file() and resolved(Path(folder) / name) not in now]
    if not stale:
        return []
    some = ", ".join(stale[:_NAMED]) + (f" and {len(stale) - _NAMED} more" if len(stale) > _NAMED else "")
    them = "them" if len(stale) > 1 else "it"
    remedy = f"no command reads {them} now, remove {them} or keep {them} elsewhere"
    return [f"{some}: left over from the campaign that was here before; {remedy}"]


_NO_FRICTION = (
    b"# Written by `bayes-damper init`: no magnet_pull was given, so nothing rubs between the bodies.\nmu = 0.0\n"
)


def init_campaign(
    folder: str | Path, sources: Sequence[str | Path], overwrite: bool = False, raw: str | Path | None = None,
    **options: object,
) -> Path:  # fmt: skip
    """A commented campaign from logger files, one trial a file; gives its folder, which also gets import.toml.

    sources : the logger's files, in the order of the trials; overwrite : replace the campaign that `folder` holds;
    raw : where the files lie that a sheet names, by default beside the sheet.
    options : any key of READER and TRIAL (for all files alike), of [rig] and of [measurement] of campaign.toml, and
    name, description, source_text (where the data come from). What is not given is assumed and noted as a caveat: an
    inertia of 1 (all per unit inertia), k1t from the strongest frequency, no friction between the bodies (mu = 0 in the
    campaign's priors.toml) where coupled trials come without a magnet_pull.

    Raises
    ------
    InputError
        as `import_records`, and for options that do not exist.
    """
    folder = Path(folder)
    paths = [resolved(s) for s in sources]
    with spoken_of(options.get("kind")):
        spec = spec_from_options(resolved(folder).name, paths, options, None if raw is None else resolved(raw))
    text = spec_text(spec)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        line = text[: error.end].splitlines()[-1]
        raise InputError(f"{line}: holds a byte that is no character; name files and give words in UTF-8") from None
    beside = folder / "priors.toml"
    found = file_bytes(beside) if beside.exists() else None
    priors = _NO_FRICTION if NOTHING_RUBS in spec["caveats"] else None
    _write(spec, "import", folder, Path(), priors if found in (None, _NO_FRICTION) else found, overwrite)
    if priors is None and found == _NO_FRICTION:  # of an earlier call that knew no magnet
        beside.unlink()
    (folder / "import.toml").write_text(text, encoding="utf-8")
    return folder


def convert(
    readings: Array, unit: str, kind: str, quantity: str, radius: float | None, where: str, sideways: bool = False
) -> Array:
    """Readings in SI units of the quantity: rad (m), rad/s (m/s), rad/s^2 (m/s^2).

    A tangential unit on a torsional rig (m/s^2, g, mm ...) is divided by the mounting radius, in m. sideways : lengths
    are not arcs but sideways positions x of a marker at that radius, whose angle is asin(x / radius).

    Raises
    ------
    InputError
        for a unit that the quantity cannot have, a tangential unit without a radius, or sideways readings that are no
        lengths or longer than the radius.
    """
    tangential = _TANGENTIAL[quantity]
    if kind == "translational":
        valid = tangential
    else:
        valid = {**_ANGULAR[quantity], **tangential}
    if unit not in valid:
        other = next((q for q in _TANGENTIAL if unit in _TANGENTIAL[q] or unit in _ANGULAR[q]), None)
        other_quantity = f", but of {other}: for such readings give --quantity {other}" if other else ""
        if other == quantity:  # of a rig that turns
            other_quantity = " of a cart, but of a rig that turns: for such readings give --kind torsional"
        if unit.lower() in COUNTED:
            first = next(iter(valid))
            other_quantity = f": give --units {first} and, as --scale, how many {first} one of them is"
            if quantity == "displacement" and kind == "torsional":
                other_quantity += " (a video: --units m, --scale, --mounting-radius of the marker, and --sideways)"
            if quantity != "displacement":
                angle = "m" if kind == "translational" else "rad"
                other_quantity += f" (counts of an encoder: --quantity displacement --units {angle})"
        raise InputError(f"{where}: '{unit}' is no unit of {quantity}{other_quantity}; valid units: {', '.join(valid)}")
    if sideways and (kind == "translational" or quantity != "displacement" or unit not in tangential):
        raise InputError(
            f"{where}: sideways is for displacements of a turning rig in m, cm, mm or um, not for '{unit}'"
        )
    if kind == "translational" or unit in _ANGULAR[quantity]:
        return readings * valid[unit]
    if radius is None:
        raise InputError(
            f"{where}: '{unit}' is tangential; give mounting_radius in metres, or kind = 'translational' for what "
            "moves along a line"
        )
    if not 0.0 < radius < 10.0:
        raise InputError(f"{where}: mounting_radius = {radius!r} m is not possible; give metres")
    with np.errstate(over="ignore"):  # readings of 1e307: the check of the campaign names what is not finite
        along = readings * (valid[unit] / radius)
    if not sideways:
        return along
    if (farthest := float(np.nanmax(np.abs(along), initial=0.0))) > 1.0:
        raise InputError(
            f"{where}: the sideways position reaches {farthest:.3g} times the mounting radius; check radius and scale, "
            "and take off with --offset what it reads where the rig hangs at rest"
        )
    return np.asarray(np.arcsin(along))


# --- the table -----------------------------------------------------------------------------------------------------


_UNNAMED = "no unit is named"
_FROM_OPTIONS = "import"  # where a table is called that no file holds


def _spec_table(spec: str | Path | Mapping[str, Any]) -> tuple[Mapping[str, Any], str, Path]:
    if isinstance(spec, Mapping):
        return spec, _FROM_OPTIONS, Path()
    path = Path(spec)
    try:
        return toml_file(path, "give an import table"), path.name, path.parent
    except FileNotFoundError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an import table") from None


def _build(table: Mapping[str, Any], name: str, raw: Path) -> Campaign:
    """The campaign in memory, all conversions done."""
    faults: list[str] = []
    head_keys = {key: value for key, value in table.items() if key not in ("reader", "trials")}
    head = campaigns.head_from_table(head_keys, name, faults)
    reader, rows = table.get("reader", {}), table.get("trials", [])
    if not isinstance(reader, dict) or not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
        raise InputError([*faults, f"{name}: write [reader] as one table and [[trials]] once for each trial"])
    faults += checked_keys(reader, READER, f"{name} [reader]")
    if not rows:
        faults.append(f"{name}: no [[trials]]; write one for each record")
    options = []
    for i, row in enumerate(rows, start=1):
        where = f"{name} [[trials]] number {i}"
        found = checked_keys(row, {**TRIAL, **READER}, where)
        found += [
            f"{where}: key '{key}' is missing" for key in ("source", "case", "configuration", "k1t") if key not in row
        ]
        faults += found
        if name == _FROM_OPTIONS and "source" in row:  # options of the command line make no table that anybody has seen
            sources = row["source"] if isinstance(row["source"], list) else [row["source"]]
            where = ", ".join(Path(str(source)).name for source in sources)
        options.append({**reader, **row, "where": where})
    if faults:
        raise InputError(_gathered(faults))
    trials: list[Trial] = []
    contradicted: list[str] = []
    unnamed: list[str] = []
    files: dict[Path, LoggerFile] = {}
    faults += _repeated(options)
    counts: dict[tuple[str, str], int] = {}
    for option in options:
        group = (option["case"], option["configuration"])
        counts[group] = counts.get(group, 0) + 1
        option.setdefault("trial", counts[group])
        option.setdefault("file", f"trials/{_slug(group[0])}_{group[1]}_{option['trial']}.csv")
        if not inside(option["file"]):
            faults.append(
                f"{option['where']}: file = {shown(option['file'])} leaves the campaign's folder, or is too long"
            )
            continue
        try:
            trials.append(_trial_from(option, head.rig, head.measurement, raw, files, contradicted, unnamed))
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(_gathered(faults))
    trials = _with_estimates(trials, head.rig)
    notes = [note for source in files.values() for note in source.notes if note not in head.caveats]
    measurement = _with_declared_units(head.rig, head.measurement, unnamed)
    if "quantity" in table.get("measurement", {}) and not any(t.given for t in trials):
        unnamed = []
    notes = _gathered([*notes, *contradicted, *unnamed]) + _resting(trials, options) + _idle(trials)
    caveats = (*head.caveats, *(sentence_of(note, head.rig.kind) for note in notes))
    return Campaign(
        head.name, head.rig, measurement, tuple(trials), head.description, head.source, caveats,
        scatter=head.scatter,
    )  # fmt: skip


_RANGES = (1.0, 2.0 * math.pi, 360.0, *(2.0**bits for bits in range(8, 33)))  # of turns, angles and counters
_REST = 0.05  # share of a record; one that rests for longer began before the release


def _resting(trials: Sequence[Trial], options: Sequence[Mapping[str, Any]]) -> list[str]:
    """A hint where records taken from their first reading on begin at rest."""
    found = []
    for trial, given in zip(trials, options, strict=True):
        t, y = np.asarray(trial.times), np.asarray(trial.channels[0])
        if given.get("release", "start") == "start" and len(t) > 20:
            rest = look.find_release(t, y) - float(t[0])
            if rest > _REST * float(t[-1] - t[0]):
                found.append((str(trial.file), rest, look.release_option(t, y)))
    if not found:
        return []
    name, rest, option = found[0]
    more = "" if len(found) == 1 else f" (and {len(found) - 1} more)"
    zero = {"find": "the release", "first_peak": "the first peak after the hand"}[option]
    return [f"{name}{more} rests for its first {rest:.2g} s: with --release {option}, t = 0 is {zero}."]


_IDLE = (
    "{}: the secondary rests throughout. If nothing coupled it to the primary, these trials are uncoupled: say so with "
    "--configuration, --pattern or --sheet."
)


def _idle(trials: Sequence[Trial]) -> list[str]:
    """A hint where the secondary of a coupled trial never moves, as it does where nothing couples it."""
    found = []
    for trial in trials:
        if trial.coupled:
            primary, secondary = (np.asarray(y) for y in trial.channels)
            if not _still(primary) and _still(secondary):
                found.append(str(trial.file))
    return [_IDLE.format(file_names(found))] if found else []


def _still(y: Array) -> bool:
    """Whether nothing in these readings exceeds their noise."""
    return bool(np.ptp(y) <= _STILL * look.noise_floor_of(y))


def _gathered(faults: Sequence[str]) -> list[str]:
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


def _slug(text: str) -> str:
    """A label as part of a file's name, which no system takes at any length."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", text) or "case"
    return (
        plain
        if len(plain) <= _LONGEST_SLUG
        else f"{plain[:_LONGEST_SLUG]}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
    )


def _with_estimates(trials: list[Trial], rig: Rig) -> list[Trial]:
    """Fills k1t where it was to be estimated (marked by 0): median over the case, standard uncertainty 20 %."""
    filled = []
    for trial in trials:
        if trial.k1t.value > 0.0:
            filled.append(trial)
            continue
        alike = [t for t in trials if t.case == trial.case]
        lines = [look.dominant_frequency(t.times, t.channels[0]) for t in alike]
        k1t = float(f"{rig.primary_inertia.value * (2.0 * math.pi * float(np.median(lines))) ** 2:.3g}")
        if k1t <= 0.0:
            raise InputError(f"{trial.file}: no frequency stands out, so k1t cannot be estimated; give it")
        filled.append(replace(trial, k1t=Constant(k1t, float(f"{0.2 * k1t:.2g}"))))
    return filled


def _trial_from(
    option: Mapping[str, Any], rig: Rig, measurement: Measurement, raw: Path, files: dict[Path, LoggerFile],
    contradicted: list[str], unnamed: list[str],
) -> Trial:  # fmt: skip
    """One trial in SI units; adds to `contradicted` what its file says otherwise than the options, to `unnamed` a
    sentence where neither says what is read.
    """
    source, where, option = _source_of(option, raw, files)
    times = _times_of(source, option, where)
    places = _places_of(source, option, where)
    channels = _unwrapped(source.table[:, places].T, option)
    if measurement.quantity == "displacement" and "wrap" not in option:
        _refuse_wraps(source.table[:, places].T, where)
    contradicted += _other_units(source, places, option.get("units", []), where)
    # Of a rig released from rest the size of the first peak shows what is read.
    released = measurement.start == "rest" and not set(_INPUT_KEYS) & set(option)
    if not {"units", "motion"} & set(option) and not released and not all(source.unit(place) for place in places):
        slow = "positions" if rig.kind == "translational" else "angles"
        give = f"for {slow} or speeds give --quantity, and" if measurement.quantity == "acceleration" else "give"
        unnamed.append(
            f"{where}: {_UNNAMED}, so the readings were taken as {_PLURAL[measurement.quantity]} in "
            f"{unit_of_parameter('sigma1', rig.kind, measurement.quantity)}; {give} --units where they are not in SI."
        )
    named = _named_units(source, places, rig.kind, measurement.quantity)
    if "motion" in option:
        named[0] = source.unit(places[0]) or next(iter(_INPUT[rig.kind]))
    option = {"units": named, **option}
    inputs = _inputs_of(source, option, rig.kind, where)
    known = np.isfinite(times) & np.isfinite(channels).all(axis=0)
    known &= np.all([np.isfinite(x) for x in inputs.values()], axis=0)
    if np.mean(known) < LEAST_KNOWN:
        missing = 100.0 * (1.0 - np.mean(known))
        raise InputError(
            f"{where}: {missing:.0f} % of the readings in the chosen columns are missing; choose other columns, or "
            "export the file again"
        )
    # A line without a reading becomes a gap of the record, which every command allows for.
    times, channels = times[known], channels[:, known]
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        raise InputError(
            f"{where}: the time does not increase after {times[back[0]]:.9g} s; {_restarted(times, int(back[-1]) + 1)}"
        )
    keep, zero = _window(times, channels[0], option, measurement, where)
    option = _with_rest(option, channels[:, times < zero - 1e-9], measurement, where)
    times, channels = np.round(times[keep] - zero, 9), channels[:, keep]
    contradicted += _swinging_tails(times, channels, option, where)
    channels = _in_si(channels, option, rig.kind, measurement.quantity, where)
    acting = {key: x[known][keep] for key, x in inputs.items()}
    return Trial(
        option["file"],
        option["case"],
        option["configuration"],
        option["trial"],
        _stiffness(option),
        _release_angle(option, rig.kind, measurement.start),
        times,
        channels,
        holdout=option.get("holdout", False),
        cut="start" in option or "end" in option,
        **acting,
    )


def _restarted(times: Array, last: int) -> str:
    """What to do about a time that does not increase; last : index of the reading from which on it does."""
    if len(times) - last < max(_FEWEST, len(times) // 2):
        return "sort the rows, or give sample_rate"
    return (
        f"it does from reading {last + 1} of {len(times)} on: if the logger began anew there, skip_lines leaves out "
        "what is before; else sort the rows, or give sample_rate"
    )


def _places_of(source: LoggerFile, option: Mapping[str, Any], where: str) -> list[int]:
    """Columns (from 0) of a trial's channels."""
    wanted = option.get("columns")
    if option["configuration"] not in ("uncoupled", "coupled"):
        raise InputError(
            f"{option['where']}: configuration = {option['configuration']!r} is none of 'uncoupled' and 'coupled'"
        )
    coupled = option["configuration"] == "coupled"
    if not wanted:
        raise InputError(
            f"{option['where']}: 'columns' is missing; name the channels, the primary first (the file has "
            f"{source.described()})"
        )
    if len(wanted) < 1 + coupled:
        raise InputError(
            f"{option['where']}: a coupled trial needs two columns, primary and secondary; 'columns' has one"
        )
    if len(wanted) > 2:
        raise InputError(
            f"{option['where']}: 'columns' names {len(wanted)} channels, {', '.join(map(str, wanted))}; a rig has one, "
            "or when coupled two: the primary's, then the secondary's"
        )
    places = [source.index(c, where) for c in wanted[: 1 + coupled]]
    _check_columns(source, places, option, where)
    return places


def _check_columns(source: LoggerFile, places: Sequence[int], option: Mapping[str, Any], where: str) -> None:
    """InputError where one column (from 0) is named for two things, or a clock for a channel."""
    named = [("columns", i) for i in places]
    named += [(key, source.index(option[key], where)) for key in ("time", *_INPUT_KEYS) if key in option]
    for (one, i), (other, j) in itertools.combinations(named, 2):
        if i == j:
            twice = "twice in 'columns'" if one == other else f"in both '{one}' and '{other}'"
            raise InputError(f"{option['where']}: {source.column(i)} is named {twice}; name each column once")
    _refuse_clocks(source, places, option)


def _refuse_clocks(source: LoggerFile, places: Sequence[int], option: Mapping[str, Any]) -> None:
    """InputError where a channel (a column from 0) is called after the time and rises all along."""
    for i in places:
        if source.called_time(i) and (np.diff(source.table[:, i]) > 0.0).all():
            mend = "name it as 'time', and in 'columns' those that the sensors read"
            if "sample_rate" in option:
                mend = "leave out the sample rate, or name in 'columns' those that the sensors read"
            raise InputError(
                f"{option['where']}: {source.column(i)} is a clock and stands in 'columns'; {mend} "
                f"(the file has {source.described()})"
            )


def _inputs_of(source: LoggerFile, option: Mapping[str, Any], kind: str, where: str) -> dict[str, Array]:
    """Measured inputs in SI units, by their names in structure.INPUTS."""
    out: dict[str, Array] = {}
    for key in _INPUT_KEYS:
        if key not in option:
            continue
        place = source.index(option[key], where)
        moves = key in ("ground", "motion")
        name = f"{key}_unit" if moves or key == "pivot" else "torque_unit"
        tables = {key: _INPUT[kind]}
        if moves:
            known = {"torsional": _ANGULAR, "translational": _TANGENTIAL}[kind]
            tables = {f"{key}_acceleration": known["acceleration"], key: known["displacement"]}
        if key == "pivot":
            tables = {key: _TANGENTIAL["acceleration"]}
        every = {unit: (target, factor) for target, table in tables.items() for unit, factor in table.items()}
        unit = option.get(name) or source.unit(place) or next(iter(every))
        unit = unit if unit in every else unit_of(unit) or unit
        if unit not in every:
            raise InputError(f"{option['where']}: {name} '{unit}' is none of {', '.join(every)}")
        target, factor = every[unit]
        out[target] = factor * source.table[:, place]
    if out and option.get("every", 1) > 1:
        raise InputError(
            f"{option['where']}: every = {option['every']} would leave out most of the measured input; write it under "
            "[measurement] of campaign.toml, where it thins the readings alone"
        )
    return out


def _unwrapped(channels: Array, option: Mapping[str, Any]) -> Array:
    """Channels (n_channels, n) that begin again at the end of their range joined, and raw numbers in `units`."""
    out = np.array(channels, float)
    for key, neutral in (("wrap", 0.0), ("scale", 1.0)):
        values = option.get(key, [neutral] * len(out))
        if len(values) < len(out) or any(not math.isfinite(v) or (key == "wrap" and v < 0.0) for v in values):
            raise InputError(
                f"{option['where']}: {key} = {values}: give a number for each of the {len(out)} channels"
                + (", 0 for one that does not begin again" if key == "wrap" else "")
            )
        for y, value in zip(out, values, strict=False):  # y is a row of out
            there = np.isfinite(y)
            if key == "scale":
                np.multiply(y, value, out=y)
            elif value:
                y[there] = np.unwrap(y[there], period=value)
    return out


def _refuse_wraps(channels: Array, where: str) -> None:
    """Refuse raw channels (n_channels, n) that begin again at the end of their range, and name the option for them."""
    found = [look.wrap_of(y[np.isfinite(y)]) for y in channels]
    if not any(found):
        return
    values = []
    for limits in found:
        least, most = limits or (0.0, 0.0)
        round_ones = (float(f"{0.5 * (least + most):.{digits}g}") for digits in range(1, 9))
        values.append(f"{next((x for x in (*_RANGES, *round_ones) if least <= x <= most), least):.8g}")
    raise InputError(
        f"{where}: the readings jump to and fro by all that they span, as those of a counter that begins again do: "
        f"give --wrap {' '.join(values)} ('wrap'; 0 for a channel that does not)"
    )


def _source_of(
    option: Mapping[str, Any], raw: Path, files: dict[Path, LoggerFile]
) -> tuple[LoggerFile, str, Mapping[str, Any]]:
    """The file of a trial, its name, and the option; files of one channel each are put side by side."""

    def read(source: str, sha256: str | None) -> LoggerFile:
        path = raw / source
        if path not in files:
            files[path] = read_file(path, {**option, "sha256": sha256})
        return files[path]

    sources = option["source"]
    if isinstance(sources, str):
        return read(sources, option.get("sha256")), Path(sources).name, option
    sums = option.get("sha256") or [None] * len(sources)
    where, columns = ", ".join(Path(s).name for s in sources), option.get("columns") or []
    if len(columns) != len(sources) or len(sums) != len(sources) or len(sources) > 2:
        raise InputError(
            f"{option['where']}: {len(sources)} files for the channels of one trial; give at most two, primary "
            "first, and 'columns' with one column of each"
        )
    parts = [read(s, digest) for s, digest in zip(sources, sums, strict=True)]
    clocks = [_own_times(part, option, Path(s).name) for part, s in zip(parts, sources, strict=True)]
    places = [p.index(c, Path(s).name) for p, c, s in zip(parts, columns, sources, strict=True)]
    for part, place in zip(parts, places, strict=True):
        _refuse_clocks(part, [place], option)
    channels = [p.table[:, i] for p, i in zip(parts, places, strict=True)]
    units = ("s", *(p.unit(i) or "" for p, i in zip(parts, places, strict=True)))
    notes: tuple[str, ...] = ()
    step = float(np.median(np.diff(clocks[0])))
    if "clock" in option or any(len(c) != len(clocks[0]) or np.max(np.abs(c - clocks[0])) > 0.5 * step for c in clocks):
        times, channels, note = _on_one_clock(clocks, channels, option, where)
        table, notes = np.column_stack([times, *channels]), (note,)
    else:
        table = np.column_stack([clocks[0], *channels])
    both = LoggerFile(("time", *(f"channel {k + 1}" for k in range(len(parts)))), table, units, notes)
    files[raw / where] = both  # for its note; those of the parts stand beside it
    plain = {k: v for k, v in option.items() if k not in ("time_unit", "sample_rate")}
    return both, where, {**plain, "time": 1, "columns": [k + 2 for k in range(len(parts))]}


def _own_times(part: LoggerFile, option: Mapping[str, Any], where: str) -> Array:
    """The clock of a file that may name its time otherwise than the other file of a trial does."""
    try:
        return _times_of(part, option, where)
    except InputError:
        column = part.time_column()
        if column is None or "sample_rate" in option:
            raise
        return _times_of(part, {**option, "time": column + 1}, where)


def _on_one_clock(
    clocks: Sequence[Array], channels: Sequence[Array], option: Mapping[str, Any], where: str
) -> tuple[Array, list[Array], str]:
    """Two channels at the times of the slower one, while both were read, on the clock of the first file; and a note.

    The faster channel goes through its readings as a cubic spline; where either lacks a reading nearby, there is none.
    """
    steps = [float(np.median(np.diff(c))) for c in clocks]
    spans = " and ".join(f"{c[0]:g} to {c[-1]:g} s in steps of {d:.4g} s" for c, d in zip(clocks, steps, strict=True))
    if "clock" not in option:
        raise InputError(
            f"{where}: the channels were not read at the same times ({spans}); export them with one clock, or give "
            "with --clock what the clock of each file shows at one instant that both saw, such as a trigger (0 0 where "
            "it is one clock)"
        )
    common = option["clock"]
    if len(common) != len(clocks):
        raise InputError(f"{option['where']}: clock = {common}: give one instant for each of the {len(clocks)} files")
    if any(not (np.diff(c) > 0.0).all() for c in clocks):
        raise InputError(f"{where}: the time of a file does not increase or has gaps; sort its rows, fill its times")
    shifted = [c - at for c, at in zip(clocks, common, strict=True)]
    slow = int(np.argmax(steps))
    fast = 1 - slow
    known = np.isfinite(channels[fast])
    have = shifted[fast][known]
    times = shifted[slow]
    if known.sum() < _FEWEST or np.sum((times >= have[0]) & (times <= have[-1])) < _FEWEST:
        raise InputError(
            f"{where}: the channels were never read at one time ({spans}, clock = {common}); correct clock"
        )
    inside = (times >= have[0]) & (times <= have[-1])
    times = times[inside]
    after = np.clip(np.searchsorted(have, times), 1, len(have) - 1)
    near = have[after] - have[after - 1] < 3.0 * steps[fast]
    found = [channels[slow][inside], np.where(near, CubicSpline(have, channels[fast][known])(times), np.nan)]
    note = f"{where}: the clocks differ; channel {fast + 1} was brought to the times of channel {slow + 1}."
    return times + common[0], found if slow == 0 else found[::-1], note


def _named_units(source: LoggerFile, places: Sequence[int], kind: str, quantity: str) -> list[str]:
    """Units that the file gives for its channels; those of SI where it gives none."""
    default = next(iter({"torsional": _ANGULAR, "translational": _TANGENTIAL}[kind][quantity]))
    return [source.unit(i) or default for i in places]


def _other_units(source: LoggerFile, places: Sequence[int], given: Sequence[str], where: str) -> list[str]:
    """Notes where a file names another unit for a channel than `units` does."""
    return [
        f"{where}: the file gives {source.column(place)} in {named}, 'units' in {unit}; {unit} was taken."
        for place, unit in zip(places, given, strict=False)
        if (named := source.unit(place)) not in (None, unit) and str(named).lower() not in COUNTED
    ]


def _with_declared_units(rig: Rig, measurement: Measurement, unnamed: Sequence[str]) -> Measurement:
    """The measurement, its units declared where no trial's are `unnamed` and `check` would ask whether they are others.

    Angles that start free are compared with no release, so only their size speaks.
    """
    asked = rig.kind == "torsional" and measurement.start == "free"
    return replace(measurement, units="declared") if asked and not unnamed else measurement


def _stiffness(option: Mapping[str, Any]) -> Constant:
    k1t = option["k1t"]
    if k1t == "estimate":
        return Constant(0.0)
    if isinstance(k1t, str) or not 0.0 < k1t < math.inf:
        raise InputError(f"{option['where']}: k1t = {k1t!r} must be a positive number or 'estimate'")
    return Constant(float(k1t), float(option.get("k1t_std", 0.0)))


def _release_angle(option: Mapping[str, Any], kind: str, start: str) -> Constant | None:
    if start == "free":
        return None
    if "theta0" not in option:
        raise InputError(
            f"{option['where']}: theta0 is missing; give it in deg (mm), or set start = 'free' in [measurement]"
        )
    unit = _DEGREE if kind == "torsional" else 1e-3
    theta0 = float(option["theta0"])
    std = float(option.get("theta0_std", f"{max(0.1, 0.02 * abs(theta0)):.3g}"))
    return Constant(theta0 * unit, std * unit)


def _in_si(channels: Array, option: Mapping[str, Any], kind: str, quantity: str, where: str) -> Array:
    """Offset, sign and unit of each channel; (n_channels, n)."""
    count = len(channels)
    default = {"torsional": _ANGULAR, "translational": _TANGENTIAL}[kind][quantity]
    units = option.get("units", [next(iter(default))])
    units = units * count if len(units) == 1 else units  # channels of one quantity, as a rule
    signs, radius = option.get("sign", [1] * count), option.get("mounting_radius")
    radii = radius if isinstance(radius, list) else [radius] * count
    offsets = option.get("offset", "none")
    offsets = offsets if isinstance(offsets, list) else [offsets] * count
    for key, values in (("units", units), ("sign", signs), ("mounting_radius", radii), ("offset", offsets)):
        if len(values) < count:
            raise InputError(
                f"{option['where']}: '{key}' has {len(values)} entries for {count} channels; give one for each"
            )
    kinds = {str(u): q for u in units[:count] for q in _TANGENTIAL if u in _TANGENTIAL[q] or u in _ANGULAR[q]}
    if "motion" not in option and len(set(kinds.values())) > 1:
        read = " and ".join(f"{q} ({unit})" for unit, q in kinds.items())
        raise InputError(
            f"{where}: the channels read {read}; a campaign has readings of one kind: name in --columns those of one "
            "kind, and give --quantity"
        )
    if any(s not in (1, -1) for s in signs):
        raise InputError(f"{option['where']}: sign must be 1 or -1 for each channel")
    rows: list[Array] = []
    sensitivities = option.get("sensitivity", [None] * count)
    if len(sensitivities) < count:
        raise InputError(f"{option['where']}: 'sensitivity' has {len(sensitivities)} entries for {count} channels")
    columns = zip(channels, units, signs, radii, offsets, sensitivities, strict=False)
    for y, unit, sign, r, offset, sensitivity in columns:
        centred = sign * (y - _offset(y, offset, option["where"]))
        factor, sensed = 1.0, str(unit)
        if sensed in _VOLTAGE:
            factor, sensed = _sensed(sensed, sensitivity, option["where"])
        if "motion" in option and not rows:  # the reaction
            if sensed not in _INPUT[kind]:
                valid = ", ".join(_INPUT[kind])
                raise InputError(f"{where}: '{sensed}' is no unit of a reaction on the primary; valid units: {valid}")
            rows.append(factor * centred * _INPUT[kind][sensed])
        else:
            rows.append(convert(factor * centred, sensed, kind, quantity, r, where, bool(option.get("sideways"))))
    return np.stack(rows)


def _sensed(unit: str, sensitivity: str | None, where: str) -> tuple[float, str]:
    """What one V or mV is, and in which unit, by a sensitivity such as '100 mV/g'."""
    if sensitivity is None:
        raise InputError(f"{where}: '{unit}' is a voltage; give the sensitivity of each sensor, e.g. '100 mV/g'")
    found = re.fullmatch(r"\s*([\d.]+(?:[eE][-+]?\d+)?)\s*(m?V)\s*/\s*\(?(.+?)\)?\s*", str(sensitivity))
    if found is None or not float(found[1]) > 0.0:
        raise InputError(f"{where}: sensitivity = '{sensitivity}' cannot be read; write it as '100 mV/g'")
    return _VOLTAGE[unit] / (float(found[1]) * _VOLTAGE[found[2]]), unit_of(found[3]) or found[3]


def _with_rest(option: Mapping[str, Any], before: Array, measurement: Measurement, where: str) -> Mapping[str, Any]:
    """The options with the mean of the readings `before` the release in place of an offset 'head'."""
    given = option.get("offset", "none")
    offsets = given if isinstance(given, list) else [given] * len(before)
    if "head" not in offsets:
        return option
    free = measurement.start == "free" and option.get("release") != "find"  # else it was at rest before it began
    if measurement.quantity == "displacement" or free:
        raise InputError(
            f"{where}: offset = 'head' takes what the sensor reads while the rig is held for 0; "
            + ("a record of start = 'free'" if free else "a displacement")
            + " does not begin at 0: use 'tail' or a number"
        )
    if before.shape[1] < _FEWEST_AT_REST:
        raise InputError(
            f"{where}: offset = 'head' wants at least {_FEWEST_AT_REST} readings before the release, the record has "
            f"{before.shape[1]}: use --release find, 'tail' or a number"
        )
    rest = [float(np.mean(y)) if x == "head" else x for x, y in zip(offsets, before, strict=False)]
    return {**option, "offset": rest}


def _swinging_tails(times: Array, channels: Array, option: Mapping[str, Any], where: str) -> list[str]:
    """Notes where the readings of an offset 'tail' hold too little of a swing for their mean to be the middle of it."""
    given = option.get("offset", "none")
    offsets = given if isinstance(given, list) else [given] * len(channels)
    out = []
    for offset, y in zip(offsets, channels, strict=False):
        t, part = times[_tail_of(y)], y[_tail_of(y)]
        periods = look.dominant_frequency(times, y) * float(np.ptp(t))
        if offset == "tail" and 0.0 < periods < _FEWEST_PERIODS and np.ptp(part) > _SWINGS * np.ptp(y):
            out.append(
                f"{where}: offset = 'tail' takes the middle of the end of the record, which still swings and holds "
                f"{periods:.1f} periods: that is not what the sensor reads at rest; give a longer record or the "
                "offset as a number, or leave it and set offset_std."
            )
    return out


def _tail_of(y: Array) -> slice:
    """The last quarter; if the rig still swings there, as much before it as holds two and a half swings."""
    tail = slice(-max(8, len(y) // 4), None)
    frequency = look.dominant_frequency(np.arange(len(y), dtype=float), y)
    if frequency == 0.0 or np.ptp(y[tail]) <= _SWINGS * np.ptp(y):
        return tail
    return slice(min(tail.start, -min(math.ceil((_FEWEST_PERIODS + 0.5) / frequency), 3 * len(y) // 4)), None)


def _offset(y: Array, offset: str | float, where: str) -> float:
    if offset == "none":
        return 0.0
    if offset in ("mean", "tail"):
        return _middle(y if offset == "mean" else y[_tail_of(y)])
    if isinstance(offset, str):
        raise InputError(f"{where}: offset = '{offset}' is none of 'none', 'mean', 'tail', 'head' or a number")
    return float(offset)


def _middle(y: Array) -> float:
    """Level about which readings lie or swing; (n,).

    Least squares of a constant beside a sinusoid whose amplitude and phase change as a parabola, under a Hann window.
    The window alone lets a swing that decays move the mean by a hundredth of it.
    """
    n, weight = len(y), np.hanning(len(y) + 2)[1:-1]
    frequency = look.dominant_frequency(np.arange(n, dtype=float), y)
    if frequency * n < _FEWEST_PERIODS:
        return float(np.average(y, weights=weight))
    u, turn = np.linspace(-1.0, 1.0, n), 2.0 * math.pi * frequency * np.arange(n)
    terms = np.stack([np.ones(n), *(u**k * wave for k in range(3) for wave in (np.cos(turn), np.sin(turn)))])
    root = np.sqrt(weight)
    found, *_ = np.linalg.lstsq((terms * root).T, root * y, rcond=None)
    return float(found[0])


def _window(
    times: Array, y: Array, option: Mapping[str, Any], measurement: Measurement, where: str
) -> tuple[NDArray[np.intp], float]:
    """Indices to keep, and the instant on the raw clock that becomes t = 0."""
    low, high = float(option.get("start", times[0])), float(option.get("end", times[-1]))
    inside = np.flatnonzero((times >= low - 1e-9) & (times <= high + 1e-9))
    if len(inside) < _FEWEST:
        raise InputError(
            f"{where}: only {len(inside)} readings between {low:g} and {high:g} s; the record runs from {times[0]:g} "
            f"to {times[-1]:g} s: correct start and end"
        )
    release, t, part = option.get("release", "start"), times[inside], y[inside]
    if release == "start":
        zero = float(t[0])
    elif release == "find":
        zero = look.find_release(t, part)
        if zero <= t[4] and _still(part):
            raise InputError(
                f"{where}: no release found: the record rests throughout, nothing in it exceeds the noise; check that "
                "the column is that of the sensor, and that the trial was recorded"
            )
        if zero <= t[4]:
            raise InputError(
                f"{where}: no release found: the record moves from its first reading on, so it starts in the middle; "
                "give release in seconds, 'first_peak' with start = 'free', or a record that begins earlier"
            )
        if measurement.quantity == "acceleration":  # it jumps: somewhere before the first reading that has moved
            zero = 0.5 * (zero + float(t[np.searchsorted(t, zero, side="right")]))
        else:  # it stays within the noise for some readings more; at a reading, a sample of doubt is left on each side
            zero = float(t[np.argmin(np.abs(t - look.carried_back(t, part, zero, measurement.quantity)))])
    elif release == "first_peak":
        peak = look.find_first_peak(t, part)
        zero = float(t[np.searchsorted(t, peak - 1e-9)]) if peak < t[-1] else float(t[0])
    elif isinstance(release, str):
        raise InputError(
            f"{option['where']}: release = '{release}' is none of 'start', 'find', 'first_peak' or a number"
        )
    else:
        zero = float(release)
        if zero < 2.0 * times[0] - times[-1]:
            raise InputError(
                f"{where}: release = {zero:g} s is longer before the first reading than the record lasts, which runs "
                f"from {times[0]:g} to {times[-1]:g} s; correct release"
            )
    before = float(option.get("before", 0.02 if measurement.start == "rest" else 0.0))
    keep = inside[t >= zero - before - 1e-9][:: option.get("every", 1)]
    if len(keep) < _FEWEST:
        raise InputError(
            f"{where}: only {len(keep)} readings are left of the record, which runs from {times[0]:g} to "
            f"{times[-1]:g} s; correct release, before or every"
        )
    return keep, zero


def _times_of(source: LoggerFile, option: Mapping[str, Any], where: str) -> Array:
    if "time" in option:
        column = source.index(option["time"], where)
        found = source.unit(column)
        unit = option.get("time_unit") or (found if found in _TIME else "s")
        if unit not in _TIME:
            raise InputError(f"{option['where']}: time_unit '{unit}' is none of {', '.join(_TIME)}")
        with np.errstate(over="ignore"):  # what is beyond all numbers counts as missing
            return np.asarray(source.table[:, column] * _TIME[unit], float)
    if not option.get("sample_rate", 0.0) > 0.0:
        raise InputError(
            f"{option['where']}: neither 'time' nor 'sample_rate' is given; one of them makes the clock (the file has "
            f"{source.described()})"
        )
    return np.arange(len(source.table)) / float(option["sample_rate"])


def _repeated(options: Sequence[Mapping[str, Any]]) -> list[str]:
    """Faults where two rows are one trial."""
    seen: dict[tuple[str, str, int], str] = {}
    faults = []
    for option in options:
        if "trial" not in option:
            continue
        key = (option["case"], option["configuration"], option["trial"])
        if key in seen:
            there = f"trial {key[2]} of {key[0]} {key[1]} is there already ({seen[key]})"
            faults.append(f"{option['where']}: {there}; give each trial of a case its own number")
        seen[key] = option["where"]
    return faults
