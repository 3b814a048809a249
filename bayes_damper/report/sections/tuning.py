"""The section of a tuning: tune.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_damper.report.charts import response_chart
from bayes_damper.report.parts import Headline, Result, Row, Section, Table, listed, words
from bayes_damper.report.sections.shared import fingerprint, meaning_of, pictures_of
from bayes_damper.rig.parameters import unit_of
from bayes_damper.rig.units import BODIES, CHOSEN, MOTION, design_in_words, in_words_of
from bayes_damper.text import NOTHING, SDS_WIDE, counted, gathered, number, percent

_PRESENT = "the rig as it is"
_Designs = Sequence[tuple[str, Mapping[str, Any], Mapping[str, Any]]]  # name, what was chosen, results


def tune_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of tune.json."""
    target = data["target_db"]
    kind = str(data.get("kind") or "torsional")
    translational = kind == "translational"
    effort, newton = ("force", "N") if translational else ("torque", "N m")
    own = "your design" if design_in_words(data.get("design", {})) else _PRESENT
    designs: list[tuple[str, Mapping[str, Any], Mapping[str, Any]]]
    designs = [(_PRESENT, {}, data["present"])] if data.get("present") else []
    designs.append((own, data.get("design", {}), data))
    best = data.get("optimum") or {}
    if best:
        designs.append(("best design", best["design"], best))
    better = [
        (f"better at {row['torque_amplitude_n_m']:g} {newton}", row["design"], {"nonlinear": [row]})
        for row in best.get("better_when_driven", ())
    ]
    converged = bool(data.get("converged", True))
    sentences = [] if converged else ["The fit that this rests on did not converge: do not use these numbers."]
    sentences += _loss_sentences(designs, target, kind)
    sentences += _driven_sentences(designs, best.get("better_when_driven", ()), newton, kind)
    sentences += data.get("notes", ())
    sentences += _friction_sentences(data.get("nonlinear", []), target, own, effort, newton)
    changes = []
    if data.get("hangs_most_on"):
        name = data["hangs_most_on"]
        share = data.get("variance_shares", {}).get(name)
        unit = unit_of(name, kind)
        what = f"{meaning_of(name, unit)} ({percent(share)} of its variance)"
        changes.append(f"The insertion loss depends most on {what}: measure that better.")
    if at_bound := (data.get("optimum") or {}).get("at_bound"):
        changes.append(f"The best design lies at the bound of {listed(at_bound)}: wider bounds may give more.")
    tables = [_loss_table([*designs, *better], target, kind, str(data.get("definition") or ""))]
    described = _design_table([*designs, *better], kind)
    tables += [described] if described.rows else []
    if data.get("variance_shares"):
        shares = tuple(Row((k, percent(v))) for k, v in data["variance_shares"].items())
        tables.append(
            Table("What the insertion loss depends on", ("parameter", "share of its variance"), shares, _SHARES)
        )
    chart = response_chart(data.get("frequency_response", {}), translational=translational)
    p = data["linear"]["probability_of_target"]
    head = Headline(
        f"Tuning, case {data.get('case', '')}", "bad" if p < 0.1 or not converged else "good" if p > 0.9 else "open",
        tuple(sentences), changes=tuple(changes),
    )  # fmt: skip
    warnings = () if converged else ("The tuning rests on a fit that did not converge: do not use its numbers.",)
    known = int(data.get("warnings_of_check") or 0)
    remarks = data.get("warnings", ())
    section = Section(
        "Tuning",
        (f"From {counted(int(data.get('draws') or 0), 'draw')} of the posterior.",),
        tuple(tables),
        () if chart is None else (chart,),
        tuple(
            replace(p, alt=in_words_of(p.alt, kind), note=in_words_of(p.note, kind))
            for p in pictures_of(folder, kind="tune")
        ),
    )
    about = fingerprint(data)
    return Result(head, section, (*warnings, *gathered(remarks[known:])), about, tuple(gathered(remarks[:known])))


_SHARES = (
    "What each parameter explains by itself. Parameters that the data tie together share what they explain: the shares "
    "then add up to more than 100 %."
)


def _loss_sentences(designs: _Designs, target: float, kind: str) -> list[str]:
    """What each design's insertion loss is in the linear model, and how probably it reaches the target."""
    sentences = []
    for name, chosen, found in designs:
        loss, p = found["linear"]["insertion_loss_db"], found["linear"]["probability_of_target"]
        what = design_in_words(chosen, kind)
        who = f"{name[0].upper() + name[1:]}{f' ({what})' if what else ''}, linear model"
        if loss["interval90"] is None:
            sentences.append(f"{who}: damping leaves no resonance, so no loss can be given.")
            continue
        low, high = loss["interval90"]
        sentences.append(
            f"{who}: insertion loss {number(loss['mean'], _wide(high - low, _DB))} dB (90 %: "
            f"{_interval(low, high, _DB)} dB); it reaches {target:g} dB with probability {percent(p)}."
        )
    return sentences


