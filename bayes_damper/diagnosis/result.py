"""The answer for one campaign and diagnosis.json, its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from bayes_damper.calibration import Calibration, Experiment
from bayes_damper.calibration.noise_spread import spread_of
from bayes_damper.calibration.scatter import scatter_shown
from bayes_damper.diagnosis.budget import Budget
from bayes_damper.diagnosis.gap import Gap, shifts
from bayes_damper.diagnosis.law import Learnt
from bayes_damper.diagnosis.next_experiment import Proposal
from bayes_damper.diagnosis.pairs import Pair
from bayes_damper.diagnosis.remainder import Remainder
from bayes_damper.diagnosis.search import Candidate
from bayes_damper.diagnosis.sensitivity import Choice
from bayes_damper.diagnosis.sets import SetProblem
from bayes_damper.diagnosis.shares import Closed
from bayes_damper.diagnosis.sites import SiteMap
from bayes_damper.diagnosis.verdict import Answers
from bayes_damper.diagnosis.where import Where
from bayes_damper.rig.parameters import OF_EFFECT, unit_of
from bayes_damper.runs.contents.diagnosis import DiagnosisFile, EffectEntry, Estimate, ShiftEntry
from bayes_damper.runs.json_files import plain

SCHEMA = "bayes-damper/diagnosis/1"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer for one campaign, with the fits behind it.

    candidates: every formula of every effect, best first, evidence relative to the nominal model; winner: the fitted
    formula of the leading effect, None if none could be fitted; best: its fit, or that of the pair where two effects
    are the answer, with the covariance that their inexact formulas leave (formula.py); before, after: what the nominal
    model and the winner leave unexplained; gap: on held-out trials, closed by `best`; closing: the same by each leading
    effect; choices: the verdict under other choices; site_map: where the nominal model's gap lies, without any library;
    remainder_map: the same for what the winner leaves; sites: probability of each site and "none"; pairs: fitted at
    once, best first; drift: log evidence of causes without a name (generic.py); weighed: all that the rule made
    the probabilities from (verdict.py), so that they can be made again; kind: of rig, torsional or translational.
    """

    campaign: str
    experiment: Experiment
    nominal_kind: Literal["nonlinear", "linear"]
    nominal: Calibration
    candidates: tuple[Candidate, ...]
    winner: Candidate | None
    answers: Answers
    before: Remainder
    after: Remainder
    gap: Gap
    where: Where
    site_map: SiteMap
    remainder_map: SiteMap
    proposals: tuple[Proposal, ...]
    sites: Mapping[str, float]
    evidence: Mapping[str, float]
    indistinguishable: tuple[tuple[str, ...], ...]
    pair: Pair | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    seed: int = 1
    pairs: tuple[Pair, ...] = ()
    drift: float = -math.inf
    best: Calibration | None = None
    choices: tuple[Choice, ...] = ()
    closing: Mapping[str, tuple[float, Closed]] = field(default_factory=dict)
    weighed: Mapping[str, Any] = field(default_factory=dict)
    kind: str = "torsional"
    budget: Budget | None = None
    under_priors: tuple[tuple[float, str, float], ...] = ()
    law: Learnt | None = None
    named: Calibration | None = None

    @property
    def verdict(self) -> str:
        """One effect, "none" or "unknown"."""
        return self.answers.verdict

    def best_of(self, effect: str) -> Candidate | None:
        """The fitted formula with the largest evidence of a family; None if it was only screened."""
        rows = [c for c in self.candidates if c.effect.name == effect and c.fit is not None]
        return rows[0] if rows else None

    def weighed_fits(self, least: float = 0.02) -> list[tuple[float, Calibration]]:
        """Probability and fit of every answer of at least that probability; `unknown` predicts as what closes most."""
        best = self.best or self.nominal
        fits: dict[int, tuple[float, Calibration]] = {}
        for name, p in self.answers.probabilities.items():
            row = self.best_of(name)
            own = {"none": self.nominal, "unknown": best}.get(name, None if row is None else row.fit)
            if self.winner is not None and name == self.winner.effect.name:
                own = best
            if own is not None and p >= least:
                fits[id(own)] = (p + fits.get(id(own), (0.0,))[0], own)
        return list(fits.values())

    def to_json(self) -> DiagnosisFile:
        """The fields of diagnosis.json (schema bayes-damper/diagnosis/1)."""
        noise = self.nominal.problem.noise
        out: dict[str, Any] = {
            "schema": SCHEMA,
            "campaign": self.campaign,
            "nominal": self.nominal_kind,
            "verdict": self.verdict,
            "credible_set": self.answers.credible_set(),
            "probabilities": self.answers.probabilities,
            "pair": None
            if self.pair is None or self.answers.pair < 0.5
            else {
                "effects": list(self.pair.effects),
                "probability": self.answers.pair,
                "log_evidence": self.pair.log_evidence,
                "gain": self.pair.gain,
                "parameters": self._of_pair(self.pair),
            },
            "sites": dict(self.sites),
            "gap": self.gap.to_json(),
            "where": self.where.to_json(),
            "next_experiment": [p.to_json(self.kind) for p in self.proposals],
            "site_map": self.site_map.to_json() | {"curve": self.site_map.curve()},
            "remainder_map": self.remainder_map.to_json(),
            "noise": {
                "sd": list(noise.floor),
                "level": list(noise.total),
                "phi": list(noise.phi),
                "innovation": list(noise.innovation),
                "spread": spread_of(self.experiment),
            },
            "effects": [self._row(name) for name in sorted(self.evidence, key=lambda n: -self.evidence[n])],
            "parameters": self._shifts(),
            "indistinguishable": [list(group) for group in self.indistinguishable],
            "budget": None if self.budget is None else self.budget.to_json(self._of_budget),
            "remainder": {
                "share_of_gap": self.answers.left.share,
                "evidence_nats": self.answers.left.nats,
                "strongest_line_hz": self.after.peak_hz,
                "temperature": self.answers.temperature,
            },
            "sensitivity": [c.to_json() for c in self.choices],
            "prior_unknown": [
                {"prior": prior, "verdict": verdict, "probability": p} for prior, verdict, p in self.under_priors
            ],
            "weighed": dict(self.weighed),
            "scatter": scatter_shown(
                self.named or self.nominal,
                unit_of("sigma1", self.kind, self.experiment.quantity),
                missing=self.verdict == "unknown",
            ),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }
        if self.law is not None and out["budget"] is not None:
            out["budget"]["unexplained"]["law"] = self.law.file
        out["law"] = None if self.law is None else self.law.to_json()
        return plain(out | {"seed": self.seed})  # type: ignore[no-any-return]

    def _row(self, name: str) -> EffectEntry:
        rows = [c for c in self.candidates if c.effect.name == name]
        best = self.best_of(name) or rows[0]
        fit = self.best if best is self.winner and self.answers.pair < 0.5 else best.fit
        return {
            "name": name,
            "variant": best.variant.name,
            "formula": best.variant.formula,
            "site": best.effect.site,
            "probability": self.answers.probabilities[name],
            "log_evidence": self.evidence[name],
            "fitted": best.fit is not None,
            "augmented_rms": self.closing[name][0] if name in self.closing else None,
            "closed": self.closing[name][1].to_json() if name in self.closing else None,
            "parameters": {p.name: _estimate(fit, OF_EFFECT + p.name, p.unit) for p in best.variant.parameters}
            if fit is not None
            else {},
        }

    def _of_budget(self, label: str, unit: str) -> Estimate:
        """A parameter of the budget's best set."""
        assert self.budget is not None
        fit = self.budget.best.fit
        # What the formulas of the named effects leave open widens the intervals of the same fit.
        return _estimate(self.best if self.best is not None and self.best.problem is fit.problem else fit, label, unit)

    def _of_pair(self, pair: Pair) -> dict[str, dict[str, Estimate]]:
        """Parameters of both effects, fitted together."""
        units = {e.name: {p.name: p.unit for p in v.parameters} for e, v in (pair.first, pair.second)}
        problem = pair.fit.problem
        named = (
            {effect: problem.parameters_of(effect) for effect in pair.effects}
            if isinstance(problem, SetProblem)
            else pair.parameters()
        )
        return {
            effect: {
                name: _estimate(self.best or pair.fit, label, units[effect][name]) for name, label in names.items()
            }
            for effect, names in named.items()
        }

    def _shifts(self) -> dict[str, ShiftEntry]:
        """Parameters before and after the winner, with the shift in standard deviations."""
        if self.best is None:
            return {n: {"before": {"value": v, "sd": sd}} for n, (v, sd) in self.nominal.parameters.items()}
        return {row.name: row.to_json() for row in shifts(self.nominal, self.best)}


def _estimate(fit: Calibration, name: str, unit: str) -> Estimate:
    value, sd = fit.parameters[name]
    i = fit.problem.names.index(name)
    share = min(float(fit.covariance[i, i]), 1.0)  # the prior's variance is 1
    return {"unit": unit, "mean": value, "sd": sd, "hdi90": fit.interval(name), "prior_share": share}
