"""Prior files: what is assumed about each parameter before the data, with its unit, its reason and its source.

A TOML file has one entry per parameter. An entry is a number (fixed), a name (tied to that parameter), a pair
(uniform) or a table with `dist` and its numbers; `cases` in a table gives numbers of their own to single cases. Nothing
in a file is evaluated as code, and every fault of a file is reported at once.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from bayes_damper.campaign import Campaign
from bayes_damper.errors import InputError
from bayes_damper.inputs import collected, real, shipped_path, shown, toml_file
from bayes_damper.priors import limits
from bayes_damper.priors.distributions import (
    Distribution,
    HalfNormal,
    LogNormal,
    LogScale,
    LogStudent,
    LogUniform,
    Normal,
    Uniform,
    median,
    to_standard,
)
from bayes_damper.rig.parameters import PARAMETERS, hint, unit_of

Array = NDArray[np.float64]
LEVELS = ("campaign", "case", "trial")
_NUMBERS = {
    "normal": (("mean", "sd"), ("lower", "upper")),
    "lognormal": (("median", "factor"), ()),
    "logstudent": (("median", "factor"), ()),
    "halfnormal": (("sd",), ()),
    "uniform": (("lower", "upper"), ()),
    "loguniform": (("lower", "upper"), ()),
    "fixed": (("value",), ()),
}
_WORDS = ("unit", "dist", "level", "reason", "source", "cases", "to")
_CONVERSIONS = {("deg", "rad"): math.pi / 180.0, ("ms", "s"): 1e-3, ("mm", "m"): 1e-3}
_HEAD = ("name", "description")
RECORDED = ("mu", "k2t", "c2t", "drag", "nu", "tail", "c1t", "c3t", "theta0", "delay", "sigma1", "sigma2")
"""What the prior file of a recorded campaign may speak of. Each has a default there, scaled to the rig."""
_ELSEWHERE = {
    "J1": "primary_inertia in campaign.toml", "J2": "secondary_inertia in campaign.toml",
    "J12": "inertial_coupling in campaign.toml", "R": "bar_radius in campaign.toml",
    "r": "magnet_radius in campaign.toml", "N0": "magnet_pull in campaign.toml",
    "k3t": "ground2_stiffness in campaign.toml", "k1t": "the columns of k1t in trials.csv",
}  # fmt: skip


_NEVER_NEGATIVE = {
    "mu": "a coefficient of friction", "drag": "a drag torque", "c1t": "a damping", "c2t": "a damping",
    "c3t": "a damping", "nu": "the sharpness of a friction", "sigma1": "a noise", "sigma2": "a noise",
}  # fmt: skip
_NEVER_ZERO = ("nu", "sigma1", "sigma2")
_OUTSIDE = 0.01  # share of a prior that may lie where nu or a noise cannot be: what is cut at 8 sd, say


@dataclass(frozen=True)
class Prior:
    """One entry: `value` is a distribution (free), a number (fixed) or a name (tied); in SI units.

    None stands for the default of a recorded campaign. cases : the values of single cases, where they differ.
    """

    name: str
    value: Distribution | float | str | None
    unit: str
    level: str = "campaign"
    reason: str = ""
    source: str = ""
    cases: Mapping[str, Distribution | float] = field(default_factory=dict)


@dataclass(frozen=True)
class PriorSet:
    """The priors of a model's parameters, in the order of the file.

    `free`, `fixed` and `tied` are what posterior.Coordinates takes. Where entries have values per case, take
    `for_case` first: until then the set has no density.
    """

    name: str
    entries: Mapping[str, Prior]
    description: str = ""

    @property
    def free(self) -> dict[str, Distribution]:
        """Free parameters with their distributions.

        Raises
        ------
        InputError
            if an entry only has values per case.
        """
        result: dict[str, Distribution] = {}
        for name, entry in self.entries.items():
            if not isinstance(entry.value, float | str | None):
                result[name] = entry.value
            elif isinstance(entry.value, str) and not entry.value:
                raise InputError(f"priors {self.name!r}: {name} has a prior per case; choose the case first")
        return result

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed parameters with their values."""
        return {name: entry.value for name, entry in self.entries.items() if isinstance(entry.value, float)}

    @property
    def tied(self) -> dict[str, str]:
        """Tied parameters with the names of those whose values they take."""
        return {
            name: entry.value for name, entry in self.entries.items() if isinstance(entry.value, str) and entry.value
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters: the order of the unit cube's dimensions."""
        return tuple(self.free)

    def level(self, name: str) -> str:
        """Whether there is one value per "campaign", per "case" or per "trial"; a tied parameter follows its other."""
        other = self.tied.get(name)
        return self.entries[other or name].level

    def for_case(self, case: str) -> PriorSet:
        """The priors of one case.

        Raises
        ------
        InputError
            if an entry has values per case, but none for this one.
        """
        faults, entries = [], {}
        for name, entry in self.entries.items():
            if case in entry.cases:
                entry = replace(entry, value=entry.cases[case], cases={})  # noqa: PLW2901 - the entry of this case
            elif entry.value == "":
                faults.append(
                    f"priors {self.name!r}: {name} has no prior for case {case!r}, only for "
                    f"{', '.join(entry.cases)}; add cases.{case} to its entry"
                )
            entries[name] = replace(entry, cases={})
        if faults:
            raise InputError(faults)
        return replace(self, entries=entries)

    def only(self, names: Iterable[str]) -> PriorSet:
        """The entries of some parameters; one that a tied entry needs comes along."""
        wanted = set(names)
        wanted |= {other for name, other in self.tied.items() if name in wanted}
        return replace(self, entries={n: e for n, e in self.entries.items() if n in wanted})

    def replace(self, **changes: Distribution | float | str) -> PriorSet:
        """The same priors with some entries changed: a distribution (free), a number (fixed) or a name (tied).

        Raises
        ------
        InputError
            if a name is no parameter or an entry is tied to one that is not there.
        """
        entries = dict(self.entries)
        faults = []
        for name, value in changes.items():
            old = entries.get(name)
            if old is None and name not in PARAMETERS:
                faults.append(f"{name!r} is no parameter; {hint(name, PARAMETERS)}")
                continue
            old = old or Prior(name, 0.0, PARAMETERS[name].unit)
            value = float(value) if isinstance(value, int | float) else value  # noqa: PLW2901 - 1 is 1.0
            entries[name] = replace(old, value=value, cases={}, reason="changed by the caller", source="")
        faults += _tie_faults(self.name, entries)
        if faults:
            raise InputError(faults)
        return replace(self, entries=entries)

    def widened(self, factor: float) -> PriorSet:
        """Every free prior with its width times `factor`, its median (uniform: its centre) kept: for sensitivity."""
        entries = {
            name: replace(
                entry,
                value=entry.value if isinstance(entry.value, float | str | None) else _widen(entry.value, factor),
                cases={c: v if isinstance(v, float) else _widen(v, factor) for c, v in entry.cases.items()},
            )
            for name, entry in self.entries.items()
        }
        return replace(self, entries=entries)

    def log_density(self, values: Mapping[str, ArrayLike]) -> Array:
        """Log prior density of the free parameters at values name -> (n,) or scalar; -inf outside the support.

        Raises
        ------
        InputError
            if a free parameter has no value.
        """
        free = self.free
        missing = [name for name in free if name not in values]
        if missing:
            raise InputError(f"priors {self.name!r}: no value given for {', '.join(missing)}")
        return np.asarray(sum((prior.logpdf(values[name]) for name, prior in free.items()), np.zeros(())))

    def from_unit_cube(self, u: ArrayLike) -> dict[str, Array]:
        """All parameters (fixed and tied ones too) at points u (n, len(names)) of the unit cube: name -> (n,)."""
        u = np.atleast_2d(np.asarray(u, float))
        free = self.free
        if u.shape[1] != len(free):
            raise ValueError(f"points of the unit cube need {len(free)} columns, got {u.shape[1]}")
        values = {name: np.asarray(prior.ppf(u[:, i])) for i, (name, prior) in enumerate(free.items())}
        values |= {name: np.full(len(u), value) for name, value in self.fixed.items()}
        values |= {name: values[other] for name, other in self.tied.items()}
        return {name: values[name] for name in self.entries}

    def draw(self, rng: np.random.Generator, n: int) -> dict[str, Array]:
        """Draws of all parameters: name -> (n,)."""
        return self.from_unit_cube(rng.random((n, len(self.free))))

    def medians(self) -> dict[str, float]:
        """Prior medians of all parameters: fixed ones at their value, tied ones at that of their other."""
        values = {name: median(prior) for name, prior in self.free.items()} | self.fixed
        values |= {name: values[other] for name, other in self.tied.items()}
        return {name: values[name] for name in self.entries}

    def to_dict(self) -> dict[str, Any]:
        """A dictionary in the form of the file (SI units), for provenance; `priors_from_dict` reads it back."""
        return {"name": self.name, "description": self.description} | {
            name: _entry_table(entry) for name, entry in self.entries.items()
        }


def load_priors(
    source: str | Path = "thesis",
    *,
    base: PriorSet | None = None,
    extra: Mapping[str, str] | None = None,
    kind: str = "torsional",
    quantity: str = "acceleration",
    recorded: bool = False,
) -> PriorSet:
    """Reads a prior file: a shipped one by name ("thesis", "campaign") or any by path.

    base : priors that the file overrides entry by entry; extra : further names with their units, e.g. of effects;
    kind, quantity : of the rig and of its readings, which decide the units; recorded : the file is that of a campaign
    of recorded trials, where parameters that it does not name have defaults.

    Raises
    ------
    InputError
        with every fault of the file.
    """
    path = Path(source)
    if path.suffix != ".toml" and not path.is_file():
        shipped = {p.stem: p for p in sorted(shipped_path("priors").glob("*.toml"))}
        if str(source) not in shipped:
            raise InputError(
                f"priors {str(source)!r}: no file and none of the shipped ones; {hint(str(source), shipped)}"
            )
        path = shipped[str(source)]
    try:
        table = toml_file(path, "give a prior file")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such prior file; check the path") from None
    return priors_from_dict(table, str(path), base=base, extra=extra, kind=kind, quantity=quantity, recorded=recorded)


def campaign_priors(source: str | Path | Mapping[str, object], campaign: Campaign) -> PriorSet:
    """The prior file (or its dictionary) of a campaign of recorded trials.

    Raises
    ------
    InputError
        with every fault of the file.
    """
    kind, quantity = campaign.rig.kind, campaign.measurement.quantity
    found = (
        priors_from_dict(source, kind=kind, quantity=quantity, recorded=True)
        if isinstance(source, Mapping)
        else load_priors(source, kind=kind, quantity=quantity, recorded=True)
    )
    where = "priors" if isinstance(source, Mapping) else str(source)
    faults = [
        f"{where}: {name}: there is no case {case!r} in this campaign; {hint(case, campaign.cases)}"
        for name, entry in found.entries.items()
        for case in entry.cases
        if case not in campaign.cases
    ]
    spring = found.entries.get("k2t")
    if spring is not None and campaign.rig.ground2_stiffness.value <= 0.0 and _all_negative(spring.value):
        faults.append(
            f"{where}: k2t: negative altogether, and ground2_stiffness is 0: nothing would hold the secondary in place"
        )
    faults += limits.beyond(
        where,
        {
            n: [x for x in (e.value, *e.cases.values()) if not isinstance(x, str | None)]
            for n, e in found.entries.items()
        },
        campaign,
    )
    if faults:
        raise InputError(faults)
    return found


def _all_negative(value: Distribution | float | str | None) -> bool:
    """Whether a fixed value, or all that a prior holds possible, lies below 0."""
    if value is None or isinstance(value, str):
        return False
    return (value if isinstance(value, float) else value.support[1]) < 0.0


def priors_from_dict(
    table: Mapping[str, object],
    where: str = "priors",
    *,
    base: PriorSet | None = None,
    extra: Mapping[str, str] | None = None,
    kind: str = "torsional",
    quantity: str = "acceleration",
    recorded: bool = False,
) -> PriorSet:
    """Priors from a dictionary in the form of a file; `where` names it in messages. See `load_priors`."""
    units = {name: unit_of(name, kind, quantity) for name in PARAMETERS} | dict(extra or {})
    defaults = {name: units[name] for name in RECORDED} if recorded else {}
    faults: list[str] = []
    entries = dict(base.entries) if base else {}
    for key, entry in table.items():
        if key in _HEAD:
            if not isinstance(entry, str):
                faults.append(f"{where}: {key} must be a text, got {shown(entry)}")
        elif recorded and key in _ELSEWHERE:
            faults.append(f"{where}: {key} of a recorded campaign is given by {_ELSEWHERE[key]}; write it there")
        elif key not in units or (recorded and key not in (*RECORDED, *(extra or {}))):
            valid = [*(defaults or units), *(extra or {}), *_HEAD]
            faults.append(f"{where}: {key!r} is no parameter; {hint(key, valid)}")
        else:
            found = _Reader(where, key, units[key], faults, key in defaults).entry(entry)
            if found is not None:
                entries[key] = found
    faults += _tie_faults(where, entries, defaults, table)
    if faults:
        raise InputError(faults)
    name = table.get("name", Path(where).stem if base is None else base.name)
    return PriorSet(str(name), entries, str(table.get("description", base.description if base else "")))


def _tie_faults(
    where: str, entries: Mapping[str, Prior], defaults: Mapping[str, str] | None = None, named: Collection[str] = ()
) -> list[str]:
    """What is wrong with ties; defaults : parameters (with their unit) that need no entry to be tied to; named : all
    that have an entry, a faulty one too.
    """
    faults = []
    for name, entry in entries.items():
        if not isinstance(entry.value, str) or not entry.value:
            continue
        other = entries.get(entry.value)
        if other is None and entry.value in (defaults or {}):
            other = Prior(entry.value, None, (defaults or {})[entry.value])
        if other is None and entry.value in named:
            continue  # that entry's own fault is listed
        if other is None:
            valid = dict.fromkeys([*entries, *(defaults or {})])
            faults.append(f"{where}: {name} is tied to {entry.value!r}, which has no entry; {hint(entry.value, valid)}")
        elif entry.value == name:
            faults.append(f"{where}: {name} is tied to itself; give it a prior or another parameter")
        elif other.value == name:
            faults.append(f"{where}: {name} and {entry.value} are tied to each other; give one of them a prior")
        elif isinstance(other.value, str) and other.value:
            faults.append(f"{where}: {name} is tied to {entry.value}, which is itself tied; tie it to {other.value}")
        elif other.unit != entry.unit:
            faults.append(f"{where}: {name} ({entry.unit}) cannot be tied to {entry.value} ({other.unit})")
    return faults


class _Reader:
    """Reads one entry and collects its faults."""

    def __init__(self, where: str, key: str, unit: str, faults: list[str], default: bool = False) -> None:
        """`default` : whether a table without `dist` may stand for the default prior."""
        self.where, self.key, self.unit, self.faults, self.default = where, key, unit, faults, default

    def fault(self, what: str) -> None:
        self.faults.append(f"{self.where}: {self.key}: {what}")

    def entry(self, entry: Any) -> Prior | None:
        """A number, a name, a pair or a table; None if it is faulty."""
        before = len(self.faults)
        if isinstance(entry, bool) or not isinstance(entry, int | float | str | list | dict):
            self.fault(f"must be a number, a name, a pair or a table, got {shown(entry)}")
            return None
        if isinstance(entry, int | float):
            entry = {"dist": "fixed", "value": entry, "unit": self.unit}
        elif isinstance(entry, str):
            entry = {"dist": "tied", "to": entry}
        elif isinstance(entry, list):
            if len(entry) != 2:
                self.fault(f"a list must be a pair [lower, upper], got {len(entry)} numbers")
                return None
            entry = {"dist": "uniform", "lower": entry[0], "upper": entry[1], "unit": self.unit}
        kinds = [*_NUMBERS, "tied", *(["default"] if self.default else [])]
        bare = self.default and "level" in entry and not set(entry) - {"level", "unit", "reason", "source"}
        kind = entry.get("dist", "default" if bare else None)
        if not isinstance(kind, str) or kind not in kinds:
            there = (
                shown(kind) if "dist" in entry else f"none: the table has {', '.join(map(shown, entry)) or 'nothing'}"
            )
            self.fault(f"dist must be one of {', '.join(kinds)}, got {there}")
            return None
        required, optional = _NUMBERS.get(kind, ((), ()))
        for word in entry:
            if word not in (*_WORDS, *required, *optional):
                self.fault(f"unknown key {word!r} for dist {kind!r}; {hint(word, [*required, *optional, *_WORDS])}")
        own = self.default and self.key in ("theta0", "delay")
        level = entry.get("level", "trial" if own else "campaign")
        if not isinstance(level, str) or level not in LEVELS:
            self.fault(f"level must be one of {', '.join(LEVELS)}, got {shown(level)}")
            level = LEVELS[0]
        scale = self.scale(entry, kind)
        value: Distribution | float | str | None = None
        cases: dict[str, Distribution | float] = {}
        if kind == "tied":
            value = entry.get("to")
            if not isinstance(value, str) or not value:
                self.fault("a tied entry needs the name of the other parameter: to = NAME")
        elif kind != "default":
            value, cases = self.values(entry, kind, scale)
        elif "cases" in entry:
            self.fault("cases need a dist with numbers")
        if len(self.faults) > before or (value is None and kind != "default"):
            return None
        return Prior(
            self.key, value, self.unit, level, str(entry.get("reason", "")), str(entry.get("source", "")), cases
        )

    def scale(self, entry: Mapping[str, object], kind: str) -> float:
        """What turns the file's unit into the parameter's own."""
        if kind in ("tied", "default") and "unit" not in entry:
            return 1.0
        unit = entry.get("unit")
        if unit is None:
            self.fault(f'has no unit; write unit = "{self.unit}"')
        elif unit != self.unit:
            scale = _CONVERSIONS.get((unit, self.unit)) if isinstance(unit, str) else None
            if scale is not None:
                return scale
            self.fault(f"unit is {shown(unit)}, but this parameter is in {self.unit!r}; convert its numbers")
        return 1.0

    def values(
        self, entry: Mapping[str, object], kind: str, scale: float
    ) -> tuple[Distribution | float | str | None, dict[str, Distribution | float]]:
        """The value of all cases ("" if there are only values per case) and those of single cases."""
        required, optional = _NUMBERS[kind]
        table = entry.get("cases", {})
        if not isinstance(table, dict) or not all(isinstance(t, dict) for t in table.values()):
            self.fault("cases must be tables of numbers, e.g. cases = { I = { mean = 1.0, sd = 0.1 } }")
            return None, {}
        common = {n: entry[n] for n in (*required, *optional) if n in entry}
        cases: dict[str, Distribution | float] = {}
        for case, own in table.items():
            for word in own:
                if word not in (*required, *optional):
                    self.fault(f"case {case}: unknown key {word!r}; {hint(word, [*required, *optional])}")
            found = self.distribution(common | own, kind, scale, f"case {case}: ")
            if found is not None:
                cases[case] = found
        if table and not set(required) <= set(common):
            return "", cases
        return self.distribution(common, kind, scale, ""), cases

    def distribution(
        self, numbers: Mapping[str, object], kind: str, scale: float, prefix: str
    ) -> Distribution | float | None:
        """The distribution of these numbers, or None with the faults reported."""
        required, optional = _NUMBERS[kind]
        x: dict[str, float] = {}
        sound = True
        for name in (*required, *optional):
            number = numbers.get(name)
            if number is None:
                if name in required:
                    self.fault(f"{prefix}{kind} needs {name}")
                    sound = False
            else:
                before = len(self.faults)
                with collected(self.faults):
                    x[name] = real(number, f"{self.where}: {self.key}: {prefix}{name}", "a finite number")
                    x[name] *= 1.0 if name == "factor" else scale
                sound &= len(self.faults) == before
        if not sound:
            return None
        problem = _problem(kind, x)
        value = None if problem else _build(kind, x)
        if value is not None:
            problem = _impossible(self.key, value)
        if problem:
            self.fault(prefix + problem)
            return None
        return value


def _problem(kind: str, x: Mapping[str, float]) -> str | None:
    """What is wrong with the numbers of a distribution."""
    lower, upper = x.get("lower", -math.inf), x.get("upper", math.inf)
    if "sd" in x and x["sd"] <= 0.0:
        return f"sd must be positive, got {x['sd']:g}"
    if "factor" in x and x["factor"] <= 1.0:
        return f"factor must be above 1 (one standard deviation as a ratio), got {x['factor']:g}"
    if "median" in x and x["median"] <= 0.0:
        return f"median must be positive, got {x['median']:g}"
    if kind in ("normal", "uniform", "loguniform") and lower >= upper:
        return f"lower ({lower:g}) must be below upper ({upper:g})"
    if kind == "loguniform" and lower <= 0.0:
        return f"lower must be positive, got {lower:g}"
    if kind == "normal" and (lower > x["mean"] + 8.0 * x["sd"] or upper < x["mean"] - 8.0 * x["sd"]):
        return "lower and upper leave nothing of this normal distribution (beyond 8 sd)"
    return None


def _impossible(name: str, value: Distribution | float) -> str | None:
    """What is wrong with a value, or most values of a prior, that the parameter cannot have."""
    if name not in _NEVER_NEGATIVE:
        return None
    zero = name in _NEVER_ZERO
    range_ = f"{_NEVER_NEGATIVE[name]} is {'above 0' if zero else '0 or more'}"
    if isinstance(value, float):
        wrong = value < 0.0 or (zero and value == 0.0)
        return f"{value:g} cannot be: {range_}" if wrong else None
    low, high = value.support
    below = 1.0 if high <= 0.0 else 0.0 if low >= 0.0 else float(ndtr(to_standard(value, 0.0)))
    if below > (_OUTSIDE if zero else 0.5):
        return f"{below:.0%} of this prior lies below 0, but {range_}; cut it with lower, or take a lognormal"
    return None


def _build(kind: str, x: Mapping[str, float]) -> Distribution | float:
    if kind == "fixed":
        return x["value"]
    if kind == "normal":
        return Normal(x["mean"], x["sd"], x.get("lower", -math.inf), x.get("upper", math.inf))
    if kind == "lognormal":
        return LogNormal(x["median"], x["factor"])
    if kind == "logstudent":
        return LogStudent(x["median"], x["factor"])
    if kind == "halfnormal":
        return HalfNormal(x["sd"])
    return Uniform(x["lower"], x["upper"]) if kind == "uniform" else LogUniform(x["lower"], x["upper"])


def _widen(prior: Distribution, factor: float) -> Distribution:
    """Width times `factor`; a range that began positive stays so, because the parameter means nothing below zero."""
    if factor <= 0.0:
        raise ValueError(f"a width is changed by a positive factor, got {factor}")
    if isinstance(prior, Normal):
        return replace(prior, sd=prior.sd * factor)
    if isinstance(prior, LogScale):
        return replace(prior, factor=prior.factor**factor)
    if isinstance(prior, HalfNormal):
        return replace(prior, sd=prior.sd * factor)
    if isinstance(prior, LogUniform):
        centre, half = math.sqrt(prior.lower * prior.upper), math.sqrt(prior.upper / prior.lower) ** factor
        return LogUniform(centre / half, centre * half)
    if isinstance(prior, Uniform):
        centre, reach = 0.5 * (prior.lower + prior.upper), 0.5 * factor * (prior.upper - prior.lower)
        lower = centre - reach
        return Uniform(max(lower, 0.0) if prior.lower >= 0.0 else lower, centre + reach)
    raise TypeError(f"{type(prior).__name__} cannot be widened")


def describe(value: Distribution | float | str | None) -> dict[str, Any]:
    """A prior's value as the `dist` and numbers of a file."""
    if value is None:
        return {"dist": "default"}
    if isinstance(value, str):
        return {"dist": "tied", "to": value}
    if isinstance(value, float):
        return {"dist": "fixed", "value": value}
    if isinstance(value, Normal):
        bounds = {"lower": value.lower, "upper": value.upper}
        limits = {k: v for k, v in bounds.items() if math.isfinite(v)}
        return {"dist": "normal", "mean": value.mean, "sd": value.sd} | limits
    if isinstance(value, LogScale):
        return {"dist": type(value).__name__.lower(), "median": value.median_value, "factor": value.factor}
    if isinstance(value, HalfNormal):
        return {"dist": "halfnormal", "sd": value.sd}
    if isinstance(value, Uniform | LogUniform):
        return {"dist": type(value).__name__.lower(), "lower": value.lower, "upper": value.upper}
    raise TypeError(f"{type(value).__name__} has no form in a prior file")


def _entry_table(entry: Prior) -> dict[str, Any]:
    table = {"unit": entry.unit, "level": entry.level, "reason": entry.reason, "source": entry.source}
    cases = {case: describe(value) for case, value in entry.cases.items()}
    if entry.value == "":
        table["dist"] = next(iter(cases.values()))["dist"]
    else:
        table |= describe(entry.value)
    if cases:
        table["cases"] = {c: {k: v for k, v in t.items() if k != "dist"} for c, t in cases.items()}  # type: ignore[assignment]
    return table
