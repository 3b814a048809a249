"""The diagnosis of published numbers: what 24 features can say about the cause of the gap, and no more.

The same answers as for records (`none`, `unknown`, the effects), with the same prior probabilities; the evidence is
that of joint.py. `unknown` is a generic discrepancy: an error of some features in addition to their standard errors,
relative to the feature and of unknown size, in four variants (which features it touches).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import logsumexp

from bayes_damper.diagnosis.joint import Formula, Joint, Weighed, beginning, from_prior, learn, weigh_formula
from bayes_damper.diagnosis.next_experiment import bhattacharyya, expected_information
from bayes_damper.diagnosis.pipeline import INDISTINCT
from bayes_damper.diagnosis.result import SCHEMA
from bayes_damper.diagnosis.verdict import PRIOR_NONE, PRIOR_UNKNOWN, USUAL, credible_set
from bayes_damper.effects import EFFECTS, Effect, candidates
from bayes_damper.effects.base import SITES
from bayes_damper.priors.distributions import Distribution, LogNormal, median
from bayes_damper.priors.files import PriorSet
from bayes_damper.published.posterior import FEATURE_QUANTITIES, Datum
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.runs.contents.diagnosis import (
    CombinedEntry,
    DiagnosisFile,
    EffectEntry,
    Estimate,
    FeatureEntry,
    FormulaEntry,
    GapEntry,
    ProposalEntry,
)
from bayes_damper.sampling.arviz_adapter import hdi
from bayes_damper.sampling.moves import StudentT
from bayes_damper.simulation.model import Model
from bayes_damper.simulation.precompile import compile_ahead

Array = NDArray[np.float64]
Data = Mapping[str, Sequence[Datum]]

BLUR_PRIOR: Distribution = LogNormal(0.1, 2.0)
"""Size of a generic discrepancy relative to the feature: between a few and some tens of per cent."""
SIZE = 0.05  # of the test for a gap
LOOSE, FEW_DRAWS = 1.5, 30.0  # nats between repeats, effective draws: from which an evidence is poorly known
_DRAWS = 240
_TOLD_OF_WEIGHING = 20  # times
_LEAST, _CAUTION = 0.01, 2.0  # probability, and nats, below which a formula is looked at once only
_LEADING = 4  # answers between which the next experiment is to decide
_NOISE = 2.0  # rad/s^2, of the records that a next experiment would take
_COMPONENTS = 12
_UNITS = {"log_decrement": "1", "period": "s", "max_acceleration": "rad/s^2"}


@dataclass(frozen=True)
class Settings:
    """How much is computed: rounds and draws of the search that begins at the prior; draws carried along in a first
    look at every formula; draws carried along and most sweeps a stage on the way to the evidence of those that may
    matter, in independent repeats.
    """

    search_rounds: int = 8
    search_count: int = 768
    look: int = 64
    count: int = 192
    sweeps: int = 8
    repeats: int = 2


def formulas(
    nominal: Literal["nonlinear", "linear"] = "nonlinear", effects: Mapping[str, Effect] = EFFECTS
) -> list[Formula]:
    """The nominal model, the variants of `unknown`, and every formula of every effect that the rig can have."""
    peak = {("coupled", "max_acceleration")}
    coupled = {("coupled", q) for q in FEATURE_QUANTITIES}
    both, everything = (
        {(c, q) for c in ("uncoupled", "coupled") for _, q in which} for which in (peak, coupled)
    )  # fmt: skip
    at_coupling, elsewhere = ("interface", "ground2"), ("ground1", "bearings", "release", "sensor")
    unknown = (
        ("coupled peaks", peak, at_coupling), ("coupled features", coupled, at_coupling),
        ("all peaks", both, elsewhere), ("all features", everything, elsewhere),
    )  # fmt: skip
    out = [Formula("none", "nominal", "the nominal model")]
    out += [
        Formula("unknown", name, f"error of the {name} in addition", sites, None, frozenset(which), BLUR_PRIOR)
        for name, which, sites in unknown
    ]
    for effect in candidates(True, True, nominal, effects).values():
        out += [Formula(effect.name, v.name, v.formula, (effect.site,), v) for v in effect.variants]
    return out


@dataclass(frozen=True)
class Result:
    """One formula: evidence relative to the nominal model with its standard error, and its runs (none if `silent`:
    it changes none of the published numbers).
    """

    formula: Formula
    log_evidence: float
    error: float
    runs: tuple[Weighed, ...]
    silent: bool = False

    @property
    def spread(self) -> float:
        """Largest difference between the log evidences of independent repeats; 0 if there is one, or if silent."""
        evidences = [w.log_z for w in self.runs]
        return 0.0 if self.silent else max(evidences) - min(evidences)


@dataclass(frozen=True)
class Row:
    """One published number and what a model that has not seen the coupled numbers of this case says of it."""

    case: str
    datum: Datum
    predicted: Array
    heldout: bool
    p_value: float

    def to_json(self) -> FeatureEntry:
        """An entry of `where.feature`."""
        low, high = hdi(self.predicted)
        return {
            "case": self.case, "configuration": self.datum.configuration, "feature": self.datum.quantity,
            "unit": _UNITS[self.datum.quantity], "measured": self.datum.value,
            "standard_error": self.datum.standard_error, "predicted": float(np.median(self.predicted)),
            "predicted_hdi90": [low, high], "held_out": self.heldout, "p_value": self.p_value,
        }  # fmt: skip


@dataclass(frozen=True)
class Measurement:
    """A further measurement and the information, nats, that it is expected to give about the leading answers."""

    configuration: str
    k1t: float
    theta0: float
    kind: str
    information: float
    margin: float

    def to_json(self) -> ProposalEntry:
        """An entry of `next_experiment`."""
        return {
            "configuration": self.configuration, "k1t_n_m_per_rad": self.k1t,
            "theta0_deg": math.degrees(self.theta0), "measurement": self.kind,
            "expected_information_nats": self.information, "margin": self.margin,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class PublishedDiagnosis:
    """The answer for published numbers, with what stands behind it.

    results : every formula; evidence, errors : of each family, relative to the nominal model; rows : the numbers
    beside their prediction, by answer ("none" and the leading ones).
    """

    nominal_kind: str
    data: Data
    results: tuple[Result, ...]
    answers: PublishedAnswers
    probability_errors: Mapping[str, float]
    evidence: Mapping[str, float]
    errors: Mapping[str, float]
    sites: Mapping[str, float]
    rows: Mapping[str, tuple[Row, ...]]
    p_value: float
    gap: GapEntry
    indistinguishable: tuple[tuple[str, ...], ...]
    proposals: tuple[Measurement, ...]
    notes: tuple[str, ...]
    log_evidence_none: tuple[float, float]
    seed: int
    seconds: float

    @property
    def verdict(self) -> str:
        """One effect, "none" or "unknown"."""
        return self.answers.verdict

    def best_of(self, family: str) -> Result:
        """The formula of a family with the largest evidence."""
        return max((r for r in self.results if r.formula.family == family), key=lambda r: r.log_evidence)

    def to_json(self) -> DiagnosisFile:
        """The fields of diagnosis.json (schema bayes-damper/diagnosis/1)."""
        none = self.rows["none"]
        effects = [name for name in self.evidence if name != "unknown"]
        return {
            "schema": SCHEMA,
            "campaign": "thesis",
            "nominal": self.nominal_kind,
            "verdict": self.verdict,
            "credible_set": self.answers.credible_set(),
            "probabilities": self.answers.probabilities,
            "probability_errors": dict(self.probability_errors),
            "pair": None,
            "sites": dict(self.sites),
            "gap": self.gap,
            "where": {
                "feature": [row.to_json() for row in none],
                "case": _combined(none, lambda row: row.case),
                "configuration": _combined(none, lambda row: row.datum.configuration),
                "quantity": _combined(none, lambda row: f"{row.datum.configuration} {row.datum.quantity}"),
            },
            "effects": [self._entry(name) for name in sorted(effects, key=lambda n: -self.evidence[n])],
            "unknown": [self._formula(r) for r in self.results if r.formula.family == "unknown"],
            "none": {"log_evidence": self.log_evidence_none[0], "log_evidence_error": self.log_evidence_none[1]},
            "indistinguishable": [list(group) for group in self.indistinguishable],
            "next_experiment": [p.to_json() for p in self.proposals],
            "notes": list(self.notes),
            "seed": self.seed,
            "seconds": self.seconds,
        }

    def _formula(self, result: Result) -> FormulaEntry:
        return {
            "variant": result.formula.name,
            "formula": result.formula.text,
            "log_evidence": result.log_evidence,
            "log_evidence_error": result.error,
            "effective_draws": 0.0 if result.silent else sum(w.ess for w in result.runs),
            "spread_of_repeats": result.spread,
            "acts": not result.silent,
            "parameters": _parameters(result),
        }

    def _entry(self, name: str) -> EffectEntry:
        best = self.best_of(name)
        return cast("EffectEntry", {
            "name": name,
            "site": best.formula.sites[0],
            "probability": self.answers.probabilities[name],
            **self._formula(best),
            "log_evidence": self.evidence[name],
            "log_evidence_error": self.errors[name],
            "variants": [self._formula(r) for r in self.results if r.formula.family == name],
        })  # fmt: skip


def _parameters(result: Result) -> dict[str, Estimate]:
    """What a formula adds: mean, sd and interval of each of its parameters; nothing where it changes no number."""
    out: dict[str, Any] = {}
    if result.silent:
        return out
    rng = np.random.default_rng(0)
    for name in result.formula.extras:
        run = result.runs[0]
        draws = np.concatenate([_values(w, w.draw(rng, 2000), name) for w in result.runs])
        unit = {} if run.joint.formula.variant is None else {
            p.name: p.unit for p in run.joint.formula.variant.parameters
        }  # fmt: skip
        short = name.removeprefix(OF_EFFECT)
        out[short] = {
            "unit": unit.get(short, "1"), "mean": float(draws.mean()), "sd": float(draws.std()),
            "median": float(np.median(draws)), "hdi90": list(hdi(draws)),
        }  # fmt: skip
    return out


def _values(run: Weighed, points: Array, name: str) -> Array:
    return run.joint.coordinates.values(points)[name]


def _combined(rows: Sequence[Row], key: Callable[[Row], str]) -> list[CombinedEntry]:
    """The smallest p-value of each group of rows, times the number of its rows."""
    groups: dict[str, list[float]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row.p_value)
    return [
        {"name": name, "numbers": len(p), "p_value": min(1.0, min(p) * len(p))} for name, p in groups.items()
    ]  # fmt: skip


# The way from numbers to answers ------------------------------------------------------------------------------------


def diagnose_published(
    data: Data,
    priors: PriorSet,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: Mapping[str, Effect] = EFFECTS,
    seed: int = 1,
    workers: int = 2,
    settings: Settings = Settings(),
    report: Callable[[str], None] = lambda _: None,
) -> PublishedDiagnosis:
    """Which effects explain published features, which cannot be excluded, and what measurement would decide.

    data : case -> its numbers; priors : of the nominal parameters; nominal : "linear" takes mu and drag as zero.

    Raises
    ------
    InputError
        if the priors cannot be used, or the likelihood is zero wherever they lead.
    """
    began = time.perf_counter()
    if nominal == "linear":
        priors = priors.replace(mu=0.0, drag=0.0)
    everything = formulas(nominal, effects)
    joints = [Joint(data, priors, f) for f in everything]
    compile_ahead(
        (m for joint in joints for case in joint.cases.values() for m in case.posterior.models.values()), report=report
    )
    with ThreadPoolExecutor(max(workers, 1)) as pool:
        seeds = [np.random.default_rng([seed, r]) for r in range(settings.repeats)]
        shapes = list(pool.map(lambda rng: search(joints[0], rng, settings), seeds))
        report(f"nominal model fitted; weighing {len(everything) - 1} formulas")
        loud = list(pool.map(lambda j: _acts(j, joints[0], shapes[0], seed), joints))

        def run(job: tuple[int, int], count: int) -> Weighed:
            i, r = job
            rng = np.random.default_rng([seed, r, i, count])
            begin = beginning(shapes[r], joints[i])
            return weigh_formula(joints[i], begin, rng, count=count, sweeps=settings.sweeps)

        def weighed(jobs: Sequence[tuple[int, int]], count: int, what: str) -> dict[int, list[Weighed]]:
            out: dict[int, list[Weighed]] = {}
            runs = pool.map(partial(run, count=count), jobs)
            for done, ((i, _), one) in enumerate(zip(jobs, runs, strict=True), 1):
                out.setdefault(i, []).append(one)
                if done % max(1, len(jobs) // _TOLD_OF_WEIGHING) == 0:
                    report(f"{done} of {len(jobs)} {what}")
            return out

        found = weighed([(i, 0) for i in range(len(joints)) if loud[i]], settings.look, "formulas looked at")
        again = contenders(everything, {i: runs[0].log_z for i, runs in found.items()})
        jobs = [(i, r) for i in again for r in range(settings.repeats)]
        found |= weighed(jobs, settings.count, f"weighings done, {settings.repeats} of each formula that may matter")
        # Everything is measured against the nominal model: it gets four times the draws.
        found |= weighed(
            [(0, r) for r in range(settings.repeats)], 4 * settings.count, "weighings of the nominal model"
        )
    base, base_error = _pooled(found[0])
    results = []
    for i, formula in enumerate(everything):
        z, error = _pooled(found[i]) if loud[i] else (base, 0.0)
        results.append(Result(formula, z - base, error, tuple(found.get(i, found[0])), not loud[i]))
    evidence, errors = _families(results)
    rng = np.random.default_rng([seed, settings.repeats])
    answers, spread = unsure(evidence, errors, base_error, rng)
    leading = [n for n in answers.ranked if n not in ("none", "unknown")][:3]
    best = {n: max((r for r in results if r.formula.family == n), key=lambda r: r.log_evidence) for n in evidence}
    best["none"] = results[0]
    report("comparing the numbers with what is predicted for them")
    rows = {name: predicted_rows(best[name].runs, rng) for name in ("none", *leading)}
    p_value = _gap_p(results[0].runs[0], rng)
    gap = _gap(rows["none"], rows[leading[0]] if leading else rows["none"], p_value, answers)
    shown = [n for n in answers.ranked if n != "unknown"][:_LEADING]
    proposals = further([best[n].runs for n in shown], [answers.probabilities[n] for n in shown], rng)
    return PublishedDiagnosis(
        nominal, data, tuple(results), answers, spread, evidence, errors,
        _sites(answers, results, evidence), rows, p_value, gap, _indistinct(evidence), tuple(proposals[:5]),
        tuple(_notes(answers, results, data, cannot_rank(evidence, errors))), (base, base_error), seed,
        time.perf_counter() - began,
    )  # fmt: skip


def contenders(everything: Sequence[Formula], evidences: Mapping[int, float]) -> list[int]:
    """Formulas (numbers) whose answer could keep 1 % if its first look were wrong by `_CAUTION` nats; not the nominal.

    evidences : number -> log evidence of a first look; of those without one the nominal model's.
    """
    known = np.array([evidences.get(i, evidences[0]) for i in range(len(everything))])
    families = [f.family for f in everything]
    prior = prior_probabilities(sorted(set(families) - {"none", "unknown"}))
    log_w = np.log([prior[name] / families.count(name) for name in families]) + known
    share = log_w - logsumexp(log_w)
    return [i for i in evidences if i > 0 and share[i] > math.log(_LEAST / families.count(families[i])) - _CAUTION]


def search(joint: Joint, rng: np.random.Generator, settings: Settings) -> StudentT:
    """Where the nominal model's posterior is, starting from the prior."""
    return learn(joint, from_prior(joint), rng, settings.search_rounds, settings.search_count)[-1]


