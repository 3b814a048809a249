"""`bayes-damper bench --command diagnose`: where a diagnosis spends its time, by step and by kind of work.

Functions are timed where they are, in one process, in CPU time. Each second counts once: for the innermost function of
the list that is at work. By step: what `diagnose` goes through. By work: what all steps are made of.
"""

from __future__ import annotations

import functools
import platform
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from bayes_damper.errors import ExitCode
from bayes_damper.inputs import shipped_path
from bayes_damper.runs.json_files import write_json, write_text
from bayes_damper.text import Printable

SCHEMA = "bayes-damper/bench-parts/1"
SHIPPED = "data/withheld/campaigns/4c19e3018027"  # 16 records of a rig with a secondary and a hidden effect
REST = "all else"
STEPS = {
    "read the campaign": ("campaign.loading.load_campaign", "calibration.experiment.experiment_of"),
    "compile kernels": ("simulation.precompile.compile_ahead", "simulation.specialised.specialise"),
    "fit the nominal model": ("calibration.nominal.calibrate_nominal", "diagnosis.pipeline._reseeded"),
    "screen and fit single effects": ("diagnosis.search.search", "diagnosis.judgement._with_winners_noise"),
    "fit pairs": ("diagnosis.pairs.seconds_of", "diagnosis.pairs.best_pairs", "diagnosis.pairs.exactly"),
    "fit sets of effects": ("diagnosis.sets.grown",),
    "map the sites": ("diagnosis.sites.site_map",),
    "what is left over": ("diagnosis.remainder.remainder_of", "diagnosis.lone.left_alone"),
    "channels under a wrong name": ("diagnosis.wiring.miswired",),
    "verdict under other choices": (
        "diagnosis.sensitivity.sensitivity", "diagnosis.sensitivity.sensitivity_of_sets",
    ),
    "gap and budget on held-out trials": (
        "diagnosis.gap.measure_gap", "diagnosis.gap.closing", "diagnosis.budget.budget_of",
    ),
    "where it shows": ("diagnosis.where.locate",),
    "next experiment": ("diagnosis.pipeline._proposals",),
    "law of the rest": ("diagnosis.law.learn",),
    "forecast of held-out trials": ("calibration.forecast.forecasts",),
    "figures": ("commands.diagnose._draw",),
}  # fmt: skip
WORK = {
    "compile and load kernels": ("simulation.precompile.compile_ahead", "simulation.specialised.specialise"),
    "integrate records": ("simulation.model.Model._run",),
    "parameters and readings around it": ("calibration.problem.Problem.simulate",),
    "whiten": ("calibration.problem.Problem.whitened",),
    "difference quotients": ("calibration.derivatives.blocks_of",),
    "normal equations": (
        "calibration.normal_equations.Linear.normal", "calibration.normal_equations.Normals.steps",
        "calibration.normal_equations.Normals.reduced", "calibration.normal_equations.Normals.log_evidence",
    ),
    "screening columns": ("diagnosis.search.Screen.projected",),
    "site map: shapes and responses": ("diagnosis.sites._columns",),
    "site map: motions": ("diagnosis.response.motions",),
    "site map: projections": ("diagnosis.response.project_parts",),
    "site map: evidences": ("diagnosis.sites.hypotheses_of",),
    "figures": ("commands.diagnose._draw",),
}  # fmt: skip


@dataclass(frozen=True)
class Parts(Printable):
    """CPU seconds of one diagnosis: in all, by step and by work, and peak memory in MB."""

    campaign: str
    verdict: str
    machine: Mapping[str, str]
    seconds: float
    megabytes: float
    steps: Mapping[str, float]
    work: Mapping[str, float]
    exit_code: ClassVar[ExitCode] = ExitCode.DONE

    def text(self) -> str:
        """Both tables, in the order of what costs most."""
        lines = [f"{self.seconds:.1f} s of CPU time in one process, {self.megabytes:.0f} MB; verdict {self.verdict}"]
        for name, parts in (("step", self.steps), ("kind of work", self.work)):
            rows = sorted(parts.items(), key=lambda row: -row[1])
            lines += ["", f"| {name} | CPU s | share |", "| --- | --- | --- |"]
            lines += [f"| {part} | {s:.2f} | {s / self.seconds:.0%} |" for part, s in rows]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {"schema": SCHEMA} | asdict(self)


