"""Ctrl-C ends a run wherever it comes."""

from __future__ import annotations

import ctypes
import signal
import sys
import time

import pytest

from bayes_damper.runs.interrupts import interrupts_passed_on


def stopped():
    raise KeyboardInterrupt


def failed():
    raise IndexError


def loading(callback):
    callback()
    for _ in range(100):
        time.sleep(0.1)


def test_ctrl_c_in_a_callback_of_a_library_is_not_lost(capfd):
    handled = signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs have not
    callback = ctypes.CFUNCTYPE(None)(stopped)
    before = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), interrupts_passed_on():
        loading(callback)
    signal.signal(signal.SIGINT, handled)
    assert sys.unraisablehook is before
    assert "Traceback" not in capfd.readouterr().err


def test_other_errors_in_a_callback_are_shown_as_before(monkeypatch):
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: seen.append(lost.exc_type))
    with interrupts_passed_on():
        ctypes.CFUNCTYPE(None)(failed)()
    assert seen == [IndexError]
