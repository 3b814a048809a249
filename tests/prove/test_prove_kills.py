"""Killed at any moment, a fit loses nothing: what `resume` ends with is bit for bit what an uninterrupted fit gives.

The sampler is killed by itself too, while it saves its state ten times a second: what a fit does every few seconds.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pages
import parts
import pytest
from test_entry import _campaign

from bayes_damper.commands.resume import resume
from bayes_damper.fit import fit
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling import Start, StoppingRule, arviz_adapter, sample

KILLS = 50
AT_MOST = 10  # kills of one run
SOON = 1.0 / 3.0
"""Share of the time of a whole run within which it is killed, from each start on: what is resumed takes up late."""
STEPS = 100


def _begin(campaign: Path, folder: Path) -> None:
    """A fit in `folder`, or what is left of it."""
    if (folder / "run.json").exists():
        resume(folder)
    else:
        fit(campaign, out=folder, seed=5, most_steps=STEPS, joint=False)


def _spawned(run: Callable[[Path], None], folder: Path) -> multiprocessing.process.BaseProcess:
    child = multiprocessing.get_context("fork").Process(target=run, args=(folder,))
    child.start()
    return child


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The campaign, the folder of a fit that nothing disturbed, and the seconds that it took."""
    home = tmp_path_factory.mktemp("kills")
    campaign = _campaign(home / "campaign", duration=0.15)
    _begin(campaign, home / "warm")  # kernels compiled, caches filled
    begun = time.monotonic()
    child = _spawned(partial(_begin, campaign), home / "whole")
    child.join()
    assert child.exitcode == 0
    return partial(_begin, campaign), home / "whole", time.monotonic() - begun


def _life(
    run: Callable[[Path], None],
    whole: Path,
    seconds: float,
    differences: Callable[[Path, Path], list[str]],
    home: Path,
    number: int,
) -> dict[str, object]:
    """One run, killed again and again; with each moment the last file that had been written."""
    rng = np.random.default_rng([50, number])
    folder = home / f"life-{number}"
    moments: list[float] = []
    last: list[str] = []
    while True:
        child = _spawned(run, folder)
        moment = float(rng.uniform(0.0, SOON * seconds)) if len(moments) < AT_MOST else None
        child.join(moment)
        if child.exitcode is None:
            os.kill(child.pid, signal.SIGKILL)
            child.join()
            moments.append(round(moment, 3))
            last.append(_latest(folder))
        else:
            assert child.exitcode == 0
            told = {"kills": moments, "after": last, "seconds": round(seconds, 1)}
            return {**told, "different": differences(whole, folder)}


def _latest(folder: Path) -> str:
    """Name of the last file that a killed run has written, states without their number."""
    files = [p for p in folder.rglob("*") if p.is_file()]
    name = max(files, key=lambda p: p.stat().st_mtime_ns).name if files else "nothing"
    return re.sub(r"-?\d{3,}", "", name)


def _until_fifty(name: str, task: Callable[[int], dict[str, object]]) -> list[dict[str, object]]:
    """As many runs as it takes to be killed fifty times."""
    results: list[dict[str, object]] = []
    while sum(len(r["kills"]) for r in results) < KILLS:
        results = parts.finish(name, len(results) + 1, task, by_chance=True)
    return results


def _differences(one: Path, other: Path) -> list[str]:
    """Files whose content differs, where it is not about time or place; matplotlib numbers clips in SVG files anew."""
    names = sorted(p.relative_to(one).as_posix() for p in one.rglob("*") if p.suffix in (".csv", ".png"))
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
def test_fifty_kills_of_a_fit_change_no_bit(uninterrupted, tmp_path):
    run, whole, seconds = uninterrupted
    results = _until_fifty("kills", partial(_life, run, whole, seconds, _differences, tmp_path))
    pages.kills()
    assert [r["different"] for r in results] == [[]] * len(results)


# The sampler by itself ----------------------------------------------------------------------------------------------


class _Banana:
    """A bent density in four dimensions."""

    names = ("a", "b", "c", "d")
    ndim = 4

    def __call__(self, points):
        a, b, c, d = points.T
        return -0.5 * (a**2 + (b - a**2) ** 2 / 0.3 + c**2 / 4.0 + (d - c) ** 2)


def _draw(folder: Path) -> None:
    """Draws of the banana into `folder`, going on from the state that is there."""
    start = Start(np.zeros(4), np.diag([1.0, 2.0, 4.0, 5.0]), 0.0, 1)
    rule = StoppingRule(ess=1e9, max_steps=600)
    sampling = sample(
        _Banana(), start, seed=11, rule=rule, checkpoint=Checkpoint(folder, {"proof": "kills"}, every=0.1)
    )
    np.save(folder / "unfinished.npy", sampling.draws)
    (folder / "unfinished.npy").rename(folder / "draws.npy")


def _draws_differ(one: Path, other: Path) -> list[str]:
    same = np.array_equal(np.load(one / "draws.npy"), np.load(other / "draws.npy"))
    return [] if same else ["draws"]


@pytest.mark.prove
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_fifty_kills_of_the_sampler_change_no_bit(tmp_path):
    _draw(tmp_path / "warm")
    begun = time.monotonic()
    child = _spawned(_draw, tmp_path / "whole")
    child.join()
    seconds = time.monotonic() - begun
    assert child.exitcode == 0
    task = partial(_life, _draw, tmp_path / "whole", seconds, _draws_differ, tmp_path)
    results = _until_fifty("kills-sampler", task)
    pages.kills()
    assert [r["different"] for r in results] == [[]] * len(results)
