"""Campaigns, priors, import tables and options damaged in thousands of ways: a sentence each, or a reason for silence.

Quick: every fourteenth way; slow: all of them.
"""

from __future__ import annotations

import resource

import damage
import damaged_files
import pytest

MOST_KB = 1_000_000
WORDS = r"name|description|source|caveats"
SILENT = [
    (rf"(toml: ({WORDS}|case|file|reason|level) = )|(without line \d+, ({WORDS}))", "words are the user's own"),
    (r"without (line|column)", "a key or a column that may be left out"),
    (r"lines of (an old Mac|Windows)|a lone return|line separators|form feeds", "lines may end in any way"),
    (
        r"UTF-16|two marks of byte order|a byte of 0 at its end",
        "a logger's file may be so; what is left out is a caveat",
    ),
    (r"one.txt: (cut at|a line of 300 000|semicolons|bytes changed)", "a shorter recording, or a foot below it"),
    (r"trials/.*: (cut at|one row|the head|bytes changed)|priors.toml: cut at", "what is left is whole"),
    (r"trials.csv: one row", "one trial is a campaign"),
    (r"= '(1_0|true|rest)'", "TOML writes 10 so, and these words are valid"),
    (r"= '(-1|-1e-9|0|0.0|\{ value = 1.0 \})'", "within what the key may be"),
    (r"= '\[(1, 2, 3|1.0, -1.0|\"a\"|)\]'", "within what the key may be"),
    (r"row \d+, (case|trial|holdout|file) = ", "a label of the user's own"),
    (r"row \d+, \w+ = '(0|1|-1|1\.5|0x10|true|\\?\"1\\?\"|nan| )?'", "within what the column may be"),
    (r"row \d+, \w+ = '(1e-308|\"1\"|-1|0|1\.5)'", "a reading may be so"),
    (r"priors.toml: (missing|empty|blank|a link to nothing)", "a campaign needs no priors of its own"),
    (r"rows reversed|twice|renamed|no line ends|commas|column \w+ (twice|renamed)", "still says what is needed"),
    (r"bytes changed", "another digit or letter is not told from the one meant"),
    (r"priors.toml: ", "a prior is what its author holds likely"),
    (r"trials.csv: row \d+, \w+ = ", "a value of its own that the records do not contradict"),
    (r"one.h5: (a link to another file|a soft link|a group within itself|words|complex)", "left out beside readings"),
    (r"one.h5: a line of 300 000", "HDF5 knows where it ends"),
    (r"one.json: log\.\d(\.\w)? = (absent|null|NaN|\{)", "a reading may be missing"),
    (r"one.json: log\.\d\.\w = (-1|0|true)", "a reading may be so; true is 1"),
    (r"option ", "the option says what it says"),
]
"""Pattern of damages that may pass in silence, and why that is right."""


def judged(outcome: damage.Outcome, least: int) -> None:
    """Nothing but sentences, reasons for silence, and little memory."""
    assert outcome.cases >= least
    assert not outcome.faults, "\n".join(f"{case}\n{told}" for case, told in list(outcome.faults.items())[:5])
    assert not damage.unexplained(outcome.silent, SILENT)
    assert len(outcome.told) > 0.7 * outcome.cases, "most damage is to be told"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < max(MOST_KB, outcome.began_kb + MOST_KB // 2)


STEPS = [pytest.param(14, id="quick"), pytest.param(1, id="all", marks=pytest.mark.slow)]


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
    assert damage.unexplained(["nothing"], SILENT) == ["nothing"]
