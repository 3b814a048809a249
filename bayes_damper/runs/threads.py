"""How many threads integrate the blocks of a batch side by side, and the threads that do."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

_COUNT: ContextVar[int] = ContextVar("kernel_threads", default=1)


@contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Integrate in up to `count` threads within; a forked process uses one. Records do not depend on it."""
    before = _COUNT.set(max(count, 1))
    try:
        yield
    finally:
        _COUNT.reset(before)


def threads_allowed() -> int:
    """How many threads are allowed here, or processes in their place."""
    return _COUNT.get()


def side_by_side(work: Callable[[int, int], None], blocks: int) -> None:
    """work(first, step) on every block first, first + step, ...: in the threads that are allowed here."""
    count = min(_COUNT.get(), blocks)
    if count < 2:
        work(0, 1)
    else:
        list(_pool(count).map(work, range(count), [count] * count))


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Threads that stay: to start new ones takes as long as a block of records."""
    return ThreadPoolExecutor(count, "kernel")


def _forked() -> None:
    """A forked process has no thread of these, and stands beside others as it is."""
    _pool.cache_clear()
    _COUNT.set(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
