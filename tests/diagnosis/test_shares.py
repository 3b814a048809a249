"""Shares of the gap without a floor of noise: exact without noise, covered with it, silent where no gap shows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_rig import measured, variant

from bayes_damper.calibration import Problem, calibrate_nominal, predict
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.diagnosis.search import Screen, fit_variant, screen_variant
from bayes_damper.diagnosis.shares import Products, _taken_up, moved_by_noise, products, products_of, shortest_interval
from bayes_damper.effects import EFFECTS


@pytest.fixture(scope="module")
def problem():
    return Problem(measured(1))


def sides(problem, gaps, noise, rng):
    """Residuals of models that leave gaps (share of the first one's amplitude), all under the same noise."""
    e = problem.experiment
    drawn = {i: noise * rng.standard_normal(t.y.shape) for i, t in enumerate(e.trials)}
    shapes = {i: np.sin(60.0 * t.times) * np.exp(-4.0 * t.times) for i, t in enumerate(e.trials)}
    every = [{i: drawn[i] + g * shapes[i] for i in drawn} for g in gaps]
    return [({i: r[i] for i in problem.trials}, {i: r[i] for i in e.heldout}) for r in every]


def test_without_noise_the_share_is_exact(problem):
    found = products(
        SimpleNamespace(problem=problem),
        problem.experiment.heldout,
        sides(problem, (2.0, 1.0), 0.0, np.random.default_rng(0)),
    )
    closed = found.closed(1)
    assert found.method == "repeats"
    assert closed.median == pytest.approx(0.75)
    assert closed.hdi90 == pytest.approx((0.75, 0.75))


def test_a_faint_gap_is_shared_out_evenly_and_covered(problem):
    """A fifth of the noise's size; 30 % are closed. Sums of squares would be lost in the noise of their floor."""
    fit, rng = SimpleNamespace(problem=problem), np.random.default_rng(1)
    left = np.sqrt(0.7)
    sd = problem.noise.total[0]
    told = [
        products(fit, problem.experiment.heldout, sides(problem, (1.2 * sd, 1.2 * sd * left), sd, rng)).closed(1)
        for _ in range(120)
    ]
    values = [c.median for c in told if c.median is not None]
    assert len(values) > 110
    assert np.mean(values) == pytest.approx(0.3, abs=0.02)
    covered = np.mean([c.hdi90[0] <= 0.3 <= c.hdi90[1] for c in told if c.hdi90])
    assert 0.78 < covered < 0.98


def test_where_no_gap_shows_no_share_is_told(problem):
    fit, rng = SimpleNamespace(problem=problem), np.random.default_rng(2)
    told = [
        products(fit, problem.experiment.heldout, sides(problem, (0.0, 0.0), 2.0, rng)).closed(1) for _ in range(60)
    ]
    silent = [c for c in told if c.median is None]
    assert len(silent) > 50
    assert "too faint" in silent[0].to_json()["how"]


def test_without_repeats_neighbouring_readings_take_the_place_of_repeats():
    cases = (("a", 0, 0.1), ("b", 0, 0.08), ("c", 0, 0.09))
    lone = Problem(measured(1, repeats=1, cases=cases, configurations=(False,)))
    heldout, rng = (0, 1, 2), np.random.default_rng(3)
    models = []
    for size in (2.0, 1.0):
        r = {i: size * np.sin(20.0 * lone.experiment.trials[i].times) for i in heldout}
        models.append(({}, {i: (x + rng.standard_normal(x.size))[None] for i, x in r.items()}))
    found = products(SimpleNamespace(problem=lone), heldout, models)
    assert found.method == "neighbours"
    assert found.closed(1).median == pytest.approx(0.75, abs=0.05)


@pytest.mark.slow
def test_what_a_wrong_effect_closes_of_a_faint_gap_is_what_it_closes():
    """A cubic spring that the noise exceeds by half: a wrong stiffness closes about 72 % of it, and is told so."""
    cubic = variant("spring_cubic")
    kept = {"effect": cubic, "values": {"k3": 5.0}, "duration": 0.8}
    for seed in (1, 2):
        experiment, clean = measured(seed, **kept), measured(seed, noise=0.0, **kept)
        # A spring of its own in each trial would take most of a gap as faint as this: nothing scatters here.
        nominal = calibrate_nominal(replace(experiment, scatter=dict.fromkeys(TYPICAL, 0.0)))
        screen, wrong = Screen(nominal), variant("stiffness_error", "factor")
        fits = [
            fit_variant(nominal, EFFECTS[name], v, screen_variant(screen, v), 2).fit
            for name, v in (("stiffness_error", wrong), ("spring_cubic", cubic))
        ]
        left = [
            sum(float(np.sum((clean.trials[i].y - p.model) ** 2)) for i, p in predict(fit, experiment.heldout).items())
            for fit in (nominal, *fits)
        ]
        found = products_of([nominal, *fits], experiment.heldout)
        for k in (1, 2):
            true, told = 1.0 - left[k] / left[0], found.closed(k)
            assert told.hdi90[0] < true < told.hdi90[1]
            assert told.median == pytest.approx(true, abs=0.1)


def test_shortest_interval_of_a_skewed_sample():
    draws = np.sort(np.concatenate([np.linspace(0.0, 1.0, 91), np.full(9, 50.0)]))
    assert shortest_interval(draws) == pytest.approx((0.0, 0.989), abs=0.02)


def test_what_follows_noise_of_an_input_lacks_no_product_of_neighbours():
    """Draws of noise with the likeliest input error taken out: products below 0 on average, and as much as is added."""
    rng = np.random.default_rng(3)
    n, sd = 300, 0.02
    t = np.arange(n) * 0.02
    shapes = np.array(
        [a * np.array([np.cos(w * t), 0.5 * np.sin(w * t)]) for a, w in ((0.004, 5.0), (0.02, 5.3), (0.002, 9.0))]
    )
    group = SimpleNamespace(
        nuisances=[("offset1", 0, 0), *((f"input{k}", 0, 0) for k in (1, 2, 3))], times=t, y=np.zeros((1, 2, n)),
        weight=rng.uniform(0.5, 1.0, (1, 2, n)), shape=lambda name: shapes[int(name[-1]) - 1],
    )  # fmt: skip
    added = _taken_up(group, 0, np.array([sd, 2.0 * sd]))
    U = (shapes * group.weight[0] / np.array([[sd], [2.0 * sd]])).reshape(3, -1).T
    drawn = rng.standard_normal((6_000, 2 * n)) + rng.standard_normal((6_000, 3)) @ U.T
    left = drawn - drawn @ U @ np.linalg.solve(np.eye(3) + U.T @ U, U.T)
    left = left.reshape(-1, 2, n)
    lacking = -np.sum(left[:, :, :-1] * left[:, :, 1:], axis=(1, 2))
    error = lacking.std() / np.sqrt(lacking.size)
    assert lacking.mean() > 5.0 * error
    assert added.sum() == pytest.approx(lacking.mean(), abs=4.0 * error)


def test_noise_at_frequencies_without_a_gap_does_not_hide_its_share(problem, monkeypatch):
    fit, rng = SimpleNamespace(problem=problem), np.random.default_rng(5)
    sd = problem.noise.total[0]
    drawn = [sides(problem, (0.4 * sd, 0.4 * sd * np.sqrt(0.7)), sd, rng) for _ in range(100)]

    def told():
        every = [products(fit, problem.experiment.heldout, each).closed(1) for each in drawn]
        return [c for c in every if c.median is not None and c.hdi90 is not None]

    slow = told()
    monkeypatch.setattr("bayes_damper.diagnosis.shares.LOW_BAND", 1e9)
    assert len(slow) > 1.3 * len(told())
    assert np.mean([c.median for c in slow]) == pytest.approx(0.3, abs=0.05)
    assert 0.8 < np.mean([c.hdi90[0] < 0.3 < c.hdi90[1] for c in slow]) < 0.98


def test_what_noise_of_the_fitted_trials_moves_is_a_miss_too():
    """Predictions under draws of the parameters, the trials' own values fitted anew, against the one they are about."""
    fit = calibrate_nominal(measured(1, configurations=(False,), duration=0.3))
    heldout, rng = fit.problem.experiment.heldout, np.random.default_rng(7)
    about = predict(fit, heldout)
    sd = fit.problem.noise.floor[0]
    drawn = rng.multivariate_normal(fit.q, fit.covariance, 40)
    missed = [
        sum(float(np.sum((p.model - about[i].model) ** 2)) for i, p in predict(replace(fit, q=q), heldout).items())
        for q in drawn
    ]
    expected = moved_by_noise(fit, {i: p.eta for i, p in about.items()})
    assert np.mean(missed) / sd**2 == pytest.approx(expected, rel=0.4)
    values = np.array([[30.0], [10.0]])
    found = Products(values, np.tile(values.T, (8, 1)), "repeats", products_of([fit, fit], heldout).moved)
    assert found.closed(1).median == pytest.approx(20.0 / (30.0 + expected))


@pytest.mark.parametrize("method", ["repeats", "neighbours"])
def test_a_gap_in_two_readings_at_the_release_is_counted(method):
    sharp = Problem(measured(1, repeats=3 if method == "repeats" else 1))
    e, rng = sharp.experiment, np.random.default_rng(6)
    heldout = e.heldout or range(len(e.trials))
    knock = np.array([60.0, -60.0 if method == "repeats" else 60.0])
    noise = {i: sharp.noise.total[0] * rng.standard_normal(t.y.shape) for i, t in enumerate(e.trials)}

    def left(share):
        out = {i: r.copy() for i, r in noise.items()}
        for r in out.values():
            r[:, :2] += share * sharp.noise.total[0] * knock
        return {i: r for i, r in out.items() if i not in heldout}, {i: out[i] for i in heldout}

    found = products(SimpleNamespace(problem=sharp), heldout, [left(1.0), left(0.5)])
    assert found.method == method
    assert found.closed(1).median == pytest.approx(0.75, abs=0.05)
