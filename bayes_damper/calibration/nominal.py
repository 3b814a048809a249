"""From the first fit of the nominal model to the noise, and to the nuisances that the trials ask for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.calibration.experiment import Experiment, late_by_the_clock, lone, repeats
from bayes_damper.calibration.free_starts import single_releases
from bayes_damper.calibration.groups import Group, Switches
from bayes_damper.calibration.input_noise import FELT, felt, with_input_noise
from bayes_damper.calibration.least_squares import Calibration, calibrate, calibrate_each, default_starts, drawn_starts
from bayes_damper.calibration.noise import Noise, rough_noise
from bayes_damper.calibration.noise_level import learn_noise, noise_alone
from bayes_damper.calibration.noise_spread import with_spread
from bayes_damper.calibration.own_values import RELEASE, Scatter
from bayes_damper.calibration.problem import Problem
from bayes_damper.calibration.scatter import (
    SHOWN_FROM,
    SUDDEN,
    carried,
    learn_scatter,
    times_of_release,
    typical_scatter,
    usual_releases,
    with_releases,
    with_scatter,
    without_repeats,
)
from bayes_damper.calibration.unknowns import middle
from bayes_damper.calibration.unlearnt import log_prior
from bayes_damper.campaign.records import LONGEST_RELEASE

Array = NDArray[np.float64]
FEW_REPEATS = 4  # repeats beyond the first of their kind, over all kinds, below which they may be late alike by chance
VARIES = 9.0  # mean square, in variances, of differences between so few repeats from which instants are the trials' own
VARIES_MANY = 3.0  # and between many: what coloured noise and other scatter may add to the 1 of noise
RELEASES = (0.0, 2.0)  # sizes of the time of release from which each trial's is looked for, in all trials alike
TIMES_TRIED = (0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 6.0, 12.0, 25.0)  # sizes of it in one trial
OVER = (0.1, 0.3, 0.5, 0.7, 0.9)  # and shares of it at the first reading
STEPS_TRIED = 3  # of the linearised model with each
WORTH_A_FIT, MOST_ROUNDS = 1.0, 3  # gain of the cost from which the fit follows, and how often
STEP_OF_MEAN = math.sqrt(2.0)  # of the mean time of release, from a typical one on, up or down for as long as it gains
ABOUT = 1.0 / math.sqrt(3.0)  # of their mean: what times differ by where each from none to twice the mean is as likely
SAME, DIFFERENT = (0.0, 0.1, 0.2, 0.3), (0.4, 0.6, 0.8, 1.0)  # shares of their mean that times of release differ by
HOPELESS = 10.0  # nats lost by a typical mean, from which no other one is tried
ALIKE = 0.38  # of their mean: half of what times differ by that are half a normal variable; closer ones are one time
KEPT = 10.0  # nats that the evidence may lose with the times of release
MOST_TURNS = 4  # of learning scatter and noise from the fit, and the fit under them, at most
LONG_PERIODS, FIRST_PERIODS, GROWING_STEPS = 12.0, 3.0, 20  # of records fitted window by window
FEW_TRIALS = 8  # trained on, up to which the cost may have more valleys than the prior medians lead to
LEAVES = 2.0  # times the noise's chi-square, beyond which a model's errors may move the instants of few repeats
NEARLY_DECLARED = 0.1  # of its range, between readings, that an instant of release lies from the declared one
OUT_OF_PHASE = 0.2  # rad of mean phase from which effects are fitted window by window too
TURNS = 2  # of learning the noise where that of the inputs is followed
ODD_CURVE = 2.0  # prior standard deviations of nu or tail from which the usual curve of dry friction is tried again
SHARPER = 0.95  # of the noise before, down to which another turn of learning it from the fit is not worth its time
FIRST_ERROR = 0.02  # of a channel's reach: noise of the first fit where there are no repeats


def releases_vary(fit: Calibration) -> bool:
    """Whether the repeats call for an instant of release of each trial's own, from a fit in which it is free.

    Repeats of one case differ only in what is each trial's own, so the spread of the instants between repeats, beyond
    their own uncertainty, shows whether they vary, whatever the model leaves out. A release that is late by the same
    time in all of them is left to the effects of release and sensor.
    Trials without repeats cannot show it: there they stay free. So do they where few repeats may be as late as each
    other by chance: what that does to the first readings looks like an effect. A logger that starts after the release,
    by the same time in the trials of all cases, is no effect of the rig or its sensors either: those would bring
    forward swings of one spring or amplitude more than those of another.
    Nor can values that a wrong model has pressed against an end of their range other than the nominal one.
    What a release that takes its time does like a later one counts as a later one.
    Where readings leave a record's instant open by more than any clock does, it stays free.
    """
    problem = fit.problem
    z: list[float] = []
    spare, pressed = 0, 0
    when: list[float] = []
    known: list[float] = []
    for block, H, _, _ in fit.linear.normal().parts:
        names = [n for n, _, _ in block.group.nuisances]
        if "delay" not in names:
            continue
        i = names.index("delay")
        kept = [k for k, name in enumerate(names) if name != RELEASE]
        sd = np.sqrt(np.linalg.inv(H[:, kept][:, :, kept])[:, kept.index(i), kept.index(i)])
        instants = block.eta[:, i].copy()
        if RELEASE in names:
            k = names.index(RELEASE)
            instants += block.eta[:, k] * H[:, i, k] / np.maximum(H[:, i, i] - 1.0, 1e-12)
        _, centre, unit = block.group.nuisances[i]
        when += list(centre + unit * instants)
        known += list(1.0 / (unit * sd) ** 2)
        for members in repeats([problem.experiment.trials[j] for j in block.group.trials]):
            spare += len(members) - 1
            values = instants[members]
            pressed += _pressed(block.group, i, members, block.eta[members, i])
            z += list((values - values.mean()) / sd[members] / math.sqrt(max(1.0 - 1.0 / len(members), 1e-9)))
    if late_by_the_clock(problem.experiment, problem.trials):
        return bool(z)
    few = spare < FEW_REPEATS or 2 * pressed >= len(z)
    if not z or few or float(np.mean(np.square(z))) > _differing(spare):
        return bool(z)
    common = float(np.average(when, weights=known))
    alike = float(np.mean(np.array(known) * (np.array(when) - common) ** 2)) < VARIES
    return alike and -common * math.sqrt(sum(known)) > math.sqrt(VARIES)


def _differing(spare: int) -> float:
    """Mean square of the differences between repeats above which they are real, with so many beyond the first.

    By chance a mean square of n differences is off by a share of sqrt(2 / n): what few repeats may show without any
    scatter of the instants, many do not.
    """
    return max(VARIES_MANY, 1.0 + (VARIES - 1.0) * math.sqrt(FEW_REPEATS / spare))


def _pressed(group: Group, i: int, members: Sequence[int], values: Array) -> int:
    """How many values of nuisance i lie at an end of their range that is not the nominal value 0."""
    _, mean, sd = group.nuisances[i]
    low, high = group.lower[members, i], group.upper[members, i]
    near = 0.02 * (high - low)
    off_low = np.abs(mean[members] / sd[members] + low) > near
    off_high = np.abs(mean[members] / sd[members] + high) > near
    return int(np.sum((values - low < near) & off_low) + np.sum((high - values < near) & off_high))


def grown(experiment: Experiment, problem: Problem, starts: Sequence[Array] = ()) -> Calibration | None:
    """The first periods of long records fitted, and the fit carried on over windows twice as long each time.

    Over many periods an error of the frequency by one part in as many puts the model out of phase, and the cost has a
    valley for every cycle; over the first periods it has one. The fit to the longest window that is shorter than the
    records; None for short records, which need none of it.

    problem : with an effect or without; starts : of the first window, default those of any fit.
    """
    trials = [experiment.trials[i] for i in problem.trials]
    period = 2.0 * math.pi / max(experiment.omegas)
    span = max(float(t.times[-1] - t.times[0]) for t in trials)
    window = FIRST_PERIODS * period
    if span < LONG_PERIODS * period:
        return None
    starts = list(starts) or default_starts(problem)
    found: Calibration | None = None
    while window < span:
        cut = tuple(t.at(t.times <= t.times[0] + window) for t in experiment.trials)
        part = problem.changed(experiment=replace(experiment, trials=cut), tolerance=1.0, factors=None)
        eta = None if found is None else carried(found, part)
        found = calibrate(part, starts, eta=eta, most=GROWING_STEPS, finish=False, give_up=300.0)
        starts = [found.q]
        window *= 2.0
    return found


def _releases(fit: Calibration) -> Calibration:
    """The fit with each trial's release in its deepest valley, looked for anew as long as the fit gains by it."""
    for turn in range(MOST_ROUNDS):
        before, fit = fit.cost, _each_release(fit, () if turn else RELEASES)
        if not fit.cost < before - WORTH_A_FIT:
            break
    # Differences to one side say nothing of what is hardly known, nor of an evidence.
    return fit if fit.linear.central else calibrate(fit.problem, [fit.q], eta=fit.eta, anneal=False)


