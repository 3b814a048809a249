"""What the readings of one channel look like, before any model: noise floor, resolution, gaps, flat tops, spikes.

Pure functions of arrays; the campaign makes sentences of what they find. Nothing here alters a reading.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MAD_TO_SD = 1.482602218505602
EVEN = 1e-3  # of the usual step, up to which a clock is even
GAP, DOUBLE = 2.5, 1.5  # usual steps from one reading to the next: above them several are missing, or one
LONG_GAP = 8.0  # the same: above it a line through the gap is a motion that nobody measured
OFF_GRID, FEW_DOUBLE = 0.2, 3  # rms of steps from whole multiples of one; double steps that stamps do not explain
MARKS = (3, 3.0)  # equal readings that stand for missing ones, and times all others that they are
OFF_A_STEP = 0.15  # of a step of rounding, by which a difference may miss a multiple of it
STOPPED = 8  # equal readings of a sensor that never repeats itself otherwise
FILLED_RUNS, FILLED = 8, 0.4  # runs of readings that were put in, and the least share of the steps that they hold
STANDS_OUT, EQUAL = 12.0, 3  # noises by which a top stands out, and equal readings that make it flat
TURNED, TOP = 1.4, 6.0  # times that a sinusoid turns for, which a flat top lasts, and the noises within which it lies
RECUR = 0.9  # share of the readings that may be distinct in a quantised channel: a few hundred of an encoder's steps
UNITS = (0.1, 0.01, 1e-3, 1e-4, 1e-5)  # s, that stamps are rounded to
ROUNDED_OFF = 0.55  # of such a unit: half of it, and what a line through the stamps errs by
SPIKE = 10.0  # noises by which a single reading leaves its neighbours
OF_SCATTER, OF_ERROR = 0.15, 8.0  # of the scatter, and standard errors, beyond which a level of rest is not 0
_LOST = 1.5  # usual steps, from which one shows that a reading is lost
_HELD = 0.78  # of its peak: what is still further out half-way to the next crossing does not swing freely yet


def noise_floor_of(readings: Array, times: Array | None = None) -> float:
    """Standard deviation of the white noise of one channel, in the unit of the readings.

    Differences of order six cancel whatever is smooth over seven samples; their median absolute value, divided by
    sqrt(924) (the root of the sum of the squared binomial coefficients), is the noise. Robust against jumps and
    spikes; noise that is correlated over several samples (a low-pass sensor) comes out too small. Never below the
    noise of rounding, step / sqrt(12). Zero for fewer than four readings.

    readings : (n,); times : (n,) s, where the clock may be uneven or lack readings: divided differences then, to the
    same effect
    """
    order = 6 if len(readings) >= 20 else 2
    if len(readings) < order + 2:
        return 0.0
    if times is not None and np.ptp(steps := np.diff(times)) > EVEN * np.median(steps):
        largest = max(float(np.max(np.abs(readings))), 1e-300)  # readings of 1e308 have no finite sum
        differences = largest * _divided_differences(times, readings / largest, order)
    else:
        differences = np.diff(readings, order) / math.sqrt(math.comb(2 * order, order))
    noise = _MAD_TO_SD * float(np.median(np.abs(differences)))
    if noise == 0.0:
        noise = min(float(np.std(differences)), float(np.std(readings)))
    step = resolution_of(readings)
    return max(noise, step / math.sqrt(12.0)) if step > 0.0 else noise


def _divided_differences(times: Array, readings: Array, order: int) -> Array:
    """Divided differences (at most 20 000 of them) in which white noise keeps its standard deviation."""
    size = order + 1
    first = np.unique(np.linspace(0, len(readings) - size, 20_000).astype(np.intp))
    window = first[:, None] + np.arange(size)
    t = times[window]
    apart = (t[:, :, None] - t[:, None, :]) / np.ptp(t, axis=1)[:, None, None] + np.eye(size)
    weights = 1.0 / np.prod(apart, axis=2)
    return np.asarray(np.sum(weights * readings[window], axis=1) / np.sqrt(np.sum(weights**2, axis=1)))


def resolution_of(readings: Array, distinct: float = 0.5) -> float:
    """Step in which one channel is quantised, 0 where no common step shows.

    A step shows when values recur (no more than that share of them are distinct) and all of them lie on its multiples,
    as far as the digits say with which they were written: one of a degree is 0.017 or 0.018 rad.
    """
    values = np.unique(readings)
    if len(values) < 3 or len(values) > distinct * len(readings):
        return 0.0
    steps = np.diff(values)
    steps = np.sort(steps[steps > 1e-9 * (values[-1] - values[0])])
    least = steps[: max(1, len(steps) // 10)]
    rough = float(np.median(least))
    sharp = _step_behind_digits(steps, rough)
    # A fine step has multiples near whatever there is: the least differences must be one of it.
    tried = [rough, sharp] if np.all(np.abs(least / sharp - 1.0) < OFF_A_STEP) else [rough]
    step = min(tried, key=lambda each: float(np.mean(_off_multiples(each, steps))))
    return step if np.mean(_off_multiples(step, steps) < OFF_A_STEP) > 0.8 else 0.0


def _off_multiples(step: float, steps: Array) -> Array:
    """How far differences are from multiples of a step, in steps."""
    multiples = steps / step
    return np.asarray(np.abs(multiples - np.round(multiples)))


def _step_behind_digits(steps: Array, step: float) -> float:
    """The step of which sorted differences are multiples but for the rounding of their digits; step : about that.

    The more steps a difference spans, the more exactly it gives one of them: each time those of twice as many.
    """
    for reach in 1.5 * 2.0 ** np.arange(1 + math.ceil(math.log2(max(steps[-1] / step, 1.0)))):
        some = steps[steps < reach * step]
        count = np.round(some / step)
        step = float(count @ some) / float(count @ count) if count.any() else step
    return step


def wrap_of(readings: Array) -> tuple[float, float] | None:
    """Least and largest range at whose end readings begin again, as those of a counter do; None where none do.

    They jump to and fro by nearly all that they span, and stay where they jump to for some readings, unlike spikes.
    """
    steps = np.abs(np.diff(readings))
    span = float(np.ptp(readings))
    jumps = np.flatnonzero(steps > 0.5 * span)
    if len(jumps) < 2 or float(np.median(np.diff(jumps))) < 3.0:
        return None
    usual = float(np.max(np.delete(steps, jumps), initial=0.0))
    least, most = max(span, float(np.max(steps))), float(np.max(steps)) + usual
    return (least, most) if usual < 0.25 * span and float(np.min(steps[jumps])) > least - 3.0 * usual else None


def gaps_of(times: Array) -> list[tuple[float, float]]:
    """The stretches (start, end), in seconds, where more than one sample is missing from an otherwise denser record."""
    return [(float(times[i]), float(times[i + 1])) for i in _long_steps(times, GAP)]


def _long_steps(times: Array, least: float) -> NDArray[np.intp]:
    """Indices of the readings after which the next one comes later than `least` usual steps."""
    steps = np.diff(times)
    return np.flatnonzero(steps > least * np.median(steps))


def missing_of(times: Array) -> float:
    """Share of the readings that are missing between the first and the last, 0 to 1: of steps of the usual length."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if steps.size else 1.0
    # Where every other reading is missing at random, most steps are still single ones.
    single = float(np.median(steps[steps < 1.5 * usual])) if steps.size else 1.0
    return max(0.0, 1.0 - (times.size - 1) / max(float(times[-1] - times[0]) / single, 1e-300))


