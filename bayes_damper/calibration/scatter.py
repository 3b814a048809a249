"""What differs from trial to trial, how much of it, learnt from what repeats do not share.

A spring that seats differently, a bearing that warms, a gain that wanders: each trial j has its own x_j = s eta_j about
the value that the campaign (or the case) has, relative for parameters of the rig and gains, in the unit of the readings
for offsets and slow drift. The trials' own values are integrated out with the release angle and its instant; their
sizes s are learnt here, all at once.

Repeats of one case share the motion and whatever the model lacks of it. With r_j the whitened residuals of repeat j
with its own values at 0, and T_j their derivatives by these, in units of typical sizes, the model of a set is

    r_j = -T_j (m + eta_j) + noise,   m ~ flat,   eta_j ~ N(0, D),

D the squares of the sizes over the typical ones: what is shared goes into m (of release angles, about a tenth), and
only what the repeats differ by is left to judge D (Patterson and Thompson 1971, Biometrika 58, 545: restricted
likelihood). It needs T_j T_j' and T_j r_j alone, so that an evaluation costs microseconds, and repeats may have other
clocks and lengths. The instant of release has a flat prior here: it is not linear.

Nor is the time that a release takes, over which what holds the primary gives way in proportion (equations.ROWS): a fit
follows it first. It is never negative, so eta is half a normal variable, which differs from its mean by less than from
0 (ABOUT_ITS_MEAN): repeats that all take the same time show no scatter, and what they share is a gap, release_ramp.

The prior of a size is half a Student t of 4 degrees of freedom with the typical size as its scale (Gelman 2006,
Bayesian Analysis 1, 515): it lets a scatter be absent, and far larger than usual. What enters a fit is the root of the
posterior mean of s^2. Where nothing is repeated, sizes are those that the trials make likely with all that they share,
and evidences are integrated over them (unlearnt.py).

One thing single records do show: a baseline of a sensor that wanders more slowly than the rig can move. It has the
cosines of a random walk (Karhunen-Loeve: the k-th falls as 1/k), up to a quarter of the rig's frequency.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize
from scipy.special import ndtr, ndtri, stdtr

from bayes_damper.calibration.experiment import lone, repeats
from bayes_damper.calibration.free_starts import released_apart, swinging_alike
from bayes_damper.calibration.groups import Nuisance
from bayes_damper.calibration.least_squares import Calibration, calibrate
from bayes_damper.calibration.noise import Noise
from bayes_damper.calibration.own_values import (
    BASELINE_WAVES,
    COUPLED_ONLY,
    NO_SCATTER,
    READINGS,
    RELATIVE,
    RELEASE,
    Scatter,
    Size,
    middle_of,
    nuisance,
)
from bayes_damper.calibration.problem import Problem
from bayes_damper.calibration.unknowns import TREND
from bayes_damper.calibration.unlearnt import LARGEST, Unlearnt, log_prior, prior_slope
from bayes_damper.runs.contents.diagnosis import ScatterEntry

Array = NDArray[np.float64]

TYPICAL: Mapping[str, float] = {
    "k1t": 0.002,  # a spring seats anew, and warms by some kelvin
    "k2t": 0.005,  # a magnet's pull falls by 0.1 % a kelvin and varies with the gap as that is set
    "c1t": 0.05,  # lubricants lose 3 to 5 % of their viscosity a kelvin
    "c3t": 0.05,
    "c2t": 0.05,
    "mu": 0.05,  # dry friction repeats to 4 to 6 % between runs of one day
    "drag": 0.05,
    "drag_ratio": 0.05,  # each bearing has its own grease and seals
    "gain": 0.002,  # an amplifier in a room
    "offset": 0.5,  # of the channel's noise
    "drift": 0.5,  # of the channel's noise, over the record
    "hum": 0.5,  # of the channel's noise, where a line of the mains shows; its phase at a release is any
    "release_time": 3e-4,  # s, over which what holds the rig gives way: valves and latches take that long
}
"""Typical standard deviation from trial to trial: the scale of a size's prior where the campaign gives none."""
_FLAT = 1e8  # prior variance of what has a flat prior, in its own units
ANGLES_SHARED = 0.1  # of the angle: prior sd of what repeats may be released apart from it by, all alike
_GRID = np.linspace(-5.0, 3.5, 35)  # of ln(size / typical size)
_WIDEST = 9.0  # of the same for the baseline of a single record, which may be thousands of times the noise
_FINE = np.linspace(-5.0, 3.5, 681)
SHOWN_FROM = 3.0  # nats by which the repeats' likelihood must gain from a scatter for it to be reported
SURE_OF_TREND = 0.01  # by chance, in any of the things that differ
FAR_FROM_OTHERS = 5.0  # of its own standard deviation, from which the value of one trial is odd
LEAST_FREEDOM = 3  # of a correlation: two trials each of two cases are in some order or the other
SUDDEN, WORTH_IT = 0.3, 1.0  # of the typical time of release, and nats, below both of which there is none
USUAL = (0.3, 2.5)  # range of times of release over their size, root mean square, in which they scatter about none
SLOW, SAME_WAY = 10.0, 1.5  # times the typical time of release, and of the shortest one, in which all are slow alike
ABOUT_ITS_MEAN = 1.0 - 2.0 / math.pi  # variance of half a normal distribution over its mean square
WIDENED = 2.0  # by how much a scatter that is not seen may widen an interval before it is said
NEGLIGIBLE = 0.05  # information s^2 T'T of every trial's own value, below which it is left out


