"""Draws of the rig's parameters for a tuning: from a fit's folder, a published case or anyone's numbers."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_damper.campaign import Campaign
from bayes_damper.errors import InputError, as_written
from bayes_damper.published.measurements import load_published
from bayes_damper.published.sources import is_published, unchanged
from bayes_damper.rig.parameters import OF_EFFECT, unit_of
from bayes_damper.runs.json_files import folder_name, read_json
from bayes_damper.sampling import arviz_adapter
from bayes_damper.text import misses

Array = NDArray[np.float64]
Draws = Mapping[str, Array]
SETUP = {
    "J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0,
    "mu": 0.0, "drag": 0.0, "nu": 50.0, "tail": 0.0,
}  # fmt: skip
"""What stands in where the posterior has no such parameter (thesis, pp. 9, 24, 27; R and r are working values)."""
LINEAR = ("J1", "J2", "k1t", "c1t", "c3t", "k2t", "c2t")
NONLINEAR = (*LINEAR, "mu", "drag", "nu", "tail", "N0", "R", "r")
SIZE = f"{OF_EFFECT}size"
"""Under this name a fit stores the size of a learnt law."""
AMPLITUDES = (0.02, 0.05, 0.1, 0.2)  # N m
"""Exciting torques of the thesis's rig, and of draws whose campaign is not known."""
OF_RELEASE = (0.025, 0.06, 0.12, 0.24)
"""Exciting torques (forces) of another rig, as shares of k1t theta0, which held it before the release."""
_MISSES = "the fit of case {} misses something of the rig{}, so that the loss may be off by more than its interval says"
_REMEDY = ": run `bayes-damper diagnose`, and tune the fit with the effect that it names"
_WITHOUT_LIMIT = 1e9  # m: a face so large that the pull does not fall with the overlap
_NO_RADIUS = 1.0  # m: bar_radius where forces between the bodies are given as torques


def complete(
    draws: Mapping[str, ArrayLike], case: str = "IV", rig: Mapping[str, float] | None = None
) -> dict[str, Array]:
    """Draws of every parameter that the models need, each (n,).

    What the draws do not hold comes from `rig` (constants of a rig of one's own, SI), else from the published set-up:
    k1t from the thesis's `case`, c3t from c1t.

    Raises
    ------
    InputError
        if a value has no physical meaning, lengths differ, or nothing gives k1t.
    """
    constants = dict(rig or {})
    unknown = sorted(set(constants) - set(NONLINEAR))
    if unknown:
        raise InputError(f"rig: {unknown[0]!r} is no constant of the rig; it may hold {', '.join(NONLINEAR)}")
    if "k1t" not in draws and "k1t" not in constants:
        cases = load_published().cases
        if case not in cases:
            raise InputError(
                f"case {case!r}: the draws hold no k1t, and the thesis has no such case (it has {', '.join(cases)}); "
                "give k1t among the constants of the rig"
            )
        constants["k1t"] = cases[case].k1t
    c1t = draws.get("c1t", constants.get("c1t", 0.0109))
    given: dict[str, ArrayLike] = {**SETUP, "c1t": c1t, "c3t": c1t, "k2t": 0.0, "c2t": 0.0, **constants}
    given |= {name: draws[name] for name in NONLINEAR if name in draws}
    try:
        columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(given[name], dtype=np.float64)) for name in NONLINEAR))
    except ValueError:
        lengths = ", ".join(f"{k} {np.size(v)}" for k, v in given.items() if np.size(v) > 1)
        raise InputError(
            f"the draws have different lengths ({lengths}); give one value of every parameter per draw"
        ) from None
    out = {name: column.ravel().copy() for name, column in zip(NONLINEAR, columns, strict=True)}
    positive = ("J1", "J2", "k1t", "nu", "R", "r")
    faults = [
        f"{name}: the posterior holds values down to {out[name].min():g}; they must be "
        f"{'above zero' if name in positive else 'at least zero'}"
        for name in NONLINEAR
        if name != "tail" and not np.all((out[name] > 0.0) if name in positive else (out[name] >= 0.0))
    ]
    if faults:
        raise InputError(faults)
    return out


def posterior_draws(
    source: Mapping[str, ArrayLike] | Path | str,
    case: str,
    n: int,
    rng: np.random.Generator,
    rig: Mapping[str, float] | None = None,
) -> dict[str, Array]:
    """`n` draws of one case from arrays, from the `posterior.nc` of a fit, or from its `summary.json`.

    A summary knows no correlations: each parameter is then drawn by itself, log-normal with its mean and sd, or normal
    where it can have either sign. The numbers of a fit's effect are among the draws, as `effect.NAME`.
    """
    stored = source if isinstance(source, Mapping) else _stored(Path(source), case, n, rng)
    full = complete(stored, case, rig)
    full |= {
        name: np.broadcast_to(np.asarray(x, float), full["J1"].shape)
        for name, x in stored.items()
        if name.startswith(OF_EFFECT)
    }
    size = len(full["J1"])
    pick = rng.permutation(size)[:n] if size >= n else rng.integers(size, size=n)
    if size == 1:
        pick = np.zeros(1, int)
    return {name: column[pick] for name, column in full.items()}