def standstill_of(readings: Array, step: float) -> tuple[int, int] | None:
    """The longest run of equal readings in a channel that never repeats itself otherwise: half-open indices, or None.

    A run counts from 8 readings on, where elsewhere fewer than one in fifty equals the one before it. Runs at the
    largest and the smallest reading are left out: a sensor whose range ends. step : in which the readings are rounded
    """
    runs = _runs(np.diff(readings) == 0.0)
    if not runs or step > 0.0:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    level = readings[first]
    elsewhere = sum(b - a for a, b in runs) - (last - first)
    if last - first < STOPPED - 1 or elsewhere > 0.02 * readings.size or level in (readings.min(), readings.max()):
        return None
    return first, last + 1


def filled_in_of(readings: Array, step: float) -> tuple[int, bool] | None:
    """Whether readings were put between measured ones: (how many lie from one to the next, whether on straight lines).

    On straight lines between them, or each reading several times; None where neither shows. Regular runs tell this from
    rounded or very smooth readings. step : in which the readings are rounded, 0 if in none
    """
    if step > 0.0 or readings.size < 40:
        return None
    small = 2e-6 * float(np.ptp(readings))  # what text rounds off
    equal = np.abs(np.diff(readings)) <= small
    straight = (np.abs(np.diff(readings, 2)) <= small) & ~(equal[:-1] & equal[1:])
    for mask, lines in ((equal, False), (straight, True)):
        lengths = np.array([b - a for a, b in _runs(mask)])
        if lengths.size < FILLED_RUNS or np.mean(mask) < FILLED:
            continue
        usual = float(np.median(lengths))
        if np.mean(np.abs(lengths - usual) <= (1.0 if usual > 1.5 else 0.0)) > 0.9:
            return round(usual) + 1, lines
    return None


