"""Is there a gap, how large is it, and how much of it does an answer close: on trials that no fit has used.

The test. Training trials predict what the model leaves on a held-out trial: the mean residual of its repeats, and the
generic shapes of the site map or the records of a rival model. None of them has seen the held-out noise, so without a
gap the product of such a prediction with the held-out residuals, both cleared of everything that parameters and the
trial's own nuisances can do, is a standard Gaussian once divided by the prediction's length: a test of exact size,
whatever was tried on the training trials. Chi-square alone would have to know the noise to a fraction of a per cent.

Trials are what is independent, not readings: whatever differs from trial to trial and has no place in the model adds to
the product's variance. So the length is taken from what the training trials' repeats do not share along the same
prediction, beside what the noise model says, which counts as six such contrasts; the p-value is Student's t with the
degrees of freedom of both. Where no training trial has a repeat, the products of the held-out trials themselves show
how they vary.

Without repeats what is left of a trial counts as noise, and it is correlated: the product's variance takes in the
correlation of residuals. As in a t-test these are what the fuller model leaves, the one that made the prediction: what
the nominal one leaves holds the gap itself. On the trials that were fitted they may be too small, on held-out ones not,
since a prediction of something that is not there only adds to them; the larger variance of the two counts. How much of
the gap an answer closes: shares.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.special import ndtr, stdtr

from bayes_damper.calibration import (
    Calibration,
    Experiment,
    Group,
    Noise,
    Prediction,
    Problem,
    calibrate,
    error_level,
    learn_noise,
    predict,
    under,
    unseeing,
    with_sizes_of_its_own,
)
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.own_values import RELEASE
from bayes_damper.diagnosis.remainder import own_frequency
from bayes_damper.diagnosis.response import on_trials
from bayes_damper.diagnosis.shares import Closed, products
from bayes_damper.runs.contents.diagnosis import GapEntry, ShiftEntry
from bayes_damper.text import p_value as words_of_p
from bayes_damper.text import two_digits

Array = NDArray[np.float64]

SIZE = 0.05
NEGLIGIBLE = 0.25  # of the noise sd: a gap below it adds 3 % to the residuals
FAR = 2.0  # times the noise: residuals beyond it are seen, whatever they are
KEPT_WEIGHT = 0.5  # readings that a fit trusts less (release, friction reversals) are left out of sums of squares
BELIEVED = 6.0  # degrees of freedom that the noise model counts as, beside what repeats do not share
FEWEST_TRIALS = 4  # held out, from which they show how they vary
OUT_OF_REACH = 5.0  # standard deviations from which own values of fitted and held-out trials are no scatter
_CORRELATED_SHARE = 6  # of a record: the longest lag of which its residuals give a correlation
_SLOW = 10.0  # times the rig's own frequency: torques on inertias show below


@dataclass(frozen=True)
class Gap:
    """The gap on held-out trials. rms in the unit of the readings; closed and augmented_rms None without an answer.

    upper_rms: 95 % upper limit of the gap's rms, in units of the noise sd. why: one sentence. taken_up: own values of
    trials that may take a gap up, so that this test cannot show it: name -> standard deviations from what is declared.
    """

    answer: Literal["none", "gap", "cannot tell"]
    p_value: float
    size: float
    noise_rms: float
    nominal_rms: float
    augmented_rms: float | None
    closed: Closed | None
    upper_rms: float
    why: str
    taken_up: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> GapEntry:
        """The `gap` entry of diagnosis.json."""
        return {
            "answer": self.answer, "p_value": self.p_value, "size": self.size, "noise_rms": self.noise_rms,
            "nominal_rms": self.nominal_rms, "augmented_rms": self.augmented_rms,
            "closed": None if self.closed is None else self.closed.to_json(),
            "upper_rms_over_noise": self.upper_rms if math.isfinite(self.upper_rms) else None, "why": self.why,
            "taken_up": dict(self.taken_up),
        }  # fmt: skip


@dataclass(frozen=True)
class Shift:
    """A parameter before and after an effect was added; sigmas: the move in standard deviations of the value after."""

    name: str
    before: tuple[float, float]
    after: tuple[float, float]
    sigmas: float

    def to_json(self) -> ShiftEntry:
        """Plain numbers."""
        return {
            "before": {"value": self.before[0], "sd": self.before[1]},
            "after": {"value": self.after[0], "sd": self.after[1]}, "shift_sigmas": self.sigmas,
        }  # fmt: skip


def measure_gap(
    nominal: Calibration,
    winner: Calibration | None = None,
    *,
    rng: np.random.Generator | None = None,
    chosen_from: int = 1,
) -> Gap:
    """The gap of the nominal model on held-out trials, and what is left of it under the winner.

    Predictions of what is missing come from the repeats and the winner. `rng` draws the bootstrap (default: seed 0).
    chosen_from : number of answers from which the held-out readings helped to choose the winner; 1 if they did not.
    """
    nominal = unseeing(nominal)
    winner = None if winner is None else unseeing(winner)
    experiment = nominal.problem.experiment
    heldout = experiment.heldout
    noise = nominal.problem.noise.floor
    if not heldout:
        rms = _rms(nominal.residuals(), nominal.problem, nominal.problem.trials)
        floor = _floor_rms(nominal.problem, nominal.problem.trials)
        added = None if winner is None else _rms(winner.residuals(), nominal.problem, nominal.problem.trials)
        return Gap(
            "cannot tell", 1.0, SIZE, floor, rms, added, None, math.inf,
            "no trial is held out: every case has a single trial; repeat at least one",
        )  # fmt: skip
    before = predict(nominal, heldout)
    after = None if winner is None else predict(winner, heldout)
    p_value = _tested(nominal, winner, before, after, chosen_from)
    masks = _masks(nominal.problem, heldout)
    x0 = _squares({i: before[i].residual for i in heldout}, masks, noise)
    count = np.array([sum(m.sum() for m in masks[i]) for i in heldout], float)
    upper = _upper_limit(float(x0.sum()), float(count.sum()), noise_spread(nominal.problem))
    nominal_rms = _rms({i: before[i].residual for i in heldout}, nominal.problem, heldout)
    floor = _floor_rms(nominal.problem, heldout)
    augmented = None if after is None else _rms({i: after[i].residual for i in heldout}, nominal.problem, heldout)
    closed = None
    if winner is not None and after is not None:
        closed = products(nominal, heldout, [_both(nominal, before), _both(winner, after)], rng).closed(1)
    taken: dict[str, float] = {}
    answer: Literal["none", "gap", "cannot tell"]
    if p_value < SIZE:
        answer, why = "gap", f"held-out residuals follow what the training trials predict ({words_of_p(p_value)})"
    elif nominal_rms <= FAR * floor and (taken := taken_up(nominal, before)):
        answer, why = "cannot tell", _taken_in_words(taken, nominal_rms / floor)
    elif upper < NEGLIGIBLE:
        answer, why = "none", f"no gap shows; one larger than {upper:.2f} times the sensor noise is excluded"
    elif nominal_rms > FAR * floor:
        answer = "cannot tell"
        repeated = any(_repeats_of(experiment, i, nominal.problem.trials) for i in heldout)
        why = _undecided(nominal_rms, augmented, floor, p_value, repeated)
    else:
        answer = "cannot tell"
        why = (
            f"the held-out trials alone show no gap, but one as large as {two_digits(upper)} times the sensor noise "
            "could hide in them: add trials"
        )
    return Gap(answer, p_value, SIZE, floor, nominal_rms, augmented, closed, upper, why, taken)


def _undecided(nominal: float, augmented: float | None, noise: float, p_value: float, repeated: bool) -> str:
    """Why held-out residuals far beyond the noise do not show that a law is missing.

    nominal, augmented, noise : rms of what the nominal model and an answer leave of them, and of the sensors' noise.
    """
    wrong = (
        f"held-out residuals are {two_digits(nominal / noise)} times the sensor noise, so the nominal model is wrong"
    )
    if repeated:
        return (
            f"{wrong} there, but other than the training trials predict: the trials differ by what the model does not "
            "allow for"
        )
    alone = f"{wrong} there, by a law or by what only these trials have; no trial that was fitted repeats them"
    if augmented is None:
        return f"{alone}, and there is no candidate whose prediction could be compared with them"
    if augmented >= nominal:
        return f"{alone}, and the best candidate comes no closer to them"
    often = "nearly always" if p_value > 0.95 else f"in up to {100.0 * p_value:.0f} of 100 cases"
    return (
        f"{alone}. The best candidate leaves {two_digits(augmented / noise)} times the noise, but residuals that "
        f"change as slowly as these follow a candidate as closely by chance {often}"
    )


def taken_up(fit: Calibration, heldout: Mapping[int, Prediction]) -> dict[str, float]:
    """Own values that lie out of their reach in a held-out trial and, to the same side, in the fitted ones on average.

    Name -> by how many standard deviations of what is declared or scatters, the nearer of the two, farthest first. What
    trials share so is no scatter but a gap, and the test does not see it: it leaves own values free.
    """
    if fit.problem.experiment.start == "free":
        return {}
    known = {name for name, _ in fit.problem.switches.scatter.columns(True)} - {RELEASE} | {"theta0"}
    fitted: dict[str, list[float]] = {}
    for group in fit.problem.groups:
        for m, (name, _, _) in enumerate(group.nuisances):
            fitted.setdefault(name, []).extend(float(fit.eta[i][m]) for i in group.trials)
    found: dict[str, float] = {}
    for group in fit.problem.grouped(tuple(heldout)):
        for m, (name, _, _) in enumerate(group.nuisances):
            for i in group.trials if name in known and name in fitted else ():
                both = (float(heldout[i].eta[m]), float(np.mean(fitted[name])))
                nearer = min(both, key=abs)
                if both[0] * both[1] > 0.0 and abs(nearer) > max(OUT_OF_REACH, abs(found.get(name, 0.0))):
                    found[name] = nearer
    return dict(sorted(found.items(), key=lambda item: -abs(item[1])))


def _taken_in_words(taken: Mapping[str, float], ratio: float) -> str:
    """Why the test is blind; ratio : rms of held-out residuals over the noise."""
    listed = [f"{name.removeprefix('ln_')} {z:+.0f}" for name, z in taken.items()]
    return (
        f"the nominal model leaves {ratio:.2f} times the sensor noise of the held-out trials only with values of each "
        f"trial's own far out of their reach ({', '.join(listed)} standard deviations), as in the fitted trials; this "
        "test leaves such values free, so it does not see a gap that they take up: measure them"
    )


def closing(
    nominal: Calibration, fits: Mapping[str, Calibration], rng: np.random.Generator | None = None
) -> dict[str, tuple[float, Closed]]:
    """What each of several models leaves on held-out trials (rms, unit of the readings), and the share it closes.

    Empty if no trial is held out.
    """
    heldout = nominal.problem.experiment.heldout
    if not heldout or not fits:
        return {}
    nominal, fits = unseeing(nominal), {name: unseeing(fit) for name, fit in fits.items()}
    after = {name: predict(fit, heldout) for name, fit in fits.items()}
    sides = [_both(fits[name], after[name]) for name in fits]
    found = products(nominal, heldout, [_both(nominal, predict(nominal, heldout)), *sides], rng)
    return {
        name: (_rms({i: p.residual for i, p in after[name].items()}, nominal.problem, heldout), found.closed(k))
        for k, name in enumerate(fits, start=1)
    }


def _both(fit: Calibration, heldout: Mapping[int, Prediction]) -> tuple[dict[int, Array], dict[int, Array]]:
    """Residuals of the fitted and of the held-out trials."""
    return fit.residuals(), {i: p.residual for i, p in heldout.items()}


def squares_of_trials(fit: Calibration) -> tuple[Array, Array]:
    """Sum of squared residuals of each trial over the variance of the sensors' noise, and what that would give alone.

    Of the held-out trials where there are any, else of those that were fitted; (trials,) each.
    """
    problem = fit.problem
    heldout = problem.experiment.heldout
    residuals = {i: p.residual for i, p in predict(fit, heldout).items()} if heldout else fit.residuals()
    masks = _masks(problem, list(residuals))
    counts = np.array([float(masks[i].sum()) for i in residuals])
    return _squares(residuals, masks, problem.noise.floor), counts


def _tested(
    nominal: Calibration, winner: Calibration | None, before: Mapping[int, Prediction],
    after: Mapping[int, Prediction] | None, chosen_from: int,
) -> float:  # fmt: skip
    """p-value of "no gap" from what the winner and the repeats predict; before, after : of nominal model and winner.

    Scatters that no repeats show, and noise, are those that the winner makes likely: learnt with the nominal model they
    take up what it lacks, as a spring of each trial's own does that of a spring that hardens.
    """
    heldout, released = nominal.problem.experiment.heldout, nominal.problem.experiment.start == "rest"
    if released and winner is not None and winner.problem.noise.sensor and winner.problem.switches.scatter.sizes:
        winner = with_sizes_of_its_own(under(winner, learn_noise(winner), winner.problem.switches.scatter))
        nominal = under(nominal, winner.problem.noise, winner.problem.switches.scatter)
        before, after = predict(nominal, heldout), predict(winner, heldout)
    predictions: list[dict[int, Array]] = []
    choices: list[int] = []
    left: list[Mapping[int, Array]] = []
    if winner is not None and after is not None:
        predictions.append({i: after[i].model - before[i].model for i in heldout})
        choices.append(chosen_from)
        left.append(winner.residuals() | {i: p.residual for i, p in after.items()})
    if said := repeats_say(nominal):
        predictions.append(said)
        choices.append(1)
    return held_out_test(nominal, {i: before[i].eta for i in heldout}, predictions, choices, left)


# The test -------------------------------------------------------------------------------------------------------------


def repeats_say(fit: Calibration) -> dict[int, Array]:
    """Mean residual of each held-out trial's repeats, its fast content removed; trial -> (channels, n)."""
    experiment = fit.problem.experiment
    residuals = fit.residuals()
    out: dict[int, Array] = {}
    for i in experiment.heldout:
        t = experiment.trials[i]
        same = _repeats_of(experiment, i, fit.problem.trials)
        if same:
            each = [_read_at(t.times, experiment.trials[j].times, np.nan_to_num(residuals[j])) for j in same]
            mean = np.mean(each, axis=0)
            dt = float(np.median(np.diff(t.times)))
            spectrum = np.fft.rfft(mean, axis=1)
            spectrum[:, np.fft.rfftfreq(mean.shape[1], dt) > _SLOW * own_frequency(experiment)] = 0.0
            out[i] = np.fft.irfft(spectrum, mean.shape[1], axis=1)
    return out


