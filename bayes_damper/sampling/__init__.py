"""Sampling of any log density with emcee: a start, independent ensembles, and a verdict on their draws."""

from bayes_damper.sampling.convergence import Diagnostic, StoppingRule, Verdict, diagnose_draws, judge
from bayes_damper.sampling.ensembles import Progress, Sampling, Target, sample
from bayes_damper.sampling.start import Start, annealed_start, resampled_start

__all__ = [
    "Diagnostic",
    "Progress",
    "Sampling",
    "Start",
    "StoppingRule",
    "Target",
    "Verdict",
    "annealed_start",
    "diagnose_draws",
    "judge",
    "resampled_start",
    "sample",
]
