"""What variability.json holds (schema bayes-damper/variability/1), and what the runs behind it return."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NotRequired, TypedDict

Pooling = Literal["shared", "separate", "partial"]
LinearName = Literal["k2t", "c2t"]
LINEAR_NAMES: tuple[LinearName, ...] = ("k2t", "c2t")
"""Parameters of the linear model of which effective values are given."""


class Interval(TypedDict):
    """Median and 90 % interval of draws; nan where fewer than two of them are finite."""

    median: float
    hdi90: Sequence[float]


class ScatterOfCases(Interval):
    """Scatter of a parameter over the cases, as a share of what its prior allows; of ln x if that is lognormal."""

    probability_below_a_quarter: float
    scatter_of_ln: NotRequired[Interval]


class UnseenEntry(TypedDict):
    """Score of data that a model has not seen: published features of each case from the others, or held-out trials."""

    what: str
    log_score: float | None
    cases: Mapping[str, float]
    error: NotRequired[float | None]
    trials: NotRequired[Mapping[str, Mapping[str, float]]]


class PoolingEntry(TypedDict, total=False):
    """One of the three answers. parameters : of one set for all cases; cases : case -> name; scatter : over the cases.

    Of published features also how the runs went: what particles remember of their start, and how far the means of
    repeats lie apart, in standard deviations.
    """

    log_evidence: float
    error: float
    spread: float
    probability: float
    heldout: UnseenEntry
    unseen_case: Mapping[str, float]
    parameters: Mapping[str, Interval]
    cases: Mapping[str, Mapping[str, Interval]]
    scatter: Mapping[str, ScatterOfCases]
    memory: float
    last_memory: float
    particles: int
    repeats: int
    repeats_apart_sd: float | None
    monte_carlo_error_sd: float
    largest_monte_carlo_error_sd: float
    largest_monte_carlo_error_at: str


class AveragedEntry(TypedDict):
    """Averaged over the three answers: of each case, of a case not yet measured, and where all cases are alike."""

    cases: Mapping[str, Mapping[str, Interval]]
    further: Mapping[str, Interval]
    alike: Mapping[str, float]
    prior: Mapping[str, Sequence[float]]
    common: Mapping[str, Interval]


class AssumptionEntry(TypedDict):
    """The answer under other assumptions, the first row being those as they are."""

    change: str
    probabilities: Mapping[Pooling, float]
    probability_errors: Mapping[Pooling, float]
    averaged: AveragedEntry
    log_evidence: NotRequired[Mapping[Pooling, float]]


class KeptEntry(TypedDict):
    """Of a parameter, over all assumptions and cases: range of medians, union of intervals, its share of the prior."""

    medians: Sequence[float]
    hdi90: Sequence[float]
    share_of_prior: float
    survives: bool


class SurvivesEntry(TypedDict):
    """What holds under all assumptions: the range of each answer's probability, and parameters."""

    structures: Mapping[Pooling, Sequence[float]]
    parameters: Mapping[str, KeptEntry]


class TwoWays(TypedDict):
    """A value by draws used again, and directly."""

    recycled: Interval
    direct: Interval


class TwoWaysOfParameter(TypedDict):
    """A parameter both ways: its common value, its scatter, and its value in each case."""

    common: TwoWays
    scatter: TwoWays
    cases: Mapping[str, TwoWays]


class AgreementEntry(TypedDict):
    """Partial pooling by the fit's draws used again, beside the direct way; differences in standard deviations."""

    ess: Mapping[str, float]
    pareto_k: Mapping[str, float]
    ess_of_one_population: Mapping[str, float]
    draws: int
    drawn_again: bool
    reliable: bool
    log_evidence_over_separate: float
    error: float
    direct_log_evidence_over_separate: float
    direct_error: float
    direct_repeats_apart_sd: float
    parameters: Mapping[str, TwoWaysOfParameter]
    differences_sd: Mapping[str, float]
    largest_difference_sd: float
    largest_at: str
    allowed_difference_sd: float
    agree: bool


class PartEntry(Interval):
    """A part of the variance of ln k2t or ln c2t over the cases, its share, and what the prior expected of it."""

    share: Interval
    before_the_data: NotRequired[Interval]


class DecompositionEntry(TypedDict):
    """Where the variance of ln k2t or ln c2t over the cases comes from, beside that of linear fits to measurements."""

    friction_at_another_amplitude: PartEntry
    measurement_scatter: PartEntry
    real_difference: PartEntry
    covariance: Interval
    expected_total: Interval
    probability_largest: Mapping[str, float]
    measured: NotRequired[float]
    measured_percentile: NotRequired[float]
    rounding_of_the_measured: NotRequired[float]


class EffectiveCase(TypedDict):
    """Effective k2t and c2t of one case at its initial energy, the misfit of the linear model, what was measured."""

    k2t: Interval
    c2t: Interval
    energy_j: float
    misfit: float
    inside: float
    measured: NotRequired[Mapping[LinearName, float]]


class Band(TypedDict):
    """Median and 90 % band along a curve."""

    median: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]


class EffectiveCurve(TypedDict):
    """Effective k2t and c2t of one rig against its initial energy."""

    energy_j: Sequence[float]
    k2t: Band
    c2t: Band


class EffectiveEntry(TypedDict):
    """Effective linear parameters: of each case, and as curves of one rig."""

    cases: Mapping[str, EffectiveCase]
    curves: Mapping[str, EffectiveCurve]


class VariabilityFile(TypedDict, total=False):
    """All of variability.json."""

    schema: str
    campaign: str
    campaign_sha256: str | None
    seed: int
    converged: bool
    kind: str
    cases: Sequence[str]
    pooled: Sequence[str]
    common: Sequence[str]
    method: str
    models: Mapping[str, PoolingEntry]
    averaged: AveragedEntry
    assumptions: Sequence[AssumptionEntry]
    survives: SurvivesEntry
    recycled: AgreementEntry | None
    effective: EffectiveEntry | None
    decomposition: Mapping[LinearName, DecompositionEntry] | None
    method_of_effective: str | None
    would_settle: Sequence[str]
    warnings: Sequence[str]
    warnings_of_check: NotRequired[int]
    sentences: Sequence[str]
    provenance: Mapping[str, object]


class PoolingRun(TypedDict, total=False):
    """What one run returns: its evidence from the prior, or what it gains on the way to other assumptions."""

    log_z: float
    gain: float
    error: float
    stages: int
    memory: float
    last_memory: float
    particles: int
    evaluations: int


class FittedPlan(TypedDict):
    """What is taken of the plan of a fit, and whether the fit converged."""

    campaign: str
    name: str
    campaign_sha256: str
    cases: Sequence[str]
    priors: dict[str, Any] | None
    normal_force: Literal["linear", "constant"] | None
    noise: NotRequired[str]
    effect: NotRequired[str | None]
    fit_converged: NotRequired[bool]


class PoolingSettings(TypedDict):
    """What decides the runs of a comparison of published cases."""

    fit: FittedPlan
    seed: int
    particles: int
    repeats: int
