"""The example that a newcomer plays with: sound, refused over another campaign, and solved by the diagnosis."""

import pytest

from bayes_damper import check, diagnose, examples
from bayes_damper.cli import main
from bayes_damper.errors import InputError


def test_the_example_is_a_campaign_without_a_fault(tmp_path):
    written = examples(tmp_path / "cart")
    found = check(written.folder)
    assert found.warnings == ()
    assert "6 trials, 2 cases" in found.text()
    assert f"bayes-damper diagnose {written.folder}" in written.text()
    assert examples(tmp_path / "again").folder != written.folder
    assert check(tmp_path / "again").sha256 == found.sha256  # the same seed
    assert check(examples(tmp_path / "other", seed=2).folder).sha256 != found.sha256


def test_it_never_writes_over_a_campaign(tmp_path, capsys):
    assert main(["examples", "--out", str(tmp_path)]) == 0
    with pytest.raises(InputError, match="holds a campaign already"):
        examples(tmp_path)
    assert main(["examples", "--out", str(tmp_path)]) == 2
    assert "give another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_the_diagnosis_finds_what_the_example_hides(tmp_path):
    written = examples(tmp_path / "cart")
    found = diagnose(written.folder, out=tmp_path / "diagnose")
    assert found.result["verdict"] == written.cause
