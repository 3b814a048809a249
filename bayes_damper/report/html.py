"""`bayes-damper report FOLDER`: one self-contained HTML page from whatever results the folder holds.

Nothing is loaded from elsewhere: styles, script and figures are inside, and a content security policy forbids the
rest. The page computes nothing but quantiles of stored draws for its charts.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from bayes_damper.errors import ExitCode, InputError, as_written, in_words
from bayes_damper.report.parts import Picture, Result, Section
from bayes_damper.report.sections import READERS
from bayes_damper.report.terms import terms
from bayes_damper.runs.json_files import read_json, write_text
from bayes_damper.runs.provenance import provenance
from bayes_damper.text import NOTHING, Printable, counted, percent

LARGEST = 5_000_000
"""Bytes that a page may have, so that it can be sent by mail."""
_LARGEST_SVG = 350_000  # bytes; a larger one is taken as PNG
_SMALL_PNG, _LARGE_PNG = 60_000, 600_000  # bytes; below the first it is taken as it is, above the other not so wide
_PAGE = 1000  # pixels, the width of a figure on the page
_MIME = {".svg": "image/svg+xml", ".png": "image/png"}
_ORDER = ("forest", "predictive", "records", "corner", "trace")


@dataclass(frozen=True)
class Report(Printable):
    """A page written to `path`: which results it shows, how many figures, and the warnings that stand on it."""

    path: Path
    results: tuple[str, ...]
    figures: int
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    size: int
    exit_code: ExitCode = ExitCode.DONE

    def text(self) -> str:
        """For people."""
        lines = [
            f"{self.path}: {listed_results(self.results)}, {counted(self.figures, 'figure')}, {self.size / 1e6:.1f} MB"
        ]
        lines += [f"  {w}" for w in self.warnings]
        if self.left_out:
            lines.append(f"  Left out because the page would be too large: {', '.join(self.left_out)}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "schema": "bayes-damper/report/1",
            "path": str(self.path),
            "results": list(self.results),
            "figures": self.figures,
            "left_out": list(self.left_out),
            "warnings": list(self.warnings),
            "bytes": self.size,
        }


@dataclass
class _Budget:
    """Bytes that figures may still take, and what they were turned into."""

    left: int
    used: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)


def report(folder: str | Path, *, out: str | Path | None = None) -> Report:
    """Write one HTML page with all results of a folder, and of the folders directly in it.

    Parameters
    ----------
    folder : what `fit`, `diagnose`, `tune` and the other commands wrote to (`--out`).
    out : the page; by default report.html in the folder.

    Raises
    ------
    InputError
        if there is no such folder, or nothing in it that a report can show.
    """
    home = Path(folder)
    if not home.is_dir():
        raise InputError(f"{home}: there is no such folder; name one that a command has written to (--out)")
    path = Path(out) if out is not None else home / "report.html"
    files, results, warnings = [], [], []
    for file, kind in _result_files(home):
        data = read_json(file)
        schema, read = READERS[kind]
        found = data.get("schema") if isinstance(data, Mapping) else None
        if found != schema:
            warnings.append(f"{file.relative_to(home)} is not shown: its schema is {found!r}, expected {schema!r}.")
            continue
        try:
            results.append(read(data, file.parent))
        except InputError as error:
            warnings.append(f"{file.relative_to(home)} is not shown: {error}.")
            continue
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, OSError, RuntimeError) as error:
            warnings.append(
                f"{file.relative_to(home)} is not shown: an entry is missing or malformed ({in_words(error)})."
            )
            continue
        files.append(file)
    if not results:
        hint = f"it holds none of {', '.join(READERS)}"
        begun = sorted({p.parent for p in (home / "run.json", *home.glob("*/run.json")) if p.is_file()})
        if begun:
            hint = f"the run in it has not ended; go on with: bayes-damper resume {begun[0]}"
        raise InputError([f"{home}: there is nothing to report; {hint}", *warnings])
    names = tuple(str(f.relative_to(home)) for f in files)
    warnings = [*_of_different_data(names, results), *(w for r in results for w in r.warnings), *warnings]
    with as_written(home, "fit, diagnose ..."):
        page, budget = _page(home, names, results, warnings)
    write_text(path, page)
    shown = sum(bool(v) for v in budget.used.values())
    return Report(path, names, shown, tuple(budget.left_out), tuple(warnings), len(page.encode("utf-8")))


def listed_results(names: Sequence[str]) -> str:
    """Names of result files for a sentence."""
    return ", ".join(names)


def _result_files(home: Path) -> Iterator[tuple[Path, str]]:
    """Files of results in a folder and directly below it, in the order of the page.

    A fleet's campaigns have pages of their own.
    """
    places = (
        [home]
        if (home / "fleet.json").is_file()
        else [home, *sorted(p for p in home.iterdir() if p.is_dir() and not p.name.startswith("."))]
    )
    for kind in READERS:
        yield from ((place / kind, kind) for place in places if (place / kind).is_file())


def _page(home: Path, names: tuple[str, ...], results: list[Result], warnings: list[str]) -> tuple[str, _Budget]:
    templates = Path(__file__).parent / "templates"
    environment = Environment(
        loader=FileSystemLoader(templates),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"json": _json, "percent": percent, "typeset": typeset, "sentence": sentence}
    sections = _numbered([r.section for r in results], names)
    charts = sum(len(_json(c.data)) for s in sections for c in _charts(s))
    budget = _Budget(LARGEST - 150_000 - charts)
    for picture in sorted((p for s in sections for p in _all_pictures(s)), key=_rank):
        _take(picture, budget, home)
    page = environment.get_template("report.html.j2").render(
        title=f"Report: {_name(results) or home.resolve().name}",
        headlines=[(r.headline, s) for r, s in zip(results, sections, strict=True)],
        sections=sections,
        warnings=warnings,
        terms=terms([r.headline for r in results], sections),
        remarks=list(dict.fromkeys(o for r in results for o in r.remarks)),
        images=budget.used,
        left_out=budget.left_out,
        origins=[(n, _origin(home / n, r)) for n, r in zip(names, results, strict=True)],
        own=provenance(),
        style=(templates / "report.css").read_text(encoding="utf-8"),
        script=(templates / "report.js").read_text(encoding="utf-8"),
    )
    return page, budget


_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def typeset(text: str) -> str:
    """Exponents raised: rad/s^2 as rad/s², th1^3 as th1³; powers of more than a number stay as they are."""
    return re.sub(r"\^(-?\d+)(?![\d.])", lambda found: found[1].translate(_RAISED), text)


def sentence(text: str) -> Markup:
    """A sentence as HTML: typeset, and what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(typeset(text)))))  # noqa: S704 (escaped)


