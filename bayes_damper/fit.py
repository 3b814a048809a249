"""Fitting: from published features or recorded trials to posteriors per case, and of all cases together.

`fit` is what `bayes-damper fit` calls. Each case is a task of run.py in a folder of its own, so that cases run side by
side, and an interrupted fit goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper import arviz_adapter, figures
from bayes_damper.arviz_adapter import hdi
from bayes_damper.calibration import (
    Calibration,
    Experiment,
    calibrate,
    calibrate_nominal,
    experiment_of,
    learn_noise,
    middle,
)
from bayes_damper.campaign import Campaign, load_campaign
from bayes_damper.checkpoint import Checkpoint
from bayes_damper.effects import all_effects
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.evidence import bridge
from bayes_damper.influence import comparison, influence, without
from bayes_damper.noise import KINDS, FittedNoise, fit_with_noise
from bayes_damper.parameters import PARAMETERS, hint, unit_of
from bayes_damper.posterior import Coordinates, Datum, FeaturePosterior, damping_pairs
from bayes_damper.priors import PriorSet, campaign_priors, load_priors, priors_from_dict
from bayes_damper.provenance import code_sha256, package_version, provenance
from bayes_damper.published import load_published
from bayes_damper.record_posterior import RecordPosterior, trial_label
from bayes_damper.run import WAITING, Progress, Silent, Task, folder_name, read_json, run_tasks, stopped, write_json
from bayes_damper.sampling import Progress as Stage
from bayes_damper.sampling import Sampling, Start, StoppingRule, annealed_start, resampled_start, sample
from bayes_damper.sensitivity import decided_by, of_standard_draws
from bayes_damper.sensitivity import text as sensitivity_text
from bayes_damper.summary import summarise, table_text, write_table
from bayes_damper.units import effect_unit
from bayes_damper.wording import gathered

Array = NDArray[np.float64]
Report = Callable[[float, str], None]
Units = Callable[[str], str]
SCHEMA = "bayes-damper/fit/1"
PROPOSALS = 4000
"""Points of bridge sampling for the evidence."""
KEPT_DRAWS = 4000
"""Draws of each case that go into posterior.nc: thinned so that they are all but independent."""
WARM = 0.15
"""Share of a case's time after which the warm-up is over."""
DRAWN = 0.7
"""Share of a case's time after which its draws are there, as seen in runs of some trials: what follows is told too."""


@dataclass(frozen=True)
class Fit:
    """Posteriors of a campaign: `summary` is what summary.json holds, `folder` where all files are."""

    folder: Path
    summary: Mapping[str, Any]

    @property
    def converged(self) -> bool:
        """Whether every run met the stopping rule."""
        return bool(self.summary["converged"])

    @property
    def exit_code(self) -> ExitCode:
        return ExitCode.DONE if self.converged else ExitCode.NOT_CONVERGED

    def to_json(self) -> dict[str, Any]:
        """What summary.json holds."""
        return dict(self.summary)

    def text(self) -> str:
        """Tables for the terminal, warnings first."""
        parts = [f"warning: {w}" for w in gathered(self.summary.get("warnings", ()))]
        groups = dict(self.summary["cases"]) | ({"joint": self.summary["joint"]} if self.summary.get("joint") else {})
        for name, found in groups.items():
            title = "all cases together" if name == "joint" else f"case {name}"
            if not found["converged"]:
                title += "   *** DID NOT CONVERGE: do not use these numbers ***"
            parts.append(table_text(found["parameters"], title))
            parts += [f"  {sentence}" for sentence in found["sentences"]]
            parts += _more_text(found)
        parts.append(f"Files: {self.folder}")
        return "\n".join(parts)


def _more_text(found: Mapping[str, Any]) -> list[str]:
    """Lines on trials apart, priors and evidence of one entry of summary.json."""
    lines = []
    apart = found.get("unlike_repeats")
    if apart:
        for row in apart["trials"]:
            more = " (or its only repeat is the odd one)" if row["or_its_only_repeat"] else ""
            lines.append(
                f"  Trial {row['trial']} is unlike its repeats{more}: its residuals have {row['residual_power']:.1f} "
                "times their power. Look at the record; set holdout = true in trials.csv to fit without it."
            )
        if apart["answers"]:
            shifts = {n: p["shift_sd"] for n, p in apart["answers"].items() if not math.isclose(p["shift_sd"], 0.0)}
            worst = sorted(shifts, key=lambda n: -abs(shifts[n]))[:4]
            told = ", ".join(
                f"{n} {apart['answers'][n]['with']['value']:.4g} -> {apart['answers'][n]['without']['value']:.4g} "
                f"({shifts[n]:+.1f} sd)"
                for n in worst
            )
            lines.append(f"  Without: {told}.")
        else:
            lines.append("  Without it a configuration would have no trial left: no answer without it.")
    if found.get("prior_sensitivity"):
        lines += sensitivity_text(found["prior_sensitivity"])
    if found.get("log_evidence"):
        e = found["log_evidence"]
        lines.append(
            f"  Log evidence {e['value']:.2f} +- {e['error']:.2f} nats ({e['health']:.0%} of proposals count)."
        )
    return lines


