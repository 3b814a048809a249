"""What cases share: evidence, scatter, recycled draws and the decomposition against cases of known truth."""

import json
import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from campaigns import CAMPAIGN_TOML, write_table
from scipy.stats import genpareto
from test_entry import _campaign

from bayes_damper import figures
from bayes_damper.campaign import load_campaign
from bayes_damper.commands.resume import resume
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import ExitCode, InputError, Interrupted
from bayes_damper.fit import fit as fit_campaign
from bayes_damper.fit import published_posterior
from bayes_damper.priors.distributions import from_standard, to_standard
from bayes_damper.published.posterior import Coordinates, FeaturePosterior
from bayes_damper.runs.execution import WAITING
from bayes_damper.runs.json_files import read_json, write_json
from bayes_damper.sampling import arviz_adapter
from bayes_damper.sampling.guide import Guide
from bayes_damper.sampling.sequential import Block, Powers, _groups, temper
from bayes_damper.simulation.model import Model
from bayes_damper.variability import answer, variability
from bayes_damper.variability.decomposition import CaseDraws, Sets, decompose
from bayes_damper.variability.equivalent import TIMES, bearing_damping, equivalent, fit_linear, linear_record
from bayes_damper.variability.pooling import (
    POOLINGS,
    CaseLikelihood,
    GaussianCase,
    GaussianHierarchy,
    Hierarchy,
    recycle,
    step_along,
)
from bayes_damper.variability.published import PublishedCases, run_pooling
from bayes_damper.variability.recorded import RecordedCases

NAMES = ("a", "b", "c", "J", "own")
POOLED, COMMON = NAMES[:3], ("J",)
FIXED = {"shared": np.zeros(3), "separate": np.ones(3)}


def linear_cases(rng, kind, *, cases=4, sharpness=3.0, readings=8):
    """Cases with a linear-Gaussian likelihood of known pooling: "shared", "separate" or "half" (a alone differs)."""
    base, constant = rng.standard_normal(3), rng.standard_normal()
    gaussians, likelihoods, draws = [], [], {}
    for i in range(cases):
        own = {"shared": base, "separate": rng.standard_normal(3), "half": np.array([rng.standard_normal(), *base[1:]])}
        truth = np.concatenate([own[kind], [constant, rng.standard_normal()]])
        a = sharpness * rng.standard_normal((readings, 5))
        y = a @ truth + rng.standard_normal(readings)
        covariance = np.linalg.inv(a.T @ a + np.eye(5))
        mean = covariance @ a.T @ y
        total = np.eye(readings) + a @ a.T
        log_z = -0.5 * (readings * math.log(2 * math.pi) + np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y))
        gaussians.append(GaussianCase(str(i), NAMES, mean, covariance, log_z))
        likelihoods.append(
            CaseLikelihood(
                str(i),
                NAMES,
                Powers(
                    lambda x, a=a, y=y: -0.5 * np.sum((x @ a.T - y) ** 2, axis=1) - 0.5 * len(y) * math.log(2 * math.pi)
                ),
            )
        )
        draws[str(i)] = rng.multivariate_normal(mean, covariance, 1500)[:, :3]
    return gaussians, likelihoods, draws


def test_closed_form_agrees_with_the_whole_gaussian_integral():
    """The evidence of data y = A x + noise under the joint prior, written down as one Gaussian density of all data."""
    rng = np.random.default_rng(3)
    s = np.array([0.3, 0.0, 1.0])
    rows, ys, gaussians = [], [], []
    for i in range(3):
        a = rng.standard_normal((4, 4))
        y = rng.standard_normal(4)
        covariance = np.linalg.inv(a.T @ a + np.eye(4))
        total = np.eye(4) + a @ a.T
        log_z = -0.5 * (4 * math.log(2 * math.pi) + np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y))
        gaussians.append(GaussianCase(str(i), NAMES[:4], covariance @ a.T @ y, covariance, log_z))
        full = np.zeros((4, 10))
        full[:, 3 * i : 3 * i + 3], full[:, 9] = a[:, :3], a[:, 3]
        rows.append(full)
        ys.append(y)
    prior = np.eye(10)
    for j in range(3):
        index = np.arange(3) * 3 + j
        prior[np.ix_(index, index)] = (1 - s[j] ** 2) + s[j] ** 2 * np.eye(3)
    design, y = np.concatenate(rows), np.concatenate(ys)
    total = np.eye(12) + design @ prior @ design.T
    exact = -0.5 * (12 * math.log(2 * math.pi) + np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y))
    found = GaussianHierarchy(gaussians, POOLED, COMMON)
    assert found.given(s).log_z == pytest.approx(exact, abs=1e-9)
    assert found.log_evidence(np.stack([s, s])) == pytest.approx([exact] * 2, abs=1e-9)
    mean = prior @ design.T @ np.linalg.solve(total, y)
    assert found.given(s).mean.ravel() == pytest.approx(mean[:9], abs=1e-9)


@pytest.mark.parametrize("kind", ["shared", "separate"])
@pytest.mark.parametrize("common", [COMMON, pytest.param((), marks=pytest.mark.slow)])
def test_tempering_agrees_with_the_closed_form(kind, common):
    rng = np.random.default_rng(1)
    gaussians, likelihoods, _ = linear_cases(rng, kind, sharpness=1.5)
    exact = GaussianHierarchy(gaussians, POOLED, common)
    for pooling in POOLINGS:
        hierarchy = Hierarchy(likelihoods, pooling, POOLED, common)
        found = temper(hierarchy, rng, 384)
        if pooling == "partial":
            log_z, error, s = exact.partial(rng, 512)
            assert found.log_z == pytest.approx(log_z, abs=5 * (found.error + error))
            assert hierarchy.scatter(found.points).mean(axis=0) == pytest.approx(s.mean(axis=0), abs=0.12)
        else:
            given = exact.given(FIXED[pooling])
            assert found.log_z == pytest.approx(given.log_z, abs=5 * found.error)
            mean = np.array([hierarchy.values(found.points, i).mean(axis=0) for i in range(4)])
            sd = np.sqrt(np.diag(given.covariance)[:12]).reshape(4, 3)
            assert np.all(np.abs(mean - given.mean) < 0.6 * sd + 0.02)


