"""A campaign: the measured trials of one rig, read from a folder, checked, and written back.

`load_campaign` either returns a `Campaign` or raises `InputError` with every fault of every file at once. What can be
read but looks odd is told in `Campaign.warnings`. Nothing is repaired or dropped here: readings arrive as recorded.
"""

from __future__ import annotations

import csv
import difflib
import gzip
import hashlib
import io
import math
import tomllib
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper import readings as look
from bayes_damper.errors import InputError
from bayes_damper.parameters import unit_of
from bayes_damper.records import USUAL_LAG, departure
from bayes_damper.wording import counted

Array = NDArray[np.float64]
TomlValue = Any  # whatever a TOML file can hold: checked by those who take it

COLUMNS = {
    ("torsional", "acceleration"): ("alpha1_rad_s2", "alpha2_rad_s2"),
    ("torsional", "velocity"): ("omega1_rad_s", "omega2_rad_s"),
    ("torsional", "displacement"): ("theta1_rad", "theta2_rad"),
    ("translational", "acceleration"): ("a1_m_s2", "a2_m_s2"),
    ("translational", "velocity"): ("v1_m_s", "v2_m_s"),
    ("translational", "displacement"): ("x1_m", "x2_m"),
}
INPUT_COLUMN = {"torsional": "torque1_n_m", "translational": "force1_n"}
_TRIAL_COLUMNS = {
    "torsional": ("k1t_n_m_per_rad", "k1t_std_n_m_per_rad", "theta0_deg", "theta0_std_deg"),
    "translational": ("k1_n_per_m", "k1_std_n_per_m", "theta0_mm", "theta0_std_mm"),
}
_TO_SI = {"torsional": math.pi / 180.0, "translational": 1e-3}
_RIG_NUMBERS = (
    "primary_inertia",
    "secondary_inertia",
    "bar_radius",
    "magnet_radius",
    "magnet_pull",
    "ground2_stiffness",
    "inertial_coupling",
)
_RIG_WORDS = {
    "kind": ("torsional", "translational"),
    "normal_force": ("linear", "constant"),
    "restoring": ("linear", "pendulum"),
    "inertial_coupling_law": ("constant", "cosine"),
}
_MEASUREMENT_WORDS = {"quantity": ("acceleration", "velocity", "displacement"), "start": ("rest", "free")}
_MEASUREMENT_NUMBERS = ("sample_rate", "duration", "noise_std", "sensor_range", "sensor_bandwidth")
_SINGLE = {"sample_rate": "Hz", "duration": "s"}
_MEASUREMENT_SPREADS = ("offset_std", "scale_std", "lag_std")  # may be 0: known
PLANNED_PERIODS = 8.0
"""Natural periods of the slowest case that a planned record lasts where no duration is declared."""
_TOP = ("name", "description", "source", "caveats", "rig", "measurement")
_TABLES = {"rig": (*_RIG_NUMBERS, *_RIG_WORDS),
           "measurement": (*_MEASUREMENT_WORDS, *_MEASUREMENT_NUMBERS, *_MEASUREMENT_SPREADS)}  # fmt: skip
_SHORT = 0.8  # of the longest repeat's end, before which a record counts as ending early
_UNLIKE = 0.3  # rms difference over rms, from which repeats are held to be of different channels
_SHOWN = 5  # faults of one kind shown for one file
_TURNED = "; where `init` made the campaign, run it again with --sign -1 (coupled: one for each channel, such as -1 1)"
_LARGEST = 1e30  # number that a record may hold, in any unit: its powers must not overflow
_FEW = 3  # readings at rest, and in the first swing, that tell which way it goes


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
    normal_force: str = "linear"
    restoring: str = "linear"
    inertial_coupling_law: str = "constant"

    @property
    def has_magnet(self) -> bool:
        """Whether pull and face of a magnet are declared, so that effects of a magnet are possible."""
        return self.magnet_pull is not None and self.magnet_radius is not None and self.magnet_pull.value > 0.0


