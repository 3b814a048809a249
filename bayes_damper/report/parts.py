"""What a report is made of, as plain records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bayes_damper.text import NOTHING, number, p_value


@dataclass(frozen=True)
class Row:
    """Cells of a table row; `mark` is "", "prior" (decided by the prior) or "bad" (do not use, or outside).

    link : of the first cell, to a page beside this one; "": none.
    """

    cells: tuple[str, ...]
    mark: str = ""
    link: str = ""


@dataclass(frozen=True)
class Table:
    """A table with its caption; numbers and words are formatted already."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure: its title, the words for those who cannot see it, its file, and how it is read (below its title).

    One that is `first` stands before the charts of its section.
    """

    title: str
    alt: str
    path: str
    note: str = ""
    first: bool = False


@dataclass(frozen=True)
class Chart:
    """An interactive chart: `data` is what the page's script draws (see charts.py)."""

    title: str
    alt: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """One part of the page below the first screen; a folded one is shown when asked for, and if `on_paper` printed.

    A sketch (an `<svg>` element of our own making) stands first. Charts stand before pictures, but for a picture that
    is `first`.
    """

    title: str
    sentences: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    charts: tuple[Chart, ...] = ()
    pictures: tuple[Picture, ...] = ()
    parts: tuple[Section, ...] = ()
    folded: bool = False
    on_paper: bool = True
    sketch: str = ""

    @property
    def before_charts(self) -> tuple[Picture, ...]:
        """Pictures that stand before the charts."""
        return tuple(picture for picture in self.pictures if picture.first)


@dataclass(frozen=True)
class Headline:
    """An answer for the first screen: `tone` is "good", "bad" or "open"; probabilities are (answer, value, tone)."""

    title: str
    tone: str
    sentences: tuple[str, ...]
    probabilities: tuple[tuple[str, float], ...] = ()
    changes: tuple[str, ...] = ()
    table: Table | None = None


@dataclass(frozen=True)
class Result:
    """What one file of results contributes to the page; `remarks` are those of the records that it is made from."""

    headline: Headline
    section: Section
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def words(name: str) -> str:
    """A key of a JSON file as words."""
    return name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as a list in a sentence, the word `last` before the last of them."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}" if names else "none"


def generic(data: Mapping[str, object], title: str, skip: Sequence[str] = (), depth: int = 0) -> Section:
    """Any JSON object as tables: plain values in one, lists and objects in one each, deeper ones nested."""
    plain, tables, parts = [], [], []
    for key, value in data.items():
        if key in skip or value is None or value in ({}, []):
            continue
        if isinstance(value, Mapping) and value and all(isinstance(v, Mapping) for v in value.values()):
            if all(_flat(v) for v in value.values()):
                tables.append(_records(words(key), [{"": k, **v} for k, v in value.items()]))
            elif depth < 2:
                parts.append(generic(value, words(key), depth=depth + 1))
        elif isinstance(value, Mapping):
            if _flat(value):
                rows = tuple(Row((words(str(k)), _text(v, str(k)))) for k, v in value.items())
                tables.append(Table(words(key), ("", "value"), rows))
            elif depth < 2:
                parts.append(generic(value, words(key), depth=depth + 1))
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) and _flat(v) for v in value):
            tables.append(_records(words(key), value))
        elif _is_plain(value):
            plain.append(Row((words(key), _text(value, key))))
    if plain:
        tables.insert(0, Table("values", ("", "value"), tuple(plain)))
    return Section(title, tables=tuple(tables), parts=tuple(p for p in parts if p.tables or p.parts))


def folded(rest: Section) -> tuple[Section, ...]:
    """What is left of a file of results, for those who look for it; nothing where nothing is left."""
    if not rest.tables and not rest.parts:
        return ()
    return (
        Section("Further numbers of the result", tables=rest.tables, parts=rest.parts, folded=True, on_paper=False),
    )


def _is_plain(value: Any) -> bool:
    return not isinstance(value, Mapping) and not (
        isinstance(value, list) and (len(value) > 12 or any(isinstance(v, Mapping) for v in value))
    )


def _flat(value: Mapping[str, object]) -> bool:
    return all(_is_plain(v) for v in value.values())


def _records(caption: str, records: Sequence[Mapping[str, object]], most: int = 40) -> Table:
    columns = list(dict.fromkeys(key for record in records for key in record))
    rows = tuple(Row(tuple(_text(record.get(c), c) for c in columns)) for record in records[:most])
    note = f"The first {most} of {len(records)} rows; all are in the JSON file." if len(records) > most else ""
    return Table(caption, tuple(words(c) for c in columns), rows, note)


def _text(value: Any, name: str = "") -> str:
    """A value of a JSON file; the name of its key marks p values."""
    if name.endswith("p_value") and isinstance(value, int | float) and not isinstance(value, bool):
        return p_value(value).removeprefix("p ").removeprefix("= ")
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(_text(v) for v in value) or NOTHING
    return NOTHING if value is None else str(value) if isinstance(value, str) else number(value)
