"""The table of an import: its keys, and how `init` makes it from options and from what files are called and hold.

What is done to the raw files stands in `import.toml`: which columns, which units, where the release lies, which
stretches become trials. importer.py carries it out.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper import campaign as campaigns
from bayes_damper.campaign import Rig
from bayes_damper.campaign.logger_files import number_of, read_file
from bayes_damper.errors import InputError
from bayes_damper.inputs import LARGEST, collected, csv_rows, file_bytes, file_sha256, real, resolved, shown, text_of
from bayes_damper.rig.units import BODIES

READER: dict[str, tuple[tuple[type, ...], str]] = {
    "delimiter": ((str,), "column separator: 'auto' (default), ',', ';', 'tab' or 'space'"),
    "decimal": ((str,), "decimal mark, '.' or ',' (default: detected)"),
    "skip_lines": ((int,), "lines to skip before the column names, or before the numbers (default: detected)"),
    "header": ((bool,), "whether a line of column names precedes the numbers (default: detected)"),
    "time": ((str, int), "column of the time, by name or number from 1; without one, sample_rate gives the times"),
    "time_unit": ((str,), "unit of the time: s (default), ms, us, min"),
    "sample_rate": ((int, float), "sample rate, Hz, if there is no time column"),
    "clock": ((list,), "reading of each file's clock at one common instant, s, if each channel has its own file"),
    "columns": ((list,), "columns of the channels, body 1 (the primary) first, by name or number from 1"),
    "units": (
        (list,),
        "units of the channels, one or one each (default: as in the file, else SI); mV or V with sensitivity",
    ),
    "sensitivity": ((list,), "sensitivity if voltages were recorded, one per channel, e.g. '100 mV/g'"),
    "torque": ((str, int), "column of a measured torque (force) on the primary"),
    "torque2": ((str, int), "column of a measured torque (force) on the secondary"),
    "torque_unit": ((str,), "unit of the torque (force): N m (default), N mm, mN m; N, kN, mN"),
    "ground": ((str, int), "column of the measured motion of the ground"),
    "ground_unit": (
        (str,),
        "its unit: rad/s^2, deg/s^2 or rad, deg, ...; m/s^2, g, ... or m, mm, ... (default: as in the file)",
    ),
    "motion": (
        (str, int),
        "column of the motion imposed on the primary; the first of 'columns' is then the reaction, in N m (N)",
    ),
    "motion_unit": ((str,), "unit of 'motion', as for ground_unit"),
    "pivot": ((str, int), "column of the sideways acceleration of a pendulum's pivot"),
    "pivot_unit": ((str,), "unit of the pivot's acceleration: m/s^2 (default), g, ..."),
    "mounting_radius": ((int, float, list), "distance of tangential sensors from the axis, m, one or per channel"),
    "sideways": (
        (bool,),
        "lengths are sideways positions, as in a video: the angle is asin(x / mounting radius), from where it hangs",
    ),
    "sign": ((list,), "1 or -1 per channel: -1 for a sensor mounted the other way round"),
    "offset": (
        (str, int, float, list),
        "offset to subtract: 'none' (default), 'mean', 'tail' (end), 'head' (before the release), or raw numbers",
    ),
    "matlab_time": ((list,), "names of the time arrays in a .mat file, in order; a field as 'name.field'"),
    "matlab_data": (
        (list,),
        "names of the data arrays in a .mat file, channels along the shorter side or each in an array of its own",
    ),
    "group": ((str,), "prefix of the channel names to take, if a TDMS, MDF4, HDF5 or UFF file has several clocks"),
    "wrap": ((list,), "value at which a raw channel wraps around, 0 for none: 360 (deg), 65536 (16-bit counter)"),
    "scale": ((list,), "size of one raw count in 'units', per channel: 0.0879 (deg per count), 0.35 (mm per pixel)"),
    "start": ((int, float), "cut readings before this time of the raw clock, s"),
    "end": ((int, float), "cut readings after this time of the raw clock, s"),
    "release": ((str, int, float), "where t = 0 is: 'start' (default), 'find', 'first_peak', or s on the raw clock"),
    "before": ((int, float), "time to keep before the release, s"),
    "every": ((int,), "keep every N-th reading"),
}
TRIAL: dict[str, tuple[tuple[type, ...], str]] = {
    "source": ((str, list), "raw file, or one for each channel, primary first"),
    "sha256": ((str, list), "its checksum (one for each file), compared where given"),
    "file": ((str,), "record to write, e.g. trials/a1.csv"),
    "case": ((str,), "label of the case"),
    "configuration": ((str,), "uncoupled or coupled"),
    "trial": ((int,), "number within case and configuration"),
    "k1t": ((int, float, str), "spring to ground, N m/rad (N/m), or 'estimate' from the strongest frequency"),
    "k1t_std": ((int, float), "standard uncertainty of k1t"),
    "theta0": ((int, float), "release angle, deg (displacement, mm)"),
    "theta0_std": ((int, float), "standard uncertainty of theta0, deg (mm)"),
    "holdout": ((bool,), "true: not fitted, only used to test the model"),
}
INIT: dict[str, tuple[tuple[type, ...], str]] = {
    "pattern": (
        (str,),
        "how file names are built, e.g. 'case{case}_{configuration}_{trial}'; also {theta0} and {k1t}",
    ),
    "words": ((list,), "words for the configurations in file names, e.g. free=uncoupled magnet=coupled"),
    "sheet": ((str,), "CSV table of the trials: a column file or case, and other options as columns"),
    "files_per_trial": ((int,), "2 if each channel has its own file, the primary's first"),
}
"""Options of `init` alone: how trials differ from each other."""
_PATTERN = {
    "case": r".+?",
    "configuration": r"uncoupled|coupled",
    "trial": r"\d+",
    "theta0": r"[-+]?\d+(?:[.,]\d+)?",
    "k1t": r"\d+(?:[.,]\d+)?",
}
_RIG = tuple(Rig.__dataclass_fields__)
MEASUREMENT = (
    "quantity",
    "frame",
    "input",
    "noise_std",
    "sensor_range",
    "sensor_bandwidth",
    "offset_std",
    "scale_std",
    "lag_std",
)
_ITEMS: dict[str, tuple[type, ...]] = {
    "source": (str,), "sha256": (str,), "columns": (str, int), "units": (str,), "sensitivity": (str,),
    "mounting_radius": (int, float), "sign": (int, float), "offset": (str, int, float), "matlab_time": (str,),
    "matlab_data": (str,), "clock": (int, float), "wrap": (int, float), "scale": (int, float),
}  # fmt: skip
"""What the lists of an import table may hold."""
_Row = Mapping[str, Any]  # of a sheet: option -> its value
_WORD_OR_NUMBER = ("release", "offset")
"""Keys of a sheet whose cells hold a word or a number."""
_LEAST: dict[str, float] = {"every": 1, "skip_lines": 0, "before": 0.0, "k1t_std": 0.0}
"""Smallest values of some keys."""
LEAST_KNOWN = 0.5
"""Share of a file's lines that must hold readings."""
NOTHING_RUBS = (
    "No force pressing the bodies together was given (magnet_pull), so the model has no friction between them "
    "(mu = 0 in priors.toml). `diagnose` shows whether friction is missing there; if so, give that force."
)
_RELEASE_ASSUMED = {
    "torsional": "The uncertainty of the release angle was not given; 0.1 deg, or 2 % of the angle if that is more, "
    "is assumed (--theta0-std; theta0_std_deg in trials.csv).",
    "translational": "The uncertainty of the release position was not given; 0.1 mm, or 2 % of it if that is more, "
    "is assumed (--theta0-std; theta0_std_mm in trials.csv).",
}
_SINGLE = "One channel only, so taken as uncoupled: {}. If that is wrong, use --pattern or --sheet."
_ALL_COUPLED = (
    "Every file has two channels, so all trials are taken as coupled. If that is wrong, use --configuration, --pattern "
    "or --sheet."
)


