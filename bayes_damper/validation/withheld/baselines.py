"""Simpler ways to name an effect, on the same campaigns and the same fits as the diagnosis.

- `bic`: weights exp(-BIC / 2) of the best fit of every effect and of the nominal model;
- `bic_gate`: the same, with `unknown` as one more model: two parameters more than the nominal one, and the chi2 that a
  true model exceeds once in a hundred times, so that it wins where every fit leaves more than that;
- `stacking`: weights that maximise the log predictive density of the held-out trials under the same fits;
- `sparse_regression`: the missing torque by inverse dynamics, regressed on one term per effect (the first step of
  sparse identification of dynamics), weighed by BIC;
- `random_forest`: trained on features of the nominal residual, campaigns in five folds, each judged by a forest that
  has seen the truths of the other four: more than any other method here is given. Causes outside the library are
  a class of their own there, `unknown`, by which it rejects.

`bic_gate` and the forest can answer `unknown`. The forest needs scikit-learn, an extra: `FOREST_ABSENT` is what is
reported where it is not installed.
"""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayes_damper.calibration import Calibration, predict, unseeing
from bayes_damper.calibration.unknowns import NOMINAL
from bayes_damper.diagnosis import Diagnosis
from bayes_damper.diagnosis.response import Motion, motions
from bayes_damper.runs.contents.withheld import BaselineAnswers

Array = NDArray[np.float64]

FOLDS = 5
LEAST_OF_A_CLASS = 3  # campaigns of a truth below which a forest cannot learn it
TREES = 300
GATE = 0.99  # quantile of chi2 beyond which no fit counts as one
FOREST_ABSENT = (
    "random_forest was skipped: it needs scikit-learn; install it with pip install 'bayes-damper[baselines]'"
)


def baselines_of(found: Diagnosis) -> BaselineAnswers:
    """Probabilities by each method, and the forest's features, from a diagnosis.Diagnosis."""
    nominal: Calibration = found.nominal
    fits = _best_fits(found)
    out: BaselineAnswers = {"bic": bic_weights(nominal, fits), "bic_gate": bic_weights(nominal, fits, gate=GATE)}
    held_out = tuple(nominal.problem.experiment.heldout)
    if held_out:
        out["stacking"] = stacking_weights(nominal, fits, held_out)
    if nominal.problem.experiment.quantity == "acceleration":
        moved = motions(nominal)
        out["sparse_regression"] = sparse_regression(nominal, moved)
        out["features"] = residual_features(nominal, moved)
    return out


def _best_fits(found: Diagnosis) -> dict[str, Calibration]:
    """Effect -> its best fit among those made with the nominal model's own noise, so that they can be compared."""
    out: dict[str, Calibration] = {}
    for candidate in found.candidates:
        fit, name = candidate.fit, candidate.effect.name
        if fit is None or fit.problem.noise != found.nominal.problem.noise:
            continue
        if name not in out or fit.chi2 < out[name].chi2:
            out[name] = fit
    return out


def _weights(log_weights: Mapping[str, float]) -> dict[str, float]:
    top = max(log_weights.values())
    raw = {name: math.exp(max(x - top, -700.0)) for name, x in log_weights.items()}
    total = sum(raw.values())
    return {name: x / total for name, x in raw.items()}


# Weights of fits ------------------------------------------------------------------------------------------------------


def bic_weights(nominal: Calibration, fits: Mapping[str, Calibration], gate: float | None = None) -> dict[str, float]:
    """exp(-BIC / 2) of each best fit, normalised; the nominal model's is `none`.

    gate : with `unknown` beside them, as a model of two more parameters that has this quantile of chi2.
    """
    each = math.log(max(nominal.problem.n_data, 2.0))
    log_w = {"none": -0.5 * nominal.chi2}
    if gate is not None:
        log_w["unknown"] = -0.5 * (float(chi2.ppf(gate, nominal.problem.n_data)) + 2.0 * each)
    for name, fit in fits.items():
        log_w[name] = -0.5 * (fit.chi2 + each * (fit.problem.size - nominal.problem.size))
    return _weights(log_w)


