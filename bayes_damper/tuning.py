"""What a tuned damper would do, with uncertainty: insertion loss and resonance shift of a design over a posterior.

The insertion loss (eq. 24, p. 29) is 20 log10 of the primary's peak accelerance without the secondary over the peak
with it, each peak being the highest over all frequencies. Two models answer:

- the linear one (eq. 23), exactly, from k2t, c2t and the viscous bearings;
- the nonlinear one, by integrating the rig under a harmonic torque of stated amplitude until it repeats itself, and
  taking the fundamental component. Dry friction makes its loss depend on the amplitude.

A design changes the secondary's inertia J2, the magnet's stiffness k2t, the radius R at which the magnets sit, and the
magnet's pull N0. R acts through k2t = k2 R^2 (eq. 21, p. 27), through the friction torque mu N0 R, and, if a part of J2
is the bar itself, through that part, which grows with R^3.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from bayes_damper import figures, linear
from bayes_damper.campaign import Campaign, load_campaign
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.linear import LinearRig
from bayes_damper.model import Model
from bayes_damper.parameters import unit_of
from bayes_damper.provenance import provenance
from bayes_damper.published import load_published
from bayes_damper.run import folder_name, read_json, write_json
from bayes_damper.wording import counted

Array = NDArray[np.float64]
Draws = Mapping[str, Array]

SCHEMA = "bayes-damper/tune/1"
SETUP = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0, "mu": 0.0, "drag": 0.0, "nu": 50.0}
"""What stands in where the posterior has no such parameter (thesis, pp. 9, 24, 27; R and r are working values)."""
LINEAR = ("J1", "J2", "k1t", "c1t", "c3t", "k2t", "c2t")
NONLINEAR = (*LINEAR, "mu", "drag", "nu", "N0", "R", "r")
BOUNDS = {"J2": (0.1, 2.0), "k2t": (0.25, 4.0), "R": (0.5, 2.0)}
"""Where the best design is sought by default: factors on the present J2, k2t and R."""
AMPLITUDES = (0.02, 0.05, 0.1, 0.2)  # N m
"""Exciting torques of the thesis's rig, and of draws whose campaign is not known."""
OF_RELEASE = (0.025, 0.06, 0.12, 0.24)
"""Exciting torques (forces) of another rig, as shares of k1t theta0, which held it before the release."""
CURVES: Mapping[str, tuple[float, float]] = {"J2": (0.1, 2.0), "R": (0.5, 2.0)}
"""What the tuning curves go over, as factors on the rig's present J2 and R."""
_CURVE_POINTS = 25
_WITHOUT_LIMIT = 1e9  # m: a face so large that the pull does not fall with the overlap
_COMMON_HZ = 10.0  # every drive is brought to this frequency by scaling time
_PER_CYCLE = 24
_MEASURED_CYCLES = 4
_OPTIMISED_DRAWS = 100  # the search for the best design uses so many; its result is judged by all