def fit(
    campaign: str | Path,
    *,
    cases: Sequence[str] | None = None,
    priors: str | Path | None = None,
    normal_force: str | None = None,
    noise: str = "auto",
    effect: str | None = None,
    effects: str | Path | None = None,
    out: str | Path = "results/fit",
    seed: int = 1,
    workers: int = 1,
    scheduler: str | None = None,
    thorough: bool = False,
    most_steps: int | None = None,
    joint: bool = True,
    progress: Progress | None = None,
) -> Fit:
    """Posterior of each case, and of all cases together for a campaign; all files are written to `out`.

    Parameters
    ----------
    campaign : folder of a campaign, or "thesis" for the published measurements.
    cases : only these; default all. priors : prior file in place of the shipped one. normal_force : "linear" or
    "constant" (eq. 20), overrides the campaign's. noise : "gaussian" (white), "student" (outliers), "ar" (correlated,
    learnt from what the fit leaves) or "auto", by the data. effect : name of one effect of the library that the model
    gets, in the formula that fits best, e.g. the verdict of a diagnosis; effects : folder with effects of your own.
    seed : decides every random number. workers : processes. thorough : 50 autocorrelation times in place of 20.
    most_steps : give up after so many steps of each ensemble. joint : whether to fit all cases of a campaign
    together too.

    Raises
    ------
    InputError
        if the campaign, a prior or an argument cannot be used, or `out` holds another run.
    Interrupted
        after Ctrl-C; `resume` goes on.
    """
    folder = Path(out)
    plan = plan_fit(
        str(campaign), cases=cases, priors=None if priors is None else str(priors), normal_force=normal_force,
        noise=noise, effect=effect, effects=None if effects is None else str(effects), seed=seed,
        thorough=thorough, most_steps=most_steps, joint=joint,
    )  # fmt: skip
    start_run(folder, {"command": "fit", "plan": plan, "workers": workers})
    return finish_fit(folder, plan, workers=workers, scheduler=scheduler, progress=progress)


def plan_fit(
    campaign: str,
    *,
    cases: Sequence[str] | None,
    priors: str | None,
    normal_force: str | None,
    noise: str = "auto",
    effect: str | None = None,
    effects: str | None = None,
    seed: int,
    thorough: bool,
    most_steps: int | None,
    joint: bool,
) -> dict[str, Any]:
    """Everything that decides the results of a fit, as plain data."""
    thesis = campaign == "thesis"
    prior_set: PriorSet | None
    if thesis:
        published = load_published()
        known: Sequence[str] = tuple(published.cases)
        checksum, name = published.checksum, "thesis"
        prior_set = load_priors(priors or "thesis")
    else:
        loaded = load_campaign(campaign)
        known, checksum, name = loaded.cases, loaded.sha256, loaded.name
        beside = Path(campaign) / "priors.toml"
        file = Path(priors) if priors is not None else beside if beside.exists() else None
        prior_set = None if file is None else campaign_priors(file, loaded)
        experiment_of(loaded, prior_set)  # tells what the file and the campaign contradict each other in
    chosen = list(known) if cases is None else list(dict.fromkeys(cases))
    unknown = [case for case in chosen if case not in known]
    if unknown:
        raise InputError(f"--case {unknown[0]}: there is no such case; {campaign} has {', '.join(known)}")
    if taken := [case for case in chosen if case in _TAKEN]:
        raise InputError(
            f"case {taken[0]!r}: results have a folder of that name; give the case another label in trials.csv"
        )
    if normal_force not in (None, "linear", "constant"):
        raise InputError(f"normal_force {normal_force!r}: expected linear or constant")
    if noise not in KINDS:
        raise InputError(f"--noise {noise}: expected one of {', '.join(KINDS)}")
    if effect is not None:
        if thesis:
            raise InputError(
                "--effect: `diagnose thesis` weighs effects by the published features; a fit needs records"
            )
        known_effects = all_effects(effects)
        if effect not in known_effects:
            raise InputError(f"--effect {effect}: there is no such effect; {hint(effect, known_effects)}")
    if noise != "auto" and thesis:
        raise InputError("--noise: the published features have standard errors of their own; leave it out")
    return {
        "campaign": campaign if thesis else str(Path(campaign).resolve()),
        "name": name,
        "campaign_sha256": checksum,
        "cases": chosen,
        "joint": joint and not thesis and len(chosen) > 1,
        "priors": None if prior_set is None else prior_set.to_dict(),
        "normal_force": normal_force,
        "noise": noise,
        "effect": effect,
        "effects": None if effects is None else str(Path(effects).resolve()),
        "seed": seed,
        "thorough": thorough,
        "most_steps": most_steps,
    }


_TAKEN = ("joint", "variability")
"""Folders beside those of the cases: of all cases together, and of the pieces of `variability`."""
_PLANNED = ("campaign", "name", "campaign_sha256", "cases", "joint", "priors", "normal_force", "seed", "thorough",
           "most_steps")  # fmt: skip