def _driven_sentences(designs: _Designs, better: Sequence[Mapping[str, Any]], newton: str, kind: str) -> list[str]:
    """What the best design of the linear model loses on the nonlinear rig, and where another design is better."""
    losses = {
        name: {row["torque_amplitude_n_m"]: _mean(row) for row in found.get("nonlinear", [])}
        for name, _, found in designs
    }
    sentences = []
    if best := losses.get("best design"):
        others = {name: found for name, found in losses.items() if name != "best design"}
        said = []
        for a, x in best.items():
            beside = {name: found[a] for name, found in others.items() if a in found}
            if any(loss is not None for loss in (x, *beside.values())):
                compared = ", ".join(f"{name}: {_decibels(loss)}" for name, loss in beside.items())
                said.append(f"{_decibels(x)} at {a:g} {newton} ({compared})")
        sentences += [f"On the nonlinear rig the best design gives {listed(said)}."] if said else []
    for row in better:
        what = design_in_words(row["design"], kind) or _PRESENT
        bound = f" (at the bound of {listed(row['at_bound'])})" if row["at_bound"] else ""
        at = f"{row['torque_amplitude_n_m']:g} {newton}"
        sentences.append(f"At {at} another design is better, {_decibels(_mean(row))}: {what}{bound}.")
    return sentences


def _mean(row: Mapping[str, Any]) -> float | None:
    mean: float | None = row["insertion_loss_db"]["mean"]
    return mean


def _decibels(loss: float | None) -> str:
    return "no resonance" if loss is None else f"{loss:.1f} dB"


def _friction_sentences(
    rows: Sequence[Mapping[str, Any]], target: float, own: str, effort: str, newton: str
) -> list[str]:
    """Where dry friction keeps the design from its target, and where it leaves no resonance."""
    sentences = []
    weak = [row for row in rows if row["probability_of_target"] < 0.5]
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
    return sentences


def _loss_table(designs: _Designs, target: float, kind: str, definition: str) -> Table:
    effort, newton = ("force", "N") if kind == "translational" else ("torque", "N m")
    first, second = BODIES[kind]
    rows = []
    for name, _, found in designs:
        rows += [_performance_row(f"{name}, linear", found["linear"], kind)] if "linear" in found else []
        rows += [
            _performance_row(f"{name}, {effort} {r['torque_amplitude_n_m']:g} {newton}", r, kind)
            for r in found.get("nonlinear", [])
        ]
    columns = (
        "design and model",
        "loss, mean [dB]",
        "loss, 90 % [dB]",
        "resonance (90 %) [Hz]",
        "shift (90 %) [Hz]",
        f"P(loss ≥ {target:g} dB)",
        f"{first} moves (without {second}) [{MOTION[kind][1]}]",
    )
    note = f"{definition}." if definition else ""
    if any(row.cells[1] == NOTHING for row in rows):
        note += (
            f" {NOTHING}: at that {effort} the rig sticks or no steady response was found, so there is no loss to give."
        )
    return Table("Insertion loss and resonance", columns, tuple(rows), note.strip())


def _performance_row(name: str, p: Mapping[str, Any], kind: str) -> Row:
    loss = p["insertion_loss_db"]
    low, high = loss["interval90"] or (None, None)
    cells = (
        name, number(loss["mean"], None if low is None else _wide(high - low, _DB)), _interval(low, high, _DB),
        *(_shown_or_nothing(p[key]) for key in ("resonance_hz", "resonance_shift_hz")),
        NOTHING if low is None else percent(p["probability_of_target"]), _motion(p, kind),
    )  # fmt: skip
    return Row(cells)


def _motion(p: Mapping[str, Any], kind: str) -> str:
    """Medians of how far the primary moves at its resonance, with and without the secondary."""
    moves, without = ((p.get(key) or {}).get("median") for key in ("displacement", "displacement_without"))
    if moves is None or without is None:
        return NOTHING
    factor, _ = MOTION[kind]
    return f"{factor * moves:.3g} ({factor * without:.3g})"


def _shown_or_nothing(found: Mapping[str, Any]) -> str:
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
    units = {key: unit_of(name, kind) for key, name in CHOSEN.items()}
    rows = tuple(
        Row(
            (
                in_words_of(words(key), kind),
                unit,
                *("as it is" if d.get(key) is None else number(d[key]) for _, d, _ in designs),
            )
        )
        for key, unit in units.items()
        if any(d.get(key) not in (None, 0.0) for _, d, _ in designs)
    )
    return Table("Designs", ("quantity", "unit", *(name for name, _, _ in designs)), rows)
