"""Dead objects are looked for seldom while a command runs, and not at all when the process ends."""

from __future__ import annotations

import gc
import subprocess
import sys

from bayes_damper.runs.memory import SELDOM, seldom_collected


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
