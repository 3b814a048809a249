"""Units of effects' parameters on rigs of both kinds."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayes_damper.campaign import load_plan
from bayes_damper.commands.plan import judge
from bayes_damper.effects import EFFECTS
from bayes_damper.rig.units import effect_unit


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