def _name(results: list[Result]) -> str:
    """The campaign that the results are of, if they say so and are of one."""
    names = {str(r.provenance["campaign"]) for r in results if r.provenance.get("campaign")}
    return names.pop() if len(names) == 1 else ""


def _of_different_data(names: Sequence[str], results: Sequence[Result]) -> list[str]:
    """A warning where results are of several campaigns, or of one that was changed between them."""
    of_campaign, of_files = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    for name, r in zip(names, results, strict=True):
        if campaign := r.provenance.get("campaign"):
            of_campaign[str(campaign)].append(name)
            if checksum := r.provenance.get("campaign_sha256"):
                of_files[str(checksum)].append(name)
    if len(of_campaign) > 1:
        each = "; ".join(f"{campaign}: {listed_results(those)}" for campaign, those in of_campaign.items())
        return [f"The results are of different campaigns, so their numbers do not belong together ({each})."]
    if len(of_files) > 1:
        each = " and ".join(listed_results(those) for those in of_files.values())
        return [f"The files of campaign {next(iter(of_campaign))} changed between {each}: run again what is older."]
    return []


def _numbered(sections: list[Section], names: tuple[str, ...]) -> list[Section]:
    """Sections with titles of their own: two of one kind name their folders. Every figure stands once on a page."""
    out: list[Section] = []
    shown: set[str] = set()
    titles = [section.title for section in sections]
    for section, name in zip(sections, names, strict=True):
        place = Path(name).parent.as_posix()
        repeated = place != "." and titles.count(section.title) > 1
        title = f"{section.title} ({place})" if repeated else section.title
        pictures = tuple(p for p in section.pictures if p.path not in shown)
        shown |= {p.path for p in pictures}
        out.append(replace(section, title=title, pictures=pictures))
    said: set[str] = set()
    return [_explained_once(section, said) for section in out]


def _explained_once(section: Section, explained: set[str]) -> Section:
    """The section with each way to read a figure said only where it comes first; adds what it says to `explained`."""
    pictures = []
    for picture in section.pictures:
        pictures.append(replace(picture, note="") if picture.note in explained else picture)
        explained.add(picture.note)
    parts = tuple(_explained_once(part, explained) for part in section.parts)
    return replace(section, pictures=tuple(pictures), parts=parts)


def _charts(section: Section) -> Iterator[Any]:
    yield from section.charts
    for part in section.parts:
        yield from _charts(part)


def _all_pictures(section: Section) -> Iterator[Picture]:
    yield from section.pictures
    for part in section.parts:
        yield from _all_pictures(part)


def _rank(picture: Picture) -> int:
    stem = Path(picture.path).name
    return _ORDER.index(stem) if stem in _ORDER else 2


def _take(picture: Picture, budget: _Budget, home: Path) -> None:
    """Turn a figure into a data address, as SVG unless that is large, as long as there is room."""
    if picture.path in budget.used:
        return
    files = [f for s in _MIME if (f := Path(picture.path).with_name(Path(picture.path).name + s)).is_file()]
    files.sort(key=lambda f: (f.suffix == ".svg" and f.stat().st_size > _LARGEST_SVG, f.suffix != ".svg"))
    budget.used[picture.path] = ""
    for file in files:
        content = _smaller(file.read_bytes()) if file.suffix == ".png" else file.read_bytes()
        address = f"data:{_MIME[file.suffix]};base64,{base64.b64encode(content).decode('ascii')}"
        if len(address) <= budget.left:
            budget.left -= len(address)
            budget.used[picture.path] = address
            return
    if files:
        name = files[0]
        budget.left_out.append(str(name.relative_to(home) if name.is_relative_to(home) else name))


def _smaller(picture: bytes) -> bytes:
    """A PNG in at most 64 colours, which line drawings do not exceed to the eye; a large one not wider than a page."""
    if len(picture) < _SMALL_PNG:
        return picture
    from PIL import Image

    try:
        with Image.open(io.BytesIO(picture)) as image:
            plain = image.convert("RGB")
    except OSError:  # not a picture that Pillow reads: the browser may
        return picture
    if len(picture) > _LARGE_PNG and plain.width > _PAGE:
        plain = plain.resize((_PAGE, round(plain.height * _PAGE / plain.width)), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    plain.quantize(64, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return min(picture, out.getvalue(), key=len)


def _origin(file: Path, result: Result) -> list[tuple[str, str]]:
    """Provenance of one result, flat; with the checksum of its file."""
    rows = [("file sha256", hashlib.sha256(file.read_bytes()).hexdigest())]
    for key, value in result.provenance.items():
        if isinstance(value, Mapping):
            text = ", ".join(f"{k} {v}" for k, v in value.items())
        else:
            text = NOTHING if value is None else str(value)
        rows.append((key.replace("_", " "), text))
    return rows


def _json(data: Any) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
