"""Calibration by least squares: right values, right covariance, right evidence, on records made by the model itself."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from small_rig import measured

from bayes_damper.calibration import (
    Experiment,
    Noise,
    Problem,
    TrialRecord,
    calibrate,
    calibrate_nominal,
    coordinate_of,
    error_level,
    grown,
    learn_noise,
    longest_step,
    predict,
    thinned,
)
from bayes_damper.calibration.experiment import unrounded
from bayes_damper.calibration.groups import Switches
from bayes_damper.calibration.least_squares import drawn_starts
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.campaign.records import crossings
from bayes_damper.diagnosis.remainder import remainder_of
from bayes_damper.effects import EFFECTS
from bayes_damper.priors.distributions import HalfNormal, LogNormal, LogUniform, Normal, Uniform, from_standard
from bayes_damper.simulation.model import Model

RIG = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0}
TRUE = {"mu": 0.006, "k2t": 1.4, "c2t": 0.07, "drag": 0.005, "nu": 40.0, "c1t": 0.011, "c3t": 0.009}
CASES = (("I", 6.2, 5.7), ("IV", 10.2, 4.7))


def make_experiment(
    seed: int, *, noise: float = 2.0, repeats: int = 3, coupled: bool = True, k1t_sd: float = 0.0, n: int = 400,
    late: bool = False, colour: bool = False, **changes: object,
) -> Experiment:  # fmt: skip
    """Two cases, each uncoupled and coupled, the last repeat held out."""
    rng = np.random.default_rng(seed)
    times = np.arange(n) * 1e-3
    trials = []
    for index, (case, k1t, degrees) in enumerate(CASES):
        for both in (False, True) if coupled else (False,):
            for number in range(1, repeats + 1):
                theta0 = math.radians(degrees)
                own = theta0 * (1.0 + 0.01 * rng.standard_normal())
                delay = -float(rng.uniform(0.0, 1e-3)) if late else 0.0
                y = Model(both).simulate(RIG | TRUE | {"k1t": k1t, "theta0": own, "delay": delay}, times).y[0]
                e = rng.standard_normal(y.shape)
                if colour:
                    for i in range(1, n):
                        e[:, i] = 0.6 * e[:, i - 1] + 0.8 * e[:, i]
                trials.append(
                    TrialRecord(
                        f"{case}{number}",
                        case,
                        both,
                        number,
                        times,
                        y + noise * e,
                        index,
                        theta0,
                        0.01 * theta0,
                        heldout=number == repeats,
                    )
                )
    return Experiment(
        {name: (value, 0.0) for name, value in RIG.items()}, tuple((k, k1t_sd * k) for _, k, _ in CASES),
        tuple(trials), **changes,  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.fixture(scope="module")
def fitted():
    return calibrate_nominal(make_experiment(3))


@pytest.mark.parametrize(
    "prior", [Normal(2.0, 0.5), LogNormal(0.01, 2.7), HalfNormal(3.0), Uniform(-1.0, 2.0), LogUniform(0.1, 10.0),
              Normal(0.0, 1.0, lower=0.0)], ids=lambda p: type(p).__name__,
)  # fmt: skip
def test_a_coordinate_has_a_standard_gaussian_prior(prior):
    """The value at z is the quantile of Phi(z), and the way back agrees."""
    from scipy.special import ndtr

    z = np.linspace(-3.0, 3.0, 13)
    assert np.allclose(from_standard(prior, z), prior.ppf(ndtr(z)), rtol=1e-9)
    for each in z:
        assert coordinate_of(prior, float(from_standard(prior, each))) == pytest.approx(each, abs=1e-6)


LAWS = {
    "tanh": np.tanh,
    "algebraic": lambda x: x / np.sqrt(1.0 + x * x),
    "arctangent": lambda x: 2.0 / np.pi * np.arctan(0.5 * np.pi * x),
}


@pytest.mark.parametrize("law", ["tanh", pytest.param("algebraic", marks=pytest.mark.slow), "arctangent"])
def test_drag_and_damping_hold_whichever_curve_dry_friction_follows(law):
    """One body by scipy, noise 1/2000 of the peak; of the sharp friction mostly the slow end of its curve is seen."""
    sign, times = LAWS[law], np.arange(600) * 2e-3
    true = {"c1t": 0.004, "drag": 0.02}
    rng = np.random.default_rng(8)
    trials = []
    for number in range(1, 5):

        def rate(_, x):
            pull = 6.2 * x[0] + true["c1t"] * x[1] + true["drag"] * sign(30.0 * x[1])
            return x[1], -pull / RIG["J1"]

        swing = solve_ivp(rate, (0.0, times[-1]), (0.1, 0.0), "DOP853", times, rtol=1e-10, atol=1e-12, max_step=1e-3)
        y = np.array([rate(0.0, x)[1] for x in swing.y.T])[None]
        y = y + 0.1 * rng.standard_normal(y.shape)
        trials.append(TrialRecord(f"{number}.csv", "I", False, number, times, y, 0, 0.1, 1e-4))
    experiment = Experiment({"J1": (RIG["J1"], 0.0)}, ((6.2, 0.0),), tuple(trials))
    fit = calibrate_nominal(experiment)
    off = {name: (fit.parameters[name][0] - value) / fit.parameters[name][1] for name, value in true.items()}
    assert max(abs(z) for z in off.values()) < 3.5, off
    assert all(fit.parameters[name][1] < 0.03 * value for name, value in true.items())
    if law != "tanh":
        sharp = calibrate_nominal(replace(experiment, priors={"tail": 0.0}))
        assert max(abs(sharp.parameters[n][0] - value) / sharp.parameters[n][1] for n, value in true.items()) > 6.0
        assert fit.log_evidence > sharp.log_evidence + 20.0


def test_a_half_normal_reaches_far_into_its_tail():
    """Ten standard deviations are as far as the formula says, with no loss of digits."""
    assert float(from_standard(HalfNormal(2.0), 10.0)) == pytest.approx(20.0, rel=0.02)


@pytest.mark.slow
def test_parameters_are_recovered_within_their_covariance(fitted):
    """Over several campaigns the deviations from the truth have unit variance in units of the stated sd."""
    z = []
    for fit in (fitted, *(calibrate_nominal(make_experiment(seed)) for seed in (0, 1, 2))):
        assert fit.converged
        z += [(fit.parameters[name][0] - TRUE[name]) / fit.parameters[name][1] for name in TRUE]
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.max(np.abs(z)) < 4.5


def test_late_triggers_and_uncertain_constants_are_part_of_the_fit():
    """Triggers late by up to a sample are found by themselves, and the fit leaves noise only."""
    fit = calibrate_nominal(make_experiment(8, late=True, k1t_sd=0.01))
    assert fit.problem.switches.delay
    assert abs(fit.excess) < 4.0 * math.sqrt(2.0 * fit.problem.n_data)
    assert "k1t[6.2]" in fit.parameters


def test_slopes_at_the_end_of_a_range_look_inward():
    """A trigger at the last instant that its record allows: one step later the first reading would lie before it."""
    fit = calibrate_nominal(make_experiment(8, late=True))
    lengths = []
    for inward in (0.0, 0.01):
        eta = {}
        for group in fit.problem.groups:
            i = [name for name, _, _ in group.nuisances].index("delay")
            for k, trial in enumerate(group.trials):
                eta[trial] = fit.eta[trial].copy()
                eta[trial][i] = group.upper[k, i] - inward
        blocks = fit.problem.linearise(fit.q, eta, central=True).blocks
        lengths.append(np.concatenate([np.sum(b.T[:, 1] ** 2, axis=1) for b in blocks]))
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=0.3)


@pytest.mark.parametrize(
    ("quantity", "noise"), [pytest.param("displacement", 2e-5, marks=pytest.mark.slow), ("velocity", 5e-3)]
)
def test_a_motion_may_be_released_on_either_side_of_the_first_reading(quantity, noise):
    """Where readings start without a jump the logger may have run before the release, and that is no gap."""
    fit = calibrate_nominal(with_release(quantity, noise, repeats=3))
    assert fit.problem.switches.delay
    assert abs(fit.excess) < 4.0 * math.sqrt(2.0 * fit.problem.n_data)


def test_a_secondary_that_its_own_spring_moves_while_the_primary_is_held_is_not_early():
    """Releases that take 0.4 ms: the first reading shows the primary at rest, and the secondary under way."""
    rng = np.random.default_rng(3)
    ramp, times, trials = EFFECTS["release_ramp"].variants[0], np.arange(400) * 1e-3, []
    for index, (case, k1t, degrees) in enumerate(CASES):
        for number in (1, 2, 3):
            theta0 = math.radians(degrees)
            rig = RIG | TRUE | {"k1t": k1t, "k3t": 3.0, "theta0": theta0}
            y = Model(True, effect=ramp).simulate(rig, times, effect={"time": 4e-4}).y[0]
            y = y + 2.0 * rng.standard_normal(y.shape)
            trials.append(TrialRecord(f"{case}{number}", case, True, number, times, y, index, theta0, 0.01 * theta0))
    assert min(abs(t.y[1, 0]) for t in trials) > 5.0 * max(abs(t.y[0, 0]) for t in trials)
    stiffnesses = tuple((k, 0.0) for _, k, _ in CASES)
    constants = {name: (RIG[name], 0.0) for name in ("J1", "J2", "R", "r", "N0")} | {"k3t": (3.0, 0.0)}
    fit = calibrate_nominal(Experiment(constants, stiffnesses, tuple(trials)))
    assert fit.chi2 < 1.1 * fit.problem.n_data
    for group in fit.problem.groups:
        assert not group.weight[:, 1, 0].any()
        assert group.weight[:, 1, 1:].all()
        assert group.weight[:, 0, 1:].all()


def test_a_reading_at_the_instant_of_the_release_may_show_the_rig_held():
    """All trials are let go just after the reading at 0, sooner than they could show: no instant is late."""
    found = make_experiment(5, noise=1.0)
    rng = np.random.default_rng(5)
    trials = []
    for t in found.trials:
        rig = RIG | TRUE | {"k1t": CASES[t.k1t][1], "theta0": t.theta0 * (1.0 + 0.01 * rng.standard_normal())}
        y = Model(t.coupled).simulate(rig | {"delay": 1e-8}, t.times).y[0]
        trials.append(replace(t, y=y + rng.standard_normal(y.shape)))
    assert max(abs(t.y[0, 0]) for t in trials) < 5.0
    noise = Noise((1.0, 1.0), (0.0, 0.0), (0.0, 0.0))
    fixed = Problem(replace(found, trials=tuple(trials)), noise=noise, switches=Switches(delay=False, friction=False))
    fit = calibrate(fixed)
    assert fit.chi2 < 1.1 * fit.problem.n_data
    assert not any(g.weight[:, :, 0].any() for g in fit.problem.groups)


def test_lone_trials_keep_their_own_release():
    """One training trial of a kind cannot tell whether releases vary, so each keeps its own."""
    fit = calibrate_nominal(with_release("velocity", 5e-3, repeats=2))
    assert fit.problem.switches.delay
    assert max(fit.problem.noise.total) < 2.0 * 5e-3


def test_two_repeats_that_agree_do_not_tell_that_releases_never_vary():
    """Two triggers are as late as each other by chance; with six pairs of trials they are not."""
    for cases, free in ((1, True), (6, False)):
        drawn = make_experiment(9, coupled=False)
        alike = [replace(t, case=f"{t.case}{k}", label=f"{t.label}.{k}") for k in range(3) for t in drawn.trials]
        few = [t for t in alike if t.case in sorted({t.case for t in alike})[:cases]]
        fit = calibrate_nominal(replace(drawn, trials=tuple(few)))
        assert fit.problem.switches.delay is free


@pytest.mark.parametrize("scatter", [0.0, 0.05])
def test_drag_that_differs_between_repeats_is_each_trials_own(scatter):
    """Quiet sensors see the bearings drag differently from trial to trial; that is no gap, and one drag for all is."""
    drawn = make_experiment(7, coupled=False)
    rng = np.random.default_rng(1)
    trials = []
    drags = 1.0 + scatter * (-1.0) ** np.arange(len(drawn.trials))
    for t, factor in zip(drawn.trials, drags, strict=True):
        own = {"k1t": CASES[t.k1t][1], "theta0": t.theta0, "drag": TRUE["drag"] * factor}
        y = Model(coupled=False).simulate(RIG | TRUE | own, t.times).y[0]
        trials.append(replace(t, y=y + 0.3 * rng.standard_normal(y.shape)))
    fit = calibrate_nominal(replace(drawn, trials=tuple(trials)))
    (size,) = (s for s in fit.problem.switches.scatter.sizes if s.name == "drag")
    assert (size.gained > 3.0) is (scatter > 0.0)
    assert size.low < scatter < size.high or not scatter
    assert abs(fit.excess) < 4.0 * math.sqrt(2.0 * fit.problem.n_data)
    assert max(fit.problem.noise.total) < 0.33
    if scatter:
        names = [n for n, _, _ in fit.problem.groups[0].nuisances]
        found = np.array([fit.eta[i][names.index("ln_drag")] for i in fit.problem.trials]) * size.sd
        assert np.corrcoef(found, np.log(drags[list(fit.problem.trials)]))[0, 1] > 0.9


def test_releases_pressed_against_their_range_stay_free():
    """A harder spring shifts all periods, so that releases of a wrong model end at one bound and look alike."""
    drawn = make_experiment(6, late=True, coupled=False)
    times = drawn.trials[0].times
    bent = EFFECTS["spring_cubic"].variant("same_for_all")
    trials = []
    for k, t in enumerate(drawn.trials):
        own = {"k1t": CASES[t.k1t][1], "theta0": t.theta0, "delay": -1e-4 * (1 + k)}
        y = Model(coupled=False, effect=bent).simulate(RIG | TRUE | own, times, effect={"k3": 30.0}).y[0]
        trials.append(replace(t, y=y + 2.0 * np.random.default_rng(k).standard_normal(y.shape)))
    assert calibrate_nominal(replace(drawn, trials=tuple(trials))).problem.switches.delay


def with_release(quantity, noise, repeats):
    """Motions at 400 Hz, released up to a sample before or after the first reading."""
    rng = np.random.default_rng(5)
    drawn = make_experiment(5, repeats=repeats, n=200, noise=0.0)
    times = np.arange(200) / 400.0
    trials = []
    for t in drawn.trials:
        own = {"k1t": CASES[t.k1t][1], "theta0": t.theta0, "delay": float(rng.uniform(-2.5e-3, 2.5e-3))}
        y = Model(t.coupled).simulate(RIG | TRUE | own, times, quantity=quantity).y[0]
        trials.append(replace(t, times=times, y=y + noise * rng.standard_normal(y.shape)))
    return replace(drawn, trials=tuple(trials), quantity=quantity)


@pytest.mark.slow
def test_a_factor_on_all_torques_and_inertias_stays_as_unknown_as_it_was_declared():
    """It changes no motion, over however many periods, so what is known of it is the declarations taken together."""
    rng = np.random.default_rng(5)
    declared = {"J1": 1.2e-5, "J2": 0.8e-5}
    true = {"c1t": 6e-5, "c2t": 8e-5, "c3t": 4e-5, "drag": 2e-4, "mu": 0.015, "nu": 40.0, "k2t": 0.25}
    rig = declared | true | {"N0": 5.0, "R": 0.02, "r": 0.006, "k1t": 1.433, "theta0": 0.07}
    times = np.arange(2500) * 2e-4
    noise = 0.05
    trials = []
    for number in range(1, 5):
        y = Model(True, normal_force="constant").simulate(rig, times, quantity="velocity").y[0]
        y = y + noise * rng.standard_normal(y.shape)
        trials.append(TrialRecord(f"{number}", "only", True, number, times, y, 0, 0.07, 0.0, heldout=number == 4))
    experiment = Experiment(
        {name: (value, 0.01 * value) for name, value in declared.items()}
        | {name: (rig[name], 0.0) for name in ("N0", "R", "r")},
        ((1.433, 0.01 * 1.433),), tuple(trials), quantity="velocity", normal_force="constant",
    )  # fmt: skip
    fit = calibrate_nominal(experiment)
    sds = [0.01] * 3
    sds += [math.log(c.prior.factor) for c in fit.problem.coordinates if c.name in true and c.name != "nu"]
    assert len(sds) == 9
    together = sum(sd**-2.0 for sd in sds) ** -0.5
    for name in ("J1", "J2", "k1t"):
        value, sd = fit.parameters[name]
        assert sd / value == pytest.approx(together, rel=0.1)
        assert abs(value / rig[name] - 1.0) < 4.0 * together
    expected = float(fit.problem.n_data)
    assert fit.cost == pytest.approx(expected, abs=6.0 * math.sqrt(2.0 * expected))


def test_elimination_equals_the_joint_problem(fitted):
    """Step, covariance and evidence by Schur complements are those of the big dense problem."""
    problem = fitted.problem
    q = fitted.q + 0.05
    linear = problem.linearise(q, fitted.eta)
    normals = linear.normal()
    J = np.concatenate([row for b in linear.blocks for row in b.J.transpose(0, 2, 1)])
    T = block_diag(*[row.T for b in linear.blocks for row in b.T])
    r = np.concatenate([row for b in linear.blocks for row in b.r])
    eta = np.concatenate([row for b in linear.blocks for row in b.eta])
    A = np.hstack([J, T])
    full = A.T @ A + np.eye(A.shape[1])
    gradient = A.T @ r + np.concatenate([q, eta])
    step = -np.linalg.solve(full, gradient)
    (dq,), deta = normals.steps([0.0])
    order = [i for b in linear.blocks for i in b.group.trials]
    assert np.allclose(dq, step[: problem.size], rtol=1e-5, atol=1e-8)
    assert np.allclose(np.concatenate([deta[i][0] for i in order]), step[problem.size :], rtol=1e-5, atol=1e-8)
    cost = r @ r + q @ q + eta @ eta
    assert normals.log_evidence() == pytest.approx(-0.5 * cost - 0.5 * np.linalg.slogdet(full)[1], rel=1e-9)


def test_evidence_of_a_linear_gaussian_problem_is_exact(fitted):
    """At the minimum of the linearised problem the Laplace evidence is the exact Gaussian integral."""
    linear = fitted.linear
    normals = linear.normal()
    (dq,), deta = normals.steps([0.0])
    J = np.concatenate([row for b in linear.blocks for row in b.J.transpose(0, 2, 1)])
    T = block_diag(*[row.T for b in linear.blocks for row in b.T])
    A = np.hstack([J, T])
    order = [i for b in linear.blocks for i in b.group.trials]
    x = np.concatenate([fitted.q + dq, *[fitted.eta[i] + deta[i][0] for i in order]])
    r = np.concatenate([row for b in linear.blocks for row in b.r])
    x0 = np.concatenate([fitted.q, *[fitted.eta[i] for i in order]])
    y = A @ x0 - r  # r = A x - y
    # Marginal density of y: N(0, 1 + A A'), by the determinant lemma, without its constant.
    precision = np.eye(A.shape[1]) + A.T @ A
    exact = -0.5 * (y @ y - (A.T @ y) @ np.linalg.solve(precision, A.T @ y)) - 0.5 * np.linalg.slogdet(precision)[1]
    residual = A @ x - y
    laplace = -0.5 * (residual @ residual + x @ x) - 0.5 * np.linalg.slogdet(precision)[1]
    assert laplace == pytest.approx(exact, abs=1e-4)
    assert normals.log_evidence() == pytest.approx(exact, abs=0.5)


@pytest.mark.parametrize("clock", [pytest.param("jittered", marks=pytest.mark.slow), "slowing"])
def test_slow_noise_is_learnt_where_the_clock_is_not_even(clock):
    """White noise and as much of an Ornstein-Uhlenbeck process that forgets within 15 ms, exact on each clock."""
    rng = np.random.default_rng(4)
    n, tau = 600, 15e-3
    trials = []
    for number in range(1, 5):
        times = np.arange(n) * 2e-3
        if clock == "jittered":
            times[1:] += 2e-3 * rng.uniform(-0.3, 0.3, n - 1)
        else:
            times = times[-1] * (2.0 * times + times**2 / times[-1]) / (3.0 * times[-1])
        y = Model(False).simulate(RIG | TRUE | {"k1t": 6.2, "theta0": 0.1}, times).y[0]
        slow = rng.standard_normal(n)
        for i, keep in enumerate(np.exp(-np.diff(times) / tau), start=1):
            slow[i] = keep * slow[i - 1] + math.sqrt(1.0 - keep**2) * slow[i]
        y = y + 2.0 * math.sqrt(0.5) * (slow + rng.standard_normal(n))
        trials.append(TrialRecord(f"{number}.csv", "I", False, number, times, y, 0, 0.1, 1e-4))
    fit = calibrate_nominal(Experiment({"J1": (RIG["J1"], 0.0)}, ((6.2, 0.0),), tuple(trials)))
    noise = fit.problem.noise
    assert noise.coloured(0)
    assert noise.total[0] == pytest.approx(2.0, rel=0.1)
    innovations = np.array([noise.whiten(0, r[0]) for r in fit.residuals().values()])
    for lag in (1, 2, 5, 10):
        together = np.mean(innovations[:, lag:] * innovations[:, :-lag])
        assert abs(together) < 4.0 / math.sqrt(4 * n), lag
    assert innovations.var() == pytest.approx(1.0, abs=0.1)


def test_whitening_makes_coloured_noise_white():
    """Innovations of an ARMA(1, 1) process have unit variance and no correlation."""
    rng = np.random.default_rng(1)
    n = 200_000
    e = rng.standard_normal(n)
    x = np.zeros(n)
    for i in range(1, n):
        x[i] = 0.9 * x[i - 1] + e[i] - 0.7 * e[i - 1]
    white = Noise((1.0,), (0.9,), (0.7,)).whiten(0, x)
    assert white.std() == pytest.approx(1.0, rel=0.01)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.01
    assert Noise((1.0,), (0.9,), (0.7,)).total[0] == pytest.approx(x.std(), rel=0.02)


@pytest.mark.parametrize("shape", [(7, 2, 50), (3, 5, 2, 50), (6, 1, 50)])
def test_residuals_are_whitened_together_as_one_after_the_other(shape):
    """By the recursion as it is written, for rows that are no multiple of four, with weights of each trial."""
    rng = np.random.default_rng(2)
    noise = Noise((2.0, 0.3), (0.9, 0.2), (0.7, -0.1))
    r, weight = rng.standard_normal(shape), rng.random((shape[-3], shape[-2], shape[-1]))
    found = noise.whitened(r, weight)
    given = (r * weight).reshape(-1, *shape[-2:])
    for row, white in zip(given, found.reshape(given.shape), strict=True):
        for c, x in enumerate(row):
            before, e = 0.0, 0.0
            for i in range(x.size):
                e = x[i] - noise.phi[c] * before + noise.theta[c] * e
                before = x[i]
                assert white[c, i] == pytest.approx(e / noise.innovation[c], abs=1e-12)


def test_a_prediction_that_is_asked_for_again_is_not_made_again(fitted, monkeypatch):
    heldout = fitted.problem.experiment.heldout
    once = predict(fitted, heldout)
    monkeypatch.setattr(Problem, "simulate", None)
    assert predict(fitted, heldout)[heldout[0]] is once[heldout[0]]
    with pytest.raises(TypeError):
        predict(replace(fitted, q=fitted.q + 0.01), heldout)


def test_the_noise_is_learnt_from_the_repeats():
    """Standard deviation and colour come back from records with AR(1) noise."""
    fit = calibrate_nominal(make_experiment(5, colour=True))
    noise = learn_noise(fit)
    assert noise.total[0] == pytest.approx(2.0, rel=0.1)
    flat = np.concatenate([noise.whiten(0, r[0]) for r in fit.residuals().values()])
    assert abs(np.corrcoef(flat[1:], flat[:-1])[0, 1]) < 0.05


def test_heldout_trials_cost_no_more_than_noise(fitted):
    """A trial that no fit has seen is predicted to the noise, its own release angle fitted."""
    experiment = fitted.problem.experiment
    assert set(fitted.problem.trials).isdisjoint(experiment.heldout)
    for row in predict(fitted, experiment.heldout).values():
        assert abs(row.chi2 - row.n_data) < 5.0 * math.sqrt(2.0 * row.n_data)


def test_switches_stay_off_where_the_repeats_agree(fitted):
    """Easy data do not pay for triggers of their own, and show no friction that differs."""
    assert not fitted.problem.switches.delay
    assert max(s.gained for s in fitted.problem.switches.scatter.sizes) < 3.0


def test_a_point_that_cannot_be_simulated_has_no_evidence(fitted):
    """A failed simulation costs infinity and its evidence is minus infinity, so that it never wins."""
    problem = fitted.problem
    q = fitted.q.copy()
    q[problem.names.index("nu")] = np.nan
    assert problem.costs(q[None], {i: v[None] for i, v in fitted.eta.items()})[0] == math.inf
    broken = calibrate(problem, [q])
    assert broken.log_evidence == -math.inf


def test_uncoupled_trials_alone_are_enough_for_what_they_show():
    """Only drag, its curve and the viscous damping are asked for."""
    fit = calibrate_nominal(make_experiment(4, coupled=False))
    assert set(fit.parameters) == {"c1t", "drag", "nu", "tail"}
    assert fit.parameters["drag"][0] == pytest.approx(TRUE["drag"], rel=0.1)


def test_the_linear_nominal_has_no_dry_friction():
    """mu and drag are neither fitted nor simulated."""
    problem = Problem(make_experiment(1, n=100), nominal="linear")
    assert set(problem.names) == {"k2t", "c2t", "c1t", "c3t"}


def test_free_starts_infer_the_initial_state():
    """Records that begin somewhere in the motion are fitted without a release."""
    rng = np.random.default_rng(2)
    times = np.arange(400) * 1e-3
    trials = []
    for number in (1, 2):
        y = (
            Model(False)
            .simulate(
                RIG | TRUE | {"k1t": 6.2, "theta0": 0.05, "omega1_0": 1.5, "delay": 0.0}, times, quantity="velocity"
            )
            .y[0]
        )
        trials.append(TrialRecord("a", "I", False, number, times, y + 0.02 * rng.standard_normal(y.shape), 0))
    fit = calibrate_nominal(
        Experiment({"J1": (RIG["J1"], 0.0)}, ((6.2, 0.0),), tuple(trials), quantity="velocity", start="free")
    )
    assert abs(fit.excess) < 5.0 * math.sqrt(2.0 * fit.problem.n_data)


def swing(offset=0.0, scale=1.0, noise=1e-4, seed=3, **fields):
    """Two records of one body on a pendulum's spring, that begin in motion, read with an offset and a wrong scale."""
    rng = np.random.default_rng(seed)
    rig = {"J1": 1.0, "k1t": 100.0, "c1t": 0.4, "drag": 0.0, "nu": 50.0}
    times = np.arange(0.0, 2.0, 0.01)
    trials = []
    for number, (angle, speed) in enumerate([(1.2, 0.5), (0.7, -0.8)], start=1):
        truth = Model(False, restoring="pendulum").simulate(
            rig | {"theta0": angle, "omega1_0": speed}, times, quantity="displacement"
        ).y[0]  # fmt: skip
        y = scale * truth + offset + noise * rng.standard_normal(truth.shape)
        trials.append(TrialRecord(f"swing {number}", "A", False, number, times, y, 0))
    return Experiment(
        {"J1": (1.0, 0.0)}, ((100.0, 5.0),), tuple(trials), quantity="displacement", restoring="pendulum",
        start="free", **fields,
    )  # fmt: skip


