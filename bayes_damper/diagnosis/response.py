"""What a small torque anywhere in the rig does to the records: the motion of a fit, and the rig linearised along it.

The site map, the search for events and the missing torque ask the same question with different torques: by how much
would the readings change? Along the motion of a fitted rig the change obeys the linearised equations

    M d(dw)/dt = K(t) dth + C(t) dw + q(t),    d(dth)/dt = dw,

stepped here by an L-stable rule of third order for many torques at once. A reversal of dry friction lasts far less
than a step; over a step the slope of s(nu w) is therefore the secant (s(nu b) - s(nu a)) / (b - a), which conserves
the jump.

Where the motion of the primary is prescribed, its part of the state does not change, and its channel reads what its own
equation lacks to that motion. A pivot that is moved sideways tilts the gravity that a pendulum feels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Block, Calibration, Experiment, Group, value_and_slope
from bayes_damper.calibration.normal_equations import Remade
from bayes_damper.rig.inputs import Inputs
from bayes_damper.rig.kernels import compiled
from bayes_damper.simulation.integrator import PER_GRAVITY
from bayes_damper.simulation.model import Model

Array = NDArray[np.float64]

ANGLE_PER_STEP = 0.08  # largest omega dt of a step, rad: keeps the response within 1e-3
SLICE = 25_000  # readings of a block of trials whose motions are held at a time
AT_ONCE = 5_000  # readings of those whose responses to hundreds of shapes are: what the processor's caches hold


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the trials of one group under a fit, on a grid (N,) s that holds every sample, and how it responds.

    th1, th2, w1, w2, a1, a2 : (trials, N), zeros for the secondary of an uncoupled rig; before the release the rig is
    held. since (trials, N): time since the release, s, 0 before. y (trials, channels, n): readings of sensors that show
    what there is. at (n,): the samples' places in the grid. friction, slope, nu, tail, k1t (trials,): what shapes need.
    step (trials, N - 1, 4, 4), push (trials, N - 1, 4, 2): transition of (dth1, dth2, dw1, dw2) and of the torque's
    mean over the step; read_state (trials, channels, n, 4), read_torque (trials, channels, n, 2): the readings of both.
    added (trials, 2, N): torque on each inertia beyond the nominal laws, N m: that of the fit's effect.
    """

    group: Group
    grid: Array
    at: NDArray[np.int64]
    th1: Array
    th2: Array
    w1: Array
    w2: Array
    a1: Array
    a2: Array
    since: Array
    y: Array
    friction: Array
    slope: Array
    nu: Array
    tail: Array
    k1t: Array
    theta0: Array
    step: Array
    push: Array
    read_state: Array
    read_torque: Array
    added: Array

    def dry(self, w: Array) -> Array:
        """The sign that dry friction gives speeds (trials, N), -1 to 1."""
        return dry_sign(w, self.nu, self.tail)

    @property
    def phi(self) -> Array:
        """Relative angle, rad; (trials, N)."""
        return self.th1 - self.th2

    @property
    def slip(self) -> Array:
        """Relative velocity, rad/s; (trials, N)."""
        return self.w1 - self.w2

    @property
    def overlap(self) -> Array:
        """N / N0, the share of the pull that is left; (trials, N)."""
        return np.asarray(np.maximum(0.0, 1.0 - self.slope[:, None] * np.abs(self.phi)))

    @property
    def prescribed(self) -> bool:
        """Whether the motion of the primary is an input, and its channel reads the reaction."""
        return self.group.inputs is not None and self.group.inputs.motion is not None

    @property
    def nbytes(self) -> int:
        """Of all arrays."""
        return sum(getattr(self, f.name).nbytes for f in fields(self) if f.name != "group")

    def only(self, at: slice) -> Motion:
        """The motion of some of its trials."""
        rest = {f.name: getattr(self, f.name)[at] for f in fields(self) if f.name not in ("group", "grid", "at")}
        return replace(self, group=self.group.only(at), **rest)

    def respond(self, q1: Array | None, q2: Array | None, start: Array | None = None) -> Array:
        """Changes of the readings, (trials, k, channels, n), that k torques make.

        q1, q2 : (trials, k, N) N m on each inertia, or None; start : (trials, k, 4) changes of the state at release.
        """
        shaped = q1 if q1 is not None else q2
        trials = self.th1.shape[0]
        k = shaped.shape[1] if shaped is not None else start.shape[1]  # type: ignore[union-attr]
        moving = self.since > 0.0
        q = np.zeros((trials, self.grid.size, 2, k))
        for body, torque in enumerate((q1, q2)):
            if torque is not None:
                q[:, :, body] = (torque * moving[:, None]).transpose(0, 2, 1)
        state = np.zeros((trials, 4, k)) if start is None else np.ascontiguousarray(start.transpose(0, 2, 1))
        if self.prescribed:
            state[:, ::2] = 0.0
        y = np.empty((trials, self.read_state.shape[1], self.at.size, k))
        _march(self.step, self.push, self.read_state, self.read_torque, self.at, moving, q, state, y)
        return y.transpose(0, 3, 1, 2)


