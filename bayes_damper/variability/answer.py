"""From the results of a fit to `variability.json`: what `variability` does, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from bayes_damper import figures
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.inputs import fields
from bayes_damper.priors.distributions import Distribution, from_standard, to_standard
from bayes_damper.published.sources import is_published
from bayes_damper.runs.contents.variability import (
    AgreementEntry,
    AssumptionEntry,
    FittedPlan,
    PoolingEntry,
    PoolingRun,
    PoolingSettings,
    TwoWaysOfParameter,
    VariabilityFile,
)
from bayes_damper.runs.execution import Progress, RunRecord, Silent, Task, claim, run_record, run_tasks
from bayes_damper.runs.json_files import folder_name, plain, read_json, write_json
from bayes_damper.runs.parallel_map import single_threaded
from bayes_damper.runs.provenance import code_sha256, provenance
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.sampling import arviz_adapter
from bayes_damper.text import Printable, warning_lines
from bayes_damper.variability.averaged import (
    DRAWS,
    Parts,
    averaged,
    mixture,
    probabilities_of,
    spread_of,
    what_survives,
)
from bayes_damper.variability.decomposition import Sets, decompose, summary
from bayes_damper.variability.pooling import POOLINGS, Direct, Recycled, recycle
from bayes_damper.variability.published import PublishedCases, run_pooling, run_scenario
from bayes_damper.variability.published_sets import published_sets
from bayes_damper.variability.recorded import RecordedCases
from bayes_damper.variability.recorded_sets import recorded_sets
from bayes_damper.variability.scenarios import scenarios

Array = NDArray[np.float64]
SCHEMA = "bayes-damper/variability/1"
WOULD_SETTLE = (
    "Turn the coupled bar slowly out and back with a spring balance: slope k2t, half the loop's width mu N0 R, apart.",
    "Record the uncoupled rig from the largest angle to rest: a straight envelope is drag, an exponential one c1t.",
    "Release the coupled rig with one spring from all four angles on one day: friction alone must then give Table 9.",
)
"""What would decide why the cases of the thesis differ; each separates two unknowns that its numbers see as a sum."""
MEANING = {
    "shared": "one parameter set for all cases",
    "separate": "each case its own parameter set",
    "partial": "values scattered about a common mean",
}
_RECYCLED_DRAWS = 100_000
_WORST_MEMORY = 0.6
_LARGEST_SPREAD = 1.5
"""Nats by which repeated runs may differ before the evidence is called unconverged."""
_APART = 0.3
"""Standard deviations by which the means of repeated runs may differ (root mean square over the unknowns) before they
are made again with more particles: at this value the two rest on some 20 independent draws each."""
_FEWEST_PARTICLES = 32
_MORE, _MOST_PARTICLES = 4, 1024
"""Factor by which the particles then grow, and up to how many."""


@dataclass(frozen=True)
class Variability(Printable):
    """What the cases share and where they differ; `result` is what variability.json holds, `folder` where it is."""

    folder: Path
    result: VariabilityFile

    @property
    def converged(self) -> bool:
        """Whether the fit and the runs of the three answers converged."""
        return bool(self.result["converged"])

    @property
    def exit_code(self) -> ExitCode:
        return ExitCode.DONE if self.converged else ExitCode.NOT_CONVERGED

    def to_json(self) -> VariabilityFile:
        """What variability.json holds."""
        return self.result

    def text(self) -> str:
        """A table for the terminal, warnings first."""
        r = self.result
        lines = warning_lines(r.get("warnings", ()), r.get("warnings_of_check", 0))
        lines += [] if self.converged else ["*** DID NOT CONVERGE: do not use these numbers ***"]
        lines.append(f"{r['campaign']}: cases {', '.join(r['cases'])}")
        lines.append(f"  {'':44s}{'log evidence':>14s}{'probability':>13s}{'unseen data':>13s}")
        for name, model in r["models"].items():
            lines.append(
                f"  {MEANING[name]:44s}{model['log_evidence']:10.2f} +-{model['error']:5.2f}"
                f"{model['probability']:11.2f}{_score(model):>13s}"
            )
        for name, rows in (r["decomposition"] or {}).items():
            lines.append(f"  variance of ln {name} over the cases      median   90 % interval")
            lines += [
                f"    {key.replace('_', ' '):36s}{row['median']:9.3f}   {row['hdi90'][0]:.3f} .. {row['hdi90'][1]:.3f}"
                for key, row in rows.items()
                if isinstance(row, Mapping) and "median" in row
            ]
        return "\n".join([*lines, *(f"  {s}" for s in r["sentences"]), f"Files: {self.folder}"])


@single_threaded
def variability(
    folder: str | Path,
    *,
    out: str | Path | None = None,
    seed: int = 1,
    particles: int = 288,
    repeats: int = 2,
    draws: int = 200,
    unseen: bool = True,
    adapt: bool = True,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Variability:
    """What the cases of a fit share and where they differ; writes variability.json and figures.

    Parameters
    ----------
    folder : results of `fit` (published features or recorded trials), or "thesis" for the published features without
    a fit: the draws of each case are then made here. out : where to write; default the folder itself
    ("results/variability" for "thesis"). seed : decides every random number. particles : of each run of the tempering.
    repeats : runs of each answer with all cases; their spread is the error of its evidence. adapt : runs whose repeats
    differ too much in their means are made again with four times as many particles, up to 1024; False keeps
    `particles`. draws : for the effective linear parameters. unseen : False leaves out the predictions of each case
    from the others, which take much of the time for published features. workers : processes; scheduler :
    address of a Dask cluster in their place; progress : receives how far it is, as in `fit`. A run that was stopped
    goes on when the call is made again.

    Raises
    ------
    InputError
        if the folder holds no fit, or one of fewer than two cases, or an argument cannot be used.
    Interrupted
        after Ctrl-C.
    """
    if particles < _FEWEST_PARTICLES or repeats < 1 or draws < 8:
        raise InputError("variability needs at least 32 particles, 1 repeat and 8 draws; raise those that are below")
    plan, fitted = _read_fit(folder)
    target = Path(out) if out is not None else fitted or Path("results/variability")
    report = partial((progress or Silent()).update, "variability")
    with kernel_threads(workers):
        cases = PublishedCases(plan) if is_published(plan["campaign"]) else RecordedCases(plan, report)
    rng = np.random.default_rng([seed, 5])
    settings: PoolingSettings = {"fit": plan, "seed": seed, "particles": particles, "repeats": repeats}
    run = {**settings, "source": str(folder), "draws": draws, "unseen": unseen, "adapt": adapt}
    claim(target / "variability", {"command": "variability", "plan": run, "code": code_sha256()}, workers)
    more: VariabilityFile = {}
    check: AgreementEntry | None = None
    if isinstance(cases, PublishedCases):
        work = target / "variability"
        runs, chosen = _run_published(cases, settings, work, unseen, adapt, workers, scheduler, progress)
        models = cases.models(runs, chosen, work)
        more, parts = _averaged(cases, models, runs, chosen, work, rng)
        sets: Sets | None = published_sets(cases, _some(parts, draws, rng), rng)
    else:
        with kernel_threads(workers):
            models, sets, check = _compared_records(cases, plan, fitted or target, rng, particles, draws)
    found = None if sets is None else decompose(sets)
    _add_probabilities(models)
    fit_converged = bool(plan.get("fit_converged", True))
    result: VariabilityFile = {
        "schema": SCHEMA,
        "campaign": plan["name"],
        "campaign_sha256": plan["campaign_sha256"],
        "seed": seed,
        "converged": fit_converged and all(m["spread"] < _LARGEST_SPREAD for m in models.values()),
        "kind": cases.kind,
        "cases": list(cases.names),
        "pooled": list(cases.pooled),
        "common": list(cases.common),
        "method": cases.method,
        "models": models,
        **more,
        "recycled": check,
        "effective": found.effective if found is not None else None,
        "decomposition": found.parts if found is not None else None,
        "method_of_effective": found.method if found is not None else None,
    }
    if more:
        result["would_settle"] = list(WOULD_SETTLE)
    summary = {} if fitted is None else read_json(fitted / "summary.json")
    result["warnings"] = list(summary.get("warnings", ()))
    result["warnings_of_check"] = summary.get("warnings_of_check", 0)
    result["sentences"] = _sentences(result, fit_converged)
    result["provenance"] = provenance()
    result = cast("VariabilityFile", plain(result))
    write_json(target / "variability.json", result)
    _draw(target, cases, plan["name"], result)
    return Variability(target, result)


def _compared_records(
    cases: RecordedCases, plan: FittedPlan, fitted: Path, rng: np.random.Generator, particles: int, draws: int
) -> tuple[dict[str, PoolingEntry], Sets | None, AgreementEntry]:
    """What variability.json says of the answers, draws by which the scatter is divided, and how the fit agrees."""
    models, pooled_draws, common_draws = cases.models(rng, particles, draws)
    cases.report(0.6, "simulating what each part of the scatter does")
    sets = recorded_sets(cases, pooled_draws, common_draws, rng)
    cases.report(0.8, "comparing with the draws of the fit")
    draws_of = {
        case: cases.reweighted(case, z, rng)
        for case, z in _fit_draws(fitted, plan, cases, lambda _: cases.pooled).items()
    }
    used, direct = recycle(draws_of, rng, particles), cases.direct(rng, particles)
    return models, sets, _agreement(used, direct, cases.pooled, cases.priors(cases.names[0]))


def _draw(target: Path, cases: PublishedCases | RecordedCases, name: str, result: VariabilityFile) -> None:
    """The figures."""
    if result["effective"] is not None and result["decomposition"] is not None:
        title = f"{name}: effective linear stiffness and damping"
        drawn = figures.variability_figure(
            result["effective"],
            result["decomposition"],
            kind=cases.kind,
            title=title,
            measured=cases.measured,
            converged=result["converged"],
        )
        figures.save(drawn, target / "variability_effective")
    figures.save(_scatter_figure(result), target / "variability_scatter")


def _score(model: PoolingEntry) -> str:
    score = model["heldout"]["log_score"]
    return "-" if score is None else f"{score:.2f}"


def _read_fit(folder: str | Path) -> tuple[FittedPlan, Path | None]:
    """The plan of a fit and its folder."""
    if is_published(folder):
        return PublishedCases.default_plan(), None
    path = Path(folder)
    if not path.is_dir():
        raise InputError(
            f"{folder}: there is no such folder; name one that `bayes-damper fit` has written, or `thesis`"
        )
    if not (path / "summary.json").exists():
        more = (
            "; the fit there is unfinished, `bayes-damper resume` goes on with it"
            if (path / "run.json").exists()
            else ""
        )
        raise InputError(f"{folder}: holds no results of `bayes-damper fit` (no summary.json){more}")
    summary, run = read_json(path / "summary.json"), run_record(path)
    schema = summary.get("schema") if isinstance(summary, dict) else None
    if schema != "bayes-damper/fit/1" or run.get("command") != "fit":
        raise InputError(
            f"{folder}: summary.json is of {schema!r}; variability needs the results of `bayes-damper fit`"
        )
    fields(run["plan"], _OF_A_FIT, f"{path / 'run.json'}: damaged", "fit anew")
    plan = cast("FittedPlan", dict(run["plan"]))
    known = fields(summary, {"converged": (bool,)}, f"{path / 'summary.json'}: damaged", "fit anew")
    plan["fit_converged"] = known["converged"]
    if plan.get("effect"):
        raise InputError(
            f"{folder}: the model of this fit has the effect {plan['effect']}; variability knows the nominal model "
            "only: give it a fit without --effect"
        )
    if len(plan["cases"]) < 2:
        raise InputError(f"{folder}: holds one case only; fit two cases or more to ask how they differ")
    return plan, path


_OF_A_FIT: dict[str, tuple[type, ...]] = {
    "campaign": (str,), "name": (str,), "campaign_sha256": (str,), "cases": (list,), "priors": (dict, NoneType),
    "normal_force": (str, NoneType), "seed": (int,),
}  # fmt: skip
_PLANNED: dict[str, tuple[type, ...]] = {
    "source": (str,), "seed": (int,), "particles": (int,), "repeats": (int,), "draws": (int,), "unseen": (bool,),
    "adapt": (bool,),
}  # fmt: skip


def finish_variability(
    work: Path, record: RunRecord, *, workers: int | None = None, progress: Progress | None = None
) -> Variability:
    """Go on with a run whose pieces and run.json (`record`) lie in `work`, the folder "variability" of its results."""
    plan = fields(record["plan"], _PLANNED, f"{work / 'run.json'}: damaged", "give the same command again")
    return variability(
        plan["source"], out=work.parent, seed=plan["seed"], particles=plan["particles"], repeats=plan["repeats"],
        draws=plan["draws"], unseen=plan["unseen"], adapt=plan["adapt"], workers=workers or record["workers"],
        progress=progress,
    )  # fmt: skip


def _run_published(
    cases: PublishedCases, settings: PoolingSettings, work: Path, unseen: bool, adapt: bool, workers: int,
    scheduler: str | None, progress: Progress | None,
) -> tuple[dict[str, PoolingRun], dict[str, list[str]]]:  # fmt: skip
    """All runs: each answer from the prior, then each under other assumptions from the draws of those.

    Returns what each run found, and the runs that count: those of the most particles, "ANSWER-all" -> names.
    """
    repeats = range(settings["repeats"])

    def with_all(pooling: str, particles: int) -> list[Task]:
        grown = "" if particles == settings["particles"] else f"{particles}-"
        given = {"settings": {**settings, "particles": particles}, "pooling": pooling}
        return [Task(f"{pooling}-all-{grown}{k}", run_pooling, given | {"repeat": k}) for k in repeats]

    base = settings["particles"]
    order = ("partial", "separate", "shared")  # the longest first
    tasks = [task for pooling in order for task in with_all(pooling, base)]
    chosen = {f"{pooling}-all": [task.name for task in with_all(pooling, base)] for pooling in POOLINGS}
    runs = run_tasks(tasks, work, workers=workers, scheduler=scheduler, progress=progress)
    particles = base
    while adapt and len(repeats) > 1 and particles * _MORE <= _MOST_PARTICLES:
        apart = [pooling for pooling in order if cases.apart(f"{pooling}-all", chosen[f"{pooling}-all"], work) > _APART]
        particles *= _MORE
        again = [task for pooling in apart for task in with_all(pooling, particles)]
        if not again:
            break
        runs |= run_tasks(again, work, workers=workers, scheduler=scheduler, progress=progress)
        chosen |= {f"{pooling}-all": [task.name for task in with_all(pooling, particles)] for pooling in apart}
    if unseen:
        others = [
            Task(
                f"{pooling}-{scenario.name}", run_scenario,
                {"settings": {**settings, "particles": runs[chosen[f"{pooling}-all"][0]]["particles"]},
                 "pooling": pooling, "scenario": scenario.name, "runs": chosen[f"{pooling}-all"]},
            )
            for pooling in order for scenario in scenarios(cases.names)
        ]  # fmt: skip
        runs |= run_tasks(others, work, workers=workers, scheduler=scheduler, progress=progress)
    return runs, chosen


def _averaged(
    cases: PublishedCases, models: Mapping[str, PoolingEntry], runs: Mapping[str, PoolingRun],
    chosen: Mapping[str, Sequence[str]], work: Path, rng: np.random.Generator,
) -> tuple[VariabilityFile, Parts]:  # fmt: skip
    """The answer averaged over the three, the same under other assumptions, and its draws."""
    height = {pooling: float(models[pooling]["log_evidence"]) for pooling in POOLINGS}
    error = {pooling: float(models[pooling]["error"]) for pooling in POOLINGS}
    draws = {pooling: cases.draws(chosen[f"{pooling}-all"], work) for pooling in POOLINGS}
    parts = mixture(cases, draws, probabilities_of(height), DRAWS, rng)
    answer = averaged(cases, parts, rng)
    rows: list[AssumptionEntry] = [{"change": "as they are", "probabilities": probabilities_of(height),
             "probability_errors": spread_of(height, error, rng), "averaged": answer}]  # fmt: skip
    for scenario in scenarios(cases.names):
        names = {pooling: f"{pooling}-{scenario.name}" for pooling in POOLINGS}
        if any(name not in runs for name in names.values()):
            continue
        _, other = cases.bridge("shared", scenario)
        moved, unsure = {}, {}
        for pooling in POOLINGS:
            run = runs[names[pooling]]
            anew = "log_z" in run
            moved[pooling] = run["log_z"] if anew else height[pooling] + run["gain"]
            unsure[pooling] = run["error"] if anew else math.hypot(error[pooling], run["error"])
        there = {pooling: cases.draws([names[pooling]], work) for pooling in POOLINGS}
        found = averaged(other, mixture(other, there, probabilities_of(moved), DRAWS, rng), rng, own=False)
        rows.append({"change": scenario.words, "probabilities": probabilities_of(moved), "log_evidence": moved,
                     "probability_errors": spread_of(moved, unsure, rng), "averaged": found})  # fmt: skip
    return {"averaged": answer, "assumptions": rows, "survives": what_survives(rows)}, parts


def _some(parts: Parts, count: int, rng: np.random.Generator) -> Parts:
    """About `count` draws of each answer's, in the same shares."""
    whole = sum(len(points) for _, points in parts)
    taken = [(h, x, max(round(count * len(x) / whole), 2)) for h, x in parts if count * len(x) >= whole]
    return [(h, x[rng.choice(len(x), n, replace=False)]) for h, x, n in taken]


