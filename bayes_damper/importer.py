"""From a pile of logger files (CSV, text, MATLAB) to a campaign folder.

What is done to the raw files stands in one table, `import.toml`, so that it can be repeated and checked: which columns,
which units, where the release lies, which stretches become trials. `import_records` carries it out and ends with
the same check as every command; `init_campaign` makes the table from options.

    name, description, source, caveats, [rig], [measurement]     as in campaign.toml
    [reader]                                                     the keys of READER below: defaults for all trials
    [[trials]]                                                   the keys of TRIAL, and any of READER
"""

from __future__ import annotations

import difflib
import hashlib
import io
import math
import re
import shutil
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper import campaign as campaigns
from bayes_damper import readings as look
from bayes_damper.campaign import Campaign, Constant, Measurement, Rig, Trial
from bayes_damper.errors import InputError

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
    "units": ((list,), "their units"),
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
    "source": ((str,), "raw file"),
    "sha256": ((str,), "its checksum, compared where given"),
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
_LEAST_KNOWN = 0.5
"""Share of a file's lines that must hold readings."""
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
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_INPUT = {
    "torsional": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "translational": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
}


@dataclass(frozen=True)
class _Raw:
    """Columns of one raw file before any conversion; names empty where the file has none; table : (n, n_columns)."""

    names: tuple[str, ...]
    table: Array