class Bent:
    """A shear of what is pooled, and a sheet of what is a case's own: straight coordinates of another volume."""

    def __init__(self, width=0.3):
        self.width = width

    def at(self, power):
        return Bent(0.3 / max(power, 0.1))

    def sampled(self, z):
        points = z.copy()
        points[:, 1] += z[:, 0] ** 2
        points[:, 4] = np.arcsinh((z[:, 4] - z[:, 0] * z[:, 3]) / self.width)
        return points

    def standard(self, points):
        z = points.copy()
        z[:, 1] -= points[:, 0] ** 2
        z[:, 4] = points[:, 0] * points[:, 3] + self.width * np.sinh(points[:, 4])
        return z

    def log_volume(self, points):
        return np.logaddexp(points[:, 4], -points[:, 4])


@pytest.mark.parametrize("pooling", POOLINGS)
def test_straight_coordinates_leave_the_posterior_as_it_is(pooling):
    """A change of coordinates changes how steps are taken, not where the particles end."""
    rng = np.random.default_rng(5)
    gaussians, likelihoods, _ = linear_cases(rng, "half", cases=3, sharpness=1.0)
    bent = [replace(c, straightener=Bent()) for c in likelihoods]
    exact = GaussianHierarchy(gaussians, POOLED, COMMON)
    found = temper(Hierarchy(bent, pooling, POOLED, COMMON), rng, 256, kept=8)
    if pooling == "partial":
        plain = temper(Hierarchy(likelihoods, pooling, POOLED, COMMON), rng, 256, kept=8)
        assert found.log_z == pytest.approx(plain.log_z, abs=5 * (found.error + plain.error))
        assert found.points.mean(axis=0) == pytest.approx(plain.points.mean(axis=0), abs=0.35)
        assert found.points.std(axis=0) == pytest.approx(plain.points.std(axis=0), rel=0.3)
    else:
        given = exact.given(FIXED[pooling])
        hierarchy = Hierarchy(likelihoods, pooling, POOLED, COMMON)
        assert found.log_z == pytest.approx(given.log_z, abs=5 * found.error)
        for case in range(3):
            z = hierarchy.values(found.points, case)
            assert z.mean(axis=0) == pytest.approx(given.mean[case], abs=0.25)


def test_straight_coordinates_lead_back():
    rng = np.random.default_rng(6)
    _, likelihoods, _ = linear_cases(rng, "half", cases=3, sharpness=1.0)
    bent = [replace(c, straightener=Bent()) for c in likelihoods]
    for pooling in POOLINGS:
        hierarchy = Hierarchy(bent, pooling, POOLED, COMMON)
        points = rng.standard_normal((20, hierarchy.ndim))
        for view in range(len(hierarchy._views)):
            steps = hierarchy.straight(points, view)
            assert hierarchy.bent(points, view, steps) == pytest.approx(points, abs=1e-9)
            other = hierarchy.bent(points, view, steps + 0.1)
            assert hierarchy.straight(other, view) == pytest.approx(steps + 0.1, abs=1e-9)


def test_refresh_keeps_the_values_of_the_cases():
    rng = np.random.default_rng(2)
    _, likelihoods, _ = linear_cases(rng, "half")
    hierarchy = Hierarchy(likelihoods, "partial", POOLED, COMMON)
    points = rng.standard_normal((64, hierarchy.ndim))
    moved = hierarchy.refresh(points, rng)
    assert not np.allclose(hierarchy.scatter(points), hierarchy.scatter(moved))
    for case in range(4):
        assert hierarchy.values(moved, case) == pytest.approx(hierarchy.values(points, case), abs=1e-9)


def test_refresh_of_the_prior_gives_the_prior():
    """Without data, m, s and e stay unit Gaussians (s uniform) under any number of refreshes."""
    rng = np.random.default_rng(4)
    _, likelihoods, _ = linear_cases(rng, "half")
    hierarchy = Hierarchy(likelihoods, "partial", POOLED, COMMON)
    points = rng.standard_normal((4000, hierarchy.ndim))
    for _ in range(5):
        points = hierarchy.refresh(points, rng)
    assert np.abs(points.mean(axis=0)).max() < 0.08
    assert points.std(axis=0) == pytest.approx(np.ones(hierarchy.ndim), abs=0.06)


def test_guided_steps_keep_a_bent_ridge():
    """Steps in x given y, learnt from other places of a banana, leave its conditional moments as they are."""
    rng = np.random.default_rng(14)

    def places(n):
        y, x = rng.standard_normal(n), rng.standard_normal(n)
        return np.stack([x, x**2 + 0.5 * y + 0.1 * rng.standard_normal(n), y], axis=1)

    def log_density(p):
        return -0.5 * (p[:, 0] ** 2 + ((p[:, 1] - p[:, 0] ** 2 - 0.5 * p[:, 2]) / 0.1) ** 2)

    guide, points = Guide(places(4000), 2), places(4000)
    begin, accepted = points.copy(), []
    for i in range(40):
        there, correction = (guide.step if i % 2 else guide.draw)(points[:, :2], points[:, 2:], rng)
        new = np.concatenate([there, points[:, 2:]], axis=1)
        taken = np.log(rng.random(len(points))) < log_density(new) - log_density(points) + correction
        points = np.where(taken[:, None], new, points)
        accepted.append(taken.mean())
    assert np.mean(accepted) > 0.25
    assert abs(np.corrcoef(begin[:, 0], points[:, 0])[0, 1]) < 0.2
    assert points[:, 0].mean() == pytest.approx(0.0, abs=0.07)
    assert points[:, 0].std() == pytest.approx(1.0, abs=0.06)
    left = points[:, 1] - points[:, 0] ** 2 - 0.5 * points[:, 2]
    assert left.mean() == pytest.approx(0.0, abs=0.01)
    assert left.std() == pytest.approx(0.1, rel=0.06)


