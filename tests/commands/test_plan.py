"""Before measuring: the algebra against dense matrices, faults of a plan, and its forecasts against real diagnoses."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import CAMPAIGN_TOML, write_synthetic

from bayes_damper.calibration.own_values import RELATIVE
from bayes_damper.campaign import load_plan
from bayes_damper.cli import main
from bayes_damper.commands.plan import (
    NATS,
    Bench,
    Plan,
    _noise_of_records,
    _standard,
    expected,
    judge,
    plan,
    planned_fit,
)
from bayes_damper.diagnosis import diagnose
from bayes_damper.diagnosis.search import offered
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import InputError
from bayes_damper.simulation.model import Model

FEW = {name: EFFECTS[name] for name in ("quadratic_drag", "spring_cubic", "sensor_gain")}
TOML = CAMPAIGN_TOML.replace("noise_std = 2.0", "noise_std = 2.0\nduration = 0.5")


def write_plan(folder: Path, toml: str = TOML, repeats: int = 3, degrees: tuple[float, float] = (5.7, 4.7)) -> Path:
    """A plan of two cases, both configurations, without records."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial"]
    for (case, k1t), angle in zip((("I", 6.2), ("IV", 10.2)), degrees, strict=True):
        for word in ("uncoupled", "coupled"):
            rows += [
                f"trials/{case}_{word}_{i}.csv,{case},{word},{k1t},{angle},{0.01 * angle:.4f},{i}"
                for i in range(1, repeats + 1)
            ]
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    campaign = load_plan(write_plan(tmp_path_factory.mktemp("plan")))
    return campaign, judge(campaign, FEW)


def test_the_noise_of_records_that_are_there_stands_in_for_a_declared_one(tmp_path):
    """Half measured: both channels' noise from the coupled trials that exist; the second like the first before that."""
    folder = write_synthetic(tmp_path, noise=2.0)
    toml = (folder / "campaign.toml").read_text().replace("noise_std = 2.0\n", "")
    (folder / "campaign.toml").write_text(toml)
    (folder / "trials" / "IV_coupled_2.csv").unlink()
    assert _noise_of_records(load_plan(folder)) == pytest.approx((2.0, 2.0), rel=0.1)
    for i in (1, 3):
        (folder / "trials" / f"IV_coupled_{i}.csv").unlink()
    first, second = _noise_of_records(load_plan(folder))
    assert first == second == pytest.approx(2.0, rel=0.1)


def test_planned_records_last_as_declared_and_hold_nothing(tmp_path):
    campaign = load_plan(write_plan(tmp_path))
    assert len(campaign.trials) == 12
    assert all(t.times[-1] == pytest.approx(0.5) and not np.any(t.channels) for t in campaign.trials)
    free = load_plan(write_plan(tmp_path / "b", CAMPAIGN_TOML))
    period = 2.0 * math.pi * math.sqrt(3.015e-3 / 6.2)
    assert free.trials[0].times[-1] == pytest.approx(8.0 * period, abs=1e-3)


def test_what_the_nominal_model_leaves_is_that_of_the_whole_gaussian(tmp_path):
    """d' (1 + A A')^-1 d with A all derivatives of parameters and nuisances of all trials, written out."""
    fit = planned_fit(load_plan(write_plan(tmp_path, repeats=2)), "nonlinear", None)
    bench = Bench(fit)
    _, variant = offered(fit.problem.experiment, "nonlinear", {"quadratic_drag": EFFECTS["quadratic_drag"]})[0]
    columns = bench.changes(variant, _standard(variant, variant.starts[0])[None])
    total = sum(b.r.size for b in bench.blocks)
    nuisances = sum(b.T.shape[0] * b.T.shape[1] for b in bench.blocks)
    A, d = np.zeros((total, fit.problem.size + nuisances)), np.zeros(total)
    row, column = 0, fit.problem.size
    for block, change in zip(bench.blocks, columns, strict=True):
        for k in range(len(block.r)):
            place = slice(row, row + block.r.shape[1])
            A[place, : fit.problem.size] = block.J[k].T
            A[place, column : column + block.T.shape[1]] = block.T[k].T
            d[place] = change[k, 0]
            row, column = place.stop, column + block.T.shape[1]
    exact = d @ d - d @ A @ np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ d)
    assert bench.pieces(columns).left()[0, 0] == pytest.approx(exact, rel=1e-6)


def test_repeats_count_as_if_they_had_been_planned(tmp_path):
    """Two trials of each for fitting, taken three times, against six; the held-out one is added to both."""
    few = planned_fit(load_plan(write_plan(tmp_path / "few", repeats=3)), "nonlinear", None)
    many = planned_fit(load_plan(write_plan(tmp_path / "many", repeats=7)), "nonlinear", None)
    _, variant = offered(few.problem.experiment, "nonlinear", {"spring_cubic": EFFECTS["spring_cubic"]})[0]
    z = _standard(variant, variant.starts[0])[None]
    lengths = [float(b.pieces(b.changes(variant, z)).left(m)[0, 0]) for b, m in ((Bench(few), 3), (Bench(many), 1))]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-9)


