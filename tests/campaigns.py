"""Writes small synthetic campaigns for tests: closed-form decays, so that no solver of the package is involved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
J1, J2, R = 3.015e-3, 2.474e-3, 0.10

CAMPAIGN_TOML = """\
name = "synthetic"
description = "closed-form decays"
source = "made by the tests"

[rig]
primary_inertia = 3.015e-3
secondary_inertia = 2.474e-3
bar_radius = 0.10
magnet_radius = 0.0127
magnet_pull = 100.0

[measurement]
quantity = "acceleration"
sample_rate = 1000.0
noise_std = 2.0
"""


def decay(times: Array, theta0: float, k1t: float, zeta: float, inertia: float = J1) -> Array:
    """Acceleration of a viscously damped oscillator released at rest from theta0 at t = 0; zero before; (n,)."""
    omega = math.sqrt(k1t / inertia)
    damped = omega * math.sqrt(1.0 - zeta**2)
    t = np.maximum(times, 0.0)
    wave = np.cos(damped * t) - zeta * omega / damped * np.sin(damped * t)
    return np.where(times < 0.0, 0.0, -theta0 * omega**2 * np.exp(-zeta * omega * t) * wave)


def write_synthetic(
    folder: Path,
    cases: Sequence[tuple[str, float, float]] = (("IV", 10.2, 4.7),),
    repeats: int = 3,
    configurations: Sequence[str] = ("uncoupled", "coupled"),
    duration: float = 1.0,
    rate: float = 1000.0,
    noise: float = 2.0,
    seed: int = 1,
) -> Path:
    """A sound campaign of `cases` (label, k1t N m/rad, theta0 deg); returns the folder."""
    rng = np.random.default_rng(seed)
    (folder / "trials").mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(CAMPAIGN_TOML, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,trial"]
    times = np.arange(round(duration * rate) + 1) / rate
    for case, k1t, degrees in cases:
        for configuration in configurations:
            for trial in range(1, repeats + 1):
                theta0 = math.radians(degrees) * (1.0 + 0.005 * rng.standard_normal())
                zeta = 0.19 if configuration == "coupled" else 0.031
                columns = [times, decay(times, theta0, k1t, zeta)]
                names = ["time_s", "alpha1_rad_s2"]
                if configuration == "coupled":
                    columns.append(0.3 * decay(times, theta0, k1t, 0.3))
                    names.append("alpha2_rad_s2")
                columns[1:] = [column + noise * rng.standard_normal(len(times)) for column in columns[1:]]
                name = f"trials/{case}_{configuration}_{trial}.csv"
                write_table(folder / name, names, columns)
                rows.append(f"{name},{case},{configuration},{k1t},{degrees},{trial}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def write_table(path: Path, names: Sequence[str], columns: Sequence[Array]) -> None:
    """A CSV file of numbers under a header."""
    lines = [",".join(names), *(",".join(f"{x:.9g}" for x in row) for row in np.column_stack(columns).tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_table(path: Path) -> tuple[list[str], list[Array]]:
    """Names and columns of a file that `write_table` wrote."""
    header, _, _ = path.read_text(encoding="utf-8").partition("\n")
    return header.split(","), list(np.loadtxt(path, delimiter=",", skiprows=1, unpack=True))
