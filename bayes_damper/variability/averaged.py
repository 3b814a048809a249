"""One answer from three: draws of one set, scattered and separate cases, each as often as it is probable.

What is said of a case then allows for what nobody knows: whether the other cases say anything about it (Bayesian model
averaging; Hoeting et al. 1999, Statistical Science 14:382). And the same under other assumptions, side by side.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayes_damper.runs.contents.variability import (
    AssumptionEntry,
    AveragedEntry,
    Interval,
    KeptEntry,
    Pooling,
    SurvivesEntry,
)
from bayes_damper.variability.decomposition import summary
from bayes_damper.variability.pooling import POOLINGS, Hierarchy
from bayes_damper.variability.published import PublishedCases

Array = NDArray[np.float64]
Parts = Sequence[tuple[Hierarchy, Array]]
DRAWS = 4000
ALIKE = 1.5
"""Largest over smallest value of the cases below which a parameter is called alike in all of them."""
LARGELY = 0.7
"""Share of the prior's 90 % interval, on a logarithmic scale, below which the data are said to have narrowed it."""
_DERIVED = {
    "friction_torque": ("mu", "N0", "R"),
    "friction_torque_per_inertia": ("mu", "N0", "R", "J1"),
    "k1t": ("k1t",),
    "k1t_per_inertia": ("k1t", "J1"),
}


def mixture(
    cases: PublishedCases, draws: Mapping[Pooling, Array], probabilities: Mapping[Pooling, float], count: int,
    rng: np.random.Generator,
) -> list[tuple[Hierarchy, Array]]:  # fmt: skip
    """Of each answer its hierarchy and as many of its draws (n, ndim), of `count` in all, as it is probable."""
    parts = []
    for pooling in POOLINGS:
        n = round(count * probabilities[pooling])
        if n:
            parts.append((cases.hierarchy(pooling), draws[pooling][rng.choice(len(draws[pooling]), n)]))
    return parts


def averaged(cases: PublishedCases, parts: Parts, rng: np.random.Generator, own: bool = True) -> AveragedEntry:
    """Intervals of each case's parameters, of those of a case not yet measured, and where the cases are alike.

    own : whether spring and angle of each case are drawn, too.
    """
    first = cases.features[cases.names[0]].coordinates

    def of(h: Hierarchy, x: Array, i: int) -> dict[str, Array]:
        return cases.values(h, x, i, rng if own else None)

    values = {case: _joined([of(h, x, i) for h, x in parts]) for i, case in enumerate(cases.names)}
    columns = [first.names.index(name) for name in cases.pooled]
    z = rng.standard_normal((sum(len(x) for _, x in parts), first.ndim))
    z[:, columns] = np.concatenate([_further(h, x, rng) for h, x in parts])
    next_one = first.values(z)
    return {
        "cases": {case: _described(cases, v) for case, v in values.items()},
        "further": {name: summary(next_one[name]) for name in cases.pooled},
        "alike": {name: _alike([v[name] for v in values.values()]) for name in cases.pooled},
        "prior": {name: list(_central(cases, name)) for name in cases.pooled},
        "common": {name: summary(values[cases.names[0]][name]) for name in cases.common},
    }


def _joined(values: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    return {name: np.concatenate([v[name] for v in values]) for name in values[0]}


def _described(cases: PublishedCases, values: Mapping[str, Array]) -> dict[str, Interval]:
    """Intervals of what one case has for itself, and of what the numbers fix of it: torques per inertia."""
    found = {name: summary(values[name]) for name in cases.pooled}
    for name, factors in _DERIVED.items():
        if all(f in values for f in factors):
            over = values[factors[-1]] if name.endswith("per_inertia") else np.ones(1)
            some = factors[:-1] if name.endswith("per_inertia") else factors
            found[name] = summary(np.prod([values[f] for f in some], axis=0) / over)
    return found


def _further(hierarchy: Hierarchy, points: Array, rng: np.random.Generator) -> Array:
    """Values (n, pooled) that a case not yet measured would have."""
    s = hierarchy.scatter(points)
    fresh = rng.standard_normal(s.shape)
    return fresh if hierarchy.pooling == "separate" else np.sqrt(1.0 - s**2) * hierarchy.means(points) + s * fresh


def _alike(values: Sequence[Array]) -> float:
    """How probable it is that the largest of the cases' values is less than ALIKE times the smallest."""
    each = np.stack(list(values))
    return float(np.mean(each.max(axis=0) < ALIKE * each.min(axis=0)))


def _central(cases: PublishedCases, name: str) -> tuple[float, float]:
    """The prior's 90 % interval."""
    prior = cases.priors(cases.names[0])[name]
    low, high = prior.ppf(np.array([0.05, 0.95]))
    return float(low), float(high)


def probabilities_of(log_evidence: Mapping[Pooling, float]) -> dict[Pooling, float]:
    """Probability of each answer, all being equally probable before."""
    height = np.array([log_evidence[p] for p in POOLINGS])
    share = np.exp(height - height.max())
    return dict(zip(POOLINGS, (share / share.sum()).tolist(), strict=True))


def spread_of(
    log_evidence: Mapping[Pooling, float], errors: Mapping[Pooling, float], rng: np.random.Generator
) -> dict[Pooling, float]:
    """Standard deviation of each probability over what the computation leaves open about the evidences."""
    drawn = [
        probabilities_of({p: z + errors[p] * rng.standard_normal() for p, z in log_evidence.items()})
        for _ in range(400)
    ]
    return {p: float(np.std([d[p] for d in drawn])) for p in POOLINGS}


def what_survives(rows: Sequence[AssumptionEntry]) -> SurvivesEntry:
    """What all rows of the table say, the first being the assumptions as they are.

    structures : range of each answer's probability; parameters : over all rows and cases, the range of the medians, the
    interval that holds all 90 % intervals, and whether that is still narrower than the prior's by a third or more.
    """
    structures = {p: [f(r["probabilities"][p] for r in rows) for f in (min, max)] for p in POOLINGS}
    first = rows[0]["averaged"]
    parameters: dict[str, KeptEntry] = {}
    for name, (low, high) in first["prior"].items():
        found = [r["averaged"]["cases"][c][name] for r in rows for c in r["averaged"]["cases"]]
        union = [min(t["hdi90"][0] for t in found), max(t["hdi90"][1] for t in found)]
        share = math.log(union[1] / union[0]) / math.log(high / low)
        medians = [t["median"] for t in found]
        parameters[name] = {
            "medians": [min(medians), max(medians)], "hdi90": union, "share_of_prior": share,
            "survives": share < LARGELY,
        }  # fmt: skip
    return {"structures": structures, "parameters": parameters}