@dataclass(frozen=True)
class Measurement:
    """What was measured and how. Tuples hold one number per channel, in the unit of `quantity` (bandwidth: Hz).

    offset_std : standard uncertainty of what a channel reads at rest, each trial its own; None: a share of the reach
    of displacement channels, and none of others. scale_std : relative, of each channel's scale. lag_std : s, by which a
    channel may have been read before or after its time stamp, as where a logger reads one sensor after the other.
    """

    quantity: str = "acceleration"
    sample_rate: float | None = None
    start: str = "rest"
    noise_std: tuple[float, ...] | None = None
    sensor_range: tuple[float, ...] | None = None
    sensor_bandwidth: tuple[float, ...] | None = None
    duration: float | None = None
    """Length of a record that is planned, s; of measured ones the time column decides."""
    offset_std: tuple[float, ...] | None = None
    scale_std: tuple[float, ...] | None = None
    lag_std: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """One record and what was declared about it.

    times : (n,) s, 0 = nominal release; channels : (n_channels, n), SI; torque : (n,) N m (N) or None;
    theta0 : rad (m), None when the start is free; k1t : N m/rad (N/m)
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

    @property
    def coupled(self) -> bool:
        """Whether the secondary is attached."""
        return self.configuration == "coupled"

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
    """The measured trials of one rig. `sha256` covers every byte that was read, in order."""

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

    @property
    def cases(self) -> tuple[str, ...]:
        """Labels of the cases, in order of appearance."""
        return tuple(dict.fromkeys(t.case for t in self.trials))

    @property
    def k1t_values(self) -> tuple[Constant, ...]:
        """The declared stiffnesses, each once: one parameter each."""
        return tuple(dict.fromkeys(t.k1t for t in self.trials))

    @property
    def coupled(self) -> bool:
        """Whether any trial is coupled."""
        return any(t.coupled for t in self.trials)

    def select(self, case: str | None = None, configuration: str | None = None) -> tuple[Trial, ...]:
        """The trials of a case, of a configuration, or of both."""
        return tuple(t for t in self.trials if case in (None, t.case) and configuration in (None, t.configuration))

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
        groups = _groups(self.trials).values()
        last = {max(group, key=lambda t: t.trial).key for group in groups if len(group) > 1}
        return tuple(t for t in self.trials if t.key in last)

    @property
    def training(self) -> tuple[Trial, ...]:
        """The trials that are not held out."""
        held = {t.key for t in self.heldout}
        return tuple(t for t in self.trials if t.key not in held)

    def describe(self) -> str:
        """A few lines for `check`: what was read, trial by trial, and the warnings."""
        unit = {"torsional": "deg", "translational": "mm"}[self.rig.kind]
        lines = [
            (
                f"{self.name}: {counted(len(self.trials), 'trial')}, {counted(len(self.cases), 'case')}, "
                f"{self.measurement.quantity}, {self.rig.kind} rig, start {self.measurement.start}"
            )
        ]
        held = {t.key for t in self.heldout}
        for t in self.trials:
            angle = "free start" if t.theta0 is None else f"{t.theta0.value / _TO_SI[self.rig.kind]:.3g} {unit}"
            noise = ", ".join(f"{x:.2g}" for x in noise_floor(t))
            lines.append(
                f"  {t.label}: {counted(len(t.times), 'reading')}, {t.times[0]:.4g} to {t.times[-1]:.4g} s, {angle}, "
                f"noise about {noise} {self.reading_unit}{_use_of(t, held)}"
            )
        lines += [f"  warning: {w}" for w in self.warnings]
        return "\n".join(lines)


def _use_of(trial: Trial, held: Collection[tuple[str, str, int]]) -> str:
    """What is told of a trial that not every command fits."""
    if trial.holdout:
        return ", held out of every fit"
    return ", held out by diagnose and variability, fitted by fit" if trial.key in held else ""


def noise_floor(trial: Trial) -> Array:
    """Standard deviation of the white noise of each channel of a trial, in its unit; (n_channels,).

    From differences of order six, see `readings.noise_floor_of`.
    """
    return np.array([look.noise_floor_of(channel) for channel in trial.channels])


def natural_period(rig: Rig, trial: Trial) -> float:
    """Period of the primary alone on its spring, 2 pi sqrt(J1 / k1t), in seconds."""
    return 2.0 * math.pi * math.sqrt(rig.primary_inertia.value / trial.k1t.value)


def record_columns(kind: str, quantity: str, coupled: bool, torque: bool = False) -> tuple[str, ...]:
    """Column names of a record, the time first."""
    first, second = COLUMNS[(kind, quantity)]
    return ("time_s", first, *((second,) if coupled else ()), *((INPUT_COLUMN[kind],) if torque else ()))


def record_text(times: Array, channels: Array, kind: str, quantity: str, torque: Array | None = None) -> str:
    """A record as CSV text, every number so that it reads back exactly; channels : (n_channels, n)."""
    names = record_columns(kind, quantity, len(channels) > 1, torque is not None)
    table = np.column_stack([times, *channels, *(() if torque is None else (torque,))])
    rows = [",".join(map(repr, row)) for row in table.tolist()]
    return "\n".join([",".join(names), *rows]) + "\n"


def load_campaign(folder: str | Path) -> Campaign:
    """Reads and checks a campaign.

    Raises
    ------
    InputError
        with one sentence for every fault of every file.
    """
    folder = Path(folder)
    faults: list[str] = []
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds campaign.toml")
    digest = hashlib.sha256()
    head = _read_head(folder, faults, digest)
    if head is None:
        raise InputError(faults)
    rows = _read_rows(folder, head.rig.kind, head.measurement.start, faults, digest)
    trials = tuple(t for row in rows if (t := _read_trial(folder, row, head, faults, digest)) is not None)
    _check_rig(folder, head.rig, any(row.configuration == "coupled" for row in rows), faults)
    warnings: list[str] = list(head.notes)
    for trial in trials:
        if not head.broken:
            _check_magnitudes(head, trial, faults, warnings)
            _look_at_trial(head, trial, warnings)
    if faults:
        if rows and not any((folder / row.file).exists() for row in rows):
            faults.append("none of the records is there: `bayes-damper plan` judges a campaign before it is measured")
        raise InputError(faults)
    _look_at_repeats(head, trials, warnings)
    both = any(t.coupled for t in trials)
    declared = head.measurement
    measurement = replace(
        declared,
        noise_std=_per_channel(declared.noise_std, both),
        offset_std=_per_channel(declared.offset_std, both),
        scale_std=_per_channel(declared.scale_std, both),
        lag_std=_per_channel(declared.lag_std, both),
    )
    return Campaign(
        head.name,
        head.rig,
        measurement,
        trials,
        head.description,
        head.source,
        head.caveats,
        folder,
        (*head.caveats, *warnings),
        digest.hexdigest(),
    )


def load_plan(folder: str | Path) -> Campaign:
    """A campaign of which nothing, or only a part, has been measured yet.

    The files that trials.csv names may be missing: such a trial has readings of zero at the sample times that
    [measurement] declares (`sample_rate`, `duration`; by default eight natural periods of the slowest case). Records
    that are there are read and checked as ever.

    Raises
    ------
    InputError
        with one sentence for every fault of every file.
    """
    folder = Path(folder)
    faults: list[str] = []
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds campaign.toml")
    digest = hashlib.sha256()
    head = _read_head(folder, faults, digest)
    if head is None:
        raise InputError(faults)
    rows = _read_rows(folder, head.rig.kind, head.measurement.start, faults, digest)
    _check_rig(folder, head.rig, any(row.configuration == "coupled" for row in rows), faults)
    missing = [row for row in rows if not (folder / row.file).exists()]
    rate = head.measurement.sample_rate
    if missing and rate is None:
        faults.append("campaign.toml [measurement]: sample_rate is missing; a plan without records needs it, in Hz")
    if faults or head.broken:
        raise InputError(faults)
    planned = []
    slowest = min((row.k1t.value for row in missing), default=1.0)
    period = 2.0 * math.pi * math.sqrt(head.rig.primary_inertia.value / slowest)
    duration = head.measurement.duration or PLANNED_PERIODS * period
    if missing and rate is not None and duration * rate < 16.0:
        raise InputError(
            f"campaign.toml [measurement]: {duration:.3g} s at {rate:g} Hz are fewer than 16 readings; raise "
            "sample_rate or duration"
        )
    for row in rows:
        if row in missing and rate is not None:
            times = np.arange(round(duration * rate) + 1) / rate
            channels = np.zeros((2 if row.configuration == "coupled" else 1, times.size))
            planned.append(
                Trial(row.file, row.case, row.configuration, row.trial, row.k1t, row.theta0, times, channels,
                      holdout=row.holdout)
            )  # fmt: skip
            continue
        trial = _read_trial(folder, row, head, faults, digest)
        if trial is not None:
            planned.append(trial)
    if faults:
        raise InputError(faults)
    noise = _per_channel(head.measurement.noise_std, any(t.coupled for t in planned))
    measurement = replace(head.measurement, noise_std=noise, duration=duration if missing else None)
    return Campaign(
        head.name, head.rig, measurement, tuple(planned), head.description, head.source, head.caveats, folder,
        (*head.caveats, *head.notes), digest.hexdigest(),
    )  # fmt: skip


# --- campaign.toml -------------------------------------------------------------------------------------------------


@dataclass
class _Head:
    """What campaign.toml says; `broken` when a fault leaves its numbers without meaning."""

    name: str
    description: str
    source: str
    caveats: tuple[str, ...]
    rig: Rig
    measurement: Measurement
    broken: bool
    notes: list[str] = field(default_factory=list)


def _nearest(word: str, names: Iterable[str]) -> str:
    found = difflib.get_close_matches(word, list(names), 1, 0.5)
    return f"did you mean '{found[0]}'?" if found else f"valid names: {', '.join(names)}"


def _read_bytes(path: Path, name: str, faults: list[str], digest: hashlib._Hash) -> bytes | None:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        near = _nearest_file(path)
        hint = f"did you mean {near}?" if near else "put it into the campaign's folder or correct the name"
        faults.append(f"{name}: no such file; {hint}")
        return None
    except OSError as error:
        faults.append(f"{name}: cannot be read ({error.strerror}); give a readable file")
        return None
    digest.update(raw)
    if not raw.strip():
        faults.append(f"{name}: the file is empty; export it again")
        return None
    return raw


def _nearest_file(path: Path) -> str | None:
    """The file that a name may mean: the same with other letters, or with / between the folders."""
    wanted = PurePosixPath(path.as_posix().replace("\\", "/"))
    place = Path(wanted.parent)
    names = sorted(p.name for p in place.iterdir() if p.is_file()) if place.is_dir() else []
    same = [n for n in names if n.lower() == wanted.name.lower()] or difflib.get_close_matches(
        wanted.name, names, 1, 0.9
    )
    return f"{place.name}/{same[0]}" if same else None


def _decode(raw: bytes, name: str, faults: list[str]) -> str | None:
    if b"\0" in raw[:4096]:
        kind = "a spreadsheet or an archive" if raw.startswith(b"PK") else "not plain text (it holds bytes of 0)"
        faults.append(f"{name}: {kind}; save it as plain text in UTF-8, tables as CSV")
        return None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        faults.append(f"{name}, line {line}: not UTF-8 text; save the file as plain text in UTF-8")
        return None


def _read_head(folder: Path, faults: list[str], digest: hashlib._Hash) -> _Head | None:
    name = "campaign.toml"
    if not (folder / name).exists():
        faults.append(f"{folder}: holds no {name}; `bayes-damper init` makes a campaign from logger files")
        return None
    raw = _read_bytes(folder / name, name, faults, digest)
    text = None if raw is None else _decode(raw, name, faults)
    if text is None:
        return None
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        faults.append(f"{name}: not valid TOML: {error}; correct that line")
        return None
    return head_from_table(table, name, faults)


def head_from_table(table: Mapping[str, Any], name: str, faults: list[str]) -> _Head:
    """Checks the keys of a campaign.toml that was read into `table`; faults are appended."""
    before = len(faults)
    for key in table:
        if key not in _TOP:
            home = next((table for table, keys in _TABLES.items() if key in keys), None)
            hint = (
                _nearest(key, _TOP) if home is None else f"it belongs into the table [{home}]: write it below that line"
            )
            faults.append(f"{name}: unknown key '{key}'; {hint}")
    words = {key: _text(table, key, name, faults) for key in ("name", "description", "source")}
    if "name" not in table:
        faults.append(f"{name}: key 'name' is missing; give the campaign a name, name = \"...\"")
    caveats = table.get("caveats", [])
    if not isinstance(caveats, list) or not all(isinstance(c, str) for c in caveats):
        faults.append(f"{name}: 'caveats' must be a list of sentences in quotes")
        caveats = []
    rig = _read_rig(_subtable(table, "rig", name, faults), name, faults)
    measurement = _read_measurement(_subtable(table, "measurement", name, faults), name, faults)
    broken = len(faults) > before
    return _Head(words["name"], words["description"], words["source"], tuple(caveats), rig, measurement, broken)


def _text(table: Mapping[str, Any], key: str, name: str, faults: list[str]) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or (key == "name" and key in table and not value.strip()):
        faults.append(f"{name}: '{key}' must be text in quotes, not {value!r}")
        return ""
    return value


def _subtable(table: Mapping[str, Any], key: str, name: str, faults: list[str]) -> Mapping[str, Any]:
    value = table.get(key, {})
    if key == "rig" and key not in table:
        faults.append(f"{name}: table [rig] is missing; it must give at least primary_inertia")
    if not isinstance(value, dict):
        faults.append(f"{name}: '{key}' must be a table, [{key}], not {value!r}")
        return {}
    return value


def _read_words(
    table: Mapping[str, Any], words: Mapping[str, tuple[str, ...]], where: str, faults: list[str]
) -> dict[str, str]:
    found = {}
    for key, valid in words.items():
        value = table.get(key, valid[0])
        if value not in valid:
            faults.append(f"{where}: {key} = {value!r} is not one of {', '.join(valid)}; {_nearest(str(value), valid)}")
            value = valid[0]
        found[key] = value
    return found


def _read_rig(table: Mapping[str, Any], name: str, faults: list[str]) -> Rig:
    where = f"{name} [rig]"
    for key in table:
        if key not in (*_RIG_WORDS, *_RIG_NUMBERS):
            faults.append(f"{where}: unknown key '{key}'; {_nearest(key, (*_RIG_WORDS, *_RIG_NUMBERS))}")
    words = _read_words(table, _RIG_WORDS, where, faults)
    numbers = {
        key: constant
        for key in _RIG_NUMBERS
        if key in table and (constant := constant_from(table[key], f"{where}: {key}", faults)) is not None
    }
    for key, constant in numbers.items():
        _check_constant(key, constant, words["kind"], where, faults)
    if table and "primary_inertia" not in table:
        faults.append(
            f"{where}: key 'primary_inertia' is missing; give J1 in kg m^2 (kg), or 1 when all is per unit inertia"
        )
    if words["kind"] == "translational":
        numbers.setdefault("bar_radius", Constant(1.0))
        if numbers["bar_radius"] != Constant(1.0):
            faults.append(f"{where}: bar_radius is 1 on a translational rig; remove the key")
    numbers.setdefault("primary_inertia", Constant(1.0))
    return Rig(**numbers, **words)  # type: ignore[arg-type]


def constant_from(value: TomlValue, where: str, faults: list[str]) -> Constant | None:
    """A `Constant` from a number or a table {value, std}; None, and a fault, when it is neither."""
    std: Any = 0.0
    if isinstance(value, dict):
        for key in value:
            if key not in ("value", "std"):
                faults.append(f"{where}: unknown key '{key}'; {_nearest(key, ('value', 'std'))}")
        if "value" not in value:
            faults.append(f"{where}: key 'value' is missing; write {{ value = ..., std = ... }}")
            return None
        value, std = value["value"], value.get("std", 0.0)
    for number in (value, std):
        if isinstance(number, bool) or not isinstance(number, int | float):
            faults.append(f"{where} must be a number or {{ value = ..., std = ... }}, not {number!r}")
            return None
    if not (math.isfinite(value) and math.isfinite(std)):
        faults.append(f"{where} must be finite, not {value!r} with std {std!r}")
        return None
    if std < 0.0:
        faults.append(f"{where}: std = {std!r} is negative; give a standard uncertainty of 0 or more")
        return None
    return Constant(float(value), float(std))


def _check_constant(key: str, constant: Constant, kind: str, where: str, faults: list[str]) -> None:
    value = constant.value
    if key in ("primary_inertia", "secondary_inertia", "bar_radius", "magnet_radius") and value <= 0.0:
        faults.append(f"{where}: {key} = {value!r} must be positive; give it in SI units")
    if key in ("magnet_pull", "ground2_stiffness") and value < 0.0:
        faults.append(f"{where}: {key} = {value!r} must not be negative; give it in SI units")
    if key in ("bar_radius", "magnet_radius") and value > 10.0 and kind == "torsional":
        faults.append(f"{where}: {key} = {value!r} m is not a laboratory rig; it looks like millimetres, give metres")


def _read_measurement(table: Mapping[str, Any], name: str, faults: list[str]) -> Measurement:
    where = f"{name} [measurement]"
    valid = (*_MEASUREMENT_WORDS, *_MEASUREMENT_NUMBERS, *_MEASUREMENT_SPREADS)
    for key in table:
        if key not in valid:
            faults.append(f"{where}: unknown key '{key}'; {_nearest(key, valid)}")
    words = _read_words(table, _MEASUREMENT_WORDS, where, faults)
    tuples = {k: _positives(table[k], f"{where}: {k}", faults) for k in _MEASUREMENT_NUMBERS if k in table}
    tuples |= {k: _positives(table[k], f"{where}: {k}", faults, zero=True) for k in _MEASUREMENT_SPREADS if k in table}
    single: dict[str, float | None] = {}
    for key, unit in _SINGLE.items():
        found = tuples.pop(key, None)
        if found is not None and len(found) != 1:
            faults.append(f"{where}: {key} must be one number, in {unit}")
        single[key] = found[0] if found else None
    return Measurement(**words, **tuples, **single)  # type: ignore[arg-type]


def _positives(value: TomlValue, where: str, faults: list[str], zero: bool = False) -> tuple[float, ...] | None:
    values = value if isinstance(value, list) else [value]
    for number in values:
        if isinstance(number, bool) or not isinstance(number, int | float):
            faults.append(f"{where} must be a number, or one number per channel, not {number!r}")
            return None
        if not (math.isfinite(number) and (number > 0.0 or (zero and number == 0.0))):
            faults.append(f"{where} = {number!r} must be {'0 or more' if zero else 'positive'} and finite")
            return None
    if not 1 <= len(values) <= 2:
        faults.append(f"{where} has {len(values)} entries; give one number, or one per channel")
        return None
    return tuple(float(v) for v in values)


def _per_channel(values: tuple[float, ...] | None, coupled: bool) -> tuple[float, ...] | None:
    if values is None or len(values) == 2 or not coupled:
        return values
    return values * 2


def _check_rig(folder: Path, rig: Rig, coupled: bool, faults: list[str]) -> None:
    where = "campaign.toml [rig]"
    if not coupled:
        return
    if rig.secondary_inertia is None:
        faults.append(f"{where}: secondary_inertia is missing; a coupled trial needs J2 in kg m^2 (kg)")
    elif rig.inertial_coupling.value and (
        rig.inertial_coupling.value**2 >= rig.primary_inertia.value * rig.secondary_inertia.value
    ):
        faults.append(f"{where}: inertial_coupling must be smaller than sqrt(J1 J2): no rig has such an inertia matrix")
    if _friction_fixed_at_zero(folder):
        return
    needed = {"bar_radius": "R, m", "magnet_pull": "N0, N, the force that presses the faces together"}
    if rig.normal_force == "linear":
        needed["magnet_radius"] = "r, m"
    for key, unit in needed.items():
        if getattr(rig, key) is None:
            faults.append(
                f"{where}: {key} ({unit}) is missing; a coupled trial needs it for the friction between the bodies, "
                "mu N0 R; where nothing rubs, write mu = 0.0 into a file priors.toml in the campaign's folder"
            )


def _friction_fixed_at_zero(folder: Path) -> bool:
    """Whether the campaign's own priors.toml fixes mu at 0; a file that cannot be read is told by the prior reader."""
    try:
        table = tomllib.loads((folder / "priors.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    for found in (table.get("mu"), *(t.get("mu") for t in table.values() if isinstance(t, dict))):
        value = found.get("value") if isinstance(found, dict) else found
        if isinstance(value, int | float) and not isinstance(value, bool) and value == 0:
            return True
    return False


# --- trials.csv ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Row:
    """One row of trials.csv that could be read."""

    file: str
    case: str
    configuration: str
    trial: int
    k1t: Constant
    theta0: Constant | None
    holdout: bool
    line: int


def _read_rows(folder: Path, kind: str, start: str, faults: list[str], digest: hashlib._Hash) -> list[_Row]:
    name = "trials.csv"
    raw = _read_bytes(folder / name, name, faults, digest)
    text = None if raw is None else _decode(raw, name, faults)
    if text is None:
        return []
    reader = csv.reader(io.StringIO(text))
    header = [cell.strip() for cell in next(reader, [])]
    if not _check_header(header, kind, start, name, faults):
        return []
    rows: list[_Row] = []
    seen: dict[tuple[str, str, int], int] = {}
    files: dict[str, int] = {}
    count = 0
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        count += 1
        where = f"{name}, line {reader.line_num}"
        if len(cells) != len(header):
            hint = (
                "a field with a comma in it needs quotes, and numbers need decimal points"
                if len(cells) > len(header)
                else "fill in what is missing; an empty field needs its comma too"
            )
            faults.append(f"{where}: {len(cells)} fields where the header has {len(header)}; {hint}")
            continue
        row = _row_from({k: c.strip() for k, c in zip(header, cells, strict=True)}, kind, start, where, faults)
        if row is None:
            continue
        row = replace(row, line=reader.line_num)
        key = (row.case, row.configuration, row.trial)
        if key in seen:
            faults.append(
                f"{where}: case {key[0]}, {key[1]}, trial {key[2]} is already on line {seen[key]}; number it anew"
            )
        if row.file in files:
            faults.append(f"{where}: {row.file} is already the record of line {files[row.file]}; a record counts once")
        seen.setdefault(key, row.line)
        files.setdefault(row.file, row.line)
        rows.append(row)
    if count == 0:
        faults.append(f"{name}: no trials; write one row for each record")
    return rows


def _check_header(header: list[str], kind: str, start: str, name: str, faults: list[str]) -> bool:
    k1t, k1t_std, theta0, theta0_std = _TRIAL_COLUMNS[kind]
    needed = ["file", "case", "configuration", k1t, "trial", *([theta0] if start == "rest" else [])]
    valid = (*dict.fromkeys([*needed, k1t_std, theta0, theta0_std, "holdout"]),)
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        faults.append(f"{name}: columns are not separated by commas; save it with commas and decimal points")
        return False
    other = _TRIAL_COLUMNS["translational" if kind == "torsional" else "torsional"]
    for column in header:
        if column in other:
            right = _TRIAL_COLUMNS[kind][other.index(column)]
            faults.append(f"{name}: column '{column}' does not belong to a {kind} rig; use '{right}', or change kind")
        elif column not in valid:
            faults.append(f"{name}: unknown column '{column}'; {_nearest(column, valid)}")
    for column in {c for c in header if header.count(c) > 1}:
        faults.append(f"{name}: column '{column}' appears twice; remove one")
    missing = [column for column in needed if column not in header]
    faults.extend(f"{name}: column '{column}' is missing; add it" for column in missing)
    return not missing


def _row_from(cells: Mapping[str, str], kind: str, start: str, where: str, faults: list[str]) -> _Row | None:
    before = len(faults)
    k1t_name, k1t_std_name, theta0_name, theta0_std_name = _TRIAL_COLUMNS[kind]
    for key in ("file", "case"):
        if not cells[key]:
            faults.append(f"{where}: '{key}' is empty; fill it in")
    if cells["file"] and not _inside(cells["file"]):
        faults.append(f"{where}: {cells['file']} leaves the campaign's folder; give a relative path inside it")
    configuration = cells["configuration"]
    if configuration not in ("uncoupled", "coupled"):
        hint = _nearest(configuration, ("uncoupled", "coupled"))
        faults.append(f"{where}: configuration '{configuration}' is not uncoupled or coupled; {hint}")
    number = _number(cells["trial"], f"{where}, trial", faults)
    if number is not None and (number != int(number) or number < 0):
        faults.append(f"{where}: trial '{cells['trial']}' is not a whole number; count from 1")
    k1t = _number(cells[k1t_name], f"{where}, {k1t_name}", faults)
    if k1t is not None and k1t <= 0.0:
        faults.append(f"{where}: {k1t_name} = {k1t!r} must be positive; give it in N m/rad (N/m)")
    k1t_std = _number(cells.get(k1t_std_name, "") or "0", f"{where}, {k1t_std_name}", faults)
    theta0 = _theta0_from(cells, theta0_name, theta0_std_name, kind, start, where, faults)
    if k1t_std is not None and k1t_std < 0.0:
        faults.append(f"{where}: {k1t_std_name} = {k1t_std!r} is negative; give a standard uncertainty of 0 or more")
    mark = cells.get("holdout", "").lower()
    if mark not in ("", "true", "false", "0", "1"):
        faults.append(f"{where}: holdout '{mark}' is not true or false; write one of them")
    if len(faults) > before or number is None or k1t is None or k1t_std is None:
        return None
    return _Row(
        cells["file"],
        cells["case"],
        configuration,
        int(number),
        Constant(k1t, k1t_std),
        theta0,
        mark in ("true", "1"),
        0,
    )


def _theta0_from(
    cells: Mapping[str, str], name: str, std_name: str, kind: str, start: str, where: str, faults: list[str]
) -> Constant | None:
    text, std_text = cells.get(name, ""), cells.get(std_name, "")
    if start == "free":
        if text:
            faults.append(f'{where}: {name} is given but start = "free"; leave it empty or set start = "rest"')
        return None
    if not text:
        faults.append(f'{where}: {name} is empty; give the release angle, or set start = "free" in campaign.toml')
        return None
    value = _number(text, f"{where}, {name}", faults)
    std = _number(std_text, f"{where}, {std_name}", faults) if std_text else None
    if value is None:
        return None
    if kind == "torsional" and abs(value) > 360.0:
        faults.append(f"{where}: {name} = {value!r} is more than a turn; give degrees")
    if std is not None and std <= 0.0:
        faults.append(f"{where}: {std_name} = {std!r} must be positive; leave it empty for the larger of 0.1 and 2 %")
        return None
    if std is None:
        std = max(0.1, 0.02 * abs(value))
    return Constant(value * _TO_SI[kind], std * _TO_SI[kind])


def _number(text: str, where: str, faults: list[str]) -> float | None:
    try:
        value = float(text)
    except ValueError:
        faults.append(f"{where}: '{text}' is not a number; write digits with a decimal point")
        return None
    if not math.isfinite(value):
        faults.append(f"{where}: '{text}' is not finite; give the number")
        return None
    return value


def _inside(name: str) -> bool:
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ":" in path.parts[0]:
        return False
    depth = 0
    for part in path.parts:
        depth += -1 if part == ".." else 1
        if depth < 0:
            return False
    return True


# --- records -------------------------------------------------------------------------------------------------------


def _read_trial(folder: Path, row: _Row, head: _Head, faults: list[str], digest: hashlib._Hash) -> Trial | None:
    name = f"{row.file} (trials.csv, line {row.line})"
    raw = _read_bytes(folder / row.file, name, faults, digest)
    if raw is None:
        return None
    if row.file.endswith(".gz"):
        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error):
            faults.append(f"{name}: not a whole gzip file; compress it again or give it uncompressed")
            return None
    text = _decode(raw, name, faults)
    if text is None:
        return None
    header, _, body = text.partition("\n")
    wanted = _columns_of(header, row, head, name, faults)
    if wanted is None:
        return None
    table = _numbers_of(body, len(header.split(",")), header.split(","), name, faults)
    if table is None:
        return None
    columns = [np.ascontiguousarray(table[:, i]) for i in wanted]
    if not _check_sizes(columns, [header.split(",")[i].strip().strip('"') for i in wanted], name, faults):
        return None
    n_channels = 2 if row.configuration == "coupled" else 1
    times, channels = columns[0], np.stack(columns[1 : 1 + n_channels])
    torque = columns[1 + n_channels] if len(columns) > 1 + n_channels else None
    trial = Trial(
        row.file, row.case, row.configuration, row.trial, row.k1t, row.theta0, times, channels, torque, row.holdout
    )
    for array in (times, channels, *(() if torque is None else (torque,))):
        array.setflags(write=False)
    return trial if _check_times(trial, head, name, faults) else None


def _columns_of(header: str, row: _Row, head: _Head, name: str, faults: list[str]) -> list[int] | None:
    """Indices of time, channels and, where there is one, the input."""
    kind, quantity, coupled = head.rig.kind, head.measurement.quantity, row.configuration == "coupled"
    names = [cell.strip().strip('"') for cell in header.split(",")]
    if len(names) == 1 and any(mark in header for mark in ";\t"):
        faults.append(
            f"{name}: columns are not separated by commas; write commas and "
            "decimal points, or import it with `bayes-damper init`"
        )
        return None
    needed = list(record_columns(kind, quantity, coupled))
    missing = [column for column in needed if column not in names]
    source = INPUT_COLUMN[kind]
    spare = record_columns(kind, quantity, True, True)
    for column in missing:
        reason = f"expected {', '.join(needed)}, found {', '.join(names)}"
        other = [f'{k}, quantity = "{q}"' for (k, q), pair in COLUMNS.items() if set(pair) & set(names)]
        if coupled and column == COLUMNS[(kind, quantity)][1] and len(missing) == 1:
            hint = "a coupled trial needs its second channel: add it or call the trial uncoupled"
        elif other and column != "time_s":
            hint = f"these are the columns of kind = {other[0]}: correct campaign.toml or the names"
        else:
            hint = "name the columns so, or import the file with `bayes-damper init`"
        faults.append(f"{name}, line 1: column '{column}' is missing ({reason}); {hint}")
    for column in names:
        if column not in spare and column not in missing and difflib.get_close_matches(column, [source], 1, 0.8):
            faults.append(f"{name}, line 1: column '{column}' is not known; did you mean '{source}'?")
        elif column not in (*needed, source) and not missing:
            head.notes.append(
                f"{row.file}: column '{column}' is not used; remove it, or correct its name if it should be"
            )
    repeated = [c for c in (*needed, source) if names.count(c) > 1]
    faults.extend(f"{name}, line 1: column '{c}' appears twice; remove one" for c in repeated)
    if missing or repeated:
        return None
    return [names.index(c) for c in (*needed, *((source,) if source in names else ()))]


def _numbers_of(body: str, width: int, header: list[str], name: str, faults: list[str]) -> Array | None:
    """The table of numbers below the header, (n, width); None when any cell is not a finite number."""
    if not body.strip():
        faults.append(f"{name}: no readings below the header; export the record again")
        return None
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None)
    except ValueError:
        table = None
    if table is not None and table.shape[1] == width and np.isfinite(table).all():
        return table
    try:
        rows = list(csv.reader(io.StringIO(body, newline=None)))  # a lone carriage return ends a line too
    except csv.Error as error:
        faults.append(f"{name}: no table of numbers ({error}); export the record again")
        return None
    before = len(faults)
    _name_bad_cells(rows, width, header, name, faults)
    if len(faults) > before:
        return None
    filled = [row for row in rows if any(cell.strip() for cell in row)]
    if not filled:
        faults.append(f"{name}: no readings below the header; export the record again")
        return None
    return np.array([[float(cell) for cell in row] for row in filled])  # quoted numbers and the like


