"""Wrong units, caught by the orders of magnitude of a record."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayes_damper.campaign import readings as look
from bayes_damper.campaign.head import Head
from bayes_damper.campaign.records import DERIVATIVE
from bayes_damper.campaign.structure import TO_SI, TRIAL_COLUMNS, Rig, Trial, channel_columns, natural_period
from bayes_damper.campaign.trials_table import LEAST_STD
from bayes_damper.errors import UnitFault
from bayes_damper.text import counted

_FEWEST = 4.0  # readings in a period of the primary, below which a motion is not seen
_NOT_NEGATIVE = (
    "primary_inertia", "secondary_inertia", "bar_radius", "magnet_radius", "magnet_pull", "ground2_stiffness",
)  # fmt: skip

_POSSIBLE = {
    "magnet_pull": (1e-6, 1e6, "N"), "magnet_radius": (1e-6, 1e2, "m"), "bar_radius": (1e-6, 1e3, "m"),
}  # fmt: skip
"""What a magnet and its arm can be at all, from micromachines to cranes."""
_STRONGEST = 0.9e6
"""Pull of a permanent magnet per area of its face, Pa, at most: B^2 / (2 mu0) of 1.5 T, which the strongest neodymium
keeps in a closed circuit. On iron usual ones have 0.6 MPa, at 1.2 T.
"""
_LIGHTEST = 0.1 * math.pi * 4000.0
"""Mass of a magnet, kg, over the cube of the radius of its face, m, at least: of a disc a tenth of its radius thick, of
4000 kg/m^3 (ferrite has 4800, neodymium 7500)."""
_FILTERED = 3.0
"""Bandwidth over the rig's frequency below which a filter of the first order takes 5 % of the motion."""
_IN_DEGREES = " (`init --units deg` converts them)"
_IN_RADIANS = '; if it is right, write units = "declared" under [measurement]'
_FEWEST_LEFT = 16  # readings of a record that `every` leaves
_COARSE = 0.5  # of a period, above which the steps of a record show no motion
_FIRST = 5  # readings after a release, in which a motion that dies at once shows
_ODD, _WRONG = (0.2, 2.0), (0.03, 10.0)  # largest reading over what the release gives, beyond which it is odd, or wrong
_SWINGS = {"translational": (1.0, 10.0), "torsional": (1.6, 20.0)}
"""Swing of a free start, m or rad, from which it is odd, or wrong."""
_TO_AND_FRO = 3.5  # rad of a swing to and fro: more than half a turn
_LATE = 10.0  # lengths of a record after the release, from which the times count from something else
_MOST_APART = 1e6  # a ratio beyond which one of two numbers does not act
_USUAL = {"torsional": 1.0, "translational": 0.3}  # swing, rad or m, up to which it is theta0 that is in another unit


def check_declared(head: Head, trials: Sequence[Trial], faults: list[str], warnings: list[str]) -> None:
    """What campaign.toml and trials.csv declare, held against itself and the length and rate of the records."""
    _check_rig(head.rig, trials, faults, warnings)
    _check_measurement(head, trials, faults, warnings)


def _check_magnet(rig: Rig, where: str, warnings: list[str]) -> None:
    """Radii and pull of a magnet, held against each other and the inertias."""
    if rig.magnet_radius is not None and rig.bar_radius is not None and rig.magnet_radius.value >= rig.bar_radius.value:
        warnings.append(
            f"{where}: magnet_radius = {rig.magnet_radius.value:g} m is not smaller than bar_radius = "
            f"{rig.bar_radius.value:g} m, at which the magnet sits; exchanged, or a diameter?"
        )
    if rig.has_magnet and rig.magnet_radius is not None and rig.bar_radius is not None:
        lightest = _LIGHTEST * rig.magnet_radius.value**3 * rig.bar_radius.value**2
        bodies = (("primary_inertia", rig.primary_inertia), ("secondary_inertia", rig.secondary_inertia))
        for key, body in bodies if rig.kind == "torsional" else ():
            if body is not None and body.value < lightest:
                warnings.append(
                    f"{where}: {key} = {body.value:g} kg m^2 is too little for a face of {rig.magnet_radius.value:g} m "
                    f"radius at bar_radius = {rig.bar_radius.value:g} m: that alone has {lightest:.2g} kg m^2 or more; "
                    "are both radii in metres, and the inertia in kg m^2?"
                )
    if rig.has_magnet and rig.magnet_pull is not None and rig.magnet_radius is not None:
        most_pull = _STRONGEST * math.pi * rig.magnet_radius.value**2
        if rig.magnet_pull.value > most_pull:
            warnings.append(
                f"{where}: magnet_pull = {rig.magnet_pull.value:g} N is more than any permanent magnet with a "
                f"face of {rig.magnet_radius.value:g} m radius pulls, {most_pull:.2g} N; in newtons (a pull of 1 kg is "
                "9.81 N)?"
            )


