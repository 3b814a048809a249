"""Terms of the grammar: what kernels compute against numpy, and records against scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import reference
from scipy.integrate import solve_ivp

from bayes_damper.effects._formula import TERMS, _product, formula_variant
from bayes_damper.priors.distributions import LogUniform, Normal
from bayes_damper.rig.equations import Rig
from bayes_damper.simulation.model import Model

TERM = {t.words: t for t in TERMS}
TIMES = np.arange(301) * 1e-3


def test_no_term_stands_twice_and_each_has_one_shape_at_most():
    assert len(TERM) == len(TERMS)
    assert all(sum(bool(f.shape) for f in (t.angle, t.speed, t.time)) <= 1 for t in TERMS)


@pytest.mark.parametrize("term", [t for t in TERMS if not t.memory], ids=lambda t: t.words)
def test_a_kernel_computes_its_term(term):
    rig = Rig(*[0.0] * len(Rig._fields))._replace(nu=60.0)
    shape = {"k": 30.0, "d": 0.02, "u": 1.5, "tau": 0.2, "": 0.0}[term.shape]
    product = _product(term, 1)
    for x, v, t in ((0.05, -1.2, 0.3), (-0.01, 0.02, 0.0), (-0.08, 3.0, 0.7)):
        one = product.py_func(t, x, v, 0.0, (9.0, 2.0, shape, 7.0), rig)
        s = np.tanh(60.0 * np.array([v]))
        wanted = 2.0 * term.torque(np.array([x]), np.array([v]), np.array([t]), s, shape)[0]
        assert one == pytest.approx(wanted, rel=1e-6, abs=1e-12)


def by_hand(words, amount, shape):
    """Torque (x, v, t, z, nu) and rate of the memory (x, v, z), from what is written alone."""
    if words == "x^2 v":
        return lambda x, v, t, z, nu: amount * x * x * v, None
    if words == "x exp(-t/tau)":
        return lambda x, v, t, z, nu: amount * x * math.exp(-t / shape), None
    if words == "stop(x, d) s":
        return (
            lambda x, v, t, z, nu: amount * math.copysign(max(abs(x) - shape, 0.0), x) * math.tanh(nu * v),
            None,
        )
    rate = (lambda x, v, z: v - z / shape) if "tau" in words else (lambda x, v, z: v - abs(v) * z / shape)
    return lambda x, v, t, z, nu: amount * z, rate


@pytest.mark.parametrize(
    ("site", "parts"),
    [
        ("interface", [("x^2 v", 40.0, 0.0), ("z[z' = v - z/tau]", 0.8, 0.02)]),
        ("bearings", [("z[z' = v - |v| z/d]", -0.5, 0.02), ("stop(x, d) s", -0.1, 0.01)]),
        ("ground2", [("x exp(-t/tau)", -2.0, 0.1)]),
    ],
)
def test_records_with_a_formula_are_those_of_scipy(site, parts):
    p = reference.BASE | {"nu": 40.0}
    laws = [by_hand(*part) for part in parts]

    def torque(k, x, v, t, z):
        return sum(law(x, v, t, z[k], p["nu"]) for law, _ in laws)

    def rate(k, x, v, z):
        return next((r(x, v, z[k]) for _, r in laws if r is not None), 0.0)

    def rhs(t, s):
        th1, th2, w1, w2, *z = s
        phi, slip = th1 - th2, w1 - w2
        q = [0.0, 0.0]
        if site == "interface":
            q[1] = torque(0, phi, slip, t, z)
            q[0] = -q[1]
            dz = [rate(0, phi, slip, z), 0.0]
        elif site == "ground2":
            q[1], dz = torque(0, th2, w2, t, z), [0.0, 0.0]
        else:
            q = [torque(0, th1, w1, t, z), torque(1, th2, w2, t, z)]
            dz = [rate(0, th1, w1, z), rate(1, th2, w2, z)]
        pull = p["N0"] * max(0.0, 1.0 - p["R"] * abs(phi) / (2.0 * p["r"]))
        joint = p["k2t"] * phi + p["c2t"] * slip + p["mu"] * pull * p["R"] * math.tanh(p["nu"] * slip)
        a1 = (q[0] - joint - p["c1t"] * w1 - p["k1t"] * th1 - p["drag"] * math.tanh(p["nu"] * w1)) / p["J1"]
        a2 = (q[1] + joint - p["c3t"] * w2 - p["drag"] * math.tanh(p["nu"] * w2)) / p["J2"]
        return [w1, w2, a1, a2, *dz]

    start = [p["theta0"], p["theta0"], 0.0, 0.0, 0.0, 0.0]
    s = solve_ivp(rhs, (0.0, TIMES[-1]), start, "LSODA", TIMES, rtol=1e-9, atol=1e-11, max_step=1e-3).y
    wanted = np.array([rhs(t, s[:, i])[2:4] for i, t in enumerate(TIMES)]).T
    values, priors = [], []
    for words, amount, shape in parts:
        values += [amount, shape] if TERM[words].shape else [amount]
        priors += [Normal(0.0, 1.0), LogUniform(1e-3, 1.0)] if TERM[words].shape else [Normal(0.0, 1.0)]
    variant = formula_variant([TERM[words] for words, _, _ in parts], site, "both", priors, (values,))
    own = dict(zip([q.name for q in variant.parameters], values, strict=True))
    found = Model(True, effect=variant).simulate(p, TIMES, effect=own).y[0]
    assert np.abs(found - wanted).max() < 2e-4 * np.abs(wanted).max()
    without = Model(True).simulate(p, TIMES).y[0]
    assert np.abs(without - wanted).max() > 0.01 * np.abs(wanted).max()
