"""The check on withheld data: seals, the closed key, rehearsals, honest scores; with a diagnosis that is made up."""

import itertools
import json
import math
import zipfile
from types import SimpleNamespace

import fake_diagnosis
import numpy as np
import pytest

from bayes_damper.cli import main
from bayes_damper.diagnosis.verdict import credible_set
from bayes_damper.effects import all_effects
from bayes_damper.errors import ExitCode, InputError, Interrupted, SelfCheckError
from bayes_damper.inputs import shipped_path
from bayes_damper.validation.withheld import archive as archives
from bayes_damper.validation.withheld import baselines, check, scores, sealing, verify
from bayes_damper.validation.withheld.baselines import forest_out_of_fold
from validation.proofs import page, together

GROUPS = [frozenset({"friction_displacement", "normal_force_law"})]
ANSWERS = ("spring_cubic", "sensor_gain", "stick_slip", "none")
SITE = {"spring_cubic": "ground1", "sensor_gain": "sensor", "stick_slip": "interface", "none": "none"}


def sealed(home):
    """Name -> seal of the verdicts that a run has sealed so far."""
    names = sealing.read_freeze(home / "freeze.json")["campaigns"]
    paths = {name: sealing.verdict_path(home, name) for name in names}
    return {name: json.loads(path.read_text())["seal"] for name, path in paths.items() if path.exists()}


def entry(truth, *, kind="easy", level=0.5, visible=500.0, standing="library", site=None, effects=None):
    """An entry of a key."""
    none = truth == "none"
    return {
        "kind": kind, "truth": truth, "effects": effects or ([] if none else [truth]),
        "class": None if none else [truth], "standing": None if none else standing,
        "site": site or SITE.get(truth, "ground1"),
        "level_wanted": 0.0 if none else level, "visible_chi2": 0.0 if none else visible,
        "nominal": {"mu": 0.005, "k2t": 1.6}, "disturbances": [{"shape": [0.3, 0.01, 0.0]}],
    }  # fmt: skip


def seal_campaigns(folder, *, code=True):
    """Bind a set of campaigns to its key and, unless code is False, to the code of this moment; the file written."""
    key = folder.parent / f"{folder.name}_key.json"
    frozen = sealing.freeze(check.find_campaigns(folder), key, all_effects(), 0, check.name_of(check.verdict_of))
    data = ("schema", "key_sha256", "campaigns", "written")
    kept = frozen if code else {name: frozen[name] for name in data}
    sealing.write_freeze(check.seal_path(key), kept)
    return check.seal_path(key)


def said(verdict, p=0.95, **more):
    """A verdict that gives one answer the probability p and `none` (or `unknown`) the rest."""
    rest = "none" if verdict != "none" else "unknown"
    return {"verdict": verdict, "probabilities": {verdict: p, rest: 1.0 - p}, "credible_set": [verdict], **more}


def write_set(home, truths, answers=None, deadly=None):
    """Campaigns that the made-up diagnosis can read, and their key; returns the folder."""
    folder = home / "set"
    key = {"schema": sealing.KEY_SCHEMA, "salt": "s", "campaigns": {}}
    for i, truth in enumerate(truths):
        name = f"c{i:02d}"
        (folder / name).mkdir(parents=True)
        (folder / name / "campaign.toml").write_text(f'name = "{name}"\n')
        told = answers[i] if answers else {truth: 0.92, "none" if truth != "none" else "stick_slip": 0.08}
        (folder / name / "answer.json").write_text(json.dumps(told))
        key["campaigns"][name] = entry(truth)
    if deadly is not None:
        (home / f"{deadly}.deadly").touch()
    (home / "set_key.json").write_text(json.dumps(key))
    return folder


def run(home, call="answer", **options):
    """The check on the set in `home`, in this process unless told otherwise."""
    options = {"workers": 1, "out": home / "out", **options}
    return check.withheld(home / "set", diagnose_with=getattr(fake_diagnosis, call), **options)


def calls(home):
    return [line.split()[0] for line in (home / "calls.log").read_text().splitlines()]


# Seals ----------------------------------------------------------------------------------------------------------------


def test_a_run_seals_every_verdict_and_scores(tmp_path):
    write_set(tmp_path, ["spring_cubic", "none", "sensor_gain", "stick_slip"])
    found = run(tmp_path)
    told = json.loads((tmp_path / "out/withheld.json").read_text())
    assert told == found.to_json()
    assert told["schema"] == "bayes-damper/withheld/1"
    assert not found.rehearsal
    assert found.exit_code == ExitCode.DONE
    assert told["scores"]["all"]["right_first"]["hits"] == 3
    assert told["scores"]["all"]["none_kept"]["hits"] == 1
    assert told["scores"]["confusion"]["stick_slip"] == {"stick_slip": 1}
    assert told["campaigns"]["c00"]["probabilities"]["spring_cubic"] == 0.92
    frozen = sealing.read_freeze(tmp_path / "out/freeze.json")
    seals = sealed(tmp_path / "out")
    assert told["chain_head"] == sealing.chain(frozen["seal"], seals)[-1]
    assert "right effect first" in found.text()
    assert (tmp_path / "out/withheld.png").stat().st_size > 10_000
    again = run(tmp_path)
    assert len(calls(tmp_path)) == 4, "a finished run must not diagnose again"
    assert again.results["scores"] == told["scores"]


