"""The nuisances of each trial, integrated out in closed form, against doing the integral by brute force."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import read_table, write_synthetic, write_table

from bayes_damper.calibration import Experiment, Noise, Problem, Switches, TrialRecord, calibrate, experiment_of
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.calibration.posterior import MANY, RecordPosterior, _solved
from bayes_damper.campaign import load_campaign
from bayes_damper.simulation.model import Model

RIG = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "k1t": 10.2}
TRUTH = {"mu": 0.006, "k2t": 1.5, "c2t": 0.05, "drag": 0.004, "nu": 40.0, "c1t": 0.01, "c3t": 0.008}
TIMES = np.arange(250) * 1e-3
ANGLE = math.radians(4.7)


def _experiment(rng: np.random.Generator, delays: bool, repeats: int = 2, **changes: Any) -> Experiment:
    trials = []
    for coupled in (False, True):
        for number in range(1, repeats + 1):
            theta0 = ANGLE * (1.0 + 0.01 * rng.standard_normal())
            start = {"theta0": theta0, "delay": rng.uniform(0, 1e-3) if delays else 0.0}
            record = Model(coupled=coupled).simulate(RIG | TRUTH | start, TIMES).y[0]
            noisy = record + 2.0 * rng.standard_normal(record.shape)
            label = f"{'coupled' if coupled else 'uncoupled'} #{number}"
            trials.append(TrialRecord(label, "IV", coupled, number, TIMES, noisy, 0, ANGLE, 0.01 * ANGLE))
    constants = {name: (RIG[name], 0.0) for name in ("J1", "J2", "R", "r", "N0")}
    return Experiment(constants, ((10.2, 0.0),), tuple(trials), **changes)


@pytest.fixture(scope="module", params=["angle", "angle and delay", "angle and delay, curve free"])
def posterior(request: pytest.FixtureRequest) -> RecordPosterior:
    delays = "delay" in request.param
    curve = {} if "curve" in request.param else {"priors": {"tail": 0.0}}
    experiment = _experiment(np.random.default_rng(5), delays, **curve)
    noise = Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0))
    problem = Problem(experiment, noise=noise, switches=Switches(delay=delays, friction=False))
    return RecordPosterior(calibrate(problem))


def _brute_force(posterior: RecordPosterior, point: np.ndarray) -> np.ndarray:
    """log of the integral over each trial's nuisances of likelihood times prior, on a grid about their best values."""
    problem = posterior.problem
    q = point[: problem.size]
    scales = iter(posterior.noise_scale(point[None])[0])
    values = []
    for part in posterior.parts:
        m = part.eta.shape[1]
        for k in range(len(part.group.trials)):
            scale = next(scales)
            A = np.eye(m) + np.einsum("c,cij->ij", scale[: part.TT.shape[1]] ** -2, part.TT[k])
            root = np.linalg.inv(np.linalg.cholesky(A)).T
            grid = np.linspace(-6.0, 6.0, 49)
            mesh = np.stack(np.meshgrid(*[grid] * m, indexing="ij"), axis=-1).reshape(-1, m)
            eta = part.eta[k] + mesh @ root.T
            y = problem.simulate(part.group, np.full(len(eta), k), np.tile(q, (len(eta), 1)), eta)
            w = problem.whitened(y - part.group.y[k], np.broadcast_to(part.group.weight[k], y.shape))
            w = w.reshape(len(eta), y.shape[1], -1)
            chi2 = np.sum(np.sum(w**2, axis=2) / scale[: y.shape[1]] ** 2, axis=1)
            density = -0.5 * (chi2 + np.sum(eta**2, axis=1)) - 0.5 * m * math.log(2.0 * math.pi)
            cell = (grid[1] - grid[0]) ** m * abs(np.linalg.det(root))
            top = density.max()
            norm = part.readings[k] @ np.log(scale[: y.shape[1]])
            values.append(top + math.log(np.sum(np.exp(density - top)) * cell) - norm)
    return np.array(values)


def test_integrating_the_nuisances_out_agrees_with_brute_force(posterior: RecordPosterior) -> None:
    rng = np.random.default_rng(2)
    points = np.vstack([posterior.start, rng.multivariate_normal(posterior.start, posterior.covariance, size=3)])
    gap = posterior.log_likelihood(points) - np.array([_brute_force(posterior, point) for point in points])
    # A tenth of a nat is what friction reversals, which are not linear in the delay, leave; with the curve of the
    # friction free its sharpness is less known, and they leave a fifth.
    np.testing.assert_allclose(gap, 0.0, atol=0.25 if "tail" in posterior.problem.names else 0.15)


def test_the_likelihood_of_a_point_does_not_depend_on_its_company(posterior: RecordPosterior) -> None:
    rng = np.random.default_rng(3)
    points = rng.multivariate_normal(posterior.start, posterior.covariance, size=20)
    together = posterior.log_likelihood(points)
    alone = np.concatenate([posterior.log_likelihood(point[None]) for point in points])
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-8)


def test_nuisances_given_the_parameters_cover_the_truth(posterior: RecordPosterior) -> None:
    points = np.tile(posterior.start, (400, 1))
    drawn = posterior.evaluated(points, np.random.default_rng(1))[1]
    for part in posterior.parts:
        for k, i in enumerate(part.group.trials):
            np.testing.assert_allclose(drawn[i].mean(axis=0), part.eta[k], atol=0.5)
            assert np.all(drawn[i].std(axis=0) < 1.0)


