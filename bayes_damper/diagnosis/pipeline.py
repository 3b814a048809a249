"""From a campaign to an answer: calibration, search, remainder, verdict, and how far the gap shrinks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from bayes_damper.calibration import (
    Calibration,
    Experiment,
    calibrate,
    calibrate_nominal,
    experiment_of,
    fitted_to_all,
    with_rounding,
)
from bayes_damper.calibration.cases import SHOWS_FROM, with_damping_of_each_case
from bayes_damper.calibration.latency import AS_LATE, latency_in_words, with_latency, with_own_instants
from bayes_damper.calibration.trends import with_trends
from bayes_damper.campaign import Campaign
from bayes_damper.diagnosis.by_case import differing_in_words
from bayes_damper.diagnosis.formula import widened
from bayes_damper.diagnosis.gap import closing, measure_gap
from bayes_damper.diagnosis.generic import UNKNOWN, site_of
from bayes_damper.diagnosis.generic import in_words as nameless_in_words
from bayes_damper.diagnosis.judgement import judge_by_repeats, judge_without_repeats, sites_of
from bayes_damper.diagnosis.later import continued
from bayes_damper.diagnosis.law import learn
from bayes_damper.diagnosis.next_experiment import Proposal, propose
from bayes_damper.diagnosis.notes import imitated_in_words, notes_on
from bayes_damper.diagnosis.outliers import (
    odd_in_words,
    odd_trials,
    outlying,
    outlying_in_words,
    without,
    without_trials,
)
from bayes_damper.diagnosis.result import Diagnosis
from bayes_damper.diagnosis.search import Candidate, from_usual_friction, generics_of, offered, search
from bayes_damper.diagnosis.sensitivity import in_a_sentence
from bayes_damper.diagnosis.sites import SiteMap, site_map
from bayes_damper.diagnosis.verdict import RULE, Answers, Rule
from bayes_damper.diagnosis.where import locate
from bayes_damper.effects import EFFECTS, Effect, classes
from bayes_damper.effects.base import Variant
from bayes_damper.priors.distributions import Distribution
from bayes_damper.priors.files import PriorSet
from bayes_damper.runs.memory import shortage
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.text import counted

CLEANINGS = 2  # times that outlying readings are looked for: the first ones hide others
INDISTINCT = 3.0  # nats between two families below which these data cannot tell them apart
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
    the record of the run (every step is deterministic); workers : processes, or threads where a step has no parts;
    report : receives a line per stage.
    """
    with kernel_threads(workers):
        return _diagnosed(campaign, nominal, effects, priors, seed, workers, rule, report)


