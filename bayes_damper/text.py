"""Words for people: counts, p values, coordinates, and a test of the gap that points another way than the verdict."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

SMALLEST_P = 1e-12
"""Below this a p value says nothing more: no model of noise holds so far out in its tails."""

_ALIKE = 3  # records of which the same is said, from which on it is said once

COORDINATES = {
    "th1": (("θ1", "rad"), ("x1", "m")), "th2": (("θ2", "rad"), ("x2", "m")),
    "phi": (("θ1 - θ2", "rad"), ("x1 - x2", "m")), "w1": (("ω1", "rad/s"), ("v1", "m/s")),
    "w2": (("ω2", "rad/s"), ("v2", "m/s")), "slip": (("ω1 - ω2", "rad/s"), ("v1 - v2", "m/s")),
}  # fmt: skip
"""Coordinates of the motion: symbol and unit on a torsional rig, and on a translational one."""


def counted(n: int, one: str, many: str = "") -> str:
    """A number with its noun: `1 case`, `3 cases`; `many` where the plural is not made by an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def p_value(p: float) -> str:
    """A p value as people write it: `p = 0.03`, and `p below 1e-12` where digits mean nothing."""
    return f"p below {SMALLEST_P:.0e}" if p < SMALLEST_P else f"p = {p:.2g}"


_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])")


def gathered(warnings: Iterable[str]) -> list[str]:
    """Warnings for reading: what is said of three records or more, alike but for its numbers, is said once.

    warnings : `FILE: sentence` or `FILE, column 'NAME': sentence`; others stay as they are, each in its place.
    """
    alike: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    for warning in warnings:
        place, mark, sentence = warning.partition(": ")
        file, comma, column = place.partition(", column ")
        if mark and ".csv" in file:
            key = (column, _NUMBER.sub("#", sentence))
            alike.setdefault(key, []).append((file, comma + column, sentence))
        else:
            alike.setdefault((warning,), []).append(("", "", warning))
    out = []
    for found in alike.values():
        file, column, sentence = found[0]
        if not file:
            out.append(sentence)
        elif len(found) < _ALIKE:
            out += [f"{name}{column}: {said}" for name, column, said in found]
        else:
            same = "" if all(said == sentence for _, _, said in found) else " (numbers of the first)"
            out.append(f"{file} and {len(found) - 1} others{column}: {sentence}{same}")
    return out


def gap_beside_verdict(verdict: str, share: float, gap: Mapping[str, Any]) -> str:
    """Why the test of the gap and the verdict point different ways, in a sentence; "" where they agree.

    verdict, share : the most probable answer and its probability; gap : `gap` of diagnosis.json.
    """
    answer, p = gap.get("answer"), gap.get("p_value")
    if answer == "gap" and verdict == "none":
        told = "" if p is None else f" ({p_value(p)})"
        rare = p is not None and p < 0.1 * gap.get("size", 0.05)
        first = f"The test of the held-out residuals alone says gap{told}"
        if rare:
            return (
                f"{first}, yet no cause explains it better than no cause at all ({share:.2f}): look at the residuals, "
                "and repeat the trials, before you trust either."
            )
        return (
            f"{first}, as it does for one faultless rig in {1.0 / gap.get('size', 0.05):.0f}; weighed against every "
            f"cause, that nothing is missing stays the most probable answer ({share:.2f}). Repeats would decide."
        )
    if verdict != "none" and answer in ("none", "cannot tell"):
        if gap.get("augmented_rms") is None and gap.get("closed") is None:
            return "No trial could be held out, so nothing tests this answer but the trials it was found in."
        return (
            "The test of the held-out trials alone does not show it"
            + ("" if p is None else f" ({p_value(p)})")
            + "; the answer rests on all trials together. Repeats would confirm it or not."
        )
    return ""


def named_answers(probabilities: Mapping[str, float], pair: Mapping[str, Any] | None) -> dict[str, float]:
    """Answer -> probability, as it is shown: where two effects are the answer, the stronger one's is that of both.

    pair : as in diagnosis.json: `effects`, the stronger first, and `probability`; None if no pair was considered.
    """
    both = tuple(pair["effects"]) if pair and pair["probability"] >= 0.5 else ()
    return {" + ".join(both) if both and name == both[0] else name: float(p) for name, p in probabilities.items()}