def typical_scatter(problem: Problem, releases: bool = False) -> Scatter:
    """All that may scatter in a problem, at its typical size, or the size that the campaign gives.

    releases : the time of release too, which is not linear and has to be followed by a fit first.
    """
    e = problem.experiment
    coupled = any(e.trials[i].coupled for i in problem.trials)
    found: dict[str, float] = {}
    hertz: dict[str, float] = {}
    for name in RELATIVE:
        absent = name in e.ties or e.levels.get(name) == "trial" or (name in COUPLED_ONLY and not coupled)
        absent |= name in ("mu", "drag", "drag_ratio") and problem.nominal == "linear"
        absent |= name == "drag_ratio" and e.coupling_law == "cosine"  # the second link has no bearing to ground
        absent |= name == "mu" and not e.magnet
        if not absent:
            found[name] = TYPICAL[name]
    # Of a free start the gain of one channel does what its first angle does; baselines are looked for in each record.
    kinds = READINGS if e.start == "rest" else ("gain",) if coupled else ()
    for channel in range(1 + int(coupled)):
        noise = problem.noise.floor[min(channel, len(problem.noise.floor) - 1)]
        own_offset = e.offset_sd is not None or e.quantity == "displacement"
        if (mains := e.hum[channel] if "hum" in kinds else None) is not None:
            hertz[f"hum{channel + 1}"] = mains
        for kind in kinds:
            if not (kind == "offset" and own_offset) and (kind != "hum" or mains is not None):
                found[f"{kind}{channel + 1}"] = TYPICAL[kind] * (1.0 if kind == "gain" else noise)
    if releases and e.start == "rest" and "delay" not in e.levels:
        found[RELEASE] = TYPICAL[RELEASE]
    for name, size in e.scatter.items():
        for key in found:
            if key == name or (name in READINGS and key[:-1] == name):
                found[key] = size
    made = (Size(n, s, 0.0, math.inf, s, hertz=hertz.get(n, 0.0)) for n, s in found.items() if s > 0.0)
    return Scatter(tuple(made))


@dataclass(frozen=True, eq=False)
class Repeats:
    """Sums over the readings of a set of n repeats, from whitened residuals and what m own values change in them.

    names : of the m own values; gram (n, m, m) : T T' of each repeat; product (n, m) : T r, with own values at 0;
    shared (m,) : prior variances of what all of them share, by default flat.
    """

    names: tuple[str, ...]
    gram: Array
    product: Array
    shared: Array | float = _FLAT

    def log_likelihood(self, variances: Array) -> tuple[float, Array]:
        """Log likelihood of what repeats do not share, up to a constant; its derivatives by ln variances (m,).

        By the normal equations of mean and deviations: the derivative is half the sum over the repeats of
        <eta^2> / variance - 1, <eta^2> being the posterior mean square of a deviation (as in the EM algorithm).
        """
        H = self.gram + np.diag(1.0 / variances)
        inverse = np.linalg.inv(H)
        pulled = self.gram @ inverse
        S = np.sum(self.gram - pulled @ self.gram, axis=0) + np.eye(variances.size) / self.shared
        g = np.sum(self.product - np.einsum("jmn,jn->jm", pulled, self.product), axis=0)
        spread = np.linalg.inv(S)
        mean = spread @ g
        eta = np.einsum("jmn,jn->jm", inverse, self.product - self.gram @ mean)
        square = eta**2 + np.diagonal(inverse + pulled.transpose(0, 2, 1) @ spread @ pulled, axis1=1, axis2=2)
        log_det = np.linalg.slogdet(S)[1] + np.sum(np.linalg.slogdet(H)[1]) + len(H) * np.sum(np.log(variances))
        explained = float(g @ mean) + float(np.einsum("jm,jmn,jn->", self.product, inverse, self.product))
        return 0.5 * (explained - float(log_det)), 0.5 * np.sum(square / variances - 1.0, axis=0)

    def log_likelihoods(self, variances: Array) -> Array:
        """Log likelihoods alone of many rows of variances (k, m), (k,)."""
        m = variances.shape[1]
        H = self.gram + (np.eye(m) / variances[:, None])[:, None]  # (k, n, m, m)
        both = np.concatenate([self.gram, self.product[:, :, None]], axis=2)
        pulled = both.transpose(0, 2, 1) @ np.linalg.solve(H, np.broadcast_to(both, (*H.shape[:2], *both.shape[1:])))
        left = np.sum(both - pulled[:, :, :m], axis=1)
        S, g = left[:, :, :m] + np.eye(m) / self.shared, left[:, :, m]
        explained = np.einsum("km,km->k", g, np.linalg.solve(S, g[:, :, None])[:, :, 0]) + pulled[:, :, m, m].sum(
            axis=1
        )
        log_det = np.linalg.slogdet(S)[1] + np.linalg.slogdet(H)[1].sum(axis=1)
        return np.asarray(0.5 * (explained - log_det - len(self.gram) * np.log(variances).sum(axis=1)))


