"""The cases of the thesis: published features, sampled directly by tempering."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.calibration import NOMINAL
from bayes_damper.effects._other_law import OTHER_LAW
from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, LogNormal, LogUniform
from bayes_damper.priors.files import priors_from_dict
from bayes_damper.published.marginal import TOLERANCE, CaseFeatures
from bayes_damper.published.measurements import load_published
from bayes_damper.published.posterior import Coordinates, Datum, damping_pairs, data_of
from bayes_damper.published.sources import PublishedSource
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.runs.contents.variability import (
    FittedPlan,
    Interval,
    Pooling,
    PoolingEntry,
    PoolingRun,
    PoolingSettings,
    ScatterOfCases,
)
from bayes_damper.runs.provenance import code_sha256
from bayes_damper.sampling.sequential import Powers, Tempered, temper
from bayes_damper.variability.decomposition import summary
from bayes_damper.variability.pooling import POOLINGS, CaseLikelihood, Hierarchy, Scaling
from bayes_damper.variability.scenarios import Bridge, Scenario, ratio_of, scenarios, widened

Array = NDArray[np.float64]
_SCALINGS: tuple[Mapping[str, float], ...] = ({"N0": 1.0, "mu": -1.0}, {"R": 1.0, "r": 1.0, "mu": -1.0})
"""Changes that leave the motion as it is: friction between the faces is the product mu N0 R."""
_KEPT = 16
"""Places of a particle that are kept of each run."""
_FEW = 6
"""Places of a particle with which other assumptions begin."""
_FEWEST = 32
"""Particles of a run under other assumptions at least; otherwise a third of those that the answer itself takes, half if
it begins at the prior."""
_SWEEPS = 10
"""Most sweeps of a stage on the way: more particles make evidences sharper than more sweeps at the same cost."""


@dataclass(frozen=True)
class _Flat:
    """Sums and ratios of the dampings that one feature cannot distinguish."""

    coordinates: Coordinates

    def at(self, power: float) -> _Flat:
        """Itself."""
        del power
        return self

    def sampled(self, z: Array) -> Array:
        """Sums and ratios."""
        return self.coordinates.sampled(z)

    def standard(self, points: Array) -> Array:
        """The inverse."""
        return self.coordinates.standard(points)

    def log_volume(self, points: Array) -> Array:
        """They keep volumes."""
        return np.zeros(len(points))


class PublishedCases:
    """Published features of several cases under the priors of a fit's plan.

    law : exchanges a formula of the model, such as the law of friction; data : other numbers than the published.
    Spring and release angle of each case are integrated out; sampled is what cases may share, and the rig's constants.
    """

    kind = "torsional"
    measured = "Table 9 (p. 20)"
    method = (
        "Published features: the joint posterior of all cases by tempering, its evidence beside it; the unseen data "
        "are the features of each case in turn, predicted from the other cases. Parameters of the level "
        "'campaign' in the priors have one value for all cases in each of the three models."
    )

    def __init__(
        self, plan: FittedPlan, law: Variant | None = None, data: Mapping[str, Sequence[Datum]] | None = None
    ) -> None:
        self.plan, self._law, self._data = plan, law, data
        self.names = tuple(plan["cases"])
        self.normal_force: Literal["linear", "constant"] = plan["normal_force"] or "linear"
        self.prior_set = priors_from_dict(plan["priors"] or {})
        levels = {name: self.prior_set.level(name) for name in self.prior_set.for_case(self.names[0]).free}
        self.pooled = tuple(name for name in NOMINAL if levels.get(name) == "case")
        self.common = tuple(name for name, level in levels.items() if level == "campaign")
        if not self.pooled:
            raise InputError(
                "the priors leave no parameter to the cases: give some of mu, k2t, c2t ... the level 'case'"
            )
        if data is None:
            published = load_published()
            data = {case: list(data_of(published, case)) for case in self.names}
        self.features = {
            case: CaseFeatures(case, data[case], self.prior_set.for_case(case), self.normal_force, law, TOLERANCE)
            for case in self.names
        }

    @staticmethod
    def default_plan() -> FittedPlan:
        """What a fit of the thesis with its shipped priors would have planned."""
        source = PublishedSource(load_published())
        return {
            "campaign": source.name,
            "name": source.name,
            "campaign_sha256": source.sha256,
            "cases": list(source.cases),
            "priors": source.priors().to_dict(),
            "normal_force": None,
        }

    def priors(self, case: str) -> dict[str, Distribution]:
        """Distributions of the free parameters of one case."""
        return self.prior_set.for_case(case).free

    def likelihood(self, case: str) -> CaseLikelihood:
        """The case as the hierarchy takes it."""
        found = self.features[case]
        own = found.coordinates
        pairs = damping_pairs(self.prior_set.for_case(case).medians())
        pairs = tuple(pair for pair in pairs if pair.x in self.pooled and pair.y in self.pooled)
        return CaseLikelihood(case, own.names, Powers(found.log_likelihood), _Flat(replace(own, shared=pairs)))

    def values(
        self, hierarchy: Hierarchy, points: Array, number: int, rng: np.random.Generator | None = None
    ) -> dict[str, Array]:
        """All parameters of one case at points (n, ndim): name -> (n,).

        With rng also spring and angle, drawn given the others.
        """
        found = self.features[self.names[number]]
        values = found.coordinates.values(hierarchy.coordinates(points, number))
        return values if rng is None else values | found.own_draws(values, rng)

    def hierarchy(self, pooling: Pooling) -> Hierarchy:
        """The joint posterior of all cases."""
        cases = [self.likelihood(case) for case in self.names]
        return Hierarchy(cases, pooling, self.pooled, self.common, self._scalings(self.names, pooling, self.common))

    def bridge(self, pooling: Pooling, scenario: Scenario) -> tuple[Bridge, PublishedCases]:
        """The way from one answer to the same under other assumptions, and the cases under these."""
        before = self.hierarchy(pooling)
        if scenario.kind == "without":
            return Bridge(before, before, without=self.names.index(scenario.case)), self
        if scenario.kind == "law":
            other = PublishedCases(self.plan, OTHER_LAW, self._data)
            return Bridge(before, other.hierarchy(pooling)), other
        priors = widened(self.plan["priors"] or {}, self.pooled, scenario.width)
        other = PublishedCases({**self.plan, "priors": priors}, self._law, self._data)
        first = self.names[0]
        ratio = ratio_of(self.priors(first), other.priors(first), self.pooled)
        return Bridge(before, other.hierarchy(pooling), ratio=ratio), other

    def anew(self, scenario: Scenario) -> bool:
        """Whether other assumptions want draws of their own: those of one range do not show what lies outside it."""
        priors = self.priors(self.names[0])
        return scenario.kind == "width" and any(isinstance(priors[name], LogUniform) for name in self.pooled)

    def draws(self, names: Sequence[str], work: Path) -> Array:
        """Draws of runs, one after the other, (n, ndim)."""
        return np.concatenate([_points(work / name) for name in names])

    def _scalings(self, cases: Sequence[str], pooling: Pooling, common: Sequence[str]) -> list[list[Scaling]]:
        """What a free decay does not show, each for every case, as far as the priors leave it free."""
        if pooling == "shared" and not common:
            return []
        found = []
        for powers in _SCALINGS:
            each = []
            for case in cases:
                own, free = self.prior_set.for_case(case), self.priors(case)
                kept = {name: power for name, power in powers.items() if name in free}
                bound = {name: own.tied.get(name) for name in powers if name not in free}
                fits = all(other in kept and powers[other] == powers[name] for name, other in bound.items())
                level = {name in common for name in kept if name in self.common}
                lognormal = all(isinstance(free[name], LogNormal) for name in kept if name in self.pooled)
                if fits and lognormal and len(level) == 1:
                    each.append(Scaling(kept, {name: free[name] for name in kept}))
            if len(each) == len(cases):
                found.append(each)
        return found

    def apart(self, key: str, names: Sequence[str], work: Path) -> float:
        """Root mean square difference of the means of two repeats, in standard deviations, over the unknowns.

        key : "shared-all", "separate-all" or "partial-all", of which `names` are the runs.
        """
        spread = self._spread(key, names, work)
        return math.sqrt(2.0 * float(np.mean(list(spread.values())))) if spread else 0.0

    def _spread(self, key: str, names: Sequence[str], work: Path) -> dict[str, float]:
        """Variance of the means of repeats over that of the draws, of each unknown; empty for one run."""
        if len(names) < 2:
            return {}
        hierarchy = self._of(key)
        columns = [hierarchy.unknowns(_points(work / name)) for name in names]
        means = np.array([x.mean(axis=0) for x in columns])
        within = np.mean([x.var(axis=0) for x in columns], axis=0)
        ratio = means.var(axis=0, ddof=1) / np.maximum(within, 1e-300)
        return dict(zip(hierarchy.labels, ratio.tolist(), strict=True))

    def _errors(self, key: str, names: Sequence[str], work: Path) -> PoolingEntry:
        """How far apart the means of the repeats are, and the standard error of all of them together."""
        spread = self._spread(key, names, work)
        if not spread:
            return {"repeats_apart_sd": None}
        error = {name: math.sqrt(x / len(names)) for name, x in spread.items()}
        worst = max(error, key=lambda name: error[name])
        return {
            "repeats_apart_sd": self.apart(key, names, work),
            "monte_carlo_error_sd": math.sqrt(float(np.mean(np.square(list(error.values()))))),
            "largest_monte_carlo_error_sd": error[worst],
            "largest_monte_carlo_error_at": worst,
        }

    def _of(self, key: str) -> Hierarchy:
        pooling = key.partition("-")[0]
        return self.hierarchy(next(p for p in POOLINGS if p == pooling))

    def models(
        self, runs: Mapping[str, PoolingRun], chosen: Mapping[str, Sequence[str]], work: Path
    ) -> dict[str, PoolingEntry]:
        """What variability.json says of the three answers."""
        models: dict[str, PoolingEntry] = {}
        for pooling in POOLINGS:
            names = list(chosen[f"{pooling}-all"])
            heights = np.array([runs[name]["log_z"] for name in names])
            error = math.sqrt(float(np.mean([runs[name]["error"] ** 2 for name in names])) / len(names))
            # A run's evidence has the right mean, its logarithm lies below: the repeats' mean is taken before the log.
            height = float(logsumexp(heights)) - math.log(len(heights))
            spread = float(np.ptp(heights)) if len(heights) > 1 else 0.0
            seen = float(heights.std(ddof=1)) / math.sqrt(len(heights)) if len(heights) > 1 else 0.0
            without = {case: runs[key] for case in self.names if (key := f"{pooling}-without-{case}") in runs}
            unseen = {case: -run["gain"] for case, run in without.items()}
            # The draws that a run without a case begins with pass on what they miss of the posterior.
            unsure = math.sqrt(sum(run["error"] ** 2 + error**2 for run in without.values()))
            points = np.concatenate([_points(work / name) for name in names])
            models[pooling] = {
                "log_evidence": height,
                "error": max(error, seen),
                "spread": spread,
                "heldout": {
                    "what": "Each case's features, predicted from the other cases",
                    "log_score": float(sum(unseen.values())) if unseen else None,
                    "error": unsure if unseen else None,
                    "cases": unseen,
                },
                "memory": max(runs[name]["memory"] for name in names),
                "last_memory": max(runs[name]["last_memory"] for name in names),
                "particles": runs[names[0]]["particles"],
                "repeats": len(names),
                **self._errors(f"{pooling}-all", names, work),
                **self._described(self.hierarchy(pooling), points),
            }
        return models

    def _described(self, hierarchy: Hierarchy, points: Array) -> PoolingEntry:
        """Intervals of the pooled parameters of each case, and of the scatter where it is inferred."""
        cases = {}
        for i, case in enumerate(self.names):
            values = self.values(hierarchy, points, i)
            cases[case] = {name: summary(values[name]) for name in self.pooled}
        priors = self.priors(self.names[0])
        return described(hierarchy.pooling, cases, hierarchy.scatter(points), self.pooled, priors)


def described(
    pooling: Pooling, cases: Mapping[str, Mapping[str, Interval]], s: Array, pooled: tuple[str, ...],
    priors: Mapping[str, Distribution],
) -> PoolingEntry:  # fmt: skip
    """What a result says of one answer: parameters of each case or the shared ones, and the scatter s if partial."""
    if pooling == "shared":
        return {"parameters": next(iter(cases.values()))}
    if pooling == "separate":
        return {"cases": cases}
    return {"cases": cases, "scatter": _described_scatter(s, pooled, priors)}


def _described_scatter(
    s: Array, pooled: tuple[str, ...], priors: Mapping[str, Distribution]
) -> dict[str, ScatterOfCases]:
    """Intervals of s, of the scatter of ln x where x has a lognormal prior, and how probable a small s is."""
    out: dict[str, ScatterOfCases] = {}
    for j, name in enumerate(pooled):
        share = summary(s[:, j])
        row: ScatterOfCases = {
            "median": share["median"], "hdi90": share["hdi90"],
            "probability_below_a_quarter": float(np.mean(s[:, j] < 0.25)),
        }  # fmt: skip
        prior = priors[name]
        if isinstance(prior, LogNormal):
            row["scatter_of_ln"] = summary(s[:, j] * math.log(prior.factor))
        out[name] = row
    return out


def _points(folder: Path) -> Array:
    with np.load(folder / "points.npz") as stored:
        return np.asarray(stored["points"], float)


def run_pooling(
    folder: Path, report: Callable[[float, str], None], *, settings: PoolingSettings, pooling: Pooling, repeat: int
) -> PoolingRun:
    """Task: one answer's evidence and draws, from the prior; the draws go to points.npz."""
    cases = PublishedCases(settings["fit"])
    rng = np.random.default_rng([settings["seed"], POOLINGS.index(pooling), repeat])
    found = temper(
        cases.hierarchy(pooling), rng, settings["particles"], report, _KEPT, False, sweeps=_SWEEPS,
        checkpoint=_state(folder, settings, pooling, str(repeat)),
    )  # fmt: skip
    return {**_kept(folder, found), "log_z": found.log_z, "particles": settings["particles"]}


