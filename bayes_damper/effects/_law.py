"""A law of torque that was learnt from records: a sum of smooth curves, kept in a file that works as an effect.

    Q = sum over terms of carrier * curve(coordinate)

Coordinates are the site's own: an angle x and a velocity v (of the primary, the secondary, or their difference) and the
time since release. A carrier is 1, tanh(nu v), x or v, the last two over their largest value: a torque by the place, a
dry friction by the place, a damping by the place, and so on. A curve is a Chebyshev series over the range that was
seen; beyond it the last value is held. The torque acts on the primary (ground1), the secondary (ground2), on each by
its own motion or on the primary alone (bearings), or between both (interface: -Q on the primary, Q on the secondary).

`--effects FILE` makes the effect `learnt_SITE` of such a file. Source: own form; Boyd (2001), Chebyshev and Fourier
Spectral Methods, ch. 2, for the series.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.effects._shapes import at_site, plus
from bayes_damper.effects.base import MOST_PARAMETERS, Effect, EffectParameter, Kernel, Variant
from bayes_damper.errors import InputError
from bayes_damper.inputs import LARGEST_TOML, fields, file_bytes, real, shown, text_of, toml_of
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.vector_math import lane, tanh

Array = NDArray[np.float64]

SCHEMA = "bayes-damper/law/1"
CARRIERS = ("one", "dry", "angle", "speed")
COORDINATES = ("angle", "speed", "time")
SITES = ("ground1", "bearings", "interface", "ground2")
ORDER = 12  # coefficients of a curve
MOST_TERMS = 4
MOST_DIRECTIONS = MOST_PARAMETERS  # in which a law that is being learnt can move
FINE = 0.2  # share of the largest velocity below which a curve along the velocity is spread
OTHER_RIG = 0.2  # relative difference of an inertia beyond which a law is another rig's


@dataclass(frozen=True)
class Term:
    """carrier * curve(along); coefficients (ORDER,): of the curve's Chebyshev series, N m (N)."""

    carrier: str
    along: str
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Law:
    """A learnt law with all that its file holds.

    bodies : "both" or "primary", for the bearings; ranges: coordinate -> lowest and highest value that was seen (rad,
    rad/s, s; m and m/s); nu: s/rad, of the carrier tanh(nu v) in tables; roots: rows (terms * ORDER) whose outer
    products add up to the covariance of the coefficients; rig: kind, J1 and J2 of the rig it was learnt on; campaign:
    its name; beside: effects that were in the model when it was learnt; closes: share of the gap on held-out trials,
    with 90 % interval; nominal: parameters of the nominal model that were fitted with the law, SI; formulas: short
    ones that may stand for it, with probabilities; shape_only: the probability that none of them does.
    """

    site: str
    bodies: str
    ranges: Mapping[str, tuple[float, float]]
    nu: float
    terms: tuple[Term, ...]
    roots: tuple[tuple[float, ...], ...] = ()
    rig: Mapping[str, Any] | None = None
    campaign: str = ""
    beside: tuple[str, ...] = ()
    closes: tuple[float, float, float] | None = None
    nominal: Mapping[str, float] | None = None
    formulas: tuple[tuple[str, float], ...] = ()
    shape_only: float | None = None

    @property
    def name(self) -> str:
        """Of the effect."""
        return f"learnt_{self.site}"

    def basis(self, angle: Array, speed: Array, time: Array) -> Array:
        """Carriers times Chebyshev polynomials of all terms, (n, terms * ORDER), where the coordinates (n,) are."""
        return basis_of(self.terms, self.ranges, self.nu, angle, speed, time)

    def torque(self, angle: Array, speed: Array, time: Array) -> tuple[Array, Array]:
        """Torque and its standard deviation (n,), N m, at coordinates (n,)."""
        features = self.basis(*(np.asarray(c, float) for c in (angle, speed, time)))
        coefficients = np.concatenate([t.coefficients for t in self.terms])
        roots = np.array(self.roots).reshape(-1, coefficients.size)
        return features @ coefficients, np.sqrt(np.sum((features @ roots.T) ** 2, axis=1))

    def curve(self, k: int) -> tuple[Array, Array, Array]:
        """Term k's curve without its carrier: 101 places in its range, torque there, and its standard deviation."""
        term = self.terms[k]
        roots = tuple(r[k * ORDER : (k + 1) * ORDER] for r in self.roots)
        at = np.linspace(*self.ranges[term.along], 101)
        alone = replace(self, terms=(replace(term, carrier="one"),), roots=roots)
        return at, *alone.torque(at, at, at)

    def outside(self, seen: Mapping[str, tuple[float, float]]) -> list[str]:
        """Sentences on coordinates whose values in `seen` (lowest, highest) leave the range, by more than 2 % of it."""
        out = []
        used = {t.along for t in self.terms} | {t.carrier for t in self.terms}
        for name, (low, high) in self.ranges.items():
            slack = 0.02 * (high - low)
            if name in used and name in seen and (seen[name][0] < low - slack or seen[name][1] > high + slack):
                out.append(
                    f"{self.name} was learnt for {_WORDS[name]} from {low:.3g} to {high:.3g}; here there are "
                    f"{seen[name][0]:.3g} to {seen[name][1]:.3g}, where it holds its last value"
                )
        return out

    def mismatch(self, kind: str, inertias: Mapping[str, float]) -> str | None:
        """A sentence if the law is that of another rig: another kind, or an inertia that differs by a fifth."""
        if self.rig is None:
            return None
        if self.rig["kind"] != kind:
            return f"{self.name} was learnt on a {self.rig['kind']} rig, and this one is {kind}; its units do not fit"
        for key in ("J1", "J2"):
            own, here = self.rig.get(key), inertias.get(key)
            if own and here and abs(here / own - 1.0) > OTHER_RIG:
                return (
                    f"{self.name} was learnt on a rig with {key} = {own:.4g}, and this one has {here:.4g}; learn it on "
                    "this rig: bayes-damper diagnose"
                )
        return None

    def effect(self) -> Effect:
        """The law as an effect of one parameter, its size."""
        size = EffectParameter(
            "size", "1", "Factor on the torque that was learnt.", Normal(1.0, 0.5),
            "Learnt with size 1; another set-up of the same rig may have half or one and a half times as much.", 0.0,
        )  # fmt: skip
        terms = " + ".join(term_words(t) for t in self.terms)
        return Effect(
            name=self.name,
            site=self.site,  # type: ignore[arg-type]
            summary=f"A law at this site that was learnt from the records of {self.campaign or 'a campaign'}.",
            looks_like="What the nominal model missed in the records that it was learnt from.",
            hides_behind=("c1t", "c3t", "drag") if self.site == "bearings" else ("k2t", "c2t", "mu"),
            source="Learnt by `bayes-damper diagnose`.",
            needs=("coupled",) if self.site in ("interface", "ground2") else (),
            variants=(
                variant_of("learnt", self.site, self.bodies, _fixed(self.terms, self.ranges), self.terms, (size,),
                           ((1.0,), (0.2,)), f"Q = size * ({terms}), learnt"),
            ),
            title="a law that was learnt",
            law=self,
        )  # fmt: skip


