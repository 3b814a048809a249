"""One list of checks for every variant of every effect, from the registry; then the registry itself."""

import inspect
import math
import os
import re
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import StateSpace, TransferFunction, lsim

from bayes_damper.effects import (
    EFFECTS,
    REFERENCE,
    Scales,
    all_effects,
    candidates,
    classes,
    faults,
    load_effects,
    scaled,
)
from bayes_damper.effects._filters import low_pass2, low_pass3
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import HalfNormal, LogNormal, LogUniform, Normal, Uniform
from bayes_damper.rig import equations
from bayes_damper.rig.equations import Rig
from bayes_damper.simulation.model import Model

PARAMETERS = {
    "J1": 3.015e-3, "J2": 2.474e-3, "J12": 0.0, "k1t": 10.2, "k3t": 0.0, "c1t": 0.01, "c3t": 0.008, "k2t": 1.3,
    "c2t": 0.02, "mu": 0.008, "N0": 100.0, "R": 0.1, "r": 0.0127, "drag": 0.012, "nu": 30.0, "tail": 0.0,
    "theta0": 0.11,
}  # fmt: skip
RIG = Rig(**PARAMETERS, slope=PARAMETERS["R"] / (2.0 * PARAMETERS["r"]))
VARIANTS = {f"{e.name}/{v.name}": (e, v) for e in EFFECTS.values() for v in e.variants}
every_variant = pytest.mark.parametrize(("effect", "variant"), VARIANTS.values(), ids=VARIANTS)
SECOND = {f"{e.name}/{v.name}" for e in EFFECTS.values() for v in e.variants[1:]}  # quick tests take the first of each


def of(condition):
    """Parametrises a test over the variants that meet a condition."""
    chosen = {name: pair for name, pair in VARIANTS.items() if condition(*pair)}
    return pytest.mark.parametrize(("effect", "variant"), chosen.values(), ids=chosen)


def simulated(condition=lambda e, v: True):
    """As `of`, for tests that compile a kernel for each variant (seconds): only the first of an effect is quick."""
    chosen = [
        pytest.param(*pair, id=name, marks=[pytest.mark.slow] * (name in SECOND))
        for name, pair in VARIANTS.items()
        if condition(*pair)
    ]
    return pytest.mark.parametrize(("effect", "variant"), chosen)


def padded(values):
    return (*values, 0.0, 0.0, 0.0, 0.0)[:4]


def at_rest(variant):
    """States of a variant's sensors before the first reading."""
    return (0.0,) * 2 * variant.sensor_states


def states(seed=1, n=12):
    """Random instants, angles, speeds and memories of the size that they have in a motion; the release first."""
    rng = np.random.default_rng(seed)
    size = np.array([0.1, 0.12, 0.12, 5.0, 5.0, 0.8, 0.8])
    drawn = [tuple(row) for row in rng.uniform([0, -1, -1, -1, -1, -1, -1], 1.0, (n, 7)) * size]
    return [(0.0, RIG.theta0, RIG.theta0, 0.0, 0.0, 0.0, 0.0), *drawn]


def named(variant, values):
    return {p.name: value for p, value in zip(variant.parameters, values, strict=True)}


# Each variant: what it declares


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_effect_meets_the_duties_of_an_author(effect):
    found = faults(effect)
    assert not found, "\n".join(found)
    assert effect.title, "title: what it is in a few words, e.g. 'drag that grows with the square of the speed'"
    unknown = set(effect.hides_behind) - set(equations.ROWS)
    assert effect.hides_behind, f"hides_behind: name one or more of {', '.join(equations.ROWS)}"
    assert not unknown, f"hides_behind: {sorted(unknown)} is none of {', '.join(equations.ROWS)}"
    one_sided = [other for other in effect.alike if effect.name not in EFFECTS[other].alike]
    assert not one_sided, f"alike holds both ways: write {effect.name!r} into alike of {one_sided} too"


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_file_of_effect_names_its_source_and_keeps_each_formula_short(effect):
    kernels = {
        k for v in effect.variants for k in (v.torque, v.rate, v.start, v.sense, v.lag, v.amend) if k is not None
    }
    module = sys.modules.get(f"bayes_damper.effects.{effect.name}")
    assert module, f"the file of an effect bears its name: bayes_damper/effects/{effect.name}.py"
    assert "Source:" in (module.__doc__ or ""), f"{module.__file__}: its first docstring needs a line `Source: ...`"
    for kernel in kernels:
        source = inspect.getsource(getattr(kernel, "py_func", kernel))
        body = [
            line for line in source.splitlines() if line.strip() and not line.strip().startswith(('"""', "@", "def"))
        ]
        assert len(body) <= 8, f"{len(body)} lines of formula, 8 at most: move parts that effects share to _shapes.py"
        wrong = re.search(r"\bmath\.|\bnp\.(?!asarray)|\bfor\b|\bwhile\b", source)
        assert not wrong, f"{wrong[0]}: no loops, math or numpy in a formula; use functions of rig/vector_math.py"


@every_variant
def test_priors_are_proper_and_their_scale_is_that_of_the_starts(effect, variant):
    for i, parameter in enumerate(variant.parameters):
        low, high = parameter.prior.ppf([1e-9, 1.0 - 1e-9])
        log = parameter.prior.coordinate == "log"
        grid = np.linspace(*(np.log([low, high]) if log else (low, high)), 200_001)
        x = np.exp(grid) if log else grid
        mass = np.trapezoid(np.exp(parameter.prior.logpdf(x)) * (x if log else 1.0), grid)
        assert mass == pytest.approx(1.0, abs=1e-5)
        assert all(low <= start[i] <= high for start in variant.starts)
        if not log:
            typical = np.abs(parameter.prior.ppf([0.1, 0.9])).max()
            largest = max(abs(start[i]) for start in variant.starts)
            told = "make one start larger, or the prior narrower"
            assert largest > 0.1 * typical, (
                f"{parameter.name}: the largest start, {largest:g}, is below a tenth of the prior's typical size, "
                f"{typical:g}: {told}"
            )


