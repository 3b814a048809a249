"""Whether a channel picks up the mains: a line at their frequency in its spectrum, with any phase at a release."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

Array = NDArray[np.float64]
MAINS, BY_CHANCE = (50, 60), 1e-6  # Hz; probability below which a line is no chance
ABOVE, BESIDE = 1.3, 10  # times the rig's frequency above which it is looked for; lines to each side, less the nearest
LASTS = 0.5  # of its power in the first half of a record that a line has in the second: what the rig does dies away
OFF = np.arange(-20, 21) / 100.0  # Hz by which a grid may run fast or slow
NEAREST = 3  # lines to each side that the window's own width fills


def mains_in(records: Iterable[tuple[Array, Array]], quickest: float) -> float | None:
    """Frequency of the mains, Hz, whose line stands out of the spectra of a channel by more than chance; else None.

    records : times (n,), s, and readings (n,) of each trial; quickest : frequency of the primary, Hz. Each record's
    power at a frequency, under Hann's window, over the mean of that beside it is nearly Exp(1) where there is no line
    (Bartlett, 1955, An Introduction to Stochastic Processes, sec. 9.2), and their sum follows a gamma law. The mains do
    not die away as a second mode of the rig does.
    """
    known = [(t[np.isfinite(y)], y[np.isfinite(y)]) for t, y in records]
    chances = {f: _chance(known, f) for f in MAINS if f > ABOVE * quickest}
    found = min(chances, key=chances.__getitem__, default=None)
    if found is None or chances[found] >= BY_CHANCE or not _lasts(known, found):
        return None
    return float(found + OFF[np.sum([_power(t, y, found + OFF) for t, y in known if t.size > 1], axis=0).argmax()])


def _lasts(records: Iterable[tuple[Array, Array]], hertz: int) -> bool:
    """Whether a line has as much power late in the records as early, in all of them together."""
    early = late = 0.0
    for times, y in records:
        if (half := times.size // 2) > 2 * BESIDE:
            early += float(_power(times[:half], y[:half], hertz + OFF).max())
            late += float(_power(times[half:], y[half:], hertz + OFF).max())
    return late > LASTS * early


def _power(times: Array, y: Array, hertz: Array) -> Array:
    """Power of a record (n,) at frequencies in Hz, (k,), under Hann's window."""
    window = np.sin(math.pi * (times - times[0]) / (times[-1] - times[0])) ** 2
    return np.asarray(np.abs(np.exp(-2j * math.pi * hertz[:, None] * times) @ (window * (y - y.mean()))) ** 2)


def _chance(records: Iterable[tuple[Array, Array]], hertz: int) -> float:
    """Probability of as strong a line by chance; 1 where no record is long and quick enough to show one."""
    ratios = []
    for times, y in records:
        span = float(times[-1] - times[0]) if times.size > 2 * BESIDE else 0.0
        if span * hertz < 2 * BESIDE or hertz + BESIDE / span > 0.5 / float(np.median(np.diff(times))):
            continue
        beside = np.arange(NEAREST, BESIDE)
        power = _power(times, y, hertz + np.array([0.0, *beside, *-beside]) / span)
        ratios.append(float(power[0] / max(float(np.mean(power[1:])), 1e-300)))
    return float(gammaincc(len(ratios), sum(ratios))) if ratios else 1.0