@dataclass(frozen=True)
class Design:
    """A secondary: J2 (kg m^2), k2t (N m/rad, at the present radius), R (m), N0 (N); None leaves the posterior's.

    bar_inertia : the part of J2 that grows with R^3, kg m^2 (the thesis's bar: 2.146e-3); 0 keeps J2 whatever R.
    """

    J2: float | None = None
    k2t: float | None = None
    R: float | None = None
    magnet_pull: float | None = None
    bar_inertia: float = 0.0

    def __post_init__(self) -> None:
        faults = []
        for name, unit in (("J2", "kg m^2 (kg)"), ("R", "m")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                faults.append(f"{name} = {value:g}: a design needs a {name} above zero; give it in {unit}")
        for name, unit in (("k2t", "N m/rad (N/m)"), ("magnet_pull", "N"), ("bar_inertia", "kg m^2")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                faults.append(f"{name} = {value:g}: a design cannot have a negative {name}; give it in {unit}")
        if not faults and self.J2 is not None and self.bar_inertia > self.J2:
            faults.append(f"bar_inertia = {self.bar_inertia:g}: the bar cannot weigh more than J2 = {self.J2:g} in all")
        if faults:
            raise InputError(faults)

    def apply(self, draws: Draws) -> dict[str, Array]:
        """The draws with this secondary.

        Raises
        ------
        InputError
            if the bar's part of the inertia exceeds a draw's J2.
        """
        out = dict(draws)
        ratio = np.ones_like(draws["R"]) if self.R is None else self.R / draws["R"]
        if self.J2 is not None:
            out["J2"] = np.full_like(draws["J2"], self.J2)
        if np.any(out["J2"] < self.bar_inertia):
            raise InputError(
                f"bar_inertia = {self.bar_inertia:g}: the posterior has J2 down to {out['J2'].min():g}; the bar is a "
                "part of it"
            )
        out["J2"] = out["J2"] + self.bar_inertia * (ratio**3 - 1.0)
        if self.k2t is not None:
            out["k2t"] = np.full_like(draws["k2t"], self.k2t)
        out["k2t"] = out["k2t"] * ratio**2
        out["R"] = draws["R"] * ratio
        if self.magnet_pull is not None:
            out["N0"] = np.full_like(draws["N0"], self.magnet_pull)
        return out

    def to_json(self) -> dict[str, float | None]:
        return asdict(self)


# Draws ------------------------------------------------------------------------------------------------------------


def complete(
    draws: Mapping[str, ArrayLike], case: str = "IV", rig: Mapping[str, float] | None = None
) -> dict[str, Array]:
    """Draws of every parameter that the models need, each (n,).

    What the draws do not hold comes from `rig` (constants of a rig of one's own, SI), else from the published set-up:
    k1t from the thesis's `case`, c3t from c1t.

    Raises
    ------
    InputError
        if a value has no physical meaning, lengths differ, or nothing tells k1t.
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
        if not np.all((out[name] > 0.0) if name in positive else (out[name] >= 0.0))
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

    A summary knows no correlations: each parameter is then drawn by itself, log-normal with its mean and sd.
    """
    if isinstance(source, Mapping):
        full = complete(source, case, rig)
    else:
        full = complete(_stored(Path(source), case, n, rng), case, rig)
    size = len(full["J1"])
    pick = rng.permutation(size)[:n] if size >= n else rng.integers(size, size=n)
    if size == 1:
        pick = np.zeros(1, int)
    return {name: column[pick] for name, column in full.items()}


@dataclass(frozen=True)
class Origin:
    """Where draws come from: name of the campaign, its checksum, and the rig's constants that are not among them.

    kind : of the rig; amplitudes : torques (N m; forces, N) that suit its size; converged : whether the fit of the case
    did, True where nothing tells; warnings : what is odd in the records that were fitted; effect : that the fit has
    beside the nominal model, which tuning leaves out, or "".
    """

    campaign: str = ""
    sha256: str | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    kind: str = "torsional"
    amplitudes: tuple[float, ...] = AMPLITUDES
    converged: bool = True
    warnings: tuple[str, ...] = ()
    effect: str = ""

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
    cases = dict(summary.get("cases") or {}) if isinstance(summary, Mapping) else {}
    known = [*cases, *(["joint"] if cases and summary.get("joint") else [])]
    wanted = case or (next(iter(cases)) if len(cases) == 1 else "IV")
    if known and wanted not in known:
        which = f"has no case {wanted!r}" if case else "has several cases"
        raise InputError(f"{source}: {which}; name one of {', '.join(known)} (--case)")
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
    plan = read_json(folder / "run.json").get("plan", {})
    summary = read_json(folder / "summary.json") if (folder / "summary.json").is_file() else {}
    entry = summary.get("joint") if case == "joint" else (summary.get("cases") or {}).get(case)
    told = {
        "campaign": str(plan.get("name", "")),
        "sha256": plan.get("campaign_sha256"),
        "converged": bool((entry or {}).get("converged", True)),
        "warnings": tuple(summary.get("warnings", ())),
    }
    if plan.get("campaign") in (None, "thesis"):
        return Origin(**told)
    campaign = load_campaign(plan["campaign"])
    if campaign.sha256 != plan["campaign_sha256"]:
        raise InputError(f"{plan['campaign']}: the campaign has changed since it was fitted; fit it again")
    rig = campaign.rig
    if rig.ground2_stiffness.value or rig.inertial_coupling.value or rig.restoring != "linear":
        raise InputError(
            f"{campaign.name}: tune knows no spring from the secondary to ground, no inertial coupling and no "
            "pendulum, but this rig has one of them; pass draws as arrays if it can be neglected"
        )
    fields = {"J1": rig.primary_inertia, "J2": rig.secondary_inertia, "R": rig.bar_radius, "r": rig.magnet_radius,
              "N0": rig.magnet_pull}  # fmt: skip
    constants = {name: constant.value for name, constant in fields.items() if constant is not None}
    if not rig.has_magnet:
        constants = {"R": 1.0} | constants | {"mu": 0.0, "N0": 0.0}
    if (plan.get("normal_force") or rig.normal_force) == "constant":
        constants["r"] = _WITHOUT_LIMIT
    constants |= known or {}
    if "J2" not in constants:
        raise InputError(
            f"{campaign.name}: the rig has no secondary_inertia and no coupled trials, so nothing tells how a second "
            "body would be coupled; fit coupled trials, or pass draws as arrays"
        )
    springs = dict.fromkeys(t.k1t.value for t in campaign.trials if case in ("joint", t.case))
    if "k1t" in constants:
        pass
    elif len(springs) == 1:
        constants["k1t"] = next(iter(springs))
    elif springs:
        listed = ", ".join(f"{k:g}" for k in springs)
        unit = unit_of("k1t", rig.kind)
        raise InputError(f"case {case!r} has several springs ({listed} {unit}): name one case, or give k1t in `rig`")
    return Origin(
        **told,
        constants=constants,
        kind=rig.kind,
        amplitudes=_suitable(campaign, case),
        effect=plan.get("effect") or "",
    )


def _suitable(campaign: Campaign, case: str) -> tuple[float, ...]:
    """Exciting torques (forces) of the size of this rig: shares of what held it before the release, two digits each.

    Where no release is declared, the largest swing that the readings imply stands in for it.
    """
    held = []
    for t in campaign.trials:
        if case not in ("joint", t.case):
            continue
        pace = math.sqrt(t.k1t.value / campaign.rig.primary_inertia.value)
        reach = {"acceleration": pace**2, "velocity": pace, "displacement": 1.0}[campaign.measurement.quantity]
        swing = float(np.quantile(np.abs(t.channels[0]), 0.99)) / reach
        held.append(t.k1t.value * (abs(t.theta0.value) if t.theta0 is not None and t.theta0.value else swing))
    largest = float(np.median(held)) if held else 0.0
    return tuple(float(f"{share * largest:.2g}") for share in OF_RELEASE) if largest > 0.0 else AMPLITUDES


def _stored(folder: Path, case: str, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Draws of one case from the files of a fit: its own posterior, else its numbers in summary.json."""
    for place in (folder / folder_name(case), folder):
        file = place / "posterior.nc"
        if file.is_file() and (draws := _draws_of_file(file, case)):
            return draws
    summary = read_json(folder / "summary.json")
    try:
        table = (summary["cases"] | ({"joint": summary["joint"]} if "joint" in summary else {}))[case]["parameters"]
    except (KeyError, TypeError):
        known = ", ".join(summary.get("cases", {})) if isinstance(summary, dict) else ""
        raise InputError(f"{folder / 'summary.json'}: has no case {case!r}; it has {known or 'none'}") from None
    draws = {}
    for name, stored in _entries(table, case).items():
        mean, sd = float(table[stored]["mean"]), float(table[stored]["sd"])
        s2 = math.log1p((sd / mean) ** 2) if mean > 0.0 else 0.0
        draws[name] = mean * np.exp(math.sqrt(s2) * rng.standard_normal(n) - 0.5 * s2)
    return draws


def _draws_of_file(file: Path, case: str) -> dict[str, Array]:
    """The parameters of a posterior in netCDF, chains one after another; nothing where it holds several cases."""
    import h5netcdf

    with h5netcdf.File(file, "r") as root:
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
    for name in NONLINEAR:
        own = [s for s in stored if s.partition("[")[0] == name]
        if len(own) == 1:
            out[name] = own[0]
        elif own and name != "k1t":
            raise InputError(
                f"case {case!r}: the fit has several values of {name} ({', '.join(own)}); name one case (--case)"
            )
    return out


# The linear model -------------------------------------------------------------------------------------------------


def linear_rig(draws: Draws) -> LinearRig:
    """The linear rig of every draw: friction and drag left out."""
    return LinearRig(**{name: draws[name] for name in LINEAR})


@dataclass(frozen=True)
class Performance:
    """What a design does, per draw, each (n,): dB, Hz; NaN where damping leaves no resonance or nothing moves."""

    insertion_loss: Array
    resonance: Array
    resonance_without: Array

    @property
    def shift(self) -> Array:
        """Resonance with the secondary minus resonance without, Hz."""
        return self.resonance - self.resonance_without


def linear_performance(draws: Draws, design: Design | None = None) -> Performance:
    """Insertion loss and resonances of the linear model (eqs. 23 and 24)."""
    rig = linear_rig((design or Design()).apply(draws))
    frequency, _ = linear.uncoupled_resonance(draws["J1"], draws["k1t"], draws["c1t"])
    return Performance(linear.insertion_loss(rig), linear.resonances(rig).peak_frequency_hz, frequency)


# The nonlinear model ----------------------------------------------------------------------------------------------


def harmonic_response(
    draws: Draws, frequency_hz: ArrayLike, amplitude: float, coupled: bool = True, settle_cycles: int | None = None
) -> tuple[Array, Array]:
    """Accelerance of the nonlinear rig under a harmonic torque on the primary, by time integration from rest.

    Parameters
    ----------
    draws : complete draws, each (n,); frequency_hz : (n_frequencies,), or (n, n_frequencies) for a grid per draw.
    amplitude : of the torque, N m.
    settle_cycles : cycles left out before the fundamental component is taken over four; by default six time constants
        of the slowest decay.

    Returns
    -------
    accelerance : (n, n_frequencies), 1/(kg m^2), the primary's fundamental acceleration over the torque; NaN where the
        integration failed. unsettled : same shape, relative change of the fundamental between the first and last two of
        the measured cycles.

    Every draw and frequency becomes one vector of one simulation: with time counted in cycles of the drive, inertias
    grow with the square of the frequency, damping and the smoothing constant with the frequency, and all share one
    drive. Displacement is read, because what the samples cannot resolve is smallest there.
    """
    if not _drives(amplitude):
        raise InputError(_refused(amplitude))
    n = len(draws["J1"])
    f = np.array(np.broadcast_to(np.asarray(frequency_hz, dtype=np.float64), (n, np.shape(frequency_hz)[-1])))
    if not np.all(f > 0.0):
        raise InputError("frequency_hz: a frequency of excitation must be above zero; give it in Hz")
    cycles = (_settling(draws) if settle_cycles is None else settle_cycles) + _MEASURED_CYCLES
    times = np.arange(cycles * _PER_CYCLE) / (_PER_CYCLE * _COMMON_HZ)
    torque = amplitude * np.cos(2.0 * np.pi * _COMMON_HZ * times)
    scale = f / _COMMON_HZ
    powers = {"J1": 2, "J2": 2, "c1t": 1, "c3t": 1, "c2t": 1, "nu": 1}
    parameters: dict[str, ArrayLike] = {
        name: (np.broadcast_to(draws[name][:, None], f.shape) * scale ** powers.get(name, 0)).ravel()
        for name in NONLINEAR
    }
    parameters |= {"theta0": 0.0, "delay": 0.0}
    run = Model(coupled=coupled).simulate(parameters, times, torque=torque, quantity="displacement", threads=2)
    y = run.y[:, 0].reshape(*f.shape, -1)
    turn = np.exp(-2j * np.pi * np.arange(_MEASURED_CYCLES * _PER_CYCLE) / _PER_CYCLE)
    last = y[..., -turn.size :] * turn
    whole, half = 2.0 * last.mean(-1), turn.size // 2
    change = np.abs(last[..., :half].mean(-1) - last[..., half:].mean(-1)) * 2.0
    # Between samples the torque is linear, so its fundamental is a little below that of the cosine.
    drive = amplitude * np.sinc(1.0 / _PER_CYCLE) ** 2
    omega = 2.0 * np.pi * f
    return np.abs(whole) * omega**2 / drive, change / np.maximum(np.abs(whole), 1e-300)


def _drives(amplitude: float) -> bool:
    return math.isfinite(amplitude) and amplitude > 0.0


def _refused(amplitude: float) -> str:
    return f"amplitude = {amplitude:g}: the exciting torque (force) must be above zero; give it in N m (N)"


def _settling(draws: Draws) -> int:
    """Cycles in which a transient of the primary's own damping falls to exp(-7), within 20 and 150."""
    zeta = float(np.quantile(linear.damping_ratio(draws["c1t"], draws["k1t"], draws["J1"]), 0.1))
    return int(np.clip(math.ceil(7.0 / (2.0 * math.pi * max(zeta, 1e-3))), 20, 150))


def _grid(draws: Draws, coupled: bool) -> tuple[Array, float]:
    """Frequencies (n, m) among which a draw's highest accelerance is sought first, and their largest logarithmic step.

    Besides an even grid: where the linear model has its resonances, and that of both inertias stuck together.
    """
    own = linear.natural_frequency(draws["k1t"], draws["J1"])[:, None]
    low, high, points = (0.4, 2.0, 29) if coupled else (0.8, 1.2, 13)
    even = own * np.geomspace(low, high, points)
    if not coupled:
        return even, math.log(high / low) / (points - 1)
    likely = linear.resonances(linear_rig(draws)).frequency_hz
    stuck = linear.natural_frequency(draws["k1t"], draws["J1"] + draws["J2"])[:, None]
    extra = np.concatenate([np.where(np.isfinite(likely), likely, own), stuck], axis=1)
    return np.sort(np.concatenate([even, extra], axis=1), axis=1), math.log(high / low) / (points - 1)


def _peak(draws: Draws, amplitude: float, coupled: bool) -> tuple[Array, Array]:
    """Frequency and height of the highest accelerance of every draw: a grid, then two finer ones about its best."""
    grid, step = _grid(draws, coupled)
    edge = grid[:, -1]
    for _ in range(2):
        height, _ = harmonic_response(draws, grid, amplitude, coupled)
        best = np.take_along_axis(grid, np.argmax(np.nan_to_num(height), axis=1)[:, None], 1)
        grid = best * np.exp(np.linspace(-step, step, 9))
        step /= 4.0
    height, _ = harmonic_response(draws, grid, amplitude, coupled)
    k = np.clip(np.argmax(np.nan_to_num(height), axis=1), 1, grid.shape[1] - 2)[:, None]
    a, b, c = (np.take_along_axis(height, k + i, 1)[:, 0] for i in (-1, 0, 1))
    bend = a - 2.0 * b + c
    x = np.where(bend < 0.0, np.clip(0.5 * (a - c) / np.where(bend < 0.0, bend, -1.0), -1.0, 1.0), 0.0)
    frequency = np.take_along_axis(grid, k, 1)[:, 0] * np.exp(x * step)
    # Faces and bearings that stick leave a mass that follows the torque: highest at the end, wherever that is.
    inside = frequency < 0.98 * edge
    return np.where(inside, frequency, np.nan), np.where(inside, b - 0.25 * (a - c) * x, np.nan)


def nonlinear_performances(draws: Draws, amplitude: float, designs: Mapping[str, Design]) -> dict[str, Performance]:
    """Insertion loss and resonances of the nonlinear model of each design, under a torque of this amplitude (N m)."""
    without_frequency, without = _peak(draws, amplitude, coupled=False)
    out = {}
    for name, design in designs.items():
        frequency, height = _peak(design.apply(draws), amplitude, coupled=True)
        moving = (height > 0.0) & (without > 0.0)  # nowhere true of nan
        loss = 20.0 * np.log10(np.where(moving, without, 1.0) / np.where(moving, height, 1.0))
        out[name] = Performance(
            np.where(moving, loss, np.nan),
            np.where(moving, frequency, np.nan),
            np.where(moving, without_frequency, np.nan),
        )
    return out


# The best design --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Optimum:
    """The design of highest expected insertion loss (linear model) and what limits it."""

    design: Design
    performance: Performance
    at_bound: tuple[str, ...]

    @property
    def expected(self) -> float:
        """Mean insertion loss, dB."""
        return float(np.nanmean(self.performance.insertion_loss))


def usual_bounds(draws: Draws, names: Sequence[str] = tuple(BOUNDS)) -> dict[str, tuple[float, float]]:
    """Where the best design is sought if nothing else is said: `BOUNDS` times the rig's present medians, if not 0."""
    middle = {name: _middle(draws, name) for name in names}
    return {name: (BOUNDS[name][0] * x, BOUNDS[name][1] * x) for name, x in middle.items() if x > 0.0}


def best_design(
    draws: Draws, start: Design | None = None, bounds: Mapping[str, tuple[float, float]] | None = None
) -> Optimum:
    """Maximises the expected insertion loss of the linear model over J2, k2t and R.

    bounds : name -> lowest and highest value (SI) of those of "J2", "k2t", "R" that are free; the others stay as in
    `start`. By default all three are free within `BOUNDS` times the rig's present medians. As long as no bar grows with
    R, only k2t R^2 enters: the radius is then changed only where k2t alone does not reach far enough.
    """
    start = start or Design()
    now = {name: _middle(draws, name) for name in ("J2", "k2t", "R")}
    if bounds is None:
        bounds = usual_bounds(draws)
    faults = [f"{name}: only J2, k2t and R can be optimised; leave it out" for name in bounds if name not in now]
    faults += [
        f"{name}: its bounds {low:g} and {high:g} must be above zero and rise"
        for name, (low, high) in bounds.items()
        if not 0.0 < low < high
    ]
    if not bounds:
        faults.append("bounds: nothing is free; name at least one of J2, k2t and R")
    if faults:
        raise InputError(faults)
    box = {name: (math.log(low), math.log(high)) for name, (low, high) in bounds.items()}
    together = "k2t" in box and "R" in box and start.bar_inertia == 0.0
    if together:  # one variable stands for k2t R^2
        radius = box.pop("R")
        start = replace(start, R=None)
        reach = [2.0 * (x - math.log(now["R"])) for x in radius]
        box["k2t"] = (box["k2t"][0] + min(reach[0], 0.0), box["k2t"][1] + max(reach[1], 0.0))
    names, edges = tuple(box), np.array(list(box.values()))

    def design(x: Array) -> Design:
        found = dict(zip(names, (float(v) for v in np.exp(x)), strict=True))
        if together:
            product = found["k2t"]
            found["k2t"] = float(np.clip(product, *bounds["k2t"]))
            if found["k2t"] != product:
                found["R"] = now["R"] * math.sqrt(product / found["k2t"])
        return replace(start, **found)

    some = {name: column[:_OPTIMISED_DRAWS] for name, column in draws.items()}

    def objective(x: Array) -> float:
        loss = linear_performance(some, design(x)).insertion_loss
        known = np.isfinite(loss)
        return -float(loss[known].mean()) if known.any() else 1e3

    middle = np.clip(np.log([max(now[name], 1e-12) for name in names]), edges[:, 0], edges[:, 1])
    corners = [np.array(c) for c in itertools.product(*((0.8 * a + 0.2 * b, 0.2 * a + 0.8 * b) for a, b in edges))]
    runs = [
        minimize(objective, x, method="L-BFGS-B", bounds=edges, options={"maxiter": 40}) for x in (middle, *corners)
    ]
    best = min(runs, key=lambda run: float(run.fun))
    found = design(np.asarray(best.x, dtype=np.float64))
    near = 1e-3 * (edges[:, 1] - edges[:, 0])
    at_bound = tuple(
        "k2t R^2" if together and name == "k2t" else name
        for i, name in enumerate(names)
        if not edges[i, 0] + near[i] < best.x[i] < edges[i, 1] - near[i]
    )
    return Optimum(found, linear_performance(draws, found), at_bound)


# What the answer hangs on -----------------------------------------------------------------------------------------


def shares_of_variance(draws: Draws, answer: Array) -> dict[str, float]:
    """Share of the answer's variance that each parameter explains by itself, highest first.

    By regression on a cubic in the parameter's rank: between 0 and 1; correlated parameters share what they explain.
    Parameters that do not vary, or are tied to an earlier one, are left out.
    """
    known = np.isfinite(answer)
    out: dict[str, float] = {}
    for name in NONLINEAR:
        x = draws[name][known]
        tied = any(np.array_equal(draws[other], draws[name]) for other in out)
        if tied or x.size < 20 or np.ptp(x) <= 1e-12 * np.abs(x).max():
            continue
        rank = (np.argsort(np.argsort(x)) + 0.5) / x.size
        basis = np.vander(2.0 * rank - 1.0, 4)
        y = answer[known] - answer[known].mean()
        fit = basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        total = float(np.mean(y**2))
        out[name] = float(np.clip(1.0 - np.mean((y - fit) ** 2) / total, 0.0, 1.0)) if total > 0.0 else 0.0
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def _middle(draws: Draws, name: str) -> float:
    return float(np.median(draws[name]))


@dataclass(frozen=True)
class Curve:
    """Insertion loss of the linear model over one quantity of the design: its values (n,), mean and central 90 % of the
    loss in dB, and the probability of the target, each (n,).
    """

    values: Array
    mean: Array
    low: Array
    high: Array
    probability: Array


def tuning_curves(
    draws: Draws, design: Design, target_db: float, over: Sequence[str] = tuple(CURVES)
) -> dict[str, Curve]:
    """Insertion loss against J2 and R about a design, all else as in the design; `over` : which of them."""
    out = {}
    for name in over:
        low, high = CURVES[name]
        values = _middle(draws, name) * np.geomspace(low, high, _CURVE_POINTS)
        if name == "J2":
            values = values[values >= design.bar_inertia]
        found = [linear_performance(draws, replace(design, **{name: float(x)})) for x in values]
        losses = np.array([p.insertion_loss for p in found])
        low_loss, _, high_loss = _quantiles(losses)
        told = np.isfinite(losses)
        mean = np.where(told, losses, 0.0).sum(axis=1) / np.where(told.any(axis=1), told.sum(axis=1), np.nan)
        reached = np.array([_probability(p, target_db) for p in found])
        out[name] = Curve(values, mean, low_loss, high_loss, reached)
    return out


# The command ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Band:
    """Quantiles 5, 50 and 95 % of an accelerance over the posterior; each (n_frequencies,)."""

    frequency_hz: Array
    low: Array
    median: Array
    high: Array


@dataclass(frozen=True)
class TuneResult:
    """What `tune` found; `linear` and `nonlinear` belong to `design`, and `optimum` to the best one within bounds."""

    case: str
    design: Design
    draws: Draws
    target_db: float
    linear: Performance
    nonlinear: Mapping[float, Performance]
    optimum: Optimum | None
    optimum_nonlinear: Mapping[float, Performance]
    shares: Mapping[str, float]
    response: Mapping[str, Band]
    curves: Mapping[str, Curve] = field(default_factory=dict)
    origin: Origin = field(default_factory=Origin)
    seed: int = 1
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def exit_code(self) -> ExitCode:
        """As that of the fit that the draws come from."""
        return ExitCode.DONE if self.origin.converged else ExitCode.NOT_CONVERGED

    def to_json(self) -> dict[str, Any]:
        """The content of tune.json."""
        best = self.optimum
        return {
            "schema": SCHEMA,
            "campaign": self.origin.campaign,
            "campaign_sha256": self.origin.sha256,
            "seed": self.seed,
            "case": self.case,
            "kind": self.origin.kind,
            "converged": self.origin.converged,
            "warnings": list(self.origin.warnings),
            "definition": "20 log10 of the highest accelerance without the secondary over the highest with it (eq. 24)",
            "draws": len(self.draws["J1"]),
            "target_db": self.target_db,
            "design": self.design.to_json(),
            "linear": _performance_json(self.linear, self.target_db),
            "nonlinear": [
                {"torque_amplitude_n_m": a} | _performance_json(p, self.target_db) for a, p in self.nonlinear.items()
            ],
            "optimum": None
            if best is None
            else {
                "design": best.design.to_json(),
                "at_bound": list(best.at_bound),
                "linear": _performance_json(best.performance, self.target_db),
                "nonlinear": [
                    {"torque_amplitude_n_m": a} | _performance_json(p, self.target_db)
                    for a, p in self.optimum_nonlinear.items()
                ],
            },
            "variance_shares": dict(self.shares),
            "hangs_most_on": next(iter(self.shares), None),
            "notes": [_LEFT_OUT.format(self.origin.effect)] if self.origin.effect else [],
            "frequency_response": {
                name: {
                    "frequency_hz": band.frequency_hz.tolist(),
                    "q05": band.low.tolist(),
                    "median": band.median.tolist(),
                    "q95": band.high.tolist(),
                }
                for name, band in self.response.items()
            },
            "curves": {
                name: {
                    "design": self._place(self.design, name),
                    "best_design": None if best is None else self._place(best.design, name),
                    "value": c.values.tolist(), "mean": c.mean.tolist(), "q05": c.low.tolist(), "q95": c.high.tolist(),
                    "probability_of_target": c.probability.tolist(),
                }
                for name, c in self.curves.items()
            },
            "provenance": dict(self.provenance),
        }  # fmt: skip

    def _place(self, design: Design, name: str) -> float:
        given = getattr(design, name)
        return float(np.median(self.draws[name]) if given is None else given)

    def text(self) -> str:
        """The result in a few lines."""
        effort, unit = self.origin.effort
        lines = [f"warning: {w}" for w in self.origin.warnings]
        if not self.origin.converged:
            lines.append("*** THE FIT DID NOT CONVERGE: do not use these numbers ***")
        lines += [f"Case {self.case}, {counted(len(self.draws['J1']), 'draw')}; target {self.target_db:g} dB."]
        lines.append(f"linear model: {_sentence(self.linear, self.target_db)}")
        lines += [f"{effort} {a:g} {unit}: {_sentence(p, self.target_db)}" for a, p in self.nonlinear.items()]
        if self.optimum is not None:
            d = self.optimum.design
            units = {"J2": "J2", "k2t": "k2t", "R": "R", "magnet_pull": "N0", "bar_inertia": "J2"}
            told = {k: f"{v:.4g} {unit_of(units[k], self.origin.kind)}" for k, v in d.to_json().items() if v}
            free = ", ".join(f"{k} = {v}" for k, v in told.items())
            bound = f" (at the bound: {', '.join(self.optimum.at_bound)})" if self.optimum.at_bound else ""
            lines.append(f"best design: {free}{bound}; {_sentence(self.optimum.performance, self.target_db)}")
            lines += [f"  at {a:g} {unit}: {_sentence(p, self.target_db)}" for a, p in self.optimum_nonlinear.items()]
        if any("no resonance" in line for line in lines):
            lines.append("No resonance: dry friction holds the rig, or damping leaves no peak.")
        if self.origin.effect:
            lines.append(_LEFT_OUT.format(self.origin.effect))
        if self.shares:
            name, share = next(iter(self.shares.items()))
            lines.append(f"The insertion loss hangs most on {name}: {100 * share:.0f} % of its variance.")
        return "\n".join(lines)


_LEFT_OUT = "The fit has the effect {} too, which is left out here: the design is judged by the nominal model alone."


def _sentence(p: Performance, target: float) -> str:
    known = p.insertion_loss[np.isfinite(p.insertion_loss)]
    if known.size == 0:
        return "no resonance in any draw"
    low, high = np.quantile(known, [0.05, 0.95])
    gone = 1.0 - known.size / p.insertion_loss.size
    none = f", no resonance in {100 * gone:.0f} % of the draws" if gone > 0.005 else ""
    return (
        f"insertion loss {known.mean():.1f} dB (90 %: {low:.1f} to {high:.1f}), resonance moves by "
        f"{np.nanmedian(p.shift):+.2f} Hz, P(loss >= {target:g} dB) = {_probability(p, target):.2f}{none}"
    )


def _probability(p: Performance, target: float) -> float:
    """Share of all draws that reach the target; a draw without a loss does not."""
    return float(np.mean(np.nan_to_num(p.insertion_loss, nan=-np.inf) >= target))


def _performance_json(p: Performance, target: float) -> dict[str, Any]:
    return {
        "insertion_loss_db": _summary(p.insertion_loss),
        "resonance_hz": _summary(p.resonance),
        "resonance_without_hz": _summary(p.resonance_without),
        "resonance_shift_hz": _summary(p.shift),
        "probability_of_target": _probability(p, target),
    }


def _summary(x: Array) -> dict[str, Any]:
    known = x[np.isfinite(x)]
    if known.size == 0:
        return {"mean": None, "sd": None, "median": None, "interval90": None, "without": int(x.size)}
    return {
        "mean": float(known.mean()),
        "sd": float(known.std()),
        "median": float(np.median(known)),
        "interval90": [float(q) for q in np.quantile(known, [0.05, 0.95])],
        "without": int(x.size - known.size),
    }


def _band(frequency: Array, accelerance: Array) -> Band:
    return Band(frequency, *_quantiles(accelerance.T))


def _quantiles(x: Array) -> Array:
    """Quantiles 5, 50 and 95 % over the draws, the last axis: (3, n); nan where no draw has a value."""
    told = np.isfinite(x)
    some = np.asarray(told.any(axis=-1))
    found = np.nanquantile(np.where(told, x, np.where(some[:, None], np.nan, 0.0)), [0.05, 0.5, 0.95], axis=-1)
    return np.where(some, found, np.nan)


def frequency_responses(draws: Draws, designs: Mapping[str, Design], amplitude: float | None = None) -> dict[str, Band]:
    """Bands of the accelerance without a secondary ("uncoupled") and with each design.

    By the linear model, or by the nonlinear one at an `amplitude` (N m).
    """
    own = float(np.median(linear.natural_frequency(draws["k1t"], draws["J1"])))
    frequency = own * np.linspace(0.3, 2.0, 171 if amplitude is None else 35)

    def response(values: Draws, coupled: bool) -> Array:
        if amplitude is not None:
            return harmonic_response(values, frequency, amplitude, coupled)[0]
        without = dict(values) if coupled else dict(values) | {k: np.zeros_like(values[k]) for k in ("k2t", "c2t")}
        return linear.accelerance(linear_rig(without), frequency)[:, 0]

    bands = {"uncoupled": _band(frequency, response(draws, coupled=False))}
    return bands | {name: _band(frequency, response(d.apply(draws), coupled=True)) for name, d in designs.items()}


def tune(
    source: Mapping[str, ArrayLike] | Path | str,
    *,
    case: str | None = None,
    rig: Mapping[str, float] | None = None,
    J2: float | None = None,
    k2t: float | None = None,
    R: float | None = None,
    magnet_pull: float | None = None,
    bar_inertia: float = 0.0,
    target_db: float = 10.0,
    amplitudes: Sequence[float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    optimise: bool = True,
    n_draws: int = 400,
    n_nonlinear: int = 50,
    seed: int = 1,
    out: Path | str | None = None,
) -> TuneResult:
    """Insertion loss and resonance shift of a design over a posterior, and the design of highest expected loss.

    Parameters
    ----------
    source : posterior draws, name -> (n,), or the folder of a fit; case : which of its cases ("joint": all together),
    by default the only one, else IV.
    rig : constants that the posterior does not hold (SI); else those of the fitted campaign, else the thesis's.
    J2, k2t, R, magnet_pull, bar_inertia : the design (see `Design`); None keeps the rig as it is.
    target_db : loss whose probability is given; amplitudes : torques (N m; forces, N) at which the nonlinear model is
    driven, by default of the size of the rig.
    bounds : where the best design is sought, SI (see `best_design`); out : folder for `tune.json` and figures.
    n_draws, n_nonlinear : draws for the linear and, among them, for the nonlinear model.

    Raises
    ------
    InputError
        if the design, the draws or the bounds mean nothing physically.
    """
    design = Design(J2, k2t, R, magnet_pull, bar_inertia)
    faults = []
    if min(n_draws, n_nonlinear) < 1:
        faults.append(f"n_draws = {n_draws}, n_nonlinear = {n_nonlinear}: at least one draw of each is needed")
    if not math.isfinite(target_db):
        faults.append(f"target_db = {target_db:g}: give the loss to reach as a number of dB")
    faults += [_refused(a) for a in amplitudes or () if not _drives(a)]
    if faults:
        raise InputError(faults)
    rng = np.random.default_rng(seed)
    case = chosen_case(source, case)
    origin = origin_of(source, case, rig)
    if origin.kind == "translational" and R is not None:
        raise InputError(f"R = {R:g}: a translational rig has no radius; change J2 or k2t")
    if amplitudes is None:
        amplitudes = origin.amplitudes
    draws = posterior_draws(source, case, n_draws, rng, {**origin.constants, **(rig or {})})
    lengths = ("R",) if origin.kind == "torsional" else ()
    if bounds is None:
        bounds = usual_bounds(draws, ("J2", "k2t", *lengths))
    performance = linear_performance(draws, design)
    optimum = best_design(draws, design, bounds) if optimise else None
    if optimum is not None and not np.isfinite(optimum.performance.insertion_loss).any():
        optimum = None
    designs = {"design": design} | ({} if optimum is None else {"best design": optimum.design})
    few = {name: column[:n_nonlinear] for name, column in draws.items()}
    driven = {float(a): nonlinear_performances(few, float(a), designs) for a in amplitudes}
    nonlinear = {a: found["design"] for a, found in driven.items()}
    at_optimum = {a: found["best design"] for a, found in driven.items() if "best design" in found}
    with_present = designs if design == Design() else {"present": Design()} | designs
    response = {f"linear, {name}": band for name, band in frequency_responses(draws, with_present).items()}
    fewer = {name: column[:20] for name, column in draws.items()}
    for a in driven:
        bands = frequency_responses(fewer, designs, a)
        response |= {f"{a:g} {origin.effort[1]}, {name}": band for name, band in bands.items()}
    shares = shares_of_variance(draws, performance.insertion_loss)
    result = TuneResult(
        case, design, draws, target_db, performance, nonlinear, optimum, at_optimum, shares, response,
        tuning_curves(draws, design, target_db, ("J2", *lengths)), origin, seed, provenance(),
    )  # fmt: skip
    if out is not None:
        told = result.to_json()
        write_json(Path(out) / "tune.json", told)
        about = f"{origin.campaign or 'design'}, case {case}"
        figures.save(figures.response_figure(told, title=f"{about}: frequency response"), Path(out) / "tune_response")
        figures.save(figures.tuning_figure(told, title=f"{about}: insertion loss"), Path(out) / "tune_loss")
    return result
