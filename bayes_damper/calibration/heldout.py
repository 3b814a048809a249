"""Trials that no fit has seen: only their own nuisances are fitted."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.derivatives import LEAST_STEP, RELEASE_STEP, Indices
from bayes_damper.calibration.groups import Group
from bayes_damper.calibration.least_squares import HOPELESS, HURRY, SAME_COST, SAME_PLACE, Calibration, calibrate
from bayes_damper.calibration.normal_equations import step_within
from bayes_damper.calibration.own_values import RELEASE, middle_of, of_readings
from bayes_damper.calibration.problem import Problem

Array = NDArray[np.float64]
ROUNDS, NEAR = 12, 1.5  # rounds from every start, in steps of at most so many sizes of a nuisance
MORE, FAR = 48, 6.0  # further rounds, from the best start of each trial
ARRIVED = 0.01  # the cost hardly falls any more
KEPT = 2  # predictions of a problem that are held
PATIENT = 5  # rounds before a row is given up for being far behind
STUCK = 1e3  # damping by which no step has gained
STANDS_OUT, MISSED = 4.0, 60.0  # cost per reading over the median trial's, and beyond it, of a trial looked at again


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a fit says about a trial that it has not seen, its own nuisances fitted.

    model (channels, n), residual (channels, n) = reading - model, over the spread of its noise (`TrialRecord.spread`),
    eta (m,), chi2: whitened and weighted; n_data: weighted number of readings.
    """

    trial: int
    model: Array
    residual: Array
    eta: Array
    chi2: float
    n_data: float


_KNOWN: WeakKeyDictionary[Problem, dict[tuple[bytes, tuple[int, ...]], dict[int, Prediction]]] = WeakKeyDictionary()
"""The last predictions of each problem, by q and trials: a diagnosis asks for those of its answers again and again."""


_WITHOUT: WeakKeyDictionary[Calibration, Calibration] = WeakKeyDictionary()
"""Fits without held-out trials, by those with them."""


def unseeing(fit: Calibration) -> Calibration:
    """The fit as it is without the trials held out: the same, where they are not among those that it was fitted to.

    Noise and sizes of scatter stay.
    """
    problem = fit.problem
    heldout = set(problem.experiment.heldout)
    if not heldout & set(problem.trials):
        return fit
    if (known := _WITHOUT.get(fit)) is None:
        fewer = problem.for_trials([i for i in problem.trials if i not in heldout])
        keep = [problem.names.index(name) for name in fewer.names]
        eta = {i: fit.eta[i] for i in fewer.trials}
        known = _WITHOUT[fit] = calibrate(fewer, [fit.q[keep]], eta=eta, anneal=False)
    return known


def predict(fit: Calibration, trials: Sequence[int]) -> dict[int, Prediction]:
    """Predictions for trials that the fit has not used: only their own nuisances are estimated, from several starts.

    Where a model misses much, a trial's own values lie tens of sizes off: the best start goes on until it is there.
    """
    known = _KNOWN.setdefault(fit.problem, {})
    key = (fit.q.tobytes(), tuple(sorted(trials)))
    found = known.pop(key, None) or _predicted(fit, key[1])
    known[key] = found
    if len(known) > KEPT:
        del known[next(iter(known))]
    return dict(found)


def _predicted(fit: Calibration, trials: tuple[int, ...]) -> dict[int, Prediction]:
    """What `predict` gives."""
    problem = fit.problem
    out: dict[int, Prediction] = {}
    for group in problem.grouped(trials):
        n, m = len(group.trials), len(group.nuisances)
        starts = _starts([name for name, _, _ in group.nuisances])
        k = len(starts)
        which = np.repeat(np.arange(n), k)
        eta, cost = _descend(fit, group, which, np.tile(starts, (n, 1)), ROUNDS if m else 0, (0, 3), NEAR)
        winner = cost.reshape(n, k).argmin(axis=1) + np.arange(n) * k
        chosen = eta[winner]
        if m:
            chosen = _descend(fit, group, np.arange(n), chosen, MORE, range(MORE), FAR)[0]
        y = problem.simulate(group, np.arange(n), np.tile(fit.q, (n, 1)), chosen)
        r = problem.whitened(y - group.y, group.weight)
        for j, i in enumerate(group.trials):
            trial = problem.experiment.trials[i]
            residual = trial.steady(trial.y - y[j])
            out[i] = Prediction(i, y[j], residual, chosen[j], float(r[j] @ r[j]), float(np.sum(group.trust[j] ** 2)))
    return out


