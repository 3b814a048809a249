"""What the thesis prints: constants and cases as strings, whose last digit shows how far a number was rounded."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper.published.measurements import load_published, published_rows

Array = NDArray[np.float64]

CASES = ("I", "II", "III", "IV")
INERTIA_ROWS = {"shaft": "195", "collar": "92", "coupling": "490", "bar": "2146"}  # Table 1, p. 9, kg mm^2
INERTIA = "3015"  # J1, kg mm^2, Table 1, p. 9
MAGNET_PULL = 100.0  # N0, N, eq. 20, p. 24
BAR_RADIUS, MAGNET_RADIUS = 0.10, 0.0127  # m: printed nowhere, working values
SECONDARY_FREQUENCY = "3.2"  # Hz at k2t = 1 N m/rad, p. 27: the only trace of J2
Law = Literal["constant", "linear"]
LAWS: tuple[tuple[Law, float], ...] = (("constant", 0.005), ("linear", 0.009))  # normal force and mu, Fig. 10, p. 26
T_MIN = 0.55e-3  # s: from when on a peak counts (features.py)
CASE_IV_DAMPING = 0.0109  # c1t = c3t, N m s/rad: eq. 12 at zeta = 0.031


@dataclass(frozen=True)
class Case:
    """What is printed on one case; every number as printed, in the printed unit (N m/rad, deg, mJ, Hz, ms, rad/s^2)."""

    k1t: str
    theta0: str
    energy: str
    decrement: tuple[str, str]
    ratio: tuple[str, str]
    designed: str
    measured_frequency: tuple[str, str]
    frequency_difference: str
    period: tuple[str, str]
    bound: str
    acceleration: tuple[str, str]
    acceleration_table_5: str
    acceleration_difference: str
    coupled_decrement: tuple[str, str]
    coupled_ratio: tuple[str, str]
    coupled_period: tuple[str, str]
    coupled_acceleration: tuple[str, str]
    k2t: str
    c2t: str
    model_acceleration: str
    model_decrement: str
    ratio_table_3: tuple[str, str]
    decrement_table_10: str


@cache
def _texts() -> dict[tuple[str, str, str, str], tuple[str, str]]:
    """(case, configuration, quantity, table) -> value and standard error as printed, of everything in `data/thesis`."""
    return {
        (row["case"], row["configuration"], row["quantity"], row["table"]): (
            row["value"],
            row.get("standard_error", ""),
        )
        for name in ("measurements", "derived", "printed")
        for row in published_rows(name)
    }


@cache
def printed_case(name: str) -> Case:
    """What is printed on one case, from `data/thesis`."""
    texts = _texts()

    def both(configuration: str, quantity: str, table: int) -> tuple[str, str]:
        return texts[name, configuration, quantity, f"Table {table}"]

    def one(configuration: str, quantity: str, table: int) -> str:
        return both(configuration, quantity, table)[0]

    nominal = load_published().cases[name]
    return Case(
        k1t=f"{nominal.k1t:.1f}",
        theta0=f"{math.degrees(nominal.theta0):.1f}",
        energy=one("both", "initial_potential_energy", 2),
        decrement=both("uncoupled", "log_decrement", 6),
        ratio=both("uncoupled", "damping_ratio", 6),
        designed=one("uncoupled", "designed_natural_frequency", 4),
        measured_frequency=both("uncoupled", "natural_frequency", 4),
        frequency_difference=one("uncoupled", "frequency_difference", 4),
        period=both("uncoupled", "period", 7),
        bound=one("uncoupled", "undamped_acceleration_bound", 5),
        acceleration=both("uncoupled", "max_acceleration", 8),
        acceleration_table_5=one("uncoupled", "max_acceleration", 5),
        acceleration_difference=one("uncoupled", "acceleration_difference", 5),
        coupled_decrement=both("coupled", "log_decrement", 6),
        coupled_ratio=both("coupled", "damping_ratio", 6),
        coupled_period=both("coupled", "period", 7),
        coupled_acceleration=both("coupled", "max_acceleration", 8),
        k2t=one("coupled", "fitted_k2t", 9),
        c2t=one("coupled", "fitted_c2t", 9),
        model_acceleration=one("coupled", "linear_model_max_acceleration", 10),
        model_decrement=one("coupled", "linear_model_log_decrement", 10),
        ratio_table_3=both("uncoupled", "damping_ratio", 3),
        decrement_table_10=one("coupled", "log_decrement", 10),
    )


@cache
def table_12() -> dict[str, tuple[tuple[str, str], ...]]:
    """Table 12 (p. 31): state of the model -> resonance (Hz) and accelerance (1/(kg m^2)) of each peak, as printed."""
    values = {
        (p.configuration, p.quantity): p.text for p in load_published().frequency_response if p.table == "Table 12"
    }

    def peak(state: str, which: str = "") -> tuple[str, str]:
        return values[state, f"{which}resonance"], values[state, f"{which}accelerance"]

    return {
        "with effective stiffness": (peak("with effective stiffness"),),
        "no effective stiffness": (peak("k2t = 0"),),
        "undamped coupling": (peak("c2t = 0", "first_"), peak("c2t = 0", "second_")),
        "uncoupled": (peak("uncoupled"),),
    }


def half_unit(printed: str) -> float:
    """Half a unit of the last printed digit: "203.6" -> 0.05."""
    digits = printed.strip().lstrip("+-")
    return 0.5 * 10.0 ** -(len(digits.partition(".")[2]))


def spread(inputs: Sequence[str | float]) -> list[Array]:
    """Lower end, printed value and upper end of every input, in all combinations; the printed values come first.

    A string is a rounded number, a float an exact one.
    """
    levels = [
        (float(x), float(x) - half_unit(x), float(x) + half_unit(x)) if isinstance(x, str) else (x,) for x in inputs
    ]
    return list(np.array(list(itertools.product(*levels))).T)
