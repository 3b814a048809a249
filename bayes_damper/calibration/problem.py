"""What the fit of one model to one experiment needs: unknowns in standard coordinates, trials in groups, weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import partial
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.derivatives import Indices, blocks_of
from bayes_damper.calibration.experiment import (
    Experiment,
    longest_step,
)
from bayes_damper.calibration.groups import Bundle, Group, Grouping, Switches, bundled
from bayes_damper.calibration.noise import Noise, rough_noise
from bayes_damper.calibration.normal_equations import Block, Linear, Remade
from bayes_damper.calibration.own_values import RELEASE, channel_of, middle_of, of_readings
from bayes_damper.calibration.unknowns import NOMINAL, TREND, Coordinate, acting_alone, coordinates_of, middle
from bayes_damper.effects.base import Variant
from bayes_damper.priors.distributions import (
    Distribution,
    columns_from_standard,
    from_standard,
)
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.simulation.model import Model, delayed

Array = NDArray[np.float64]
READINGS_AT_ONCE = 1_000_000  # simulated in one go where candidates are compared
FINER = 0.01  # factor on the integrator's tolerance where records are subtracted from each other
_KEPT = ("experiment", "effect", "nominal", "noise", "switches", "tolerance", "trials", "factors")
"""Arguments of a `Problem`."""


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
        tolerance: float = 1.0,
        trials: Sequence[int] | None = None,
        factors: Mapping[int, Array] | None = None,
    ) -> None:
        """`trials`: indices of those to fit, default all that are not held out; `noise` is estimated if absent;
        factors: trial -> what multiplies the weights of its readings, (channels, n) or a number.
        """
        self.experiment = experiment
        self.nominal = nominal
        self.tolerance = tolerance
        self.trials = tuple(experiment.training if trials is None else trials)
        self.switches = switches or Switches()
        self.factors = dict(factors or {})
        self.noise = noise or rough_noise(experiment, self.trials)
        self._cases = tuple(dict.fromkeys(t.case for t in experiment.trials))
        self._medians = {
            name: {case: middle(self.prior(name, case)) for case in self._cases} for name in NOMINAL
        }  # of each case
        self._take(effect)
        self._groups: dict[tuple[int, ...], list[Group]] = {}
        self._bundles: dict[tuple[int, ...], list[Bundle]] = {}
        self.groups = self.grouped(self.trials)

    def changed(self, **changes: Any) -> Self:
        """The same problem with other arguments: `experiment`, `noise` ... Subclasses say how they are made."""
        return cast("Self", Problem(**({name: getattr(self, name) for name in _KEPT} | changes)))

    def with_noise(self, noise: Noise) -> Self:
        """The same problem under another noise."""
        return self.changed(noise=noise)

    def reweighted(self, factors: Mapping[int, Array]) -> Self:
        """The same problem with weights of readings multiplied: trial -> (channels, n) or a number."""
        both = {i: f * self.factors[i] if i in self.factors else f for i, f in factors.items()}
        return self.changed(factors={**self.factors, **both})

    def for_trials(self, trials: Sequence[int]) -> Self:
        """The same problem for other trials of the experiment."""
        return self.changed(trials=trials)

    def with_effect(self, effect: Variant | None) -> Problem:
        """The same data, noise and nuisances under another effect; groups are shared."""
        other = Problem.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other._take(effect)  # noqa: SLF001 (the same class)
        return other

    def _take(self, effect: Variant | None) -> None:
        """Unknowns and models with an effect, or without one."""
        e = self.experiment
        used = [e.trials[i] for i in self.trials] or e.trials
        self.effect = effect
        self.coordinates = coordinates_of(e, used, self.nominal, effect, self.prior)
        self.names = tuple(c.name for c in self.coordinates)
        self.size = len(self.coordinates)
        self.models = {coupled: _model(e, coupled, effect) for coupled in (False, True)}

    @property
    def identity(self) -> tuple[Any, ...]:
        """All that decides what a fit of it ends at: two problems with equal ones are one."""
        return (type(self).__name__, *(getattr(self, name) for name in _KEPT))

    @property
    def n_data(self) -> float:
        """Number of readings, weighted."""
        return float(sum(np.sum(g.trust**2) for g in self.groups))

    # Set-up

    def prior(self, name: str, case: str) -> Distribution | float:
        """Prior of a parameter for the trials of a case: a distribution, or a number where it is fixed."""
        return self.experiment.prior(name, case)

    def grouped(self, trials: Sequence[int]) -> list[Group]:
        """The trials in groups that share a simulation."""
        known = self._groups.get(tuple(trials))
        if known is not None:
            return known
        e = self.experiment
        keyed: dict[tuple[Any, ...], list[int]] = {}
        for i in trials:
            t = e.trials[i]
            driven = None if t.inputs is None or not t.inputs.active else t.inputs.key
            keyed.setdefault((t.coupled, t.times.tobytes(), driven), []).append(i)
        grouping = Grouping(e, self.noise, self.switches, self.nominal, self.factors, self.coordinates, self.prior)
        groups = [grouping.group(members) for members in keyed.values()]
        self._groups[tuple(trials)] = groups
        return groups

    @property
    def bundles(self) -> list[Bundle]:
        """The groups, those together whose trials differ by their clocks alone."""
        same = tuple(map(id, self.groups))
        if same not in self._bundles:
            self._bundles[same] = bundled(self.groups)
        return self._bundles[same]

    # Simulation

    def prior_mean(self) -> Array:
        """The start at the prior medians, (size,)."""
        return np.zeros(self.size)

    def no_nuisance(self) -> dict[int, Array]:
        """Nuisances at their prior means: trial -> (m,)."""
        return {i: np.array([middle_of(n) for n, _, _ in g.nuisances]) for g in self.groups for i in g.trials}

    def parameters(self, q: Array) -> dict[str, Array]:
        """Values of the coordinates q (..., size) by name."""
        return {c.name: from_standard(c.prior, q[..., i]) for i, c in enumerate(self.coordinates)}

    def _inputs(self, group: Group, which: Indices, q: Array, eta: Array) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arguments of Model.simulate for vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        e = self.experiment
        rig = _declared(self, self._medians, group, which)
        effect: dict[str, Any] = {}
        for c, x in zip(self.coordinates, _values(self.coordinates, q), strict=True):
            if c.role == "effect":
                effect[c.name.removeprefix(OF_EFFECT)] = x
            elif c.role in ("sensor", "lag"):
                continue
            elif c.role == "trend":
                name, order = c.name.removeprefix(TREND), np.array([e.trials[i].order for i in group.trials])[which]
                rig[name] = rig.get(name, 1.0) * np.exp(order * x)
            elif c.role == "stiffness" or c.case is not None:
                hit = self.touched(c, group)[which]
                rig[c.parameter] = np.where(hit, x, rig[c.parameter])
            else:
                rig[c.name] = x
        for i, (name, mean, sd) in enumerate(group.nuisances):
            x = mean[which] + sd[which] * eta[:, i]
            if name.startswith("ln_"):
                rig[name[3:]] = rig.get(name[3:], 1.0) * np.exp(x)
            elif not of_readings(name):
                rig[name] = x
        for name, other in e.ties.items():
            if name in NOMINAL:
                rig[name] = rig[other]
        if e.start == "free":
            rig["delay"] = group.times[which, 0] if group.times.ndim == 2 else float(group.times[0])
        if RELEASE in rig and e.ends_bounded and any(name == "delay" for name, _, _ in group.nuisances):
            rig["delay"] = rig["delay"] - rig[RELEASE]
        acting = self.models[group.coupled].acting
        if RELEASE in rig and acting is not None and acting.lets_go in effect:
            effect[acting.lets_go] = effect[acting.lets_go] + rig.pop(RELEASE)
        return {"theta2_0": rig["theta0"]} | rig, effect

    def simulate(self, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Readings (n, channels, n_times) of vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        rig, effect = self._inputs(group, which, q, eta)
        motion = partial(
            self.models[group.coupled].simulate, times=group.times[which] if group.times.ndim == 2 else group.times,
            effect=effect if self.effect is not None else None,
            inputs=group.inputs, quantity=self.experiment.quantity, tolerance=self.tolerance,
        )  # fmt: skip
        y = motion(rig).y
        for i, c in enumerate(self.coordinates):
            if c.role == "lag" and c.index < y.shape[1]:
                if group.inputs is not None and group.inputs.active:
                    lags = [from_standard(c.prior, q[:, i]) if k == c.index else 0.0 for k in range(y.shape[1])]
                    y = delayed(y, group.times, lags)
                    continue
                late = rig | {"delay": rig.get("delay", 0.0) + from_standard(c.prior, q[:, i])}
                y[:, c.index] = motion(late).y[:, c.index]
        return _as_sensors_show(y, self.coordinates, group, which, q, eta)

    def finer(self) -> Problem:
        """The same problem with records integrated more finely, for differences between them."""
        out = copy(self)
        out.tolerance = FINER * self.tolerance
        return out

    def whitened(self, r: Array, weight: Array) -> Array:
        """Weighted innovations, (..., channels * n), of residuals r (..., channels, n)."""
        return self.noise.whitened(r, weight).reshape(*r.shape[:-2], -1)

    def costs(self, q: Array, eta: Mapping[int, Array], annealed: bool = False) -> Array:
        """Cost of k candidates: q (k, size), eta: trial -> (k, m). inf where a simulation failed."""
        total = np.sum(q**2, axis=1) + sum(self.costs_of_trials(q, eta, annealed).values())
        return np.where(np.isfinite(total), total, np.inf)

    def costs_of_trials(self, q: Array, eta: Mapping[int, Array], annealed: bool = False) -> dict[int, Array]:
        """What each trial has of the cost of k candidates: trial -> (k,)."""
        k = q.shape[0]
        out: dict[int, Array] = {}
        for group in (bundle.whole for bundle in self.bundles):
            values = np.stack([eta[i] for i in group.trials], axis=1)
            most = max(READINGS_AT_ONCE // group.y.size, 1)
            turns = [slice(first, first + most) for first in range(0, max(k, 1), most)]
            own = np.concatenate([self._costs_in(group, q[at], values[at], annealed) for at in turns])
            out |= dict(zip(group.trials, own.T, strict=True))
        return out

    def _costs_in(self, group: Group, q: Array, eta: Array, annealed: bool) -> Array:
        """Cost (k, trials) of k candidates in one group; q (k, size), eta (k, trials, m)."""
        k, n, m = eta.shape
        values = eta.reshape(k * n, m)
        r = self.simulate(group, np.tile(np.arange(n), k), np.repeat(q, n, axis=0), values).reshape(k, *group.y.shape)
        r -= group.y
        w = self.whitened(r, group.weights(annealed)).reshape(k * n, -1)
        return np.asarray((np.einsum("ij,ij->i", w, w) + np.sum(values**2, axis=1)).reshape(k, n))

    def linearise(
        self, q: Array, eta: Mapping[int, Array], *, annealed: bool = False, central: bool = False,
        steps: Array | None = None, known: tuple[Block, ...] = (),
    ) -> Linear:  # fmt: skip
        """Whitened residuals and their derivatives at one point. steps (size,) of the differences in q.

        known : the blocks, where another process has made them.

        central : differences to both sides, of records integrated more finely: what a common factor on all inertias,
        stiffnesses and frictions does to a record of many periods cancels out of columns of thousands of noise sds,
        so that a few digits of them would pretend to know that factor.
        """
        q, fixed = np.array(q), {i: np.array(v) for i, v in eta.items()}
        return Linear(q, Remade(lambda: blocks_of(self, q, fixed, annealed, central, steps), known), central)

    def touched(self, c: Coordinate, group: Group) -> NDArray[np.bool_]:
        """Which trials of a group a coordinate belongs to, (trials,)."""
        return np.array([c.of_trial(self.experiment.trials[i]) for i in group.trials])

    def acts(self, c: Coordinate, group: Group) -> bool:
        """Whether a coordinate can change the records of a group."""
        if c.role == "effect":
            return self.effect is not None and (group.coupled or self.effect.uncoupled)
        if c.role in ("sensor", "lag"):
            return group.coupled or c.index == 0
        name = c.parameter.removeprefix(TREND)
        free = group.coupled or c.role == "stiffness" or name == "k1t" or name in acting_alone(self.experiment)
        return free and bool(self.touched(c, group).any())


def simulated_once(problem: Problem, group: Group, which: Indices, q: Array, eta: Array) -> Array:
    """The same as `Problem.simulate`, where many vectors may be equal: each is integrated once."""
    _, first, place = np.unique(np.column_stack([which, q, eta]), axis=0, return_index=True, return_inverse=True)
    return problem.simulate(group, which[first], q[first], eta[first])[place.ravel()]


def _model(experiment: Experiment, coupled: bool, effect: Variant | None) -> Model:
    """The model of one configuration."""
    law = experiment.coupling_law if coupled else "constant"
    return Model(coupled, experiment.normal_force, experiment.restoring, effect, law, longest_step(experiment))


def _declared(
    problem: Problem, medians: Mapping[str, Mapping[str, float]], group: Group, which: Indices
) -> dict[str, Any]:
    """What the rig has for a group's trials `which` (n,) where nothing is fitted: declared values and prior medians."""
    e = problem.experiment
    rig: dict[str, Any] = {name: value for name, (value, _) in e.constants.items()}
    rig["k1t"] = np.array([e.stiffnesses[e.trials[i].k1t][0] for i in group.trials])[which]
    rig["theta0"] = np.array([e.trials[i].theta0 for i in group.trials])[which]
    cases = [e.trials[i].case for i in group.trials]
    for name, middles in medians.items():
        own = [middles[case] for case in cases]
        rig[name] = own[0] if len(set(own)) == 1 else np.array(own)[which]
    if problem.nominal == "linear":
        rig |= {"mu": 0.0, "drag": 0.0}
    for name in ("theta0", "delay"):
        if name in e.levels and e.start == "rest":
            rig[name] = np.array([middle(problem.prior(name, case)) for case in cases])[which]
    # A rig without magnet, or with a constant pull, has no use for these.
    rig = {"N0": 0.0, "R": 1.0, "r": 1.0} | rig
    if not e.magnet:
        rig["mu"] = 0.0
    return rig


