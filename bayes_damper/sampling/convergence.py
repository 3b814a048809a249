"""How far an ensemble run can be trusted: autocorrelation time, effective sample size, R-hat, stranded walkers.

The walkers of one ensemble are no independent chains: each moves with the help of the others, so that flattening them
step by step would claim twenty times the draws there are. Here the effective sample size is draws / tau, with tau from
the autocorrelation averaged over the walkers of an ensemble, and R-hat compares ensembles, which are independent.
Deviations are taken from the mean of all ensembles, so that a walker or an ensemble which stays by itself lengthens
tau instead of hiding. Nothing here raises on a short run: what cannot be computed yet is NaN.

Arrays of draws of one quantity are (ensembles, steps, walkers) throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]
_FEWEST_STEPS = 16


@dataclass(frozen=True)
class Diagnostic:
    """Of one quantity: R-hat, effective sample sizes, and tau in stored steps (NaN where draws are too few)."""

    r_hat: float
    ess_bulk: float
    ess_tail: float
    tau: float


@dataclass(frozen=True)
class StoppingRule:
    """When a run has enough draws, and when it gives up.

    All three must hold for every parameter: R-hat across ensembles at most `r_hat`; at least `taus` autocorrelation
    times in each ensemble; bulk and tail effective sample size at least `ess`. The run gives up after `max_steps` steps
    of each ensemble (burn-in not counted) or, if given, `max_seconds` of this process.
    """

    r_hat: float = 1.01
    taus: float = 20.0
    ess: float = 1000.0
    max_steps: int = 30_000
    max_seconds: float | None = None

    @classmethod
    def thorough(cls) -> StoppingRule:
        """The rule of `--thorough`: 50 autocorrelation times."""
        return cls(taus=50.0, max_steps=60_000)


@dataclass(frozen=True)
class Verdict:
    """Whether a run converged, by which figures, in sentences that say what to do when it did not.

    r_hat, ess_bulk, ess_tail : (ndim,); tau : (ndim,) in steps; steps : of each ensemble;
    stranded : (ensemble, walker) pairs that stay apart from the others.
    """

    converged: bool
    r_hat: Array
    ess_bulk: Array
    ess_tail: Array
    tau: Array
    steps: int
    stranded: tuple[tuple[int, int], ...]
    sentences: tuple[str, ...]


def diagnose_draws(draws: Array) -> Diagnostic:
    """R-hat, bulk and tail effective sample size and tau of one quantity, (ensembles, steps, walkers)."""
    values = np.asarray(draws, dtype=float)
    if values.shape[1] < _FEWEST_STEPS or not np.all(np.isfinite(values)) or np.ptp(values) == 0:
        return Diagnostic(np.nan, np.nan, np.nan, np.nan)
    bulk_tau = autocorrelation_time(_normal_scores(values))
    tails = [
        effective_size((values <= np.quantile(values, 0.05)).astype(float)),
        effective_size((values >= np.quantile(values, 0.95)).astype(float)),
    ]
    per_ensemble = values.shape[1] * values.shape[2]
    return Diagnostic(r_hat(values), float((per_ensemble / bulk_tau).sum()), min(tails), float(bulk_tau.max()))


def effective_size(draws: Array) -> float:
    """Effective number of independent draws for the mean of (ensembles, steps, walkers)."""
    return float((draws.shape[1] * draws.shape[2] / autocorrelation_time(draws)).sum())


def autocorrelation_time(draws: Array) -> Array:
    """Integrated autocorrelation time of each ensemble in stored steps, (ensembles,), at least 1.

    Autocorrelation averaged over walkers, about the common mean, summed up to the first lag beyond 5 tau (Sokal's
    window; Foreman-Mackey et al. 2013, section 3). NaN where nothing varies.
    """
    centred = draws - draws.mean()
    steps = draws.shape[1]
    variance = float((centred**2).mean())
    if variance == 0:
        return np.full(len(draws), np.nan)
    length = 1 << (2 * steps - 1).bit_length()
    transform = np.fft.rfft(centred, length, axis=1)
    power = (transform.real**2 + transform.imag**2).mean(axis=2)  # (ensembles, frequencies)
    correlation = np.fft.irfft(power, length, axis=1)[:, :steps] / (steps * variance)
    tau = 2.0 * np.cumsum(correlation, axis=1) - correlation[:, :1]
    beyond = np.arange(steps) >= 5.0 * tau
    window = np.where(beyond.any(axis=1), beyond.argmax(axis=1), steps - 1)
    return np.asarray(np.maximum(tau[np.arange(len(draws)), window], 1.0))


def r_hat(draws: Array) -> float:
    """Rank-normalised split R-hat across ensembles, the larger of bulk and folded (Vehtari et al. 2021, eqs. 4 to 14).

    Each half (in time) of each ensemble is a chain. NaN for a single ensemble, which has nothing to be compared with.
    """
    if len(draws) < 2:
        return float("nan")
    half = draws.shape[1] // 2
    chains = np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])
    return _r_hat_of_chains(chains.reshape(len(chains), -1))


def stranded_walkers(log_prob: Array) -> tuple[tuple[int, int], ...]:
    """(ensemble, walker) pairs whose mean log density lies far below that of the others, or that never moved.

    log_prob : (ensembles, steps, walkers). Far: more than 8 robust standard deviations of the walkers' means, and 10
    nats, below their median.
    """
    if log_prob.shape[1] == 0:
        return ()
    means = log_prob.mean(axis=1)
    centre = np.median(means)
    scale = 1.4826 * np.median(np.abs(means - centre))
    low = means < centre - np.maximum(8.0 * scale, 10.0)
    still = (np.ptp(log_prob, axis=1) == 0) & (log_prob.shape[1] >= 4 * _FEWEST_STEPS)
    return tuple((int(e), int(w)) for e, w in np.argwhere(low | still))


def judge(
    names: tuple[str, ...], draws: Array, log_prob: Array, thin: int, rule: StoppingRule, seconds_per_step: float = 0.0
) -> Verdict:
    """The verdict on draws (ensembles, steps, walkers, ndim) and log_prob (ensembles, steps, walkers) under a rule.

    thin : steps for each stored one; seconds_per_step : for the estimate of the time still needed.
    """
    ndim = draws.shape[3]
    each = [diagnose_draws(draws[..., i]) for i in range(ndim)]
    hats, bulk, tail, tau = (
        np.array([getattr(d, field) for d in each]) for field in ("r_hat", "ess_bulk", "ess_tail", "tau")
    )
    steps = draws.shape[1] * thin
    tau_steps = tau * thin
    stranded = stranded_walkers(log_prob)
    faults = _shortfalls(names, hats, bulk, tail, tau_steps, steps, rule, seconds_per_step)
    if stranded:
        shown = ", ".join(f"{e + 1}/{w + 1}" for e, w in stranded[:5])
        faults.append(
            f"{len(stranded)} walker(s) are stranded far from the others (ensemble/walker {shown}): "
            "the posterior may have a second mode; run again with another seed or narrower priors."
        )
    if not faults:
        good = (
            f"Converged: independent runs agree (R-hat at most {hats.max():.4f}; 1 is perfect), and the draws are "
            f"worth {min(bulk.min(), tail.min()):.0f} independent ones or more (effective sample size; "
            f"{steps / tau_steps.max():.0f} autocorrelation times of {tau_steps.max():.0f} steps)."
        )
        return Verdict(True, hats, bulk, tail, tau_steps, steps, stranded, (good,))
    return Verdict(False, hats, bulk, tail, tau_steps, steps, stranded, tuple(faults))


def _shortfalls(
    names: tuple[str, ...],
    hats: Array,
    bulk: Array,
    tail: Array,
    tau: Array,
    steps: int,
    rule: StoppingRule,
    pace: float,
) -> list[str]:
    """A sentence for each part of the rule that does not hold, with the steps still needed."""
    if not np.all(np.isfinite(bulk)):
        stuck = [n for n, b in zip(names, bulk, strict=True) if not np.isfinite(b)]
        return [f"Not enough draws to judge {', '.join(stuck)} after {steps} steps: continue the run."]
    if not np.all(np.isfinite(hats)):
        return ["R-hat needs at least two independent ensembles: sample with more than one."]
    faults = []
    needed = 1.0
    ess = np.minimum(bulk, tail)
    if hats.max() > rule.r_hat:
        # R-hat - 1 falls as one over the number of steps.
        needed = max(needed, (hats.max() - 1) / (rule.r_hat - 1))
        faults.append(f"R-hat of {names[int(hats.argmax())]} is {hats.max():.4f}, above {rule.r_hat}.")
    if steps < rule.taus * tau.max():
        needed = max(needed, rule.taus * tau.max() / steps)
        faults.append(
            f"{steps} steps are {steps / tau.max():.1f} autocorrelation times of {names[int(tau.argmax())]} "
            f"(the longest, {tau.max():.0f} steps); {rule.taus:g} are required."
        )
    if ess.min() < rule.ess:
        needed = max(needed, rule.ess / ess.min())
        faults.append(
            f"The effective sample size of {names[int(ess.argmin())]} is {ess.min():.0f}, below {rule.ess:g}."
        )
    if faults:
        more = int(np.ceil(steps * (needed - 1)))
        time = f", about {more * pace:.0f} s at the present pace" if pace > 0 else ""
        faults.append(f"Continue for about {more} more steps per ensemble{time}.")
    return faults


def _normal_scores(values: Array) -> Array:
    """Ranks over all draws turned into standard normal quantiles (Blom), same shape."""
    from scipy.stats import rankdata  # slow to load, and a diagnosis draws nothing

    ranks = rankdata(values, axis=None).reshape(values.shape)
    return np.asarray(ndtri((ranks - 0.375) / (values.size + 0.25)))


def _r_hat_of_chains(chains: Array) -> float:
    """Larger of bulk and folded rank-normalised R-hat of (chains, draws)."""
    folded = np.abs(chains - np.median(chains))
    return max(_plain_r_hat(_normal_scores(chains)), _plain_r_hat(_normal_scores(folded)))


def _plain_r_hat(chains: Array) -> float:
    count = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean()
    between = chains.mean(axis=1).var(ddof=1)
    return float(np.sqrt((count - 1) / count + between / within)) if within > 0 else float("inf")