def freed(fit: Calibration, most: int) -> Calibration:
    """The fit, gone on by at most so many steps where trials that stand out have better values of their own.

    Where the first fit of a model misses much, the own values of a trial may be caught in a valley that no descent of
    all unknowns together leaves.
    """
    blocks = fit.linear.blocks
    cost = np.concatenate([np.sum(b.r**2, axis=1) + np.sum(b.eta**2, axis=1) for b in blocks])
    readings = np.concatenate([np.sum(b.group.trust**2, axis=(1, 2)) for b in blocks])
    usual = np.quantile(cost / readings, 0.5, method="lower") * readings
    trials = [i for b in blocks for i in b.group.trials]
    odd = {i: c for i, c, u in zip(trials, cost, usual, strict=True) if c > max(STANDS_OUT * u, u + MISSED)}
    found = predict(fit, list(odd)) if odd else {}
    better = {i: p.eta for i, p in found.items() if p.chi2 + float(p.eta @ p.eta) < odd[i] - MISSED}
    if not better:
        return fit
    again = calibrate(fit.problem, [fit.q], eta=dict(fit.eta) | better, anneal=False, most=most)
    return again if again.cost < fit.cost else fit


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
) -> tuple[Array, Array]:
    """Damped Gauss-Newton steps in the nuisances alone: where each row ends, and its cost.

    which : trial of the group of each row of eta (rows, m); renewed : rounds in which derivatives by what acts nearly
    linearly are taken; most : the largest step, in sizes. A row goes on until it is there, or is seen to lead nowhere.
    """
    problem = fit.problem
    names = [name for name, _, _ in group.nuisances]
    rows, m = eta.shape
    low, high, weight = group.lower[which], group.upper[which], group.weight[which]
    eta = np.clip(eta, low, high)

    def evaluate(values: Array) -> tuple[Array, Array]:
        y = problem.simulate(group, which, np.tile(fit.q, (len(which), 1)), values)
        r = problem.whitened(y - group.y[which], weight)
        total = np.einsum("ij,ij->i", r, r) + np.sum(values**2, axis=1)
        return r, np.where(np.isfinite(total), total, np.inf)

    r, cost = evaluate(eta)
    ends, costs = eta.copy(), cost.copy()
    live = np.arange(rows)
    damping = np.full(rows, 1e-2)
    T = np.zeros((rows, m, r.shape[1]))
    better = np.ones(rows, dtype=np.bool_)
    for number in range(rounds):
        known = number - 1 in renewed and not better.any()
        for i, name in enumerate(names):
            if known or (number not in renewed and (name.startswith("ln_") or of_readings(name))):
                continue  # no row has moved, or nearly linear
            if of_readings(name) and not name.startswith("gain"):
                column = group.nuisances[i][2][:, None, None] * group.shape(name)
                T[:, i] = problem.whitened(column, group.weight)[which]
                continue
            step = np.full(len(which), 2e-3) if name != "delay" else 1e-6 / group.nuisances[i][2][which]
            if name == RELEASE:
                step = RELEASE_STEP / group.nuisances[i][2][which]
            elif name.startswith("ln_"):
                step = np.maximum(step, LEAST_STEP / group.nuisances[i][2][which])
            step = np.where(eta[:, i] + step > high[:, i], -step, step)
            beside = eta.copy()
            beside[:, i] += step
            T[:, i] = (evaluate(beside)[0] - r) / step[:, None]
        T = np.nan_to_num(T)
        H = T @ T.transpose(0, 2, 1) + np.eye(m)
        H += damping[:, None, None] * H * np.eye(m)
        g = (T @ np.nan_to_num(r)[:, :, None])[:, :, 0] + eta
        move = step_within(H, g, np.maximum(low - eta, -most), np.minimum(high - eta, most))
        candidate = np.clip(eta + move, low, high)
        r_new, cost_new = evaluate(candidate)
        better = cost_new < cost
        gain = np.where(better, cost - cost_new, 0.0)
        eta = np.where(better[:, None], candidate, eta)
        r = np.where(better[:, None], r_new, r)
        damping = np.where(better, damping * 0.1, damping * 30.0)
        cost = np.where(better, cost_new, cost)
        ends[live], costs[live] = eta, cost
        arrived = np.where(better, gain < ARRIVED, damping > STUCK)
        on = np.flatnonzero(~arrived & ~_idle(which, eta, cost, gain, number))
        if on.size == 0:
            break
        if on.size < len(which):
            live, which, weight, low, high = live[on], which[on], weight[on], low[on], high[on]
            eta, cost, damping, r, T = eta[on], cost[on], damping[on], r[on], T[on]
    return ends, costs


def _idle(which: Indices, eta: Array, cost: Array, gain: Array, number: int) -> NDArray[np.bool_]:
    """Which rows lead to no end that another row of the same trial does not reach: hopeless ones, and second ones."""
    out = np.zeros(len(which), dtype=np.bool_)
    for trial in np.unique(which):
        own = np.flatnonzero(which == trial)
        behind = cost[own] - cost[own].min()
        hopeless = (behind > HOPELESS) & (HURRY * gain[own] < behind) & (number >= PATIENT)
        near = np.abs(eta[own][:, None] - eta[own]).max(axis=2, initial=0.0) < SAME_PLACE
        near &= np.abs(behind[:, None] - behind) < SAME_COST
        ahead = (behind < behind[:, None]) | ((behind == behind[:, None]) & (own < own[:, None]))
        out[own] = hopeless | (near & ahead).any(axis=1)
    return out
