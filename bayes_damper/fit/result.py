"""`fit`: from a plan to posteriors of all cases, tables, overview."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, cast

from bayes_damper.errors import ExitCode, InputError
from bayes_damper.fit.drawings import draw_overview
from bayes_damper.fit.plan import kept, plan_fit, planned_warnings, start_run
from bayes_damper.fit.published import fit_published_case
from bayes_damper.fit.recorded import fit_recorded_cases
from bayes_damper.fit.summary import table_text, write_table
from bayes_damper.published.sources import is_published
from bayes_damper.rig.units import in_words_of, kind_by
from bayes_damper.runs.contents.fit import CaseEntry, FitFile, FitPlan
from bayes_damper.runs.execution import WAITING, Progress, Silent, Task, run_tasks, stopped
from bayes_damper.runs.json_files import folder_name, read_json, write_json
from bayes_damper.runs.provenance import provenance
from bayes_damper.sampling import arviz_adapter
from bayes_damper.sampling.prior_sensitivity import text as sensitivity_text
from bayes_damper.text import Printable, effect_of, misses, warning_lines

SCHEMA = "bayes-damper/fit/1"
_OVERVIEW = "overview"


@dataclass(frozen=True)
class _Titled:
    """Progress of tasks under other titles than the names of their folders."""

    shown: Progress
    titles: Mapping[str, str]

    def update(self, task: str, share: float, text: str) -> None:
        """How far a task is, in [0, 1]."""
        self.shown.update(self.titles.get(task, task), share, text)


@dataclass(frozen=True, repr=False)
class Fit(Printable):
    """Posteriors of a campaign: `summary` is what summary.json holds, `folder` where all files are."""

    folder: Path
    summary: FitFile

    @property
    def converged(self) -> bool:
        """Whether every run met the stopping rule."""
        return bool(self.summary["converged"])

    @property
    def exit_code(self) -> ExitCode:
        return ExitCode.DONE if self.converged else ExitCode.NOT_CONVERGED

    def __repr__(self) -> str:
        cases = ", ".join(self.summary.get("cases", {}))
        ended = "converged" if self.converged else "did not converge"
        return f"Fit({str(self.folder)!r}: {self.summary.get('campaign')}, cases {cases}, {ended})"

    def _repr_html_(self) -> str:
        """The tables of `text`, as a notebook shows them."""
        return f"<pre>{escape(self.text())}</pre>"

    def to_json(self) -> FitFile:
        """What summary.json holds."""
        return self.summary

    def to_arviz(self, case: str | None = None) -> Any:
        """The draws of one case (default: the joint fit, or the only case) as ArviZ's own object, a chain a walker.

        An `arviz.InferenceData` with the 0.x line of ArviZ, a DataTree from 1.0 on: for `arviz.summary` and its plots.

        Raises
        ------
        InputError
            if the fit has no such case, or its file is damaged.
        """
        known = {**dict.fromkeys(self.summary["cases"]), **({"joint": None} if self.summary.get("joint") else {})}
        chosen = case or ("joint" if "joint" in known else next(iter(known)) if len(known) == 1 else None)
        if chosen not in known:
            raise InputError(
                f"{self.folder}: give one of the cases {', '.join(known)}; there is no {case or 'default'}"
            )
        return arviz_adapter.to_arviz(self.folder / folder_name(str(chosen)) / "posterior.nc")

    def text(self) -> str:
        """Tables for the terminal, warnings first."""
        parts = warning_lines(self.summary.get("warnings", ()), self.summary.get("warnings_of_check", 0))
        groups = dict(self.summary["cases"]) | ({"joint": self.summary["joint"]} if self.summary.get("joint") else {})
        for name, found in groups.items():
            title = "all cases together" if name == "joint" else f"case {name}"
            if not found["converged"]:
                title += "   *** DID NOT CONVERGE: do not use these numbers ***"
            elif missed := misses(found):
                title += f"   *** {missed} ***"
            best = found.get("best_fit")
            parts.append(table_text(found["parameters"], title, best.get("meanings", {}) if best else {}))
            if best and (formula := best.get("formula")):
                damping = found["parameters"].get("c1t")
                kind = kind_by(damping["unit"] if damping else "")
                parts.append(f"  Effect: {in_words_of(formula, kind)}")
            parts += [f"  {sentence}" for sentence in found["sentences"]]
            parts += _more_text(found)
        parts.append(f"Files: {self.folder}")
        alone = any(misses(found) and not effect_of(found) for found in groups.values())
        campaign = self._campaign() if alone else ""
        if campaign:
            parts.append(f"Next: bayes-damper diagnose {shlex.quote(campaign)} --out results/diagnose")
        parts.append(f"{'Or' if campaign else 'Next'}: bayes-damper report {shlex.quote(str(self.folder))}")
        return "\n".join(parts)

    def _campaign(self) -> str:
        """The folder that was fitted; "" where no file says it."""
        file = self.folder / "run.json"
        run = read_json(file) if file.is_file() else {}
        plan = run.get("plan") if isinstance(run, dict) else None
        return str(plan.get("campaign") or "") if isinstance(plan, dict) else ""


def load_fit(folder: str | Path) -> Fit:
    """The fit that a folder holds, as `fit` returned it when it ended.

    Raises
    ------
    InputError
        if the folder holds no ended fit.
    """
    place = Path(folder)
    summary = read_json(place / "summary.json")
    if not isinstance(summary, dict) or summary.get("schema") != SCHEMA:
        raise InputError(f"{place / 'summary.json'}: not the summary of a fit; name a folder that `fit` has written")
    return Fit(place, cast("FitFile", summary))


def _more_text(found: CaseEntry) -> list[str]:
    """Lines on trials apart, priors and evidence of one entry of summary.json."""
    lines = []
    apart = found.get("unlike_repeats")
    if apart:
        for row in apart["trials"]:
            more = " (or its only repeat is the odd one)" if row["or_its_only_repeat"] else ""
            lines.append(
                f"  Trial {row['trial']} differs from its repeats{more}: its residuals have "
                f"{row['residual_power']:.1f} "
                "times their power. Look at the record; holdout = true in trials.csv leaves it out of the fit."
            )
        if apart["answers"]:
            shifts = {n: p["shift_sd"] for n, p in apart["answers"].items() if not math.isclose(p["shift_sd"], 0.0)}
            worst = sorted(shifts, key=lambda n: -abs(shifts[n]))[:4]
            names = ", ".join(
                f"{n} {apart['answers'][n]['with']['value']:.4g} -> {apart['answers'][n]['without']['value']:.4g} "
                f"({shifts[n]:+.1f} sd)"
                for n in worst
            )
            lines.append(f"  Without: {names}.")
        else:
            lines.append("  It is the only trial of its configuration, so there is no fit without it.")
    if found.get("prior_sensitivity"):
        lines += sensitivity_text(found["prior_sensitivity"])
    if found.get("log_evidence"):
        e = found["log_evidence"]
        lines.append(
            f"  Log evidence {e['value']:.2f} +- {e['error']:.2f} nats, to compare models of these records: 3 more "
            "are odds of 20 to 1."
        )
    return lines


def fit(
    campaign: str | Path,
    *,
    cases: Sequence[str] | None = None,
    priors: str | Path | None = None,
    normal_force: str | None = None,
    noise: str = "auto",
    effect: str | Sequence[str] | None = None,
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
    gets, in the formula that fits best, e.g. the verdict of a diagnosis, or two names, ("A", "B") or "A+B"; effects :
    folder with effects of your own.
    seed : decides every random number. workers : processes. thorough : 50 autocorrelation times in place of 20.
    most_steps : at most so many steps of each ensemble, the warm-up not counted, or as many as the fewest that can be
    judged. joint : whether to fit all cases of a campaign together too. out : folder for all files. scheduler : address
    of a Dask cluster that works in place of processes.
    progress : its `update(task, share, sentence)` is called with how far it is; None: silence.

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
    start_run(folder, {"command": "fit", "plan": kept(plan), "workers": workers})
    return finish_fit(folder, plan, workers=workers, scheduler=scheduler, progress=progress)


def finish_fit(
    folder: Path,
    plan: FitPlan,
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
    published = is_published(plan["campaign"])
    known, beyond = ((), ()) if published else planned_warnings(plan)
    call = fit_published_case if published else fit_recorded_cases
    names = [*plan["cases"], *(["joint"] if plan["joint"] else [])]
    # The joint fit is the longest: it starts first.
    order = sorted(names, key=lambda name: name != "joint")
    tasks = [Task(folder_name(name), call, {"name": name, "plan": dict(plan)}) for name in order]
    titles = {folder_name(name): "all cases" if name == "joint" else f"case {name}" for name in names}
    shown = _Titled(progress or Silent(), titles)
    shown.update(_OVERVIEW, 0.0, WAITING)
    done = run_tasks(tasks, folder, workers=workers, scheduler=scheduler, progress=shown)
    results = {name: done[folder_name(name)] for name in names}
    found = {name: results[name] for name in plan["cases"]}
    summary: FitFile = {
        "schema": SCHEMA,
        "campaign": plan["name"],
        "campaign_sha256": plan["campaign_sha256"],
        "seed": plan["seed"],
        "converged": all(r["converged"] for r in results.values()),
        "warnings": [*known, *beyond],
        "warnings_of_check": len(known),
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


def _write_overview(folder: Path, cases: Sequence[str], summary: FitFile) -> None:
    """The files of all cases together. What other commands look for, summary.json, comes last: until then the run has
    not ended.
    """
    write_table(summary, folder / "summary.csv")
    arviz_adapter.combine_cases(
        {name: folder / folder_name(name) / "posterior.nc" for name in cases}, folder / "posterior.nc"
    )
    draw_overview(folder, summary)
    write_json(folder / "summary.json", summary)
