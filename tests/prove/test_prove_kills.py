"""Killed at any moment, a fit loses nothing: what `resume` ends with is bit for bit what an uninterrupted fit gives."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from functools import partial
from pathlib import Path

import numpy as np
import pages
import parts
import pytest
from test_fit import _campaign

from bayes_damper import arviz_adapter
from bayes_damper.fit import fit
from bayes_damper.resume import resume

KILLS = 50
AT_MOST = 8  # kills of one fit
STEPS = 300


def _begin(campaign: Path, folder: Path) -> None:
    """A fit in `folder`, or what is left of it."""
    if (folder / "run.json").exists():
        resume(folder)
    else:
        fit(campaign, out=folder, seed=5, most_steps=STEPS, joint=False)


def _spawned(campaign: Path, folder: Path) -> multiprocessing.process.BaseProcess:
    child = multiprocessing.get_context("fork").Process(target=_begin, args=(campaign, folder))
    child.start()
    return child


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The campaign, the folder of a fit that nothing disturbed, and the seconds that it took."""
    home = tmp_path_factory.mktemp("kills")
    campaign = _campaign(home / "campaign", duration=0.15)
    _begin(campaign, home / "warm")  # kernels compiled, caches filled
    begun = time.monotonic()
    child = _spawned(campaign, home / "whole")
    child.join()
    assert child.exitcode == 0
    return campaign, home / "whole", time.monotonic() - begun


def _life(campaign: Path, whole: Path, seconds: float, tmp_path: Path, number: int) -> dict[str, object]:
    """One fit, killed again and again at moments drawn evenly over the time that a whole fit takes."""
    rng = np.random.default_rng([50, number])
    folder = tmp_path / f"life-{number}"
    moments: list[float] = []
    while True:
        child = _spawned(campaign, folder)
        moment = float(rng.uniform(0.0, seconds)) if len(moments) < AT_MOST else None
        child.join(moment)
        if child.exitcode is None:
            os.kill(child.pid, signal.SIGKILL)
            child.join()
            moments.append(round(moment, 3))
        else:
            assert child.exitcode == 0
            return {"kills": moments, "seconds": round(seconds, 1), "different": _differences(whole, folder)}


def _differences(one: Path, other: Path) -> list[str]:
    """Files whose content differs, where it is not about time or place."""
    names = sorted(p.relative_to(one).as_posix() for p in one.rglob("*") if p.suffix in (".csv", ".svg", ".png"))
    different = [n for n in names if (one / n).read_bytes() != (other / n).read_bytes()]
    a, b = (json.loads((folder / "summary.json").read_text()) for folder in (one, other))
    for summary in (a, b):
        del summary["provenance"]
        for entry in summary["cases"].values():
            del entry["sentences"]  # they tell the pace
    different += [] if a == b else ["summary.json"]
    for name in sorted(p.relative_to(one).as_posix() for p in one.rglob("*.nc")):
        first, second = arviz_adapter.read(one / name), arviz_adapter.read(other / name)
        for group, node in first.children.items():
            for variable, values in node.data_vars.items():
                if not np.array_equal(
                    values.values, second[group][variable].values, equal_nan=values.dtype.kind == "f"
                ):
                    different.append(f"{name}: {group}/{variable}")
    return different


@pytest.mark.prove
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_fifty_kills_change_no_bit(uninterrupted, tmp_path):
    count, results = 0, []
    while sum(len(r["kills"]) for r in results) < KILLS:
        count += 1
        results = parts.finish("kills", count, partial(_life, *uninterrupted, tmp_path))
    pages.kills(results)
    assert [r["different"] for r in results] == [[]] * len(results)
