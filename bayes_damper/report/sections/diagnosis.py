"""The section of a diagnosis: diagnosis.json."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from bayes_damper.effects import EFFECTS, options_of
from bayes_damper.effects.base import SITES
from bayes_damper.report.charts import torque_chart
from bayes_damper.report.parts import Headline, Result, Row, Section, Table, folded, generic, listed, words
from bayes_damper.report.sections.shared import fingerprint, meaning_of, pictures_of, records_table
from bayes_damper.report.sketch import KINDS, sketch
from bayes_damper.rig.parameters import PARAMETERS
from bayes_damper.rig.units import BODIES, in_words_of
from bayes_damper.runs.contents.diagnosis import (
    BudgetEntry,
    BudgetPart,
    ChoiceEntry,
    DiagnosisFile,
    EffectEntry,
    FeatureEntry,
    Forecasts,
    ForecastSides,
    GapEntry,
    LawEntry,
    PairEntry,
    PlaceEntry,
    ProposalEntry,
    Share,
    ShiftEntry,
    UnderPrior,
    WherePublished,
    WhereRecords,
)
from bayes_damper.sampling.prior_sensitivity import decided_by
from bayes_damper.text import (
    COORDINATES,
    NOTHING,
    NOTHING_HELD_OUT,
    UNDETERMINED,
    begins_with_budget,
    budget_sentence,
    effects_to_fit,
    failed_sentence,
    gap_beside_verdict,
    gathered,
    held_out_of,
    interval,
    law_sentence,
    left_beside,
    named_answers,
    named_sentence,
    number,
    p_value,
    percent,
    places_of_rest,
    plus_minus,
    share_of_gap,
)

Said = Callable[[str], str]
"""Puts a text into the words of the rig."""
_SITES = {
    "ground1": "the primary's spring to ground and its fixings",
    "bearings": "drag and friction in the bearings",
    "interface": "friction and coupling between the two bodies",
    "ground2": "the secondary alone: its inertia, a spring to ground if it has one",
    "release": "how the rig is let go",
    "sensor": "sensors and logger",
    "none": "no gap",
}
_RIVALS = {"none": "a complete model", "unknown": "a cause outside the library"}


def diagnosis_result(data: DiagnosisFile, folder: Path) -> Result:
    """Headline and section of diagnosis.json."""
    probabilities = sorted(data.get("probabilities", {}).items(), key=lambda item: -item[1])
    verdict, gap = str(data.get("verdict", "unknown")), data.get("gap")
    # What is on the first screen is the same model as one of the rows: one model, one number.
    effects: list[EffectEntry] = [
        {**e, "closed": gap["closed"]}
        if gap and gap.get("closed") and e.get("augmented_rms") == gap.get("augmented_rms")
        else e
        for e in data.get("effects") or ()
    ]
    titles = {e["name"]: str(e.get("title") or words(e["name"])) for e in effects}

    def called(name: str) -> str:
        return titles.get(name, words(name))

    share = dict(probabilities).get(verdict)
    sites = sorted((data.get("sites") or {}).items(), key=lambda item: -item[1])
    pair = data.get("pair")
    budget = data.get("budget")
    kind = _kind_of(data)
    said = partial(in_words_of, kind=kind, magnet=bool((data.get("rig") or {}).get("magnet", True)))
    held_out = gap is None or held_out_of(gap)
    divided = said(budget_sentence(budget, held_out)) if budget and begins_with_budget(verdict, held_out) else ""
    likely = sites
    if verdict == "unknown":
        likely = sorted(places_of_rest(dict(sites), data.get("budget")).items(), key=lambda item: -item[1])
    left = left_beside(budget)
    sentences = [divided, *_verdict_sentences(verdict, share, likely, pair, effects, said, left)]
    if pair:
        sentences.append(
            f"No single effect closes the gap; {listed([called(e) for e in pair['effects']])} together do "
            f"({percent(pair['probability'])})."
        )
    sentences += [
        said(failed_sentence(budget)),
        said(law_sentence(data.get("law"))),
        said(named_sentence(data.get("law"))),
    ]
    beside = gap_beside_verdict(verdict, share or 0.0, gap) if gap else ""
    alone = beside and (verdict == "none" or (gap is not None and gap["answer"] == "cannot tell"))
    sentences += [beside] if alone else [_gap_sentence(gap), beside]
    credible = [called(n) for n in data.get("credible_set", [])]
    both_present = set(data.get("credible_set", ())) <= set(pair["effects"]) if pair else False
    if len(credible) > 1 and not both_present:
        sentences.append(f"With a probability of 90 % it is one of {listed(credible)}; the data do not decide which.")
    who = "these two together close" if pair else "the most probable cause closes"
    if verdict in ("none", "unknown"):
        who = "the best candidate would close"
    sentences.append(_closed_sentence(gap, who))
    top = (share or 0.0) > 0.9 and len(credible) <= 1
    changes = _changes(data, folder, verdict, probabilities, called, top)
    tone = "good" if verdict == "none" and top else "bad" if top else "open"
    named = named_answers(dict(probabilities), pair)
    shown = tuple((" + ".join(map(called, n.split(" + "))), p) for n, p in named.items() if p >= 0.01)[:8]
    name = str(data.get("campaign", ""))
    head = Headline(
        f"Diagnosis of {name}" if name else "Diagnosis", tone, tuple(s for s in sentences if s), shown, tuple(changes)
    )
    section = _section(data, folder, effects, probabilities, sites, said)
    about = fingerprint(data)
    return Result(head, section, (), about, tuple(gathered(data.get("warnings", ()))))


def _changes(
    data: DiagnosisFile, folder: Path, verdict: str, probabilities: Sequence[tuple[str, float]],
    called: Callable[[str], str], top: bool,
) -> list[str]:  # fmt: skip
    """What would change the answer, and the next command; top : whether there is one answer alone."""
    changes = [
        f"{listed([called(n) for n in group])} cannot be distinguished by these data."
        for group in data.get("indistinguishable", [])
        if set(group) & set(data.get("credible_set", []))
    ]
    changes += [_experiment_sentence(e) for e in (data.get("next_experiment") or [])[:1]]
    if len(probabilities) > 1:
        second = next(item for item in probabilities if item[0] != verdict)
        rival = f"Second most probable: {_RIVALS.get(second[0], called(second[0]))} ({percent(second[1])})."
        changes += [rival] if second[1] >= 0.01 else []
    fit = f"bayes-damper fit {shlex.quote(str(data.get('campaign', 'CAMPAIGN')))}"
    if top and verdict != "unknown" and "feature" not in (data.get("where") or {}):
        added = [] if verdict == "none" else effects_to_fit(verdict, data.get("pair"))
        changes.insert(0, f"Next: `{fit}{options_of(added, 'DIR')}`")
    if law := data.get("law"):
        file = shlex.quote(str(folder / law["file"]))
        changes.insert(0, f"With the learnt law: `{fit} --effects {file} --effect {law['effect']}`")
    return changes


def _section(
    data: DiagnosisFile,
    folder: Path,
    effects: Sequence[EffectEntry],
    probabilities: Sequence[tuple[str, float]],
    sites: Sequence[tuple[str, float]],
    said: Said,
) -> Section:
    """Tables, charts and figures of a diagnosis.

    effects : with the share of the gap that the first screen gives; probabilities, sites : the largest first; said :
    puts a text into the words of the rig.
    """
    kind = _kind_of(data)
    translational = kind == "translational"
    accelerations = str(data.get("reading_unit") or "").endswith("s^2")
    charts = [
        torque_chart(f, translational=translational, accelerations=accelerations)
        for f in (sorted(folder.glob("*torque*.csv")) if data.get("verdict") != "none" else ())
    ]
    rest = generic(
        data, "", ("schema", "campaign", "verdict", "credible_set", "probabilities", "sites", "effects", "provenance",
                   "campaign_sha256", "seed", "indistinguishable", "notes", "next_experiment", "gap", "parameters",
                   "sensitivity", "budget", "prior_unknown", "law", "where", "forecast", "reading_unit", "rig",
                   "warnings", "warnings_of_check"),
    )  # fmt: skip
    lacks = "force" if translational else "torque"
    pictures = [
        replace(p, title=p.title.replace("torque (force)", lacks)) for p in pictures_of(folder, kind="diagnosis")
    ]
    places = _where_sections(data.get("where"), kind)
    every = (_effect_table(effects, probabilities),)
    choices = _choice_tables(data.get("sensitivity") or []) + _prior_tables(data.get("prior_unknown") or [])
    return Section(
        "Diagnosis",
        tuple(map(said, data.get("notes", ()))),
        (
            *_budget_tables(data.get("budget"), "gap" not in data or held_out_of(data["gap"])),
            *_law_tables(data.get("law"), said, translational),
            _site_table(sites, said),
            *_gap_tables(data.get("gap"), effects, data.get("pair"), str(data.get("reading_unit") or "")),
            *_forecast_tables(data.get("forecast") or {}, str(data.get("reading_unit") or "")),
            *_shift_tables(data.get("parameters") or {}),
            *_experiment_tables(data.get("next_experiment") or []),
        ),
        tuple(c for c in charts if c is not None),
        tuple(pictures),
        (
            *places,
            Section("Every answer that was tried", tables=every, folded=True),
            *([Section("How the verdict depends on choices", tables=choices, folded=True)] if choices else []),
            *folded(rest),
        ),
        sketch=_sketch(data.get("rig"), sites),
    )


def _verdict_sentences(
    verdict: str,
    share: float | None,
    sites: Sequence[tuple[str, float]],
    pair: PairEntry | None,
    effects: Sequence[EffectEntry] = (),
    said: Said = str,
    left: str = "",
) -> list[str]:
    """The verdict in plain words, with its probability, what the effect is, its size, and the most probable place.

    said : puts a text into the words of the rig; left : whose place it is (`left_beside`) where the cause is unknown.
    """
    sure = (share or 0.0) >= 0.9
    if verdict == "none":
        first = "No missing effect found" if sure else "No missing effect found, but this is not certain"
        return [f"{first}: the model is complete with a probability of {percent(share)}."]
    places = [(s, p) for s, p in sites if s != "none"]
    likely = [(s, p) for s, p in places[:2] if p > 0.5 * places[0][1]] or places[:1]
    named = " and ".join(f"{said(_place(s))} ({percent(p)})" for s, p in likely)
    of = said(left) if verdict == "unknown" else ""
    where = [f"Most probable place{'s' if len(likely) > 1 else ''}{of}: {named}."] if likely else []
    if verdict == "unknown":
        first = "The model misses something" if sure else "Most probable, but not sure: the model misses something"
        return [f"{first} that no effect of the library explains (probability {percent(share)}).", *where]
    found = next((e for e in effects if e.get("name") == verdict), EffectEntry())
    title = found.get("title") or words(verdict)
    if pair:
        return [f"Two causes; the stronger one is {title} ({percent(share)})."]
    first = "The missing effect is" if sure else "Most probable, but not sure:"
    size = "; ".join(_parameter(k, v) for k, v in (found.get("parameters") or {}).items())
    meant = [str(found["meaning"])] if found.get("meaning") else []
    if size and found.get("formula"):
        meant.append(f"Its law: {found['formula']}, with {size} (90 % intervals). {_meanings(found)}".strip())
    name = f", in the library {verdict}" if found.get("title") else ""
    return [f"{first} {title} ({percent(share)}{name}).", *meant, *where]


def _meanings(found: EffectEntry) -> str:
    """What the parameters of an effect are, in sentences; nothing for effects that are none of the library's."""
    known = EFFECTS.get(str(found["name"]))
    variants = [v for v in known.variants if v.name == found.get("variant")] if known else []
    meanings = {p.name: p.meaning for v in variants for p in v.parameters}
    meanings |= {k: v["meaning"] for k, v in found["parameters"].items() if "meaning" in v}
    return " ".join(f"{name}: {meanings[name]}" for name in found["parameters"] if name in meanings)


