"""The same task given to other packages, for bench.py: each with the loosest setting that keeps the accuracy bound.

A peer is a function (nu, vectors, times, error) -> (call, records, read): `call` integrates `records` parameter vectors
over the sample times, `read` gives their accelerations (records, 2, n). Those that compute a trajectory only are not
charged for the accelerations. An ImportError says that a package is not there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Peer = tuple[Callable[[], Any], int, Callable[[], Array]]
_LADDER = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
_BOUND = 1e-4


def accelerations(th1: Any, th2: Any, w1: Any, w2: Any, q: Any, xp: Any = np) -> tuple[Any, Any]:
    """Both accelerations of the nominal rig with linear pull; q as `constants` gives it, xp numpy or jax.numpy."""
    J1, J2, k1, c1, c3, k2, c2, friction, slope, drag, nu = q[:11]
    phi, slip = th1 - th2, w1 - w2
    T = k2 * phi + c2 * slip + friction * xp.maximum(0.0, 1.0 - slope * xp.abs(phi)) * xp.tanh(nu * slip)
    return (-c1 * w1 - k1 * th1 - drag * xp.tanh(nu * w1) - T) / J1, (T - c3 * w2 - drag * xp.tanh(nu * w2)) / J2


def constants(table: dict[str, Any], n: int) -> Array:
    """Rows of numbers for `accelerations` and the release angle, (12, n)."""
    t = table
    columns = (
        *(t["J1"], t["J2"], t["k1t"], t["c1t"], t["c3t"], t["k2t"], t["c2t"], t["mu"] * t["N0"] * t["R"]),
        *(t["R"] / (2.0 * t["r"]), t["drag"], t["nu"], t["theta0"]),
    )
    return np.array([np.broadcast_to(column, np.shape(t["nu"]))[:n] for column in columns])


def forced(table: dict[str, Any], n: int, times: Array, torque: Array) -> Array:
    """Accelerations (n, 2, n_times) of the first n vectors under a torque on the primary, linear between the samples.

    By scipy's DOP853 at 1e-9 from sample to sample, where the torque has its corners: the truth of forced records.
    """
    from scipy.integrate import solve_ivp

    out = np.empty((n, 2, times.size))
    slope = np.append(np.diff(torque) / np.diff(times), 0.0)
    for k, q in enumerate(constants(table, n).T):
        x = np.array([q[11], q[11], 0.0, 0.0])
        for i, start in enumerate(times):

            def rates(t: float, x: Array, i: int = i, start: float = start, q: Array = q) -> list[float]:
                a1, a2 = accelerations(x[0], x[1], x[2], x[3], q)
                return [x[2], x[3], a1 + (torque[i] + slope[i] * (t - start)) / q[0], a2]

            out[k, :, i] = rates(start, x)[2:]
            if i + 1 < times.size:
                x = solve_ivp(rates, (start, times[i + 1]), x, "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    return out


def _loosest(candidates: Iterable[Peer], error: Callable[[Array], float]) -> Peer:
    """The fastest of the candidates that keeps the bound, tried from loose to tight until one does."""
    last: Peer | None = None
    for candidate in candidates:
        last = candidate
        candidate[0]()
        if error(candidate[2]()) < _BOUND:
            break
    if last is None:
        raise ImportError("nothing to run")
    return last


def _from_states(states: Array, q: Array) -> Array:
    """Accelerations (1, 2, n) of a trajectory (n, 4)."""
    th1, th2, w1, w2 = states.T
    return np.array(accelerations(th1, th2, w1, w2, q))[None]


def _scipy(method: str) -> Callable[..., Peer]:
    def make(nu: float, table: dict[str, Any], times: Array, error: Callable[[Array], float]) -> Peer:
        from scipy.integrate import solve_ivp

        q = constants(table, 1)[:, 0]
        J1, J2, k1, c1, c3, k2, c2, friction, slope, drag, sharp, theta0 = (float(x) for x in q)

        def rates(_t: float, x: Array) -> tuple[float, float, float, float]:
            th1, th2, w1, w2 = x
            phi, slip = th1 - th2, w1 - w2
            T = k2 * phi + c2 * slip + friction * max(0.0, 1.0 - slope * abs(phi)) * math.tanh(sharp * slip)
            a1 = (-c1 * w1 - k1 * th1 - drag * math.tanh(sharp * w1) - T) / J1
            return w1, w2, a1, (T - c3 * w2 - drag * math.tanh(sharp * w2)) / J2

        def candidate(tolerance: float) -> Peer:
            kept: list[Array] = []

            def call() -> None:
                solution = solve_ivp(
                    *(rates, (times[0], times[-1]), [theta0, theta0, 0.0, 0.0]),
                    method=method, t_eval=times, rtol=tolerance, atol=1e-2 * tolerance, max_step=1e-3,
                )  # fmt: skip
                kept[:] = [solution.y.T]

            return call, 1, lambda: _from_states(kept[0], q)

        # Explicit methods at large nu are slow enough to try few tolerances.
        ladder = _LADDER if method == "LSODA" or nu < 500.0 else (1e-6, 1e-8)
        return _loosest((candidate(tolerance) for tolerance in ladder), error)

    return make


def _numbalsoda(_nu: float, table: dict[str, Any], times: Array, error: Callable[[Array], float]) -> Peer:
    import numba
    from numbalsoda import lsoda, lsoda_sig  # type: ignore[import-not-found,import-untyped,unused-ignore]

    @numba.cfunc(lsoda_sig, fastmath=True)
    def rates(_t, u, du, p):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        q = numba.carray(p, (12,))  # type: ignore[attr-defined]
        phi, slip = u[0] - u[1], u[2] - u[3]
        T = q[5] * phi + q[6] * slip + q[7] * max(0.0, 1.0 - q[8] * abs(phi)) * math.tanh(q[10] * slip)
        du[0] = u[2]
        du[1] = u[3]
        du[2] = (-q[3] * u[2] - q[2] * u[0] - q[9] * math.tanh(q[10] * u[2]) - T) / q[0]
        du[3] = (T - q[4] * u[3] - q[9] * math.tanh(q[10] * u[3])) / q[1]

    records = 8
    q = np.ascontiguousarray(constants(table, records).T)
    address = rates.address

    def candidate(tolerance: float) -> Peer:
        kept: list[Array] = []

        def call() -> None:
            kept.clear()
            for row in q:
                start = np.array([row[11], row[11], 0.0, 0.0])
                kept.append(lsoda(address, start, times, row, rtol=tolerance, atol=1e-2 * tolerance)[0])

        return call, records, lambda: np.concatenate([_from_states(u, row) for u, row in zip(kept, q, strict=True)])

    return _loosest((candidate(tolerance) for tolerance in _LADDER), error)


def _heyoka(_nu: float, table: dict[str, Any], times: Array, error: Callable[[Array], float]) -> Peer:
    import heyoka as hy

    th1, th2, w1, w2 = hy.make_vars("th1", "th2", "w1", "w2")
    J1, J2, k1, c1, c3, k2, c2, friction, slope, drag, sharp = (hy.par[i] for i in range(11))
    phi, slip = th1 - th2, w1 - w2
    pull = hy.relu(1.0 - slope * (hy.relu(phi) + hy.relu(-phi)))
    T = k2 * phi + c2 * slip + friction * pull * hy.tanh(sharp * slip)
    a1 = (-c1 * w1 - k1 * th1 - drag * hy.tanh(sharp * w1) - T) / J1
    a2 = (T - c3 * w2 - drag * hy.tanh(sharp * w2)) / J2
    batch = 8
    q = constants(table, batch)
    start = np.array([q[11], q[11], np.zeros(batch), np.zeros(batch)])
    system = [(th1, w1), (th2, w2), (w1, a1), (w2, a2)]
    grid = np.repeat(times[:, None], batch, axis=1)

    def candidate(tolerance: float, cap: float) -> Peer:
        integrator = hy.taylor_adaptive_batch(system, start, pars=q[:11], tol=tolerance)
        kept: list[Any] = []

        def call() -> None:
            integrator.set_time(0.0)
            integrator.state[:] = start
            kept[:] = [integrator.propagate_grid(grid, max_delta_t=[cap] * batch)]

        def read() -> Array:
            states = next(part for part in kept[0] if isinstance(part, np.ndarray) and part.ndim == 3)
            return np.array([_from_states(states[:, :, i], q[:, i])[0] for i in range(batch)])

        return call, batch, read

    # Without a cap on its step a Taylor method jumps over reversals of the friction.
    caps = (
        (1e-6, 1.0),
        (1e-8, 1.0),
        (1e-8, 3e-3),
        (1e-8, 1e-3),
        (1e-8, 5e-4),
        (1e-8, 2e-4),
        (1e-8, 1e-4),
        (1e-10, 5e-5),
    )
    return _loosest((candidate(*pair) for pair in caps), error)


def _diffrax(nu: float, table: dict[str, Any], times: Array, error: Callable[[Array], float]) -> Peer:
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    records = 32
    q = jnp.asarray(constants(table, records).T)
    save = diffrax.SaveAt(ts=jnp.asarray(times))

    def rates(_t: Any, x: Any, row: Any) -> Any:
        a1, a2 = accelerations(x[0], x[1], x[2], x[3], row, xp=jnp)
        return x[2], x[3], a1, a2

    def candidates(solver: Any) -> Iterable[Peer]:
        def one(row: Any, tolerance: Any) -> Any:
            return diffrax.diffeqsolve(
                *(diffrax.ODETerm(rates), solver, 0.0, float(times[-1]), 1e-5, (row[11], row[11], 0.0, 0.0), row),
                saveat=save, max_steps=400_000, throw=False,
                stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=1e-2 * tolerance, dtmax=1e-3),
            ).ys  # fmt: skip

        solve = jax.jit(jax.vmap(one))
        for tolerance in _LADDER[1:6]:
            kept: list[Any] = []

            def call(tolerance: float = tolerance, kept: list[Any] = kept) -> None:
                kept[:] = [jax.block_until_ready(solve(q, jnp.full(records, tolerance)))]

            def read(kept: list[Any] = kept) -> Array:
                th1, th2, w1, w2 = (np.asarray(part) for part in kept[0])
                return np.stack(accelerations(th1, th2, w1, w2, np.asarray(q).T[:, :, None]), axis=1)

            yield call, records, read

    # The explicit solver is tried where friction is soft; elsewhere only the implicit one ends in reasonable time.
    solvers = [diffrax.Kvaerno5()] if nu > 50.0 else [diffrax.Tsit5(), diffrax.Kvaerno5()]
    tried = [_loosest(candidates(solver), error) for solver in solvers]
    return min(tried, key=_seconds)


def _seconds(peer: Peer) -> float:
    start = time.process_time()
    peer[0]()
    return time.process_time() - start


PEERS: dict[str, Callable[..., Peer]] = {
    "numbalsoda LSODA": _numbalsoda,
    "heyoka, batch of 8": _heyoka,
    "diffrax, vmap of 32": _diffrax,
    "scipy LSODA": _scipy("LSODA"),
    "scipy RK45": _scipy("RK45"),
    "scipy DOP853": _scipy("DOP853"),
}