def mark_of(readings: Array) -> tuple[float, int] | None:
    """A number that stands for missing readings, -9999 say, and how often: several equal ones far beyond all others."""
    for value in (readings.min(), readings.max()):
        marked = readings == value
        others = readings[~marked]
        far = others.size > marked.sum() and abs(value) > MARKS[1] * np.max(np.abs(others))
        if far and np.count_nonzero(marked) >= MARKS[0]:
            return float(value), int(marked.sum())
    return None


def without_outliers(times: Array, readings: Array, omega: float, smooth: bool = False) -> Array:
    """The readings with single ones that stick out put between their neighbours."""
    spikes = outliers_of(times, readings, noise_floor_of(readings, times), omega, smooth)
    if not spikes:
        return readings
    largest = float(np.max(np.abs(readings)))  # of 1e308 there are no finite differences
    return largest * np.interp(times, np.delete(times, spikes), np.delete(readings, spikes) / largest)


def within_gaps(at: Array, times: Array) -> NDArray[np.bool_]:
    """Which instants `at` lie in a gap of the readings at `times`, where nothing was read."""
    out = np.zeros(at.shape, dtype=np.bool_)
    for start, end in gaps_of(times) if times.size > 1 else []:
        out |= (at > start) & (at < end)
    return out


def rounded_clock(times: Array) -> tuple[float, float] | None:
    """To what the stamps of an even clock were rounded, s, and its rate, Hz; None if these are not such stamps.

    times : (n,) s; single readings may be missing
    """
    step, first = np.polyfit(places := places_of(times), times, 1)
    off = float(np.max(np.abs(times - first - step * places)))
    unit = next((u for u in UNITS if np.max(np.abs(times / u - np.round(times / u))) < 1e-3), None)
    if unit is None or not EVEN * step < off < ROUNDED_OFF * unit < ROUNDED_OFF * step:
        return None
    return unit, 1.0 / float(step)


def places_of(times: Array) -> NDArray[np.intp]:
    """Which reading of an even clock each one is, from 0: (n,); those that are missing count."""
    steps = np.diff(times)
    single = float(np.mean(steps[steps < DOUBLE * np.median(steps)]))
    return np.concatenate([[0], np.cumsum(np.maximum(np.round(steps / single), 1.0))]).astype(np.intp)


