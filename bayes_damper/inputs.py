"""The door for what others wrote: files as bytes, text, TOML, CSV and JSON, and their numbers, all within limits.

Whatever stands in a file, what comes back is sound data or an `InputError` with a sentence: no file is read that would
not end (a named pipe, a device), none that would fill the memory, nothing nested beyond reason, no number beyond what
double precision can work with. Nothing is run: no pickle, no module, no expression.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import json
import math
import os
import re
import stat
import struct
import tomllib
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_damper.errors import InputError

LARGEST = 1e30
"""Largest magnitude of a number in a file, in any unit: its square and cube must not overflow."""
SMALLEST = 1e-30
"""Smallest magnitude, but for 0, of a number that is declared (a reading may be smaller)."""
LARGEST_FILE = 1 << 29
"""Bytes of a file that are read at most."""
LARGEST_TOML = 1 << 22
"""Bytes of a TOML file: ten thousand trials of an import table."""
DEEPEST = 12
"""Tables within tables that a TOML file may hold; ours need four."""
_UNPACKED = 1 << 28
_UNPACKED_ALWAYS = 1 << 26
_RATIO = 100  # times that text of readings is packed at most; a text of nothing but line ends reaches 1000
_NUMBERS = 20  # times that numbers are packed at most in a binary file above _UNPACKED
_PACKED = 15  # kind of element of a MATLAB file that holds another, compressed
_CELL = 131_072
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


class collected:  # noqa: N801 (used as contextlib.suppress is)
    """In a with statement: adds the sentences of an `InputError` to `faults` and goes on behind the block."""

    def __init__(self, faults: list[str]) -> None:
        self.faults = faults

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> bool:
        if not isinstance(error, InputError):
            return False
        self.faults.extend(error.faults)
        return True


# Bytes and text -------------------------------------------------------------------------------------------------------


def file_bytes(
    path: Path, name: str | None = None, remedy: str = "give a readable file", most: int = LARGEST_FILE
) -> bytes:
    """The bytes of a file; name : of the file in sentences; most : bytes.

    Raises
    ------
    FileNotFoundError
        if there is none.
    InputError
        if it is no file (a folder, a named pipe, a device), cannot be read or has more bytes.
    """
    name = str(path) if name is None else name
    try:
        found = path.stat()
        what = next((words for test, words in _KINDS if test(found.st_mode)), None)
        if what is not None:
            raise InputError(f"{name}: {what}, not a file; {remedy}")
        if found.st_size > most:
            raise InputError(
                f"{name}: {found.st_size / 1e6:.0f} MB, more than the {most / 1e6:.0f} MB that are read; {remedy}"
            )
        with path.open("rb") as file:
            raw = file.read(most + 1)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with a byte of 0 in it
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{name}: cannot be read ({reason}); {remedy}") from None
    if len(raw) > most:
        raise InputError(f"{name}: more than the {most / 1e6:.0f} MB that are read; {remedy}")
    return raw


def resolved(path: str | Path) -> Path:
    """The absolute path without links; one that leads to itself or holds a byte of 0 stays, for what reads it to name.

    (`Path.resolve` ends in a RuntimeError there, before Python 3.13.)
    """
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError):
        return Path(path)


def is_file(path: Path) -> bool:
    """Whether there is a file of that name; never an error, however odd the name."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def unpacked(raw: bytes, name: str) -> bytes:
    """What a gzip file holds.

    Raises
    ------
    InputError
        if it is damaged, or unpacks to more than records of readings do.
    """
    most = min(max(_UNPACKED_ALWAYS, _RATIO * len(raw)), _UNPACKED)
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
            text = file.read(most + 1)
    except (OSError, EOFError, zlib.error):
        raise InputError(f"{name}: not a whole gzip file; compress it again or give it uncompressed") from None
    if len(text) > most:
        raise InputError(
            f"{name}: {len(raw) / 1e6:.2g} MB that unpack to more than {most / 1e6:.0f} MB; no record of readings "
            "packs so tightly: look what it holds, or give it uncompressed"
        )
    return text


