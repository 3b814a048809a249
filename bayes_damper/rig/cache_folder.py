"""Where compiled kernels are kept: a folder that nobody else can have written to, since machine code is run as it lies.

numba keeps compiled code as pickles, and whoever can change a pickle decides what runs when it is read. So a folder is
used only when it and all files in it belong to the user and nobody else may write them. Otherwise kernels are compiled
anew, in a folder that only the user can enter. What no run has used for KEPT days is deleted: each version of the
package, and each learnt law, leaves some.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_VARIABLE = "BAYES_DAMPER_CACHE"
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_MACHINE_CODE = "__pycache__"  # where numba puts it
KEPT = 90  # days since a kernel was used, after which it is deleted
_DAY = 86_400.0  # s


def cache_folder() -> Path:
    """Where compiled kernels are kept: BAYES_DAMPER_CACHE, else the user's cache folder.

    Where that cannot be written, or others can have written to it, a private one below the system's folder of temporary
    files, with a sentence.
    """
    given = os.environ.get(_VARIABLE)
    base = Path(given) if given else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bayes_damper"
    return _usable(base)


@cache
def _usable(base: Path) -> Path:
    """The folder, if it is safe, else a private one; judged once in a process, not again by those that it starts."""
    reason = _unfit(base)
    if reason is None:
        _forget(base)
        return base
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"bayes_damper-{user}"
    if _unfit(folder) is not None:
        folder = Path(tempfile.mkdtemp(prefix="bayes_damper-"))  # mode 700
        (folder / _MACHINE_CODE).mkdir(mode=0o700)
        owner = os.getpid()
        atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    os.environ[_VARIABLE] = str(folder)
    sys.stderr.write(f"bayes-damper: {reason}. Compiled code is kept in {folder} instead.\n")
    return folder


def mark_used(kernel: Path) -> None:
    """Keep a kernel's file for KEPT days more. By its access time: by the other, numba knows machine code from it."""
    with contextlib.suppress(OSError):
        os.utime(kernel, ns=(time.time_ns(), kernel.stat().st_mtime_ns))


def _forget(base: Path) -> None:
    """Delete kernels that have not been used for long, with their machine code."""
    before = time.time() - KEPT * _DAY
    for path in base.glob("*.py"):
        with contextlib.suppress(OSError):  # another process has just deleted it, too
            found = path.stat()
            if max(found.st_atime, found.st_mtime) < before:
                for code in (base / _MACHINE_CODE).glob(f"{path.stem}.*"):
                    code.unlink()
                path.unlink()


def _unfit(base: Path) -> str | None:
    """Why compiled code cannot be kept in a folder, or must not be taken from it; None for a good one, now made."""
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        for folder in (base, base / _MACHINE_CODE):
            folder.mkdir(mode=0o700, exist_ok=True)
        found = next(distrusted(base), None)
        if found is not None:
            return f"{base}: compiled code there is not used, because {found}; delete that folder to have it made anew"
        with tempfile.TemporaryFile(dir=base):
            return None
    except OSError as error:
        return f"{base}: compiled code cannot be kept there ({error.strerror or error})"


def distrusted(base: Path) -> Iterator[str]:
    """Why a folder of compiled code must not be used: who else can have written what, one reason each.

    Of folders above it only those count in which anybody may exchange anything. Where files have no owner (Windows),
    the user's profile guards them and nothing is looked at.
    """
    if not hasattr(os, "getuid"):
        return
    user = os.getuid()
    for above in (path for path in base.resolve().parents if path.exists()):
        mode = above.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            yield f"anybody may exchange what lies in {above}"
    for folder in (base.resolve(), base / _MACHINE_CODE):
        if not folder.exists():
            continue
        yield from _reasons(folder, user, closed=False)
        closed = not folder.lstat().st_mode & (stat.S_IXGRP | stat.S_IXOTH)
        for path in folder.iterdir():
            if path.name != _MACHINE_CODE:
                yield from _reasons(path, user, closed)


def _reasons(path: Path, user: int, closed: bool) -> Iterator[str]:
    """Closed : whether only the owner can enter the folder of a file, so that its own mode lets nobody else write."""
    try:
        found = path.lstat()
    except FileNotFoundError:  # another process has just replaced it
        return
    if found.st_uid != user:
        yield f"{path} belongs to another user"
    elif stat.S_ISLNK(found.st_mode):
        yield f"{path} is a link to another place"
    elif found.st_mode & _OTHERS_WRITE and not closed:
        yield f"others may write {path}"
