"""What a fit of a campaign does not know: parameters of the rig, of its sensors and of an effect, by their priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayes_damper.calibration.experiment import Experiment, TrialRecord
from bayes_damper.effects.base import Variant
from bayes_damper.priors.distributions import Distribution, Normal, from_standard, median, to_standard
from bayes_damper.rig.parameters import OF_EFFECT

Priors = Callable[[str, str], Distribution | float]
"""Of a parameter, by name and case: a distribution, or a number where it is fixed."""
TREND = "trend_"
NOMINAL = ("k2t", "c2t", "c1t", "c3t", "mu", "drag", "nu", "tail")


def coordinate_of(distribution: Distribution, x: float) -> float:
    """The standard Gaussian coordinate of the value `x`, cut to +-8."""
    return float(np.clip(to_standard(distribution, x), -8.0, 8.0))


def value_and_slope(distribution: Distribution, z: float, step: float = 1e-3) -> tuple[float, float]:
    """The value at a standard Gaussian coordinate, and its derivative by that."""
    value, near = (float(from_standard(distribution, x)) for x in (z, z + step))
    return value, (near - value) / step


@dataclass(frozen=True)
class Coordinate:
    """One unknown of the whole campaign, or of one `case` if that is given.

    role: "nominal", "release" (angle or instant), "constant", "stiffness" (k1t number `index`), "sensor" (scale of
    channel `index`), "lag" (of its readings, s), "trend" (how a parameter changes from the first trial to the last,
    TREND and its name) or "effect". shape : of an effect, whether it is a parameter of shape,
    which has no value at which the effect vanishes.
    """

    name: str
    role: Literal["nominal", "release", "constant", "stiffness", "sensor", "lag", "trend", "effect"]
    prior: Distribution
    index: int = 0
    case: str | None = None
    shape: bool = False

    @property
    def parameter(self) -> str:
        """The name without its case."""
        return self.name.partition("[")[0]

    def of_trial(self, trial: TrialRecord) -> bool:
        """Whether it belongs to a trial."""
        return trial.k1t == self.index if self.role == "stiffness" else self.case in (None, trial.case)


def coordinates_of(
    e: Experiment,
    used: Sequence[TrialRecord],
    nominal: Literal["nonlinear", "linear"],
    effect: Variant | None,
    prior: Priors,
) -> tuple[Coordinate, ...]:
    """The unknowns of a campaign that the trials in use share, under a nominal model and an effect."""
    coupled = any(t.coupled for t in used)
    names = ["k2t", "c2t", "c1t", "c3t"] if coupled else ["c1t"]
    if nominal == "nonlinear":
        names += ["mu", "drag", "nu", "tail"] if coupled and e.magnet else ["drag", "nu", "tail"]
    out = []
    alone = acting_alone(e)
    for name in dict.fromkeys(e.ties.get(n, n) for n in names):
        out += _shared(e, name, "nominal", [t for t in used if t.coupled or name in alone], prior)
    for name in ("theta0", "delay"):
        if e.start == "rest" and e.levels.get(name, "trial") != "trial":
            out += _shared(e, name, "release", used, prior)
    for name, (value, sd) in e.constants.items():
        if sd > 0.0 and (coupled or name == "J1"):
            out.append(Coordinate(name, "constant", Normal(value, sd)))
    for i, (value, sd) in enumerate(e.stiffnesses):
        if sd > 0.0 and any(t.k1t == i for t in used):
            label = "k1t" if len(e.stiffnesses) == 1 else f"k1t[{value:g}]"
            out.append(Coordinate(label, "stiffness", Normal(value, sd), i))
    for c, sd in enumerate(e.scale_sd[: 1 + int(coupled)]):
        if sd > 0.0:
            out.append(Coordinate(f"scale{c + 1}", "sensor", Normal(1.0, sd), c))
    for c, sd in enumerate(e.lag_sd[: 1 + int(coupled)]):
        if sd > 0.0:
            out.append(Coordinate(f"lag{c + 1}", "lag", Normal(0.0, sd), c))
    for name, sd in e.trends.items():
        if coupled or name in alone or name == "k1t":
            out.append(Coordinate(TREND + name, "trend", Normal(0.0, sd)))
    if effect is not None:
        out += [Coordinate(OF_EFFECT + p.name, "effect", p.prior, shape=p.null is None) for p in effect.parameters]
    return tuple(out)


def _shared(
    e: Experiment, name: str, role: Literal["nominal", "release"], trials: Sequence[TrialRecord], prior: Priors
) -> list[Coordinate]:
    """The unknowns that a parameter has at its level: one, or one for each case; none if it is each trial's own."""
    cases = list(dict.fromkeys(t.case for t in trials))
    level = e.levels.get(name, "campaign")
    free = {case: p for case in cases if not isinstance(p := prior(name, case), float | int) and _spread(p) > 0}
    if level == "trial" or not free:
        return []
    several = len({t.case for t in e.trials}) > 1  # of which those in use may be one
    if several and (level == "case" or name in e.case_priors):
        return [Coordinate(f"{name}[{case}]", role, p, case=case) for case, p in free.items()]
    return [Coordinate(name, role, next(iter(free.values())))]


def acting_alone(e: Experiment) -> set[str]:
    """Parameters that act on trials of the primary alone."""
    alone = {"J1", "c1t", "drag", "nu", "tail", "theta0", "delay"}
    return alone | {other for name, other in e.ties.items() if name in alone}


def middle(prior: Distribution | float) -> float:
    """The median of a prior, or the number it is fixed at."""
    return float(prior) if isinstance(prior, float | int) else median(prior)


def _spread(distribution: Distribution) -> float:
    return float(distribution.ppf(0.84) - distribution.ppf(0.16))