@pytest.mark.prove
def test_repeats_of_a_sharp_hierarchy_agree_within_their_error():
    """Four sharp readings of five unknowns a case, so that the posterior is thin: the rule for repeats is kept."""
    rng = np.random.default_rng(21)
    _, likelihoods, _ = linear_cases(rng, "half", sharpness=20.0, readings=4)
    hierarchy = Hierarchy(likelihoods, "partial", POOLED, COMMON)
    found = [temper(hierarchy, np.random.default_rng(k), 96, kept=16) for k in range(2)]
    unknowns = [hierarchy.unknowns(f.points) for f in found]
    assert unknowns[0].shape == (96 * 16, 4 * 3 + 2 * 3 + 1) == (len(found[0].log_likelihood), len(hierarchy.labels))
    means = np.array([x.mean(axis=0) for x in unknowns])
    apart = np.abs(means[0] - means[1]) / np.sqrt(np.mean([x.var(axis=0) for x in unknowns], axis=0))
    assert np.sqrt(np.mean(apart**2)) < answer._APART
    assert abs(found[0].log_z - found[1].log_z) < 5.0 * (found[0].error + found[1].error)


def test_evidence_alone_needs_no_settling():
    _, likelihoods, _ = linear_cases(np.random.default_rng(21), "half")
    hierarchy = Hierarchy(likelihoods, "partial", POOLED, COMMON)
    whole, alone = (temper(hierarchy, np.random.default_rng(0), 32, settle=settle) for settle in (True, False))
    assert alone.log_z == whole.log_z
    assert alone.stages == whole.stages - 1


def test_coordinates_are_straight_for_the_power_of_the_stage_alone():
    """Not for those of all stages before it, one upon the other."""
    powers = []

    class Thick(Bent):
        def at(self, power):
            powers.append((self.width, power))
            return Thick(0.3 / power)

    _, likelihoods, _ = linear_cases(np.random.default_rng(25), "half", cases=2, sharpness=1.0)
    bent = [replace(c, straightener=Thick()) for c in likelihoods]
    temper(Hierarchy(bent, "shared", POOLED, COMMON), np.random.default_rng(0), 64)
    assert len({power for _, power in powers}) > 2
    assert {width for width, _ in powers} == {0.3}


@pytest.mark.slow
def test_recycled_draws_agree_with_direct_sampling():
    rng = np.random.default_rng(7)
    _, likelihoods, draws = linear_cases(rng, "separate", sharpness=1.5)
    hierarchy = Hierarchy(likelihoods, "partial", POOLED)
    direct = temper(hierarchy, rng, 384)
    alone = sum(temper(Hierarchy([c], "separate", POOLED), rng, 384).log_z for c in likelihoods)
    recycled = recycle(draws, rng, 192)
    assert recycled.reliable
    assert min(recycled.ess.values()) > 100
    assert recycled.log_z == pytest.approx(direct.log_z - alone, abs=1.2)
    scatter = hierarchy.scatter(direct.points)
    assert recycled.scatter.mean(axis=0) == pytest.approx(scatter.mean(axis=0), abs=0.12)
    assert recycled.mean.mean(axis=0) == pytest.approx(hierarchy.means(direct.points).mean(axis=0), abs=0.3)
    for i, case in enumerate(draws):
        z = hierarchy.values(direct.points, i)
        assert recycled.values[case].mean(axis=0) == pytest.approx(z.mean(axis=0), abs=0.35 * z.std(axis=0).max())


def test_more_draws_are_taken_where_few_cannot_be_trusted():
    rng = np.random.default_rng(7)
    _, _, draws = linear_cases(rng, "separate", sharpness=1.5)
    few = recycle(draws, np.random.default_rng(1), 96, levels=(60,))
    assert not few.reliable
    found = recycle(draws, np.random.default_rng(1), 96, levels=(60, 1500, 9999))
    assert found.reliable
    assert found.used == 1500
    assert min(found.ess.values()) > 10.0 * min(few.ess.values())


def test_a_place_that_a_chain_does_not_leave_is_one_draw():
    rng = np.random.default_rng(9)
    draws = {str(i): 0.7 * rng.standard_normal((200, 2)) for i in range(3)}
    once = recycle(draws, np.random.default_rng(1), 64)
    often = recycle({name: np.repeat(z, 5, axis=0) for name, z in draws.items()}, np.random.default_rng(1), 64)
    assert often.ess_of_one == pytest.approx(once.ess_of_one, rel=1e-9)
    assert often.log_z == pytest.approx(once.log_z, abs=1e-9)


def test_weights_that_rest_on_few_draws_are_called_unreliable():
    """Sharp and nearly equal cases want a population far narrower than the draws are dense."""
    rng = np.random.default_rng(8)
    draws = {str(i): rng.standard_normal((60, 5)) * 0.9 for i in range(6)}
    draws["far"] = rng.standard_normal((60, 5)) * 0.05 + 3.0
    found = recycle(draws, rng, 96)
    assert not found.reliable


@pytest.mark.parametrize("k", [0.2, 0.6, 1.1])
def test_pareto_k_finds_the_shape_of_a_known_tail(k):
    rng = np.random.default_rng(int(10 * k))
    found = [arviz_adapter.pareto_k(genpareto.rvs(k, size=4000, random_state=rng)) for _ in range(8)]
    assert np.mean(found) == pytest.approx(k, abs=0.12)


def test_equal_weights_have_no_tail():
    assert arviz_adapter.pareto_k(np.ones(100)) == -math.inf


