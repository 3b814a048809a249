"""The section of a plan: plan.json."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bayes_damper.effects.base import SITE_TITLES
from bayes_damper.report.parts import Headline, Result, Row, Section, Table, listed, words
from bayes_damper.report.sections.shared import fingerprint, meaning_of, pictures_of, records_table
from bayes_damper.runs.contents.plan import Addition, PlanFile
from bayes_damper.sampling.prior_sensitivity import decided_by
from bayes_damper.text import NOTHING, interval, number, percent, trial_words


def plan_result(data: PlanFile, folder: Path) -> Result:
    """Headline and section of plan.json."""
    columns: tuple[str, ...]
    cells: tuple[str, ...]
    rows = []
    for e in data["effects"]:
        rival, least = e.get("rival"), e.get("smallest") or {}
        name, nats = (rival["name"], rival["nats"]) if rival else (NOTHING, None)
        times = e.get("repeats_needed")
        cells = (
            f"{words(e['name'])}: {title}" if (title := e.get("title")) else words(e["name"]),
            SITE_TITLES.get(e["site"], e["site"]),
            percent(e["chance"]),
            "; ".join(f"{k} {number(v['value'])} {v['unit']}".strip() for k, v in least.items()) or NOTHING,
            words(name),
            number(nats, 10.0) if (nats or 0.0) < 100.0 else "above 100",
            "more than 100 times" if times is None else "as planned" if times == 1 else f"{times} times",
        )
        rows.append(Row(cells, "bad" if times is None else ""))
    columns = ("effect", "site", "seen", "smallest seen", "strongest rival", "nats over it", "trials needed")
    note = (
        "Seen: chance that the effect, if present at a plausible size, would be clearly visible. Trials needed: how "
        "many times the planned number it takes to see the effect and to distinguish it from every rival."
    )
    tables = [Table("What the planned trials could show", columns, tuple(rows), note)]
    parameters = []
    for name, p in data["parameters"].items():
        low, high = p["expected90"]
        who = decided_by(p["sd_over_prior"] ** 2)
        cells = (meaning_of(name, p["unit"]), interval(low, high), p["unit"], number(p["sd_over_prior"], 0.1), who)
        parameters.append(Row(cells, "prior" if who == "prior" else ""))
    columns = ("parameter", "expected 90 %", "unit", "sd / prior sd", "decided by")
    tables.append(Table("What they would say about each parameter", columns, tuple(parameters)))
    if data.get("add"):
        tables.append(records_table("Single trials that would help most", data["add"]))
    distinct = sum(e["repeats_needed"] == 1 for e in data["effects"])
    given = [_spelt_out(s, [e["name"] for e in data["effects"]]) for s in data["sentences"]]
    changes = [s for s in given if "times as many trials" in s] + _best_trial(data.get("add") or [])
    sentences = (
        f"{distinct} of {len(rows)} effects would be seen and distinguished from all others.",
        *(s for s in given if s not in changes),
    )
    name = str(data.get("campaign", ""))
    head = Headline(f"Plan of {name}" if name else "Plan", "open", sentences[:4], changes=tuple(changes))
    section = Section("Plan", sentences[4:], tuple(tables), (), pictures_of(folder, kind="plan"))
    return Result(head, section, (), fingerprint(data))


def _spelt_out(sentence: str, names: Sequence[str]) -> str:
    """A sentence with the names of effects as words."""
    for name in names:
        sentence = re.sub(rf"\b{re.escape(name)}\b", words(name), sentence)
    return sentence


def _best_trial(proposals: Sequence[Addition]) -> list[str]:
    """The single trial that would help most, in a sentence; nothing where none would."""
    if not proposals or not proposals[0].get("helps"):
        return []
    helps = listed([words(n) for n in proposals[0]["helps"]])
    return [f"One more {trial_words(proposals[0])}, would help most: to distinguish {helps}."]