def _place(site: str) -> str:
    return f"{site}, {_SITES[site]}" if site in _SITES else site


def _gap_sentence(gap: GapEntry | None) -> str:
    answer, p = (gap.get("answer"), gap.get("p_value")) if gap else (None, None)
    chance = "" if p is None else f" ({p_value(p)})"
    return {
        "gap": f"The rig and the model differ by more than the noise{chance}.",
        "none": f"The rig and the model differ by no more than the noise{chance}.",
        "cannot tell": f"The held-out trials do not decide whether the model lacks a law{chance}.",
    }.get(str(answer), "")


_WIDEST = 4.0
"""Width of the interval of a share of the gap, from which on there is no gap of which a share could be given."""


def _share_of(closed: Share | None) -> float | None:
    """Share of the gap that is closed; None where none can be given."""
    median, hdi = (closed.get("median"), closed.get("hdi90")) if closed else (None, None)
    return None if median is None or (hdi and hdi[1] - hdi[0] > _WIDEST) else float(median)


def _closed_sentence(gap: GapEntry | None, who: str) -> str:
    closed = gap.get("closed") if gap else None
    if not gap or not closed or (closed.get("median") is None and closed.get("method") != "cannot tell"):
        return ""
    where = (
        "coupled peaks, predicted without the coupled numbers of their case,"
        if gap.get("on")
        else "held-out trials (kept apart from the fit)"
    )
    share, hdi = _share_of(closed), closed.get("hdi90")
    if share is None:
        return f"On {where} the gap is too small to give shares of it."
    ends = [share_of_gap(x) for x in hdi or ()]
    spread = f" (90 % interval {' to '.join(ends)} %)" if ends and set(ends) != {share_of_gap(share)} else ""
    if share <= 0.0:
        return f"On {where} none of the effects tried is shown to reduce the gap{spread}."
    how = f" Measured from {closed['how'].removeprefix('from ')}." if closed.get("how") else ""
    return f"On {where} {who} {share_of_gap(share)} % of the gap{spread}.{how}"


