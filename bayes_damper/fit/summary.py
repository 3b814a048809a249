"""Summaries of draws: the numbers that `summary.json` and `summary.csv` hold for each parameter."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayes_damper.rig.units import plain_meaning
from bayes_damper.runs.contents.fit import CaseEntry, FitFile, ParameterEntry
from bayes_damper.runs.json_files import write_text
from bayes_damper.sampling.arviz_adapter import hdi
from bayes_damper.sampling.convergence import diagnose_draws
from bayes_damper.sampling.prior_sensitivity import decided_by

Array = NDArray[np.float64]


def summarise(
    draws: Mapping[str, Array], units: Mapping[str, str], prior_shares: Mapping[str, float]
) -> dict[str, ParameterEntry]:
    """Summary of each quantity: name -> numbers as in summary.json.

    draws : name -> (ensembles, steps, walkers); prior_shares : name -> variance of the posterior over that of the
    prior, in the coordinate in which the prior is Gaussian: near 1 the data say nothing, near 0 the prior does not
    matter. Quantities that have no prior of their own (derived ones) have None.
    """
    out: dict[str, ParameterEntry] = {}
    for name, values in draws.items():
        checked = diagnose_draws(values)
        flat = values.ravel()
        out[name] = {
            "unit": units.get(name, ""),
            "mean": float(flat.mean()),
            "sd": float(flat.std(ddof=1)),
            "median": float(np.median(flat)),
            "hdi90": list(hdi(flat)),
            "quartiles": np.quantile(flat, (0.25, 0.75)).tolist(),
            "r_hat": _finite(checked.r_hat),
            "ess_bulk": _finite(checked.ess_bulk),
            "ess_tail": _finite(checked.ess_tail),
            "prior_share": prior_shares.get(name),
        }
    return out


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def groups_of(summary: FitFile) -> dict[str, CaseEntry]:
    """What was fitted of each case, and of all together ("joint") if that was."""
    return dict(summary["cases"]) | ({"joint": summary["joint"]} if summary.get("joint") else {})


def write_table(summary: FitFile, path: Path) -> None:
    """The parameters of all cases as CSV, one row each; `converged` says whether that case's run did."""
    rows = []
    for case, found in groups_of(summary).items():
        for name, numbers in found["parameters"].items():
            row: dict[str, Any] = {"case": case, "parameter": name, "converged": found["converged"], **numbers}
            row["hdi90_low"], row["hdi90_high"] = row.pop("hdi90")
            if quartiles := row.pop("quartiles", None):
                row["quartile_low"], row["quartile_high"] = quartiles
            if before := row.pop("prior", None):
                row["prior_median"] = before["median"]
                row["prior_hdi90_low"], row["prior_hdi90_high"] = before["hdi90"]
            rows.append(row)
    write_text(path, pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"))


def table_text(
    parameters: Mapping[str, ParameterEntry], title: str, meanings: Mapping[str, str] = MappingProxyType({})
) -> str:
    """A table for the terminal: median and 90 % interval, who decided (data or prior), and what each parameter is.

    meanings : of the parameters of an effect.
    """
    wide = max([8, *(len(name) + 1 for name in parameters)])
    lines = [title, f"  {'':{wide}s}{'median':>11s}  {'90 % interval':^25s}  {'unit':10s} {'decided by':14s} meaning"]
    for name, p in parameters.items():
        low, high = p["hdi90"]
        word = "(derived)" if p["prior_share"] is None else decided_by(p["prior_share"])
        row = f"  {name:{wide}s}{p['median']:11.4g}  {low:11.4g} .. {high:<11.4g} {p['unit']:10s} {word:14s} "
        lines.append((row + (meanings.get(name) or plain_meaning(name, p["unit"]))).rstrip())
    return "\n".join(lines)