def _acts(joint: Joint, nominal: Joint, known: StudentT, seed: int) -> bool:
    """Whether a formula changes any of the published numbers at points that its prior leads to."""
    if joint.formula.variant is None:
        return True
    points = beginning(known, joint).draw(np.random.default_rng(seed), 32)
    return any(
        not np.array_equal(
            joint.at_the_middle(points, case), nominal.at_the_middle(points[:, : nominal.ndim], case), equal_nan=True
        )
        for case in joint.cases
    )


def _pooled(runs: Sequence[Weighed]) -> tuple[float, float]:
    """Log of the mean evidence of independent runs; of its error the larger of what they say and what they show."""
    evidences = np.array([r.log_z for r in runs])
    value = float(logsumexp(evidences) - math.log(len(runs)))
    # Few effective draws cannot tell how few they are: each run's error is taken as at least that of so many.
    stated = math.sqrt(sum(max(r.error, 1.0 / math.sqrt(r.ess)) ** 2 for r in runs)) / len(runs)
    shown = float(evidences.std(ddof=1)) / math.sqrt(len(runs)) if len(runs) > 1 else 0.0
    return value, max(stated, shown)


def _families(results: Sequence[Result]) -> tuple[dict[str, float], dict[str, float]]:
    """Log evidence of each family over the nominal model (mean over its formulas), and its standard error."""
    evidence, errors = {}, {}
    for name in dict.fromkeys(r.formula.family for r in results if r.formula.family != "none"):
        rows = [r for r in results if r.formula.family == name]
        z = np.array([r.log_evidence for r in rows])
        share = np.exp(z - logsumexp(z))
        evidence[name] = float(logsumexp(z) - math.log(len(z)))
        errors[name] = float(np.sqrt(np.sum((share * np.array([r.error for r in rows])) ** 2)))
    return evidence, errors


