"""The model as its callers see it: inputs, readings, failures, and independence of batch, order and threads."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_damper.effects import EFFECTS
from bayes_damper.runs.parallel_map import can_fork, forked_map
from bayes_damper.runs.threads import kernel_threads, threads_allowed
from bayes_damper.simulation.model import Model
from bayes_damper.simulation.outcome import Outcome

TIMES = np.arange(0.0, 0.1005, 1e-3)


def _table(n, seed=1):
    return reference.BASE | reference.draw(n, seed)


def _take(parameters, index):
    return {k: np.asarray(v)[index] if np.ndim(v) else v for k, v in parameters.items()}


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 40), threads=st.sampled_from([1, 2]))
def test_a_record_is_bitwise_the_same_alone_in_any_batch_and_in_any_order(seed, n, threads):
    everything = _table(40)
    whole = Model().simulate(everything, TIMES).y
    chosen = np.random.default_rng(seed).permutation(40)[:n]
    with kernel_threads(threads):
        alone = Model().simulate(_take(everything, chosen), TIMES).y
    np.testing.assert_array_equal(alone, whole[chosen])


@pytest.mark.skipif(not can_fork(), reason="this system cannot fork")
def test_a_forked_process_integrates_in_one_thread_of_its_own():
    everything = _table(40)
    with kernel_threads(2):
        here = Model().simulate(everything, TIMES).y
        apart = forked_map(lambda _: (threads_allowed(), Model().simulate(everything, TIMES).y), [0, 1], 2)
        assert threads_allowed() == 2
    assert threads_allowed() == 1
    for threads, there in apart:
        assert threads == 1
        np.testing.assert_array_equal(there, here)


def test_delays_of_others_do_not_touch_a_record():
    everything = _table(20) | {"delay": np.linspace(-4e-3, 4e-3, 20)}
    whole = Model().simulate(everything, TIMES).y
    for one in (0, 9, 19):
        np.testing.assert_array_equal(Model().simulate(_take(everything, [one]), TIMES).y[0], whole[one])


@pytest.mark.parametrize("quantity", ["acceleration", "displacement"])
@pytest.mark.parametrize("formula", [None, EFFECTS["sensor_bandwidth"].variants[0]], ids=["bare", "filter"])
def test_each_vector_may_have_a_clock_of_its_own(formula, quantity):
    """Bitwise what it has alone, also where it begins before its release and others after theirs."""
    rng, n = np.random.default_rng(3), 21
    everything = _table(n) | {"delay": rng.uniform(-4e-3, 4e-3, n)}
    times = TIMES + 3e-4 * rng.uniform(-1.0, 1.0, (n, TIMES.size)) + rng.choice([0.0, 3e-3], (n, 1))
    given = {"effect": None if formula is None else {"time": 2e-3}, "quantity": quantity}
    whole = Model(effect=formula).simulate(everything, times, **given).y
    for k in range(n):
        alone = Model(effect=formula).simulate(_take(everything, [k]), times[k], **given).y[0]
        np.testing.assert_array_equal(whole[k], alone)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["k1t", "nu", "theta0", "delay"])
def test_what_is_not_finite_is_a_counted_failure_and_harms_no_neighbour(name, bad):
    good = _table(3) | {"delay": np.zeros(3)}
    spoiled = {k: np.array(np.broadcast_to(v, 3), float) for k, v in good.items()}
    spoiled[name][1] = bad
    result = Model().simulate(spoiled, TIMES)
    assert result.outcome.tolist() == [Outcome.COMPLETED, Outcome.NOT_FINITE_INPUT, Outcome.COMPLETED]
    assert np.isnan(result.y[1]).all()
    np.testing.assert_array_equal(result.y[[0, 2]], Model().simulate(good, TIMES).y[[0, 2]])


@pytest.mark.parametrize(("name", "value"), [("J1", 0.0), ("J2", -1.0), ("nu", 0.0), ("r", 0.0)])
def test_what_no_rig_can_have_is_a_counted_failure(name, value):
    result = Model().simulate(reference.BASE | {name: value}, TIMES)
    assert result.outcome.tolist() == [Outcome.NOT_FINITE_INPUT]


def test_motion_without_bound_is_a_counted_failure():
    result = Model().simulate(reference.BASE | {"c1t": np.array([-200.0, 0.01])}, np.arange(0.0, 2.0, 1e-3))
    assert result.outcome[1] == Outcome.COMPLETED
    assert result.outcome[0] in (Outcome.NOT_FINITE_RECORD, Outcome.STEP_UNDERFLOW)
    assert np.isnan(result.y[0]).all()
    assert np.isfinite(result.y[1]).all()


def test_shapes_and_defaults():
    result = Model().simulate(_table(5), TIMES)
    assert result.y.shape == (5, 2, TIMES.size)
    assert Model(coupled=False).simulate(
        {k: reference.BASE[k] for k in ("J1", "k1t", "c1t", "drag", "nu", "theta0")}, [0.0]
    ).y.shape == (1, 1, 1)


def test_faulty_calls_are_refused():
    with pytest.raises(KeyError, match="needs"):
        Model().simulate({"J1": 1.0}, TIMES)
    with pytest.raises(ValueError, match="unknown parameter"):
        Model().simulate(reference.BASE | {"k9": 1.0}, TIMES)
    with pytest.raises(ValueError, match="increase"):
        Model().simulate(reference.BASE, [0.0, 0.0])
    with pytest.raises(ValueError, match="one torque per sample"):
        Model().simulate(reference.BASE, TIMES, torque=np.zeros(3))
    with pytest.raises(ValueError, match="one clock"):
        Model().simulate(reference.BASE, np.stack([TIMES, TIMES]), torque=np.zeros(TIMES.size))
    with pytest.raises(ValueError, match="no effect"):
        Model().simulate(reference.BASE, TIMES, effect={"a": 1.0})


@pytest.mark.parametrize("delay", [0.0103, 0.010, -0.0041, 0.00037])
def test_a_delay_shifts_the_record_and_the_rig_is_held_before(delay):
    y = Model().simulate(reference.BASE | {"delay": delay}, TIMES).y[0]
    after = delay <= TIMES
    shifted = reference.solve(
        {}, np.concatenate([[0.0], TIMES[after] - delay]) if delay not in (0.0, 0.010) else TIMES[after] - delay
    )[0]
    expected = shifted[:, -after.sum() :]
    assert np.abs(y[:, after] - expected).max() < 1e-4 * np.abs(expected).max()
    assert (y[:, ~after] == 0.0).all()


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_velocity_and_displacement_are_read(quantity):
    y = Model().simulate(reference.BASE | {"delay": 0.0103}, TIMES, quantity=quantity).y[0]
    after = TIMES >= 0.0103
    row = {"velocity": 1, "displacement": 2}[quantity]
    expected = reference.solve({}, np.concatenate([[0.0], TIMES[after] - 0.0103]))[row][:, 1:]
    assert np.abs(y[:, after] - expected).max() < 2e-5 * np.abs(expected).max()
    np.testing.assert_array_equal(y[:, ~after], reference.BASE["theta0"] if quantity == "displacement" else 0.0)


@pytest.mark.parametrize(
    ("effect", "formula", "values", "shown"),
    [
        ("sensor_gain", "channel1", {"error": 0.05}, 1.05),
        ("sensor_clipping", "both", {"level": 0.6 * reference.BASE["theta0"]}, 0.6),
        ("sensor_bandwidth", "both", {"time": 3e-3}, 1.0),
        ("sensor_highpass", "both", {"rate": 4.0}, 1.0),
    ],
)
def test_sensors_show_a_rig_that_is_held_as_they_show_everything(effect, formula, values, shown):
    """A wrong scale is there before the release too: 25 sd of one such reading hid gains of 5 %."""
    model = Model(effect=EFFECTS[effect].variant(formula))
    y = model.simulate(reference.BASE | {"delay": 0.0103}, TIMES, effect=values, quantity="displacement").y[0]
    np.testing.assert_allclose(y[0, TIMES < 0.0103], shown * reference.BASE["theta0"], rtol=1e-9)


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("quantity", ["acceleration", "displacement"])
def test_a_release_that_takes_its_time_is_that_of_a_torque_that_falls(coupled, quantity):
    """Against the effect of that formula, whose torque comes from a kernel of its own."""
    falling = Model(coupled, effect=EFFECTS["release_ramp"].variant("linear"))
    time = np.array([0.0, 4e-4, 3e-3, 7e-3])
    rig = _take(_table(4), 0) | {"delay": 3.1e-4}
    found = Model(coupled).simulate(rig | {"release_time": time}, TIMES, quantity=quantity).y
    expected = falling.simulate(rig, TIMES, effect={"time": time}, quantity=quantity).y
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max(), rtol=0.0)
    assert np.abs(found[3] - found[0]).max() > 0.05 * np.abs(expected).max()
    np.testing.assert_array_equal(found[0], Model(coupled).simulate(rig, TIMES, quantity=quantity).y[0])


def test_a_pendulum_is_held_by_its_own_torque():
    """At the release nothing accelerates it, also where sin(theta0) is far from theta0."""
    rig = _take(_table(1), 0) | {"theta0": 1.2, "theta2_0": 1.2, "release_time": 0.01}
    y = Model(False, restoring="pendulum").simulate(rig, np.array([0.0, 5e-3])).y[0, 0]
    assert abs(y[0]) < 2e-4 * rig["k1t"] / rig["J1"]
    assert abs(y[1] + 0.5 * np.sin(1.2) * rig["k1t"] / rig["J1"]) < 0.05 * rig["k1t"] / rig["J1"]
