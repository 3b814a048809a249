"""One channel lags behind the other.

    m(t) = y(t - T)    on channel 1 or on channel 2
    m2(t) = y2(t + T)  where a late channel 1 gives the instant of the release

Source: Wilson (2005), Sensor Technology Handbook, ch. 4 (a multiplexed converter reads one channel after the other).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import HalfNormal


def channel1(p: Mapping[str, Any]) -> tuple[Any, Any]:
    """The primary's channel is late."""
    return p["time"], 0.0


def channel2(p: Mapping[str, Any]) -> tuple[Any, Any]:
    """The secondary's channel is late."""
    return 0.0, p["time"]


def channel2_early(p: Mapping[str, Any]) -> tuple[Any, Any]:
    """The primary's channel is late, and the instant of the release was read from it: so the secondary's is early."""
    return 0.0, -p["time"]


PARAMETERS = (
    EffectParameter(
        "time", "s", "Lag of the channel.", HalfNormal(0.002),
        "Multiplexing and filters shift a channel by a fraction of a sample to a few samples of 1 ms.", 0.0,
    ),
)  # fmt: skip
# The smallest lag carries no reading across the release, where an acceleration jumps: there the response is a slope.
STARTS = ((0.00001,), (0.0001,), (0.0007,), (0.002,), (0.004,))

EFFECT = Effect(
    name="sensor_delay",
    site="sensor",
    title="one channel later than the other",
    summary="One channel is recorded later than the other.",
    looks_like="One channel is shifted in time by a constant amount, the release included; the other one fits.",
    hides_behind=("delay",),
    source="Wilson (2005), Sensor Technology Handbook, ch. 4.",
    needs=("coupled",),
    exact=True,
    variants=(
        Variant(
            name="channel1",
            formula="m1(t) = y1(t - T)",
            parameters=PARAMETERS,
            lag=channel1,
            starts=STARTS,
        ),
        Variant(
            name="channel2",
            formula="m2(t) = y2(t - T)",
            parameters=PARAMETERS,
            lag=channel2,
            starts=STARTS,
            uncoupled=False,
        ),
        Variant(
            name="channel2_early",
            formula="m2(t) = y2(t + T)",
            parameters=PARAMETERS,
            lag=channel2_early,
            starts=STARTS,
            uncoupled=False,
        ),
    ),
)
