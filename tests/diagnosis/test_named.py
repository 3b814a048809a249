"""A learnt law named: formulas that made the records come first, "shape only" where the grammar has none."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from solved import measured_with

from bayes_damper.calibration import calibrate_nominal
from bayes_damper.diagnosis.budget import Budget
from bayes_damper.diagnosis.law import learn
from bayes_damper.diagnosis.named import (
    SIZES,
    Entry,
    Proposal,
    Weighed,
    _apart,
    _pruned,
    closer,
    entries_of,
    gains,
    proposed,
)
from bayes_damper.diagnosis.response import Projected
from bayes_damper.diagnosis.sets import set_fit
from bayes_damper.diagnosis.shares import NO_SHARE
from bayes_damper.diagnosis.sites import site_map
from bayes_damper.effects._formula import TERMS

TERM = {t.words: t for t in TERMS}


def named(site, law):
    """What the records of a rig with this law give, none of the library's effects in the way."""
    fit = calibrate_nominal(measured_with(site, law))
    budget = Budget(set_fit((), fit), (), NO_SHARE, {}, {})
    return learn(fit, budget, "unknown", site_map(fit, torque=False))


@pytest.mark.slow
def test_cubic_damping_is_named_with_its_amount():
    learnt = named("bearings", lambda x, v, t: -4e-4 * v**3)
    assert learnt.law.site == "bearings"
    best = learnt.named.formulas[0]
    assert [t.words for t in best.proposal.formula] == ["v^3"]
    assert best.probability > 0.8
    [(_, (amount, sd), _)] = best.numbers()
    assert abs(amount + 4e-4) < 4.0 * sd < 1e-4
    shown = learnt.to_json()["named"]
    assert shown["formulas"][0]["terms"][0]["unit"] == "N m (rad/s)^-3"
    assert sum(f["probability"] for f in shown["formulas"]) + shown["shape_only"] <= 1.0 + 1e-9
    assert learnt.law.formulas[0] == (best.words(), best.probability)


@pytest.mark.slow
def test_a_shape_that_the_grammar_does_not_hold_stays_a_shape():
    def dents(x, v, t):
        return -0.03 * math.exp(-(((x - 0.03) / 0.008) ** 2)) - 0.02 * math.exp(-(((x + 0.05) / 0.01) ** 2))

    learnt = named("ground1", dents)
    assert learnt.law.site == "ground1"
    assert learnt.named.shape_only > 0.7


def judged(columns, residuals):
    """The Gram matrix of columns (k, n) of white data that nothing else can stand for."""
    gram = columns @ columns.T
    return Projected(gram, columns @ residuals, np.diag(gram).copy(), np.zeros((3, len(columns))))


@pytest.mark.parametrize("truth", [("v^3",), ("|x|", "x s"), ("sin(k x)", "x^2 v", "v t")])
def test_the_terms_that_made_the_residuals_lead(truth):
    rng = np.random.default_rng(4)
    entries = entries_of(0.1, 5.0, 1.0, 0.03)
    columns = rng.standard_normal((len(entries), 2000))
    made = [next(k for k, e in enumerate(entries) if e.term.words == w) for w in truth]
    found = proposed(judged(columns, 0.4 * columns[made].sum(axis=0) + rng.standard_normal(2000)), entries)
    assert {t.words for t in found[0].formula} == set(truth)
    np.testing.assert_allclose(found[0].amounts, 0.4, atol=0.1)
    assert found[0].entries == tuple(entries[k] for k in sorted(made))


def test_of_a_formula_and_the_same_with_more_terms_the_likelier_one_is_kept():
    rng = np.random.default_rng(4)
    entries = entries_of(0.1, 5.0, 1.0, 0.03)
    columns = rng.standard_normal((len(entries), 2000))
    k = next(k for k, e in enumerate(entries) if e.term.words == "v^3")
    found = proposed(judged(columns, 0.4 * columns[k] + rng.standard_normal(2000)), entries)
    assert [t.words for t in found[0].formula] == ["v^3"]
    assert len(found) > 2
    best = Weighed(found[0], 0.0)
    for ranked in (found, found[::-1]):  # in whatever order the others come
        assert not any(set(p.formula) > {TERM["v^3"]} for p in _apart(ranked, best))
    assert {len(p.formula) for p in found} == {1, 2, 3}


