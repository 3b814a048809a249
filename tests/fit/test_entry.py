"""Fits: recorded trials and published features, files, refusals, going on after a stop."""

from __future__ import annotations

import html
import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom
from test_ensembles import Gaussian, start_of

from bayes_damper.campaign import record_text
from bayes_damper.commands.demo import demo
from bayes_damper.commands.resume import resume
from bayes_damper.effects import EFFECTS
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.fit import (
    DRAWN,
    WARM,
    expected_steps,
    fit,
    load_fit,
    plan_fit,
    published_posterior,
    sampled,
    start_run,
)
from bayes_damper.fit.draw import search
from bayes_damper.fit.published import feature_posterior
from bayes_damper.priors.files import load_priors
from bayes_damper.published.posterior import Datum
from bayes_damper.runs.json_files import write_json
from bayes_damper.sampling import Progress, StoppingRule, arviz_adapter
from bayes_damper.simulation.model import Model

TRUTH = {"mu": 0.006, "k2t": 1.5, "c2t": 0.05, "drag": 0.004, "nu": 40.0, "c1t": 0.01, "c3t": 0.008}
RIG = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.1, "r": 0.0127, "N0": 100.0}


def _campaign(folder, cases=("IV",), duration=0.3, seed=0, effect=None, values=None):
    """A campaign of two repeats of both configurations, simulated with known parameters and perhaps an effect."""
    rng = np.random.default_rng(seed)
    (folder / "trials").mkdir(parents=True)
    (folder / "campaign.toml").write_text(
        'name = "known"\ncaveats = ["Made by a test."]\n[rig]\nprimary_inertia = 3.015e-3\n'
        "secondary_inertia = 2.474e-3\nbar_radius = 0.1\nmagnet_radius = 0.0127\nmagnet_pull = 100.0\n",
        encoding="utf-8",
    )
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial"]
    times = np.arange(round(duration * 1000)) * 1e-3
    for case in cases:
        k1t, degrees = {"IV": (10.2, 4.7), "I": (6.2, 5.7)}[case]
        for configuration in ("uncoupled", "coupled"):
            for trial in (1, 2):
                theta0 = math.radians(degrees) * (1.0 + 0.01 * rng.standard_normal())
                model = Model(coupled=configuration == "coupled", effect=effect)
                y = model.simulate(RIG | TRUTH | {"k1t": k1t, "theta0": theta0}, times, effect=values).y[0]
                y = y + 2.0 * rng.standard_normal(y.shape)
                name = f"trials/{case}-{configuration}-{trial}.csv"
                (folder / name).write_text(record_text(times, y, "torsional", "acceleration"), encoding="utf-8")
                rows.append(f"{name},{case},{configuration},{k1t},{degrees},{0.01 * degrees},{trial}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


class Told:
    """Progress that remembers."""

    def __init__(self):
        self.updates = []

    def update(self, task, share, text):
        self.updates.append((task, share, text))


TOLD = Told()


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    home = tmp_path_factory.mktemp("fit")
    return fit(_campaign(home / "campaign"), out=home / "out", seed=3, progress=TOLD)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_fit_of_one_trial_gives_the_parameters_of_that_trial(tmp_path):
    campaign = _campaign(tmp_path / "campaign")
    rows = (campaign / "trials.csv").read_text(encoding="utf-8").splitlines()
    (campaign / "trials.csv").write_text("\n".join(rows[:2]) + "\n", encoding="utf-8")
    entry = fit(campaign, out=tmp_path / "out", most_steps=100).summary["cases"]["IV"]
    assert any(sentence.startswith("There is one trial: parameters") for sentence in entry["sentences"])
    (own,) = entry["trials"].values()
    assert not {"ln_k1t", "ln_c1t", "ln_drag"} & set(own)
    low, high = entry["parameters"]["c1t"]["hdi90"]
    assert low < TRUTH["c1t"] < high


@pytest.mark.slow
def test_progress_tells_what_is_left_when_all_is_drawn(fitted):
    """The draws are two thirds of the work; what comes after has shares of its own, and so have the files of all."""
    assert fitted.converged
    own = [(share, text) for task, share, text in TOLD.updates if task == "case IV"]
    assert [share for share, _ in own] == sorted(share for share, _ in own)
    drawing = [share for share, text in own if text.startswith("sampling,")]
    assert max(drawing) <= 0.7
    left = [text for share, text in own if share >= 0.7 and "next: " in text]
    assert left[0].endswith("next: predictions, evidence, files, figures")
    assert left[-1].endswith("next: figures")
    assert own[-1] == (1.0, "done")
    assert [task for task, _, _ in TOLD.updates[-2:]] == ["overview", "overview"]


def test_progress_of_the_draws_moves_from_the_first_and_expects_what_it_takes(tmp_path):
    """Before the first judgement too, which comes after three states; what was expected then holds within a factor."""
    target = Gaussian(12)
    plan = {"campaign": "known", "seed": 1, "thorough": True, "most_steps": None}
    told = []
    drawn = sampled(target, tmp_path, lambda *news: told.append(news), plan, lambda: start_of(target))
    assert drawn.converged
    shares = [share for share, text in told if text.startswith("sampling,")]
    steps = [tuple(map(int, re.findall(r"\d+", text))) for _, text in told if text.startswith("sampling,")]
    assert WARM < shares[0] < shares[1] < shares[2]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(DRAWN)
    assert steps[-1][0] == steps[-1][1] == drawn.verdict.steps
    assert all(0.5 < expected / drawn.verdict.steps < 2.0 for _, expected in steps)
    warming = [share for share, text in told if text.startswith("warm-up")]
    assert len(set(warming)) > 4, "after each ensemble's round"
    assert warming == sorted(warming)
    assert 0.01 < warming[0] < 0.1 < warming[-1] == pytest.approx(WARM)


def test_expected_steps_end_with_the_budget():
    """Where a run gives up after 90 steps, no more are expected, however far off the rule is."""
    rule = StoppingRule(max_steps=90)
    assert expected_steps(Progress("drawing", 25, 0.0, 1.0, None, 8.0, 75), rule) == 90
    assert expected_steps(Progress("drawing", 100, 0.0, 1.0, None, 8.0, 75), rule) == 100


@pytest.mark.slow
def test_a_fit_of_records_converges_and_covers_the_truth(fitted):
    assert fitted.converged
    assert fitted.exit_code == ExitCode.DONE
    found = fitted.summary["cases"]["IV"]["parameters"]
    for name, value in TRUTH.items():
        p = found[name]
        assert abs(p["mean"] - value) < 4.0 * p["sd"], name
        assert p["r_hat"] <= 1.01
        assert min(p["ess_bulk"], p["ess_tail"]) >= 1000
    assert found["sigma1"]["mean"] == pytest.approx(2.0, rel=0.1)
    assert fitted.summary["warnings"] == ["Made by a test."]
    assert fitted.text().startswith("`bayes-damper check` lists 1 warning about these trials; it holds here too.\n")
    assert found["friction_torque"]["mean"] == pytest.approx(found["mu"]["mean"] * 10.0, rel=1e-9)
    assert found["c1t"]["prior_share"] < 0.3
    low, high = found["friction_torque"]["prior"]["hdi90"]
    assert low < 0.06 < high, "what was assumed is told of what follows from parameters and constants too"
    assert found["c1t"]["prior"]["hdi90"][1] > 10.0 * (found["c1t"]["hdi90"][1] - found["c1t"]["hdi90"][0])
    table = pd.read_csv(fitted.folder / "summary.csv")
    assert "prior_hdi90_low" in table
    assert (table["quartile_low"] <= table["median"]).all()
    assert (table["median"] <= table["quartile_high"]).all()


@pytest.mark.slow
def test_the_files_of_a_fit_are_there_and_readable(fitted):
    folder = fitted.folder
    for name in ("summary.json", "summary.csv", "forest.svg", "IV/corner.png", "IV/trace.svg", "IV/records.svg"):
        assert (folder / name).stat().st_size > 500, name
    tree = arviz_adapter.read(folder / "IV" / "posterior.nc")
    assert {"posterior", "prior", "log_likelihood", "observed_data", "sample_stats"} <= set(tree.children)
    assert tree["posterior"]["mu"].dims == ("chain", "draw")
    assert arviz_adapter.read(folder / "posterior.nc")["posterior"]["mu"].sizes["case"] == 1
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["schema"] == "bayes-damper/fit/1"
    assert len(summary["cases"]["IV"]["trials"]) == 4


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_fit_with_an_effect_infers_its_parameters(tmp_path):
    drag = EFFECTS["quadratic_drag"].variant("alike")
    campaign = _campaign(tmp_path / "campaign", effect=drag, values={"coefficient": 0.8})
    found = fit(campaign, out=tmp_path / "out", effect="quadratic_drag", most_steps=100, joint=False)
    entry = found.summary["cases"]["IV"]
    assert entry["best_fit"]["effect"] == "quadratic_drag"
    (meaning,) = entry["best_fit"]["meanings"].values()
    assert meaning in found.text()
    coefficient = entry["parameters"]["effect.coefficient"]
    assert coefficient["unit"] == "1/rad"
    assert abs(coefficient["mean"] - 0.8) < 4.0 * coefficient["sd"]
    assert coefficient["sd"] < 0.3


@pytest.mark.slow
def test_a_finished_run_is_not_run_again_and_another_one_is_refused(fitted):
    again = resume(fitted.folder)
    assert again.summary["cases"] == fitted.summary["cases"]
    plan = json.loads((fitted.folder / "run.json").read_text())["plan"]
    with pytest.raises(InputError, match="another run"):
        fit(plan["campaign"], out=fitted.folder, seed=4)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_workers_give_what_one_gives_also_where_it_does_not_converge(tmp_path):
    """Two cases at once, of which each has its ensembles on two more processes."""
    campaign = _campaign(tmp_path / "campaign", ("IV", "I"), duration=0.2)
    one = fit(campaign, cases=["IV"], out=tmp_path / "one", most_steps=1, workers=1)
    four = fit(campaign, out=tmp_path / "four", most_steps=1, joint=False, workers=4)
    for stopped in (one, four):
        assert not stopped.converged
        assert stopped.exit_code == ExitCode.NOT_CONVERGED
        assert "DID NOT CONVERGE" in stopped.text()
        assert any("more steps" in sentence for sentence in stopped.summary["cases"]["IV"]["sentences"])
    entries = [dict(found.summary["cases"]["IV"]) for found in (one, four)]
    for entry in entries:
        del entry["sentences"]  # they tell the pace of the machine
    assert entries[0] == entries[1]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"campaign": "thesis", "cases": ["V"]}, "no such case"),
        ({"campaign": "nowhere"}, "nowhere"),
        ({"campaign": "thesis", "priors": "nowhere.toml"}, "nowhere.toml"),
        ({"campaign": "thesis", "normal_force": "square"}, "linear or constant"),
        ({"campaign": "thesis", "effect": "stick_slip"}, "needs records"),
        ({"campaign": "thesis", "effect": "stick_slip+spring_cubic"}, "needs records"),
    ],
)
def test_bad_arguments_get_a_sentence(arguments, told):
    defaults = dict.fromkeys(("cases", "priors", "normal_force", "most_steps"))
    with pytest.raises(InputError, match=told):
        plan_fit(**(defaults | {"seed": 1, "thorough": False, "joint": True} | arguments))


