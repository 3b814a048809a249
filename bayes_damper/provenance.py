"""Where a result comes from: versions, commit, command, checksums. Written into every result."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("numpy", "scipy", "numba", "emcee", "arviz-base", "arviz-stats", "pandas")
_HERE = Path(__file__).resolve().parent


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
    return name if name is None else name + ("+" if git("status", "--porcelain", "--", "bayes_damper") else "")


@cache
def code_sha256() -> str:
    """Checksum of the package's own source files; data that a wheel carries along are not code."""
    digest = hashlib.sha256()
    for path in sorted(p for p in _HERE.rglob("*.py") if "_shipped" not in p.relative_to(_HERE).parts):
        digest.update(path.relative_to(_HERE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


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
