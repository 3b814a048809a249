"""Compiling one large function for many uses: its front end once, then for each use only what differs.

Most of the seconds that numba takes over a large function go into its types and into writing it down for LLVM, which
is the same work for each use. So the large function calls small ones that are only `declared`; a use is a function of
a few lines that says what they are (`definitions`) and calls the large one. LLVM then has all of it in one module: it
puts the small functions where they are called, folds constants, drops what they rule out and vectorises the rest, as
if the large function had been written for that use.

This leans on internals of numba and llvmlite, which are imported where they are used: where a new version has others,
`specialised.specialise` says so and compiles each use as one piece.
"""

from __future__ import annotations

import bayes_damper.rig.unsteered_numba  # noqa: F401

# isort: split
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from numba import types
from numba.extending import intrinsic


def declared(name: str, signature: Any) -> Any:
    """A function for compiled code that is defined elsewhere; signature : numba's, e.g. float64(float64, int64).

    Where nothing defines it, it gives zeros: the large function alone is complete, if of no use.
    """

    def call(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        from llvmlite import ir

        function = _function(context, builder, name, signature)
        if function.is_declaration:
            function.linkage = "linkonce"  # LLVM may assume nothing about its body: another can take its place
            neutral = ir.IRBuilder(function.append_basic_block())
            neutral.ret(ir.Constant(function.function_type.return_type, 0))
        status, value = context.call_conv.call_function(builder, function, signature.return_type, signature.args, args)
        with builder.if_then(status.is_error, likely=False):
            context.call_conv.return_status_propagate(builder, status)
        return value

    return _intrinsic(call, signature)


def definitions(functions: Mapping[str, tuple[Any, Any]]) -> Any:
    """A call for compiled code that defines declared functions for all that is linked with it.

    functions : name -> compiled function and signature. The large function has to be compiled with `forceinline`, as
    these are: in the machine code of several uses the same name stands for different things, so none may be called.
    """

    def define(context: Any, builder: Any, _: Any, __: Any) -> Any:
        from llvmlite import ir

        for name, (compiled, signature) in functions.items():
            result = compiled.get_compile_result(signature)
            context.add_linking_libs([result.library])
            function = _function(context, builder, name, signature)
            function.linkage = "weak_odr"  # stronger than that of the neutral one
            function.attributes.add("alwaysinline")
            body = ir.IRBuilder(function.append_basic_block())
            args = context.call_conv.decode_arguments(body, signature.args, function)
            value = context.call_internal(body, result.fndesc, result.signature, args)
            value = context.cast(body, value, result.signature.return_type, signature.return_type)
            returned = context.get_return_value(body, signature.return_type, value)
            context.call_conv.return_value(body, returned)
        return context.get_dummy_value()

    return _intrinsic(define, types.none())


def _function(context: Any, builder: Any, name: str, signature: Any) -> Any:
    """The function of that name in the module that is being built."""
    from numba.core import cgutils

    kind = context.call_conv.get_function_type(signature.return_type, signature.args)
    return cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
        builder.module, kind, f"bayes_damper.{name}"
    )


def _intrinsic(build: Callable[..., Any], signature: Any) -> Any:
    """What compiled code calls with these types, and `build` writes."""

    def typed(*_: Any) -> Any:
        return signature, build

    names = ("typing_context", *(f"x{i}" for i in range(len(signature.args))))
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    typed.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in names])  # type: ignore[attr-defined]
    return intrinsic(typed)
