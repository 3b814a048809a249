"""From evidences to probabilities of answers: effects, `none` and `unknown`.

Naive evidence is overconfident with tens of thousands of samples, because every formula is slightly wrong. So

- the evidence of a family is the mean over its formulas;
- evidences are tempered by T = 1 + (excess of the winner's mean residual beyond 2 sd) / TEMPERING;
- `unknown` competes through what the leading answer leaves: the evidence that something is left (remainder.py), and the
  share of the gap that is left. A right effect under a slightly wrong formula leaves a small share; a foreign effect
  under its best impostor a larger one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_damper.diagnosis.pairs import Pair
from bayes_damper.diagnosis.remainder import Remainder
from bayes_damper.diagnosis.search import Candidate

PRIOR_NONE = 0.25
PRIOR_UNKNOWN = 0.15
USUAL = 20  # candidates among which the prior is shared, however few are offered
FLOOR = 0.005  # probability that no answer falls below, shared among all


@dataclass(frozen=True)
class Rule:
    """Constants of the rule, calibrated on simulated campaigns."""

    share: float = 0.10
    share_width: float = 0.30
    strength: float = 10.0
    strength_width: float = 2.5
    tempering: float = 30.0
    line: float = 12.0
    torque_band: float = 25.0
    """Hz: above, no torque on the inertias explains a narrow line."""
    pair_share: float = 0.02
    pair_gain: float = 12.0


RULE = Rule()


@dataclass(frozen=True)
class Answers:
    """Probabilities of all answers, and how they came about."""

    probabilities: dict[str, float]
    temperature: float
    share_left: float
    unknown: float
    pair: float = 0.0

    @property
    def verdict(self) -> str:
        """The most probable answer."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])

    def credible_set(self, share: float = 0.9) -> list[str]:
        """The smallest set of answers that holds at least `share` of the probability."""
        total, out = 0.0, []
        for name, p in sorted(self.probabilities.items(), key=lambda item: -item[1]):
            out.append(name)
            total += p
            if total >= share - 1e-12:
                break
        return out


def family_evidence(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Log evidence of each family over the nominal model: mean over its variants; -inf for what is not finite."""
    rows: dict[str, list[float]] = {}
    for c in candidates:
        rows.setdefault(c.effect.name, []).append(c.log_evidence if math.isfinite(c.log_evidence) else -math.inf)
    return {name: _log_mean(values) for name, values in rows.items()}


def _log_mean(values: Sequence[float]) -> float:
    top = max(values)
    if not math.isfinite(top):
        return -math.inf
    return top + math.log(sum(math.exp(v - top) for v in values) / len(values))


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(min(x, 60.0), -60.0)))


def weigh(
    evidence: Mapping[str, float],
    before: Remainder,
    after: Remainder,
    rule: Rule = RULE,
    pair: Pair | None = None,
    generic: float = -math.inf,
) -> Answers:
    """Probabilities of all answers.

    evidence : family -> log Z relative to the nominal model; before, after : what the nominal model leaves, and what
    the leading effect leaves; pair : two effects that may close what one leaves open; generic : log Z of a
    drift of the nominal laws (generic.py), which counts for `unknown`.
    """
    names = [n for n, z in evidence.items() if math.isfinite(z)]
    each = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / max(len(evidence), USUAL)
    temperature = 1.0 + max(0.0, after.low_excess - 2.0 * after.low_sd) / (rule.tempering * 20.0)
    log_w = {"none": math.log(PRIOR_NONE)} | {n: math.log(each) + evidence[n] / temperature for n in names}
    if math.isfinite(generic):
        log_w["unknown"] = math.log(each) + generic / temperature
    top = max(log_w.values())
    weights = {n: math.exp(v - top) for n, v in log_w.items()}
    total = sum(weights.values())
    known = {n: w / total for n, w in weights.items()}
    # What the answers leave, averaged over `none` and the leading effect.
    gap = max(before.low_excess, before.low_sd)
    share = min(max(after.low_excess, 0.0) / gap, 1.0)
    left = _logistic((after.strength - rule.strength) / rule.strength_width)
    large = _logistic((math.log(max(share, 1e-6)) - math.log(rule.share)) / rule.share_width)
    lined = _logistic((after.line - rule.line) / rule.strength_width) * _logistic(
        (math.log(max(share, 1e-6)) - math.log(0.3 * rule.share)) / rule.share_width
    )
    foreign = left * max(large, lined if after.peak_hz > rule.torque_band else 0.0)
    both = 0.0
    if pair is not None:
        closes = _logistic((math.log(rule.pair_share) - math.log(max(pair.share_left, 1e-6))) / rule.share_width)
        both = foreign * closes * _logistic((pair.gain - rule.pair_gain) / rule.strength_width)
        foreign -= both
    nothing = _logistic((before.strength - rule.strength) / rule.strength_width)
    unknown = known["none"] * nothing + (1.0 - known["none"]) * foreign
    probabilities = {n: p * (1.0 - nothing if n == "none" else 1.0 - foreign - both) for n, p in known.items()}
    probabilities["unknown"] = unknown + probabilities.get("unknown", 0.0)
    if pair is not None:
        probabilities[pair.effects[0]] += (1.0 - known["none"]) * both
    for name in evidence:
        probabilities.setdefault(name, 0.0)
    count = len(probabilities)
    mixed = {n: (1.0 - FLOOR) * p + FLOOR / count for n, p in probabilities.items()}
    total = sum(mixed.values())
    return Answers({n: float(p / total) for n, p in mixed.items()}, temperature, share, float(unknown), both)


def rank(evidence: Mapping[str, float]) -> list[str]:
    """Families, best first."""
    return sorted(evidence, key=lambda n: -np.nan_to_num(evidence[n], nan=-np.inf))
