"""`bayes-damper bench`: accuracy and speed on this machine, beside what is installed of its peers.

Everything is timed in one run, one thread, in CPU time: repeats of all rows are interleaved and the least is kept, so
that what else the machine does moves all rows alike. Compare ratios, not microseconds. The task: accelerations of both
bodies at 1001 instants of one second, at an error below 1e-4 of the peak; peers get the loosest settings that reach it.
One row more has the same rig under a swept torque, held against scipy.
"""

from __future__ import annotations

import bayes_damper.rig.unsteered_numba  # noqa: F401

# isort: split
import inspect
import math
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import emcee
import numba
import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_damper.effects.base import MOST_PARAMETERS
from bayes_damper.errors import ExitCode
from bayes_damper.rig import equations, vector_math
from bayes_damper.rig.equations import ROWS
from bayes_damper.rig.inputs import Inputs
from bayes_damper.runs.json_files import write_json, write_text
from bayes_damper.sampling.moves import DifferentialEvolution, Snooker
from bayes_damper.simulation import integrator, specialised
from bayes_damper.simulation.integrator import LANES, LONGEST_STEP
from bayes_damper.simulation.model import Model
from bayes_damper.text import Printable
from bayes_damper.validation import bench_peers

Array = NDArray[np.float64]
SCHEMA = "bayes-damper/bench/1"
SHARPNESS = (10.0, 100.0, 1000.0)
TIMES = np.arange(1001) / 1000.0
BASE = {
    "J1": 3.015e-3,
    "J2": 2.474e-3,
    "k1t": 6.2,
    "c1t": 0.01,
    "c3t": 0.01,
    "k2t": 1.0,
    "c2t": 0.03,
    "mu": 0.009,
    "N0": 100.0,
    "R": 0.1,
    "r": 0.0127,
    "drag": 0.015,
    "nu": 100.0,
    "theta0": math.radians(5.0),
}
ERROR_BOUND = 1e-4
FIXED_TOLERANCE = 2e-7  # rad/s of velocity error a step, the yardstick of a tolerance that does not know nu
# One step of one lane of the bare coupled rig, counted in its machine code: 184 fused multiply-adds (two each), 117
# products, 97 sums and 12 divisions.
FLOPS_PER_STEP = 2 * 184 + 117 + 97 + 12
# Steps per ms of the fixed-step build that keep it below the bound at each sharpness.
_SUBSTEPS = {10.0: 4, 100.0: 16, 1000.0: 128}
_VECTORS = 64


@dataclass(frozen=True)
class Row:
    """One implementation at one sharpness: CPU time of one record, and its largest error as a share of the peak."""

    name: str
    nu: float
    microseconds: float
    error: float


@dataclass(frozen=True)
class Target:
    """A promise, and what was reached: `kept` is None where a peer is not installed."""

    name: str
    promised: float
    reached: float | None
    at_most: bool = False

    @property
    def kept(self) -> bool | None:
        if self.reached is None:
            return None
        return self.reached <= self.promised if self.at_most else self.reached >= self.promised


@dataclass(frozen=True)
class Bench(Printable):
    """What `bench` measured; `work_precision` holds points (microseconds, error) of each method at nu = 100."""

    machine: dict[str, str]
    rows: tuple[Row, ...]
    targets: tuple[Target, ...]
    missing: tuple[str, ...]
    work_precision: dict[str, list[tuple[float, float]]]
    peak_gflops: float
    kernel_gflops: float
    scaling: dict[str, list[tuple[float, float]]]
    """Total time (us) over the number of samples of 32 records, and over the number of records (trials) of 1001."""
    emcee_overhead: float
    """Time (us) that emcee spends per walker and step beside the target, 64 walkers, 6 parameters, default mix."""

    @property
    def accurate(self) -> bool:
        """Whether our own kernel kept the accuracy bound everywhere."""
        return all(target.kept is not False for target in self.targets if target.at_most and "error" in target.name)

    @property
    def exit_code(self) -> ExitCode:
        """A missed accuracy bound is a self-check that failed; a missed speed is a number in the table."""
        return ExitCode.DONE if self.accurate else ExitCode.SELF_CHECK_FAILED

    def text(self) -> str:
        """The table."""
        return self.table()

    def to_json(self) -> dict[str, Any]:
        """What bench.json holds."""
        body = asdict(self) | {
            "schema": SCHEMA,
            "targets": [asdict(target) | {"kept": target.kept} for target in self.targets],
            "accurate": self.accurate,
        }
        return {"schema": SCHEMA} | body

    def table(self) -> str:
        """Both tables as Markdown."""
        lines = [
            "| implementation | " + " | ".join(f"nu = {nu:g}" for nu in SHARPNESS) + " |",
            "| --- | --- | --- | --- |",
        ]
        own = {row.nu: row.microseconds for row in self.rows if row.name == _OWN}
        for name in dict.fromkeys(row.name for row in self.rows):
            cells = {row.nu: row for row in self.rows if row.name == name}
            shown = [
                f"{cells[nu].microseconds:.3g} us ({cells[nu].microseconds / own[nu]:.3g}x), {cells[nu].error:.0e}"
                if nu in cells
                else "-"
                for nu in SHARPNESS
            ]
            lines.append(f"| {name} | " + " | ".join(shown) + " |")
        lines += ["", "| target | promised | reached | kept |", "| --- | --- | --- | --- |"]
        for target in self.targets:
            sign = "<=" if target.at_most else ">="
            reached = "not installed" if target.reached is None else f"{target.reached:.3g}"
            kept = {True: "yes", False: "NO", None: "-"}[target.kept]
            lines.append(f"| {target.name} | {sign} {target.promised:g} | {reached} | {kept} |")
        return "\n".join(lines)


