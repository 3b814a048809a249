"""Noise of the measured inputs: what it does to the readings, as unknowns of each trial.

A torque or a motion of the ground is measured with noise of its own; the rig was driven by what acted, not by what was
recorded. With u the record of an input, u = u* + e, the readings are those of the rig under u less the rig's response
to e. That response lies in the band of the rig, is as coloured as its resonance, and no two trials share it: taken for
the model's fault it is a gap. So e is unknown (errors in variables): white, with the standard deviation that the fast
content of the record has, and resolved into cosines and sines over the record, whose sizes are independent. Only lines
that show beside the noise of the sensors are kept, the strongest first; what each does to the readings is simulated
with the fitted model, about its own motion, and its size is one of the trial's nuisances, with a unit prior. To first
order this gives the readings the covariance N + U U', U being those responses.

The fast content of an input that is itself as fast as it is sampled is no noise. The readings decide: if the sizes that
they ask for are less than half of what noise of that size would show (root mean square), the input is taken as it is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.experiment import Experiment
from bayes_damper.calibration.groups import Group
from bayes_damper.calibration.least_squares import Calibration
from bayes_damper.calibration.noise import fast_level
from bayes_damper.calibration.own_values import INPUT, middle_of
from bayes_damper.calibration.problem import Problem
from bayes_damper.rig.inputs import Inputs

Array = NDArray[np.float64]
ORDER = 10  # of the differences that show the noise: what drives a rig may be a tenth as fast as it is sampled
LEAST = 0.3  # size of a line's response, in standard deviations of the noise, below which it is left out
MOST = 100  # lines of a trial: two unknowns each
FELT = 0.25  # of its mean square that noise of an input must have in the readings to be noise: half of its size


def with_input_noise(fit: Calibration) -> Experiment | None:
    """The experiment with what the noise of its inputs does to the readings of each trial; None where nothing shows."""
    problem = fit.problem.finer()
    trials = list(problem.experiment.trials)
    found = False
    for group in problem.grouped(tuple(range(len(trials)))):
        if group.inputs is None or not (sds := input_noise(group.inputs)):
            errors = None
        else:
            errors = _responses(fit, problem, group, group.inputs, sds)
        for i in group.trials:
            trials[i] = replace(trials[i], errors=errors)
        found = found or errors is not None
    return replace(problem.experiment, trials=tuple(trials)) if found else None


def input_noise(inputs: Inputs) -> dict[str, float]:
    """Standard deviation of the noise of each measured input that has any, from its fast content; by its name."""
    return {name: sd for name, row in inputs.columns.items() if (sd := fast_level([row], ORDER)) > 0.0}


def followed(fit: Calibration) -> float:
    """Sum of squares of the sizes that a fit gives the inputs' noise, in its own standard deviations."""
    return sum(float(np.sum(block.eta[:, _places(block.group)] ** 2)) for block in fit.linear.blocks)


def felt(fit: Calibration) -> float:
    """Mean square of the inputs' noise that the readings ask for, over what noise of that size would have there.

    With T the whitened responses, noise leaves sizes (1 + T T')^-1 T r whose squares sum to trace T T' (1 + T T')^-1.
    """
    expected = 0.0
    for block in fit.linear.blocks:
        T = block.T[:, _places(block.group)]
        gram = T @ T.transpose(0, 2, 1)
        expected += float(np.trace(np.linalg.solve(gram + np.eye(T.shape[1]), gram), axis1=1, axis2=2).sum())
    return followed(fit) / expected if expected > 0.0 else 0.0


def _places(group: Group) -> list[int]:
    """Where the sizes of the inputs' noise stand among the nuisances of a group's trials."""
    return [k for k, (name, _, _) in enumerate(group.nuisances) if name.startswith(INPUT)]


def _responses(
    fit: Calibration, problem: Problem, group: Group, inputs: Inputs, sds: dict[str, float]
) -> Array | None:  # fmt: skip
    """What unit sizes of the lines that show do to the readings of a group's trials, (k, channels, n)."""
    middle = np.array([middle_of(name) for name, _, _ in group.nuisances])
    eta = fit.eta.get(group.trials[0], middle)[None]
    group = group.only(slice(0, 1))
    base = _readings(fit, problem, group, inputs, eta)
    count, n = inputs.times.size, group.times.size
    floor = np.array(fit.problem.noise.floor[: len(base)])[:, None]
    lines = []
    for name, sd in sds.items():
        # One record with all lines at once, in phases of their own, shows how much each of them does.
        phase = np.random.default_rng(0).uniform(0.0, 2.0 * math.pi, count // 2 + 1)
        probe = np.fft.irfft(np.exp(1j * phase), count, norm="ortho")
        change = _readings(fit, problem, group, inputs.shifted(name, sd * probe), eta) - base
        seen = np.array([np.interp(inputs.times, group.times, row, 0.0, 0.0) for row in change / floor])
        power = n / count * np.sum(np.abs(np.fft.rfft(seen, norm="ortho")) ** 2, axis=0)
        lines += [(float(power[k]), name, k) for k in range((count + 1) // 2)]
    kept = sorted((line for line in lines if line[0] > LEAST**2), reverse=True)[:MOST]
    out = []
    for _, name, k in kept:
        turns = 2.0 * math.pi * k / count * np.arange(count)
        for shape in (np.cos(turns), np.sin(turns)) if k else (np.ones(count),):
            moved = inputs.shifted(name, sds[name] * shape / np.linalg.norm(shape))
            out.append(_readings(fit, problem, group, moved, eta) - base)
    return np.array(out) if out and np.isfinite(out).all() else None


def _readings(fit: Calibration, problem: Problem, group: Group, inputs: Inputs, eta: Array) -> Array:
    """What the model gives for the first trial of a group under other inputs, (channels, n)."""
    return np.asarray(problem.simulate(replace(group, inputs=inputs, kept={}), np.zeros(1, int), fit.q[None], eta)[0])
