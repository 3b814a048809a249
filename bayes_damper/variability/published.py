"""The cases of the thesis: published features, sampled directly by tempering."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import NOMINAL
from bayes_damper.errors import InputError
from bayes_damper.fit import published_posterior
from bayes_damper.priors.distributions import Distribution, LogNormal, Normal
from bayes_damper.priors.files import load_priors, priors_from_dict
from bayes_damper.published.measurements import load_published
from bayes_damper.published.posterior import Coordinates, FeaturePosterior, ShrinkingErrors, feature_times
from bayes_damper.sampling.sequential import move_on, temper
from bayes_damper.variability.decomposition import CaseDraws, Sets, curve_values, mean_over_cases, summary
from bayes_damper.variability.equivalent import NAMES, bearing_damping, feature_scatter
from bayes_damper.variability.pooling import POOLINGS, CaseLikelihood, Direct, Hierarchy, Pooling, Scaling, Tilt, Tilted

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_CURVE_DRAWS = 48
_CURVE_POINTS = 8
_SCALINGS: tuple[Mapping[str, float], ...] = (
    dict.fromkeys(("J1", "J2", "k1t", "k2t", "c1t", "c3t", "c2t", "drag", "mu"), 1.0),
    {"N0": 1.0, "mu": -1.0},
    {"R": 1.0, "r": 1.0, "mu": -1.0},
)
"""Changes that leave the motion as it is: all torques with the inertias, and friction mu N0 R as a product."""
_KEPT = 16
"""Places of a particle that are kept of each run."""
_ROWS = 64
"""Records that are simulated in one go at least, where points are judged by several cases."""
_AGAIN = 1024
"""Draws of a case that are moved on where its draws are too few."""


class _Together:
    """Measures several cases in one go: their uncoupled records first, which take a third of the time.

    Points that these show to be too low already are left, however well what is to come would fit.
    """

    def __init__(self, posteriors: Sequence[FeaturePosterior]) -> None:
        self._posteriors = list(posteriors)
        self._paths = [ShrinkingErrors(p) for p in posteriors]
        self._configurations = sorted({name for p in posteriors for name in p.models}, reverse=True)

    def __call__(self, z: Sequence[Array], parts: Index, power: float, least: Array) -> Array:
        """Distances (n, len(parts), data) as `Target.tried` asks for them."""
        chosen = [self._posteriors[c] for c in parts]
        values = [p.coordinates.values(x) for p, x in zip(chosen, z, strict=True)]
        n, apart = len(z[0]), least.ndim == 2
        found = np.full((n, len(parts), len(chosen[0].data)), np.nan)
        best = np.zeros_like(found)  # what is not known yet may fit as well as can be
        heights = np.stack([self._paths[c].height(best[:, k], power) for k, c in enumerate(parts)], axis=1)
        # Cases that are judged together show one after the other what need not be simulated, unless points are few.
        size = len(parts) if apart else max(1, _ROWS // max(n, 1))
        for i in range(0, len(parts), size):
            some = range(i, min(i + size, len(parts)))
            for configuration in self._configurations:
                alive = heights >= least if apart else np.tile(heights.sum(axis=1) >= least, (len(parts), 1)).T
                rows = [np.flatnonzero(alive[:, k]) for k in some]
                ends = np.cumsum([len(r) for r in rows])
                if ends[-1] == 0:
                    continue
                table = {name: np.concatenate([values[k][name][r] for k, r in zip(some, rows, strict=True)])
                         for name in values[0]}  # fmt: skip
                records = self._posteriors[0].features_of(configuration, table)
                for k, r, end in zip(some, rows, ends, strict=True):
                    for j, d in enumerate(chosen[k].data):
                        if d.configuration == configuration:
                            value = getattr(records, d.quantity)[end - len(r) : end]
                            found[r, k, j] = best[r, k, j] = (value - d.value) / d.standard_error
                    heights[:, k] = self._paths[parts[k]].height(best[:, k], power)
        return found


@dataclass(frozen=True)
class _Flat:
    """A case's coordinates as its fit samples them."""

    coordinates: Coordinates

    def at(self, power: float) -> _Flat:
        """Sheets as thick as errors that are 1 / power times as large make them."""
        sheets = tuple(replace(s, width=s.width / max(power, 1e-6)) for s in self.coordinates.sheets)
        return _Flat(replace(self.coordinates, sheets=sheets))

    def sampled(self, z: Array) -> Array:
        """Sums and ratios of pairs, distances from sheets."""
        return self.coordinates.sampled(z)

    def standard(self, points: Array) -> Array:
        """The inverse."""
        return self.coordinates.standard(points)

    def log_volume(self, points: Array) -> Array:
        """A sheet's x goes with sinh y."""
        free, names = self.coordinates.free, self.coordinates.names
        flat = [names.index(s.name) for s in self.coordinates.sheets if isinstance(free.get(s.name), Normal)]
        return np.asarray(np.logaddexp(points[:, flat], -points[:, flat]).sum(axis=1))


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
        fitted = {case: published_posterior(case, self.prior_set, self.normal_force) for case in self.names}
        # The same times for all cases, whose records are simulated together.
        times = feature_times([datum for posterior in fitted.values() for datum in posterior.data])
        self.posteriors = {case: self._posterior(case, fitted[case], times) for case in self.names}

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

    def _posterior(self, case: str, fitted: FeaturePosterior, times: Array) -> FeaturePosterior:
        """The fit's posterior, in plain standard coordinates."""
        own = self.prior_set.for_case(case)
        plain = Coordinates(own.free, own.fixed, own.tied)
        return FeaturePosterior(fitted.data, plain, self.normal_force, case, times=times)

    def likelihood(self, case: str) -> CaseLikelihood:
        """The case as the hierarchy takes it."""
        posterior = self.posteriors[case]
        fitted = published_posterior(case, self.prior_set, self.normal_force).coordinates
        pairs = tuple(pair for pair in fitted.shared if pair.x in self.pooled and pair.y in self.pooled)
        moved = tuple(sheet for sheet in fitted.sheets if sheet.name not in self.pooled + self.common)
        return CaseLikelihood(
            case, posterior.names, ShrinkingErrors(posterior), _Flat(replace(fitted, shared=pairs, sheets=moved))
        )

    def hierarchy(self, pooling: Pooling, without: str | None = None, own_constants: bool = False) -> Hierarchy:
        """The joint posterior of all cases but one."""
        cases = [self.likelihood(case) for case in self.names if case != without]
        names, common = [c.name for c in cases], () if own_constants else self.common
        scalings = self._scalings(names, pooling, common)
        return Hierarchy(cases, pooling, self.pooled, common, scalings, self._together(names))

    def alone(self, case: str) -> Hierarchy:
        """The posterior of one case by itself."""
        scalings = self._scalings([case], "separate", ())
        return Hierarchy([self.likelihood(case)], "separate", self.pooled, (), scalings, self._together([case]))

    def _together(self, cases: Sequence[str]) -> _Together:
        return _Together([self.posteriors[case] for case in cases])

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

    def own_draws(self, work: Path, repeats: int) -> dict[str, Array]:
        """Draws of each case by itself from the runs in a folder: case -> (n, all its parameters), standard."""
        return {
            case: np.concatenate(
                [self.alone(case).coordinates(_points(work / f"alone-{case}-{k}"), 0) for k in range(repeats)]
            )
            for case in self.names
        }

    def columns(self, case: str) -> list[int]:
        """Where the pooled parameters stand among those of a case."""
        return [self.posteriors[case].names.index(name) for name in self.pooled]

    def again(self, draws: Mapping[str, Array], rng: np.random.Generator) -> Callable[[str, Tilt], Array]:
        """What `recycle` takes to move draws of the cases (n, all parameters) on under another prior."""

        def moved(case: str, tilt: Tilt) -> Array:
            pooled = self.columns(case)
            rest = [i for i in range(draws[case].shape[1]) if i not in pooled]
            places = draws[case][:, pooled + rest]
            weights = np.exp(tilt(draws[case][:, pooled]))
            hierarchy = self.alone(case)
            # The values of one case by itself stand before what is only its own.
            found = move_on(Tilted(hierarchy, tilt), places, weights, _AGAIN, rng)
            return hierarchy.values(found, 0)

        return moved

    def apart(self, key: str, names: Sequence[str], work: Path) -> float:
        """Root mean square difference of the means of two repeats, in standard deviations, over the unknowns.

        key : "shared-all", "separate-all", "partial-all" or "partial-own", of which `names` are the runs.
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

    def _errors(self, key: str, names: Sequence[str], work: Path) -> dict[str, Any]:
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
            unseen = {case: height - run["log_z"] for case, run in without.items()}
            unsure = len(without) ** 2 * max(error, spread / 2.0) ** 2
            unsure += sum(run["error"] ** 2 for run in without.values())
            points = np.concatenate([_points(work / name) for name in names])
            models[pooling] = (
                {
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
                    "last_memory": max(runs[name]["last_memory"] for name in names),
                    "particles": runs[names[0]]["particles"],
                }
                | self._errors(f"{pooling}-all", names, work)
                | self._described(self.hierarchy(pooling), points)
            )
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
    return _tempered(folder, hierarchy, seed, settings["particles"], report, settle=without is None)


def run_alone(
    folder: Path, report: Callable[[float, str], None], *, settings: Mapping[str, Any], case: str, repeat: int
) -> Any:
    """Task: one run of the tempering with one case; its draws go to points.npz."""
    cases = PublishedCases(settings["fit"])
    seed = [settings["seed"], len(POOLINGS), cases.names.index(case), repeat]
    return _tempered(folder, cases.alone(case), seed, settings["particles"], report)


def _tempered(
    folder: Path, hierarchy: Hierarchy, seed: list[int], particles: int, report: Callable[[float, str], None],
    settle: bool = True,
) -> dict[str, Any]:  # fmt: skip
    found = temper(hierarchy, np.random.default_rng(seed), particles, report, _KEPT, settle)
    np.savez_compressed(folder / "points.npz", points=found.points, log_likelihood=found.log_likelihood)
    return {
        "log_z": found.log_z,
        "error": found.error,
        "stages": found.stages,
        "memory": found.forgotten,
        "last_memory": found.last,
        "particles": particles,
    }
