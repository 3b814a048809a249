"""What differs from trial to trial is learnt from repeats, held against dense algebra, simulation and known truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import helmert
from scipy.stats import multivariate_normal

from bayes_damper.calibration import Experiment, Noise, Problem, Switches, TrialRecord, calibrate_nominal, predict
from bayes_damper.calibration import scatter as scatters
from bayes_damper.calibration.scatter import (
    TYPICAL,
    Repeats,
    Scatter,
    Size,
    learn_scatter,
    typical_scatter,
)
from bayes_damper.simulation.model import Model

RIG = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0}
TRUE = {"mu": 0.006, "k2t": 1.4, "c2t": 0.07, "drag": 0.005, "nu": 40.0, "c1t": 0.011, "c3t": 0.009}
CASES = (("I", 6.2, 5.7), ("IV", 10.2, 4.7))


def laboratory(
    seed: int,
    sizes: Mapping[str, float],
    *,
    repeats: int = 4,
    coupled: bool = False,
    stiffer: float = 1.0,
    n: int = 500,
) -> Experiment:
    """Trials of a rig whose parameters, gains and offsets scatter; the last repeat of each is held out."""
    rng = np.random.default_rng(seed)
    times = np.arange(n) * 1e-3
    trials = []
    for index, (case, k1t, degrees) in enumerate(CASES):
        for both in (False, True) if coupled else (False,):
            for number in range(1, repeats + 1):
                angle = math.radians(degrees)
                rig = RIG | TRUE | {"k1t": k1t * stiffer, "theta0": angle * (1.0 + 0.01 * rng.standard_normal())}
                rig |= {p: rig[p] * math.exp(sizes.get(p, 0.0) * rng.standard_normal()) for p in (*TRUE, "k1t")}
                y = Model(both).simulate(rig, times).y[0]
                y *= 1.0 + sizes.get("gain", 0.0) * rng.standard_normal((len(y), 1))
                y += sizes.get("offset", 0.0) * rng.standard_normal((len(y), 1))
                y += 2.0 * rng.standard_normal(y.shape)
                label = f"{case}{number}{both}"
                last = 1 < repeats == number
                trials.append(
                    TrialRecord(label, case, both, number, times, y, index, angle, 0.01 * angle, heldout=last)
                )
    constants = {name: (value, 0.0) for name, value in RIG.items()}
    return Experiment(constants, tuple((k, 0.0) for _, k, _ in CASES), tuple(trials))


def sizes_of(scatter: Scatter) -> dict[str, Size]:
    return {size.name: size for size in scatter.sizes}


def test_likelihood_of_what_repeats_do_not_share_is_that_of_the_dense_gaussian():
    """Four repeats with a common part that no model explains, three own values each: contrasts of the readings."""
    rng = np.random.default_rng(3)
    slopes = rng.standard_normal((3, 12))
    residuals = rng.standard_normal((4, 12)) + 50.0 * rng.standard_normal(12)
    found = Repeats(("a", "b", "c"), np.tile(slopes @ slopes.T, (4, 1, 1)), residuals @ slopes.T)
    variances = np.array([0.3, 2.0, 1e-3])
    contrasts = helmert(4) @ residuals

    def dense(v: np.ndarray) -> float:
        return float(multivariate_normal(np.zeros(12), np.eye(12) + slopes.T * v @ slopes).logpdf(contrasts).sum())

    little = np.full(3, 1e-7)
    value, slope = found.log_likelihood(variances)
    assert value - found.log_likelihood(little)[0] == pytest.approx(dense(variances) - dense(little), abs=1e-4)
    for k in range(3):
        up, down = variances.copy(), variances.copy()
        up[k], down[k] = variances[k] * math.exp(1e-4), variances[k] * math.exp(-1e-4)
        assert slope[k] == pytest.approx((dense(up) - dense(down)) / 2e-4, abs=1e-4)


def test_repeats_with_other_clocks_are_judged_by_brute_force_alike():
    """Three repeats read at other instants: the mean has a flat prior, and what is left is a dense Gaussian."""
    rng = np.random.default_rng(4)
    slopes = [rng.standard_normal((2, n)) for n in (9, 11, 14)]
    residuals = [rng.standard_normal(t.shape[1]) + 3.0 * t[0] for t in slopes]
    gram, product = (np.array([f(t, r) for t, r in zip(slopes, residuals, strict=True)])
                     for f in (lambda t, _: t @ t.T, lambda t, r: t @ r))  # fmt: skip
    found = Repeats(("a", "b"), gram, product)
    T, r = np.concatenate(slopes, axis=1), np.concatenate(residuals)

    def dense(v: np.ndarray) -> float:
        own = np.zeros((r.size, r.size))
        first = 0
        for t in slopes:
            n = t.shape[1]
            own[first : first + n, first : first + n] = t.T * v @ t
            first += n
        return float(multivariate_normal(np.zeros(r.size), np.eye(r.size) + own + 1e6 * T.T @ T).logpdf(r))

    one, other = np.array([0.4, 1.5]), np.array([2.0, 0.1])
    assert found.log_likelihood(one)[0] - found.log_likelihood(other)[0] == pytest.approx(
        dense(one) - dense(other), abs=1e-3
    )


@pytest.mark.parametrize("coupled", [False, True])
def test_every_own_value_changes_the_record_as_its_column_says(coupled):
    """Columns taken from those of shared parameters, from readings and from simulation, against differences."""
    experiment = laboratory(1, {}, repeats=2, coupled=coupled, n=200)
    # One stiffness is uncertain and shared by one case only: the other trials' own ones are no copies of it.
    experiment = replace(experiment, stiffnesses=((6.2, 0.06), (10.2, 0.0)))
    noise = Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0))
    bare = Problem(experiment, noise=noise, switches=Switches(delay=False, friction=False))
    problem = bare.changed(switches=replace(bare.switches, scatter=typical_scatter(bare)))
    rng = np.random.default_rng(5)
    q = 0.2 * rng.standard_normal(problem.size)
    eta = {i: rng.standard_normal(len(g.nuisances)) for g in problem.groups for i in g.trials}
    fine = problem.finer()
    for block in problem.linearise(q, eta, central=True).blocks:
        group = block.group
        expected = {"theta0", "ln_k1t", "ln_c1t", "ln_drag", "gain1", "offset1", "drift1_1", "drift1_3"}
        expected |= {"ln_mu", "ln_k2t", "ln_c2t", "ln_c3t", "gain2", "drift2_2"} if group.coupled else set()
        names = [name for name, _, _ in group.nuisances]
        assert expected <= set(names)
        n = len(group.trials)
        for m, name in enumerate(names):
            moved = []
            for sign in (1.0, -1.0):
                values = block.eta.copy()
                values[:, m] += sign * 0.1
                y = fine.simulate(group, np.arange(n), np.tile(q, (n, 1)), values)
                moved.append(fine.whitened(y - group.y, group.weight))
            difference = (moved[0] - moved[1]) / 0.2
            error = np.linalg.norm(difference - block.T[:, m]) / np.linalg.norm(difference)
            assert error < 0.02, (name, error)


def test_sizes_are_learnt_from_repeats():
    """A spring that scatters by twice the usual, damping and offsets as usual, gains not at all."""
    truth = {"k1t": 0.004, "c1t": 0.08, "offset": 1.5}
    fit = calibrate_nominal(laboratory(2, truth, repeats=7))
    found = sizes_of(learn_scatter(fit))
    for name, size in (("k1t", 0.004), ("c1t", 0.08), ("offset1", 1.5)):
        assert 0.6 < found[name].sd / size < 1.6, name  # twelve draws show it to a fifth
        assert found[name].low < found[name].sd < found[name].high
        assert found[name].gained > 8.0
    assert found["drag"].low < 0.01
    assert found["gain1"].gained < 3.0
    assert abs(fit.excess) < 4.0 * math.sqrt(2.0 * fit.problem.n_data)
    assert fit.problem.noise.total[0] == pytest.approx(2.0, rel=0.03)


def test_what_repeats_share_is_no_scatter():
    """Both springs are 3 % stiffer than declared, in every trial: a gap, from which no scatter is learnt."""
    fit = calibrate_nominal(laboratory(3, {}, stiffer=1.03))
    assert sizes_of(learn_scatter(fit))["k1t"].sd < 0.002
    assert fit.cost > fit.problem.n_data + 300.0


def test_without_repeats_priors_carry_the_scatter():
    """Root of the mean square of half a Student t of 4 degrees of freedom: 1.4 times its scale."""
    experiment = laboratory(4, {}, repeats=1)
    fit = calibrate_nominal(experiment)
    found = sizes_of(fit.problem.switches.scatter)
    assert found["k1t"].sd == pytest.approx(math.sqrt(2.0) * TYPICAL["k1t"], rel=0.05)
    given = calibrate_nominal(replace(experiment, scatter={"k1t": 0.01, "c1t": 0.0}))
    assert sizes_of(given.problem.switches.scatter)["k1t"].sd == pytest.approx(math.sqrt(2.0) * 0.01, rel=0.05)
    assert "c1t" not in sizes_of(given.problem.switches.scatter)


def test_stretches_of_one_decay_have_no_springs_of_their_own():
    stretches = laboratory(5, {}, repeats=1)
    assert sizes_of(calibrate_nominal(stretches).problem.switches.scatter)
    assert calibrate_nominal(replace(stretches, start="free")).problem.switches.scatter.sizes == ()


def test_a_held_out_trial_has_values_of_its_own():
    experiment = laboratory(6, {"k1t": 0.005, "c1t": 0.1, "offset": 2.0}, repeats=4, coupled=True)
    fit = calibrate_nominal(experiment)
    for found in predict(fit, experiment.heldout).values():
        assert abs(found.chi2 - found.n_data) < 5.0 * math.sqrt(2.0 * found.n_data)


def test_a_size_that_nothing_shows_keeps_its_prior():
    typical = (Size("k1t", 0.002, 0.0, math.inf, 0.002),)

    blind = Repeats(("ln_k1t",), np.full((2, 1, 1), 1e-12), np.full((2, 1), 1e-9))
    (size,) = scatters._posterior([blind], typical)
    assert size.sd == pytest.approx(0.002 * math.sqrt(2.0), rel=0.05)
    assert size.low < 1e-4
    assert size.gained == pytest.approx(0.0, abs=1e-3)
