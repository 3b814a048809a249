"""What records show of what is declared: stiffness and inertia by their frequency, release by its swing, channels.

A primary alone on a linear spring swings at sqrt(k1t/J1), whatever dry friction takes from it, and its first swing
shows the angle of its release. A secondary that is dragged along moves as the primary does at first, and less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look
from bayes_damper.campaign.head import Head
from bayes_damper.campaign.records import DERIVATIVE, departure
from bayes_damper.campaign.structure import TO_SI, Trial, natural_period

Array = NDArray[np.float64]
_OFF = 0.1  # of the frequency: nonlinear springs and viscous damping of a free decay stay below it, as a rule
_HIGHER, _LOWER = 1.25, 0.7  # first swing, less what friction takes of it, over the declared one
_SURE = 5.0  # standard uncertainties of what is declared, beyond which the records contradict it
_STILL = 0.1  # of the largest reading, below which a rig is held to have come to rest
_FEWEST = 3.0  # swings that give a frequency
_FIRST = 0.5  # rad of the primary's oscillation, in which the release shows and nothing has turned round
_FREE, _LESS = 0.5, 0.6  # of a free primary's way that an exchanged channel goes, and of that what the other goes
_APART = 0.1  # of the primary's displacement at the release: where dry friction stops a body is nearer, as a rule
_LEAP, _FINE = 3.0, 0.5  # times the fastest motion that follows; radians of the oscillation from reading to reading
_MOST = 2.5  # times the swing of a released primary, which none that is declared well enough exceeds
_FARTHER = 1.2  # times as far as a channel of another scale goes, if its body goes as far as the primary
_FEWEST_HELD = 3  # readings up to the release that show a rig at rest


def look_at_declarations(head: Head, trials: Sequence[Trial], warnings: list[str]) -> None:
    """Adds as warnings the cases whose uncoupled trials contradict what is declared of spring, inertia or release."""
    if head.rig.restoring != "linear":
        return
    cases = _alone(trials)
    found = {case: f for case, own in cases.items() if (f := _frequency(own)) is not None}
    power = DERIVATIVE[head.measurement.quantity]
    swings = {
        case: float(np.median([_first_swing(t, power, f) for t in cases[case]]))
        for case, f in found.items()
        if all(t.theta0 is not None and t.theta0.value != 0.0 for t in cases[case])
    }
    # Readings as large as spring, inertia and release give, at another frequency: neither of them is wrong, but time.
    slow = {}
    for case, swing in list(swings.items()):
        ratio = found[case][0] * natural_period(head.rig, cases[case][0])
        if not _LOWER <= swing <= _HIGHER and _LOWER <= swing * ratio**power <= _HIGHER:
            slow[case] = 1.0 / ratio
            del swings[case]
    _look_at_springs(head, {case: cases[case][0] for case in found}, found, slow, warnings)
    _look_at_releases({case: cases[case][0] for case in swings}, swings, warnings)


def wiring_of(head: Head, trial: Trial) -> Literal["exchanged", "reversed", "first reversed", "mirrored"] | None:
    """What the first moments after the release say of the channels: exchanged, one of them reversed, or nothing.

    Exchanged: the secondary moves as the primary must, and the primary less. Reversed: the secondary moves away, where
    the primary that drags it along moves back; the first one reversed: the other way round. Mirrored: the
    secondary is held as far on the other side of 0 as the primary.
    """
    found = _drives(head, trial)
    if found is None:
        return None
    first, second, least = found
    held = held_at(head, trial)
    if held is not None and trial.theta0 is not None:
        share = held / trial.theta0.value
        if abs(share[0]) < 0.5 * abs(share[1]) and 0.7 < share[1] < 1.4:
            return "exchanged"
        if share[0] > 0.0 and abs(share[1]) < 0.5 * share[0]:  # not released together: the primary draws it near
            return "reversed" if first > 0.3 and second > max(least, _FARTHER * share[1] * first) else None
    alike = second > _FREE > first and first < _LESS * second
    if head.rig.ground2_stiffness.value == 0.0 and alike and not (_is_cut_off(head, trial) or _is_beyond(head, trial)):
        return "exchanged"
    if first < -0.3:
        return "first reversed"
    if first > 0.3 and second < -least:
        return "reversed"
    return "mirrored" if held is not None and abs(held[0] + held[1]) < _APART * abs(held[0]) else None


def _is_cut_off(head: Head, trial: Trial) -> bool:
    """Whether the first channel has flat tops, which hide how it begins."""
    y, omega = trial.channels[0], 2.0 * math.pi / natural_period(head.rig, trial)
    return bool(look.flat_tops_of(trial.times, y, look.noise_floor_of(y, trial.times), omega, False))


def _is_beyond(head: Head, trial: Trial) -> bool:
    """Whether the second channel goes farther than a released primary can, and has another scale."""
    assert trial.theta0 is not None
    y, power = trial.channels[1], DERIVATIVE[head.measurement.quantity]
    reach = abs(trial.theta0.value) * (2.0 * math.pi / natural_period(head.rig, trial)) ** power
    return float(np.quantile(np.abs(y), 0.998)) > _MOST * reach


def frozen_for(trial: Trial, y: Array, omega: float) -> int:
    """Equal readings with which a displacement begins that then leaps, as nothing does that is let go; else 0.

    omega : rad/s of the rig; a record of few readings in its period has no leaps
    """
    speeds = np.abs(np.diff(y) / np.diff(trial.times))
    count = int(np.argmax(speeds > 0.0)) + 1
    leaps = look.STOPPED <= count < speeds.size and speeds[count - 1] > _LEAP * np.max(speeds[count:])
    return count if leaps and omega * float(np.median(np.diff(trial.times))) < _FINE else 0


def up_to_release(trial: Trial) -> NDArray[np.bool_]:
    """Which readings of a record lie before the release or at it."""
    return trial.times <= 0.5 * float(np.median(np.diff(trial.times)))


def held_at(head: Head, trial: Trial) -> Array | None:
    """Displacement that each channel reads where the rig is held before the release, (n_channels,).

    None where no displacements are read, or the readings up to t = 0 do not show a rig at rest. A record that begins
    with the release has one such reading; it counts where it is that of the declared release.
    """
    if head.measurement.quantity != "displacement" or head.measurement.start != "rest" or trial.theta0 is None:
        return None
    until = trial.channels[:, up_to_release(trial)]
    if until.size == 0 or trial.driven:
        return None
    held = np.median(until, axis=1)
    if until.shape[1] < _FEWEST_HELD:
        return held if abs(held[0] - trial.theta0.value) < 0.05 * abs(trial.theta0.value) else None
    still = max(12.0 * look.noise_floor_of(trial.channels[0]), 0.01 * float(np.max(np.abs(trial.channels[0]))))
    return held if float(np.ptp(until[0])) < still else None


def look_at_starts(head: Head, trials: Sequence[Trial], warnings: list[str]) -> None:
    """Adds a warning where most coupled trials show the secondary away from the primary at their release."""
    apart = [(t, levels) for t in trials if t.coupled and (levels := _apart(head, t)) is not None]
    if not apart or len(apart) < 0.5 * sum(t.coupled for t in trials):
        return
    unit, name, sign = ("mm", "theta0_mm", "x") if head.rig.kind == "translational" else ("deg", "theta0_deg", "th")
    levels = apart[0][1] / TO_SI[head.rig.kind]
    first, second = np.round(levels, 1 - math.floor(math.log10(abs(levels[0])))) + 0.0  # no -0
    warnings.append(
        f"{apart[0][0].file}{f' and {len(apart) - 1} other coupled trials' if len(apart) > 1 else ''}: at the release "
        f"the primary stands at {first:g} {unit} and the secondary at {second:g} {unit}, but the model releases both "
        f"from the same angle, {sign}2(0) = {sign}1(0). If only the primary was held there, let the initial angles of "
        "both bodies be inferred: run `init` again without theta0 (no --theta0, and {case} for {theta0} in --pattern); "
        f'or set start = "free" in campaign.toml, empty the column {name} of trials.csv, and take off all readings '
        "before the release. If both were held there, take the zero of the second sensor off (--offset)"
    )


def _apart(head: Head, trial: Trial) -> Array | None:
    """Where the bodies are held before the release, (2,), if that is not the same place; else None."""
    held = held_at(head, trial)
    if held is None or wiring_of(head, trial) is not None:
        return None
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    noise = [look.noise_floor_of(c) for c in trial.channels]
    zeros = [look.offset_of(trial.times, c, s, omega) for c, s in zip(trial.channels, noise, strict=True)]
    for levels in (held, held - zeros):  # a zero that is not taken off is no distance, nor one that seems to be there
        if not max(_APART * abs(levels[0]), 20.0 * noise[1]) < abs(levels[1] - levels[0]):
            return None
    return levels if abs(levels[1]) < 3.0 * abs(levels[0]) else None  # else in another unit, which its torques show


def _alone(trials: Sequence[Trial]) -> dict[str, list[Trial]]:
    """The trials of each case in which nothing but its spring acts on the primary."""
    cases: dict[str, list[Trial]] = {}
    for trial in trials:
        if not trial.coupled and not trial.driven:
            cases.setdefault(trial.case, []).append(trial)
    return cases


def frequency_ratios(head: Head, trials: Sequence[Trial]) -> dict[str, float]:
    """Frequency of the primary's own swings over sqrt(k1t/J1)/(2 pi), of each case whose uncoupled trials show it."""
    found = {case: (own[0], _frequency(own)) for case, own in _alone(trials).items()}
    return {case: f[0] * natural_period(head.rig, trial) for case, (trial, f) in found.items() if f is not None}