def _fit_draws(
    folder: Path, plan: FittedPlan, cases: PublishedCases | RecordedCases, names: Callable[[str], Sequence[str]]
) -> dict[str, Array]:
    """The fit's draws of some parameters in standard coordinates: case -> (n, names), spread over the whole chain."""
    out = {}
    for case in plan["cases"]:
        file = folder / folder_name(case) / "posterior.nc"
        if not file.exists():
            raise InputError(f"{file}: is missing; run `bayes-damper fit` again")
        posterior = arviz_adapter.read(file)["posterior"]
        priors = cases.priors(case)
        columns = [to_standard(priors[name], np.asarray(posterior[name].values).ravel()) for name in names(case)]
        z = np.stack(columns, axis=1)
        out[case] = z[np.linspace(0, len(z) - 1, min(len(z), _RECYCLED_DRAWS)).round().astype(int)]
    return out


def _agreement(
    recycled: Recycled, direct: Direct, pooled: Sequence[str], priors: Mapping[str, Distribution]
) -> AgreementEntry:
    """The two ways to the hierarchy beside each other: evidence; common value, scatter, and cases of each parameter.

    Differences are those of means, in standard deviations of the direct draws; the common value is that of a case in
    the middle of the population.
    """
    rows: dict[str, float] = {}
    parameters: dict[str, TwoWaysOfParameter] = {}
    for j, name in enumerate(pooled):
        rows[f"scatter of {name}"] = _difference(recycled.scatter[:, j], direct.scatter[:, j])
        rows[f"common {name}"] = _difference(_middle(recycled)[:, j], _middle(direct)[:, j])
        for case, z in direct.values.items():
            rows[f"{name} of case {case}"] = _difference(recycled.values[case][:, j], z[:, j])
        parameters[name] = {
            "common": {
                "recycled": summary(from_standard(priors[name], _middle(recycled)[:, j])),
                "direct": summary(from_standard(priors[name], _middle(direct)[:, j])),
            },
            "scatter": {"recycled": summary(recycled.scatter[:, j]), "direct": summary(direct.scatter[:, j])},
            "cases": {
                case: {
                    "recycled": summary(from_standard(priors[name], recycled.values[case][:, j])),
                    "direct": summary(from_standard(priors[name], z[:, j])),
                }
                for case, z in direct.values.items()
            },
        }
    least = min(*recycled.ess.values(), len(recycled.scatter))
    allowed = 0.15 + 4.0 * math.sqrt(1.0 / least + 4.0 / len(direct.scatter))
    worst = max(rows, key=lambda key: abs(rows[key]))
    return {
        "ess": dict(recycled.ess),
        "pareto_k": dict(recycled.pareto_k),
        "ess_of_one_population": dict(recycled.ess_of_one),
        "draws": recycled.used,
        "drawn_again": False,  # kept for readers of the file: no draw is made anew any more
        "reliable": recycled.reliable,
        "log_evidence_over_separate": recycled.log_z,
        "error": recycled.error,
        "direct_log_evidence_over_separate": direct.log_z,
        "direct_error": direct.error,
        "direct_repeats_apart_sd": direct.apart,
        "parameters": parameters,
        "differences_sd": rows,
        "largest_difference_sd": abs(rows[worst]),
        "largest_at": worst,
        "allowed_difference_sd": allowed,
        "agree": abs(rows[worst]) <= allowed,
    }


