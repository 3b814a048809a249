"""Sections of results that the page knows only by their form: every list a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bayes_damper.report.parts import Headline, Result, Section, generic
from bayes_damper.report.sections.shared import pictures_of


def other_result(kind: str, title: str, opening: str) -> Callable[[Mapping[str, Any], Path], Result]:
    """A reader of results that shows everything as tables."""

    def read(data: Mapping[str, Any], folder: Path) -> Result:
        rest = generic(data, title, ("schema", "provenance"))
        sentences = tuple(data.get("sentences", ())) or (opening,)
        scores = data.get("scores")
        table = generic({"scores": scores}, "").tables[:1] if scores else ()
        section = Section(title, (), rest.tables, (), pictures_of(folder, kind=kind), rest.parts)
        return Result(
            Headline(title, "open", sentences, table=next(iter(table), None)),
            section,
            (),
            dict(data.get("provenance", {})),
        )

    return read
