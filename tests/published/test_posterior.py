"""Coordinates of a posterior: shared pairs taken apart and put together, with the density that belongs to them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.fit import published_posterior
from bayes_damper.priors.distributions import HalfNormal, LogNormal, Normal, Uniform
from bayes_damper.priors.files import load_priors
from bayes_damper.published.posterior import (
    FEATURE_TIMES,
    Coordinates,
    Datum,
    FeaturePosterior,
    Shared,
    Sheet,
    feature_times,
)
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.sampling import annealed_start
from bayes_damper.sampling.sequential import Powers

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


def _product(values):
    return values["mu"] * values["k2t"]


SHEETS = Coordinates(
    {"mu": LogNormal(0.5, 1.5), "k2t": Uniform(1.0, 3.0), "k1t": Normal(1.0, 0.4, lower=-4.0), "c": Normal(0.0, 1.0)},
    sheets=(Sheet("k1t", 0.01, _product), Sheet("c", 0.3, lambda v: v["k1t"] ** 2), Sheet("k2t", 0.1, _product)),
)
"""Of the three sheets the last is left out, its parameter not being normal."""


def test_a_sheet_is_sampled_as_the_distance_from_where_the_others_put_it():
    points = SHEETS.draw(np.random.default_rng(3), 300)
    values = SHEETS.values(points)
    np.testing.assert_allclose(SHEETS.sampled(SHEETS.standard(points)), points, rtol=1e-9, atol=1e-9)
    z = np.random.default_rng(4).standard_normal((300, 4))
    np.testing.assert_allclose(SHEETS.standard(SHEETS.sampled(z)), z, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(points[:, 1], SHEETS.standard(points)[:, 1])  # k2t, as if it were no sheet
    for column, name, width, centre in ((2, "k1t", 0.01, _product(values)), (3, "c", 0.3, values["k1t"] ** 2)):
        away = (values[name] - centre) / width
        np.testing.assert_allclose(np.sinh(points[:, column]), away, rtol=1e-9, atol=1e-9)


def test_what_is_tied_to_a_sheet_takes_the_value_that_the_sheet_gives():
    tied = replace(SHEETS, tied={"twin": "c"})
    points = tied.draw(np.random.default_rng(6), 50)
    before = points.copy()
    z, values = tied.placed(points)
    np.testing.assert_array_equal(values["twin"], values["c"])
    np.testing.assert_allclose(values["c"], z[:, 3], rtol=1e-12)
    np.testing.assert_array_equal(points, before)
    np.testing.assert_array_equal(tied.log_prior(points, z), tied.log_prior(points))


def test_the_prior_density_of_sheets_is_that_of_the_standard_coordinates_times_the_jacobian():
    points = SHEETS.draw(np.random.default_rng(5), 40)
    step = 1e-6
    for point in points:
        shifts = step * np.eye(4)
        jacobian = (SHEETS.standard(point + shifts) - SHEETS.standard(point - shifts)).T / (2.0 * step)
        z = SHEETS.standard(point[None])[0]
        expected = stats.norm.logpdf(z).sum() + np.linalg.slogdet(jacobian)[1]
        assert SHEETS.log_prior(point[None])[0] == pytest.approx(expected, abs=1e-5)


def test_sheets_leave_the_posterior_of_published_numbers_as_it_is():
    """The same values have the same density in both coordinates, but for the Jacobian that the prior shows."""
    for case in ("II", "III"):
        thin = published_posterior(case, load_priors("thesis"))
        own = thin.coordinates
        plain = FeaturePosterior(thin.data, Coordinates(own.free, own.fixed, own.tied, own.shared), case=case)
        z = np.random.default_rng(6).standard_normal((50, thin.ndim))
        here, there = own.sampled(z), plain.coordinates.sampled(z)
        assert {s.name for s in own.sheets} == {"k1t", "theta0"}
        ratio = own.log_prior(here) - plain.coordinates.log_prior(there)
        with_sheets, without = thin(here), plain(there)
        both = np.isfinite(without)
        assert both.sum() > 20
        np.testing.assert_array_equal(np.isfinite(with_sheets), both)
        np.testing.assert_allclose(with_sheets[both] - without[both], ratio[both], atol=1e-6)


def test_the_sheets_of_a_case_lie_where_its_numbers_are():
    """A spring and an angle on their sheets give the measured period and acceleration within their errors or so."""
    posterior = published_posterior("II", load_priors("thesis"))
    names = posterior.names
    points = posterior.coordinates.sampled(np.zeros((1, posterior.ndim)))
    points[:, [names.index("k1t"), names.index("theta0")]] = 0.0
    away = dict(zip([d.name for d in posterior.data], posterior.misfits(points)[0], strict=True))
    assert abs(away["period (uncoupled)"]) < 2.0
    assert abs(away["max_acceleration (coupled)"]) < 5.0
    plain = posterior.misfits(posterior.coordinates.sampled(np.zeros((1, posterior.ndim))))[0]
    assert max(abs(plain)) > 20.0  # where the middle of the prior is


def test_densities_with_wider_errors_are_those_of_the_wider_distribution():
    posterior = published_posterior("II", load_priors("thesis"))
    misfits = np.array([[0.0, 1.0, -2.0, 30.0, 0.3, np.nan]])
    found = posterior.densities(misfits, 4.0)[0]
    scale = 4.0 * np.array([d.standard_error for d in posterior.data])
    expected = stats.t.logpdf(misfits[0] * scale / 4.0, 2.0, scale=scale)
    np.testing.assert_allclose(found[:5], expected[:5])
    assert found[5] == -np.inf


def test_with_data_that_say_nothing_the_posterior_is_the_prior():
    """Standard errors a million times too large: what comes out must be the prior, in every parameter.

    By the first priors, whose records nearly all have a second peak: that one was measured says nothing there.
    """
    base = published_posterior("IV", load_priors("thesis_first"))
    vague = [Datum(d.configuration, d.quantity, d.value, 1e6 * d.standard_error) for d in base.data]
    posterior = FeaturePosterior(vague, base.coordinates)
    rng = np.random.default_rng(8)
    start = annealed_start(
        base.coordinates.log_prior,
        Powers(lambda x: posterior.log_likelihood(x).sum(axis=1)),
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
            Powers(lambda x: np.full(len(x), -np.inf)),
            coordinates.draw(np.random.default_rng(1), 64),
            np.random.default_rng(1),
        )


def test_a_posterior_with_an_effect_takes_its_parameters_as_coordinates():
    """At its null the effect changes nothing; a soft release lowers the first peak, in both configurations."""
    fitted = published_posterior("IV", load_priors("thesis"))
    plain = FeaturePosterior(fitted.data, Coordinates(fitted.coordinates.free, tied=fitted.coordinates.tied,
                                                      fixed=fitted.coordinates.fixed))  # fmt: skip
    ramp = EFFECTS["release_ramp"].variant("linear")
    free = plain.coordinates.free | {f"{OF_EFFECT}{p.name}": p.prior for p in ramp.parameters}
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


@pytest.mark.parametrize("case", ["I", "III"])
def test_records_are_long_enough_for_their_features(case):
    """Longer ones give the same wherever there is a period; what has one in these only is far from any measured."""
    posterior = published_posterior(case, load_priors("thesis_first"))
    longest = FeaturePosterior(posterior.data, posterior.coordinates, case=case, times=FEATURE_TIMES)
    assert posterior.times[-1] < 0.7 * FEATURE_TIMES[-1]
    points = posterior.coordinates.draw(np.random.default_rng(5), 800)
    found, more = posterior.predict(points), longest.predict(points)
    for configuration in ("uncoupled", "coupled"):
        own = [i for i, d in enumerate(posterior.data) if d.configuration == configuration]
        period = next(i for i in own if posterior.data[i].quantity == "period")
        there = np.isfinite(found[:, period])
        assert np.mean(there) > 0.7
        np.testing.assert_allclose(found[np.ix_(there, own)], more[np.ix_(there, own)], rtol=1e-9)
        late = more[~there, period]
        assert np.all(late[np.isfinite(late)] > 1.25 * posterior.data[period].value)
    assert feature_times([d for d in posterior.data if d.quantity != "period"]) is FEATURE_TIMES
