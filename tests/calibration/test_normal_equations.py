"""Steps within bounds, beside scipy's bounded least squares."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from bayes_damper.calibration.normal_equations import Block, Linear, step_within


@pytest.mark.parametrize("reach", [np.inf, 0.3])
@pytest.mark.parametrize("seed", range(8))
def test_a_step_within_bounds_is_that_of_bounded_least_squares(seed, reach):
    rng = np.random.default_rng(seed)
    n, size, m, data = 4, 3, 5, 30
    J, T, r = rng.standard_normal((n, size, data)), rng.standard_normal((n, m, data)), rng.standard_normal((n, data))
    T[:, 1] = 0.9 * T[:, 0] + 0.1 * T[:, 1]  # two that stand for each other, as an instant and a time of release
    q, eta = rng.standard_normal(size), 0.1 * rng.standard_normal((n, m))
    low, high = eta - 0.1 * rng.random((n, m)), eta + 0.1 * rng.random((n, m))
    group = SimpleNamespace(trials=tuple(range(n)), lower=low, upper=high)
    linear = Linear(q, lambda: (Block(group, r, J, T, eta),))
    (dq,), deta = linear.normal().steps([0.0], reach)
    A = np.zeros((n * data + size + n * m, size + n * m))
    b = np.zeros(len(A))
    for j in range(n):
        rows, own = slice(j * data, (j + 1) * data), slice(size + j * m, size + (j + 1) * m)
        A[rows, :size], A[rows, own], b[rows] = J[j].T, T[j].T, -r[j]
    A[n * data :] = np.eye(size + n * m)
    b[n * data :] = -np.concatenate([q, eta.ravel()])
    far = np.full(size, reach)
    bounds = (np.concatenate([-far, (low - eta).ravel()]), np.concatenate([far, (high - eta).ravel()]))
    exact = lsq_linear(A, b, bounds, method="bvls", tol=1e-14).x
    assert np.count_nonzero(np.isclose(exact, bounds[0]) | np.isclose(exact, bounds[1])) > n
    assert dq == pytest.approx(exact[:size], abs=1e-8)
    assert np.array([deta[j][0] for j in range(n)]).ravel() == pytest.approx(exact[size:], abs=1e-8)
    H = T @ T.transpose(0, 2, 1) + np.eye(m)
    alone = step_within(H, np.einsum("jmd,jd->jm", T, r) + eta, low - eta, high - eta)
    for j in range(n):
        rows = np.concatenate([T[j].T, np.eye(m)])
        left = -np.concatenate([r[j], eta[j]])
        one = lsq_linear(rows, left, ((low - eta)[j], (high - eta)[j]), method="bvls", tol=1e-14).x
        assert alone[j] == pytest.approx(one, abs=1e-8)
