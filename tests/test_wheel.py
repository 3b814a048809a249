"""The wheel is whole: data, priors and the command work from another folder, without the checkout."""

import os
import site
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def run(wheel, tmp_path_factory):
    """Runs a command of an environment that has the wheel and, behind it, the packages of this one."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "venv", with_pip=False)
    (target,) = (folder / "venv").glob("lib/python*/site-packages")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(target), str(wheel)]
    subprocess.run(install, check=True)
    # A line in a .pth file adds the folder itself, but not its .pth files: the editable checkout stays out of sight.
    (target / "outside.pth").write_text("\n".join(site.getsitepackages()))
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}

    def call(*arguments):
        command = [str(folder / "venv" / "bin" / "python"), *arguments]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)

    return call


def test_the_wheel_is_small_and_holds_data_and_priors(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert "bayes_damper/_shipped/data/thesis/measurements.csv" in names
    assert "bayes_damper/_shipped/priors/thesis.toml" in names
    kept = [p.relative_to(ROOT) for folder in ("data", "priors") for p in (ROOT / folder).rglob("*") if p.is_file()]
    for folder in ("thesis", "real", "withheld"):
        assert any(p.parts[:2] == ("data", folder) for p in kept)
    for path in kept:
        assert "__pycache__" in path.parts or f"bayes_damper/_shipped/{path.as_posix()}" in names
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".nbi", ".nbc"))]
    assert not [name for name in names if name.startswith("tests/")]
    assert wheel.stat().st_size < 1.5e6  # of which 0.4 MB are campaigns for the withheld check


def test_data_and_priors_are_found_outside_the_checkout(run):
    done = run(
        "-c",
        "from bayes_damper.published import measurements; from bayes_damper.priors.files import load_priors; "
        "print(measurements.__file__); "
        "print(len(measurements.load_published().measurements), load_priors('thesis').name)",
    )
    assert done.returncode == 0, done.stderr
    place, numbers = done.stdout.splitlines()
    assert str(ROOT / "bayes_damper") not in place
    assert numbers == "24 thesis"


def test_the_command_explains_itself(run):
    done = run(
        "-c", "import sys; from bayes_damper.cli import main; sys.argv = ['bayes-damper', '--help']; sys.exit(main())"
    )
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout
