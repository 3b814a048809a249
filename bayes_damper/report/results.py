"""From the JSON files of results to headlines and sections: words and tables, nothing computed anew."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_damper.numerals import NOTHING, SDS_WIDE, interval, number, percent, plus_minus
from bayes_damper.parameters import PARAMETERS, unit_of
from bayes_damper.report.charts import record_chart, response_chart, torque_chart
from bayes_damper.report.parts import (
    Headline,
    Picture,
    Result,
    Row,
    Section,
    Table,
    folded,
    generic,
    listed,
    words,
)
from bayes_damper.run import folder_name
from bayes_damper.sensitivity import decided_by
from bayes_damper.wording import COORDINATES, counted, gap_beside_verdict
from bayes_damper.wording import p_value as told_p

_HEADS = {
    "k1t n m per rad": "k1t [N m/rad]", "k1 n per m": "k1 [N/m]", "theta0 deg": "theta0 [deg]",
    "theta0 mm": "theta0 [mm]", "expected information nats": "expected information [nats]", "nats": "gain [nats]",
}  # fmt: skip
_OUTSIDE = 5.0  # per cent: a measurement below this percentile, or as far above, counts as outside
_PICTURES = {
    "forest": (
        "Parameters over the cases",
        "Median (dot) and 90 % interval (line) for each case. Hollow and thin: the prior decided.",
    ),
    "predictive": (
        "What was measured and what the fitted model gives",
        "Every measurement lies at 0, its standard error in grey; the model's median (dot), 50 and 90 % intervals.",
    ),
    "records": (
        "Records, band and residuals",
        "Measured records of one trial of each configuration under the model's 90 % band, residuals below.",
    ),
    "corner": (
        "Pairs of parameters",
        (
            "Each parameter by itself (in a single case dashed: the median and the 90 % interval written above; grey: "
            "what was assumed), and each pair: contours hold 50 and 90 % of the draws. A slanted one ties the two."
        ),
    ),
    "trace": (
        "Health of the run",
        "Left the draws in their order, which should not wander; right their ranks, flat where ensembles agree.",
    ),
}
_MORE = {
    "gap": (
        "What the model misses",
        "One record, what the nominal model leaves of it before and after the answer is added, and all probabilities.",
    ),
    "residuals": (
        "Where the residuals lie",
        "Residuals over the noise, by trial over time and frequency, and over angle and velocity. White: noise alone.",
    ),
    "ranking": ("Which effect, and where", "Bars: probability of each answer, and of each site of the rig."),
    "published": ("Published numbers", "Each published number beside what the leading answers predict for it."),
    "missing_torque": (
        "Missing torque",
        "The torque that the nominal model lacks, against time, angle and velocity, with its uncertainty.",
    ),
    "variability_effective": (
        "Effective stiffness and damping",
        "Effective linear stiffness and damping of each case, and what shared friction at another amplitude explains.",
    ),
    "variability_scatter": ("Scatter over the cases", "Median and 90 % interval of each part of the scatter."),
    "tune_response": (
        "Frequency response",
        "Acceleration of the primary per exciting torque over frequency, without a secondary and with each design.",
    ),
    "tune_loss": (
        "Insertion loss",
        "Insertion loss against the exciting torque, and over the inertia and the radius of the secondary.",
    ),
    "plan": (
        "What could be told apart",
        "Share of plausible sizes of each effect that would be seen, and nats by which it stands out beside rivals.",
    ),
}
_SITES = {
    "ground1": "the primary's spring to ground and what couples it",
    "bearings": "drag and friction in the bearings",
    "interface": "what acts between the two bodies: faces, magnet, coupling",
    "ground2": "the secondary: its inertia, its spring to ground",
    "release": "how the rig is let go",
    "sensor": "sensors and logger",
    "none": "no gap",
}
_RIVALS = {"none": "that nothing is missing", "unknown": "a cause outside the library"}
_KINDS = ("variability", "tune", "plan", "withheld", "comparison", "bench")
_MAIN = (
    "mu", "friction_torque", "friction_torque_per_inertia", "k2t", "c2t", "drag", "nu", "c1t", "c3t", "k1t", "J1", "J2",
)  # fmt: skip
_MEASURABLE = ("J1", "J2", "R", "r", "N0", "k1t", "k2t", "theta0", "drag", "mu")
_INTERVALS = (
    "Intervals hold 90 % of the posterior probability, given the model, the data and the prior. “Decided by prior” "
    "means that the measurements said nothing about that parameter: the interval is the one that was assumed."
)
_UNCONVERGED = "The run did not converge: do not use these numbers."


def _decided(p: Mapping[str, Any]) -> str:
    """Who decided about a parameter of summary.json, in the words of the tables."""
    share = p.get("prior_share")
    return "derived" if share is None else decided_by(share)


# A fit --------------------------------------------------------------------------------------------------------------


def fit_result(summary: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of summary.json."""
    cases = dict(summary.get("cases", {}))
    groups = cases | ({"all cases together": summary["joint"]} if summary.get("joint") else {})
    converged = bool(summary.get("converged"))
    failed = [name for name, entry in groups.items() if not entry.get("converged")]
    warnings = [f"{_title(name)} did not converge: do not use its numbers." for name in failed]
    sections = []
    pictures = _pictures(folder)
    shown = {Path(p.path).name for p in pictures} & {"predictive"}  # of all cases: what each would show once more
    for name, entry in groups.items():
        place = folder / ("joint" if name == "all cases together" else folder_name(name))
        sections.append(_case_section(name, entry, place, shown if len(groups) > 1 else set()))
    section = Section("Fit", (_INTERVALS,), pictures=pictures, parts=tuple(sections))
    head = _fit_headline(str(summary.get("campaign", "")), groups, converged)
    about = dict(summary.get("provenance", {})) | _fingerprint(summary)
    return Result(head, section, tuple(warnings), about, tuple(summary.get("warnings", ())))


def _fingerprint(data: Mapping[str, Any]) -> dict[str, Any]:
    return {k: data[k] for k in ("campaign", "campaign_sha256", "seed") if k in data}


def _title(name: str) -> str:
    return name[0].upper() + name[1:] if name.startswith("all") else f"Case {name}"