def gained_by_own_releases(fit: Calibration) -> float:
    """Nats that a time of release of each trial's own gains the nominal model where no trial is repeated, else 0.

    Nothing learns their size there, and a fit has none of them: a filter or a lag would hide in them. But latches take
    that long, so that what such times explain is no sign of a gap.
    """
    problem = fit.problem
    has_them = problem.switches.scatter.sd(RELEASE) > 0.0
    if has_them or problem.experiment.start != "rest" or not lone(problem.experiment, problem.trials):
        return 0.0
    slow = usual_releases(problem)
    found = _releases(calibrate(slow, [fit.q], eta=carried(fit, slow), anneal=False))
    return max(_log_density(found) - _log_density(fit), 0.0)


def explained_by_own_releases(fit: Calibration) -> float:
    """Nats that a time of release of each trial's own gains the nominal model that has it, else 0."""
    every = fit.problem.switches.scatter.sizes
    sizes = tuple(s for s in every if s.name != RELEASE)
    if len(sizes) == len(every):
        return 0.0
    return max(_log_density(fit) - _log_density(with_scatter(fit, Scatter(sizes))), 0.0)


def _other_valleys(fit: Calibration) -> dict[int, Array]:
    """Nuisances of the trials that are likelier with another time of release, all that is common as it is.

    Any time from a grid is tried with some share of it over at the first reading, and with its middle at the fit's own,
    which is known from all later readings: there the trial's other nuisances go where the linearised model leads, by
    what comes after the longest release.
    """
    problem = fit.problem
    end = float(problem.experiment.ends_bounded)  # the own instant: 0 at the beginning, 1 at the end
    looked: dict[int, Array] = {}
    for block in fit.linear.blocks:
        group = block.group
        rows = {name: (n, mean, sd) for n, (name, mean, sd) in enumerate(group.nuisances)}
        if RELEASE not in rows or "delay" not in rows:
            continue
        (n, least, size), (d, late, unit) = rows[RELEASE], rows["delay"]
        free = np.arange(len(rows)) != n
        weights = group.weights(False)

        for k, i in enumerate(group.trials):
            first = problem.experiment.trials[i].times[0]
            time = least[k] + size[k] * np.array(TIMES_TRIED)
            own = np.tile(fit.eta[i], (time.size, 1))
            own[:, n] = TIMES_TRIED
            at_first = np.tile(own, (len(OVER), 1))
            instants = [first + (end - share) * time for share in OVER]
            at_first[:, d] = (np.concatenate(instants) - late[k]) / unit[k]
            own[:, d] += (end - 0.5) * size[k] * (own[:, n] - fit.eta[i][n]) / unit[k]
            T = block.T[k][free] * np.tile(group.times > first + time[-1], len(weights[k]))
            H = np.eye(len(T)) + T @ T.T
            for _ in range(STEPS_TRIED):
                own = np.clip(own, group.lower[k], group.upper[k])
                y = problem.simulate(group, np.full(len(own), k), np.tile(fit.q, (len(own), 1)), own)
                r = problem.whitened(y - group.y[k], weights[k])
                own[:, free] -= np.linalg.solve(H, T @ r.T + own[:, free].T).T
            looked[i] = np.clip(np.concatenate([[fit.eta[i]], own, at_first]), group.lower[k], group.upper[k])
    if not looked:
        return {}
    count = len(next(iter(looked.values())))
    tried = {i: np.tile(v, (count, 1)) for i, v in fit.eta.items()} | looked
    costs = problem.costs_of_trials(np.tile(fit.q, (count, 1)), tried)
    best = {i: int(np.argmin(np.where(np.isfinite(c), c, np.inf))) for i, c in costs.items()}
    better = {i: k for i, k in best.items() if k}
    gained = sum(float(costs[i][0] - costs[i][k]) for i, k in better.items())
    return {i: tried[i][k] for i, k in better.items()} if gained > WORTH_A_FIT else {}


