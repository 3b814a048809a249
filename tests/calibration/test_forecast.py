"""Forecasts from the first two periods: against scipy, against known truth, and blind to what comes later."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from small_rig import measured, variant

from bayes_damper.calibration import Calibration, Experiment, Noise, Problem, Switches, TrialRecord, calibrate
from bayes_damper.calibration.forecast import (
    PERIODS,
    Forecast,
    _ahead,
    averaged,
    forecast,
    forecasts,
    period_of,
    summary,
)
from bayes_damper.calibration.heldout import NEAR, ROUNDS, _descend, predict
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.priors.distributions import LogNormal, Normal

K, VISCOUS, DRY, NU = 90.0, 0.30, 1.1, 30.0  # per unit inertia: s^-2, s^-1, s^-2, s
SIGMA = 2e-3


def swing(times, angle, speed, viscous=VISCOUS, dry=DRY):
    """Angle of a pendulum by scipy, (n,)."""

    def rate(_, x):
        return x[1], -K * np.sin(x[0]) - viscous * x[1] - dry * np.tanh(NU * x[1])

    found = solve_ivp(rate, (times[0], times[-1]), (angle, speed), "LSODA", times, rtol=1e-7, atol=1e-8)
    return found.y[0]


def swings(seed: int, trained: int, unseen: int, dry: float = DRY, duration: float = 5.0) -> Experiment:
    """A pendulum per unit inertia, let go by hand: angles, start free, white noise."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(duration * 50.0)) / 50.0
    trials = []
    for i in range(trained + unseen):
        y = swing(times, rng.uniform(0.6, 1.2), rng.uniform(-0.5, 0.5), dry=dry) + SIGMA * rng.standard_normal(
            times.size
        )
        trials.append(TrialRecord(f"{i}.csv", "A", False, i + 1, times, y[None], 0, heldout=i >= trained))
    priors = {"c1t": LogNormal(0.3, 2.0), "drag": LogNormal(1.0, 2.0), "nu": NU, "tail": 0.0}
    return Experiment(
        {"J1": (1.0, 0.0)}, ((K * 1.01, 0.02 * K),), tuple(trials), "displacement", restoring="pendulum", start="free",
        priors=priors, offset_sd=(1e-9,),
    )  # fmt: skip


def fitted(experiment: Experiment, nominal: str = "nonlinear") -> Calibration:
    problem = Problem(experiment, nominal=nominal, noise=Noise((SIGMA,), (0.0,), (0.0,)))
    return calibrate(problem, [problem.prior_mean()])


@pytest.fixture(scope="module")
def pendulum() -> Calibration:
    return fitted(swings(3, trained=2, unseen=12))


def test_a_forecast_is_what_scipy_says_from_the_same_first_periods(pendulum):
    """Least squares over angle and speed on the first two periods, then on: no part of the package."""
    values = {name: x for name, (x, _) in pendulum.parameters.items()}
    k1t = next(x for name, x in values.items() if name.startswith("k1t"))
    for i, found in forecast(pendulum, (2, 7)).items():
        t = pendulum.problem.experiment.trials[i]
        first = t.times <= found.seen_s
        assert found.seen_s == pytest.approx(4.0 * np.pi / np.sqrt(k1t), rel=0.1)  # wide swings take longer

        def ahead(x, times):
            def rate(_, s):
                dry = values["drag"] * np.tanh(NU * s[1])
                return s[1], -k1t * np.sin(s[0]) - values["c1t"] * s[1] - dry

            return solve_ivp(rate, (times[0], times[-1]), x, "LSODA", times, rtol=1e-7, atol=1e-8).y[0]

        own = least_squares(lambda x, t=t, first=first: ahead(x, t.times[first]) - t.y[0, first], (t.y[0, 0], 0.0))
        np.testing.assert_allclose(found.centre[0], ahead(own.x, t.times)[~first], atol=0.05 * SIGMA)
        assert found.times[0] == t.times[~first][0]


