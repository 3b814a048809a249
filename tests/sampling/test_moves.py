"""The moves leave known distributions as they are: moments and Kolmogorov-Smirnov tests at fixed seeds."""

import emcee
import numpy as np
import pytest
from scipy import stats

from bayes_damper.sampling import resampled_start
from bayes_damper.sampling.local_mixture import Nearby
from bayes_damper.sampling.moves import DifferentialEvolution, Independence, Snooker, StudentT, _distinct, fit_mixture
from bayes_damper.sampling.normal_scores import InScores, NormalScores


def mixture(ndim):
    """A proposal of two wide bumps, neither of which is the target."""
    centres = np.array([np.full(ndim, 0.3), np.full(ndim, -0.8)])
    return Independence(np.array([0.7, 0.3]), centres, np.array([1.5, 2.5])[:, None, None] * np.eye(ndim), 5.0)


def nearby(parts):
    """Steps within the same bumps."""
    return Nearby(
        parts.shares,
        np.array([s.centre for s in parts.shapes]),
        np.array([s.covariance for s in parts.shapes]),
        parts.shapes[0].freedom,
    )


def in_scores(move, ndim):
    """The same move in the normal scores of another, skewed distribution."""
    skewed = np.random.default_rng(0).gamma(2.0, size=(600, ndim))
    return InScores(move, NormalScores.of(skewed - 1.0))


MOVES = {
    "differential_evolution": lambda ndim: DifferentialEvolution(),
    "differential_evolution_spread": lambda ndim: DifferentialEvolution(spread=0.5),
    "snooker": lambda ndim: Snooker(),
    "independence": mixture,
    "nearby": lambda ndim: nearby(mixture(ndim)),
    "in_scores": lambda ndim: in_scores(mixture(ndim), ndim),
    "nearby_in_scores": lambda ndim: in_scores(nearby(mixture(ndim)), ndim),
    "default_mix": lambda ndim: [
        (DifferentialEvolution(), 0.7),
        (DifferentialEvolution(1.0), 0.1),
        (Snooker(), 0.2),
    ],
}


def run(move, log_prob, start, steps, seed=0, thin=10):
    walkers, ndim = start.shape
    sampler = emcee.EnsembleSampler(walkers, ndim, log_prob, vectorize=True, moves=move)
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(start, steps, thin_by=thin)
    return sampler.get_chain()


@pytest.mark.parametrize("name", MOVES)
def test_a_correlated_gaussian_is_kept(name):
    """Started from the target itself, 25 steps later every ensemble of many still has its distribution."""
    walkers, ndim = 64, 3  # few walkers: below
    covariance = np.array([[1.0, 0.9, 0.3], [0.9, 1.0, 0.1], [0.3, 0.1, 2.0]])
    inverse = np.linalg.inv(covariance)
    rng = np.random.default_rng(5)
    last = []
    repeats = 3000 // walkers
    for seed in range(repeats):
        start = rng.multivariate_normal(np.zeros(ndim), covariance, walkers)
        chain = run(
            MOVES[name](ndim), lambda x: -0.5 * np.einsum("ij,jk,ik->i", x, inverse, x), start, 1, seed=seed, thin=25
        )
        last.append(chain[-1])
    points = np.concatenate(last)
    white = points @ np.linalg.inv(np.linalg.cholesky(covariance)).T
    for column in white.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert stats.kstest(np.einsum("ij,ij->i", white, white), stats.chi2(ndim).cdf).pvalue > 1e-3
    assert np.abs(np.cov(white.T) - np.eye(ndim)).max() < 0.12


