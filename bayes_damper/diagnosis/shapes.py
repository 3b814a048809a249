"""Generic shapes that a missing torque or a faulty sensor can take, site by site: the site map's vocabulary.

No effect of the library is named here. Each site has groups of columns, e.g. smooth functions of its own coordinates,
memories of them, or bumps in time; a group is what one cause would use. Coordinates are scaled by their largest value
in the campaign, so a column means the same in every case.

Polynomials up to degree 5 in a site's own angle and velocity are there already (`_tensor`): add what they cannot
follow, such as |v|, corners or memories. A new shape is one more `Shape` in the function of its site (`_ground1`, ...):
in the group of the cause that it is a form of, or in a new one, for another cause. Every group of trials gives the same
shapes in the same order, zeros where one does not act; a group whose name ends in 2 is left out where no trial is
coupled. A group of laws of torque that an effect's formula may stand for is also named in `LAWS` of
diagnosis/formula.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.diagnosis.response import Motion, scale_of
from bayes_damper.effects.base import SITES
from bayes_damper.rig.kernels import compiled

Array = NDArray[np.float64]

DEGREE = 5  # of the polynomials in angle and velocity
BUMPS = 40  # in time, along a record
WINDOWS = 40  # of time in which a sensor may misbehave
PLACES = 12  # on the way of an angle from one end to the other
CONTACTS = 8  # after the release, each longer than the one before, the last one a quarter of the rig's period long
HUM = (50.0, 60.0, 100.0, 120.0)  # Hz
TOUCHES = (0.25, 2.0)  # periods after the release, between which what held the rig may touch it again
BACK = (0.5, 1.25)
"""Periods after the release between which a rig swings back to where it was held: what acts before the end of that, at
the same instants of all trials, is what held it, and may be short."""
TOUCHES_A_PERIOD, TAPS_A_PERIOD = 12, 24
RESONANCES = tuple(1.5 * 1.35**k for k in range(9))  # times the rig's own frequency
DAMPING = 0.08  # ratio of those resonators: wide enough to meet their neighbours
SHARP = 0.02  # damping ratio of the one at the residuals' own peak


@dataclass(frozen=True)
class Scale:
    """Largest values in the campaign: angles (rad), velocities (rad/s), torque k1t theta0 (N m), duration (s)."""

    th1: float
    w1: float
    th2: float
    w2: float
    phi: float
    slip: float
    torque: float
    theta0: float
    duration: float
    omega: float
    readings: tuple[float, ...]
    peak: float
    """Frequency of the residuals' strongest line above the rig's own, rad/s; 0 if unknown."""
    back: float = 0.0
    """Time from a release to the end of `BACK`, s; 0 where nothing is released."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One column for one group of trials: torques (trials, N), a change of start (trials, 4) or of readings."""

    site: str
    group: str
    q1: Array | None = None
    q2: Array | None = None
    start: Array | None = None
    reading: Array | None = None

    @property
    def acts(self) -> bool:
        """Whether it is a torque."""
        return self.q1 is not None or self.q2 is not None

    @property
    def silent(self) -> bool:
        """Whether it is nothing on these trials, as all that has to do with a secondary is on uncoupled ones."""
        return not any(x.any() for x in (self.q1, self.q2, self.start, self.reading) if x is not None)


def scale_of_motions(motions: Sequence[Motion], peak: float = 0.0, released: bool = False) -> Scale:
    """The campaign's largest values; peak as in `Scale`; released : whether the trials begin with a release."""
    coupled = [m for m in motions if m.group.coupled]
    period = max(float(np.median(np.diff(m.grid))) for m in motions)
    omega = float(np.median(np.concatenate([m.w1.std(axis=1) / (m.th1.std(axis=1) + 1e-300) for m in motions])))
    omega, channels = max(omega, 1e-3 / period), max(m.y.shape[1] for m in motions)
    return Scale(
        th1=scale_of([m.th1 for m in motions]), w1=scale_of([m.w1 for m in motions]),
        th2=scale_of([m.th2 for m in coupled]), w2=scale_of([m.w2 for m in coupled]),
        phi=scale_of([m.phi for m in coupled]), slip=scale_of([m.slip for m in coupled]),
        torque=scale_of([m.k1t[:, None] * m.th1 for m in motions]), theta0=scale_of([m.theta0 for m in motions]),
        duration=max(float(m.grid[-1]) for m in motions), omega=omega,
        readings=tuple(
            scale_of([m.y[:, c] for m in motions if m.y.shape[1] > c]) for c in range(channels)
        ),
        peak=peak, back=BACK[1] * 2.0 * np.pi / omega if released else 0.0,
    )  # fmt: skip