def test_offset_and_scale_of_a_sensor_are_inferred():
    fit = calibrate(Problem(swing(offset=0.02, scale=1.01, scale_sd=(0.02,)), nominal="linear"))
    scale, sd = fit.parameters["scale1"]
    assert abs(scale - 1.01) < 4.0 * sd < 0.004
    for group in fit.problem.groups:
        names = [name for name, _, _ in group.nuisances]
        assert names == ["theta0", "omega1_0", "offset1"]
        for k, i in enumerate(group.trials):
            assert group.nuisances[2][2][k] * fit.eta[i][2] == pytest.approx(0.02, abs=1e-4)
    assert fit.chi2 < 1.2 * fit.problem.n_data
    assert fit.parameters["k1t"][0] == pytest.approx(100.0, rel=2e-3)


def test_a_channel_read_late_is_inferred_where_the_logger_may_be_late():
    """The second sensor is read 20 ms after its time stamp; its lag is inferred, to a thousandth of that."""
    times = np.arange(0.0, 2.0, 0.02)
    rig = {"J1": 1.0, "J2": 0.5, "k1t": 100.0, "k2t": 40.0, "c1t": 0.2, "c3t": 0.1, "c2t": 0.1, "mu": 0.0, "drag": 0.0,
           "nu": 50.0, "N0": 0.0, "R": 1.0, "r": 1.0, "theta0": 0.3, "theta2_0": 0.1}  # fmt: skip
    y = Model(True).simulate(rig, times, quantity="displacement").y[0]
    y[1] = Model(True).simulate(rig | {"delay": 0.02}, times, quantity="displacement").y[0, 1]
    trial = TrialRecord("a", "A", True, 1, times, y + 1e-4 * np.random.default_rng(1).standard_normal(y.shape), 0)
    experiment = Experiment(
        {"J1": (1.0, 0.0), "J2": (0.5, 0.0)}, ((100.0, 5.0),), (trial,), quantity="displacement", start="free",
        lag_sd=(0.0, 0.02),
    )  # fmt: skip
    fit = calibrate_nominal(experiment, nominal="linear")
    assert "lag1" not in fit.parameters
    lag, sd = fit.parameters["lag2"]
    assert sd < 3e-4
    assert lag == pytest.approx(0.02, abs=max(4.0 * sd, 1e-4))


