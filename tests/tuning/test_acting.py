"""What acts on a driven rig: the effect of a fit, or a learnt law."""

import numpy as np
import pytest

from bayes_damper import tuning
from bayes_damper.effects import EFFECTS
from bayes_damper.simulation.model import Model
from bayes_damper.tuning.acting import acting_of, seconds_in

RIG = {"mu": 0.004, "k2t": 1.0, "c2t": 0.01, "drag": 0.02, "nu": 40.0, "c1t": 0.01, "k1t": 8.2}


def driven(effect, formula, values=None, **more):
    """Draws of one rig with an effect, at a first point of its search, and what a fit's folder says of both."""
    variant = EFFECTS[effect].variant(formula)
    numbers = {f"effect.{p.name}": x for p, x in zip(variant.parameters, values or variant.starts[0], strict=True)}
    draws = tuning.posterior_draws(RIG | numbers | more, "IV", 1, np.random.default_rng(1))
    return draws, tuning.Origin(effect=effect, formula=variant.formula)


@pytest.mark.parametrize(
    ("unit", "power"),
    [
        ("N m s/rad", 1), ("kg m^2", 2), ("rad/s", -1), ("1/s", -1), ("s", 1), ("s/rad", 1), ("N m/rad^3", 0),
        ("1/(N m rad)", 0), ("1/rad^2", 0), ("1", 0), ("N s^2/m", 2),
    ],
)  # fmt: skip
def test_powers_of_seconds_are_read_from_units(unit, power):
    assert seconds_in(unit) == power


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "formula", "values"),
    [
        ("bearing_stribeck", "gaussian", (1.0, 1.0)), ("coupling_hysteresis", "dahl", (0.02, 0.01, 0.0)),
        ("interface_relaxation", "two_arms", (1.0, 0.02)), ("quadratic_drag", "alike", (2.0,)),
        ("spring_bottoming", "same_stop", (0.004, 4.0)), ("stick_slip", "lugre", (0.002, 0.003, 1.0, 0.5)),
    ],
)  # fmt: skip
def test_an_effect_acts_as_on_a_rig_driven_in_its_own_time(effect, formula, values):
    """All frequencies share one drive, with time scaled; here the same rig is integrated at 7 Hz as it is."""
    draws, origin = driven(effect, formula, values)
    acting, same, note = acting_of(origin, draws)
    assert same is draws
    assert f"The driven rig has the effect {effect} ({EFFECTS[effect].title}), as in the fit" in note
    (f, amplitude, cycles, a_cycle) = (7.0, 0.08, 16, 24)
    found, _ = tuning.harmonic_response(draws, [f], amplitude, settle_cycles=cycles - 4, acting=acting)
    times = np.arange(cycles * a_cycle) / (a_cycle * f)
    numbers = {p.name: draws[f"effect.{p.name}"] for p in acting.variant.parameters}
    rig = {k: x for k, x in draws.items() if "." not in k} | {"theta0": 0.0, "delay": 0.0}
    y = (
        Model(coupled=True, effect=acting.variant)
        .simulate(
            rig, times, effect=numbers, torque=amplitude * np.cos(2.0 * np.pi * f * times), quantity="displacement",
            tolerance=0.1,
        )
        .y[0, 0, -4 * a_cycle :]
    )  # fmt: skip
    last = 2.0 * np.mean(y * np.exp(-2j * np.pi * np.arange(y.size) / a_cycle))
    drive = amplitude * np.sinc(1.0 / a_cycle) ** 2
    assert found[0, 0] == pytest.approx(abs(last) * (2.0 * np.pi * f) ** 2 / drive, rel=1e-5)
    without, _ = tuning.harmonic_response(draws, [f], amplitude, settle_cycles=cycles - 4)
    assert abs(without[0, 0] / found[0, 0] - 1.0) > 0.01


@pytest.mark.parametrize(
    ("effect", "formula", "why"),
    [
        ("sensor_gain", "channel1", "it belongs to the sensors, and a driven rig does not have it"),
        ("release_ramp", "linear", "it belongs to the release"),
        ("magnet_fade", "linear", "a driven rig has no steady state with it"),
    ],
)
def test_what_a_driven_rig_does_not_have_is_left_out_with_the_reason(effect, formula, why):
    draws, origin = driven(effect, formula)
    acting, same, note = acting_of(origin, draws)
    assert acting is None
    assert same is draws
    assert f"The fit has the effect {effect} ({EFFECTS[effect].title}) too, which is left out here: " in note
    assert why in note


def test_a_wrong_constant_is_put_right_in_the_draws_and_a_new_secondary_is_as_given():
    draws, origin = driven("inertia_error", "factor", J2=2.0e-3)
    acting, right, note = acting_of(origin, draws)
    assert right["J2"] == pytest.approx(2.0e-3 * 1.08)
    assert (acting, note) == (
        None,
        "The rig has the effect inertia_error (wrong inertia of the secondary), as in the fit.",
    )
    assert tuning.Design(J2=1e-3).apply(right)["J2"] == pytest.approx(1e-3)


def test_a_formula_that_is_not_known_is_left_out():
    draws, origin = driven("spring_cubic", "same_for_all")
    acting, _, note = acting_of(tuning.Origin(effect=origin.effect), draws)
    assert acting is None
    assert "which is left out here: fit it again" in note
    assert "only effects of the library" in acting_of(tuning.Origin(effect="my_own"), draws)[2]
    assert acting_of(tuning.Origin(), draws)[::2] == (None, "")


