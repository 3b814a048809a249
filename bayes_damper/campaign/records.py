"""Records as the fits take them: from the release on, and repeats on one grid of times.

A logger may run long before the release, start its clock anywhere, lose readings, or stop repeats at different ends.
None of it is a gap between model and rig, so it is undone before a fit: by what the record itself shows, never by
what a model says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look

Array = NDArray[np.float64]

TOLERANCE = 0.02  # share of a step by which readings may lie beside a common grid
LARGEST_GRID = 3.0  # times the readings of the longest record; beyond, gaps are longer than what was read
STEPS_OF_DOUBT = 1.5  # sampling steps between nominal and real release that are left to the fit
FEW = 8  # stamps up to which a clock is taken as it is
FLICKER = 0.05  # share of a rounded channel's changes that are undone at once, beyond which its noise sets it moving
ROUNDED = 1.3  # noise of a rounded channel, over that of its rounding alone, beyond which it averages like any other
LARGE = 200_000
"""Readings of a campaign beyond which one in so many is picked, where they come faster than the motion needs."""
READINGS_PER_PERIOD = 150.0  # of the primary, that the readings of a large campaign are picked down to
READINGS_PER_SWING = 100.0  # the same of displacements and velocities of free starts, however few they are
DERIVATIVE = {"displacement": 0, "velocity": 1, "acceleration": 2}  # order in time of a quantity that is read
EARLY = 0.35  # of the release angle, or of the velocity that belongs to it: passed before a quarter of a swing is over
BEND, BENDS = 4000, 400  # readings up to a release among noise, and instants of it that are tried, at most
SEEN, SURE = 3.0, 5.0
"""Standard deviations by which noisy readings must speak against a release within `STEPS_OF_DOUBT` of the nominal one
for its range to be wider, and for the clock to be set: a campaign has a hundred trials, of which three in a thousand
are beyond 3 by chance."""
DEPARTS = (8.0, 0.05)  # noises, and of the largest reading, by which a reading has left a held rig
LONGEST_RELEASE = 1.0
"""Radians of the primary's oscillation over which a release may take place; what falls more slowly is no release."""
TINY = 1e-300  # in place of zero below a fraction's line
USUAL_LAG = {"displacement": 0.5, "velocity": 0.2, "acceleration": 0.02}
"""Radians of the oscillation after which the motion stands out from its noise."""


class Release(NamedTuple):
    """Where a record of a rig released from rest begins, and how much its clock is off.

    first : index of the first reading to keep: the last one of the held rig, or at or before the nominal release;
    shift : s to take from the clock, 0 where the release lies within one and a half steps of t = 0 or is not found;
    doubt : s by which the release may be off after that, where the clock was set, or noise or a motion that begins
    gently leaves more than those steps of doubt, else 0.
    """

    first: int = 0
    shift: float = 0.0
    doubt: float = 0.0


def departure(times: Array, readings: Array, quantity: str, theta0: float) -> tuple[Array, float]:
    """How far the first channel has left a held rig, and the bound beyond which that is noise no more.

    times : (n,) s; readings : (n,), finite; theta0 : nominal angle (rad) or displacement (m) at which the rig is held
    """
    sign = math.copysign(1.0, theta0) * (1.0 if quantity == "displacement" else -1.0)
    level = abs(theta0) if quantity == "displacement" else 0.0
    reach = float(np.max(np.abs(readings)))
    return np.abs(sign * readings - level), max(DEPARTS[0] * look.noise_floor_of(readings, times), DEPARTS[1] * reach)


def release_of(
    times: Array, readings: Array, quantity: str, theta0: float, omega: float, latest: float = 0.5
) -> Release:
    """Where a record of a rig released from rest begins, and how much its clock is off.

    Velocities and displacements that begin late by no more than a slow release takes may be either, and the clock of
    single records would be set or not as noise has it: it is left, with as much doubt.

    times : (n,) s, nominal release at 0; readings : (n,) of the primary; omega : rad/s of the primary on its spring;
    latest : of `LONGEST_RELEASE`, up to which such a record may begin late.
    """
    usable = np.isfinite(readings)
    if usable.sum() < 8 or theta0 == 0.0:
        return Release()
    t, y = times[usable], readings[usable]
    step = float(np.median(np.diff(t)))
    # A held reading before the release bounds it, wherever between two readings the clock puts 0.
    first = max(int(np.searchsorted(times, 0.01 * step, side="right")) - 1, 0) if times[-1] > 0.0 else 0
    away, bound = departure(t, y, quantity, theta0)
    moving = away > bound
    if not moving.any():
        return Release(first)
    k = int(np.argmax(moving))
    if k == 0:
        return Release()
    lag = USUAL_LAG[quantity] / omega if quantity == "acceleration" else 0.0
    if -STEPS_OF_DOUBT * step <= t[k] <= lag + STEPS_OF_DOUBT * step:
        return Release(first)
    start, low, high = (float(t[k - 1]),) * 3
    if quantity != "acceleration":
        noise = look.noise_floor_of(y, t)
        if bound > 8.0 * noise:
            start = _beginning(t[k:], away[k:], quantity, theta0, omega, step)
        else:
            start, low, high = _bend(t, y, k, theta0, DERIVATIVE[quantity], omega, noise)
    if abs(start) <= STEPS_OF_DOUBT * step:
        return Release(first, 0.0, max(-low, high, 0.0) if start == 0.0 else 0.0)
    if quantity != "acceleration" and 0.0 < start <= latest * LONGEST_RELEASE / omega:
        return Release(first, 0.0, max(start + step, high))
    keep = max(int(np.searchsorted(times, start, side="right")) - 1, 0)
    shift = float(times[keep])
    return Release(keep, shift, max(shift - low, high - shift) if low < high else STEPS_OF_DOUBT * step)


