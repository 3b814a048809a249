"""What a tuned damper would do, with uncertainty: insertion loss and resonance shift of a design over a posterior.

The insertion loss (eq. 24, p. 29) is 20 log10 of the primary's peak accelerance without the secondary over the peak
with it, each peak being the highest over all frequencies. Two models answer:

- the linear one (eq. 23), exactly, from k2t, c2t and the viscous bearings;
- the nonlinear one, by integrating the rig under a harmonic torque of stated amplitude until it repeats itself, and
  taking the fundamental component. Dry friction makes its loss depend on the amplitude.

A design changes the secondary's inertia J2, the stiffness k2t and the damping c2t of the coupling, the radius R at
which the magnets sit, and the dry friction between the bodies, as a torque or by the magnet's pull N0. R acts through
k2t = k2 R^2 (eq. 21, p. 27), through the friction torque mu N0 R, and, if a part of J2 is the bar itself, through that
part, which grows with R^3.
"""

from __future__ import annotations

from bayes_damper.tuning.acting import Acting
from bayes_damper.tuning.curves import CURVES, Band, Curve, driven_responses, frequency_responses, tuning_curves
from bayes_damper.tuning.draws import AMPLITUDES, OF_RELEASE, Origin, chosen_case, complete, origin_of, posterior_draws
from bayes_damper.tuning.optimum import (
    BOUNDS,
    FREE,
    Optimum,
    best_design,
    best_driven,
    shares_of_variance,
    usual_bounds,
)
from bayes_damper.tuning.performance import (
    Design,
    Driven,
    Performance,
    Sweep,
    driven,
    harmonic_response,
    linear_performance,
    linear_rig,
    sweep,
)
from bayes_damper.tuning.result import SCHEMA, TuneResult, tune

__all__ = [
    "AMPLITUDES",
    "BOUNDS",
    "CURVES",
    "FREE",
    "OF_RELEASE",
    "SCHEMA",
    "Acting",
    "Band",
    "Curve",
    "Design",
    "Driven",
    "Optimum",
    "Origin",
    "Performance",
    "Sweep",
    "TuneResult",
    "best_design",
    "best_driven",
    "chosen_case",
    "complete",
    "driven",
    "driven_responses",
    "frequency_responses",
    "harmonic_response",
    "linear_performance",
    "linear_rig",
    "origin_of",
    "posterior_draws",
    "shares_of_variance",
    "sweep",
    "tune",
    "tuning_curves",
    "usual_bounds",
]
