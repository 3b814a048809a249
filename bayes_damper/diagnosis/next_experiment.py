"""Which experiment would best split the answers that are still open.

Each leading answer, fitted to the trials at hand, predicts what a new trial would show; what its uncertain parameters
and the new trial's own nuisances could still bend is part of the prediction's spread, so a difference that a refit
would swallow counts for nothing. Linearised, every prediction is Gaussian, and the information that the trial is
expected to give about the answers is bounded below by their pairwise Bhattacharyya distances B (Kolchinsky and Tracey,
Entropy 19 (2017) 361):

    I >= -sum_a p_a log sum_b p_b exp(-B_ab).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, Problem, TrialRecord, default_priors
from bayes_damper.runs.contents.diagnosis import ProposalEntry

Array = NDArray[np.float64]

STIFFNESS_FACTORS = (0.7, 1.0, 1.4)
ANGLES = 5
LEAST_PROBABILITY = 0.01
_FAINT = 1e-6  # squared length, in noise units, of a direction of uncertainty that matters to nothing


@dataclass(frozen=True)
class Proposal:
    """One experiment and the information (nats) that one trial of it is expected to give about the open answers.

    margin: Bhattacharyya distance of the two answers that it splits least; ranks experiments that all decide.
    """

    configuration: str
    k1t: float
    theta0: float
    information: float
    margin: float

    def to_json(self, kind: str = "torsional") -> ProposalEntry:
        """An entry of `next_experiment`, in the units of that kind of rig."""
        place: ProposalEntry = (
            {"k1_n_per_m": self.k1t, "theta0_mm": 1e3 * self.theta0}
            if kind == "translational"
            else {"k1t_n_m_per_rad": self.k1t, "theta0_deg": math.degrees(self.theta0)}
        )
        return {
            "configuration": self.configuration, **place, "expected_information_nats": self.information,
            "margin": self.margin,
        }  # fmt: skip


def propose(
    fits: Sequence[Calibration],
    probabilities: Sequence[float],
    *,
    stiffnesses: Sequence[float] | None = None,
    angles: Sequence[float] | None = None,
    top: int | None = None,
) -> list[Proposal]:
    """Experiments ranked by expected information, the best first.

    fits : the leading answers (the nominal model may be one), all fitted to the same trials; probabilities : of each,
    any scale; stiffnesses : k1t to try, N m/rad, default the declared values and 0.7 and 1.4 times them; angles :
    theta0 to try, rad, default from half the smallest to 1.3 times the largest in the campaign; top : how many.

    An empty list if fewer than two answers are open, or if there is no release to choose: the rig starts freely, or the
    motion of its primary is prescribed.

    Raises
    ------
    ValueError
        if there is not one probability per fit, or one is negative.
    """
    if len(fits) != len(probabilities):
        raise ValueError(f"{len(fits)} fits but {len(probabilities)} probabilities: give one for each")
    if any(p < 0.0 for p in probabilities):
        raise ValueError("probabilities must not be negative")
    whole = sum(probabilities) or 1.0
    open_answers = [(f, p / whole) for f, p in zip(fits, probabilities, strict=True) if p >= LEAST_PROBABILITY * whole]
    known = [f.problem.experiment for f, _ in open_answers[:1]]
    if len(open_answers) < 2 or known[0].start != "rest" or any(t.prescribed for t in known[0].trials):
        return []
    p = np.array([x for _, x in open_answers])
    p /= p.sum()
    leaders = [f for f, _ in open_answers]
    experiment = candidate_trials(leaders[0].problem.experiment, stiffnesses, angles)
    experiment = with_events(leaders[0], experiment)
    predicted = [_predict(fit, experiment) for fit in leaders]
    proposals = []
    for i, trial in enumerate(experiment.trials):
        distance = np.zeros((p.size, p.size))
        for a in range(p.size):
            for b in range(a):
                distance[a, b] = distance[b, a] = bhattacharyya(*predicted[a][i], *predicted[b][i])
        information = expected_information(p, distance)
        k1t = experiment.stiffnesses[trial.k1t][0]
        margin = float(np.min(distance[np.triu_indices(p.size, 1)]))
        configuration = "coupled" if trial.coupled else "uncoupled"
        proposals.append(Proposal(configuration, k1t, trial.theta0, information, margin))
    proposals.sort(key=lambda x: (-round(x.information, 4), -x.margin))
    return proposals[:top]


def expected_information(probabilities: Array, distance: Array) -> float:
    """Lower bound of the information about the answers, nats, from Bhattacharyya distances (k, k)."""
    mixed = np.exp(-distance) @ probabilities
    return float(-np.sum(probabilities * np.log(mixed)))


def bhattacharyya(mean_a: Array, root_a: Array, mean_b: Array, root_b: Array) -> float:
    """Distance of two Gaussians of unit noise: means (d,), covariances 1 + root root' with roots (d, k).

    D = delta' M^-1 delta / 8 + (log |M| - log |A| / 2 - log |B| / 2) / 2 with M the mean covariance.
    """
    delta = mean_a - mean_b
    root = np.concatenate([root_a, root_b], axis=1) / math.sqrt(2.0)
    inner = np.eye(root.shape[1]) + root.T @ root
    along = root.T @ delta
    solved = np.linalg.solve(inner, along)
    quadratic = float(delta @ delta - along @ solved)

    def log_det(r: Array) -> float:
        return float(np.linalg.slogdet(np.eye(r.shape[1]) + r.T @ r)[1])

    return max(0.0, quadratic / 8.0 + 0.5 * (log_det(root) - 0.5 * log_det(root_a) - 0.5 * log_det(root_b)))


def candidate_trials(
    experiment: Experiment, stiffnesses: Sequence[float] | None, angles: Sequence[float] | None
) -> Experiment:
    """The experiments to judge, one trial each; priors stay those of the campaign."""
    given = list(experiment.stiffnesses)
    if stiffnesses is None:
        declared = [k for k, _ in given]
        stiffnesses = sorted({round(k * f, 9) for k in declared for f in STIFFNESS_FACTORS})
    released = [t for t in experiment.trials if t.theta0]
    used = [abs(t.theta0) for t in released] or [0.1]
    if angles is None:
        angles = np.geomspace(0.5 * min(used), 1.3 * max(used), ANGLES).tolist()
    relative = max((t.theta0_sd / abs(t.theta0) for t in released), default=0.0)
    share = max((sd / k for k, sd in given), default=0.0)
    places = []
    for k in stiffnesses:
        near = [i for i, (value, _) in enumerate(given) if abs(value - k) < 1e-6 * k]
        if not near:
            given.append((float(k), share * float(k)))
            near = [len(given) - 1]
        places.append(near[0])
    configurations = sorted({t.coupled for t in experiment.trials})
    records: list[TrialRecord] = []
    for coupled in configurations:
        model = max((t for t in experiment.trials if t.coupled == coupled), key=lambda t: t.times.size)
        blank = np.zeros_like(model.y)
        for place, angle in product(places, angles):
            sd = relative * float(angle)
            number = len(records) + 1
            records.append(TrialRecord("", "next", coupled, number, model.times, blank, place, float(angle), sd))
    # Priors and medians depend on the campaign they were made for, so they are handed over.
    priors = default_priors(experiment) | dict(experiment.priors)
    return replace(experiment, trials=tuple(records), stiffnesses=tuple(given), priors=priors)


def with_events(fit: Calibration, experiment: Experiment) -> Experiment:
    """The candidates with predicted readings, so that friction reversals count as little as they would in a fit."""
    problem, q = moved(fit, experiment)
    readings: dict[int, Array] = {}
    for group in problem.groups:
        n = len(group.trials)
        every: Any = np.arange(n)
        y = problem.simulate(group, every, np.tile(q, (n, 1)), np.zeros((n, len(group.nuisances))))
        readings.update({i: np.nan_to_num(y[k]) for k, i in enumerate(group.trials)})
    return replace(experiment, trials=tuple(replace(t, y=readings[i]) for i, t in enumerate(experiment.trials)))


def moved(fit: Calibration, experiment: Experiment) -> tuple[Problem, Array]:
    """The fit's model on other trials, and its coordinates there: at the prior mean where they are new."""
    old = fit.problem
    problem = Problem(
        experiment, old.effect, nominal=old.nominal, noise=old.noise, switches=old.switches,
        tolerance=old.tolerance, trials=tuple(range(len(experiment.trials))),
    )  # fmt: skip
    return problem, np.array([0.0 if k is None else fit.q[k] for k in places_of(fit, problem)])