def held_out_test(
    fit: Calibration,
    eta: Mapping[int, Array],
    predictions: Sequence[Mapping[int, Array]],
    choices: Sequence[int] | None = None,
    left: Sequence[Mapping[int, Array]] = (),
) -> float:
    """p-value of "no gap": the smallest over the predictions, multiplied by their number.

    eta : nuisances fitted to each held-out trial; predictions : held-out trial -> (channels, n) of what the model
    lacks, made without those trials; choices : for each, the number of those that it was chosen from with a look at
    the held-out readings, by which its p-value is multiplied (default: 1, no look); left : for the first ones, trial ->
    residuals (channels, n) of fitted and held-out trials under the model that made it (default: those of `fit`).
    """
    if not predictions:
        return 1.0
    problem = fit.problem
    linear = on_trials(fit, eta).linear
    rows, nuisances = [], []
    residual: list[Array] = []
    ranges: dict[int, tuple[Group, slice]] = {}
    first = 0
    for block in linear.blocks:
        for k, i in enumerate(block.group.trials):
            d = block.r.shape[1]
            rows.append(block.J[k].T)
            nuisances.append(block.T[k].T)
            residual.append(-block.r[k])
            ranges[i] = (block.group, slice(first, first + d))
            first += d
    J, r = np.concatenate(rows), np.concatenate(residual)
    place = {i: k for k, i in enumerate(ranges)}

    def cleared(x: Array) -> Array:
        """Without what each trial's nuisances can do."""
        out = x.copy()
        for i, (_, s) in ranges.items():
            T = nuisances[place[i]]
            if T.shape[1]:
                q, _ = np.linalg.qr(T)
                out[s] -= q @ (q.T @ out[s])
        return out

    basis, s, _ = np.linalg.svd(cleared(J), full_matrices=False)
    basis = basis[:, s > 1e-9 * max(float(s[0]), 1e-300)]
    p_values = []
    counts = choices or [1] * len(predictions)
    for prediction, tried, remains in zip_longest(predictions, counts, left):
        x = np.zeros(first)
        for i, shape in prediction.items():
            if i in ranges:
                group, where = ranges[i]
                k = group.trials.index(i)
                x[where] = problem.whitened(np.nan_to_num(shape)[None], group.weight[k][None])[0]
        x = cleared(x)
        x -= basis @ (basis.T @ x)
        length = float(np.linalg.norm(x))
        if length < 1e-12:
            p_values.append(1.0)
            continue
        if problem.noise.sensor:
            shapes = {i: x[s].reshape(group.y.shape[1], -1) for i, (group, s) in ranges.items()}
            length = _length_beside(shapes, remains or fit.residuals(), problem.noise)
        own = {i: x[s] for i, (_, s) in ranges.items()}
        power, freedom = unshared_along(fit, own)
        if freedom > 0.0:
            both = BELIEVED + freedom
            power = (BELIEVED + freedom * power) / both
            p = float(stdtr(both, -float(x @ r) / (length * math.sqrt(power))))
        else:
            shown = np.array([(own[i] @ r[s], own[i] @ own[i]) for i, (_, s) in ranges.items()])
            p = _by_trials(shown[:, 0], shown[:, 1], float(x @ r) / length)
        p_values.append(tried * p)
    return min(1.0, len(p_values) * min(p_values))


