"""The run: which campaigns, one task each, the sealed verdicts, the opened key, the scores."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, cast

from bayes_damper import figures
from bayes_damper.diagnosis import Diagnosis
from bayes_damper.effects import Effect, all_effects, classes, effects_sha256, same_effects
from bayes_damper.errors import ExitCode, InputError, Interrupted, SelfCheckError
from bayes_damper.inputs import fields, resolved, shipped_path
from bayes_damper.runs.contents.diagnosis import Forecasts
from bayes_damper.runs.contents.withheld import (
    BaselineEntry,
    CampaignEntry,
    ComparedScores,
    Freeze,
    Judged,
    KeyEntry,
    Rate,
    RateName,
    RemovedEntry,
    UnderTheAnswer,
    Verdict,
    WithheldFile,
)
from bayes_damper.runs.execution import Progress, Task, run_tasks
from bayes_damper.runs.json_files import plain, write_json, write_text
from bayes_damper.runs.provenance import provenance
from bayes_damper.text import Printable, counted, p_value
from bayes_damper.validation.withheld import scores
from bayes_damper.validation.withheld.archive import NAME as ARCHIVE
from bayes_damper.validation.withheld.archive import write_archive
from bayes_damper.validation.withheld.baselines import FOREST_ABSENT, baselines_of, forest_out_of_fold, has_forest
from bayes_damper.validation.withheld.sealing import (
    differences,
    digest,
    freeze,
    open_key,
    read_freeze,
    read_verdict,
    write_freeze,
    write_verdict,
)

SCHEMA = "bayes-damper/withheld/1"
SHIPPED = "data/withheld/campaigns"
SUBSET = 24  # campaigns of a run that is not full: at most 20 s each on 2 cores, so at most 10 minutes


@dataclass(frozen=True)
class Withheld(Printable):
    """What the check found; `results` is the content of withheld.json."""

    results: WithheldFile
    folder: Path
    exit_code: ExitCode = ExitCode.DONE

    @property
    def rehearsal(self) -> bool:
        """Whether the scores count as a rehearsal only."""
        return bool(self.results["rehearsal"])

    def to_json(self) -> WithheldFile:
        """For programs."""
        return self.results

    def text(self) -> str:
        """For people: the scores, the targets, every miss."""
        return table_text(self.results)


# One campaign ---------------------------------------------------------------------------------------------------------


def verdict_of(
    campaign: str, *, seed: int, leave_out: Sequence[str], workers: int, effects: str | None = None
) -> Verdict:
    """The diagnosis of one campaign folder, as diagnosis.json, with what the scores need beyond it.

    `effects`: folder with effects beside the library's and those of installed packages.

    That is: the answers of the baselines on the same fits, intervals under the answer, forecasts, a case left out; none
    of it where effects are taken out of the library (`leave_out`).
    """
    from bayes_damper.campaign import load_campaign
    from bayes_damper.diagnosis import diagnose

    offered = {name: effect for name, effect in all_effects(effects).items() if name not in leave_out}
    found = diagnose(load_campaign(campaign), seed=seed, effects=offered, workers=workers)
    verdict = cast("Verdict", found.to_json())
    if leave_out:
        return verdict
    return {**verdict, "baselines": baselines_of(found), **_under_the_answer(found)}


def _under_the_answer(found: Diagnosis) -> UnderTheAnswer:
    """Intervals of the parameters under the answer, forecasts, and what the leading effect closes of a case left out.

    The answer: the leading effect, or the nominal rig where nothing is missing. The case left out is the last of the
    campaign; nothing is reported of it where the leading answer has no fit.
    """
    from bayes_damper.calibration.forecast import forecasts
    from bayes_damper.diagnosis.gap import left_out_case

    fit = found.best
    ahead = forecasts(found.nominal, fit, found.weighed_fits())
    out: UnderTheAnswer = {"forecast": cast("Forecasts", {k: v for k, v in ahead.items() if k != "trials"})}
    answer = found.nominal if found.verdict == "none" else fit
    if answer is not None:
        names = answer.problem.names
        out["intervals90"] = {n: list(answer.interval(n)) for n in scores.PARAMETERS if n in names}
    if fit is None or found.winner is None:
        return out
    cases = sorted({trial.case for trial in found.experiment.trials})
    if len(cases) > 1 and found.verdict == found.winner.effect.name:
        case = left_out_case(found.nominal, fit, cases[-1])
        out["left_out_case"] = {"case": case.case, "closed": case.closed.median}
    return out


def give_verdict(
    folder: Path,
    report: Callable[[float, str], None],
    *,
    name: str,
    campaign: str,
    call: Callable[..., Verdict],
    seed: int,
    leave_out: Sequence[str],
    workers: int,
    freeze_seal: str,
    effects: str | None = None,
) -> dict[str, str]:
    """A task of the run: diagnose one campaign and seal the verdict; only its seal is returned.

    A diagnosis that fails is a verdict too, "failed", and counts as wrong everywhere.
    """
    path = folder / "verdict.json"
    if path.exists():
        return {"seal": read_verdict(path, name, freeze_seal)["seal"]}
    report(0.0, "diagnosing")
    own = {} if effects is None else {"effects": effects}
    try:
        verdict = call(campaign, seed=seed, leave_out=list(leave_out), workers=workers, **own)
    except Exception as error:  # noqa: BLE001 (whatever a diagnosis dies of, its verdict is "failed")
        reason = traceback.format_exception_only(error)[-1].strip()
        verdict = {"verdict": scores.FAILED, "probabilities": {}, "credible_set": [], "sites": {}, "error": reason}
    report(1.0, "sealed")
    return {"seal": write_verdict(path, name, plain(verdict), freeze_seal)["seal"]}


# The run --------------------------------------------------------------------------------------------------------------


def find_campaigns(folder: Path) -> dict[str, Path]:
    """Name -> folder of every campaign below `folder`, in alphabetical order.

    Raises
    ------
    InputError
        if there is none.
    """
    found = {path.parent.name: path.parent for path in sorted(folder.glob("*/campaign.toml"))}
    if not found:
        raise InputError(
            f"{folder}: holds no campaigns; make some in the repository: python -m validation.laboratories 'none*4' "
            f"'library*4' --out {folder}"
        )
    return found


def withheld(
    folder: str | Path | None = None,
    *,
    full: bool = False,
    key: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    seed: int = 1,
    out: str | Path = "results/withheld",
    leave_one_out: bool | None = None,
    diagnose_with: Callable[..., Verdict] = verdict_of,
    effects: str | Path | None = None,
    progress: Progress | None = None,
) -> Withheld:
    """Diagnose campaigns whose effect is withheld, seal every verdict, open the key and score.

    folder : campaigns as `python -m validation.laboratories` of the repository writes them; default: those shipped.
    key : default FOLDER_key.json beside it. full : all campaigns, and every campaign of a library effect again with its
    class taken out of the library; otherwise the first 24 by name, which are hashes. out : where the run keeps its
    state; the same call goes on with a run that was stopped. diagnose_with : a module's function that gives a verdict,
    called as `verdict_of` is. effects : folder with effects of your own, candidates beside those of the library and of
    installed packages; in the key they are effects of the library. leave_one_out : whether campaigns are judged again
    without the effect that they have; None: as `full`. workers : processes; scheduler : address of a Dask cluster in
    their place; seed : decides every random number; progress : receives how far it is, as in `fit`.

    Raises
    ------
    SelfCheckError
        if a seal is broken: verdicts, campaigns, key or freeze are not those that were sealed.
    InputError
        if there are no campaigns or no key, or `out` holds another run.
    """
    source = Path(folder) if folder is not None else shipped_path(SHIPPED)
    home = Path(out)
    key_file = Path(key) if key is not None else source.parent / f"{source.name}_key.json"
    campaigns = find_campaigns(source)
    if not full:
        campaigns = dict(list(campaigns.items())[:SUBSET])
    library = all_effects(effects)
    now = freeze(campaigns, key_file, library, seed, name_of(diagnose_with))
    frozen = _begin(home, now)
    write_json(
        home / "run.json",
        {
            "command": "withheld", "workers": workers,
            "plan": {
                "folder": str(source), "full": full, "key": str(key_file), "seed": seed, "leave_one_out": leave_one_out,
                "verdicts_by": name_of(diagnose_with),
                "effects_sha256": None if effects is None else effects_sha256(effects),
            },
        },
    )  # fmt: skip
    own = None if effects is None else str(resolved(effects))
    run = _Run(home, campaigns, seed, diagnose_with, workers, scheduler, progress, now, library, own)
    run.verdicts(dict.fromkeys(campaigns, ()), home, frozen["seal"])
    opened = open_key(home, key_file, campaigns, freeze(campaigns, key_file, library, seed, name_of(diagnose_with)))
    reasons = [*opened.rehearsal, *_earlier(key_file, now)]
    groups = classes(library)
    rows = [scores.score_one(n, opened.verdicts[n], opened.entries[n], groups) for n in campaigns]
    removed: list[scores.Scored] = []
    if full if leave_one_out is None else leave_one_out:
        removed, more = run.without_the_truth(opened.entries, key_file, groups)
        reasons += [reason for reason in more if reason not in reasons]
    scored = scores.all_scores(rows, seed)
    if removed:
        scored["targets"] = [target.judge([*rows, *removed]) for target in scores.TARGETS]
    results: WithheldFile = {
        "schema": SCHEMA,
        "rehearsal": bool(reasons),
        "why_rehearsal": reasons,
        "folder": str(source),
        "full": full,
        "seed": seed,
        "freeze": {
            "seal": frozen["seal"], "code_sha256": frozen["code_sha256"], "effects_sha256": frozen["effects_sha256"],
            "key_sha256": frozen["key_sha256"], "commit": frozen["commit"], "written": frozen["written"],
        },
        "chain_head": opened.head,
        "campaigns": {
            row.name: {**_shown_verdict(opened.verdicts[row.name]), "score": row.to_json()} for row in rows
        },
        "scores": scored,
        "leave_one_out": left_out_scores(removed),
        "baselines": baseline_scores(rows, opened.verdicts, opened.entries, groups, seed),
        "baselines_skipped": skipped_baselines(),
        "provenance": provenance(workers=workers),
    }  # fmt: skip
    results["bound_to_code"] = not reasons and (source == _shipped() or _remember(key_file, now))
    results = cast("WithheldFile", plain(results))
    write_json(home / "withheld.json", results)
    write_text(home / "withheld.txt", table_text(results) + "\n")
    figures.save(figures.withheld_figure(results["scores"], rehearsal=bool(reasons)), home / "withheld")
    write_archive(home, key_file, home / ARCHIVE)
    return Withheld(results, home)


_PLANNED: dict[str, tuple[type, ...]] = {
    "folder": (str,), "full": (bool,), "key": (str,), "seed": (int,), "leave_one_out": (bool, NoneType),
    "verdicts_by": (str,), "effects_sha256": (str, NoneType),
}  # fmt: skip


def name_of(function: Callable[..., Any]) -> str:
    """A function in words, for a freeze: "module:name"."""
    return f"{function.__module__}:{function.__qualname__}"


def finish_withheld(
    home: Path,
    plan: Mapping[str, object],
    *,
    effects: str | Path | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Withheld:
    """Go on with a run that was stopped; `plan` as its run.json holds it, effects as the run began with.

    Raises
    ------
    SelfCheckError, InputError
        as `withheld`.
    """
    begun = fields(plan, _PLANNED, f"{home / 'run.json'}: damaged", "give the same command again")
    if begun["verdicts_by"] != name_of(verdict_of):
        raise InputError(
            f"{home}: another function than the package's own gives the verdicts of this run, and no code is taken "
            "from a folder of results; call withheld() again with the same diagnose_with"
        )
    same_effects(home, begun["effects_sha256"], effects)
    return withheld(
        begun["folder"],
        full=begun["full"],
        key=begun["key"],
        seed=begun["seed"],
        leave_one_out=begun["leave_one_out"],
        diagnose_with=verdict_of,
        effects=effects,
        workers=workers,
        out=home,
        progress=progress,
    )


def _begin(home: Path, now: Freeze) -> Freeze:
    """The freeze of the run in `home`: what is there, or a new one."""
    path = home / "freeze.json"
    if not path.exists():
        return write_freeze(path, now)
    frozen = read_freeze(path)
    other = [
        word
        for word, same in (
            ("other campaigns", set(frozen["campaigns"]) == set(now["campaigns"])),
            ("another seed", frozen["seed"] == now["seed"]),
        )
        if not same
    ]
    if other:
        raise InputError(f"{home}: holds a run with {' and '.join(other)}; give another --out, or delete the folder")
    held = (
        ("the campaigns are", frozen["campaigns"] == now["campaigns"]),
        ("the key is", frozen["key_sha256"] == now["key_sha256"]),
    )
    for words, same in held:
        if not same:
            raise SelfCheckError(f"{home}: broken seal: {words} not what was there when the run was frozen")
    return frozen


@dataclass
class _Run:
    home: Path
    campaigns: Mapping[str, Path]
    seed: int
    call: Callable[..., Verdict]
    workers: int
    scheduler: str | None
    progress: Progress | None
    now: Freeze
    library: Mapping[str, Effect]
    effects: str | None = None

    def verdicts(self, leave_out: Mapping[str, Sequence[str]], home: Path, seal: str) -> None:
        """Seal the verdict of every campaign named, in `home`/verdicts; those that are sealed are kept."""
        tasks = [
            Task(
                name,
                give_verdict,
                {
                    "name": name, "campaign": str(resolved(self.campaigns[name])), "call": self.call,
                    "seed": self.seed_of(name), "leave_out": list(without), "workers": 2 if self.workers == 1 else 1,
                    "freeze_seal": seal, **({} if self.effects is None else {"effects": self.effects}),
                },
            )
            for name, without in leave_out.items()
        ]  # fmt: skip
        for task in tasks:
            if not (home / "verdicts" / task.name / "verdict.json").exists():
                (home / "verdicts" / task.name / "done.json").unlink(missing_ok=True)
        try:
            run_tasks(tasks, home / "verdicts", workers=self.workers, scheduler=self.scheduler, progress=self.progress)
        except Interrupted:
            raise Interrupted(
                f"stopped; what is sealed stays in {self.home}: give the same command again to go on"
            ) from None

    def seed_of(self, name: str) -> int:
        """A seed of its own for each campaign, whatever else is in the run."""
        return int(digest([self.seed, name])[:8], 16)

    def without_the_truth(
        self, entries: Mapping[str, KeyEntry], key: Path, groups: Sequence[frozenset[str]]
    ) -> tuple[list[scores.Scored], list[str]]:
        """Campaigns of library effects diagnosed again with the effect's class taken out of the library.

        Which effect to take out stands in the key, so this begins when the key is open; its verdicts are sealed in a
        chain of their own before they are scored.
        """
        leave_out = {
            name: sorted(scores.class_of(entry["truth"], groups) | set(entry.get("class") or ()))
            for name, entry in entries.items()
            if entry["truth"] in self.library
        }
        if not leave_out:
            return [], []
        home = self.home / "leave_one_out"
        part = {name: self.campaigns[name] for name in leave_out}
        now = freeze(part, key, self.library, self.seed, name_of(self.call))
        frozen = _begin(home, now)
        self.verdicts(leave_out, home, frozen["seal"])
        opened = open_key(home, key, part, freeze(part, key, self.library, self.seed, name_of(self.call)))
        rows = [
            scores.score_one(name, opened.verdicts[name], opened.entries[name], groups, left_out=True) for name in part
        ]
        return rows, [*opened.rehearsal, *differences(self.now, now)]


def _shown_verdict(verdict: Verdict) -> CampaignEntry:
    """What withheld.json repeats of a sealed verdict."""
    known: Mapping[str, object] = verdict
    names = ("verdict", "credible_set", "probabilities", "pair", "sites", "gap", "seconds", "error")
    return cast("CampaignEntry", {name: known[name] for name in names if name in known})


def left_out_scores(rows: Sequence[scores.Scored]) -> RemovedEntry | None:
    """Scores of campaigns diagnosed without their effect in the library; None if there are none."""
    if not rows:
        return None
    visible = [row for row in rows if row.single]
    return {
        "campaigns": len(rows),
        "visible": len(visible),
        "unknown_first": scores.rate(row.is_right for row in visible),
        "site": scores.rate(row.site_right for row in visible),
        "site_in_set": scores.rate(row.site_in_set for row in visible),
        "false_and_confident": scores.rate(row.false_and_confident for row in visible),
        "by_effect": {
            name: {
                "unknown_first": scores.rate(row.is_right for row in visible if row.truth == name),
                "site": scores.rate(row.site_right for row in visible if row.truth == name),
                "taken_for": scores.confusion(r for r in visible if r.truth == name).get(name, {}),
            }
            for name in sorted({row.truth for row in visible})
        },
        "misses": scores.misses(rows),
    }


def baseline_scores(
    rows: Sequence[scores.Scored], verdicts: Mapping[str, Verdict], entries: Mapping[str, KeyEntry],
    groups: Sequence[frozenset[str]], seed: int,
) -> dict[str, BaselineEntry]:  # fmt: skip
    """The baselines' scores on the same campaigns, each beside the diagnosis on those campaigns."""
    answers: dict[str, dict[str, Mapping[str, float]]] = {}
    features: dict[str, Sequence[float]] = {}
    for name, verdict in verdicts.items():
        baselines: Mapping[str, object] = verdict.get("baselines") or {}
        for method, given in baselines.items():
            if method != "features":
                answers.setdefault(method, {})[name] = cast("Mapping[str, float]", given)
            elif given:
                features[name] = cast("Sequence[float]", given)
    forest = forest_out_of_fold(features, {r.name: _label(r) for r in rows if r.group != "pair"}, seed)
    if forest:
        answers["random_forest"] = dict(forest)
    out: dict[str, BaselineEntry] = {}
    for method, said in sorted(answers.items()):
        ours = [row for row in rows if row.name in said and row.group != "pair"]
        theirs = [scores.score_one(row.name, _as_verdict(said[row.name]), entries[row.name], groups) for row in ours]
        out[method] = {
            "baseline": _compared(theirs),
            "diagnosis": _compared(ours),
            "better_log_score": _who_wins(theirs, ours),
        }
    return out


