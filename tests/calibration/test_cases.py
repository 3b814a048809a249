"""Damping of each case's own spring: found where it differs, one number where nothing allows it to."""

import re
from dataclasses import replace

import numpy as np
import pytest
import small_rig
from scipy.stats import f_oneway
from small_rig import measured, variant

from bayes_damper.calibration import Problem, calibrate, calibrate_nominal
from bayes_damper.calibration.cases import (
    _Means,
    by_case_in_words,
    damping_in_words,
    differing_by_case,
    one_damping_in_words,
    with_damping_of_each_case,
    with_own_in_each_case,
)
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.by_case import differing_in_words, gains_by_case
from bayes_damper.diagnosis.gap import left_out_case
from bayes_damper.diagnosis.next_experiment import moved, propose
from bayes_damper.effects import EFFECTS

DAMPING = {"I": 0.011, "IV": 0.02}


def damped(second):
    """Trials of the primary alone on two springs, with another damping on the second."""
    parts = []
    with pytest.MonkeyPatch.context() as patch:
        for seed, (case, k, theta0) in enumerate((("I", 0, 0.1), ("IV", 1, 0.08))):
            patch.setitem(small_rig.RIG, "c1t", second if k else DAMPING["I"])
            parts.append(measured(seed, cases=((case, k, theta0),), configurations=(False,), repeats=4))
    return replace(parts[0], trials=parts[0].trials + parts[1].trials)


@pytest.fixture(scope="module")
def unlike():
    """The second spring takes nearly twice the energy."""
    return damped(DAMPING["IV"])


@pytest.fixture(scope="module")
def fitted(unlike):
    nominal = calibrate_nominal(unlike)
    return nominal, with_damping_of_each_case(nominal)


def test_each_case_shows_the_damping_of_its_own_spring(fitted):
    nominal, own = fitted
    assert own.log_evidence > nominal.log_evidence + 20.0
    for case, value in DAMPING.items():
        mean, sd = own.parameters[f"c1t[{case}]"]
        assert abs(mean - value) < 3.5 * sd
        assert sd < 0.2 * value
    assert damping_in_words(nominal) == one_damping_in_words(own) == []
    assert "right for none of them" in one_damping_in_words(nominal)[0]
    assert "0.0" in damping_in_words(own)[0]
    assert "case IV" in damping_in_words(own)[0]


def test_cases_on_one_spring_share_its_damping():
    cases = (("low", 0, 0.05), ("high", 0, 0.1))
    for chosen in (cases, cases[:1]):
        fit = calibrate_nominal(measured(3, cases=chosen, configurations=(False,)))
        assert with_damping_of_each_case(fit) is None


def test_springs_that_damp_alike_need_no_second_number():
    fit = calibrate_nominal(measured(4, configurations=(False,)))
    assert with_damping_of_each_case(fit).log_evidence < fit.log_evidence + 1.0


def test_a_sound_rig_whose_springs_damp_differently_is_not_accused(unlike):
    found = diagnose(unlike, effects={n: EFFECTS[n] for n in ("bearing_stribeck", "quadratic_drag")})
    assert found.verdict == "none"
    assert any("c1t differs from case to case" in note for note in found.notes)


@pytest.mark.slow
def test_an_effect_that_explains_more_is_not_taken_for_damping():
    quadratic = variant("quadratic_drag")
    measured_with_it = measured(5, effect=quadratic, values={"coefficient": 0.8}, configurations=(False,))
    found = diagnose(measured_with_it, effects={n: EFFECTS[n] for n in ("bearing_stribeck", "quadratic_drag")})
    assert found.verdict == "quadratic_drag"
    assert not any("from case to case" in note for note in found.notes)


def test_a_fit_without_one_of_two_cases_keeps_the_name_of_the_other(fitted):
    own = fitted[1]
    rest = own.problem.for_trials([i for i in own.problem.trials if own.problem.experiment.trials[i].case == "IV"])
    assert set(rest.names) < set(own.problem.names)
    assert "c1t[I]" not in rest.names
    beyond = left_out_case(own, own, "I")
    assert np.isfinite(beyond.nominal_rms)


def test_a_trial_that_is_proposed_has_the_damping_of_a_case(fitted):
    own = fitted[1]
    stops = variant("spring_bottoming")
    rival = calibrate(own.problem.with_effect(stops), [np.append(own.q, (0.0, 0.5))], eta=own.eta, anneal=False)
    assert propose([own, rival], (0.5, 0.5))
    other = replace(
        own.problem.experiment, trials=tuple(replace(t, case="next") for t in own.problem.experiment.trials)
    )
    problem, q = moved(own, other)
    assert isinstance(problem, Problem)
    assert q[problem.names.index("c1t")] in [own.q[own.problem.names.index(f"c1t[{case}]")] for case in DAMPING]


