"""Where the residuals of a fit exceed the noise: time, frequency, channel, case, region of phase space; local events.

All looks are taken at whitened residuals, unit variance under the noise of the sensors, also where a fit without
repeats takes the model's own error for noise. The repeats of a case share what the model lacks and not their noise, so
windows and bands are judged on their scaled mean, against what parameters can absorb. Each look gives a p-value, made
up for the number of looks of its kind (Holm); an entry is listed if it stays below `SIZE`, so a fit that lacks nothing
has any entry of a kind in at most that share of campaigns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, stdtr

from bayes_damper.calibration import Calibration
from bayes_damper.calibration.experiment import lone, repeats_by_reading
from bayes_damper.diagnosis.gap import noise_spread
from bayes_damper.diagnosis.remainder import own_frequency
from bayes_damper.diagnosis.response import Motion, in_slices, motions, project_parts, whiten
from bayes_damper.runs.contents.diagnosis import EventEntry, Place, PlaceEntry, WhereRecords

Array = NDArray[np.float64]

SIZE = 0.05
WINDOWS = (0.01, 0.03, 0.1)  # s
BANDS = (1, 5)  # widths in lines of the periodogram
CELLS = 6  # of phase space along each axis
NOISE_SPREAD = 0.01  # relative standard deviation of the noise variance, at least
MOST_ENTRIES = 12
AT_ONCE = 2_000_000  # changed readings that responses to short torques are held of at a time
EVENT_WIDTHS = (0.03, 0.09, 0.22)  # of the primary's period
WIDEST_EVENT = 0.75  # of it
EVENT = 8.0  # nats that a short torque gains at least


@dataclass(frozen=True, eq=False)
class Repeats:
    """Trials of the same case, configuration and times, whitened.

    mean (channels, n) of their residuals times the square root of their number: unit variance under noise;
    single (trials, channels, n); weight (channels, n); spread: relative standard deviation of the noise variance.
    """

    case: str
    coupled: bool
    trials: tuple[int, ...]
    numbers: tuple[int, ...]
    times: Array
    mean: Array
    single: Array
    weight: Array
    spread: float = NOISE_SPREAD


@dataclass(frozen=True)
class Entry:
    """One place where residuals exceed the noise. p_value is made up for all looks of its kind."""

    place: Place
    p_value: float

    def to_json(self) -> PlaceEntry:
        """The place and its p-value."""
        return {**self.place, "p_value": self.p_value}


@dataclass(frozen=True)
class Event:
    """A short torque at one instant, the same in all trials.

    start_s, end_s : where its pulse lies; instant_s : its middle; site: "ground1", "ground2" or "interface";
    impulse (N m s) and its sd; gain: log-likelihood over none, nats, places and widths tried paid for; share: of the
    misfit that the event alone explains: a law that is wrong everywhere also has a best instant, of a small share.
    """

    instant_s: float
    start_s: float
    end_s: float
    site: str
    impulse: float
    impulse_sd: float
    gain: float
    share: float

    @property
    def local(self) -> bool:
        """Whether the event explains most of what is wrong."""
        return self.share > 0.5

    def to_json(self) -> EventEntry:
        """Plain numbers."""
        return {
            "instant_s": self.instant_s, "start_s": self.start_s, "end_s": self.end_s, "site": self.site,
            "impulse_n_m_s": self.impulse, "impulse_sd_n_m_s": self.impulse_sd, "gain_nats": self.gain,
            "share": self.share, "local": self.local,
        }  # fmt: skip


@dataclass(frozen=True)
class Where:
    """Places where residuals exceed the noise, the most significant first, and the strongest event if there is one."""

    time: tuple[Entry, ...]
    frequency: tuple[Entry, ...]
    channel: tuple[Entry, ...]
    case: tuple[Entry, ...]
    phase_space: tuple[Entry, ...]
    event: Event | None

    def to_json(self) -> WhereRecords:
        """The `where` entry of diagnosis.json."""
        return {
            "time": [e.to_json() for e in self.time],
            "frequency": [e.to_json() for e in self.frequency],
            "channel": {str(e.place["channel"]): e.to_json() for e in self.channel},
            "case": {str(e.place["label"]): e.to_json() for e in self.case},
            "phase_space": [e.to_json() for e in self.phase_space],
            "event": None if self.event is None else self.event.to_json(),
        }


def locate(fit: Calibration, *, events: bool = True) -> Where:
    """Where a fit's residuals exceed the noise; about 1 s a campaign, most of it for events."""
    fit = in_slices(fit)
    sets = repeats_of(fit)
    moved = motions(fit)
    event = find_event(fit, moved) if events else None
    return Where(
        tuple(_kept(list(_in_time(sets)))),
        tuple(_kept(list(_in_frequency(sets)))),
        tuple(_adjusted(list(_in_channels(sets)))),
        tuple(_adjusted(list(_in_cases(sets)))),
        tuple(_kept(list(_in_phase_space(sets, moved)))),
        event,
    )