def shapes_of(motion: Motion, scale: Scale, coupled_campaign: bool) -> Iterator[Shape]:
    """All columns for the trials of one motion, in the same order for every motion of a campaign."""
    for site, build in _BUILDERS.items():
        if site in ("interface", "ground2") and not coupled_campaign:
            continue
        for shape in build(motion, scale):
            if coupled_campaign or not shape.group.endswith("2"):
                yield Shape(site, shape.group, shape.q1, shape.q2, shape.start, shape.reading)


# Elements -------------------------------------------------------------------------------------------------------------


def _tensor(a: Array, b: Array) -> list[Array]:
    """Chebyshev products T_i(a) T_j(b), i + j <= DEGREE, the constant first; a, b within [-1, 1]."""
    a, b = np.clip(a, -1.0, 1.0), np.clip(b, -1.0, 1.0)
    ta, tb = [np.ones_like(a), a], [np.ones_like(b), b]
    for _ in range(DEGREE - 1):
        ta.append(2.0 * a * ta[-1] - ta[-2])
        tb.append(2.0 * b * tb[-1] - tb[-2])
    return [ta[i] * tb[j] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]


def relaxed(motion: Motion, rate: Array, tau: float) -> Array:
    """Force of a spring and dashpot in series driven at `rate`: m' = rate - m / tau, m = 0 at release; (trials, N)."""
    h = np.diff(motion.grid)
    keep = np.exp(-h / tau)
    gain = tau * (1.0 - keep)
    mean = 0.5 * (rate[:, 1:] + rate[:, :-1])
    return np.asarray(_followed(np.tile(keep, (len(mean), 1)), gain * mean))


@compiled()
def _followed(keep: Array, added: Array) -> Array:
    """x[0] = 0, x[i + 1] = keep[i] x[i] + added[i], along each row; (trials, steps) -> (trials, steps + 1)."""
    out = np.zeros((keep.shape[0], keep.shape[1] + 1))
    for j in range(keep.shape[0]):
        for i in range(keep.shape[1]):
            out[j, i + 1] = keep[j, i] * out[j, i] + added[j, i]
    return out


def dahl(angle: Array, breakaway: float) -> Array:
    """Rate-independent memory of an angle: h follows it over `breakaway` rad and then saturates at +-1; (trials, N)."""
    moved = np.diff(angle, axis=1) / breakaway
    keep = np.exp(-np.abs(moved))
    return np.asarray(_followed(keep, np.sign(moved) * (1.0 - keep)))


@compiled()
def _ringing(pole, driven):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 (of numbers, real or complex)
    """y[i] = driven[i] + pole y[i - 1], along each row, from rest; (trials, N)."""
    out = np.empty_like(driven)
    for j in range(driven.shape[0]):
        last = 0.0 * pole
        for i in range(driven.shape[1]):
            last = driven[j, i] + pole * last
            out[j, i] = last
    return out


def _resonances(drive: Array, h: float, scale: Scale) -> Iterator[Array]:
    """Deflection and speed of lightly damped resonators shaken by `drive` (trials, N), sampled every h s."""
    known = [(factor * scale.omega, DAMPING) for factor in RESONANCES]
    for omega, damping in [*known, (scale.peak if scale.peak > 0.0 else 2.5 * scale.omega, SHARP)]:
        angle = min(omega * h, 0.9 * math.pi)
        pole = np.exp((-damping + 1j * math.sqrt(1.0 - damping**2)) * angle)
        state = _ringing(complex(pole), (angle + 0.0j) * drive)
        yield state.imag
        yield state.real


