"""The integrator against theory, against an independent solution, and against its own promises."""

from __future__ import annotations

import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
import reference
from compiled import without_kernels
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bayes_damper.effects.base import EffectParameter, Variant
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig import equations, vector_math
from bayes_damper.simulation import integrator, specialised
from bayes_damper.simulation.integrator import LANES
from bayes_damper.simulation.model import Model

SECOND = np.arange(0.0, 1.0005, 1e-3)
SHORT = np.arange(0.0, 0.1505, 1e-3)
LINEAR = reference.BASE | {"mu": 0.0, "drag": 0.0}
COEFFICIENT = EffectParameter("k", "1", "its size", Normal(0.0, 1.0), "a toy", null=0.0)


def _one(parameters, number):
    return {k: float(v[number]) if np.ndim(v) else v for k, v in parameters.items()}


def _state_space(p, coupled=True):
    J = np.array([[p["J1"], p["J12"]], [p["J12"], p["J2"]]])
    K = np.array([[p["k1t"] + p["k2t"], -p["k2t"]], [-p["k2t"], p["k3t"] + p["k2t"]]])
    C = np.array([[p["c1t"] + p["c2t"], -p["c2t"]], [-p["c2t"], p["c3t"] + p["c2t"]]])
    inverse = np.linalg.inv(J)
    return np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ K, -inverse @ C]])


# Closed forms -------------------------------------------------------------------------------------------------------


def test_one_degree_of_freedom_follows_the_closed_form():
    p = {"J1": 3e-3, "k1t": 8.0, "c1t": 0.02, "drag": 0.0, "nu": 50.0, "theta0": 0.08}
    y = Model(coupled=False).simulate(p, SECOND, quantity="displacement").y[0, 0]
    decay, omega0 = 0.02 / 6e-3, np.sqrt(8.0 / 3e-3)
    omega = np.sqrt(omega0**2 - decay**2)
    exact = 0.08 * np.exp(-decay * SECOND) * (np.cos(omega * SECOND) + decay / omega * np.sin(omega * SECOND))
    assert np.abs(y - exact).max() < 2e-5 * 0.08


@pytest.mark.parametrize("extra", [{}, {"J12": 8e-4, "k3t": 2.0}])
def test_the_linear_rig_follows_the_matrix_exponential(extra):
    p = LINEAR | extra
    y = Model().simulate(p, SECOND, tolerance=0.01).y[0]
    A = _state_space(p)
    step, x = expm(A * 1e-3), np.array([p["theta0"], p["theta0"], 0.0, 0.0])
    exact = np.empty_like(y)
    for i in range(SECOND.size):
        exact[:, i] = (A @ x)[2:]
        x = step @ x
    assert np.abs(y - exact).max() < 1e-6 * np.abs(exact).max()


def test_the_order_of_convergence_is_four():
    # A tolerance that never binds leaves the steps to the sample interval, below 1 ms.
    p = LINEAR | {"k1t": 300.0, "k2t": 120.0}
    A = _state_space(p)
    exact = (A @ expm(A * 0.05) @ np.array([p["theta0"], p["theta0"], 0.0, 0.0]))[2:]
    errors = []
    for parts in (1, 2, 4, 8):
        times = np.linspace(0.0, 0.05, 50 * parts + 1)
        y = Model().simulate(p, times, tolerance=1e9).y[0]
        errors.append(np.abs(y[:, -1] - exact).max())
    slopes = -np.diff(np.log2(errors))
    assert 3.6 < slopes[-1] < 4.6, (errors, slopes)
    assert errors[0] > 100.0 * errors[-1]


def test_the_error_falls_in_step_with_the_tolerance():
    p = reference.BASE | {"nu": 60.0}
    exact = reference.solve({"nu": 60.0}, SHORT)[0]
    tolerances = np.array([100.0, 10.0, 1.0, 0.1, 0.01])
    errors = [np.sqrt(np.mean((Model().simulate(p, SHORT, tolerance=x).y[0] - exact) ** 2)) for x in tolerances]
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.6 < slope < 1.3, (errors, slope)