def test_evidence_of_an_effect_that_does_not_show_is_not_positive():
    assert expected(0.0, 2) == 0.0
    assert expected(2.0, 2) < 0.0
    assert expected(100.0, 1) > 40.0


def test_the_result_says_what_would_be_seen(planned):
    _, result = planned
    rows = {row["name"]: row for row in result["effects"]}
    assert set(rows) == set(FEW)
    assert all(0.0 <= row["chance"] <= 1.0 for row in rows.values())
    assert rows["spring_cubic"]["chance"] > 0.9
    assert 0.0 < abs(rows["sensor_gain"]["smallest"]["error"]["value"]) < 0.05
    assert all(p["sd_over_prior"] <= 1.0 for p in result["parameters"].values())
    low, high = result["parameters"]["c1t"]["expected90"]
    wide = result["parameters"]["c1t"]["prior90"]
    assert wide[0] < low < high < wide[1]
    assert rows["sensor_gain"]["smallest"]["error"]["unit"] == ""
    json.dumps(result, allow_nan=False)


def test_expected_intervals_allow_for_trials_that_differ_as_usual_or_as_declared(planned, tmp_path):
    """What scatters by 5 % from trial to trial is known from eight trials to no less than 5 % / sqrt(8)."""
    steady = write_plan(tmp_path, TOML + "[scatter]\n" + "".join(f"{name} = 0\n" for name in RELATIVE))
    widths = []
    for result in (planned[1], judge(load_plan(steady), FEW)):
        low, high = result["parameters"]["c1t"]["expected90"]
        widths.append((high - low) / (high + low) / 1.645)
    assert widths[0] > 0.05 / math.sqrt(8.0) > 2.0 * widths[1]


def test_a_plan_ends_with_the_command_that_comes_next(planned):
    _, result = planned
    best = {"configuration": "coupled", "k1t_n_m_per_rad": 6.2, "theta0_deg": 10.0, "helps": ["spring_cubic"]}
    idle = {**best, "helps": []}
    add = "To distinguish more (spring_cubic): plan one more coupled trial, k1t 6.2 N m/rad, released at 10 deg."
    measure = "Next: measure these trials, put the records into the folder, and run: bayes-damper check 'my rig'"
    found = {**result, "add": [idle, best]}
    assert Plan(found, None, "my rig").text().splitlines()[-2:] == [add, measure]
    diagnose_it = "Next: bayes-damper diagnose 'my rig' --out results/diagnose"
    assert Plan(found, None, "my rig", recorded=True).text().splitlines()[-2:] == [add, diagnose_it]
    assert "To distinguish more" not in Plan({**result, "add": [idle]}, None, "my rig").text()


def test_a_plan_says_what_its_effects_are(tmp_path):
    few = {name: FEW[name] for name in ("quadratic_drag", "sensor_gain")}
    result = judge(load_plan(write_plan(tmp_path, TOML.replace("noise_std = 2.0", "noise_std = 9e6"))), few)
    blind = next(s for s in result["sentences"] if s.startswith("Not seen"))
    assert "sensor_gain (wrong scale of one channel)" in blind
    assert "quadratic_drag (drag that grows with the square of the speed)" in blind


def test_more_noise_sees_less(planned, tmp_path):
    _, quiet = planned
    loud = judge(load_plan(write_plan(tmp_path, TOML.replace("noise_std = 2.0", "noise_std = 40.0"))), FEW)
    quiet_rows, loud_rows = ({row["name"]: row for row in r["effects"]} for r in (quiet, loud))
    for name in FEW:
        assert loud_rows[name]["chance"] <= quiet_rows[name]["chance"]
    parameters = zip(quiet["parameters"].values(), loud["parameters"].values(), strict=True)
    assert all(a["sd_over_prior"] <= b["sd_over_prior"] + 1e-9 for a, b in parameters)
    assert loud["add"][0]["nats"] >= loud["add"][-1]["nats"] > 0.0