@pytest.mark.parametrize("kind", ["shared", "separate", "half"])
def test_known_pooling_is_found_at_the_right_rate(kind):
    """Over seeds: the right answer has the highest evidence, and the scatter tells which parameter differs."""
    right = told = 0
    for seed in range(16):
        rng = np.random.default_rng([seed, 11])
        gaussians, _, _ = linear_cases(rng, kind, sharpness=6.0)
        exact = GaussianHierarchy(gaussians, POOLED, COMMON)
        log_z, _, s = exact.partial(rng, 96)
        height = {name: exact.given(fixed).log_z for name, fixed in FIXED.items()} | {"partial": log_z}
        best = max(height, key=lambda name: height[name])
        right += best == ("partial" if kind == "half" else kind)
        small = np.median(s, axis=0)
        told += {"shared": small.max() < 0.3, "separate": np.mean(small) > 0.4, "half": small[0] > small[1:].max()}[
            kind
        ]
    # A draw of four values is by chance sometimes so narrow that a common mean is the better answer.
    assert right >= {"shared": 15, "separate": 9, "half": 13}[kind]
    assert told >= 14


@pytest.mark.parametrize(
    ("campaigns", "least", "most"),  # beyond by chance in fewer than one of 100 runs, three s a campaign
    [(10, 0.55, 0.97), pytest.param(30, 0.65, 0.93, marks=pytest.mark.prove)],
)
def test_intervals_of_the_scatter_cover_the_truth(campaigns, least, most):
    """Truth drawn from the prior of the partly pooled model: 80 % intervals of s hold it about as often as they say."""
    inside = []
    for seed in range(campaigns):
        rng = np.random.default_rng([seed, 17])
        s = rng.random(3)
        m, gaussians = rng.standard_normal(3), []
        for i in range(4):
            truth = np.append(np.sqrt(1 - s**2) * m + s * rng.standard_normal(3), rng.standard_normal(2))
            a = 4.0 * rng.standard_normal((10, 5))
            covariance = np.linalg.inv(a.T @ a + np.eye(5))
            y = a @ truth + rng.standard_normal(10)
            gaussians.append(GaussianCase(str(i), NAMES, covariance @ a.T @ y, covariance, 0.0))
        _, _, draws = GaussianHierarchy(gaussians, POOLED).partial(rng, 192)
        low, high = np.quantile(draws, [0.1, 0.9], axis=0)
        inside += list((s > low) & (s < high))
    assert least < np.mean(inside) < most


# The effective linear rig

RIG = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "k1t": 10.2}
TRUTH = {"mu": 0.009, "k2t": 1.5, "c2t": 0.04, "drag": 0.004, "nu": 80.0, "c1t": 0.008, "c3t": 0.007}


def rigs(n, **changes):
    values = {name: np.full(n, x) for name, x in (RIG | TRUTH | {"theta0": math.radians(4.7)}).items()}
    return values | {name: np.broadcast_to(np.asarray(x, float), (n,)).copy() for name, x in changes.items()}


def test_a_linear_rig_is_its_own_equivalent():
    k2t, c2t = np.array([0.4, 1.0, 3.0, 8.0]), np.array([0.03, 0.08, 0.12, 0.3])
    values = rigs(4, mu=0.0, drag=0.0, c3t=0.008, k2t=k2t, c2t=c2t)
    found = equivalent(values)
    assert np.exp(found.log_values) == pytest.approx(np.stack([k2t, c2t], axis=1), rel=0.02)
    assert found.misfit.max() < 0.005
    exact = values | {"k3t": np.zeros(4), "J12": np.zeros(4)}
    record = linear_record(exact, np.log(np.stack([k2t, c2t], axis=1)), TIMES, "acceleration")
    direct = fit_linear(record, values, values["c1t"], "acceleration")
    assert np.exp(direct.log_values) == pytest.approx(np.stack([k2t, c2t], axis=1), rel=1e-3)


def test_the_legend_hides_no_case():
    """Of the effective values: it stands above the axes, and is the title at once."""
    cases = {"I": rigs(8), "II": rigs(8, c2t=0.06, theta0=math.radians(7.0))}
    found = decompose(sets_of(cases, list(cases.values())))
    figure = figures.variability_figure(found.effective, found.parts, kind="translational", title="effective values")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "effective values"
    assert all(legend.get_window_extent().y0 >= axes.get_window_extent().y1 for axes in figure.axes[:2])
    assert [axes.get_ylabel() for axes in figure.axes[:2]] == ["effective k2t [N/m]", "effective c2t [N s/m]"]


def test_the_linear_fit_keeps_to_the_pace_of_the_rig():
    """A rig a hundred times as slow has the same equivalent in its own units of time: drag shows in its decrement."""
    fast = rigs(2, drag=[0.002, 0.004])
    powers = {"J1": 2, "J2": 2, "c1t": 1, "c3t": 1, "c2t": 1, "nu": 1}
    slow = {name: x * 100.0 ** powers.get(name, 0) for name, x in fast.items()}
    found, expected = equivalent(slow, stretch=100.0), equivalent(fast)
    assert found.log_values[:, 0] == pytest.approx(expected.log_values[:, 0], abs=1e-3)
    assert found.log_values[:, 1] == pytest.approx(expected.log_values[:, 1] + math.log(100.0), abs=1e-3)
    assert bearing_damping(slow, stretch=100.0) == pytest.approx(100.0 * bearing_damping(fast), rel=1e-3)


def test_friction_looks_like_damping_that_falls_with_amplitude():
    """Dry friction gives a viscous equivalent in proportion to 1 / amplitude: what the thesis saw (p. 22)."""
    found = equivalent(rigs(3, theta0=np.radians([3.0, 5.0, 9.0])))
    damping = np.exp(found.log_values[:, 1])
    assert damping[0] > damping[1] > damping[2] > TRUTH["c2t"]


def test_bearing_damping_grows_with_drag():
    found = bearing_damping(rigs(3, drag=[0.0, 0.004, 0.01]))
    assert found[0] == pytest.approx(0.008, rel=0.03)  # the first peak is read 0.6 ms late
    assert found[0] < found[1] < found[2]


def sets_of(cases, references):
    draws = {
        name: CaseDraws(v, w, v, w) for (name, v), w in zip(cases.items(), references, strict=True)
    }  # fmt: skip
    return Sets(
        draws,
        {name: float(0.5 * v["k1t"][0] * v["theta0"][0] ** 2) for name, v in cases.items()},
        {},
        (0.0, 0.0),
        {name: lambda x: np.full(x.shape, 1e-4) for name in cases},
        {},
    )


