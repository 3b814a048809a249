"""Progress bars in a terminal; silence elsewhere."""

from __future__ import annotations

import sys
from typing import Any

from bayes_damper.run import Progress, Silent


class Bars:
    """One bar per task, drawn by rich on standard error."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as RichProgress

        self._bars = RichProgress(
            TextColumn("{task.description:<14}"),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}"),
            console=Console(stderr=True),
        )
        self._known: dict[str, TaskID] = {}
        self._bars.start()

    def update(self, task: str, share: float, text: str) -> None:
        """Draw how far a task is."""
        if task not in self._known:
            self._known[task] = self._bars.add_task(task, total=1.0, text=text)
        self._bars.update(self._known[task], completed=share, text=text)
        if all(bar.finished for bar in self._bars.tasks):
            self._bars.refresh()

    def close(self) -> None:
        """Leave the terminal as it was found."""
        self._bars.stop()


class _Quiet(Silent):
    def close(self) -> None:
        """Nothing to close."""


def make_progress(quiet: bool) -> Any:
    """Bars where standard error is a terminal and nobody asked for quiet; else silence."""
    progress: Progress = _Quiet() if quiet or not sys.stderr.isatty() else Bars()
    return progress
