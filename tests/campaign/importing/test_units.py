"""From raw numbers to SI units."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayes_damper.campaign.importing.units import _middle, convert
from bayes_damper.errors import InputError


def test_tangential_units() -> None:
    ones = np.ones(2)
    assert convert(ones, "g", "torsional", "acceleration", 0.1, "x") == pytest.approx([98.0665] * 2)
    assert convert(ones, "deg", "torsional", "displacement", None, "x") == pytest.approx([math.pi / 180.0] * 2)
    assert convert(ones, "mm", "translational", "displacement", None, "x") == pytest.approx([1e-3] * 2)


def test_the_sideways_position_of_a_marker_becomes_an_angle() -> None:
    """Of 0.5 rad the arc x / L is 4 % less: a sound pendulum would seem to have a wrong law of gravity."""
    angle = np.linspace(-0.5, 0.5, 5)
    x = 620.0 * np.sin(angle)
    straight = convert(x, "mm", "torsional", "displacement", 0.62, "x", sideways=True)
    assert straight == pytest.approx(angle, abs=1e-12)
    assert convert(x, "mm", "torsional", "displacement", 0.62, "x") == pytest.approx(np.sin(angle))
    for unit, kind, quantity, faulty, sentence in (
        ("deg", "torsional", "displacement", x, "not for 'deg'"),
        ("mm", "translational", "displacement", x, "of a turning rig"),
        ("mm/s", "torsional", "velocity", x, "not for 'mm/s'"),
        ("mm", "torsional", "displacement", 4.0 * x, "reaches 1.92 times the mounting radius"),
    ):
        with pytest.raises(InputError, match=sentence):
            convert(faulty, unit, kind, quantity, 0.62, "x", sideways=True)


@pytest.mark.parametrize("periods", [2.6, 3.4, 5.1])
def test_the_middle_of_a_swing_that_decays_is_found(periods: float) -> None:
    """By dry friction, which takes the same from each swing; a windowed mean alone is off by up to a tenth."""
    u = np.linspace(0.0, 1.0, 700)
    for phase in np.arange(0.0, 6.0, 0.7):
        swing = (1.0 - 0.3 * u) * np.cos(2.0 * np.pi * periods * u * (1.0 + 0.02 * u) + phase)
        assert abs(_middle(31.5 + swing) - 31.5) < 3e-3
