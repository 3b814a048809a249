"""What `init` takes where no columns are named: those of each file, if only one choice is left, and its time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayes_damper.campaign.importing.logger_files import read_file
from bayes_damper.campaign.importing.options import ReaderOptions
from bayes_damper.errors import InputError
from bayes_damper.rig.units import BODIES

LEAST_KNOWN = 0.5  # share of a file's lines that must hold readings
_SINGLE = "One channel only, so taken as uncoupled: {}. If that is wrong, use --pattern or --sheet."
_ALL_COUPLED = (
    "Every file has two channels, so all trials are taken as coupled. If that is wrong, use --configuration, --pattern "
    "or --sheet."
)


class Guess(NamedTuple):
    """Columns of the channels and the time, from 1, and the words for them."""

    columns: tuple[int, ...]
    time: int | None
    words: str

    @property
    def configuration(self) -> str:
        """What trials with these columns are where nothing else says so."""
        return "coupled" if len(self.columns) == 2 else "uncoupled"

    @property
    def keys(self) -> dict[str, object]:
        """The columns as keys of the table."""
        return {"columns": list(self.columns)} | ({} if self.time is None else {"time": self.time})


def columns_of(path: str | Path) -> str:
    """A sentence that numbers the columns of a logger's file, for whoever has to name them.

    Raises
    ------
    InputError
        if it cannot be read.
    """
    source = read_file(Path(path))
    numbered = [f"{i} {name}".strip() for i, name in enumerate(source.names or ("",) * source.table.shape[1], start=1)]
    return f"{Path(path).name} has the columns: {', '.join(numbered)}"


def file_names(names: Sequence[str]) -> str:
    """File names for a sentence, a few at most."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} other files"


def guessed_all(
    paths: Sequence[Path], given: ReaderOptions, kind: str, caveats: list[str], declared: bool
) -> dict[Path, dict[str, object]]:
    """Keys of the columns where only one choice is left, for all files under `Path()`, else for each file.

    declared : whether something else says which trials are coupled. Where nothing does and some files hold one channel
    and others two, the former are uncoupled.
    """
    found = {path: _guessed(path, given, kind) for path in paths}
    first = found[paths[0]]
    if all(other == first for other in found.values()):
        caveats.append(f"No columns were named; used: {first.words}.")
        if len(first.columns) == 2 and not declared:
            caveats.append(_ALL_COUPLED)
        return {Path(): first.keys}
    for words in dict.fromkeys(guess.words for guess in found.values()):
        where = [path.name for path, guess in found.items() if guess.words == words]
        caveats.append(f"No columns were named; used from {file_names(where)}: {words}.")
    single = [path.name for path, guess in found.items() if len(guess.columns) == 1]
    if declared or len(single) in (0, len(found)):
        return {path: guess.keys for path, guess in found.items()}
    caveats.append(_SINGLE.format(file_names(single)))
    return {path: guess.keys | {"configuration": guess.configuration} for path, guess in found.items()}


def guessed_time(paths: Sequence[Path], given: ReaderOptions, caveats: list[str]) -> int | None:
    """The column of the time where none was named and all files have the same one, beside the named channels."""
    found, chosen, named = set[int | None](), "", True
    for path in paths:
        source = read_file(path, given)
        time = source.time_column()
        named = named and time is not None and source.called_time(time)
        try:
            taken = [source.index(c, path.name) for c in given.columns]
        except InputError:
            taken = []  # a channel that this file lacks: the reader says so, or the trial is uncoupled
        found.add(None if time is None or time in taken else time + 1)
        chosen = chosen or ("" if time is None else source.column(time))
    if len(found) != 1 or None in found:
        return None
    if not named:
        caveats.append(f"No time column was named; used: {chosen}.")
    return found.pop()


def uncoupled_in(paths: Sequence[Path], given: ReaderOptions, caveats: list[str]) -> list[Path]:
    """Files that lack the second of two named columns, so that their trials are uncoupled."""
    out = []
    for path in paths:
        source = read_file(path, given)
        try:
            source.index(given.columns[1], path.name)
        except InputError:
            out.append(path)
    if len(out) == len(paths):
        return []  # then the name of the column is wrong, which the reader says
    caveats.append(_SINGLE.format(file_names([path.name for path in out])) if out else _ALL_COUPLED)
    return out


def _guessed(path: Path, given: ReaderOptions, kind: str) -> Guess:
    """The columns of a file where only one choice is left.

    A column that never changes (a temperature, a counter that stands) is no channel where others are left.
    """
    source = read_file(path, given)
    time = None if given.sample_rate is not None else source.time_column()
    if given.time is not None:
        time = source.index(given.time, path.name)
    readings = [
        i for i in range(source.table.shape[1]) if i != time and np.mean(np.isfinite(source.table[:, i])) > LEAST_KNOWN
    ]
    moving = [i for i in readings if np.nanmax(source.table[:, i]) > np.nanmin(source.table[:, i])]
    readings = moving or readings
    if len(readings) not in (1, 2) or (time is None and given.sample_rate is None):
        raise InputError(
            f"{path.name}: has {source.described()}; name the channels with --columns, the primary first, and the time "
            "with --time (or give --sample-rate)"
        )
    taken = [f"{source.column(i)} for {who}" for i, who in zip(readings, BODIES[kind], strict=False)]
    if time is not None:
        taken.append(f"{source.column(time)} for the time")
    columns = tuple(i + 1 for i in readings)
    return Guess(columns, None if time is None else time + 1, ", ".join(taken))
