"""The command line: every command explains itself, errors are sentences with the right exit code."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from bayes_damper import cli
from bayes_damper.cli import _parser, main
from bayes_damper.commands.check import Check
from bayes_damper.errors import InputError

COMMANDS = next(a.choices for a in _parser()._actions if a.dest == "command")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "--seed" in text
    assert "--quiet" in text
    silent = [a.dest for a in COMMANDS[command]._actions if not a.help]
    assert not silent, f"{command}: {', '.join(silent)} needs help=, which the reference of commands is made of"


def test_the_bare_command_shows_what_there_is(capsys):
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(command in text for command in ("check", "diagnose"))


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
        (["fit", "thesis", "--seed", "1" * 29], "give a whole number, at least 0 and of 18 digits"),
        (["init", "new", "old"], "old: a folder, not a file; say where the raw files are"),
        (["fit", "thesis", "--workers", "0"], "argument --workers: 0: give a whole number, at least 1"),
        (["simulate", "--out", "F.toml"], "--out F.toml: the values used go to that name"),
        (["bench", "--repeats", "many"], "argument --repeats: many: give a whole number, at least 1"),
        (["fit", "thesis", "--effect", "a+b", "--effect", "c"], "takes one effect, or two at once; leave out 1 of"),
        (["fit", "thesis", "--effect", "a", "--effect", "a"], "--effect a --effect a: this is the same effect twice"),
        (["fit", "thesis", "--out", "a", "--out", "b"], "argument --out: given twice, as a and as b; give it once"),
        (["simulate", "--effect", "a", "--effect", "b"], "argument --effect: given twice, as a and as b; give it once"),
        (["init", "new", "--columns", "1", "--columns", "2", "3"], "argument --columns: given twice, as 1 and as 2 3;"),
        (["init", "new", "--sign", "1", "-1", "--sign", "1"], "argument --sign: given twice, as 1 -1 and as 1; give"),
        (
            ["init", "new", "--sensor-range", "1", "--sensor-range", "2"],
            "argument --sensor-range: given twice, as 1 and",
        ),
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


def test_an_option_may_be_given_twice_alike_and_those_of_several_values_as_often_as_one_likes():
    several = ["--case", "I", "--case", "II", "--effect", "a", "--effect", "b"]
    args = _parser().parse_args(["fit", "rig", "--seed", "3", "--seed", "3", "--out", "a", *several, "--out", "a"])
    assert (args.seed, args.case, args.effect) == (3, ["I", "II"], ["a", "b"])
    assert _parser().parse_args(["fit", "rig"]).effect is None


@pytest.mark.parametrize("number", ["-1e-3", "-.5E-3", "-2", "0"])
def test_numbers_below_zero_are_told_in_a_sentence(number, capsys, tmp_path):
    """However they are written: argparse itself takes -1e-3 for an option."""
    assert main(["tune", str(tmp_path), "--secondary-inertia", number]) == 2
    assert capsys.readouterr().err.startswith(f"bayes-damper tune: J2 = {float(number):g}: a design needs a J2 above")


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (["--c2t", "-1"], "c2t = -1: a design cannot have a negative c2t"),
        (["--friction-torque", "-1"], "friction_torque = -1: a design cannot"),
        (["--friction-torque", "1", "--magnet-pull", "2"], "not both"),
    ],
)
def test_damping_and_friction_of_a_design_are_options(option, said, capsys, tmp_path):
    assert main(["tune", str(tmp_path), *option]) == 2
    assert said in capsys.readouterr().err


def test_what_the_search_of_tune_may_change_is_an_option(monkeypatch):
    given = {}
    monkeypatch.setattr("bayes_damper.tune", lambda *_, **options: given.update(options) or Check("", "", (), ""))
    assert main(["tune", "fit", "--free", "J2", "c2t"]) == 0
    assert given["free"] == ["J2", "c2t"]


def test_an_unknown_command_is_refused():
    with pytest.raises(SystemExit) as ended:
        main(["fly"])
    assert ended.value.code == 2


def _said_of(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["fti", "thesis"], "did you mean fit?"),
        (["fit", "thesis", "--efect", "stick_slip"], "--efect stick_slip; did you mean --effect?"),
        (["fit", "thesis", "--efect=stick_slip", "--sed=1"], "did you mean --effect, --seed?"),
        (["fit", "thesis", "--noise", "gausian"], "did you mean gaussian?"),
        (["diagnose", "thesis", "--nominal", "Linaer"], "did you mean linear?"),
        (["init", "rig", "a.csv", "--colums", "1"], "did you mean --columns?"),
    ],
)
def test_a_misspelt_word_of_the_command_line_is_told_what_it_may_mean(words, told, capsys):
    assert _said_of(words, capsys).rstrip().endswith(told)


def test_a_word_that_is_like_none_is_told_nothing(capsys):
    assert "did you mean" not in _said_of(["fit", "thesis", "--xyzzy", "--effect", "drag"], capsys)
    assert "did you mean" not in _said_of(["fit", "thesis", "--noise", "xyzzy"], capsys)


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_for_a_shell_names_every_command_and_option(capsys, shell):
    with pytest.raises(SystemExit, match="0"):
        main(["--print-completion", shell])
    script = capsys.readouterr().out
    assert all(word in script for word in ("diagnose", "variability", "prior-unknown", "most-steps", "mounting-radius"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_and_options(capsys):
    with pytest.raises(SystemExit):
        main(["--print-completion", "bash"])
    script = capsys.readouterr().out
    function = re.search(r"^complete .* -F (\S+) bayes-damper$", script, re.MULTILINE)[1]
    for words, wanted in ((("bayes-damper", "dia"), "diagnose"), (("bayes-damper", "fit", "--most"), "--most-steps")):
        line = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; {function}; echo ${{COMPREPLY[@]}}"
        found = subprocess.run(["bash", "-c", f"{script}\n{line}"], capture_output=True, text=True, check=True)
        assert found.stdout.split() == [wanted]


def test_the_log_level_decides_what_goes_to_standard_error(tmp_path, capsys):
    assert main(["examples", "--out", str(tmp_path / "a")]) == 0
    assert main(["check", str(tmp_path / "a")]) == 0
    assert capsys.readouterr().err == ""
    assert main(["check", str(tmp_path / "a"), "--log-level", "info"]) == 0
    log = capsys.readouterr().err
    assert "INFO bayes_damper.cli: bayes_damper" in log
    assert "6 trials, 4806 readings" in log


def test_the_recipe_for_conda_asks_for_what_the_package_needs():
    """Of pyproject.toml, those that hold for the Python that the recipe names; matplotlib without its windows."""
    root = Path(__file__).parent.parent
    recipe = (root / "conda" / "meta.yaml").read_text(encoding="utf-8")
    run = re.findall(r"^    - (\S+) ?(.*)$", recipe.partition("  run:")[2].partition("test:")[0], re.MULTILINE)
    asked = {name.replace("matplotlib-base", "matplotlib"): bounds for name, bounds in run if name != "python"}
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {}
    for line in project["dependencies"]:
        requirement, _, marker = (part.strip() for part in line.partition(";"))
        if "< '3.12'" not in marker:
            name = re.match(r"[\w-]+", requirement)[0]
            needed[name] = requirement[len(name) :]
    assert asked == needed
    assert f'version = "{project["version"]}"' in recipe


def test_init_takes_files_behind_the_options_and_names_those_that_an_option_took(tmp_path, capsys):
    rows = "".join(f"{0.004 * i:.3f},{0.08 * math.cos(0.232 * i):.6f}\n" for i in range(300))
    sources = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for source in sources:
        source.write_text(f"t,x\n{rows}", encoding="utf-8")
    options = ["--primary-inertia", "0.003", "--k1t", "10.2", "--theta0", "4.7", "--units", "rad"]
    behind = [*options, "--quantity", "displacement", *map(str, sources)]
    assert main(["init", str(tmp_path / "rig"), *behind]) == 0
    assert "2 trials" in capsys.readouterr().out
    taken = ["--quantity", "displacement", *options, *map(str, sources)]
    assert main(["init", str(tmp_path / "other"), *taken]) == 2
    said = capsys.readouterr().err
    assert f"init {tmp_path / 'other'} {sources[0]} {sources[1]} --" in said
    with pytest.raises(SystemExit) as ended:
        main(["check", "thesis", "more"])
    assert ended.value.code == 2


def test_what_is_given_beside_an_import_table_is_refused(tmp_path, capsys):
    beside = ["a.csv", "--theta0", "4.7", "--no-header", "--primary-inertia", "0.003"]
    assert main(["init", str(tmp_path / "rig"), *beside, "--table", "import.toml"]) == 2
    assert "and a.csv, --theta0, --header, --primary-inertia would do nothing; write" in capsys.readouterr().err
    assert main(["init", str(tmp_path / "rig"), "--table", str(tmp_path / "no.toml"), "--raw", "x", "--overwrite"]) == 2
    assert "would do nothing" not in capsys.readouterr().err


def test_a_cell_of_a_logger_file_that_no_computer_holds_is_named_with_its_line(tmp_path, capsys):
    rows = [f"{0.004 * i:.3f},{0.08 * math.cos(0.232 * i):.6f}" for i in range(300)]
    rows[100] = f"0.400,{'1' * 140_000}"
    source = tmp_path / "a.csv"
    source.write_text("\n".join(["t,x", *rows]), encoding="utf-8")
    assert main(["init", str(tmp_path / "rig"), str(source), "--primary-inertia", "0.003"]) == 2
    assert "line 102: '1111111111" in capsys.readouterr().err


def test_processes_of_a_command_import_nothing_from_the_folder_in_which_it_runs(tmp_path, monkeypatch):
    mark = tmp_path / "ran"
    (tmp_path / "multiprocessing.py").write_text(f"open({str(mark)!r}, 'w')\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    codes = []

    def starts(_):
        process = multiprocessing.get_context("spawn").Process(target=os.getpid)
        process.start()
        process.join(60)
        codes.append(process.exitcode)
        raise InputError("enough")

    monkeypatch.setattr(cli, "_check", starts)
    assert cli.main(["check", "thesis"]) == 2
    assert not mark.exists()
    assert codes == [0]
    assert "PYTHONSAFEPATH" not in os.environ
