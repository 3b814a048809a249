"""Measured inputs against scipy's DOP853 in absolute coordinates, which shares neither equations nor frame."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy.integrate import solve_ivp

from bayes_damper.effects import all_effects
from bayes_damper.rig.inputs import Inputs
from bayes_damper.simulation.model import Model

P = reference.BASE | {"J12": 4e-4, "k3t": 0.8, "nu": 40.0, "theta0": 0.0}
TIMES = np.arange(0.0, 0.25, 1e-3)
QUANTITIES = ("acceleration", "velocity", "displacement")


def absolute(p, times, torques, ground, coupled=True, start=(0.0, 0.0, 0.0, 0.0), cubic=0.0, knots=None):
    """Accelerations, velocities and angles in space, (3, 2, n); torques, ground: t -> (T1, T2), (angle, speed) of it.

    knots : instants between which torques and ground are smooth; start : angles and velocities in space.
    """

    def rates(t, x):
        (u1, u2), (g, wg) = torques(t), ground(t)
        th1, th2, w1, w2 = x
        tau1 = u1 - p["c1t"] * (w1 - wg) - p["k1t"] * (th1 - g) - p["drag"] * math.tanh(p["nu"] * (w1 - wg))
        tau1 -= cubic * (th1 - g) ** 3
        if not coupled:
            return [w1, 0.0, tau1 / p["J1"], 0.0]
        tau2 = u2 - p["c3t"] * (w2 - wg) - p["k3t"] * (th2 - g) - p["drag"] * math.tanh(p["nu"] * (w2 - wg))
        pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(th1 - th2) / (2.0 * p["r"]))
        face = p["mu"] * pull * p["R"] * math.tanh(p["nu"] * (w1 - w2))
        joint = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2) + face
        a1, a2 = np.linalg.solve([[p["J1"], p["J12"]], [p["J12"], p["J2"]]], [tau1 - joint, tau2 + joint])
        return [w1, w2, a1, a2]

    states = np.empty((4, times.size))
    states[:, 0] = start
    knots = times if knots is None else np.union1d(knots, times)
    x, row = np.array(start, float), 0
    accelerations = np.empty((2, times.size))
    for k, t in enumerate(knots):
        if row < times.size and abs(t - times[row]) < 1e-12:
            states[:, row], accelerations[:, row] = x, rates(t + 1e-12, x)[2:]
            row += 1
        if k + 1 < knots.size:
            inside = (t + 1e-12, knots[k + 1] - 1e-12)  # a held input changes at the sample
            x = solve_ivp(rates, inside, x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return np.stack([accelerations, states[2:], states[:2]])


def series(seed=3):
    """Torques on both bodies and an acceleration of the ground: a step, a sweep and noise."""
    rng = np.random.default_rng(seed)
    sweep = 0.2 * np.sin(2.0 * np.pi * (4.0 + 60.0 * TIMES) * TIMES)
    step = np.where(TIMES > 0.1, 0.15, 0.0)
    return step + 0.02 * rng.normal(size=TIMES.size), sweep, 40.0 * np.sin(31.0 * TIMES) + rng.normal(size=TIMES.size)


def between(times, values, held):
    if held:
        return lambda t: values[max(np.searchsorted(times, t, side="right") - 1, 0)]
    return lambda t: np.interp(t, times, values)


def motion_of(times, acceleration, held):
    """Angle and speed of a ground at rest at first, by stepping quadrature of its own."""

    def ground(t):
        if t <= times[0]:
            return 0.0, 0.0
        i = min(np.searchsorted(times, t, side="right") - 1, times.size - 2)
        h, u = times[i + 1] - times[i], t - times[i]
        slope = 0.0 if held else (acceleration[i + 1] - acceleration[i]) / h
        w = speeds[i] + acceleration[i] * u + slope * u**2 / 2.0
        return angles[i] + speeds[i] * u + acceleration[i] * u**2 / 2.0 + slope * u**3 / 6.0, w

    speeds, angles = [0.0], [0.0]
    for i in range(times.size - 1):
        h = times[i + 1] - times[i]
        slope = 0.0 if held else (acceleration[i + 1] - acceleration[i]) / h
        angles.append(angles[-1] + speeds[-1] * h + acceleration[i] * h**2 / 2.0 + slope * h**3 / 6.0)
        speeds.append(speeds[-1] + acceleration[i] * h + slope * h**2 / 2.0)
    return ground


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("coupled", [True, False])
def test_torques_and_an_accelerated_ground_act_as_the_equations_say(held, coupled):
    torque1, torque2, ground = series()
    first, second = between(TIMES, torque1, held), between(TIMES, torque2, held)
    moved = motion_of(TIMES, ground, held)
    exact = absolute(P, TIMES, lambda t: (first(t), second(t)), moved, coupled)
    carried = np.array([[between(TIMES, ground, held)(t + 1e-12), *moved(t)[::-1]] for t in TIMES]).T
    for row, quantity in enumerate(QUANTITIES):
        for frame in ("absolute", "ground"):
            inputs = Inputs.measured(
                TIMES, torque1, torque2, ground=ground, quantity=quantity, frame=frame, held=held
            )  # fmt: skip
            y = Model(coupled=coupled).simulate(P, TIMES, inputs=inputs, quantity=quantity).y[0]
            wanted = exact[row, : 1 + coupled] - (carried[row] if frame == "ground" else 0.0)
            assert np.abs(y - wanted).max() < 1e-4 * np.abs(wanted).max(), (quantity, frame)


def _multisine(t):
    waves = [(2.0, 0.03, 0.2), (7.0, 0.02, 1.1), (16.0, 0.006, 2.5)]
    angle = sum(a * (np.sin(2.0 * np.pi * f * t + s) - np.sin(s)) for f, a, s in waves)
    return angle, sum(a * 2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t + s) for f, a, s in waves)


@pytest.mark.parametrize(("quantity", "row"), [("acceleration", 0), ("velocity", 1), ("displacement", 2)])
def test_a_ground_measured_as_an_angle_moves_the_rig_as_it_really_did(quantity, row):
    angle, speed = _multisine(TIMES)
    at_rest = (0.0, 0.0, speed[0], speed[0])  # as the ground
    exact = absolute(P, TIMES, lambda _: (0.0, 0.0), _multisine, start=at_rest)[row]
    told = {"ground": angle, "ground_quantity": "displacement", "quantity": quantity}
    y = Model().simulate(P, TIMES, inputs=Inputs.measured(TIMES, **told), quantity=quantity).y[0]
    closeness = 3e-4 if quantity == "acceleration" else 1e-4  # where friction turns round the spline shows
    assert np.abs(y - exact).max() < closeness * np.abs(exact).max()
    if quantity != "acceleration":
        seen = Inputs.measured(TIMES, **told, frame="ground")
        y = Model().simulate(P, TIMES, inputs=seen, quantity=quantity).y[0]
        beside = exact - (speed if quantity == "velocity" else angle)
        assert np.abs(y - beside).max() < 1e-4 * np.abs(beside).max()


def test_readings_have_a_clock_of_their_own():
    """Uneven readings, fewer than those of the input, that begin after it and stop before."""
    torque1, torque2, _ = series()
    rng = np.random.default_rng(4)
    times = np.sort(rng.choice(TIMES[20:230], 60, replace=False) + 2e-4 * rng.uniform(size=60))
    state = (0.05, -0.02, 1.0, 2.0)
    first, second = between(TIMES, torque1, False), between(TIMES, torque2, False)
    inside = TIMES[(times[0] < TIMES) & (times[-1] > TIMES)]
    exact = absolute(P, times, lambda t: (first(t), second(t)), lambda _: (0.0, 0.0), start=state, knots=inside)
    rig = P | dict(zip(("theta0", "theta2_0", "omega1_0", "omega2_0"), state, strict=True)) | {"delay": times[0]}
    y = Model().simulate(rig, times, inputs=Inputs.measured(TIMES, torque1, torque2)).y[0]
    assert np.abs(y - exact[0]).max() < 1e-4 * np.abs(exact[0]).max()


def test_an_effect_sees_angles_counted_from_the_ground():
    _, _, ground = series()
    cubic = all_effects()["spring_cubic"].variants[0]
    moved = motion_of(TIMES, ground, False)
    size = 900.0
    exact = absolute(P, TIMES, lambda _: (0.0, 0.0), moved, cubic=size)[0]
    without = absolute(P, TIMES, lambda _: (0.0, 0.0), moved)[0]
    y = Model(effect=cubic).simulate(
        P, TIMES, effect={cubic.parameters[0].name: size}, inputs=Inputs.measured(TIMES, ground=ground)
    ).y[0]  # fmt: skip
    assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max() < 1e-2 * np.abs(without - exact).max()


def test_a_sensor_that_lags_shows_what_was_there_before():
    """The input stays on the record's clock, unlike the release of a free decay."""
    p = P | {"mu": 0.0, "drag": 0.0}
    delay = all_effects()["sensor_delay"].variants[0]
    names = [p.name for p in delay.parameters]
    t = np.arange(0.0, 0.5, 1e-3)
    torque = 0.2 * np.sin(40.0 * t)
    lag = 0.0031
    late = Model(effect=delay).simulate(p, t, effect=dict.fromkeys(names, lag), torque=torque).y[0]
    fine = np.union1d(t, np.round(t - lag, 7)[t > lag])
    there = Model().simulate(p, fine, inputs=Inputs.measured(t, torque)).y[0]
    lagging = [c for c in range(2) if np.abs(late[c] - Model().simulate(p, t, torque=torque).y[0, c]).max() > 1e-3]
    assert lagging
    for c in lagging:
        wanted = np.interp(t[10:] - lag, fine, there[c])
        assert np.abs(late[c, 10:] - wanted).max() < 2e-4 * np.abs(wanted).max()