def unevenness_of(times: Array) -> float:
    """Largest departure of a time step from the median step, as a share of it; gaps are left out.

    Where a single reading is missing, a step is twice as long: that is not uneven.
    """
    steps = np.diff(times)
    middle = float(np.median(steps))
    ordinary = steps[steps <= GAP * middle]
    return float(np.max(np.minimum(np.abs(ordinary - middle), np.abs(ordinary - 2.0 * middle)))) / middle


def singles_missing(times: Array) -> int:
    """How many single readings are missing: steps of about twice the median."""
    steps = np.diff(times) / np.median(np.diff(times))
    return int(np.sum((steps > DOUBLE) & (steps <= GAP)))


def clock_of(times: Array) -> tuple[float, bool]:
    """The usual step of a clock, in s, and whether steps count what is missing: all near multiples of a single one.

    They do not where each step is drawn out or cut short at random, nor where readings at even instants have coarse
    stamps or stamps with jitter: these stay within a step of a straight line, however many steps look double. The step
    is then the mean one.
    """
    steps = np.diff(times)
    usual = float(np.median(steps))
    single = float(np.median(steps[steps < DOUBLE * usual]))
    mean = float(times[-1] - times[0]) / steps.size
    stamps = float(np.ptp(times - times[0] - mean * np.arange(times.size)))
    if np.count_nonzero(steps > DOUBLE * usual) > FEW_DOUBLE and stamps < DOUBLE * single:
        return mean, False
    off = steps / single - np.round(steps / single)
    return (single, True) if float(np.sqrt(np.mean(off**2))) < OFF_GRID else (mean, False)


def flat_tops_of(times: Array, readings: Array, noise: float, omega: float, held_at_first: bool) -> list[float]:
    """The levels at which a channel seems to end: at most one below and one above.

    Two signs: runs of three and more equal extreme values (in a channel whose values do not recur otherwise), or a
    run within six standard deviations of the extreme that lasts 1.4 times as long as the turn of a sinusoid of
    angular frequency `omega` (rad/s) and is flat to the noise. With `held_at_first` a run that begins with the
    record is no sign: the rig is held there.
    """
    levels: list[float] = []
    if held_at_first:
        readings = readings[times >= min(0.0, times[-1])]
    centre = float(np.median(readings))
    step = resolution_of(readings, RECUR)
    dt = float(np.median(np.diff(times)))
    for side in (-1.0, 1.0):
        y = side * (readings - centre)
        top = float(np.max(y))
        if top <= STANDS_OUT * max(noise, step):
            continue
        if _flat_by_equality(y, top, step, dt, omega, held_at_first) or (
            step < 2.0 * noise and _flat_by_spread(y, top, max(noise, step / 3.0), dt, omega, held_at_first)
        ):
            levels.append(centre + side * top)
    return levels


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open index ranges in which `mask` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _flat_by_equality(y: Array, top: float, step: float, dt: float, omega: float, held_at_first: bool) -> bool:
    runs = [
        b - a
        for a, b in _runs(y >= top - 1e-9 * abs(top))
        if not (held_at_first and a == 0) and (step == 0.0 or _cut_off(y, a, b, step))
    ]
    if step > 0.0:
        return bool(runs) and max(runs) >= EQUAL
    turn = 2.0 * math.acos(max(-1.0, 1.0 - step / top)) / (omega * dt)  # samples that a rounded sinusoid stays there
    return bool(runs) and max(runs) >= EQUAL and max(runs) > 2.0 * turn + 1.0


def _cut_off(y: Array, a: int, b: int, step: float) -> bool:
    """Whether rounded readings end at the level of y[a:b], and do not just turn round within one step.

    A smooth turn spends at most 4.9 times as long in its last step as in the one before it, whatever its frequency. In
    noise readings of both steps alternate there.
    """
    below = y > y[a] - 1.5 * step
    before = next((i for i in range(a - 1, -1, -1) if not below[i]), -1)
    after = next((i for i in range(b, y.size) if not below[i]), y.size)
    sides = [n for n, inside in ((a - 1 - before, a > 0), (after - b, b < y.size)) if inside]
    return b - a > 6 * (min(sides, default=0) + 1)


