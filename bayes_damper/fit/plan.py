"""What a fit is to do, kept in its folder, so that it can be resumed and a changed one is refused."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from types import NoneType
from typing import Any, Literal, cast

from bayes_damper.calibration import Experiment, experiment_of
from bayes_damper.calibration.correlated_noise import KINDS
from bayes_damper.calibration.experiment import laws_on
from bayes_damper.campaign import Campaign
from bayes_damper.effects import Effect, Variant, all_effects, effects_sha256, names_in, same_effects
from bayes_damper.errors import InputError
from bayes_damper.inputs import fields, resolved, shown
from bayes_damper.priors.files import campaign_priors
from bayes_damper.published.sources import RecordedSource, source_of, unchanged
from bayes_damper.rig.parameters import hint
from bayes_damper.runs.contents.fit import FitPlan
from bayes_damper.runs.execution import run_record
from bayes_damper.runs.json_files import write_json
from bayes_damper.runs.provenance import code_sha256, package_version

LAWS = (None, "linear", "constant")
"""Laws of the magnet's pull that a plan may name; None: the campaign's own."""
_TAKEN = ("joint", "variability")
"""Folders beside those of the cases: of all cases together, and of the pieces of `variability`."""
_PLANNED: dict[str, tuple[type, ...]] = {
    "campaign": (str,), "name": (str,), "campaign_sha256": (str,), "cases": (list,), "joint": (bool,),
    "priors": (dict, NoneType), "normal_force": (str, NoneType), "noise": (str,), "effect": (str, NoneType),
    "effects_sha256": (str, NoneType), "seed": (int,), "thorough": (bool,), "most_steps": (int, NoneType),
}  # fmt: skip
"""What run.json holds of a fit: data alone. Where effects of the user's own lie is not among it (see `kept`)."""


def plan_fit(
    campaign: str,
    *,
    cases: Sequence[str] | None,
    priors: str | None,
    normal_force: str | None,
    noise: str = "auto",
    effect: str | Sequence[str] | None = None,
    effects: str | None = None,
    seed: int,
    thorough: bool,
    most_steps: int | None,
    joint: bool,
) -> FitPlan:
    """Everything that decides the results of a fit, as plain data; two effects are one word, "A+B"."""
    names = names_in(effect)
    source = source_of(campaign)
    prior_set = source.priors(priors)
    recorded = source.campaign if isinstance(source, RecordedSource) else None
    if recorded is not None:
        experiment = experiment_of(recorded, prior_set)  # raises where file and campaign contradict each other
    chosen = _chosen_of(source.cases if recorded is None else recorded.fitted_cases, source.cases, cases, campaign)
    if normal_force not in LAWS:
        raise InputError(f"normal_force {normal_force!r}: expected linear or constant")
    if noise not in KINDS:
        raise InputError(f"--noise {noise}: expected one of {', '.join(KINDS)}")
    if names:
        if recorded is None:
            raise InputError(
                "--effect: `diagnose thesis` weighs effects by the published features; a fit needs records"
            )
        known_effects = all_effects(effects)
        if missing := [name for name in names if name not in known_effects]:
            raise InputError(f"--effect {missing[0]}: there is no such effect; {hint(missing[0], known_effects)}")
        chosen_effects = {name: known_effects[name] for name in names}
        check_room([(e, v) for e in chosen_effects.values() for v in e.variants])
        laws_on(chosen_effects, recorded)
        refused: dict[str, InputError] = {}
        for case in chosen:
            trials = tuple(t for t in experiment.trials if t.case == case)
            try:
                possible(replace(experiment, trials=trials), names, chosen_effects)
            except InputError as error:
                refused[case] = error
        if refused:
            able = [f"--case {shlex.quote(case)}" for case in chosen if case not in refused]
            first = next(iter(refused.values()))
            raise InputError(f"{first}; other cases can: {' '.join(able)}" if able else str(first)) from first
    if noise != "auto" and recorded is None:
        raise InputError("--noise: the published features have standard errors of their own; leave it out")
    return {
        "campaign": campaign if recorded is None else str(resolved(campaign)),
        "name": source.name,
        "campaign_sha256": source.sha256,
        "cases": chosen,
        "joint": joint and recorded is not None and len(chosen) > 1,
        "priors": None if prior_set is None else prior_set.to_dict(),
        "normal_force": cast("Literal['linear', 'constant'] | None", normal_force),
        "noise": noise,
        "effect": "+".join(names) or None,
        "effects": None if effects is None or not names else str(resolved(effects)),
        "effects_sha256": None if effects is None or not names else effects_sha256(effects),
        "seed": seed,
        "thorough": thorough,
        "most_steps": most_steps,
    }


def _chosen_of(fitted: Sequence[str], known: Sequence[str], cases: Sequence[str] | None, campaign: str) -> list[str]:
    """The cases to fit; fitted : those of the known ones of which a trial is left to fit; cases : asked for."""
    chosen = list(fitted if cases is None else dict.fromkeys(cases))
    if unknown := [case for case in chosen if case not in known]:
        raise InputError(f"--case {unknown[0]}: there is no such case; {campaign} has {', '.join(known)}")
    if held := [case for case in chosen if case not in fitted]:
        raise InputError(
            f"--case {held[0]}: each of its trials is marked holdout in trials.csv, so nothing is left to fit"
        )
    if taken := [case for case in chosen if case in _TAKEN]:
        raise InputError(
            f"case {taken[0]!r}: results have a folder of that name; give the case another label in trials.csv"
        )
    return chosen


