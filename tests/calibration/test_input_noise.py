"""Noise of measured inputs against scipy's linear systems, which share neither equations nor integrator."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from bayes_damper.calibration import (
    Experiment,
    Noise,
    Problem,
    Switches,
    TrialRecord,
    calibrate,
    calibrate_nominal,
    predict,
)
from bayes_damper.calibration.input_noise import followed, input_noise, with_input_noise
from bayes_damper.calibration.nominal import _with_exact_inputs
from bayes_damper.diagnosis.sets import left_over, set_fit
from bayes_damper.rig.inputs import Inputs

J1, J2, K1, C1, K2, C2, C3 = 0.034, 0.012, 5.2, 0.03, 2.1, 0.01, 0.004
TIMES = np.arange(400) * 0.025
NOISE = 4e-4


def linear(torque, coupled=False, **found):
    """Angles (channels, n) of the linear rig from rest under a torque on the primary that is linear between samples."""
    p = {"k1t": K1, "c1t": C1, "k2t": K2, "c2t": C2, "c3t": C3} | found
    M = np.diag([J1, J2])
    K = np.array([[p["k1t"] + p["k2t"], -p["k2t"]], [-p["k2t"], p["k2t"]]])
    C = np.array([[p["c1t"] + p["c2t"], -p["c2t"]], [-p["c2t"], p["c2t"] + p["c3t"]]])
    if not coupled:
        M, K, C = M[:1, :1], np.array([[p["k1t"]]]), np.array([[p["c1t"]]])
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.vstack([np.zeros((n, 1)), np.linalg.inv(M)[:, :1]])
    system = cont2discrete((A, B, np.eye(2 * n), np.zeros((2 * n, 1))), TIMES[1], method="foh")
    # The discrete state is the motion less D u: at rest at first.
    return dlsim(system, torque, x0=-system[3][:, 0] * torque[0])[1].T[:n]


def driven(seed, coupled=False, error=0.004, shown=None, trials=1):
    """Records of the linear rig under multisines that were measured with an error; shown: white noise acts instead."""
    rng = np.random.default_rng(seed)
    records = []
    for number in range(1, trials + 2):
        phases = rng.uniform(0.0, 2.0 * math.pi, 21)
        acts = shown or sum(
            0.08 * np.sin(2.0 * math.pi * f * TIMES + p) * np.minimum(TIMES, 1.0)
            for f, p in zip(np.arange(0.4, 4.5, 0.2), phases, strict=True)
        )
        acts = rng.normal(0.0, 0.3, TIMES.size) * (TIMES > 0.0) if isinstance(acts, str) else acts
        y = linear(acts, coupled)
        y = y + rng.normal(0.0, NOISE, y.shape)
        inputs = Inputs.measured(TIMES, acts + rng.normal(0.0, error, TIMES.size), quantity="displacement")
        last = number == trials + 1
        records.append(TrialRecord("I", "I", coupled, number, TIMES, y, 0, inputs=inputs, heldout=last))
    constants = {"J1": (J1, 0.0)} | ({"J2": (J2, 0.0)} if coupled else {})
    return Experiment(constants, ((K1, 0.1),), tuple(records), "displacement", offset_sd=(0.0, 0.0))


@cache
def exact_fit(coupled=False):
    experiment = driven(3, coupled)
    return _with_exact_inputs(experiment, "linear", None, None, lambda _: None)


@pytest.mark.parametrize("coupled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_responses_hold_all_that_noise_of_the_input_does_beside_that_of_the_sensor(coupled):
    """Covariance by brute force: scipy's response to an error of each sample of the torque, one after the other."""
    found = with_input_noise(exact_fit(coupled))
    assert found is not None
    errors = found.trials[0].errors
    U = errors.reshape(len(errors), -1) / NOISE
    sd = input_noise(found.trials[0].inputs)["torque1"]
    assert sd == pytest.approx(0.004, rel=0.15)
    known = {name: value for name, (value, _) in exact_fit(coupled).parameters.items()}
    each = np.array([linear(sd * row, coupled, **known).ravel() for row in np.eye(TIMES.size)]) / NOISE
    whole, left = each.T @ each, each.T @ each - U.T @ U
    largest = np.linalg.eigvalsh(whole)[-1]
    assert largest > 100.0
    # Lines that are left out hold LEAST^2 each, and begin with a swing of the rig that they have in common.
    assert np.abs(np.linalg.eigvalsh(left)).max() < 0.005 * largest
    assert abs(np.trace(left)) < 0.005 * np.trace(whole)


@pytest.mark.slow
def test_a_rig_is_known_as_well_as_noise_of_its_input_lets_it_be():
    """Errors of k1t and c1t over their standard deviations; a held-out trial leaves what the readings' covariance says.

    Taken as exact, the inputs leave several times the noise of the sensor.
    """
    z, left, before = [], [], []
    for seed in range(5):
        fit = calibrate_nominal(experiment := driven(100 + seed), nominal="linear", switches=Switches())
        z += [(x - true) / sd for (x, sd), true in zip(map(fit.parameters.get, ("k1t", "c1t")), (K1, C1), strict=True)]
        unseen = predict(fit, fit.problem.experiment.heldout)[1]
        left.append((unseen.chi2 + unseen.eta @ unseen.eta) / unseen.n_data)
        assert fit.problem.noise.total[0] == pytest.approx(NOISE, rel=0.1)
        if seed < 2:
            rough = _with_exact_inputs(experiment, "linear", Switches(), None, lambda _: None)
            before.append(rough.problem.noise.total[0] / NOISE)
    assert 0.6 < math.sqrt(np.mean(np.square(z))) < 1.5
    assert np.mean(left) == pytest.approx(1.0, abs=0.08)
    assert min(before) > 2.0


def test_what_noise_of_an_input_takes_up_speaks_neither_for_nor_against_a_set_of_effects():
    """One model under two noises: under the larger one sizes of the input noise shrink, readings are missed more."""
    fit = calibrate_nominal(driven(7), nominal="linear", switches=Switches())
    floor = fit.problem.noise.total
    fits = [
        calibrate(fit.problem.with_noise(Noise((f * floor[0],), (0.0,), (0.0,), sensor=floor)), [fit.q], eta=fit.eta)
        for f in (1.0, 4.0)
    ]
    assert followed(fits[0]) > 2.0 * followed(fits[1])
    sharp, blunt = (set_fit((), f).under(np.array(floor)) for f in fits)
    assert sharp == pytest.approx(blunt, abs=0.5)
    stiffer = replace(fit.problem.experiment, stiffnesses=((1.005 * K1, 0.0),))
    noise = fits[0].problem.noise
    wrong = calibrate(Problem(stiffer, nominal="linear", noise=noise, switches=Switches()), [], eta=fit.eta)
    assert followed(wrong) > 2.0 * followed(fits[0])  # where a wrong stiffness hides
    assert left_over(wrong)[0] > left_over(fits[0])[0] + 0.9 * (followed(wrong) - followed(fits[0]))


def test_an_input_as_fast_as_it_is_sampled_is_no_noise():
    """White excitation, measured exactly: its fast content is what drives the rig."""
    experiment = driven(5, error=1e-7, shown="white")
    assert input_noise(experiment.trials[0].inputs)["torque1"] > 0.2
    assert calibrate_nominal(experiment, nominal="linear").problem.experiment.trials[0].errors is None


def test_a_smooth_input_has_no_noise():
    fit = calibrate_nominal(driven(6, error=0.0), nominal="linear")
    assert fit.problem.experiment.trials[0].errors is None
    assert fit.parameters["k1t"][0] == pytest.approx(K1, rel=1e-4)