def skipped_baselines() -> list[str]:
    """Which baselines cannot run here, and what to install: a sentence each."""
    return [] if has_forest() else [FOREST_ABSENT]


def _as_verdict(probabilities: Mapping[str, float]) -> Verdict:
    return {"verdict": max(probabilities, key=lambda n: probabilities[n]), "probabilities": probabilities}


def _label(row: scores.Scored) -> str:
    return row.truth if row.group in ("library", "none") else "unknown"


def _compared(rows: Sequence[scores.Scored]) -> ComparedScores:
    s = scores.summarise(rows)
    return {
        "campaigns": s["campaigns"], "accepted_first": s["accepted_first"], "log_score": s["log_score"],
        "brier": s["brier"], "false_and_confident": s["false_and_confident"],
    }  # fmt: skip


def _who_wins(theirs: Sequence[scores.Scored], ours: Sequence[scores.Scored]) -> str:
    """Paired over campaigns: whose log score is better, or "cannot tell" where these campaigns do not decide."""
    gained = [a - b for a, b in zip(scores.log_scores(theirs), scores.log_scores(ours), strict=True)]
    low, high = scores.bootstrap(gained, _mean)["interval95"]
    if low is None or high is None or low <= 0.0 <= high:
        return "cannot tell"
    return "diagnosis" if low > 0.0 else "baseline"


