"""What plan.json holds (schema bayes-damper/plan/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict


class Sized(TypedDict):
    """A size of an effect's parameter."""

    value: float
    unit: str


class Rival(TypedDict):
    """The effect that is hardest to distinguish from another, and the nats between them."""

    name: str
    nats: float


class PlannedEffect(TypedDict):
    """What the planned trials could show of one effect; counts are None above 100 times the trials planned."""

    name: str
    title: NotRequired[str]
    site: str
    variant: str
    typical: Mapping[str, Sized]
    nats: float
    chance: float
    smallest: Mapping[str, Sized] | None
    rival: Rival | None
    repeats_needed: int | None
    repeats_to_see: int | None


class PlannedParameter(TypedDict):
    """What the planned trials would teach about a parameter."""

    unit: str
    prior90: Sequence[float]
    expected90: Sequence[float]
    sd_over_prior: float


class Addition(TypedDict, total=False):
    """A single trial that would help, in the units of its rig."""

    configuration: str
    k1t_n_m_per_rad: float
    theta0_deg: float
    k1_n_per_m: float
    theta0_mm: float
    nats: float
    helps: Sequence[str]


class PlanFile(TypedDict):
    """All of plan.json."""

    schema: str
    campaign: str
    nominal: str
    trials: int
    held_out: int
    noise: Sequence[float]
    duration_s: float | None
    nats_needed: float
    effects: Sequence[PlannedEffect]
    matrix: Mapping[str, Mapping[str, float]]
    invisible: Sequence[str]
    indistinguishable: Sequence[Sequence[str]]
    parameters: Mapping[str, PlannedParameter]
    add: Sequence[Addition]
    sentences: list[str]
    campaign_sha256: NotRequired[str]
    seed: NotRequired[int]
    provenance: NotRequired[Mapping[str, object]]
