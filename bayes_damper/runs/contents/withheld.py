"""What withheld.json holds (schema bayes-damper/withheld/1), and the files sealed behind it: freeze, verdicts, key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NotRequired, TypedDict

from bayes_damper.runs.contents.diagnosis import DiagnosisFile, Forecasts


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


RateName = Literal[
    "right_first", "accepted_first", "none_kept", "unknown_first", "truth_in_credible_set", "credible_set_size",
    "false_and_confident", "false_and_likely", "site", "site_of_unknown", "site_of_unknown_in_set", "pairs_both_named",
    "pairs_one_named", "closed_median", "closed_tenth", "log_score", "brier", "coverage90", "scatter90", "gap_test_5",
    "bands50", "bands90", "seconds",
]  # fmt: skip
"""Figures of a summary that are rates, or statistics with an interval."""


class SummaryEntry(TypedDict):
    """All scores of a set of campaigns."""

    campaigns: int
    failed: int
    hidden: int
    right_first: Rate
    accepted_first: Rate
    none_kept: Rate
    unknown_first: Rate
    truth_in_credible_set: Rate
    credible_set_size: Rate
    false_and_confident: Rate
    false_and_likely: Rate
    site: Rate
    site_of_unknown: Rate
    site_of_unknown_in_set: Rate
    pairs_both_named: Rate
    pairs_one_named: Rate
    closed_median: Rate
    closed_tenth: Rate
    log_score: Rate
    brier: Rate
    coverage90: Rate
    coverage90_by_parameter: Mapping[str, Rate]
    scatter90: Rate
    gap_test_5: Rate
    bands50: Rate
    bands90: Rate
    seconds: Rate


class ClassEntry(SummaryEntry):
    """Scores of a class of laboratories, with its calibration."""

    reliability: Reliability


Counts = Mapping[str, Mapping[str, int]]
"""Truth -> answer -> number of campaigns."""


class ScoresEntry(TypedDict):
    """Everything that is scored of a set of verdicts."""

    all: SummaryEntry
    by_kind: Mapping[str, SummaryEntry]
    by_level: Sequence[LevelRow]
    by_class: Mapping[str, ClassEntry]
    confusion: Counts
    sites: Counts
    reliability: Mapping[str, Reliability]
    targets: Sequence[Judged]
    misses: Sequence[str]


class RemovedEffect(TypedDict):
    """Of campaigns of one effect, diagnosed without it."""

    unknown_first: Rate
    site: Rate
    taken_for: Mapping[str, int]


class RemovedEntry(TypedDict):
    """Scores of campaigns diagnosed without their effect in the library."""

    campaigns: int
    visible: int
    unknown_first: Rate
    site: Rate
    site_in_set: Rate
    false_and_confident: Rate
    by_effect: Mapping[str, RemovedEffect]
    misses: Sequence[str]


class ComparedScores(TypedDict):
    """The figures by which a baseline is held against the diagnosis."""

    campaigns: int
    accepted_first: Rate
    log_score: Rate
    brier: Rate
    false_and_confident: Rate


class BaselineEntry(TypedDict):
    """A baseline and the diagnosis on the same campaigns."""

    baseline: ComparedScores
    diagnosis: ComparedScores
    better_log_score: str


class LeftOutCase(TypedDict):
    """What the leading effect closes of a case that was left out of its fit."""

    case: str
    closed: float | None


class BaselineAnswers(TypedDict, total=False):
    """Probabilities of every answer by each baseline on the same fits, and what the forest learns from."""

    bic: Mapping[str, float]
    bic_gate: Mapping[str, float]
    stacking: Mapping[str, float]
    sparse_regression: Mapping[str, float]
    features: Sequence[float]


class Verdict(DiagnosisFile, total=False):
    """A sealed verdict: a diagnosis, with what the scores need beyond it; `error` where it failed."""

    baselines: BaselineAnswers
    intervals90: Mapping[str, Sequence[float]]
    left_out_case: LeftOutCase
    error: str


class Disturbance(TypedDict):
    """A disturbance of the simulated rig; shape of a knock: start and length in s, size."""

    shape: Sequence[float]


class Laboratory(TypedDict, total=False):
    """Which class of laboratories a campaign is of."""

    repeats: bool
    bodies: int
    scatter_class: str


KeyEntry = TypedDict(
    "KeyEntry",
    {
        "kind": str, "truth": str, "standing": str, "effects": Sequence[str], "site": str | list[str],
        "class": NotRequired[Sequence[str]], "level_wanted": float, "visible_chi2": float,
        "nominal": Mapping[str, float], "at_rest": NotRequired[Mapping[str, float]],
        "scatter": NotRequired[Mapping[str, float]], "disturbances": NotRequired[Sequence[Disturbance]],
        "laboratory": NotRequired[Laboratory],
    },
)  # fmt: skip
"""What the key says of a campaign: truth and standing, its class and sites, how visible it is, the true parameters."""


class Freeze(TypedDict):
    """What a run is bound to, by checksums; `seal` once it is written. A seal of data alone has no checksum of code."""

    schema: str
    key_sha256: str
    campaigns: Mapping[str, str]
    written: str
    bayes_damper: NotRequired[str]
    commit: NotRequired[str | None]
    code_sha256: NotRequired[str]
    effects_sha256: NotRequired[str]
    effects: NotRequired[Sequence[str]]
    seed: NotRequired[int]
    call: NotRequired[str]
    seal: NotRequired[str]


class SealedVerdict(TypedDict):
    """A verdict bound to its campaign, to the freeze and to the code that gave it."""

    schema: str
    campaign: str
    freeze: str
    code_sha256: str
    verdict: Verdict
    seal: str


class CampaignEntry(Verdict, total=False):
    """What withheld.json repeats of a sealed verdict, with its score."""

    probability: float
    score: ScoreEntry


class WithheldFile(TypedDict, total=False):
    """All of withheld.json; parts : the runs, where several are scored together."""

    schema: str
    rehearsal: bool
    why_rehearsal: Sequence[str]
    folder: str
    full: bool
    seed: int
    freeze: Mapping[str, object]
    parts: Sequence[Mapping[str, object]]
    chain_head: str
    campaigns: Mapping[str, CampaignEntry]
    scores: ScoresEntry
    leave_one_out: RemovedEntry | None
    baselines: Mapping[str, BaselineEntry]
    baselines_skipped: Sequence[str]
    provenance: Mapping[str, object]
    bound_to_code: bool


class UnderTheAnswer(TypedDict, total=False):
    """What the scores need of the leading answer: forecasts, intervals, a case left out."""

    forecast: Forecasts
    intervals90: Mapping[str, Sequence[float]]
    left_out_case: LeftOutCase


class VerifiedFile(TypedDict):
    """What holding an archive's seals found."""

    schema: str
    archive: str
    verdicts: int
    chain_head: str
    freeze: Mapping[str, object]
    data_held: bool
    found: Sequence[str]