def _flat_by_spread(y: Array, top: float, noise: float, dt: float, omega: float, held_at_first: bool) -> bool:
    width = TOP * noise
    turn = 2.0 * math.acos(max(-1.0, 1.0 - width / top)) / (omega * dt)
    for a, b in _runs(y > top - width):
        inside = y[a + 2 : b - 2]
        held = held_at_first and (a == 0 or np.min(y[:a]) > top - 2.0 * width)
        if held or len(inside) < 8:
            continue
        slope = np.polyfit(np.arange(len(inside)), inside, 2)
        bow = abs(slope[0]) * (len(inside) / 2.0) ** 2
        if b - a > TURNED * turn and np.std(inside) < 1.3 * noise and bow < 1.5 * noise:
            return True
    return False


def outliers_of(times: Array, readings: Array, noise: float, omega: float, smooth: bool = False) -> list[int]:
    """Indices of single readings that leave both neighbours by ten standard deviations and more.

    The bend of the motion itself, of angular frequency up to 5 `omega` (rad/s), is allowed for. smooth : the readings
    are of displacement, which has no jumps: then coarse records are judged by the cubic through the readings around.
    """
    if len(readings) < 7:
        return []
    inner = readings[2:-2]
    around = np.stack([readings[0:-4], readings[1:-3], readings[3:-1], readings[4:]])
    departure = inner - np.median(around, axis=0)
    dt = float(np.median(np.diff(times)))
    bend = 2.0 * np.ptp(readings) * min(1.0, (5.0 * omega * dt) ** 2)
    bound = max(SPIKE * noise, bend, 1e-9 * float(np.ptp(readings)))
    spike = (np.abs(departure) > bound) & (np.abs(departure) > 3.0 * np.ptp(around[1:3], axis=0))
    return [int(i) + 2 for i in np.flatnonzero(spike | (smooth and _off_the_cubic(readings, noise)))]


def _off_the_cubic(readings: Array, noise: float) -> NDArray[np.bool_]:
    """Which of readings[2:-2] stick out of the cubic through the four around them, by far more than others do.

    A motion that is sampled coarsely bends between readings, and hardly departs from the cubic. A step departs as much
    on both sides of it, a kink less than it differs from its neighbours; a single wrong reading does neither.
    """
    off = np.zeros(readings.size)
    off[2:-2] = readings[2:-2] - (4.0 * (readings[1:-3] + readings[3:-1]) - readings[:-4] - readings[4:]) / 6.0
    size = np.abs(off)
    bound = max(SPIKE * noise, 5.0 * float(np.quantile(size[2:-2], 0.98)), 1e-9 * float(np.ptp(readings)))
    beside = np.maximum(size[1:-3], size[3:-1])
    nearest = np.minimum(np.abs(readings[2:-2] - readings[1:-3]), np.abs(readings[2:-2] - readings[3:-1]))
    return (size[2:-2] > bound) & (size[2:-2] > 1.3 * beside) & (size[2:-2] > 0.8 * nearest) & (nearest > 0.5 * bound)