def moved(p, times, motion, torque2, coupled=True, apart=(0.0, 0.0), cubic=0.0, sine=False, knots=None):
    """Reaction on a primary that moves as prescribed, and the secondary's acceleration, speed and angle: (n,), (3, n).

    motion : t -> angle, speed, acceleration; apart : what the secondary's angle and speed are ahead of it at first.
    """

    def parts(t, x):
        (th1, w1, a1), (th2, w2) = motion(t), x
        restoring = p["k1t"] * (math.sin(th1) if sine else th1) + cubic * th1**3
        own = p["c1t"] * w1 + restoring + p["drag"] * math.tanh(p["nu"] * w1)
        if not coupled:
            return p["J1"] * a1 + own, 0.0
        pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(th1 - th2) / (2.0 * p["r"]))
        joint = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2) + p["mu"] * pull * p["R"] * math.tanh(p["nu"] * (w1 - w2))
        held = p["c3t"] * w2 + p["k3t"] * (math.sin(th2) if sine else th2) + p["drag"] * math.tanh(p["nu"] * w2)
        a2 = (torque2(t) + joint - held - p["J12"] * a1) / p["J2"]
        return p["J1"] * a1 + p["J12"] * a2 + own + joint, a2

    th1, w1, _ = motion(times[0])
    x = np.array([th1 + apart[0], w1 + apart[1]])
    reaction, second = np.empty(times.size), np.empty((3, times.size))
    for k, t in enumerate(times):
        reaction[k], a2 = parts(t + 1e-12, x)
        second[:, k] = a2, x[1], x[0]
        inside = [] if k + 1 == times.size else np.union1d([t, times[k + 1]], knots if knots is not None else [])
        inside = [u for u in inside if t <= u <= times[min(k + 1, times.size - 1)]]
        for u, v in itertools.pairwise(inside):
            span = (u + 1e-12, v - 1e-12)
            x = solve_ivp(lambda s, y: [y[1], parts(s, y)[1]], span, x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return reaction, second


def _swept(t):
    """A prescribed sweep, by its formula: angle, speed, acceleration."""
    rate, phase = 2.0 * np.pi * (2.0 + 16.0 * t), 2.0 * np.pi * (2.0 + 8.0 * t) * t
    bend = 2.0 * np.pi * 16.0
    return 0.1 * np.sin(phase), 0.1 * rate * np.cos(phase), 0.1 * (bend * np.cos(phase) - rate**2 * np.sin(phase))


@pytest.mark.parametrize(("quantity", "row"), [("acceleration", 0), ("velocity", 1), ("displacement", 2)])
@pytest.mark.parametrize("coupled", [True, False])
def test_a_primary_that_is_moved_needs_the_torque_that_its_equation_says(quantity, row, coupled):
    torque2 = between(TIMES, series()[1], False) if coupled else (lambda _: 0.0)
    given = series()[1] if coupled else None
    reaction, second = moved(P, TIMES, _swept, torque2, coupled, (0.02, -0.5))
    rig = P | {"theta0": 0.3, "theta2_0": 0.32, "omega1_0": 1.0, "omega2_0": 0.5, "delay": -1.0}  # differences count
    inputs = Inputs.measured(TIMES, None, given, motion=_swept(TIMES)[0])
    y = Model(coupled=coupled).simulate(rig, TIMES, inputs=inputs, quantity=quantity).y[0]
    inner = slice(3, -3)  # at both ends a spline's second derivative is off
    assert np.abs(y[0] - reaction)[inner].max() < 3e-4 * np.abs(reaction).max()
    if coupled:
        assert np.abs(y[1] - second[row])[inner].max() < 3e-4 * np.abs(second[row]).max()


@pytest.mark.parametrize("held", [False, True])
def test_a_prescribed_acceleration_is_exact_between_its_samples(held):
    ground = series()[2]
    angle = motion_of(TIMES, ground, held)
    acceleration = between(TIMES, ground, held)
    reaction, second = moved(P, TIMES, lambda t: (*angle(t), acceleration(t)), lambda _: 0.0)
    inputs = Inputs.measured(TIMES, motion=ground, motion_quantity="acceleration", held=held)
    y = Model().simulate(P, TIMES, inputs=inputs, tolerance=0.1).y[0]
    assert np.abs(y[0] - reaction).max() < 1e-5 * np.abs(reaction).max()
    assert np.abs(y[1] - second[0]).max() < 1e-5 * np.abs(second[0]).max()
    per_inertia = replace(inputs, unit=P["J1"])
    assert np.allclose(Model().simulate(P, TIMES, inputs=per_inertia, tolerance=0.1).y[0, 0], y[0] / P["J1"])


def test_readings_of_a_moved_primary_may_begin_late_and_be_few():
    times = TIMES[20:230:7] + 3e-4
    angle = motion_of(TIMES, series()[2], False)
    acceleration = between(TIMES, series()[2], False)
    reaction, second = moved(P, times, lambda t: (*angle(t), acceleration(t)), lambda _: 0.0, knots=TIMES)
    y = Model().simulate(P, times, inputs=Inputs.measured(TIMES, motion=series()[2], motion_quantity="acceleration"))
    assert np.abs(y.y[0, 0] - reaction).max() < 1e-4 * np.abs(reaction).max()
    assert np.abs(y.y[0, 1] - second[0]).max() < 1e-4 * np.abs(second[0]).max()


def test_a_moved_pendulum_and_an_effect_in_its_spring():
    cubic = all_effects()["spring_cubic"].variants[0]
    size = 900.0
    angle = motion_of(TIMES, series()[2], False)
    acceleration = between(TIMES, series()[2], False)
    reaction, second = moved(
        P, TIMES, lambda t: (*angle(t), acceleration(t)), lambda _: 0.0, cubic=size, sine=True
    )  # fmt: skip
    inputs = Inputs.measured(TIMES, motion=series()[2], motion_quantity="acceleration")
    model = Model(effect=cubic, restoring="pendulum")
    y = model.simulate(P, TIMES, effect={cubic.parameters[0].name: size}, inputs=inputs).y[0]
    assert np.abs(y[0] - reaction).max() < 1e-4 * np.abs(reaction).max()
    assert np.abs(y[1] - second[0]).max() < 1e-4 * np.abs(second[0]).max()


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("coupled", [True, False])
def test_a_pendulum_on_a_pivot_that_is_moved_sideways(held, coupled):
    """Against Lagrange's equations of a bob whose pivot moves: m l (l th'' + g sin th + x'' cos th) = torques."""
    rng = np.random.default_rng(6)
    pushed = 6.0 * np.sin(20.0 * TIMES) + rng.normal(size=TIMES.size)
    across, gravity = between(TIMES, pushed, held), 9.80665
    p = P | {"k1t": 10.2, "k3t": 3.0}

    def rates(t, x):
        th1, th2, w1, w2 = x
        tau1 = -p["c1t"] * w1 - p["drag"] * math.tanh(p["nu"] * w1)
        tau1 -= p["k1t"] / gravity * (gravity * math.sin(th1) + across(t) * math.cos(th1))
        if not coupled:
            return [w1, 0.0, tau1 / p["J1"], 0.0]
        tau2 = -p["c3t"] * w2 - p["drag"] * math.tanh(p["nu"] * w2)
        tau2 -= p["k3t"] / gravity * (gravity * math.sin(th2) + across(t) * math.cos(th2))
        pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(th1 - th2) / (2.0 * p["r"]))
        joint = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2) + p["mu"] * pull * p["R"] * math.tanh(p["nu"] * (w1 - w2))
        return [w1, w2, *np.linalg.solve([[p["J1"], p["J12"]], [p["J12"], p["J2"]]], [tau1 - joint, tau2 + joint])]

    x = np.array([0.6, 0.6, 0.0, 0.0])
    exact = np.empty((3, 2, TIMES.size))
    for k, t in enumerate(TIMES):
        exact[:, :, k] = rates(t + 1e-12, x)[2:], x[2:], x[:2]
        if k + 1 < TIMES.size:
            x = solve_ivp(rates, (t + 1e-12, TIMES[k + 1] - 1e-12), x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    rig = p | {"theta0": 0.6, "theta2_0": 0.6}
    inputs = Inputs.measured(TIMES, pivot=pushed, held=held)
    model = Model(coupled=coupled, restoring="pendulum")
    for row, quantity in enumerate(QUANTITIES):
        y = model.simulate(rig, TIMES, inputs=inputs, quantity=quantity, tolerance=0.1).y[0]
        wanted = exact[row, : 1 + coupled]
        assert np.abs(y - wanted).max() < 2e-5 * np.abs(wanted).max(), quantity


def test_what_cannot_be_driven_is_refused():
    with pytest.raises(ValueError, match="keep one"):
        Inputs.measured(TIMES, motion=TIMES, pivot=TIMES)
    with pytest.raises(ValueError, match='needs restoring = "pendulum"'):
        Model().simulate(P, TIMES, inputs=Inputs.measured(TIMES, pivot=TIMES))
    with pytest.raises(ValueError, match="jump"):
        Inputs.measured(TIMES, motion=TIMES, held=True)
    with pytest.raises(ValueError, match="keep one"):
        Inputs.measured(TIMES, TIMES, motion=TIMES)
    with pytest.raises(ValueError, match="jump"):
        Inputs.measured(TIMES, ground=TIMES, ground_quantity="displacement", held=True)
    with pytest.raises(ValueError, match="one value per sample"):
        Inputs.measured(TIMES, np.zeros(3))
    with pytest.raises(ValueError, match="gravity"):
        Model(restoring="pendulum").simulate(P, TIMES, inputs=Inputs.measured(TIMES, ground=TIMES))
    with pytest.raises(ValueError, match="both"):
        Model().simulate(P, TIMES, torque=TIMES, inputs=Inputs.measured(TIMES, TIMES))