def driven_variant(law: Law) -> Variant:
    """A law as a formula where time runs `pace` times as fast as for the rig: parameters (size, pace)."""
    numbers = tuple(
        EffectParameter(name, "1", meaning, Normal(1.0, 0.5), "Given by whoever drives the rig.", null)
        for name, meaning, null in (("size", "Factor on the torque.", 0.0), ("pace", "Simulated over true time.", None))
    )
    kernel = _fixed(law.terms, law.ranges, paced=True)
    return variant_of("driven", law.site, law.bodies, kernel, law.terms, numbers, ((1.0, 1.0),), "Q = size * law")


_WORDS = {"angle": "angles", "speed": "velocities", "time": "times"}


def term_words(term: Term) -> str:
    """A term as a formula without numbers."""
    carrier = {"one": "", "dry": "tanh(nu v) ", "angle": "x ", "speed": "v "}[term.carrier]
    return f"{carrier}f({ {'angle': 'x', 'speed': 'v', 'time': 't'}[term.along] })"


def scaled_coordinate(along: str, x: Array, low: float, high: float) -> Array:
    """The coordinate brought from its range to [-1, 1], values beyond it to the ends.

    Friction has its detail where the motion reverses, so a velocity is spread there: u = (1 + FINE) w / (FINE + |w|)
    with w = v over its largest size.
    """
    x = np.clip(x, low, high)
    if along == "speed":
        w = x / max(abs(low), abs(high))
        return np.asarray((1.0 + FINE) * w / (FINE + np.abs(w)))
    return np.asarray((2.0 * x - (high + low)) / (high - low))


