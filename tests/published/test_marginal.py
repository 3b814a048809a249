"""The features of one case with spring and angle integrated out, against a grid of simulated pairs of both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import from_standard, to_standard
from bayes_damper.priors.files import load_priors
from bayes_damper.published.marginal import BLUR, OWN, CaseFeatures
from bayes_damper.published.measurements import load_published
from bayes_damper.published.posterior import FEATURE_QUANTITIES, Datum
from bayes_damper.rig.parameters import OF_EFFECT

RIG = {"J1": 3.1e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "t_min": 0.6e-3}
USUAL = {"mu": 0.012, "k2t": 2.0, "c2t": 0.006, "drag": 0.035, "nu": 40.0, "c1t": 0.005}
# Likely values of each case.
OF_CASES = {
    "I": {"mu": 0.0097, "k2t": 2.34, "c2t": 0.0026, "drag": 0.021, "nu": 2610.0, "c1t": 0.0041},
    "II": {"mu": 0.0087, "k2t": 1.07, "c2t": 0.00075, "drag": 0.0631, "nu": 17.2, "c1t": 0.00097},
    "III": {"mu": 0.023, "k2t": 24.7, "c2t": 0.001, "drag": 0.0494, "nu": 6.84, "c1t": 0.0011},
    "IV": {"mu": 0.0109, "k2t": 2.01, "c2t": 0.0095, "drag": 0.0324, "nu": 58.9, "c1t": 0.0066},
}
# Here the coupled period jumps by half as the angle changes by a few per cent.
JUMPS = {
    "mu": 0.00957, "k2t": 2.3432, "c2t": 0.00255, "drag": 0.02125, "nu": 2610.0, "c1t": 0.00411, "J1": 3.28e-3,
    "J2": 2.52e-3, "R": 0.09663, "r": 0.01223, "N0": 103.7, "t_min": 0.7e-3,
}  # fmt: skip


def case_features(case, **options):
    data = [Datum(m.configuration, m.quantity, m.value, m.standard_error, m.n) for m in load_published().of_case(case)]
    return CaseFeatures(case, data, load_priors("thesis").for_case(case), **options)


def point(found, values):
    return found.coordinates.points({name: (RIG | values)[name] for name in found.coordinates.names})


def on_a_grid(found, z, more=None, reach=0.03, coupled=True):
    """Log likelihood at one point, and means of spring and angle, by 41 x 121 records of each configuration.

    more : parameters beside the coordinates; reach : largest change of the spring's logarithm; coupled : of all
    numbers, or of the uncoupled rig's alone.
    """
    values = found.coordinates.values(z) | {name: np.array([x]) for name, x in (more or {}).items()}
    period = next(d for d in found.data if d.name == "period (uncoupled)")
    # The spring that gives the period lies within 3 % of that of the undamped rig, its error within 0.3 %.
    u = reach * np.sinh(np.linspace(-2.5, 2.5, 41)) / np.sinh(2.5)
    k1t = float(values["J1"][0]) * (2.0 * np.pi / period.value) ** 2 * np.exp(u)
    v = np.linspace(-3.6, 3.6, 121)
    springs, angles = (x.ravel() for x in np.meshgrid(k1t, from_standard(found.own["theta0"], v), indexing="ij"))
    table = {name: np.full(springs.size, x[0]) for name, x in values.items()} | {"k1t": springs, "theta0": angles}
    features = found.predict(table)
    errors = found.scales(table, features)
    heights = sum(
        stats.t.logpdf(features[:, j], d.n - 1, d.value, errors[:, j])
        for j, d in enumerate(found.data) if coupled or d.configuration == "uncoupled"
    )  # fmt: skip
    density = np.nan_to_num(np.exp(heights)).reshape(len(u), len(v))
    density *= (np.exp(found.own["k1t"].logpdf(k1t)) * k1t)[:, None] * stats.norm.pdf(v)
    over_angles = np.trapezoid(density, v, axis=1)
    total = np.trapezoid(over_angles, u)
    theta0 = np.trapezoid(np.trapezoid(density * angles.reshape(density.shape), v, axis=1), u) / total
    return np.log(total), np.trapezoid(over_angles * k1t, u) / total, theta0


@pytest.mark.slow  # 5 000 records of each configuration at each point
@pytest.mark.parametrize("case", ["I", "II", "III", "IV"])
def test_likelihood_is_the_integral_over_spring_and_angle(case):
    found, fine = case_features(case), case_features(case, parts=24)
    for more in ({}, {"t_min": 0.75e-3}):
        z = point(found, USUAL | OF_CASES[case] | more)
        expected, k1t, theta0 = on_a_grid(found, z)
        assert found.log_likelihood(z)[0] == pytest.approx(expected, abs=0.6)
        # In case II the period jumps with the spring as well, whose integral stands apart.
        assert fine.log_likelihood(z)[0] == pytest.approx(expected, abs=0.45 if case == "II" else 0.15)
        values = {name: np.repeat(x, 400) for name, x in found.coordinates.values(z).items()}
        drawn = fine.own_draws(values, np.random.default_rng(1))
        for x, mean in ((drawn["k1t"], k1t), (drawn["theta0"], theta0)):
            assert abs(x.mean() - mean) < 5.0 * x.std() / np.sqrt(len(x)) + 1e-3 * mean


@pytest.mark.slow  # 5 000 records of each configuration at each point
@pytest.mark.parametrize("case", ["III", "IV"])
@pytest.mark.parametrize(
    ("effect", "parameters"),
    [("sensor_gain", {"error": 0.1}), ("release_ramp", {"time": 4e-3}), ("inertia_error", {"error": 0.1})],
)
def test_likelihood_of_a_formula_is_the_integral_too(case, effect, parameters):
    """A gain of 1.1 or a slow release moves the highest acceleration by far more than the angle's prior does."""
    law = EFFECTS[effect].variants[0]
    assert {p.name for p in law.parameters} == set(parameters)
    found = case_features(case, law=law, pilot=True)
    z, more = point(found, USUAL | OF_CASES[case]), {OF_EFFECT + name: x for name, x in parameters.items()}
    values = found.coordinates.values(z) | {name: np.array([x]) for name, x in more.items()}
    assert found.log_density(values)[0] == pytest.approx(on_a_grid(found, z, more)[0], abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.05, 0.12])
