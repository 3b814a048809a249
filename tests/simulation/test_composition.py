"""Two effects composed into one kernel, held against what their formulas say and against one of them alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_damper.effects import EFFECTS
from bayes_damper.simulation.composition import compose
from bayes_damper.simulation.model import Model

RIG = {
    "J1": 3.015e-3, "J2": 2.474e-3, "k1t": 8.2, "c1t": 0.02, "c3t": 0.01, "k2t": 1.5, "c2t": 0.08, "mu": 4e-3,
    "N0": 100.0, "R": 0.1, "r": 0.0127, "drag": 2e-3, "nu": 50.0, "theta0": 0.07,
}  # fmt: skip
TIMES = np.arange(0.0, 0.3, 1e-3)


def formula(effect, name=None):
    variants = EFFECTS[effect].variants
    return variants[0] if name is None else EFFECTS[effect].variant(name)


def values(variant, label, scale=1.0):
    start = variant.starts[0]
    null = variant.null or start
    return {
        f"{label}{p.name}": (n + scale * (s - n) if p.null is not None else s)
        for p, s, n in zip(variant.parameters, start, null, strict=True)
    }


def read(variant, effect, coupled=True, tolerance=0.01, **changes):
    model = Model(coupled, effect=variant)
    return model.simulate(RIG | changes, TIMES, effect=effect, tolerance=tolerance).y[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"),
    [("quadratic_drag", "magnet_cubic"), ("inertia_error", "quadratic_drag"), ("sensor_gain", "spring_cubic"),
     ("interface_relaxation", "coupling_backlash"), ("magnet_fade", "sensor_delay"),
     ("coupling_hysteresis", "bearing_stribeck")],
)  # fmt: skip
def test_with_one_effect_at_its_null_the_other_one_acts_alone(first, second):
    """In both places, so that parameters and memory find their way."""
    a, b = formula(first), formula(second)
    both = compose(a, b)
    if both is None:
        pytest.skip("the kernel has no room for this pair")
    off_a, off_b = values(a, "first.", 0.0), values(b, "second.", 0.0)
    alone = read(a, values(a, ""))
    assert np.allclose(read(both, values(a, "first.") | off_b), alone, rtol=0.0, atol=2e-5 * np.abs(alone).max())
    alone = read(b, values(b, ""))
    assert np.allclose(read(both, off_a | values(b, "second.")), alone, rtol=0.0, atol=2e-5 * np.abs(alone).max())


@pytest.mark.slow
def test_a_changed_constant_and_a_torque_act_together():
    """An error of J2 composed with a torque is the torque on a rig of that other J2, exactly."""
    a, b = formula("inertia_error"), formula("magnet_cubic")
    both = compose(a, b)
    assert both is not None
    known = values(a, "")
    changed = a.amend({k: np.atleast_1d(v) for k, v in RIG.items()}, {k: np.atleast_1d(v) for k, v in known.items()})
    expected = read(b, values(b, ""), J2=float(np.asarray(changed["J2"])[0]))
    found = read(both, values(a, "first.") | values(b, "second."))
    assert np.allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_in_the_uncoupled_rig_only_those_act_that_can():
    """A torque of the interface has nothing to act on there."""
    a, b = formula("magnet_cubic"), formula("quadratic_drag")
    both = compose(a, b, coupled=False)
    assert both is not None
    effect = values(a, "first.") | values(b, "second.")
    expected = read(b, values(b, ""), coupled=False)
    assert np.allclose(read(both, effect, coupled=False), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_what_the_kernel_has_no_room_for_is_not_composed():
    """Too many parameters or memory states, two sensors, two frictions."""
    lugre = formula("stick_slip", "lugre")
    assert compose(lugre, lugre) is None
    assert compose(lugre, formula("magnet_cubic")) is not None
    assert compose(formula("sensor_gain"), formula("sensor_highpass")) is None


def test_an_effect_that_changes_the_drag_changes_that_of_both_bearings():
    """Whatever their ratio is."""
    rougher = replace(formula("inertia_error"), amend=lambda rig, p: {**rig, "drag": rig["drag"] * (1.0 + p["error"])})
    rig = RIG | {"drag_ratio": 1.5}
    y = Model(effect=rougher).simulate(rig, TIMES, effect={"error": 1.0}).y
    np.testing.assert_array_equal(y, Model().simulate(rig | {"drag": 2.0 * RIG["drag"]}, TIMES).y)


def test_parameters_are_called_by_the_labels_and_find_their_functions_under_them():
    """Kernels are the same; what changes constants and what a trial's own release adds to know their parameters."""
    inertia, cubic, ramp = formula("inertia_error"), formula("spring_cubic"), formula("release_ramp")
    plain, named = compose(cubic, inertia), compose(cubic, inertia, labels=("spring_cubic", "inertia_error"))
    assert plain is not None
    assert named is not None
    assert [p.name for p in plain.parameters] == ["first.k3", "second.error"]
    assert [p.name for p in named.parameters] == ["spring_cubic.k3", "inertia_error.error"]
    assert [p.unit for p in named.parameters] == ["N m/rad^3", "1"]
    assert named.torque is plain.torque
    assert plain.formula == f"{cubic.formula}; {inertia.formula}"
    assert named.formula == f"spring_cubic: {cubic.formula}; inertia_error: {inertia.formula}"
    assert named.amend is not None
    assert named.amend({"J2": 2.0}, {"spring_cubic.k3": 1.0, "inertia_error.error": 0.5})["J2"] == 3.0
    released = compose(cubic, ramp, labels=("spring_cubic", "release_ramp"))
    assert released is not None
    assert released.lets_go == "release_ramp.time"