def learn_scatter(fit: Calibration, noise: Noise | None = None, apart: bool = False) -> Scatter:
    """Sizes of all scatters, from what the repeats of a fit do not share, under a noise (default: that of the fit).

    Where trials start free, those that swing equally far repeat each other, as releases by hand do, and show what the
    rig's parameters scatter by. Slow baselines single records show. All else that free starts leave is taken for the
    model's error (noise_level.py): springs of their own for swings that differ would take a gap that they share.

    apart : releases of other sizes have what priors say; stretches of one decay do not scatter.
    """
    problem = fit.problem if noise is None else fit.problem.with_noise(noise)
    if problem.experiment.start != "free":
        return _of_repeats(fit, problem, {i: problem.experiment.trials[i].conditions for i in problem.trials})
    swings = swinging_alike(problem.experiment, problem.trials)
    several = len(set(swings.values())) < len(swings) or (apart and released_apart(problem.experiment))
    sizes = _of_repeats(fit, problem, swings).sizes if several else ()
    return Scatter((*sizes, *_baselines(fit, problem).sizes))


def _of_repeats(fit: Calibration, problem: Problem, alike: Mapping[int, Hashable]) -> Scatter:
    """Sizes of all scatters but those of baselines of free starts; alike : trial -> the set of repeats it is one of."""
    typical = typical_scatter(problem, releases=fit.problem.switches.scatter.sd(RELEASE) > 0.0)
    wide = problem.changed(switches=replace(problem.switches, friction=False, drag=False, scatter=typical))
    linear = wide.linearise(fit.q, carried(fit, wide))
    found: dict[Hashable, list[tuple[tuple[str, ...], Array, Array, Array]]] = {}
    information: dict[str, float] = {}
    for block in linear.blocks:
        names = tuple(name for name, _, _ in block.group.nuisances)
        free = np.array([name == "delay" for name in names])
        residual = block.r - np.einsum("jmd,jm->jd", block.T, np.where(free, 0.0, block.eta))
        gram = block.T @ block.T.transpose(0, 2, 1)
        product = np.einsum("jmd,jd->jm", block.T, residual)
        for k, name in enumerate(names):
            known = gram[:, k, k]
            if name == RELEASE and free.any():  # what a later instant of release does not do as well
                known = known - gram[:, k, free][:, 0] ** 2 / np.maximum(gram[:, free, free][:, 0], 1e-300)
            information[name] = max(information.get(name, 0.0), float(np.max(known)))
        for k, i in enumerate(block.group.trials):
            found.setdefault(alike[i], []).append((names, gram[k], product[k], _shared(block.group.nuisances, k)))
    sets = [
        Repeats(rows[0][0], np.array([r[1] for r in rows]), np.array([r[2] for r in rows]), rows[0][3])
        for rows in found.values()
        if len(rows) > 1
    ]
    sizes = _posterior(sets, typical.sizes)
    times = math.sqrt(float(np.mean(np.square(times_of_release(fit) or [0.0]))))
    return Scatter(tuple(s for s in sizes if _matters(s, information, times)))


def _shared(nuisances: Sequence[Nuisance], k: int) -> Array:
    """Prior variances (m,) of what trial k shares with its repeats, in units of its nuisances: flat but for the angle.

    Angles and gains have all but the same derivatives. With twice the angle and none of the gain, what these
    derivatives differ by from trial to trial, of second order, would explain what the trials' own gains differ by.
    """
    out = np.full(len(nuisances), _FLAT)
    for m, (name, mean, sd) in enumerate(nuisances):
        if name == "theta0" and mean[k]:
            out[m] = (ANGLES_SHARED * mean[k] / sd[k]) ** 2
    return out