def unshared_along(fit: Calibration, shapes: Mapping[int, Array]) -> tuple[float, float]:
    """Power, over that of the noise, of what training repeats do not share along shapes; its degrees of freedom.

    shapes : held-out trial -> (data,) whitened, cleared of what nuisances can do. Power 1 and no freedom where no
    training trial of their kind has a repeat.
    """
    trials = fit.problem.experiment.trials
    records = {i: block.r[k] for block in fit.linear.blocks for k, i in enumerate(block.group.trials)}
    total, weight, square = 0.0, 0.0, 0.0
    for i, x in shapes.items():
        same = _repeats_of(fit.problem.experiment, i, list(records))
        if len(same) < 2:
            continue
        rows = x.reshape(trials[i].y.shape)
        own = [_read_at(trials[j].times, trials[i].times, rows).ravel() for j in same]
        contrasts = helmert(len(same)) @ np.array([y @ records[j] for j, y in zip(same, own, strict=True)])
        length = float(np.mean([y @ y for y in own]))
        total += float(contrasts @ contrasts)
        weight += len(contrasts) * length
        square += len(contrasts) * length**2
    if weight <= 0.0:
        return 1.0, 0.0
    return max(total / weight, 1e-12), weight**2 / square


def _repeats_of(experiment: Experiment, i: int, among: Sequence[int]) -> list[int]:
    """Some trials that repeat trial i, whatever their clocks. Of records that start in motion no two begin alike."""
    trials = experiment.trials
    return [] if experiment.start == "free" else [j for j in among if trials[j].conditions == trials[i].conditions]


