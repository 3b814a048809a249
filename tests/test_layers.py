"""Imports go one way: a module imports from layers above its own (lower numbers), never from its own or one below."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent / "bayes_damper"

# A package counts as one module; inside it anything goes that makes no cycle at import time.
LAYERS = (
    {
        "errors",
        "resources",
        "distributions",
        "outcome",
        "parameters",
        "checkpoint",
        "provenance",
        "memory",
        "wording",
        "numerals",
    },
    {"readings", "logger_files", "units", "kernels", "forked", "linking"},
    {"records"},
    {"campaign", "import_options", "importer", "lanes", "damper", "linear", "published"},
    {"effects"},
    {"integrator", "accumulate", "composition", "links"},
    {"model"},
    {"ahead"},
    {"features", "priors", "likelihood"},
    {"posterior", "calibration"},
    {"noise"},
    {"record_posterior", "influence", "forecast"},
    {"sampling", "evidence", "arviz_adapter"},
    {"figures", "run", "bench_peers", "check", "sensitivity"},
    {"progress", "summary"},
    {"diagnosis"},
    {"fit", "variability", "tuning", "thesis", "compare", "simulate", "diagnose"},
    {"withheld", "bench", "planning"},
    {"report"},
    {"demo", "resume"},
    {"cli"},
)
LEVEL = {name: number for number, names in enumerate(LAYERS) for name in names}
FREE = {"cli", "__init__", "__main__"}  # may import anything: they are the doors
ARVIZ = {"arviz", "arviz_base", "arviz_stats"}
ONLY_IN = {"matplotlib": {"figures"}, "corner": {"figures"}} | {name: {"arviz_adapter"} for name in ARVIZ}
FILES = sorted(ROOT.rglob("*.py"))


def module_of(path):
    """The first part of a module's name below bayes_damper, and its last part."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[0], parts[-1] if parts[-1] != "__init__" else parts[-2] if len(parts) > 1 else parts[0]


def imports_of(path):
    """(dotted name, line) of every import in a file, those inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            if node.module == "bayes_damper":
                yield from ((f"bayes_damper.{alias.name}", node.lineno) for alias in node.names)
            else:
                yield node.module, node.lineno


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_upwards(path):
    package, _ = module_of(path)
    if package in FREE:
        return
    assert package in LEVEL, f"give {package} a layer in this file"
    for name, line in imports_of(path):
        if not name.startswith("bayes_damper"):
            continue
        parts = name.split(".")
        assert len(parts) > 1, f"{path}:{line}: nothing inside imports the package itself"
        if parts[1] == package or not ((ROOT / parts[1]).is_dir() or (ROOT / f"{parts[1]}.py").is_file()):
            continue
        assert parts[1] in LEVEL, f"give {parts[1]} a layer in this file"
        assert LEVEL[parts[1]] <= LEVEL[package], f"{path}:{line}: {package} must not import {parts[1]}"
        # Two of one layer may not need each other: the direction within a layer would be a layer of its own.
        if LEVEL[parts[1]] == LEVEL[package]:
            back = [n for f in FILES if module_of(f)[0] == parts[1] for n, _ in imports_of(f)]
            others = {n.split(".")[1] for n in back if n.startswith("bayes_damper.")}
            assert package not in others, f"{path}:{line}: {package} and {parts[1]} import each other"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_plotting_and_arviz_have_one_door_each(path):
    _, module = module_of(path)
    for name, line in imports_of(path):
        allowed = ONLY_IN.get(name.split(".")[0])
        assert allowed is None or module in allowed, f"{path}:{line}: only {allowed} may import {name}"


def test_importing_the_package_takes_no_heavy_module():
    code = (
        "import sys, bayes_damper; heavy = {'numba', 'scipy', 'matplotlib', 'emcee', 'pandas', 'xarray', 'arviz_base', "
        "'arviz_stats', 'corner'} & set(sys.modules); sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"import bayes_damper imports {done.stderr}"


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
