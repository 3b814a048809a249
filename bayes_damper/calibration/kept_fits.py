"""Fits that a run has made, kept in a folder, so that the same run does not make them again after a stop.

A fit is known by the checksum of all that decides it: problem, starts and options. What is kept is where it ended; its
derivatives are made anew there, so that the fit is the same bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.problem import Problem
from bayes_damper.runs.checkpoint import read_whole, write_whole
from bayes_damper.runs.content_hash import content_sha256

Array = NDArray[np.float64]
End = tuple[Array, dict[int, Array], bool, int, bool]
"""Where a fit ended: q, each trial's own values, whether it converged, steps, derivatives to both sides."""
_FOLDER: ContextVar[Path | None] = ContextVar("folder of kept fits", default=None)


@contextmanager
def fits_kept_in(folder: Path) -> Iterator[None]:
    """Every fit that is made here, in this process or one forked from it, is kept in `folder`, and found there."""
    folder.mkdir(parents=True, exist_ok=True)
    before = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(before)


def place_of(problem: Problem, starts: Sequence[Array], eta: Mapping[int, Array] | None, *options: Any) -> Path | None:
    """File of a fit, None where none is kept."""
    folder = _FOLDER.get()
    return None if folder is None else folder / f"{content_sha256(problem.identity, starts, eta, options)}.npz"


def kept_end(place: Path | None, problem: Problem) -> End | None:
    """Where the fit ended, if it has been made; None where its file is not of this problem either."""
    content = None if place is None else read_whole(place)
    if content is None:
        return None
    arrays, record = content
    own = problem.no_nuisance()
    wanted = {"q": problem.prior_mean(), **{f"eta{i}": v for i, v in own.items()}}
    steps = record.get("iterations")
    fits = all(n in arrays and (arrays[n].shape, arrays[n].dtype) == (v.shape, v.dtype) for n, v in wanted.items())
    if not fits or not isinstance(steps, int):
        return None
    eta = {i: arrays[f"eta{i}"] for i in own}
    return arrays["q"], eta, bool(record.get("converged")), steps, bool(record.get("central"))


def keep(place: Path | None, end: End) -> None:
    """Note where a fit ended, if fits are kept."""
    if place is None:
        return
    q, eta, converged, iterations, central = end
    record = {"converged": bool(converged), "iterations": int(iterations), "central": bool(central)}
    write_whole(place, {"q": q, **{f"eta{i}": v for i, v in eta.items()}}, record, flush=False)