@compiled()
def _march(
    step: Array, push: Array, read_state: Array, read_torque: Array, at: NDArray[np.int64],
    moving: NDArray[np.bool_], q: Array, start: Array, y: Array,
) -> None:  # fmt: skip
    """Step the states that k torques q (trials, N, 2, k) make, and read them at the samples.

    start (trials, 4, k): states at the release; moving (trials, N): whether the rig has been let go; y (trials,
    channels, n, k) receives the changes of the readings; the others as in `Motion`.
    """
    trials, channels, n, k = y.shape
    now, then = np.empty((4, k)), np.empty((4, k))
    for j in range(trials):
        now[:] = start[j]
        sample = 0
        for i in range(q.shape[1]):
            # Rows by themselves: LLVM takes a third of the time over them.
            q1, q2 = q[j, i, 0], q[j, i, 1]
            x0, x1, x2, x3 = now[0], now[1], now[2], now[3]
            if sample < n and at[sample] == i:
                for c in range(channels):
                    read = y[j, c, sample]
                    t0, t1 = read_torque[j, c, sample, 0], read_torque[j, c, sample, 1]
                    for column in range(k):
                        read[column] = t0 * q1[column] + t1 * q2[column]
                    if moving[j, i]:
                        for row in range(4):
                            slope, x = read_state[j, c, sample, row], now[row]
                            for column in range(k):
                                read[column] += slope * x[column]
                sample += 1
            if i + 1 == q.shape[1]:
                break
            r1, r2 = q[j, i + 1, 0], q[j, i + 1, 1]
            for row in range(4):
                p0, p1 = 0.5 * push[j, i, row, 0], 0.5 * push[j, i, row, 1]
                a0, a1, a2, a3 = step[j, i, row, 0], step[j, i, row, 1], step[j, i, row, 2], step[j, i, row, 3]
                x = then[row]
                for column in range(k):
                    x[column] = (
                        a0 * x0[column] + a1 * x1[column] + a2 * x2[column] + a3 * x3[column]
                        + p0 * (q1[column] + r1[column])
                        + p1 * (q2[column] + r2[column])
                    )  # fmt: skip
            now, then = then, now


def in_slices(fit: Calibration) -> Calibration:
    """The fit with its linearised problem in blocks small enough that responses to many shapes fit into memory."""
    return replace(fit, linear=fit.linear.sliced(SLICE))


def motions(fit: Calibration) -> list[Motion]:
    """The motion of every fitted trial, one entry for each group of the problem."""
    out: list[Motion] = []
    for block in fit.linear.blocks:
        out.append(_motion(fit, block))
        Remade.make_room(sum(m.nbytes for m in out))
    return out


def in_turns(fit: Calibration, moved: Sequence[Motion]) -> tuple[Calibration, list[Motion]]:
    """The fit and its motions by so few trials that the responses to many shapes stay in the processor's caches."""
    turns = fit.linear.sliced(AT_ONCE)
    places = iter(len(block.group.trials) for block in turns.blocks)
    parts = []
    for motion in moved:
        first = 0
        while first < len(motion.group.trials):
            end = first + next(places)
            parts.append(motion if end - first == len(motion.group.trials) else motion.only(slice(first, end)))
            first = end
    return replace(fit, linear=turns), parts


