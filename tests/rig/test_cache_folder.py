"""Compiled code is taken only from where nobody else can have put it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest
from compiled import without_kernels

from bayes_damper.rig import cache_folder as module
from bayes_damper.rig.cache_folder import KEPT, cache_folder, distrusted, mark_used

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owner here")
OTHER = 65534


@pytest.fixture
def base(tmp_path, monkeypatch):
    """A cache folder that the variable names, safe as it is made."""
    monkeypatch.setenv("BAYES_DAMPER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr(module.tempfile, "tempdir", None)
    (tmp_path / "temporary").mkdir()
    module._usable.cache_clear()
    assert cache_folder() == tmp_path / "cache"
    module._usable.cache_clear()
    yield tmp_path / "cache"
    module._usable.cache_clear()


def planted(base, name="__pycache__/advance_1.nbi"):
    path = base / name
    path.write_bytes(b"planted")
    return path


def test_a_folder_of_ones_own_is_used_again_and_closed_to_others(base):
    planted(base)
    assert cache_folder() == base
    assert base.stat().st_mode & 0o77 == 0
    assert (base / "__pycache__").stat().st_mode & 0o77 == 0


def test_kernels_that_no_run_has_used_for_long_are_deleted(base):
    long_ago = time.time() - 86_400.0 * (KEPT + 1)
    for name in ("advance_1", "advance_2"):
        for path in (planted(base, f"{name}.py"), planted(base, f"__pycache__/{name}.linked-1.py311.nbi")):
            os.utime(path, (long_ago, long_ago))
    mark_used(base / "advance_2.py")
    assert (base / "advance_2.py").stat().st_mtime == pytest.approx(long_ago), "or numba would compile it again"
    assert cache_folder() == base
    assert {path.name for path in base.rglob("*.*")} == {"advance_2.py", "advance_2.linked-1.py311.nbi"}


def in_private(base, capsys, words):
    """The folder that is used instead: private, empty, named in a sentence, and used by processes started from here."""
    found = cache_folder()
    assert found != base
    assert found.stat().st_mode & 0o777 == 0o700
    assert [p.name for p in found.iterdir()] == ["__pycache__"]
    assert not list((found / "__pycache__").iterdir())
    told = capsys.readouterr().err
    assert str(base) in told
    assert words in told
    assert os.environ["BAYES_DAMPER_CACHE"] == str(found)


@pytest.mark.parametrize("place", [".", "__pycache__"])
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_may_write_is_not_used(base, capsys, place, mode):
    planted(base)
    (base / place).chmod(mode)
    in_private(base, capsys, "others may write")


def test_a_file_that_others_may_write_is_not_used_unless_they_cannot_come_to_it(base, capsys):
    planted(base).chmod(0o666)
    assert cache_folder() == base
    module._usable.cache_clear()
    (base / "__pycache__").chmod(0o755)
    in_private(base, capsys, "others may write")


@pytest.mark.parametrize("name", ["__pycache__/advance_1.nbi", "advance_1.py"])
def test_a_link_is_not_followed(base, capsys, tmp_path, name):
    (tmp_path / "elsewhere").write_bytes(b"planted")
    (base / name).symlink_to(tmp_path / "elsewhere")
    in_private(base, capsys, "is a link")


def test_a_linked_folder_of_machine_code_is_not_used(base, capsys, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (base / "__pycache__").rmdir()
    (base / "__pycache__").symlink_to(tmp_path / "elsewhere")
    in_private(base, capsys, "is a link")


def test_a_parent_in_which_anybody_may_exchange_anything_is_not_used(base, capsys):
    base.parent.chmod(0o777)
    in_private(base, capsys, "anybody may exchange")
    base.parent.chmod(0o700)


@pytest.mark.skipif(hasattr(os, "getuid") and os.getuid() != 0, reason="only root can give files to others")
@pytest.mark.parametrize("place", [".", "__pycache__", "__pycache__/advance_1.nbi"])
def test_what_belongs_to_another_user_is_not_used(base, capsys, place):
    planted(base)
    os.chown(base / place, OTHER, OTHER)
    in_private(base, capsys, "belongs to another user")


def test_a_planted_spare_folder_is_not_used_either(base, tmp_path):
    base.chmod(0o777)
    spare = tmp_path / "temporary" / f"bayes_damper-{os.getuid()}"
    spare.mkdir()
    spare.chmod(0o777)
    assert cache_folder() not in (base, spare)


class Runs:
    """What a pickle can do when it is read."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (os.system, (f"touch {self.mark}",))


@pytest.mark.slow
def test_a_planted_pickle_is_not_run(tmp_path):
    """A kernel's index is exchanged for a pickle that leaves a mark; it runs from a folder of one's own, not from one
    that others may write.
    """
    cache, mark = without_kernels(tmp_path / "cache"), tmp_path / "ran"
    without_kernels(tmp_path / f"bayes_damper-{os.getuid()}")  # the spare folder
    code = (
        "from bayes_damper.simulation import specialised as i;"
        "i.specialise(i.specialised_globals(False, True, False, False, None))"
    )

    def start() -> str:
        environment = os.environ | {"BAYES_DAMPER_CACHE": str(cache), "TMPDIR": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
        )
        return done.stderr

    start()
    (index,) = cache.glob("__pycache__/advance_*.nbi")
    index.write_bytes(pickle.dumps(Runs(mark)))
    start()
    assert mark.exists(), "the planted file must be one that numba would read, or this test shows nothing"
    mark.unlink()
    index.write_bytes(pickle.dumps(Runs(mark)))
    (cache / "__pycache__").chmod(0o777)
    assert "compiled code there is not used, because others may write" in start()
    assert not mark.exists()


def test_nothing_is_distrusted_in_a_folder_that_is_not_there(tmp_path):
    assert not list(distrusted(tmp_path / "none"))


def simulated_in(folder, **variables):
    """A small simulation by another process that runs in a folder."""
    code = "from bayes_damper import simulate_record; simulate_record(duration=0.1, out='record.csv')"
    here = Path(module.__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(here), "PYTHONSAFEPATH": "1"} | variables
    return subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, check=True, capture_output=True)


@pytest.mark.slow
def test_a_folder_in_which_a_command_runs_does_not_say_where_compiled_code_lies(tmp_path):
    """numba would take that from a file in the current folder, and run the pickles it names."""
    pytest.importorskip("yaml")  # else numba cannot read that file
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: planted\n", encoding="utf-8")
    simulated_in(tmp_path)
    assert (tmp_path / "record.csv").exists()
    assert not (tmp_path / "planted").exists()


@pytest.mark.slow
def test_numbas_own_folder_is_judged_too(tmp_path):
    shared = tmp_path / "shared"
    simulated_in(tmp_path, NUMBA_CACHE_DIR=str(shared))
    folders = [path for path in shared.rglob("*") if path.is_dir()]
    mark = tmp_path / "ran"
    for path in shared.rglob("*.nbi"):
        path.write_bytes(pickle.dumps(Runs(mark)))
    for path in (shared, *folders):
        path.chmod(0o777)
    simulated_in(tmp_path, NUMBA_CACHE_DIR=str(shared))
    assert not mark.exists()
    assert folders, "else nothing was planted"
