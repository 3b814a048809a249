"""Fitting: from published features or recorded trials to posteriors per case, and of all cases together.

`fit` is what `bayes-damper fit` calls. Each case is a task of `runs` in a folder of its own, so that cases run side by
side, and an interrupted fit goes on where it stopped.
"""

from __future__ import annotations

from bayes_damper.fit.draw import DRAWN, WARM, expected_steps, sampled
from bayes_damper.fit.plan import OtherRun, kept, plan_fit, plan_in, recorded_experiment, refuse_changes, start_run
from bayes_damper.fit.published import fit_published_case, published_posterior
from bayes_damper.fit.recorded import fit_recorded_cases
from bayes_damper.fit.result import Fit, finish_fit, fit, load_fit

__all__ = [
    "DRAWN",
    "WARM",
    "Fit",
    "OtherRun",
    "expected_steps",
    "finish_fit",
    "fit",
    "fit_published_case",
    "fit_recorded_cases",
    "kept",
    "load_fit",
    "plan_fit",
    "plan_in",
    "published_posterior",
    "recorded_experiment",
    "refuse_changes",
    "sampled",
    "start_run",
]
