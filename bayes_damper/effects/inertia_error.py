"""The secondary inertia is not the declared one.

    J2 -> J2 (1 + e)

Source: Augustine (2013) prints no J2; the value used follows from omega_n2 on p. 27 to 3 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal


def factor(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
    """The secondary inertia with its relative error."""
    return {**parameters, "J2": np.asarray(parameters["J2"]) * (1.0 + p["error"])}


EFFECT = Effect(
    name="inertia_error",
    site="ground2",
    title="wrong inertia of the secondary",
    summary="The secondary inertia is off by more than its declaration allows.",
    looks_like="Coupled trials only: the secondary's acceleration is off by one factor while both torques fit.",
    hides_behind=("J2", "k2t", "mu"),
    source="Augustine (2013), p. 27 and Table 1, p. 9.",
    needs=("coupled",),
    exact=True,
    variants=(
        Variant(
            name="factor",
            formula="J2 -> J2 (1 + e)",
            parameters=(
                EffectParameter(
                    "error", "1", "Relative error of J2.", Normal(0.0, 0.1, -0.6, 1.0),
                    "Inertias computed from drawings miss bolts and magnets: some per cent to a tenth and more.", 0.0,
                ),
            ),
            amend=factor,
            starts=((0.08,), (-0.08,), (0.003,), (0.0003,), (-0.0003,)),
        ),
    ),
)  # fmt: skip