def _each_release(fit: Calibration, sizes: Sequence[float] = ()) -> Calibration:
    """The fit with each trial's time of release in the deepest of its valleys: sudden, as found, or slow.

    A reading within the release is met by a sudden one at that very instant, too, and no descent leads from there to
    a slow one. The trials are apart but for the common parameters: the best of some fits is taken for each.

    sizes : of the time of release, from which it is looked for in all trials alike, too.
    """

    def costs(found: Calibration) -> dict[int, float]:
        return {
            i: float(b.r[k] @ b.r[k] + b.eta[k] @ b.eta[k])
            for b in found.linear.blocks
            for k, i in enumerate(b.group.trials)
        }

    places = {i: n for g in fit.problem.groups for i in g.trials for n, u in enumerate(g.nuisances) if u[0] == RELEASE}
    if not places:
        return fit
    starts = [{i: np.where(np.arange(v.size) == places.get(i, -1), x, v) for i, v in fit.eta.items()} for x in sizes]
    if elsewhere := _other_valleys(fit):
        starts.insert(0, {**fit.eta, **elsewhere})
    found = [fit, *calibrate_each(fit.problem, [(fit.q, s) for s in starts], anneal=False, finish=False)]
    own = [costs(f) for f in found]
    best = {i: min(range(len(found)), key=lambda k: own[k][i]) for i in places}
    if len(set(best.values())) > 1:
        eta = {i: found[best.get(i, 0)].eta[i] for i in fit.eta}
        start = min(found, key=lambda f: f.cost).q
        found.append(calibrate(fit.problem, [start], eta=eta, anneal=False, finish=False))
    return min(found, key=lambda f: f.cost)


