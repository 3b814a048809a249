"""What is fitted: the trials of a campaign with what is declared of the rig, as the calibration sees them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.hum import mains_in
from bayes_damper.campaign import Campaign, Constant, Trial
from bayes_damper.campaign.readings import noise_floor_of
from bayes_damper.campaign.records import (
    DEPARTS,
    DERIVATIVE,
    STEPS_OF_DOUBT,
    Release,
    common_grid,
    crossings,
    evened,
    picks,
    release_of,
    rounding_of,
)
from bayes_damper.effects.base import Effect
from bayes_damper.errors import InputError
from bayes_damper.priors.distributions import Distribution, LogNormal, LogStudent, Normal, Uniform
from bayes_damper.priors.files import PriorSet
from bayes_damper.rig.inputs import Inputs
from bayes_damper.simulation.integrator import LONGEST_STEP
from bayes_damper.simulation.model import Quantity

Array = NDArray[np.float64]
STEPS_PER_PERIOD = 120.0  # at least, of the primary on its spring
SHARPNESS = 200.0
"""nu times the peak speed before any reading is seen: dry friction changes sign within a two hundredth of it."""
LEAST_DIGITS = 3  # of a declared constant that count: 216 may be 216.0, or rounded
ROUNDED = 3e-6  # of a constant that rounding leaves open, below which no record shows it
TAIL = (-0.5, 1.5)
"""Ends of `tail`, between which any is as likely before a reading is seen: of the curves in use for a smoothed sign the
clipped straight line is met best by -0.4, the error function by -0.15, tanh by 0, x / sqrt(1 + x^2) by 1/2, the
arctangent by 1 and x / (1 + |x|) by 1.4 (with nu and a viscous part free, at nu times the peak speed of 20)."""
SKEW = 0.1
"""Of a sampling interval: by how much channels of a logger are usually read apart. Multiplexed ones may be by more."""
OF_ONE_TRIGGER = 0.25  # of the records, that begin late, beyond which it is not chance, and noise may hide it in others


@dataclass(frozen=True)
class TrialRecord:
    """One measured trial, as the calibration sees it.

    times (n,) s; y (channels, n), nan where a reading is missing; k1t: index into Experiment.stiffnesses;
    theta0, theta0_sd: nominal release angle (rad) and its standard uncertainty; inputs: what acted on the rig;
    weight (channels, n): what multiplies the residuals of readings that do not count fully; errors (k, channels, n):
    what independent standard deviations of the inputs' noise do to the readings (input_noise.py);
    spread (channels, n): standard deviation of each reading's noise over that of its channel (noise_spread.py);
    doubt: s by which the release may be off, where that is more than `STEPS_OF_DOUBT` of the clock;
    order: place in the campaign's table, -0.5 of the first trial to 0.5 of the last.
    """

    label: str
    case: str
    coupled: bool
    number: int
    times: Array
    y: Array
    k1t: int
    theta0: float = 0.0
    theta0_sd: float = 0.0
    inputs: Inputs | None = None
    heldout: bool = False
    weight: Array | None = None
    errors: Array | None = None
    doubt: float = 0.0
    spread: Array | None = None
    order: float = 0.0

    def at(self, which: NDArray[np.bool_] | slice) -> TrialRecord:
        """The trial with these of its readings only; inputs stay as they were measured."""
        weight = None if self.weight is None else self.weight[:, which]
        errors = None if self.errors is None else self.errors[:, :, which]
        spread = None if self.spread is None else self.spread[:, which]
        return replace(self, times=self.times[which], y=self.y[:, which], weight=weight, errors=errors, spread=spread)

    def noise(self, sds: Array) -> Array:
        """Standard deviation of the noise of each reading, (channels, n), from those of the channels, (channels,)."""
        return np.repeat(sds[:, None], self.times.size, axis=1) if self.spread is None else sds[:, None] * self.spread

    def steady(self, residual: Array) -> Array:
        """Residuals (channels, n) over the spread of their noise, as if it were the same everywhere."""
        return residual if self.spread is None else np.asarray(residual / self.spread)

    @property
    def prescribed(self) -> bool:
        """Whether the motion of the primary is an input, and its channel reads the reaction."""
        return self.inputs is not None and self.inputs.motion is not None

    @property
    def driven(self) -> bool:
        """Whether a torque, a motion or the ground acts on it while it is recorded."""
        return self.inputs is not None and self.inputs.active

    @property
    def conditions(self) -> tuple[Any, ...]:
        """Equal for repeats: trials of one case and configuration, release and inputs."""
        return self.case, self.coupled, self.theta0, None if self.inputs is None else self.inputs.key

    @property
    def conditions_and_length(self) -> tuple[Any, ...]:
        """Equal for repeats of one record length too, whose residuals can be compared."""
        return *self.conditions, self.times.size


@dataclass(frozen=True)
class Experiment:
    """Trials of one rig, with what is declared about it.

    constants: name (J1 J2 J12 k3t R r N0) -> (value, standard deviation or 0); stiffnesses: (k1t, sd) per declared
    value; start: "rest" from theta0, or "free": angles and velocities at the first sample are inferred.

    priors: parameter -> distribution, or number where it is fixed, in place of the default; levels: parameter ->
    "campaign" (one value for all trials, the default), "case" or "trial"; case_priors: parameter -> case -> prior where
    cases differ; ties: parameter -> the one whose value it takes; rounding: step of each channel whose readings err by
    their rounding alone, 0 for the others; scatter: typical sizes by which things differ from trial to trial, in place
    of the default (scatter.py); trends: parameter that changes with the order of the trials -> prior sd of the natural
    logarithm of its last value over its first (trends.py); fits_all: models are fitted to the held-out trials too, and
    held-out figures come from fits without them (`heldout.unseeing`).
    """

    constants: Mapping[str, tuple[float, float]]
    stiffnesses: tuple[tuple[float, float], ...]
    trials: tuple[TrialRecord, ...]
    quantity: Quantity = "acceleration"
    normal_force: Literal["linear", "constant"] = "linear"
    restoring: Literal["linear", "pendulum"] = "linear"
    start: Literal["rest", "free"] = "rest"
    noise_sd: tuple[float, ...] = ()
    priors: Mapping[str, Distribution | float] = field(default_factory=dict)
    levels: Mapping[str, str] = field(default_factory=dict)
    case_priors: Mapping[str, Mapping[str, Distribution | float]] = field(default_factory=dict)
    ties: Mapping[str, str] = field(default_factory=dict)
    offset_sd: tuple[float, ...] | None = None
    scale_sd: tuple[float, ...] = ()
    lag_sd: tuple[float, ...] = ()
    coupling_law: Literal["constant", "cosine"] = "constant"
    rounding: tuple[float, ...] = ()
    scatter: Mapping[str, float] = field(default_factory=dict)
    trends: Mapping[str, float] = field(default_factory=dict)
    fits_all: bool = False

    @cached_property
    def _stacked(self) -> dict[tuple[int, ...], Array]:
        return {}

    def readings(self, members: tuple[int, ...]) -> Array:
        """Those of trials that share their times, (trials, channels, n), missing ones 0: one array for all problems."""
        if members not in self._stacked:
            y = self._stacked[members] = np.nan_to_num([self.trials[i].y for i in members])
            y.setflags(write=False)
        return self._stacked[members]

    @cached_property
    def _defaults(self) -> dict[str, Distribution]:
        return default_priors(self)

    def prior(self, name: str, case: str) -> Distribution | float:
        """Prior of a nominal parameter for the trials of a case: a distribution, or a number where it is fixed."""
        own = self.case_priors.get(name, {})
        return own[case] if case in own else self.priors[name] if name in self.priors else self._defaults[name]

    @property
    def omegas(self) -> tuple[float, ...]:
        """Angular frequency of the primary on each of the springs, rad/s."""
        return tuple(_omega(k, self.constants["J1"][0]) for k, _ in self.stiffnesses)

    @cached_property
    def hum(self) -> tuple[float | None, ...]:
        """Frequency of the mains, Hz, that each channel picks up, (channels,); None where none shows."""
        quickest = max(self.omegas) / (2.0 * math.pi)
        of_channel = [[(t.times, t.y[c]) for t in self.trials if c < len(t.y)] for c in range(1 + int(self.coupled))]
        return tuple(mains_in(records, quickest) for records in of_channel)

    def rounding_step(self, channel: int) -> float:
        """Step of a channel that errs by its rounding alone, else 0."""
        return self.rounding[channel] if channel < len(self.rounding) else 0.0

    @property
    def coupled(self) -> bool:
        """Whether any trial is coupled."""
        return any(trial.coupled for trial in self.trials)

    @property
    def magnet(self) -> bool:
        """Whether friction at the interface is possible."""
        return self.coupled and self.constants.get("N0", (0.0, 0.0))[0] > 0.0

    @property
    def face(self) -> bool:
        """Whether a magnet with a face is declared, so that effects of a magnet are possible."""
        return self.magnet and "r" in self.constants

    @property
    def ends_bounded(self) -> bool:
        """Whether a trial's own instant is that at which its release ends; else it is that at which it begins.

        An acceleration that shows all of the jump bounds the end, however long the release took.
        """
        return self.quantity == "acceleration"

    @cached_property
    def rises_slowly(self) -> bool:
        """Whether an acceleration at the release is neither that of the peak nor at rest, as behind a slow sensor."""
        return self.quantity == "acceleration" and any(_risen_in_part(t) for t in self.trials)

    @property
    def training(self) -> tuple[int, ...]:
        """Indices of the trials that models are fitted to."""
        return tuple(i for i, trial in enumerate(self.trials) if self.fits_all or not trial.heldout)

    @property
    def heldout(self) -> tuple[int, ...]:
        """Indices of the trials on which, for held-out figures, only their own nuisances are fitted."""
        return tuple(i for i, trial in enumerate(self.trials) if trial.heldout)


def angles_of(experiment: Experiment) -> list[float]:
    """How far the primary goes in each trial, rad (m): as released, as its motion is prescribed, or as it reads."""
    if angles := [abs(t.theta0) for t in experiment.trials if t.theta0]:
        return angles
    omega = math.sqrt(float(np.median([k for k, _ in experiment.stiffnesses])) / experiment.constants["J1"][0])
    reach = omega ** DERIVATIVE[experiment.quantity]
    moved = [None if t.inputs is None else t.inputs.motion for t in experiment.trials]
    return [
        float(np.nanmax(np.abs(t.y[0]))) / reach if m is None else float(np.max(np.abs(m[0])))
        for t, m in zip(experiment.trials, moved, strict=True)
    ]


def default_priors(experiment: Experiment) -> dict[str, Distribution]:
    """Priors of the nominal parameters, scaled to the rig; with the thesis's rig their medians are the thesis's values.

    Wide (a factor of 2.7 each way for stiffness and damping, 3 for friction) and with tails that let a rig lack any
    of them, because a campaign decides, not the prior: a parameter that its prior holds away from where readings want
    it looks like a gap. Wider are those of the coupling's damping, a few per cent of critical or half of it, and of
    the secondary's bearing, which a body that hangs on the first alone lacks. Of nu the thesis prints no value: two
    standard deviations down dry friction is a viscous damping under another name, two up it is sharper than readings
    show.
    """
    j1 = experiment.constants["J1"][0]
    j2 = experiment.constants.get("J2", (j1, 0.0))[0]
    k1 = float(np.median([k for k, _ in experiment.stiffnesses]))
    omega = math.sqrt(k1 / j1)
    angle = max(float(np.median(angles_of(experiment) or [0.1])), 1e-9)
    viscous = 0.06 * math.sqrt(k1 * j1)  # damping ratio 0.03
    return {
        "mu": LogStudent(0.007, 2.7),
        "k2t": LogStudent(1.5 * k1 / 8.2 * j2 / 2.474e-3 * 3.015e-3 / j1, 2.7),
        "c2t": LogStudent(0.48 * math.sqrt(k1 * j2) * 1.2, 5.0),
        "drag": LogStudent(0.0065 * k1 * angle, 3.0),
        "nu": LogNormal(SHARPNESS / (omega * angle), 5.0),
        "tail": Uniform(*TAIL),
        "c1t": LogStudent(viscous, 2.7),
        "c3t": LogStudent(viscous * j2 / j1, 10.0),
    }


def longest_step(experiment: Experiment) -> float:
    """Longest time step, s: 1 ms times a power of 2, and at least 120 to a period of the fastest primary."""
    omega = max(experiment.omegas)
    return LONGEST_STEP * 2.0 ** max(0, math.floor(math.log2(2.0 * math.pi / omega / STEPS_PER_PERIOD / LONGEST_STEP)))


def release_window(trial: TrialRecord, quantity: str) -> tuple[float, float]:
    """Earliest and latest instant of release that the first readings allow, s.

    Accelerations jump at the release: a first reading near 0 while the next ones are at the peak means that the logger
    ran before it, any other that it came later, and the window is one sample wide. Velocities and displacements start
    without a jump, so the logger may have started up to a sample before or after.
    """
    n = min(trial.times.size - 1, 400)
    dt = float(np.median(np.diff(trial.times[: n + 1]))) if n > 0 else 1e-3
    if quantity != "acceleration":
        doubt = max(STEPS_OF_DOUBT * dt, trial.doubt)
        return -doubt, (doubt if trial.times[0] <= 0.0 else 0.0)
    if trial.times[0] > 0.0 or trial.times.size < 4:
        return -dt, 0.0
    held = _held_readings(trial)
    if held == 0:
        return float(trial.times[0]) - dt, float(trial.times[0])
    return float(trial.times[held - 1]), float(trial.times[held])


def _held_readings(trial: TrialRecord) -> int:
    """Number of first accelerations that are small beside the peak, up to three."""
    y = np.abs(np.nan_to_num(trial.y[0]))
    peak = float(np.max(y[1:6]))
    held = 0
    while held < y.size - 2 and y[held] < 0.3 * peak and held < 3:
        held += 1
    return held


def _risen_in_part(trial: TrialRecord) -> bool:
    """Whether the last acceleration that is small beside the peak stands out from the noise."""
    if trial.times.size < 4 or not trial.theta0 or not (held := _held_readings(trial)):
        return False
    y = np.nan_to_num(trial.y[0])
    return bool(abs(y[held - 1]) > DEPARTS[0] * noise_floor_of(y, trial.times))


def lone(experiment: Experiment, trials: Sequence[int]) -> bool:
    """Whether no two of the trials are repeats, of one record length too. Free starts never repeat."""
    keys = [experiment.trials[i].conditions_and_length for i in trials]
    return experiment.start == "free" or len(set(keys)) == len(keys)


def prior_of_instants(experiment: Experiment) -> Normal:
    """The usual prior of an instant of release that is one for many trials: about t = 0, by a sampling step, s."""
    steps = [float(np.median(np.diff(t.times))) for t in experiment.trials if t.times.size > 1]
    return Normal(0.0, float(np.median(steps or [1e-3])))


def late_by_the_clock(experiment: Experiment, trials: Sequence[int]) -> bool:
    """Whether readings leave the instant of each release of these trials open, by more than any clock does."""
    released = [experiment.trials[i] for i in trials if experiment.trials[i].theta0]
    return bool(released) and all(t.doubt for t in released)


def fitted_to_all(experiment: Experiment) -> Experiment:
    """The experiment with models fitted to its held-out trials too, if each trial has repeats but training has none.

    Of two trials each, it takes both to separate what the model misses from what differs from trial to trial.
    """
    counts = Counter(t.conditions_and_length for t in experiment.trials)
    in_pairs = experiment.start == "rest" and min(counts.values()) > 1 and lone(experiment, experiment.training)
    return replace(experiment, fits_all=True) if in_pairs else experiment


def _omega(stiffness: float, inertia: float) -> float:
    return math.sqrt(max(stiffness, 1e-300) / inertia)


def repeats(trials: Sequence[TrialRecord]) -> list[list[int]]:
    """Positions of the trials of one case, release and input, a list each."""
    same: dict[tuple[Any, ...], list[int]] = {}
    for k, t in enumerate(trials):
        same.setdefault(t.conditions, []).append(k)
    return list(same.values())


def repeats_by_reading(experiment: Experiment, among: Sequence[int]) -> list[list[int]]:
    """Some trials in sets of repeats whose readings lie at the same instants, to within a step of their clocks.

    Their residuals can be compared reading by reading: what a model misses hardly changes in so short a time. Records
    that start in motion have no repeats: no two begin alike.
    """
    sets: list[list[int]] = []
    for i in among:
        t = experiment.trials[i]
        alike = (s for s in sets if experiment.start != "free" and _read_alike(experiment.trials[s[0]], t))
        if (known := next(alike, None)) is None:
            sets.append([i])
        else:
            known.append(i)
    return sets


def _read_alike(one: TrialRecord, other: TrialRecord) -> bool:
    if one.conditions != other.conditions or one.times.size != other.times.size:
        return False
    apart = float(np.max(np.abs(one.times - other.times), initial=0.0))
    return apart == 0.0 or apart < float(np.median(np.diff(one.times)))


def with_priors(experiment: Experiment, priors: PriorSet) -> Experiment:
    """The experiment under the priors of a campaign's file: values, levels, and ties.

    Raises
    ------
    InputError
        for entries that contradict each other or the campaign.
    """
    faults = []
    levels: dict[str, str] = {}
    values: dict[str, Distribution | float] = {}
    own: dict[str, dict[str, Distribution | float]] = {}
    ties = priors.tied
    known = set(dict.fromkeys(t.case for t in experiment.trials))
    for name, entry in priors.entries.items():
        prior = f"priors {priors.name!r}: {name}"
        if name in ties:
            if name in ("theta0", "delay"):
                faults.append(f"{prior} cannot be tied; give it a level, a number or a prior")
            continue
        if name in ("theta0", "delay") and experiment.start == "free":
            faults.append(f'{prior} has no meaning where start is "free"; leave it out')
        levels[name] = entry.level
        if entry.cases:
            own[name] = {case: value for case, value in entry.cases.items() if case in known}
            levels[name] = "case" if entry.level == "campaign" else entry.level
        if entry.value is not None and not isinstance(entry.value, str):
            values[name] = entry.value
        elif entry.value == "" and known - set(entry.cases):
            missing = ", ".join(sorted(known - set(entry.cases)))
            faults.append(f"{prior} has numbers for some cases only; add those of {missing}")
        elif entry.value is None and name == "theta0" and entry.level != "trial":
            angles = {(t.theta0, t.theta0_sd) for t in experiment.trials}
            if entry.level == "campaign" and len(angles) > 1:
                faults.append(
                    f"{prior} is one for the campaign, but trials.csv has several angles; give it a level of case"
                )
            own[name] = {t.case: Normal(t.theta0, max(t.theta0_sd, 1e-12)) for t in experiment.trials}
        elif entry.value is None and name == "theta0":
            levels.pop(name)
        elif entry.value is None and name == "delay":
            values[name] = prior_of_instants(experiment)
    if faults:
        raise InputError(faults)
    return replace(
        experiment, priors={**experiment.priors, **values}, levels={**experiment.levels, **levels},
        case_priors={**experiment.case_priors, **own}, ties={**experiment.ties, **ties},
    )  # fmt: skip


def gridded(experiment: Experiment) -> Experiment:
    """The experiment with repeats on one even grid of times, nan where a reading is missing, where there is one.

    A free start is simulated from the first time of its grid: those that begin at another time have another one.
    """
    trials = list(experiment.trials)
    sets: dict[tuple[Any, ...], list[int]] = {}
    for i, t in enumerate(trials):
        free = experiment.start == "free" and t.times.size > 1
        begins = round(float(t.times[0] / np.median(np.diff(t.times)))) if free else 0
        sets.setdefault((t.case, t.coupled, t.theta0, begins), []).append(i)
    for members in sets.values():
        found = common_grid([trials[i].times for i in members])
        if found is None:
            continue
        grid, places = found
        for i, place in zip(members, places, strict=True):
            t = trials[i]
            y = np.full((t.y.shape[0], grid.size), np.nan)
            y[:, place] = t.y
            trials[i] = replace(t, times=grid, y=y)
    return replace(experiment, trials=tuple(trials))


def thinned(experiment: Experiment, every: int | None = None) -> Experiment:
    """The experiment with one reading in `every` of each record; without a number as `records.picks` decides."""
    trials = experiment.trials
    steps = [float(np.median(np.diff(t.times))) if t.times.size > 1 else 0.0 for t in trials]
    swings = experiment.quantity != "acceleration" and experiment.start == "free"
    period = 2.0 * math.pi / max(experiment.omegas)
    decided = [every or n for n in picks([t.y.size for t in trials], steps, period, swings)]
    kept = tuple(t if n == 1 else t.at(slice(None, None, n)) for t, n in zip(trials, decided, strict=True))
    return replace(experiment, trials=kept)


def unrounded(experiment: Experiment) -> Experiment:
    """The experiment with what rounded channels hold in place of their readings, and with their steps.

    A channel counts as rounded where most of its records do (`records.rounding_of`).
    """
    trials = list(experiment.trials)
    rounding = []
    for c in range(max(t.y.shape[0] for t in trials)):
        having = [i for i, t in enumerate(trials) if c < t.y.shape[0]]
        steps = [rounding_of(trials[i].y[c]) for i in having]
        coarse = [step for step in steps if step > 0.0]
        if 2 * len(coarse) <= len(having):
            rounding.append(0.0)
            continue
        rounding.append(float(np.median(coarse)))
        for i in having:
            t = trials[i]
            y = t.y.copy()
            weight = np.ones_like(y) if t.weight is None else t.weight.copy()
            y[c], weight[c] = crossings(t.times, y[c], rounding[c], 2.0 * math.pi / experiment.omegas[t.k1t])
            trials[i] = replace(t, y=y, weight=weight)
    return replace(experiment, trials=tuple(trials), rounding=tuple(rounding)) if any(rounding) else experiment


def rounding_sd(value: float) -> float:
    """The standard deviation of a constant that is known by its digits alone: of its unrounded values, all alike.

    Its last digit is the last one that is not 0, and at least the third: 216 may stand for 215.5 to 216.5.
    """
    if value == 0.0:
        return 0.0
    last = int(Decimal(repr(float(value))).normalize().as_tuple().exponent)
    return 10.0 ** min(last, math.floor(math.log10(abs(value))) + 1 - LEAST_DIGITS) / math.sqrt(12.0)


def with_rounding(experiment: Experiment) -> Experiment:
    """The experiment with what rounding leaves open of constants that are declared without an uncertainty.

    Periods are measured to one part in 1e5, and four digits of a stiffness hold one in 1e4. What acts by a ratio is
    one unknown: J1 and k1t by the pace of the primary, R and r by the overlap of the faces.
    """
    constants = dict(experiment.constants)

    def share(name: str) -> float:
        value, sd = constants.get(name, (0.0, 1.0))
        return 0.0 if sd > 0.0 or value == 0.0 else rounding_sd(value) / abs(value)

    def rounded(value: float, sd: float, *others: str) -> tuple[float, float]:
        """With the roundings of the others too; the value's own one where no uncertainty is declared."""
        own = sd or rounding_sd(value)
        whole = math.hypot(own, *(abs(value) * share(other) for other in others))
        return value, whole if whole > ROUNDED * abs(value) else sd

    if "r" in constants:
        constants["r"] = rounded(*constants["r"], "R")
    if "J2" in constants:
        constants["J2"] = rounded(*constants["J2"])
    stiffnesses = tuple(rounded(*k, "J1") for k in experiment.stiffnesses)
    return replace(experiment, constants=constants, stiffnesses=stiffnesses)


