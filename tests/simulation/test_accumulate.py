"""Sums taken in the block against numpy on the records of `simulate`."""

from __future__ import annotations

import numpy as np
import pytest
import reference

from bayes_damper.runs.outcome import Outcome
from bayes_damper.simulation.accumulate import AUTOREGRESSIVE, GAUSSIAN, STUDENT
from bayes_damper.simulation.model import Model

TIMES = np.arange(0.0, 0.1235, 1e-3)
TABLE = reference.BASE | reference.draw(20, 6)


@pytest.fixture(scope="module")
def residuals():
    """Data with a gap, the residuals of 20 vectors (zero in the gap) and where there are data."""
    y = Model().simulate(TABLE, TIMES).y
    data = y[3] + np.random.default_rng(0).normal(0.0, 2.0, y[3].shape)
    data[1, 30:41] = np.nan
    there = np.isfinite(data)
    return data, np.where(there, data - y, 0.0), there


def test_gaussian_sums_and_directions(residuals):
    data, r, _ = residuals
    directions = np.random.default_rng(1).normal(size=(3, *data.shape))
    got = Model().accumulate(TABLE, TIMES, data, GAUSSIAN, directions=directions)
    assert (got.outcome == Outcome.COMPLETED).all()
    np.testing.assert_allclose(got.sums[:, :, 0], (r**2).sum(axis=2), rtol=1e-12)
    np.testing.assert_allclose(got.sums[:, :, 1:], np.einsum("nct,kct->nck", r, directions), rtol=1e-9, atol=1e-9)


def test_sums_of_neighbours(residuals):
    data, r, there = residuals
    got = Model().accumulate(TABLE, TIMES, data, AUTOREGRESSIVE).sums
    both = there[:, 1:] & there[:, :-1]
    rho = 0.3
    innovations = (np.where(both, r[:, :, 1:] - rho * r[:, :, :-1], 0.0) ** 2).sum(axis=2)
    np.testing.assert_allclose(got[:, :, 0], (r**2).sum(axis=2), rtol=1e-12)
    np.testing.assert_allclose(got[:, :, 3] - 2 * rho * got[:, :, 2] + rho**2 * got[:, :, 1], innovations, rtol=1e-10)


def test_student_sums_with_numbers_of_each_vector(residuals):
    data, r, there = residuals
    options = np.column_stack([np.linspace(2.0, 9.0, 20), np.full(20, 2.0), np.linspace(1.0, 3.0, 20)])
    got = Model().accumulate(TABLE, TIMES, data, STUDENT, options=options).sums[:, :, 0]
    scale = options[:, 1:, None]
    expected = (there * np.log1p(r**2 / (options[:, 0, None, None] * scale**2))).sum(axis=2)
    np.testing.assert_allclose(got, expected, rtol=1e-12)


@pytest.mark.parametrize("threads", [1, 2])
def test_sums_are_bitwise_the_same_alone_and_in_any_batch(residuals, threads):
    data = residuals[0]
    whole = Model().accumulate(TABLE, TIMES, data, GAUSSIAN, threads=threads).sums
    for i in (0, 7, 19):
        one = {k: v[[i]] if np.ndim(v) else v for k, v in TABLE.items()}
        np.testing.assert_array_equal(Model().accumulate(one, TIMES, data, GAUSSIAN).sums[0], whole[i])


def test_a_failed_vector_has_no_sums_and_wrong_data_are_refused(residuals):
    data = residuals[0]
    got = Model().accumulate(TABLE | {"mu": np.where(np.arange(20) == 4, np.nan, TABLE["mu"])}, TIMES, data, GAUSSIAN)
    assert np.isnan(got.sums[4]).all()
    assert np.isfinite(np.delete(got.sums, 4, axis=0)).all()
    with pytest.raises(ValueError, match="data has shape"):
        Model().accumulate(TABLE, TIMES, data[:1], GAUSSIAN)