def test_decomposition_of_one_rig_at_several_amplitudes_is_all_friction():
    cases = {str(i): rigs(8, theta0=math.radians(a)) for i, a in enumerate((3.0, 5.0, 9.0))}
    parts = decompose(sets_of(cases, list(cases.values()))).parts["c2t"]
    assert parts["real_difference"]["median"] == pytest.approx(0.0, abs=1e-12)
    assert parts["friction_at_another_amplitude"]["share"]["median"] > 0.95
    assert parts["probability_largest"]["friction_at_another_amplitude"] == 1.0


def test_decomposition_of_different_rigs_at_one_amplitude_is_all_difference():
    cases = {str(i): rigs(8, c2t=c) for i, c in enumerate((0.03, 0.06, 0.12))}
    parts = decompose(sets_of(cases, [rigs(8, c2t=0.06)] * 3)).parts["c2t"]
    assert parts["friction_at_another_amplitude"]["median"] == pytest.approx(0.0, abs=1e-12)
    assert parts["real_difference"]["share"]["median"] > 0.95
    total = parts["expected_total"]["median"]
    pieces = ("friction_at_another_amplitude", "measurement_scatter", "real_difference", "covariance")
    assert total == pytest.approx(sum(parts[key]["median"] for key in pieces), rel=1e-6)


# Recorded campaigns

CASES = (("I", 6.2, 5.7), ("II", 6.2, 7.2), ("IV", 10.2, 4.7))


def write_campaign(folder, kind, seed=1, repeats=2):
    """A campaign of the nonlinear model with known pooling; returns the parameters of each case."""
    rng = np.random.default_rng(seed)
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(CAMPAIGN_TOML, encoding="utf-8")
    differing = {"shared": (), "half": ("mu", "c2t"), "separate": tuple(TRUTH)}[kind]
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial"]
    times = np.arange(501) * 1e-3
    truths = {}
    for case, k1t, degrees in CASES:
        factor = {name: math.exp(0.4 * rng.standard_normal()) for name in TRUTH}
        truths[case] = {name: x * (factor[name] if name in differing else 1.0) for name, x in TRUTH.items()}
        for coupled in (False, True):
            for trial in range(1, repeats + 1):
                theta0 = math.radians(degrees) * (1.0 + 0.005 * rng.standard_normal())
                values = RIG | truths[case] | {"k1t": k1t, "theta0": theta0}
                y = Model(coupled).simulate(values, times).y[0]
                y = y + 2.0 * rng.standard_normal(y.shape)
                name = f"trials/{case}_{int(coupled)}_{trial}.csv"
                write_table(folder / name, ["time_s", "alpha1_rad_s2", "alpha2_rad_s2"][: 1 + len(y)], [times, *y])
                word = "coupled" if coupled else "uncoupled"
                rows.append(f"{name},{case},{word},{k1t},{degrees},{0.005 * degrees},{trial}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return truths


def plan_of(folder):
    campaign = load_campaign(folder)
    return {
        "campaign": str(folder), "name": campaign.name, "campaign_sha256": campaign.sha256,
        "cases": [case for case, _, _ in CASES], "priors": None, "normal_force": None, "effect": None, "seed": 1,
    }  # fmt: skip


def write_fit(folder, cases, converged=True):
    """A folder like that of a fit, with draws of each case's Laplace approximation."""
    rng = np.random.default_rng(9)
    folder.mkdir()
    write_json(folder / "run.json", {"command": "fit", "plan": cases.plan, "workers": 1})
    summary = {"schema": "bayes-damper/fit/1", "converged": converged, "cases": {}, "warnings": ["trials/2.csv: a gap"]}
    write_json(folder / "summary.json", summary)
    for case, fit in cases.fits.items():
        q = rng.multivariate_normal(fit.q, fit.covariance, 2 * 50 * 8)
        draws = {
            c.name: from_standard(c.prior, q[:, i]).reshape(2, 50, 8) for i, c in enumerate(fit.problem.coordinates)
        }  # fmt: skip
        (folder / case).mkdir()
        tree = arviz_adapter.results(draws, log_prob=np.zeros((2, 50, 8)))
        arviz_adapter.write(tree, folder / case / "posterior.nc")


@pytest.mark.slow
def test_half_shared_campaign_end_to_end(tmp_path, monkeypatch):
    # With fewer repeats the prior of the scatter lets each trial have a friction of its own.
    truths = write_campaign(tmp_path / "campaign", "half", repeats=4)
    cases = RecordedCases(plan_of(tmp_path / "campaign"))
    write_fit(tmp_path / "fit", cases)

    def fitted_already(plan, report):
        assert {name: plan[name] for name in cases.plan} == cases.plan
        cases.report = report
        return cases

    monkeypatch.setattr(answer, "RecordedCases", fitted_already)
    told = mock.Mock()
    found = variability(tmp_path / "fit", particles=64, draws=24, seed=3, progress=told)
    shares = [call.args[1] for call in told.update.call_args_list]
    assert shares == sorted(shares)
    assert len(shares) >= 6
    assert found.exit_code is ExitCode.DONE
    result = json.loads((tmp_path / "fit" / "variability.json").read_text())
    assert result["schema"] == "bayes-damper/variability/1"
    models = result["models"]
    assert models["partial"]["probability"] > 0.95
    # Where its friction is that of other cases, a held-out trial takes what it can by values of its own.
    assert models["shared"]["heldout"]["log_score"] < models["partial"]["heldout"]["log_score"] - 5.0
    assert models["partial"]["heldout"]["log_score"] > models["separate"]["heldout"]["log_score"] - 10.0
    scatter = {name: row["median"] for name, row in models["partial"]["scatter"].items()}
    assert min(scatter["mu"], scatter["c2t"]) > max(scatter["k2t"], scatter["c1t"], scatter["drag"])
    for case, truth in truths.items():
        low, high = models["partial"]["cases"][case]["mu"]["hdi90"]
        assert 0.8 * low < truth["mu"] < 1.2 * high
        row = result["effective"]["cases"][case]
        assert row["c2t"]["median"] == pytest.approx(row["measured"]["c2t"], rel=0.1)
    parts = result["decomposition"]["c2t"]
    assert parts["expected_total"]["median"] == pytest.approx(parts["measured"], rel=0.3)
    two_ways = result["recycled"]["parameters"]["c2t"]["cases"]
    assert set(two_ways) == set(truths)
    for row in two_ways.values():
        low, high = row["direct"]["hdi90"]
        assert abs(row["recycled"]["median"] - row["direct"]["median"]) < high - low
    assert (tmp_path / "fit" / "variability_effective.svg").exists()
    assert result["warnings"] == ["trials/2.csv: a gap"]
    assert found.text().startswith("warning: trials/2.csv: a gap\n")
    assert "one parameter set for all cases" in found.text()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["shared", pytest.param("separate", marks=pytest.mark.prove)])
