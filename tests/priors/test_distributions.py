"""Each distribution against scipy.stats, and its parts against each other."""

import math

import numpy as np
import pytest
from scipy import stats

from bayes_damper.priors.distributions import (
    HalfNormal,
    LogNormal,
    LogScale,
    LogStudent,
    LogUniform,
    Normal,
    Uniform,
    columns_from_standard,
    from_standard,
    median,
    to_standard,
    widths_out,
)


class TailedScale:
    """exp of scipy's Student's t with four degrees of freedom: what scipy.stats has no name for."""

    def __init__(self, median_value, scale):
        self.t = stats.t(4, loc=math.log(median_value), scale=scale)

    def logpdf(self, x):
        return self.t.logpdf(np.log(x)) - np.log(x)

    def ppf(self, u):
        return np.exp(self.t.ppf(u))

    def cdf(self, x):
        return self.t.cdf(np.log(x))

    def median(self):
        return self.ppf(0.5)


PAIRS = [
    pytest.param(Normal(1.5, 0.3), stats.norm(1.5, 0.3), id="normal"),
    pytest.param(
        Normal(1.5, 0.3, lower=1.2, upper=2.5), stats.truncnorm(-1.0, 1.0 / 0.3, loc=1.5, scale=0.3), id="normal-cut"
    ),
    pytest.param(
        Normal(0.0, 1.0, lower=5.0), stats.truncnorm(5.0, np.inf, loc=0.0, scale=1.0), id="normal-far-upper-tail"
    ),
    pytest.param(LogNormal(0.01, 2.5), stats.lognorm(math.log(2.5), scale=0.01), id="lognormal"),
    pytest.param(LogStudent(0.01, 2.5), TailedScale(0.01, math.log(2.5)), id="logstudent"),
    pytest.param(HalfNormal(0.02), stats.halfnorm(scale=0.02), id="halfnormal"),
    pytest.param(Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0), id="uniform"),
    pytest.param(LogUniform(5.0, 3000.0), stats.loguniform(5.0, 3000.0), id="loguniform"),
]


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_log_density_is_that_of_scipy(ours, theirs):
    x = theirs.ppf(np.linspace(0.001, 0.999, 41))
    np.testing.assert_allclose(ours.logpdf(x), theirs.logpdf(x), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_quantiles_are_those_of_scipy(ours, theirs):
    u = np.linspace(0.001, 0.999, 41)
    np.testing.assert_allclose(ours.ppf(u), theirs.ppf(u), rtol=1e-7, atol=1e-12)
    assert median(ours) == pytest.approx(theirs.median(), rel=1e-7)


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_density_vanishes_outside_the_support(ours, theirs):
    low, high = ours.support
    outside = [x for x in (low - 1.0, high + 1.0) if math.isfinite(x)]
    assert np.all(ours.logpdf(outside) == -np.inf)
    assert np.isfinite(ours.logpdf(median(ours)))


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_draws_follow_the_distribution(ours, theirs):
    x = ours.ppf(np.random.default_rng(1).random(4000))
    assert stats.kstest(x, theirs.cdf).pvalue > 1e-3


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_standard_coordinates_go_there_and_back(ours, theirs):
    z = np.linspace(-4.0, 4.0, 33)
    x = from_standard(ours, z)
    np.testing.assert_allclose(theirs.cdf(x), stats.norm.cdf(z), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(to_standard(ours, x), z, atol=1e-5)


def test_many_columns_at_once_are_those_of_one_at_a_time():
    distributions = [pair.values[0] for pair in PAIRS]
    z = np.random.default_rng(3).standard_normal((50, len(distributions))) * 3.0
    z[0], z[1] = 30.0, -30.0
    found = columns_from_standard(distributions, z)
    for i, ours in enumerate(distributions):
        np.testing.assert_array_equal(found[i], from_standard(ours, z[:, i]))


@pytest.mark.parametrize(("ours", "theirs"), PAIRS)
def test_standard_coordinates_beyond_the_support_are_the_farthest(ours, theirs):
    low, high = ours.support
    for end, sign in ((low, -1.0), (high, 1.0)):
        if math.isfinite(end) and not (isinstance(ours, LogScale) and sign < 0.0):
            assert sign * to_standard(ours, end + sign * 1e-3) >= 8.0


def test_what_no_loguniform_reaches_is_the_farthest_without_a_warning():
    assert to_standard(LogUniform(5.0, 3000.0), [-1.0, 0.0, 4.0, 4000.0]).tolist() == [-8.0, -8.0, -8.0, 8.0]


def test_a_tail_of_student_lets_a_value_lie_where_a_gaussian_one_holds_it():
    """A drag eleven scales below its median: half of the log density that a lognormal loses there."""
    tailed, plain = LogStudent(1.0, 3.0), LogNormal(1.0, 3.0)
    far = 3.0**-11.0
    assert abs(to_standard(tailed, far)) < 4.0 < to_standard(plain, 1.0 / far)
    assert to_standard(tailed, from_standard(tailed, -5.3)) == pytest.approx(-5.3, rel=1e-12)
    assert widths_out(tailed, to_standard(tailed, far)) == pytest.approx(11.0, rel=1e-9)
    assert widths_out(plain, [-2.5, 1.0]).tolist() == [2.5, 1.0]
    assert np.isfinite(from_standard(tailed, [-37.0, 37.0])).all(), "beyond a hundred scales it is not followed"