@of(lambda e, v: any(p.null == 0.0 and p.prior.support[0] < 0.0 for p in v.parameters))
def test_an_amplitude_of_either_sign_is_searched_on_both_sides(effect, variant):
    for i, parameter in enumerate(variant.parameters):
        if parameter.null == 0.0 and parameter.prior.support[0] < 0.0:
            found = [start[i] for start in variant.starts]
            assert min(found) < 0.0 < max(found), f"{parameter.name} takes either sign: add a start of the other one"


@of(lambda e, v: v.null is not None and any(p.null == 0.0 for p in v.parameters))
def test_one_start_lies_near_the_null(effect, variant):
    i = next(i for i, p in enumerate(variant.parameters) if p.null is not None)
    amplitudes = np.abs([start[i] for start in variant.starts])
    assert amplitudes.min() <= 0.2 * amplitudes.max(), (
        f"starts of {variant.parameters[i].name}: add one at a fifth of the largest or less, e.g. "
        f"{0.1 * amplitudes.max():g}, so that a search finds small effects"
    )


@of(lambda e, v: v.fades)
def test_starts_fade_towards_the_null_and_keep_their_shape(effect, variant):
    for start in variant.starts:
        for parameter, whole, half, gone in zip(
            variant.parameters, start, variant.faded(start, 0.5), variant.faded(start, 0.0), strict=True
        ):
            if parameter.null is None:
                assert half == gone == whole
            else:
                assert gone == parameter.null
                assert half == pytest.approx(0.5 * (whole + parameter.null), abs=1e-300)


def test_no_factor_leads_to_the_null_of_a_range_or_of_what_replaces_the_friction():
    rigid = {f"{e.name}/{v.name}" for e in EFFECTS.values() for v in e.variants if not v.fades}
    assert {"sensor_clipping/channel1", "stick_slip/bristle", "stick_slip/lugre"} <= rigid
    assert "stick_slip/gaussian" not in rigid


# Each variant: its formulas

kernels = of(lambda e, v: any(k is not None for k in (v.torque, v.rate, v.start, v.sense)))


@kernels
def test_compiled_and_plain_python_agree(effect, variant):
    rng = np.random.default_rng(2)
    for values in variant.starts:
        p = padded(values)
        for state in states():
            for hook in (variant.torque, variant.rate):
                if hook is not None:
                    plain = hook.py_func(*state, p, RIG)
                    np.testing.assert_allclose(hook(*state, p, RIG), plain, rtol=1e-9, atol=1e-12)
        if variant.start is not None:
            np.testing.assert_allclose(variant.start(p, RIG), variant.start.py_func(p, RIG), rtol=1e-13)
        if variant.sense is not None:
            for first in (1.0, 0.0):
                given = (0.0 if first else 3e-4, *rng.normal(0.0, 150.0, 4 + 2 * variant.sensor_states), p, first)
                np.testing.assert_allclose(variant.sense(*given), variant.sense.py_func(*given), rtol=1e-12)


@of(lambda e, v: v.torque is not None and v.null is not None)
def test_no_torque_at_the_null(effect, variant):
    p = padded(variant.null)
    z = (0.0, 0.0) if variant.start is None else variant.start.py_func(p, RIG)
    for state in states():
        if variant.memory:  # it must not leave zero, or it would still take part in the control of the step
            assert z == (0.0, 0.0)
            assert variant.rate.py_func(*state[:5], *z, p, RIG) == (0.0, 0.0)
        now = (*state[:5], *z) if variant.memory else state
        assert variant.torque.py_func(*now, p, RIG) == pytest.approx((0.0, 0.0), abs=1e-17)


@of(lambda e, v: v.torque is not None)
def test_torque_is_finite_in_extreme_states(effect, variant):
    extreme = [
        (1e3, 1.5, -1.5, 60.0, -60.0, 1.0, 1.0),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (1.0, 3.0, 3.0, 0.0, 9.0, -1.0, 0.0),
    ]
    corners = [variant.starts[0], *([variant.null] if variant.null else [])]
    corners += [tuple(float(p.prior.ppf(u)) for p in variant.parameters) for u in (1e-4, 0.5, 1.0 - 1e-4)]
    for values in corners:
        for state in extreme:
            assert np.isfinite(variant.torque.py_func(*state, padded(values), RIG)).all()


@of(lambda e, v: v.sense is not None and v.null is not None)
def test_sensors_show_what_there_is_at_the_null(effect, variant):
    p = padded(variant.null)
    s = at_rest(variant)
    rng = np.random.default_rng(3)
    readings = rng.normal(0.0, 100.0, (30, 2))
    before = np.zeros(2)
    for i, y in enumerate(readings):
        m1, m2, *s = variant.sense.py_func(0.0 if i == 0 else 2e-4, *before, *y, *s, p, float(i == 0))
        np.testing.assert_allclose((m1, m2), y, rtol=0.0, atol=1e-10)
        before = y


