"""Columns of measured torques and of a moving ground: read, checked, written back, fitted and forecast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaigns import write_table

from bayes_damper.calibration.experiment import experiment_of
from bayes_damper.calibration.forecast import forecast, summary
from bayes_damper.calibration.noise import rough_noise
from bayes_damper.calibration.nominal import calibrate_nominal
from bayes_damper.calibration.problem import Problem
from bayes_damper.calibration.scatter import TYPICAL
from bayes_damper.campaign import load_campaign, write_campaign
from bayes_damper.errors import InputError
from bayes_damper.rig.inputs import Inputs
from bayes_damper.simulation.model import Model

TIMES = np.arange(0.0, 2.0, 2e-3)
RIG = {
    "J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "k1t": 10.2, "k2t": 1.2, "c2t": 0.06,
    "c1t": 0.011, "c3t": 0.009, "mu": 0.006, "drag": 0.005, "nu": 60.0, "theta0": 0.0,
}  # fmt: skip
TOML = """
name = "shaken"
[rig]
primary_inertia = 3.015e-3
secondary_inertia = 2.474e-3
bar_radius = 0.1
magnet_radius = 0.0127
magnet_pull = 100.0
[measurement]
quantity = "acceleration"
noise_std = 1.0
"""


def sweep(level, seed=0):
    """A torque that runs through the resonances."""
    return level * np.sin(2.0 * np.pi * (2.0 + 5.0 * TIMES) * TIMES + seed)


def multisine(level, seed):
    """An acceleration of the ground."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1.0, 16.0, 0.5)
    return level * np.sum(np.cos(2.0 * np.pi * np.outer(lines, TIMES) + rng.uniform(0, 6.3, (lines.size, 1))), axis=0)


# name, column, input: a step on the secondary, sweeps, multisines of the ground; the last two at twice the level
TRIALS = (
    ("sweep1", "torque1_n_m", sweep(0.25)),
    ("sweep2", "torque2_n_m", sweep(0.15, 1)),
    ("step", "torque2_n_m", np.where(TIMES > 0.3, 0.4, 0.0)),
    ("ground", "ground_rad_s2", multisine(8.0, 1)),
    ("sweep1_high", "torque1_n_m", sweep(0.5)),
    ("ground_high", "ground_rad_s2", multisine(16.0, 2)),
)
KEYS = {"torque1_n_m": "torque1", "torque2_n_m": "torque2", "ground_rad_s2": "ground"}