def over_noise(fit: Calibration) -> dict[int, tuple[Array, Array]]:
    """Residuals (reading minus model) of each fitted trial over the noise of the sensors, and their weights.

    (channels, n) each, whitened.
    """
    scale = fit.problem.noise.over_sensors[:, None]
    rows = ((i, b, k) for b in fit.linear.blocks for k, i in enumerate(b.group.trials))
    return {i: (-scale[: (c := b.group.y.shape[1])] * b.r[k].reshape(c, -1), b.group.trust[k]) for i, b, k in rows}


def repeats_of(fit: Calibration) -> list[Repeats]:
    """Residuals of the fitted trials (`over_noise`) in sets of repeats."""
    experiment, spread, found = fit.problem.experiment, _spread(fit), over_noise(fit)
    residuals, weights = ({i: row[part] for i, row in found.items()} for part in (0, 1))
    out = []
    for members in repeats_by_reading(experiment, list(residuals)):
        single = np.array([residuals[i] for i in members])
        t = experiment.trials[members[0]]
        numbers = tuple(experiment.trials[i].number for i in members)
        mean = single.sum(axis=0) / math.sqrt(len(members))
        weight = np.min([weights[i] for i in members], axis=0)
        out.append(Repeats(t.case, t.coupled, tuple(members), numbers, t.times, mean, single, weight, spread))
    return out


def _spread(fit: Calibration) -> float:
    """Relative standard deviation of the noise variance, as `learn_noise` finds it.

    From a median of differences of n readings where there are no repeats and the model leaves an error: sqrt(8 / n);
    from the mean power of the upper two thirds of the spectrum where it leaves none: sqrt(3 / n).
    """
    problem = fit.problem
    if not lone(problem.experiment, problem.trials):
        return max(NOISE_SPREAD, noise_spread(problem))
    readings = sum(problem.experiment.trials[i].times.size for i in problem.trials)
    return max(NOISE_SPREAD, math.sqrt((8.0 if problem.noise.sensor else 3.0) / max(readings, 1)))


# Multiplicity ---------------------------------------------------------------------------------------------------------