def _baselines(fit: Calibration, problem: Problem) -> Scatter:
    """Slow baselines that records which start free show by themselves: nothing of the rig moves so slowly.

    By the likelihood of what the residuals of each record have of its slow cosines, all else that is unknown integrated
    out; the size over a grid of its logarithm. None where something drives the rig, which may be as slow as that.
    """
    e = problem.experiment
    trials = [e.trials[i] for i in problem.trials]
    if any(t.driven for t in trials):
        return NO_SCATTER
    sizes = []
    for c in range(1 + int(any(t.coupled for t in trials))):
        name, usual = f"drift{c + 1}", TYPICAL["drift"] * problem.noise.floor[c]
        sd = e.scatter.get(name, e.scatter.get("drift", usual))
        if sd > 0.0:
            sizes.append(Size(name, sd, 0.0, math.inf, sd, waves=BASELINE_WAVES))
    wide = problem.changed(switches=replace(problem.switches, scatter=Scatter(tuple(sizes))))
    parts: dict[str, list[tuple[Array, Array]]] = {size.name: [] for size in sizes}
    linear = wide.linearise(fit.q, carried(fit, wide))
    for block in linear.blocks:
        names = [name for name, _, _ in block.group.nuisances]
        for k in range(len(block.group.trials)):
            # Residuals with every unknown at its prior's middle, by the linearised model.
            left = block.r[k] - block.eta[k] @ block.T[k] - linear.q @ block.J[k]
            for size in sizes:
                slow = np.array([name.startswith(size.name) for name in names])
                if not slow.any():
                    continue
                other = np.concatenate([block.T[k][~slow], block.J[k]])
                both = np.concatenate([block.T[k][slow], left[None]])
                fitted = np.linalg.solve(other @ other.T + np.eye(len(other)), other @ both.T)
                own = both @ both.T - (other @ both.T).T @ fitted
                parts[size.name].append((own[:-1, :-1], own[:-1, -1]))
    return Scatter(tuple(s for size in sizes if (s := _lone_size(size, parts[size.name])).gained > SHOWN_FROM))


def _lone_size(typical: Size, parts: Sequence[tuple[Array, Array]]) -> Size:
    """Posterior of a size from records that share nothing: of each, gram (w, w) of its waves, and their product with r.

    For waves x ~ N(0, s^2): 2 log L = b' (A + 1/s^2)^-1 b - log |1 + s^2 A|.
    """
    u = np.arange(_GRID[0], _WIDEST, 0.05)
    gained = np.zeros(u.size)
    for gram, product in parts:
        value, vector = np.linalg.eigh(gram)
        value, square = np.maximum(value, 0.0), (vector.T @ product) ** 2
        loud = np.exp(2.0 * u)[:, None]
        gained += 0.5 * np.sum(square * loud / (1.0 + loud * value) - np.log1p(loud * value), axis=1)
    share = np.exp((logs := gained + log_prior(u)) - logs.max())
    share /= share.sum()
    sd = math.sqrt(float(share @ np.exp(2.0 * u)))
    low, high = (float(np.exp(np.interp(x, np.cumsum(share), u))) for x in (0.05, 0.95))
    t = typical.typical
    return replace(typical, sd=t * sd, low=t * low, high=t * high, gained=float(gained[np.argmax(logs)] - gained[0]))


def times_of_release(fit: Calibration) -> list[float]:
    """That of each trial, s; empty where the fit has none."""
    return own_values(fit, RELEASE)


def slow_alike(fit: Calibration) -> bool:
    """Whether all trials are released in about the same time, which is long for a latch."""
    times = times_of_release(fit)
    return bool(times) and min(times) > SLOW * TYPICAL[RELEASE] and max(times) < SAME_WAY * min(times)


def own_values(fit: Calibration, nuisance: str) -> list[float]:
    """The value of a nuisance in each trial, in its unit; empty where the fit has none."""
    return [
        float(mean[k] + sd[k] * fit.eta[i][m])
        for group in fit.problem.groups
        for m, (name, mean, sd) in enumerate(group.nuisances)
        for k, i in enumerate(group.trials)
        if name == nuisance
    ]


def placed(problem: Problem, eta: Mapping[int, Array], nuisance: str, value: float) -> dict[int, Array]:
    """Nuisances with one of them at the same value in all trials, as far as its range allows."""
    out = dict(eta)
    for group in problem.groups:
        for m, (name, mean, sd) in enumerate(group.nuisances):
            for k, i in enumerate(group.trials if name == nuisance else ()):
                at = np.clip((value - mean[k]) / sd[k], group.lower[k, m], group.upper[k, m])
                out[i] = np.where(np.arange(out[i].size) == m, at, out[i])
    return out


def with_releases(problem: Problem, scatter: Scatter) -> Scatter:
    """The sizes with that of the time of release, at what its prior says, where trials are released and repeat.

    Without repeats it would be taken for a lag of sensors, or the other way round, as the prior has it.
    """
    return scatter if lone(problem.experiment, problem.trials) else _released(problem, scatter)


