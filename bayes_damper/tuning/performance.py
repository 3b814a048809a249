"""What a design does, draw by draw: insertion loss and resonance shift, by the linear model and the nonlinear one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from bayes_damper.errors import InputError
from bayes_damper.rig import linear
from bayes_damper.rig.linear import LinearRig
from bayes_damper.simulation.model import Model
from bayes_damper.tuning.acting import Acting
from bayes_damper.tuning.draws import LINEAR, NONLINEAR, Draws

Array = NDArray[np.float64]
_COMMON_HZ = 10.0  # every drive is brought to this frequency by scaling time
_PER_CYCLE = 24
_MEASURED_CYCLES = 4
SWEPT = (0.4, 2.0)
"""From where to where the frequency of excitation goes at least, in natural frequencies of the primary alone."""
_COARSE = 29  # points of the even grid in that range


@dataclass(frozen=True)
class Design:
    """A secondary: J2 (kg m^2), k2t (N m/rad, at the present radius), R (m), N0 (N), c2t (N m s/rad, whatever R).

    None leaves the posterior's. bar_inertia : the part of J2 that grows with R^3, kg m^2 (the thesis's bar: 2.146e-3);
    0 keeps J2 whatever R. friction_torque : mu N0 R, dry friction between the bodies at full overlap, N m.
    """

    J2: float | None = None
    k2t: float | None = None
    R: float | None = None
    magnet_pull: float | None = None
    bar_inertia: float = 0.0
    c2t: float | None = None
    friction_torque: float | None = None

    def __post_init__(self) -> None:
        faults = []
        for name, unit in (("J2", "kg m^2 (kg)"), ("R", "m")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                faults.append(f"{name} = {value:g}: a design needs a {name} above zero; give it in {unit}")
        for name, unit in (
            ("k2t", "N m/rad (N/m)"), ("magnet_pull", "N"), ("bar_inertia", "kg m^2"), ("c2t", "N m s/rad (N s/m)"),
            ("friction_torque", "N m (N)"),
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                faults.append(f"{name} = {value:g}: a design cannot have a negative {name}; give it in {unit}")
        if not faults and self.J2 is not None and self.bar_inertia > self.J2:
            faults.append(f"bar_inertia = {self.bar_inertia:g}: the bar cannot weigh more than J2 = {self.J2:g} in all")
        if self.friction_torque is not None and self.magnet_pull is not None:
            faults.append("friction_torque is mu N0 R whatever the pull: give it or magnet_pull, not both")
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
        if self.c2t is not None:
            out["c2t"] = np.full_like(draws["c2t"], self.c2t)
        if self.friction_torque is not None:
            out["N0"] = np.where(out["N0"] > 0.0, out["N0"], 1.0)
            out["mu"] = self.friction_torque / (out["N0"] * out["R"])
        return out

    def to_json(self) -> dict[str, float | None]:
        return asdict(self)


def linear_rig(draws: Draws) -> LinearRig:
    """The linear rig of every draw: friction and drag left out."""
    return LinearRig(**{name: draws[name] for name in LINEAR})


@dataclass(frozen=True)
class Performance:
    """What a design does, per draw, each (n,): dB, Hz; NaN where damping leaves no resonance or nothing moves.

    displacement, displacement_without : amplitude of the primary at its resonance with and without the secondary, rad;
    None by the linear model, in which it is as large as the torque.
    """

    insertion_loss: Array
    resonance: Array
    resonance_without: Array
    displacement: Array | None = None
    displacement_without: Array | None = None

    @property
    def shift(self) -> Array:
        """Resonance with the secondary minus resonance without, Hz."""
        return self.resonance - self.resonance_without


def linear_performance(draws: Draws, design: Design | None = None) -> Performance:
    """Insertion loss and resonances of the linear model (eqs. 23 and 24)."""
    rig = linear_rig((design or Design()).apply(draws))
    frequency, _ = linear.uncoupled_resonance(draws["J1"], draws["k1t"], draws["c1t"])
    return Performance(linear.insertion_loss(rig), linear.resonances(rig).peak_frequency_hz, frequency)


def harmonic_response(
    draws: Draws, frequency_hz: ArrayLike, amplitude: float, coupled: bool = True, settle_cycles: int | None = None,
    acting: Acting | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Accelerance of the nonlinear rig under a harmonic torque on the primary, by time integration from rest.

    Parameters
    ----------
    draws : complete draws, each (n,); frequency_hz : (n_frequencies,), or (n, n_frequencies) for a grid per draw.
    amplitude : of the torque, N m.
    settle_cycles : cycles left out before the fundamental component is taken over four; by default six time constants
        of the slowest decay.
    acting : what acts beside the nominal model; its numbers are among the draws, as `effect.NAME`.

    Returns
    -------
    accelerance : (n, n_frequencies), 1/(kg m^2), the primary's fundamental acceleration over the torque; NaN where the
        integration failed. unsettled : same shape, relative change of the fundamental between the first and last two of
        the measured cycles.

    Every draw and frequency becomes one vector of one simulation: with time counted in cycles of the drive, inertias
    grow with the square of the frequency, damping and the smoothing constant with the frequency, and all share one
    drive. Displacement is read, because what the samples cannot resolve is smallest there.
    """
    y, f = _driven(draws, frequency_hz, amplitude, coupled, settle_cycles, acting)
    y = y[:, :, 0]
    turn = np.exp(-2j * np.pi * np.arange(_MEASURED_CYCLES * _PER_CYCLE) / _PER_CYCLE)
    last = y[..., -turn.size :] * turn
    whole, half = 2.0 * last.mean(-1), turn.size // 2
    change = np.abs(last[..., :half].mean(-1) - last[..., half:].mean(-1)) * 2.0
    # Between samples the torque is linear, so its fundamental is a little below that of the cosine.
    drive = amplitude * np.sinc(1.0 / _PER_CYCLE) ** 2
    omega = 2.0 * np.pi * f
    return np.abs(whole) * omega**2 / drive, change / np.maximum(np.abs(whole), 1e-300)


