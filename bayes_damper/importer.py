"""From a pile of logger files (CSV, text, MATLAB) to a campaign folder.

What is done to the raw files stands in one table, `import.toml`, so that it can be repeated and checked: which columns,
which units, where the release lies, which stretches become trials. `import_records` carries it out and ends with
the same check as every command; `init_campaign` makes the table from options.

    name, description, source, caveats, [rig], [measurement]     as in campaign.toml
    [reader]                                                     the keys of READER below: defaults for all trials
    [[trials]]                                                   the keys of TRIAL, and any of READER
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import math
import re
import shutil
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper import campaign as campaigns
from bayes_damper import readings as look
from bayes_damper.campaign import Campaign, Constant, Measurement, Rig, Trial
from bayes_damper.errors import InputError
from bayes_damper.logger_files import LoggerFile, number_of, read_matlab, read_text, unit_of

Array = NDArray[np.float64]

READER: dict[str, tuple[tuple[type, ...], str]] = {
    "delimiter": ((str,), "mark between columns; 'auto' (default), ',', ';', 'tab' or 'space'"),
    "decimal": ((str,), "'.' or ',' (default: as the numbers are written)"),
    "skip_lines": ((int,), "lines before the header, or before the numbers where there is none (default: found)"),
    "header": ((bool,), "whether a line of column names precedes the numbers (default: found)"),
    "time": ((str, int), "column of the time, by name or number from 1; absent: sample_rate makes it"),
    "time_unit": ((str,), "s (default), ms, us, min"),
    "sample_rate": ((int, float), "Hz, nominal, where there is no time column"),
    "columns": ((list,), "columns of the channels, primary first, by name or number from 1"),
    "units": ((list,), "their units (default: as the file names them, else SI); mV or V with sensitivity"),
    "sensitivity": ((list,), "of sensors whose voltage was recorded, one per channel, e.g. '100 mV/g'"),
    "torque": ((str, int), "column of a measured torque (force) on the primary"),
    "torque_unit": ((str,), "N m (default), N mm, mN m; N, kN, mN"),
    "mounting_radius": ((int, float, list), "m, of tangential sensors on a torsional rig, one or per channel"),
    "sign": ((list,), "1 or -1 per channel"),
    "offset": ((str, int, float, list), "to take off: 'none' (default), 'mean', 'tail', or numbers in the raw unit"),
    "matlab_time": ((list,), "names of the time arrays in a .mat file, in order"),
    "matlab_data": ((list,), "names of the data arrays in a .mat file, channels along the shorter side"),
    "start": ((int, float), "s on the raw clock: cut what is earlier"),
    "end": ((int, float), "s on the raw clock: cut what is later"),
    "release": ((str, int, float), "t = 0: 'start' (default), 'find', 'first_peak', or s on the raw clock"),
    "before": ((int, float), "s kept before the release"),
    "every": ((int,), "keep one reading in so many"),
}
TRIAL: dict[str, tuple[tuple[type, ...], str]] = {
    "source": ((str, list), "raw file, or one for each channel, primary first"),
    "sha256": ((str, list), "its checksum (one for each file), compared where given"),
    "file": ((str,), "record to write, e.g. trials/a1.csv"),
    "case": ((str,), "label of the case"),
    "configuration": ((str,), "uncoupled or coupled"),
    "trial": ((int,), "number within case and configuration"),
    "k1t": ((int, float, str), "N m/rad (N/m), or 'estimate' from the strongest frequency"),
    "k1t_std": ((int, float), "its standard uncertainty"),
    "theta0": ((int, float), "deg (mm)"),
    "theta0_std": ((int, float), "deg (mm)"),
    "holdout": ((bool,), "true: only its own nuisances are estimated"),
}
INIT: dict[str, tuple[tuple[type, ...], str]] = {
    "pattern": (
        (str,),
        "what the files' names tell, e.g. 'case{case}_{configuration}_{trial}'; also {theta0} and {k1t}",
    ),
    "words": ((list,), "what the names call the configurations, e.g. free=uncoupled magnet=coupled"),
    "sheet": ((str,), "a CSV table of the trials: a column file or case, then any of the other keys as columns"),
    "files_per_trial": ((int,), "2 where each channel has a file of its own, the primary's first"),
}
"""Options of `init` alone: how trials differ from each other."""
_PATTERN = {
    "case": r".+?",
    "configuration": r"uncoupled|coupled",
    "trial": r"\d+",
    "theta0": r"[-+]?\d+(?:[.,]\d+)?",
    "k1t": r"\d+(?:[.,]\d+)?",
}
_LEAST: dict[str, float] = {"every": 1, "skip_lines": 0, "before": 0.0}
"""Smallest values of some keys."""
_NAMED = 12
"""Files that a sentence names one by one."""
_FEWEST = 10
"""Readings that a record must have."""
_LEAST_KNOWN = 0.5
"""Share of a file's lines that must hold readings."""
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
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
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
    priors = beside.read_bytes() if not isinstance(spec, Mapping) and beside.exists() else None
    return _write(table, name, Path(folder), Path(raw) if raw is not None else home, priors, overwrite)


