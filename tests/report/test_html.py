"""The report: what it says, that it is whole in one file, and that a browser shows it without fault."""

from __future__ import annotations

import base64
import html
import io
import itertools
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from PIL import Image

from bayes_damper import report
from bayes_damper.commands.diagnose import _forecast_words, _rms
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.figures import (
    COLOURS,
    corner_figure,
    forest_figure,
    gap_figure,
    missing_torque_figure,
    new_figure,
    record_figure,
    residual_maps_figure,
    save,
)
from bayes_damper.fit.drawings import draw_overlaid
from bayes_damper.report.charts import pack, record_chart, torque_chart
from bayes_damper.report.html import LARGEST, sentence, typeset
from bayes_damper.report.sections.fit import _trial_table
from bayes_damper.text import NOTHING, number, percent

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
TIMES = np.arange(0.0, 0.5, 1e-3)
LAW = {
    "site": "interface", "bodies": "both", "effect": "learnt_interface", "file": "learnt/interface.toml",
    "formula": "f(x) + tanh(nu v) f(v)", "beside": ["stick_slip"], "effective_degrees_of_freedom": 9.66,
    "closes": {"median": 0.27, "hdi90": [0.2, 1.02]}, "ranges": {"angle": [-0.1, 0.12], "time": [0.0, 1.0]},
    "tables": ["learnt/interface.csv", "learnt/interface_table.csv"],
    "named": {
        "formulas": [{"formula": "-3.1 x^2 v", "probability": 0.9}, {"formula": "0.5 |x| v", "probability": 0.06}],
        "shape_only": 0.04, "grammar": "f(x) g(v) h(t)",
    },
}  # fmt: skip


def unpack(packed: dict) -> np.ndarray:
    """The numbers of `pack`, to half a step, as the report's script reads them."""
    steps = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").astype(np.float64)
    return np.where(steps == -32768, np.nan, packed["low"] + packed["scale"] * (steps + 32767.0))


def parameter(median: float, share: float | None, unit: str = "1") -> dict:
    return {
        "unit": unit, "mean": median, "sd": 0.2 * median, "median": median, "hdi90": [0.7 * median, 1.3 * median],
        "r_hat": 1.002, "ess_bulk": 2300.0, "ess_tail": 1900.0, "prior_share": share,
    }  # fmt: skip


def case(converged: bool = True, outside: bool = False) -> dict:
    return {
        "converged": converged,
        "parameters": {
            "mu": parameter(0.0083, 0.2),
            "nu": parameter(120.0, 0.93, "s/rad"),
            "k2t": parameter(1.3, 0.5, "N m/rad"),
            "friction_torque": parameter(0.081, None, "N m"),
        },
        "sentences": []
        if converged
        else ["The effective sample size of nu is 200, below 1000.", "Continue for about 9 more steps."],
        "predictive": [
            {
                "name": f"case IV: period ({c})", "unit": "s", "measured": 0.11, "standard_error": 0.001,
                "median": 0.111, "hdi50": [0.1105, 0.1115], "hdi90": [0.109, 0.113],
                "percentile": 99.0 if outside else p,
            }
            for c, p in (("uncoupled", 40.0), ("coupled", 55.0))
        ],
    }  # fmt: skip


MORE = {
    "noise": {"kind": "student", "sd": [2.0, 2.1]},
    "unlike_repeats": {
        "trials": [{"trial": "IV coupled #2", "residual_power": 7.3, "or_its_only_repeat": False}],
        "answers": {"mu": {"with": {"value": 0.0083, "sd": 1e-3}, "without": {"value": 0.0071, "sd": 1e-3},
                           "shift_sd": -1.2}},
    },
    "influence": {"IV coupled #2": {"moves_most": "mu", "shift_sd": -1.2, "shifts_sd": {"mu": -1.2}}},
    "prior_sensitivity": {"nu": {
        "prior_share": 0.93, "decided_by": "prior",
        "half": {"shift": -0.61, "width": 0.5, "moves_most": "mu", "shift_of_that": 0.1, "reliable": True},
        "double": {"shift": 0.85, "width": 1.9, "moves_most": "k2t", "shift_of_that": -0.2, "reliable": False},
    }},
    "log_evidence": {"value": -812.34, "error": 0.05, "health": 0.4, "sentence": ""},
}  # fmt: skip
"""What a fit of recorded trials tells beside its parameters."""


def write_fit(folder: Path, converged: bool = True, outside: bool = False) -> None:
    cases = {"III": case(converged, outside), "IV": case() | MORE}
    summary = {
        "schema": "bayes-damper/fit/1", "campaign": "synthetic <rig>", "campaign_sha256": "a" * 64, "seed": 7,
        "converged": converged, "cases": cases, "provenance": {"commit": "0123456789", "packages": {"numpy": "2.0"}},
    }  # fmt: skip
    (folder / "III").mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    intervals = {"mu": {"III": (0.006, 0.008, 0.01), "IV": (0.007, 0.0083, 0.011)}}
    save(forest_figure(intervals, {"mu": "mu"}, title="mu", converged=converged), folder / "forest")
    write_posterior(folder / "III" / "posterior.nc")


def write_posterior(path: Path) -> None:
    rng = np.random.default_rng(1)
    wave = -250.0 * np.exp(-9.0 * TIMES) * np.cos(57.0 * TIMES)
    y = np.stack([wave, 0.3 * wave]) + 2.0 * rng.standard_normal((2, TIMES.size))
    y[0, 100:104] = np.nan  # a gap
    y[0, 50] += 400.0  # a reading far out
    model = np.stack([wave, 0.3 * wave])[None, None] * (1.0 + 0.01 * rng.standard_normal((1, 40, 1, 1)))
    tree = {
        "observed_data": xr.Dataset({"coupled_1": (("channel", "time"), y)}),
        "posterior_predictive": xr.Dataset({"coupled_1": (("chain", "draw", "channel", "time"), model)}),
        "constant_data": xr.Dataset({"coupled_1": (("time",), TIMES)}),
    }
    xr.DataTree.from_dict(tree).to_netcdf(path, engine="h5netcdf")