@dataclass(frozen=True)
class Origin:
    """Where draws come from: name of the campaign, its checksum, and the rig's constants that are not among them.

    kind : of the rig; amplitudes : torques (N m; forces, N) that suit its size; converged : whether the fit of the case
    did, True where nothing says; known : what is odd in the records that were fitted, as `check` lists it; warnings :
    of the fit and of the tuning; effect, formula : that the fit has beside the nominal model, "A+B" of two, or "";
    reach : how far the primary moves in the records of the fit, rad (m), None where they are not known; radius :
    whether the rig has a radius that can be chosen.
    """

    campaign: str = ""
    sha256: str | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    kind: str = "torsional"
    amplitudes: tuple[float, ...] = AMPLITUDES
    converged: bool = True
    known: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    effect: str = ""
    formula: str = ""
    reach: float | None = None
    radius: bool = True

    @property
    def effort(self) -> tuple[str, str]:
        """What excites the rig, and its unit."""
        return ("force", "N") if self.kind == "translational" else ("torque", "N m")


def chosen_case(source: Mapping[str, ArrayLike] | Path | str, case: str | None) -> str:
    """The case to tune: the one that was named, else the only one of the fit, else IV.

    Raises
    ------
    InputError
        if the fit has no such case.
    """
    file = None if isinstance(source, Mapping) else Path(source) / "summary.json"
    summary = read_json(file) if file is not None and file.is_file() else {}
    with as_written(str(file), "fit"):
        cases = dict(summary.get("cases") or {})
        known = [*cases, *(["joint"] if cases and summary.get("joint") else [])]
    wanted = case or (next(iter(cases)) if len(cases) == 1 else "IV")
    if known and wanted not in known:
        which = f"has no case {wanted!r}" if case else "has several cases"
        names, every = ", ".join(map(shlex.quote, known)), "; joint: all cases together" if "joint" in known else ""
        raise InputError(f"{source}: {which}; name one of {names} (--case{every})")
    return wanted


def origin_of(
    source: Mapping[str, ArrayLike] | Path | str, case: str, known: Mapping[str, float] | None = None
) -> Origin:
    """The campaign that a fit's folder belongs to; nothing for arrays.

    The constants of a recorded campaign that were not inferred stand in its files, which must be where they were; those
    that are `known` (SI) already are taken as they are.

    Raises
    ------
    InputError
        if the campaign has changed, or its rig is one that the equations of tuning do not know.
    """
    if isinstance(source, Mapping):
        return Origin()
    folder = Path(source)
    if not (folder / "run.json").is_file():
        return Origin()
    summary = read_json(folder / "summary.json") if (folder / "summary.json").is_file() else {}
    with as_written(folder, "fit"):
        plan = dict(read_json(folder / "run.json").get("plan", {}))
        entry = summary.get("joint") if case == "joint" else (summary.get("cases") or {}).get(case)
        warned, n = summary.get("warnings", ()), int(summary.get("warnings_of_check", 0))
        about: dict[str, Any] = {
            "campaign": str(plan.get("name", "")),
            "sha256": plan.get("campaign_sha256"),
            "converged": bool((entry or {}).get("converged", True)),
            "effect": str(plan.get("effect") or ""),
            "formula": str(((entry or {}).get("best_fit") or {}).get("formula") or ""),
            "known": tuple(map(str, warned[:n])),
            "warnings": (
                *((_missing(case, plan.get("effect")),) if (entry and misses(entry)) else ()),
                *map(str, warned[n:]),
            ),
        }
    if plan.get("campaign") is None or is_published(plan["campaign"]):
        return Origin(**about)
    campaign = unchanged(str(plan["campaign"]), plan.get("campaign_sha256"), "it was fitted; fit it again")
    rig = campaign.rig
    if rig.ground2_stiffness.value or rig.inertial_coupling.value or rig.restoring != "linear":
        raise InputError(
            f"{campaign.name}: tune knows no spring from the secondary to ground, no inertial coupling and no "
            "pendulum, but this rig has one of them; pass draws as arrays if it can be neglected"
        )
    constants = _constants_of(campaign, plan.get("normal_force") or rig.normal_force, case, known or {})
    reached, held = _swings(campaign, case)
    return Origin(
        **about,
        constants=constants,
        kind=rig.kind,
        amplitudes=_suitable(held),
        reach=max(reached, default=None),
        radius=rig.kind == "torsional" and (rig.has_magnet or constants["R"] != _NO_RADIUS),
    )


