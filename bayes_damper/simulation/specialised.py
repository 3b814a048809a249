"""Kernels: `integrator.advance` for each combination of rig options and effect, compiled and kept on disk.

What differs between them are small functions that `advance` calls and that late_binding.py brings together with it, so
that numba works through `advance` once and LLVM alone once for each kernel: half a second instead of three. Each has a
file of its own in the user's cache folder, so that numba's on-disk cache serves a second start. Its name follows what
the machine code depends on, and nothing of this file but the signatures and options: a change here compiles nothing.
"""

from __future__ import annotations

import bayes_damper.rig.unsteered_numba  # noqa: F401

# isort: split
import gc
import hashlib
import inspect
import multiprocessing
import os
import sys
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba import float64, int64, njit, types

from bayes_damper.effects.base import MOST_PARAMETERS, Variant
from bayes_damper.rig import equations, vector_math
from bayes_damper.rig.cache_folder import cache_folder, mark_used
from bayes_damper.rig.equations import Rig
from bayes_damper.rig.kernels import is_safe
from bayes_damper.runs.content_hash import code_of
from bayes_damper.simulation import integrator, late_binding
from bayes_damper.simulation.composition import sensor_of_three_states

_COUPLES = {"bodies": 0, "interface": 1, "all": 2}
_ROW, _TABLE, _CUBE = float64[::1], float64[:, ::1], float64[:, :, ::1]
_SIGNATURE = (_TABLE, _TABLE, _TABLE, _TABLE, _ROW, _ROW, float64, _ROW, _CUBE, _ROW, int64[::1])
"""Of the arguments of `advance`."""
_P = types.UniTuple(float64, MOST_PARAMETERS)  # type: ignore[no-untyped-call]
_RIG = types.NamedUniTuple(float64, len(Rig._fields), Rig)  # type: ignore[no-untyped-call]
_TWO, _EIGHT = (types.UniTuple(float64, n) for n in (2, 8))  # type: ignore[no-untyped-call]
_MOTION = (float64,) * 7
_SPECIAL: dict[str, Any] = {
    "effect_torque": _TWO(*_MOTION, _P, _RIG),
    "effect_rate": _TWO(*_MOTION, _P, _RIG),
    "effect_start": _TWO(_P, _RIG),
    "effect_sense": _EIGHT(*_MOTION, *(float64,) * 4, _P, float64),
    **dict.fromkeys(("coupled", "pendulum", "linear_normal_force", "frictionless", "driven"), types.boolean()),
    **dict.fromkeys(("prescribed", "swings", "curved", "acts", "timed", "senses", "starts"), types.boolean()),
    **dict.fromkeys(("couples", "memory"), int64()),
    **dict.fromkeys(("memory_scale1", "memory_scale2"), float64()),
}
"""Signatures of what `advance` is specialised in."""
_LOADED: dict[Path, Callable[..., Any]] = {}
"""Kernels of this process by their file: formulas that differ in what is no matter of the kernel share one."""
_SLOW: list[str] = []
"""Why kernels are compiled as one piece each, if they are."""
_NUMBA_OPTIONS: dict[str, Any] = {"fastmath": vector_math.FASTMATH, "error_model": "numpy", "nogil": True}


def specialised_globals(
    coupled: bool,
    linear_normal_force: bool,
    pendulum: bool,
    driven: bool,
    variant: Variant | None,
    prescribed: bool = False,
    swings: bool = False,
    curved: bool = False,
) -> dict[str, Any]:
    """The globals that `advance` reads, for one combination of rig options and effect."""
    bound: dict[str, Any] = {
        "coupled": integrator.constant(coupled),
        "linear_normal_force": integrator.constant(linear_normal_force),
        "pendulum": integrator.constant(pendulum),
        "driven": integrator.constant(driven),
        "prescribed": integrator.constant(prescribed),
        "swings": integrator.constant(swings),
        "curved": integrator.constant(curved),
    }
    if variant is not None:
        hooks = {f"effect_{name}": getattr(variant, name) for name in ("torque", "rate", "start", "sense")}
        scales = (*variant.memory_scale, 1.0, 1.0)
        if variant.sense is not None:
            hooks["effect_sense"] = sensor_of_three_states(variant.sense, variant.sensor_states)
        bound |= {name: hook for name, hook in hooks.items() if hook is not None}
        bound |= {
            "frictionless": integrator.constant(variant.replaces_friction),
            "acts": integrator.constant(variant.torque is not None),
            "couples": integrator.constant(_COUPLES[variant.couples]),
            "timed": integrator.constant(variant.timed),
            "senses": integrator.constant(variant.sense is not None),
            "starts": integrator.constant(variant.start is not None),
            "memory": integrator.constant(variant.memory),
            "memory_scale1": integrator.constant(float(scales[0])),
            "memory_scale2": integrator.constant(float(scales[1])),
        }
    return bound