def _released(problem: Problem, scatter: Scatter) -> Scatter:
    added = tuple(s for s in typical_scatter(problem, releases=True).sizes if s.name == RELEASE)
    others = tuple(s for s in scatter.sizes if s.name != RELEASE)
    return Scatter((*others, *_posterior((), added)))


def usual_releases(problem: Problem) -> Problem:
    """The same problem with a time of release of each trial's own, of the size that its prior says."""
    return problem.changed(switches=replace(problem.switches, scatter=_released(problem, problem.switches.scatter)))


def _matters(size: Size, information: Mapping[str, float], times: float) -> bool:
    """Whether a size is kept; times : root mean square of the fit's times of release.

    Small ones are, where the times are neither all none nor all the same: the gain is that of the linearised problem,
    in which an instant of each trial's own makes up for a release that has no time.
    """
    small = size.name == RELEASE and size.sd < SUDDEN * size.typical and size.gained < WORTH_IT
    if small and not USUAL[0] * size.sd < times < USUAL[1] * size.sd:
        return False
    return any((size.sd / size.typical) ** 2 * information.get(name, 0.0) > NEGLIGIBLE for name, _ in size.columns)


def carried(fit: Calibration, problem: Problem) -> dict[int, Array]:
    """Nuisances of a fit for the same trials of another problem: the same values where both have them."""
    known = {
        i: {name: float(mean[k] + sd[k] * fit.eta[i][m]) for m, (name, mean, sd) in enumerate(group.nuisances)}
        for group in fit.problem.groups
        for k, i in enumerate(group.trials)
    }
    out = {}
    for group in problem.groups:
        for k, i in enumerate(group.trials):
            value = [
                (known[i][name] - float(mean[k])) / float(sd[k]) if name in known[i] else middle_of(name)
                for name, mean, sd in group.nuisances
            ]
            out[i] = np.clip(np.array(value), group.lower[k], group.upper[k])
    return out


def _posterior(sets: Sequence[Repeats], typical: Sequence[Size]) -> tuple[Size, ...]:
    """Posterior of each size: the others at the posterior mode, its own over a grid of its logarithm."""
    which = {name: k for k, size in enumerate(typical) for name, _ in size.columns}
    placed = [np.array([which.get(name, -1) for name in s.names]) for s in sets]
    fixed = [np.array([{"delay": _FLAT, RELEASE: ABOUT_ITS_MEAN}.get(name, 1.0) for name in s.names]) for s in sets]

    def variances(u: Array, place: NDArray[np.intp], start: Array) -> Array:
        return np.asarray(start * np.where(place >= 0, np.exp(2.0 * u)[..., place], 1.0))

    def log_density(u: Array) -> tuple[float, Array]:
        value, slope = float(np.sum(log_prior(u))), prior_slope(u)
        for s, place, start in zip(sets, placed, fixed, strict=True):
            gain, by_log = s.log_likelihood(variances(u, place, start))
            value += gain
            np.add.at(slope, place[place >= 0], 2.0 * by_log[place >= 0])
        return value, slope

    begin: Array = np.zeros(len(typical))
    bounds = [(float(_GRID[0]), float(_GRID[-1]))] * len(typical)
    found = begin
    if sets and len(typical):
        found = minimize(
            lambda u: tuple(-x for x in log_density(u)), begin, jac=True, method="L-BFGS-B", bounds=bounds
        ).x
    out = []
    for k, size in enumerate(typical):
        line = np.tile(found, (_GRID.size, 1))
        line[:, k] = _GRID
        logs = log_prior(_GRID)
        for s, place, start in zip(sets, placed, fixed, strict=True):
            if k in place:
                logs = logs + s.log_likelihoods(variances(line, place, start))
        likelihood = logs - log_prior(_GRID)
        out.append(_from_grid(size, logs, float(likelihood[np.argmax(logs)] - likelihood[0])))
    return tuple(out)


def _from_grid(size: Size, logs: Array, gained: float) -> Size:
    """A size whose log density is known at `_GRID`."""
    smooth = CubicSpline(_GRID, logs)(_FINE)
    share = np.exp(smooth - smooth.max())
    share /= share.sum()
    low, high = _shortest(share)
    t = size.typical
    sd = t * math.sqrt(float(share @ np.exp(2.0 * _FINE)))
    return replace(size, sd=sd, low=t * low, high=t * high, gained=gained, middle=t * _of_intervals(share))