def _about_a_mean(fit: Calibration) -> Calibration:
    """The fit with each trial's time of release between none and twice a mean, if that is likelier; else the fit.

    Sizes are learnt from what differs between repeats. Where single trials show little of their times, what these
    share is known far better, and an effect that lets go slowly, or a lag, would stand for it. Times that are all alike
    as far as the trials show are left to those.
    """
    problem = fit.problem
    trials = [problem.experiment.trials[i] for i in problem.trials]
    usual = [s for s in typical_scatter(problem, releases=True).sizes if s.name == RELEASE]
    if not usual or lone(problem.experiment, problem.trials) or all(t.theta0 == 0.0 for t in trials):
        return fit
    others = tuple(s for s in problem.switches.scatter.sizes if s.name != RELEASE)
    size = problem.switches.scatter.sd(RELEASE)

    def sudden(slow: bool = False) -> Calibration:
        switches = replace(problem.switches, scatter=Scatter(others), slow=slow)
        without = problem.changed(switches=switches)
        return calibrate(without, [fit.q], eta=carried(fit, without), anneal=False)

    if size and _alike(fit):
        return sudden(slow=True)
    if size and max(times_of_release(fit), default=0.0) < SUDDEN * size:  # it was learnt from other times on the way
        fit = max(fit, sudden(), key=_log_density)

    def about(share: float, start: Calibration) -> tuple[Calibration, float]:
        mean = share * usual[0].typical
        scatter = Scatter((*others, replace(usual[0], sd=ABOUT * mean, low=0.0, high=2.0 * mean, mean=mean)))
        wide = problem.changed(switches=replace(problem.switches, scatter=scatter))
        found = calibrate(wide, [start.q], eta=carried(start, wide), anneal=False)
        return found, _log_density(found) + float(log_prior(np.log(share))) - float(log_prior(np.zeros(())))

    known = _log_density(fit)
    best, most = about(1.0, fit)
    if most < known - HOPELESS:
        return fit
    share, longest = 1.0, LONGEST_RELEASE / (usual[0].typical * max(problem.experiment.omegas))
    for step in (STEP_OF_MEAN, 1.0 / STEP_OF_MEAN):
        while share * step < longest and (further := about(share * step, best))[1] > most:
            share, (best, most) = share * step, further
    if most <= known + SHOWN_FROM:
        return fit
    best = _releases(best)
    return sudden(slow=True) if _alike(best) else best


