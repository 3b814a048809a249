"""The second channel against the declared inertias: two bodies whose motion is known in closed form."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from campaigns import CAMPAIGN_TOML, J1, J2, decay, write_table
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bayes_damper.campaign import load_campaign
from bayes_damper.campaign.declarations import wiring_of
from bayes_damper.errors import InputError

STEP, K1, K2 = 1e-3, 10.2, 1.2
TIMES = np.arange(1000) * STEP
C1, C2, C3 = 0.011, 0.06, 0.009


def motion(quantity):
    """Of both bodies, released together from 4.7 deg; (2, n) rad/s^2, rad/s or rad, by the matrix exponential."""
    stiffness = np.array([[K1 + K2, -K2], [-K2, K2]]) / np.array([[J1], [J2]])
    damping = np.array([[C1 + C2, -C2], [-C2, C3 + C2]]) / np.array([[J1], [J2]])
    whole = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    step, state, found = expm(STEP * whole), math.radians(4.7) * np.array([1.0, 1.0, 0.0, 0.0]), []
    for _ in TIMES:
        found.append({"acceleration": (whole @ state)[2:], "velocity": state[2:], "displacement": state[:2]}[quantity])
        state = step @ state
    return np.array(found).T


def remarks(
    folder, change=lambda y: y, inertia=J2, spring=K1, alone=0, quantity="acceleration", theta0=4.7, to_ground=""
):
    """Warnings of three coupled trials whose second channel is changed, and whose declared J2 is `inertia`.

    spring : declared k1t; alone : uncoupled trials beside them, of accelerations
    """
    names, noise = {
        "acceleration": (["alpha1_rad_s2", "alpha2_rad_s2"], 0.5), "velocity": (["omega1_rad_s", "omega2_rad_s"], 0.02),
        "displacement": (["theta1_rad", "theta2_rad"], 2e-4),
    }[quantity]  # fmt: skip
    rng = np.random.default_rng(4)
    (folder / "trials").mkdir(parents=True)
    text = (
        CAMPAIGN_TOML.replace("2.474e-3", repr(inertia))
        .replace("noise_std = 2.0\n", "")
        .replace("acceleration", quantity)
    )
    (folder / "campaign.toml").write_text(text)
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,trial"]
    for k in range(3):
        first, second = motion(quantity) + rng.normal(0.0, noise, (2, TIMES.size))
        columns = [TIMES, first, change(np.array([first, second]))]
        write_table(folder / f"trials/{k}.csv", ["time_s", *names], columns)
        rows.append(f"trials/{k}.csv,IV,coupled,{spring},{theta0},{k + 1}")
    for k in range(alone):
        own = decay(TIMES, math.radians(4.7), K1, 0.03) + rng.normal(0.0, 0.5, TIMES.size)
        write_table(folder / f"trials/alone_{k}.csv", ["time_s", "alpha1_rad_s2"], [TIMES, own])
        rows.append(f"trials/alone_{k}.csv,IV,uncoupled,{spring},4.7,{k + 1}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return " ".join(load_campaign(folder).warnings)


def second(y):
    return y[1]


def test_a_sound_pair_is_not_remarked_on(tmp_path):
    text = remarks(tmp_path / "c", second)
    assert "second" not in text, text


CARTS = """\
name = "carts"
[rig]
kind = "translational"
primary_inertia = 0.91
secondary_inertia = 0.49
bar_radius = 1.0
magnet_pull = 1.0
normal_force = "constant"
ground2_stiffness = {{ value = 3.5, std = {std} }}
[measurement]
quantity = "displacement"
start = "free"
"""


def remarks_on_carts(folder, sign, std):
    """Warnings of one decay of two carts in both modes, the second one without a spring to ground."""
    stiffness = np.array([[28.9, -3.0], [-3.0, 3.0]]) / np.array([[0.91], [0.49]])
    damping = np.array([[0.07, -0.02], [-0.02, 0.02]]) / np.array([[0.91], [0.49]])
    whole = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    step, state, found = expm(0.02 * whole), np.array([0.03, 0.0, 0.0, 0.0]), []
    for _ in range(1000):
        found.append(state[:2])
        state = step @ state
    y = np.array(found).T + 1e-4 * np.random.default_rng(0).standard_normal((2, 1000))
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(CARTS.format(std=std))
    write_table(folder / "trials/1.csv", ["time_s", "x1_m", "x2_m"], [0.02 * np.arange(1000), y[0], sign * y[1]])
    (folder / "trials.csv").write_text("file,case,configuration,k1_n_per_m,trial\ntrials/1.csv,A,coupled,26.2,1\n")
    return " ".join(load_campaign(folder).warnings)


@pytest.mark.parametrize(
    ("sign", "std", "said"), [(1.0, 1.75, None), (1.0, 0.1, "add up"), (-1.0, 1.75, "is reversed")]
)
def test_a_spring_to_ground_is_believed_as_far_as_it_is_known(tmp_path, sign, std, said):
    """There is none; 3.5 N/m are declared, which is two standard deviations away, or 35."""
    text = remarks_on_carts(tmp_path / "c", sign, std)
    assert ("add up" not in text) if said is None else (said in text), text


@pytest.mark.parametrize("factor", [1.0 / 3.0, 0.5, 2.0, 3.0])
def test_an_inertia_that_does_not_balance_is_named(tmp_path, factor):
    text = remarks(tmp_path / "c", second, J2 * factor)
    assert "the torques on both bodies add up to zero only with a secondary_inertia of about 0.002" in text


@pytest.mark.parametrize("factor", [0.5, 1.2, 2.0])
def test_a_wrong_spring_is_not_laid_to_the_second_body(tmp_path, factor):
    """Uncoupled trials show the spring; without them either may be wrong."""
    said = "add up to zero only"
    text = remarks(tmp_path / "coupled", second, spring=factor * K1)
    assert said in text
    assert "or k1t or primary_inertia is not as declared" in text
    text = remarks(tmp_path / "both", second, spring=factor * K1, alone=2)
    assert said not in text
    assert ("swings at another frequency than" in text) == (factor != 1.2)  # 10 % of the frequency is the least
    text = remarks(tmp_path / "two", second, 3.0 * J2, spring=factor * K1, alone=2)
    assert f"{said} with a secondary_inertia of about 0.002" in text


def test_clipped_channels_are_not_said_to_be_late(tmp_path):
    text = remarks(tmp_path / "c", lambda y: np.clip(y[1], -20.0, 20.0))
    assert "clipped" in text
    assert "add up to zero" not in text


@pytest.mark.parametrize(("factor", "cause"), [(1e3, "thousandths of"), (1e-3, "thousand times too small")])
def test_where_no_fit_can_follow_it_is_an_error(tmp_path, factor, cause):
    """Such fits ran for minutes and did not converge."""
    with pytest.raises(InputError, match=f"add up to zero only with .*{cause}"):
        remarks(tmp_path / "c", second, J2 * factor)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda y: 0.1 * y[1], r"it may be that it is in m/s\^2 at the bar's end"),
        (lambda y: 2.0 * y[1], "the second channel reads 2"),
        (lambda y: np.concatenate([np.zeros(20), y[1, :-20]]), r"only if the second channel is about (19|2\d) ms late"),
        (lambda y: np.random.default_rng(1).normal(size=TIMES.size), "shows nothing but noise while the primary moves"),
    ],
)
def test_a_second_channel_that_cannot_be_is_a_warning(tmp_path, change, said):
    assert re.search(said, remarks(tmp_path / "c", change))


def test_a_late_channel_that_another_inertia_would_balance_is_said_to_be_late(tmp_path, monkeypatch):
    """A weak coupling: 20 ms are a tenth of the second body's swing, and half more inertia does nearly as well."""
    for name, value in (("K2", 0.8), ("C2", 0.003)):
        monkeypatch.setattr(sys.modules[__name__], name, value)
    found = remarks(tmp_path / "c", lambda y: np.interp(TIMES - 0.02, TIMES, y[1]))
    assert "only if the second channel is 8.6 to 21 ms late" in found
    assert "secondary_inertia" not in found
    assert "add up to zero" not in remarks(tmp_path / "sound", second)


