"""Compiling loops over records, with the machine code kept on disk where there is a place for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: numba's, without the interpreter's lock, kept on disk; compiled in every process where it cannot be.

    options : further ones of numba.njit, e.g. fastmath.
    """
    usual: dict[str, Any] = {"nogil": True, "error_model": "numpy"} | options

    def compile_it(function: Callable[..., Any]) -> Any:
        try:
            return njit(function, cache=True, **usual)
        except RuntimeError:  # numba found nowhere to write to
            return njit(function, **usual)

    return compile_it
