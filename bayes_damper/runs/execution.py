"""Long runs: independent tasks on worker processes, their progress, and what it takes to go on after a stop.

A task is a function with plain data for its arguments; neither is taken from a file. It runs in a folder of its own,
keeps its state there, and leaves `done.json` when it is finished, so a run that was stopped goes on with what is
missing. Results do not depend on the number of workers or on the order, because every task carries its own seed.
"""

from __future__ import annotations

import importlib
import os
import shutil
import signal
import sys
import threading
import time
from asyncio import CancelledError as AsyncCancelled
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context, parent_process
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from types import ModuleType
from typing import Any, NotRequired, Protocol, TypedDict, cast

from bayes_damper.errors import BayesDamperError, ExitCode, InputError, Interrupted
from bayes_damper.inputs import fields
from bayes_damper.runs.json_files import read_json, write_json
from bayes_damper.runs.memory import collect_seldom
from bayes_damper.runs.parallel_map import single_threaded

_POLL_S = 0.2
_STATUS_EVERY_S = 0.5
_MOST_BREAKDOWNS = 3
_TASKS_OF_A_WORKER = 12
"""So many for each worker, then all are started anew: a worker keeps a megabyte for every kernel that it has loaded."""
_MOST_WORKERS = 10_000
WAITING = "waiting"
"""What progress shows of a task that has not begun."""


@dataclass(frozen=True)
class Task:
    """One independent piece of a run.

    call : a function of a module, so that other processes can import it, called as f(folder, report, **arguments),
    where `folder` is the task's own and `report(share, text)` says how far it is. It returns plain JSON data.
    """

    name: str
    call: Callable[..., Any]
    arguments: Mapping[str, Any] = field(default_factory=dict)


class Progress(Protocol):
    """What shows progress to the user; figures in [0, 1]."""

    def update(self, task: str, share: float, text: str) -> None: ...


class Silent:
    """Shows nothing: for --quiet, and where nobody shows progress."""

    def update(self, task: str, share: float, text: str) -> None:
        """Nothing."""


class RunRecord(TypedDict):
    """What run.json of a folder holds: `code` and `made_by` where a command notes what runs it."""

    command: str
    plan: dict[str, Any]
    workers: int
    code: NotRequired[str]
    made_by: NotRequired[dict[str, str]]


def run_record(folder: Path) -> RunRecord:
    """What run.json of a folder says of the run in it: `command`, `plan` and `workers`, each of its type, and more.

    Raises
    ------
    InputError
        if there is none, or it is damaged.
    """
    path = folder / "run.json"
    record = read_json(path)
    known = {"command": (str,), "plan": (dict,)}
    sound = fields(record, known, f"{path}: damaged", "begin the run anew in another folder")
    workers = record.get("workers", 1)
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= _MOST_WORKERS:
        workers = 1
    return cast("RunRecord", {**record, **sound, "workers": workers})


def execute(task: Task, folder: Path) -> Any:
    """Run one task in its folder, unless it is done already; its result."""
    done = folder / "done.json"
    if done.exists():
        return read_json(done)
    folder.mkdir(parents=True, exist_ok=True)
    last = 0.0

    def report(share: float, text: str) -> None:
        nonlocal last
        if time.monotonic() - last > _STATUS_EVERY_S or share >= 1.0:
            last = time.monotonic()
            write_json(folder / "status.json", {"share": share, "text": text})

    result = single_threaded(task.call)(folder, report, **task.arguments)
    write_json(done, result)
    return result


def not_a_campaign(folder: Path) -> None:
    """Refuses the folder of a campaign for results, by an InputError: both have files that commands would mix up."""
    if (folder / "campaign.toml").exists():
        raise InputError(f"{folder}: holds a campaign, and results do not go beside it; name another --out")


def claim(folder: Path, record: Mapping[str, Any], workers: int) -> None:
    """Note in run.json of `folder` what runs there (`command`, `plan`, and more); the same run goes on.

    Raises
    ------
    InputError
        if another run is there, or a campaign, whose pieces are not mixed with this one's.
    """
    not_a_campaign(folder)
    path = folder / "run.json"
    if path.exists():
        before = run_record(folder)
        if not _same_run(before, record):
            changed = [key for key, value in record["plan"].items() if before["plan"].get(key) != value]
            what = f", with other {', '.join(changed)}" if changed else ", or one of another version of the package"
            raise InputError(f"{folder}: holds another run{what}; name another --out, or remove that folder")
    write_json(path, {**record, "workers": workers})


