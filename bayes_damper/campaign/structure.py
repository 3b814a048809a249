"""What a campaign is: rig, measurement, trials, and the names of its columns."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look
from bayes_damper.rig.inputs import Inputs
from bayes_damper.rig.parameters import unit_of
from bayes_damper.rig.units import BODIES
from bayes_damper.text import counted, gathered

Array = NDArray[np.float64]
COLUMNS = {
    ("torsional", "acceleration"): ("alpha1_rad_s2", "alpha2_rad_s2"),
    ("torsional", "velocity"): ("omega1_rad_s", "omega2_rad_s"),
    ("torsional", "displacement"): ("theta1_rad", "theta2_rad"),
    ("translational", "acceleration"): ("a1_m_s2", "a2_m_s2"),
    ("translational", "velocity"): ("v1_m_s", "v2_m_s"),
    ("translational", "displacement"): ("x1_m", "x2_m"),
}
INPUT_COLUMNS = {
    "torsional": (
        *("torque1_n_m", "torque2_n_m", "ground_rad", "ground_rad_s2", "motion1_rad", "motion1_rad_s2", "pivot_m_s2"),
    ),
    "translational": (*("force1_n", "force2_n", "ground_m", "ground_m_s2", "motion1_m", "motion1_m_s2", "pivot_m_s2"),),
}
"""Measured inputs in the order of `INPUTS`."""
INPUTS = ("torque", "torque2", "ground", "ground_acceleration", "motion", "motion_acceleration", "pivot")
MOTIONS = ("motion", "motion_acceleration")
"""Those of `INPUTS` that prescribe how the primary moves: channel 1 is then the reaction."""
REACTION = {"torsional": "reaction1_n_m", "translational": "reaction1_n"}
TRIAL_COLUMNS = {
    "torsional": ("k1t_n_m_per_rad", "k1t_std_n_m_per_rad", "theta0_deg", "theta0_std_deg"),
    "translational": ("k1_n_per_m", "k1_std_n_per_m", "theta0_mm", "theta0_std_mm"),
}
TO_SI = {"torsional": math.pi / 180.0, "translational": 1e-3}
RIG_NUMBERS = (
    "primary_inertia",
    "secondary_inertia",
    "bar_radius",
    "magnet_radius",
    "magnet_pull",
    "ground2_stiffness",
    "inertial_coupling",
)
RIG_WORDS = {
    "kind": ("torsional", "translational"),
    "normal_force": ("linear", "constant"),
    "restoring": ("linear", "pendulum"),
    "inertial_coupling_law": ("constant", "cosine"),
}
MEASUREMENT_WORDS = {
    "quantity": ("acceleration", "velocity", "displacement"),
    "start": ("rest", "free"),
    "frame": ("absolute", "ground"),
    "input": ("linear", "held"),
    "units": ("assumed", "declared"),
}
MEASUREMENT_NUMBERS = ("sample_rate", "duration", "noise_std", "sensor_range", "sensor_bandwidth", "every")
SCATTER_RELATIVE = ("k1t", "k2t", "c1t", "c2t", "c3t", "mu", "drag", "drag_ratio", "gain", "gain1", "gain2")
SCATTER_SIZES = ("offset", "offset1", "offset2", "drift", "drift1", "drift2", "release_time")  # in SI units
MEASUREMENT_SPREADS = ("offset_std", "scale_std", "lag_std")  # may be 0: known
SHOWN = 5  # faults of one kind shown for one file


@dataclass(frozen=True)
class Constant:
    """A declared number with its standard uncertainty (0: taken as known)."""

    value: float
    std: float = 0.0

    @property
    def uncertain(self) -> bool:
        """Whether it is to be inferred, with this Gaussian as prior."""
        return self.std > 0.0


@dataclass(frozen=True)
class Rig:
    """The rig's own constants, SI: kg m^2, N m/rad, m, N (torsional) or kg, N/m, m, N (translational)."""

    primary_inertia: Constant
    secondary_inertia: Constant | None = None
    bar_radius: Constant | None = None
    magnet_radius: Constant | None = None
    magnet_pull: Constant | None = None
    ground2_stiffness: Constant = Constant(0.0)
    inertial_coupling: Constant = Constant(0.0)
    kind: str = "torsional"
    normal_force: Literal["linear", "constant"] = "linear"
    restoring: Literal["linear", "pendulum"] = "linear"
    inertial_coupling_law: Literal["constant", "cosine"] = "constant"

    @property
    def has_magnet(self) -> bool:
        """Whether pull and face of a magnet are declared, so that effects of a magnet are possible."""
        return self.magnet_pull is not None and self.magnet_radius is not None and self.magnet_pull.value > 0.0

    def describe(self) -> str:
        """The declared numbers in a line, with what shows a wrong unit: the weight that a magnet lifts."""
        unit = "kg m^2" if self.kind == "torsional" else "kg"
        first, second = BODIES[self.kind]
        parts = [f"{first} {self.primary_inertia.value:.4g} {unit}"]
        if self.secondary_inertia is not None:
            parts.append(f"{second} {self.secondary_inertia.value:.4g} {unit}")
        if self.magnet_pull is not None and self.magnet_pull.value > 0.0:
            pull = self.magnet_pull.value
            parts.append(f"faces pressed together with {pull:.4g} N")
            if self.magnet_radius is not None:
                weight, radius = pull / 9.80665, 1e3 * self.magnet_radius.value
                parts[-1] += f", the weight of {weight:.3g} kg, over a radius of {radius:.3g} mm"
        return "rig: " + "; ".join(parts)