def columns_of(path: str | Path) -> str:
    """A sentence that numbers the columns of a logger's file, for whoever has to name them.

    Raises
    ------
    InputError
        if it cannot be read.
    """
    source = read_file(Path(path), {})
    numbered = [f"{i} {name}".strip() for i, name in enumerate(source.names or ("",) * source.table.shape[1], start=1)]
    return f"{Path(path).name} has the columns: {', '.join(numbered)}"


def checked_keys(table: Mapping[str, Any], valid: Mapping[str, tuple[tuple[type, ...], str]], where: str) -> list[str]:
    """What is wrong with the keys of READER, TRIAL, ... in a table, or with their values."""
    faults = []
    for key, value in table.items():
        if key not in valid:
            near = difflib.get_close_matches(key[:60], valid, 1, 0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"valid keys: {', '.join(valid)}"
            faults.append(f"{where}: unknown key '{key}'; {hint}")
        elif not _is_one_of(value, valid[key][0]):
            types, meaning = valid[key]
            numbers = float in types and list not in types
            wanted = "a number with a decimal point" if numbers else "of another type"
            faults.append(f"{where}: {key} = {shown(value)}, which must be {wanted}: {meaning}")
        elif key == "decimal" and value not in (".", ","):
            faults.append(f"{where}: decimal = {shown(value)} is none of '.' and ','")
        elif value == "":
            faults.append(f"{where}: {key} is empty; leave the key out, or give {valid[key][1]}")
        for part in value if isinstance(value, list) and key in _ITEMS else ():
            if not _is_one_of(part, _ITEMS[key]):
                faults.append(f"{where}: {key} holds {shown(part)}, which cannot be: {valid[key][1]}")
        for number in value if isinstance(value, list) else [value]:
            with collected(faults):
                if isinstance(number, int | float) and not isinstance(number, bool):
                    real(number, f"{where}: {key}")
    return faults + [
        f"{where}: {key} = {shown(value)} is too small; give at least {least}"
        for key, least in _LEAST.items()
        if isinstance(value := table.get(key), int | float) and not value >= least
    ]


def _is_one_of(value: object, types: tuple[type, ...]) -> bool:
    return isinstance(value, types) and (not isinstance(value, bool) or bool in types)


def _check_options(options: Mapping[str, object]) -> None:
    """Raises InputError where an option does not exist or a number is beyond reason."""
    valid = (*READER, *TRIAL, *_RIG, *MEASUREMENT, *INIT, "name", "description", "source_text", "free_start")
    faults = [
        f"option '{key}' does not exist; " + (f"did you mean '{near[0]}'?" if near else f"options: {', '.join(valid)}")
        for key in options
        if key not in valid
        for near in [difflib.get_close_matches(key[:60], valid, 1, 0.5)]
    ]
    for key, value in options.items():
        for number in value if isinstance(value, list | tuple) else [value]:
            if isinstance(number, int) and abs(number) > LARGEST:
                faults.append(
                    f"option '{key}' = {shown(number)} is beyond reason (more than {LARGEST:g}); check its unit"
                )
    given = {key: value for key, value in options.items() if key in READER and value is not None}
    if faults := faults or checked_keys(given, READER, "options"):
        raise InputError(faults)


def spec_from_options(
    name: str, sources: Sequence[Path], options: Mapping[str, object], raw: Path | None = None
) -> dict[str, Any]:
    """The table that `init` carries out; see `importer.init_campaign` for the options.

    raw : folder of the files that a sheet names, by default that of the sheet.

    Raises
    ------
    InputError
        for options that do not exist, files that cannot be read, and columns that are not given and not to be guessed.
    """
    _check_options(options)
    faults: list[str] = []
    rows = _sheet_rows(options.get("sheet"), faults)
    folder = raw if raw is not None else resolved(str(options["sheet"])).parent if rows else Path()
    if not sources:
        sources = [folder / str(row["file"]) for row in rows if "file" in row]
    faults += [f"{path}: there is no such file; correct the name or --raw" for path in sources if not path.exists()]
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
    apart = _files_and_rows(sources, rows, several)
    groups = [files for files, _ in apart]
    caveats = []
    if "primary_inertia" not in given:
        caveats.append("The inertia was not given, so all results are per unit inertia (primary_inertia = 1).")
    pattern = given.get("pattern")
    asked = ("configuration" in about for about in (given, *rows))
    declared = any(asked) or "{configuration}" in str(pattern)
    own: dict[Path, dict[str, Any]] = {}
    own_columns = all(any("columns" in row for row in about) for _, about in apart)
    if "columns" not in given and several == 1 and sources[0].is_file() and not own_columns:
        own = _guessed_all([s for s in sources if s.is_file()], given, caveats, declared)
        given |= own.pop(Path(), {})
    elif not declared and several == 1 and isinstance(named := given.get("columns"), list) and len(named) == 2:
        own = _configurations([s for s in sources if s.is_file()], given, caveats)
    if "columns" in given and several == 1 and not {"time", "sample_rate"} & given.keys():
        given |= _guessed_time(sources, given, caveats)
    columns = given.get("columns", [])
    coupled = isinstance(columns, list) and len(columns) > 1
    common: dict[str, Any] = {"case": "A", "configuration": "coupled" if coupled else "uncoupled", "k1t": "estimate"}
    common |= {k: given[k] for k in TRIAL if k in given and k not in ("source", "trial", "file", "sha256")}
    trials = [_trial_row(files, common | own.get(files[0], {}), pattern, about, words) for files, about in apart]
    if "case" not in given and "{case}" not in str(pattern) and not any("case" in row for row in rows):
        _name_cases(trials, str(pattern), given.get("kind") == "translational")
    rubbing = {"magnet_pull", "magnet_radius"} & given.keys()
    if not rubbing and any(trial["configuration"] == "coupled" for trial in trials):
        caveats.append(NOTHING_RUBS)
    if any(trial["k1t"] == "estimate" for trial in trials):
        caveats.append("k1t was not given; it is estimated from the strongest frequency, with an uncertainty of 20 %.")
    known = _all_released(trials) and not given.get("free_start")
    caveats += _rows_without_files(rows, groups, trials, str(given.get("sheet")))
    start = "rest" if known else "free"
    if start == "rest" and not all("theta0_std" in trial for trial in trials):
        caveats.append(_RELEASE_ASSUMED["translational" if given.get("kind") == "translational" else "torsional"])
    spec: dict[str, Any] = {"name": given.get("name", name), "description": given.get("description", "")}
    spec |= {"source": given.get("source_text", ""), "caveats": caveats}
    spec["rig"] = {"primary_inertia": 1.0, **{k: given[k] for k in _RIG if k in given}}
    spec["measurement"] = {"start": start, **_measurement_of(given)}
    spec["reader"] = {k: given[k] for k in READER if k in given}
    return spec | {"trials": trials}


def _measurement_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The table [measurement]; the sample rate is that of the readings kept."""
    found = {k: given[k] for k in MEASUREMENT if k in given}
    if "sample_rate" in given:
        rate, every = given["sample_rate"], given.get("every", 1)
        if isinstance(rate, int | float) and isinstance(every, int) and every > 0:
            rate = rate / every
        found["sample_rate"] = rate
    return found


def _files_and_rows(sources: Sequence[Path], rows: Sequence[_Row], several: int) -> list[tuple[list[Path], list[_Row]]]:
    """Of each trial its files, and the rows of the sheet that may be about it.

    Where several rows name one file, it holds a trial for each of them, side by side or one after the other.
    """
    if several > 1:
        return [(list(sources[i : i + several]), list(rows)) for i in range(0, len(sources), several)]
    out: list[tuple[list[Path], list[_Row]]] = []
    for path in dict.fromkeys(sources) if any("file" in row for row in rows) else sources:
        named = [row for row in rows if "file" in row and _describes(row, path, {})]
        exact = [row for row in named if path.parts[-len(parts := Path(str(row["file"])).parts) :] == parts]
        for own in exact or named or [{}]:
            out.append(([path], [row for row in rows if "file" not in row or row is own]))
    return out


def _trial_row(
    files: Sequence[Path], common: Mapping[str, Any], pattern: object, rows: Sequence[Mapping[str, Any]],
    words: Mapping[str, str],
) -> dict[str, Any]:  # fmt: skip
    """One [[trials]]: what holds for all, over it what the file's name says, over it what the sheet says."""
    sums = [file_sha256(path) for path in files if path.is_file()]
    single = len(files) == 1
    row: dict[str, Any] = {"source": str(files[0]) if single else [str(path) for path in files]}
    if len(sums) == len(files):
        row["sha256"] = sums[0] if single else sums
    row |= common
    if pattern is not None:
        row |= _named_in(files[0], str(pattern), words)
    for entry in rows:
        if _describes(entry, files[0], row):
            row |= {key: value for key, value in entry.items() if key != "file"}
            if "columns" in entry and "configuration" not in entry and pattern is None:
                row["configuration"] = "coupled" if len(entry["columns"]) > 1 else common["configuration"]
    row["case"] = str(row["case"])
    return row


def _describes(entry: Mapping[str, Any], file: Path, row: Mapping[str, Any]) -> bool:
    """Whether a row of the sheet is about a trial, by its file, else by its case and configuration."""
    if "file" in entry:
        return Path(str(entry["file"])).name == file.name
    return all(str(entry[key]) == str(row[key]) for key in ("case", "configuration") if key in entry)


def _rows_without_files(
    rows: Sequence[Mapping[str, Any]], groups: Sequence[Sequence[Path]], trials: Sequence[Mapping[str, Any]], sheet: str
) -> list[str]:
    """A sentence on the rows of the sheet that are about none of the files."""
    lost = [
        ", ".join(str(entry[key]) for key in ("file", "case", "configuration") if key in entry)
        for entry in rows
        if not any(_describes(entry, files[0], row) for files, row in zip(groups, trials, strict=True))
    ]
    return [f"{sheet}: {_first_of(lost)} describe{'s' * (len(lost) == 1)} none of the files."] if lost else []


def _first_of(names: Sequence[str]) -> str:
    """The first three names, and how many more there are."""
    return ", ".join(names[:3]) + f" and {len(names) - 3} more" * (len(names) > 3)


def _all_released(trials: Sequence[Mapping[str, Any]]) -> bool:
    """Whether all trials have a release angle, or none has one; InputError where some have one."""
    missing = [row for row in trials if "theta0" not in row]
    if missing and len(missing) < len(trials):
        names = _first_of([Path(str(s[0] if isinstance(s := row["source"], list) else s)).name for row in missing])
        raise InputError(
            f"theta0 is given for some trials and missing for {names}; give it for all of them (--theta0, --pattern or "
            "the sheet), or for none: the start of each is then inferred"
        )
    return not missing


def _name_cases(trials: Sequence[dict[str, Any]], pattern: str, straight: bool) -> None:
    """Cases after the springs or angles in the names, where these number the trials of each and nothing names cases."""
    keys = [key for key in ("k1t", "theta0") if "{" + key + "}" in pattern and "{trial}" in pattern]
    keys = [key for key in keys if len({trial[key] for trial in trials}) > 1]
    for trial in trials if keys else ():
        forms = {"k1t": "k1 {:g}" if straight else "k1t {:g}", "theta0": "{:g} mm" if straight else "{:g} deg"}
        trial["case"] = ", ".join(forms[key].format(trial[key]) for key in keys)


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
    """What a file's name says by a pattern such as 'case{case}_{configuration}_{trial}'."""
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
            f"{file.name}: the name does not follow --pattern '{pattern}': {{trial}} stands for digits, {{theta0}} and "
            "{k1t} for numbers, and all else in the name has to stand in the pattern too, as in "
            "'run{trial}_{configuration}'; correct the pattern or the name"
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
    """Rows of a table of trials: a column 'file' or 'case' (or both), and any key of TRIAL and READER."""
    if sheet is None:
        return []
    path = Path(str(sheet))
    try:
        text = text_of(file_bytes(path, remedy="give a table of the trials as CSV"), str(path))
        mark = next((m for m in (";", "\t") if m in text.lstrip().partition("\n")[0]), ",")
        table = [[c.strip() for c in row] for _, row in csv_rows(text, str(path), mark)]
    except FileNotFoundError as error:
        faults.append(f"{path}: cannot be read ({error.strerror}); give a table of the trials as CSV")
        return []
    except InputError as error:
        faults.extend(error.faults)
        return []
    head, *body = [row for row in table if any(row)] or [[]]
    single = {k: v for k, v in {**TRIAL, **READER}.items() if (list,) != v[0] or k == "columns"}
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
                elif key == "columns":  # numbers, or the name of one, which may have blanks
                    row[key] = [int(x) for x in cell.split()] if re.fullmatch(r"[\d ]+", cell) else [cell]
                elif key in _WORD_OR_NUMBER and re.match(r"[-+.,]?\d", cell) is None:
                    pass
                elif str not in types or key in ("k1t", *_WORD_OR_NUMBER):
                    number = number_of(cell, mark != ",")
                    row[key] = int(number) if float not in types else number
            except (ValueError, KeyError, OverflowError):
                if cell != "estimate":
                    wanted = "true or false" if bool in types else "a number"
                    faults.append(f"{path}, line {i}, column '{key}': '{cell}' is not {wanted}")
        rows.append(row)
    return rows


def _guessed_all(
    paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str], declared: bool
) -> dict[Path, dict[str, Any]]:
    """Columns where none were named and only one choice is left, for all files under `Path()`, else for each file.

    declared : whether something else says which trials are coupled. Where nothing does and some files hold one channel
    and others two, the former are uncoupled.
    """
    found = {path: _guessed(path, given) for path in paths}
    first = found[paths[0]]
    if all(other == first for other in found.values()):
        columns, words = first
        caveats.append(f"No columns were named; used: {words}.")
        if len(columns["columns"]) == 2 and not declared:
            caveats.append(_ALL_COUPLED)
        return {Path(): columns}
    counts = {len(columns["columns"]) for columns, _ in found.values()}
    for words in dict.fromkeys(words for _, words in found.values()):
        where = [path.name for path, (_, other) in found.items() if other == words]
        caveats.append(f"No columns were named; used from {file_names(where)}: {words}.")
    if declared or len(counts) == 1:
        return {path: dict(columns) for path, (columns, _) in found.items()}
    single = [path.name for path, (columns, _) in found.items() if len(columns["columns"]) == 1]
    caveats.append(_SINGLE.format(file_names(single)))
    return {
        path: {**columns, "configuration": "coupled" if len(columns["columns"]) == 2 else "uncoupled"}
        for path, (columns, _) in found.items()
    }


