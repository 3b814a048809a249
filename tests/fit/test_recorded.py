"""The fit of recorded trials with an effect, or with two at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns import write_synthetic
from reference import solve
from small_rig import NOISE, RIG, STIFFNESSES, measured, variant

from bayes_damper.calibration import Experiment, TrialRecord
from bayes_damper.calibration.correlated_noise import fit_with_noise
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.campaign import load_campaign
from bayes_damper.diagnosis import search
from bayes_damper.diagnosis.pairs import ComposedProblem
from bayes_damper.errors import InputError
from bayes_damper.fit import fit
from bayes_damper.fit.plan import plan_fit
from bayes_damper.fit.recorded import _trial_draws, fit_with_effect
from bayes_damper.simulation.composition import compose

HEAVIER, BEHIND = 0.15, 0.012  # of J2; rad by which the secondary lags at the release


def solved(seed=1):
    """Trials by an independent solver: J2 is larger than declared, and the secondary is let go elsewhere."""
    rng = np.random.default_rng(seed)
    times = np.arange(300) * 1e-3
    rig = RIG | {"k1t": STIFFNESSES[0], "tail": 0.0, "J2": RIG["J2"] * (1.0 + HEAVIER)}
    trials = []
    for coupled in (False, True):
        for number in (1, 2):
            theta0 = 0.1 * (1.0 + 0.01 * rng.standard_normal())
            y = solve(rig, times, coupled=coupled, start=(theta0, theta0 + BEHIND, 0.0, 0.0))[0, : 1 + coupled]
            y = y + NOISE * rng.standard_normal(y.shape)
            trials.append(TrialRecord(f"{coupled} {number}", "I", coupled, number, times, y, 0, 0.1, 0.001))
    constants = {name: (RIG[name], 0.0) for name in ("J1", "J2", "R", "r", "N0")}
    return Experiment(constants, ((STIFFNESSES[0], 0.0),), tuple(trials))


@pytest.fixture(scope="module")
def both():
    return fit_with_effect(solved(), "release_offset+inertia_error")


def test_two_effects_are_recovered_from_the_records_of_another_solver(both):
    """By either formula of the offset: what it is in rad, or as a share of the release."""
    found = both.parameters
    error, sd = found["effect.inertia_error.error"]
    assert abs(error - HEAVIER) < 3.0 * sd < 0.1
    own = {name: x for name, x in found.items() if name.startswith("effect.release_offset.")}
    ((name, (value, sd)),) = own.items()
    truth = {"offset": BEHIND, "share": BEHIND / 0.1}[name.rpartition(".")[2]]
    assert abs(value - truth) < 3.0 * sd < 0.5 * truth
    assert both.chi2 / both.problem.n_data == pytest.approx(1.0, abs=0.1)
    effect = both.problem.effect
    assert sorted(part.partition(":")[0] for part in effect.formula.split("; ")) == ["inertia_error", "release_offset"]
    assert {p.unit for p in effect.parameters} <= {"1", "rad"}


def test_what_follows_a_fit_takes_two_effects(both):
    """Its noise is learnt as for one, and the posterior is that of the composed model."""
    noise = fit_with_noise(both.problem.experiment, "gaussian", begin=both)
    assert isinstance(noise.fit.problem, ComposedProblem)
    posterior = RecordPosterior(noise.fit, power=noise.power)
    values = posterior.values(posterior.start[None])
    for name in noise.fit.problem.names:
        if name.startswith("effect."):
            assert values[name][0] == pytest.approx(noise.fit.parameters[name][0], rel=1e-6)
    assert np.isfinite(posterior.evaluated(posterior.start[None], np.random.default_rng(1))[0]).all()


@pytest.mark.slow
def test_names_may_be_two_words_and_come_in_any_order(both):
    again = fit_with_effect(both.problem.experiment, ("inertia_error", "release_offset"))
    assert again.problem.names == both.problem.names
    np.testing.assert_allclose(again.q, both.q, atol=1e-4)


def test_two_that_the_kernel_has_no_room_for_are_refused():
    with pytest.raises(
        InputError, match="--effect sensor_gain --effect sensor_clipping: the simulation has no room for both"
    ):
        fit_with_effect(measured(duration=0.05), "sensor_gain+sensor_clipping")


def test_each_of_two_must_be_possible_on_the_rig():
    alone = measured(duration=0.05, configurations=(False,))
    with pytest.raises(InputError, match=r"--effect inertia_error: .* cannot have it: it needs coupled trials"):
        fit_with_effect(alone, ("spring_cubic", "inertia_error"))


def test_an_effect_that_the_rig_cannot_have_is_refused_before_anything_is_written(tmp_path):
    campaign, out = write_synthetic(tmp_path / "rig", duration=0.3), tmp_path / "out"
    head = campaign / "campaign.toml"
    head.write_text("\n".join(x for x in head.read_text().splitlines() if not x.startswith("magnet_radius")))
    (campaign / "priors.toml").write_text("mu = 0.0\n")
    with pytest.raises(InputError, match=r"stick_slip: the trials of case .* needs coupled trials and a magnet \("):
        fit(campaign, effect="stick_slip", out=out)
    assert not out.exists()


def test_cases_that_can_have_an_effect_are_named_beside_one_that_cannot(tmp_path):
    campaign = write_synthetic(tmp_path / "rig", duration=0.3, cases=[("I", 6.2, 5.2), ("IV b", 10.2, 4.7)])
    rows = (campaign / "trials.csv").read_text().splitlines()
    (campaign / "trials.csv").write_text("\n".join(x for x in rows if ",I,coupled," not in x) + "\n")
    told = (
        "--effect stick_slip: the trials of case I cannot .* needs coupled trials .*; other cases can: --case 'IV b'$"
    )
    with pytest.raises(InputError, match=told):
        fit(campaign, effect="stick_slip", out=tmp_path / "out")


@pytest.mark.slow
def test_two_torques_are_recovered():
    """Both in one kernel; the truth is simulated so too."""
    cubic, drag = variant("spring_cubic"), variant("quadratic_drag")
    truth = {"k3": 60.0, "coefficient": 0.8}
    values = {"first.k3": truth["k3"], "second.coefficient": truth["coefficient"]}
    records = measured(2, effect=compose(cubic, drag), values=values, duration=0.4, repeats=2)
    found = fit_with_effect(records, ("spring_cubic", "quadratic_drag"))
    for name, value in {"spring_cubic.k3": 60.0, "quadratic_drag.coefficient": 0.8}.items():
        mean, sd = found.parameters[f"effect.{name}"]
        assert abs(mean - value) < 3.0 * sd < value, name


@pytest.mark.slow
def test_the_formula_of_an_effect_is_chosen_under_what_itself_leaves(monkeypatch):
    """Under the noise of the nominal model, which holds all that it misses, a wrong formula may lead by a nat."""
    fitted = search.fit_variant

    def misled(nominal, effect, formula, *rest):
        found = fitted(nominal, effect, formula, *rest)
        lead = 1e5 if formula.name == "rounded" else 0.0
        return replace(found, fit=replace(found.fit, log_evidence=found.fit.log_evidence + lead))

    monkeypatch.setattr(search, "fit_variant", misled)
    rig = measured(2, effect=variant("coupling_backlash", "dead_zone"), values={"play": 0.02}, configurations=(False,))
    found = fit_with_effect(rig, "coupling_backlash")
    assert found.problem.effect.name == "dead_zone"
    value, sd = found.parameters["effect.play"]
    assert abs(value - 0.02) < 4.0 * sd < 0.002


def test_no_draw_of_a_trials_own_time_of_release_is_negative():
    group = SimpleNamespace(
        trials=(0,), nuisances=[("release_time", np.zeros(1), np.full(1, 1e-3))], lower=np.zeros((1, 1)),
        upper=np.full((1, 1), np.inf),
    )  # fmt: skip
    problem = SimpleNamespace(experiment=SimpleNamespace(levels={}))
    posterior = SimpleNamespace(problem=problem, parts=[SimpleNamespace(group=group)])
    drawn = {0: np.random.default_rng(1).standard_normal((100, 1))}
    times = _trial_draws(posterior, drawn)[0]["release_time"]
    assert times.min() == 0.0
    assert times.max() == pytest.approx(1e-3 * drawn[0].max())


def test_a_case_of_which_every_trial_is_held_out_is_not_fitted(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, (("I", 6.2, 4.7), ("IV", 10.2, 4.7)), repeats=1)
    rows = (folder / "trials.csv").read_text().splitlines()
    marked = [f"{row},{str(',IV,' in row).lower()}" for row in rows[1:]]
    (folder / "trials.csv").write_text("\n".join([rows[0] + ",holdout", *marked]))
    assert "trials.csv: every trial of case IV is marked holdout: `fit` leaves it out" in load_campaign(folder).warnings
    others = dict.fromkeys(("priors", "normal_force", "most_steps")) | {"seed": 1, "thorough": False, "joint": True}
    plan = plan_fit(str(folder), cases=None, **others)
    assert plan["cases"] == ["I"]
    assert not plan["joint"]
    with pytest.raises(InputError, match="--case IV: each of its trials is marked holdout"):
        plan_fit(str(folder), cases=["IV"], **others)