def import_records(
    spec: str | Path | Mapping[str, Any], folder: str | Path, raw: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Writes the campaign that an import table describes; gives its folder.

    spec : path of an import.toml, or its content as a mapping; raw : folder of the raw files, by default that of the
    table. A priors.toml beside the table goes along. Nothing is written unless the result passes the check of
    every command.

    Raises
    ------
    InputError
        with one sentence for every fault of the table, of the raw files, or of the campaign that comes out.
    """
    folder = Path(folder)
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder")
    table, name, home = _spec_table(spec)
    built = _build(table, name, Path(raw) if raw is not None else home)
    with tempfile.TemporaryDirectory() as scratch:
        draft = campaigns.write_campaign(Path(scratch) / "campaign", built)
        text = (draft / "campaign.toml").read_text(encoding="utf-8")
        note = "# Written by `bayes-damper init`; every key may be edited. SI units.\n"
        (draft / "campaign.toml").write_text(note + text, encoding="utf-8")
        if not isinstance(spec, Mapping) and (home / "priors.toml").exists():
            shutil.copyfile(home / "priors.toml", draft / "priors.toml")
        campaigns.load_campaign(draft)
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    return folder


def init_campaign(
    folder: str | Path, sources: Sequence[str | Path], overwrite: bool = False, **options: object
) -> Path:
    """A commented campaign from logger files, one trial a file; gives its folder, which also gets import.toml.

    options : any key of READER and TRIAL (for all files alike), of [rig] and of [measurement] of campaign.toml, and
    name, description, source_text (where the data come from). What is not given is assumed and told as a caveat: an
    inertia of 1 (all per unit inertia), k1t from the strongest frequency.

    Raises
    ------
    InputError
        as `import_records`, and for options that do not exist.
    """
    folder = Path(folder)
    spec = _spec_from_options(folder.name, [Path(s).resolve() for s in sources], options)
    import_records(spec, folder, overwrite=overwrite)
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
        raise InputError(f"{where}: '{unit}' is no unit of {quantity}; valid units: {', '.join(valid)}")
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
            faults.append(f"{where}: {key} = {value!r} is of the wrong type; it is the {valid[key][1]}")
    return faults


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
        raise InputError(faults)
    trials: list[Trial] = []
    files: dict[Path, _Raw] = {}
    counts: dict[tuple[str, str], int] = {}
    for option in options:
        group = (option["case"], option["configuration"])
        counts[group] = counts.get(group, 0) + 1
        option.setdefault("trial", counts[group])
        option.setdefault("file", f"trials/{_slug(group[0])}_{group[1]}_{option['trial']}.csv")
        try:
            trials.append(_trial_from(option, head.rig, head.measurement, raw, files))
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    trials = _with_estimates(trials, head.rig)
    return Campaign(head.name, head.rig, head.measurement, tuple(trials), head.description, head.source, head.caveats)


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
    option: Mapping[str, Any], rig: Rig, measurement: Measurement, raw: Path, files: dict[Path, _Raw]
) -> Trial:
    path = raw / option["source"]
    if path not in files:
        files[path] = _read_raw(path, option)
    source = files[path]
    where = path.name
    times = _times_of(source, option, where)
    wanted = option.get("columns")
    coupled = option["configuration"] == "coupled"
    if not wanted:
        raise InputError(f"{option['where']}: 'columns' is missing; name the channels, the primary first")
    if len(wanted) < 1 + coupled:
        raise InputError(
            f"{option['where']}: a coupled trial needs two columns, primary and secondary; 'columns' has one"
        )
    n_channels = 2 if coupled else 1
    channels = np.stack([_column(source, c, where) for c in wanted[:n_channels]])
    torque = _column(source, option["torque"], where) if "torque" in option else None
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
    keep, zero = _window(times, channels[0], option, measurement.start, where)
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


def _stiffness(option: Mapping[str, Any]) -> Constant:
    k1t = option["k1t"]
    if k1t == "estimate":
        return Constant(0.0)
    if isinstance(k1t, str) or k1t <= 0.0:
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
    for y, unit, sign, r, offset in zip(channels, units, signs, radii, offsets, strict=False):
        centred = sign * (y - _offset(y, offset, option["where"]))
        rows.append(convert(centred, str(unit), kind, quantity, r, where))
    return np.stack(rows)


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
    times: Array, y: Array, option: Mapping[str, Any], start: str, where: str
) -> tuple[NDArray[np.intp], float]:
    """Indices to keep, and the instant on the raw clock that becomes t = 0."""
    low, high = float(option.get("start", times[0])), float(option.get("end", times[-1]))
    inside = np.flatnonzero((times >= low - 1e-9) & (times <= high + 1e-9))
    if len(inside) < 10:
        raise InputError(
            f"{where}: only {len(inside)} readings between {low:g} and {high:g} s; the record runs "
            f"from {times[0]:g} to "
            f"{times[-1]:g} s: correct start and end"
        )
    release, t, part = option.get("release", "start"), times[inside], y[inside]
    if release == "start":
        zero = float(t[0])
    elif release == "find":
        zero = look.find_release(t, part)
        if zero <= t[4]:
            raise InputError(
                f"{where}: no release found: the record moves from its first reading on, so it "
                f"starts in the middle; give "
                "release in seconds, 'first_peak' with start = 'free', or a record that begins earlier"
            )
    elif release == "first_peak":
        peak = look.find_first_peak(t, part)
        zero = float(t[np.searchsorted(t, peak - 1e-9)]) if peak < t[-1] else float(t[0])
    elif isinstance(release, str):
        raise InputError(
            f"{option['where']}: release = '{release}' is none of 'start', 'find', 'first_peak' or a number"
        )
    else:
        zero = float(release)
    before = float(option.get("before", 0.02 if start == "rest" else 0.0))
    keep = inside[t >= zero - before - 1e-9]
    return keep[:: option.get("every", 1)], zero


# --- raw files -----------------------------------------------------------------------------------------------------


def _read_raw(path: Path, option: Mapping[str, Any]) -> _Raw:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); say where the raw files are") from error
    expected = option.get("sha256")
    found = hashlib.sha256(raw).hexdigest()
    if expected and found != expected.lower():
        raise InputError(
            f"{path.name}: sha256 is {found[:16]}..., expected {expected[:16]}...: this is not the "
            f"file that was described; get that "
            "version, or remove sha256 if the change is meant"
        )
    if not raw.strip():
        raise InputError(f"{path.name}: the file is empty; export it again")
    if path.suffix.lower() == ".mat":
        return _read_matlab(raw, path.name, option)
    return _read_text(raw, path.name, option)


def _read_matlab(raw: bytes, name: str, option: Mapping[str, Any]) -> _Raw:
    """Time in column 1 where matlab_time is given, then the channels; cell arrays are joined piece by piece."""
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(raw))
    except Exception as error:
        raise InputError(f"{name}: not a MATLAB file that can be read ({error}); save it as version 5 or 7") from error
    parts = []
    for key in ("matlab_time", "matlab_data"):
        pieces = []
        for variable in option.get(key, []):
            if variable not in content:
                known = [k for k in content if not k.startswith("__")]
                raise InputError(f"{name}: no variable '{variable}'; it holds {', '.join(known)}: correct {key}")
            pieces += [_tall(piece) for piece in _pieces(content[variable])]
        if pieces:
            parts.append(np.concatenate(pieces))
    if not parts or any(len(p) != len(parts[0]) for p in parts):
        raise InputError(f"{name}: matlab_time and matlab_data must name arrays of equal length")
    return _Raw((), np.ascontiguousarray(np.concatenate(parts, axis=1), dtype=float))


def _pieces(variable: NDArray[Any]) -> list[NDArray[Any]]:
    return [np.asarray(p) for p in variable.ravel()] if variable.dtype == object else [variable]


def _tall(piece: NDArray[Any]) -> NDArray[Any]:
    return piece.T if piece.shape[0] < piece.shape[1] else piece


def _read_text(raw: bytes, name: str, option: Mapping[str, Any]) -> _Raw:
    lines = _decoded(raw).splitlines()[option.get("skip_lines", 0) :]
    lines = [line for line in lines if line.strip()]
    if len(lines) < 3:
        raise InputError(f"{name}: no readings after the first {option.get('skip_lines', 0)} lines; correct skip_lines")
    mark = _mark(lines, option)
    comma = option["decimal"] == "," if "decimal" in option else _has_decimal_commas(lines, mark)
    begin, named = _begin(lines, option, mark, comma)
    names: tuple[str, ...] = ()
    if named:
        names = tuple(cell.strip().strip('"') for cell in _split(lines[begin], mark))
    lines = lines[begin + bool(names) :]
    if comma and mark == ",":
        raise InputError(
            f"{name}: decimal commas and commas between columns cannot be told apart; export with semicolons"
        )
    first = 1 + option.get("skip_lines", 0) + begin + bool(names)
    rows = []
    for i, line in enumerate(lines):
        cells = _split(line, mark)
        try:
            rows.append([_number_of(c, comma) for c in cells])
        except ValueError:
            raise InputError(_bad_line(name, first + i, line, cells, bool(names))) from None
        if len(cells) != len(rows[0]) or (names and len(cells) != len(names)):
            expected = len(names) or len(rows[0])
            raise InputError(
                f"{name}, line {first + i}: {len(cells)} columns where {expected} are expected; "
                + (
                    "decimal commas? set decimal = ',' and delimiter"
                    if len(cells) > expected
                    else "the line is cut short"
                )
            )
    return _Raw(names, np.array(rows))


_MISSING = {"", "-", "--", "---", "na", "n/a", "nan", "null", "none"}
"""What loggers write where there is no reading."""


def _decoded(raw: bytes) -> str:
    """Text of a file in UTF-8, or else in the code page of Windows, whose names of columns may have umlauts."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def _number_of(cell: str, comma: bool) -> float:
    """A cell as a number, nan where the reading is missing; ValueError for other words."""
    cell = cell.strip().strip('"')
    if cell.lower() in _MISSING:
        return math.nan
    return float(cell.replace(",", ".") if comma else cell)


def _has_decimal_commas(lines: Sequence[str], mark: str) -> bool:
    """Whether the later half of the lines writes its numbers with decimal commas."""
    if mark == ",":
        return False
    cells = [c.strip() for line in lines[len(lines) // 2 :] for c in _split(line, mark)]
    return any("," in c for c in cells) and not any("." in c for c in cells)


def _begin(lines: Sequence[str], option: Mapping[str, Any], mark: str, comma: bool) -> tuple[int, bool]:
    """Which line holds the names of the columns, or the first numbers, and whether it holds names.

    Told by skip_lines and header where these are given; else the numbers begin with the first of five rows of numbers
    of one length, and the line before them holds names if it has as many cells and is no row of numbers itself.
    """
    if "skip_lines" in option:
        return 0, bool(option.get("header", True))

    def width(line: str) -> int:
        cells = _split(line, mark)
        try:
            known = [math.isfinite(_number_of(c, comma)) for c in cells]
        except ValueError:
            return 0
        return len(cells) if any(known) else 0

    widths = [width(line) for line in lines[:400]]
    starts = (i for i in range(len(widths)) if widths[i] and len(set(widths[i : i + 5])) == 1)
    first = next(starts, None)
    if first is None:
        return 0, bool(option.get("header", True))
    named = first > 0 and len(_split(lines[first - 1], mark)) == widths[first] and option.get("header", True)
    return (first - 1, True) if named else (first, False)


def _bad_line(name: str, line: int, text: str, cells: Sequence[str], named: bool) -> str:
    if any(re.fullmatch(r"\s*[-+]?\d+,\d+(e[-+]?\d+)?\s*", c, re.IGNORECASE) for c in cells):
        return f"{name}, line {line}: '{text.strip()[:40]}' has decimal commas; set decimal = ','"
    hint = (
        "set skip_lines to the number of lines before the column names" if named else "set skip_lines, or header = true"
    )
    return f"{name}, line {line}: '{text.strip()[:40]}' is not a row of numbers; {hint}, or remove the line"


def _mark(lines: Sequence[str], option: Mapping[str, Any]) -> str:
    given = option.get("delimiter", "auto")
    named = {"tab": "\t", "space": " "}
    if given != "auto":
        return str(named.get(given, given))
    sample = lines[max(min(2, len(lines) - 1), len(lines) // 2)]
    for mark in (";", "\t"):
        if mark in sample:
            return mark
    return "," if "," in sample and option.get("decimal", ".") != "," else " "


def _split(line: str, mark: str) -> list[str]:
    return line.split() if mark == " " else line.rstrip().split(mark)


def _column(source: _Raw, column: str | int, where: str) -> Array:
    """One column by name or by number from 1; (n,)."""
    width = source.table.shape[1]
    if isinstance(column, str):
        if column not in source.names:
            near = difflib.get_close_matches(column, source.names, 1, 0.4)
            hint = f"did you mean '{near[0]}'?" if near else "name or number the columns"
            known = ", ".join(source.names) or f"{width} columns without names"
            raise InputError(f"{where}: column '{column}' is missing, the file has {known}; {hint}")
        return source.table[:, source.names.index(column)]
    if not 1 <= column <= width:
        raise InputError(f"{where}: column {column} is missing, the file has {width}; count from 1")
    return source.table[:, column - 1]


def _unit_in_name(column: str | int) -> str | None:
    """The unit of time that a column's name gives in brackets, such as "Time [ms]"; None if it gives none."""
    found = re.search(r"[\[(]\s*([a-zµ]+)\s*[\])]", column) if isinstance(column, str) else None
    unit = found[1].replace("µ", "u") if found else None
    return unit if unit in _TIME else None


def _times_of(source: _Raw, option: Mapping[str, Any], where: str) -> Array:
    if "time" in option:
        unit = option.get("time_unit") or _unit_in_name(option["time"]) or "s"
        if unit not in _TIME:
            raise InputError(f"{option['where']}: time_unit '{unit}' is none of {', '.join(_TIME)}")
        return _column(source, option["time"], where) * _TIME[unit]
    if not option.get("sample_rate", 0.0) > 0.0:
        raise InputError(f"{option['where']}: neither 'time' nor 'sample_rate' is given; one of them makes the clock")
    return np.arange(len(source.table)) / float(option["sample_rate"])


# --- the table from options ----------------------------------------------------------------------------------------

_RIG = tuple(Rig.__dataclass_fields__)
_MEASUREMENT = ("quantity", "noise_std", "sensor_range", "sensor_bandwidth", "offset_std", "scale_std", "lag_std")


def _spec_from_options(name: str, sources: Sequence[Path], options: Mapping[str, object]) -> dict[str, Any]:
    valid = (*READER, *TRIAL, *_RIG, *_MEASUREMENT, "name", "description", "source_text", "free_start")
    faults = [
        f"option '{key}' does not exist; " + (f"did you mean '{near[0]}'?" if near else f"options: {', '.join(valid)}")
        for key in options
        if key not in valid
        for near in [difflib.get_close_matches(key, valid, 1, 0.5)]
    ]
    if not sources:
        faults.append("no logger files were given; name at least one")
    if faults:
        raise InputError(faults)
    given = {key: value for key, value in options.items() if value is not None}
    caveats = []
    if "primary_inertia" not in given:
        caveats.append("The inertia was not given: everything is per unit inertia (primary_inertia = 1).")
    if "k1t" not in given:
        caveats.append("k1t was not given: it was estimated from the strongest frequency, uncertain by 20 %.")
    columns = given.get("columns", [])
    coupled = isinstance(columns, list) and len(columns) > 1
    start = "rest" if "theta0" in given and not given.get("free_start") else "free"
    spec: dict[str, Any] = {"name": given.get("name", name), "description": given.get("description", "")}
    spec["source"] = given.get("source_text", "")
    spec["caveats"] = caveats
    spec["rig"] = {"primary_inertia": 1.0, **{k: given[k] for k in _RIG if k in given}}
    spec["measurement"] = {"start": start, **{k: given[k] for k in _MEASUREMENT if k in given}}
    if "sample_rate" in given:
        spec["measurement"]["sample_rate"] = given["sample_rate"]
    spec["reader"] = {k: given[k] for k in READER if k in given}
    common: dict[str, Any] = {"case": "A", "configuration": "coupled" if coupled else "uncoupled", "k1t": "estimate"}
    common |= {k: given[k] for k in TRIAL if k in given and k not in ("source", "trial", "file", "sha256")}
    spec["trials"] = [
        {"source": str(path), **({"sha256": _sha256(path)} if path.is_file() else {}), **common} for path in sources
    ]
    return spec


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
