"""From a campaign to an answer: calibration, search, remainder, verdict, and how far the gap shrinks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import (
    Calibration,
    Experiment,
    Problem,
    calibrate,
    calibrate_nominal,
    experiment_of,
    explained_by_own_releases,
    gained_by_own_releases,
    learn_noise,
    with_rounding,
)
from bayes_damper.campaign import Campaign
from bayes_damper.diagnosis.budget import Budget, answers_of, budget_of, foreign_alone
from bayes_damper.diagnosis.formula import widened
from bayes_damper.diagnosis.gap import closing, measure_gap
from bayes_damper.diagnosis.generic import DRIFT
from bayes_damper.diagnosis.law import learn
from bayes_damper.diagnosis.lone import left_alone
from bayes_damper.diagnosis.next_experiment import Proposal, propose
from bayes_damper.diagnosis.notes import notes_on
from bayes_damper.diagnosis.outliers import (
    odd_in_words,
    odd_trials,
    outlying,
    outlying_in_words,
    without,
    without_trials,
)
from bayes_damper.diagnosis.pairs import Pair, best_pairs, exactly, seconds_of
from bayes_damper.diagnosis.remainder import Remainder, readings_of_change, remainder_of
from bayes_damper.diagnosis.result import Diagnosis
from bayes_damper.diagnosis.search import Candidate, offered, scales_of, search
from bayes_damper.diagnosis.sensitivity import Quadratic, in_a_sentence, sensitivity, sensitivity_of_sets
from bayes_damper.diagnosis.sets import SetFit, as_candidates, grown, probabilities
from bayes_damper.diagnosis.sites import SiteMap, site_map
from bayes_damper.diagnosis.verdict import RULE, Answers, Left, Rule, family_evidence, left_of, weigh
from bayes_damper.diagnosis.where import locate
from bayes_damper.diagnosis.wiring import miswired
from bayes_damper.effects import EFFECTS, Effect, classes, scaled
from bayes_damper.effects.base import SITES, Variant
from bayes_damper.priors.distributions import Distribution
from bayes_damper.priors.files import PriorSet
from bayes_damper.runs.memory import shortage

Array = NDArray[np.float64]

CLEANINGS = 2  # times that outlying readings are looked for: the first ones hide others
INDISTINCT = 3.0  # nats between two families below which these data cannot tell them apart
PAIR_FROM = 6.0  # nats left by the leading effect from which pairs are fitted
WORTH_RELEARNING = 10.0  # nats of the leading effect from which the noise is learnt again from what it leaves
PRIORS_OF_UNKNOWN = (0.05, 0.15, 0.3, 0.5)  # prior probabilities of a foreign cause under which verdicts are given
MOST_ROUNDS = 4  # of 25 steps by which a leader's descent goes on
UNLIKELY = 0.01  # probability of a set below which it is not asked what it leaves
JUDGED_PAIRS = 2  # pairs whose remainder is mapped
SHOWN = 3  # leading effects for which the gap they leave on held-out trials is given


def diagnose(
    campaign: Campaign | Experiment,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: Mapping[str, Effect] = EFFECTS,
    priors: PriorSet | Mapping[str, Distribution | float] | None = None,
    seed: int = 1,
    workers: int = 1,
    rule: Rule = RULE,
    report: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """The sim-to-real gap of a campaign (campaign.Campaign, or an Experiment): whether, which, how far it shrinks.

    effects : name -> Effect, the candidates; priors : of nominal parameters, in place of the defaults; seed : kept in
    the record of the run (every step is deterministic); workers : processes; report : receives a line per stage.
    """
    began = time.perf_counter()
    if isinstance(campaign, Experiment):
        name, kind, experiment = "campaign", "torsional", campaign
    else:
        name, kind = campaign.name, campaign.rig.kind
        experiment = with_rounding(experiment_of(campaign, priors))
    if short := shortage(sum(t.y.size for t in experiment.trials)):
        report(short)
    fit, notes = _cleaned_fit(experiment, nominal, report)
    experiment = fit.problem.experiment
    pool = offered(experiment, nominal, effects)
    found = search(fit, [*pool, *_drifts(experiment)], workers=workers, report=report)
    fit, found = _reseeded(fit, found)
    alone = bool(fit.problem.noise.sensor)
    pairs: list[Pair] = []
    sets: list[SetFit] = []
    if alone:
        # No repeats tell the error of the model from noise, so that each answer is judged under what it leaves itself.
        sets = grown(fit, found, pool, workers=workers, report=report)
        found = as_candidates(found, sets)
    else:
        fit, found = _with_winners_noise(fit, found)
        found = finished(found)
    winner = next((c for c in found if c.fit is not None), None)
    before = remainder_of(fit)
    first_set = next((s for s in sets if s.members), None)
    leading = first_set.fit if first_set is not None else None if winner is None else winner.fit
    after = before if leading is None else remainder_of(leading)
    evidence = family_evidence(found)
    drift = evidence.pop(DRIFT.name)
    wiring = miswired(fit)
    if wiring is not None and wiring.gain <= max(evidence.values(), default=0.0):
        wiring = None
    report("testing the residuals of the leading effect")
    before_map = site_map(fit)
    after_map = before_map if leading is None else site_map(leading, torque=False)
    if alone:
        none_left = left_alone(fit, fit)
        left = none_left if first_set is None else left_alone(fit, first_set.fit)
    else:
        none_left = left_of(before, before_map.strength, before, before_map.strength)
        left = _left_by_winner(fit, winner, after, after_map, before, before_map)
    seconds = [] if alone or winner is None or winner.effect is DRIFT else seconds_of(winner, fit, pool, workers)
    gain = max((s.gain for s in seconds), default=0.0)
    if not alone and max(left.nats, gain) > PAIR_FROM:
        pairs = best_pairs(fit, found, pool, seconds, workers=workers)
    pairs, judged = _judged_pairs(fit, found, pairs, left, before, before_map, report)
    best_left = pairs[0].after if pairs and pairs[0].gain > 0.0 else after
    excess = best_left.low_excess - 2.0 * best_left.low_sd
    definitions = sorted({c.effect.name for c in found if c.effect.exact})
    usual = 0.0 if alone or winner is None or not winner.variant.lets_go else _usual_release(fit, winner, rule)

    def judge(changes: Mapping[str, float], of_pairs: Mapping[str, float], rule: Rule = rule) -> Answers:
        moved = {n: z + changes.get(n, 0.0) for n, z in evidence.items()}
        both = [(e, z + of_pairs.get("+".join(e), 0.0), remains) for e, z, remains in judged]
        other = drift + changes.get(DRIFT.name, 0.0)
        if wiring is not None:
            other = float(np.logaddexp(other, wiring.gain))
        return weigh(moved, none_left, left, excess, rule, both, other, definitions, usual)

    answers = judge({}, {})
    rng = np.random.default_rng(seed)
    if not alone:
        sets = grown(fit, found, pool, pairs, home=left.home, workers=workers, report=report)
    names = sorted(evidence)
    shares_left = _shares_left(fit, sets, len(names)) if alone else {}

    def foreign_of(rule: Rule) -> dict[frozenset[str], float]:
        if alone:
            return {names: foreign_alone(share, rule) for names, share in shares_left.items()}
        return dict.fromkeys((s.names for s in sets), given_a_gap(answers))

    budget = _budget(fit, sets, len(names), foreign_of(rule), after_map, winner, rng)

    # Sets with an effect that closes nothing on held-out trials are no answers.
    absent = {part.name for part in budget.absent}
    judged_sets = [s for s in sets if not s.names & absent]
    judged_sets += [] if any(s is budget.best for s in judged_sets) else [budget.best]

    def answered(rule: Rule, sets: Sequence[SetFit] = judged_sets) -> Answers:
        if not alone:
            return judge({}, {}, rule)
        gain = -math.inf if wiring is None else wiring.gain
        return answers_of(budget, sets, names, foreign_of(rule), none_left, left, gain, rule)

    if alone:
        shares_left = _shares_left(fit, judged_sets, len(names))
        answers = answered(rule)
        winner = next((c for c in found for part in budget.parts[:1] if c.effect is part.member[0]), None)
        pairs = _as_pairs(budget, evidence)
    weighed = {
        "before": asdict(none_left), "after": asdict(left), "excess": excess,
        "drift": drift if wiring is None else float(np.logaddexp(drift, wiring.gain)),
        "pairs": [{"effects": list(e), "log_evidence": z, "left": asdict(remains)} for e, z, remains in judged],
        "definitions": definitions, "usual": usual,
    }  # fmt: skip
    fits: dict[str, list[Calibration]] = {}
    for c in found:
        if c.fit is not None and math.isfinite(c.log_evidence):
            fits.setdefault(c.effect.name, []).append(c.fit)
    choices = (
        sensitivity_of_sets(fit, judged_sets, lambda sets: answered(rule, sets), answers.verdict)
        if alone
        else sensitivity(
            fit,
            fits,
            judge,
            answers.verdict,
            {**evidence, DRIFT.name: drift},
            {"+".join(p.effects): p.fit for p in pairs[:JUDGED_PAIRS]},
        )
    )
    pair = next((p for p in pairs if p.effects == answers.pair_effects), None)
    report(f"most probable answer so far: {answers.verdict}")
    best = pair.fit if pair is not None and answers.pair >= 0.5 else None if winner is None else winner.fit
    named = best if winner is not None and answers.verdict == winner.effect.name else None
    if wiring is not None:
        notes.insert(0, wiring.sentence())
    notes += notes_on(experiment, fit, named, answers, before_map)
    notes.append(in_a_sentence(choices, answers.verdict))
    gap = measure_gap(fit, best, rng=rng)
    first = sorted(evidence, key=lambda n: -evidence[n])[:SHOWN]
    closes = {} if best is None else closing(fit, {n: fits[n][0] for n in first if n in fits}, rng)
    if best is not None and winner is not None and winner.effect is not DRIFT:
        acting = [winner.effect] if best is winner.fit or pair is None else [pair.first[0], pair.second[0]]
        best = widened(best, [effect.site for effect in acting])
    law = learn(fit, budget, answers.verdict, before_map, name, kind, np.random.default_rng(seed), report)
    return Diagnosis(
        campaign=name, experiment=experiment, nominal_kind=nominal, nominal=fit, candidates=tuple(found),
        winner=winner, answers=answers, before=before, after=after, gap=gap, where=locate(fit), site_map=before_map,
        remainder_map=after_map, proposals=tuple(_proposals(fit, found, answers)),
        sites=_sites(answers, effects, before_map, after_map, sites_of(experiment), wiring is not None),
        evidence=evidence, indistinguishable=tuple(_indistinct(evidence, effects)), pair=pair, notes=tuple(notes),
        seconds=time.perf_counter() - began, seed=seed, pairs=tuple(pairs), drift=drift, best=best,
        choices=tuple(choices), closing=closes, weighed=weighed, kind=kind, budget=budget,
        under_priors=_under_priors(answered, answers, rule), law=law, named=named,
    )  # fmt: skip


def _cleaned_fit(
    experiment: Experiment, nominal: Literal["nonlinear", "linear"], report: Callable[[str], None]
) -> tuple[Calibration, list[str]]:
    """The nominal model's fit without odd trials and readings far out, and sentences on what was left out."""
    odd = odd_trials(experiment)
    notes = odd_in_words(experiment, odd)
    experiment = without_trials(experiment, odd)
    fit = calibrate_nominal(experiment, nominal=nominal, report=report)
    for _ in range(CLEANINGS):
        far = outlying(fit)
        if not far:
            break
        notes += outlying_in_words(experiment, far)
        experiment = without(experiment, far)
        fit = calibrate_nominal(experiment, nominal=nominal, report=report)
    return fit, notes


