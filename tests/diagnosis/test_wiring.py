"""Channels under a wrong name: told as such, at the sensors, and never where the wiring is right."""

from dataclasses import replace

import numpy as np
import pytest
from small_rig import knock, measured

from bayes_damper.calibration import Experiment, calibrate_nominal
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.wiring import miswired
from bayes_damper.effects import EFFECTS


def rewired(experiment: Experiment, change, coupled_only: bool = True) -> Experiment:
    trials = [
        replace(t, y=np.ascontiguousarray(change(t.y))) if t.coupled or not coupled_only else t
        for t in experiment.trials
    ]
    return replace(experiment, trials=tuple(trials))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda y: y[::-1], "channels exchanged"),
        (lambda y: y * np.array([[1.0], [-1.0]]), "channel 2 reversed"),
    ],
)
def test_a_wrong_wiring_is_told_and_lies_at_the_sensors(change, words):
    few = {name: EFFECTS[name] for name in ("spring_cubic",)}
    found = diagnose(rewired(measured(2), change), effects=few)
    assert found.verdict == "unknown"
    assert found.sites["sensor"] > 0.9
    assert words in found.notes[0]


@pytest.mark.slow
def test_reversed_signs_of_all_channels_are_told():
    found = miswired(calibrate_nominal(rewired(measured(3), lambda y: -y, coupled_only=False)))
    assert found is not None
    assert "all channels" in found.words
    assert found.after < 0.05 < 0.5 < found.before


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_a_rig_that_is_wired_rightly_is_not_doubted(size):
    """Neither without a gap nor with a blow that no law explains, as strong as the spring."""
    assert miswired(calibrate_nominal(measured(4, torque=knock(0.1, 0.05, size)))) is None