def basis_of(
    terms: Sequence[Term], ranges: Mapping[str, tuple[float, float]], nu: Array | float, angle: Array, speed: Array,
    time: Array,
) -> Array:  # fmt: skip
    """As `Law.basis`, along the last axis of coordinates of any shape."""
    values = {"angle": angle, "speed": speed, "time": time}
    out = []
    for term in terms:
        u = scaled_coordinate(term.along, values[term.along], *ranges[term.along])
        series = np.polynomial.chebyshev.chebvander(u, ORDER - 1)
        out.append(_carried(term.carrier, ranges, nu, angle, speed)[..., None] * series)
    return np.concatenate(out, axis=-1)


def _carried(
    carrier: str, ranges: Mapping[str, tuple[float, float]], nu: Array | float, angle: Array, speed: Array
) -> Array:
    if carrier == "one":
        return np.ones_like(angle)
    if carrier == "dry":
        return np.tanh(nu * speed)
    reach = max(map(abs, ranges[carrier]))
    return np.clip((angle if carrier == "angle" else speed) / reach, -1.0, 1.0)


# Kernels --------------------------------------------------------------------------------------------------------------


@lane
def series(u, c):
    """Chebyshev series of twelve coefficients at u within [-1, 1], by Clenshaw's recurrence."""
    two = u + u
    b11 = c[11]
    b10 = two * b11 + c[10]
    b9 = two * b10 - b11 + c[9]
    b8 = two * b9 - b10 + c[8]
    b7 = two * b8 - b9 + c[7]
    b6 = two * b7 - b8 + c[6]
    b5 = two * b6 - b7 + c[5]
    b4 = two * b5 - b6 + c[4]
    b3 = two * b4 - b5 + c[3]
    b2 = two * b3 - b4 + c[2]
    b1 = two * b2 - b3 + c[1]
    return u * b1 - b2 + c[0]


@lane
def mixed(p, m):
    """Sum of twelve parameters times twelve numbers."""
    low = p[0] * m[0] + p[1] * m[1] + p[2] * m[2] + p[3] * m[3] + p[4] * m[4] + p[5] * m[5]
    return low + p[6] * m[6] + p[7] * m[7] + p[8] * m[8] + p[9] * m[9] + p[10] * m[10] + p[11] * m[11]


@lane
def one(x, v, rig):
    """No carrier."""
    return 1.0


@lane
def dry(x, v, rig):
    """Sense of the motion, as the nominal friction has it."""
    return tanh(rig.nu * v)


def _over(reach: float, of_angle: bool) -> Kernel:
    """Angle or velocity over its largest value."""
    per = 1.0 / reach

    @lane
    def share(x, v, rig):
        return min(max((x if of_angle else v) * per, -1.0), 1.0)

    return share