def _read_at(times: Array, own: Array, rows: Array) -> Array:
    """Records (channels, n) read at instants `own`, at other ones; nothing beyond."""
    return rows if np.array_equal(times, own) else np.array([np.interp(times, own, x, 0.0, 0.0) for x in rows])


def _by_trials(products: Array, expected: Array, z: float) -> float:
    """p-value of products (trials,) that vary as they do, each about nothing; z: their sum if noise alone makes it.

    expected : of each, up to a factor; trials of which nothing is expected show nothing and do not count.
    """
    p, n = float(ndtr(-z)), float(expected.sum()) ** 2 / max(float(expected @ expected), 1e-300)
    if n < FEWEST_TRIALS:
        return p
    share = float(products.sum() / math.sqrt(float(products @ products)))
    return max(p, float(stdtr(n - 1.0, -share * math.sqrt((n - 1.0) / max(n - share**2, 1e-12)))))


def _length_beside(shapes: Mapping[int, Array], left: Mapping[int, Array], noise: Noise) -> float:
    """Standard deviation of the product of shapes, trial -> (channels, n), with noise like residuals, `left`.

    Of those of fitted trials, or of each held-out trial's own, whichever is larger. Where residuals have little at the
    frequencies of a shape, they count with their mean power over frequencies, weighted by itself (`error_level`).
    """

    def beside(some: Mapping[int, Array], residuals: Sequence[Array]) -> float:
        levels = [
            max(error_level([np.nan_to_num(r[c]) for r in residuals if c < len(r)]), sensor) / sd
            for c, (sensor, sd) in enumerate(zip(noise.sensor, noise.total, strict=True))
        ]
        white = math.hypot(
            *(s * float(np.linalg.norm(x)) for shape in some.values() for x, s in zip(shape, levels, strict=False))
        )
        return max(white, _length(some, correlation(residuals, noise.total)))

    fitted = beside(shapes, [r for i, r in left.items() if i not in shapes])
    return max(fitted, math.hypot(*(beside({i: x}, [left[i]]) for i, x in shapes.items() if i in left)))


