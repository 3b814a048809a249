"""The table of an import as `init` makes it from options and a sheet, and from what files are called and hold."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_damper.campaign import Rig, toml_value
from bayes_damper.campaign.importing.guesses import guessed_all, guessed_time, uncoupled_in
from bayes_damper.campaign.importing.logger_text import number_of
from bayes_damper.campaign.importing.options import INIT, MEASUREMENT, READER, TRIAL, ReaderOptions, checked_keys
from bayes_damper.errors import InputError
from bayes_damper.inputs import LARGEST, csv_rows, file_bytes, file_sha256, resolved, shown, text_of

_PATTERN = {
    "case": r".+?", "configuration": r"uncoupled|coupled", "trial": r"\d+", "theta0": r"[-+]?\d+(?:[.,]\d+)?",
    "k1t": r"\d+(?:[.,]\d+)?",
}  # fmt: skip
_RIG = tuple(Rig.__dataclass_fields__)
_Row = dict[str, object]  # of the table or of a sheet: key -> its value
_WORD_OR_NUMBER = ("release", "offset")  # keys of a sheet whose cells hold either
NOTHING_RUBS = (
    "No force pressing the bodies together was given (magnet_pull), so the model has no friction between them "
    "(mu = 0 in priors.toml). `diagnose` shows whether friction is missing there; if so, give that force."
)
_RELEASE_ASSUMED = (
    "The uncertainty of the release {0} was not given; 0.1 {2}, or 2 % of {1} if that is more, is assumed "
    "(--theta0-std; theta0_std_{2} in trials.csv)."
)
_RELEASE = {"torsional": ("angle", "the angle", "deg"), "translational": ("position", "it", "mm")}


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
    sources, rows = _sources_and_rows(sources, options.get("sheet"), raw)
    given: _Row = {key: value for key, value in options.items() if value is not None}
    kind = "translational" if given.get("kind") == "translational" else "torsional"
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
    own: dict[Path, _Row] = {}
    own_columns = all(any("columns" in row for row in about) for _, about in apart)
    if "columns" not in given and several == 1 and sources[0].is_file() and not own_columns:
        own = guessed_all([s for s in sources if s.is_file()], ReaderOptions.of(given), kind, caveats, declared)
        given |= own.pop(Path(), {})
    elif not declared and several == 1 and isinstance(named := given.get("columns"), list) and len(named) == 2:
        single = uncoupled_in([s for s in sources if s.is_file()], ReaderOptions.of(given), caveats)
        own = {path: {"configuration": "uncoupled"} for path in single}
    if "columns" in given and several == 1 and not {"time", "sample_rate"} & given.keys():
        time = guessed_time(sources, ReaderOptions.of(given), caveats)
        given |= {} if time is None else {"time": time}
    columns = given.get("columns", [])
    coupled = isinstance(columns, list) and len(columns) > 1
    common: _Row = {"case": "A", "configuration": "coupled" if coupled else "uncoupled", "k1t": "estimate"}
    common |= {k: given[k] for k in TRIAL if k in given and k not in ("source", "trial", "file", "sha256")}
    trials = [_trial_row(files, common | own.get(files[0], {}), pattern, about, words) for files, about in apart]
    if "case" not in given and "{case}" not in str(pattern) and not any("case" in row for row in rows):
        _name_cases(trials, str(pattern), kind)
    rubbing = {"magnet_pull", "magnet_radius"} & given.keys()
    if not rubbing and any(trial["configuration"] == "coupled" for trial in trials):
        caveats.append(NOTHING_RUBS)
    if any(trial["k1t"] == "estimate" for trial in trials):
        caveats.append("k1t was not given; it is estimated from the strongest frequency, with an uncertainty of 20 %.")
    known = _all_released(trials) and not given.get("free_start")
    caveats += _rows_without_files(rows, groups, trials, str(given.get("sheet")))
    start = "rest" if known else "free"
    if start == "rest" and not all("theta0_std" in trial for trial in trials):
        caveats.append(_RELEASE_ASSUMED.format(*_RELEASE[kind]))
    spec: dict[str, Any] = {"name": given.get("name", name), "description": given.get("description", "")}
    spec |= {"source": given.get("source_text", ""), "caveats": caveats}
    spec["rig"] = {"primary_inertia": 1.0, **{k: given[k] for k in _RIG if k in given}}
    spec["measurement"] = {"start": start, **_measurement_of(given)}
    spec["reader"] = {k: given[k] for k in READER if k in given}
    return spec | {"trials": trials}


def _sources_and_rows(sources: Sequence[Path], sheet: object, raw: Path | None) -> tuple[Sequence[Path], list[_Row]]:
    """The files, those that a sheet names if none are given, and the rows of the sheet."""
    faults: list[str] = []
    rows = _sheet_rows(sheet, faults)
    folder = raw if raw is not None else resolved(str(sheet)).parent if rows else Path()
    sources = sources or [folder / str(row["file"]) for row in rows if "file" in row]
    faults += [f"{path}: there is no such file; correct the name or --raw" for path in sources if not path.exists()]
    if not sources:
        faults.append("no logger files were given; name at least one, or a --sheet with a column 'file'")
    if faults:
        raise InputError(faults)
    return sources, rows


def _measurement_of(given: _Row) -> _Row:
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
    files: Sequence[Path], common: _Row, pattern: object, rows: Sequence[_Row], words: Mapping[str, str]
) -> _Row:  # fmt: skip
    """One [[trials]]: what holds for all, over it what the file's name says, over it what the sheet says."""
    sums = [file_sha256(path) for path in files if path.is_file()]
    single = len(files) == 1
    row: _Row = {"source": str(files[0]) if single else [str(path) for path in files]}
    if len(sums) == len(files):
        row["sha256"] = sums[0] if single else sums
    row |= common
    if pattern is not None:
        row |= _named_in(files[0], str(pattern), words)
    for entry in rows:
        if _describes(entry, files[0], row):
            row |= {key: value for key, value in entry.items() if key != "file"}
            if isinstance(own := entry.get("columns"), list) and "configuration" not in entry and pattern is None:
                row["configuration"] = "coupled" if len(own) > 1 else common["configuration"]
    row["case"] = str(row["case"])
    return row