@pytest.mark.parametrize("other", [1.0, 2.5])
def test_energy_lost_is_the_work_of_friction(other):
    p = reference.BASE | {"nu": 30.0, "drag_ratio": other}
    model = Model()
    th1, th2 = model.simulate(p, SECOND, quantity="displacement", tolerance=0.1).y[0]
    w1, w2 = model.simulate(p, SECOND, quantity="velocity", tolerance=0.1).y[0]
    energy = 0.5 * (p["J1"] * w1**2 + p["J2"] * w2**2 + p["k1t"] * th1**2 + p["k2t"] * (th1 - th2) ** 2)
    pull = np.maximum(0.0, 1.0 - p["R"] * np.abs(th1 - th2) / (2.0 * p["r"]))
    slip = w1 - w2
    power = p["c1t"] * w1**2 + p["c3t"] * w2**2 + p["c2t"] * slip**2
    power += p["drag"] * (w1 * np.tanh(p["nu"] * w1) + other * w2 * np.tanh(p["nu"] * w2))
    power += p["mu"] * p["N0"] * p["R"] * pull * slip * np.tanh(p["nu"] * slip)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * 1e-3)])
    assert np.abs(energy + work - energy[0]).max() < 2e-3 * energy[0]
    assert (np.diff(energy) <= 1e-9 * energy[0]).all()
    assert energy[-1] < 0.2 * energy[0]


# Accuracy -----------------------------------------------------------------------------------------------------------


def test_the_reference_itself_agrees_with_scipy():
    for parameters in ({"nu": 20.0}, {"nu": 400.0, "J12": 5e-4, "k3t": 1.0}):
        q = np.array([(reference.BASE | parameters)[name] for name in reference.NAMES])
        ours = reference.solve(parameters, SHORT[:41])[0]
        x = np.array([q[-1], q[-1], 0.0, 0.0])

        def rates(t, x, q=q):
            a1, a2 = reference._forces(q, x, 0.0, True, True, False)
            return [x[2], x[3], a1, a2]

        for i in range(40):
            assert np.abs(np.array(rates(0, x))[2:] - ours[:, i]).max() < 1e-6 * np.abs(ours).max()
            x = solve_ivp(rates, (0.0, 1e-3), x, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def _errors(law, table, times, **options):
    n = table["nu"].size
    y = Model(normal_force=law).simulate(reference.BASE | table, times, **options).y
    exact = np.array([reference.solve(_one(table, i), times, linear=law == "linear")[0] for i in range(n)])
    return np.abs(y - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2)), y - exact


@pytest.mark.parametrize("tail", [0.0, 0.9])
@pytest.mark.parametrize("law", ["linear", "constant"])
def test_errors_stay_below_1e_4_of_the_peak(law, tail):
    table = reference.draw(16, 11) | {"tail": np.full(16, tail)}
    assert _errors(law, table, SHORT)[0].max() < 1e-4
    # The curves other than tanh are fitted to 1.3e-5 of the friction, which is up to twice the peak torque of a spring.
    assert _errors(law, table, SHORT, tolerance=0.1)[0].max() < (4e-5 if tail else 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["linear", "constant"])
def test_errors_stay_below_1e_4_of_the_peak_over_whole_records(law):
    table = reference.draw(12, 21)
    errors, difference = _errors(law, table, SECOND)
    noise = np.random.default_rng(5).normal(0.0, 2.0, difference.shape)
    change = ((noise + difference) ** 2 - noise**2).sum(axis=(1, 2)) / 8.0
    assert errors.max() < 1e-4
    assert np.abs(change).max() < 0.1  # of the log likelihood with 2 rad/s^2 of noise
    assert _errors(law, table, SECOND, tolerance=0.1)[0].max() < 1e-5


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    nu=st.floats(5.0, 3000.0), mu=st.floats(0.0, 0.02), drag=st.floats(0.0, 0.03), k2t=st.floats(0.0, 3.0),
    c2t=st.floats(0.0, 0.12), k1t=st.floats(5.0, 12.0), degrees=st.floats(1.0, 8.0), law=st.booleans(),
)  # fmt: skip
def test_no_vector_that_a_search_finds_breaks_the_bound(nu, mu, drag, k2t, c2t, k1t, degrees, law):
    p = {"nu": nu, "mu": mu, "drag": drag, "k2t": k2t, "c2t": c2t, "k1t": k1t, "theta0": np.radians(degrees)}
    times = SHORT[:81]
    y = Model(normal_force="linear" if law else "constant").simulate(reference.BASE | p, times).y[0]
    exact = reference.solve(p, times, linear=law)[0]
    assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("nu", [5.0, 3000.0])
