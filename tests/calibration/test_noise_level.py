"""Levels of parameters: one value for the campaign, for each case, for each trial, fixed, or that of another."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from coloured import autoregression
from small_rig import NOISE, RIG, measured
from test_forecast import swings

from bayes_damper.calibration import (
    Experiment,
    Noise,
    Problem,
    Switches,
    calibrate,
    calibrate_nominal,
    learn_noise,
    with_priors,
)
from bayes_damper.calibration.noise import fast_level, tails_of
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import LogNormal, Normal, Uniform
from bayes_damper.priors.files import priors_from_dict

WHITE = Noise((NOISE, NOISE), (0.0, 0.0), (0.0, 0.0))
RELEASE = Switches(delay=False, friction=False)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return measured(3, duration=0.25, repeats=2)


def _under(experiment: Experiment, **entries: object) -> Experiment:
    return with_priors(experiment, priors_from_dict(entries, recorded=True))


def _problem(experiment: Experiment, **entries: object) -> Problem:
    return Problem(_under(experiment, **entries), noise=WHITE, switches=RELEASE)


CASES = {"I": {"median": 1.0}, "IV": {"median": 1.5}}
CASE, TRIAL = {"level": "case"}, {"level": "trial"}


def test_a_level_alone_keeps_the_default_prior(experiment: Experiment) -> None:
    shared, own = _problem(experiment), _problem(experiment, mu=CASE, c1t=CASE)
    assert set(own.names) - set(shared.names) == {"mu[I]", "mu[IV]", "c1t[I]", "c1t[IV]"}
    priors = {c.name: c.prior for c in (*shared.coordinates, *own.coordinates)}
    assert priors["mu"] == priors["mu[I]"] == priors["mu[IV]"]


def test_values_per_case_move_only_the_trials_of_the_case(experiment: Experiment) -> None:
    problem = _problem(experiment, k2t=CASE)
    group = next(g for g in problem.groups if g.coupled)
    which, none = np.arange(len(group.trials)), np.zeros((len(group.trials), len(group.nuisances)))
    moved = np.zeros((len(which), problem.size))
    base = problem.simulate(group, which, moved, none)
    moved[:, problem.names.index("k2t[IV]")] = 0.5
    change = np.abs(problem.simulate(group, which, moved, none) - base).max(axis=(1, 2))
    in_case = np.array([experiment.trials[i].case == "IV" for i in group.trials])
    assert np.all(change[in_case] > 1.0)
    assert np.all(change[~in_case] == 0.0)


@pytest.mark.parametrize(
    "entries",
    [
        {"mu": CASE, "c1t": CASE, "c3t": "c1t"},
        {"c1t": "c3t", "drag": TRIAL, "c2t": TRIAL},
        {"theta0": CASE, "delay": {"level": "campaign", "dist": "normal", "mean": 0.3, "sd": 0.2, "unit": "ms"}},
        {"delay": {"dist": "uniform", "lower": 0.0, "upper": 1.0, "unit": "ms"}, "nu": 60.0},
        {
            "k2t": {"dist": "lognormal", "factor": 2.0, "unit": "N m/rad", "cases": CASES}
        },
    ],
    ids=", ".join,
)  # fmt: skip
def test_derivatives_hold_at_every_level(experiment: Experiment, entries: dict[str, object]) -> None:
    problem = Problem(_under(experiment, **entries), noise=WHITE, switches=RELEASE, tolerance=0.01)
    eta = {i: 0.1 + v for i, v in problem.no_nuisance().items()}
    q = np.full(problem.size, 0.1)
    for block in problem.linearise(q, eta, central=True).blocks:
        group, n = block.group, len(block.group.trials)
        own = np.array([eta[i] for i in group.trials]).reshape(n, -1)
        which = np.arange(n)

        def whitened(q: np.ndarray, values: np.ndarray, group=group, which=which, n=n) -> np.ndarray:
            y = problem.simulate(group, which, np.tile(q, (n, 1)), values)
            return problem.whitened(y - group.y, group.weight)

        for i in range(problem.size):
            up, down = (q + h * np.eye(problem.size)[i] for h in (2e-3, -2e-3))
            slope = (whitened(up, own) - whitened(down, own)) / 4e-3
            np.testing.assert_allclose(block.J[:, i], slope, atol=2e-3 * (1.0 + np.abs(slope).max()))
        for i, (name, _, _) in enumerate(group.nuisances):
            if name in ("ln_mu", "delay"):  # taken from mu's own derivative; a reversal has no derivative by time
                continue
            step = 2e-3 * np.eye(own.shape[1])[i]
            slope = (whitened(q, own + step) - whitened(q, own - step)) / 4e-3
            np.testing.assert_allclose(block.T[:, i], slope, atol=2e-3 * (1.0 + np.abs(slope).max()))


def test_a_tie_is_the_same_as_two_equal_values(experiment: Experiment) -> None:
    tied = _problem(
        experiment, c3t="c1t", c1t={"dist": "lognormal", "median": 0.01, "factor": 2.0, "unit": "N m s/rad"}
    )
    assert "c3t" not in tied.names
    both = {"c1t": LogNormal(0.01, 2.0), "c3t": LogNormal(0.01, 2.0)}
    free = Problem(replace(experiment, priors=both), noise=WHITE, switches=RELEASE)
    point = np.linspace(-0.3, 0.3, tied.size)
    value = point[tied.names.index("c1t")]
    rest = np.array([point[tied.names.index(n)] if n in tied.names else value for n in free.names])
    for a, b in zip(tied.groups, free.groups, strict=True):
        which, none = np.arange(len(a.trials)), np.zeros((len(a.trials), len(a.nuisances)))
        first = tied.simulate(a, which, np.tile(point, (len(which), 1)), none)
        second = free.simulate(b, which, np.tile(rest, (len(which), 1)), none)
        np.testing.assert_array_equal(first, second)


def test_a_value_of_each_trial_is_a_nuisance_and_no_dimension(experiment: Experiment) -> None:
    problem = _problem(experiment, c1t=TRIAL, mu=TRIAL)
    assert not {"c1t", "mu"} & set(problem.names)
    names = {g.coupled: [name for name, _, _ in g.nuisances] for g in problem.groups}
    assert names == {False: ["theta0", "ln_c1t"], True: ["theta0", "ln_c1t", "ln_mu"]}


def test_integrating_a_trials_own_damping_out_agrees_with_brute_force() -> None:
    experiment = _under(
        measured(5, duration=0.2, repeats=2, cases=[("I", 0, 0.1)]), c1t=TRIAL, theta0=5.7 * math.pi / 180
    )
    posterior = RecordPosterior(calibrate(Problem(experiment, noise=WHITE, switches=RELEASE)))
    problem = posterior.problem
    rng = np.random.default_rng(2)
    points = rng.multivariate_normal(posterior.start, posterior.covariance, size=2)
    found = posterior.log_likelihood(points)
    scales = posterior.noise_scale(points)
    for k, point in enumerate(points):
        row = 0
        for part in posterior.parts:
            group = part.group
            for j in range(len(group.trials)):
                s = scales[k, row, : group.y.shape[1]]
                spread = 1.0 / math.sqrt(1.0 + float(np.sum(part.TT[j, :, 0, 0] / s**2)))
                grid = part.eta[j, 0] + spread * np.linspace(-7.0, 7.0, 57)
                y = problem.simulate(group, np.full(57, j), np.tile(point[: problem.size], (57, 1)), grid[:, None])
                w = problem.whitened(y - group.y[j], np.broadcast_to(group.weight[j], y.shape)).reshape(57, len(s), -1)
                height = -0.5 * (np.sum(w**2, axis=2) @ s**-2 + grid**2) - part.readings[j] @ np.log(s)
                integral = np.sum(np.exp(height - height.max())) * (grid[1] - grid[0]) / math.sqrt(2.0 * math.pi)
                assert found[k, row] == pytest.approx(height.max() + math.log(integral), abs=0.1)
                row += 1


@pytest.mark.parametrize(
    ("entries", "names"),
    [
        ({}, ["sigma1", "sigma2"]),
        ({"sigma1": CASE}, ["sigma1[I]", "sigma1[IV]", "sigma2"]),
        ({"sigma2": "sigma1"}, ["sigma1"]),
        ({"sigma1": 2.0}, ["sigma2"]),
    ],
)
def test_noise_at_every_level_has_the_density_of_a_gaussian(experiment: Experiment, entries, names) -> None:
    known = _under(experiment, theta0=0.1, **entries)
    posterior = RecordPosterior(calibrate(Problem(known, noise=WHITE, switches=RELEASE), most=3))
    problem = posterior.problem
    assert list(posterior.names[problem.size :]) == names
    point = posterior.start + 0.1 * np.arange(posterior.ndim) / posterior.ndim
    values = {name: float(x[0]) for name, x in posterior.values(point[None]).items()} | {"sigma": 2.0}
    told = posterior.log_likelihood(point[None])[0]
    order = iter(told)
    for part in posterior.parts:
        y = problem.simulate(
            part.group, np.arange(len(part.group.trials)), np.tile(point[: problem.size], (len(part.group.trials), 1)),
            np.zeros((len(part.group.trials), 0)),
        )  # fmt: skip
        for k, i in enumerate(part.group.trials):
            expected = 0.0
            for c in range(y.shape[1]):
                name = f"sigma{c + 1}"
                case = f"{name}[{experiment.trials[i].case}]"
                sigma = values.get(name, values.get(case, values["sigma1"] if "sigma2" in entries else 2.0))
                r = (part.group.y[k, c] - y[k, c]) * part.group.weight[k, c]
                expected += -0.5 * float(r @ r) / sigma**2 - float(np.sum(part.group.weight[k, c] ** 2)) * math.log(
                    sigma / NOISE
                )
            assert next(order) == pytest.approx(expected, rel=1e-9)


def test_a_declared_noise_is_a_prior_of_ten_per_cent(experiment: Experiment) -> None:
    posterior = RecordPosterior(calibrate(Problem(replace(experiment, noise_sd=(1.8,)), noise=WHITE), most=2))
    assert [s.prior for s in posterior.sigmas] == [LogNormal(1.8, 1.1)] * 2
    assert posterior.values(posterior.start[None])["sigma1"][0] == pytest.approx(NOISE)


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ({"k1t": 3.0}, "given by the columns of k1t in trials.csv"),
        ({"J1": 3.0}, "given by primary_inertia"),
        ({"theta0": "c1t"}, "cannot be tied"),
        ({"theta0": {"level": "campaign"}}, "give it a level of case"),
        ({"c3t": "c1"}, "did you mean 'c1t'"),
        ({"c1t": "c1t"}, "tied to itself"),
        ({"mu": {"median": 0.1, "factor": 2.0, "unit": "1"}}, "dist must be one of"),
        ({"mu": {"level": "cases"}}, "level must be one of"),
        ({"mu": {"dist": "normal", "sd": 1.0, "unit": "1", "cases": {"I": {"mean": 1.0}}}}, "add those of IV"),
    ],
)
def test_what_a_prior_file_cannot_mean_is_told(experiment: Experiment, entries, told) -> None:
    with pytest.raises(InputError) as error:
        _under(experiment, **entries)
    assert told in str(error.value)


def test_priors_survive_the_way_through_a_plan() -> None:
    table = {"mu": CASE, "c3t": "c1t", "nu": [10.0, 100.0], "delay": 0.0, "theta0": TRIAL}
    first = priors_from_dict(table, recorded=True)
    again = priors_from_dict(first.to_dict(), recorded=True)
    assert again.entries == first.entries
    assert first.entries["nu"].value == Uniform(10.0, 100.0)
    assert first.entries["delay"].level == "trial"


def test_angles_of_a_case_are_one_unknown_about_the_nominal_one(experiment: Experiment) -> None:
    problem = _problem(experiment, theta0=CASE)
    found = {c.name: c.prior for c in problem.coordinates if c.role == "release"}
    assert found == {"theta0[I]": Normal(0.1, 0.001), "theta0[IV]": Normal(0.08, 0.0008)}
    assert all(not group.nuisances for group in problem.groups)


@pytest.mark.slow
def test_what_differs_between_cases_is_found_where_the_file_says_so() -> None:
    """Friction twice as large in one case: its own value at level "case", a compromise at level "campaign"."""
    one = measured(7, cases=[("I", 0, 0.1)], repeats=2)
    RIG["mu"] *= 2.0
    try:
        other = measured(8, cases=[("IV", 1, 0.08)], repeats=2)
    finally:
        RIG["mu"] /= 2.0
    both = replace(one, trials=(*one.trials, *other.trials))
    fit = calibrate(_problem(both, mu=CASE))
    for name, truth in {"mu[I]": RIG["mu"], "mu[IV]": 2.0 * RIG["mu"]}.items():
        value, sd = fit.parameters[name]
        assert abs(value - truth) < 4.0 * sd
    assert calibrate(_problem(both)).chi2 > fit.chi2 + 50.0


def test_heavy_tails_are_distinguished_from_white_noise_and_from_colour():
    rng = np.random.default_rng(4)
    white, heavy = rng.standard_normal((3, 4000)), rng.standard_t(3.0, (3, 4000))
    slow = np.cumsum(rng.standard_normal((3, 4000)), axis=1) * 0.02
    assert tails_of(list(white)) < 1.05
    assert tails_of(list(white + slow)) < 1.05
    expected = float(np.mean(heavy**2)) / fast_level(list(heavy)) ** 2
    assert tails_of(list(heavy)) == pytest.approx(expected, rel=0.1)
    assert expected > 1.3
    assert tails_of([]) == 1.0


def test_a_body_at_rest_below_the_step_of_an_encoder_does_not_hide_its_noise():
    """Most of the record stands still there, and the model creeps: the readings that move show the noise."""
    step, t = 0.01, np.arange(4000) * 1e-3
    motion = np.where(t < 1.0, np.exp(-2.0 * t) * np.cos(60.0 * t), 0.0)
    reading = step * np.round(motion / step)
    residual = reading - motion + 1e-9 * np.exp(-t)
    assert fast_level([residual]) < 1e-3 * step, "the median difference is that of the model"
    assert 0.1 * step < fast_level([residual], readings=[reading]) < step
    assert tails_of([residual], readings=[reading]) < 3.0
    assert 0.1 * step < fast_level([reading]) < step


def test_the_noise_learnt_from_a_fit_is_that_of_the_encoder_while_it_moves():
    """Five seconds of swinging, then twenty in which dry friction holds the pendulum within a step."""
    step = 0.02
    swinging = swings(2, trained=1, unseen=0, duration=25.0)
    (trial,) = swinging.trials
    reading = step * np.round(trial.y / step)
    assert np.mean(np.diff(reading[0], n=4) == 0.0) > 0.5
    fit = calibrate_nominal(replace(swinging, trials=(replace(trial, y=reading),)))
    assert 0.1 * step < learn_noise(fit).floor[0] < step


def test_short_records_show_together_that_their_noise_wanders():
    """Eighty readings each: none has lines enough, all have. As white noise it would be a gap that nothing explains."""
    rng = np.random.default_rng(2)
    steady = measured(1, duration=0.08, repeats=4)
    trials = tuple(replace(t, y=t.y + autoregression(rng, t.y.shape, 0.9, 3.0 * NOISE)) for t in steady.trials)
    learnt = learn_noise(calibrate_nominal(replace(steady, trials=trials)))
    assert min(learnt.phi) > 0.6
    assert learn_noise(calibrate_nominal(steady)).phi == (0.0, 0.0)