def stacking_weights(
    nominal: Calibration, fits: Mapping[str, Calibration], held_out: tuple[int, ...], rounds: int = 500
) -> dict[str, float]:
    """Weights of the mixture of fits that best predicts the held-out trials, found by expectation-maximisation."""
    everything = {"none": nominal, **fits}
    misfit = np.array([[predict(unseeing(fit), (i,))[i].chi2 for i in held_out] for fit in everything.values()])
    relative = np.exp(-0.5 * np.clip(misfit - misfit.min(axis=0), 0.0, 1400.0))  # (fits, trials)
    w = np.full(len(everything), 1.0 / len(everything))
    for _ in range(rounds):
        share = w[:, None] * relative
        w = (share / share.sum(axis=0)).mean(axis=1)
    return dict(zip(everything, w.tolist(), strict=True))


# Sparse regression ----------------------------------------------------------------------------------------------------


def _without_drift(x: Array, degree: int = 2) -> Array:
    """Records (trials, n) minus their polynomials of that degree: integrated noise drifts."""
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, x.shape[1]), degree + 1))[0]
    return np.asarray(x - (x @ basis) @ basis.T)


def _integral(x: Array, times: Array) -> Array:
    steps = 0.5 * (x[:, 1:] + x[:, :-1]) * np.diff(times)
    return np.concatenate([np.zeros((x.shape[0], 1)), np.cumsum(steps, axis=1)], axis=1)


def _residual(m: Motion) -> Array:
    """Reading minus model, (trials, 2, n), 0 where a reading is missing and on the secondary of an uncoupled rig."""
    r = np.where(m.group.weight > 0.0, m.group.y - m.y, 0.0)
    return r if r.shape[1] == 2 else np.concatenate([r, np.zeros_like(r)], axis=1)


def missing_torque(fit: Calibration, m: Motion) -> tuple[Array, Array]:
    """Torques on both inertias that the nominal model lacks, (trials, n) N m, by inverse dynamics of the residual."""
    value = {name: x for name, (x, _) in fit.parameters.items()}
    constant = {name: pair[0] for name, pair in fit.problem.experiment.constants.items()} | value
    r = _residual(m)
    times = m.group.times
    dw = [_without_drift(_integral(r[:, c], times)) for c in (0, 1)]
    dth = [_without_drift(_integral(dw[c], times)) for c in (0, 1)]
    q1 = constant["J1"] * r[:, 0] + value["c1t"] * dw[0] + m.k1t[:, None] * dth[0]
    if not m.group.coupled:
        return q1, np.zeros_like(q1)
    across = value["k2t"] * (dth[0] - dth[1]) + value["c2t"] * (dw[0] - dw[1])
    return q1 + across, constant["J2"] * r[:, 1] + value["c3t"] * dw[1] - across


