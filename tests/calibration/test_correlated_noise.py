"""The noise of a fit: chosen by the data, learnt from what is left, and trials unlike their repeats."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from coloured import NAMES, autoregression, campaign, covered, share_inside
from scipy.special import ndtr
from small_rig import NOISE, RIG, measured
from test_scatter import laboratory

from bayes_damper.calibration import Calibration, Noise, Problem, Switches, calibrate, default_starts
from bayes_damper.calibration.correlated_noise import FittedNoise, _beyond, fit_with_noise, student_log_density
from bayes_damper.calibration.influence import comparison, influence, without
from bayes_damper.calibration.noise_level import whittle
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.errors import InputError
from bayes_damper.fit import plan_fit
from bayes_damper.priors.distributions import LogNormal, to_standard
from bayes_damper.sampling.prior_sensitivity import of_standard_draws, text
from bayes_damper.text import misses

ONE_CASE: dict[str, Any] = {"cases": [("IV", 1, 0.08)], "duration": 0.4, "repeats": 3}


def _fitted(sensor: Callable[..., Any] | None = None, kind: str = "auto", **more: Any) -> FittedNoise:
    """A fit of a campaign that says that nothing scatters from trial to trial, so that noise alone widens it."""
    experiment = measured(1, sensor=sensor, **(ONE_CASE | more))
    return fit_with_noise(replace(experiment, scatter=dict.fromkeys(TYPICAL, 0.0)), kind)


def _same_misfit(times, y):
    """The same correlated error in every trial of a configuration."""
    return y + autoregression(np.random.default_rng(len(y)), y.shape, 0.95, 6.0)


@pytest.fixture(scope="module")
def plain() -> FittedNoise:
    return _fitted()


@pytest.fixture(scope="module")
def misfit() -> FittedNoise:
    return _fitted(_same_misfit)


def test_white_noise_is_left_as_the_repeats_show_it(plain: FittedNoise) -> None:
    assert plain.kind == "gaussian"
    assert plain.unlike == ()
    assert plain.sentences("rad/s^2") == []
    for channel in plain.channels:
        assert not channel.widened
        assert channel.repeats == pytest.approx(NOISE, rel=0.1)
        assert channel.fast == pytest.approx(NOISE, rel=0.2)
        assert channel.left == pytest.approx(NOISE, rel=0.1)


def test_a_misfit_that_repeats_share_is_found_and_widens_the_answer(plain: FittedNoise, misfit: FittedNoise) -> None:
    assert misfit.kind == "ar"
    assert all(channel.widened for channel in misfit.channels)
    for channel in misfit.channels:
        assert channel.repeats == pytest.approx(NOISE, rel=0.1)  # what repeats share drops out of their differences
        assert channel.left > 2.0 * NOISE
        assert channel.correlation > 0.7
        assert channel.used > channel.left  # it does not average out over repeats
    told = " ".join(misfit.sentences("rad/s^2"))
    assert "the model misses something" in told
    for name in ("k2t", "c2t", "c1t"):
        assert misfit.fit.parameters[name][1] > 2.0 * plain.fit.parameters[name][1]
    row = misfit.to_json("rad/s^2")["channels"][0]
    assert row["learnt_from"] == "residuals"
    assert row["left_over_floor"] == pytest.approx(row["left"] / row["repeats"])


@pytest.mark.slow
def test_noise_estimated_from_the_residuals_on_request_accuses_nobody() -> None:
    for sensor, missed in ((None, ""), (_same_misfit, "THE MODEL MISSES SOMETHING")):
        found = _fitted(sensor, "ar")
        assert (found.kind, found.chosen) == ("ar", False)
        entry = {"noise": found.to_json("rad/s^2")}
        assert misses(entry).partition(":")[0] == missed
        asked = {c["learnt_from"] for c in entry["noise"]["channels"]}
        assert asked == ({"residuals"} if missed else {"residuals, as asked"})


def test_a_single_trial_with_coloured_noise_is_not_taken_for_a_quiet_one() -> None:
    found = _fitted(_same_misfit, repeats=1)
    assert all(c.repeats is None and c.widened for c in found.channels)
    assert all(c.used > 2.0 * c.fast for c in found.channels)
    assert misses({"noise": found.to_json("rad/s^2")}).startswith("THE MODEL MISSES SOMETHING, OR THE NOISE IS SLOW:")


def test_trials_that_start_free_are_no_repeats_of_each_other() -> None:
    """No two begin alike: their noise is what residuals have in their fast content."""
    experiment = measured(1, configurations=(False,), **ONE_CASE)
    still = replace(experiment, start="free", scatter=dict.fromkeys(TYPICAL, 0.0))
    (channel,) = fit_with_noise(still).channels
    assert channel.repeats is None
    assert channel.fast == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
def test_unevenly_sampled_records_are_widened_too() -> None:
    experiment = measured(1, sensor=_same_misfit, **(ONE_CASE | {"repeats": 1}))
    rng = np.random.default_rng(0)
    trials = []
    for trial in experiment.trials:
        keep = np.sort(rng.choice(trial.times.size, trial.times.size * 2 // 3, replace=False))
        trials.append(replace(trial, times=trial.times[keep], y=trial.y[:, keep]))
    found = fit_with_noise(replace(experiment, trials=tuple(trials)))
    assert all(c.widened and c.used > 2.0 * c.left for c in found.channels)


def _outliers(rng: np.random.Generator) -> Callable[..., Any]:
    def sensor(times, y):
        y = y.copy()
        y[:, rng.integers(5, y.shape[1], 12)] += 40.0 * rng.standard_normal((y.shape[0], 12))
        return y

    return sensor


def test_outliers_make_the_noise_that_of_student() -> None:
    found = _fitted(_outliers(np.random.default_rng(0)))
    assert found.kind == "student"
    assert found.freedom < 6.0
    assert "outliers" in found.sentences("rad/s^2")[0]
    for name in ("k2t", "c1t", "mu", "drag"):
        value, sd = found.fit.parameters[name]
        assert abs(value - RIG[name]) < 4.0 * sd


@pytest.mark.parametrize("kind", ["gaussian", "student", "ar"])
def test_the_user_decides_if_he_wants_to(kind: str) -> None:
    found = _fitted(kind=kind)
    assert (found.kind, found.chosen) == (kind, False)
    assert math.isfinite(found.freedom) == (kind == "student")


def test_an_unknown_noise_is_refused() -> None:
    with pytest.raises(InputError, match="auto, gaussian, student, ar"):
        plan_fit("thesis", cases=None, priors=None, normal_force=None, noise="pink", seed=1, thorough=False,
                 most_steps=None, joint=True)  # fmt: skip


@pytest.mark.parametrize(
    "noise",
    [Noise((1.3,), (0.9,), (0.4,)), Noise((0.7,), (0.0,), (0.0,), ((1.6, -0.7, 0.05),))],
    ids=["ARMA(1, 1)", "AR(3)"],
)
def test_whitening_density_and_size_of_a_noise_agree(noise: Noise) -> None:
    from scipy.signal import lfilter

    rng = np.random.default_rng(1)
    ahead, back = noise.filter(0)
    innovations = rng.standard_normal(200_000)
    made = lfilter(back, ahead, noise.innovation[0] * innovations)
    np.testing.assert_allclose(noise.whiten(0, made)[100:], innovations[100:], atol=1e-9)
    assert made.std() == pytest.approx(noise.total[0], rel=0.03)
    omega = np.linspace(1e-4, np.pi, 20_001)
    assert math.sqrt(np.mean(noise.density(0, omega))) == pytest.approx(noise.total[0], rel=1e-3)


def test_the_density_of_student_tends_to_that_of_a_gaussian() -> None:
    w = np.linspace(-4.0, 4.0, 9)
    np.testing.assert_allclose(student_log_density(w, 1e7), -0.5 * w**2, atol=1e-4)
    grid = np.linspace(-200.0, 200.0, 400_001)
    mass = np.exp(student_log_density(grid, 3.0)).sum() * (grid[1] - grid[0]) / math.sqrt(2.0 * math.pi)
    assert mass == pytest.approx(1.0, abs=1e-3)


def test_nuisances_under_students_noise_are_integrated_out_as_by_brute_force() -> None:
    experiment = measured(2, sensor=_outliers(np.random.default_rng(3)), **(ONE_CASE | {"duration": 0.2}))
    problem = Problem(
        experiment, noise=Noise((NOISE, NOISE), (0.0, 0.0), (0.0, 0.0)), switches=Switches(delay=False, friction=False)
    )
    posterior = RecordPosterior(calibrate(problem), freedom=3.0)
    assert posterior.names[-1] == "noise_freedom"
    point = posterior.start
    freedom = posterior.values(point[None])["noise_freedom"][0]
    told = iter(posterior.log_likelihood(point[None])[0])
    for part, s in posterior._scaled(point[None]):
        for k in range(len(part.group.trials)):
            grid = part.eta[k, 0] + np.linspace(-1.0, 1.0, 401)
            y = problem.simulate(part.group, np.full(401, k), np.tile(point[: problem.size], (401, 1)), grid[:, None])
            w = (y - part.group.y[k]) * part.group.weight[k] / NOISE / s[0, k][None, :, None]
            each = student_log_density(w, freedom).sum(axis=2) - np.log(s[0, k]) * part.readings[k]
            height = each.sum(axis=1) - 0.5 * grid**2
            step = grid[1] - grid[0]
            integral = np.exp(height - height.max()).sum() * step / math.sqrt(2.0 * math.pi)
            assert next(told) == pytest.approx(height.max() + math.log(integral), abs=0.2)


# Trials unlike their repeats ----------------------------------------------------------------------------------------


def _one_bad(number: int) -> Callable[..., Any]:
    count = [0]

    def sensor(times, y):
        count[0] += 1
        bad = count[0] == number
        return y + bad * autoregression(np.random.default_rng(3), y.shape, 0.5, 10.0)

    return sensor


@pytest.mark.slow
def test_a_bad_trial_is_named_weighed_down_and_left_out_for_comparison() -> None:
    experiment = measured(1, sensor=_one_bad(5), **(ONE_CASE | {"repeats": 4}))
    found = fit_with_noise(experiment)
    assert [u.trial for u in found.unlike] == [4]
    assert found.unlike[0].power > 5.0
    assert found.kind == "gaussian"
    assert not any(c.widened for c in found.channels)
    other = without(experiment, (4,), "auto")
    assert other is not None
    table = comparison(found.fit, other.fit)
    for name in NAMES:
        assert abs(table[name]["shift_sd"]) < 1.5
        value, sd = other.fit.parameters[name]
        assert abs(value - RIG[name]) < 4.0 * sd


@pytest.mark.slow
def test_one_of_two_repeats_may_be_the_odd_one() -> None:
    experiment = measured(1, sensor=_one_bad(3), **(ONE_CASE | {"repeats": 2}))
    experiment = replace(experiment, trials=tuple(replace(t, heldout=False) for t in experiment.trials))
    found = fit_with_noise(experiment)
    assert [(u.trial, u.alone) for u in found.unlike] == [(2, True)]


def test_without_the_only_trial_of_a_configuration_there_is_no_answer() -> None:
    experiment = measured(1, **(ONE_CASE | {"repeats": 1}))
    assert without(experiment, (1,), "auto") is None


def test_the_influence_of_a_trial_is_what_leaving_it_out_does() -> None:
    fit: Calibration = _fitted(repeats=8).fit
    moved = influence(fit)
    left_out = fit.problem.trials[-1]
    rest = tuple(i for i in fit.problem.trials if i != left_out)
    problem = fit.problem
    again = calibrate(
        Problem(problem.experiment, noise=problem.noise, switches=problem.switches, trials=rest), [fit.q], anneal=False
    )
    shift = (again.q - fit.q) / np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(moved[left_out], shift, atol=0.15 + 0.1 * np.abs(shift).max())


# Priors -------------------------------------------------------------------------------------------------------------


def test_shifts_under_other_priors_are_those_of_a_gaussian() -> None:
    rng = np.random.default_rng(5)
    precision = 4.0  # of the likelihood, which is centred on 1
    mean, sd = precision / (precision + 1.0), (precision + 1.0) ** -0.5
    points = np.column_stack([mean + sd * rng.standard_normal(200_000), 0.05 * rng.standard_normal(200_000)])
    table = of_standard_draws(["a", "b"], points)
    for word, width in (("half", 0.5), ("double", 2.0)):
        other = precision / (precision + width**-2)
        assert table["a"][word]["shift"] == pytest.approx((other - mean) / sd, abs=0.02)
        assert table["a"][word]["width"] == pytest.approx((precision + width**-2) ** -0.5 / sd, abs=0.02)
        assert abs(table["b"][word]["shift"]) < 0.02
    assert table["a"]["prior_share"] == pytest.approx(sd**2, abs=0.01)
    assert any("a " in line for line in text(table))


def test_shifts_under_other_priors_are_those_of_a_new_fit() -> None:
    """The table of one fit against a fit under priors that are really half as wide."""
    experiment = measured(4, **(ONE_CASE | {"repeats": 1}))
    switches, noise = Switches(delay=False, friction=False), Noise((NOISE, NOISE), (0.0, 0.0), (0.0, 0.0))
    prior = LogNormal(1.1 * RIG["drag"], 1.05)
    fits = [
        calibrate(Problem(replace(experiment, priors={"drag": p}), noise=noise, switches=switches))
        for p in (prior, LogNormal(prior.median_value, prior.factor**0.5))
    ]
    fit = fits[0]
    points = np.random.default_rng(1).multivariate_normal(fit.q, fit.covariance, 100_000)
    table = of_standard_draws(fit.problem.names, points)
    i = fit.problem.names.index("drag")
    told = table["drag"]["half"]
    assert told["reliable"]
    sd = math.sqrt(fit.covariance[i, i])
    assert told["shift"] == pytest.approx((0.5 * fits[1].q[i] - fit.q[i]) / sd, abs=0.15)
    assert told["width"] == pytest.approx(0.5 * math.sqrt(fits[1].covariance[i, i]) / sd, abs=0.1)


@pytest.mark.slow
def test_the_best_fit_is_looked_for_anew_under_the_noise_that_was_learnt() -> None:
    """In this campaign the valley that white noise leads to is not the best one under the noise learnt there."""
    found = fit_with_noise(campaign(9055, "shared", 3)[0])
    assert any(c.widened for c in found.channels)
    best = calibrate(found.fit.problem, default_starts(found.fit.problem))
    assert found.fit.cost < best.cost + 1.0
    nowhere = [found.fit.q + 50.0]
    with (
        mock.patch("bayes_damper.calibration.correlated_noise.default_starts", return_value=nowhere),
        mock.patch("bayes_damper.calibration.correlated_noise.drawn_starts", return_value=[]),
    ):
        left = fit_with_noise(campaign(9055, "shared", 3)[0])
    assert left.fit.log_evidence < found.fit.log_evidence - 5.0


# Coverage -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seed", "kind", "repeats"), [(9011, "shared", 1), pytest.param(9039, "own", 3, marks=pytest.mark.slow)]
)
def test_no_valley_near_the_truth_is_deeper_than_the_fit(seed: int, kind: str, repeats: int) -> None:
    """Few trials with correlated errors: their cost has many valleys, and prior medians lead to another one."""
    experiment, truth, _ = campaign(seed, kind, repeats)
    fit = fit_with_noise(experiment).fit
    start = fit.q.copy()
    for name in NAMES:
        start[fit.problem.names.index(name)] = to_standard(experiment.priors[name], truth[name])
    near = min(calibrate(fit.problem, [start], finish=False, anneal=anneal).cost for anneal in (True, False))
    assert fit.cost < near + 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "repeats"),
    [  # those of repeats take long, and the proof counts them on more campaigns
        pytest.param("own", 3, marks=pytest.mark.prove),
        pytest.param("shared", 3, marks=pytest.mark.prove),
        ("shared", 1),
    ],
)
def test_intervals_cover_under_coloured_noise(kind: str, repeats: int) -> None:
    """A few campaigns each; tests/prove holds many against binomial bounds."""
    ranks = np.concatenate([covered(500 + seed, kind, repeats) for seed in range(5)])
    assert share_inside(ranks, 0.9) > 0.7
    assert 0.25 < share_inside(ranks, 0.5) < 0.8


def test_ranks_of_a_known_gaussian_are_uniform() -> None:
    ranks = ndtr(np.random.default_rng(0).standard_normal(100_000))
    assert share_inside(ranks, 0.9) == pytest.approx(0.9, abs=0.01)
    assert share_inside(ranks, 0.5) == pytest.approx(0.5, abs=0.01)


def test_draws_that_the_prior_decides_cannot_tell_what_a_wider_one_would_allow() -> None:
    points = np.random.default_rng(2).standard_normal((4000, 2)) * [0.3, 0.95]
    table = of_standard_draws(["measured", "assumed"], points)
    assert table["measured"]["double"]["reliable"]
    assert table["measured"]["half"]["reliable"]
    assert table["assumed"]["half"]["reliable"]
    assert not table["assumed"]["double"]["reliable"]


def test_a_tail_that_only_the_prior_ends_is_told() -> None:
    """An upper limit says nothing of small values: half of the prior's variance is gone, yet a wider one widens."""
    rng = np.random.default_rng(4)
    z = rng.standard_normal(60_000)
    limited = z[rng.random(z.size) < ndtr((-0.5 - z) / 0.3)][:8000]
    measured_well = 0.6 * rng.standard_normal(limited.size)
    table = of_standard_draws(["limited", "measured"], np.column_stack([limited, measured_well]))
    assert table["limited"]["prior_share"] < 0.5
    assert not table["limited"]["double"]["reliable"]
    assert table["limited"]["half"]["reliable"]
    assert table["measured"]["double"]["reliable"]