def test_offsets_taken_as_known_stay_at_zero():
    fixed = swing(offset=0.02, offset_sd=(0.0,))
    fit = calibrate(Problem(fixed, nominal="linear"))
    assert [name for name, _, _ in fit.problem.groups[0].nuisances] == ["theta0", "omega1_0"]
    assert fit.chi2 > 5.0 * fit.problem.n_data


def test_a_free_start_takes_its_first_speed_from_the_record():
    group = Problem(swing(), nominal="linear").groups[0]
    assert group.nuisances[1][1] == pytest.approx([0.5, -0.8], abs=0.5)


def test_slow_rigs_take_longer_steps():
    assert longest_step(swing()) == pytest.approx(4e-3)
    assert longest_step(make_experiment(1, n=50)) == pytest.approx(1e-3)


def test_the_level_of_an_error_is_that_of_its_noise_where_it_is_white():
    rng = np.random.default_rng(5)
    white = [0.3 * rng.standard_normal(4000) for _ in range(3)]
    assert error_level(white) == pytest.approx(0.3, rel=0.05)
    slow = [np.convolve(w, np.ones(20), mode="same") for w in white]
    # A moving sum of 20: variance times the sum of squared autocorrelations, about 20 x 0.09 x 13.35.
    assert error_level(slow) ** 2 == pytest.approx(20 * 0.09 * 13.35, rel=0.2)