def on_trials(fit: Calibration, eta: Mapping[int, Array]) -> Calibration:
    """The fit as it stands, linearised on other trials whose nuisances are eta."""
    old = fit.problem
    problem = old.for_trials(tuple(eta))
    keep = [old.names.index(name) for name in problem.names]
    q = fit.q[keep]
    linear = problem.linearise(q, eta)
    return replace(
        fit, problem=problem, q=q, eta=dict(eta), covariance=fit.covariance[np.ix_(keep, keep)], linear=linear
    )


def _bare(model: Model) -> Model:
    """The model with sensors that show what there is, and constants that are amended already."""
    e = model.effect
    if e is None or (e.sense is None and e.lag is None and e.amend is None):
        return model
    return replace(model, effect=replace(e, sense=None, lag=None, amend=None))


def _grid(times: Array, omega: float) -> tuple[Array, NDArray[np.int64]]:
    """The sample times with steps halved until none is longer than the motion allows, and the samples' places."""
    parts = np.maximum(1, np.ceil(np.diff(times) * omega / ANGLE_PER_STEP)).astype(int)
    at = np.concatenate([[0], np.cumsum(parts)])
    grid = np.interp(np.arange(at[-1] + 1), at, times)
    return grid, at


def _of_both(y: Array) -> Array:
    """Readings (n, 2, times) of both bodies, 0 where there is one or the simulation failed."""
    y = np.nan_to_num(y)
    return y if y.shape[1] == 2 else np.concatenate([y, np.zeros_like(y)], axis=1)


def _motion(fit: Calibration, block: Block) -> Motion:
    problem = fit.problem
    group = block.group
    n = len(group.trials)
    every: Any = np.arange(n)
    rig, effect = problem._inputs(group, every, np.tile(fit.q, (n, 1)), block.eta)  # noqa: SLF001

    def value(name: str, default: float = 0.0) -> Array:
        return np.broadcast_to(np.asarray(rig.get(name, default), float), (n,)).astype(float)

    variant = problem.effect
    if variant is not None and variant.amend is not None:
        rig = dict(variant.amend(dict(rig), {k: np.asarray(v) for k, v in effect.items()}))
    k1t, j1, nu = value("k1t"), value("J1"), value("nu")
    grid, at = _grid(group.times, float(np.sqrt(np.max(k1t / j1))))
    model = _bare(problem.models[group.coupled])
    inputs = None if group.inputs is None else group.inputs.seen_from_ground()
    run = partial(
        model.simulate, rig, grid, effect=effect if model.effect is not None else None, inputs=inputs,
        tolerance=problem.tolerance,
    )  # fmt: skip
    th, w, a = (_of_both(run(quantity=name).y) for name in ("displacement", "velocity", "acceleration"))
    delay = value("delay", 0.0)
    reaction = None  # N m
    if inputs is not None and inputs.motion is not None:
        reaction, delay = a[:, 0] * inputs.unit, np.full(n, grid[0])
        th[:, 0], w[:, 0], a[:, 0] = inputs.moved(grid)
    since = np.maximum(grid[None, :] - delay[:, None], 0.0)
    if float(delay.max()) <= grid[0]:
        since = since + 1e-12  # released before the record begins
    coupled = group.coupled
    e = problem.experiment
    parts = _parts(e, value, coupled)
    inverse = _inverse_mass(value, n, coupled, prescribed=reaction is not None)
    pendulum = e.restoring == "pendulum"
    tilt = _tilt(inputs, grid)
    K, C = _jacobian(
        th[:, :, :-1], th[:, :, 1:], w[:, :, :-1], w[:, :, 1:], parts, coupled, pendulum, 0.5 * (tilt[:-1] + tilt[1:])
    )
    h = np.clip(grid[None, 1:] - np.maximum(grid[None, :-1], delay[:, None]), 0.0, None)
    step, push = _steps(K, C, inverse, h)
    beside = _beside(K), _beside(C)
    y, read_state, read_torque = _reading(th, w, a, at, inverse, *beside, coupled, e.quantity)
    if inputs is not None and reaction is not None:
        y[:, 0] = reaction[:, at] / inputs.unit
        carried = value("J12", 0.0)[:, None] * inverse[:, 1, 1:]
        read_state[:, 0], read_torque[:, 0] = _read_of_reaction(carried, [b[:, at] for b in beside], inputs.unit)
    if group.inputs is not None and group.inputs.pivot is None:
        y = y + group.inputs.at(group.times)[3]
    added = np.zeros_like(th)
    if variant is not None:
        added = _accelerating(a, value, coupled) - _nominal_torques(th, w, parts, coupled, pendulum, tilt)
        if coupled and e.coupling_law == "cosine":
            added -= _of_links(th, w, a, value, parts)
        if inputs is not None:
            acting = inputs.torques(grid, j1, value("J2"), value("J12") if coupled else np.zeros(n))
            acting[:, 0] = acting[:, 0] if reaction is None else reaction
            added[:, : 1 + coupled] -= acting[:, : 1 + coupled]
        added *= (since > 0.0)[:, None]
    return Motion(
        group, grid, at, th[:, 0], th[:, 1], w[:, 0], w[:, 1], a[:, 0], a[:, 1], since, y, parts["friction"],
        parts["slope"], nu, value("tail"), k1t, value("theta0"), step, push, read_state, read_torque, added,
    )  # fmt: skip