def _of_intervals(share: Array) -> float:
    """The size, in typical ones, of a normal distribution with the central 90 % of own values whose size is not known.

    share : probability of the sizes on the fine grid. Few trials leave a size long tails, as of Student's t: the root
    of the mean square lies far out in them, and intervals made from it would be several times too wide.
    """
    end = float(ndtri(0.95))
    return math.exp(brentq(lambda u: share @ ndtr(end * np.exp(u - _FINE)) - 0.95, _FINE[0] - 1.0, _FINE[-1] + 1.0))


def with_sizes_of_intervals(fit: Calibration) -> Calibration:
    """The fit with sizes of scatters that give intervals the width that they have over all likely sizes.

    Those of a calibration are roots of mean squares, so that evidences, which sum squares, accuse nobody in haste. What
    a single trial has of its own is what is fitted: its parameters are those of that trial.
    """
    sizes = fit.problem.switches.scatter.sizes
    if len(fit.problem.trials) == 1:
        sizes = tuple(s for s in sizes if s.name not in RELATIVE)
    elif (
        sizes
        and lone(fit.problem.experiment, fit.problem.trials)
        and all(s.sd < s.typical * math.exp(LARGEST) for s in sizes)
    ):
        # What repeats among them show stays; of the rest all trials together say more than each set of repeats.
        together = zip(sizes, without_repeats(fit).sizes, strict=True)
        sizes = tuple(s if s.gained > SHOWN_FROM else replace(all_of, gained=s.gained) for s, all_of in together)
    narrow = Scatter(tuple(replace(s, sd=min(s.middle, s.sd)) if s.middle > 0.0 else s for s in sizes))
    return fit if narrow == fit.problem.switches.scatter else with_scatter(fit, narrow)


def with_scatter(fit: Calibration, scatter: Scatter, noise: Noise | None = None) -> Calibration:
    """The fit with these sizes of scatters, under a noise (default: that of the fit)."""
    switches = replace(fit.problem.switches, scatter=scatter)
    problem = fit.problem.changed(noise=noise or fit.problem.noise, switches=switches)
    return calibrate(problem, [fit.q], eta=carried(fit, problem), anneal=False)


def likeliest_sizes(fit: Calibration) -> Scatter:
    """Sizes that trials without repeats make likeliest together, under the fit's noise."""
    scatter = fit.problem.switches.scatter
    mode = Unlearnt.of(fit.problem, fit.linear.normal()).mode()
    sds = {s.name: s.typical * math.exp(u) for s, u in zip(scatter.from_trial_to_trial, mode, strict=True)}
    return Scatter(tuple(replace(s, sd=sds.get(s.name, s.sd)) for s in scatter.sizes))


def without_repeats(fit: Calibration) -> Scatter:
    """Sizes that trials without repeats make likely, each with the others at the mode, under the fit's noise.

    What they share and the model lacks may be in them, too: they show no scatter, and `gained` is 0.
    """
    own = Unlearnt.of(fit.problem, fit.linear.normal())
    mode = own.mode()
    scatter = fit.problem.switches.scatter
    found = {}
    for k, size in enumerate(scatter.from_trial_to_trial):
        lines = np.tile(mode, (_GRID.size, 1))
        lines[:, k] = _GRID
        found[size.name] = _from_grid(size, log_prior(_GRID) + [own.log_evidence(u)[0] for u in lines], 0.0)
    return Scatter(tuple(found.get(size.name, size) for size in scatter.sizes))


def _shortest(share: Array, of: float = 0.9) -> tuple[float, float]:
    """The shortest interval of the size, in typical ones, that holds so much of the probability on the grid."""
    sizes = np.exp(_FINE)
    total = np.concatenate([[0.0], np.cumsum(share)])
    best = (0.0, float(sizes[-1]))
    for first in range(share.size):
        last = int(np.searchsorted(total, total[first] + of - 1e-12))
        if last > share.size:
            break
        low = 0.0 if first == 0 else float(sizes[first])
        high = float(sizes[min(last, share.size) - 1])
        if high - low < best[1] - best[0]:
            best = (low, high)
    return best


# What is reported of it ----------------------------------------------------------------------------------------------


def scatter_shown(fit: Calibration, unit: str, missing: bool = False) -> dict[str, ScatterEntry]:
    """Entry `scatter` of the results: what the repeats show to differ from trial to trial; unit : of the readings.

    trend_with_order : correlation, from -1 to 1, of the trials' own values with their order among repeats; missing :
    whether the model lacks a cause that nobody can name. It may differ from trial to trial too, or act differently in
    swings that differ, and be all there is of a scatter: no interval then excludes 0.
    """
    return {
        size.name: {
            "sd": size.sd,
            "unit": "s" if size.name == RELEASE else "relative" if _in_proportion(size.name) else unit,
            "hdi90": [0.0 if missing else size.low, size.high],
            "trend_with_order": trend_with_order(fit, size)[0],
        }
        for size in sizes_shown(fit)
    }