def test_a_set_of_pairs_alone_is_scored_and_drawn(tmp_path):
    write_set(tmp_path, ["spring_cubic", "stick_slip"])
    key = json.loads((tmp_path / "set_key.json").read_text())
    for name in key["campaigns"]:
        key["campaigns"][name] = entry("pair", effects=["spring_cubic", "stick_slip"], site=["ground1", "interface"])
    (tmp_path / "set_key.json").write_text(json.dumps(key))
    found = run(tmp_path)
    assert found.results["scores"]["all"]["pairs_both_named"]["n"] == 2
    assert found.results["scores"]["confusion"] == {}
    assert (tmp_path / "out/withheld.png").stat().st_size > 1000


def test_a_verdict_changed_after_its_seal_is_found(tmp_path):
    write_set(tmp_path, ["spring_cubic", "none"])
    run(tmp_path)
    path = sealing.verdict_path(tmp_path / "out", "c00")
    path.write_text(path.read_text().replace("0.92", "0.93"))
    with pytest.raises(SelfCheckError, match="broken seal") as caught:
        run(tmp_path)
    assert caught.value.exit_code == ExitCode.SELF_CHECK_FAILED == 4


def test_a_verdict_replaced_with_a_good_seal_breaks_the_chain(tmp_path):
    write_set(tmp_path, ["spring_cubic", "none"])
    run(tmp_path)
    path = sealing.verdict_path(tmp_path / "out", "c00")
    content = json.loads(path.read_text())
    sealing.write_verdict(path, "c00", said("none"), content["freeze"])
    with pytest.raises(SelfCheckError, match="replaced"):
        run(tmp_path)


@pytest.mark.parametrize("what", ["set_key.json", "set/c01/answer.json", "out/freeze.json"])
def test_key_campaigns_and_freeze_must_stay_what_they_were(tmp_path, what):
    write_set(tmp_path, ["spring_cubic", "none"])
    run(tmp_path)
    path = tmp_path / what
    path.write_text(path.read_text().replace("s", "t", 1))
    with pytest.raises(SelfCheckError, match="broken seal"):
        run(tmp_path)


def test_the_key_stays_closed_while_a_verdict_is_missing(tmp_path):
    folder = write_set(tmp_path, ["spring_cubic", "none", "sensor_gain"])
    key = tmp_path / "set_key.json"
    key.write_text("this would fail if anybody read it as JSON")
    campaigns = check.find_campaigns(folder)
    now = sealing.freeze(campaigns, key, {}, 1, "fake")
    frozen = sealing.write_freeze(tmp_path / "out/freeze.json", now)
    for name in ("c00", "c02"):
        sealing.write_verdict(sealing.verdict_path(tmp_path / "out", name), name, said("none"), frozen["seal"])
    with pytest.raises(SelfCheckError, match=r"stays closed: 1 of 3 .*c01"):
        sealing.open_key(tmp_path / "out", key, campaigns, now)
    sealing.write_verdict(sealing.verdict_path(tmp_path / "out", "c01"), "c01", said("none"), frozen["seal"])
    with pytest.raises(InputError, match="not valid JSON"):
        sealing.open_key(tmp_path / "out", key, campaigns, now)


def test_a_verdict_of_another_run_does_not_count(tmp_path):
    path = tmp_path / "verdict.json"
    sealing.write_verdict(path, "c00", said("none"), "seal of another run")
    with pytest.raises(SelfCheckError, match="another campaign or run"):
        sealing.read_verdict(path, "c00", "seal of this run")


def test_code_changed_since_the_seal_makes_a_rehearsal(tmp_path, monkeypatch):
    write_set(tmp_path, ["spring_cubic", "none"])
    assert not run(tmp_path).rehearsal
    monkeypatch.setattr(sealing, "code_sha256", lambda *roots: "0" * 64)
    same_run = run(tmp_path)
    assert same_run.rehearsal
    assert "REHEARSAL" in same_run.text()
    new_run = run(tmp_path, out=tmp_path / "fresh")
    assert new_run.rehearsal, "campaigns that were scored once are bound to the code of that time"
    assert "code of the diagnosis has changed" in new_run.results["why_rehearsal"][0]
    fresh = tmp_path / "new"
    fresh.mkdir()
    write_set(fresh, ["spring_cubic"])
    assert not run(fresh).rehearsal, "fresh campaigns may be scored by the changed code"