def _alike(fit: Calibration) -> bool:
    """Whether times of release differ by less than half of what times about a mean differ by, as far as trials show.

    Each trial's own likelihood is that of its fit without the prior; those of all trials are Gaussian about a mean, by
    a share of it that is small or usual.
    """
    shown, variance = [], []
    for block, H, _, _ in fit.linear.normal().parts:
        k = [name for name, _, _ in block.group.nuisances].index(RELEASE)
        _, mean, sd = block.group.nuisances[k]
        left = np.minimum(np.linalg.inv(H)[:, k, k], 1.0 - 1e-9)  # of a prior variance of 1
        shown += list(mean + sd * block.eta[:, k] / (1.0 - left))
        variance += list(sd**2 * left / (1.0 - left))
    center = np.geomspace(0.2, 5.0, 60)[:, None, None] * float(np.median(np.abs(shown)))
    both = []
    for shares in (SAME, DIFFERENT):
        v = np.array(variance) + (np.array(shares)[:, None] * center) ** 2
        both.append(float(logsumexp(-0.5 * np.sum(np.log(v) + (np.array(shown) - center) ** 2 / v, axis=2))))
    return both[0] > both[1] + SHOWN_FROM


def _as_declared(fit: Calibration) -> Calibration:
    """The fit with every release at the nominal instant, if that is as likely; the fit itself if not.

    What repeats differ by may be counted too high where noise is coloured or much scatters. Instants that lie where
    they are declared then have a prior of their own each that an effect could spare. A model that leaves more than
    noise may bring few repeats there by chance.
    """
    problem = fit.problem
    sets = repeats([problem.experiment.trials[i] for i in problem.trials])
    spare = sum(len(members) - 1 for members in sets)
    if not problem.switches.delay or not spare or len(problem.trials) < FEW_REPEATS:
        return fit
    if spare < FEW_REPEATS and fit.chi2 > LEAVES * problem.n_data:
        return fit
    off = []
    for group in problem.groups:
        for m, (name, mean, sd) in enumerate(group.nuisances):
            if name == "delay":
                own = np.array([fit.eta[i][m] for i in group.trials])
                off += list(np.abs(mean / sd + own) / (group.upper[:, m] - group.lower[:, m]))
    if not off or float(np.median(off)) > NEARLY_DECLARED:
        return fit
    sizes = problem.switches.scatter.sizes
    if max(times_of_release(fit), default=0.0) < SUDDEN * problem.switches.scatter.sd(RELEASE):
        sizes = tuple(s for s in sizes if s.name != RELEASE)
    exact = problem.changed(switches=replace(problem.switches, delay=False, scatter=Scatter(sizes)))
    found = calibrate(exact, [fit.q], eta=carried(fit, exact), anneal=False)
    return max(fit, found, key=_log_density)


def _one_of_each(problem: Problem) -> tuple[int, ...]:
    """The first trial of each kind that repeats: on these a search from many starts costs little."""
    kinds: dict[tuple[str, bool, float, int], int] = {}
    for i in problem.trials:
        t = problem.experiment.trials[i]
        kinds.setdefault((t.case, t.coupled, t.theta0, t.k1t), i)
    return tuple(kinds.values())


def _begun(problem: Problem) -> tuple[Calibration, bool]:
    """A rough fit, and whether the records are long: of one trial of each kind from many starts, then of all.

    The usual curve of dry friction comes first, which is then free: far from the best fit a slow end of the friction
    stands for any damping, in a valley of its own. So may a coupling that slips at once where it should hold.
    """
    e = problem.experiment
    if "tail" in problem.names and e.levels.get("tail", "campaign") == "campaign" and "tail" not in e.case_priors:
        e = replace(e, priors=dict(e.priors) | {"tail": middle(problem.prior("tail", ""))})
    few = problem.changed(experiment=e, effect=None, tolerance=1.0, trials=_one_of_each(problem), factors=None)
    long = grown(e, few)
    starts = [*default_starts(few), *drawn_starts(few)] if long is None else [long.q, *default_starts(few)]
    found = calibrate(few, starts, most=15, finish=False, give_up=300.0)
    start = problem.prior_mean()
    start[[problem.names.index(name) for name in few.names]] = found.q
    return calibrate(problem, [start], most=15, finish=False), long is not None


