"""Compiling loops over records, with the machine code kept on disk where there is a place for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import bayes_damper.rig.unsteered_numba  # noqa: F401

# isort: split
from numba import njit

from bayes_damper.rig.cache_folder import distrusted

_PACKAGE = Path(__file__).resolve().parents[1]


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: numba's, without the interpreter's lock, kept on disk; compiled in every process where it cannot be.

    options : further ones of numba.njit, e.g. fastmath.
    """
    usual: dict[str, Any] = {"nogil": True, "error_model": "numpy"} | options

    def compile_it(function: Callable[..., Any]) -> Any:
        try:
            kernel = njit(function, cache=True, **usual)
        except RuntimeError:  # numba found nowhere to write to
            return njit(function, **usual)
        return kernel if is_safe(kernel) else njit(function, **usual)

    return compile_it


def is_safe(kernel: Any) -> bool:
    """Whether the machine code of a kernel lies beside its source, or where nobody else can have written."""
    return _nobody_else_writes(Path(kernel._cache.cache_path))  # noqa: SLF001


@cache
def _nobody_else_writes(folder: Path) -> bool:
    return _PACKAGE in folder.parents or next(distrusted(folder), None) is None
