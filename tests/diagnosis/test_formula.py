"""What an inexact formula leaves open: the torque that a fit adds, and intervals that widen with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_pipeline import with_effect
from test_problem import RIG, TRUE

from bayes_damper.calibration import Calibration, Experiment, Problem, TrialRecord, calibrate, summarise
from bayes_damper.diagnosis.formula import widened
from bayes_damper.diagnosis.response import motions
from bayes_damper.diagnosis.result import _estimate
from bayes_damper.effects import EFFECTS
from bayes_damper.priors.distributions import from_standard
from bayes_damper.simulation.links import of_links


def fitted(effect: str, made_by: str, values: dict[str, float], explained_by: str) -> Calibration:
    """A campaign made by one formula of an effect and fitted with another one."""
    return calibrate(Problem(with_effect(effect, made_by, values), EFFECTS[effect].variant(explained_by)))


@pytest.fixture(scope="module")
def drag():
    return fitted("quadratic_drag", "alike", {"coefficient": 0.8}, "alike")


def test_the_torque_that_an_effect_adds_is_that_of_its_formula(drag):
    """Inertia times acceleration less the nominal laws is -b J1 w |w| on each body, nothing before the release."""
    q = RIG["J1"] * drag.parameters["effect.coefficient"][0]
    for motion in motions(drag):
        moving = motion.since > 0.0
        largest = q * np.max(motion.w1**2)
        for inertia, w in enumerate((motion.w1, motion.w2)):
            formula = np.where(moving, -q * w * np.abs(w), 0.0)
            # beside a reversal of the drag the acceleration hangs on the velocity's last digits
            off = np.abs(motion.added[:, inertia] - formula) / largest
            assert np.median(off) < 1e-3
            assert np.quantile(off, 0.99) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "name"),
    [
        ("interface_friction", None),
        ("bearing_drag", None),
        ("quadratic_drag", "by_inertia"),
        ("quadratic_drag", "first"),
        ("quadratic_drag", "second"),
    ],
)
def test_the_torque_that_an_effect_adds_to_two_links_is_that_of_its_formula(effect, name):
    """Wide swings of a double pendulum, whose inertia turns and whose first arm carries the second through the air."""
    times = np.arange(0.0, 4.0, 0.01)
    trial = TrialRecord("a", "A", True, 1, times, np.ones((2, times.size)), 0, theta0=1.0)
    constants = {"J1": 1.0, "J2": 0.5, "J12": 0.45, "k3t": 25.0, "N0": 1.0, "R": 1.0}
    experiment = Experiment(
        {name: (value, 0.0) for name, value in constants.items()}, ((60.0, 0.0),), (trial,), "displacement",
        normal_force="constant", restoring="pendulum", coupling_law="cosine",
        priors={"k2t": 0.0, "c1t": 0.02, "c2t": 0.01, "c3t": 0.3, "mu": 0.0, "drag": 0.2, "nu": 40.0, "tail": 0.0},
    )  # fmt: skip
    variant = EFFECTS[effect].variants[-1] if name is None else EFFECTS[effect].variant(name)
    problem = Problem(experiment, of_links(variant) if EFFECTS[effect].site == "bearings" else variant)
    fit = summarise(problem, np.full(problem.size, 0.5), problem.no_nuisance(), True, 0, central=False)
    p = {name.removeprefix("effect."): value for name, (value, _) in fit.parameters.items()}
    (m,) = motions(fit)
    lever = constants["J12"] / constants["J2"] * np.cos(m.phi)
    if effect == "interface_friction":
        q = p["torque"] * np.tanh(p["smoothing"] * m.slip)
        expected = -q, q
    elif effect == "bearing_drag":
        expected = -p["drag"] * np.tanh(p["smoothing"] * m.w1), 0.0 * m.w1
    else:
        v = m.w2 + lever * m.w1
        q2 = -p["coefficient"] * constants["J2"] * v * np.abs(v) * (name != "first")
        expected = -p["coefficient"] * m.w1 * np.abs(m.w1) * (name != "second") + lever * q2, q2
    assert np.abs(m.phi).max() > 0.3
    for found, right in zip(m.added[0], expected, strict=True):
        off = np.abs(found - np.where(m.since[0] > 0.0, right[0], 0.0)) / np.max(np.abs(expected))
        assert np.median(off) < 1e-3
        assert np.quantile(off, 0.99) < 0.03


def test_intervals_widen_where_another_formula_could_pass_for_a_nominal_law(drag):
    """A drag's inexact law makes the bearings' damping and friction less certain, the coupling hardly."""
    sd = {name: value[1] for name, value in drag.parameters.items()}
    wide = {name: value[1] for name, value in widened(drag, ["bearings"]).parameters.items()}
    assert all(wide[name] >= sd[name] * (1.0 - 1e-9) for name in sd)
    assert wide["c1t"] / sd["c1t"] > 2.0 * wide["k2t"] / sd["k2t"]
    less = {name: value[1] for name, value in widened(drag, ["bearings"], share=0.05).parameters.items()}
    assert sd["c1t"] < less["c1t"] < wide["c1t"]


def test_no_interval_reaches_beyond_what_the_prior_leaves(drag):
    """A stop at a thousandth of its prior's median, which formulas of its family move by 6 standard deviations."""
    i = drag.problem.names.index("k2t")
    prior = drag.problem.coordinates[i].prior
    q, covariance = drag.q.copy(), drag.covariance.copy()
    q[i], covariance[i, i] = -7.8, 36.0
    open_ = replace(drag, q=q, covariance=covariance)
    ends = from_standard(prior, np.array([-7.8 - 1.645, 1.645]))
    assert open_.interval("k2t") == pytest.approx(ends, rel=1e-3)
    assert open_.parameters["k2t"][1] < 0.5 * from_standard(prior, 1.0)
    assert _estimate(open_, "k2t", "N m/rad")["prior_share"] == 1.0
    assert _estimate(drag, "k2t", "N m/rad")["prior_share"] < 0.01


def test_a_definition_leaves_nothing_open(drag):
    """Where an effect's site has no laws, or nothing is added to them, the fit stays as it is."""
    assert widened(drag, ["sensor", "release"]) is drag
    bare = replace(drag, problem=drag.problem.with_effect(None), q=drag.q[:-1])
    bare = replace(bare, linear=bare.problem.linearise(bare.q, bare.eta))
    assert widened(bare, ["bearings"]) is bare


@pytest.mark.slow
def test_the_truth_lies_within_reach_when_a_formula_of_the_family_stands_for_another():
    """Two relaxing arms fitted as one: off by several of the fit's own standard deviations, not of the widened ones."""
    found = fitted("interface_relaxation", "two_arms", {"stiffness": 1.0, "time": 0.01}, "one_arm")
    wide = widened(found, ["interface"])
    for name in ("k2t", "c2t"):
        off = abs(found.parameters[name][0] - TRUE[name])
        assert off > 3.0 * found.parameters[name][1]
        assert off < 2.0 * wide.parameters[name][1]
