"""Where data come from: the recorded trials of a campaign, or the published numbers of the thesis.

Both have a name, a checksum, cases and priors. That `thesis` in place of a folder means the published numbers is
decided here alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bayes_damper.campaign import Campaign, load_campaign
from bayes_damper.errors import InputError
from bayes_damper.priors.files import PriorSet, campaign_priors, load_priors
from bayes_damper.published.measurements import Published, load_published

THESIS = "thesis"
"""What names the published numbers wherever a folder is expected, and their prior file."""


def is_published(campaign: object) -> bool:
    """Whether what a command or a plan names as its campaign is the published numbers."""
    return str(campaign) == THESIS


@dataclass(frozen=True)
class PublishedSource:
    """The 24 published numbers."""

    published: Published
    name: str = THESIS

    @property
    def sha256(self) -> str:
        """Checksum over all files."""
        return self.published.checksum

    @property
    def cases(self) -> tuple[str, ...]:
        """Labels of the cases."""
        return tuple(self.published.cases)

    def priors(self, file: str | Path | None = None) -> PriorSet:
        """Those of a file, by default the shipped ones; InputError with every fault of the file."""
        return load_priors(file or THESIS)


@dataclass(frozen=True)
class RecordedSource:
    """The trials of a campaign that lies in a folder."""

    campaign: Campaign
    folder: Path

    @property
    def name(self) -> str:
        """The name that the campaign gives itself."""
        return self.campaign.name

    @property
    def sha256(self) -> str:
        """Checksum over all files."""
        return self.campaign.sha256

    @property
    def cases(self) -> tuple[str, ...]:
        """Labels of the cases."""
        return self.campaign.cases

    def priors(self, file: str | Path | None = None) -> PriorSet | None:
        """Those of a file, else of priors.toml in the folder, else None; InputError with every fault of the file."""
        beside = self.folder / "priors.toml"
        chosen = file if file is not None else beside if beside.exists() else None
        return None if chosen is None else campaign_priors(chosen, self.campaign)


Source = PublishedSource | RecordedSource


def source_of(campaign: str | Path) -> Source:
    """The source that a command's argument names.

    Raises
    ------
    InputError
        with every fault of every file.
    """
    if is_published(campaign):
        return PublishedSource(load_published())
    return RecordedSource(load_campaign(campaign), Path(campaign))


def unchanged(campaign: str, sha256: object, since: str) -> Campaign:
    """The campaign that a plan names, if it still has the plan's checksum.

    Raises
    ------
    InputError
        if it cannot be read, or has changed `since`, words that also say what to do then.
    """
    found = load_campaign(campaign)
    if found.sha256 != sha256:
        raise InputError(f"{campaign}: the campaign has changed since {since}")
    return found