def _check_sizes(columns: Sequence[Array], names: Sequence[str], name: str, faults: list[str]) -> bool:
    """Whether all numbers of a record are such that one can reckon with them; a fault for each column with others."""
    before = len(faults)
    for column, values in zip(names, columns, strict=True):
        beyond = np.flatnonzero(np.abs(values) > _LARGEST)
        if len(beyond):
            first = int(beyond[0])
            faults.append(
                f"{name}, column '{column}': {counted(len(beyond), 'number')} beyond reason, the first "
                f"{values[first]:.4g} as reading {first + 1}; remove such lines (gaps are allowed), or check the units "
                "of the record"
            )
    return len(faults) == before


def _name_bad_cells(rows: Sequence[Sequence[str]], width: int, header: list[str], name: str, faults: list[str]) -> None:
    bad: list[str] = []
    for line, cells in enumerate(rows, start=2):
        if not cells or not any(c.strip() for c in cells):
            continue
        if len(cells) != width:
            hint = (
                "decimal commas? write decimal points, or import it with `bayes-damper init`"
                if len(cells) > width
                else ("complete or remove the line")
            )
            bad.append(f"{name}, line {line}: {counted(len(cells), 'field')} where the header has {width}; {hint}")
            continue
        for column, cell in zip(header, cells, strict=True):
            try:
                finite = math.isfinite(float(cell))
            except ValueError:
                what = f"'{cell.strip()}' is not a number" if cell.strip() else "the cell is empty"
                bad.append(f"{name}, line {line}, column '{column.strip()}': {what}; correct it or remove the line")
            else:
                if not finite:
                    bad.append(
                        f"{name}, line {line}, column '{column.strip()}': {cell.strip()} "
                        "is no reading; remove the line (gaps are allowed)"
                    )
    faults.extend(bad[:_SHOWN])
    if len(bad) > _SHOWN:
        faults.append(f"{name}: {len(bad) - _SHOWN} more such faults; correct the export")


