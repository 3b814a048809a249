"""Trials that share a simulation: their readings, weights and each trial's own unknowns."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.experiment import Experiment, TrialRecord, release_window, repeats
from bayes_damper.calibration.noise import Noise
from bayes_damper.calibration.own_values import (
    INPUT,
    NO_SCATTER,
    RELEASE,
    Scatter,
    channel_of,
    half_periods,
    wave,
)
from bayes_damper.calibration.unknowns import NOMINAL, Coordinate, Priors, acting_alone, middle
from bayes_damper.campaign.records import DERIVATIVE, LONGEST_RELEASE
from bayes_damper.priors.distributions import Distribution, LogScale
from bayes_damper.rig.inputs import Inputs

Array = NDArray[np.float64]
FRICTION_SPREAD = 0.04  # prior sd of ln mu from trial to trial, where the repeats show that it varies
EVENT_THRESHOLD = 4.5  # robust sds of the second difference beyond which a sample counts as an event
EVENT_TIMING = 5e-5  # s, by which the instant of an event may be off without the model being wrong
RELEASE_WEIGHT = 0.4  # of the first two readings
FALL_SHAPE = 0.1  # of the peak: how far from a straight line the torque that held the rig may fall
FIRST_STAGE_EVENT_WEIGHT = 0.15
OFFSET_SHARE = 0.05  # of a channel's reach: prior sd of its unknown offset, where the campaign does not say
SLOW = 0.25  # of the rig's frequency, up to which what a free record shows is its sensor's baseline
_FARTHEST = 37.0  # standard deviations beyond which a coordinate is not followed
Nuisance = tuple[str, Array, Array]  # name, prior mean and sd for each trial
Bounds = tuple[Array | float, Array | float]  # of each trial's coordinate
NEAR_READING = 1e-9  # s, by which a release that ends at a reading may lie beyond it by rounding
_WIDE: Bounds = (-_FARTHEST, _FARTHEST)


@dataclass(frozen=True, eq=False)
class Group:
    """Training trials that can share one simulation: same configuration, times and inputs.

    times (n,); (trials, n) in a `Bundle`, whose trials have clocks of their own.
    """

    coupled: bool
    trials: tuple[int, ...]
    times: Array
    inputs: Inputs | None
    y: Array  # (trials, channels, n), missing readings 0
    weight: Array  # the same shape; 0 where missing
    trust: Array  # the same shape: the weight but for what noise that is not the same everywhere changes of it
    events: NDArray[np.bool_]  # the same shape; beside friction reversals
    nuisances: tuple[Nuisance, ...]
    lower: Array  # (trials, m) bounds of eta
    upper: Array
    errors: Array | None = None  # (k, channels, n), what unit sizes of the inputs' noise do to the readings
    kept: dict[tuple[str, bool], Array] = field(default_factory=dict, repr=False)  # what is the same for every fit

    def weights(self, annealed: bool) -> Array:
        """Weights of the residuals; annealed: samples beside friction reversals count little, for a smoother cost."""
        if not annealed:
            return self.weight
        return np.minimum(np.where(self.events, FIRST_STAGE_EVENT_WEIGHT, 1.0), self.weight)

    def shape(self, name: str) -> Array:
        """What a unit of a nuisance that adds to the readings adds to them, (channels, n); in a bundle each trial's."""
        if name.startswith(INPUT):
            assert self.errors is not None
            return np.asarray(self.errors[int(name.removeprefix(INPUT)) - 1])
        out = np.zeros(self.y.shape[-self.times.ndim - 1 :])
        out[..., channel_of(name), :] = wave(name, self.times)
        return out

    def between_readings(self, eta: Array) -> tuple[Array, Array]:
        """Bounds (trials, m) within which each trial's release begins between the readings that it now begins between.

        A release that takes time begins by as much before its instant; here it gets no shorter.
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        names = [name for name, _, _ in self.nuisances]
        if "delay" not in names:
            return lower, upper
        k, taken = names.index("delay"), np.zeros(len(eta))
        _, middle, half = self.nuisances[k]
        if RELEASE in names:
            m = names.index(RELEASE)
            _, mean, sd = self.nuisances[m]
            taken = mean + sd * eta[:, m]
            lower[:, m] = eta[:, m]
        edges, own = np.concatenate([[-np.inf], self.times, [np.inf]]), eta[:, k]
        after = np.searchsorted(edges, middle + half * own - taken - NEAR_READING)
        low, high = (edges[[after - 1, after]] + taken - middle) / half
        lower[:, k] = np.minimum(np.maximum(lower[:, k], low), own)
        upper[:, k] = np.maximum(np.minimum(upper[:, k], high), own)
        return lower, upper

    def only(self, at: slice) -> Group:
        """The group of some of its trials."""
        times = self.times[at] if self.times.ndim == 2 else self.times
        return replace(
            self, trials=self.trials[at], times=times, y=self.y[at], weight=self.weight[at], trust=self.trust[at],
            events=self.events[at], nuisances=tuple((name, mean[at], sd[at]) for name, mean, sd in self.nuisances),
            lower=self.lower[at], upper=self.upper[at], kept={},
        )  # fmt: skip

    def turns(self, readings: int) -> Iterator[tuple[slice, Group]]:
        """Parts of the group with at most so many readings each, or one trial: place among the trials, and part."""
        most = max(readings // max(self.y[0].size, 1), 1)
        if most >= len(self.trials):
            yield slice(None), self
            return
        for first in range(0, len(self.trials), most):
            at = slice(first, first + most)
            yield at, self.only(at)


@dataclass(frozen=True, eq=False)
class Bundle:
    """Groups that share a simulation although their trials have clocks of their own.

    whole : all their trials as one group; parts : each of the groups, and its place among the trials.
    """

    whole: Group
    parts: tuple[tuple[slice, Group], ...]


def bundled(groups: Sequence[Group]) -> list[Bundle]:
    """Bundles of groups with equally many readings and nothing that acts on them while they are recorded."""
    alike: dict[Hashable, list[Group]] = {}
    for k, group in enumerate(groups):
        own = k if group.errors is not None or (group.inputs is not None and group.inputs.active) else -1
        names = tuple(name for name, _, _ in group.nuisances)
        alike.setdefault((own, group.coupled, group.y.shape[1:], names), []).append(group)
    return [_bundle(members) for members in alike.values()]


def _bundle(groups: Sequence[Group]) -> Bundle:
    """The bundle of groups that are alike; of one alone it is that one."""
    ends = np.cumsum([0, *(len(group.trials) for group in groups)])
    parts = tuple((slice(a, b), group) for a, b, group in zip(ends, ends[1:], groups, strict=False))
    if len(groups) == 1:
        return Bundle(groups[0], parts)

    def joined(of: Callable[[Group], NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([of(group) for group in groups])

    whole = replace(
        groups[0], trials=tuple(i for group in groups for i in group.trials),
        times=joined(lambda g: np.tile(g.times, (len(g.trials), 1))), y=joined(lambda g: g.y),
        weight=joined(lambda g: g.weight), trust=joined(lambda g: g.trust), events=joined(lambda g: g.events),
        nuisances=tuple(
            (own[0][0], np.concatenate([mean for _, mean, _ in own]), np.concatenate([sd for _, _, sd in own]))
            for own in zip(*(group.nuisances for group in groups), strict=True)
        ),
        lower=joined(lambda g: g.lower), upper=joined(lambda g: g.upper), kept={},
    )  # fmt: skip
    return Bundle(whole, parts)


@dataclass(frozen=True)
class Switches:
    """Which nuisances of the trials are free: the instant of release, each trial's own friction, its bearings' drag.

    slow : all releases take their time, alike, so that the model lacks it; they may begin before a reading shows it.
    scatter : what else differs from trial to trial, and by how much; it takes the place of `friction` and `drag`.
    """

    delay: bool = True
    friction: bool = True
    drag: bool = False
    slow: bool = False
    scatter: Scatter = NO_SCATTER


@dataclass(frozen=True)
class Grouping:
    """How trials become groups: weights of their readings, and what each trial has for itself.

    factors : trial -> what multiplies the weights of its readings, (channels, n) or a number; coordinates : unknowns
    that trials share; prior : of a parameter, by name and case.
    """

    experiment: Experiment
    noise: Noise
    switches: Switches
    nominal: Literal["nonlinear", "linear"]
    factors: Mapping[int, Array]
    coordinates: Sequence[Coordinate]
    prior: Priors

    def group(self, members: Sequence[int]) -> Group:
        """The group of trials that share times, inputs and configuration."""
        e = self.experiment
        trials = [e.trials[i] for i in members]
        first = trials[0]
        y = e.readings(tuple(members))
        spread = np.array(self.noise.total[: y.shape[1]])
        weight = np.ones_like(y)
        events = np.zeros(y.shape, dtype=np.bool_)
        for same in repeats(trials):
            jump = np.max([_event_strength(trials[k].y, 2.4 * spread) for k in same], axis=0)
            jump = jump * (first.times > first.times[0])
            rate = 1.0 / max(float(np.median(np.diff(first.times))), 1e-12) if first.times.size > 1 else 0.0
            extra = (jump * rate * EVENT_TIMING / spread[:, None]) ** 2
            for k in same:
                weight[k] /= np.sqrt(1.0 + extra)
                events[k] = jump > 0.0
        nuisances, lower, upper = self._nuisances(trials)
        if e.start == "rest" and first.times.size > 2 and e.quantity == "acceleration":
            # The release itself: what rig and sensor do within a sample of it is given by no formula exactly.
            step = float(np.median(np.diff(first.times)))
            early = first.times <= first.times[0] + 1.5 * step
            falling = ~early & (first.times <= first.times[0] + 2.0 * self.switches.scatter.sd(RELEASE))
            for k, t in enumerate(trials):
                held = first.times <= release_window(t, e.quantity)[0] + NEAR_READING
                if first.coupled and e.constants.get("k3t", (0.0, 0.0))[0]:
                    # What keeps the secondary from following its own spring while the primary is held, if anything
                    # does, is not declared.
                    weight[k][1, held] = 0.0
                if not self.switches.delay:
                    # At the very instant of a release a reading may show either side of the jump.
                    weight[k][:, held & (first.times < step)] = 0.0
                if t.times[0] <= 0.0:
                    weight[k][:, early] *= RELEASE_WEIGHT
                    jump = e.stiffnesses[t.k1t][0] * t.theta0 / e.constants["J1"][0]
                    weight[k][0, falling] /= math.hypot(1.0, FALL_SHAPE * jump / spread[0])
        for k, i in enumerate(members):
            weight[k] *= self.factors.get(i, 1.0)
            own = trials[k].weight
            if own is not None:
                weight[k] *= own
            weight[k][~np.isfinite(trials[k].y)] = 0.0
        trust = weight
        if any(t.spread is not None for t in trials):
            weight = trust / np.array([np.ones(t.y.shape) if t.spread is None else t.spread for t in trials])
        return Group(
            first.coupled, tuple(members), first.times, first.inputs, y, weight, trust, events, nuisances, lower, upper,
            first.errors,
        )  # fmt: skip

    def _nuisances(self, trials: list[TrialRecord]) -> tuple[tuple[Nuisance, ...], Array, Array]:
        """What trials that share a simulation have for themselves, with the bounds of each, (trials, m)."""
        e = self.experiment
        if e.start == "free":
            bounded = [(own, _WIDE) for own in self._starts(trials)]
            released = False
        else:
            bounded, released = self._releases(trials)
        alike = [*self._offsets(trials), *self._scattered(trials, released), *self._of_inputs(trials)]
        bounded += [(own, _WIDE) for own in alike]
        out = tuple(own for own, _ in bounded)
        lower, upper = (np.array([np.full(len(trials), b[k]) for _, b in bounded]).T for k in (0, 1))
        for k, (name, centre, spread) in enumerate(out):
            if name == RELEASE:
                longest = LONGEST_RELEASE / np.array([e.omegas[t.k1t] for t in trials])
                lower[:, k], upper[:, k] = -centre / spread, (longest - centre) / spread
        if not out:
            lower = upper = np.zeros((len(trials), 0))
        return out, lower, upper

    def _starts(self, trials: list[TrialRecord]) -> list[Nuisance]:
        """Angles and velocities of trials that are in motion from the first reading on."""
        e = self.experiment
        out = []
        omega = math.sqrt(e.stiffnesses[0][0] / e.constants["J1"][0])
        given = trials[0].inputs
        moved = None if given is None else given.motion
        for name, order in (("theta0", 0), ("omega1_0", 1), ("theta2_0", 0), ("omega2_0", 1)):
            if name in ("theta2_0", "omega2_0") and not trials[0].coupled:
                continue
            if moved is not None and name in ("theta0", "omega1_0"):
                continue  # the primary begins as its motion is prescribed, and the secondary is counted from it
            channel = 1 if "2_0" in name else 0
            power = order - DERIVATIVE[e.quantity]
            reach = np.array([float(np.nanmax(np.abs(t.y[channel]))) for t in trials]) * omega**power
            guess = np.zeros(len(trials))
            if power == 0:
                guess = np.array([float(np.nan_to_num(t.y[channel][0])) for t in trials])
            elif power == 1 and e.quantity == "displacement":
                guess = np.array([_first_slope(t.times, t.y[channel], 1.0 / omega) for t in trials])
            elif power == -2:
                guess = -np.array([float(np.nan_to_num(t.y[channel][0])) for t in trials]) / omega**2
            if moved is not None:
                guess = guess - moved[order, 0]
            out.append((name, guess, 1.5 * reach + 1e-9))
        return out

    def _releases(self, trials: list[TrialRecord]) -> tuple[list[tuple[Nuisance, Bounds]], bool]:
        """Angle, instant and frictions of trials that begin at rest, and whether anything is released in them."""
        e = self.experiment
        n = len(trials)
        out: list[tuple[Nuisance, Bounds]] = []
        mean = np.array([t.theta0 for t in trials])
        sd = np.array([t.theta0_sd for t in trials])
        if np.any(sd > 0.0) and "theta0" not in e.levels:
            out.append((("theta0", mean, np.maximum(sd, 1e-12)), _WIDE))
        absent = {"mu"} if not e.magnet else set()
        absent |= {"mu", "drag"} if self.nominal == "linear" else set()
        for name in (*NOMINAL, "theta0", "delay"):
            if (
                e.levels.get(name) == "trial"
                and name not in absent
                and (trials[0].coupled or name in acting_alone(self.experiment))
            ):
                found = _own_value(name, [self.prior(name, t.case) for t in trials])
                out += [] if found is None else [found]
        forced = trials[0].driven and not np.any(mean)
        if self.switches.delay and "delay" not in e.levels and not forced:  # nothing is released
            out.append(self._instant(trials))
        for name, free in (("mu", self.switches.friction and trials[0].coupled), ("drag", self.switches.drag)):
            if free and any(c.parameter == name for c in self.coordinates):
                out.append(((f"ln_{name}", np.zeros(n), np.full(n, FRICTION_SPREAD)), _WIDE))
        return out, not forced

    def _instant(self, trials: list[TrialRecord]) -> tuple[Nuisance, Bounds]:
        """Instant of the release, or its end, within what the first readings allow."""
        low, high = np.array([release_window(t, self.experiment.quantity) for t in trials]).T
        middle, last = 0.5 * (low + high), high
        if self.experiment.quantity == "acceleration":  # the largest reading may lie within a slow release
            last = high + self.switches.scatter.sd(RELEASE)
        half = 0.35 * (last - low)
        # A rig seen held at the first reading bounds the release from below; else the logger may be later yet.
        first, own = np.array([t.times[0] for t in trials]), self.switches.scatter.sd(RELEASE) > 0.0
        begins = first if own or self.switches.slow else low  # one that takes its time begins unseen
        if self.experiment.rises_slowly:
            begins = first - (high - low)  # of some a slow sensor shows nothing in the first reading after it
        slack = np.where(low >= first, (low - begins) / half - 1e-6, 0.4)
        if own and self.experiment.quantity == "acceleration":  # and may last as long as any
            last = high + LONGEST_RELEASE / np.array([self.experiment.omegas[t.k1t] for t in trials])
        return ("delay", middle, half), ((low - middle) / half - slack, (last - middle) / half * (1.0 - 1e-9))

    def _of_inputs(self, trials: list[TrialRecord]) -> list[Nuisance]:
        """Noise of what was measured as an input, in its own standard deviations."""
        errors, n = trials[0].errors, len(trials)
        count = 0 if errors is None else len(errors)
        return [(f"{INPUT}{k}", np.zeros(n), np.ones(n)) for k in range(1, count + 1)]

    def _offsets(self, trials: list[TrialRecord]) -> list[Nuisance]:
        """Reading of each channel at rest, unknown for each trial; its prior is a share of the channel's reach.

        Of displacements, and of whatever is read of a rig that is in motion from the first reading on: what it reads at
        rest was not seen, and no motion has an acceleration or a speed on average. Of released ones it scatters.
        """
        e = self.experiment
        out = []
        for c in range(1 + int(trials[0].coupled)):
            if e.offset_sd is not None:
                sd = np.full(len(trials), e.offset_sd[min(c, len(e.offset_sd) - 1)])
            elif e.quantity == "displacement" or e.start == "free":
                sd = OFFSET_SHARE * np.array([float(np.nanmax(np.abs(t.y[c]))) for t in trials])
            else:
                continue
            if np.any(sd > 0.0):
                out.append((f"offset{c + 1}", np.zeros(len(trials)), np.maximum(sd, 1e-12)))
        return out

    def _scattered(self, trials: list[TrialRecord], released: bool) -> list[Nuisance]:
        """What else each trial has for itself: values about those of all trials; released : from a known angle.

        Where trials start free a drift has no waves that the rig might have: none above SLOW of its frequency.
        """
        n = len(trials)
        columns = self.switches.scatter.columns(trials[0].coupled)
        if self.experiment.start == "free":
            periods = float(trials[0].times[-1] - trials[0].times[0]) * min(self.experiment.omegas) / (2.0 * math.pi)
            columns = [c for c in columns if not c[0].startswith("drift") or half_periods(c[0]) <= 2.0 * SLOW * periods]
        about = {RELEASE: self.switches.scatter.mean(RELEASE)}
        return [
            (name, np.full(n, about.get(name, 0.0)), np.full(n, sd))
            for name, sd in columns
            if released or name != RELEASE
        ]


def trust_of(groups: Iterable[Group]) -> dict[int, Array]:
    """How far each reading of the groups' trials is trusted, (channels, n): its weight were its noise as elsewhere."""
    return {i: g.trust[k] for g in groups for k, i in enumerate(g.trials)}


