"""Measured inputs of a record: torques on both bodies, the motion of the ground that carries springs and bearings, or
a motion that something strong imposes on the primary.

Angles counted from the ground obey the rig's own equations with two torques more, so that no formula of spring,
bearing, interface or effect changes where the ground moves:

    torque1 - (J1 + J12) ag   on the primary,   torque2 - (J2 + J12) ag   on the secondary

A torque and an acceleration of the ground are linear between samples, or held. A ground that was measured as an angle
is joined by a cubic spline: its second derivative, the acceleration that drives the rig, is linear between samples.

Where the primary's motion th1(t) is prescribed, its equation gives the torque that this takes, the reaction:

    reaction = J1 a1 + J12 a2 + c1t w1 + k1t g(th1) + drag tanh(nu w1) + T - Q1

which is what the primary's channel reads then; the secondary moves as its own equation says.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_SAME = 1e-6  # of a step, by which two clocks may differ and still name one sample


@dataclass(frozen=True, eq=False)
class Inputs:
    """What acted on the rig during one record.

    times : (m,) s on the record's clock, increasing; before and after them the first and last values hold.
    torque1, torque2 : (m,) N m (N) on primary and secondary; ground : (m,) rad/s^2 (m/s^2), its acceleration.
    shown : (m,) what the motion of the ground adds to the readings, in their unit; zeros where the sensors read in the
    frame of the ground. held : whether inputs keep their value until the next sample; else they are linear between.
    motion : (3, m) angle, speed and acceleration of a primary whose motion is prescribed, else None; unit : of its
    reaction, N m (N): a simulation gives reaction / unit. pivot : (m,) m/s^2, sideways acceleration of the pivot of a
    pendulum, or None. given : the arguments of `measured` that they were made from.
    """

    times: Array
    torque1: Array
    torque2: Array
    ground: Array
    shown: Array
    held: bool = False
    motion: Array | None = None
    unit: float = 1.0
    pivot: Array | None = None
    given: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def measured(
        cls,
        times: ArrayLike,
        torque1: ArrayLike | None = None,
        torque2: ArrayLike | None = None,
        *,
        ground: ArrayLike | None = None,
        ground_quantity: Literal["displacement", "acceleration"] = "acceleration",
        quantity: Literal["displacement", "velocity", "acceleration"] = "acceleration",
        frame: Literal["absolute", "ground"] = "absolute",
        held: bool = False,
        motion: ArrayLike | None = None,
        motion_quantity: Literal["displacement", "acceleration"] = "displacement",
        pivot: ArrayLike | None = None,
    ) -> Inputs:
        """Inputs as they were measured, all (m,), SI; None for those that were not there.

        ground : angle (rad, m) or acceleration of the ground; quantity : what the sensors on the bodies read, and frame
        in which. motion : prescribed angle (rad, m) or acceleration of the primary. What is measured by its
        acceleration is at angle 0 and at rest at times[0]. pivot : sideways acceleration of a pendulum's pivot, m/s^2,
        to the side to which a positive angle swings.

        Raises
        ------
        ValueError
            for arrays of other lengths than `times`, an angle that is to be held between samples, or a prescribed
            motion beside a torque on the primary or a ground that moves, or a pivot that moves beside either motion.
        """
        t = np.ascontiguousarray(times, float)
        nothing = np.zeros(t.size)
        columns = {"torque1": torque1, "torque2": torque2, "ground": ground, "motion": motion, "pivot": pivot}
        rows = {name: nothing if x is None else np.ascontiguousarray(x, float) for name, x in columns.items()}
        given: dict[str, Any] = {name: rows[name] for name, x in columns.items() if x is not None} | {
            "ground_quantity": ground_quantity, "quantity": quantity, "frame": frame, "held": held,
            "motion_quantity": motion_quantity,
        }  # fmt: skip
        for name, row in rows.items():
            if row.shape != t.shape:
                raise ValueError(f"{name} has {row.size} samples, times has {t.size}; give one value per sample")
        if pivot is not None:
            if motion is not None or ground is not None:
                raise ValueError("a pivot that is moved sideways is the only motion that acts; keep one of them")
            return cls(t, rows["torque1"], rows["torque2"], nothing, nothing, held, pivot=rows["pivot"], given=given)
        if motion is not None:
            if torque1 is not None or ground is not None:
                raise ValueError(
                    "a prescribed motion leaves no room for a torque on the primary or a moving ground; keep one"
                )
            moved = _motion(t, rows["motion"], motion_quantity, held, "the primary")
            stacked = np.stack(list(moved.values()))
            return cls(t, nothing, rows["torque2"], nothing, nothing, held, stacked, given=given)
        if ground is None:
            return cls(t, rows["torque1"], rows["torque2"], nothing, nothing, held, given=given)
        moved = _motion(t, rows["ground"], ground_quantity, held, "the ground")
        shown = moved[quantity] if frame == "absolute" else nothing
        return cls(t, rows["torque1"], rows["torque2"], moved["acceleration"], shown, held, given=given)

    @property
    def columns(self) -> dict[str, Array]:
        """What was measured of torques, ground and pivot, by the name of its argument; not a prescribed motion."""
        return {name: self.given[name] for name in ("torque1", "torque2", "ground", "pivot") if name in self.given}

    def shifted(self, name: str, by: Array) -> Inputs:
        """The inputs with `by` (m,) added to one of the measured columns."""
        return replace(Inputs.measured(self.times, **{**self.given, name: self.given[name] + by}), unit=self.unit)

    @cached_property
    def active(self) -> bool:
        """Whether anything acts or shows at any time, or the primary's motion is prescribed."""
        return (
            self.motion is not None
            or self.pivot is not None
            or any(bool(np.any(x)) for x in (self.torque1, self.torque2, self.ground, self.shown))
        )

    @cached_property
    def moving_ground(self) -> bool:
        """Whether the ground moves."""
        return bool(np.any(self.ground) or np.any(self.shown))

    @cached_property
    def key(self) -> str:
        """A checksum, equal for equal inputs."""
        moved = [x for x in (self.motion, self.pivot) if x is not None]
        rows = (self.times, self.torque1, self.torque2, self.ground, self.shown, *moved)
        return hashlib.sha256(b"".join([bytes([self.held]), *(row.tobytes() for row in rows)])).hexdigest()

    def seen_from_ground(self) -> Inputs:
        """The same inputs with sensors that move with the ground."""
        return replace(self, shown=np.zeros(self.times.size))

    def grid(self, times: Array) -> tuple[Array, NDArray[np.intp]]:
        """The samples of readings and inputs in one row, (n,), and where in it the readings `times` stand."""
        if times.size == self.times.size and np.array_equal(times, self.times):
            return times, np.arange(times.size)
        inner = self.times[(self.times > times[0]) & (self.times < times[-1])]
        k = np.searchsorted(times, inner)
        beside = np.minimum(inner - times[k - 1], times[k] - inner)
        merged = np.union1d(times, inner[beside > _SAME * self._step])
        return merged, np.searchsorted(merged, times)

    def begun(self, instant: float) -> tuple[float, float]:
        """Angle and speed of a primary whose motion is prescribed, at an instant."""
        angle, speed, _ = self.moved(np.array([instant]))[:, 0]
        return float(angle), float(speed)

    def moved(self, instants: Array) -> Array:
        """Angle, speed and acceleration of a primary whose motion is prescribed, (3, n), at the instants (n,)."""
        assert self.motion is not None
        k = np.clip(np.searchsorted(self.times, instants, side="right") - 1, 0, self.times.size - 1)
        angle, speed, a = self.motion[:, k]
        later = np.minimum(k + 1, self.times.size - 1)
        h, u = self.times[later] - self.times[k], instants - self.times[k]
        rise = np.zeros_like(u) if self.held else self.motion[2, later] - a
        slope = np.divide(rise, h, out=np.zeros_like(u), where=h > 0.0)
        faster = u * (a + 0.5 * slope * u)
        return np.stack([angle + u * (speed + u * (0.5 * a + slope * u / 6.0)), speed + faster, a + slope * u])

    def at(self, grid: Array) -> Array:
        """Values of torque1, torque2, ground and shown at the instants `grid`, (4, n).

        Where the primary's motion is prescribed, its acceleration takes the place of torque1; where a pivot moves, its
        acceleration that of shown.
        """
        first = self.torque1 if self.motion is None else self.motion[2]
        rows = (first, self.torque2, self.ground, self.shown if self.pivot is None else self.pivot)
        if not self.held:
            return np.array([np.interp(grid, self.times, row) for row in rows])
        index = np.searchsorted(self.times, grid + _SAME * self._step, side="right") - 1
        out = np.array([row[np.maximum(index, 0)] for row in rows])
        if self.pivot is None:
            out[3] = np.interp(grid, self.times, self.shown)
        return out

    def pieces(self, grid: Array) -> Array:
        """As the integrator takes them, (8, n): values at the end of each interval of the grid, then their slopes.

        The last interval, after the end of the grid, has no length.
        """
        begin = self.at(grid)
        end = np.concatenate([begin[:, 1:], begin[:, -1:]], axis=1)
        if self.held:
            last = 3 if self.pivot is None else 4
            end[:last] = begin[:last]
        steps = np.append(np.diff(grid), 1.0)
        return np.ascontiguousarray(np.concatenate([end, (end - begin) / steps]))

    def torques(self, grid: Array, j1: Array, j2: Array, j12: Array) -> Array:
        """What acts on both bodies in the frame of the ground, N m; j1, j2, j12 (n,); returns (n, 2, n_times)."""
        torque1, torque2, ground, _ = self.at(grid)
        first = torque1 - (j1 + j12)[:, None] * ground
        return np.stack([first, torque2 - (j2 + j12)[:, None] * ground], axis=1)

    @cached_property
    def _step(self) -> float:
        return float(np.median(np.diff(self.times))) if self.times.size > 1 else 1.0


def _motion(times: Array, values: Array, quantity: str, held: bool, whose: str) -> dict[str, Array]:
    """Angle, velocity and acceleration at the samples, from an angle that was measured or an acceleration."""
    if quantity == "acceleration":
        return _integrated(times, values, held)
    if held:
        raise ValueError(f"an angle of {whose} held between samples would jump; give its acceleration")
    from scipy.interpolate import CubicSpline  # slow to load, and few rigs are moved so

    spline = CubicSpline(times, values)
    return {"displacement": values, "velocity": spline(times, 1), "acceleration": spline(times, 2)}


def _integrated(times: Array, acceleration: Array, held: bool) -> dict[str, Array]:
    """Acceleration, velocity and angle of a ground at rest at times[0], exact for linear (or held) accelerations."""
    h = np.diff(times)
    left = acceleration[:-1]
    right = left if held else acceleration[1:]
    velocity = np.concatenate([[0.0], np.cumsum(0.5 * h * (left + right))])
    angle = np.concatenate([[0.0], np.cumsum(h * velocity[:-1] + h**2 * (2.0 * left + right) / 6.0)])
    return {"displacement": angle, "velocity": velocity, "acceleration": acceleration}