def _check_times(trial: Trial, head: _Head, name: str, faults: list[str]) -> bool:
    times = trial.times
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        i = int(back[0])
        faults.append(
            f"{name}, line {i + 3}: time_s does not increase ({times[i]:.9g} s, then {times[i + 1]:.9g} s"
            f"{f', and {len(back) - 1} more places' if len(back) > 1 else ''}); "
            "sort the rows, or write the time with more digits"
        )
        return False
    if head.broken:
        return True
    period = natural_period(head.rig, trial)
    steps = np.diff(times)
    rate = head.measurement.sample_rate
    if len(steps) and (
        (rate and 300.0 < np.median(steps) * rate < 3000.0) or (not rate and np.median(steps) > 0.5 * period)
    ):
        faults.append(
            f"{name}: time_s runs from {times[0]:.6g} to {times[-1]:.6g} in steps of {np.median(steps):.4g}, where one "
            f"natural period is {period:.4g} s{f' and sample_rate {rate:.6g} Hz' if rate else ''}; it looks like "
            "milliseconds: give seconds, as `bayes-damper init` with --time-unit ms makes them of the logger's file "
            "(or correct k1t, J1)"
        )
        return False
    duration = times[-1] - max(times[0], 0.0)
    if duration < period:
        faults.append(
            f"{name}: {duration:.4g} s of motion is less than one natural period, {period:.4g} s (2 pi sqrt(J1/k1t)); "
            "record longer, or correct the unit of time, k1t or primary_inertia"
        )
        return False
    return True


