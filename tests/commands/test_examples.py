"""The example that a newcomer plays with: sound, refused over another campaign, and solved by the diagnosis."""

import pytest

from bayes_damper import check, diagnose, examples
from bayes_damper.cli import main
from bayes_damper.errors import InputError
from bayes_damper.fit.plan import plan_fit
from bayes_damper.fit.recorded import fit_recorded_cases
from bayes_damper.runs.progress import NOTICE


def test_the_example_is_a_campaign_without_a_fault(tmp_path):
    written = examples(tmp_path / "cart")
    found = check(written.folder)
    assert found.warnings == ()
    assert "6 trials, 2 cases" in found.text()
    assert found.text().endswith(f"No fault found. Next: bayes-damper fit {written.folder} --out results/fit")
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


class Stopped(Exception):
    """Raised by the test's own progress."""


@pytest.mark.slow
def test_a_fit_that_misses_something_says_so_before_it_draws(tmp_path):
    """The cart without its hardening: known from the best fit, before the draws that take most of the time."""
    written = examples(tmp_path / "cart")
    plan = plan_fit(
        str(written.folder),
        cases=None,
        priors=None,
        normal_force=None,
        seed=1,
        thorough=False,
        most_steps=None,
        joint=False,
    )
    news = []

    def report(share, text):
        news.append(text)
        if NOTICE in text:
            raise Stopped

    with pytest.raises(Stopped):
        fit_recorded_cases(tmp_path, report, name="large", plan=plan)
    assert news[0] == "finding the best fit"
    # As soon as the best fit under the noise of the repeats is there, before the noise is estimated anew.
    assert news[-1] == (
        "estimating the noise from the residuals\nTHE MODEL MISSES SOMETHING: stop with Ctrl-C and run "
        f"`bayes-damper diagnose {written.folder}`"
    )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_diagnosis_finds_what_the_example_hides(tmp_path):
    written = examples(tmp_path / "cart")
    found = diagnose(written.folder, out=tmp_path / "diagnose")
    assert found.result["verdict"] == written.cause