def test_known_pooling_of_campaigns_is_found(tmp_path, kind):
    """One campaign each, one that is half shared above; the proof below counts sixty."""
    write_campaign(tmp_path / "campaign", kind)
    models, *_ = RecordedCases(plan_of(tmp_path / "campaign")).models(np.random.default_rng(1), 96, 24)
    best = max(models, key=lambda name: models[name]["log_evidence"])
    assert best in {"shared": ("shared",), "separate": ("separate", "partial")}[kind]
    scatter = {name: row["median"] for name, row in models["partial"]["scatter"].items()}
    if kind == "shared":
        assert max(scatter[name] for name in ("mu", "k2t", "c2t", "c1t", "drag")) < 0.15


RATE_SEEDS = range(20)


@pytest.mark.prove
def test_known_pooling_of_campaigns_is_found_at_the_right_rate(tmp_path):
    """Simulated campaigns of three cases whose parameters are all shared, differ in two, or differ in all.

    docs/proof/variability.md holds the counts of these very campaigns.
    """
    kinds, told = ("shared", "half", "separate"), {}
    apart: list[tuple[bool, float]] = []
    for kind in kinds:
        heads = dict.fromkeys(POOLINGS, 0)
        for seed in RATE_SEEDS:
            folder = tmp_path / f"{kind}{seed}"
            write_campaign(folder, kind, seed=100 + seed)
            models, *_ = RecordedCases(plan_of(folder)).models(np.random.default_rng(seed), 128, 24)
            heads[max(models, key=lambda name: models[name]["log_evidence"])] += 1
            if kind == "half":
                rows = models["partial"]["scatter"]
                apart += [(name in ("mu", "c2t"), rows[name]["median"]) for name in ("mu", "c2t", "k2t", "c1t", "c3t")]
        told[kind] = heads
    differing = [s for differs, s in apart if differs]
    same = [s for differs, s in apart if not differs]
    above = float(np.mean([a > b for a in differing for b in same]))
    print(json.dumps(told), f"{above:.3f}")
    n = len(RATE_SEEDS)
    assert told["shared"]["shared"] >= 0.9 * n
    assert told["half"]["partial"] >= 0.8 * n
    assert told["separate"]["partial"] + told["separate"]["separate"] >= 0.95 * n
    assert above > 0.95


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_case_is_as_uncertain_as_in_its_fit_where_the_model_misses_something(tmp_path):
    """The spring hardens, the model does not know: a case is known no better here than by the draws of its own fit."""
    spring = EFFECTS["spring_cubic"].variants[0]
    folder = _campaign(tmp_path / "campaign", effect=spring, values={"k3": 40.0}, seed=2)  # of seed 1 nu has two modes
    rows = (folder / "trials.csv").read_text(encoding="utf-8").splitlines()
    marked = [rows[0] + ",holdout", rows[1] + ",true", *(row + "," for row in rows[2:])]  # the same trials in both
    (folder / "trials.csv").write_text("\n".join(marked) + "\n", encoding="utf-8")
    found = fit_campaign(folder, out=tmp_path / "fit", most_steps=100)
    assert found.summary["cases"]["IV"]["noise"]["channels"][0]["learnt_from"] == "residuals"
    plan = read_json(tmp_path / "fit" / "run.json")["plan"]
    cases = RecordedCases(plan)
    names = cases.fits["IV"].problem.names
    known = np.sqrt(np.diag(cases.fits["IV"].covariance))[[names.index(name) for name in cases.pooled]]
    draws = answer._fit_draws(tmp_path / "fit", plan, cases, lambda _: cases.pooled)["IV"]
    # Half the central 68 %: that of nu has one long tail, of frictions too sharp for records whose releases take time.
    drawn = 0.5 * np.diff(np.quantile(draws, (0.1587, 0.8413), axis=0), axis=0)[0]
    ratio = dict(zip(cases.pooled, known / drawn, strict=True))
    assert all(0.6 < x < 1.7 for x in ratio.values()), ratio


@pytest.mark.slow
def test_the_fit_of_one_case_is_brought_to_the_common_prior(tmp_path):
    """Draws of a case under its own prior, drawn again, have the mean that the common prior gives."""
    write_campaign(tmp_path / "campaign", "shared")
    cases = RecordedCases(plan_of(tmp_path / "campaign"))
    case, j = "II", cases.pooled.index("drag")
    own, common = cases.fitted_priors[case]["drag"], cases.priors(case)["drag"]
    assert own.median_value != pytest.approx(common.median_value, rel=0.05)
    rng = np.random.default_rng(1)
    z = rng.standard_normal((20000, len(cases.pooled)))  # no data: the case's own prior
    columns = [
        to_standard(cases.priors(case)[n], from_standard(cases.fitted_priors[case][n], z[:, k]))
        for k, n in enumerate(cases.pooled)
    ]  # fmt: skip
    moved = cases.reweighted(case, np.stack(columns, axis=1), rng)
    assert abs(moved[:, j].mean()) < 0.1
    assert moved[:, j].std() == pytest.approx(1.0, abs=0.1)