# --- orders of magnitude -------------------------------------------------------------------------------------------


def _check_magnitudes(head: _Head, trial: Trial, faults: list[str], warnings: list[str]) -> None:
    """Compares each channel with what the declared release can produce: wrong units show as factors of 57, 1000, R."""
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[head.measurement.quantity]
    centred = trial.channels[0] - (0.0 if power else float(np.median(trial.channels[0])))
    largest = float(np.quantile(np.abs(centred), 1.0 - min(0.002, 2.0 / len(centred))))
    names = COLUMNS[(head.rig.kind, head.measurement.quantity)]
    if np.ptp(trial.channels[0]) == 0.0:
        faults.append(f"{trial.file}, column '{names[0]}': every reading is the same; the sensor was not connected?")
        return
    if trial.torque is not None and np.any(trial.torque != 0.0):
        return
    if trial.theta0 is None:
        _check_free_magnitude(head, trial, largest / omega**power, names[0], faults, warnings)
        return
    if trial.theta0.value == 0.0:
        faults.append(f"{trial.file}: released from 0 without a torque, nothing can move; correct theta0 in trials.csv")
        return
    largest = (
        float(np.quantile(np.abs(trial.channels[0]), 1.0 - min(0.002, 2.0 / len(centred)))) if not power else largest
    )
    bound = abs(trial.theta0.value) * omega**power
    formula = {0: "theta0", 1: "theta0 sqrt(k1t/J1)", 2: "k1t theta0/J1"}[power]
    ratio = largest / bound
    unit = names[0].partition("1_")[2].replace("_", "/")
    sentence = (
        f"{trial.file}, column '{names[0]}': the largest reading, {largest:.4g} {unit}, is {ratio:.3g} times "
        f"{formula} = {bound:.4g} {unit}, the most that this release can give"
    )
    if ratio > 10.0 or ratio < 0.03:
        faults.append(f"{sentence}; {_unit_guess(head.rig, ratio, power)}")
    elif ratio > 2.0 or ratio < 0.2:
        warnings.append(f"{sentence}; {_unit_guess(head.rig, ratio, power)}")


