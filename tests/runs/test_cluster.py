"""Tasks on a Dask cluster: processes that may have no children, and a scheduler that ends in mid-run."""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from test_ensembles import Gaussian, start_of

from bayes_damper.errors import BayesDamperError, InputError
from bayes_damper.runs.execution import Task, run_tasks
from bayes_damper.runs.parallel_map import can_fork, forked_map
from bayes_damper.sampling import StoppingRule, sample

TASKS = """
import multiprocessing, os, signal, time
from bayes_damper.runs.parallel_map import forked_map

def forks(folder, report):
    return [multiprocessing.current_process().daemon, *forked_map(abs, [-1, -2], 2)]

def waits(folder, report):
    (folder / "begun").touch()
    time.sleep(60)
    return []

def killed_once(folder, report):
    first = not (folder / "begun").exists()
    (folder / "begun").touch()
    if first:
        os.kill(os.getpid(), signal.SIGKILL)
    return [multiprocessing.current_process().name]

def killed(folder, report):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def in_a_daemon(results) -> None:
    target = Gaussian(2)
    found = sample(target, start_of(target), walkers=8, seed=1, rule=StoppingRule(max_steps=50), workers=2)
    results.put((can_fork(), forked_map(abs, [-1, -2], 2), found.draws.shape[0]))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks")
def test_a_process_that_may_have_no_children_does_the_work_itself():
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=in_a_daemon, args=(results,), daemon=True)
    process.start()
    forks, mapped, ensembles = results.get(timeout=60)
    process.join()
    assert not forks
    assert mapped == [1, 2]
    assert ensembles > 1
    assert np.isfinite(ensembles)


@pytest.fixture
def cluster(tmp_path, monkeypatch) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Address of a scheduler with one worker process, and the scheduler's own process."""
    pytest.importorskip("distributed", reason="needs the extra `cluster`")
    (tmp_path / "cluster_tasks.py").write_text(TASKS)
    monkeypatch.syspath_prepend(str(tmp_path))
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH", "")])
    told = tmp_path / "scheduler.json"
    commands = (
        ("dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)),
        ("dask_worker", "--scheduler-file", str(told), "--nworkers", "1", "--nthreads", "1", "--nanny",
         "--no-dashboard", "--local-directory", str(tmp_path / "scratch")),
    )  # fmt: skip
    started = []
    try:
        for name, *more in commands:
            command = [sys.executable, "-m", f"distributed.cli.{name}", *more]
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            started.append(subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, **quiet))
            until = time.monotonic() + 60.0
            while not (told.exists() and told.read_text().strip()):
                assert time.monotonic() < until, f"{name} did not start"
                time.sleep(0.1)
        yield json.loads(told.read_text())["address"], started[0]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait(20)


@pytest.mark.slow
def test_tasks_on_a_cluster_may_ask_for_processes(cluster, tmp_path):
    import cluster_tasks

    address, _ = cluster
    assert run_tasks([Task("a", cluster_tasks.forks)], tmp_path / "out", scheduler=address) == {"a": [True, 1, 2]}


@pytest.mark.slow
def test_the_task_of_a_worker_that_is_killed_is_done_again(cluster, tmp_path):
    import cluster_tasks

    address, _ = cluster
    tasks = [Task("a", cluster_tasks.killed_once), Task("b", cluster_tasks.forks)]
    found = run_tasks(tasks, tmp_path / "out", scheduler=address)
    assert set(found) == {"a", "b"}
    assert found["b"] == [True, 1, 2]


@pytest.mark.slow
def test_a_task_whose_workers_are_killed_each_time_is_a_sentence(cluster, tmp_path):
    import cluster_tasks

    address, _ = cluster
    with pytest.raises(BayesDamperError, match=r"gave up a \(KilledWorker\).*go on with: bayes-damper resume"):
        run_tasks([Task("a", cluster_tasks.killed)], tmp_path / "out", scheduler=address)


@pytest.mark.slow
def test_a_scheduler_that_ends_in_mid_run_is_a_sentence(cluster, tmp_path):
    import threading

    import cluster_tasks

    address, scheduler = cluster
    out = tmp_path / "out"

    def kill() -> None:
        while not (out / "a" / "begun").exists():
            time.sleep(0.1)
        scheduler.kill()

    threading.Thread(target=kill, daemon=True).start()
    with pytest.raises(BayesDamperError, match="go on with: bayes-damper resume"):
        run_tasks([Task("a", cluster_tasks.waits)], out, scheduler=address)


def test_no_scheduler_is_a_sentence(tmp_path):
    pytest.importorskip("distributed", reason="needs the extra `cluster`")
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        run_tasks([Task("a", print)], tmp_path, scheduler="nonsense://x")
