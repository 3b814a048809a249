"""A checksum of what a computation is given: the same values have the same one in any process."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from types import CodeType
from typing import Any

import numpy as np


def content_sha256(*values: Any) -> str:
    """Checksum of plain values, arrays, mappings, sequences, data classes and functions, whatever they hold.

    A function counts with its code and all that it is bound to: two that a factory makes differ by that alone.

    Raises
    ------
    TypeError
        for anything else, since two of them that differ would have the same.
    """
    digest = hashlib.sha256()
    for value in values:
        _add(value, digest.update)
    return digest.hexdigest()


def code_of(code: CodeType) -> str:
    """A checksum of what a function does: two that a factory makes may share name, file and all that they use."""
    constants = [code_of(c) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    used = (constants, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return hashlib.sha256(code.co_code + repr(used).encode()).hexdigest()


def _add(value: Any, update: Callable[[bytes], None]) -> None:
    kind = type(value)
    update(f"{kind.__module__}.{kind.__qualname__}(".encode())
    function = getattr(value, "py_func", value)  # of a compiled one
    if value is None or isinstance(value, bool | int | float | str | np.generic):
        update(repr(value).encode())
    elif isinstance(value, np.ndarray):
        update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            _add(key, update)
            _add(inner, update)
    elif isinstance(value, tuple | list):
        for inner in value:
            _add(inner, update)
    elif is_dataclass(value):
        for part in fields(value):
            _add(getattr(value, part.name), update)
    elif inspect.isfunction(function):
        update(f"{function.__module__}.{function.__qualname__}:{code_of(function.__code__)}".encode())
        _add([cell.cell_contents for cell in function.__closure__ or ()], update)
        _add([function.__defaults__, function.__kwdefaults__], update)
    else:
        raise TypeError(f"no checksum of a {kind.__qualname__}")
    update(b")")
