"""Folders of results damaged in many ways, read by each command that reads them: sentences and silence, nothing else.

Silence is right wherever a command shows what a file says without using it, or does not need the damaged entry: it has
no other copy to compare with. What is asked here is that nothing ends in a traceback, hangs, or fills the memory.
"""

from __future__ import annotations

import damage
import damaged_files
import pytest

QUICK = {"compare": 120, "tune": 40, "report": 60, "resume": 3}
"""One damage in so many is tried by the quick test: the commands take from a millisecond to a second."""
LEAST_TOLD = {"compare": 0.05, "tune": 0.05, "report": 0.03, "resume": 0.2}
"""Share of damages that is told at least; run.json and summary.json hold much that a command does not use."""


@pytest.mark.parametrize("share", [pytest.param(1, id="quick"), pytest.param(4, id="more", marks=pytest.mark.slow)])
def test_damaged_results_are_told(tmp_path, share):
    seen = 0
    for target in damaged_files.results_targets(tmp_path):
        target.call()
        outcome = damage.Outcome()
        damage.run(target.folder, target.damages[:: max(1, QUICK[target.name] // share)], target.call, outcome)
        faults = [f"{target.name}: {case}\n{told}" for case, told in outcome.faults.items()]
        assert not faults, "\n".join(faults[:5])
        assert len(outcome.told) >= LEAST_TOLD[target.name] * outcome.cases
        target.call()
        seen += outcome.cases
    assert seen > 150


def test_every_kind_of_damage_to_a_posterior_is_survived(tmp_path):
    """Files of HDF5 that point elsewhere, claim petabytes or hold themselves: `tune` says so, at once."""
    target = next(t for t in damaged_files.results_targets(tmp_path) if t.name == "tune")
    kinds = [d for d in target.damages if d.file.endswith(".nc") and not d.name.startswith("bytes changed")]
    outcome = damage.Outcome()
    damage.run(target.folder, kinds, target.call, outcome)
    assert not outcome.faults, outcome.faults
    for name in ("a link to another file", "readings elsewhere", "a petabyte of nothing", "a gigabyte of nothing"):
        assert any("damaged, or not what" in s for s in outcome.told[f"IV/posterior.nc: {name}"]), name
    assert outcome.silent