@pytest.mark.parametrize("quantity", ["acceleration", "velocity"])
@pytest.mark.parametrize("late", [40, 60, 100])
def test_a_channel_that_is_late_by_up_to_a_period_is_said_to_be_late(tmp_path, quantity, late):
    """A period of the primary on its spring is 108 ms."""
    text = remarks(tmp_path / "c", lambda y: np.concatenate([np.zeros(late), y[1, :-late]]), quantity=quantity)
    found = re.search(r"only if the second channel is (?:about (\d+)|(\d+) to (\d+)) ms late", text)
    assert found, text
    about, least, most = found.groups()
    assert float(about or least) - 3.0 <= late <= float(about or most) + 3.0


@pytest.mark.parametrize("factor", [-3.0, -2.0, -0.5, -0.3, 3.0])
def test_another_scale_is_not_taken_for_a_channel_that_is_late(tmp_path, factor):
    """A half of a period later a decay has changed its sign and become smaller."""
    text = remarks(tmp_path / "c", lambda y: factor * y[1])
    assert "ms late" not in text
    assert "ms early" not in text


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_a_second_channel_that_is_turned_round_shows_by_the_sum_of_torques(tmp_path, monkeypatch, factor):
    """A weak coupling: after the release the second body hardly moves. A wrong inertia is not taken for that."""
    for name, value in (("K2", 0.8), ("C2", 0.003)):
        monkeypatch.setattr(sys.modules[__name__], name, value)
    said = "case IV: the torques on both bodies add up to zero only if the sign of the second channel is reversed"
    text = remarks(tmp_path / "turned", lambda y: -y[1], factor * J2, quantity="velocity")
    assert (said in text) == (factor == 1.0)
    assert "its sign looks reversed" not in text
    assert "sign" not in remarks(tmp_path / "sound", second, factor * J2, quantity="velocity")


