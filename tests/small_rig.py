"""A small rig for the tests of the diagnosis: two cases, both configurations, half a second, answers known."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from bayes_damper.calibration import Experiment, TrialRecord
from bayes_damper.effects import EFFECTS
from bayes_damper.effects.base import Variant
from bayes_damper.simulation.model import Model

RIG = {
    "J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0, "k2t": 1.2, "c2t": 0.06, "c1t": 0.011,
    "c3t": 0.009, "mu": 0.006, "drag": 0.005, "nu": 60.0,
}  # fmt: skip
STIFFNESSES = (6.2, 10.2)
NOISE = 2.0


def variant(effect: str, name: str | None = None) -> Variant:
    """A formula of the library, the first one unless named."""
    family = EFFECTS[effect]
    return family.variants[0] if name is None else family.variant(name)


def measured(
    seed: int = 1,
    *,
    effect: Variant | None = None,
    values: Mapping[str, float] | None = None,
    torque: Callable[[Any], Any] | None = None,
    sensor: Callable[[Any, Any], Any] | None = None,
    cases: Sequence[tuple[str, int, float]] = (("I", 0, 0.1), ("IV", 1, 0.08)),
    configurations: Sequence[bool] = (False, True),
    repeats: int = 3,
    duration: float = 0.5,
    rate: float = 1000.0,
    noise: float = NOISE,
    late: float = 0.0,
) -> Experiment:
    """Trials of the rig with something unknown in it; the last repeat of each case and configuration is held out.

    torque : (times) -> N m on the primary, which nobody declares; sensor : (times, y (channels, n)) -> what it shows;
    late : s, the most that a trial's trigger misses its release by.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(round(duration * rate)) / rate
    trials = []
    for case, k, theta0 in cases:
        for coupled in configurations:
            for number in range(1, repeats + 1):
                released = theta0 * (1.0 + 0.01 * rng.standard_normal())
                delay = {"delay": late * rng.random()} if late else {}
                y = Model(coupled, effect=effect).simulate(
                    RIG | {"k1t": STIFFNESSES[k], "theta0": released} | delay, times, effect=values,
                    torque=None if torque is None else torque(times),
                ).y[0]  # fmt: skip
                if sensor is not None:
                    y = sensor(times, y)
                y = y + noise * rng.standard_normal(y.shape)
                label = f"{case} {coupled} {number}"
                trials.append(
                    TrialRecord(
                        label, case, coupled, number, times, y, k, theta0, 0.01 * theta0, heldout=number == repeats > 1
                    )
                )
    constants = {name: (RIG[name], 0.0) for name in ("J1", "J2", "R", "r", "N0")}
    return Experiment(constants, tuple((k, 0.0) for k in STIFFNESSES), tuple(trials))


def knock(start: float, length: float, size: float) -> Callable[[Any], Any]:
    """Half a sine on the primary, N m."""

    def torque(times: Any) -> Any:
        x = (times - start) / length
        return np.where((x > 0.0) & (x < 1.0), size * np.sin(np.pi * np.clip(x, 0.0, 1.0)), 0.0)

    return torque


def braked_by_air(reaches: Sequence[float]) -> Experiment:
    """Decays with square drag by scipy's solver, each spring by 0.05 to 0.1 % apart; the last one is held out."""
    rng, omega, trials = np.random.default_rng(3), 2.0 * math.pi * 2.0, []
    for number, (reach, own) in enumerate(zip(reaches, (1.0, -0.6, 0.4), strict=False), 1):
        k, times = omega**2 * (1.0 + 1e-3 * own), np.arange(0.0, 6.0, 0.02)

        def motion(_: float, x: np.ndarray, k: float = k) -> list[float]:
            return [x[1], -k * x[0] - 0.02 * omega * x[1] - 0.06 * abs(x[1]) * x[1]]

        y = solve_ivp(motion, (0.0, 6.0), [reach, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12).y[0]
        y += 2e-5 * rng.standard_normal(times.size)
        trials.append(
            TrialRecord(str(number), "I", False, number, times, y[None], 0, 0.0, heldout=reach == reaches[-1])
        )
    return Experiment({"J1": (1.0, 0.0)}, ((158.0, 8.0),), tuple(trials), quantity="displacement", start="free")


def vane_on_a_pendulum(releases: Sequence[float] = (0.15, 0.3, 0.45, 0.6)) -> Experiment:
    """One decay from each release by scipy's solver, under the drag |w|^1.85 of a vane; each release is a case."""
    rng, J, k, trials = np.random.default_rng(5), 0.04, 1.9, []
    times = np.arange(0.0, 27.0, 0.0227)

    def motion(_: float, x: np.ndarray) -> list[float]:
        return [
            x[1],
            -(
                k * math.sin(x[0])
                + 1.66e-3 * x[1]
                + 7.2e-4 * math.tanh(60.0 * x[1])
                + 5e-4 * np.sign(x[1]) * abs(x[1]) ** 1.85
            )
            / J,
        ]

    for number, release in enumerate(releases, 1):
        y = solve_ivp(motion, (0.0, 27.0), [release, 0.0], "DOP853", times, rtol=1e-9, atol=1e-11).y[0]
        y += 1.8e-3 * rng.standard_normal(times.size)
        trials.append(TrialRecord(str(number), str(number), False, 1, times, y[None], 0, release, 0.005 * release))
    constants = {"J1": (J, 0.0004)}
    return Experiment(constants, ((1.91, 0.019),), tuple(trials), quantity="displacement", restoring="pendulum")
