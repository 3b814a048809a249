"""The command line: every command explains itself, errors are sentences with the right exit code."""

from __future__ import annotations

import json

import pytest

from bayes_damper.cli import main

COMMANDS = (
    "demo",
    "examples",
    "check",
    "simulate",
    "fit",
    "resume",
    "diagnose",
    "tune",
    "bench",
    "init",
    "report",
    "thesis",
    "variability",
    "compare",
    "plan",
    "withheld",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "--seed" in text
    assert "--quiet" in text


def test_check_of_the_thesis(capsys):
    assert main(["check", "thesis"]) == 0
    assert "24 published measurements" in capsys.readouterr().out
    assert main(["check", "thesis", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "bayes-damper/check/1"


def test_quiet_says_nothing(capsys, tmp_path):
    assert main(["simulate", "--quiet", "--out", str(tmp_path / "F.csv")]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "nowhere"],
        ["fit", "nowhere"],
        ["fit", "thesis", "--case", "V"],
        ["resume", "nowhere"],
        ["diagnose", "nowhere"],
        ["simulate", "--set", "muu=1", "--out", "F.csv"],
        ["tune", "nowhere"],
    ],
)
def test_bad_input_is_a_sentence_and_exit_code_2(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"bayes-damper {arguments[0]}: ")
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["fit", "thesis", "--out", "file"], "file: File exists; choose another place, e.g. with --out"),
        (["resume", "old"], "run.json: holds no plan of this version: campaign is missing; fit anew"),
        (["tune", "old", "--case", "IV"], "has not ended; go on with: bayes-damper resume old"),
        (["resume", "old", "--more"], "holds no plan of this version"),
        (["init", "new", "file"], "file: holds no row of numbers; name a file of the logger"),
        (["fit", "thesis", "--seed", "-1"], "argument --seed: -1: give a whole number, at least 0"),
        (["fit", "thesis", "--workers", "0"], "argument --workers: 0: give a whole number, at least 1"),
        (["simulate", "--out", "F.toml"], "--out F.toml: the values used go to that name"),
        (["bench", "--repeats", "many"], "argument --repeats: many: give a whole number, at least 1"),
    ],
)
def test_what_cannot_be_done_is_told_without_a_traceback(arguments, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "run.json").write_text('{"command": "fit", "plan": {}}')
    try:
        code = main(arguments)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("number", ["-1e-3", "-.5E-3", "-2", "0"])
def test_numbers_below_zero_are_told_in_a_sentence(number, capsys, tmp_path):
    """However they are written: argparse itself takes -1e-3 for an option."""
    assert main(["tune", str(tmp_path), "--secondary-inertia", number]) == 2
    assert capsys.readouterr().err.startswith(f"bayes-damper tune: J2 = {float(number):g}: a design needs a J2 above")


def test_an_unknown_command_is_refused():
    with pytest.raises(SystemExit) as ended:
        main(["fly"])
    assert ended.value.code == 2