@dataclass(frozen=True)
class Measurement:
    """What was measured and how. Tuples hold one number per channel, in the unit of `quantity` (bandwidth: Hz).

    offset_std : standard uncertainty of what a channel reads at rest, each trial its own; None: a share of the reach
    of displacement channels, and none of others. scale_std : relative, of each channel's scale. lag_std : s, by which a
    channel may have been read before or after its time stamp, as where a logger reads one sensor after the other.
    """

    quantity: Literal["acceleration", "velocity", "displacement"] = "acceleration"
    sample_rate: float | None = None
    start: Literal["rest", "free"] = "rest"
    noise_std: tuple[float, ...] | None = None
    sensor_range: tuple[float, ...] | None = None
    sensor_bandwidth: tuple[float, ...] | None = None
    duration: float | None = None
    """Length of a record that is planned, s; of measured ones the time column decides."""
    every: int | None = None
    """One reading in so many is used by fits; None: all, or fewer where a large campaign was sampled very fast."""
    offset_std: tuple[float, ...] | None = None
    scale_std: tuple[float, ...] | None = None
    lag_std: tuple[float, ...] | None = None
    frame: Literal["absolute", "ground"] = "absolute"
    """Where the ground moves: whether readings count from space, or from the ground."""
    input: str = "linear"
    """What measured inputs do between samples: "linear", or "held" until the next."""
    units: str = "assumed"
    """Whether the logger file or who imported it named the unit: "declared" readings are in no other one."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One record and what was declared about it.

    times : (n,) s, 0 = nominal release; channels : (n_channels, n), SI; theta0 : rad (m), None when the start is free;
    k1t : N m/rad (N/m). Measured inputs, (n,) or None: torque and torque2 : N m (N) on primary and secondary;
    ground : rad (m), or ground_acceleration : rad/s^2 (m/s^2); motion : rad (m) of a primary whose motion is
    prescribed, or motion_acceleration : its acceleration. The first channel is then the reaction, N m (N). pivot :
    m/s^2, sideways acceleration of a pendulum's pivot. cut : whether the record has its length on purpose.
    """

    file: str
    case: str
    configuration: str
    trial: int
    k1t: Constant
    theta0: Constant | None
    times: Array
    channels: Array
    torque: Array | None = None
    holdout: bool = False
    cut: bool = False
    torque2: Array | None = None
    ground: Array | None = None
    ground_acceleration: Array | None = None
    motion: Array | None = None
    motion_acceleration: Array | None = None
    pivot: Array | None = None

    @property
    def prescribed(self) -> bool:
        """Whether the motion of the primary is an input."""
        return self.motion is not None or self.motion_acceleration is not None

    @property
    def coupled(self) -> bool:
        """Whether the secondary is attached."""
        return self.configuration == "coupled"

    @property
    def driven(self) -> bool:
        """Whether a measured torque or the ground acts at some time, or the primary's motion is prescribed."""
        return self.prescribed or any(bool(np.any(x != 0.0)) for x in self.given)

    @property
    def given(self) -> tuple[Array, ...]:
        """The measured inputs that there are."""
        return tuple(x for name in INPUTS if (x := getattr(self, name)) is not None)

    def inputs(self, measurement: Measurement) -> Inputs | None:
        """The measured inputs as a simulation takes them; None where there are none."""
        if not self.given:
            return None
        angle, moved = self.ground is not None, self.motion is not None
        return Inputs.measured(
            self.times,
            self.torque,
            self.torque2,
            ground=self.ground if angle else self.ground_acceleration,
            ground_quantity="displacement" if angle else "acceleration",
            quantity=measurement.quantity,
            frame=measurement.frame,
            held=measurement.input == "held",
            motion=self.motion if moved else self.motion_acceleration,
            motion_quantity="displacement" if moved else "acceleration",
            pivot=self.pivot,
        )

    @property
    def key(self) -> tuple[str, str, int]:
        """Case, configuration and number: unique within a campaign."""
        return self.case, self.configuration, self.trial

    @property
    def label(self) -> str:
        """Words that name the trial."""
        return f"{self.case} {self.configuration} #{self.trial}"


