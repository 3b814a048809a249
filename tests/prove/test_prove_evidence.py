"""The evidence of a record by bridge sampling: the same for all seeds, that of nautilus, at a tenth of its cost."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import parts
import pytest
from nested import nested
from scipy.special import ndtri
from small_rig import RIG, measured

from bayes_damper.calibration import Noise, Problem, Switches, calibrate
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.sampling import resampled_start, sample
from bayes_damper.sampling.bridge import bridge

SEEDS = 8
LIVE = 500
"""Live points of nautilus, a quarter of its default: it spends nearly all of its time in its own neural networks."""
FIXED = ("k2t", "c1t", "c3t", "drag")
"""Held at their true values, so that nautilus comes to an end within a minute: five unknowns are left."""


def _posterior() -> RecordPosterior:
    experiment = measured(1, cases=[("IV", 1, 0.08)], configurations=(True,), repeats=1, duration=0.3)
    experiment = replace(experiment, priors={name: RIG[name] for name in FIXED})
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
            live=LIVE,
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
    own, seconds = (float(np.median([row[key] for row in ours])) for key in ("error", "seconds"))
    ratio = theirs["seconds"] / seconds
    numbers = {
        "ours": values.tolist(),
        "errors": [row["error"] for row in ours],
        "nautilus": {name: theirs[name] for name in ("log_z", "error", "seconds")},
        "cpu_ratio": ratio,
        "commits": sorted({row["commit"] for row in (*ours, theirs)}),
    }
    spread, gap = float(values.std(ddof=1)), float(values.mean() - theirs["log_z"])
    lines = [
        "One coupled record of 0.3 s at 1 kHz, five unknowns (mu, c2t, nu and the noise of both channels; the others",
        "held at their true values, so that nautilus comes to an end soon), the release angle integrated out. Ours:",
        "the sampler until its rule is met, then bridge sampling with 4000 proposals, all from a new seed each time.",
        f"nautilus: {LIVE} live points, exploration discarded. CPU times on one core.",
        "",
        "| | log evidence, nats | standard deviation over seeds | its own error | CPU time, s |",
        "| --- | --- | --- | --- | --- |",
        f"| bridge sampling, {SEEDS} seeds | {values.mean():.3f} | {spread:.3f} | {own:.3f} | {seconds:.1f} |",
        f"| nautilus | {theirs['log_z']:.3f} | - | {theirs['error']:.3f} | {theirs['seconds']:.1f} |",
    ]
    verdict = (
        f"Spread over {SEEDS} seeds {spread:.3f} nats, {abs(gap):.3f} from nautilus, {ratio:.0f} times less CPU time."
    )
    parts.write_page("evidence", verdict, lines, numbers)
    assert spread <= 0.05
    assert abs(gap) <= 0.1
    assert ratio >= 10.0
