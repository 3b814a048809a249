"""Whether the second channel and the declared inertias can belong together: the torques on both bodies add up to zero.

What the bodies do to each other drops out of the sum of their equations, whatever the law of the coupling is:

    (J1 + J12) a1 + c1 w1 + k1 th1 + (J2 + J12) a2 + c3 w2 + k3 th2 = 0

with the dry friction of the bearings beside, but for other small things. Held against a bump g of one natural period
that is moved along the record (Shinbrot's modulating functions, NACA TN 3288, 1954), the derivatives go over to the
bump: with accelerations, velocities or displacements alike th, w and a become the readings filtered by g, -g' and g''.
Nothing is integrated, so nothing drifts, but the way that a body moves, where accelerations are read. A least-squares
fit of J2, of the dampings and of the frictions is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.campaign import readings as look
from bayes_damper.campaign.declarations import wiring_of
from bayes_damper.campaign.head import Head
from bayes_damper.campaign.structure import Trial, channel_columns, natural_period

Array = NDArray[np.float64]
_SHOWN = 0.95  # share of the primary's torques that the second body must explain, for its inertia to be believed
_OFF = (0.6, 1.4)  # times J2, beyond which it is an error: effects and noise that rigs have change it by less
_FAR = 30.0  # times J2 or a part of it, beyond which no fit can follow: the two bodies' numbers are in other units
_TAKES = 4.0  # times what primary and springs can give, from which the secondary takes more than any drag accounts for
_UNIT = 300.0  # times J2, which no other law of spring or friction looks like
_FAINT = 0.2  # share explained that still gives an inertia to within its unit
_FEWEST = 20.0  # readings in a natural period
_ALIKE = 1.5  # times what the best lag, or inertia, leaves, up to which another one does as well
_DERIVED = {"displacement": 0, "velocity": 1, "acceleration": 2}  # how often the readings are angles derived
_NEAR = np.linspace(-1.2, 1.2, 25)  # rad of the rig's oscillation by which channels are moved first
_BEYOND = np.arange(1.3, 6.65, 0.1)  # and then, where that balances nothing
_TRIED = 8  # trials of a case that are moved so far
_NARROW = 0.5  # rad of it, to which lags that do as well as the best one are not listed
_LATE = 0.3  # rad of the rig's oscillation by which channels may be apart
_LEAST = 5.0  # natural periods of a record that are looked at, where the motion dies out sooner
_HOLDS = 0.1  # of the secondary's own torque: what sums leave for which the channels need no other clock
_SWINGS = 1.5  # natural periods that both bodies move, below which a lag and friction that stops them look alike
_OFF_BY = 3.0  # standard deviations by which springs may be off
_SLOW = 0.02  # of the largest velocity, over which dry friction turns round
_ALONE = 1.3  # readings over their own noise, up to which a channel shows nothing else


@dataclass(frozen=True)
class _Sum:
    """Inertia of the second body that balances the primary, its standard error, and the share that it explains.

    left : what it leaves, over the angular acceleration of the second body
    """

    inertia: float
    error: float
    explained: float
    left: float


def look_at_balance(
    head: Head, trials: Sequence[Trial], off: Mapping[str, float], faults: list[str], warnings: list[str]
) -> None:
    """Adds what the coupled trials say of the second channel: a copy, noise alone, another scale, another clock.

    off : `frequency_ratios` of the cases
    """
    cases: dict[str, list[Trial]] = {}
    for trial in trials:
        named = len(trial.channels) == 2 and (_is_copy(trial, head, faults) or _is_noise(trial, head, warnings))
        if len(trial.channels) == 2 and not named and not _is_clipped(head, trial):
            cases.setdefault(trial.case, []).append(trial)
    rig = head.rig
    if rig.restoring != "linear" or rig.inertial_coupling_law != "constant" or rig.secondary_inertia is None:
        return
    declared = rig.secondary_inertia
    wrong: dict[str, float] = {}
    sure = False
    unseen: set[str] = set()  # cases whose spring no uncoupled trial shows
    for case, own in cases.items():
        still = [t for t in own if not t.driven]
        if not still or natural_period(rig, still[0]) < _FEWEST * float(np.median(np.diff(still[0].times))):
            continue
        filtered = _filtered(head, still)
        # What uncoupled trials show of k1t/J1 is no fault of the second body: k1t is off by its square, or J1 is.
        own_swing = off.get(case, 1.0) ** 2
        unseen.update({case} - off.keys())
        found = _balance(head, filtered, 0.0, own_swing)
        if found is None:
            continue
        otherwise = _or_the_spring(head, case in unseen)
        if found.explained > _SHOWN:
            known = 5.0 * math.hypot(found.error / max(found.inertia, 1e-300), declared.std / declared.value)
            ratios = [found.inertia / declared.value, found.inertia / (own_swing * declared.value)]
            off_by_more = all(not _OFF[0] < r < _OFF[1] and abs(math.log(max(r, 1e-9))) > known for r in ratios)
            if off_by_more and not _look_at_clock(
                head, case, filtered, found, own_swing, otherwise, warnings, as_declared=True
            ):
                wrong[case], sure = found.inertia, True
            continue
        if _is_reversed(head, filtered, own_swing):
            wirings = [wiring_of(head, trial) for trial in still]
            if not {"reversed", "mirrored"} & set(wirings):  # else each of them is named
                first = 2 * wirings.count("first reversed") > len(wirings)
                channel, signs = ("first", "-1 1") if first else ("second", "1 -1")
                warnings.append(
                    f"case {case}: the torques on both bodies add up to zero only if the sign of the {channel} channel "
                    f"is reversed; where `init` made the campaign, run it again with --sign {signs}{otherwise}"
                )
            continue
        other_unit = found.inertia > _UNIT * declared.value or _taken(head, filtered, own_swing) > _TAKES
        if found.explained > _FAINT and other_unit:
            wrong[case] = found.inertia
            continue
        _look_at_clock(head, case, filtered, found, own_swing, otherwise, warnings)
    if wrong:
        middle = float(np.median(list(wrong.values())))
        unit = "kg m^2" if rig.kind == "torsional" else "kg"
        balancing = ", ".join(f"{value:.3g} {unit} in case {case}" for case, value in wrong.items())
        far = max(middle / declared.value, declared.value / middle) > _FAR
        (faults if far and sure else warnings).append(
            f"the torques on both bodies add up to zero only with a secondary_inertia of about {balancing}, "
            f"not with the declared {declared.value:.3g}: correct it{f' (is it in {unit}?)' if far else ''}, or "
            + _cause(head, middle / declared.value, 1.3 if sure else 2.0)
            + _or_the_spring(head, not unseen.isdisjoint(wrong))
        )


def _taken(head: Head, trials: Sequence[_Filtered], own_swing: float) -> float:
    """What torque the secondary takes if J2 and its readings are right, over the most that primary and springs give.

    Whatever couples the bodies, their inertias and springs balance but for drags: no law of it makes this large.
    """
    rig, ratios = head.rig, []
    declared = rig.secondary_inertia
    assert declared is not None
    beside = rig.inertial_coupling.value
    for filtered in trials:
        th1, a1, th2, a2 = (
            float(np.sqrt(np.mean(x**2))) for x in (filtered.first[0], filtered.first[2], *filtered.second(0.0)[::2])
        )
        given = (rig.primary_inertia.value + abs(beside)) * a1 + rig.ground2_stiffness.value * th2
        given += max(own_swing, 1.0) * filtered.trial.k1t.value * th1
        noise = look.noise_floor_of(filtered.trial.channels[1]) * float(np.linalg.norm(filtered.bumps[2]))
        least = max(declared.value + min(beside, 0.0) - 3.0 * declared.std, 0.0)
        ratios.append(least * max(a2 - 3.0 * noise, 0.0) / max(given, 1e-300))
    return float(np.median(ratios)) if ratios else 0.0


def _or_the_spring(head: Head, unseen: bool) -> str:
    """That the spring may be wrong instead, where no uncoupled trial shows it."""
    spring = "k1t" if head.rig.kind == "torsional" else "k1"
    return f"; or {spring} or primary_inertia is not as declared, which an uncoupled trial would show" * unseen


def _cause(head: Head, ratio: float, within: float) -> str:
    """What may be wrong with a second channel that has to be multiplied by `ratio`, known to a factor of `within`."""
    torsional = head.rig.kind == "torsional"
    radius = head.rig.bar_radius.value if head.rig.bar_radius is not None else 0.1
    guesses = {
        "is in thousandths of the declared unit": 1e-3,
        "is a thousand times too small in the declared unit": 1e3,
    }
    if torsional:
        guesses["is in degrees, not in radians"] = math.pi / 180.0
        if head.measurement.quantity == "acceleration":
            guesses["is in m/s^2 at the bar's end, not in rad/s^2"] = 1.0 / radius
            guesses["is in g at the bar's end, not in rad/s^2"] = 9.81 / radius
    elif head.measurement.quantity == "acceleration":
        guesses["is in g, not in m/s^2"] = 9.81
    best = min(guesses, key=lambda text: abs(math.log(guesses[text] / ratio)))
    likely = f"; it may be that it {best}" if abs(math.log(guesses[best] / ratio)) < math.log(within) else ""
    return f"the second channel reads {1.0 / ratio:.3g} times what it should{likely}"


def _look_at_clock(
    head: Head, case: str, trials: Sequence[_Filtered], found: _Sum, own_swing: float, otherwise: str,
    warnings: list[str], as_declared: bool = False,
) -> bool:  # fmt: skip
    """Whether a second channel balances the first only if it is moved in time, which is named.

    as_declared : with an inertia near the declared one, while another one balances the channels without a lag.
    """
    period = natural_period(head.rig, trials[0].trial)
    swings = [min(float(np.ptp(_stretch(f.trial, c))) for c in (0, 1)) / period for f in trials]
    declared = head.rig.secondary_inertia
    assert declared is not None
    as_it_is = _balance(head, trials, 0.0, own_swing, within=_about_declared(head))
    holds = as_it_is is not None and as_it_is.left < _HOLDS * declared.value
    if holds or np.median(swings) < _SWINGS:
        return False
    omega = 2.0 * math.pi / period
    near = _moved(head, trials, _NEAR / omega, own_swing)
    best = _best(near)
    if not _is_lag(best[1], found):
        # Farther away a body that swings at one frequency can be balanced by many lags, if its inertia is as well.
        if as_declared or (far := _far_lag(head, trials[:_TRIED], own_swing, near)) is None:
            return False
        near, best = far
    elif as_declared and not _is_as_declared(head, best[1]):
        return False
    late = abs(best[0]) * omega > _LATE
    if late:
        bound = _ALIKE * (1.0 - best[1].explained)
        alike = [1e3 * abs(lag) for lag, m in near if 1.0 - m.explained < bound]
        least, most = min(alike), max(alike)
        narrow = most < 1.5 * least and 1e-3 * (most - least) * omega < _NARROW
        about = f"about {_of_two(1e3 * abs(best[0]))}" if narrow else f"{_of_two(least)} to {_of_two(most)}"
        warnings.append(
            f"case {case}: the torques on both bodies add up to zero only if the second channel is {about} ms "
            f"{'late' if best[0] > 0.0 else 'early'}: see how the two channels are sampled, and move its readings "
            f"in time{otherwise}"
        )
    return late


def _of_two(value: float) -> str:
    """A number of two digits, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def _far_lag(
    head: Head, trials: Sequence[_Filtered], own_swing: float, near: Sequence[tuple[float, _Sum]]
) -> tuple[list[tuple[float, _Sum]], tuple[float, _Sum]] | None:
    """Lags of more than `_NEAR` that balance the channels with about the declared inertia, and the best of them.

    None where there are none, or a smaller lag does nearly as well with any inertia, whichever sign the second channel
    has: a lag of half a period and a reversed sign look alike.
    """
    omega = 2.0 * math.pi / natural_period(head.rig, trials[0].trial)
    moved = _moved(head, trials, np.concatenate([-_BEYOND[::-1], _BEYOND]) / omega, own_swing)
    far = [(lag, m) for lag, m in moved if _is_as_declared(head, m)]
    if not far:
        return None
    best = _best(far)
    turned = _moved(head, trials, _NEAR / omega, own_swing, sign=-1.0)
    sure = all(_is_lag(best[1], m) for _, m in (*near, *turned))
    return (far, best) if sure else None