def check_hdf5(file: Any, size: int, plain: bool = False) -> None:
    """Looks through an open file of HDF5 before any number of it is read; size : its bytes.

    plain : whether it may hold neither links nor complex numbers, as none of ours does.

    Raises
    ------
    ValueError
        if numbers of it lie in another file, or it claims to hold far more than it can.
    """
    import h5py  # slow to load, and the help of the command line reads this module

    seen, total = set(), 0
    groups: list[Any] = [file]
    while groups:
        group = groups.pop()
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                if plain:
                    raise ValueError(f"{name!r} lies in another file")
                continue
            item = group[name]
            place = h5py.h5o.get_info(item.id).addr
            if place in seen:
                continue
            seen.add(place)
            if isinstance(item, h5py.Group):
                groups.append(item)
            elif isinstance(item, h5py.Dataset):
                if item.is_virtual or item.external:
                    raise ValueError(f"{name!r} lies in another file")
                if plain and item.dtype.kind == "c":
                    raise ValueError(f"{name!r} holds complex numbers")
                total += item.size * item.dtype.itemsize
    _check_claim(total, size)


def check_matlab(raw: bytes) -> int:
    """Bytes of a MATLAB file of version 5 or 7 with its packed arrays unpacked, before any of them is kept.

    Raises
    ------
    ValueError
        if they unpack to far more than numbers do.
    """
    order, place, total = "<" if raw[126:128] == b"IM" else ">", 128, 0
    while place + 8 <= len(raw):
        kind, length = struct.unpack(f"{order}II", raw[place : place + 8])
        place += 8
        packed, stream = raw[place : place + length], zlib.decompressobj()
        while kind == _PACKED and packed and not stream.eof:
            try:
                total += len(stream.decompress(packed, 1 << 20))
            except zlib.error:
                break  # whoever reads it says so
            packed = stream.unconsumed_tail
            _check_claim(total, len(raw))
        place += length
    return total + len(raw)


def _check_claim(total: int, size: int) -> None:
    """ValueError where so many bytes of numbers cannot have come from a file of this size."""
    if total > max(_UNPACKED, _NUMBERS * size):
        raise ValueError(f"{total / 1e6:.0f} MB of numbers in {size / 1e6:.2g} MB")


def text_of(raw: bytes, name: str) -> str:
    """The text of UTF-8 bytes, without a mark of the byte order.

    Raises
    ------
    InputError
        if they are no such text.
    """
    if b"\0" in raw:
        kind = "a spreadsheet or an archive" if raw.startswith(b"PK") else "not plain text (it holds bytes of 0)"
        raise InputError(f"{name}: {kind}; save it as plain text in UTF-8, tables as CSV")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise InputError(f"{name}, line {line}: not UTF-8 text; save the file as plain text in UTF-8") from None


# Tables ---------------------------------------------------------------------------------------------------------------


def toml_of(text: str, name: str) -> dict[str, Any]:
    """What a TOML file says.

    Raises
    ------
    InputError
        if it is not valid, longer than LARGEST_TOML or nested deeper than DEEPEST.
    """
    if len(text) > LARGEST_TOML:
        raise InputError(f"{name}: {len(text) / 1e6:.0f} MB of TOML; give at most {LARGEST_TOML / 1e6:.0f} MB")
    deep = f"{name}: tables or lists nested more than {DEEPEST} deep; no key needs that, write them flat"
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: not valid TOML: {str(error)[:200]}; correct that line") from None
    except RecursionError:
        raise InputError(deep) from None
    except ValueError:
        raise InputError(f"{name}: a number of thousands of digits; correct it") from None
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer) if isinstance(inner, dict | list)]
        if not level:
            return table
    raise InputError(deep)


def _inside(outer: Mapping[str, object] | Sequence[Any]) -> Sequence[Any]:
    return list(outer.values()) if isinstance(outer, Mapping) else outer


def toml_file(path: Path, remedy: str, name: str | None = None) -> dict[str, Any]:
    """What a TOML file says; remedy : for one that cannot be read.

    Raises
    ------
    FileNotFoundError
        if there is none.
    InputError
        as `file_bytes`, `text_of` and `toml_of`.
    """
    name = str(path) if name is None else name
    return toml_of(text_of(file_bytes(path, name, remedy, LARGEST_TOML), name), name)


