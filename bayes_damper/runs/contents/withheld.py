"""What withheld.json holds of scores (schema bayes-damper/withheld/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict


class Rate(TypedDict):
    """A figure with its 95 % interval over campaigns, all None where there is no campaign; hits: of a rate."""

    value: float | None
    interval95: Sequence[float] | Sequence[None]
    n: int
    hits: NotRequired[int]


class Judged(TypedDict):
    """A target beside what came out."""

    what: str
    where: str
    least: float | None
    most: float | None
    value: float | None
    interval95: Sequence[float] | Sequence[None]
    n: int
    enough: bool
    status: NotRequired[str]


Bin = TypedDict("Bin", {"from": float, "to": float, "confidence": float, "right": Rate, "twin95": Sequence[float]})
"""Answers of about the same probability, and how many of them were right."""


class Twin(TypedDict):
    """The calibration error of perfectly calibrated twins."""

    mean: float
    upper95: float


class Reliability(TypedDict):
    """Confidence against success."""

    n: int
    bins: Sequence[Bin]
    error: float | None
    p_value: float | None
    confidence: NotRequired[float]
    success: NotRequired[float]
    twin_error: NotRequired[Twin]


class LevelRow(TypedDict):
    """Results of one kind at one strength of the effect."""

    kind: str
    level: float
    accepted_first: Rate
    right_first: Rate
    site: Rate
    closed_median: Rate
    rms_median: Mapping[str, float] | None


class ScoreEntry(TypedDict):
    """The score of one campaign."""

    kind: str
    truth: str
    standing: str
    level: float
    true_sites: Sequence[str]
    visible_chi2: float
    accepted: Sequence[str]
    right: bool
    truth_in_credible_set: bool
    probability_of_truth: float
    brier: float
    site_right: bool