def _guessed_time(paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str]) -> dict[str, Any]:
    """The column of the time where none was named and all files have the same one, beside the named channels."""
    found, chosen, named = set(), "", True
    for path in paths:
        source = read_file(path, given)
        time = source.time_column()
        named = named and time is not None and source.called_time(time)
        try:
            taken = [source.index(c, path.name) for c in given["columns"]]
        except InputError:
            taken = []  # a channel that this file lacks: the reader says so, or the trial is uncoupled
        found.add(None if time is None or time in taken else time + 1)
        chosen = chosen or ("" if time is None else source.column(time))
    if len(found) != 1 or None in found:
        return {}
    if not named:
        caveats.append(f"No time column was named; used: {chosen}.")
    return {"time": found.pop()}


def file_names(names: Sequence[str]) -> str:
    """File names for a sentence, a few at most."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} other files"


def _configurations(paths: Sequence[Path], given: Mapping[str, Any], caveats: list[str]) -> dict[Path, dict[str, Any]]:
    """Files that lack the second of two named columns hold uncoupled trials."""
    out: dict[Path, dict[str, Any]] = {}
    for path in paths:
        source = read_file(path, given)
        try:
            source.index(given["columns"][1], path.name)
        except InputError:
            out[path] = {"configuration": "uncoupled"}
    if len(out) == len(paths):
        return {}  # then the name of the column is wrong, which the reader says
    caveats.append(_SINGLE.format(file_names([path.name for path in out])) if out else _ALL_COUPLED)
    return out


def _guessed(path: Path, given: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Columns of the time and the channels where only one choice is left, and the words for them.

    A column that never changes (a temperature, a counter that stands) is no channel where others are left.
    """
    source = read_file(path, given)
    time = None if "sample_rate" in given else source.time_column()
    if "time" in given:
        time = source.index(given["time"], path.name)
    readings = [
        i for i in range(source.table.shape[1]) if i != time and np.mean(np.isfinite(source.table[:, i])) > LEAST_KNOWN
    ]
    moving = [i for i in readings if np.nanmax(source.table[:, i]) > np.nanmin(source.table[:, i])]
    readings = moving or readings
    if len(readings) not in (1, 2) or (time is None and "sample_rate" not in given):
        raise InputError(
            f"{path.name}: has {source.described()}; name the channels with --columns, the primary first, and the time "
            "with --time (or give --sample-rate)"
        )
    found: dict[str, Any] = {"columns": [i + 1 for i in readings]}
    bodies = BODIES["translational" if given.get("kind") == "translational" else "torsional"]
    taken = [f"{source.column(i)} for {who}" for i, who in zip(readings, bodies, strict=False)]
    if time is not None:
        found["time"] = time + 1
        taken.append(f"{source.column(time)} for the time")
    return found, ", ".join(taken)


def spec_text(spec: Mapping[str, Any]) -> str:
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