@of(lambda e, v: v.sense is not None)
def test_reading_the_sensor_again_at_once_changes_nothing(effect, variant):
    p = padded(variant.starts[-1])
    _, _, *s = variant.sense.py_func(0.0, 0.0, 0.0, 90.0, 60.0, *at_rest(variant), p, 1.0)
    once = variant.sense.py_func(4e-4, 90.0, 60.0, 80.0, 75.0, *s, p, 0.0)
    np.testing.assert_allclose(variant.sense.py_func(0.0, 80.0, 75.0, 80.0, 75.0, *once[2:], p, 0.0), once, rtol=1e-12)


@of(lambda e, v: v.torque is not None and v.couples == "bodies")
def test_torque_of_each_body_depends_on_that_body_alone(effect, variant):
    p = padded(variant.starts[-1])
    for t, th1, th2, w1, w2, z1, z2 in states():
        q1, q2 = variant.torque.py_func(t, th1, th2, w1, w2, z1, z2, p, RIG)
        told = "couples='bodies' is for Q1 on th1, w1 alone and Q2 on th2, w2 alone: leave it out (or correct the law)"
        assert variant.torque.py_func(t, th1, th2 + 0.03, w1, w2 - 0.7, z1, z2, p, RIG)[0] == q1, told
        assert variant.torque.py_func(t, th1 - 0.02, th2, w1 + 0.9, w2, z1, z2, p, RIG)[1] == q2, told


@of(lambda e, v: v.torque is not None and e.site == "interface")
def test_interface_torque_is_equal_and_opposite_and_relative(effect, variant):
    assert variant.couples == "interface", "an effect of the interface has couples='interface' in each variant"
    for values in variant.starts:
        p = padded(values)
        for t, th1, th2, w1, w2, z1, z2 in states():
            q1, q2 = variant.torque.py_func(t, th1, th2, w1, w2, z1, z2, p, RIG)
            assert q1 == -q2
            together = variant.torque.py_func(t, th1 + 0.5, th2 + 0.5, w1 + 2.0, w2 + 2.0, z1, z2, p, RIG)
            np.testing.assert_allclose(together, (q1, q2), rtol=1e-9, atol=1e-13)


@of(lambda e, v: v.torque is not None)
def test_a_variant_says_whether_it_depends_on_time(effect, variant):
    p = padded(variant.starts[-1])
    changes = [
        hook.py_func(0.0, *state[1:], p, RIG) != hook.py_func(0.004, *state[1:], p, RIG)
        for state in states()
        for hook in (variant.torque, variant.rate)
        if hook is not None
    ]
    told = "depends on t: write timed=True" if any(changes) else "does not depend on t: leave timed out"
    assert any(changes) == variant.timed, f"{effect.name}/{variant.name} {told}"


@of(lambda e, v: v.torque is not None)
def test_mirrored_motion_feels_mirrored_torque(effect, variant):
    mirrored = RIG._replace(theta0=-RIG.theta0)
    p = padded(variant.starts[-1])
    for t, *rest in states():
        back = variant.torque.py_func(t, *(-x for x in rest), p, mirrored)
        memory = effect.name == "magnet_fade"  # heat does not change its sign
        if memory:
            back = variant.torque.py_func(t, *(-x for x in rest[:4]), *rest[4:], p, mirrored)
        told = "the torque of the mirrored motion must be mirrored: write th1 * abs(th1), say, in place of th1 * th1"
        there = variant.torque.py_func(t, *rest, p, RIG)
        np.testing.assert_allclose(np.negative(back), there, rtol=1e-9, atol=1e-15, err_msg=told)


@of(
    lambda e, v: (
        v.torque is not None
        and (e.site == "bearings" or e.name == "interface_friction" or (e.name == "stick_slip" and v.memory == 0))
    )
)
def test_friction_never_feeds_energy_in(effect, variant):
    for values in variant.starts:
        for state in states(seed=4, n=40):
            q1, q2 = variant.torque.py_func(*state, padded(values), RIG)
            power = q1 * state[3] + q2 * state[4]
            assert power <= 0.0, (
                f"bearings and friction only take energy; at w1 = {state[3]:.3g}, w2 = {state[4]:.3g} rad/s this one "
                f"gives {power:.3g} W: check its signs"
            )


@of(
    lambda e, v: (
        e.name in ("friction_displacement", "normal_force_law", "magnet_fade", "eddy_overlap") and v.name != "whole"
    )
)
def test_what_is_taken_off_the_nominal_losses_never_exceeds_them(effect, variant):
    for values in variant.starts:
        for state in states(seed=5, n=40):
            _, th1, th2, w1, w2, z1, z2 = state
            q1, _ = variant.torque.py_func(0.0, th1, th2, w1, w2, abs(z1), z2, padded(values), RIG)
            slope = RIG.R / (2.0 * RIG.r)
            ratio = equations.normal_force_ratio.py_func(th1 - th2, slope)
            nominal = RIG.c2t * (w1 - w2) + RIG.mu * RIG.N0 * RIG.R * ratio * math.tanh(RIG.nu * (w1 - w2))
            assert (q1 - nominal) * (w1 - w2) <= 1e-12


# Limits and known results