@pytest.mark.parametrize("quantities", [("max_acceleration",), FEATURE_QUANTITIES])
def test_likelihood_with_a_discrepancy_is_the_integral_too(quantities, size):
    """Where the uncoupled period has one, the spring is known by its prior alone, and other features move with it."""
    blurred = {(configuration, q) for configuration in ("uncoupled", "coupled") for q in quantities}
    for case, own in OF_CASES.items():
        found = case_features(case, blurred=blurred)
        z = point(found, USUAL | own)
        values = found.coordinates.values(z) | {BLUR: np.array([size])}
        expected, k1t, _ = on_a_grid(found, z, {BLUR: size}, 0.6 if "period" in quantities else 0.03)
        assert found.log_density(values)[0] == pytest.approx(expected, abs=0.5 if case == "II" else 0.25)
        many = {name: np.repeat(x, 300) for name, x in values.items()}
        springs = found.own_draws(many, np.random.default_rng(4))["k1t"]
        assert springs.mean() == pytest.approx(k1t, rel=0.03 if "period" in quantities else 1e-3)


@pytest.mark.slow
def test_uncoupled_numbers_alone_have_their_own_likelihood():
    found = case_features("IV")
    z = point(found, USUAL | OF_CASES["IV"])
    values = {name: np.repeat(x, 400) for name, x in found.coordinates.values(z).items()}
    expected, _, theta0 = on_a_grid(found, z, coupled=False)
    assert found.log_density(values, coupled=False) == pytest.approx(np.full(400, expected), abs=0.1)
    angle = found.own_draws(values, np.random.default_rng(3), coupled=False)["theta0"]
    assert abs(angle.mean() - theta0) < 5.0 * angle.std() / np.sqrt(len(angle))


@pytest.mark.slow
def test_a_period_that_jumps_with_the_angle_makes_no_likelihood_of_its_own():
    """Features drawn out linearly from two angles are 3 nats too high here; more records lead to the integral."""
    coarse, fine = case_features("I"), case_features("I", parts=16)
    z = point(coarse, JUMPS)
    expected, *_ = on_a_grid(coarse, z)
    assert coarse.log_likelihood(z)[0] == pytest.approx(expected, abs=0.6)
    assert fine.log_likelihood(z)[0] == pytest.approx(expected, abs=0.15)


def test_points_whose_records_lack_a_feature_have_no_likelihood():
    found = case_features("IV")
    z = np.concatenate([point(found, USUAL), point(found, USUAL | {"c1t": 1.0})])
    height = found.log_likelihood(z)
    assert np.isfinite(height[0])
    assert height[1] == -np.inf
    own = found.own_draws(found.coordinates.values(z), np.random.default_rng(0))
    assert {name: bool(np.isnan(x[1])) for name, x in own.items()} == dict.fromkeys(OWN, True)


def test_a_point_is_the_same_alone_and_among_others():
    found = case_features("II")
    z = point(found, USUAL) + 0.1 * np.random.default_rng(2).standard_normal((20, found.coordinates.ndim))
    together = found.log_likelihood(z)
    assert [found.log_likelihood(x[None])[0] for x in z] == pytest.approx(together, abs=1e-9)


def test_what_cannot_be_used_is_refused():
    priors = load_priors("thesis").for_case("IV")
    data = case_features("IV").data
    with pytest.raises(InputError, match=r"case IV: .* are needed, all from the same number of trials"):
        CaseFeatures("IV", data[1:], priors)
    with pytest.raises(InputError, match=r"case IV: .* given are .* of 4"):
        CaseFeatures("IV", [replace(data[0], n=4), *data[1:]], priors)
    fixed = priors.replace(theta0=0.08)
    with pytest.raises(InputError, match="theta0 needs a prior with a width in case IV"):
        CaseFeatures("IV", data, fixed)


def test_points_are_those_of_the_coordinates():
    found = case_features("I")
    z = point(found, USUAL)
    assert z[0, found.coordinates.names.index("mu")] == pytest.approx(
        float(to_standard(load_priors("thesis").for_case("I").free["mu"], 0.012))
    )
