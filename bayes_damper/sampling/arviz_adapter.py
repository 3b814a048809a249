"""Results with the groups and dimension names of ArviZ, and `posterior.nc` on disk, which reads as an xarray DataTree.

Dimension `chain` is the ensemble. The walkers of an ensemble are folded into `draw`: draw = stored step * walkers +
walker, so that all walkers of a step stand together. ArviZ would take them for one sequential chain: the effective
sample sizes and R-hat that count are those
of `bayes_damper.sampling`, kept in the attributes of the posterior's variables.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import as_written
from bayes_damper.inputs import check_hdf5
from bayes_damper.runs.surroundings import unsteered
from bayes_damper.sampling.convergence import diagnose_draws

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
_HEALTH = ("r_hat", "ess_bulk", "ess_tail")


def imported(name: str) -> Any:
    """The module `name`, arviz itself or one that imports it.

    On import ArviZ 0.23 announces its successor and keeps the day on which it did so in the user's cache folder. Where
    another process does the same at that moment, or nothing can be written there, that ends in an OSError: the day is
    kept in a folder of no account then.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        try:
            return unsteered(name)
        except OSError:
            own = os.environ.get("XDG_CACHE_HOME")
            with TemporaryDirectory() as folder:
                os.environ["XDG_CACHE_HOME"] = folder
                try:
                    return unsteered(name)
                finally:
                    os.environ.pop("XDG_CACHE_HOME") if own is None else os.environ.update(XDG_CACHE_HOME=own)


def hdi(draws: Array, probability: float = 0.9) -> tuple[float, float]:
    """Shortest interval that holds this share of the draws (any shape)."""
    values = np.sort(np.ravel(draws))
    inside = int(np.floor(probability * len(values)))
    width = values[inside:] - values[: len(values) - inside]
    low = int(width.argmin())
    return float(values[low]), float(values[low + inside])


