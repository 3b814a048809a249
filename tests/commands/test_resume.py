"""A folder of results is data: whatever it says, no code comes from it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from campaigns import write_synthetic

from bayes_damper import cli
from bayes_damper.commands.resume import resume
from bayes_damper.effects import effects_sha256
from bayes_damper.errors import InputError
from bayes_damper.fit.plan import kept, plan_fit, plan_in, start_run
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.runs.json_files import read_json, write_json

EVIL = "from pathlib import Path\nPath({mark!r}).touch()\n\ndef run(*a, **k):\n    Path({mark!r}).touch()\n"
OWN = '''"""An effect."""
from bayes_damper.effects.spring_cubic import EFFECT as LIBRARY
from dataclasses import replace
EFFECT = replace(LIBRARY, name="{name}")
'''


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A folder on Python's path whose module leaves a mark when it is imported or called; the mark's path."""
    (tmp_path / "evil").mkdir()
    mark = tmp_path / "ran"
    (tmp_path / "evil/evil_module.py").write_text(EVIL.format(mark=str(mark)))
    monkeypatch.syspath_prepend(str(tmp_path / "evil"))
    monkeypatch.chdir(tmp_path)
    yield mark
    sys.modules.pop("evil_module", None)
    assert not mark.exists(), "a folder of results ran code"


def campaign_of(tmp_path):
    return write_synthetic(tmp_path / "campaign", repeats=1, rate=200.0)


def planned(tmp_path, **changes):
    options = dict.fromkeys(("cases", "priors", "normal_force", "effect", "effects", "most_steps"))
    return plan_fit(str(campaign_of(tmp_path)), **options | {"seed": 1, "thorough": False, "joint": False} | changes)


def names_code(tmp_path, plan):
    """The ways in which a folder may name code, each added to a plan."""
    evil = str(tmp_path / "evil")
    for key in ("effects", "diagnose_with", "call", "verdicts_by", "module", "effects_sha256", "priors", "name"):
        for value in (evil, "evil_module:run", f"{evil}/evil_module.py", [evil], {"path": evil}):
            yield plan | {key: value}


@pytest.mark.parametrize("command", ["fit", "withheld", "variability", "evil_module:run", "diagnose"])
def test_no_folder_runs_code(tmp_path, evil, command):
    """Whatever code run.json names for whatever command, `resume` says no or goes on with its own."""
    plans = {
        "fit": lambda: planned(tmp_path),
        "withheld": lambda: {
            "folder": str(tmp_path / "set"), "full": False, "key": str(tmp_path / "key.json"), "seed": 1,
            "leave_one_out": None, "verdicts_by": "bayes_damper.validation.withheld.check:verdict_of",
            "effects_sha256": None,
        },
    }  # fmt: skip
    out = tmp_path / "out"
    for i, plan in enumerate(names_code(tmp_path, plans.get(command, plans["withheld"])())):
        folder = tmp_path / f"out{i}"
        write_json(folder / "run.json", {"command": command, "plan": plan, "workers": 1})
        (folder / "evil_module.py").write_text((tmp_path / "evil/evil_module.py").read_text())
        with pytest.raises(InputError):
            resume(folder)
        assert cli.main(["resume", str(folder), "--quiet"]) == 2
    assert not evil.exists()
    assert not out.exists()


@pytest.mark.parametrize("command", ["report", "compare", "tune", "variability"])
def test_commands_that_read_results_run_nothing_of_them(tmp_path, evil, command):
    for name in ("a", "b"):
        folder = tmp_path / name
        write_json(folder / "run.json", {"command": "fit", "plan": {"effects": str(tmp_path / "evil")}})
        write_json(folder / "summary.json", {"schema": "bayes-damper/fit/1", "cases": {}, "effects": "evil_module:run"})
        (folder / "conftest.py").write_text("import evil_module")
        (folder / "evil_module.py").write_text((tmp_path / "evil/evil_module.py").read_text())
    words = [str(tmp_path / "a"), *([str(tmp_path / "b")] if command == "compare" else [])]
    cli.main([command, *words, "--quiet"])
    assert not evil.exists()


