"""Libraries that read a file of settings from the folder in which a command runs are imported without it.

numba reads .numba_config.yaml there, matplotlib matplotlibrc and ArviZ arvizrc, whoever wrote them: a received folder
would steer a command, and a malformed file end it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType


@contextmanager
def elsewhere() -> Iterator[None]:
    """What is done in here is done in a folder of this package, for the whole process."""
    try:
        here = Path.cwd()
    except OSError:  # a folder that is there no more has no files
        yield
        return
    os.chdir(Path(__file__).parent)
    try:
        yield
    finally:
        with suppress(OSError):
            os.chdir(here)


def unsteered(name: str) -> ModuleType:
    """The module `name`, imported without the settings that the current folder may hold for it."""
    with elsewhere():
        return import_module(name)
