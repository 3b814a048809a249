"""Results side by side, evidence from a fit's draws, and how far answers hang on the priors."""

import json
import math
import shutil

import numpy as np
import pytest

from bayes_damper.commands.compare import _cell, _word, compare, leave_out
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.fit import published_posterior
from bayes_damper.fit.summary import summarise, table_text
from bayes_damper.priors.files import load_priors
from bayes_damper.published.measurements import load_published
from bayes_damper.runs.json_files import write_json
from bayes_damper.sampling import arviz_adapter
from bayes_damper.sampling.prior_sensitivity import of_standard_draws, text
from bayes_damper.sampling.sequential import temper
from bayes_damper.variability.pooling import Hierarchy
from bayes_damper.variability.published import PublishedCases


def write_fit(folder, normal_force, rng):
    """A folder like that of a fit of case IV of the thesis, its draws made by tempering; their log evidence."""
    plan = PublishedCases.default_plan() | {"cases": ["IV"], "normal_force": normal_force}
    cases = PublishedCases(plan)
    hierarchy = Hierarchy([cases.likelihood("IV")], "separate", cases.pooled)
    found = temper(hierarchy, rng, 256)
    values = cases.values(hierarchy, found.points, 0, rng)
    posterior = published_posterior("IV", load_priors("thesis"), normal_force)
    points = posterior.coordinates.points(values)
    # Spring and angle were drawn by linear features: a draw without the features that were measured gives its place.
    sound = np.flatnonzero(np.isfinite(posterior(points)))
    assert len(sound) > 0.9 * len(points)
    kept = np.where(np.isin(np.arange(len(points)), sound), np.arange(len(points)), sound[:1])
    points, values = points[kept], {name: x[kept] for name, x in values.items()}
    draws = {name: values[name].reshape(2, 8, 16) for name in posterior.names}
    folder.mkdir()
    write_json(folder / "run.json", {"command": "fit", "plan": plan, "workers": 1})
    summary = {"schema": "bayes-damper/fit/1", "campaign": "thesis", "converged": True}
    parameters = summarise(draws, {}, {})
    summary["cases"] = {"IV": {"converged": True, "parameters": parameters, "sentences": []}}
    write_json(folder / "summary.json", summary)
    likelihood = posterior.log_likelihood(points).reshape(2, 128, -1)
    tree = arviz_adapter.results(
        draws, log_prob=posterior(points).reshape(2, 8, 16), groups={"log_likelihood": {"features": likelihood}}
    )
    (folder / "IV").mkdir()
    arviz_adapter.write(tree, folder / "IV" / "posterior.nc")
    return found.log_z


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Folder and log evidence of a fit by the law of its normal force, drawn once; tests change copies."""
    home = tmp_path_factory.mktemp("fits")
    return {
        law: (home / law, write_fit(home / law, law, np.random.default_rng(seed)))
        for seed, law in enumerate(("linear", "constant"), start=1)
    }


@pytest.mark.slow
def test_two_fits_side_by_side(tmp_path, drawn):
    """Bridge sampling from the draws in posterior.nc agrees with tempering, which made them."""
    for law, (folder, _) in drawn.items():
        shutil.copytree(folder, tmp_path / law)
    summary = json.loads((tmp_path / "constant" / "summary.json").read_text()) | {"converged": False}
    summary["cases"]["IV"]["converged"] = False
    write_json(tmp_path / "constant" / "summary.json", summary)
    found = compare([tmp_path / "linear", tmp_path / "constant"], out=tmp_path / "out")
    assert found.exit_code is ExitCode.DONE
    result = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert result["schema"] == "bayes-damper/comparison/1"
    for law, (_, log_z) in drawn.items():
        assert result["evidence"]["case IV"][law] == pytest.approx(log_z, abs=1.0)
    cell = result["parameters"]["IV"]["mu"]
    assert set(cell) == {"linear", "constant"}
    assert "distance_sd" in cell["constant"]
    assert "distance_sd" not in cell["linear"]
    assert math.isfinite(result["heldout"]["case IV"]["linear"])
    assert "constant: did not converge; do not use its numbers." in found.text()
    assert (tmp_path / "out" / "comparison.svg").exists()
    moved = result["prior_sensitivity"]["linear"]["IV"]
    assert set(moved) == set(published_posterior("IV", load_priors("thesis")).names)
    assert moved["J2"]["half"]["width"] == pytest.approx(0.5, abs=0.15)  # its prior decides J2


def test_folders_of_other_kinds(tmp_path):
    for name, verdict in (("a", "stick_slip"), ("b", "none")):
        (tmp_path / name).mkdir()
        write_json(
            tmp_path / name / "diagnosis.json",
            {
                "schema": "bayes-damper/diagnosis/1", "campaign": "c", "verdict": verdict,
                "probabilities": {"none": 0.2, "stick_slip": 0.8}, "gap": {"answer": "gap", "size": 0.1},
                "effects": [{"name": "stick_slip", "log_evidence": -3.0}],
            },
        )  # fmt: skip
    result = compare([tmp_path / "a", tmp_path / "b"]).to_json()
    assert result["diagnosis"]["verdict"] == {"a": "stick_slip", "b": "none"}
    assert result["diagnosis"]["probability of the verdict"] == {"a": 0.8, "b": 0.2}
    assert result["parameters"] == {}


def test_leave_one_out_of_gaussian_draws_is_the_predictive_density():
    """Mean of a Gaussian from n readings with known noise: leaving one out is known in closed form."""
    rng = np.random.default_rng(2)
    y = rng.standard_normal(8)
    draws = rng.normal(y.mean(), 1 / math.sqrt(8), 20000)
    for i in range(8):
        others = np.delete(y, i)
        sd = math.sqrt(1.0 + 1.0 / 7.0)
        exact = -0.5 * ((y[i] - others.mean()) / sd) ** 2 - math.log(sd) - 0.5 * math.log(2 * math.pi)
        found, k = leave_out(-0.5 * (y[i] - draws) ** 2 - 0.5 * math.log(2 * math.pi))
        assert found == pytest.approx(exact, abs=0.05)
        assert k < 0.7


def test_prior_sensitivity_of_a_conjugate_posterior():
    """Prior N(0, 1), one reading y = 2 with noise 1: posterior N(1, 1/2); with prior sd 2 it is N(1.6, 0.8)."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.normal(1.0, math.sqrt(0.5), 40000), rng.standard_normal(40000)])
    found = of_standard_draws(("k2t", "mu"), points)
    double = found["k2t"]["double"]
    assert double["shift"] == pytest.approx(0.6 / math.sqrt(0.5), abs=0.08)
    assert double["width"] == pytest.approx(math.sqrt(0.8 / 0.5), abs=0.08)
    half = found["k2t"]["half"]
    assert half["shift"] == pytest.approx((0.4 - 1.0) / math.sqrt(0.5), abs=0.05)
    assert half["width"] == pytest.approx(math.sqrt(0.2 / 0.5), abs=0.05)
    assert half["moves_most"] == "mu"
    assert abs(half["shift_of_that"]) < 0.05
    assert found["mu"]["decided_by"] == "prior"


