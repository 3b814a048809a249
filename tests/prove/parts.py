"""Long proofs in resumable parts: one JSON line per finished task, and a page of results in docs/proof/.

An interrupted proof goes on where it stopped: tasks whose line is there are not run again. Lines that another version
of the modules in question has written count only if one in ten of these tasks, spread over all of them, is run again
and gives the same bit for bit; the page says so. `PROVE_OUT` names another folder than results/prove.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bayes_damper import figures
from bayes_damper.runs.provenance import code_sha256, commit

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "proof"


FITTED = (
    "bayes_damper.calibration.posterior", "bayes_damper.sampling.bridge", "bayes_damper.sampling",
    "bayes_damper.published.posterior", "bayes_damper.published.measurements", "bayes_damper.priors.files",
)  # fmt: skip
MODULES = {
    "calibration": FITTED,
    "exact": FITTED,
    "bug": FITTED,
    "noise": FITTED,
    "priors": (*FITTED, "bayes_damper.sampling.prior_sensitivity"),
    "evidence": FITTED,
    "kills-sampler": ("bayes_damper.sampling",),
    "integrator": ("bayes_damper.simulation.model",),
    "next": ("bayes_damper.diagnosis",),
    "rigs": ("bayes_damper.diagnosis", "bayes_damper.campaign", "bayes_damper.calibration.forecast"),
}
"""By the beginning of a part's name, the modules that decide its results, with all that they import; else all."""


def _code(name: str) -> str:
    """Checksum of the modules that decide the results of a part."""
    hits = [modules for begin, modules in MODULES.items() if name.startswith(begin)]
    return code_sha256(*(hits[0] if hits else ()))[:16]


def out_folder() -> Path:
    """Where the lines of finished tasks are kept."""
    return Path(os.environ.get("PROVE_OUT", ROOT / "results" / "prove"))