class Stopwatch:
    """CPU seconds by part: of nested parts the innermost counts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {REST: 0.0}
        self._running = [REST]
        self._since = time.process_time()

    def _charge(self) -> None:
        now = time.process_time()
        self.seconds[self._running[-1]] = self.seconds.get(self._running[-1], 0.0) + now - self._since
        self._since = now

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time is the part's."""

        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            self._charge()
            self._running.append(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._charge()
                self._running.pop()

        return run

    def start(self) -> None:
        """Count from now on: not what it took to import what is timed."""
        self._since = time.process_time()

    def stop(self) -> dict[str, float]:
        """Seconds by part until now."""
        self._charge()
        return dict(self.seconds)


@contextmanager
def timed(watch: Stopwatch, parts: Mapping[str, tuple[str, ...]]) -> Iterator[None]:
    """Times functions of the package, by their dotted names, wherever its modules use them."""
    changed: list[tuple[Any, str, Any]] = []
    try:
        for part, names in parts.items():
            for name in names:
                owner, attribute, function = _found(name)
                run = watch.timed(part, function)
                modules = [m for n, m in list(sys.modules.items()) if n.startswith("bayes_damper") and m is not None]
                for place in [owner] if isinstance(owner, type) else modules:
                    for known, value in list(vars(place).items()):
                        if value is function and (place is not owner or known == attribute):
                            changed.append((place, known, function))
                            setattr(place, known, run)
        yield
    finally:
        for place, known, function in reversed(changed):
            setattr(place, known, function)


def _found(name: str) -> tuple[Any, str, Any]:
    """Module or class, attribute and function of a dotted name below the package."""
    path = name.split(".")
    classes = [k for k, part in enumerate(path[:-1]) if part[0].isupper()]
    k = classes[0] if classes else len(path) - 1
    owner: Any = import_module(".".join(["bayes_damper", *path[:k]]))
    for part in path[k:-1]:
        owner = getattr(owner, part)
    return owner, path[-1], vars(owner)[path[-1]]


def diagnose_by_parts(campaign: str | Path | None = None, **options: Any) -> Parts:
    """A campaign (default: a shipped one) diagnosed once, in one process, with the time of each part; no file is kept.

    Kernels that this machine has none of are compiled in processes of their own, whose time does not count: run it
    twice for the time of a machine that knows them. options : of `diagnose`.

    Raises
    ------
    InputError
        as `diagnose`.
    """
    from bayes_damper.commands.diagnose import diagnose

    campaign = shipped_path(SHIPPED) if campaign is None else campaign
    steps, work = Stopwatch(), Stopwatch()
    with tempfile.TemporaryDirectory() as folder, timed(steps, STEPS), timed(work, WORK):
        begun = time.process_time()
        steps.start()
        work.start()
        found = diagnose(campaign, out=Path(folder) / "diagnosis", **({"workers": 1} | options))
        seconds = time.process_time() - begun
        by_step, by_work = steps.stop(), work.stop()
    return Parts(
        Path(campaign).name, str(found.result["verdict"]),
        {"processor": platform.processor() or platform.machine(), "python": platform.python_version()},
        seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, by_step, by_work,
    )  # fmt: skip


def save(found: Parts, folder: Path) -> list[Path]:
    """Write diagnose.json and diagnose.md; gives the files."""
    write_json(folder / "diagnose.json", found.to_json())
    title = [
        "# Where a diagnosis spends its time",
        "",
        f"Campaign {found.campaign}, by `bench --command diagnose`.",
        "",
    ]
    write_text(folder / "diagnose.md", "\n".join([*title, found.text()]) + "\n")
    return [folder / "diagnose.json", folder / "diagnose.md"]
