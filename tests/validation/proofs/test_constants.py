"""The rule's constants fitted to verdicts: read from a run, weighed again, better on what they were fitted to."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from bayes_damper.diagnosis.verdict import RULE, Left, weigh
from bayes_damper.errors import InputError
from validation.proofs.constants import Known, fit_constants, fit_rule, main, mean_log_score, read_run

ENTRY = {
    "kind": "easy", "effects": ["quadratic_drag"], "truth": "quadratic_drag", "site": "bearings", "class": None,
    "standing": "library", "level_wanted": 0.5, "visible_chi2": 900.0, "nominal": {}, "disturbances": [],
}  # fmt: skip


def verdict(leading: float, nats: float, share: float) -> dict:
    """A verdict in which quadratic_drag leads by `leading` nats and leaves that much."""
    before, after = Left(400.0, 1.0), Left(nats, share)
    answers = weigh({"quadratic_drag": leading, "sensor_gain": 0.0}, before, after)
    return {
        "verdict": answers.verdict, "probabilities": answers.probabilities, "credible_set": answers.credible_set(),
        "sites": {"bearings": 1.0}, "gap": {},
        "effects": [
            {"name": "quadratic_drag", "log_evidence": leading}, {"name": "sensor_gain", "log_evidence": 0.0},
        ],
        "weighed": {"before": asdict(before), "after": {**asdict(after), "readings": None}, "excess": 0.0,
                    "drift": None, "pairs": []},
    }  # fmt: skip


@pytest.fixture
def rows() -> list[Known]:
    """Right formulas that leave a tenth of the gap, foreign causes that leave half of it."""
    rng = np.random.default_rng(3)
    out = []
    for k in range(20):
        foreign = k % 2 == 1
        share = (0.5 if foreign else 0.14) * np.exp(0.2 * rng.standard_normal())
        entry = ENTRY if not foreign else {**ENTRY, "truth": "wind", "effects": ["wind"], "standing": "reserved"}
        out.append(Known(f"c{k}", verdict(300.0, 60.0, float(share)), entry))
    return out


def test_fitted_constants_score_better_and_move_the_right_way(rows):
    """Shares of a tenth are laid to the formula here, so the share from which they are not must rise."""
    rule = fit_rule(rows, most=150)
    assert mean_log_score(rows, rule) < mean_log_score(rows, RULE) - 0.05
    assert rule.share_away * rule.share_home > RULE.share_away * RULE.share_home


def test_each_kind_of_truth_counts_as_in_the_prior(rows):
    """Ten times as many right formulas change nothing."""
    library = [k for k in rows if k.group == "library"]
    assert mean_log_score(rows + 9 * library, RULE) == pytest.approx(mean_log_score(rows, RULE))
    taken_out = [replace(k, left_out=True) for k in library]
    assert {k.group for k in taken_out} == {"foreign"}


def write_run(home, rows):
    for known in rows:
        folder = home / "run" / "verdicts" / known.name
        folder.mkdir(parents=True)
        (folder / "verdict.json").write_text(json.dumps({"verdict": known.verdict}))
    (home / "key.json").write_text(json.dumps({"campaigns": {k.name: k.entry for k in rows}}))
    return home / "run", home / "key.json"


def test_a_run_is_read_and_told(tmp_path, rows, capsys):
    run, key = write_run(tmp_path, rows)
    read = read_run(run, key)
    assert {k.name for k in read} == {k.name for k in rows}
    told = fit_constants(read, most=40).text()
    assert "20 verdicts" in told
    assert "share_home" in told
    assert "tried on the other" in told
    assert main([]) == 2
    assert "RUN KEY" in capsys.readouterr().out


def test_runs_that_do_not_belong_together_are_refused(tmp_path, rows):
    run, key = write_run(tmp_path, rows)
    key.write_text(json.dumps({"campaigns": {}}))
    with pytest.raises(InputError, match="no entry"):
        read_run(run, key)
    with pytest.raises(InputError, match="no verdicts"):
        read_run(tmp_path / "elsewhere", key)
