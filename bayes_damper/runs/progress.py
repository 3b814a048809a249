"""How far a long run is, while it goes on: bars in a terminal, plain lines in a log, nothing where nobody asked."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TextIO

from bayes_damper.runs.execution import WAITING, Progress, Silent

_MOST_BARS = 8
"""Tasks whose bars stay when they are done; of more, only those at work are drawn."""


NOTICE = "\n"
"""What separates the stage in a text of progress from a notice: a sentence of its own, shown once."""


class Notices:
    """Notices of tasks, each given the first time only: several tasks that have the same to say say it once."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def separate(self, task: str, text: str) -> tuple[str, str]:
        """The stage in a text of progress, and the line of its notice, "" where there is nothing new."""
        stage, _, notice = text.partition(NOTICE)
        if not notice or notice in self._said:
            return stage, ""
        self._said.add(notice)
        return stage, f"{task}: {notice}"


class Bars:
    """One bar per task that has begun, and one of all together where there are several, drawn by rich on standard
    error (or on `console`, a rich.console.Console). Notices stand above the bars.
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
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.fields[text]}"),
            console=console or Console(stderr=True),
        )
        self._known: dict[str, TaskID] = {}
        self._shares: dict[str, float] = {}
        self._begun: dict[str, tuple[float, float]] = {}
        self._all: TaskID | None = None
        self._notices = Notices()
        self._bars.start()

    def update(self, task: str, share: float, text: str) -> None:
        """Draw how far a task is; one that waits has no bar yet but counts."""
        self._shares[task] = share
        text, notice = self._notices.separate(task, text)
        if notice:
            self._bars.console.print(notice, markup=False, highlight=False)
        if text != WAITING:
            if task not in self._known:
                self._known[task] = self._bars.add_task(task, total=1.0, text=text, left="")
                self._begun[task] = (time.monotonic(), share)
            done = share >= 1.0
            self._bars.update(
                self._known[task], completed=share, text=text, visible=not done or len(self._shares) <= _MOST_BARS,
                left=time_left(self._begun[task], share, time.monotonic()),
            )  # fmt: skip
        if len(self._shares) > 1:
            self._draw_all()

    def _draw_all(self) -> None:
        if self._all is None:
            self._all = self._bars.add_task("together", total=1.0, text="", left="")
        done = sum(share >= 1.0 for share in self._shares.values())
        waiting = len(self._shares) - len(self._known)
        text = f"{done} of {len(self._shares)} parts done" + (f", {waiting} not begun" if waiting else "")
        self._bars.update(self._all, completed=sum(self._shares.values()) / len(self._shares), text=text)

    def close(self) -> None:
        """Leave the terminal as it was found, the bars as they were last."""
        self._bars.stop()


_SURE_FROM = 0.1
"""Share of a task from which the time that it took shows what it will take, with `_SURE_S` seconds at least."""
_SURE_S = 5.0


def time_left(begun: tuple[float, float], share: float, now: float) -> str:
    """`about 40 s left`, of a task of which a share is done; "" where that says nothing yet.

    begun : time (s) and share, above 0 if a stopped run goes on, at which it began; now : s.
    """
    seconds, done = now - begun[0], share - begun[1]
    if share >= 1.0 or done < _SURE_FROM or seconds < _SURE_S:
        return ""
    left = seconds * (1.0 - share) / done
    if left < 57.5:
        return f"about {max(5 * round(left / 5.0), 5)} s left"
    return f"about {round(left / 60.0)} min left" if left < 5400.0 else f"about {left / 3600.0:.1f} h left"


_SILENT_S = 30.0
"""Seconds after which many alike steps report how many of them are done."""
_REPEATED_S = 60.0
"""Seconds after which a stage that lasts is reported again."""


@dataclass
class _Part:
    """A task as lines report it: time (s) and share when it began, time of its last line, and its stage then."""

    begun: tuple[float, float] | None = None
    reported: float = 0.0
    stage: str = ""
    done: bool = False


class Lines:
    """A line for each task that begins, for each of its stages and for its end, with the time since all began.

    A stage that lasts is reported again once a minute. file : default standard error; clock : s.
    """

    def __init__(self, file: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._file, self._clock = file, clock
        self._begun = clock()
        self._parts: dict[str, _Part] = {}
        self._notices = Notices()

    def write(self, text: str) -> None:
        """Write one line."""
        print(f"{_hours(self._clock() - self._begun)}  {text}", file=self._file or sys.stderr, flush=True)

    def update(self, task: str, share: float, text: str) -> None:
        """Report how far a task is, where that is news."""
        part = self._parts.setdefault(task, _Part())
        text, notice = self._notices.separate(task, text)
        if notice:
            self.write(notice)
        if text == WAITING or part.done:
            return
        now = self._clock()
        if part.begun is None:
            part.begun = now, share
        stage, part.done = _stage(text), share >= 1.0
        if stage == part.stage and not part.done and now - part.reported < _REPEATED_S:
            return
        part.stage, part.reported = stage, now
        left = time_left(part.begun, share, now)
        how_far = f"{share:.0%} done, {left}" if left else f"{share:.0%} done"
        self.write(f"{task}: {self._ended(part, text)}" if part.done else f"{task}, {how_far}: {text}")

    def _ended(self, part: _Part, text: str) -> str:
        assert part.begun is not None
        left = sum(not p.done for p in self._parts.values())
        waiting = sum(p.begun is None for p in self._parts.values())
        ending = f"{text} in {_hours(part.reported - part.begun[0])}" if part.reported > part.begun[0] else text
        if len(self._parts) > 1:
            ending += f"; left: {left} of {len(self._parts)} parts" + (f", {waiting} not begun" if waiting else "")
        return ending

    def close(self) -> None:
        """Nothing to close."""


def _stage(text: str) -> str:
    """What a text says without the numbers that move on within a stage: its words before the first of them."""
    return re.split(r"[,;]|\d", text, maxsplit=1)[0].strip()


def _hours(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


class _Quiet(Silent):
    def close(self) -> None:
        """Nothing to close."""


def make_progress(quiet: bool) -> Any:
    """Bars where standard error is a terminal, lines elsewhere, nothing for `quiet`; who makes it closes it."""
    progress: Progress = _Quiet() if quiet else Bars() if sys.stderr.isatty() else Lines()
    return progress


def now_and_then(
    report: Callable[[str], None], total: int, what: str, clock: Callable[[], float] = time.monotonic
) -> Callable[[int], None]:
    """What reports `3 of 31 fitted, 0:05:10 left`, where half a minute has passed since it last did or was made.

    what : the words behind the numbers; the function takes how many are done. The time left is that of as many more
    steps as are missing, each as long as those done were on average.
    """
    begun = last = clock()

    def each(done: int) -> None:
        nonlocal last
        now = clock()
        if 0 < done < total and now - last >= _SILENT_S:
            last = now
            report(f"{done} of {total} {what}, {_hours((now - begun) / done * (total - done))} left")

    return each


def make_reporter(quiet: bool) -> Callable[[str], None]:
    """What reports the stages of a command that has no parts: lines, or nothing for `quiet`."""
    return (lambda _: None) if quiet else Lines().write