@dataclass(frozen=True)
class PublishedAnswers:
    """Probabilities of all answers, by prior probability times evidence alone."""

    probabilities: dict[str, float]

    @property
    def ranked(self) -> list[str]:
        """The answers, most probable first."""
        return sorted(self.probabilities, key=lambda n: -self.probabilities[n])

    @property
    def verdict(self) -> str:
        """The most probable answer."""
        return self.ranked[0]

    def credible_set(self, share: float = 0.9) -> list[str]:
        """The smallest set of answers that holds at least `share` of the probability."""
        return credible_set(self.probabilities, share)


def prior_probabilities(names: Sequence[str]) -> dict[str, float]:
    """Of `none`, `unknown` and effects of these names."""
    each = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / max(len(names), USUAL)
    return {"none": PRIOR_NONE, "unknown": PRIOR_UNKNOWN} | dict.fromkeys(names, each)


def weigh_answers(evidence: Mapping[str, float]) -> PublishedAnswers:
    """Probabilities of `none`, `unknown` and the effects from log evidences over the nominal model.

    Prior probabilities are those of a diagnosis of records. Unlike there, nothing is tempered: 24 numbers with
    heavy-tailed errors make no evidence that would have to be distrusted.
    """
    prior = prior_probabilities([n for n in evidence if n != "unknown"])
    log_w = np.array([math.log(prior[n]) + (0.0 if n == "none" else evidence[n]) for n in prior])
    share = np.exp(log_w - logsumexp(log_w))
    probabilities = {n: float(p) for n, p in zip(prior, share, strict=True)}
    return PublishedAnswers(probabilities)


