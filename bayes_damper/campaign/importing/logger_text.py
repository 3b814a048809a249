"""Delimited text of a logger as columns of numbers.

It is read as it comes: in UTF-8, UTF-16 or the code page of Windows, with lines of a head before the columns' names, a
line of units below them, decimal commas, times of the day, quotes, an empty last column, words for missing readings,
and a footer below the numbers. `LoggerFile.notes` says what was left out.
"""

from __future__ import annotations

import csv
import datetime as dt
import math
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from bayes_damper.campaign.importing.logger_columns import LoggerFile, known_units, unit_of
from bayes_damper.campaign.importing.options import ReaderOptions
from bayes_damper.errors import InputError
from bayes_damper.inputs import number_in

Line = tuple[int, str]
_LOOKED_AT = 400  # lines in which the first numbers are looked for
_FEWEST_ROWS = 5  # of which on a column of words is no column of readings that failed
_LONGEST_LINE = 100_000  # characters in which quotes are looked for: whatever is longer is no row of a logger's table
_MISSING = {"", "-", "--", "---", "na", "n/a", "nan", "null", "none"}  # what loggers write where there is no reading
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
_LETTER = re.compile(r"[^\W\d_eE]")  # that no number is written with
_THOUSANDS = re.compile(r"\s*[-+]?\d{1,3}(?:(?:\.\d{3})+,\d+|(?:,\d{3})+\.\d+|(?:[ ']\d{3})+(?:[.,]\d+)?)\s*")


def read_text(raw: bytes, name: str, option: ReaderOptions) -> LoggerFile:
    """A file of delimited text; as `option` says or as it looks.

    Raises
    ------
    InputError
        with file, line and remedy, for what is no text or no table of numbers.
    """
    skipped = option.skip_lines or 0
    lines = [(i, x) for i, x in enumerate(decoded(raw, name).splitlines(), start=1) if i > skipped and x.strip()]
    if len(lines) < 3:
        left = f" after the first {skipped} lines; correct skip_lines" if skipped else "; name a file of the logger"
        raise InputError(f"{name}: holds no row of numbers{left}")
    mark = _mark(lines, option)
    comma = option.decimal == "," if option.decimal is not None else _has_decimal_commas(lines, mark)
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
    units, unknown = known_units(name, names, [unit.strip("[]()- ") for unit in units]) if units else ((), [])
    notes += unknown
    for i in wordy:
        called = f"column {i + 1}" + (f" ({names[i]})" if names[i : i + 1] not in ((), ("",)) else "")
        notes.append(f"{name}: {called} holds words, no numbers, and was left out.")
    return LoggerFile(names, table[:, :width], units, tuple(notes))


def decoded(raw: bytes, name: str) -> str:
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
    # A foot may have as many cells as the rows, but no number.
    rows = [cells for cells in later if len(cells) == width and any(_is_number(c, comma) for c in cells)]
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


def _begin(lines: Sequence[Line], option: ReaderOptions, mark: str, comma: bool) -> tuple[int, bool]:
    """Which line holds the names of the columns (or their units), or the first numbers, and whether it holds names.

    Given by skip_lines and header where these are set; else the numbers begin with the first of five rows of numbers
    of one length, and the line before them holds names if it has as many cells and is no row of numbers itself.
    """
    if option.skip_lines is not None:
        named = option.header
        return int(named and _of_units(_head(lines[1][1], mark))), named
    widths = []
    for _, line in lines[:_LOOKED_AT]:
        values = _cells(line, mark, comma)
        widths.append(0 if values is None else len(values))
    starts = (i for i in range(len(widths)) if widths[i] and len(set(widths[i : i + 5])) == 1)
    first = next(starts, None)
    if first is None:
        return 0, option.header
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
    return (first - 1, True) if enough and option.header else (first, False)


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


def _trimmed(cells: Sequence[str]) -> list[str]:
    """The cells without empty ones at the end."""
    kept = list(cells)
    while kept and not kept[-1].strip():
        kept.pop()
    return kept


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


def _mark(lines: Sequence[Line], option: ReaderOptions) -> str:
    if option.delimiter != "auto":
        return {"tab": "\t", "space": " "}.get(option.delimiter, option.delimiter)
    sample = lines[max(min(2, len(lines) - 1), len(lines) // 2)][1]
    for mark in (";", "\t", "|"):
        if mark in sample:
            return mark
    if "," not in sample or '"' in sample:
        return "," if "," in sample else " "
    if option.decimal == "," or (
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
