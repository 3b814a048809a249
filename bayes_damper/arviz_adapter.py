"""Results as an xarray DataTree with the groups and dimension names of ArviZ, and `posterior.nc` on disk.

Dimension `chain` is the ensemble. The walkers of an ensemble are folded into `draw`: draw = stored step * walkers +
walker, so that all walkers of a step stand together. ArviZ would take them for one sequential chain: the effective
sample sizes and R-hat that count are those
of `bayes_damper.sampling`, kept in the attributes of the posterior's variables.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_damper.sampling.convergence import diagnose_draws

Array = NDArray[np.float64]
Summary = dict[str, dict[str, float | tuple[float, float]]]


def hdi(draws: Array, probability: float = 0.9) -> tuple[float, float]:
    """Shortest interval that holds this share of the draws (any shape)."""
    values = np.sort(np.ravel(draws))
    inside = int(np.floor(probability * len(values)))
    width = values[inside:] - values[: len(values) - inside]
    low = int(width.argmin())
    return float(values[low]), float(values[low + inside])


def summary(posterior: Mapping[str, Array]) -> Summary:
    """Mean, sd, median, hdi90, r_hat, ess_bulk and ess_tail of each quantity (ensembles, steps, walkers)."""
    table: Summary = {}
    for name, draws in posterior.items():
        d = diagnose_draws(draws)
        table[name] = {
            "mean": float(np.mean(draws)),
            "sd": float(np.std(draws, ddof=1)),
            "median": float(np.median(draws)),
            "hdi90": hdi(draws),
            "r_hat": d.r_hat,
            "ess_bulk": d.ess_bulk,
            "ess_tail": d.ess_tail,
        }
    return table


def to_tree(
    posterior: Mapping[str, Array],
    *,
    log_prob: Array,
    groups: Mapping[str, Mapping[str, Array]] | None = None,
    attributes: Mapping[str, str | int | float] | None = None,
) -> xr.DataTree:
    """A DataTree with posterior and sample_stats (lp), plus `groups`.

    posterior : name -> (ensembles, steps, walkers); log_prob likewise. groups : prior, posterior_predictive and
    log_likelihood hold (chain, draw, ...) arrays, log_likelihood with one entry a trial; observed_data plain arrays.
    """
    variables = {}
    for name, draws in posterior.items():
        d = diagnose_draws(draws)
        figures = {"r_hat": d.r_hat, "ess_bulk": d.ess_bulk, "ess_tail": d.ess_tail}
        variables[name] = xr.Variable(("chain", "draw"), draws.reshape(len(draws), -1), figures)
    tree: dict[str, xr.Dataset] = {
        "posterior": _dataset(variables, {"walkers": log_prob.shape[2]}),
        "sample_stats": _dataset({"lp": xr.Variable(("chain", "draw"), log_prob.reshape(len(log_prob), -1))}, {}),
    }
    for group, content in (groups or {}).items():
        sampled = group not in ("observed_data", "constant_data")
        tree[group] = _dataset({n: _variable(n, np.asarray(v), sampled) for n, v in content.items()}, {})
    tree["/"] = xr.Dataset(attrs=dict(attributes or {}))
    return xr.DataTree.from_dict(tree)


def write(tree: xr.DataTree, path: Path | str) -> None:
    """Writes `posterior.nc` (h5netcdf), whole or not at all."""
    final = Path(path)
    scratch = final.with_name(f".{final.name}.part")
    tree.to_netcdf(scratch, engine="h5netcdf")
    scratch.replace(final)


def read(path: Path | str) -> xr.DataTree:
    """The DataTree of a `posterior.nc`, in memory."""
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree.load()


def _variable(name: str, values: Array, sampled: bool) -> xr.Variable:
    lead = ("chain", "draw") if sampled else ()
    return xr.Variable((*lead, *(f"{name}_dim_{i}" for i in range(values.ndim - len(lead)))), values)


def _dataset(variables: Mapping[str, xr.Variable], attributes: Mapping[str, int]) -> xr.Dataset:
    data = xr.Dataset(dict(variables), attrs=dict(attributes))
    return data.assign_coords({dim: np.arange(size) for dim, size in data.sizes.items()})


def combine_cases(files: Mapping[str, Path], path: Path, most: int = 1000) -> None:
    """One `posterior.nc` from those of single cases, with a dimension `case`; at most `most` draws of each chain.

    Only groups and quantities that all cases have are taken.
    """
    trees = {case: read(file) for case, file in files.items()}
    combined: dict[str, xr.Dataset] = {}
    for group in set.intersection(*(set(tree.children) for tree in trees.values())):
        parts = {case: tree[group].to_dataset() for case, tree in trees.items()}
        shared = set.intersection(*({str(name) for name in part.data_vars} for part in parts.values()))
        if not shared:
            continue
        kept = [_spread(part[sorted(shared)], most) for part in parts.values()]
        draws = min(part.sizes.get("draw", 0) for part in kept)
        if draws:
            kept = [part.isel(draw=slice(draws)).assign_coords(draw=np.arange(draws)) for part in kept]
        index = xr.Variable("case", list(parts))
        combined[group] = xr.concat(kept, dim=index, coords="minimal", join="exact", combine_attrs="drop_conflicts")
    attributes = {f"{key} of case {case}": value for case, tree in trees.items() for key, value in tree.attrs.items()}
    combined["/"] = xr.Dataset(attrs=attributes)
    write(xr.DataTree.from_dict(combined), path)


def _spread(part: xr.Dataset, most: int) -> xr.Dataset:
    size = part.sizes.get("draw", 0)
    if size <= most:
        return part
    return part.isel(draw=np.linspace(0, size - 1, most).round().astype(int))