def plan_in(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The plan of a fit that run.json holds.

    Raises
    ------
    InputError
        if it holds none, or one of another version.
    """
    plan = record.get("plan")
    missing = [key for key in _PLANNED if not isinstance(plan, Mapping) or key not in plan]
    if missing or not isinstance(plan, Mapping):
        raise InputError(f"{folder / 'run.json'}: holds no plan of this version ({missing[0]} is missing); fit anew")
    return dict(plan)


class OtherRun(InputError):
    """A folder holds what is not to be mixed with the run asked for: nothing was touched, and `beside` is free."""

    def __init__(self, folder: Path, what: str, more: str) -> None:
        taken = (folder.with_name(f"{folder.name}-{k}") for k in itertools.count(2))
        self.beside = next(path for path in taken if not path.exists())
        super().__init__(
            f"{folder}: {what}. Nothing was touched.{more} For new results beside it, begin with --out {self.beside}; "
            f"for new ones in its place: mv {folder} {self.beside}, then the same command again"
        )


def start_run(folder: Path, record: Mapping[str, Any]) -> None:
    """Note in `folder` what runs there and what runs it, so that `resume` can go on; refuse a folder of another run.

    A run of which nothing was saved is none.

    Raises
    ------
    InputError
        if the folder holds a run with another plan, or of another version, with every difference.
    """
    path = folder / "run.json"
    if path.exists() and any(p.is_dir() for p in folder.iterdir()):
        before = read_json(path)
        changed = _differences("command", before.get("command"), record["command"])
        changed += _differences("", before.get("plan", {}), record["plan"])
        if changed:
            raise OtherRun(folder, f"holds another run: {'; '.join(changed)}", "")
        refuse_changes(folder, before)
    write_json(path, dict(record) | {"made_by": _versions()})


def refuse_changes(folder: Path, record: Mapping[str, Any]) -> None:
    """Refuse to go on with a run (the contents of its run.json) that other code began, before any work.

    Raises
    ------
    InputError
        with every difference.
    """
    if changed := _differences("", record.get("made_by", {}), _versions()):
        ended = (folder / "summary.json").exists()
        what = "results that are complete, made by" if ended else "an unfinished run of"
        more = "" if ended else " To go on with it, install again what it began with."
        raise OtherRun(folder, f"holds {what} another version of the code: {'; '.join(changed)}", more)


def _versions() -> dict[str, str]:
    """What else than its plan decides the draws of a run, bit for bit."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba", "emcee")}
    return {"bayes_damper": package_version(), "source files (SHA-256)": code_sha256()[:12]} | libraries


def _differences(name: str, before: Any, now: Any) -> list[str]:
    """Every entry that differs, in words: name was one thing and is another now."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        keys = dict.fromkeys([*before, *now])
        parts = [_differences(f"{name}.{key}".lstrip("."), before.get(key), now.get(key)) for key in keys]
        return [sentence for part in parts for sentence in part]
    said = ["not set" if x is None else ", ".join(map(str, x)) if isinstance(x, list) else x for x in (before, now)]
    return [] if before == now else [f"{name} was {said[0]} and is {said[1]} now"]


def finish_fit(
    folder: Path,
    plan: Mapping[str, Any],
    *,
    workers: int,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Run what is missing of a planned fit, then write the files that cover all cases.

    Raises
    ------
    InputError
        if the campaign is not the one that the fit was planned for.
    """
    warnings = () if plan["campaign"] == "thesis" else _planned_campaign(plan).warnings
    kind = "fit_published_case" if plan["campaign"] == "thesis" else "fit_recorded_cases"
    names = [*plan["cases"], *(["joint"] if plan["joint"] else [])]
    # The joint fit is the longest: it starts first.
    order = sorted(names, key=lambda name: name != "joint")
    # Processes that cases leave idle share the ensembles of one case; so do those of the joint fit, when all else ends.
    processes = {name: workers if name == "joint" or len(names) < workers else 1 for name in order}
    tasks = [
        Task(
            folder_name(name),
            f"bayes_damper.fit:{kind}",
            {"name": name, "plan": dict(plan), "processes": processes[name]},
        )
        for name in order
    ]
    shown = progress or Silent()
    shown.update(_OVERVIEW, 0.0, WAITING)
    done = run_tasks(tasks, folder, workers=workers, scheduler=scheduler, progress=shown)
    results = {name: done[folder_name(name)] for name in names}
    found = {name: results[name] for name in plan["cases"]}
    summary: dict[str, Any] = {
        "schema": SCHEMA,
        "campaign": plan["name"],
        "campaign_sha256": plan["campaign_sha256"],
        "seed": plan["seed"],
        "converged": all(r["converged"] for r in results.values()),
        "warnings": list(warnings),
        "cases": found,
    }
    if plan["joint"]:
        summary["joint"] = results["joint"]
    summary["provenance"] = provenance()
    shown.update(_OVERVIEW, 0.0, "table, posterior.nc and figures of all cases")
    try:
        _write_overview(folder, plan["cases"], summary)
    except KeyboardInterrupt:
        raise stopped(folder) from None
    shown.update(_OVERVIEW, 1.0, "done")
    return Fit(folder, summary)


_OVERVIEW = "overview"


def _write_overview(folder: Path, cases: Sequence[str], summary: Mapping[str, Any]) -> None:
    """The files of all cases together. What other commands look for, summary.json, comes last: until then the run has
    not ended.
    """
    write_table(summary, folder / "summary.csv")
    arviz_adapter.combine_cases(
        {name: folder / folder_name(name) / "posterior.nc" for name in cases}, folder / "posterior.nc"
    )
    _draw_overview(folder, summary)
    write_json(folder / "summary.json", summary)


