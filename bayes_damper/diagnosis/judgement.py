"""From fitted effects to the answers for one campaign and the gap as a budget, with repeats and without.

Repeats distinguish the error of a model from noise: effects are weighed under the noise that the leading one leaves,
and by what each answer leaves of the gap (verdict.py). Without repeats each set of effects is weighed under what it
leaves itself (sets.py, lone.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from bayes_damper.calibration import (
    Calibration,
    Experiment,
    as_single_releases,
    calibrate,
    explained_by_own_releases,
    gained_by_own_releases,
    learn_noise,
    under,
)
from bayes_damper.calibration.free_starts import single_releases
from bayes_damper.calibration.latency import AS_LATE, with_latency
from bayes_damper.calibration.scatter import likeliest_sizes, slow_alike, with_scatter
from bayes_damper.diagnosis.budget import UNLIKELY, Budget, answers_of, budget_of, foreign_alone, idle_alone
from bayes_damper.diagnosis.generic import UNKNOWN
from bayes_damper.diagnosis.lone import leaving
from bayes_damper.diagnosis.pairs import Pair, best_pairs, exactly, seconds_of
from bayes_damper.diagnosis.remainder import Remainder, odd_shapes, readings_of_change, remainder_of
from bayes_damper.diagnosis.search import Candidate, generics_of, search
from bayes_damper.diagnosis.sensitivity import Choice, Quadratic, sensitivity, sensitivity_of_sets
from bayes_damper.diagnosis.sets import RESIZED, SetFit, as_candidates, grown, probabilities, support
from bayes_damper.diagnosis.sites import SiteMap, site_map
from bayes_damper.diagnosis.verdict import Answers, Left, Rule, borne_by_sets, family_evidence, left_of, weigh
from bayes_damper.diagnosis.wiring import Wiring, miswired
from bayes_damper.effects import Effect
from bayes_damper.effects.base import SITES, Variant

PAIR_FROM = 6.0  # nats left by the leading effect from which pairs are fitted
WORTH_RELEARNING = 10.0  # nats of the leading effect from which the noise is learnt again from what it leaves
PRIORS_OF_UNKNOWN = (0.05, 0.15, 0.3, 0.5)  # prior probabilities of a foreign cause under which verdicts are given
MOST_ROUNDS = 4  # of 25 steps by which a leader's descent goes on
NO_WORSE = 1.0  # nats: evidences are integrated over sizes of scatter, and differ by their Laplace error alone
SETTLED = 0.1  # nats by which such a round moves the evidence at the end: slowly, where the valley is flat
OTHER_CHOICES = "asking whether other priors, or a case or trial less, would change the answer"
JUDGED_PAIRS = 2  # pairs whose remainder is mapped
Offered = Sequence[tuple[Effect, Variant]]
Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Seen:
    """The gap of a nominal fit and what the leading answer leaves of it.

    found : candidates, best first; leading : fit of the leading answer; before, after : tests of what the nominal
    model and that answer leave, and maps of their sites; evidence : family -> log evidence over the nominal model;
    drift : the same of causes without a name (generic.py); wiring : channels under a wrong name, where that explains
    more than any effect.
    """

    fit: Calibration
    found: list[Candidate]
    leading: Calibration | None
    before: Remainder
    after: Remainder
    before_map: SiteMap
    after_map: SiteMap
    evidence: dict[str, float]
    drift: float
    wiring: Wiring | None

    @property
    def winner(self) -> Candidate | None:
        """The fitted candidate with the largest evidence."""
        return next((c for c in self.found if c.fit is not None), None)

    @property
    def definitions(self) -> list[str]:
        """Families whose formulas are definitions, such as a wrong constant."""
        return sorted({c.effect.name for c in self.found if c.effect.exact})

    @property
    def families(self) -> dict[str, list[Calibration]]:
        """Family -> its fitted formulas with an evidence, best first."""
        fits: dict[str, list[Calibration]] = {}
        for c in self.found:
            if c.fit is not None and math.isfinite(c.log_evidence):
                fits.setdefault(c.effect.name, []).append(c.fit)
        return fits

    @classmethod
    def of(cls, fit: Calibration, found: list[Candidate], leading: Calibration | None, report: Report) -> Seen:
        """Tests and maps of what a nominal fit and the leading answer leave."""
        before = remainder_of(fit)
        after = before if leading is None else remainder_of(leading)
        evidence = family_evidence(found)
        drift = evidence.pop(UNKNOWN)
        wiring = miswired(fit)
        if wiring is not None and wiring.gain <= max(evidence.values(), default=0.0):
            wiring = None
        report("testing the residuals of the leading effect")
        before_map = site_map(fit)
        after_map = before_map if leading is None else site_map(leading, torque=False)
        return cls(fit, found, leading, before, after, before_map, after_map, evidence, drift, wiring)


@dataclass(frozen=True, eq=False)
class Judgement:
    """Probabilities of all answers, and what they were made from.

    winner : the candidate that the answer names, or the leading one; pairs : fitted at once, best first; choices : the
    verdict under other choices; under_priors : prior probability of a cause outside the library, verdict, its
    probability; weighed : all numbers that the rule made the probabilities from, so that they can be made again.
    """

    seen: Seen
    winner: Candidate | None
    pairs: list[Pair]
    answers: Answers
    budget: Budget
    choices: list[Choice]
    under_priors: tuple[tuple[float, str, float], ...]
    weighed: dict[str, Any]


def judge_without_repeats(
    fit: Calibration, found: list[Candidate], pool: Offered, rng: np.random.Generator, rule: Rule, workers: int,
    report: Report,
) -> Judgement:  # fmt: skip
    """Answers where no repeats distinguish the error of the model from noise: each is judged under what it leaves."""
    sets = grown(fit, found, pool, workers=workers, report=report)
    # The nominal model has been asked where it was fitted.
    own = as_single_releases(sets[0].fit).problem.switches.scatter if sets[0].members else fit.problem.switches.scatter
    if own != fit.problem.switches.scatter:
        report("the leading answer leaves no more than the trials may differ by; searching again, with values for each")
        fit = _under_what_it_leaves(under(fit, fit.problem.noise, own))
        found = search(fit, [*pool, *generics_of(fit.problem.experiment)], workers=workers, report=report)
        sets = grown(fit, found, pool, workers=workers, report=report)
    fit = next(s.fit for s in sets if not s.members)
    first = next((s.fit for s in sets if s.members), None)
    found = as_candidates(found, sets)
    best = next((c.fit for c in found if c.fit is not None), None)
    seen = Seen.of(fit, found, best if first is None else first, report)
    left_by = cache(leaving(fit))
    none_left = left_by(fit)
    left = none_left if first is None else left_by(first)
    names = sorted(seen.evidence)

    shares = _shares_left(left_by, sets, len(names))
    fits = {s.names: s.fit for s in reversed(sets)}
    failing = {
        some: 1.0
        - (1.0 - foreign_alone(share, rule, odd_shapes(fits[some]))) * (1.0 - idle_alone(share, none_left, rule))
        for some, share in shares.items()
    }
    budget = _budget(seen, sets, failing, rng, shows=rule.seen(none_left.nats) > 0.5)
    sets = _standing(sets, budget)
    shares = _shares_left(left_by, sets, len(names))
    alone = {s.members[0][0].name: s.evidence for s in reversed(sets) if len(s.members) == 1}

    def answered(rule: Rule, sets: Sequence[SetFit] = sets) -> Answers:
        gain = -math.inf if seen.wiring is None else seen.wiring.gain
        return answers_of(budget, sets, names, alone, shares, none_left, left, gain, rule)

    answers = answered(rule)
    report(OTHER_CHOICES)
    return Judgement(
        seen, next((c for c in found for part in budget.parts[:1] if c.effect is part.member[0]), None),
        _as_pairs(budget, seen.evidence), answers, budget,
        sensitivity_of_sets(fit, sets, partial(answered, rule), answers.verdict, len(names)),
        _under_priors(answered, answers, rule), _weighed(seen, none_left, left, _excess(seen.after)),
    )  # fmt: skip


def _under_what_it_leaves(fit: Calibration) -> Calibration:
    """The fit under the noise that it shows, also where that is no more than the noise of the sensors."""
    noise = learn_noise(fit)
    return under(fit, noise if noise.sensor else noise.of_sensors, fit.problem.switches.scatter)


def judge_by_repeats(
    fit: Calibration, found: list[Candidate], pool: Offered, rng: np.random.Generator, rule: Rule, workers: int,
    report: Report,
) -> Judgement:  # fmt: skip
    """Answers where repeats distinguish the error of the model from noise: all under the leader's noise."""
    fit, found = _with_winners_noise(fit, found)
    found = with_own_sizes(finished(found))
    seen = Seen.of(fit, found, next((c.fit for c in found if c.fit is not None), None), report)
    winner = seen.winner
    none_left = left_of(seen.before, seen.before_map.strength, seen.before, seen.before_map.strength)
    left = _left_by_winner(seen)
    seconds = [] if winner is None or winner.effect.name == UNKNOWN else seconds_of(winner, fit, pool, workers)
    pairs: list[Pair] = []
    if max(left.nats, max((s.gain for s in seconds), default=0.0)) > PAIR_FROM:
        report("the leading effect leaves something: fitting it together with others")
        pairs = best_pairs(fit, found, pool, seconds, workers=workers)
    pairs, judged = _judged_pairs(seen, pairs, left, report)
    excess = _excess(pairs[0].after if pairs and pairs[0].gain > 0.0 else seen.after)
    usual = 0.0 if winner is None or not winner.variant.lets_go else _usual_release(fit, winner, rule)
    latency = with_latency(fit) if winner is not None and winner.effect.site in AS_LATE else None
    late = -math.inf if latency is None else latency.log_evidence - fit.log_evidence

    def judge(changes: Mapping[str, float], of_pairs: Mapping[str, float], rule: Rule = rule) -> Answers:
        moved = {n: z + changes.get(n, 0.0) for n, z in seen.evidence.items()}
        both = [(p.effects, p.log_evidence + of_pairs.get("+".join(p.effects), 0.0), remains) for p, remains in judged]
        other = seen.drift + changes.get(UNKNOWN, 0.0)
        if seen.wiring is not None:
            other = float(np.logaddexp(other, seen.wiring.gain))
        found = weigh(moved, none_left, left, excess, rule, both, other, seen.definitions, usual, late)
        return borne_by_sets(found, held)

    report("dividing the gap among effects")
    sets = grown(fit, found, pool, pairs, home=left.home, workers=workers, report=report)
    held = support(probabilities(sets, len(seen.evidence)))
    answers = judge({}, {})
    budget = _budget(seen, sets, dict.fromkeys((s.names for s in sets), given_a_gap(answers)), rng)
    report(OTHER_CHOICES)
    choices = sensitivity(
        fit, seen.families, judge, answers.verdict, {**seen.evidence, UNKNOWN: seen.drift},
        {"+".join(p.effects): p.fit for p, _ in judged},
    )  # fmt: skip
    return Judgement(
        seen, winner, pairs, answers, budget, choices,
        _under_priors(lambda rule: judge({}, {}, rule), answers, rule),
        _weighed(seen, none_left, left, excess, judged, usual, late) | {"support": held},
    )  # fmt: skip


