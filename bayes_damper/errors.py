"""What can go wrong in front of a user, and the exit code that each kind of ending has.

Every message is a sentence that says what is wrong, where, and what to do.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

_LONGEST = 4000  # characters of a sentence


class ExitCode(IntEnum):
    """How a command ended."""

    DONE = 0
    BAD_INPUT = 2
    NOT_CONVERGED = 3
    SELF_CHECK_FAILED = 4
    INTERRUPTED = 130


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
    return printable(sentence)


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
