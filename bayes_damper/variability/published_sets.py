"""The effective linear parameters of published cases: draws of each, and Table 9, which linear fits gave."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayes_damper.priors.distributions import Distribution, LogNormal, from_standard
from bayes_damper.published.marginal import OWN
from bayes_damper.published.measurements import load_published
from bayes_damper.variability.decomposition import CaseDraws, Sets, curves_of, mean_over_cases
from bayes_damper.variability.equivalent import NAMES, bearing_damping, feature_scatter
from bayes_damper.variability.pooling import POOLINGS, Hierarchy
from bayes_damper.variability.published import PublishedCases

Array = NDArray[np.float64]
_Values = dict[str, tuple[dict[str, Array], dict[str, Array]]]


def published_sets(
    cases: PublishedCases, parts: Sequence[tuple[Hierarchy, Array]], rng: np.random.Generator
) -> Sets:  # fmt: skip
    """What the decomposition needs, of draws (n, ndim) of several answers together."""
    published = load_published()
    found = _joined([_values(cases, hierarchy, points, rng) for hierarchy, points in parts])
    count = max(sum(len(points) for _, points in parts) // 6, 8)
    every = [cases.hierarchy(pooling) for pooling in POOLINGS]
    before = _joined([_values(cases, h, rng.standard_normal((count, h.ndim)), rng, True) for h in every])
    energies = {case: 0.5 * published.cases[case].k1t * published.cases[case].theta0 ** 2 for case in cases.names}
    springs = sorted({published.cases[case].k1t for case in cases.names})
    table, rounding = _printed(cases.names)
    return Sets(
        {case: CaseDraws(*found[case], *before[case]) for case in cases.names},
        energies,
        table,
        rounding,
        {case: _scatter(cases, case, found[case][0]) for case in cases.names},
        curves_of(found[cases.names[0]][1], {f"k1t = {k:g} N m/rad": k for k in springs}, energies.values()),
        cases.normal_force,
        measurement="Measurement scatter: the printed standard errors of the three coupled features, carried to "
        "the linear model's k2t and c2t to first order. Beside the result stands Table 9 (p. 20), whose values are "
        "rounded to one digit.",
    )


def _values(
    cases: PublishedCases, hierarchy: Hierarchy, points: Array, rng: np.random.Generator, before: bool = False
) -> _Values:  # fmt: skip
    """Parameters of each case, and the same with the pooled ones at the cases' mean; before : the data."""
    mean = mean_over_cases([hierarchy.values(points, i) for i in range(len(cases.names))])
    out = {}
    for i, case in enumerate(cases.names):
        found = cases.features[case]
        coordinates, z = found.coordinates, hierarchy.coordinates(points, i)
        values, reference = coordinates.values(z), z.copy()
        reference[:, [coordinates.names.index(name) for name in cases.pooled]] = mean
        own = (
            {name: from_standard(found.own[name], rng.standard_normal(len(z))) for name in OWN}
            if before else found.own_draws(values, rng)
        )  # fmt: skip
        out[case] = values | own, coordinates.values(reference) | own
    return out


def _scatter(cases: PublishedCases, case: str, values: Mapping[str, Array]) -> Callable[[Array], Array]:
    errors = {d.quantity: d.standard_error for d in cases.features[case].data if d.configuration == "coupled"}
    priors = cases.priors(case)
    sds = tuple(_log_sd(priors.get(name)) for name in NAMES)
    damping = bearing_damping(values, cases.normal_force)

    def scatter(log_values: Array) -> Array:
        return feature_scatter(values, log_values, damping, errors, (sds[0], sds[1]))

    return scatter


def _joined(parts: Sequence[_Values]) -> _Values:
    """Draws of several answers, one after the other."""

    def whole(case: str, which: int) -> dict[str, Array]:
        names = parts[0][case][which]
        return {name: np.concatenate([part[case][which][name] for part in parts]) for name in names}

    return {case: (whole(case, 0), whole(case, 1)) for case in parts[0]}


def _log_sd(prior: Distribution | None) -> float:
    return math.log(prior.factor) if isinstance(prior, LogNormal) else 1.0


def _printed(cases: tuple[str, ...]) -> tuple[dict[str, tuple[float, float]], tuple[float, float]]:
    """Table 9, and the variance of ln k2t and ln c2t that its rounding makes."""
    rows = {(p.case, p.quantity): p for p in load_published().printed if p.quantity in ("fitted_k2t", "fitted_c2t")}
    table, rounding = {}, []
    for case in cases:
        if (case, "fitted_k2t") in rows and (case, "fitted_c2t") in rows:
            table[case] = rows[case, "fitted_k2t"].value, rows[case, "fitted_c2t"].value
    for k, name in enumerate(NAMES):
        digits = max(len(rows[c, f"fitted_{name}"].text.partition(".")[2]) for c in table) if table else 0
        half = 0.5 * 10.0**-digits
        rounding.append(float(np.mean([(half / pair[k]) ** 2 / 3.0 for pair in table.values()])) if table else math.nan)
    return table, (rounding[0], rounding[1])