def _write(
    table: Mapping[str, Any], name: str, folder: Path, raw: Path, priors: bytes | None, overwrite: bool
) -> Path:  # fmt: skip
    """The campaign of an import table with its priors.toml, if it passes the check of every command."""
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder, or --overwrite to replace it")
    built = _build(table, name, raw)
    with tempfile.TemporaryDirectory() as scratch:
        draft = campaigns.write_campaign(Path(scratch) / "campaign", built)
        text = (draft / "campaign.toml").read_text(encoding="utf-8")
        note = "# Written by `bayes-damper init`; every key may be edited. SI units.\n"
        (draft / "campaign.toml").write_text(note + text, encoding="utf-8")
        if priors is not None:
            (draft / "priors.toml").write_bytes(priors)
        campaigns.load_campaign(draft)
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    return folder


def records_in(folder: str | Path) -> tuple[str, ...]:
    """The records that are there of those that a folder's trials.csv names, whatever else is wrong with it."""
    path = Path(folder) / "trials.csv"
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, ValueError, csv.Error):
        return ()
    named = dict.fromkeys((row.get("file") or "").strip() for row in rows)
    return tuple(name for name in named if name and (Path(folder) / name).is_file())


def left_over(folder: str | Path, before: Sequence[str]) -> list[str]:
    """A sentence on records of the former campaign of a folder (`records_in` it) that the new one does not name.

    They stay: only their owner knows whether they are to be had elsewhere.
    """
    now = {(Path(folder) / name).resolve() for name in records_in(folder)}
    stale = [name for name in before if (Path(folder) / name).is_file() and (Path(folder) / name).resolve() not in now]
    if not stale:
        return []
    some = ", ".join(stale[:_NAMED]) + (f" and {len(stale) - _NAMED} more" if len(stale) > _NAMED else "")
    them = "them" if len(stale) > 1 else "it"
    told = f"no command reads {them} now, remove {them} or keep {them} elsewhere"
    return [f"{some}: left over from the campaign that was here before; {told}"]


_NOTHING_RUBS = (
    "No magnet_pull was given: taken was that nothing rubs between the bodies (mu = 0 in priors.toml). If something "
    "does, give the force that presses the faces together; `diagnose --nominal linear` tells if friction is missing."
)
_NO_FRICTION = (
    b"# Written by `bayes-damper init`: no magnet_pull was given, so nothing rubs between the bodies.\nmu = 0.0\n"
)


def init_campaign(
    folder: str | Path, sources: Sequence[str | Path], overwrite: bool = False, **options: object
) -> Path:
    """A commented campaign from logger files, one trial a file; gives its folder, which also gets import.toml.

    sources : the logger's files, in the order of the trials; overwrite : replace the campaign that `folder` holds.
    options : any key of READER and TRIAL (for all files alike), of [rig] and of [measurement] of campaign.toml, and
    name, description, source_text (where the data come from). What is not given is assumed and told as a caveat: an
    inertia of 1 (all per unit inertia), k1t from the strongest frequency, no friction between the bodies (mu = 0 in the
    campaign's priors.toml) where coupled trials come without a magnet_pull.

    Raises
    ------
    InputError
        as `import_records`, and for options that do not exist.
    """
    folder = Path(folder)
    spec = _spec_from_options(folder.resolve().name, [Path(s).resolve() for s in sources], options)
    beside = folder / "priors.toml"
    found = beside.read_bytes() if beside.exists() else None
    priors = _NO_FRICTION if _NOTHING_RUBS in spec["caveats"] else None
    _write(spec, "import", folder, Path(), priors if found in (None, _NO_FRICTION) else found, overwrite)
    if priors is None and found == _NO_FRICTION:  # of an earlier call that knew no magnet
        beside.unlink()
    (folder / "import.toml").write_text(_spec_text(spec), encoding="utf-8")
    return folder


def convert(readings: Array, unit: str, kind: str, quantity: str, radius: float | None, where: str) -> Array:
    """Readings in SI units of the quantity: rad (m), rad/s (m/s), rad/s^2 (m/s^2).

    A tangential unit on a torsional rig (m/s^2, g, mm ...) is divided by the mounting radius, in m.

    Raises
    ------
    InputError
        for a unit that the quantity cannot have, or a tangential unit without a radius.
    """
    tangential = _TANGENTIAL[quantity]
    if kind == "translational":
        valid = tangential
    else:
        valid = {**_ANGULAR[quantity], **tangential}
    if unit not in valid:
        other = next((q for q in _TANGENTIAL if unit in _TANGENTIAL[q] or unit in _ANGULAR[q]), None)
        told = f", but of {other}, and a campaign holds readings of one quantity" if other else ""
        raise InputError(f"{where}: '{unit}' is no unit of {quantity}{told}; valid units: {', '.join(valid)}")
    if kind == "translational" or unit in _ANGULAR[quantity]:
        return readings * valid[unit]
    if radius is None:
        raise InputError(f"{where}: '{unit}' is tangential; give mounting_radius in metres")
    if not 0.0 < radius < 10.0:
        raise InputError(f"{where}: mounting_radius = {radius!r} m is not possible; give metres")
    return readings * (valid[unit] / radius)


# --- the table -----------------------------------------------------------------------------------------------------


