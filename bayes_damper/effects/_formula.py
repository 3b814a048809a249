"""Short formulas for a torque that the library does not hold: their grammar, and each as an effect that can be fitted.

    Q = sum over one to three terms of amount * f(x) * g(v) * h(t),    or amount * a memory of the motion

in the coordinates of a site as in `_law.py`: an angle x, a velocity v, the time since release t; s = s(nu v) is the
smooth sign of the nominal friction.

    f: 1, x, |x|, x^2, x|x|, x^3, sin(k x), cos(k x), tanh(x/d), stop(x, d) = sign(x) max(|x| - d, 0)
    g: 1, s, v, |v|, v|v|, v^2, v^3, s exp(-|v|/u)
    h: 1, t, exp(-t/tau)
    memory: spring and dashpot in series, z' = v - z/tau; friction that yields, z' = v - |v| z/d (Dahl)

A term has one factor with a shape (k, d, u, tau) at most. Those stand with g = 1, s or v (waves and tanh: 1 or s), h
with 1, x, s or v.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.effects._shapes import at_site, plus
from bayes_damper.effects.base import EffectParameter, Kernel, Variant
from bayes_damper.rig.vector_math import cos, exp, lane, sin, smooth_sign, tanh

Array = NDArray[np.float64]
GRAMMAR = (
    "one to three terms, each an amount times f(x) g(v) h(t) or a memory; f: 1, x, |x|, x^2, x|x|, x^3, sin(kx), "
    "cos(kx), tanh(x/d), stop(x, d); g: 1, s, v, |v|, v|v|, v^2, v^3, s exp(-|v|/u), s the sign of v; h: 1, t, "
    "exp(-t/tau); memories: z' = v - z/tau, z' = v - |v| z/d"
)
MOST_TERMS = 3


@dataclass(frozen=True)
class Factor:
    """A function of one coordinate.

    words: as it is written; value (coordinate, shape): of arrays; kernel (coordinate, shape, rig): the same where
    records are simulated; power: of the coordinate in its unit; shape: name of its free number, "" if it has none.
    """

    words: str
    value: Callable[[Array, float], Array]
    kernel: Kernel
    power: int = 0
    shape: str = ""


@lane
def one(c, shape, rig):
    """1."""
    return 1.0


@lane
def first(c, shape, rig):
    """The coordinate."""
    return c


@lane
def size(c, shape, rig):
    """Its size."""
    return abs(c)


@lane
def square(c, shape, rig):
    """Its square."""
    return c * c


@lane
def odd_square(c, shape, rig):
    """Its square with its sign."""
    return c * abs(c)


@lane
def cube(c, shape, rig):
    """Its cube."""
    return c * c * c


@lane
def sine(c, shape, rig):
    """A wave."""
    return sin(shape * c)


@lane
def cosine(c, shape, rig):
    """A wave."""
    return cos(shape * c)


@lane
def step(c, shape, rig):
    """A step as wide as its shape."""
    return tanh(c / shape)


@lane
def stop(c, shape, rig):
    """A stop at either side."""
    return c - min(max(c, -shape), shape)


@lane
def sign(c, shape, rig):
    """Sense of the motion, as the nominal friction has it."""
    return smooth_sign(rig.nu * c, rig.tail)


@lane
def hump(c, shape, rig):
    """The same, dying out with the speed."""
    return smooth_sign(rig.nu * c, rig.tail) * exp(-abs(c) / shape)


@lane
def dying(c, shape, rig):
    """Dying out with the time."""
    return exp(-c / shape)


ONE = Factor("1", lambda c, _: np.ones_like(c), one)
OF_ANGLE = (
    ONE,
    Factor("x", lambda c, _: c, first, 1),
    Factor("|x|", lambda c, _: np.abs(c), size, 1),
    Factor("x^2", lambda c, _: c * c, square, 2),
    Factor("x|x|", lambda c, _: c * np.abs(c), odd_square, 2),
    Factor("x^3", lambda c, _: c**3, cube, 3),
    Factor("sin(k x)", lambda c, k: np.sin(k * c), sine, 0, "k"),
    Factor("cos(k x)", lambda c, k: np.cos(k * c), cosine, 0, "k"),
    Factor("tanh(x/d)", lambda c, d: np.tanh(c / d), step, 0, "d"),
    Factor("stop(x, d)", lambda c, d: c - np.clip(c, -d, d), stop, 1, "d"),
)
# `value` of a factor of the sign takes the sign itself: the caller knows its curve.
OF_SPEED = (
    ONE,
    Factor("s", lambda c, _: c, sign),
    Factor("v", lambda c, _: c, first, 1),
    Factor("|v|", lambda c, _: np.abs(c), size, 1),
    Factor("v|v|", lambda c, _: c * np.abs(c), odd_square, 2),
    Factor("v^2", lambda c, _: c * c, square, 2),
    Factor("v^3", lambda c, _: c**3, cube, 3),
    Factor("s exp(-|v|/u)", lambda c, u: np.exp(-np.abs(c) / u), hump, 0, "u"),
)
OF_TIME = (
    ONE,
    Factor("t", lambda c, _: c, first, 1),
    Factor("exp(-t/tau)", lambda c, tau: np.exp(-c / tau), dying, 0, "tau"),
)
SHAPE_UNITS = {"k": "1/angle", "d": "angle", "u": "speed", "tau": "s"}


@dataclass(frozen=True)
class FormulaTerm:
    """A term of the grammar without its numbers: a product of three factors, or a memory ("relaxes" or "yields")."""

    angle: Factor = ONE
    speed: Factor = ONE
    time: Factor = ONE
    memory: str = ""

    @property
    def words(self) -> str:
        """As it is written."""
        if self.memory:
            return {"relaxes": "z[z' = v - z/tau]", "yields": "z[z' = v - |v| z/d]"}[self.memory]
        return " ".join(f.words for f in (self.angle, self.speed, self.time) if f is not ONE) or "1"

    @property
    def shape(self) -> str:
        """Name of its free number beside the amount, "" if it has none."""
        own = {"relaxes": "tau", "yields": "d", "": ""}[self.memory]
        return own or next((f.shape for f in (self.angle, self.speed, self.time) if f.shape), "")

    @property
    def powers(self) -> tuple[int, int, int]:
        """Of angle, velocity and time in the unit of what the amount multiplies."""
        return (1, 0, 0) if self.memory else (self.angle.power, self.speed.power, self.time.power)

    def torque(self, x: Array, v: Array, t: Array, s: Array, shape: float = 0.0) -> Array:
        """Torque per amount at coordinates of any shape, without memories; s : the smooth sign of v."""
        g = self.speed
        along = {"s": s, "s exp(-|v|/u)": v}.get(g.words, v)
        value = self.angle.value(x, shape) * g.value(along, shape) * self.time.value(t, shape)
        return np.asarray(value * s if g.words == "s exp(-|v|/u)" else value)


def _grammar() -> tuple[FormulaTerm, ...]:
    angle = {f.words: f for f in OF_ANGLE}
    speed = {f.words: f for f in OF_SPEED}
    out = [FormulaTerm(f, g) for f in OF_ANGLE if not f.shape for g in OF_SPEED if not g.shape]
    out += [FormulaTerm(angle[f], speed[g]) for f in ("sin(k x)", "cos(k x)", "tanh(x/d)") for g in ("1", "s")]
    out += [FormulaTerm(angle["stop(x, d)"], speed[g]) for g in ("1", "s", "v")]
    out.append(FormulaTerm(speed=speed["s exp(-|v|/u)"]))
    slow = [FormulaTerm(), FormulaTerm(angle["x"]), FormulaTerm(speed=speed["s"]), FormulaTerm(speed=speed["v"])]
    out += [FormulaTerm(p.angle, p.speed, h) for p in slow for h in OF_TIME if h is not ONE]
    return (*out, FormulaTerm(memory="relaxes"), FormulaTerm(memory="yields"))


TERMS = _grammar()
"""Every term of the grammar."""


# As effects -----------------------------------------------------------------------------------------------------------


def _product(term: FormulaTerm, i: int) -> Kernel:
    """Torque of a term whose amount is p[i] and whose shape p[i + 1]."""
    f, g, h = term.angle.kernel, term.speed.kernel, term.time.kernel
    j = i + 1 if term.shape else i

    @lane
    def product(t, x, v, z, p, rig):
        return p[i] * f(x, p[j], rig) * g(v, p[j], rig) * h(t, p[j], rig)

    return product


@lane
def remembered(t, x, v, z, p, rig):
    """Torque of a memory: z over k1t, so that it is an angle."""
    return rig.k1t * z


def _relaxing(i: int) -> Kernel:
    @lane
    def relaxing(t, x, v, z, p, rig):
        return v * p[i] / rig.k1t - z / p[i + 1]

    return relaxing


def _yielding(i: int) -> Kernel:
    @lane
    def yielding(t, x, v, z, p, rig):
        return v * p[i] / rig.k1t - abs(v) * z / p[i + 1]

    return yielding


def formula_variant(
    terms: Sequence[FormulaTerm], site: str, bodies: str, priors: Sequence[Any], starts: Sequence[Sequence[float]]
) -> Variant:
    """Terms as a formula that can be fitted: parameters `a1`, then `k1`, `d1`, `u1` or `tau1` if it has one, `a2`, ...

    priors : of the parameters, in order. One memory at most.
    """
    parameters: list[EffectParameter] = []
    parts: list[Kernel] = []
    rate: Kernel | None = None
    for number, term in enumerate(terms, 1):
        i = len(parameters)
        parts.append(remembered if term.memory else _product(term, i))
        if term.memory:
            rate = _relaxing(i) if term.memory == "relaxes" else _yielding(i)
        for name in ("a", term.shape)[: 1 + bool(term.shape)]:
            null = 0.0 if name == "a" else None
            meaning = f"Amount of {term.words}." if name == "a" else f"Shape of {term.words}."
            reason = "As large as the records leave open." if name == "a" else "Within what the records can show."
            parameters.append(EffectParameter(f"{name}{number}", "1", meaning, priors[i + (name != "a")], reason, null))
    memory = (2 if site == "bearings" and bodies == "both" else 1) if rate is not None else 0
    return Variant(
        name="named",
        formula="Q = " + " + ".join(f"a{k} {t.words}" for k, t in enumerate(terms, 1)),
        parameters=tuple(parameters),
        torque=at_site(site, bodies, reduce(plus, parts)),
        couples="interface" if site == "interface" else "bodies",
        timed=any(t.time is not ONE for t in terms),
        rate=at_site(site, bodies, rate, memory=True) if rate is not None else None,
        memory=memory,
        memory_scale=(0.005,) * memory,
        starts=tuple(tuple(map(float, s)) for s in starts),
        uncoupled=site in ("ground1", "bearings"),
    )