@pytest.mark.parametrize("quantity", ["acceleration", "velocity"])
def test_where_the_first_channel_is_reversed_no_message_says_that_it_is_the_second(tmp_path, quantity):
    text = remarks(tmp_path / "c", lambda y: -y[1], quantity=quantity, theta0=-4.7)
    assert "add up to zero only if the sign of the first channel is reversed" in text
    assert "--sign -1 1" in text
    assert "second" not in text


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_copy_of_the_first_channel_is_an_error(tmp_path, scale):
    with pytest.raises(InputError, match="column 'alpha1_rad_s2', noise and all"):
        remarks(tmp_path / "c", lambda y: scale * y[0])


@pytest.mark.parametrize("value", ["1e308", "-1.0", "true"])
def test_a_wrong_inertia_is_not_called_missing(tmp_path, value):
    with pytest.raises(InputError) as told:
        remarks(tmp_path / "c", second, type("Raw", (), {"__repr__": lambda _: value})())
    assert "missing" not in str(told.value)
    assert "secondary_inertia" in str(told.value)


def test_velocities_of_a_scale_that_no_primary_has_are_not_called_exchanged(tmp_path, monkeypatch):
    """Their noise is above the motion at first, and hides when it began."""
    monkeypatch.setattr(sys.modules[__name__], "C2", 0.3)
    text = remarks(tmp_path / "c", lambda y: 9.81 * y[1], quantity="velocity")
    assert "exchanged" not in text
    assert "the second channel reads" in text


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_a_displacement_that_reads_a_part_is_not_called_reversed(tmp_path, monkeypatch, share):
    """It stands where a body of its own may be held; turned round, it would go farther than the primary draws it."""
    monkeypatch.setattr(sys.modules[__name__], "C2", 0.3)
    text = remarks(tmp_path / "part", lambda y: share * y[1], quantity="displacement")
    assert "the second channel reads" in text
    assert "reversed" not in text


def test_noise_of_the_first_readings_turns_no_channel_round(tmp_path):
    """A second channel that is late stands still at first, where three readings say that it was held."""
    remarks(tmp_path / "c", second, quantity="displacement")
    campaign, rng = load_campaign(tmp_path / "c"), np.random.default_rng(1)
    y = motion("displacement")
    late = np.array([y[0], np.concatenate([np.full(10, y[1, 0]), y[1, :-10]])])
    found = []
    for changed in (late, y * [[1.0], [-1.0]]):
        noisy = [replace(campaign.trials[0], channels=changed + rng.normal(0.0, 2e-4, y.shape)) for _ in range(1500)]
        found.append([wiring_of(campaign, trial) for trial in noisy])
    assert set(found[0]) == {None}
    assert set(found[1]) <= {"reversed", "mirrored"}


def with_dry_friction(quantity, first, second_body, stiffness):
    """As `motion`, with dry friction in both bearings (N m) and another coupling, by scipy's LSODA."""

    def slopes(_, x):
        coupling = stiffness * (x[0] - x[1]) + 0.02 * (x[2] - x[3])
        return [
            *x[2:],
            (-K1 * x[0] - C1 * x[2] - coupling - first * math.tanh(x[2] / 0.02)) / J1,
            (coupling - C3 * x[3] - second_body * math.tanh(x[3] / 0.02)) / J2,
        ]

    start = [math.radians(4.7)] * 2 + [0.0, 0.0]
    x = solve_ivp(slopes, (0.0, TIMES[-1]), start, "LSODA", TIMES, rtol=1e-8, atol=1e-10).y
    shown = {"displacement": x[:2], "velocity": x[2:], "acceleration": np.array([slopes(0.0, s)[2:] for s in x.T]).T}
    return shown[quantity]


@pytest.mark.parametrize(
    ("quantity", "first", "second_body", "stiffness"),
    [
        ("velocity", 0.05, 0.1, 3.0), ("velocity", 0.1, 0.1, 3.0), ("velocity", 0.02, 0.05, 1.2),
        ("acceleration", 0.02, 0.05, 3.0), ("acceleration", 0.1, 0.1, 3.0), ("displacement", 0.1, 0.05, 1.2),
    ],
)  # fmt: skip
def test_dry_friction_in_the_bearings_is_not_taken_for_a_late_channel(
    tmp_path, monkeypatch, quantity, first, second_body, stiffness
):
    moved = with_dry_friction(quantity, first, second_body, stiffness)
    monkeypatch.setattr(sys.modules[__name__], "motion", lambda _: moved)
    assert "add up to zero" not in remarks(tmp_path / "c", second, quantity=quantity)
