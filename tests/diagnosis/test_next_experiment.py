"""The next experiment: expected information by brute force, and a recommendation that really splits the answers."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from small_rig import measured, variant

from bayes_damper.calibration import Problem, calibrate, calibrate_nominal
from bayes_damper.diagnosis.next_experiment import bhattacharyya, expected_information, propose

HARDENING, STOP = variant("spring_cubic"), variant("spring_bottoming")
TRUTH = {"k3": 40.0}
SMALL = (("I", 0, 0.045),)


@pytest.fixture(scope="module")
def rivals():
    """Nominal and hardening fits of a campaign of small angles, which hardly tells them apart."""
    experiment = measured(31, effect=HARDENING, values=TRUTH, cases=SMALL, configurations=(False,))
    nominal = calibrate_nominal(experiment)
    found = calibrate(
        nominal.problem.with_effect(HARDENING), [np.append(nominal.q, 0.5)], eta=nominal.eta, anneal=False
    )
    return nominal, found


def test_distance_of_two_gaussians_by_quadrature():
    """Minus the logarithm of the integral of the square root of the product of both densities, in one dimension."""
    a, b = np.array([[0.8]]), np.array([[1.7]])
    x = np.linspace(-30.0, 30.0, 200001)
    first = multivariate_normal(0.3, 1.0 + 0.8**2).pdf(x)
    second = multivariate_normal(2.5, 1.0 + 1.7**2).pdf(x)
    expected = -np.log(np.trapezoid(np.sqrt(first * second), x))
    assert bhattacharyya(np.array([0.3]), a, np.array([2.5]), b) == pytest.approx(expected, rel=1e-6)
    assert bhattacharyya(np.array([0.3]), a, np.array([0.3]), a) == pytest.approx(0.0, abs=1e-12)


def test_information_is_bounded_by_what_is_open():
    """Nothing where answers agree, the entropy where they are far apart, and below the exact value in between."""
    p = np.array([0.7, 0.3])
    entropy = -np.sum(p * np.log(p))
    assert expected_information(p, np.zeros((2, 2))) == pytest.approx(0.0)
    far = np.array([[0.0, 50.0], [50.0, 0.0]])
    assert expected_information(p, far) == pytest.approx(entropy)
    # Two unit Gaussians 1.5 apart: mutual information by quadrature.
    x = np.linspace(-12.0, 14.0, 20001)
    one, two = multivariate_normal(0.0, 1.0).pdf(x), multivariate_normal(1.5, 1.0).pdf(x)
    mixed = p[0] * one + p[1] * two
    exact = np.trapezoid(p[0] * one * np.log(one / mixed) + p[1] * two * np.log(two / mixed), x)
    distance = bhattacharyya(np.zeros(1), np.zeros((1, 1)), np.array([1.5]), np.zeros((1, 1)))
    bound = expected_information(p, np.array([[0.0, distance], [distance, 0.0]]))
    assert 0.5 * exact < bound <= exact + 1e-9


def test_the_recommended_experiment_splits_the_answers_in_simulation(rivals):
    """Another trial as recommended raises the right answer's evidence by more than one as least recommended."""
    ranked = propose(rivals, (0.5, 0.5))
    assert len(ranked) > 10
    assert ranked[0].information >= ranked[-1].information
    assert ranked[0].theta0 > 0.045  # a hardening spring shows at large angles
    margins = []
    for proposal in (ranked[0], ranked[-1]):
        k = proposal.k1t
        case = ("next", 0, proposal.theta0)
        gained = []
        for seed in (41, 42):
            extra = measured(seed, effect=HARDENING, values=TRUTH, cases=(case,), configurations=(False,), repeats=2)
            old = rivals[0].problem.experiment
            trials = (*(t for t in old.trials if not t.heldout), *extra.trials[:1])
            together = type(old)(old.constants, old.stiffnesses, trials)
            evidence = []
            for fit in rivals:
                problem = Problem(together, fit.problem.effect, noise=fit.problem.noise, switches=fit.problem.switches)
                evidence.append(calibrate(problem, [fit.q], anneal=False).log_evidence)
            gained.append(evidence[1] - evidence[0])
        margins.append(np.mean(gained))
        assert k > 0.0
    assert margins[0] > margins[1] + 3.0


def test_one_open_answer_needs_no_experiment(rivals):
    assert propose(rivals, (1.0, 0.0)) == []
    assert propose(rivals[:1], (1.0,)) == []
    assert len(propose(rivals, (0.5, 0.5), top=3)) == 3


def test_choices_can_be_given(rivals):
    ranked = propose(rivals, (0.5, 0.5), stiffnesses=(6.2,), angles=(0.02, 0.1))
    assert {(p.k1t, p.theta0) for p in ranked} == {(6.2, 0.02), (6.2, 0.1)}
    assert ranked[0].theta0 == 0.1
    entry = ranked[0].to_json()
    assert set(entry) >= {"configuration", "k1t_n_m_per_rad", "theta0_deg", "expected_information_nats"}
    assert entry["theta0_deg"] == pytest.approx(np.degrees(0.1))
    entry = ranked[0].to_json("translational")
    assert (entry["k1_n_per_m"], entry["theta0_mm"]) == (6.2, pytest.approx(100.0))
    assert "k1t_n_m_per_rad" not in entry


def test_mistaken_calls_are_refused(rivals):
    with pytest.raises(ValueError, match="one for each"):
        propose(rivals, (1.0,))
    with pytest.raises(ValueError, match="negative"):
        propose(rivals, (1.0, -0.5))