def _left_by_winner(
    fit: Calibration, winner: Candidate | None, after: Remainder, after_map: SiteMap, before: Remainder,
    before_map: SiteMap,
) -> Left:  # fmt: skip
    """What the leading effect leaves, where repeats tell the error of the model from noise."""
    # In a formula that is a definition nothing is left open, not at its own site either.
    own_sites = set() if winner is None or winner.effect.exact else {winner.effect.site}
    return left_of(
        after, after_map.strength, before, before_map.strength, 0.5 if winner is None else _at(after_map, own_sites),
        readings=math.inf if winner is None or winner.fit is None else readings_of_change(fit, winner.fit),
        explained=0.0 if winner is None else winner.log_evidence,
    )  # fmt: skip


def _judged_pairs(
    fit: Calibration, found: Sequence[Candidate], pairs: Sequence[Pair], left: Left, before: Remainder,
    before_map: SiteMap, report: Callable[[str], None],
) -> tuple[list[Pair], list[tuple[tuple[str, str], float, Left]]]:  # fmt: skip
    """Pairs, best first, those that may be the answer composed; and evidence and rest of the leading ones."""
    pairs, judged = list(pairs), []
    for k, p in enumerate(pairs[:JUDGED_PAIRS]):
        remains = _left_by(p, before, before_map)
        # That two effects change the records by the sum of both holds the less, the larger the changes are.
        promising = p.gain > PAIR_FROM or remains.nats < left.nats - PAIR_FROM
        if remains.nats > PAIR_FROM and promising:
            report(f"composing {' and '.join(p.effects)}")
            pairs[k] = exactly(fit, p, found)
            remains = _left_by(pairs[k], before, before_map)
        judged.append((pairs[k].effects, pairs[k].log_evidence, remains))
    return sorted(pairs, key=lambda p: -p.log_evidence), judged


