"""Tables of a proof, for its page.

    python -m validation.proofs.page EASY HARD
    python -m validation.proofs.page LABORATORIES

EASY, HARD: what `together` wrote of the two kinds. Printed are the tables of docs/proof/withheld.md, the
misses one by one, and the short table of counts; a test holds the page against them. LABORATORIES: the withheld.json of
drawn laboratories, for docs/proof/laboratories.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bayes_damper.runs.contents.withheld import ClassEntry, Judged, Rate, RateName, WithheldFile
from bayes_damper.runs.json_files import read_json
from bayes_damper.text import p_value
from bayes_damper.validation.withheld.scores import status

PLACES = ("easy, level 0.15-2", "easy, level 0.05", "hard, level 1", "hard, level 0.5", "hard, level 0.15")
KINDS = ("easy", "hard")


def table(easy: WithheldFile, hard: WithheldFile) -> str:
    """Markdown: targets by kind and level, then those of a kind at all its levels."""
    calibration = [
        "calibration error of the probabilities",
        *(_calibration(d, kind) for d, kind in zip((easy, hard), KINDS, strict=True)),
    ]
    return "\n".join((*_rows(easy, hard, PLACES), "", *_rows(easy, hard, KINDS), _line(calibration)))


_BY_CLASS: tuple[tuple[str, RateName], ...] = (
    ("`none` where nothing is missing", "none_kept"), ("right effect first", "right_first"),
    ("`unknown` first, outside the library", "unknown_first"), ("right site, library", "site"),
    ("wrong name with p > 0.9", "false_and_confident"), ("wrong name with p > 0.5", "false_and_likely"),
    ("truth in the 90 % set", "truth_in_credible_set"), ("90 % intervals of parameters", "coverage90"),
    ("90 % intervals of scatters", "scatter90"), ("gap's test below 5 %, sound rigs", "gap_test_5"),
    ("readings in 50 % bands", "bands50"), ("readings in 90 % bands", "bands90"), ("log score, nats", "log_score"),
    ("seconds, median", "seconds"),
)  # fmt: skip


def laboratories(results: WithheldFile) -> str:
    """Markdown: targets over laboratories, what each class of them came to, the baselines, the misses."""
    scored = results["scores"]
    lines = [_line(("what", "where", "came out", "asked")), _line(["---"] * 4)]
    for t in (t for t in scored["targets"] if t["where"].startswith("laboratories") and t["n"]):
        came, _, asked = _cell(t).partition("; ")
        lines.append(_line((t["what"], t["where"], came, asked)))
    whole: ClassEntry = {**scored["all"], "reliability": scored["reliability"]["all"]}
    found = {**scored["by_class"], "all": whole}
    lines += ["", _line(("what", *found)), _line(["---"] * (1 + len(found)))]
    lines.append(_line(("campaigns", *(str(c["campaigns"]) for c in found.values()))))
    lines += [_line((words, *(_short(c[name]) for c in found.values()))) for words, name in _BY_CLASS]
    calibrated = [(r["error"], r["p_value"]) for c in found.values() for r in (c["reliability"],)]
    lines.append(_line(("calibration", *("-" if p is None else f"{e:.2f}; {p_value(p)}" for e, p in calibrated))))
    lines += ["", _line(("baseline", "right or acceptable first", "log score", "better log score")), _line(["---"] * 4)]
    for name, b in (results["baselines"] or {}).items():
        lines.append(
            _line((name, *(_short(b["baseline"][n]) for n in ("accepted_first", "log_score")), b["better_log_score"]))
        )
    lines += ["", *(f"- {miss}" for miss in scored["misses"])]
    return "\n".join(lines)


def _short(found: Rate) -> str:
    if not found["n"] or found["value"] is None:
        return "-"
    if "hits" in found:
        return f"{found['hits']} of {found['n']}"
    low, high = found["interval95"]
    return f"{found['value']:.2g} ({low:.2g} .. {high:.2g})"


def misses(easy: WithheldFile, hard: WithheldFile) -> str:
    """Markdown: what was taken for what, a line each."""
    return "\n".join(f"- {miss}" for d in (easy, hard) for miss in d["scores"]["misses"])


def short_table(easy: WithheldFile, hard: WithheldFile) -> str:
    """Markdown: counts alone."""
    both = (easy, hard)
    levels = sorted({level for d in both for level in _unknown_by_level(d)}, reverse=True)
    gaps = ", ".join(f"{level:g}" for level in levels)
    counted = {
        "right effect named": [_overall(d, "right_first") for d in both],
        "no false alarm where nothing is wrong": [_overall(d, "none_kept") for d in both],
        f"`unknown` for a cause of a kind never seen before (gap {gaps})": [
            ", ".join(_unknown_by_level(d).get(level, "-") for level in levels) for d in both
        ],
        "`unknown` for an effect that was taken out of the library": [
            _count(removed["unknown_first"]) for d in both if (removed := d["leave_one_out"])
        ],
        "a wrong effect named with p > 0.9": [_overall(d, "false_and_confident") for d in both],
        "two effects at once, both named": [_overall(d, "pairs_both_named") for d in both],
        "best simple baseline (regression terms weighted by BIC), right answer first": [_beaten(d) for d in both],
    }
    head = ("", "rig constants exact", "constants 1-2 % off, late triggers, coloured noise")
    return "\n".join([_line(head), _line(["---"] * 3), *(_line([what, *cells]) for what, cells in counted.items())])


def _rows(easy: WithheldFile, hard: WithheldFile, places: Sequence[str]) -> list[str]:
    """A line for each target that these places have and that was tested; both results hold all targets."""
    tested: dict[str, dict[str, str]] = {}
    for target in (t for d in (easy, hard) for t in d["scores"]["targets"] if t["where"] in places):
        cells = tested.setdefault(_name(target), {})
        if target["value"] is not None:
            cells[target["where"]] = _cell(target)
    head = ["what", *(place.removesuffix(", level 0.15-2") for place in places)]
    lines = [[name, *(cells.get(place, "") for place in places)] for name, cells in tested.items() if cells]
    return [_line(cells) for cells in (head, ["---"] * len(head), *lines)]


def _calibration(results: WithheldFile, kind: str) -> str:
    """Error of the probabilities, that of a calibrated twin, and how often a twin errs as much."""
    found = results["scores"]["reliability"][kind]
    if (p := found["p_value"]) is None:
        return "-"
    return f"{found['error']:.3f} of {found['n']}; twin {found['twin_error']['mean']:.3f}; {p_value(p)}"


def _name(target: Judged) -> str:
    """What is asked for, without what differs from kind to kind."""
    return str(target["what"]).partition(" within ")[0]


def _cell(target: Judged) -> str:
    low, high = target["interval95"]
    asked = " and ".join(
        f"{sign} {x:g}" for x, sign in ((target["least"], ">="), (target["most"], "<=")) if x is not None
    )
    mark = {"missed": " **missed**", "shown": " (shown)"}.get(status(target), "")
    return f"{target['value']:.2g} ({low:.2g} .. {high:.2g}) of {target['n']}; {asked}{mark}"


def _line(cells: Sequence[str]) -> str:
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def _overall(results: WithheldFile, rate: RateName) -> str:
    return _count(results["scores"]["all"][rate])


def _count(rate: Rate) -> str:
    return f"{rate['hits']} of {rate['n']}" if rate["n"] else "-"


def _unknown_by_level(results: WithheldFile) -> dict[float, str]:
    """Of causes of kinds kept for the proof, and to be seen: how often `unknown` came first, by level."""
    found: dict[float, list[bool]] = {}
    for row in (campaign["score"] for campaign in results["campaigns"].values()):
        if row["standing"] == "reserved" and row["accepted"] == ["unknown"]:
            found.setdefault(float(row["level"]), []).append(row["right"])
    return {level: f"{sum(right)} of {len(right)}" for level, right in found.items()}


def _beaten(results: WithheldFile) -> str:
    bic, ours = (results["baselines"]["bic"][name]["accepted_first"] for name in ("baseline", "diagnosis"))
    return f"{bic['value']:.2f}, ours {ours['value']:.2f} of {ours['n']}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    given = [Path(x) for x in (sys.argv[1:] if arguments is None else arguments)]
    if len(given) == 1:
        sys.stdout.write(laboratories(read_json(given[0])) + "\n")
        return 0
    if len(given) != 2:
        sys.stdout.write("give the withheld.json of the easy set and that of the hard one, or that of laboratories\n")
        return 2
    easy, hard = (read_json(path) for path in given)
    sys.stdout.write("\n\n".join(part(easy, hard) for part in (table, misses, short_table)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