def _flexible(motion: Motion, drive: Array, scale: Scale) -> Iterator[Array]:
    h = float(np.median(np.diff(motion.grid)))
    yield from _resonances(drive * (motion.since > 0.0), h, scale)


def _bumps(motion: Motion, scale: Scale, begin: float = 0.0) -> Iterator[Array]:
    centres = (np.arange(BUMPS) + 0.5) * scale.duration / BUMPS
    width = scale.duration / BUMPS
    for centre in centres[centres >= begin]:
        x = (motion.grid - centre) / width
        yield np.broadcast_to(np.where(np.abs(x) < 1.0, 0.5 + 0.5 * np.cos(np.pi * x), 0.0), motion.th1.shape)


def _places(angle: Array, reach: float) -> Iterator[Array]:
    """Triangles that share out the way of an angle from -reach to reach; they add up to 1 in between."""
    width = 2.0 * reach / (PLACES - 1)
    for k in range(PLACES):
        yield np.maximum(0.0, 1.0 - np.abs(angle + reach - k * width) / width)


def _contacts(m: Motion, s: Scale) -> Iterator[Array]:
    """Half waves that begin at the release or soon after it, the later the longer."""
    last = 0.5 * np.pi / s.omega
    first = min(2.0 * float(np.median(np.diff(m.grid))), 0.2 * last)
    edges = np.concatenate([[0.0], np.geomspace(first, last, CONTACTS + 1)])
    for k in range(CONTACTS):
        middle = edges[k + 1]
        rising = np.clip((m.since - edges[k]) / (middle - edges[k]), 0.0, 1.0)
        falling = np.clip((edges[k + 2] - m.since) / (edges[k + 2] - middle), 0.0, 1.0)
        yield np.asarray(np.sin(0.5 * np.pi * np.minimum(rising, falling)) ** 2)


def _touches(m: Motion, s: Scale, a_period: int, within: tuple[float, float]) -> Iterator[Array]:
    """Half waves, so many a period after the release, each twice as long as they are apart; within : periods."""
    spacing = 2.0 * np.pi / s.omega / a_period
    first, last = (round(end * a_period) for end in within)
    for k in range(first, last + 1):
        yield 0.5 + 0.5 * np.cos(np.pi * np.clip(m.since / spacing - k, -1.0, 1.0))


def _drags(m: Motion, w: Array, reach: float) -> list[Array]:
    """Odd functions of a velocity: dry, smoother dry, Stribeck humps, square, cube, root."""
    v = w / reach
    dry = m.dry(w)
    return [
        dry, np.tanh(v / 0.1), np.tanh(v / 0.3), dry * np.exp(-np.abs(v) / 0.02), dry * np.exp(-np.abs(v) / 0.06),
        dry * np.exp(-np.abs(v) / 0.2), v * np.abs(v), v**3, dry * np.sqrt(np.abs(v)),
    ]  # fmt: skip


# Sites ----------------------------------------------------------------------------------------------------------------


def _ground1(m: Motion, s: Scale) -> Iterator[Shape]:
    u, v, t = m.th1 / s.th1, m.w1 / s.w1, m.since / s.duration
    for f in _tensor(u, v):
        yield Shape("", "law", f)
    for f in _own_spring(u):
        yield Shape("", "spring", f)
    for f in _places(m.th1, s.th1):
        yield Shape("", "place", f)
    for f in (u * t, v * t, u * t * t, np.exp(-5.0 * t) * u, t, t * t):
        yield Shape("", "drift", f)
    for breakaway in (0.02, 0.06, 0.2, 0.6):
        yield Shape("", "memory", dahl(m.th1, breakaway * s.th1))
    for tau in (0.1, 0.3, 1.0, 3.0):
        yield Shape("", "memory", relaxed(m, v, tau / s.omega))
    for f in _flexible(m, m.a1 / (s.w1 * s.omega), s):
        yield Shape("", "flexible", f)
    for f in _bumps(m, s):
        yield Shape("", "drift", f * u)
    for f in _bumps(m, s, s.back):
        yield Shape("", "time", f)