def _values(coordinates: Sequence[Coordinate], q: Array) -> Array:
    """Values (k, n) of k coordinates at vectors q (n, k), which seldom differ from one to the next."""
    new = np.ones(len(q), np.bool_)
    new[1:] = (q[1:] != q[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    values = columns_from_standard([c.prior for c in coordinates], q[first])
    return np.repeat(values, np.diff(np.append(first, len(q))), axis=1)


def _as_sensors_show(
    y: Array, coordinates: Sequence[Coordinate], group: Group, which: Indices, q: Array, eta: Array
) -> Array:
    """Motions y (n, channels, n_times) as the sensors show them: scale, offset and drift of channels, in place."""
    for i, c in enumerate(coordinates):
        if c.role == "sensor" and c.index < y.shape[1]:
            y[:, c.index] *= from_standard(c.prior, q[:, i])[:, None]
    for channel in range(y.shape[1]):
        waves, sizes = [], []
        for i, (name, mean, sd) in enumerate(group.nuisances):
            if of_readings(name) and channel_of(name) in (channel, -1):
                x = mean[which] + sd[which] * eta[:, i]
                if name.startswith("gain"):
                    y[:, channel] *= 1.0 + x[:, None]
                else:
                    waves.append(name)
                    sizes.append(x)
        if waves:
            key = (f"waves of {channel}: " + " ".join(waves), False)
            if key not in group.kept:
                group.kept[key] = np.stack([group.shape(name)[..., channel, :] for name in waves])
            shapes = group.kept[key]
            if shapes.ndim == 2:
                y[:, channel] += np.stack(sizes, axis=1) @ shapes
            else:
                for x, own in zip(sizes, shapes, strict=True):
                    y[:, channel] += x[:, None] * own[which]
    return y
