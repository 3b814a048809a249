"""The way from one set of assumptions to another, against closed forms; the other law against scipy."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_damper.effects._other_law import OTHER_LAW
from bayes_damper.priors.distributions import LogNormal
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling.sequential import Powers, temper
from bayes_damper.simulation.model import Model
from bayes_damper.variability.pooling import POOLINGS, CaseLikelihood, GaussianCase, GaussianHierarchy, Hierarchy
from bayes_damper.variability.published import PublishedCases, run_pooling
from bayes_damper.variability.scenarios import Bridge, ratio_of, scenarios, widened

NAMES = ("a", "b", "J")
POOLED, COMMON = NAMES[:2], ("J",)
FIXED = {"shared": np.zeros(2), "separate": np.ones(2)}


def hierarchies(pooling, widths=(1.0, 1.0), cases=3, seed=4):
    """Cases with a linear-Gaussian likelihood whose pooled coordinates count `widths` times, and the exact evidence."""
    rng = np.random.default_rng(seed)
    scale = np.array([*widths, 1.0])
    likelihoods, gaussians = [], []
    for i in range(cases):
        a = 1.5 * rng.standard_normal((4, 3))
        y = a @ np.array([0.3, -0.4, 0.2]) + rng.standard_normal(4)
        a = a * scale
        covariance = np.linalg.inv(a.T @ a + np.eye(3))
        total = np.eye(4) + a @ a.T
        log_z = -0.5 * (4 * math.log(2 * math.pi) + np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y))
        gaussians.append(GaussianCase(str(i), NAMES, covariance @ a.T @ y, covariance, log_z))

        def log_likelihood(x, a=a, y=y):
            return -0.5 * np.sum((x @ a.T - y) ** 2, axis=1) - 0.5 * len(y) * math.log(2 * math.pi)

        likelihoods.append(CaseLikelihood(str(i), NAMES, Powers(log_likelihood)))
    return Hierarchy(likelihoods, pooling, POOLED, COMMON), gaussians


def exact(gaussians, pooling, rng):
    found = GaussianHierarchy(gaussians, POOLED, COMMON)
    return found.partial(rng, 512)[0] if pooling == "partial" else found.given(FIXED[pooling]).log_z


def base(hierarchy, rng, particles=160):
    """Draws (times, particles, ndim) to begin with, and the error of their evidence, which they pass on."""
    found = temper(hierarchy, rng, particles, kept=6)
    return np.swapaxes(found.points.reshape(particles, -1, hierarchy.ndim), 0, 1), found.error


@pytest.mark.parametrize("pooling", POOLINGS)
@pytest.mark.parametrize("width", [0.5, 2.0])
def test_evidence_changes_with_the_width_of_the_priors_as_the_closed_form_says(pooling, width):
    rng = np.random.default_rng(2)
    before, old = hierarchies(pooling)
    after, new = hierarchies(pooling, (width, 1.0))
    bridge = Bridge(before, after, ratio=np.array([width, 1.0]))
    draws, error = base(before, rng)
    found = temper(bridge, rng, 160, settle=False, start=bridge.start(draws))
    gain = exact(new, pooling, rng) - exact(old, pooling, rng)
    assert found.log_z == pytest.approx(gain, abs=0.1 + 4.0 * math.hypot(found.error, error))
    if pooling != "partial":
        given = GaussianHierarchy(new, POOLED, COMMON).given(FIXED[pooling])
        for i in range(3):
            assert after.values(found.points, i).mean(axis=0) == pytest.approx(given.mean[i], abs=0.2)


@pytest.mark.parametrize("pooling", POOLINGS)
def test_evidence_without_a_case_is_that_of_the_others(pooling):
    rng = np.random.default_rng(3)
    before, gaussians = hierarchies(pooling)
    bridge = Bridge(before, before, without=1)
    draws, error = base(before, rng)
    found = temper(bridge, rng, 160, settle=False, start=bridge.start(draws))
    gain = exact([gaussians[0], gaussians[2]], pooling, rng) - exact(gaussians, pooling, rng)
    assert found.log_z == pytest.approx(gain, abs=0.1 + 4.0 * math.hypot(found.error, error))


@pytest.mark.parametrize("pooling", POOLINGS)
def test_another_likelihood_is_reached(pooling):
    rng = np.random.default_rng(5)
    (before, old), (after, new) = hierarchies(pooling), hierarchies(pooling, seed=6)
    bridge = Bridge(before, after)
    draws, error = base(before, rng)
    found = temper(bridge, rng, 160, settle=False, start=bridge.start(draws))
    gain = exact(new, pooling, rng) - exact(old, pooling, rng)
    assert found.log_z == pytest.approx(gain, abs=0.1 + 4.0 * math.hypot(found.error, error))


def test_only_a_range_of_another_length_is_drawn_anew():
    cases = PublishedCases(PublishedCases.default_plan())
    assert {s.kind for s in scenarios(cases.names) if cases.anew(s)} == {"width"}
    fixed = cases.plan | {"priors": cases.plan["priors"] | {"nu": {"dist": "fixed", "value": 50.0, "unit": "s/rad"}}}
    assert not any(PublishedCases(fixed).anew(s) for s in scenarios(cases.names))


def test_start_keeps_the_values_of_the_cases():
    for pooling in POOLINGS:
        before, _ = hierarchies(pooling)
        points = np.random.default_rng(1).standard_normal((5, before.ndim))
        started = Bridge(before, before, ratio=np.array([2.0, 1.0])).start(points)
        for case in range(3):
            ratio = before.values(points, case) / before.values(started, case)
            assert ratio == pytest.approx(np.tile([2.0, 1.0], (5, 1)))


def test_widened_priors_have_the_log_factors_that_were_asked_for():
    nu = {"dist": "loguniform", "lower": 10.0, "upper": 1000.0}
    priors = {"name": "x", "mu": {"dist": "lognormal", "factor": 4.0}, "nu": nu}
    wide, narrow = (widened(priors, ("mu", "nu"), width) for width in (2.0, 0.5))
    assert wide["mu"]["factor"] == pytest.approx(16.0)
    assert (wide["nu"]["lower"], wide["nu"]["upper"]) == pytest.approx((1.0, 10_000.0))
    assert (narrow["nu"]["lower"], narrow["nu"]["upper"]) == pytest.approx((10.0**1.5, 10.0**2.5))
    assert priors["mu"]["factor"] == 4.0
    assert priors["nu"]["lower"] == 10.0
    before, after = {"mu": LogNormal(1.0, 4.0), "nu": None}, {"mu": LogNormal(1.0, 16.0), "nu": None}
    assert ratio_of(before, after, ("mu", "nu")) == pytest.approx([2.0, 1.0])


def test_each_case_is_left_out_once():
    tried = scenarios(("I", "II"))
    assert [s.case for s in tried if s.kind == "without"] == ["I", "II"]
    assert {s.kind for s in tried} == {"width", "law", "without"}


@pytest.mark.slow
def test_a_task_that_was_stopped_goes_on_to_the_same_result(tmp_path, monkeypatch):
    """Inside a task, from the stage it had reached: what was measured before is not measured again."""
    plan = {"fit": PublishedCases.default_plan(), "seed": 1, "particles": 32}
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for folder in (whole, stopped):
        folder.mkdir()
    monkeypatch.setattr(Checkpoint, "due", lambda _: True)
    expected = run_pooling(whole, lambda *_: None, settings=plan, pooling="shared", repeat=0)
    stages = []

    def stops(share, text):
        stages.append((share, text))
        if len(stages) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_pooling(stopped, stops, settings=plan, pooling="shared", repeat=0)
    assert (stopped / "state").is_dir()
    left = []
    found = run_pooling(stopped, lambda *x: left.append(x), settings=plan, pooling="shared", repeat=0)
    assert found == expected
    assert len(left) == expected["stages"] - 2
    points = [np.load(folder / "points.npz")["points"] for folder in (whole, stopped)]
    np.testing.assert_array_equal(*points)
    assert not (stopped / "state").exists()


@pytest.mark.parametrize("coupled", [False, True])
def test_the_other_law_takes_the_place_of_tanh(coupled):
    """Against scipy with x / sqrt(1 + x^2) written into the equations of motion."""
    p = SimpleNamespace(J1=3e-3, J2=2.5e-3, k1t=9.8, c1t=0.006, c3t=0.006, k2t=1.4, c2t=0.02, mu=0.01, N0=100.0, R=0.1,
                        r=0.0127, drag=0.03, nu=20.0, theta0=0.082)  # fmt: skip

    def law(x):
        return x / math.sqrt(1.0 + x * x)

    def rate(_, y):
        th1, th2, w1, w2 = y
        t = 0.0
        if coupled:
            pull = p.N0 * max(0.0, 1.0 - p.R * abs(th1 - th2) / (2.0 * p.r))
            t = p.k2t * (th1 - th2) + p.c2t * (w1 - w2) + p.mu * pull * p.R * law(p.nu * (w1 - w2))
        a1 = -(p.c1t * w1 + p.k1t * th1 + p.drag * law(p.nu * w1) + t) / p.J1
        a2 = -(p.c3t * w2 + p.drag * law(p.nu * w2) - t) / p.J2 if coupled else 0.0
        return [w1, w2, a1, a2]

    times = np.arange(1, 300) * 1e-3
    exact = solve_ivp(rate, (0.0, 0.3), [p.theta0, p.theta0 if coupled else 0.0, 0.0, 0.0], t_eval=times, rtol=1e-10,
                      atol=1e-12)  # fmt: skip
    a1 = np.array([rate(0.0, y)[2] for y in exact.y.T])
    only = ("J1", "k1t", "c1t", "drag", "nu", "theta0")
    values = {n: np.array([x]) for n, x in vars(p).items() if coupled or n in only}
    model = Model(coupled, "linear", effect=OTHER_LAW)
    found = model.simulate(values, times, effect={}).y[0, 0]
    assert np.abs(found - a1).max() < 2e-4 * np.abs(a1).max()
    plain = Model(coupled, "linear").simulate(values, times).y[0, 0]
    assert np.abs(plain - a1).max() > 2e-3 * np.abs(a1).max()