def offset_of(times: Array, readings: Array, noise: float, omega: float, strongest: float | None = None) -> float:
    """Level at which the channel rests at the end of the record; 0 where the last quarter shows none.

    The last quarter, or two and a half periods (of what swings most, if that is slower than omega and the record holds
    as many), is averaged with a window that suppresses the oscillation itself. An offset shows when the mean is beyond
    a seventh of the scatter there and beyond eight standard errors. Where readings are lost for longer than a quarter
    of a period, an oscillation does not cancel, and shows no level.

    strongest : Hz, the `dominant_frequency` of the readings, where it is known
    """
    span = float(times[-1] - times[0])
    strongest = dominant_frequency(times, readings) if strongest is None else strongest
    slow = 2.5 / strongest if strongest > 2.5 / max(span, 1e-300) else 0.0
    inside = times >= times[-1] - max(0.25 * span, 5.0 * math.pi / omega, slow)
    clock, tail = times[inside], readings[inside]
    if len(tail) < 8:
        return 0.0
    steps = np.diff(clock)
    step = float(np.median(steps))
    weights = np.hanning(len(tail) + 2)[1:-1]
    if np.max(steps) > _LOST * step:
        place = (clock - clock[0] + step) / (clock[-1] - clock[0] + 2.0 * step)
        weights = (1.0 - np.cos(2.0 * math.pi * place)) * np.gradient(clock)
    mean, scatter = float(np.average(tail, weights=weights)), float(np.std(tail))
    if scatter > 5.0 * noise and np.max(steps) > max(0.5 * math.pi / omega, 3.0 * step):
        return 0.0
    large = (tail - mean)[np.abs(tail - mean) > 0.5 * scatter]
    if scatter > 5.0 * noise and np.count_nonzero(np.diff(np.sign(large))) < 3:
        return 0.0  # less than two swings: the mean of a part of one is no level of rest
    return mean if abs(mean) > max(OF_SCATTER * scatter, OF_ERROR * noise / math.sqrt(len(tail))) else 0.0


