"""The site map: responses against full simulations, the right site for known causes, honest evidence and torque."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from small_rig import RIG, STIFFNESSES, knock, measured, variant
from test_scatter import laboratory

from bayes_damper.calibration import Switches, calibrate, calibrate_nominal
from bayes_damper.calibration.own_values import Scatter
from bayes_damper.calibration.scatter import carried
from bayes_damper.diagnosis.response import _steps, motions, project, project_parts
from bayes_damper.diagnosis.sites import (
    LARGEST_LEFT,
    STRENGTHS,
    _torque_site,
    dense_evidence,
    share_left,
    shares_of,
    site_map,
    write_missing_torque,
)
from bayes_damper.effects.base import SITES, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.vector_math import exp, lane, tanh
from bayes_damper.simulation.model import Model

CUBIC = {"effect": variant("magnet_cubic", "cubic"), "values": {"cubic": 200.0}}


@pytest.fixture(scope="module")
def faultless():
    return calibrate_nominal(measured(3))


@pytest.fixture(scope="module")
def interface():
    fit = calibrate_nominal(measured(4, **CUBIC))
    return fit, site_map(fit)


def test_linearised_response_agrees_with_a_simulation():
    """A small torque that depends on the motion, through full simulation and through the variational equations."""
    faultless = calibrate_nominal(measured(3), switches=Switches(delay=False, friction=False, drag=False))
    size = 0.05
    for motion in motions(faultless):
        group = motion.group
        torque = -size * motion.phi**3 * group.coupled
        response = motion.respond(torque[:, None], -torque[:, None])[:, 0]
        values = {k: v[0] for k, v in faultless.parameters.items()}
        for k, i in enumerate(group.trials):
            trial = faultless.problem.experiment.trials[i]
            rig = RIG | values | {
                "k1t": faultless.problem.experiment.stiffnesses[trial.k1t][0], "theta0": motion.theta0[k],
            }  # fmt: skip
            bare = Model(group.coupled).simulate(rig, group.times).y[0]
            other = Model(group.coupled, effect=CUBIC["effect"])
            changed = other.simulate(rig, group.times, effect={"cubic": size}, tolerance=0.1).y[0]
            still = other.simulate(rig, group.times, effect={"cubic": 0.0}, tolerance=0.1).y[0]
            assert np.allclose(motion.y[k], bare, atol=1e-3 * np.abs(bare).max())
            if not group.coupled:
                assert not np.any(response[k])
                continue
            difference = changed - still
            error = np.median(np.abs(response[k] - difference))
            assert error < 0.02 * np.median(np.abs(difference))


def test_projection_takes_out_what_parameters_can_do(faultless):
    """A column that a parameter already has is left with next to nothing; noise is left as it is."""
    rng = np.random.default_rng(1)
    columns = []
    for block in faultless.linear.blocks:
        n, _, d = block.J.shape
        columns.append(np.stack([block.J[:, 0], block.J[:, 1], rng.standard_normal((n, d))], axis=1))
    judged = project(faultless, columns)
    left = np.diag(judged.gram) / judged.raw
    assert np.all(left[:2] < 1e-2)
    assert left[2] > 0.95


@pytest.mark.parametrize(
    ("site", "cause"),
    [
        ("ground1", {"effect": variant("spring_cubic"), "values": {"k3": 40.0}}),
        pytest.param("ground1", {"torque": knock(0.2, 0.012, 0.06)}, marks=pytest.mark.slow),
        ("bearings", {"effect": variant("quadratic_drag"), "values": {"coefficient": 0.3}}),
        pytest.param("sensor", {"sensor": lambda t, y: np.clip(y, -130.0, 130.0)}, marks=pytest.mark.slow),
        pytest.param(
            "sensor",
            {"sensor": lambda t, y: y + (np.array([[0.0], [0.12]]) * y[:1])[: len(y)]},
            marks=pytest.mark.slow,
        ),
        ("sensor", {"sensor": lambda t, y: np.where((t > 0.131) & (t < 0.139), y[:, [131]], y)}),
        ("release", {"torque": knock(0.004, 0.006, 0.25)}),
    ],
    ids=["hardening", "knock", "drag", "clipping", "crosstalk", "held reading", "second touch"],
)
def test_a_cause_is_found_at_its_site(site, cause):
    found = site_map(calibrate_nominal(measured(5, **cause)), torque=False)
    assert found.best == site
    assert found.probabilities["none"] < 0.01
    assert site in found.credible_set()
    assert abs(sum(found.probabilities.values()) - 1.0) < 1e-12


def test_what_touches_a_rig_that_comes_back_is_what_released_it():
    """For a fifteenth of a period, one period after the release in all trials: the floor cannot know when that is."""
    period = 2.0 * math.pi * math.sqrt(RIG["J1"] / STIFFNESSES[0])
    touch = knock(1.02 * period, period / 15.0, -0.15)
    twice = (("I", 0, 0.1), ("II", 0, 0.08))
    found = site_map(calibrate_nominal(measured(5, torque=touch, cases=twice, duration=0.8)), torque=False)
    assert found.best == "release"
    assert found.probabilities["ground1"] < 0.3


@lane
def _dent(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Both shafts rest in a dent of their races 0.02 rad off the middle."""
    x1, x2 = (th1 - 0.02) / 0.01, (th2 - 0.02) / 0.01
    return -p[0] * x1 * exp(-0.5 * x1 * x1), -p[0] * x2 * exp(-0.5 * x2 * x2)


