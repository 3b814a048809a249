"""From evidences to probabilities of answers: effects, pairs of effects, `none` and `unknown`.

Naive evidence is overconfident with tens of thousands of samples, because every formula is slightly wrong. So

- the evidence of a family is the mean over its formulas;
- evidences are tempered by T = 1 + (excess of the winner's mean residual beyond 2 sd) / TEMPERING, and more where so
  few readings of a record carry the change that they show its size but not its shape;
- a pair must gain more than the share of the stronger one's evidence by which a formula may be wrong;
- `unknown` competes with each answer through what that answer leaves: the evidence that something is left, and its
  share of the evidence of the gap. A right effect under a slightly wrong formula leaves a small share, and at its own
  site; a cause outside the library, imitated by the best substitute, leaves a larger one, mostly at another site;
- and where the gap is so faint that a remainder could not be seen, through how often a cause outside the library is
  imitated that well.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_damper.diagnosis.remainder import Remainder
from bayes_damper.diagnosis.search import Candidate

PRIOR_NONE = 0.3
PRIOR_UNKNOWN = 0.15
PRIOR_PAIRS = 0.05
LATE = 0.25
"""Prior odds of releases that are all late by the same part of a sampling step, to one effect: t = 0 is declared."""
USUAL = 20  # candidates among which the prior is shared, however few are offered
FRICTIONS = frozenset({"bearing_drag", "interface_friction"})
"""Candidates beside a linear nominal model; both at once are the usual nonlinear model, so they count as one answer."""
FLOOR = 0.005  # probability that no answer falls below, shared among all


@dataclass(frozen=True)
class Rule:
    """Constants of the rule, calibrated on simulated campaigns (validation/proofs/constants.py of the repository).

    strength, strength_width : nats left from which a remainder counts, logistic; share_home, share_away : share of the
    gap's evidence left, at the answer's own site or at another one, from which it is no matter of formulas, logistic in
    its logarithm with share_width; line : nats of a narrow line that no torque explains, torque_band : frequency above
    which it is one, over the rig's own, smooth_error : share of all that is left by which its smooth spectrum may be
    off; tempering : of the evidences; mismatch : share of the stronger effect's evidence that a second one gains by
    mending the first one's formula, where what the first one leaves lies at its own site (less by share_away /
    share_home where it does not); unseen : nats that may be left without being seen; imitated : exponent of the share
    left by causes outside the library, P(share < s) = s^imitated, and least : its smallest value with a meaning;
    few_readings : of a record: a gap that shows in these alone is imitated by any cause that acts there.
    """

    strength: float = 12.0
    strength_width: float = 2.5
    share_home: float = 0.2
    share_away: float = 0.05
    share_lone: float = 0.33
    """Where no trial has repeats: share of the reducible sum of squares left on held-out readings."""
    lone_ratio: float = 4.0
    """Where no trial has repeats: sum of squares over that of the sensors' noise from which it counts as a gap."""
    share_width: float = 0.30
    line: float = 12.0
    torque_band: float = 3.0
    smooth_error: float = 0.1
    tempering: float = 30.0
    mismatch: float = 0.04
    unseen: float = 30.0
    imitated: float = 0.8
    least: float = 0.03
    least_easy: float = 0.5
    """As `least`, for answers that imitate easily. A definition, such as a wrong constant, is the first order of
    whatever acts in proportion to its term: a spring that creeps or breaks looks like another stiffness. And two
    formulas at once imitate better than one."""
    few_readings: float = 0.8
    shape_readings: float = 2.0
    """Readings of a record that it takes to distinguish one formula's shape from another's."""
    prior_unknown: float = PRIOR_UNKNOWN
    """Prior probability that the cause is one that the library does not have."""

    def seen(self, nats: float) -> float:
        """Probability that so much evidence of a remainder counts."""
        return _logistic((nats - self.strength) / self.strength_width)

    def large(self, share: float, limit: float) -> float:
        """Probability that a share of the gap is more than a matter of formulas, which leave up to a limit."""
        return _logistic(math.log(max(share, 1e-6) / limit) / self.share_width)


RULE = Rule()


