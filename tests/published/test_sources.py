"""Where data come from: one word for the published numbers, a folder for recorded trials, one interface for both."""

import ast
from pathlib import Path

import pytest

from bayes_damper.errors import InputError
from bayes_damper.published.sources import THESIS, PublishedSource, RecordedSource, source_of, unchanged
from tests.campaigns import write_synthetic

PACKAGE = Path(__file__).resolve().parents[2] / "bayes_damper"


def test_the_thesis_is_decided_in_one_place():
    places = [
        path.name
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Compare)
        and any(isinstance(n, ast.Constant) and n.value == THESIS for n in ast.walk(node))
    ]
    assert places == []
    assert isinstance(source_of(Path(THESIS)), PublishedSource)


def test_both_sources_give_name_cases_checksum_and_priors(tmp_path):
    folder = write_synthetic(tmp_path / "rig", repeats=1)
    published, recorded = source_of(THESIS), source_of(folder)
    assert isinstance(recorded, RecordedSource)
    assert (published.name, published.cases) == ("thesis", ("I", "II", "III", "IV"))
    assert (recorded.name, recorded.cases) == ("synthetic", ("IV",))
    assert len(published.sha256) == len(recorded.sha256) == 64
    assert published.priors() is not None
    assert recorded.priors() is None
    (folder / "priors.toml").write_text("mu = 0.02\n")
    (tmp_path / "other.toml").write_text("mu = 0.03\n")
    for chosen, value in ((None, 0.02), (tmp_path / "other.toml", 0.03)):
        found = source_of(folder).priors(chosen)
        assert found is not None
        assert found.entries["mu"].value == value


def test_a_campaign_that_has_changed_is_refused_with_what_to_do(tmp_path):
    folder = write_synthetic(tmp_path / "rig", repeats=1)
    sha256 = source_of(folder).sha256
    assert unchanged(str(folder), sha256, "it was fitted; fit it again").sha256 == sha256
    rows = (folder / "trials.csv").read_text()
    (folder / "trials.csv").write_text(rows.replace("10.2", "10.3"))
    with pytest.raises(InputError, match="has changed since it was fitted; fit it again"):
        unchanged(str(folder), sha256, "it was fitted; fit it again")