def test_without_data_the_posterior_is_the_prior(posterior: RecordPosterior) -> None:
    points = np.random.default_rng(4).standard_normal((5, posterior.ndim))
    expected = -0.5 * np.sum(points**2, axis=1) - 0.5 * posterior.ndim * math.log(2.0 * math.pi)
    np.testing.assert_allclose(posterior.log_prior(points), expected)


@pytest.mark.parametrize("repeats", [1, 3])
def test_repeats_share_what_they_can_of_one_simulation(repeats: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many repeats there are, each configuration is simulated in one call: for all repeats and all points of
    the posterior, and for all derivatives of a fit. What is each trial's own costs no motion in the posterior, and in a
    fit one for each nuisance that is not known in closed form.
    """
    experiment = _experiment(np.random.default_rng(5), True, repeats)
    noise = Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0))
    problem = Problem(experiment, noise=noise, switches=Switches(delay=True, friction=True))
    fit = calibrate(problem, most=2)
    posterior = RecordPosterior(fit)
    runs: list[tuple[bool, int]] = []
    simulate = Model.simulate

    def counted(self: Model, *arguments: Any, **options: Any) -> Any:
        found = simulate(self, *arguments, **options)
        runs.append((self.coupled, len(found.y)))
        return found

    monkeypatch.setattr(Model, "simulate", counted)
    points = np.tile(np.append(fit.q, np.zeros(posterior.ndim - problem.size)), (5, 1))
    assert np.isfinite(posterior(points)).all()
    assert sorted(runs) == [(False, 5 * repeats), (True, 5 * repeats)]
    runs.clear()
    linear = problem.linearise(fit.q, fit.eta)
    assert [block.T.shape[1] for block in linear.blocks] == [2, 3]  # release angle, instant; coupled: friction too
    # The point itself, then each parameter: of the primary alone drag, nu, tail and c1t, coupled mu, k2t, c2t, c3t too.
    assert sorted(runs) == [(False, (1 + 4 + 2) * repeats), (True, (1 + 8 + 2) * repeats)]


def test_repeats_of_other_lengths_and_with_gaps_share_the_simulation(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, repeats=3)
    for path, kept in (("IV_coupled_1", np.s_[:800]), ("IV_coupled_2", np.r_[0:300, 340:1001])):
        names, columns = read_table(folder / "trials" / f"{path}.csv")
        write_table(folder / "trials" / f"{path}.csv", names, [x[kept] for x in columns])
    groups = Problem(experiment_of(load_campaign(folder))).grouped(range(6))
    assert sorted(len(group.trials) for group in groups) == [3, 3]


def test_a_prediction_is_either_of_the_motion_or_of_nothing_where_the_release_lies() -> None:
    """A band that reaches from the held rig to the peak would say that anything may be read there."""
    problem = Problem(
        _experiment(np.random.default_rng(5), delays=False),
        noise=Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0)), switches=Switches(delay=True, friction=False),
    )  # fmt: skip
    posterior = RecordPosterior(calibrate(problem))
    rng = np.random.default_rng(1)
    found = posterior.predictive(rng.multivariate_normal(posterior.start, posterior.covariance, size=60), rng)
    unsaid = 0
    for i, y in found.items():
        assert np.isfinite(y[:, :, 2:]).all()
        first = y[:, 0, 0][np.isfinite(y[:, 0, 0])]
        unsaid += len(y) - len(first)
        assert np.ptp(first) < 0.2 * np.abs(problem.experiment.trials[i].y[0, 0])
    assert unsaid > 10


def test_predictions_fit_the_readings_where_the_valley_of_the_nuisances_bends() -> None:
    """A release and a gain are known as a product: draws of a Gaussian leave the valley where that product is right."""
    experiment = _experiment(np.random.default_rng(5), delays=False)
    trials = tuple(replace(t, theta0_sd=0.1 * ANGLE) for t in experiment.trials)
    noise = Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0))
    switches = Switches(
        delay=False, friction=False, scatter=Scatter(tuple(Size(g, 0.1, 0.1, 0.1, 0.1) for g in ("gain1", "gain2")))
    )
    posterior = RecordPosterior(calibrate(Problem(replace(experiment, trials=trials), noise=noise, switches=switches)))
    rng = np.random.default_rng(1)
    points = rng.multivariate_normal(posterior.start, posterior.covariance, size=60)
    for i, y in posterior.predictive(points, rng).items():
        missed = np.sqrt(np.nanmean((y - trials[i].y) ** 2, axis=(1, 2)))
        assert missed.max() < 3.0, i  # with noise of 2; 5.4 and 2.9 by such draws


def test_many_nuisances_are_solved_as_few_are():
    """Beyond MANY a Cholesky factor gives solution and determinant; below, numpy's solvers do."""
    rng = np.random.default_rng(2)
    T = rng.standard_normal((2, 3, MANY + 10, 300))
    A, b = np.eye(MANY + 10) + T @ T.swapaxes(-1, -2), rng.standard_normal((2, 3, MANY + 10))
    x, log_det = _solved(A, b)
    assert np.einsum("knij,knj->kni", A, x) == pytest.approx(b, abs=1e-10)
    assert log_det == pytest.approx(np.linalg.slogdet(A)[1], rel=1e-12)
    few = _solved(A[..., :5, :5], b[..., :5])
    assert few[1] == pytest.approx(np.linalg.slogdet(A[..., :5, :5])[1], rel=1e-12)