def _fit_headline(campaign: str, groups: Mapping[str, Any], converged: bool) -> Headline:
    sentences, changes = [], []
    if converged:
        sentences.append(_determined(groups))
        sentences.append("All runs converged." if len(groups) > 1 else "The run converged.")
    else:
        failed = [_title(n) for n, e in groups.items() if not e.get("converged")]
        sentences.append(f"{listed(failed)} did not converge. Do not use these numbers.")
        changes.append("More steps: bayes-damper resume FOLDER --more. The sentences of each case say what fell short.")
    checks = [row for entry in groups.values() for row in entry.get("predictive", [])]
    outside = [row for row in checks if _is_outside(row)]
    tone = "good" if converged else "bad"
    if checks:
        few = {0: "None", len(checks): "All"}.get(len(outside), str(len(outside)))
        sentences.append(
            f"{few} of {counted(len(checks), 'measurement')} {'lies' if len(outside) < 2 else 'lie'} outside the "
            f"central 90 % of the prediction; chance alone would put about {0.1 * len(checks):.0f} there."
        )
        if outside and len(outside) > max(1.0, 0.2 * len(checks)):
            tone = "bad" if not converged else "open"
            worst = ", ".join(words(str(row["name"])) for row in outside[:3])
            sentences.append(f"The model cannot reproduce all of the data, whatever its parameters: {worst}.")
            changes.append("A diagnosis of recorded trials would tell what the model lacks.")
    missed = _missed(groups)
    if missed:
        tone = "open" if converged else "bad"
        sentences.append(missed)
        changes.append("A diagnosis (bayes-damper diagnose) looks for what the model misses.")
    by_prior: dict[str, int] = {}
    for entry in groups.values():
        for name, p in entry.get("parameters", {}).items():
            if _decided(p) == "prior":
                by_prior.setdefault(name, 0)
                by_prior[name] += 1
    everywhere = [name for name, count in by_prior.items() if count == len(groups)]
    if everywhere:
        sentences.append(f"Nothing was learnt about {listed(everywhere)}: there the prior decided.")
        able = [name for name in everywhere if name in _MEASURABLE]
        if able:
            changes.append(f"Measuring {listed(able)} directly would replace an assumption by a fact.")
    title = f"Fit of {campaign}" if campaign else "Fit"
    return Headline(title, tone, tuple(sentences), changes=tuple(changes), table=_overview(groups))


def _determined(groups: Mapping[str, Any]) -> str:
    """Which parameters the data decide about, and in which cases, in a sentence."""
    where: dict[tuple[str, ...], list[str]] = {}
    for name in _MAIN:
        found = [g for g, e in groups.items() if _decided(e.get("parameters", {}).get(name, {})) == "data"]
        if found:
            where.setdefault(tuple(found), []).append(name)
    if not where:
        return "The data alone determine no parameter: each interval owes something to the prior."
    parts = []
    for places, names in sorted(where.items(), key=lambda item: -len(item[0])):
        fits = listed([place if place.startswith("all") else f"case {place}" for place in places])
        everywhere = len(places) == len(groups)
        parts.append(listed(names) + ("" if len(groups) == 1 else " everywhere" if everywhere else f" in {fits}"))
    return f"Determined by the data: {'; '.join(parts)}."


def _missed(groups: Mapping[str, Any]) -> str:
    """The channel of which the fit leaves most beyond the noise, in a sentence; nothing where it leaves noise alone."""
    rows = [
        (name, c)
        for name, entry in groups.items()
        for c in (entry.get("noise") or {}).get("channels", ())
        if c.get("learnt_from") == "residuals" and c.get("left_over_floor")
    ]
    if not rows:
        return ""
    name, worst = max(rows, key=lambda row: float(row[1]["left_over_floor"]))
    floor = worst.get("repeats") or worst.get("fast_content")
    source = "repeats differ by" if worst.get("repeats") else "the fast content has"
    return (
        f"The model misses something: in {_title(name)[0].lower() + _title(name)[1:]}, channel {worst['channel']}, it "
        f"leaves {worst['left']:.2g} {worst['unit']} where {source} {floor:.2g}. The intervals allow for it."
    )


def _overview(groups: Mapping[str, Any]) -> Table:
    names = [n for n in _MAIN if any(n in e.get("parameters", {}) for e in groups.values())]
    rows = []
    for name in names:
        cells, unit = [], ""
        for entry in groups.values():
            p = entry.get("parameters", {}).get(name)
            if p is None:
                cells.append(NOTHING)
                continue
            unit = p.get("unit", "")
            low, high = p["hdi90"]
            star = " *" if _decided(p) == "prior" else ""
            cells.append(f"{number(p['median'], high - low)}{star}\n({interval(low, high)})")
        rows.append(Row((_told_name(name), unit, *cells)))
    columns = ("parameter", "unit", *((n if n.startswith("all") else f"case {n}") + "\n90 %" for n in groups))
    starred = any("*" in cell for row in rows for cell in row.cells[2:])
    note = "* decided by the prior, not by the data" if starred else ""
    return Table("Median and 90 % interval", columns, tuple(rows), note)


def _told_name(name: str) -> str:
    """A parameter for the first column of a table: its name, and below what it is."""
    known = PARAMETERS.get(name.partition("[")[0])
    if known is None:
        return name
    formula = f" = {known.symbol}" if " " in known.symbol else ""
    return f"{name}{formula}\n{known.meaning}"


def _meaning(name: str) -> str:
    known = PARAMETERS.get(name.partition("[")[0])
    return f"{name}: {known.meaning}" if known else name


def _is_outside(row: Mapping[str, Any]) -> bool:
    return not _OUTSIDE <= float(row["percentile"]) <= 100.0 - _OUTSIDE


def _case_section(name: str, entry: Mapping[str, Any], folder: Path, shown: Collection[str] = ()) -> Section:
    """One case of a fit; `shown`: names of the figures that stand elsewhere on the page for all cases together."""
    good = bool(entry.get("converged"))
    assumed = any(p.get("prior") for p in entry.get("parameters", {}).values())
    rows = []
    for key, p in entry.get("parameters", {}).items():
        low, high = p["hdi90"]
        width = high - low
        who = _decided(p)
        health = (
            number(p.get("r_hat")),
            *(f"{v:.0f}" if (v := p.get(k)) else NOTHING for k in ("ess_bulk", "ess_tail")),
        )
        cells = (_meaning(key), number(p["median"], width), number(low, width), number(high, width), p["unit"], who)
        before = (interval(*p["prior"]["hdi90"]) if p.get("prior") else NOTHING,) if assumed else ()
        rows.append(Row(cells + before + health, "bad" if not good else "prior" if who == "prior" else ""))
    columns = (
        "parameter", "median", "90 % from", "to", "unit", "decided by", *(("assumed, 90 %",) if assumed else ()),
        "R-hat", "ESS bulk", "ESS tail",
    )  # fmt: skip
    tables = [Table(f"{_title(name)}: parameters", columns, tuple(rows))]
    checks = entry.get("predictive", [])
    if checks:
        tables.append(_check_table(name, checks))
    if entry.get("trials"):
        tables.append(_trial_table(name, entry["trials"]))
    tables += _more_tables(name, entry)
    sentences = tuple(entry.get("sentences", ()))
    evidence = entry.get("log_evidence")
    if evidence:
        error = max(evidence["error"], 0.01)
        sentences += (f"Log evidence {plus_minus(evidence['value'], error)} nats, to compare models of these records.",)
    if not good:
        sentences = (_UNCONVERGED, *sentences)
    file = folder / "posterior.nc"
    unit = entry.get("parameters", {}).get("sigma1", {}).get("unit", "")
    chart = record_chart(file, unit) if file.is_file() else None
    charts = () if chart is None else (chart,)
    pictures = [p for p in _pictures(folder, _title(name)) if Path(p.path).name not in shown]
    traces = tuple(p for p in pictures if Path(p.path).name == "trace")
    parts = (Section("Health of the run", pictures=traces, folded=True),) if traces else ()
    return Section(_title(name), sentences, tuple(tables), charts, tuple(p for p in pictures if p not in traces), parts)