@dataclass(frozen=True, eq=False)
class Campaign:
    """The measured trials of one rig. `sha256` covers every byte that was read, in order.

    scatter : expected size by which something differs from trial to trial, by name: relative (SCATTER_RELATIVE) or in
    SI units, the release angle `theta0` in rad (m) among them.
    """

    name: str
    rig: Rig
    measurement: Measurement
    trials: tuple[Trial, ...]
    description: str = ""
    source: str = ""
    caveats: tuple[str, ...] = ()
    folder: Path | None = None
    warnings: tuple[str, ...] = ()
    sha256: str = ""
    scatter: Mapping[str, float] = field(default_factory=dict)

    @property
    def cases(self) -> tuple[str, ...]:
        """Labels of the cases, in order of appearance."""
        return tuple(dict.fromkeys(t.case for t in self.trials))

    @property
    def coupled(self) -> bool:
        """Whether any trial is coupled."""
        return any(t.coupled for t in self.trials)

    @property
    def reading_unit(self) -> str:
        """Unit of a reading, e.g. "rad/s^2"."""
        return unit_of("sigma1", self.rig.kind, self.measurement.quantity)

    @property
    def heldout(self) -> tuple[Trial, ...]:
        """Trials for held-out figures: the marked ones, or the last of each case and configuration.

        A case and configuration of one single trial keeps it for training: nothing would be left to learn from.
        """
        if any(t.holdout for t in self.trials):
            return tuple(t for t in self.trials if t.holdout)
        groups = groups_of(self.trials).values()
        last = {max(group, key=lambda t: t.trial).key for group in groups if len(group) > 1}
        return tuple(t for t in self.trials if t.key in last)

    @property
    def fitted_cases(self) -> tuple[str, ...]:
        """The cases of which a trial is left that is not marked holdout."""
        return tuple(dict.fromkeys(t.case for t in self.trials if not t.holdout))

    @property
    def training(self) -> tuple[Trial, ...]:
        """The trials that are not held out."""
        held = {t.key for t in self.heldout}
        return tuple(t for t in self.trials if t.key not in held)

    def describe(self) -> str:
        """A few lines for `check`: what was read, trial by trial, and the warnings."""
        unit = {"torsional": "deg", "translational": "mm"}[self.rig.kind]
        rig = "pendulum" if self.rig.restoring == "pendulum" else f"{self.rig.kind} rig"
        lines = [
            (
                f"{self.name}: {counted(len(self.trials), 'trial')}, {counted(len(self.cases), 'case')}, "
                f"{self.measurement.quantity}, {rig}, start {self.measurement.start}"
            )
        ]
        lines += [f"  {self.rig.describe()}"]
        held = {t.key for t in self.heldout}
        for t in self.trials:
            angle = "free start" if t.theta0 is None else f"{t.theta0.value / TO_SI[self.rig.kind]:.3g} {unit}"
            units = [unit_of("friction_torque", self.rig.kind) if t.prescribed else self.reading_unit]
            units += [self.reading_unit] * (len(t.channels) - 1)
            floors = [f"{x:.2g}" for x in noise_floor(t)]
            noise = (
                " ".join([", ".join(floors), units[0]])
                if len(set(units)) == 1
                else ", ".join(f"{x} {u}" for x, u in zip(floors, units, strict=True))
            )
            begun = f"{BODIES[self.rig.kind][0]} moved as prescribed" if t.prescribed else angle
            lines.append(
                f"  {t.label}: {counted(len(t.times), 'reading')}, {t.times[0]:.4g} to {t.times[-1]:.4g} s, {begun}, "
                f"noise about {noise}{_use_of(t, held)}"
            )
        lines += [f"  warning: {w}" for w in gathered(self.warnings)]
        return "\n".join(lines)


