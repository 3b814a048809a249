"""Normal scores: where they go, what they gain, and when they are not used."""

import numpy as np
import pytest
from scipy import stats

from bayes_damper.sampling.moves import Independence, fit_mixture
from bayes_damper.sampling.normal_scores import InScores, NormalScores, normal_scores


def skewed(count, seed):
    """Draws (count, 6), each a gamma variable of its own size, the first two correlated."""
    rng = np.random.default_rng(seed)
    x = rng.gamma(1.5, size=(count, 6))
    x[:, 1] += x[:, 0]
    return x * np.array([1e-6, 1.0, 1.0, 1e4, 1.0, 1.0])


def test_quantiles_go_to_those_of_the_normal_and_back():
    draws = skewed(4000, 0)
    through = NormalScores.of(draws)
    there, denser = through.scores(draws)
    for column in there.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert through.points(there) == pytest.approx(draws, rel=1e-9)
    # The density in scores, by difference quotients.
    step = 1e-7 * draws.std(axis=0)
    slopes = (through.scores(draws + step)[0] - there) / step
    assert np.median(np.abs(np.log(slopes).sum(axis=1) + denser)) < 1e-5


def test_equal_draws_leave_a_map_that_turns_back():
    draws = np.zeros((500, 2))
    draws[:20] = np.random.default_rng(0).standard_normal((20, 2))
    through = NormalScores.of(draws)
    there, _ = through.scores(draws)
    assert np.isfinite(there).all()
    assert through.points(there) == pytest.approx(draws, abs=1e-5)


def test_skewed_draws_get_scores_and_normal_ones_do_not():
    assert normal_scores(skewed(2000, 1)) is not None
    assert normal_scores(skewed(60, 1)) is None
    assert normal_scores(np.random.default_rng(2).standard_normal((8000, 6)) @ np.triu(np.ones((6, 6)))) is None


def test_draws_of_a_mixture_in_normal_scores_are_accepted_more_often():
    draws, fresh = skewed(4000, 3), skewed(2000, 4)
    through = normal_scores(draws)
    plain = Independence(*fit_mixture(draws))
    in_scores = InScores(Independence(*fit_mixture(through.scores(draws)[0])), through)

    def log_target(x):
        x = x / np.array([1e-6, 1.0, 1.0, 1e4, 1.0, 1.0])
        x = np.column_stack([x[:, 0], x[:, 1] - x[:, 0], x[:, 2:]])
        return stats.gamma.logpdf(x, 1.5).sum(axis=1)

    shares = {}
    for name, move in {"plain": plain, "in scores": in_scores}.items():
        points, log_ratio = move.proposal(fresh, fresh, np.random.RandomState(0))
        with np.errstate(invalid="ignore"):
            gain = log_target(points) - log_target(fresh) + log_ratio
        shares[name] = np.exp(np.minimum(gain, 0.0)).mean()
    assert shares["in scores"] > 0.5
    assert shares["in scores"] > 1.5 * shares["plain"]