@dataclass(frozen=True)
class Left:
    """What an answer leaves of the gap.

    nats : evidence that anything is left; share : of the evidence of the gap, 1 for `none`; home : probability that it
    lies at the answer's own site; line, peak : the strongest narrow line, nats and frequency over the rig's own; lone :
    judged by sums of squares, for trials without repeats; readings : of a record that carry what the answer explains;
    exact : of a pair, whether one of its formulas is a definition, which mends nothing and in which nothing is mended;
    odd : nats by which the shapes of its effects speak for something else.
    """

    nats: float
    share: float
    home: float = 0.5
    line: float = 0.0
    peak: float = 0.0
    lone: bool = False
    readings: float = math.inf
    exact: bool = False
    odd: float = 0.0


def left_of(
    after: Remainder, mapped: float, before: Remainder, mapped_before: float, home: float = 0.5, *,
    explained: float = 0.0, readings: float = math.inf, exact: bool = False, odd: float = 0.0,
) -> Left:  # fmt: skip
    """What an answer leaves, by the tests of its residuals and the site map of what is left.

    mapped, mapped_before : evidence of the best site in the remainder, and in the gap itself, nats; home : probability
    that the remainder lies at the answer's own site; explained : log evidence of the answer over the nominal model; the
    gap holds what is explained and what is left, more than generic spectra and maps see of sharp events; readings,
    exact, odd : as in `Left`. Where the gap shows at low frequencies, the share is at most that of its chi-square
    there: what is left at sharp events, such as reversals of a friction whose formula is not quite right, has much
    evidence but is little of the gap.
    """
    nats = max(after.strength, mapped - math.log(20.0))
    remains = max(mapped, after.generic, 0.0)
    whole = max(mapped_before, before.generic, explained + remains, 1e-9)
    share = remains / whole
    if before.low_excess > 5.0 * before.low_sd:
        share = min(share, max(after.low_excess + after.low_sd, 0.0) / before.low_excess)
    peak = after.peak_hz / after.own_hz
    return Left(nats, min(share, 1.0), home, after.line, peak, readings=readings, exact=exact, odd=odd)


@dataclass(frozen=True)
class Answers:
    """Probabilities of all answers, and how they came about.

    temperature : of the evidences; left : what the leading answer leaves; unknown : probability that it leaves the work
    of another cause; pair : probability of `pair_effects`, whose stronger member carries it in `probabilities`.
    """

    probabilities: dict[str, float]
    temperature: float
    left: Left
    unknown: float
    pair: float = 0.0
    pair_effects: tuple[str, str] | None = None

    @property
    def verdict(self) -> str:
        """The most probable answer."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])

    def credible_set(self, share: float = 0.9) -> list[str]:
        """The smallest set of answers that holds at least `share` of the probability."""
        return credible_set(self.probabilities, share)


def credible_set(probabilities: Mapping[str, float], share: float = 0.9) -> list[str]:
    """The smallest set of answers that holds at least `share` of their probability, the most probable first."""
    ranked = sorted(probabilities, key=lambda name: (-probabilities[name], name))
    total = np.cumsum([probabilities[name] for name in ranked])
    return ranked[: int(np.searchsorted(total, share * total[-1] - 1e-9)) + 1] if ranked else []


def family_evidence(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Log evidence of each family over the nominal model: mean over its variants; -inf for what is not finite.

    Effects that share a name (generic.py) add up, each as likely beforehand as any other effect.
    """
    rows: dict[tuple[str, str], list[float]] = {}
    for c in candidates:
        value = c.log_evidence if math.isfinite(c.log_evidence) else -math.inf
        rows.setdefault((c.effect.name, c.effect.site), []).append(value)
    out: dict[str, float] = {}
    for (name, _), values in rows.items():
        out[name] = float(np.logaddexp(out.get(name, -math.inf), _log_mean(values)))
    return out


def _log_mean(values: Sequence[float]) -> float:
    top = max(values)
    if not math.isfinite(top):
        return -math.inf
    return top + math.log(sum(math.exp(v - top) for v in values) / len(values))


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(min(x, 60.0), -60.0)))


def _prior_of_one(among: int, unknown: float = PRIOR_UNKNOWN) -> float:
    """Prior probability of one effect among so many candidates; unknown: that of a cause that is none of them."""
    return (1.0 - PRIOR_NONE - unknown - PRIOR_PAIRS) / among