def _use_of(trial: Trial, held: Collection[tuple[str, str, int]]) -> str:
    """What the description of a trial says where not every command fits it."""
    if trial.holdout:
        return ", held out of every fit"
    return ", held out by diagnose and variability" if trial.key in held else ""


def noise_floor(trial: Trial) -> Array:
    """Standard deviation of the white noise of each channel of a trial, in its unit; (n_channels,).

    From differences of order six, see `readings.noise_floor_of`.
    """
    return np.array([look.noise_floor_of(channel, trial.times) for channel in trial.channels])


def natural_period(rig: Rig, trial: Trial) -> float:
    """Period of the primary alone on its spring, 2 pi sqrt(J1 / k1t), in seconds."""
    return 2.0 * math.pi * math.sqrt(rig.primary_inertia.value / trial.k1t.value)


def record_columns(kind: str, quantity: str, coupled: bool, inputs: Collection[str] = ()) -> tuple[str, ...]:
    """Column names of a record, the time first; inputs : those of `INPUTS` that it has."""
    first, second = COLUMNS[(kind, quantity)]
    first = REACTION[kind] if set(inputs) & set(MOTIONS) else first
    given = [column for name, column in zip(INPUTS, INPUT_COLUMNS[kind], strict=True) if name in inputs]
    return ("time_s", first, *((second,) if coupled else ()), *given)


def channel_columns(trial: Trial, kind: str, quantity: str) -> tuple[str, ...]:
    """Column names of the channels of a trial."""
    moved = MOTIONS if trial.prescribed else ()
    return record_columns(kind, quantity, trial.coupled, moved)[1 : 1 + len(trial.channels)]


def record_text(
    times: Array, channels: Array, kind: str, quantity: str, inputs: Mapping[str, Array | None] | None = None
) -> str:
    """A record as CSV text, every number so that it reads back exactly; channels : (n_channels, n).

    inputs : name of `INPUTS` -> (n,), or None.
    """
    given = {name: x for name in INPUTS if (x := (inputs or {}).get(name)) is not None}
    names = record_columns(kind, quantity, len(channels) > 1, given)
    table = np.column_stack([times, *channels, *given.values()])
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    return "\n".join([",".join(names), *rows]) + "\n"


def groups_of(trials: Iterable[Trial]) -> dict[tuple[str, str], list[Trial]]:
    """Trials by case and configuration, in the order in which they come."""
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.case, trial.configuration), []).append(trial)
    return groups