def _event_strength(y: Array, noise: Array) -> Array:
    """How far each sample's neighbourhood jumps, in the unit of y: 0 away from events. y (channels, n)."""
    jump = np.zeros_like(y)
    if y.shape[1] < 8:
        return jump
    second = np.zeros_like(y)
    second[:, 1:-1] = y[:, 2:] - 2.0 * y[:, 1:-1] + y[:, :-2]
    second[~np.isfinite(second[:, 2:-2]).any(axis=1)] = 0.0  # no three readings in a row
    scale = 1.4826 * np.nanmedian(np.abs(second[:, 2:-2]), axis=1) + 1e-300
    scale = np.maximum(scale, noise)
    hit = np.abs(second) > EVENT_THRESHOLD * scale[:, None]
    step = np.zeros_like(y)
    step[:, 1:] = np.abs(np.diff(y, axis=1))
    step[:, :-1] = np.maximum(step[:, :-1], step[:, 1:])
    for shift in (-1, 0, 1):
        rolled = np.roll(np.where(hit, step, 0.0), shift, axis=1)
        jump = np.maximum(jump, rolled)
    return np.asarray(np.nan_to_num(jump))


def _own_value(name: str, priors: Sequence[Distribution | float]) -> tuple[Nuisance, Bounds] | None:
    """Nuisance of a parameter that each trial has for itself, with its bounds; None if it is fixed.

    Scales are followed by their logarithm, relative to the median. What is not Gaussian there already (uniform,
    half-normal) gets the Gaussian of the same middle and spread, cut where the prior ends.
    """
    if all(isinstance(p, float | int) for p in priors):
        return None
    means, sds, lows, highs = [], [], [], []
    log = all(isinstance(p, float | int) or p.coordinate == "log" for p in priors) and name not in ("theta0", "delay")
    for p in priors:
        value = middle(p)
        if isinstance(p, float | int):
            spread, low, high = 1e-12, -math.inf, math.inf
        elif isinstance(p, LogScale):
            spread, low, high = math.log(p.factor) * (1.0 if log else value), -math.inf, math.inf
        else:
            (low, high), edge = p.support, (float(p.ppf(0.16)), float(p.ppf(0.84)))
            spread = 0.5 * (math.log(edge[1] / edge[0]) if log else edge[1] - edge[0])
            if log:
                low, high = math.log(low / value), math.log(high / value)
        centre = 0.0 if log else value
        means.append(centre)
        sds.append(spread)
        lows.append(max((low - centre) / spread, -_FARTHEST))
        highs.append(min((high - centre) / spread, _FARTHEST))
    label = f"ln_{name}" if log else name
    return (label, np.array(means), np.array(sds)), (np.array(lows), np.array(highs))


def _first_slope(times: Array, y: Array, within: float) -> float:
    """Rate of change at the first reading, from a parabola through the readings `within` so many seconds."""
    near = (times <= times[0] + within) & np.isfinite(y)
    if np.count_nonzero(near) < 4:
        return 0.0
    return float(np.polynomial.polynomial.polyfit(times[near] - times[0], y[near], 2)[1])