def dominant_frequency(times: Array, readings: Array) -> float:
    """Frequency of the strongest line, in Hz: peak of the windowed spectrum, refined by a parabola; 0 if none."""
    if len(times) >= 8:
        times, readings = without_long_gaps(times, readings)
    count = len(times)
    if count < 8:
        return 0.0
    even = np.linspace(times[0], times[-1], count)
    largest = max(float(np.max(np.abs(readings))), 1e-300)
    y = np.interp(even, times, readings / largest)  # readings of 1e308 have no finite sum or difference
    size = 8 * count
    window = np.hanning(count)
    # The windowed readings are without a mean: of a decay that is over soon, the level at which it rests would be left.
    power = np.abs(np.fft.rfft((y - np.average(y, weights=window)) * window, size))
    i = int(np.argmax(power[1:-1])) + 1
    a, b, c = power[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend != 0.0 else 0.0
    return float((i + shift) / (size * (even[1] - even[0])))


def without_long_gaps(times: Array, readings: Array) -> tuple[Array, Array]:
    """The longest stretch between gaps, where these make up a quarter of the record; else the whole record.

    A straight line through a long gap is no oscillation: it would be the strongest line of the spectrum.
    """
    gaps = _long_steps(times, LONG_GAP)
    if float(np.sum(times[gaps + 1] - times[gaps])) < 0.25 * float(times[-1] - times[0]):
        return times, readings
    edges = [0, *(int(i) + 1 for i in gaps), len(times)]
    first, last = max(itertools.pairwise(edges), key=lambda ends: ends[1] - ends[0])
    return (times[first:last], readings[first:last]) if last - first >= 8 else (times, readings)


def find_release(times: Array, readings: Array) -> float:
    """Instant at which a held rig begins to move, in seconds on the clock of the record.

    The first hundredth of the record (at least five readings) is taken as held: level and noise come from it. The
    motion begins with the first of three successive readings beyond six standard deviations; the instant is the
    reading before them. Where nothing is held or
    nothing moves, the start of the record is returned.

    times : (n,) s; readings : (n,), any quantity, any unit
    """
    count = max(5, len(readings) // 100)
    head = readings[:count]
    level = float(np.median(head))
    floor = max(noise_floor_of(readings, times), 1e-12 * float(np.ptp(readings)))
    if np.std(head) > 5.0 * floor:  # not held: it moves from the first reading on
        return float(times[0])
    noise = max(floor, float(np.std(head)))
    beyond = np.abs(readings - level) > 6.0 * noise
    lasting = beyond[:-2] & beyond[1:-1] & beyond[2:]
    if not lasting.any():
        return float(times[0])
    first = int(np.argmax(lasting))
    return float(times[max(first - 1, 0)])


def carried_back(times: Array, readings: Array, seen: float, quantity: str) -> float:
    """Instant of a release whose motion was first seen after the reading at `seen`, s on the clock of the record.

    At first a velocity grows in proportion to the time, a displacement as A (1 - cos(omega t)) with half the reach for
    A: a line through the velocities, or through the phases omega t of the displacements, is followed back to nothing.
    `seen` is returned where too few readings lie in the first fifth of the reach, or where they do not grow.

    times : (n,) s; readings : (n,), displacement or velocity in any unit
    """
    after = int(np.searchsorted(times, seen, side="right"))
    away = np.abs(readings - np.median(readings[:after]))
    reach = float(np.ptp(readings))
    end = after + int(np.argmax(away[after:] > 0.2 * reach))
    if after < 3 or end - after < 3:
        return seen
    grown = np.arccos(1.0 - 2.0 * away[after:end] / reach) if quantity == "displacement" else away[after:end]
    slope, rest = np.polyfit(times[after:end] - seen, grown, 1)
    if not slope > 0.0:
        return seen
    return seen + float(np.clip(-rest / slope, times[0] - seen, times[after] - seen))


def release_option(times: Array, readings: Array) -> str:
    """The `--release` of `init` that leaves the decay alone of a record that rests first: "find", or "first_peak".

    A rig that is let go or struck is near its largest excursion within half a period; a hand takes longer.

    times : (n,) s; readings : (n,), any quantity, any unit
    """
    away = np.abs(readings - np.median(readings[len(readings) // 2 :]))
    begun = find_release(times, readings)
    reached = times[(times > begun) & (away > 0.9 * np.max(away))]
    sudden = reached.size and (reached[0] - begun) * dominant_frequency(times, readings) < 0.5
    return "find" if sudden and begun > times[0] else "first_peak"


def find_first_peak(times: Array, readings: Array, omega: float | None = None) -> float:
    """Instant of the first turning point of an oscillation, in seconds on the clock of the record.

    Where a start by hand spoils the first swing, the record is used from there on. A turning point is the largest
    excursion between two crossings of the middle position, refined by a parabola through the readings within a
    fortieth of a period. Where a hand still holds the rig it stays out longer than a free swing, which has fallen to
    cos(45 deg) = 0.71 of its peak half-way to the crossing (pendulums to 0.77 from 140 deg): the next one is taken.

    times : (n,) s; readings : (n,), displacement or acceleration; omega : rad/s, from the spectrum when not given
    """
    middle = float(np.median(readings[len(readings) // 2 :]))
    y = readings - middle
    crossings = np.flatnonzero((y[:-1] < 0.0) != (y[1:] < 0.0))
    swing = 0.2 * float(np.max(np.abs(y)))
    start, peaks = 0, list[tuple[bool, int, int]]()
    for end in [*crossings.tolist(), len(y) - 1]:
        stretch = np.abs(y[start : end + 1])
        if len(stretch) > 2 and stretch.max() > swing:
            top = int(np.argmax(stretch))
            half_way = np.interp(0.5 * (times[start + top] + times[end]), times[start : end + 1], stretch)
            peaks.append((bool(half_way > _HELD * stretch[top]), len(peaks), start + top))
            if len(peaks) == 3 or not peaks[-1][0]:
                break
        start = end + 1
    peak = min(peaks)[2] if peaks else int(np.argmax(np.abs(y)))
    rate = omega / (2.0 * math.pi) if omega else dominant_frequency(times, readings)
    near = np.abs(times - times[peak]) <= max(1.0 / (40.0 * max(rate, 1e-9)), 2.0 * float(np.median(np.diff(times))))
    if near.sum() < 4 or rate <= 0.0:
        return float(times[peak])
    a, b, _ = np.polyfit(times[near] - times[peak], y[near], 2)
    vertex = -b / (2.0 * a) if a != 0.0 else 0.0
    return float(times[peak] + np.clip(vertex, *(np.array([times[near][0], times[near][-1]]) - times[peak])))
