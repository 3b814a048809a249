"""The rig as a function: parameters and sample times in, the readings of both channels out.

A `Model` is the nominal damper with at most one effect (or a pair composed into one variant) and the sensors, compiled
once. It takes many parameter vectors at a time, because sixteen cost hardly more than one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import Akima1DInterpolator

from bayes_damper.effects.base import MOST_PARAMETERS, Variant, parameter_table
from bayes_damper.rig.equations import ROWS
from bayes_damper.rig.inputs import Inputs
from bayes_damper.runs.threads import side_by_side
from bayes_damper.simulation import integrator, links, specialised
from bayes_damper.simulation.integrator import LANES, LONGEST_STEP

Quantity = Literal["acceleration", "velocity", "displacement"]
QUANTITIES: tuple[Quantity, ...] = ("acceleration", "velocity", "displacement")
Array = NDArray[np.float64]
Parameters = Mapping[str, ArrayLike]

# What a rig has when nothing is said: no second stiffness, friction along a tanh, a start at rest, both bodies at one
# angle, no late trigger.
_OPTIONAL = {
    "J12": 0.0, "k3t": 0.0, "omega1_0": 0.0, "omega2_0": 0.0, "delay": 0.0, "release_time": 0.0, "tail": 0.0,
    "drag_ratio": 1.0,
}  # fmt: skip
# What the uncoupled rig does not see.
_COUPLED_ONLY = {"J2": 1.0, "c3t": 0.0, "k2t": 0.0, "c2t": 0.0, "mu": 0.0, "N0": 0.0, "R": 1.0, "r": 1.0}
_WIDTH = 4  # lanes of a vector register: a block of few vectors is no wider than they need
_POSITIVE = [ROWS.index(name) for name in ("J1", "J2", "R", "r", "nu")]


@dataclass(frozen=True)
class Simulation:
    """Readings of n parameter vectors: `y` (n, n_channels, n_times), nan where `outcome` (n,) is not COMPLETED."""

    y: Array
    outcome: NDArray[np.int64]


@cache
def _kernel(model: Model, *options: bool) -> Callable[..., None]:
    return specialised.specialise(model.bound(*options))


@dataclass(frozen=True)
class Model:
    """One configuration of a rig, with at most one effect.

    coupled : whether the secondary inertia is there; normal_force : law of the magnet's pull (eq. 20);
    restoring : "pendulum" puts k sin(th) in place of k th; coupling_law : "cosine" puts J12 cos(th1 - th2) in place of
    J12, as of two links (links.py); longest_step : s, longer than the default for rigs far slower than the thesis's.
    """

    coupled: bool = True
    normal_force: Literal["linear", "constant"] = "linear"
    restoring: Literal["linear", "pendulum"] = "linear"
    effect: Variant | None = None
    coupling_law: Literal["constant", "cosine"] = "constant"
    longest_step: float = LONGEST_STEP

    @property
    def channels(self) -> int:
        """1 for the uncoupled rig, else 2."""
        return 2 if self.coupled else 1

    @property
    def acting(self) -> Variant | None:
        """The effect, if it acts in this configuration."""
        return self.effect if self.effect is not None and (self.coupled or self.effect.uncoupled) else None

    def bound(
        self, driven: bool = False, prescribed: bool = False, swings: bool = False, curved: bool = False
    ) -> dict[str, Any]:
        """What the kernel's globals are bound to: with inputs (driven), friction with a tail (curved), or without.

        prescribed : whether one of the inputs is the motion of the primary; swings : or of a pendulum's pivot.

        Raises
        ------
        ValueError
            for inputs to a rig of two links.
        """
        variant = self.acting
        variant = variant if variant is not None and variant.has_kernel else None
        pendulum = self.restoring == "pendulum"
        if self.coupled and self.coupling_law == "cosine":
            if driven:
                raise ValueError('a measured input needs coupling_law = "constant"')
            variant = links.linked(variant, pendulum)
        linear = self.normal_force == "linear"
        return specialised.specialised_globals(
            self.coupled, linear, pendulum, driven, variant, prescribed, swings, curved
        )

    def compile(
        self, driven: bool = False, prescribed: bool = False, swings: bool = False, curved: bool = False
    ) -> Callable[..., None]:
        """The kernel: for records with inputs (driven), friction with a tail (curved), or without.

        prescribed : whether one of the inputs is the motion of the primary; swings : or of a pendulum's pivot.

        From the on-disk cache if it was compiled before (0.02 s), else compiled (seconds).
        """
        return _kernel(self, driven, prescribed, swings, curved)

    def simulate(
        self,
        parameters: Parameters,
        times: ArrayLike,
        *,
        effect: Parameters | None = None,
        torque: ArrayLike | None = None,
        inputs: Inputs | None = None,
        quantity: Quantity = "acceleration",
        tolerance: float = 1.0,
    ) -> Simulation:
        """Readings of all channels for n parameter vectors.

        Parameters
        ----------
        parameters : name -> scalar or (n,), SI; names of `equations.ROWS` (theta2_0 defaults to theta0, drag_ratio to
            1; J12, k3t, initial velocities, delay and release_time to 0; what only the coupled rig has may be left out
            for the uncoupled one).
        times : (n_times,) s on the record's clock, increasing; or (n, n_times), a clock for each vector, where nothing
            drives the rig. It is released at `delay`; before, it is held. A delay below the first time means that the
            record begins after the release.
        effect : parameters of the effect, name -> scalar or (n,), if the model has one.
        torque : (n_times,) N m on the primary, linear between samples: short for `inputs` with nothing else.
        inputs : torques on both bodies and the motion of the ground, on a clock of their own. Where the ground moves,
            theta0, theta2_0 and the initial velocities are counted from the ground, and readings are what
            `Inputs.shown` makes of them. A sensor that lags shows what a smooth curve through its readings showed.
            Where the motion of the primary is prescribed, channel 1 reads the reaction over `Inputs.unit`, the record
            begins at times[0], and of theta0, theta2_0 and initial velocities the differences between the bodies count.
        quantity : what the channels read.
        tolerance : factor on the integrator's error tolerance: 1 keeps errors below 1e-4 of the peak, 0.1 below 1e-5.

        Raises
        ------
        KeyError
            if a parameter that the configuration needs is missing.
        ValueError
            if times do not increase, a name is unknown, the ground of a pendulum moves, or the pivot of a spring.
        """
        rows, extras, grid, drive, lags = self._prepared(parameters, times, effect, torque, inputs)
        if lags is None:
            return self._run(rows, extras, grid, drive, quantity, tolerance)
        if drive is not None:
            there = self._run(rows, extras, grid, drive, quantity, tolerance)
            return Simulation(delayed(there.y, grid, lags), there.outcome)
        readings = []
        for channel, lag in enumerate(lags):
            late = np.array(np.broadcast_to(rows, (rows.shape[0], max(rows.shape[1], np.size(lag)))))
            late[ROWS.index("delay")] += lag
            readings.append((channel, self._run(late, extras, grid, drive, quantity, tolerance)))
        y = np.stack([simulation.y[:, channel] for channel, simulation in readings], axis=1)
        return Simulation(y, np.max([simulation.outcome for _, simulation in readings], axis=0))

    def _prepared(
        self,
        parameters: Parameters,
        times: ArrayLike,
        effect: Parameters | None,
        torque: ArrayLike | None,
        inputs: Inputs | None,
    ) -> tuple[Array, Array, Array, Inputs | None, list[Any] | None]:
        """Checked arguments: rows, parameters of the effect, sample times, inputs that act, lags of channels."""
        grid = np.ascontiguousarray(times, float)
        if grid.ndim not in (1, 2) or grid.size < 1 or (grid[..., 1:] <= grid[..., :-1]).any():
            raise ValueError("times must be one- or two-dimensional and increase from sample to sample")
        if grid.ndim == 2 and (torque is not None or (inputs is not None and inputs.active)):
            raise ValueError("a torque or another input needs one clock for all vectors")
        drive = inputs
        if torque is not None:
            if inputs is not None:
                raise ValueError("both torque and inputs are given; put the torque into the inputs")
            if np.shape(torque) != grid.shape:
                raise ValueError(
                    f"torque has {np.size(torque)} samples, times has {grid.size}; give one torque per sample"
                )
            drive = Inputs.measured(grid, torque)
        drive = drive if drive is not None and drive.active else None
        if drive is not None and drive.moving_ground and self.restoring == "pendulum":
            raise ValueError(
                'a moving ground needs restoring = "linear": gravity does not turn with the ground (a pivot may move)'
            )
        if drive is not None and drive.pivot is not None and self.restoring != "pendulum":
            raise ValueError('a pivot that is moved sideways needs restoring = "pendulum"')
        variant = self.acting
        changes = dict(effect or {})
        if self.effect is not None:
            parameter_table(self.effect, changes)  # the names must fit, even where the effect does not act
        elif changes:
            raise ValueError(f"the model has no effect, but parameters {sorted(changes)} were given for one")
        if variant is None:
            return self._rows(parameters), np.zeros((MOST_PARAMETERS, 1)), grid, drive, None
        extras = parameter_table(variant, changes)
        named = {p.name: extras[i] for i, p in enumerate(variant.parameters)}
        amended = parameters if variant.amend is None else variant.amend(_complete(parameters), named)
        lags = None if variant.lag is None else list(variant.lag(named)[: self.channels])
        return self._rows(amended), extras, grid, drive, lags

    def _rows(self, parameters: Parameters) -> Array:
        """Parameters as rows of equations.ROWS, (23, n)."""
        given = _complete(parameters)
        if not self.coupled:
            # Placeholders of what is not there: nothing between the bodies acts on the motion, whatever was given.
            given = _COUPLED_ONLY | given | dict.fromkeys(("J12", "k3t", "k2t", "c2t", "c3t", "mu", "N0"), 0.0)
        elif self.coupling_law == "cosine":
            given["drag_ratio"] = 1.0  # the second link has no bearing to ground
        missing = [name for name in ROWS if name not in given]
        if missing:
            raise KeyError(f"the simulation needs {', '.join(missing)}; give them in SI units")
        rows = np.empty((len(ROWS), max(np.size(given[name]) for name in ROWS)))
        for row, name in zip(rows, ROWS, strict=True):
            row[:] = given[name]
        return rows

    def _run(
        self,
        rows: Array,
        extras: Array,
        times: Array,
        inputs: Inputs | None,
        quantity: Quantity,
        tolerance: float,
    ) -> Simulation:
        """Integrate block by block."""
        n = max(rows.shape[1], extras.shape[1], len(times) if times.ndim == 2 else 1)
        rows = np.array(np.broadcast_to(rows, (rows.shape[0], n)))
        extras = np.array(np.broadcast_to(extras, (extras.shape[0], n)))
        usable = np.isfinite(rows).all(axis=0) & np.isfinite(extras).all(axis=0)
        usable &= (rows[_POSITIVE] > 0.0).all(axis=0)
        outcome = np.where(usable, integrator.COMPLETED, integrator.NOT_FINITE_INPUT)
        y = np.full((n, self.channels, times.shape[-1]), np.nan)
        which = np.flatnonzero(usable)
        # Vectors that take similarly many steps share a block: one that is done waits for the others.
        which = which[np.lexsort([rows[ROWS.index(name), which] for name in ("theta0", "k1t", "nu")])]
        if which.size == 0:
            return Simulation(y, outcome)
        prescribed = inputs is not None and inputs.motion is not None
        if inputs is not None and prescribed:
            _begin_as_prescribed(rows, inputs, float(times[0]))
        first = rows[ROWS.index("delay"), which].min()
        grid = _begun_before(times, first)
        skip = grid.shape[-1] - times.shape[-1]
        pieces, at = np.zeros((8, 1)), None
        if inputs is not None:
            grid, where = inputs.grid(grid)
            pieces = inputs.pieces(grid)
            at = where[skip:] if grid.size > times.size + skip else None
        swings = inputs is not None and inputs.pivot is not None
        curved = bool(np.any(rows[ROWS.index("tail"), which]))
        kernel = self.compile(inputs is not None, prescribed, swings, curved)
        read = np.array([float(quantity == name) for name in QUANTITIES])
        variant = self.acting
        scales = (*variant.memory_scale, np.inf, np.inf)[:2] if variant is not None else (np.inf, np.inf)
        memory_weights = 1.0 / np.array(scales)

        starts = range(0, which.size, LANES)

        def work(first: int, step: int) -> None:
            out = np.empty((LANES, 2, grid.shape[-1] + 1))
            final = np.empty(LANES)
            status = np.empty(LANES, np.int64)
            for start in starts[first::step]:
                width = min(LANES, _WIDTH * math.ceil((which.size - start) / _WIDTH))
                lanes = which[np.minimum(np.arange(start, start + width), which.size - 1)]
                kernel(
                    *(
                        grid[None] if grid.ndim == 1 else grid[lanes],
                        np.ascontiguousarray(rows[:, lanes]),
                        np.ascontiguousarray(extras[:, lanes]),
                        pieces,
                    ),
                    *(np.full(LANES, tolerance), memory_weights, self.longest_step, read, out, final, status),
                )
                status[(status == integrator.COMPLETED) & ~np.isfinite(final)] = integrator.NOT_FINITE_RECORD
                kept = min(LANES, which.size - start)
                outcome[lanes[:kept]] = status[:kept]
                there = slice(skip, grid.shape[-1]) if at is None else at
                y[lanes[:kept]] = out[:kept, : self.channels, there]

        side_by_side(work, len(starts))
        y[outcome != integrator.COMPLETED] = np.nan
        if inputs is not None and prescribed:
            y[:, 0] /= inputs.unit
        return Simulation(y, outcome)


def _begin_as_prescribed(rows: Array, inputs: Inputs, begin: float) -> None:
    """Let parameters begin with the primary as its motion is prescribed, and the secondary as far from it as given."""
    for name, other, value in zip(("theta2_0", "omega2_0"), ("theta0", "omega1_0"), inputs.begun(begin), strict=True):
        second, primary = ROWS.index(name), ROWS.index(other)
        rows[second] += value - rows[primary]
        rows[primary] = value
    rows[ROWS.index("delay")], rows[ROWS.index("release_time")] = begin, 0.0


def _begun_before(times: Array, first: float) -> Array:
    """Sample times with one more in front, where one of the records begins after the first release."""
    if not np.any(first < times[..., 0]):
        return times
    if times.ndim == 1:
        return np.concatenate([[first], times])
    step = times[:, 1] - times[:, 0] if times.shape[1] > 1 else np.ones(len(times))
    return np.column_stack([np.minimum(first, times[:, 0] - step), times])


def delayed(y: Array, times: Array, lags: Sequence[ArrayLike]) -> Array:
    """Readings y (n, channels, n_times) as channels show them that lag, by s, a number or (n,) for each channel.

    For records with inputs, whose clock does not move with the release: by a local cubic between the readings.
    """
    there, y = y, y.copy()
    for channel, lag in enumerate(lags):
        each = np.broadcast_to(np.asarray(lag, float), (y.shape[0],))
        for v in np.flatnonzero((each != 0.0) & np.isfinite(there[:, channel]).all(axis=1)):
            curve = Akima1DInterpolator(times, there[v, channel])
            y[v, channel] = curve(np.clip(times - each[v], times[0], times[-1]))
    return y


def _complete(parameters: Parameters) -> dict[str, Any]:
    """The parameters with the defaults of those that may be left out."""
    unknown = sorted(set(parameters) - set(ROWS))
    if unknown:
        raise ValueError(f"unknown parameter {unknown[0]!r}; the simulation knows {', '.join(ROWS)}")
    given = _OPTIONAL | dict(parameters)
    if "theta2_0" not in given and "theta0" in given:
        given["theta2_0"] = given["theta0"]
    return given