def _middle(way: Recycled | Direct) -> Array:
    return np.asarray(np.sqrt(1.0 - way.scatter**2) * way.mean)


def _difference(a: Array, b: Array) -> float:
    return float((a.mean() - b.mean()) / max(float(b.std()), 1e-12))


def _add_probabilities(models: Mapping[str, PoolingEntry]) -> None:
    """Probability of each answer, all three being equally probable before."""
    height = np.array([m["log_evidence"] for m in models.values()])
    share = np.exp(height - height.max())
    for model, p in zip(models.values(), share / share.sum(), strict=True):
        model["probability"] = float(p)


def _sentences(result: VariabilityFile, fit_converged: bool) -> list[str]:
    models, check = result["models"], result["recycled"]
    best = max(models, key=lambda name: models[name]["log_evidence"])
    others = [models[best]["log_evidence"] - models[n]["log_evidence"] for n in models if n != best]
    out = [f"Evidence is highest for {MEANING[best]}, by {min(others):.1f} and {max(others):.1f} nats."]
    scores = {name: score for name, m in models.items() if (score := m["heldout"]["log_score"]) is not None}
    if len(scores) == len(models):
        seen = max(scores, key=lambda name: scores[name])
        out.append(f"{models[best]['heldout']['what']}: best predicted by {MEANING[seen]}.")
    if not fit_converged:
        out.insert(0, "The fit that this rests on did not converge.")
    out += [
        f"The model {name} spreads by {m['spread']:.1f} nats between runs: raise particles."
        for name, m in models.items()
        if m["spread"] >= _LARGEST_SPREAD
    ]
    slow = [name for name, m in models.items() if m.get("memory", 0.0) > _WORST_MEMORY]
    if slow:
        known_by = min(m.get("repeats", 1) for m in models.values())
        out.append(
            f"Particles moved slowly ({', '.join(slow)}), which widens the errors of their evidences; "
            + (
                "give --repeats 2 or more."
                if known_by < 2
                else f"the differences between {known_by} repeats are included."
            )
        )
    known = [apart for m in models.values() if (apart := m.get("repeats_apart_sd")) is not None]
    if known:
        one = models["partial"]
        out.append(
            f"Means of repeated runs differ by {max(known):.2f} of their standard deviations at most (root mean square "
            f"over the unknowns); those of {MEANING['partial']} have a Monte Carlo error of "
            f"{one['monte_carlo_error_sd']:.2f} standard deviations (at most "
            f"{one['largest_monte_carlo_error_sd']:.2f}, {one['largest_monte_carlo_error_at']})."
        )
    out += _about_recycled(check) if check else []
    out += _about_assumptions(result) if "averaged" in result else []
    decomposition = result["decomposition"] or {}
    for name, parts in decomposition.items():
        shares = {key: row["share"] for key, row in parts.items() if isinstance(row, Mapping) and "share" in row}
        first = max(shares, key=lambda key: shares[key]["median"])
        low, high = shares[first]["hdi90"]
        sure = parts["probability_largest"][first]
        out.append(
            f"Scatter of the effective {name} over the cases, if they may differ: the largest share comes from "
            f"{first.replace('_', ' ')} ({100 * shares[first]['median']:.0f} %, 90 % interval {100 * low:.0f} to "
            f"{100 * high:.0f} %; it is the largest with a probability of {sure:.2f})."
        )
    if decomposition:
        out.append(
            f"The cases differ at all with a probability of {1.0 - models['shared']['probability']:.2f}; if they do "
            "not, the other parts are the whole scatter."
        )
    return out + (_about_cases(result) if "averaged" in result else [])


