"""Counts and p values in sentences."""

import re
from pathlib import Path

import pytest

from bayes_damper.commands.check import Check
from bayes_damper.commands.diagnose import Diagnosed, next_steps
from bayes_damper.text import (
    begins_with_budget,
    budget_sentence,
    counted,
    failed_sentence,
    gap_beside_verdict,
    gathered,
    left_beside,
    p_value,
    places_of_rest,
    share_of_gap,
    warning_lines,
)


@pytest.mark.parametrize(
    ("n", "words", "told"),
    [
        (1, ("case",), "1 case"),
        (0, ("case",), "0 cases"),
        (3, ("trial",), "3 trials"),
        (2, ("frequency", "frequencies"), "2 frequencies"),
    ],
)
def test_one_of_a_kind_stands_in_the_singular(n, words, told):
    assert counted(n, *words) == told


@pytest.mark.parametrize(
    ("p", "told"), [(0.0, "p below 1e-12"), (2.2e-221, "p below 1e-12"), (3.14e-5, "p = 3.1e-05"), (0.25, "p = 0.25")]
)
def test_a_p_value_has_no_digits_where_they_mean_nothing(p, told):
    assert p_value(p) == told


@pytest.mark.parametrize(
    ("verdict", "gap", "told"),
    [
        ("none", {"answer": "gap", "p_value": 0.03, "size": 0.05}, "one faultless rig in 20"),
        ("none", {"answer": "gap", "p_value": 1e-30, "size": 0.05}, "p below 1e-12"),
        ("stick_slip", {"answer": "none", "p_value": 0.4, "augmented_rms": 1.0}, "rests on all trials together"),
        ("unknown", {"answer": "cannot tell", "p_value": 1.0, "augmented_rms": None}, "No trial could be held out"),
        # Nothing could be added (unknown), though trials were held out.
        ("unknown", {"answer": "cannot tell", "p_value": 0.2, "augmented_rms": None, "closed": None,
                     "upper_rms_over_noise": 0.4}, "held-out trials alone does not show the gap (p = 0.2)"),
        ("unknown", {"answer": "cannot tell", "p_value": 1.0, "augmented_rms": None, "closed": None,
                     "upper_rms_over_noise": 0.4}, "held-out trials alone does not show the gap"),
        ("unknown", {"answer": "cannot tell", "p_value": 0.11, "augmented_rms": 0.06, "why": "they are 12 times it"},
         "alone does not decide (p = 0.11): they are 12 times it. The answer rests on all trials together"),
        ("none", {"answer": "none", "p_value": 0.4}, ""),
        ("stick_slip", {"answer": "gap", "p_value": 0.0}, ""),
    ],
)  # fmt: skip
def test_a_verdict_that_the_test_of_the_gap_does_not_share_is_explained(verdict, gap, told):
    sentence = gap_beside_verdict(verdict, 0.7, gap)
    assert told in sentence
    assert bool(sentence) is bool(told)


def test_more_trials_are_not_asked_for_where_own_values_of_trials_hide_a_gap():
    gap = {"answer": "cannot tell", "p_value": 0.4, "upper_rms_over_noise": 0.4, "why": "measure the angles"}
    assert "More trials" in gap_beside_verdict("unknown", 0.7, gap)
    blind = gap_beside_verdict("unknown", 0.7, gap | {"taken_up": {"theta0": -9.0}})
    assert blind.endswith("measure the angles. The answer rests on all trials together.")


