"""Imports numba without the settings of the folder in which a command runs, and sees to it that it reads none later.

To be imported before numba, by every module that uses it.
"""

from __future__ import annotations

from typing import Any

from bayes_damper.runs.surroundings import unsteered

config: Any = unsteered("numba.core.config")
config._config_fname = ""  # noqa: SLF001  # what each compilation looks for again
config.reload_config()
