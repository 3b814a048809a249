"""What can be read but looks odd: clocks, releases, saturation, repeats that are unlike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look
from bayes_damper.campaign.declarations import frozen_for, held_at, up_to_release, wiring_of
from bayes_damper.campaign.head import Head, per_channel
from bayes_damper.campaign.records import DERIVATIVE, USUAL_LAG, departure, picks
from bayes_damper.campaign.structure import SHOWN, Trial, channel_columns, groups_of, natural_period
from bayes_damper.rig.units import motion_in_words
from bayes_damper.text import counted

Array = NDArray[np.float64]
_UNEVEN = 0.01  # of the usual step, by which another one departs from it
_JITTERS = 0.25  # of it, up to which a step of two differs clearly from a step of one
_RATE = 0.02  # by which the rate of the time column departs from the declared one
_STILL_HELD = 0.3  # of the largest acceleration, below which the first one may be that of a rig that is still held
_BESIDE = 1.5  # steps from the nominal release, within which a record begins with it
_RANGE, _ABOVE = 0.98, 1.05  # of a sensor's range: at its end, and beyond it
_NOISE = 3.0  # times the declared noise, or a part of it
_OF_STEPS = 1.5  # of an encoder: its rounding, that of its zero, and that of a mean between two steps, half a step each
_OF_DECLARED = 3.0  # times offset_std
_MISSING = 0.2  # share of the readings that are not there
_RESTS = {"displacement": 1.0, "velocity": 0.5, "acceleration": 0.5}
"""Radians of the oscillation for which a primary must rest, so that it is held and not at a turning point."""
_SHORT = 0.8  # of the longest repeat's end, before which a record counts as ending early
_BEGINS = {"displacement": 0.8, "velocity": 0.3, "acceleration": 0.4}
"""First readings of a release: a displacement is above this share of theta0, a velocity below this share of its
largest, an acceleration above it."""
_HELD, _SOON = 0.3, 0.2
"""Radians of the oscillation within which a record of accelerations that begins at 0 begins its motion, where it does
not rest first; and within which they then reach what a release has, where it jumps and does not swing there."""
_APART, _OF_MOTION = 4.0, 0.1  # times the distance of repeats from each other, and of their rms, of one that is odd
_COMMON = 8  # readings in which repeats are compared, at least
_UNLIKE = 0.3  # rms difference over rms, from which repeats are held to be of different channels
_ALIKE = 0.25  # of its distance from its own repeats, up to which a trial is like one of another case
_SPRINGS = 0.02  # by which a trial's spring may differ from that of its repeats
_PACES = np.linspace(1.0 - 0.5 * _SPRINGS, 1.0 + 0.5 * _SPRINGS, 81)  # of its repeats' time, at which it then runs
_TURNED = "; where `init` made the campaign, run it again with --sign -1 (coupled: one for each channel, such as -1 1)"
_OTHER_SIDE = "on the other side of 0 than theta0"
_GROWS = 0.4  # of the largest excursion, which a free decay exceeds within its first period
_FEW = 3  # readings at rest, and in the first swing, that show which way it goes


def look_at_trial(head: Head, trial: Trial, swings: float, warnings: list[str]) -> None:
    """Everything about one record that can be handled but should be known.

    swings : frequency of the primary on the spring of this case, over the declared one
    """
    _look_at_clock(head, trial, warnings)
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    free = head.measurement.start == "free"
    alone = not trial.driven and (free or _begins_at_rest(head, trial))
    grows = _growth(trial, 0.5 * omega / math.pi, free) if alone else []
    filled_in = [_look_at_channel(head, trial, i, omega, bool(grows), warnings) for i in range(len(trial.channels))]
    wiring = wiring_of(head, trial)
    if wiring == "exchanged":
        return  # reported with its repeats
    turned = {
        "reversed": "goes the other way than the primary, which drags the secondary along",
        "mirrored": "stands as far on the other side of 0 as the primary, but the model releases both from one side",
    }
    if other := turned.get(wiring or ""):
        warnings.append(f"{trial.file}: at the release the second channel {other}; its sign looks reversed{_TURNED}")
    released = head.measurement.start == "rest" and trial.theta0 is not None
    pushed = trial.driven and trial.theta0 is not None and not trial.theta0.value
    if released and not grows and not any(filled_in) and not pushed:
        _look_at_release(head, trial, swings * omega, warnings)
    warnings += grows


def _look_at_channel(head: Head, trial: Trial, i: int, omega: float, grows: bool, warnings: list[str]) -> bool:
    """What is odd about one channel; whether most of its readings, or the first of them, were not measured.

    omega : rad/s of the rig; grows : whether a free motion gains energy.
    """
    y = trial.channels[i]
    coupled = len(trial.channels) > 1
    given = per_channel(head.measurement.noise_std, coupled)
    declared = per_channel(head.measurement.offset_std, coupled)
    limits = per_channel(head.measurement.sensor_range, coupled)
    where = f"{trial.file}, column '{channel_columns(trial, head.rig.kind, head.measurement.quantity)[i]}'"
    noise = look.noise_floor_of(y, trial.times)
    step = look.resolution_of(y)
    if np.ptp(y) == 0.0:
        warnings.append(f"{where}: every reading is the same; the sensor looks dead")
        return False
    if (filled := look.filled_in_of(y, step)) is not None:
        others = "lie on straight lines between those" if filled[1] else "repeat it"
        warnings.append(
            f"{where}: only one reading in {filled[0]} was measured, the others {others}: this hides the noise and "
            "counts each reading several times; give the readings as they were measured"
        )
        return True
    frozen = frozen_for(trial, y, omega) if head.measurement.quantity == "displacement" else 0
    held_for = frozen or _held_for(head, trial, y)
    stuck = (-frozen, 0) if frozen else look.standstill_of(y[held_for:], step)
    if stuck is not None:
        start, end = trial.times[held_for + stuck[0]], trial.times[held_for + stuck[1] - 1]
        warnings.append(
            f"{where}: stands still at {y[held_for + stuck[0]]:.4g} from {start:.4g} to {end:.4g} s, "
            f"{stuck[1] - stuck[0]} equal readings: the logger or the sensor stopped; leave them out of the record"
        )
    if (rounded := step or look.resolution_of(y, look.RECUR)) > noise:
        warnings.append(f"{where}: quantised in steps of {rounded:.3g}; noise below that cannot be seen")
    strongest = look.dominant_frequency(trial.times, y)
    slowest = 2.0 * math.pi * strongest  # of a coupled rig's slow mode: round tops
    reacts = trial.prescribed and i == 0  # dry friction has flat tops
    begins_held = head.measurement.quantity == "displacement"
    tops = look.flat_tops_of(trial.times, y, noise, min(omega, max(slowest, 0.25 * omega)), begins_held)
    for level in [] if reacts or grows else tops:  # a hand that holds the rig makes them too
        warnings.append(f"{where}: flat tops at {level:.4g}; it looks clipped there")
    if limits is not None and np.max(np.abs(y)) > _RANGE * limits[i]:
        beyond = float(np.max(np.abs(y))) > _ABOVE * limits[i]
        warnings.append(
            f"{where}: readings go to {np.max(np.abs(y)):.4g}, beyond the sensor's range of {limits[i]:.4g}: is "
            "sensor_range in the unit of the readings?"
            if beyond
            else f"{where}: readings reach the sensor's range of {limits[i]:.4g}; it may be clipped"
        )
    spikes = look.outliers_of(trial.times, y, noise, omega, head.measurement.quantity == "displacement")
    if spikes:
        some = ", ".join(f"{trial.times[j]:.4g}" for j in spikes[:SHOWN])
        more = f" and {len(spikes) - SHOWN} more" if len(spikes) > SHOWN else ""
        warnings.append(
            f"{where}: 1 single reading sticks out, at {some} s; it looks like an outlier"
            if len(spikes) == 1
            else f"{where}: {len(spikes)} single readings stick out, at {some} s{more}; they look like outliers"
        )
    offset = look.offset_of(trial.times, y, noise, omega, strongest)
    if stuck is not None and offset:  # where it stands still it swings about nothing
        first, last = held_for + stuck[0], held_for + stuck[1]
        moves = slice(first) if first > y.size - last else slice(last, None)
        offset = look.offset_of(trial.times[moves], y[moves], noise, omega)
    expected = _OF_DECLARED * declared[i] if declared is not None else 0.0  # fits infer it within that
    if abs(offset) > max(_OF_STEPS * step if step > noise else 0.0, expected):
        _tell_offset(head, trial, where, offset, warnings)
    if given is not None and noise > 0.0 and not reacts and not 1.0 / _NOISE <= noise / given[i] <= _NOISE:
        warnings.append(f"{where}: noise is about {noise:.3g}, noise_std says {given[i]:.3g}; check unit and sensor")
    return frozen > 0


def _tell_offset(head: Head, trial: Trial, where: str, offset: float, warnings: list[str]) -> None:
    """A warning where a channel should rest at 0 and does not."""
    held = head.measurement.quantity == "displacement" and head.measurement.start == "rest"
    if not trial.driven and not (head.rig.restoring == "pendulum" and held):
        half = _is_angle(head) and abs(abs(offset) - math.pi) < 0.1
        held_off = ", or dry friction holds it there" if head.measurement.quantity == "displacement" else ""
        turned = " (half a turn: it may count from the upper position)" if half else ""
        warnings.append(
            f"{where}: rests at {offset:.3g} at the end, not at 0{turned}; the sensor has an "
            f"offset{held_off}: `init --offset tail` takes off what it reads at the end, offset_std under "
            "[measurement] of campaign.toml lets fits infer it"
        )


def _held_for(head: Head, trial: Trial, y: Array) -> int:
    """Equal readings with which a channel begins because the rig is held: a displacement, or until the release."""
    moved = y != y[0]
    count = int(np.argmax(moved)) if moved.any() else 0
    if head.measurement.start != "rest" or count < 2:
        return 0
    step = float(np.median(np.diff(trial.times)))
    at_rest = head.measurement.quantity == "displacement" or float(trial.times[count - 1]) <= 0.5 * step
    return count if at_rest else 0


def _begins_at_rest(head: Head, trial: Trial) -> bool:
    """Whether a displacement that should begin with its release begins near 0 and later goes as far as that."""
    if head.measurement.quantity != "displacement" or trial.theta0 is None or trial.times[0] < 0.0:
        return False
    sizes, held = np.abs(trial.channels[0]), abs(trial.theta0.value)
    return float(np.median(sizes[:_FEW])) < 0.1 * held and float(np.max(sizes)) > _BEGINS["displacement"] * held


def _growth(trial: Trial, natural: float, free: bool) -> list[str]:
    """A sentence where a decay begins small and then grows: at rest, or in a hand, before it was let go.

    natural : frequency of the rig, Hz; free : whether the start is inferred, of a rig that may swing at another one
    """
    frequency = look.dominant_frequency(trial.times, trial.channels[0]) if free else natural
    if trial.coupled:  # such a rig comes to rest soon, and a hand may be what swings most
        frequency = max(frequency, 0.5 * natural)
    if frequency == 0.0 or np.ptp(trial.times) < 3.0 / frequency:
        return []
    first = trial.times < trial.times[0] + 1.0 / frequency
    sizes = [np.abs(y - np.median(y[trial.times > np.median(trial.times)])) for y in trial.channels]
    if np.count_nonzero(first) < 4 or any(np.max(s[first]) > _GROWS * np.max(s) for s in sizes):
        return []
    largest = float(trial.times[int(np.argmax(sizes[0]))])
    option = f"`init --release {look.release_option(trial.times, trial.channels[0])}`"
    cure = f'put t = 0 there and take off what is read before; or, with start = "free" and no theta0, {option}'
    if free:
        cure = f'fits with start = "free" need a record of the decay alone: {option}, or take the first readings off'
    sentence = (
        f"{trial.file}: the motion grows until {largest:.4g} s: the rig rests, or a hand moves it, before it is let "
        f"go; {cure}"
    )
    return [sentence]


def _is_angle(head: Head) -> bool:
    """Whether the readings are angles."""
    return head.rig.kind == "torsional" and head.measurement.quantity == "displacement"


def _look_at_clock(head: Head, trial: Trial, warnings: list[str]) -> None:
    times = trial.times
    step, counts = look.clock_of(times)
    rate = head.measurement.sample_rate
    steps = np.diff(times)
    mean, doubt = float(np.mean(steps)), float(np.std(steps)) / math.sqrt(steps.size)
    if rate is not None and abs(step * rate - 1.0) > _RATE and abs(mean * rate - 1.0) > _RATE + 4.0 * doubt * rate:
        warnings.append(
            f"{trial.file}: the time column says {1.0 / step:.5g} Hz, "
            f"sample_rate says {rate:.5g}; the time column decides"
        )
    uneven = look.unevenness_of(times)
    if uneven > _UNEVEN:
        most = f"{float(f'{100.0 * uneven:.2g}'):g} %"
        rounded = look.rounded_clock(times)
        why = (
            f", as those of stamps rounded to {rounded[0]:g} s; fits take the readings as even, at {rounded[1]:.5g} Hz"
            if rounded
            else ""
        )
        warnings.append(f"{trial.file}: time is uneven: steps depart from {step:.4g} s by up to {most}{why}")
    gaps = look.gaps_of(times) if counts else []
    if gaps:
        longest = max(gaps, key=lambda g: g[1] - g[0])
        warnings.append(
            f"{trial.file}: {counted(len(gaps), 'gap')} in time, {'the longest ' if len(gaps) > 1 else ''}"
            f"from {longest[0]:.4g} to {longest[1]:.4g} s"
        )
    missing, singles = (look.missing_of(times), look.singles_missing(times)) if counts else (0.0, 0)
    if singles and uneven <= _JITTERS and missing <= _MISSING:
        verb = "is" if singles == 1 else "are"
        warnings.append(f"{trial.file}: {counted(singles, 'single reading')} {verb} missing")
    if missing > _MISSING:
        warnings.append(
            f"{trial.file}: {missing:.0%} of the readings between the first and the last are missing; see how the "
            "record was exported"
        )
    if times[0] > _BESIDE * step:
        warnings.append(f"{trial.file}: late start: the record begins {times[0]:.4g} s after the nominal release")


def _look_at_release(head: Head, trial: Trial, omega: float, warnings: list[str]) -> None:
    """Late trigger, start in the middle of the motion, reversed sign: seen in the first readings."""
    times, quantity = trial.times, head.measurement.quantity
    y = look.without_outliers(times, trial.channels[0], omega, quantity == "displacement")
    power = DERIVATIVE[quantity]
    if power:  # what a sensor reads at rest is no motion
        y = y - look.offset_of(times, y, look.noise_floor_of(y, times), omega)
    assert trial.theta0 is not None
    sign = math.copysign(1.0, trial.theta0.value) * (1.0 if power == 0 else -1.0)
    level = abs(trial.theta0.value) if power == 0 else 0.0
    rest = 0.0 if power == 0 and _is_held(trial, omega) else _RESTS[quantity]
    if not trial.driven and (onset_away := _moves_the_wrong_way(times, sign * y, quantity, omega, rest)) is not None:
        at_rest = (
            f"at rest until {onset_away:.4g} s and then begins to move away from its rest position, not towards it"
        )
        warnings.append(_reversed(trial, _OTHER_SIDE if power == 0 else at_rest))
        y = -y
    away, bound = departure(times, y, quantity, trial.theta0.value)
    departed = away > bound
    if not departed.any():
        return
    onset = float(times[int(np.argmax(departed))])
    step = float(np.median(np.diff(times)))
    early = trial.times[0] < -_BESIDE * step and onset < -_BESIDE * step
    held = held_at(head, trial)
    if early and held is not None and (y[0] > 0.0) == (trial.theta0.value > 0.0):
        warnings.append(f"{trial.file}: before the release {_elsewhere(head, float(held[0]), level)}")
    elif early and power == 0 and sign * y[0] < -0.3 * float(np.max(np.abs(y))):
        warnings.append(_reversed(trial, _OTHER_SIDE))
    elif early:
        warnings.append(
            f"{trial.file}: motion begins {-onset:.4g} s before the nominal release; the trigger came late; "
            "fits take the release from the record"
        )
    first = _first_of(times, y, power, omega, onset)
    largest = float(np.max(np.abs(y)))
    begins = _BEGINS[quantity]
    middle = {
        0: sign * first < begins * level,
        1: abs(first) > begins * largest,
        2: sign * first < begins * float(np.quantile(np.abs(y), 0.998)) and onset < times[0] + _HELD / omega,
    }[power]
    away_at_once = (
        power == 1 and not trial.driven and _moves_the_wrong_way(times, sign * y, quantity, omega, 0.0) is not None
    )
    if times[0] <= _BESIDE * step and not early and (middle or away_at_once):
        reversed_sign = away_at_once or (power != 1 and sign * first < -0.3 * largest)
        looks = "; the sign of the channel looks reversed, or " if reversed_sign else "; "
        if power == 0 and sign * first > begins * largest:  # it never swings farther
            looks = f": {_elsewhere(head, float(y[0]), level)}, or "
        elif power == 2 and abs(first) < _STILL_HELD * largest:
            looks = "; what holds the rig lets go slowly, or "
        warnings.append(
            f"{trial.file}: the first readings are not those of a release"
            f"{looks}the record begins after the motion began{_TURNED if reversed_sign else ''}"
        )
    elif onset > USUAL_LAG[quantity] / omega + _BESIDE * step and times[0] <= _BESIDE * step:
        warnings.append(
            f"{trial.file}: motion begins {onset:.4g} s after the nominal release; the trigger came early, the rig "
            "stuck or was let go slowly, or the sensor is slow; fits infer the instant of each release"
        )


def _elsewhere(head: Head, at: float, level: float) -> str:
    """Words for a primary that stands elsewhere than declared; at, level : rad (m), by the readings and by theta0."""
    stands, declared = (motion_in_words(abs(x), head.rig.kind) for x in (at, level))
    return (
        f"the primary stands {stands} from 0, not {declared} as theta0 says; correct theta0 in trials.csv "
        "(where `init` made the campaign, --theta0 or {theta0} in --pattern), or the sensor's zero or scale "
        "(--offset, --units)"
    )


def _first_of(times: Array, y: Array, power: int, omega: float, onset: float) -> float:
    """What is read first: of an acceleration that was held until then, as fast as latch and sensor let it jump."""
    if power == 2 and onset > times[0]:
        return float(y[min(int(np.searchsorted(times, onset + _SOON / omega)), len(y) - 1)])
    # A fast rig that is read slowly has swung far at its second reading.
    coarse = power == 1 and omega * float(times[1] - times[0]) > 0.5 * _BEGINS["velocity"]
    return float(np.median(y[: 1 if coarse else 3]))


def _reversed(trial: Trial, held: str) -> str:
    """The warning that a channel looks reversed; held : how the primary is held before the release."""
    return (
        f"{trial.file}: the primary is held {held}; the sign of the channel looks reversed (or that of theta0 in "
        f"trials.csv){_TURNED}"
    )


def _is_held(trial: Trial, omega: float) -> bool:
    """Whether displacements up to t = 0 show a primary at rest: its turning point, at omega (rad/s), would be bent."""
    until = up_to_release(trial)
    if np.count_nonzero(until) < _FEW:
        return False
    slowest = 0.5 * omega if trial.coupled else omega
    turn = min(0.5 * slowest * float(np.ptp(trial.times[until])), 0.5 * math.pi)
    y = trial.channels[0][until]
    return float(np.ptp(y)) < 0.5 * abs(float(np.median(y))) * (1.0 - math.cos(turn))


def _moves_the_wrong_way(times: Array, y: Array, quantity: str, omega: float, rest: float = 1.0) -> float | None:
    """When the motion begins, in s, where a primary that is held at first then moves as if released on the other side.

    None where it moves as it should, or where the record holds too little to judge: a shorter rest (what is shorter
    than a radian of the oscillation may be a turning point, if no jump of an acceleration ends it), or fewer than three
    readings of the first swing.

    y : (n,) the readings, times the sign that they should have at first; omega : rad/s of the primary on its spring;
    rest : rad of that oscillation
    """
    largest = float(np.quantile(np.abs(y), 0.998))
    held = float(np.median(y[:_FEW])) if quantity == "displacement" else 0.0
    bound = max(8.0 * look.noise_floor_of(y, times), 0.05 * float(np.max(np.abs(y))))
    moving = np.abs(y - held) > bound
    lasting = moving[:-2] & moving[1:-1] & moving[2:]
    k = int(np.argmax(lasting)) if lasting.any() else 0
    if rest > 0.0 and k < _FEW:
        return None
    if times[k] - times[0] < rest / omega and not (quantity == "acceleration" and _jumps(y, k, bound)):
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


def _jumps(y: Array, k: int, bound: float) -> bool:
    """Whether readings that stay within the bound until k then go where no smooth motion could, as at a release.

    A parabola that turns round among the k readings, from one bound to the other, gets to 2 bound (x/h)^2 - bound at x
    steps from their middle, where h is half their length.
    """
    half = 0.5 * (k - 1)
    return bool(np.all(np.abs(y[k + 1 : k + 3]) > bound * (2.0 * (1.0 + 2.0 / half) ** 2 - 1.0)))


def look_at_rates(head: Head, trials: Sequence[Trial], warnings: list[str]) -> None:
    """Whether fits pick readings of their own accord, because there are very many of them."""
    measurement = head.measurement
    if measurement.every is not None or not trials:
        return
    swings = measurement.quantity != "acceleration" and measurement.start == "free"
    steps = [float(np.median(np.diff(t.times))) for t in trials]
    period = min(natural_period(head.rig, t) for t in trials)
    picked = picks([t.channels.size for t in trials], steps, period, swings)
    if swings or max(picked) == 1:
        return
    few, most = min(picked), max(picked)
    per_period = f"{most}" if few == most else f"{few} to {most}"
    warnings.append(
        f"{sum(t.channels.size for t in trials)} readings, {period / min(steps):.0f} in a period: fits use one in "
        f"{per_period}, enough to show the motion, for less time and memory; `every = 1` under [measurement] of "
        "campaign.toml uses all"
    )


def look_at_repeats(head: Head, trials: Sequence[Trial], warnings: list[str]) -> None:
    """Adds as warnings what is odd between trials: copies, stiffnesses, lengths, repeats that are unlike."""
    stiffness: dict[str, set[float]] = {}
    for trial in trials:
        stiffness.setdefault(trial.case, set()).add(trial.k1t.value)
    for case, values in stiffness.items():
        if len(values) > 1:
            warnings.append(
                f"trials.csv: case {case} has several k1t "
                f"({', '.join(f'{v:g}' for v in sorted(values))}); one case is one spring"
            )
    spelt: dict[str, list[str]] = {}
    for case in stiffness:
        spelt.setdefault(case.casefold(), []).append(case)
    warnings += [
        f"trials.csv: the cases {' and '.join(names)} differ in capitals only and count as {len(names)}: is one meant?"
        for names in spelt.values()
        if len(names) > 1
    ]
    single = [f"{case} {configuration}" for (case, configuration), g in groups_of(trials).items() if len(g) == 1]
    if single:
        warnings.append(
            f"trials.csv: only one trial of {', '.join(single)}: its repeatability is unknown"
            + ("" if any(t.holdout for t in trials) else ", and it is not held out")
        )
    _look_for_copies(trials, warnings)
    for group in groups_of(trials).values():
        _look_for_short_twin(group, warnings)
        free = [trial for trial in group if not trial.driven]  # what is driven moves as its input does
        if head.measurement.start != "rest" or (free and _look_for_exchanged_twin(free, warnings)):
            continue
        warnings += [
            f"{trial.file}: the second channel begins as the released primary must, and the first does not; the "
            "channels look exchanged: correct the order of the columns"
            for trial in group
            if wiring_of(head, trial) == "exchanged"
        ]
        if len(free) > 2:
            _look_for_odd_twin(free, head.measurement.quantity, warnings, trials)


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
    """Names repeats that end much earlier than the longest one, of those that were not cut on purpose."""
    group = [t for t in group if not t.cut]
    group = [t for t in group if not t.holdout] or group  # stretches that were kept for a test may be shorter
    ends = [float(t.times[-1]) for t in group]
    longest = max(ends, default=0.0)
    short = [f"{t.file} at {end:.4g} s" for t, end in zip(group, ends, strict=True) if end < _SHORT * longest]
    if short:
        some = ", ".join(short[:SHOWN]) + (f" and {len(short) - SHOWN} more" if len(short) > SHOWN else "")
        warnings.append(
            f"case {group[0].case} {group[0].configuration}: repeats of different length: {some}, the longest at "
            f"{longest:.4g} s; every record is used to its end, but how repeats scatter is seen only where two of "
            "them last: was one cut off?"
        )


def _look_for_odd_twin(group: Sequence[Trial], quantity: str, warnings: list[str], trials: Sequence[Trial]) -> None:
    """Compares repeats of equal release with each other; one that is four times as far off as the rest is named.

    trials : of the whole campaign, among whose other cases the odd one may belong.

    Each runs from the onset of its own motion, and the jump there is left out: a late trigger is no other motion.
    """
    clocks = [t.times - _onset(t, quantity) for t in group]
    steps = [float(np.median(np.diff(t.times))) for t in group]
    start, end = max(c[0] for c in clocks), min(c[-1] for c in clocks)
    inside = (clocks[0] >= max(start, 2.0 * max(steps))) & (clocks[0] <= end)
    grid = clocks[0][inside]
    grid = grid[~np.any([look.within_gaps(grid, c) for c in clocks], axis=0)]
    if len(grid) < _COMMON:
        warnings.append(f"{group[0].file} and its repeats hardly overlap in time; they cannot be compared")
        return
    worst: dict[str, tuple[float, float]] = {}
    for channel in range(len(group[0].channels)):
        curves = np.stack(
            [np.interp(grid, c, t.channels[channel]) / _release(t) for c, t in zip(clocks, group, strict=True)]
        )
        distance = np.sqrt([np.mean((curves - curve) ** 2, axis=-1) for curve in curves])
        noise = max(look.noise_floor_of(c) for c in curves)
        scale = float(np.sqrt(np.median(np.mean(curves**2, axis=-1))))
        for i, trial in enumerate(group):
            others = np.delete(np.delete(distance, i, 0), i, 1)
            usual = float(np.median(others[np.triu_indices(len(group) - 1, 1)]))
            nearest = float(np.min(np.delete(distance[i], i)))
            bound = max(_APART * usual, _OF_MOTION * scale, 4.0 * noise)
            if nearest > bound and _at_another_pace(grid, curves, i) > bound:
                worst[trial.file] = max(worst.get(trial.file, (0.0, 0.0)), (nearest / scale, usual / scale))
                break
    for file, (nearest, usual) in worst.items():
        odd = next(t for t in group if t.file == file)
        home = _looks_like(odd, quantity, nearest, trials)
        warnings.append(
            f"{file}: unlike its repeats: {nearest:.0%} away from the nearest, they {usual:.0%} from each other"
            + ("; see what was different" if home is None else f"; it is like the trials of case {home}: a wrong name?")
        )


def _at_another_pace(times: Array, curves: Array, odd: int) -> float:
    """Rms distance of a record from the nearest of its repeats, all (trials, n) at times (n,), were its spring theirs.

    A spring that differs by half a per cent, as springs do from trial to trial, is a radian apart after 60 periods.
    """
    paces = [np.interp(pace * times, times, curves[odd], left=np.nan, right=np.nan) for pace in _PACES]
    rest = np.delete(curves, odd, 0)
    return float(np.sqrt(min(np.nanmean((rest - curve) ** 2, axis=1).min() for curve in paces)))


def _looks_like(odd: Trial, quantity: str, away: float, trials: Sequence[Trial]) -> str | None:
    """The other case that an odd trial is like: near one of its trials, measured alike."""
    nearest, case = min(((_unlike(odd, t, quantity), t.case) for t in trials if t.case != odd.case), default=(away, ""))
    return case if nearest < _ALIKE * away else None


def _unlike(odd: Trial, other: Trial, quantity: str) -> float:
    """Rms difference of two trials from the release of the other one on, over its rms; inf where none can be taken."""
    clocks = odd.times - _onset(replace(odd, theta0=other.theta0), quantity), other.times - _onset(other, quantity)
    grid = clocks[0][(clocks[0] > 0.0) & (clocks[0] <= clocks[1][-1])]
    if len(grid) < _COMMON or len(other.channels) != len(odd.channels):
        return math.inf
    y, x = (
        np.stack([np.interp(grid, clock, channel) for channel in trial.channels])
        for clock, trial in zip(clocks, (odd, other), strict=True)
    )
    return float(np.sqrt(np.mean((x - y) ** 2))) / (float(np.sqrt(np.mean(x**2))) or 1.0)


def look_for_exchanged_trials(head: Head, trials: Sequence[Trial], warnings: list[str]) -> list[Trial]:
    """Names two trials of a case, and two of another, that are alike across the cases only; those trials.

    Where a case has more repeats, `look_at_repeats` names the odd one.
    """
    quantity, found = head.measurement.quantity, list[Trial]()

    def unlike(a: Trial, b: Trial) -> float:
        return min(_unlike(a, b, quantity), _unlike(b, a, quantity))

    groups = groups_of([t for t in trials if t.theta0 is not None and not t.driven]).values()
    pairs = [
        (a, b)
        for a, b in (group for group in groups if len(group) == 2)
        if (a.theta0, a.k1t) == (b.theta0, b.k1t) and unlike(a, b) > _UNLIKE
    ]
    for (a, b), (c, d) in combinations(pairs, 2):
        apart = unlike(a, b), unlike(c, d)
        for x, y in ((c, d), (d, c)):
            if max(unlike(a, x), unlike(b, y)) < _ALIKE * min(apart):
                warnings.append(
                    f"{a.file}: like {x.file} of case {x.case}, and {b.file} like {y.file}, but repeats are "
                    f"{apart[0]:.0%} and {apart[1]:.0%} apart: two of these records look exchanged between the cases; "
                    "correct their names in trials.csv"
                )
                found += [a, b, c, d]
    return found


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
    alike = (
        f"unlike: {straight:.0%} apart as they are, {exchanged:.0%} with the channels of one exchanged; correct the "
        "order of the columns"
    )
    if len(fewer) == len(more):
        warnings.append(
            f"{', '.join(t.file for t in even)} and {', '.join(t.file for t in odd)}: repeats {alike} of one"
        )
    else:
        warnings.append(f"{', '.join(t.file for t in fewer)}: channels exchanged? It and its repeats are {alike}")
    return True


def _apart(a: Trial, b: Trial) -> tuple[float, float]:
    """Rms difference of two repeats over the rms of the first, as they are and with the channels of one exchanged.

    (0, 0) where they cannot be compared: one channel only, or hardly any time in common.
    """
    inside = (a.times >= b.times[0]) & (a.times <= b.times[-1]) & ~look.within_gaps(a.times, b.times)
    if len(a.channels) < 2 or np.count_nonzero(inside) < _COMMON:
        return 0.0, 0.0
    x = a.channels[:, inside] / _release(a)
    y = np.stack([np.interp(a.times[inside], b.times, channel) for channel in b.channels]) / _release(b)
    size = float(np.sqrt(np.mean(x**2))) or 1.0
    return float(np.sqrt(np.mean((x - y) ** 2))) / size, float(np.sqrt(np.mean((x - y[::-1]) ** 2))) / size


def _onset(trial: Trial, quantity: str) -> float:
    """Time of the first reading that has left the held rig, in s; that of the first reading where none has."""
    if trial.theta0 is None:
        return 0.0
    away, bound = departure(trial.times, trial.channels[0], quantity, trial.theta0.value)
    return float(trial.times[int(np.argmax(away > bound))])


def _release(trial: Trial) -> float:
    return trial.theta0.value if trial.theta0 is not None and trial.theta0.value else 1.0
