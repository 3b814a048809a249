"""Where a result comes from: versions, commit, command, checksums. Written into every result."""

from __future__ import annotations

import ast
import hashlib
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("numpy", "scipy", "numba", "emcee", "arviz-base", "arviz-stats", "pandas")
_HERE = Path(__file__).resolve().parents[1]


def package_version() -> str:
    """Version of bayes_damper, or a word for a tree that is not installed."""
    try:
        return version("bayes-damper")
    except PackageNotFoundError:
        return "not installed"


@cache
def commit() -> str | None:
    """The commit of the checkout that runs, with `+` when files differ from it; None outside a checkout."""

    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(  # fixed arguments
                ["git", "-C", str(_HERE), *arguments],
                capture_output=True,
                text=True,
                timeout=10,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    top = git("rev-parse", "--show-toplevel")
    if top is None or Path(top).resolve() != _HERE.parent:
        return None
    name = git("rev-parse", "HEAD")
    return name if name is None else name + ("+" if git("status", "--porcelain", "--", ".") else "")


@cache
def code_sha256(*roots: str) -> str:
    """Checksum of the package's own source files; data that a wheel carries along are not code.

    roots : names of modules, e.g. "bayes_damper.diagnosis"; then only of these and of what they import, directly or
    not, wherever the import stands. Of a package that is imported every file counts.
    """
    files = sorted(_reached(roots)) if roots else [p for p in _HERE.rglob("*.py") if not _is_carried(p)]
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.relative_to(_HERE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _is_carried(path: Path) -> bool:
    return "_shipped" in path.relative_to(_HERE).parts


def _reached(roots: Iterable[str]) -> set[Path]:
    """Source files of these modules of the package and of every one that they import."""
    todo = list(roots)
    found: set[Path] = set()
    while todo:
        for path in _files(todo.pop()) - found:
            found.add(path)
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    todo += [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom) and node.module:
                    todo += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def _files(module: str) -> set[Path]:
    """The file of a module of this package, every file of a subpackage; none of another package."""
    first, *rest = module.split(".")
    place = _HERE.joinpath(*rest)
    if first != _HERE.name or not rest:
        return set()
    if place.is_dir():
        return set(place.rglob("*.py"))
    return {place.with_suffix(".py")} & {place.parent / name.name for name in place.parent.glob("*.py")}


def provenance(**more: Any) -> dict[str, Any]:
    """What a reader needs to make the result again; `more` is added as it is."""
    found: Mapping[str, str] = {name: version(name) for name in _PACKAGES if _installed(name)}
    return {
        "bayes_damper": package_version(),
        "commit": commit(),
        "code_sha256": code_sha256(),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "packages": dict(found),
        "command": " ".join(["bayes-damper", *sys.argv[1:]]),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        **more,
    }


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