def _more_tables(name: str, entry: Mapping[str, Any]) -> list[Table]:
    """What a fit tells beside its parameters, as far as it is there: noise, odd trials, priors, the best fit."""
    tables: list[Table] = []
    columns: tuple[str, ...]
    apart = entry.get("unlike_repeats") or {}
    if apart.get("trials"):
        rows = tuple(Row((str(t["trial"]), f"{number(t['residual_power'])} times"), "bad") for t in apart["trials"])
        columns = ("trial", "power of its residuals, against its repeats")
        tables.append(Table(f"{_title(name)}: trials unlike their repeats", columns, rows))
    if apart.get("answers"):
        rows = tuple(
            Row((_meaning(n), number(p["with"]["value"]), number(p["without"]["value"]), f"{p['shift_sd']:+.1f} sd"))
            for n, p in apart["answers"].items()
        )
        columns = ("parameter", "with them", "without them", "shift")
        tables.append(Table(f"{_title(name)}: parameters without those trials", columns, rows))
    if entry.get("influence"):
        rows = tuple(
            Row((label, i["moves_most"], f"{i['shift_sd']:+.1f} sd")) for label, i in entry["influence"].items()
        )
        columns = ("trial left out", "moves most", "by")
        tables.append(Table(f"{_title(name)}: what each trial decides", columns, rows))
    if entry.get("prior_sensitivity"):
        tables.append(_sensitivity_table(f"{_title(name)}: how the answers hang on the priors",
                                         entry["prior_sensitivity"]))  # fmt: skip
    for key in ("noise", "best_fit"):
        if isinstance(entry.get(key), Mapping):
            tables += generic({words(key): entry[key]}, "").tables
    return tables


def _sensitivity_table(caption: str, rows: Mapping[str, Any]) -> Table:
    """Shifts when one prior is half or twice as wide."""
    out = []
    for name, p in rows.items():
        half, double = p["half"], p["double"]
        cells = [_meaning(name)]
        for found in (half, double):
            cells.append(f"{found['shift']:+.2f}" + ("" if found["reliable"] else " ?"))
        most = max((half, double), key=lambda found: abs(found["shift_of_that"]))
        cells.append(f"{most['moves_most']} {most['shift_of_that']:+.2f}")
        out.append(Row(tuple(cells)))
    columns = ("parameter", "its prior half as wide", "twice as wide", "moves most among the others")
    note = "Shifts of the mean in standard deviations. ?: too few draws count to be sure; fit with that prior to know."
    return Table(caption, columns, tuple(out), note)