def test_what_is_said_of_three_records_is_said_once():
    late = [f"trials/A_{i}.csv: motion begins {t} s after the release; it stuck" for i, t in ((1, 0.001), (2, 0.002))]
    steps = [f"trials/A_{i}.csv, column 'theta1_rad': quantised in steps of 0.1" for i in (1, 2, 3, 4)]
    twins = [f"trials/A_{i}.csv: holds the same readings as trials/A_{i + 1}.csv" for i in (1, 2, 3)]
    told = ["Friction was not given.", *late, *steps, *twins]
    assert gathered(told) == [
        "Friction was not given.",
        *late,
        "trials/A_1.csv and 3 others, column 'theta1_rad': quantised in steps of 0.1",
        *twins,
    ]
    assert gathered([*late, late[0].replace("A_1", "A_3")]) == [
        "trials/A_1.csv and 2 others: motion begins 0.001 s after the release; it stuck (numbers of the first)"
    ]
    tops = [
        f"trials/A_{i}.csv, column 'x1_m': flat tops at {level}; it looks clipped there"
        for i in (1, 2, 3)
        for level in (-1.5, 1.5)
    ]
    assert gathered(tops) == [f"trials/A_1.csv and 2 others{tops[0][len('trials/A_1.csv') :]} (numbers of the first)"]
    assert gathered(tops[:4]) == tops[:4]


def test_a_fault_of_many_lines_is_said_once_with_their_numbers():
    free = [f"trials.csv, line {i}, theta0_mm: it is empty; fill it in" for i in range(2, 14)]
    cells = [f"trials/A_1.csv, line {i}, column 'x1_m': the cell is empty" for i in (5, 7, 30)]
    other = [f"trials/A_{i}.csv, line 5, column 'x1_m': the cell is empty" for i in (2, 3, 4)]
    assert gathered([*free, *cells]) == [
        "trials.csv, lines 2 to 13, theta0_mm: it is empty; fill it in",
        "trials/A_1.csv, lines 5, 7, 30, column 'x1_m': the cell is empty",
    ]
    assert gathered([*free[:2], *cells[:2], *other]) == [*free[:2], *cells[:2], *other]  # their lines are to be found
    many = [f"trials.csv, line {2 * i}: it is empty; fill it in" for i in range(1, 41)]
    assert gathered(many) == [
        "trials.csv, lines 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24 and 28 more: it is empty; fill it in"
    ]


def test_what_check_lists_is_counted_and_what_a_command_adds_is_said():
    late = [f"trials/A_{i}.csv: motion begins late" for i in (1, 2, 3)]
    assert warning_lines(["The law ends at 1 m."]) == ["warning: The law ends at 1 m."]
    assert warning_lines([*late, "Friction was not given.", "The law ends at 1 m."], 4) == [
        "warning: The law ends at 1 m.",
        "`bayes-damper check` lists 2 warnings about these trials; they hold here too.",
    ]
    assert warning_lines([]) == []


@pytest.mark.parametrize(("share", "begins"), [(0.5, "Most probable, but not sure: a gap"), (0.96, "There is a gap")])
def test_an_unknown_cause_is_told_at_a_place_and_as_surely_as_it_is_known(tmp_path, share, begins):
    """Where nothing may be missing too, "none" is the most probable place, and no place for a cause."""
    result = {
        "where": {},
        "verdict": "unknown",
        "probabilities": {"unknown": share, "none": 1.0 - share},
        "sites": {"none": 1.0 - share, "sensor": 0.3, "ground1": 0.2},
        "gap": {"answer": "gap", "p_value": 0.01, "nominal_rms": 2.0, "augmented_rms": None, "noise_rms": 1.0},
        "indistinguishable": [],
    }
    first = Diagnosed(tmp_path, result).text().splitlines()[0]
    assert first.startswith(begins)
    assert first.endswith("most likely place: sensor.")
    result["gap"]["augmented_rms"] = 1.2
    result["effects"] = [{"name": "quadratic_drag", "augmented_rms": 1.2}]
    beside = result | {"budget": divided({"stick_slip": 0.7}, 0.3)}
    said = Diagnosed(tmp_path, beside).text()
    assert "the most likely place of what stick slip leaves of it: bearings." in said
    said = Diagnosed(tmp_path, result).text()
    assert "2 with the nominal model, 1.2 with quadratic_drag (no explanation of the gap) added; noise 1." in said
    assert "with the answer" not in said
    result["gap"]["closed"] = {"median": 0.867}
    said = Diagnosed(tmp_path, result).text()
    assert "quadratic_drag (not the answer, though it closes 87 % of the gap there) added" in said


