"""The section of diagnoses of several campaigns: fleet.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bayes_damper.report.parts import Headline, Result, Row, Section, Table, words
from bayes_damper.text import NOTHING, counted, percent


def fleet_result(data: Mapping[str, Any], folder: Path) -> Result:
    """Headline and section of fleet.json; the names of campaigns lead to their own pages in `folder`."""
    rows = []
    for row in data["campaigns"]:
        name = str(row["name"])
        answer, sure = words(row["verdict"]), row["probability"]
        rest = [words(a) for a in row["credible_set"] if a != row["verdict"]]
        cells = (name, answer, percent(sure), ", ".join(rest) or NOTHING, row["gap"], row["site"],
                 NOTHING if row["closed"] is None else percent(row["closed"]), str(row["warnings"]))  # fmt: skip
        page = f"{quote(name)}/report.html" if (folder / name / "report.html").is_file() else ""
        rows.append(Row(cells, "bad" if row["verdict"] != "none" and sure >= 0.9 else "", page))
    columns = ("campaign", "answer", "probability", "or else", "gap", "site", "closed", "warnings")
    note = (
        "Or else: the other answers that 90 % probability leaves. Closed: share of the gap on held-out trials that the "
        "named effect closes. Marked rows are those in which something is missing with 90 % probability or more."
    )
    table = Table("Campaigns", columns, tuple(rows), note)
    head = Headline(f"Diagnoses of {counted(len(rows), 'campaign')}", "open", tuple(data["sentences"]))
    return Result(head, Section("Campaigns", tables=(table,)), (), dict(data.get("provenance", {})))
