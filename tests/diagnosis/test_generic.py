"""Causes that no effect names: laws that change while a trial runs, and channels that are not straight."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_rig import measured
from test_problem import make_experiment

from bayes_damper.calibration import Experiment, TrialRecord
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.generic import (
    CHANGE,
    CURVED,
    ONE_WAY,
    UNKNOWN,
    curved,
    in_words,
    one_way,
    settling,
    site_of,
)
from bayes_damper.diagnosis.search import Candidate, generics_of
from bayes_damper.diagnosis.verdict import family_evidence
from bayes_damper.effects import EFFECTS
from bayes_damper.effects.base import EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.equations import Rig
from bayes_damper.rig.vector_math import lane, tanh


@lane
def _nap(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Friction of the faces that is larger where the primary runs ahead."""
    pull = p[0] * rig.mu * rig.N0 * rig.R * max(0.0, 1.0 - rig.slope * abs(th1 - th2))
    even = pull * tanh(rig.nu * (w1 - w2)) * tanh(rig.nu * (w1 - w2))
    return -even, even


NAP = Variant(
    name="nap", formula="Q = -bias |friction|", torque=_nap,
    parameters=(EffectParameter("bias", "1", "Share.", HalfNormal(1.0), "For this test.", 0.0),),
)  # fmt: skip


def free_decays(torque, sense, begun, seconds, every, noise, stiffness, restoring="linear"):
    """Records of one body of unit inertia by scipy's solver, from (angle, speed) each, read by a sensor."""
    rng, trials = np.random.default_rng(11), []
    times = np.arange(0.0, seconds, every)
    for number, start in enumerate(begun, 1):
        found = solve_ivp(
            lambda t, x: [x[1], torque(t, *x)], (0.0, seconds), start, "DOP853", times, rtol=1e-9, atol=1e-11
        )
        y = sense(found.y[0]) + noise * rng.standard_normal(times.size)
        trials.append(TrialRecord(str(number), "A", False, number, times, y[None], 0, abs(start[0]), 0.0))
    return Experiment(
        {"J1": (1.0, 0.0)}, ((stiffness, 0.02 * stiffness),), tuple(trials), quantity="displacement",
        restoring=restoring, start="free",
    )  # fmt: skip


@pytest.mark.slow
def test_a_damping_that_dies_away_is_no_square_drag():
    """An oil that warms damps a single decay as a drag of the square of the speed nearly does: that had .94."""
    record = free_decays(
        lambda t, x, v: -40.0 * x - (0.23 + 0.85 * math.exp(-t / 4.0)) * v,
        lambda x: x, [(0.06, 0.0)], 18.0, 1.0 / 150.0, 5e-5, 40.3,
    )  # fmt: skip
    found = diagnose(record)
    assert found.verdict == UNKNOWN
    assert found.to_json()["sites"]["bearings"] > 0.5
    leader = found.candidates[0]
    assert (leader.effect, leader.variant.name) == (CHANGE, "settling")
    assert leader.fit.parameters["effect.time"][0] == pytest.approx(4.0, rel=0.1)
    assert any("the torque of the bearings is off by +" in n and "dies away in 4" in n for n in found.notes)


@pytest.mark.slow
def test_a_disc_that_is_not_centred_is_no_stop():
    """A reading that is off by .035 rad once a turn, on a pendulum of 2.3 rad: a stop on one side had .80."""
    begun, off = [(2.3, 0.0), (1.2, 0.3)], 0.9
    records = free_decays(
        lambda t, x, v: -48.0 * math.sin(x) - 0.06 * v - 0.08 * math.tanh(v / 0.01),
        lambda x: x + 0.035 * (np.sin(x + off) - math.sin(off)), begun, 26.0, 0.02, 1e-3, 47.5, "pendulum",
    )  # fmt: skip
    found = diagnose(records)
    assert found.verdict == UNKNOWN
    assert found.to_json()["sites"]["sensor"] > 0.7
    assert found.candidates[0].effect is CURVED
    assert any("a channel that is not straight" in note for note in found.notes)


@pytest.mark.slow
def test_a_face_that_rubs_more_one_way_is_no_release_apart():
    """As the nap of felt does: bodies that begin apart come to rest apart, too, and had .79 on such a rig."""
    campaign = measured(7, torque=None, effect=NAP, values={"bias": 0.5}, cases=(("I", 0, 0.1),), repeats=4, noise=0.4)
    few = {name: EFFECTS[name] for name in ("release_offset", "quadratic_drag")}
    found = diagnose(campaign, effects=few)
    assert found.verdict == UNKNOWN
    assert found.candidates[0].effect is ONE_WAY
    sites = found.to_json()["sites"]
    assert max(sites, key=sites.get) == "interface"
    assert any("drag of the faces is" in note and "larger in one direction" in note for note in found.notes)


