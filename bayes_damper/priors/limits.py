"""What mechanics leaves possible of a parameter, held against the rig and the records of a campaign.

Each limit lies far above what any rig shows: a prior beyond it has a wrong unit, a wrong power of ten or another
parameter's number. What must not be negative is read with the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_damper.campaign import Campaign
from bayes_damper.campaign.records import DERIVATIVE
from bayes_damper.campaign.structure import natural_period
from bayes_damper.priors.distributions import Distribution

_TORQUES = 100.0  # friction over the largest torque: beyond 1 the bodies hardly move
_DAMPINGS = 100.0  # damping over the critical one: a swing would take as many periods to creep back
_STIFFNESSES = 1e6  # a coupling over the spring: the two bodies are one
_WIDTHS = 1e6  # speeds over the one at which friction changes its sign: usual fits have 100, readings show up to 1e4
_ANGLES = 20.0  # a release over the largest one declared or read: degrees for radians are 57
_NOISES = 1e3  # a noise over the largest reading
CURVES = (-1.0, 2.0)
"""Of `tail`: a tanh has 0, an arctangent 1; farther out the curve between them overshoots."""
OF_CURVES = f"curves of friction have {CURVES[0]:g} to {CURVES[1]:g}"


@dataclass(frozen=True)
class _Limit:
    """The largest magnitude of a parameter, what it is compared with, and what follows beyond it."""

    most: float
    what: str


def beyond(where: str, values: Mapping[str, Sequence[Distribution | float]], campaign: Campaign) -> Iterator[str]:
    """Sentences on the parameters (name -> values and priors in SI units) of which too much lies beyond what can be."""
    limits = _limits(campaign)
    still = math.inf if any(t.driven for t in campaign.trials) else limits["drag"].most / _TORQUES
    for name, given in values.items():
        for said in (_cannot_be(name, value, limits, still) for value in given):
            if said:
                yield f"{where}: {name}: {said}"


def _cannot_be(name: str, value: Distribution | float, limits: Mapping[str, _Limit], still: float) -> str | None:
    """Why a fixed value or a prior lies beyond what can be; still : the largest fixed drag with which a rig moves."""
    for x, given_as, cause in _held(value):
        if name == "tail" and not CURVES[0] <= x <= CURVES[1]:
            return f"{given_as} cannot be: {OF_CURVES}"
        if name == "drag" and isinstance(value, float) and x > still:
            return (
                f"fixed at {x:g}, above the largest torque of the records, {still:.3g}: nothing would move; check its "
                "unit, or give a prior"
            )
        if name in limits and abs(x) > limits[name].most:
            most, what = limits[name].most, limits[name].what
            return f"{given_as} cannot be: above {most:.3g}, {what}; check its {cause}"
    return None


def _held(value: Distribution | float) -> Iterator[tuple[float, str, str]]:
    """What of a fixed value or a prior is held against the limits, with its name and what makes it too large."""
    if isinstance(value, float):
        yield value, f"{value:g}", "unit"
        return
    quantiles = ((0.5, "a median", "unit"), (0.25, "a lower quartile", "width"), (0.75, "an upper quartile", "width"))
    for share, name, cause in quantiles:
        x = float(value.ppf(share))
        yield x, f"{name} of {x:g}", cause


def _limits(campaign: Campaign) -> dict[str, _Limit]:
    """The limits of one campaign, by parameter."""
    rig, trials = campaign.rig, campaign.trials
    omegas = [2.0 * math.pi / natural_period(rig, t) for t in trials]
    power = DERIVATIVE[campaign.measurement.quantity]
    reach = [0.0 if t.prescribed else float(np.nanmax(np.abs(t.channels))) for t in trials]
    read = [x / omega**power for x, omega in zip(reach, omegas, strict=True)]
    moved = [0.0 if t.motion is None else float(np.max(np.abs(t.motion))) for t in trials]
    declared = [0.0 if t.theta0 is None else abs(t.theta0.value) for t in trials]
    angle = max(*read, *moved, *declared)
    stiffest, inertia = max(t.k1t.value for t in trials), rig.primary_inertia.value
    if rig.secondary_inertia is not None:
        inertia = max(inertia, rig.secondary_inertia.value)
    driving = max(
        (float(np.max(np.abs(x))) for t in trials for x in (t.torque, t.torque2) if x is not None), default=0.0
    )
    torque = max(stiffest * angle, driving)
    critical = 2.0 * math.sqrt(stiffest * inertia)
    speed = angle * max(omegas)
    longest = max(float(np.ptp(t.times)) for t in trials)
    held = f"{_TORQUES:g} times the largest torque of its records, which could not move it"
    creeping = _Limit(_DAMPINGS * critical, f"{_DAMPINGS:g} times critical damping: nothing would swing")
    limits = {
        "drag": _Limit(_TORQUES * torque, held),
        "c1t": creeping, "c2t": creeping, "c3t": creeping,
        "k2t": _Limit(_STIFFNESSES * stiffest, f"{_STIFFNESSES:g} times the stiffest k1t: the two bodies would be one"),
        "theta0": _Limit(_ANGLES * angle, f"{_ANGLES:g} times the largest one of its records"),
        "delay": _Limit(longest, "as long as its longest record, s"),
    }  # fmt: skip
    if speed > 0.0:
        limits["nu"] = _Limit(_WIDTHS / speed, "beyond which no reading and no step in time follows a change of sign")
    pull = (rig.magnet_pull.value if rig.magnet_pull else 0.0) * (rig.bar_radius.value if rig.bar_radius else 1.0)
    if pull > 0.0:
        limits["mu"] = _Limit(_TORQUES * torque / pull, "with which the friction mu N0 R is " + held)
    if not any(t.prescribed for t in trials):
        largest = max(float(np.nanmax(np.abs(t.channels))) for t in trials)
        limits |= dict.fromkeys(
            ("sigma1", "sigma2"), _Limit(_NOISES * largest, f"{_NOISES:g} times the largest reading")
        )
    return limits
