"""The first fit of the nominal model: its valley, and the digits of declared constants."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.special import erf
from small_rig import measured
from test_outliers import exchanged
from test_scatter import CASES, laboratory

from bayes_damper.calibration import (
    Experiment,
    Noise,
    Problem,
    Switches,
    TrialRecord,
    calibrate,
    calibrate_nominal,
    gained_by_own_releases,
    learn_noise,
    nominal,
    under,
    with_rounding,
    with_sizes_of_its_own,
)
from bayes_damper.calibration.experiment import default_priors, rounding_sd, unrounded
from bayes_damper.calibration.nominal import _log_density
from bayes_damper.calibration.own_values import RELEASE, Scatter
from bayes_damper.calibration.scatter import carried
from bayes_damper.diagnosis.outliers import odd_trials, without_trials
from bayes_damper.simulation.model import Model


@pytest.mark.parametrize(
    ("value", "unit"),
    [(383.7, 0.1), (0.02548, 1e-5), (216.0, 1.0), (200.0, 1.0), (0.0011, 1e-5), (-1.87, 0.01), (1.25e-7, 1e-9)],
)
def test_a_declared_number_is_known_to_its_last_digit(value, unit):
    """Numbers that are rounded alike lie evenly about it: their standard deviation is that of an even distribution."""
    assert rounding_sd(value) == pytest.approx(unit / math.sqrt(12.0))
    near = np.random.default_rng(1).uniform(value - unit / 2, value + unit / 2, 20_000)
    assert np.std(near) == pytest.approx(rounding_sd(value), rel=0.02)


def test_rounding_is_left_open_where_no_uncertainty_is_declared_and_digits_are_few():
    experiment = laboratory(1, {}, repeats=1, n=20)
    given = replace(
        experiment,
        constants={**experiment.constants, "J1": (3.015e-3, 0.0), "J2": (2.474e-3, 1e-5), "R": (0.1, 0.0)},
        stiffnesses=((6.2, 0.0), (10.212345678, 0.05)),
    )
    found = with_rounding(given)
    pace = rounding_sd(3.015e-3) / 3.015e-3
    assert found.stiffnesses[0][1] == pytest.approx(math.hypot(rounding_sd(6.2), 6.2 * pace))
    assert found.stiffnesses[1][1] == pytest.approx(math.hypot(0.05, 10.212345678 * pace))
    assert found.constants["J2"] == (2.474e-3, 1e-5)
    assert found.constants["r"][1] == pytest.approx(
        0.0127 * math.hypot(rounding_sd(0.0127) / 0.0127, 0.01 / 12**0.5 / 1)
    )
    assert found.constants["J1"] == (3.015e-3, 0.0)
    exact = replace(
        given, constants={**given.constants, "J1": (0.0030151234567, 0.0)}, stiffnesses=((6.2123456789, 0.0),)
    )
    assert with_rounding(exact).stiffnesses == exact.stiffnesses


def test_no_curve_of_friction_in_use_is_less_likely_than_another():
    """Smoothed signs, and the tail that meets each best beside a viscous damping, over a quarter of a swing."""
    x = 20.0 * np.sin(np.linspace(0.0, 0.5 * math.pi, 1000))
    three = (np.tanh, lambda x: x / np.hypot(1.0, x), lambda x: 2.0 / math.pi * np.arctan(0.5 * math.pi * x))
    in_use = (
        (-0.4, lambda x: np.clip(x, -1.0, 1.0)),
        (-0.15, lambda x: erf(0.5 * math.sqrt(math.pi) * x)),
        *zip((0.0, 0.5, 1.0), three, strict=True),
        (1.4, lambda x: x / (1.0 + np.abs(x))),
    )
    prior = default_priors(measured(1))["tail"]
    for expected, curve in in_use:

        def left(p, curve=curve):
            sharpness, tail = math.exp(p[0]), p[1]
            parabola = ((1.0 - tail) * (1.0 - 2.0 * tail), 4.0 * tail * (1.0 - tail), tail * (2.0 * tail - 1.0))
            sign = sum(w * f(sharpness * x) for w, f in zip(parabola, three, strict=True))
            columns = np.stack([sign, x], axis=1)
            return columns @ np.linalg.lstsq(columns, curve(x), rcond=None)[0] - curve(x)

        fits = [least_squares(left, (s, t), x_scale=(0.1, 0.5)) for s in (-0.5, 0.5) for t in (0.0, 1.0)]
        tail = min(fits, key=lambda fit: fit.cost).x[1]
        assert tail == pytest.approx(expected, abs=0.06)
        assert prior.logpdf(tail) == pytest.approx(float(prior.logpdf(0.5)))


@pytest.mark.slow
def test_a_stiffness_in_three_digits_leaves_no_gap():
    """Springs that are stiffer by 6e-4 than declared, within their last digit: hundreds of nats, and no missing law."""
    stiff = laboratory(3, {}, stiffer=1.0006, n=1500, noise=0.5, repeats=5)
    plain, found = calibrate_nominal(stiff), calibrate_nominal(with_rounding(stiff))
    assert plain.excess > 300.0
    assert abs(found.excess) < 4.0 * math.sqrt(2.0 * found.problem.n_data)
    for _, k1t, _ in CASES:
        value, sd = found.parameters[f"k1t[{k1t:g}]"]
        assert value == pytest.approx(1.0006 * k1t, abs=4.0 * sd)
        assert sd < 1e-4 * value


@pytest.mark.slow
def test_the_fit_finds_the_valley_of_a_coupling_that_holds():
    """A stiff magnet with a light friction, far from the prior medians, over three periods.

    A descent whose step is cut short as a whole where one coordinate would go too far ends, from the medians, in a
    valley in which the coupling slips at once, with fifty times the chi-square.
    """
    rig = {"J1": 0.02676, "J2": 0.02924, "R": 0.06655, "r": 0.005428, "N0": 199.2}
    true = {"k2t": 128.8, "c2t": 0.2142, "c1t": 0.01073, "c3t": 0.004613, "mu": 0.006634, "drag": 0.004604, "nu": 4.84}
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 0.47, 0.47 / 88)
    trials = []
    for index, (case, k1t, degrees) in enumerate((("I", 48.72, 2.885), ("II", 29.42, 2.389))):
        for both in (False, True):
            for number in (1, 2, 3):
                theta0 = math.radians(degrees) * (1.0 + 0.015 * rng.standard_normal())
                start = {"k1t": k1t, "theta0": theta0, "delay": -4e-4 * rng.random()}
                y = Model(both).simulate(rig | true | start, times).y[0]
                y = y + 0.14 * rng.standard_normal(y.shape)
                angle = math.radians(degrees)
                label = f"{case}{number}{both}"
                trials.append(TrialRecord(label, case, both, number, times, y, index, angle, 0.0155 * angle))
    constants = {name: (value, 0.004 * value * (name != "N0")) for name, value in rig.items()}
    fit = calibrate_nominal(Experiment(constants, ((48.72, 0.2), (29.42, 0.13)), tuple(trials), "acceleration"))
    assert fit.chi2 < 1.3 * fit.problem.n_data
    assert fit.parameters["k2t"][0] == pytest.approx(128.8, rel=0.05)
    at_once = calibrate(Problem(fit.problem.experiment, noise=fit.problem.noise))
    assert at_once.chi2 < 1.3 * fit.problem.n_data  # from the prior medians alone


@pytest.mark.slow
def test_releases_that_fade_within_a_first_reading_are_found():
    """Holds that let go within 0.05 to 0.12 ms, a fiftieth of a sample late: in half of the trials the first reading is
    taken in the midst of it, and no descent leads there from a release in an instant.
    """
    fading = laboratory(
        2, {}, repeats=3, coupled=True, n=300, releases=lambda rng: rng.uniform(5e-5, 1.2e-4), instants=4e-5, noise=0.5
    )  # fmt: skip
    fit = calibrate_nominal(fading)
    assert fit.chi2 < 1.2 * fit.problem.n_data  # 6 where times of release are dropped, 4 where they are not found


@pytest.mark.slow
def test_a_logger_that_starts_after_every_release_by_the_same_time_is_no_gap():
    exact = measured(3, rate=2500.0, duration=0.4)
    assert not calibrate_nominal(exact).problem.switches.delay
    after = tuple(replace(t.at(np.s_[1::2]), times=t.times[:-1:2]) for t in exact.trials)
    fit = calibrate_nominal(replace(exact, trials=after))
    found = []
    for group in fit.problem.groups:
        m = [name for name, _, _ in group.nuisances].index("delay")
        _, mean, sd = group.nuisances[m]
        found += [mean[k] + sd[k] * fit.eta[i][m] for k, i in enumerate(group.trials)]
    assert found == pytest.approx([-4e-4] * len(found), abs=1e-4)
    assert fit.excess < 0.1 * fit.problem.n_data


def test_releases_that_end_beyond_the_next_reading_of_a_displacement_are_followed():
    """A reading late and up to three readings long: their shape was taken for noise of twelve times the size."""
    slow = laboratory(
        6, {}, repeats=4, n=300, releases=lambda rng: rng.uniform(0.0, 3e-3), instants=8e-4, noise=2e-5,
        quantity="displacement",
    )  # fmt: skip
    fit = calibrate_nominal(slow)
    assert fit.converged
    assert fit.problem.noise.total == pytest.approx((2e-5,), rel=0.1)


@pytest.mark.parametrize("repeats", [6, 3])
def test_instants_that_are_the_declared_ones_have_no_prior_of_their_own(repeats):
    """Where coloured noise makes instants seem to vary, 14 nats lay in their priors: an effect could spare them."""
    rng = np.random.default_rng(1)
    drawn = laboratory(1, {"k1t": 2e-3, "c1t": 0.06}, repeats=repeats, n=700, noise=0.0)
    trials = []
    for t in drawn.trials:
        noise = 0.4 * rng.standard_normal(t.y.shape)
        for k in range(1, noise.shape[1]):
            noise[:, k] += 0.8 * noise[:, k - 1]
        trials.append(replace(t, y=t.y + noise))
    assert not calibrate_nominal(replace(drawn, trials=tuple(trials))).problem.switches.delay


def test_the_fit_reports_what_it_leaves_of_the_readings():
    """Their rms beside that of the residuals; it gave a noise learnt from repeats, which may be above the readings."""
    said = []
    measurements = measured(3)
    fit = calibrate_nominal(measurements, report=said.append)
    left, read = map(
        float, re.search(r"leaves \(rms of each channel, SI units\) ([\d.e+-]+) of ([\d.e+-]+)", said[0]).groups()
    )
    every = np.concatenate([measurements.trials[i].y[0] for i in fit.problem.trials])
    assert read == pytest.approx(math.sqrt(np.mean(every**2)), rel=0.01)
    assert left == pytest.approx(fit.problem.noise.total[0], rel=0.1)


@pytest.mark.parametrize("instants", [0.0, 2e-4])
def test_many_repeats_show_a_small_scatter_of_the_instant(instants):
    """A fifth of a sample: a mean square of 5.7 of 20 differences, which 4 of them might show by chance."""
    drawn = laboratory(2, {}, repeats=12, n=300, quantity="displacement", noise=3e-3, instants=instants)
    assert calibrate_nominal(drawn).problem.switches.delay == (instants > 0.0)


def test_readings_that_exact_instants_leave_out_do_not_count_in_their_units():
    """Of instants of each trial's own a noise 40 times smaller costs the logarithm of 40 a trial, no more and no less.

    With first readings that show the rig still held, which have no weight where instants are exact: it cost nothing.
    """
    gained = []
    for noise in (2.0, 0.05):
        drawn = laboratory(1, {}, repeats=3, n=60, noise=noise)
        held = tuple(replace(t, y=np.where(np.arange(60) == 0, noise, t.y)) for t in drawn.trials)
        sudden = Problem(
            replace(drawn, trials=held), switches=Switches(friction=False), noise=Noise((noise,), (0.0,), (0.0,))
        )
        own = calibrate(sudden)
        exact = sudden.changed(switches=replace(sudden.switches, delay=False))
        alike = calibrate(exact, [own.q], eta=carried(own, exact), anneal=False)
        gained.append(_log_density(alike) - _log_density(own))
    trials = len(sudden.trials)
    assert gained[1] - gained[0] == pytest.approx(trials * math.log(40.0), abs=3.0)


def test_a_release_late_by_more_than_a_reading_is_followed():
    """As much as one and a half of them is left to the fit; beyond one it was taken for a slow release, 61 nats."""
    late = laboratory(
        4, {}, repeats=2, coupled=True, n=400, releases=lambda rng: rng.uniform(0.0, 6e-4), instants=1e-3, noise=1e-3,
        quantity="velocity",
    )  # fmt: skip
    fit = calibrate_nominal(late)
    assert fit.problem.noise.total == pytest.approx((1e-3, 1e-3), rel=0.1)


@pytest.mark.slow
def test_own_times_of_release_count_where_none_could_be_learnt():
    slow = [
        laboratory(
            1,
            {},
            repeats=n,
            coupled=True,
            n=300,
            releases=lambda _: 3e-3,
            instants=4e-4,
            quantity="velocity",
            noise=5e-3,
        )
        for n in (2, 4)
    ]
    assert gained_by_own_releases(calibrate_nominal(slow[0])) > 3.0
    assert gained_by_own_releases(calibrate_nominal(slow[1])) == 0.0  # repeats would show them


@pytest.mark.slow
def test_trials_without_repeats_that_are_let_go_slowly_have_times_of_their_own():
    """By 2 to 8 ms at an acceleration a millisecond, the usual time being 0.3: sudden ones leave an error."""
    slow = laboratory(2, {}, repeats=1, n=300, releases=lambda rng: rng.uniform(2e-3, 8e-3), instants=3e-4)
    fit = calibrate_nominal(slow)
    scatter = fit.problem.switches.scatter
    assert scatter.sd("release_time") > 0.0
    assert gained_by_own_releases(fit) == 0.0
    others = replace(scatter, sizes=tuple(s for s in scatter.sizes if s.name != "release_time"))
    sudden = with_sizes_of_its_own(under(fit, fit.problem.noise, others))
    assert sudden.problem.noise.total[0] > 1.5 * fit.problem.noise.total[0]


def test_a_reading_that_the_fit_does_not_trust_shows_nothing_of_the_noise():
    """The second reading of a record, within the release, off by 300 standard deviations of the noise."""
    rig = laboratory(1, {}, repeats=1, n=300)
    problem = Problem(rig, switches=Switches(delay=False, friction=False), noise=Noise((2.0,), (0.0,), (0.0,)))
    fit = calibrate(problem, anneal=False)
    first = rig.trials[0]
    off = replace(first, y=first.y + 600.0 * (np.arange(first.times.size) == 1))
    spoilt = Problem(
        replace(rig, trials=(off, *rig.trials[1:])), switches=problem.switches, noise=problem.noise
    )  # fmt: skip
    again = calibrate(spoilt, [fit.q], eta=fit.eta, anneal=False, most=0, finish=False)
    assert again.problem.groups[0].weight[0, 0, 1] < 0.9
    assert learn_noise(again).total[0] == pytest.approx(learn_noise(fit).total[0], rel=0.02)


@pytest.mark.slow  # 5 s
def test_the_noise_of_an_encoder_is_learnt_until_it_settles():
    """A pendulum by scipy in 4096 steps a turn, off by a step. One turn of learning left a valley with drag 0.174."""
    rng, step, times = np.random.default_rng(20261124), 2.0 * math.pi / 4096, np.arange(0.0, 14.0, 0.005)

    def rate(_, x):
        return x[1], -38.0 * np.sin(x[0]) - 0.05 * x[1] - 0.12 * np.tanh(x[1] / 0.02)

    trials = []
    for i in range(3):
        start = (np.radians(25.0 + 0.3 * rng.standard_normal()), 0.0)
        late = times - rng.uniform(0.0, 0.005)
        angle = solve_ivp(rate, (0.0, 15.0), start, "LSODA", np.maximum(late, 0.0), rtol=1e-8, atol=1e-9).y[0]
        trials.append(TrialRecord(f"{i}.csv", "A", False, i + 1, times, step * (np.round(angle / step)[None] - 1.0), 0))
    experiment = unrounded(
        Experiment(
            {"J1": (1.0, 0.0)}, ((38.0, 0.0),), tuple(trials), "displacement", restoring="pendulum", start="free"
        )
    )
    fit = calibrate_nominal(experiment)
    for name, true in (("drag", 0.12), ("c1t", 0.05)):
        value, sd = fit.parameters[name]
        assert abs(value - true) < 4.0 * sd < 0.1 * true


def test_a_fit_goes_on_from_one_before_some_readings_were_left_out():
    """It ends where a fit from its own starts does, which searches the whole prior for it."""
    experiment = laboratory(4, {"k1t": 0.004}, repeats=4, noise=0.5)
    spoilt = experiment.trials[1].y.copy()
    spoilt[0, 100:103] += 60.0
    cut = spoilt.copy()
    cut[0, 100:103] = np.nan
    with_readings, without_them = (
        replace(experiment, trials=(experiment.trials[0], replace(experiment.trials[1], y=y), *experiment.trials[2:]))
        for y in (spoilt, cut)
    )
    before = calibrate_nominal(with_readings)
    alone, after = calibrate_nominal(without_them), calibrate_nominal(without_them, begin=before)
    assert after.problem.n_data == pytest.approx(alone.problem.n_data)
    assert nominal._log_density(after) > nominal._log_density(alone) - 0.5
    for name, (value, sd) in alone.parameters.items():
        assert abs(after.parameters[name][0] - value) < 0.2 * sd


@pytest.mark.slow
def test_releases_that_are_all_sudden_in_the_end_have_no_times_of_their_own():
    """Sizes are learnt from times on the way, which may all be sudden in the end."""
    experiment, _, _ = exchanged()
    fit = calibrate_nominal(without_trials(experiment, odd_trials(experiment)))
    sizes = tuple(s for s in fit.problem.switches.scatter.sizes if s.name != RELEASE)
    sudden = fit.problem.changed(switches=replace(fit.problem.switches, scatter=Scatter(sizes)))
    found = calibrate(sudden, [fit.q], eta=carried(fit, sudden), anneal=False)
    assert nominal._log_density(fit) > nominal._log_density(found) - 0.05
