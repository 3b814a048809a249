"""Runs of ensembles: known posteriors, the verdict, and runs that are stopped, killed or spread over processes."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayes_damper.checkpoint import Checkpoint
from bayes_damper.errors import InputError, Interrupted
from bayes_damper.sampling import StoppingRule, diagnose_draws, find_start, sample
from bayes_damper.sampling.convergence import stranded_walkers


class Gaussian:
    """A correlated normal density with badly scaled coordinates."""

    def __init__(self, ndim=3, pause=0.0):
        rng = np.random.default_rng(ndim)
        root = rng.standard_normal((ndim, ndim)) * 10.0 ** rng.uniform(-2, 2, ndim)[:, None]
        self.names = tuple(f"p{i}" for i in range(ndim))
        self.ndim = ndim
        self.covariance = root @ root.T
        self.inverse_root = np.linalg.inv(np.linalg.cholesky(self.covariance))
        self.pause = pause

    def __call__(self, points):
        time.sleep(self.pause)
        white = np.einsum("ij,kj->ik", points, self.inverse_root)
        return -0.5 * (white**2).sum(axis=1)


def start_of(target):
    rng = np.random.default_rng(0)
    draws = 8.0 * rng.standard_normal((300, target.ndim)) * np.sqrt(np.diag(target.covariance))
    return find_start(target, draws, rng)


def test_start_is_the_optimum_with_the_local_covariance():
    target = Gaussian(6)
    start = start_of(target)
    shape = target.inverse_root @ start.covariance @ target.inverse_root.T
    assert start.log_prob > -0.1
    assert np.linalg.eigvalsh(shape).min() > 0.7
    assert np.linalg.eigvalsh(shape).max() < 1.4


def test_start_without_any_finite_point_says_so():
    with pytest.raises(InputError, match="zero at all 20 points"):
        find_start(lambda x: np.full(len(x), -np.inf), np.zeros((20, 2)), np.random.default_rng(0))


def test_gaussian_is_recovered_and_the_rule_is_met():
    target = Gaussian(4)
    result = sample(target, start_of(target), seed=3)
    assert result.converged, result.verdict.sentences
    sd = np.sqrt(np.diag(target.covariance))
    assert np.abs(result.flat().std(axis=0) / sd - 1).max() < 0.05
    assert np.abs(result.flat().mean(axis=0) / sd).max() < 0.08
    assert result.draws.shape[0] == 4
    assert result.draws.shape[2:] == (64, 4)


def test_a_short_budget_gives_a_verdict_and_advice():
    target = Gaussian(3)
    rule = StoppingRule(ess=1e7, max_steps=200)
    result = sample(target, start_of(target), seed=3, rule=rule)
    assert not result.converged
    assert "more steps" in " ".join(result.verdict.sentences)


def test_two_processes_give_what_one_gives():
    target = Gaussian(3)
    start = start_of(target)
    one, two = (sample(target, start, seed=5, workers=n) for n in (1, 2))
    assert one.draws.tobytes() == two.draws.tobytes()
    assert one.log_prob.tobytes() == two.log_prob.tobytes()


RULE = StoppingRule(ess=1e7, max_steps=300)


def test_an_interrupted_run_goes_on_bit_for_bit(tmp_path):
    target = Gaussian(3)
    start = start_of(target)
    whole = sample(target, start, seed=5, rule=RULE)
    calls = []

    def stop(progress):
        calls.append(progress)
        if len(calls) in (2, 6):
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(Interrupted, match="saved"):
            sample(target, start, seed=5, rule=RULE, checkpoint=Checkpoint(tmp_path, {}), progress=stop)
    again = sample(target, start, seed=5, rule=RULE, checkpoint=Checkpoint(tmp_path, {}))
    assert again.draws.tobytes() == whole.draws.tobytes()
    with pytest.raises(InputError, match="seed was 5"):
        sample(target, start, seed=6, rule=RULE, checkpoint=Checkpoint(tmp_path, {}))
    longer = sample(
        target, start, seed=5, rule=StoppingRule(ess=1e7, max_steps=400), checkpoint=Checkpoint(tmp_path, {})
    )
    assert longer.draws[:, : whole.draws.shape[1]].tobytes() == whole.draws.tobytes()


CHILD = """
import sys
sys.path.insert(0, sys.argv[2])
from test_sampling import Gaussian, RULE, start_of
from bayes_damper.checkpoint import Checkpoint
from bayes_damper.sampling import sample
target = Gaussian(3, pause=0.001)
sample(target, start_of(Gaussian(3)), seed=5, rule=RULE, checkpoint=Checkpoint(sys.argv[1], {}, every=0.02))
"""


def test_a_run_killed_at_random_moments_ends_as_if_never_stopped(tmp_path):
    target = Gaussian(3)
    start = start_of(target)
    whole = sample(target, start, seed=5, rule=RULE)
    rng = np.random.default_rng(1)
    killed = 0
    for _ in range(4):
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path), str(Path(__file__).parent)])
        until = time.monotonic() + 20
        before = {p.name for p in tmp_path.glob("state-*.npz")}
        while child.poll() is None and {p.name for p in tmp_path.glob("state-*.npz")} == before:
            assert time.monotonic() < until
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.3))
        child.send_signal(signal.SIGKILL)
        killed += child.wait() == -signal.SIGKILL
    assert killed > 0
    again = sample(target, start, seed=5, rule=RULE, checkpoint=Checkpoint(tmp_path, {}))
    assert again.draws.tobytes() == whole.draws.tobytes()


def test_too_few_walkers_are_refused():
    target = Gaussian(6)
    with pytest.raises(InputError, match="even number, at least 12"):
        sample(target, start_of(target), seed=1, walkers=10)


def test_effective_size_is_that_of_an_autoregression():
    """x(t) = a x(t-1) + e has tau = (1 + a) / (1 - a)."""
    rng = np.random.default_rng(0)
    a = 0.8
    x = np.zeros((4, 2000, 16))
    noise = np.sqrt(1 - a**2) * rng.standard_normal(x.shape)
    x[:, 0] = rng.standard_normal((4, 16))
    for t in range(1, x.shape[1]):
        x[:, t] = a * x[:, t - 1] + noise[:, t]
    got = diagnose_draws(x)
    assert got.tau == pytest.approx(9.0, rel=0.2)
    assert got.ess_bulk == pytest.approx(x.size / 9.0, rel=0.15)
    assert got.r_hat < 1.01
    assert diagnose_draws(x + np.array([0, 0, 0, 1.0])[:, None, None]).r_hat > 1.05


def test_few_draws_are_no_error():
    assert np.isnan(diagnose_draws(np.zeros((4, 3, 8))).ess_bulk)


def test_a_stranded_walker_is_found():
    heights = np.random.default_rng(0).standard_normal((2, 100, 16))
    heights[1, :, 3] -= 60.0
    assert stranded_walkers(heights) == ((1, 3),)
