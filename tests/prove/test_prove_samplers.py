"""Our sampler beside PINTS, zeus and NUTS, on the same data and the same log density, in one run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pages
import pytest
import samplers

PROMISED = {"zeus": 4.0, "PINTS": 10.0, "numpyro": 10.0}


def _peers(posterior: Any) -> dict[str, Callable[[], samplers.Run]]:
    return {
        "zeus": lambda: samplers.zeus(posterior),
        "PINTS": lambda: samplers.pints(posterior, "HaarioBardenetACMC", 3, 8000, 2000),
        "PINTS, DE": lambda: samplers.pints(posterior, "DifferentialEvolutionMCMC", 24, 1000, 300),
        "numpyro": lambda: samplers.nuts(posterior),
    }


@pytest.mark.prove
@pytest.mark.filterwarnings("ignore")  # the peers' own
def test_the_sampler_beats_its_peers_and_agrees_with_them():
    posterior, ours, stages = samplers.own()
    rate = float(ours.sizes.min()) / ours.seconds
    rows = [_row(ours, ours, rate)]
    missing = []
    for name, run in _peers(posterior).items():
        try:
            rows.append(_row(ours, run(), rate))
        except ImportError:
            missing.append(name)
    settled = [row for row in rows if row["r_hat"] is None or row["r_hat"] < 1.05]
    agree = all(row["means"] < 4.5 and row["sds"] < 1.2 for row in settled)
    gap = None if "numpyro" in missing else samplers.jax_gap(posterior)
    pages.samplers({"runs": rows, "stages": stages, "missing": missing, "agree": agree, "jax_gap": gap})
    assert stages["converged"]
    assert agree, rows
    for row in rows[1:]:
        promised = next(value for name, value in PROMISED.items() if row["name"].startswith(name))
        assert row["ratio"] >= promised, row
    if len(missing) == len(_peers(posterior)):
        pytest.skip("none of the peers is installed: pip install 'bayes-damper[bench]'")


def _row(ours: samplers.Run, run: samplers.Run, rate: float) -> dict[str, Any]:
    least = float(run.sizes.min())
    means, sds = samplers.agreement(ours, run)
    return {
        "name": run.name,
        "ess": least,
        "r_hat": run.r_hat if np.isfinite(run.r_hat) else None,  # one ensemble has nothing to be compared with
        "evaluations_each": run.evaluations / least,
        "warm_up": run.warm_up_seconds,
        "seconds": run.seconds,
        "rate": least / run.seconds,
        "ratio": rate / (least / run.seconds),
        "means": means,
        "sds": sds,
    }
