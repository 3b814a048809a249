"""`bayes-damper diagnose`: from a campaign's folder to diagnosis.json, the missing torque, and figures."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper import figures
from bayes_damper.calibration import Calibration, predict, unseeing
from bayes_damper.calibration.experiment import laws_on, trial_label
from bayes_damper.calibration.forecast import forecasts
from bayes_damper.calibration.kept_fits import fits_kept_in
from bayes_damper.campaign import Campaign
from bayes_damper.diagnosis import Diagnosis
from bayes_damper.diagnosis import diagnose as diagnose_campaign
from bayes_damper.diagnosis.published import diagnose_published
from bayes_damper.diagnosis.response import Motion, motions
from bayes_damper.diagnosis.sites import write_missing_torque
from bayes_damper.diagnosis.verdict import RULE
from bayes_damper.diagnosis.where import over_noise
from bayes_damper.effects import Effect, all_effects, effects_sha256, options_of
from bayes_damper.effects._law import SITES
from bayes_damper.effects.base import SITE_TITLES
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.inputs import file_sha256, resolved
from bayes_damper.published.posterior import data_of
from bayes_damper.published.sources import PublishedSource, source_of
from bayes_damper.rig.parameters import unit_of
from bayes_damper.rig.units import BODIES, effect_unit, in_words_of
from bayes_damper.runs.contents.diagnosis import (
    BudgetPart,
    DiagnosisFile,
    EffectEntry,
    Estimate,
    Forecasts,
    GapEntry,
    PairEntry,
)
from bayes_damper.runs.execution import not_a_campaign, pieces_kept
from bayes_damper.runs.json_files import write_json
from bayes_damper.runs.parallel_map import forked_map, single_threaded
from bayes_damper.runs.provenance import code_sha256, provenance
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.sampling.prior_sensitivity import decided_by
from bayes_damper.text import (
    UNDETERMINED,
    Printable,
    begins_with_budget,
    budget_sentence,
    effects_to_fit,
    failed_sentence,
    gap_beside_verdict,
    held_out_of,
    law_sentence,
    left_beside,
    named_answers,
    named_sentence,
    p_value,
    places_of_rest,
    share_of_gap,
    trial_words,
    warning_lines,
)

Array = NDArray[np.float64]
NOMINALS = ("nonlinear", "linear")
MOST_UNKNOWN = 0.6  # prior probability of a cause outside the library, at most
CERTAIN = 0.9  # probability from which an answer is given without doubt


@dataclass(frozen=True)
class Diagnosed(Printable):
    """A diagnosis and the folder that its files are in; `result` is what diagnosis.json holds."""

    folder: Path
    result: DiagnosisFile = field(repr=False)
    campaign: str = ""
    """What was diagnosed, as the command line names it."""
    effects: str = ""
    """Folder or file with effects of the user's own, as the command line names it."""
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> DiagnosisFile:
        """What diagnosis.json holds."""
        return self.result

    def text(self) -> str:
        """The verdict in plain words, what speaks for it, and what to do next."""
        warned, known = self.result.get("warnings", ()), self.result.get("warnings_of_check", 0)
        follows = next_steps(self.result, self.campaign, str(self.folder), self.effects)
        return "\n".join([*_words(self.result), *warning_lines(warned, known), f"Files: {self.folder}", *follows])