@pytest.mark.parametrize("law", ["linear", "constant"])
def test_edges_of_the_prior(nu, law):
    for mu, drag, c2t in ((0.0, 0.03, 0.0), (0.02, 0.0, 0.12), (0.02, 0.03, 0.0)):
        p = {"nu": nu, "mu": mu, "drag": drag, "c2t": c2t}
        y = Model(normal_force=law).simulate(reference.BASE | p, SHORT[:81]).y[0]
        exact = reference.solve(p, SHORT[:81], linear=law == "linear")[0]
        assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()


def test_the_stiff_stick_phase_keeps_the_bodies_together():
    # Friction far above what the spring can ask for: both turn as one inertia, and an explicit step would need < 1 us.
    p = LINEAR | {"mu": 0.3, "k2t": 0.0, "c2t": 0.0, "nu": 3000.0, "c1t": 0.0, "c3t": 0.0}
    model = Model(normal_force="constant")
    start = time.process_time()
    y = model.simulate(p, SECOND, quantity="displacement").y[0]
    assert time.process_time() - start < 20.0  # including compiling; not the minutes of a step bound by stability
    exact = p["theta0"] * np.cos(np.sqrt(p["k1t"] / (p["J1"] + p["J2"])) * SECOND)
    assert np.abs(y[0] - exact).max() < 5e-3 * p["theta0"]
    assert np.abs(y[0] - y[1]).max() < 5e-3 * p["theta0"]


def test_a_start_at_the_kink_of_the_pull_and_one_beside_it_agree():
    # th1 = th2 at rest sits on the kink of N(phi) = 1 - R |phi| / (2 r).
    on = Model().simulate(reference.BASE, SHORT).y[0]
    exact = reference.solve({}, SHORT)[0]
    beside = Model().simulate(reference.BASE | {"theta2_0": reference.BASE["theta0"] * (1.0 + 1e-9)}, SHORT).y[0]
    assert np.abs(on - exact).max() < 1e-4 * np.abs(exact).max()
    assert np.abs(on - beside).max() < 1e-5 * np.abs(exact).max()


# Options ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{"coupled": True}, {"coupled": False}])
def test_pendulum_and_inertial_coupling(options):
    p = {"k1t": 9.0, "k3t": 2.0, "J12": 6e-4, "theta0": 1.2, "nu": 50.0, "k2t": 0.3}
    coupled = options["coupled"]
    y = Model(restoring="pendulum", **options).simulate(reference.BASE | p, SHORT).y[0]
    exact = reference.solve(p, SHORT, pendulum=True, **options)[0][: y.shape[0]]
    assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()
    assert np.abs(y - Model(**options).simulate(reference.BASE | p, SHORT).y[0]).max() > 0.05 * np.abs(exact).max()
    assert y.shape[0] == 1 + coupled


@pytest.mark.parametrize("coupled", [True, False])
def test_an_input_torque_acts_linearly_between_samples(coupled):
    torque = 0.3 * np.sin(60.0 * SHORT) + 0.05 * np.random.default_rng(2).normal(size=SHORT.size)
    p = {"theta0": 0.0}
    y = Model(coupled=coupled).simulate(reference.BASE | p, SHORT, torque=torque).y[0]
    exact = reference.solve(p, SHORT, coupled=coupled, torque=torque)[0][: y.shape[0]]
    assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()


def test_uneven_times_and_long_intervals():
    rng = np.random.default_rng(8)
    uneven = np.concatenate([[0.0], np.cumsum(rng.uniform(1e-5, 3e-3, 90))])
    every31ms = np.arange(0.0, 0.3, 31e-3)
    for times in (uneven, every31ms):
        y = Model().simulate(reference.BASE | {"nu": 300.0}, times).y[0]
        exact = reference.solve({"nu": 300.0}, times)[0]
        assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()