def _spec_table(spec: str | Path | Mapping[str, Any]) -> tuple[Mapping[str, Any], str, Path]:
    if isinstance(spec, Mapping):
        return spec, "import", Path()
    path = Path(spec)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")), path.name, path.parent
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an import table") from error
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}; correct that line") from error


def _checked_keys(table: Mapping[str, Any], valid: Mapping[str, tuple[tuple[type, ...], str]], where: str) -> list[str]:
    faults = []
    for key, value in table.items():
        if key not in valid:
            near = difflib.get_close_matches(key, valid, 1, 0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"valid keys: {', '.join(valid)}"
            faults.append(f"{where}: unknown key '{key}'; {hint}")
        elif not isinstance(value, valid[key][0]) or (isinstance(value, bool) and bool not in valid[key][0]):
            types, meaning = valid[key]
            numbers = float in types and list not in types
            wanted = "a number with a decimal point" if numbers else "of another type"
            faults.append(f"{where}: {key} = {value!r}, which must be {wanted}: {meaning}")
        elif key == "decimal" and value not in (".", ","):
            faults.append(f"{where}: decimal = {value!r} is none of '.' and ','")
    return faults + [
        f"{where}: {key} = {value!r} is too small; give at least {least}"
        for key, least in _LEAST.items()
        if isinstance(value := table.get(key), int | float) and not value >= least
    ]


def _build(table: Mapping[str, Any], name: str, raw: Path) -> Campaign:
    """The campaign in memory, all conversions done."""
    faults: list[str] = []
    head_keys = {key: value for key, value in table.items() if key not in ("reader", "trials")}
    head = campaigns.head_from_table(head_keys, name, faults)
    reader, rows = table.get("reader", {}), table.get("trials", [])
    if not isinstance(reader, dict) or not isinstance(rows, list) or not all(isinstance(r, dict) for r in rows):
        raise InputError([*faults, f"{name}: write [reader] as one table and [[trials]] once for each trial"])
    faults += _checked_keys(reader, READER, f"{name} [reader]")
    if not rows:
        faults.append(f"{name}: no [[trials]]; write one for each record")
    options = []
    for i, row in enumerate(rows, start=1):
        where = f"{name} [[trials]] number {i}"
        found = _checked_keys(row, {**TRIAL, **READER}, where)
        found += [
            f"{where}: key '{key}' is missing" for key in ("source", "case", "configuration", "k1t") if key not in row
        ]
        faults += found
        options.append({**reader, **row, "where": where})
    if faults:
        raise InputError(_gathered(faults))
    trials: list[Trial] = []
    contradicted: list[str] = []
    files: dict[Path, LoggerFile] = {}
    faults += _repeated(options)
    counts: dict[tuple[str, str], int] = {}
    for option in options:
        group = (option["case"], option["configuration"])
        counts[group] = counts.get(group, 0) + 1
        option.setdefault("trial", counts[group])
        option.setdefault("file", f"trials/{_slug(group[0])}_{group[1]}_{option['trial']}.csv")
        try:
            trials.append(_trial_from(option, head.rig, head.measurement, raw, files, contradicted))
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(_gathered(faults))
    trials = _with_estimates(trials, head.rig)
    notes = [note for source in files.values() for note in source.notes if note not in head.caveats]
    notes = _gathered([*notes, *contradicted]) + _resting(trials, options) + _idle(trials)
    caveats = (*head.caveats, *notes)
    return Campaign(head.name, head.rig, head.measurement, tuple(trials), head.description, head.source, caveats)


_REST = 0.05  # share of a record; one that rests for longer began before the release


def _resting(trials: Sequence[Trial], options: Sequence[Mapping[str, Any]]) -> list[str]:
    """A hint where records taken from their first reading on begin at rest."""
    found = []
    for trial, option in zip(trials, options, strict=True):
        t, y = np.asarray(trial.times), np.asarray(trial.channels[0])
        if option.get("release", "start") == "start" and len(t) > 20:
            rest = look.find_release(t, y) - float(t[0])
            if rest > _REST * float(t[-1] - t[0]):
                found.append((str(trial.file), rest))
    if not found:
        return []
    name, rest = found[0]
    more = "" if len(found) == 1 else f" (and {len(found) - 1} more)"
    return [f"{name}{more} rests for its first {rest:.2g} s: with --release find, t = 0 is the release."]


def _idle(trials: Sequence[Trial]) -> list[str]:
    """A hint where the secondary of a coupled trial never moves, as it does where nothing couples it."""
    found = []
    for trial in trials:
        if trial.configuration == "coupled":
            primary, secondary = (np.asarray(y) for y in trial.channels)
            if not _still(primary) and _still(secondary):
                found.append(str(trial.file))
    return [_IDLE.format(_files(found))] if found else []


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
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text) or "case"


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
    contradicted: list[str],
) -> Trial:  # fmt: skip
    """One trial in SI units; adds to `contradicted` what its file says otherwise than the options."""
    source, where, option = _source_of(option, raw, files)
    times = _times_of(source, option, where)
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
    n_channels = 2 if coupled else 1
    places = [source.index(c, where) for c in wanted[:n_channels]]
    channels = source.table[:, places].T
    contradicted += _other_units(source, places, option.get("units", []), where)
    option = {"units": _told_units(source, places, rig.kind, measurement.quantity), **option}
    torque = source.table[:, source.index(option["torque"], where)] if "torque" in option else None
    known = np.isfinite(times) & np.isfinite(channels).all(axis=0)
    if np.mean(known) < _LEAST_KNOWN:
        missing = 100.0 * (1.0 - np.mean(known))
        raise InputError(
            f"{where}: {missing:.0f} % of the readings in the chosen columns are missing; choose other columns, or "
            "export the file again"
        )
    # A line without a reading becomes a gap of the record, which every command allows for.
    times, channels = times[known], channels[:, known]
    torque = None if torque is None else torque[known]
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        raise InputError(
            f"{where}: the time does not increase after {times[back[0]]:.9g} s; sort the rows, or give sample_rate"
        )
    keep, zero = _window(times, channels[0], option, measurement, where)
    times, channels = np.round(times[keep] - zero, 9), channels[:, keep]
    torque = torque[keep] if torque is not None else None
    channels = _in_si(channels, option, rig.kind, measurement.quantity, where)
    if torque is not None:
        unit = option.get("torque_unit", next(iter(_INPUT[rig.kind])))
        if unit not in _INPUT[rig.kind]:
            raise InputError(f"{option['where']}: torque_unit '{unit}' is none of {', '.join(_INPUT[rig.kind])}")
        torque = torque * _INPUT[rig.kind][unit]
    return Trial(
        option["file"],
        option["case"],
        option["configuration"],
        option["trial"],
        _stiffness(option),
        _release_angle(option, rig.kind, measurement.start),
        times,
        channels,
        torque,
        option.get("holdout", False),
    )