def test_without_repeats_the_noise_allows_for_an_error_of_the_model():
    rng = np.random.default_rng(5)
    wrong = replace(swing(noise=2e-3), scatter=dict.fromkeys(TYPICAL, 0.0))  # which would widen c1t in both
    right = calibrate_nominal(wrong, nominal="linear")
    assert right.problem.noise.sensor == ()
    slow = [np.convolve(rng.standard_normal(t.y.size), np.hanning(25), "same")[None] * 5e-3 for t in wrong.trials]
    bent = replace(wrong, trials=tuple(replace(t, y=t.y + s) for t, s in zip(wrong.trials, slow, strict=True)))
    fit = calibrate_nominal(bent, nominal="linear")
    noise = fit.problem.noise
    assert noise.floor[0] == pytest.approx(2e-3, rel=1.0)
    assert noise.total[0] > 5.0 * noise.floor[0]
    value, sd = fit.parameters["c1t"]
    assert sd > 4.0 * right.parameters["c1t"][1]
    assert abs(value - 0.4) < 4.0 * sd


def test_displacements_of_free_starts_are_thinned():
    fine = swing()
    kept = thinned(replace(fine, stiffnesses=((1.0, 0.1),)))
    assert kept.trials[0].times.size == 200 // 6 + 1
    assert np.array_equal(kept.trials[0].y, fine.trials[0].y[:, ::6])
    assert thinned(fine) == fine


