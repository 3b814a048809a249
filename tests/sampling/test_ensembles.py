"""Runs of ensembles: known posteriors, the verdict, and runs that are stopped, killed or spread over processes."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import digamma, polygamma

from bayes_damper.errors import InputError, Interrupted
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling import Start, StoppingRule, diagnose_draws, sample
from bayes_damper.sampling.convergence import judge, stranded_walkers
from bayes_damper.sampling.ensembles import _after_round, _fingerprint, _moves, _Run
from bayes_damper.sampling.moves import fit_mixture
from bayes_damper.sampling.normal_scores import InScores
from bayes_damper.sampling.sequential import Powers
from bayes_damper.sampling.start import annealed_start, cloud, resampled_start


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
    return Start(np.zeros(target.ndim), target.covariance, 0.0, 1)


def unit_normal(points):
    return -0.5 * (points**2 + np.log(2.0 * np.pi)).sum(axis=1)


def two_narrow_modes(points):
    """Likelihood: 0.25 of a narrow bump at -1.5, 0.75 of a wider one at +1.5, in the first of two coordinates."""
    x, y = points.T
    bumps = [
        np.log(w) - 0.5 * (((x - c) / s) ** 2 + ((y - 0.5) / s) ** 2) - 2.0 * np.log(s)
        for w, c, s in ((0.25, -1.5, 0.05), (0.75, 1.5, 0.1))
    ]
    return np.logaddexp(*bumps)


def test_an_annealed_population_has_the_weights_and_shapes_of_both_modes():
    """With a unit normal prior each mode is again a normal, of known weight, mean and width."""
    widths, centres = np.array([0.05, 0.1]), np.array([-1.5, 1.5])
    sd = widths / np.sqrt(1.0 + widths**2)
    # Evidence of each mode: its share times the product over both coordinates of N(0; centre, 1 + s^2).
    evidence = np.array([0.25, 0.75]) / (1.0 + widths**2)
    evidence = evidence * np.exp(-0.5 * (centres**2 + 0.5**2) / (1.0 + widths**2))
    expected = evidence[0] / evidence.sum()
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start = annealed_start(unit_normal, Powers(two_narrow_modes), rng.standard_normal((1200, 2)), rng)
        left = start.population[:, 0] < 0.0
        shares.append(left.mean())
    for k, inside in enumerate((left, ~left)):
        mode = start.population[inside]
        mean = np.array([centres[k], 0.5]) / (1.0 + widths[k] ** 2)
        assert np.abs(mode.mean(axis=0) - mean).max() < 0.2 * sd[k]
        assert np.abs(mode.std(axis=0) / sd[k] - 1.0).max() < 0.15
    error = np.std(shares, ddof=1) / np.sqrt(len(shares))
    assert error < 0.03
    assert abs(np.mean(shares) - expected) < 4.0 * max(error, 0.005)
    assert start.log_prob == pytest.approx((unit_normal(start.point[None]) + two_narrow_modes(start.point[None]))[0])
    walkers, heights = cloud(lambda x: unit_normal(x) + two_narrow_modes(x), start, 64, np.random.default_rng(0))
    assert np.isfinite(heights).all()
    assert {tuple(w) for w in walkers} <= {tuple(p) for p in start.population}


def test_annealing_by_shrinking_errors_has_the_share_of_a_narrow_mode_among_heavy_tails():
    """Two coordinates, each measured with contradicting results and errors of Student's t: four modes."""
    values, errors = np.array([1.0, -1.0, -1.2]), np.array([0.01, 0.3, 0.3])

    class Shrinking:
        def measure(self, points):
            return ((points[:, :, None] - values) / errors).reshape(len(points), 6)

        def height(self, misfits, temperature):
            return -1.5 * np.log1p((temperature * misfits) ** 2 / 2.0).sum(axis=1)

    x = np.linspace(-4.0, 4.0, 80001)[:, None]
    density = np.exp(-0.5 * x[:, 0] ** 2 - 1.5 * np.log1p(((x - values) / errors) ** 2 / 2.0).sum(axis=1))
    narrow = density[x[:, 0] > 0.9].sum() / density.sum()
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start = annealed_start(unit_normal, Shrinking(), rng.standard_normal((1000, 2)), rng)
        shares.append((start.population > 0.9).mean(axis=0))
    error = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    assert 0.05 < narrow < 0.95
    assert (error < 0.03).all()
    assert (np.abs(np.mean(shares, axis=0) - narrow) < 4.0 * np.maximum(error, 0.01)).all()


def test_annealing_without_any_finite_point_says_so():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="zero at all 20 points"):
        annealed_start(unit_normal, Powers(lambda x: np.full(len(x), -np.inf)), np.zeros((20, 2)), rng)