def _excess(remains: Remainder) -> float:
    """Chi-square of mean residuals at low frequency beyond two standard deviations."""
    return remains.low_excess - 2.0 * remains.low_sd


JudgedPair = tuple[Pair, Left]  # what it leaves


def _weighed(
    seen: Seen, before: Left, after: Left, excess: float, pairs: Sequence[JudgedPair] = (), usual: float = 0.0,
    late: float = -math.inf,
) -> dict[str, Any]:  # fmt: skip
    """All that the rule makes the probabilities from."""
    return {
        "before": asdict(before), "after": asdict(after), "excess": excess,
        "drift": seen.drift if seen.wiring is None else float(np.logaddexp(seen.drift, seen.wiring.gain)),
        "pairs": [
            {"effects": list(p.effects), "log_evidence": p.log_evidence, "left": asdict(left)} for p, left in pairs
        ],
        "definitions": seen.definitions, "usual": usual, "late": late,
    }  # fmt: skip


def _standing(sets: Sequence[SetFit], budget: Budget) -> list[SetFit]:
    """The sets that may be answers: without those with an effect that closes nothing on held-out trials."""
    absent = {part.name for part in budget.absent}
    standing = [s for s in sets if not s.names & absent]
    return standing + ([] if any(s is budget.best for s in standing) else [budget.best])


