"""The section on what the cases share: variability.json."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from bayes_damper.report.parts import Headline, Result, Row, Section, Table, folded, generic, listed, words
from bayes_damper.report.sections.shared import UNCONVERGED, fingerprint, pictures_of
from bayes_damper.rig.parameters import unit_of
from bayes_damper.runs.contents.variability import LINEAR_NAMES, AgreementEntry, Interval, VariabilityFile
from bayes_damper.text import NOTHING, gathered, interval, number, percent, plus_minus

_SHARING = {
    "shared": "one parameter set for all cases",
    "separate": "each case its own parameter set",
    "partial": "values scattered about a common mean",
}
_SURE = 0.9
_METHOD = re.compile(r"\bnats\b|\b[Pp]articles\b|\bdraws\b|\bMonte Carlo\b")
"""Sentences on how the answer was computed: they stand below it."""


def _answer(shown: Sequence[tuple[str, float]]) -> str:
    """What the cases share, in a sentence: the most probable answer, with every other that is not ruled out."""
    first, p = shown[0]
    if p >= _SURE:
        return f"{first[0].upper() + first[1:]} ({percent(p)})."
    return f"Not settled: {listed([f'{what} ({percent(q)})' for what, q in shown if q >= _OPEN], 'or')}."


_OPEN = 0.1  # an answer with less is as good as ruled out


def variability_result(data: VariabilityFile, folder: Path) -> Result:
    """Headline and section of variability.json."""
    models = sorted(data["models"].items(), key=lambda item: -item[1]["probability"])
    converged = bool(data.get("converged"))
    shown = tuple((_SHARING.get(name, name), float(m["probability"])) for name, m in models)
    method = [s for s in data.get("sentences", ()) if _METHOD.search(s)]
    sentences = [] if converged else [UNCONVERGED]
    sentences.append(_answer(shown))
    sentences += [s for s in data.get("sentences", ()) if s not in method]
    changes: list[str] = []
    if shown[0][1] < _SURE:
        changes.append("More data of each case, recorded trials with repeats best of all.")
    changes += data.get("would_settle", ())
    if any("raise particles" in s for s in method):
        changes.append("Sharper probabilities from the same data: more --particles and --repeats (see below why).")
    rows = []
    for name, m in models:
        score = m["heldout"]["log_score"] if m.get("heldout") else None
        cells = (_SHARING.get(name, name), percent(m["probability"]), plus_minus(m["log_evidence"], m.get("error")))
        rows.append(Row((*cells, number(score, 1.0)), "" if converged else "bad"))
    columns = ("answer", "probability", "log evidence, nats", "log score on unseen data, nats")
    compared = Table("Do the cases share their parameters?", columns, tuple(rows))
    tone = "bad" if not converged else "good" if shown[0][1] >= _SURE else "open"
    name = str(data.get("campaign", ""))
    head = Headline(
        f"What the cases of {name} share" if name else "What the cases share", tone, tuple(sentences), shown,
        tuple(changes), table=_averaged_table(data) if "averaged" in data else None,
    )  # fmt: skip
    rest = generic(
        data, "", ("schema", "campaign", "campaign_sha256", "seed", "converged", "sentences", "provenance", "models",
                   "effective", "decomposition", "recycled", "method", "kind", "method_of_effective", "cases", "pooled",
                   "common", "warnings", "warnings_of_check", "averaged", "assumptions", "survives", "would_settle"),
    )  # fmt: skip
    pictures = pictures_of(folder, kind="variability")
    notes = (*method, *(str(data[key]) for key in ("method", "method_of_effective") if data.get(key)))
    tables = (
        compared,
        *_assumption_tables(data),
        *_decomposition_tables(data),
        *_recycled_tables(data.get("recycled")),
    )
    section = Section("Variability", notes, tables, (), pictures, folded(rest))
    warnings = () if converged else ("The comparison of the cases did not converge: do not use its numbers.",)
    about = fingerprint(data)
    return Result(head, section, warnings, about, tuple(gathered(data.get("warnings", ()))))


_SHOWN = ("mu", "friction_torque", "k2t", "c2t", "drag", "nu", "c1t", "k1t", "k1t_per_inertia")


def _averaged_table(data: VariabilityFile) -> Table:
    """Each case's parameters under the average of the three answers."""
    cases, kind = data["averaged"]["cases"], str(data.get("kind", "torsional"))
    further = data["averaged"]["further"]
    rows = []
    for name in _SHOWN:
        of_cases = [row[name] for row in cases.values() if name in row]
        if of_cases:
            one_more = _shown(further[name]) if name in further else NOTHING
            rows.append(
                Row((name.replace("_per_inertia", " / J1"), _unit(name, kind), *map(_shown, of_cases), one_more))
            )
    columns = ("parameter", "unit", *(f"case {case}" for case in cases), "one more case")
    note = "Median and 90 % interval of one set, scattered and separate cases, each as often as it is probable."
    return Table("The answer: each case, averaged over what the cases may share", columns, tuple(rows), note)


def _unit(name: str, kind: str) -> str:
    return "1/s²" if name == "k1t_per_inertia" else unit_of(name, kind)


