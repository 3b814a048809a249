"""What a logger or DAQ system has written (text, MATLAB, JSON, binary forms) as columns of numbers, unconverted.

Text is read as it comes: in UTF-8, UTF-16 or the code page of Windows, with lines of a head before the columns' names,
a line of units below them, decimal commas, times of the day, quotes, an empty last column, words for missing readings,
and a footer below the numbers. `LoggerFile.notes` says what was left out. Nothing here knows of rigs or quantities.
"""

from __future__ import annotations

import csv
import datetime as dt
import difflib
import hashlib
import io
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign.logger_formats import channels_of, form_of
from bayes_damper.errors import InputError
from bayes_damper.inputs import check_matlab, file_bytes, json_of, number_in
from bayes_damper.runs.parallel_map import apart

Array = NDArray[np.float64]
Line = tuple[int, str]
_LOOKED_AT = 400
"""Lines in which the first numbers are looked for."""
_FEWEST_ROWS = 5
"""Rows of which on a column of words is no column of readings that failed."""
_LONGEST_LINE = 100_000
"""Characters of a line in which quotes are looked for: whatever is longer is no row of a logger's table."""
_MATLAB_SECONDS = 15.0
_MATLAB_SPEED = 5e6
"""Bytes a second beyond these seconds in which a MATLAB file must be read, a tenth of what is usual: some small damaged
ones would take for ever, and hundreds of megabytes of memory more each second.
"""
_MATLAB_MEMORY = 500_000_000
_MATLAB_GROWTH = 20
"""Bytes that reading may take beside so many for each of the file's, unpacked: a byte may stand for a number of eight,
and what is sent is there twice.
"""
_MISSING = {"", "-", "--", "---", "na", "n/a", "nan", "null", "none"}
"""What loggers write where there is no reading."""
_OTHER_FORMATS = (
    (b"PK\x03\x04", "an Excel workbook or another archive; save it as CSV"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook; save it as CSV"),
    (b"\x1f\x8b", "compressed; unpack it first"),
)
_CLOCK = re.compile(
    r"(?:(?P<y>\d{4})[-/](?P<m>\d{1,2})[-/](?P<d>\d{1,2})[ T]+"
    r"|(?P<d2>\d{1,2})[./](?P<m2>\d{1,2})[./](?P<y2>\d{4})[ T]+)?"
    r"(?:(?P<h>\d{1,2}):(?P<min>\d{2}):(?P<s>\d{2}(?:[.,]\d+)?)|(?P<min2>\d{1,3}):(?P<s2>\d{2}[.,]\d+))Z?"
)
_TIME_NAMES = re.compile(
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
        near = _nearest(column, self.names)
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
        return i < len(self.names) and bool(_TIME_NAMES.fullmatch(self.names[i].strip().strip('"')))

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


def read_file(path: Path, option: Mapping[str, Any]) -> LoggerFile:
    """A logger's file of any form; option: as for `read_text` and `read_matlab`, and sha256, which must be its own.

    Raises
    ------
    InputError
        if it cannot be read, is empty, or is not the file that was described.
    """
    try:
        raw = file_bytes(path, remedy="say where the raw files are")
    except FileNotFoundError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); say where the raw files are") from None
    expected = option.get("sha256")
    found = hashlib.sha256(raw).hexdigest()
    if expected and found != expected.lower():
        raise InputError(
            f"{path.name}: sha256 is {found[:16]}..., expected {expected[:16]}...: this is not the file that was "
            "described; get that version, or remove sha256 if the change is meant"
        )
    if not raw.strip():
        raise InputError(f"{path.name}: the file is empty; export it again")
    form = form_of(raw)
    if form is not None:
        return read_binary(raw, path.name, form, option)
    readers = {".mat": read_matlab, ".json": read_json}
    return readers.get(path.suffix.lower(), read_text)(raw, path.name, option)


def read_binary(raw: bytes, name: str, form: str, option: Mapping[str, Any]) -> LoggerFile:
    """A file of one of logger_formats.FORMS; option: group. The time is column 1 where the file has a clock.

    Raises
    ------
    InputError
        for a file that is damaged or holds no series, or a package that is not installed.
    """
    channels, notes = channels_of(raw, name, form, option.get("group", ""))
    columns, names, units = [c.readings for c in channels], [c.name for c in channels], [c.unit for c in channels]
    called = [k for k, n in enumerate(names) if _TIME_NAMES.fullmatch(n.rpartition("/")[2])]
    times = channels[0].times
    if times is not None and not called:
        columns, names, units = [times, *columns], ["time", *names], ["s", *units]
    elif called and names[called[0]] != "time":
        names[called[0]] = "time"
    known, unknown = _known_units(name, names, units)
    notes += unknown
    with np.errstate(invalid="ignore"):  # a NaN that raises a warning wherever it is used becomes one that does not
        table = np.column_stack(columns) + 0.0
    return LoggerFile(tuple(names), table, known, tuple(notes))


def _known_units(name: str, columns: Sequence[str], units: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """The units of columns as the tables of units write them, "" for an unknown one, and a note on each of these."""
    known = tuple(unit_of(unit) or "" for unit in units)
    return known, [
        f"{name}: the unit '{unit}' of {column} is not known; give it with --units."
        for column, unit, plain in zip(columns, units, known, strict=True)
        if unit.strip() and not plain
    ]


def read_text(raw: bytes, name: str, option: Mapping[str, Any]) -> LoggerFile:
    """A file of delimited text; option: delimiter, decimal, skip_lines, header (see import_options.READER).

    Raises
    ------
    InputError
        with file, line and remedy, for what is no text or no table of numbers.
    """
    skipped = option.get("skip_lines", 0)
    lines = [(i, x) for i, x in enumerate(_decoded(raw, name).splitlines(), start=1) if i > skipped and x.strip()]
    if len(lines) < 3:
        left = f" after the first {skipped} lines; correct skip_lines" if skipped else "; name a file of the logger"
        raise InputError(f"{name}: holds no row of numbers{left}")
    mark = _mark(lines, option)
    comma = option["decimal"] == "," if "decimal" in option else _has_decimal_commas(lines, mark)
    if comma and mark == "," and not any('"' in x for _, x in lines):
        raise InputError(
            f"{name}: decimal commas and commas between columns cannot be distinguished; export with semicolons"
        )
    lines, wordy = _without_words(lines, mark, comma)
    begin, named = _begin(lines, option, mark, comma)
    head = _split(lines[begin][1], mark) if named else []
    rows, notes = _rows(lines[begin + named :], mark, comma, name, named, len(_trimmed(head)))
    table = np.array(rows)
    width = table.shape[1]
    while width > 1 and np.isnan(table[:, width - 1]).all() and not "".join(head[width - 1 : width]).strip():
        width -= 1  # an empty last column: each line ends with the mark
    if len(_trimmed(head)) == width - 1 and width > 1 and np.isfinite(table[:, width - 1]).any():
        raise InputError(
            f"{name}, line {lines[begin + 1][0]}: {width} columns where {width - 1} are expected; decimal commas? set "
            "decimal = ',' and delimiter"
        )
    names, units = _names(lines[: begin + 1] if named else [], mark, width)
    units, unknown = _known_units(name, names, [unit.strip("[]()- ") for unit in units]) if units else ((), [])
    notes += unknown
    for i in wordy:
        called = f"column {i + 1}" + (f" ({names[i]})" if names[i : i + 1] not in ((), ("",)) else "")
        notes.append(f"{name}: {called} holds words, no numbers, and was left out.")
    return LoggerFile(names, table[:, :width], units, tuple(notes))


def read_matlab(raw: bytes, name: str, option: Mapping[str, Any]) -> LoggerFile:
    """Time in column 1 where matlab_time is given, then the channels.

    Several arrays of data, and those of a cell array, are joined one below the other, or side by side where each is as
    long as the time.
    """
    import scipy.io  # noqa: F401 (once, here, and not in each forked process)

    try:
        size = check_matlab(raw)
        # Some damaged files end the process that reads them.
        content = apart(
            _loaded,
            raw,
            seconds=_MATLAB_SECONDS + len(raw) / _MATLAB_SPEED,
            memory=_MATLAB_MEMORY + _MATLAB_GROWTH * size,
        )
    except Exception as error:
        raise InputError(
            f"{name}: not a MATLAB file that can be read ({error}); copy it again, or save it as version 5 or 7"
        ) from error
    parts: list[NDArray[Any]] = []
    for key in ("matlab_time", "matlab_data"):
        pieces: list[NDArray[Any]] = []
        beside = bool(parts)  # arrays as long as the time are channels of their own, others the pieces of one record
        for variable in option.get(key, []):
            for piece in _pieces(_variable(content, variable, name, key)):
                if piece.ndim != 2 or piece.dtype.kind not in "biuf":
                    raise InputError(
                        f"{name}: '{variable}' holds no numbers; it holds {_listed(content)}: correct {key}"
                    )
                tall = _tall(piece)
                beside = beside and len(tall) == len(parts[0])
                if pieces and not beside and tall.shape[1] != pieces[0].shape[1]:
                    raise InputError(
                        f"{name}: '{variable}' has {tall.shape[1]} columns, those before it {pieces[0].shape[1]}, but "
                        f"{key} joins them one below the other; correct {key}"
                    )
                pieces.append(tall)
        if pieces:
            parts.append(np.concatenate(pieces, axis=int(beside)))
    if not parts:
        raise InputError(
            f"{name}: which of its arrays are the readings? It holds {_listed(content)}: name them with --matlab-data, "
            "and the time's with --matlab-time"
        )
    if len(parts) > 1 and len(parts[0]) != len(parts[1]):
        raise InputError(
            f"{name}: matlab_time names {len(parts[0])} readings and matlab_data {len(parts[1])}; the file holds "
            f"{_listed(content)}: name arrays of one length"
        )
    return LoggerFile((), np.ascontiguousarray(np.concatenate(parts, axis=1), dtype=float))


def _loaded(raw: bytes) -> dict[str, Any]:
    from scipy.io import loadmat

    return dict(loadmat(io.BytesIO(raw)))


def _nearest(word: str, names: Sequence[str]) -> str | None:
    """The name that is meant: the shortest that has the word in it, or the most alike, whole or without its path."""
    word = word.strip().lower()[:60]
    if holding := [n for n in names if len(word) > 1 and word in n.lower()]:
        return min(holding, key=len)
    known = {n.lower().rpartition(".")[2]: n for n in names} | {n.lower(): n for n in names}
    near = difflib.get_close_matches(word, known, 1, 0.4)
    return known[near[0]] if near else None


def _arrays(content: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """The arrays of a MATLAB file, those in structures too: path and shape of each."""
    found: dict[str, tuple[int, ...]] = {}
    level = [(key, np.asarray(value)) for key, value in content.items() if not key.startswith("__")]
    while level:
        path, value = level.pop(0)
        if value.dtype.names and value.size == 1:
            level = [(f"{path}.{field}", np.asarray(value[field].ravel()[0])) for field in value.dtype.names] + level
        elif value.size > 1:
            found[path] = value.shape
    return found


def _listed(content: Mapping[str, Any], most: int = 20) -> str:
    """The arrays of a MATLAB file for a sentence."""
    found = [f"{path} ({' x '.join(map(str, shape))})" for path, shape in _arrays(content).items()]
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(found[:most]) + more if found else "no arrays"


def _variable(content: Mapping[str, Any], path: str, name: str, key: str) -> NDArray[Any]:
    """A variable of a MATLAB file, or a field of a structure in it: "Theta1.signals.values"."""
    first, *fields = path.split(".")
    found = content.get(first)
    for field in fields:
        inside = found[field] if found is not None and field in (found.dtype.names or ()) else None
        found = inside.ravel()[0] if inside is not None and inside.size == 1 else inside
    if found is None:
        near = _nearest(path, list(_arrays(content)))
        hint = f"did you mean '{near}'?" if near else f"correct {key}"
        raise InputError(f"{name}: no variable '{path}'; it holds {_listed(content)}: {hint}")
    return np.asarray(found)


def read_json(raw: bytes, name: str, _: Mapping[str, Any]) -> LoggerFile:
    """A list of readings, each an object of names and numbers: the file itself, or the one such list that it holds.

    Raises
    ------
    InputError
        if there is no such list, or more than one.
    """
    content = json_of(_decoded(raw, name), name, "export it again")
    inside = list(content.values()) if isinstance(content, dict) else [content]
    lists = [x for x in inside if isinstance(x, list) and len(x) > 1 and all(isinstance(row, dict) for row in x)]
    if len(lists) != 1:
        raise InputError(f"{name}: holds {len(lists)} lists of readings where one is expected; export it as CSV")
    names = [k for k, v in lists[0][0].items() if isinstance(v, int | float)]
    if not names:
        raise InputError(f"{name}: its readings hold no numbers; export it as CSV")
    table = [[math.nan if (x := row.get(k)) is None else x for k in names] for row in lists[0]]
    try:
        readings = np.array(table, float)
        if np.isinf(readings).any():
            raise ValueError("one is beyond what a computer holds")
        return LoggerFile(tuple(names), readings)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: a reading is no number ({error}); export it as CSV") from error


def _pieces(variable: NDArray[Any]) -> list[NDArray[Any]]:
    return [np.asarray(p) for p in variable.ravel()] if variable.dtype == object else [variable]


def _tall(piece: NDArray[Any]) -> NDArray[Any]:
    return piece.T if piece.shape[0] < piece.shape[1] else piece


def _decoded(raw: bytes, name: str) -> str:
    """Text of a file in UTF-8 or UTF-16, or else in the code page of Windows, whose names may have umlauts."""
    for start, what in _OTHER_FORMATS:
        if raw.startswith(start):
            raise InputError(f"{name}: this is {what}")
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    head = raw[:4000]
    if b"\x00" in head or sum(b < 9 or 13 < b < 32 for b in head) > 0.02 * len(head):
        raise InputError(f"{name}: this is no text; export it as CSV or text")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def number_of(cell: str, comma: bool) -> float:
    """A cell as a number, nan where the reading is missing, seconds for a time of the day (and a date).

    Raises
    ------
    ValueError
        for other words.
    """
    cell = cell.strip().strip('"')
    if cell.lower() in _MISSING:
        return math.nan
    if ":" in cell:
        return _seconds(cell)
    value = number_in(cell.replace(",", ".") if comma else cell)
    if math.isinf(value) and any(c.isdigit() for c in cell):
        raise ValueError(f"{cell[:40]!r} is beyond what a computer holds")
    return value


def _seconds(cell: str) -> float:
    found = _CLOCK.fullmatch(cell)
    if found is None:
        raise ValueError(cell)
    part = {k: float(v.replace(",", ".")) for k, v in found.groupdict().items() if v is not None}
    seconds = 3600.0 * part.get("h", 0.0) + 60.0 * (part.get("min", 0.0) + part.get("min2", 0.0))
    seconds += part.get("s", 0.0) + part.get("s2", 0.0)
    year = int(part.get("y", part.get("y2", 0.0)))
    if year:
        day = dt.date(year, int(part.get("m", part.get("m2", 0.0))), int(part.get("d", part.get("d2", 0.0))))
        # Days of the year alone, so that a double still resolves microseconds.
        seconds += 86400.0 * (day - dt.date(year, 1, 1)).days
    return seconds


_LETTER = re.compile(r"[^\W\d_eE]")
"""A letter that no number is written with."""


def _has_decimal_commas(lines: Sequence[Line], mark: str) -> bool:
    """Whether the later half of the lines writes its numbers with decimal commas."""
    cells = [c.strip() for _, line in lines[len(lines) // 2 :] for c in _split(line, mark)]
    return any("," in c for c in cells) and not any("." in c for c in cells)


def _without_words(lines: list[Line], mark: str, comma: bool) -> tuple[list[Line], list[int]]:
    """The lines with columns of words ("OK", a date, remarks) as missing readings, and which columns these are, from 0.

    A column is one of words if none of its cells in the later half is a number, beside one of numbers alone; one of
    remarks if it holds words in some rows of numbers and a number in none.
    """
    later = [_split(line, mark) for _, line in lines[len(lines) // 2 :]]
    width = Counter(map(len, later)).most_common(1)[0][0]
    rows = [cells for cells in later if len(cells) == width]
    numbers = [sum(_is_number(row[i], comma) for row in rows) for i in range(width)]
    wordy = {i for i in range(width) if not numbers[i] and all(_is_word(row[i], comma) for row in rows)}
    wordy |= _remarks(lines, mark, comma)
    if not wordy or max(numbers) < len(rows) or len(rows) < _FEWEST_ROWS:
        return lines, []

    def numbers_of(line: str) -> str:
        cells = _split(line, mark)
        while len(cells) > width and len(cells) - 1 in wordy:
            cells.pop()
        if len(cells) != width or not any(_is_number(c, comma) for c in cells):
            return line
        return mark.join("nan" if i in wordy else f'"{c}"' if mark in c else c for i, c in enumerate(cells))

    return [(number, numbers_of(line)) for number, line in lines], sorted(wordy)


def _is_word(cell: str, comma: bool) -> bool:
    """Whether a cell holds neither a number nor what stands for a missing one."""
    return cell.strip(' "').lower() not in _MISSING and not _is_number(cell, comma)


def _remarks(lines: Sequence[Line], mark: str, comma: bool) -> set[int]:
    """Columns, from 0, that hold words in some rows of numbers, and a number in none."""
    odd = [_split(line, mark) for _, line in lines if _LETTER.search(line) and _half_numbers(line, mark, comma)]
    found = {i for cells in odd for i, cell in enumerate(cells) if _is_word(cell, comma)}
    for _, line in lines if found else ():
        cells = _split(line, mark)
        found -= {i for i in found if i < len(cells) and _is_number(cells[i], comma)}
    return found


def _cells(line: str, mark: str, comma: bool) -> list[float] | None:
    """A line as numbers; None where it is none, or all of them are missing."""
    try:
        values = [number_of(c, comma) for c in _split(line, mark)]
    except ValueError:
        return None
    return values if any(math.isfinite(v) for v in values) else None


def _begin(lines: Sequence[Line], option: Mapping[str, Any], mark: str, comma: bool) -> tuple[int, bool]:
    """Which line holds the names of the columns (or their units), or the first numbers, and whether it holds names.

    Given by skip_lines and header where these are set; else the numbers begin with the first of five rows of numbers
    of one length, and the line before them holds names if it has as many cells and is no row of numbers itself.
    """
    if "skip_lines" in option:
        named = bool(option.get("header", True))
        return int(named and _of_units(_head(lines[1][1], mark))), named
    widths = []
    for _, line in lines[:_LOOKED_AT]:
        values = _cells(line, mark, comma)
        widths.append(0 if values is None else len(values))
    starts = (i for i in range(len(widths)) if widths[i] and len(set(widths[i : i + 5])) == 1)
    first = next(starts, None)
    if first is None:
        return 0, bool(option.get("header", True))
    # A line with words between rows of numbers is no head: it is reported as a bad line.
    while first > 1 and widths[first - 2] == widths[first] and _half_numbers(lines[first - 1][1], mark, comma):
        first -= 2
    # The names may do without the empty last column, or have one (of comments) that the rows do without. Units may be
    # empty for a column of words too.
    head = _head(lines[first - 1][1], mark) if first > 0 else []
    enough = first > 0 and (
        abs(len(_trimmed(head)) - widths[first]) <= 1 or (len(head) == widths[first] and _of_units(head))
    )
    if widths[first] == 1:
        enough = first > 0 and len(_trimmed(head)) == 1
    return (first - 1, True) if enough and option.get("header", True) else (first, False)


def _is_number(cell: str, comma: bool) -> bool:
    """Whether a cell holds a number."""
    try:
        return math.isfinite(number_of(cell, comma))
    except ValueError:
        return False


def _half_numbers(line: str, mark: str, comma: bool) -> bool:
    """Whether half of a line's cells are numbers."""
    cells = _split(line, mark)
    return 2 * sum(_is_number(cell, comma) for cell in cells) >= len(cells)


def _rows(
    lines: Sequence[Line], mark: str, comma: bool, name: str, named: bool, heads: int
) -> tuple[list[list[float]], list[str]]:
    """All rows of numbers, one length each, and what was left out: a foot, a last line that is cut short."""
    found = [(_cells(line, mark, comma), line, number) for number, line in lines]
    known = Counter(len(values) for values, _, _ in found if values is not None)
    if not known:
        raise InputError(f"{name}: holds no row of numbers; name another file, or set delimiter and decimal")
    width = known.most_common(1)[0][0]
    if heads > width + 1:
        number = next(n for values, _, n in found if values is not None)
        raise InputError(f"{name}, line {number}: {width} columns where {heads} are expected; the line is cut short")
    last = max(i for i, (values, _, _) in enumerate(found) if values is not None and len(values) == width)
    notes, rows = [], []
    left = len(found) - last - 1
    if left:
        what = "the last line, below the numbers, was" if left == 1 else f"{left} lines below the numbers were"
        notes.append(f"{name}: {what} left out.")
    for values, line, number in found[: last + 1]:
        cells = _split(line, mark)
        try:
            row = values if values is not None else [number_of(c, comma) for c in cells]  # all missing
        except ValueError:
            raise InputError(_bad_line(name, number, line, cells, named, comma)) from None
        if len(row) > width and all(math.isnan(v) for v in row[width:]):
            row = row[:width]
        if len(row) != width:
            raise InputError(
                f"{name}, line {number}: {len(row)} columns where {width} are expected; "
                + ("decimal commas? set --decimal , and --delimiter" if len(row) > width else "the line is cut short")
            )
        rows.append(row)
    return rows, notes


def _names(head: Sequence[Line], mark: str, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units, as they stand there, of the columns from the last line of the head.

    A line of units alone, most of which are known, has the names above it.
    """
    if not head:
        return (), ()
    cells = _head(head[-1][1], mark)[:width]
    cells += [""] * (width - len(cells))
    if len(head) > 1 and _of_units(cells):
        above = _head(head[-2][1], mark)[:width]
        if sum(map(bool, above)) >= sum(unit_of(c) is not None for c in cells):
            return tuple(above + [""] * (width - len(above))), tuple(cells)
    return tuple(cells), ()


def _of_units(cells: Sequence[str]) -> bool:
    """Whether a line is one of units: most of its cells that are neither empty nor a dash are known ones."""
    return 2 * sum(unit_of(c) is not None for c in cells) > sum(bool(c.strip("[]()- ")) for c in cells)


def _without_unit(name: str) -> str:
    return re.sub(r"\s*[\[(][^\[\]]*[\])]\s*$", "", name).strip().lower()


def _trimmed(cells: Sequence[str]) -> list[str]:
    """The cells without empty ones at the end."""
    kept = list(cells)
    while kept and not kept[-1].strip():
        kept.pop()
    return kept


_THOUSANDS = re.compile(r"\s*[-+]?\d{1,3}(?:(?:\.\d{3})+,\d+|(?:,\d{3})+\.\d+|(?:[ ']\d{3})+(?:[.,]\d+)?)\s*")


def _bad_line(name: str, line: int, text: str, cells: Sequence[str], named: bool, comma: bool) -> str:
    if thousands := next((c.strip() for c in cells if _THOUSANDS.fullmatch(c)), None):
        return f"{name}, line {line}: '{thousands}' has a mark between thousands; export the numbers without it"
    if not comma and any(re.fullmatch(r"\s*[-+]?\d+,\d+(e[-+]?\d+)?\s*", c, re.IGNORECASE) for c in cells):
        return f"{name}, line {line}: '{text.strip()[:40]}' has decimal commas; set --decimal ,"
    numbers = [_is_number(c, comma) for c in cells]
    if any(numbers) and not all(numbers):
        odd = cells[numbers.index(False)].strip()
        return (
            f"{name}, line {line}: '{odd[:40]}' is no number; where a reading is missing leave the cell empty, or "
            "remove the line"
        )
    hint = (
        "set --skip-lines to the number of lines before the column names" if named else "set --skip-lines, or --header"
    )
    return f"{name}, line {line}: '{text.strip()[:40]}' is not a row of numbers; {hint}, or remove the line"


def _mark(lines: Sequence[Line], option: Mapping[str, Any]) -> str:
    given = option.get("delimiter", "auto")
    named = {"tab": "\t", "space": " "}
    if given != "auto":
        if not given:
            raise InputError(
                "delimiter = '' separates nothing; give the mark between columns, 'tab', 'space' or 'auto'"
            )
        return str(named.get(given, given))
    sample = lines[max(min(2, len(lines) - 1), len(lines) // 2)][1]
    for mark in (";", "\t", "|"):
        if mark in sample:
            return mark
    if "," not in sample or '"' in sample:
        return "," if "," in sample else " "
    if option.get("decimal", ".") == "," or (
        all(re.fullmatch(r"[-+]?\d+,\d+", c) for c in sample.split()[:9]) and (len(sample.split()) > 1)
    ):
        return " "
    return ","


def _split(line: str, mark: str) -> list[str]:
    if mark == " ":
        return line.split()
    text = line.strip("\r\n") if mark == "\t" else line.rstrip()
    if '"' not in text or len(mark) > 1 or len(text) > _LONGEST_LINE:
        return text.split(mark)
    return next(csv.reader([text], delimiter=mark))


def _head(line: str, mark: str) -> list[str]:
    """The cells of a line of names, without the mark of a comment."""
    return [c.strip().strip('"').strip() for c in _split(re.sub(r"^\s*[#%]+\s*", "", line), mark)]