def test_bands_hold_the_share_they_are_to_hold():
    """Over six campaigns of known truth: pooled shares within what so many stretches scatter."""
    held = {0.5: [], 0.9: []}
    for seed in range(6):
        fit = fitted(swings(100 + seed, trained=1, unseen=6))
        for found in forecast(fit, fit.problem.experiment.heldout).values():
            for share, shares in held.items():
                shares.append(float(found.inside(share).mean()))
    assert 0.44 < np.mean(held[0.5]) < 0.58
    assert 0.86 < np.mean(held[0.9]) < 0.95


def test_bands_over_several_answers_are_those_of_draws_from_them():
    """Against the quantiles of draws from the mixture; one answer alone changes nothing."""
    rng = np.random.default_rng(11)
    times, reading = np.arange(5.0), rng.normal(0.0, 3.0, (2, 5))
    centres, sds = rng.normal(0.0, 2.0, (3, 2, 5)), rng.uniform(0.3, 1.5, (3, 2, 5))
    parts = [Forecast(0, 1.0, np.ones(2), times, reading, c, s) for c, s in zip(centres, sds, strict=True)]
    found = averaged([(3.0, parts[0]), (1.0, parts[1]), (1.0, parts[2])])
    which = rng.choice(3, 200_000, p=(0.6, 0.2, 0.2))
    draws = centres[which] + sds[which] * rng.standard_normal((which.size, 2, 5))
    for share in (0.5, 0.9):
        low, high = np.quantile(draws, (0.5 - 0.5 * share, 0.5 + 0.5 * share), axis=0)
        np.testing.assert_allclose(found.width(share), high - low, rtol=0.02)
        clear = np.minimum(np.abs(reading - low), np.abs(reading - high)) > 0.05
        np.testing.assert_array_equal(found.inside(share)[clear], ((low <= reading) & (reading <= high))[clear])
    np.testing.assert_allclose(found.sd, draws.std(axis=0), rtol=0.02)
    alone = averaged([(0.2, parts[0])])
    np.testing.assert_array_equal(alone.inside(0.9), parts[0].inside(0.9))
    np.testing.assert_allclose(alone.width(0.9), parts[0].width(0.9))


def test_answers_are_weighed_in_the_forecasts_of_a_diagnosis(pendulum):
    """Between a model without dry friction and the right one, by their probabilities."""
    viscous = fitted(pendulum.problem.experiment, "linear")
    told = forecasts(viscous, pendulum, [(0.01, viscous), (0.99, pendulum)])
    assert told["averaged"]["rms"] == pytest.approx(told["after"]["rms"], rel=0.2)
    assert told["averaged"]["rms"] < 0.5 * told["before"]["rms"]
    even = forecasts(viscous, pendulum, [(0.5, viscous), (0.5, pendulum)])
    assert even["averaged"]["width90"] > told["averaged"]["width90"]
    assert "averaged" not in forecasts(viscous, pendulum, [(1.0, pendulum)])
    assert "averaged" in even["trials"][0]


def test_the_spread_is_that_of_forecasts_from_other_noise():
    """The same trial measured 40 times: scatter of the forecast at each instant, against the spread told."""
    base = swings(8, trained=2, unseen=1)
    fit = fitted(base)
    t = base.trials[2]
    clean = swing(t.times, 0.9, 0.2)
    rng = np.random.default_rng(4)
    trials = tuple(replace(t, y=(clean + SIGMA * rng.standard_normal(clean.size))[None]) for _ in range(40))
    many = replace(base, trials=(*base.trials[:2], *trials))
    problem = Problem(many, noise=fit.problem.noise)
    found = list(_ahead(replace(fit, problem=problem), many.heldout, PERIODS, None).values())
    scatter = np.std([f.centre[0] for f in found], axis=0)
    told = np.mean([f.sd[0] for f in found], axis=0)
    assert np.mean(scatter) == pytest.approx(np.mean(told), rel=0.25)