def _moved(
    head: Head, trials: Sequence[_Filtered], lags: Array, own_swing: float, sign: float = 1.0
) -> list[tuple[float, _Sum]]:
    """The sum of torques for each lag (s) of the second channel that leaves readings enough."""
    sums = ((float(lag), _balance(head, trials, float(lag), own_swing, sign)) for lag in lags)
    return [(lag, m) for lag, m in sums if m is not None]


def _best(moved: Sequence[tuple[float, _Sum]]) -> tuple[float, _Sum]:
    """The lag that explains most."""
    return max(moved, key=lambda m: m[1].explained, default=(0.0, _Sum(0.0, math.inf, 0.0, math.inf)))


def _is_lag(there: _Sum, here: _Sum) -> bool:
    """Whether a sum that a lag gives is that of the torques, and leaves at most half of what another one does."""
    return there.explained >= _SHOWN and 1.0 - there.explained <= 0.5 * (1.0 - here.explained)


def _about_declared(head: Head) -> tuple[float, float]:
    """Bounds of inertias that are about the declared one."""
    declared = head.rig.secondary_inertia
    assert declared is not None  # asked by look_at_balance
    return _OFF[0] * declared.value, _OFF[1] * declared.value


def _is_as_declared(head: Head, found: _Sum) -> bool:
    """Whether the inertia that balances is about the declared one."""
    low, high = _about_declared(head)
    return low < found.inertia < high


