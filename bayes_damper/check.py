"""`bayes-damper check`: is this campaign readable, and what in it looks odd?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper.campaign import Trial, load_campaign
from bayes_damper.errors import ExitCode
from bayes_damper.published import load_published


@dataclass(frozen=True)
class Check:
    """A campaign that can be read: what it holds, and sentences on what looks odd."""

    name: str
    description: str
    warnings: tuple[str, ...]
    sha256: str
    exit_code: ExitCode = ExitCode.DONE

    def text(self) -> str:
        """For people."""
        return f"{self.description}\n{'No fault; read the warnings.' if self.warnings else 'No fault found.'}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "schema": "bayes-damper/check/1",
            "campaign": self.name,
            "campaign_sha256": self.sha256,
            "description": self.description,
            "warnings": list(self.warnings),
        }


def check(campaign: str | Path) -> Check:
    """Read and validate a campaign folder, or ``thesis``, the published measurements.

    Raises
    ------
    InputError
        with a sentence for every fault: file, line, column, what was expected, what to do.
    """
    if str(campaign) == "thesis":
        published = load_published()
        cases = ", ".join(published.cases)
        text = f"thesis: cases {cases}; {len(published.measurements)} published measurements (Augustine 2013)"
        return Check("thesis", text, (), published.checksum)
    found = load_campaign(campaign)
    copies = tuple(_copies(found.trials))
    text = "\n".join([found.describe(), *(f"  warning: {w}" for w in copies)])
    return Check(found.name, text, (*found.warnings, *copies), found.sha256)


def _copies(trials: Sequence[Trial]) -> Iterator[str]:
    """Trials whose readings are those of an earlier one: noise never repeats itself."""
    seen: dict[bytes, Trial] = {}
    for trial in trials:
        readings = np.ascontiguousarray(trial.channels[0]).tobytes()
        first = seen.setdefault(readings, trial)
        if first is not trial:
            yield (
                f"{trial.file} holds the same readings as {first.file}: a trial that is there twice counts twice and "
                "hides how trials scatter; remove one of them"
            )