def test_nothing_after_the_first_periods_matters(pendulum):
    experiment = pendulum.problem.experiment
    before = forecast(pendulum, (3,))[3]
    y = experiment.trials[3].y.copy()
    y[:, experiment.trials[3].times > before.seen_s] = 0.3
    trials = list(experiment.trials)
    trials[3] = replace(trials[3], y=y)
    problem = Problem(replace(experiment, trials=tuple(trials)), noise=pendulum.problem.noise)
    after = forecast(replace(pendulum, problem=problem), (3,))[3]
    np.testing.assert_allclose(after.centre, before.centre, atol=1e-6)
    assert np.all(after.reading == 0.3)


def test_a_model_that_lacks_friction_misses_more_and_says_so():
    experiment = swings(5, trained=3, unseen=4)
    wrong, right = fitted(experiment, "linear"), fitted(experiment)
    entry = forecasts(wrong, right)
    assert entry["before"]["rms"] > 10.0 * entry["after"]["rms"]
    assert entry["after"]["rms"] == pytest.approx(SIGMA, rel=0.15)
    assert entry["before"]["coverage90"] > 0.6  # wide bands, since it misses as much on the trials it was fitted to
    assert entry["before"]["width90"] > 5.0 * entry["after"]["width90"]
    assert [row["trial"] for row in entry["trials"]] == [4, 5, 6, 7]
    square = np.average([row["after"]["rms"] ** 2 for row in entry["trials"]])
    assert entry["after"]["rms"] == pytest.approx(np.sqrt(square))


def test_what_is_too_short_is_left_out(pendulum):
    period = period_of(pendulum, 2)
    assert 1.0 < period / (2.0 * np.pi / np.sqrt(K)) < 1.1
    assert forecast(pendulum, (2,), periods=5.0 / period) == {}
    assert forecast(pendulum, ()) == {}
    alone = replace(pendulum.problem.experiment, trials=pendulum.problem.experiment.trials[:2])
    problem = Problem(alone, noise=pendulum.problem.noise)
    assert forecasts(replace(pendulum, problem=problem), None) == {}


def test_missing_readings_do_not_count(pendulum):
    experiment = pendulum.problem.experiment
    y = experiment.trials[4].y.copy()
    y[:, ::3] = np.nan
    trials = list(experiment.trials)
    trials[4] = replace(trials[4], y=y)
    problem = Problem(replace(experiment, trials=tuple(trials)), noise=pendulum.problem.noise)
    found = forecast(replace(pendulum, problem=problem), (4,))[4]
    assert summary([found])["rms"] == pytest.approx(SIGMA, rel=0.2)
    assert 0.8 < summary([found])["coverage90"] <= 1.0


def test_what_a_held_out_trial_has_for_itself_is_found_however_far_off():
    """Its sensor is off by thirty times what was declared: steps of a size or so would stop half way."""
    experiment = swings(3, trained=2, unseen=1)
    *seen, unseen = experiment.trials
    fit = fitted(replace(experiment, trials=(*seen, replace(unseen, y=unseen.y + 0.03)), offset_sd=(1e-3,)))
    (found,) = predict(fit, [2]).values()
    assert np.std(found.residual) == pytest.approx(SIGMA, rel=0.1)
    assert abs(found.residual.mean()) < 0.5 * SIGMA
    assert np.abs(found.eta).max() > 25.0


def test_values_that_scatter_by_little_do_not_hold_back_the_state_of_a_held_out_trial():
    """Before its initial angle is found they would have to be hundreds of sizes off."""
    experiment = replace(swings(3, trained=2, unseen=1), restoring="linear")
    sizes = tuple(Size(name, sd, 0.0, math.inf, sd) for name, sd in (("k1t", 1e-4), ("c1t", 5e-4), ("drag", 1e-3)))
    noise, switches = Noise((2e-5,), (0.0,), (0.0,)), Switches(scatter=Scatter(sizes))
    problem = Problem(experiment, noise=noise, switches=switches)
    (group,) = problem.grouped((2,))
    true = np.full((1, len(group.nuisances)), 0.3)
    y = problem.simulate(group, np.array([0]), problem.prior_mean()[None], true)[0]
    unseen = replace(experiment.trials[2], y=y)
    problem = Problem(
        replace(experiment, trials=(*experiment.trials[:2], unseen)), noise=noise, switches=switches
    )  # fmt: skip
    (group,) = problem.grouped((2,))
    fit = SimpleNamespace(problem=problem, q=problem.prior_mean())
    away = true.copy()
    away[0, [name for name, *_ in group.nuisances].index("theta0")] -= 1.0
    eta, cost = _descend(fit, group, np.array([0]), away, ROUNDS, (0, 3), NEAR)
    assert cost[0] < 1.0
    assert eta[0, -3:] == pytest.approx(true[0, -3:], abs=0.01)