@pytest.mark.parametrize("farthest", [0.99, 0.9999])
def test_a_spectrum_without_any_white_part_has_a_finite_noise(farthest):
    """All of it is steep, so that the white part of the fit ends near 1e-160 of it: the noise was infinite."""
    omega = 2.0 * np.pi * np.arange(1, 700) / 1400
    power = 1e-6 * (0.01 / omega) ** 4
    sd, phi, theta = whittle(omega, power, np.ones(omega.size), farthest)
    assert phi == pytest.approx(farthest)
    assert 0.0 <= theta < 1e-100
    # of the likelihood with that phi and no white part the maximum is known
    assert sd**2 == pytest.approx(np.mean(power * (1.0 + phi**2 - 2.0 * phi * np.cos(omega))), rel=1e-3)


def test_what_an_encoder_rounds_is_nothing_that_the_model_misses() -> None:
    """In slow motion errors of rounding are alike from reading to reading, and were taken for a misfit."""
    step = 6e-3
    drawn = laboratory(1, {}, repeats=3, n=800, quantity="displacement", noise=1e-6)
    trials = tuple(replace(t, y=step * np.round(t.y / step)) for t in drawn.trials)
    said: list[bool] = []
    fitted = fit_with_noise(replace(drawn, rounding=(step,), trials=trials), on_excess=said.append)
    (channel,) = fitted.channels
    assert channel.left == pytest.approx(step / math.sqrt(12.0), rel=0.05)
    assert not channel.widened
    assert said == []


def test_power_beyond_what_repeats_show_is_judged_by_the_error_of_both():
    """By simulation: of white noise that three repeats share, three standard errors are as rare as they should be."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(400):
        readings = rng.standard_normal((3, 800))
        mean = math.sqrt(3.0) * readings.mean(axis=0)
        noise = math.sqrt(float(np.sum((readings - readings.mean(axis=0)) ** 2)) / (2.0 * 800.0))
        found.append(_beyond([(mean, np.ones(800))], noise, 3))
    assert np.std(found) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(found)) < 0.2
    assert _beyond([(mean, np.ones(800))], noise, 1) == math.inf
