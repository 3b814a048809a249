"""Files of a campaign as bytes and text, with what to say when one is absent or no text."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from bayes_damper.inputs import collected, file_bytes, text_of


def nearest_name(word: str, names: Iterable[str]) -> str:
    """A hint for a word that is none of the names: the one that was meant, or all of them."""
    found = difflib.get_close_matches(word[:60], list(names), 1, 0.5)
    return f"did you mean '{found[0]}'?" if found else f"valid names: {', '.join(names)}"


def read_bytes(path: Path, name: str, faults: list[str], digest: hashlib._Hash) -> bytes | None:
    """The bytes of a file, with `digest` fed; None, and a fault, if it cannot be read."""
    raw = None
    try:
        with collected(faults):
            raw = file_bytes(path, name)
    except FileNotFoundError:
        near = _nearest_file(path)
        hint = f"did you mean {near}?" if near else "put it into the campaign's folder or correct the name"
        faults.append(f"{name}: no such file; {hint}")
    if raw is None:
        return None
    digest.update(raw)
    if not raw.strip():
        faults.append(f"{name}: the file is empty; export it again")
        return None
    return raw


def read_text(path: Path, name: str, faults: list[str], digest: hashlib._Hash) -> str | None:
    """The text of a file, with `digest` fed; None, and a fault, if it cannot be read or is no text."""
    raw = read_bytes(path, name, faults, digest)
    return None if raw is None else decoded(raw, name, faults)


def _nearest_file(path: Path) -> str | None:
    """The file that a name may mean: the same with other letters, or with / between the folders."""
    wanted = PurePosixPath(path.as_posix().replace("\\", "/"))
    place = Path(wanted.parent)
    names = sorted(p.name for p in place.iterdir() if p.is_file()) if place.is_dir() else []
    same = [n for n in names if n.lower() == wanted.name.lower()] or difflib.get_close_matches(
        wanted.name, names, 1, 0.9
    )
    return f"{place.name}/{same[0]}" if same else None


def decoded(raw: bytes, name: str, faults: list[str]) -> str | None:
    """The text of a file; None, and a fault, if it is no text."""
    with collected(faults):
        return text_of(raw, name)
    return None