def _experiment_sentence(e: Mapping[str, object]) -> str:
    forms = {
        "configuration": "{}", "k1t_n_m_per_rad": "k1t {} N m/rad", "k1_n_per_m": "k1 {} N/m",
        "theta0_deg": "released at {} deg", "theta0_mm": "released at {} mm",
    }  # fmt: skip
    details = [
        form.format(f"{e[key]:.3g}" if isinstance(e[key], int | float) else e[key])
        for key, form in forms.items()
        if e.get(key) is not None
    ]
    proposal = f"Next experiment: {', '.join(details)}"
    gain = e.get("expected_information_nats")
    if gain is None:
        return f"{proposal}."
    return f"{proposal} (expected information {gain:.2f} nats; 0.69 nats decide between two equally probable answers)."


def _site_table(sites: Sequence[tuple[str, float]], said: Said) -> Table:
    rows = tuple(Row((words(name), percent(p), said(_SITES.get(name, NOTHING)))) for name, p in sites)
    return Table("Probability of each place on the rig", ("site", "probability", "what it includes"), rows)


def _experiment_tables(proposals: Sequence[ProposalEntry]) -> list[Table]:
    """Experiments by the information that they are expected to give."""
    if not proposals:
        return []
    table = records_table("Next experiment", proposals)
    note = (
        "Expected information about which of the leading answers is right: 0.69 nats decide between two equally "
        "probable "
        "ones. Margin: the difference in nats between the two answers that the experiment separates least."
    )
    return [replace(table, note=note if any("margin" in p for p in proposals) else "")]