def _source_of(
    option: Mapping[str, Any], raw: Path, files: dict[Path, LoggerFile]
) -> tuple[LoggerFile, str, Mapping[str, Any]]:
    """The file of a trial, its name, and the option; files of one channel each are put side by side."""

    def read(source: str, sha256: str | None) -> LoggerFile:
        path = raw / source
        if path not in files:
            files[path] = _read_raw(path, {**option, "sha256": sha256})
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
    clocks = [_times_of(part, option, Path(s).name) for part, s in zip(parts, sources, strict=True)]
    places = [p.index(c, Path(s).name) for p, c, s in zip(parts, columns, sources, strict=True)]
    step = float(np.median(np.diff(clocks[0])))
    if any(len(c) != len(clocks[0]) or np.max(np.abs(c - clocks[0])) > 0.5 * step for c in clocks):
        raise InputError(
            f"{where}: the channels were not read at the same times; export them with one clock, or in one file"
        )
    table = np.column_stack([clocks[0], *(p.table[:, i] for p, i in zip(parts, places, strict=True))])
    units = ("s", *(p.unit(i) or "" for p, i in zip(parts, places, strict=True)))
    notes = tuple(note for p in parts for note in p.notes)
    both = LoggerFile(("time", *(f"channel {k + 1}" for k in range(len(parts)))), table, units, notes)
    plain = {k: v for k, v in option.items() if k not in ("time_unit", "sample_rate")}
    return both, where, {**plain, "time": 1, "columns": [k + 2 for k in range(len(parts))]}


def _told_units(source: LoggerFile, places: Sequence[int], kind: str, quantity: str) -> list[str]:
    """Units that the file gives for its channels; those of SI where it gives none."""
    default = next(iter({"torsional": _ANGULAR, "translational": _TANGENTIAL}[kind][quantity]))
    return [source.unit(i) or default for i in places]


def _other_units(source: LoggerFile, places: Sequence[int], given: Sequence[str], where: str) -> list[str]:
    """Notes where a file names another unit for a channel than `units` does."""
    return [
        f"{where}: the file gives {_column(source, place)} in {told}, 'units' in {unit}; {unit} was taken."
        for place, unit in zip(places, given, strict=False)
        if (told := source.unit(place)) is not None and told != unit
    ]


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
    std = float(option.get("theta0_std", max(0.1, 0.02 * abs(theta0))))
    return Constant(theta0 * unit, std * unit)


def _in_si(channels: Array, option: Mapping[str, Any], kind: str, quantity: str, where: str) -> Array:
    """Offset, sign and unit of each channel; (n_channels, n)."""
    count = len(channels)
    default = {"torsional": _ANGULAR, "translational": _TANGENTIAL}[kind][quantity]
    units = option.get("units", [next(iter(default))] * count)
    signs, radius = option.get("sign", [1] * count), option.get("mounting_radius")
    radii = radius if isinstance(radius, list) else [radius] * count
    offsets = option.get("offset", "none")
    offsets = offsets if isinstance(offsets, list) else [offsets] * count
    for key, values in (("units", units), ("sign", signs), ("mounting_radius", radii), ("offset", offsets)):
        if len(values) < count:
            raise InputError(
                f"{option['where']}: '{key}' has {len(values)} entries for {count} channels; give one for each"
            )
    if any(s not in (1, -1) for s in signs):
        raise InputError(f"{option['where']}: sign must be 1 or -1 for each channel")
    rows = []
    sensitivities = option.get("sensitivity", [None] * count)
    if len(sensitivities) < count:
        raise InputError(f"{option['where']}: 'sensitivity' has {len(sensitivities)} entries for {count} channels")
    columns = zip(channels, units, signs, radii, offsets, sensitivities, strict=False)
    for y, unit, sign, r, offset, sensitivity in columns:
        centred = sign * (y - _offset(y, offset, option["where"]))
        if str(unit) in _VOLTAGE:
            factor, sensed = _sensed(str(unit), sensitivity, option["where"])
            rows.append(convert(factor * centred, sensed, kind, quantity, r, where))
        else:
            rows.append(convert(centred, str(unit), kind, quantity, r, where))
    return np.stack(rows)


