"""Workers of long runs: they end with the process that started them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayes_damper.commands.diagnose import diagnose
from bayes_damper.errors import InputError
from bayes_damper.runs.execution import claim
from bayes_damper.runs.json_files import read_json, write_json

ENDLESS = """
import os, time
from pathlib import Path

def endless(folder, report):
    (folder / "pid").write_text(str(os.getpid()))
    while True:
        time.sleep(0.05)
        (folder / "alive").write_text("yes")
"""
RUN = """
from pathlib import Path
from endless import endless
from bayes_damper.runs.execution import Task, run_tasks
run_tasks([Task(n, endless) for n in ("a", "b")], Path("out"), workers=2)
"""


def python(folder, **files):
    """What starts Python in a folder with modules of these names, which it can import beside the package."""
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    root = str(Path(__file__).resolve().parents[2])
    return {"cwd": folder, "env": os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), root])}}


SCRIPT = """
from counted import count
from bayes_damper.runs.execution import Task, run_tasks
print(run_tasks([Task(n, count) for n in ("a", "b")], __import__("pathlib").Path("out"), workers=2))
"""


@pytest.mark.parametrize("given", ["a file", "standard input"])
def test_a_script_without_a_guard_is_not_run_again_by_its_workers(tmp_path, given):
    where = python(tmp_path, counted="def count(folder, report):\n    return len(folder.name)\n", go=SCRIPT)
    command = [sys.executable, "go.py" if given == "a file" else "-"]
    ran = subprocess.run(command, **where, input=SCRIPT, capture_output=True, text=True, timeout=60, check=False)
    assert ran.stdout.splitlines() == ["{'a': 1, 'b': 1}"], ran.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_workers_end_when_their_parent_is_killed(tmp_path):
    parent = subprocess.Popen([sys.executable, "go.py"], **python(tmp_path, endless=ENDLESS, go=RUN))
    alive = [tmp_path / "out" / name / "alive" for name in ("a", "b")]
    try:
        _until(lambda: all(path.exists() for path in alive), 60.0)
    finally:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()

    def still() -> bool:
        before = [path.stat().st_mtime_ns for path in alive]
        time.sleep(0.5)
        return before == [path.stat().st_mtime_ns for path in alive]

    try:
        _until(still, 20.0)
    finally:
        for name in ("a", "b"):
            with contextlib.suppress(ProcessLookupError):
                os.kill(int((tmp_path / "out" / name / "pid").read_text()), signal.SIGKILL)


CREW = """
import time
from bayes_damper.runs.execution import processes

def short(folder, report):
    return processes()

def long(folder, report):
    seen, end = [processes()], time.monotonic() + 60.0
    while seen[-1] < 3 and time.monotonic() < end:
        time.sleep(0.05)
        seen.append(processes())
    return sorted(set(seen))
"""
RUN_CREW = """
from pathlib import Path
from crew import long, processes, short
from bayes_damper.runs.execution import Task, run_tasks
found = run_tasks([Task("long", long), Task("a", short), Task("b", short)], Path("out"), workers=3)
print(found["long"], processes())
"""


@pytest.mark.slow
def test_the_last_task_may_use_the_workers_of_all(tmp_path):
    """From one of three to all three; outside a worker a task has its own process alone."""
    where = python(tmp_path, crew=CREW, go=RUN_CREW)
    done = subprocess.run([sys.executable, "go.py"], **where, capture_output=True, text=True, check=True)
    assert done.stdout.split() in (["[1,", "3]", "1"], ["[3]", "1"]), done.stdout


FLEET = """
import os

def process(folder, report):
    return os.getpid()

def wrong(folder, report):
    raise ValueError("this one is wrong")
"""
RUN_FLEET = """
from pathlib import Path
from fleet import process, wrong
from bayes_damper.runs import execution
from bayes_damper.runs.execution import Task, run_tasks
execution._TASKS_OF_A_WORKER = 2
tasks = [Task(f"t{i}", process) for i in range(5)]
print(len(set(run_tasks(tasks, Path("out"), workers=1).values())))
try:
    run_tasks([Task("bad", wrong), *tasks], Path("other"), workers=1)
except ValueError as error:
    print(error, *sorted(path.parent.name for path in Path("other").glob("*/done.json")))
"""


def test_workers_of_many_tasks_are_started_anew_and_an_error_waits_for_all(tmp_path):
    """What they have loaded is given back; five tasks, two for each process."""
    where = python(tmp_path, fleet=FLEET, go=RUN_FLEET)
    done = subprocess.run([sys.executable, "go.py"], **where, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["3", "this one is wrong t0 t1 t2 t3 t4"]


def test_files_hold_null_where_a_number_is_not_finite(tmp_path):
    """Nothing that a long run found is lost to a single number that JSON cannot hold."""
    found = {"x": np.array([1.0, np.nan]), "y": {"z": (np.float64(np.inf), 2)}, "n": np.int64(3)}
    write_json(tmp_path / "new" / "a.json", found)
    assert read_json(tmp_path / "new" / "a.json") == {"x": [1.0, None], "y": {"z": [None, 2]}, "n": 3}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.json"]


def _until(condition, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_results_do_not_go_into_the_folder_of_a_campaign(tmp_path):
    (tmp_path / "campaign.toml").write_text('name = "cart"\n')
    with pytest.raises(InputError, match="holds a campaign, and results do not go beside it; name another --out"):
        claim(tmp_path, {"command": "fit", "plan": {}}, 1)
    with pytest.raises(InputError, match="holds a campaign"):
        diagnose(tmp_path / "other", out=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]