def _own_spring(u: Array) -> Iterator[Array]:
    """A cubic, stops and dead zones of a scaled angle."""
    yield u**3
    for stop in (0.2, 0.35, 0.5, 0.65, 0.8, 0.9):
        yield np.sign(u) * np.maximum(np.abs(u) - stop, 0.0)
    for slack in (0.01, 0.03, 0.1):
        yield np.clip(u / slack, -1.0, 1.0)


def _bearings(m: Motion, s: Scale) -> Iterator[Shape]:
    coupled = m.group.coupled
    d1 = _drags(m, m.w1, s.w1)
    d2 = _drags(m, m.w2, s.w2) if coupled else [np.zeros_like(m.w1)] * len(d1)
    wide = [s.w2 / s.w1 if coupled else 1.0] * len(d1)
    for k in (6, 7):  # the same law on both inertias, in the same units
        wide[k] = (s.w2 / s.w1) ** (2.0 if k == 6 else 3.0)
    for k, (a, b) in enumerate(zip(d1, d2, strict=True)):
        yield Shape("", "drag", a, b * (wide[k] if k >= 6 else 1.0))
    pull = m.overlap if coupled else np.zeros_like(m.w1)
    for k in (0, 1, 2, 6):
        yield Shape("", "load", d1[k] * pull, d2[k] * pull)
    for k in (0, 1):
        yield Shape("", "load", d1[k] * (pull > 0.0), d2[k] * (pull > 0.0))
        yield Shape("", "load", d1[k] * np.abs(m.phi) / s.phi, d2[k] * np.abs(m.phi) / s.phi)
    t = m.since / s.duration
    for k in (0, 2):
        yield Shape("", "drift", d1[k] * t, d2[k] * t)
    ratio = s.w2 / s.w1
    yield Shape("", "drift", m.w1 / s.w1 * t, m.w2 / s.w2 * t * ratio if coupled else 0.0 * t)
    # Drag that is not the same in both directions.
    v1, v2 = m.w1 / s.w1, m.w2 / s.w1 if coupled else 0.0 * m.w1
    for a, b in ((np.abs(d1[0]), np.abs(d2[0])), (np.abs(v1), np.abs(v2)), (v1**2, v2**2)):
        yield Shape("", "one way", a, b)
    # A dent, or a rough spot, at some angle of the shafts.
    reach = max(s.th1, s.th2)
    for a, f in zip(_places(m.th1, reach), _places(m.th2, reach), strict=True):
        b = f if coupled else 0.0 * f
        yield Shape("", "dent", a, b)
        yield Shape("", "spot", a * d1[0], b * d2[0])


def _interface(m: Motion, s: Scale) -> Iterator[Shape]:
    def pair(group: str, f: Array) -> Shape:
        f = f if m.group.coupled else np.zeros_like(m.th1)
        return Shape("", group, -f, f)

    phi, slip, t = m.phi, m.slip, m.since / s.duration
    p, v = phi / s.phi, slip / s.slip
    dry = m.dry(slip)
    pull = m.overlap
    for f in _tensor(p, v):
        yield pair("law", f)
    for f in (dry, dry * pull, dry * pull**2, dry * pull**3, dry * np.abs(p), dry * p**2, dry * p**4):
        yield pair("friction", f)
    for hump in (0.02, 0.06, 0.2, 0.5):
        yield pair("friction", dry * pull * np.exp(-np.abs(v) / hump))
    for f in (v * pull, v * pull**2, v * np.abs(p), v * p**2, v * p**4, v * np.abs(v), v / (1.0 + (3.0 * v) ** 2)):
        yield pair("damping", f)
    for f in (p**3, p**5, p * np.abs(p), p * pull, np.sign(p) * np.maximum(np.abs(p) - 0.5, 0.0)):
        yield pair("magnet", f)
    heat = np.cumsum(np.abs(slip) * np.gradient(m.grid)[None, :], axis=1)
    heat = heat / (s.slip * s.duration)
    for f in (dry * pull, p, v):
        yield pair("heat", f * heat)
        yield pair("heat", f * t)
    for tau in (0.1, 0.3, 1.0, 3.0, 10.0):
        yield pair("memory", relaxed(m, v, tau / s.omega))
    for breakaway in (0.01, 0.03, 0.1, 0.3):
        yield pair("memory", dahl(phi, breakaway * s.phi) * pull)
    for k in range(1, 9):
        yield pair("poles", np.sin(0.5 * np.pi * k * p))
        yield pair("poles", np.cos(0.5 * np.pi * k * p))
    for f in (np.abs(dry), np.abs(dry) * pull, dry * pull * np.tanh(p / 0.1), np.abs(v)):
        yield pair("one way", f)
    for f in _bumps(m, s):
        yield pair("time", f)
    for f in _flexible(m, (m.a1 - m.a2) / (s.slip * s.omega), s):
        yield pair("flexible", f)


