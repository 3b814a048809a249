"""Compiled functions that call what is defined elsewhere: each use has its own, side by side in one process."""

from __future__ import annotations

import numba
import pytest
from numba import float64, int64, njit

from bayes_damper.simulation import late_binding

STEP, COUNT = float64(float64), int64()
step, count = late_binding.declared("test_step", STEP), late_binding.declared("test_count", COUNT)


@njit(forceinline=True)
def large(x):
    for _ in range(count()):
        x = step(x)
    return x


def use(body, number):
    """`large` with its step and its number of steps."""
    own, constant = njit(body), njit(lambda: number)
    define = late_binding.definitions({"test_step": (own, STEP), "test_count": (constant, COUNT)})

    @njit
    def small(x):
        define()
        return large(x)

    return small


def test_each_use_has_its_own_functions():
    assert large(3.0) == 3.0  # nothing defined: no steps
    double, third = use(lambda x: 2.0 * x, 3), use(lambda x: x / 3.0, 2)
    assert double(1.0) == 8.0
    assert third(9.0) == 1.0
    assert double(2.0) == 16.0
    assert large(3.0) == 3.0


def test_nothing_is_left_to_call():
    small = use(lambda x: 2.0 * x, 3)
    small(1.0)
    code = next(iter(small.inspect_llvm().values()))
    assert not [line for line in code.splitlines() if "call" in line and "bayes_damper.test" in line]


def test_a_function_that_gives_another_type_is_cast():
    assert use(lambda x: 7, 1)(1.0) == 7.0


def test_an_error_in_a_function_arises_where_it_is_used():
    def fail(x):
        if x > 2.0:
            raise ValueError("too large")
        return x + 1.0

    careful = use(fail, 3)
    assert careful(-1.0) == 2.0
    with pytest.raises(ValueError, match="too large"):
        careful(1.0)


def test_a_function_that_does_not_fit_is_refused():
    with pytest.raises((numba.NumbaError, NotImplementedError, AttributeError)):
        use(lambda x: "text", 1)(1.0)
