"""Whole trials under a wrong name: found from the records, told with what they look like, left out; repeats are not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_rig import measured

from bayes_damper.calibration import Experiment, TrialRecord
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.outliers import odd_in_words, odd_trials, outlying, without_trials
from bayes_damper.effects import EFFECTS
from bayes_damper.simulation.model import Model


def place(experiment: Experiment, case: str, coupled: bool, number: int) -> int:
    """Index of a trial."""
    wanted = (case, coupled, number)
    return next(i for i, t in enumerate(experiment.trials) if (t.case, t.coupled, t.number) == wanted)


def with_records(experiment: Experiment, records: dict[int, np.ndarray]) -> Experiment:
    trials = [replace(t, y=records.get(i, t.y)) for i, t in enumerate(experiment.trials)]
    return replace(experiment, trials=tuple(trials))


def exchanged(seed: int = 1, noise: float = 2.0) -> tuple[Experiment, int, int]:
    """Two coupled records of different springs, each filed as the other."""
    e = measured(seed, noise=noise)
    i, j = place(e, "I", True, 2), place(e, "IV", True, 3)
    return with_records(e, {i: e.trials[j].y, j: e.trials[i].y}), i, j


@pytest.mark.parametrize("noise", [0.1, 2.0, 8.0])
def test_two_records_filed_as_each_other_are_found_and_told(noise):
    e, i, j = exchanged(noise=noise)
    found = odd_trials(e)
    assert {o.trial for o in found} == {i, j}
    sentences = odd_in_words(e, found)
    assert any(e.trials[i].label in s and "case IV coupled" in s for s in sentences)
    assert any(e.trials[j].label in s and "case I coupled" in s for s in sentences)


def test_the_trial_left_out_is_replaced_as_held_out_one():
    e, i, j = exchanged()
    clean = without_trials(e, odd_trials(e))
    assert len(clean.trials) == len(e.trials) - 2
    assert all(t.label not in (e.trials[i].label, e.trials[j].label) for t in clean.trials)
    for case in ("I", "IV"):
        held = [t for t in clean.trials if t.heldout and t.coupled and t.case == case]
        assert len(held) == 1


def test_exchanged_channels_of_one_trial_are_told():
    e = measured(3)
    i = place(e, "I", True, 1)
    found = odd_trials(with_records(e, {i: e.trials[i].y[::-1]}))
    assert [o.trial for o in found] == [i]
    assert "channels exchanged" in odd_in_words(e, found)[0]


def test_a_record_of_an_unknown_rig_is_told_without_a_likeness():
    e = measured(4)
    i = place(e, "IV", False, 1)
    t = e.trials[i]
    found = odd_trials(with_records(e, {i: np.array([np.interp(0.8 * t.times, t.times, r) for r in t.y])}))
    assert [o.trial for o in found] == [i]
    assert "another spring, case or rig?" in odd_in_words(e, found)[0]


@pytest.mark.parametrize("noise", [0.1, 2.0, 30.0])
def test_repeats_that_differ_as_repeats_do_are_none(noise):
    """Release angles that scatter, one of them by 10 %, one late trigger, and noise as large as the motion."""
    e = measured(5, noise=noise)
    larger, late = place(e, "I", True, 1), place(e, "IV", True, 2)
    y = np.concatenate([e.trials[late].y[:, :1]] * 4 + [e.trials[late].y[:, :-4]], axis=1)
    assert odd_trials(with_records(e, {larger: 1.1 * e.trials[larger].y, late: y})) == []


@pytest.mark.parametrize("cut", [False, True])
def test_readings_that_are_missing_make_no_trial_odd(cut):
    """A gap of a third of a period and an early end, as readings left out or as none known there."""
    e = measured(7)
    i = place(e, "I", True, 3)
    t = e.trials[i]
    lost = ((t.times > 0.03) & (t.times < 0.07)) | (t.times > 0.7 * t.times[-1])
    short = replace(t, times=t.times[~lost], y=t.y[:, ~lost]) if cut else replace(t, y=np.where(lost, np.nan, t.y))
    assert odd_trials(replace(e, trials=(*e.trials[:i], short, *e.trials[i + 1 :]))) == []
    exchanged = replace(short, y=short.y[::-1])
    assert [o.trial for o in odd_trials(replace(e, trials=(*e.trials[:i], exchanged, *e.trials[i + 1 :])))] == [i]


def test_of_two_repeats_none_is_called_the_odd_one():
    e = measured(6, repeats=2)
    i = place(e, "I", True, 1)
    assert odd_trials(with_records(e, {i: e.trials[i].y[::-1]})) == []


@pytest.mark.slow
def test_the_diagnosis_leaves_such_records_out_and_finds_no_gap():
    e, _, _ = exchanged()
    few = {name: EFFECTS[name] for name in ("spring_cubic", "sensor_gain", "quadratic_drag")}
    found = diagnose(e, effects=few)
    assert found.verdict == "none"
    assert sum("differs from its repeats" in note for note in found.notes) == 2


def let_go_slowly(which: tuple[int, ...]) -> SimpleNamespace:
    """A fit of two cases of five repeats; in those trials the acceleration is read when half the way is let go."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 3.0, 0.01)
    motion = np.stack([-np.cos(6.0 * t), 0.1 * np.sin(6.0 * t)])
    trials, residuals = [], {}
    for i in range(10):
        noise = 0.01 * rng.standard_normal(motion.shape)
        noise[0, 0] += 0.5 if i in which else 0.0
        residuals[i] = noise
        trials.append(TrialRecord(str(i), "I" if i < 5 else "II", True, i, t, motion + noise, 0, 0.03))
    experiment = Experiment({"J1": (1.0, 0.0)}, ((36.0, 0.0),), tuple(trials), quantity="acceleration")
    problem = SimpleNamespace(experiment=experiment, trials=tuple(range(10)))
    return SimpleNamespace(residuals=lambda: residuals, problem=problem)