@single_threaded
def diagnose(
    campaign: str | Path,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: str | Path | None = None,
    priors: str | Path | None = None,
    out: str | Path = "results/diagnose",
    seed: int = 1,
    workers: int = 2,
    prior_unknown: float = RULE.prior_unknown,
    report: Callable[[str], None] = lambda _: None,
) -> Diagnosed:
    """Where the model and the rig differ, which unmodelled effect causes it, and how far adding it closes the gap.

    campaign : folder, or "thesis" for the published measurements; nominal : "linear" leaves dry friction out, which
    then is a candidate; effects : folder with effects of your own; priors : prior file, by default priors.toml in the
    campaign; out : folder for all files; seed : decides every random number; workers : processes; prior_unknown :
    prior probability that the cause is none of the library's; report : called with a sentence for each step.

    Raises
    ------
    InputError
        if the campaign, the priors or an effect cannot be used, or if `out` is the folder of a campaign.
    Interrupted
        after Ctrl-C: the same call, or `resume`, goes on with the fits that were made.
    """
    check_choices(nominal, prior_unknown)
    not_a_campaign(Path(out))
    source = source_of(campaign)
    library = all_effects(effects)
    if isinstance(source, PublishedSource):
        return _published(source, nominal, library, priors, Path(out), seed, workers, report)
    loaded, chosen = source.campaign, source.priors(priors)
    warned = [*loaded.warnings, *laws_on(library, loaded)]
    plan = plan_of(
        {loaded.name: Path(campaign)}, {loaded.name: loaded.sha256}, nominal, seed, prior_unknown, priors, effects
    )
    with pieces_kept(Path(out), {"command": "diagnose", "plan": plan, "code": code_sha256()}, workers) as pieces:
        with fits_kept_in(pieces / "fits"):
            found = diagnose_campaign(
                loaded, nominal=nominal, effects=library, priors=chosen, seed=seed, workers=workers, report=report,
                rule=replace(RULE, prior_unknown=prior_unknown),
            )  # fmt: skip
        return _written(found, loaded, Path(out), str(campaign), effects, library, warned, workers, report)


def plan_of(
    places: Mapping[str, Path],
    checksums: Mapping[str, str],
    nominal: str,
    seed: int,
    prior_unknown: float,
    priors: str | Path | None,
    effects: str | Path | None,
) -> dict[str, Any]:
    """What decides a diagnosis, or several, for run.json: places and checksums of campaigns by name, and settings."""
    file = None if priors is None else resolved(priors)
    return {
        "campaigns": {name: str(resolved(path)) for name, path in places.items()}, "sha256": dict(checksums),
        "nominal": nominal, "seed": seed, "prior_unknown": float(prior_unknown),
        "priors": None if file is None else str(file), "priors_sha256": None if file is None else file_sha256(file),
        "effects_sha256": None if effects is None else effects_sha256(effects),
    }  # fmt: skip


def _written(
    found: Diagnosis,
    loaded: Campaign,
    folder: Path,
    campaign: str,
    effects: str | Path | None,
    library: Mapping[str, Effect],
    warned: list[str],
    workers: int,
    report: Callable[[str], None],
) -> Diagnosed:
    """The files and figures of a diagnosis, in its folder; those of an earlier one are removed."""
    path = _emptied(folder)
    write_missing_torque(folder / "missing_torque.csv", found.site_map)
    earlier = [folder / "learnt" / f"{site}{end}" for site in SITES for end in (".toml", ".csv", "_table.csv")]
    pictures = [folder / f"{name}{end}" for name in ("learnt_law", "missing_torque") for end in (".svg", ".png")]
    for file in (*earlier, *pictures):
        file.unlink(missing_ok=True)
    if found.law is not None:
        found.law.write(folder)
    report("forecasting held-out trials, and drawing figures")
    with kernel_threads(workers):
        ahead = forecasts(found.nominal, found.best, found.weighed_fits())
    result = found.to_json()
    result |= {
        "reading_unit": loaded.reading_unit,
        "rig": {
            "kind": loaded.rig.kind,
            "restoring": loaded.rig.restoring,
            "coupled": loaded.coupled,
            "magnet": loaded.rig.has_magnet,
        },
        "forecast": ahead,
        "warnings": warned,
        "warnings_of_check": len(loaded.warnings),
        "campaign_sha256": loaded.sha256,
        "provenance": provenance(),
    }
    of_rig = loaded.rig.kind, loaded.measurement.quantity
    for name, shift in result["parameters"].items():
        shift["unit"] = unit_of(name, *of_rig)
    both = result["pair"]["parameters"] if result["pair"] else {}
    rows = [*result["effects"], *(result["budget"]["effects"] if result["budget"] else ())]
    for parameters in (*(row["parameters"] for row in rows), *both.values()):
        for row in parameters.values():
            row["unit"] = effect_unit(row["unit"], *of_rig)
    _add_meanings(result, library, loaded.rig.kind, loaded.rig.has_magnet)
    _draw(folder, found, workers, library, loaded.rig.has_magnet)
    write_json(path, result)  # last: a folder with it is whole
    return Diagnosed(folder, result, campaign, effects="" if effects is None else str(effects))


