"""Fitting a campaign by least squares, with everything that is uncertain about the rig and about each trial.

How to use it::

    experiment = experiment_of(campaign)              # a campaign.Campaign, or build an Experiment by hand
    problem = Problem(experiment)                     # nominal model; effect=variant adds one effect
    fit = calibrate(problem)                          # noise is learnt from the repeats on the way
    fit.parameters                                    # {"mu": (value, sd), ...}
    fit.log_evidence                                  # Laplace; comparable between Problems that share `noise`
    rival = calibrate(Problem(experiment, effect=variant, noise=fit.problem.noise), starts=[fit.q])
    predict(fit, experiment.heldout)                  # held-out trials: only their own nuisances are fitted

Every unknown has a coordinate in which its prior is a standard Gaussian: `q` holds those of the whole campaign
(nominal parameters, constants declared with a standard deviation, parameters of the effect), `eta` those of each trial
(release angle, instant of release, its own friction). With r the whitened residuals, J = dr/dq and T = dr/d eta the
cost  |r|^2 + |q|^2 + sum |eta_j|^2  is minimised by damped Gauss-Newton steps in which each trial's nuisances are
eliminated by a Schur complement,

    H_j = 1 + T_j' T_j,    S = 1 + sum_j J_j' J_j - J_j' T_j H_j^-1 T_j' J_j,
    log Z = -(cost + log |S| + sum_j log |H_j|) / 2      (Laplace, up to the constant of the noise).

All vectors of a Jacobian, of all trials that share their sample times, go through one call of Model.simulate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.special import ndtri

from bayes_damper.distributions import (
    Distribution,
    HalfNormal,
    LogNormal,
    LogUniform,
    Normal,
    Uniform,
    from_standard,
    median,
    to_standard,
)
from bayes_damper.effects.base import Variant
from bayes_damper.errors import InputError
from bayes_damper.integrator import LONGEST_STEP
from bayes_damper.model import Model, Quantity
from bayes_damper.priors import PriorSet
from bayes_damper.records import common_grid, release_of

Array = NDArray[np.float64]
Indices = NDArray[np.signedinteger[Any]]

NOMINAL = ("k2t", "c2t", "c1t", "c3t", "mu", "drag", "nu")
FRICTION_SPREAD = 0.04  # prior sd of ln mu from trial to trial, where the repeats show that it varies
EVENT_THRESHOLD = 4.5  # robust sds of the second difference beyond which a sample counts as an event
EVENT_TIMING = 5e-5  # s, by which the instant of an event may be off without the model being wrong
RELEASE_WEIGHT = 0.4  # of the first two readings
FIRST_STAGE_EVENT_WEIGHT = 0.15
LONG_PERIODS, FIRST_PERIODS, GROWING_STEPS = 12.0, 3.0, 20  # of records fitted window by window
OWN_FRICTION = ("ln_mu", "ln_drag")  # nuisances whose derivative is that of the parameter all trials share
VARIES = 9.0  # mean square, in variances, of a nuisance's differences between repeats from which it is each trial's own
FEW_REPEATS = 4  # repeats beyond the first of their kind, over all kinds, below which they may be late alike by chance
WHITE_ENOUGH = 1.3  # largest ratio of residuals without repeats to the noise of the sensors up to which they are noise
FIRST_ERROR = 0.02  # of a channel's reach: noise of the first fit where there are no repeats
READINGS_PER_PERIOD = 100.0  # of the primary, that displacements and velocities are thinned to
STEPS_PER_PERIOD = 120.0  # at least, of the primary on its spring
OFFSET_SHARE = 0.05  # of a channel's reach: prior sd of its unknown offset, where the campaign does not say
HOPELESS, HURRY = 60.0, 6.0  # cost above a target, and in how many such steps it must be reachable, to go on
_FARTHEST = 37.0  # standard deviations beyond which a coordinate is not followed


# Coordinates with a standard Gaussian prior -------------------------------------------------------------------------


def coordinate_of(distribution: Distribution, x: float) -> float:
    """The standard Gaussian coordinate of the value `x`, cut to +-8."""
    return float(np.clip(to_standard(distribution, x), -8.0, 8.0))


# What is fitted -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TrialRecord:
    """One measured trial, as the calibration sees it.

    times (n,) s; y (channels, n), nan where a reading is missing; k1t: index into Experiment.stiffnesses;
    theta0, theta0_sd: nominal release angle (rad) and its standard uncertainty.
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
    torque: Array | None = None
    heldout: bool = False


@dataclass(frozen=True)
class Experiment:
    """Trials of one rig, with what is declared about it.

    constants: name (J1 J2 J12 k3t R r N0) -> (value, standard deviation or 0); stiffnesses: (k1t, sd) per declared
    value; start: "rest" from theta0, or "free": angles and velocities at the first sample are inferred.

    priors: parameter -> distribution, or number where it is fixed, in place of the default; levels: parameter ->
    "campaign" (one value for all trials, the default), "case" or "trial"; case_priors: parameter -> case -> prior where
    cases differ; ties: parameter -> the one whose value it takes.
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
    def training(self) -> tuple[int, ...]:
        """Indices of the trials that fits may use."""
        return tuple(i for i, trial in enumerate(self.trials) if not trial.heldout)

    @property
    def heldout(self) -> tuple[int, ...]:
        """Indices of the trials on which only their own nuisances are ever fitted."""
        return tuple(i for i, trial in enumerate(self.trials) if trial.heldout)


def default_priors(experiment: Experiment) -> dict[str, Distribution]:
    """Priors of the nominal parameters, scaled to the rig; with the thesis's rig their medians are the thesis's values.

    Wide (a factor of 2.7 each way for stiffness and damping, 3 for friction) because a campaign decides, not the prior.
    """
    j1 = experiment.constants["J1"][0]
    j2 = experiment.constants.get("J2", (j1, 0.0))[0]
    k1 = float(np.median([k for k, _ in experiment.stiffnesses]))
    omega = math.sqrt(k1 / j1)
    angles = [abs(t.theta0) for t in experiment.trials if t.theta0]
    if not angles:
        reach = {"acceleration": omega**2, "velocity": omega, "displacement": 1.0}[experiment.quantity]
        angles = [float(np.nanmax(np.abs(t.y[0]))) / reach for t in experiment.trials] or [0.1]
    angle = max(float(np.median(angles)), 1e-9)
    viscous = 0.06 * math.sqrt(k1 * j1)  # damping ratio 0.03
    return {
        "mu": LogNormal(0.007, 2.7),
        "k2t": LogNormal(1.5 * k1 / 8.2 * j2 / 2.474e-3 * 3.015e-3 / j1, 2.7),
        "c2t": LogNormal(0.48 * math.sqrt(k1 * j2) * 1.2, 2.7),
        "drag": LogNormal(0.0065 * k1 * angle, 3.0),
        "nu": LogNormal(200.0 / (omega * angle * 52.0) * 50.0 / 40.0 * 12.0, 2.5),
        "c1t": LogNormal(viscous, 2.7),
        "c3t": LogNormal(viscous * j2 / j1, 2.7),
    }


@dataclass(frozen=True)
class Noise:
    """Noise of each channel: an ARMA(1, 1) process (a white one plus an AR(1) one); phi = theta = 0 is white.

    innovation: sd of the innovations, the channel's unit; total: sd of the noise itself; longer: for each channel the
    coefficients of a longer autoregression that takes the place of phi and theta, empty where there is none.
    Without repeats the noise stands for the model's own error too (`error_level`); sensor is then the sd of the
    readings' noise alone.
    """

    innovation: tuple[float, ...]
    phi: tuple[float, ...]
    theta: tuple[float, ...]
    longer: tuple[tuple[float, ...], ...] = ()
    sensor: tuple[float, ...] = ()

    @property
    def floor(self) -> tuple[float, ...]:
        """Standard deviation of what no model could explain, each channel."""
        return self.sensor or self.total

    def filter(self, channel: int) -> tuple[list[float], list[float]]:
        """Numerator and denominator of the filter that turns the noise into its innovations."""
        if self.longer and self.longer[channel]:
            return [1.0, *(-a for a in self.longer[channel])], [1.0]
        return [1.0, -self.phi[channel]], [1.0, -self.theta[channel]]

    @property
    def total(self) -> tuple[float, ...]:
        """Standard deviation of the noise of each channel."""
        out = []
        for channel, (s, p, t) in enumerate(zip(self.innovation, self.phi, self.theta, strict=True)):
            if self.longer and self.longer[channel]:
                impulse = np.zeros(20_000)
                impulse[0] = 1.0
                ahead, back = self.filter(channel)
                out.append(s * math.sqrt(float(np.sum(np.square(lfilter(back, ahead, impulse))))))
            else:
                out.append(s * math.sqrt((1.0 + t * t - 2.0 * p * t) / (1.0 - p * p)))
        return tuple(out)

    def density(self, channel: int, omega: Array) -> Array:
        """Spectral density at angular frequencies omega (rad per sample), the channel's unit squared."""
        ahead, back = self.filter(channel)
        z = np.exp(-1j * omega)
        gain = np.polyval(back[::-1], z) / np.polyval(ahead[::-1], z)
        return np.asarray(self.innovation[channel] ** 2 * np.abs(gain) ** 2)

    def coloured(self, channel: int) -> bool:
        """Whether the noise of a channel is correlated."""
        ahead, back = self.filter(channel)
        return any(ahead[1:]) or any(back[1:])

    def whiten(self, channel: int, r: Array) -> Array:
        """Innovations of residuals r (..., n), in units of their standard deviation."""
        s = self.innovation[channel]
        ahead, back = self.filter(channel)
        if not self.coloured(channel):
            return r / s
        return np.asarray(lfilter(ahead, back, r, axis=-1)) / s