def test_verdicts_given_by_other_code_make_a_rehearsal(tmp_path, monkeypatch):
    write_set(tmp_path, ["spring_cubic", "none"], deadly="c01")
    with pytest.raises(Interrupted):
        run(tmp_path, "stopped_once")
    path = sealing.verdict_path(tmp_path / "out", "c00")
    content = json.loads(path.read_text())
    with monkeypatch.context() as patch:
        patch.setattr(sealing, "code_sha256", lambda *roots: "0" * 64)
        sealing.write_verdict(path, "c00", content["verdict"], content["freeze"])
    assert "other code than was frozen" in run(tmp_path, "stopped_once").results["why_rehearsal"][0]


def test_campaigns_may_be_sealed_before_anybody_runs_them(tmp_path, monkeypatch):
    folder = write_set(tmp_path, ["spring_cubic", "none"])
    assert seal_campaigns(folder) == tmp_path / "set_seal.json"
    assert not run(tmp_path).rehearsal
    monkeypatch.setattr(sealing, "library_sha256", lambda _: "0" * 64)
    assert "library of effects" in run(tmp_path, out=tmp_path / "later").results["why_rehearsal"][0]


def test_another_seed_needs_another_folder(tmp_path):
    write_set(tmp_path, ["none"])
    run(tmp_path)
    with pytest.raises(InputError, match="another seed"):
        run(tmp_path, seed=2)


def test_the_seeds_of_campaigns_do_not_depend_on_the_others(tmp_path):
    write_set(tmp_path, ["none", "spring_cubic"])
    run(tmp_path)
    seeds = [line.split()[1] for line in (tmp_path / "calls.log").read_text().splitlines()]
    part = check._Run(tmp_path, {}, 1, "", 1, None, None, {}, {})
    assert seeds == [str(part.seed_of("c00")), str(part.seed_of("c01"))]
    assert seeds[0] != seeds[1]


def test_no_campaigns_or_no_key_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="holds no campaigns"):
        check.withheld(tmp_path, out=tmp_path / "out")
    write_set(tmp_path, ["none"])
    (tmp_path / "set_key.json").unlink()
    with pytest.raises(InputError, match="--key"):
        run(tmp_path)


def renamed(home, letter):
    """The set of `home` with other names of its campaigns."""
    key = json.loads((home / "set_key.json").read_text())
    key["campaigns"] = {letter + name[1:]: row for name, row in key["campaigns"].items()}
    (home / "set_key.json").write_text(json.dumps(key))
    for folder in list((home / "set").iterdir()):
        folder.rename(folder.with_name(letter + folder.name[1:]))


def test_runs_are_scored_together(tmp_path, capsys):
    """Counts add up, taken-out effects too; a campaign that is in two runs, or a run that is not done, is refused."""
    truths = (["spring_cubic", "none"], ["sensor_gain", "none", "none"])
    parts = []
    for home, own in zip((tmp_path / "one", tmp_path / "two"), truths, strict=True):
        home.mkdir()
        write_set(home, own)
        renamed(home, home.name[0])
        run(home, full=True)
        parts += [home / "out", home / "set_key.json"]
    assert together.main([str(tmp_path / "both"), *map(str, parts)]) == 0
    told = json.loads((tmp_path / "both/withheld.json").read_text())
    assert told["scores"]["all"]["campaigns"] == 5
    assert told["scores"]["all"]["none_kept"]["n"] == 3
    assert told["leave_one_out"]["campaigns"] == 2
    assert len(told["parts"]) == 2
    assert (tmp_path / "both/withheld.svg").exists()
    assert "5 campaigns" in capsys.readouterr().out
    with pytest.raises(InputError, match="another run too"):
        together.together([tuple(parts[:2]), tuple(parts[:2])])
    (parts[0] / "withheld.json").unlink()
    with pytest.raises(InputError, match="no finished run"):
        together.together([tuple(parts[:2])])
    assert together.main([]) == 2


# Archive --------------------------------------------------------------------------------------------------------------