def test_direct_sampling_of_gaussian_cases_has_the_moments_of_the_cases_and_a_common_mean():
    rng = np.random.default_rng(6)
    cases = [GaussianCase(str(i), ("a", "b"), np.array([x, 0.5]), 0.01 * np.eye(2), 0.0)
             for i, x in enumerate((-1.0, 0.0, 1.2))]  # fmt: skip
    found = GaussianHierarchy(cases, ("a", "b")).direct(rng, 256)
    assert np.median(found.scatter[:, 0]) > 0.4
    assert np.median(found.scatter[:, 1]) < 0.3
    for case in cases:
        assert found.values[case.name].mean(axis=0) == pytest.approx(case.mean, abs=0.06)
    middle = np.sqrt(1.0 - found.scatter**2) * found.mean
    assert middle[:, 1].mean() == pytest.approx(0.5, abs=0.1)
    assert middle[:, 0].mean() == pytest.approx(0.07, abs=0.3)
    assert middle[:, 0].std() > 3.0 * middle[:, 1].std() * 0.5


# The thesis


@pytest.fixture(scope="module")
def thesis():
    return PublishedCases(PublishedCases.default_plan())


def test_levels_of_the_priors_say_what_is_compared(thesis):
    assert thesis.pooled == ("k2t", "c2t", "c1t", "mu", "drag", "nu")
    assert set(thesis.common) == {"J1", "J2", "R", "r", "N0", "t_min"}
    assert thesis.hierarchy("shared").ndim == 6 + 6
    assert thesis.hierarchy("separate").ndim == 6 + 4 * 6
    assert thesis.hierarchy("partial").ndim == 2 * 6 + 6 + 4 * 6


def test_likelihood_of_a_case_is_that_of_its_six_numbers_with_spring_and_angle_integrated_out(thesis):
    """By draws of both from their priors, the spring's from a window about the measured period that it is known in."""
    hierarchy = thesis.hierarchy("shared")
    rng = np.random.default_rng(1)
    near = {"mu": 0.01, "k2t": 1.4, "c2t": 0.015, "drag": 0.04, "nu": 16.0, "c1t": 0.005}
    points = 0.1 * rng.standard_normal((3, hierarchy.ndim))
    points[:, :6] += [float(to_standard(thesis.priors("IV")[name], near[name])) for name in thesis.pooled]
    found = hierarchy.log_likelihood(points, np.arange(4))
    number = thesis.names.index("IV")
    own = published_posterior("IV", thesis.prior_set)
    plain = Coordinates(own.coordinates.free, own.coordinates.fixed, own.coordinates.tied)
    exact = FeaturePosterior(own.data, plain, case="IV")
    values = thesis.values(hierarchy, points, number)
    prior = thesis.features["IV"].own
    spring = next(d.value for d in own.data if d.name == "period (uncoupled)")
    u = np.linspace(-0.12, 0.06, 241)
    angles = np.linspace(-3.0, 3.0, 31)
    for i in range(len(points)):
        centre = values["J1"][i] * (2.0 * math.pi / spring) ** 2
        k1t, angle = (x.ravel() for x in np.meshgrid(centre * np.exp(u), from_standard(prior["theta0"], angles)))
        table = {n: np.full(k1t.size, x[i]) for n, x in values.items()} | {"k1t": k1t, "theta0": angle}
        heights = exact.log_likelihood(plain.points(table)).sum(axis=1).reshape(len(angles), len(u))
        weight = np.exp(-0.5 * angles**2) / math.sqrt(2.0 * math.pi) * (angles[1] - angles[0])
        density = np.exp(prior["k1t"].logpdf(k1t)) * k1t * (u[1] - u[0])
        total = np.sum(np.exp(heights) * weight[:, None] * density.reshape(heights.shape))
        assert found[i, number] == pytest.approx(math.log(total), abs=0.25)


def test_only_blocks_that_have_nothing_to_do_with_each_other_move_at_once():
    def groups(pooling, common):
        _, likelihoods, _ = linear_cases(np.random.default_rng(2), "half", cases=3)
        return _groups(Hierarchy(likelihoods, pooling, POOLED, common).blocks)

    assert groups("partial", COMMON) == [[0], [1], [2], [3, 4, 5]]
    assert groups("separate", COMMON) == [[0], [1, 2, 3]]
    assert groups("separate", ()) == [[0, 1, 2]]
    first, second = Block(np.arange(2), np.array([0])), Block(np.arange(2, 4), np.array([1]), given=np.array([1]))
    assert _groups([first, second]) == [[0], [1]]  # one hangs on the other
    assert _groups([first, replace(second, given=None, parts=np.array([0]))]) == [[0], [1]]  # one part bears on both


@pytest.mark.parametrize("pooling", POOLINGS)
def test_scalings_change_no_reading_and_keep_the_prior(pooling, thesis):
    """Friction as a product: the likelihood stays, the prior is kept."""
    hierarchy = thesis.hierarchy(pooling)
    assert len(hierarchy.scalings) == 2
    rng = np.random.default_rng(15)
    points = rng.standard_normal((24, hierarchy.ndim)) * 0.4
    moved = points
    for each in hierarchy.scalings:
        moved = step_along(hierarchy, moved, each, 0.05, range(4), rng)
    before, after = (hierarchy.log_likelihood(x, np.arange(4)) for x in (points, moved))
    assert after == pytest.approx(before, rel=1e-4, abs=1e-4)
    assert np.mean(np.any(moved != points, axis=1)) > 0.5
    points = rng.standard_normal((3000, hierarchy.ndim))
    moved = points
    for _ in range(4):
        moved = hierarchy.refresh(moved, rng)
    assert np.abs(moved.mean(axis=0)).max() < 0.1
    assert moved.std(axis=0) == pytest.approx(np.ones(hierarchy.ndim), abs=0.07)