_OTHER = {"scale": ("scale of the readings of channel", "1"), "lag": ("lag of the readings of channel", "s")}


def _sketch(rig: Any, sites: Sequence[tuple[str, float]]) -> str:
    """The rig with its probable sites highlighted: those with at least half of the largest probability of a site.

    Nothing where the file does not say what rig it is, or where most probably nothing is missing.
    """
    places = [(s, p) for s, p in sites if s in SITES]
    if not isinstance(rig, Mapping) or not places:
        return ""
    kind = "pendulum" if rig.get("restoring") == "pendulum" else rig.get("kind")
    if kind not in KINDS:
        return ""
    gap = 1.0 - sum(p for s, p in sites if s == "none")
    named = [s for s, p in places if p > 0.5 * places[0][1]] if gap > 0.5 else []
    coupled = bool(rig.get("coupled"))
    there = [s for s in named if coupled or s not in ("interface", "ground2")]
    return sketch(kind, coupled=coupled, named=there, magnet=bool(rig.get("magnet")))


def _kind_of(data: DiagnosisFile) -> str:
    """Of the rig, "torsional" or "translational": what the file says, or what its units show."""
    unit = str(data.get("reading_unit") or "")
    slides = unit.startswith("m") or any("k1_n_per_m" in e for e in data.get("next_experiment") or ())
    return str((data.get("rig") or {}).get("kind") or ("translational" if slides else "torsional"))


