"""Campaigns, priors, import tables and options damaged in thousands of ways: a sentence each, or a reason for silence.

Quick: every fourteenth way; slow: every third; tests/prove/test_prove_damage.py: all of them.
"""

from __future__ import annotations

import resource

import damage
import damaged_files
import pytest

MOST_KB = 1_000_000


def judged(outcome: damage.Outcome, least: int) -> None:
    """Nothing but sentences, reasons for silence, and little memory."""
    assert outcome.cases >= least
    assert not outcome.faults, "\n".join(f"{case}\n{told}" for case, told in list(outcome.faults.items())[:5])
    assert not damage.unexplained(outcome.silent, damaged_files.SILENT)
    assert len(outcome.told) > 0.7 * outcome.cases, "most damage is to be told"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < max(MOST_KB, outcome.began_kb + MOST_KB // 2)


STEPS = [pytest.param(14, id="quick"), pytest.param(3, id="third", marks=pytest.mark.slow)]


@pytest.mark.parametrize("step", STEPS)
def test_damaged_campaigns_are_told(tmp_path, step):
    outcome = damage.Outcome()
    for target in damaged_files.campaign_targets(tmp_path):
        target.call()
        damage.run(target.folder, target.damages[::step], target.call, outcome)
    judged(outcome, 3500 // step)


@pytest.mark.parametrize("step", STEPS)
def test_damaged_imports_are_told(tmp_path, step):
    outcome = damage.Outcome()
    for target in damaged_files.import_targets(tmp_path / "raw"):
        target.call()
        damage.run(target.folder, target.damages[1::step], target.call, outcome)
    judged(outcome, 1900 // step)


@pytest.mark.parametrize("step", STEPS)
def test_damaged_files_of_loggers_are_told(tmp_path, step):
    outcome = damage.Outcome()
    targets = list(damaged_files.logger_targets(tmp_path / "raw"))
    for target in targets:
        target.call()
        own = [
            d for d in target.damages if "nothing" in d.name or "pipe" in d.name or "itself" in d.name
        ]  # memory, a hang, a loop
        damage.run(target.folder, [*own, *target.damages[min(3, step - 1) :: step]], target.call, outcome)
    judged(outcome, 260 // step)


@pytest.mark.parametrize("step", STEPS)
def test_odd_words_on_the_command_line_are_told(tmp_path, step):
    outcome = damage.Outcome()
    damaged_files.spoken(damaged_files.command_line(tmp_path / "good"))
    for name, call in list(damaged_files.command_line_calls(tmp_path / "raw"))[1 :: 3 * step]:
        damage.tried(call, name, outcome)
    judged(outcome, 800 // step)


@pytest.mark.parametrize("step", STEPS)
def test_odd_options_are_told(tmp_path, step):
    outcome = damage.Outcome()
    for name, call in list(damaged_files.option_calls(tmp_path / "raw"))[2::step]:
        damage.tried(call, name, outcome)
    judged(outcome, 1500 // step)


def test_a_fault_of_ours_would_be_seen(tmp_path):
    """An error that is no sentence, a call without an end and an empty sentence are faults; other calls are not."""
    from bayes_damper.errors import InputError

    def loops() -> None:
        while True:
            pass

    def raises(error: Exception) -> None:
        raise error

    outcome = damage.Outcome()
    damage.tried(lambda: raises(ValueError("x")), "a traceback", outcome)
    damage.tried(loops, "a loop", outcome, seconds=0.2)
    damage.tried(lambda: raises(InputError(" ")), "no words", outcome)
    damage.tried(lambda: raises(InputError("Wrong here; do that")), "a sentence", outcome)
    damage.tried(lambda: None, "nothing", outcome)
    assert set(outcome.faults) == {"a traceback", "a loop", "no words"}
    assert outcome.silent == ["nothing"]
    assert damage.unexplained(["nothing"], damaged_files.SILENT) == ["nothing"]