def _check_table(name: str, checks: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for row in checks:
        error = row["standard_error"]
        outside = _is_outside(row)
        cells = (
            words(str(row["name"]).partition(": ")[2] or str(row["name"])),
            plus_minus(row["measured"], error),
            number(row["median"], error),
            interval(*row["hdi90"]),
            row["unit"],
            f"{row['percentile']:.0f} %",
            "outside" if outside else "inside",
        )
        rows.append(Row(cells, "bad" if outside else ""))
    columns = ("feature", "measured ± standard error", "model, median", "model, 90 %", "unit", "percentile", "verdict")
    note = "Percentile: where the measurement falls in the prediction, noise included. Outside: below 5 or above 95 %."
    return Table(f"{_title(name)}: what was measured and what the fitted model gives", columns, tuple(rows), note)


def _trial_table(name: str, trials: Mapping[str, Any]) -> Table:
    rows = []
    for label, nuisances in trials.items():
        for key, p in nuisances.items():
            low, high = p["hdi90"]
            rows.append(Row((label, _meaning(key), number(p["mean"], high - low), interval(low, high), p["unit"])))
    columns = ("trial", "unknown", "mean", "90 %", "unit")
    return Table(f"{_title(name)}: unknowns of each trial", columns, tuple(rows))


def _pictures(folder: Path, group: str = "", *, kind: str = "") -> tuple[Picture, ...]:
    """Figures that lie in a folder, known ones first; one entry for SVG and PNG of a name.

    Where several results share a folder, figures go by their names: to the `kind` that they begin with, else to the fit
    if it draws such figures, else to whichever of fit and diagnosis comes first on the page.
    """
    stems = sorted({p.stem for s in (".svg", ".png") for p in folder.glob(f"*{s}")})
    if kind not in ("", "diagnosis"):
        stems = [s for s in stems if s.startswith(kind)]
    else:
        stems = [s for s in stems if not s.startswith(_KINDS) and not (kind == "diagnosis" and s in _PICTURES)]
    order = list(_PICTURES)
    stems.sort(key=lambda s: (order.index(s) if s in order else len(order), s))
    out = []
    for stem in stems:
        title, alt = (_PICTURES | _MORE).get(stem, (words(stem).capitalize(), f"Figure: {words(stem)}."))
        note = alt if stem in _PICTURES or stem in _MORE else ""
        out.append(
            Picture(title, f"{group + ': ' if group else ''}{alt}", str(folder / stem), note, first=stem == "gap")
        )
    return tuple(out)


# A diagnosis --------------------------------------------------------------------------------------------------------


def diagnosis_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of diagnosis.json."""
    probabilities = sorted(data.get("probabilities", {}).items(), key=lambda item: -item[1])
    verdict, gap = str(data.get("verdict", "unknown")), data.get("gap") or {}
    # What is on the first screen is the same model as one of the rows: one model, one number.
    effects = [
        {**e, "closed": gap["closed"]}
        if gap.get("closed") and e.get("augmented_rms") == gap.get("augmented_rms")
        else e
        for e in data.get("effects") or ()
    ]
    share = dict(probabilities).get(verdict)
    sites = sorted((data.get("sites") or {}).items(), key=lambda item: -item[1])
    pair = data.get("pair")
    sentences = _verdict_sentences(verdict, share, sites, pair, effects)
    if pair:
        sentences.append(
            f"One effect does not close the gap; {listed([words(e) for e in pair['effects']])} together do "
            f"({percent(pair['probability'])})."
        )
    beside = gap_beside_verdict(verdict, share or 0.0, gap)
    sentences += [beside] if beside and verdict == "none" else [_gap_sentence(gap), beside]
    credible = [words(n) for n in data.get("credible_set", [])]
    if len(credible) > 1:
        sentences.append(f"With 90 % probability it is one of {listed(credible)}; the data do not decide which.")
    who = "these two together close" if pair else "the most probable cause closes"
    if verdict in ("none", "unknown"):
        who = "what comes closest to a cause would close"
    sentences.append(_closed_sentence(gap, who))
    changes = [
        f"{listed([words(n) for n in group])} cannot be told apart by these data."
        for group in data.get("indistinguishable", [])
        if set(group) & set(data.get("credible_set", []))
    ]
    changes += [_experiment_sentence(e) for e in (data.get("next_experiment") or [])[:1]]
    if len(probabilities) > 1:
        second = next(item for item in probabilities if item[0] != verdict)
        changes.append(f"The strongest rival is {_RIVALS.get(second[0], words(second[0]))} ({percent(second[1])}).")
    top = (share or 0.0) > 0.9 and len(credible) <= 1
    tone = "good" if verdict == "none" and top else "bad" if top else "open"
    shown = tuple((words(n), float(p)) for n, p in probabilities if p >= 0.01)[:8]
    name = str(data.get("campaign", ""))
    head = Headline(
        f"Diagnosis of {name}" if name else "Diagnosis", tone, tuple(s for s in sentences if s), shown, tuple(changes)
    )
    translational = _is_translational(data)
    charts = [torque_chart(f, translational=translational) for f in sorted(folder.glob("*torque*.csv"))]
    rest = generic(
        data, "", ("schema", "campaign", "verdict", "credible_set", "probabilities", "sites", "effects", "provenance",
                   "campaign_sha256", "seed", "indistinguishable", "notes", "next_experiment", "gap", "parameters",
                   "sensitivity", "where", "forecast", "reading_unit", "warnings"),
    )  # fmt: skip
    places = _where_sections(data.get("where") or {}, translational)
    every = (_effect_table(effects, probabilities),)
    choices = _choice_tables(data.get("sensitivity") or [])
    section = Section(
        "Diagnosis",
        tuple(data.get("notes", ())),
        (
            _site_table(sites),
            *_gap_tables(gap, effects, pair, str(data.get("reading_unit") or "")),
            *_forecast_tables(data.get("forecast") or {}, str(data.get("reading_unit") or "")),
            *_shift_tables(data.get("parameters") or {}),
            *_experiment_tables(data.get("next_experiment") or []),
        ),
        tuple(c for c in charts if c is not None),
        _pictures(folder, kind="diagnosis"),
        (
            *places,
            Section("Every answer that was tried", tables=every, folded=True),
            *([Section("How far the verdict hangs on choices", tables=choices, folded=True)] if choices else []),
            *folded(rest),
        ),
    )
    about = dict(data.get("provenance", {})) | _fingerprint(data)
    return Result(head, section, (), about, tuple(data.get("warnings", ())))


def _verdict_sentences(
    verdict: str,
    share: float | None,
    sites: Sequence[tuple[str, float]],
    pair: Mapping[str, Any] | None,
    effects: Sequence[Mapping[str, Any]] = (),
) -> list[str]:
    """The verdict in plain words, with its probability, what the effect is, its size, and the most probable place."""
    sure = (share or 0.0) >= 0.9
    if verdict == "none":
        told = "Nothing is missing from the model" if sure else "Most probable, but not sure: nothing is missing"
        return [f"{told} ({percent(share)})."]
    place = next(((s, p) for s, p in sites if s != "none"), None)
    where = [f"Most probable place: {_place(place[0])} ({percent(place[1])})."] if place else []
    if verdict == "unknown":
        told = "Something is missing" if sure else "Most probable, but not sure: something is missing"
        return [f"{told} that no effect of the library explains ({percent(share)}).", *where]
    if pair:
        return [f"Two causes; the stronger one is {words(verdict)} ({percent(share)})."]
    told = "The missing effect is" if sure else "Most probable, but not sure:"
    found: Mapping[str, Any] = next((e for e in effects if e.get("name") == verdict), {})
    size = "; ".join(_parameter(k, v) for k, v in (found.get("parameters") or {}).items())
    meant = [str(found["meaning"])] if found.get("meaning") else []
    if size and found.get("formula"):
        meant.append(f"Its law: {found['formula']}, with {size} (90 % intervals).")
    return [f"{told} {words(verdict)} ({percent(share)}).", *meant, *where]


def _place(site: str) -> str:
    return f"{site}, {_SITES[site]}" if site in _SITES else site


def _records_table(caption: str, records: Sequence[Mapping[str, Any]]) -> Table:
    table = generic({caption: list(records)}, "").tables[0]
    return replace(table, columns=tuple(_HEADS.get(c, c) for c in table.columns))


def _gap_sentence(gap: Mapping[str, Any]) -> str:
    answer = gap.get("answer")
    p = gap.get("p_value")
    told = "" if p is None else f" ({told_p(p)})"
    return {
        "gap": f"The rig and the model differ by more than the noise{told}.",
        "none": f"The rig and the model differ by no more than the noise{told}.",
        "cannot tell": f"These data cannot tell whether the rig and the model differ{told}.",
    }.get(str(answer), "")


def _closed_sentence(gap: Mapping[str, Any], who: str) -> str:
    closed = (gap.get("closed") or {}).get("median")
    if closed is None:
        return ""
    hdi = (gap.get("closed") or {}).get("hdi90")
    spread = f" (90 %: {_whole(hdi[0])} to {_whole(hdi[1])} %)" if hdi else ""
    where = (
        "coupled peaks, predicted without the coupled numbers of their case," if gap.get("on") else "held-out trials"
    )
    if closed <= 0.0:
        return f"On {where} nothing that was tried closes any of the gap{spread}."
    return f"On {where} {who} {_whole(closed)} % of the gap{spread}."


def _whole(share: float) -> str:
    """A share in whole per cent; never -0."""
    return f"{round(100.0 * share)}"


def _experiment_sentence(e: Mapping[str, Any]) -> str:
    forms = {
        "configuration": "{}", "k1t_n_m_per_rad": "k1t {} N m/rad", "k1_n_per_m": "k1 {} N/m",
        "theta0_deg": "released at {} deg", "theta0_mm": "released at {} mm",
    }  # fmt: skip
    details = [
        form.format(f"{e[key]:.3g}" if isinstance(e[key], int | float) else e[key])
        for key, form in forms.items()
        if e.get(key) is not None
    ]
    gain = e.get("expected_information_nats")
    return f"Next experiment: {', '.join(details)}" + (
        "." if gain is None else f" (expected information {gain:.2f} nats; to settle an even choice takes 0.69)."
    )


def _site_table(sites: Sequence[tuple[str, float]]) -> Table:
    rows = tuple(Row((words(name), percent(p), _SITES.get(name, NOTHING))) for name, p in sites)
    return Table("Probability of each site", ("site", "probability", "what belongs to it"), rows)


def _experiment_tables(proposals: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Experiments by the information that they are expected to give."""
    if not proposals:
        return []
    table = _records_table("Next experiment", proposals)
    note = (
        "Expected information about which answer is right: 0.69 nats settle an even choice between two. Margin: how "
        "far apart, in nats, the two answers stand that the experiment splits least; it ranks those that all decide."
    )
    return [replace(table, note=note if any("margin" in p for p in proposals) else "")]


_OTHER = {"scale": ("scale of the readings of channel", "1"), "lag": ("lag of the readings of channel", "s")}
_CHANNELS = {1: "1, primary", 2: "2, secondary"}


def _is_translational(data: Mapping[str, Any]) -> bool:
    unit = str(data.get("reading_unit") or "")
    return unit.startswith("m") or any("k1_n_per_m" in e for e in data.get("next_experiment") or ())


def _where_sections(where: Mapping[str, Any], translational: bool) -> tuple[Section, ...]:
    """Where residuals exceed the noise, one table for each way to look; nothing where nothing does."""
    if "feature" in where:
        return _published_sections(where["feature"])

    def cells(row: Mapping[str, Any], *names: str) -> tuple[str, ...]:
        return tuple(str(row[n]) if row.get(n) is not None else "all" for n in names)

    def channel(row: Mapping[str, Any]) -> str:
        return _CHANNELS.get(row.get("channel", 0), str(row.get("channel", NOTHING)))

    def p(row: Mapping[str, Any]) -> str:
        return NOTHING if row.get("p_value") is None else told_p(row["p_value"]).removeprefix("p ").removeprefix("= ")

    def span(low: float, high: float) -> str:
        return f"{low:.3g} to {high:.3g}"

    tables: list[Table] = []

    def add(caption: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], note: str = "") -> None:
        if rows:
            tables.append(Table(caption, columns, tuple(Row(r) for r in rows), note))

    times = "Trials: those repeats whose residuals were taken together."
    rows = [
        (span(r["start_s"], r["end_s"]), channel(r), *cells(r, "case", "configuration"),
         ", ".join(map(str, r.get("trials") or [r.get("trial", NOTHING)])), p(r))
        for r in where.get("time") or ()
    ]  # fmt: skip
    add("In time", ("time [s]", "channel", "case", "configuration", "trials", "p value"), rows, times)
    rows = [
        (span(r["low_hz"], r["high_hz"]), channel(r), *cells(r, "case", "configuration"), p(r))
        for r in where.get("frequency") or ()
    ]
    add("In frequency", ("band [Hz]", "channel", "case", "configuration", "p value"), rows)
    power = "power above the noise"
    note = (
        "Power of the residuals above that of the noise, in units of the noise's: 0 is noise alone, 1 is twice as much."
    )
    rows = [(channel(r), f"{r['excess_over_noise']:+.2f}", p(r)) for r in (where.get("channel") or {}).values()]
    add("By channel", ("channel", power, "p value"), rows, note)
    rows = [
        (*cells(r, "case", "configuration"), f"{r['excess_over_noise']:+.2f}", p(r))
        for r in (where.get("case") or {}).values()
    ]
    add("By case", ("case", "configuration", power, "p value"), rows, note)

    def named(coordinate: str) -> tuple[str, str]:
        return COORDINATES[coordinate][translational] if coordinate in COORDINATES else (coordinate, "")

    rows = []
    for r in where.get("phase_space") or ():
        both = [
            f"{symbol} {span(*reach)} {unit}".rstrip()
            for (symbol, unit), reach in zip(map(named, r["coordinates"]), r["range"], strict=True)
        ]
        rows.append((both[0], both[1], channel(r), f"{r['excess_over_noise']:+.2f}", p(r)))
    letters = "x and v" if translational else "θ and ω"
    moves = f"{letters}: position and velocity of the primary (1) and the secondary (2). {note}"
    add("In phase space", ("where", "and", "channel", power, "p value"), rows, moves)
    event = where.get("event")
    if event and event.get("local"):  # else it only says that a law is wrong everywhere
        unit = "N s" if translational else "N m s"
        impulse = f"{event['impulse_n_m_s']:.3g} ± {event['impulse_sd_n_m_s']:.2g} {unit}"
        row = (
            span(event["start_s"], event["end_s"]), str(event["site"]), impulse, f"{event['gain_nats']:.0f} nats",
            percent(event["share"]),
        )  # fmt: skip
        columns = ("time [s]", "site", "impulse ± sd", "gain", "share of the misfit")
        add("A knock at one instant explains most of the misfit", columns, [row])
    return (Section("Where the model and the rig differ", tables=tuple(tables)),) if tables else ()