def test_a_long_record_is_fitted_from_its_first_periods_on():
    """Eighty periods, stiffness declared 47 % off: a valley for every cycle, and the right one is found."""
    times = np.arange(0.0, 40.0, 0.02)
    rig = {"J1": 1.0, "c1t": 0.02, "k1t": 190.0, "drag": 0.0, "nu": 50.0, "theta0": 0.2, "omega1_0": 0.0}
    y = Model(False).simulate(rig, times, quantity="displacement").y[0]
    y = y + 1e-4 * np.random.default_rng(3).standard_normal(y.shape)
    trial = TrialRecord("one", "a", False, 1, times, y, 0)
    experiment = Experiment({"J1": (1.0, 0.0)}, ((100.0, 60.0),), (trial,), quantity="displacement", start="free")
    problem = Problem(experiment, nominal="linear")
    begun = grown(experiment, problem)
    assert begun is not None
    assert begun.parameters["k1t"][0] == pytest.approx(190.0, rel=2e-3)
    short = replace(trial, times=times[:200], y=y[:, :200])
    assert grown(replace(experiment, trials=(short,)), problem) is None
    fit = calibrate_nominal(experiment, nominal="linear")
    assert np.sqrt(np.mean(fit.residuals()[0] ** 2)) < 3e-4


