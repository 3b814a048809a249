"""A diagnosis that is stopped goes on with the fits that it has made, and its folder does not look whole."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from campaigns import write_synthetic

from bayes_damper.calibration import least_squares
from bayes_damper.commands import diagnose as command
from bayes_damper.commands.resume import resume
from bayes_damper.errors import InputError, Interrupted
from bayes_damper.runs.json_files import read_json


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
    with pytest.raises(Interrupted, match="bayes-damper resume"):
        command.diagnose(campaign, out=out)
    assert not (out / "diagnosis.json").exists(), "not even that of the run before"


def stopped_at(words):
    """Reports nothing, and presses Ctrl-C at a sentence that begins so."""

    def report(sentence):
        if sentence.startswith(words):
            raise KeyboardInterrupt

    return report


def values_of(out):
    found = read_json(out / "diagnosis.json")
    return {key: value for key, value in found.items() if key not in ("provenance", "seconds")}


@pytest.mark.slow
def test_a_stopped_diagnosis_goes_on_to_the_same_result(tmp_path, monkeypatch):
    campaign = write_synthetic(tmp_path / "campaign", repeats=2, rate=200.0, configurations=["uncoupled"], duration=0.5)
    made = []
    descend = least_squares._descend

    def counted(*given, **options):
        made.append(given)
        return descend(*given, **options)

    monkeypatch.setattr(least_squares, "_descend", counted)
    command.diagnose(campaign, out=tmp_path / "whole", workers=1)
    whole = len(made)
    out = tmp_path / "out"
    with pytest.raises(Interrupted, match="bayes-damper resume"):
        command.diagnose(campaign, out=out, workers=1, report=stopped_at("testing the residuals"))
    begun = len(made) - whole
    resume(out)
    assert len(made) == 2 * whole, "nothing is fitted twice"
    assert begun > whole / 2
    assert values_of(out) == values_of(tmp_path / "whole")
    assert not (out / "unfinished").exists()


def test_a_stopped_diagnosis_of_other_data_begins_anew(tmp_path):
    campaign = write_synthetic(tmp_path / "campaign", repeats=1, rate=200.0, configurations=["uncoupled"])
    out = tmp_path / "out"
    fits = out / "unfinished/fits"
    with pytest.raises(Interrupted):
        command.diagnose(campaign, out=out, report=stopped_at("nominal model fitted"))
    assert list(fits.iterdir())
    (fits / "of the first run").touch()
    for seed, left in ((1, True), (2, False)):
        with pytest.raises(Interrupted):
            command.diagnose(campaign, out=out, seed=seed, report=stopped_at("nominal model fitted"))
        assert (fits / "of the first run").exists() == left
    trial = next((campaign / "trials").iterdir())
    trial.write_text(trial.read_text().replace("0.05,", "0.050,", 1))
    with pytest.raises(InputError, match="has changed since its diagnosis"):
        resume(out)