def possible(
    experiment: Experiment, names: Sequence[str], effects: Mapping[str, Effect]
) -> list[tuple[Effect, Variant]]:
    """All formulas of these effects, at the scale of the rig.

    Raises
    ------
    InputError
        if the rig of these trials cannot have one of them, with what it needs.
    """
    from bayes_damper.diagnosis.search import offered  # numba is of no use to a plan without effects

    pool = offered(experiment, "nonlinear", {name: effects[name] for name in names})
    for name in names:
        if not any(effect.name == name for effect, _ in pool):
            cases = list(dict.fromkeys(t.case for t in experiment.trials))
            raise InputError(
                f"--effect {name}: the trials of case {', '.join(cases)} cannot have it: it needs "
                f"{effects[name].needs_in_words()}"
            )
    return pool


def check_room(pool: Sequence[tuple[Effect, Variant]]) -> None:
    """Refuse two effects that no kernel has room for; pool : all formulas of one effect, or of two.

    Raises
    ------
    InputError
        if no two of their formulas go together.
    """
    names = list(dict.fromkeys(effect.name for effect, _ in pool))
    if len(names) < 2:
        return
    from bayes_damper.diagnosis.pairs import room_for  # numba is of no use to a plan without two effects

    if not room_for(pool):
        raise InputError(
            f"--effect {' --effect '.join(names)}: the simulation has no room for both at once, as for two effects of "
            "the sensors; fit each of them alone"
        )


def kept(plan: Mapping[str, object]) -> dict[str, object]:
    """What files keep of a plan: all but where effects of the user's own lie, since no code is taken from files."""
    return {key: plan[key] for key in _PLANNED if key in plan}


def plan_in(record: Mapping[str, object], folder: Path, effects: str | Path | None = None) -> FitPlan:
    """The plan of a fit that run.json holds; effects : folder with effects of one's own, where it began with such.

    Raises
    ------
    InputError
        if it holds none, or one of another version, or the effects are not those that it began with.
    """
    where = f"{folder / 'run.json'}: holds no plan of this version"
    plan = fields(record.get("plan"), _PLANNED, where, "fit anew")
    if not plan["cases"] or not all(isinstance(case, str) for case in plan["cases"]):
        raise InputError(f"{where}: cases are no list of labels; fit anew")
    sound = {
        "seed": 0 <= plan["seed"] < 1 << 64,
        "most_steps": plan["most_steps"] is None or plan["most_steps"] >= 1,
        "normal_force": plan["normal_force"] in LAWS,
        "noise": plan["noise"] in KINDS,
        "cases": len(set(plan["cases"])) == len(plan["cases"]),
    }
    if wrong := [key for key, good in sound.items() if not good]:
        raise InputError(f"{where}: {wrong[0]} = {shown(plan[wrong[0]])} cannot be; fit anew")
    same_effects(folder, plan["effects_sha256"], effects)
    return cast("FitPlan", plan | {"effects": None if effects is None else str(resolved(effects))})


class OtherRun(InputError):
    """A folder holds what is not to be mixed with the run asked for: nothing was touched, and `beside` is free."""

    def __init__(self, folder: Path, what: str, more: str) -> None:
        taken = (folder.with_name(f"{folder.name}-{k}") for k in itertools.count(2))
        self.beside = next(path for path in taken if not path.exists())
        super().__init__(
            f"{folder}: {what}. Nothing was touched.{more} For new results beside it, begin with --out {self.beside}; "
            f"for new ones in its place: mv {folder} {self.beside}, then the same command again"
        )


def start_run(folder: Path, record: Mapping[str, object]) -> None:
    """Note in `folder` what runs there and what runs it, so that `resume` can go on; refuse a folder of another run.

    A run of which nothing was saved is none.

    Raises
    ------
    InputError
        if the folder holds a run with another plan, or of another version, with every difference.
    """
    path = folder / "run.json"
    if path.exists() and any(p.is_dir() for p in folder.iterdir()):
        before = run_record(folder)
        changed = _differences("command", before["command"], record["command"])
        changed += _differences("", before["plan"], record["plan"])
        if changed:
            raise OtherRun(folder, f"holds another run: {'; '.join(changed)}", "")
        refuse_changes(folder, before)
    write_json(path, dict(record) | {"made_by": _versions()})


def refuse_changes(folder: Path, record: Mapping[str, object]) -> None:
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


def planned_campaign(plan: FitPlan) -> Campaign:
    """The campaign that a fit was planned for, as it was then."""
    since = "this run began; start a new run with another --out"
    return unchanged(plan["campaign"], plan["campaign_sha256"], since)


def planned_warnings(plan: FitPlan) -> tuple[Sequence[str], Sequence[str]]:
    """What is odd in the campaign that a fit was planned for, as `check` lists it, and where a learnt law does not
    reach.
    """
    campaign, names = planned_campaign(plan), names_in(plan["effect"])
    known = all_effects(plan["effects"]) if names else {}
    return campaign.warnings, laws_on({name: known[name] for name in names}, campaign)


def recorded_experiment(plan: FitPlan, case: str | None) -> tuple[Experiment, str]:
    """The trials of one case, or of all planned cases, as a calibration takes them; marked trials are left out.

    With it the kind of the rig.
    """
    campaign = planned_campaign(plan)
    priors = None if plan["priors"] is None else campaign_priors(plan["priors"], campaign)
    experiment = experiment_of(campaign, priors)
    marked = {t.file for t in campaign.trials if t.holdout}
    wanted = [case] if case is not None else plan["cases"]
    trials = tuple(
        replace(record, heldout=record.label in marked) for record in experiment.trials if record.case in wanted
    )
    if (law := plan["normal_force"]) is not None:
        experiment = replace(experiment, normal_force=law)
    return replace(experiment, trials=trials), campaign.rig.kind