@dataclass(frozen=True)
class Variable:
    """One quantity of a file: values, a name for each of their dimensions, and attributes."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Results:
    """What a `posterior.nc` holds: group -> name -> Variable, attributes of groups, and of the file."""

    groups: Mapping[str, Mapping[str, Variable]]
    group_attributes: Mapping[str, Mapping[str, Any]]
    attributes: Mapping[str, Any]


def results(
    posterior: Mapping[str, Array],
    *,
    log_prob: Array,
    diagnostics: Mapping[str, Mapping[str, Any]] | None = None,
    groups: Mapping[str, Mapping[str, Array]] | None = None,
    attributes: Mapping[str, str | int | float] | None = None,
) -> Results:
    """Draws as a file holds them: posterior and sample_stats (lp), plus `groups`.

    posterior : name -> (ensembles, steps, walkers); log_prob likewise; diagnostics : r_hat, ess_bulk, ess_tail and unit
    of each where they are known already. groups : prior, posterior_predictive and log_likelihood hold arrays of
    (chain, draw, ...), log_likelihood with one entry a trial; observed_data plain arrays.
    """
    variables = {}
    for name, draws in posterior.items():
        known = vars(diagnose_draws(draws)) if diagnostics is None else diagnostics[name]
        health = {key: math.nan if known[key] is None else float(known[key]) for key in _HEALTH}
        unit = {"units": str(known["unit"])} if known.get("unit") else {}
        variables[name] = Variable(("chain", "draw"), draws.reshape(len(draws), -1), health | unit)
    lp = Variable(("chain", "draw"), log_prob.reshape(len(log_prob), -1))
    content: dict[str, Mapping[str, Variable]] = {"posterior": variables, "sample_stats": {"lp": lp}}
    for group, arrays in (groups or {}).items():
        lead = () if group in ("observed_data", "constant_data") else ("chain", "draw")
        content[group] = {name: _variable(name, np.asarray(values), lead) for name, values in arrays.items()}
    return Results(content, {"posterior": {"walkers": log_prob.shape[2]}}, dict(attributes or {}))


def _variable(name: str, values: NDArray[Any], lead: tuple[str, ...]) -> Variable:
    return Variable((*lead, *(f"{name}_dim_{i}" for i in range(values.ndim - len(lead)))), values)


def pareto_k(weights: Array) -> float:
    """Shape of the generalised Pareto distribution of the largest of weights (n,), by ArviZ.

    Below 0.7 averages over the weighted draws can be trusted (Vehtari et al. 2024, JMLR 25:72); inf where fewer than
    five large weights differ, -inf where all weights are the same.
    """
    top = float(weights.max())
    if np.ptp(weights) < 1e-9 * top:
        return -math.inf
    # ArviZ weighs by 1/exp(its argument): it takes log likelihoods of data to be left out.
    smooth = imported("arviz_stats.base").array_stats.psislw
    try:
        k = float(smooth(-np.log(np.maximum(weights / top, 1e-300)))[1])
    except ValueError:  # the largest weights are all the same
        return math.inf
    return k if math.isfinite(k) else math.inf


def write(content: Results, path: Path | str) -> None:
    """Writes `posterior.nc` (NetCDF 4), whole or not at all."""
    final = Path(path)
    scratch = final.with_name(f".{final.name}.part")
    # HDF5 itself does not survive a disk that fills: it crashes when the process ends.
    packed = io.BytesIO()
    _write(content, packed)
    try:
        scratch.write_bytes(packed.getbuffer())
        scratch.replace(final)
    finally:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)


def _write(content: Results, packed: io.BytesIO) -> None:
    with h5netcdf.File(packed, "w") as file:
        file.attrs.update(content.attributes)
        for group, variables in content.groups.items():
            place = file.create_group(group)
            place.attrs.update(content.group_attributes.get(group, {}))
            sizes = {dim: n for v in variables.values() for dim, n in zip(v.dims, v.values.shape, strict=True)}
            place.dimensions = sizes
            own = {dim: Variable((dim,), np.arange(n)) for dim, n in sizes.items() if dim not in variables}
            for name, variable in {**own, **variables}.items():
                kind = h5py.string_dtype() if variable.values.dtype.kind in "UO" else variable.values.dtype
                made = place.create_variable(name, variable.dims, kind, data=variable.values)
                made.attrs.update(variable.attributes)


@contextmanager
def opened(path: Path | str) -> Iterator[h5netcdf.File]:
    """A `posterior.nc` to read from, in a with statement.

    Raises
    ------
    InputError
        if it is damaged, points to other files, or claims to hold more than it can; also for what fails in the block.
    """
    with as_written(path, "fit"):
        with h5py.File(path, "r") as whole:
            check_hdf5(whole, Path(path).stat().st_size, plain=True)
        with h5netcdf.File(path, "r") as file:
            yield file


def read(path: Path | str) -> xr.DataTree:
    """The DataTree of a `posterior.nc`, in memory.

    Raises
    ------
    InputError
        as `opened`.
    """
    import xarray as xr

    with opened(path), xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree.load()


def to_arviz(path: Path | str) -> Any:
    """The draws of a `posterior.nc` as ArviZ's own object: InferenceData of its 0.x line, DataTree from 1.0 on.

    Each walker is a chain of its own here, so that ArviZ's effective sample sizes are honest: folded into one chain per
    ensemble, as they lie in the file, the walkers of a step would be taken for successive draws.

    Raises
    ------
    InputError
        as `opened`.
    """
    arviz = imported("arviz")
    tree = read(path)
    groups = {name: _by_walker(tree, name) for name in ("posterior", "sample_stats")}
    if int(arviz.__version__.partition(".")[0]) >= 1:
        return arviz.from_dict(groups)
    return arviz.from_dict(**groups)


def _by_walker(tree: xr.DataTree, group: str) -> dict[str, Array]:
    """Name -> (ensembles * walkers, steps, ...) of a group whose draws hold the walkers of a step together."""
    walkers = int(tree["posterior"].attrs["walkers"])
    found = {}
    for name, variable in tree[group].data_vars.items():
        ensembles, draws, *rest = variable.shape
        steps = variable.values.reshape(ensembles, draws // walkers, walkers, *rest)
        found[str(name)] = np.moveaxis(steps, 2, 1).reshape(ensembles * walkers, draws // walkers, *rest)
    return found


def combine_cases(files: Mapping[str, Path], path: Path, most: int = 1000) -> None:
    """One `posterior.nc` from those of single cases, with a dimension `case`; at most `most` draws of each chain.

    Only groups and quantities that all cases have, in like shapes, are taken.
    """
    content: dict[str, dict[str, Variable]] = {}
    attributes: dict[str, Any] = {}
    with ExitStack() as stack:
        stack.enter_context(as_written(Path(path).parent, "fit"))
        cases = {case: stack.enter_context(opened(file)) for case, file in files.items()}
        first, *others = cases.values()
        for case, file in cases.items():
            attributes |= {f"{key} of case {case}": value for key, value in file.attrs.items()}
        for group in (g for g in first.groups if all(g in other.groups for other in others)):
            places = [file.groups[group] for file in cases.values()]
            draws = min(
                min(place.dimensions["draw"].size, most) if "draw" in place.dimensions else 0 for place in places
            )
            found = {}
            for name in (n for n in places[0].variables if n not in places[0].dimensions):
                if all(name in place.variables for place in places):
                    parts = [_few(place.variables[name], draws) for place in places]
                    if len({part.shape for part in parts}) == 1:
                        found[name] = Variable(("case", *places[0].variables[name].dimensions), np.stack(parts))
            if found:
                found["case"] = Variable(("case",), np.array(list(files), dtype=object))
                content[group] = found
    write(Results(content, {}, attributes), path)


def _few(variable: Any, draws: int) -> NDArray[Any]:  # of h5netcdf
    """Values of a variable with so many of its draws."""
    values = np.asarray(variable[...])
    if "draw" not in variable.dimensions:
        return values
    axis = variable.dimensions.index("draw")
    return values.take(np.linspace(0, values.shape[axis] - 1, draws).round().astype(int), axis=axis)