def _log_density(fit: Calibration) -> float:
    """The log evidence with what depends on the noise alone, for comparing fits under different noise."""
    sizes = np.log(np.array(fit.problem.noise.innovation))
    counted = [np.sum(g.weight > 0.0, axis=(0, 2)) for g in fit.problem.groups]
    return fit.log_evidence - sum(float(n @ sizes[: n.size]) for n in counted) - _left_out(fit, sizes)


def _left_out(fit: Calibration, sizes: Array) -> float:
    """What the readings at exact instants of release cost, which have no weight: each shows one side of the jump or the
    other, half as likely a priori, as far off as noise is. sizes : ln of each channel's noise.

    Left out of the one fit alone, they would count in the units of the readings.
    """
    e, total = fit.problem.experiment, 0.0
    if fit.problem.switches.delay or e.quantity != "acceleration" or e.start != "rest":
        return total
    for group in fit.problem.groups:
        early = group.times < np.median(np.diff(group.times))
        for k, i in enumerate(group.trials):
            for c, y in enumerate(e.trials[i].y):
                if c == 0 or not e.constants.get("k3t", (0.0, 0.0))[0]:
                    left = early & np.isfinite(y) & (group.weight[k][c] == 0.0)
                    total += float(np.sum(left)) * (float(sizes[c]) + 0.5 + math.log(2.0))
    return total


def under(fit: Calibration, noise: Noise, scatter: Scatter | None = None) -> Calibration:
    """The fit under another noise and the scatter that is learnt with it, or that which is given.

    Times of release that differ are kept if it is far worse without them: that repeats need none is judged along a
    line. If all are alike it is a gap.
    """
    sizes = learn_scatter(fit, noise) if scatter is None else scatter
    found = with_scatter(fit, sizes, noise)
    own = [s for s in fit.problem.switches.scatter.sizes if s.name == RELEASE and not sizes.sd(RELEASE)]
    times = np.array(times_of_release(fit) or [0.0])
    differ = float(np.std(times)) > ALIKE * float(np.mean(times))
    if scatter is None and own and differ and _log_density(found) < _log_density(fit) - KEPT:
        found = with_scatter(fit, Scatter((*sizes.sizes, *own)), noise)
    return found


def with_sizes_of_its_own(fit: Calibration) -> Calibration:
    """The fit of released trials without repeats, and its noise, with the sizes of scatters that they make likely.

    Those that are usual leave a part of what scatters more, and the noise that is learnt from it is too large. The
    evidence hangs little on these sizes: it is integrated over all (unlearnt.py).
    """
    for _ in range(MOST_TURNS):
        before = fit.problem.noise.total
        fit = under(fit, fit.problem.noise, without_repeats(fit))
        fit = under(fit, learn_noise(fit), fit.problem.switches.scatter)
        if all(abs(new / old - 1.0) < 1.0 - SHARPER for new, old in zip(fit.problem.noise.total, before, strict=True)):
            break
    return fit


def as_single_releases(fit: Calibration) -> Calibration:
    """The fit with the scatter that priors say of releases by hand of other sizes, if that takes all of the error.

    Where an error of the model is left all the same, values of each trial's own would hide a part of what they share.
    """
    experiment = fit.problem.experiment
    known = fit.problem.switches.scatter.from_trial_to_trial
    if known or experiment.start != "free" or not single_releases(experiment, fit.problem.trials):
        return fit
    sizes = learn_scatter(fit, apart=True)
    found = with_scatter(fit, sizes)
    for _ in range(MOST_TURNS):
        noise = learn_noise(found)
        found = calibrate(found.problem.with_noise(noise), [found.q], eta=found.eta, anneal=False)
        if not noise.sensor:
            return found
    readings = sum(experiment.trials[i].times.size for i in found.problem.trials)
    return found if noise_alone(found.problem.noise, readings) else fit


