"""What stands for causes that no effect of the library names: nominal laws that change while a trial runs, drag that
depends on the direction, and a sensor that is not straight.

Effects that grow or fade with the amplitude imitate a slow change almost perfectly, a spring that is not straight
imitates a reading that is not, and bodies that begin apart imitate a bias, so that tests of the remainder miss them. As
candidates of their own they win only where they explain better than each effect; their probability counts for the
answer `unknown`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayes_damper.effects._shapes import friction
from bayes_damper.effects.base import Effect, EffectParameter, Site, Variant
from bayes_damper.priors.distributions import LogUniform, Normal
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.rig.vector_math import exp, lane, smooth_sign

UNKNOWN = "unknown"
"""Name of all of them: the answer that they count for."""


@lane
def bearing(w, c, rig):
    """Torque of a nominal bearing of viscous constant c at a velocity."""
    return c * w + rig.drag * smooth_sign(rig.nu * w, rig.tail)


@lane
def changed(th1, th2, w1, w2, share, p, rig):
    """A share of each nominal torque, times a factor of its own: spring, bearings, coupling, friction of the faces."""
    phi, v = th1 - th2, w1 - w2
    spring = p[0] * rig.k1t * th1
    joint = p[2] * (rig.k2t * phi + rig.c2t * v) + p[3] * friction(phi, v, rig)
    held1, held2 = p[1] * bearing(w1, rig.c1t, rig), p[1] * bearing(w2, rig.c3t, rig)
    return -share * (spring + held1 + joint), share * (joint - held2)


@lane
def drifting(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Each nominal torque times the time since release."""
    return changed(th1, th2, w1, w2, t, p, rig)


@lane
def settling(t, th1, th2, w1, w2, z1, z2, p, rig):
    """Each nominal torque times what is left after the time since release of a change that dies away."""
    return changed(th1, th2, w1, w2, exp(-t / p[4]), p, rig)


@lane
def one_way(t, th1, th2, w1, w2, z1, z2, p, rig):
    """A share of each drag that keeps its direction: bearings, damping of the coupling, friction of the faces."""
    v = w1 - w2
    held1 = p[0] * bearing(w1, rig.c1t, rig) * smooth_sign(rig.nu * w1, rig.tail)
    held2 = p[0] * bearing(w2, rig.c3t, rig) * smooth_sign(rig.nu * w2, rig.tail)
    joint = (p[1] * rig.c2t * v + p[2] * friction(th1 - th2, v, rig)) * smooth_sign(rig.nu * v, rig.tail)
    return -held1 - joint, joint - held2


@lane
def curved(y, a, b, c):
    """A reading with a square, a cubic and a fourth power of itself."""
    return y * (1.0 + y * (a + y * (b + y * c)))


@lane
def curved1(h, u1, u2, y1, y2, s1, s2, p, first):
    """The primary's channel."""
    return curved(y1, p[0], p[1], p[2]), y2, s1, s2


@lane
def curved2(h, u1, u2, y1, y2, s1, s2, p, first):
    """The secondary's channel."""
    return y1, curved(y2, p[0], p[1], p[2]), s1, s2


_LAWS = (
    ("spring", "the spring to ground"), ("bearings", "the bearings"), ("coupling", "the coupling"),
    ("friction", "the faces"),
)  # fmt: skip


def _rate(name: str, of: str) -> EffectParameter:
    return EffectParameter(
        name, "1/s", f"Relative change per second of the torque of {of}.", Normal(0.0, 0.3),
        "Within a trial of a second a law may well change by a third, hardly by more.", 0.0,
    )  # fmt: skip


def _share(name: str, of: str) -> EffectParameter:
    return EffectParameter(
        name, "1", f"Relative change at the release of the torque of {of}.",
        Normal(0.0, 1.0 if name in ("bearings", "friction") else 0.3),
        "Grease and rubbing faces may begin with twice their later drag; a stiffness changes by a third, hardly more.",
        0.0,
    )  # fmt: skip


def _biased(name: str, of: str) -> EffectParameter:
    return EffectParameter(
        name, "1", f"Half the difference of the drag of {of} in both directions, over their mean.", Normal(0.0, 0.5),
        "At 1 it drags in one direction only, as a brush with its nap does.", 0.0,
    )  # fmt: skip


def _power(name: str, power: int) -> EffectParameter:
    return EffectParameter(
        name, f"1/reading^{power}", f"Error of a reading over its power {power + 1}.", Normal(0.0, 0.05 / 200.0**power),
        "At usual peaks a faulty sensor is off by some per cent.", 0.0,
    )  # fmt: skip


_TIME = EffectParameter(
    "time", "s", "Time in which the change dies away.", LogUniform(0.05, 5.0),
    "From half a period of the rig to longer than most records; what is faster belongs to the release.",
)  # fmt: skip


def _one_by_one(sizes: Sequence[float], *rest: float) -> tuple[tuple[float, ...], ...]:
    """Starts: each law alone, up and down."""
    each = [(k, sign * size) for sign in (1.0, -1.0) for k, size in enumerate(sizes)]
    return tuple((*(x if i == k else 0.0 for i in range(len(sizes))), *rest) for k, x in each)