def test_initial_velocities_and_angles():
    start = [0.05, -0.03, 1.0, -2.0]
    names = ("theta0", "theta2_0", "omega1_0", "omega2_0")
    y = Model().simulate(reference.BASE | dict(zip(names, start, strict=True)), SHORT).y[0]
    exact = reference.solve({}, SHORT, start=start)[0]
    assert np.abs(y - exact).max() < 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("coupled", [True, False])
def test_compiled_and_plain_python_agree(coupled):
    bound = specialised.specialised_globals(coupled, True, False, False, None)
    n, rows = 6, []
    for name in equations.ROWS:
        value = {"theta2_0": reference.BASE["theta0"]}.get(name, reference.BASE.get(name, 0.0))
        rows.append(np.full(LANES, value))
    results = []
    for compile_it in (True, False):
        advance = specialised.specialise(
            bound
            if compile_it
            else bound | {n: getattr(integrator, n).py_func for n in ("effect_torque", "effect_rate")},
            compile=compile_it,
        )
        out, final, status = np.empty((LANES, 2, n + 1)), np.empty(LANES), np.empty(LANES, np.int64)
        advance(
            SHORT[None, :n], np.array(rows), np.zeros((12, LANES)), np.zeros((8, n)), np.ones(LANES), np.zeros(2),
            integrator.LONGEST_STEP, np.array([1.0, 0.0, 0.0]), out, final, status,
        )  # fmt: skip
        results.append(out[:, : 1 + coupled, :n])
    np.testing.assert_allclose(results[0], results[1], rtol=1e-9, atol=1e-9)


# Effects' hooks, with toys whose answer is known --------------------------------------------------------------------


@vector_math.lane
def _cubic(t, th1, th2, w1, w2, z1, z2, p, rig):
    return -p[0] * th1 * th1 * th1 - 1e-4 * p[0] * w1 * w1 * w1, -1e-4 * p[0] * th2 * w2 * w2 * w2


@vector_math.lane
def _arm_torque(t, th1, th2, w1, w2, z1, z2, p, rig):
    return -z1, z1


@vector_math.lane
def _arm_rate(t, th1, th2, w1, w2, z1, z2, p, rig):
    return p[0] * (w1 - w2) - z1 / 0.004, 0.0


@vector_math.lane
def _low_pass(h, u1, u2, y1, y2, s1, s2, p, first):
    # Exact answer of p s' = y - s to a y that is linear between readings.
    e = vector_math.exp(-h / p[0])
    share = (1.0 - e) * p[0] / max(h, 1e-12)
    m1 = u1 if first > 0.5 else e * s1 + (share - e) * u1 + (1.0 - share) * y1
    m1 = m1 if h > 0.0 or first > 0.5 else s1
    return m1, y2, m1, s2


CUBIC = Variant("toy_cubic", "-k th^3 - ...", (COEFFICIENT,), torque=_cubic)
ARM = Variant(
    "toy_arm", "Maxwell arm", (COEFFICIENT,), torque=_arm_torque, rate=_arm_rate, couples="interface",
    memory=1, memory_scale=(0.01,), uncoupled=False,
)  # fmt: skip
LOW_PASS = Variant("toy_low_pass", "p s' = y - s", (COEFFICIENT,), sense=_low_pass)


@vector_math.lane
def _some_torque(p, rig):
    return p[0] * rig.theta0, -0.5 * p[0]


EVERY = replace(ARM, name="toy_every", sense=_low_pass, start=_some_torque, timed=True)


