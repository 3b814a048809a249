"""The effective linear parameters of recorded cases: draws of each, and the same fits to the records themselves."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, predict
from bayes_damper.priors.distributions import from_standard
from bayes_damper.rig.parameters import unit_of
from bayes_damper.variability.decomposition import CaseDraws, Sets, curves_of, mean_over_cases
from bayes_damper.variability.equivalent import NAMES, TIMES, bearing_damping, fit_linear
from bayes_damper.variability.recorded import RecordedCases

Array = NDArray[np.float64]


def recorded_sets(cases: RecordedCases, drawn: Array, common: Array, rng: np.random.Generator) -> Sets | None:
    """What the decomposition needs, of draws (n, cases, pooled) and (n, common) of partly pooled cases.

    None where there is nothing to take apart: a case without coupled trials, or an unknown start.
    """
    first = next(iter(cases.experiments.values()))
    usable = all(any(t.coupled for t in e.trials) for e in cases.experiments.values())
    if not usable or first.start != "rest" or not set(NAMES) <= set(cases.pooled):
        return None
    mean = mean_over_cases([drawn[:, i] for i in range(len(cases.names))])
    n = max(len(drawn) // 2, 8)
    before = _prior(cases, rng, n)
    before_mean = mean_over_cases([before[:, i] for i in range(len(cases.names))])
    before_common = rng.standard_normal((n, len(cases.common)))
    drawn_of = {
        case: CaseDraws(
            _values(cases, case, drawn[:, i], common),
            _values(cases, case, mean, common),
            _values(cases, case, before[:, i], before_common),
            _values(cases, case, before_mean, before_common),
        )
        for i, case in enumerate(cases.names)
    }
    energies = {case: float(np.median(0.5 * d.values["k1t"] * d.values["theta0"] ** 2)) for case, d in drawn_of.items()}
    found = {case: _measured(cases, case) for case in cases.names}
    springs = sorted({float(np.median(d.values["k1t"])) for d in drawn_of.values()})
    labels = {f"k1t = {k:.3g} {unit_of('k1t', cases.kind)}": k for k in springs}
    return Sets(
        drawn_of,
        energies,
        {case: (math.exp(m[0][0]), math.exp(m[0][1])) for case, m in found.items() if m is not None},
        (0.0, 0.0),
        {case: _constant(m[1] if m is not None else np.zeros(2)) for case, m in found.items()},
        curves_of(drawn_of[cases.names[0]].reference, labels, energies.values()),
        first.normal_force,
        first.restoring,
        first.quantity,
        "Measurement scatter: the same linear fit to each coupled trial, its variance from trial to trial over "
        "their number.",
        cases.stretch,
    )


def _values(cases: RecordedCases, case: str, values: Array, common: Array) -> dict[str, Array]:
    """Parameters in SI of draws (n, pooled) and (n, common): name -> (n,)."""
    fit = cases.fits[case]
    experiment = fit.problem.experiment
    n = len(values)
    coupled = [t for t in experiment.trials if t.coupled]
    spring = coupled[0].k1t
    rig = {name: np.full(n, value) for name, (value, _) in experiment.constants.items()}
    rig["k1t"] = np.full(n, experiment.stiffnesses[spring][0])
    rig["theta0"] = np.full(n, float(np.mean([t.theta0 for t in coupled])))
    q = cases.point(case, values, common)
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


def _prior(cases: RecordedCases, rng: np.random.Generator, n: int) -> Array:
    """Draws (n, cases, pooled) of the partly pooled prior."""
    s = rng.random((n, 1, len(cases.pooled)))
    m = rng.standard_normal((n, 1, len(cases.pooled)))
    return np.asarray(np.sqrt(1.0 - s**2) * m + s * rng.standard_normal((n, len(cases.names), len(cases.pooled))))


def _measured(cases: RecordedCases, case: str) -> tuple[Array, Array] | None:
    """Logarithms of k2t and c2t of linear fits to the coupled trials: mean (2,), and variance of that mean (2,)."""
    fit = cases.fits[case]
    experiment = fit.problem.experiment
    starts = _starts(fit, experiment)
    times = cases.stretch * TIMES
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
    at_best = _values(
        cases, case, fit.q[None, [fit.problem.names.index(n) for n in cases.pooled]], _own_common(cases, fit)
    )
    values = {name: np.repeat(x, len(records)) for name, x in at_best.items()} | {"theta0": np.array(angles)}
    damping = bearing_damping(values, experiment.normal_force, experiment.restoring, cases.stretch)
    found = fit_linear(np.array(records), values, damping, experiment.quantity, times)
    x = found.log_values
    variance = x.var(axis=0, ddof=1) / len(x) if len(x) > 1 else np.zeros(2)
    return x.mean(axis=0), variance


def _own_common(cases: RecordedCases, fit: Calibration) -> Array:
    names = fit.problem.names
    return np.array([[fit.q[names.index(name)] if name in names else 0.0 for name in cases.common]])


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