def test_hysteresis_and_bristles_stay_bounded_and_dissipate_over_a_cycle():
    for effect, variant in VARIANTS.values():
        if variant.memory != 1 or effect.name not in ("coupling_hysteresis", "stick_slip"):
            continue
        p = padded(variant.starts[2])
        angle = lambda t: 0.1 * math.cos(40.0 * t)  # noqa: E731
        speed = lambda t: -4.0 * math.sin(40.0 * t)  # noqa: E731

        def rates(t, y, variant=variant, p=p, angle=angle, speed=speed):
            dz, _ = variant.rate.py_func(t, angle(t), 0.0, speed(t), 0.0, y[0], 0.0, p, RIG)
            q1, _ = variant.torque.py_func(t, angle(t), 0.0, speed(t), 0.0, y[0], 0.0, p, RIG)
            return [dz, -q1 * speed(t)]

        z0 = 0.0 if variant.start is None else variant.start.py_func(p, RIG._replace(theta0=0.1))[0]
        period = 2.0 * math.pi / 40.0
        solution = solve_ivp(
            rates, (0.0, 3.0 * period), [z0, 0.0], "LSODA", np.linspace(0, 3 * period, 300), rtol=1e-9, atol=1e-12
        )
        highest = {"dahl": p[0] / RIG.k1t, "bouc_wen": p[0] * p[1], "bristle": 1.0, "lugre": 1.0 + p[2]}[variant.name]
        assert np.abs(solution.y[0]).max() <= highest * (1.0 + 1e-5)
        assert solution.y[1][-1] > solution.y[1][199] > solution.y[1][99] > 0.0


def test_bristles_in_steady_sliding_give_the_nominal_friction():
    for name in ("bristle", "lugre"):
        variant = EFFECTS["stick_slip"].variant(name)
        p = padded((1e-4, 1e-4) if name == "bristle" else (1e-4, 1e-4, 0.4, 0.1))
        for v in (-3.0, 2.0):
            z = math.copysign(1.0, v)
            assert variant.rate.py_func(0.0, 0.05, 0.02, v, 0.0, z, 0.0, p, RIG)[0] == pytest.approx(0.0, abs=1e-9)
            expected = RIG.mu * RIG.N0 * RIG.R * (1.0 - RIG.R * 0.03 / (2.0 * RIG.r)) * math.tanh(1000.0 * v)
            assert variant.torque.py_func(0.0, 0.05, 0.02, v, 0.0, z, 0.0, p, RIG) == pytest.approx(
                (-expected, expected)
            )


def test_stiff_bristle_gives_the_record_of_the_nominal_rig_with_hard_friction():
    times = np.arange(0.0, 0.3, 1e-3)
    hard = PARAMETERS | {"nu": 2000.0}
    variant = EFFECTS["stick_slip"].variant("bristle")
    bristle = Model(effect=variant).simulate(
        hard, times, effect={"deflection": 2e-6, "damping": 1e-7}, quantity="velocity"
    )
    nominal = Model().simulate(hard, times, quantity="velocity")
    assert np.abs(bristle.y - nominal.y).max() < 5e-3 * np.abs(nominal.y).max()


def test_lens_law_is_the_common_area_of_two_circles():
    variant = EFFECTS["normal_force_law"].variant("lens")
    for x in np.linspace(0.0, 0.99, 34):
        phi = x * 2.0 * RIG.r / RIG.R
        q2 = variant.torque.py_func(0.0, phi, 0.0, 50.0, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), RIG)[1]
        area = 2.0 / math.pi * (math.acos(x) - x * math.sqrt(1.0 - x * x))
        assert q2 / (RIG.mu * RIG.N0 * RIG.R) + (1.0 - x) == pytest.approx(area, abs=1e-5)


def test_effects_of_the_friction_follow_the_law_of_the_pull():
    constant = RIG._replace(slope=0.0)
    full = RIG.mu * RIG.N0 * RIG.R
    apart = 2.5 * RIG.r / RIG.R  # the faces no longer overlap
    p = (0.5, 2.0, 0.5, 1.0)
    sliding = (0.0, apart, 0.0, 2.0, 0.0, 1.0, 0.0)

    def torque(effect, name, rig, p=p):
        return EFFECTS[effect].variant(name).torque.py_func(*sliding, p, rig)

    for effect in ("stick_slip", "misalignment_drag", "friction_displacement"):
        for variant in EFFECTS[effect].variants:
            if (effect, variant.name) == ("misalignment_drag", "constant"):
                continue
            assert torque(effect, variant.name, RIG)[0] == 0.0
            assert torque(effect, variant.name, constant)[0] != 0.0
    assert torque("misalignment_drag", "with_pull", constant) == torque("misalignment_drag", "constant", constant)
    # A pull that is wholly the effect's is the same whatever the rig's own law; full sharpness, so tanh is 1.
    whole = (1.0, 3.0, 0.0, 0.0)
    for name in ("lens", "bell"):
        for phi in (0.0, 0.1, apart):
            now = (0.0, phi, 0.0, 50.0, 0.0, 0.0, 0.0, whole)
            sums = []
            for rig in (RIG, constant):
                nominal = full * equations.normal_force_ratio.py_func(phi, rig.slope)
                sums.append(nominal + EFFECTS["normal_force_law"].variant(name).torque.py_func(*now, rig)[1])
            assert sums[0] == pytest.approx(sums[1], rel=1e-12)
    # Eddy currents know the overlap, not the pull.
    assert torque("eddy_overlap", "linear", RIG) == torque("eddy_overlap", "linear", constant)


def test_kernels_of_a_rig_with_constant_pull_know_it():
    share = {"share": 0.3}
    records = [
        Model(normal_force="constant", effect=EFFECTS["misalignment_drag"].variant(name)).simulate(
            PARAMETERS, TIMES, effect=share
        )
        for name in ("with_pull", "constant")
    ]
    assert np.abs(records[0].y - records[1].y).max() < 1e-6 * np.abs(records[0].y).max()
    assert np.abs(records[0].y - Model(normal_force="constant").simulate(PARAMETERS, TIMES).y).max() > 0.5