def _published_sections(features: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
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
    gap: Mapping[str, Any], effects: Sequence[Mapping[str, Any]], pair: Mapping[str, Any] | None = None, unit: str = ""
) -> list[Table]:
    """Residuals on held-out trials: the noise, the nominal model, each effect that was added, and two that answer."""
    if gap.get("nominal_rms") is None:
        return []
    rows = [
        Row(("noise alone", number(gap.get("noise_rms")), NOTHING)),
        Row(("nominal model", number(gap["nominal_rms"]), "0 %")),
    ]
    told = [e for e in effects if e.get("augmented_rms") is not None]
    if pair and gap.get("augmented_rms") is not None:
        both = " and ".join(str(name) for name in pair["effects"])
        told.append({"name": both, "augmented_rms": gap["augmented_rms"], "closed": gap.get("closed")})
    if not told and gap.get("augmented_rms") is not None:
        told = [{"name": "most probable cause", "augmented_rms": gap["augmented_rms"], "closed": gap.get("closed")}]
    for e in told:
        closed = e.get("closed") or {}
        share = NOTHING
        if closed.get("median") is not None:
            share = f"{_whole(closed['median'])} %"
            if closed.get("hdi90"):
                low, high = closed["hdi90"]
                share += f" ({_whole(low)} to {_whole(high)} %)"
        rows.append(Row((f"with {words(str(e['name']))}", number(e["augmented_rms"]), share)))
    unit = unit or str(gap.get("unit") or "")
    columns = ("model", f"rms residual [{unit}]" if unit else "rms residual", "gap closed (90 %)")
    note = (
        f"On {gap['on']}."
        if gap.get("on")
        else (
            f"On held-out trials{'' if unit else ', in the unit of the readings'}; only what each trial has for itself "
            "(release angle, instant) is fitted there."
        )
    )
    return [Table("The gap before and after", columns, tuple(rows), note)]


def _forecast_tables(ahead: Mapping[str, Any], unit: str = "") -> list[Table]:
    """Held-out trials forecast from their first periods: what is missed, and what share the bands hold."""
    if "before" not in ahead:
        return []
    sides = [side for side in ("before", "after") if side in ahead]

    def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
        found = [row[side] for side in sides if row.get(side) is not None]
        return tuple(
            " → ".join(number(f["rms"]) if name == "rms" else percent(f[name]) for f in found)
            for name in ("rms", "coverage50", "coverage90")
        )

    rows = [
        Row((f"case {t['case']}, {t['configuration']}, trial {t['trial']}", str(t["readings"]), *cells(t)))
        for t in ahead["trials"]
    ]
    if len(rows) > 1:
        rows.append(Row(("all", str(sum(t["readings"] for t in ahead["trials"])), *cells(ahead))))
    heads = ("trial", "readings", f"rms miss [{unit}]" if unit else "rms miss", "in the 50 % band", "in the 90 % band")
    note = (
        f"Each trial's own state is inferred from its first {ahead['periods']:g} periods, the rest is predicted; "
        "by the nominal model → with the leading effect added. Fewer readings in a band than it should hold: "
        "the model is surer than it may be."
    )
    return [Table("Forecasts of held-out trials", heads, tuple(rows), note)]