def test_a_twin_of_an_effect_is_its_strongest_rival(tmp_path):
    """Stiffness at one angle and spring is all that a hardening spring can be told by: the rival is found."""
    toml = TOML.replace("noise_std = 2.0", "noise_std = 60.0")
    names = ("spring_cubic", "quadratic_drag", "stiffness_error")
    few = judge(load_plan(write_plan(tmp_path, toml)), {n: EFFECTS[n] for n in names})
    assert few["matrix"]["spring_cubic"]["stiffness_error"] < 0.5 * few["matrix"]["spring_cubic"]["quadratic_drag"]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("noise_std = 2.0", "", "noise_std is missing"),
        ("sample_rate = 1000.0", "", "sample_rate is missing"),
        ("duration = 0.5", "duration = 1e-3", "fewer than 16 readings"),
        ("duration = 0.5", "duration = [1.0, 2.0]", "duration must be one number"),
        ("duration = 0.5", "durations = 0.5", "did you mean 'duration'"),
    ],
)
def test_what_a_plan_lacks_is_named(tmp_path, old, new, told):
    with pytest.raises(InputError, match=told):
        plan(write_plan(tmp_path, TOML.replace(old, new)))


def test_a_free_start_cannot_be_planned(tmp_path):
    folder = write_plan(tmp_path, TOML.replace("sample_rate", 'start = "free"\nsample_rate'))
    rows = (folder / "trials.csv").read_text().splitlines()
    emptied = [",".join([*r.split(",")[:4], "", "", r.split(",")[6]]) for r in rows[1:]]
    (folder / "trials.csv").write_text("\n".join([rows[0], *emptied]) + "\n")
    with pytest.raises(InputError, match=r"and the release in trials\.csv"):
        plan(folder)


def test_check_of_a_plan_says_what_can_be_done_with_it(tmp_path, capsys):
    assert main(["check", str(write_plan(tmp_path))]) == 2
    assert "bayes-damper plan" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_a_file_and_a_figure(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bayes_damper.commands.plan.all_effects", lambda _: FEW)
    assert main(["plan", str(write_plan(tmp_path / "rig")), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "spring_cubic" in told
    assert "would be seen" in told
    stored = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert stored["schema"] == "bayes-damper/plan/1"
    assert (tmp_path / "out" / "plan.svg").stat().st_size > 2000


def simulated(campaign, fit, variant=None, values=None, seed=1):
    """The planned campaign measured on a rig at the prior medians, with one effect at work."""
    rng = np.random.default_rng(seed)
    constants = {name: value for name, (value, _) in fit.problem.experiment.constants.items()}
    trials = []
    for t in fit.problem.experiment.trials:
        k1t = fit.problem.experiment.stiffnesses[t.k1t][0]
        theta0 = t.theta0 + t.theta0_sd * rng.standard_normal()
        medians = {name: values[t.case] for name, values in fit.problem._medians.items()}
        rig = constants | medians | {"k1t": k1t, "theta0": theta0}
        y = Model(t.coupled, effect=variant).simulate(rig, t.times, effect=values).y[0]
        trials.append(replace(t, y=y + 2.0 * rng.standard_normal(y.shape)))
    return replace(fit.problem.experiment, trials=tuple(trials))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spring_cubic", "sensor_gain"])  # quadratic drag: the next test
def test_an_effect_called_visible_is_found_and_one_called_invisible_is_not(planned, name):
    """At 2.5 times the smallest size that the plan calls visible a diagnosis names it; at an eighth it does not."""
    campaign, result = planned
    fit = planned_fit(campaign, "nonlinear", None)
    row = next(r for r in result["effects"] if r["name"] == name)
    pool = offered(fit.problem.experiment, "nonlinear", FEW)
    variant = next(v for e, v in pool if e.name == name and v.name == row["variant"])
    nulls = {p.name: p.null for p in variant.parameters}

    def sized(factor):
        return {
            key: p["value"] if nulls[key] is None else nulls[key] + factor * (p["value"] - nulls[key])
            for key, p in row["smallest"].items()
        }

    found = diagnose(simulated(campaign, fit, variant, sized(2.5)), effects=FEW)
    assert found.verdict == name
    faint = diagnose(simulated(campaign, fit, variant, sized(0.125)), effects=FEW)
    assert faint.verdict == "none"
    assert faint.answers.probabilities[name] < 0.3


@pytest.mark.slow
def test_the_evidence_of_a_diagnosis_is_what_the_plan_expects(planned):
    """At the smallest visible size the evidence over seeds is about `NATS`, as forecast without any record."""
    campaign, result = planned
    fit = planned_fit(campaign, "nonlinear", None)
    row = next(r for r in result["effects"] if r["name"] == "quadratic_drag")
    variant = next(
        v for _, v in offered(fit.problem.experiment, "nonlinear", {"quadratic_drag": EFFECTS["quadratic_drag"]})
        if v.name == row["variant"]
    )  # fmt: skip
    values = {key: p["value"] for key, p in row["smallest"].items()}
    gains = []
    for seed in range(3):
        found = diagnose(
            simulated(campaign, fit, variant, values, seed), effects={"quadratic_drag": FEW["quadratic_drag"]}
        )
        gains.append(found.evidence["quadratic_drag"])
    assert np.mean(gains) == pytest.approx(NATS, abs=7.0)