def correlation(residuals: Sequence[Array], sds: Sequence[float]) -> list[Array]:
    """Autocovariance of each channel's residuals (channels, n) over lags from 0, in units of the noise's variance.

    Bartlett's window brings it to zero at a sixth of the longest record, beyond which it cannot be estimated.
    """
    out = []
    for c, sd in enumerate(sds):
        rows = [np.nan_to_num(r[c]) / sd for r in residuals if c < r.shape[0]]
        lags = max(max((r.size for r in rows), default=0) // _CORRELATED_SHARE, 1)
        known = sum(int(np.count_nonzero(r)) for r in rows)
        sums = np.array([sum(float(r[: r.size - k] @ r[k:]) for r in rows if r.size > k) for k in range(lags)])
        out.append(sums / max(known, 1) * (1.0 - np.arange(lags) / lags))
    return out


def _length(shapes: Mapping[int, Array], covariance: Sequence[Array]) -> float:
    """Standard deviation of the product of shapes, trial -> (channels, n), with noise of that autocovariance."""
    variance = 0.0
    for shape in shapes.values():
        for x, own in zip(shape, covariance, strict=False):
            lags = min(own.size, x.size)
            with_itself = np.array([float(x[: x.size - k] @ x[k:]) for k in range(lags)])
            variance += float(own[0] * with_itself[0] + 2.0 * own[1:lags] @ with_itself[1:])
    return math.sqrt(max(variance, 0.0))


# Sizes ----------------------------------------------------------------------------------------------------------------


def _masks(problem: Problem, trials: Sequence[int]) -> dict[int, NDArray[np.bool_]]:
    return {i: trust > KEPT_WEIGHT for i, trust in trust_of(problem.grouped(tuple(trials))).items()}


def _squares(residuals: Mapping[int, Array], masks: Mapping[int, NDArray[np.bool_]], noise: Sequence[float]) -> Array:
    """Sum of squared residuals of each trial, over the noise variance of its channel; (trials,)."""
    sds = np.array(noise)
    return np.array([
        float(np.sum((np.where(masks[i], np.nan_to_num(r), 0.0) / sds[: r.shape[0], None]) ** 2))
        for i, r in residuals.items()
    ])  # fmt: skip


def _rms(residuals: Mapping[int, Array], problem: Problem, trials: Sequence[int]) -> float:
    """Rms in the readings' unit of residuals over the spread of their noise."""
    masks, records = _masks(problem, trials), problem.experiment.trials
    each = {i: np.nan_to_num(residuals[i]) * records[i].noise(np.ones(len(residuals[i]))) for i in trials}
    total = sum(float(np.sum(each[i][masks[i]] ** 2)) for i in trials)
    return math.sqrt(total / max(sum(int(masks[i].sum()) for i in trials), 1))


def _floor_rms(problem: Problem, trials: Sequence[int]) -> float:
    masks, records, sds = _masks(problem, trials), problem.experiment.trials, np.array(problem.noise.floor)
    total = sum(float(np.sum(records[i].noise(sds[: len(m)])[m] ** 2)) for i, m in masks.items())
    return math.sqrt(total / max(sum(int(m.sum()) for m in masks.values()), 1))


def _upper_limit(x: float, n: float, known: float) -> float:
    """95 % upper limit of a gap's rms over the noise sd: chi-square x of n readings, noise variance to `known`."""
    if n <= 0.0:
        return math.inf
    sd = math.sqrt(2.0 * n + (known * n) ** 2)
    return math.sqrt(max(x - n, 0.0) / n + 1.645 * sd / n)


def noise_spread(problem: Problem) -> float:
    """Relative standard deviation of the noise variance, as learnt from the repeats of the fitted trials."""
    sets: dict[tuple[object, ...], list[int]] = {}
    trials = problem.experiment.trials
    for i in problem.trials:
        sets.setdefault(trials[i].conditions, []).append(trials[i].y.size)
    freedom = sum(sum(sizes) * (len(sizes) - 1) / len(sizes) for sizes in sets.values())
    return math.sqrt(2.0 / freedom) if freedom > 100.0 else 0.05


# Parameters and extrapolation -----------------------------------------------------------------------------------------


def shifts(nominal: Calibration, winner: Calibration) -> list[Shift]:
    """What the missing effect had pretended: every shared parameter before and after."""
    before, after = nominal.parameters, winner.parameters
    out = []
    for name, (x0, sd0) in before.items():
        if name in after:
            x1, sd1 = after[name]
            out.append(Shift(name, (x0, sd0), (x1, sd1), (x1 - x0) / sd1 if sd1 > 0.0 else 0.0))
    return out


@dataclass(frozen=True)
class Extrapolation:
    """A case predicted by fits that never saw it."""

    case: str
    nominal_rms: float
    augmented_rms: float
    noise_rms: float
    closed: Closed

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "case": self.case, "nominal_rms": self.nominal_rms, "augmented_rms": self.augmented_rms,
            "noise_rms": self.noise_rms, "closed": self.closed.to_json(),
        }  # fmt: skip