def check_choices(nominal: str, prior_unknown: float) -> None:
    """Refuse, with InputError, what neither a nominal model nor a prior probability of `unknown` can be."""
    if nominal not in NOMINALS:
        raise InputError(f"--nominal {nominal}: expected one of {', '.join(NOMINALS)}")
    if not 0.0 < prior_unknown <= MOST_UNKNOWN:
        raise InputError(
            f"--prior-unknown {prior_unknown:g}: a probability above 0 and up to {MOST_UNKNOWN:g} is expected, since "
            "the other answers share the rest"
        )


def _published(
    source: PublishedSource,
    nominal: Literal["nonlinear", "linear"],
    effects: Mapping[str, Effect],
    priors: str | Path | None,
    folder: Path,
    seed: int,
    workers: int,
    report: Callable[[str], None],
) -> Diagnosed:
    """The same answers from the 24 published numbers."""
    published = source.published
    found = diagnose_published(
        {case: data_of(published, case) for case in published.cases},
        source.priors(priors),
        nominal=nominal,
        effects=effects,
        seed=seed,
        workers=workers,
        report=report,
    )
    path = _emptied(folder)
    result = found.to_json() | {"campaign_sha256": source.sha256, "provenance": provenance()}
    _add_meanings(result, effects)
    ranking = figures.ranking_figure(
        found.answers.probabilities, found.sites, title="thesis: what 24 numbers say is missing, and where"
    )
    figures.save(ranking, folder / "ranking")
    rows = {("nominal" if n == "none" else n): [r.to_json() for r in rows] for n, rows in found.rows.items()}
    figures.save(
        figures.published_figure(rows, title="published numbers and what each answer predicts for them"),
        folder / "published",
    )
    write_json(path, result)  # last: a folder with it is whole
    return Diagnosed(folder, result)


def _emptied(folder: Path) -> Path:
    """Where diagnosis.json is to stand, in a folder that is made and holds none: not even that of an earlier run."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "diagnosis.json"
    path.unlink(missing_ok=True)
    return path


def _add_meanings(
    result: DiagnosisFile, library: Mapping[str, Effect], kind: str = "torsional", magnet: bool = True
) -> None:
    """Adds to each effect of a result what it is, in a few words and in a sentence, in the words of the rig."""
    budget = result.get("budget")
    rows: list[EffectEntry | BudgetPart] = [*result["effects"], *(budget["effects"] if budget else ())]
    for row in rows:
        if row["name"] in library:
            row["title"] = in_words_of(library[row["name"]].title, kind, magnet)
            row["meaning"] = in_words_of(library[row["name"]].summary, kind, magnet)
            for p in (p for v in library[row["name"]].variants if v.name == row.get("variant") for p in v.parameters):
                if p.name in row.get("parameters", {}):
                    row["parameters"][p.name]["meaning"] = in_words_of(p.meaning, kind, magnet)
        if row.get("formula"):
            row["formula"] = in_words_of(row["formula"], kind)


def _published_words(result: DiagnosisFile) -> list[str]:
    """The answer from published numbers; below 90 % no effect is named as the cause."""
    probabilities, errors, gap = result["probabilities"], result["probability_errors"], result["gap"]
    verdict = result["verdict"]
    share = probabilities[verdict]
    names = {"none": "no effect at all", "unknown": "a cause outside the library"}
    first = f"Most probable: {names.get(verdict, verdict)}, probability {share:.2f} +- {errors[verdict]:.2f}"
    lines = [first + ("." if share >= 0.9 else "; this is no finding: the numbers leave other answers open.")]
    found = {"gap": "gap", "none": "no gap shown", "cannot tell": "cannot tell"}[gap["answer"]]
    lines.append(
        f"Gap on the coupled numbers: {found} ({p_value(gap['p_value'])}). Coupled peaks, each predicted without the "
        f"coupled numbers of its case: the nominal model lies {gap['mean_difference']:+.0f} rad/s^2 off on average, "
        f"{gap['nominal_rms']:.0f} rms; the leading effect {gap['augmented_rms']:.0f} rms; "
        f"standard errors {gap['noise_rms']:.1f}."
    )
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])
    lines.append("Answers that keep 2 % or more (+- what the computation leaves open):")
    evidence = {row["name"]: row for row in result["effects"]}
    for name in ranked:
        if probabilities[name] < 0.02:
            continue
        row = evidence.get(name)
        detail = ""
        if row is not None:
            detail = f"   {row['site']}; log evidence {row['log_evidence']:+.1f} +- {row['log_evidence_error']:.1f}"
        lines.append(f"  {name:<22} {probabilities[name]:.3f} +- {errors[name]:.3f}{detail}")
    low = [n for n in ranked if probabilities[n] < 0.02]
    if low:
        lines.append(f"Less than 2 % each: {', '.join(low)}")
    sites = sorted(result["sites"], key=lambda s: -result["sites"][s])[:4]
    lines.append("Sites: " + ", ".join(f"{site} {result['sites'][site]:.2f}" for site in sites))
    for e in result["next_experiment"][:1]:
        lines.append(
            f"What would decide best: {e['measurement']}, {e['configuration']}, "
            f"k1t {e['k1t_n_m_per_rad']:g} N m/rad, from {e['theta0_deg']:.1f} deg "
            f"(expected {e['expected_information_nats']:.2f} nats about the leaders)."
        )
    return lines + [f"note: {note}" for note in result["notes"]]


def _estimated(p: Estimate) -> str:
    """A parameter's value, unit (none for a plain number) and interval."""
    unit = "" if p["unit"] == "1" else f" {p['unit']}"
    free = f" ({UNDETERMINED})" if decided_by(p.get("prior_share", 0.0)) == "prior" else ""
    return f"{p['mean']:.4g}{unit}, 90 % interval {p['hdi90'][0]:.4g} to {p['hdi90'][1]:.4g}{free}"


