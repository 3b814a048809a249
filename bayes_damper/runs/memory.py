"""Memory: whether there is enough for a campaign, and how often Python looks for dead objects.

Importing the libraries and drawing figures makes a million objects that live on and refer to each other. Looked at
whenever 700 have been added, as Python does by default, and once more when the process ends, they cost a fit of one
record two of its eight seconds.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

BASE = 0.5e9
"""Bytes that a fit or a diagnosis holds however few the readings are: libraries, compiled code, what is kept."""
PER_READING = 2000.0
"""Bytes for each reading that is used: residuals and derivatives by every unknown, some of them twice. Measured with
campaigns of 50 trials of 5 000 readings of two channels."""
SELDOM = (50_000, 5, 5)
"""New objects until the youngest are looked at; how many such looks until the older, and the oldest, are."""


def free_bytes() -> float:
    """Memory that this process may still take: what the machine has left, or what a limit leaves; inf if unknown."""
    left = float("inf")
    with suppress(OSError, ValueError, IndexError):
        available = Path("/proc/meminfo").read_text(encoding="ascii").partition("MemAvailable:")[2]
        left = 1024.0 * float(available.split()[0])
    with suppress(ImportError, OSError, ValueError):
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY:
            left = min(left, float(soft))
    return min(left, group_bytes())


def group_bytes(root: Path = Path("/")) -> float:
    """Memory that the limit of a container or a batch job leaves, bytes; inf where there is none.

    root : of the file system. Source: the kernel's documentation of control groups, versions 1 and 2 (memory); pages of
    files that are not in use count as free.
    """
    left = float("inf")
    with suppress(OSError, ValueError):
        for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, controllers, group = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            first = bool(controllers)
            top = root / ("sys/fs/cgroup/memory" if first else "sys/fs/cgroup")
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes") if first else ("memory.max", "memory.current")
            folder = top / group.lstrip("/")
            for place in (folder, *(above for above in folder.parents if top in (above, *above.parents))):
                with suppress(OSError, ValueError):  # no such file, or no limit: "max"
                    limit, used = (float((place / name).read_text(encoding="ascii")) for name in names)
                    kept = (place / "memory.stat").read_text(encoding="ascii").partition("inactive_file ")[2]
                    left = min(left, max(limit - used + float(kept.split()[0] if kept else 0.0), 0.0))
    return left


def shortage(readings: int, left: float | None = None) -> str:
    """A sentence where a campaign of so many readings needs more memory than is free, else nothing.

    left : bytes; default what is free now
    """
    needed = BASE + PER_READING * readings
    left = free_bytes() if left is None else left
    if needed <= left:
        return ""
    return (
        f"{readings} readings take about {needed / 1e9:.2g} GB of memory, and {left / 1e9:.2g} GB are free: it may be "
        "stopped half way; `every = 2` under [measurement] of campaign.toml uses one reading in two"
    )


def collect_seldom() -> None:
    """From now on, in this process; at its end not at all: all memory goes back at once."""
    gc.set_threshold(*SELDOM)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


@contextmanager
def seldom_collected() -> Iterator[None]:
    """For as long as the context lasts, and at the end of the process."""
    before = gc.get_threshold()
    collect_seldom()
    try:
        yield
    finally:
        gc.set_threshold(*before)