def stopping_rule(plan: Mapping[str, Any]) -> StoppingRule:
    """The rule that a plan asks for.

    Ensembles that begin as an annealed sample of the posterior have no start to forget: for published features a
    quarter of the autocorrelation times will do, R-hat and effective sample sizes being asked for as ever.
    """
    rule = StoppingRule.thorough() if plan["thorough"] else StoppingRule()
    if plan["campaign"] == "thesis":
        rule = replace(rule, taus=rule.taus / 4.0)
    return rule if plan["most_steps"] is None else replace(rule, max_steps=int(plan["most_steps"]))


# Published features --------------------------------------------------------------------------------------------------


def published_posterior(case: str, priors: PriorSet, normal_force: str = "linear") -> FeaturePosterior:
    """The posterior of one thesis case: six published numbers, priors of the thesis's rig."""
    published = load_published()
    data = [Datum(m.configuration, m.quantity, m.value, m.standard_error, m.n) for m in published.of_case(case)]
    own = priors.for_case(case)
    coordinates = Coordinates(own.free, own.fixed, own.tied, damping_pairs(own.medians()))
    return FeaturePosterior(data, coordinates, normal_force, case)


def fit_published_case(folder: Path, report: Report, *, name: str, plan: Mapping[str, Any], processes: int = 1) -> Any:
    """Task: fit one thesis case and write its files; its entry of summary.json."""
    posterior = published_posterior(name, priors_from_dict(plan["priors"]), plan["normal_force"] or "linear")
    rng = np.random.default_rng([plan["seed"], _number(name)])
    standard = posterior.coordinates.standard
    sampling = _sampled(posterior, folder, report, plan, processes, lambda: _search(posterior, rng), standard)
    flat = sampling.flat()
    draws = {key: _shaped(value, sampling) for key, value in posterior.coordinates.values(flat).items()}
    draws = {key: draws[key] for key in posterior.names} | _derived(draws)
    report(DRAWN, "drawn; left: predictions, files, figures")
    kept = sampling.flat(KEPT_DRAWS)
    features, likelihood = posterior.predict(kept), posterior.log_likelihood(kept)
    noise = rng.standard_t([d.n - 1.0 for d in posterior.data], size=features.shape)
    replicated = features + noise * [d.standard_error for d in posterior.data]
    checks = [
        {
            "name": f"case {name}: {d.name}",
            "unit": {"log_decrement": "1", "period": "s", "max_acceleration": "rad/s^2"}[d.quantity],
            "measured": d.value,
            "standard_error": d.standard_error,
            "median": float(np.nanmedian(features[:, i])),
            "hdi50": list(hdi(features[:, i], 0.5)),
            "hdi90": list(hdi(features[:, i], 0.9)),
            "percentile": float(100.0 * np.mean(replicated[:, i] < d.value)),
        }
        for i, d in enumerate(posterior.data)
    ]
    groups = {
        "prior": _one_chain(posterior.coordinates.values(posterior.coordinates.draw(rng, 2000))),
        "posterior_predictive": {"features": _as_chains(replicated, sampling)},
        "log_likelihood": {"features": _as_chains(likelihood, sampling)},
        "observed_data": {"features": np.array([d.value for d in posterior.data])},
    }
    names = {"features": json.dumps([d.name for d in posterior.data])}
    entry = _entry(draws, _shares(posterior.names, standard(flat)), sampling)
    assumed = _tell_priors(entry, groups["prior"])
    report(0.8, "predicted; left: files, figures")
    _write_draws(folder, draws, sampling, entry["parameters"], groups, _attributes(plan, name) | names)
    entry["predictive"] = checks
    report(0.85, "files written; left: figures")
    _draw_case(folder, f"thesis, case {name}", draws, sampling, entry, assumed)
    return entry


def _search(posterior: FeaturePosterior, rng: np.random.Generator) -> Start:
    coordinates = posterior.coordinates
    return annealed_start(
        coordinates.log_prior, lambda x: posterior.log_likelihood(x).sum(axis=1), coordinates.draw(rng, 2048), rng
    )


# Recorded trials -----------------------------------------------------------------------------------------------------


def _planned_campaign(plan: Mapping[str, Any]) -> Campaign:
    """The campaign that a fit was planned for, as it was then."""
    campaign = load_campaign(plan["campaign"])
    if campaign.sha256 != plan["campaign_sha256"]:
        raise InputError(
            f"{plan['campaign']}: the campaign has changed since this run began; start a new run with another --out"
        )
    return campaign


def recorded_experiment(plan: Mapping[str, Any], case: str | None) -> tuple[Experiment, str]:
    """The trials of one case, or of all planned cases, as a calibration takes them; marked trials are left out.

    With it the kind of the rig.
    """
    campaign = _planned_campaign(plan)
    priors = None if plan["priors"] is None else campaign_priors(plan["priors"], campaign)
    experiment = experiment_of(campaign, priors)
    marked = {t.file for t in campaign.trials if t.holdout}
    wanted = [case] if case is not None else plan["cases"]
    trials = tuple(
        replace(record, heldout=record.label in marked) for record in experiment.trials if record.case in wanted
    )
    law = plan["normal_force"] or experiment.normal_force
    return replace(experiment, trials=trials, normal_force=law), campaign.rig.kind