def next_steps(result: DiagnosisFile, campaign: str, folder: str = "", own: str = "") -> list[str]:
    """What to do with a verdict: the fit that it asks for, or the trial to measure while the answer is open.

    result : what diagnosis.json holds, of recorded trials; campaign : its folder; folder : of the results; own :
    folder with effects of the user's own. Nothing for published numbers.
    """
    if not campaign or "feature" in result["where"]:
        return []
    verdict, share = result["verdict"], result["probabilities"][result["verdict"]]
    fit = f"bayes-damper fit {shlex.quote(campaign)}"
    steps = []
    open_ = share < CERTAIN or len(result["credible_set"]) > 1
    proposals = result.get("next_experiment") or ()
    if open_ and proposals:
        steps.append(
            f"Next, to decide: measure one more {trial_words(proposals[0])}, add it to the campaign, "
            "and diagnose again."
        )
    if verdict not in ("none", "unknown"):
        effects = effects_to_fit(verdict, result.get("pair"))
        options = options_of(effects, shlex.quote(own) if own else "")
        steps.append(
            f"{'If you take this answer' if open_ else 'Next'}: {fit}{options} --out results/fit-{'+'.join(effects)}"
        )
    elif verdict == "none":
        steps.append(f"{'If you take this answer' if open_ else 'Next'}: {fit} --out results/fit")
    else:
        rest = places_of_rest(result["sites"], result.get("budget"))
        place = max(rest, key=lambda s: rest[s])
        places = result.get("site_map")
        shown = ", and at missing_torque.csv" if places and places["curve"] else ""
        steps.append(f"Next: look at {_place(place)} on the rig{shown}; --effects DIR adds your own effect.")
    if law := result.get("law"):
        file = shlex.quote(str(Path(folder) / law["file"]))
        steps.append(f"With the learnt law: {fit} --effects {file} --effect {law['effect']} --out results/fit-learnt")
    return steps