def trial_label(trial: TrialRecord) -> str:
    """Words that name a trial, without the slash that separates groups in a posterior.nc."""
    configuration = "coupled" if trial.coupled else "uncoupled"
    return f"{trial.case} {configuration} #{trial.number}".replace("/", "|")


def laws_on(effects: Mapping[str, Effect], campaign: Campaign) -> list[str]:
    """Warnings on learnt laws among the effects that a campaign leaves the range of, as far as its head shows it.

    Raises
    ------
    InputError
        if a law is that of another rig.
    """
    rig, trials = campaign.rig, campaign.trials
    inertias = {"J1": rig.primary_inertia.value}
    inertias |= {"J2": rig.secondary_inertia.value} if rig.secondary_inertia is not None else {}
    seen = {"time": (0.0, max(float(t.times[-1] - t.times[0]) for t in trials))}
    released = [abs(t.theta0.value) for t in trials if t.theta0 is not None]
    laws = [e.law for e in effects.values() if e.law is not None]
    if wrong := [said for law in laws if (said := law.mismatch(rig.kind, inertias)) is not None]:
        raise InputError(wrong)
    out = []
    for law in laws:
        turned = law.site in ("ground1", "bearings") and released
        out += law.outside(seen | ({"angle": (-max(released), max(released))} if turned else {}))
    return out