def _budget(
    seen: Seen, sets: Sequence[SetFit], foreign: Mapping[frozenset[str], float], rng: np.random.Generator,
    shows: bool = False,
) -> Budget:  # fmt: skip
    """The gap as a budget; foreign : probability that a set is not what does what it explains; shows : as there."""
    found = budget_of(seen.fit, sets, len(seen.evidence), foreign, rng, shows)
    known_map = bool(seen.fit.problem.noise.sensor) and not found.absent
    mapped = known_map or (seen.winner is not None and found.best.fit is seen.winner.fit)
    place = seen.after_map if mapped or not found.parts else site_map(found.best.fit, torque=False)
    known = sites_of(seen.fit.problem.experiment)
    total = max(sum(place.probabilities.get(site, 0.0) for site in known), 1e-9)
    return replace(found, sites={site: place.probabilities.get(site, 0.0) / total for site in known})


def _shares_left(
    left_by: Callable[[Calibration], Left], sets: Sequence[SetFit], among: int
) -> dict[frozenset[str], float]:
    """Share of the gap that each likely set leaves, where no trial has repeats; left_by : what a fit leaves."""
    weights = probabilities(sets, among)
    likely = {s.names: s for s in reversed(sets) if weights[s.names] > UNLIKELY and s.members}
    return {names: left_by(s.fit).share for names, s in likely.items()}