def _words(result: DiagnosisFile) -> list[str]:
    if "feature" in result["where"]:
        return _published_words(result)
    rig = result.get("rig") or {}
    said = partial(in_words_of, kind=rig.get("kind", "torsional"), magnet=rig.get("magnet", True))
    probabilities = result["probabilities"]
    verdict = result["verdict"]
    share = probabilities[verdict]
    gap = result["gap"]
    if verdict == "none":
        lines = [f"No missing effect found: model and records agree within the noise (probability {share:.2f})."]
        if share < CERTAIN:
            lines = [
                f"No missing effect found (probability {share:.2f} that the model is complete, which is not certain)."
            ]
    elif verdict == "unknown":
        rest = places_of_rest(result["sites"], result.get("budget"))
        site = max(rest, key=lambda s: rest[s])
        sure = "There is" if share >= CERTAIN else "Most probable, but not sure:"
        first = f"{sure} a gap that no effect of the library explains (probability {share:.2f}); "
        left = left_beside(result.get("budget"))
        lines = [f"{first}{'the' if left else 'its'} most likely place{said(left)}: {said(_place(site))}."]
    else:
        lines = _effect_words(result, share)
    leads = begins_with_budget(verdict, held_out_of(gap))
    divided = said(budget_sentence(result.get("budget"), held_out_of(gap))) if leads else ""
    lines = [divided, *lines] if divided else lines
    failed = said(failed_sentence(result.get("budget")))
    learnt = said(law_sentence(result.get("law")))
    named = said(named_sentence(result.get("law")))
    lines += [line for line in (failed, learnt, named) if line]
    none = verdict == "none"  # nothing is added to the nominal model
    lines.append(_gap_words(gap, str(result.get("reading_unit") or ""), _named_addition(result)))
    beside = gap_beside_verdict(verdict, share, gap)
    lines += [beside] if beside and held_out_of(gap) else []  # else said already
    if ahead := result.get("forecast"):
        lines += _forecast_words(ahead, str(result.get("reading_unit") or ""), added=not none)
    answers = named_answers(probabilities, result.get("pair"))
    rows = [row for row in result.get("effects", ()) if row.get("title")]
    titles = {row["name"]: f"{row['title']} ({row['name']})" for row in rows}
    lines.append(
        "Probability of each answer: "
        + _ranked(answers, lambda name: " + ".join(titles.get(n, n) for n in name.split(" + ")), 5)
    )
    lines.append("Probability of each place: " + _ranked(result["sites"], lambda site: said(_place(site)), 3))
    if result["indistinguishable"]:
        lines.append(
            "Not distinguished by these data: " + "; ".join(" / ".join(g) for g in result["indistinguishable"])
        )
    return lines + [f"note: {said(note)}" for note in result.get("notes", [])]


def _effect_words(result: DiagnosisFile, share: float) -> list[str]:
    """The effect of the answer, or the pair, its formula and parameters."""
    verdict = result["verdict"]
    row = next(r for r in result["effects"] if r["name"] == verdict)
    sure = "The missing effect is" if share >= CERTAIN else "Most probable, but not sure:"
    title = f"{row['title']} ({verdict}, at {row['site']})" if row.get("title") else f"{verdict} ({row['site']})"
    lines = [f"{sure} {title}, probability {share:.2f}: {row['formula']}."]
    lines += [f"  {row['meaning']}"] if row.get("meaning") else []
    parameters: Mapping[str, Mapping[str, Estimate]] = {verdict: row["parameters"]}
    if pair := result.get("pair"):
        both, p = pair["effects"], pair["probability"]
        lines.append(f"Alone it does not close the gap; {both[0]} and {both[1]} together do (probability {p:.2f}).")
        parameters = pair["parameters"]
    return lines + [
        f"  {effect}, {name} = {_estimated(p)}" for effect, those in parameters.items() for name, p in those.items()
    ]


def _ranked(probabilities: Mapping[str, float], named: Callable[[str], str], most: int) -> str:
    """The most probable of these with their probabilities, those that round to nothing left out."""
    ranked = sorted(probabilities.items(), key=lambda item: -item[1])[:most]
    return ", ".join(f"{named(name)} {p:.2f}" for name, p in ranked if p >= 0.005 or p == ranked[0][1])


def _named_addition(result: DiagnosisFile) -> str:
    """What is added to the nominal model for the second residual of the test of the gap, in words; "" for nothing."""
    verdict, rms = result["verdict"], result["gap"]["augmented_rms"]
    if verdict != "unknown":
        return "" if verdict == "none" else "the answer"
    if not held_out_of(result["gap"]):
        return ""
    best = next((r["name"] for r in result.get("effects", ()) if r.get("augmented_rms") == rms), None)
    closed = result["gap"].get("closed")
    share = (closed["median"] if closed else None) or 0.0
    but = f"not the answer, though it closes {share_of_gap(share)} % of the gap there"
    return f"{best or 'the best two candidates'} ({but if share >= 0.5 else 'no explanation of the gap'})"


