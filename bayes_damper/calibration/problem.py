"""What the fit of one model to one experiment needs: unknowns in standard coordinates, trials in groups, weights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.experiment import (
    Experiment,
    default_priors,
    longest_step,
)
from bayes_damper.calibration.groups import Group, Grouping, Switches
from bayes_damper.calibration.noise import Noise, rough_noise
from bayes_damper.calibration.normal_equations import Block, Linear, Remade
from bayes_damper.calibration.own_values import RELEASE, channel_of, middle_of, of_readings, wave
from bayes_damper.calibration.unknowns import NOMINAL, Coordinate, acting_alone, coordinates_of, middle
from bayes_damper.effects.base import Variant
from bayes_damper.priors.distributions import (
    Distribution,
    LogNormal,
    from_standard,
)
from bayes_damper.simulation.model import Model, delayed

Array = NDArray[np.float64]
Indices = NDArray[np.signedinteger[Any]]
RELEASE_STEP = 5e-6  # s, of a difference quotient by a trial's time of release: from none to some, readings jump
LEAST_STEP = 1e-4  # relative, of a difference quotient by a trial's own value of a parameter
FINER = 0.01  # factor on the integrator's tolerance where records are subtracted from each other
READINGS_AT_ONCE = 100_000  # of the trials whose records are differentiated together
_KEPT = ("nominal", "noise", "switches", "threads", "tolerance", "trials", "factors")  # arguments of a `Problem`


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
        self._take(effect)
        self._groups: dict[tuple[int, ...], list[Group]] = {}
        self.groups = self.grouped(self.trials)

    def changed(self, **changes: Any) -> Self:
        """The same problem with other arguments: `noise`, `trials`, `factors` ... Subclasses say how they are made."""
        given = {name: getattr(self, name) for name in _KEPT} | changes
        return cast("Self", Problem(self.experiment, self.effect, **given))

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
    def n_data(self) -> float:
        """Number of readings, weighted."""
        return float(sum(np.sum(g.weight**2) for g in self.groups))

    # Set-up

    def prior(self, name: str, case: str) -> Distribution | float:
        """Prior of a parameter for the trials of a case: a distribution, or a number where it is fixed."""
        e = self.experiment
        own = e.case_priors.get(name, {})
        return own[case] if case in own else e.priors[name] if name in e.priors else self._defaults[name]

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
            elif not of_readings(name):
                rig[name] = x
        for name, other in e.ties.items():
            if name in NOMINAL:
                rig[name] = rig[other]
        if e.start == "free":
            rig["delay"] = float(group.times[0])
        if RELEASE in rig and any(name == "delay" for name, _, _ in group.nuisances):
            # The own instant is that of the end: a reading that shows all of the jump bounds it, whatever the time.
            rig["delay"] = rig["delay"] - rig[RELEASE]
        acting = self.models[group.coupled].acting
        if RELEASE in rig and acting is not None and acting.lets_go in effect:
            effect[acting.lets_go] = effect[acting.lets_go] + rig.pop(RELEASE)
        return {"theta2_0": rig["theta0"]} | rig, effect

    def _read(self, y: Array, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Motions y (n, channels, n_times) as the sensors show them: scale, offset and drift of channels, in place."""
        for i, c in enumerate(self.coordinates):
            if c.role == "sensor" and c.index < y.shape[1]:
                y[:, c.index] *= from_standard(c.prior, q[:, i])[:, None]
        for channel in range(y.shape[1]):
            waves, sizes = [], []
            for i, (name, mean, sd) in enumerate(group.nuisances):
                if of_readings(name) and channel_of(name) == channel:
                    x = mean[which] + sd[which] * eta[:, i]
                    if name.startswith("gain"):
                        y[:, channel] *= 1.0 + x[:, None]
                    else:
                        waves.append(wave(name, group.times))
                        sizes.append(x)
            if waves:
                y[:, channel] += np.stack(sizes, axis=1) @ np.stack(waves)
        return y

    @staticmethod
    def _own_readings(group: Group, nuisance: int, shown: Array, eta: Array) -> Array:
        """Change of the readings `shown` at eta by a unit of one trial's own gain, offset or drift, of their shape."""
        name = group.nuisances[nuisance][0]
        channel = channel_of(name)
        out = np.zeros_like(shown)
        if not name.startswith("gain"):
            out[:, channel] = wave(name, group.times)
            return out
        out[:, channel] = shown[:, channel]
        for k, (other, mean, sd) in enumerate(group.nuisances):
            x = mean + sd * eta[:, k]
            if k != nuisance and of_readings(other) and channel_of(other) == channel:
                out[:, channel] -= np.outer(x, wave(other, group.times))
            elif k == nuisance:
                scale = 1.0 + x
        out[:, channel] /= scale[:, None]
        return out

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
                    inputs=group.inputs,
                    quantity=self.experiment.quantity,
                    tolerance=self.tolerance,
                    threads=self.threads,
                )
                .y
            )

        y = readings(rig)
        for i, c in enumerate(self.coordinates):
            if c.role == "lag" and c.index < y.shape[1]:
                if group.inputs is not None and group.inputs.active:
                    lags = [from_standard(c.prior, q[:, i]) if k == c.index else 0.0 for k in range(y.shape[1])]
                    y = delayed(y, group.times, lags)
                    continue
                late = rig | {"delay": rig.get("delay", 0.0) + from_standard(c.prior, q[:, i])}
                y[:, c.index] = readings(late)[:, c.index]
        return self._read(y, group, which, q, eta)

    def finer(self) -> Problem:
        """The same problem with records integrated more finely, for differences between them."""
        out = copy(self)
        out.tolerance = FINER * self.tolerance
        return out

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
        """Whitened residuals and their derivatives at one point. steps (size,) of the differences in q.

        central : differences to both sides, of records integrated more finely: what a common factor on all inertias,
        stiffnesses and frictions does to a record of many periods cancels out of columns of thousands of noise sds,
        so that a few digits of them would pretend to know that factor.
        """
        q, fixed = np.array(q), {i: np.array(v) for i, v in eta.items()}
        return Linear(q, Remade(lambda: self._linearised(q, fixed, annealed, central, steps)))

    def _linearised(
        self, q: Array, eta: Mapping[int, Array], annealed: bool, central: bool, steps: Array | None
    ) -> tuple[Block, ...]:
        """Blocks of `linearise`, the trials of a large group in turns."""
        blocks = []
        for group in self.groups:
            most = max(READINGS_AT_ONCE // max(group.y[0].size, 1), 1)
            parts = [
                self._block(group.only(slice(k, k + most)), q, eta, annealed, central, steps)
                for k in range(0, len(group.trials), most)
            ]
            whole = (
                parts[0]
                if len(parts) == 1
                else Block(
                    group, *(np.concatenate([getattr(p, name) for p in parts]) for name in ("r", "J", "T", "eta"))
                )
            )
            blocks.append(replace(whole, group=group))
        return tuple(blocks)

    def _block(
        self, group: Group, q: Array, eta: Mapping[int, Array], annealed: bool, central: bool, steps: Array | None
    ) -> Block:
        """Residuals and derivatives of one group."""
        differences = self.finer() if central else self
        steps = np.full(self.size, 2e-3) if steps is None else steps
        # Unknowns of different cases or springs never meet in a trial: they share a simulation.
        together: dict[str, list[int]] = {}
        for i, c in enumerate(self.coordinates):
            if self._acts(c, group):
                together.setdefault(c.name if c.role == "effect" else c.parameter, []).append(i)
        n = len(group.trials)
        m = len(group.nuisances)
        names = [name for name, _, _ in group.nuisances]
        shared = {
            name: together[name[3:]]
            for name in names
            if name.startswith("ln_") and self._touch_all(together.get(name[3:], []), group)
        }
        moved = [i for i, name in enumerate(names) if not of_readings(name) and name not in shared]
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
            elif name == RELEASE:
                trial_steps[:, i] = RELEASE_STEP / group.nuisances[i][2]
            elif name.startswith("ln_"):
                trial_steps[:, i] = np.maximum(trial_steps[:, i], LEAST_STEP / group.nuisances[i][2])
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
        y = differences.simulate(
            group, np.tile(np.arange(n), copies), np.concatenate(rows_q), np.concatenate(rows_eta)
        ).reshape(copies, n, -1, group.times.size)
        base = y[0]
        shown = self.simulate(group, np.arange(n), base_q, base_eta) if central else base
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
        r = self.whitened(shown - group.y, weight)
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
            if of_readings(name):
                column = self._own_readings(group, i, shown, base_eta)
                own[:, i] = self.whitened(group.nuisances[i][2][:, None, None] * column, weight)
        for name, members in shared.items():
            place = names.index(name)
            for i in members:
                hit = self.touched(self.coordinates[i], group)
                per_log = _log_slope(self.coordinates[i].prior, float(q[i]))
                own[hit, place] = jac[hit, i] * (group.nuisances[place][2][hit, None] / per_log)
        return Block(group, r, jac, own, base_eta)

    def touched(self, c: Coordinate, group: Group) -> NDArray[np.bool_]:
        """Which trials of a group a coordinate belongs to, (trials,)."""
        trials = [self.experiment.trials[i] for i in group.trials]
        if c.role == "stiffness":
            return np.array([t.k1t == c.index for t in trials])
        return np.array([c.case is None or t.case == c.case for t in trials])

    def _touch_all(self, coordinates: Sequence[int], group: Group) -> bool:
        """Whether every trial of a group has one of these unknowns."""
        none = np.zeros(len(group.trials), dtype=np.bool_)
        return bool(sum((self.touched(self.coordinates[i], group) for i in coordinates), none).all())

    def _acts(self, c: Coordinate, group: Group) -> bool:
        """Whether a coordinate can change the records of a group."""
        if c.role == "effect":
            return self.effect is not None and (group.coupled or self.effect.uncoupled)
        if c.role in ("sensor", "lag"):
            return group.coupled or c.index == 0
        free = group.coupled or c.role == "stiffness" or c.parameter in acting_alone(self.experiment)
        return free and bool(self.touched(c, group).any())


def _model(experiment: Experiment, coupled: bool, effect: Variant | None) -> Model:
    """The model of one configuration."""
    law = experiment.coupling_law if coupled else "constant"
    return Model(coupled, experiment.normal_force, experiment.restoring, effect, law, longest_step(experiment))


def _log_slope(distribution: Distribution, z: float) -> float:
    """Change of the logarithm of a scale parameter by one unit of its standard coordinate, at z."""
    if isinstance(distribution, LogNormal):
        return math.log(distribution.factor)
    low, high = float(from_standard(distribution, z - 1e-3)), float(from_standard(distribution, z + 1e-3))
    return math.log(high / low) / 2e-3 if low > 0.0 else 1.0