def _about_cases(result: VariabilityFile) -> list[str]:
    """Of each case, whether what a linear fit found is what the averaged model gives by the same recipe."""
    out = []
    for case, row in (result["effective"]["cases"] if result["effective"] else {}).items():
        notes = []
        for name, value in (row.get("measured") or {}).items():
            (low, high), median = row[name]["hdi90"], row[name]["median"]
            place = "inside" if low <= value <= high else "above" if value > high else "below"
            notes.append(f"{name} = {value:g}, {place} the predicted {median:.2g} ({low:.2g} to {high:.2g})")
        if notes:
            out.append(f"Case {case}, linear fit: {'; '.join(notes)}.")
    return out


def _about_recycled(check: AgreementEntry) -> list[str]:
    """Whether the draws of single cases, used again, agree with the direct way."""
    out = []
    worst = max(check["pareto_k"].values())
    k = (
        f"effective draws {min(check['ess'].values()):.0f} or more, {min(check['ess_of_one_population'].values()):.0f} "
        f"under one population, Pareto k at most {worst:.2f}"
    )
    if not check["reliable"]:
        out.append(f"The fit's draws used again by weights cannot be trusted here ({k}): use the probabilities above.")
    elif check["agree"]:
        out.append(f"The fit's draws used again by weights ({k}) agree with direct sampling.")
    elif check["direct_repeats_apart_sd"] > _APART:
        out.append(
            f"The fit's draws used again by weights ({k}) cannot be compared with direct sampling, whose repeats "
            f"differ by {check['direct_repeats_apart_sd']:.2f} standard deviations: raise particles."
        )
    else:
        out.append(
            f"The fit's draws used again by weights ({k}) differ from direct sampling by "
            f"{check['largest_difference_sd']:.2f} standard deviations in {check['largest_at']}."
        )
    return out