def test_a_record_without_three_readings_in_a_row_is_fitted_like_any_other():
    """Every third reading is missing: no second difference is known, so no reading counts as an event, none warns."""
    experiment = measured(3, repeats=2, duration=0.3)
    holes = []
    for t in experiment.trials:
        y = t.y.copy()
        y[:, ::3] = np.nan
        holes.append(replace(t, y=y))
    problem = Problem(replace(experiment, trials=tuple(holes)))
    for group in problem.groups:
        assert np.all(group.weight[:, :, ::3] == 0.0)
        assert np.all(group.weight[:, :, 4::3] == 1.0)


STEP = 2.0 * math.pi / 2000.0  # rad, of an encoder
ENCODED = {"J1": 8e-4, "c1t": 4e-4, "k1t": 0.9, "drag": 0.004, "nu": 1000.0, "omega1_0": 0.0}


def encoded(angles: dict[str, tuple[float, ...]], duration: float) -> Experiment:
    """A disc with dry friction, read by an encoder of 2000 steps a turn, released from these angles, rad, by case."""
    times = np.arange(0.0, duration, 4e-3)
    trials = []
    for case, releases in angles.items():
        for number, theta0 in enumerate(releases, 1):
            y = Model(False).simulate(ENCODED | {"theta0": theta0}, times, quantity="displacement").y[0]
            trials.append(TrialRecord(f"{case}{number}", case, False, number, times, np.round(y / STEP) * STEP, 0))
    constants: dict[str, tuple[float, float]] = {"J1": (8e-4, 0.0)}
    return Experiment(constants, ((0.9, 0.009),), tuple(trials), quantity="displacement", start="free")


