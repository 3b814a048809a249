"""Under correlated errors, whether repeats share them or not, intervals hold the truth as often as they say."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import parts
import pytest
from coloured import NAMES, covered, share_inside
from scipy.stats import binom

CAMPAIGNS = 60
KINDS = {
    "white noise, three repeats": ("white", 3),
    "correlated errors of each trial, three repeats": ("own", 3),
    "a correlated misfit that three repeats share": ("shared", 3),
    "a correlated misfit, a single trial": ("shared", 1),
}
SHARES = (0.5, 0.9)


def _campaign(kind: str, repeats: int, number: int) -> dict[str, Any]:
    return {"ranks": covered(9000 + number, kind, repeats).tolist()}


@pytest.mark.prove
def test_intervals_cover_under_every_kind_of_noise() -> None:
    found: dict[str, dict[str, float]] = {}
    for title, (kind, repeats) in KINDS.items():
        name = f"noise-{kind}-{repeats}"
        rows = parts.finish(name, CAMPAIGNS, partial(_campaign, kind, repeats))
        ranks = np.array([row["ranks"] for row in rows])
        found[title] = {f"{share:g}": share_inside(ranks, share) for share in SHARES}
        found[title] |= {f"{name} {s:g}": share_inside(ranks[:, i], s) for i, name in enumerate(NAMES) for s in SHARES}
    told = (
        f"{CAMPAIGNS} campaigns of each kind, seven parameters each, truths drawn from the priors; white noise of "
        "2 rad/s² everywhere, beside it an autoregression (0.95 from reading to reading, 6 rad/s²). Share of truths "
        "inside the central intervals:"
    )
    lines = [
        told,
        "",
        "| errors | 50 % | 90 % |",
        "| --- | --- | --- |",
        *(f"| {title} | {row['0.5']:.2f} | {row['0.9']:.2f} |" for title, row in found.items()),
    ]
    worst = min(row["0.9"] for row in found.values())
    verdict = f"90 % intervals hold the truth in {worst:.0%} of cases or more, whatever the errors."
    numbers = {"campaigns": CAMPAIGNS, "coverage": found}
    parts.write_page("noise", verdict, lines, numbers)
    # Parameters of one campaign are not independent: two of the seven are taken as free.
    n = 2 * CAMPAIGNS
    for title, row in found.items():
        for share in SHARES:
            low, high = binom.ppf([0.001, 0.999], n, share) / n
            assert low <= row[f"{share:g}"] <= high, (title, share)
