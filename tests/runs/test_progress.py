"""What a user sees of a long run: bars that tell what remains, and a terminal left as it was found."""

from __future__ import annotations

import io
import re
from importlib import import_module

import pytest
from rich.console import Console

from bayes_damper import cli
from bayes_damper.errors import ExitCode, InputError, Interrupted
from bayes_damper.runs.execution import WAITING, Task, run_tasks
from bayes_damper.runs.progress import Bars, Lines, now_and_then, time_left


def seen(updates) -> str:
    """What stands in a terminal at last after these updates."""
    screen = io.StringIO()
    bars = Bars(Console(file=screen, force_terminal=True, width=100, color_system=None))
    for update in updates:
        bars.update(*update)
    bars.close()
    written = screen.getvalue()
    assert written.count("\x1b[?25h") >= written.count("\x1b[?25l") == 1, "the cursor stays hidden"
    return written.rpartition("\x1b[2K")[2]


def test_bars_tell_what_is_done_and_what_has_not_begun():
    last = seen([("joint", 0.0, WAITING), ("IV", 0.0, WAITING), ("III", 0.0, WAITING), ("joint", 1.0, "done"),
                 ("IV", 0.5, "drawing")])  # fmt: skip
    assert "1 of 3 parts done, 1 not begun" in last
    assert "50 %" in last
    assert "III" not in last


def test_of_many_parts_only_those_at_work_have_a_bar():
    names = [f"part{i:02}" for i in range(30)]
    updates = [(name, 0.0, WAITING) for name in names] + [(name, 1.0, "done") for name in names[:20]]
    last = seen([*updates, (names[20], 0.3, "at work")])
    assert "20 of 30 parts done, 9 not begun" in last
    assert "part20" in last
    assert "part19" not in last


def lines(updates) -> list[str]:
    """What a log holds after these updates, each with the seconds since the one before it."""
    log, now = io.StringIO(), [0.0]
    told = Lines(log, lambda: now[0])
    for seconds, *update in updates:
        now[0] += seconds
        told.update(*update)
    told.close()
    assert "\r" not in log.getvalue()
    return log.getvalue().splitlines()


def test_a_log_has_a_line_for_each_stage_and_each_end_with_what_is_left():
    assert lines([
        (0, "joint", 0.0, WAITING),
        (0, "IV", 0.0, WAITING),
        (1, "joint", 0.0, "finding the best fit"),
        (1, "joint", 0.0, "finding the best fit"),
        (10, "joint", 0.05, "warm-up, 50 steps"),
        (10, "joint", 0.05, "warm-up, 100 steps"),
        (10, "joint", 0.12, "drawing, 25 of about 75 steps"),
        (59, "joint", 0.3, "drawing, 50 of about 75 steps"),
        (1, "joint", 0.7, "drawing, 75 of about 75 steps"),
        (3600, "joint", 1.0, "done"),
        (0, "joint", 1.0, "done"),
        (1, "IV", 1.0, "done before"),
    ]) == [
        "0:00:01  joint, 0% done: finding the best fit",
        "0:00:12  joint, 5% done: warm-up, 50 steps",
        "0:00:32  joint, 12% done, about 4 min left: drawing, 25 of about 75 steps",
        "0:01:32  joint, 70% done, about 40 s left: drawing, 75 of about 75 steps",
        "1:01:32  joint: done in 1:01:31; left: 1 of 2 parts, 1 not begun",
        "1:01:33  IV: done before; left: 0 of 2 parts",
    ]  # fmt: skip


@pytest.mark.parametrize(("words", "begins"), [(["fit"], r"0:00:0\d  IV, 0% done: fitting"), (["fit", "--quiet"], ""),
                                               (["fit", "--json"], ""), (["diagnose"], r"0:00:0\d  screening"),
                                               (["diagnose", "--quiet"], "")])  # fmt: skip
def test_commands_without_a_terminal_tell_in_lines_unless_asked_for_quiet(words, begins, monkeypatch, capsys):
    def run(*_, progress=None, report=None, **__):
        if progress is not None:
            progress.update("IV", 0.0, "fitting")
        if report is not None:
            report("screening")
        return FoundPlain()

    monkeypatch.setattr("bayes_damper.fit", run)
    monkeypatch.setattr("bayes_damper.diagnose", run)
    assert cli.main([*words, "somewhere"]) == 0
    told = capsys.readouterr().err
    assert re.match(begins, told) if begins else told == ""


class FoundPlain:
    exit_code = ExitCode.DONE

    def text(self):
        return "found"

    def to_json(self):
        return {}