def unsure(
    evidence: Mapping[str, float], errors: Mapping[str, float], base: float, rng: np.random.Generator
) -> tuple[PublishedAnswers, dict[str, float]]:
    """Probabilities averaged over what the computation leaves open about the evidences, and their sd over that.

    errors : standard error of each log evidence; base : that of the nominal model's, which all share.
    """
    rows = []
    for _ in range(400):
        common = base * rng.standard_normal()
        drawn = {n: z + errors[n] * rng.standard_normal() - common for n, z in evidence.items()}
        rows.append(weigh_answers(drawn).probabilities)
    mean = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return PublishedAnswers(mean), {n: float(np.std([r[n] for r in rows])) for n in mean}


# What is predicted for the numbers, and how far the prediction is from them -------------------------------------


def predicted_rows(runs: Sequence[Weighed], rng: np.random.Generator) -> tuple[Row, ...]:
    """Every published number beside its prediction; coupled numbers are predicted without those of their case.

    To leave the coupled numbers of a case out, points are weighted by the ratio of the likelihoods without and with
    them.
    """
    joint = runs[0].joint
    points = np.concatenate([w.points for w in runs])
    weights = np.concatenate([w.log_weights for w in runs])
    keep = weights > weights.max() - 14.0
    points, weights = points[keep], weights[keep]
    out = []
    values = joint.coordinates.values(points)
    for name, case in joint.cases.items():
        without = weights + case.log_density(values, coupled=False) - case.log_density(values)
        for held, log_w in ((True, without), (False, weights)):
            share = np.exp(log_w - logsumexp(log_w))
            chosen = points[rng.choice(len(points), _DRAWS, p=share)]
            features, _ = joint.features(chosen, name, rng, coupled=not held)
            features = features[np.isfinite(features).all(axis=1)]
            for j, datum in enumerate(case.data):
                if (datum.configuration == "coupled") != held:
                    continue
                noise = datum.standard_error * rng.standard_t(datum.n - 1.0, len(features))
                below = float(np.mean(features[:, j] + noise < datum.value))
                floor = 0.5 / len(features)
                p = 2.0 * max(min(below, 1.0 - below), floor)
                out.append(Row(name, datum, features[:, j], held, min(p, 1.0)))
    order = list(joint.cases)
    return tuple(sorted(out, key=lambda r: (order.index(r.case), r.datum.configuration != "uncoupled")))