def test_winding_up_leaves_the_hysteresis_where_its_rate_takes_it():
    for variant in EFFECTS["coupling_hysteresis"].variants:
        p = padded((0.1, 0.03, 1.0))
        wound = solve_ivp(
            lambda t, z, variant=variant, p=p: [variant.rate.py_func(t, t, 0.0, 1.0, 0.0, z[0], 0.0, p, RIG)[0]],
            (0.0, RIG.theta0), [0.0], rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        assert variant.start.py_func(p, RIG)[0] == pytest.approx(wound.y[0, -1], rel=1e-5)


def test_low_pass_answers_a_ramp_exactly():
    tau, slope = 2e-3, 5e4
    variant = EFFECTS["sensor_bandwidth"].variant("both_settled")
    s = variant.sense.py_func(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (tau, 0.0, 0.0, 0.0), 1.0)[2:]
    t = 0.0
    for h in (1e-7, 3e-4, 1e-3, 2e-5):
        m1, m2, *s = variant.sense.py_func(h, slope * t, 0.0, slope * (t + h), 0.0, *s, (tau, 0.0, 0.0, 0.0), 0.0)
        t += h
        assert m1 == pytest.approx(slope * (t - tau * -math.expm1(-t / tau)), rel=1e-6)
        assert m2 == 0.0


@pytest.mark.parametrize("zeta", [0.5, 0.9999999, 1.0, 1.6])
def test_low_pass_of_second_order_answers_steps_and_ramps_exactly(zeta):
    tau, jump, slope, h = 2e-3, 70.0, -9e3, 3e-4
    sense = EFFECTS["sensor_bandwidth"].variant("two_poles").sense.py_func
    filtered = TransferFunction([1.0], [tau**2, 2.0 * zeta * tau, 1.0])
    times = np.arange(120) * h
    shown = lsim(filtered, jump + slope * times, times)[1]
    _, _, *s = sense(0.0, 0.0, -jump, jump, -jump, *(0.0,) * 4, (tau, zeta), 1.0)
    for t, m in zip(times[:-1], shown[1:], strict=True):
        m1, m2, *s = sense(h, jump + slope * t, -jump, jump + slope * (t + h), -jump, *s, (tau, zeta), 0.0)
        assert m1 == pytest.approx(m, abs=0.05)  # the reading jumps a microsecond before the first sample
        assert m2 == pytest.approx(-jump)  # at rest it has settled


@pytest.mark.parametrize("zeta", [0.5, 0.7235, 0.98, 1.0, 1.6])
@pytest.mark.parametrize("h", [1e-6, 3e-4, 5e-3])
def test_low_pass_of_third_order_answers_steps_and_ramps_exactly(zeta, h):
    tau, jump, slope = 2e-3, 70.0, -9e3
    sense = EFFECTS["sensor_bandwidth"].variant("three_poles").sense.py_func
    times = np.arange(120) * h
    s = -1.0 / tau
    k = np.array([[s, 0.0, 0.0], [0.0, 0.0, 1.0 / tau], [1.0 / tau, s, 2.0 * zeta * s]])  # of r, m, tau dm/dt
    filtered = StateSpace(k, [[-s], [0.0], [0.0]], [[0.0, 1.0, 0.0]], [[0.0]])
    shown = lsim(filtered, jump + slope * times, times)[1]
    m1, m2, *s = sense(0.0, 0.0, -jump, jump, -jump, *(0.0,) * 6, (tau, zeta), 1.0)
    for t, m in zip(times[:-1], shown[1:], strict=True):
        m1, m2, *s = sense(h, jump + slope * t, -jump, jump + slope * (t + h), -jump, *s, (tau, zeta), 0.0)
        assert m1 == pytest.approx(m, abs=0.05)  # the reading jumps a microsecond before the first sample
        assert m2 == pytest.approx(-jump)  # at rest it has settled


@pytest.mark.parametrize("zeta", [0.5, 0.9999999, 1.0, 1.6])
def test_high_pass_of_second_order_answers_steps_and_ramps_exactly(zeta):
    rate, jump, slope, h = 60.0, 70.0, -9e3, 3e-4
    sense = EFFECTS["sensor_highpass"].variant("two_poles").sense.py_func
    times = np.arange(400) * h
    filtered = TransferFunction([1.0, 0.0, 0.0], [1.0, 2.0 * zeta * rate, rate**2])
    shown = lsim(filtered, jump + slope * times, times)[1]
    m1, m2, *s = sense(0.0, 0.0, 0.0, jump, 0.0, *(0.0,) * 4, (rate, zeta), 1.0)
    assert (m1, m2) == (jump, 0.0)
    for t, m in zip(times[:-1], shown[1:], strict=True):
        m1, m2, *s = sense(h, jump + slope * t, 0.0, jump + slope * (t + h), 0.0, *s, (rate, zeta), 0.0)
        assert m1 == pytest.approx(m, abs=1e-8 * jump)
        assert m2 == 0.0


def test_filters_of_third_order_are_smooth_where_a_step_is_short():
    about = 1e-3 * (1.0 + np.array([-1e-9, 1e-9]))
    below, above = (low_pass3.py_func(x, 3.0, 5.0, 0.4, -2.0, 2.5, 1.0, 0.7) for x in about)
    assert above == pytest.approx(below, abs=1e-9)


def test_filters_of_second_order_are_smooth_where_a_step_is_short():
    about = 1e-5 * (1.0 + np.array([-1e-7, 1e-7]))
    below, above = (low_pass2.py_func(x, 3.0, 5.0, 0.4, -2.0, 1.0, 0.7) for x in about)
    np.testing.assert_allclose(below, above, rtol=1e-9)
    assert low_pass2.py_func(0.0, 3.0, 5.0, 0.4, -2.0, 1.0, 0.7) == (0.4, -2.0)


def test_release_ramp_holds_the_rig_at_first_and_then_lets_go():
    for variant in EFFECTS["release_ramp"].variants:
        holding = RIG.k1t * RIG.theta0
        q = [
            variant.torque.py_func(t, RIG.theta0, 0, 0, 0, 0, 0, padded((0.004, 1.5)), RIG)[0]
            for t in (0.0, 1e-3, 3e-3, 0.1)
        ]
        assert q[0] == pytest.approx(holding, rel=1e-3)
        assert q[0] > q[1] > q[2] > 0.0
        assert abs(q[3]) < 1e-9 * holding


# In the simulation

TIMES = np.arange(0.0, 0.25, 1e-3)


@simulated()
def test_effect_at_its_null_is_the_bare_rig(effect, variant):
    if variant.null is None:
        assert variant.replaces_friction
        return
    for coupled in (True, False) if variant.uncoupled and "coupled" not in effect.needs else (True,):
        bare = Model(coupled=coupled).simulate(PARAMETERS, TIMES)
        model = Model(coupled=coupled, effect=variant)
        record = model.simulate(PARAMETERS, TIMES, effect=named(variant, variant.null))
        assert (record.outcome == 0).all()
        assert np.abs(record.y - bare.y).max() <= 1e-12 * np.abs(bare.y).max()


def reference(variant, values, times):
    """Accelerations of the coupled rig by scipy at tight tolerances, from the plain Python formulas."""
    p = padded(values)
    parameters = PARAMETERS | {"theta2_0": PARAMETERS["theta0"]}
    if variant.amend is not None:
        parameters = dict(variant.amend(parameters, named(variant, values)))
    rig = Rig(**{name: float(parameters[name]) for name in PARAMETERS}, slope=RIG.slope)

    def forces(t, y):
        th1, th2, w1, w2 = y[:4]
        friction = 0.0 if variant.replaces_friction else rig.mu * rig.N0 * rig.R
        slope = rig.R / (2.0 * rig.r)
        phi, slip = th1 - th2, w1 - w2
        interface = rig.k2t * phi + rig.c2t * slip
        interface += friction * max(0.0, 1.0 - slope * abs(phi)) * math.tanh(rig.nu * slip)
        tau1 = -rig.c1t * w1 - rig.k1t * th1 - rig.drag * math.tanh(rig.nu * w1) - interface
        tau2 = -rig.c3t * w2 - rig.k3t * th2 - rig.drag * math.tanh(rig.nu * w2) + interface
        q1, q2 = (0.0, 0.0) if variant.torque is None else variant.torque.py_func(t, *y, p, rig)
        return (tau1 + q1) / rig.J1, (tau2 + q2) / rig.J2

    def rates(t, y):
        dz = (0.0, 0.0) if variant.rate is None else variant.rate.py_func(t, *y, p, rig)
        return [y[2], y[3], *forces(t, y), *dz]

    z = (0.0, 0.0) if variant.start is None else variant.start.py_func(p, rig)
    start = [rig.theta0, float(parameters["theta2_0"]), 0.0, 0.0, *z]
    solution = solve_ivp(rates, (0.0, times[-1]), start, "LSODA", times, rtol=1e-9, atol=1e-11, max_step=5e-4)
    assert solution.success
    return np.array([forces(t, y) for t, y in zip(times, solution.y.T, strict=True)]).T


@simulated(lambda e, v: v.lag is None)
def test_kernel_agrees_with_scipy_and_plain_python(effect, variant):
    values = variant.starts[min(1, len(variant.starts) - 1)]
    lag = 0
    if variant.sense is None:
        truth = reference(variant, values, TIMES)
    else:  # a sensor reads a motion that is known on a fine grid
        fine = np.arange(0.0, TIMES[-1] + 1e-9, 2e-5)
        motion = reference(variant, values, fine)
        s, before, shown = at_rest(variant), np.zeros(2), []
        for i, y in enumerate(motion.T):
            m1, m2, *s = variant.sense.py_func(0.0 if i == 0 else 2e-5, *before, *y, *s, padded(values), float(i == 0))
            shown.append((m1, m2))
            before = y
        truth = np.array(shown).T[:, ::50]
    record = Model(effect=variant).simulate(PARAMETERS, TIMES, effect=named(variant, values))
    assert (record.outcome == 0).all()
    error = np.abs(record.y[0] - truth)[:, lag:].max() / np.abs(truth).max()
    assert error < (1e-4 if variant.sense is None else 4e-4)


@simulated(lambda e, v: e.name == "sensor_delay")
def test_a_lag_shifts_one_channel_and_not_the_other(effect, variant):
    record = Model(effect=variant).simulate(PARAMETERS, TIMES, effect={"time": 3e-3}).y[0]
    bare = Model().simulate(PARAMETERS, TIMES).y[0]
    shifted = 0 if variant.name == "channel1" else 1
    np.testing.assert_allclose(record[1 - shifted], bare[1 - shifted], rtol=1e-12)
    early = variant.name == "channel2_early"
    late, soon = (bare[shifted], record[shifted]) if early else (record[shifted], bare[shifted])
    np.testing.assert_allclose(late[3:], soon[:-3], atol=1e-4 * np.abs(bare).max())
    assert early or (record[shifted, :3] == 0.0).all()


@simulated()
def test_every_start_changes_the_record(effect, variant):
    starts = np.array(variant.starts)
    record = Model(effect=variant).simulate(PARAMETERS, TIMES, effect=named(variant, starts.T))
    bare = Model().simulate(PARAMETERS, TIMES).y
    assert (record.outcome == 0).all()
    changed = np.sqrt(((record.y - bare) ** 2).mean((1, 2)))
    assert changed.max() > 1.0, (
        f"the largest start changes the record of this rig by {changed.max():.2g} rad/s^2 rms, more than 1 is asked "
        f"for: make starts, and the prior, {1.2 / max(changed.max(), 1e-12):.2g} times as large, so that it can be seen"
    )
    assert (changed > 0.0).mean() > 0.6, f"starts {starts[changed == 0.0].tolist()} change nothing: replace them"


# The registry


def test_library_holds_every_effect_of_the_contract():
    promised = {
        "spring_cubic": "ground1", "spring_bottoming": "ground1", "coupling_backlash": "ground1",
        "coupling_hysteresis": "ground1", "stiffness_error": "ground1", "bearing_stribeck": "bearings",
        "quadratic_drag": "bearings", "misalignment_drag": "bearings", "stick_slip": "interface",
        "friction_displacement": "interface", "magnet_cubic": "interface", "eddy_overlap": "interface",
        "magnet_fade": "interface", "interface_relaxation": "interface", "normal_force_law": "interface",
        "inertia_error": "ground2", "release_ramp": "release", "release_offset": "release", "sensor_gain": "sensor",
        "sensor_delay": "sensor", "sensor_bandwidth": "sensor", "sensor_highpass": "sensor",
        "sensor_clipping": "sensor", "bearing_drag": "bearings", "interface_friction": "interface",
    }  # fmt: skip
    assert promised.items() <= {name: effect.site for name, effect in EFFECTS.items()}.items()
    assert all(name == effect.name for name, effect in EFFECTS.items())


def test_only_effects_that_the_rig_can_have_are_offered():
    full = candidates(True)
    assert set(EFFECTS) - set(full) == {"bearing_drag", "interface_friction"}
    alone = candidates(False)
    assert not {e.site for e in alone.values()} & {"interface", "ground2"}
    assert all(v.uncoupled for e in alone.values() for v in e.variants)
    assert {"sensor_delay", "release_offset"}.isdisjoint(alone)
    magnetless = candidates(True, has_magnet=False)
    assert {"stick_slip", "misalignment_drag", "normal_force_law", "magnet_cubic"}.isdisjoint(magnetless)
    assert {"interface_relaxation", "release_offset"} <= set(magnetless)
    faceless = candidates(True, has_magnet=False, nominal="linear")["interface_friction"]
    assert [v.name for v in faceless.variants] == ["constant"]  # no faces whose overlap friction could follow
    assert set(candidates(True, rubs=False)) - set(full) == {"interface_friction"}
    linear = candidates(True, nominal="linear")
    assert {"bearing_drag", "interface_friction", "spring_cubic"} <= set(linear)
    assert {"bearing_stribeck", "stick_slip", "friction_displacement", "normal_force_law"}.isdisjoint(linear)
    assert [v.name for v in linear["misalignment_drag"].variants] == ["viscous"]


def test_a_free_start_knows_nothing_of_a_release():
    assert "release" in {e.site for e in candidates(True).values()}
    assert "release" not in {e.site for e in candidates(True, start="free").values()}
    hanging = set(candidates(True)) - set(candidates(True, restoring="pendulum"))
    assert hanging == {"coupling_backlash", "coupling_hysteresis"}  # a weight has neither play nor hysteresis


def test_classes_join_effects_that_agree_to_first_order():
    assert frozenset({"friction_displacement", "normal_force_law"}) in classes()
    assert len(set().union(*classes())) == sum(map(len, classes()))
    assert classes(candidates(False)) == []


def test_priors_follow_the_magnitudes_of_the_rig():
    pendulum = Scales(angle=1.0, time=1.0 / 5.5, torque=8.0, reading=20.0)
    for _, variant in VARIANTS.values():
        assert scaled(variant, REFERENCE) == variant
        other = scaled(variant, pendulum)
        for before, after in zip(variant.parameters, other.parameters, strict=True):
            if before.unit == "1":
                assert after == before
        assert all(
            np.isfinite(p.prior.logpdf(x)) for s in other.starts for p, x in zip(other.parameters, s, strict=True)
        )
    medians = {
        ("spring_cubic", "same_for_all"): Normal(0.0, 1.6), ("quadratic_drag", "alike"): HalfNormal(0.06),
        ("release_ramp", "linear"): HalfNormal(0.04), ("sensor_clipping", "both"): LogUniform(0.2, 2000.0),
    }  # fmt: skip
    for (effect, variant), expected in medians.items():
        found = scaled(EFFECTS[effect].variant(variant), pendulum).parameters[0].prior
        assert type(found) is type(expected)
        np.testing.assert_allclose(found.ppf([0.3, 0.8]), expected.ppf([0.3, 0.8]), rtol=1e-12, atol=1e-15)


OWN = '''
"""Cogging: a torque that is periodic in the relative angle. Source: none."""
from bayes_damper.priors.distributions import Normal
from bayes_damper.effects import Effect, EffectParameter, Variant
from bayes_damper.rig.vector_math import lane, sin

@lane
def torque(t, th1, th2, w1, w2, z1, z2, p, rig):
    q = p[0] * sin(90.0 * (th1 - th2))
    return -q, q

EFFECT = Effect(
    name="{name}", site="interface", summary="The poles cog as they pass.", looks_like="A ripple in both channels.",
    hides_behind=("k2t",), source="Made up for this test.", needs=("coupled",),
    variants=(Variant(name="sine", formula="Q1 = -a sin(90 phi)", torque=torque, couples="interface", uncoupled=False,
        starts=((0.01,), (-0.01,)), parameters=(EffectParameter("torque", "{unit}", "Cogging torque of the poles.",
        Normal(0.0, 0.02), "A fraction of the friction torque.", 0.0),)),),
)
'''


def written(folder, file, **changes):
    text = OWN
    for key, value in ({"name": "cogging", "unit": "N m"} | changes).items():
        text = text.replace("{" + key + "}", value)
    (folder / file).write_text(text, encoding="utf-8")


def test_an_effect_of_the_users_own_is_one_file(tmp_path):
    written(tmp_path, "cogging.py")
    effects = all_effects(tmp_path)
    assert set(effects) - set(EFFECTS) == {"cogging"}
    variant = candidates(True, effects=effects)["cogging"].variants[0]
    record = Model(effect=variant).simulate(PARAMETERS, TIMES, effect={"torque": np.array([0.0, 0.02])})
    bare = Model().simulate(PARAMETERS, TIMES).y[0]
    assert np.abs(record.y[0] - bare).max() <= 1e-12 * np.abs(bare).max()
    assert np.abs(record.y[1] - bare).max() > 1.0


def test_a_file_that_imports_from_where_modules_used_to_lie_goes_on_working(tmp_path):
    written(tmp_path, "cogging.py")
    file = tmp_path / "cogging.py"
    text = file.read_text(encoding="utf-8")
    former = {"rig.vector_math": "lanes", "priors.distributions": "distributions"}
    for new, old in former.items():
        text = text.replace(f"bayes_damper.{new}", f"bayes_damper.{old}")
    file.write_text(text, encoding="utf-8")
    assert "cogging" in all_effects(tmp_path)
    assert "bayes_damper.lanes" not in sys.modules  # for such files alone


def test_an_own_effect_without_a_small_start_gets_one(tmp_path):
    written(tmp_path, "cogging.py")
    assert all_effects(tmp_path)["cogging"].variants[0].starts == ((0.01,), (-0.01,), (pytest.approx(0.001),))


def test_all_faults_of_a_folder_are_told_at_once(tmp_path):
    written(tmp_path, "a.py", unit="furlong")
    written(tmp_path, "b.py", name="stick_slip")
    (tmp_path / "c.py").write_text("EFFECT = 3\n")
    (tmp_path / "d.py").write_text("import no_such_module_at_all\n")
    with pytest.raises(InputError) as caught:
        load_effects(tmp_path)
    told = caught.value.faults
    assert len(told) == 4
    for word, sentence in zip(("furlong", "already", "no EFFECT", "no_such_module_at_all"), told, strict=True):
        assert word in sentence
    for folder in (tmp_path / "nowhere", tmp_path):
        for file in tmp_path.glob("*.py"):
            file.unlink()
        with pytest.raises(InputError):
            load_effects(folder)


def test_faults_of_a_variant_are_found():
    effect = EFFECTS["spring_cubic"]
    variant = effect.variants[0]
    parameter = variant.parameters[0]
    broken = {
        "outside its prior": replace(variant, parameters=(replace(parameter, prior=Uniform(1.0, 200.0)),)),
        "lies outside the prior of k3": replace(
            variant, parameters=(replace(parameter, prior=LogNormal(1.0, 2.0), null=None),)
        ),
        "sentence": replace(variant, parameters=(replace(parameter, reason="none"),)),
        "vector_math.lane": replace(variant, torque=lambda *_: (0.0, 0.0)),
        "does nothing": replace(variant, torque=None),
        "`starts`": replace(variant, starts=()),
        "belong together": replace(variant, memory=1, memory_scale=(1.0,)),
        "replaces the friction": replace(variant, replaces_friction=True),
    }
    for words, bad in broken.items():
        assert any(words in fault for fault in faults(replace(effect, variants=(bad,)))), words
    assert any("site" in fault for fault in faults(replace(effect, site="moon")))


def test_an_installed_package_can_bring_an_effect(tmp_path):
    """With the small start that effects of a folder get, too."""
    written(tmp_path, "cogging_effect.py")
    info = tmp_path / "cogging-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: cogging\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[bayes_damper.effects]\ncogging = cogging_effect:EFFECT\n")
    code = textwrap.dedent("""
        from bayes_damper.effects import all_effects
        effect = all_effects()["cogging"]
        print(effect.site, min(abs(start[0]) for start in effect.variants[0].starts))
    """)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.stdout.split() == ["interface", "0.001"], done.stderr


def test_what_needs_the_coupled_rig_is_silent_on_the_uncoupled_one():
    """Said once, by `needs`: a variant need not say it again. A sensor's first channel is there on both rigs."""
    friction = EFFECTS["interface_friction"]
    anew = replace(friction, variants=tuple(replace(v, uncoupled=True) for v in friction.variants))
    assert not any(v.uncoupled for v in anew.variants)
    assert any(v.uncoupled for v in EFFECTS["sensor_delay"].variants)
    assert all(v.uncoupled for v in EFFECTS["bearing_drag"].variants)


def test_rounded_stops_push_back_as_hertz_has_it():
    """Force as the power 3/2 of the approach, on both sides, and none before they touch."""
    torque = next(v for v in EFFECTS["spring_bottoming"].variants if v.name == "contact").torque
    x, gap, share = np.array([-0.11, -0.06, -0.05, 0.0, 0.05, 0.07, 0.11]), 0.05, 0.7
    found = [torque(0.0, th, 0.0, 0.0, 0.0, 0.0, 0.0, (gap, share), RIG)[0] for th in x]
    expected = -share * RIG.k1t / math.sqrt(gap) * np.sign(x) * np.maximum(np.abs(x) - gap, 0.0) ** 1.5
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-100)