def _shift_tables(parameters: Mapping[str, Any]) -> list[Table]:
    """Parameters of the nominal model before and after the leading effect is added."""
    rows = []
    for name, p in parameters.items():
        meant, unit = _meaning(name), PARAMETERS[k].unit if (k := name.partition("[")[0]) in PARAMETERS else ""
        if (own := re.fullmatch(r"(scale|lag)(\d)", name)) is not None:
            meant, unit = f"{name}: {_OTHER[own[1]][0]} {own[2]}", _OTHER[own[1]][1]
        cells = [meant]
        for side in ("before", "after"):
            found = p.get(side)
            cells.append(NOTHING if not found else plus_minus(found["value"], found["sd"]))
        cells.append(str(p.get("unit") or unit))
        shift = p.get("shift_sigmas")
        rows.append(Row((*cells, NOTHING if shift is None else f"{shift:+.1f} sd")))
    columns = ("parameter", "nominal model ± sd", "with the leading effect ± sd", "unit", "shift")
    note = "Shift in standard deviations of the nominal model."
    return [Table("Parameters before and after", columns, tuple(rows), note)] if rows else []


def _choice_tables(choices: Sequence[Mapping[str, Any]]) -> tuple[Table, ...]:
    """What the verdict would be had something been chosen otherwise."""
    rows = tuple(
        Row((
            str(c["choice"]), words(str(c["verdict"])), percent(c["probability"]),
            percent(c.get("probability_of_the_leading_answer")),
        ))
        for c in choices
    )  # fmt: skip
    columns = ("had it been otherwise", "verdict", "probability", "today's verdict keeps")
    return (Table("The verdict under other choices", columns, rows),) if rows else ()