def _in_proportion(name: str) -> bool:
    return name in RELATIVE or name.startswith("gain")


def trend_with_order(fit: Calibration, size: Size) -> tuple[float, float]:
    """Correlation of the trials' own values with their order among the repeats, and the p-value of none.

    It is 1 where too few trials are repeated to show any. A trend that the model has (trends.py) is a part of them.
    """
    column = size.columns[0][0]
    values, order, sets = [], [], 0
    trials = fit.problem.experiment.trials
    trend = change_over_campaign(fit, size.name)
    for group in fit.problem.groups:
        names = [name for name, _, _ in group.nuisances]
        if column not in names:
            continue
        m = names.index(column)
        sd = group.nuisances[m][2]
        own = np.array([trend * trials[i].order + sd[k] * fit.eta[i][m] for k, i in enumerate(group.trials)])
        for members in repeats([trials[i] for i in group.trials]):
            number = np.array([float(trials[group.trials[k]].number) for k in members])
            values += list(own[members] - own[members].mean())
            order += list(number - number.mean())
            sets += 1
    x, y = np.array(order), np.array(values)
    freedom = x.size - sets - 1
    both = float(np.sum(x * x) * np.sum(y * y))
    if freedom < 1 or both <= 0.0:
        return 0.0, 1.0
    r = float(np.clip(x @ y / math.sqrt(both), -1.0, 1.0))
    if freedom < LEAST_FREEDOM:
        return r, 1.0
    return r, float(2.0 * stdtr(freedom, -abs(r) * math.sqrt(freedom / max(1.0 - r * r, 1e-12))))


def change_over_campaign(fit: Calibration, name: str) -> float:
    """Logarithm of the last trial's value of a parameter over the first one's, 0 where the model has no trend of it."""
    return fit.parameters[TREND + name][0] if TREND + name in fit.problem.names else 0.0


def odd_values(fit: Calibration) -> list[tuple[int, str, float]]:
    """Trials of which one own value is far from that of all others: trial, parameter, and by what share it differs.

    Judged as one more draw of a normal distribution of which the others are a sample, all trials and parameters being
    looked at; and against what is known of that value from its own trial.
    """
    looked_at = {nuisance(name) for name in RELATIVE}
    known: dict[str, dict[int, tuple[float, float]]] = {}
    for block, H, _, _ in fit.linear.normal().parts:
        spreads = np.sqrt(np.linalg.inv(H).diagonal(axis1=1, axis2=2))
        for n, (name, _, sd) in enumerate(block.group.nuisances):
            if name not in looked_at:
                continue
            for k, i in enumerate(block.group.trials):
                known.setdefault(name, {})[i] = (float(sd[k] * block.eta[k, n]), float(sd[k] * spreads[k, n]))
    out = []
    looks = sum(map(len, known.values()))
    for name, values in known.items():
        for i, (value, spread) in values.items():
            others = np.array([v for j, (v, _) in values.items() if j != i])
            if others.size < LEAST_FREEDOM + 1:
                continue
            away = value - float(others.mean())
            chance = float(np.std(others, ddof=1)) * math.sqrt(1.0 + 1.0 / others.size)
            sure = looks * 2.0 * stdtr(others.size - 1, -abs(away) / max(chance, 1e-12)) < SURE_OF_TREND
            if sure and abs(away) > FAR_FROM_OTHERS * spread:
                out.append((i, name.removeprefix("ln_"), math.expm1(away)))
    return out


def odd_values_in_words(fit: Calibration) -> list[str]:
    """A sentence on each trial of which one own value is far from that of all others."""
    out = []
    for i, name, share in odd_values(fit):
        label, side = fit.problem.experiment.trials[i].label, "above" if share > 0.0 else "below"
        out.append(
            f"{label}: its {name} is {100.0 * abs(share):.2g} % {side} that of the other trials, which are far closer "
            "to each other. The fit allows for it; look at how that trial was run."
        )
    return out


def sizes_shown(fit: Calibration) -> list[Size]:
    """What the repeats show to scatter, of all that a fit allows for.

    The sizes were learnt under the nominal model. With an effect in the model they are judged again: where repeats
    swing differently far, what the effect does differs between them, and may be all there is of a scatter.
    """
    sizes = fit.problem.switches.scatter.sizes
    if fit.problem.effect is not None:
        if fit not in _AGAIN:
            _AGAIN[fit] = {s.name: s for s in learn_scatter(fit).sizes}
        sizes = tuple(_AGAIN[fit][s.name] for s in sizes if s.name in _AGAIN[fit])
    return [_about_trend(fit, s) for s in sizes if s.gained > SHOWN_FROM or TREND + s.name in fit.problem.names]


