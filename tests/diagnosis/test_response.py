"""The rig linearised along a motion that is imposed on it, against equations solved here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from scipy.stats import norm

from bayes_damper.calibration import Experiment, Noise, Problem, Switches, TrialRecord, summarise
from bayes_damper.calibration.own_values import Scatter, Size
from bayes_damper.diagnosis.response import motions, nominal_slopes
from bayes_damper.effects import EFFECTS
from bayes_damper.rig.inputs import Inputs

TIMES = np.arange(0.0, 2.0, 4e-3)
GRAVITY = 9.80665
MOTION = 0.05 * np.sin(21.0 * TIMES) + 0.02 * np.sin(47.0 * TIMES)
PUSH = 0.01 * np.cos(30.0 * TIMES)  # N m


def moved(constants, inputs, *, coupled, quantity="displacement", restoring="linear"):
    """The motion of one trial at the prior medians of a linear model, and its fit."""
    y = np.ones((1 + coupled, TIMES.size))
    trial = TrialRecord("a", "A", coupled, 1, TIMES, y, 0, inputs=inputs)
    experiment = Experiment(
        {name: (value, 0.0) for name, value in constants.items()}, ((12.0, 0.0),), (trial,), quantity,
        restoring=restoring,
    )  # fmt: skip
    zero = (0.0,) * (1 + coupled)
    problem = Problem(experiment, nominal="linear", noise=Noise((1.0,) * (1 + coupled), zero, zero))
    fit = summarise(problem, np.zeros(problem.size), problem.no_nuisance(), True, 0, central=False)
    (motion,) = motions(fit)
    return fit, motion, {name: float(x) for name, x in problem.parameters(np.zeros(problem.size)).items()}


def test_linear_responses_know_that_the_drag_of_the_bearings_differs():
    """An effect of no strength adds no torque to the nominal laws, those of a trial whose bearings differ by 10 %."""
    constants = {"J1": 3e-3, "J2": 2.5e-3, "N0": 100.0, "R": 0.1, "r": 0.0127}
    trial = TrialRecord("a", "A", True, 1, TIMES, np.ones((2, TIMES.size)), 0, 0.1)
    fixed = {"mu": 0.0, "k2t": 1.5, "c2t": 0.06, "drag": 0.006, "nu": 40.0, "c1t": 0.01, "c3t": 0.01, "tail": 0.0}
    experiment = Experiment(
        {name: (value, 0.0) for name, value in constants.items()}, ((8.0, 0.0),), (trial,), priors=fixed
    )
    scatter = Scatter((Size("drag_ratio", 0.1, 0.0, 1.0, 0.1),))
    problem = Problem(
        experiment, noise=Noise((1.0, 1.0), (0.0, 0.0), (0.0, 0.0)), switches=Switches(False, False, scatter=scatter),
        effect=EFFECTS["spring_cubic"].variants[0],
    )  # fmt: skip
    (motion,) = motions(summarise(problem, problem.prior_mean(), {0: np.array([1.0])}, True, 0, central=False))
    assert np.abs(motion.added).max() < 1e-3 * fixed["drag"]


def between(grid, values):
    return np.interp(grid, TIMES, values)


@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
def test_a_torque_on_the_secondary_shows_in_the_reaction_of_a_prescribed_primary(quantity):
    """J2 x'' + (c2t + c3t) x' + (k2t + k3t) x = q2, reaction + J12 x'' - c2t x' - k2t x, by scipy's lsim."""
    constants = {"J1": 3e-3, "J2": 2.5e-3, "J12": 4e-4, "k3t": 0.8}
    _, motion, p = moved(constants, Inputs.measured(TIMES, motion=MOTION), coupled=True, quantity=quantity)
    J2, c, k = constants["J2"], p["c2t"] + p["c3t"], p["k2t"] + constants["k3t"]
    state = np.array([[0.0, 1.0], [-k / J2, -c / J2]])
    fine = np.linspace(0.0, TIMES[-1], 20 * (TIMES.size - 1) + 1)
    q2 = between(fine, PUSH)
    _, _, x = lsim((state, [[0.0], [1.0 / J2]], np.eye(2), np.zeros((2, 1))), q2, fine)
    bent = q2 / J2 + x @ state[1]
    expected = [
        constants["J12"] * bent - p["c2t"] * x[:, 1] - p["k2t"] * x[:, 0],
        bent if "acc" in quantity else x[:, 0],
    ]
    torque = between(motion.grid, PUSH)[None, None]
    for found, right in zip(motion.respond(None, torque)[0, 0], expected, strict=True):
        np.testing.assert_allclose(found, right[::20], atol=2e-3 * np.abs(right).max())
    # A torque on the primary changes nothing but what it takes to move it as prescribed.
    reaction, secondary = motion.respond(torque, None)[0, 0]
    np.testing.assert_allclose(reaction, -PUSH, atol=1e-12)
    assert not secondary.any()
    np.testing.assert_allclose(motion.th1[0, motion.at], MOTION, atol=1e-12)
    # The reading itself: M a less what the nominal laws give.
    a1, a2, th, w = motion.a1, motion.a2, motion.th1 - motion.th2, motion.w1 - motion.w2
    right = constants["J1"] * a1 + constants["J12"] * a2 + 12.0 * motion.th1 + p["c1t"] * motion.w1
    right += p["k2t"] * th + p["c2t"] * w
    np.testing.assert_allclose(motion.y[0, 0], right[0, motion.at], atol=1e-6)


def test_a_torque_on_a_pendulum_whose_pivot_moves_acts_as_scipy_has_it():
    """J1 x'' + c1t x' + k1t sin x = -k1t a / g cos x + q at an acceleration of the pivot near that of gravity."""
    pivot = 7.0 * np.sin(9.0 * TIMES)
    constants = {"J1": 0.1}
    inputs = Inputs.measured(TIMES, pivot=pivot)
    fit, motion, p = moved(constants, inputs, coupled=False, restoring="pendulum")

    def angle(size):
        def rates(t, x):
            a, q = np.interp(t, TIMES, pivot), size * np.interp(t, TIMES, PUSH)
            torque = -12.0 * np.sin(x[0]) - 12.0 * a / GRAVITY * np.cos(x[0]) - p["c1t"] * x[1] + q
            return [x[1], torque / 0.1]

        return solve_ivp(rates, (0.0, TIMES[-1]), [0.0, 0.0], t_eval=TIMES, rtol=1e-10, atol=1e-12, max_step=4e-3).y[0]

    np.testing.assert_allclose(motion.y[0, 0], angle(0.0), atol=1e-4)
    assert np.abs(motion.th1).max() > 0.3  # far enough for cos and sin to matter
    expected = (angle(1e-2) - angle(-1e-2)) / 2e-2
    found = motion.respond(between(motion.grid, PUSH)[None, None], None)[0, 0, 0]
    np.testing.assert_allclose(found, expected, atol=1e-2 * np.abs(expected).max())
    # What is left of the nominal laws beside the inertia: nothing where only these act.
    slopes = nominal_slopes(fit, fit.linear.blocks[0], motion)
    k = fit.problem.names.index("c1t")
    # A value moves with its standard coordinate by the ratio of the two densities.
    slope = norm.pdf(fit.q[k]) / np.exp(fit.problem.coordinates[k].prior.logpdf(p["c1t"]))
    np.testing.assert_allclose(slopes[0, k, 0], -slope * motion.w1[0], rtol=2e-3, atol=1e-9)