def _effect_table(effects: Sequence[Mapping[str, Any]], probabilities: Sequence[tuple[str, float]]) -> Table:
    """Every answer, the most probable first; `none` and `unknown` have no formula."""
    named = {e.get("name") for e in effects}
    more = [{"name": n, "probability": p} for n, p in probabilities if n not in named]
    effects = sorted([*effects, *more], key=lambda e: -(e.get("probability") or 0.0))
    rows = []
    for e in effects:
        closed = e.get("closed")
        closed = closed.get("median") if isinstance(closed, Mapping) else closed
        cells = (
            words(str(e.get("name", ""))),
            words(str(e.get("variant") or NOTHING)),
            str(e.get("site") or NOTHING),
            percent(e.get("probability")),
            number(e.get("log_evidence")),
            "; ".join(_parameter(k, v) for k, v in (e.get("parameters") or {}).items()) or NOTHING,
            NOTHING if closed is None else f"{_whole(closed)} %",
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
        told = number(middle, None if low is None else high - low)
        return f"{name} {told}{spread} {'' if unit == '1' else unit}".strip()
    if isinstance(value, list) and len(value) == 2:
        return f"{name} {number(value[0])} ± {number(value[1])}"
    return f"{name} {number(value)}"


# A tuning -----------------------------------------------------------------------------------------------------------


def tune_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of tune.json."""
    target = data["target_db"]
    translational = data.get("kind") == "translational"
    effort, newton = ("force", "N") if translational else ("torque", "N m")
    asked = any(data.get("design", {}).get(key) is not None for key in ("J2", "k2t", "R", "magnet_pull"))
    own = "your design" if asked else "the rig as it is"
    designs = [(own, data.get("design", {}), data)]
    if data.get("optimum"):
        designs.append(("best design", data["optimum"]["design"], data["optimum"]))
    converged = bool(data.get("converged", True))
    sentences = [] if converged else ["The fit that this rests on did not converge: do not use these numbers."]
    for name, _, found in designs:
        loss, p = found["linear"]["insertion_loss_db"], found["linear"]["probability_of_target"]
        who = f"{name[0].upper() + name[1:]}, linear model"
        if loss["interval90"] is None:
            sentences.append(f"{who}: damping leaves no resonance, so no loss can be told.")
            continue
        low, high = loss["interval90"]
        sentences.append(
            f"{who}: insertion loss {number(loss['mean'], _wide(high - low, _DB))} dB (90 %: "
            f"{_interval(low, high, _DB)} dB); it reaches {target:g} dB with probability {percent(p)}."
        )
    sentences += data.get("notes", ())
    weak = [row for row in data.get("nonlinear", []) if row["probability_of_target"] < 0.5]
    # Draws without a resonance do not reach the target; where there is one they may well.
    silent = [row for row in weak if (row["insertion_loss_db"]["mean"] or target) >= target]
    weak = [row for row in weak if row not in silent]
    if weak:
        at = listed([f"{row['torque_amplitude_n_m']:g} {newton}" for row in weak])
        sentences.append(f"With dry friction, {own} probably misses the target where the {effort} is {at}.")
    if silent:
        at = listed([f"{row['torque_amplitude_n_m']:g} {newton}" for row in silent])
        sentences.append(
            f"Where the {effort} is {at}, {own} probably has no resonance left to compare: dry friction holds it or "
            "damps it away."
        )
    changes = []
    if data.get("hangs_most_on"):
        name = data["hangs_most_on"]
        share = data.get("variance_shares", {}).get(name)
        changes.append(
            f"The insertion loss hangs most on {name} ({percent(share)} of its variance): measure that better."
        )
    if data.get("optimum") and data["optimum"].get("at_bound"):
        changes.append(
            f"The best design lies at the bound of {listed(data['optimum']['at_bound'])}: wider bounds may give more."
        )
    rows = []
    for name, _, found in designs:
        rows.append(_performance_row(f"{name}, linear", found["linear"]))
        rows += [
            _performance_row(f"{name}, {effort} {r['torque_amplitude_n_m']:g} {newton}", r)
            for r in found.get("nonlinear", [])
        ]
    columns = (
        "design and model",
        "loss, mean [dB]",
        "loss, 90 % [dB]",
        "resonance (90 %) [Hz]",
        "shift (90 %) [Hz]",
        f"P(loss ≥ {target:g} dB)",
    )
    note = f"{data.get('definition', '')}." if data.get("definition") else ""
    if any(row.cells[1] == NOTHING for row in rows):
        note += (
            f" {NOTHING}: at that {effort} the rig sticks or no steady response was found, so there is no loss to tell."
        )
    tables = [Table("Insertion loss and resonance", columns, tuple(rows), note.strip())]
    described = _design_table(designs, "translational" if translational else "torsional")
    tables += [described] if described.rows else []
    if data.get("variance_shares"):
        shares = tuple(Row((k, percent(v))) for k, v in data["variance_shares"].items())
        tables.append(
            Table("What the insertion loss hangs on", ("parameter", "share of its variance"), shares, _SHARES)
        )
    chart = response_chart(data.get("frequency_response", {}), translational=translational)
    p = data["linear"]["probability_of_target"]
    head = Headline(
        f"Tuning, case {data.get('case', '')}", "bad" if p < 0.1 or not converged else "good" if p > 0.9 else "open",
        tuple(sentences), changes=tuple(changes),
    )  # fmt: skip
    warnings = () if converged else ("The tuning rests on a fit that did not converge: do not use its numbers.",)
    section = Section(
        "Tuning",
        (f"From {counted(int(data.get('draws') or 0), 'draw')} of the posterior.",),
        tuple(tables),
        () if chart is None else (chart,),
        _pictures(folder, kind="tune"),
    )
    about = dict(data.get("provenance", {})) | _fingerprint(data)
    return Result(head, section, warnings, about, tuple(data.get("warnings", ())))


_SHARES = (
    "What each parameter explains by itself. Parameters that the data tie together share what they explain: the shares "
    "then add up to more than 100 %."
)


def _performance_row(name: str, p: Mapping[str, Any]) -> Row:
    loss = p["insertion_loss_db"]
    low, high = loss["interval90"] or (None, None)
    cells = (
        name, number(loss["mean"], None if low is None else _wide(high - low, _DB)), _interval(low, high, _DB),
        *(_told_or_nothing(p[key]) for key in ("resonance_hz", "resonance_shift_hz")),
        NOTHING if low is None else percent(p["probability_of_target"]),
    )  # fmt: skip
    return Row(cells)


def _told_or_nothing(found: Mapping[str, Any]) -> str:
    """Median and 90 % interval; nothing where no draw has the quantity."""
    if found.get("median") is None or not found.get("interval90"):
        return number(found.get("median"))
    low, high = found["interval90"]
    return f"{number(found['median'], _wide(high - low, _HZ))} ({_interval(low, high, _HZ)})"


_DB, _HZ = SDS_WIDE, 0.1 * SDS_WIDE
"""Widths of intervals below which nobody needs more digits: of a loss in dB, of a resonance in Hz."""


def _wide(width: float, least: float) -> float:
    return max(width, least)


def _interval(low: float | None, high: float | None, least: float) -> str:
    """An interval with no more digits than one of the `least` width would have."""
    if low is None or high is None:
        return NOTHING
    width = _wide(high - low, least)
    return f"{number(low, width)} to {number(high, width)}"


def _design_table(designs: Sequence[tuple[str, Mapping[str, Any], Any]], kind: str) -> Table:
    names = {"J2": "J2", "k2t": "k2t", "R": "R", "magnet_pull": "N0", "bar_inertia": "J2"}
    if kind == "translational":
        names = {key: name for key, name in names.items() if key in ("J2", "k2t", "magnet_pull")}
    units = {key: unit_of(name, kind) for key, name in names.items()}
    rows = tuple(
        Row((words(key), unit, *("as it is" if d.get(key) is None else number(d[key]) for _, d, _ in designs)))
        for key, unit in units.items()
        if any(d.get(key) not in (None, 0.0) for _, d, _ in designs)
    )
    return Table("Designs", ("quantity", "unit", *(name for name, _, _ in designs)), rows)


# A plan -------------------------------------------------------------------------------------------------------------


def plan_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of plan.json."""
    columns: tuple[str, ...]
    cells: tuple[str, ...]
    rows = []
    for e in data["effects"]:
        rival, least = e.get("rival") or {}, e.get("smallest") or {}
        times = e.get("repeats_needed")
        cells = (
            words(e["name"]),
            e["site"],
            percent(e["chance"]),
            "; ".join(f"{k} {number(v['value'])} {v['unit']}".strip() for k, v in least.items()) or NOTHING,
            words(rival.get("name", NOTHING)),
            number(rival.get("nats"), 10.0) if (rival.get("nats") or 0.0) < 100.0 else "above 100",
            "more than 100 times" if times is None else "as planned" if times == 1 else f"{times} times",
        )
        rows.append(Row(cells, "bad" if times is None else ""))
    columns = ("effect", "site", "seen", "smallest seen", "strongest rival", "nats over it", "trials needed")
    note = (
        "Seen: share of the sizes and shapes that the library holds plausible. Trials needed: how many times those "
        "planned until the effect is seen and told from every rival."
    )
    tables = [Table("What the planned trials could tell", columns, tuple(rows), note)]
    parameters = []
    for name, p in data["parameters"].items():
        low, high = p["expected90"]
        who = decided_by(p["sd_over_prior"] ** 2)
        cells = (_meaning(name), interval(low, high), p["unit"], number(p["sd_over_prior"], 0.1), who)
        parameters.append(Row(cells, "prior" if who == "prior" else ""))
    columns = ("parameter", "expected 90 %", "unit", "sd / prior sd", "decided by")
    tables.append(Table("What they would teach about each parameter", columns, tuple(parameters)))
    if data.get("add"):
        tables.append(_records_table("Single trials that would help most", data["add"]))
    told = sum(e["repeats_needed"] == 1 for e in data["effects"])
    sentences = (f"{told} of {len(rows)} effects would be seen and told from all others.", *data["sentences"])
    name = str(data.get("campaign", ""))
    head = Headline(f"Plan of {name}" if name else "Plan", "open", sentences[:4])
    section = Section("Plan", sentences[4:], tuple(tables), (), _pictures(folder, kind="plan"))
    return Result(head, section, (), dict(data.get("provenance", {})) | _fingerprint(data))


# What the cases share ---------------------------------------------------------------------------------------------

_SHARING = {
    "shared": "one parameter set for all cases",
    "separate": "each case its own parameter set",
    "partial": "values scattered about a common mean",
}


def variability_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of variability.json."""
    models = sorted(data["models"].items(), key=lambda item: -item[1]["probability"])
    converged = bool(data.get("converged"))
    sentences = [] if converged else [_UNCONVERGED]
    first, p = models[0][0], float(models[0][1]["probability"])
    sentences.append(f"Most probable: {_SHARING.get(first, first)} ({percent(p)}).")
    sentences += data.get("sentences", ())
    rows = []
    for name, m in models:
        score = (m.get("heldout") or {}).get("log_score")
        cells = (_SHARING.get(name, name), percent(m["probability"]), number(m["log_evidence"]), number(m.get("error")))
        rows.append(Row((*cells, number(score)), "" if converged else "bad"))
    columns = ("answer", "probability", "log evidence, nats", "its error", "log score on unseen data")
    compared = Table("Do the cases share their parameters?", columns, tuple(rows))
    shown = tuple((_SHARING.get(name, name), float(m["probability"])) for name, m in models)
    tone = "bad" if not converged else "good" if shown[0][1] > 0.9 else "open"
    name = str(data.get("campaign", ""))
    head = Headline(
        f"What the cases of {name} share" if name else "What the cases share", tone, tuple(sentences), shown
    )
    rest = generic(
        data, "", ("schema", "campaign", "campaign_sha256", "seed", "converged", "sentences", "provenance", "models",
                   "effective", "decomposition", "recycled", "method", "kind", "method_of_effective", "cases", "pooled",
                   "common", "warnings"),
    )  # fmt: skip
    pictures = _pictures(folder, kind="variability")
    told = tuple(str(data[key]) for key in ("method", "method_of_effective") if data.get(key))
    tables = (compared, *_decomposition_tables(data), *_recycled_tables(data.get("recycled") or {}))
    section = Section("Variability", told, tables, (), pictures, folded(rest))
    warnings = () if converged else ("The comparison of the cases did not converge: do not use its numbers.",)
    about = dict(data.get("provenance", {})) | _fingerprint(data)
    return Result(head, section, warnings, about, tuple(data.get("warnings", ())))


def _decomposition_tables(data: Mapping[str, Any]) -> list[Table]:
    """Where the scatter of the effective values comes from, and those values case by case."""
    tables = []
    for name, parts in (data.get("decomposition") or {}).items():
        rows = []
        for key, row in parts.items():
            if not isinstance(row, Mapping) or "median" not in row:
                continue
            share = row.get("share")
            told = NOTHING
            if share:
                low, high = share["hdi90"]
                told = f"{100.0 * share['median']:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f} %)"
            cells = (words(key), number(row["median"]), interval(*row["hdi90"]), told)
            rows.append(Row(cells))
        columns = ("part", f"variance of ln {name}", "90 %", "share (90 %)")
        tables.append(
            Table(f"Where the scatter of the effective {name} over the cases comes from", columns, tuple(rows))
        )
    cases = (data.get("effective") or {}).get("cases") or {}
    if cases:
        rows = []
        for case, row in cases.items():
            line = [case, number(1e3 * row["energy_j"])]
            for name in ("k2t", "c2t"):
                line.append(f"{number(row[name]['median'])} ({interval(*row[name]['hdi90'])})")
                line.append(number((row.get("measured") or {}).get(name)))
            rows.append(Row(tuple(line)))
        heads = ["case", "initial energy [mJ]"]
        for name in ("k2t", "c2t"):
            unit = unit_of(name, str(data.get("kind", "torsional")))
            heads += [f"effective {name} (90 %) [{unit}]", f"fitted to the measurement [{unit}]"]
        tables.append(Table("Effective linear stiffness and damping", tuple(heads), tuple(rows)))
    return tables


def _recycled_tables(recycled: Mapping[str, Any]) -> list[Table]:
    """Partial pooling both ways, and the health of the weights by which the draws of single cases were used again."""
    if not recycled.get("ess"):
        return []
    tails = recycled.get("pareto_k") or {}
    single = recycled.get("ess_of_one_population") or {}
    rows = tuple(
        Row((case, f"{ess:.0f}", f"{single[case]:.0f}" if case in single else NOTHING, number(tails.get(case), 1.0)))
        for case, ess in recycled["ess"].items()
    )
    note = "Weights can be trusted where Pareto k is below 0.7 and no single population rests on a few draws."
    columns: tuple[str, ...] = ("case", "effective draws", "under one population", "Pareto k")
    tables = [Table("Draws of each case, used again by weights", columns, rows, note)]
    compared = [
        Row((name, *(_told(row[key][way]) for key in ("common", "scatter") for way in ("recycled", "direct"))))
        for name, row in (recycled.get("parameters") or {}).items()
    ]
    if compared:
        heights = [f"{number(recycled[key], 0.5)} ± {number(recycled[error], 0.5)}" for key, error in _HEIGHTS]
        note = f"Log evidence over separate cases: {heights[0]} by weights, {heights[1]} directly."
        columns = ("parameter", "common value, by weights", "directly", "scatter, by weights", "directly")
        tables.append(Table("Values scattered about a common mean, found in two ways", columns, tuple(compared), note))
    cases = [
        Row((f"{name} of case {case}", _told(ways["recycled"]), _told(ways["direct"])))
        for name, row in (recycled.get("parameters") or {}).items()
        for case, ways in row.get("cases", {}).items()
    ]
    if cases:
        tables.append(Table("Each case, found in two ways", ("parameter", "by weights", "directly"), tuple(cases)))
    return tables


_HEIGHTS = (("log_evidence_over_separate", "error"), ("direct_log_evidence_over_separate", "direct_error"))


def _told(row: Mapping[str, Any]) -> str:
    return f"{number(row['median'], row['hdi90'][1] - row['hdi90'][0])} ({interval(*row['hdi90'])})"


# A check on withheld causes -----------------------------------------------------------------------------------------

_SCORES = (
    ("accepted_first", "right or acceptable first answer"),
    ("right_first", "right effect first"),
    ("none_kept", "no gap claimed where there is none"),
    ("unknown_first", "'unknown' for a cause outside the library"),
    ("pairs_both_named", "both of two effects named"),
    ("site", "right site"),
    ("false_and_confident", "wrong name with more than 90 %"),
    ("coverage90", "90 % intervals that hold the true parameter"),
)


def withheld_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of withheld.json: sealed verdicts, and their scores once the key was opened."""
    scores = (data.get("scores") or {}).get("all") or {}
    count = len(data.get("campaigns") or ())
    rehearsal = bool(data.get("rehearsal"))
    sentences = [f"{counted(count, 'campaign')} judged, verdicts sealed; the key has not been opened."]
    rows = []
    for key, what in _SCORES:
        score = scores.get(key) or {}
        if not score.get("n"):
            continue
        low, high = (100.0 * x for x in score.get("interval95") or (float("nan"),) * 2)
        rows.append(Row((what, f"{score['hits']} of {score['n']}", f"{low:.0f} to {high:.0f} %")))
    if rows:
        told = {row.cells[0]: row.cells[1] for row in rows}
        first = next(iter(told.items()))
        sentences = [f"{first[0].capitalize()}: {first[1]} campaigns whose causes were withheld."]
        sentences += [f"{what.capitalize()}: {n}." for what, n in list(told.items())[1:4]]
    if rehearsal:
        sentences.insert(
            0, "A rehearsal: the causes could have been known. " + " ".join(data.get("why_rehearsal") or ())
        )
    table = Table("Scores", ("what", "how often", "95 % interval"), tuple(rows)) if rows else None
    rest = generic(data, "", ("schema", "provenance"))
    name = "Withheld causes"
    head = Headline(name, "bad" if rehearsal else "good" if rows else "open", tuple(sentences), table=table)
    section = Section(name, (), (), (), _pictures(folder, kind="withheld"), folded(rest))
    return Result(head, section, (), dict(data.get("provenance", {})))


# Results that this page knows only by their form --------------------------------------------------------------------


def other_result(kind: str, title: str, opening: str) -> Callable[[Mapping[str, Any], Path], Result]:
    """A reader of results that shows everything as tables."""

    def read(data: Mapping[str, Any], folder: Path) -> Result:
        rest = generic(data, title, ("schema", "provenance"))
        sentences = tuple(data.get("sentences", ())) or (opening,)
        scores = data.get("scores")
        table = generic({"scores": scores}, "").tables[:1] if scores else ()
        section = Section(title, (), rest.tables, (), _pictures(folder, kind=kind), rest.parts)
        return Result(
            Headline(title, "open", sentences, table=next(iter(table), None)),
            section,
            (),
            dict(data.get("provenance", {})),
        )

    return read


READERS: Mapping[str, tuple[str, Callable[[Mapping[str, Any], Path], Result]]] = {
    "diagnosis.json": ("bayes-damper/diagnosis/1", diagnosis_result),
    "summary.json": ("bayes-damper/fit/1", fit_result),
    "variability.json": ("bayes-damper/variability/1", variability_result),
    "tune.json": ("bayes-damper/tune/1", tune_result),
    "plan.json": ("bayes-damper/plan/1", plan_result),
    "withheld.json": ("bayes-damper/withheld/1", withheld_result),
    "comparison.json": ("bayes-damper/comparison/1", other_result("comparison", "Comparison", "Results side by side.")),
    "bench.json": (
        "bayes-damper/bench/1",
        other_result("bench", "Speed and accuracy", "Measured on the machine named below."),
    ),
}
"""File name -> (schema, reader), in the order in which they come on the page."""
