"""Drawing the posterior of a case until the stopping rule is met, with its progress reported."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.published.posterior import FeaturePosterior, ShrinkingErrors
from bayes_damper.published.sources import is_published
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.runs.contents.fit import FitPlan
from bayes_damper.runs.execution import processes
from bayes_damper.runs.provenance import code_sha256
from bayes_damper.sampling import Progress as Stage
from bayes_damper.sampling import Sampling, Start, StoppingRule, annealed_start, sample

Array = NDArray[np.float64]
Report = Callable[[float, str], None]
WARM = 0.15
"""Share of a case's time after which the warm-up is over."""
DRAWN = 0.7
"""Share of a case's time after which its draws are there, as seen in runs of some trials: what follows counts too."""


def stopping_rule(plan: FitPlan) -> StoppingRule:
    """The rule that a plan asks for.

    Ensembles that begin as an annealed sample of the posterior have little of a start to forget, and their warm-up
    takes six autocorrelation times as far as it can estimate: for published features a quarter of those of the rule
    will do, R-hat and effective sample sizes being asked for as ever.
    """
    rule = StoppingRule.thorough() if plan["thorough"] else StoppingRule()
    if is_published(plan["campaign"]):
        rule = replace(rule, taus=rule.taus / 4.0)
    return rule if plan["most_steps"] is None else replace(rule, max_steps=int(plan["most_steps"]))


def search(posterior: FeaturePosterior, rng: np.random.Generator, members: int = 2048) -> Start:
    """Where the ensembles of a published case begin: draws of the prior, tempered by letting errors shrink."""
    coordinates = posterior.coordinates
    return annealed_start(coordinates.log_prior, ShrinkingErrors(posterior), coordinates.draw(rng, members), rng)


def sampled(
    posterior: FeaturePosterior | RecordPosterior,
    folder: Path,
    report: Report,
    plan: FitPlan,
    start: Callable[[], Start],
    monitor: Callable[[Array], Array] | None = None,
) -> Sampling:
    """Draws of a posterior, going on from the folder's saved state if there is one."""
    decided = json.dumps(
        {key: value for key, value in plan.items() if key not in ("thorough", "most_steps", "effects")}, sort_keys=True
    )
    fingerprint = {
        "plan": hashlib.sha256(decided.encode()).hexdigest(),
        "code": code_sha256(),
    }
    report(0.01, "finding starting points")
    begin = start()
    rule = stopping_rule(plan)
    share = 0.0

    def show_stage(stage: Stage) -> None:
        nonlocal share
        if stage.phase == "warm-up":
            share = max(share, 0.01 + (WARM - 0.01) * stage.part)  # waits where more is expected than before
            report(share, f"warm-up, {stage.steps} steps")
            return
        expected = expected_steps(stage, rule)
        share = max(share, WARM + (DRAWN - WARM) * stage.steps / expected)
        report(share, f"sampling, {stage.steps} of about {expected} steps")

    return sample(
        posterior,
        begin,
        walkers=_walkers(posterior.ndim, 0 if is_published(plan["campaign"]) else len(begin.population)),
        seed=int(np.random.SeedSequence([plan["seed"], number_of(folder.name)]).generate_state(1)[0]),
        rule=rule,
        checkpoint=Checkpoint(folder / "state", fingerprint),
        progress=show_stage,
        workers=processes,  # those that other cases leave idle share the ensembles of this one
        monitor=monitor,
    )


def expected_steps(stage: Stage, rule: StoppingRule) -> int:
    """Steps of each ensemble after which a run will have the draws that its rule asks for, or will give up.

    From the latest verdict: effective draws grow with the steps, and what R-hat has above 1 shrinks with them. Before
    the first, from what the warm-up lets expect.
    """
    verdict = stage.verdict
    if verdict is None or not stage.part > 0.0:
        needed = max(rule.taus * stage.tau, stage.least)
    elif verdict.converged:
        needed = stage.steps
    else:
        apart = float(np.nanmax(verdict.r_hat) - 1.0) / (rule.r_hat - 1.0)
        needed = verdict.steps * max(1.2, 1.0 / stage.part, apart)  # the next verdict comes a fifth later
    return math.ceil(max(stage.steps, min(needed, rule.max_steps)))


def _walkers(ndim: int, known: int) -> int:
    """Walkers of an ensemble, a multiple of 32 to fill the lanes of the kernel; fewer where independent draws of the
    posterior are known, the more of them the more coordinates: most moves are then drawn from what they show, not from
    other walkers.
    """
    few = (known > 0 and ndim <= 12) or (known >= 512 and ndim <= 16)
    return 32 if few else 64 * math.ceil(ndim / 32)


def number_of(name: str) -> int:
    """A number that belongs to a name: tasks get seeds of their own, whatever their order."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")


def shaped(values: Array, sampling: Sampling) -> Array:
    """Values of all draws as (ensembles, steps, walkers)."""
    return np.reshape(values, sampling.draws.shape[:3])
