"""Bugs planted in the fit must be noticed by the calibration, and a sound fit must not."""

from __future__ import annotations

from typing import Any

import pages
import parts
import pytest
import ranks
from bugs import BUGS, SOUND, Bug

LEVEL = 1e-3
FIRST, MOST = 3, 96
"""Campaigns after which the ranks are first looked at, and at most; the number doubles from look to look."""


def hunt(bug: Bug) -> dict[str, Any]:
    """How many campaigns it takes until the ranks give a bug away, and which quantity does."""
    name = f"bug-{bug.kind}-" + "-".join(w for w in bug.name.replace(":", " ").replace(",", " ").split())
    count = FIRST
    while True:
        results = parts.finish(name, count, bug.task)
        p_values = {q: ranks.p_value(values) for q, values in pages.collected(results).items()}
        by = min(p_values, key=lambda q: p_values[q])
        least = ranks.least_of(list(p_values.values()))
        if least < LEVEL or count >= MOST:
            caught = count if least < LEVEL else None
            return {
                "bug": bug.name,
                "kind": bug.kind,
                "campaigns": count,
                "caught": caught,
                "by": by,
                "p": least,
                "commits": sorted({r["commit"] for r in results}),
            }
        count *= 2


@pytest.mark.prove
def test_every_planted_bug_is_caught():
    found = [hunt(bug) for bug in (*BUGS, *SOUND)]
    pages.bugs(found, LEVEL)
    assert [row["bug"] for row in found if (row["caught"] is None) is not row["bug"].startswith("none")] == []


def test_there_are_eight_bugs_or_more():
    assert len({bug.name for bug in BUGS}) == len(BUGS) >= 8