def _sensed(unit: str, sensitivity: str | None, where: str) -> tuple[float, str]:
    """What one V or mV is, and in which unit, by a sensitivity such as '100 mV/g'."""
    if sensitivity is None:
        raise InputError(f"{where}: '{unit}' is a voltage; give the sensitivity of each sensor, e.g. '100 mV/g'")
    found = re.fullmatch(r"\s*([\d.]+(?:[eE][-+]?\d+)?)\s*(m?V)\s*/\s*\(?(.+?)\)?\s*", str(sensitivity))
    if found is None or not float(found[1]) > 0.0:
        raise InputError(f"{where}: sensitivity = '{sensitivity}' cannot be read; write it as '100 mV/g'")
    return _VOLTAGE[unit] / (float(found[1]) * _VOLTAGE[found[2]]), unit_of(found[3]) or found[3]


def _offset(y: Array, offset: str | float, where: str) -> float:
    if offset == "none":
        return 0.0
    if offset in ("mean", "tail"):
        part = y if offset == "mean" else y[-max(8, len(y) // 4) :]
        return float(np.average(part, weights=np.hanning(len(part) + 2)[1:-1]))
    if isinstance(offset, str):
        raise InputError(f"{where}: offset = '{offset}' is none of 'none', 'mean', 'tail' or a number")
    return float(offset)


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
    before = float(option.get("before", 0.02 if measurement.start == "rest" else 0.0))
    keep = inside[t >= zero - before - 1e-9][:: option.get("every", 1)]
    if len(keep) < _FEWEST:
        raise InputError(
            f"{where}: only {len(keep)} readings are left of the record, which runs from {times[0]:g} to "
            f"{times[-1]:g} s; correct release, before or every"
        )
    return keep, zero


def columns_of(path: str | Path) -> str:
    """A sentence that numbers the columns of a logger's file, for whoever has to name them.

    Raises
    ------
    InputError
        if it cannot be read.
    """
    source = _read_raw(Path(path), {})
    told = [f"{i} {name}".strip() for i, name in enumerate(source.names or ("",) * source.table.shape[1], start=1)]
    return f"{Path(path).name} has the columns: {', '.join(told)}"


# --- raw files -----------------------------------------------------------------------------------------------------


def _read_raw(path: Path, option: Mapping[str, Any]) -> LoggerFile:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); say where the raw files are") from error
    expected = option.get("sha256")
    found = hashlib.sha256(raw).hexdigest()
    if expected and found != expected.lower():
        raise InputError(
            f"{path.name}: sha256 is {found[:16]}..., expected {expected[:16]}...: this is not the file that was "
            "described; get that version, or remove sha256 if the change is meant"
        )
    if not raw.strip():
        raise InputError(f"{path.name}: the file is empty; export it again")
    return (read_matlab if path.suffix.lower() == ".mat" else read_text)(raw, path.name, option)


def _times_of(source: LoggerFile, option: Mapping[str, Any], where: str) -> Array:
    if "time" in option:
        column = source.index(option["time"], where)
        found = source.unit(column)
        unit = option.get("time_unit") or (found if found in _TIME else "s")
        if unit not in _TIME:
            raise InputError(f"{option['where']}: time_unit '{unit}' is none of {', '.join(_TIME)}")
        return source.table[:, column] * _TIME[unit]
    if not option.get("sample_rate", 0.0) > 0.0:
        raise InputError(
            f"{option['where']}: neither 'time' nor 'sample_rate' is given; one of them makes the clock (the file has "
            f"{source.described()})"
        )
    return np.arange(len(source.table)) / float(option["sample_rate"])


# --- the table from options ----------------------------------------------------------------------------------------

_RIG = tuple(Rig.__dataclass_fields__)
MEASUREMENT = ("quantity", "noise_std", "sensor_range", "sensor_bandwidth", "offset_std", "scale_std", "lag_std")


def _spec_from_options(name: str, sources: Sequence[Path], options: Mapping[str, object]) -> dict[str, Any]:
    valid = (*READER, *TRIAL, *_RIG, *MEASUREMENT, *INIT, "name", "description", "source_text", "free_start")
    faults = [
        f"option '{key}' does not exist; " + (f"did you mean '{near[0]}'?" if near else f"options: {', '.join(valid)}")
        for key in options
        if key not in valid
        for near in [difflib.get_close_matches(key, valid, 1, 0.5)]
    ]
    rows = _sheet_rows(options.get("sheet"), faults)
    folder = Path(str(options["sheet"])).resolve().parent if rows else Path()
    if not sources:
        sources = [folder / str(row["file"]) for row in rows if "file" in row]
    faults += [f"{path}: there is no such file; correct the name or --raw" for path in sources if not path.is_file()]
    if not sources:
        faults.append("no logger files were given; name at least one, or a --sheet with a column 'file'")
    if faults:
        raise InputError(faults)
    given = {key: value for key, value in options.items() if value is not None}
    several = given.pop("files_per_trial", 1)
    if not isinstance(several, int) or several not in (1, 2) or len(sources) % several:
        raise InputError(
            f"files_per_trial = {several} for {len(sources)} files: give 2 where each channel has a file of its own, "
            "and the files in order, the primary before the secondary"
        )
    words = _words_of(given.pop("words", []))
    groups = [list(sources[i : i + several]) for i in range(0, len(sources), several)]
    caveats = []
    if "primary_inertia" not in given:
        caveats.append("The inertia was not given: everything is per unit inertia (primary_inertia = 1).")
    pattern = given.get("pattern")
    told = "configuration" in given or "{configuration}" in str(pattern) or any("configuration" in row for row in rows)
    own: dict[Path, dict[str, Any]] = {}
    if "columns" not in given and several == 1 and sources[0].is_file():
        own = _guessed_all([s for s in sources if s.is_file()], given, caveats, told)
        given |= own.pop(Path(), {})
    elif not told and several == 1 and isinstance(named := given.get("columns"), list) and len(named) == 2:
        own = _configurations([s for s in sources if s.is_file()], given, caveats)
    if "columns" in given and several == 1 and not {"time", "sample_rate"} & given.keys():
        given |= _guessed_time(sources, given, caveats)
    columns = given.get("columns", [])
    coupled = isinstance(columns, list) and len(columns) > 1
    common: dict[str, Any] = {"case": "A", "configuration": "coupled" if coupled else "uncoupled", "k1t": "estimate"}
    common |= {k: given[k] for k in TRIAL if k in given and k not in ("source", "trial", "file", "sha256")}
    trials = [_trial_row(group, common | own.get(group[0], {}), pattern, rows, words) for group in groups]
    if "case" not in given and "{case}" not in str(pattern) and not any("case" in row for row in rows):
        _name_cases(trials, str(pattern))
    rubbing = {"magnet_pull", "magnet_radius"} & given.keys()
    if not rubbing and any(trial["configuration"] == "coupled" for trial in trials):
        caveats.append(_NOTHING_RUBS)
    if any(trial["k1t"] == "estimate" for trial in trials):
        caveats.append("k1t was not given: it was estimated from the strongest frequency, uncertain by 20 %.")
    known = all("theta0" in trial for trial in trials)
    start = "rest" if known and not given.get("free_start") else "free"
    if start == "rest" and not all("theta0_std" in trial for trial in trials):
        caveats.append(_ANGLE_ASSUMED)
    spec: dict[str, Any] = {"name": given.get("name", name), "description": given.get("description", "")}
    spec["source"] = given.get("source_text", "")
    spec["caveats"] = caveats
    spec["rig"] = {"primary_inertia": 1.0, **{k: given[k] for k in _RIG if k in given}}
    spec["measurement"] = {"start": start, **{k: given[k] for k in MEASUREMENT if k in given}}
    if "sample_rate" in given:
        spec["measurement"]["sample_rate"] = given["sample_rate"]
    spec["reader"] = {k: given[k] for k in READER if k in given}
    spec["trials"] = trials
    return spec


def _trial_row(
    files: Sequence[Path], common: Mapping[str, Any], pattern: object, rows: Sequence[Mapping[str, Any]],
    words: Mapping[str, str],
) -> dict[str, Any]:  # fmt: skip
    """One [[trials]]: what holds for all, over it what the file's name tells, over it what the sheet tells."""
    sums = [_sha256(path) for path in files if path.is_file()]
    single = len(files) == 1
    row: dict[str, Any] = {"source": str(files[0]) if single else [str(path) for path in files]}
    if len(sums) == len(files):
        row["sha256"] = sums[0] if single else sums
    row |= common
    if pattern is not None:
        row |= _named_in(files[0], str(pattern), words)
    for entry in rows:
        keys = [key for key in ("file", "case", "configuration") if key in entry]
        own = {"file": None, **row}
        matches = [
            Path(str(entry[key])).name == files[0].name if key == "file" else str(entry[key]) == str(own[key])
            for key in keys
            if key == "file" or "file" not in entry
        ]
        if all(matches):
            row |= {key: value for key, value in entry.items() if key != "file"}
    row["case"] = str(row["case"])
    return row


def _name_cases(trials: Sequence[dict[str, Any]], pattern: str) -> None:
    """Cases after the springs or angles in the names, where these number the trials of each and nothing names cases."""
    keys = [key for key in ("k1t", "theta0") if "{" + key + "}" in pattern and "{trial}" in pattern]
    keys = [key for key in keys if len({trial[key] for trial in trials}) > 1]
    for trial in trials if keys else ():
        trial["case"] = ", ".join(f"{key} {trial[key]:g}" for key in keys)


def _words_of(given: object) -> dict[str, str]:
    """What the names call the configurations: word -> uncoupled or coupled."""
    pairs = [str(word).partition("=")[::2] for word in given] if isinstance(given, list | tuple) else []
    out = {word.lower(): configuration.lower() for word, configuration in pairs}
    if not isinstance(given, list | tuple) or not set(out.values()) <= {"uncoupled", "coupled"} or "" in out:
        raise InputError(
            f"--words {given}: write what the names say and what it means, as in free=uncoupled magnet=coupled"
        )
    return out


def _named_in(file: Path, pattern: str, words: Mapping[str, str]) -> dict[str, Any]:
    """What a file's name tells by a pattern such as 'case{case}_{configuration}_{trial}'."""
    fields = re.findall(r"\{(\w*)\}", pattern)
    wrong = [f for f in fields if f not in _PATTERN]
    if wrong or not fields or len(set(fields)) < len(fields):
        raise InputError(
            f"--pattern '{pattern}': write each of {', '.join('{' + f + '}' for f in _PATTERN)} at most once, as in "
            "'case{case}_{configuration}_{trial}'"
        )
    parts = re.split(r"\{\w*\}", pattern)

    def read(forms: Mapping[str, str]) -> re.Match[str] | None:
        expression = re.escape(parts[0])
        for field, part in zip(fields, parts[1:], strict=True):
            expression += f"(?P<{field}>{forms[field]})" + re.escape(part)
        whole = (re.fullmatch(expression, name, re.IGNORECASE) for name in (file.stem, file.name))
        return next((match for match in whole if match), None)

    known = "|".join([_PATTERN["configuration"], *map(re.escape, words)])
    found = read(_PATTERN | {"configuration": known})
    if found is None:
        other = read(_PATTERN | {"configuration": r"[^\W_]+"}) if "configuration" in fields else None
        if other is not None:
            word = other["configuration"]
            raise InputError(
                f"{file.name}: '{word}' stands where --pattern expects 'uncoupled' or 'coupled'; say what it means, "
                f"e.g. --words {word}=uncoupled, with every word that the names use"
            )
        raise InputError(
            f"{file.name}: the name does not follow --pattern '{pattern}'; correct the pattern or the name"
        )
    out: dict[str, Any] = {}
    for field, text in found.groupdict().items():
        if field in ("case", "configuration"):
            out[field] = words.get(text.lower(), text.lower()) if field == "configuration" else text
        elif field == "trial":
            out[field] = int(text)
        else:
            out[field] = float(text.replace(",", "."))
    return out


def _sheet_rows(sheet: object, faults: list[str]) -> list[dict[str, Any]]:
    """Rows of a table that tells trials apart: a column 'file' or 'case' (or both), and any key of TRIAL and READER."""
    if sheet is None:
        return []
    path = Path(str(sheet))
    try:
        lines = [x for x in path.read_text(encoding="utf-8-sig").splitlines() if x.strip()]
    except (OSError, UnicodeDecodeError) as error:
        faults.append(f"{path}: cannot be read ({error}); give a table of the trials as CSV")
        return []
    mark = next((m for m in (";", "\t") if lines and m in lines[0]), ",")
    head, *body = [[c.strip() for c in row] for row in csv.reader(lines, delimiter=mark)] or [[]]
    single = {k: v for k, v in {**TRIAL, **READER}.items() if (list,) != v[0]}
    wrong = [key for key in head if key not in ("file", *single)]
    if wrong or not body or not ({"file", "case", "configuration"} & set(head)):
        known = f"columns: file, {', '.join(single)}"
        faults.append(f"{path}: " + (f"unknown column '{wrong[0]}'; {known}" if wrong else f"give rows and {known}"))
        return []
    rows = []
    for i, cells in enumerate(body, start=2):
        row: dict[str, Any] = {}
        for key, cell in zip(head, cells, strict=False):
            if not cell:
                continue
            row[key] = cell
            types = single[key][0] if key in single else (str,)
            try:
                if bool in types:
                    row[key] = {"true": True, "false": False}[cell.lower()]
                elif str not in types or key == "k1t":
                    number = number_of(cell, mark != ",")
                    row[key] = int(number) if float not in types else number
            except (ValueError, KeyError):
                if cell != "estimate":
                    wanted = "true or false" if bool in types else "a number"
                    faults.append(f"{path}, line {i}, column '{key}': '{cell}' is not {wanted}")
        rows.append(row)
    return rows


def _guessed_all(
    paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str], told: bool
) -> dict[Path, dict[str, Any]]:
    """Columns where none were named and only one choice is left, for all files under `Path()`, else for each file.

    told : whether something else says which trials are coupled. Where nothing does and some files hold one channel
    and others two, the former are uncoupled.
    """
    found = {path: _guessed(path, given) for path in paths}
    first = found[paths[0]]
    if all(other == first for other in found.values()):
        columns, words = first
        caveats.append(f"The columns were not named; taken: {words}.")
        if len(columns["columns"]) == 2 and not told:
            caveats.append(_ALL_COUPLED)
        return {Path(): columns}
    counts = {len(columns["columns"]) for columns, _ in found.values()}
    for words in dict.fromkeys(words for _, words in found.values()):
        where = [path.name for path, (_, other) in found.items() if other == words]
        caveats.append(f"The columns were not named; taken from {_files(where)}: {words}.")
    if told or len(counts) == 1:
        return {path: dict(columns) for path, (columns, _) in found.items()}
    single = [path.name for path, (columns, _) in found.items() if len(columns["columns"]) == 1]
    caveats.append(_SINGLE.format(_files(single)))
    return {
        path: {**columns, "configuration": "coupled" if len(columns["columns"]) == 2 else "uncoupled"}
        for path, (columns, _) in found.items()
    }