@dataclass(frozen=True)
class Coordinate:
    """One unknown of the whole campaign, or of one `case` if that is given.

    role: "nominal", "release" (angle or instant), "constant", "stiffness" (k1t number `index`), "sensor" (scale of
    channel `index`), "lag" (of its readings, s) or "effect".
    """

    name: str
    role: Literal["nominal", "release", "constant", "stiffness", "sensor", "lag", "effect"]
    prior: Distribution
    index: int = 0
    case: str | None = None

    @property
    def parameter(self) -> str:
        """The name without its case."""
        return self.name.partition("[")[0]


@dataclass(frozen=True)
class Switches:
    """Which nuisances of the trials are free: the instant of release, each trial's own friction, its bearings' drag."""

    delay: bool = True
    friction: bool = True
    drag: bool = False


@dataclass(frozen=True, eq=False)
class Group:
    """Training trials that can share one simulation: same configuration, times and torque."""

    coupled: bool
    trials: tuple[int, ...]
    times: Array
    torque: Array | None
    y: Array  # (trials, channels, n), missing readings 0
    weight: Array  # the same shape; 0 where missing
    first_weight: Array
    nuisances: tuple[tuple[str, Array, Array], ...]  # name, prior mean and sd for each trial
    lower: Array  # (trials, m) bounds of eta
    upper: Array

    def weights(self, annealed: bool) -> Array:
        """Weights of the residuals; annealed: samples beside friction reversals count little, for a smoother cost."""
        return self.first_weight if annealed else self.weight


def _event_strength(y: Array, noise: Array) -> Array:
    """How far each sample's neighbourhood jumps, in the unit of y: 0 away from events. y (channels, n)."""
    jump = np.zeros_like(y)
    if y.shape[1] < 8:
        return jump
    second = np.zeros_like(y)
    second[:, 1:-1] = y[:, 2:] - 2.0 * y[:, 1:-1] + y[:, :-2]
    second[~np.isfinite(second[:, 2:-2]).any(axis=1)] = 0.0  # no three readings in a row
    scale = 1.4826 * np.nanmedian(np.abs(second[:, 2:-2]), axis=1) + 1e-300
    scale = np.maximum(scale, noise)
    hit = np.abs(second) > EVENT_THRESHOLD * scale[:, None]
    step = np.zeros_like(y)
    step[:, 1:] = np.abs(np.diff(y, axis=1))
    step[:, :-1] = np.maximum(step[:, :-1], step[:, 1:])
    for shift in (-1, 0, 1):
        rolled = np.roll(np.where(hit, step, 0.0), shift, axis=1)
        jump = np.maximum(jump, rolled)
    return np.asarray(np.nan_to_num(jump))