def test_two_effects_stand_in_the_plan_as_one_word(tmp_path):
    """However they were given; a plan of one, or of none, is what it was."""
    folder = str(_campaign(tmp_path / "campaign"))
    defaults = dict.fromkeys(("cases", "priors", "normal_force", "most_steps"))

    def planned(effect):
        return plan_fit(folder, **defaults, seed=1, thorough=False, joint=True, effect=effect)["effect"]

    for given in (("release_offset", "spring_cubic"), "release_offset+spring_cubic", ["release_offset + spring_cubic"]):
        assert planned(given) == "release_offset+spring_cubic"
    assert planned("spring_cubic") == planned(["spring_cubic"]) == "spring_cubic"
    assert planned(None) is planned([]) is None
    for given, told in (
        ("release_offset+spring_cubi", "--effect spring_cubi: there is no such effect; .*spring_cubic"),
        (("spring_cubic", "spring_cubic"), "--effect spring_cubic --effect spring_cubic: this is the same effect"),
        ("sensor_gain+sensor_clipping", "--effect sensor_gain --effect sensor_clipping: the simulation has no room"),
        ("spring_cubic+stick_slip+sensor_gain", "a fit takes one effect, or two at once; leave out 1 of these"),
        ("spring_cubic+", "--effect spring_cubic --effect : a name is missing"),
    ):
        with pytest.raises(InputError, match=told):
            planned(given)


