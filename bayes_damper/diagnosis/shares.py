"""Which share of the gap a model closes, measured on trials that it was not fitted to, without a floor of noise.

A sum of squared residuals holds the noise as well as the gap, and where the gap is faint their difference is lost. A
product of two residuals whose noises are independent holds the gap alone: where g is what a model leaves in both and e,
e' is the noise, the mean of (g + e)(g + e') is g^2, whatever the noise. So each held-out residual is multiplied with

- the mean residual of the trials that repeat it (those that were fitted, or else the other held-out ones);
- without repeats its own neighbour in time, where the sensors' noise is white and the gap is slow. What follows the
  noise of a measured input takes slow noise of the sensors with it, so that neighbours of pure noise have products
  below 0: those are expected, and added (`_taken_up`).

With X the sum of such products over the noise's variance, before (0) and after (1), the share closed is 1 - X1 / X0.
To each X comes what the model misses because the fitted trials' noise moved its parameters: a miss like any other, of
which a product with a residual that the same fit has made small knows nothing. With C their covariance and J the
derivatives of held-out readings, the trials' own values following, products lack trace(J C J').
Every reading counts with its weight in the fit, those at the release and at reversals too. But a product over all
frequencies has the noise of all of them, hundreds of times the squared gap of a faint one that lies, as torques do, at
the slow ones. So the part of products of repeats above that band counts only where it shows. The interval comes from
blocks of the records drawn again with replacement. Where 5 % of the draws have no gap left in X0, no share can be
given. A model's readings are never their own judge: parameters are fitted to training trials, and held-out ones have
only their own nuisances fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from bayes_damper.calibration import Calibration, Group, Noise, predict, unseeing
from bayes_damper.calibration.experiment import repeats_by_reading
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.own_values import INPUT
from bayes_damper.diagnosis.remainder import LOW_BAND, own_frequency
from bayes_damper.runs.contents.diagnosis import Share
from bayes_damper.text import NOTHING_HELD_OUT

Array = NDArray[np.float64]
Method = Literal["repeats", "neighbours", "cannot tell"]

DRAWS = 2000
DOUBT = 0.05  # share of draws without a gap from which no share of it is given
SURE = 3.0  # standard deviations of noise from which the part above the band of the rig's motion counts
BLOCKS = 6  # of a record without repeats: what its model misses is alike over long stretches
IN_WORDS = {
    "repeats": "from what held-out trials and their repeats leave in common, which noise does not",
    "neighbours": "from what neighbouring readings of held-out trials leave in common, which sensor noise does not",
    "cannot tell": "on the held-out trials the gap is too faint to say which share of it anything closes",
}


@dataclass(frozen=True)
class Closed:
    """Share of the gap that an answer closes, over held-out trials: value and 90 % interval, None where none shows."""

    median: float | None
    hdi90: tuple[float, float] | None
    method: Method
    tested: bool = True
    """Whether any trial is held out."""

    @property
    def how(self) -> str:
        """How it was measured, in words."""
        return IN_WORDS[self.method] if self.tested else NOTHING_HELD_OUT

    def to_json(self) -> Share:
        """Plain numbers, and the method in words."""
        interval = None if self.hdi90 is None else list(self.hdi90)
        return {"median": self.median, "hdi90": interval, "method": self.method, "how": self.how}


NO_SHARE = Closed(None, None, "cannot tell")
UNTESTED = Closed(None, None, "cannot tell", tested=False)


@dataclass(frozen=True, eq=False)
class Products:
    """Squared gap that each of several models leaves, in blocks of the held-out trials.

    values (models, blocks): sums of products over the noise's variance; draws (DRAWS, models): the same with blocks
    drawn again, summed; method: how they were made; moved (models,): what errors of the parameters add to each.
    """

    values: Array
    draws: Array
    method: Method
    moved: Array | float = 0.0

    @property
    def total(self) -> Array:
        """Over all blocks, (models,)."""
        return np.asarray(self.values.sum(axis=1))

    def is_known(self, before: int = 0) -> bool:
        """Whether what model `before` leaves is a gap of which shares can be given."""
        return self.total[before] > 0.0 and float(np.mean(self.draws[:, before] <= 0.0)) < DOUBT

    def shares(self, before: int = 0) -> tuple[Array, Array]:
        """Share of the gap of model `before` that each model leaves, (models,), and draws of it, (draws, models)."""
        total, draws = self.total + self.moved, self.draws + self.moved
        draws = draws[draws[:, before] > DOUBT * total[before]]
        return total / total[before], draws / draws[:, before][:, None]

    def closed(self, after: int, before: int = 0) -> Closed:
        """Share of the gap of model `before` that model `after` closes."""
        if not self.is_known(before):
            return NO_SHARE
        left, draws = self.shares(before)
        return Closed(float(1.0 - left[after]), shortest_interval(np.sort(1.0 - draws[:, after])), self.method)


def products_of(
    fits: Sequence[Calibration], heldout: Sequence[int], rng: np.random.Generator | None = None
) -> Products:  # fmt: skip
    """Products of residuals of the held-out trials under each of the fits of one experiment, the nominal one first."""
    residuals, moved = [], []
    fits = [unseeing(fit) for fit in fits]
    for fit in fits:
        inside = set(fit.problem.trials)
        predicted = predict(fit, heldout)
        found = {i: p.residual for i, p in predicted.items()}
        residuals.append(({i: r for i, r in fit.residuals().items() if i in inside}, found))
        moved.append(moved_by_noise(fit, {i: p.eta for i, p in predicted.items()}))
    judged = products(fits[0], heldout, residuals, rng)
    return replace(judged, moved=np.array(moved)) if judged.method == "repeats" else judged


def moved_by_noise(fit: Calibration, eta: Mapping[int, Array]) -> float:
    """Expected square of what errors of a fit's parameters change in its predictions of held-out trials, over noise.

    eta : trial -> (m,), the held-out trials' own values, which give way.
    """
    floor = fit.problem.noise.floor
    none = (0.0,) * len(floor)
    problem = fit.problem.changed(noise=Noise(floor, none, none), trials=tuple(eta))
    names = [name for name in problem.names if name in fit.problem.names]
    own, known = ([p.names.index(name) for name in names] for p in (problem, fit.problem))
    q = problem.prior_mean()
    q[own] = fit.q[known]
    total = 0.0
    for block in problem.linearise(q, eta).blocks:
        J, T = block.J[:, own], block.T
        H = np.eye(T.shape[1]) + T @ T.transpose(0, 2, 1)
        J = J - (J @ T.transpose(0, 2, 1)) @ np.linalg.solve(H, T)
        total += float(np.einsum("jpd,jqd,pq->", J, J, fit.covariance[np.ix_(known, known)], optimize=True))
    return total if math.isfinite(total) else 0.0


def products(
    fit: Calibration,
    heldout: Sequence[int],
    residuals: Sequence[tuple[Mapping[int, Array], Mapping[int, Array]]],
    rng: np.random.Generator | None = None,
) -> Products:
    """The same from residuals of several models, fitted and held out: trial -> (channels, n) each.

    fit : whose noise and weights are used; rng : draws the blocks (default: seed 0).
    """
    rng = np.random.default_rng(0) if rng is None else rng
    problem = fit.problem
    trials = problem.experiment.trials
    groups = problem.grouped(tuple(heldout))
    weights = trust_of(groups)
    fitted_by_all = [j for j in problem.trials if all(j in fitted for fitted, _ in residuals)]
    alike = {i: s for s in repeats_by_reading(problem.experiment, [*fitted_by_all, *heldout]) for i in s}
    partners = {i: [j for j in alike[i] if j in fitted_by_all] for i in heldout}
    spare = {i: [j for j in alike[i] if j in heldout and j != i] for i in heldout}
    repeated = all(partners[i] or spare[i] for i in heldout)
    sds = np.array(problem.noise.floor)
    taken_up = {} if repeated else {i: _taken_up(g, k, sds) for g in groups for k, i in enumerate(g.trials)}
    own = own_frequency(problem.experiment)
    period = 1.0 / own
    columns: list[list[list[float]]] = []
    noise = 0.0  # variance of the sum of all products of noise
    for i in heldout:
        noise += float(np.sum(weights[i] ** 4)) / max(len(partners[i] or spare[i]), 1)
        t = trials[i].times
        span = float(t[-1] - t[0])
        count = max(1, math.ceil(span / period)) if repeated else BLOCKS
        block = np.minimum((count * (t - t[0]) / max(span, 1e-300)).astype(int), count - 1)
        rows = []
        for fitted, held in residuals:
            r = held[i] * weights[i] / sds[: held[i].shape[0], None]
            slow = np.zeros_like(r)
            if repeated:
                others = [fitted[j] for j in partners[i]] or [held[j] for j in spare[i]]
                other = np.mean(others, axis=0) * weights[i] / sds[: r.shape[0], None]
                both = r * other
                slow = _slow(r, t, LOW_BAND * own) * _slow(other, t, LOW_BAND * own)
            else:
                both = np.zeros_like(r)
                both[:, :-1] = r[:, :-1] * r[:, 1:] + taken_up[i]
            parts = (slow, np.nan_to_num(both) - slow)
            rows.append([np.bincount(block, part.sum(axis=0), count) for part in parts])
        columns += np.array(rows).transpose(2, 1, 0).tolist()
    slow, fast = np.array(columns).transpose(1, 2, 0)  # (models, blocks)
    picked = rng.multinomial(slow.shape[1], np.full(slow.shape[1], 1.0 / slow.shape[1]), DRAWS)
    method: Method = "repeats" if repeated else "neighbours"
    shown = not repeated or bool(np.any(fast.sum(axis=1) > SURE * math.sqrt(noise)))
    values = slow + fast if shown else slow
    return Products(values, picked @ values.T, method)


def _slow(r: Array, times: Array, band: float) -> Array:
    """Residuals (channels, n) at frequencies below `band` in Hz: of cosines over the readings those that may be."""
    r = np.nan_to_num(r)
    n = times.size
    waves = dct(r, axis=1, norm="ortho")
    waves[:, math.ceil(2.0 * band * n * float(np.max(np.diff(times), initial=0.0))) :] = 0.0
    return np.asarray(idct(waves, axis=1, norm="ortho"))


def _taken_up(group: Group, k: int, sds: Array) -> Array:
    """What products of a trial's neighbouring residuals lack by what follows its inputs' noise, (channels, n - 1).

    Of residuals with covariance 1 + U U', U U' that of the inputs' noise, the part that is not followed has the
    covariance (1 + U U')^-1 = 1 - U (1 + U'U)^-1 U'.
    """
    names = [name for name, _, _ in group.nuisances if name.startswith(INPUT)]
    if not names:
        return np.zeros((group.y.shape[1], group.times.size - 1))
    U = np.stack([group.shape(name) for name in names]) * group.weight[k] / sds[: group.y.shape[1], None]
    flat = U.reshape(len(names), -1)
    followed = np.tensordot(np.linalg.inv(np.eye(len(names)) + flat @ flat.T), U, 1)
    return np.asarray(np.sum(U[:, :, :-1] * followed[:, :, 1:], axis=0))


def shortest_interval(draws: Array) -> tuple[float, float]:
    """The shortest interval that holds 90 % of sorted draws."""
    inside = max(1, math.ceil(0.9 * draws.size) - 1)
    widths = draws[inside:] - draws[: draws.size - inside]
    k = int(np.argmin(widths))
    return float(draws[k]), float(draws[k + inside])