@pytest.mark.parametrize("more", [False, True])
def test_nothing_is_written_through_a_link_in_a_folder_of_results(tmp_path, more):
    """`--more` removes done.json of each case first: of a case that is a link it would be somebody else's file."""
    start_run(tmp_path / "out", {"command": "fit", "plan": kept(planned(tmp_path)), "workers": 1})
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/done.json").write_text("mine")
    (tmp_path / "out/IV").symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match=r"out/IV: a link to .*mine, where the run would write"):
        resume(tmp_path / "out", more=more)
    assert (tmp_path / "mine/done.json").read_text() == "mine"
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["done.json"]


def test_only_known_keys_of_a_plan_are_taken(tmp_path, evil):
    plan = planned(tmp_path)
    for named in names_code(tmp_path, plan):
        if set(named) != set(plan) or named["effects"] != plan["effects"]:
            found = plan_in({"command": "fit", "plan": named}, tmp_path)
            assert found == plan
    assert not evil.exists()


def own_effects(folder, name="own_spring"):
    folder.mkdir(exist_ok=True)
    (folder / "own.py").write_text(OWN.format(name=name))
    return folder


def test_a_run_with_effects_of_ones_own_asks_for_them_again(tmp_path):
    effects = own_effects(tmp_path / "effects")
    plan = planned(tmp_path, effect="own_spring", effects=str(effects))
    out = tmp_path / "out"
    start_run(out, {"command": "fit", "plan": kept(plan), "workers": 1})
    assert str(effects) not in (out / "run.json").read_text(), "the folder names where code lies"
    with pytest.raises(InputError, match=r"say where they lie: bayes-damper resume .*out --effects DIR"):
        resume(out)
    record = read_json(out / "run.json")
    moved = effects.rename(tmp_path / "moved")
    assert plan_in(record, out, moved)["effects"] == str(moved)
    own_effects(moved, "another")
    with pytest.raises(InputError, match="these are not the effects that the run"):
        resume(out, effects=moved)


def test_a_run_without_effects_of_ones_own_takes_none(tmp_path):
    out = tmp_path / "out"
    start_run(out, {"command": "fit", "plan": kept(planned(tmp_path)), "workers": 1})
    with pytest.raises(InputError, match="began without effects of your own"):
        resume(out, effects=own_effects(tmp_path / "effects"))


def test_the_checksum_of_effects_sees_every_file_and_name(tmp_path):
    effects = own_effects(tmp_path / "effects")
    before = effects_sha256(effects)
    (effects / "_shared.py").write_text("x = 1\n")
    with_more = effects_sha256(effects)
    (effects / "_shared.py").rename(effects / "_other.py")
    assert len({before, with_more, effects_sha256(effects)}) == 3


@pytest.mark.parametrize("content", ["[]", "1", "null", '"x"', '{"command": 1}', '{"command": "fit"}',
    '{"command": "fit", "plan": []}', '{"command": ["fit"], "plan": {}}', "{", "",])  # fmt: skip
def test_a_damaged_run_json_is_a_sentence(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(InputError, match=r"run\.json"):
        resume(tmp_path)


class Pickled:
    """What would leave a mark if a pickle of it were read."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (type(self.mark).touch, (self.mark,))


def test_a_pickle_in_a_saved_state_is_not_read(tmp_path, evil):
    import hashlib
    import io

    good = Checkpoint(tmp_path / "state", {"a": "b"})
    good.save({"x": np.zeros(2)}, {"n": 1})
    text = json.dumps({"fingerprint": {"a": "b"}, "record": {}})
    buffer = io.BytesIO()
    planted = np.empty(1, object)
    planted[0] = Pickled(evil)
    np.savez(buffer, __record__=np.frombuffer(text.encode(), np.uint8), x=planted)
    payload = buffer.getvalue()
    (tmp_path / "state/state-000009.npz").write_bytes(hashlib.sha256(payload).digest() + payload)
    arrays, record = good.load()
    assert record == {"n": 1}
    assert (arrays["x"] == 0.0).all()
