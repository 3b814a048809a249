"""Prior files: what the shipped ones assume, the arithmetic of a set, and every fault of a file in one error."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaigns import write_synthetic
from scipy import stats

from bayes_damper.campaign import Constant, load_campaign
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import LogNormal, LogStudent, Normal, Uniform, median
from bayes_damper.priors.files import campaign_priors, load_priors, priors_from_dict
from bayes_damper.published.measurements import load_published
from bayes_damper.rig.parameters import PARAMETERS, nearest, unit_of

SHIPPED = ("thesis", "thesis_first", "campaign")


@pytest.fixture(scope="module")
def thesis():
    return load_priors("thesis")


def faults_of(text, tmp_path, **options):
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_priors(path, **options)
    assert all(str(path) in fault for fault in error.value.faults)
    return error.value.faults


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_entry_has_a_reason_and_a_source(name):
    for entry in load_priors(name).entries.values():
        assert len(entry.reason) > 5, entry.name
        assert entry.source, entry.name
        assert entry.unit == PARAMETERS[entry.name].unit


@pytest.mark.parametrize("name", SHIPPED)
def test_round_trip_through_a_dictionary(name):
    priors = load_priors(name)
    assert priors_from_dict(priors.to_dict()) == priors


@pytest.mark.parametrize("case", ["I", "II", "III", "IV"])
def test_thesis_priors_allow_the_measured_periods(thesis, case):
    """At the nominal k1t and J1 the uncoupled periods are impossible (thesis Table 4, p. 14); the priors reach them."""
    draws = thesis.for_case(case).draw(np.random.default_rng(1), 20_000)
    measured = {(m.configuration, m.quantity): m.value for m in load_published().of_case(case)}
    period = 2.0 * math.pi * np.sqrt(draws["J1"] / draws["k1t"])
    assert 0.01 < np.mean(period > measured["uncoupled", "period"]) < 0.99


@pytest.mark.parametrize("case", ["I", "II", "III", "IV"])
def test_thesis_priors_allow_the_measured_drop_of_the_peak(thesis, case):
    """mu N0 R / J1 must be able to take what coupling takes off the first peak (thesis Table 8, p. 18).

    The priors come from elsewhere: that they expect more friction than was measured is no fault; to exclude it is.
    """
    draws = thesis.for_case(case).draw(np.random.default_rng(2), 20_000)
    peak = {m.configuration: m.value for m in load_published().of_case(case) if m.quantity == "max_acceleration"}
    friction = draws["mu"] * draws["N0"] * draws["R"] / draws["J1"]
    assert 0.02 < np.mean(friction > peak["uncoupled"] - peak["coupled"]) < 0.98


def test_release_angles_are_uncertain_by_a_tenth_of_a_degree_or_two_percent(thesis):
    for name, case in load_published().cases.items():
        prior = thesis.for_case(name).free["theta0"]
        assert prior.mean == pytest.approx(case.theta0)
        assert prior.sd == pytest.approx(max(math.radians(0.1), 0.02 * case.theta0))


def test_stiffness_is_uncertain_by_a_tenth(thesis):
    for name, case in load_published().cases.items():
        prior = thesis.for_case(name).free["k1t"]
        assert (prior.mean, prior.sd) == (case.k1t, pytest.approx(0.1 * case.k1t))


def test_first_priors_of_the_thesis_are_kept_and_the_shipped_ones_are_wider():
    """Those of k2t, c2t and c1t: the first leant on the fitted values themselves."""
    first, thesis = (load_priors(name).for_case("IV") for name in ("thesis_first", "thesis"))
    assert first.free["mu"] == LogNormal(0.01, 2.5)
    assert first.free["drag"] == LogNormal(0.01, 3.0)
    assert first.free.keys() == thesis.free.keys()
    assert all(thesis.free[name].factor > first.free[name].factor for name in ("k2t", "c2t", "c1t"))


def test_thesis_ties_the_two_bearings_and_campaigns_do_not(thesis):
    assert thesis.tied == {"c3t": "c1t"}
    assert "c3t" in load_priors("campaign").names


def test_levels(thesis):
    assert (thesis.level("J1"), thesis.level("mu"), thesis.level("c3t")) == ("campaign", "case", "case")
    assert load_priors("campaign").level("delay") == "trial"


def test_a_set_with_values_per_case_wants_a_case(thesis):
    with pytest.raises(InputError, match="choose the case first"):
        _ = thesis.free
    with pytest.raises(InputError) as error:
        thesis.for_case("V")
    assert len(error.value.faults) == 2


def test_log_density_is_the_sum_of_its_parts():
    priors = priors_from_dict({"mu": [0.0, 0.5], "drag": {"dist": "halfnormal", "sd": 0.02, "unit": "N m"}, "nu": 100})
    got = priors.log_density({"mu": [0.1, 0.6], "drag": [0.01, 0.01]})
    expected = math.log(2.0) + stats.halfnorm(scale=0.02).logpdf(0.01)
    assert got[0] == pytest.approx(expected)
    assert got[1] == -np.inf
    with pytest.raises(InputError, match="no value given for drag"):
        priors.log_density({"mu": 0.1})


def test_a_prior_with_the_tails_of_student_is_read_widened_and_written_again():
    entry = {"dist": "logstudent", "median": 0.01, "factor": 3.0, "unit": "N m"}
    priors = priors_from_dict({"drag": entry})
    assert priors.free["drag"] == LogStudent(0.01, 3.0)
    assert priors.widened(2.0).free["drag"] == LogStudent(0.01, 9.0)
    assert priors_from_dict(priors.to_dict()).free == priors.free


def test_unit_cube_gives_quantiles_and_carries_fixed_and_tied_values():
    priors = priors_from_dict(
        {"c1t": {"dist": "lognormal", "median": 0.01, "factor": 2.0, "unit": "N m s/rad"}, "c3t": "c1t", "J12": 0}
    )
    values = priors.from_unit_cube([[0.5], [stats.norm.cdf(1.0)]])
    assert list(values) == ["c1t", "c3t", "J12"]
    np.testing.assert_allclose(values["c1t"], [0.01, 0.02])
    np.testing.assert_array_equal(values["c1t"], values["c3t"])
    np.testing.assert_array_equal(values["J12"], [0.0, 0.0])
    assert priors.medians() == {"c1t": pytest.approx(0.01), "c3t": pytest.approx(0.01), "J12": 0.0}
    with pytest.raises(ValueError, match="1 columns"):
        priors.from_unit_cube([[0.5, 0.5]])


def test_draws_are_reproducible_and_inside_the_support(thesis):
    priors = thesis.for_case("I")
    one, two = (priors.draw(np.random.default_rng(3), 500) for _ in range(2))
    for name in priors.names:
        np.testing.assert_array_equal(one[name], two[name])
    assert np.all(np.isfinite(priors.log_density(one)))


def test_replace_frees_fixes_and_ties(thesis):
    changed = thesis.replace(mu=0, c3t=LogNormal(0.02, 2.0), drag="friction_torque", friction_torque=0.1)
    assert changed.fixed["mu"] == 0.0
    assert "c3t" not in changed.tied
    assert changed.tied["drag"] == "friction_torque"
    with pytest.raises(InputError, match="did you mean 'drag'"):
        thesis.replace(drags=1.0)
    with pytest.raises(InputError, match="has no entry"):
        thesis.replace(mu="sigma1")


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_widening_keeps_the_middle_and_changes_the_width(thesis, factor):
    before, after = thesis.for_case("IV").free, thesis.widened(factor).for_case("IV").free
    for name in ("mu", "k1t", "nu", "t_min"):
        assert median(after[name]) == pytest.approx(median(before[name]), rel=1e-3)
        log = name in ("mu", "nu")
        width = [
            np.ptp(np.log(d[name].ppf([0.25, 0.75])) if log else d[name].ppf([0.25, 0.75])) for d in (before, after)
        ]
        assert width[1] / width[0] == pytest.approx(factor, rel=0.02)
    assert before["J1"].lower == after["J1"].lower
    with pytest.raises(ValueError, match="positive"):
        thesis.widened(0.0)


def test_only_takes_what_a_tie_needs(thesis):
    assert set(thesis.only(["c3t", "mu"]).entries) == {"mu", "c1t", "c3t"}


def test_a_file_overrides_a_base_entry_by_entry(thesis, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("mu = 0.0\nnu = [10, 1000]\n")
    merged = load_priors(path, base=thesis)
    assert merged.fixed["mu"] == 0.0
    assert merged.for_case("I").free["nu"] == Uniform(10.0, 1000.0)
    assert merged.for_case("I").free["k2t"] == thesis.for_case("I").free["k2t"]


def test_degrees_and_milliseconds_are_converted(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'theta0 = {dist = "normal", mean = 180, sd = 90, unit = "deg"}\n'
        'delay = {dist = "fixed", value = 2, unit = "ms"}\n'
    )
    priors = load_priors(path)
    assert priors.free["theta0"] == Normal(math.pi, math.pi / 2.0)
    assert priors.fixed["delay"] == pytest.approx(2e-3)


def test_translational_rigs_have_units_of_their_own(tmp_path):
    assert unit_of("k2t", "translational") == "N/m"
    path = tmp_path / "mine.toml"
    path.write_text('k2t = {dist = "lognormal", median = 100, factor = 2, unit = "N/m"}\n')
    assert load_priors(path, kind="translational").free["k2t"] == LogNormal(100.0, 2.0)
    with pytest.raises(InputError, match="unit is 'N/m'"):
        load_priors(path)


def test_names_of_effects_can_be_added(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('"stick_slip.ratio" = [1.0, 2.0]\n')
    assert load_priors(path, extra={"stick_slip.ratio": "1"}).names == ("stick_slip.ratio",)
    with pytest.raises(InputError, match="is no parameter"):
        load_priors(path)


def test_all_faults_of_a_file_come_at_once(tmp_path):
    faults = faults_of(
        """
        name = 3
        mue = 0.1
        k2t = {dist = "lognormal", median = 1.5, factor = 0.9, unit = "N m/rad"}
        c2t = {dist = "normal", mean = 0.05, sd = -0.1, unit = "N s/m"}
        drag = [0.1, 0.2, 0.3]
        nu = {dist = "loguniforn", lower = 5, upper = 10, unit = "s/rad"}
        J1 = {dist = "normal", mean = 3e-3, sdd = 1e-4, unit = "kg m^2"}
        tail = {distribution = "normal", mean = 0.5}
        R = {dist = "uniform", lower = 0.2, upper = 0.1, unit = "m", level = "rig"}
        r = true
        """,
        tmp_path,
    )
    text = "\n".join(faults)
    for expected in (
        "name must be a text",
        "'mue' is no parameter; did you mean 'mu'?",
        "k2t: factor must be above 1",
        "c2t: unit is 'N s/m', but this parameter is in 'N m s/rad'",
        "c2t: sd must be positive, got -0.1",
        "drag: a list must be a pair",
        "nu: dist must be one of",
        "J1: unknown key 'sdd' for dist 'normal'; did you mean 'sd'?",
        "J1: normal needs sd",
        "tail: dist must be one of",
        "got none: the table has 'distribution', 'mean'",
        "R: level must be one of",
        "R: lower (0.2) must be below upper (0.1)",
        "r: must be a number, a name, a pair or a table",
    ):
        assert expected in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('k2t = {dist = "lognormal", median = 1.5, factor = 2}', 'has no unit; write unit = "N m/rad"'),
        ('mu = {dist = "loguniform", lower = 0, upper = 1, unit = "1"}', "lower must be positive"),
        ('mu = {dist = "lognormal", median = -1, factor = 2, unit = "1"}', "median must be positive"),
        ("mu = nan", "finite"),
        ("mu = -0.01", "mu: -0.01 cannot be: a coefficient of friction is 0 or more"),
        ("c1t = [-1, -0.5]", "c1t: 100% of this prior lies below 0, but a damping is 0 or more"),
        ("nu = 0", "nu: 0 cannot be: the sharpness of a friction is above 0"),
        ("sigma1 = 0", "sigma1: 0 cannot be: a noise is above 0"),
        ('nu = {dist = "normal", mean = 60, sd = 60, unit = "s/rad"}', "nu: 16% of this prior lies below 0"),
        ('mu = {dist = "normal", mean = "a", sd = 1, unit = "1"}', "mean must be a finite number, not 'a'"),
        ('mu = {dist = "normal", mean = 0, sd = 1, lower = 20, unit = "1"}', "leave nothing"),
        ('c3t = "c1"', "tied to 'c1', which has no entry"),
        ('c1t = 0.01\nc3t = "c1t"\nk3t = "c3t"', "which is itself tied; tie it to c1t"),
        ('c1t = "c3t"\nc3t = "c1t"', "c1t and c3t are tied to each other; give one of them a prior"),
        ('mu = -0.01\nc3t = "c1"', "tied to 'c1', which has no entry"),
        ('c1t = 0.01\nmu = "c1t"', "cannot be tied"),
        ('mu = {dist = "tied"}', "to = NAME"),
        ('mu = {dist = "normal", sd = 1, unit = "1", cases = {I = {meen = 1}}}', "case I: unknown key 'meen'"),
        ('mu = {dist = "normal", unit = "1", cases = 3}', "cases must be tables"),
        ("mu = ", "not valid TOML"),
    ],
)
def test_each_fault_is_one_sentence(text, expected, tmp_path):
    assert expected in "\n".join(faults_of(text + "\n", tmp_path))


def test_a_coupling_that_pushes_apart_needs_a_spring_to_ground(tmp_path):
    campaign = load_campaign(write_synthetic(tmp_path / "campaign", repeats=1, rate=250.0, duration=0.6))
    assert campaign_priors({"k2t": 0.5}, campaign).fixed["k2t"] == 0.5
    for prior in (-0.5, [-2.0, -0.5]):
        with pytest.raises(InputError, match="k2t: negative altogether, and ground2_stiffness is 0"):
            campaign_priors({"k2t": prior}, campaign)
    held = replace(campaign, rig=replace(campaign.rig, ground2_stiffness=Constant(2.0)))
    assert campaign_priors({"k2t": -0.5}, held).fixed["k2t"] == -0.5


def test_a_missing_file_and_an_unknown_name_are_told(tmp_path):
    with pytest.raises(InputError, match="there is no such prior file"):
        load_priors(tmp_path / "nothing.toml")
    with pytest.raises(InputError, match="did you mean 'thesis'"):
        load_priors("thesiss")


def test_nearest_name():
    assert nearest("K2T", PARAMETERS) == "k2t"
    assert nearest("completely_different", PARAMETERS) is None


def test_a_folder_of_the_same_name_hides_no_shipped_file(tmp_path, monkeypatch):
    """Results kept in a folder "thesis" must not take the place of the priors of that name."""
    (tmp_path / "thesis").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_priors("thesis").to_dict()
    with pytest.raises(InputError, match="none of the shipped"):
        load_priors(str(tmp_path / "thesis"))


def test_a_prior_for_a_case_that_does_not_exist_is_named(tmp_path):
    campaign = load_campaign(write_synthetic(tmp_path))
    own = {"mu": {"dist": "normal", "mean": 0.01, "sd": 0.01, "lower": 0.0, "unit": "1", "cases": {"VI": {"sd": 0.1}}}}
    with pytest.raises(InputError, match="mu: there is no case 'VI' in this campaign; did you mean 'IV'"):
        campaign_priors(own, campaign)
    own["mu"]["cases"] = {"IV": {"sd": 0.1}}
    assert campaign_priors(own, campaign).entries["mu"].cases["IV"].sd == 0.1