def _as_latched(fit: Calibration) -> Calibration:
    """The fit of trials without repeats with a time of release of each, if that is likelier and an error is left.

    Where none is left a filter or a lag would hide in such times. They are looked for as if noise were all of the rest.
    """
    if not fit.problem.noise.sensor:
        return fit
    problem = fit.problem.with_noise(fit.problem.noise.of_sensors)
    sudden, slow = (
        with_sizes_of_its_own(_releases(calibrate(p, [fit.q], eta=carried(fit, p), anneal=False)))
        for p in (problem, usual_releases(problem))
    )
    return slow if _log_density(slow) > max(_log_density(sudden), _log_density(fit)) + SHOWN_FROM else fit


def broad_noise(experiment: Experiment, trained: Sequence[int]) -> Noise:
    """Noise for the first fit of records without repeats: a share of what each channel reads.

    The error of the model is not known yet, and may be a thousand times the noise.
    """
    noise = rough_noise(experiment, trained)
    trials = [experiment.trials[i] for i in trained]
    reach = [max(float(np.nanmax(np.abs(t.y[c]))) for t in trials if c < len(t.y)) for c in range(len(noise.phi))]
    level = tuple(max(s, FIRST_ERROR * r) for s, r in zip(noise.innovation, reach, strict=True))
    return replace(noise, innovation=level, sensor=noise.total)


def out_of_phase(fit: Calibration) -> bool:
    """Whether a fit to records without repeats leaves so much that somewhere in them it is out of phase.

    An error of the phase by x leaves x times the reading, and beyond half a period it leads into another valley.
    """
    if not fit.problem.noise.sensor:
        return False
    trials = fit.problem.experiment.trials
    return any(
        float(np.nanmean(r[c] ** 2)) > OUT_OF_PHASE**2 * float(np.nanvar(trials[i].y[c]))
        for i, r in fit.residuals().items()
        for c in range(r.shape[0])
    )


