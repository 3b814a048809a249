"""The five measured rigs: what the diagnosis and its peers say of each, and how held-out stretches are forecast."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pages
import pandas as pd
import parts
import pytest
import rig_peers

from bayes_damper.calibration import experiment_of
from bayes_damper.campaign import load_campaign
from bayes_damper.campaign.importing.importer import import_records
from bayes_damper.commands.diagnose import diagnose
from bayes_damper.priors.files import campaign_priors

RAW = Path(os.environ.get("BAYES_DAMPER_REALDATA", parts.ROOT.parent / "shared" / "realdata"))
RIGS = ("rotary_pendulum", "tuned_mass_damper", "single_pendulum", "servo_drop", "double_pendulum")
KEPT = ("verdict", "probabilities", "credible_set", "pair", "sites", "gap", "forecast", "notes")


def studied(name: str, folder: Path) -> dict[str, Any]:
    """What `diagnose --nominal linear` and the installed peers say of one rig."""
    home = import_records(parts.ROOT / "data" / "real" / name / "import.toml", folder / name, RAW / name)
    own = diagnose(home, nominal="linear", out=folder / f"{name}_out").result
    campaign = load_campaign(home)
    experiment = experiment_of(campaign, campaign_priors(parts.ROOT / "data" / "real" / name / "priors.toml", campaign))
    return {
        "rig": name,
        "diagnosis": {key: own[key] for key in KEPT},
        "others": others_held_out(home, folder, [i for i, t in enumerate(experiment.trials) if not t.heldout]),
        "peers": rig_peers.all_of(experiment),
    }


def others_held_out(home: Path, folder: Path, trained: list[int]) -> list[dict[str, Any]]:
    """The same diagnosis with each trained trial held out in turn, where there are several: verdict and forecast."""
    table = pd.read_csv(home / "trials.csv")
    found = []
    for k in trained if len(trained) > 1 else []:
        copy = shutil.copytree(home, folder / f"{home.name}_{k}")
        table.assign(holdout=[i == k for i in range(len(table))]).to_csv(copy / "trials.csv", index=False)
        own = diagnose(copy, nominal="linear", out=folder / f"{home.name}_{k}_out").result
        found.append({key: own[key] for key in ("verdict", "probabilities", "forecast")})
    return found


@pytest.mark.prove
@pytest.mark.filterwarnings("ignore")  # the peers' own
def test_what_measured_rigs_say(tmp_path):
    if not RAW.is_dir():
        pytest.skip("the raw files of the measured rigs are not here; set BAYES_DAMPER_REALDATA to their folder")
    found = parts.finish("rigs", len(RIGS), lambda i: studied(RIGS[i], tmp_path))
    pages.rigs(found)
    by_name = {row["rig"]: row["diagnosis"] for row in found}
    assert by_name["rotary_pendulum"]["verdict"] == "bearing_drag"
    assert by_name["tuned_mass_damper"]["verdict"] == "none"
    assert by_name["tuned_mass_damper"]["gap"]["answer"] != "gap"
    assert max(by_name["tuned_mass_damper"]["probabilities"].values()) < 0.9
    named = {n: p for n, p in by_name["tuned_mass_damper"]["probabilities"].items() if n not in ("none", "unknown")}
    assert max(named.values()) < 0.1, "its damping law cannot be identified"
    assert by_name["servo_drop"]["verdict"] == "bearing_drag"
    assert set(by_name["single_pendulum"]["pair"]["effects"]) == {"bearing_drag", "quadratic_drag"}
    assert set(by_name["double_pendulum"]["pair"]["effects"]) == {"bearing_drag", "interface_friction"}
    for name in ("rotary_pendulum", "single_pendulum", "servo_drop", "double_pendulum"):
        ahead = by_name[name]["forecast"]
        assert ahead["after"]["rms"] < ahead["before"]["rms"]
    # What least squares by others are quoted with, the state from the whole stretch.
    for stretch, reference in zip(
        by_name["double_pendulum"]["forecast"]["trials"], (1.09e-3, 3.1e-3, 30.5e-3), strict=True
    ):
        assert stretch["after"]["rms_whole"] < reference