def test_annealing_passes_a_likelihood_that_is_zero_over_most_of_the_prior():
    """A half plane: the posterior is the prior cut at x = 2, whose mean is known."""

    def half_plane(points):
        return np.where(points[:, 0] > 2.0, 0.0, -np.inf)

    rng = np.random.default_rng(1)
    start = annealed_start(unit_normal, Powers(half_plane), rng.standard_normal((2000, 2)), rng)
    assert start.population[:, 0].min() > 2.0
    mills = np.exp(-2.0) / np.sqrt(2.0 * np.pi) / 0.0227501319
    assert start.population[:, 0].mean() == pytest.approx(mills, abs=0.05)
    assert start.population[:, 1].std() == pytest.approx(1.0, abs=0.1)


def skewed(points):
    """Three coordinates: a normal of sd 0.5 about 1, a log-gamma (skewed to the left), and a normal that follows the
    second; normalised up to a constant.
    """
    x, y, z = points.T
    return -2.0 * (x - 1.0) ** 2 + 4.0 * y - np.exp(y) - 0.5 * ((z - 0.3 * y) / 0.2) ** 2


def resampled(seed):
    """A start from a best fit that is off by two standard deviations and half as wide again."""
    at = np.array([0.0, np.log(4.0), 0.3 * np.log(4.0)])
    slope = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.3, 1.0]])
    covariance = 2.25 * slope @ np.diag([0.25, 0.25, 0.04]) @ slope.T
    return resampled_start(skewed, at, covariance, np.random.default_rng(seed))


def test_a_resampled_population_is_a_sample_of_the_posterior():
    populations = [resampled(seed).population for seed in range(4)]
    x, y, z = np.concatenate(populations).T
    assert x.mean() == pytest.approx(1.0, abs=0.04)
    assert x.std() == pytest.approx(0.5, rel=0.06)
    assert y.mean() == pytest.approx(digamma(4.0), abs=0.04)
    assert y.std() == pytest.approx(np.sqrt(polygamma(1, 4.0)), rel=0.06)
    assert (z - 0.3 * y).std() == pytest.approx(0.2, rel=0.06)


def test_a_resampled_population_has_few_copies_and_they_stand_together():
    """Else a mixture that knows single members by heart would be thought the best likeness of the posterior."""
    start = resampled(1)
    population = start.population
    distinct, first, count = np.unique(population[:, 0], return_index=True, return_counts=True)
    assert len(distinct) > 0.85 * len(population)
    assert all(np.all(population[i : i + n, 0] == x) for x, i, n in zip(distinct, first, count, strict=True))
    shares, _, _ = fit_mixture(start.population)
    assert len(shares) < 12


def test_a_best_fit_unlike_the_posterior_is_no_sample_of_it(caplog):
    """A thin shell: too few draws of any Student t count. A needle; a density that is nought. The log says why."""
    caplog.set_level("INFO", "bayes_damper.sampling.start")

    def shell(points):
        return -0.5 * ((np.linalg.norm(points[:, :5], axis=1) - 1.0) / 1e-4) ** 2

    start = resampled_start(shell, np.r_[1.0, np.zeros(4)], 1e-4 * np.eye(5), np.random.default_rng(0))
    assert len(start.population) == 0
    empty = resampled_start(lambda x: np.full(len(x), -np.inf), np.zeros(2), np.eye(2), np.random.default_rng(0))
    assert len(empty.population) == 0

    def needle(points):
        return -1e12 * np.sum(points**2, axis=1)

    assert len(resampled_start(needle, np.zeros(9), np.eye(9), np.random.default_rng(0)).population) == 0
    reasons = (
        "of 8192 draws about it only",
        "only 0 of 1024 draws about it are possible",
        "1024 draws about it show no shape",
    )
    assert len(caplog.messages) == len(reasons)
    assert all(why in said for why, said in zip(reasons, caplog.messages, strict=True)), caplog.messages


def test_where_most_moves_are_independent_draws_every_step_is_stored():
    """The warm-up's own moves are mostly others, with a longer autocorrelation: that would thin what need not be."""
    target = Gaussian(6)
    rng = np.random.default_rng(0)
    start = resampled_start(target, np.zeros(6), 1.3 * target.covariance, rng)
    result = sample(target, start, seed=3, walkers=32)
    assert result.converged
    assert result.thin == 1
    assert result.verdict.tau.max() < 3.5
    assert result.evaluations < 20_000