def _check_rig(rig: Rig, trials: Sequence[Trial], faults: list[str], warnings: list[str]) -> None:
    where = "campaign.toml [rig]"
    for key in _NOT_NEGATIVE:
        constant = getattr(rig, key)
        if constant is not None and constant.std >= constant.value > 0.0:
            faults.append(
                f"{where}: {key} = {constant.value:g} with std = {constant.std:g}: the uncertainty is as large as the "
                "value, which cannot be negative; give the standard uncertainty in the same unit"
            )
    if (beside := rig.inertial_coupling).std > abs(beside.value) > 0.0:
        warnings.append(
            f"{where}: inertial_coupling = {beside.value:g} with std = {beside.std:g}: the uncertainty is larger than "
            "the value, so that its sign is open; is std in the same unit? (For an unknown one give value = 0.0.)"
        )
    _check_magnet(rig, where, warnings)
    for key, (least, most, unit) in _POSSIBLE.items():
        constant = getattr(rig, key)
        if constant is not None and constant.value != 0.0 and not least <= constant.value <= most:
            faults.append(
                f"{where}: {key} = {constant.value:g} {unit} is none of a rig ({least:g} to {most:g} {unit} are read): "
                "check its unit"
            )
    for trial in {t.k1t: t for t in trials}.values():
        if trial.k1t.std >= trial.k1t.value > 0.0:
            faults.append(
                f"trials.csv: case {trial.case}: the uncertainty of the spring, {trial.k1t.std:g}, is as large as the "
                f"spring itself, {trial.k1t.value:g}; give the standard uncertainty in the same unit"
            )
    for theta0, trial in {t.theta0: t for t in trials if t.theta0 is not None and not t.driven}.items():
        if theta0.std > abs(theta0.value) > 0.0:
            (warnings if theta0.std == LEAST_STD * TO_SI[rig.kind] else faults).append(
                f"trials.csv: case {trial.case}: theta0 is smaller than its standard uncertainty, so the sign of the "
                f"release is open; give {TRIAL_COLUMNS[rig.kind][3]} in the unit of theta0 (without it {LEAST_STD:g} "
                "or more is taken)"
            )
    stiffest = max((t.k1t.value for t in trials), default=math.inf)
    if rig.ground2_stiffness.value > _MOST_APART * stiffest:
        faults.append(
            f"{where}: ground2_stiffness is {rig.ground2_stiffness.value / stiffest:.3g} times the stiffest k1t: the "
            "secondary could not move; check its unit"
        )


def _check_measurement(head: Head, trials: Sequence[Trial], faults: list[str], warnings: list[str]) -> None:
    rig, declared = head.rig, head.measurement
    where = "campaign.toml [measurement]"
    largest = max((float(np.max(np.abs(t.channels))) for t in trials), default=math.inf)
    for key in ("noise_std", "offset_std", "sensor_range"):
        if any(x > _MOST_APART * largest for x in getattr(declared, key) or ()):
            faults.append(
                f"{where}: {key} is more than {_MOST_APART:g} times the largest reading, {largest:.3g}; give it in the "
                "unit of the readings"
            )
    if any(_MOST_APART * x < largest < math.inf for x in declared.sensor_range or ()):
        faults.append(
            f"{where}: sensor_range is less than a millionth of the largest reading, {largest:.3g}; give it in the "
            "unit of the readings"
        )
    if any(largest < x <= _MOST_APART * largest for x in declared.offset_std or ()):
        warnings.append(
            f"{where}: offset_std = {max(declared.offset_std or ()):g} is above the largest reading, {largest:.3g}; is "
            "it in the unit of the readings?"
        )
    if any(x >= 1.0 for x in declared.scale_std or ()):
        faults.append(
            f"{where}: scale_std is relative, 0.01 for 1 %; a scale uncertain by 100 % and more means nothing"
        )
    shortest = min((float(np.ptp(t.times)) for t in trials), default=math.inf)
    if any(x >= shortest for x in declared.lag_std or ()):
        faults.append(f"{where}: lag_std is as long as the shortest record, {shortest:.3g} s; give it in seconds")
    period = min((natural_period(rig, t) for t in trials), default=math.inf)
    if any(0.5 * period < x < shortest for x in declared.lag_std or ()):
        warnings.append(
            f"{where}: lag_std = {max(declared.lag_std or ()):g} s is more than half a period, {period:.3g} s: such a "
            "channel can be placed anywhere; give what its clock may be off by, in seconds"
        )
    if declared.every is not None and not head.broken:
        for trial in trials:
            left = natural_period(rig, trial) / (declared.every * float(np.median(np.diff(trial.times))))
            kept = trial.times.size // declared.every
            if left < _FEWEST or kept < _FEWEST_LEFT:
                faults.append(
                    f"{where}: every = {declared.every} leaves {counted(kept, 'reading')} of {trial.file}, {left:.2g} "
                    f"to a period of the primary; at least {_FEWEST:g} show a motion"
                )
                break
    own = 1.0 / period
    for bandwidth in dict.fromkeys(declared.sensor_bandwidth or ()):
        if bandwidth < _FILTERED * own < math.inf:
            shown, late = math.cos(math.atan(own / bandwidth)), math.degrees(math.atan(own / bandwidth))
            warnings.append(
                f"{where}: sensor_bandwidth = {bandwidth:g} Hz, and the rig swings at {own:.3g} Hz: such a sensor (of "
                f"the first order) shows {shown:.0%} of the motion, {late:.0f} degrees late, which a fit takes for the "
                "rig's; check its unit, or fit with --effect sensor_bandwidth"
            )