def _is_copy(trial: Trial, head: Head, faults: list[str]) -> bool:
    """Names a second channel that is the first one times a number, noise and all."""
    a, b = trial.channels - trial.channels.mean(axis=1, keepdims=True)
    scale = float(a @ b) / max(float(a @ a), 1e-300)
    copied = scale != 0.0 and float(np.max(np.abs(b - scale * a))) < 1e-6 * float(np.max(np.abs(b)))
    if copied and look.noise_floor_of(trial.channels[0]) > 1e-5 * float(
        np.max(np.abs(a))
    ):  # noise never repeats itself
        names = channel_columns(trial, head.rig.kind, head.measurement.quantity)
        times = "" if abs(scale - 1.0) < 1e-6 else f"{scale:.4g} times "
        faults.append(
            f"{trial.file}: column '{names[1]}' is {times}column '{names[0]}', noise and all: give the readings of "
            "the second sensor"
        )
    return copied


def _is_noise(trial: Trial, head: Head, warnings: list[str]) -> bool:
    """Names a second channel in which nothing but noise is seen while the first one moves."""
    first, second = (float(np.std(c)) / max(look.noise_floor_of(c), 1e-300) for c in trial.channels)
    silent = second < _ALONE and first > 10.0
    if silent and np.ptp(trial.channels[1]) > 0.0:
        name = channel_columns(trial, head.rig.kind, head.measurement.quantity)[1]
        warnings.append(
            f"{trial.file}, column '{name}': shows nothing but noise while the primary moves; is the second sensor "
            "connected, and the trial coupled?"
        )
    return silent


