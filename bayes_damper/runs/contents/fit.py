"""What summary.json holds (schema bayes-damper/fit/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NotRequired, TypedDict

from bayes_damper.runs.contents.diagnosis import ScatterEntry, Side


class Assumed(TypedDict):
    """A parameter before any data."""

    median: float
    hdi90: Sequence[float]


class ParameterEntry(TypedDict):
    """A parameter's posterior and its health; r_hat and ess are None where they cannot be computed."""

    unit: str
    mean: float
    sd: float
    median: float
    hdi90: Sequence[float]
    quartiles: NotRequired[Sequence[float]]
    r_hat: float | None
    ess_bulk: float | None
    ess_tail: float | None
    prior_share: float | None
    prior: NotRequired[Assumed]


class CheckEntry(TypedDict):
    """A measured feature beside what the posterior predicts for it."""

    name: str
    unit: str
    measured: float
    standard_error: float
    median: float
    hdi50: Sequence[float]
    hdi90: Sequence[float]
    percentile: float


class ChannelEntry(TypedDict):
    """Noise of one channel: what repeats differ by, what its fast content has, and what the model leaves."""

    channel: int
    unit: str
    repeats: float | None
    fast_content: float
    left: float
    left_over_floor: float | None
    correlation: float
    used: float
    learnt_from: str


class NoiseEntry(TypedDict, total=False):
    """The noise model of the readings."""

    model: str
    chosen_by: str
    freedom: float | None
    channels: Sequence[ChannelEntry]


class TrialUnknown(TypedDict):
    """What one trial has for itself."""

    mean: float
    sd: float
    hdi90: Sequence[float]
    unit: str


class InfluenceEntry(TypedDict):
    """How far parameters move where a trial is left out, in standard deviations."""

    moves_most: str
    shift_sd: float
    shifts_sd: Mapping[str, float]


class UnlikeTrial(TypedDict):
    """A trial unlike its repeats, by the power of its residuals over theirs."""

    trial: str
    residual_power: float
    or_its_only_repeat: bool


Compared = TypedDict("Compared", {"with": Side, "without": Side, "shift_sd": float})
"""A parameter with all trials and without some, and the shift in standard deviations."""


class UnlikeEntry(TypedDict):
    """Trials unlike their repeats, and the parameters without them (None where too little would be left)."""

    trials: Sequence[UnlikeTrial]
    answers: Mapping[str, Compared] | None


class WidthEntry(TypedDict):
    """What another width of one prior does to its parameter, and to the other that it moves most."""

    shift: float
    width: float
    moves_most: str
    shift_of_that: float
    effective_share: float
    reliable: bool


class PriorEntry(TypedDict):
    """A prior half and twice as wide."""

    prior_share: float
    decided_by: str
    half: WidthEntry
    double: WidthEntry


class EvidenceEntry(TypedDict):
    """Evidence of the readings, nats."""

    value: float
    error: float
    health: float
    spread_of_halves: float
    evaluations: int
    sentence: str


class BestFitEntry(TypedDict):
    """The fit that sampling begins from."""

    chi2: float
    readings: float
    log_evidence_laplace: float
    noise_learnt: Sequence[float]
    noise_correlation: Sequence[float]
    constants_pulled: Mapping[str, float]
    effect: str | None
    formula: str | None
    meanings: NotRequired[Mapping[str, str]]
    """Of the parameters of the effect, in the words of the rig."""


class CaseEntry(TypedDict, total=False):
    """One run: a case, or all together."""

    converged: bool
    parameters: Mapping[str, ParameterEntry]
    sentences: list[str]
    steps: int
    autocorrelation_steps: float
    acceptance: Sequence[float]
    evaluations: int
    outcomes: Mapping[str, int]
    stranded_walkers: Sequence[Sequence[int]]
    noise: NoiseEntry
    scatter: Mapping[str, ScatterEntry]
    influence: Mapping[str, InfluenceEntry]
    unlike_repeats: UnlikeEntry | None
    prior_sensitivity: Mapping[str, PriorEntry]
    log_evidence: EvidenceEntry
    trials: Mapping[str, Mapping[str, TrialUnknown]]
    best_fit: BestFitEntry
    predictive: Sequence[CheckEntry]


class FitFile(TypedDict, total=False):
    """All of summary.json."""

    schema: str
    campaign: str
    campaign_sha256: str
    seed: int
    converged: bool
    warnings: Sequence[str]
    warnings_of_check: int
    cases: Mapping[str, CaseEntry]
    joint: CaseEntry
    provenance: Mapping[str, object]


class FitPlan(TypedDict):
    """Everything that decides the results of a fit, as plain data."""

    campaign: str
    name: str
    campaign_sha256: str
    cases: Sequence[str]
    joint: bool
    priors: dict[str, Any] | None
    normal_force: Literal["linear", "constant"] | None
    noise: str
    effect: str | None
    effects: str | None
    effects_sha256: str | None
    seed: int
    thorough: bool
    most_steps: int | None