def fit_recorded_cases(folder: Path, report: Report, *, name: str, plan: Mapping[str, Any], processes: int = 1) -> Any:
    """Task: fit one case of a campaign, or all together (`name` "joint"); its entry of summary.json."""
    experiment, kind = recorded_experiment(plan, None if name == "joint" else name)
    report(0.0, "finding the best fit")
    begin_with = None
    if plan.get("effect") is not None:
        begin_with = fit_with_effect(experiment, plan["effect"], plan["effects"])
    noise = fit_with_noise(experiment, plan.get("noise", "auto"), lambda text: report(0.0, text), begin_with)
    best = noise.fit
    declared = () if best.problem.effect is None else best.problem.effect.parameters
    own = {f"effect.{p.name}": effect_unit(p.unit, kind, experiment.quantity) for p in declared}

    def units(name: str) -> str:
        return own.get(name) or unit_of(name, kind, experiment.quantity)

    freedom = noise.freedom if noise.kind == "student" else None
    posterior = RecordPosterior(best, power=noise.power, freedom=freedom)
    rng = np.random.default_rng([plan["seed"], _number(name)])

    begin = partial(resampled_start, posterior, posterior.start, posterior.covariance, rng)
    sampling = _sampled(posterior, folder, report, plan, processes, begin)
    draws = {key: _shaped(value, sampling) for key, value in posterior.values(sampling.flat()).items()}
    constants = {key: np.full(1, value) for key, (value, _) in experiment.constants.items() if key not in draws}
    draws |= _derived(constants | draws)
    report(DRAWN, "drawn; left: predictions, evidence, files, figures")
    kept = sampling.flat(KEPT_DRAWS)
    likelihood, drawn = posterior.evaluated(kept, rng)
    nuisances = _trial_draws(posterior, drawn)
    few = sampling.flat(60)
    bands = posterior.predictive(few, rng)
    entry = _entry(draws, _shares(posterior.names, sampling.flat()), sampling, units)
    labels = {i: trial_label(experiment.trials[i]) for i in posterior.trials}
    report(0.76, "predicted; left: trials left out, evidence, files, figures")
    entry["noise"] = noise.to_json(units("sigma1"))
    entry["sentences"] += noise.sentences(units("sigma1"))
    entry |= _trials_apart(experiment, noise, labels, plan.get("noise", "auto"))
    entry["prior_sensitivity"] = of_standard_draws(posterior.names, sampling.flat(4 * KEPT_DRAWS))
    report(0.8, "trials compared; left: evidence, files, figures")
    entry["log_evidence"] = _evidence(posterior, sampling, rng)
    entry["trials"] = {
        labels[i]: {
            key: {"mean": float(x.mean()), "sd": float(x.std()), "hdi90": list(hdi(x)), "unit": units(key)}
            for key, x in values.items()
        }
        for i, values in nuisances.items()
    }
    entry["best_fit"] = {
        "chi2": best.chi2,
        "readings": best.problem.n_data,
        "log_evidence_laplace": best.log_evidence,
        "noise_learnt": list(best.problem.noise.total),
        "noise_correlation": list(best.problem.noise.phi),
        "constants_pulled": best.pulled,
        "effect": plan.get("effect"),
        "formula": None if best.problem.effect is None else best.problem.effect.formula,
    }
    per_trial = {
        f"{key}[{labels[i]}]": _as_chains(x, sampling) for i, values in nuisances.items() for key, x in values.items()
    }
    groups: dict[str, Mapping[str, Array]] = {
        "trial_posterior": per_trial,
        "prior": _one_chain(posterior.values(rng.standard_normal((2000, posterior.ndim)))),
        "posterior_predictive": {labels[i]: y[None] for i, y in bands.items()},
        "log_likelihood": {"trials": _as_chains(likelihood + posterior.constant, sampling)},
        "observed_data": {labels[i]: experiment.trials[i].y for i in posterior.trials},
        "constant_data": {labels[i]: experiment.trials[i].times for i in posterior.trials},
    }
    assumed = _tell_priors(entry, groups["prior"], constants)
    report(0.84, "evidence found; left: files, figures")
    names = {"trials": json.dumps([labels[i] for i in posterior.trials])}
    _write_draws(folder, draws, sampling, entry["parameters"], groups, _attributes(plan, name) | names)
    report(0.87, "files written; left: figures")
    title = f"{plan['name']}, {'all cases' if name == 'joint' else f'case {name}'}"
    _draw_case(folder, title, draws, sampling, entry, assumed, units)
    _draw_records(folder, experiment, bands, sampling.converged, units("sigma1"))
    return entry


def fit_with_effect(experiment: Experiment, effect: str, folder: str | None = None) -> Calibration:
    """The best fit of the model with one effect, in the formula with the largest evidence.

    Raises
    ------
    InputError
        if these trials cannot show the effect.
    """
    from bayes_damper.diagnosis.search import Screen, fit_variant, offered, screen_variant

    pool = [(e, v) for e, v in offered(experiment, "nonlinear", all_effects(folder)) if e.name == effect]
    if not pool:
        raise InputError(
            f"--effect {effect}: the rig of these trials cannot have it (see docs, Effects: what each needs)"
        )
    nominal = calibrate_nominal(experiment)
    screen = Screen(nominal)
    found = [fit_variant(nominal, e, v, screen_variant(screen, v), len(v.starts)) for e, v in pool]
    best = max((c.fit for c in found if c.fit is not None), key=lambda f: f.log_evidence)
    again = best.problem.with_noise(learn_noise(best))
    return calibrate(again, [best.q], eta=best.eta, anneal=False)