_BENT = tuple((a, b, 0.0) for a, b in ((5e-5, 0.0), (-5e-5, 0.0), (0.0, 5e-7), (0.0, -5e-7)))
_CURVE = tuple(_power(name, power) for name, power in (("square", 1), ("cube", 2), ("fourth", 3)))

CHANGE = Effect(
    name=UNKNOWN,
    site="ground1",
    summary="A law of the nominal rig changes while a trial runs, for a reason that the library does not name.",
    looks_like="Early and late swings that no single set of parameters fits.",
    hides_behind=("k1t", "c1t", "drag"),
    source="Own formulas: first order of any slow change, and a change that dies away.",
    variants=(
        Variant(
            name="drift",
            formula="Q = -t (a1 k1t th1 + a2 bearings + a3 coupling + a4 friction)",
            parameters=tuple(_rate(name, of) for name, of in _LAWS),
            torque=drifting,
            timed=True,
            starts=_one_by_one((0.05, 0.2, 0.2, 0.3)),
        ),
        Variant(
            name="settling",
            formula="Q = -exp(-t/tau) (a1 k1t th1 + a2 bearings + a3 coupling + a4 friction)",
            parameters=(*(_share(name, of) for name, of in _LAWS), _TIME),
            torque=settling,
            timed=True,
            starts=tuple(p for tau in (0.1, 0.6) for p in _one_by_one((0.02, 0.2, 0.2, 0.3), tau)),
        ),
    ),
)  # fmt: skip
ONE_WAY = Effect(
    name=UNKNOWN,
    site=CHANGE.site,  # of one kind with it: together they are as likely beforehand as one effect
    summary="A drag depends on the direction of motion, for a reason that the library does not name.",
    looks_like="Swings to both sides that lose not the same, about a middle that moves as they fade.",
    hides_behind=("drag", "mu", "theta0"),
    source="Own formula: the even part of any law of drag.",
    variants=(
        Variant(
            name="one_way",
            formula="Q = -(a1 |bearings| + a2 |c2t (w1 - w2)| + a3 |friction|)",
            parameters=tuple(_biased(name, of) for name, of in _LAWS[1:]),
            torque=one_way,
            starts=_one_by_one((0.2, 0.2, 0.2)),
        ),
    ),
)  # fmt: skip
CURVED = Effect(
    name=UNKNOWN,
    site="sensor",
    summary="A channel is not straight, for a reason that the library does not name.",
    looks_like="Swings of another shape, or not alike to both sides, at the frequency of the model.",
    hides_behind=("theta0", "k1t"),
    source="Own formula: the first terms of any smooth error of a reading.",
    variants=tuple(
        Variant(
            name=f"channel{channel}",
            formula=f"m{channel} = y{channel} (1 + a y{channel} + b y{channel}^2 + c y{channel}^3)",
            parameters=_CURVE, sense=sense, starts=_BENT, uncoupled=channel == 1,
        )
        for channel, sense in ((1, curved1), (2, curved2))
    ),
)  # fmt: skip
GENERIC = (CHANGE, ONE_WAY, CURVED)
_SITES: dict[str, Site] = {
    "spring": "ground1", "bearings": "bearings", "coupling": "interface", "friction": "interface",
}  # fmt: skip


def site_of(effect: Effect, parameters: Mapping[str, tuple[float, float]]) -> Site:
    """Where a cause without a name acts; parameters : value and standard deviation of each unknown of its fit.

    Of several laws that of the largest share over its standard deviation.
    """
    return effect.site if effect is CURVED else _SITES[_law_of(parameters)]


def _law_of(parameters: Mapping[str, tuple[float, float]]) -> str:
    clear = {name: abs(value) / max(sd, 1e-300) for name, (value, sd) in parameters.items()}
    return max(_SITES, key=lambda law: clear.get(OF_EFFECT + law, 0.0))


def in_words(effect: Effect, parameters: Mapping[str, tuple[float, float]], reach: float) -> str:
    """What such a cause does, in a sentence; parameters : as in `site_of`; reach : largest reading of its channel."""
    values = {name.removeprefix(OF_EFFECT): value for name, (value, _) in parameters.items()}
    if effect is CURVED:
        off = [abs(x * (values["square"] + x * (values["cube"] + x * values["fourth"]))) for x in (reach, -reach)]
        does = f"a channel that is not straight, off by up to {100.0 * max(off):.2g} % at its largest readings"
    else:
        law = _law_of(parameters)
        of, size = dict(_LAWS)[law], 100.0 * values[law]
        if effect is ONE_WAY:
            does = f"the drag of {of} is {abs(size):.3g} % larger in one direction than in the mean of both"
        elif "time" in values:
            does = (
                f"the torque of {of} is off by {size:+.3g} % at the release, which dies away in {values['time']:.3g} s"
            )
        else:
            does = f"the torque of {of} changes by {size:+.3g} % a second"
    return f"What explains the gap best is no effect of the library: {does}."