def _gap_p(run: Weighed, rng: np.random.Generator) -> float:
    """Posterior predictive p-value of the coupled numbers' misfit under the nominal model.

    Misfit: minus the log Student density; replicated numbers are drawn at the same points. Such a test rejects less
    often than its size says.
    """
    joint = run.joint
    points = run.draw(rng, _DRAWS)
    real, replicated = np.zeros(_DRAWS), np.zeros(_DRAWS)
    for name, case in joint.cases.items():
        features, _ = joint.features(points, name, rng)
        for j, d in enumerate(case.data):
            if d.configuration != "coupled":
                continue
            t = (d.value - features[:, j]) / d.standard_error
            real += np.log1p(t**2 / joint.dof)
            replicated += np.log1p(rng.standard_t(joint.dof, _DRAWS) ** 2 / joint.dof)
    good = np.isfinite(real)
    return float((np.sum(replicated[good] >= real[good]) + 1.0) / (np.sum(good) + 1.0))


def _gap(none: Sequence[Row], leader: Sequence[Row], p_value: float, answers: PublishedAnswers) -> GapEntry:
    """The gap on the coupled peaks, predicted without the coupled numbers of their case."""

    def peaks(rows: Sequence[Row]) -> list[Row]:
        return [r for r in rows if r.heldout and r.datum.quantity == "max_acceleration"]

    def squares(rows: Sequence[Row]) -> Array:
        return np.stack([(r.predicted[:120] - r.datum.value) ** 2 for r in rows if len(r.predicted) >= 120])

    before, after = peaks(none), peaks(leader)
    noise = float(np.mean([r.datum.standard_error**2 for r in before]))
    x0, x1 = squares(before).mean(axis=0), squares(after).mean(axis=0)
    middle = [float(np.mean([(np.median(r.predicted) - r.datum.value) ** 2 for r in rows])) for rows in (before, after)]
    closed = (middle[0] - x1) / (middle[0] - noise) if middle[0] > noise else None
    sure = answers.probabilities["none"]
    answer = "gap" if p_value < SIZE else "none" if sure > 0.9 else "cannot tell"
    return {
        "answer": answer,
        "p_value": p_value,
        "size": SIZE,
        "unit": "rad/s^2",
        "on": "coupled peaks, each predicted without the coupled numbers of its case",
        "noise_rms": math.sqrt(noise),
        "nominal_rms": math.sqrt(middle[0]),
        "nominal_rms_hdi90": list(hdi(np.sqrt(x0))),
        "augmented_rms": math.sqrt(middle[1]),
        "mean_difference": float(np.mean([np.median(r.predicted) - r.datum.value for r in before])),
        "closed": None if closed is None else {"median": float(np.median(closed)), "hdi90": list(hdi(closed))},
    }