def _same_run(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two records are of one run, by whatever number of workers."""
    return {**one, "workers": 0} == {**other, "workers": 0}


UNFINISHED = "unfinished"
"""Folder with the pieces of a run that has not ended, in that of its results."""


@contextmanager
def pieces_kept(folder: Path, record: Mapping[str, Any], workers: int) -> Iterator[Path]:
    """A place in `folder` for pieces of a run, which are there again when the same run is begun after a stop.

    record : what runs (`command`, `plan`, and more), noted in run.json there; the pieces of another run are removed,
    and all of them when this one has ended.

    Raises
    ------
    Interrupted
        after Ctrl-C; the sentence says how to go on.
    """
    inside = folder / UNFINISHED
    try:
        begun = read_json(inside / "run.json") if inside.exists() else None
    except InputError:
        begun = None
    if not isinstance(begun, dict) or not _same_run(begun, record):
        shutil.rmtree(inside, ignore_errors=True)
        write_json(inside / "run.json", {**record, "workers": workers})
    try:
        yield inside
    except KeyboardInterrupt:
        raise stopped(folder) from None
    shutil.rmtree(inside, ignore_errors=True)


def stopped(folder: Path) -> Interrupted:
    """What is raised after Ctrl-C in a run that `resume` goes on with: the sentence says how."""
    return Interrupted(f"stopped, the state is saved; go on with: bayes-damper resume {folder}")


def run_tasks(
    tasks: Sequence[Task],
    folder: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run tasks in `folder`/<task name> on worker processes, or on a Dask cluster; name -> result, in the tasks' order.

    Raises
    ------
    Interrupted
        after Ctrl-C: every task has saved its state.
    BayesDamperError
        the first error of a task, when the others have come to an end.
    """
    shown: Progress = progress or Silent()
    if workers < 1:
        raise InputError(f"--workers {workers}: give at least 1")
    if scheduler is not None:
        return _on_cluster(tasks, folder, scheduler, shown)
    for task in tasks:
        shown.update(task.name, 0.0, WAITING)
    if workers == 1 and len(tasks) <= _TASKS_OF_A_WORKER:
        return {task.name: _here(task, folder, shown) for task in tasks}
    return _on_processes(tasks, folder, workers, shown)


def _here(task: Task, folder: Path, progress: Progress) -> Any:
    own = folder / task.name
    done = own / "done.json"
    if done.exists():
        progress.update(task.name, 1.0, "done before")
        return read_json(done)
    own.mkdir(parents=True, exist_ok=True)

    def report(share: float, text: str) -> None:
        progress.update(task.name, share, text)

    try:
        result = task.call(own, report, **task.arguments)
    except (KeyboardInterrupt, Interrupted):
        raise stopped(folder) from None
    write_json(done, result)
    progress.update(task.name, 1.0, "done")
    return result


def _on_processes(tasks: Sequence[Task], folder: Path, workers: int, progress: Progress) -> dict[str, Any]:
    results: dict[str, Any] = {}
    failed: dict[str, BaseException] = {}
    breakdowns = 0
    while True:
        waiting = [task for task in tasks if task.name not in results and task.name not in failed]
        waiting = waiting[: workers * _TASKS_OF_A_WORKER]
        if not waiting:
            if failed:
                raise next(iter(failed.values()))
            return {task.name: results[task.name] for task in tasks}
        context = get_context("spawn")
        crew = (workers, context.Value("i", len(waiting)))
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=crew)
        try:
            with _script_set_aside():
                futures: dict[Future[Any], Task] = {
                    pool.submit(_execute, task, folder / task.name): task for task in waiting
                }
            failed |= _collect(futures, folder, progress, results)
        except BrokenProcessPool:
            # A worker was killed from outside: what it had saved is there, so a new pool goes on with the rest.
            breakdowns += 1
            if breakdowns > _MOST_BREAKDOWNS:
                raise BayesDamperError(
                    f"worker processes were killed {breakdowns} times (out of memory?); use fewer --workers and go on "
                    f"with: bayes-damper resume {folder}"
                ) from None
        except KeyboardInterrupt:
            for process in list((pool._processes or {}).values()):  # noqa: SLF001 (an executor has no other way)
                process.terminate()
            raise stopped(folder) from None
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _script_set_aside() -> Iterator[None]:
    """Processes that start meanwhile do not run the user's script again, as a spawned process otherwise does.

    Tasks never need it, and a script without `if __name__ == "__main__":`, or one read from standard input, would end
    every worker before it began.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


_WORKER = {"busy": False, "stopped": False}
_CREW: list[tuple[int, Synchronized[int]]] = []  # in a worker: how many there are, and how many tasks are not finished


def processes() -> int:
    """Processes that the task which runs here may keep busy now: its share of the workers, all of them when it is the
    last.
    """
    if not _CREW:
        return 1
    workers, unfinished = _CREW[0]
    return max(1, workers // max(1, unfinished.value))


def _begin_worker(workers: int, unfinished: Synchronized[int]) -> None:
    """In a worker: Ctrl-C in a terminal reaches all processes at once, so it is left to the parent, which asks each
    worker once to stop.
    """
    _CREW[:] = [(workers, unfinished)]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    _end_with_parent()
    collect_seldom()


def _stop(_signal: int, _frame: Any) -> None:
    if not _WORKER["busy"]:
        os._exit(int(ExitCode.INTERRUPTED))
    _WORKER["stopped"] = True
    raise KeyboardInterrupt


def _execute(task: Task, folder: Path) -> Any:
    """`execute` in a worker; after a stop nothing more is begun."""
    if _WORKER["stopped"]:
        raise Interrupted("stopped before it began")
    _WORKER["busy"] = True
    try:
        return execute(task, folder)
    except KeyboardInterrupt:
        raise Interrupted("stopped") from None
    finally:
        _WORKER["busy"] = False
        unfinished = _CREW[0][1]
        with unfinished.get_lock():
            unfinished.value -= 1


def _end_with_parent() -> None:
    """In a worker: end when the process that started it has been killed. Left alone, it would go on writing into a
    folder in which `resume` is at work.
    """
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _collect(
    futures: dict[Future[Any], Task], folder: Path, progress: Progress, results: dict[str, object]
) -> dict[str, BaseException]:
    """Fills `results`, task by task; the errors of those that failed, by name, the first one first."""
    pending = set(futures)
    failed: dict[str, BaseException] = {}
    while pending:
        finished, pending = wait(pending, timeout=_POLL_S, return_when=FIRST_COMPLETED)
        for future in finished:
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                raise error
            if error is None:
                results[futures[future].name] = future.result()
                progress.update(futures[future].name, 1.0, "done")
            else:
                failed[futures[future].name] = error
        for future in pending:
            name = futures[future].name
            status = folder / name / "status.json"
            if status.exists():
                status_now = read_json(status)
                progress.update(name, status_now["share"], status_now["text"])
    return failed


def _on_cluster(tasks: Sequence[Task], folder: Path, scheduler: str, progress: Progress) -> dict[str, Any]:
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'bayes-damper[cluster]'") from None
    try:
        client = distributed.Client(scheduler)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); check address") from None
    results = {}
    with client:
        futures = {
            client.submit(execute, task, (folder / task.name).resolve(), pure=False, retries=_MOST_BREAKDOWNS): task
            for task in tasks
        }
        for future in distributed.as_completed(list(futures)):
            task = futures[future]
            try:
                results[task.name] = future.result()
            except (AsyncCancelled, CancelledError, OSError, distributed.KilledWorker) as error:
                raise BayesDamperError(
                    f"the cluster at {scheduler} gave up {task.name} ({type(error).__name__}): its scheduler has "
                    "ended, or its workers were killed; what was saved is there, go on with: bayes-damper resume "
                    f"{folder}"
                ) from None
            progress.update(task.name, 1.0, "done")
    return {task.name: results[task.name] for task in tasks}