def calibrate_nominal(
    experiment: Experiment,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    switches: Switches | None = None,
    begin: Calibration | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """The nominal model fitted to the training trials: roughly, then with the nuisances and noise that they show.

    The experiment of the fit knows what noise of the measured inputs does to the readings, where that shows.

    begin : a fit to the same trials but for some readings, near which the search begins.
    """
    exact = _with_exact_inputs(experiment, nominal, switches, begin, report)
    if (uneven := with_spread(exact)) is not None:
        report("the noise is stronger where the rig moves more; fitting the nominal model again")
        exact = _with_exact_inputs(uneven, nominal, switches, exact, report)
    noisy = with_input_noise(exact)
    if noisy is None:
        return exact
    noise, chosen = exact.problem.noise.of_sensors, exact.problem.switches
    problem = Problem(noisy, nominal=nominal, noise=noise, switches=chosen)
    fit = calibrate(problem, [exact.q], eta=carried(exact, problem), anneal=False)
    if felt(fit) < FELT:
        return exact
    for _ in range(TURNS):
        fit = _under_its_noise(fit)
    report(f"noise of the measured inputs estimated; {_left(fit)}")
    return fit


def _left(fit: Calibration) -> str:
    """Rms of the readings and of what the fit leaves of them, channel by channel, in words."""
    residuals, trials = fit.residuals(), fit.problem.experiment.trials
    each = []
    for c in range(max(len(r) for r in residuals.values())):
        left = np.concatenate([r[c] for r in residuals.values() if c < len(r)])
        read = np.concatenate([trials[i].y[c] for i, r in residuals.items() if c < len(r)])
        each.append(f"{math.sqrt(np.nanmean(left**2)):.3g} of {math.sqrt(np.nanmean(read**2)):.3g}")
    return f"it leaves (rms of each channel, SI units) {', '.join(each)}"


def _usual_curve(fit: Calibration) -> Calibration:
    """The fit, or a better one that begins with the usual curve of dry friction where the first ended far from it.

    A very smooth friction with a long tail resembles viscous damping beside a sharp one; no short step leads from the
    one to the other.
    """
    problem, curve = fit.problem, {"nu", "tail"}
    places = [i for i, name in enumerate(problem.names) if name in curve]
    if not places or float(np.abs(fit.q[places]).max()) < ODD_CURVE:
        return fit
    start = fit.q.copy()
    start[places] = 0.0
    again = calibrate(problem, [start], eta=fit.eta)
    return again if again.cost < fit.cost else fit


def _under_its_noise(fit: Calibration) -> Calibration:
    """The fit gone on with under the noise that it shows."""
    return calibrate(fit.problem.with_noise(learn_noise(fit)), [fit.q], eta=fit.eta, anneal=False)


def _sharpened(fit: Calibration) -> Calibration:
    """The fit and its noise in turns: a better fit leaves smaller residuals, whose smaller noise sharpens the fit."""
    for _ in range(MOST_TURNS):
        before = fit.problem.noise.total
        fit = _under_its_noise(fit)
        if all(new > SHARPER * old for new, old in zip(fit.problem.noise.total, before, strict=True)):
            break
        fit = _usual_curve(fit)
    return fit


def _again(experiment: Experiment, begin: Calibration) -> Calibration:
    """A fit made again where some readings of its trials have changed."""
    problem = begin.problem.changed(experiment=experiment, effect=None, tolerance=1.0, trials=None, factors=None)
    return _releases(calibrate(problem, [begin.q], eta=begin.eta, anneal=False))


def _shaped(experiment: Experiment, nominal: Literal["nonlinear", "linear"], switches: Switches | None) -> Calibration:
    """The best fit from many starts under the first noise that is learnt, with the nuisances that the trials ask for.

    switches : the nuisances instead.
    """
    first = (broad_noise if lone(experiment, experiment.training) else rough_noise)(experiment, experiment.training)
    problem = Problem(experiment, nominal=nominal, noise=first, switches=switches or Switches())
    fit, long = _begun(problem)
    chosen = switches or Switches(friction=False, scatter=learn_scatter(fit))
    if switches is None:
        # A scatter that has no place yet would look like releases late by different times; so do slow ones.
        for scatter in (chosen.scatter, with_releases(problem, chosen.scatter)):
            problem = problem.changed(switches=replace(chosen, scatter=scatter))
            fit = calibrate(problem, [fit.q], eta=carried(fit, problem), most=8, finish=False, anneal=False)
            vary = releases_vary(fit)
            if not vary:
                break
        chosen = replace(chosen, delay=vary, scatter=with_releases(problem, chosen.scatter))
    problem = Problem(experiment, nominal=nominal, noise=learn_noise(fit), switches=chosen)
    starts = [fit.q, *default_starts(problem)]
    if len(problem.trials) <= FEW_TRIALS and not long:
        starts += drawn_starts(problem)
    return _releases(calibrate(problem, starts, give_up=300.0))


def _with_exact_inputs(
    experiment: Experiment,
    nominal: Literal["nonlinear", "linear"],
    switches: Switches | None,
    begin: Calibration | None,
    report: Callable[[str], None],
) -> Calibration:
    """The nominal model fitted with inputs as they were recorded."""
    alone = lone(experiment, experiment.training)
    fit = _shaped(experiment, nominal, switches) if begin is None else _again(experiment, begin)
    noise = learn_noise(fit)
    report(f"nominal model fitted; {_left(fit)}")
    # The first noise held the scatter that was not learnt yet.
    fit = under(fit, noise, None if switches is None else switches.scatter)
    if switches is None:
        fit = _as_declared(fit)
    fit = _usual_curve(fit)
    if noise.sensor:
        fit = _sharpened(fit)
    if alone and switches is None and experiment.start == "rest" and fit.problem.switches.scatter.sizes:
        return _as_latched(with_sizes_of_its_own(fit))
    if noise.sensor:
        return as_single_releases(fit) if switches is None else fit
    # In turns these need not gain at each: the best of a few is kept.
    best, last = fit, _log_density(fit)
    for _ in range(MOST_TURNS if switches is None else 0):
        noise = learn_noise(fit)
        if not all(map(math.isfinite, noise.innovation)):
            break  # trials that have nothing in common
        fit = under(fit, noise)
        before, last = last, _log_density(fit)
        best = max(best, fit, key=_log_density)
        if not abs(last - before) > 1.0:
            break
    best = _releases(best)
    return as_single_releases(_about_a_mean(best)) if switches is None else best
