"""First-order filters of the sensors, exact for a reading that is linear over each internal step."""

from __future__ import annotations

from bayes_damper.rig.vector_math import exp, lane


@lane
def low_pass(h, u, y, s, tau):
    """State at the end of a step h (s) of tau ds/dt = x - s, where x goes linearly from u to y."""
    x = h / max(tau, 1e-20)
    decay = exp(-x)
    # Both ways to the mean of the decay are computed, so that choosing one needs no branch (which would not vectorise).
    quotient = (1.0 - decay) / max(x, 1e-3)
    series = 1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0))
    mean = quotient if x > 1e-3 else series
    return y - (y - u) * mean + (s - u) * decay


@lane
def follow(h, u, y, s, tau, first):
    """Reading of a low-pass that showed the rig at rest when it was released, 1 us before the first reading.

    That microsecond stands for a release that is never quite sudden, and makes tau = 0 the unfiltered reading.
    """
    at_rest = first > 0.5
    return low_pass(h + 1e-6 * first, y if at_rest else u, y, u if at_rest else s, tau)
