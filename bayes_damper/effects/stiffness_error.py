"""The stiffness of the spring to ground is not the declared one.

    k1t -> k1t (1 + e)    or    k1t -> k1t + k

Source: Augustine (2013), Table 4, p. 14: natural frequencies lie 6 % (low stiffness) and 2 % (high) below design.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_damper.effects.base import Effect, EffectParameter, Variant
from bayes_damper.priors.distributions import Normal


def factor(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same relative error of all springs."""
    return {**parameters, "k1t": np.asarray(parameters["k1t"]) * (1.0 + p["error"])}


def addition(parameters: Mapping[str, Any], p: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same stiffness missing, or in addition, whichever springs are mounted."""
    return {**parameters, "k1t": np.asarray(parameters["k1t"]) + p["stiffness"]}


EFFECT = Effect(
    name="stiffness_error",
    site="ground1",
    title="wrong stiffness of the spring to ground",
    summary="The stiffness of the spring to ground is off by more than its declaration allows.",
    looks_like="All periods are off by one factor from the first to the last, in coupled and uncoupled trials alike.",
    hides_behind=("k1t", "theta0"),
    source="Augustine (2013), Table 4, p. 14.",
    exact=True,
    variants=(
        Variant(
            name="factor",
            formula="k1t -> k1t (1 + e)",
            parameters=(
                EffectParameter(
                    "error", "1", "Relative error of k1t.", Normal(0.0, 0.08, -0.5, 0.5),
                    "The thesis's natural frequencies ask for 4 to 14 % less than its nominal stiffness.", 0.0,
                ),
            ),
            amend=factor,
            starts=((0.05,), (-0.05,), (0.002,), (0.0002,), (-0.0002,)),
        ),
        Variant(
            name="addition",
            formula="k1t -> k1t + k",
            parameters=(
                EffectParameter(
                    "stiffness", "N m/rad", "Stiffness in addition to the declared one.", Normal(0.0, 0.6, -3.0, 3.0),
                    "The same 4 to 14 %, of a stiffness of 8 N m/rad.", 0.0,
                ),
            ),
            amend=addition,
            starts=((0.4,), (-0.4,), (0.015,), (0.0015,), (-0.0015,)),
        ),
    ),
)  # fmt: skip