def holm(p_values: Sequence[float]) -> Array:
    """p-values made up for their number by Holm's step-down rule; the same order."""
    p = np.asarray(p_values, float)
    order = np.argsort(p)
    scaled = p[order] * (p.size - np.arange(p.size))
    out = np.empty(p.size)
    out[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return out


def _adjusted(entries: Sequence[Entry]) -> list[Entry]:
    adjusted = holm([e.p_value for e in entries]) if entries else np.zeros(0)
    return [Entry(e.place, float(p)) for e, p in zip(entries, adjusted, strict=True)]


def _kept(entries: Sequence[Entry]) -> list[Entry]:
    """Entries below `SIZE` after Holm, the strongest first, none that overlaps a stronger one of the same record."""
    pairs = sorted(zip(_adjusted(entries), entries, strict=True), key=lambda pair: (pair[0].p_value, pair[1].p_value))
    out: list[Entry] = []
    for entry, _ in pairs:
        if entry.p_value >= SIZE or len(out) >= MOST_ENTRIES:
            break
        if not any(_overlap(entry.place, other.place) for other in out):
            out.append(entry)
    return out


def _overlap(a: Place, b: Place) -> bool:
    if any(a.get(k) != b.get(k) for k in ("case", "configuration", "channel")):
        return False
    if "start_s" in a:
        return a["start_s"] < b["end_s"] and b["start_s"] < a["end_s"]
    return "low_hz" in a and a["low_hz"] < b["high_hz"] and b["low_hz"] < a["high_hz"]


def _exceeds(sum_of_squares: Array, count: Array, spread: float = NOISE_SPREAD) -> Array:
    """p-value of a sum of squares of `count` standard normals, their variance known to `spread`: Fisher's F."""
    count = np.maximum(np.asarray(count, float), 1e-9)
    return np.asarray(fdtrc(count, 2.0 / spread**2, np.asarray(sum_of_squares) / count))


def _strays(sums: Array, count: Array, spread: float) -> Array:
    """p-value of the sum of `count` standard normals, their variance known to `spread`: Student's t."""
    return np.asarray(2.0 * stdtr(2.0 / spread**2, -np.abs(sums) / np.sqrt(np.maximum(count, 1e-9))))


# Looks ----------------------------------------------------------------------------------------------------------------


def _words(coupled: bool) -> str:
    return "coupled" if coupled else "uncoupled"


def _in_time(sets: Sequence[Repeats]) -> Iterator[Entry]:
    """Windows of several lengths, by their energy and by their mean (both looks are counted)."""
    for s in sets:
        dt = float(np.median(np.diff(s.times))) if s.times.size > 1 else 1.0
        for channel in range(s.mean.shape[0]):
            r = s.mean[channel]
            w2 = s.weight[channel] ** 2
            for length in WINDOWS:
                width = max(2, round(length / dt))
                starts = np.arange(0, r.size - width + 1, max(1, width // 2))
                sums = np.concatenate([[0.0], np.cumsum(r)])
                squares = np.concatenate([[0.0], np.cumsum(r**2)])
                counts = np.concatenate([[0.0], np.cumsum(w2)])
                count = counts[starts + width] - counts[starts]
                energy = _exceeds(squares[starts + width] - squares[starts], count, s.spread)
                mean = _strays(sums[starts + width] - sums[starts], count, s.spread)
                for first, p, c in zip(starts, np.minimum(1.0, 2.0 * np.minimum(energy, mean)), count, strict=True):
                    if c < 0.5 * width:
                        continue
                    single = np.sum(s.single[:, channel, first : first + width] ** 2, axis=1)
                    place: Place = {
                        "start_s": float(s.times[first]), "end_s": float(s.times[first + width - 1] + dt),
                        "case": s.case, "configuration": _words(s.coupled), "trial": s.numbers[int(np.argmax(single))],
                        "trials": list(s.numbers), "channel": channel + 1,
                    }  # fmt: skip
                    yield Entry(place, float(p))


def _in_frequency(sets: Sequence[Repeats]) -> Iterator[Entry]:
    """Lines and bands of the periodogram, of each set of repeats and of all that share their times."""
    together: dict[tuple[bytes, int], list[Array]] = {}
    for s in sets:
        n = s.times.size
        if n < 16:
            continue
        f = np.asarray(np.fft.rfftfreq(n, float(np.median(np.diff(s.times)))), np.float64)[1:-1]
        for channel in range(s.mean.shape[0]):
            scale = 1.0 / max(float(np.sum(s.weight[channel] ** 2)), 1e-9)
            power = np.abs(np.fft.rfft(s.mean[channel])[1:-1]) ** 2 * scale
            together.setdefault((f.tobytes(), channel), []).append(power)
            for low, high, p in _bands(f, power, 1, s.spread):
                place: Place = {
                    "low_hz": low, "high_hz": high, "case": s.case, "configuration": _words(s.coupled),
                    "channel": channel + 1,
                }  # fmt: skip
                yield Entry(place, p)
    for (grid, channel), powers in together.items():
        if len(powers) > 1:
            spread = max(s.spread for s in sets)
            for low, high, p in _bands(np.frombuffer(grid), np.sum(powers, axis=0), len(powers), spread):
                place = {"low_hz": low, "high_hz": high, "case": None, "configuration": None, "channel": channel + 1}
                yield Entry(place, p)


def _bands(f: Array, power: Array, records: int, spread: float) -> Iterator[tuple[float, float, float]]:
    spacing = float(f[1] - f[0])
    for width in BANDS:
        m = f.size // width
        total = power[: m * width].reshape(m, width).sum(axis=1)
        p = _exceeds(2.0 * total, np.full(m, 2.0 * width * records), spread)
        for k in range(m):
            yield float(f[k * width] - 0.5 * spacing), float(f[k * width + width - 1] + 0.5 * spacing), float(p[k])


def _low_energy(s: Repeats, channel: int) -> tuple[float, float]:
    """Energy of the mean residual below 100 Hz, where missing torques show, and its number of degrees of freedom."""
    r = s.mean[channel]
    n = r.size
    f = np.fft.rfftfreq(n, float(np.median(np.diff(s.times))) if n > 1 else 1.0)
    keep = (f > 0.0) & (f < 100.0)
    scale = 1.0 / max(float(np.sum(s.weight[channel] ** 2)), 1e-9)
    return float(2.0 * np.sum(np.abs(np.fft.rfft(r)[keep]) ** 2) * scale), float(2.0 * np.sum(keep))


def _low_excess(places: Iterable[tuple[Repeats, int]]) -> tuple[float, float]:
    """Energy below 100 Hz in channels of some repeats, over that of noise less 1, and its p-value under noise."""
    places = list(places)
    pairs = [_low_energy(s, channel) for s, channel in places]
    energy, count = sum(p[0] for p in pairs), sum(p[1] for p in pairs)
    spread = max(s.spread for s, _ in places)
    return energy / max(count, 1.0) - 1.0, float(_exceeds(np.array(energy), np.array(count), spread))


def _in_channels(sets: Sequence[Repeats]) -> Iterator[Entry]:
    for channel in range(max(s.mean.shape[0] for s in sets)):
        excess, p = _low_excess((s, channel) for s in sets if s.mean.shape[0] > channel)
        yield Entry({"channel": channel + 1, "excess_over_noise": excess}, p)


def _in_cases(sets: Sequence[Repeats]) -> Iterator[Entry]:
    for s in sets:
        excess, p = _low_excess((s, channel) for channel in range(s.mean.shape[0]))
        place: Place = {
            "label": f"{s.case} {_words(s.coupled)}", "case": s.case, "configuration": _words(s.coupled),
            "excess_over_noise": excess,
        }  # fmt: skip
        yield Entry(place, p)


def _in_phase_space(sets: Sequence[Repeats], moved: Sequence[Motion]) -> Iterator[Entry]:
    """Cells of (th1, w1), (th2, w2) and (phi, slip), each coordinate over its largest value."""
    where = {i: (m, k) for m in moved for k, i in enumerate(m.group.trials)}
    planes = (("th1", "w1"), ("th2", "w2"), ("phi", "slip"))
    for names in planes:
        largest = [max(float(np.max(np.abs(getattr(m, name)))) for m in moved) for name in names]
        if min(largest) <= 0.0:
            continue
        for channel in range(max(s.mean.shape[0] for s in sets)):
            energy, sums, count = np.zeros((3, CELLS * CELLS))
            for s in sets:
                if s.mean.shape[0] <= channel or (names[0] != "th1" and not s.coupled):
                    continue
                m, k = where[s.trials[0]]
                cells = np.zeros(s.times.size, int)
                for name, reach in zip(names, largest, strict=True):
                    x = getattr(m, name)[k, m.at] / reach
                    cells = cells * CELLS + np.clip(((x + 1.0) * 0.5 * CELLS).astype(int), 0, CELLS - 1)
                energy += np.bincount(cells, s.mean[channel] ** 2, CELLS * CELLS)
                sums += np.bincount(cells, s.mean[channel], CELLS * CELLS)
                count += np.bincount(cells, s.weight[channel] ** 2, CELLS * CELLS)
            used = count > 5.0
            spread = max(s.spread for s in sets)
            p = np.minimum(1.0, 2.0 * np.minimum(_exceeds(energy, count, spread), _strays(sums, count, spread)))
            for cell in np.flatnonzero(used):
                row, column = divmod(int(cell), CELLS)
                ranges = [
                    [(-1.0 + 2.0 * place / CELLS) * reach, (-1.0 + 2.0 * (place + 1) / CELLS) * reach]
                    for place, reach in zip((row, column), largest, strict=True)
                ]
                cell_place: Place = {
                    "coordinates": list(names), "range": ranges, "channel": channel + 1,
                    "excess_over_noise": float(energy[cell] / count[cell] - 1.0),
                }  # fmt: skip
                yield Entry(cell_place, float(p[cell]))


# Events ---------------------------------------------------------------------------------------------------------------


def find_event(fit: Calibration, moved: Sequence[Motion] | None = None) -> Event | None:
    """The strongest short torque at one instant of all trials, None if its gain stays below `EVENT` nats.

    Half-sines of several widths are tried on the primary, the secondary and between the bodies, first on a coarse
    raster of instants, then ever closer; the number of places tried is paid for.
    """
    moved = motions(fit) if moved is None else moved
    end = max(float(m.grid[-1]) for m in moved)
    coupled = any(m.group.coupled for m in moved)
    sites = ("ground1", "interface", "ground2") if coupled else ("ground1",)
    period = 1.0 / own_frequency(fit.problem.experiment)
    looks = len(sites) * len(EVENT_WIDTHS) * end / (EVENT_WIDTHS[0] * period)
    best: tuple[float, float, float, str, float, float] | None = None
    step = max(float(np.median(np.diff(m.grid))) for m in moved)
    width = max(EVENT_WIDTHS[1] * period, 2.0 * step)  # a narrower one falls between the readings
    coarse = np.arange(0.5 * width, end, 0.5 * width)
    for site in sites:
        gain, size, sd = _pulses(fit, moved, site, coarse, np.full(coarse.size, width))
        k = int(np.argmax(gain))
        if best is None or gain[k] > best[0]:
            best = (float(gain[k]), float(coarse[k]), width, site, float(size[k]), float(sd[k]))
    assert best is not None
    if best[0] < 0.3 * EVENT:
        return None
    reach, ends = 0.5 * width, (0.5 * EVENT_WIDTHS[0] * period, WIDEST_EVENT * period)
    for _ in range(4):
        instants = best[1] + reach * np.linspace(-1.0, 1.0, 7)
        widths = np.unique(np.clip(best[2] * np.array([0.4, 0.7, 1.0, 1.4, 2.2]), *ends))
        t, w = (x.ravel() for x in np.meshgrid(instants, widths))
        for site in sites:
            gain, size, sd = _pulses(fit, moved, site, t, w)
            k = int(np.argmax(gain))
            if gain[k] > best[0]:
                best = (float(gain[k]), float(t[k]), float(w[k]), site, float(size[k]), float(sd[k]))
        reach *= 0.4
    gain_found, instant, width, site, impulse, impulse_sd = best
    paid = gain_found - math.log(max(looks, 1.0))
    if paid < EVENT:
        return None
    share = min(1.0, paid / max(0.5 * fit.excess, paid, 1.0))
    return Event(instant, instant - 0.5 * width, instant + 0.5 * width, site, impulse, impulse_sd, paid, share)


def _pulses(
    fit: Calibration, moved: Sequence[Motion], site: str, instants: Array, widths: Array
) -> tuple[Array, Array, Array]:
    """Gain (nats), impulse and its sd (N m s) of half-sine torques at the instants; (k,) each."""
    most = max(AT_ONCE // max(m.y.size for m in moved), 1)
    parts = [
        _pulses_at_once(fit, moved, site, instants[k : k + most], widths[k : k + most])
        for k in range(0, instants.size, most)
    ]
    gain, size, sd = (np.concatenate(x) for x in zip(*parts, strict=True))
    return gain, size, sd


def _pulses_at_once(
    fit: Calibration, moved: Sequence[Motion], site: str, instants: Array, widths: Array
) -> tuple[Array, Array, Array]:
    """`_pulses` for so few instants that all responses of a block of trials are held together."""

    def responses(m: Motion) -> Array:
        h = np.gradient(m.grid)
        x = (m.grid[None] - instants[:, None]) / widths[:, None]
        pulse = np.cos(np.pi * x, where=np.abs(x) < 0.5, out=np.zeros_like(x))
        area = np.sum(pulse * h, axis=1, keepdims=True)
        pulse = np.where(area > 0.0, pulse / np.maximum(area, 1e-300), 0.0)
        q = np.broadcast_to(pulse, (m.th1.shape[0], *pulse.shape))
        q1 = None if site == "ground2" else (-q if site == "interface" else q)
        q2 = None if site == "ground1" else q
        if not m.group.coupled and site != "ground1":
            q1, q2 = np.zeros_like(q), None
        return whiten(fit, m.group, m.respond(q1, q2))

    # Each pulse is judged by itself.
    judged = project_parts(fit, (responses(m) for m in moved), lambda _: None, lambda: range(instants.size)).on()
    length = np.diag(judged.gram)
    usable = length > 1e-6 * np.maximum(judged.raw, 1e-300)
    safe = np.where(usable & (length > 0.0), length, 1.0)
    gain = np.where(usable, 0.5 * judged.product**2 / safe, 0.0)
    return gain, judged.product / safe, 1.0 / np.sqrt(safe)
