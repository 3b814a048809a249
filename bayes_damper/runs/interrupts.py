"""Ctrl-C while a library calls back into Python."""

from __future__ import annotations

import _thread
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_AGAIN_S = 0.1
"""After so long the callback has returned; if another one runs by then, Ctrl-C is sent once more."""


@contextmanager
def interrupts_passed_on() -> Iterator[None]:
    """Sends Ctrl-C again where it came during a callback, such as those of kernels being loaded: errors end there."""
    before = sys.unraisablehook

    def pass_on(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            again = threading.Timer(_AGAIN_S, _thread.interrupt_main)
            again.daemon = True
            again.start()
        else:
            before(lost)

    sys.unraisablehook = pass_on
    try:
        yield
    finally:
        sys.unraisablehook = before
