"""The records: one file a trial, every cell a number, times that rise."""

from __future__ import annotations

import difflib
import hashlib
import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look
from bayes_damper.campaign.files import decoded, read_bytes
from bayes_damper.campaign.head import Head
from bayes_damper.campaign.structure import (
    COLUMNS,
    INPUT_COLUMNS,
    INPUTS,
    MOTIONS,
    REACTION,
    SHOWN,
    Trial,
    natural_period,
    record_columns,
)
from bayes_damper.campaign.trials_table import Row
from bayes_damper.inputs import LARGEST, collected, csv_rows, in_lines, number_in, shown, unpacked
from bayes_damper.text import counted

Array = NDArray[np.float64]
_THOUSAND = (300.0, 3000.0)  # times the declared step, of times that are in milliseconds
_COARSE = 0.5  # of a natural period, above which steps are too long to be in seconds
_SWINGS = 3.0  # of a record, which give a frequency


def read_trial(folder: Path, row: Row, head: Head, faults: list[str], digest: hashlib._Hash) -> Trial | None:
    """A trial with its record, read and checked; None, and faults, if it cannot be used."""
    name = f"{row.file} (trials.csv, line {row.line})"
    raw = read_bytes(folder / row.file, name, faults, digest)
    if raw is None:
        return None
    if row.file.endswith(".gz"):
        packed, raw = raw, None
        with collected(faults):
            raw = unpacked(packed, name)
    text = None if raw is None else decoded(raw, name, faults)
    if text is None:
        return None
    header, _, body = in_lines(text).partition("\n")
    wanted = _columns_of(header, row, head, name, faults)
    if wanted is None:
        return None
    table = _numbers_of(body, len(header.split(",")), header.split(","), name, faults)
    if table is None:
        return None
    columns = [np.ascontiguousarray(table[:, i]) for i in wanted]
    names = [cell.strip().strip('"') for cell in header.split(",")]
    if not _check_sizes(columns, [names[i] for i in wanted], name, faults):
        return None
    n_channels = 2 if row.configuration == "coupled" else 1
    times, channels = columns[0], np.stack(columns[1 : 1 + n_channels])
    known = dict(zip(INPUT_COLUMNS[head.rig.kind], INPUTS, strict=True))
    inputs = {known[names[i]]: x for i, x in zip(wanted[1 + n_channels :], columns[1 + n_channels :], strict=True)}
    trial = Trial(
        row.file, row.case, row.configuration, row.trial, row.k1t, row.theta0, times, channels, holdout=row.holdout,
        cut=row.cut, **inputs,
    )  # fmt: skip
    for array in (times, channels, *inputs.values()):
        array.setflags(write=False)
    return trial if _check_inputs(trial, head, name, faults) and _check_times(trial, head, name, faults) else None


def _check_inputs(trial: Trial, head: Head, name: str, faults: list[str]) -> bool:
    """Whether the rig can take what a record says acted on it; a fault for each input that it cannot."""
    columns = dict(zip(INPUTS, INPUT_COLUMNS[head.rig.kind], strict=True))
    torque2, angle, acceleration = (columns[key] for key in ("torque2", "ground", "ground_acceleration"))
    before = len(faults)
    motion, accelerated = columns["motion"], columns["motion_acceleration"]
    if trial.prescribed and any(x is not None for x in (trial.torque, trial.ground, trial.ground_acceleration)):
        faults.append(
            f"{name}: a motion of the primary that is prescribed ('{motion}', '{accelerated}') leaves no room for "
            f"'{columns['torque']}', which is then part of the reaction, nor for a moving ground; remove one of them"
        )
    moving = trial.ground is not None or trial.ground_acceleration is not None
    if trial.pivot is not None and head.rig.restoring != "pendulum":
        faults.append(
            f"{name}: column '{columns['pivot']}' is the motion of a pendulum's pivot; set restoring = "
            '"pendulum", or give the motion of the ground'
        )
    if trial.pivot is not None and (trial.prescribed or moving):
        faults.append(
            f"{name}: column '{columns['pivot']}' leaves no room for a motion of the ground or one that is imposed on "
            "the primary; remove one of them"
        )
    if trial.motion is not None and trial.motion_acceleration is not None:
        faults.append(f"{name}: columns '{motion}' and '{accelerated}' are one motion of the primary; keep one")
    if trial.motion is not None and head.measurement.input == "held":
        faults.append(
            f"{name}: column '{motion}' would jump from sample to sample, as campaign.toml says with input = 'held'; "
            f"give '{accelerated}', or input = 'linear'"
        )
    if trial.torque2 is not None and not trial.coupled:
        faults.append(f"{name}: column '{torque2}' acts on the secondary, which an uncoupled trial lacks; remove it")
    if trial.ground is not None and trial.ground_acceleration is not None:
        faults.append(f"{name}: columns '{angle}' and '{acceleration}' are one motion of the ground; keep one")
    if trial.ground is not None and head.measurement.input == "held":
        faults.append(
            f"{name}: column '{angle}' would jump from sample to sample, as campaign.toml says with input = 'held'; "
            f"give '{acceleration}', or input = 'linear'"
        )
    if moving and head.rig.restoring == "pendulum":
        faults.append(
            f'{name}: a ground that turns cannot be taken into account where restoring = "pendulum", since gravity '
            f"does not turn with it; give a linear spring, or '{columns['pivot']}' where the pivot is moved sideways"
        )
    if trial.given and trial.coupled and head.rig.inertial_coupling_law == "cosine":
        faults.append(
            f'{name}: measured inputs cannot be taken into account where inertial_coupling_law = "cosine"; leave out '
            + ", ".join(column for key, column in columns.items() if getattr(trial, key) is not None)
        )
    return len(faults) == before


