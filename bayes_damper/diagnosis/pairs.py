"""Two effects at once, where one does not close the gap.

Each of the leading effects is held in turn, at its own fit, and every other effect is screened against what that fit
leaves: first pick and swap in one sweep. The second effect's change of the records is taken without the first one at
work, which is right to first order; its evidence is that of the linearised problem, everything else refitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_damper.calibration import Calibration
from bayes_damper.diagnosis.generic import DRIFT
from bayes_damper.diagnosis.remainder import Remainder, remainder_of
from bayes_damper.diagnosis.search import Candidate, Screen, Screened, bases_of, screen_column
from bayes_damper.effects.base import Effect, Variant

LEADERS = 4  # families that are held in turn
LEAST_GAIN = 10.0  # nats of the second effect, below which no pair is claimed


@dataclass(frozen=True, eq=False)
class Pair:
    """Two effects that explain a campaign together.

    first: fitted; second: screened against what the first leaves; log_evidence over the nominal model; gain: nats of
    the second; share_left: of the gap's low-frequency chi-square.
    """

    first: Candidate
    second: Effect
    variant: Variant
    screened: Screened
    log_evidence: float
    gain: float
    share_left: float

    @property
    def effects(self) -> tuple[str, str]:
        """Names of both, the stronger first."""
        return self.first.effect.name, self.second.name


def best_pair(
    nominal: Calibration, found: Sequence[Candidate], pool: Sequence[tuple[Effect, Variant]], before: Remainder
) -> Pair | None:
    """The pair with the largest evidence, None if no second effect gains enough."""
    held: dict[str, Candidate] = {}
    for c in found:
        if (
            c.effect.name != DRIFT.name
            and c.fit is not None
            and math.isfinite(c.log_evidence)
            and c.effect.name not in held
        ):
            held[c.effect.name] = c
        if len(held) == LEADERS:
            break
    best: Pair | None = None
    for first in held.values():
        assert first.fit is not None
        if first.log_evidence < LEAST_GAIN:
            continue
        left = remainder_of(first.fit)
        screen = Screen(first.fit)
        for effect, variant in pool:
            if effect.name == first.effect.name or variant.null is None:
                continue
            row = _second(screen, nominal, variant)
            if row is None or row.log_evidence < LEAST_GAIN:
                continue
            total = first.log_evidence + row.log_evidence
            if total > max(found[0].log_evidence + LEAST_GAIN, -math.inf if best is None else best.log_evidence):
                remaining = max(left.low_excess - 2.0 * row.gain, 0.0) / max(before.low_excess, before.low_sd)
                best = Pair(first, effect, variant, row, total, row.gain, min(remaining, 1.0))
    return best


def _second(screen: Screen, nominal: Calibration, variant: Variant) -> Screened | None:
    """The best start of a second effect at the fit of a first one."""
    base = screen.fit.q[: nominal.problem.size]
    problem = nominal.problem.with_effect(variant)
    rows = []
    for point in bases_of(replace(nominal, q=base)):
        rows += screen_column(screen, problem, variant, point, against=nominal.problem)
    usable = [r for r in rows if r.amplitude > 0.0 and np.isfinite(r.log_evidence)]
    return max(usable, key=lambda r: r.log_evidence) if usable else None
