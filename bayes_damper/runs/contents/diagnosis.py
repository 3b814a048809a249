"""What diagnosis.json holds (schema bayes-damper/diagnosis/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict


class Estimate(TypedDict):
    """A parameter of an effect: mean, sd, 90 % interval, and its variance over that of its prior."""

    unit: str
    mean: float
    sd: float
    hdi90: Sequence[float]
    median: NotRequired[float]
    prior_share: NotRequired[float]
    meaning: NotRequired[str]


class Share(TypedDict):
    """A share of the gap; median and interval are None where there is no gap of which one could be given."""

    median: float | None
    hdi90: Sequence[float] | None
    method: NotRequired[str]
    how: NotRequired[str]


class GapEntry(TypedDict):
    """The test of the gap; rms in the unit of the readings, or in `unit`."""

    answer: str
    p_value: NotRequired[float]
    size: float
    noise_rms: float
    nominal_rms: float
    nominal_rms_hdi90: NotRequired[Sequence[float]]
    augmented_rms: float | None
    closed: Share | None
    upper_rms_over_noise: NotRequired[float | None]
    why: NotRequired[str]
    taken_up: NotRequired[Mapping[str, float]]
    unit: NotRequired[str]
    on: NotRequired[str]
    mean_difference: NotRequired[float]


class PairEntry(TypedDict):
    """Two effects at once, the stronger first."""

    effects: Sequence[str]
    probability: float
    log_evidence: NotRequired[float]
    gain: NotRequired[float]
    parameters: NotRequired[Mapping[str, Mapping[str, Estimate]]]


class FormulaEntry(TypedDict):
    """One formula of an effect, weighed against published numbers."""

    variant: str
    formula: str
    log_evidence: float
    log_evidence_error: float
    effective_draws: float
    spread_of_repeats: float
    acts: bool
    parameters: Mapping[str, Estimate]


class EffectEntry(TypedDict, total=False):
    """One effect with its best formula."""

    name: str
    variant: str
    formula: str
    site: str
    title: str
    meaning: str
    probability: float
    log_evidence: float
    log_evidence_error: float
    effective_draws: float
    spread_of_repeats: float
    acts: bool
    variants: Sequence[FormulaEntry]
    fitted: bool
    augmented_rms: float | None
    closed: Share | None
    parameters: Mapping[str, Estimate]


class BudgetPart(TypedDict):
    """An effect of the budget, with its share of the gap."""

    name: str
    variant: str
    formula: str
    site: str
    present: float
    share: Share
    parameters: Mapping[str, Estimate]
    title: NotRequired[str]
    meaning: NotRequired[str]


class AbsentPart(TypedDict):
    """An effect that was fitted and closes nothing."""

    name: str
    present: float
    share: Share


class Unexplained(TypedDict):
    """What no effect of the budget closes, where it lies, and the file of the law that was learnt for it."""

    share: Share
    sites: Mapping[str, float]
    law: str | None


class BudgetEntry(TypedDict):
    """The gap divided among effects."""

    effects: Sequence[BudgetPart]
    unexplained: Unexplained
    leading: Mapping[str, float]
    absent: Sequence[AbsentPart]
    method: str


class TermEntry(TypedDict):
    """A term of a short formula: amount and sd, and its shape parameter where it has one."""

    term: str
    amount: float
    sd: float
    unit: str
    shape: NotRequired[str]
    value: NotRequired[float]
    value_sd: NotRequired[float]
    value_unit: NotRequired[str]


class NamedFormula(TypedDict):
    """A short formula that may stand for a learnt law."""

    formula: str
    probability: float
    fitted: bool
    terms: Sequence[TermEntry]


class NamedEntry(TypedDict):
    """The best short formulas, and the probability that it is none of the grammar."""

    formulas: Sequence[NamedFormula]
    shape_only: float
    grammar: str


class LawEntry(TypedDict):
    """A law that was learnt in place of a cause without a name."""

    site: str
    bodies: str
    effect: str
    file: str
    formula: str
    beside: Sequence[str]
    closes: Share
    closes_of_the_rest: Share
    effective_degrees_of_freedom: float
    ranges: Mapping[str, Sequence[float]]
    named: NamedEntry | None
    parameters: Mapping[str, object]
    tables: Sequence[str]


class Place(TypedDict, total=False):
    """A place where residuals exceed the noise: a stretch of time, a band, a channel, a case or a region of motion."""

    start_s: float
    end_s: float
    low_hz: float
    high_hz: float
    case: str | None
    label: str
    configuration: str | None
    channel: int
    trial: int
    trials: Sequence[int]
    coordinates: Sequence[str]
    range: Sequence[Sequence[float]]
    excess_over_noise: float


class PlaceEntry(Place, total=False):
    """A place with its p-value, made up for all looks of its kind."""

    p_value: float


class EventEntry(TypedDict):
    """A short torque at one instant, the same in all trials."""

    instant_s: float
    start_s: float
    end_s: float
    site: str
    impulse_n_m_s: float
    impulse_sd_n_m_s: float
    gain_nats: float
    share: float
    local: bool


class FeatureEntry(TypedDict):
    """A published number beside what a model predicts for it."""

    case: str
    configuration: str
    feature: str
    unit: str
    measured: float
    standard_error: float
    predicted: float
    predicted_hdi90: Sequence[float]
    held_out: bool
    p_value: float


class CombinedEntry(TypedDict):
    """The smallest p-value of a group of published numbers, times how many they are."""

    name: str
    numbers: int
    p_value: float


class WhereRecords(TypedDict):
    """Where the residuals of records exceed the noise."""

    time: Sequence[PlaceEntry]
    frequency: Sequence[PlaceEntry]
    channel: Mapping[str, PlaceEntry]
    case: Mapping[str, PlaceEntry]
    phase_space: Sequence[PlaceEntry]
    event: EventEntry | None


class WherePublished(TypedDict):
    """Published numbers beside the nominal model, one by one and in groups."""

    feature: Sequence[FeatureEntry]
    case: Sequence[CombinedEntry]
    configuration: Sequence[CombinedEntry]
    quantity: Sequence[CombinedEntry]


class ProposalEntry(TypedDict, total=False):
    """A trial or a measurement that would decide between the leading answers, in the units of its rig."""

    configuration: str
    k1t_n_m_per_rad: float
    theta0_deg: float
    k1_n_per_m: float
    theta0_mm: float
    measurement: str
    expected_information_nats: float
    margin: float


class Side(TypedDict):
    """A parameter under one of two models."""

    value: float
    sd: float


class ShiftEntry(TypedDict, total=False):
    """A parameter before and after an effect is added; the shift in standard deviations of the value after."""

    before: Side
    after: Side
    shift_sigmas: float
    unit: str


class ForecastEntry(TypedDict):
    """Forecasts of one model: rms miss, share of readings inside each band, median width of the 90 % band."""

    rms: float
    rms_by_channel: Sequence[float]
    coverage50: float
    coverage90: float
    width90: float
    rms_whole: NotRequired[float]


class ForecastSides(TypedDict, total=False):
    """Forecasts by the nominal model, with the answer, and by all answers weighted."""

    before: ForecastEntry
    after: ForecastEntry
    averaged: ForecastEntry


class TrialForecast(ForecastSides):
    """Forecasts of one held-out trial."""

    file: str
    case: str
    configuration: str
    trial: int
    seen_s: float
    readings: int


class Forecasts(ForecastSides, total=False):
    """Held-out trials forecast from their first periods."""

    periods: float
    bands: Sequence[float]
    trials: Sequence[TrialForecast]


class ChoiceEntry(TypedDict):
    """The verdict had something been chosen otherwise."""

    choice: str
    verdict: str
    probability: float
    probability_of_the_leading_answer: float


class UnderPrior(TypedDict):
    """The verdict under another prior probability of a cause outside the library."""

    prior: float
    verdict: str
    probability: float


class RigEntry(TypedDict, total=False):
    """What rig the records are of."""

    kind: str
    coupled: bool
    magnet: bool
    restoring: str


class CurveEntry(TypedDict):
    """Missing torque against one coordinate, in bins."""

    centre: Sequence[float]
    torque_n_m: Sequence[float]
    sd_n_m: Sequence[float]
    count: Sequence[int]


class ScatterEntry(TypedDict):
    """What differs from trial to trial."""

    sd: float
    unit: str
    hdi90: Sequence[float]
    trend_with_order: float


class SiteMapEntry(TypedDict):
    """Evidence and probability of each site, without any library."""

    sites: Mapping[str, float]
    log_evidence: Mapping[str, float]
    credible_set: Sequence[str]
    shape: Mapping[str, str]
    torque_site: str | None
    only: Mapping[str, str]
    curve: NotRequired[Mapping[str, CurveEntry]]


class LeftEntry(TypedDict):
    """What an answer leaves of the gap, as the rule takes it; None where a number is not finite."""

    nats: float | None
    share: float
    home: NotRequired[float]
    line: NotRequired[float]
    peak: NotRequired[float]
    lone: NotRequired[bool]
    readings: NotRequired[float | None]
    exact: NotRequired[bool]
    odd: NotRequired[float]


class WeighedPair(TypedDict):
    """A pair of effects as the rule takes it."""

    effects: Sequence[str]
    log_evidence: float
    left: LeftEntry


class WeighedEntry(TypedDict):
    """All that the rule makes the probabilities from."""

    before: LeftEntry
    after: LeftEntry
    excess: float
    drift: float | None
    pairs: Sequence[WeighedPair]
    definitions: NotRequired[Sequence[str]]
    usual: NotRequired[float]
    support: NotRequired[Mapping[str, float]]


class DiagnosisFile(TypedDict, total=False):
    """All of diagnosis.json, of records or of published numbers."""

    schema: str
    campaign: str
    campaign_sha256: str
    seed: int
    nominal: str
    verdict: str
    credible_set: Sequence[str]
    probabilities: Mapping[str, float]
    probability_errors: Mapping[str, float]
    pair: PairEntry | None
    sites: Mapping[str, float]
    gap: GapEntry
    where: WhereRecords | WherePublished
    next_experiment: Sequence[ProposalEntry]
    site_map: SiteMapEntry
    remainder_map: SiteMapEntry
    noise: Mapping[str, Sequence[float]]
    effects: Sequence[EffectEntry]
    unknown: Sequence[FormulaEntry]
    none: Mapping[str, float]
    parameters: Mapping[str, ShiftEntry]
    indistinguishable: Sequence[Sequence[str]]
    budget: BudgetEntry | None
    remainder: Mapping[str, float | None]
    sensitivity: Sequence[ChoiceEntry]
    prior_unknown: Sequence[UnderPrior]
    weighed: WeighedEntry
    scatter: Mapping[str, ScatterEntry]
    notes: Sequence[str]
    warnings: Sequence[str]
    warnings_of_check: NotRequired[int]
    seconds: float | None
    law: LawEntry | None
    forecast: Forecasts
    reading_unit: str
    rig: RigEntry
    provenance: Mapping[str, object]