def test_drag_in_one_direction_is_the_even_part_of_the_laws():
    """Their sum with the nominal laws is what acts, (1 + a) times them one way and (1 - a) the other."""
    rig = Rig(**dict.fromkeys(Rig._fields, 0.0) | {"c1t": 0.2, "drag": 0.3, "c2t": 0.5, "mu": 0.1, "N0": 2.0, "R": 3.0})
    rig = rig._replace(nu=1e6, slope=1.0)
    for w1, w2 in ((1.0, 0.4), (-1.0, -0.4)):
        q1, q2 = one_way(0.0, 0.2, 0.1, w1, w2, 0.0, 0.0, (0.5, 0.2, 0.4), rig)
        joint = 0.2 * 0.5 * 0.6 + 0.4 * 0.1 * 2.0 * 3.0 * 0.9
        assert q1 == pytest.approx(-0.5 * (0.2 * 1.0 + 0.3) - joint)
        assert q2 == pytest.approx(joint - 0.5 * 0.3)


def test_readings_and_torques_are_those_of_their_formulas():
    assert curved(2.0, 0.1, 0.01, 0.001) == pytest.approx(2.0 + 0.1 * 4.0 + 0.01 * 8.0 + 0.001 * 16.0)
    rig = Rig(**dict.fromkeys(Rig._fields, 0.0) | {"k1t": 3.0, "c1t": 0.2, "k2t": 1.0, "nu": 10.0, "slope": 1.0})
    half = settling(math.log(2.0) * 4.0, 0.1, 0.05, 1.0, 0.5, 0.0, 0.0, (0.5, 1.0, 0.2, 0.0, 4.0), rig)
    spring, bearing, joint = 0.5 * 3.0 * 0.1, 0.2 * 1.0, 0.2 * 1.0 * 0.05
    assert half[0] == pytest.approx(-0.5 * (spring + bearing + joint))
    assert half[1] == pytest.approx(0.5 * joint)


def test_what_a_cause_without_a_name_does_is_said_with_its_size():
    curve = {"effect.square": (-0.01, 0.001), "effect.cube": (0.0, 0.001), "effect.fourth": (0.0, 0.001)}
    assert "off by up to 2.5 % at its largest readings" in in_words(CURVED, curve, 2.5)
    still = {f"effect.{law}": (0.0, 0.3) for law in ("spring", "coupling", "friction")}
    drift = still | {"effect.bearings": (-0.2, 0.01)}
    assert "the torque of the bearings changes by -20 % a second" in in_words(CHANGE, drift, 1.0)
    biased = {f"effect.{law}": (0.0, 0.5) for law in ("bearings", "coupling")} | {"effect.friction": (-0.4, 0.1)}
    assert "the drag of the faces is 40 % larger in one direction" in in_words(ONE_WAY, biased, 1.0)
    assert site_of(ONE_WAY, biased) == "interface"
    fades = drift | {"effect.time": (4.0, 0.1)}
    assert "off by -20 % at the release, which dies away in 4 s" in in_words(CHANGE, fades, 1.0)


def test_what_has_no_name_adds_up_and_a_second_channel_needs_a_second_body():
    """Each kind is as likely beforehand as an effect; the formulas of a kind share that."""
    every = [Candidate(effect, v, (), None, 5.0) for effect, v in generics_of(make_experiment(1, n=50))]
    assert len(every) == 5
    assert family_evidence(every) == {UNKNOWN: pytest.approx(5.0 + math.log(2.0))}
    alone = generics_of(make_experiment(1, n=50, coupled=False))
    assert [v.name for effect, v in alone if effect is CURVED] == ["channel1"]


def test_the_place_of_a_change_is_that_of_the_law_that_changes_most_clearly():
    still = {f"effect.{law}": (0.0, 0.3) for law in ("spring", "coupling", "friction")}
    assert site_of(CHANGE, still | {"effect.bearings": (0.8, 0.1)}) == "bearings"
    assert site_of(CHANGE, still | {"effect.bearings": (0.8, 1.0), "effect.friction": (-0.9, 0.1)}) == "interface"
    assert site_of(CURVED, {}) == "sensor"
