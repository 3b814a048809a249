"""What the thesis prints: constants and cases as strings, whose last digit tells how far a number was rounded."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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


PRINTED: dict[str, Case] = {
    "I": Case(
        *("6.2", "5.7", "30.4", ("0.95", "0.40"), ("0.150", "0.061"), "7.19", ("6.76", "0.01"), "5.98"),
        *(("149.6", "0.2"), "203.6", ("164.1", "6.2"), "164.2", "19.4", ("1.61", "0.20"), ("0.249", "0.028")),
        *(("138.1", "3.6"), ("135.7", "2.9"), "2", "0.1", "199.8", "1.9", ("0.15", "0.06")),
    ),
    "II": Case(
        *("6.2", "7.2", "49.2", ("0.26", "0.04"), ("0.041", "0.006"), "7.19", ("6.71", "0.01"), "6.68"),
        *(("149.0", "0.2"), "257.1", ("211.3", "4.6"), "211.3", "17.8", ("0.96", "0.12"), ("0.151", "0.018")),
        *(("121.3", "1.5"), ("177.3", "0.6"), "1", "0.08", "252.3", "1.9", ("0.04", "0.01")),
    ),
    "III": Case(
        *("10.2", "2.7", "11.3", ("0.42", "0.41"), ("0.067", "0.062"), "9.26", ("9.04", "0.01"), "2.38"),
        *(("110.8", "0.1"), "159.1", ("157.4", "8.3"), "157.4", "1.1", ("1.66", "0.16"), ("0.256", "0.022")),
        *(("112.1", "5.3"), ("95.9", "9.9"), "3", "0.12", "155.6", "1.9", ("0.07", "0.06")),
    ),
    "IV": Case(
        *("10.2", "4.7", "34.3", ("0.20", "0.01"), ("0.031", "0.001"), "9.26", ("9.07", "0.01"), "2.05"),
        *(("110.4", "0.1"), "277.5", ("240.7", "8.1"), "240.7", "13.3", ("1.21", "0.05"), ("0.189", "0.007")),
        *(("116.3", "7.3"), ("218.7", "6.1"), "1", "0.08", "273.1", "1.4", ("0.03", "0.001")),
    ),
}
TABLE_12 = {  # p. 31: resonance Hz, accelerance 1/(kg m^2)
    "with effective stiffness": (("9.0", "680.7"),),
    "no effective stiffness": (("9.0", "873.9"),),
    "undamped coupling": (("3.1", "900.1"), ("9.8", "7069.2")),
    "uncoupled": (("9.2", "772.1"),),
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
