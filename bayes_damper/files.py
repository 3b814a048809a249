"""Where the shipped files lie: `data/` and `priors/`, in a checkout or inside an installed wheel."""

from __future__ import annotations

from pathlib import Path

from bayes_damper.errors import InputError

_PACKAGE = Path(__file__).resolve().parent


def shipped_path(name: str) -> Path:
    """The path of a shipped file or folder, e.g. ``data/thesis`` or ``priors/thesis.toml``.

    Raises
    ------
    InputError
        if no such file was shipped.
    """
    for root in (_PACKAGE / "_shipped", _PACKAGE.parent):
        path = root / name
        if path.exists():
            return path
    raise InputError(f"{name}: this file belongs to bayes_damper but was not found; reinstall the package")