@lane
def _one_way(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Seals that drag in one direction only."""
    return -p[0] * 0.5 * (1.0 + tanh(rig.nu * w1)), -p[0] * 0.5 * (1.0 + tanh(rig.nu * w2))


@pytest.mark.slow
@pytest.mark.parametrize("law", [_dent, _one_way], ids=["dent", "one way"])
def test_bearings_are_told_from_springs_and_weights(law):
    """What bearings do depends on the angle or the direction of each shaft, and is the same law on both."""
    size = EffectParameter("size", "N m", "Torque.", HalfNormal(1.0), "For this test.", 0.0)
    cause = Variant(name="law", formula="Q = law(th, w)", parameters=(size,), torque=law, couples="bodies")
    campaign = measured(5, effect=cause, values={"size": 0.05}, duration=0.8)
    found = site_map(calibrate_nominal(campaign, switches=Switches()))  # angle, instant and friction differ, no more
    assert found.best == "bearings"
    assert found.torque_site == "bearings"


def test_torque_is_told_where_it_may_be_missing():
    """A site that is not the likeliest one, but not excluded, has its torque told; beside a sure sensor none has."""
    some = {"ground1": 0.3, "bearings": 0.05, "sensor": 0.6, "none": 0.05}
    assert _torque_site(some) == "ground1"
    assert _torque_site(some | {"ground1": 0.02, "sensor": 0.88}) is None
    assert _torque_site({"sensor": 0.5, "none": 0.5}) is None
    wrong_start = {"release": 0.6, "ground1": 0.3, "sensor": 0.05, "none": 0.05}
    assert _torque_site(wrong_start) == "release"
    assert _torque_site(wrong_start, {"release"}) == "ground1"


def test_interface_torque_is_found_at_the_interface_with_its_shape(interface):
    """The missing torque grows with the cube of the relative angle, apart from what stiffness and damping can take."""
    fit, found = interface
    assert found.best == "interface"
    assert found.probabilities["interface"] > 0.9
    coupled = [m for m in found.torque if np.any(m.th2)]
    assert len(coupled) == 4
    for m in coupled:
        assert np.allclose(m.torque[0], -m.torque[1])
    phi = np.concatenate([m.phi for m in coupled])
    slip = np.concatenate([m.slip for m in coupled])
    q2 = np.concatenate([m.torque[1] for m in coupled])
    nominal = np.column_stack([phi, slip, np.tanh(60.0 * slip), np.tanh(60.0 * slip) * np.abs(phi)])

    def beyond(x):
        return x - nominal @ np.linalg.lstsq(nominal, x, rcond=None)[0]

    shape = beyond(q2)
    expected = beyond(200.0 * phi**3)
    assert np.corrcoef(shape, expected)[0, 1] > 0.9
    assert set(found.curve()) == {"phi", "slip"}
    assert fit.problem.experiment.coupled


@pytest.mark.parametrize(("on", "names"), [((1.0, 0.0), {"th1", "w1"}), ((0.0, 1.0), {"th2", "w2"})])
def test_a_torque_of_the_release_is_shown_on_the_body_that_it_acts_on(interface, on, names):
    """A release may push either body: the curve takes the coordinates of the one that was pushed."""
    _, found = interface
    torque = tuple(replace(m, torque=m.torque * np.array(on)[:, None]) for m in found.torque)
    pushed = replace(found, torque=torque, torque_site="release")
    assert names == set(pushed.curve())
    assert pushed.torque_body == on.index(1.0)


def test_missing_torque_is_what_the_fitted_laws_lack(interface):
    """True torque between the bodies less that of the nominal laws at their fitted parameters, along the motion.

    All but the smoothing constant, which belongs to the bearings too.
    """
    fit, found = interface
    fitted = RIG | {name: value for name, (value, _) in fit.parameters.items() if name != "nu"}

    def between(rig, m):
        pull = np.maximum(0.0, 1.0 - rig["R"] * np.abs(m.phi) / (2.0 * rig["r"]))
        dry = rig["mu"] * rig["N0"] * rig["R"] * pull * np.tanh(rig["nu"] * m.slip)
        return rig["k2t"] * m.phi + rig["c2t"] * m.slip + dry

    coupled = [m for m in found.torque if np.any(m.th2)]
    told = np.concatenate([m.torque[1] for m in coupled])
    lacking = np.concatenate([between(RIG, m) + 200.0 * m.phi**3 - between(fitted, m) for m in coupled])
    assert np.corrcoef(told, lacking)[0, 1] > 0.92
    assert np.std(told) == pytest.approx(np.std(lacking), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("k3", "rig"),
    [(20.0, {"cases": (("I", 0, 0.1),), "configurations": (False,)}), (60.0, {})],
    ids=["one body", "two bodies"],
)
def test_the_band_of_the_missing_torque_holds_what_the_fitted_spring_lacks(k3, rig):
    """A cubic spring is missing, of which the fitted stiffness and damping have taken over a part.

    Against all of the cubic torque the band would be off by 20 to 400 standard deviations: that is another question.
    """
    experiment = measured(1, effect=variant("spring_cubic"), values={"k3": k3}, **rig)
    experiment = replace(experiment, stiffnesses=tuple((k, 0.2 * k) for k, _ in experiment.stiffnesses))
    fit = calibrate_nominal(experiment)
    found, fitted = site_map(fit), {name: value for name, (value, _) in fit.parameters.items()}
    assert found.torque_site == "ground1"

    def lacking(m):
        k = experiment.stiffnesses[experiment.trials[m.trial].k1t][0]
        return -k3 * m.th1**3 - (k - fitted[f"k1t[{k:g}]"]) * m.th1 - (RIG["c1t"] - fitted["c1t"]) * m.w1

    true, told, sd = (
        np.concatenate(x) for x in zip(*((lacking(m), m.torque[0], m.sd[0]) for m in found.torque), strict=True)
    )
    assert np.mean(np.abs(told - true) < 1.645 * sd) > 0.9
    assert np.corrcoef(told, true)[0, 1] > 0.9
    assert np.sqrt(np.mean(sd**2)) < 0.7 * np.std(true)


@pytest.mark.slow
def test_no_torque_is_given_where_the_fit_is_too_far_off_for_linear_responses():
    """A coupling that hardens eight times as much: its torque would err by as much as it has."""
    fit = calibrate_nominal(measured(4, effect=CUBIC["effect"], values={"cubic": 1600.0}))
    found = site_map(fit)
    assert found.best == "interface"
    assert found.left > LARGEST_LEFT
    assert found.torque_site == "interface"
    assert found.torque == ()
    assert found.curve() == {}


def test_what_is_left_of_a_record_is_beyond_noise(interface, faultless):
    """Noise is no share of it; what a coupling that hardens leaves is."""
    assert share_left(faultless) < 0.02 < share_left(interface[0]) < LARGEST_LEFT
    louder = replace(faultless.problem.noise, innovation=(1e-3,) * len(faultless.problem.noise.phi), sensor=())
    all_of_it = replace(faultless, problem=faultless.problem.with_noise(louder))
    assert share_left(all_of_it) > 0.05


def test_without_a_gap_the_map_says_none(faultless):
    found = site_map(faultless)
    assert found.probabilities["none"] > 0.5
    assert set(found.probabilities) == {*SITES, "none"}


def test_missing_torque_is_written_as_a_table(tmp_path, interface):
    fit, found = interface
    path = tmp_path / "missing_torque.csv"
    write_missing_torque(path, found)
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(fit.problem.experiment.trials[i].times.size for i in fit.problem.trials)
    row = next(r for r in rows if r["configuration"] == "coupled" and float(r["time_s"]) > 0.1)
    assert float(row["torque1_n_m"]) == pytest.approx(-float(row["torque2_n_m"]))
    assert float(row["torque1_sd_n_m"]) > 0.0


def test_evidence_equals_the_ratio_of_densities():
    """Against the two multivariate normal densities of the data, averaged over the strengths of the prior."""
    rng = np.random.default_rng(2)
    root = rng.standard_normal((30, 3))
    root /= np.linalg.norm(root, axis=0)
    y = rng.standard_normal(30) + root @ np.array([4.0, -2.0, 1.0])
    ratios = [
        multivariate_normal(np.zeros(30), np.eye(30) + s**2 * root @ root.T).logpdf(y)
        - multivariate_normal(np.zeros(30), np.eye(30)).logpdf(y)
        for s in STRENGTHS
    ]
    value, strength = dense_evidence(root.T @ root, root.T @ y)
    assert value == pytest.approx(logsumexp(ratios) - np.log(len(ratios)), rel=1e-6)
    assert strength == STRENGTHS[int(np.argmax(ratios))]


def test_probabilities_share_what_surrogates_cannot_tell():
    """Differences of a few per cent of a large evidence leave both sites possible; a small gap is told from none."""
    everywhere = {None: 1.0}
    close = shares_of({("ground1", None): 3000.0, ("sensor", None): 2990.0, ("interface", None): 900.0}, everywhere)
    assert 0.3 < close["sensor", None] < close["ground1", None] < 0.7
    assert sum(close.values()) == pytest.approx(1.0, abs=1e-9)
    assert close["interface", None] < 0.01
    assert sum(shares_of({("ground1", None): -3.0, ("sensor", None): -3.0}, everywhere).values()) < 0.1


def test_what_acts_in_one_case_only_must_explain_more_than_what_acts_in_all():
    """Equal evidence leaves the prior's odds, however large the gap is."""
    priors = {None: 0.9, "case I": 0.1}
    for gap in (10.0, 3000.0):
        equal = shares_of({("ground1", None): gap, ("sensor", "case I"): gap}, priors)
        assert equal["ground1", None] == pytest.approx(9.0 * equal["sensor", "case I"])
        more = shares_of({("ground1", None): gap, ("sensor", "case I"): 2.0 * gap}, priors)
        assert more["sensor", "case I"] > more["ground1", None]


def test_columns_on_a_part_of_the_trials_are_columns_that_are_nothing_elsewhere():
    """Projected piece by piece, as at once."""
    fit = calibrate_nominal(measured(4, configurations=(False,)))
    rng = np.random.default_rng(1)
    cases = [fit.problem.experiment.trials[i].case for b in fit.linear.blocks for i in b.group.trials]
    columns = [rng.standard_normal((b.r.shape[0], 5, b.r.shape[1])) for b in fit.linear.blocks]
    assert len(columns) == 1
    assert set(cases) == {"I", "IV"}
    pieces = project_parts(fit, columns, lambda i: fit.problem.experiment.trials[i].case)
    inside = np.array([case == "IV" for case in cases])[:, None, None]
    for found, given in ((pieces.on(), columns[0]), (pieces.on({"IV"}), columns[0] * inside)):
        expected = project(fit, [given])
        for name in ("gram", "product", "raw", "absorbed"):
            assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9, abs=1e-9)