def _moving(trial: Trial) -> tuple[float, float]:
    """When the primary begins to move and when it has come to rest, s; equal where it never moves."""
    y = trial.channels[0] - np.median(trial.channels[0])
    large = np.flatnonzero(np.abs(y) > max(_STILL * float(np.max(np.abs(y))), 8.0 * look.noise_floor_of(y)))
    if large.size == 0:
        return float(trial.times[0]), float(trial.times[0])
    start, end = (float(t) for t in trial.times[large[[0, -1]]])
    return min(max(start, 0.0), end), end  # a displacement is large before the release too


def _frequency(trials: Sequence[Trial]) -> tuple[float, float] | None:
    """Frequency of the swings of a case, Hz, and how finely its records give it; None where they hold too few."""
    measured = []
    for trial in trials:
        start, end = _moving(trial)
        inside = (trial.times >= start) & (trial.times <= end)
        if np.count_nonzero(inside) < 8:  # has no frequency
            continue
        times, readings = look.without_long_gaps(trial.times[inside], trial.channels[0][inside])
        frequency, length = look.dominant_frequency(times, readings), float(np.ptp(times))
        if frequency * length >= _FEWEST:
            measured.append((frequency, 0.3 / length))
    if not measured:
        return None
    return float(np.median([f for f, _ in measured])), float(np.median([error for _, error in measured]))