def _unit_guess(rig: Rig, ratio: float, power: int) -> str:
    """Which confusion of units a ratio far from one looks like, as advice."""
    radius = rig.bar_radius.value if rig.bar_radius is not None else 0.1
    torsional = rig.kind == "torsional"
    guesses: dict[str, float] = {"k1t, the inertia or the release are in another unit than declared": 1e6}
    if torsional:
        guesses["it looks like degrees taken for radians: give radians in the record, degrees in theta0_deg"] = 57.3
        if power == 2:
            guesses[
                "it looks like g at the mounting radius: convert to rad/s^2, or import it with `bayes-damper init`"
            ] = radius / 9.81
            guesses[
                "it looks like m/s^2 at the mounting radius: convert to rad/s^2, or import it with `bayes-damper init`"
            ] = radius
            guesses["it looks like g at the mounting radius: convert to rad/s^2 with `bayes-damper init`"] = (
                radius / 9.81
            )
    else:
        guesses["it looks like millimetres taken for metres: give SI units in the record, mm in theta0_mm"] = 1000.0
        guesses["it looks like metres given as theta0_mm, or the like: theta0_mm is in millimetres"] = 1e-3
        if power == 2:
            guesses["it looks like g: give m/s^2"] = 1.0 / 9.81
    best = min(guesses, key=lambda text: abs(math.log(0.8 * guesses[text] / ratio)))
    near = abs(math.log(0.8 * guesses[best] / ratio)) < math.log(4.0)
    return best if near else "check the units of the record, of theta0, k1t and primary_inertia"


def _check_free_magnitude(
    head: _Head, trial: Trial, swing: float, column: str, faults: list[str], warnings: list[str]
) -> None:
    """Without a declared release: the swing that the readings imply, rad or m, must be possible."""
    where = f"{trial.file}, column '{column}': the readings imply a swing of {swing:.4g}"
    if head.rig.kind == "translational":
        if swing > 10.0:
            faults.append(f"{where} m; it looks like millimetres taken for metres: give SI units in the record")
        elif swing > 1.0:
            warnings.append(f"{where} m; if these are millimetres, give metres")
        return
    y = trial.channels[0] - np.median(trial.channels[0])
    to_and_fro = int(np.count_nonzero(np.diff(np.sign(y)) != 0)) >= 4
    if swing > 20.0 or (swing > 3.5 and to_and_fro):
        faults.append(f"{where} rad to and fro; it looks like degrees taken for radians: give radians in the record")
    elif swing > 1.6 and head.rig.restoring == "linear":
        warnings.append(f'{where} rad; if these are degrees, give radians; if it hangs, set restoring = "pendulum"')


# --- oddities ------------------------------------------------------------------------------------------------------


def _look_at_trial(head: _Head, trial: Trial, warnings: list[str]) -> None:
    """Everything about one record that can be handled but should be known."""
    _look_at_clock(head, trial, warnings)
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    held = head.measurement.quantity == "displacement" and head.measurement.start == "rest"
    coupled = len(trial.channels) > 1
    given = _per_channel(head.measurement.noise_std, coupled)
    limits = _per_channel(head.measurement.sensor_range, coupled)
    for i, y in enumerate(trial.channels):
        where = f"{trial.file}, column '{COLUMNS[(head.rig.kind, head.measurement.quantity)][i]}'"
        noise = look.noise_floor_of(y)
        step = look.resolution_of(y)
        if np.ptp(y) == 0.0:
            warnings.append(f"{where}: every reading is the same; the sensor looks dead")
            continue
        if step > noise:
            warnings.append(f"{where}: quantised in steps of {step:.3g}; noise below that cannot be seen")
        slowest = 2.0 * math.pi * look.dominant_frequency(trial.times, y)  # of a coupled rig's slow mode: round tops
        for level in look.flat_tops_of(trial.times, y, noise, min(omega, max(slowest, 0.25 * omega)), held):
            warnings.append(f"{where}: flat tops at {level:.4g}; it looks clipped there")
        if limits is not None and np.max(np.abs(y)) > 0.98 * limits[i]:
            warnings.append(f"{where}: readings reach the sensor's range of {limits[i]:.4g}; it may be clipped")
        spikes = look.outliers_of(trial.times, y, noise, omega)
        if spikes:
            some = ", ".join(f"{trial.times[j]:.4g}" for j in spikes[:_SHOWN])
            more = f" and {len(spikes) - _SHOWN} more" if len(spikes) > _SHOWN else ""
            warnings.append(
                f"{where}: 1 single reading sticks out, at {some} s; it looks like an outlier"
                if len(spikes) == 1
                else f"{where}: {len(spikes)} single readings stick out, at {some} s{more}; they look like outliers"
            )
        offset = look.offset_of(trial.times, y, noise, omega)
        if offset and not (head.rig.restoring == "pendulum" and held):
            warnings.append(f"{where}: rests at {offset:.3g} at the end, not at 0; the sensor has an offset")
        if given is not None and noise > 0.0 and not 1.0 / 3.0 <= noise / given[i] <= 3.0:
            warnings.append(
                f"{where}: noise is about {noise:.3g}, noise_std says {given[i]:.3g}; check unit and sensor"
            )
    if head.measurement.start == "rest" and trial.theta0 is not None:
        _look_at_release(head, trial, omega, warnings)


def _look_at_clock(head: _Head, trial: Trial, warnings: list[str]) -> None:
    times = trial.times
    step = float(np.median(np.diff(times)))
    rate = head.measurement.sample_rate
    if rate is not None and abs(step * rate - 1.0) > 0.02:
        warnings.append(
            f"{trial.file}: the time column says {1.0 / step:.5g} Hz, "
            f"sample_rate says {rate:.5g}; the time column decides"
        )
    uneven = look.unevenness_of(times)
    if uneven > 0.01:
        warnings.append(f"{trial.file}: time is uneven: steps depart from {step:.4g} s by up to {100.0 * uneven:.0f} %")
    gaps = look.gaps_of(times)
    if gaps:
        longest = max(gaps, key=lambda g: g[1] - g[0])
        warnings.append(
            f"{trial.file}: {counted(len(gaps), 'gap')} in time, {'the longest ' if len(gaps) > 1 else ''}"
            f"from {longest[0]:.4g} to {longest[1]:.4g} s"
        )
    if times[0] > 1.5 * step:
        warnings.append(f"{trial.file}: late start: the record begins {times[0]:.4g} s after the nominal release")


