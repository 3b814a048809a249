"""What an effect is: a family of formulas for one physical cause that the nominal model leaves out.

The author of an effect writes one file in this folder (or in a folder of their own, `--effects DIR`) that defines
`EFFECT`. Its duties:

1. Name, title, site and a summary in one line; what it looks like in a record; which nominal terms can hide it; its
   source.
2. One variant or more: the formula, its parameters (unit, prior and the reason for it) and the functions below.
3. A parameter with a `null` makes the effect vanish there: the record is then that of the bare rig to 1e-12 of its
   peak. A variant that replaces the nominal friction says so (`replaces_friction`) and has no null.
4. Functions marked "kernel" are decorated with `vector_math.lane`: floats in, floats out, arithmetic, abs, min, max,
   conditional expressions and the functions of rig/vector_math.py only (no `math`, no loops, no arrays), so that they
   vectorise.

Nothing else has to be edited: registry, kernels, priors, ranking, tests and report read these records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.priors.distributions import Distribution, LogUniform

Site = Literal["ground1", "bearings", "interface", "ground2", "release", "sensor"]
SITES: tuple[Site, ...] = ("ground1", "bearings", "interface", "ground2", "release", "sensor")
SITE_TITLES: dict[str, str] = {
    "ground1": "spring to ground", "bearings": "bearings", "interface": "between the bodies",
    "ground2": "secondary alone", "release": "release", "sensor": "sensors",
}  # fmt: skip
"""Site -> what it is in a few words, beside its name wherever a person reads it."""
Kernel = Callable[..., Any]
MOST_PARAMETERS = 12


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect's formula.

    `null` is the value at which the effect vanishes, None for a parameter of shape. `prior` must be proper: the
    probability of the effect depends on its width, so `reason` says where that comes from.
    """

    name: str
    unit: str
    meaning: str
    prior: Distribution
    reason: str
    null: float | None = None


Need = Literal["coupled", "magnet", "linear_nominal", "no_rubbing", "spring"]
NEEDED: dict[Need, str] = {
    "coupled": "coupled trials", "magnet": "a magnet (magnet_pull and magnet_radius)",
    "linear_nominal": "diagnose --nominal linear (else the model has it)",
    "no_rubbing": "a model without friction between the bodies (mu = 0)",
    "spring": "a spring to ground, not a pendulum",
}  # fmt: skip
"""What a rig must have for an effect -> in words."""


@dataclass(frozen=True)
class Variant:
    """One formula of an effect, with the functions that compute it. Hooks not used keep their neutral defaults.

    Kernel hooks (see the numbered duties of this module); `p` is a tuple of twelve floats, the effect's parameters in
    order and zeros; `rig` has the fields of `equations.Rig` (J1 ... nu, theta0, slope):

    torque : (t, th1, th2, w1, w2, z1, z2, p, rig) -> (Q1, Q2), N m added on the right-hand side; t in s since release
    rate : the same arguments -> (dz1, dz2), rates of the memory states
    start : (p, rig) -> (z1, z2), memory at release
    sense : (h, u1, u2, y1, y2, s1, s2, p, first) -> (m1, m2, s1, s2): true readings y now and u an internal step h
        (s) ago, sensor states s; m is what the channels show. At the first reading after release h = 0 and
        first = 1.0, and u is the reading at rest. With `sensor_states` = 2 it takes s1, s2, v1, v2 and gives them back,
        with 3 also r1, r2.

    Python hooks, vectorised over n parameter vectors; `p` maps parameter names to arrays (n,):

    lag : (p) -> (lag1, lag2), seconds by which each channel lags
    amend : (parameters, p) -> parameters, changes to the rig's own constants or to its start
    """

    name: str
    formula: str
    parameters: tuple[EffectParameter, ...]
    torque: Kernel | None = None
    couples: Literal["bodies", "interface", "all"] = "all"
    """What the torque depends on: "bodies": Q1 on th1, w1 and Q2 on th2, w2; "interface": equal and opposite, on
    th1 - th2 and w1 - w2; "all": anything. The narrower, the cheaper the Jacobian."""
    in_air: bool = False
    """Whether a drag is that of the air around the bodies, not of bearings in the ground."""
    timed: bool = False
    """Whether torque or rate depend on t."""
    rate: Kernel | None = None
    start: Kernel | None = None
    memory: int = 0
    """Number of memory states, 0 to 2; with `rate`."""
    memory_scale: tuple[float, ...] = ()
    """For each memory state, the change that matters as much as 1 rad/s of velocity does: weighs its error."""
    sense: Kernel | None = None
    sensor_states: Literal[1, 2, 3] = 1
    """Number of states of each channel's sensor: the order of a filter."""
    lag: Callable[[Mapping[str, Any]], tuple[Any, Any]] | None = None
    amend: Callable[[Mapping[str, Any], Mapping[str, Any]], Mapping[str, Any]] | None = None
    lets_go: str = ""
    """Name of the parameter that is the time a release takes, if there is one: a trial's own time is added to it."""
    late: float = 0.0
    """By how much what the records show begins late, over the first parameter, if clocks that are late may hide it."""
    replaces_friction: bool = False
    """The variant brings its own friction between the faces in place of the nominal mu N R tanh."""
    starts: tuple[tuple[float, ...], ...] = ()
    """Points from which a search begins: cover the shapes that the formula can take, both signs where both occur."""
    uncoupled: bool = True
    """Whether the effect acts on the uncoupled rig too; none does that `needs` the coupled one, but sensors' do."""
    needs: tuple[Need, ...] = ()
    """What a rig must have for this formula, beside what the effect itself needs."""
    wears: bool = False
    """Whether it grows for as long as the rig moves, so that a driven rig has no steady state with it."""

    def __post_init__(self) -> None:
        if len(self.parameters) > MOST_PARAMETERS:
            raise ValueError(f"variant {self.name}: at most {MOST_PARAMETERS} parameters, got {len(self.parameters)}")
        if self.memory not in (0, 1, 2) or len(self.memory_scale) != self.memory:
            raise ValueError(f"variant {self.name}: memory must be 0, 1 or 2 with one memory_scale for each state")
        if any(len(start) != len(self.parameters) for start in self.starts):
            raise ValueError(f"variant {self.name}: each of `starts` needs one number per parameter")

    @property
    def null(self) -> tuple[float, ...] | None:
        """Parameter values at which the effect vanishes (shape parameters at their prior median), None if none."""
        if all(parameter.null is None for parameter in self.parameters):
            return None
        return tuple(
            float(parameter.prior.ppf(0.5)) if parameter.null is None else parameter.null
            for parameter in self.parameters
        )

    @property
    def fades(self) -> bool:
        """Whether a factor on the distance from the null makes the effect smaller, down to nothing.

        On a logarithmic scale (a sensor's range, say) the null is far away and no factor leads there.
        """
        return self.null is not None and not any(isinstance(p.prior, LogUniform) for p in self.parameters)

    def faded(self, point: Sequence[float], share: float) -> tuple[float, ...]:
        """A point brought to `share` of its distance from the null; what only sets the shape stays as it is."""
        return tuple(
            x if p.null is None or isinstance(p.prior, LogUniform) else p.null + share * (x - p.null)
            for p, x in zip(self.parameters, point, strict=True)
        )

    @property
    def has_kernel(self) -> bool:
        """Whether the variant changes the compiled kernel (else it works through `lag` and `amend` alone)."""
        return self.torque is not None or self.rate is not None or self.sense is not None or self.replaces_friction