def _as_pairs(budget: Budget, alone: Mapping[str, float]) -> list[Pair]:
    """The two leading effects of the budget as a pair, where it has two or more."""
    if len(budget.parts) < 2:
        return []
    first, second = (part.member for part in budget.parts[:2])
    best = budget.best
    gain = best.evidence - max(alone[first[0].name], alone[second[0].name])
    return [Pair(first, second, best.fit, best.evidence, gain, remainder_of(best.fit))]


def _left_by_winner(seen: Seen) -> Left:
    """What the leading effect leaves."""
    winner = seen.winner
    # In a formula that is a definition nothing is left open, not at its own site either.
    own_sites = set() if winner is None or winner.effect.exact else {winner.effect.site}
    return left_of(
        seen.after, seen.after_map.strength, seen.before, seen.before_map.strength,
        0.5 if winner is None else _at(seen.after_map, own_sites),
        readings=math.inf if winner is None or winner.fit is None else readings_of_change(seen.fit, winner.fit),
        explained=0.0 if winner is None else winner.log_evidence,
        odd=0.0 if winner is None or winner.fit is None else odd_shapes(winner.fit),
    )  # fmt: skip


def _judged_pairs(seen: Seen, pairs: Sequence[Pair], left: Left, report: Report) -> tuple[list[Pair], list[JudgedPair]]:
    """Pairs, best first, those that may be the answer composed; and what the leading ones leave."""
    pairs, judged = list(pairs), list[JudgedPair]()
    for k, p in enumerate(pairs[:JUDGED_PAIRS]):
        remains = _left_by(p, seen)
        # That two effects change the records by the sum of both holds the less, the larger the changes are.
        promising = p.gain > PAIR_FROM or remains.nats < left.nats - PAIR_FROM
        if remains.nats > PAIR_FROM and promising:
            report(f"composing {' and '.join(p.effects)}")
            pairs[k] = exactly(seen.fit, p, seen.found)
            remains = _left_by(pairs[k], seen)
        judged.append((pairs[k], remains))
    return sorted(pairs, key=lambda p: -p.log_evidence), judged


def _left_by(pair: Pair, seen: Seen) -> Left:
    """What a pair of effects leaves; two have formulas enough, so less of it is laid to them than to one."""
    found = site_map(pair.fit, torque=False)
    home = 0.5 * _at(found, {pair.first[0].site, pair.second[0].site})
    return left_of(
        pair.after, found.strength, seen.before, seen.before_map.strength, home, explained=pair.log_evidence,
        exact=pair.exact, odd=odd_shapes(pair.fit),
    )  # fmt: skip


def _at(found: SiteMap, sites: Collection[str]) -> float:
    """Probability that a remainder, if there is one, lies at one of the sites."""
    somewhere = 1.0 - found.probabilities["none"]
    return sum(found.probabilities[site] for site in sites) / somewhere if somewhere > 1e-9 else 0.5


def _usual_release(fit: Calibration, winner: Candidate, rule: Rule) -> float:
    """Nats of an effect of the release that a release of each trial's own explains as well."""
    if slow_alike(fit):
        return 0.0  # that is no latch
    # The law by which single trials are let go is as inexact as a formula.
    inexact = min(winner.log_evidence, rule.mismatch * explained_by_own_releases(fit))
    return max(gained_by_own_releases(fit), inexact)


