"""What acts on a driven rig beside the nominal model: the effect of a fit, or a learnt law."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.effects import EFFECTS, Effect, Variant
from bayes_damper.effects._law import Law, driven_variant
from bayes_damper.rig.units import in_words_of
from bayes_damper.tuning.draws import OF_EFFECT, SIZE, Draws, Origin

Array = NDArray[np.float64]
_SECONDS = {"s": 1, "Hz": -1, "kg": 2}  # kg = N s^2/m, with torques and angles as they are
_NOT_DRIVEN = {"sensor": "the sensors", "release": "the release"}


@dataclass(frozen=True)
class Acting:
    """A formula that acts on the driven rig; law : that it was learnt as, if it was."""

    variant: Variant
    law: Law | None = None

    @classmethod
    def of_law(cls, law: Law) -> Acting:
        """A learnt law."""
        return cls(driven_variant(law), law)

    def numbers(self, draws: Draws, scale: Array) -> dict[str, Array]:
        """The formula's numbers for each draw and frequency, with time `scale` (n, n_frequencies) times as fast.

        Each is multiplied by the power of `scale` that its unit has of seconds: the equation of motion is then the
        same, because formulas have no numbers with a unit but their parameters and the rig's.
        """
        if self.law is not None:
            size = np.asarray(draws.get(SIZE, np.ones(len(scale))))[:, None]
            return {"size": np.broadcast_to(size, scale.shape).ravel(), "pace": scale.ravel()}
        return {
            p.name: (draws[OF_EFFECT + p.name][:, None] * scale ** seconds_in(p.unit)).ravel()
            for p in self.variant.parameters
        }


def seconds_in(unit: str) -> int:
    """The power of seconds in a unit such as "N m s/rad", torques and angles taken as they are."""

    def power(text: str) -> int:
        return sum(_SECONDS.get(name, 0) * int(n or 1) for name, n in re.findall(r"([A-Za-z]+)(?:\^(\d+))?", text))

    above, _, below = unit.partition("/")
    return power(above) - power(below)


def acting_of(origin: Origin, draws: Draws) -> tuple[Acting | None, Draws, str]:
    """The effect of a fit as it acts on a driven rig, the draws with it, and a sentence on what becomes of it.

    Effects of sensors and of the release are not on a driven rig, and what wears has no steady state. One that amends
    the rig's constants, a wrong stiffness say, does so in the draws.
    """
    if not origin.effect:
        return None, draws, ""
    effect = EFFECTS.get(origin.effect)
    variant = None if effect is None else formula_of(effect, origin, draws)
    title = "" if effect is None else in_words_of(effect.title, origin.kind)
    named = f"the effect {origin.effect}{f' ({title})' if title else ''}"
    left_out = f"The fit has {named} too, which is left out here: "
    if effect is None or variant is None:
        why = "only effects of the library and learnt laws are driven" if effect is None else "fit it again"
        return None, draws, f"{left_out}{why}; the design is judged by the nominal model alone."
    if effect.site in _NOT_DRIVEN:
        return None, draws, f"{left_out}it belongs to {_NOT_DRIVEN[effect.site]}, and a driven rig does not have it."
    if variant.wears:
        why = "it grows for as long as the rig moves, so a driven rig has no steady state with it."
        return None, draws, left_out + why
    if not variant.has_kernel:
        if variant.amend is not None:
            draws = {**draws, **variant.amend(draws, {p.name: draws[OF_EFFECT + p.name] for p in variant.parameters})}
        return None, draws, f"The rig has {named}, as in the fit."
    acts = f"The driven rig has {named}, as in the fit; the linear model, and with it the search for the best design, "
    return Acting(variant), draws, acts + "leaves it out."


def formula_of(effect: Effect, origin: Origin, draws: Draws) -> Variant | None:
    """The formula of an effect that a fit took, if its draws hold the numbers of it."""
    found = [v for v in effect.variants if v.formula == origin.formula]
    return next((v for v in found if all(OF_EFFECT + p.name in draws for p in v.parameters)), None)