def _columns_of(header: str, row: Row, head: Head, name: str, faults: list[str]) -> list[int] | None:
    """Indices of time, channels and the inputs that there are."""
    kind, quantity, coupled = head.rig.kind, head.measurement.quantity, row.configuration == "coupled"
    names = [cell.strip().strip('"') for cell in header.split(",")]
    if len(names) == 1 and any(mark in header for mark in ";\t"):
        faults.append(
            f"{name}: columns are not separated by commas; write commas and "
            "decimal points, or import it with `bayes-damper init`"
        )
        return None
    moved = [key for key, column in zip(INPUTS, INPUT_COLUMNS[kind], strict=True) if key in MOTIONS and column in names]
    needed = list(record_columns(kind, quantity, coupled, moved))[: 2 + coupled]
    missing = [column for column in needed if column not in names]
    sources = INPUT_COLUMNS[kind]
    spare = (*record_columns(kind, quantity, True), *sources)
    for column in missing:
        reason = f"expected {', '.join(needed)}, found {', '.join(names)}"
        other = [f'{k}, quantity = "{q}"' for (k, q), pair in COLUMNS.items() if set(pair) & set(names)]
        if coupled and column == COLUMNS[(kind, quantity)][1] and len(missing) == 1:
            hint = "a coupled trial needs its second channel: add it or call the trial uncoupled"
        elif moved and column == REACTION[kind]:
            hint = "where the primary's motion is prescribed, its channel is the torque (force) that this takes"
        elif other and column != "time_s":
            hint = f"these are the columns of kind = {other[0]}: correct campaign.toml or the names"
        else:
            hint = "name the columns so, or import the file with `bayes-damper init`"
        faults.append(f"{name}, line 1: column '{column}' is missing ({reason}); {hint}")
    for column in names:
        near = difflib.get_close_matches(column, sources, 1, 0.8)
        if column not in spare and column not in missing and near:
            faults.append(f"{name}, line 1: column '{column}' is not known; did you mean '{near[0]}'?")
        elif column not in (*needed, *sources) and not missing:
            head.notes.append(
                f"{row.file}: column '{column}' is not used; remove it, or correct its name if it should be"
            )
    repeated = [c for c in (*needed, *sources) if names.count(c) > 1]
    faults.extend(f"{name}, line 1: column '{c}' appears twice; remove one" for c in repeated)
    if missing or repeated:
        return None
    return [names.index(c) for c in (*needed, *(source for source in sources if source in names))]


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
    before = len(faults)
    rows: list[tuple[int, list[str]]] = []
    with collected(faults):
        rows = csv_rows(body, name, first=2)
    _name_bad_cells(rows, width, header, name, faults)
    if len(faults) > before:
        return None
    filled = [cells for _, cells in rows if any(cell.strip() for cell in cells)]
    if not filled:
        faults.append(f"{name}: no readings below the header; export the record again")
        return None
    return np.array([[number_in(cell) for cell in cells] for cells in filled])  # quoted numbers and the like


