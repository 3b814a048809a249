"""Two links in series against an independent integration, and the constant inertia matrix as the small-angle limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_damper.effects import EFFECTS
from bayes_damper.links import of_first_bearing
from bayes_damper.model import Model

RIG = {
    "J1": 1.0, "J2": 0.41, "J12": 0.42, "k1t": 57.0, "k3t": 22.0, "c1t": 0.05, "c3t": 0.01, "k2t": 0.0, "c2t": 0.02,
    "mu": 0.01, "N0": 1.0, "R": 1.0, "r": 1.0, "drag": 0.02, "nu": 30.0, "theta0": 0.8, "theta2_0": -0.5,
    "omega1_0": 0.3, "omega2_0": 0.1,
}  # fmt: skip
TIMES = np.arange(0.0, 3.0, 0.02)


def reference(rig, quadratic=0.0):
    """Lagrange's equations of a double pendulum in absolute angles, by scipy; only the first link has bearing drag."""

    def rates(_, state):
        a, b, u, v = state
        phi = a - b
        matrix = np.array([[rig["J1"], rig["J12"] * np.cos(phi)], [rig["J12"] * np.cos(phi), rig["J2"]]])
        joint = rig["c2t"] * (u - v) + rig["mu"] * np.tanh(rig["nu"] * (u - v))
        torques = np.array(
            [
                -rig["c1t"] * u - rig["k1t"] * np.sin(a) - rig["drag"] * np.tanh(rig["nu"] * u) - joint
                - rig["J12"] * np.sin(phi) * v * v - quadratic * rig["J1"] * u * abs(u),
                -rig["c3t"] * v - rig["k3t"] * np.sin(b) + joint
                + rig["J12"] * np.sin(phi) * u * u - quadratic * rig["J1"] * v * abs(v),
            ]
        )  # fmt: skip
        return np.concatenate([[u, v], np.linalg.solve(matrix, torques)])

    start = [rig[name] for name in ("theta0", "theta2_0", "omega1_0", "omega2_0")]
    span = (0.0, TIMES[-1])
    return solve_ivp(rates, span, start, t_eval=TIMES, rtol=1e-9, atol=1e-11, method="LSODA").y[:2]


@pytest.mark.slow
@pytest.mark.parametrize("quadratic", [0.0, 0.3])
def test_links_follow_lagranges_equations(quadratic):
    effect = EFFECTS["quadratic_drag"].variant("alike") if quadratic else None
    model = Model(True, "constant", "pendulum", effect, "cosine", 4e-3)
    values = {"coefficient": quadratic} if quadratic else None
    y = model.simulate(RIG, TIMES, effect=values, quantity="displacement").y[0]
    assert np.abs(y - reference(RIG, quadratic)).max() < 2e-5


@pytest.mark.slow
def test_small_angles_do_not_tell_the_two_laws_apart():
    small = RIG | {"theta0": 1e-3, "theta2_0": -5e-4, "omega1_0": 0.0, "omega2_0": 0.0, "drag": 0.0, "mu": 0.0}
    cosine, constant = (
        Model(True, "constant", "pendulum", None, law, 4e-3).simulate(small, TIMES, quantity="displacement").y[0]
        for law in ("cosine", "constant")
    )
    assert np.abs(cosine - constant).max() < 1e-7


@pytest.mark.slow
def test_an_effect_in_the_bearings_acts_on_the_first_link_only():
    """Dry drag as an effect is the nominal drag of the same size; drag of the air stays on both links."""
    found = of_first_bearing(EFFECTS["bearing_drag"].variant("dry"))
    model = Model(True, "constant", "pendulum", found, "cosine", 4e-3)
    values = {"drag": RIG["drag"], "smoothing": RIG["nu"]}
    y = model.simulate(RIG | {"drag": 0.0}, TIMES, effect=values, quantity="displacement").y[0]
    assert np.abs(y - reference(RIG)).max() < 2e-5
    air = EFFECTS["quadratic_drag"].variant("alike")
    assert of_first_bearing(air) is air


def test_links_take_no_input_torque():
    with pytest.raises(ValueError, match="coupling_law"):
        Model(True, "constant", "pendulum", None, "cosine").compile(driven=True)
