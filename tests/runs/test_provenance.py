"""Checksums of code: what counts, and what does not."""

from __future__ import annotations

from pathlib import Path

from bayes_damper.runs import provenance
from bayes_damper.runs.provenance import code_sha256


def names(*roots):
    return {p.relative_to(provenance._HERE).as_posix() for p in provenance._reached(roots)}


def test_the_code_of_a_module_is_what_it_imports_and_no_more():
    reached = names("bayes_damper.diagnosis")
    assert {"diagnosis/verdict.py", "calibration/problem.py", "simulation/integrator.py"} <= reached
    assert "effects/stick_slip.py" in reached
    assert not {"cli.py", "report/html.py", "tuning/result.py", "validation/withheld/scores.py"} & reached
    assert names("numpy", "bayes_damper") == set()
    assert code_sha256("bayes_damper.diagnosis") != code_sha256()
    assert code_sha256("bayes_damper.diagnosis") != code_sha256("bayes_damper.campaign")


def test_the_checksum_follows_the_code_that_counts(tmp_path, monkeypatch):
    package = tmp_path / "bayes_damper"
    package.mkdir()
    (package / "a.py").write_text("def f():\n    from bayes_damper import b\n    return b\n")
    (package / "b.py").write_text("import numpy\n")
    (package / "c.py").write_text("import bayes_damper.a\n")
    monkeypatch.setattr(provenance, "_HERE", Path(package))

    def mark():
        code_sha256.cache_clear()
        return code_sha256("bayes_damper.a")

    before = mark()
    assert names("bayes_damper.a") == {"a.py", "b.py"}
    (package / "c.py").write_text("import os\n")
    assert mark() == before
    (package / "b.py").write_text("import scipy\n")
    assert mark() != before
    code_sha256.cache_clear()
