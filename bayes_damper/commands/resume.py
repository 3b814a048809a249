"""Going on with a run that was stopped, or extending one that has finished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_damper.errors import InputError
from bayes_damper.fit import finish_fit, plan_in, refuse_changes
from bayes_damper.runs.execution import Progress, read_json, write_json
from bayes_damper.validation.withheld.check import finish_withheld
from bayes_damper.variability import finish_variability


def resume(
    folder: str | Path, *, more: bool = False, workers: int | None = None, progress: Progress | None = None
) -> Any:
    """Go on with what `folder` holds; the result is what the uninterrupted command would have given.

    more : extend a finished run: four times the autocorrelation times, and twice the most steps if those were given.
    workers : processes; default as before. progress : told how far it is, as in `fit`.

    Raises
    ------
    InputError
        if the folder holds no run, or one whose data, code or settings have changed.
    """
    path = Path(folder)
    pieces = _unfinished_variability(path)
    if pieces is not None and not more:
        return finish_variability(pieces, read_json(pieces / "run.json"), workers=workers, progress=progress)
    record = read_json(path / "run.json")
    if record.get("command") == "withheld" and not more:
        return finish_withheld(
            path, dict(record["plan"]), workers=workers or record.get("workers", 1), progress=progress
        )
    if record.get("command") != "fit":
        raise InputError(
            f"{path}: run.json names the command {record.get('command')!r}; fits, variability and withheld "
            "checks can be resumed, and only fits extended; other commands go on when the same command is given again"
        )
    plan = plan_in(record, path)
    refuse_changes(path, record)
    if more:
        plan["thorough"] = True
        plan["most_steps"] = None if plan["most_steps"] is None else 2 * plan["most_steps"]
        for done in path.glob("*/done.json"):
            done.unlink()
        write_json(path / "run.json", record | {"plan": plan})
    return finish_fit(path, plan, workers=workers or record.get("workers", 1), progress=progress)


def _unfinished_variability(path: Path) -> Path | None:
    """The folder with the pieces of a `variability` run: named itself, or in that of the results it has not written."""
    if (path / "run.json").exists() and read_json(path / "run.json").get("command") == "variability":
        return path
    inside = path / "variability"
    return inside if (inside / "run.json").exists() and not (path / "variability.json").exists() else None