def with_two(first, second, **more):
    """Draws of one rig with two effects, each at a first point of its search, and what a fit's folder says of both."""
    pair = {effect: EFFECTS[effect].variant(formula) for effect, formula in (first, second)}
    numbers = {
        f"effect.{name}.{p.name}": x
        for name, v in pair.items() for p, x in zip(v.parameters, v.starts[0], strict=True)
    }  # fmt: skip
    draws = tuning.posterior_draws(RIG | numbers | more, "IV", 1, np.random.default_rng(1))
    # A kernel may take them in the other order.
    formula = "; ".join(f"{name}: {v.formula}" for name, v in reversed(pair.items()))
    return draws, tuning.Origin(effect="+".join(pair), formula=formula)


CUBIC, OFFSET = ("spring_cubic", "same_for_all"), ("release_offset", "offset")


@pytest.mark.parametrize("pair", [(OFFSET, CUBIC), (CUBIC, OFFSET)], ids=str)
def test_of_two_effects_the_one_of_the_release_is_left_out_and_the_other_acts(pair):
    draws, origin = with_two(*pair)
    acting, same, note = acting_of(origin, draws)
    assert same is draws
    assert acting.variant is EFFECTS["spring_cubic"].variant("same_for_all")
    numbers = acting.numbers(draws, np.array([[0.5, 2.0]]))
    assert {name: list(x) for name, x in numbers.items()} == {"k3": [draws["effect.spring_cubic.k3"][0]] * 2}
    assert f"The driven rig has the effect spring_cubic ({EFFECTS['spring_cubic'].title}), as in the fit; the" in note
    assert f"The fit has the effect release_offset ({EFFECTS['release_offset'].title}) too, which is left out" in note


def test_two_effects_that_act_drive_the_rig_together():
    """Alone on the primary, too, only the one that can act there does; each number is that of its own effect."""
    draws, origin = with_two(("magnet_cubic", "cubic"), ("quadratic_drag", "alike"))
    acting, same, note = acting_of(origin, draws)
    assert same is draws
    assert "has the effects magnet_cubic (" in note
    assert ") and quadratic_drag (" in note
    assert note.endswith(
        ", as in the fit; the linear model, and with it the search for the best design, leaves them out."
    )
    assert {p.name for p in acting.variant.parameters} == {"magnet_cubic.cubic", "quadratic_drag.coefficient"}
    cubic, drag = EFFECTS["magnet_cubic"].variant("cubic"), EFFECTS["quadratic_drag"].variant("alike")
    scale = np.array([[0.5, 2.0]])
    numbers = acting.numbers(draws, scale)
    assert list(numbers["magnet_cubic.cubic"]) == [cubic.starts[0][0]] * 2
    assert list(numbers["quadratic_drag.coefficient"]) == [drag.starts[0][0]] * 2
    assert acting.on_rig(True) is acting
    apart = acting.on_rig(False)
    assert [p.name for p in apart.variant.parameters] == [p.name for p in acting.variant.parameters]
    assert apart.variant.torque is not acting.variant.torque


@pytest.mark.slow
def test_two_effects_drive_the_rig_as_each_would_beside_the_other():
    """With one at its null, the response is that of the other alone; without the secondary, that of the drag."""
    for name, formula in (("magnet_cubic", "cubic"), ("quadratic_drag", "alike")):
        draws, origin = with_two(("magnet_cubic", "cubic"), ("quadratic_drag", "alike"))
        off = {k: 0.0 * x for k, x in draws.items() if k.startswith("effect.") and name not in k}
        both, draws, _ = acting_of(origin, draws | off)
        alone = tuning.Acting(EFFECTS[name].variant(formula), label=f"{name}.")
        for coupled in (True, False):
            found, right = (
                tuning.harmonic_response(draws, [7.0], 0.08, coupled, settle_cycles=12, acting=acting)[0][0, 0]
                for acting in (both, alone)
            )
            assert found == pytest.approx(right, rel=1e-6)


def test_a_wrong_constant_beside_an_effect_that_acts_is_put_right_in_the_draws():
    draws, origin = with_two(("inertia_error", "factor"), CUBIC, J2=2.0e-3)
    acting, right, note = acting_of(origin, draws)
    assert right["J2"] == pytest.approx(2.0e-3 * 1.08)
    assert acting.variant is EFFECTS["spring_cubic"].variant("same_for_all")
    assert acting.numbers(right, np.ones((1, 1)))["k3"] == draws["effect.spring_cubic.k3"]
    assert note.startswith("The rig has the effect inertia_error (wrong inertia of the secondary), as in the fit. The")


def test_of_two_effects_one_that_is_not_known_is_left_out():
    draws, origin = with_two(CUBIC, OFFSET)
    formula = origin.formula.replace("release_offset", "learnt_ground1")
    acting, _, note = acting_of(tuning.Origin(effect="spring_cubic+learnt_ground1", formula=formula), draws)
    assert acting.variant is EFFECTS["spring_cubic"].variant("same_for_all")
    assert "has the effect learnt_ground1 too, which is left out here: " in note
    assert "the design is judged without it" in note