def test_an_encoder_at_rest_is_no_finer_than_its_step():
    """Records that mostly rest are rounded alike there: differences vanish, and would tell of a noise of nothing."""
    fit = calibrate_nominal(unrounded(encoded({"a": (0.21, 0.207, 0.214)}, 6.0)))
    assert fit.problem.noise.floor[0] > 0.99 * STEP / math.sqrt(12.0)


def test_a_run_of_equal_readings_counts_once():
    whole = encoded({"a": (0.21,)}, 6.0).trials[0]
    told = unrounded(encoded({"a": (0.21,)}, 6.0))
    assert told.rounding == (pytest.approx(STEP),)
    trial = told.trials[0]
    assert trial.weight is not None
    assert np.array_equal(trial.weight > 0.0, np.isfinite(trial.y))
    changes = np.flatnonzero(np.diff(whole.y[0]) != 0.0)
    rest = slice(changes[-1] + 2, None)
    assert 5 < np.count_nonzero(trial.weight[0, rest]) < 40  # one for each period
    assert np.sum(trial.weight[0, rest] ** 2) == pytest.approx(1.0)
    ends = np.concatenate([changes, [whole.times.size - 1]])
    lasting = np.diff(whole.times[ends]) - 4e-3 >= 2.0 * math.pi * math.sqrt(8e-4 / 0.9)
    assert np.sum(trial.weight[0] ** 2) == pytest.approx(changes.size + np.count_nonzero(lasting))