def test_the_gain_of_a_set_is_the_evidence_under_its_likeliest_prior_size():
    """Against the density of the readings, Gaussian amounts integrated out."""
    rng = np.random.default_rng(7)
    columns = rng.standard_normal((3, 40)) / math.sqrt(40.0)
    r = 5.0 * columns[0] + rng.standard_normal(40)
    found = gains(columns @ columns.T, columns @ r, np.array([[0, 1], [1, 2]]))
    for value, chosen in zip(found, ([0, 1], [1, 2]), strict=True):
        x = columns[chosen]
        under = [multivariate_normal.logpdf(r, cov=np.eye(40) + s**2 * x.T @ x) for s in SIZES]
        wanted = max(under) - multivariate_normal.logpdf(r, cov=np.eye(40)) - math.log(SIZES.size)
        assert value == pytest.approx(wanted, abs=1e-6)


def test_of_noise_no_formula_gains_anything():
    rng = np.random.default_rng(5)
    entries = entries_of(0.1, 5.0, 1.0, 0.03)
    found = proposed(judged(rng.standard_normal((len(entries), 2000)), rng.standard_normal(2000)), entries)
    assert found[0].evidence < 0.0


def test_what_parameters_can_do_is_no_term():
    rng = np.random.default_rng(6)
    entries = [Entry(TERM["v"]), Entry(TERM["v^3"])]
    columns = rng.standard_normal((2, 2000))
    whole = judged(columns, columns.sum(axis=0))
    taken = Projected(whole.gram * np.array([[1e-5, 0.0], [0.0, 1.0]]), whole.product, whole.raw, whole.absorbed)
    assert [[t.words for t in p.formula] for p in proposed(taken, entries)] == [["v^3"]]


def test_leading_shapes_are_looked_at_more_closely():
    entries = entries_of(0.1, 5.0, 1.0, 0.03)
    waves = [e for e in entries if e.term.words == "sin(k x)"]
    leading = Proposal((waves[4], Entry(TERM["x^3"])), np.ones(2), np.ones(2), 1.0)
    fine = [e.shape for e in closer(entries, [leading]) if e.term.words == "sin(k x)"]
    assert waves[3].shape < min(fine) < waves[4].shape < max(fine) < waves[5].shape
    assert waves[4].shape in fine
    assert {e.term.words for e in closer(entries, [leading]) if e.prior is None} == {
        t.words for t in TERMS if not t.shape
    }


def test_terms_whose_amounts_may_be_nothing_are_dropped():
    """Three amounts, of which one is 40 sd from nothing, in prior sds."""
    entries = (Entry(TERM["v^3"]), Entry(TERM["x^3"]), Entry(TERM["t"]))
    fit = SimpleNamespace(
        q=np.array([0.7, 0.4, 0.005, -0.01]),
        covariance=np.diag([1.0, 1e-4, 1e-4, 1e-4]),
        problem=SimpleNamespace(size=4),
    )
    kept = _pruned(Weighed(Proposal(entries, np.ones(3), np.full(3, 2.0), 1.0), 7.0, fit))
    assert [t.words for t in kept.formula] == ["v^3"]
    np.testing.assert_allclose(kept.amounts, [0.8])
    clear = SimpleNamespace(q=np.array([0.7, 0.4, 0.5, -0.6]), covariance=fit.covariance, problem=fit.problem)
    assert _pruned(Weighed(Proposal(entries, np.ones(3), np.full(3, 2.0), 1.0), 7.0, clear)) is None


def test_a_formula_is_written_with_its_numbers():
    wave = next(e for e in entries_of(0.1, 5.0, 1.0, 0.03) if e.term.words == "sin(k x) s")
    p = Proposal((Entry(TERM["1"]), wave, Entry(TERM["v|v|"])), np.array([-0.02, 0.5, -3e-3]), np.ones(3), 0.0)
    assert Weighed(p, 0.0).words() == f"-0.02 + 0.5 sin({wave.shape:.3g} x) s - 0.003 v|v|"
    units = [t["unit"] for t in Weighed(p, 0.0).to_json(False)["terms"]]
    assert units == ["N m", "N m", "N m (rad/s)^-2"]
    assert Weighed(p, 0.0).to_json(True)["terms"][1]["value_unit"] == "1/m"