def _beginning(times: Array, away: Array, quantity: str, theta0: float, omega: float, step: float) -> float:
    """Instant at which a motion began that was first seen at times[0]: its beginning carried back to nothing."""
    top = EARLY * (abs(theta0) if quantity == "displacement" else abs(theta0) * omega)
    end = max(int(np.argmax(away > top)) if (away > top).any() else away.size, 4)
    t, a = times[:end], away[:end]
    x = np.arccos(np.clip(1.0 - a / abs(theta0), -1.0, 1.0)) if quantity == "displacement" else a
    if t.size < 2 or np.ptp(x) <= 0.0:
        return float(times[0]) - step
    slope, rest = np.polyfit(t, x, 1)
    return float(-rest / slope) if slope > 0.0 else float(times[0]) - step


def _bend(
    times: Array, readings: Array, seen: int, theta0: float, derivative: int, omega: float, noise: float
) -> tuple[float, float, float]:
    """Instant at which noisy readings begin to leave a held value, 0 unless they are `SURE` against it, and its range.

    The range is 0 to 0 where they are not `SEEN` to be against the steps of doubt about 0.

    Where the noise is large, the first reading beyond it comes long after the beginning. A parabola of a displacement,
    a line of a velocity, is fitted behind each instant that it may have begun at, and a constant before.

    times, readings : (n,); seen : index of the first reading beyond the noise; derivative : 0 for a displacement, 1 for
    a velocity; noise : sd of a reading
    """
    held = 0.0 if derivative else theta0
    away = np.abs(readings[seen:] - held)
    top = EARLY * abs(theta0) * (omega if derivative else 1.0)
    end = min(seen + max(int(np.argmax(away > top)), 4), times.size)
    begin = max(0, end - BEND)
    t, x = times[begin:end], readings[begin:end] - held
    tried = np.append(np.unique(np.linspace(0, seen - begin, BENDS).astype(int)), 0)
    instants = t[tried]
    instants[-1] = 0.0
    shape = np.maximum(t - instants[:, None], 0.0) ** (2 - derivative)
    shape /= np.maximum(np.max(shape, axis=1, keepdims=True), TINY)
    loose = (noise / (0.02 * float(away[0]))) ** 2  # the held value is known to a fiftieth of that reading's way
    # The sum of squares that a constant and the shape leave, of each instant.
    a, b, c = t.size + loose, shape.sum(axis=1), (shape**2).sum(axis=1)
    u, v = float(x.sum()), shape @ x
    left = float(x @ x) - (c * u * u - 2.0 * b * u * v + a * v * v) / np.maximum(a * c - b * b, TINY)
    best = int(np.argmin(left))
    step = float(np.median(np.diff(times)))
    nominal = np.abs(instants) <= STEPS_OF_DOUBT * step
    against = (float(np.min(left[nominal])) - float(left[best])) / noise**2
    if not against > SEEN**2:
        return 0.0, 0.0, 0.0
    likely = instants[left - left[best] <= (SEEN * noise) ** 2]
    return float(instants[best]) if against > SURE**2 else 0.0, float(likely.min()) - step, float(likely.max()) + step


def picks(sizes: Sequence[int], steps: Sequence[float], period: float, swings: bool) -> list[int]:
    """Of how many readings of each record one is picked for fits.

    Readings are picked, not averaged: an average would shrink fast swings and blur the reversals of dry friction.

    sizes : readings of each record, all channels; steps : s, its sampling step; period : s, of the fastest primary;
    swings : displacements or velocities of free starts, which hold nothing faster that a torque could have made, and
    whose errors, that of the model first, are the same over many readings
    """
    if not swings and sum(sizes) <= LARGE:
        return [1] * len(sizes)
    wanted = period / (READINGS_PER_SWING if swings else READINGS_PER_PERIOD)
    return [max(1, math.floor(wanted / step * (1.0 + 1e-9))) if step > 0.0 else 1 for step in steps]


def rounding_of(readings: Array) -> float:
    """Step of one channel whose readings err by their rounding and hardly by anything else; 0 where noise moves them to
    and fro between steps, so that they average like any other.

    readings : (n,); nan where missing
    """
    y = readings[np.isfinite(readings)]
    step = look.resolution_of(y) if y.size >= 4 else 0.0
    if step == 0.0 or look.noise_floor_of(y) > ROUNDED * step / math.sqrt(12.0):
        return 0.0
    changes = np.diff(y) != 0.0
    back = changes[:-1] & changes[1:] & (y[2:] == y[:-2])
    return 0.0 if np.count_nonzero(back) > FLICKER * np.count_nonzero(changes) else step