def _gap_words(gap: GapEntry, unit: str, added: str) -> str:
    """What the test of the gap says, and the residuals without and with what is `added`; unit : of readings."""
    tested = (
        f"Test on held-out trials: {gap['answer']} ({p_value(gap['p_value'])})."
        if held_out_of(gap)
        else "No trial is held out, so the gap cannot be tested."
    )
    after = "" if gap["augmented_rms"] is None or not added else f", {gap['augmented_rms']:.3g} with {added} added"
    sizes = f"{gap['nominal_rms']:.3g} with the nominal model{after}; noise {gap['noise_rms']:.3g}"
    return f"{tested} Rms residual{f' in {unit}' if unit else ''}: {sizes}."


def _place(site: str) -> str:
    """A site with what it is."""
    title = SITE_TITLES.get(site, site)
    return site if title in (site, f"{site}s") else f"{site} ({title})"


def _forecast_words(ahead: Forecasts, unit: str, *, added: bool = True) -> list[str]:
    """What held-out trials do after the two periods that their own state is inferred from; `unit`: of readings."""
    said = {"before": "with the nominal model", "after": "with the leading effect", "averaged": "over all answers"}
    found = {"before": ahead.get("before"), "after": ahead.get("after"), "averaged": ahead.get("averaged")}
    sides = {said[name]: side for name, side in found.items() if side is not None and (added or name == "before")}
    if not sides:
        return []
    misses = ", ".join(f"{s['rms']:.3g} {name}" for name, s in sides.items())
    held = ", ".join(
        f"{100 * s['coverage50']:.0f} and {100 * s['coverage90']:.0f} % {name}" for name, s in sides.items()
    )
    first = f"Forecast of held-out trials from their first {ahead['periods']:g} periods: rms error"
    return [f"{first}{f' in {unit}' if unit else ''} {misses}. Readings inside the 50 and 90 % bands: {held}."]


def _draw(folder: Path, found: Diagnosis, workers: int, library: Mapping[str, Effect], magnet: bool) -> None:
    """Every figure of a diagnosis, side by side in `workers` processes, in the words of the rig."""
    said = partial(in_words_of, kind=found.kind, magnet=magnet)
    titles = {name: said(effect.title) for name, effect in library.items()}
    added = _added(found, titles)
    answers = found.answers
    pair: PairEntry | None = (
        {"effects": answers.pair_effects, "probability": answers.pair} if answers.pair_effects else None
    )
    probabilities = named_answers(answers.probabilities, pair)
    drawn = {
        "residuals": lambda: figures.residual_maps_figure(
            _maps(found, added), title=f"{found.campaign}: where the residuals exceed the noise"
        ),
        "ranking": lambda: figures.ranking_figure(
            {_label(name, titles): p for name, p in probabilities.items()},
            {said(_place(site)): p for site, p in found.sites.items()},
            title=f"{found.campaign}: what is missing, and where",
        ),
    }
    record = _shown_record(found, added)
    if record is not None:
        plain = {_plain(name, titles): p for name, p in probabilities.items()}
        explained = "" if found.verdict in _NO_EFFECT else ", and the effect that explains it"
        drawn["gap"] = lambda: figures.gap_figure(
            record, plain, title=f"{found.campaign}: what the model misses{explained}"
        )
    torques = found.site_map.torque
    if torques and found.verdict != "none":
        shown = max(torques, key=lambda found: float(np.abs(found.torque).max()))
        drawn["missing_torque"] = lambda: figures.missing_torque_figure(
            shown,
            found.site_map.curve(),
            body=found.site_map.torque_body,
            title=said(_torque_title(found)),
            record=trial_label(found.nominal.problem.experiment.trials[shown.trial]),
            translational=found.kind == "translational",
        )
    if found.law is not None:
        learnt = found.law
        drawn["learnt_law"] = lambda: figures.learnt_law_figure(
            learnt.law, learnt.density, title=f"{found.campaign}: the learnt law",
            translational=found.kind == "translational",
        )  # fmt: skip
    forked_map(lambda name: figures.save(drawn[name](), folder / name), list(drawn), workers)