PROPOSED = {"configuration": "uncoupled", "k1_n_per_m": 500.0, "theta0_mm": 40.0}
MORE = "Next, to decide: measure one more uncoupled trial, k1 500 N/m, released at 40 mm, add it to the campaign"


@pytest.mark.parametrize(
    ("verdict", "share", "steps"),
    [
        (
            "spring_cubic",
            0.97,
            ["Next: bayes-damper fit 'my cart' --effect spring_cubic --out results/fit-spring_cubic"],
        ),
        ("spring_cubic", 0.6, [MORE, "If you take this answer: bayes-damper fit 'my cart' --effect spring_cubic"]),
        (
            "spring_cubic+release_offset",
            0.97,
            ["Next: bayes-damper fit 'my cart' --effect spring_cubic --effect release_offset --out results/fit-spring"],
        ),
        ("bearing_drag+quadratic_drag", 0.97, ["Next: bayes-damper fit 'my cart' --effect quadratic_drag --out"]),
        ("none", 0.95, ["Next: bayes-damper fit 'my cart' --out results/fit"]),
        ("none", 0.7, [MORE, "If you take this answer: bayes-damper fit 'my cart' --out"]),
        ("unknown", 0.96, ["Next: look at sensor on the rig, and at missing_torque.csv; --effects"]),
        ("unknown, no estimate", 0.96, ["Next: look at sensor on the rig; --effects DIR adds your own effect."]),
    ],
)
def test_a_diagnosis_ends_with_what_to_do(verdict, share, steps):
    verdict, none, _ = verdict.partition(", no estimate")
    both, verdict = verdict.split("+"), verdict.partition("+")[0]
    result = {
        "pair": {"effects": both, "probability": 0.9} if len(both) > 1 else None,
        "site_map": {"curve": {} if none else {"angle": {}}},
        "where": {}, "verdict": verdict, "probabilities": {verdict: share}, "next_experiment": [PROPOSED],
        "credible_set": [verdict], "sites": {"none": 0.5, "sensor": 0.3, "ground1": 0.2},
    }  # fmt: skip
    found = next_steps(result, "my cart")
    assert len(found) == len(steps)
    assert all(line.startswith(begins) for line, begins in zip(found, steps, strict=True))
    result |= {"verdict": "own_spring", "probabilities": {"own_spring": 0.97}, "pair": None}
    asked = next_steps(result, "cart", own="my effects")[-1]
    assert "fit cart --effects 'my effects' --effect own_spring --out" in asked
    assert len(both) == 1 or found[-1].endswith(f" --out results/fit-{'+'.join(both)}")


def divided(shares, left, present=0.96):
    def share(x):
        return {"median": x, "hdi90": None if x is None else [x, x]}

    effects = [{"name": n, "present": present, "share": share(x)} for n, x in shares.items()]
    return {"effects": effects, "unexplained": {"share": share(left), "sites": {"bearings": 0.7, "sensor": 0.3}}}


def test_the_gap_by_effects_is_one_sentence():
    assert budget_sentence(divided({"bearing_drag": 0.714, "quadratic_drag": 0.18}, 0.106)) == (
        "Bearing drag (probability 0.96) closes 71 % of the gap, quadratic drag (probability 0.96) 18 %; 11 % stays "
        "unexplained, most "
        "likely at the bearings."
    )
    whole = budget_sentence(divided({"stick_slip": 1.0}, 0.0, 0.999))
    assert whole == "Stick slip (probability >0.99) closes 100 % of the gap; nothing stays unexplained."
    assert budget_sentence(divided({"release_offset": 0.998, "spring_cubic": 0.002}, 0.0)).endswith(
        "spring cubic (probability 0.96) less than 1 %; nothing stays unexplained."
    )
    assert "too faint to give shares" in budget_sentence(divided({"stick_slip": None}, None))
    told = budget_sentence(divided({"stick_slip": None}, None), held_out=False)
    assert told == "Stick slip (probability 0.96) is present; no trial is held out to test that."
    assert budget_sentence(divided({"stick_slip": 0.9}, 0.1, 0.4)) == budget_sentence(None) == ""


