"""A diagnosis that is stopped while it draws leaves no diagnosis.json: the folder does not look whole."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from campaigns import write_synthetic

from bayes_damper.commands import diagnose as command


def test_a_diagnosis_stopped_while_drawing_does_not_look_whole(tmp_path, monkeypatch):
    out = tmp_path / "out"
    found = SimpleNamespace(
        site_map=None, nominal=None, best=None, law=None, weighed_fits=list,
        to_json=lambda: {"parameters": {}, "pair": None, "effects": [], "budget": {"effects": []}},
    )  # fmt: skip
    monkeypatch.setattr(command, "diagnose_campaign", lambda *_, **__: found)
    monkeypatch.setattr(command, "write_missing_torque", lambda *_: None)
    monkeypatch.setattr(command, "forecasts", lambda *_: [])
    monkeypatch.setattr(command, "_draw", lambda *_: None)
    campaign = write_synthetic(tmp_path / "campaign", repeats=1, rate=200.0)
    command.diagnose(campaign, out=out)
    assert (out / "diagnosis.json").exists()

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "_draw", stopped)
    with pytest.raises(KeyboardInterrupt):
        command.diagnose(campaign, out=out)
    assert not (out / "diagnosis.json").exists(), "not even that of the run before"