def test_tables_and_shifts_agree_on_who_decided():
    """One word for one share of the prior's variance, in the table of a fit and below it."""
    rng = np.random.default_rng(3)
    points = np.column_stack([x * rng.standard_normal(20_000) for x in (0.3, 0.8, 0.95)])
    found = of_standard_draws(("a", "b", "c"), points)
    assert [found[name]["decided_by"] for name in "abc"] == ["data", "data and prior", "prior"]
    row = {"median": 1.0, "hdi90": (0.5, 1.5), "unit": "1"}
    lines = table_text({n: row | {"prior_share": found[n]["prior_share"]} for n in "abc"}, "case").splitlines()
    assert [line.rpartition(" 1 ")[2].strip() for line in lines[2:]] == ["data", "data and prior", "prior"]


def test_names_as_long_as_those_of_two_effects_stay_apart_from_their_numbers():
    name = "effect.quadratic_drag.coefficient"
    row = {"median": 1.25, "hdi90": (0.5, 1.5), "unit": "1/rad", "prior_share": 0.1}
    head, long, short = table_text({name: row, "mu": row}, "case").splitlines()[1:]
    assert long.split()[:2] == [name, "1.25"]
    assert short.index("1.25") == long.index("1.25")
    assert long.index("data") == short.index("data") == head.index("decided by")
    assert short.index("coefficient of friction between the bodies") == head.index("meaning")
    shown = table_text({name: row}, "case", {name: "torque per angle and speed"}).splitlines()[2]
    assert shown.index("torque per angle") == head.index("meaning")
    side = {
        "shift": 0.5,
        "width": 1.0,
        "moves_most": name,
        "shift_of_that": 0.0,
        "effective_share": 1.0,
        "reliable": True,
    }
    entry = {"prior_share": 0.5, "decided_by": "data", "half": side, "double": side}
    assert text({name: entry})[1].split()[:2] == [name, "+0.50"]