def _usual_release(fit: Calibration, winner: Candidate, rule: Rule) -> float:
    """Nats of an effect of the release that a release of each trial's own explains as well."""
    # The law by which single trials are let go is as inexact as a formula.
    inexact = min(winner.log_evidence, rule.mismatch * explained_by_own_releases(fit))
    return max(gained_by_own_releases(fit), inexact)


def _drifts(experiment: Experiment) -> list[tuple[Effect, Variant]]:
    """The drift of the nominal laws, its rates at the rig's own pace."""
    return [(DRIFT, scaled(variant, scales_of(experiment))) for variant in DRIFT.variants]


def _left_by(pair: Pair, before: Remainder, before_map: SiteMap) -> Left:
    """What a pair of effects leaves; two have formulas enough, so less of it is laid to them than to one."""
    found = site_map(pair.fit, torque=False)
    home = 0.5 * _at(found, {pair.first[0].site, pair.second[0].site})
    return left_of(
        pair.after, found.strength, before, before_map.strength, home, explained=pair.log_evidence, exact=pair.exact
    )


def _shares_left(fit: Calibration, sets: Sequence[SetFit], among: int) -> dict[frozenset[str], float]:
    """Share of the gap that each likely set leaves, where no trial has repeats."""
    weights = probabilities(sets, among)
    likely = {s.names: s for s in reversed(sets) if weights[s.names] > UNLIKELY and s.members}
    return {names: left_alone(fit, s.fit).share for names, s in likely.items()}


