"""trials.csv: one row a trial, checked."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from bayes_damper.campaign.files import nearest_name, read_text
from bayes_damper.campaign.structure import TO_SI, TRIAL_COLUMNS, Constant
from bayes_damper.inputs import collected, csv_rows, number_in, real, shown

_MOST_FAULTS = 100  # of trials.csv: whoever has more has one cause
_TURN = 360.0  # degrees of a release, at most
LEAST_STD = 0.1  # of a release, deg (mm), where none is declared
_MARKS = ("holdout", "cut")
_COUNTED = 2**53  # above it doubles skip whole numbers, so that two trials may have one


@dataclass(frozen=True)
class Row:
    """One row of trials.csv that could be read."""

    file: str
    case: str
    configuration: str
    trial: int
    k1t: Constant
    theta0: Constant | None
    holdout: bool
    cut: bool
    line: int


def read_rows(folder: Path, kind: str, start: str, faults: list[str], digest: hashlib._Hash) -> list[Row]:
    """The rows of trials.csv, read and checked."""
    name = "trials.csv"
    text = read_text(folder / name, name, faults, digest)
    if text is None:
        return []
    table: list[tuple[int, list[str]]] = []
    with collected(faults):
        table = csv_rows(text, name)
    if not table:
        return []
    header = [cell.strip() for cell in table[0][1]]
    if not _check_header(header, kind, start, name, faults):
        return []
    rows: list[Row] = []
    seen: dict[tuple[str, str, int], int] = {}
    files: dict[str, int] = {}
    count, before = 0, len(faults)
    for line, cells in table[1:]:
        if not any(cell.strip() for cell in cells):
            continue
        count += 1
        if len(faults) - before > _MOST_FAULTS:
            faults.append(f"{name}: line {line} and those below were not looked at; correct the lines above first")
            break
        where = f"{name}, line {line}"
        if len(cells) != len(header):
            hint = (
                "a field with a comma in it needs quotes, and numbers need decimal points"
                if len(cells) > len(header)
                else "fill in what is missing; an empty field needs its comma too"
            )
            faults.append(f"{where}: {len(cells)} fields where the header has {len(header)}; {hint}")
            continue
        row = _row_from({k: c.strip() for k, c in zip(header, cells, strict=True)}, kind, start, where, faults)
        if row is None:
            continue
        row = replace(row, line=line)
        key = (row.case, row.configuration, row.trial)
        if key in seen:
            faults.append(
                f"{where}: case {key[0]}, {key[1]}, trial {key[2]} is already on line {seen[key]}; number it anew"
            )
        if row.file in files:
            faults.append(f"{where}: {row.file} is already the record of line {files[row.file]}; a record counts once")
        seen.setdefault(key, row.line)
        files.setdefault(row.file, row.line)
        rows.append(row)
    if count == 0:
        faults.append(f"{name}: no trials; write one row for each record")
    return rows


def _check_header(header: list[str], kind: str, start: str, name: str, faults: list[str]) -> bool:
    k1t, k1t_std, theta0, theta0_std = TRIAL_COLUMNS[kind]
    needed = ["file", "case", "configuration", k1t, "trial", *([theta0] if start == "rest" else [])]
    valid = (*dict.fromkeys([*needed, k1t_std, theta0, theta0_std, *_MARKS]),)
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        faults.append(f"{name}: columns are not separated by commas; save it with commas and decimal points")
        return False
    other = TRIAL_COLUMNS["translational" if kind == "torsional" else "torsional"]
    for column in header[:_MOST_FAULTS]:
        if column in other:
            right = TRIAL_COLUMNS[kind][other.index(column)]
            faults.append(f"{name}: column '{column}' does not belong to a {kind} rig; use '{right}', or change kind")
        elif column not in valid:
            faults.append(f"{name}: unknown column '{column}'; {nearest_name(column, valid)}")
    for column in [c for c, count in Counter(header).items() if count > 1]:
        faults.append(f"{name}: column '{column}' appears twice; remove one")
    missing = [column for column in needed if column not in header]
    faults.extend(f"{name}: column '{column}' is missing; add it" for column in missing)
    return not missing


def _row_from(cells: Mapping[str, str], kind: str, start: str, where: str, faults: list[str]) -> Row | None:
    before = len(faults)
    k1t_name, k1t_std_name, theta0_name, theta0_std_name = TRIAL_COLUMNS[kind]
    for key in ("file", "case"):
        if not cells[key]:
            faults.append(f"{where}: '{key}' is empty; fill it in")
        elif not cells[key].isprintable():
            faults.append(f"{where}: {key} {shown(cells[key])} holds characters that cannot be printed; write it anew")
    if cells["file"] and not inside(cells["file"]):
        faults.append(
            f"{where}: {cells['file']} leaves the campaign's folder, or is too long; give a relative path inside it"
        )
    configuration = cells["configuration"]
    if configuration not in ("uncoupled", "coupled"):
        hint = nearest_name(configuration, ("uncoupled", "coupled"))
        faults.append(f"{where}: configuration '{configuration}' is not uncoupled or coupled; {hint}")
    number = _number(cells["trial"], f"{where}, trial", faults)
    if number is not None and not (number == int(number) and 0 <= number <= _COUNTED):
        faults.append(f"{where}: trial '{cells['trial']}' is not a whole number up to {_COUNTED}; count from 1")
    k1t = _number(cells[k1t_name], f"{where}, {k1t_name}", faults)
    if k1t is not None and k1t <= 0.0:
        faults.append(f"{where}: {k1t_name} = {k1t!r} must be positive; give it in N m/rad (N/m)")
    k1t_std = _number(cells.get(k1t_std_name, "") or "0", f"{where}, {k1t_std_name}", faults)
    theta0 = _theta0_from(cells, theta0_name, theta0_std_name, kind, start, where, faults)
    if k1t_std is not None and k1t_std < 0.0:
        faults.append(f"{where}: {k1t_std_name} = {k1t_std!r} is negative; give a standard uncertainty of 0 or more")
    marks = {key: cells.get(key, "").lower() for key in _MARKS}
    for key, mark in marks.items():
        if mark not in ("", "true", "false", "0", "1"):
            faults.append(f"{where}: {key} '{mark}' is not true or false; write one of them")
    if len(faults) > before or number is None or k1t is None or k1t_std is None:
        return None
    marked = {key: mark in ("true", "1") for key, mark in marks.items()}
    return Row(
        cells["file"], cells["case"], configuration, int(number), Constant(k1t, k1t_std), theta0, line=0, **marked
    )


def _theta0_from(
    cells: Mapping[str, str], name: str, std_name: str, kind: str, start: str, where: str, faults: list[str]
) -> Constant | None:
    text, std_text = cells.get(name, ""), cells.get(std_name, "")
    if start == "free":
        if text:
            faults.append(
                f'{where}: {name} is given but start = "free"; empty the column and take all readings before the '
                'release off the records, or set start = "rest"'
            )
        return None
    if not text:
        faults.append(f'{where}: {name} is empty; give the release angle, or set start = "free" in campaign.toml')
        return None
    value = _number(text, f"{where}, {name}", faults)
    std = _number(std_text, f"{where}, {std_name}", faults) if std_text else None
    if value is None:
        return None
    if kind == "torsional" and abs(value) > _TURN:
        faults.append(f"{where}: {name} = {value!r} is more than a turn; give degrees")
    if std is not None and std <= 0.0:
        faults.append(f"{where}: {std_name} = {std!r} must be positive; leave it empty for the larger of 0.1 and 2 %")
        return None
    if std is None:
        std = max(LEAST_STD, 0.02 * abs(value))
    return Constant(value * TO_SI[kind], std * TO_SI[kind])


def _number(text: str, where: str, faults: list[str]) -> float | None:
    try:
        value = number_in(text)
    except ValueError:
        faults.append(f"{where}: {shown(text)} is not a number; write digits 0 to 9 with a decimal point")
        return None
    if not math.isfinite(value):
        faults.append(f"{where}: {shown(text)} is not finite; give the number")
        return None
    with collected(faults):
        return real(value, where)
    return None


def inside(name: str) -> bool:
    """Whether a file's name is one that leads nowhere out of the campaign's folder, and that any system takes."""
    path = PurePosixPath(name.replace("\\", "/"))
    if any(len(part.encode()) > 255 for part in path.parts) or len(name) > 1000 or "\0" in name:
        return False
    if path.is_absolute() or not path.parts or ":" in path.parts[0]:
        return False
    depth = 0
    for part in path.parts:
        depth += -1 if part == ".." else 1
        if depth < 0:
            return False
    return True
