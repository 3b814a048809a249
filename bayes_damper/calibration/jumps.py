"""Evidence of trials of which a reading lies in the jump of its release.

An acceleration jumps where the rig is let go. A fit may put the end of a sudden release on the very instant of a
reading: there the reading's slope by that instant is the jump over next to nothing, as if it were known to nanoseconds.
But just before the jump and just after it the cost may be as low, over all the instants that the next readings allow,
and that is where the probability lies. A Laplace approximation at the reading alone would miss a factor of up to a
thousand for each such trial, by which of two models one seems likelier whose fit happened to stop beside the reading.

So such a trial has the larger of what lies in the jump and what lies beside it. There the reading has no slope by the
instant, and shows the acceleration before the release or after it: two halves of a Gaussian, as the jump ends them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.groups import Group
from bayes_damper.calibration.normal_equations import Normals
from bayes_damper.calibration.own_values import RELEASE
from bayes_damper.calibration.problem import Problem

Array = NDArray[np.float64]
STEP = 2e-6  # s from a reading, at which it is out of the jump: twice the step of the differences that give its slope


def beside_jumps(problem: Problem, normals: Normals) -> float:
    """What is added to the log evidence of a fit for its trials of which a reading lies in the jump."""
    if problem.experiment.quantity != "acceleration":
        return 0.0
    eta: dict[int, Array] = {}
    cost: dict[int, float] = {}
    moved: dict[int, Array] = {}
    wider: dict[int, float] = {}
    for block, H, _, _ in normals.parts:
        group = block.group
        eta |= dict(zip(group.trials, block.eta, strict=True))
        names = [name for name, _, _ in group.nuisances]
        if "delay" not in names:
            continue
        d = names.index("delay")
        timing = [d, *(k for k, name in enumerate(names) if name == RELEASE)]
        for k, i in enumerate(group.trials):
            begins, ends = _jump(group, k, eta[i])
            inside = (group.times > begins - STEP) & (group.times < ends + STEP)
            hit = np.flatnonzero(inside & (group.weight[k][0] > 0.0))
            if not hit.size:
                continue
            first, last = group.times[hit[[0, -1]]]
            to = np.array([first - STEP - ends, last + STEP - begins]) / group.nuisances[d][2][k] + eta[i][d]
            to = to[(group.lower[k, d] <= to) & (to <= group.upper[k, d])]
            cost[i] = float(block.r[k] @ block.r[k] + eta[i] @ eta[i])
            moved[i] = np.tile(eta[i], (to.size, 1))
            moved[i][:, d] = to
            # What the readings in the jump say of its instant is left out.
            impulses = np.zeros((hit.size, *group.y.shape[1:]))
            impulses[np.arange(hit.size), 0, hit] = 1.0
            basis, _ = np.linalg.qr(problem.whitened(impulses, group.weight[k]).T)
            T = block.T[k].copy()
            T[timing] -= (T[timing] @ basis) @ basis.T
            wider[i] = 0.5 * float(np.linalg.slogdet(H[k])[1] - np.linalg.slogdet(T @ T.T + np.eye(len(T)))[1])
    sides = max(map(len, moved.values()), default=0)
    if not sides:
        return 0.0
    tried = {i: np.tile(v, (sides, 1)) for i, v in eta.items()}
    for i, others in moved.items():
        tried[i][: len(others)] = others
    costs = problem.costs_of_trials(np.tile(normals.linear.q, (sides, 1)), tried)
    total = 0.0
    for i, others in moved.items():
        worse = costs[i][: len(others)] - cost[i]
        worse[~np.isfinite(worse)] = np.inf
        total += max(float(np.logaddexp.reduce(wider[i] - 0.5 * worse - math.log(2.0), initial=-np.inf)), 0.0)
    return total


def _jump(group: Group, k: int, own: Array) -> tuple[float, float]:
    """When the release of trial k begins and ends, s, with its own values (m,)."""
    value = {name: float(mean[k] + sd[k] * x) for (name, mean, sd), x in zip(group.nuisances, own, strict=True)}
    return value["delay"] - value.get(RELEASE, 0.0), value["delay"]
