"""Priors beyond what mechanics leaves possible on the rig of a campaign."""

from pathlib import Path

import pytest
from campaigns import write_synthetic

from bayes_damper.campaign import load_campaign
from bayes_damper.errors import InputError
from bayes_damper.priors.files import campaign_priors, load_priors

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return load_campaign(write_synthetic(tmp_path_factory.mktemp("rig"), repeats=1, rate=250.0, duration=0.6))


@pytest.mark.parametrize(
    ("prior", "said"),
    [
        ({"mu": 1e9}, "mu: 1e.09 cannot be: above .* with which the friction mu N0 R is 100 times the largest torque"),
        ({"mu": [0.0, 1e9]}, "mu: a median of 5e.08"),
        ({"mu": {"dist": "lognormal", "median": 0.01, "factor": 2.0, "unit": "1", "cases": {"IV": {"median": 1e6}}}},
         "mu: a median of 1e.06"),
        ({"drag": [1e3, 1e5]}, "drag: a median of 50500 cannot be: above .* could not move it"),
        ({"drag": 4.0}, "drag: fixed at 4, above the largest torque of the records, 0.8.*: nothing would move"),
        ({"c1t": 1e3}, "c1t: 1000 cannot be: .* 100 times critical damping: nothing would swing"),
        ({"c2t": 1e6}, "c2t: .* critical"),
        ({"c3t": {"dist": "halfnormal", "sd": 1e20, "unit": "N m s/rad"}}, "c3t: a median of .* critical"),
        ({"k2t": 1e12}, "k2t: .* the two bodies would be one"),
        ({"k2t": -1e12}, "k2t: "),
        ({"nu": 1e9}, "nu: 1e.09 cannot be: .* no reading and no step in time follows"),
        ({"tail": 50.0}, "tail: 50 cannot be: curves of friction have -1 to 2"),
        ({"theta0": 4.7}, "theta0: 4.7 cannot be: .* 20 times the largest one of its records; check its unit"),
        ({"delay": 10.0}, "delay: 10 cannot be: .* longest record"),
        ({"sigma1": 1e9}, "sigma1: 1e.09 cannot be: .* 1000 times the largest reading"),
        ({"drag": {"dist": "lognormal", "median": 0.01, "factor": 1e29, "unit": "N m"}},
         "drag: an upper quartile of .* cannot be: above .* could not move it; check its width"),
        ({"k2t": {"dist": "normal", "mean": 1.0, "sd": 1e29, "unit": "N m/rad"}}, "k2t: a lower quartile of -.* one"),
        ({"nu": {"dist": "loguniform", "lower": 1e-29, "upper": 1e29, "unit": "s/rad"}}, "nu: an upper quartile"),
        ({"tail": {"dist": "normal", "mean": 0.5, "sd": 1e29, "unit": "1"}}, "tail: a lower quartile .* have -1 to 2"),
    ],
)  # fmt: skip
def test_a_prior_beyond_what_can_be_is_named_with_its_limit(campaign, prior, said):
    with pytest.raises(InputError, match=said):
        campaign_priors(prior, campaign)


def test_all_of_them_at_once(campaign):
    with pytest.raises(InputError) as error:
        campaign_priors({"mu": 1e9, "drag": 1e9, "nu": 1e9}, campaign)
    assert len(error.value.faults) == 3


def test_bold_priors_that_can_be_pass(campaign):
    bold = {"mu": 1.0, "drag": 0.5, "c1t": 0.5, "c2t": 2.0, "k2t": 100.0, "nu": 3000.0, "tail": 1.5, "theta0": 0.2}
    assert campaign_priors(bold, campaign).fixed == bold


@pytest.mark.parametrize("name", sorted(p.stem for p in (ROOT / "priors").glob("campaign*.toml")))
def test_shipped_priors_pass(campaign, name):
    entries = {k: v for k, v in load_priors(name).to_dict().items() if k in ("mu", "drag", "c1t", "c2t", "c3t", "nu")}
    assert campaign_priors(entries, campaign).free
