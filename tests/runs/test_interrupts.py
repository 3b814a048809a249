"""Ctrl-C ends a run wherever it comes."""

from __future__ import annotations

import ctypes
import sys
import time

import pytest

from bayes_damper.runs.interrupts import interrupts_passed_on


def stopped():
    raise KeyboardInterrupt


def test_ctrl_c_in_a_callback_of_a_library_is_not_lost(capfd):
    callback = ctypes.CFUNCTYPE(None)(stopped)
    before = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), interrupts_passed_on():
        callback()
        time.sleep(10.0)
    assert sys.unraisablehook is before
    assert "Traceback" not in capfd.readouterr().err


def test_other_errors_in_a_callback_are_shown_as_before(monkeypatch):
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: seen.append(lost.exc_type))
    with interrupts_passed_on():
        ctypes.CFUNCTYPE(None)(lambda: [][0])()
    assert seen == [IndexError]
