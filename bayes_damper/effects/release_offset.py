"""The secondary is not released at the angle of the primary.

    theta2(0) = theta1(0) + d    or    theta1(0) (1 + e)

Source: Augustine (2013), p. 10 (both bars are set by hand and eye before the release).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal


def offset(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same offset in all trials."""
    return {**parameters, "theta2_0": np.asarray(parameters["theta2_0"]) + p["offset"]}


def share(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
    """An offset in proportion to the release angle."""
    return {**parameters, "theta2_0": np.asarray(parameters["theta2_0"]) * (1.0 + p["share"])}


EFFECT = Effect(
    name="release_offset",
    site="release",
    title="secondary at another angle at release",
    summary="At release the secondary stands at another angle than the primary.",
    looks_like="The secondary accelerates unlike the primary in the first milliseconds, in coupled trials only.",
    hides_behind=("theta0", "k2t", "mu"),
    source="Augustine (2013), p. 10.",
    needs=("coupled",),
    exact=True,
    variants=(
        Variant(
            name="offset",
            formula="theta2(0) = theta1(0) + d",
            parameters=(
                EffectParameter(
                    "offset", "rad", "Angle of the secondary less that of the primary.", Normal(0.0, 0.015),
                    "Bars aligned by eye agree to one or two millimetres at a radius of 0.1 m.", 0.0,
                ),
            ),
            amend=offset,
            starts=((0.01,), (-0.01,), (0.0005,)),
        ),
        Variant(
            name="share",
            formula="theta2(0) = theta1(0) (1 + e)",
            parameters=(
                EffectParameter(
                    "share", "1", "Offset over the release angle.", Normal(0.0, 0.15),
                    "One or two millimetres at a radius of 0.1 m, over release angles of about 0.1 rad.", 0.0,
                ),
            ),
            amend=share,
            starts=((0.1,), (-0.1,), (0.005,)),
        ),
    ),
)  # fmt: skip