def rewritten(path, member, change):
    """The archive with one member changed."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    members[member] = change(members[member])
    with zipfile.ZipFile(path, "w") as new:
        for name, content in members.items():
            new.writestr(name, content)


def test_a_finished_run_leaves_an_archive_whose_seals_can_be_held_later(tmp_path, capsys):
    write_set(tmp_path, ["none", "spring_cubic", "sensor_gain"])
    done = run(tmp_path, full=True)
    archive = tmp_path / "elsewhere.zip"
    archive.write_bytes((tmp_path / "out" / "sealed.zip").read_bytes())
    for path in sorted((tmp_path / "out").rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    found = verify(archive, tmp_path / "set")
    assert found.exit_code == ExitCode.DONE
    assert found.results["chain_head"] == done.results["chain_head"]
    assert "3 verdicts" in found.text()
    assert "2 verdicts without the true effect: whole" in found.text()
    assert "3 of 3 verdicts are right" in found.text()
    assert "the data are those that were judged" in found.text()
    assert main(["withheld", "--verify", str(archive)]) == 0
    assert "not held: give their folder" in capsys.readouterr().out


def test_the_same_run_gives_the_same_archive(tmp_path):
    write_set(tmp_path, ["none"])
    run(tmp_path)
    first = (tmp_path / "out" / "sealed.zip").read_bytes()
    again = archives.write_archive(tmp_path / "out", tmp_path / "set_key.json", tmp_path / "again.zip")
    assert again.read_bytes() == first


@pytest.mark.parametrize(
    ("member", "old", "new", "words"),
    [
        ("verdicts.jsonl", b"0.92", b"0.93", "verdict was changed"),
        ("freeze.json", b'"seed": 1', b'"seed": 2', "freeze was changed"),
        ("key.json", b"spring_cubic", b"sensor_gain", "key in the archive is not"),
        ("chain.json", b'"links": [', b'"links": ["0", ', "replaced"),
        ("withheld.json", b'"chain_head": "', b'"chain_head": "0', "other verdicts"),
        ("verdicts.jsonl", b'"campaign":"c00"', b'"campaign":"../../c00"', "outside the run"),
        ("leave_one_out/verdicts.jsonl", b"0.92", b"0.93", "verdict was changed"),
    ],
)
def test_an_archive_that_was_changed_is_found_out(tmp_path, member, old, new, words):
    write_set(
        tmp_path, ["none", "spring_cubic"], [{"none": 0.92, "stick_slip": 0.08}, {"spring_cubic": 0.08, "none": 0.92}]
    )
    run(tmp_path, full=True)
    path = tmp_path / "out" / "sealed.zip"
    rewritten(path, member, lambda content: content.replace(old, new))
    with pytest.raises(SelfCheckError, match=words) as caught:
        verify(path)
    assert caught.value.exit_code == ExitCode.SELF_CHECK_FAILED


def test_an_archive_is_held_against_the_data(tmp_path):
    write_set(tmp_path, ["none", "spring_cubic"])
    run(tmp_path)
    path = tmp_path / "out" / "sealed.zip"
    (tmp_path / "set" / "c01" / "answer.json").write_text("{}")
    with pytest.raises(SelfCheckError, match="c01 of 2 campaigns are not the data"):
        verify(path, tmp_path / "set")
    with pytest.raises(InputError, match="lacks the campaigns c00"):
        verify(path, tmp_path / "out")
    (tmp_path / "no.zip").write_text("nothing")
    with pytest.raises(InputError, match="cannot be read as an archive"):
        verify(tmp_path / "no.zip")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        other.writestr("key.json", "{}")
    with pytest.raises(InputError, match=r"it lacks chain.json, freeze.json"):
        verify(tmp_path / "other.zip")


def test_a_seal_of_data_alone_does_not_ask_for_the_code(tmp_path, monkeypatch):
    folder = write_set(tmp_path, ["none", "spring_cubic"])
    seal = seal_campaigns(folder, code=False)
    assert "code_sha256" not in sealing.read_freeze(seal)
    monkeypatch.setattr(sealing, "code_sha256", lambda *roots: "0" * 64)
    assert not run(tmp_path).rehearsal
    (folder / "c01" / "answer.json").write_text(json.dumps({"none": 1.0}))
    assert "the data of c01 have changed" in run(tmp_path, out=tmp_path / "later").results["why_rehearsal"][0]


def test_the_shipped_campaigns_are_those_that_were_sealed_and_their_seal_names_no_code():
    """So no ordinary commit has to touch the seal."""
    home = shipped_path(check.SHIPPED)
    seal = sealing.read_freeze(check.seal_path(home.parent / "campaigns_key.json"))
    found = check.find_campaigns(home)
    assert {name: sealing.folder_sha256(path) for name, path in found.items()} == seal["campaigns"]
    assert sealing.file_sha256(home.parent / "campaigns_key.json") == seal["key_sha256"]
    assert not {"code_sha256", "effects_sha256", "commit"} & set(seal)
    key = sealing.read_key(home.parent / "campaigns_key.json", found)
    assert {entry["kind"] for entry in key.values()} == {"easy", "hard", "laboratory"}
    assert {scores.right_answers(entry, GROUPS) for entry in key.values()} >= {
        frozenset({"none"}),
        frozenset({"unknown"}),
    }
    assert sum(p.stat().st_size for p in home.parent.rglob("*") if p.is_file()) < 1e6


# Long runs ------------------------------------------------------------------------------------------------------------


def test_a_run_that_was_stopped_goes_on_with_what_is_missing(tmp_path, monkeypatch):
    write_set(tmp_path, ["none", "spring_cubic", "none"], deadly="c01")
    with pytest.raises(Interrupted, match="same command again"):
        run(tmp_path, "stopped_once")
    assert calls(tmp_path) == ["c00"]
    assert not (tmp_path / "out/withheld.json").exists()
    assert set(sealed(tmp_path / "out")) == {"c00"}
    record = json.loads((tmp_path / "out/run.json").read_text())
    assert record["command"] == "withheld"
    with pytest.raises(InputError, match="no code is taken from a folder of results"):
        check.finish_withheld(tmp_path / "out", record["plan"], workers=1)
    monkeypatch.setattr(check, "verdict_of", fake_diagnosis.stopped_once)
    found = check.finish_withheld(tmp_path / "out", record["plan"], workers=1)
    assert calls(tmp_path) == ["c00", "c01", "c02"]
    assert found.results["scores"]["all"]["campaigns"] == 3


@pytest.mark.slow
def test_a_worker_killed_in_mid_run_loses_nothing(tmp_path):
    truths = ["none", "spring_cubic", "sensor_gain"]
    for home, deadly in ((tmp_path / "one", None), (tmp_path / "two", "c01")):
        home.mkdir()
        write_set(home, truths, deadly=deadly)
    killed = run(tmp_path / "two", "dies_once", workers=2)
    alone = run(tmp_path / "one", "dies_once")
    assert not (tmp_path / "two/c01.deadly").exists(), "no worker was killed"
    assert set(calls(tmp_path / "two")) == {"c00", "c01", "c02"}
    assert killed.results["scores"] == alone.results["scores"]
    sealed = [{n: c["verdict"] for n, c in found.results["campaigns"].items()} for found in (killed, alone)]
    assert sealed[0] == sealed[1]


def test_a_diagnosis_that_fails_is_a_wrong_verdict(tmp_path):
    write_set(tmp_path, ["none", "spring_cubic"])
    told = run(tmp_path, "fails").results
    assert told["campaigns"]["c00"]["error"] == "ZeroDivisionError: no such luck"
    assert told["scores"]["all"]["failed"] == 2
    assert told["scores"]["all"]["accepted_first"]["hits"] == 0
    assert told["scores"]["all"]["log_score"]["value"] == pytest.approx(-math.log(scores.LEAST_PROBABILITY))


def test_the_truth_taken_out_of_the_library_is_expected_to_be_unknown(tmp_path):
    write_set(tmp_path, ["none", "spring_cubic", "sensor_gain"])
    checked = run(tmp_path, full=True)
    assert "effect taken out of the library (2 visible campaigns)" in checked.text()
    told = checked.results
    found = told["leave_one_out"]
    assert found["campaigns"] == 2
    assert found["unknown_first"]["value"] == 1.0
    assert found["site"]["hits"] == 1, "the made-up diagnosis puts every unknown at ground 1"
    lines = (tmp_path / "calls.log").read_text().splitlines()
    assert sorted(line.split()[2] for line in lines if len(line.split()) == 3) == ["sensor_gain", "spring_cubic"]
    target = next(t for t in told["scores"]["targets"] if t["what"].endswith("unknown first") and t["n"])
    assert target["n"] == 2
    assert target["status"] == "met"
    assert not target["enough"]


# Scores ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("truth", "verdict", "right"),
    [
        (entry("friction_displacement"), "normal_force_law", True),
        (entry("friction_displacement"), "stick_slip", False),
        (entry("none"), "none", True),
        (entry("none"), "unknown", False),
        (entry("spring_cubic", kind="hard", visible=9.0), "none", True),
        (entry("spring_cubic", kind="hard", visible=11.0), "none", False),
        (entry("spring_cubic", kind="easy", visible=9.0), "none", False),
        (entry("knock", standing="reserved", visible=31.0), "unknown", True),
        (entry("knock", standing="reserved", visible=31.0), "none", False),
        (entry("knock", standing="reserved", visible=29.0), "none", True),
        (entry("knock", standing="reserved"), "spring_cubic", False),
    ],
)
def test_which_answers_are_right(truth, verdict, right):
    assert scores.score_one("c", said(verdict), truth, GROUPS).is_right is right


def test_a_class_counts_as_one_answer():
    verdict = {
        "verdict": "normal_force_law",
        "probabilities": {"normal_force_law": 0.5, "friction_displacement": 0.4, "none": 0.1},
        "credible_set": ["normal_force_law", "friction_displacement"],
        "sites": {"interface": 0.9, "none": 0.1},
    }
    row = scores.score_one("c", verdict, entry("friction_displacement", site="interface"), GROUPS)
    assert row.p_right == pytest.approx(0.9)
    assert row.confidence == pytest.approx(0.9)
    assert row.brier == pytest.approx(0.1**2 + 0.1**2)
    assert row.set_size == 1
    assert row.single
    assert row.site_right


def test_wrong_and_confident_is_counted_only_for_named_effects():
    assert scores.score_one("c", said("stick_slip", 0.95), entry("spring_cubic"), GROUPS).false_and_confident
    assert not scores.score_one("c", said("stick_slip", 0.85), entry("spring_cubic"), GROUPS).false_and_confident
    assert not scores.score_one("c", said("unknown", 0.95), entry("spring_cubic"), GROUPS).false_and_confident


def test_a_pair_needs_both_names():
    pair = entry("pair", effects=["spring_cubic", "stick_slip"], site=["ground1", "interface"], standing=None)
    one = scores.score_one("c", said("stick_slip"), pair, GROUPS)
    both = scores.score_one("c", said("stick_slip", pair={"effects": ["stick_slip", "spring_cubic"]}), pair, GROUPS)
    assert (one.either_named, one.both_named) == (True, False)
    assert (both.either_named, both.both_named) == (True, True)
    assert scores.all_scores([one, both])["all"]["pairs_both_named"]["hits"] == 1


def test_coverage_and_instant_of_an_event():
    verdict = said("spring_cubic", intervals90={"mu": [0.004, 0.006], "k2t": [1.7, 1.8]})
    assert scores.score_one("c", verdict, entry("spring_cubic"), GROUPS).covered == {"mu": True, "k2t": False}
    assert scores.score_one("c", verdict, entry("stick_slip"), GROUPS).covered == {}
    knock = entry("knock", standing="development")
    row = scores.score_one("c", said("unknown", where={"event": {"instant_s": 0.307}}), knock, GROUPS)
    assert row.event_error_s == pytest.approx(0.002)
    assert scores.score_one("c", said("unknown"), knock, GROUPS).event_error_s == math.inf


def test_wilson_gives_the_published_interval():
    # Newcombe (1998), Statistics in Medicine 17, table I: 81 of 263, and 0 of 20.
    assert scores.wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert scores.wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)


def made_up(rng, n, sharpen=1.0):
    """Scored verdicts whose truths are drawn from probabilities that are then sharpened before they are reported."""
    rows = []
    for i in range(n):
        p = rng.dirichlet([0.25] * len(ANSWERS))
        truth = ANSWERS[rng.choice(len(ANSWERS), p=p)]
        told = p**sharpen / np.sum(p**sharpen)
        probabilities = dict(zip(ANSWERS, told.tolist(), strict=True))
        verdict = {
            "verdict": max(probabilities, key=probabilities.get),
            "probabilities": probabilities,
            "credible_set": credible_set(probabilities),
            "sites": {SITE[name]: x for name, x in probabilities.items()},
        }
        rows.append(scores.score_one(f"c{i}", verdict, entry(truth), GROUPS))
    return rows


def test_a_perfectly_calibrated_diagnosis_comes_out_calibrated():
    p_values = [scores.reliability(made_up(np.random.default_rng(k), 300), seed=k)["p_value"] for k in range(12)]
    assert min(p_values) > 0.01
    assert max(p_values) > 0.3
    rows = made_up(np.random.default_rng(99), 2000)
    found = scores.reliability(rows)
    assert abs(found["confidence"] - found["success"]) < 0.03
    in_set = scores.summarise(rows)["truth_in_credible_set"]["value"]
    assert 0.88 < in_set < 1.0


def test_an_overconfident_diagnosis_does_not():
    found = scores.reliability(made_up(np.random.default_rng(5), 300, sharpen=4.0))
    assert found["p_value"] < 0.001
    assert found["error"] > found["twin_error"]["upper95"]


def test_a_target_is_met_by_the_estimate_and_shown_by_its_interval():
    good, bad = said("spring_cubic"), said("stick_slip")

    def judged(hits, n, least=0.9, most=None):
        rows = [scores.score_one("c", good if i < hits else bad, entry("spring_cubic"), GROUPS) for i in range(n)]
        return scores.Target("right", "here", scores._rate_of("is_right"), lambda _: True, least, most, 20).judge(rows)

    assert judged(17, 20)["status"] == "missed", "an interval that merely holds the target is no success"
    assert judged(18, 20)["status"] == "met"
    assert judged(100, 100)["status"] == "shown"
    assert judged(170, 200)["status"] == "missed"
    assert judged(0, 0)["status"] == "not tested"
    assert (judged(18, 20)["enough"], judged(9, 10)["enough"]) == (True, False)
    assert judged(900, 1000, 0.85, 0.95)["status"] == "shown"
    assert judged(18, 20, 0.85, 0.95)["status"] == "met"
    assert judged(20, 20, 0.85, 0.95)["status"] == "missed"
    assert judged(0, 100, None, 0.0)["status"] == "met", "no rate can be shown to be exactly nought"


def laboratory(truth, repeats=True, bodies=2, scatter="weak", **more):
    """An entry of the key of a drawn laboratory."""
    facts = {"repeats": repeats, "bodies": bodies, "scatter_class": scatter}
    return entry(truth, kind="laboratory", level=1.0, **more) | {
        "laboratory": facts, "at_rest": {"mu": 0.005}, "scatter": {"k1t": 2e-3, "mu": 0.0, "offset1": 0.5},
    }  # fmt: skip


def test_every_target_of_the_table_can_be_judged():
    rows = []
    kinds = ("easy", "hard", "laboratory")
    for kind, level, truth, repeats in itertools.product(
        kinds, (0.05, 0.15, 0.5, 1.0), (*ANSWERS, "knock", "pair"), (True, False)
    ):
        effects = ["spring_cubic", "stick_slip"] if truth == "pair" else None
        known = truth in ANSWERS
        verdict = said(
            truth if known else "unknown",
            gap={
                "nominal_rms": 3.0,
                "augmented_rms": 2.0,
                "noise_rms": 2.0,
                "closed": {"median": 0.99},
                "p_value": 0.5,
            },
            seconds=9.0,
            left_out_case={"closed": 0.95},
            sites={SITE.get(truth, "ground1"): 1.0},
            intervals90={"mu": [0.004, 0.006]},
            where={"event": {"instant_s": 0.305}},
            pair={"effects": effects} if effects else None,
            forecast={"before": {"coverage50": 0.5, "coverage90": 0.9}},
            scatter={"k1t": {"sd": 2e-3, "unit": "relative", "hdi90": [1e-3, 3e-3]}},
        )
        standing = "library" if known else "development"
        more = {"standing": standing, "effects": effects}
        made = (
            laboratory(truth, repeats, **more) if kind == "laboratory" else entry(truth, kind=kind, level=level, **more)
        )
        rows.append(scores.score_one(f"{kind}{level}{truth}{repeats}", verdict, made, GROUPS))
    told = scores.all_scores(rows)
    assert [t["what"] for t in told["targets"] if t["status"] == "not tested"] == []
    assert told["by_level"][0]["rms_median"] == {"nominal": 3.0, "augmented": 2.0, "noise": 2.0}


def test_laboratories_are_scored_by_class_with_their_calibration():
    wrong = scores.score_one("a", said("stick_slip", 0.7), laboratory("none", repeats=False, scatter="strong"), GROUPS)
    right = scores.score_one("b", said("none"), laboratory("none", bodies=1), GROUPS)
    named = scores.score_one("c", said("spring_cubic"), laboratory("spring_cubic"), GROUPS)
    told = scores.all_scores([wrong, right, named])["by_class"]
    assert set(told) == {
        "with repeats", "without repeats", "two bodies", "one body", "strong scatter", "weak scatter",
    }  # fmt: skip
    assert told["with repeats"]["none_kept"]["hits"] == told["with repeats"]["right_first"]["hits"] == 1
    assert told["without repeats"]["none_kept"] == told["strong scatter"]["none_kept"]
    assert told["without repeats"]["none_kept"]["hits"] == 0
    assert told["one body"]["campaigns"] == 1
    assert told["two bodies"]["reliability"]["n"] == 2
    assert 0.0 < told["two bodies"]["reliability"]["p_value"] <= 1.0
    lines = page.laboratories({"scores": scores.all_scores([wrong, right, named]), "baselines": {}}).splitlines()
    assert any(line.startswith("| what | with repeats | without repeats | two bodies") for line in lines)
    assert any(line.startswith("| none where nothing is missing | laboratories with repeats | 1 (") for line in lines)
    assert any(line.startswith("| calibration | ") and "p = " in line for line in lines)
    assert [line[:16] for line in lines if line.startswith("- ")] == ["- a (laboratory,"]
    assert (wrong.false_and_likely, wrong.false_and_confident, right.false_and_likely) == (True, False, False)
    assert scores.all_scores([scores.score_one("d", said("none"), entry("none"), GROUPS)])["by_class"] == {}


def test_what_a_sound_laboratory_is_asked_for_is_scored():
    """Intervals under the nominal rig, scatters, the gap's test and the bands of forecasts."""
    verdict = said(
        "none", gap={"p_value": 0.03}, forecast={"before": {"coverage50": 0.4, "coverage90": 0.8}},
        intervals90={"mu": [0.004, 0.006]},
        scatter={
            "k1t": {"unit": "relative", "hdi90": [1e-3, 3e-3]}, "mu": {"unit": "relative", "hdi90": [0.01, 0.02]},
            "offset1": {"unit": "m/s", "hdi90": [0.0, 1.0]},
        },
    )  # fmt: skip
    row = scores.score_one("c", verdict, laboratory("none"), GROUPS)
    assert row.covered == {"mu": True}
    assert row.scatter_covered == {"k1t": True, "mu": False}
    assert row.bands == (0.4, 0.8)
    told = scores.summarise([row])
    assert told["gap_test_5"]["hits"] == told["scatter90"]["hits"] == 1
    assert told["scatter90"]["n"] == 2
    hidden = scores.score_one("d", said("none"), laboratory("spring_cubic", visible=9.0), GROUPS)
    assert hidden.is_right
    assert not scores.score_one("d", said("none"), laboratory("spring_cubic", visible=11.0), GROUPS).is_right


