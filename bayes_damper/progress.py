"""Progress bars in a terminal; silence elsewhere."""

from __future__ import annotations

import sys
from typing import Any

from bayes_damper.run import WAITING, Progress, Silent

_MOST_BARS = 8
"""Tasks whose bars stay when they are done; of more, only those at work are drawn."""


class Bars:
    """One bar per task that has begun, and one of all together where there are several, drawn by rich on standard
    error (or on `console`, a rich.console.Console).
    """

    def __init__(self, console: Any = None) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as RichProgress

        self._bars = RichProgress(
            TextColumn("{task.description:<14}"),
            BarColumn(bar_width=20),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}"),
            console=console or Console(stderr=True),
        )
        self._known: dict[str, TaskID] = {}
        self._shares: dict[str, float] = {}
        self._all: TaskID | None = None
        self._bars.start()

    def update(self, task: str, share: float, text: str) -> None:
        """Draw how far a task is; one that waits has no bar yet but counts."""
        self._shares[task] = share
        if text != WAITING:
            if task not in self._known:
                self._known[task] = self._bars.add_task(task, total=1.0, text=text)
            done = share >= 1.0
            self._bars.update(
                self._known[task], completed=share, text=text, visible=not done or len(self._shares) <= _MOST_BARS
            )
        if len(self._shares) > 1:
            self._draw_all()

    def _draw_all(self) -> None:
        if self._all is None:
            self._all = self._bars.add_task("together", total=1.0, text="")
        done = sum(share >= 1.0 for share in self._shares.values())
        waiting = len(self._shares) - len(self._known)
        text = f"{done} of {len(self._shares)} parts done" + (f", {waiting} not begun" if waiting else "")
        self._bars.update(self._all, completed=sum(self._shares.values()) / len(self._shares), text=text)

    def close(self) -> None:
        """Leave the terminal as it was found, the bars as they were last."""
        self._bars.stop()


class _Quiet(Silent):
    def close(self) -> None:
        """Nothing to close."""


def make_progress(quiet: bool) -> Any:
    """Bars where standard error is a terminal and nobody asked for quiet, else silence; who makes it closes it."""
    progress: Progress = _Quiet() if quiet or not sys.stderr.isatty() else Bars()
    return progress
