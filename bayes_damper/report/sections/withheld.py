"""The section of a check on withheld causes: withheld.json."""

from __future__ import annotations

import math
from pathlib import Path

from bayes_damper.report.parts import Headline, Result, Row, Section, Table, folded, generic
from bayes_damper.report.sections.shared import pictures_of
from bayes_damper.runs.contents.withheld import Judged, RateName, WithheldFile
from bayes_damper.text import counted, number

_SCORES: tuple[tuple[RateName, str], ...] = (
    ("accepted_first", "right or acceptable first answer"),
    ("right_first", "right effect first"),
    ("none_kept", "no gap claimed where there is none"),
    ("unknown_first", "'unknown' for a cause outside the library"),
    ("pairs_both_named", "both of two effects named"),
    ("site", "right site"),
    ("false_and_confident", "wrong name with more than 90 %"),
    ("coverage90", "90 % intervals that hold the true parameter"),
)


def withheld_result(data: WithheldFile, folder: Path) -> Result:
    """Headline and section of withheld.json: sealed verdicts, and their scores once the key was opened."""
    scored = data.get("scores")
    whole = scored.get("all") if scored else None
    count = len(data.get("campaigns") or ())
    rehearsal = bool(data.get("rehearsal"))
    sentences = [f"{counted(count, 'campaign')} judged, verdicts sealed; the key has not been opened."]
    rows = []
    for key, what in _SCORES:
        score = whole.get(key) if whole else None
        if score is None or not score["n"]:
            continue
        low, high = (math.nan if x is None else 100.0 * x for x in score["interval95"])
        rows.append(Row((what, f"{score['hits']} of {score['n']}", f"{low:.0f} to {high:.0f} %")))
    if rows:
        by_name = {row.cells[0]: row.cells[1] for row in rows}
        first = next(iter(by_name.items()))
        sentences = [f"{first[0].capitalize()}: {first[1]} campaigns whose causes were withheld."]
        sentences += [f"{what.capitalize()}: {n}." for what, n in list(by_name.items())[1:4]]
    if rehearsal:
        sentences.insert(
            0, "A rehearsal: the causes could have been known. " + " ".join(data.get("why_rehearsal") or ())
        )
    table = Table("Scores", ("what", "how often", "95 % interval"), tuple(rows)) if rows else None
    rest = generic(data, "", ("schema", "provenance"))
    name = "Withheld causes"
    tone = "bad" if rehearsal else "good" if rows else "open"
    head = Headline(name, tone, tuple(sentences), changes=tuple(_changes(data, bool(rows), rehearsal)), table=table)
    section = Section(name, (), (), (), pictures_of(folder, kind="withheld"), folded(rest))
    return Result(head, section, (), dict(data.get("provenance", {})))


def _changes(data: WithheldFile, opened: bool, rehearsal: bool) -> list[str]:
    """What would make more of these scores: fresh campaigns, the targets missed, and how many are known too roughly."""
    if not opened:
        return ["The same call again goes on to the end and then opens the key."]
    fresh = "Campaigns generated after the code was frozen, from seeds never used before"
    changes = [f"{fresh}: these scores are a rehearsal."] if rehearsal else []
    scored = data.get("scores")
    targets = (scored.get("targets") if scored else None) or ()
    missed = [_target(t) for t in targets if t["status"] == "missed"]
    if missed:
        changes.append(f"Targets missed: {'; '.join(missed)}.")
    few = [t for t in targets if t["status"] != "not tested" and not t["enough"]]
    untested = [t for t in targets if t["status"] == "not tested"]
    if few or untested:
        changes.append(
            f"More campaigns (bayes-damper withheld FOLDER --full): of {counted(len(targets), 'target')} "
            f"{len(untested)} could not be tested and {len(few)} rest on fewer campaigns than they are meant for."
        )
    return changes


def _target(judged: Judged) -> str:
    """A target that was missed: what, where, what came out and what was asked for."""
    asked = [f"at {word} {judged[word]:g}" for word in ("least", "most") if judged.get(word) is not None]
    return f"{judged['what']}, {judged['where']}: {number(judged['value'])} ({' and '.join(asked)} asked for)"
