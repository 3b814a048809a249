"""What the thesis measured on an acceleration record: highest acceleration, logarithmic decrement, damped period.

The thesis leaves the definitions open (pp. 12-18). Here, alpha being the primary's acceleration after release at t = 0:

- X1 is the largest |alpha| from `t_min` on. The supremum over t > 0 is always the value at release, which no
  accelerometer shows: the thesis's own linear peaks are those 0.4-0.8 ms later (Table 10, p. 21).
- A lobe is what lies between two changes of sign. X2 is the largest |alpha| of the next lobe of the same sign as X1's,
  so the jag that dry friction puts beside a peak, where the velocity reverses, makes no peak of its own. Nor
  does the jag that the faces' reversal of slip puts across zero: an excursion to the other side ends a lobe only if it
  lasts half as long as the time from X1 to the first change of sign and exceeds 0.2 % of X1.
- The decrement is ln(X1 / X2) (eq. 10).
- The period is the time between the crossings of zero that end the two lobes: neighbouring crossings in the same
  direction. The time from release to X2 is given beside it as `period_peaks`; in heavily damped records the two differ
  by a tenth and more.

Peaks and crossings are interpolated between samples, so that features move continuously with the record and with t_min.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_damper.errors import InputError
from bayes_damper.rig.kernels import compiled

Array = NDArray[np.float64]
SMALLEST_LOBE = 0.002
"""A lobe counts from this fraction of X1 on, ..."""
SHORTEST_LOBE = 0.5
"""... and from this fraction of the time between X1 and the first change of sign on."""


@dataclass(frozen=True)
class Features:
    """Features of n records, each (n,): rad/s^2, 1, s, s; NaN where a record has no such feature.

    `valid` marks the records that have all of them: a heavily damped one has no second peak.
    """

    max_acceleration: Array
    log_decrement: Array
    period: Array
    period_peaks: Array
    valid: NDArray[np.bool_]


def features(times: ArrayLike, alpha1: ArrayLike, t_min: ArrayLike = 0.0, release: ArrayLike = 0.0) -> Features:
    """Features of acceleration records.

    Parameters
    ----------
    times : (n_times,) s, increasing, not necessarily even; samples a hundredth of a period apart are enough.
    alpha1 : (n, n_times) or (n_times,), rad/s^2, the primary's acceleration. A record with a NaN has no features.
    t_min : scalar or (n,), s on the clock of `times`: from when on a peak counts.
    release : scalar or (n,), s: from when `period_peaks` is counted.

    Raises
    ------
    InputError
        if the shapes do not fit, times do not increase, or t_min lies outside the record.
    """
    t = np.ascontiguousarray(times, dtype=np.float64)
    records = np.atleast_2d(np.ascontiguousarray(alpha1, dtype=np.float64))
    if t.ndim != 1 or t.size < 3 or records.ndim != 2 or records.shape[1] != t.size:
        raise InputError(
            f"alpha1 has the shape {np.shape(alpha1)} and times {np.shape(times)}; "
            "give at least three times and records of shape (n, n_times)"
        )
    if not (t[1:] > t[:-1]).all():
        raise InputError("times must increase from sample to sample; sort the record and drop repeated times")
    n = len(records)
    start = np.array(np.broadcast_to(np.asarray(t_min, dtype=np.float64), (n,)))
    zero = np.array(np.broadcast_to(np.asarray(release, dtype=np.float64), (n,)))
    if not np.all((start >= t[0]) & (start < t[-1])):
        raise InputError(f"t_min must lie within the record, {t[0]:g} to {t[-1]:g} s; got {start.min():g}")
    out = np.full((4, n), np.nan)
    _scan(t, records, start, zero, SMALLEST_LOBE, SHORTEST_LOBE, out)
    return Features(out[0], out[1], out[2], out[3], np.isfinite(out).all(axis=0))


@compiled()
def _parabola(t: Array, y: Array, k: int, sign: float, best: float, period: float) -> tuple[float, float]:
    """Summit of the parabola through sample k and its neighbours: height above that sample, time from it.

    The height is at most what a sine of the record's own period can hide between two samples: this keeps the parabola
    from overshooting a kink.
    """
    if k < 1 or k + 1 >= t.size:
        return 0.0, 0.0
    h1, h2 = t[k] - t[k - 1], t[k + 1] - t[k]
    d1 = sign * (y[k] - y[k - 1]) / h1
    d2 = sign * (y[k + 1] - y[k]) / h2
    bend = (d1 - d2) / (h1 + h2)
    if not bend > 0.0:
        return 0.0, 0.0
    slope = (d1 * h2 + d2 * h1) / (h1 + h2)
    hidden = 0.5 * best * (np.pi * max(h1, h2) / period) ** 2 if np.isfinite(period) else 0.0
    return min(slope * slope / (4.0 * bend), hidden), min(max(slope / (2.0 * bend), -0.5 * h1), 0.5 * h2)


@compiled()
def _scan(
    times: Array, records: Array, t_min: Array, release: Array, smallest: float, shortest: float, out: Array
) -> None:
    n_times = times.size
    for i in range(records.shape[0]):
        y = records[i]
        first = np.searchsorted(times, t_min[i], side="right")  # the first sample after t_min
        before = y[first - 1]
        share = (t_min[i] - times[first - 1]) / (times[first] - times[first - 1])
        at_start = before + share * (y[first] - before)
        best = abs(at_start)
        sign = 1.0 if at_start > 0.0 else -1.0
        k1 = -1  # the peak lies at t_min itself
        finite = np.isfinite(at_start)
        for k in range(first, n_times):
            if not np.isfinite(y[k]):
                finite = False
            if abs(y[k]) > best:
                best, k1 = abs(y[k]), k
                sign = 1.0 if y[k] > 0.0 else -1.0
        if not finite or best == 0.0:
            continue
        # From the peak on: the ends of its lobe, of the lobe of the other sign and of the next one of the same sign.
        # Each lobe is first a candidate, and counts once it has lasted and reached far enough.
        least = smallest * best
        start = t_min[i] if k1 < 0 else times[k1]
        previous, t_previous = sign * (at_start if k1 < 0 else y[k1]), start
        phase = 0
        hold = -1.0
        crossing, highest, k_highest = 0.0, 0.0, -1
        end_first, end_second = np.nan, np.nan
        second, k2 = 0.0, -1
        for k in range(first if k1 < 0 else k1 + 1, n_times):
            now = sign * y[k]
            awaited = 1.0 if phase == 1 else -1.0  # the sign of the lobe that comes next
            if phase == 2 and now > second:
                second, k2 = now, k
            if awaited * now > 0.0:
                if awaited * previous <= 0.0:
                    crossing = t_previous + (times[k] - t_previous) * previous / (previous - now)
                    highest = 0.0
                    if hold < 0.0:
                        hold = shortest * (crossing - start)
                if awaited * now > highest:
                    highest, k_highest = awaited * now, k
                if highest > least and times[k] - crossing >= hold:
                    if phase == 0:
                        end_first = crossing
                    elif phase == 1:
                        second, k2 = highest, k_highest
                    else:
                        end_second = crossing
                        break
                    phase += 1
            previous, t_previous = now, times[k]
        period = end_second - end_first
        out[2, i] = period
        largest = best
        if k1 >= 0:
            largest += _parabola(times, y, k1, sign, best, period)[0]
        out[0, i] = largest
        # A second peak from which the record has not turned away may still be growing.
        if k2 >= 0 and (np.isfinite(end_second) or previous < 0.5 * second):
            height, offset = _parabola(times, y, k2, sign, second, period)
            out[1, i] = np.log(largest / (second + height))
            out[3, i] = times[k2] + offset - release[i]
