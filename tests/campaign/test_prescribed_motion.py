"""Campaigns in which the primary is moved as prescribed and its reaction read: checked, fitted, forecast."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from campaigns import write_table

from bayes_damper.calibration.experiment import experiment_of
from bayes_damper.calibration.forecast import forecast, summary
from bayes_damper.calibration.nominal import calibrate_nominal
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.campaign import load_campaign, write_campaign
from bayes_damper.campaign.importing.importer import init_campaign
from bayes_damper.commands.plan import judge
from bayes_damper.diagnosis import diagnose
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.rig.inputs import Inputs
from bayes_damper.simulation.model import Model

TIMES = np.arange(0.0, 2.0, 2e-3)
RIG = {
    "J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "k1t": 10.2, "k2t": 1.2, "c2t": 0.06,
    "c1t": 0.011, "c3t": 0.009, "mu": 0.006, "drag": 0.005, "nu": 60.0, "theta0": 0.0,
}  # fmt: skip
TOML = """
name = "moved"
[rig]
primary_inertia = { value = 3.1e-3, std = 2e-4 }
secondary_inertia = 2.474e-3
bar_radius = 0.1
magnet_radius = 0.0127
magnet_pull = 100.0
[measurement]
quantity = "displacement"
start = "START"
"""
NOISE = (2e-3, 1e-4)  # N m, rad


def angle(level, seed):
    """A multisine from 3 to 12 Hz."""
    rng = np.random.default_rng(seed)
    lines = np.arange(3.0, 12.0, 0.5)
    waves = np.cos(2.0 * np.pi * np.outer(lines, TIMES) + rng.uniform(0.0, 6.3, (lines.size, 1)))
    return 2.0 * level * (lines**-1.0 @ waves)


def write(folder, *, start="rest", toml=TOML, names=("reaction1_n_m", "theta2_rad", "motion1_rad"), extra=None):
    """Four trials, the last one at twice the level and held out; extra : a column more in the first record."""
    rng = np.random.default_rng(5)
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(toml.replace("START", start), encoding="utf-8")
    angles = "theta0_deg,theta0_std_deg," if start == "rest" else ""
    rows = [f"file,case,configuration,k1t_n_m_per_rad,{angles}trial,holdout"]
    for k, level in enumerate((0.03, 0.03, 0.03, 0.06)):
        motion = angle(level, k)
        begun = {} if start == "rest" else {"theta2_0": 0.02 * k, "omega2_0": 0.3}
        inputs = Inputs.measured(TIMES, motion=motion)
        y = Model().simulate(RIG | begun, TIMES, inputs=inputs, quantity="displacement").y[0]
        y = y + np.array(NOISE)[:, None] * rng.standard_normal(y.shape)
        own, table = ["time_s", *names], [TIMES, *y, motion]
        if k == 0 and extra is not None:
            own, table = [*own, extra], [*table, motion]
        write_table(folder / f"trials/{k}.csv", own, table)
        released = "0,0.001," if start == "rest" else ""
        rows.append(f"trials/{k}.csv,A,coupled,10.2,{released}{k + 1},{str(k == 3).lower()}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def test_reactions_are_read_described_and_written_back(tmp_path):
    campaign = load_campaign(write(tmp_path / "a"))
    assert all(t.prescribed and t.driven for t in campaign.trials)
    assert re.search(r"moved as prescribed, noise about 0\.002\d* N m, [\d.e-]+ rad\b", campaign.describe())
    assert not campaign.warnings
    again = load_campaign(write_campaign(tmp_path / "b", campaign))
    assert (tmp_path / "b/trials/0.csv").read_text().startswith("time_s,reaction1_n_m,theta2_rad,motion1_rad\n")
    for one, other in zip(campaign.trials, again.trials, strict=True):
        np.testing.assert_array_equal(one.channels, other.channels)
        assert one.inputs(campaign.measurement).key == other.inputs(again.measurement).key


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"names": ("theta1_rad", "theta2_rad", "motion1_rad")}, "'reaction1_n_m' is missing.*the torque"),
        ({"names": ("reaction1_n_m", "theta2_rad", "motion1_rda")}, "did you mean 'motion1_rad'"),
        ({"extra": "motion1_rad_s2"}, "one motion of the primary"),
        ({"extra": "torque1_n_m"}, "part of the reaction"),
        ({"extra": "ground_rad"}, "moving ground"),
        ({"toml": TOML + 'input = "held"\n'}, "would jump"),
    ],
)
def test_motions_that_cannot_be_taken_are_faults(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        load_campaign(write(tmp_path / "a", **options))


def test_a_campaign_is_of_reactions_or_of_motions(tmp_path):
    campaign = load_campaign(write(tmp_path / "a"))
    y = campaign.trials[0].channels
    write_table(tmp_path / "a/trials/0.csv", ["time_s", "theta1_rad", "theta2_rad", "torque1_n_m"], [TIMES, *y, y[0]])
    with pytest.raises(InputError, match="make a campaign of each"):
        load_campaign(tmp_path / "a")


@pytest.mark.slow
@pytest.mark.parametrize("start", ["rest", "free"])
def test_a_fit_of_reactions_finds_the_rig_and_forecasts_twice_the_level(tmp_path, start):
    """The reaction shows the inertia itself, which a free decay never does."""
    experiment = experiment_of(load_campaign(write(tmp_path / "a", start=start)))
    fit = calibrate_nominal(replace(experiment, scatter=dict.fromkeys(TYPICAL, 0.0)))
    for name in ("J1", "k2t", "c2t", "c1t", "c3t", "mu", "drag"):
        low, high = fit.interval(name, 0.9999)
        assert low < RIG[name] < high, (name, low, high)
    low, high = fit.interval("J1", 0.9)
    assert high - low < 2e-5  # 6.6e-4 before any reading
    found = summary(list(forecast(fit, experiment.heldout).values()))
    assert 0.4 < found["coverage50"] < 0.6
    assert 0.85 < found["coverage90"] < 0.96
    unit = RIG["k1t"]  # of a reaction among angles
    for rms, sd in zip(found["rms_by_channel"], (NOISE[0] / unit, NOISE[1]), strict=True):
        assert 0.9 < rms / sd < 1.15


@pytest.mark.slow
@pytest.mark.parametrize(("cubic", "verdict"), [(0.0, "none"), (900.0, "spring_cubic")])
def test_diagnose_names_what_the_reaction_of_a_prescribed_motion_shows(tmp_path, cubic, verdict):
    """One body, whose reaction is a sum of known terms: nothing is simulated."""
    rng = np.random.default_rng(3)
    folder = tmp_path / "a"
    (folder / "trials").mkdir(parents=True)
    toml = re.sub("(secondary|bar|magnet).*\n", "", TOML).replace("START", "rest")
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial"]
    for k in range(3):
        motion = angle(0.04, 1)
        th, w, a = Inputs.measured(TIMES, motion=motion).motion
        reaction = 3.015e-3 * a + 0.011 * w + 10.2 * th + 0.005 * np.tanh(60.0 * w) + cubic * th**3
        write_table(
            folder / f"trials/{k}.csv", ["time_s", "reaction1_n_m", "motion1_rad"],
            [TIMES, reaction + NOISE[0] * rng.standard_normal(TIMES.size), motion],
        )  # fmt: skip
        rows.append(f"trials/{k}.csv,A,uncoupled,10.2,0,0.001,{k + 1}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    campaign = load_campaign(folder)
    if cubic:
        declared = replace(campaign, measurement=replace(campaign.measurement, noise_std=NOISE[:1]))
        plan = judge(declared, {name: EFFECTS[name] for name in ("spring_cubic", "quadratic_drag")})
        assert plan["noise"] == [NOISE[0]]  # N m
        assert all(row["chance"] > 0.5 for row in plan["effects"])
        low, high = plan["parameters"]["J1"]["expected90"]
        assert high - low < 2e-5
    found = diagnose(campaign)
    assert found.verdict == verdict, found.answers.probabilities
    assert found.answers.probabilities[verdict] > 0.6
    assert found.proposals == ()  # nothing is released
    assert not {"release_ramp", "release_offset"} & set(found.evidence)
    if cubic:
        assert found.gap.answer == "gap"
        assert found.gap.closed.median > 0.9
        missing = found.site_map.torque[0]
        right = -cubic * missing.th1**3
        assert np.corrcoef(missing.torque[0], right)[0, 1] > 0.9


def test_init_takes_a_reaction_and_the_motion_that_was_imposed(tmp_path):
    motion, reaction, second = angle(0.03, 1), 0.2 * angle(0.03, 2), angle(0.02, 3)
    columns = [1e3 * TIMES, 1e3 * reaction, np.degrees(second), np.degrees(motion)]
    write_table(tmp_path / "a.csv", ["t [ms]", "M [N mm]", "phi2 [deg]", "phi1 [deg]"], columns)
    options = {
        "time": 1, "columns": [2, 3], "motion": "phi1", "quantity": "displacement", "secondary_inertia": 2.474e-3,
        "primary_inertia": 3.015e-3, "k1t": 10.2, "configuration": "coupled",
    }  # fmt: skip
    trial = load_campaign(init_campaign(tmp_path / "rig", [tmp_path / "a.csv"], **options)).trials[0]
    for found, given in ((trial.channels[0], reaction), (trial.channels[1], second), (trial.motion, motion)):
        np.testing.assert_allclose(found, given, rtol=1e-6, atol=1e-9)
    assert trial.prescribed
    with pytest.raises(InputError, match="no unit of a reaction"):
        init_campaign(tmp_path / "wrong", [tmp_path / "a.csv"], **options | {"units": ["rad/s^2", "deg"]})