def _tilt(inputs: Inputs | None, grid: Array) -> Array:
    """Sideways pull on a pendulum whose pivot is moved, as a share of its weight, at the instants `grid`, (N,)."""
    moved = inputs is not None and inputs.pivot is not None
    return inputs.at(grid)[3] * PER_GRAVITY if inputs is not None and moved else np.zeros(grid.size)


def _parts(e: Experiment, value: Callable[[str, float], Array], coupled: bool) -> dict[str, Array]:
    """What the nominal laws need, by name, (trials,) each."""
    parts = {name: value(name, 0.0) for name in ("k1t", "k3t", "c1t", "c3t", "k2t", "c2t", "drag", "nu", "tail")}
    nothing = np.zeros_like(parts["nu"])
    parts["drag2"] = parts["drag"] * value("drag_ratio", 1.0)
    magnet = coupled and e.magnet
    parts["friction"] = value("mu", 0.0) * value("N0", 0.0) * value("R", 1.0) if magnet else nothing
    linear = e.normal_force == "linear" and magnet
    parts["slope"] = value("R", 1.0) / (2.0 * value("r", 1.0)) if linear else nothing
    return parts


def _mass(value: Callable[[str, float], Array]) -> Array:
    """Mass matrices (trials, 2, 2)."""
    beside = value("J12", 0.0)
    return np.stack([np.stack([value("J1", 1.0), beside], -1), np.stack([beside, value("J2", 1.0)], -1)], -2)


def _inverse_mass(value: Callable[[str, float], Array], trials: int, coupled: bool, prescribed: bool) -> Array:
    """What accelerations follow from torques, (trials, 2, 2); of a primary whose motion is prescribed none."""
    inverse = np.zeros((trials, 2, 2))
    if prescribed:
        inverse[:, 1, 1] = float(coupled) / value("J2", 1.0)
    elif coupled:
        inverse[:] = np.linalg.inv(_mass(value))
    else:
        inverse[:, 0, 0] = 1.0 / value("J1", 0.0)
    return inverse


def _accelerating(a: Array, value: Callable[[str, float], Array], coupled: bool) -> Array:
    """Torques that the accelerations a (trials, 2, N) take, alike in shape; of an uncoupled rig the primary's."""
    if coupled:
        return np.asarray(np.einsum("jkl,jln->jkn", _mass(value), a))
    out = a.copy()
    out[:, 0] *= value("J1", 0.0)[:, None]
    return out


def _read_of_reaction(carried: Array, laws: Sequence[Array], unit: float) -> tuple[Array, Array]:
    """What the channel of a reaction shows of state and torques: (trials, n, 4) and (trials, 1, 2).

    carried (trials, 1) : of what acts on the secondary; laws (trials, n, 2, 2) each : change of the
    nominal ones with angles and with velocities.
    """
    state = [carried[:, :, None] * per[:, :, 1] - per[:, :, 0] for per in laws]
    torque = np.concatenate([-np.ones_like(carried), carried], axis=1)[:, None]
    return np.concatenate(state, axis=2) / unit, torque / unit