_POWER = "power above the noise"
_EXCESS = (
    "Power of the residuals above that of the sensors' noise, in units of it: 0 is noise alone, 1 is twice as much."
)


def _excess(row: PlaceEntry) -> str:
    """The excess of a row, to hundredths or to three digits."""
    excess = row["excess_over_noise"]
    return f"{excess:+.2f}" if abs(excess) < 100.0 else f"{excess:+.0f}"


def _where_sections(where: WhereRecords | WherePublished | None, kind: str) -> tuple[Section, ...]:
    """Where residuals exceed the noise, one table for each way to look; nothing where nothing does."""
    if not where:
        return ()
    if "feature" in where:
        return _published_sections(cast("WherePublished", where)["feature"])
    tables = [*_record_tables(where, kind), *_phase_tables(where, kind), *_event_tables(where, kind)]
    return (Section("Where the model and the rig differ", tables=tuple(tables)),) if tables else ()


def _cells(row: Mapping[str, object], *names: str) -> tuple[str, ...]:
    return tuple(str(row[n]) if row.get(n) is not None else "all" for n in names)


def _channel(row: PlaceEntry, kind: str) -> str:
    """The channel of a row, by its number and its body."""
    number_, bodies = row.get("channel"), BODIES[kind]
    if number_ not in (1, 2):
        return str(number_ or NOTHING)
    return f"{number_}, {bodies[number_ - 1].removeprefix('the ')}"


def _p(row: PlaceEntry) -> str:
    return NOTHING if row.get("p_value") is None else p_value(row["p_value"]).removeprefix("p ").removeprefix("= ")


def _span(low: float, high: float) -> str:
    return f"{low:.3g} to {high:.3g}"


def _table(caption: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], note: str = "") -> list[Table]:
    """One table, or none where it would have no rows."""
    return [Table(caption, columns, tuple(Row(r) for r in rows), note)] if rows else []


def _record_tables(where: WhereRecords, kind: str) -> list[Table]:
    """Stretches of time, bands of frequency, channels and cases."""
    tables: list[Table] = []
    times = "Trials: the repeats whose residuals were averaged."
    rows = [
        (_span(r["start_s"], r["end_s"]), _channel(r, kind), *_cells(r, "case", "configuration"),
         ", ".join(map(str, r.get("trials") or (r.get("trial", NOTHING),))), _p(r))
        for r in where.get("time") or ()
    ]  # fmt: skip
    tables += _table("In time", ("time [s]", "channel", "case", "configuration", "trials", "p value"), rows, times)
    rows = [
        (_span(r["low_hz"], r["high_hz"]), _channel(r, kind), *_cells(r, "case", "configuration"), _p(r))
        for r in where.get("frequency") or ()
    ]
    tables += _table("In frequency", ("band [Hz]", "channel", "case", "configuration", "p value"), rows)
    rows = [(_channel(r, kind), _excess(r), _p(r)) for r in (where.get("channel") or {}).values()]
    tables += _table("By channel", ("channel", _POWER, "p value"), rows, _EXCESS)
    rows = [(*_cells(r, "case", "configuration"), _excess(r), _p(r)) for r in (where.get("case") or {}).values()]
    tables += _table("By case", ("case", "configuration", _POWER, "p value"), rows, _EXCESS)
    return tables


def _phase_tables(where: WhereRecords, kind: str) -> list[Table]:
    """Regions of the phase space."""
    translational = kind == "translational"

    def named(coordinate: str) -> tuple[str, str]:
        return COORDINATES[coordinate][translational] if coordinate in COORDINATES else (coordinate, "")

    rows = []
    for r in where.get("phase_space") or ():
        both = [
            f"{symbol} {_span(*reach)} {unit}".rstrip()
            for (symbol, unit), reach in zip(map(named, r["coordinates"]), r["range"], strict=True)
        ]
        rows.append((both[0], both[1], _channel(r, kind), _excess(r), _p(r)))
    letters = "x and v" if translational else "θ and ω"
    first, second = BODIES[kind]
    moves = f"{letters}: position and velocity, 1 of {first}, 2 of {second}. {_EXCESS}"
    return _table("In phase space", ("where", "and", "channel", _POWER, "p value"), rows, moves)


