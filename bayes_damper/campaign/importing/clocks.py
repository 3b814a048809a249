"""The clocks of logger files: the times of readings, two files on one clock, and which readings a trial keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from bayes_damper.campaign import Measurement
from bayes_damper.campaign import readings as look
from bayes_damper.campaign.importing.logger_columns import LoggerFile
from bayes_damper.campaign.importing.logger_files import read_file
from bayes_damper.campaign.importing.options import TrialOptions
from bayes_damper.errors import InputError

Array = NDArray[np.float64]
_FEWEST = 10  # readings that a record must have
_STILL = 12.0  # reach of a record that rests, in standard deviations of its noise, at most
_SLOW = 0.5  # s from reading to reading; those of a rig come every few milliseconds
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}


def times_of(source: LoggerFile, option: TrialOptions, where: str) -> Array:
    """The times of a file's readings on its clock, s."""
    if option.time is not None:
        column = source.index(option.time, where)
        found = source.unit(column)
        unit = option.time_unit or (found if found in _TIME else "s")
        if unit not in _TIME:
            raise InputError(f"{option.where}: time_unit '{unit}' is none of {', '.join(_TIME)}")
        with np.errstate(over="ignore"):  # what is beyond all numbers counts as missing
            return np.asarray(source.table[:, column] * _TIME[unit], float)
    rate = option.sample_rate or 0.0
    if not rate > 0.0:
        raise InputError(
            f"{option.where}: neither 'time' nor 'sample_rate' is given; one of them makes the clock (the file has "
            f"{source.described()})"
        )
    return np.arange(len(source.table)) / float(rate)


def unnamed_unit(source: LoggerFile, option: TrialOptions, times: Array, where: str) -> list[str]:
    """A sentence where nothing says that times are in seconds, and readings are then very far apart."""
    if option.time is None or option.time_unit is not None:
        return []
    column = source.index(option.time, where)
    step = float(np.median(np.diff(times[np.isfinite(times)]))) if np.count_nonzero(np.isfinite(times)) > 1 else 0.0
    if source.unit(column) in _TIME or step < _SLOW:
        return []
    taken = f"so it was taken in seconds, and readings come every {step:.3g} s"
    cure = "if it is in milliseconds or microseconds, give --time-unit ms or us"
    return [f"{where}: no unit is named for the time, {taken}; {cure}."]


def source_of(option: TrialOptions, raw: Path, files: dict[Path, LoggerFile]) -> tuple[LoggerFile, str, TrialOptions]:
    """The file of a trial, its name, and the option; files of one channel each are put side by side."""

    def read(source: str, sha256: str | None) -> LoggerFile:
        path = raw / source
        if path not in files:
            files[path] = read_file(path, option, sha256)
        return files[path]

    sources, columns = option.source, option.columns
    sums = (option.sha256,) if isinstance(option.sha256, str) else option.sha256 or (None,) * len(sources)
    if isinstance(sources, str):
        return read(sources, sums[0]), Path(sources).name, option
    where = ", ".join(Path(s).name for s in sources)
    if len(columns) != len(sources) or len(sums) != len(sources) or len(sources) > 2:
        raise InputError(
            f"{option.where}: {len(sources)} files for the channels of one trial; give at most two, primary "
            "first, and 'columns' with one column of each"
        )
    parts = [read(s, digest) for s, digest in zip(sources, sums, strict=True)]
    clocks = [_own_times(part, option, Path(s).name) for part, s in zip(parts, sources, strict=True)]
    places = [p.index(c, Path(s).name) for p, c, s in zip(parts, columns, sources, strict=True)]
    for part, place in zip(parts, places, strict=True):
        refuse_clocks(part, [place], option)
    channels = [p.table[:, i] for p, i in zip(parts, places, strict=True)]
    units = ("s", *(p.unit(i) or "" for p, i in zip(parts, places, strict=True)))
    notes: tuple[str, ...] = ()
    step = float(np.median(np.diff(clocks[0])))
    apart = any(len(c) != len(clocks[0]) or np.max(np.abs(c - clocks[0])) > 0.5 * step for c in clocks)
    if option.clock is not None or apart:
        times, channels, note = _on_one_clock(clocks, channels, option, where)
        table, notes = np.column_stack([times, *channels]), (note,)
    else:
        table = np.column_stack([clocks[0], *channels])
    both = LoggerFile(("time", *(f"channel {k + 1}" for k in range(len(parts)))), table, units, notes)
    files[raw / where] = both  # for its note; those of the parts stand beside it
    columns = tuple(k + 2 for k in range(len(parts)))
    return both, where, replace(option, time=1, time_unit=None, sample_rate=None, columns=columns)


def _own_times(part: LoggerFile, option: TrialOptions, where: str) -> Array:
    """The clock of a file that may name its time otherwise than the other file of a trial does."""
    try:
        return times_of(part, option, where)
    except InputError:
        column = part.time_column()
        if column is None or option.sample_rate is not None:
            raise
        return times_of(part, replace(option, time=column + 1), where)


