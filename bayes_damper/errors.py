"""What can go wrong in front of a user, and the exit code that each kind of ending has.

Every message is a sentence that says what is wrong, where, and what to do.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path

_LONGEST = 4000  # characters of a sentence
_OF_THE_DISK = (errno.ENOSPC, errno.EROFS, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC))


class ExitCode(IntEnum):
    """How a command ended."""

    DONE = 0
    BAD_INPUT = 2
    NOT_CONVERGED = 3
    SELF_CHECK_FAILED = 4
    INTERRUPTED = 130


class UnitFault(str):
    """A sentence on readings of a size that they cannot have: they may be in another unit than they were taken for."""

    __slots__ = ()


class BayesDamperError(Exception):
    """Base of all errors that are meant for the user's eyes."""

    exit_code = ExitCode.BAD_INPUT


class InputError(BayesDamperError):
    """Something that the user gave cannot be used; `faults` holds one sentence for each thing that is wrong."""

    exit_code = ExitCode.BAD_INPUT

    def __init__(self, faults: str | Sequence[str]) -> None:
        sentences = (faults,) if isinstance(faults, str) else tuple(faults)
        self.faults: tuple[str, ...] = tuple(map(_readable, sentences))
        super().__init__("\n".join(self.faults))


def _readable(sentence: str) -> str:
    """A sentence for a terminal: what it quotes from a file may be long, or hold what steers the terminal."""
    if len(sentence) > _LONGEST:
        sentence = f"{sentence[: _LONGEST // 2]} ... {sentence[-_LONGEST // 2 :]}"
    return type(sentence)(printable(sentence))


def printable(text: str) -> str:
    """A text without characters that steer a terminal, or that cannot be written: each as Python would escape it."""
    return text if text.isprintable() else "".join(
        c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text
    )  # fmt: skip


class SelfCheckError(BayesDamperError):
    """A check that the tool makes on itself failed: a broken seal, an accuracy bound missed."""

    exit_code = ExitCode.SELF_CHECK_FAILED


class Interrupted(BayesDamperError):
    """The user stopped a run; its state has been saved."""

    exit_code = ExitCode.INTERRUPTED


@contextmanager
def as_written(path: Path | str, command: str) -> Iterator[None]:
    """For taking results out of a file that `command` wrote: what cannot be taken is a sentence about that file."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError, OSError) as error:
        if isinstance(error, OSError) and error.errno in _OF_THE_DISK:
            raise
        raise InputError(
            f"{path}: damaged, or not what `bayes-damper {command}` writes ({in_words(error)[:120]}); run that command "
            "again"
        ) from error


def in_words(error: Exception) -> str:
    """What is wrong with a file of results in which Python ran into this error."""
    if isinstance(error, KeyError):
        return f"{error} is missing"
    if isinstance(error, AttributeError | TypeError | IndexError):
        return "an entry is of another kind, or shorter, than it was written"
    return str(error).replace("\n", " ")
