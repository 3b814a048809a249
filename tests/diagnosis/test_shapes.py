"""Shapes of the site map: alike in every group of trials, and named where another file counts on their names."""

import numpy as np
import pytest
from small_rig import measured

from bayes_damper.calibration import Problem, calibrate
from bayes_damper.diagnosis.formula import LAWS
from bayes_damper.diagnosis.response import motions
from bayes_damper.diagnosis.shapes import Shape, dahl, relaxed, scale_of_motions, shapes_of
from bayes_damper.diagnosis.sites import _columns


@pytest.fixture(scope="module")
def made():
    """{coupled: (motion, its shapes)} of a campaign with both configurations."""
    moved = motions(calibrate(Problem(measured(repeats=2, duration=0.15)), anneal=False))
    scale = scale_of_motions(moved, peak=100.0)
    return {m.group.coupled: (m, list(shapes_of(m, scale, coupled_campaign=True))) for m in moved}


def test_every_group_of_trials_has_the_same_shapes_in_the_same_order(made):
    alone, both = ([(s.site, s.group) for s in made[coupled][1]] for coupled in (False, True))
    odd = next((pair for pair in zip(alone, both, strict=False) if pair[0] != pair[1]), (alone[-1], both[-1]))
    assert alone == both, (
        f"uncoupled trials have {len(alone)} shapes, coupled ones {len(both)}, from {odd[0]} and {odd[1]} on not the "
        "same: where a shape does not act, yield zeros"
    )


@pytest.mark.parametrize("coupled", [False, True])
def test_shapes_are_finite_and_as_large_as_the_motion(made, coupled):
    motion, shapes = made[coupled]
    torque, start, reading = motion.th1.shape, (motion.th1.shape[0], 4), motion.y.shape
    for shape in shapes:
        where = f"{shape.site}/{shape.group}"
        given = {"q1": torque, "q2": torque, "start": start, "reading": reading}
        arrays = {name: getattr(shape, name) for name in given if getattr(shape, name) is not None}
        assert arrays, f"{where}: it changes nothing; give q1, q2, start or reading"
        for name, array in arrays.items():
            assert array.shape == given[name], f"{where}: {name} is {array.shape}, and {given[name]} is asked for"
            assert np.isfinite(array).all(), f"{where}: {name} is not finite; scale by `Scale`, which is never 0"
        assert shape.reading is None or shape.site == "sensor", f"{where}: only a sensor changes readings"


def test_shapes_with_a_memory_follow_their_equations(made):
    motion = made[True][0]
    rate, tau, breakaway = motion.w1, 0.02, 0.01
    h = np.diff(motion.grid)
    spring, hysteresis = np.zeros_like(rate), np.zeros_like(rate)
    for i in range(h.size):
        keep = np.exp(-h[i] / tau)
        mean = 0.5 * (rate[:, i] + rate[:, i + 1])
        spring[:, i + 1] = keep * spring[:, i] + tau * (1.0 - keep) * mean
        moved = motion.th1[:, i + 1] - motion.th1[:, i]
        aim = np.sign(moved)
        hysteresis[:, i + 1] = aim + (hysteresis[:, i] - aim) * np.exp(-np.abs(moved) / breakaway)
    for found, wanted in ((relaxed(motion, rate, tau), spring), (dahl(motion.th1, breakaway), hysteresis)):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())


def test_what_is_silent_on_uncoupled_trials_is_left_out_and_changes_nothing(made, monkeypatch):
    motion, shapes = made[False]
    silent = np.array([s.silent for s in shapes])
    assert silent.any()
    assert not silent.all()
    fit = calibrate(Problem(measured(repeats=2, duration=0.15)), anneal=False)
    found = _columns(fit, motion, shapes)
    monkeypatch.setattr(Shape, "silent", property(lambda _: False))
    every = _columns(fit, motion, shapes)
    np.testing.assert_array_equal(found, every)
    assert not every[:, silent].any()


def test_what_stands_for_another_formula_is_a_group_of_shapes(made):
    groups = {(s.site, s.group) for s in made[True][1]}
    missing = {(site, group) for site, laws in LAWS.items() for group in laws} - groups
    assert not missing, f"LAWS in diagnosis/formula.py names {sorted(missing)}, which shapes.py does not make"


def test_a_campaign_without_the_second_body_has_no_shape_of_it(made):
    motion, _ = made[False]
    shapes = list(shapes_of(motion, scale_of_motions([motion]), coupled_campaign=False))
    assert {s.site for s in shapes} == {"ground1", "bearings", "release", "sensor"}
    assert not [s.group for s in shapes if s.group.endswith("2")]