def _sites(answers: PublishedAnswers, results: Sequence[Result], evidence: Mapping[str, float]) -> dict[str, float]:
    """Probability of each site; `unknown` goes to the sites that can touch the features its variants make uncertain."""
    sites = dict.fromkeys((*SITES, "none"), 0.0)
    sites["none"] = answers.probabilities["none"]
    variants = [r for r in results if r.formula.family == "unknown"]
    z = np.array([r.log_evidence for r in variants])
    for r, share in zip(variants, np.exp(z - logsumexp(z)), strict=True):
        for site in r.formula.sites:
            sites[site] += answers.probabilities["unknown"] * float(share) / len(r.formula.sites)
    places = {r.formula.family: r.formula.sites[0] for r in results if r.formula.variant is not None}
    for name in evidence:
        if name in places:
            sites[places[name]] += answers.probabilities[name]
    return sites


def _indistinct(evidence: Mapping[str, float]) -> tuple[tuple[str, ...], ...]:
    """The answers whose evidence lies within 3 nats of the best, the nominal model among them where it does."""
    known = {"none": 0.0} | dict(evidence)
    top = max(known.values())
    close = tuple(sorted((n for n, z in known.items() if z > top - INDISTINCT), key=lambda n: -known[n]))
    return (close,) if len(close) > 1 else ()