def _event_tables(where: WhereRecords, kind: str) -> list[Table]:
    """A knock, where it explains most of the misfit."""
    event = where.get("event")
    if event and event.get("local"):  # else it only says that a law is wrong everywhere
        unit = "N s" if kind == "translational" else "N m s"
        impulse = f"{event['impulse_n_m_s']:.3g} ± {event['impulse_sd_n_m_s']:.2g} {unit}"
        row = (
            _span(event["start_s"], event["end_s"]), str(event["site"]), impulse, f"{event['gain_nats']:.0f} nats",
            percent(event["share"]),
        )  # fmt: skip
        columns = ("time [s]", "site", "impulse ± sd", "gain", "share of the gap")
        return _table("A single knock explains most of the gap", columns, [row])
    return []


def _published_sections(features: Sequence[FeatureEntry]) -> tuple[Section, ...]:
    """Published numbers beside what the nominal model predicts for them."""
    rows = []
    for r in features:
        low, high = r["predicted_hdi90"]
        cells = (
            f"{r['case']}, {r['configuration']}: {words(str(r['feature']))}",
            plus_minus(r["measured"], r["standard_error"]),
            number(r["predicted"], high - low),
            interval(low, high),
            str(r.get("unit", "")),
            f"{r['p_value']:.2g}",
            "no" if r.get("held_out") else "yes",
        )
        rows.append(Row(cells, "bad" if r["p_value"] < 0.05 else ""))
    columns = ("number", "measured ± standard error", "nominal model", "90 %", "unit", "p value", "fitted")
    note = "Coupled numbers are predicted without those of their own case. Marked: p below 0.05."
    table = Table("Published numbers beside the nominal model", columns, tuple(rows), note)
    return (Section("Where the model and the rig differ", tables=(table,)),)


def _gap_tables(
    gap: GapEntry | None, effects: Sequence[EffectEntry], pair: PairEntry | None = None, unit: str = ""
) -> list[Table]:
    """Residuals on held-out trials: the noise, the nominal model, each effect that was added, and two that answer."""
    if not gap or gap.get("nominal_rms") is None:
        return []
    rows = [
        Row(("noise alone", number(gap.get("noise_rms")), NOTHING)),
        Row(("nominal model", number(gap["nominal_rms"]), "0 %")),
    ]
    closing: list[EffectEntry] = [e for e in effects if e.get("augmented_rms") is not None]
    if pair and gap.get("augmented_rms") is not None:
        both = " and ".join(str(name) for name in pair["effects"])
        closing.append({"name": both, "augmented_rms": gap["augmented_rms"], "closed": gap.get("closed")})
    if not closing and gap.get("augmented_rms") is not None:
        leader = str(effects[0]["name"]) if effects else "the leading effect"
        closing = [{"name": leader, "augmented_rms": gap["augmented_rms"], "closed": gap.get("closed")}]
    for e in closing:
        closed = e.get("closed")
        share = NOTHING
        if (middle := _share_of(closed)) is not None:
            share = f"{share_of_gap(middle)} %"
            if closed and closed.get("hdi90"):
                share += f" ({' to '.join(map(share_of_gap, closed['hdi90'] or ()))} %)"
        rows.append(Row((f"with {e.get('title') or words(str(e['name']))}", number(e["augmented_rms"]), share)))
    unit = unit or str(gap.get("unit") or "")
    columns = ("model", f"rms residual [{unit}]" if unit else "rms residual", "gap closed (90 %)")
    note = (
        f"On {gap['on']}."
        if gap.get("on")
        else (
            f"On held-out trials{'' if unit else ', in the unit of the readings'}, where only each trial's own release "
            "is fitted."
            if held_out_of(gap)
            else "No trial is held out: these are the residuals of the fitted trials."
        )
    )
    return [Table("The gap before and after", columns, tuple(rows), note)]


