"""Tables of a proof, for its page and for the README.

    python -m bayes_damper.withheld.page EASY HARD

EASY, HARD: what `withheld.together` wrote of the two kinds. Printed are the tables of docs/proof/withheld.md, the
misses one by one, and the table of the README; a test holds both files against them.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_damper.run import read_json

PLACES = {"easy, level 0.15-2": "easy", "hard, level 1": "hard, level 1", "hard, level 0.5": "hard, level 0.5",
          "hard, level 0.15": "hard, level 0.15"}  # fmt: skip
KINDS = {"easy": "easy", "hard": "hard"}


def table(easy: Mapping[str, Any], hard: Mapping[str, Any]) -> str:
    """Markdown: targets by kind and level, then those of a kind at all its levels."""
    return "\n".join((*_rows(easy, hard, PLACES), "", *_rows(easy, hard, KINDS)))


def misses(easy: Mapping[str, Any], hard: Mapping[str, Any]) -> str:
    """Markdown: what was taken for what, a line each."""
    return "\n".join(f"- {miss}" for d in (easy, hard) for miss in d["scores"]["misses"])


def short_table(easy: Mapping[str, Any], hard: Mapping[str, Any]) -> str:
    """Markdown for the README: counts alone."""
    lines = [
        "| | rig constants exact | constants 1-2 % off, late triggers, coloured noise |",
        "| --- | --- | --- |",
        _line("right effect named", *(_count(d["scores"]["all"]["right_first"]) for d in (easy, hard))),
        _line(
            "no false alarm where nothing is wrong", *(_count(d["scores"]["all"]["none_kept"]) for d in (easy, hard))
        ),
    ]
    levels = sorted({level for d in (easy, hard) for level in _unknown_by_level(d)}, reverse=True)
    words = f"`unknown` for a cause of a kind never seen before (gap {', '.join(f'{x:g}' for x in levels)})"
    lines += [
        _line(words, *(", ".join(_unknown_by_level(d).get(x, "-") for x in levels) for d in (easy, hard))),
        _line(
            "`unknown` for an effect that was taken out of the library",
            *(_count(d["leave_one_out"]["unknown_first"]) for d in (easy, hard)),
        ),
        _line(
            "a wrong effect named with p > 0.9",
            *(_count(d["scores"]["all"]["false_and_confident"]) for d in (easy, hard)),
        ),
        _line(
            "two effects at once, both named", *(_count(d["scores"]["all"]["pairs_both_named"]) for d in (easy, hard))
        ),
        _line("best baseline (BIC weights), right answer", *(_beaten(d) for d in (easy, hard))),
    ]
    return "\n".join(lines)


def _rows(easy: Mapping[str, Any], hard: Mapping[str, Any], places: Mapping[str, str]) -> list[str]:
    targets = [
        t for d in (easy, hard) for t in d["scores"]["targets"] if t["where"] in places and t["value"] is not None
    ]
    names = dict.fromkeys(_name(t) for d in (easy, hard) for t in d["scores"]["targets"] if t["where"] in places)
    lines = [_line("what", *places.values()), _line("---", *("---" for _ in places))]
    for name in names:
        cells = [next((_cell(t) for t in targets if _name(t) == name and t["where"] == where), "") for where in places]
        if any(cells):
            lines.append(_line(name, *cells))
    return lines


def _name(target: Mapping[str, Any]) -> str:
    """What is asked for, without what differs from kind to kind."""
    return str(target["what"]).partition(" within ")[0]


def _cell(target: Mapping[str, Any]) -> str:
    low, high = target["interval95"]
    asked = " and ".join(
        f"{sign} {target[side]:g}" for side, sign in (("least", ">="), ("most", "<=")) if target[side] is not None
    )
    missed = " **missed**" if target["status"] == "missed" else ""
    return f"{target['value']:.2g} ({low:.2g} .. {high:.2g}) of {target['n']}; {asked}{missed}"


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |".replace("|  |", "| |").replace("|  |", "| |")


def _count(rate: Mapping[str, Any]) -> str:
    return f"{rate['hits']} of {rate['n']}" if rate["n"] else "-"


def _unknown_by_level(results: Mapping[str, Any]) -> dict[float, str]:
    """Of causes of kinds kept for the proof, and to be seen: how often `unknown` came first, by level."""
    rows = [c["score"] for c in results["campaigns"].values()]
    seen = [r for r in rows if r["standing"] == "reserved" and r["accepted"] == ["unknown"]]
    found = {}
    for level in {r["level"] for r in seen}:
        here = [r["right"] for r in seen if r["level"] == level]
        found[float(level)] = f"{sum(here)} of {len(here)}"
    return found


def _beaten(results: Mapping[str, Any]) -> str:
    bic, ours = (results["baselines"]["bic"][name]["accepted_first"] for name in ("baseline", "diagnosis"))
    return f"{bic['value']:.2f}, ours {ours['value']:.2f} of {ours['n']}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    given = [Path(x) for x in (sys.argv[1:] if arguments is None else arguments)]
    if len(given) != 2:
        sys.stdout.write("give the withheld.json of the easy set and that of the hard one\n")
        return 2
    easy, hard = (read_json(path) for path in given)
    sys.stdout.write("\n\n".join(part(easy, hard) for part in (table, misses, short_table)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