def _on_one_clock(
    clocks: Sequence[Array], channels: Sequence[Array], option: TrialOptions, where: str
) -> tuple[Array, list[Array], str]:
    """Two channels at the times of the slower one, while both were read, on the clock of the first file; and a note.

    The faster channel goes through its readings as a cubic spline; where either lacks a reading nearby, there is none.
    """
    steps = [float(np.median(np.diff(c))) for c in clocks]
    spans = " and ".join(f"{c[0]:g} to {c[-1]:g} s in steps of {d:.4g} s" for c, d in zip(clocks, steps, strict=True))
    common = option.clock
    if common is None:
        raise InputError(
            f"{where}: the channels were not read at the same times ({spans}); export them with one clock, or give "
            "with --clock what the clock of each file shows at one instant that both saw, such as a trigger (0 0 where "
            "it is one clock)"
        )
    shown = list(common)
    if len(common) != len(clocks):
        raise InputError(f"{option.where}: clock = {shown}: give one instant for each of the {len(clocks)} files")
    if any(not (np.diff(c) > 0.0).all() for c in clocks):
        raise InputError(f"{where}: the time of a file does not increase or has gaps; sort its rows, fill its times")
    shifted = [c - at for c, at in zip(clocks, common, strict=True)]
    slow = int(np.argmax(steps))
    fast = 1 - slow
    known = np.isfinite(channels[fast])
    have = shifted[fast][known]
    times = shifted[slow]
    if known.sum() < _FEWEST or np.sum((times >= have[0]) & (times <= have[-1])) < _FEWEST:
        raise InputError(f"{where}: the channels were never read at one time ({spans}, clock = {shown}); correct clock")
    inside = (times >= have[0]) & (times <= have[-1])
    times = times[inside]
    after = np.clip(np.searchsorted(have, times), 1, len(have) - 1)
    near = have[after] - have[after - 1] < 3.0 * steps[fast]
    found = [channels[slow][inside], np.where(near, CubicSpline(have, channels[fast][known])(times), np.nan)]
    note = f"{where}: the clocks differ; channel {fast + 1} was brought to the times of channel {slow + 1}."
    return times + common[0], found if slow == 0 else found[::-1], note


def refuse_clocks(source: LoggerFile, places: Sequence[int], option: TrialOptions) -> None:
    """InputError where a channel (a column from 0) is called after the time and rises all along."""
    for i in places:
        if source.called_time(i) and (np.diff(source.table[:, i]) > 0.0).all():
            mend = "name it as 'time', and in 'columns' those that the sensors read"
            if option.sample_rate is not None:
                mend = "leave out the sample rate, or name in 'columns' those that the sensors read"
            raise InputError(
                f"{option.where}: {source.column(i)} is a clock and stands in 'columns'; {mend} "
                f"(the file has {source.described()})"
            )


def window(
    times: Array, y: Array, option: TrialOptions, measurement: Measurement, where: str
) -> tuple[NDArray[np.intp], float]:
    """Indices to keep, and the instant on the raw clock that becomes t = 0."""
    low = float(times[0] if option.start is None else option.start)
    high = float(times[-1] if option.end is None else option.end)
    inside = np.flatnonzero((times >= low - 1e-9) & (times <= high + 1e-9))
    if len(inside) < _FEWEST:
        raise InputError(
            f"{where}: only {len(inside)} readings between {low:g} and {high:g} s; the record runs from {times[0]:g} "
            f"to {times[-1]:g} s: correct start and end"
        )
    release, t, part = option.release, times[inside], y[inside]
    if release == "start":
        zero = float(t[0])
    elif release == "find":
        zero = look.find_release(t, part)
        if zero <= t[4] and still(part):
            raise InputError(
                f"{where}: no release found: the record rests throughout, nothing in it exceeds the noise; check that "
                "the column is that of the sensor, and that the trial was recorded"
            )
        if zero <= t[4]:
            raise InputError(
                f"{where}: no release found: the record moves from its first reading on, so it starts in the middle; "
                "give release in seconds, 'first_peak' with start = 'free', or a record that begins earlier"
            )
        if measurement.quantity == "acceleration":  # it jumps: somewhere before the first reading that has moved
            zero = 0.5 * (zero + float(t[np.searchsorted(t, zero, side="right")]))
        else:  # it stays within the noise for some readings more; at a reading, a sample of doubt is left on each side
            zero = float(t[np.argmin(np.abs(t - look.carried_back(t, part, zero, measurement.quantity)))])
    elif release == "first_peak":
        peak = look.find_first_peak(t, part)
        zero = float(t[np.searchsorted(t, peak - 1e-9)]) if peak < t[-1] else float(t[0])
    elif isinstance(release, str):
        raise InputError(f"{option.where}: release = '{release}' is none of 'start', 'find', 'first_peak' or a number")
    else:
        zero = float(release)
        if zero < 2.0 * times[0] - times[-1]:
            raise InputError(
                f"{where}: release = {zero:g} s is longer before the first reading than the record lasts, which runs "
                f"from {times[0]:g} to {times[-1]:g} s; correct release"
            )
    usual = 0.02 if measurement.start == "rest" else 0.0
    before = float(usual if option.before is None else option.before)
    keep = inside[t >= zero - before - 1e-9][:: option.every]
    if len(keep) < _FEWEST:
        raise InputError(
            f"{where}: only {len(keep)} readings are left of the record, which runs from {times[0]:g} to "
            f"{times[-1]:g} s; correct release, before or every"
        )
    return keep, zero


def restarted(times: Array, last: int) -> str:
    """What to do about a time that does not increase; last : index of the reading from which on it does."""
    if len(times) - last < max(_FEWEST, len(times) // 2):
        return "sort the rows, or give sample_rate"
    return (
        f"it does from reading {last + 1} of {len(times)} on: if the logger began anew there, skip_lines leaves out "
        "what is before; else sort the rows, or give sample_rate"
    )


def still(y: Array) -> bool:
    """Whether nothing in these readings exceeds their noise."""
    return bool(np.ptp(y) <= _STILL * look.noise_floor_of(y))
