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
    Experiment,
    default_priors,
    experiment_of,
    predict,
)
from bayes_damper.calibration.correlated_noise import fit_with_noise
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, from_standard, to_standard
from bayes_damper.priors.files import campaign_priors
from bayes_damper.published.sources import unchanged
from bayes_damper.rig.parameters import unit_of
from bayes_damper.runs.contents.variability import FittedPlan, Pooling, PoolingEntry, UnseenEntry
from bayes_damper.variability.decomposition import CaseDraws, Sets, curve_values, mean_over_cases, summary
from bayes_damper.variability.equivalent import NAMES, PERIOD, TIMES, bearing_damping, fit_linear
from bayes_damper.variability.pooling import POOLINGS, Direct, GaussianCase, GaussianHierarchy
from bayes_damper.variability.published import describe_scatter

Array = NDArray[np.float64]
_CURVE_DRAWS = 48
_CURVE_POINTS = 8
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

    def __init__(self, plan: FittedPlan) -> None:
        self.plan = plan
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
        self.noises = {case: fit_with_noise(e, kind) for case, e in self.experiments.items()}
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
    ) -> tuple[dict[str, PoolingEntry], Sets | None]:
        """What variability.json says of the three answers, and what the decomposition needs."""
        everything = self._solve(self.gaussians(), rng, particles)
        without = {
            case: self._solve([g for g in self.gaussians() if g.name != case], rng, particles) for case in self.names
        }
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
        return models, self._sets(kept, constants, rng)

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

    def _point(self, case: str, values: Array, common: Array) -> Array:
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
            moved = replace(fit, q=self._point(case, mean[i], common))
            found = predict(moved, experiment.heldout)
            cases[case] = -0.5 * sum(p.chi2 for p in found.values())
            for k, p in found.items():
                rms = float(np.sqrt(np.nanmean(p.residual**2)))
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
        if pooling == "shared":
            return {"parameters": next(iter(cases.values()))}
        if pooling == "separate":
            return {"cases": cases}
        return {"cases": cases, "scatter": describe_scatter(s, self.pooled, self.priors(self.names[0]))}

    # The effective linear parameters

    def _values(self, case: str, values: Array, common: Array) -> dict[str, Array]:
        """Parameters in SI of draws (n, pooled) and (n, common): name -> (n,)."""
        fit = self.fits[case]
        experiment = fit.problem.experiment
        n = len(values)
        coupled = [t for t in experiment.trials if t.coupled]
        spring = coupled[0].k1t
        rig = {name: np.full(n, value) for name, (value, _) in experiment.constants.items()}
        rig["k1t"] = np.full(n, experiment.stiffnesses[spring][0])
        rig["theta0"] = np.full(n, float(np.mean([t.theta0 for t in coupled])))
        q = self._point(case, values, common)
        for i, c in enumerate(fit.problem.coordinates):
            if c.role == "stiffness":
                if c.index == spring:
                    rig["k1t"] = from_standard(c.prior, q[:, i])
            else:
                rig[c.name] = from_standard(c.prior, q[:, i])
        if not experiment.magnet:
            rig = {"N0": np.zeros(n), "R": np.ones(n), "r": np.ones(n)} | rig | {"mu": np.zeros(n)}
        rig.setdefault("k3t", np.zeros(n))
        rig.setdefault("J12", np.zeros(n))
        return rig

    def _sets(self, drawn: Array, common: Array, rng: np.random.Generator) -> Sets | None:
        """None where there is nothing to take apart: a case without coupled trials, or an unknown start."""
        first = next(iter(self.experiments.values()))
        usable = all(any(t.coupled for t in e.trials) for e in self.experiments.values())
        if not usable or first.start != "rest" or not set(NAMES) <= set(self.pooled):
            return None
        mean = mean_over_cases([drawn[:, i] for i in range(len(self.names))])
        n = max(len(drawn) // 2, 8)
        before = self._prior(rng, n)
        before_mean = mean_over_cases([before[:, i] for i in range(len(self.names))])
        before_common = rng.standard_normal((n, len(self.common)))
        cases = {
            case: CaseDraws(
                self._values(case, drawn[:, i], common),
                self._values(case, mean, common),
                self._values(case, before[:, i], before_common),
                self._values(case, before_mean, before_common),
            )
            for i, case in enumerate(self.names)
        }
        energies = {
            case: float(np.median(0.5 * d.values["k1t"] * d.values["theta0"] ** 2)) for case, d in cases.items()
        }
        found = {case: self._measured(case) for case in self.names}
        grid = np.geomspace(0.6 * min(energies.values()), 1.3 * max(energies.values()), _CURVE_POINTS)
        springs = sorted({float(np.median(d.values["k1t"])) for d in cases.values()})
        reference = {name: x[:_CURVE_DRAWS] for name, x in cases[self.names[0]].reference.items()}
        return Sets(
            cases,
            energies,
            {case: (math.exp(m[0][0]), math.exp(m[0][1])) for case, m in found.items() if m is not None},
            (0.0, 0.0),
            {case: _constant(m[1] if m is not None else np.zeros(2)) for case, m in found.items()},
            {f"k1t = {k:.3g} {unit_of('k1t', self.kind)}": (grid, curve_values(reference, k, grid)) for k in springs},
            first.normal_force,
            first.restoring,
            first.quantity,
            "Measurement scatter: the same linear fit to each coupled trial, its variance from trial to trial over "
            "their number.",
            self.stretch,
        )

    def _prior(self, rng: np.random.Generator, n: int) -> Array:
        """Draws (n, cases, pooled) of the partly pooled prior."""
        s = rng.random((n, 1, len(self.pooled)))
        m = rng.standard_normal((n, 1, len(self.pooled)))
        return np.asarray(np.sqrt(1.0 - s**2) * m + s * rng.standard_normal((n, len(self.names), len(self.pooled))))

    def _measured(self, case: str) -> tuple[Array, Array] | None:
        """Logarithms of k2t and c2t of linear fits to the coupled trials: mean (2,), and variance of that mean (2,)."""
        fit = self.fits[case]
        experiment = fit.problem.experiment
        starts = _starts(fit, experiment)
        times = self.stretch * TIMES
        records, angles = [], []
        for i, t in enumerate(experiment.trials):
            good = np.isfinite(t.y[0])
            angle, delay = starts.get(i, (t.theta0, 0.0))
            if not t.coupled or t.inputs is not None or good.sum() < 20 or t.times[good][-1] < times[-1] + delay:
                continue
            records.append(np.interp(times + delay, t.times[good], t.y[0][good]))
            angles.append(angle)
        if not records:
            return None
        at_best = self._values(
            case, fit.q[None, [fit.problem.names.index(n) for n in self.pooled]], self._own_common(fit)
        )
        values = {name: np.repeat(x, len(records)) for name, x in at_best.items()} | {"theta0": np.array(angles)}
        damping = bearing_damping(values, experiment.normal_force, experiment.restoring, self.stretch)
        found = fit_linear(np.array(records), values, damping, experiment.quantity, times)
        x = found.log_values
        variance = x.var(axis=0, ddof=1) / len(x) if len(x) > 1 else np.zeros(2)
        return x.mean(axis=0), variance

    def _own_common(self, fit: Calibration) -> Array:
        names = fit.problem.names
        return np.array([[fit.q[names.index(name)] if name in names else 0.0 for name in self.common]])


def _starts(fit: Calibration, experiment: Experiment) -> dict[int, tuple[float, float]]:
    """Fitted angle (rad) and instant (s) of release of each trial, held-out ones included."""
    found = dict(fit.eta)
    if experiment.heldout:
        found |= {i: p.eta for i, p in predict(fit, experiment.heldout).items()}
    out: dict[int, tuple[float, float]] = {}
    for group in fit.problem.grouped(tuple(found)):
        for k, i in enumerate(group.trials):
            known = {name: mean[k] + sd[k] * found[i][m] for m, (name, mean, sd) in enumerate(group.nuisances)}
            out[i] = float(known.get("theta0", experiment.trials[i].theta0)), float(known.get("delay", 0.0))
    return out


def _constant(variance: Array) -> Callable[[Array], Array]:
    return lambda log_values: np.tile(variance, (len(log_values), 1))