def _place(along: str, low: float, high: float) -> Kernel:
    """The coordinate of a curve, from its range to [-1, 1].

    Kernels are distinguished by their names and what they bind (specialised._fingerprint): each has a name of its own.
    """
    middle, per, reach = 0.5 * (low + high), 2.0 / (high - low), max(abs(low), abs(high))

    @lane
    def by_time(t, x, v):
        return min(max((t - middle) * per, -1.0), 1.0)

    @lane
    def by_angle(t, x, v):
        return min(max((x - middle) * per, -1.0), 1.0)

    @lane
    def by_speed(t, x, v):
        w = min(max(v, low), high) / reach
        return (1.0 + FINE) * w / (FINE + abs(w))

    return {"time": by_time, "angle": by_angle, "speed": by_speed}[along]


def _carrier(carrier: str, ranges: Mapping[str, tuple[float, float]]) -> Kernel:
    if carrier in ("one", "dry"):
        return one if carrier == "one" else dry
    return _over(max(map(abs, ranges[carrier])), carrier == "angle")


def _fixed(terms: Sequence[Term], ranges: Mapping[str, tuple[float, float]], paced: bool = False) -> Kernel:
    """The law's torque by (t, x, v, z, p, rig), its size p[0]; paced : where time and nu are stretched by p[1]."""

    def part(term: Term) -> Kernel:
        carrier, place = _carrier(term.carrier, ranges), _place(term.along, *ranges[term.along])
        c = tuple(map(float, term.coefficients))
        is_dry = term.carrier == "dry"

        @lane
        def value(t, x, v, z, p, rig):
            return p[0] * carrier(x, v, rig) * series(place(t, x, v), c)

        @lane
        def paced_value(t, x, v, z, p, rig):
            w = v * p[1]
            return p[0] * carrier(x, v if is_dry else w, rig) * series(place(t / p[1], x, w), c)

        return paced_value if paced else value

    return reduce(plus, [part(term) for term in terms])


def free_law(terms: Sequence[Term], ranges: Mapping[str, tuple[float, float]], directions: Array) -> Kernel:
    """The same while it is learnt: coefficients are p times directions (MOST_DIRECTIONS, terms * ORDER)."""

    def part(k: int, term: Term) -> Kernel:
        carrier, place = _carrier(term.carrier, ranges), _place(term.along, *ranges[term.along])
        m = tuple(tuple(map(float, row)) for row in directions[:, k * ORDER : (k + 1) * ORDER].T)

        @lane
        def value(t, x, v, z, p, rig):
            c = (
                mixed(p, m[0]), mixed(p, m[1]), mixed(p, m[2]), mixed(p, m[3]), mixed(p, m[4]), mixed(p, m[5]),
                mixed(p, m[6]), mixed(p, m[7]), mixed(p, m[8]), mixed(p, m[9]), mixed(p, m[10]), mixed(p, m[11]),
            )  # fmt: skip
            return carrier(x, v, rig) * series(place(t, x, v), c)

        return value

    return reduce(plus, [part(k, term) for k, term in enumerate(terms)])


def variant_of(
    name: str, site: str, bodies: str, law: Kernel, terms: Sequence[Term], parameters: tuple[EffectParameter, ...],
    starts: tuple[tuple[float, ...], ...], formula: str,
) -> Variant:  # fmt: skip
    """A law as a formula of an effect."""
    return Variant(
        name=name,
        formula=formula,
        parameters=parameters,
        torque=at_site(site, bodies, law),
        couples="interface" if site == "interface" else "bodies",
        timed=any(t.along == "time" for t in terms),
        starts=starts,
        uncoupled=site in ("ground1", "bearings"),
    )


# Files ----------------------------------------------------------------------------------------------------------------


