"""Compiling many kernels on all cores, once on a machine.

A diagnosis needs a kernel for each formula and configuration, and numba compiles one at a time in a process: left to
the first call of each they take as long on many cores as on one.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayes_damper.rig.cache_folder import cache_folder
from bayes_damper.runs.parallel_map import can_fork, cores, forked_map
from bayes_damper.simulation import specialised
from bayes_damper.simulation.model import Model

LOG = logging.getLogger(__name__)
FEWEST = 4  # kernels for which it pays to start processes
_SECONDS = 0.65  # that a kernel takes, about, after what all of them share (6 s, mostly done by the first simulation)


def compile_ahead(
    models: Iterable[Model], driven: bool = False, curved: bool = False, report: Callable[[str], None] = lambda _: None
) -> int:
    """Compile the kernels of all models that this machine has none of, in as many processes as it has cores.

    driven : for records with an input torque; curved : for friction with a tail; report : receives a line before.
    Returns how many were compiled: 0 where processes cannot be forked; kernels are compiled when first called then, as
    they are after any failure here.
    """
    count = cores()
    if count < 2 or not can_fork():
        return 0
    bounds = {
        specialised.kernel_file(bound).stem: bound
        for bound in (model.bound(driven, curved=curved) for model in set(models))
    }
    if len(_missing(bounds)) < FEWEST:
        return 0
    with _alone(cache_folder() / "compiling.lock", lambda: len(_missing(bounds)), report):
        LOG.info("%d kernels, %d of them in %s", len(bounds), len(bounds) - len(_missing(bounds)), cache_folder())
        names = _missing(bounds)  # another process may have compiled them while this one waited
        if names:
            seconds = max(1.0, len(names) * _SECONDS / count)
            report(f"compiling {len(names)} kernels, once on this machine: about {seconds:.0f} s")
            specialised.compile_common()  # else each process would
            forked_map(lambda name: specialised.specialise(bounds[name]) is None, names, count)
    return len(names)


def _missing(bounds: dict[str, dict[str, object]]) -> list[str]:
    """Names of those of which no machine code is on disk."""
    index = f"py{sys.version_info.major}{sys.version_info.minor}.nbi"  # as numba names it
    kept: set[str] = set()
    with suppress(FileNotFoundError):
        files = (cache_folder() / "__pycache__").iterdir()
        kept = {file.name.split(".")[0] for file in files if file.name.endswith(index)}
    return [name for name in bounds if name not in kept]


@contextmanager
def _alone(
    path: Path, missing: Callable[[], int], report: Callable[[str], None], patience: float = 60.0
) -> Iterator[None]:
    """Holds a lock that one process on this machine can have at a time, so that two do not compile the same.

    The system frees that of a dead process, not that of one that is halted: where no kernel arrives for `patience`
    seconds, both go on. A kernel that two have compiled is only written twice.
    """
    import fcntl  # not on every system

    with path.open("w") as file:
        left, until = missing(), time.monotonic() + patience
        waits = False
        while left and time.monotonic() < until:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if not waits:
                    report("waiting for another run on this machine, which compiles the same code")
                waits = True
                time.sleep(min(0.2, patience))
            if missing() < left:
                left, until = missing(), time.monotonic() + patience
        yield