def _mean(x: Any, axis: int) -> Any:
    return x.mean(axis=axis)


# Seals that outlive a run ---------------------------------------------------------------------------------------------


def seal_path(key: Path) -> Path:
    """Where the seal of a set of campaigns lies: beside its key."""
    return key.with_name(key.name.removesuffix(".json").removesuffix("_key") + "_seal.json")


def _earlier(key: Path, now: Freeze) -> list[str]:
    """Reasons for a rehearsal that come from an earlier seal of the same campaigns."""
    path = seal_path(key)
    if not path.exists():
        return []
    sealed = read_freeze(path)
    reasons = differences({**sealed, "call": now["call"]}, now) if "code_sha256" in sealed else []
    if sealed["key_sha256"] != now["key_sha256"]:
        reasons.append(f"{path.name} was written for another key")
    changed = [n for n, seal in now["campaigns"].items() if sealed["campaigns"].get(n, seal) != seal]
    if changed:
        reasons.append(f"the data of {', '.join(changed[:3])} have changed")
    return [f"these campaigns were sealed on {sealed['written'][:10]}: {reason}" for reason in reasons]


def _remember(key: Path, now: Freeze) -> bool:
    """Bind campaigns that were scored to this code; whether that is so now (not where nothing can be written)."""
    try:
        if not seal_path(key).exists():
            write_freeze(seal_path(key), now)
    except OSError:
        return False
    return True