def reaction_unit(campaign: Campaign) -> float:
    """What a reaction, N m (N), is divided by to be a reading like the others of its campaign.

    The inertia where accelerations are read, the stiffness where angles are, the root of their product between: so the
    readings of both channels are of one size and unit. One number for all trials, since they share a sensor.
    """
    inertia = float(campaign.rig.primary_inertia.value)
    stiffness = float(np.median([t.k1t.value for t in campaign.trials]))
    return inertia * _omega(stiffness, inertia) ** (2 - DERIVATIVE[campaign.measurement.quantity])


def _releases(campaign: Campaign) -> list[Release]:
    """Where each record begins. Clocks are set to late beginnings that may be slow ones where most records have one.

    A slow sensor shows the motion a little later in one record than in another.
    """
    measurement, inertia = campaign.measurement, campaign.rig.primary_inertia.value

    def release(t: Trial, latest: float) -> Release:
        if measurement.start != "rest" or t.given or t.theta0 is None:
            return Release()
        first, omega = np.atleast_2d(t.channels)[0], _omega(t.k1t.value, inertia)
        return release_of(t.times, first, measurement.quantity, t.theta0.value, omega, latest)

    begins = [release(t, 0.5) for t in campaign.trials]
    slow = [release(t, 1.0) if b.shift else b for t, b in zip(campaign.trials, begins, strict=True)]
    late = sum(a.shift != b.shift for a, b in zip(begins, slow, strict=True))
    return slow if 2 * late <= len(begins) else begins