def _check_sizes(columns: Sequence[Array], names: Sequence[str], name: str, faults: list[str]) -> bool:
    """Whether all numbers of a record are such that one can reckon with them; a fault for each column with others."""
    before = len(faults)
    for column, values in zip(names, columns, strict=True):
        beyond = np.flatnonzero(np.abs(values) > LARGEST)
        if len(beyond):
            first = int(beyond[0])
            faults.append(
                f"{name}, column '{column}': {counted(len(beyond), 'number')} beyond reason, the first "
                f"{values[first]:.4g} as reading {first + 1}; remove such lines (gaps are allowed), or check the units "
                "of the record"
            )
    return len(faults) == before


def _name_bad_cells(
    rows: Sequence[tuple[int, list[str]]], width: int, header: list[str], name: str, faults: list[str]
) -> None:
    bad: list[str] = []
    for line, cells in rows:
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
                finite = math.isfinite(number_in(cell))
            except ValueError:
                what = f"{shown(cell.strip())} is not a number" if cell.strip() else "the cell is empty"
                bad.append(f"{name}, line {line}, column '{column.strip()}': {what}; correct it or remove the line")
            else:
                if not finite:
                    bad.append(
                        f"{name}, line {line}, column '{column.strip()}': {cell.strip()[:60]} "
                        "is no reading; remove the line (gaps are allowed)"
                    )
    faults.extend(bad[:SHOWN])
    if len(bad) > SHOWN:
        faults.append(f"{name}: {len(bad) - SHOWN} more such faults; correct the export")


def _check_times(trial: Trial, head: Head, name: str, faults: list[str]) -> bool:
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
        (rate and _THOUSAND[0] < np.median(steps) * rate < _THOUSAND[1] and 1e-3 * np.ptp(times) > period)
        or (not rate and np.median(steps) > _COARSE * period)
    ):
        unit = ("microseconds", "us") if 1e-3 * np.median(steps) > _COARSE * period else ("milliseconds", "ms")
        faults.append(
            f"{name}: time_s runs from {times[0]:.6g} to {times[-1]:.6g} in steps of {np.median(steps):.4g}, where one "
            f"natural period is {period:.4g} s{f' and sample_rate {rate:.6g} Hz' if rate else ''}; it looks like "
            f"{unit[0]}: give seconds, as `bayes-damper init` with --time-unit {unit[1]} makes them of the logger's "
            "file (or correct k1t, J1)"
        )
        return False
    duration = times[-1] - max(times[0], 0.0)
    if duration < period and not trial.prescribed:
        before = float(times[-1] - times[0])
        if times[0] < 0.0 and before >= period:
            faults.append(
                f"{name}: the clock begins {-times[0]:.4g} s before the release at t = 0, and "
                + (f"only {duration:.4g} s lie" if duration > 0.0 else "no reading lies")
                + " behind it: put t = 0 at the release, as `bayes-damper init --release find` does"
            )
            return False
        faults.append(
            f"{name}: {duration:.4g} s of motion is less than one natural period, {period:.4g} s (2 pi sqrt(J1/k1t)); "
            "record longer, or correct the unit of time, k1t or primary_inertia"
            + _unit_guess(trial, head.rig.kind, period)
        )
        return False
    return True


_UNITS = {
    "translational": {"g taken for kg, or N/mm for N/m": 1e3, "s taken for ms, or g for kg and N/mm for N/m": 1e6},
    "torsional": {
        "kg cm^2 taken for kg m^2": 1e4, "s taken for ms, or kg mm^2 for kg m^2": 1e6, "g cm^2 taken for kg m^2": 1e7,
    },
}  # fmt: skip
"""By how much k1t/J1 is too small for units that are mixed up."""


def _unit_guess(trial: Trial, kind: str, period: float) -> str:
    """Which units of spring and inertia the record's own frequency points to; "" where it shows none.

    period : s, as declared
    """
    frequency = look.dominant_frequency(trial.times, trial.channels[0])
    if trial.driven or frequency * float(np.ptp(trial.times)) < _SWINGS:
        return ""
    ratio = (frequency * period) ** 2
    if 0.5 < ratio < 2.0:
        return ""
    near = [guess for guess, factor in _UNITS[kind].items() if 0.5 < ratio / factor < 2.0]
    name = "k1" if kind == "translational" else "k1t"
    guess = f": {near[0]}?" if near else ""
    return f"; it swings at {frequency:.3g} Hz, for which {name}/primary_inertia is {ratio:.3g} times too small{guess}"