def nominal_slopes(fit: Calibration, block: Block, motion: Motion, step: float = 1e-3) -> Array:
    """By how much each parameter q of a nominal fit changes the torques of its laws, (trials, size, 2, N) N m.

    Along the motion as it is; a larger inertia counts as the torque that it takes to move it so.
    """
    problem, group = fit.problem, block.group
    n, size = len(group.trials), problem.size
    which: Any = np.tile(np.arange(n), size + 1)
    q = np.tile(fit.q, (size + 1, n, 1))
    q[np.arange(size), :, np.arange(size)] += step
    rig, _ = problem._inputs(group, which, q.reshape(-1, size), block.eta[which])  # noqa: SLF001

    def value(name: str, default: float = 0.0) -> Array:
        return np.broadcast_to(np.asarray(rig.get(name, default), float), which.shape).astype(float)

    th, w, a = (
        np.stack(pair, axis=1)[which]
        for pair in ((motion.th1, motion.th2), (motion.w1, motion.w2), (motion.a1, motion.a2))
    )
    pendulum = problem.experiment.restoring == "pendulum"
    parts = _parts(problem.experiment, value, group.coupled)
    torque = _nominal_torques(th, w, parts, group.coupled, pendulum, _tilt(group.inputs, motion.grid))
    mass = _mass(value) if group.coupled else value("J1")[:, None, None] * np.diag([1.0, 0.0])
    torque = (torque - np.einsum("jkl,jln->jkn", mass, a)).reshape(size + 1, n, 2, -1)
    return np.asarray(((torque[:-1] - torque[-1]) / step).transpose(1, 0, 2, 3))


def _nominal_torques(th: Array, w: Array, p: dict[str, Array], coupled: bool, pendulum: bool, tilt: Array) -> Array:
    """Torques of the nominal laws on both inertias, (trials, 2, N); nothing on the secondary of an uncoupled rig."""

    def column(name: str) -> Array:
        return p[name][:, None]

    def dry(x: Array) -> Array:
        return dry_sign(x, p["nu"], p["tail"])

    bent = np.sin(th) + tilt * np.cos(th) if pendulum else th
    out = np.zeros_like(th)
    out[:, 0] = -column("k1t") * bent[:, 0] - column("c1t") * w[:, 0] - column("drag") * dry(w[:, 0])
    if coupled:
        out[:, 1] = -column("k3t") * bent[:, 1] - column("c3t") * w[:, 1] - column("drag2") * dry(w[:, 1])
        phi, slip = th[:, 0] - th[:, 1], w[:, 0] - w[:, 1]
        pull = column("friction") * np.maximum(0.0, 1.0 - column("slope") * np.abs(phi))
        joint = column("k2t") * phi + column("c2t") * slip + pull * dry(slip)
        out[:, 0] -= joint
        out[:, 1] += joint
    return out


def _of_links(th: Array, w: Array, a: Array, value: Callable[[str, float], Array], p: dict[str, Array]) -> Array:
    """What two links in series (simulation/links.py) have beyond the torques of two bodies about one axis, N m."""
    beside = value("J12", 0.0)[:, None]
    phi, drag = th[:, 0] - th[:, 1], p["drag"][:, None] * dry_sign(w[:, 1], p["nu"], p["tail"])
    less, turning = beside * (1.0 - np.cos(phi)), beside * np.sin(phi)
    lever = beside / value("J2", 1.0)[:, None] * np.cos(phi)
    air = lever * p["c3t"][:, None]
    first = less * a[:, 1] - turning * w[:, 1] ** 2 - air * (w[:, 1] + lever * w[:, 0])
    second = less * a[:, 0] + turning * w[:, 0] ** 2 - air * w[:, 0] + drag
    return np.stack([first, second], axis=1)


def dry_sign(w: Array, nu: Array, tail: Array) -> Array:
    """The sign that dry friction gives speeds w (trials, N), -1 to 1: vector_math.smooth_sign; nu, tail (trials,)."""
    x, t = nu[:, None] * w, tail[:, None]
    if not tail.any():
        return np.asarray(np.tanh(x))
    root, arc = x / np.sqrt(1.0 + x * x), 2.0 / np.pi * np.arctan(0.5 * np.pi * x)
    return np.asarray(np.tanh(x) + 4.0 * t * (1.0 - t) * (root - np.tanh(x)) + t * (2.0 * t - 1.0) * (arc - np.tanh(x)))