def _look_at_release(head: _Head, trial: Trial, omega: float, warnings: list[str]) -> None:
    """Late trigger, start in the middle of the motion, reversed sign: told from the first readings."""
    y, times = trial.channels[0], trial.times
    noise = look.noise_floor_of(y)
    quantity = head.measurement.quantity
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[quantity]
    assert trial.theta0 is not None
    sign = math.copysign(1.0, trial.theta0.value) * (1.0 if power == 0 else -1.0)
    level = abs(trial.theta0.value) if power == 0 else 0.0
    driven = trial.torque is not None and bool(np.any(trial.torque != 0.0))
    if not driven and (onset_away := _moves_the_wrong_way(times, sign * y, quantity, omega)) is not None:
        place = "on the other side of 0 than theta0" if power == 0 else "at rest"
        then = "" if power == 0 else " and then begins to move away from its rest position, not towards it"
        warnings.append(
            f"{trial.file}: the primary is held {place} until {onset_away:.4g} s{then}; the sign of the channel "
            f"looks reversed (or that of theta0 in trials.csv){_TURNED}"
        )
        y = -y
    away, bound = departure(y, quantity, trial.theta0.value)
    departed = away > bound
    if not departed.any():
        return
    onset = float(times[int(np.argmax(departed))])
    step = float(np.median(np.diff(times)))
    early = trial.times[0] < -1.5 * step and onset < -1.5 * step
    if early:
        warnings.append(
            f"{trial.file}: motion begins {-onset:.4g} s before the nominal release; the trigger came late; "
            "fits take the release from the record"
        )
    if onset > USUAL_LAG[quantity] / omega + 1.5 * step and times[0] <= 1.5 * step:
        warnings.append(
            f"{trial.file}: motion begins {onset:.4g} s after the nominal "
            "release; the trigger came early or the rig stuck; fits take the release from the record"
        )
    first = float(np.median(y[:3]))
    largest = float(np.max(np.abs(y)))
    middle = {0: sign * first < 0.8 * level, 1: abs(first) > 0.3 * largest, 2: False}[power]
    soon = min(int(np.searchsorted(times, onset + 0.13 / omega)), len(y) - 1)
    if power == 2 and abs(first) <= 8.0 * noise and onset < times[0] + 0.3 / omega:  # no jump where a release jumps
        middle = sign * y[soon] < 0.4 * float(np.quantile(np.abs(y), 0.998))
    if power == 2 and abs(first) > 8.0 * noise:
        middle = sign * first < 0.4 * float(np.quantile(np.abs(y), 0.998))
    away_at_once = power == 1 and not driven and _moves_the_wrong_way(times, sign * y, quantity, omega, 0.0) is not None
    if times[0] <= 1.5 * step and not early and (middle or away_at_once):
        reversed_sign = away_at_once or (power != 1 and sign * first < -0.3 * largest)
        looks = "the sign of the channel looks reversed, or " if reversed_sign else ""
        warnings.append(
            f"{trial.file}: the first readings are not those of a release; "
            f"{looks}the record begins after the motion began{_TURNED if reversed_sign else ''}"
        )


def _moves_the_wrong_way(times: Array, y: Array, quantity: str, omega: float, rest: float = 1.0) -> float | None:
    """When the motion begins, in s, where a primary that is held at first then moves as if released on the other side.

    None where it moves as it should, or where the record holds too little to tell: a shorter rest (what is shorter than
    a radian of the oscillation may be a turning point), or fewer than three readings of the first swing.

    y : (n,) the readings, times the sign that they should have at first; omega : rad/s of the primary on its spring;
    rest : rad of that oscillation
    """
    largest = float(np.quantile(np.abs(y), 0.998))
    held = float(np.median(y[:_FEW])) if quantity == "displacement" else 0.0
    moving = np.abs(y - held) > max(8.0 * look.noise_floor_of(y), 0.05 * float(np.max(np.abs(y))))
    lasting = moving[:-2] & moving[1:-1] & moving[2:]
    k = int(np.argmax(lasting)) if lasting.any() else 0
    if times[k] - times[0] < rest / omega or (rest > 0.0 and k < _FEW):
        return None
    if quantity == "displacement":
        return float(times[k]) if held < -0.3 * largest else None
    if quantity == "velocity":  # grows for a quarter of a period
        swing = y[k : k + 1 + int(np.argmax(np.abs(y[k:]) > 0.5 * largest))]
        soon = times[k + len(swing) - 1] - times[k] < math.pi / omega
    else:  # jumps at once
        swing = y[k:][times[k:] <= times[k] + 0.8 / omega]
        soon = True
    wrong = soon and len(swing) >= _FEW and bool(np.all(swing < 0.0))
    return float(times[k]) if wrong and (quantity == "velocity" or np.median(swing) < -0.4 * largest) else None


def _groups(trials: Iterable[Trial]) -> dict[tuple[str, str], list[Trial]]:
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.case, trial.configuration), []).append(trial)
    return groups


def _look_at_repeats(head: _Head, trials: Sequence[Trial], warnings: list[str]) -> None:
    stiffness: dict[str, set[float]] = {}
    for trial in trials:
        stiffness.setdefault(trial.case, set()).add(trial.k1t.value)
    for case, values in stiffness.items():
        if len(values) > 1:
            warnings.append(
                f"trials.csv: case {case} has several k1t "
                f"({', '.join(f'{v:g}' for v in sorted(values))}); one case is one spring"
            )
    single = [f"{case} {configuration}" for (case, configuration), g in _groups(trials).items() if len(g) == 1]
    if single:
        warnings.append(
            f"trials.csv: only one trial of {', '.join(single)}: its repeatability is unknown"
            + ("" if any(t.holdout for t in trials) else ", and it is not held out")
        )
    if all(t.holdout for t in trials):
        warnings.append("trials.csv: every trial is marked holdout; nothing is left to train on")
    _look_for_copies(trials, warnings)
    for group in _groups(trials).values():
        _look_for_short_twin(group, warnings)
        if head.measurement.start == "rest" and not _look_for_exchanged_twin(group, warnings) and len(group) > 2:
            _look_for_odd_twin(group, head.measurement.quantity, warnings)


def _look_for_copies(trials: Sequence[Trial], warnings: list[str]) -> None:
    """Names trials whose readings are those of an earlier one: noise never repeats itself."""
    seen: dict[bytes, Trial] = {}
    for trial in trials:
        first = seen.setdefault(np.ascontiguousarray(trial.channels[0]).tobytes(), trial)
        if first is not trial:
            warnings.append(
                f"{trial.file}: holds the same readings as {first.file}: a trial that is there twice counts twice and "
                "hides how trials scatter; remove one of them"
            )


def _look_for_short_twin(group: Sequence[Trial], warnings: list[str]) -> None:
    """Names repeats that end much earlier than the longest one."""
    ends = [float(t.times[-1]) for t in group]
    short = [f"{t.file} at {end:.4g} s" for t, end in zip(group, ends, strict=True) if end < _SHORT * max(ends)]
    if short:
        some = ", ".join(short[:_SHOWN]) + (f" and {len(short) - _SHOWN} more" if len(short) > _SHOWN else "")
        warnings.append(
            f"case {group[0].case} {group[0].configuration}: repeats of different length: {some}, the longest at "
            f"{max(ends):.4g} s; every record is used to its end, but how repeats scatter is seen only where two of "
            "them last: was one cut off?"
        )


def _look_for_odd_twin(group: Sequence[Trial], quantity: str, warnings: list[str]) -> None:
    """Compares repeats of equal release with each other; one that is four times as far off as the rest is named.

    Each runs from the onset of its own motion, and the jump there is left out: a late trigger is no other motion.
    """
    clocks = [t.times - _onset(t, quantity) for t in group]
    steps = [float(np.median(np.diff(t.times))) for t in group]
    start, end = max(c[0] for c in clocks), min(c[-1] for c in clocks)
    inside = (clocks[0] >= max(start, 2.0 * max(steps))) & (clocks[0] <= end)
    grid = clocks[0][inside]
    if len(grid) < 8:
        warnings.append(f"{group[0].file} and its repeats hardly overlap in time; they cannot be compared")
        return
    for channel in range(len(group[0].channels)):
        curves = np.stack(
            [np.interp(grid, c, t.channels[channel]) / _release(t) for c, t in zip(clocks, group, strict=True)]
        )
        distance = np.sqrt(np.mean((curves[:, None] - curves[None]) ** 2, axis=-1))
        noise = max(look.noise_floor_of(c) for c in curves)
        scale = float(np.sqrt(np.median(np.mean(curves**2, axis=-1))))
        for i, trial in enumerate(group):
            others = np.delete(np.delete(distance, i, 0), i, 1)
            usual = float(np.median(others[np.triu_indices(len(group) - 1, 1)]))
            nearest = float(np.min(np.delete(distance[i], i)))
            if nearest > 4.0 * usual and nearest > max(0.1 * scale, 4.0 * noise):
                warnings.append(
                    f"{trial.file}: unlike its repeats: {nearest / scale:.0%} away from "
                    f"the nearest, they {usual / scale:.0%} from each other"
                )
                break