def written(law: Law) -> str:
    """The law as the text of its file, TOML, with a checksum in its last line."""

    def row(values: Sequence[float]) -> str:
        return "[" + ", ".join(f"{x:.9e}" for x in values) + "]"

    rig = law.rig or {}
    units = ("N", "m", "m/s") if rig.get("kind") == "translational" else ("N m", "rad", "rad/s")
    lines = [
        "# A law of torque that `bayes-damper diagnose` learnt. Use it: --effects THIS_FILE --effect " + law.name,
        "# Q = sum of carrier * (Chebyshev series at u); beyond a range its last value is held. Angle, time: u from -1",
        f"# to 1 over the range; speed: u = {1.0 + FINE} w / ({FINE} + |w|), w = speed over its largest in the range",
        f'schema = "{SCHEMA}"',
        f'site = "{law.site}"',
        f'bodies = "{law.bodies}"',
        f"campaign = {_quoted(law.campaign)}",
        f"beside = [{', '.join(map(_quoted, law.beside))}]",
        f'units = ["{units[0]}", "{units[1]}", "{units[2]}", "s"]',
        f"nu = {law.nu:.9e}",
    ]
    if law.closes is not None:
        lines.append(f"closes = {row(law.closes)}  # share of the gap on held-out trials, 90 % interval")
    if law.shape_only is not None:
        lines.append(f"shape_only = {law.shape_only:.4g}  # probability that no short formula stands for it")
        lines += ["formulas = [", *(f"    [{_quoted(words)}, {p:.4g}]," for words, p in law.formulas), "]"]
    lines += ["", "[rig]", *(f"{k} = {_quoted(v) if isinstance(v, str) else repr(float(v))}" for k, v in rig.items())]
    nominal = law.nominal or {}
    lines += ["", "[nominal]", *(f"{_quoted(k)} = {float(v):.9e}" for k, v in nominal.items())] if nominal else []
    lines += ["", "[ranges]", *(f"{name} = {row(bounds)}" for name, bounds in law.ranges.items())]
    for k, term in enumerate(law.terms):
        own = [r[k * ORDER : (k + 1) * ORDER] for r in law.roots]
        lines += [
            "", "[[term]]", f'carrier = "{term.carrier}"', f'along = "{term.along}"',
            f"coefficients = {row(term.coefficients)}", "roots = [", *(f"    {row(r)}," for r in own), "]",
        ]  # fmt: skip
    text = "\n".join(lines) + "\n"
    return f'{text}\n[check]\nsha256 = "{_checksum(text)}"\n'


def _quoted(text: str) -> str:
    escaped = "".join(c if c.isprintable() and c not in '"\\' else " " for c in text)
    return f'"{escaped}"'


def _checksum(text: str) -> str:
    return hashlib.sha256("\n".join(line.rstrip() for line in text.strip().splitlines()).encode()).hexdigest()


def is_law(path: Path) -> bool:
    """Whether a TOML file says that it is a learnt law; others may lie beside one."""
    try:
        return b"bayes-damper/law/" in file_bytes(path, most=LARGEST_TOML)
    except (InputError, FileNotFoundError):
        return False


def read_law(path: str | Path) -> Law:
    """The law of a file.

    Raises
    ------
    InputError
        if the file cannot be read, is no such file, was changed after it was written, or holds impossible numbers.
    """
    path = Path(path)
    again = "write it anew: bayes-damper diagnose CAMPAIGN, folder learnt/"
    try:
        text = text_of(file_bytes(path, remedy=again, most=LARGEST_TOML), str(path))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; {again}") from None
    held = toml_of(text, str(path))
    if held.get("schema") != SCHEMA:
        raise InputError(f'{path}: is no learnt law (schema = "{SCHEMA}" is missing); {again}')
    body, _, _ = text.partition("[check]")
    check = held.get("check")
    if check is not None and (not isinstance(check, dict) or check.get("sha256") != _checksum(body)):
        raise InputError(
            f"{path}: was changed after it was written, so its numbers are no longer what was learnt; {again}, or, "
            "if the change is meant, delete its table [check]"
        )
    try:
        return _law(held, str(path))
    except InputError as error:
        raise InputError([f"{fault}; {again}" for fault in error.faults]) from None


_TERM_TYPES = {"carrier": (str,), "along": (str,), "coefficients": (list,), "roots": (list,)}


