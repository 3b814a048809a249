"""The state of a long run on disk: written whole or not at all, checked when read, refused when it is another run's.

A folder holds the last two states, `state-000017.npz` and so on. Each is written under another name, flushed to the
disk and then renamed, and begins with the SHA-256 of what follows, so that a kill at any moment leaves at least one
good state. The arrays and the JSON record inside go in and come out bit for bit; nothing is pickled.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import InputError
from bayes_damper.runs.json_files import whole

_KEPT = 2
_RECORD = "__record__"


class Checkpoint:
    """States of one run in `folder`.

    fingerprint : what decides the result (model, prior, data, seed, package version ...), name -> value as text. A
    state with another fingerprint is refused. every : least seconds between two timed saves.
    """

    def __init__(self, folder: Path | str, fingerprint: Mapping[str, str], every: float = 3.0) -> None:
        self.folder = Path(folder)
        self.fingerprint = {str(k): str(v) for k, v in fingerprint.items()}
        self.every = every
        self._last = time.monotonic()
        self._cost = 0.0

    def bound_to(self, more: Mapping[str, str]) -> Checkpoint:
        """The same folder with further entries in the fingerprint."""
        return Checkpoint(self.folder, {**self.fingerprint, **more}, self.every)

    def due(self) -> bool:
        """Whether it is time to save: `every` seconds after the last save, less often when saving takes long."""
        return time.monotonic() - self._last >= max(self.every, 20.0 * self._cost)

    def save(self, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, object]) -> None:
        """Writes a state: named arrays and a JSON record. The oldest beyond the last two is removed."""
        begun = time.monotonic()
        self.folder.mkdir(parents=True, exist_ok=True)
        known = self._states()
        number = 1 + (_number(known[0]) if known else 0)
        write_whole(
            self.folder / f"state-{number:06d}.npz", arrays, {"fingerprint": self.fingerprint, "record": record}
        )
        for old in self._states()[_KEPT:]:
            old.unlink(missing_ok=True)
        for left in self.folder.glob("state-*.partial"):
            left.unlink(missing_ok=True)
        self._last = time.monotonic()
        self._cost = self._last - begun

    def load(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
        """Arrays and record of the newest state that is whole, or None where there is no state.

        Raises InputError when the fingerprint differs (with each difference), or when no state is whole.
        """
        states = self._states()
        for path in states:
            content = read_whole(path)
            if content is None or not all(isinstance(content[1].get(k), dict) for k in ("fingerprint", "record")):
                continue
            arrays, outer = content
            faults = self._differences(outer["fingerprint"])
            if faults:
                raise InputError(faults)
            return arrays, outer["record"]
        if states:
            raise InputError(
                f"{self.folder}: none of the saved states ({', '.join(p.name for p in states)}) is intact; "
                "delete the folder and start the run again."
            )
        return None

    def _states(self) -> list[Path]:
        return sorted(self.folder.glob("state-*.npz"), key=_number, reverse=True)

    def _differences(self, saved: Mapping[str, str]) -> list[str]:
        keys = [*self.fingerprint, *(k for k in saved if k not in self.fingerprint)]
        return [
            f"{self.folder}: cannot go on, {key} was {saved.get(key, 'absent')} when the run began and is "
            f"{self.fingerprint.get(key, 'absent')} now; restore it, or start anew in another folder."
            for key in keys
            if saved.get(key) != self.fingerprint.get(key)
        ]


def _number(path: Path) -> int:
    digits = path.stem.rpartition("-")[2]
    return int(digits) if digits.isdigit() else 0


def write_whole(
    path: Path, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, object], flush: bool = True
) -> None:
    """Named arrays and a JSON record in a file that is there whole or not at all, with its checksum at the front.

    flush : to the disk, where it outlives a loss of power; else it may be found torn then, and is not read.
    """
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(record).encode(), dtype=np.uint8)
    np.savez(buffer, **{_RECORD: text}, **dict(arrays))  # type: ignore[arg-type]
    payload = buffer.getvalue()
    with whole(path) as partial, partial.open("wb") as file:
        file.write(hashlib.sha256(payload).digest())
        file.write(payload)
        if flush:
            file.flush()
            os.fsync(file.fileno())


def read_whole(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Arrays and record of such a file, or None when it is not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, payload = content[:32], content[32:]
    if hashlib.sha256(payload).digest() != digest:
        return None
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as packed:
            if any(part.compress_type != zipfile.ZIP_STORED for part in packed.infolist()):
                return None
        with np.load(io.BytesIO(payload), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return arrays, dict(json.loads(arrays.pop(_RECORD).tobytes().decode()))
    except (ValueError, LookupError, TypeError, EOFError, RecursionError, zipfile.BadZipFile):
        return None  # not written here, checksum or not
