"""Some hundreds of draws of a record's posterior, in less time than a fit takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.sampling import Sampling, StoppingRule, resampled_start, sample
from bayes_damper.sampling.moves import StudentT

Array = NDArray[np.float64]
SHORT = StoppingRule(max_steps=1)
WALKERS = 64


def weighted(posterior: RecordPosterior, rng: np.random.Generator, n: int) -> tuple[Array, dict[str, Any]] | None:
    """Draws (n, ndim) of a posterior by weights, and their health; None where too few of them count.

    A Student t about the best fit is drawn from, fitted to its draws by weights that leave a few hundred effective
    ones, drawn from again, and so on.
    """
    shape = StudentT(posterior.start, 1.2 * posterior.covariance, 5.0)
    effective = 0.0
    for count in (2048, 2048, 6144):
        points = shape.draw(rng, count)
        log_weight = np.nan_to_num(posterior(points), nan=-np.inf) - shape.log_density(points)
        if not np.isfinite(log_weight).any():
            return None
        power = 1.0
        while True:
            weight = np.exp(power * (log_weight - log_weight.max()))
            weight /= weight.sum()
            effective = 1.0 / float(np.sum(weight**2))
            if count == 6144 or effective > 300.0 or power < 1e-3:
                break
            power *= 0.7
        centre = weight @ points
        covariance = (points - centre).T * weight @ (points - centre)
        try:
            shape = StudentT(centre, 1.1 * covariance, 5.0)
        except np.linalg.LinAlgError:  # too few points bear all the weight
            return None
    if effective < 500.0:
        return None
    flat = points[rng.choice(len(points), n, p=weight)]
    return flat, {"ess": round(effective), "evaluations": 2 * 2048 + 6144}


def sampled(posterior: RecordPosterior, rng: np.random.Generator, seed: int) -> Sampling:
    """The sampler of `fit` with one ensemble and 75 stored steps."""
    start = resampled_start(posterior, posterior.start, posterior.covariance, rng)
    return sample(posterior, start, seed=seed, ensembles=1, walkers=WALKERS, rule=SHORT)