def _law(held: Mapping[str, Any], where: str) -> Law:
    types: dict[str, tuple[type, ...]] = {
        "site": (str,), "bodies": (str,), "ranges": (dict,), "nu": (float, int), "term": (list,), "rig": (dict,),
        "campaign": (str,), "beside": (list,),
    }  # fmt: skip
    remedy = "this is not what diagnose writes"
    own = fields(held, types, where, remedy)
    if own["site"] not in SITES or own["bodies"] not in ("both", "primary"):
        raise InputError(f"{where}: site {shown(own['site'])}, bodies {shown(own['bodies'])}: {remedy}")
    ranges = {}
    for name in COORDINATES:
        low, high = _numbers(own["ranges"].get(name), f"{where}: range of {name}", 2)
        if not low < high:
            raise InputError(f"{where}: range of {name} must rise, not {low:g} to {high:g}")
        ranges[name] = (low, high)
    if not 1 <= len(own["term"]) <= MOST_TERMS:
        raise InputError(f"{where}: holds {len(own['term'])} terms; 1 to {MOST_TERMS} are possible")
    terms, roots = [], []
    for k, part in enumerate(own["term"], 1):
        here = f"{where}: term {k}"
        entry = fields(part, _TERM_TYPES, here, remedy)
        if entry["carrier"] not in CARRIERS or entry["along"] not in COORDINATES:
            raise InputError(f"{here}: carrier {shown(entry['carrier'])}, along {shown(entry['along'])}: {remedy}")
        terms.append(
            Term(entry["carrier"], entry["along"], _numbers(entry["coefficients"], f"{here}: coefficients", ORDER))
        )
        roots.append([_numbers(r, f"{here}: roots", ORDER) for r in entry["roots"]])
    if len({len(r) for r in roots}) > 1 or len(roots[0]) > 10 * MOST_DIRECTIONS:
        raise InputError(f"{where}: terms have roots of different number: {remedy}")
    rig = fields(own["rig"], {"kind": (str,), "J1": (float, int)}, f"{where}: [rig]", remedy)
    if "J2" in own["rig"]:
        rig = {**rig, "J2": own["rig"]["J2"]}
    rig = {k: v if isinstance(v, str) else real(v, f"{where}: {k}") for k, v in rig.items()}
    closes = held.get("closes")
    nu = real(own["nu"], f"{where}: nu")
    formulas = _formulas(held.get("formulas", []), where)
    only = held.get("shape_only")
    nominal = held.get("nominal")
    if nominal is not None and not isinstance(nominal, dict):
        raise InputError(f"{where}: nominal = {shown(nominal)} is no table: {remedy}")
    return Law(
        own["site"], own["bodies"], ranges, nu, tuple(terms),
        tuple(tuple(sum(r, ())) for r in zip(*roots, strict=True)), rig, own["campaign"],
        tuple(map(str, own["beside"])),
        None if closes is None else _numbers(closes, f"{where}: closes", 3),  # type: ignore[arg-type]
        None if nominal is None else {k: real(v, f"{where}: {k}") for k, v in nominal.items()}, formulas,
        None if only is None else real(only, f"{where}: shape_only"),
    )  # fmt: skip


def _formulas(held: object, where: str) -> tuple[tuple[str, float], ...]:
    """Formulas with their probabilities."""
    out = []
    for row in held if isinstance(held, list) else [held]:
        if not (isinstance(row, list) and len(row) == 2 and isinstance(row[0], str)):
            raise InputError(f"{where}: formulas = {shown(held)} must be pairs of a formula and its probability")
        out.append((row[0], real(row[1], f"{where}: probability of {row[0][:60]}")))
    return tuple(out)


def _numbers(value: object, where: str, count: int) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{where} must be {count} numbers, not {shown(value)}")
    out = tuple(float(x) if isinstance(x, int | float) and not isinstance(x, bool) else math.nan for x in value)
    if not all(math.isfinite(x) and abs(x) < 1e12 for x in out):
        raise InputError(f"{where} must be {count} finite numbers, not {shown(value)}")
    return out