class ThinSheets:
    """Twelve unknowns with unit normal priors; three numbers, each measured three times, see curved combinations.

    That makes thin sheets with the heavy tails of Student's t, and modes where one measurement is given up for others.
    """

    ndim = 12
    names = tuple(f"p{i}" for i in range(ndim))
    measured = np.array([1.0, 2.2, 0.4])
    errors = np.array([0.02, 0.02, 0.05])

    def seen(self, points):
        a, b, c, d = np.exp(0.5 * points[:, :4]).T
        return np.stack([a + b + 0.1 * points[:, 4], a * c + b + 0.1 * points[:, 5], c * d - b], axis=1)

    def log_likelihood(self, points):
        return (-1.5 * np.log1p(((self.seen(points) - self.measured) / self.errors) ** 2 / 2.0)).sum(axis=1)

    def __call__(self, points):
        return unit_normal(points) + self.log_likelihood(points)


def sheets_and_start():
    target, rng = ThinSheets(), np.random.default_rng(2)
    draws = rng.standard_normal((1024, target.ndim))
    return target, annealed_start(unit_normal, Powers(target.log_likelihood), draws, rng)


def test_what_an_annealed_population_taught_is_not_forgotten_in_a_short_warm_up():
    """Autocorrelation stays short: the walkers of one ensemble, in a few hundred steps, know less of thin sheets."""
    target, start = sheets_and_start()
    result = sample(target, start, seed=4, rule=StoppingRule(taus=5.0, max_steps=4000))
    assert result.converged, result.verdict.sentences
    assert result.verdict.tau.max() < 120.0
    assert result.warm_up.max() < 1500


def test_a_rule_that_asks_for_few_autocorrelation_times_is_judged_when_it_has_them():
    """Not when 75 draws of an eighth of one are there, which is more than nine."""
    target, start = sheets_and_start()
    result = sample(target, start, seed=4, rule=StoppingRule(taus=2.0, ess=500.0, r_hat=1.03))
    assert result.converged, result.verdict.sentences
    assert 2.0 <= result.verdict.steps / result.verdict.tau.max() < 3.5


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
    asked = []

    def later() -> int:
        asked.append(None)
        return 1 if len(asked) < 3 else 2

    one, two, more = (sample(target, start, seed=5, workers=n) for n in (1, 2, later))
    assert one.draws.tobytes() == two.draws.tobytes() == more.draws.tobytes()
    assert one.log_prob.tobytes() == two.log_prob.tobytes() == more.log_prob.tobytes()
    assert len(asked) > 3


class Bent:
    """Two log-normal coordinates; along the square of the first, the others in two modes, the right one seldomer."""

    ndim = 8
    names = tuple(f"p{i}" for i in range(8))

    def __call__(self, points):
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(points[:, :2])
            scale = -0.5 * (logs**2).sum(axis=1) / 0.36 - logs.sum(axis=1)
            rest = points[:, 2:] - 0.3 * points[:, :1] ** 2
        modes = [np.log(w) - 2.0 * ((rest - c) ** 2).sum(axis=1) for w, c in ((0.8, -1.0), (0.2, 1.0))]
        return np.where((points[:, :2] > 0.0).all(axis=1), scale + np.logaddexp(*modes), -np.inf)


def bent_and_start():
    target = Bent()
    return target, Start(np.ones(8), 0.3 * np.eye(8), float(target(np.ones((1, 8)))[0]), 1)


@pytest.mark.slow
def test_ensembles_propose_what_all_of_them_have_seen(tmp_path):
    """The autocorrelation time was 82 steps where each learnt from its own draws alone."""
    target, start = bent_and_start()
    result = sample(target, start, seed=1, checkpoint=Checkpoint(tmp_path, {}))
    assert result.converged, result.verdict.sentences
    assert result.verdict.tau.max() < 12.0
    assert result.flat()[:, 1].mean() == pytest.approx(np.exp(0.18), rel=0.05)
    assert np.mean(result.flat()[:, 2] > 0.3 * result.flat()[:, 0] ** 2) == pytest.approx(0.2, abs=0.03)
    arrays, _ = Checkpoint(tmp_path, {}).bound_to(_fingerprint(target, start, 1, 4, 64)).load()
    for i in range(1, 4):
        assert arrays[f"{i}.centres"].tobytes() == arrays["0.centres"].tobytes()


class Skewed:
    """Gamma variables of shape 1.2 in eight coordinates."""

    ndim = 8
    names = tuple(f"p{i}" for i in range(8))

    def __call__(self, points):
        with np.errstate(invalid="ignore", divide="ignore"):
            heights = (0.2 * np.log(points) - points).sum(axis=1)
        return np.where((points > 0.0).all(axis=1), heights, -np.inf)