@pytest.mark.slow
def test_what_a_fit_has_worked_out_is_taken_from_it(tmp_path, drawn):
    for name, (folder, _) in zip("ab", drawn.values(), strict=True):
        shutil.copytree(folder, tmp_path / name)
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    row = {"shift": 0.25, "width": 0.9, "moves_most": "k2t", "shift_of_that": 0.1, "reliable": True}
    told = {"mu": {"prior_share": 0.2, "decided_by": "data", "half": row, "double": row}}
    summary["cases"]["IV"] |= {"log_evidence": {"value": -12.5, "error": 0.1}, "prior_sensitivity": told}
    write_json(tmp_path / "a" / "summary.json", summary)
    result = compare([tmp_path / "a", tmp_path / "b"]).to_json()
    assert result["evidence"]["case IV"]["a"] == -12.5
    assert result["prior_sensitivity"]["a"] == {"IV": told}
    assert len(result["prior_sensitivity"]["b"]["IV"]) > 5


@pytest.mark.slow
def test_sums_over_different_cases_and_different_data_are_not_held_against_each_other(tmp_path, drawn):
    for name, (folder, _) in zip("ab", drawn.values(), strict=True):
        shutil.copytree(folder, tmp_path / name)
    summary = json.loads((tmp_path / "b" / "summary.json").read_text())
    row = {"shift": 0.25, "width": 0.9, "moves_most": "k2t", "shift_of_that": 0.1, "reliable": False}
    told = {"mu": {"prior_share": 0.9, "decided_by": "prior", "half": row | {"reliable": True}, "double": row}}
    more = {"log_evidence": {"value": -5.0}, "prior_sensitivity": told}
    (tmp_path / "b" / "I").mkdir()
    (tmp_path / "b" / "I" / "posterior.nc").write_bytes((tmp_path / "b" / "IV" / "posterior.nc").read_bytes())
    summary["cases"]["I"] = summary["cases"]["IV"] | more
    write_json(tmp_path / "b" / "summary.json", summary)
    text = compare([tmp_path / "a", tmp_path / "b"]).text()
    assert "Evidence is highest" not in text
    assert "The folders hold different cases" in text
    assert "case I: mu +0.25 / +0.25?" in text, "what rests on too few draws is marked, as the last sentence says"
    for name, checksum in (("a", "1"), ("b", "2")):
        summary = json.loads((tmp_path / name / "summary.json").read_text()) | {"campaign_sha256": checksum}
        write_json(tmp_path / name / "summary.json", summary)
    assert "different states of one campaign" in compare([tmp_path / "a", tmp_path / "b"]).text()


def test_bad_folders_are_all_named(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError) as caught:
        compare([tmp_path / "empty", tmp_path / "missing"])
    assert len(caught.value.faults) == 2
    assert "holds no results" in caught.value.faults[0]
    assert "there is no such folder" in caught.value.faults[1]
    with pytest.raises(InputError, match="two folders or more"):
        compare([tmp_path / "empty"])
    write_json(tmp_path / "empty" / "summary.json", {"schema": "something else"})
    with pytest.raises(InputError, match="named twice"):
        compare([tmp_path / "empty", tmp_path / "empty"])
    (tmp_path / "other").mkdir()
    write_json(tmp_path / "other" / "summary.json", {"schema": "something else"})
    with pytest.raises(InputError, match="its schema is 'something else'"):
        compare([tmp_path / "empty", tmp_path / "other"])


def test_the_published_cases_are_those_of_the_thesis():
    assert PublishedCases.default_plan()["cases"] == list(load_published().cases)


def test_values_have_the_digits_that_their_uncertainty_supports():
    assert _cell({"median": 1799.9634, "sd": 0.837, "unit": "N/m"}) == "1799.96 +- 0.84"
    assert _word(25599.234) == "25599.2"  # nats, of which differences count
    assert _word(0.012346) == "0.01235"