def pair_log_prior(effects: Collection[str], among: int = USUAL, unknown: float = PRIOR_UNKNOWN) -> float:
    """Logarithm of the prior probability of a pair of effects among so many candidates; unknown: as for one."""
    one = set(effects) == FRICTIONS
    return math.log(_prior_of_one(among, unknown) if one else 2.0 * PRIOR_PAIRS / (among * (among - 1.0)))


def mended_share(home: float, rule: Rule = RULE) -> float:
    """Share of an effect's evidence that a second one may gain by mending the first one's formula.

    home : probability that what the first one leaves lies at its own site; what lies elsewhere is seldom the work of an
    inexact formula.
    """
    return float(rule.mismatch * (rule.share_away / rule.share_home) ** (1.0 - home))


def imitated(left: float, odd: float, rule: Rule = RULE) -> float:
    """Probability that a cause outside the library does what an answer explains that leaves this share of the gap.

    Such a cause is imitated as well as that with the probability `left` ^ `rule.imitated`, and the odds grow with what
    the shapes of the answer's effects say: odd, nats, as in `Left`.
    """
    chance = rule.prior_unknown / (1.0 - PRIOR_NONE) * left**rule.imitated
    return _logistic(math.log(max(chance, 1e-300) / (1.0 - chance)) + odd)


def outside_library(left: Left, evidence: float, rule: Rule = RULE, easy: bool = False) -> float:
    """Probability that what an answer explains is the work of a cause outside the library.

    By what it leaves; and, because a remainder of some nats goes unseen, by how often such a cause would be imitated
    well enough for that: the fainter the gap and the fewer the readings that show it, the easier. evidence : of the
    answer over the nominal model, nats; easy : whether the answer is one of those that imitate easily.
    """
    home = rule.share_away * (rule.share_home / rule.share_away) ** left.home
    limit = rule.share_lone if left.lone else home
    large = rule.large(left.share, limit)
    if left.peak > rule.torque_band:
        lined = _logistic((left.line - rule.smooth_error * left.nats - rule.line) / rule.strength_width)
        large = max(large, lined * rule.large(left.share, 0.3 * limit))
    least = rule.least_easy if easy else rule.least
    unnoticed = max(rule.unseen / max(evidence, 1e-9), least, rule.few_readings / max(left.readings, 1e-9))
    base = imitated(min(1.0, unnoticed), left.odd, rule)
    return 1.0 - (1.0 - base) * (1.0 - rule.seen(left.nats) * large)