def _terms(fit: Calibration, m: Motion) -> Iterator[tuple[str, Array, Array]]:
    """One pair of columns (trials, n) for each effect that a torque can show, and those of the nominal model ("")."""
    at = m.at
    th1, w1, w2, a2 = m.th1[:, at], m.w1[:, at], m.w2[:, at], m.a2[:, at]
    phi, slip, overlap = m.phi[:, at], m.slip[:, at], m.overlap[:, at]
    zero = np.zeros_like(th1)
    on = 1.0 if m.group.coupled else 0.0
    sign1, sign2, signs = (np.tanh(m.nu[:, None] * x) for x in (w1, w2, slip))
    reach = float(np.abs(th1).max())
    speed = 0.05 * float(np.abs(w1).max())
    heat = _integral(np.abs(slip) * overlap, m.group.times)
    for x in (phi, slip, signs * overlap):
        yield "", on * x, -on * x
    yield "", w1, zero
    yield "", zero, on * w2
    yield "", sign1, on * sign2
    yield "spring_cubic", th1**3, zero
    yield "spring_bottoming", np.sign(th1) * np.maximum(np.abs(th1) - 0.6 * reach, 0.0), zero
    yield "coupling_backlash", np.clip(th1, -0.05 * reach, 0.05 * reach), zero
    yield "coupling_hysteresis", sign1 * np.abs(th1), zero
    yield "stiffness_error", m.k1t[:, None] * th1, zero
    yield "bearing_stribeck", sign1 * np.exp(-np.abs(w1) / speed), on * sign2 * np.exp(-np.abs(w2) / speed)
    yield "quadratic_drag", w1 * np.abs(w1), on * w2 * np.abs(w2)
    yield "sensor_delay", np.gradient(m.a1[:, at], axis=1), zero
    if not fit.problem.experiment.coupled:
        return
    yield "misalignment_drag", on * sign1 * overlap, on * sign2 * overlap
    for name, x in (
        ("stick_slip", signs * overlap * np.exp(-np.abs(slip) / speed)),
        ("friction_displacement", signs * np.abs(phi)),
        ("magnet_cubic", phi**3),
        ("eddy_overlap", slip * overlap**2),
        ("magnet_fade", signs * overlap * heat),
        ("interface_relaxation", np.gradient(slip, axis=1)),
    ):
        yield name, on * x, -on * x
    yield "inertia_error", zero, on * a2
    yield "sensor_gain", m.a1[:, at], zero


def sparse_regression(fit: Calibration, moved: Sequence[Motion]) -> dict[str, float]:
    """BIC weights of one term beside those of the nominal model, in a regression of the missing torque."""
    names: list[str] = []
    blocks = []
    torques = []
    for m in moved:
        terms = list(_terms(fit, m))
        names = [name for name, _, _ in terms]
        blocks.append(np.array([np.concatenate([a.ravel(), b.ravel()]) for _, a, b in terms]))
        torques.append(np.concatenate([q.ravel() for q in missing_torque(fit, m)]))
    table, y = np.concatenate(blocks, axis=1), np.concatenate(torques)
    table /= np.maximum(np.linalg.norm(table, axis=1), 1e-300)[:, None]
    known = np.array([not name for name in names])
    basis = np.linalg.qr(table[known].T)[0]
    y = y - basis @ (basis.T @ y)
    rows = table[~known] - (table[~known] @ basis) @ basis.T
    norms = np.linalg.norm(rows, axis=1)
    gains = np.where(norms > 1e-6, (rows @ y) ** 2 / np.maximum(norms, 1e-6) ** 2, 0.0)
    left = float(y @ y)
    log_w = {"none": 0.0}
    for name, gain in zip([n for n in names if n], gains, strict=True):
        log_w[name] = -0.5 * (y.size * math.log(max(1.0 - gain / left, 1e-12)) + math.log(y.size))
    return _weights(log_w)


# Forest ---------------------------------------------------------------------------------------------------------------


def residual_features(fit: Calibration, moved: Sequence[Motion]) -> list[float]:
    """Numbers that describe what the nominal model leaves: sizes, colours, correlations with the motion, pulls."""
    noise = fit.problem.noise.total
    out: list[float] = []
    for coupled in (False, True):
        here = [m for m in moved if m.group.coupled == coupled]
        for c in (0, 1) if coupled else (0,):
            rows = [_channel_features(m, c, noise[min(c, len(noise) - 1)]) for m in here]
            out += np.mean(rows, axis=0).tolist() if rows else [0.0] * 30
    pulls = [float(fit.q[i]) for i, x in enumerate(fit.problem.coordinates) if x.role in ("constant", "stiffness")]
    moved_by = dict(zip([c.parameter for c in fit.problem.coordinates], fit.q.tolist(), strict=True))
    nominal = [moved_by.get(name, 0.0) for name in NOMINAL]  # where it differs from case to case, of the last one
    return [*out, *nominal, *sorted(pulls, key=abs, reverse=True)[:4], *([0.0] * (4 - min(len(pulls), 4)))]


