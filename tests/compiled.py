"""Folders for compiled code in which only kernels are missing."""

import shutil
from pathlib import Path

from bayes_damper.rig.cache_folder import cache_folder
from bayes_damper.simulation import specialised


def without_kernels(folder: Path) -> Path:
    """A private cache folder, now made, with the machine code that all kernels share (most of a first compiling)."""
    specialised.compile_common()
    (folder / "__pycache__").mkdir(mode=0o700, parents=True)
    folder.chmod(0o700)
    common = specialised._common().py_func.__code__.co_filename
    for path in cache_folder().rglob(f"{Path(common).stem}.*"):
        shutil.copy2(path, folder / path.relative_to(cache_folder()))  # numba looks at the time of the source
    return folder