def test_a_case_cannot_be_called_what_results_call_their_own_folders(tmp_path):
    folder = _campaign(tmp_path / "campaign")
    rows = (folder / "trials.csv").read_text()
    (folder / "trials.csv").write_text(rows.replace(",IV,", ",joint,"))
    plan = dict.fromkeys(("cases", "priors", "normal_force", "most_steps"))
    with pytest.raises(InputError, match="case 'joint': results have a folder of that name"):
        plan_fit(str(folder), **plan, seed=1, thorough=False, joint=True)


def test_a_campaign_that_has_changed_is_told_before_anything_runs(tmp_path):
    folder = _campaign(tmp_path / "campaign")
    plan = plan_fit(str(folder), cases=None, priors=None, normal_force=None, seed=1, thorough=False, most_steps=None,
                    joint=True)  # fmt: skip
    start_run(tmp_path / "out", {"command": "fit", "plan": plan, "workers": 1})
    rows = (folder / "trials.csv").read_text()
    (folder / "trials.csv").write_text(rows.replace("10.2", "10.3"))
    with pytest.raises(InputError, match="the campaign has changed since this run began"):
        resume(tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["run.json"]


def test_a_folder_without_a_run_cannot_be_resumed(tmp_path):
    with pytest.raises(InputError, match=r"run\.json"):
        resume(tmp_path)


def test_a_fit_may_lie_in_a_folder_called_variability(tmp_path):
    """Which is what the pieces of `variability` are called: told by what runs there, not by the name."""
    write_json(tmp_path / "variability" / "run.json", {"command": "fit", "plan": {}})
    with pytest.raises(InputError, match="holds no plan of this version"):
        resume(tmp_path / "variability")


def _begun(tmp_path, **changes):
    """A folder in which a fit of the thesis's cases has just begun, and its record."""
    defaults = dict.fromkeys(("cases", "priors", "normal_force", "most_steps"))
    plan = plan_fit("thesis", **(defaults | {"seed": 1, "thorough": False, "joint": True} | changes))
    record = {"command": "fit", "plan": plan, "workers": 1}
    start_run(tmp_path, record)
    (tmp_path / "I").mkdir()
    return record


@pytest.mark.parametrize("name", ["bayes_damper", "source files (SHA-256)", "numpy", "emcee"])
def test_a_run_of_another_version_is_refused_before_any_work(tmp_path, name):
    record = _begun(tmp_path)
    there = json.loads((tmp_path / "run.json").read_text())
    now = there["made_by"][name]
    write_json(tmp_path / "run.json", there | {"made_by": there["made_by"] | {name: "0.0.7"}})
    said = re.escape(f"{name} was 0.0.7 and is {now} now")
    with pytest.raises(InputError, match=said):
        resume(tmp_path)
    with pytest.raises(InputError, match=said):
        start_run(tmp_path, record)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["I", "run.json"]


def test_the_demo_after_an_upgrade_says_what_to_type_and_touches_nothing(tmp_path):
    home = tmp_path / "demo"
    home.mkdir()
    _begun(home)
    there = json.loads((home / "run.json").read_text())
    write_json(home / "run.json", there | {"made_by": there["made_by"] | {"bayes_damper": "0.0.7"}})
    with pytest.raises(InputError, match=r"an unfinished run of another version .* install again what it began with"):
        demo(home)
    (home / "summary.json").write_text("{}")
    (tmp_path / "demo-2").mkdir()
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    with pytest.raises(InputError) as raised:
        demo(home)
    beside = tmp_path / "demo-3"
    for said in ("holds results that are complete", f"begin with --out {beside}", f"mv {home} {beside}",
                 f"make demo DEMO_OUT={beside}"):  # fmt: skip
        assert said in str(raised.value)
    assert {path: path.read_bytes() for path in home.rglob("*") if path.is_file()} == before
    assert not beside.exists()


def test_another_plan_is_refused_with_every_difference(tmp_path):
    before = _begun(tmp_path, cases=["I", "II"])
    plan = json.loads(json.dumps(before["plan"])) | {"seed": 2, "cases": ["I"]}
    plan["priors"]["mu"]["median"] = 0.5
    with pytest.raises(InputError) as raised:
        start_run(tmp_path, before | {"plan": plan})
    median = before["plan"]["priors"]["mu"]["median"]
    for said in (
        "seed was 1 and is 2 now",
        "cases was I, II and is I now",
        f"priors.mu.median was {median} and is 0.5 now",
    ):
        assert said in str(raised.value)
    start_run(tmp_path, before | {"workers": 2})  # as many processes as one likes


@pytest.mark.prove
def test_features_drawn_from_the_model_are_recovered_at_the_stated_rate():
    """Parameters drawn from the prior lie in their 90 % intervals nine times in ten, over many synthetic theses."""
    priors = load_priors("thesis")
    base = published_posterior("IV", priors)
    rng = np.random.default_rng(11)
    hits, trials = np.zeros(base.ndim), 0
    while trials < 24:
        z = rng.standard_normal(base.ndim)
        truth = base.predict(base.coordinates.sampled(z[None]))[0]
        if not np.isfinite(truth).all():
            continue
        data = [
            Datum(d.configuration, d.quantity, float(m + d.standard_error * rng.standard_t(2)), d.standard_error)
            for d, m in zip(base.data, truth, strict=True)
        ]
        posterior = feature_posterior(data, "IV", priors)
        drawn = posterior.coordinates.standard(search(posterior, rng, 512).population)
        low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
        hits += (z >= low) & (z <= high)
        trials += 1
    total = hits.sum()
    n = trials * base.ndim
    # Parameters of one posterior are not independent: half of the trials is taken as the effective number.
    assert binom.ppf(0.001, n // 2, 0.9) / (n // 2) <= total / n <= binom.ppf(0.999, n // 2, 0.9) / (n // 2)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")
def test_ctrl_c_with_two_workers_saves_and_ends(tmp_path):
    """As in a terminal, where all processes get the signal; more tasks than workers, of which none may begin then."""
    campaign = _campaign(tmp_path / "campaign", ("I", "IV"))
    out = tmp_path / "out"
    # A shell's background jobs ignore Ctrl-C, and so does what they start; here it is to be heard wherever this runs.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from bayes_damper.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", code, "fit", str(campaign), "--workers", "2", "--thorough", "--out", str(out)]
    with subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120.0
        while not list(out.glob("*/state/*")) and time.monotonic() < deadline:
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60.0)
    assert process.returncode == ExitCode.INTERRUPTED, told
    assert f"bayes-damper resume {out}" in told
    assert "Traceback" not in told
    assert list(out.glob("*/state/*"))
    assert not list(out.glob("*/done.json"))


def test_a_fit_is_read_from_its_folder_and_says_first_what_its_model_misses(tmp_path):
    k2t = {"unit": "N m/rad", "mean": 1.0, "sd": 0.1, "median": 1.0, "hdi90": [0.9, 1.1], "r_hat": 1.0,
           "ess_bulk": 1000.0, "ess_tail": 1000.0, "prior_share": 0.1}  # fmt: skip
    channel = {"channel": 1, "repeats": 1.0, "left_over_floor": 1.9, "learnt_from": "residuals"}
    case = {"converged": True, "parameters": {"k2t": k2t}, "sentences": [], "noise": {"channels": [channel]}}
    summary = {"schema": "bayes-damper/fit/1", "campaign": "cart", "converged": True, "cases": {"IV": case}}
    write_json(tmp_path / "summary.json", summary)
    found = load_fit(tmp_path)
    assert "case IV   *** THE MODEL MISSES SOMETHING: run `bayes-damper diagnose`" in found.text()
    assert repr(found) == f"Fit({str(tmp_path)!r}: cart, cases IV, converged)"
    assert found._repr_html_() == f"<pre>{html.escape(found.text())}</pre>"
    report = f"bayes-damper report {shlex.quote(str(tmp_path))}"
    assert found.text().endswith(f"\nNext: {report}")
    write_json(tmp_path / "run.json", {"command": "fit", "plan": {"campaign": "my cart"}})
    assert found.text().endswith(f"\nNext: bayes-damper diagnose 'my cart' --out results/diagnose\nOr: {report}")
    case["best_fit"] = {"effect": "spring_cubic", "formula": "Q1 = -k1t a th1^3"}
    write_json(tmp_path / "summary.json", summary)
    told = load_fit(tmp_path).text()
    assert "  Effect: Q1 = -k1t a th1^3" in told
    case["parameters"]["c1t"] = k2t | {"unit": "N s/m"}
    write_json(tmp_path / "summary.json", summary)
    assert "  Effect: F1 = -k1t a x1^3" in load_fit(tmp_path).text()
    assert told.endswith(f"\nNext: {report}")
    assert "*** THE MODEL MISSES SOMETHING BESIDE spring_cubic: the intervals are wider for it ***" in told
    assert "run `bayes-damper diagnose`" not in told
    case["noise"]["channels"][0]["learnt_from"] = "repeats"
    write_json(tmp_path / "summary.json", summary)
    assert "MISSES" not in load_fit(tmp_path).text()
    write_json(tmp_path / "summary.json", {"schema": "bayes-damper/diagnosis/1"})
    with pytest.raises(InputError, match="not the summary of a fit"):
        load_fit(tmp_path)
