"""One synthetic campaign from its truth to the ranks of all its unknowns: the fit is that of `bayes-damper fit`.

What differs from `fit` is only how long it samples: one ensemble of 64 walkers in place of four, and 75 stored steps
(every eighth of an autocorrelation time, some hundreds of independent draws) in place of the stopping rule.

`fit` gives little weight to the release and to readings beside a reversal of friction, because no real rig follows the
formulas there to the microsecond. Synthetic campaigns do: to them this is information left unused, by design. Ranks
are therefore asked for twice, of the fit as it is and of one `without_allowance`, whose likelihood is exactly that of
the campaigns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any
from unittest import mock

import numpy as np
import parts
import ranks
import synthetic
from draws import SHORT, WALKERS, sampled, weighted
from numpy.typing import NDArray

from bayes_damper.calibration import Experiment, Switches, calibrate_nominal, problem
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.fit.draw import search
from bayes_damper.fit.published import feature_posterior, published_posterior
from bayes_damper.priors.files import load_priors
from bayes_damper.published.posterior import Datum
from bayes_damper.sampling import Sampling, diagnose_draws, sample

Array = NDArray[np.float64]
SEED = 20261
POPULATION = 512
"""Members of the annealed start of published features; `fit` takes 2048."""
CASES = ("I", "II", "III", "IV")
SETTINGS = {
    "synthetic campaigns": f"one case, two trials of {synthetic.TIMES.size / synthetic.RATE:g} s at "
    f"{synthetic.RATE:g} Hz; lone: an uncoupled and a coupled trial; repeats: two coupled ones; each with its own "
    "angle and instant of release, if coupled with its own friction too. Truths of parameters from the default priors, "
    "of release angle, pull and stiffness from what is declared, noise from a lognormal of median 2 rad/s² and factor "
    "1.5. Records by the "
    "tests' own Runge-Kutta solver, which shares nothing with the package.",
    "draws by weights": "weighted draws of a Student t fitted to the posterior, resampled where at least 500 of 6144 "
    "count, else the sampler as below: in less time, so on more campaigns",
    "fit": "calibrate_nominal and RecordPosterior, as in `bayes-damper fit` under white noise; sampled by the same "
    f"sampler with one ensemble of {WALKERS} walkers and 75 stored steps, not four ensembles and the stopping rule",
    "cases of the thesis": "truths from the thesis's priors, features with the published standard errors (Student t, "
    f"2 degrees of freedom), FeaturePosterior; annealed start of {POPULATION} members in place of 2048, then as above",
    "seed": str(SEED),
}
SWITCHES = dict.fromkeys((*synthetic.KINDS, synthetic.FAINT), Switches(delay=True, friction=True))
"""What each trial has of its own is as in the synthetic ones: the usual scatter of single trials would widen all."""


@contextmanager
def without_allowance() -> Iterator[None]:
    """A fit that trusts the release and the reversals of friction to the microsecond."""
    with mock.patch.object(problem, "EVENT_TIMING", 0.0), mock.patch.object(problem, "RELEASE_WEIGHT", 1.0):
        yield


def finished_parts() -> dict[str, list[dict[str, Any]]]:
    """What is finished of the calibration, by kind of campaign."""
    found = {f"{kind} campaigns, fit as it is": f"calibration-{kind}" for kind in synthetic.KINDS}
    found |= {
        f"{kind} campaigns, fit as it is, draws by weights": f"calibration-weights-{kind}" for kind in synthetic.KINDS
    }
    found |= {f"{kind} campaigns, fit without allowance": f"exact-{kind}" for kind in synthetic.KINDS}
    found |= {f"thesis, case {case}": f"calibration-{case}" for case in CASES}
    done = {title: list(parts.finished(name).values()) for title, name in found.items()}
    return {title: results for title, results in done.items() if results}


def _ranks(truth: dict[str, float], drawn: dict[str, Array]) -> dict[str, int]:
    return {name: int(np.count_nonzero(x < truth[name])) for name, x in drawn.items() if name in truth}


def _health(sampling: Sampling, draws: Array) -> dict[str, Any]:
    """Effective sample size of the worst coordinate, steps, walkers left behind."""
    sizes = [diagnose_draws(draws[..., i]).ess_bulk for i in range(draws.shape[-1])]
    return {
        "ess": round(float(np.nanmin(sizes))),
        "steps": sampling.verdict.steps,
        "warm_up": int(sampling.warm_up[0]),
        "evaluations": sampling.evaluations,
        "stranded": len(sampling.verdict.stranded),
    }


def recorded(
    kind: str,
    number: int,
    fault: Callable[[], AbstractContextManager[Any]] = nullcontext,
    mistake: Callable[[Experiment], Experiment] = lambda e: e,
    weights: bool = False,
) -> dict[str, Any]:
    """Ranks of one synthetic campaign's truths; `fault` is a bug that the fit, but not the campaign, has, and `mistake`
    what the fit takes the campaign for.

    weights : draws by weights, in less time; by the sampler where too few count.
    """
    made = synthetic.campaign(kind, SEED, number)
    with fault():
        best = calibrate_nominal(mistake(made.experiment), switches=SWITCHES[kind])
        posterior = RecordPosterior(best)
        rng = np.random.default_rng([SEED, number])
        found = weighted(posterior, rng, ranks.DRAWS) if weights else None
        if found is not None:
            flat, health = found
        else:
            sampling = sampled(posterior, rng, number)
            flat, health = sampling.flat(ranks.DRAWS), _health(sampling, sampling.draws)
        values = posterior.values(flat)
        nuisances = posterior.evaluated(flat, rng)[1]
    own: list[dict[str, Array]] = [{} for _ in made.experiment.trials]
    for part in posterior.parts:
        for k, i in enumerate(part.group.trials):
            for m, (name, mean, sd) in enumerate(part.group.nuisances):
                own[i][name] = mean[k] + sd[k] * nuisances[i][:, m]
    truth = made.truth | {
        "log_likelihood": float(
            synthetic.log_likelihood(
                made,
                {name: np.array([x]) for name, x in made.truth.items()},
                [{name: np.array([x]) for name, x in mine.items()} for mine in made.own],
            )[0]
        ),
        "friction_torque": made.truth["mu"] * made.truth["N0"],
    }
    drawn = dict(values)
    drawn["log_likelihood"] = synthetic.log_likelihood(made, values, own)
    drawn["friction_torque"] = values["mu"] * values.get("N0", np.full(len(flat), synthetic.CONSTANTS["N0"][0]))
    if kind == synthetic.FAINT:  # what tells of the priors where they decide much
        truth["log_prior"] = float(synthetic.log_prior(made, {n: np.array([x]) for n, x in made.truth.items()})[0])
        drawn["log_prior"] = synthetic.log_prior(made, values)
        known = [{n: np.array([x]) for n, x in mine.items()} for mine in made.own]
        truth["log_prior_own"] = float(synthetic.log_prior_own(known)[0])
        drawn["log_prior_own"] = synthetic.log_prior_own(own)
    for i, mine in enumerate(made.own):
        truth |= {f"{name}[{i + 1}]": x for name, x in mine.items()}
        drawn |= {f"{name}[{i + 1}]": x for name, x in own[i].items()}
    switches = {name: on for name, on in vars(best.problem.switches).items() if isinstance(on, bool)}
    return {"ranks": _ranks(truth, drawn), "switches": switches} | health


def published(case: str, number: int) -> dict[str, Any]:
    """Ranks of truths drawn from the thesis's priors of one case, given features simulated with their errors.

    Truths whose record lacks a feature are drawn again: the posterior gives them no weight either.
    """
    priors = load_priors("thesis")
    base = published_posterior(case, priors)
    rng = np.random.default_rng([SEED, *case.encode(), number])
    while True:
        point = rng.standard_normal((1, base.ndim))
        exact = base.predict(base.coordinates.sampled(point))[0]
        if np.isfinite(exact).all():
            break
    data = [
        Datum(d.configuration, d.quantity, float(x + d.standard_error * rng.standard_t(d.n - 1)), d.standard_error, d.n)
        for d, x in zip(base.data, exact, strict=True)
    ]
    posterior = feature_posterior(data, case, priors)
    coordinates = posterior.coordinates
    start = search(posterior, rng, POPULATION)
    sampling = sample(
        posterior, start, seed=number, ensembles=1, walkers=WALKERS, rule=SHORT, monitor=coordinates.standard
    )
    flat = sampling.flat(ranks.DRAWS)
    standard = coordinates.standard(sampling.flat()).reshape(sampling.draws.shape)
    truth = {name: float(x) for name, x in zip(posterior.names, point[0], strict=True)}
    drawn = dict(zip(posterior.names, coordinates.standard(flat).T, strict=True))
    truth["log_prior"] = float(-0.5 * np.sum(point**2))
    drawn["log_prior"] = -0.5 * np.sum(coordinates.standard(flat) ** 2, axis=1)
    truth["log_likelihood"] = float(posterior.log_likelihood(coordinates.sampled(point)).sum())
    drawn["log_likelihood"] = posterior.log_likelihood(flat).sum(axis=1)
    return {"ranks": _ranks(truth, drawn)} | _health(sampling, standard)