def _trials_apart(experiment: Experiment, noise: FittedNoise, labels: Mapping[int, str], kind: str) -> dict[str, Any]:
    """Entries `influence` and `unlike_repeats` of summary.json."""
    names = noise.fit.problem.names
    moved = {labels[i]: shift for i, shift in influence(noise.fit).items()}
    found = noise.unlike
    entry: dict[str, Any] = {
        "influence": {
            label: {
                "moves_most": names[k],
                "shift_sd": float(shift[k]),
                "shifts_sd": {n: float(x) for n, x in zip(names, shift, strict=True)},
            }
            for label, shift in moved.items()
            if len(shift)
            for k in [int(np.argmax(np.abs(shift)))]
        },
        "unlike_repeats": None,
    }
    if found:
        other = without(experiment, tuple(u.trial for u in found), kind)
        entry["unlike_repeats"] = {
            "trials": [
                {"trial": labels[u.trial], "residual_power": u.power, "or_its_only_repeat": u.alone} for u in found
            ],
            "answers": None if other is None else comparison(noise.fit, other.fit),
        }
    return entry


def _evidence(posterior: RecordPosterior, sampling: Sampling, rng: np.random.Generator) -> dict[str, Any]:
    """Entry `log_evidence` of summary.json: of the readings, all unknowns integrated out, in nats."""
    found = bridge(posterior, sampling.draws, sampling.log_prob, rng, proposals=PROPOSALS)
    constant = float(posterior.constant.sum())
    return {
        "value": found.log_z + constant,
        "error": found.error,
        "health": found.health,
        "spread_of_halves": found.spread,
        "evaluations": found.evaluations,
        "sentence": found.words(constant),
    }


def _trial_draws(posterior: RecordPosterior, drawn: Mapping[int, Array]) -> dict[int, dict[str, Array]]:
    """What each trial has for itself, from draws of its nuisances in standard coordinates: trial -> name -> (n,).

    Release angle (rad), instant (s), friction and drag relative to those of all trials (ln_mu, ln_drag), and what the
    prior file gives to trials.
    """
    out: dict[int, dict[str, Array]] = {}
    problem = posterior.problem
    for part in posterior.parts:
        for k, i in enumerate(part.group.trials):
            out[i] = {}
            for m, (name, mean, sd) in enumerate(part.group.nuisances):
                value = mean[k] + sd[k] * drawn[i][:, m]
                own = name.removeprefix("ln_")
                if own != name and problem.experiment.levels.get(own) == "trial":
                    case = problem.experiment.trials[i].case
                    out[i][own] = middle(problem.prior(own, case)) * np.exp(value)
                else:
                    out[i][name] = value
    return {i: values for i, values in out.items() if values}


# What both kinds share -----------------------------------------------------------------------------------------------


def _sampled(
    posterior: FeaturePosterior | RecordPosterior,
    folder: Path,
    report: Report,
    plan: Mapping[str, Any],
    processes: int,
    start: Callable[[], Start],
    monitor: Callable[[Array], Array] | None = None,
) -> Sampling:
    """Draws of a posterior, going on from the folder's saved state if there is one."""
    decided = json.dumps({key: plan[key] for key in plan if key not in ("thorough", "most_steps")}, sort_keys=True)
    fingerprint = {
        "plan": hashlib.sha256(decided.encode()).hexdigest(),
        "code": code_sha256(),
    }
    report(0.01, "finding the start")
    begin = start()
    rule = stopping_rule(plan)
    share = 0.0

    def tell(stage: Stage) -> None:
        nonlocal share
        if stage.phase == "warm-up":
            share = max(share, 0.01 + (WARM - 0.01) * stage.part)  # waits where more is expected than before
            report(share, f"warm-up, {stage.steps} steps")
            return
        expected = expected_steps(stage, rule)
        share = max(share, WARM + (DRAWN - WARM) * stage.steps / expected)
        report(share, f"drawing, {stage.steps} of about {expected} steps")

    return sample(
        posterior,
        begin,
        walkers=_walkers(posterior.ndim, 0 if plan["campaign"] == "thesis" else len(begin.population)),
        seed=int(np.random.SeedSequence([plan["seed"], _number(folder.name)]).generate_state(1)[0]),
        rule=rule,
        checkpoint=Checkpoint(folder / "state", fingerprint),
        progress=tell,
        workers=processes,
        monitor=monitor,
    )


def expected_steps(stage: Stage, rule: StoppingRule) -> int:
    """Steps of each ensemble after which a run will have the draws that its rule asks for, or will give up.

    From the latest verdict: effective draws grow with the steps, and what R-hat has above 1 shrinks with them. Before
    the first, from what the warm-up lets expect.
    """
    verdict = stage.verdict
    if verdict is None or not stage.part > 0.0:
        needed = max(rule.taus * stage.tau, stage.least)
    elif verdict.converged:
        needed = stage.steps
    else:
        apart = float(np.nanmax(verdict.r_hat) - 1.0) / (rule.r_hat - 1.0)
        needed = verdict.steps * max(1.2, 1.0 / stage.part, apart)  # the next verdict comes a fifth later
    return math.ceil(max(stage.steps, min(needed, rule.max_steps)))