def _loose(result: Result) -> bool:
    """Whether a formula's evidence is too poorly known to rank it."""
    return result.spread > LOOSE or min(w.ess for w in result.runs) < FEW_DRAWS


def _notes(answers: PublishedAnswers, results: Sequence[Result], data: Data, close: Sequence[str]) -> list[str]:
    """What could not be found out, in sentences; close : effects that cannot be ranked among each other."""
    count = sum(len(rows) for rows in data.values())
    shared = "One set of parameters is shared by all cases; each case has a spring and a release angle of its own."
    notes = [f"The answer rests on {count} published numbers, not on records. {shared}"]
    kept = [n for n in answers.ranked if answers.probabilities[n] >= 0.01]
    if answers.probabilities[answers.verdict] < 0.9:
        notes.append(f"No answer reaches 90 %: {len(kept)} answers keep at least 1 % each and cannot be excluded.")
    if len(close) > 1:
        notes.append(
            f"Which named effect comes first cannot be said: {', '.join(close)} differ by less than the errors of "
            "their evidences."
        )
    silent = sorted({r.formula.family for r in results if r.silent})
    loud = {r.formula.family for r in results if not r.silent}
    mute = [n for n in silent if n not in loud]
    if mute:
        notes.append(f"These numbers say nothing at all about: {', '.join(mute)}.")
    loose = sorted({r.formula.family for r in results if not r.silent and len(r.runs) > 1 and _loose(r)})
    if loose:
        notes.append(
            f"The evidence of a formula of {', '.join(loose)} differs by more than {LOOSE:g} nats between repeats, or "
            f"rests on fewer than {FEW_DRAWS:g} effective draws: its place in the ranking is not sure."
        )
    once = sorted(loud - {r.formula.family for r in results if len(r.runs) > 1})
    if once and len(results[0].runs) > 1:
        notes.append(
            f"Looked at once, with few draws: {', '.join(once)}. {_CAUTION:g} nats more would not bring them to "
            f"{100 * _LEAST:g} %."
        )
    return notes


def cannot_rank(evidence: Mapping[str, float], errors: Mapping[str, float]) -> list[str]:
    """Effects whose evidence lies within two standard errors of the best effect's, that one first."""
    names = sorted((n for n in evidence if n != "unknown"), key=lambda n: -evidence[n])
    first = names[0]
    return [n for n in names if evidence[first] - evidence[n] <= 2.0 * math.hypot(errors[first], errors[n])]


# What to measure next -------------------------------------------------------------------------------------------------

KINDS = ("record of the primary", "records of both bodies")


