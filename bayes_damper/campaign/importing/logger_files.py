"""What a logger or DAQ system has written (text, MATLAB, JSON, binary forms) as columns of numbers, unconverted.

Nothing here knows of rigs or quantities.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign.importing.logger_columns import TIME_NAMES, LoggerFile, known_units, nearest
from bayes_damper.campaign.importing.logger_formats import channels_of, form_of
from bayes_damper.campaign.importing.logger_text import decoded, read_text
from bayes_damper.campaign.importing.options import ReaderOptions
from bayes_damper.errors import InputError
from bayes_damper.inputs import check_matlab, file_bytes, json_of
from bayes_damper.runs.parallel_map import apart

Arrays = Mapping[str, NDArray[Any]]  # of a MATLAB file
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


def read_file(path: Path, option: ReaderOptions = ReaderOptions(), sha256: str | None = None) -> LoggerFile:  # noqa: B008
    """A logger's file of any form; sha256 : its checksum, if it must have one.

    Raises
    ------
    InputError
        if it cannot be read, is empty, or is not the file that was described.
    """
    try:
        raw = file_bytes(path, remedy="say where the raw files are")
    except FileNotFoundError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); say where the raw files are") from None
    found = hashlib.sha256(raw).hexdigest()
    if sha256 and found != sha256.lower():
        raise InputError(
            f"{path.name}: sha256 is {found[:16]}..., expected {sha256[:16]}...: this is not the file that was "
            "described; get that version, or remove sha256 if the change is meant"
        )
    if not raw.strip():
        raise InputError(f"{path.name}: the file is empty; export it again")
    form = form_of(raw)
    if form is not None:
        return _read_binary(raw, path.name, form, option)
    readers = {".mat": _read_matlab, ".json": _read_json}
    return readers.get(path.suffix.lower(), read_text)(raw, path.name, option)


def _read_binary(raw: bytes, name: str, form: str, option: ReaderOptions) -> LoggerFile:
    """A file of one of logger_formats.FORMS; option: group. The time is column 1 where the file has a clock."""
    channels, notes = channels_of(raw, name, form, option.group)
    columns, names, units = [c.readings for c in channels], [c.name for c in channels], [c.unit for c in channels]
    called = [k for k, n in enumerate(names) if TIME_NAMES.fullmatch(n.rpartition("/")[2])]
    times = channels[0].times
    if times is not None and not called:
        columns, names, units = [times, *columns], ["time", *names], ["s", *units]
    elif called and names[called[0]] != "time":
        names[called[0]] = "time"
    known, unknown = known_units(name, names, units)
    notes += unknown
    with np.errstate(invalid="ignore"):  # a NaN that raises a warning wherever it is used becomes one that does not
        table = np.column_stack(columns) + 0.0
    return LoggerFile(tuple(names), table, known, tuple(notes))


def _read_json(raw: bytes, name: str, _: ReaderOptions) -> LoggerFile:
    """A list of readings, each an object of names and numbers: the file itself, or the one such list that it holds."""
    content = json_of(decoded(raw, name), name, "export it again")
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


def _read_matlab(raw: bytes, name: str, option: ReaderOptions) -> LoggerFile:
    """Time in column 1 where matlab_time is given, then the channels.

    Several arrays of data, and those of a cell array, are joined one below the other, or side by side where each is as
    long as the time.
    """
    import scipy.io  # noqa: F401 (once, here, and not in each forked process)

    try:
        size = check_matlab(raw)
        # Some damaged files end the process that reads them.
        seconds, memory = _MATLAB_SECONDS + len(raw) / _MATLAB_SPEED, _MATLAB_MEMORY + _MATLAB_GROWTH * size
        content = apart(_loaded, raw, seconds=seconds, memory=memory)
    except Exception as error:
        raise InputError(
            f"{name}: not a MATLAB file that can be read ({error}); copy it again, or save it as version 5 or 7"
        ) from error
    parts: list[NDArray[Any]] = []
    for key, names in (("matlab_time", option.matlab_time), ("matlab_data", option.matlab_data)):
        pieces: list[NDArray[Any]] = []
        beside = bool(parts)  # arrays as long as the time are channels of their own, others the pieces of one record
        for variable in names:
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


def _loaded(raw: bytes) -> Arrays:
    from scipy.io import loadmat

    return {key: np.asarray(value) for key, value in loadmat(io.BytesIO(raw)).items() if not key.startswith("__")}


def _arrays(content: Arrays) -> dict[str, tuple[int, ...]]:
    """The arrays of a MATLAB file, those in structures too: path and shape of each."""
    found: dict[str, tuple[int, ...]] = {}
    level = list(content.items())
    while level:
        path, value = level.pop(0)
        if value.dtype.names and value.size == 1:
            level = [(f"{path}.{field}", np.asarray(value[field].ravel()[0])) for field in value.dtype.names] + level
        elif value.size > 1:
            found[path] = value.shape
    return found


def _listed(content: Arrays, most: int = 20) -> str:
    """The arrays of a MATLAB file for a sentence."""
    found = [f"{path} ({' x '.join(map(str, shape))})" for path, shape in _arrays(content).items()]
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(found[:most]) + more if found else "no arrays"


def _variable(content: Arrays, path: str, name: str, key: str) -> NDArray[Any]:
    """A variable of a MATLAB file, or a field of a structure in it: "Theta1.signals.values"."""
    first, *fields = path.split(".")
    found = content.get(first)
    for field in fields:
        inside = found[field] if found is not None and field in (found.dtype.names or ()) else None
        found = inside.ravel()[0] if inside is not None and inside.size == 1 else inside
    if found is None:
        near = nearest(path, list(_arrays(content)))
        hint = f"did you mean '{near}'?" if near else f"correct {key}"
        raise InputError(f"{name}: no variable '{path}'; it holds {_listed(content)}: {hint}")
    return np.asarray(found)


def _pieces(variable: NDArray[Any]) -> list[NDArray[Any]]:
    return [np.asarray(p) for p in variable.ravel()] if variable.dtype == object else [variable]


def _tall(piece: NDArray[Any]) -> NDArray[Any]:
    return piece.T if piece.shape[0] < piece.shape[1] else piece
