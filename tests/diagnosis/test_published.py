"""The diagnosis of the thesis's published numbers: its likelihood, its evidence, and what it dares to say."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_damper.commands.diagnose import Diagnosed, diagnose
from bayes_damper.diagnosis.joint import Formula, Joint, weigh_formula
from bayes_damper.diagnosis.published import (
    BLUR_PRIOR,
    Result,
    Settings,
    _information,
    _parameters,
    cannot_rank,
    contenders,
    diagnose_published,
    formulas,
    prior_probabilities,
    weigh_answers,
)
from bayes_damper.diagnosis.verdict import PRIOR_NONE, PRIOR_UNKNOWN
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.figures import published_figure, save
from bayes_damper.priors.distributions import from_standard
from bayes_damper.priors.files import load_priors
from bayes_damper.published.measurements import load_published
from bayes_damper.published.posterior import Datum
from bayes_damper.report import report
from bayes_damper.runs.json_files import write_json
from bayes_damper.sampling.moves import StudentT
from bayes_damper.variability.published import PublishedCases

NONE = Formula("none", "nominal", "the nominal model")
SMALL = Settings(search_rounds=4, search_count=384, count=64, sweeps=4, repeats=1)


def published_data(cases=("I", "II", "III", "IV")):
    published = load_published()
    return {
        c: tuple(Datum(m.configuration, m.quantity, m.value, m.standard_error, m.n) for m in published.of_case(c))
        for c in cases
    }


def test_a_case_has_the_likelihood_that_variability_gives_it():
    """One likelihood for both commands: the nominal formula adds nothing to it."""
    joint = Joint(published_data(), load_priors("thesis"), NONE)
    cases = PublishedCases(PublishedCases.default_plan())
    points = joint.coordinates.draw(np.random.default_rng(1), 40)
    found, values = joint.log_likelihood(points), joint.coordinates.values(points)
    for k, case in enumerate(joint.cases):
        assert np.array_equal(found[:, k], cases.features[case].log_density(values))
    assert np.isfinite(found).all(axis=1).sum() > 5


class Bell:
    """A target with a known integral: a Gaussian of mass e^3, off the place where the search begins."""

    formula = NONE
    ndim = 5

    def log_target(self, points):
        return 3.0 + stats.multivariate_normal(np.full(5, 1.5), 0.3 * np.eye(5) + 0.2).logpdf(points)


def test_the_evidence_of_a_known_integral_is_found_within_its_error():
    begin = StudentT(np.zeros(5), np.eye(5), 6.0)
    heights = []
    for seed in range(6):
        found = weigh_formula(Bell(), begin, np.random.default_rng(seed), count=512)
        assert abs(found.log_z - 3.0) < 4.0 * found.error
        assert found.ess > 200.0
        assert np.exp(found.log_weights).sum() == pytest.approx(1.0)
        heights.append(found.log_z)
    assert np.mean(heights) == pytest.approx(3.0, abs=0.15)


def test_every_effect_and_both_other_answers_are_among_the_explanations():
    """Dry friction is a candidate of the linear nominal model only; each family has all of its formulas."""
    families = {f.family for f in formulas()}
    assert {"none", "unknown", "release_ramp", "stick_slip", "sensor_gain"} <= families
    assert not {"bearing_drag", "interface_friction"} & families
    linear = {f.family for f in formulas("linear")}
    assert {"bearing_drag", "interface_friction"} <= linear
    assert sum(f.family == "release_ramp" for f in formulas()) == len(EFFECTS["release_ramp"].variants)


def test_answers_follow_prior_and_evidence():
    names = [n for n in EFFECTS if n not in ("bearing_drag", "interface_friction")]
    flat = weigh_answers({"unknown": 0.0} | dict.fromkeys(names, 0.0))
    assert sum(flat.probabilities.values()) == pytest.approx(1.0)
    assert flat.verdict == "none"
    assert flat.probabilities["unknown"] == pytest.approx(PRIOR_UNKNOWN)
    strong = weigh_answers({"unknown": 0.0} | dict.fromkeys(names, 0.0) | {"release_ramp": 5.0})
    each = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / len(names)
    expected = each * math.exp(5.0) / (1.0 - each + each * math.exp(5.0))
    assert strong.probabilities["release_ramp"] == pytest.approx(expected)
    assert strong.ranked[0] == "release_ramp"


def test_a_generic_discrepancy_widens_the_features_it_names_and_no_others():
    peaks = Formula("unknown", "peaks", "", (), None, frozenset({("coupled", "max_acceleration")}), BLUR_PRIOR)
    joint = Joint(published_data(("II",)), load_priors("thesis"), peaks)
    case, values = joint.cases["II"], joint.coordinates.values(np.zeros((1, joint.ndim)))
    features = np.array([[d.value for d in case.data]])
    for s, d in zip(case.scales(values, features)[0], case.data, strict=True):
        blurred = (d.configuration, d.quantity) == ("coupled", "max_acceleration")
        size = values["blur"][0] * d.value
        assert s == pytest.approx(math.hypot(d.standard_error, size) if blurred else d.standard_error)


def test_features_are_those_of_records_with_the_spring_and_angle_drawn():
    """Held out, the coupled numbers have no say: predictions then lie farther off than those that have met them."""
    joint = Joint(published_data(("IV",)), load_priors("thesis"), NONE)
    point = joint.coordinates.points({"mu": 0.008, "k2t": 1.2, "c2t": 0.03, "drag": 0.01, "nu": 100.0, "c1t": 0.008,
                                      "J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0,
                                      "t_min": 0.6e-3})  # fmt: skip
    rng, points = np.random.default_rng(2), np.repeat(point, 300, axis=0)
    met, spring = joint.features(points, "IV", rng)
    held, _ = joint.features(points, "IV", rng, coupled=False)
    data = joint.cases["IV"].data
    period, peak = (
        next(j for j, d in enumerate(data) if d.name == name)
        for name in ("period (uncoupled)", "max_acceleration (coupled)")
    )
    assert np.median(met[:, period]) == pytest.approx(data[period].value, rel=1e-3)
    assert spring.std() / spring.mean() == pytest.approx(2.0 * met[:, period].std() / met[:, period].mean(), rel=0.05)
    off = [np.mean(x[:, peak]) - data[peak].value for x in (held, met)]
    assert off[0] > off[1] + 3.0 * held[:, peak].std() / math.sqrt(300.0)


def test_a_formula_that_changes_no_number_tells_nothing_of_its_parameters():
    late = next(f for f in formulas() if f.family == "sensor_delay")
    assert _parameters(Result(late, 0.0, 0.0, (), silent=True)) == {}


def test_information_is_nothing_for_equal_answers_and_the_entropy_for_far_ones():
    rng = np.random.default_rng(3)
    p = np.array([0.5, 0.5])
    same = [rng.standard_normal((300, 40)) for _ in range(2)]
    assert _information(p, same)[0] < 0.05
    far = [rng.standard_normal((300, 40)), 30.0 + rng.standard_normal((300, 40))]
    assert _information(p, far)[0] == pytest.approx(math.log(2.0), abs=0.02)


def test_the_figure_has_a_panel_for_each_feature_and_all_answers(tmp_path):
    rows = {
        name: [
            {"case": case, "configuration": d.configuration, "feature": d.quantity, "unit": "1", "measured": d.value,
             "standard_error": d.standard_error, "predicted": share * d.value,
             "predicted_hdi90": [0.9 * share * d.value, 1.1 * share * d.value]}
            for case, data in published_data().items() for d in data
        ]
        for name, share in (("nominal", 1.1), ("release_offset", 1.0))
    }  # fmt: skip
    figure = published_figure(rows, title="published numbers")
    assert len(figure.axes) == 6
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["measured", "nominal", "release offset"]
    save(figure, tmp_path / "published")
    assert (tmp_path / "published.png").stat().st_size > 10_000


def test_only_what_may_matter_is_weighed_again():
    names = ["none", "unknown", "unknown", "release_offset", "release_offset", "inertia_error"]
    every = [replace(NONE, family=name, name=str(i)) for i, name in enumerate(names)]
    heights = {0: -30.0, 1: -22.0, 2: -40.0, 3: -30.0, 4: -21.0, 5: -29.5}
    assert contenders(every, heights) == [1, 4]
    # Behind a formula that says nothing of these numbers, which counts as the nominal model does.
    assert contenders(every, {i: z for i, z in heights.items() if i != 5}) == [1, 4]
    assert contenders(every, dict.fromkeys(heights, -30.0)) == [1, 2, 3, 4, 5]


def test_effects_are_not_ranked_by_less_than_the_errors_of_their_evidences():
    evidence = {"unknown": 9.0, "a": 3.0, "b": 2.2, "c": -1.0}
    assert cannot_rank(evidence, dict.fromkeys(evidence, 0.3)) == ["a", "b"]
    assert cannot_rank(evidence, dict.fromkeys(evidence, 0.2)) == ["a"]


@pytest.fixture(scope="module")
def found():
    few = {name: EFFECTS[name] for name in ("release_offset", "inertia_error")}
    return diagnose_published(published_data(), load_priors("thesis"), effects=few, settings=SMALL)


@pytest.mark.slow
def test_the_answer_holds_all_that_24_numbers_can_carry(found, tmp_path):
    """Fields of diagnosis.json, words, and the report's page."""
    write_json(tmp_path / "diagnosis.json", found.to_json())
    data = json.loads((tmp_path / "diagnosis.json").read_text())
    assert data["schema"] == "bayes-damper/diagnosis/1"
    assert set(data["probabilities"]) == {"none", "unknown", "release_offset", "inertia_error"}
    assert sum(data["probabilities"].values()) == pytest.approx(1.0)
    assert sum(data["sites"].values()) == pytest.approx(1.0)
    assert len(data["where"]["feature"]) == 24
    assert {e["name"] for e in data["effects"]} == {"release_offset", "inertia_error"}
    assert all(e["log_evidence_error"] >= 0.0 for e in data["effects"])
    assert data["gap"]["answer"] in ("gap", "none", "cannot tell")
    assert data["next_experiment"][0]["expected_information_nats"] >= 0.0
    # The model's coupled peaks lie above the measured ones.
    assert data["gap"]["mean_difference"] > 0.0
    text = Diagnosed(tmp_path, data | {"provenance": {}}).text()
    assert "Most probable" in text
    assert "cannot be excluded" in text or "0.9" in text
    report(tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "release offset" in page


@pytest.mark.slow
def test_the_same_seed_gives_the_same_answer_on_any_number_of_processes():
    few = {"inertia_error": EFFECTS["inertia_error"]}
    one, two = (
        diagnose_published(published_data(("IV",)), load_priors("thesis"), effects=few, settings=SMALL, workers=n)
        for n in (1, 2)
    )
    assert one.answers.probabilities == two.answers.probabilities


def test_what_cannot_be_used_is_refused(tmp_path):
    fixed = load_priors("thesis").replace(theta0=0.1)
    with pytest.raises(InputError, match="theta0 needs a prior"):
        Joint(published_data(), fixed, NONE)
    with pytest.raises(InputError, match="nominal"):
        diagnose("thesis", nominal="odd", out=tmp_path)


def simulated(joint, rng):
    """Numbers as the formula would have given them: everything drawn from its prior, published standard errors.

    Drawn again where a record has no second peak, because such numbers would not have been published.
    """
    for _ in range(200):
        values = joint.coordinates.values(joint.coordinates.draw(rng, 1))
        numbers = {}
        for name, case in joint.cases.items():
            own = {key: from_standard(prior, rng.standard_normal(1)) for key, prior in case.own.items()}
            features = case.predict(values | own)
            measured = features + case.scales(values, features) * rng.standard_t(joint.dof, features.shape)
            numbers[name] = tuple(replace(d, value=float(x)) for d, x in zip(case.data, measured[0], strict=True))
        if all(math.isfinite(d.value) and d.value > 0.0 for rows in numbers.values() for d in rows):
            return numbers
    pytest.fail(f"{joint.formula.family}: no draw of the prior shows all features")


@pytest.mark.slow
def test_numbers_of_the_nominal_model_are_not_blamed_on_an_effect():
    """Simulated under `none` from one draw of the prior: `none` stays possible, and nothing else is sure."""
    few = {"release_offset": EFFECTS["release_offset"]}
    numbers = simulated(Joint(published_data(("I", "IV")), load_priors("thesis"), NONE), np.random.default_rng(5))
    found = diagnose_published(numbers, load_priors("thesis"), effects=few, settings=SMALL)
    assert found.answers.probabilities["none"] > 0.1
    assert found.answers.verdict == "none" or max(found.answers.probabilities.values()) < 0.9
    row = found.to_json()["effects"][0]
    assert 3.0 < row["effective_draws"] < 64.0
    assert row["spread_of_repeats"] == 0.0


@pytest.mark.prove
def test_probabilities_are_calibrated_on_simulated_numbers():
    """Truths drawn equally often: `none`, `unknown`, three effects. Under equal prior probabilities the right answer
    then gets, on average, the confidence told, and `none` is not denied where it is true.
    """
    few = {name: EFFECTS[name] for name in ("release_offset", "release_ramp", "interface_relaxation")}
    every = formulas("nonlinear", few)
    prior = prior_probabilities(list(few))
    priors, data = load_priors("thesis"), published_data()
    rng = np.random.default_rng(11)
    told, right, denied = [], [], []
    for k in range(20):
        family = ("none", "unknown", *few)[k % 5]
        formula = [f for f in every if f.family == family][k % sum(f.family == family for f in every)]
        numbers = simulated(Joint(data, priors, formula), rng)
        answers = diagnose_published(numbers, priors, effects=few, seed=k, settings=SMALL).answers
        evidence = {name: p / prior[name] for name, p in answers.probabilities.items()}
        told.append({name: e / sum(evidence.values()) for name, e in evidence.items()})
        right.append(family)
        if family == "none":
            denied.append(answers.probabilities["none"])
    confident = [(max(p, key=p.get), max(p.values()), r) for p, r in zip(told, right, strict=True)]
    wrong = [c for c in confident if c[1] > 0.9 and c[0] != c[2]]
    assert len(wrong) <= 1
    of_right = np.array([p[r] for p, r in zip(told, right, strict=True)])
    # Where probabilities are true, that of the right answer is on average the sum of their squares.
    over = of_right - np.array([sum(x**2 for x in p.values()) for p in told])
    assert abs(over.mean()) < 3.0 * over.std(ddof=1) / math.sqrt(len(over))
    assert -np.mean(np.log(np.maximum(of_right, 1e-9))) < math.log(5.0) + 0.1
    assert np.mean(denied) > 0.2
