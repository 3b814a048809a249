"""`bayes-damper examples`: a small campaign to play with, simulated with a cause that the reader may look for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper.campaign.structure import Campaign, Constant, Measurement, Rig, Trial
from bayes_damper.campaign.writing import write_campaign
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.simulation.model import Model
from bayes_damper.simulation.outcome import Outcome
from bayes_damper.text import Printable

MASS = 2.0  # kg
STIFFNESS = 500.0  # N/m
RELEASES = {"small": 0.010, "large": 0.025}  # m
TRIALS = 3
TRUTH = {"c1t": 1.2, "drag": 0.25, "nu": 60.0}  # N s/m, N, s/m
HARDENING = 0.15  # of the linear force, at the largest release
NOISE = 0.02  # m/s^2
RATE, DURATION = 200.0, 4.0  # Hz, s


@dataclass(frozen=True)
class Example(Printable):
    """A campaign written to `folder`; `cause` names the effect that it was simulated with."""

    folder: Path
    cause: str
    exit_code: ExitCode = ExitCode.DONE

    def text(self) -> str:
        """For people."""
        return (
            f"{self.folder}: a cart of {MASS:g} kg on a spring, let go {TRIALS} times from {len(RELEASES)} places.\n"
            "The spring is not quite the one that the campaign declares. Find out:\n"
            f"  bayes-damper check {self.folder}\n"
            f"  bayes-damper diagnose {self.folder} --out {self.folder}/diagnose\n"
            f"  bayes-damper report {self.folder}/diagnose"
        )

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"schema": "bayes-damper/examples/1", "campaign": str(self.folder), "cause": self.cause}


def examples(out: str | Path = "example", *, seed: int = 1) -> Example:
    """Write a campaign of six trials of a cart on a hardening spring, with noise and small differences between trials.

    Parameters
    ----------
    out : folder for the campaign. seed : decides noise and differences.

    Raises
    ------
    InputError
        If the folder holds a campaign already.
    """
    rng = np.random.default_rng(seed)
    variant = EFFECTS["spring_cubic"].variants[0]
    farthest = max(RELEASES.values())
    cubic = {variant.parameters[0].name: HARDENING * STIFFNESS / farthest**2}
    times = np.arange(round(DURATION * RATE) + 1) / RATE
    model = Model(False, "linear", "linear", variant)
    trials = []
    for case, release in RELEASES.items():
        for number in range(1, TRIALS + 1):
            let_go = release * (1.0 + 0.01 * rng.standard_normal())
            values = {"J1": MASS, "k1t": STIFFNESS, "theta0": let_go} | TRUTH
            found = model.simulate(values, times, effect=cubic)
            if Outcome(int(found.outcome[0])) is not Outcome.COMPLETED:
                raise InputError(f"the example cannot be simulated: {Outcome(int(found.outcome[0])).sentence}")
            channel = found.y[0][:1] + NOISE * rng.standard_normal((1, times.size))
            file = f"trials/{case}_{number}.csv"
            declared = Constant(STIFFNESS, 0.005 * STIFFNESS), Constant(release, 0.02 * release)
            trials.append(Trial(file, case, "uncoupled", number, *declared, times, channel))
    campaign = Campaign(
        "cart-example",
        Rig(Constant(MASS, 0.005 * MASS), kind="translational"),
        Measurement(sample_rate=RATE),
        tuple(trials),
        description="A cart on a spring, let go at rest; simulated.",
        source="bayes-damper examples",
    )
    return Example(write_campaign(out, campaign), "spring_cubic")
