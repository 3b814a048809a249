"""Two effects in one rig: their formulas composed into one variant, exactly.

Torques add up, memory states stand side by side, sensors and the rig's own constants are changed by the first one and
then by the second. A pair that needs more than the kernel has room for (twelve parameters, of which the second one has
at most four, two memory states, one sensor, one replaced friction) cannot be composed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

from bayes_damper.effects.base import MOST_PARAMETERS, Kernel, Variant
from bayes_damper.rig.vector_math import lane

MOST_SECOND = 4  # parameters of the second of two variants that are composed
Labels = tuple[str, str]
PLACES: Labels = ("first", "second")


def compose(
    first: Variant, second: Variant, *, coupled: bool = True, labels: Labels = PLACES
) -> Variant | None:  # fmt: skip
    """Both variants at once, for the coupled or the uncoupled rig; None if the kernel has no room for both.

    Parameters are called `LABEL.NAME`, by default `first.NAME` and `second.NAME`; other labels also stand before the
    formulas. In the uncoupled rig only those act that say so; the parameters of the others are kept, so that both
    configurations take the same ones.
    """
    split = len(first.parameters)
    if len(second.parameters) > MOST_SECOND or split + len(second.parameters) > MOST_PARAMETERS:
        return None
    if first.memory + second.memory > 2:
        return None
    if (first.sense and second.sense) or (first.replaces_friction and second.replaces_friction):
        return None
    acting = [v if coupled or v.uncoupled else _silent(v) for v in (first, second)]
    a, b = (_shifted(v, start) for v, start in zip(acting, (0, split), strict=True))
    one_memory = a.memory
    couples = {v.couples for v in (a, b) if v.torque is not None}
    named = list(zip(labels, (first, second), strict=True))
    return Variant(
        name=f"{first.name}+{second.name}",
        formula="; ".join(v.formula if labels == PLACES else f"{label}: {v.formula}" for label, v in named),
        parameters=tuple(replace(p, name=f"{label}.{p.name}") for label, v in named for p in v.parameters),
        torque=_both(a.torque, b.torque, one_memory),
        couples=couples.pop() if len(couples) == 1 else "all",
        timed=a.timed or b.timed,
        rate=_both_rates(a, b),
        start=_both_starts(a, b),
        memory=a.memory + b.memory,
        memory_scale=a.memory_scale + b.memory_scale,
        sense=a.sense or b.sense,
        sensor_states=max(a.sensor_states, b.sensor_states),
        lag=_both_lags(acting, labels),
        amend=_both_amendments(acting, labels),
        lets_go=next((f"{label}.{v.lets_go}" for label, v in zip(labels, acting, strict=True) if v.lets_go), ""),
        replaces_friction=a.replaces_friction or b.replaces_friction,
        uncoupled=first.uncoupled or second.uncoupled,
    )


def _silent(v: Variant) -> Variant:
    """The variant's parameters without what they do."""
    return replace(
        v, torque=None, rate=None, start=None, memory=0, memory_scale=(), sense=None, sensor_states=1, lag=None,
        amend=None, timed=False, lets_go="", late=0.0, replaces_friction=False,
    )  # fmt: skip


def _shifted(v: Variant, start: int) -> Variant:
    """The variant with kernels that read their parameters from the place `start` on."""
    if start == 0:
        return v
    i0, i1, i2, i3 = (min(start + k, MOST_PARAMETERS - 1) for k in range(MOST_SECOND))
    g1, g2, g3 = (1.0 if k < len(v.parameters) else 0.0 for k in range(1, MOST_SECOND))

    def moved(kernel: Kernel) -> Kernel:
        @lane
        def torque(t, th1, th2, w1, w2, z1, z2, p, rig):
            return kernel(t, th1, th2, w1, w2, z1, z2, (p[i0], p[i1] * g1, p[i2] * g2, p[i3] * g3), rig)

        return torque

    def moved_start(kernel: Kernel) -> Kernel:
        @lane
        def start(p, rig):
            return kernel((p[i0], p[i1] * g1, p[i2] * g2, p[i3] * g3), rig)

        return start

    def moved_sense(kernel: Kernel) -> Kernel:
        padded = sensor_of_three_states(kernel, v.sensor_states)

        @lane
        def sense(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, p, first):
            own = (p[i0], p[i1] * g1, p[i2] * g2, p[i3] * g3)
            return padded(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, own, first)

        return sense

    return replace(
        v,
        torque=None if v.torque is None else moved(v.torque),
        rate=None if v.rate is None else moved(v.rate),
        start=None if v.start is None else moved_start(v.start),
        sense=None if v.sense is None else moved_sense(v.sense),
        sensor_states=1 if v.sense is None else 3,
    )


