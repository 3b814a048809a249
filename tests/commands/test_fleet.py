"""Several campaigns in one command: the verdict of each alone, a page for each, one of all, and going on."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from campaigns import write_synthetic

from bayes_damper import cli
from bayes_damper.commands import fleet
from bayes_damper.commands.diagnose import diagnose
from bayes_damper.commands.fleet import diagnose_fleet, sentences
from bayes_damper.commands.resume import resume
from bayes_damper.errors import InputError, Interrupted
from bayes_damper.runs.json_files import read_json, write_json


def told(verdict="none", p=0.8):
    """What diagnosis.json of one campaign holds, as far as the table reads it."""
    return {
        "schema": "bayes-damper/diagnosis/1", "verdict": verdict, "probabilities": {verdict: p, "unknown": 1.0 - p},
        "credible_set": [verdict, "unknown"], "sites": {"ground1": 1.0 - p, "none": p}, "campaign_sha256": "0",
        "gap": {"answer": "none", "closed": {"median": 0.5}}, "warnings": [],
    }  # fmt: skip


@pytest.fixture
def rigs(tmp_path):
    """Two sound campaigns."""
    return [write_synthetic(tmp_path / name, repeats=1, rate=200.0, seed=k) for k, name in enumerate(("left", "right"))]


@pytest.fixture
def answered(monkeypatch):
    """In place of the diagnosis: an answer at once, or a stop for the campaigns in `stops`; `seen`: who was asked."""
    asked = SimpleNamespace(seen=[], stops=set())

    def answer(campaign, *, out, **_):
        name = out.name
        if name in asked.stops:
            raise KeyboardInterrupt
        asked.seen.append(name)
        write_json(out / "diagnosis.json", told("spring_cubic" if name == "right" else "none"))
        return SimpleNamespace(result=read_json(out / "diagnosis.json"))

    monkeypatch.setattr(fleet, "diagnose", answer)
    return asked


def test_each_campaign_has_a_folder_and_a_page_and_one_table_holds_all(tmp_path, rigs, answered):
    found = diagnose_fleet(rigs, out=tmp_path / "out", workers=1)
    held = json.loads((tmp_path / "out/fleet.json").read_text())
    assert [(r["name"], r["verdict"], r["closed"]) for r in held["campaigns"]] == [
        ("left", "none", None), ("right", "spring_cubic", 0.5),
    ]  # fmt: skip
    page = found.page.read_text()
    for name in ("left", "right"):
        assert (tmp_path / "out" / name / "report.html").is_file()
        assert f'href="{name}/report.html"' in page
    assert page.count("<h2>Diagnosis") == 0, "the diagnoses stand on pages of their own"
    assert "0.4 of these answers" in found.text()


def test_a_stopped_run_goes_on_with_what_is_missing(tmp_path, rigs, answered):
    answered.stops = {"right"}
    with pytest.raises(Interrupted, match="bayes-damper resume"):
        diagnose_fleet(rigs, out=tmp_path / "out", workers=1)
    answered.stops = set()
    found = resume(tmp_path / "out")
    assert answered.seen == ["left", "right"]
    assert found.text() == diagnose_fleet(rigs, out=tmp_path / "out", workers=1).text()
    assert answered.seen == ["left", "right"], "nothing is diagnosed twice"


def test_a_folder_with_another_run_is_refused(tmp_path, rigs, answered):
    diagnose_fleet(rigs, out=tmp_path / "out", workers=1)
    with pytest.raises(InputError, match="with other seed"):
        diagnose_fleet(rigs, out=tmp_path / "out", workers=1, seed=2)
    with (rigs[0] / "campaign.toml").open("a") as file:
        file.write("\n# another one\n")
    with pytest.raises(InputError, match="with other sha256"):
        diagnose_fleet(rigs, out=tmp_path / "out", workers=1)
    write_json(tmp_path / "single/diagnosis.json", told())
    with pytest.raises(InputError, match="diagnosis of one campaign"):
        diagnose_fleet(rigs, out=tmp_path / "single", workers=1)


def test_faults_of_every_campaign_are_named_before_any_work(tmp_path, rigs, answered, capsys):
    broken = [tmp_path / "absent", tmp_path / "empty"]
    broken[1].mkdir()
    assert cli.main(["diagnose", *map(str, (*broken, *rigs)), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert all(str(path) in error for path in broken)
    for bad, words in ((["thesis", rigs[0]], "diagnose them alone"), ([rigs[0], rigs[0]], "named twice")):
        with pytest.raises(InputError, match=words):
            diagnose_fleet(bad, out=tmp_path / "out")
    with pytest.raises(InputError, match="no such file"):
        diagnose_fleet(rigs, out=tmp_path / "out", priors=tmp_path / "none.toml")
    assert cli.main(["diagnose", str(rigs[0]), "--scheduler", "tcp://nowhere:1"]) == 2
    assert answered.seen == []
    assert not (tmp_path / "out").exists()


def test_folders_of_the_same_name_are_kept_apart(tmp_path, answered):
    paths = [write_synthetic(tmp_path / above / "rig", repeats=1, rate=200.0) for above in ("old", "new")]
    diagnose_fleet(paths, out=tmp_path / "out", workers=1)
    assert answered.seen == ["old-rig", "new-rig"]


def test_answers_are_counted_with_how_many_are_expected_to_be_wrong():
    rows = [{"verdict": v, "probability": p} for v, p in (("none", 0.9), ("none", 0.7), ("unknown", 0.6))]
    first, second = sentences(rows)
    assert first == "3 campaigns: nothing missing 2, a cause outside the library 1."
    assert "0.8 of these" in second


@pytest.mark.slow
def test_the_verdict_is_that_of_the_campaign_alone(tmp_path):
    paths = [
        write_synthetic(tmp_path / name, repeats=n, rate=200.0, seed=n, duration=0.5 * n, configurations=("uncoupled",))
        for n, name in enumerate(("left", "right"), start=1)
    ]
    found = diagnose_fleet(paths, out=tmp_path / "out", workers=2)
    for path in paths[1:]:
        alone = diagnose(path, out=tmp_path / "alone" / path.name, workers=2).result
        inside = read_json(tmp_path / "out" / path.name / "diagnosis.json")
        assert inside["probabilities"] == alone["probabilities"]
        assert inside["verdict"] == next(r for r in found.result["campaigns"] if r["name"] == path.name)["verdict"]