_OWN = "bayes_damper"
_FORCED = "bayes_damper, swept torque"
_SWEEP = 0.1 * np.sin(2.0 * np.pi * (2.0 + 18.0 * TIMES) * TIMES)
"""N m on the primary, from 2 to 38 Hz: through both resonances, as large as the spring's torque at the release."""


def vectors(nu: float, n: int = _VECTORS, spread: float = 0.01) -> dict[str, Any]:
    """The first n of 64 parameter vectors around the base case, as a sampler asks for them at once; one nu for all."""
    rng = np.random.default_rng(7)
    table: dict[str, Any] = {
        name: value * np.exp(spread * rng.standard_normal(_VECTORS))[:n]
        if name in ("k1t", "k2t", "c2t", "mu", "drag")
        else value
        for name, value in BASE.items()
    }
    return table | {"nu": np.full(n, nu)}


def _block(nu: float) -> tuple[Any, ...]:
    """Arguments of a kernel for one block of lanes."""
    table = vectors(nu, LANES) | dict.fromkeys(
        ("J12", "k3t", "omega1_0", "omega2_0", "delay", "release_time", "tail"), 0.0
    )
    table |= {"theta2_0": table["theta0"], "drag_ratio": 1.0}
    rows = np.array([np.broadcast_to(table[name], LANES) for name in ROWS], float)
    n = TIMES.size
    return (
        *(
            TIMES[None],
            rows,
            np.zeros((MOST_PARAMETERS, LANES)),
            np.zeros((8, n)),
            np.ones(LANES),
            np.zeros(2),
            LONGEST_STEP,
        ),
        *(np.array([1.0, 0.0, 0.0]), np.empty((LANES, 2, n + 1)), np.empty(LANES), np.empty(LANES, np.int64)),
    )


@cache
def libm_kernel() -> Callable[..., Any]:
    """Our own source compiled with the C library's tanh, which LLVM cannot vectorise."""

    @njit(inline="always")
    def tanh_scaled(y):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        return math.tanh(y / vector_math.TANH_SCALE)

    physics = dict(vars(equations)) | {"tanh_scaled": tanh_scaled}
    namespace = dict(vars(integrator)) | specialised.specialised_globals(True, True, False, False, None)
    for name in ("_sign", "friction_torques", "linearised"):
        exec(inspect.getsource(getattr(equations, name).py_func), physics)  # noqa: S102
        namespace[name] = physics[name]
    exec(inspect.getsource(integrator.advance), namespace)  # noqa: S102
    options: dict[str, Any] = {"fastmath": vector_math.FASTMATH, "error_model": "numpy"}
    return njit(**options)(namespace["advance"])  # type: ignore[no-any-return]


