"""Long proofs in resumable parts: one JSON line per finished task, and a page of results in docs/proof/.

An interrupted proof goes on where it stopped: tasks whose line is there are not run again. Lines that another version
of the package has written do not count. `PROVE_OUT` names another folder than results/prove.
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
            line = json.dumps({"code": code_sha256()[:16]} | found)
            cut = path.exists() and not path.read_bytes().endswith(b"\n")  # by a kill
            with path.open("a", encoding="utf-8") as file:
                file.write("\n" * cut + line + "\n")
            done[number] = json.loads(line)
    return [done[number] for number in range(count)]


def finished(name: str, code: str | None = None) -> dict[int, dict[str, Any]]:
    """What is there of a part: task -> its line. A last line cut off by a kill does not count."""
    path = out_folder() / f"{name}.jsonl"
    wanted = code or code_sha256()[:16]
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


def write_page(name: str, title: str, lines: Sequence[str], numbers: dict[str, Any], figure: Any = None) -> None:
    """NAME.md and NAME.json in docs/proof/, and NAME.svg and .png where there is a figure."""
    PAGES.mkdir(parents=True, exist_ok=True)
    date = datetime.now(UTC).date().isoformat()
    numbers = {"schema": f"bayes-damper/proof-{name}/1", "date": date, "commit": commit()} | numbers
    (PAGES / f"{name}.json").write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    head = [f"# {title}", "", f"Run on {date}, commit {numbers['commit']}.", ""]
    if figure is not None:
        figures.save(figure, PAGES / name)
        lines = [*lines, "", f"![{title}]({name}.svg)"]
    (PAGES / f"{name}.md").write_text("\n".join([*head, *lines]) + "\n", encoding="utf-8")