def test_what_stays_unexplained_has_one_place():
    """The gap of the nominal model may lie elsewhere than what effects that are present leave of it."""
    sites = {"ground1": 0.6, "bearings": 0.3, "none": 0.1}
    assert places_of_rest(sites, divided({"bearing_drag": 0.7}, 0.3)) == {"bearings": 0.7, "sensor": 0.3}
    alone = {"ground1": 0.6, "bearings": 0.3}
    assert places_of_rest(sites, divided({"bearing_drag": 0.7}, 0.3, 0.4)) == places_of_rest(sites, None) == alone


def test_whose_place_is_given_is_said_where_effects_are_present():
    assert left_beside(divided({"bearing_drag": 0.7}, 0.3)) == " of what bearing drag leaves of it"
    both = divided({"bearing_drag": 0.5, "stick_slip": 0.2}, 0.3)
    assert left_beside(both) == " of what bearing drag and stick slip leave of it"
    assert left_beside(None) == left_beside(divided({"bearing_drag": 0.7}, 0.3, 0.4)) == ""


@pytest.mark.parametrize(
    ("verdict", "held_out", "leads"),
    [("unknown", False, False), ("unknown", True, True), ("stick_slip", False, True), ("none", True, False)],
)
def test_an_unknown_answer_does_not_begin_with_an_effect_that_no_trial_tests(verdict, held_out, leads):
    """ "Drag ... (probability 0.80) is present" had stood above `unknown` 97 %."""
    assert begins_with_budget(verdict, held_out) is leads


def test_no_share_of_a_gap_is_below_none_or_above_all_of_it():
    """An effect with which held-out trials are missed 326 times as far was said to close -10605972 % of the gap."""
    worse = divided({"spring_bottoming": -106059.72}, 106060.72, 0.78)
    assert budget_sentence(worse) == (
        "100 % of the gap stays unexplained, most likely at the bearings; spring bottoming (probability 0.78) closes "
        "nothing of it."
    )
    both = budget_sentence(divided({"spring_cubic": -0.3, "bearing_drag": 0.9}, 0.4))
    assert both.startswith(
        "Bearing drag (probability 0.96) closes 90 % of the gap, spring cubic (probability 0.96) nothing; 40 % stays"
    )
    absent = {"absent": [*worse["effects"], {"name": "stick_slip", "present": 0.1, "share": {"median": -0.02}}]}
    assert failed_sentence(absent) == (
        "Fitted, but rejected, because they do not reduce the gap on held-out trials: spring bottoming (error 3.3e+02 "
        "times as large); stick slip."
    )
    assert failed_sentence(None) == failed_sentence({"absent": []}) == ""
    shown = [share_of_gap(x) for x in (-106059.72, -0.4, -0.001, 0.714, 106060.72)]
    assert shown == ["below -100", "-40", "0", "71", "above 200"]


OLD_WORDS = ("told", "tells", "telling", "oddities")


def test_the_package_shows_reports_and_gives_and_does_not_tell():
    root = Path(__file__).parent.parent / "bayes_damper"
    found = {
        f"{path.relative_to(root).as_posix()}: {line.strip()}"
        for path in [*root.rglob("*.py"), *root.rglob("*.j2"), *root.rglob("*.js")]
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(rf"\b(?:{'|'.join(OLD_WORDS)})\b", line)
    }
    assert not found, "say shows, reports, gives, distinguishes: see Style in CONTRIBUTING.md"


def test_print_shows_a_result_as_the_command_line_does():
    found = Check("rig", "4 trials", (), "0")
    assert str(found) == found.text()
    assert (
        len(repr(Diagnosed(Path("results/diagnose"), {"probabilities": dict.fromkeys(map(str, range(999)), 0.0)})))
        < 200
    )
