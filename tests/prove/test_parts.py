"""The index of the proofs is what `make prove` would write."""

from __future__ import annotations

import shutil

import parts


def test_the_index_of_proofs_is_that_which_make_prove_writes(tmp_path, monkeypatch):
    kept = parts.PAGES
    for path in (*kept.glob("*.json"), kept / "index.md"):
        shutil.copy(path, tmp_path / path.name)
    monkeypatch.setattr(parts, "PAGES", tmp_path)
    parts.write_index()
    assert (tmp_path / "index.md").read_text(encoding="utf-8") == (kept / "index.md").read_text(encoding="utf-8")
