"""The check on a real Dask scheduler with worker processes of its own; one of them is killed in mid-run."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_check import calls, run, write_set

ROOT = Path(__file__).resolve().parents[3]

pytest.importorskip("distributed", reason="needs the extra `cluster`")


def wait_for(path, what, seconds=60.0):
    """Waits until a file is there and holds something."""
    until = time.monotonic() + seconds
    while not (path.exists() and path.read_text().strip()):
        assert time.monotonic() < until, f"{what} did not start"
        time.sleep(0.1)


@pytest.mark.slow
def test_a_cluster_gives_what_one_process_gives_though_a_worker_is_killed(tmp_path):
    truths = ["none", "spring_cubic", "sensor_gain", "stick_slip"]
    for home, deadly in ((tmp_path / "one", None), (tmp_path / "many", "c02")):
        home.mkdir()
        write_set(home, truths, deadly=deadly)
    told = tmp_path / "scheduler.json"
    environment = {
        **os.environ,
        "PYTHONPATH": f"{ROOT / 'tests'}{os.pathsep}{ROOT}",
    }
    started = []

    def start(*command):
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + command[0], *command[1:]],
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )

    try:
        start("dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(told))
        wait_for(told, "the scheduler")
        start(
            "dask_worker", "--scheduler-file", str(told), "--nworkers", "2", "--nthreads", "1", "--nanny",
            "--no-dashboard", "--local-directory", str(tmp_path / "scratch"),
        )  # fmt: skip
        address = json.loads(told.read_text())["address"]
        many = run(tmp_path / "many", "dies_once", scheduler=address)
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(20)
    alone = run(tmp_path / "one", "dies_once")
    assert not (tmp_path / "many/c02.deadly").exists(), "no worker was killed"
    assert set(calls(tmp_path / "many")) == {"c00", "c01", "c02", "c03"}
    assert many.results["scores"] == alone.results["scores"]