def given_a_gap(answers: Answers) -> float:
    """Probability that a gap, if there is one, is the work of a cause outside the library."""
    return answers.probabilities["unknown"] / max(1.0 - answers.probabilities["none"], 1e-9)


def _budget(
    fit: Calibration, sets: Sequence[SetFit], among: int, foreign: Mapping[frozenset[str], float], after: SiteMap,
    winner: Candidate | None, rng: np.random.Generator,
) -> Budget:  # fmt: skip
    """The gap as a budget; after: where what the leading answer leaves lies."""
    found = budget_of(fit, sets, among, foreign, rng)
    known_map = bool(fit.problem.noise.sensor) and not found.absent
    mapped = known_map or (winner is not None and found.best.fit is winner.fit)
    place = after if mapped or not found.parts else site_map(found.best.fit, torque=False)
    known = sites_of(fit.problem.experiment)
    total = max(sum(place.probabilities.get(site, 0.0) for site in known), 1e-9)
    return replace(found, sites={site: place.probabilities.get(site, 0.0) / total for site in known})


def _under_priors(
    answered: Callable[[Rule], Answers], answers: Answers, rule: Rule
) -> tuple[tuple[float, str, float], ...]:
    """Prior probability of a cause outside the library, verdict under it, and the verdict's probability."""
    out = []
    for prior in sorted({*PRIORS_OF_UNKNOWN, rule.prior_unknown}):
        found = answers if prior == rule.prior_unknown else answered(replace(rule, prior_unknown=prior))
        out.append((prior, found.verdict, found.probabilities[found.verdict]))
    return tuple(out)


def _as_pairs(budget: Budget, alone: Mapping[str, float]) -> list[Pair]:
    """The two leading effects of the budget as a pair, where it has two or more."""
    if len(budget.parts) < 2:
        return []
    first, second = (part.member for part in budget.parts[:2])
    best = budget.best
    gain = best.evidence - max(alone[first[0].name], alone[second[0].name])
    return [Pair(first, second, best.fit, best.evidence, gain, remainder_of(best.fit))]


def _at(found: SiteMap, sites: Collection[str]) -> float:
    """Probability that a remainder, if there is one, lies at one of the sites."""
    somewhere = 1.0 - found.probabilities["none"]
    return sum(found.probabilities[site] for site in sites) / somewhere if somewhere > 1e-9 else 0.5


def _proposals(fit: Calibration, found: list[Candidate], answers: Answers) -> list[Proposal]:
    """Experiments that would best split the leading answers that are fitted, `none` among them."""
    best: dict[str, Calibration] = {"none": fit}
    for c in found:
        if c.fit is not None:
            best.setdefault(c.effect.name, c.fit)
    leading = sorted(best, key=lambda n: -answers.probabilities[n])[:3]
    return propose([best[n] for n in leading], [max(answers.probabilities[n], 0.02) for n in leading], top=5)