def _constants_of(campaign: Campaign, law: str, case: str, known: Mapping[str, float]) -> dict[str, float]:
    """The constants of a campaign's rig not inferred, those that are `known` as they are; law : of the pull."""
    rig = campaign.rig
    fields = {"J1": rig.primary_inertia, "J2": rig.secondary_inertia, "R": rig.bar_radius, "r": rig.magnet_radius,
              "N0": rig.magnet_pull}  # fmt: skip
    constants = {name: constant.value for name, constant in fields.items() if constant is not None}
    if not rig.has_magnet:
        constants = {"R": _NO_RADIUS, "r": _WITHOUT_LIMIT, "mu": 0.0, "N0": 0.0} | constants
    if law == "constant":
        constants["r"] = _WITHOUT_LIMIT
    constants |= known
    if "J2" not in constants:
        raise InputError(
            f"{campaign.name}: the rig has no secondary_inertia and no coupled trials, so nothing says how a second "
            "body would be coupled; fit coupled trials, or pass draws as arrays"
        )
    springs = dict.fromkeys(t.k1t.value for t in campaign.trials if case in ("joint", t.case))
    if "k1t" not in constants and len(springs) > 1:
        listed = ", ".join(f"{k:g}" for k in springs)
        unit = unit_of("k1t", rig.kind)
        raise InputError(f"case {case!r} has several springs ({listed} {unit}): name one case, or give k1t in `rig`")
    return ({"k1t": next(iter(springs))} if springs else {}) | constants


def _missing(case: str, effect: str | None) -> str:
    """That a fit misses something, with an effect or without."""
    return _MISSES.format(case, f" beside {effect.replace('+', ' and ')}" if effect else "") + (
        "" if effect else _REMEDY
    )


def _swings(campaign: Campaign, case: str) -> tuple[list[float], list[float]]:
    """How far the primary moves in each trial of a case, rad (m), and the torque (force) that holds it there.

    From where it is released; where no release is declared, as the readings imply: the third largest, and for the
    torque a swing that one in a hundred exceeds.
    """
    reached, held = [], []
    for t in campaign.trials:
        if case not in ("joint", t.case):
            continue
        pace = math.sqrt(t.k1t.value / campaign.rig.primary_inertia.value)
        scale = {"acceleration": pace**2, "velocity": pace, "displacement": 1.0}[campaign.measurement.quantity]
        size = np.sort(np.abs(t.channels[0][np.isfinite(t.channels[0])])) / scale
        released = abs(t.theta0.value) if t.theta0 is not None else 0.0
        reached.append(released or float(size[-min(3, size.size)]))
        held.append(t.k1t.value * (released or float(np.quantile(size, 0.99))))
    return reached, held


def _suitable(held: Sequence[float]) -> tuple[float, ...]:
    """Exciting torques (forces) of the size of a rig: shares of what held it before the releases, two digits each."""
    largest = float(np.median(held)) if held else 0.0
    return tuple(float(f"{share * largest:.2g}") for share in OF_RELEASE) if largest > 0.0 else AMPLITUDES


def _stored(folder: Path, case: str, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Draws of one case from the files of a fit: its own posterior, else its numbers in summary.json."""
    for place in (folder / folder_name(case), folder):
        file = place / "posterior.nc"
        if file.is_file() and (draws := _draws_of_file(file, case)):
            return draws
    summary = read_json(folder / "summary.json")
    draws = {}
    with as_written(folder / "summary.json", "fit"):
        cases = {**summary["cases"], "joint": summary.get("joint")}
        if cases.get(case) is None:
            known = ", ".join(summary["cases"]) or "none"
            raise InputError(f"{folder / 'summary.json'}: has no case {case!r}; it has {known}")
        table = cases[case]["parameters"]
        for name, stored in _entries(table, case).items():
            mean, sd = float(table[stored]["mean"]), float(table[stored]["sd"])
            s2 = math.log1p((sd / mean) ** 2) if mean > 0.0 else 0.0
            z = rng.standard_normal(n)
            signed = (name == "tail" or name.startswith(OF_EFFECT)) and mean - 4.0 * sd < 0.0
            draws[name] = mean + sd * z if signed else mean * np.exp(math.sqrt(s2) * z - 0.5 * s2)
    return draws


def _draws_of_file(file: Path, case: str) -> dict[str, Array]:
    """The parameters of a posterior in netCDF, chains one after another; nothing where it holds several cases."""
    with arviz_adapter.opened(file) as root:
        group = root["posterior"] if "posterior" in root.groups else root
        if "case" in group.dimensions:
            return {}
        names = _entries(group.variables, case)
        return {name: np.asarray(group.variables[n][...], dtype=np.float64).ravel() for name, n in names.items()}


def _entries(stored: Iterable[str], case: str) -> dict[str, str]:
    """Name of each parameter -> the name under which a fit stored it: one spring of several is `k1t[6.2]`.

    Raises
    ------
    InputError
        if the fit of all cases together has a value of a parameter for each of them.
    """
    out = {}
    for name in (*NONLINEAR, *dict.fromkeys(s.partition("[")[0] for s in stored if s.startswith(OF_EFFECT))):
        own = [s for s in stored if s.partition("[")[0] == name]
        if len(own) == 1:
            out[name] = own[0]
        elif own and name != "k1t":
            raise InputError(
                f"case {case!r}: the fit has several values of {name} ({', '.join(own)}); name one case (--case)"
            )
    return out