def test_of_three_effects_two_must_be_named():
    three = entry("pair", effects=["spring_cubic", "stick_slip", "sensor_gain"], site=["ground1"] * 3, standing=None)
    two = scores.score_one("c", said("stick_slip", pair={"effects": ["stick_slip", "sensor_gain"]}), three, GROUPS)
    assert (two.both_named, two.either_named) == (True, True)
    assert not scores.score_one("c", said("stick_slip"), three, GROUPS).both_named


def test_misses_name_truth_and_verdict():
    rows = [scores.score_one("abc", said("stick_slip", 0.8), entry("spring_cubic"), GROUPS)]
    assert scores.misses(rows) == [
        "abc (easy, level 0.5): spring_cubic (ground1) taken for stick_slip with p = 0.80; the right answer had 0."
    ]


# Baselines ------------------------------------------------------------------------------------------------------------


def test_a_forest_learns_from_the_other_folds_only():
    rng = np.random.default_rng(3)
    labels = {f"c{i:03d}": ANSWERS[i % 3] for i in range(60)}
    features = {
        n: [float(ANSWERS.index(a)) + 0.2 * rng.standard_normal(), rng.standard_normal()] for n, a in labels.items()
    }
    told = forest_out_of_fold(features, labels, seed=1, trees=40)
    assert set(told) == set(labels)
    right = [max(told[n], key=told[n].get) == a for n, a in labels.items()]
    assert np.mean(right) > 0.9
    noise = {n: [rng.standard_normal(), rng.standard_normal()] for n in labels}
    guessed = forest_out_of_fold(noise, labels, seed=1, trees=40)
    assert np.mean([max(guessed[n], key=guessed[n].get) == a for n, a in labels.items()]) < 0.65
    assert all(sum(p.values()) == pytest.approx(1.0) for p in told.values())
    assert forest_out_of_fold({}, labels, 1) == {}
    shorter = {n: x[: 1 + i % 2] for i, (n, x) in enumerate(features.items())}  # rigs with fewer parameters
    told = forest_out_of_fold(shorter, labels, seed=1, trees=40)
    assert np.mean([max(told[n], key=told[n].get) == a for n, a in labels.items()]) > 0.9


