"""The section of a fit: summary.json."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from bayes_damper.report.charts import record_chart
from bayes_damper.report.parts import Headline, Result, Row, Section, Table, generic, listed, words
from bayes_damper.report.sections.shared import (
    UNCONVERGED,
    fingerprint,
    meaning_in,
    meaning_of,
    pictures_of,
    titled,
)
from bayes_damper.rig.parameters import OF_EFFECT, PARAMETERS
from bayes_damper.rig.units import in_words_of, kind_by, plain_meaning
from bayes_damper.runs.contents.fit import CaseEntry, CheckEntry, FitFile, ParameterEntry, PriorEntry, TrialUnknown
from bayes_damper.runs.json_files import folder_name
from bayes_damper.sampling.prior_sensitivity import decided_by
from bayes_damper.text import NOTHING, counted, effect_of, gathered, interval, number, plus_minus, two_digits

_OUTSIDE = 5.0  # per cent: a measurement below this percentile, or as far above, counts as outside
_MAIN = (
    "mu", "friction_torque", "friction_torque_per_inertia", "k2t", "c2t", "drag", "nu", "tail", "c1t", "c3t",
    "k1t", "J1", "J2",
)  # fmt: skip
_SPELT_OUT = 7  # parameters in a sentence; of more, the names alone
_SPELT_FIRST = 4  # the same in the first sentence
_MEASURABLE = ("J1", "J2", "R", "r", "N0", "k1t", "k2t", "theta0", "drag", "mu")
_INTERVALS = (
    "A parameter lies in its 90 % interval with a probability of 90 %, given the model, the data and the prior. "
    "“Decided "
    "by prior” means that the measurements say nothing about that parameter: its interval is the one assumed "
    "beforehand."
)


def _decided(p: ParameterEntry | None) -> str:
    """Who decided about a parameter of summary.json, in the words of the tables."""
    share = p.get("prior_share") if p else None
    return "derived" if share is None else decided_by(share)


def fit_result(summary: FitFile, folder: Path) -> Result:
    """Headline and section of summary.json."""
    cases = dict(summary.get("cases", {}))
    groups = cases | ({"all cases together": summary["joint"]} if summary.get("joint") else {})
    converged = bool(summary.get("converged"))
    failed = [name for name, entry in groups.items() if not entry.get("converged")]
    warnings = [f"{_title(name)} did not converge: do not use its numbers." for name in failed]
    sections = []
    pictures = pictures_of(folder)
    shown = {Path(p.path).name for p in pictures} & {"predictive"}  # of all cases: what each would show once more
    for name, entry in groups.items():
        place = folder / ("joint" if name == "all cases together" else folder_name(name))
        sections.append(_case_section(name, entry, place, shown if len(groups) > 1 else set()))
    section = Section("Fit", (_INTERVALS,), pictures=pictures, parts=tuple(sections))
    head = _fit_headline(str(summary.get("campaign", "")), groups, converged)
    about = fingerprint(summary)
    return Result(head, section, tuple(warnings), about, tuple(gathered(summary.get("warnings", ()))))


def _title(name: str) -> str:
    return name[0].upper() + name[1:] if name.startswith("all") else f"Case {name}"


def _fit_headline(campaign: str, groups: Mapping[str, CaseEntry], converged: bool) -> Headline:
    sentences, changes = [], []
    if not converged:
        failed = [_title(n) for n, e in groups.items() if not e.get("converged")]
        sentences.append(
            f"{listed(failed)} did not converge: the run was too short to trust. Do not use these numbers."
        )
        longer = {s for e in groups.values() for s in e.get("sentences", ()) if s.startswith("Continue for about")}
        advice = f" {longer.pop()}" if len(longer) == 1 else ""
        changes.append(
            f"Run more steps: bayes-damper resume FOLDER --more.{advice} Below, each case lists what fell short."
        )
        title = f"Fit of {campaign}" if campaign else "Fit"
        return Headline(title, "bad", tuple(sentences), changes=tuple(changes), table=_overview(groups))
    missed = _missed(groups)
    sentences += [missed, f"If the model were right: {_determined(groups)}"] if missed else [_determined(groups)]
    sentences.append("All runs converged." if len(groups) > 1 else "The run converged.")
    checks = [row for entry in groups.values() for row in entry.get("predictive", [])]
    outside = [row for row in checks if _is_outside(row)]
    tone = "good"
    if checks:
        few = {0: "None", len(checks): "All"}.get(len(outside), str(len(outside)))
        sentences.append(
            f"{few} of {counted(len(checks), 'measurement')} {'lies' if len(outside) < 2 else 'lie'} outside the "
            f"central 90 % of the prediction; about {0.1 * len(checks):.0f} are expected to by chance."
        )
        if outside and len(outside) > max(1.0, 0.2 * len(checks)):
            tone = "open"
            worst = ", ".join(words(str(row["name"])) for row in outside[:3])
            sentences.append(f"The model cannot reproduce all of the data, whatever its parameters: {worst}.")
            changes.append("A diagnosis of recorded trials would show what the model misses.")
    if missed:
        tone = "open"
        changes.append(
            "Look at the figure of the records for where the rest is."
            if any(map(effect_of, groups.values()))
            else "`bayes-damper diagnose` looks for what the model misses."
        )
    elif noise := _left(groups, ("repeats", "fast content")):
        sentences.append(f"The residuals are about as large as the noise: at worst, {noise}.")
    by_prior: dict[str, int] = {}
    for entry in groups.values():
        for name, p in entry.get("parameters", {}).items():
            if _decided(p) == "prior":
                by_prior.setdefault(name, 0)
                by_prior[name] += 1
    everywhere = [name for name, count in by_prior.items() if count == len(groups)]
    if everywhere:
        units = {name: _unit_in(groups.values(), name) for name in everywhere}
        repeat = "its number repeats" if len(everywhere) == 1 else "their numbers repeat"
        sentences.append(
            f"The data say nothing about {_in_words(everywhere, units=units)}: {repeat} the prior, which was assumed "
            "before the data."
        )
        able = [name for name in everywhere if name in _MEASURABLE]
        if able:
            changes.append(f"Measure {listed(able)} directly to replace an assumption by a fact.")
    if not changes:
        changes.append("All numbers assume that the model is right; `bayes-damper diagnose` tests that.")
    title = f"Fit of {campaign}" if campaign else "Fit"
    return Headline(title, tone, tuple(sentences), changes=tuple(changes), table=_overview(groups))


def _determined(groups: Mapping[str, CaseEntry]) -> str:
    """Which parameters the data decide about, and in which cases, in a sentence."""
    where: dict[tuple[str, ...], list[str]] = {}
    added = dict.fromkeys(n for e in groups.values() for n in e.get("parameters", {}) if n.startswith(OF_EFFECT))
    for name in (*added, *_MAIN):
        found = [g for g, e in groups.items() if _decided(e.get("parameters", {}).get(name)) == "data"]
        if found:
            where.setdefault(tuple(found), []).append(name)
    if not where:
        return "The data alone determine no parameter: each interval also depends on the prior."
    parts = []
    for places, names in sorted(where.items(), key=lambda item: -len(item[0])):
        fits = listed([place if place.startswith("all") else f"case {place}" for place in places])
        everywhere = len(places) == len(groups)
        known = {name: _precision(name, [groups[place] for place in places]) for name in names}
        units = {name: groups[places[0]]["parameters"][name].get("unit", "") for name in names}
        known_best = _in_words(names, known, _SPELT_FIRST, units)
        parts.append(known_best + ("" if len(groups) == 1 else " in every case" if everywhere else f" in {fits}"))
    return f"Determined by the data: {'; '.join(parts)}."


def _precision(name: str, entries: Sequence[CaseEntry]) -> str:
    """How well a parameter is known: half its 90 % interval over its median, the worst of these cases; "" if none."""
    halves = []
    for entry in entries:
        p = entry["parameters"][name]
        low, high = p["hdi90"]
        halves.append(0.5 * (high - low) / abs(p["median"]) if p["median"] else math.inf)
    worst = max(halves)
    return f"±{two_digits(100.0 * worst)} %" if worst < 1.0 else ""


def _in_words(
    names: Sequence[str], more: Mapping[str, str] = MappingProxyType({}), most: int = _SPELT_OUT,
    units: Mapping[str, str] = MappingProxyType({}),
) -> str:  # fmt: skip
    """Parameters in a sentence, each with what it is, unless they are more than `most`; `more` stands behind each."""
    spelt = []
    for name in names:
        meant = plain_meaning(name, units.get(name, "")) if len(names) <= most else ""
        beside = more.get(name, "")
        if not meant:
            own = name.removeprefix(OF_EFFECT)
            spelt.append(f"{own} ({beside})" if beside else own)
        else:
            spelt.append(f"the {meant} ({name}{', ' if beside else ''}{beside})")
    return listed(spelt)


def _unit_in(entries: Iterable[CaseEntry], name: str) -> str:
    """The unit of a parameter in the first of these entries that has it."""
    found = (e["parameters"][name].get("unit", "") for e in entries if name in e.get("parameters", {}))
    return str(next(found, ""))


def _missed(groups: Mapping[str, CaseEntry]) -> str:
    """The channel of which the fit leaves most beyond the noise, in a sentence; nothing where it leaves noise alone."""
    left = _left(groups, ("residuals",))
    if not left:
        return ""
    beside = next((f" beside {titled(e)}" for entry in groups.values() if (e := effect_of(entry))), "")
    slow = "" if "repeats differ" in left else ", or the noise is slow"
    follows = "" if beside else " Run `bayes-damper diagnose`, and fit again with the effect that it names."
    outside = "The true values may lie outside the intervals below."
    return f"The model misses something{beside}{slow}: {left}. {outside}{follows}"


def _left(groups: Mapping[str, CaseEntry], learnt_from: Collection[str]) -> str:
    """What the fit leaves of the channel where it is most against the noise, of those whose noise was learnt so."""
    rows = [
        (name, c)
        for name, entry in groups.items()
        for c in (entry.get("noise") or {}).get("channels", ())
        if c.get("learnt_from") in learnt_from and c.get("left_over_floor")
    ]
    if not rows:
        return ""
    name, worst = max(rows, key=lambda row: row[1]["left_over_floor"] or 0.0)
    floor = worst.get("repeats") or worst.get("fast_content")
    source = "repeats differ by" if worst.get("repeats") else "the fast content of the readings is"
    return (
        f"in {_title(name)[0].lower() + _title(name)[1:]}, channel {worst['channel']}, the residual is "
        f"{worst['left']:.2g} {worst['unit']}, and {source} {floor:.2g}"
    )


def _overview(groups: Mapping[str, CaseEntry]) -> Table:
    found = dict.fromkeys(n for e in groups.values() for n in e.get("parameters", {}))
    names = [n for n in found if n.startswith(OF_EFFECT)] + [n for n in _MAIN if n in found]
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
        best = next((e.get("best_fit") for e in groups.values()), None)
        who = str((best.get("effect") if best else None) or "")
        meant = (best.get("meanings") if best else None) or {}
        rows.append(Row((_shown_name(name, unit, who, meant.get(name, "")), unit, *cells)))
    heads = [
        (name if name.startswith("all") else f"case {name}")
        + (": median\n(90 %)" if entry.get("converged") else ": median\n(90 %) NOT CONVERGED")
        for name, entry in groups.items()
    ]
    columns = ("parameter", "unit", *heads)
    starred = any("*" in cell for row in rows for cell in row.cells[2:])
    note = "* decided by the prior, not by the data" if starred else ""
    return Table("Median and 90 % interval", columns, tuple(rows), note)


def _shown_name(name: str, unit: str, effect: str = "", meant: str = "") -> str:
    """A parameter for the first column of a table: its name, and below what it is.

    effect : given to the model; meant : what its parameter is, where the fit says so.
    """
    if name.startswith(OF_EFFECT):
        own = name.removeprefix(OF_EFFECT)
        meaning = meant or meaning_in(effect, own)
        title = titled(own.partition(".")[0] if "+" in effect else effect)
        return f"{own}\n{title}{f': {meaning}' if meaning else ''}"
    known = PARAMETERS.get(name.partition("[")[0])
    if known is None:
        return name
    formula = f" = {known.symbol}" if " " in known.symbol else ""
    return f"{name}{formula}\n{plain_meaning(name, unit)}"


def _is_outside(row: CheckEntry) -> bool:
    return not _OUTSIDE <= float(row["percentile"]) <= 100.0 - _OUTSIDE


def _case_section(name: str, entry: CaseEntry, folder: Path, shown: Collection[str] = ()) -> Section:
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
        cells = (
            _named(key, entry),
            number(p["median"], width),
            number(low, width),
            number(high, width),
            p["unit"],
            who,
        )
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
        tables.append(_trial_table(name, entry["trials"], kind_by(_unit_in([entry], "c1t"))))
    tables += _more_tables(name, entry)
    sentences = tuple(entry.get("sentences", ()))
    evidence = entry.get("log_evidence")
    if evidence:
        error = max(evidence["error"], 0.01)
        sentences += (f"Log evidence {plus_minus(evidence['value'], error)} nats, to compare models of these records.",)
    if not good:
        sentences = (UNCONVERGED, *sentences)
    file = folder / "posterior.nc"
    unit = _unit_in([entry], "sigma1")
    chart = record_chart(file, unit) if file.is_file() else None
    charts = () if chart is None else (chart,)
    pictures = [p for p in pictures_of(folder, _title(name)) if Path(p.path).name not in shown]
    traces = tuple(p for p in pictures if Path(p.path).name == "trace")
    parts = (Section("Health of the run", pictures=traces, folded=True),) if traces else ()
    return Section(_title(name), sentences, tuple(tables), charts, tuple(p for p in pictures if p not in traces), parts)


def _more_tables(name: str, entry: CaseEntry) -> list[Table]:
    """What a fit gives beside its parameters, as far as it is there: noise, odd trials, priors, the best fit."""
    tables: list[Table] = []
    columns: tuple[str, ...]
    apart = entry.get("unlike_repeats")
    if apart and apart.get("trials"):
        rows = tuple(Row((str(t["trial"]), f"{number(t['residual_power'])} times"), "bad") for t in apart["trials"])
        columns = ("trial", "power of its residuals, against its repeats")
        tables.append(Table(f"{_title(name)}: trials unlike their repeats", columns, rows))
    if apart and (answers := apart.get("answers")):
        rows = tuple(
            Row(
                (
                    _named(n, entry),
                    number(p["with"]["value"]),
                    number(p["without"]["value"]),
                    f"{p['shift_sd']:+.1f} sd",
                )
            )
            for n, p in answers.items()
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
        tables.append(_sensitivity_table(f"{_title(name)}: how the answers depend on the priors",
                                         entry["prior_sensitivity"], entry))  # fmt: skip
    for key in ("noise", "best_fit"):
        if isinstance(entry.get(key), Mapping):
            tables += generic({words(key): entry[key]}, "").tables
    return tables


def _sensitivity_table(caption: str, rows: Mapping[str, PriorEntry], entry: CaseEntry) -> Table:
    """Shifts when one prior is half or twice as wide."""
    out = []
    for name, p in rows.items():
        half, double = p["half"], p["double"]
        cells = [_named(name, entry)]
        for found in (half, double):
            cells.append(f"{found['shift']:+.2f}" + ("" if found["reliable"] else " ?"))
        most = max((half, double), key=lambda found: abs(found["shift_of_that"]))
        cells.append(f"{most['moves_most']} {most['shift_of_that']:+.2f}")
        out.append(Row(tuple(cells)))
    columns = ("parameter", "its prior half as wide", "twice as wide", "moves most among the others")
    note = (
        "How far the mean moves, in standard deviations. ?: the draws are too few for a sure figure; fit with that "
        "prior to know."
    )
    return Table(caption, columns, tuple(out), note)


def _check_table(name: str, checks: Sequence[CheckEntry]) -> Table:
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


def _named(name: str, entry: CaseEntry) -> str:
    """A parameter of an entry with what it means, one of the effect's too."""
    if not name.startswith(OF_EFFECT):
        return meaning_of(name, _unit_in([entry], name))
    own = name.removeprefix(OF_EFFECT)
    meaning = meaning_in(effect_of(entry), own)
    return f"{own}: {meaning}" if meaning else own


def _trial_table(name: str, trials: Mapping[str, Mapping[str, TrialUnknown]], kind: str) -> Table:
    rows = []
    for label, nuisances in trials.items():
        for key, p in nuisances.items():
            middle, (low, high), unit = p["mean"], p["hdi90"], p["unit"]
            what = in_words_of(meaning_of(key, unit), kind)
            if key.startswith("ln_"):  # readers think in factors
                middle, low, high, unit = math.exp(middle), math.exp(low), math.exp(high), "1"
                what = f"{key.removeprefix('ln_')} of this trial over that of all"
            rows.append(Row((label, what, number(middle, high - low), interval(low, high), unit)))
    columns = ("trial", "unknown", "mean", "90 %", "unit")
    return Table(f"{_title(name)}: unknowns of each trial", columns, tuple(rows))
