"""How often Python looks for dead objects that refer to each other.

Importing the libraries and drawing figures makes a million objects that live on. Looked at whenever 700 have been
added, as Python does by default, and once more when the process ends, they cost a fit of one record two of its eight
seconds.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = (50_000, 5, 5)
"""New objects until the youngest are looked at; how many such looks until the older, and the oldest, are."""


def collect_seldom() -> None:
    """From now on, in this process; at its end not at all: all memory goes back at once."""
    gc.set_threshold(*SELDOM)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


@contextmanager
def seldom_collected() -> Iterator[None]:
    """For as long as the context lasts, and at the end of the process."""
    before = gc.get_threshold()
    collect_seldom()
    try:
        yield
    finally:
        gc.set_threshold(*before)