def places_of(fit: Calibration, problem: Problem) -> list[int | None]:
    """Where each coordinate of the new problem stands in the fit, one of a new case at that of another; None if new."""
    known = {(c.role, c.name if c.role != "stiffness" else c.index): k for k, c in enumerate(fit.problem.coordinates)}
    known = {(c.role, c.parameter): k for k, c in enumerate(fit.problem.coordinates) if c.case is not None} | known
    return [known.get((c.role, c.name if c.role != "stiffness" else c.index)) for c in problem.coordinates]


def _predict(fit: Calibration, experiment: Experiment) -> list[tuple[Array, Array]]:
    """For each candidate trial its whitened prediction (d,) and the root (d, k) of what is uncertain about it."""
    problem, q = moved(fit, experiment)
    places = places_of(fit, problem)
    known = [k for k in places if k is not None]
    covariance = np.eye(problem.size)
    rows = np.array([i for i, k in enumerate(places) if k is not None], dtype=np.int64)
    covariance[np.ix_(rows, rows)] = fit.covariance[np.ix_(known, known)]
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    eta = {i: np.zeros(len(g.nuisances)) for g in problem.groups for i in g.trials}
    linear = problem.linearise(q, eta)
    out: dict[int, tuple[Array, Array]] = {}
    for block in linear.blocks:
        group = block.group
        for k, i in enumerate(group.trials):
            y = block.r[k] + problem.whitened(group.y[k][None], group.weight[k][None])[0]
            root = np.concatenate([block.J[k].T @ half, block.T[k].T], axis=1)
            keep = np.sum(root**2, axis=0) > _FAINT
            out[i] = (np.nan_to_num(y), np.nan_to_num(root[:, keep]))
    return [out[i] for i in range(len(experiment.trials))]
