"""Long proofs in resumable parts: one JSON line per finished task, and a page of results in docs/proof/.

An interrupted proof goes on where it stopped: tasks whose line is there are not run again. Lines that another version
of the modules in question has written do not count. `PROVE_OUT` names another folder than results/prove.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bayes_damper import figures
from bayes_damper.provenance import code_sha256, commit

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "proof"


FITTED = (
    "bayes_damper.record_posterior", "bayes_damper.evidence", "bayes_damper.sampling", "bayes_damper.posterior",
    "bayes_damper.published", "bayes_damper.priors",
)  # fmt: skip
MODULES = {
    "calibration": FITTED,
    "exact": FITTED,
    "bug": FITTED,
    "noise": FITTED,
    "priors": (*FITTED, "bayes_damper.sensitivity"),
    "evidence": FITTED,
    "kills-sampler": ("bayes_damper.sampling",),
    "integrator": ("bayes_damper.model",),
}
"""By the beginning of a part's name, the modules that decide its results, with all that they import; else all."""


def _code(name: str) -> str:
    """Checksum of the modules that decide the results of a part."""
    hits = [modules for begin, modules in MODULES.items() if name.startswith(begin)]
    return code_sha256(*(hits[0] if hits else ()))[:16]


def out_folder() -> Path:
    """Where the lines of finished tasks are kept."""
    return Path(os.environ.get("PROVE_OUT", ROOT / "results" / "prove"))


def finish(name: str, count: int, task: Callable[[int], dict[str, Any]]) -> list[dict[str, Any]]:
    """Results of tasks 0 .. count - 1, run here if their line is not in NAME.jsonl yet."""
    path = out_folder() / f"{name}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    done = finished(name)
    for number in range(count):
        if number not in done:
            begun = time.process_time()
            found = task(number)
            found |= {"task": number, "cpu_seconds": round(time.process_time() - begun, 2), "commit": commit()}
            line = json.dumps({"code": _code(name)} | found)
            cut = path.exists() and not path.read_bytes().endswith(b"\n")  # by a kill
            with path.open("a", encoding="utf-8") as file:
                file.write("\n" * cut + line + "\n")
            done[number] = json.loads(line)
    return [done[number] for number in range(count)]


def finished(name: str) -> dict[int, dict[str, Any]]:
    """What is there of a part: task -> its line. A last line cut off by a kill does not count."""
    path = out_folder() / f"{name}.jsonl"
    wanted = _code(name)
    done: dict[int, dict[str, Any]] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue
            if entry["code"] == wanted:
                done[entry["task"]] = entry
    return done


def write_page(name: str, verdict: str, lines: Sequence[str], numbers: dict[str, Any], figure: Any = None) -> None:
    """NAME.md and NAME.json in docs/proof/, NAME.svg and .png where there is a figure, and the index of all pages.

    verdict : the result in a sentence or two, for the index.
    """
    PAGES.mkdir(parents=True, exist_ok=True)
    title = QUESTIONS[name]
    date = datetime.now(UTC).date().isoformat()
    commits = sorted({" ".join(w[:12] for w in str(c).split()) for c in numbers.pop("commits", [commit()])})
    head = {"schema": f"bayes-damper/proof-{name}/1", "title": title, "verdict": verdict, "date": date}
    numbers = head | {"commits": commits} | numbers
    (PAGES / f"{name}.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    text = [f"# {title}", "", f"Run on {date}, commit {', '.join(commits)}. {verdict}", "", *lines]
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
    "priors": "Does the table of prior sensitivity tell what a new fit would find?",
}
"""What each page answers, by its name."""


def write_index() -> None:
    """docs/proof/index.md: every page with its question, its result, its date and commit."""
    rows = [
        f"| {title} | not run yet | `make prove` | | |"
        for name, title in QUESTIONS.items()
        if not (PAGES / f"{name}.json").exists()
    ]
    for path in sorted(PAGES.glob("*.json")):
        page = json.loads(path.read_text(encoding="utf-8"))
        if page["schema"].startswith("bayes-damper/proof-"):
            commits = ", ".join(page["commits"])
            rows.append(
                f"| [{page['title']}]({path.stem}.md) | {page['verdict']} | `make prove` | {page['date']} | {commits} |"
            )
    text = f"""\
# What is proven, and by which command

`make prove` runs every proof of the table that names it: statistical checks too long for `make test`, about three hours
on two cores. It works in parts, kept in `results/prove/` (or the folder that `PROVE_OUT` names): stopped at any moment,
the same command goes on where it was. Parts that another version
of the modules in question has written do not count. One proof alone:
`python -m pytest -m prove tests/prove/test_prove_bugs.py`.

| question | result | command | date | commit |
| --- | --- | --- | --- | --- |
{chr(10).join(rows)}

Two more have commands of their own: [how fast and how accurate the simulation is beside its peers](bench.md),
`bayes-damper bench`, and [whether the diagnosis names the cause of a gap that it has never seen](withheld.md),
`bayes-damper withheld`.
"""
    (PAGES / "index.md").write_text(text, encoding="utf-8")