def write(folder, *, extra="", toml=TOML, names=None, columns=None, noise=1.0, held=False, late=0.0):
    """A campaign of driven trials; names, columns : of the first record, in place of its own.

    late : s after their stamps, at which readings are taken.
    """
    rng = np.random.default_rng(8)
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(toml + extra, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial,holdout"]
    for k, (name, column, values) in enumerate(TRIALS):
        inputs = Inputs.measured(TIMES, **{KEYS[column]: values}, held=held)
        y = Model().simulate(RIG, TIMES + late, inputs=inputs).y[0]
        own = ["time_s", "alpha1_rad_s2", "alpha2_rad_s2", column]
        table = [TIMES, *(y + noise * rng.standard_normal(y.shape)), values]
        if k == 0 and names is not None:
            own, table = names, columns(table)
        write_table(folder / f"trials/{name}.csv", own, table)
        rows.append(f"trials/{name}.csv,A,coupled,10.2,0,0.001,{k + 1},{str('high' in name).lower()}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def test_inputs_are_read_and_written_back(tmp_path):
    campaign = load_campaign(write(tmp_path / "a", extra='frame = "ground"\ninput = "held"\n'))
    assert (campaign.measurement.frame, campaign.measurement.input) == ("ground", "held")
    assert not campaign.warnings
    for trial, (_, column, values) in zip(campaign.trials, TRIALS, strict=True):
        inputs = trial.inputs(campaign.measurement)
        np.testing.assert_allclose(getattr(inputs, KEYS[column]), values, rtol=1e-8)
        assert inputs.held
        assert not inputs.shown.any()
        assert trial.driven
    again = load_campaign(write_campaign(tmp_path / "b", campaign))
    assert again.measurement == campaign.measurement
    for one, other in zip(campaign.trials, again.trials, strict=True):
        for x, y in zip(one.given, other.given, strict=True):
            np.testing.assert_array_equal(x, y)
        assert one.inputs(campaign.measurement).key == other.inputs(again.measurement).key


def test_readings_are_absolute_unless_the_campaign_says_otherwise(tmp_path):
    trial = load_campaign(write(tmp_path / "a")).trials[3]
    experiment = experiment_of(load_campaign(tmp_path / "a"))
    np.testing.assert_array_equal(experiment.trials[3].inputs.shown, trial.ground_acceleration)


def test_readings_may_be_a_little_apart_in_time_from_inputs_unless_that_is_declared(tmp_path):
    """A logger reads its channels in turn: here the motion 0.1 ms, a twentieth of an interval, after its stamp."""
    folder = write(tmp_path / "a", late=1e-4)
    fit = calibrate_nominal(experiment_of(load_campaign(folder)))
    for channel in (1, 2):
        value, sd = fit.parameters[f"lag{channel}"]
        assert abs(value + 1e-4) < 4.0 * sd < 8e-5
    exact = experiment_of(load_campaign(write(tmp_path / "b", extra="lag_std = 0.0\n")))
    assert not any(exact.lag_sd)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"names": ["time_s", "alpha1_rad_s2", "alpha2_rad_s2", "torque3_n_m"], "columns": lambda t: t}, "torque"),
        (
            {"names": ["time_s", "alpha1_rad_s2", "alpha2_rad_s2", "ground_rad", "ground_rad_s2"],
             "columns": lambda t: [*t, t[-1]]}, "one motion of the ground",
        ),
        (
            {"names": ["time_s", "alpha1_rad_s2", "alpha2_rad_s2", "ground_rad"], "columns": lambda t: t,
             "extra": 'input = "held"\n'}, "would jump",
        ),
        ({"extra": 'frame = "space"\n'}, "'space' is not one of absolute, ground"),
        ({"toml": TOML.replace("[measurement]", 'restoring = "pendulum"\n[measurement]')}, "gravity"),
        (
            {"toml": TOML.replace("[measurement]",
                                  'inertial_coupling = 1e-4\ninertial_coupling_law = "cosine"\n[measurement]')},
            "leave out torque1_n_m",
        ),
    ],
)  # fmt: skip
def test_inputs_that_a_rig_cannot_take_are_faults(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        load_campaign(write(tmp_path / "a", **options))


def write_carried(folder, restoring="pendulum", column="pivot_m_s2", also=None):
    """A pendulum on a cart that is shaken: two trials, the second at twice the level and held out."""
    rng = np.random.default_rng(2)
    folder.mkdir()
    constants = f'name = "cart"\n[rig]\nprimary_inertia = 0.02\nrestoring = "{restoring}"\n'
    (folder / "campaign.toml").write_text(constants + '[measurement]\nquantity = "displacement"\nstart = "free"\n')
    rows = ["file,case,configuration,k1t_n_m_per_rad,k1t_std_n_m_per_rad,trial,holdout"]
    times = np.arange(0.0, 6.0, 1e-2)
    for k, level in enumerate((0.5, 0.6, 1.0)):
        waves = 2.0 * np.pi * np.outer(np.arange(0.4, 3.0, 0.2), times) + rng.uniform(0.0, 6.3, (13, 1))
        pushed = level * np.cos(waves).sum(axis=0)
        p = {"J1": 0.02, "k1t": 1.6, "c1t": 0.004, "drag": 0.003, "nu": 80.0, "theta0": 0.1 * k, "omega1_0": 0.3}
        y = Model(coupled=False, restoring="pendulum").simulate(
            p, times, inputs=Inputs.measured(times, pivot=pushed), quantity="displacement"
        ).y[0, 0]  # fmt: skip
        table = [times, y + 1e-3 * rng.standard_normal(y.size), pushed, *([] if also is None else [pushed])]
        write_table(folder / f"{k}.csv", ["time_s", "theta1_rad", column, *([] if also is None else [also])], table)
        rows.append(f"{k}.csv,A,uncoupled,1.55,0.1,{k + 1},{str(k == 2).lower()}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_a_pendulum_on_a_moving_pivot_is_read_fitted_and_forecast(tmp_path):
    campaign = load_campaign(write_carried(tmp_path / "a"))
    again = load_campaign(write_campaign(tmp_path / "b", campaign))
    np.testing.assert_array_equal(campaign.trials[0].pivot, again.trials[0].pivot)
    experiment = experiment_of(campaign, {"tail": 0.0})  # the bound below is for the curve that made the records
    fit = calibrate_nominal(replace(experiment, scatter=dict.fromkeys(TYPICAL, 0.0)))
    for name, truth in (("k1t", 1.6), ("c1t", 0.004), ("drag", 0.003)):
        low, high = fit.interval(name, 0.9999)
        assert low < truth < high, (name, low, high)
    found = summary(list(forecast(fit, experiment.heldout).values()))
    assert found["coverage90"] > 0.85  # one record, whose errors go together: from its state, which grows by then
    assert max(found["rms_by_channel"]) < 1.5e-3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"restoring": "linear"}, "pendulum's pivot; set restoring"),
        ({"also": "ground_rad_s2"}, "leaves no room"),
        ({"column": "ground_rad_s2"}, "'pivot_m_s2' where the pivot"),
    ],
)
def test_a_pivot_that_cannot_be_taken_is_a_fault(tmp_path, options, words):
    with pytest.raises(InputError, match=words):
        load_campaign(write_carried(tmp_path / "a", **options))