class Problem:
    """Everything that the fit of one model to one experiment needs: coordinates, trials in groups, weights, noise."""

    def __init__(
        self,
        experiment: Experiment,
        effect: Variant | None = None,
        *,
        nominal: Literal["nonlinear", "linear"] = "nonlinear",
        noise: Noise | None = None,
        switches: Switches | None = None,
        threads: int = 1,
        tolerance: float = 1.0,
        trials: Sequence[int] | None = None,
        factors: Mapping[int, Array] | None = None,
    ) -> None:
        """`trials`: indices of those to fit, default all that are not held out; `noise` is estimated if absent;
        factors: trial -> what multiplies the weights of its readings, (channels, n) or a number.
        """
        self.experiment = experiment
        self.effect = effect
        self.nominal = nominal
        self.threads = threads
        self.tolerance = tolerance
        self.trials = tuple(experiment.training if trials is None else trials)
        self.switches = switches or Switches()
        self.factors = dict(factors or {})
        self.noise = noise or rough_noise(experiment, self.trials)
        self._defaults = default_priors(experiment)
        self._cases = tuple(dict.fromkeys(t.case for t in experiment.trials))
        self._medians = {
            name: {case: middle(self.prior(name, case)) for case in self._cases} for name in NOMINAL
        }  # of each case
        self.coordinates = self._coordinates()
        self.names = tuple(c.name for c in self.coordinates)
        self.size = len(self.coordinates)
        self.models = {coupled: _model(experiment, coupled, effect) for coupled in (False, True)}
        self._groups: dict[tuple[int, ...], list[Group]] = {}
        self.groups = self.grouped(self.trials)

    def with_noise(self, noise: Noise) -> Problem:
        """The same problem under another noise."""
        return Problem(
            self.experiment, self.effect, nominal=self.nominal, noise=noise, switches=self.switches,
            threads=self.threads, tolerance=self.tolerance, trials=self.trials, factors=self.factors,
        )  # fmt: skip

    def reweighted(self, factors: Mapping[int, Array]) -> Problem:
        """The same problem with weights of readings multiplied: trial -> (channels, n) or a number."""
        both = {i: f * self.factors[i] if i in self.factors else f for i, f in factors.items()}
        return Problem(
            self.experiment, self.effect, nominal=self.nominal, noise=self.noise, switches=self.switches,
            threads=self.threads, tolerance=self.tolerance, trials=self.trials, factors={**self.factors, **both},
        )  # fmt: skip

    def for_trials(self, trials: Sequence[int]) -> Problem:
        """The same problem for other trials of the experiment."""
        return Problem(
            self.experiment, self.effect, nominal=self.nominal, noise=self.noise, switches=self.switches,
            threads=self.threads, tolerance=self.tolerance, trials=trials,
        )  # fmt: skip

    def with_effect(self, effect: Variant | None) -> Problem:
        """The same data, noise and nuisances under another effect; groups are shared."""
        other = Problem.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.effect = effect
        other.coordinates = other._coordinates()  # noqa: SLF001 (the same class)
        other.names = tuple(c.name for c in other.coordinates)
        other.size = len(other.coordinates)
        other.models = {coupled: _model(self.experiment, coupled, effect) for coupled in (False, True)}
        return other

    @property
    def n_data(self) -> float:
        """Number of readings, weighted."""
        return float(sum(np.sum(g.weight**2) for g in self.groups))

    # Set-up

    def prior(self, name: str, case: str) -> Distribution | float:
        """Prior of a parameter for the trials of a case: a distribution, or a number where it is fixed."""
        e = self.experiment
        own = e.case_priors.get(name, {})
        return own[case] if case in own else e.priors[name] if name in e.priors else self._defaults[name]

    def _coordinates(self) -> tuple[Coordinate, ...]:
        e = self.experiment
        used = [e.trials[i] for i in self.trials] or list(e.trials)
        coupled = any(t.coupled for t in used)
        names = ["k2t", "c2t", "c1t", "c3t"] if coupled else ["c1t"]
        if self.nominal == "nonlinear":
            names += ["mu", "drag", "nu"] if coupled and e.magnet else ["drag", "nu"]
        out = []
        for name in dict.fromkeys(e.ties.get(n, n) for n in names):
            out += self._shared(name, "nominal", [t for t in used if t.coupled or name in self._alone()])
        for name in ("theta0", "delay"):
            if e.start == "rest" and e.levels.get(name, "trial") != "trial":
                out += self._shared(name, "release", used)
        for name, (value, sd) in e.constants.items():
            if sd > 0.0 and (coupled or name == "J1"):
                out.append(Coordinate(name, "constant", Normal(value, sd)))
        for i, (value, sd) in enumerate(e.stiffnesses):
            if sd > 0.0 and any(t.k1t == i for t in used):
                label = "k1t" if len(e.stiffnesses) == 1 else f"k1t[{value:g}]"
                out.append(Coordinate(label, "stiffness", Normal(value, sd), i))
        for c, sd in enumerate(e.scale_sd[: 1 + int(coupled)]):
            if sd > 0.0:
                out.append(Coordinate(f"scale{c + 1}", "sensor", Normal(1.0, sd), c))
        for c, sd in enumerate(e.lag_sd[: 1 + int(coupled)]):
            if sd > 0.0:
                out.append(Coordinate(f"lag{c + 1}", "lag", Normal(0.0, sd), c))
        if self.effect is not None:
            out += [Coordinate(f"effect.{p.name}", "effect", p.prior) for p in self.effect.parameters]
        return tuple(out)

    def _shared(
        self, name: str, role: Literal["nominal", "release"], trials: Sequence[TrialRecord]
    ) -> list[Coordinate]:
        """The unknowns that a parameter has at its level: one, or one for each case; none if it is each trial's own."""
        e = self.experiment
        cases = list(dict.fromkeys(t.case for t in trials))
        level = e.levels.get(name, "campaign")
        free = {
            case: p for case in cases if not isinstance(p := self.prior(name, case), float | int) and _spread(p) > 0
        }
        if level == "trial" or not free:
            return []
        if len(cases) > 1 and (level == "case" or name in e.case_priors):
            return [Coordinate(f"{name}[{case}]", role, p, case=case) for case, p in free.items()]
        return [Coordinate(name, role, next(iter(free.values())))]

    def _alone(self) -> set[str]:
        """Parameters that act on trials of the primary alone."""
        alone = {"J1", "c1t", "drag", "nu", "theta0", "delay"}
        return alone | {other for name, other in self.experiment.ties.items() if name in alone}

    def grouped(self, trials: Sequence[int]) -> list[Group]:
        """The trials in groups that share a simulation."""
        known = self._groups.get(tuple(trials))
        if known is not None:
            return known
        e = self.experiment
        keyed: dict[tuple[Any, ...], list[int]] = {}
        for i in trials:
            t = e.trials[i]
            driven = None if t.torque is None or not np.any(t.torque) else t.torque.tobytes()
            keyed.setdefault((t.coupled, t.times.tobytes(), driven), []).append(i)
        groups = [self._group(members) for members in keyed.values()]
        self._groups[tuple(trials)] = groups
        return groups

    def _group(self, members: list[int]) -> Group:
        e = self.experiment
        trials = [e.trials[i] for i in members]
        first = trials[0]
        raw = np.array([t.y for t in trials])
        y = np.nan_to_num(raw)
        spread = np.array(self.noise.total[: y.shape[1]])
        weight = np.ones_like(y)
        annealed = np.ones_like(y)
        for same in _repeats(trials):
            jump = np.max([_event_strength(raw[k], 2.4 * spread) for k in same], axis=0)
            jump = jump * (first.times > first.times[0])
            rate = 1.0 / max(float(np.median(np.diff(first.times))), 1e-12) if first.times.size > 1 else 0.0
            extra = (jump * rate * EVENT_TIMING / spread[:, None]) ** 2
            for k in same:
                weight[k] /= np.sqrt(1.0 + extra)
                annealed[k] = np.where(jump > 0.0, FIRST_STAGE_EVENT_WEIGHT, 1.0)
        nuisances, lower, upper = self._nuisances(trials)
        if e.start == "rest" and first.times.size > 2 and e.quantity == "acceleration":
            # The release itself: what rig and sensor do within a sample of it is told by no formula exactly.
            early = first.times <= first.times[0] + 1.5 * float(np.median(np.diff(first.times)))
            for k, t in enumerate(trials):
                if t.times[0] <= 0.0:
                    weight[k][:, early] *= RELEASE_WEIGHT
        for k, i in enumerate(members):
            weight[k] *= self.factors.get(i, 1.0)
        missing = ~np.isfinite(raw)
        weight[missing] = 0.0
        annealed = np.minimum(annealed, weight)
        return Group(
            first.coupled, tuple(members), first.times, first.torque, y, weight, annealed, nuisances, lower, upper
        )

    def _nuisances(self, trials: list[TrialRecord]) -> tuple[tuple[tuple[str, Array, Array], ...], Array, Array]:
        e = self.experiment
        n = len(trials)
        out: list[tuple[str, Array, Array]] = []
        bounds: list[tuple[Array, Array]] = []
        wide = (np.full(n, -_FARTHEST), np.full(n, _FARTHEST))
        if e.start == "free":
            omega = math.sqrt(e.stiffnesses[0][0] / e.constants["J1"][0])
            for name, order in (("theta0", 0), ("omega1_0", 1), ("theta2_0", 0), ("omega2_0", 1)):
                if name in ("theta2_0", "omega2_0") and not trials[0].coupled:
                    continue
                channel = 1 if "2_0" in name else 0
                power = order - {"displacement": 0, "velocity": 1, "acceleration": 2}[e.quantity]
                reach = np.array([float(np.nanmax(np.abs(t.y[channel]))) for t in trials]) * omega**power
                guess = np.zeros(n)
                if power == 0:
                    guess = np.array([float(np.nan_to_num(t.y[channel][0])) for t in trials])
                elif power == 1 and e.quantity == "displacement":
                    guess = np.array([_first_slope(t.times, t.y[channel], 1.0 / omega) for t in trials])
                elif power == -2:
                    guess = -np.array([float(np.nan_to_num(t.y[channel][0])) for t in trials]) / omega**2
                out.append((name, guess, 1.5 * reach + 1e-9))
                bounds.append(wide)
            out += self._offsets(trials)
            bounds += [wide] * (len(out) - len(bounds))
            return tuple(out), np.array([b[0] for b in bounds]).T, np.array([b[1] for b in bounds]).T
        mean = np.array([t.theta0 for t in trials])
        sd = np.array([t.theta0_sd for t in trials])
        if np.any(sd > 0.0) and "theta0" not in e.levels:
            out.append(("theta0", mean, np.maximum(sd, 1e-12)))
            bounds.append(wide)
        absent = {"mu"} if not e.magnet else set()
        absent |= {"mu", "drag"} if self.nominal == "linear" else set()
        for name in (*NOMINAL, "theta0", "delay"):
            if e.levels.get(name) == "trial" and name not in absent and (trials[0].coupled or name in self._alone()):
                found = _own_value(name, [self.prior(name, t.case) for t in trials])
                if found is not None:
                    out.append(found[0])
                    bounds.append(found[1])
        if self.switches.delay and "delay" not in e.levels:
            low, high = np.array([release_window(t, e.quantity) for t in trials]).T
            middle, half = 0.5 * (low + high), 0.35 * (high - low)
            out.append(("delay", middle, half))
            # A rig seen held at the first reading bounds the release from below; else the logger may be later yet.
            slack = np.where(low >= np.array([t.times[0] for t in trials]), -1e-6, 0.4)
            bounds.append(((low - middle) / half - slack, (high - middle) / half * (1.0 - 1e-9)))
        if self.switches.friction and trials[0].coupled and any(c.parameter == "mu" for c in self.coordinates):
            out.append(("ln_mu", np.zeros(n), np.full(n, FRICTION_SPREAD)))
            bounds.append(wide)
        if self.switches.drag and any(c.parameter == "drag" for c in self.coordinates):
            out.append(("ln_drag", np.zeros(n), np.full(n, FRICTION_SPREAD)))
            bounds.append(wide)
        out += self._offsets(trials)
        bounds += [wide] * (len(out) - len(bounds))
        if not out:
            return (), np.zeros((n, 0)), np.zeros((n, 0))
        return tuple(out), np.array([b[0] for b in bounds]).T, np.array([b[1] for b in bounds]).T

    def _offsets(self, trials: list[TrialRecord]) -> list[tuple[str, Array, Array]]:
        """Reading of each channel at rest, unknown for each trial; its prior is a share of the channel's reach."""
        e = self.experiment
        out = []
        for c in range(1 + int(trials[0].coupled)):
            if e.offset_sd is not None:
                sd = np.full(len(trials), e.offset_sd[min(c, len(e.offset_sd) - 1)])
            elif e.quantity == "displacement":
                sd = OFFSET_SHARE * np.array([float(np.nanmax(np.abs(t.y[c]))) for t in trials])
            else:
                continue
            if np.any(sd > 0.0):
                out.append((f"offset{c + 1}", np.zeros(len(trials)), np.maximum(sd, 1e-12)))
        return out

    # Simulation

    def prior_mean(self) -> Array:
        """The start at the prior medians, (size,)."""
        return np.zeros(self.size)

    def no_nuisance(self) -> dict[int, Array]:
        """Nuisances at their prior means: trial -> (m,)."""
        return {i: np.zeros(len(g.nuisances)) for g in self.groups for i in g.trials}

    def parameters(self, q: Array) -> dict[str, Array]:
        """Values of the coordinates q (..., size) by name."""
        return {c.name: from_standard(c.prior, q[..., i]) for i, c in enumerate(self.coordinates)}

    def _inputs(self, group: Group, which: Indices, q: Array, eta: Array) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arguments of Model.simulate for vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        e = self.experiment
        rig: dict[str, Any] = {name: value for name, (value, _) in e.constants.items()}
        rig["k1t"] = np.array([e.stiffnesses[e.trials[i].k1t][0] for i in group.trials])[which]
        rig["theta0"] = np.array([e.trials[i].theta0 for i in group.trials])[which]
        cases = [e.trials[i].case for i in group.trials]
        for name, middles in self._medians.items():
            own = [middles[case] for case in cases]
            rig[name] = own[0] if len(set(own)) == 1 else np.array(own)[which]
        if self.nominal == "linear":
            rig |= {"mu": 0.0, "drag": 0.0}
        for name in ("theta0", "delay"):
            if name in e.levels and e.start == "rest":
                rig[name] = np.array([middle(self.prior(name, case)) for case in cases])[which]
        rig = {
            "N0": 0.0,
            "R": 1.0,
            "r": 1.0,
        } | rig  # a rig without magnet, or with a constant pull, has no use for them
        if not e.magnet:
            rig["mu"] = 0.0
        effect: dict[str, Any] = {}
        for i, c in enumerate(self.coordinates):
            x = from_standard(c.prior, q[:, i])
            if c.role == "effect":
                effect[c.name.removeprefix("effect.")] = x
            elif c.role in ("sensor", "lag"):
                continue
            elif c.role == "stiffness" or c.case is not None:
                hit = self.touched(c, group)[which]
                rig[c.parameter] = np.where(hit, x, rig[c.parameter])
            else:
                rig[c.name] = x
        for i, (name, mean, sd) in enumerate(group.nuisances):
            x = mean[which] + sd[which] * eta[:, i]
            if name.startswith("ln_"):
                rig[name[3:]] = rig[name[3:]] * np.exp(x)
            elif not name.startswith("offset"):
                rig[name] = x
        for name, other in e.ties.items():
            if name in NOMINAL:
                rig[name] = rig[other]
        if e.start == "free":
            rig["delay"] = float(group.times[0])
        return {"theta2_0": rig["theta0"]} | rig, effect

    def _read(self, y: Array, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Motions y (n, channels, n_times) as the sensors show them: each channel's scale and offset, in place."""
        for i, c in enumerate(self.coordinates):
            if c.role == "sensor" and c.index < y.shape[1]:
                y[:, c.index] *= from_standard(c.prior, q[:, i])[:, None]
        for i, (name, mean, sd) in enumerate(group.nuisances):
            if name.startswith("offset"):
                y[:, int(name[6:]) - 1] += (mean[which] + sd[which] * eta[:, i])[:, None]
        return y

    def simulate(self, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Readings (n, channels, n_times) of vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        rig, effect = self._inputs(group, which, q, eta)

        def readings(rig: dict[str, Any]) -> Array:
            return (
                self.models[group.coupled]
                .simulate(
                    rig,
                    group.times,
                    effect=effect if self.effect is not None else None,
                    torque=group.torque,
                    quantity=self.experiment.quantity,
                    tolerance=self.tolerance,
                    threads=self.threads,
                )
                .y
            )

        y = readings(rig)
        for i, c in enumerate(self.coordinates):
            if c.role == "lag" and c.index < y.shape[1]:
                late = rig | {"delay": rig.get("delay", 0.0) + from_standard(c.prior, q[:, i])}
                y[:, c.index] = readings(late)[:, c.index]
        return self._read(y, group, which, q, eta)

    def whitened(self, r: Array, weight: Array) -> Array:
        """Weighted innovations, (..., channels * n), of residuals r (..., channels, n)."""
        scaled = r * weight
        parts = [self.noise.whiten(c, scaled[..., c, :]) for c in range(r.shape[-2])]
        return np.concatenate(parts, axis=-1)

    def costs(self, q: Array, eta: Mapping[int, Array], annealed: bool = False) -> Array:
        """Cost of k candidates: q (k, size), eta: trial -> (k, m). inf where a simulation failed."""
        k = q.shape[0]
        total = np.sum(q**2, axis=1)
        for group in self.groups:
            n = len(group.trials)
            which = np.tile(np.arange(n), k)
            values = np.stack([eta[i] for i in group.trials], axis=1).reshape(k * n, -1)
            y = self.simulate(group, which, np.repeat(q, n, axis=0), values)
            r = y - group.y[which]
            w = self.whitened(r, group.weights(annealed)[which])
            chi2 = np.einsum("ij,ij->i", w, w)
            total = total + (chi2 + np.sum(values**2, axis=1)).reshape(k, n).sum(axis=1)
        return np.where(np.isfinite(total), total, np.inf)

    def linearise(
        self, q: Array, eta: Mapping[int, Array], *, annealed: bool = False, central: bool = False,
        steps: Array | None = None,
    ) -> Linear:  # fmt: skip
        """Whitened residuals and their derivatives at one point. steps (size,) of the differences in q."""
        blocks = []
        steps = np.full(self.size, 2e-3) if steps is None else steps
        for group in self.groups:
            # Unknowns of different cases or springs never meet in a trial: they share a simulation.
            together: dict[str, list[int]] = {}
            for i, c in enumerate(self.coordinates):
                if self._acts(c, group):
                    together.setdefault(c.name if c.role == "effect" else c.parameter, []).append(i)
            n = len(group.trials)
            m = len(group.nuisances)
            names = [name for name, _, _ in group.nuisances]
            moved = [
                i
                for i, name in enumerate(names)
                if not name.startswith("offset") and not (name in OWN_FRICTION and name[3:] in together)
            ]
            lanes = 1 + len(together) + len(moved)
            sides = (1.0, -1.0) if central else (1.0,)
            base_q = np.tile(q, (n, 1))
            base_eta = np.array([eta[i] for i in group.trials]).reshape(n, m)
            rows_q = [base_q]
            rows_eta = [base_eta]
            trial_steps = np.full((n, m), 2e-3)
            for i, name in enumerate(names):
                if name == "delay":
                    trial_steps[:, i] = 1e-6 / group.nuisances[i][2]
                trial_steps[:, i] *= np.where(base_eta[:, i] + trial_steps[:, i] > group.upper[:, i], -1.0, 1.0)
            for side in sides:
                for members in together.values():
                    moved_q = base_q.copy()
                    for i in members:
                        moved_q[:, i] += side * steps[i]
                    rows_q.append(moved_q)
                    rows_eta.append(base_eta)
                for i in moved:
                    moved_eta = base_eta.copy()
                    moved_eta[:, i] += side * trial_steps[:, i]
                    rows_q.append(base_q)
                    rows_eta.append(moved_eta)
            copies = len(rows_q)
            y = self.simulate(
                group, np.tile(np.arange(n), copies), np.concatenate(rows_q), np.concatenate(rows_eta)
            ).reshape(copies, n, -1, group.times.size)
            base = y[0]
            forward = y[1:lanes] - base
            if central:
                backward = y[lanes:] - base
                bad = ~np.isfinite(backward).all(axis=(2, 3))
                for k, i in enumerate(moved):
                    # Beyond the end of a nuisance's range a reading may jump: the release is another sample's.
                    back = base_eta[:, i] - trial_steps[:, i]
                    bad[len(together) + k] |= (back < group.lower[:, i]) | (back > group.upper[:, i])
                backward[bad] = -forward[bad]
                forward = 0.5 * (forward - backward)
            forward[~np.isfinite(forward).all(axis=(2, 3))] = 0.0
            weight = group.weights(annealed)
            r = self.whitened(base - group.y, weight)
            w = self.whitened(forward, weight)  # (lanes - 1, n, data)
            jac = np.zeros((n, self.size, w.shape[-1]))
            for k, members in enumerate(together.values()):
                for i in members:
                    hit = self.touched(self.coordinates[i], group)
                    jac[hit, i] = w[k][hit] / steps[i]
            own = np.zeros((n, m, w.shape[-1]))
            for k, i in enumerate(moved):
                own[:, i] = w[len(together) + k] / trial_steps[:, i, None]
            for i, name in enumerate(names):
                if name.startswith("offset"):
                    shift = np.zeros_like(group.y)
                    shift[:, int(name[6:]) - 1] = group.nuisances[i][2][:, None]
                    own[:, i] = self.whitened(shift, weight)
            for name in OWN_FRICTION:
                for i in together.get(name[3:], ()) if name in names else ():
                    hit = self.touched(self.coordinates[i], group)
                    per_log = math.log(_factor(self.coordinates[i].prior))
                    own[hit, names.index(name)] = jac[hit, i] * (FRICTION_SPREAD / per_log)
            blocks.append(Block(group, r, jac, own, base_eta))
        return Linear(self, q, tuple(blocks))

    def touched(self, c: Coordinate, group: Group) -> NDArray[np.bool_]:
        """Which trials of a group a coordinate belongs to, (trials,)."""
        trials = [self.experiment.trials[i] for i in group.trials]
        if c.role == "stiffness":
            return np.array([t.k1t == c.index for t in trials])
        return np.array([c.case is None or t.case == c.case for t in trials])

    def _acts(self, c: Coordinate, group: Group) -> bool:
        """Whether a coordinate can change the records of a group."""
        if c.role == "effect":
            return self.effect is not None and (group.coupled or self.effect.uncoupled)
        if c.role in ("sensor", "lag"):
            return group.coupled or c.index == 0
        free = group.coupled or c.role == "stiffness" or c.parameter in self._alone()
        return free and bool(self.touched(c, group).any())


def middle(prior: Distribution | float) -> float:
    """The median of a prior, or the number it is fixed at."""
    return float(prior) if isinstance(prior, float | int) else median(prior)


def _own_value(
    name: str, priors: Sequence[Distribution | float]
) -> tuple[tuple[str, Array, Array], tuple[Array, Array]] | None:
    """Nuisance of a parameter that each trial has for itself, with its bounds; None if it is fixed.

    Scales are followed by their logarithm, relative to the median. What is not Gaussian there already (uniform,
    half-normal) gets the Gaussian of the same middle and spread, cut where the prior ends.
    """
    if all(isinstance(p, float | int) for p in priors):
        return None
    means, sds, lows, highs = [], [], [], []
    log = all(isinstance(p, float | int | LogNormal | LogUniform) for p in priors) and name not in ("theta0", "delay")
    for p in priors:
        value = middle(p)
        if isinstance(p, float | int):
            spread, low, high = 1e-12, -math.inf, math.inf
        elif isinstance(p, LogNormal):
            spread, low, high = math.log(p.factor) * (1.0 if log else value), -math.inf, math.inf
        else:
            (low, high), edge = p.support, (float(p.ppf(0.16)), float(p.ppf(0.84)))
            spread = 0.5 * (math.log(edge[1] / edge[0]) if log else edge[1] - edge[0])
            if log:
                low, high = math.log(low / value), math.log(high / value)
        centre = 0.0 if log else value
        means.append(centre)
        sds.append(spread)
        lows.append(max((low - centre) / spread, -_FARTHEST))
        highs.append(min((high - centre) / spread, _FARTHEST))
    label = f"ln_{name}" if log else name
    return (label, np.array(means), np.array(sds)), (np.array(lows), np.array(highs))


def _model(experiment: Experiment, coupled: bool, effect: Variant | None) -> Model:
    """The model of one configuration."""
    law = experiment.coupling_law if coupled else "constant"
    return Model(coupled, experiment.normal_force, experiment.restoring, effect, law, longest_step(experiment))


def _first_slope(times: Array, y: Array, within: float) -> float:
    """Rate of change at the first reading, from a parabola through the readings `within` so many seconds."""
    near = (times <= times[0] + within) & np.isfinite(y)
    if np.count_nonzero(near) < 4:
        return 0.0
    return float(np.polynomial.polynomial.polyfit(times[near] - times[0], y[near], 2)[1])


def longest_step(experiment: Experiment) -> float:
    """Longest time step, s: 1 ms times a power of 2, and at least 120 to a period of the fastest primary."""
    omega = max(math.sqrt(max(k, 1e-300) / experiment.constants["J1"][0]) for k, _ in experiment.stiffnesses)
    return LONGEST_STEP * 2.0 ** max(0, math.floor(math.log2(2.0 * math.pi / omega / STEPS_PER_PERIOD / LONGEST_STEP)))


def _spread(distribution: Distribution) -> float:
    return float(distribution.ppf(0.84) - distribution.ppf(0.16))


def _factor(distribution: Distribution) -> float:
    """Local factor per unit of z of a scale parameter at its median (exact for a LogNormal)."""
    if isinstance(distribution, LogNormal):
        return distribution.factor
    if isinstance(distribution, LogUniform | Uniform | HalfNormal | Normal):
        low, high = float(from_standard(distribution, -0.1)), float(from_standard(distribution, 0.1))
        return (high / low) ** 5.0 if low > 0.0 else math.e
    return math.e


def release_window(trial: TrialRecord, quantity: str) -> tuple[float, float]:
    """Earliest and latest instant of release that the first readings allow, s.

    Accelerations jump at the release: a first reading near 0 while the next ones are at the peak means that the logger
    ran before it, any other that it came later, and the window is one sample wide. Velocities and displacements start
    without a jump, so the logger may have started up to a sample before or after.
    """
    n = min(trial.times.size - 1, 400)
    dt = float(np.median(np.diff(trial.times[: n + 1]))) if n > 0 else 1e-3
    if quantity != "acceleration":
        return -dt, (dt if trial.times[0] <= 0.0 else 0.0)
    if trial.times[0] > 0.0 or trial.times.size < 4:
        return -dt, 0.0
    y = np.abs(np.nan_to_num(trial.y[0]))
    peak = float(np.max(y[1:6]))
    held = 0
    while held < y.size - 2 and y[held] < 0.3 * peak and held < 3:
        held += 1
    if held == 0:
        return float(trial.times[0]) - dt, float(trial.times[0])
    return float(trial.times[held - 1]), float(trial.times[held])


# Linear algebra -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Block:
    """Whitened residuals r (trials, data), J (trials, size, data) and T (trials, m, data) of one group."""

    group: Group
    r: Array
    J: Array
    T: Array
    eta: Array


@dataclass(frozen=True, eq=False)
class Linear:
    """The problem linearised at q: what steps, covariance, evidence and screening are computed from."""

    problem: Problem
    q: Array
    blocks: tuple[Block, ...]

    def normal(self, extra: Sequence[Array] | None = None) -> Normals:
        """Normal equations with the nuisances eliminated.

        extra: for each block further columns (trials, k, data) to carry along, such as an effect to be screened.
        """
        k = 0 if extra is None else extra[0].shape[1]
        size = self.problem.size
        S = np.eye(size + k)
        S[size:, size:] = 0.0
        g = np.concatenate([self.q, np.zeros(k)])
        cost = float(self.q @ self.q)
        parts = []
        for b, block in enumerate(self.blocks):
            J = block.J if extra is None else np.concatenate([block.J, extra[b]], axis=1)
            m = block.eta.shape[1]
            full = np.concatenate([J, block.T, block.r[:, None, :]], axis=1)
            gram = np.matmul(full, full.transpose(0, 2, 1))
            p = size + k
            H = gram[:, p : p + m, p : p + m] + np.eye(m)
            TJ = gram[:, p : p + m, :p]
            gT = gram[:, p : p + m, -1] + block.eta
            S += gram[:, :p, :p].sum(axis=0)
            g += gram[:, :p, -1].sum(axis=0)
            cost += float(gram[:, -1, -1].sum() + np.sum(block.eta**2))
            parts.append((block, H, TJ, gT))
        return Normals(self, S, g, cost, tuple(parts), size, k)

    def pinned(self) -> Linear:
        """The same with nuisances held that are pressed against an end of their range: they can take nothing up."""
        blocks = []
        for b in self.blocks:
            low, high = b.group.lower, b.group.upper
            gradient = np.einsum("jmd,jd->jm", b.T, b.r) + b.eta
            near = 1e-6 * (high - low)
            held = ((b.eta - low < near) & (gradient > 0.0)) | ((high - b.eta < near) & (gradient < 0.0))
            blocks.append(replace(b, T=np.where(held[:, :, None], 0.0, b.T)) if held.any() else b)
        return replace(self, blocks=tuple(blocks))


@dataclass(frozen=True, eq=False)
class Normals:
    """S and g before the elimination, and each trial's H, T'J and nuisance gradient."""

    linear: Linear
    S: Array
    g: Array
    cost: float
    parts: tuple[tuple[Block, Array, Array, Array], ...]
    size: int
    extra: int

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array, list[Array]]:
        """S and g with the nuisances eliminated, and H_j^-1 of each block."""
        S, g = self.S.copy(), self.g.copy()
        inverses = []
        for _, H, TJ, gT in self.parts:
            if H.shape[1] == 0:
                inverses.append(H)
                continue
            m = H.shape[1]
            damped = H + damping * H * np.eye(m)
            inverse = np.linalg.inv(damped)
            S -= np.sum(TJ.transpose(0, 2, 1) @ (inverse @ TJ), axis=0)
            g -= np.sum(TJ.transpose(0, 2, 1) @ (inverse @ gT[:, :, None]), axis=0)[:, 0]
            inverses.append(np.asarray(inverse, float))
        return S, g, inverses

    def step(self, damping: float) -> tuple[Array, dict[int, Array]]:
        """Damped Gauss-Newton step in q and in each trial's eta."""
        S, g, inverses = self.reduced(damping)
        S[np.diag_indices_from(S)] *= 1.0 + damping
        dq = -np.linalg.solve(S, g)
        deta: dict[int, Array] = {}
        for (block, _, TJ, gT), inverse in zip(self.parts, inverses, strict=True):
            move = -np.einsum("jmn,jn->jm", inverse, gT + TJ @ dq) if inverse.shape[1] else gT
            for k, i in enumerate(block.group.trials):
                deta[i] = move[k]
        return np.asarray(dq, float), deta

    def log_evidence(self) -> float:
        """Laplace evidence without the constant of the noise; -inf if a matrix is not positive definite."""
        S, _, _ = self.reduced()
        total = -0.5 * self.cost
        sign, log_det = np.linalg.slogdet(S)
        if sign <= 0 or not np.isfinite(log_det):
            return -math.inf
        total -= 0.5 * log_det
        for _, H, _, _ in self.parts:
            if H.shape[1]:
                signs, log_dets = np.linalg.slogdet(H)
                if np.any(signs <= 0):
                    return -math.inf
                total -= 0.5 * float(np.sum(log_dets))
        return total if math.isfinite(total) else -math.inf


# The fit ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted model.

    q (size,), covariance (size, size) in coordinates with standard Gaussian priors; eta: trial -> (m,);
    chi2: sum of squared whitened residuals; cost: chi2 and the priors' share; n_data: weighted number of readings.
    """

    problem: Problem
    q: Array
    eta: Mapping[int, Array]
    covariance: Array
    cost: float
    chi2: float
    log_evidence: float
    converged: bool
    linear: Linear
    iterations: int

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of every unknown of the campaign."""
        out = {}
        for i, c in enumerate(self.problem.coordinates):
            x = float(from_standard(c.prior, self.q[i]))
            sd = math.sqrt(max(self.covariance[i, i], 0.0))
            up, down = from_standard(c.prior, self.q[i] + sd), from_standard(c.prior, self.q[i] - sd)
            out[c.name] = (x, 0.5 * abs(float(up - down)))
        return out

    @property
    def excess(self) -> float:
        """Chi-square beyond what noise alone would leave."""
        return self.chi2 - self.problem.n_data

    @property
    def pulled(self) -> dict[str, float]:
        """Declared constants that the fit moved by more than 3 of their standard deviations."""
        return {
            c.name: float(self.q[i])
            for i, c in enumerate(self.problem.coordinates)
            if c.role in ("constant", "stiffness") and abs(self.q[i]) > 3.0
        }

    def interval(self, name: str, share: float = 0.9) -> tuple[float, float]:
        """Central interval of one unknown, holding `share` of its probability."""
        i = self.problem.names.index(name)
        reach = float(ndtri(0.5 + 0.5 * share)) * math.sqrt(max(self.covariance[i, i], 0.0))
        prior = self.problem.coordinates[i].prior
        low, high = float(from_standard(prior, self.q[i] - reach)), float(from_standard(prior, self.q[i] + reach))
        return (low, high) if low <= high else (high, low)

    def residuals(self) -> dict[int, Array]:
        """Reading minus model of each fitted trial, (channels, n); nan where the reading is missing."""
        out = {}
        for group in self.problem.groups:
            n = len(group.trials)
            values = np.array([self.eta[i] for i in group.trials]).reshape(n, -1)
            y = self.problem.simulate(group, np.arange(n), np.tile(self.q, (n, 1)), values)
            for k, i in enumerate(group.trials):
                out[i] = self.problem.experiment.trials[i].y - y[k]
        return out


def calibrate(
    problem: Problem,
    starts: Iterable[ArrayLike] = (),
    *,
    eta: Mapping[int, Array] | None = None,
    most: int = 25,
    finish: bool = True,
    anneal: bool = True,
    give_up: float = math.inf,
    target: float = -math.inf,
) -> Calibration:
    """The best fit over the starts, each by annealed, damped Gauss-Newton steps.

    starts : points (size,) in q; default the prior medians, with smoothing constants below and above;
    eta : nuisances to start from; most : iterations per stage; finish : central differences at the end;
    give_up : a start whose cost after the first stage exceeds the best by more is not followed; target : a cost that
    another model has reached: a descend that gets nowhere near it ends early.

    A fit in which every simulation fails has cost inf and log_evidence -inf.
    """
    points = [np.asarray(s, float) for s in starts] or default_starts(problem)
    best: tuple[float, Array, dict[int, Array], bool, int] | None = None
    for point in points:
        own = {i: v.copy() for i, v in (eta or problem.no_nuisance()).items()}
        q = point
        used = 0
        if anneal:
            q, own, cost, _, used = _descend(problem, q, own, most, annealed=True, tolerance=0.5)
            if best is not None and cost > best[0] + give_up:
                continue
        goal = target if best is None else max(target, best[0])
        q, own, cost, converged, more = _descend(problem, q, own, most, annealed=False, tolerance=0.02, target=goal)
        if best is None or cost < best[0]:
            best = (cost, q, own, converged, used + more)
    assert best is not None
    cost, q, own, converged, used = best
    return summarise(problem, q, own, converged, used, central=finish)


def default_starts(problem: Problem) -> list[Array]:
    """Prior medians, with a smooth and a sharp friction."""
    start = problem.prior_mean()
    if "nu" not in problem.names:
        return [start]
    i = problem.names.index("nu")
    prior = problem.coordinates[i].prior
    out = []
    for factor in (0.6, 1.8):
        point = start.copy()
        point[i] = coordinate_of(prior, factor * median(prior))
        out.append(point)
    return out


def summarise(
    problem: Problem, q: Array, eta: Mapping[int, Array], converged: bool, iterations: int, central: bool = True
) -> Calibration:
    """Covariance, evidence and the rest at a point that a fit has reached."""
    linear = problem.linearise(q, eta, central=central)
    normals = linear.normal()
    S, _, _ = normals.reduced()
    try:
        covariance = cho_solve(cho_factor(S), np.eye(problem.size))
        evidence = normals.log_evidence()
    except (np.linalg.LinAlgError, ValueError):
        covariance, evidence = np.full((problem.size, problem.size), np.nan), -math.inf
    prior = float(q @ q) + sum(float(v @ v) for v in eta.values())
    cost = normals.cost if math.isfinite(normals.cost) else math.inf
    return Calibration(problem, q, dict(eta), covariance, cost, cost - prior, evidence, converged, linear, iterations)


def _descend(
    problem: Problem, q: Array, eta: dict[int, Array], most: int, annealed: bool, tolerance: float,
    target: float = -math.inf,
) -> tuple[Array, dict[int, Array], float, bool, int]:  # fmt: skip
    """Levenberg-Marquardt from one start: q, eta, cost, whether it converged, Jacobians used."""
    damping = 1e-2
    cost = float(problem.costs(q[None], {i: v[None] for i, v in eta.items()}, annealed)[0])
    if not math.isfinite(cost):
        return q, eta, cost, False, 0
    bounds = {i: (g.lower[k], g.upper[k]) for g in problem.groups for k, i in enumerate(g.trials)}
    for iteration in range(1, most + 1):
        normals = problem.linearise(q, eta, annealed=annealed).normal()
        accepted = False
        gained = 0.0
        for _ in range(3):
            candidates = []
            for factor in (0.03, 0.3, 3.0, 30.0):
                try:
                    dq, deta = normals.step(damping * factor)
                except np.linalg.LinAlgError:
                    continue
                shrink = min(1.0, 1.5 / max(float(np.max(np.abs(dq), initial=0.0)), 1e-12))
                moved = {i: np.clip(eta[i] + shrink * deta[i], *bounds[i]) for i in eta}
                candidates.append((damping * factor, q + shrink * dq, moved))
            if not candidates:
                damping *= 100.0
                continue
            trial_costs = problem.costs(
                np.array([c[1] for c in candidates]),
                {i: np.array([c[2][i] for c in candidates]) for i in eta},
                annealed,
            )
            k = int(np.argmin(trial_costs))
            if trial_costs[k] < cost:
                gained = cost - float(trial_costs[k])
                cost = float(trial_costs[k])
                damping, q, eta = candidates[k]
                damping = max(damping, 1e-7)
                accepted = True
                break
            damping *= 300.0
        if not accepted or gained < tolerance:
            return q, eta, cost, True, iteration
        if math.isfinite(target) and iteration >= 3 and cost - target > HOPELESS and HURRY * gained < cost - target:
            return q, eta, cost, False, iteration
    return q, eta, cost, False, most


# Held-out trials ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a fit says about a trial that it has not seen, its own nuisances fitted.

    model (channels, n), residual (channels, n) = reading - model, eta (m,), chi2: whitened and weighted; n_data:
    weighted number of readings.
    """

    trial: int
    model: Array
    residual: Array
    eta: Array
    chi2: float
    n_data: float


def predict(fit: Calibration, trials: Sequence[int], rounds: int = 12) -> dict[int, Prediction]:
    """Predictions for trials that the fit has not used: only their own nuisances are estimated, from several starts."""
    problem = fit.problem
    out: dict[int, Prediction] = {}
    for group in problem.grouped(tuple(trials)):
        n, m = len(group.trials), len(group.nuisances)
        names = [name for name, _, _ in group.nuisances]
        starts = [np.zeros(m)]
        if "delay" in names:
            for value in (-1.2, -0.8, -0.4, 0.4, 0.8, 1.2):
                point = np.zeros(m)
                point[names.index("delay")] = value
                starts.append(point)
        k = len(starts)
        which = np.repeat(np.arange(n), k)
        eta = np.tile(np.array(starts).reshape(k, m), (n, 1))
        low, high = group.lower[which], group.upper[which]
        eta = np.clip(eta, low, high)
        weight = group.weight[which]

        def evaluate(
            values: Array, which: Indices = which, weight: Array = weight, group: Group = group
        ) -> tuple[Array, Array]:
            y = problem.simulate(group, which, np.tile(fit.q, (which.size, 1)), values)
            r = problem.whitened(y - group.y[which], weight)
            total = np.einsum("ij,ij->i", r, r) + np.sum(values**2, axis=1)
            return r, np.where(np.isfinite(total), total, np.inf)

        r, cost = evaluate(eta)
        damping = np.full(n * k, 1e-2)
        for _ in range(rounds if m else 0):
            T = np.empty((n * k, m, r.shape[1]))
            for i, name in enumerate(names):
                step = np.full(n * k, 2e-3) if name != "delay" else 1e-6 / group.nuisances[i][2][which]
                step = np.where(eta[:, i] + step > high[:, i], -step, step)
                moved = eta.copy()
                moved[:, i] += step
                T[:, i] = (evaluate(moved)[0] - r) / step[:, None]
            T = np.nan_to_num(T)
            H = T @ T.transpose(0, 2, 1) + np.eye(m)
            H += damping[:, None, None] * H * np.eye(m)
            g = np.einsum("imd,id->im", T, np.nan_to_num(r)) + eta
            move = -np.linalg.solve(H, g[:, :, None])[:, :, 0]
            move *= np.minimum(1.0, 1.5 / np.maximum(np.abs(move).max(axis=1), 1e-12))[:, None]
            candidate = np.clip(eta + move, low, high)
            r_new, cost_new = evaluate(candidate)
            better = cost_new < cost
            done = np.all(~better | (cost - cost_new < 0.01)) and np.all(damping < 1e3)
            eta = np.where(better[:, None], candidate, eta)
            r = np.where(better[:, None], r_new, r)
            damping = np.where(better, damping * 0.1, damping * 30.0)
            cost = np.where(better, cost_new, cost)
            if done:
                break
        winner = cost.reshape(n, k).argmin(axis=1) + np.arange(n) * k
        chosen = eta[winner]
        y = problem.simulate(group, np.arange(n), np.tile(fit.q, (n, 1)), chosen)
        r = problem.whitened(y - group.y, group.weight)
        for j, i in enumerate(group.trials):
            residual = problem.experiment.trials[i].y - y[j]
            out[i] = Prediction(i, y[j], residual, chosen[j], float(r[j] @ r[j]), float(np.sum(group.weight[j] ** 2)))
    return out


# Noise --------------------------------------------------------------------------------------------------------------


def rough_noise(experiment: Experiment, trials: Sequence[int]) -> Noise:
    """White noise per channel from the fast content of the readings: for a first fit."""
    channels = 1 + int(any(experiment.trials[i].coupled for i in trials))
    sds = []
    for c in range(channels):
        pieces = []
        for i in trials:
            y = experiment.trials[i].y
            if c < y.shape[0] and y.shape[1] > 12:
                pieces.append(y[c])
        sd = _fast_level(pieces)
        declared = experiment.noise_sd[min(c, len(experiment.noise_sd) - 1)] if experiment.noise_sd else 0.0
        scale = max((float(np.nanmax(np.abs(experiment.trials[i].y))) for i in trials), default=1.0)
        sds.append(max(sd if sd > 0.0 else declared, 1e-6 * scale, 1e-300))
    return Noise(tuple(sds), (0.0,) * channels, (0.0,) * channels)


def _fast_level(series: Sequence[Array]) -> float:
    """Standard deviation of the white noise in series, from their fourth differences; 0 where there is too little."""
    fast = [np.diff(x, n=4)[4:] for x in series if x.size > 12]
    kept = np.concatenate([f[np.isfinite(f)] for f in fast]) if fast else np.zeros(0)
    return 1.4826 * float(np.median(np.abs(kept))) / math.sqrt(70.0) if kept.size else 0.0


def lone(experiment: Experiment, trials: Sequence[int]) -> bool:
    """Whether no two of the trials are repeats: one initial state and record length twice. Free starts never repeat."""
    keys = [(t.case, t.coupled, t.theta0, t.times.size) for t in (experiment.trials[i] for i in trials)]
    return experiment.start == "free" or len(set(keys)) == len(keys)


def error_level(residuals: Sequence[Array]) -> float:
    """Level, as of white noise, at which residuals with correlated errors carry the information that they do carry.

    Half of sum P^2 / sum P over the lines P of the periodograms: the variance times the sum of all squared
    autocorrelations (Bayley and Hammersley, 1946, J. R. Stat. Soc. Suppl. 8, 184: n readings tell as much of a variance
    as n over that sum independent ones do). For white residuals it is their standard deviation.
    """
    lines = [np.abs(np.fft.rfft(r - r.mean())[1:-1]) ** 2 / r.size for r in residuals if r.size > 8]
    if not lines:
        return 0.0
    power = np.concatenate(lines)
    total = float(power.sum())
    return math.sqrt(0.5 * float(power @ power) / total) if total > 0.0 else 0.0


def _white_enough(readings: int) -> float:
    """Ratio of `error_level` to the noise of the sensors up to which nothing speaks for correlated errors.

    One standard deviation: from n readings the former is known to sqrt(1 / n), the latter, from a median of
    differences, to sqrt(2 / n). White noise that exceeds it loses some per cent of sharpness; colour taken for white
    noise would be taken for a gap.
    """
    return min(1.0 + math.sqrt(3.0 / max(readings, 1)), WHITE_ENOUGH)


def learn_noise(fit: Calibration, colour: bool = True) -> Noise:
    """Noise of each channel from what the repeats do not share; without repeats, from the residuals.

    What the repeats share is the model's fault, not noise: it drops out of the differences. Colour is only claimed
    where it raises the likelihood by more than 3 nats. Without repeats the residuals' fast content is the noise of the
    sensors, and nothing tells the rest from a model that is wrong in a way that would repeat. Posteriors and evidences
    must allow for that error, so the noise is then white at the `error_level` of the residuals.
    """
    noise = _unshared_noise(fit, colour)
    problem = fit.problem
    if not lone(problem.experiment, problem.trials):
        return noise
    found = fit.residuals()
    weights = {i: g.weight[k] for g in problem.groups for k, i in enumerate(g.trials)}
    levels, sensors, white = [], [], []
    for c, total in enumerate(noise.total):
        used = [r[c][weights[i][c] > 0.0] for i, r in found.items() if c < r.shape[0]]
        # Lines leak from a large slow error into the fast ones of a short record; differences do not.
        fast = _fast_level(used)
        sensors.append(min(fast, total) if fast > 0.0 else total)
        levels.append(max(sensors[-1], error_level(used)))
        white.append(levels[-1] < _white_enough(sum(r.size for r in used)) * sensors[-1])
    if all(white):
        return noise
    zero = (0.0,) * len(levels)
    return Noise(tuple(levels), zero, zero, sensor=tuple(sensors))


def _unshared_noise(fit: Calibration, colour: bool) -> Noise:
    problem = fit.problem
    e = problem.experiment
    residuals = fit.residuals()
    channels = len(problem.noise.innovation)
    sets: dict[tuple[str, bool, float], list[int]] = {}
    for i in problem.trials:
        t = e.trials[i]
        sets.setdefault((t.case, t.coupled, t.theta0), []).append(i)
    weights = {i: g.weight[k] for g in problem.groups for k, i in enumerate(g.trials)}
    innovation: list[float] = []
    phis: list[float] = []
    thetas: list[float] = []
    for c in range(channels):
        spectra: dict[int, list[Array]] = {}
        counts: dict[int, float] = {}
        lone: dict[int, list[Array]] = {}
        for members in sets.values():
            usable = [i for i in members if c < residuals[i].shape[0] and weights[i][c].max(initial=0.0) > 0.9]
            lengths = {residuals[i].shape[1] for i in usable}
            if not usable:
                continue
            stack = [np.nan_to_num(residuals[i][c]) for i in usable]
            if len(usable) > 1 and len(lengths) == 1:
                deviation = np.array(stack) - np.mean(stack, axis=0)
                keep = np.min([weights[i][c] for i in usable], axis=0) > 0.9
                deviation = deviation[:, keep] * math.sqrt(len(usable) / (len(usable) - 1.0))
                for d in deviation:
                    power = np.abs(np.fft.rfft(d)) ** 2 / d.size
                    spectra.setdefault(d.size, []).append(power[1:])
                    counts[d.size] = counts.get(d.size, 0.0) + (len(usable) - 1.0) / len(usable)
            else:
                for d in stack:
                    power = np.abs(np.fft.rfft(d)) ** 2 / d.size
                    lone.setdefault(d.size, []).append(power[power.size // 3 :])
        if spectra and sum(len(v) for v in spectra.values()) > 1:
            a, p, theta = _fit_spectrum(
                spectra, counts, colour and all(evenly_sampled(e.trials[i].times) for i in problem.trials)
            )
        elif lone:
            values = np.concatenate([x for v in lone.values() for x in v])
            a, p, theta = math.sqrt(float(np.mean(np.minimum(values, 12.0 * np.median(values))))), 0.0, 0.0
        else:
            a, p, theta = problem.noise.innovation[c], 0.0, 0.0
        innovation.append(max(a, 1e-300))
        phis.append(p)
        thetas.append(theta)
    return Noise(tuple(innovation), tuple(phis), tuple(thetas))


def evenly_sampled(times: Array) -> bool:
    """Whether the samples are evenly spaced, to 2 %."""
    gaps = np.diff(times)
    return bool(gaps.size > 0 and gaps.max() < 1.02 * gaps.min() + 1e-12)


def _fit_spectrum(
    spectra: Mapping[int, list[Array]], counts: Mapping[int, float], colour: bool
) -> tuple[float, float, float]:
    """Whittle fit of a white plus an AR(1) process: sd of the innovations, phi, theta of the ARMA(1, 1) they form."""
    omega, power, count = spectrum_bins(spectra, counts)
    white = float(np.sum(count * power) / np.sum(count))
    if not colour or omega.size < 50:
        return math.sqrt(white), 0.0, 0.0
    return whittle(omega, power, count)


def spectrum_bins(spectra: Mapping[int, list[Array]], counts: Mapping[int, float]) -> tuple[Array, Array, Array]:
    """Angular frequency, mean power and count of every bin of spectra by record length (without their mean)."""
    bins = []
    for n, powers in spectra.items():
        mean = np.mean(powers, axis=0)
        omega = 2.0 * np.pi * np.arange(1, mean.size + 1) / n
        bins.append((omega[:-1], mean[:-1], counts[n]))
    omega = np.concatenate([b[0] for b in bins])
    power = np.concatenate([b[1] for b in bins])
    count = np.concatenate([np.full(b[0].size, b[2]) for b in bins])
    return omega, power, count


def whittle(
    omega: Array, power: Array, count: Array, farthest: float = 0.99, starts: Sequence[float] = (2.0,)
) -> tuple[float, float, float]:
    """Whittle fit of a white plus an AR(1) process to power at omega: innovation, phi, theta of their ARMA(1, 1).

    White where colour raises the likelihood by less than 3 nats. farthest : largest phi; starts : logits of phi.
    """
    white = float(np.sum(count * power) / np.sum(count))

    def minus_log(x: Array) -> float:
        a, b, phi = math.exp(x[0]), math.exp(x[1]), farthest / (1.0 + math.exp(-x[2]))
        s = a + b / (1.0 + phi * phi - 2.0 * phi * np.cos(omega))
        return float(np.sum(count * (np.log(s) + power / s)))

    flat = float(np.sum(count * (math.log(white) + power / white)))
    begun = [np.array([math.log(0.8 * white), math.log(0.04 * white), x]) for x in starts]
    options = {"maxiter": 400, "xatol": 1e-3, "fatol": 1e-3}
    tried = [minimize(minus_log, start, method="Nelder-Mead", options=options) for start in begun]
    found = min(tried, key=lambda t: float(t.fun))
    if flat - float(found.fun) < 3.0:
        return math.sqrt(white), 0.0, 0.0
    a, b, phi = math.exp(found.x[0]), math.exp(found.x[1]), farthest / (1.0 + math.exp(-found.x[2]))
    # a |1 - phi z|^2 + b = s^2 |1 - theta z|^2
    if a * phi <= 0.0:
        return math.sqrt(white), 0.0, 0.0
    half = (a * (1.0 + phi * phi) + b) / (2.0 * a * phi)
    inverse = half + math.sqrt(max(half * half - 1.0, 0.0))
    return math.sqrt(a * phi * inverse), phi, 1.0 / inverse


# From the first fit to the nuisances that are needed ----------------------------------------------------------------


def choose_switches(fit: Calibration) -> Switches:
    """Which nuisances the repeats call for, from a fit in which all are free.

    Repeats of one case differ only in what is each trial's own, so the spread of the nuisances between repeats, beyond
    their own uncertainty, tells whether release or friction vary, whatever the model leaves out. A release that is late
    by the same time in all of them is left to the effects of release and sensor.
    Trials without repeats cannot tell: there both stay free. So does the release where few repeats may be as late as
    each other by chance: what that does to the first readings looks like an effect.
    Nor can values that a wrong model has pressed against an end of their range other than the nominal one.
    """
    problem = fit.problem
    wanted = {"delay": False, "ln_mu": False}
    normals = fit.linear.normal()
    for name in wanted:
        z: list[float] = []
        spare, pressed = 0, 0
        enough = FEW_REPEATS if name == "delay" else 1
        for block, H, _, _ in normals.parts:
            names = [n for n, _, _ in block.group.nuisances]
            if name not in names or not H.shape[1]:
                continue
            i = names.index(name)
            sd = np.sqrt(np.linalg.inv(H)[:, i, i])
            for members in _repeats([problem.experiment.trials[j] for j in block.group.trials]):
                spare += len(members) - 1
                values = block.eta[members, i]
                pressed += _pressed(block.group, i, members, values)
                pull = sd[members]
                z += list((values - values.mean()) / pull / math.sqrt(max(1.0 - 1.0 / len(members), 1e-9)))
        wanted[name] = bool(z) and (spare < enough or 2 * pressed >= len(z) or float(np.mean(np.square(z))) > VARIES)
    return Switches(delay=wanted["delay"], friction=wanted["ln_mu"])


def _repeats(trials: Sequence[TrialRecord]) -> list[list[int]]:
    """Positions of the trials of one case and release, a list each."""
    same: dict[tuple[str, float], list[int]] = {}
    for k, t in enumerate(trials):
        same.setdefault((t.case, t.theta0), []).append(k)
    return list(same.values())


def drag_varies(fit: Calibration) -> bool:
    """Whether the drag of the bearings differs between repeats of the primary alone, beyond its uncertainty.

    By the linearised problem of the fit: each trial's own drag beside its other nuisances. Only repeats can tell, and
    without them one drag for all it is.
    """
    problem = fit.problem
    here = [i for i, c in enumerate(problem.coordinates) if c.parameter == "drag"]
    if problem.experiment.start != "rest" or not here:
        return False
    z: list[float] = []
    spare = 0
    for block in fit.linear.blocks:
        if block.group.coupled:
            continue
        m = block.T.shape[1]
        rows = np.concatenate([block.T, block.J[:, here].sum(axis=1, keepdims=True)], axis=1)
        H = rows @ rows.transpose(0, 2, 1) + np.diag(np.append(np.ones(m), 1e-12))
        g = np.einsum("jmd,jd->jm", rows, block.r) + np.pad(block.eta, ((0, 0), (0, 1)))
        values = -np.linalg.solve(H, g[:, :, None])[:, m, 0]
        sd = np.sqrt(np.linalg.inv(H)[:, m, m])
        for members in _repeats([problem.experiment.trials[j] for j in block.group.trials]):
            spare += len(members) - 1
            if len(members) > 1:
                off = (values[members] - values[members].mean()) / sd[members]
                z += list(off / math.sqrt(1.0 - 1.0 / len(members)))
    return spare > 1 and float(np.mean(np.square(z))) > VARIES


def _pressed(group: Group, i: int, members: Sequence[int], values: Array) -> int:
    """How many values of nuisance i lie at an end of their range that is not the nominal value 0."""
    _, mean, sd = group.nuisances[i]
    low, high = group.lower[members, i], group.upper[members, i]
    near = 0.02 * (high - low)
    off_low = np.abs(mean[members] / sd[members] + low) > near
    off_high = np.abs(mean[members] / sd[members] + high) > near
    return int(np.sum((values - low < near) & off_low) + np.sum((high - values < near) & off_high))


def grown(experiment: Experiment, problem: Problem) -> list[Array]:
    """Starts for long records: fits to their first few periods, carried on over windows twice as long each time.

    Over many periods an error of the frequency by one part in as many puts the model out of phase, and the cost has a
    valley for every cycle; over the first periods it has one. Empty for short records, which need none of it.
    """
    trials = [experiment.trials[i] for i in problem.trials]
    omega = max(math.sqrt(max(k, 1e-300) / experiment.constants["J1"][0]) for k, _ in experiment.stiffnesses)
    period = 2.0 * math.pi / omega
    span = max(float(t.times[-1] - t.times[0]) for t in trials)
    window = FIRST_PERIODS * period
    if span < LONG_PERIODS * period:
        return []
    starts: list[Array] = default_starts(problem)
    while window < span:
        cut = []
        for t in experiment.trials:
            keep = t.times <= t.times[0] + window
            torque = None if t.torque is None else t.torque[keep]
            cut.append(replace(t, times=t.times[keep], y=t.y[:, keep], torque=torque))
        shorter = replace(experiment, trials=tuple(cut))
        part = Problem(
            shorter, nominal=problem.nominal, noise=problem.noise, switches=problem.switches, threads=problem.threads,
            trials=problem.trials,
        )  # fmt: skip
        starts = [calibrate(part, starts, most=GROWING_STEPS, finish=False, give_up=300.0).q]
        window *= 2.0
    return starts


def calibrate_nominal(
    experiment: Experiment,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    threads: int = 1,
    switches: Switches | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """The nominal model fitted to the training trials: roughly, then with the nuisances and noise that they show."""
    first = rough_noise(experiment, experiment.training)
    if lone(experiment, experiment.training):
        # The error of the model is not known yet, and may be a thousand times the noise: begin with a broad valley.
        trials = [experiment.trials[i] for i in experiment.training]
        reach = [max(float(np.nanmax(np.abs(t.y[c]))) for t in trials if c < len(t.y)) for c in range(len(first.phi))]
        level = tuple(max(s, FIRST_ERROR * r) for s, r in zip(first.innovation, reach, strict=True))
        first = replace(first, innovation=level, sensor=first.total)
    problem = Problem(experiment, nominal=nominal, noise=first, threads=threads, switches=switches or Switches())
    fit = calibrate(problem, [*grown(experiment, problem), *default_starts(problem)], most=15, finish=False)
    chosen = switches or choose_switches(fit)
    problem = Problem(experiment, nominal=nominal, noise=learn_noise(fit), switches=chosen, threads=threads)
    starts = [fit.q, *default_starts(problem)]
    fit = calibrate(problem, starts, give_up=300.0)
    if switches is None and not fit.problem.noise.sensor and drag_varies(fit):
        chosen = replace(chosen, drag=True)
        problem = Problem(experiment, nominal=nominal, noise=fit.problem.noise, switches=chosen, threads=threads)
        fit = calibrate(problem, [fit.q], anneal=False)
    noise = learn_noise(fit)
    tell(f"noise sd {', '.join(f'{s:.3g}' for s in noise.total)}")
    problem = Problem(experiment, nominal=nominal, noise=noise, switches=chosen, threads=threads)
    fit = calibrate(problem, [fit.q], eta=fit.eta, anneal=False)
    if noise.sensor:
        # A better fit leaves less error, which again sharpens the fit.
        fit = calibrate(problem.with_noise(learn_noise(fit)), [fit.q], eta=fit.eta, anneal=False)
    return fit


# Reading a campaign -------------------------------------------------------------------------------------------------


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
        told = f"priors {priors.name!r}: {name}"
        if name in ties:
            if name in ("theta0", "delay"):
                faults.append(f"{told} cannot be tied; give it a level, a number or a prior")
            continue
        if name in ("theta0", "delay") and experiment.start == "free":
            faults.append(f'{told} has no meaning where start is "free"; leave it out')
        levels[name] = entry.level
        if entry.cases:
            own[name] = {case: value for case, value in entry.cases.items() if case in known}
            levels[name] = "case" if entry.level == "campaign" else entry.level
        if entry.value is not None and not isinstance(entry.value, str):
            values[name] = entry.value
        elif entry.value == "" and known - set(entry.cases):
            missing = ", ".join(sorted(known - set(entry.cases)))
            faults.append(f"{told} has numbers for some cases only; add those of {missing}")
        elif entry.value is None and name == "theta0" and entry.level != "trial":
            angles = {(t.theta0, t.theta0_sd) for t in experiment.trials}
            if entry.level == "campaign" and len(angles) > 1:
                faults.append(
                    f"{told} is one for the campaign, but trials.csv has several angles; give it a level of case"
                )
            own[name] = {t.case: Normal(t.theta0, max(t.theta0_sd, 1e-12)) for t in experiment.trials}
        elif entry.value is None and name == "theta0":
            levels.pop(name)
        elif entry.value is None and name == "delay":
            rate = float(
                np.median([float(np.median(np.diff(t.times))) for t in experiment.trials if t.times.size > 1] or [1e-3])
            )
            values[name] = Normal(0.0, rate)
    if faults:
        raise InputError(faults)
    return replace(
        experiment, priors={**experiment.priors, **values}, levels={**experiment.levels, **levels},
        case_priors={**experiment.case_priors, **own}, ties={**experiment.ties, **ties},
    )  # fmt: skip


def gridded(experiment: Experiment) -> Experiment:
    """The experiment with repeats on one even grid of times, nan where a reading is missing, where there is one."""
    trials = list(experiment.trials)
    sets: dict[tuple[str, bool, float], list[int]] = {}
    for i, t in enumerate(trials):
        sets.setdefault((t.case, t.coupled, t.theta0), []).append(i)
    for members in sets.values():
        found = common_grid([trials[i].times for i in members])
        if found is None:
            continue
        grid, places = found
        for i, place in zip(members, places, strict=True):
            t = trials[i]
            y = np.full((t.y.shape[0], grid.size), np.nan)
            y[:, place] = t.y
            torque = None if t.torque is None else np.interp(grid, t.times, t.torque)
            trials[i] = replace(t, times=grid, y=y, torque=torque)
    return replace(experiment, trials=tuple(trials))


def thinned(experiment: Experiment) -> Experiment:
    """The experiment with displacements and velocities of free starts thinned to some 100 readings a period.

    Such records hold nothing faster that a torque could have made, and their errors, that of the model first, are the
    same over many readings. Readings are picked, not averaged: an average would shrink fast swings.
    """
    if experiment.quantity == "acceleration" or experiment.start != "free":
        return experiment
    omega = max(math.sqrt(max(k, 1e-300) / experiment.constants["J1"][0]) for k, _ in experiment.stiffnesses)
    wanted = 2.0 * math.pi / omega / READINGS_PER_PERIOD
    trials = []
    for t in experiment.trials:
        every = max(1, math.floor(wanted / float(np.median(np.diff(t.times))))) if t.times.size > 1 else 1
        torque = None if t.torque is None else t.torque[::every]
        trials.append(t if every == 1 else replace(t, times=t.times[::every], y=t.y[:, ::every], torque=torque))
    return replace(experiment, trials=tuple(trials))


def experiment_of(campaign: Any, priors: PriorSet | Mapping[str, Distribution | float] | None = None) -> Experiment:
    """A campaign.Campaign as an Experiment; priors override those of `default_priors`.

    Where no trial is marked as held out, the last one of each case and configuration that has repeats is.
    """
    rig, measurement = campaign.rig, campaign.measurement
    fields = {
        "J1": "primary_inertia", "J2": "secondary_inertia", "R": "bar_radius", "r": "magnet_radius",
        "N0": "magnet_pull", "k3t": "ground2_stiffness", "J12": "inertial_coupling",
    }  # fmt: skip
    constants: dict[str, tuple[float, float]] = {}
    for name, field_name in fields.items():
        value = getattr(rig, field_name, None)
        if value is not None:
            constants[name] = (float(getattr(value, "value", value)), float(getattr(value, "std", 0.0) or 0.0))
    stiffnesses: list[tuple[float, float]] = []
    records = []
    heldout = {id(t) for t in campaign.heldout}
    for t in campaign.trials:
        key = (float(getattr(t.k1t, "value", t.k1t)), float(getattr(t.k1t, "std", 0.0) or 0.0))
        if key not in stiffnesses:
            stiffnesses.append(key)
        angle = t.theta0
        theta0 = 0.0 if angle is None else float(getattr(angle, "value", angle))
        first, shift = 0, 0.0
        if measurement.start == "rest" and t.torque is None:
            omega = math.sqrt(max(key[0], 1e-300) / constants["J1"][0])
            primary = np.atleast_2d(np.array(t.channels, float))[0]
            first, shift = release_of(np.array(t.times, float), primary, measurement.quantity, theta0, omega)
        records.append(
            TrialRecord(
                label=str(t.file),
                case=t.case,
                coupled=t.configuration == "coupled",
                number=int(t.trial),
                times=np.array(t.times, float)[first:] - shift,
                y=np.atleast_2d(np.array(t.channels, float))[:, first:],
                k1t=stiffnesses.index(key),
                theta0=theta0,
                theta0_sd=0.0 if angle is None else float(getattr(angle, "std", 0.0) or 0.0),
                torque=None if t.torque is None else np.array(t.torque, float)[first:],
                heldout=id(t) in heldout,
            )
        )
    sd = getattr(measurement, "noise_std", None)
    given = () if sd is None else tuple(float(x) for x in np.atleast_1d(np.asarray(sd, float)))
    experiment = Experiment(
        constants, tuple(stiffnesses), tuple(records), measurement.quantity, rig.normal_force, rig.restoring,
        measurement.start, given, offset_sd=measurement.offset_std, scale_sd=measurement.scale_std or (),
        lag_sd=measurement.lag_std or (),
        coupling_law=rig.inertial_coupling_law,
    )  # fmt: skip
    experiment = thinned(gridded(experiment))
    if isinstance(priors, PriorSet):
        return with_priors(experiment, priors)
    return replace(experiment, priors=dict(priors or {}))
