"""What the records show without their first periods: causes at the release, and laws that stay wrong."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_rig import knock, measured, variant

from bayes_damper.calibration import calibrate_nominal
from bayes_damper.diagnosis.later import GONE, SEEN, Later, _without_beginning, continued
from bayes_damper.diagnosis.sites import Hypothesis, shares_of, site_map


def maps_of(**cause):
    """The site map of whole records, what follows their beginning, and the map with that."""
    alone = site_map(calibrate_nominal(measured(5, duration=0.7, **cause)), torque=False)
    later = continued(alone, lambda _: None)
    return alone, later, site_map(alone.fit, torque=False, against=later.against)


@pytest.fixture(scope="module")
def kicked():
    return maps_of(torque=knock(0.001, 0.004, 6.0))


def test_a_kick_at_the_release_is_found_there_however_large(kicked):
    """Along a motion that the rig did not make, the linear responses of a sensor fit as well as those of the kick."""
    alone, later, both = kicked
    assert alone.best == "sensor"
    assert later.gap < GONE
    assert both.best == "release"
    assert both.probabilities["release"] > 0.9
    assert "leaves no gap" in later.in_words()


def test_whether_there_is_a_gap_is_left_to_the_whole_records(kicked):
    alone, _, both = kicked
    assert both.probabilities["none"] == pytest.approx(alone.probabilities["none"], abs=1e-12)
    assert both.log_evidence == pytest.approx(alone.log_evidence)
    assert both.strength == alone.strength


@pytest.mark.parametrize(
    "cause",
    [{"effect": variant("spring_cubic"), "values": {"k3": 100.0}}, {"torque": knock(0.45, 0.012, 0.06)}],
    ids=["a law", "a late knock"],
)
def test_what_stays_wrong_is_not_found_at_the_release(cause):
    _, later, both = maps_of(**cause)
    assert later.gap > SEEN
    assert later.in_words() is None
    assert both.best == "ground1"
    assert both.probabilities["release"] < 0.01


def test_a_hypothesis_loses_what_it_expects_and_does_not_find(kicked):
    """The loss against the change of half the squared residuals, worked out from the columns themselves."""
    _, later, _ = kicked
    judged = later.pieces.on()
    column = next(k for k in range(len(judged.raw)) if judged.gram[k, k] > 0.1 * judged.raw[k] > 0.0)
    amount = 10.0 / np.sqrt(judged.gram[column, column])
    expected, along = 50.0, amount * judged.product[column]
    own = Hypothesis("ground1", "law", np.array([column]), 1.0, 0.0)
    every = [(own, np.array([amount])), (own, np.zeros(1)), (replace(own, site="release"), np.array([amount]))]
    loss = min(along - expected, 0.0) / (1.0 + 0.1 * expected)
    assert replace(later, gap=0.0).against(every) == pytest.approx([loss, 0.0, 0.0])
    assert replace(later, gap=40.0).against(every) == pytest.approx([0.0, 0.0, 0.0])  # which none of them predicts


@pytest.mark.parametrize(("gap", "gain", "lost"), [(40.0, 21.0, -8.0), (40.0, 19.0, 0.0), (8.0, 8.0, 0.0)])
def test_a_gap_that_some_site_predicts_speaks_against_the_release(kicked, monkeypatch, gap, gain, lost):
    """Half of it, and not of one so small that some of many sites predicts it by chance."""
    _, later, _ = kicked
    own = Hypothesis("ground1", "law", np.array([0]), 1.0, 0.0)
    monkeypatch.setattr(Later, "_gains", lambda *_: (np.array([gain, 0.0]), np.array([gain, 0.0])))
    found = replace(later, gap=gap).against([(own, np.zeros(1)), (replace(own, site="release"), np.zeros(1))])
    assert found == pytest.approx([0.0, lost])


def test_records_that_end_soon_have_no_later_part():
    short = site_map(calibrate_nominal(measured(5, duration=0.3)), torque=False)
    assert continued(short, lambda _: None) is None


def _first_trial(experiment, change):
    return replace(experiment, trials=(change(experiment.trials[0]), *experiment.trials[1:]))


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.at(t.times < 0.2),
        lambda t: replace(t, y=np.where(t.times > 0.29, np.nan, t.y)),
        lambda t: replace(t, theta0=0.0),
        lambda t: replace(t, inputs=SimpleNamespace()),
    ],
    ids=["ends early", "falls silent", "not released", "driven"],
)
def test_one_record_without_a_later_part_is_enough(change):
    made = measured(5, duration=0.7)
    period = 0.138
    later, none = (
        _without_beginning(SimpleNamespace(problem=SimpleNamespace(experiment=e)), 2.0 * np.pi / period)
        for e in (made, _first_trial(made, change))
    )
    assert none is None
    assert later.start == "free"
    assert all(t.times[0] == pytest.approx(2.0 * period, abs=1e-3) for t in later.trials)


def test_refuted_sites_lose_to_others_and_not_to_none():
    evidence = {("sensor", None): 50.0, ("release", None): 49.0}
    alone, both = (shares_of(evidence, {None: 1.0}, 0.4, lost) for lost in (None, {("sensor", None): -8.0}))
    assert sum(both.values()) == pytest.approx(sum(alone.values()))
    assert both["sensor", None] / both["release", None] == pytest.approx(
        alone["sensor", None] / alone["release", None] * np.exp(-8.0)
    )
