"""The fit: damped Gauss-Newton steps from several starts, and the Laplace evidence at the end of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri

from bayes_damper.calibration.jumps import beside_jumps
from bayes_damper.calibration.kept_fits import keep, kept_end, place_of
from bayes_damper.calibration.normal_equations import Block, Linear, Normals
from bayes_damper.calibration.problem import Problem
from bayes_damper.calibration.unknowns import coordinate_of, value_and_slope
from bayes_damper.calibration.unlearnt import gained_over_sizes
from bayes_damper.priors.distributions import (
    columns_from_standard,
    from_standard,
    median,
)
from bayes_damper.runs.parallel_map import forked_map
from bayes_damper.runs.threads import threads_allowed

Array = NDArray[np.float64]
REACH = 1.5  # of a step in each coordinate
FACTORS = (0.03, 0.3, 3.0, 30.0)  # on the damping, of the steps that are compared
BEND_STEP = 0.01  # of differences by a coordinate
GAINED = 0.02  # of the cost by a step, below which a descent has ended
OF_EXCESS = 1e-4  # the same, of what is left beyond noise: the last nats of a model that misses by far decide nothing
NEAR_END = 0.1  # of the way to where a value's prior ends that a step along the values leaves
HOPELESS, HURRY = 60.0, 6.0  # cost above a target, and in how many such steps it must be reachable, to go on
NEARLY = 0.01  # share of the way to a target, of which no more is left where a descent goes on however slow it is
FAR_BEHIND = 600.0  # cost above a target from which forward differences are good enough for the evidence
DRAWN, STARTS = 512, 6  # draws from the prior, and the best of them from which descents begin
MOST_SENT = 12_000_000  # bytes of a fit's derivatives up to which they are sent: a dozen fits are on their way at once
SAME_COST, SAME_PLACE = 1.0, 0.05  # difference of costs, and of each coordinate, of two descents in one valley

Essence = tuple[Array, dict[int, Array], float, bool, int, bool, tuple[tuple[Array, Array, Array, Array], ...]]


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted model.

    q (size,), covariance (size, size) in coordinates with standard Gaussian priors; eta: trial -> (m,);
    chi2: sum of squared whitened residuals; cost: chi2 and the priors' share; n_data: weighted number of readings.
    """

    problem: Problem
    q: Array
    eta: Mapping[int, Array]
    covariance: Array
    cost: float
    chi2: float
    log_evidence: float
    converged: bool
    linear: Linear
    iterations: int

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of every unknown of the campaign."""
        out = {}
        for i, c in enumerate(self.problem.coordinates):
            low, high = self._within(i, 1.0)
            out[c.name] = (float(from_standard(c.prior, self.q[i])), 0.5 * (high - low))
        return out

    @property
    def excess(self) -> float:
        """Chi-square beyond what noise alone would leave."""
        return self.chi2 - self.problem.n_data

    @property
    def pulled(self) -> dict[str, float]:
        """Declared constants, of rig and sensors, that the fit moved by more than 3 of their standard deviations."""
        return {
            c.name: float(self.q[i])
            for i, c in enumerate(self.problem.coordinates)
            if c.role in ("constant", "stiffness", "sensor", "lag") and abs(self.q[i]) > 3.0
        }

    def interval(self, name: str, share: float = 0.9) -> tuple[float, float]:
        """Central interval of one unknown, holding `share` of its probability."""
        return self._within(self.problem.names.index(name), float(ndtri(0.5 + 0.5 * share)))

    def _within(self, i: int, sds: float) -> tuple[float, float]:
        """Values so many standard deviations to either side of one unknown.

        Where what formulas leave open (`widened`) exceeds its prior, these end where the prior's own about the fit and
        about its middle do.
        """
        q, sd = float(self.q[i]), math.sqrt(max(self.covariance[i, i], 0.0))
        prior = self.problem.coordinates[i].prior
        low = float(from_standard(prior, max(q - sds * sd, min(q, 0.0) - sds)))
        high = float(from_standard(prior, min(q + sds * sd, max(q, 0.0) + sds)))
        return (low, high) if low <= high else (high, low)

    def residuals(self) -> dict[int, Array]:
        """Reading minus model of each fitted trial, (channels, n), over the spread of its noise; nan where missing."""
        trials = self.problem.experiment.trials
        return {i: trials[i].steady(trials[i].y - y) for i, y in self.simulated().items()}

    def simulated(self) -> dict[int, Array]:
        """What the model gives for each fitted trial, (channels, n)."""
        out: dict[int, Array] = {}
        for group in self.problem.groups:
            n = len(group.trials)
            values = np.array([self.eta[i] for i in group.trials]).reshape(n, -1)
            y = self.problem.simulate(group, np.arange(n), np.tile(self.q, (n, 1)), values)
            out |= dict(zip(group.trials, y, strict=True))
        return out


def calibrate(
    problem: Problem,
    starts: Iterable[ArrayLike] = (),
    *,
    eta: Mapping[int, Array] | None = None,
    most: int = 25,
    finish: bool = True,
    anneal: bool = True,
    give_up: float = math.inf,
    target: float = -math.inf,
    straight: bool = False,
) -> Calibration:
    """The best fit over the starts, each by annealed, damped Gauss-Newton steps.

    starts : points (size,) in q; default the prior medians, with smoothing constants below and above;
    eta : nuisances to start from; most : iterations per stage; finish : central differences at the end, and steps by
    them for as long as they gain;
    give_up : a start whose cost after the first stage exceeds the best by more is not followed; target : a cost that
    another model has reached: a descent that gets nowhere near it, or the best one's end, ends early, and what ends far
    behind it is differentiated to one side only; straight : each step is tried along the values themselves too, not
    only along the coordinates, in which a valley of two terms that stand for each other is bent.
    A start that comes to where another one was is not followed further.

    A fit in which every simulation fails has cost inf and log_evidence -inf.
    """
    points = [np.asarray(s, float) for s in starts] or default_starts(problem)
    place = place_of(problem, points, eta, most, finish, anneal, give_up, target, straight)
    if known := kept_end(place, problem):
        q, own, converged, used, central = known
        return summarise(problem, q, own, converged, used, central)
    best: _End | None = None
    passed: list[_End] = []  # where descents have been after their first stage
    begun = [
        _End(math.inf, q, {i: v.copy() for i, v in (eta or problem.no_nuisance()).items()}, False, 0) for q in points
    ]
    if anneal:
        begun = forked_map(lambda start: _descend(problem, start, most, True, 0.5), begun, threads_allowed())
    for start in begun:
        if anneal:
            if best is not None and start.cost > best.cost + give_up:
                continue
            if any(_alike(start, other) for other in passed):
                continue
            passed.append(start)
        goals = [target] if best is None else [target, best.cost]
        goal = min((x for x in goals if x > -math.inf), default=-math.inf)
        end = _descend(problem, start, most, False, GAINED, goal, straight, best)
        if best is None or end.cost < best.cost:
            best = replace(end, iterations=start.iterations + end.iterations)
    assert best is not None
    cost, q, own, converged, used = best.cost, best.q, best.eta, best.converged, best.iterations
    behind = target > -math.inf and cost > target + FAR_BEHIND
    linear = problem.linearise(q, own, central=finish and not behind)
    damping = 1e-4
    for _ in range(most if finish and converged and not behind else 0):
        tried, moved_q, moved, moved_cost = _tried(problem, linear.normal(), damping, q, own, annealed=False)
        if not moved_cost < cost - _least(problem, cost, GAINED):
            break
        damping, q, own, cost, used = max(tried, 1e-7), moved_q, moved, moved_cost, used + 1
        linear = problem.linearise(q, own, central=True)
    keep(place, (q, own, converged, used, linear.central))
    return summarise(problem, q, own, converged, used, linear=linear)


def calibrate_each(
    problem: Problem, starts: Sequence[tuple[Array, Mapping[int, Array]]], **how: Any
) -> list[Calibration]:
    """The fit from each start (q, eta) by itself, with options of `calibrate`, in as many processes as are allowed."""

    def fitted(start: tuple[Array, Mapping[int, Array]]) -> Calibration:
        return calibrate(problem, [start[0]], eta=start[1], **how)

    if threads_allowed() < 2 or len(starts) < 2:  # nothing has to be sent
        return [fitted(start) for start in starts]
    found = forked_map(lambda start: essence(fitted(start)), starts, threads_allowed())
    return [restored(problem, each) for each in found]


def essence(fit: Calibration) -> Essence:
    """Of a fit, what has to be sent from one process to another."""
    blocks = fit.linear.blocks
    sent = blocks if sum(b.nbytes for b in blocks) < MOST_SENT else ()
    derivatives = tuple((b.r, b.J, b.T, b.eta) for b in sent)
    return fit.q, dict(fit.eta), fit.log_evidence, fit.converged, fit.iterations, fit.linear.central, derivatives


def restored(problem: Problem, found: Essence) -> Calibration:
    """The fit of a problem from its essence, in which its derivatives are: to differentiate again costs most."""
    q, eta, evidence, converged, iterations, central, derivatives = found
    blocks = tuple(Block(g, *arrays) for g, arrays in zip(problem.groups, derivatives, strict=bool(derivatives)))
    linear = problem.linearise(q, eta, central=central, known=blocks)
    return summarise(problem, q, eta, converged, iterations, linear=linear, evidence=evidence)


def default_starts(problem: Problem) -> list[Array]:
    """Prior medians, with a smooth and a sharp friction."""
    start = problem.prior_mean()
    if "nu" not in problem.names:
        return [start]
    i = problem.names.index("nu")
    prior = problem.coordinates[i].prior
    out = []
    for factor in (0.6, 1.8):
        point = start.copy()
        point[i] = coordinate_of(prior, factor * median(prior))
        out.append(point)
    return out


def drawn_starts(problem: Problem) -> list[Array]:
    """The best `STARTS` of `DRAWN` draws from the prior, always the same ones, each (size,).

    For costs of many valleys, as few trials have whose errors are correlated: there the valley that leads down from
    the prior medians was not the deepest one for some of a hundred campaigns.
    """
    q = np.random.default_rng(0).standard_normal((DRAWN, problem.size))
    own = {i: np.tile(v, (DRAWN, 1)) for i, v in problem.no_nuisance().items()}
    order = np.argsort(problem.costs(q, own, annealed=True), kind="stable")
    return [q[i] for i in order[:STARTS]]


def summarise(
    problem: Problem, q: Array, eta: Mapping[int, Array], converged: bool, iterations: int, central: bool = True,
    linear: Linear | None = None, evidence: float | None = None,
) -> Calibration:  # fmt: skip
    """Covariance, evidence and the rest at a point that a fit has reached.

    linear : the problem there, evidence : its logarithm, where they are known.
    """
    linear = problem.linearise(q, eta, central=central) if linear is None else linear
    normals = linear.normal()
    S, _, _ = normals.reduced()
    try:
        covariance = cho_solve(cho_factor(S), np.eye(problem.size))
        if evidence is None:
            evidence = normals.log_evidence() + gained_over_sizes(problem, normals) + beside_jumps(problem, normals)
    except (np.linalg.LinAlgError, ValueError):
        covariance, evidence = np.full((problem.size, problem.size), np.nan), -math.inf
    prior = float(q @ q) + sum(float(v @ v) for v in eta.values())
    cost = normals.cost if math.isfinite(normals.cost) else math.inf
    return Calibration(problem, q, dict(eta), covariance, cost, cost - prior, evidence, converged, linear, iterations)


@dataclass(frozen=True, eq=False)
class _End:
    """Where a descent has come to, whether it converged there, and with how many derivatives."""

    cost: float
    q: Array
    eta: dict[int, Array]
    converged: bool
    iterations: int


def _alike(one: _End, other: _End) -> bool:
    """Whether a descent is beside where another one has converged: it leads to the same end."""
    near = float(np.max(np.abs(one.q - other.q), initial=0.0)) < SAME_PLACE
    return other.converged and near and abs(one.cost - other.cost) < SAME_COST


def _descend(
    problem: Problem, start: _End, most: int, annealed: bool, tolerance: float, target: float = -math.inf,
    straight: bool = False, known: _End | None = None,
) -> _End:  # fmt: skip
    """Levenberg-Marquardt from one start; known : the end of another one, beside which this one stops."""
    q, eta = start.q, start.eta
    damping = 1e-2
    between = False  # whether instants of release stay between the readings that they lie between
    cost = float(problem.costs(q[None], {i: v[None] for i, v in eta.items()}, annealed)[0])
    if not math.isfinite(cost):
        return _End(cost, q, eta, False, 0)
    near = max(HOPELESS, NEARLY * (cost - target))
    for iteration in range(1, most + 1):
        normals = problem.linearise(q, eta, annealed=annealed).normal()
        accepted = False
        gained = 0.0
        for _ in range(3):
            tried, moved_q, moved, moved_cost = _tried(problem, normals, damping, q, eta, annealed, straight, between)
            if moved_cost < cost:
                gained = cost - moved_cost
                cost, q, eta = moved_cost, moved_q, moved
                damping = max(tried, 1e-7)
                accepted = True
                break
            damping *= 300.0 if math.isfinite(moved_cost) else 100.0
        ended = not accepted or gained < _least(problem, cost, tolerance)
        if ended and not between and _crosses(normals):
            ended, between, damping = False, True, 1e-2
        del normals  # before the next ones are made: they hold all derivatives
        end = _End(cost, q, eta, ended, iteration)
        if end.converged or (known is not None and _alike(end, known)):
            return end
        if math.isfinite(target) and iteration >= 3 and cost - target > near and HURRY * gained < cost - target:
            return end
    return _End(cost, q, eta, False, most)


def _crosses(normals: Normals) -> bool:
    """Whether the undamped step carries the instant of a release past a reading, at which an acceleration jumps.

    A jump is no slope: where it costs more than the step gains, every step fails, long before the descent's end.
    """
    released = [block for block, *_ in normals.parts if any(name == "delay" for name, _, _ in block.group.nuisances)]
    if not released:
        return False
    try:
        _, moves = normals.steps([0.0], REACH)
    except np.linalg.LinAlgError:
        return False
    for block in released:
        low, high = block.group.between_readings(block.eta)
        there = block.eta + np.array([moves[i][0] for i in block.group.trials])
        if np.any((there < low) | (there > high)):
            return True
    return False


def _least(problem: Problem, cost: float, tolerance: float) -> float:
    """Gain of a step below which a descent has ended."""
    return max(tolerance, OF_EXCESS * (cost - problem.n_data))


def _tried(
    problem: Problem, normals: Normals, damping: float, q: Array, eta: Mapping[int, Array], annealed: bool,
    straight: bool = False, between: bool = False,
) -> tuple[float, Array, dict[int, Array], float]:  # fmt: skip
    """The best of four steps, damped by about `damping`: its damping, where it leads, and the cost there.

    straight : of eight, the same four along the values too; between : instants stay between the same readings.

    The cost is inf where no step can be made.
    """
    bounds = {i: (g.lower[k], g.upper[k]) for g in problem.groups for k, i in enumerate(g.trials)}
    try:
        moves, own_moves = normals.steps([damping * x for x in FACTORS], REACH, _bend(problem, q, normals.g), between)
    except np.linalg.LinAlgError:
        return damping, q, dict(eta), math.inf
    steps = []
    for k, factor in enumerate(FACTORS):
        dq = np.clip(moves[k], -REACH, REACH)
        moved = {i: np.clip(eta[i] + own_moves[i][k], *bounds[i]) for i in eta}
        steps.append((damping * factor, q + dq, moved))
        if straight:
            along, share = _along_values(problem, q, dq)
            moved = {i: np.clip(eta[i] + share * own_moves[i][k], *bounds[i]) for i in eta}
            steps.append((damping * factor, along, moved))
    costs = problem.costs(
        np.array([s[1] for s in steps]), {i: np.array([s[2][i] for s in steps]) for i in eta}, annealed
    )
    k = int(np.argmin(costs))
    return *steps[k], float(costs[k])


def _bend(problem: Problem, q: Array, g: Array) -> Array:
    """Curvature of the cost, (size,), that comes from how values hang on coordinates: of a bounded value, near its end.

    g (size,) : half the cost's gradient. A record is more nearly linear in a value, or in the logarithm of a scale,
    than in a coordinate in which the end of its range is infinitely far. Only what makes a step shorter.
    """
    priors = tuple(c.prior for c in problem.coordinates)
    values = columns_from_standard(priors, q + np.array([[-BEND_STEP], [0.0], [BEND_STEP]]))
    scales = [prior.coordinate == "log" for prior in priors]
    values[scales] = np.log(values[scales])
    low, here, high = values.T
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = (g - q) * (high - 2.0 * here + low) / (high - low) * 2.0 / BEND_STEP
    return np.where(high > low, np.maximum(bend, 0.0), 0.0)


def _along_values(problem: Problem, q: Array, dq: Array) -> tuple[Array, float]:
    """Where a step leads that is linear in the values, and the share of it after which one of them nears its end."""
    values, moves = np.empty(q.size), np.empty(q.size)
    share = 1.0
    for i, c in enumerate(problem.coordinates):
        values[i], slope = value_and_slope(c.prior, float(q[i]))
        moves[i] = slope * dq[i]
        low, high = c.prior.support
        room = values[i] - low if moves[i] < 0.0 else high - values[i]
        if abs(moves[i]) > (1.0 - NEAR_END) * room:
            share = min(share, (1.0 - NEAR_END) * room / abs(moves[i]))
    there = zip(problem.coordinates, values + share * moves, moves, q, strict=True)
    return np.array([coordinate_of(c.prior, float(x)) if move else z for c, x, move, z in there]), share