def json_of(text: str, name: str, remedy: str) -> Any:
    """What a JSON file says.

    Raises
    ------
    InputError
        if it is not valid.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise InputError(f"{name}: this is not valid JSON (nested too deep); {remedy}") from None
    except ValueError as error:
        raise InputError(f"{name}: this is not valid JSON ({str(error)[:200]}); {remedy}") from None


def fields(table: object, types: Mapping[str, tuple[type, ...]], where: str, remedy: str) -> dict[str, Any]:
    """These entries of a JSON object, each of one of its types (a truth value is no number); others are left out.

    Raises
    ------
    InputError
        if it is no object, or an entry is missing or of another type; the sentence begins with `where`.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: no table of names and values; {remedy}")
    for key, valid in types.items():
        if key not in table:
            raise InputError(f"{where}: {key} is missing; {remedy}")
        if not isinstance(table[key], valid) or (isinstance(table[key], bool) and bool not in valid):
            raise InputError(
                f"{where}: {key} = {shown(table[key])} is of another type than it was written with; {remedy}"
            )
    return {key: table[key] for key in types}


def file_sha256(path: Path) -> str:
    """Checksum of a file's bytes.

    Raises
    ------
    InputError
        if there is none, or it cannot be read.
    """
    try:
        return hashlib.sha256(file_bytes(path)).hexdigest()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; give one that is there") from None


def in_lines(text: str) -> str:
    """Text whose lines end as on Unix, whether they ended as on Windows or on an old Mac."""
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def csv_rows(text: str, name: str, delimiter: str = ",", first: int = 1) -> list[tuple[int, list[str]]]:
    """The rows of a CSV text, each with the number of the line that it ends on; lines end in any way.

    first : number of the first line in its file.

    Raises
    ------
    InputError
        for a quote that is never closed or a cell of more characters than any has.
    """
    lines = in_lines(text).split("\n")
    if max(map(len, lines)) > _CELL:
        long = next(i for i, line in enumerate(lines, start=first) if len(line) > _CELL)
        raise InputError(f"{name}, line {long}: more than {_CELL} characters in one line; no table of trials has such")
    for strict in (True, False):
        reader = csv.reader(lines, delimiter=delimiter, strict=strict)
        rows: list[tuple[int, list[str]]] = []
        try:
            rows.extend((first - 1 + reader.line_num, cells) for cells in reader)
        except csv.Error as error:
            if strict and "expected after" in str(error):
                continue  # text behind a closing quote: read as it is written
            begun = rows[-1][0] + 1 if rows else first
            raise InputError(f"{name}, line {begun}: a quote is opened and never closed; close or remove it") from None
        return rows
    raise AssertionError


# Numbers --------------------------------------------------------------------------------------------------------------


def shown(value: object, most: int = 60) -> str:
    """A value of a file for a sentence: as Python writes it, and no more of it than a reader needs."""
    if isinstance(value, int) and abs(value) > 10**18:
        return f"a whole number of about {int(value.bit_length() * math.log10(2.0)) + 1} digits"
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return "a value too long to show"
    return text if len(text) <= most else f"{text[:most]} ..."


def number_in(cell: str) -> float:
    """The number in a cell of a text file: digits 0 to 9, a decimal point, an exponent; also inf and nan.

    Raises
    ------
    ValueError
        for anything else, such as 1_0 or digits of other scripts, which Python would take.
    """
    cell = cell.strip()
    if _NUMBER.fullmatch(cell) or cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return float(cell)
    raise ValueError(f"{cell[:40]!r} is not a number")


def real(value: object, where: str, wanted: str = "a number") -> float:
    """A number of a TOML or JSON file as a float, 0 or within SMALLEST and LARGEST.

    Raises
    ------
    InputError
        if it is none; the sentence begins with `where` and says that it must be `wanted`.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} must be {wanted}, not {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where} must be finite, not {value!r}")
    if abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        limit = f"more than {LARGEST:g}" if abs(value) > LARGEST else f"less than {SMALLEST:g} and not 0"
        raise InputError(f"{where} = {shown(value)} is beyond reason ({limit}); check its unit")
    return float(value)


def shipped_path(name: str) -> Path:
    """The path of a shipped file or folder, e.g. ``data/thesis`` or ``priors/thesis.toml``: in a checkout or a wheel.

    Raises
    ------
    InputError
        if no such file was shipped.
    """
    package = Path(__file__).resolve().parent
    for root in (package / "_shipped", package.parent):
        path = root / name
        if path.exists():
            return path
    raise InputError(f"{name}: this file belongs to bayes_damper but was not found; reinstall the package")
