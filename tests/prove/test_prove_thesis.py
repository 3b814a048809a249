"""Synthetic theses of known structure: 24 numbers drawn from one set, scattered or separate cases, and judged."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_damper.priors.distributions import from_standard
from bayes_damper.published.marginal import OWN
from bayes_damper.sampling.sequential import temper
from bayes_damper.variability.averaged import averaged, mixture, probabilities_of
from bayes_damper.variability.pooling import POOLINGS
from bayes_damper.variability.published import PublishedCases

THESES = int(os.environ.get("BAYES_DAMPER_THESES", "30"))
PARTICLES = int(os.environ.get("BAYES_DAMPER_PARTICLES", "96"))
KEPT = os.environ.get("BAYES_DAMPER_THESES_FILE")
TRIES = 3000


def drawn(cases, pooling, rng, n):
    """Numbers of n theses as this structure gives them, errors as published, (n, 24), and mu of each case, (n, 4).

    Everything from its prior; nan where a record has no such feature.
    """
    hierarchy = cases.hierarchy(pooling)
    points = rng.standard_normal((n, hierarchy.ndim))
    numbers, mu = [], []
    for i, case in enumerate(cases.names):
        found = cases.features[case]
        values = cases.values(hierarchy, points, i)
        mu.append(values["mu"])
        own = {name: from_standard(found.own[name], rng.standard_normal(n)) for name in OWN}
        error = np.array([d.standard_error for d in found.data])
        numbers.append(found.predict(values | own) + error * rng.standard_t(found.data[0].n - 1.0, (n, len(error))))
    return np.concatenate(numbers, axis=1), np.stack(mu, axis=1)


def printable(numbers):
    """Whether anybody would have printed them: all features there, all positive."""
    with np.errstate(invalid="ignore"):
        return np.all(numbers > 0.0, axis=1)


def synthetic(cases, pooling, rng):
    """One thesis that would have been printed: case -> its numbers; and the truth's mu."""
    for _ in range(TRIES // 16):
        numbers, mu = drawn(cases, pooling, rng, 16)
        if printable(numbers).any():
            which = int(np.argmax(printable(numbers)))
            rows = np.split(numbers[which], len(cases.names))
            return {
                case: [replace(d, value=float(x)) for d, x in zip(cases.features[case].data, row, strict=True)]
                for case, row in zip(cases.names, rows, strict=True)
            }, mu[which]
    raise AssertionError("no draw of the prior has all features")


def judged(plan, data, rng, printed):
    """Probabilities of the three structures, and the averaged answer.

    printed : how often a thesis of each structure is printable. As many theses of each are drawn, so that the density
    of a structure's numbers is its evidence over that.
    """
    cases = PublishedCases(plan, data=data)
    found = {p: temper(cases.hierarchy(p), rng, PARTICLES, kept=8, settle=False, sweeps=10) for p in POOLINGS}
    probabilities = probabilities_of({p: f.log_z - np.log(printed[p]) for p, f in found.items()})
    parts = mixture(cases, {p: f.points for p, f in found.items()}, probabilities, 1000, rng)
    return probabilities, averaged(cases, parts, rng, own=False)


def at_once(rows):
    """How many theses were right and were expected to be, with the standard deviation of that; coverage and its own."""
    sure = np.array([max(r["probabilities"].values()) for r in rows])
    right = sum(max(r["probabilities"], key=r["probabilities"].get) == r["truth"] for r in rows)
    # The four intervals of a thesis stand and fall together: a thesis is one trial.
    inside = np.array([np.mean(r["inside"]) for r in rows])
    return right, sure.sum(), np.sqrt(np.sum(sure * (1.0 - sure))), inside.mean(), np.sqrt(0.09 / len(rows))


@pytest.mark.prove
def test_structures_are_true_as_often_as_they_are_probable_and_intervals_of_mu_cover():
    """The three are equally frequent, as they are assumed to be: answers given with p are then right in a share p.

    Goes on from the file BAYES_DAMPER_THESES_FILE, if it is named. Three standard deviations are allowed.
    """
    plan = PublishedCases.default_plan()
    cases = PublishedCases(plan)
    printed = {p: np.mean(printable(drawn(cases, p, np.random.default_rng(27), TRIES)[0])) for p in POOLINGS}
    print("printable", {p: round(float(x), 3) for p, x in printed.items()}, flush=True)
    store = None if KEPT is None else Path(KEPT)
    rows = [json.loads(x) for x in store.read_text().splitlines()] if store is not None and store.exists() else []
    for seed in range(THESES):
        for pooling in POOLINGS:
            if any(r["truth"] == pooling and r["seed"] == seed for r in rows):
                continue
            rng = np.random.default_rng([seed, POOLINGS.index(pooling), 27])
            data, mu = synthetic(cases, pooling, rng)
            probabilities, answer = judged(plan, data, rng, printed)
            intervals = [case["mu"]["hdi90"] for case in answer["cases"].values()]
            inside = [bool(low <= m <= high) for (low, high), m in zip(intervals, mu, strict=True)]
            rows.append({"truth": pooling, "seed": seed, "probabilities": probabilities, "inside": inside})
            print(json.dumps(rows[-1]), flush=True)
            if store is not None:
                with store.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    right, expected, spread, covered, unsure = at_once(rows)
    print(f"right {right} of {len(rows)}, expected {expected:.1f} +- {spread:.1f}")
    print(f"mu inside {covered:.2f} +- {unsure:.2f}")
    for pooling in POOLINGS:
        some = [r for r in rows if r["truth"] == pooling]
        print(pooling, "mu inside", np.mean([np.mean(r["inside"]) for r in some]), "of", len(some))
    assert abs(right - expected) < 3.0 * spread + 0.5
    assert abs(covered - 0.9) < 3.0 * unsure
