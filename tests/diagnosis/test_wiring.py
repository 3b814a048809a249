"""Channels under a wrong name: told as such, at the sensors, and never where the wiring is right."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from small_rig import knock, measured

from bayes_damper.calibration import Experiment, TrialRecord, calibrate_nominal
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.wiring import _rewired, miswired
from bayes_damper.effects import EFFECTS


def rewired(experiment: Experiment, change, coupled_only: bool = True) -> Experiment:
    trials = [
        replace(t, y=np.ascontiguousarray(change(t.y))) if t.coupled or not coupled_only else t
        for t in experiment.trials
    ]
    return replace(experiment, trials=tuple(trials))


@pytest.mark.slow
def test_a_wrong_wiring_is_told_and_lies_at_the_sensors():
    few = {name: EFFECTS[name] for name in ("spring_cubic",)}
    found = diagnose(rewired(measured(2), lambda y: y * np.array([[1.0], [-1.0]])), effects=few)
    assert found.verdict == "unknown"
    assert found.sites["sensor"] > 0.9
    assert "channel 2 reversed" in found.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "change", "coupled_only", "words", "poor"),
    [(2, lambda y: y[::-1], True, "channels exchanged", 0.1), (3, lambda y: -y, False, "all channels", 0.5)],
    ids=["exchanged", "reversed"],
)
def test_other_wrong_wirings_are_told(seed, change, coupled_only, words, poor):
    found = miswired(calibrate_nominal(rewired(measured(seed, repeats=2), change, coupled_only)))
    assert found is not None
    assert words in found.words
    assert found.after < 0.05 < poor < found.before


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_a_rig_that_is_wired_rightly_is_not_doubted(size):
    """Neither without a gap nor with a blow that no law explains, as strong as the spring."""
    assert miswired(calibrate_nominal(measured(4, repeats=2, torque=knock(0.1, 0.05, size)))) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda y: y, None),
        (lambda y: y * np.array([[1.0], [-1.0]]), "channel 1 or of channel 2 reversed"),
        (lambda y: y[::-1], "channels exchanged"),
    ],
    ids=["right", "reversed", "exchanged"],
)
def test_two_bodies_that_start_free_show_how_they_are_wired(change, words):
    whole = rewired(measured(2), change)
    cut = [
        replace(t, times=t.times[40:] - t.times[40], y=np.ascontiguousarray(t.y[:, 40:]), theta0=0.0, theta0_sd=0.0)
        for t in whole.trials
        if t.coupled
    ]
    found = miswired(calibrate_nominal(replace(whole, start="free", trials=tuple(cut))))
    assert (found is None) if words is None else (found is not None and words in found.words)


def carts(flip: float) -> Experiment:
    """One long decay of two carts on three springs by the matrix exponential, which start free in mid-swing."""
    k1, k2, k3, c1, c2 = 40.0, 15.0, 10.0, 0.03, 0.04
    stiff, damp = np.array([[k1 + k2, -k2], [-k2, k3 + k2]]), np.array([[c1 + c2, -c2], [-c2, c2]])
    M = np.array([0.8, 0.6])[:, None]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiff / M, -damp / M]])
    times = np.arange(0.0, 18.0, 0.02)
    step, state, y = expm(A * 0.02), np.array([0.03, 0.01, 0.0, 0.05]), []
    for _ in times:
        y.append(state[:2])
        state = step @ state
    y = np.array(y).T * np.array([[1.0], [flip]]) + 1e-4 * np.random.default_rng(1).standard_normal((2, times.size))
    constants = {
        "J1": (0.8, 0.02),
        "J2": (0.6, 0.02),
        "R": (1.0, 0.0),
        "r": (1.0, 0.0),
        "N0": (1.0, 0.0),
        "k3t": (12.0, 4.0),
    }
    trial = TrialRecord("carts", "I", True, 1, times, y, 0, 0.0, 0.0)
    return Experiment(
        constants, ((41.0, 2.0),), (trial,), quantity="displacement", start="free", normal_force="constant"
    )


@pytest.mark.slow
def test_one_long_record_of_two_carts_shows_a_reversed_sensor():
    """Reversed, the nominal fit ends where no period of the record agrees, and its residuals are no noise."""
    found = miswired(calibrate_nominal(carts(-1.0)))
    assert found is not None
    assert "channel 2 reversed" in found.words
    assert found.after < 1e-4
    assert found.gain > 30.0
    assert miswired(calibrate_nominal(carts(1.0))) is None


def test_the_noise_of_a_channel_goes_with_its_readings():
    fit = calibrate_nominal(measured(2, duration=0.15, repeats=2))
    trials = [replace(t, spread=np.stack([np.full(t.times.size, k + 1.0) for k in range(len(t.y))]))
              for t in fit.problem.experiment.trials]  # fmt: skip
    own = fit.problem.changed(experiment=replace(fit.problem.experiment, trials=tuple(trials)))
    exchanged = _rewired(own.experiment, lambda y: y[::-1]).trials
    assert all(np.array_equal(new.spread, old.spread[::-1]) for new, old in zip(exchanged, trials, strict=True))