def _about_trend(fit: Calibration, size: Size) -> Size:
    """The size with what a trend of the model adds to it over all trials."""
    if TREND + size.name not in fit.problem.names:
        return size
    spread = float(np.std([fit.problem.experiment.trials[i].order for i in fit.problem.trials]))
    ends = fit.interval(TREND + size.name)
    low, high = (0.0 if ends[0] < 0.0 < ends[1] else min(map(abs, ends))), max(map(abs, ends))
    sd = math.hypot(size.sd, spread * change_over_campaign(fit, size.name))
    return replace(size, sd=sd, low=math.hypot(size.low, spread * low), high=math.hypot(size.high, spread * high))


_AGAIN: WeakKeyDictionary[Calibration, dict[str, Size]] = WeakKeyDictionary()
"""Sizes judged again, of each fit with an effect: sentences and tables ask for the same."""


def scatter_in_words(fit: Calibration) -> list[str]:
    """Sentences on what the repeats show to differ from trial to trial, and on baselines that wander."""
    trials = [fit.problem.experiment.trials[i] for i in fit.problem.trials]
    shown = sizes_shown(fit)
    out = []
    for size in shown if fit.problem.experiment.start == "free" else ():
        if size.name.startswith("drift"):
            c = int(size.name[-1]) - 1
            reach = max(float(np.nanmax(np.abs(t.y[c]))) for t in trials if c < len(t.y))
            out.append(
                f"The zero of channel {c + 1} drifts slowly, by about {100.0 * size.sd / reach:.2g} % of its largest "
                "reading. The fit allows for it; no cause is named, since a rig seldom moves so slowly. If something "
                "may, a clamp that gives way say, declare `drift = 0` under [scatter]."
            )
    for size in shown:
        if size.name.startswith("hum"):
            hum = math.sqrt(2.0) * size.sd / fit.problem.noise.floor[int(size.name[-1]) - 1]
            out.append(
                f"Channel {size.name[-1]} picks up the mains: {size.hertz:.4g} Hz, {float(f'{hum:.2g}'):g} times "
                "its noise (rms), with another phase in each trial. The fit allows for it; no cause is named for it."
            )
    relative = [s for s in shown if s.name in RELATIVE or s.name.startswith("gain")]
    if relative:
        listed = ", ".join(f"{s.name} (by {float(f'{100.0 * s.sd:.2g}'):g} %)" for s in relative)
        out.append(
            f"Differs from trial to trial: {listed}. The fit allows each trial its own value; no cause is named for it."
        )
    if slow_alike(fit):
        times = 1e3 * np.array(times_of_release(fit))
        out.append(
            f"The trials are released over {times.min():.3g} to {times.max():.3g} ms, which is long for a latch "
            f"({1e3 * TYPICAL[RELEASE]:g} ms is typical). The fit allows each trial its own time, and no cause "
            "is named for it: look at what lets go of the rig."
        )
    for size in shown:
        r, p = (0.0, 1.0) if size.name.startswith("hum") else trend_with_order(fit, size)
        if change := 100.0 * math.expm1(change_over_campaign(fit, size.name)):
            out.append(
                f"{size.name} {'grows' if change > 0.0 else 'falls'} by {abs(change):.2g} % from the first trial of "
                "trials.csv to the last: repeats show it, and cases follow. Something warms up or wears; the fit "
                "allows for it, and no cause is named for it."
            )
        elif p < SURE_OF_TREND / len(shown):
            out.append(
                f"{size.name} {'grows' if r > 0.0 else 'falls'} from repeat to repeat "
                f"(correlation {r:+.2f}): something warms up or wears."
            )
    return out


def unseen_in_words(fit: Calibration) -> list[str]:
    """A sentence where intervals are wide for scatters of the rig that these trials do not show, and may have."""
    if len(fit.problem.trials) == 1:
        return ["There is one trial: parameters and intervals are those of that trial, and another may differ."]
    sizes = fit.problem.switches.scatter.sizes
    unseen = [s for s in sizes if s.name in RELATIVE and s.gained <= SHOWN_FROM]
    if not unseen:
        return []
    without = with_scatter(fit, Scatter(tuple(s for s in sizes if s not in unseen)))
    ratios = np.sqrt(np.diag(fit.covariance) / np.diag(without.covariance))
    named = zip(fit.problem.names, ratios, strict=True)
    wide = [f"{name} ({ratio:.2g} times)" for name, ratio in named if ratio > WIDENED]
    if not wide:
        return []
    listed = ", ".join(wide[:-1]) + (" and " if wide[1:] else "") + wide[-1]
    said = (
        "Intervals are wider than noise alone makes them, because trials may differ by more than these show: "
        f"{listed}. If you know that nothing differs from trial to trial, set it in `[scatter]` of campaign.toml: "
        f"{', '.join(f'{s.name} = 0' for s in unseen)}."
    )
    return [said]