def write_diagnosis(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    data = {
        "schema": "bayes-damper/diagnosis/1", "campaign": "synthetic <rig>", "verdict": "stick_slip",
        "credible_set": ["stick_slip", "unknown"],
        "probabilities": {"none": 0.01, "unknown": 0.12, "stick_slip": 0.86, "magnet_cubic": 0.01}, "pair": None,
        "sites": {"interface": 0.95, "none": 0.01, "bearings": 0.04},
        "gap": {"answer": "gap", "p_value": 1e-9, "size": 0.05, "noise_rms": 2.0, "nominal_rms": 2.9,
                "augmented_rms": 2.01, "closed": {"median": 0.97, "hdi90": [0.9, 1.0]}},
        "reading_unit": "rad/s^2",
        "where": {
            "time": [{"start_s": 0.3, "end_s": 0.31, "case": "IV", "configuration": "coupled", "trial": 1,
                      "trials": [1, 2], "channel": 1, "p_value": 2.2e-221}],
            "frequency": [{"low_hz": 5.5, "high_hz": 10.5, "case": None, "configuration": None, "channel": 2,
                           "p_value": 3e-5}],
            "channel": {"1": {"channel": 1, "excess_over_noise": 5.45, "p_value": 0.01}},
            "case": {"IV coupled": {"case": "IV", "configuration": "coupled", "excess_over_noise": -0.15,
                                    "p_value": 1.0}},
            "phase_space": [{"coordinates": ["phi", "slip"], "range": [[0.0, 0.04], [-1.8, 0.0]], "channel": 1,
                             "excess_over_noise": 25.0, "p_value": 0.0}],
            "event": {"instant_s": 0.3, "start_s": 0.29, "end_s": 0.31, "site": "ground2", "impulse_n_m_s": -5.5e-4,
                      "impulse_sd_n_m_s": 7.1e-6, "gain_nats": 30.2, "share": 0.28, "local": False},
        },
        "effects": [{"name": "stick_slip", "variant": "bristle", "site": "interface", "probability": 0.86,
                     "log_evidence": 812.3, "parameters": {"ratio": {"median": 1.4, "hdi90": [1.2, 1.6], "unit": "1"}},
                     "augmented_rms": 2.01, "closed": {"median": 0.97, "hdi90": [0.9, 1.0]}}],
        "indistinguishable": [["stick_slip", "bearing_stribeck"], ["friction_displacement", "normal_force_law"]],
        "next_experiment": [{"configuration": "coupled", "k1t_n_m_per_rad": 10.2, "theta0_deg": 2.7,
                             "expected_information_nats": 1.8}],
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    head = (
        "case,configuration,trial,time_s,torque1_n_m,torque1_sd_n_m,torque2_n_m,torque2_sd_n_m,theta1_rad,omega1_rad_s"
    )
    rows = [f"IV,coupled,1,{t:.3f},{0.01 * np.sin(57 * t):.5f},0.001,{-0.01 * np.sin(57 * t):.5f},0.001,"
            f"{0.08 * np.cos(57 * t):.4f},{4.0 * np.sin(57 * t):.4f}" for t in TIMES]  # fmt: skip
    (folder / "missing_torque.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("torques", "axes"),
    [((1.0, -1.0), ("θ1 - θ2 [rad]", "ω1 - ω2 [rad/s]")), ((0.0, 1.0), ("θ2 [rad]", "ω2 [rad/s]")),
     ((1.0, 0.0), ("θ1 [rad]", "ω1 [rad/s]")), ((1.0, 0.5), ("θ1 [rad]", "ω1 [rad/s]"))],
    ids=["interface", "ground2", "ground1", "bearings"],
)  # fmt: skip
def test_missing_torque_is_drawn_against_the_coordinates_of_its_site(tmp_path, torques, axes):
    x = 0.01 * np.sin(57.0 * TIMES)
    columns = {
        "case": ["IV"] * x.size, "configuration": ["coupled"] * x.size, "trial": [1] * x.size, "time_s": TIMES,
        "torque1_n_m": torques[0] * x, "torque1_sd_n_m": 0.1 + 0.0 * x, "torque2_n_m": torques[1] * x,
        "torque2_sd_n_m": 0.1 + 0.0 * x, "theta1_rad": 3.0 * x, "omega1_rad_s": 50.0 * x, "theta2_rad": x,
        "omega2_rad_s": 20.0 * x,
    }  # fmt: skip
    pd.DataFrame(columns).to_csv(tmp_path / "missing_torque.csv", index=False)
    chart = torque_chart(tmp_path / "missing_torque.csv")
    assert chart is not None
    views = {view["x"]: view for view in chart.data["views"]}
    assert set(views) == {"time [s]", *axes}
    difference = torques[0] == -torques[1]
    body = 2.0 if difference else 1.0 if torques[0] == 0.0 else 3.0
    assert np.allclose(unpack(views[axes[0]]["at"]), body * x, atol=1e-5)


def test_charts_of_a_translational_rig_are_in_newtons_and_metres(tmp_path):
    write_fit(tmp_path)
    chart = record_chart(tmp_path / "III" / "posterior.nc", "m/s^2")
    assert [panel["y"] for panel in chart.data["views"][0]["panels"]][:2] == ["body 1 [m/s²]", "residual [m/s²]"]
    write_diagnosis(tmp_path)
    chart = torque_chart(tmp_path / "missing_torque.csv", translational=True)
    assert chart.title == "Missing force"
    assert [view["x"] for view in chart.data["views"]] == ["time [s]", "x1 [m]", "v1 [m/s]"]
    assert {panel["y"] for view in chart.data["views"] for panel in view["panels"]} == {
        "on body 1 [N]", "on body 2 [N]"
    }  # fmt: skip


def test_the_page_of_a_cart_numbers_its_bodies_and_speaks_of_force(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data |= {"rig": {"kind": "translational", "coupled": True, "magnet": False}, "reading_unit": "m"}
    data["sites"] = {"ground2": 0.6, "ground1": 0.4}
    data["notes"] = ["Nothing can be said about the secondary."]
    data["law"] = LAW
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert not re.search(r"primary|secondary", text)
    assert "ground2, body 2 alone: its mass" in text
    assert "Nothing can be said about body 2." in text
    assert "F = f(x) + tanh(nu v) f(v)" in text
    assert "As a formula: F = -3.1 x² v (probability 0.90); or F = 0.5 |x| v (0.06); none of these: 0.04" in text
    assert "none of these: shape only 0.04" in text
    assert "displacement -0.1 to 0.12 m;" in text
    first = text[: text.index("Probability of each place")]
    assert f"--effects {tmp_path / 'learnt/interface.toml'} --effect learnt_interface" in first


def test_where_no_trial_is_held_out_no_test_is_quoted(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data["gap"] |= {"answer": "cannot tell", "p_value": 1.0, "closed": None}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "No trial could be held out, so this answer is not tested" in text
    assert "do not decide whether" not in text


def test_why_the_test_of_the_gap_does_not_decide_is_said_beside_an_answer(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data["gap"] |= {"answer": "cannot tell", "p_value": 0.11, "why": "held-out residuals are 12 times the sensor noise"}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "does not decide (p = 0.11): held-out residuals are 12 times the sensor noise." in text
    assert "do not decide whether" not in text


def test_a_fit_opens_with_what_the_data_determine_and_what_the_model_misses(tmp_path):
    write_fit(tmp_path)
    data = json.loads((tmp_path / "summary.json").read_text())
    data["cases"]["III"]["parameters"]["k2t"]["prior_share"] = 0.1
    learnt = {"channel": 1, "unit": "rad/s^2", "repeats": 2.0, "left": 5.03, "left_over_floor": 2.5,
              "learnt_from": "residuals"}  # fmt: skip
    quiet = learnt | {"channel": 2, "left": 2.1, "left_over_floor": 1.05, "learnt_from": "repeats"}
    data["cases"]["IV"]["noise"] = {"channels": [learnt, quiet]}
    (tmp_path / "summary.json").write_text(json.dumps(data))
    page = report(tmp_path).path.read_text(encoding="utf-8")
    text = words_of(page)
    first = (
        "If the model were right: Determined by the data: the coefficient of friction between the bodies (mu, "
        "±30 %) in every case; the stiffness of the coupling between the bodies (k2t, ±30 %) in case III. All "
        "runs converged. None of 4 measurements lies"
    )
    assert first in text
    assert (
        "in case IV, channel 1, the residual is 5 rad/s², and repeats differ by 2. The true values may lie outside"
        in text
    )
    assert text.index("The model misses something") < text.index("Determined by the data")
    assert '<section class="answer open">' in page
    assert "Whether the model itself is right" not in text, "something else would change it"
    assert text.index("What next") < text.index("Median and 90 % interval")
    data["cases"]["IV"] |= {
        "best_fit": {"effect": "spring_cubic"},
        "noise": {"channels": [learnt | {"repeats": None, "fast_content": 2.0}]},
    }
    (tmp_path / "summary.json").write_text(json.dumps(data))
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert (
        "The model misses something beside spring to ground that hardens or softens, or the noise is slow: in case IV"
        in text
    )
    assert "fit again with the effect" not in text
    del data["cases"]["IV"]["best_fit"]
    data["cases"]["IV"]["noise"] = {"channels": [quiet]}
    data["cases"]["IV"]["trials"] = {"IV coupled #1": {
        "ln_mu": {"mean": 0.0104, "sd": 0.02, "hdi90": [-0.03, 0.047], "unit": ""}}}  # fmt: skip
    (tmp_path / "summary.json").write_text(json.dumps(data))
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "as large as the noise: at worst, in case IV, channel 2, the residual is 2.1 rad/s², and repeats" in text
    assert "IV coupled #1 mu of this trial over that of all 1.010 0.970 to 1.048 1" in text


def test_the_first_screen_of_a_fit_with_an_effect_has_the_parameters_of_the_effect(tmp_path):
    write_fit(tmp_path)
    data = json.loads((tmp_path / "summary.json").read_text())
    for entry in data["cases"].values():
        entry["parameters"]["effect.k3"] = parameter(120.0, 0.01) | {"unit": "N m/rad^3"}
        entry["best_fit"] = {"effect": "spring_cubic"}
    (tmp_path / "summary.json").write_text(json.dumps(data))
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    first = text[: text.index("What next")]
    assert "Determined by the data: k3 (" in first
    named = "k3 spring to ground that hardens or softens: cubic stiffness, positive when hardening"
    assert f"{named} N m/rad^3 120" in text.replace("³", "^3")
    assert "k3: cubic stiffness, positive when hardening" in text


def test_a_fit_with_two_effects_names_the_effect_of_each_parameter(tmp_path):
    write_fit(tmp_path)
    data = json.loads((tmp_path / "summary.json").read_text())
    for entry in data["cases"].values():
        entry["parameters"]["effect.release_offset.offset"] = parameter(0.01, 0.01) | {"unit": "rad"}
        entry["parameters"]["effect.spring_cubic.k3"] = parameter(120.0, 0.01) | {"unit": "N m/rad^3"}
        entry["best_fit"] = {"effect": "release_offset+spring_cubic"}
        entry["noise"] = {"channels": [{"channel": 1, "unit": "rad/s^2", "repeats": 2.0, "left": 5.0,
                                        "left_over_floor": 2.5, "learnt_from": "residuals"}]}  # fmt: skip
    (tmp_path / "summary.json").write_text(json.dumps(data))
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    first = text[: text.index("What next")]
    assert "Determined by the data: release_offset.offset (±30 %), spring_cubic.k3 (±30 %) and" in first
    assert "misses something beside secondary at another angle at release and spring to ground that hardens" in first
    named = "spring_cubic.k3 spring to ground that hardens or softens: cubic stiffness, positive when hardening"
    assert f"{named} N m/rad^3 120" in text.replace("³", "^3")
    assert "spring_cubic.k3: cubic stiffness, positive when hardening" in text


def test_parameters_on_the_first_screen_are_told_in_words_with_how_well_they_are_known(tmp_path):
    write_fit(tmp_path)
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "The data say nothing about the sharpness with which dry friction changes its sign (nu): its number" in text
    data = json.loads((tmp_path / "summary.json").read_text())
    for entry in data["cases"].values():  # many at once stay names; what may be 0 or twice as much has no percentage
        for name in ("k2t", "c2t", "drag", "c1t", "c3t", "k1t", "J1", "J2"):
            entry["parameters"][name] = parameter(2.0, 0.05) | ({"hdi90": [0.0, 4.4]} if name == "drag" else {})
    (tmp_path / "summary.json").write_text(json.dumps(data))
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "Determined by the data: mu (±30 %), k2t (±30 %), c2t (±30 %), drag, c1t (±30 %), c3t" in text
    for entry in data["cases"].values():
        entry["parameters"].pop("nu")
    (tmp_path / "summary.json").write_text(json.dumps(data))
    assert "All numbers assume that the model is right" in words_of(report(tmp_path).path.read_text("utf-8"))


def test_the_legend_of_a_corner_figure_shows_the_line_of_each_case():
    """On a grey printout only the style of a line tells the cases apart."""
    rng = np.random.default_rng(1)
    figure = corner_figure({k: {"mu": rng.normal(size=500)} for k in ("case I", "case IV")}, {}, title="all cases")
    lines = figure.legends[0].get_lines()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["case I", "case IV"]
    assert [line.get_linestyle() for line in lines] == ["-", "--"]


def test_exponents_are_raised_and_formulas_stay():
    assert typeset("rad/s^2, kg m^-1, th1^3") == "rad/s², kg m⁻¹, th1³"
    assert typeset("N m s^0.5, x^n, 2^(1/2)") == "N m s^0.5, x^n, 2^(1/2)"
    assert sentence("a < b: run `x --y` at 2 m/s^2") == "a &lt; b: run <code>x --y</code> at 2 m/s²"


def test_oddities_of_the_records_stand_on_the_page_once(tmp_path):
    """Below the answers, not above them; a fit and a diagnosis of one campaign tell the same ones."""
    write_fit(tmp_path)
    write_diagnosis(tmp_path)
    told = "trials/2.csv: holds the same readings as trials/1.csv"
    for name in ("summary.json", "diagnosis.json"):
        data = json.loads((tmp_path / name).read_text())
        (tmp_path / name).write_text(json.dumps(data | {"warnings": [told]}))
    page = report(tmp_path).path.read_text()
    assert page.count(told) == 1
    assert page.index('id="answers"') < page.index('href="#records">1 remark on the records') < page.index(told)


def write_tuning(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    loss = {"mean": 12.0, "sd": 1.0, "median": 12.0, "interval90": [10.4, 13.6], "without": 0}
    hertz = {"mean": 8.9, "sd": 0.1, "median": 8.9, "interval90": [8.7, 9.1], "without": 0}
    performance = {"insertion_loss_db": loss, "resonance_hz": hertz, "resonance_without_hz": hertz,
                   "resonance_shift_hz": hertz, "probability_of_target": 0.97}  # fmt: skip
    f = np.linspace(3.0, 18.0, 60)
    peak = 600.0 / (1.0 + (f - 9.0) ** 2)
    band = {
        "frequency_hz": f.tolist(),
        "q05": (0.8 * peak).tolist(),
        "median": peak.tolist(),
        "q95": (1.2 * peak).tolist(),
    }
    design = {"J2": None, "k2t": 2.0, "R": None, "magnet_pull": None, "bar_inertia": 0.0}
    data = {
        "schema": "bayes-damper/tune/1", "case": "IV", "definition": "20 log10", "draws": 400, "target_db": 10.0,
        "design": design, "linear": performance,
        "nonlinear": [{"torque_amplitude_n_m": 0.02} | performance | {"probability_of_target": 0.2}],
        "optimum": {"design": design, "at_bound": ["k2t"], "linear": performance, "nonlinear": []},
        "variance_shares": {"c2t": 0.7, "k2t": 0.2}, "hangs_most_on": "c2t",
        "frequency_response": {"linear, uncoupled": band, "linear, design": band, "0.02 N m, design": band},
    }  # fmt: skip
    (folder / "tune.json").write_text(json.dumps(data), encoding="utf-8")


def write_plan(folder: Path) -> None:
    effect = {
        "name": "magnet_cubic", "site": "interface", "variant": "cubic", "nats": 4.0, "chance": 0.22,
        "typical": {"cubic": {"value": 30.0, "unit": "N m/rad^3"}},
        "smallest": {"cubic": {"value": 66.0, "unit": "N m/rad^3"}},
        "rival": {"name": "interface_relaxation", "nats": 2.4}, "repeats_needed": 6, "repeats_to_see": 3,
    }  # fmt: skip
    data = {
        "schema": "bayes-damper/plan/1", "campaign": "next rig", "effects": [effect], "matrix": {},
        "parameters": {"mu": {"unit": "1", "prior90": [0.001, 0.04], "expected90": [0.0068, 0.0072],
                              "sd_over_prior": 0.02}},
        "add": [{"configuration": "coupled", "k1t_n_m_per_rad": 14.3, "theta0_deg": 7.4, "nats": 5.0,
                 "helps": ["magnet_cubic"]}],
        "sentences": ["0 of 1 effects would be seen at their typical size.",
                      "magnet_cubic would be seen with 6 times as many trials."],
    }  # fmt: skip
    (folder / "plan.json").write_text(json.dumps(data), encoding="utf-8")


def write_everything(folder: Path) -> Path:
    write_fit(folder)
    write_diagnosis(folder / "diagnosis")
    write_tuning(folder)
    models = {
        name: {"log_evidence": z, "error": 0.1, "probability": p, "spread": 0.2, "heldout": {"log_score": -9.0}}
        for name, z, p in (("shared", -60.0, 0.02), ("partial", -55.0, 0.91), ("separate", -57.0, 0.07))
    }
    shares = {
        "schema": "bayes-damper/variability/1", "campaign": "synthetic <rig>", "converged": True, "models": models,
        "decomposition": {"k2t": {"real_difference": {
            "median": 0.2, "hdi90": [0.1, 0.4], "share": {"median": 0.6, "hdi90": [0.2, 0.9]}}}},
        "effective": {"cases": {"IV": {"energy_j": 0.0343, "k2t": {"median": 1.1, "hdi90": [0.9, 1.4]},
                                       "c2t": {"median": 0.07, "hdi90": [0.05, 0.09]},
                                       "measured": {"k2t": 1.0, "c2t": 0.08}}}},
        "recycled": {"ess": {"IV": 412.0}, "pareto_k": {"IV": 0.31},
                     "ess_of_one_population": {"IV": 63.0}, "log_evidence_over_separate": 2.1, "error": 0.2,
                     "direct_log_evidence_over_separate": 1.8, "direct_error": 0.3, "parameters": {"mu": {
                         "common": TWO_WAYS, "scatter": TWO_WAYS, "cases": {"IV": TWO_WAYS}}}},
        "sentences": ["The cases do not share one parameter set (2 %)."],
    }  # fmt: skip
    (folder / "variability.json").write_text(json.dumps(shares), encoding="utf-8")
    write_plan(folder)
    scores = {"schema": "bayes-damper/withheld/1", "scores": {"top_1": 0.9, "covered": 0.93}, "campaigns": [
        {"name": "a1", "verdict": "none", "right": True}]}  # fmt: skip
    (folder / "withheld.json").write_text(json.dumps(scores), encoding="utf-8")
    return folder


@pytest.mark.parametrize(("kind", "unit"), [("torsional", "N m"), ("translational", "N")])
def test_friction_that_cases_share_is_a_force_on_a_cart(tmp_path, kind, unit):
    write_everything(tmp_path)
    (tmp_path / "summary.json").unlink()
    file = tmp_path / "variability.json"
    data = json.loads(file.read_text(encoding="utf-8")) | {"kind": kind}
    data["averaged"] = {"cases": {"IV": {"friction_torque": TWO_WAYS["direct"]}}, "further": {}}
    file.write_text(json.dumps(data), encoding="utf-8")
    page = report(tmp_path).path.read_text(encoding="utf-8")
    assert re.search(rf"friction_<wbr>torque.*?</th>\s*<td[^>]*>{unit}</td>", page, re.DOTALL)


def test_what_the_cases_share_opens_with_the_answer_and_leaves_the_method_below(tmp_path):
    write_everything(tmp_path)
    (tmp_path / "summary.json").unlink()
    file = tmp_path / "variability.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    told = "The fit's draws used again by weights (Pareto k at most 0.31) agree with direct sampling."
    slow = "Particles moved slowly (shared): the errors are too small; raise particles and repeats."
    data["sentences"] += [told, slow]
    for (name, model), p in zip(data["models"].items(), (0.49, 0.5, 0.01), strict=True):
        data["models"][name] = model | {"probability": p}
    file.write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    first = (
        "Not settled: values scattered about a common mean (50 %) or one parameter set for all cases (49 %). The cases"
    )
    answers = text[: text.index("Variability Particles") if "Variability Particles" in text else text.index(told)]
    assert first in answers
    assert "More data of each case" in answers
    assert "more --particles and --repeats" in answers
    assert told not in answers
    assert slow in text


TWO_WAYS = {way: {"median": 0.31, "hdi90": [0.2, 0.4]} for way in ("recycled", "direct")}


def words_of(page: str) -> str:
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", body.replace("<wbr>", ""))))


# What it says -------------------------------------------------------------------------------------------------------


def test_everything_a_folder_holds_is_on_the_page(tmp_path):
    done = report(write_everything(tmp_path / "results"))
    text = words_of(done.path.read_text(encoding="utf-8"))
    assert done.exit_code is ExitCode.DONE
    assert "</p><p" not in done.path.read_text(encoding="utf-8")  # text taken out of the page keeps sentences apart
    assert set(done.results) == {
        "diagnosis/diagnosis.json", "summary.json", "variability.json", "tune.json", "plan.json", "withheld.json",
    }  # fmt: skip
    assert "Most probable, but not sure: stick slip (86 %). Most probable place: interface, friction and" in text
    assert "The rig and the model differ by more than the noise (p = 1e-09)." in text
    assert "With a probability of 90 % it is one of stick slip and unknown" in text
    assert "stick slip and bearing stribeck cannot be distinguished" in text
    assert "friction displacement and normal force law cannot" not in text
    assert "Next experiment: coupled, k1t 10.2 N m/rad, released at 2.7 deg (expected information 1.80 nats; " in text
    assert "closes 97 % of the gap" in text
    assert "The data say nothing about the sharpness with which dry friction changes its sign (nu)" in text
    assert "The cases do not share one parameter set (2 %)" in text
    assert "insertion loss 12.0 dB (90 %: 10.4 to 13.6 dB)" in text
    assert (
        "depends most on c2t: damping of the coupling between the bodies (70 % of its variance): measure that better."
        in text
    )
    assert "your design probably has no resonance left" in text, "12 dB where there is one, but few have one"
    assert "synthetic <rig>" in text
    assert text.index("Most probable, but") < text.index("Case III: parameters")
    assert done.to_json()["bytes"] == done.path.stat().st_size


def test_what_a_fit_tells_beside_its_parameters_is_on_the_page(tmp_path):
    write_fit(tmp_path / "fit")
    text = words_of(report(tmp_path / "fit").path.read_text(encoding="utf-8"))
    assert "IV coupled #2 7.300 times" in text or "IV coupled #2 7.3 times" in text
    assert "0.0083 0.0071 -1.2 sd" in text
    assert "nu: sharpness with which dry friction changes its sign -0.61 +0.85 ? k2t -0.20" in text
    assert "Log evidence -812.34" in text
    assert "* decided by the prior, not by the data" in text


def test_figures_say_how_they_are_read_once_and_words_are_explained(tmp_path):
    write_fit(tmp_path / "fit")
    for case in ("III", "IV"):
        (tmp_path / "fit" / case).mkdir(exist_ok=True)
        save(forest_figure({"mu": {case: (1.0, 2.0, 3.0)}}, {}, title="mu"), tmp_path / "fit" / case / "corner")
    page = report(tmp_path / "fit").path.read_text(encoding="utf-8")
    assert page.count("<figcaption><strong>Pairs of parameters</strong>") == 2
    assert page.count("of the draws. A slanted contour: the two are correlated.</figcaption>") == 1
    words = re.findall(r"<dt>(.*?)</dt>", page.partition('id="words"')[2].partition("</section>")[0])
    assert {"prior", "R-hat", "evidence", "nat", "90 % interval"} <= set(words)
    assert "insertion loss" not in words, "a word that does not stand on the page"
    assert "drag\nbearing drag torque" not in page
    assert re.search(r'friction_<wbr>torque = mu N0 R<span class="meaning">\s+friction torque between the faces', page)


def test_numbers_of_a_diagnosis_are_explained_by_their_names(tmp_path):
    write_diagnosis(tmp_path)
    file = tmp_path / "diagnosis.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    data |= {"noise": {"sd": [2.0], "phi": [0.1], "innovation": [2.0]}, "remainder": {"temperature": 1.03}}
    file.write_text(json.dumps(data), encoding="utf-8")
    page = report(tmp_path).path.read_text(encoding="utf-8")
    words = re.findall(r"<dt>(.*?)</dt>", page.partition('id="words"')[2].partition("</section>")[0])
    assert {"innovation, phi", "temperature"} <= set(words)


def test_a_verdict_says_what_the_effect_is_and_how_large(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data["effects"][0] |= {"meaning": "The faces stick.", "formula": "a law"}
    data["gap"]["closed"]["median"] = 0.94
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert (
        "stick slip (86 %). The faces stick. Its law: a law, with ratio 1.40 (1.20 to 1.60) (90 % intervals)." in text
    )
    assert (
        "On held-out trials (kept apart from the fit) the most probable cause closes 94 % of the gap (90 % interval"
        in text
    )
    assert "with stick slip 2.01 94 %" in text, "one model has one share, here and on the first screen"
    data["effects"][0]["parameters"]["ratio"]["prior_share"] = 0.9
    data["gap"]["closed"] = {"median": 0.8, "hdi90": [-45.6, 45.3]}
    data["effects"][0]["closed"] = {"median": 0.8, "hdi90": [-45.6, 45.3]}
    data["sites"] = {"interface": 0.46, "ground2": 0.4, "sensor": 0.14}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "the gap is too small to give shares of it" in text
    assert "with ratio 1.40 (1.20 to 1.60) (these data do not determine it)" in text
    assert f"with stick slip 2.01 {NOTHING}" in text
    data["gap"]["closed"] = {"median": None, "hdi90": None, "method": "cannot tell", "how": "too faint"}
    share = {"median": 0.7, "hdi90": [0.6, 0.8]}
    data["budget"] = {
        "effects": [{"name": "stick_slip", "site": "interface", "present": 0.86, "share": share,
                     "parameters": {"ratio": {"mean": 1.4, "hdi90": [1.2, 1.6], "unit": "1"}}}],
        "unexplained": {"share": {"median": 0.3, "hdi90": [0.2, 0.4]}, "sites": {"interface": 0.6, "sensor": 0.4}},
        "method": "products of residuals",
        "absent": [{"name": "sensor_gain", "present": 0.1, "share": {"median": -0.1, "hdi90": [-0.2, 0.0]}}],
    }  # fmt: skip
    data["prior_unknown"] = [{"prior": 0.5, "verdict": "unknown", "probability": 0.6}]
    data["law"] = LAW
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    told = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "the gap is too small to give shares of it" in told
    assert (
        "Stick slip (probability 0.86) closes 70 % of the gap; 30 % stays unexplained, most likely at the interface."
        in told
    )
    assert "stick slip interface 86 % 70 % (60 to 80 %)" in told
    assert f"unexplained interface 60 %, sensor 40 % {NOTHING} 30 % (20 to 40 %)" in told
    assert "50 % unknown 60 %" in told
    assert "rejected, because they do not reduce the gap on held-out trials: sensor gain." in told
    assert (
        "A law learnt at the interface beside stick slip, Q = f(x) + tanh(nu v) f(v), closes 27 % (20 to 100 %) of the "
        "gap on held-out trials. Other commands can use it: --effects learnt/interface.toml." in told
    )
    assert "as an effect --effects learnt/interface.toml --effect learnt_interface" in told
    assert "angle -0.1 to 0.12 rad; time 0 to 1 s" in told
    assert re.search(r"Most probable places: interface, .* \(46 %\) and ground2, .* \(40 %\)\.", text)
    assert "4530" not in text
    assert "Products of residuals. Present:" in told
    data["gap"] |= {"answer": "cannot tell", "p_value": 1.0, "upper_rms_over_noise": None}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    told = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "No trial is held out, so no share of the gap is known. Present:" in told


def test_the_parameters_of_an_effect_of_the_library_are_explained(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    value = {"median": 0.3, "hdi90": [0.2, 0.4], "unit": "rad/s"}
    data["effects"][0] |= {"variant": "gaussian", "formula": "a law", "parameters": {"speed": value, "other": value}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "rad/s (90 % intervals). speed: Sliding speed over which the excess is lost. Most probable place" in text


def test_the_figure_of_the_missing_torque_names_its_record():
    ramp = np.linspace(0.0, 1.0, 9)
    names = ("times", "th1", "w1", "th2", "w2", "phi", "slip")
    torque = SimpleNamespace(**dict.fromkeys(names, ramp), torque=np.stack([ramp, -ramp]), sd=np.full((2, 9), 0.1))
    bins = {"centre": ramp, "torque_n_m": ramp, "sd_n_m": ramp}
    curve = {"phi": bins, "slip": bins}
    figure = missing_torque_figure(torque, curve, body=0, title="torque", record="IV coupled #2")
    assert figure.axes[0].get_title(loc="left") == "IV coupled #2"


def test_a_forecast_is_told_with_the_unit_of_the_readings():
    side = {"rms": 2.1, "coverage50": 0.5, "coverage90": 0.9}
    (told,) = _forecast_words({"periods": 2.0, "before": side}, "rad/s^2")
    assert told.startswith(
        "Forecast of held-out trials from their first 2 periods: rms error in rad/s^2 2.1 with the nominal model. "
    )


def test_the_rig_as_it_is_is_no_design_and_needs_a_resonance(tmp_path):
    write_tuning(tmp_path)
    data = json.loads((tmp_path / "tune.json").read_text(encoding="utf-8"))
    data["design"] = dict.fromkeys(data["design"])
    nothing = {"mean": None, "median": None, "interval90": None}
    data["nonlinear"][0] |= {"probability_of_target": 0.0} | {
        "insertion_loss_db": nothing,
        "resonance_hz": nothing,
        "resonance_shift_hz": nothing,
    }
    (tmp_path / "tune.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "The rig as it is, linear model: insertion loss 12.0 dB" in text
    assert "Where the torque is 0.02 N m, the rig as it is probably has no resonance left to compare" in text
    assert "misses the target" not in text
    data["nonlinear"][0] |= {"insertion_loss_db": {"mean": 7.0, "median": 7.0, "interval90": [6.0, 8.0]}}
    (tmp_path / "tune.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "the rig as it is probably misses the target where the torque is 0.02 N m" in text


def test_the_gap_stands_before_and_after_each_effect(tmp_path):
    write_diagnosis(tmp_path / "diagnosis")
    data = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    data["parameters"] = {"mu": {"before": {"value": 0.0083, "sd": 1e-4}, "after": {"value": 0.0071, "sd": 2e-4},
                                 "shift_sigmas": -6.0}}  # fmt: skip
    data["sensitivity"] = [{"choice": "without case IV", "verdict": "none", "probability": 0.4,
                            "probability_of_the_leading_answer": 0.3}]  # fmt: skip
    sides = {"before": {"rms": 3.4, "coverage50": 0.31, "coverage90": 0.62},
             "after": {"rms": 2.1, "coverage50": 0.52, "coverage90": 0.91}}  # fmt: skip
    trial = {"case": "IV", "configuration": "coupled", "trial": 4, "readings": 812}
    data["forecast"] = {"periods": 2.0, "bands": [0.5, 0.9], "trials": [trial | sides], **sides}
    data["pair"] = {"effects": ["stick_slip", "magnet_cubic"], "probability": 0.7}
    (tmp_path / "diagnosis" / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path / "diagnosis").path.read_text(encoding="utf-8"))
    assert "with stick slip and magnet cubic 2.01 97 % (90 to 100 %)" in text
    assert "case IV, coupled, trial 4 812 readings nominal model 3.4 31 % 62 % with the leading effect 2.1" in text
    assert "model rms residual [rad/s²] gap closed (90 %) noise alone 2" in text
    assert "nominal model 2.9 0 %" in text
    assert "with stick slip 2.01 97 % (90 to 100 %)" in text
    assert "0.00830 ± 0.00010 0.00710 ± 0.00020 1 -6.0 sd" in text
    assert "without case IV none 40 % 30 %" in text


@pytest.mark.parametrize(("other", "undecided"), [("magnet_cubic", False), ("unknown", True)])
def test_two_causes_that_are_both_there_are_not_said_to_be_one_of_two(tmp_path, other, undecided):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data |= {"credible_set": ["stick_slip", other]}
    data["pair"] = {"effects": ["stick_slip", "magnet_cubic"], "probability": 0.96}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "stick slip and magnet cubic together do (96 %)" in text
    assert ("it is one of" in text) == undecided


def test_where_it_differs_is_told_with_units_and_without_digits_that_mean_nothing(tmp_path):
    write_diagnosis(tmp_path)
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "0.3 to 0.31 1, primary IV coupled 1, 2 below 1e-12" in text
    assert "5.5 to 10.5 2, secondary all all 3e-05" in text
    assert "1, primary +5.45 0.01" in text
    assert "IV coupled -0.15 1" in text
    assert "θ1 - θ2 0 to 0.04 rad ω1 - ω2 -1.8 to 0 rad/s 1, primary +25.00 below 1e-12" in text
    assert "e-221" not in text
    assert "A knock" not in text, "a law that is wrong everywhere is no knock"
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data["where"]["event"]["local"] = True
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "0.29 to 0.31 ground2 -0.00055 ± 7.1e-06 N m s 30 nats 28 %" in text


def test_a_diagnosis_of_published_numbers_shows_them_beside_the_model(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    feature = {"case": "I", "configuration": "coupled", "feature": "max_acceleration", "unit": "rad/s^2",
               "measured": 135.7, "standard_error": 2.9, "predicted": 150.2, "predicted_hdi90": [141.0, 159.0],
               "held_out": True, "p_value": 0.012}  # fmt: skip
    data["where"] = {"feature": [feature], "case": [{"case": "I", "p_value": 0.3}]}
    data["gap"] |= {"unit": "rad/s^2", "on": "coupled peaks"}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "I, coupled: max acceleration 135.7 ± 2.9 150.2 141.0 to 159.0 rad/s² 0.012 no" in text
    assert "On coupled peaks." in text


def test_maps_of_residuals_have_a_column_for_each_channel_and_model():
    cells = np.full((2, 4), 1.0)
    cells[1, 2] = 7.0
    rows = {"y": np.arange(3.0), "values": cells, "labels": ["A #1", "A #2"], "y_label": ""}
    plane = {"x": np.linspace(-1.0, 1.0, 5), "y": np.linspace(-1.0, 1.0, 3), "values": np.full((2, 4), np.nan),
             "labels": None, "x_label": "angle [rad]", "y_label": "velocity [rad/s]"}  # fmt: skip
    column = {"time": {"x": np.linspace(0.0, 1.0, 5), "x_label": "time [s]", **rows},
              "frequency": {"x": np.geomspace(1.0, 500.0, 5), "x_label": "frequency [Hz]", **rows},
              "plane": plane}  # fmt: skip
    maps = [{"title": title, **column} for title in ("nominal model", "with stick_slip")]
    figure = residual_maps_figure(maps, title="rig")
    assert [a.get_title(loc="left") for a in figure.axes[:2]] == ["nominal model", "with stick_slip"]
    assert [a.get_xlabel() for a in figure.axes[:6:2]] == ["time [s]", "frequency [Hz]", "angle [rad]"]
    assert figure.axes[-1].get_ylabel() == "rms residual / noise (1: noise alone)"
    assert figure.axes[0].collections[0].norm.vmax > 3.0


def test_one_reading_far_out_does_not_hide_the_other_residuals():
    rng = np.random.default_rng(4)
    measured = rng.normal(size=(1, 400))
    measured[0, 7] = -90.0
    zero = np.zeros((1, 400))
    trial = {"label": "IV", "times": np.arange(400) * 1e-3, "measured": measured, "low": zero, "median": zero,
             "high": zero}  # fmt: skip
    axis = record_figure([trial], "rad/s^2", title="rig").axes[1]
    low, high = axis.get_ylim()
    assert -6.0 < low < -2.5
    assert 2.5 < high < 6.0
    marks = {line.get_marker(): line.get_xydata() for line in axis.lines if len(line.get_xydata())}
    assert marks["v"].tolist() == [[0.007, low]]
    assert "^" not in marks
    assert len(marks["."]) == 399


def test_one_legend_below_the_panels_names_the_band_of_the_noise_too():
    times, zero = np.arange(400) * 1e-3, np.zeros(400)
    record = {"label": "IV", "unit": "rad", "times": times, "measured": zero, "nominal": zero, "augmented": zero,
              "added": "stick slip", "noise": 0.1}  # fmt: skip
    figure = gap_figure(record, {"none": 1.0}, title="rig")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert [t.get_text() for t in legend.get_texts()] == ["measured", "fitted nominal model", "noise, ± 2 sd"]
    assert all(axis.get_legend() is None for axis in figure.axes)
    assert legend.get_window_extent().y1 < min(axis.get_window_extent().y0 for axis in figure.axes)


def test_the_label_of_small_residuals_stays_in_the_figure():
    zero = np.zeros((1, 400))
    trial = {"label": "IV", "times": np.arange(400) * 1e-3, "low": zero, "median": zero, "high": zero}
    trial["measured"] = 2e-4 * np.random.default_rng(4).normal(size=(1, 400))
    figure = record_figure([trial], "rad", title="rig")
    figure.draw_without_rendering()
    assert all(axis.yaxis.label.get_window_extent().x0 >= 0.0 for axis in figure.axes)


def test_residuals_are_gathered_in_cells():
    found = _rms(np.array([0, 0, 0, 1, 5, -1]), np.array([1.0, 4.0, 4.0, 9.0, 9.0, 9.0]), np.ones(6), 3, 3.0)
    assert found[0] == pytest.approx(math.sqrt(3.0))
    assert np.isnan(found[1:]).all()


def test_all_cases_are_drawn_over_each_other(tmp_path):
    rng = np.random.default_rng(1)
    draws = {name: (("case", "chain", "draw"), rng.normal(size=(2, 2, 50))) for name in ("mu", "k2t")}
    posterior = xr.Dataset(draws, coords={"case": ["III", "IV"]})
    xr.DataTree.from_dict({"posterior": posterior}).to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    cases = {name: {"parameters": {"mu": parameter(0.0, 0.1), "k2t": parameter(0.0, 0.5)}} for name in ("III", "IV")}
    draw_overlaid(tmp_path, cases, ["mu", "k2t"], {}, {"campaign": "rig", "converged": True})
    assert (tmp_path / "corner.svg").stat().st_size > 5000
    assert "case III" in (tmp_path / "corner.svg").read_text(encoding="utf-8")


def test_numbers_of_neighbouring_panels_of_a_corner_figure_stay_apart():
    rng = np.random.default_rng(1)
    draws = {name: rng.normal(1.0, 0.1 * k, 4000) for k, name in enumerate(("mu", "k2t", "c2t"), start=1)}
    figure = corner_figure({"I": draws}, {}, title="I")
    figure.canvas.draw()
    boxes = [
        text.get_window_extent() for axis in figure.axes[-3:] for text in axis.get_xticklabels() if text.get_text()
    ]
    boxes = [box for box in boxes if box.width > 0.0]
    assert len(boxes) >= 6
    assert not any(one.overlaps(other) for one, other in itertools.pairwise(boxes))


def test_a_forest_leaves_a_gap_where_a_group_lacks_a_parameter():
    """The fit of all cases together has a value of its own of what the cases share, and none of what is each one's."""
    both = {"I": (0.0, 1.0, 2.0), "IV": (1.0, 2.0, 3.0)}
    figure = forest_figure({"mu": both, "k2t": both | {"all": (0.5, 1.0, 1.5)}}, {}, title="cases")
    left, right = figure.axes[:2]
    assert [text.get_text() for text in left.get_yticklabels()] == ["I", "IV", "all"]
    assert len(left.lines) == 4
    assert len(right.lines) == 6


def test_a_forest_draws_hollow_what_the_prior_decided():
    both = {"I": (0.0, 1.0, 2.0), "IV": (1.0, 2.0, 3.0)}
    figure = forest_figure({"mu": both, "k2t": both}, {}, title="cases", assumed={"mu": ["IV"]})
    fills = [line.get_markerfacecolor() for axis in figure.axes[:2] for line in axis.lines if line.get_marker() == "o"]
    assert fills == [COLOURS[1], "white", COLOURS[1], COLOURS[1]]


def test_a_corner_figure_tells_each_interval_and_what_was_assumed():
    """The prior is drawn to the scale of the posterior: the same draws give the same line."""
    rng = np.random.default_rng(1)
    draws = {"mu": rng.normal(1.0, 0.1, 4000), "nu": rng.lognormal(4.0, 1.5, 4000)}
    told = {"mu": (0.84, 1.0, 1.16), "nu": (2.0, 55.0, 400.0)}
    figure = corner_figure({"I": draws}, {}, title="I", intervals=told, assumed=draws)
    for axis, name in zip(figure.axes[::3], draws, strict=True):
        prior = next(line for line in axis.lines if line.get_label() == "prior")
        assert np.max(prior.get_ydata()) == pytest.approx(np.max(axis.lines[0].get_ydata()), rel=1e-6), name
    assert [axis.get_title() for axis in figure.axes[::3]] == ["mu\n1.000\n(0.840 to 1.160)", "nu\n60\n(2 to 400)"]


def test_a_diagnosis_shows_the_record_that_proves_it_before_the_missing_torque(tmp_path):
    write_diagnosis(tmp_path)
    for stem in ("gap", "ranking"):
        save(new_figure(2.0, 2.0), tmp_path / stem)
    report(tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    places = [page.index(f"<figcaption><strong>{t}</strong>") for t in ("What the model misses", "Missing torque")]
    assert places == sorted(places)
    assert places[1] < page.index("<figcaption><strong>Which effect, and where</strong>")
    assert page.count("<figcaption><strong>What the model misses</strong>") == 1


def test_a_page_on_which_nothing_is_missing_shows_no_missing_torque(tmp_path):
    write_diagnosis(tmp_path)
    file = tmp_path / "diagnosis.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    for verdict, shown in (("unknown", True), ("none", False)):
        file.write_text(json.dumps(data | {"verdict": verdict}), encoding="utf-8")
        report(tmp_path)
        assert ("<strong>Missing torque</strong>" in (tmp_path / "report.html").read_text(encoding="utf-8")) == shown


def test_a_page_of_several_campaigns_bears_the_name_of_the_folder(tmp_path):
    for name in ("bench", "rig"):
        (tmp_path / name).mkdir()
        write_diagnosis(tmp_path / name)
        file = tmp_path / name / "diagnosis.json"
        data = json.loads(file.read_text(encoding="utf-8"))
        file.write_text(json.dumps(data | {"campaign": name}), encoding="utf-8")
    assert report(tmp_path).warnings[0] == (
        "The results are of different campaigns, so their numbers do not belong together "
        "(bench: bench/diagnosis.json; rig: rig/diagnosis.json)."
    )
    assert f"<h1>Report: {tmp_path.name}</h1>" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not report(tmp_path / "rig").warnings
    assert "<h1>Report: rig</h1>" in (tmp_path / "rig" / "report.html").read_text(encoding="utf-8")


def test_a_campaign_that_changed_between_two_results_is_named(tmp_path):
    """Where both say what they were made from."""
    for name, checksum in (("old", {"campaign_sha256": "a" * 64}), ("new", {"campaign_sha256": "b" * 64}), ("any", {})):
        (tmp_path / name).mkdir()
        write_diagnosis(tmp_path / name)
        file = tmp_path / name / "diagnosis.json"
        data = json.loads(file.read_text(encoding="utf-8"))
        data.pop("campaign_sha256", None)
        file.write_text(json.dumps(data | {"campaign": "rig"} | checksum), encoding="utf-8")
    assert report(tmp_path).warnings[0] == (
        "The files of campaign rig changed between new/diagnosis.json and old/diagnosis.json: run again what is older."
    )


def test_a_gap_beside_the_verdict_none_is_explained_on_the_first_screen(tmp_path):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data |= {"verdict": "none", "probabilities": {"none": 0.7, "unknown": 0.3}}
    data["gap"] |= {"p_value": 0.03}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    first = text[: text.index("Every answer that was tried")]
    assert "alone says gap (p = 0.03), as it does for one faultless rig in 20" in first
    assert "differ by more than the noise" not in first
    assert "the best candidate would close 97 % of the gap" in first


def test_a_run_that_has_not_ended_is_told_how_to_go_on(tmp_path):
    (tmp_path / "fit").mkdir()
    (tmp_path / "fit" / "run.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match=r"has not ended; go on with: bayes-damper resume .*fit"):
        report(tmp_path)


@pytest.mark.parametrize(
    ("verdict", "share", "step"),
    [
        ("stick_slip", 0.97, "What next Next: bayes-damper fit 'my rig' --effect stick_slip Next experiment:"),
        (
            "stick_slip+spring_cubic",
            0.97,
            "What next Next: bayes-damper fit 'my rig' --effect stick_slip --effect spring_cubic Next experiment:",
        ),
        ("none", 0.97, "What next Next: bayes-damper fit 'my rig' Next experiment:"),
        ("unknown", 0.97, "What next Next experiment:"),
        ("stick_slip", 0.7, "What next Next experiment:"),
    ],
)
def test_a_sure_verdict_comes_with_the_command_that_follows(tmp_path, verdict, share, step):
    write_everything(tmp_path)
    file = (
        tmp_path / "diagnosis" / "diagnosis.json" if (tmp_path / "diagnosis").exists() else tmp_path / "diagnosis.json"
    )
    data = json.loads(file.read_text(encoding="utf-8"))
    other = "unknown" if verdict != "unknown" else "stick_slip"
    both, verdict = verdict.split("+"), verdict.partition("+")[0]
    if len(both) > 1:
        data["pair"] = {"effects": both, "probability": 0.9, "log_evidence": 9.0, "gain": 9.0, "parameters": {}}
    data |= {"campaign": "my rig", "verdict": verdict, "probabilities": {verdict: share, other: 1.0 - share},
             "credible_set": [verdict], "indistinguishable": []}  # fmt: skip
    data["gap"]["closed"] = {"median": 1.0, "hdi90": [0.999, 1.001], "how": "from products of residuals"}
    file.write_text(json.dumps(data), encoding="utf-8")
    text = words_of(report(file.parent).path.read_text(encoding="utf-8"))
    assert step in text
    if both == ["stick_slip"]:
        assert "closes 100 % of the gap. Measured from products of residuals." in text


def test_a_plan_and_a_decomposition_read_as_tables(tmp_path):
    text = words_of(report(write_everything(tmp_path / "results")).path.read_text(encoding="utf-8"))
    assert "magnet cubic between the bodies 22 % cubic 66 N m/rad³ interface relaxation 2.4 6 times" in text
    assert (
        "typical size. What next magnet cubic would be seen with 6 times as many trials. One more coupled trial, "
        "k1t 14.3 N m/rad, released at 7.4 deg, would help most: to distinguish magnet cubic." in text
    )
    assert "real difference 0.200 0.100 to 0.400 60 % (20 to 90 %) In every draw the shares add up to 100 %" in text
    assert "IV 34.3 1.10 (0.90 to 1.40) 1" in text
    assert "IV 412 63 0.31" in text
    assert "coupled 14.3 7.4 5 magnet_cubic" in text


def test_withheld_scores_open_the_page(tmp_path):
    score = {"value": 0.95, "interval95": [0.87, 0.98], "n": 65, "hits": 62}
    data = {
        "schema": "bayes-damper/withheld/1", "rehearsal": False, "campaigns": {f"c{i}": {} for i in range(71)},
        "scores": {"all": {"accepted_first": score, "none_kept": {**score, "n": 20, "hits": 19}}},
    }  # fmt: skip
    (tmp_path / "withheld.json").write_text(json.dumps(data), encoding="utf-8")
    words = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "Right or acceptable first answer: 62 of 65 campaigns whose causes were withheld." in words
    assert "No gap claimed where there is none: 19 of 20." in words
    judged = {"what": "site", "where": "hard, level 1", "least": 0.98, "most": None, "value": 0.9, "n": 30}
    data["scores"]["targets"] = [
        {**judged, "enough": True, "status": "missed"},
        {**judged, "enough": False, "status": "met"},
        {**judged, "value": None, "n": 0, "enough": False, "status": "not tested"},
    ]
    (tmp_path / "withheld.json").write_text(json.dumps(data), encoding="utf-8")
    words = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "What next Targets missed: site, hard, level 1: 0.9 (at least 0.98 asked for)." in words
    assert "of 3 targets 1 could not be tested and 1 rest on fewer campaigns than they are meant for" in words
    data |= {"rehearsal": True, "why_rehearsal": ["The code changed."]}
    (tmp_path / "withheld.json").write_text(json.dumps(data), encoding="utf-8")
    words = words_of(report(tmp_path).path.read_text(encoding="utf-8"))
    assert "from seeds never used before: these scores are a rehearsal." in words
    (tmp_path / "withheld.json").write_text(json.dumps({**data, "scores": None}), encoding="utf-8")
    assert "71 campaigns judged, verdicts sealed" in words_of(report(tmp_path).path.read_text(encoding="utf-8"))


def test_numbers_stand_with_unit_and_interval(tmp_path):
    write_fit(tmp_path / "fit")
    page = report(tmp_path / "fit").path.read_text(encoding="utf-8")
    row = re.search(r"<tr[^>]*><th scope=\"row\">k2t: stiffness.*?</tr>", page, re.DOTALL)
    assert row is not None
    cells = re.findall(r"<td>(.*?)</td>", row[0])
    assert cells[:5] == ["1.30", "0.91", "1.69", "N m/rad", "data and prior"]
    assert "assumed, 90 %" not in page, "results of before it was told"
    summary = json.loads((tmp_path / "fit" / "summary.json").read_text(encoding="utf-8"))
    summary["cases"]["III"]["parameters"]["k2t"]["prior"] = {"median": 1.6, "hdi90": [0.05, 5.4]}
    (tmp_path / "fit" / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    page = report(tmp_path / "fit").path.read_text(encoding="utf-8")
    row = re.search(r"<tr[^>]*><th scope=\"row\">k2t: stiffness.*?</tr>", page, re.DOTALL)
    assert row is not None
    assert re.findall(r"<td>(.*?)</td>", row[0])[5] == "0.05 to 5.4"
    assert '<tr class="prior"><th scope="row">nu:' in page


def test_a_run_that_did_not_converge_is_marked_first(tmp_path):
    write_fit(tmp_path / "fit", converged=False)
    done = report(tmp_path / "fit")
    text = words_of(done.path.read_text(encoding="utf-8"))
    assert done.warnings == ("Case III did not converge: do not use its numbers.",)
    assert text.index("Do not use these numbers") < text.index("Median and 90 % interval")
    assert "case III: median (90 %) NOT CONVERGED case IV: median (90 %) mu" in text, "heads of the overview"
    assert "The data say nothing" not in text, "what such numbers say is not told"
    assert "central 90 %" not in text
    assert "The effective sample size of nu is 200" in text
    assert "--more. Continue for about 9 more steps. Below, each case" in text


def test_a_model_that_cannot_reproduce_the_data_is_said_so(tmp_path):
    write_fit(tmp_path / "fit", outside=True)
    text = words_of(report(tmp_path / "fit").path.read_text(encoding="utf-8"))
    assert "2 of 4 measurements lie outside" in text
    assert "The model cannot reproduce all of the data" in text


def test_results_that_cannot_be_read_are_named(tmp_path):
    write_fit(tmp_path / "fit")
    (tmp_path / "fit" / "tune.json").write_text('{"schema": "bayes-damper/tune/9"}', encoding="utf-8")
    (tmp_path / "fit" / "diagnosis.json").write_text(
        '{"schema": "bayes-damper/diagnosis/1", "verdict": "x", "pair": {"effects": 3}}', encoding="utf-8"
    )
    warnings = report(tmp_path / "fit").warnings
    assert any("tune.json is not shown: its schema is 'bayes-damper/tune/9'" in w for w in warnings)
    assert any("diagnosis.json is not shown: an entry is missing or malformed" in w for w in warnings)


@pytest.mark.parametrize("make", [False, True])
def test_a_folder_without_results_is_refused(tmp_path, make):
    folder = tmp_path / "nothing"
    if make:
        folder.mkdir()
    with pytest.raises(InputError, match="nothing to report" if make else "there is no such folder"):
        report(folder)


# One file -----------------------------------------------------------------------------------------------------------


def test_the_page_is_one_file_that_loads_nothing(tmp_path):
    page = report(write_everything(tmp_path / "results")).path.read_text(encoding="utf-8")
    addresses = re.findall(r"(?:src|href|action|srcset)=\"([^\"]*)\"", page)
    assert addresses
    assert all(a.startswith(("data:", "#")) for a in addresses)
    assert "url(" not in page
    assert "http" not in re.sub(r"http-equiv", "", page)
    assert "default-src 'none'" in page


def test_large_figures_are_left_out_and_named(tmp_path):
    write_fit(tmp_path / "fit")
    noise = np.random.default_rng(0)
    for name in "abc":
        (tmp_path / "fit" / f"{name}.png").write_bytes(noise.bytes(1_700_000))
    done = report(tmp_path / "fit")
    assert done.size <= LARGEST
    assert done.left_out == ("c.png",)
    assert "c.png" in words_of(done.path.read_text(encoding="utf-8"))


def test_a_large_vector_figure_is_taken_as_picture(tmp_path):
    write_fit(tmp_path / "fit")
    figure = new_figure()
    rng = np.random.default_rng(0)
    figure.subplots().plot(rng.random(9000), rng.random(9000), ".", color=COLOURS[0])
    svg, png = save(figure, tmp_path / "fit" / "cloud")
    assert svg.stat().st_size > 350_000 > png.stat().st_size
    page = report(tmp_path / "fit").path.read_text(encoding="utf-8")
    assert len(re.findall(r"<img src=\"data:image/png", page)) == 1


def test_a_picture_travels_in_few_colours(tmp_path):
    """A trace of lines shrinks to less than half, keeps its size in pixels, and differs by no more than a shade."""
    write_fit(tmp_path / "fit")
    figure = new_figure(9.0, 6.0)
    walk = np.cumsum(np.random.default_rng(0).standard_normal((4, 3000)), axis=1)
    axes = figure.subplots()
    for i, y in enumerate(walk):
        axes.plot(y, color=COLOURS[i], lw=0.4, alpha=0.8)
    _, png = save(figure, tmp_path / "fit" / "walk")
    (tmp_path / "fit" / "walk.svg").unlink()
    page = report(tmp_path / "fit").path.read_text(encoding="utf-8")
    found = re.search(r"<img src=\"data:image/png;base64,([^\"]+)", page)
    assert found is not None
    content = base64.b64decode(found[1])
    assert len(content) < 0.6 * png.stat().st_size
    before, after = (np.asarray(Image.open(f).convert("RGB"), float) for f in (png, io.BytesIO(content)))
    assert before.shape == after.shape
    assert np.mean(np.abs(before - after)) < 2.0


def test_packed_numbers_come_back_within_half_a_step():
    x = np.array([-250.0, 3.25, np.nan, 180.5])
    back = unpack(pack(x))
    assert np.isnan(back[2])
    assert np.nanmax(np.abs(back - x)) <= 0.5 * (180.5 + 250.0) / 65534.0 * 1.0001
    assert unpack(pack([4.0, 4.0])) == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize(
    ("value", "width", "text"),
    [(0.0079294, 0.0104, "0.0079"), (120.7, 1609.0, "120"), (9.0423, 0.21, "9.042"), (None, None, "\N{EN DASH}")],
)
def test_numbers_have_the_digits_that_their_interval_supports(value, width, text):
    assert number(value, width) == text


def test_no_probability_is_rounded_to_certainty():
    assert [percent(p) for p in (0.0, 1e-7, 0.004, 0.5, 0.9996, 1.0)] == [
        "0 %", "below 0.1 %", "0.4 %", "50 %", "99.9 %", "100 %",
    ]  # fmt: skip


# In a browser -------------------------------------------------------------------------------------------------------

PROBE = """
const frame = document.querySelector("iframe");
const seen = { faults: [], contrast: [] };
addEventListener("load", () => setTimeout(() => {
  const page = frame.contentDocument, root = page.documentElement, view = frame.contentWindow;
  seen.wide = root.scrollWidth - root.clientWidth;
  seen.width = root.clientWidth;
  seen.charts = Number(root.dataset.drawn || -1);
  seen.images = [...page.images].map((i) => i.complete && i.naturalWidth > 20);
  seen.dark = view.matchMedia("(prefers-color-scheme: dark)").matches;
  seen.beyond = [...page.querySelectorAll("canvas")].map((c) => Number(c.dataset.beyond));
  seen.canvases = [...page.querySelectorAll("canvas")].map((c) => {
    const pixels = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
    const colours = new Set();
    for (let i = 0; i < pixels.length; i += 4) {
      colours.add(pixels[i] + 256 * pixels[i + 1] + 65536 * pixels[i + 2]);
    }
    return colours.size;
  });
  const fault = (what, e) => seen.faults.push(what + ": " + (e.outerHTML || "").slice(0, 80));
  for (const e of page.images) if (!e.alt.trim()) fault("no alt", e);
  for (const e of page.querySelectorAll("th")) if (!e.scope) fault("no scope", e);
  for (const e of page.querySelectorAll("table")) {
    if (!e.caption || !e.caption.textContent.trim()) fault("no caption", e);
  }
  for (const e of page.querySelectorAll("button, a, option")) if (!e.textContent.trim()) fault("no name", e);
  for (const e of page.querySelectorAll("select")) if (!e.labels.length) fault("no label", e);
  for (const e of page.querySelectorAll("canvas, .scroll")) if (!e.getAttribute("aria-label")) fault("no label", e);
  for (const e of page.querySelectorAll("[aria-labelledby]")) {
    if (!page.getElementById(e.getAttribute("aria-labelledby"))) fault("labelled by nothing", e);
  }
  for (const e of page.querySelectorAll("a[href^='#']")) {
    if (!page.querySelector(e.getAttribute("href"))) fault("dead link", e);
  }
  const ids = [...page.querySelectorAll("[id]")].map((e) => e.id);
  if (new Set(ids).size !== ids.length) seen.faults.push("an id twice");
  for (const name of ["header", "nav", "main", "footer", "h1"]) {
    const count = page.querySelectorAll("body > " + name + ", header > " + name).length;
    if (count !== 1) seen.faults.push("not one " + name);
  }
  if (root.lang !== "en" || !page.title) seen.faults.push("language or title");
  let level = 0;
  for (const e of page.querySelectorAll("h1, h2, h3, h4, h5, h6")) {
    if (Number(e.tagName[1]) > level + 1) fault("heading skips a level", e);
    level = Number(e.tagName[1]);
  }
  const rgb = (text) => (text.match(/[0-9.]+/g) || []).map(Number);
  const light = ([r, g, b]) => {
    const f = (c) => (c / 255 <= 0.03928 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4);
    return 0.2126 * f(r) + 0.7152 * f(g) + 0.0722 * f(b);
  };
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = rgb(view.getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] > 0) return c;
    }
    return [255, 255, 255];
  };
  for (const e of page.querySelectorAll("body *")) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    if (!own || !e.getClientRects().length || ["SCRIPT", "STYLE"].includes(e.tagName)) continue;
    const a = light(rgb(view.getComputedStyle(e).color)), b = light(ground(e));
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) seen.contrast.push(e.tagName + " " + ratio.toFixed(2) + " " + e.textContent.trim().slice(0, 30));
  }
  const select = page.querySelector("figure.chart select");
  select.value = "1";
  select.dispatchEvent(new view.Event("change"));
  const canvas = page.querySelector("figure.chart canvas");
  canvas.dispatchEvent(new view.KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  seen.readout = page.querySelector("figure.chart .readout").textContent;
  canvas.dispatchEvent(new view.KeyboardEvent("keydown", { key: "+", bubbles: true }));
  page.querySelector("button.enlarge").click();
  Object.defineProperty(view.navigator, "clipboard", { value: { writeText: async (text) => { seen.copied = text; } } });
  [...page.querySelectorAll("button.copy")].find((b) => b.textContent.includes("Median and 90 %")).click();
  seen.large = page.querySelectorAll("figure.large").length;
  seen.wideAfter = root.scrollWidth - root.clientWidth;
  view.dispatchEvent(new view.Event("beforeprint"));
  seen.unfolded = [...page.querySelectorAll("details.paper")].map((e) => e.open);
  seen.sharp = [...page.querySelectorAll("canvas")].map((c) => c.width);
  seen.shown = page.querySelector("figure.chart .on-paper").textContent;
  view.dispatchEvent(new view.Event("afterprint"));
  seen.folded = [...page.querySelectorAll("details")].every((e) => !e.open);
  const told = { id: "seen", textContent: JSON.stringify(seen) };
  document.body.append(Object.assign(document.createElement("pre"), told));
}, 400));
"""


def probed(page: Path, folder: Path, width: int, dark: bool) -> tuple[dict, str]:
    """What a script sees of the page in a frame of this width, and the lines that the browser logged to its console."""
    assert CHROMIUM is not None
    wrapper = folder / f"frame{width}{dark}.html"
    content = html.escape(page.read_text(encoding="utf-8"), quote=True)
    wrapper.write_text(
        f'<!DOCTYPE html><body style="margin:0"><iframe style="border:0" width="{width}" height="900" '
        f'srcdoc="{content}"></iframe><script>{PROBE}</script>',
        encoding="utf-8",
    )
    done = subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--hide-scrollbars",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--enable-logging=stderr",
            f"--user-data-dir={folder / f'profile{width}{dark}'}", "--window-size=1400,1000",
            "--virtual-time-budget=4000",
            *(["--blink-settings=preferredColorScheme=0"] if dark else ["--blink-settings=preferredColorScheme=1"]),
            "--dump-dom", wrapper.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None, done.stderr[-2000:]
    return json.loads(html.unescape(found[1])), "\n".join(x for x in done.stderr.splitlines() if "CONSOLE" in x)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page is not tried in a browser")
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (360, False), (1280, True), (360, True)])
def test_a_browser_shows_all_of_it_without_fault(tmp_path, width, dark):
    page = report(write_everything(tmp_path / "results")).path
    seen, console = probed(page, tmp_path, width, dark)
    assert console == ""
    assert seen["width"] == width
    assert seen["dark"] is dark
    assert seen["charts"] == 3
    assert len(seen["images"]) == 1
    assert all(seen["images"])
    assert len(seen["canvases"]) == 3
    assert min(seen["canvases"]) > 20, "a canvas was left empty"
    assert sum(seen["beyond"]) == 1, "a reading far out stands at the edge of its residuals, and hides no other"
    assert seen["wide"] <= 0
    assert seen["wideAfter"] <= 0, "an enlarged figure widens the page"
    assert seen["large"] == 1
    assert seen["faults"] == []
    assert seen["contrast"] == []
    assert seen["readout"].startswith(("θ1", "frequency", "time"))
    assert seen["unfolded"]
    assert all(seen["unfolded"]), "what is folded would be missing on paper"
    assert seen["folded"], "after printing the page is as it was"
    assert seen["sharp"] == [2040, 2040, 2040]
    head, first, *_ = (line.split("\t") for line in seen["copied"].splitlines())
    assert head[:5] == ["parameter", "", "unit", "case III: median", "(90 %)"]
    assert len(first) == len(head)
    assert re.fullmatch(r"[\d.]+ *\*?", first[3])
    assert re.fullmatch(r"\([\d.]+ to [\d.]+\)", first[4]), "an interval is copied into a column of its own"
    assert re.fullmatch(r"Shown: .+, against θ1 \[rad\] \(one of \d; .*\)\.", seen["shown"])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page is not printed")
def test_it_prints_on_few_full_pages(tmp_path):
    page = report(write_everything(tmp_path / "results")).path
    paper = tmp_path / "page.pdf"
    subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
         f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=4000", "--no-pdf-header-footer",
         f"--print-to-pdf={paper}", page.as_uri()],
        capture_output=True, timeout=120, check=True,
    )  # fmt: skip
    sheets = len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes()))
    assert 5 <= sheets <= 20


def axe_source() -> str:
    """The accessibility checker axe-core, as a package for Python brings it along; skipped without it."""
    package = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    return (Path(package.__file__).parent / "axe.min.js").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page is not tried in a browser")
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (360, True)])
def test_axe_finds_no_fault(tmp_path, width, dark):
    """All rules of axe-core for WCAG 2.1 A and AA and good practice, on a page of everything."""
    page = report(write_everything(tmp_path / "results")).path.read_text(encoding="utf-8")
    run = (
        "addEventListener('load', () => axe.run(document).then((found) => { const pre = document.createElement('pre');"
        "pre.id = 'axe'; pre.textContent = JSON.stringify({passes: found.passes.length, faults: found.violations.map("
        "(v) => v.id + ': ' + v.nodes.slice(0, 3).map((n) => n.html.slice(0, 120)).join(' | '))});"
        "document.body.append(pre); }));"
    )
    tried = tmp_path / "axe.html"
    tried.write_text(page.replace("</body>", f"<script>{axe_source()}</script><script>{run}</script></body>"), "utf-8")
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
         f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={max(width, 500)},1200",
         "--virtual-time-budget=20000", f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--dump-dom",
         tried.as_uri()],
        capture_output=True, text=True, timeout=180, check=False,
    )  # fmt: skip
    found = re.search(r'<pre id="axe">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None, done.stderr[-2000:]
    seen = json.loads(html.unescape(found[1]))
    assert seen["passes"] > 20
    assert seen["faults"] == []


@pytest.mark.parametrize(("high", "scale"), [(1500.0, "log"), (29.0, "linear")])
def test_an_axis_is_logarithmic_where_only_a_factor_is_known(high, scale):
    figure = forest_figure({"nu": {"I": (5.0, 20.0, high), "II": (5.5, 21.0, high)}}, {}, title="nu")
    assert figure.axes[0].get_xscale() == scale


@pytest.mark.parametrize(
    ("share", "told"),
    [(0.97, "No missing effect found: the model is complete with a probability of 97 %."),
     (0.43, "No missing effect found, but this is not certain: the model is complete with a probability of 43 %.")],
)  # fmt: skip
def test_a_doubtful_none_is_told_with_doubt(tmp_path, share, told):
    write_diagnosis(tmp_path)
    data = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    data |= {"verdict": "none", "probabilities": {"none": share, "unknown": 1.0 - share}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(data), encoding="utf-8")
    assert told in words_of(report(tmp_path).path.read_text(encoding="utf-8"))


def test_what_a_trial_has_for_itself_is_said_in_the_words_of_the_rig():
    own = {"release_time": {"mean": 2e-4, "sd": 1e-4, "hdi90": [0.0, 4e-4], "unit": "s"}}
    rows = _trial_table("8 mm", {"8 mm coupled #1": own}, "translational").rows
    assert rows[0].cells[1] == "release_time: time over which the force that holds body 1 falls to nothing"