def run_scenario(
    folder: Path, report: Callable[[float, str], None], *, settings: PoolingSettings, pooling: Pooling,
    scenario: str, runs: Sequence[str],
) -> PoolingRun:  # fmt: skip
    """Task: one answer under other assumptions, from the draws of the runs of these names; what its evidence gains.

    Where those draws do not do, from the prior; what its evidence is.
    """
    cases = PublishedCases(settings["fit"])
    every = {s.name: s for s in scenarios(cases.names)}
    bridge, other = cases.bridge(pooling, every[scenario])
    few, state = max(settings["particles"] // 3, _FEWEST), _state(folder, settings, pooling, scenario)
    rng = np.random.default_rng([settings["seed"], POOLINGS.index(pooling), list(every).index(scenario), 7])
    if cases.anew(every[scenario]):
        half = max(settings["particles"] // 2, _FEWEST)
        found = temper(other.hierarchy(pooling), rng, half, report, _KEPT, False, sweeps=_SWEEPS, checkpoint=state)
        return {**_kept(folder, found), "log_z": found.log_z}
    first = [_points(folder.parent / run) for run in runs]
    # Places of one particle stand together; a few of each do to begin with.
    size = settings["particles"]
    chains = [bridge.start(p.reshape(size, len(p) // size, -1)[:, -_FEW:]) for p in first]
    start = np.swapaxes(np.concatenate(chains), 0, 1)
    found = temper(bridge, rng, few, report, _KEPT, False, sweeps=_SWEEPS, start=start, checkpoint=state)
    return {**_kept(folder, found), "gain": found.log_z}


def _state(folder: Path, settings: PoolingSettings, pooling: str, which: str) -> Checkpoint:
    """Where a task keeps its state until it is done."""
    decided = json.dumps({"settings": settings, "pooling": pooling, "which": which}, sort_keys=True)
    return Checkpoint(folder / "state", {"task": hashlib.sha256(decided.encode()).hexdigest(), "code": code_sha256()})


def _kept(folder: Path, found: Tempered) -> PoolingRun:
    shutil.rmtree(folder / "state", ignore_errors=True)
    np.savez_compressed(folder / "points.npz", points=found.points)
    return {
        "error": found.error, "stages": found.stages, "memory": found.forgotten, "last_memory": found.last,
        "evaluations": found.evaluations,
    }  # fmt: skip