def _look_for_exchanged_twin(group: Sequence[Trial], warnings: list[str]) -> bool:
    """Names coupled repeats that are like the others only with their channels exchanged; whether there are any."""
    found = [_apart(group[0], other) for other in group[1:]]
    crossed = [straight > _UNLIKE and exchanged < 0.5 * straight for straight, exchanged in found]
    if not any(crossed):
        return False
    odd = [other for other, mark in zip(group[1:], crossed, strict=True) if mark]
    even = [group[0], *(other for other, mark in zip(group[1:], crossed, strict=True) if not mark)]
    fewer, more = sorted((odd, even), key=len)
    straight, exchanged = found[crossed.index(True)]
    told = (
        f"unlike: {straight:.0%} apart as they are, {exchanged:.0%} with the channels of one exchanged; correct the "
        "order of the columns"
    )
    if len(fewer) == len(more):
        warnings.append(
            f"{', '.join(t.file for t in even)} and {', '.join(t.file for t in odd)}: repeats {told} of one"
        )
    else:
        warnings.append(f"{', '.join(t.file for t in fewer)}: channels exchanged? It and its repeats are {told}")
    return True


def _apart(a: Trial, b: Trial) -> tuple[float, float]:
    """Rms difference of two repeats over the rms of the first, as they are and with the channels of one exchanged.

    (0, 0) where they cannot be compared: one channel only, or hardly any time in common.
    """
    inside = (a.times >= b.times[0]) & (a.times <= b.times[-1])
    if len(a.channels) < 2 or np.count_nonzero(inside) < 8:
        return 0.0, 0.0
    x = a.channels[:, inside] / _release(a)
    y = np.stack([np.interp(a.times[inside], b.times, channel) for channel in b.channels]) / _release(b)
    size = float(np.sqrt(np.mean(x**2))) or 1.0
    return float(np.sqrt(np.mean((x - y) ** 2))) / size, float(np.sqrt(np.mean((x - y[::-1]) ** 2))) / size


def _onset(trial: Trial, quantity: str) -> float:
    """Time of the first reading that has left the held rig, in s; that of the first reading where none has."""
    if trial.theta0 is None:
        return 0.0
    away, bound = departure(trial.channels[0], quantity, trial.theta0.value)
    return float(trial.times[int(np.argmax(away > bound))])


def _release(trial: Trial) -> float:
    return trial.theta0.value if trial.theta0 is not None and trial.theta0.value else 1.0


# --- writing -------------------------------------------------------------------------------------------------------


def write_campaign(folder: str | Path, campaign: Campaign, overwrite: bool = False) -> Path:
    """Writes campaign.toml, trials.csv and the records so that `load_campaign` gives the same campaign back.

    Raises
    ------
    InputError
        if the folder already holds a campaign and `overwrite` is not set.
    """
    folder = Path(folder)
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(campaign_toml(campaign), encoding="utf-8")
    (folder / "trials.csv").write_text(trials_csv(campaign), encoding="utf-8")
    for trial in campaign.trials:
        path = folder / trial.file
        path.parent.mkdir(parents=True, exist_ok=True)
        text = record_text(trial.times, trial.channels, campaign.rig.kind, campaign.measurement.quantity, trial.torque)
        raw = text.encode()
        path.write_bytes(gzip.compress(raw, mtime=0) if trial.file.endswith(".gz") else raw)
    return folder


COMMENTS = {
    "kind": "torsional, or translational (m, kg, N)",
    "primary_inertia": "J1, kg m^2 (kg); 1 for a rig known only per unit inertia",
    "secondary_inertia": "J2, kg m^2 (kg)",
    "bar_radius": "R, m",
    "magnet_radius": "r, m",
    "magnet_pull": "N0, N",
    "ground2_stiffness": "k3t, N m/rad (N/m), spring from the secondary to ground",
    "inertial_coupling": "J12, kg m^2 (kg)",
    "inertial_coupling_law": "constant, or cosine: J12 cos(th1 - th2), as of two links",
    "normal_force": "linear in the overlap of the faces, or constant",
    "restoring": "linear spring, or pendulum",
    "quantity": "acceleration, velocity or displacement",
    "start": "rest: released at rest from theta0; free: initial angles and velocities are inferred",
    "sample_rate": "Hz; the time column decides",
    "duration": "s, of a record that is planned; the time column decides",
    "noise_std": "prior value of the noise, one per channel",
    "sensor_range": "largest reading, one per channel",
    "sensor_bandwidth": "Hz, one per channel",
    "offset_std": "standard uncertainty of the reading at rest, one per channel, in SI units",
    "scale_std": "relative standard uncertainty of the scale, one per channel",
    "lag_std": "s, standard uncertainty of the instant of reading against the time stamp, one per channel",
}


def campaign_toml(campaign: Campaign) -> str:
    """campaign.toml as text, each key with what it means."""
    lines = [f"name = {quoted(campaign.name)}"]
    for key in ("description", "source"):
        if getattr(campaign, key):
            lines.append(f"{key} = {quoted(getattr(campaign, key))}")
    if campaign.caveats:
        lines += [
            "caveats = [  # told as warnings by every command",
            *(f"    {quoted(c)}," for c in campaign.caveats),
            "]",
        ]
    lines += ["", "[rig]"]
    for key in ("kind", *_RIG_NUMBERS, "normal_force", "restoring", "inertial_coupling_law"):
        value = getattr(campaign.rig, key)
        if key == "inertial_coupling_law" and not campaign.rig.inertial_coupling.value:
            continue
        if value is not None and not (key == "bar_radius" and campaign.rig.kind == "translational"):
            lines.append(f"{key} = {_toml(value)}  # {COMMENTS[key]}")
    lines += ["", "[measurement]"]
    for key in ("quantity", "start", *_MEASUREMENT_NUMBERS, *_MEASUREMENT_SPREADS):
        value = getattr(campaign.measurement, key)
        if value is not None:
            lines.append(f"{key} = {_toml(value)}  # {COMMENTS[key]}")
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    for mark, name in (("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t")):
        escaped = escaped.replace(mark, name)
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'


def _toml(value: Constant | str | float | tuple[float, ...]) -> str:
    if isinstance(value, Constant):
        return f"{{ value = {value.value!r}, std = {value.std!r} }}" if value.uncertain else repr(value.value)
    if isinstance(value, tuple):
        return "[" + ", ".join(map(repr, value)) + "]"
    return quoted(value) if isinstance(value, str) else repr(value)


def trials_csv(campaign: Campaign) -> str:
    """trials.csv as text; columns that no trial needs are left out."""
    kind = campaign.rig.kind
    k1t, k1t_std, theta0, theta0_std = _TRIAL_COLUMNS[kind]
    uncertain = any(t.k1t.uncertain for t in campaign.trials)
    marked = any(t.holdout for t in campaign.trials)
    rest = campaign.measurement.start == "rest"
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = ["file", "case", "configuration", k1t, *([k1t_std] if uncertain else [])]
    names += [*([theta0, theta0_std] if rest else []), "trial", *(["holdout"] if marked else [])]
    writer.writerow(names)
    for t in campaign.trials:
        cells: list[Any] = [
            t.file,
            t.case,
            t.configuration,
            repr(t.k1t.value),
            *([repr(t.k1t.std)] if uncertain else []),
        ]
        if rest and t.theta0 is not None:
            cells += [_declared(t.theta0.value, _TO_SI[kind]), _declared(t.theta0.std, _TO_SI[kind])]
        cells += [t.trial, *([str(t.holdout).lower()] if marked else [])]
        writer.writerow(cells)
    return out.getvalue()


def _declared(value: float, unit: float) -> str:
    """A number in degrees (mm), as short as reads back to the same SI value."""
    scaled = value / unit
    for digits in range(1, 18):
        text = f"{scaled:.{digits}g}"
        if float(text) * unit == value:
            return text
    return repr(scaled)
