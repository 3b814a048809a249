"""What comparison.json holds (schema bayes-damper/comparison/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict

from bayes_damper.runs.contents.diagnosis import DiagnosisFile
from bayes_damper.runs.contents.fit import FitFile, PriorEntry
from bayes_damper.runs.contents.variability import VariabilityFile


class FolderContents(TypedDict, total=False):
    """The files of results that a folder holds."""

    fit: FitFile
    diagnosis: DiagnosisFile
    variability: VariabilityFile


class ComparedCell(TypedDict):
    """A parameter in one folder, and its distance from the first folder's, in standard deviations of the difference."""

    unit: str
    median: float
    mean: float
    sd: float
    hdi90: Sequence[float]
    distance_sd: NotRequired[float]


ComparedTable = Mapping[str, Mapping[str, Mapping[str, ComparedCell]]]
"""Case -> parameter -> folder -> cell."""
ComparedRows = Mapping[str, Mapping[str, float | str]]
"""Row -> folder -> value."""


class ComparisonFile(TypedDict):
    """All of comparison.json; folders go by the shortest endings of their paths that differ."""

    schema: str
    folders: Mapping[str, str]
    campaigns: Mapping[str, str]
    campaign_sha256: Mapping[str, str]
    converged: Mapping[str, bool]
    parameters: ComparedTable
    evidence: Mapping[str, Mapping[str, float]]
    heldout: Mapping[str, Mapping[str, float]]
    diagnosis: ComparedRows
    variability: ComparedRows
    prior_sensitivity: Mapping[str, Mapping[str, Mapping[str, PriorEntry]]]
    sentences: Sequence[str]
    provenance: Mapping[str, object]