def check_magnitudes(head: Head, trial: Trial, faults: list[str], warnings: list[str]) -> None:
    """Compares each channel with what the declared release can produce: wrong units show as factors of 57, 1000, R."""
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    power = DERIVATIVE[head.measurement.quantity]
    readings = look.without_outliers(trial.times, trial.channels[0], omega, power == 0)
    centred = readings - (0.0 if power else float(np.median(readings)))
    largest = float(np.quantile(np.abs(centred), 1.0 - min(0.002, 2.0 / len(centred))))
    names = channel_columns(trial, head.rig.kind, head.measurement.quantity)
    marks = [(name, found) for name, y in zip(names, trial.channels, strict=True) if (found := look.mark_of(y))]
    faults += [
        f"{trial.file}, column '{name}': {count} readings are {value:g}, far beyond all others: does that stand for "
        "missing readings? Remove those lines (gaps are allowed)"
        for name, (value, count) in marks
    ]
    if marks:
        return
    if np.ptp(trial.channels[0]) == 0.0:
        faults.append(f"{trial.file}, column '{names[0]}': every reading is the same; the sensor was not connected?")
        return
    if trial.driven:
        return
    step, length = float(np.median(np.diff(trial.times))), float(np.ptp(trial.times))
    if head.measurement.start == "rest" and trial.times[0] > _LATE * length:
        faults.append(
            f"{trial.file}: begins {trial.times[0]:.6g} s after t = 0, the release, and lasts {length:.3g} s: take the "
            "instant of the release off its times, or import it with `bayes-damper init --release find`"
        )
        return
    if step > _COARSE * natural_period(head.rig, trial):
        faults.append(
            f"{trial.file}: readings come every {step:.3g} s, but sqrt(k1t/primary_inertia) swings with a period of "
            f"{natural_period(head.rig, trial):.3g} s; the time column is in milliseconds or microseconds, or k1t and "
            "primary_inertia are in other units"
        )
        return
    if trial.theta0 is None:
        _check_free_magnitude(head, trial, largest / omega**power, names[0], faults, warnings)
        return
    if trial.theta0.value == 0.0:
        faults.append(f"{trial.file}: released from 0 without a torque, nothing can move; correct theta0 in trials.csv")
        return
    largest = float(np.quantile(np.abs(readings), 1.0 - min(0.002, 2.0 / len(centred)))) if not power else largest
    _check_released_magnitude(head, trial, largest, names[0], faults, warnings)


