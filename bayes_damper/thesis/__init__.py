"""The thesis recomputed: Tables 1-12 and Figures 2, 6, 8, 10-13 from its own equations and constants.

`recompute()` sets every printed number beside the computed one, with a verdict, and reports where the thesis
contradicts itself: with the evidence, with the parameter value that the printed number would need, and with what speaks
for or against that value. Nothing is tuned to make numbers meet. Source: A. S. Augustine, Development of a Magnetically
Coupled Mass Damper, The Ohio State University, 2013; tables and pages as printed there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_damper import figures as drawing
from bayes_damper.errors import ExitCode
from bayes_damper.runs.json_files import plain, write_json, write_text
from bayes_damper.runs.provenance import provenance
from bayes_damper.text import Printable, counted
from bayes_damper.thesis.contradictions import Contradiction, Needed, contradictions
from bayes_damper.thesis.figures import Figure, figures
from bayes_damper.thesis.printed import CASES, printed_case
from bayes_damper.thesis.rig import effective_coupling, linear_rig, nonlinear_rig, secondary_inertia
from bayes_damper.thesis.tables import table

__all__ = [
    "CASES", "Contradiction", "Figure", "Needed", "Recomputation", "effective_coupling", "linear_rig",
    "nonlinear_rig", "printed_case", "recompute", "secondary_inertia",
]  # fmt: skip

SCHEMA = "bayes-damper/thesis/1"


@dataclass(frozen=True)
class Recomputation(Printable):
    """Everything recomputed.

    table : where, page, quantity, unit, printed, computed, low, high, difference, verdict, explanation; low and high
    span what the rounding of the printed inputs allows. folder : where thesis.csv, thesis.json and the figures are.
    """

    table: pd.DataFrame
    contradictions: tuple[Contradiction, ...]
    figures: Mapping[str, Figure]
    folder: Path | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> dict[str, Any]:
        """The content of thesis.json."""
        return {
            "schema": SCHEMA,
            "verdicts": self._counts(),
            "table": plain(self.table.to_dict("records")),
            "contradictions": [asdict(c) for c in self.contradictions],
            "provenance": dict(self.provenance),
        }

    def _counts(self) -> dict[str, int]:
        return {str(verdict): int(n) for verdict, n in self.table["verdict"].value_counts().items()}

    def text(self) -> str:
        """The counts of the verdicts, what contradicts, and each contradiction with what it would need."""
        lines = [f"{counted(len(self.table), 'printed number')} and statements of the thesis, recomputed:"]
        lines += [f"  {n:4d}  {verdict}" for verdict, n in self._counts().items()]
        lines += ["", "Contradictions, with the value that the printed number would need:"]
        for c in self.contradictions:
            pages = ", ".join(map(str, c.pages))
            lines += [f"- {c.name} (p. {pages}): {c.statement}", f"    {c.evidence}"]
            lines += [f"    needs {needed_in_words(n)}" for n in c.needed]
        if self.folder is not None:
            lines.append(f"Files: {self.folder}")
        return "\n".join(lines)

    def markdown(self) -> str:
        """A page with the whole table and every contradiction: what thesis.md holds."""
        counts = ", ".join(f"{n} {verdict}" for verdict, n in self._counts().items())
        lines = [
            "# The thesis recomputed",
            "",
            "Every printed number of Tables 1 to 12, of the figures and of the text that follows from others, beside",
            "what the thesis's own equations and constants give. Verdicts: *agrees* to the last printed digit;",
            "*rounding*: inside what rounded inputs allow; *contradiction*: outside; or *not determined by what is",
            f"printed*. Of {len(self.table)}: {counts}.",
            "",
            "| where | p. | quantity | unit | printed | computed | difference | verdict | from what |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        ordered = self.table.sort_values("page", kind="stable")
        for row in ordered.to_dict("records"):
            shown = (row["where"], row["page"], row["quantity"], row["unit"], row["printed"], _digits(row["computed"]),
                     _digits(row["difference"], 2), row["verdict"], row["explanation"])  # fmt: skip
            lines.append("| " + " | ".join(str(x).replace("|", "\\|") for x in shown) + " |")
        lines += ["", "## Where it contradicts itself or leaves a gap", ""]
        lines.append(
            "With the evidence, and with what a printed number would need. Nothing is tuned to make numbers meet."
        )
        for c in self.contradictions:
            lines += ["", f"### {c.name[0].upper()}{c.name[1:]} (p. {', '.join(map(str, c.pages))})", ""]
            lines += [c.statement, "", c.evidence]
            lines += [("" if k else "\n") + f"- {needed_in_words(n)}" for k, n in enumerate(c.needed)]
        lines += ["", "## Figures", "", "Curves that were measured were not published, and are left out.", ""]
        lines += ["![Figures 2, 6, 8 and 10 to 13 recomputed, with the printed peaks](thesis_figures.svg)", ""]
        lines += [f"- {name} (p. {f.page}): {f.note}" for name, f in self.figures.items()]
        return "\n".join(lines) + "\n"


def _digits(x: float, digits: int = 4) -> str:
    """A number with so many significant digits; a dash where there is none."""
    return f"{x:.{digits}g}" if math.isfinite(x) else "-"


def needed_in_words(needed: Needed) -> str:
    """The parameter value that a printed number would need, and how plausible it is, in a sentence."""
    if needed.value is None:
        return f"{needed.parameter}: no value gives the printed {needed.printed}. {needed.plausibility}"
    unit = "" if needed.unit == "1" else f" {needed.unit}"
    return f"{needed.parameter} = {needed.value:.4g}{unit} for the printed {needed.printed}. {needed.plausibility}"


def recompute(out: Path | str | None = None) -> Recomputation:
    """Recomputes Tables 1-12 and Figures 2, 6, 8, 10-13, and lists the contradictions; takes seconds.

    out : folder for the table (thesis.csv), all of it as a page (thesis.md) and as data (thesis.json), and the figures;
    None writes nothing.
    """
    folder = None if out is None else Path(out)
    found = Recomputation(table(), contradictions(), figures(), folder, provenance())
    if folder is not None:
        write_json(folder / "thesis.json", found.to_json())
        write_text(folder / "thesis.md", found.markdown())
        write_text(folder / "thesis.csv", found.table.to_csv(index=False, lineterminator="\n"))
        drawing.save(drawing.thesis_figure(found.figures), folder / "thesis_figures")
    return found