def _ground2(m: Motion, s: Scale) -> Iterator[Shape]:
    def own(group: str, f: Array) -> Shape:
        return Shape("", group, None, f if m.group.coupled else np.zeros_like(m.th1))

    u, v, t = m.th2 / s.th2, m.w2 / s.w2, m.since / s.duration
    for f in _tensor(u, v):
        yield own("law", f)
    yield own("inertia", m.a2 / (s.w2 * s.omega))
    for f in (np.ones_like(t), u, u * u):
        yield own("weight", f)
    for f in _own_spring(u):
        yield own("spring", f)
    for f in _places(m.th2, s.th2):
        yield own("place", f)
    for f in _drags(m, m.w2, s.w2):
        yield own("drag", f)
    for f in (u * t, v * t, t, t * t):
        yield own("drift", f)
    for breakaway in (0.02, 0.06, 0.2, 0.6):
        yield own("memory", dahl(m.th2, breakaway * s.th2))
    for tau in (0.1, 0.3, 1.0, 3.0):
        yield own("memory", relaxed(m, v, tau / s.omega))
    for f in _flexible(m, m.a2 / (s.w2 * s.omega), s):
        yield own("flexible", f)
    for f in _bumps(m, s):
        yield own("time", f)


def _release(m: Motion, s: Scale) -> Iterator[Shape]:
    n = m.th1.shape[0]
    reach = (m.k1t * m.theta0)[:, None]
    angle = m.theta0 / s.theta0
    coupled = m.group.coupled
    nothing = np.zeros((n, 4))

    def begun(index: int, size: Array) -> Array:
        out = nothing.copy()
        out[:, index] = size
        return out

    one = np.ones(n)
    for size in (angle, one):
        yield Shape("", "offset2", start=begun(1, s.theta0 * size if coupled else 0.0 * size))
        yield Shape("", "speed", start=begun(2, s.w1 * size))
        yield Shape("", "speed2", start=begun(3, s.w1 * size if coupled else 0.0 * size))
        yield Shape("", "start", start=begun(0, s.theta0 * size))
    # The holder lets go late: a torque towards the start that dies out within a time.
    step = float(np.median(np.diff(m.grid)))
    for steps in (0.4, 1.0, 2.0, 4.0, 8.0):
        held = np.maximum(0.0, 1.0 - m.since / (steps * step)) * reach / s.torque
        yield Shape("", "hold", held)
    for steps in (2.0, 8.0):
        held = np.exp(-m.since / (steps * step)) * reach / s.torque
        yield Shape("", "hold", held)
        yield Shape("", "hold2", None, held if coupled else 0.0 * held)
    # What held it touches it again.
    for touch in _contacts(m, s):
        yield Shape("", "contact", touch * reach / s.torque)
        yield Shape("", "contact", touch)
        yield Shape("", "contact2", None, touch if coupled else 0.0 * touch)
    for group, a_period, within in (("touch", TOUCHES_A_PERIOD, TOUCHES), ("tap", TAPS_A_PERIOD, BACK)):
        for touch in _touches(m, s, a_period, within):
            yield Shape("", group, touch * reach / s.torque)


