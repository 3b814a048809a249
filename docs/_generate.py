"""Hook of mkdocs: fills the reference pages from the code, so that they cannot fall behind it.

A line `<!-- generated: NAME -->`, and the line after it that tells readers of the repository where to look, give place
to what the function of that name below returns. Below a line `<!-- thresholds -->`, with the line after it, constants
of the code stand in braces, as {plausibility._MISSING:.0%} does; numbers take their place.
"""
# ruff: noqa: INP001 (docs is no package)

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Callable
from typing import Any

_MARK = re.compile(r"<!-- generated: (\w+) -->(?:\n\*In the repository[^\n]*\*)?")
_THRESHOLDS = re.compile(r"<!-- thresholds -->\n\*In the repository[^\n]*\*\n")
_CONSTANT = re.compile(r"\{(\w+)\.\w+(?:\[\w+\])*(?::[^{}]*)?\}")
_HOMES = {
    path.rpartition(".")[2]: f"bayes_damper.{path}"
    for path in (
        *("campaign.balance", "campaign.declarations", "campaign.head", "campaign.magnitudes", "campaign.plausibility"),
        *("campaign.readings", "campaign.record_files", "campaign.records", "campaign.trials_table"),
        *("calibration.correlated_noise", "calibration.hum", "diagnosis.outliers", "priors.files", "priors.limits"),
        "inputs",
    )
}
"""Modules whose constants pages may name: by their last name, the whole one."""
_MATH = re.compile(r"^```math\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
_HEADINGS = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put the generated parts in place, and typeset equations (MathML, so that pages need no network)."""
    if _THRESHOLDS.search(markdown):
        markdown = thresholds(markdown)
    return _MATH.sub(_typeset, _MARK.sub(lambda found: _PARTS[found[1]](), markdown))


def thresholds(markdown: str) -> str:
    """A page with the constants that it names as numbers: 20 %, 1 000 000, 1e-6."""

    def number(found: re.Match[str]) -> str:
        text = found[0].format(**{found[1]: importlib.import_module(_HOMES[found[1]])})
        return re.sub(r"e([+-])0*", lambda e: "e" + e[1].strip("+"), text).replace("%", " %").replace(",", " ")

    return _CONSTANT.sub(number, _THRESHOLDS.sub("", markdown))


def _typeset(found: re.Match[str]) -> str:
    from latex2mathml.converter import convert

    return f'<div class="math" markdown="0">{convert(found[1].strip(), display="block")}</div>'


def commands() -> str:
    """Every command with its options, from the parser."""
    from bayes_damper.cli import _parser

    subparsers = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction))  # noqa: SLF001
    parts = []
    for name, sub in subparsers.choices.items():
        rows = ["| argument | meaning |", "| --- | --- |"]
        for action in sub._actions:  # noqa: SLF001
            if isinstance(action, argparse._HelpAction) or action.help == argparse.SUPPRESS:  # noqa: SLF001
                continue
            spelt = ", ".join(action.option_strings) or (action.metavar or action.dest)
            if action.option_strings and action.nargs != 0:
                choices = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper()
                spelt = f"{spelt} {action.metavar or choices}"
            rows.append(f"| `{_cell(str(spelt))}` | {_cell(action.help or '')} |")
        parts.append(f"## {name}\n\n{_sentence(sub.description or '')}\n\n" + "\n".join(rows))
    return "\n\n".join(parts)


def python() -> str:
    """Every public name: signature and docstring."""
    import bayes_damper

    parts = []
    for name in bayes_damper.__all__:
        value = getattr(bayes_damper, name)
        if callable(value):
            text = _docstring(inspect.getdoc(value) or "")
            body = f"```python\n{name}{_signature(value)}\n```\n\n{text}"
            body += _methods(value) if inspect.isclass(value) else _result(value)
        else:
            body = f"`{value!r}`"
        parts.append(f"## {name}\n\n`from bayes_damper import {name}`\n\n{body}")
    return "\n\n".join(parts)


def _result(function: Any) -> str:
    """What a function gives, where that is a record of the package: its fields and its methods."""
    name = str(inspect.signature(function).return_annotation)
    kind = getattr(sys.modules[function.__module__], name, None)
    if not dataclasses.is_dataclass(kind):
        return ""
    fields = ", ".join(f"`{f.name}`: {f.type}" for f in dataclasses.fields(kind))
    own = [n for n, x in vars(kind).items() if not n.startswith("_") and (inspect.isfunction(x) or n == "exit_code")]
    methods = ", ".join(f"`{n}`" if n == "exit_code" else f"`{n}()`" for n in own)
    text = _docstring(inspect.getdoc(kind) or "")
    return f"\n\n**Gives** `{name}`: {text}\n\nFields: {fields}." + (f" Also: {methods}." if methods else "")


def parameters() -> str:
    """The registry of parameters as a table."""
    from bayes_damper.rig.parameters import PARAMETERS, unit_of

    rows = ["| name | symbol | unit | on a translational rig | meaning |", "| --- | --- | --- | --- | --- |"]
    rows += [
        f"| `{p.name}` | {p.symbol} | {p.unit} | {unit_of(p.name, 'translational')} | {p.meaning} |"
        for p in PARAMETERS.values()
    ]
    return "\n".join(rows)


def effects() -> str:
    """The library of effects, one section each."""
    from bayes_damper.effects import EFFECTS, classes
    from bayes_damper.effects.base import SITES

    alike = {name: sorted(group - {name}) for group in classes() for name in group}
    rows = [f"| `{e.name}` | {words} |" for e in EFFECTS.values() if (words := e.needs_in_words())]
    parts = [
        "## What each effect needs",
        "Any rig can have the others. `fit` and `simulate` refuse an effect that a rig cannot have.",
        "\n".join(["| effect | needs |", "| --- | --- |", *rows]),
    ]
    for site in SITES:
        parts.append(f"## {site}")
        for effect in (e for e in EFFECTS.values() if e.site == site):
            lines = [
                f"### {effect.name}",
                "",
                f"*{effect.title[0].upper() + effect.title[1:]}.* {effect.summary}",
                "",
                f"Seen as: {effect.looks_like}",
                "",
            ]
            if effect.hides_behind:
                lines += [f"Can hide behind {', '.join(f'`{n}`' for n in effect.hides_behind)}.", ""]
            if effect.name in alike:
                others = ", ".join(f"`{n}`" for n in alike[effect.name])
                lines += [f"Agrees to first order with {others}: a verdict inside that class is right.", ""]
            lines += ["| formula | parameter | unit | meaning |", "| --- | --- | --- | --- |"]
            for variant in effect.variants:
                for i, p in enumerate(variant.parameters):
                    first = f"{variant.name}: `{_cell(variant.formula)}`" if i == 0 else ""
                    lines.append(f"| {first} | `{p.name}` | {p.unit} | {_cell(p.meaning)} |")
            lines += ["", f"Source: {effect.source}"]
            parts.append("\n".join(lines))
    return "\n\n".join(parts)


def reader() -> str:
    """The keys of an import table."""
    from bayes_damper.campaign.importing.options import READER, TRIAL

    rows = ["| key | meaning |", "| --- | --- |"]
    rows += [f"| `{key}` | {_cell(known.meaning)} |" for table in (TRIAL, READER) for key, known in table.items()]
    return "\n".join(rows)


def _methods(value: Any) -> str:
    parts = []
    for name, member in vars(value).items():
        if not name.startswith("_") and inspect.isfunction(member) and member.__doc__:
            text = f"```python\n.{name}{_signature(member)}\n```\n\n{_docstring(inspect.getdoc(member) or '')}"
            parts.append(f"\n\n**{name}**\n\n{text}")
    return "".join(parts)


def _signature(function: Any) -> str:
    """A signature with one argument a line where it is long."""
    arguments, starred = [], False
    for p in inspect.signature(function).parameters.values():
        if p.name == "self":
            continue
        if p.kind is p.KEYWORD_ONLY and not starred:
            starred = True
            arguments.append("*")
        star = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        starred = starred or star == "*"
        default = "" if p.default is p.empty else f" = {p.default!r}"
        arguments.append(f"{star}{p.name}{'' if p.annotation is p.empty else f': {p.annotation}'}{default}")
    short = ", ".join(arguments)
    return f"({short})" if len(short) < 80 else "(\n" + "".join(f"    {a},\n" for a in arguments) + ")"


def _docstring(text: str) -> str:
    """A docstring of numpy style as markdown: headings bold, `name : ...` lines and raised errors as definitions."""
    text = _HEADINGS.sub(r"**\1**\n", text)
    out: list[str] = []
    for line in re.sub(r"[;.,] (?=\w+ : )", ".\n", text).splitlines():
        if line.startswith("    ") and out and out[-1] and not out[-1].startswith((":", " ")):
            out.append(f":   {line.strip()}")
        elif re.match(r"^\w[\w, ]* : ", line):
            names, _, rest = line.partition(" : ")
            out += ["", f"`{names}`: {rest}"]
        else:
            out.append(line)
    return "\n".join(out)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("%%", "%").replace("\n", " ")


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


_PARTS: dict[str, Callable[[], str]] = {part.__name__: part for part in (commands, python, parameters, effects, reader)}