def _check_released_magnitude(
    head: Head, trial: Trial, largest: float, column: str, faults: list[str], warnings: list[str]
) -> None:
    """The largest reading must be what the declared release can give."""
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    power = DERIVATIVE[head.measurement.quantity]
    if power and head.measurement.start == "rest":  # a motion that dies at once looks like one reading that sticks out
        largest = max(largest, float(np.max(np.abs(trial.channels[0][:_FIRST]))))
    held = 0.0 if trial.theta0 is None else abs(trial.theta0.value)
    bound = held * omega**power
    formula = {0: "theta0", 1: "theta0 sqrt(k1t/J1)", 2: "k1t theta0/J1"}[power]
    ratio = largest / bound
    unit = column.partition("1_")[2].replace("_", "/").replace("s2", "s^2")
    sentence = (
        f"{trial.file}, column '{column}': the largest reading, {largest:.4g} {unit}, is {ratio:.3g} times "
        f"{formula} = {bound:.4g} {unit}, the most that this release can give"
    )
    if _ODD[0] <= ratio <= _ODD[1]:
        return
    y = trial.channels[0]
    if _WRONG[0] <= ratio < _ODD[0] and look.standstill_of(y, look.resolution_of(y)) is not None:
        return  # what it would have read shows in no unit, and `look_at_trial` says that it stands still
    swings = look.dominant_frequency(trial.times, trial.channels[0])
    own = swings / (omega / (2.0 * math.pi))
    if power and 0.5 < ratio / own**power < 2.0:  # the release is right at the frequency that the record shows
        guess = (
            f"the record swings at {swings:.4g} Hz, k1t and primary_inertia give {omega / (2.0 * math.pi):.4g} Hz: "
            "correct one of them, or the time column"
        )
    else:
        guess = _unit_guess(head.rig, ratio, power, ratio * held)
    (faults if ratio > _WRONG[1] or ratio < _WRONG[0] else warnings).append(f"{sentence}; {guess}")


def _unit_guess(rig: Rig, ratio: float, power: int, reach: float) -> str:
    """Which confusion of units a ratio far from one looks like, as advice; reach : by the readings, rad or m."""
    radius = rig.bar_radius.value if rig.bar_radius is not None else 0.1
    torsional = rig.kind == "torsional"
    guesses: dict[str, float] = {"k1t, the inertia or the release are in another unit than declared": 1e6}
    if torsional:
        guess = f"degrees taken for radians: give radians in the record{_IN_DEGREES}, degrees in theta0_deg"
        if reach < _USUAL["torsional"]:
            guess = "radians given for theta0, which is in degrees; or degrees taken for radians in the record"
        guesses[f"it looks like {guess}"] = 57.3
        if power == 2:
            guesses[
                "it looks like g at the mounting radius: convert to rad/s^2, or import it with `bayes-damper init`"
            ] = radius / 9.81
            guesses[
                "it looks like m/s^2 at the mounting radius: convert to rad/s^2, or import it with `bayes-damper init`"
            ] = radius
    else:
        guess = "it looks like millimetres taken for metres: give SI units in the record, mm in theta0_mm"
        if reach < _USUAL["translational"]:
            guess = "it looks like metres given for theta0, which is in mm"
        guesses[guess] = 1000.0
        guesses["it looks like micrometres given for theta0, which is in mm"] = 1e-3
        if power == 2:
            guesses["it looks like g: give m/s^2"] = 1.0 / 9.81
    best = min(guesses, key=lambda text: abs(math.log(0.8 * guesses[text] / ratio)))
    near = abs(math.log(0.8 * guesses[best] / ratio)) < math.log(4.0)
    return best if near else "check the units of the record, of theta0, k1t and primary_inertia"


def _check_free_magnitude(
    head: Head, trial: Trial, swing: float, column: str, faults: list[str], warnings: list[str]
) -> None:
    """Without a declared release: the swing that the readings imply, rad or m, must be possible."""
    where = f"{trial.file}, column '{column}': the readings imply a swing of {swing:.4g}"
    odd, wrong = _SWINGS[head.rig.kind]
    if head.rig.kind == "translational":
        if swing > wrong:
            fault = f"{where} m; it looks like millimetres taken for metres: give SI units in the record"
            faults.append(UnitFault(fault))
        elif swing > odd:
            warnings.append(f"{where} m; if these are millimetres, give metres")
        return
    known = head.measurement.units == "declared"
    y = trial.channels[0] - np.median(trial.channels[0])
    to_and_fro = int(np.count_nonzero(np.diff(np.sign(y)) != 0)) >= 4
    if swing > wrong:
        fault = f"{where} rad; it looks like degrees taken for radians: give radians in the record{_IN_DEGREES}"
        faults.append(UnitFault(fault))
    elif swing > _TO_AND_FRO and to_and_fro and not known:
        warnings.append(
            f"{where} rad to and fro, more than half a turn; if these are degrees, give radians in the record"
            + _IN_DEGREES
            + _IN_RADIANS
        )
    elif swing > odd and head.rig.restoring == "linear":
        degrees = "" if known else f" if these are degrees, give radians{_IN_DEGREES}{_IN_RADIANS};"
        warnings.append(f'{where} rad;{degrees} if it hangs, set restoring = "pendulum"')