@pytest.mark.parametrize("name", MOVES)
def test_a_half_line_with_a_hard_wall_is_kept(name):
    """An exponential that ends at zero beside a Gaussian: points beyond the wall have log density -inf.

    With as few walkers as there may be, where a move that leans on the others errs most.
    """
    walkers = 8

    def log_prob(x):
        return np.where(x[:, 0] < 0, -np.inf, -x[:, 0]) - 0.5 * x[:, 1] ** 2

    rng = np.random.default_rng(8)
    last = []
    for seed in range(3000 // walkers):
        start = np.column_stack([rng.exponential(size=walkers), rng.standard_normal(walkers)])
        last.append(run(MOVES[name](2), log_prob, start, 1, seed=seed, thin=25)[-1])
    points = np.concatenate(last)
    assert points[:, 0].min() >= 0
    assert stats.kstest(points[:, 0], "expon").pvalue > 1e-3
    assert stats.kstest(points[:, 1], "norm").pvalue > 1e-3


@pytest.mark.parametrize(
    "name", [pytest.param("snooker", marks=pytest.mark.slow), "default_mix"]
)  # most of the mix is differential evolution
def test_a_banana_is_found_from_a_small_ball(name):
    """x ~ N(0, 1), y | x ~ N(x^2, 0.3): the moments of the long run are those of the formula."""

    def log_prob(x):
        return -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - x[:, 0] ** 2) / 0.3) ** 2

    start = 0.1 * np.random.default_rng(1).standard_normal((64, 2))
    chain = run(MOVES[name](2), log_prob, start, 1500, thin=10)[300:].reshape(-1, 2)
    residual = (chain[:, 1] - chain[:, 0] ** 2) / 0.3
    assert abs(chain[:, 0].mean()) < 0.08
    assert chain[:, 0].std() == pytest.approx(1.0, abs=0.06)
    assert chain[:, 1].mean() == pytest.approx(1.0, abs=0.12)
    assert residual.mean() == pytest.approx(0.0, abs=0.05)
    assert residual.std() == pytest.approx(1.0, abs=0.05)


def test_unit_gamma_swaps_walkers_between_two_modes():
    """Two narrow modes 40 standard deviations apart: gamma = 1 carries walkers across, 2.38 / sqrt(2 d) does not."""

    def log_prob(x):
        left = -0.5 * ((x + 20.0) ** 2).sum(axis=1)
        right = -0.5 * ((x - 20.0) ** 2).sum(axis=1)
        return np.logaddexp(left, right)

    rng = np.random.default_rng(3)
    start = rng.standard_normal((64, 2)) + np.where(np.arange(64) < 48, 20.0, -20.0)[:, None]

    def crossings(gamma):
        side = run(DifferentialEvolution(gamma), log_prob, start, 300, thin=1)[:, :, 0] > 0
        return np.count_nonzero(side[1:] != side[:-1])

    assert crossings(1.0) > 100
    assert crossings(None) == 0


def test_in_one_dimension_snooker_needs_no_extra_factor():
    points, log_ratio = Snooker().proposal(np.ones((5, 1)), np.arange(8.0)[:, None] + 2, np.random.RandomState(0))
    assert points.shape == (5, 1)
    assert np.all(log_ratio == 0)


def test_undefined_values_are_refused_and_counted():
    def log_prob(x):
        return np.where(x[:, 0] > 0.5, np.nan, -0.5 * (x**2).sum(axis=1))

    move = DifferentialEvolution()
    start = np.random.default_rng(0).uniform(-1, 0.4, (16, 2))
    chain = run(move, log_prob, start, 100, thin=1)
    assert chain[:, :, 0].max() <= 0.5
    assert move.undefined > 0
    assert move.tried == 1600
    assert 0 < move.taken < move.tried


def test_triples_are_distinct_and_evenly_spread():
    first, second, third = _distinct(np.random.RandomState(0), 60000, 5)
    assert np.all((first != second) & (second != third) & (first != third))
    counts = np.bincount(first * 25 + second * 5 + third, minlength=125)
    counts = counts[counts > 0]
    assert len(counts) == 60
    assert stats.chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize("freedom", [3.0, 8.0])
