"""The nominal torques against the formulas of the thesis, and their Jacobian against difference quotients."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_damper.rig import equations, vector_math

CONSTANTS = {"k1t": 6.2, "k3t": 0.7, "c1t": 0.01, "c3t": 0.02, "k2t": 1.3, "c2t": 0.03}
NU, FRICTION, SLOPE, DRAG, DRAG2, TAIL = 40.0, 0.09, 3.9, 0.015, 0.022, 0.6
STATES = np.random.default_rng(3).normal(0.0, [0.05, 0.05, 1.0, 1.0], (20, 4))


def _sign(x):
    curves = [np.tanh(x), x / np.hypot(1.0, x), 2.0 / np.pi * np.arctan(0.5 * np.pi * x)]
    return np.polynomial.Polynomial.fit([0.0, 0.5, 1.0], curves, 2)(TAIL)


def _formula(state, coupled, pendulum):
    """Eqs. 18-20 and the slow end of dry friction, written out with numpy."""
    th1, th2, w1, w2 = state
    k = CONSTANTS
    g1, g2 = (np.sin(th1), np.sin(th2)) if pendulum else (th1, th2)
    pull = max(0.0, 1.0 - SLOPE * abs(th1 - th2))
    T = k["k2t"] * (th1 - th2) + k["c2t"] * (w1 - w2) + FRICTION * pull * _sign(NU * (w1 - w2))
    tau1 = -k["c1t"] * w1 - k["k1t"] * g1 - DRAG * _sign(NU * w1)
    if not coupled:
        return np.array([tau1, 0.0])
    return np.array([tau1 - T, T - k["c3t"] * w2 - k["k3t"] * g2 - DRAG2 * _sign(NU * w2)])


def _linearised(state, coupled, pendulum):
    return equations.linearised.py_func(
        *state, *CONSTANTS.values(), FRICTION, SLOPE, DRAG, DRAG2, NU, TAIL, True, coupled, pendulum
    )


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("pendulum", [True, False])
def test_torques_are_those_of_the_equations(coupled, pendulum):
    for state in STATES:
        expected = _formula(state, coupled, pendulum)
        smooth = equations.smooth_torques(*state, *CONSTANTS.values(), coupled, pendulum)
        held = equations.friction_torques(
            *state, FRICTION, SLOPE, DRAG, DRAG2, vector_math.TANH_SCALE * NU, TAIL, True, coupled
        )
        np.testing.assert_allclose(np.subtract(smooth, held), expected, atol=2e-5 * (FRICTION + DRAG))
        np.testing.assert_allclose(_linearised(state, coupled, pendulum)[:2], np.subtract(smooth, held), atol=1e-13)


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("pendulum", [True, False])
def test_jacobian_is_the_derivative_of_the_torques(coupled, pendulum):
    for state in STATES:
        _, _, a1, a2, t_phi, b1, b2, t_slip = _linearised(state, coupled, pendulum)
        analytic = np.array([
            [a1 - t_phi, t_phi, b1 - t_slip, t_slip],
            [t_phi, a2 - t_phi, t_slip, b2 - t_slip],
        ])  # fmt: skip
        step = 1e-6 * np.eye(4)
        quotient = np.array([
            (_formula(state + s, coupled, pendulum) - _formula(state - s, coupled, pendulum)) / 2e-6 for s in step
        ]).T  # fmt: skip
        np.testing.assert_allclose(analytic, quotient, atol=1e-6 * np.abs(quotient).max())


def test_the_pull_falls_linearly_with_the_overlap_and_ends_at_its_edge():
    assert equations.normal_force_ratio(0.0, SLOPE) == 1.0
    assert equations.normal_force_ratio(-0.1, SLOPE) == pytest.approx(1.0 - 0.39)
    assert equations.normal_force_ratio(0.3, SLOPE) == 0.0
    assert equations.normal_force_ratio(0.3, 0.0) == 1.0