def _guessed_time(paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str]) -> dict[str, Any]:
    """The column of the time where none was named and all files have the same one, beside the named channels."""
    found, told = set(), ""
    for path in paths:
        source = _read_raw(path, given)
        time = source.time_column()
        try:
            taken = [source.index(c, path.name) for c in given["columns"]]
        except InputError:
            taken = []  # a channel that this file lacks: the reader says so, or the trial is uncoupled
        found.add(None if time is None or time in taken else time + 1)
        told = told or ("" if time is None else _column(source, time))
    if len(found) != 1 or None in found:
        return {}
    caveats.append(f"The time was not named; taken: {told}.")
    return {"time": found.pop()}


_ANGLE_ASSUMED = (
    "How sure the release angle is was not given: 0.1 deg (mm), or 2 % of it where that is more, was assumed "
    "(theta0_std_deg, theta0_std_mm in trials.csv)."
)
_SINGLE = "One channel only, so taken as uncoupled: {}. Say otherwise with --pattern or --sheet."
_IDLE = (
    "{}: the secondary rests throughout. If nothing coupled it to the primary, these trials are uncoupled: say so with "
    "--configuration, --pattern or --sheet."
)
_ALL_COUPLED = (
    "Every file has two channels, so all trials were taken as coupled; say otherwise with --configuration, --pattern "
    "or --sheet."
)