def test_student_t_agrees_with_scipy(freedom):
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    shape = StudentT(np.array([1.0, -1.0]), covariance, freedom)
    points = shape.draw(np.random.default_rng(0), 20000)
    peer = stats.multivariate_t([1.0, -1.0], covariance, df=freedom)
    assert np.allclose(shape.log_density(points[:50]), peer.logpdf(points[:50]))
    assert stats.kstest((points[:, 0] - 1) / np.sqrt(2), stats.t(freedom).cdf).pvalue > 1e-3


def test_a_mixture_proposal_has_the_density_that_it_draws_from():
    move = mixture(2)
    random = np.random.RandomState(4)
    points, _ = move.proposal(np.zeros((40_000, 2)), np.zeros((2, 2)), random)
    peers = [stats.multivariate_t(s.centre, s.covariance, df=5.0) for s in move.shapes]
    density = sum(w * peer.pdf(points[:50]) for w, peer in zip(move.shares, peers, strict=True))
    np.testing.assert_allclose(np.exp(move.log_density(points[:50])), density)
    marginal = [stats.t(5.0, s.centre[0], np.sqrt(s.covariance[0, 0])) for s in move.shapes]
    mixed = lambda x: sum(w * m.cdf(x) for w, m in zip(move.shares, marginal, strict=True))  # noqa: E731
    assert stats.kstest(points[:, 0], mixed).pvalue > 1e-3


def test_steps_within_a_mixture_leave_it_as_it_is_and_are_shorter_than_it():
    """From draws of the mixture: the ratio is that of its density, the distribution stays, and few draws jump far."""
    parts = mixture(3)
    move, random = nearby(parts), np.random.RandomState(11)
    none = np.zeros((2, 3))
    points, _ = parts.proposal(np.zeros((20_000, 3)), none, random)
    moved, ratio = move.proposal(points, none, random)
    np.testing.assert_allclose(ratio, parts.log_density(points) - parts.log_density(moved), atol=1e-9)
    for before, after in zip(points.T, moved.T, strict=True):
        assert stats.ks_2samp(before, after).pvalue > 1e-3
    assert stats.ks_2samp(parts.log_density(points), parts.log_density(moved)).pvalue > 1e-3
    assert np.median(np.linalg.norm(moved - points, axis=1)) < 0.5 * np.median(
        np.linalg.norm(points[1:] - points[:-1], axis=1)
    )
    # Reversible: a step from a to b is as likely as one from b to a.
    a, b = points[:, 0] < -0.5, moved[:, 0] < -0.5
    there, back = np.count_nonzero(a & ~b), np.count_nonzero(~a & b)
    assert abs(there - back) < 4.0 * np.sqrt(there + back)


def test_steps_within_the_parts_of_thin_modes_are_accepted_where_draws_of_them_are_not():
    """Two thin crossed needles in six dimensions; the mixture knows the directions but takes them for wider."""
    widths = np.array([1.0, 0.02, 0.02, 0.02, 0.02, 0.02])
    needles = np.stack([np.diag(widths**2), np.diag(np.roll(widths, 1) ** 2)])
    centres = np.array([np.full(6, -1.0), np.full(6, 1.0)])
    known = (np.full(2, 0.5), centres, 9.0 * needles)
    target = Independence(np.full(2, 0.5), centres, needles, 30.0)
    start = target.proposal(np.zeros((64, 6)), np.zeros((2, 6)), np.random.RandomState(1))[0]
    shares = {}
    for name, move in {"draws": Independence(*known), "steps": Nearby(*known), "all": DifferentialEvolution()}.items():
        run(move, target.log_density, start, 200, thin=1)
        shares[name] = move.taken / move.tried
    assert shares["steps"] > 3.0 * max(shares["draws"], shares["all"])


def two_bumps(count, rng):
    """Draws (count, 2) of two bumps, a third of them in the first, in coordinates of very different size."""
    first = rng.random(count) < 1.0 / 3.0
    white = rng.standard_normal((count, 2))
    points = np.where(first[:, None], white * [1.0, 0.3] + [-4.0, 0.0], white * [0.5, 1.0] + [3.0, 2.0])
    return points * [1e-4, 1e3]