@dataclass(frozen=True)
class _Filtered:
    """What a coupled trial gives to the sum of torques whatever the lag: its first channel, filtered, and the bumps.

    Angle, its rate, its acceleration, and the dry friction of a body over its size, each filtered by the bump of its
    place in `bumps`.
    """

    trial: Trial
    grid: Array  # (n,) s
    bumps: tuple[Array, Array, Array, Array]
    rate: Array  # velocity of the second body at the times of the trial, about
    first: list[Array]

    def second(self, lag: float) -> list[Array]:
        """The second channel, read later by `lag` (s), filtered alike."""
        return _through(self.bumps, self.grid + lag, self.trial.times, self.trial.channels[1], self.rate)


def _through(bumps: Sequence[Array], at: Array, times: Array, y: Array, rate: Array) -> list[Array]:
    """Readings y thrice, and the way of a velocity, on a grid of times, each filtered by its bump."""
    readings, w = np.interp(at, times, y), np.interp(at, times, rate)
    least = _SLOW * float(np.max(np.abs(w))) + 1e-300
    signals = (readings, readings, readings, w / np.hypot(w, least))
    return [np.convolve(signal, bump, "valid") for signal, bump in zip(signals, bumps, strict=True)]


def _filtered(head: Head, trials: Sequence[Trial]) -> list[_Filtered]:
    """The trials that are long enough."""
    found = []
    for trial in trials:
        period = natural_period(head.rig, trial)
        step = float(np.median(np.diff(trial.times)))
        start, end = _stretch(trial)
        grid = np.arange(start, min(max(end, start + _LEAST * period), float(trial.times[-1])), step)
        width = round(period / step)
        if grid.size < 2 * width:
            continue
        rate = math.pi / period
        x = np.arange(width + 1) * step * rate
        bump, slope, bend = (
            np.sin(x) ** 4,
            4.0 * rate * np.sin(x) ** 3 * np.cos(x),
            4.0 * rate**2 * (3.0 * np.sin(x) ** 2 * np.cos(x) ** 2 - np.sin(x) ** 4),
        )
        derived = (bump[::-1], -slope[::-1], bend[::-1])
        bumps = (*derived, derived[_DERIVED[head.measurement.quantity]])
        one, other = (_rate(trial.times, y, head.measurement.quantity, max(width // 20, 1)) for y in trial.channels)
        found.append(_Filtered(trial, grid, bumps, other, _through(bumps, grid, trial.times, trial.channels[0], one)))
    return found


def _rate(times: Array, y: Array, quantity: str, smooth: int) -> Array:
    """Velocity of a body from its readings, well enough to see which way it moves.

    smooth : readings over which displacements are averaged before they are derived
    """
    if quantity == "velocity":
        return y
    if quantity == "acceleration":  # sums up from rest, to rest
        rate = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(times))])
        last = slice(-max(times.size // 4, 1), None)
        since = times - times[0]
        return np.asarray(rate - since * (np.mean(rate[last]) / max(float(np.mean(since[last])), 1e-300)))
    window = np.ones(2 * smooth + 1) / (2 * smooth + 1)
    return np.gradient(np.convolve(np.pad(y, smooth, mode="edge"), window, "valid"), times)


def _is_clipped(head: Head, trial: Trial) -> bool:
    """Whether a channel has flat tops: what it reads there is no torque."""
    omega = 2.0 * math.pi / natural_period(head.rig, trial)
    held = head.measurement.quantity == "displacement" and head.measurement.start == "rest"
    return any(look.flat_tops_of(trial.times, y, look.noise_floor_of(y), omega, held) for y in trial.channels)


def _is_reversed(head: Head, trials: Sequence[_Filtered], own_swing: float) -> bool:
    """Whether the torques add up with the sign of the second channel reversed, and with about the declared J2."""
    free = _balance(head, trials, 0.0, own_swing, sign=-1.0)
    found = _balance(head, trials, 0.0, own_swing, sign=-1.0, within=_about_declared(head))
    if free is None or found is None:
        return False
    return found.explained > _SHOWN and 1.0 - found.explained <= _ALIKE * (1.0 - free.explained)


def _balance(
    head: Head, trials: Sequence[_Filtered], lag: float, own_swing: float, sign: float = 1.0,
    within: tuple[float, float] = (0.0, math.inf),
) -> _Sum | None:  # fmt: skip
    """The fit of J2, dampings and dry frictions to coupled trials; lag : s by which the second channel is read later.

    own_swing : k1t/J1 as uncoupled trials show it, over the declared one; sign : of the second channel; within : bounds
    of J2. Springs are taken for as uncertain as they are declared.

    None where the records hold too little.
    """
    if not trials:
        return None
    rig = head.rig
    beside, k3 = rig.inertial_coupling.value, rig.ground2_stiffness
    rows: list[Array] = []
    for filtered in trials:
        (th1, w1, a1, dry1), (th2, w2, a2, dry2) = filtered.first, (sign * x for x in filtered.second(lag))
        k1 = own_swing * filtered.trial.k1t.value
        one = np.ones_like(w1)
        off = math.hypot(own_swing * filtered.trial.k1t.std, k1 * rig.primary_inertia.std / rig.primary_inertia.value)
        target = (rig.primary_inertia.value + beside) * a1 + k1 * th1 + beside * a2 + k3.value * th2
        free = (-a2, -w1, -w2, -dry1, -dry2, -off * th1, -k3.std * th2, one, target)
        rows.append(np.stack(free, axis=1))
    table = np.concatenate(rows)
    size = np.append(np.maximum(np.linalg.norm(table[:, :-1], axis=0), 1e-300), 1.0)
    R = np.asarray(np.linalg.qr(table / size, mode="r"))
    # Springs are off by so many standard deviations, and there is none that pushes.
    low = np.array([within[0], 0.0, 0.0, 0.0, 0.0, -_OFF_BY, -min(_OFF_BY, k3.value / max(k3.std, 1e-300)), -np.inf])
    high = np.array([within[1], np.inf, np.inf, np.inf, np.inf, _OFF_BY, _OFF_BY, np.inf])
    low, high = low * size[:-1], high * size[:-1] + 1e-12
    x, left = _bounded(R, low, high)
    if not np.any(R[:, -1] - R[:, -2] * x[-1]):
        return None
    others = R[:, 1:-1]
    own = (R[:, 0] - others @ np.linalg.lstsq(others, R[:, 0], rcond=None)[0]) * size[0]
    error = left / math.sqrt(len(table)) / max(float(np.linalg.norm(own)), 1e-300) * math.sqrt(len(trials) * 4.0)
    # What the rest alone could explain says nothing of the second body.
    without = _bounded(R[:, 1:], low[1:], high[1:])[1]
    explained = 1.0 - (left / max(without, 1e-300)) ** 2
    return _Sum(float(x[0] / size[0]), error, explained, left / size[0])


def _bounded(R: Array, low: Array, high: Array) -> tuple[Array, float]:
    """Least squares of the last column of a triangular table by the others, within bounds, and what it leaves."""
    from scipy.optimize import lsq_linear  # slow to load, and the help of the command line reads this module

    found = lsq_linear(R[:, :-1], R[:, -1], (low, high), method="bvls")
    return found.x, math.sqrt(2.0 * found.cost)


def _stretch(trial: Trial, channel: int = 0) -> tuple[float, float]:
    """From the first to the last reading that stands out from noise, s, the first reading behind a release left out."""
    own = trial.channels[channel]
    y = own - np.median(own[-max(trial.times.size // 4, 1) :])
    large = np.flatnonzero(np.abs(y) > max(0.02 * float(np.max(np.abs(y))), 6.0 * look.noise_floor_of(y)))
    if large.size < 2:
        return float(trial.times[0]), float(trial.times[0])
    first = max(large[0], np.searchsorted(trial.times, 0.0))  # before, a hand balances the torques of displacements
    return float(trial.times[min(first + 2, trial.times.size - 1)]), float(trial.times[large[-1]])