def _label(name: str, titles: Mapping[str, str]) -> str:
    """An answer for the axis of a figure: its name, and below what it is."""
    known = {**_NO_EFFECT, **titles}
    return "\n".join([name, *(line for n in name.split(" + ") if n in known for line in wrap(known[n], 30))])


_NO_EFFECT = {"none": "nothing is missing", "unknown": "a cause outside the library"}


def _plain(name: str, titles: Mapping[str, str]) -> str:
    """An answer in words alone, for the narrow panel beside a record."""
    parts = [titles.get(n, _NO_EFFECT.get(n, n)) for n in name.split(" + ")]
    return "\n".join(wrap(" and ".join(parts), 26))


def _torque_title(found: Diagnosis) -> str:
    """What the figure shows, and under which condition where another site is as likely."""
    place = found.site_map.torque_site
    where = " at" if place == found.site_map.best else ", if the cause lies at"
    effort = "force" if found.kind == "translational" else "torque"
    return f"{effort} missing from the nominal model{where} {_place(place or '')}"


_CELLS = {"time": 48, "frequency": 24, "plane": 16}  # of the maps of residuals, along each axis, at most
_FEWEST = 3.0  # readings that a cell needs
_PLANES = (("th1", "w1", "", "velocity"), ("phi", "slip", "relative ", "relative velocity"))


def _maps(found: Diagnosis, added: str) -> list[dict[str, Any]]:
    """Columns of the figure of residuals: each channel under the nominal model, then with the answer added."""
    sides = [("nominal model", found.nominal)]
    if found.verdict != "none" and found.best is not None:
        sides.append(("\n".join(wrap(f"with {added}", 40)), found.best))
    rows = [(name, _whitened(fit)) for name, fit in sides]
    channels = range(max(len(r) for _, trials in rows for _, _, r, _, _ in trials))
    return [
        {
            "title": f"{name}\n{BODIES[found.kind][c].removeprefix('the ')}",
            **_maps_of([t for t in trials if len(t[2]) > c], c, found),
        }
        for name, trials in rows
        for c in channels
    ]


_Whitened = tuple[str, Array, Array, Array, tuple[Motion, int]]


def _whitened(fit: Calibration) -> list[_Whitened]:
    """Of each fitted trial: label, times, residuals over the sensors' noise (channels, n), weights, and its motion."""
    moved = {i: (m, k) for m in motions(fit) for k, i in enumerate(m.group.trials)}
    trials = fit.problem.experiment.trials
    rows = ((trial_label(trials[i]), trials[i].times, *row, moved[i]) for i, row in over_noise(fit).items())
    return sorted(rows, key=lambda row: row[0])


