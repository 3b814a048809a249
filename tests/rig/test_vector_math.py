"""Elementary functions of the kernels: their stated errors, against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from bayes_damper.rig import vector_math


def _apply(function, x):
    @njit
    def loop(x):
        y = np.empty_like(x)
        for i in range(x.size):
            y[i] = function(x[i])
        return y

    return loop(x)


def _grid(low, high):
    return np.concatenate([np.linspace(low, high, 20_001), np.random.default_rng(1).uniform(low, high, 20_000)])


def test_tanh_keeps_its_stated_error_and_is_odd_and_bounded():
    x = np.concatenate([_grid(-25.0, 25.0), _grid(-1e-3, 1e-3), [0.0, 1e300, -1e300, 1e-300]])
    y = _apply(vector_math.tanh, x)
    assert np.abs(y - np.tanh(x)).max() < 2e-14
    assert _apply(vector_math.tanh, np.zeros(1))[0] == 0.0
    assert np.abs(y).max() <= 1.0


def test_scaled_tanh_is_tanh():
    x = _grid(-5.0, 5.0)
    assert np.abs(_apply(vector_math.tanh_scaled, vector_math.TANH_SCALE * x) - np.tanh(x)).max() < 2e-14


CURVES = {0.0: np.tanh, 0.5: lambda x: x / np.hypot(1.0, x), 1.0: lambda x: 2.0 / np.pi * np.arctan(0.5 * np.pi * x)}


def _sign(x, tail):
    """At x, with a tail that all x share."""
    return _apply(vector_math.lane(lambda v: vector_math.smooth_sign(v, tail)), x)


@pytest.mark.parametrize("tail", CURVES)
def test_the_sign_of_dry_friction_is_one_of_three_curves(tail):
    x = np.concatenate([_grid(-5.0, 5.0), _grid(-1e3, 1e3), [0.0, 1e12, -1e12]])
    assert np.abs(_sign(x, tail) - CURVES[tail](x)).max() < (1.3e-5 if tail else 4e-14)
    assert _sign(np.zeros(1), tail)[0] == 0.0


@pytest.mark.parametrize("tail", [-0.3, 0.2, 0.8, 1.3])
def test_between_the_curves_lies_the_parabola_through_them(tail):
    x = _grid(-8.0, 8.0)
    expected = np.polyval(np.polyfit([*CURVES], [curve(x) for curve in CURVES.values()], 2), tail)
    assert np.abs(_sign(x, tail) - expected).max() < 5e-5
    assert (np.diff(_sign(np.linspace(0.0, 1.5, 200), tail)) > 0.0).all()


@pytest.mark.parametrize("tail", [0.0, 0.4, 1.0])
def test_the_slope_of_that_sign_is_its_derivative(tail):
    x = _grid(-6.0, 6.0)
    scale = vector_math.TANH_SCALE
    slope = _apply(vector_math.lane(lambda v: vector_math.smooth_sign_scaled(scale * v, tail)[1]), x)
    assert np.abs(slope - (_sign(x + 1e-6, tail) - _sign(x - 1e-6, tail)) / 2e-6).max() < 1e-7


def test_exp_keeps_its_stated_error():
    near, far = _grid(-1.0, 1.0), _grid(-690.0, 690.0)
    assert np.abs(_apply(vector_math.exp, near) / np.exp(near) - 1.0).max() < 1e-15
    assert (np.abs(_apply(vector_math.exp, far) / np.exp(far) - 1.0) / np.maximum(np.abs(far), 1.0)).max() < 2e-15
    assert _apply(vector_math.exp, np.array([0.0]))[0] == 1.0


def test_log_keeps_its_stated_error():
    x = np.exp(_grid(-600.0, 600.0))
    assert np.abs(_apply(vector_math.log, x) - np.log(x)).max() < 5e-13
    near = _grid(0.5, 2.0)
    assert np.abs(_apply(vector_math.log, near) - np.log(near)).max() < 3e-16
    assert _apply(vector_math.log, np.array([1.0]))[0] == 0.0


@pytest.mark.parametrize(("ours", "numpys"), [(vector_math.sin, np.sin), (vector_math.cos, np.cos)])
def test_sine_and_cosine_agree_with_numpy(ours, numpys):
    assert np.abs(_apply(ours, _grid(-10.0, 10.0)) - numpys(_grid(-10.0, 10.0))).max() < 3e-15
    wide = _grid(-1e5, 1e5)
    assert np.abs(_apply(ours, wide) - numpys(wide)).max() < 5e-11


def test_fourth_root_is_good_to_four_percent():
    x = np.exp(_grid(-18.0, 18.0))
    assert np.abs(_apply(vector_math.fourth_root_of_inverse, x) * x**0.25 - 1.0).max() < 0.05