def test_products_are_made_between_columns_of_a_kind_only():
    """Kinds of three, one and two columns, of which some are zero on a part of the trials."""
    fit = calibrate_nominal(measured(4, configurations=(False,)))
    block = fit.linear.blocks[0]
    columns = np.random.default_rng(2).standard_normal((block.r.shape[0], 6, block.r.shape[1]))
    columns[:, 1] = 0.0
    found = project_parts(fit, [columns], lambda _: None, lambda: ["a", "a", "a", "b", "c", "c"]).on()
    whole = project(fit, [columns])
    same = np.zeros((6, 6), dtype=np.bool_)
    for run in (slice(0, 3), slice(3, 4), slice(4, 6)):
        same[run, run] = True
    assert found.gram == pytest.approx(np.where(same, whole.gram, 0.0), rel=1e-9, abs=1e-9)
    assert found.product == pytest.approx(whole.product, rel=1e-9, abs=1e-9)


def test_a_sensor_that_lags_in_one_case_is_found_there_and_said_to_lag_in_that_case():
    made = measured(3, cases=(("I", 0, 0.1), ("II", 0, 0.06), ("IV", 1, 0.08)))

    def read(t):
        late = np.interp(t.times - 1e-3, t.times, t.y[-1])
        return replace(t, y=np.stack([t.y[0], late])) if t.coupled and t.case == "II" else t

    found = site_map(calibrate_nominal(replace(made, trials=tuple(read(t) for t in made.trials))))
    assert found.best == "sensor"
    assert found.only == "case II"
    assert found.to_json()["only"]["sensor"] == "case II"


