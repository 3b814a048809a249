"""`bayes-damper check`: is this campaign readable, and what in it looks odd?"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_damper.campaign.head import read_head
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.priors.files import load_priors
from bayes_damper.published.sources import PublishedSource, source_of
from bayes_damper.text import Printable


@dataclass(frozen=True)
class Check(Printable):
    """A campaign that can be read: what it holds, and sentences on what looks odd."""

    name: str
    description: str
    warnings: tuple[str, ...]
    sha256: str
    next: str = ""
    """The command to run next."""
    exit_code: ExitCode = ExitCode.DONE

    def text(self) -> str:
        """For people."""
        found = "No fault; read the warnings." if self.warnings else "No fault found."
        return f"{self.description}\n{found} Next: {self.next}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "schema": "bayes-damper/check/1",
            "campaign": self.name,
            "campaign_sha256": self.sha256,
            "description": self.description,
            "warnings": list(self.warnings),
            "next": self.next,
        }


def check(campaign: str | Path, notes: Sequence[str] = ()) -> Check:
    """Read and validate a campaign folder with its priors.toml, or ``thesis``, the published measurements.

    notes : sentences on the folder that its campaign does not give; they become warnings.

    Raises
    ------
    InputError
        with a sentence for every fault: file, line, column, what was expected, what to do.
    """
    try:
        source = source_of(campaign)
    except InputError as error:
        raise InputError([*error.faults, *_faults_of_priors(Path(campaign))]) from None
    if isinstance(source, PublishedSource):
        cases, numbers = ", ".join(source.cases), len(source.published.measurements)
        text = f"{source.name}: cases {cases}; {numbers} published measurements (Augustine 2013)"
        return Check(source.name, text, (), source.sha256, f"bayes-damper fit {source.name} --out results/fit")
    found = source.campaign
    if (priors := source.priors()) is not None:
        from bayes_damper.calibration import experiment_of

        experiment_of(found, priors)
    lines = "\n".join([found.describe(), *(f"  warning: {note}" for note in notes)])
    follows = f"bayes-damper fit {shlex.quote(str(campaign))} --out results/fit"
    return Check(found.name, lines, (*found.warnings, *notes), found.sha256, follows)


def _faults_of_priors(folder: Path) -> list[str]:
    """Those of priors.toml in the folder of a campaign that cannot be read; its units are of the rig's kind."""
    file = folder / "priors.toml"
    if not file.exists():
        return []
    head = read_head(folder, [], hashlib.sha256())
    if head is None or head.broken:
        return [f"{file}: not read yet: campaign.toml must say first which units its entries have"]
    try:
        load_priors(file, kind=head.rig.kind, quantity=head.measurement.quantity, recorded=True)
    except InputError as error:
        return list(error.faults)
    return []
