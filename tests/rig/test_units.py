"""Units of effects' parameters on rigs of both kinds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bayes_damper.campaign import load_plan
from bayes_damper.commands.plan import judge
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError, UnitFault
from bayes_damper.rig.parameters import PARAMETERS
from bayes_damper.rig.units import effect_unit, in_words_of, sentence_of, spoken_of


@pytest.mark.parametrize(
    ("declared", "told"),
    [
        ("N m/rad^3", "N/m^3"), ("1/(N m rad)", "1/(N m)"), ("s/rad", "s/m"), ("rad/s", "m/s"), ("1", "1"),
        ("reading", "m"),
    ],
)  # fmt: skip
def test_units_of_a_translational_rig_are_newtons_and_metres(declared: str, told: str) -> None:
    assert effect_unit(declared, "translational", "displacement") == told


def test_units_of_a_torsional_rig_are_as_declared() -> None:
    declared = {p.unit for e in EFFECTS.values() for v in e.variants for p in v.parameters}
    assert {effect_unit(unit) for unit in declared - {"reading"}} == declared - {"reading"}
    assert effect_unit("reading", quantity="velocity") == "rad/s"
    assert not any("rad" in effect_unit(unit, "translational") for unit in declared)


def test_a_plan_of_carts_tells_effects_in_newtons_and_metres(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(
        'name = "cart"\n[rig]\nkind = "translational"\nprimary_inertia = 1.0\n[measurement]\n'
        'quantity = "displacement"\nsample_rate = 200.0\nduration = 1.0\nnoise_std = 1e-5\n'
    )
    (tmp_path / "trials.csv").write_text(
        "file,case,configuration,k1_n_per_m,theta0_mm,trial\nr.csv,A,uncoupled,900,8,1\n"
    )
    found = judge(load_plan(tmp_path), {name: EFFECTS[name] for name in ("spring_cubic", "sensor_clipping")})
    typical = {row["name"]: {p["unit"] for p in row["typical"].values()} for row in found["effects"]}
    assert typical["sensor_clipping"] == {"m"}
    assert not any("rad" in unit for units in typical.values() for unit in units)


def test_words_of_a_cart_are_force_mass_and_displacement_and_its_symbols_are_of_a_line() -> None:
    cart = ("translational", False)
    assert in_words_of("The torque of the spring grows faster than its angle.", *cart) == (
        "The force of the spring grows faster than its displacement."
    )
    assert in_words_of("Q1 = -k3 th1^3", *cart) == "F1 = -k3 x1^3"
    assert in_words_of("Q = -d tanh(n w)", *cart) == "F = -d tanh(n v)"
    assert in_words_of("Inertia of the bars", *cart) == "Mass of the bodies"
    assert in_words_of("The secondary inertia is off.", *cart) == "The mass of body 2 is off."
    assert in_words_of("missing_torque.csv, inertia_error", *cart) == "missing_torque.csv, inertia_error", "names stay"


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if "magnet" not in e.needs], ids=lambda e: e.name)
def test_no_effect_speaks_of_torque_angle_or_magnet_on_a_cart_that_has_none(effect) -> None:
    assert effect.title, "each effect has a title beside its name"
    meanings = [p.meaning for v in effect.variants for p in v.parameters]
    text = " ".join([effect.title, effect.summary, *meanings, *(v.formula for v in effect.variants)])
    words = set(re.findall(r"[a-z]+\d?", in_words_of(text, "translational", False).lower()))
    assert not words & {
        "torque",
        "torques",
        "angle",
        "angles",
        "inertia",
        "inertias",
        "magnet",
        "magnetic",
        "faces",
        "th1",
        "primary",
        "secondary",
    }


def test_parameters_of_a_torsional_rig_keep_their_words() -> None:
    assert all(in_words_of(p.meaning) == p.meaning for p in PARAMETERS.values())


def test_words_of_another_rig_leave_names_of_files_alone() -> None:
    """A note named trials/x0-16_uncoupled_1.csv, which is not there."""
    note = "trials/theta0-16_w1_1.csv, trials/torque.csv.gz: theta0 of the primary"
    assert in_words_of(note, "translational") == "trials/theta0-16_w1_1.csv, trials/torque.csv.gz: x0 of body 1"


def test_what_is_said_of_a_cart_leaves_names_of_files_and_columns_alone() -> None:
    said = "trials/angle.csv: the primary is held; in turn 'the primary' of theta0_std_deg, torque.csv, primary_inertia"
    assert sentence_of(said) == said
    assert sentence_of(said, "translational") == said.replace("the primary is", "body 1 is")
    assert sentence_of("The torques on both. A torque.", "translational") == "The forces on both. A force."
    with pytest.raises(InputError, match=r"^body 2 rests$"), spoken_of("translational"):
        raise InputError("the secondary rests")
    with pytest.raises(InputError, match=r"^the secondary rests$"), spoken_of(None):
        raise InputError("the secondary rests")


def test_a_fault_stays_of_its_kind_in_the_words_of_a_rig() -> None:
    with pytest.raises(InputError) as caught, spoken_of("translational"):
        raise InputError([UnitFault("the secondary rests\x1b"), "the secondary rests"])
    assert [type(fault) for fault in caught.value.faults] == [UnitFault, str]
    assert caught.value.faults[0] == "body 2 rests\\x1b"