def test_a_torque_on_a_secondary_that_is_not_there_is_a_fault(tmp_path):
    folder = write(tmp_path / "a")
    rows = (folder / "trials.csv").read_text().replace("sweep2.csv,A,coupled", "sweep2.csv,A,uncoupled")
    (folder / "trials.csv").write_text(rows)
    with pytest.raises(InputError, match="which an uncoupled trial lacks"):
        load_campaign(folder)


def test_fits_of_some_readings_see_every_sample_of_the_input(tmp_path):
    whole, some = (
        experiment_of(load_campaign(write(tmp_path / f"{n}", noise=0.0, extra=f"every = {n}\n"))) for n in (1, 7)
    )
    assert some.trials[3].times.size == -(-TIMES.size // 7)
    simulated = []
    for experiment in (whole, some):
        problem = Problem(experiment, noise=rough_noise(experiment, (3,)), trials=(3,))
        group = problem.groups[0]
        own = np.zeros((1, len(group.nuisances)))
        simulated.append(problem.simulate(group, np.zeros(1, int), np.zeros((1, problem.size)), own))
    picked = simulated[0][:, :, ::7]
    assert np.abs(picked - simulated[1]).max() < 1e-3 * np.abs(picked).max()  # the priors come from the readings


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
def test_a_fit_at_one_level_forecasts_twice_the_level(tmp_path, held):
    experiment = experiment_of(
        load_campaign(write(tmp_path / "a", held=held, extra=f'input = "{"held" if held else "linear"}"\n'))
    )
    assert [t.label for t in experiment.trials if t.heldout] == ["trials/sweep1_high.csv", "trials/ground_high.csv"]
    # This rig does not scatter, which single trials cannot show: it is given as 0.
    fit = calibrate_nominal(replace(experiment, scatter=dict.fromkeys(TYPICAL, 0.0)))
    for name in ("k2t", "c2t", "c1t", "c3t", "mu", "drag"):
        low, high = fit.interval(name, 0.9999)
        assert low < RIG[name] < high, (name, low, high)
    found = summary(list(forecast(fit, experiment.heldout).values()))
    assert 0.4 < found["coverage50"] < 0.6
    assert 0.85 < found["coverage90"] < 0.96
    assert max(found["rms_by_channel"]) < 1.15  # the noise is 1
