"""The integrator over the whole prior, against a solver that shares nothing with it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pages
import parts
import pytest
import reference

from bayes_damper.simulation.model import Model

SECOND = np.arange(0.0, 1.0005, 1e-3)
VECTORS = 150
"""Of each law of the pull."""


def errors(law: str, number: int) -> dict[str, float]:
    """Largest error of one vector's record as a share of its peak, at both tolerances; the tests' solver takes h L <=
    0.05, up to some million steps.
    """
    p = {k: float(v[number]) for k, v in reference.draw(VECTORS, 31).items()}
    exact = reference.solve(p, SECOND, linear=law == "linear")[0]
    found = {"nu": p["nu"]}
    for name, tolerance in (("error", 1.0), ("tight", 0.1)):
        y = Model(normal_force=law).simulate(reference.BASE | p, SECOND, tolerance=tolerance).y[0]
        found[name] = float(np.abs(y - exact).max() / np.abs(exact).max())
    return found


@pytest.mark.prove
def test_errors_stay_below_1e_4_of_the_peak_over_300_vectors():
    rows = []
    for law in ("linear", "constant"):
        results = parts.finish(f"integrator-{law}", VECTORS, partial(errors, law))
        rows.append(
            {
                "law": law,
                "vectors": len(results),
                "error": max(r["error"] for r in results),
                "tight": max(r["tight"] for r in results),
            }
        )
    pages.integrator(rows)
    for row in rows:
        assert row["error"] < 1e-4, row
        assert row["tight"] < 1e-5, row