def _driven(
    draws: Draws, frequency_hz: ArrayLike, amplitude: float, coupled: bool, settle_cycles: int | None,
    acting: Acting | None,
) -> tuple[Array, Array]:  # fmt: skip
    """Displacements (n, n_frequencies, channels, n_times) under a harmonic torque, and the frequencies (n, ...), Hz."""
    if not drives(amplitude):
        raise InputError(refused(amplitude))
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
    acting = None if acting is None else acting.on_rig(coupled)
    run = Model(coupled=coupled, effect=None if acting is None else acting.variant).simulate(
        parameters, times, effect=None if acting is None else acting.numbers(draws, scale), torque=torque,
        quantity="displacement",
    )  # fmt: skip
    return run.y.reshape(*f.shape, *run.y.shape[1:]), f


def outside_of(acting: Acting, draws: Draws, amplitude: float, design: Design, p: Performance) -> list[str]:
    """Sentences on where a design that is driven at its resonance leaves the range of a learnt law."""
    law = acting.law
    assert law is not None
    known = np.isfinite(p.resonance)
    if not known.any():
        return []
    some = {name: column[known] for name, column in design.apply(draws).items()}
    y, f = _driven(some, p.resonance[known][:, None], amplitude, True, None, acting)
    th1, th2 = np.moveaxis(y[:, 0, :, -_MEASURED_CYCLES * _PER_CYCLE :], 1, 0)
    places = {"interface": [th1 - th2], "ground2": [th2], "ground1": [th1], "bearings": [th1, th2]}[law.site]
    places = places[:1] if law.bodies == "primary" else places
    reach = max(float(np.nanmax(np.abs(x))) for x in places)
    fast = max(float(np.nanmax(np.abs(x) * 2.0 * np.pi * f)) for x in places)
    return law.outside({"angle": (-reach, reach), "speed": (-fast, fast)})


def drives(amplitude: float) -> bool:
    """Whether an exciting torque moves anything: finite and above zero."""
    return math.isfinite(amplitude) and amplitude > 0.0


