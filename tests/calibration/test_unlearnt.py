"""Sizes that no repeats show are integrated out of the evidence, held against dense algebra and brute force."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t
from test_scatter import TRUE, laboratory

from bayes_damper.calibration import Noise, Problem, Switches, calibrate
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.calibration.unlearnt import Part, Unlearnt, gained_over_sizes

TYPICAL_OF_FIT = math.log(1.4)


def drawn(loud: float) -> tuple[Unlearnt, np.ndarray, np.ndarray, np.ndarray]:
    """Three trials of 9 readings, two own values each and one common unknown; loud : of the first own values."""
    rng = np.random.default_rng(5)
    T, J = rng.standard_normal((3, 2, 9)), rng.standard_normal((3, 1, 9))
    r = rng.standard_normal((3, 9)) + loud * T[:, 0]
    product = [a @ b.transpose(0, 2, 1) for a, b in ((T, T), (T, J), (J, J))]
    part = Part(np.array([0, 1]), product[0], product[1], np.einsum("jmn,jn->jm", T, r))
    Jr = np.einsum("jkn,jn->k", J, r)
    start = np.full(2, TYPICAL_OF_FIT)
    return Unlearnt(start, np.zeros(1), product[2].sum(axis=0), Jr, float(np.sum(r**2)), (part,)), T, J, r


def dense(u: np.ndarray, T: np.ndarray, J: np.ndarray, r: np.ndarray) -> float:
    """Log density of all readings, own values of the fit's size 1 where u is that of the fit."""
    size = np.exp(2.0 * (u - TYPICAL_OF_FIT))
    along = J.transpose(1, 0, 2).reshape(1, -1)
    covariance = np.eye(r.size) + along.T @ along
    for k in range(3):
        at = slice(9 * k, 9 * k + 9)
        covariance[at, at] += np.einsum("mi,m,mj->ij", T[k], size, T[k])
    return float(-0.5 * (np.linalg.slogdet(covariance)[1] + r.ravel() @ np.linalg.solve(covariance, r.ravel())))


def test_evidence_at_given_sizes_is_that_of_the_dense_gaussian():
    found, *arrays = drawn(2.0)
    at, other = np.array([0.3, -1.0]), np.array([-2.0, 1.5])
    (here, slopes), (there, _) = found.log_evidence(at), found.log_evidence(other)
    assert here - there == pytest.approx(dense(at, *arrays) - dense(other, *arrays), abs=1e-9)
    for k, step in enumerate(1e-4 * np.eye(2)):
        slope = (dense(at + step, *arrays) - dense(at - step, *arrays)) / 2e-4
        assert slopes[k] == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize("loud", [0.5, 3.0, 10.0])
def test_gain_is_that_of_the_integral_over_both_sizes(loud):
    """By brute force over the sizes s with their half Student t; Laplace's method is right to a third of a nat."""
    found, *arrays = drawn(loud)
    known = dense(found.start, *arrays)

    grid = np.arange(-6.0, 5.0, 0.25)
    prior = grid + math.log(2.0) + t(4.0).logpdf(np.exp(grid))
    logs = [dense(np.array([u, v]), *arrays) - known + a + b
            for u, a in zip(grid, prior, strict=True) for v, b in zip(grid, prior, strict=True)]  # fmt: skip
    whole = 0.25**2 * float(np.sum(np.exp(logs)))
    assert found.gained() == pytest.approx(math.log(whole), abs=0.33)


def test_sizes_that_no_reading_shows_change_nothing():
    part = Part(np.array([0, 1]), np.zeros((3, 2, 2)), np.zeros((3, 2, 1)), np.zeros((3, 2)))
    blind = Unlearnt(np.zeros(2), np.zeros(1), np.eye(1), np.ones(1), 5.0, (part,))
    assert blind.gained() == pytest.approx(0.0, abs=1e-6)


def test_springs_that_are_off_cost_less_where_no_trial_repeats():
    """Each by ten typical sizes, at 1.4 of which that costs 25 nats; where trials repeat, sizes are learnt."""
    scatter = Scatter((Size("k1t", 1.4 * TYPICAL["k1t"], 0.0, math.inf, TYPICAL["k1t"]),))
    switches = Switches(delay=False, friction=False, scatter=scatter)
    known = {name: value for name, value in TRUE.items() if name != "c1t"}
    gains = []
    for off, repeats in ((0.0, 1), (0.02, 1), (0.02, 3)):
        rig = laboratory(1, {}, stiffer=1.0 + off, repeats=repeats, n=200)
        rig = replace(rig, priors=known | {"tail": 0.0})
        problem = Problem(rig, switches=switches, noise=Noise((2.0,), (0.0,), (0.0,)))
        fit = calibrate(problem, anneal=False)
        normals = fit.linear.normal()
        gains.append(fit.log_evidence - normals.log_evidence())
        # Where records fail nothing is gained, and numpy has nothing to say of it.
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert gained_over_sizes(problem, replace(normals, S=np.full_like(normals.S, np.nan))) == 0.0
    assert gains[1] > gains[0] + 10.0
    assert gains[2] == 0.0
