"""The main job on the shipped data: the four cases of the thesis, from published numbers to one answer and a report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bayes_damper.errors import ExitCode, InputError
from bayes_damper.fit import Fit, OtherRun, fit
from bayes_damper.report import report
from bayes_damper.runs.contents.fit import FitFile
from bayes_damper.runs.execution import Progress
from bayes_damper.text import Printable
from bayes_damper.variability import Variability, variability

QUICK_STEPS = 300
PARTICLES, QUICK_PARTICLES = 128, 32
"""Of each run of `variability`: fewer than that takes by itself, with the error that this leaves."""
_DRAWS = 100


@dataclass(frozen=True)
class Demo(Printable):
    """The fit of the thesis's cases, what they share, and the page that shows both."""

    fit: Fit
    shared: Variability
    page: Path

    @property
    def exit_code(self) -> ExitCode:
        return self.fit.exit_code if self.fit.exit_code is not ExitCode.DONE else self.shared.exit_code

    def to_json(self) -> FitFile:
        """What summary.json holds."""
        return self.fit.to_json()

    def text(self) -> str:
        """For people."""
        return f"{self.fit.text()}\n{self.shared.text()}\nReport: {self.page}"


def demo(
    out: str | Path = "results/demo", *, seed: int = 1, workers: int = 2, quick: bool = False,
    scheduler: str | None = None, progress: Progress | None = None,
) -> Demo:  # fmt: skip
    """Fit the four cases of the thesis, ask what they share, and write the report.

    out : folder for all files; seed : decides every random number; workers : processes; quick : stop early, marked as
    not converged; scheduler : address of a Dask cluster that works in place of processes; progress : as in
    `fit`.

    Raises
    ------
    InputError
        if `out` holds another run, with what to type.
    """
    try:
        fitted = fit(
            "thesis", out=out, seed=seed, workers=workers, most_steps=QUICK_STEPS if quick else None,
            scheduler=scheduler, progress=progress,
        )  # fmt: skip
    except OtherRun as error:
        raise InputError([*error.faults, f"With make, beside it: make demo DEMO_OUT={error.beside}"]) from None
    shared = variability(
        fitted.folder, seed=seed, particles=QUICK_PARTICLES if quick else PARTICLES, repeats=1, draws=_DRAWS,
        workers=workers, scheduler=scheduler, progress=progress,
    )  # fmt: skip
    return Demo(fitted, shared, report(fitted.folder).path)