def _maps_of(trials: Sequence[_Whitened], channel: int, found: Diagnosis) -> dict[str, Any]:
    labels = [label for label, *_ in trials]
    first, last = min(float(t[0]) for _, t, *_ in trials), max(float(t[-1]) for _, t, *_ in trials)
    shortest, all_of_them = min(len(t) for _, t, *_ in trials), sum(len(t) for _, t, *_ in trials)
    cells = {
        "time": min(_CELLS["time"], max(8, shortest // 8)),
        "frequency": min(_CELLS["frequency"], max(8, shortest // 16)),
        "plane": min(_CELLS["plane"], max(6, round(math.sqrt(all_of_them / 12)))),
    }
    times = np.linspace(first, last * (1.0 + 1e-12), cells["time"] + 1)
    steps = [float(np.median(np.diff(t))) for _, t, *_ in trials]
    low = min(1.0 / (len(t) * step) for (_, t, *_), step in zip(trials, steps, strict=True))
    bands = np.geomspace(low, 0.5 / min(steps), cells["frequency"] + 1)
    in_time, in_frequency = [], []
    for (_, t, r, w, _), step in zip(trials, steps, strict=True):
        in_time.append(_rms(np.digitize(t, times) - 1, r[channel] ** 2, w[channel] ** 2, cells["time"], _FEWEST))
        power = np.abs(np.fft.rfft(r[channel])) ** 2 / max(float(np.sum(w[channel] ** 2)), 1e-9)
        cell = np.digitize(np.fft.rfftfreq(len(t), step), bands) - 1
        in_frequency.append(_rms(cell, power, np.ones_like(power), cells["frequency"], 1.0))
    x_name, y_name, x_words, y_words = _PLANES[channel]
    translational = found.kind == "translational"
    unit = ("m", "m/s") if translational else ("rad", "rad/s")
    x_words += "position" if translational else "angle"
    place = [(getattr(m, x_name)[k, m.at], getattr(m, y_name)[k, m.at]) for *_, (m, k) in trials]
    x, y = (np.concatenate([p[axis] for p in place]) for axis in (0, 1))
    edges = [np.linspace(-1.0, 1.0, cells["plane"] + 1) * max(float(np.abs(v).max()), 1e-12) * 1.000001 for v in (x, y)]
    cell = (np.digitize(y, edges[1]) - 1) * cells["plane"] + np.digitize(x, edges[0]) - 1
    squares = np.concatenate([r[channel] ** 2 for _, _, r, _, _ in trials])
    weights = np.concatenate([w[channel] ** 2 for _, _, _, w, _ in trials])
    plane = _rms(cell, squares, weights, cells["plane"] ** 2, _FEWEST).reshape(cells["plane"], -1)
    row_edges = np.arange(len(trials) + 1.0)
    shared = {"y": row_edges, "labels": labels, "y_label": ""}
    return {
        "time": {"x": times, "values": np.array(in_time), "x_label": "time [s]", **shared},
        "frequency": {"x": bands, "values": np.array(in_frequency), "x_label": "frequency [Hz]", **shared},
        "plane": {
            "x": edges[0], "y": edges[1], "values": plane, "labels": None,
            "x_label": f"{x_words} [{unit[0]}]", "y_label": f"{y_words} [{unit[1]}]",
        },
    }  # fmt: skip


def _rms(cell: NDArray[np.intp], squares: Array, weights: Array, cells: int, fewest: float) -> Array:
    """Root of the mean square in each cell, nan in those of fewer than `fewest` readings."""
    inside = (cell >= 0) & (cell < cells)
    total = np.bincount(cell[inside], squares[inside], cells)
    count = np.bincount(cell[inside], weights[inside], cells)
    return np.sqrt(np.where(count >= fewest, total / np.maximum(count, 1e-9), np.nan))


def _added(found: Diagnosis, titles: Mapping[str, str]) -> str:
    """What the answer adds to the nominal model, in words."""
    if found.pair is not None and found.answers.pair >= 0.5:
        return " and ".join(titles.get(n, n) for n in found.pair.effects)
    if found.verdict == "unknown" and found.winner is not None:
        name = found.winner.effect.name
        return f"{titles.get(name, 'laws that drift')}, which does not explain it"
    return titles.get(found.verdict, found.verdict)


def _shown_record(found: Diagnosis, added: str) -> dict[str, Any] | None:
    """The record that the answer changes most, held-out ones first, as the figure of the gap takes it.

    Where the answer adds nothing ("none", or nothing could be fitted), the record that is explained worst.
    """
    experiment = found.nominal.problem.experiment
    before, after = _residuals(found.nominal), None
    if found.verdict != "none" and found.best is not None:
        after = _residuals(found.best)
    noise = found.nominal.problem.noise.floor
    sizes = {}
    for i, residual in before.items():
        change = residual if after is None else residual - after[i]
        for channel, row in enumerate(change / np.asarray(noise[: len(change)])[:, None]):
            sizes[i, channel] = float(np.nansum(row**2))
    if not sizes:
        return None
    i, channel = max(sizes, key=lambda key: sizes[key])
    trial = experiment.trials[i]
    return {
        "label": f"{trial_label(trial)}, channel {channel + 1}" + (", held out" if trial.heldout else ""),
        "unit": unit_of(f"sigma{channel + 1}", found.kind, experiment.quantity),
        "times": trial.times,
        "measured": trial.y[channel],
        "nominal": trial.y[channel] - before[i][channel],
        "augmented": None if after is None else trial.y[channel] - after[i][channel],
        "added": added,
        "noise": noise[channel],
    }


def _residuals(fit: Calibration) -> dict[int, Array]:
    """Reading minus model (channels, n) of the held-out trials, of all trials where none is held out."""
    trials, heldout = fit.problem.experiment.trials, fit.problem.experiment.heldout
    given = {i: p.model for i, p in predict(unseeing(fit), heldout).items()} if heldout else fit.simulated()
    return {i: trials[i].y - y for i, y in given.items()}