def refused(amplitude: float) -> str:
    """Why an amplitude that drives nothing is refused."""
    return f"amplitude = {amplitude:g}: the exciting torque (force) must be above zero; give it in N m (N)"


def _settling(draws: Draws) -> int:
    """Cycles in which a transient of the primary's own damping falls to exp(-7), within 20 and 150."""
    zeta = float(np.quantile(linear.damping_ratio(draws["c1t"], draws["k1t"], draws["J1"]), 0.1))
    return int(np.clip(math.ceil(7.0 / (2.0 * math.pi * max(zeta, 1e-3))), 20, 150))


def _grid(draws: Draws, coupled: bool) -> tuple[Array, Array]:
    """Frequencies (n, m) among which the resonances of each draw are sought first, and their logarithmic step (n, 1).

    An even grid that holds the resonances of the linear model, these themselves, and that of both inertias stuck
    together.
    """
    own = linear.natural_frequency(draws["k1t"], draws["J1"])[:, None]
    extra = own
    if coupled:
        likely = linear.resonances(linear_rig(draws)).frequency_hz
        stuck = linear.natural_frequency(draws["k1t"], draws["J1"] + draws["J2"])[:, None]
        extra = np.concatenate([np.where(np.isfinite(likely), likely, own * [[0.99, 1.01]]), stuck], axis=1)
    low = np.minimum(SWEPT[0] * own, 0.8 * extra.min(axis=1, keepdims=True))
    step = np.log(np.maximum(SWEPT[1] * own, 1.25 * extra.max(axis=1, keepdims=True)) / low) / (_COARSE - 1)
    return np.sort(np.concatenate([low * np.exp(step * np.arange(_COARSE)), extra], axis=1), axis=1), step


@dataclass(frozen=True)
class Sweep:
    """Accelerance of every draw over rising frequencies of its own, close together at its resonances; (n, m) each."""

    frequency_hz: Array
    accelerance: Array

    def maxima(self) -> NDArray[np.bool_]:
        """Where a draw has a resonance: higher than its neighbours and, by half a percent, than what lies beyond.

        Faces and bearings that stick leave a mass that follows the torque: highest at the end, wherever that is.
        """
        h = np.nan_to_num(self.accelerance)
        out = np.zeros(h.shape, dtype=bool)
        lowest_before = np.minimum.accumulate(h, axis=1)
        lowest_after = np.minimum.accumulate(h[:, ::-1], axis=1)[:, ::-1]
        inner = h[:, 1:-1]
        out[:, 1:-1] = (inner >= h[:, :-2]) & (inner > h[:, 2:])
        return out & (h > 1.005 * np.maximum(lowest_before, lowest_after))

    def resonances(self, most: int = 2) -> Array:
        """Frequencies of the highest resonances of every draw, highest first: (n, most), nan where there are fewer."""
        height = np.where(self.maxima(), self.accelerance, -np.inf)
        best = np.argsort(-height, axis=1)[:, :most]
        found = np.take_along_axis(self.frequency_hz, best, 1)
        return np.where(np.isfinite(np.take_along_axis(height, best, 1)), found, np.nan)

    def highest(self) -> tuple[Array, Array]:
        """Frequency and height of the highest resonance of every draw, by a parabola; nan where there is none."""
        height = np.where(self.maxima(), self.accelerance, -np.inf)
        k = np.clip(np.argmax(height, axis=1), 1, height.shape[1] - 2)[:, None]
        some = np.isfinite(np.take_along_axis(height, k, 1)[:, 0])
        x, y = (
            np.concatenate([np.take_along_axis(values, k + i, 1) for i in (-1, 0, 1)], axis=1)
            for values in (np.log(self.frequency_hz), np.nan_to_num(self.accelerance))
        )
        before, after = np.maximum(np.diff(x, axis=1), 1e-12).T
        rise, fall = (y[:, 1] - y[:, 0]) / before, (y[:, 1] - y[:, 2]) / after
        bend = (rise + fall) / (before + after)  # y = y1 + slope u - bend u^2
        slope = (rise * after - fall * before) / (before + after)
        u = np.clip(slope / np.where(bend > 0.0, 2.0 * bend, np.inf), -before, after)
        found = np.exp(x[:, 1] + u), y[:, 1] + slope * u - bend * u**2
        return np.where(some, found[0], np.nan), np.where(some, found[1], np.nan)

    def at(self, frequency_hz: Array) -> Array:
        """Accelerance at other frequencies, the same for every draw: (n, n_frequencies); nan where none is known."""
        out = np.full((len(self.accelerance), frequency_hz.size), np.nan)
        for row, f, h in zip(out, self.frequency_hz, self.accelerance, strict=True):
            x, first = np.unique(np.log(f[h > 0.0]).round(9), return_index=True)
            if x.size > 1:
                curve = PchipInterpolator(x, np.log(h[h > 0.0][first]), extrapolate=False)
                row[:] = np.exp(curve(np.log(frequency_hz)))
        return out


