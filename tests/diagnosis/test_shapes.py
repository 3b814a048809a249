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
    scale = scale_of_motions(moved, peak=100.0, released=True)
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


def test_no_shape_is_nothing_everywhere(made):
    for alone, both in zip(made[False][1], made[True][1], strict=True):
        if alone.group in (
            "place",
            "touch",
            "tap",
        ):  # one of them for each place or instant, where a motion need not come
            continue
        given = [a for s in (alone, both) for a in (s.q1, s.q2, s.start, s.reading) if a is not None]
        assert any(np.any(a) for a in given), f"{alone.site}/{alone.group}: a column is 0 in every trial"


OWN_LAWS = {
    ("ground1", "spring"): [lambda m: m.th1**3],
    ("ground1", "drift"): [lambda m: m.th1 * m.grid],
    ("bearings", "drag"): [lambda m: m.w1 * np.abs(m.w1)],
    ("interface", "damping"): [lambda m: (m.w1 - m.w2) * np.abs(m.w1 - m.w2)],
    ("interface", "magnet"): [lambda m: (m.th1 - m.th2) ** 3],
    ("ground2", "weight"): [lambda m: m.th2**2],
    ("ground2", "inertia"): [lambda m: m.a2],
}
"""Formulas of torques, written out once more; a new shape is one line here, which fails without it."""


@pytest.mark.parametrize("place", OWN_LAWS, ids="/".join)
def test_a_shape_is_its_formula(made, place):
    motion, shapes = made[True]
    given = [s.q1 if s.q1 is not None and np.any(s.q1) else s.q2 for s in shapes if (s.site, s.group) == place]
    assert given, f"no shape is in the group {'/'.join(place)}"
    for law in OWN_LAWS[place]:
        wanted = law(motion).ravel()
        alike = [abs(a.ravel() @ wanted) / np.linalg.norm(a) / np.linalg.norm(wanted) for a in given]
        assert max(alike) > 1.0 - 1e-9, f"{'/'.join(place)}: no column is proportional to the formula"


def test_touches_share_out_the_first_periods_after_the_first_quarter(made):
    motion, shapes = made[True]
    period = 2.0 * np.pi * np.median(motion.th1.std(axis=1) / motion.w1.std(axis=1))
    touches, taps = ([s.q1 for s in shapes if (s.site, s.group) == ("release", of)] for of in ("touch", "tap"))
    assert len(touches) == 22  # a twelfth of a period apart, from a quarter of one to two
    assert len(taps) == 19  # half of that, from half a period to 1.25
    for some, first, last in ((touches, 0.25, 2.0), (taps, 0.5, 1.25)):
        total = np.sum(some, axis=0) / (motion.k1t * motion.theta0)[:, None]
        inside = (motion.since[0] > (first + 0.05) * period) & (motion.since[0] < (last - 0.05) * period)
        np.testing.assert_allclose(total[:, inside], np.full_like(total[:, inside], total[0, inside][-1]), rtol=1e-9)
        assert not total[:, motion.since[0] < (first - 0.1) * period].any()


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