def test_an_effect_that_supplies_only_its_torque_keeps_the_order_of_four():
    p = LINEAR | {"k1t": 200.0, "k2t": 60.0, "theta0": 0.3}
    model = Model(effect=CUBIC)
    errors = []

    def rates(t, x):
        tau1 = -p["c1t"] * x[2] - p["k1t"] * x[0] - 900.0 * x[0] ** 3 - 0.09 * x[2] ** 3
        T = p["k2t"] * (x[0] - x[1]) + p["c2t"] * (x[2] - x[3])
        return [x[2], x[3], (tau1 - T) / p["J1"], (T - p["c3t"] * x[3] - 0.09 * x[1] * x[3] ** 3) / p["J2"]]

    end = solve_ivp(rates, (0.0, 0.02), [0.3, 0.3, 0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    for parts in (2, 4, 8, 16):
        y = model.simulate(p, np.linspace(0.0, 0.02, 20 * parts + 1), effect={"k": 900.0}, tolerance=1e9).y[0]
        errors.append(np.abs(y[:, -1] - rates(0.0, end)[2:]).max())
    slopes = -np.diff(np.log2(errors))
    assert 3.4 < slopes[-1] < 5.0, (errors, slopes)


def test_a_memory_follows_the_exact_linear_system():
    k = 3.0
    A = np.zeros((5, 5))
    A[:4, :4] = _state_space(LINEAR)
    A[2, 4], A[3, 4] = -1.0 / LINEAR["J1"], 1.0 / LINEAR["J2"]
    A[4, 2], A[4, 3], A[4, 4] = k, -k, -1.0 / 0.004
    x, step = np.array([LINEAR["theta0"], LINEAR["theta0"], 0.0, 0.0, 0.0]), expm(A * 1e-3)
    y = Model(effect=ARM).simulate(LINEAR, SHORT, effect={"k": k}, tolerance=0.1).y[0]
    exact = np.empty_like(y)
    for i in range(SHORT.size):
        exact[:, i] = (A @ x)[2:4]
        x = step @ x
    assert np.abs(y - exact).max() < 1e-5 * np.abs(exact).max()
    assert np.abs(y - Model().simulate(LINEAR, SHORT).y[0]).max() > 0.01 * np.abs(exact).max()


def test_a_sensor_follows_the_closed_form():
    p = {"J1": 3e-3, "k1t": 8.0, "c1t": 0.0, "drag": 0.0, "nu": 50.0, "theta0": 0.08}
    y = Model(coupled=False, effect=LOW_PASS).simulate(p, SHORT, quantity="displacement", effect={"k": 0.005}).y[0, 0]
    w = np.sqrt(8.0 / 3e-3)
    steady = 0.08 / (1.0 + 0.005j * w)
    exact = (steady * np.exp(1j * w * SHORT)).real + (0.08 - steady.real) * np.exp(-SHORT / 0.005)
    assert np.abs(y - exact).max() < 5e-4 * 0.08


# Compiled code ------------------------------------------------------------------------------------------------------

_PROBE = """
import numpy as np
from bayes_damper.simulation.model import Model
model = Model(coupled=False)
y = model.simulate({"J1": 3e-3, "k1t": 8.0, "c1t": 0.01, "drag": 0.01, "nu": 50.0, "theta0": 0.08}, [0.0, 1e-3]).y
stats = model.compile().stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), y[0, 0, 1])
"""


def _probe(environment):
    result = subprocess.run(
        [sys.executable, "-c", _PROBE], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    hits, misses, reading = result.stdout.split()
    return int(hits), int(misses), float(reading)


@pytest.mark.slow
def test_a_second_process_does_not_compile_again(tmp_path):
    cache = without_kernels(tmp_path / "cache")
    first = _probe({"BAYES_DAMPER_CACHE": str(cache)})
    second = _probe({"BAYES_DAMPER_CACHE": str(cache)})
    assert first[:2] == (0, 1)
    assert second[:2] == (1, 0)
    assert first[2] == second[2]


@pytest.mark.slow
def test_a_home_that_cannot_be_written_falls_back(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    spare = without_kernels(tmp_path / f"bayes_damper-{os.getuid()}")  # that it is made: runs/test_cache_folder.py
    assert _probe({"BAYES_DAMPER_CACHE": str(blocked), "TMPDIR": str(tmp_path)})[:2] == (0, 1)
    assert len(list(spare.glob("advance_*.py"))) == 1
    assert spare.stat().st_mode & 0o77 == 0


def _block(parameters):
    given = {"drag_ratio": 1.0} | parameters
    rows = np.array([np.full(LANES, given.get(name, 0.0)) for name in equations.ROWS])
    n = SHORT.size
    return (
        *(
            SHORT[None],
            rows,
            np.full((12, LANES), 0.5),
            np.zeros((8, n)),
            np.ones(LANES),
            np.ones(2),
            integrator.LONGEST_STEP,
            np.array([1.0, 0.0, 0.0]),
        ),
        *(np.zeros((LANES, 2, n + 1)), np.zeros(LANES), np.zeros(LANES, np.int64)),
    )


def _record(kernel):
    block = _block(reference.BASE | {"theta2_0": reference.BASE["theta0"]})
    kernel(*block)
    return block[8][:, :, :-1]


BROKEN = """
import sys, warnings
import numba
numba.njit(lambda: 1.0)()  # numba has loaded all of its own
package, _, name = sys.argv[1].rpartition(".")
delattr(sys.modules[package], name)
sys.modules[sys.argv[1]] = None  # what an import of it would meet in a numba without it
from bayes_damper.simulation import specialised
from test_integrator import EVERY, _record
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    specialised.compile_common()
    kernel = specialised.specialise(specialised.specialised_globals(True, True, False, False, EVERY))
print(_record(kernel).tobytes().hex())
print(kernel.py_func.__name__, [str(w.message) for w in caught if "link" in str(w.message)])
"""


@pytest.mark.slow
def test_a_numba_without_the_internals_is_slower_and_says_so_once(tmp_path):
    """The import is broken on purpose, before the first kernel, which has all that an effect can have: results of the
    one that is compiled as a whole are those of the one that is linked, to rounding.
    """
    here = Path(__file__).parent
    environment = os.environ | {
        "BAYES_DAMPER_CACHE": str(tmp_path),
        "PYTHONPATH": os.pathsep.join(map(str, (Path(integrator.__file__).parents[2], here, here.parent))),
    }
    done = subprocess.run(
        [sys.executable, "-c", BROKEN, "numba.core.cgutils"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    record, said = done.stdout.splitlines()
    assert said.startswith("advance ")
    assert said.count("does not link kernels") == 1
    assert "cgutils" in said
    linked = specialised.specialise(specialised.specialised_globals(True, True, False, False, EVERY))
    assert linked.py_func.__name__ == "linked"
    expected = _record(linked)
    found = np.frombuffer(bytes.fromhex(record)).reshape(expected.shape)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@vector_math.lane
def _whole_numbers(t, th1, th2, w1, w2, z1, z2, p, rig):
    return 1, 0


@vector_math.lane
def _of_no_use(t, th1, th2, w1, w2, z1, z2, p, rig):
    return th1.nothing, 0.0


def test_a_torque_in_whole_numbers_is_that_torque():
    one = Variant("toy_one", "1 N m", (COEFFICIENT,), torque=_whole_numbers)
    model, driven = Model(coupled=False, effect=one), Model(coupled=False)
    p = {"J1": 3e-3, "k1t": 8.0, "c1t": 0.01, "drag": 0.0, "nu": 50.0, "theta0": 0.08}
    y = model.simulate(p, SHORT, effect={"k": 0.0}).y
    assert np.abs(y - driven.simulate(p, SHORT, torque=np.ones(SHORT.size)).y).max() < 1e-4 * np.abs(y).max()


def test_what_is_wrong_with_a_hook_is_told_at_once(monkeypatch):
    """Nothing is compiled as one piece first, which takes ten seconds."""
    specialised._common()
    asked, in_file = [], specialised._in_file
    monkeypatch.setattr(
        specialised, "_in_file", lambda f, *a, **more: asked.append(f.__name__) or in_file(f, *a, **more)
    )
    with pytest.raises(numba.TypingError, match="nothing"):
        Model(effect=Variant("toy_wrong", "?", (COEFFICIENT,), torque=_of_no_use)).compile()
    assert asked == ["linked"]


HELPER = """
from bayes_damper.rig.vector_math import lane
@lane
def grip(w):
    return 2.0 * w
"""
USER = """
from bayes_damper.rig.vector_math import lane
from grip_helper import grip
def factory(size):
    @lane
    def drag(t, th1, th2, w1, w2, z1, z2, p, rig):
        return -size * grip(w1) * rig.drag, 0.0
    return drag
"""


def test_a_kernel_is_compiled_anew_when_anything_that_it_calls_changes(tmp_path, monkeypatch):
    helper = tmp_path / "grip_helper.py"
    helper.write_text(HELPER)
    (tmp_path / "grip_user.py").write_text(USER)
    monkeypatch.syspath_prepend(tmp_path)
    user = importlib.import_module("grip_user")

    def mark(size):
        variant = Variant("grip", "size grip(w)", (), torque=user.factory(size))
        return specialised._fingerprint(specialised.specialised_globals(True, True, False, False, variant))

    before = mark(1.0)
    assert mark(1.0) == before
    assert mark(1.5) != before
    helper.write_text(HELPER.replace("2.0", "3.0"))
    assert mark(1.0) != before
    helper.write_text(HELPER)
    assert mark(1.0) == before


def test_a_file_that_is_moved_into_the_library_has_kernels_of_its_own(tmp_path, monkeypatch):
    """Machine code names the module that it is made from, which is imported where it is read from a file."""
    (tmp_path / "grip_helper.py").write_text(HELPER)
    (tmp_path / "grip_user.py").write_text(USER)
    monkeypatch.syspath_prepend(tmp_path)
    marks = []
    for name in ("bayes_damper_effect_grip", "bayes_damper.effects.grip"):
        spec = importlib.util.spec_from_file_location(name, tmp_path / "grip_user.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        variant = Variant("grip", "size grip(w)", (), torque=module.factory(1.0))
        marks.append(specialised._fingerprint(specialised.specialised_globals(True, True, False, False, variant)))
    assert marks[0] != marks[1]


def test_only_what_decides_the_machine_code_has_kernels_compiled_anew(monkeypatch):
    read = []
    monkeypatch.setattr(Path, "read_text", lambda path, **_: read.append(path.name) or "")
    specialised._fingerprint(specialised.specialised_globals(True, True, False, False, None))
    assert sorted(read) == ["equations.py", "integrator.py", "late_binding.py", "vector_math.py"]


def test_the_sources_of_a_kernel_are_read_once(monkeypatch):
    bound = Model(effect=CUBIC).bound()
    path = specialised.kernel_file(bound)
    monkeypatch.setattr(Path, "read_text", None)
    assert specialised.kernel_file(Model(effect=CUBIC).bound()) == path


def test_closures_of_one_name_and_the_same_numbers_do_not_share_a_kernel():
    def factory(size, squared):
        if squared:

            @vector_math.lane
            def drag(t, th1, th2, w1, w2, z1, z2, p, rig):
                return -size * w1 * abs(w1), 0.0
        else:

            @vector_math.lane
            def drag(t, th1, th2, w1, w2, z1, z2, p, rig):
                return -size * w1, 0.0

        return drag

    def mark(torque):
        return specialised._fingerprint(
            specialised.specialised_globals(True, True, False, False, Variant("drag", "drag", (), torque=torque))
        )

    assert mark(factory(1.0, False)) == mark(factory(1.0, False))
    assert mark(factory(1.0, False)) != mark(factory(1.0, True))


def test_rigs_share_a_kernel_whatever_their_pace():
    slow = Model(longest_step=32.0 * integrator.LONGEST_STEP)
    assert specialised.kernel_file(slow.bound()) == specialised.kernel_file(Model().bound())
    # The step is still the rig's own: a record of long intervals is another one, within the tolerance.
    times = np.arange(9) * 0.032
    parameters = reference.BASE | {"k1t": 0.01, "k2t": 0.01, "mu": 0.0, "drag": 0.0}
    y = [model.simulate(parameters, times).y for model in (Model(), slow)]
    assert not np.array_equal(y[0], y[1])
    np.testing.assert_allclose(y[1], y[0], atol=1e-4 * np.abs(y[0]).max())


@pytest.mark.slow
def test_two_copies_of_the_package_share_their_compiled_kernels(tmp_path):
    package = Path(integrator.__file__).parents[1]
    skipped = shutil.ignore_patterns("__pycache__", "_shipped")
    shutil.copytree(package, tmp_path / "copy" / "bayes_damper", ignore=skipped)
    code = (
        "from bayes_damper.simulation import specialised; from bayes_damper.effects import EFFECTS;"
        "variant = EFFECTS['stick_slip'].variants[0];"
        "print(specialised.__file__, specialised._fingerprint("
        "specialised.specialised_globals(True, True, False, False, variant)))"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(home)}, check=True, text=True,
            capture_output=True, cwd=tmp_path,
        ).stdout.split()
        for home in (tmp_path / "copy", package.parent)
    ]  # fmt: skip
    assert found[0][0] != found[1][0]
    assert found[0][1] == found[1][1]