def _reseeded(fit: Calibration, found: list[Candidate]) -> tuple[Calibration, list[Candidate]]:
    """The nominal model fitted again from where the leaders lie: a better basin than its own lowers their gain."""
    size = fit.problem.size
    leaders = [c.fit for c in found[:2] if c.fit is not None]
    if not leaders:
        return fit, found
    fits = [calibrate(fit.problem, [c.q[:size]], eta=c.eta, anneal=False, most=12) for c in leaders]
    again = min(fits, key=lambda f: f.cost)
    gained = again.log_evidence - fit.log_evidence
    if not gained > 0.05:
        return fit, found
    return again, [
        Candidate(c.effect, c.variant, c.screens, c.fit, c.log_evidence - (gained if c.fit is not None else 0.0))
        for c in found
    ]


def _with_winners_noise(fit: Calibration, found: list[Candidate]) -> tuple[Calibration, list[Candidate]]:
    """Nominal model and leaders under the noise that the leader shows, where it is smaller: a bad model inflates it."""
    leader = next((c for c in found if c.fit is not None), None)
    if leader is None or leader.fit is None or leader.log_evidence < WORTH_RELEARNING:
        return fit, found
    noise = learn_noise(leader.fit)
    shrunk = max(old / new for old, new in zip(fit.problem.noise.innovation, noise.innovation, strict=True))
    if shrunk < 1.015:
        return fit, found
    base = Problem(
        fit.problem.experiment, nominal=fit.problem.nominal, noise=noise, switches=fit.problem.switches,
        threads=fit.problem.threads, tolerance=fit.problem.tolerance, trials=fit.problem.trials,
    )  # fmt: skip
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
        fit, rounds = c.fit, 0
        if c.fit is not None and c.log_evidence + Quadratic.of(c.fit).log_evidence() - c.fit.log_evidence > best:
            while fit is not None and not fit.converged and rounds < MOST_ROUNDS:
                fit = calibrate(fit.problem, [fit.q], eta=fit.eta, anneal=False)
                rounds += 1
        gained = fit.log_evidence - c.fit.log_evidence if fit is not None and c.fit is not None else 0.0
        out.append(replace(c, fit=fit, log_evidence=c.log_evidence + gained) if gained > 0.0 else c)
    return sorted(out, key=lambda c: -c.log_evidence)


def sites_of(experiment: Experiment) -> tuple[str, ...]:
    """The sites that a rig has: a second body only in coupled trials, a release only where records begin at rest."""
    missing = set() if experiment.coupled else {"interface", "ground2"}
    missing |= set() if experiment.start == "rest" else {"release"}
    return tuple(site for site in SITES if site not in missing)


def _sites(
    answers: Answers, effects: Mapping[str, Effect], before: SiteMap, after: SiteMap, known: Sequence[str],
    miswired: bool = False,
) -> dict[str, float]:  # fmt: skip
    """Probability of each site: effects at their own, `unknown` as the site maps of gap and remainder say.

    known : the sites that the rig has; miswired : channels under a wrong name explain the gap better than any torque,
    so it lies at the sensors.
    """
    sites = dict.fromkeys((*known, "none"), 0.0)
    for name, p in answers.probabilities.items():
        if name == "none":
            sites["none"] += p
        elif name != "unknown":
            sites[effects[name].site] = sites.get(effects[name].site, 0.0) + p
    if answers.pair_effects is not None:
        # The stronger effect of a pair carries its probability; the place is where both are.
        here, there = (effects[name].site for name in answers.pair_effects)
        sites[here] -= 0.5 * answers.pair
        sites[there] += 0.5 * answers.pair
    weights = {s: before.probabilities.get(s, 0.0) + 0.5 * after.probabilities.get(s, 0.0) + 0.01 for s in known}
    if miswired:
        weights = {s: float(s == "sensor") + 0.01 for s in known}
    total = sum(weights.values())
    for site in known:
        sites[site] += answers.probabilities["unknown"] * weights[site] / total
    return sites


def _indistinct(evidence: Mapping[str, float], effects: Mapping[str, Effect]) -> list[tuple[str, ...]]:
    """Declared classes among the candidates, and the leaders whose evidence lies within 3 nats of the first."""
    groups = [tuple(sorted(group)) for group in classes({n: effects[n] for n in evidence})]
    if evidence:
        top = max(evidence.values())
        close = tuple(sorted(n for n, z in evidence.items() if z > top - INDISTINCT)) if top > INDISTINCT else ()
        if len(close) > 1 and close not in groups:
            groups.append(close)
    return groups