def _walkers(ndim: int, known: int) -> int:
    """Walkers of an ensemble, a multiple of 32 to fill the lanes of the kernel; fewer where independent draws of the
    posterior are known, the more of them the more coordinates: most moves are then drawn from what they tell, not from
    other walkers.
    """
    few = (known > 0 and ndim <= 12) or (known >= 512 and ndim <= 16)
    return 32 if few else 64 * math.ceil(ndim / 32)


def _number(name: str) -> int:
    """A number that belongs to a name: tasks get seeds of their own, whatever their order."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")


def _shaped(values: Array, sampling: Sampling) -> Array:
    return np.reshape(values, sampling.draws.shape[:3])


def _derived(draws: Mapping[str, Array]) -> dict[str, Array]:
    """Combinations that free decay determines better than their factors."""
    if not {"mu", "N0", "R"} <= set(draws):
        return {}
    torque = draws["mu"] * draws["N0"] * draws["R"]
    found = {"friction_torque": torque}
    if "J1" in draws:
        found["friction_torque_per_inertia"] = torque / draws["J1"]
    return found


def _thinned(draws: Mapping[str, Array], sampling: Sampling) -> dict[str, Array]:
    """The kept draws by ensemble: name -> (ensembles, kept / ensembles)."""
    count = _kept(sampling)
    index = np.linspace(0, sampling.draws.shape[1] * sampling.draws.shape[2] - 1, count).round().astype(int)
    return {key: value.reshape(value.shape[0], -1)[:, index] for key, value in draws.items()}


def _kept(sampling: Sampling) -> int:
    ensembles, steps, walkers = sampling.log_prob.shape
    return int(min(KEPT_DRAWS // ensembles, steps * walkers))


def _one_chain(values: Mapping[str, Array]) -> dict[str, Array]:
    return {key: np.asarray(value)[None] for key, value in values.items()}


def _write_draws(
    folder: Path,
    draws: Mapping[str, Array],
    sampling: Sampling,
    diagnostics: Mapping[str, Mapping[str, Any]],
    groups: Mapping[str, Mapping[str, Array]],
    attributes: Mapping[str, Any],
) -> None:
    found = arviz_adapter.results(
        draws, log_prob=sampling.log_prob, diagnostics=diagnostics, groups=groups, attributes=dict(attributes)
    )
    arviz_adapter.write(found, folder / "posterior.nc")


def _as_chains(values: Array, sampling: Sampling) -> Array:
    """(n, ...) of kept draws as (ensembles, n / ensembles, ...)."""
    ensembles = sampling.draws.shape[0]
    per = len(values) // ensembles
    return values[: per * ensembles].reshape(ensembles, per, *values.shape[1:])


def _entry(
    draws: Mapping[str, Array],
    prior_shares: Mapping[str, float],
    sampling: Sampling,
    units: Units = unit_of,
) -> dict[str, Any]:
    """The entry of summary.json for one run."""
    verdict, outcomes = sampling.verdict, sampling.outcomes
    failed = {name: count for name, count in outcomes.items() if name != "COMPLETED" and count}
    sentences = list(verdict.sentences)
    if failed:
        told = ", ".join(f"{count} {name}" for name, count in failed.items())
        sentences.append(f"Simulations that failed and were given no weight: {told} of {sum(outcomes.values())}.")
    return {
        "converged": verdict.converged,
        "parameters": summarise(draws, {name: units(name) for name in draws}, prior_shares),
        "sentences": sentences,
        "steps": verdict.steps,
        "autocorrelation_steps": float(np.max(verdict.tau)),
        "acceptance": [float(a) for a in sampling.acceptance],
        "evaluations": sampling.evaluations,
        "outcomes": dict(outcomes),
        "stranded_walkers": [list(pair) for pair in verdict.stranded],
    }


def _tell_priors(
    entry: Mapping[str, Any], draws: Mapping[str, Array], constants: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Adds to each parameter of an entry of summary.json what was assumed about it, from draws of its prior.

    Those draws, by parameter: of what was free and of what derives from it.
    """
    before = {
        name: np.ravel(values)
        for name, values in {**draws, **_derived({**(constants or {}), **draws})}.items()
        if name in entry["parameters"] and np.isfinite(values).all() and np.ptp(values) > 0.0
    }
    for name, values in before.items():
        entry["parameters"][name]["prior"] = {"median": float(np.median(values)), "hdi90": list(hdi(values))}
    return before


def _shares(names: Sequence[str], points: Array) -> dict[str, float]:
    """Posterior variance of each standard coordinate: what is left of the prior's own 1."""
    return {name: float(min(1.0, points[:, i].var())) for i, name in enumerate(names)}