def _ingredients(name: str, value: Any, files: set[Path], callers: tuple[Any, ...] = ()) -> list[str]:
    """Names and numbers that a kernel uses, itself and through what it calls; `files` gains the sources they stand in.

    So an effect is compiled anew also when a file that it shares with others changes, or a number that a factory of
    kernels has bound.
    """
    if isinstance(value, bool | int | float | str | tuple):
        return [f"{name}={value!r}"]
    if isinstance(value, np.ndarray):
        return [f"{name}={value.dtype}{value.shape}{value.tobytes().hex()}"]
    function = getattr(value, "py_func", None)
    module = value if isinstance(value, ModuleType) else sys.modules.get(getattr(value, "__module__", None) or "")
    source = inspect.getsourcefile(function) if function is not None else getattr(module, "__file__", None)
    path = Path(source) if source else None
    ours = path is not None and path.suffix == ".py" and "site-packages" not in path.parts
    parts = [name]
    if function is not None:  # its module, too: numba imports that where it reads machine code from a file
        parts = [f"{name}:{function.__module__}.{function.__qualname__}:{code_of(function.__code__)}"]
    if path is not None and (function is not None or ours):
        files.add(path)
    if function is not None:
        used = inspect.getclosurevars(function)
        for inner, part in sorted((dict(used.globals) | dict(used.nonlocals)).items()):
            # A kernel may have the name of a field that it reads, and then seems to use itself.
            if part is not value and not any(part is caller for caller in callers):
                parts += _ingredients(f"{name}.{inner}", part, files, (*callers, value))
    return parts


def _fingerprint(bound: dict[str, object]) -> str:
    """A checksum of everything that the machine code depends on, the same for every copy of the package."""
    options = [f"{name}={sorted(v) if isinstance(v, set) else v}" for name, v in _NUMBA_OPTIONS.items()]
    parts = [numba.__version__, np.__version__, repr(_SIGNATURE), repr(_SPECIAL), *options]
    files = {Path(inspect.getfile(module)) for module in (integrator, equations, vector_math, late_binding)}
    for name in sorted(bound):
        parts += _ingredients(name, bound[name], files)
    parts += sorted(f"{path.name}\0{path.read_text(encoding='utf-8')}" for path in files)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:20]


def specialise(bound: dict[str, object], compile: bool = True) -> Callable[..., Any]:  # noqa: A002
    """`advance` bound to these globals: compiled, from numba's on-disk cache when it was compiled before.

    With ``compile=False`` the plain Python function, which tests hold the compiled one against.
    """
    if not compile:
        return FunctionType(integrator.advance.__code__, vars(integrator) | bound)
    path = kernel_file(bound)
    if path not in _LOADED:
        special: dict[str, Any] = {name: (bound.get(name, vars(integrator)[name]), s) for name, s in _SPECIAL.items()}
        try:
            parts = {"advance": _common(), "define": late_binding.definitions(special)}
            _LOADED[path] = _compiled(_in_file(integrator.linked, parts, path))
        except Exception as error:  # noqa: BLE001 (internals of numba may fail in any way)
            for part, signature in special.values():
                part.compile(signature.args)  # what is wrong with an effect is said here, by numba
            _LOADED[path] = _compiled(_in_file(integrator.advance, bound, path))
            _warn_of_slow_compiling(error)
    return _LOADED[path]


def _warn_of_slow_compiling(error: Exception) -> None:
    """One warning a run: not in each worker, and not for each kernel."""
    if _SLOW or multiprocessing.parent_process() is not None:
        return
    _SLOW.append(f"{type(error).__name__}: {error}".splitlines()[0][:200])
    warnings.warn(
        f"numba {numba.__version__} does not link kernels as it is asked to ({_SLOW[0]}): each is compiled as one "
        "piece instead. Results are the same; the first run with an effect takes seconds longer. Install the numba "
        "that constraints.txt names, or report this sentence.",
        RuntimeWarning,
        stacklevel=2,
    )


def compile_common() -> None:
    """Compile what all kernels share (seconds, once on a machine): for who compiles many in several processes."""
    try:
        _compiled(_common())
    except Exception as error:  # noqa: BLE001 (internals of numba may fail in any way)
        _warn_of_slow_compiling(error)


def kernel_file(bound: dict[str, object]) -> Path:
    """The file in which the kernel bound to these globals stands, or would stand; its stem is theirs alone."""
    return cache_folder() / f"advance_{_name(frozenset(bound.items()))}.py"


@lru_cache(maxsize=1024)  # asked for again by what compiles ahead and by each model
def _name(bound: frozenset[tuple[str, object]]) -> str:
    return _fingerprint(dict(bound))


def _common() -> Any:
    """`advance` with nothing said yet, for `linked` to call; compiled when one does that is not on disk."""
    path = cache_folder() / f"common_{_fingerprint({})}.py"
    if path not in _LOADED:
        special = {name: late_binding.declared(name, signature) for name, signature in _SPECIAL.items()}
        _LOADED[path] = _in_file(integrator.advance, special, path, forceinline=True)
    return _LOADED[path]


def _in_file(function: Callable[..., Any], bound: dict[str, object], path: Path, **options: Any) -> Any:
    """A function of the integrator to be compiled, as if it stood in that file: there numba keeps machine code."""
    if not path.exists():
        partial = path.with_suffix(f".{os.getpid()}")
        partial.write_text(inspect.getsource(function), encoding="utf-8")
        partial.replace(path)
    mark_used(path)
    code = function.__code__.replace(co_filename=str(path), co_firstlineno=1)
    python = FunctionType(code, vars(integrator) | bound)
    kernel = njit(cache=True, **_NUMBA_OPTIONS, **options)(python)
    return kernel if is_safe(kernel) else njit(**_NUMBA_OPTIONS, **options)(python)


def _compiled(kernel: Any) -> Any:
    collecting = gc.isenabled()
    gc.disable()  # it would go through numba's millions of objects again and again: a third of the time
    try:
        kernel.compile(_SIGNATURE)
    finally:
        if collecting:
            gc.enable()
    return kernel