def weigh(
    evidence: Mapping[str, float],
    before: Left,
    after: Left,
    excess: float = 0.0,
    rule: Rule = RULE,
    pairs: Sequence[tuple[tuple[str, str], float, Left]] = (),
    generic: float = -math.inf,
    definitions: Collection[str] = (),
    usual: float = 0.0,
    late: float = -math.inf,
) -> Answers:
    """Probabilities of all answers.

    evidence : family -> log Z relative to the nominal model; before, after : what `none` and the leading effect leave;
    excess : chi-square of the best answer's mean residuals at low frequency beyond 2 sd; pairs : effects (the stronger
    first), log Z of both, and what they leave; generic : log Z of causes without a name (generic.py), which
    counts for `unknown`; definitions : families whose formulas are; usual : log Z of the nominal model with what may be
    usual in a laboratory and no repeats could show, as likely a priori as without it; late : the same with releases
    that are all late by the same time (`LATE`). Both leave what the leading effect leaves.
    """
    names = [n for n, z in evidence.items() if math.isfinite(z)]
    among = max(len(evidence), USUAL)
    each = _prior_of_one(among, rule.prior_unknown)
    temperature = 1.0 + max(0.0, excess) / (rule.tempering * 20.0)
    temperature *= 1.0 + rule.shape_readings / max(after.readings, 1e-9)
    best = max((evidence[n] for n in names), default=0.0)
    mending = mended_share(after.home, rule)
    sound, as_it_is = _sound(usual, math.log(LATE * each) + late / temperature)
    log_w: dict[str | tuple[str, str], float] = {"none": sound}
    mended = {n: evidence[n] for n in names}
    if math.isfinite(generic):
        log_w["unknown"] = math.log(each) + generic / temperature
    left: dict[str | tuple[str, str], Left] = {"none": before}
    for effects, value, remains in pairs:
        # Some of what a second effect gains the first one would gain by a better formula: it does so alone.
        lacks = {n: value - evidence[n] for n in (() if remains.exact else set(effects) & set(mended))}
        least = max(min(lacks.values(), default=0.0), 1.0)
        for n, lack in lacks.items():
            # That the other one comes so much closer without acting is a coincidence.
            gain = min(lack, mending * max(best, 0.0)) - math.log(max(lack, 1.0) / least)
            mended[n] = max(mended[n], evidence[n] + gain)
        log_w[effects] = pair_log_prior(effects, among, rule.prior_unknown) + value / temperature
        left[effects] = remains
    log_w |= {n: math.log(each) + z / temperature for n, z in mended.items()}
    top = max(log_w.values())
    weights = {n: math.exp(v - top) for n, v in log_w.items()}
    total = sum(weights.values())
    probabilities = dict.fromkeys(("none", "unknown", *evidence), 0.0)
    pair, pair_effects, unknown = 0.0, None, 0.0
    for answer, weight in weights.items():
        p = weight / total
        if answer == "unknown":
            probabilities["unknown"] += p
            continue
        remains = left.get(answer, after)
        if answer == "none":
            lost = as_it_is * rule.seen(remains.nats) + (1.0 - as_it_is) * rule.seen(after.nats)
        else:
            easy = set(answer) != FRICTIONS if isinstance(answer, tuple) else answer in definitions
            lost = outside_library(remains, log_evidence_of(answer, evidence, pairs), rule, easy)
        probabilities["unknown"] += p * lost
        unknown += p * lost
        if isinstance(answer, tuple):
            probabilities[answer[0]] += p * (1.0 - lost)
            if p * (1.0 - lost) > pair:
                pair, pair_effects = p * (1.0 - lost), answer
        else:
            probabilities[answer] += p * (1.0 - lost)
    floor = FLOOR / len(probabilities)
    mixed = {n: (1.0 - FLOOR) * p + floor for n, p in probabilities.items()}
    total = sum(mixed.values())
    shares = {n: float(p / total) for n, p in mixed.items()}
    leading = max(weights, key=lambda n: weights[n])
    return Answers(shares, temperature, left.get(leading, after), float(unknown), pair, pair_effects)


def _sound(usual: float, log_late: float) -> tuple[float, float]:
    """Log weight of `none`, and the share of it that leaves the gap as it is; log_late : log weight of a late clock."""
    prior = math.log(PRIOR_NONE)
    parts = [prior, log_late] if usual <= 0.0 else [prior - math.log(2.0), prior - math.log(2.0) + usual, log_late]
    whole = float(np.logaddexp.reduce(parts))
    return whole, math.exp(parts[0] - whole)


def borne_by_sets(answers: Answers, support: Mapping[str, float]) -> Answers:
    """The answers, each effect only as far as the sets that explain the gap hold it; the rest is for `unknown`.

    support : effect -> probability of the sets that hold it, over that of these and of those that explain the gap by
    several others, or by a cause without a name. What explains most alone and is not needed there imitates a cause
    that has no formula of its own.
    """
    given = answers.probabilities
    held = {n: p * support.get(n, 1.0) for n, p in given.items()}
    lost = sum(given.values()) - sum(held.values())
    kept = {n: max(p, FLOOR / len(held)) for n, p in held.items()}
    kept["unknown"] += lost
    total = sum(kept.values())
    return replace(
        answers,
        probabilities={n: p / total for n, p in kept.items()},
        unknown=answers.unknown + lost,
        pair=answers.pair * min((support.get(n, 1.0) for n in answers.pair_effects or ()), default=1.0),
    )


def log_evidence_of(
    answer: str | tuple[str, str],
    evidence: Mapping[str, float],
    pairs: Sequence[tuple[tuple[str, str], float, Left]],
) -> float:
    """Log Z of an answer over the nominal model."""
    if isinstance(answer, str):
        return evidence[answer]
    return next(value for effects, value, _ in pairs if effects == answer)