def _assumption_tables(data: VariabilityFile) -> list[Table]:
    """How the answer moves with its assumptions."""
    rows = []
    for row in data.get("assumptions", ()):
        p, unsure = row["probabilities"], row["probability_errors"]
        chances = [f"{p[key]:.2f} ± {unsure[key]:.2f}" for key in ("shared", "partial", "separate")]
        ranges = [_range(row["averaged"]["cases"], name) for name in ("mu", "k2t", "c2t", "drag", "nu")]
        rows.append(Row((row["change"], *chances, *ranges)))
    if not rows:
        return []
    columns = ("assumptions", "one set", "scattered", "separate", "mu", "k2t", "c2t", "drag", "nu")
    note = "Probabilities with the error of the computation; medians, from the lowest to the highest of the cases."
    return [Table("How the answer moves with its assumptions", columns, tuple(rows), note)]


def _range(cases: Mapping[str, Mapping[str, Interval]], name: str) -> str:
    medians = [row[name]["median"] for row in cases.values()]
    low, high = f"{min(medians):.2g}", f"{max(medians):.2g}"
    return low if low == high else f"{low} to {high}"


_MEDIANS = "In every draw the shares add up to 100 %; their medians, each taken by itself, need not."


def _decomposition_tables(data: VariabilityFile) -> list[Table]:
    """Where the scatter of the effective values comes from, and those values case by case."""
    tables = []
    for name, parts in (data.get("decomposition") or {}).items():
        rows = []
        for key, row in parts.items():
            if not isinstance(row, Mapping) or "median" not in row:
                continue
            share = row.get("share")
            explained = NOTHING
            if share:
                low, high = share["hdi90"]
                explained = f"{100.0 * share['median']:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f} %)"
            width = row["hdi90"][1] - row["hdi90"][0]
            cells = (words(key), number(row["median"], width), interval(*row["hdi90"]), explained)
            rows.append(Row(cells))
        columns = ("part", f"variance of ln {name}", "90 %", "share (90 %)")
        caption = f"Where the scatter of the effective {name} over the cases comes from"
        tables.append(Table(caption, columns, tuple(rows), _MEDIANS))
    effective = data.get("effective")
    if effective and (cases := effective["cases"]):
        rows = []
        for case, row in cases.items():
            line = [case, number(1e3 * row["energy_j"])]
            for name in LINEAR_NAMES:
                line.append(_shown(row[name]))
                line.append(number((row.get("measured") or {}).get(name)))
            rows.append(Row(tuple(line)))
        heads = ["case", "initial energy [mJ]"]
        for name in LINEAR_NAMES:
            unit = unit_of(name, str(data.get("kind", "torsional")))
            heads += [f"effective {name} (90 %) [{unit}]", f"fitted to the measurement [{unit}]"]
        tables.append(Table("Effective linear stiffness and damping", tuple(heads), tuple(rows)))
    return tables


def _recycled_tables(recycled: AgreementEntry | None) -> list[Table]:
    """Partial pooling both ways, and the health of the weights by which the draws of single cases were used again."""
    if not recycled or not recycled.get("ess"):
        return []
    tails = recycled.get("pareto_k") or {}
    single = recycled.get("ess_of_one_population") or {}
    rows = tuple(
        Row((case, f"{ess:.0f}", f"{single[case]:.0f}" if case in single else NOTHING, number(tails.get(case), 1.0)))
        for case, ess in recycled["ess"].items()
    )
    note = "Weights can be trusted where Pareto k is below 0.7 and no single population rests on a few draws."
    if recycled.get("drawn_again"):
        note += " The fit's draws were too few: they were moved on towards the populations by new simulations."
    columns: tuple[str, ...] = ("case", "effective draws", "under one population", "Pareto k")
    tables = [Table("Draws of each case, used again by weights", columns, rows, note)]
    compared = [
        Row((name, *(_shown(row[key][way]) for key in ("common", "scatter") for way in ("recycled", "direct"))))
        for name, row in (recycled.get("parameters") or {}).items()
    ]
    if compared:
        heights = (
            (recycled["log_evidence_over_separate"], recycled["error"]),
            (recycled["direct_log_evidence_over_separate"], recycled["direct_error"]),
        )
        by_weights, directly = (" ± ".join(number(x, 0.5) for x in pair) for pair in heights)
        note = f"Log evidence over separate cases: {by_weights} by weights, {directly} directly."
        columns = ("parameter", "common value, by weights", "directly", "scatter, by weights", "directly")
        tables.append(Table("Values scattered about a common mean, found in two ways", columns, tuple(compared), note))
    cases = [
        Row((f"{name} of case {case}", _shown(ways["recycled"]), _shown(ways["direct"])))
        for name, row in (recycled.get("parameters") or {}).items()
        for case, ways in row.get("cases", {}).items()
    ]
    if cases:
        tables.append(Table("Each case, found in two ways", ("parameter", "by weights", "directly"), tuple(cases)))
    return tables


def _shown(row: Interval) -> str:
    return f"{number(row['median'], row['hdi90'][1] - row['hdi90'][0])} ({interval(*row['hdi90'])})"