def test_a_sharp_friction_does_not_ring_from_sample_to_sample():
    """A change of the start is damped by a stiff friction at rest within a step, not turned over by it."""
    stiff = np.array([[[[0.0, 0.0], [0.0, 0.0]]]])
    damped = np.array([[[[-40.0, 0.0], [0.0, -0.2]]]])
    step, push = _steps(stiff, damped, np.eye(2)[None], np.array([[1.0]]))
    assert abs(step[0, 0, 2, 2]) < 0.05
    assert step[0, 0, 3, 3] == pytest.approx(np.exp(-0.2), rel=1e-4)
    assert push[0, 0, 3, 1] == pytest.approx((1.0 - np.exp(-0.2)) / 0.2, rel=1e-4)


def test_a_missing_torque_ends_where_the_record_ends():
    """Repeats share a grid of times; of a shorter one nothing is known behind its last reading."""
    whole = measured(4, **CUBIC)
    y = whole.trials[-3].y.copy()
    y[:, 300:] = np.nan
    short = replace(whole, trials=(*whole.trials[:-3], replace(whole.trials[-3], y=y), *whole.trials[-2:]))
    found = site_map(calibrate_nominal(short))
    ends = {m.trial: m.times.size for m in found.torque}
    assert ends[len(whole.trials) - 3] == 300
    assert set(ends.values()) == {300, 500}
    assert all(m.torque.shape == (2, m.times.size) and m.sd.shape == m.torque.shape for m in found.torque)