def further(
    answers: Sequence[Sequence[Weighed]],
    probabilities: Sequence[float],
    rng: np.random.Generator,
    draws: int = 160,
) -> list[Measurement]:
    """Further measurements on the thesis's rig by the information they are expected to give about the leading answers.

    Each answer predicts the measurement at draws of its posterior, with the spring of a case and a release angle of
    2 % uncertainty. Predictions are taken as Gaussian in the few directions in which they differ most; the information
    is bounded below by their Bhattacharyya distances, as for records (next_experiment.py).
    """
    if len(answers) < 2:
        return []
    p = np.array(probabilities) / sum(probabilities)
    springs: dict[float, str] = {}
    joint = answers[0][0].joint
    for name, case in joint.cases.items():
        springs.setdefault(round(float(median(case.own["k1t"])), 6), name)
    angles = [median(case.own["theta0"]) for case in joint.cases.values()]
    tried = np.geomspace(0.75 * min(angles), 1.4 * max(angles), 4)
    times = np.concatenate([np.arange(1, 11) * 1e-4, np.arange(2, 401) * 1e-3])
    taken = []
    for runs in answers:
        per = [w.draw(rng, draws // len(runs)) for w in runs]
        points = np.concatenate(per)
        taken.append((runs[0].joint, points))
    out = []
    for stiffness, name in springs.items():
        own = [j.features(x, name, rng)[1] for j, x in taken]
        for angle in tried:
            for configuration in ("uncoupled", "coupled"):
                records = []
                for (j, x), k1t in zip(taken, own, strict=True):
                    theta0 = angle * (1.0 + 0.02 * rng.standard_normal(len(x)))
                    records.append(_record(j, x, k1t, theta0, configuration, times))
                kinds = {KINDS[0]: [r[:, 0] for r in records]}
                if configuration == "coupled":
                    kinds[KINDS[1]] = [r.reshape(len(r), -1) for r in records]
                for kind, y in kinds.items():
                    information, margin = _information(p, y)
                    out.append(Measurement(configuration, stiffness, float(angle), kind, information, margin))
    return sorted(out, key=lambda m: (-round(m.information, 3), -m.margin))


def _record(joint: Joint, points: Array, k1t: Array, theta0: Array, configuration: str, times: Array) -> Array:
    """Readings (n, channels, times) at points of a posterior, over the noise; without those that failed."""
    values = {n: x for n, x in joint.coordinates.values(points).items() if n not in ("t_min", "blur")}
    effect = {n.removeprefix(OF_EFFECT): values.pop(n) for n in list(values) if n.startswith(OF_EFFECT)}
    model = Model(configuration == "coupled", effect=joint.formula.variant)
    y = model.simulate(values | {"k1t": k1t, "theta0": theta0}, times, effect=effect).y / _NOISE
    return np.asarray(y[np.isfinite(y).all(axis=(1, 2))])


def _information(p: Array, y: Sequence[Array]) -> tuple[float, float]:
    """Expected information about the answers (nats) and the smallest distance of two, from predictions (n, d) each."""
    if min(len(rows) for rows in y) < 3 * _COMPONENTS:
        return 0.0, 0.0
    centre = np.average([rows.mean(axis=0) for rows in y], axis=0, weights=p)
    pooled = np.concatenate([rows - centre for rows in y])
    d = pooled.shape[1]
    axes = eigh(pooled.T @ pooled, subset_by_index=(max(d - _COMPONENTS, 0), d - 1))[1].T
    shapes = []
    for rows in y:
        z = (rows - centre) @ axes.T
        mean = z.mean(axis=0)
        shapes.append((mean, (z - mean).T / math.sqrt(len(z) - 1.0)))
    count = len(y)
    # Two samples of one Gaussian are this far apart by chance.
    chance = _COMPONENTS * (_COMPONENTS + 3.0) / (8.0 * float(np.mean([len(rows) for rows in y])))
    distance = np.zeros((count, count))
    for a in range(count):
        for b in range(a):
            distance[a, b] = distance[b, a] = max(0.0, bhattacharyya(*shapes[a], *shapes[b]) - chance)
    return expected_information(p, distance), float(np.min(distance[np.triu_indices(count, 1)]))
