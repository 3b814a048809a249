"""Two links in series against an independent integration, and the constant inertia matrix as the small-angle limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_damper.effects import EFFECTS
from bayes_damper.simulation.links import of_links
from bayes_damper.simulation.model import Model

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
        lever = rig["J12"] / rig["J2"] * np.cos(phi)
        through = v + lever * u  # of the second link through the air
        air = rig["c3t"] * through + quadratic * rig["J1"] * through * abs(through)
        matrix = np.array([[rig["J1"], rig["J12"] * np.cos(phi)], [rig["J12"] * np.cos(phi), rig["J2"]]])
        joint = rig["c2t"] * (u - v) + rig["mu"] * np.tanh(rig["nu"] * (u - v))
        torques = np.array(
            [
                -rig["c1t"] * u - rig["k1t"] * np.sin(a) - rig["drag"] * np.tanh(rig["nu"] * u) - joint
                - rig["J12"] * np.sin(phi) * v * v - quadratic * rig["J1"] * u * abs(u) - lever * air,
                -rig["k3t"] * np.sin(b) + joint + rig["J12"] * np.sin(phi) * u * u - air,
            ]
        )  # fmt: skip
        return np.concatenate([[u, v], np.linalg.solve(matrix, torques)])

    start = [rig[name] for name in ("theta0", "theta2_0", "omega1_0", "omega2_0")]
    span = (0.0, TIMES[-1])
    return solve_ivp(rates, span, start, t_eval=TIMES, rtol=1e-9, atol=1e-11, method="LSODA").y[:2]


@pytest.mark.slow
@pytest.mark.parametrize("quadratic", [0.0, 0.3])
def test_links_follow_lagranges_equations(quadratic):
    effect = of_links(EFFECTS["quadratic_drag"].variant("alike")) if quadratic else None
    model = Model(True, "constant", "pendulum", effect, "cosine", 4e-3)
    values = {"coefficient": quadratic} if quadratic else None
    y = model.simulate(RIG, TIMES, effect=values, quantity="displacement").y[0]
    assert np.abs(y - reference(RIG, quadratic)).max() < 2e-5


@pytest.mark.slow
def test_small_angles_do_not_tell_the_two_laws_apart():
    """Without c3t, which is a bearing's in the one law and the air's in the other."""
    small = RIG | {"theta0": 1e-3, "theta2_0": -5e-4, "omega1_0": 0.0, "omega2_0": 0.0, "drag": 0.0, "mu": 0.0}
    small["c3t"] = 0.0
    cosine, constant = (
        Model(True, "constant", "pendulum", None, law, 4e-3).simulate(small, TIMES, quantity="displacement").y[0]
        for law in ("cosine", "constant")
    )
    assert np.abs(cosine - constant).max() < 1e-7


def test_the_second_link_has_no_bearing_whose_drag_could_differ():
    model = Model(True, "constant", "pendulum", None, "cosine", 4e-3)
    y, other = (model.simulate(RIG | ratio, TIMES).y for ratio in ({}, {"drag_ratio": 3.0}))
    np.testing.assert_array_equal(y, other)


@pytest.mark.slow
def test_an_effect_in_the_bearings_acts_on_the_first_link_only():
    """Dry drag as an effect is the nominal drag of the same size."""
    found = of_links(EFFECTS["bearing_drag"].variant("dry"))
    model = Model(True, "constant", "pendulum", found, "cosine", 4e-3)
    values = {"drag": RIG["drag"], "smoothing": RIG["nu"]}
    y = model.simulate(RIG | {"drag": 0.0}, TIMES, effect=values, quantity="displacement").y[0]
    assert np.abs(y - reference(RIG)).max() < 2e-5


def test_links_take_no_input_torque():
    with pytest.raises(ValueError, match="coupling_law"):
        Model(True, "constant", "pendulum", None, "cosine").compile(driven=True)


@pytest.mark.slow
def test_drag_along_the_second_link_is_that_of_its_speed_through_the_air():
    """A uniform thin rod dragged at every point: simulated by points, against c3t and c1t of the package."""
    first, length, mass, drag = 0.4, 0.6, 1.0, 0.08
    points = (np.arange(400) + 0.5) / 400 * length
    share = np.full(400, drag / 400)
    rig = RIG | {
        "J1": 0.5, "J2": mass * length**2 / 3, "J12": mass * first * length / 2, "c1t": 0.0, "c2t": 0.0, "mu": 0.0,
        "drag": 0.0, "k1t": 20.0, "k3t": 3.0,
    }  # fmt: skip

    def rates(_, state):
        a, b, u, v = state
        phi = a - b
        across = rig["J12"] * np.cos(phi)
        speed = first * np.cos(phi) * u + points * v  # across the rod, of each point
        torques = np.array(
            [
                -rig["k1t"] * np.sin(a) - rig["J12"] * np.sin(phi) * v * v - first * np.cos(phi) * share @ speed,
                -rig["k3t"] * np.sin(b) + rig["J12"] * np.sin(phi) * u * u - share * points @ speed,
            ]
        )
        return np.concatenate([[u, v], np.linalg.solve([[rig["J1"], across], [across, rig["J2"]]], torques)])

    start = [rig[name] for name in ("theta0", "theta2_0", "omega1_0", "omega2_0")]
    small = [0.05 * x for x in start]
    exact = solve_ivp(rates, (0.0, TIMES[-1]), small, t_eval=TIMES, rtol=1e-10, atol=1e-13, method="LSODA").y[:2]
    beyond = drag * first**2 * (1.0 - 0.75)  # of the first link's own speed: belongs to c1t
    ours = rig | {"c3t": drag * length**2 / 3, "c1t": beyond}
    ours |= dict(zip(("theta0", "theta2_0", "omega1_0", "omega2_0"), small, strict=True))
    y = Model(True, "constant", "pendulum", None, "cosine", 4e-3).simulate(ours, TIMES, quantity="displacement").y[0]
    assert np.abs(y - exact).max() < 2e-4 * np.abs(exact).max()
    # At the second link's own speed alone, as if it turned about a point at rest, the drag is a different one.
    still = rig | {"c3t": drag * length**2 / 3, "c1t": drag * first**2}
    assert np.abs(exact - exact_without_carrying(still, small)).max() > 2e-2 * np.abs(exact).max()


def exact_without_carrying(rig, start):
    """The links with c1t and c3t each at its own link's speed."""

    def rates(_, state):
        a, b, u, v = state
        phi = a - b
        across = rig["J12"] * np.cos(phi)
        torques = [
            -rig["k1t"] * np.sin(a) - rig["J12"] * np.sin(phi) * v * v - rig["c1t"] * u,
            -rig["k3t"] * np.sin(b) + rig["J12"] * np.sin(phi) * u * u - rig["c3t"] * v,
        ]
        return np.concatenate([[u, v], np.linalg.solve([[rig["J1"], across], [across, rig["J2"]]], torques)])

    return solve_ivp(rates, (0.0, TIMES[-1]), start, t_eval=TIMES, rtol=1e-10, atol=1e-13, method="LSODA").y[:2]
