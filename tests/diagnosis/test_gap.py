"""The gap on held-out trials: a test of its stated size, with power, and honest shares of what is closed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm
from small_rig import NOISE, measured, variant

from bayes_damper.calibration import Problem, Switches, calibrate, calibrate_nominal, coordinate_of, predict
from bayes_damper.diagnosis.gap import (
    _by_trials,
    _length,
    _undecided,
    correlation,
    held_out_test,
    left_out_case,
    measure_gap,
    repeats_say,
    shifts,
    taken_up,
    unshared_along,
)

CUBIC = variant("magnet_cubic", "cubic")


@pytest.fixture(scope="module")
def both():
    """The nominal fit and the fit of the true formula, on data with a cubic magnet."""
    nominal = calibrate_nominal(measured(4, effect=CUBIC, values={"cubic": 400.0}))
    problem = nominal.problem.with_effect(CUBIC)
    winner = calibrate(problem, [np.append(nominal.q, 0.5)], eta=nominal.eta, anneal=False)
    return nominal, winner


@pytest.mark.slow
def test_the_test_has_its_stated_size():
    """200 small campaigns without a gap, each fitted anew: about 5 % are called a gap, never many more."""
    alarms = 0
    p_values = []
    switches = Switches(delay=False, friction=False)
    start = None
    for seed in range(200):
        experiment = measured(1000 + seed, configurations=(False,), duration=0.25, rate=500.0)
        problem = Problem(experiment, switches=switches)
        fit = calibrate(problem, [np.zeros(problem.size) if start is None else start], anneal=False, finish=False)
        start = fit.q
        gap = measure_gap(fit)
        p_values.append(gap.p_value)
        alarms += gap.answer == "gap"
    assert 1 <= alarms <= 20  # 10 expected; beyond 20 once in a thousand
    assert 0.4 < np.mean(p_values) < 0.6


def test_a_gap_is_found_and_closed_by_its_cause(both):
    nominal, winner = both
    gap = measure_gap(nominal, winner)
    assert gap.answer == "gap"
    assert gap.p_value < 1e-6
    assert gap.nominal_rms > gap.augmented_rms
    assert gap.augmented_rms == pytest.approx(gap.noise_rms, rel=0.03)
    assert 0.8 < gap.closed.median < 1.2
    low, high = gap.closed.hdi90
    assert low < gap.closed.median < high
    entry = gap.to_json()
    assert {"answer", "p_value", "size", "noise_rms", "nominal_rms", "augmented_rms", "closed"} <= set(entry)


def test_no_gap_is_left_under_the_cause(both):
    _, winner = both
    assert measure_gap(winner).p_value > 0.01


def test_predictions_made_of_noise_find_nothing():
    """Random shapes: p-values are even, and many of them are paid for."""
    fit = calibrate_nominal(measured(3))
    experiment = fit.problem.experiment
    eta = {i: np.zeros(len(g.nuisances)) for g in fit.problem.grouped(experiment.heldout) for i in g.trials}
    rng = np.random.default_rng(5)

    def shape():
        return {i: rng.standard_normal(experiment.trials[i].y.shape) for i in experiment.heldout}

    single = [held_out_test(fit, eta, [shape()]) for _ in range(60)]
    assert 0.3 < np.mean(single) < 0.7
    assert held_out_test(fit, eta, [shape() for _ in range(20)]) > 0.05
    assert held_out_test(fit, eta, []) == 1.0
    assert set(repeats_say(fit)) == set(experiment.heldout)


def test_repeats_are_compared_whatever_their_clocks():
    """Each trial has a clock of its own and ends where it likes: what they share and do not share is known as well."""
    even, rng = measured(3, repeats=3, duration=0.15), np.random.default_rng(3)

    def own(t):
        step = float(np.median(np.diff(t.times)))
        times = np.sort(t.times + step * np.concatenate([[0.0], rng.uniform(-0.4, 0.4, t.times.size - 1)]))
        last = int(rng.integers(1, 6))
        y = np.array([np.interp(times, t.times, x) for x in t.y])
        return replace(t, times=times[:-last], y=y[:, :-last])

    told = []
    for experiment in (even, replace(even, trials=tuple(own(t) for t in even.trials))):
        fit = calibrate(Problem(experiment), anneal=False, most=3)
        said = repeats_say(fit)
        assert set(said) == set(experiment.heldout)
        assert all(x.shape == experiment.trials[i].y.shape for i, x in said.items())
        told.append(unshared_along(fit, {i: np.ones(x.size) for i, x in said.items()}))
    assert told[1][1] == pytest.approx(told[0][1], rel=0.05)
    assert told[0][1] > 1.0
    assert told[1][0] == pytest.approx(told[0][0], rel=1.0)


def test_parameters_stop_pretending_once_the_cause_is_there(both):
    nominal, winner = both
    moved = {s.name: s for s in shifts(nominal, winner)}
    assert abs(moved["k2t"].sigmas) > 3.0
    value, sd = moved["k2t"].after
    assert value == pytest.approx(1.2, abs=4.0 * sd)
    assert abs(moved["k2t"].before[0] - 1.2) > abs(value - 1.2)


def test_a_left_out_case_is_predicted_better_with_the_cause(both):
    nominal, winner = both
    found = left_out_case(nominal, winner, "I")
    assert found.closed.median > 0.7
    assert found.augmented_rms < found.nominal_rms
    with pytest.raises(ValueError, match="cases are"):
        left_out_case(nominal, winner, "IX")


def test_leaving_out_the_only_case_is_refused():
    fit = calibrate_nominal(measured(3, cases=(("I", 0, 0.1),)))
    with pytest.raises(ValueError, match="two cases"):
        left_out_case(fit, fit, "I")


def test_without_repeats_the_answer_is_that_none_can_be_told():
    gap = measure_gap(calibrate_nominal(measured(3, repeats=1)))
    assert gap.answer == "cannot tell"
    assert "repeat" in gap.why
    assert gap.closed is None


def test_held_out_trials_that_differ_far_beyond_the_noise_are_not_said_to_show_nothing():
    """Of a chaotic drive: 130 times the noise, and "no gap, but one as large as that could hide"."""
    fit = calibrate_nominal(measured(3))
    e = fit.problem.experiment
    rng = np.random.default_rng(5)
    odd = tuple(replace(t, y=t.y + 10.0 * NOISE * rng.standard_normal(t.y.shape)) if t.heldout else t for t in e.trials)
    gap = measure_gap(replace(fit, problem=fit.problem.changed(experiment=replace(e, trials=odd))))
    assert gap.answer == "cannot tell"
    assert gap.nominal_rms > 5.0 * gap.noise_rms
    assert gap.why.startswith(f"held-out residuals are {float(f'{gap.nominal_rms / gap.noise_rms:.2g}'):g} times")
    assert "other than the training trials predict" in gap.why
    other = tuple(replace(t, case=t.case + " held out") if t.heldout else t for t in odd)
    alone = measure_gap(replace(fit, problem=fit.problem.changed(experiment=replace(e, trials=other))))
    assert "no trial that was fitted repeats them" in alone.why


@pytest.mark.parametrize(
    ("augmented", "p", "repeated", "said"),
    [
        (None, 1.0, False, "there is no candidate whose prediction could be compared"),
        (25.0, 0.3, False, "the best candidate comes no closer to them"),
        (7.6, 0.44, False, "leaves 7.6 times the noise, but .* as closely by chance in up to 44 of 100 cases"),
        (7.6, 1.0, False, "as closely by chance nearly always"),
        (7.6, 0.44, True, "other than the training trials predict"),
    ],
)
def test_why_residuals_far_beyond_the_noise_show_no_law_is_said_in_words(augmented, p, repeated, said):
    """Of three stretches of one decay: 21 times the noise, of which a candidate closes 87 %, and p = 0.44."""
    why = _undecided(21.0, augmented, 1.0, p, repeated)
    assert why.startswith("held-out residuals are 21 times the sensor noise, so the nominal model is wrong there")
    assert re.search(said, why)
    assert ("no trial that was fitted repeats them" in why) == (not repeated)


def test_a_short_campaign_without_a_sign_cannot_exclude_a_gap():
    experiment = measured(21, cases=(("I", 0, 0.1),), configurations=(False,), repeats=2, duration=0.1)
    gap = measure_gap(calibrate_nominal(experiment))
    assert gap.answer == "cannot tell"
    as_large = f"{float(f'{gap.upper_rms:.2g}'):g}"
    assert f"show no gap, but one as large as {as_large} times the sensor noise could hide in them: add" in gap.why


def test_what_values_of_each_trials_own_take_up_is_not_said_to_be_no_gap():
    """All rest angles are declared ten standard deviations too large: own angles, and gains, take that up."""
    e = measured(3, configurations=(False,))
    sound = calibrate_nominal(e)
    assert taken_up(sound, predict(sound, e.heldout)) == {}
    wrong = replace(e, trials=tuple(replace(t, theta0=1.1 * t.theta0, theta0_sd=0.01 * t.theta0) for t in e.trials))
    fit = calibrate_nominal(wrong)
    assert set(taken_up(fit, predict(fit, e.heldout))) <= {"theta0", "gain1"}
    gap = measure_gap(fit)
    assert gap.p_value > 0.05
    assert gap.nominal_rms < 1.2 * gap.noise_rms
    assert gap.answer == "cannot tell"
    off = float(re.search(r"theta0 ([+-]\d+)", gap.why).group(1))
    assert -11.0 < off < -5.0
    assert "it does not see a gap that they take up" in gap.why
    assert gap.to_json()["taken_up"] == taken_up(fit, predict(fit, e.heldout))


def slow_errors(seed, width=20.0):
    """Adds noise of a quarter of the rig's period to what the channels show: an error of the model, trial by trial.

    width : of the noise's kernel, in readings.
    """
    reach = round(3.0 * width)
    rng = np.random.default_rng(seed)

    def sensor(times, y):
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
        rough = rng.standard_normal((y.shape[0], times.size + 2 * reach))
        return y + 12.0 * np.array([np.convolve(x, kernel, "valid") for x in rough]) / np.linalg.norm(kernel)

    return sensor


def test_correlated_errors_of_lone_trials_widen_the_test():
    """Trials without repeats, slow errors: with those a slow prediction moves far, a fast one hardly."""
    cases = (("I", 0, 0.1), ("II", 0, 0.13), ("III", 1, 0.08), ("IV", 1, 0.11))
    found = measured(50, cases=cases, configurations=(False,), repeats=1, sensor=slow_errors(1))
    trials = tuple(replace(t, heldout=t.case == "II") for t in found.trials)
    fit = calibrate_nominal(replace(found, trials=trials))
    assert fit.problem.noise.sensor
    covariance = correlation(list(fit.residuals().values()), fit.problem.noise.total)
    slow, fast = (_length({1: np.sin(w * np.arange(500))[None]}, covariance) for w in (0.03, 1.5))
    assert slow > 5.0 * fast


HARDENING = variant("spring_cubic")


def lone_gap(seed, k3):
    """Of three trials without repeats, slow errors and a spring that may harden, one held out."""
    rows = (("I", 0, 0.1), ("II", 0, 0.13), ("III", 0, 0.08))
    effect, values = (HARDENING, {"k3": k3}) if k3 else (None, None)
    found = measured(
        seed, cases=rows, configurations=(False,), repeats=1, rate=500.0, sensor=slow_errors(seed, 10.0),
        effect=effect, values=values,
    )  # fmt: skip
    trials = tuple(replace(t, heldout=t.case == "II") for t in found.trials)
    fit = calibrate_nominal(replace(found, trials=trials))
    starts = [np.array([coordinate_of(HARDENING.parameters[0].prior, x)]) for x in (-40.0, 40.0)]
    winner = calibrate(fit.problem.with_effect(HARDENING), [np.concatenate([fit.q, s]) for s in starts], anneal=False)
    assert fit.problem.noise.sensor
    return measure_gap(fit, winner)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sound", "most"),  # more alarms come in fewer than one of 150 tests of its size
    [(8, 2), pytest.param(40, 6, marks=pytest.mark.prove)],
)
def test_a_gap_without_repeats_is_measured_against_what_its_cause_leaves(sound, most):
    """What the nominal model leaves, three times as much, holds the gap; where there is none the test has its size."""
    assert all(lone_gap(100 + seed, 75.0).p_value < 0.04 for seed in range(4))
    alarms = [lone_gap(100 + seed, 0.0).answer == "gap" for seed in range(sound)]
    assert sum(alarms) <= most


def test_the_length_of_a_prediction_is_the_spread_of_its_product_with_correlated_noise():
    rng = np.random.default_rng(4)
    phi, n = 0.9, 300
    noise = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.standard_normal((4000, n + 100)), axis=1)[:, 100:]
    x = np.sin(0.03 * np.arange(n))
    found = _length({0: x[None]}, [phi ** np.arange(200)])
    assert found == pytest.approx(float(np.std(noise @ x)), rel=0.05)
    assert found > 3.0 * np.linalg.norm(x)


def test_a_choice_that_looked_at_the_held_out_trials_is_paid_for(both):
    nominal, winner = both
    assert measure_gap(nominal, winner, chosen_from=10**30).p_value > measure_gap(nominal, winner).p_value
    experiment = nominal.problem.experiment
    eta = {i: np.zeros(len(g.nuisances)) for g in nominal.problem.grouped(experiment.heldout) for i in g.trials}
    rng = np.random.default_rng(6)
    shape = {i: rng.standard_normal(experiment.trials[i].y.shape) for i in experiment.heldout}
    once = held_out_test(nominal, eta, [shape])
    assert held_out_test(nominal, eta, [shape], [3]) == pytest.approx(min(1.0, 3.0 * once))


def test_what_repeats_do_not_share_is_no_gap():
    """A slow wave of each trial's own size, for which the model has no place: called a gap as rarely as noise is."""
    alarms = 0
    switches = Switches(delay=False, friction=False)
    start = None
    for seed in range(60):
        rng = np.random.default_rng(seed)

        def wave(times, y, rng=rng):
            return y + 0.7 * NOISE * rng.standard_normal() * np.sin(30.0 * times)

        experiment = measured(2000 + seed, configurations=(False,), duration=0.25, rate=500.0, repeats=6, sensor=wave)
        problem = Problem(experiment, switches=switches)
        fit = calibrate(problem, [np.zeros(problem.size) if start is None else start], anneal=False, finish=False)
        start = fit.q
        alarms += measure_gap(fit).answer == "gap"
    assert alarms <= 9  # 3 expected; by the noise alone a third of them would be


def test_held_out_trials_show_how_they_vary_where_nothing_else_does():
    """Eight products of one sign and size are no chance; one large among seven small ones may be."""
    assert _by_trials(np.ones(8), np.ones(8), 8.0) < 1e-4
    assert _by_trials(np.array([8.0, *np.zeros(3), 0.1, -0.1, 0.1, 0.05]), np.ones(8), 8.0) > 0.1
    assert _by_trials(np.array([2.0]), np.ones(1), 2.0) == pytest.approx(float(norm.sf(2.0)))


def test_held_out_trials_in_which_nothing_is_expected_do_not_hide_what_the_others_show():
    """Coupled trials show a gap, uncoupled ones hardly any: what the latter show is neither for nor against it."""
    products, expected = np.array([9.0, 7.0, 8.0, 10.0, *np.zeros(6)]), np.array([9.0, 9.0, 8.0, 8.0, *np.full(6, 0.1)])
    assert _by_trials(products, expected, 9.0) < 0.002 < 0.01 < _by_trials(products, np.ones(10), 9.0)
