"""Writes campaigns of many trials, to measure memory and time: `python tests/large.py FOLDER TRIALS READINGS`."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from campaigns import CAMPAIGN_TOML
from small_rig import NOISE, RIG

from bayes_damper.campaign import record_text
from bayes_damper.simulation.model import Model


def write_large(folder: Path, trials: int, readings: int, rate: float = 1000.0, k1t: float = 10.2) -> Path:
    """A sound campaign of one case, all of its trials coupled repeats: the worst for whatever compares repeats."""
    rng = np.random.default_rng(1)
    (folder / "trials").mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(CAMPAIGN_TOML, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial"]
    times = np.arange(readings) / rate
    for number in range(1, trials + 1):
        theta0 = math.radians(4.7) * (1.0 + 0.005 * rng.standard_normal())
        y = Model().simulate({**RIG, "k1t": k1t, "theta0": theta0, "delay": -5e-4}, times).y[0]
        record = y + NOISE * rng.standard_normal(y.shape)
        name = f"trials/{number}.csv"
        (folder / name).write_text(record_text(times, record, "torsional", "acceleration"), encoding="utf-8")
        rows.append(f"{name},IV,coupled,{k1t},4.7,0.03,{number}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


if __name__ == "__main__":
    print(write_large(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])))