def test_an_acceleration_read_during_one_release_is_left_out_and_a_slow_release_is_not():
    far = outlying(let_go_slowly((6,)))
    assert list(far) == [6]
    assert np.argwhere(far[6]).tolist() == [[0, 0]]
    assert outlying(let_go_slowly((2, 6))) == {}
    assert outlying(let_go_slowly(tuple(range(10)))) == {}
    beyond = let_go_slowly((6,))
    beyond.problem.experiment.trials[6].y[0, 0] = -1.5  # more than the whole way: nothing of a release
    beyond.residuals()[6][0, 0] = -0.5
    assert outlying(beyond) == {}


def rubbed(drags: tuple[float, ...], k1t: float = 6.2) -> Experiment:
    """Repeats that dry friction stops within ten swings, each with its own; the last one on a spring k1t, N m/rad."""
    times, rng = np.arange(0.0, 1.5, 2e-3), np.random.default_rng(6)
    rig = {"J1": 3e-3, "c1t": 2e-3, "nu": 100.0, "theta0": 0.1}
    springs = [6.2] * (len(drags) - 1) + [k1t]
    trials = []
    for number, (drag, k) in enumerate(zip(drags, springs, strict=True), 1):
        y = Model(False).simulate(rig | {"drag": drag, "k1t": k}, times, quantity="displacement").y[0]
        y += 1e-4 * rng.standard_normal(y.shape)
        trials.append(TrialRecord(str(number), "I", False, number, times, y, 0, 0.1, 1e-3))
    return Experiment({"J1": (3e-3, 0.0)}, ((6.2, 0.1),), tuple(trials), quantity="displacement")


@pytest.mark.parametrize("k1t", [6.2, 6.35])
def test_a_trial_whose_friction_and_spring_differ_as_those_of_one_rig_do_is_not_odd(k1t):
    """By 12 and 2 %: such a trial was left out, as one of another rig."""
    assert odd_trials(rubbed((0.02, 0.0201, 0.0176), k1t)) == []


def test_a_trial_of_another_spring_is_odd_whatever_its_friction():
    assert [o.trial for o in odd_trials(rubbed((0.02, 0.0201, 0.0176), 7.4))] == [2]
    assert [o.trial for o in odd_trials(rubbed((0.02, 0.0201, 0.05)))] == [2], "two and a half times the friction"