def _look_at_springs(
    head: Head, first: Mapping[str, Trial], found: Mapping[str, tuple[float, float]], slow: Mapping[str, float],
    warnings: list[str],
) -> None:  # fmt: skip
    """Names the cases that swing at another frequency than sqrt(k1t/J1); slow : by how much time seems stretched."""
    inertia = head.rig.primary_inertia
    name, unit = ("k1t", "N m/rad") if head.rig.kind == "torsional" else ("k1", "N/m")
    off: dict[str, float] = {}
    for case, (frequency, error) in found.items():
        trial = first[case]
        ratio = frequency * natural_period(head.rig, trial)
        known = 0.5 * math.hypot(trial.k1t.std / trial.k1t.value, inertia.std / inertia.value)
        if abs(ratio - 1.0) > max(_OFF, _SURE * known, error / frequency):
            off[case] = ratio
    if not off:
        return
    listed = "; ".join(
        f"case {case} at {found[case][0]:.4g} Hz for {1.0 / natural_period(head.rig, first[case]):.4g} Hz"
        for case in off
    )
    ratios = np.array(list(off.values()))
    common = len(off) == len(found) > 1 and float(np.ptp(np.log(ratios))) < 0.05
    cure = (
        f"one primary_inertia of {inertia.value / float(np.median(ratios)) ** 2:.3g} would do for all of them"
        if common
        else ", ".join(f"{name} of {first[c].k1t.value * r**2:.4g} {unit} would do in case {c}" for c, r in off.items())
    )
    advice = f"{cure}: correct {name}, primary_inertia or the time column, if no other spring acts"
    if all(case in slow for case in off):
        factor = float(np.median([slow[case] for case in off]))
        advice = (
            f"the first swing is as large as declared, so it seems that time is {factor:.3g} times what it should be"
        )
    warnings.append(
        f"trials.csv: uncoupled, the primary swings at another frequency than sqrt({name}/primary_inertia)/(2 pi): "
        f"{listed}; {advice}"
    )