def _shipped() -> Path | None:
    try:
        return shipped_path(SHIPPED)
    except InputError:
        return None


# Text -----------------------------------------------------------------------------------------------------------------


def _figure(row: Rate | Judged) -> str:
    if row["value"] is None or row["n"] == 0:
        return "not tested"
    low, high = row["interval95"]
    return f"{row['value']:.3g}  ({low:.3g} .. {high:.3g})  n = {row['n']}"


_LINES: tuple[tuple[str, RateName], ...] = (
    ("right effect first", "right_first"),
    ("none where there is none", "none_kept"),
    ("unknown where it is foreign", "unknown_first"),
    ("truth in the 90 % set", "truth_in_credible_set"),
    ("wrong effect with p > 0.9", "false_and_confident"),
    ("site, effect in the library", "site"),
    ("site of an unknown", "site_of_unknown"),
    ("pairs, both named", "pairs_both_named"),
    ("share of gap closed, median", "closed_median"),
    ("log score, nats", "log_score"),
    ("Brier score", "brier"),
    ("90 % intervals cover", "coverage90"),
    ("seconds a campaign, median", "seconds"),
)
_CLASS_LINES: tuple[tuple[str, RateName], ...] = (
    ("wrong effect with p > 0.5", "false_and_likely"),
    ("90 % intervals of scatters", "scatter90"),
    ("gap's test below 5 %, sound", "gap_test_5"),
    ("readings in 50 % bands, mean", "bands50"),
    ("readings in 90 % bands, mean", "bands90"),
)