def _cpu_seconds() -> float:
    """CPU time of this process and of those it has waited for."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def finish(
    name: str, count: int, task: Callable[[int], dict[str, Any]], *, by_chance: bool = False
) -> list[dict[str, Any]]:
    """Results of tasks 0 .. count - 1, run here if their line is not in NAME.jsonl yet.

    by_chance : whether a task gives something else each time, so that nothing of another version can count.
    """
    done = finished(name)
    if not by_chance and any(number not in done for number in range(count)):
        _try_earlier(name, count, task)
        done = finished(name)
    for number in range(count):
        if number not in done:
            done[number] = _run(name, number, task)
    return [done[number] for number in range(count)]


def _run(name: str, number: int, task: Callable[[int], dict[str, Any]]) -> dict[str, Any]:
    """Run one task and keep its line."""
    begun = _cpu_seconds()
    found = task(number)
    found |= {"task": number, "cpu_seconds": round(_cpu_seconds() - begun, 2), "commit": commit()}
    return _keep(name, found)


def _keep(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    path = out_folder() / f"{name}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    line = json.dumps({"code": _code(name)} | entry)
    cut = path.exists() and not path.read_bytes().endswith(b"\n")  # by a kill
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut + line + "\n")
    return dict(json.loads(line))


_OF_THE_RUN = ("code", "commit", "cpu_seconds", "seconds", "peak_kb")  # what differs between runs of one task


def _try_earlier(name: str, count: int, task: Callable[[int], dict[str, Any]]) -> None:
    """Let lines of an earlier version count if the tasks that are run again give the same."""
    here, lines_there = _code(name), _lines(name)
    if any("earlier" in entry and entry["code"] == here for entry in lines_there):
        return
    by_code: dict[str, dict[int, dict[str, Any]]] = {}
    for entry in lines_there:
        if "task" in entry and entry["task"] < count and entry["code"] != here:
            by_code.setdefault(entry["code"], {})[entry["task"]] = entry
    if not by_code:
        return
    earlier, lines = max(by_code.items(), key=lambda item: len(item[1]))
    numbers = sorted(lines)
    chosen = numbers[:: max(len(numbers) // max(count // 10, 2), 1)]
    done = finished(name)
    for number in chosen:
        again = done.get(number) or _run(name, number, task)
        if any(again.get(key) != value for key, value in lines[number].items() if key not in _OF_THE_RUN):
            return
    commits = sorted({str(line["commit"]) for line in lines.values()})
    _keep(name, {"earlier": earlier, "repeated": len(chosen), "commit": commit(), "earlier_commits": commits})


def repeated(*names: str) -> tuple[int, int]:
    """Tasks, of the parts whose names begin so, that an earlier version has run, and those run again and the same."""
    lines, again = 0, 0
    for path in sorted(out_folder().glob("*.jsonl")):
        if path.stem.startswith(names):
            told = [e for e in _lines(path.stem) if "earlier" in e and e["code"] == _code(path.stem)]
            lines += sum(e["code"] != _code(path.stem) for e in finished(path.stem).values())
            again += told[-1]["repeated"] if told else 0
    return lines, again


def _lines(name: str) -> list[dict[str, Any]]:
    """All whole lines of a part, of whatever version; a last one cut off by a kill is none."""
    path = out_folder() / f"{name}.jsonl"
    found = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        with suppress(json.JSONDecodeError):
            found.append(json.loads(line))
    return found


def finished(name: str) -> dict[int, dict[str, Any]]:
    """What is there of a part: task -> its line."""
    wanted = _code(name)
    lines = _lines(name)
    earlier = {entry["earlier"] for entry in lines if entry["code"] == wanted and "earlier" in entry}
    done = {entry["task"]: entry for entry in lines if entry["code"] in earlier and "task" in entry}
    return done | {entry["task"]: entry for entry in lines if entry["code"] == wanted and "task" in entry}


def cost(*names: str) -> float:
    """CPU minutes that parts have taken, those whose names begin so."""
    begun = [p.stem for p in sorted(out_folder().glob("*.jsonl")) if p.stem.startswith(names)]
    return sum(float(entry["cpu_seconds"]) for name in begun for entry in finished(name).values()) / 60.0


def write_page(
    name: str,
    verdict: str,
    lines: Sequence[str],
    numbers: dict[str, Any],
    figure: Any = None,
    minutes: float | None = None,
) -> None:
    """NAME.md and NAME.json in docs/proof/, NAME.svg and .png where there is a figure, and the index of all pages.

    verdict : the result in a sentence or two, for the index; minutes : of CPU time, by default those of its parts.
    """
    PAGES.mkdir(parents=True, exist_ok=True)
    title = QUESTIONS[name]
    date = datetime.now(UTC).date().isoformat()
    commits = sorted({" ".join(w[:12] for w in str(c).split()) for c in numbers.pop("commits", [commit()])})
    head = {"schema": f"bayes-damper/proof-{name}/1", "title": title, "verdict": verdict, "date": date}
    spent = cost(*PARTS.get(name, (name,))) if minutes is None else minutes
    numbers = head | {"commits": commits, "cpu_minutes": round(spent, 1)} | numbers
    (PAGES / f"{name}.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    text = [f"# {title}", "", f"Run on {date}, commit {', '.join(commits)}. {verdict}", "", *lines]
    before, again = repeated(*PARTS.get(name, (name,)))
    if before:
        text += [
            "",
            f"{before} tasks were run by an earlier commit of those named; {again} of them, spread over each part,",
            "were run again by the latest and gave the same, bit for bit.",
        ]
    if figure is not None:
        figures.save(figure, PAGES / name)
        text += ["", f"![{title}]({name}.svg)"]
    (PAGES / f"{name}.md").write_text("\n".join(text) + "\n", encoding="utf-8")
    write_index()


QUESTIONS = {
    "calibration": "Are the posteriors calibrated?",
    "bugs": "Does the calibration notice a bug?",
    "noise": "Do intervals hold the truth under correlated errors?",
    "samplers": "How does the sampler compare with its peers?",
    "kills": "Is anything lost when a run is killed?",
    "integrator": "Is the integrator accurate over the whole prior?",
    "evidence": "Is the evidence right, and what does it cost?",
    "rigs": "What do measured rigs say?",
    "priors": "Does the table of prior sensitivity agree with new fits?",
    "damage": "Does every damaged file end in a sentence?",
}
"""What each page answers, by its name."""
PARTS = {"calibration": ("calibration", "exact"), "bugs": ("bug-",)}
"""Beginnings of the names of the parts of a page, where they are not its own name."""


def write_index() -> None:
    """docs/proof/index.md: every page with its question, its result, its date and commit."""
    rows = [
        f"| {title} | not run yet | `make prove` | | | |"
        for name, title in QUESTIONS.items()
        if not (PAGES / f"{name}.json").exists()
    ]
    total = 0.0
    for path in sorted(PAGES.glob("*.json")):
        page = json.loads(path.read_text(encoding="utf-8"))
        if page.get("schema", "").startswith("bayes-damper/proof-"):
            commits = ", ".join(page["commits"])
            minutes = float(page.get("cpu_minutes", 0.0))
            total += minutes
            link = f"[{page['title']}]({path.stem}.md)"
            rows.append(f"| {link} | {page['verdict']} | `make prove` | {minutes:.0f} | {page['date']} | {commits} |")
    index = PAGES / "index.md"
    before = index.read_text(encoding="utf-8") if index.exists() else ""
    # What stands below the table is written by hand.
    below = before[before.rindex("\n|") + 1 :].partition("\n")[2] if "\n|" in before else ""
    text = f"""\
# What is proven, and by which command

`make prove` runs the proofs in the table that have it as their command. They are statistical checks that take too
long for `make test`. The work is split into parts, kept in `results/prove/` (or the folder in `PROVE_OUT`); after an
interruption the same command continues. Parts written by another version of the code are reused only if a tenth of
their tasks, run again, gives the same result bit for bit. To run one proof:
`python -m pytest -m prove tests/prove/test_prove_bugs.py`.

All parts together take {total:.0f} CPU minutes, half of that by the clock on two cores; the limit is three hours.

| question | result | command | CPU, min | date | commit |
| --- | --- | --- | --- | --- | --- |
{chr(10).join(rows)}
{below}"""
    index.write_text(text, encoding="utf-8")
