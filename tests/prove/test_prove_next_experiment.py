"""The proposed experiment decides more often than the same number of trials spent on a case measured before."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import parts
import pytest
from test_problem import RIG, TRUE

from bayes_damper.calibration import Experiment, TrialRecord
from bayes_damper.diagnosis import Diagnosis, diagnose
from bayes_damper.effects import EFFECTS
from bayes_damper.simulation.model import Model

Truth = tuple[str, str, dict[str, float]]
"""Effect, formula, parameters."""

RIVALS: dict[str, tuple[Truth, ...]] = {
    "spring": (
        ("spring_cubic", "same_for_all", {"k3": 14.0}),
        ("spring_bottoming", "both_sides", {"angle": 0.04, "share": 0.10}),
    ),
    "bearings": (
        ("quadratic_drag", "alike", {"coefficient": 0.08}),
        ("bearing_stribeck", "gaussian", {"excess": 0.15, "speed": 0.5}),
    ),
    "interface": (
        ("friction_displacement", "linear", {"slope": 1.0}),
        ("magnet_fade", "linear", {"loss": 3.0}),
    ),
}
"""Effects that look alike in a campaign of small angles, faint enough that it leaves open which one acts."""
SMALL = (("I", 6.2, 2.9), ("II", 6.2, 3.9))
NOISE = 2.0
CAMPAIGNS = 4  # of each effect as the truth
DECISIVE = 0.5


def _trials(
    rng: np.random.Generator, truth: Truth, case: str, place: int, k1t: float, theta0: float,
    both: bool, numbers: tuple[int, ...], heldout: int = 0,
) -> list[TrialRecord]:  # fmt: skip
    """Trials of one case and configuration with the effect at work; the one numbered `heldout` is held out."""
    times = np.arange(500) * 1e-3
    formula = EFFECTS[truth[0]].variant(truth[1])
    out = []
    for number in numbers:
        rig = RIG | TRUE | {"k1t": k1t, "theta0": theta0 * (1.0 + 0.01 * rng.standard_normal())}
        acting = formula if both or formula.uncoupled else None
        y = Model(both, effect=acting).simulate(rig, times, effect=truth[2] if acting else None).y[0]
        y = y + NOISE * rng.standard_normal(y.shape)
        label = f"{case}{number}"
        out.append(
            TrialRecord(label, case, both, number, times, y, place, theta0, 0.01 * theta0, heldout=number == heldout)
        )
    return out


def _campaign(rng: np.random.Generator, truth: Truth) -> Experiment:
    trials = [
        trial
        for case, k1t, degrees in SMALL
        for both in (False, True)
        for trial in _trials(rng, truth, case, 0, k1t, math.radians(degrees), both, (1, 2, 3), heldout=3)
    ]
    return Experiment({n: (v, 0.0) for n, v in RIG.items()}, ((SMALL[0][1], 0.0),), tuple(trials))


def _more(rng: np.random.Generator, old: Experiment, truth: Truth, found: Diagnosis) -> Experiment:
    """The campaign with two trials as proposed."""
    best = found.proposals[0]
    springs = [k for k, _ in old.stiffnesses]
    place = springs.index(best.k1t) if best.k1t in springs else len(springs)
    stiffnesses = old.stiffnesses if place < len(springs) else (*old.stiffnesses, (best.k1t, 0.0))
    both = best.configuration == "coupled"
    trials = _trials(rng, truth, "next", place, best.k1t, best.theta0, both, (1, 2))
    return replace(old, stiffnesses=stiffnesses, trials=(*old.trials, *trials))


def _again(rng: np.random.Generator, old: Experiment, truth: Truth) -> Experiment:
    """The campaign with two more trials of its case of the largest angle, coupled."""
    case, k1t, degrees = SMALL[-1]
    return replace(old, trials=(*old.trials, *_trials(rng, truth, case, 0, k1t, math.radians(degrees), True, (4, 5))))


def _told(rivals: str, which: int, number: int) -> dict[str, Any]:
    """Probability of the truth before, with two trials as proposed, and with two more of a known case."""
    truth = RIVALS[rivals][which]
    effects = {name: EFFECTS[name] for name, _, _ in RIVALS[rivals]}
    rng = np.random.default_rng([4711, which, number])
    first = _campaign(rng, truth)
    before = diagnose(first, effects=effects, workers=1)
    proposed = diagnose(_more(rng, first, truth, before), effects=effects, workers=1)
    repeated = diagnose(_again(rng, first, truth), effects=effects, workers=1)
    return {
        "before": before.answers.probabilities[truth[0]], "proposed": proposed.answers.probabilities[truth[0]],
        "repeated": repeated.answers.probabilities[truth[0]], "proposal": before.proposals[0].to_json(),
    }  # fmt: skip


@pytest.mark.prove
def test_the_proposed_experiment_decides_more_often_than_a_repetition() -> None:
    rows = {
        rivals: [
            row
            for which in (0, 1)
            for row in parts.finish(f"next-{rivals}-{which}", CAMPAIGNS, partial(_told, rivals, which))
        ]
        for rivals in RIVALS
    }
    every = [row for group in rows.values() for row in group]
    decided = {kind: sum(row[kind] > DECISIVE for row in every) for kind in ("before", "proposed", "repeated")}
    score = {kind: -float(np.mean([math.log(row[kind]) for row in every])) for kind in decided}
    assert decided["proposed"] > decided["repeated"], rows
    assert score["proposed"] < score["repeated"] < score["before"] + 0.1