def _sensor(m: Motion, s: Scale) -> Iterator[Shape]:
    group = m.group
    n, channels, size = m.y.shape
    dt = np.gradient(group.times)
    released = (m.since[:, m.at] > 0.0).astype(float)
    th, w = (m.th1[:, m.at], m.th2[:, m.at]), (m.w1[:, m.at], m.w2[:, m.at])
    t = m.since[:, m.at] / s.duration
    h = float(np.median(np.diff(group.times)))

    for c in range(len(s.readings)):
        present = c < channels
        y = m.y[:, c] / s.readings[c] if present else np.zeros((n, size))
        slope = np.gradient(y, group.times, axis=1) * released / s.omega
        other = m.y[:, 1 - c] / s.readings[1 - c] if channels == 2 and present else np.zeros((n, size))

        def column(kind: str, f: Array, c: int = c, present: bool = present, while_held: bool = False) -> Shape:
            out = np.zeros((n, channels, size))
            if present:
                out[:, c] = f if while_held else f * released
            return Shape("", f"{kind}{'' if c == 0 else ' 2'}", reading=out)

        yield column("gain", y, while_held=True)
        yield column("delay", slope)
        for tau in (0.3, 1.0, 3.0, 8.0):
            yield column("lowpass", _passed(y, tau * h, dt) - y)
        for tau in (1.0, 3.0, 10.0, 30.0, 100.0):
            slow = _passed(y, tau / s.omega, dt)
            yield column("highpass", slow)
        for tau in (3.0, 30.0):
            yield column("highpass", _passed(_passed(y, tau / s.omega, dt), tau / s.omega, dt))
        for limit in (0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9):
            yield column("clip", y - np.clip(y, -limit, limit), while_held=True)
        for f in (y**2, y**3, y * np.abs(y), np.abs(y), np.tanh(y / 0.05)):
            yield column("nonlinear", f, while_held=True)
        for f in (other, np.gradient(other, group.times, axis=1) / s.omega):
            yield column("cross 2", f)
        for f in (np.ones((n, size)), t, t * t, np.exp(-5.0 * t)):
            yield column("offset", f)
        for f in (y * t, y * t * t, slope * t):
            yield column("drift", f)
        for f in (th[c] / s.th1, w[c] / s.w1, (w[c] / s.w1) ** 2, (th[c] / s.th1) ** 2):
            yield column("tilt", f)
        for f in _resonances(y * released, h, s):  # a sensor on an elastic mount
            yield column("mount", f)
        for start in s.duration * np.arange(WINDOWS) / WINDOWS:
            inside = ((group.times >= start) & (group.times < start + s.duration / WINDOWS)).astype(float)
            yield column("moment", np.broadcast_to(inside, (n, size)))
            yield column("moment", inside * y)
            yield column("moment", inside * y[:, [int(np.argmax(inside))]])
        for hertz in HUM:
            for wave in (np.sin, np.cos):
                yield column("hum", np.broadcast_to(wave(2.0 * np.pi * hertz * group.times), (n, size)))
    both = np.gradient(m.y, group.times, axis=2) * t[:, None] * released[:, None] / s.omega / s.readings[0]
    yield Shape("", "clock", reading=both)


def _passed(y: Array, tau: float, dt: Array) -> Array:
    """First-order low-pass of y (trials, n), from rest at 0."""
    keep = math.exp(-float(np.median(dt)) / tau)
    return np.asarray(_ringing(keep, (1.0 - keep) * y))


_BUILDERS: dict[str, Callable[[Motion, Scale], Iterator[Shape]]] = {
    "ground1": _ground1, "bearings": _bearings, "interface": _interface, "ground2": _ground2, "release": _release,
    "sensor": _sensor,
}  # fmt: skip
assert tuple(_BUILDERS) == SITES
