"""Sequential Monte Carlo: an honest error, steps that keep the target, runs that go on where they stopped."""

import math

import numpy as np
import pytest
from scipy import stats

from bayes_damper.errors import InputError
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling.moves import StudentT
from bayes_damper.sampling.sequential import (
    Block,
    Plain,
    Powers,
    UnitPrior,
    Whole,
    next_temperature,
    systematic,
    temper,
)
from bayes_damper.sampling.steps import Guided, Shaped

MASS = 3.0


def bell(ndim):
    """A Gaussian of mass e^3 off the Student t that the particles are drawn from."""
    begin = StudentT(np.zeros(ndim), np.eye(ndim), 6.0)
    density = stats.multivariate_normal(np.full(ndim, 1.5), 0.3 * np.eye(ndim) + 0.2)
    return Whole(ndim, begin.draw, begin.log_density, Powers(lambda x: MASS + density.logpdf(x) - begin.log_density(x)))


def test_the_stated_error_is_the_scatter_of_the_evidence():
    """Few particles, whose siblings are alike: what single stages show would be half of it. And next to no bias, which
    a mixture that learns from the very particles it moves would bring.
    """
    found = [temper(bell(5), np.random.default_rng(k), 96, settle=False) for k in range(16)]
    away = np.array([f.log_z for f in found]) - MASS
    stated = math.sqrt(np.mean([f.error**2 for f in found]))
    assert abs(away.mean()) < 4.0 * away.std(ddof=1) / math.sqrt(len(away)) + 0.05
    assert 0.6 < stated / away.std(ddof=1) < 1.8


class Cut(UnitPrior, Plain):
    """A unit Gaussian of three coordinates cut at x = 1, in two blocks, with given steps."""

    ndim, parts = 3, 1

    def __init__(self, steps):
        only = np.zeros(1, dtype=np.intp)
        self.blocks = [
            Block(np.array([0, 1]), only, given=np.array([2]), steps=steps),
            Block(np.array([2]), only, steps=steps),
        ]

    def measure(self, points, parts):
        return np.where(points[:, 0] > 1.0, 0.0, -np.inf)[:, None, None]

    def height(self, measured, parts, temperature):
        return measured[:, :, 0]


@pytest.mark.parametrize("steps", [None, Shaped, Guided], ids=["by block", "shaped", "guided"])
def test_every_kind_of_step_keeps_the_target(steps):
    found = temper(Cut(steps), np.random.default_rng(3), 600, kept=4)
    tail = stats.norm.sf(1.0)
    assert found.log_z == pytest.approx(math.log(tail), abs=4.0 * found.error)
    assert found.error < 0.1
    assert found.points[:, 0].min() > 1.0
    mean = stats.norm.pdf(1.0) / tail
    assert found.points[:, 0].mean() == pytest.approx(mean, abs=0.04)
    assert found.points[:, 0].var() == pytest.approx(1.0 + mean - mean**2, abs=0.03)
    assert found.points[:, 1:].mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.12)
    assert found.points[:, 1:].std(axis=0) == pytest.approx([1.0, 1.0], abs=0.08)


class Stopped(Exception):
    """Raised where a run is broken off."""


@pytest.mark.parametrize("settle", [True, False])
def test_a_run_that_was_stopped_goes_on_to_the_same_result(tmp_path, monkeypatch, settle):
    def run(stop, checkpoint):
        stages = []

        def tell(temperature, text):
            stages.append(text)
            if len(stages) == stop:
                raise Stopped

        found = temper(bell(4), np.random.default_rng(5), 64, tell, 2, settle, checkpoint=checkpoint)
        return found, stages

    whole, all_stages = run(0, None)
    assert len(all_stages) >= 3
    checkpoint = Checkpoint(tmp_path / "state", {"seed": "5"})
    monkeypatch.setattr(Checkpoint, "due", lambda self: True)
    with pytest.raises(Stopped):
        run(3, checkpoint)
    found, left = run(0, checkpoint)
    assert len(left) == len(all_stages) - 2
    assert found.log_z == whole.log_z
    assert found.error == whole.error
    assert found.evaluations == whole.evaluations
    assert np.array_equal(found.points, whole.points)
    with pytest.raises(InputError, match="particles was 64"):
        temper(
            bell(4),
            np.random.default_rng(5),
            65,
            settle=settle,
            checkpoint=Checkpoint(tmp_path / "state", {"seed": "5"}),
        )


def test_the_next_temperature_leaves_half_of_those_that_can_count():
    like = np.array([-np.inf] * 50 + list(np.linspace(-200.0, 0.0, 50)))

    def gain(to):
        return np.where(np.isfinite(like), to * np.maximum(like, -1e300), -np.inf)

    found = next_temperature(gain, 0.0)
    weights = np.exp(gain(found))
    assert weights.sum() ** 2 / (weights**2).sum() == pytest.approx(25.0, rel=1e-3)
    assert next_temperature(lambda to: 0.01 * gain(to), 0.3) == 1.0


def test_systematic_resampling_takes_each_as_often_as_its_share():
    share = np.array([0.5, 0.0, 0.3, 0.2])
    chosen = systematic(share, 100, np.random.default_rng(0))
    assert np.all(np.abs(np.bincount(chosen, minlength=4) - 100 * share) <= 1)
    assert np.all(np.diff(chosen) >= 0)