def test_a_fitted_mixture_is_close_to_what_was_drawn():
    draws = two_bumps(4000, np.random.default_rng(2))
    shares, centres, covariances = fit_mixture(draws)
    assert shares.sum() == pytest.approx(1.0)
    assert len(shares) == len(centres) == len(covariances)
    mean = shares @ centres
    within = np.einsum("k,kij->ij", shares, covariances)
    between = np.einsum("k,ki,kj->ij", shares, centres - mean, centres - mean)
    sd = draws.std(axis=0)
    assert np.abs((mean - draws.mean(axis=0)) / sd).max() < 0.08
    assert np.abs((within + between - np.cov(draws.T)) / np.outer(sd, sd)).max() < 0.1
    left = centres[:, 0] < 0.0
    assert shares[left].sum() == pytest.approx(1.0 / 3.0, abs=0.04)
    fresh = two_bumps(2000, np.random.default_rng(3))
    move = Independence(shares, centres, covariances, 1e6)
    one = StudentT(draws.mean(axis=0), np.cov(draws.T), 1e6)
    assert move.log_density(fresh).mean() > one.log_density(fresh).mean() + 0.5


def test_few_draws_are_fitted_by_a_single_normal():
    draws = np.random.default_rng(0).standard_normal((24, 4)) * 3.0 + 1.0
    shares, centres, covariances = fit_mixture(draws)
    assert shares.tolist() == [1.0]
    assert centres.shape == (1, 4)
    assert np.linalg.eigvalsh(covariances[0]).min() > 0.0


def bent(count, rng):
    """Draws (count, 14) of which one is bent over another, as wide as a third lets it be."""
    points = rng.standard_normal((count, 14))
    points[:, 1] = 0.5 * points[:, 1] + points[:, 0] ** 2
    points[:, 2] *= np.exp(0.7 * points[:, 0])
    return points


def test_several_normals_are_learnt_of_few_draws_in_many_coordinates():
    """A part that is fitted to forty draws in fourteen coordinates by themselves predicts no other draw."""
    rng = np.random.default_rng(0)
    draws, fresh = bent(600, rng), bent(2000, rng)
    found = Independence(*fit_mixture(draws), 1e6)
    one = StudentT(draws.mean(axis=0), np.cov(draws.T), 1e6)
    assert len(found.shares) > 1
    assert found.log_density(fresh).mean() > one.log_density(fresh).mean() + 0.5


def test_the_check_tells_a_snooker_that_keeps_its_target_from_one_that_does_not():
    """The Kolmogorov-Smirnov test above has the power to see a wrong acceptance rule, emcee's own move included."""

    class Careless(Snooker):
        def proposal(self, moving, resting, random):
            return super().proposal(moving, resting, random)[0], 0.0

    def p_value(move):
        rng = np.random.default_rng(5)
        starts = [rng.standard_normal((64, 3)) for _ in range(40)]
        last = [run(move, lambda x: -0.5 * (x**2).sum(axis=1), s, 1, seed=i, thin=25)[-1] for i, s in enumerate(starts)]
        return stats.kstest((np.concatenate(last) ** 2).sum(axis=1), stats.chi2(3).cdf).pvalue

    assert p_value(Snooker()) > 1e-3
    assert p_value(Careless()) < 1e-10
    assert p_value(emcee.moves.DESnookerMove()) < 1e-10


def test_a_target_that_no_draw_meets_is_begun_about_its_optimum():
    """A noise declared a thousand times too small: of a cloud one point has all of the weight, and no shape."""
    spread = np.eye(4)
    found = resampled_start(
        lambda x: -0.5e12 * np.sum(x**2, axis=1), np.zeros(4), spread, np.random.default_rng(1), draws=200
    )
    assert found.population.size == 0
    np.testing.assert_array_equal(found.covariance, spread)
