"""Compiling loops over records, with the machine code kept on disk where there is a place for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

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
        return kernel if _is_safe(Path(kernel._cache.cache_path)) else njit(function, **usual)  # noqa: SLF001

    return compile_it


@cache
def _is_safe(folder: Path) -> bool:
    """Whether machine code may be taken from there: beside the source, or where nobody else can have written."""
    return _PACKAGE in folder.parents or next(distrusted(folder), None) is None
