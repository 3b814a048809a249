"""What one trial does not share with its repeats: bursts, spikes, a wrong record; no gap of the model.

What the model lacks shows in every repeat. A reading far off in one trial, where the repeats of the same case are all
within the noise, is the measurement's own; such readings are left out before anything is judged. So is a whole trial
that is far from repeats which agree with each other: a record of another case, spring or rig under a wrong name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, predict
from bayes_damper.calibration.experiment import repeats_by_reading
from bayes_damper.campaign import readings as look

Array = NDArray[np.float64]
FAR, NEAR = 7.0, 3.5  # robust standard deviations: of the reading, and of its repeats
LATE = 2.0  # samples by which the instant of a release or of a friction reversal may differ between repeats
UNLIKE = 4.0  # times the usual distance between repeats that a trial is away which is none of them
VISIBLY = 0.1  # of the rms of a record: the least distance that counts as another motion
SCALES = (0.8, 1.25)  # of a record beside its repeat, by which the release angle may differ
STOPS = 0.25  # of its largest reading, under which a record says little of how it decays
DECAYS = (0.5, 2.0)  # the same at any time of it, where friction differs too
STRETCHES = np.linspace(0.98, 1.02, 17)  # of its time, by which the spring may differ: four per cent of its stiffness
LAGS = 20  # within a quarter of a period, that are tried with each stretch
FEWEST = 32  # readings that two records must share to be compared
MOST = 0.1  # share of a record beyond which it is not a matter of single readings


def outlying(fit: Calibration) -> dict[int, NDArray[np.bool_]]:
    """Readings to leave out: trial -> (channels, n), only trials that have any. Held-out ones are judged as well."""
    experiment = fit.problem.experiment
    trials, residuals = experiment.trials, fit.residuals()
    sets = repeats_by_reading(experiment, sorted({*residuals, *experiment.heldout}))
    sets = [members for members in sets if len(members) > 1]
    if unseen := [i for members in sets for i in members if i not in residuals]:
        residuals |= {i: p.residual for i, p in predict(fit, unseen).items()}
    jumps = experiment.quantity == "acceleration" and experiment.start == "rest"
    out = {}
    begun = {}
    for members in sets:
        r = np.array([residuals[i] for i in members])
        with np.errstate(invalid="ignore"):
            scale = 1.4826 * np.nanmedian(np.abs(r), axis=(0, 2))
            z = np.abs(r) / np.maximum(scale, 1e-300)[None, :, None]
        for k, i in enumerate(members):
            others = np.nan_to_num(np.delete(z, k, axis=0), nan=np.inf).max(axis=0)
            step = np.abs(np.gradient(np.nan_to_num(trials[i].y - r[k]), axis=1))
            step = np.maximum(step, np.maximum(np.roll(step, 1, axis=1), np.roll(step, -1, axis=1)))
            far = (np.nan_to_num(z[k]) > FAR) & (others < NEAR) & (np.abs(r[k]) > LATE * step)
            far[:, :2] = False  # the release itself
            if 0.0 < far.mean() < MOST:
                out[i] = far
            if jumps and trials[i].inputs is None:
                begun[i] = _on_the_jump(trials[i].y, r[k], z[k], others)
    # A release that takes its time shows so in other trials too.
    seen = [i for i, mask in begun.items() if mask.any()]
    if len(seen) <= max(1.0, MOST * len(begun)):
        out |= {i: begun[i] | out.get(i, False) for i in seen}
    return out


def _on_the_jump(y: Array, r: Array, z: Array, others: Array) -> NDArray[np.bool_]:
    """Where one of the first two accelerations, far off alone, lies between none and that of a rig let go.

    The sensor was read while the rig was being let go: such a reading says how long this release took, and nothing of
    what the trials share. y, r, z : (channels, n), readings, residuals, these in standard deviations; others : largest
    of the repeats.
    """
    modelled = y[0, :2] - r[0, :2]
    mask = np.zeros(y.shape, dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        part = (y[0, :2] * modelled > 0.0) & (np.abs(y[0, :2]) < np.abs(modelled))
        mask[0, :2] = (z[0, :2] > FAR) & (others[0, :2] < NEAR) & part
    return mask


def without(experiment: Experiment, far: dict[int, NDArray[np.bool_]]) -> Experiment:
    """The experiment without those readings."""
    trials = list(experiment.trials)
    for i, mask in far.items():
        trials[i] = replace(trials[i], y=np.where(mask, np.nan, trials[i].y))
    return replace(experiment, trials=tuple(trials))


def outlying_in_words(experiment: Experiment, far: dict[int, NDArray[np.bool_]]) -> list[str]:
    """What was left out, a sentence for each trial."""
    out = []
    for i, mask in far.items():
        t = experiment.trials[i]
        times = t.times[mask.any(axis=0)]
        if mask.sum() == 1:
            left_out = (
                f"one reading at {times.min():.4g} s is far from those of its repeats; it was left out as a fault"
            )
        else:
            left_out = (
                f"{int(mask.sum())} readings between {times.min():.4g} s and {times.max():.4g} s are far from those of "
                "its repeats; they were left out as faults"
            )
        out.append(f"{t.label}: {left_out} of the measurement.")
    return out


# Whole trials -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Odd:
    """A trial unlike its repeats: rms distance to the nearest of them and of these from each other, over their rms.

    like : the trials that it does resemble, in words; empty if none.
    """

    trial: int
    away: float
    usual: float
    like: str = ""


def odd_trials(experiment: Experiment) -> list[Odd]:
    """Trials that at least two others of the same release agree to be none of theirs: another spring, case or rig.

    Judged by the records alone, so that a fit which such a trial has spoilt does not judge it. A trigger that is late
    within a quarter of a period, and a share of the release angle, are no reason.
    """
    if experiment.start != "rest":
        return []
    sets: dict[tuple[str, bool, float], list[int]] = {}
    for i, t in enumerate(experiment.trials):
        if t.inputs is None:
            sets.setdefault((t.case, t.coupled, t.theta0), []).append(i)
    found: list[tuple[list[int], Odd]] = []
    for members in sets.values():
        left = list(members)
        # At most half of a set can be odd.
        for _ in range((len(members) - 1) // 2):
            odd = _odd_one(experiment, left)
            if odd is None:
                break
            left.remove(odd.trial)
            found.append((left, odd))
    bad = {odd.trial for _, odd in found}
    rest = [[i for i in members if i not in bad] for members in sets.values()]
    return [replace(odd, like=_resembled(experiment, odd.trial, own, rest)) for own, odd in found]


def _odd_one(experiment: Experiment, members: list[int]) -> Odd | None:
    """The trial farther from every other one than these are from each other, if there is one."""
    if len(members) < 3:
        return None
    away = {i: {j: _distance(experiment, i, j) for j in members if j != i} for i in members}
    worst = max(members, key=lambda i: min(away[i].values()))
    others = [d for i in members if i != worst for j, d in away[i].items() if j not in (worst, i)]
    usual = float(np.median(others))
    limit = max(UNLIKE * usual, VISIBLY)
    if not min(away[worst].values()) > limit:
        return None
    nearest = min(_distance(experiment, worst, j, shifts=True) for j in away[worst])
    if not nearest > limit:
        return None
    of_one_rig = min(_distance(experiment, worst, j, shifts=True, scatters=True) for j in away[worst])
    return Odd(worst, nearest, usual) if of_one_rig > limit else None


def _distance(
    experiment: Experiment, i: int, j: int, swapped: bool = False, shifts: bool = False, scatters: bool = False
) -> float:
    """Smallest rms difference of two records, beyond white noise, over the rms of the second; the larger channel's.

    Over scales of the first. shifts : over shifts in time too; scatters : and over periods and decays, as far as the
    spring and the friction of one rig may differ from trial to trial; swapped : with the channels of the first
    exchanged. inf where they cannot be compared.
    """
    a, b = experiment.trials[i], experiment.trials[j]
    if a.y.shape[0] != b.y.shape[0] or min(a.times.size, b.times.size) < FEWEST:
        return math.inf
    first = [_known(a.times, y) for y in (a.y[::-1] if swapped else a.y)]
    second = [_known(b.times, y) for y in b.y]
    if min(t.size for t, _ in (*first, *second)) < FEWEST:
        return math.inf
    rounded = [experiment.rounding_step(c) > 0.0 for c in range(len(second))]
    step = float(np.median(np.diff(b.times)))
    most = min(int(0.5 * np.pi / experiment.omegas[b.k1t] / step), b.times.size // 4) if shifts else 0
    best = math.inf
    lags = range(-most, most + 1, max(1, most // LAGS) if scatters else 1)
    for lag, stretch in product(lags, STRETCHES if scatters else (1.0,)):
        at = b.times[0] + stretch * (b.times - b.times[0]) + lag * step
        inside = np.ones(at.shape, dtype=np.bool_)
        for (here, _), (there, _), alike in zip(first, second, rounded, strict=True):
            inside &= (at >= here[0]) & (at <= here[-1]) & (b.times >= there[0]) & (b.times <= there[-1])
            if not alike:  # nothing can be compared where one of them has a gap; runs of a rounded channel are none
                inside &= ~look.within_gaps(at, here) & ~look.within_gaps(b.times, there)
        if inside.sum() < FEWEST:
            continue
        x = np.array([np.interp(at[inside], t, r) for t, r in first])
        y = np.array([np.interp(b.times[inside], t, r) for t, r in second])
        if scatters:  # friction that differs stops one of them first
            k = min(_lasts(x[0]), _lasts(y[0]))
            x, y = x[:, :k], y[:, :k]
        d = _scaled(x, y, b.times[inside][:k] if scatters else None) - y
        # Neighbouring differences hold the white noise (von Neumann 1941), with five of its standard errors.
        fast = 0.5 * np.mean(np.diff(d, axis=1) ** 2, axis=1) * (1.0 + 5.0 * math.sqrt(6.0 / d.shape[1]))
        off = np.maximum(np.mean(d**2, axis=1) - fast, 0.0) / np.maximum(np.mean(y**2, axis=1), 1e-300)
        best = min(best, math.sqrt(float(np.max(off))))
    return best


def _lasts(x: Array) -> int:
    """Readings of a record (n,) up to the last one as large as a share STOPS of the largest, a third at least."""
    return max(int(np.flatnonzero(np.abs(x) > STOPS * np.abs(x).max())[-1]) + 1, x.size // 3, FEWEST)


def _scaled(x: Array, y: Array, times: Array | None) -> Array:
    """Records x (channels, n), scaled to be nearest to y; by a parabola of times (n,), where they are given.

    Where such a parabola leaves the range of `DECAYS` at some time, which the decays of one rig do not, one factor.
    """
    if times is not None:
        s = (times - times[0]) / (times[-1] - times[0])
        powers = s ** np.arange(3)[:, None]
        columns = (powers[:, None] * x).reshape(3, -1)
        factor = np.linalg.lstsq(columns.T, y.ravel(), rcond=None)[0] @ powers
        if DECAYS[0] < factor.min() and factor.max() < DECAYS[1]:
            return np.asarray(factor * x)
    return np.asarray(float(np.clip(np.sum(x * y) / max(float(np.sum(x * x)), 1e-300), *SCALES)) * x)


def _known(times: Array, readings: Array) -> tuple[Array, Array]:
    """Times and values of the readings of one channel that are there."""
    there = np.isfinite(readings)
    return times[there], readings[there]


def _resembled(experiment: Experiment, trial: int, own: Sequence[int], sets: Sequence[Sequence[int]]) -> str:
    """The set to which an odd trial is as near as two of its trials are to each other, channels as they are or not."""
    similar = []
    for members in sets:
        if len(members) < 2:
            continue
        t = experiment.trials[members[0]]
        usual = _distance(experiment, members[0], members[1])
        for swapped in (False, True):
            if (set(members) == set(own) and not swapped) or (swapped and not t.coupled):
                continue
            off = _distance(experiment, trial, members[0], swapped)
            if off < max(2.0 * usual, VISIBLY):
                kind = "coupled" if t.coupled else "uncoupled"
                similar.append((off, f"case {t.case} {kind}" + (" with its channels exchanged" if swapped else "")))
    return min(similar)[1] if similar else ""


def without_trials(experiment: Experiment, odd: Sequence[Odd]) -> Experiment:
    """The experiment without those trials; a set whose held-out trial is gone holds out its last one."""
    gone = {o.trial for o in odd}
    trials = [t for i, t in enumerate(experiment.trials) if i not in gone]
    for o in odd:
        t = experiment.trials[o.trial]
        same = [k for k, u in enumerate(trials) if (u.case, u.coupled, u.theta0) == (t.case, t.coupled, t.theta0)]
        if t.heldout and len(same) > 1 and not any(trials[k].heldout for k in same):
            trials[same[-1]] = replace(trials[same[-1]], heldout=True)
    return replace(experiment, trials=tuple(trials))


def odd_in_words(experiment: Experiment, odd: Sequence[Odd]) -> list[str]:
    """Which trials were left out as a whole and why, a sentence each."""
    out = []
    for o in odd:
        apart = f"are {o.usual:.0%} from" if o.usual >= 0.005 else "agree with"
        like = f" It looks like one of {o.like}." if o.like else " Is it of another spring, case or rig?"
        out.append(
            f"{experiment.trials[o.trial].label}: differs from its repeats, by {o.away:.0%} from the nearest, while "
            f"they {apart} each other. No cause common to all trials does that, so it was left out.{like}"
        )
    return out