def test_what_is_told_of_rounded_readings_is_nearer_to_the_motion():
    """Where steps take long: half as far as the readings, and not nearer to rest at the ends of a swing."""
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 60.0, 2e-3)
    motion = rng.uniform(9.0, 11.0) * np.exp(-0.01 * times) * np.cos(2.0 * math.pi * 0.4 * times)
    values, weights = crossings(times, np.round(motion), 1.0, 2.5)
    assert np.array_equal(weights > 0.0, np.isfinite(values))
    off = (values - motion)[weights == 1.0]
    assert math.sqrt(np.mean(off**2)) < 0.05
    outward = off * np.sign(motion[weights == 1.0])
    assert abs(np.mean(outward)) < 4.0 * np.std(outward) / math.sqrt(outward.size)


@pytest.mark.parametrize("apart", [0.002, 0.0])
def test_values_from_an_encoder_stay_within_their_intervals(apart: float):
    """Repeats released from nearly the same angle are rounded alike, which is neither a gap nor more knowledge."""
    angles = {"a": (0.2087, 0.2087 - apart, 0.2087 + 2.0 * apart), "b": (0.4449, 0.4449 + apart, 0.4449 - apart)}
    fit = calibrate_nominal(unrounded(encoded(angles, 3.0)))
    for name in ("c1t", "drag", "k1t"):
        value, sd = fit.parameters[name]
        assert abs(value - ENCODED[name]) < 4.0 * sd
    assert remainder_of(fit).strength < 8.0
    alike = fit.problem.noise.floor[0] / (STEP / math.sqrt(12.0))
    assert alike == pytest.approx(math.sqrt(3.0), rel=0.05) if apart == 0.0 else alike < 1.3


def test_readings_whose_noise_exceeds_their_step_all_count():
    fine = make_experiment(2, n=50, repeats=2)
    assert unrounded(fine) is fine
    coarse = replace(fine, trials=tuple(replace(t, y=np.round(t.y)) for t in fine.trials))  # half the noise's sd
    assert unrounded(coarse) is coarse


def test_missing_readings_neither_hide_nor_feign_a_remainder():
    experiment = make_experiment(3, coupled=False)
    holes = []
    for t in experiment.trials:
        y = t.y.copy()
        y[:, 150:350] = np.nan
        holes.append(replace(t, y=y))
    left = remainder_of(calibrate_nominal(replace(experiment, trials=tuple(holes))))
    assert abs(left.low_excess) < 4.0 * left.low_sd


def test_draws_from_the_prior_are_compared_in_little_memory():
    """All 512 records of 14 000 readings at once are 57 MB, and several such arrays are held at a time."""
    times = 1e-3 * np.arange(14_000)
    trial = TrialRecord("a", "A", False, 1, times, np.cos(60.0 * times)[None], 0)
    experiment = Experiment({"J1": (3e-3, 0.0)}, ((10.8, 0.0),), (trial,), "displacement", start="free")
    problem = Problem(experiment)
    rng = np.random.default_rng(0).standard_normal((512, problem.size))
    tracemalloc.start()
    try:
        found = drawn_starts(problem)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 80e6
    assert len(found) == 6
    eta = {0: np.tile(problem.no_nuisance()[0], (8, 1))}
    costs = problem.costs(np.array([*found, *rng[:2]]), eta, annealed=True)
    assert np.all(np.diff(costs[:6]) >= 0.0)
    assert np.all(costs[0] <= costs[6:])


def test_what_an_accelerometer_reads_at_rest_is_no_motion():
    """A free decay of damping ratio 0.1 % in closed form, its sensor off by a twentieth of the largest reading."""
    rng = np.random.default_rng(2)
    times = 4e-3 * np.arange(1500)
    omega, ratio, offset, noise = 38.0, 1e-3, 0.13, 0.03
    z = omega * complex(-ratio, math.sqrt(1.0 - ratio**2))
    y = (1.8e-3 * z**2 * np.exp(z * times)).real + offset + noise * rng.standard_normal(times.size)
    trial = TrialRecord("a", "A", False, 1, times, y[None], 0)
    experiment = Experiment({"J1": (1.0, 0.0)}, ((1.02 * omega**2, 0.1 * omega**2),), (trial,), start="free")
    fit = calibrate_nominal(experiment, nominal="linear")
    assert float(np.std(fit.residuals()[0])) < 1.05 * noise
    names = [name for name, _, _ in fit.problem.groups[0].nuisances]
    sd = fit.problem.groups[0].nuisances[names.index("offset1")][2][0]
    assert abs(fit.eta[0][names.index("offset1")] * sd - offset) < 5e-3
    low, high = fit.interval("c1t", 0.99)
    assert low < 2.0 * ratio * omega < high
