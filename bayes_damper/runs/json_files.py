"""Files of results: text and JSON written whole, so that a reader sees the old or the new one, and read back."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper.errors import InputError
from bayes_damper.inputs import file_bytes, json_of, text_of

LOG = logging.getLogger(__name__)


def folder_name(case: str) -> str:
    """The folder of a case: its label where that is a plain word, else one that no file system minds."""
    if re.fullmatch(r"[\w-]+", case):
        return case
    return re.sub(r"[^\w-]+", "_", case) + "-" + hashlib.sha256(case.encode(errors="surrogatepass")).hexdigest()[:6]


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write a file so that a reader sees either the old or the new one, whole; its folder is made.

    A file that could not be written to its end is removed and leaves the old one in place.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file so that a reader sees either the old or the new one, whole; its folder is made."""
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")
    LOG.debug("wrote %s, %d characters", path, len(text))


def json_text(data: Any) -> str:
    """JSON as every file and `--json` have it: null in place of numbers that are not finite, which JSON cannot hold."""
    return json.dumps(plain(data), indent=1, allow_nan=False)


def write_json(path: Path, data: Any) -> None:
    """Write JSON so that a reader sees either the old or the new file, whole."""
    write_text(path, json_text(data) + "\n")


def plain(x: Any) -> Any:
    """Data as JSON takes it: arrays as lists, and null in place of numbers that are not finite."""
    if isinstance(x, Mapping):
        return {str(key): plain(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [plain(value) for value in x]
    if isinstance(x, np.ndarray):
        return plain(x.tolist())
    if isinstance(x, np.generic):
        return plain(x.item())
    return None if isinstance(x, float) and not math.isfinite(x) else x


def read_json(path: Path) -> Any:
    """Contents of a JSON file.

    Raises
    ------
    InputError
        if the file is missing or is not JSON.
    """
    remedy = "run the command that wrote it again"
    try:
        return json_of(text_of(file_bytes(path, remedy=remedy), str(path)), str(path), remedy)
    except FileNotFoundError:
        hint = "name a folder that bayes-damper has written"
        if path.name == "run.json":
            hint = "no run in that folder can go on; begin it again with its own command"
        elif (path.parent / "run.json").is_file():
            hint = f"the run in that folder has not ended; go on with: bayes-damper resume {path.parent}"
        raise InputError(f"{path}: there is no such file; {hint}") from None
