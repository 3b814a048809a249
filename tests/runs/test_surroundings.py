"""What lies in the folder in which a command runs neither steers nor ends it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import bayes_damper
from bayes_damper.runs.surroundings import elsewhere

PACKAGE = Path(bayes_damper.__file__).parent
GUARDS = {"numba": "bayes_damper.rig.unsteered_numba", "matplotlib": "bayes_damper.figures"}
USE = """
import bayes_damper.figures
from bayes_damper import simulate_record
from bayes_damper.sampling.arviz_adapter import imported
import matplotlib
simulate_record(duration=0.1, out="record.csv")
imported("arviz")
assert not matplotlib.rcParams["text.usetex"]
import arviz_base
assert arviz_base.rcParams["data.index_origin"] == 0
"""


def run_in(folder):
    environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-W", "ignore", "-c", USE]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numba", "arviz", "matplotlib"),
    [
        (b"cache_dir: [1", b"stats.evil: 1", b"text.usetex"),
        (b"\xff\xfe", b"\xff\xfe", b"\xff\xfe"),
        (b"disable_jit: 1\nopt: 77", b"data.index_origin: 1", b"text.usetex: True"),
    ],
    ids=["malformed", "no text", "steering"],
)
def test_settings_of_libraries_in_the_current_folder_are_not_read(tmp_path, numba, arviz, matplotlib):
    (tmp_path / ".numba_config.yaml").write_bytes(numba)
    (tmp_path / "arvizrc").write_bytes(arviz)
    (tmp_path / "matplotlibrc").write_bytes(matplotlib)
    done = run_in(tmp_path)
    assert done.returncode == 0, done.stderr.decode()
    assert b"Traceback" not in done.stderr
    assert b"matplotlibrc" not in done.stderr
    assert (tmp_path / "record.csv").exists()


@pytest.mark.parametrize("library", GUARDS)
def test_every_module_that_uses_such_a_library_loads_it_without_them(library):
    """Figures have the guard at the head of their folder, which is imported before them."""
    for path in PACKAGE.rglob("*.py"):
        names = [
            name
            for node in ast.parse(path.read_text(encoding="utf-8")).body
            for name in _imported(node)
            if name.partition(".")[0] == library or name == GUARDS[library]
        ]
        inside = path.is_relative_to(PACKAGE / "figures") and library == "matplotlib"
        assert not names or inside or names[0] == GUARDS[library], path
    first = next(_imported(node) for node in ast.parse((PACKAGE / "figures/__init__.py").read_text()).body[1:])
    assert first == ["bayes_damper.figures"]


def _imported(node):
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module] if isinstance(node, ast.ImportFrom) and node.module else []


def test_the_current_folder_is_what_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with elsewhere():
        assert Path.cwd() != tmp_path
    assert Path.cwd() == tmp_path
    with pytest.raises(FileNotFoundError), elsewhere():
        (tmp_path / "none").read_bytes()
    assert Path.cwd() == tmp_path


def test_a_current_folder_that_is_there_no_more_is_none(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with elsewhere():
        pass
    os.chdir(tmp_path)