def _about_assumptions(result: VariabilityFile) -> list[str]:
    """What the table of assumptions lets one say without "if", and what not."""
    rows, kept = result["assumptions"], result["survives"]
    several = f"under each of the {len(rows)} sets of assumptions" if len(rows) > 1 else "under these assumptions"
    out = []
    low, high = kept["structures"]["separate"]
    if high < 0.5:
        out.append(f"A parameter set of its own for each case is improbable {several} ({low:.2f} to {high:.2f}).")
    low, high = kept["structures"]["shared"]
    if low < 0.5 < high:
        out.append(
            "Whether one set serves all cases or values scatter depends on the assumptions "
            f"(one set: {low:.2f} to {high:.2f})."
        )
    else:
        out.append(f"One set for all cases has the probability {low:.2f} to {high:.2f} {several}.")
    sure = [name for name, row in kept["parameters"].items() if row["survives"]]
    for name in sure:
        (first, last), (lowest, highest) = kept["parameters"][name]["medians"], kept["parameters"][name]["hdi90"]
        out.append(
            f"{name} lies between {lowest:.2g} and {highest:.2g} in every case {several} "
            f"(medians {first:.2g} to {last:.2g})."
        )
    rest = [name for name in kept["parameters"] if name not in sure]
    if rest:
        out.append(f"Results for {', '.join(rest)} depend on the priors.")
    return out


def _scatter_figure(result: VariabilityFile) -> Any:
    rows = result["models"]["partial"]["scatter"]
    intervals = {
        "scatter": {
            name: (row["hdi90"][0], row["median"], row["hdi90"][1]) for name, row in rows.items()
        }
    }  # fmt: skip
    return figures.forest_figure(
        intervals,
        {"scatter": "scatter over cases / scatter that the prior allows"},
        title=f"{result['campaign']}: 0 = one value for all cases, 1 = each its own",
        converged=result["converged"],
    )