def _channel_features(m: Motion, c: int, noise: float) -> Array:
    """(30,) features of one channel of a group of trials."""
    r = _residual(m)[:, c] / noise  # (trials, n)
    n = r.shape[1]
    at = m.at
    th, w, a = (m.th1, m.w1, m.a1) if c == 0 else (m.th2, m.w2, m.a2)
    th, w, a = th[:, at], w[:, at], a[:, at]
    phi, slip = m.phi[:, at], m.slip[:, at]
    power = np.abs(np.fft.rfft(r, axis=1)) ** 2
    bands = [b.sum() for b in np.array_split(power[:, 1:], 9, axis=1)]
    sizes = [math.log1p(float(np.mean(part**2))) for part in np.array_split(r, 5, axis=1)]
    colours = [float(np.mean(r[:, lag:] * r[:, : n - lag]) / (np.mean(r**2) + 1e-12)) for lag in (1, 3, 10)]
    shapes = (
        th, th**3, np.sign(th), w, w * np.abs(w), np.sign(w), a, np.gradient(a, axis=1), phi**3, np.sign(slip),
        np.sign(slip) * np.abs(phi), slip,
    )  # fmt: skip
    first = math.log1p(float(np.mean(r[:, : max(n // 50, 1)] ** 2)))
    like = [float(np.sum(r * s) / max(np.linalg.norm(s), 1e-12)) for s in shapes]
    shares = [math.log(max(float(b) / max(float(power.sum()), 1e-12), 1e-12)) for b in bands]
    return np.array([*sizes, *colours, *np.arcsinh(like).tolist(), *shares, first])


def has_forest() -> bool:
    """Whether scikit-learn is installed."""
    return importlib.util.find_spec("sklearn") is not None


def forest_out_of_fold(
    features: Mapping[str, Sequence[float]], labels: Mapping[str, str], seed: int, trees: int = TREES
) -> dict[str, dict[str, float]]:
    """Probabilities of every campaign by a forest that has not seen it.

    Empty where there are too few to learn from, or without scikit-learn.

    features : campaign -> numbers, 0 beyond the last of a campaign that has fewer; labels : campaign -> right answer.
    """
    names = sorted(set(features) & set(labels)) if has_forest() else []
    counts: dict[str, int] = {}
    for name in names:
        counts[labels[name]] = counts.get(labels[name], 0) + 1
    if len(names) < 2 * FOLDS or not any(count >= LEAST_OF_A_CLASS for count in counts.values()):
        return {}
    forest = importlib.import_module("sklearn.ensemble").RandomForestClassifier
    table = np.zeros((len(names), max(len(features[name]) for name in names)))
    for row, name in zip(table, names, strict=True):
        row[: len(features[name])] = np.nan_to_num(np.array(features[name], float), posinf=0.0, neginf=0.0)
    answers = np.array([labels[name] for name in names])
    every = sorted(counts)
    fold = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    out = {}
    for k in range(FOLDS):
        train, test = fold != k, fold == k
        model = forest(n_estimators=trees, min_samples_leaf=2, random_state=seed, n_jobs=1)
        with warnings.catch_warnings():
            # Many answers with few campaigns each: it asks whether these are numbers. They are names.
            warnings.filterwarnings("ignore", message="The number of unique classes is greater")
            model.fit(table[train], answers[train])
        predicted = model.predict_proba(table[test])
        for name, row in zip(np.array(names)[test], predicted, strict=True):
            p = dict.fromkeys(every, 0.0) | dict(zip(model.classes_.tolist(), row.tolist(), strict=True))
            mixed = {answer: 0.98 * x + 0.02 / len(every) for answer, x in p.items()}
            out[str(name)] = mixed
    return out