def test_both_channels_of_trials_released_from_rest():
    """Coupled and uncoupled accelerations of two springs, an effect added: the release angle is each trial's own."""
    cubic = variant("magnet_cubic", "cubic")
    experiment = measured(4, effect=cubic, values={"cubic": 200.0}, duration=0.5)
    problem = Problem(experiment, cubic)
    start = problem.prior_mean()
    fit = calibrate(problem, [start])
    found = forecast(fit, experiment.heldout)
    assert set(found) == set(experiment.heldout)
    told = summary(list(found.values()))
    assert len(told["rms_by_channel"]) == 2
    assert told["rms"] == pytest.approx(2.0, rel=0.1)
    assert 0.4 < told["coverage50"] < 0.6
    assert 0.84 < told["coverage90"] < 0.96


def test_the_unknown_offset_of_a_sensor_is_part_of_the_state():
    experiment = replace(swings(9, trained=2, unseen=3), offset_sd=(0.02,))
    shifted = [replace(t, y=t.y + 0.01 * (i - 2)) for i, t in enumerate(experiment.trials)]
    fit = fitted(replace(experiment, trials=tuple(shifted), priors=experiment.priors | {"c3t": Normal(0.3, 0.1)}))
    told = summary(list(forecast(fit, fit.problem.experiment.heldout).values()))
    assert told["rms"] == pytest.approx(SIGMA, rel=0.25)


def test_waves_of_a_drift_that_the_first_periods_cannot_show_widen_the_bands():
    """A cut record of a free start has fewer of them than the whole one."""
    noise = Noise((SIGMA,), (0.0,), (0.0,))
    found = {}
    for sd in (1e-6, 0.02):
        switches = Switches(scatter=Scatter((Size("drift1", sd, 0.0, math.inf, sd, waves=3),)))
        problem = Problem(swings(9, trained=2, unseen=2), noise=noise, switches=switches)
        found[sd] = forecast(calibrate(problem, [problem.prior_mean()]), (2, 3))
    assert {name for name, *_ in problem.grouped((2,))[0].nuisances} >= {"drift1_1", "drift1_2", "drift1_3"}
    for i in (2, 3):
        assert np.median(found[1e-6][i].sd) < 3.0 * SIGMA
        assert 0.005 < np.median(found[0.02][i].sd) < 0.08


def test_the_period_is_that_of_the_slow_mode_where_it_leads():
    """Two pendulums whose primary swings with both modes, mostly with the slow one; a sensor that misses readings."""
    times = np.arange(600) / 50.0
    slow = np.exp(-0.05 * times) * np.cos(5.7 * times) + 0.3 * np.cos(12.6 * times)
    slow[100:110] = np.nan
    y = np.array([slow, slow])
    trials = tuple(TrialRecord(f"{i}.csv", "A", True, i, times, y, 0, heldout=i == 1) for i in range(2))
    constants = {"J1": (1.0, 0.0), "J2": (1.0, 0.0)}
    experiment = Experiment(constants, ((60.0, 0.0),), trials, "displacement", start="free")
    problem = Problem(experiment, nominal="linear", noise=Noise((0.01,) * 2, (0.0,) * 2, (0.0,) * 2))
    fit = calibrate(problem, [problem.prior_mean()], most=1, anneal=False, finish=False)
    assert period_of(fit, 1) == pytest.approx(2.0 * np.pi / 5.7, rel=0.02)