def _files(names: Sequence[str]) -> str:
    """File names for a sentence, a few at most."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} other files"


def _configurations(paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str]) -> dict[Path, dict[str, Any]]:
    """Files that lack the second of two named columns hold uncoupled trials."""
    out: dict[Path, dict[str, Any]] = {}
    for path in paths:
        source = _read_raw(path, given)
        try:
            source.index(given["columns"][1], path.name)
        except InputError:
            out[path] = {"configuration": "uncoupled"}
    if len(out) == len(paths):
        return {}  # then the name of the column is wrong, which the reader says
    caveats.append(_SINGLE.format(_files([path.name for path in out])) if out else _ALL_COUPLED)
    return out


def _guessed(path: Path, given: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Columns of the time and the channels where only one choice is left, and the words for them.

    A column that never changes (a temperature, a counter that stands) is no channel where others are left.
    """
    source = _read_raw(path, given)
    time = None if "sample_rate" in given else source.time_column()
    if "time" in given:
        time = source.index(given["time"], path.name)
    readings = [
        i for i in range(source.table.shape[1]) if i != time and np.mean(np.isfinite(source.table[:, i])) > _LEAST_KNOWN
    ]
    moving = [i for i in readings if np.nanmax(source.table[:, i]) > np.nanmin(source.table[:, i])]
    readings = moving or readings
    if len(readings) not in (1, 2) or (time is None and "sample_rate" not in given):
        raise InputError(
            f"{path.name}: has {source.described()}; name the channels with --columns, the primary first, and the time "
            "with --time (or give --sample-rate)"
        )
    found: dict[str, Any] = {"columns": [i + 1 for i in readings]}
    told = [f"{_column(source, i)} for the {who}" for i, who in zip(readings, ("primary", "secondary"), strict=False)]
    if time is not None:
        found["time"] = time + 1
        told.append(f"{_column(source, time)} for the time")
    return found, ", ".join(told)


