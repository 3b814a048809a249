"""The cases of a recorded campaign: each by its calibration and the Laplace approximation around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import (
    NOMINAL,
    Calibration,
    default_priors,
    experiment_of,
    predict,
)
from bayes_damper.calibration.correlated_noise import fit_with_noise
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, from_standard, to_standard
from bayes_damper.priors.files import campaign_priors
from bayes_damper.published.sources import unchanged
from bayes_damper.runs.contents.variability import FittedPlan, Pooling, PoolingEntry, UnseenEntry
from bayes_damper.variability.decomposition import summary
from bayes_damper.variability.equivalent import PERIOD
from bayes_damper.variability.pooling import POOLINGS, Direct, GaussianCase, GaussianHierarchy
from bayes_damper.variability.published import described

Array = NDArray[np.float64]
_AVERAGED = 64
"""Draws of the scatter over which the partly pooled best values are averaged."""


def _free(priors: Mapping[str, Distribution | float]) -> dict[str, Distribution]:
    """The priors of what is not fixed at a number."""
    return {name: prior for name, prior in priors.items() if not isinstance(prior, float | int)}


class RecordedCases:
    """Recorded trials of several cases under the priors of a fit's plan; held-out trials are not fitted."""

    measured = "linear fit to the measurements"
    method = (
        "Recorded trials: each case is calibrated by least squares under the noise that its fit works with (learnt "
        "from what is left where the model misses something) and taken as Gaussian around its best fit (Laplace); the "
        "hierarchy of these is exact. Declared uncertain constants of the rig have one value for all "
        "cases. The unseen data are the held-out trials, of which only each trial's own nuisances are estimated; the "
        "score is minus half their chi-square at the best values."
    )

    def __init__(self, plan: FittedPlan, report: Callable[[float, str], None] = lambda *_: None) -> None:
        """`report` : called with the share of the work that is done, and what is done next."""
        self.plan, self.report = plan, report
        self.names = tuple(plan["cases"])
        campaign = unchanged(plan["campaign"], plan["campaign_sha256"], "it was fitted; fit it again")
        whole = experiment_of(campaign, None if plan["priors"] is None else campaign_priors(plan["priors"], campaign))
        if plan["normal_force"]:
            whole = replace(whole, normal_force=plan["normal_force"])
        whole = replace(whole, trials=tuple(t for t in whole.trials if t.case in self.names))
        self.kind = campaign.rig.kind
        pace = [math.log(whole.stiffnesses[t.k1t][0] / whole.constants["J1"][0]) for t in whole.trials]
        self.stretch = 2.0 * math.pi * math.exp(-0.5 * float(np.mean(pace))) / PERIOD
        alone = {case: replace(whole, trials=tuple(t for t in whole.trials if t.case == case)) for case in self.names}
        # Default priors follow the amplitude of the trials they are for. The cases are compared under one prior, that
        # of all trials; the fit of one case had its own.
        self.fitted_priors = {case: default_priors(e) | _free(e.priors) for case, e in alone.items()}
        one = default_priors(whole) | dict(whole.priors)
        self.experiments = {case: replace(e, priors=one) for case, e in alone.items()}
        kind = plan.get("noise", "auto")
        self.noises = {}
        for k, (case, e) in enumerate(self.experiments.items()):
            report(0.4 * k / len(self.experiments), f"fitting case {case}")
            self.noises[case] = fit_with_noise(e, kind)
        self.fits: dict[str, Calibration] = {case: found.fit for case, found in self.noises.items()}
        known = [set(fit.problem.names) for fit in self.fits.values()]
        self.pooled = tuple(name for name in NOMINAL if all(name in names for names in known))
        if not self.pooled:
            raise InputError(f"{plan['campaign']}: the cases have no free parameter in common that could be compared")
        constants = [
            c.name for f in self.fits.values() for c in f.problem.coordinates if c.role in ("constant", "stiffness")
        ]
        self.common = tuple(dict.fromkeys(constants))

    def priors(self, case: str) -> dict[str, Distribution]:
        """Distributions of the unknowns of one case."""
        return {c.name: c.prior for c in self.fits[case].problem.coordinates}

    def reweighted(self, case: str, draws: Array, rng: np.random.Generator) -> Array:
        """A fit's draws (n, pooled), in the standard coordinates of the common prior, drawn again for that prior."""
        own, common = self.fitted_priors[case], self.priors(case)
        before = np.stack(
            [to_standard(own[name], from_standard(common[name], draws[:, j])) for j, name in enumerate(self.pooled)],
            axis=1,
        )
        log_weights = 0.5 * np.sum(before**2 - draws**2, axis=1)
        weights = np.exp(log_weights - log_weights.max())
        return np.asarray(draws[rng.choice(len(draws), len(draws), p=weights / weights.sum())])

    def gaussians(self) -> list[GaussianCase]:
        """Each case as the closed form takes it."""
        return [
            GaussianCase(case, fit.problem.names, fit.q, fit.covariance, fit.log_evidence)
            for case, fit in self.fits.items()
        ]

    def direct(self, rng: np.random.Generator, particles: int) -> Direct:
        """Partial pooling of cases that have constants of the rig of their own each, as single fits have."""
        return GaussianHierarchy(self.gaussians(), self.pooled).direct(rng, particles)

    def models(
        self, rng: np.random.Generator, particles: int, draws: int
    ) -> tuple[dict[str, PoolingEntry], Array, Array]:
        """What variability.json says of the answers, and draws if partly pooled: (n, cases, pooled) and (n, common)."""
        self.report(0.4, "comparing one set, scattered and separate values")
        everything = self._solve(self.gaussians(), rng, particles)
        without = {}
        for k, case in enumerate(self.names):
            self.report(0.45 + 0.15 * k / len(self.names), f"the same without case {case}")
            without[case] = self._solve([g for g in self.gaussians() if g.name != case], rng, particles)
        hierarchy = GaussianHierarchy(self.gaussians(), self.pooled, self.common)
        models: dict[str, PoolingEntry] = {}
        for pooling in POOLINGS:
            log_z, error, s = everything[pooling]
            best = [hierarchy.given(row) for row in s[:_AVERAGED]]
            mean = np.mean([b.mean for b in best], axis=0)
            common = np.mean([b.common for b in best], axis=0)
            drawn, shared = hierarchy.draw(np.resize(s, (max(draws, 200), s.shape[1])), rng)
            models[pooling] = {
                "log_evidence": log_z,
                "error": error,
                "spread": 0.0,
                "heldout": self._heldout(mean, common),
                "unseen_case": {case: log_z - without[case][pooling][0] for case in self.names},
                **self._described(pooling, drawn, s),
            }
            if pooling == "partial":
                kept, constants = drawn[:draws], shared[:draws]
        return models, kept, constants

    def _solve(
        self, cases: list[GaussianCase], rng: np.random.Generator, particles: int
    ) -> dict[Pooling, tuple[float, float, Array]]:
        """Log evidence, its error, and draws of s of each answer."""
        hierarchy = GaussianHierarchy(cases, self.pooled, self.common)
        fixed = {"shared": np.zeros((1, len(self.pooled))), "separate": np.ones((1, len(self.pooled)))}
        out: dict[Pooling, tuple[float, float, Array]] = {}
        for pooling in POOLINGS:
            if pooling == "partial":
                out[pooling] = hierarchy.partial(rng, particles)
            else:
                out[pooling] = hierarchy.given(fixed[pooling][0]).log_z, 0.0, fixed[pooling]
        return out

    def point(self, case: str, values: Array, common: Array) -> Array:
        """The unknowns of a case's calibration (size,), or of many (n, size), from pooled and common values."""
        names = self.fits[case].problem.names
        columns = [
            values[..., self.pooled.index(name)]
            if name in self.pooled
            else common[..., self.common.index(name)]
            if name in self.common
            else np.broadcast_to(self.fits[case].q[i], values.shape[:-1])
            for i, name in enumerate(names)
        ]
        return np.stack(columns, axis=-1)

    def _heldout(self, mean: Array, common: Array) -> UnseenEntry:
        """Score of the held-out trials of each case at given values."""
        cases: dict[str, float] = {}
        trials: dict[str, dict[str, float]] = {}
        for i, (case, fit) in enumerate(self.fits.items()):
            experiment = fit.problem.experiment
            if not experiment.heldout:
                continue
            moved = replace(fit, q=self.point(case, mean[i], common))
            found = predict(moved, experiment.heldout)
            cases[case] = -0.5 * sum(p.chi2 for p in found.values())
            for k, p in found.items():
                rms = float(np.sqrt(np.nanmean((experiment.trials[k].y - p.model) ** 2)))
                trials[experiment.trials[k].label] = {"chi2": p.chi2, "readings": p.n_data, "residual_rms": rms}
        return {
            "what": "Held-out trials" if cases else "No trials are held out",
            "log_score": float(sum(cases.values())),
            "cases": cases,
            "trials": trials,
        }

    def _described(self, pooling: Pooling, drawn: Array, s: Array) -> PoolingEntry:
        cases = {}
        for i, case in enumerate(self.names):
            priors = self.priors(case)
            cases[case] = {
                name: summary(from_standard(priors[name], drawn[:, i, j])) for j, name in enumerate(self.pooled)
            }
        return described(pooling, cases, s, self.pooled, self.priors(self.names[0]))