@dataclass(frozen=True)
class Effect:
    """A named candidate for what the nominal model leaves out: what a verdict names."""

    name: str
    site: Site
    summary: str
    looks_like: str
    hides_behind: tuple[str, ...]
    """Nominal parameters that can take its place."""
    source: str
    variants: tuple[Variant, ...]
    needs: tuple[Need, ...] = ()
    """What a rig must have for the effect to be possible; "linear_nominal": only offered with `--nominal linear`;
    "no_rubbing": there, and where the nominal model has no dry friction between the bodies."""
    exact: bool = False
    """Whether its formula is a definition, such as a factor on a constant, not one of many that a cause may follow."""
    title: str = ""
    """What it is in a few words of a torsional rig, beside its name wherever a person reads it."""
    alike: frozenset[str] = field(default_factory=frozenset)
    """Effects that agree with it to first order (a class): a verdict inside the class is right."""
    law: Any = None
    """What was learnt and from which rig (_law.Law), for an effect that comes from the file of a learnt law."""

    def __post_init__(self) -> None:
        # Of what needs the coupled rig, the uncoupled one shows nothing, but for what the first channel reads.
        if "coupled" in self.needs and self.site != "sensor":
            object.__setattr__(self, "variants", tuple(replace(v, uncoupled=False) for v in self.variants))

    def needs_in_words(self) -> str:
        """What a rig must have for the effect, empty where any rig can have it."""
        released = ("trials released from rest",) if self.site == "release" else ()
        return " and ".join([*(NEEDED[need] for need in self.needs), *released])

    def variant(self, name: str) -> Variant:
        """The variant of that name; KeyError if there is none."""
        return {v.name: v for v in self.variants}[name]


def parameter_table(variant: Variant, values: Mapping[str, Any]) -> NDArray[np.float64]:
    """Values of a variant's parameters as rows, (MOST_PARAMETERS, n), zeros below those it has.

    Raises
    ------
    KeyError
        if one of its parameters is missing or one is unknown.
    """
    names = [parameter.name for parameter in variant.parameters]
    unknown = set(values) - set(names)
    missing = set(names) - set(values)
    if unknown or missing:
        raise KeyError(f"{variant.name}: takes {names}; unknown {sorted(unknown)}, missing {sorted(missing)}")
    columns = np.broadcast_arrays(*[np.atleast_1d(np.asarray(values[name], float)) for name in names] or [np.zeros(1)])
    table = np.zeros((MOST_PARAMETERS, columns[0].size))
    for row in range(len(names)):
        table[row] = columns[row]
    return table