def _column(source: LoggerFile, i: int) -> str:
    """A column for a sentence: its number, and its name where it has one."""
    return f"column {i + 1}" + (f" ({source.names[i]})" if source.names else "")


def _repeated(options: Sequence[Mapping[str, Any]]) -> list[str]:
    """Faults where two rows are one trial."""
    seen: dict[tuple[str, str, int], str] = {}
    faults = []
    for option in options:
        if "trial" not in option:
            continue
        key = (option["case"], option["configuration"], option["trial"])
        if key in seen:
            faults.append(f"{option['where']}: trial {key[2]} of {key[0]} {key[1]} is there already ({seen[key]})")
        seen[key] = option["where"]
    return faults


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _spec_text(spec: Mapping[str, Any]) -> str:
    """An import table as TOML, each reader key with what it means."""
    lines = ["# How this campaign was made from the logger's files; `bayes-damper init` repeats it."]
    lines += [f"{key} = {_toml(value)}" for key, value in spec.items() if not _is_table(value)]
    for key in ("rig", "measurement", "reader"):
        lines += ["", f"[{key}]"]
        lines += [
            f"{k} = {_toml(v)}" + (f"  # {READER[k][1]}" if key == "reader" else "") for k, v in spec[key].items()
        ]
    for trial in spec["trials"]:
        lines += ["", "[[trials]]", *(f"{k} = {_toml(v)}" for k, v in trial.items())]
    return "\n".join(lines) + "\n"


def _is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return campaigns.quoted(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    return repr(value)
