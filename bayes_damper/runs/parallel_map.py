"""The same function on many things, side by side in forked processes that hand back small answers.

Threads do not help where each call is a few milliseconds of compiled code between lines of Python: they wait for one
another longer than they work.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

Item = TypeVar("Item")
Answer = TypeVar("Answer")
Given = ParamSpec("Given")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_fork() -> bool:
    """Whether processes can be forked safely here: elsewhere than on Linux system libraries forbid it, and processes
    that are not to outlive their parent, as the workers of a cluster, may have no children.
    """
    return sys.platform.startswith("linux") and not multiprocessing.current_process().daemon


def single_threaded(work: Callable[Given, Answer]) -> Callable[Given, Answer]:
    """The same function with linear algebra in one thread.

    The matrices here are many and small: threads that wait for one another's share of each doubled the time of a
    diagnosis on two cores, and took three times the processor time.
    """

    @wraps(work)
    def alone(*args: Given.args, **options: Given.kwargs) -> Answer:
        from threadpoolctl import threadpool_limits  # a tenth of the time that `--help` takes

        with threadpool_limits(limits=1, user_api="blas"):
            return work(*args, **options)

    return alone


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ctrl-C waits: a process that has been started must be known to be ended."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _limit_memory(most: int) -> None:
    """Let this process take `most` bytes beyond what it has; on Linux alone, which says in a file how much that is."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (has + most, hard))


def _sent(end: Connection, work: Callable[[Any], Any], item: Any, memory: int) -> None:
    _limit_memory(memory)
    faulthandler.disable()  # the sentence says what a dump of the stack would
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as in `forked_map`
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        end.send((work(item), None))
    except MemoryError:
        end.send((None, f"reading it takes more than {memory / 1e9:.2g} GB of memory"))
    except Exception as error:  # noqa: BLE001 (it is raised again by whoever receives it)
        end.send((None, str(error) or type(error).__name__))


def apart(work: Callable[[Item], Answer], item: Item, seconds: float, memory: int) -> Answer:
    """work(item) in a process of its own, for libraries that may take the process with them; both must be picklable.

    memory : bytes that it may take beyond those that this process has, on Linux.

    Raises
    ------
    RuntimeError
        if the process died, took longer or more memory, or met an exception: says which.
    """
    if multiprocessing.current_process().daemon:  # may have no children, and is one itself
        return work(item)
    context: Any = multiprocessing.get_context("fork" if can_fork() else "spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_sent, args=(theirs, work, item, memory), daemon=True)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*fork.*", DeprecationWarning)  # as in `forked_map`
            process.start()
        theirs.close()
        if not ours.poll(seconds):
            raise RuntimeError(f"reading it does not end within {seconds:g} s")
        answer, fault = ours.recv()
    except EOFError:
        raise RuntimeError("it crashes the reader") from None
    finally:
        if process.pid is not None:
            process.kill()
            process.join()
        ours.close()
    if fault is not None:
        raise RuntimeError(fault)
    return cast("Answer", answer)


def forked_map(
    work: Callable[[Item], Answer], items: Sequence[Item], count: int, each: Callable[[int], None] = lambda _: None
) -> list[Answer]:
    """[work(item) for item in items], in `count` processes that take one item after the other.

    each : called after each answer with how many there are.

    The answers have to be picklable, the items not. What a process failed at, or took with it when it died, is done
    here, so that errors arise as without them. Without fork, or with a count of 1, everything is done here.
    """
    if count < 2 or len(items) < 2 or not can_fork():
        done = []
        for item in items:
            done.append(work(item))
            each(len(done))
        return done
    context = multiprocessing.get_context("fork")
    turn = context.Value("i", 0)

    def serve(answers: Connection) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it too, and ends us
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        while True:
            with turn.get_lock():
                mine = turn.value
                turn.value += 1
            if mine >= len(items):
                return
            with suppress(Exception):  # the parent tries again what is missing, and meets it there
                answers.send((mine, work(items[mine])))

    open_ends: list[Connection] = []
    processes = []
    found: dict[int, Any] = {}
    try:
        for _ in range(min(count, len(items))):
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=serve, args=(theirs,), daemon=True)
            with warnings.catch_warnings(), _uninterrupted():
                # Threads beside us only wait, or belong to linear algebra, which knows of forks: they hold no lock.
                warnings.filterwarnings("ignore", ".*fork.*", DeprecationWarning)
                process.start()
                processes.append(process)
            theirs.close()
            open_ends.append(ours)
        while open_ends:
            for end in wait(open_ends):
                try:
                    mine, answer = cast("Connection", end).recv()
                    found[mine] = answer
                    each(len(found))
                except EOFError:
                    open_ends.remove(cast("Connection", end))
    finally:
        for process in processes:
            process.terminate()
            process.join()
    return [found[k] if k in found else work(items[k]) for k in range(len(items))]