def test_without_scikit_learn_the_forest_is_skipped_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(baselines.importlib.util, "find_spec", lambda name: None)
    assert (
        forest_out_of_fold({f"c{i}": [float(i % 2)] for i in range(40)}, {f"c{i}": "none" for i in range(40)}, 1) == {}
    )
    write_set(tmp_path, ["none"])
    found = run(tmp_path)
    assert "pip install 'bayes-damper[baselines]'" in found.text()
    assert found.results["baselines_skipped"] == [baselines.FOREST_ABSENT]


def test_a_gate_of_chi2_lets_bic_weights_say_unknown():
    def fit(chi2, size):
        return SimpleNamespace(chi2=chi2, problem=SimpleNamespace(n_data=1000.0, size=size))

    def winner(nominal, effect, gate=0.99):
        told = baselines.bic_weights(fit(nominal, 7), {"stick_slip": fit(effect, 9)}, gate)
        assert sum(told.values()) == pytest.approx(1.0)
        return max(told, key=told.get)

    assert winner(1005.0, 1003.0) == "none"
    assert winner(1400.0, 1010.0) == "stick_slip"
    assert winner(1400.0, 1300.0) == "unknown"
    assert winner(1400.0, 1300.0, None) == "stick_slip"


@pytest.mark.filterwarnings("error")
def test_the_forest_takes_many_answers_with_few_campaigns_each_without_a_word():
    rng = np.random.default_rng(4)
    labels = {f"c{i}": f"answer{i}" for i in range(30)} | {f"more{i}": "answer0" for i in range(4)}
    told = forest_out_of_fold({name: rng.standard_normal(3) for name in labels}, labels, seed=1, trees=5)
    assert set(told) == set(labels)
    assert all(sum(p.values()) == pytest.approx(1.0) for p in told.values())