def _attributes(plan: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {"campaign": plan["name"], "case": name, "plan": json.dumps(plan), "provenance": json.dumps(provenance())}


# Figures -------------------------------------------------------------------------------------------------------------

_TRACED = 2  # of the kept draws, every so many
_CROWDED = 7  # panels each way of a corner figure; beyond, those that say nothing of their own are left out
_MAIN = ("k1t", "mu", "k2t", "c2t", "drag", "nu", "c1t", "c3t", "friction_torque", "sigma1", "sigma2")


def _axis_labels(units: Mapping[str, str]) -> dict[str, str]:
    """Labels from units by parameter."""
    return {
        name: figures.label(PARAMETERS[name].symbol if name.startswith("friction") else name, unit)
        for name, unit in units.items()
    }


def _draw_case(
    folder: Path,
    title: str,
    draws: Mapping[str, Array],
    sampling: Sampling,
    entry: Mapping[str, Any],
    assumed: Mapping[str, Array],
    units: Units = unit_of,
) -> None:
    """Figures of one case: its entry of summary.json is what they tell, `assumed` draws of the priors."""
    thinned = _thinned(draws, sampling)
    names = [name for main in _MAIN for name in thinned if name.partition("[")[0] == main]
    labels = _axis_labels({name: units(name) for name in draws})
    beside = {"friction_torque", "sigma1", "sigma2"} & set(names) if len(names) > _CROWDED else set()
    flat = {name: thinned[name].ravel() for name in names if name not in beside}
    converged = sampling.converged
    told = {name: _told(entry["parameters"][name]) for name in flat}
    figure = figures.corner_figure({title: flat}, labels, title=title, converged=converged, told=told, assumed=assumed)
    figures.save(figure, folder / "corner")
    trace = {name: value[:, ::_TRACED] for name, value in thinned.items() if value.std() > 0.0}
    figures.save(figures.trace_figure(trace, labels, title=title, converged=converged), folder / "trace")
    if checks := entry.get("predictive"):
        figures.save(figures.feature_check_figure(checks, title=title, converged=converged), folder / "predictive")


def _told(numbers: Mapping[str, Any]) -> tuple[float, float, float]:
    """Low end, median and high end of a parameter's entry."""
    return numbers["hdi90"][0], numbers["median"], numbers["hdi90"][1]


def _draw_overview(folder: Path, summary: Mapping[str, Any]) -> None:
    cases = summary["cases"]
    names = [name for name in _MAIN if all(name in entry["parameters"] for entry in cases.values())]
    groups = dict(cases) | ({"all": summary["joint"]} if summary.get("joint") else {})
    intervals = {
        name: {group: _told(p) for group, entry in groups.items() if (p := entry["parameters"].get(name)) is not None}
        for name in names
    }
    assumed = {
        name: [g for g in of if decided_by(groups[g]["parameters"][name].get("prior_share") or 0.0) == "prior"]
        for name, of in intervals.items()
    }
    halves = {
        name: {group: (q[0], q[1]) for group in of if (q := groups[group]["parameters"][name].get("quartiles"))}
        for name, of in intervals.items()
    }
    title = f"{summary['campaign']}: median, middle half and 90 % interval of each case"
    shown = {name: next(iter(cases.values()))["parameters"][name]["unit"] for name in names}
    figure = figures.forest_figure(
        intervals, _axis_labels(shown), title=title, converged=summary["converged"], assumed=assumed, quartiles=halves
    )
    figures.save(figure, folder / "forest")
    if len(cases) > 1:
        _draw_overlaid(folder, cases, names, _axis_labels(shown), summary)
    rows = [row for entry in cases.values() for row in entry.get("predictive", [])]
    if rows:
        title = f"{summary['campaign']}: what was measured, and what the fitted model gives"
        figure = figures.feature_check_figure(rows, title=title, converged=summary["converged"])
        figures.save(figure, folder / "predictive")


_OVERLAID = 6  # panels each way of the figure of all cases


def _draw_overlaid(
    folder: Path, cases: Mapping[str, Any], names: Sequence[str], labels: Mapping[str, str], summary: Mapping[str, Any]
) -> None:
    """Corner figure of all cases over each other, of the parameters that the data say most about."""
    shares = {n: min(e["parameters"][n].get("prior_share") or 0.0 for e in cases.values()) for n in names}
    chosen = [n for n in names if n in sorted(names, key=lambda n: shares[n])[:_OVERLAID]]
    posterior = arviz_adapter.read(folder / "posterior.nc")["posterior"]
    chosen = [n for n in chosen if n in posterior and "case" in posterior[n].dims]
    if not chosen:
        return
    draws = {f"case {case}": {n: np.asarray(posterior[n].sel(case=case)).ravel() for n in chosen} for case in cases}
    known = {case: {n: x[np.isfinite(x)] for n, x in values.items()} for case, values in draws.items()}
    title = f"{summary['campaign']}: all cases"
    figure = figures.corner_figure(known, labels, title=title, converged=summary["converged"])
    figures.save(figure, folder / "corner")


def _draw_records(
    folder: Path, experiment: Experiment, bands: Mapping[int, Array], converged: bool, unit: str, most: int = 4
) -> None:
    """The first trial of each configuration (at most `most`) under the band of the posterior."""
    shown: dict[tuple[str, bool], int] = {}
    for i in bands:
        trial = experiment.trials[i]
        shown.setdefault((trial.case, trial.coupled), i)
    rows = []
    for i in list(shown.values())[:most]:
        low, middle, high = np.nanquantile(bands[i], [0.05, 0.5, 0.95], axis=0)
        trial = experiment.trials[i]
        rows.append(
            {
                "label": trial_label(trial),
                "times": trial.times,
                "measured": trial.y,
                "low": low,
                "median": middle,
                "high": high,
            }
        )
    figure = figures.record_figure(rows, unit, title="measured records and the fitted model", converged=converged)
    figures.save(figure, folder / "records")