def left_out_case(nominal: Calibration, winner: Calibration, case: str) -> Extrapolation:
    """Both models refitted without one case, which they then predict.

    Raises
    ------
    ValueError
        if the case does not exist, or no training trial remains without it.
    """
    experiment = nominal.problem.experiment
    out = [i for i, t in enumerate(experiment.trials) if t.case == case]
    rest = tuple(i for i in nominal.problem.trials if experiment.trials[i].case != case)
    if not out:
        raise ValueError(f"no trial belongs to case {case!r}; cases are {sorted({t.case for t in experiment.trials})}")
    if not rest:
        raise ValueError(f"without case {case!r} no training trial remains; leave-out needs two cases")
    predictions = []
    for fit in (nominal, winner):
        problem = fit.problem
        fewer = problem.for_trials(rest)
        keep = [problem.names.index(n) for n in fewer.names]
        again = calibrate(fewer, [fit.q[keep]], eta={i: fit.eta[i] for i in rest}, anneal=False, finish=False)
        q = np.zeros(problem.size)  # what only the left-out case could teach keeps its prior
        q[keep] = again.q
        widened = Calibration(
            problem, q, again.eta, fit.covariance, again.cost, again.chi2, again.log_evidence, again.converged,
            fit.linear, again.iterations,
        )  # fmt: skip
        predictions.append(predict(widened, out))
    before, after = predictions
    closed = products(nominal, out, [({}, {i: p.residual for i, p in side.items()}) for side in predictions])
    return Extrapolation(
        case, _rms({i: before[i].residual for i in out}, nominal.problem, out),
        _rms({i: after[i].residual for i in out}, nominal.problem, out), _floor_rms(nominal.problem, out),
        closed.closed(1),
    )  # fmt: skip
