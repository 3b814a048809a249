"""The command line: every command explains itself, errors are sentences with the right exit code."""

from __future__ import annotations

import json

import pytest

from bayes_damper.cli import main

COMMANDS = (
    "demo",
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


def test_an_unknown_command_is_refused():
    with pytest.raises(SystemExit) as ended:
        main(["fly"])
    assert ended.value.code == 2