class Shown:
    """Progress that remembers."""

    def __init__(self):
        self.told, self.closed = [], False

    def update(self, task, share, text):
        self.told.append((task, share, text))

    def close(self):
        self.closed = True


class Found:
    exit_code = ExitCode.DONE

    def __init__(self, shown):
        self.shown = shown

    def text(self):
        assert self.shown.closed, "the result is printed between the bars"
        return "found"


@pytest.mark.parametrize("error", [None, InputError("bad"), Interrupted("stopped"), KeyboardInterrupt()])
def test_bars_are_closed_before_anything_is_printed(error, monkeypatch, capsys):
    shown = Shown()

    def fit(*_, progress, **__):
        if error is not None:
            raise error
        return Found(progress)

    monkeypatch.setattr(import_module("bayes_damper.runs.progress"), "make_progress", lambda quiet: shown)
    monkeypatch.setattr("bayes_damper.fit", fit)
    code = cli.main(["fit", "somewhere"])
    assert shown.closed
    printed = capsys.readouterr()
    assert printed.out == ("found\n" if error is None else "")
    assert code == (0 if error is None else 2 if isinstance(error, InputError) else 130)


def interrupted(folder, report):
    """A task that Ctrl-C stops once its state is saved."""
    del folder, report
    raise Interrupted("Stopped by the user; the state is saved in its folder.")


def test_a_stopped_run_says_how_it_goes_on(tmp_path):
    shown = Shown()
    with pytest.raises(Interrupted, match=f"the state is saved; go on with: bayes-damper resume {tmp_path}"):
        run_tasks([Task(n, interrupted) for n in ("a", "b")], tmp_path, progress=shown)
    assert shown.told == [("a", 0.0, WAITING), ("b", 0.0, WAITING)]


def test_many_alike_steps_say_now_and_then_how_many_are_done():
    now, said = [0.0], []
    each = now_and_then(said.append, 5, "fitted", lambda: now[0])
    for done, seconds in enumerate((10, 21, 5, 26, 90), 1):
        now[0] += seconds
        each(done)
    # The last one is the end, which the next stage shows.
    assert said == ["2 of 5 fitted, 0:00:46 left", "4 of 5 fitted, 0:00:15 left"]


def test_a_notice_is_shown_once_on_a_line_of_its_own():
    """Tasks repeat it with each stage, and several have the same to say; an 80-column bar would cut it."""
    notice = "THE MODEL MISSES SOMETHING: " + "run another command " * 4
    updates = [
        ("IV", 0.0, "finding the best fit"),
        ("IV", 0.0, f"estimating the noise\n{notice}"),
        ("joint", 0.0, f"estimating the noise\n{notice}"),
        ("IV", 0.05, f"warm-up, 50 steps\n{notice}"),
        ("IV", 0.1, "warm-up, 100 steps\nanother"),
    ]
    assert lines([(1, *update) for update in updates]) == [
        "0:00:01  IV, 0% done: finding the best fit",
        f"0:00:02  IV: {notice}",
        "0:00:02  IV, 0% done: estimating the noise",
        "0:00:03  joint, 0% done: estimating the noise",
        "0:00:04  IV, 5% done: warm-up, 50 steps",
        "0:00:05  IV: another",
    ]
    screen = io.StringIO()
    bars = Bars(Console(file=screen, force_terminal=True, width=80, color_system=None))
    for update in updates:
        bars.update(*update)
    bars.close()
    shown = " ".join(screen.getvalue().split())
    assert shown.count(f"IV: {notice}".strip()) == 1
    assert shown.count("THE MODEL MISSES SOMETHING") == 1


@pytest.mark.parametrize(
    ("begun", "share", "now", "left"),
    [
        ((0.0, 0.0), 0.05, 30.0, ""),  # too little of it to judge by
        ((0.0, 0.0), 0.5, 3.0, ""),
        ((0.0, 0.0), 1.0, 60.0, ""),
        ((100.0, 0.0), 0.25, 110.0, "about 30 s left"),
        ((0.0, 0.0), 0.99, 60.0, "about 5 s left"),
        ((0.0, 0.0), 0.2, 60.0, "about 4 min left"),
        ((0.0, 0.5), 0.625, 60.0, "about 3 min left"),  # a stopped run that goes on
        ((0.0, 0.0), 0.1, 3600.0, "about 9.0 h left"),
    ],
)
def test_the_time_left_follows_from_what_was_done_since_the_task_began(begun, share, now, left):
    assert time_left(begun, share, now) == left
