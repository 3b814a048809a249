"""Work shared among forked processes: the answers of one process, whoever gave them."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from compiled import without_kernels

from bayes_damper.effects import EFFECTS
from bayes_damper.rig.kernels import compiled
from bayes_damper.runs.parallel_map import apart, can_fork, forked_map, single_threaded
from bayes_damper.simulation import specialised
from bayes_damper.simulation.model import Model
from bayes_damper.simulation.precompile import _alone, compile_ahead

# What a task, a diagnosis and a process that either starts see of the threads of linear algebra, begun with two.
THREADS = """
import pathlib, tempfile
import numpy
from threadpoolctl import threadpool_info, threadpool_limits
from bayes_damper.runs.execution import Task, execute
from bayes_damper.runs.parallel_map import forked_map

def seen(*_):
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

threadpool_limits(2, "blas")
with tempfile.TemporaryDirectory() as folder:
    print(seen(), execute(Task("t", lambda *_: [seen(), *forked_map(seen, range(2), 2)]), pathlib.Path(folder)), seen())
"""

forks = pytest.mark.skipif(not can_fork(), reason="this system cannot fork")


@pytest.mark.parametrize("count", [1, 3])
def test_each_answer_is_counted(count):
    counts = []
    assert forked_map(lambda x: 2 * x, range(4), count, counts.append) == [0, 2, 4, 6]
    assert counts == [1, 2, 3, 4]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_answers_come_in_the_order_of_the_items(count):
    assert forked_map(lambda x: x**2, list(range(7)), count) == [x**2 for x in range(7)]
    assert forked_map(lambda x: x**2, [], count) == []


@forks
def test_the_work_is_done_elsewhere():
    assert os.getpid() not in forked_map(lambda _: os.getpid(), range(4), 2)


def test_an_error_arises_here():
    def work(x):
        return 1.0 / x

    with pytest.raises(ZeroDivisionError):
        forked_map(work, [1.0, 0.0, 2.0], 2)


@forks
def test_what_a_dead_process_took_with_it_is_done_here():
    here = os.getpid()

    def work(x):
        if os.getpid() != here and x == 2:
            os._exit(9)
        return x, os.getpid() == here

    answers = forked_map(work, range(6), 2)
    assert [x for x, _ in answers] == list(range(6))
    assert answers[2] == (2, True)


@forks
def test_an_answer_that_cannot_be_sent_is_found_here():
    answers = forked_map(lambda x: lambda: x, [1, 2, 3], 2)
    assert [answer() for answer in answers] == [1, 2, 3]


HALF_GB = 500_000_000


def ends(way):
    """Work that ends in some way, or not at all."""
    ends = {"answer": os.getpid, "dies": os.abort, "fails": lambda: 1 / 0, "hangs": lambda: time.sleep(60.0)}
    return (ends | {"grows": lambda: len(np.ones(100_000_000))})[way]()


@pytest.mark.parametrize(
    ("way", "told"),
    [
        ("dies", "crashes"),
        ("fails", "division by zero"),
        ("hangs", "not end"),
        pytest.param("grows", r"more than 0\.5 GB of memory", marks=forks),
    ],
)
def test_work_done_apart_takes_no_other_process_with_it(way, told):
    assert apart(ends, "answer", 30.0, HALF_GB) != os.getpid()
    with pytest.raises(RuntimeError, match=told):
        apart(ends, way, 0.5 if way == "hangs" else 30.0, HALF_GB)
    assert not multiprocessing.active_children()


@forks
@pytest.mark.slow
def test_kernels_are_compiled_ahead_and_not_again(tmp_path, monkeypatch):
    cache = without_kernels(tmp_path / "cache")
    monkeypatch.setenv("BAYES_DAMPER_CACHE", str(cache))
    monkeypatch.setattr("bayes_damper.simulation.precompile.cores", lambda: 2)
    variants = [
        EFFECTS[name].variants[0] for name in ("quadratic_drag", "spring_cubic", "bearing_stribeck", "magnet_cubic")
    ]
    models = [Model(False, effect=variant) for variant in variants]
    told = []
    wanted = {
        specialised.kernel_file(model.bound()).stem for model in models
    }  # what acts on both bodies alone is nothing
    assert compile_ahead([*models, *models], report=told.append) == len(wanted) == 4
    assert len(told) == 1
    assert {path.name.split(".")[0] for path in (cache / "__pycache__").glob("advance_*.nbi")} == wanted
    assert compile_ahead(models, report=told.append) == 0
    assert len(told) == 1
    kernel = specialised.specialise(models[0].bound())
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert sum(kernel.stats.cache_misses.values()) == 0


@forks
def test_a_halted_process_that_compiles_stops_no_other(tmp_path):
    """The system frees the lock of a dead process, not that of one that is halted; a run then waited for ever."""
    lock = tmp_path / "compiling.lock"
    said = []
    with _alone(lock, lambda: 3, said.append):
        assert said == []
        left = iter([3, 2, 2])  # one kernel arrives while the other waits
        with _alone(lock, lambda: next(left, 2), said.append, patience=0.3):
            assert said == ["waiting for another run on this machine, which compiles the same code"]
        with _alone(lock, lambda: 0, said.append):  # all have arrived: no wait
            assert len(said) == 1


def test_a_loop_is_compiled_where_nothing_can_be_kept(tmp_path):
    """In a file that does not exist numba finds no place for machine code."""
    source = "def double(x):\n    for i in range(x.size):\n        x[i] *= 2.0\n"
    space: dict = {}
    exec(compile(source, "<nowhere>", "exec"), space)
    x = np.arange(3.0)
    compiled()(space["double"])(x)
    np.testing.assert_array_equal(x, [0.0, 2.0, 4.0])


@forks
def test_a_run_that_is_stopped_as_a_process_starts_leaves_none_behind():
    code = (
        "import multiprocessing, os, signal, time\n"
        "from multiprocessing.context import ForkProcess\n"
        "from bayes_damper.runs.parallel_map import forked_map\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "start = ForkProcess.start\n"
        "def stopped(self):\n"
        "    start(self)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "ForkProcess.start = stopped\n"
        "try:\n"
        "    forked_map(lambda x: time.sleep(60), range(4), 2)\n"
        "except KeyboardInterrupt:\n"
        "    print('stopped', multiprocessing.active_children(), flush=True)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50, check=True)
    assert done.stdout == "stopped []\n"


@forks
def test_a_stopped_run_leaves_no_process_behind(tmp_path):
    """Interrupted by one of its processes while both work, it ends, and they with it."""
    code = (
        "import os, pathlib, signal, sys, time\n"
        "from bayes_damper.runs.parallel_map import forked_map\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background jobs begin deaf to it
        "begun = pathlib.Path(sys.argv[1])\n"
        "def work(x):\n"
        "    os.write(1, f'{os.getpid()}\\n'.encode())\n"  # at once: two processes write here
        "    if x == 0:\n"
        "        begun.touch()\n"
        "    while not begun.exists():\n"
        "        time.sleep(0.01)\n"
        "    if x == 1:\n"
        "        os.kill(os.getppid(), signal.SIGINT)\n"
        "    time.sleep(60)\n"
        "try:\n"
        "    forked_map(work, range(4), 2)\n"
        "except KeyboardInterrupt:\n"
        "    print('stopped', flush=True)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "begun")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, check=True)
    *pids, last = done.stdout.split()
    assert last == "stopped"
    assert len(pids) == 2
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_linear_algebra_of_a_task_has_one_thread_and_of_others_what_it_had():
    given = os.environ | {"OMP_NUM_THREADS": "2"}
    shown = subprocess.run([sys.executable, "-c", THREADS], env=given, capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["2", "[1,", "1,", "1]", "2"]


def test_a_function_keeps_its_name_and_its_answer():
    @single_threaded
    def work(x: float, *, times: int) -> float:
        """Documented."""
        return x * times

    assert work(2.0, times=3) == 6.0
    assert (work.__name__, work.__doc__) == ("work", "Documented.")
