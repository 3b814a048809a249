"""A user's own effect, one file outside the package: named, shown in the report, and found by the withheld check."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from bayes_damper.cli import main
from bayes_damper.effects import EFFECTS, load_effects
from bayes_damper.simulation.model import Model
from bayes_damper.validation.withheld.sealing import KEY_SCHEMA

OWN = '''"""A cable that holds the secondary back, the stiffer the farther it is bent: Q2 = -a th2 |th2|."""

from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.rig.vector_math import lane


@lane
def pull(t, th1, th2, w1, w2, z1, z2, p, rig):
    return 0.0, -p[0] * th2 * abs(th2)


EFFECT = Effect(
    name="bent_cable",
    site="ground2",
    summary="The sensor's cable pulls the secondary back.",
    looks_like="The secondary swings faster the farther it goes.",
    hides_behind=("k2t",),
    source="Own assumption, for this test.",
    variants=(Variant(
        name="square", formula="Q2 = -a th2 |th2|", torque=pull, couples="bodies", starts=((3.0,),), uncoupled=False,
        parameters=(EffectParameter(
            "a", "N m/rad^2", "Torque per squared angle.", HalfNormal(6.0), "As k2t at a third of a radian.", 0.0,
        ),),
    ),),
)
'''
TOML = """name = "c1"
description = "simulated trials with a bent cable"
source = "tests/test_own_effect.py"

[rig]
kind = "torsional"
primary_inertia = 3.015e-3
secondary_inertia = 2.474e-3
bar_radius = 0.1
magnet_radius = 0.0127
magnet_pull = 100.0

[measurement]
quantity = "acceleration"
sample_rate = 1000.0
"""
TRUE = {"mu": 0.006, "k2t": 1.4, "c2t": 0.07, "drag": 0.005, "nu": 40.0, "c1t": 0.011, "c3t": 0.009}
STIFFNESS = 5.0
RIVALS = {
    "inertia_error", "magnet_cubic", "misalignment_drag", "quadratic_drag", "release_offset", "sensor_gain",
    "spring_cubic",
}  # fmt: skip
"""What of the library is tried beside it, from every site: what is shown here is how an effect comes to be tried."""


def write_campaign(folder: Path, effect) -> None:
    """Two cases coupled, one uncoupled, three trials each, with the effect at work on the secondary."""
    rng = np.random.default_rng(12)
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(TOML)
    times = np.arange(300) * 1e-3
    rig = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0}
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,trial"]
    for case, k1t, degrees in (("II", 6.2, 7.2), ("IV", 10.2, 4.7)):
        for both in (False, True)[case == "II" :]:
            y = Model(both, effect=effect if both else None).simulate(
                rig | TRUE | {"k1t": k1t, "theta0": math.radians(degrees)},
                times,
                effect={"a": STIFFNESS} if both else None,
            ).y[0]  # fmt: skip
            for trial in (1, 2, 3):
                table = np.column_stack([times, *(y + 2.0 * rng.standard_normal(y.shape))])
                name = f"trials/{case}_{both:d}_{trial}.csv"
                head = "time_s,alpha1_rad_s2" + ",alpha2_rad_s2" * both
                np.savetxt(folder / name, table, fmt="%.7g", delimiter=",", header=head, comments="")
                rows.append(f"{name},{case},{'coupled' if both else 'uncoupled'},{k1t},{degrees},{trial}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")


def test_it_needs_at_most_thirty_lines_of_its_own():
    """Imports and blank lines not counted."""
    lines = [x for x in OWN.splitlines() if x.strip() and not x.startswith(("from ", "import "))]
    assert len(lines) <= 30


@pytest.mark.slow
def test_an_effect_from_outside_the_package_is_named_reported_and_found(tmp_path, monkeypatch, capsys):
    """diagnose --effects names it, the report shows it, and withheld finds it, as an installed package's effect too."""
    for name in EFFECTS.keys() - RIVALS:
        monkeypatch.delitem(EFFECTS, name)
    own = tmp_path / "mine"
    own.mkdir()
    (own / "bent_cable.py").write_text(OWN)
    campaigns = tmp_path / "campaigns"
    write_campaign(campaigns / "c1", load_effects(own)["bent_cable"].variants[0])

    out = tmp_path / "diagnosis"
    assert main(["diagnose", str(campaigns / "c1"), "--effects", str(own), "--out", str(out)]) == 0
    found = json.loads((out / "diagnosis.json").read_text())
    assert found["verdict"] == "bent_cable"
    row = next(e for e in found["effects"] if e["name"] == "bent_cable")
    assert row["parameters"]["a"]["mean"] == pytest.approx(STIFFNESS, rel=0.3)
    assert max(found["sites"], key=found["sites"].get) == "ground2"
    assert "bent_cable" in capsys.readouterr().out

    assert main(["report", str(out)]) == 0
    page = next(out.glob("*.html")).read_text(encoding="utf-8")
    assert "bent cable" in page or "bent_cable" in page

    (tmp_path / "cable_effect.py").write_text(OWN)
    info = tmp_path / "cable-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: cable\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[bayes_damper.effects]\ncable = cable_effect:EFFECT\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = {
        "kind": "easy", "effects": ["bent_cable"], "truth": "bent_cable", "site": "ground2", "class": None,
        "standing": "library", "level_wanted": 0.5, "level": 0.5, "visible_chi2": 500.0, "nominal": TRUE,
        "disturbances": [],
    }  # fmt: skip
    (tmp_path / "campaigns_key.json").write_text(
        json.dumps({"schema": KEY_SCHEMA, "salt": "x", "campaigns": {"c1": entry}})
    )
    sealed = tmp_path / "sealed"
    for name in RIVALS - {"spring_cubic", "magnet_cubic"}:  # what is shown here is that withheld has the effect at all
        monkeypatch.delitem(EFFECTS, name)
    try:
        assert main(["withheld", str(campaigns), "--workers", "1", "--out", str(sealed)]) == 0
    finally:
        sys.modules.pop("cable_effect", None)
    scored = json.loads((sealed / "withheld.json").read_text())
    assert scored["campaigns"]["c1"]["verdict"] == "bent_cable"
    assert scored["scores"]["all"]["right_first"]["value"] == 1.0
