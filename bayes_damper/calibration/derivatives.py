"""Whitened residuals of a problem and their derivatives, from differences of records that are simulated together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.groups import Bundle, Group
from bayes_damper.calibration.normal_equations import Block
from bayes_damper.calibration.own_values import RELEASE, channel_of, of_readings
from bayes_damper.calibration.unknowns import Coordinate
from bayes_damper.priors.distributions import Distribution, LogNormal, from_standard

Array = NDArray[np.float64]
Indices = NDArray[np.signedinteger[Any]]
RELEASE_STEP = 5e-6  # s, of a difference quotient by a trial's time of release: from none to some, readings jump
LEAST_STEP = 1e-4  # relative, of a difference quotient by a trial's own value of a parameter
READINGS_AT_ONCE = 50_000  # of the trials whose records are differentiated together


class Differentiable(Protocol):
    """What a problem must say of itself to be linearised."""

    size: int
    coordinates: tuple[Coordinate, ...]
    groups: list[Group]

    @property
    def bundles(self) -> list[Bundle]: ...

    def finer(self) -> Differentiable: ...

    def simulate(self, group: Group, which: Indices, q: Array, eta: Array) -> Array: ...

    def whitened(self, r: Array, weight: Array) -> Array: ...

    def acts(self, c: Coordinate, group: Group) -> bool: ...

    def touched(self, c: Coordinate, group: Group) -> NDArray[np.bool_]: ...


def blocks_of(
    problem: Differentiable, q: Array, eta: Mapping[int, Array], annealed: bool, central: bool, steps: Array | None
) -> tuple[Block, ...]:
    """Blocks of `linearise`, a bundle of groups at a time, the trials of a large one in turns."""
    blocks: dict[int, Block] = {}
    for bundle in problem.bundles:
        turns = [some for _, some in bundle.whole.turns(READINGS_AT_ONCE)]
        made = (_block(problem, some, q, eta, annealed, central, steps) for some in turns)
        b = next(made) if len(turns) == 1 else _joined(bundle.whole, made)
        for at, group in bundle.parts:
            blocks[id(group)] = Block(group, b.r[at], b.J[at], b.T[at], b.eta[at])
    return tuple(blocks[id(group)] for group in problem.groups)


def _joined(group: Group, parts: Iterable[Block]) -> Block:
    """The block of a group from those of its trials in turns, each let go once it is copied, in one array."""
    rows = np.zeros((0, 0, 0))
    own: list[Array] = []
    done = size = 0
    for part in parts:
        full = part.full
        if not own:
            rows, size = np.empty((len(group.trials), *full.shape[1:])), part.J.shape[1]
        rows[done : done + len(full)] = full
        done += len(full)
        own.append(part.eta)
    return Block(group, rows[:, -1], rows[:, :size], rows[:, size:-1], np.concatenate(own))


def _block(
    problem: Differentiable,
    group: Group,
    q: Array,
    eta: Mapping[int, Array],
    annealed: bool,
    central: bool,
    steps: Array | None,
) -> Block:
    """Residuals and derivatives of one group."""
    differences = problem.finer() if central else problem
    steps = np.full(problem.size, 2e-3) if steps is None else steps
    # Unknowns of different cases or springs never meet in a trial: they share a simulation.
    together: dict[str, list[int]] = {}
    for i, c in enumerate(problem.coordinates):
        if problem.acts(c, group):
            together.setdefault(c.name if c.role == "effect" else c.parameter, []).append(i)
    n = len(group.trials)
    m = len(group.nuisances)
    names = [name for name, _, _ in group.nuisances]
    shared = {
        name: together[name[3:]]
        for name in names
        if name.startswith("ln_") and _touch_all(problem, together.get(name[3:], []), group)
    }
    moved = [i for i, name in enumerate(names) if not of_readings(name) and name not in shared]
    lanes = 1 + len(together) + len(moved)
    sides = (1.0, -1.0) if central else (1.0,)
    base_q = np.tile(q, (n, 1))
    base_eta = np.array([eta[i] for i in group.trials]).reshape(n, m)
    rows_q = [base_q]
    rows_eta = [base_eta]
    trial_steps = np.full((n, m), 2e-3)
    for i, name in enumerate(names):
        if name == "delay":
            trial_steps[:, i] = 1e-6 / group.nuisances[i][2]
        elif name == RELEASE:
            trial_steps[:, i] = RELEASE_STEP / group.nuisances[i][2]
        elif name.startswith("ln_"):
            trial_steps[:, i] = np.maximum(trial_steps[:, i], LEAST_STEP / group.nuisances[i][2])
        trial_steps[:, i] *= np.where(base_eta[:, i] + trial_steps[:, i] > group.upper[:, i], -1.0, 1.0)
    for side in sides:
        for members in together.values():
            moved_q = base_q.copy()
            for i in members:
                moved_q[:, i] += side * steps[i]
            rows_q.append(moved_q)
            rows_eta.append(base_eta)
        for i in moved:
            moved_eta = base_eta.copy()
            moved_eta[:, i] += side * trial_steps[:, i]
            rows_q.append(base_q)
            rows_eta.append(moved_eta)
    copies = len(rows_q)
    y = differences.simulate(
        group, np.tile(np.arange(n), copies), np.concatenate(rows_q), np.concatenate(rows_eta)
    ).reshape(copies, n, -1, group.y.shape[-1])
    base = y[0]
    shown = problem.simulate(group, np.arange(n), base_q, base_eta) if central else base
    forward = y[1:lanes]
    forward -= base
    if central:
        backward = y[lanes:]
        backward -= base
        bad = np.asarray(~np.isfinite(np.sum(backward, axis=(2, 3))))
        for k, i in enumerate(moved):
            # Beyond the end of a nuisance's range a reading may jump: the release is another sample's.
            back = base_eta[:, i] - trial_steps[:, i]
            bad[len(together) + k] |= (back < group.lower[:, i]) | (back > group.upper[:, i])
        backward[bad] = -forward[bad]
        forward -= backward
        forward *= 0.5
    forward[~np.isfinite(np.sum(forward, axis=(2, 3)))] = 0.0
    weight = group.weights(annealed)
    w = problem.whitened(forward, weight)  # (lanes - 1, n, data)
    rows = np.zeros((n, problem.size + m + 1, w.shape[-1]))
    jac, own, r = rows[:, : problem.size], rows[:, problem.size : -1], rows[:, -1]
    r[...] = problem.whitened(shown - group.y, weight)
    for k, members in enumerate(together.values()):
        for i in members:
            hit = problem.touched(problem.coordinates[i], group)
            np.divide(w[k], steps[i], out=jac[:, i], where=hit[:, None])
    for k, i in enumerate(moved):
        np.divide(w[len(together) + k], trial_steps[:, i, None], out=own[:, i])
    for i, name in enumerate(names):
        if name.startswith("gain"):
            own[:, i] = _of_readings(problem, group, i, shown, base_eta, weight)
        elif of_readings(name):  # the same wherever the fit is
            if (name, annealed) not in group.kept:
                group.kept[name, annealed] = _of_readings(problem, group, i, shown, base_eta, weight)
            own[:, i] = group.kept[name, annealed]
    for name, members in shared.items():
        place = names.index(name)
        for i in members:
            hit = problem.touched(problem.coordinates[i], group)
            per_log = _log_slope(problem.coordinates[i].prior, float(q[i]))
            own[hit, place] = jac[hit, i] * (group.nuisances[place][2][hit, None] / per_log)
    return Block(group, r, jac, own, base_eta)


def _of_readings(
    problem: Differentiable, group: Group, nuisance: int, shown: Array, eta: Array, weight: Array
) -> Array:
    """Whitened change of the readings by a unit of a nuisance that acts on them, (trials, data)."""
    column = _own_readings(group, nuisance, shown, eta)
    return problem.whitened(group.nuisances[nuisance][2][:, None, None] * column, weight)


def _own_readings(group: Group, nuisance: int, shown: Array, eta: Array) -> Array:
    """Change of the readings `shown` at eta by a unit of one trial's own gain, offset or drift, of their shape."""
    name = group.nuisances[nuisance][0]
    out = np.zeros_like(shown)
    if not name.startswith("gain"):
        out[:] = group.shape(name)
        return out
    channel = channel_of(name)
    out[:, channel] = shown[:, channel]
    for k, (other, mean, sd) in enumerate(group.nuisances):
        x = mean + sd * eta[:, k]
        if k != nuisance and of_readings(other) and channel_of(other) in (channel, -1):
            out[:, channel] -= x[:, None] * group.shape(other)[..., channel, :]
        elif k == nuisance:
            scale = 1.0 + x
    out[:, channel] /= scale[:, None]
    return out


def _touch_all(problem: Differentiable, coordinates: Sequence[int], group: Group) -> bool:
    """Whether every trial of a group has one of these unknowns."""
    none = np.zeros(len(group.trials), dtype=np.bool_)
    return bool(sum((problem.touched(problem.coordinates[i], group) for i in coordinates), none).all())


def _log_slope(distribution: Distribution, z: float) -> float:
    """Change of the logarithm of a scale parameter by one unit of its standard coordinate, at z."""
    if isinstance(distribution, LogNormal):
        return math.log(distribution.factor)
    low, high = float(from_standard(distribution, z - 1e-3)), float(from_standard(distribution, z + 1e-3))
    return math.log(high / low) / 2e-3 if 0.0 < low < high else 1.0
