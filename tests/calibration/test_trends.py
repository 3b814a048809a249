"""Parameters that change with the order of the trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from bayes_damper.calibration import calibrate_nominal
from bayes_damper.calibration.cases import differing_by_case
from bayes_damper.calibration.experiment import Experiment, TrialRecord
from bayes_damper.calibration.scatter import scatter_in_words, scatter_shown
from bayes_damper.calibration.trends import with_trends
from bayes_damper.diagnosis import diagnose

RELEASES = {"I": 0.3, "II": 0.2, "III": 0.12}
REPEATS = 6


def decays(dampings: Sequence[float], seed: int = 3) -> Experiment:
    """Viscous decays of 4 Hz from rest in closed form, six from each of three angles, in the order of the table."""
    rng, times = np.random.default_rng(seed), np.arange(0.0, 2.0, 0.005)
    omega, trials, places = 2.0 * math.pi * 4.0, [], np.linspace(-0.5, 0.5, len(dampings))
    for n, c in enumerate(dampings):
        case = list(RELEASES)[n // REPEATS]
        reach = RELEASES[case] * (1.0 + 0.003 * rng.standard_normal())
        root = omega * complex(-c, math.sqrt(1.0 - c * c))
        y = np.real(reach * (1.0 - 1j * c / math.sqrt(1.0 - c * c)) * np.exp(root * times))
        y = y + 1e-4 * rng.standard_normal(times.size)
        of_case = n % REPEATS + 1
        trials.append(
            TrialRecord(
                f"{n}.csv", case, False, of_case, times, y[None], 0, RELEASES[case], 0.01 * RELEASES[case],
                heldout=of_case == REPEATS, order=float(places[n]),
            )
        )  # fmt: skip
    stiffness = omega**2
    return Experiment({"J1": (1.0, 0.0)}, ((stiffness, 0.001 * stiffness),), tuple(trials), quantity="displacement")


def dampings(change: float, of_cases: Sequence[float] = (0.0, 0.0, 0.0), scatter: float = 0.01) -> np.ndarray:
    """Damping ratios of all trials: by what share they change over the table, and differ from case to case."""
    n, rng = len(RELEASES) * REPEATS, np.random.default_rng(8)
    own = change * np.linspace(-0.5, 0.5, n) + np.repeat(of_cases, REPEATS) + scatter * rng.standard_normal(n)
    return 0.02 * np.exp(own)


@pytest.fixture(scope="module")
def warming() -> Experiment:
    """Its damping grows by e^0.2 from the first trial to the last, and scatters by 1 %."""
    return decays(dampings(0.2))


def test_a_damping_that_grows_from_trial_to_trial_is_followed_over_the_cases(warming):
    plain = calibrate_nominal(warming, nominal="linear")
    assert [apart.name for apart in differing_by_case(plain)] == ["c1t"]
    fit = with_trends(plain, lambda _: None)
    change, sd = fit.parameters["trend_c1t"]
    assert abs(change - 0.2) < 3.0 * sd
    assert sd < 0.03
    assert fit.problem.switches.scatter.sd("c1t") < 0.02
    assert differing_by_case(fit) == []
    assert any("c1t grows by 2" in words and "from the first trial" in words for words in scatter_in_words(fit))
    shown = scatter_shown(fit, "rad")["c1t"]
    of_all = float(np.std(np.log(dampings(0.2)), ddof=1))
    assert shown["hdi90"][0] < of_all < shown["hdi90"][1]
    assert shown["trend_with_order"] > 0.8


def test_a_diagnosis_follows_it_names_no_cause_and_says_so(warming):
    found = diagnose(warming, nominal="linear")
    assert "trend_c1t" in found.nominal.problem.names
    assert found.answers.probabilities["none"] > 0.6
    assert any("c1t grows by 2" in note for note in found.notes)
    assert not any("differs from case to case" in note for note in found.notes)


@pytest.mark.parametrize(
    ("change", "of_cases"),
    [(0.0, (-0.07, 0.0, 0.07)), (0.2, (0.15, 0.0, -0.15)), (0.2, (0.067, 0.0, -0.067)), (0.0, (0.0, 0.0, 0.0))],
    ids=["cases differ, repeats do not", "cases refute what repeats show", "cases are alike", "nothing changes"],
)
def test_a_trend_needs_repeats_that_show_it_and_cases_that_follow(change, of_cases):
    """Of the damping, which alone scatters: of several parameters, that which repeats show best would be asked."""
    alone = replace(decays(dampings(change, of_cases)), scatter={"k1t": 0.0})
    fit = calibrate_nominal(alone, nominal="linear")
    assert with_trends(fit, lambda _: None) is fit