def given_a_gap(answers: Answers) -> float:
    """Probability that a gap, if there is one, is the work of a cause outside the library."""
    return answers.probabilities["unknown"] / max(1.0 - answers.probabilities["none"], 1e-9)


def _under_priors(
    answered: Callable[[Rule], Answers], answers: Answers, rule: Rule
) -> tuple[tuple[float, str, float], ...]:
    """Prior probability of a cause outside the library, verdict under it, and the verdict's probability."""
    out = []
    for prior in sorted({*PRIORS_OF_UNKNOWN, rule.prior_unknown}):
        found = answers if prior == rule.prior_unknown else answered(replace(rule, prior_unknown=prior))
        out.append((prior, found.verdict, found.probabilities[found.verdict]))
    return tuple(out)


def _with_winners_noise(fit: Calibration, found: list[Candidate]) -> tuple[Calibration, list[Candidate]]:
    """Nominal model and leaders under the noise that the leader shows, where it is smaller: a bad model inflates it."""
    leader = next((c for c in found if c.fit is not None), None)
    if leader is None or leader.fit is None or leader.log_evidence < WORTH_RELEARNING:
        return fit, found
    noise = learn_noise(leader.fit)
    shrunk = max(old / new for old, new in zip(fit.problem.noise.innovation, noise.innovation, strict=True))
    if shrunk < 1.015:
        return fit, found
    base = fit.problem.changed(effect=None, noise=noise, factors=None)
    fresh = calibrate(base, [fit.q], eta=fit.eta, anneal=False, most=12)
    out = []
    for c in found:
        if c.fit is None or c.log_evidence < 0.3 * leader.log_evidence:
            out.append(c)
            continue
        again = calibrate(base.with_effect(c.variant), [c.fit.q], eta=c.fit.eta, anneal=False, most=10)
        out.append(Candidate(c.effect, c.variant, c.screens, again, again.log_evidence - fresh.log_evidence))
    return fresh, sorted(out, key=lambda c: -c.log_evidence)


def finished(found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, best first, those that may lead at the end of their descents, which the search cuts short.

    Tens of nats may be left in a long valley, more than lie between the leaders. Which may lead is judged by where each
    fit's own quadratic would end.
    """
    best = max((c.log_evidence for c in found if c.fit is not None), default=0.0)
    out = []
    for c in found:
        fit, gained = c.fit, 0.0
        if fit is not None and c.log_evidence + Quadratic.of(fit).log_evidence() - fit.log_evidence > best:
            moves, rounds = not fit.converged, 0
            while moves and rounds < MOST_ROUNDS:
                before, rounds = fit, rounds + 1
                fit = calibrate(before.problem, [before.q], eta=before.eta, anneal=False)
                moves = not fit.converged or abs(fit.log_evidence - before.log_evidence) > SETTLED
                gained += fit.log_evidence - before.log_evidence
        out.append(replace(c, fit=fit, log_evidence=c.log_evidence + gained) if gained > 0.0 else c)
    return sorted(out, key=lambda c: -c.log_evidence)


def with_own_sizes(found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, best first, the leader with the sizes of scatter that it makes likeliest where nothing repeats.

    Those of the nominal model are of what that lacks, too: trials that all have another spring than the declared one
    share what an effect explains, and leave it nothing of its size.
    """
    leader = next((c for c in found if c.fit is not None), None)
    if leader is None or leader.fit is None:
        return list(found)
    fit, problem = leader.fit, leader.fit.problem
    if not (problem.switches.scatter.from_trial_to_trial and single_releases(problem.experiment, problem.trials)):
        return list(found)
    for _ in range(RESIZED):
        again = with_scatter(fit, likeliest_sizes(fit))
        if not again.log_evidence > fit.log_evidence - NO_WORSE:
            break
        fit = again
    moved = replace(leader, fit=fit, log_evidence=leader.log_evidence + fit.log_evidence - leader.fit.log_evidence)
    return sorted((moved if c is leader else c for c in found), key=lambda c: -c.log_evidence)


def sites_of(experiment: Experiment) -> tuple[str, ...]:
    """The sites that a rig has: a second body only in coupled trials, a release only where records begin at rest."""
    missing = set() if experiment.coupled else {"interface", "ground2"}
    missing |= set() if experiment.start == "rest" else {"release"}
    return tuple(site for site in SITES if site not in missing)