def test_scatter_in_proportion_is_no_sign_of_a_term_of_the_same_form():
    """Viscosity that scatters by twice what is said: a larger one beside a negative constant part would scatter less.

    On the columns of a viscous torque at the spring or the bearings that came to 17 nats.
    """
    fit = calibrate_nominal(laboratory(5, {"c1t": 0.3}, repeats=12, noise=3.0))
    sizes = fit.problem.switches.scatter.sizes
    said = Scatter(tuple(replace(s, sd=0.5 * s.sd) if s.name == "c1t" else s for s in sizes))
    problem = fit.problem.changed(switches=replace(fit.problem.switches, scatter=said))
    evidence = site_map(calibrate(problem, [fit.q], eta=carried(fit, problem), anneal=False), torque=False).log_evidence
    assert max(evidence.values()) < 0.0


def test_a_secondary_without_a_bearing_of_its_own_is_no_gap(monkeypatch):
    """The prior of c3t, held to a factor of 2.7, pulled it away from zero: two nats at the bearings and the spring."""
    monkeypatch.setitem(RIG, "c3t", 1e-9)
    fit = calibrate_nominal(measured(5, configurations=(True,), noise=0.5))
    assert site_map(fit, torque=False).strength < 0.0
    assert fit.parameters["c3t"][0] < 5e-5