def sweep(draws: Draws, amplitude: float, coupled: bool, acting: Acting | None = None) -> Sweep:
    """The nonlinear rig's accelerance: over a coarse grid, then ever more closely about the highest resonances."""
    grid, step = _grid(draws, coupled)
    found = Sweep(grid, harmonic_response(draws, grid, amplitude, coupled, acting=acting)[0])
    for resonances in (2, 2, 1) if coupled else (1, 1, 1):
        centre = found.resonances(resonances)
        there = np.isfinite(centre)
        highest = np.argmax(np.nan_to_num(found.accelerance), axis=1)[:, None]
        highest = np.where(there[:, :1], centre[:, :1], np.take_along_axis(found.frequency_hz, highest, 1))
        # Where there are fewer resonances the points lie between those about the highest.
        centre = np.where(there, centre, highest * np.exp(step * np.arange(resonances) / 16.0))
        more = (centre[:, :, None] * np.exp(step[:, :, None] * np.arange(-7, 8, 2) / 8.0)).reshape(len(centre), -1)
        height, _ = harmonic_response(draws, more, amplitude, coupled, acting=acting)
        grid = np.concatenate([found.frequency_hz, more], axis=1)
        order = np.argsort(grid, axis=1)
        both = np.concatenate([found.accelerance, height], axis=1)
        found = Sweep(np.take_along_axis(grid, order, 1), np.take_along_axis(both, order, 1))
        step = step / 4.0
    return found


@dataclass(frozen=True)
class Driven:
    """The nonlinear rig under a harmonic torque of one amplitude: what each design does, and the sweeps behind it."""

    performances: Mapping[str, Performance]
    sweeps: Mapping[str, Sweep]  # of each design, and "uncoupled"


def driven(
    draws: Draws, amplitude: float, designs: Mapping[str, Design], acting: Acting | None = None,
    uncoupled: Sweep | None = None,
) -> Driven:  # fmt: skip
    """Insertion loss, resonances and motion of the nonlinear model of each design, under a torque of this amplitude.

    amplitude : N m; acting : what acts beside the nominal model; uncoupled : the sweep without a secondary, if known.
    """
    sweeps = {"uncoupled": sweep(draws, amplitude, False, acting) if uncoupled is None else uncoupled}
    sweeps |= {name: sweep(design.apply(draws), amplitude, True, acting) for name, design in designs.items()}
    without_frequency, without = sweeps["uncoupled"].highest()
    out = {}
    for name in designs:
        frequency, height = sweeps[name].highest()
        moving = (height > 0.0) & (without > 0.0)  # nowhere true of nan
        loss = 20.0 * np.log10(np.where(moving, without, 1.0) / np.where(moving, height, 1.0))
        out[name] = Performance(
            np.where(moving, loss, np.nan),
            np.where(moving, frequency, np.nan),
            np.where(moving, without_frequency, np.nan),
            height * amplitude / (2.0 * np.pi * frequency) ** 2,
            without * amplitude / (2.0 * np.pi * without_frequency) ** 2,
        )
    return Driven(out, sweeps)


def probability_of(p: Performance, target: float) -> float:
    """Share of all draws that reach the target; a draw without a loss does not."""
    return float(np.mean(np.nan_to_num(p.insertion_loss, nan=-np.inf) >= target))