def _diagnosed(
    campaign: Campaign | Experiment,
    nominal: Literal["nonlinear", "linear"],
    effects: Mapping[str, Effect],
    priors: PriorSet | Mapping[str, Distribution | float] | None,
    seed: int,
    workers: int,
    rule: Rule,
    report: Callable[[str], None],
) -> Diagnosis:
    """The whole diagnosis, step by step."""
    began = time.perf_counter()
    if isinstance(campaign, Experiment):
        name, kind, experiment = "campaign", "torsional", campaign
    else:
        name, kind = campaign.name, campaign.rig.kind
        experiment = with_rounding(experiment_of(campaign, priors))
        if not any(t.holdout for t in campaign.trials):
            experiment = fitted_to_all(experiment)
    if short := shortage(sum(t.y.size for t in experiment.trials)):
        report(short)
    fit, notes = _cleaned_fit(experiment, nominal, report)
    fit = with_trends(fit, report)
    experiment = fit.problem.experiment
    pool = offered(experiment, nominal, effects)
    fit, found, said = _searched(fit, pool, workers, report)
    notes += said
    experiment = fit.problem.experiment
    judge = judge_without_repeats if fit.problem.noise.sensor else judge_by_repeats
    rng = np.random.default_rng(seed)
    judged = judge(fit, found, pool, rng, rule, workers, report)
    seen, winner, answers, pairs = judged.seen, judged.winner, judged.answers, judged.pairs
    fit, found, evidence, fits = seen.fit, seen.found, seen.evidence, seen.families
    pair = next((p for p in pairs if p.effects == answers.pair_effects), None)
    report(f"most probable answer so far: {answers.verdict}")
    best = pair.fit if pair is not None and answers.pair >= 0.5 else None if winner is None else winner.fit
    known = None if winner is None or winner.effect.name == UNKNOWN else winner
    named = best if known is not None and answers.verdict == known.effect.name else None
    if seen.wiring is not None:
        notes.insert(0, seen.wiring.sentence())
    notes += notes_on(experiment, fit, named, answers, seen.before_map)
    before_map, after_map = seen.before_map, seen.after_map
    if answers.verdict == UNKNOWN:
        notes += [*_nameless_in_words(found, experiment), *imitated_in_words(known, answers)]
        notes += differing_in_words(fit, max(evidence.values(), default=0.0))
        before_map, after_map, said = _located(before_map, after_map, report)
        notes += said
    notes.append(in_a_sentence(judged.choices, answers.verdict))
    report("measuring the gap on held-out trials, and how far it shrinks")
    # Where all trials chose the answer, those held out among them, its prediction is one of many.
    gap = measure_gap(fit, best, rng=rng, chosen_from=max(len(evidence), 1) if experiment.fits_all else 1)
    first = sorted(evidence, key=lambda n: -evidence[n])[:SHOWN]
    closes = {} if best is None else closing(fit, {n: fits[n][0] for n in first if n in fits}, rng)
    if best is not None and known is not None:
        acting = [known.effect] if best is known.fit or pair is None else [pair.first[0], pair.second[0]]
        best = widened(best, [effect.site for effect in acting])
    report("looking for the experiment that would decide best")
    proposals = tuple(_proposals(fit, found, answers))
    law = learn(fit, judged.budget, answers.verdict, before_map, name, kind, np.random.default_rng(seed), report)
    return Diagnosis(
        campaign=name, experiment=experiment, nominal_kind=nominal, nominal=fit, candidates=tuple(found),
        winner=winner, answers=answers, before=seen.before, after=seen.after, gap=gap, where=locate(fit),
        site_map=before_map, remainder_map=after_map, proposals=proposals,
        sites=_sites(
            answers, effects, before_map, after_map, sites_of(experiment), seen.wiring is not None,
            _done_at(found, known),
        ),
        evidence=evidence, indistinguishable=tuple(_indistinct(evidence, effects)), pair=pair, notes=tuple(notes),
        seconds=time.perf_counter() - began, seed=seed, pairs=tuple(pairs), drift=seen.drift, best=best,
        choices=tuple(judged.choices), closing=closes, weighed=judged.weighed, kind=kind, budget=judged.budget,
        under_priors=judged.under_priors, law=law, named=named,
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
        count = sum(int(mask.sum()) for mask in far.values())
        report(f"{counted(count, 'reading')} far from those of their repeats left out; fitting the nominal model again")
        experiment = without(experiment, far)
        fit = calibrate_nominal(experiment, nominal=nominal, begin=fit, report=report)
    return fit, notes


def _searched(
    fit: Calibration, pool: Sequence[tuple[Effect, Variant]], workers: int, report: Callable[[str], None]
) -> tuple[Calibration, list[Candidate], list[str]]:
    """The nominal model and all candidates, and sentences on clocks that are late.

    The model has the damping of each case's own spring, and an instant of each release, where that explains more than
    any effect, or than any that would show alike.
    """
    pool = [*pool, *generics_of(fit.problem.experiment)]
    found = search(fit, pool, workers=workers, report=report)
    leader = found[0].fit
    own = with_damping_of_each_case(fit, fit.cost if leader is None else min(fit.cost, leader.cost))
    if own is not None and own.log_evidence - fit.log_evidence > max(SHOWS_FROM, found[0].log_evidence):
        report("the damping differs from case to case more than any effect explains; fitting one for each case")
        fit = calibrate_nominal(own.problem.experiment, nominal=fit.problem.nominal, begin=own, report=report)
        found = search(fit, pool, workers=workers, report=report)
    notes = []
    alike = max((c.log_evidence for c in found if c.effect.site in AS_LATE), default=0.0)
    late = with_latency(fit) if alike > SHOWS_FROM else None
    if late is not None and late.log_evidence - fit.log_evidence > alike + SHOWS_FROM:
        report("all releases are late by the same time; fitting an instant for each")
        notes.append(latency_in_words(late))
        own = with_own_instants(fit, late)
        fit = calibrate_nominal(own.problem.experiment, nominal=fit.problem.nominal, begin=own, report=report)
        found = search(fit, pool, workers=workers, report=report)
    return (*_reseeded(fit, from_usual_friction(found)), notes)


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


def _located(before: SiteMap, after: SiteMap, report: Callable[[str], None]) -> tuple[SiteMap, SiteMap, list[str]]:
    """Where an unknown cause is: both maps less what the later part of the records refutes, and sentences."""
    later = continued(before, report)
    if later is None:
        return before, after, []
    found = site_map(before.fit, against=later.against)
    rest = found if after is before else site_map(after.fit, torque=False, against=later.against)
    said = later.in_words() if found.best == "release" else None
    return found, rest, [] if said is None else [said]


def _sites(
    answers: Answers, effects: Mapping[str, Effect], before: SiteMap, after: SiteMap, known: Sequence[str],
    miswired: bool = False, done_at: tuple[str, bool] | None = None,
) -> dict[str, float]:  # fmt: skip
    """Probability of each site: effects at their own, `unknown` as the site maps of gap and remainder say.

    known : the sites that the rig has; miswired : channels under a wrong name explain the gap better than any torque,
    so it lies at the sensors; done_at : site of the leading candidate, and whether it has no name: what it closes of
    the gap, with a name if its shape is one that such effects do not have, is done there by something else, unless what
    it leaves lies at another site.
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
    imitated, place = 0.0, ""
    if done_at is not None:
        place, nameless = done_at
        rest = {site: after.probabilities.get(site, 0.0) for site in (*known, place)}
        at_home = 1.0 - (max(rest.values()) - rest[place])
        closed = 1.0 - answers.left.share
        if nameless:  # without repeats `left` is that of the best set of effects with names
            closed = max(closed, after.probabilities.get("none", 0.0))
        imitated = closed * (1.0 if nameless else -math.expm1(-answers.left.odd)) * at_home
    for site in known:
        share = imitated * (site == place) + (1.0 - imitated) * weights[site] / total
        sites[site] += answers.probabilities["unknown"] * share
    return sites


def _done_at(found: Sequence[Candidate], known: Candidate | None) -> tuple[str, bool] | None:
    """Site of the leading candidate, and whether it has no name."""
    for effect, _, fit in _nameless(found):
        return site_of(effect, fit.parameters), True
    return None if known is None else (known.effect.site, False)


def _nameless_in_words(found: Sequence[Candidate], experiment: Experiment) -> list[str]:
    """What the leading candidate does, where it has no name."""
    out = []
    for effect, variant, fit in _nameless(found):
        channel = int(variant.name == "channel2")
        reach = max(float(np.nanmax(np.abs(t.y[channel]))) for t in experiment.trials if channel < len(t.y))
        out.append(nameless_in_words(effect, fit.parameters, reach))
    return out


def _nameless(found: Sequence[Candidate]) -> list[tuple[Effect, Variant, Calibration]]:
    """The leading candidate, where it has no name and is fitted."""
    return [(c.effect, c.variant, c.fit) for c in found[:1] if c.fit is not None and c.effect.name == UNKNOWN]


def _indistinct(evidence: Mapping[str, float], effects: Mapping[str, Effect]) -> list[tuple[str, ...]]:
    """Declared classes among the candidates, and the leaders whose evidence lies within 3 nats of the first."""
    groups = [tuple(sorted(group)) for group in classes({n: effects[n] for n in evidence})]
    if evidence:
        top = max(evidence.values())
        close = tuple(sorted(n for n, z in evidence.items() if z > top - INDISTINCT)) if top > INDISTINCT else ()
        if len(close) > 1 and close not in groups:
            groups.append(close)
    return groups