@njit(fastmath=vector_math.FASTMATH, error_model="numpy", nogil=True)
def _fixed_step(rows, sharp, substeps, n, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Classical Runge-Kutta in lanes: rows (13, LANES), out (LANES, 2, n)."""
    state = np.zeros((4, LANES))
    width = rows.shape[1]
    h = 1e-3 / substeps
    for lane in range(width):
        state[0, lane] = rows[12, lane]
        state[1, lane] = rows[12, lane]
    reading = np.zeros((2, LANES))
    for i in range(n):
        for s in range(substeps):
            for lane in range(width):
                k1, c1, c3 = rows[2, lane], rows[3, lane], rows[4, lane]
                k2, c2, F, slope, d = rows[5, lane], rows[6, lane], rows[7, lane], rows[8, lane], rows[9, lane]
                i1, i2 = rows[10, lane], rows[11, lane]
                x1, x2, w1, w2 = state[0, lane], state[1, lane], state[2, lane], state[3, lane]
                a1, a2 = _rates(x1, x2, w1, w2, k1, c1, c3, k2, c2, F, slope, d, sharp, i1, i2)
                if s == 0:
                    reading[0, lane] = a1
                    reading[1, lane] = a2
                g = 0.5 * h
                b1, b2 = _rates(
                    x1 + g * w1, x2 + g * w2, w1 + g * a1, w2 + g * a2, k1, c1, c3, k2, c2, F, slope, d, sharp, i1, i2
                )
                e1, e2 = _rates(
                    x1 + g * w1 + g * g * a1, x2 + g * w2 + g * g * a2, w1 + g * b1, w2 + g * b2,
                    k1, c1, c3, k2, c2, F, slope, d, sharp, i1, i2,
                )  # fmt: skip
                f1, f2 = _rates(
                    x1 + h * w1 + h * g * b1, x2 + h * w2 + h * g * b2, w1 + h * e1, w2 + h * e2,
                    k1, c1, c3, k2, c2, F, slope, d, sharp, i1, i2,
                )  # fmt: skip
                state[0, lane] = x1 + h * w1 + h * h / 6.0 * (a1 + b1 + e1)
                state[1, lane] = x2 + h * w2 + h * h / 6.0 * (a2 + b2 + e2)
                state[2, lane] = w1 + h / 6.0 * (a1 + 2.0 * b1 + 2.0 * e1 + f1)
                state[3, lane] = w2 + h / 6.0 * (a2 + 2.0 * b2 + 2.0 * e2 + f2)
        for lane in range(width):
            out[lane, 0, i] = reading[0, lane]
            out[lane, 1, i] = reading[1, lane]


@vector_math.lane
def _rates(x1, x2, w1, w2, k1, c1, c3, k2, c2, F, slope, d, sharp, i1, i2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    tau1, tau2 = equations.smooth_torques(x1, x2, w1, w2, k1, 0.0, c1, c3, k2, c2, True, False)
    held1, held2 = equations.friction_torques(x1, x2, w1, w2, F, slope, d, d, sharp, 0.0, False, True)
    return (tau1 - held1) * i1, (tau2 - held2) * i2


def fixed_step(nu: float, substeps: int) -> tuple[Callable[[], None], Array]:
    """A call that integrates one block with that many fixed steps per ms, and the array (LANES, 2, n) it fills."""
    t = vectors(nu, LANES)
    columns = (
        *(t["J1"], t["J2"], t["k1t"], t["c1t"], t["c3t"], t["k2t"], t["c2t"], t["mu"] * t["N0"] * t["R"]),
        *(t["R"] / (2.0 * t["r"]), t["drag"], 1.0 / t["J1"], 1.0 / t["J2"], t["theta0"]),
    )
    rows = np.array([np.broadcast_to(column, LANES) for column in columns], float)
    out = np.empty((LANES, 2, TIMES.size))
    return lambda: _fixed_step(rows, vector_math.TANH_SCALE * nu, substeps, TIMES.size, out), out


def _interleaved(calls: dict[Any, tuple[Callable[[], Any], int]], repeats: int) -> dict[Any, float]:
    """Least CPU time, s, of each call per record it makes; every round runs all calls."""
    least = dict.fromkeys(calls, math.inf)
    for call, _ in calls.values():
        call()
    for _ in range(repeats):
        for key, (call, records) in calls.items():
            for _ in range(3 if least[key] * records < 0.05 else 1):  # a short call first has to fetch its data again
                start = time.process_time()
                call()
                least[key] = min(least[key], (time.process_time() - start) / records)
    return least


def peak_gflops(repeats: int = 9) -> float:
    """Fused multiply-adds per second of one core in registers, in 1e9 operations."""
    chains, rounds, length = 12, 16, 64
    lines = ["def loop(x, a, b, turns):", "    for turn in range(turns):", "        for j in range(x.shape[1]):"]
    lines += [f"            v{k} = x[{k}, j]" for k in range(chains)]
    lines += [f"            v{k} = v{k} * a + b" for _ in range(rounds) for k in range(chains)]
    lines += [f"            x[{k}, j] = v{k}" for k in range(chains)]
    namespace: dict[str, Any] = {}
    exec("\n".join(lines), namespace)  # noqa: S102
    loop = njit(fastmath=vector_math.FASTMATH, error_model="numpy")(namespace["loop"])
    x = np.zeros((chains, length))
    turns = 2000
    least = _interleaved({0: (lambda: loop(x, 0.999999, 1e-9, turns), 1)}, repeats)[0]
    return 2.0 * chains * rounds * length * turns / least / 1e9


def _error(y: Array, truth: Array) -> float:
    """Largest error of the vectors that are there (m, 2, n), as a share of the peak; inf if not a number."""
    shared = min(y.shape[0], truth.shape[0])
    worst = float(np.abs(y[:shared] - truth[:shared]).max() / np.abs(truth).max())
    return worst if math.isfinite(worst) else math.inf


def _peers(nu: float, truth: Array) -> tuple[dict[str, tuple[Callable[[], Any], int, Callable[[], float]]], list[str]]:
    """Peers that are installed, at one sharpness: name -> call, records it makes, its error; and who is missing."""
    found: dict[str, tuple[Callable[[], Any], int, Callable[[], float]]] = {}
    missing = []
    for name, make in bench_peers.PEERS.items():
        try:
            call, records, read = make(nu, vectors(nu), TIMES, lambda y: _error(y, truth))
        except ImportError:
            missing.append(name)
            continue
        found[name] = (call, records, lambda read=read: _error(read(), truth))  # type: ignore[misc]
    return found, missing


def _own_calls(
    nu: float,
    kernel: Callable[..., Any],
    calls: dict[Any, tuple[Callable[[], Any], int]],
    errors: dict[Any, Callable[[], float]],
) -> Array:
    """Our own ways to simulate at one sharpness, added to what is timed and held against the truth, which it gives."""
    model, plain, data = Model(), libm_kernel(), np.zeros((2, TIMES.size))
    call, truth = fixed_step(nu, 2000 if nu > 500.0 else 250)
    call()
    truth = truth.copy()
    table, sixteen = vectors(nu), vectors(nu, LANES)
    arguments = _block(nu)
    speed = BASE["theta0"] * math.sqrt(BASE["k1t"] / BASE["J1"])

    def own_error(tolerance: float = 1.0) -> float:
        return _error(model.simulate(sixteen, TIMES, tolerance=tolerance).y, truth)

    def as_a_fit_does() -> Array:
        """Records, then the sums of squares of their residuals."""
        return np.asarray(np.square(model.simulate(table, TIMES).y - data).sum(axis=(1, 2)))

    swept = Inputs.measured(TIMES, _SWEEP)

    def forced_error() -> float:
        return _error(model.simulate(sixteen, TIMES, inputs=swept).y, bench_peers.forced(sixteen, 1, TIMES, _SWEEP))

    calls[_FORCED, nu] = lambda: model.simulate(table, TIMES, inputs=swept), _VECTORS
    errors[_FORCED, nu] = forced_error
    calls[_OWN, nu] = as_a_fit_does, _VECTORS
    errors[_OWN, nu] = own_error
    calls["kernel alone", nu] = lambda: kernel(*arguments), LANES
    errors["kernel alone", nu] = own_error
    fixed = min(integrator.SPEED_TOLERANCE * speed, integrator.SWITCH_TOLERANCE / nu)
    at_fixed = list(_block(nu))
    at_fixed[4] = np.full(LANES, FIXED_TOLERANCE / fixed)
    calls["kernel, one fixed tolerance", nu] = lambda: kernel(*at_fixed), LANES
    errors["kernel, one fixed tolerance", nu] = lambda: own_error(FIXED_TOLERANCE / fixed)
    calls["same source, libm tanh", nu] = lambda: plain(*arguments), LANES
    errors["same source, libm tanh", nu] = own_error
    rk4, out = fixed_step(nu, _SUBSTEPS[nu])
    calls["RK4 in lanes", nu] = (rk4, LANES)
    errors["RK4 in lanes", nu] = lambda: _error(out, truth)
    return truth


def bench(*, repeats: int = 7, peers: bool = True) -> Bench:
    """Measure speed and accuracy; about two minutes with all peers, half a minute without.

    repeats : rounds over all rows; peers : whether other packages that are installed are timed too.
    """
    kernel: Callable[..., Any] = Model().compile()
    calls: dict[Any, tuple[Callable[[], Any], int]] = {}
    slow: dict[Any, tuple[Callable[[], Any], int]] = {}
    errors: dict[Any, Callable[[], float]] = {}
    missing: list[str] = []
    passes: dict[float, int] = {}
    for nu in SHARPNESS:
        truth = _own_calls(nu, kernel, calls, errors)
        passes[nu] = int(kernel(*_block(nu)))
        if peers:
            found, missing = _peers(nu, truth)
            for name, (peer, records, error) in found.items():
                start = time.process_time()
                peer()
                (slow if time.process_time() - start > 0.3 else calls)[name, nu] = (peer, records)
                errors[name, nu] = error
    least = _interleaved(calls, repeats) | _interleaved(slow, 1)
    rows = tuple(
        Row(name, nu, least[name, nu] * 1e6, errors[name, nu]()) for name, nu in sorted(least, key=_order(least))
    )
    peak = peak_gflops()
    reached = max(passes[nu] * FLOPS_PER_STEP / least["kernel alone", nu] / 1e9 for nu in SHARPNESS)
    overhead = _emcee_overhead()
    return Bench(
        machine={"processor": _processor(), "python": platform.python_version(), "numba": numba.__version__},
        rows=rows,
        targets=(
            *_targets(rows, missing if peers else [], peak, reached),
            Target("emcee's own time per walker and step, us", 2.5, overhead, True),
        ),
        missing=tuple(missing),
        work_precision=_work_precision(),
        peak_gflops=peak,
        kernel_gflops=reached,
        scaling=_scaling(),
        emcee_overhead=overhead,
    )


def _scaling() -> dict[str, list[tuple[float, float]]]:
    """Total CPU time over the length of the record and over the number of records."""
    model, nu = Model(), 100.0
    curves: dict[str, list[tuple[float, float]]] = {"samples": [], "records": []}
    table = vectors(nu, 32)
    for samples in (251, 501, 1001, 2001, 4001):
        times = np.arange(samples) * 1e-3
        spent = _interleaved({0: (lambda t=times: model.simulate(table, t), 1)}, 5)[0]  # type: ignore[misc]
        curves["samples"].append((samples, spent * 1e6))
    for records in (16, 32, 64, 128, 256):
        many = {name: np.resize(v, records) if np.ndim(v) else v for name, v in vectors(nu).items()}
        spent = _interleaved({0: (lambda v=many: model.simulate(v, TIMES), 1)}, 5)[0]  # type: ignore[misc]
        curves["records"].append((records, spent * 1e6))
    return curves


def _emcee_overhead() -> float:
    """CPU time per walker and step of the default mix of moves on a target that costs next to nothing, us."""
    walkers, ndim, steps = 64, 6, 400
    mix = [(DifferentialEvolution(spread=0.3), 0.7), (DifferentialEvolution(1.0, spread=1e-3), 0.1), (Snooker(), 0.2)]

    def target(points: Array) -> Array:
        return np.asarray(-0.5 * np.einsum("ij,ij->i", points, points))

    start = np.random.default_rng(1).standard_normal((walkers, ndim))
    sampler = emcee.EnsembleSampler(walkers, ndim, target, moves=mix, vectorize=True)
    state = sampler.run_mcmc(start, 50, skip_initial_state_check=True)
    spent = math.inf
    for _ in range(5):
        begun = time.process_time()
        state = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        own = time.process_time() - begun
        begun = time.process_time()
        for _ in range(2 * steps):
            target(start[: walkers // 2])
        spent = min(spent, own - (time.process_time() - begun))
    return spent / (walkers * steps) * 1e6


def _order(least: dict[Any, float]) -> Callable[[Any], Any]:
    names = list(dict.fromkeys(name for name, _ in least))
    return lambda key: (names.index(key[0]), key[1])


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


_PROMISES: tuple[tuple[str, dict[float, float]], ...] = (
    ("numbalsoda LSODA", {10.0: 7.0, 100.0: 7.0, 1000.0: 7.0}),
    ("heyoka, batch of 8", {10.0: 3.5, 100.0: 5.0, 1000.0: 30.0}),
    ("scipy LSODA", {10.0: 350.0, 100.0: 350.0, 1000.0: 350.0}),
    ("diffrax, vmap of 32", {10.0: 6.0, 100.0: 40.0, 1000.0: 120.0}),
    ("same source, libm tanh", {10.0: 3.5, 100.0: 3.5, 1000.0: 3.5}),
)


def _targets(rows: tuple[Row, ...], missing: list[str], peak: float, reached: float) -> tuple[Target, ...]:
    spent = {(row.name, row.nu): row.microseconds for row in rows}
    targets = [
        Target(
            f"largest error{words}, share of the peak", ERROR_BOUND, max(r.error for r in rows if r.name == name), True
        )
        for name, words in ((_OWN, ""), (_FORCED, " of forced records"))
    ]
    for name, promised in _PROMISES:
        for nu, ratio in promised.items():
            # Whoever vectorises like us is compared in the kernel; the rest with all that a call of ours costs.
            own = "kernel alone" if name.startswith("same source") else _OWN
            found = (name, nu) in spent
            if found or name in missing:
                value = spent[name, nu] / spent[own, nu] if found else None
                targets.append(Target(f"times faster than {name} at nu = {nu:g}", ratio, value))
    fixed = "kernel, one fixed tolerance"
    targets += [
        Target("cost at nu = 1000 over nu = 10, one tolerance", 1.2, spent[fixed, 1000.0] / spent[fixed, 10.0], True),
        Target(
            "cost at nu = 10 over that at a tolerance of 2e-7",
            1.0,
            spent["kernel alone", 10.0] / spent[fixed, 10.0],
            True,
        ),
        Target("share of the peak of fused multiply-adds", 0.33, reached / peak),
    ]
    return tuple(targets)


def _work_precision() -> dict[str, list[tuple[float, float]]]:
    """CPU time and error of our kernel over its tolerance and of fixed steps over their number, nu = 100."""
    call, truth = fixed_step(100.0, 1000)
    call()
    model, table = Model(), vectors(100.0, LANES)
    curves: dict[str, list[tuple[float, float]]] = {_OWN: [], "RK4 in lanes": []}
    for tolerance in (100.0, 10.0, 1.0, 0.1, 0.01):
        error = _error(model.simulate(table, TIMES, tolerance=tolerance).y, truth)
        least = _interleaved({0: (lambda w=tolerance: model.simulate(table, TIMES, tolerance=w), LANES)}, 5)[0]  # type: ignore[misc]
        curves[_OWN].append((least * 1e6, error))
    for substeps in (4, 8, 16, 32, 64, 128):
        rk4, out = fixed_step(100.0, substeps)
        least = _interleaved({0: (rk4, LANES)}, 3)[0]
        curves["RK4 in lanes"].append((least * 1e6, _error(out, truth)))
    return curves


def _scaling_lines(scaling: dict[str, list[tuple[float, float]]]) -> list[str]:
    lines = []
    for what, points in scaling.items():
        lines += [
            f"| {what} | " + " | ".join(f"{n:g}" for n, _ in points) + " |",
            "| --- " * (len(points) + 1) + "|",
            "| CPU time, ms | " + " | ".join(f"{spent / 1e3:.3g}" for _, spent in points) + " |",
            "| per one, us | " + " | ".join(f"{spent / n:.3g}" for n, spent in points) + " |",
            "",
        ]
    return lines[:-1]


def save(result: Bench, folder: Path) -> list[Path]:
    """Write bench.json, bench.md and the figure of work against precision; gives the files."""
    from bayes_damper import figures

    write_json(folder / "bench.json", result.to_json())
    machine = ", ".join(f"{key} {value}" for key, value in result.machine.items())
    share = result.kernel_gflops / result.peak_gflops
    text = [
        "# Speed and accuracy beside the peers",
        "",
        "Made by `bayes-damper bench`. CPU time of one record (1 s at 1 kHz, coupled rig, linear pull), one thread,",
        "least of interleaved repeats; in brackets the time over ours; then the largest error as a share of the peak.",
        f"Machine: {machine}.",
        f"Peak measured in the same run: {result.peak_gflops:.0f} GFLOP/s; our kernel: {result.kernel_gflops:.0f}",
        f"({share:.0%}, idle lanes included).",
        "",
        result.table(),
        "",
        "Cost grows in proportion to the number of samples and of records (32 records; 1001 samples; nu = 100):",
        "",
        *_scaling_lines(result.scaling),
        "",
        "![Error against time](bench.svg)",
    ]
    if result.missing:
        text += ["", f"Not installed: {', '.join(sorted(result.missing))}."]
    write_text(folder / "bench.md", "\n".join(text) + "\n")
    figure = figures.work_precision_figure(result.work_precision, title="Work against precision, nu = 100 s/rad")
    return [folder / "bench.json", folder / "bench.md", *figures.save(figure, folder / "bench")]
