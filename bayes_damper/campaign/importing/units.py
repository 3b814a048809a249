"""From raw numbers to SI units: units and radii, ranges that begin again, offsets, sensitivities, measured inputs."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import Measurement
from bayes_damper.campaign import readings as look
from bayes_damper.campaign.importing.logger_columns import COUNTED, LoggerFile, unit_of
from bayes_damper.campaign.importing.options import TrialOptions
from bayes_damper.errors import InputError

Array = NDArray[np.float64]
T = TypeVar("T")
_FEWEST_AT_REST = 8  # readings before a release of which a mean is taken
_FEWEST_PERIODS = 2.0  # of an oscillation which the weighted mean of a tail takes out but for 5 %
_SWINGS = 0.2  # share of the record's range in its last quarter
_GRAVITY = 9.80665
DEGREE = math.pi / 180.0
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_TANGENTIAL = {
    "displacement": _LENGTHS,
    "velocity": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    "acceleration": {f"{unit}/s^2": f for unit, f in _LENGTHS.items()} | {"g": _GRAVITY, "mg": 1e-3 * _GRAVITY},
}
_ANGULAR = {
    "displacement": {"rad": 1.0, "mrad": 1e-3, "deg": DEGREE, "rev": 2.0 * math.pi},
    "velocity": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": DEGREE, "rpm": math.pi / 30.0},
    "acceleration": {"rad/s^2": 1.0, "deg/s^2": DEGREE},
}
_OF_RIG = {"torsional": _ANGULAR, "translational": _TANGENTIAL}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}
_INPUT = {
    "torsional": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "translational": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
}
_RANGES = (1.0, 2.0 * math.pi, 360.0, *(2.0**bits for bits in range(8, 33)))  # of turns, angles and counters


def convert(
    readings: Array, unit: str, kind: str, quantity: str, radius: float | None, where: str, sideways: bool = False
) -> Array:
    """Readings in SI units of the quantity: rad (m), rad/s (m/s), rad/s^2 (m/s^2).

    A tangential unit on a torsional rig (m/s^2, g, mm ...) is divided by the mounting radius, in m. sideways : lengths
    are not arcs but sideways positions x of a marker at that radius, whose angle is asin(x / radius).

    Raises
    ------
    InputError
        for a unit that the quantity cannot have, a tangential unit without a radius, or sideways readings that are no
        lengths or longer than the radius.
    """
    tangential = _TANGENTIAL[quantity]
    valid = tangential if kind == "translational" else {**_ANGULAR[quantity], **tangential}
    if unit not in valid:
        other = next((q for q in _TANGENTIAL if unit in _TANGENTIAL[q] or unit in _ANGULAR[q]), None)
        other_quantity = f", but of {other}: for such readings give --quantity {other}" if other else ""
        if other == quantity:  # of a rig that turns
            other_quantity = " of a cart, but of a rig that turns: for such readings give --kind torsional"
        if unit.lower() in COUNTED:
            first = next(iter(valid))
            other_quantity = f": give --units {first} and, as --scale, how many {first} one of them is"
            if quantity == "displacement" and kind == "torsional":
                other_quantity += " (a video: --units m, --scale, --mounting-radius of the marker, and --sideways)"
            if quantity != "displacement":
                angle = "m" if kind == "translational" else "rad"
                other_quantity += f" (counts of an encoder: --quantity displacement --units {angle})"
        raise InputError(f"{where}: '{unit}' is no unit of {quantity}{other_quantity}; valid units: {', '.join(valid)}")
    if sideways and (kind == "translational" or quantity != "displacement" or unit not in tangential):
        raise InputError(
            f"{where}: sideways is for displacements of a turning rig in m, cm, mm or um, not for '{unit}'"
        )
    if kind == "translational" or unit in _ANGULAR[quantity]:
        return readings * valid[unit]
    if radius is None:
        raise InputError(
            f"{where}: '{unit}' is tangential; give mounting_radius in metres, or kind = 'translational' for what "
            "moves along a line"
        )
    if not 0.0 < radius < 10.0:
        raise InputError(f"{where}: mounting_radius = {radius!r} m is not possible; give metres")
    with np.errstate(over="ignore"):  # readings of 1e307: the check of the campaign names what is not finite
        along = readings * (valid[unit] / radius)
    if not sideways:
        return along
    if (farthest := float(np.nanmax(np.abs(along), initial=0.0))) > 1.0:
        raise InputError(
            f"{where}: the sideways position reaches {farthest:.3g} times the mounting radius; check radius and scale, "
            "and take off with --offset what it reads where the rig hangs at rest"
        )
    return np.asarray(np.arcsin(along))


def in_si(channels: Array, option: TrialOptions, kind: str, quantity: str, where: str) -> Array:
    """Offset, sign and unit of each channel; (n_channels, n)."""
    count = len(channels)
    units = (next(iter(_OF_RIG[kind][quantity])),) if option.units is None else option.units
    units = units * count if len(units) == 1 else units  # channels of one quantity, as a rule
    signs = (1,) * count if option.sign is None else option.sign
    radii, offsets = _each(option.mounting_radius, count), _each(option.offset, count)
    for key, values in (("units", units), ("sign", signs), ("mounting_radius", radii), ("offset", offsets)):
        if len(values) < count:
            raise InputError(
                f"{option.where}: '{key}' has {len(values)} entries for {count} channels; give one for each"
            )
    kinds = {str(u): q for u in units[:count] for q in _TANGENTIAL if u in _TANGENTIAL[q] or u in _ANGULAR[q]}
    if option.motion is None and len(set(kinds.values())) > 1:
        read = " and ".join(f"{q} ({unit})" for unit, q in kinds.items())
        raise InputError(
            f"{where}: the channels read {read}; a campaign has readings of one kind: name in --columns those of one "
            "kind, and give --quantity"
        )
    if any(s not in (1, -1) for s in signs):
        raise InputError(f"{option.where}: sign must be 1 or -1 for each channel")
    rows: list[Array] = []
    sensitivities: tuple[str | None, ...] = option.sensitivity or (None,) * count
    if len(sensitivities) < count:
        raise InputError(f"{option.where}: 'sensitivity' has {len(sensitivities)} entries for {count} channels")
    columns = zip(channels, units, signs, radii, offsets, sensitivities, strict=False)
    for y, unit, sign, r, offset, sensitivity in columns:
        centred = sign * (y - _level_of(y, offset, option.where))
        factor, sensed = 1.0, str(unit)
        if sensed in _VOLTAGE:
            factor, sensed = _sensed(sensed, sensitivity, option.where)
        if option.motion is not None and not rows:  # the reaction
            if sensed not in _INPUT[kind]:
                valid = ", ".join(_INPUT[kind])
                raise InputError(f"{where}: '{sensed}' is no unit of a reaction on the primary; valid units: {valid}")
            rows.append(factor * centred * _INPUT[kind][sensed])
        else:
            rows.append(convert(factor * centred, sensed, kind, quantity, r, where, option.sideways))
    return np.stack(rows)


def _each(given: T | tuple[T, ...], count: int) -> tuple[T, ...]:
    """What is given for each channel, or for all alike."""
    return given if isinstance(given, tuple) else (given,) * count


def _sensed(unit: str, sensitivity: str | None, where: str) -> tuple[float, str]:
    """What one V or mV is, and in which unit, by a sensitivity such as '100 mV/g'."""
    if sensitivity is None:
        raise InputError(f"{where}: '{unit}' is a voltage; give the sensitivity of each sensor, e.g. '100 mV/g'")
    found = re.fullmatch(r"\s*([\d.]+(?:[eE][-+]?\d+)?)\s*(m?V)\s*/\s*\(?(.+?)\)?\s*", str(sensitivity))
    if found is None or not float(found[1]) > 0.0:
        raise InputError(f"{where}: sensitivity = '{sensitivity}' cannot be read; write it as '100 mV/g'")
    return _VOLTAGE[unit] / (float(found[1]) * _VOLTAGE[found[2]]), unit_of(found[3]) or found[3]


def named_units(
    source: LoggerFile, places: Sequence[int], kind: str, quantity: str, reaction: bool
) -> tuple[str, ...]:  # fmt: skip
    """Units that the file gives for its channels, else those of SI; reaction : whether the first is one."""
    tables = [_INPUT[kind] if reaction and not k else _OF_RIG[kind][quantity] for k in range(len(places))]
    return tuple(source.unit(i) or next(iter(table)) for i, table in zip(places, tables, strict=True))


def other_units(source: LoggerFile, places: Sequence[int], given: Sequence[str], where: str) -> list[str]:
    """Notes where a file names another unit for a channel than `units` does."""
    return [
        f"{where}: the file gives {source.column(place)} in {named}, 'units' in {unit}; {unit} was taken."
        for place, unit in zip(places, given, strict=False)
        if (named := source.unit(place)) not in (None, unit) and str(named).lower() not in COUNTED
    ]


def inputs_of(source: LoggerFile, option: TrialOptions, kind: str, where: str) -> dict[str, Array]:
    """Measured inputs in SI units, by their names in structure.INPUTS."""
    out: dict[str, Array] = {}
    units = {"ground": option.ground_unit, "motion": option.motion_unit, "pivot": option.pivot_unit}
    for key, column in option.inputs.items():
        place = source.index(column, where)
        given, name = (units[key], f"{key}_unit") if key in units else (option.torque_unit, "torque_unit")
        tables = {key: _INPUT[kind]}
        if key in ("ground", "motion"):
            known = _OF_RIG[kind]
            tables = {f"{key}_acceleration": known["acceleration"], key: known["displacement"]}
        if key == "pivot":
            tables = {key: _TANGENTIAL["acceleration"]}
        every = {unit: (target, factor) for target, table in tables.items() for unit, factor in table.items()}
        unit = given or source.unit(place) or next(iter(every))
        unit = unit if unit in every else unit_of(unit) or unit
        if unit not in every:
            raise InputError(f"{option.where}: {name} '{unit}' is none of {', '.join(every)}")
        target, factor = every[unit]
        out[target] = factor * source.table[:, place]
    if out and option.every > 1:
        raise InputError(
            f"{option.where}: every = {option.every} would leave out most of the measured input; write it under "
            "[measurement] of campaign.toml, where it thins the readings alone"
        )
    return out


def unwrapped(channels: Array, option: TrialOptions) -> Array:
    """Channels (n_channels, n) that begin again at the end of their range joined, and raw numbers in `units`."""
    out = np.array(channels, float)
    for key, given, neutral in (("wrap", option.wrap, 0.0), ("scale", option.scale, 1.0)):
        values = (neutral,) * len(out) if given is None else given
        if len(values) < len(out) or any(not math.isfinite(v) or (key == "wrap" and v < 0.0) for v in values):
            raise InputError(
                f"{option.where}: {key} = {list(values)}: give a number for each of the {len(out)} channels"
                + (", 0 for one that does not begin again" if key == "wrap" else "")
            )
        for y, value in zip(out, values, strict=False):  # y is a row of out
            there = np.isfinite(y)
            if key == "scale":
                np.multiply(y, value, out=y)
            elif value:
                y[there] = np.unwrap(y[there], period=value)
    return out


def refuse_wraps(channels: Array, where: str) -> None:
    """Refuse raw channels (n_channels, n) that begin again at the end of their range, and name the option for them."""
    found = [look.wrap_of(y[np.isfinite(y)]) for y in channels]
    if not any(found):
        return
    values = []
    for limits in found:
        least, most = limits or (0.0, 0.0)
        round_ones = (float(f"{0.5 * (least + most):.{digits}g}") for digits in range(1, 9))
        values.append(f"{next((x for x in (*_RANGES, *round_ones) if least <= x <= most), least):.8g}")
    raise InputError(
        f"{where}: the readings jump to and fro by all that they span, as those of a counter that begins again do: "
        f"give --wrap {' '.join(values)} ('wrap'; 0 for a channel that does not)"
    )


def with_rest(option: TrialOptions, before: Array, measurement: Measurement, where: str) -> TrialOptions:
    """The options with the mean of the readings `before` the release in place of an offset 'head'."""
    offsets: tuple[str | float, ...] = _each(option.offset, len(before))
    if "head" not in offsets:
        return option
    free = measurement.start == "free" and option.release != "find"  # else it was at rest before it began
    if measurement.quantity == "displacement" or free:
        raise InputError(
            f"{where}: offset = 'head' takes what the sensor reads while the rig is held for 0; "
            + ("a record of start = 'free'" if free else "a displacement")
            + " does not begin at 0: use 'tail' or a number"
        )
    if before.shape[1] < _FEWEST_AT_REST:
        raise InputError(
            f"{where}: offset = 'head' wants at least {_FEWEST_AT_REST} readings before the release, the record has "
            f"{before.shape[1]}: use --release find, 'tail' or a number"
        )
    rest = [float(np.mean(y)) if x == "head" else x for x, y in zip(offsets, before, strict=False)]
    return replace(option, offset=tuple(rest))


def swinging_tails(times: Array, channels: Array, option: TrialOptions, where: str) -> list[str]:
    """Notes where the readings of an offset 'tail' hold too little of a swing for their mean to be the middle of it."""
    out = []
    for offset, y in zip(_each(option.offset, len(channels)), channels, strict=False):
        t, part = times[_tail_of(y)], y[_tail_of(y)]
        periods = look.dominant_frequency(times, y) * float(np.ptp(t))
        if offset == "tail" and 0.0 < periods < _FEWEST_PERIODS and np.ptp(part) > _SWINGS * np.ptp(y):
            out.append(
                f"{where}: offset = 'tail' takes the middle of the end of the record, which still swings and holds "
                f"{periods:.1f} periods: that is not what the sensor reads at rest; give a longer record or the "
                "offset as a number, or leave it and set offset_std."
            )
    return out


def _tail_of(y: Array) -> slice:
    """The last quarter; if the rig still swings there, as much before it as holds two and a half swings."""
    tail = slice(-max(8, len(y) // 4), None)
    frequency = look.dominant_frequency(np.arange(len(y), dtype=float), y)
    if frequency == 0.0 or np.ptp(y[tail]) <= _SWINGS * np.ptp(y):
        return tail
    return slice(min(tail.start, -min(math.ceil((_FEWEST_PERIODS + 0.5) / frequency), 3 * len(y) // 4)), None)


def _level_of(y: Array, offset: str | float, where: str) -> float:
    if offset == "none":
        return 0.0
    if offset in ("mean", "tail"):
        return _middle(y if offset == "mean" else y[_tail_of(y)])
    if isinstance(offset, str):
        raise InputError(f"{where}: offset = '{offset}' is none of 'none', 'mean', 'tail', 'head' or a number")
    return float(offset)


def _middle(y: Array) -> float:
    """Level about which readings lie or swing; (n,).

    Least squares of a constant beside a sinusoid whose amplitude and phase change as a parabola, under a Hann window.
    The window alone lets a swing that decays move the mean by a hundredth of it.
    """
    n, weight = len(y), np.hanning(len(y) + 2)[1:-1]
    frequency = look.dominant_frequency(np.arange(n, dtype=float), y)
    if frequency * n < _FEWEST_PERIODS:
        return float(np.average(y, weights=weight))
    u, turn = np.linspace(-1.0, 1.0, n), 2.0 * math.pi * frequency * np.arange(n)
    terms = np.stack([np.ones(n), *(u**k * wave for k in range(3) for wave in (np.cos(turn), np.sin(turn)))])
    root = np.sqrt(weight)
    found, *_ = np.linalg.lstsq((terms * root).T, root * y, rcond=None)
    return float(found[0])