def _secant(nu: Array, tail: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Slope of dry friction's sign averaged between the speeds a and b, and its mean value."""
    least = 1e-4 / np.maximum(nu, 1e-9)[:, None]
    near = np.abs(b - a) < least
    a, b = np.where(near, 0.5 * (a + b - least), a), np.where(near, 0.5 * (a + b + least), b)
    low, high = dry_sign(a, nu, tail), dry_sign(b, nu, tail)
    return (high - low) / (b - a), 0.5 * (low + high)


def _jacobian(
    th_a: Array, th_b: Array, w_a: Array, w_b: Array, p: dict[str, Array], coupled: bool, pendulum: bool, tilt: Array
) -> tuple[Array, Array]:
    """Derivatives of both torques by angles and velocities, averaged over steps from a to b; (trials, steps, 2, 2)."""
    trials, _, steps = th_a.shape
    K, C = np.zeros((trials, steps, 2, 2)), np.zeros((trials, steps, 2, 2))
    th = 0.5 * (th_a + th_b)

    def column(name: str) -> Array:
        return p[name][:, None]

    bend = np.cos(th) - tilt * np.sin(th) if pendulum else np.ones_like(th)
    slope1, _ = _secant(p["nu"], p["tail"], w_a[:, 0], w_b[:, 0])
    K[:, :, 0, 0] = -column("k1t") * bend[:, 0]
    C[:, :, 0, 0] = -column("c1t") - column("drag") * slope1
    if coupled:
        slope2, _ = _secant(p["nu"], p["tail"], w_a[:, 1], w_b[:, 1])
        K[:, :, 1, 1] = -column("k3t") * bend[:, 1]
        C[:, :, 1, 1] = -column("c3t") - column("drag2") * slope2
        phi = th[:, 0] - th[:, 1]
        ratio = np.maximum(0.0, 1.0 - column("slope") * np.abs(phi))
        slip_slope, slip_sign = _secant(p["nu"], p["tail"], w_a[:, 0] - w_a[:, 1], w_b[:, 0] - w_b[:, 1])
        t_phi = column("k2t") - column("friction") * column("slope") * np.sign(phi) * (ratio > 0.0) * slip_sign
        t_slip = column("c2t") + column("friction") * ratio * slip_slope
        sign = np.array([[-1.0, 1.0], [1.0, -1.0]])
        K += t_phi[:, :, None, None] * sign
        C += t_slip[:, :, None, None] * sign
    return K, C


def _steps(K: Array, C: Array, inverse: Array, h: Array) -> tuple[Array, Array]:
    """Transition and push of the state over steps of h (trials, steps) s, with A h = z:

        (1 + z/3) / (1 - 2z/3 + z^2/6),    (1 - z/6) / (1 - 2z/3 + z^2/6)

    of third order, and what a sharp friction damps within a step is gone after it (L-stable); by the trapezoidal
    rule it would ring from sample to sample.
    """
    trials, steps = h.shape
    A = np.zeros((trials, steps, 4, 4))
    A[:, :, 0, 2] = A[:, :, 1, 3] = 1.0
    A[:, :, 2:, :2] = inverse[:, None] @ K
    A[:, :, 2:, 2:] = inverse[:, None] @ C
    A *= h[:, :, None, None]
    B = np.zeros((trials, steps, 4, 2))
    B[:, :, 2:, :] = inverse[:, None] * h[:, :, None, None]
    one = np.eye(4)
    left = np.linalg.inv(one - A @ (2.0 / 3.0 * one - A / 6.0))
    return np.asarray(left @ (one + A / 3.0)), np.asarray(left @ (one - A / 6.0) @ B)


def _beside(steps: Array) -> Array:
    """What belongs to steps (trials, N - 1, ...) at the instants between them, (trials, N, ...)."""
    ends = np.concatenate([steps[:, :1], steps, steps[:, -1:]], axis=1)
    return np.asarray(0.5 * (ends[:, 1:] + ends[:, :-1]))


def _reading(
    th: Array, w: Array, a: Array, at: NDArray[np.int64], inverse: Array, K: Array, C: Array, coupled: bool,
    quantity: str,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Readings at the samples and their derivatives by state and torque.

    K, C (trials, N, 2, 2): of the torques, averaged over the steps on either side of each instant. The slope of a
    reversing friction at the instant itself holds for changes of 1/nu only, far less than what is asked for.
    """
    channels = 2 if coupled else 1
    trials, n = th.shape[0], at.size
    state = np.zeros((trials, n, 2, 4))
    torque = np.zeros((trials, n, 2, 2))
    if quantity == "displacement":
        y = th
        state[:, :, 0, 0] = state[:, :, 1, 1] = 1.0
    elif quantity == "velocity":
        y = w
        state[:, :, 0, 2] = state[:, :, 1, 3] = 1.0
    else:
        y = a
        state[:, :, :, :2] = inverse[:, None] @ K[:, at]
        state[:, :, :, 2:] = inverse[:, None] @ C[:, at]
        torque[:] = inverse[:, None]
    return (
        y[:, :channels][:, :, at],
        state[:, :, :channels].transpose(0, 2, 1, 3),
        torque[:, :, :channels].transpose(0, 2, 1, 3),
    )


# Judging columns ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Projected:
    """Gram matrix (k, k) of whitened columns and their product (k,) with the residuals, parameters taken out.

    `raw` (k,): squared lengths before that; `absorbed` (size, k): by how much the parameters give way to a column.
    """

    gram: Array
    product: Array
    raw: Array
    absorbed: Array


def whiten(fit: Calibration, group: Group, y: Array) -> Array:
    """Whitened columns (trials, k, data) of changes of the readings (trials, k, channels, n)."""
    return fit.problem.whitened(y, group.weight[:, None])


@dataclass(frozen=True, eq=False)
class _Piece:
    """What columns do on one part of the trials, nuisances taken out.

    gram (k, k), mixed (size, k), product (k,), raw (k,)
    """

    gram: Array
    mixed: Array
    product: Array
    raw: Array


@dataclass(frozen=True, eq=False)
class Pieces:
    """Columns on each part of the trials, for all that they can do on some of the parts only.

    names: of the parts, as `project_parts` was given them, hashable; runs: of columns between which products were made.
    """

    names: tuple[Any, ...]
    pieces: tuple[_Piece, ...]
    S: Array
    g: Array
    folded: Array
    """(size, unknowns): what each unknown that gives way is of the fit's parameters."""
    runs: tuple[slice, ...]

    def on(self, names: Collection[Any] | None = None) -> Projected:
        """The columns, zero on all parts but the named ones, after all that parameters can do is taken out."""
        chosen = [p for name, p in zip(self.names, self.pieces, strict=True) if names is None or name in names]
        gram = np.sum([p.gram for p in chosen], axis=0)
        mixed = np.sum([p.mixed for p in chosen], axis=0)
        product = np.sum([p.product for p in chosen], axis=0)
        raw = np.sum([p.raw for p in chosen], axis=0)
        k = len(raw)
        answer = np.linalg.solve(self.S, np.column_stack([mixed, self.g]))
        for run in self.runs:
            gram[run, run] -= mixed[:, run].T @ answer[:, run]
        product = product - mixed.T @ answer[:, k]
        return Projected(0.5 * (gram + gram.T), -product, raw, np.asarray(-self.folded @ answer[:, :k]))


def project_parts(
    fit: Calibration,
    columns: Iterable[Array],
    part: Callable[[int], Any],
    kinds: Callable[[], Sequence[Any]] | None = None,
) -> Pieces:
    """Columns (trials, k, data), one array per block, for each part of the trials: `part` names that of a trial.

    Columns are looked at once, in order, so that they can be made one block after the other.

    kinds : what each column is, asked for once the first ones are made: products are made between neighbours of a kind
    only, and zero between others; None: all are of a kind.

    The product's sign is that of "reading minus model": a coefficient c > 0 of a column adds it to the model.
    """
    added, folded = alike_in_all(fit)
    normals = fit.linear.normal(added)
    size = folded.shape[1]
    normals.S[range(fit.problem.size, size), range(fit.problem.size, size)] += 1.0
    S, g, inverses = normals.reduced()
    pieces: dict[Any, _Piece] = {}
    runs: tuple[slice, ...] = ()
    columns = iter(columns)
    for (block, H, TJ, gT), inverse, more in zip(normals.parts, inverses, added, strict=True):
        every = next(columns)
        live = _live(every)
        k = every.shape[1]
        runs = runs or _runs([None] * k if kinds is None else kinds())
        ends = np.searchsorted(live, [run.start for run in runs] + [k])
        if live.size < k:
            every = every[:, live]
        full = np.concatenate([block.J, more, block.T, block.r[:, None, :]], axis=1)
        names = [part(i) for i in block.group.trials]
        for name in dict.fromkeys(names):
            own = np.array([n == name for n in names])
            d = every if own.all() else every[own]
            flat = d.transpose(1, 0, 2).reshape(live.size, d.shape[0] * d.shape[2])
            gram = np.zeros((live.size, live.size))
            within = [slice(a, b) for a, b in itertools.pairwise(ends)]
            for run in within:
                gram[run, run] = flat[run] @ flat[run].T
            raw = np.diag(gram).copy()
            cross = full[own] @ d.transpose(0, 2, 1)  # (trials, size + m + 1, k)
            m = H.shape[1]
            mixed = cross[:, :size].sum(axis=0)
            product = cross[:, -1].sum(axis=0)
            if m:
                td = cross[:, size : size + m]
                solved = inverse[own] @ td
                for run in within:
                    gram[run, run] -= np.tensordot(td[:, :, run], solved[:, :, run], axes=([0, 1], [0, 1]))
                mixed -= np.tensordot(TJ[own], solved, axes=([0, 1], [0, 1]))
                product -= np.tensordot(solved, gT[own], axes=([0, 1], [0, 1]))
            if name not in pieces:
                pieces[name] = _Piece(np.zeros((k, k)), np.zeros((size, k)), np.zeros(k), np.zeros(k))
            whole = pieces[name]
            whole.gram[np.ix_(live, live)] += gram
            whole.mixed[:, live] += mixed
            whole.product[live] += product
            whole.raw[live] += raw
            del d, flat
        del every  # before the next ones are made
    return Pieces(tuple(pieces), tuple(pieces.values()), S, g, folded, runs)


def _runs(kinds: Sequence[Any]) -> tuple[slice, ...]:
    """Places of neighbours of one kind."""
    starts = [i for i, kind in enumerate(kinds) if i == 0 or kind != kinds[i - 1]]
    return tuple(slice(a, b) for a, b in itertools.pairwise([*starts, len(kinds)]))


def alike_in_all(fit: Calibration) -> tuple[list[Array], Array]:
    """Columns (trials, k, data) of each block that change a parameter by the same amount in all trials, and by how much
    each parameter of the fit and each of these columns moves that, (size, size + k).

    A parameter scatters in proportion to its value. Beside a term of the same form and sign opposite it might be
    larger and its scatter, in proportion, less than what was learnt: no law is missing for that.
    """
    problem = fit.problem
    blocks = fit.linear.blocks
    names = dict.fromkeys(n for b in blocks for n, _, _ in b.group.nuisances if n.startswith("ln_"))
    columns = []
    for b in blocks:
        at = {name: (i, mean, sd) for i, (name, mean, sd) in enumerate(b.group.nuisances)}
        column = np.zeros((b.T.shape[0], len(names), b.T.shape[2]))
        for k, name in enumerate(names):
            if name in at:
                i, mean, sd = at[name]
                column[:, k] = b.T[:, i] * (np.exp(-mean - sd * b.eta[:, i]) / sd)[:, None]
        columns.append(column)
    folded = np.eye(problem.size, problem.size + len(names))
    for k, name in enumerate(names):
        for i, c in enumerate(problem.coordinates):
            if c.parameter == name[3:]:
                value, slope = value_and_slope(c.prior, float(fit.q[i]))
                folded[i, problem.size + k] = value / slope if slope else 0.0
    return columns, folded


def _live(columns: Array) -> NDArray[np.intp]:
    """Which columns (trials, k, data) are not zero throughout: most show that at a few readings."""
    live = np.asarray(columns[:, :, ::16].any(axis=(0, 2)))
    silent = np.flatnonzero(~live)
    live[silent] = columns[:, silent].any(axis=(0, 2))
    return np.flatnonzero(live)


def project(fit: Calibration, columns: Iterable[Array]) -> Projected:
    """Columns (trials, k, data), one array per block, after all that parameters and nuisances can do is taken out.

    The product's sign is that of "reading minus model": a coefficient c > 0 of a column adds it to the model.
    """
    return project_parts(fit, columns, lambda _: None).on()


def scale_of(values: Sequence[Array]) -> float:
    """Largest absolute value, or 1 where all are zero."""
    largest = max((float(np.max(np.abs(v))) for v in values if v.size), default=0.0)
    return largest if largest > 0.0 and math.isfinite(largest) else 1.0
