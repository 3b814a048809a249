"""Why the cases differ: what they share, what is each one's own, and what only looks different.

`variability` takes the results of a fit. Three answers are compared by evidence and by data that they have not seen:
one parameter set for all cases, one for each, and values scattered about a common mean (pooling.py). Then the scatter
of the effective linear k2t and c2t over the cases, which the thesis took for nonlinearity (pp. 19-22), is taken apart:
the same friction seen at another amplitude, scatter of the measurement, and real differences between the cases.

Published features are sampled directly by tempering; recorded trials, which determine each case to a few per cent, by
the Laplace approximation of each case's calibration, in closed form. In both the draws of the fit are also used again
by importance weights, and the two ways compared.
"""

from __future__ import annotations

from bayes_damper.variability.answer import Variability, finish_variability, variability

__all__ = ["Variability", "finish_variability", "variability"]