class StopsIn:
    """Progress that is interrupted, as by Ctrl-C, when the task of this number begins to tell."""

    def __init__(self, number):
        self.number, self.seen = number, []

    def update(self, task, share, text):
        del share
        if task not in self.seen and text != WAITING:
            self.seen.append(task)
        if len(self.seen) == self.number:
            raise KeyboardInterrupt


@pytest.mark.prove  # takes longer than all other slow tests of this file together
def test_thesis_end_to_end_interrupted_and_resumed(tmp_path):
    """Stopped in its third piece, and gone on with by `resume`: as one run, with pieces that any order would give."""
    settings = {"particles": 32, "repeats": 1, "draws": 16, "unseen": False}
    with pytest.raises(Interrupted, match="bayes-damper resume"):
        variability("thesis", out=tmp_path / "a", progress=StopsIn(3), **settings)
    assert not (tmp_path / "a" / "variability.json").exists()
    first = resume(tmp_path / "a")
    assert first.folder == tmp_path / "a"
    assert first.result["seed"] == 1
    rows = first.result["effective"]["cases"]
    assert rows["IV"]["measured"] == {"k2t": 1.0, "c2t": 0.08}
    assert rows["II"]["energy_j"] == pytest.approx(49.2e-3, rel=0.02)
    assert sum(m["probability"] for m in first.result["models"].values()) == pytest.approx(1.0)
    work = tmp_path / "a" / "variability"
    plan = {k: v for k, v in read_json(work / "run.json")["plan"].items() if k in ("fit", "seed", "particles")}
    alone = run_pooling(tmp_path, lambda *_: None, settings=plan, pooling="shared", repeat=0)
    assert read_json(work / "shared-all-0" / "done.json")["log_z"] == alone["log_z"]
    assert first.result["models"]["shared"]["heldout"]["log_score"] is None
    again = variability("thesis", out=tmp_path / "a", **settings)
    assert again.result["models"] == first.result["models"]
    assert resume(work).result["models"] == first.result["models"]
    with pytest.raises(InputError, match="another run"):
        variability("thesis", out=tmp_path / "a", **(settings | {"particles": 48}))


class Apart:
    """Cases whose partly pooled runs differ until they have enough particles."""

    names = ("I", "II")

    def __init__(self, enough):
        self.enough = enough

    def apart(self, key, names, work):
        del work
        grown = [int(name.split("-")[2]) for name in names if name.count("-") == 3]
        return 0.9 if key == "partial-all" and max(grown, default=0) < self.enough else 0.1


@pytest.mark.parametrize(
    ("particles", "enough", "adapt", "last"),
    [(64, 256, True, "partial-all-256-1"), (64, 10**6, True, "partial-all-1024-1"), (256, 10**6, False, None)],
)
def test_runs_whose_repeats_differ_are_made_again_with_more_particles(
    monkeypatch, tmp_path, particles, enough, adapt, last
):
    made = {}

    def run_tasks(tasks, work, **_):
        del work
        made.update({task.name: task.arguments for task in tasks})
        return {task.name: {} for task in tasks}

    monkeypatch.setattr(answer, "run_tasks", run_tasks)
    settings = {"fit": {}, "seed": 1, "particles": particles, "repeats": 2}
    runs, chosen = answer._run_published(Apart(enough), settings, tmp_path, False, adapt, 1, None, None)
    assert set(runs) == set(made)
    assert chosen["shared-all"] == ["shared-all-0", "shared-all-1"]
    assert chosen["partial-all"][-1] == (last or "partial-all-1")
    if last is not None:
        assert made[last]["settings"]["particles"] == int(last.split("-")[2])
    assert not any(name.startswith("shared-all-") and name.count("-") == 3 for name in made)


def test_repeats_apart_by_one_standard_deviation_are_found(tmp_path):
    cases = PublishedCases(PublishedCases.default_plan())
    hierarchy = cases.hierarchy("shared")
    points = np.random.default_rng(2).standard_normal((4000, hierarchy.ndim))
    for name, shift in (("a", 0.0), ("b", 1.0), ("c", 0.0)):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "points.npz", points=points[:: -1 if name == "c" else 1] + shift)
    assert cases.apart("shared-all", ["a", "b"], tmp_path) == pytest.approx(1.0, rel=0.05)
    assert cases.apart("shared-all", ["a", "c"], tmp_path) < 1e-6
    assert cases.apart("shared-all", ["a"], tmp_path) == 0.0


# Bad input


def test_bad_folders_are_refused_with_a_sentence(tmp_path):
    plan = {
        "campaign": "thesis", "name": "thesis", "campaign_sha256": "", "priors": None, "normal_force": None,
        "effect": None, "seed": 1,
    }  # fmt: skip
    with pytest.raises(InputError, match="there is no such folder"):
        variability(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no results of `bayes-damper fit`"):
        variability(tmp_path)
    write_json(tmp_path / "summary.json", {"schema": "bayes-damper/diagnosis/1"})
    write_json(tmp_path / "run.json", {"command": "diagnose", "plan": {}})
    with pytest.raises(InputError, match="needs the results of"):
        variability(tmp_path)
    write_json(tmp_path / "summary.json", {"schema": "bayes-damper/fit/1", "converged": True})
    write_json(tmp_path / "run.json", {"command": "fit", "plan": plan | {"cases": ["I"]}})
    with pytest.raises(InputError, match="one case only"):
        variability(tmp_path)
    plan |= {"campaign": "rig", "cases": ["I", "IV"], "effect": "stick_slip"}
    write_json(tmp_path / "run.json", {"command": "fit", "plan": plan})
    with pytest.raises(InputError, match="has the effect stick_slip; variability knows the nominal model only"):
        variability(tmp_path)


def test_bad_arguments_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least 32 particles"):
        variability("thesis", out=tmp_path, particles=4)


def test_a_parameter_that_a_case_lacks_cannot_be_compared():
    _, likelihoods, _ = linear_cases(np.random.default_rng(1), "shared")
    with pytest.raises(InputError, match="case 0 has no parameter 'mu'"):
        Hierarchy(likelihoods, "shared", ("mu",))
