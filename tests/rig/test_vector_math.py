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