@pytest.mark.slow
def test_skewed_targets_are_proposed_in_normal_scores_which_a_state_keeps(tmp_path):
    """Half of the draws are accepted; of a mixture in the coordinates themselves a fifth."""
    target = Skewed()
    start = Start(np.ones(8), 0.3 * np.eye(8), float(target(np.ones((1, 8)))[0]), 1)
    result = sample(target, start, seed=1, checkpoint=Checkpoint(tmp_path, {}))
    assert result.converged, result.verdict.sentences
    assert result.acceptance.min() > 0.45
    assert result.flat().mean(axis=0) == pytest.approx(np.full(8, 1.2), rel=0.06)
    assert result.flat().var(axis=0) == pytest.approx(np.full(8, 1.2), rel=0.15)
    checkpoint = Checkpoint(tmp_path, {}).bound_to(_fingerprint(target, start, 1, 4, 64))
    again = _Run(target, start, 1, 4, 64, StoppingRule(), checkpoint, None, None)
    assert all(state.knots.shape == (14, 8) for state in again.states)
    assert all(isinstance(move, InScores) for move, _ in _moves(again.states[0])[3:])


def test_the_mixture_learns_from_all_walkers(monkeypatch):
    """Of walkers that hardly move in 500 steps, every 16th draw of all would be of four of the 64 in each ensemble."""
    target, start = bent_and_start()
    run = _Run(target, start, 0, 4, 64, StoppingRule(), None, None, None)
    rng = np.random.default_rng(0)
    places = np.arange(64.0)[:, None] + 0.01 * rng.standard_normal((500, 64, 8))
    heights = rng.standard_normal((500, 64))
    learnt = []
    monkeypatch.setattr(
        "bayes_damper.sampling.ensembles.fit_mixture", lambda draws: (learnt.append(draws), fit_mixture(draws))[1]
    )
    run.states = [_after_round(s, places + 100.0 * i, heights, []) for i, s in enumerate(run.states)]
    run._share()
    run.draws = np.stack([places + 100.0 * i for i in range(4)])
    run._begin_anew()
    for draws in learnt:
        owners, counts = np.unique(draws[:, 0].round(), return_counts=True)
        assert owners.tolist() == [100.0 * i + w for i in range(4) for w in range(64)]
        assert np.ptp(counts) == 0
        assert 8000 <= len(draws) < 16000


@pytest.mark.slow
def test_poor_draws_count_as_warm_up_and_a_stopped_run_counts_them_so_too(tmp_path, monkeypatch):
    target, start = bent_and_start()
    begun = []
    anew = _Run._begin_anew
    monkeypatch.setattr(_Run, "_begin_anew", lambda run: (begun.append(run.draws.shape[1]), anew(run)))
    whole = sample(target, start, seed=1)
    assert 1 <= len(begun) <= 2
    assert whole.evaluations == 64 * (whole.warm_up.sum() + 4 * whole.draws.shape[1] * whole.thin)
    calls = []

    def stop(progress):
        calls.append(progress)
        if len(calls) in (3, 9, 14):
            raise KeyboardInterrupt

    for _ in range(3):
        with pytest.raises(Interrupted, match="saved"):
            sample(target, start, seed=1, checkpoint=Checkpoint(tmp_path, {}), progress=stop)
    again = sample(target, start, seed=1, checkpoint=Checkpoint(tmp_path, {}))
    assert again.draws.tobytes() == whole.draws.tobytes()


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
from test_ensembles import Gaussian, RULE, start_of
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling import sample
target = Gaussian(3, pause=0.001)
sample(target, start_of(Gaussian(3)), seed=5, rule=RULE, checkpoint=Checkpoint(sys.argv[1], {}, every=0.02))
"""


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("steps", "tau", "anew", "poorly"),
    [
        (250, 20.0, 100, True),
        (150, 20.0, 100, False),  # not twice what the mixture was learnt from
        (350, 20.0, 100, False),  # 400 steps will do
        (150, 20.0, 0, True),
        (75, 9.0, 0, False),  # steps that follow each other as closely as those of a good proposal may
        (9000, 1000.0, 4000, False),  # of 30 000 allowed
    ],
)
def test_a_mixture_is_learnt_anew_from_twice_the_draws_while_many_are_wanting(steps, tau, anew, poorly):
    target = Gaussian(3)
    run = _Run(target, start_of(target), 0, 4, 32, StoppingRule(), None, None, None)
    run.thin, run.judged, run.draws = 1, steps, np.zeros((4, steps, 32, 3))
    rng = np.random.default_rng(0)
    verdict = judge(("a", "b", "c"), rng.standard_normal((4, 75, 32, 3)), np.zeros((4, 75, 32)), 1, StoppingRule())
    run.verdict = replace(verdict, steps=steps, tau=np.full(3, tau))
    run.states = [replace(state, anew=anew) for state in run.states]
    assert run._drawn_poorly() is poorly
