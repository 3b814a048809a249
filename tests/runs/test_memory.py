"""Dead objects are looked for seldom while a command runs, and not at all when the process ends."""

from __future__ import annotations

import gc
import math
import subprocess
import sys

import pytest

from bayes_damper.runs.memory import BASE, PER_READING, SELDOM, free_bytes, group_bytes, seldom_collected, shortage


def test_the_thresholds_are_put_back():
    before = gc.get_threshold()
    with seldom_collected():
        assert gc.get_threshold() == SELDOM
    assert gc.get_threshold() == before


def test_nothing_is_looked_at_when_the_process_ends():
    script = (
        "import atexit, gc\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 1000))\n"
        "from bayes_damper.runs.memory import seldom_collected\n"
        "with seldom_collected(), seldom_collected():\n"
        "    kept = [[] for _ in range(2000)]\n"
        "print(gc.get_freeze_count() > 1000)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["False", "True"]


def test_a_campaign_that_needs_more_memory_than_is_free_gets_a_sentence_before_it_begins():
    needed = BASE + 500_000 * PER_READING
    assert shortage(500_000, left=1.01 * needed) == ""
    told = shortage(500_000, left=0.5e9)
    assert told.startswith("500000 readings take about 1.5 GB of memory, and 0.5 GB are free")
    assert "`every = 2`" in told


def test_a_limit_on_the_address_space_counts_as_what_is_free():
    assert free_bytes() > 1e6
    script = (
        "import resource\n"
        "from bayes_damper.runs.memory import free_bytes\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3_000_000_000, resource.RLIM_INFINITY))\n"
        "print(free_bytes() <= 3_000_000_000)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "True"


@pytest.mark.parametrize(
    ("line", "top", "limit", "used", "none"),
    [
        ("0::/job", "sys/fs/cgroup", "memory.max", "memory.current", "max"),
        ("4:memory:/job", "sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", str(2**63 - 4096)),
    ],
)
def test_the_limit_of_a_container_counts_as_what_is_free(tmp_path, line, top, limit, used, none):
    assert group_bytes(tmp_path) == math.inf
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(f"9:cpuset:/\n{line}\n")
    outer = tmp_path / top
    (outer / "job").mkdir(parents=True)
    for folder, most in ((outer, "3000000000"), (outer / "job", none)):
        (folder / limit).write_text(f"{most}\n")
        (folder / used).write_text("1000000000\n")
        (folder / "memory.stat").write_text("anon 5\ninactive_file 400000000\nactive_file 7\n")
    assert group_bytes(tmp_path) == 2.4e9  # of the group above; that of the job itself has no limit
    (outer / "job" / limit).write_text("1500000000\n")
    assert group_bytes(tmp_path) == 0.9e9
