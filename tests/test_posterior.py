"""Coordinates of a posterior: shared pairs taken apart and put together, with the density that belongs to them."""

import numpy as np
import pytest
from scipy import stats

from bayes_damper.distributions import HalfNormal, LogNormal, Uniform
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.fit import published_posterior
from bayes_damper.posterior import EFFECT_PREFIX, Coordinates, Datum, FeaturePosterior, Shared
from bayes_damper.priors import load_priors
from bayes_damper.sampling import annealed_start

FREE = {
    "mu": LogNormal(0.008, 2.0),
    "k2t": Uniform(0.0, 3.0),
    "c2t": LogNormal(0.03, 3.0),
}
SHARED = Shared("mu", "c2t", 0.01, 0.05)
COORDINATES = Coordinates(FREE, fixed={"nu": 60.0}, tied={"c3t": "c2t"}, shared=(SHARED,))


def test_values_and_points_are_inverse_to_each_other():
    points = COORDINATES.draw(np.random.default_rng(0), 200)
    values = COORDINATES.values(points)
    assert set(values) == {"mu", "k2t", "c2t", "nu", "c3t"}
    assert (values["c3t"] == values["c2t"]).all()
    assert (values["nu"] == 60.0).all()
    np.testing.assert_allclose(COORDINATES.points(values), points, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(COORDINATES.sampled(COORDINATES.standard(points)), points, rtol=1e-9, atol=1e-9)


def test_a_shared_pair_is_sampled_as_the_logarithms_of_sum_and_ratio():
    points = COORDINATES.draw(np.random.default_rng(1), 50)
    values = COORDINATES.values(points)
    total = values["mu"] / SHARED.x_unit + values["c2t"] / SHARED.y_unit
    ratio = (values["c2t"] / SHARED.y_unit) / (values["mu"] / SHARED.x_unit)
    np.testing.assert_allclose(points[:, 0], np.log(total))
    np.testing.assert_allclose(points[:, 2], np.log(ratio))


def test_the_prior_density_has_the_jacobian_of_the_change():
    """Density in the sampled coordinates = density of the values times |d values / d points|, by differences."""
    points = COORDINATES.draw(np.random.default_rng(2), 20)
    names = COORDINATES.names
    step = 1e-5
    jacobian = np.empty((len(points), 3, 3))
    for j in range(3):
        ahead, behind = points.copy(), points.copy()
        ahead[:, j] += step
        behind[:, j] -= step
        above, below = COORDINATES.values(ahead), COORDINATES.values(behind)
        for i, name in enumerate(names):
            jacobian[:, i, j] = (above[name] - below[name]) / (2.0 * step)
    values = COORDINATES.values(points)
    density = sum(FREE[name].logpdf(values[name]) for name in names)
    expected = density + np.log(np.abs(np.linalg.det(jacobian)))
    np.testing.assert_allclose(COORDINATES.log_prior(points), expected, atol=1e-6)


def test_draws_of_the_prior_have_the_priors_of_each_parameter():
    values = COORDINATES.values(COORDINATES.draw(np.random.default_rng(3), 4000))
    for name, prior in FREE.items():
        uniform = stats.norm.cdf(prior_score(prior, values[name]))
        assert stats.kstest(uniform, "uniform").pvalue > 1e-3


def prior_score(prior, x):
    """Standard normal score of x, from the definition of each prior."""
    if isinstance(prior, LogNormal):
        return np.log(x / prior.median_value) / np.log(prior.factor)
    return stats.norm.ppf((x - 0.0) / 3.0)


def test_a_pair_with_another_prior_is_left_as_it_is():
    plain = Coordinates({"mu": HalfNormal(0.01), "c2t": LogNormal(0.03, 3.0)}, shared=(SHARED,))
    points = plain.draw(np.random.default_rng(4), 10)
    np.testing.assert_array_equal(plain.standard(points), points)
    np.testing.assert_allclose(plain.log_prior(points), stats.norm.logpdf(points).sum(axis=1))


def test_a_parameter_tied_to_nothing_is_refused():
    with pytest.raises(InputError, match="neither a free nor a fixed parameter"):
        Coordinates(FREE, tied={"c3t": "c1t"})


def test_with_data_that_say_nothing_the_posterior_is_the_prior():
    """Standard errors a million times too large: what comes out must be the prior, in every parameter."""
    base = published_posterior("IV", load_priors("thesis"))
    vague = [Datum(d.configuration, d.quantity, d.value, 1e6 * d.standard_error) for d in base.data]
    posterior = FeaturePosterior(vague, base.coordinates)
    rng = np.random.default_rng(8)
    start = annealed_start(
        base.coordinates.log_prior,
        lambda x: posterior.log_likelihood(x).sum(axis=1),
        base.coordinates.draw(rng, 512),
        rng,
    )
    z = base.coordinates.standard(start.population)
    worst = min(stats.kstest(column, "norm").pvalue for column in z.T)
    assert worst > 1e-4


def test_a_prior_that_excludes_every_record_gets_a_sentence():
    base = published_posterior("IV", load_priors("thesis"))
    coordinates = base.coordinates
    with pytest.raises(InputError, match="widen the prior"):
        annealed_start(
            coordinates.log_prior,
            lambda x: np.full(len(x), -np.inf),
            coordinates.draw(np.random.default_rng(1), 64),
            np.random.default_rng(1),
        )


def test_a_posterior_with_an_effect_takes_its_parameters_as_coordinates():
    """At its null the effect changes nothing; a soft release lowers the first peak, in both configurations."""
    fitted = published_posterior("IV", load_priors("thesis"))
    plain = FeaturePosterior(fitted.data, Coordinates(fitted.coordinates.free, tied=fitted.coordinates.tied,
                                                      fixed=fitted.coordinates.fixed))  # fmt: skip
    ramp = EFFECTS["release_ramp"].variant("linear")
    free = plain.coordinates.free | {f"{EFFECT_PREFIX}{p.name}": p.prior for p in ramp.parameters}
    changed = FeaturePosterior(
        fitted.data, Coordinates(free, plain.coordinates.fixed, plain.coordinates.tied), effect=ramp
    )
    z = np.zeros((2, changed.ndim))
    z[0, -1] = -8.0  # the null of a half-normal duration
    without = plain.predict(np.zeros((1, plain.ndim)))[0]
    found = changed.predict(z)
    np.testing.assert_allclose(found[0], without, rtol=1e-6)
    peaks = [i for i, d in enumerate(changed.data) if d.quantity == "max_acceleration"]
    assert (found[1, peaks] < 0.999 * without[peaks]).all()
    values = changed.coordinates.values(z)
    np.testing.assert_allclose(changed.predict_from(values), found)