def _first_swing(trial: Trial, power: int, found: tuple[float, float]) -> float:
    """Half the range of the readings in the first period of the motion, over that of the declared release."""
    assert trial.theta0 is not None
    frequency = found[0]
    start, _ = _moving(trial)
    readings = look.without_outliers(trial.times, trial.channels[0], 2.0 * math.pi * frequency, power == 0)
    y = readings[(trial.times >= start) & (trial.times <= start + 1.0 / frequency)]
    noise = look.noise_floor_of(trial.channels[0]) * math.sqrt(2.0 * math.log(max(y.size, 2)))
    half = max(0.5 * float(np.ptp(y)) - noise, 0.0)
    after = (trial.times >= start + 1.0 / frequency) & (trial.times <= start + 2.0 / frequency)
    if half > 0.0 and np.count_nonzero(after) > 4:  # what a period loses, taken off again from the first half of one
        kept = max(0.5 * float(np.ptp(readings[after])) - noise, 0.0) / half
        half *= 2.0 / (1.0 + math.sqrt(min(1.0, max(kept, 0.25))))
    return half / (abs(trial.theta0.value) * (2.0 * math.pi * frequency) ** power)


def _look_at_releases(first: Mapping[str, Trial], swings: Mapping[str, float], warnings: list[str]) -> None:
    """Names the cases whose first swing is larger than that of the declared release, or smaller than that of others."""
    most = max((r for r in swings.values() if r <= _HIGHER), default=0.0)
    off: dict[str, float] = {}
    for case, ratio in swings.items():
        theta0 = first[case].theta0
        assert theta0 is not None
        known = _SURE * theta0.std / abs(theta0.value)
        if ratio > max(_HIGHER, 1.0 + known) or ratio < min(_LOWER * most, 1.0 - known):
            off[case] = ratio
    if not off:
        return
    ratios = "; ".join(f"case {case} {ratio:.2g} times the declared one" for case, ratio in off.items())
    rest = ", ".join(f"{ratio:.2g}" for case, ratio in swings.items() if case not in off)
    warnings.append(
        f"trials.csv: uncoupled, the first swing is that of another release than declared: {ratios}"
        + (f" (other cases {rest})" if rest else "")
        + "; correct theta0 there, or see whether the sensor's scale is right and it does not saturate; a spring that "
        "stiffens or softens looks so too, which `diagnose` shows"
    )


def _drives(head: Head, trial: Trial) -> tuple[float, float, float] | None:
    """How far each channel has gone after the release, over what a free primary does; from where on that is no noise.

    1, 0: a primary without friction and a secondary that stays. None where that is unknown: an unknown release,
    a torque, inertias that are coupled, a record that begins too late or holds too few readings.
    """
    if len(trial.channels) < 2 or trial.theta0 is None or trial.theta0.value == 0.0 or trial.driven:
        return None
    if head.measurement.start != "rest" or head.rig.inertial_coupling.value != 0.0 or head.rig.restoring != "linear":
        return None
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    power = DERIVATIVE[head.measurement.quantity]
    if power == 0 and any(frozen_for(trial, c, omega) for c in trial.channels):
        return None
    reach = abs(trial.theta0.value) * omega**power
    held = [float(np.median(c[:3])) if power == 0 else 0.0 for c in trial.channels]
    onset = math.inf
    for channel, level in zip(trial.channels, held, strict=True):
        start = math.copysign(trial.theta0.value, level) if power == 0 else trial.theta0.value
        if power == 0 and abs(level - start) > 0.3 * abs(start):  # held elsewhere than declared
            start = level
        away, bound = departure(trial.times, channel, head.measurement.quantity, start)
        if np.any(away > bound):
            share = min(bound / reach, 1.0)
            before = (math.acos(1.0 - share), math.asin(share), 0.0)[power] / omega  # it has moved unseen for so long
            onset = min(onset, float(trial.times[int(np.argmax(away > bound))]) - before)
    inside = (trial.times >= onset) & (trial.times <= onset + _FIRST / omega)
    if np.count_nonzero(inside) < 3:
        return None
    phase = omega * (trial.times[inside] - onset)
    expected = (1.0 - np.cos(phase), np.sin(phase), np.cos(phase))[power] * reach
    size = float(np.mean(expected))
    sign = math.copysign(1.0, trial.theta0.value)
    gone = [-sign * float(np.mean(c[inside] - h)) / size for c, h in zip(trial.channels, held, strict=True)]
    noise, count = look.noise_floor_of(trial.channels[1]) / size, float(np.count_nonzero(inside))
    # Three readings say where a displacement was held, and are off by two thirds of the noise of one.
    least = 4.0 * noise * math.sqrt(1.0 / count + 0.45) if power == 0 else 6.0 * noise / math.sqrt(count)
    return gone[0], gone[1], max(0.02, least)
