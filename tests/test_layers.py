"""The layout: few flat modules, folders that import one way only, and one door each for plotting and ArviZ.

Every import counts: those inside functions and those for types alone, too.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent / "bayes_damper"
FILES = sorted(ROOT.rglob("*.py"))
DOORS = {"__init__", "__main__"}  # hand names on; nothing inside imports them
FLAT = {"cli", "errors", "inputs", "text"}
ARVIZ = {"arviz", "arviz_base", "arviz_stats"}
ONLY_IN = {"matplotlib": {"figures"}, "corner": {"figures"}} | {name: {"arviz_adapter"} for name in ARVIZ}


def name_of(path):
    """The dotted name of a module below bayes_damper, e.g. "fit.plan"; a folder's own file has the folder's name."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


MODULES = {name_of(path): path for path in FILES}


@cache
def imports_of(path):
    """(dotted name, line) of every import in a file."""
    return tuple(_imports_of(path))


def _imports_of(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}".removeprefix("bayes_damper.")
                yield (f"bayes_damper.{inside}" if inside in MODULES else node.module), node.lineno


def taken_by(path):
    """Modules of the package that a file imports."""
    for name, line in imports_of(path):
        if name.startswith("bayes_damper"):
            if name == "bayes_damper":
                assert path == ROOT / "cli.py", f"{path}:{line}: only the command line calls the public functions"
                continue
            yield name.removeprefix("bayes_damper.")


def one_way(graph, what):
    """Asserts that arrows between the nodes of {node: those it imports} form no ring."""
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as ring:
        pytest.fail(f"{what} import each other: {' <- '.join(ring.args[1])}")


def test_few_modules_lie_flat():
    flat = {path.stem for path in ROOT.glob("*.py")} - DOORS
    assert flat <= FLAT, f"{sorted(flat - FLAT)}: put them into the folder of their subject"
    assert len(FLAT) <= 6


def test_folders_import_one_way():
    graph = {}
    for name, path in MODULES.items():
        part = name.split(".")[0]
        if part not in DOORS | {"cli"}:
            graph.setdefault(part, set()).update(taken.split(".")[0] for taken in taken_by(path))
    graph = {part: taken - {part} for part, taken in graph.items()}
    one_way(graph, "folders")
    table = (ROOT.parent / "CONTRIBUTING.md").read_text(encoding="utf-8").split("| --- | --- |")[1].split("\n\n")[0]
    first = [row.split("|")[1] for row in table.splitlines() if row.startswith("|")]
    order = [name for cell in first for name in re.findall(r"`(\w+)(?:\.py|/)`", cell)]
    assert sorted(order) == sorted({*graph, "cli"}), "the map in CONTRIBUTING.md lists each part once"
    for part, taken in graph.items():
        above = set(order[: order.index(part)])
        assert taken <= above, f"the map in CONTRIBUTING.md puts {sorted(taken - above)} below {part}, which imports it"


@pytest.mark.parametrize("folder", sorted({p.parent for p in FILES} - {ROOT}), ids=lambda p: p.name)
def test_files_of_a_folder_import_one_way(folder):
    inside = {name_of(path): path for path in folder.glob("*.py")}
    graph = {name: {taken for taken in taken_by(path) if taken in inside} for name, path in inside.items()}
    one_way(graph, f"files of {folder.name}")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_plotting_and_arviz_have_one_door_each(path):
    parts = set(path.relative_to(ROOT).with_suffix("").parts)
    for name, line in imports_of(path):
        allowed = ONLY_IN.get(name.split(".")[0])
        assert allowed is None or parts & allowed, f"{path}:{line}: only {allowed} may import {name}"


FITS_ALONE = "{'scipy.stats', 'scipy.signal', 'scipy.ndimage', 'emcee', 'xarray', 'arviz', 'corner'}"
HEAVY = "{'numba', 'scipy', 'matplotlib', 'emcee', 'pandas', 'xarray', 'arviz', 'arviz_base', 'arviz_stats', 'corner'}"


@pytest.mark.parametrize(
    "code",
    ["import bayes_damper", "from bayes_damper.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass"],
    ids=["package", "help"],
)
def test_neither_the_package_nor_its_help_takes_a_heavy_module(code):
    code = f"import sys\n{code}\nsys.exit(', '.join(sorted({HEAVY} & set(sys.modules))) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"it imports {done.stderr}"


def test_a_diagnosis_starts_without_what_fits_alone_need():
    """Half a second and 25 MB of every start, also of each worker."""
    code = (
        f"import sys, bayes_damper.commands.diagnose; sys.exit(', '.join(sorted({FITS_ALONE} & set(sys.modules))) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"it imports {done.stderr}"


def test_importing_the_package_is_quick_and_leaves_nothing(tmp_path):
    """Below a second in a new process without home, display or cache, and no file is written."""
    code = f"import sys; sys.path.insert(0, {str(ROOT.parent)!r}); import bayes_damper, bayes_damper.cli"
    done = subprocess.run(
        [sys.executable, "-B", "-I", "-X", "importtime", "-c", code],
        capture_output=True, text=True, check=True, cwd=tmp_path, env={"PATH": "", "HOME": str(tmp_path)},
    )  # fmt: skip
    rows = [line.split("|") for line in done.stderr.splitlines() if line.startswith("import time:") and "|" in line]
    cumulative = {row[2].strip(): int(row[1]) for row in rows if row[1].strip().isdigit()}
    assert cumulative["bayes_damper"] < 1_000_000
    assert list(tmp_path.iterdir()) == []


def test_tests_of_a_file_go_to_one_process_and_formulas_apart(request):
    """Side by side, what a file prepares is made once, and kernels are shared out."""
    plugins = request.config.pluginmanager.get_plugins()
    rule = next(p for p in plugins if getattr(p, "__file__", None) == str(Path(__file__).parent / "conftest.py"))
    assert len({rule.together(f"tests/fit/test_entry.py::{name}") for name in ("test_a[x/y]", "test_b")}) == 1
    simulated = [f"tests/effects/test_effects.py::{test}[{name}]" for test in "ab" for name in ("e/one", "e/two")]
    assert len({rule.together(nodeid) for nodeid in simulated}) == 2