def _forecast_tables(ahead: Forecasts, unit: str = "") -> list[Table]:
    """Held-out trials forecast from their first periods: what is missed, and what share the bands hold."""
    if "before" not in ahead:
        return []
    models = ("nominal model", "with the leading effect", "all answers, weighted")

    def rows_of(name: str, readings: int, found: ForecastSides) -> list[Row]:
        forecasts = found.get("before"), found.get("after"), found.get("averaged")
        sides = [(model, f) for model, f in zip(models, forecasts, strict=True) if f is not None]
        return [
            Row((
                "" if k else f"{name}\n{readings} readings", model, number(f["rms"]), percent(f["coverage50"]),
                percent(f["coverage90"]),
            ))
            for k, (model, f) in enumerate(sides)
        ]  # fmt: skip

    trials = ahead["trials"]
    rows = [
        row
        for t in trials
        for row in rows_of(f"case {t['case']}, {t['configuration']}, trial {t['trial']}", t["readings"], t)
    ]
    if len(trials) > 1:
        rows += rows_of("all", sum(t["readings"] for t in trials), ahead)
    heads = ("trial", "model", f"rms error [{unit}]" if unit else "rms error", "in the 50 % band", "in the 90 % band")
    note = (
        f"The state of each trial is inferred from its first {ahead['periods']:g} periods; the rest is predicted. “All "
        "answers, weighted” weights each answer by its probability. If a band contains fewer readings than it should, "
        "the model is overconfident."
    )
    return [Table("Forecasts of held-out trials", heads, tuple(rows), note)]


def _shift_tables(parameters: Mapping[str, ShiftEntry]) -> list[Table]:
    """Parameters of the nominal model before and after the leading effect is added."""
    rows = []
    for name, p in parameters.items():
        unit = p.get("unit") or (PARAMETERS[k].unit if (k := name.partition("[")[0]) in PARAMETERS else "")
        meant = meaning_of(name, unit)
        if (own := re.fullmatch(r"(scale|lag)(\d)", name)) is not None:
            meant, unit = f"{name}: {_OTHER[own[1]][0]} {own[2]}", _OTHER[own[1]][1]
        cells = [meant]
        for found in (p.get("before"), p.get("after")):
            cells.append(NOTHING if not found else plus_minus(found["value"], found["sd"]))
        cells.append(str(p.get("unit") or unit))
        shift = p.get("shift_sigmas")
        rows.append(Row((*cells, NOTHING if shift is None else f"{shift:+.1f} sd")))
    columns = ("parameter", "nominal model ± sd", "with the leading effect ± sd", "unit", "shift")
    note = "Shift in standard deviations of the nominal model."
    return [Table("Parameters before and after", columns, tuple(rows), note)] if rows else []


def _choice_tables(choices: Sequence[ChoiceEntry]) -> tuple[Table, ...]:
    """What the verdict would be had something been chosen otherwise."""
    rows = tuple(
        Row((
            str(c["choice"]), words(str(c["verdict"])), percent(c["probability"]),
            percent(c.get("probability_of_the_leading_answer")),
        ))
        for c in choices
    )  # fmt: skip
    columns = ("other choice", "verdict", "its probability", "probability of the present verdict")
    return (Table("The verdict under other choices", columns, rows),) if rows else ()


def _prior_tables(rows: Sequence[UnderPrior]) -> tuple[Table, ...]:
    """The verdict under other prior probabilities of a cause that the library does not have."""
    cells = tuple(Row((percent(r["prior"]), words(str(r["verdict"])), percent(r["probability"]))) for r in rows)
    columns = ("prior probability", "verdict", "probability")
    caption = "How the verdict depends on the prior probability of a cause outside the library"
    return (Table(caption, columns, cells),) if cells else ()


def _budget_tables(budget: BudgetEntry | None, held_out: bool) -> list[Table]:
    """Each effect of the best set with its share of the gap, and what stays unexplained; held_out : by any trial."""
    if not budget or not budget.get("effects"):
        return []

    def share(found: Share) -> str:
        if (middle := found.get("median")) is None:
            return NOTHING
        return f"{share_of_gap(middle)} % ({' to '.join(map(share_of_gap, found['hdi90'] or ()))} %)"

    rows = [
        Row((
            titled(e), str(e["site"]), percent(e["present"]), share(e["share"]),
            "; ".join(_parameter(k, v) for k, v in e["parameters"].items()),
        ))
        for e in budget["effects"]
    ]  # fmt: skip
    left = budget["unexplained"]
    places = sorted((left.get("sites") or {}).items(), key=lambda item: -item[1])[:2]
    where = ", ".join(f"{site} {percent(p)}" for site, p in places)
    rows.append(Row(("unexplained", where, NOTHING, share(left["share"]), NOTHING)))
    how = str(budget["method"]) if held_out else NOTHING_HELD_OUT
    note = (
        f"{how[0].upper()}{how[1:]}. Present: probability over all sets of effects fitted. Shares with 90 % intervals."
    )
    columns = ("effect", "site", "present", "share of the gap", "parameters")
    return [Table("The gap as a budget", columns, tuple(rows), note)]


