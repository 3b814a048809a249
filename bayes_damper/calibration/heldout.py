"""Trials that no fit has seen: only their own nuisances are fitted."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.derivatives import LEAST_STEP, RELEASE_STEP, Indices
from bayes_damper.calibration.groups import Group
from bayes_damper.calibration.least_squares import Calibration
from bayes_damper.calibration.normal_equations import step_within
from bayes_damper.calibration.own_values import RELEASE, middle_of, of_readings

Array = NDArray[np.float64]
ROUNDS, NEAR = 12, 1.5  # rounds from every start, in steps of at most so many sizes of a nuisance
MORE, FAR = 48, 6.0  # further rounds, from the best start of a trial that is not there yet
ARRIVED = 0.01  # the cost hardly falls any more


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a fit says about a trial that it has not seen, its own nuisances fitted.

    model (channels, n), residual (channels, n) = reading - model, eta (m,), chi2: whitened and weighted; n_data:
    weighted number of readings.
    """

    trial: int
    model: Array
    residual: Array
    eta: Array
    chi2: float
    n_data: float


def predict(fit: Calibration, trials: Sequence[int]) -> dict[int, Prediction]:
    """Predictions for trials that the fit has not used: only their own nuisances are estimated, from several starts.

    Where a model misses much, a trial's own values lie tens of sizes off: the best start goes on until it is there.
    """
    problem = fit.problem
    out: dict[int, Prediction] = {}
    for group in problem.grouped(tuple(trials)):
        n, m = len(group.trials), len(group.nuisances)
        starts = _starts([name for name, _, _ in group.nuisances])
        k = len(starts)
        which = np.repeat(np.arange(n), k)
        eta, cost, gain = _descend(fit, group, which, np.tile(starts, (n, 1)), ROUNDS if m else 0, (0, 3), NEAR)
        winner = cost.reshape(n, k).argmin(axis=1) + np.arange(n) * k
        chosen = eta[winner]
        far = np.flatnonzero(gain[winner] > ARRIVED)
        if far.size:
            chosen[far] = _descend(fit, group, far, chosen[far], MORE, range(0, MORE, 4), FAR)[0]
        y = problem.simulate(group, np.arange(n), np.tile(fit.q, (n, 1)), chosen)
        r = problem.whitened(y - group.y, group.weight)
        for j, i in enumerate(group.trials):
            residual = problem.experiment.trials[i].y - y[j]
            out[i] = Prediction(i, y[j], residual, chosen[j], float(r[j] @ r[j]), float(np.sum(group.weight[j] ** 2)))
    return out


def _starts(names: Sequence[str]) -> Array:
    """Points to begin from, (starts, m): instants before and after the likely one, releases at once and slow."""
    m = len(names)
    starts = [np.zeros(m)]
    if "delay" in names:
        for value in (-1.2, -0.8, -0.4, 0.4, 0.8, 1.2):
            point = np.zeros(m)
            point[names.index("delay")] = value
            starts.append(point)
    if RELEASE in names:
        starts += [point + middle_of(RELEASE) * np.eye(m)[names.index(RELEASE)] for point in starts]
    return np.array(starts).reshape(len(starts), m)


def _descend(
    fit: Calibration, group: Group, which: Indices, eta: Array, rounds: int, renewed: Container[int], most: float
) -> tuple[Array, Array, Array]:
    """Damped Gauss-Newton steps in the nuisances alone: where each row ends, its cost, and what its last round gained.

    which : trial of the group of each row of eta (rows, m); renewed : rounds in which derivatives by what acts nearly
    linearly are taken; most : the largest step, in sizes.
    """
    problem = fit.problem
    names = [name for name, _, _ in group.nuisances]
    rows, m = eta.shape
    low, high, weight = group.lower[which], group.upper[which], group.weight[which]
    eta = np.clip(eta, low, high)

    def evaluate(values: Array) -> tuple[Array, Array]:
        y = problem.simulate(group, which, np.tile(fit.q, (rows, 1)), values)
        r = problem.whitened(y - group.y[which], weight)
        total = np.einsum("ij,ij->i", r, r) + np.sum(values**2, axis=1)
        return r, np.where(np.isfinite(total), total, np.inf)

    r, cost = evaluate(eta)
    gain = np.zeros(rows)
    damping = np.full(rows, 1e-2)
    T = np.zeros((rows, m, r.shape[1]))
    for number in range(rounds):
        for i, name in enumerate(names):
            if number not in renewed and (name.startswith("ln_") or of_readings(name)):
                continue  # nearly linear
            if of_readings(name) and not name.startswith("gain"):
                column = group.nuisances[i][2][:, None, None] * group.shape(name)
                T[:, i] = problem.whitened(column, group.weight)[which]
                continue
            step = np.full(rows, 2e-3) if name != "delay" else 1e-6 / group.nuisances[i][2][which]
            if name == RELEASE:
                step = RELEASE_STEP / group.nuisances[i][2][which]
            elif name.startswith("ln_"):
                step = np.maximum(step, LEAST_STEP / group.nuisances[i][2][which])
            step = np.where(eta[:, i] + step > high[:, i], -step, step)
            moved = eta.copy()
            moved[:, i] += step
            T[:, i] = (evaluate(moved)[0] - r) / step[:, None]
        T = np.nan_to_num(T)
        H = T @ T.transpose(0, 2, 1) + np.eye(m)
        H += damping[:, None, None] * H * np.eye(m)
        g = np.einsum("imd,id->im", T, np.nan_to_num(r)) + eta
        move = step_within(H, g, low - eta, high - eta)
        move *= np.minimum(1.0, most / np.maximum(np.abs(move).max(axis=1), 1e-12))[:, None]
        candidate = np.clip(eta + move, low, high)
        r_new, cost_new = evaluate(candidate)
        better = cost_new < cost
        gain = np.where(better, cost - cost_new, 0.0)
        done = np.all(~better | (gain < ARRIVED)) and np.all(damping < 1e3)
        eta = np.where(better[:, None], candidate, eta)
        r = np.where(better[:, None], r_new, r)
        damping = np.where(better, damping * 0.1, damping * 30.0)
        cost = np.where(better, cost_new, cost)
        if done:
            break
    return eta, cost, gain
