"""Synthetic theses of known structure: 24 numbers drawn from one set, scattered or separate cases, and judged."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_damper.diagnosis.joint import OWN
from bayes_damper.priors.distributions import from_standard
from bayes_damper.sampling.sequential import temper
from bayes_damper.variability.averaged import averaged, mixture, probabilities_of
from bayes_damper.variability.pooling import POOLINGS
from bayes_damper.variability.published import PublishedCases

SEEDS = range(30)
PARTICLES = 96


def synthetic(plan, pooling, rng):
    """Numbers as this structure gives them, everything from its prior, errors as published; and the truth's mu."""
    cases = PublishedCases(plan)
    hierarchy = cases.hierarchy(pooling)
    for _ in range(2000):
        point = rng.standard_normal((1, hierarchy.ndim))
        data, mu = {}, []
        for i, case in enumerate(cases.names):
            values = cases.joint.coordinates.values(hierarchy.coordinates(point, i))
            mu.append(float(values["mu"][0]))
            own = {name: from_standard(cases.joint.own[case][name], rng.standard_normal(1)) for name in OWN}
            features = cases.joint.models[case].predict_from(values | own)[0]
            data[case] = tuple(
                replace(d, value=float(f + d.standard_error * rng.standard_t(d.n - 1.0)))
                for d, f in zip(cases.joint.data[case], features, strict=True)
            )
        # Numbers that nobody would have printed are drawn again, whatever the structure.
        if all(np.isfinite(d.value) and d.value > 0.0 for rows in data.values() for d in rows):
            return data, mu
    raise AssertionError("no draw of the prior has all features")


def judged(plan, data, rng):
    """Probabilities of the three structures, and the averaged answer."""
    cases = PublishedCases(plan, data=data)
    found = {p: temper(cases.hierarchy(p), rng, PARTICLES, kept=8, settle=False, sweeps=10) for p in POOLINGS}
    probabilities = probabilities_of({p: f.log_z for p, f in found.items()})
    parts = mixture(cases, {p: f.points for p, f in found.items()}, probabilities, 1000, rng)
    return probabilities, averaged(cases, parts, rng, own=False)


@pytest.mark.prove
def test_structures_are_true_as_often_as_they_are_probable_and_intervals_of_mu_cover():
    """The three are equally frequent, as they are assumed to be: answers told with p are then right in a share p."""
    plan = PublishedCases.default_plan()
    right, sure, shared = [], [], []
    for pooling in POOLINGS:
        for seed in SEEDS:
            rng = np.random.default_rng([seed, POOLINGS.index(pooling), 27])
            data, mu = synthetic(plan, pooling, rng)
            probabilities, answer = judged(plan, data, rng)
            head = max(probabilities, key=probabilities.get)
            right.append(head == pooling)
            sure.append(probabilities[head])
            intervals = [case["mu"]["hdi90"] for case in answer["cases"].values()]
            inside = [low <= m <= high for (low, high), m in zip(intervals, mu, strict=True)]
            if pooling == "shared":
                shared.append(np.mean(inside))
            print(pooling, seed, {p: round(x, 2) for p, x in probabilities.items()}, inside, flush=True)
    print(f"right {np.sum(right)} of {len(right)}, expected {np.sum(sure):.1f}; shared mu inside {np.mean(shared):.2f}")
    p = np.array(sure)
    assert abs(np.sum(right) - p.sum()) < 3.0 * np.sqrt(np.sum(p * (1.0 - p))) + 1.0
    assert 0.75 < np.mean(shared) <= 1.0
