"""The evidence of a record by bridge sampling: the same for all seeds, that of nautilus, at a tenth of its cost."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import parts
import pytest
from scipy.special import ndtri
from small_rig import measured

from bayes_damper.calibration import Noise, Problem, Switches, calibrate
from bayes_damper.evidence import bridge, nested
from bayes_damper.record_posterior import RecordPosterior
from bayes_damper.sampling import resampled_start, sample

SEEDS = 5


def _posterior() -> RecordPosterior:
    experiment = measured(1, cases=[("IV", 1, 0.08)], configurations=(True,), repeats=1, duration=0.3)
    noise, switches = Noise((2.0, 2.0), (0.0, 0.0), (0.0, 0.0)), Switches(delay=False, friction=False)
    return RecordPosterior(calibrate(Problem(experiment, noise=noise, switches=switches)))


def _answer(number: int) -> dict[str, Any]:
    """Of seed `number`: by bridge sampling from a run of the sampler; number SEEDS: by nautilus."""
    posterior = _posterior()
    begun = time.process_time()
    if number == SEEDS:
        log_z, error = nested(
            lambda x: posterior.log_likelihood(x).sum(axis=1),
            lambda u: ndtri(np.clip(u, 1e-15, 1.0 - 1e-15)),
            posterior.ndim,
            1,
        )
    else:
        rng = np.random.default_rng(number)
        run = sample(posterior, resampled_start(posterior, posterior.start, posterior.covariance, rng), seed=number)
        found = bridge(posterior, run.draws, run.log_prob, rng, proposals=4000)
        log_z, error = found.log_z, found.error
    return {"log_z": log_z, "error": error, "seconds": time.process_time() - begun}


@pytest.mark.prove
def test_the_evidence_is_that_of_nautilus_at_a_tenth_of_its_cost() -> None:
    *ours, theirs = parts.finish("evidence", SEEDS + 1, _answer)
    values = np.array([row["log_z"] for row in ours])
    ratio = theirs["seconds"] / float(np.median([row["seconds"] for row in ours]))
    numbers = {"ours": values.tolist(), "nautilus": theirs["log_z"], "cpu_ratio": ratio}
    told = (
        f"One coupled record of 0.3 s, nine unknowns. Bridge sampling over {SEEDS} seeds: {values.mean():.3f} nats, "
        f"standard deviation {values.std(ddof=1):.3f}; nautilus, exploration discarded: {theirs['log_z']:.3f}. "
        f"CPU time of nautilus over ours: {ratio:.0f}."
    )
    parts.write_page("evidence", "Evidence against nautilus", [told], numbers)
    assert values.std(ddof=1) <= 0.05
    assert abs(values.mean() - theirs["log_z"]) <= 0.1
    assert ratio >= 10.0