def _describes(entry: _Row, file: Path, row: _Row) -> bool:
    """Whether a row of the sheet is about a trial, by its file, else by its case and configuration."""
    if "file" in entry:
        return Path(str(entry["file"])).name == file.name
    return all(str(entry[key]) == str(row[key]) for key in ("case", "configuration") if key in entry)


def _rows_without_files(
    rows: Sequence[_Row], groups: Sequence[Sequence[Path]], trials: Sequence[_Row], sheet: str
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


def _all_released(trials: Sequence[_Row]) -> bool:
    """Whether all trials have a release angle, or none has one; InputError where some have one."""
    missing = [row for row in trials if "theta0" not in row]
    if missing and len(missing) < len(trials):
        names = _first_of([Path(str(s[0] if isinstance(s := row["source"], list) else s)).name for row in missing])
        raise InputError(
            f"theta0 is given for some trials and missing for {names}; give it for all of them (--theta0, --pattern or "
            "the sheet), or for none: the start of each is then inferred"
        )
    return not missing


def _name_cases(trials: Sequence[_Row], pattern: str, kind: str) -> None:
    """Cases after the springs or angles in the names, where these number the trials of each and nothing names cases."""
    keys = [key for key in ("k1t", "theta0") if "{" + key + "}" in pattern and "{trial}" in pattern]
    keys = [key for key in keys if len({trial[key] for trial in trials}) > 1]
    for trial in trials if keys else ():
        straight = kind == "translational"
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


def _named_in(file: Path, pattern: str, words: Mapping[str, str]) -> _Row:
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
    out: _Row = dict(found.groupdict())
    for field, text in found.groupdict().items():
        if field == "configuration":
            out[field] = words.get(text.lower(), text.lower())
        elif field != "case":
            out[field] = int(text) if field == "trial" else float(text.replace(",", "."))
    return out


def _sheet_rows(sheet: object, faults: list[str]) -> list[_Row]:
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
    single = {k: v for k, v in (TRIAL | READER).items() if (list,) != v.types or k == "columns"}
    wrong = [key for key in head if key not in ("file", *single)]
    if wrong or not body or not ({"file", "case", "configuration"} & set(head)):
        known = f"columns: file, {', '.join(single)}"
        faults.append(f"{path}: " + (f"unknown column '{wrong[0]}'; {known}" if wrong else f"give rows and {known}"))
        return []
    rows = []
    for i, cells in enumerate(body, start=2):
        row: _Row = {}
        for key, cell in zip(head, cells, strict=False):
            if not cell:
                continue
            row[key] = cell
            types = single[key].types if key in single else (str,)
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


def spec_text(spec: Mapping[str, Any]) -> str:
    """An import table as TOML, each reader key with what it means."""
    lines = ["# How this campaign was made from the logger's files; `bayes-damper init` repeats it."]
    lines += [f"{key} = {toml_value(value)}" for key, value in spec.items() if not _is_table(value)]
    for key in ("rig", "measurement", "reader"):
        lines += ["", f"[{key}]"]
        lines += [
            f"{k} = {toml_value(v)}" + (f"  # {READER[k].meaning}" if key == "reader" else "")
            for k, v in spec[key].items()
        ]
    for trial in spec["trials"]:
        lines += ["", "[[trials]]", *(f"{k} = {toml_value(v)}" for k, v in trial.items())]
    return "\n".join(lines) + "\n"


def _is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))
