"""What acts on a driven rig beside the nominal model: the effects of a fit, or a learnt law."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.effects import EFFECTS, Effect, Variant, names_in
from bayes_damper.effects._law import Law, driven_variant
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.rig.units import in_words_of
from bayes_damper.simulation.composition import compose
from bayes_damper.tuning.draws import SIZE, Draws, Origin

Array = NDArray[np.float64]
_SECONDS = {"s": 1, "Hz": -1, "kg": 2}  # kg = N s^2/m, with torques and angles as they are
_NOT_DRIVEN = {"sensor": "the sensors", "release": "the release"}


@dataclass(frozen=True)
class Acting:
    """A formula that acts on the driven rig; law : that it was learnt as, if it was.

    label : what stands before the names of its numbers among the draws, behind `effect.`; apart : the formula without
    the secondary, where not all of it acts there.
    """

    variant: Variant
    law: Law | None = None
    label: str = ""
    apart: Variant | None = None

    @classmethod
    def of_law(cls, law: Law) -> Acting:
        """A learnt law."""
        return cls(driven_variant(law), law)

    def on_rig(self, coupled: bool) -> Acting | None:
        """What of it acts on the rig with the secondary, or on the primary alone."""
        if coupled:
            return self
        return replace(self, variant=self.apart or self.variant) if self.variant.uncoupled else None

    def numbers(self, draws: Draws, scale: Array) -> dict[str, Array]:
        """The formula's numbers for each draw and frequency, with time `scale` (n, n_frequencies) times as fast.

        Each is multiplied by the power of `scale` that its unit has of seconds: the equation of motion is then the
        same, because formulas have no numbers with a unit but their parameters and the rig's.
        """
        if self.law is not None:
            size = np.asarray(draws.get(SIZE, np.ones(len(scale))))[:, None]
            return {"size": np.broadcast_to(size, scale.shape).ravel(), "pace": scale.ravel()}
        return {
            p.name: (draws[OF_EFFECT + self.label + p.name][:, None] * scale ** seconds_in(p.unit)).ravel()
            for p in self.variant.parameters
        }


def seconds_in(unit: str) -> int:
    """The power of seconds in a unit such as "N m s/rad", torques and angles taken as they are."""

    def power(text: str) -> int:
        return sum(_SECONDS.get(name, 0) * int(n or 1) for name, n in re.findall(r"([A-Za-z]+)(?:\^(\d+))?", text))

    above, _, below = unit.partition("/")
    return power(above) - power(below)


def acting_of(origin: Origin, draws: Draws) -> tuple[Acting | None, Draws, str]:
    """The effect of a fit, or both, as on a driven rig, the draws with it, and a sentence on what becomes of it.

    Effects of sensors and of the release are not on a driven rig, and what wears has no steady state. One that amends
    the rig's constants, a wrong stiffness say, does so in the draws.
    """
    acting: dict[str, Variant] = {}
    named, notes = [], []
    for name in names_in(origin.effect or None):
        variant, draws, note = _part(name, origin, draws)
        if variant is None:
            notes.append(note)
        else:
            acting[name] = variant
            named.append(_named(name, origin))
    if not acting:
        return None, draws, " ".join(notes)
    which = f"effect {named[0]}" if len(named) == 1 else f"effects {' and '.join(named)}"
    notes.append(
        f"The driven rig has the {which}, as in the fit; the linear model, and with it the search for the best design, "
        f"leaves {'it' if len(named) == 1 else 'them'} out."
    )
    if len(acting) == 1:
        ((name, variant),) = acting.items()
        return Acting(variant, label=_label(name, origin)), draws, " ".join(notes)
    return _together(acting), draws, " ".join(notes)


def _together(acting: dict[str, Variant]) -> Acting:
    """Two formulas at once, in the order in which the kernel has room for them: the fit had it."""
    both, apart = (
        next(
            found
            for names in (tuple(acting), tuple(reversed(acting)))
            if (found := compose(*(acting[n] for n in names), coupled=coupled, labels=(names[0], names[1])))
        )
        for coupled in (True, False)
    )
    return Acting(both, apart=apart)


def _part(name: str, origin: Origin, draws: Draws) -> tuple[Variant | None, Draws, str]:
    """The formula of one of a fit's effects if it acts on a driven rig, the draws, and else what becomes of it."""
    effect = EFFECTS.get(name)
    variant = None if effect is None else formula_of(effect, origin, draws)
    left_out = f"The fit has the effect {_named(name, origin)} too, which is left out here: "
    if effect is None or variant is None:
        why = "only effects of the library and learnt laws are driven" if effect is None else "fit it again"
        judged = "without it" if _label(name, origin) else "by the nominal model alone"
        return None, draws, f"{left_out}{why}; the design is judged {judged}."
    if effect.site in _NOT_DRIVEN:
        return None, draws, f"{left_out}it belongs to {_NOT_DRIVEN[effect.site]}, and a driven rig does not have it."
    if variant.wears:
        why = "it grows for as long as the rig moves, so a driven rig has no steady state with it."
        return None, draws, left_out + why
    if variant.has_kernel:
        return variant, draws, ""
    if variant.amend is not None:
        of_effect = OF_EFFECT + _label(name, origin)
        draws = {**draws, **variant.amend(draws, {p.name: draws[of_effect + p.name] for p in variant.parameters})}
    return None, draws, f"The rig has the effect {_named(name, origin)}, as in the fit."


def _named(name: str, origin: Origin) -> str:
    """An effect with what it is, where the library knows it."""
    title = in_words_of(EFFECTS[name].title, origin.kind) if name in EFFECTS else ""
    return f"{name} ({title})" if title else name


def _label(name: str, origin: Origin) -> str:
    """What stands before the names of an effect's numbers: nothing where the fit has no other effect."""
    return f"{name}." if "+" in origin.effect else ""


def formula_of(effect: Effect, origin: Origin, draws: Draws) -> Variant | None:
    """The formula of an effect that a fit took, if its draws hold the numbers of it."""
    label = _label(effect.name, origin)
    found = [v for v in effect.variants if _took(origin.formula, f"{effect.name}: {v.formula}" if label else v.formula)]
    return next((v for v in found if all(OF_EFFECT + label + p.name in draws for p in v.parameters)), None)


def _took(formula: str, part: str) -> bool:
    """Whether a fit's formula is this one, or has it beside another."""
    return formula == part or formula.startswith(f"{part}; ") or formula.endswith(f"; {part}")
