"""Evidences against closed forms."""

import numpy as np
import pytest
from nested import nested
from scipy.stats import multivariate_normal

from bayes_damper.errors import InputError
from bayes_damper.sampling.bridge import bridge


@pytest.mark.parametrize("ndim", [3, 6, 13])
def test_a_correlated_gaussian(ndim):
    rng = np.random.default_rng(ndim)
    root = rng.standard_normal((ndim, ndim)) * 10.0 ** rng.uniform(-3, 3, ndim)[:, None]
    inverse = np.linalg.inv(root)
    peak = -0.5 * ndim * np.log(2 * np.pi) - np.linalg.slogdet(root)[1] - 7.0

    def log_density(x):
        return peak - 0.5 * ((x @ inverse.T) ** 2).sum(axis=1)

    answers = []
    for seed in range(4):
        draws = rng.standard_normal((4, 60, 32, ndim)) @ root.T
        height = log_density(draws.reshape(-1, ndim)).reshape(draws.shape[:3])
        found = bridge(log_density, draws, height, np.random.default_rng(seed))
        answers.append(found.log_z)
        assert found.health > 0.3
    assert np.abs(np.array(answers) + 7.0).max() < 0.06
    assert np.std(answers) < 0.05


def test_bounded_coordinates():
    """Uniform on (2, 5) times an exponential beyond 1 times its mirror image below -1: the evidence is known."""

    def log_density(x):
        inside = (x[:, 0] > 2) & (x[:, 0] < 5) & (x[:, 1] > 1) & (x[:, 2] < -1)
        return np.where(inside, -(x[:, 1] - 1) + (x[:, 2] + 1), -np.inf)

    rng = np.random.default_rng(0)
    shape = (4, 60, 32)
    draws = np.stack([rng.uniform(2, 5, shape), 1 + rng.exponential(size=shape), -1 - rng.exponential(size=shape)], -1)
    height = log_density(draws.reshape(-1, 3)).reshape(shape)
    inf = np.inf
    found = bridge(log_density, draws, height, rng, bounds=(np.array([2.0, 1.0, -inf]), np.array([5.0, inf, -1.0])))
    assert found.log_z == pytest.approx(np.log(3.0), abs=max(4 * found.error, 0.03))


def test_one_ensemble_is_not_enough():
    with pytest.raises(InputError, match="two ensembles"):
        bridge(lambda x: x[:, 0], np.zeros((1, 5, 4, 2)), np.zeros((1, 5, 4)), np.random.default_rng(0))


def test_nautilus_finds_a_known_evidence():
    """Without its neural networks, which spare evaluations of a costly likelihood and take nearly all of the time."""
    density = multivariate_normal(np.zeros(2), np.eye(2))
    log_z, _ = nested(density.logpdf, lambda u: 16.0 * u - 8.0, 2, 1, live=200, n_networks=0)
    assert log_z + 2 * np.log(16.0) == pytest.approx(0.0, abs=0.1)