def table_text(results: WithheldFile) -> str:
    """The scores as a table: figures with 95 % intervals by kind, targets, reliability, baselines, misses."""
    scored = results["scores"]
    lines = []
    if results["rehearsal"]:
        lines += ["REHEARSAL, not a proof:", *(f"  {reason}" for reason in results["why_rehearsal"]), ""]
    lines.append(f"{counted(scored['all']['campaigns'], 'campaign')}, chain {results['chain_head'][:16]}")
    for kind, found in scored["by_kind"].items():
        lines += [
            "",
            f"{kind} ({counted(found['campaigns'], 'campaign')}, {found['hidden']} hidden behind the constants)",
        ]
        lines += [f"  {words:32s}{_figure(found[name])}" for words, name in _LINES]
        r = scored["reliability"][kind]
        if (p := r["p_value"]) is not None:
            lines.append(
                f"  {'calibration error':32s}{r['error']:.3f}  (calibrated twin: {r['twin_error']['mean']:.3f}, 95 % "
                f"below {r['twin_error']['upper95']:.3f}; {p_value(p)})"
            )
    for name, row in (scored.get("by_class") or {}).items():
        r = row["reliability"]
        lines += ["", f"{name} ({counted(row['campaigns'], 'campaign')})"]
        lines += [f"  {words:32s}{_figure(row[key])}" for words, key in (*_LINES, *_CLASS_LINES) if row[key]["n"]]
        if (p := r["p_value"]) is not None:
            lines.append(f"  {'calibration error':32s}{r['error']:.3f}  ({p_value(p)})")
    if scored["by_level"]:
        lines += ["", f"  {'level':>12s}  {'right first':32s}share of gap closed"]
        lines += [
            f"  {at['kind']:>6s}{at['level']:6g}  {_figure(at['accepted_first']):32s}{_figure(at['closed_median'])}"
            for at in scored["by_level"]
        ]
    lines += ["", "targets"]
    for t in scored["targets"]:
        if t["status"] != "not tested":
            goal = " and ".join(
                f"{sign} {x:g}" for sign, x in ((">=", t["least"]), ("<=", t["most"])) if x is not None
            )  # fmt: skip
            few = "" if t["enough"] else ", too few campaigns"
            lines.append(f"  {t['status']:8s}{t['where']:22s}{t['what']:44s}{goal:22s}{_figure(t)}{few}")
    untested = sum(t["status"] == "not tested" for t in scored["targets"])
    if untested:
        lines.append(f"  {untested} of {len(scored['targets'])} targets are not touched by these campaigns")
    if removed := results.get("leave_one_out"):
        lines += ["", f"effect taken out of the library ({removed['visible']} visible campaigns)"]
        lines.append(f"  {'unknown first':32s}{_figure(removed['unknown_first'])}")
        lines.append(f"  {'right site first':32s}{_figure(removed['site'])}")
        lines += [f"  {miss}" for miss in removed["misses"]]
    if results.get("baselines"):
        lines += ["", f"  {'baseline':18s}{'accepted first':32s}{'log score':34s}better log score"]
        lines += [
            f"  {name:18s}{_figure(b['baseline']['accepted_first']):32s}{_figure(b['baseline']['log_score']):34s}"
            f"{b['better_log_score']}"
            for name, b in results["baselines"].items()
        ]
    lines += [f"  {sentence}" for sentence in results.get("baselines_skipped") or ()]
    lines += ["", f"misses ({len(scored['misses'])})", *(f"  {miss}" for miss in scored["misses"])]
    return "\n".join(lines)