def _both(a: Kernel | None, b: Kernel | None, memory: int) -> Kernel | None:
    """Sum of two torques; the second one's memory begins after the first one's `memory` states."""
    if b is None:
        return a
    own = b
    if memory == 1:

        @lane
        def own(t, th1, th2, w1, w2, z1, z2, p, rig):
            return b(t, th1, th2, w1, w2, z2, 0.0, p, rig)

    if a is None:
        return own

    @lane
    def torque(t, th1, th2, w1, w2, z1, z2, p, rig):
        q1, q2 = a(t, th1, th2, w1, w2, z1, z2, p, rig)
        m1, m2 = own(t, th1, th2, w1, w2, z1, z2, p, rig)
        return q1 + m1, q2 + m2

    return torque


def _both_rates(a: Variant, b: Variant) -> Kernel | None:
    if a.rate is None or b.rate is None:
        return a.rate or b.rate
    one, two = a.rate, b.rate

    @lane
    def rate(t, th1, th2, w1, w2, z1, z2, p, rig):
        d1, _ = one(t, th1, th2, w1, w2, z1, 0.0, p, rig)
        d2, _ = two(t, th1, th2, w1, w2, z2, 0.0, p, rig)
        return d1, d2

    return rate


def _both_starts(a: Variant, b: Variant) -> Kernel | None:
    one, two = a.start, b.start
    if one is None and two is None:
        return None
    if a.memory == 0 or b.memory == 0:
        return one if a.memory else two
    if one is not None and two is not None:

        @lane
        def start(p, rig):
            z1, _ = one(p, rig)
            z2, _ = two(p, rig)
            return z1, z2

    elif one is not None:

        @lane
        def start(p, rig):
            z1, _ = one(p, rig)
            return z1, 0.0

    else:
        last: Any = two

        @lane
        def start(p, rig):
            z2, _ = last(p, rig)
            return 0.0, z2

    return start


def _own(p: Mapping[str, Any], label: str) -> dict[str, Any]:
    return {name.removeprefix(f"{label}."): x for name, x in p.items() if name.startswith(f"{label}.")}


def _both_lags(acting: list[Variant], labels: Labels) -> Callable[..., tuple[Any, Any]] | None:
    lags = [(label, v.lag) for label, v in zip(labels, acting, strict=True) if v.lag is not None]
    if not lags:
        return None

    def lag(p: Mapping[str, Any]) -> tuple[Any, Any]:
        each = [own(_own(p, label)) for label, own in lags]
        return sum(x[0] for x in each), sum(x[1] for x in each)

    return lag


def _both_amendments(acting: list[Variant], labels: Labels) -> Callable[..., Mapping[str, Any]] | None:
    changes = [(label, v.amend) for label, v in zip(labels, acting, strict=True) if v.amend is not None]
    if not changes:
        return None

    def amend(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
        for label, change in changes:
            parameters = change(parameters, _own(p, label))
        return parameters

    return amend


@lru_cache(maxsize=1024)  # the same kernel for the same sensor
def sensor_of_three_states(kernel: Kernel, states: int) -> Kernel:
    """A sensor of up to three states in each channel, as `advance` calls it."""
    if states == 1:

        @lane
        def sense(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, p, first):
            m1, m2, n1, n2 = kernel(h, u1, u2, y1, y2, s1, s2, p, first)
            return m1, m2, n1, n2, v1, v2, r1, r2

    elif states == 2:

        @lane
        def sense(h, u1, u2, y1, y2, s1, s2, v1, v2, r1, r2, p, first):
            m1, m2, n1, n2, o1, o2 = kernel(h, u1, u2, y1, y2, s1, s2, v1, v2, p, first)
            return m1, m2, n1, n2, o1, o2, r1, r2

    else:
        return kernel
    return sense