def crossings(times: Array, readings: Array, step: float, period: float) -> tuple[Array, Array]:
    """What the readings of a rounded channel hold: values (n,), nan where nothing, and their weights (n,).

    Equal readings share one error of rounding: all of a run show no more than that a step was passed when it began. So
    the first reading of each run is kept, at the value to be expected there: where a run lasts k readings, 1 / k of a
    step beyond the edge between the two, give or take half of that; a swing is not flattened at its ends, as it is
    where the middles of steps stand for all that is rounded to them. Of a run that lasts longer than a period one
    reading is kept for each, so that a model that still moves there is seen; together these count as one.

    times : (n,) s; readings : (n,), nan where missing; step : of the readings; period : s, of the rig's own oscillation
    """
    values, weights = np.full(readings.size, np.nan), np.zeros(readings.size)
    here = np.flatnonzero(np.isfinite(readings))
    t, y = times[here], readings[here]
    if y.size == 0:
        return values, weights
    starts = np.concatenate([[0], np.flatnonzero(np.diff(y) != 0.0) + 1])
    lengths = np.diff(np.concatenate([starts, [y.size]]))
    rise = np.sign(np.diff(y[starts]))  # into each run but the first
    passed = np.concatenate([[False], rise[1:] == rise[:-1], [False]])  # runs that lead on, neither first nor last
    for k in range(1, starts.size):
        near = [lengths[i] for i in (k - 1, k) if passed[i]] or [min(lengths[k - 1], lengths[k])]
        at = here[starts[k]]
        values[at] = y[starts[k]] - 0.5 * step * rise[k - 1] * (1.0 - 1.0 / np.mean(near))
        weights[at] = 1.0
    for first, length in zip(starts, lengths, strict=True):
        parts = int((t[first + length - 1] - t[first]) / period)
        if parts:
            middles = here[first + (length * (np.arange(parts) + 0.5) / parts).astype(np.intp)]
            values[middles], weights[middles] = y[first], 1.0 / math.sqrt(parts)
    return values, weights


def evened(clocks: Sequence[Array]) -> list[Array]:
    """The clocks (n_i,), s, of all records; the even ones whose stamps were rounded as they were before that.

    A body with velocity v moves by v dt while a stamp is wrong by dt. Where stamps allow it, records have their rate in
    common, and their instants.
    """
    coarse = {k: found[0] for k, c in enumerate(clocks) if c.size > FEW and (found := look.rounded_clock(c))}
    if not coarse:
        return list(clocks)
    places = {k: look.places_of(clocks[k]) for k in coarse}
    lines = {k: np.polyfit(places[k], clocks[k], 1) for k in coarse}
    weights = {k: len(p) * float(np.var(p)) for k, p in places.items()}
    shared = sum(w * lines[k][0] for k, w in weights.items()) / sum(weights.values())
    out, known = list(clocks), list[Array]()
    for k, unit in coarse.items():
        line = np.array([shared, float(np.mean(clocks[k] - shared * places[k]))])
        fitting = [x for x in (*known, line, lines[k]) if _off(x, places[k], clocks[k]) < look.ROUNDED_OFF * unit]
        known.append(fitting[0])
        out[k] = np.polyval(fitting[0], places[k])
    return out


def _off(line: Array, places: NDArray[np.intp], clock: Array) -> float:
    """Largest distance, s, of stamps from a line through the readings' places."""
    return float(np.max(np.abs(np.polyval(line, places) - clock)))


def common_grid(clocks: Sequence[Array]) -> tuple[Array, list[NDArray[np.intp]]] | None:
    """One even grid that holds the readings of all records, and where on it those of each record lie.

    clocks : (n_i,) s of each record. None where they are the same already, or where no even grid holds them: uneven
    times, clocks that differ by a fraction of a step, or gaps longer than what was read.
    """
    first = clocks[0]
    if all(c.size < 3 for c in clocks):
        return None
    step = float(np.median(np.concatenate([np.diff(c) for c in clocks])))
    origin = min(float(c[0]) for c in clocks)
    exact = [(c - origin) / step for c in clocks]
    places = [np.round(x).astype(np.intp) for x in exact]
    if any(np.max(np.abs(x - p)) > TOLERANCE * max(1.0, 1e-3 * x.size) for x, p in zip(exact, places, strict=True)):
        return None
    if any(np.any(np.diff(p) < 1) for p in places):
        return None
    size = 1 + max(int(p[-1]) for p in places)
    if size > LARGEST_GRID * max(c.size for c in clocks):
        return None
    if all(c.size == size and np.array_equal(c, first) for c in clocks):
        return None
    grid: Array = origin + step * np.arange(size, dtype=np.float64)
    for clock, place in zip(clocks, places, strict=True):
        grid[place] = clock  # the record's own times where there are any
    return grid, places
