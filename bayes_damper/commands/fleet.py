"""`bayes-damper diagnose` of several campaigns: a folder and a page for each, and one table and page of all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal

from bayes_damper.campaign import load_campaign
from bayes_damper.commands.diagnose import Diagnosed, check_choices, diagnose, plan_of
from bayes_damper.diagnosis.verdict import RULE
from bayes_damper.effects import all_effects, same_effects
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.inputs import fields, resolved
from bayes_damper.published.sources import is_published
from bayes_damper.report import report
from bayes_damper.runs.execution import Progress, Silent, Task, claim, run_tasks
from bayes_damper.runs.json_files import folder_name, write_json
from bayes_damper.runs.provenance import code_sha256, provenance
from bayes_damper.text import NOTHING, Printable, counted

SCHEMA = "bayes-damper/fleet/1"
_PLANNED: dict[str, tuple[type, ...]] = {
    "campaigns": (dict,), "sha256": (dict,), "nominal": (str,), "seed": (int,), "prior_unknown": (float,),
    "priors": (str, NoneType), "priors_sha256": (str, NoneType), "effects_sha256": (str, NoneType),
}  # fmt: skip


@dataclass(frozen=True)
class Fleet(Printable):
    """Diagnoses of several campaigns; `result` is what fleet.json of `folder` holds, `page` the page of all."""

    folder: Path
    page: Path
    result: Mapping[str, Any]
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> dict[str, Any]:
        """What fleet.json holds."""
        return dict(self.result)

    def text(self) -> str:
        """A line for each campaign, then how often each answer was given and where the pages are."""
        rows = self.result["campaigns"]
        width = max(len(row["name"]) for row in rows)
        lines = []
        for row in rows:
            closed = NOTHING if row["closed"] is None else f"{row['closed']:.0%} closed"
            answer = f"{row['verdict']} ({row['probability']:.2f})"
            lines.append(f"{row['name']:<{width}}  {answer:<34}  gap: {row['gap']:<11}  {row['site']:<9}  {closed}")
        return "\n".join([*lines, *self.result["sentences"], f"Page of all: {self.page}"])


def diagnose_fleet(
    campaigns: Sequence[str | Path],
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: str | Path | None = None,
    priors: str | Path | None = None,
    out: str | Path = "results/diagnose",
    seed: int = 1,
    workers: int = 2,
    scheduler: str | None = None,
    prior_unknown: float = RULE.prior_unknown,
    progress: Progress | None = None,
) -> Fleet:
    """Diagnose several campaigns, each as `diagnose` does alone; the same call goes on with a run that was stopped.

    campaigns : folders, each of which gets a folder of its own name in `out`, with a page; fleet.json and report.html
    beside them show all. nominal, effects, priors, seed and prior_unknown : as in `diagnose`, the same for all. out :
    folder for all files; workers : processes, one campaign each; scheduler : address of a Dask cluster in their place;
    progress : receives how far it is, as in `fit`.

    Raises
    ------
    InputError
        before any work, with every fault of every campaign; or if `out` holds a run of other campaigns or settings.
    """
    check_choices(nominal, prior_unknown)
    places = _places([Path(c) for c in campaigns])
    checksums = _checksums(places)
    all_effects(effects)  # faults of an effect are found before any work
    home = Path(out)
    plan = plan_of(places, checksums, nominal, seed, prior_unknown, priors, effects)
    if (home / "diagnosis.json").exists() and not (home / "run.json").exists():
        raise InputError(f"{home}: holds the diagnosis of one campaign; name another --out, or remove that folder")
    claim(home, {"command": "diagnose", "plan": plan, "code": code_sha256()}, workers)
    given = {
        "nominal": nominal, "seed": seed, "prior_unknown": prior_unknown, "priors": plan["priors"],
        "effects": None if effects is None else str(resolved(effects)),
        "workers": 2 if workers == 1 and scheduler is None else 1,
    }  # fmt: skip
    tasks = [Task(name, diagnose_one, {"campaign": folder, **given}) for name, folder in plan["campaigns"].items()]
    rows = run_tasks(tasks, home, workers=workers, scheduler=scheduler, progress=progress)
    named = [{"name": name, "campaign": str(places[name]), **row} for name, row in rows.items()]
    result = {
        "schema": SCHEMA, "seed": seed, "nominal": nominal, "prior_unknown": prior_unknown, "campaigns": named,
        "sentences": sentences(named), "provenance": provenance(workers=workers),
    }  # fmt: skip
    write_json(home / "fleet.json", result)
    return Fleet(home, report(home).path, result)


def finish_diagnoses(
    home: Path,
    record: Mapping[str, object],
    *,
    effects: str | Path | None,
    workers: int,
    progress: Progress | None,
    alone: bool = False,
) -> Fleet | Diagnosed:
    """Go on with a run that was stopped; `record` as its run.json holds it, effects as the run began with.

    alone : it is the diagnosis of one campaign, whose results stand in `home` itself.

    Raises
    ------
    InputError
        as `diagnose_fleet`.
    """
    plan = fields(record["plan"], _PLANNED, f"{home / 'run.json'}: damaged", "give the same command again")
    same_effects(home, plan["effects_sha256"], effects)
    places = plan["campaigns"]
    if not all(isinstance(path, str) for path in places.values()) or (alone and len(places) != 1):
        raise InputError(
            f"{home / 'run.json'}: damaged: campaigns are no paths, or too many; give the same command again"
        )
    if alone:
        ((name, campaign),) = places.items()
        if load_campaign(campaign).sha256 != plan["sha256"].get(name):
            raise InputError(f"{campaign}: has changed since its diagnosis in {home} was stopped; diagnose it anew")
        step = (progress or Silent()).update
        return diagnose(
            campaign, nominal=plan["nominal"], effects=effects, priors=plan["priors"], out=home, seed=plan["seed"],
            workers=workers, prior_unknown=plan["prior_unknown"], report=lambda words: step("diagnosis", 0.0, words),
        )  # fmt: skip
    return diagnose_fleet(
        list(places.values()), nominal=plan["nominal"], effects=effects, priors=plan["priors"], out=home,
        seed=plan["seed"], workers=workers, prior_unknown=plan["prior_unknown"], progress=progress,
    )  # fmt: skip


def diagnose_one(folder: Path, report_share: Callable[[float, str], None], *, campaign: str, **given: Any) -> Any:
    """A task of the run: diagnose one campaign into `folder`, write its page, and give its row of the table."""
    result = diagnose(campaign, out=folder, report=lambda words: report_share(0.0, words), **given).result
    report(folder)
    verdict, gap = result["verdict"], result["gap"]
    closed = gap["closed"]["median"] if gap["closed"] else None
    site = max(result["sites"], key=lambda s: result["sites"][s])
    return {
        "verdict": verdict, "probability": result["probabilities"][verdict], "credible_set": result["credible_set"],
        "gap": gap["answer"], "site": site, "closed": None if verdict in ("none", "unknown") else closed,
        "campaign_sha256": result["campaign_sha256"], "warnings": len(result["warnings"]),
    }  # fmt: skip


def sentences(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How often each answer was given, and how many of them are expected to be wrong by their own probabilities."""
    times = Counter(row["verdict"] for row in rows)
    words = {"none": "nothing missing", "unknown": "a cause outside the library"}
    parts = [f"{words.get(name, name)} {n}" for name, n in times.most_common()]
    out = [f"{counted(len(rows), 'campaign')}: {', '.join(parts)}."]
    doubt = sum(1.0 - row["probability"] for row in rows)
    return [*out, f"By their own probabilities, {doubt:.1f} of these answers are expected to be wrong."]


def _places(paths: Sequence[Path]) -> dict[str, Path]:
    """Name -> campaign: the name of its folder, with the folder above where two have the same one."""
    same = [str(path) for path, n in Counter(resolved(path) for path in paths).items() if n > 1]
    if same:
        raise InputError([f"{path}: named twice; name each campaign once" for path in same])
    faults = ["thesis: the published numbers are no campaign; diagnose them alone" for p in paths if is_published(p)]
    if faults:
        raise InputError(faults)
    labels = [resolved(path).name for path in paths]
    above = [f"{resolved(path).parent.name}-{label}" for path, label in zip(paths, labels, strict=True)]
    names = [a if labels.count(label) > 1 else label for label, a in zip(labels, above, strict=True)]
    unique = [f"{n}-{k + 1}" if names.count(n) > 1 else n for k, n in enumerate(names)]
    return {folder_name(name): path for name, path in zip(unique, paths, strict=True)}


def _checksums(places: Mapping[str, Path]) -> dict[str, str]:
    """Name -> checksum of each campaign; InputError with every fault of every one."""
    found: dict[str, str] = {}
    faults: list[str] = []
    for name, path in places.items():
        try:
            found[name] = load_campaign(path).sha256
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return found