def _lags(trials: Sequence[TrialRecord]) -> tuple[float, ...]:
    """Standard deviation of each channel's time against that of the inputs, s, where none is declared.

    Loggers read their channels one after the other. Without inputs nothing shows when a channel is read, but for what
    the other one shows (`sensor_delay`).
    """
    steps = [float(np.median(np.diff(t.times))) for t in trials if t.driven]
    return (SKEW * min(steps),) * 2 if steps else ()


def experiment_of(
    campaign: Campaign, priors: PriorSet | Mapping[str, Distribution | float] | None = None
) -> Experiment:
    """A campaign as an Experiment; priors override those of `default_priors`.

    Where no trial is marked as held out, the last one of each case and configuration that has repeats is.
    """
    rig, measurement = campaign.rig, campaign.measurement
    declared = {
        "J1": rig.primary_inertia, "J2": rig.secondary_inertia, "R": rig.bar_radius, "r": rig.magnet_radius,
        "N0": rig.magnet_pull, "k3t": rig.ground2_stiffness, "J12": rig.inertial_coupling,
    }  # fmt: skip
    constants = {name: (c.value, c.std) for name, c in declared.items() if c is not None}
    stiffnesses = tuple(dict.fromkeys((t.k1t.value, t.k1t.std) for t in campaign.trials))
    records = []
    heldout = {id(t) for t in campaign.heldout}
    scatter = dict(campaign.scatter)
    apart = scatter.pop("theta0", 0.0)
    reaction = reaction_unit(campaign) if any(t.prescribed for t in campaign.trials) else 1.0
    clocks = evened([np.array(t.times, float) for t in campaign.trials])
    places = np.linspace(-0.5, 0.5, len(campaign.trials))
    for t, begins, times, order in zip(campaign.trials, _releases(campaign), clocks, places, strict=True):
        angle = Constant(0.0) if t.theta0 is None else t.theta0
        channels = np.atleast_2d(np.array(t.channels, float))
        inputs = replace(t, times=times).inputs(measurement)
        if inputs is not None and inputs.motion is not None:
            inputs = replace(inputs, unit=reaction)
            channels[0] /= reaction
        records.append(
            TrialRecord(
                label=t.file,
                case=t.case,
                coupled=t.coupled,
                number=t.trial,
                times=times[begins.first :] - begins.shift,
                y=channels[:, begins.first :],
                k1t=stiffnesses.index((t.k1t.value, t.k1t.std)),
                theta0=angle.value,
                theta0_sd=0.0 if t.theta0 is None else math.hypot(angle.std, apart),
                inputs=inputs,
                heldout=id(t) in heldout,
                doubt=begins.doubt,
                order=float(order),
            )
        )
    late = [t.doubt for t in records if t.doubt]
    if len(late) > OF_ONE_TRIGGER * len(records):
        records = [replace(t, doubt=t.doubt or max(late)) if t.theta0 else t for t in records]
    given, offset = (s and (s[0] / reaction, *s[1:]) for s in (measurement.noise_std, measurement.offset_std))
    experiment = Experiment(
        constants, stiffnesses, tuple(records), measurement.quantity, rig.normal_force, rig.restoring,
        measurement.start, given or (), offset_sd=offset, scale_sd=measurement.scale_std or (),
        lag_sd=_lags(records) if measurement.lag_std is None else measurement.lag_std,
        coupling_law=rig.inertial_coupling_law, scatter=scatter,
    )  # fmt: skip
    experiment = unrounded(thinned(gridded(experiment), measurement.every))
    if isinstance(priors, PriorSet):
        return with_priors(experiment, priors)
    return replace(experiment, priors=dict(priors or {}))
