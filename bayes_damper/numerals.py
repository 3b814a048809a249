"""How numbers are written for people: with the digits that they support, and no more."""

from __future__ import annotations

import math
from typing import Any

NOTHING = "\N{EN DASH}"
"""What stands where there is no number."""
SDS_WIDE = 3.29
"""Standard deviations between the ends of a 90 % interval of a normal distribution."""


def number(x: Any, width: float | None = None) -> str:
    """A number as text, else four digits, with those that a 90 % interval of this width supports: two of its standard
    deviation; a dash for nothing.
    """
    if x is None or isinstance(x, bool) or not isinstance(x, int | float) or not math.isfinite(x):
        return NOTHING
    if isinstance(x, int):
        return str(x)
    if width is None or not math.isfinite(width) or width <= 0.0:
        return f"{x:.4g}"
    digits = 1 - math.floor(math.log10(width / SDS_WIDE))
    if x:  # a number far below the width of a lopsided interval keeps a digit of its own
        digits = min(max(digits, -math.floor(math.log10(abs(x)))), digits + 2)
    if -3 <= digits <= 6 and abs(x) < 1e6:
        return f"{round(x, digits):.{max(digits, 0)}f}"
    significant = max(2, math.floor(math.log10(max(abs(x), 1e-300))) + digits + 1)
    return f"{x:.{min(significant, 6)}g}"


def plus_minus(x: Any, sd: Any) -> str:
    """A value and its standard deviation, with the digits that this supports."""
    if not isinstance(sd, int | float) or not math.isfinite(sd) or sd <= 0.0:
        return number(x)
    return f"{number(x, SDS_WIDE * sd)} ± {number(sd, SDS_WIDE * sd)}"


def percent(p: Any) -> str:
    """A probability in per cent; never 0 or 100 unless it is exactly that."""
    if p is None:
        return NOTHING
    value = 100.0 * float(p)
    if value in {0.0, 100.0}:
        return f"{value:.0f} %"
    if value > 99.0:
        return f"{min(value, 99.9):.1f} %"
    return "below 0.1 %" if value < 0.1 else f"{value:.1f} %" if value < 1.0 else f"{value:.0f} %"


def interval(low: Any, high: Any) -> str:
    """An interval as text."""
    if low is None or high is None:
        return NOTHING
    width = abs(high - low)
    return f"{number(low, width)} to {number(high, width)}"