def test_the_parameter_that_differs_from_case_to_case_is_asked_for():
    """On one spring damping has no reason to differ; a sentence asks what was changed, with the values."""
    cases = (("low", 0, 0.06), ("high", 0, 0.1))
    alike = calibrate_nominal(measured(7, cases=cases, configurations=(False,), repeats=4))
    assert differing_in_words(alike, 0.0) == []
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(small_rig.RIG, "c1t", 0.02)
        other = measured(8, cases=cases[1:], configurations=(False,), repeats=4)
    kept = [t for t in alike.problem.experiment.trials if t.case == "low"]
    fit = calibrate_nominal(replace(alike.problem.experiment, trials=(*kept, *other.trials)))
    assert max(gains_by_case(fit), key=gains_by_case(fit).get) == "c1t"
    said = differing_in_words(fit, 0.0)[0]
    values = re.search(r"c1t for each case .*: (\S+) in case low, (\S+) in case high", said).groups()
    assert [float(x) for x in values] == pytest.approx([0.011, 0.02], rel=0.15)
    assert differing_in_words(fit, 1e6) == []
    (said,) = by_case_in_words(fit)
    assert said.startswith("c1t differs from case to case: above that of case low by ")
    assert said.endswith('write `c1t = { level = "case" }` in the file of --priors.')


def test_the_linearised_gain_of_a_value_for_each_case_is_that_of_the_fit():
    """Of a small difference, for which the records change in proportion."""
    fit = calibrate_nominal(damped(1.1 * DAMPING["I"]))
    own = with_own_in_each_case(fit, "c1t")
    assert gains_by_case(fit)["c1t"] == pytest.approx(0.5 * (fit.cost - own.cost), rel=0.3)


SPRINGS = {"A": (0.0, 0.1), "B": (-0.006, 0.07), "C": (-0.015, 0.05)}  # by what share they differ, and the swing


def on_springs(differ, seed=1, declared=0.01, repeats=4, names="ABC"):
    """Trials of the primary alone, each spring seated anew by 0.1 %; differ : factor on what cases differ by."""
    rng, trials = np.random.default_rng(seed), []
    for case in names:
        share, swing = SPRINGS[case]
        for number in range(1, repeats + 1):
            own = 6.2 * (1.0 + differ * share + 1e-3 * rng.standard_normal())
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(small_rig, "STIFFNESSES", (own,))
                one = measured(int(rng.integers(1e6)), cases=((case, 0, swing),), configurations=(False,), repeats=1)
            t = one.trials[0]
            trials.append(replace(t, label=f"{case} {number}", number=number, theta0_sd=0.01 * swing))
    return replace(one, stiffnesses=((6.2, declared * 6.2),), trials=tuple(trials))


def test_cases_that_share_a_spring_and_should_not_are_named():
    fit = calibrate_nominal(on_springs(1.0))
    (apart,) = differing_by_case(fit)
    assert apart.name == "k1t"
    (values,) = apart.values
    for case, (share, _) in SPRINGS.items():
        assert values[case] - values["A"] == pytest.approx(share, abs=0.0025)
    (said,) = by_case_in_words(fit)
    assert said.startswith("k1t differs from case to case: above that of case C by ")
    assert "Cases that declare the same k1t share one spring." in said
    assert "the model lacks" not in said
    assert "the model lacks" in by_case_in_words(fit, missing=True)[0]


@pytest.mark.parametrize(("differ", "seed"), [(0.3, 2), (0.0, 3)])
def test_the_test_of_cases_is_the_plain_one_where_trials_show_their_springs(differ, seed):
    """Each trial shows its own spring far better than springs differ: then it is the F test of these values."""
    fit = calibrate_nominal(on_springs(differ, seed, repeats=6 if differ else 4))
    (group,) = fit.problem.groups
    column = [name for name, _, _ in group.nuisances].index("ln_k1t")
    own = {case: [] for case in SPRINGS}
    for i in group.trials:
        own[fit.problem.experiment.trials[i].case].append(fit.eta[i][column])
    p = _Means.of(fit).tested("k1t", [])
    assert np.log(p) == pytest.approx(np.log(f_oneway(*own.values()).pvalue), rel=0.2, abs=0.3)
    assert bool(differing_by_case(fit)) is (differ > 0.0)


def test_cases_that_declare_springs_of_their_own_need_no_note():
    one = on_springs(1.0)
    apart = tuple(replace(t, k1t="ABC".index(t.case)) for t in one.trials)
    fit = calibrate_nominal(replace(one, trials=apart, stiffnesses=tuple((6.2 + 1e-3 * k, 0.06) for k in range(3))))
    assert differing_by_case(fit) == []
    values = [fit.parameters[f"k1t[{6.2 + 1e-3 * k:g}]"][0] for k in range(3)]
    assert values[2] / values[0] - 1.0 == pytest.approx(SPRINGS["C"][0], abs=0.0025)


def test_without_repeats_springs_that_differ_more_than_usual_are_named():
    fit = calibrate_nominal(on_springs(2.0, repeats=1))
    assert differing_by_case(fit) == []
    (said,) = by_case_in_words(fit)
    assert re.match(
        r"k1t differs from trial to trial by [1-4](\.\d)? %, where 0.2 % is usual. No case is repeated", said
    )
    assert by_case_in_words(fit, missing=True) == []
    assert by_case_in_words(calibrate_nominal(on_springs(0.0, repeats=1))) == []
