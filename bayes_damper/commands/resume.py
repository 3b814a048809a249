"""Going on with a run that was stopped, or extending one that has finished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_damper.commands.fleet import finish_diagnoses
from bayes_damper.errors import InputError
from bayes_damper.fit import finish_fit, kept, plan_in, refuse_changes
from bayes_damper.inputs import resolved, shown
from bayes_damper.runs.execution import UNFINISHED, Progress, run_record
from bayes_damper.runs.json_files import write_json
from bayes_damper.validation.withheld.check import finish_withheld
from bayes_damper.variability import finish_variability

GOES_ON = ("fit", "diagnose", "variability", "withheld")
"""Commands that can be resumed: run.json names one of these, and nothing else is taken for what to run."""


def resume(
    folder: str | Path,
    *,
    more: bool = False,
    effects: str | Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Any:
    """Go on with what `folder` holds; the result is what the uninterrupted command would have given.

    The folder is data: it names a command and its settings, and what is run for them stands here. more : extend a
    finished run: four times the autocorrelation times, and twice the most steps if those were given. effects : the
    folder with effects of your own that the run began with, if it did; it is compared by its checksum. workers :
    processes; default as before. progress : as in `fit`.

    Raises
    ------
    InputError
        if the folder holds no run, one whose data, code or settings have changed, or a link that leads out of it.
    """
    path = Path(folder)
    _refuse_links_outside(path)
    pieces = _unfinished(path)
    record = run_record(path if pieces is None or more else pieces)
    command = record["command"]
    if command not in GOES_ON or (more and command != "fit"):
        raise InputError(
            f"{path}: run.json names the command {shown(command)}; fits, diagnoses, variability and withheld "
            "checks can be resumed, and only fits extended; other commands go on when the same command is given again"
        )
    if command == "variability" and effects is not None:
        raise InputError("--effects: variability knows the nominal model only; leave it out")
    if command == "variability":
        return finish_variability(pieces or path, record, workers=workers, progress=progress)
    processes = workers or record["workers"]
    if command == "withheld":
        return finish_withheld(path, record["plan"], effects=effects, workers=processes, progress=progress)
    if command == "diagnose":
        alone = pieces is not None
        return finish_diagnoses(path, record, effects=effects, workers=processes, progress=progress, alone=alone)
    plan = plan_in(record, path, effects)
    refuse_changes(path, record)
    if more:
        plan["thorough"] = True
        plan["most_steps"] = None if plan["most_steps"] is None else 2 * plan["most_steps"]
        for done in path.glob("*/done.json"):
            done.unlink()
        write_json(path / "run.json", record | {"plan": kept(plan)})
    return finish_fit(path, plan, workers=processes, progress=progress)


def _refuse_links_outside(path: Path) -> None:
    """InputError for a link to another place in a folder of results: what goes on there would be written elsewhere."""
    home = resolved(path)
    out = [p for p in path.rglob("*") if p.is_symlink() and not resolved(p).is_relative_to(home)]
    if out:
        remedy = "where the run would write; put the folder itself in its place"
        raise InputError([f"{p}: a link to {resolved(p)}, {remedy}" for p in out])


def _unfinished(path: Path) -> Path | None:
    """The folder with the pieces of a `diagnose` or `variability` run, in that of the results it has not written.

    That of a `variability` run may be named itself.
    """
    if (path / UNFINISHED / "run.json").exists():
        return path / UNFINISHED
    if (path / "run.json").exists() and run_record(path)["command"] == "variability":
        return path
    inside = path / "variability"
    return inside if (inside / "run.json").exists() and not (path / "variability.json").exists() else None