def titled(e: EffectEntry | BudgetPart) -> str:
    """An effect for the first column of a table: its name, and below what it is."""
    name = words(str(e.get("name", "")))
    return f"{name}\n{e['title']}" if e.get("title") else name


def _law_tables(law: LawEntry | None, said: Said, translational: bool) -> list[Table]:
    """The learnt law: where it acts, what it closes, and its files."""
    if not law:
        return []
    units = {"angle": "m" if translational else "rad", "speed": "m/s" if translational else "rad/s", "time": "s"}
    seen = "; ".join(f"{said(name)} {number(a)} to {number(b)} {units[name]}" for name, (a, b) in law["ranges"].items())
    rows = (
        Row(("formula", f"{said('Q')} = {said(law['formula'])}, curves f in {law['tables'][0]}")),
        Row(("range covered by the records", seen)),
        Row(("degrees of freedom", number(law["effective_degrees_of_freedom"]))),
        Row(("as an effect", f"--effects {law['file']} --effect {law['effect']}")),
        Row(("as a table, for another simulator", law["tables"][1])),
    )
    return [Table("The learnt law", ("", ""), rows, said(law_sentence(law))), *_named_table(law, said)]


def _named_table(law: LawEntry, said: Said) -> list[Table]:
    """Short formulas that may stand for the learnt law."""
    named = law.get("named")
    if not named:
        return []
    rows = [Row((f"{said('Q')} = {said(f['formula'])}", f"{f['probability']:.2f}")) for f in named["formulas"]]
    rows.append(Row(("none of these: shape only", f"{named['shape_only']:.2f}")))
    note = f"{said(named_sentence(law))} Formulas tried: {named['grammar']}."
    return [Table("The learnt law as a formula", ("formula", "probability"), tuple(rows), note)]


def _effect_table(effects: Sequence[EffectEntry], probabilities: Sequence[tuple[str, float]]) -> Table:
    """Every answer, the most probable first; `none` and `unknown` have no formula."""
    named = {e.get("name") for e in effects}
    more: list[EffectEntry] = [{"name": n, "probability": p} for n, p in probabilities if n not in named]
    effects = sorted([*effects, *more], key=lambda e: -(e.get("probability") or 0.0))
    rows = []
    for e in effects:
        closed = _share_of(e.get("closed"))
        cells = (
            titled(e),
            words(str(e.get("variant") or NOTHING)),
            str(e.get("site") or NOTHING),
            percent(e.get("probability")),
            number(e.get("log_evidence")),
            "; ".join(_parameter(k, v) for k, v in (e.get("parameters") or {}).items()) or NOTHING,
            NOTHING if closed is None else f"{share_of_gap(closed)} %",
        )
        rows.append(Row(cells))
    columns = ("effect", "formula", "site", "probability", "log evidence, nats", "parameters", "gap closed")
    return Table("Answers, the most probable first", columns, tuple(rows))


def _parameter(name: str, value: Any) -> str:
    if isinstance(value, Mapping):
        middle = value.get("median", value.get("mean", value.get("value")))
        low, high = value.get("hdi90") or (None, None)
        sd = value.get("sd")
        spread = f" ({interval(low, high)})" if low is not None else f" ± {number(sd)}" if sd is not None else ""
        unit = value.get("unit", "")
        estimate = number(middle, None if low is None else high - low)
        free = f" ({UNDETERMINED})" if decided_by(value.get("prior_share", 0.0)) == "prior" else ""
        return f"{name} {estimate}{spread} {'' if unit == '1' else unit}".strip() + free
    if isinstance(value, list) and len(value) == 2:
        return f"{name} {number(value[0])} ± {number(value[1])}"
    return f"{name} {number(value)}"
