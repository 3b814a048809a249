"""The cases of the thesis: published features, sampled directly by tempering."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import NOMINAL
from bayes_damper.distributions import Distribution, LogNormal
from bayes_damper.errors import InputError
from bayes_damper.fit import published_posterior
from bayes_damper.posterior import Coordinates, FeaturePosterior
from bayes_damper.priors import load_priors, priors_from_dict
from bayes_damper.published import load_published
from bayes_damper.variability.decomposition import CaseDraws, Sets, curve_values, mean_over_cases, summary
from bayes_damper.variability.equivalent import NAMES, bearing_damping, feature_scatter
from bayes_damper.variability.pooling import POOLINGS, CaseLikelihood, Direct, Hierarchy, Pooling
from bayes_damper.variability.tempering import temper

Array = NDArray[np.float64]
_CURVE_DRAWS = 48
_CURVE_POINTS = 8


class PublishedCases:
    """Published features of several cases under the priors of a fit's plan."""

    kind = "torsional"
    method = (
        "Published features: the joint posterior of all cases by tempering, its evidence beside it; the unseen data "
        "are the features of each case in turn, predicted from the other cases. Parameters of the level "
        "'campaign' in the priors have one value for all cases in each of the three models."
    )

    def __init__(self, plan: Mapping[str, Any]) -> None:
        self.plan = dict(plan)
        self.names = tuple(plan["cases"])
        self.normal_force: Literal["linear", "constant"] = plan["normal_force"] or "linear"
        self.prior_set = priors_from_dict(plan["priors"])
        levels = {name: self.prior_set.level(name) for name in self.prior_set.for_case(self.names[0]).free}
        self.pooled = tuple(name for name in NOMINAL if levels.get(name) == "case")
        self.common = tuple(name for name, level in levels.items() if level == "campaign")
        if not self.pooled:
            raise InputError(
                "the priors leave no parameter to the cases: give some of mu, k2t, c2t ... the level 'case'"
            )
        self.posteriors = {case: self._posterior(case) for case in self.names}

    @staticmethod
    def default_plan() -> dict[str, Any]:
        """What a fit of the thesis with its shipped priors would have planned."""
        published = load_published()
        return {
            "campaign": "thesis",
            "name": "thesis",
            "campaign_sha256": published.checksum,
            "cases": list(published.cases),
            "priors": load_priors("thesis").to_dict(),
            "normal_force": None,
        }

    def priors(self, case: str) -> dict[str, Distribution]:
        """Distributions of the free parameters of one case."""
        return self.prior_set.for_case(case).free

    def _posterior(self, case: str) -> FeaturePosterior:
        """The fit's posterior, in plain standard coordinates."""
        fitted = published_posterior(case, self.prior_set, self.normal_force)
        own = self.prior_set.for_case(case)
        return FeaturePosterior(fitted.data, Coordinates(own.free, own.fixed, own.tied), self.normal_force, case)

    def likelihood(self, case: str) -> CaseLikelihood:
        """The case as the hierarchy takes it."""
        posterior = self.posteriors[case]
        pairs = published_posterior(case, self.prior_set, self.normal_force).coordinates.shared
        free = self.priors(case)
        kept = tuple(pair for pair in pairs if pair.x in self.pooled and pair.y in self.pooled)
        curve = Coordinates({name: free[name] for name in self.pooled}, shared=kept)

        def log_likelihood(points: Array) -> Array:
            return np.asarray(posterior.log_likelihood(points).sum(axis=1))

        return CaseLikelihood(case, posterior.names, log_likelihood, curve)

    def hierarchy(self, pooling: Pooling, without: str | None = None, own_constants: bool = False) -> Hierarchy:
        """The joint posterior of all cases but one."""
        cases = [self.likelihood(case) for case in self.names if case != without]
        return Hierarchy(cases, pooling, self.pooled, () if own_constants else self.common)

    def alone(self, case: str) -> Hierarchy:
        """The posterior of one case by itself."""
        return Hierarchy([self.likelihood(case)], "separate", self.pooled)

    def own_draws(self, work: Path, repeats: int) -> dict[str, Array]:
        """Draws of each case by itself from the runs in a folder: case -> (n, pooled) standard coordinates."""
        return {
            case: np.concatenate(
                [self.alone(case).values(_points(work / f"alone-{case}-{k}"), 0) for k in range(repeats)]
            )
            for case in self.names
        }

    def apart(self, key: str, names: Sequence[str], work: Path) -> float:
        """Root mean square difference of the means of two repeats, in standard deviations, over what is pooled.

        key : "shared-all", "separate-all", "partial-all" or "partial-own", of which `names` are the runs.
        """
        hierarchy = self._of(key)
        columns = []
        for points in (_points(work / name) for name in names):
            parts = [hierarchy.values(points, i) for i in range(len(self.names))]
            if hierarchy.pooling == "partial":
                parts += [hierarchy.means(points), hierarchy.scatter(points)]
            columns.append(np.concatenate(parts[:1] if hierarchy.pooling == "shared" else parts, axis=1))
        if len(columns) < 2:
            return 0.0
        means = np.array([x.mean(axis=0) for x in columns])
        within = np.mean([x.var(axis=0) for x in columns], axis=0)
        return math.sqrt(2.0 * float(np.mean(means.var(axis=0, ddof=1) / np.maximum(within, 1e-300))))

    def _of(self, key: str) -> Hierarchy:
        pooling, _, kind = key.partition("-")
        return self.hierarchy(next(p for p in POOLINGS if p == pooling), own_constants=kind == "own")

    def direct(self, runs: Mapping[str, Any], chosen: Mapping[str, Sequence[str]], work: Path, repeats: int) -> Direct:
        """Partial pooling of cases that have constants of the rig of their own each, as single fits have."""
        hierarchy = self.hierarchy("partial", own_constants=True)
        own = list(chosen["partial-own"])
        points = np.concatenate([_points(work / name) for name in own])
        heights = np.array(
            [
                runs[own[k]]["log_z"] - sum(runs[f"alone-{case}-{k}"]["log_z"] for case in self.names)
                for k in range(repeats)
            ]
        )
        names = own + [f"alone-{case}-{k}" for case in self.names for k in range(repeats)]
        error = math.sqrt(sum(runs[name]["error"] ** 2 for name in names)) / repeats
        return Direct(
            hierarchy.means(points),
            hierarchy.scatter(points),
            {case: hierarchy.values(points, i) for i, case in enumerate(self.names)},
            float(heights.mean()),
            max(error, float(np.ptp(heights)) / 2.0),
            self.apart("partial-own", own, work),
        )

    def models(
        self, runs: Mapping[str, Any], chosen: Mapping[str, Sequence[str]], work: Path, rng: np.random.Generator,
        draws: int,
    ) -> tuple[dict[str, dict[str, Any]], Sets]:  # fmt: skip
        """What variability.json says of the three answers, and what the decomposition needs."""
        models: dict[str, dict[str, Any]] = {}
        for pooling in POOLINGS:
            names = list(chosen[f"{pooling}-all"])
            heights = np.array([runs[name]["log_z"] for name in names])
            error = math.sqrt(float(np.mean([runs[name]["error"] ** 2 for name in names])) / len(names))
            spread = float(np.ptp(heights)) if len(heights) > 1 else 0.0
            height = float(heights.mean())
            without = {case: runs[key] for case in self.names if (key := f"{pooling}-without-{case}-0") in runs}
            # Runs without a case have the first number of particles: set beside runs of the same.
            first = [run for name, run in runs.items() if name.startswith(f"{pooling}-all-") and name.count("-") == 2]
            whole = np.array([run["log_z"] for run in first])
            unseen = {case: float(whole.mean()) - run["log_z"] for case, run in without.items()}
            own = math.sqrt(float(np.mean([run["error"] ** 2 for run in first])) / len(first))
            unsure = len(without) ** 2 * max(own, float(np.ptp(whole)) / 2.0) ** 2
            unsure += sum(run["error"] ** 2 for run in without.values())
            points = np.concatenate([_points(work / name) for name in names])
            models[pooling] = {
                "log_evidence": height,
                "error": max(error, spread / 2.0),
                "spread": spread,
                "heldout": {
                    "what": "Each case's features, predicted from the other cases",
                    "log_score": float(sum(unseen.values())) if unseen else None,
                    "error": math.sqrt(unsure) if unseen else None,
                    "cases": unseen,
                },
                "memory": max(runs[name]["memory"] for name in names),
                "particles": len(points) // len(names),
                "repeats_apart_sd": self.apart(f"{pooling}-all", names, work),
            } | self._described(self.hierarchy(pooling), points)
        points = np.concatenate([_points(work / name) for name in chosen["partial-all"]])
        points = points[rng.permutation(len(points))[:draws]]
        return models, self._sets(self.hierarchy("partial"), points, rng)

    def _described(self, hierarchy: Hierarchy, points: Array) -> dict[str, Any]:
        """Intervals of the pooled parameters of each case, and of the scatter where it is inferred."""
        cases = {}
        for i, case in enumerate(self.names):
            values = self.posteriors[case].coordinates.values(hierarchy.coordinates(points, i))
            cases[case] = {name: summary(values[name]) for name in self.pooled}
        if hierarchy.pooling == "shared":
            return {"parameters": next(iter(cases.values()))}
        if hierarchy.pooling == "separate":
            return {"cases": cases}
        s = hierarchy.scatter(points)
        priors = self.priors(self.names[0])
        return {"cases": cases, "scatter": describe_scatter(s, self.pooled, priors)}

    def _values(self, hierarchy: Hierarchy, points: Array) -> dict[str, tuple[dict[str, Array], dict[str, Array]]]:
        """Parameters of each case, and the same with the pooled ones at the cases' mean."""
        mean = mean_over_cases([hierarchy.values(points, i) for i in range(len(self.names))])
        out = {}
        for i, case in enumerate(self.names):
            coordinates = self.posteriors[case].coordinates
            z = hierarchy.coordinates(points, i)
            reference = z.copy()
            reference[:, [coordinates.names.index(name) for name in self.pooled]] = mean
            out[case] = coordinates.values(z), coordinates.values(reference)
        return out

    def _sets(self, hierarchy: Hierarchy, points: Array, rng: np.random.Generator) -> Sets:
        published = load_published()
        found = self._values(hierarchy, points)
        before = self._values(hierarchy, rng.standard_normal((max(len(points) // 2, 8), hierarchy.ndim)))
        energies = {case: 0.5 * published.cases[case].k1t * published.cases[case].theta0 ** 2 for case in self.names}
        grid = np.geomspace(0.6 * min(energies.values()), 1.3 * max(energies.values()), _CURVE_POINTS)
        reference = {name: x[:_CURVE_DRAWS] for name, x in found[self.names[0]][1].items()}
        springs = sorted({published.cases[case].k1t for case in self.names})
        table, rounding = _printed(self.names)
        return Sets(
            {case: CaseDraws(*found[case], *before[case]) for case in self.names},
            energies,
            table,
            rounding,
            {case: self._scatter(case, found[case][0]) for case in self.names},
            {f"k1t = {k:g} N m/rad": (grid, curve_values(reference, k, grid)) for k in springs},
            self.normal_force,
            measurement="Measurement scatter: the printed standard errors of the three coupled features, carried to "
            "the linear model's k2t and c2t to first order. Beside the result stands Table 9 (p. 20), whose values are "
            "rounded to one digit.",
        )

    def _scatter(self, case: str, values: Mapping[str, Array]) -> Callable[[Array], Array]:
        errors = {d.quantity: d.standard_error for d in self.posteriors[case].data if d.configuration == "coupled"}
        priors = self.priors(case)
        sds = tuple(_log_sd(priors.get(name)) for name in NAMES)
        damping = bearing_damping(values, self.normal_force)

        def scatter(log_values: Array) -> Array:
            return feature_scatter(values, log_values, damping, errors, (sds[0], sds[1]))

        return scatter


def describe_scatter(
    s: Array, pooled: tuple[str, ...], priors: Mapping[str, Distribution]
) -> dict[str, dict[str, Any]]:
    """Intervals of s, of the scatter of ln x where x has a lognormal prior, and how probable a small s is."""
    out = {}
    for j, name in enumerate(pooled):
        row = summary(s[:, j]) | {"probability_below_a_quarter": float(np.mean(s[:, j] < 0.25))}
        prior = priors[name]
        if isinstance(prior, LogNormal):
            row["scatter_of_ln"] = summary(s[:, j] * math.log(prior.factor))
        out[name] = row
    return out


def _log_sd(prior: Distribution | None) -> float:
    return math.log(prior.factor) if isinstance(prior, LogNormal) else 1.0


def _printed(cases: tuple[str, ...]) -> tuple[dict[str, tuple[float, float]], tuple[float, float]]:
    """Table 9, and the variance of ln k2t and ln c2t that its rounding makes."""
    rows = {(p.case, p.quantity): p for p in load_published().printed if p.quantity in ("fitted_k2t", "fitted_c2t")}
    table, rounding = {}, []
    for case in cases:
        if (case, "fitted_k2t") in rows and (case, "fitted_c2t") in rows:
            table[case] = rows[case, "fitted_k2t"].value, rows[case, "fitted_c2t"].value
    for k, name in enumerate(NAMES):
        digits = max(len(rows[c, f"fitted_{name}"].text.partition(".")[2]) for c in table) if table else 0
        half = 0.5 * 10.0**-digits
        rounding.append(float(np.mean([(half / pair[k]) ** 2 / 3.0 for pair in table.values()])) if table else math.nan)
    return table, (rounding[0], rounding[1])


def _points(folder: Path) -> Array:
    with np.load(folder / "points.npz") as stored:
        return np.asarray(stored["points"], float)


def run_pooling(
    folder: Path, report: Callable[[float, str], None], *, settings: Mapping[str, Any], pooling: Pooling,
    without: str | None, repeat: int, own_constants: bool,
) -> Any:  # fmt: skip
    """Task: one run of the tempering with all cases, or all but one; its draws go to points.npz."""
    cases = PublishedCases(settings["fit"])
    which = 0 if without is None else 1 + cases.names.index(without)
    seed = [settings["seed"], POOLINGS.index(pooling), which, repeat, int(own_constants)]
    hierarchy = cases.hierarchy(pooling, without, own_constants)
    return _tempered(folder, hierarchy, seed, settings["particles"], report)


def run_alone(
    folder: Path, report: Callable[[float, str], None], *, settings: Mapping[str, Any], case: str, repeat: int
) -> Any:
    """Task: one run of the tempering with one case; its draws go to points.npz."""
    cases = PublishedCases(settings["fit"])
    seed = [settings["seed"], len(POOLINGS), cases.names.index(case), repeat]
    return _tempered(folder, cases.alone(case), seed, 4 * settings["particles"], report)


def _tempered(
    folder: Path, hierarchy: Hierarchy, seed: list[int], particles: int, report: Callable[[float, str], None]
) -> dict[str, Any]:
    found = temper(hierarchy, np.random.default_rng(seed), particles, report)
    np.savez_compressed(folder / "points.npz", points=found.points, log_likelihood=found.log_likelihood)
    return {"log_z": found.log_z, "error": found.error, "stages": found.stages, "memory": found.forgotten}
