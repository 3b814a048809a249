"""Filters of the sensors of first to third order, exact for a reading that is linear over each internal step."""

from __future__ import annotations

from bayes_damper.rig.vector_math import cos, exp, lane, log, sin


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


@lane
def free_answer(x, zeta):
    """What is left of s and of ds/dx after x, of s = 1 and ds/dx = 0 before, in s'' + 2 zeta s' + s = 0.

    Gives e^(-zeta x) C and e^(-zeta x) S with C = cos(k x), S = sin(k x) / k and k^2 = 1 - zeta^2, or cosh and sinh.
    """
    k = exp(0.5 * log(max(abs(1.0 - zeta * zeta), 1e-8)))
    slow = 0.5 * exp((k - zeta) * x)
    fast = 0.5 * exp(-(k + zeta) * x)
    swings = exp(-zeta * x)
    c_swings = swings * cos(k * x)
    s_swings = swings * sin(k * x)
    rings = zeta < 1.0
    return c_swings if rings else slow + fast, (s_swings if rings else slow - fast) / k


@lane
def low_pass2(h, u, y, s, v, tau, zeta):
    """State s and v = tau ds/dt after a step h (s) of tau^2 s'' + 2 zeta tau s' + s = x, x linear from u to y."""
    x = h / max(tau, 1e-20)
    slope = (y - u) / max(x, 1e-5)
    c, d = free_answer(min(x, 1e3), zeta)
    off = s - (u - 2.0 * zeta * slope)
    moving = v - slope
    s_end = y - 2.0 * zeta * slope + off * c + (moving + zeta * off) * d
    v_end = slope + moving * c - (off + zeta * moving) * d
    # In a step as short as this the differences above cancel, and its series is exact.
    short = x < 1e-5
    s_short = s + x * v + x * x * ((2.0 * u + y) / 6.0 - 0.5 * s - zeta * v)
    v_short = v + x * (0.5 * (u + y) - s - 2.0 * zeta * v)
    return s_short if short else s_end, v_short if short else v_end


@lane
def low_pass3(h, u, y, s, v, r, tau, zeta):
    """States s, v = tau ds/dt and r after a step h (s) of `low_pass2` behind tau dr/dt = x - r, x linear from u to y.

    What drives the two poles is a line and an exponential, which is a pole of theirs at zeta = 1: within 0.001 of it
    zeta counts as that far away.
    """
    x = h / max(tau, 1e-20)
    apart = 1.0 - zeta
    zeta = 1.0 - (max(apart, 1e-3) if apart > 0.0 else min(apart, -1e-3))
    slope = (y - u) / max(x, 1e-3)
    c, d = free_answer(min(x, 1e3), zeta)
    decay = exp(-x)
    left = r - u + slope
    own = left / (2.0 - 2.0 * zeta)
    off = s - (u - (1.0 + 2.0 * zeta) * slope) - own
    moving = v - slope + own
    s_end = y - (1.0 + 2.0 * zeta) * slope + own * decay + off * c + (moving + zeta * off) * d
    v_end = slope - own * decay + moving * c - (off + zeta * moving) * d
    r_end = y - slope + left * decay
    # In a step as short as this the differences above cancel; of its series the terms left out are below rounding.
    r1 = u - r
    xr2 = (y - u) - x * r1  # each with as many x as keep it finite
    s2 = r - s - 2.0 * zeta * v
    s3 = r1 - v - 2.0 * zeta * s2
    xs4 = xr2 - x * (s2 + 2.0 * zeta * s3)
    s_short = s + x * (v + x * (0.5 * s2 + x * (s3 / 6.0 + xs4 / 24.0)))
    v_short = v + x * (s2 + x * (0.5 * s3 + xs4 / 6.0))
    r_short = r + x * (r1 + xr2 * (0.5 - x / 6.0))
    short = x < 1e-3
    return s_short if short else s_end, v_short if short else v_end, r_short if short else r_end


@lane
def follow3(h, u, y, s, v, r, tau, zeta, first):
    """States of a low-pass of third order that showed the rig at rest when it was released, as in `follow`."""
    at_rest = first > 0.5
    s, v, r = u if at_rest else s, 0.0 if at_rest else v, u if at_rest else r
    return low_pass3(h + 1e-6 * first, y if at_rest else u, y, s, v, r, tau, zeta)


@lane
def follow2(h, u, y, s, v, tau, zeta, first):
    """State of a low-pass of second order that showed the rig at rest when it was released, as in `follow`."""
    at_rest = first > 0.5
    return low_pass2(h + 1e-6 * first, y if at_rest else u, y, u if at_rest else s, 0.0 if at_rest else v, tau, zeta)
