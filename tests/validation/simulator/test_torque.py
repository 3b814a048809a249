"""The torque that a withheld cause adds, and how the shape that a verdict draws is held against it."""

import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from withheld_reference import NOMINAL, RIG

import torque  # isort: skip  (validation/simulator, which withheld_reference puts on the path)

K1T = {"6.2": 6.3, "10.2": 10.1}
SPRING = {"effect": "spring_cubic", "amplitude": 0.5, "shape": [20.0, 0.0, 0.0]}
NUT = {"effect": "release_offset", "amplitude": 0.01, "shape": [0.0, 0.0, 0.0]}


def entry(*disturbances, site="ground1", truth="spring_cubic", **other):
    constants = {name: RIG[name] for name in ("J1", "J2", "R", "r", "N0")}
    return {
        "kind": "easy", "truth": truth, "standing": "library", "level_wanted": 0.5, "visible_chi2": 900.0, "site": site,
        "disturbances": list(disturbances), "nominal": NOMINAL, "best_nominal": NOMINAL, "duration": 1.0,
        "constants": {**constants, "k1t": K1T}, **other,
    }  # fmt: skip


def drawn(e, names, change=lambda x, p: 0.0, bins=25):
    """What a verdict draws, by bins of its own: the true torque and a change."""
    body = torque.BODY[e["site"]]
    pieces = torque.true_motion(e, body)
    q = np.concatenate([torque.missing(x, p, body, coupled) + change(x, p) for x, p, coupled in pieces])
    out = {}
    for name in names:
        value = np.concatenate([torque.COORDINATES[name](x) for x, _, _ in pieces])
        edges = np.linspace(value.min(), value.max(), bins + 1)
        place = np.clip(np.digitize(value, edges) - 1, 0, bins - 1)
        count = np.bincount(place, minlength=bins)
        told = {"centre": 0.5 * (edges[1:] + edges[:-1]), "torque_n_m": np.bincount(place, q, bins) / count}
        out[name] = {n: v.tolist() for n, v in told.items()} | {"count": count.tolist(), "sd_n_m": [1e-3] * bins}
    return out


def test_the_missing_torque_is_that_of_the_cause():
    for x, p, coupled in torque.true_motion(entry(SPRING), 0):
        law = -0.5 * p["k1t"] * (np.sinh(20.0 * x[:, 0]) / 20.0 - x[:, 0])
        np.testing.assert_allclose(torque.missing(x, p, 0, coupled), law, rtol=1e-9, atol=1e-12)
        if coupled:
            np.testing.assert_allclose(torque.missing(x, p, 1, True), 0.0, atol=1e-12)


def test_nothing_is_missing_where_only_the_start_differs():
    for body in (0, 1):
        for x, p, coupled in torque.true_motion(entry(NUT), body):
            assert len(x) == 1001
            np.testing.assert_allclose(torque.missing(x, p, body, coupled), 0.0, atol=1e-12)


def test_every_mix_of_nominal_laws_is_what_a_change_of_parameters_makes_missing():
    e = entry(NUT)
    for body in (0, 1):
        for x, p, coupled in torque.true_motion(e, body):
            form = torque.laws(x, p, body, coupled)
            names = ["c1t" if body == 0 else "c3t", "drag", "nu", *(("k2t", "c2t", "mu") if coupled else ())]
            for name in names:
                changed = torque.missing(x, p | {name: p[name] * 1.001}, body, coupled)
                solved, *_ = np.linalg.lstsq(form, changed, rcond=None)
                left = np.linalg.norm(changed - form @ solved)
                assert left < 2e-3 * np.linalg.norm(changed), (body, coupled, name)


@pytest.mark.parametrize(
    ("change", "cosine"),
    [
        (lambda x, p: 0.0, 1.0),
        (lambda x, p: 0.02 * x[:, 2] + 0.01 * np.tanh(p["nu"] * x[:, 2]), 1.0),  # as another damping and drag
        (lambda x, p: p["k1t"] * (np.sinh(20.0 * x[:, 0]) / 20.0 - x[:, 0]), -1.0),  # a spring that softens as much
    ],
)
def test_shapes_are_compared_beyond_the_nominal_laws(change, cosine):
    e = entry(SPRING)
    found, size, beyond = torque.compared(e, drawn(e, ("th1", "w1"), change))
    assert found == pytest.approx(cosine, abs=2e-3)
    assert size == pytest.approx(1.0, abs=5e-3)
    assert 0.0 < beyond <= 1.0


def test_another_shape_is_not_called_the_same():
    e = entry(SPRING)
    found, _, _ = torque.compared(
        e, drawn(e, ("th1", "w1"), lambda x, p: 0.5 * p["k1t"] * (np.sinh(20.0 * x[:, 0]) / 20.0 - x[:, 0])
                 + 1e-4 * x[:, 2] ** 2)
    )  # fmt: skip
    assert abs(found) < 0.5


@pytest.fixture
def run(tmp_path):
    e = entry(SPRING)
    curve = drawn(e, ("th1", "w1"))
    maps = {
        "a": {"torque_site": "ground1", "curve": curve},
        "b": {"torque_site": "interface", "curve": dict.fromkeys(("phi", "slip"), curve["th1"])},
        "c": {"torque_site": None, "curve": {}},
        "d": {"torque_site": "ground1", "curve": curve},
    }
    for name, placed in maps.items():
        home = tmp_path / "run" / "verdicts" / name
        home.mkdir(parents=True)
        (home / "verdict.json").write_text(json.dumps({"verdict": {"site_map": placed}}))
    entries = dict.fromkeys("abc", e) | {"d": entry(NUT, site="release", truth="release_offset")}
    (tmp_path / "key.json").write_text(json.dumps({"campaigns": entries}))
    return tmp_path


def test_a_run_is_held_against_its_key(run, capsys):
    out = run / "shapes.json"
    assert torque.main([str(run / "run"), str(run / "key.json"), "--out", str(out)]) == 0
    told = json.loads(out.read_text())
    rows = {row["campaign"]: row for row in told["campaigns"]}
    assert set(rows) == {"a", "b", "c"}  # a start that is off is no torque
    assert rows["a"]["cosine"] == pytest.approx(1.0)
    assert rows["b"]["cosine"] is None  # drawn on the other inertia
    assert rows["c"]["cosine"] is None  # nothing drawn
    for group in ("library", "library, ground1", "`spring_cubic`"):
        assert (told["summary"][group]["campaigns"], told["summary"][group]["same"]) == (3, 1)
    assert "| library | 3 | 1 | 1.00 (1.00 .. 1.00) | 1 of 1 |" in capsys.readouterr().out


def test_a_folder_without_verdicts_and_a_key_of_other_campaigns_are_told(run):
    with pytest.raises(SystemExit, match="holds no verdicts"):
        torque.main([str(run / "run"), str(run / "key.json"), "--left-out"])
    (run / "key.json").write_text(json.dumps({"campaigns": {"z": entry(SPRING)}}))
    with pytest.raises(SystemExit, match="has no entry"):
        torque.main([str(run / "run"), str(run / "key.json")])


def test_medians_have_an_interval_over_campaigns():
    cosines = [0.2, 0.5, 0.9, 0.95, None]
    told = torque.summary([{"cosine": c} for c in cosines])
    assert told["median"] == pytest.approx(0.7)
    assert told["interval95"][0] < 0.7 < told["interval95"][1]
    assert (told["campaigns"], told["drawn"], told["same"]) == (5, 4, 2)
    assert math.isclose(torque.summary([{"cosine": None}])["drawn"], 0)


def test_the_page_of_the_proof_repeats_the_table():
    proof = Path(__file__).resolve().parents[3] / "docs" / "proof"
    told = json.loads((proof / "withheld_torque.json").read_text(encoding="utf-8"))
    assert told["summary"] == torque.grouped(told["campaigns"])
    places = {name: part for name, part in told["summary"].items() if not name.startswith("`")}
    assert torque.table(places) in (proof / "withheld.md").read_text(encoding="utf-8")


def law_of(site, terms, bodies="both"):
    """A learnt law as its file holds it."""
    ranges = {"angle": [-0.15, 0.15], "speed": [-8.0, 8.0], "time": [0.0, 1.0]}
    parts = [{"carrier": c, "along": along, "coefficients": list(k)} for c, along, k in terms]
    return {"site": site, "bodies": bodies, "ranges": ranges, "term": parts, "nominal": {}}


def test_a_learnt_law_is_read_as_the_package_reads_it(tmp_path):
    """Two codes, one file: the script's torque on each inertia, and the package's at the site's coordinates."""
    from bayes_damper.effects._law import Law, Term, read_law, written

    rng = np.random.default_rng(3)
    kinds = (("one", "angle"), ("dry", "speed"), ("angle", "time"), ("speed", "angle"))
    terms = tuple(Term(c, along, tuple(rng.standard_normal(12))) for c, along in kinds)
    ranges = {"angle": (-0.08, 0.1), "speed": (-5.0, 3.0), "time": (0.0, 0.7)}
    x, t, nu = rng.standard_normal((40, 6)) * 0.2, np.linspace(0.0, 1.0, 40), 30.0
    for site, bodies in (("interface", "both"), ("bearings", "both"), ("bearings", "primary"), ("ground2", "both")):
        path = tmp_path / f"{site}.toml"
        path.write_text(written(Law(site, bodies, ranges, nu, terms, rig={"kind": "torsional", "J1": 1.0})))
        law, mine = tomllib.loads(path.read_text()), read_law(path)
        for body in (0, 1):
            acts = {"interface": (True, True), "ground2": (False, True)}.get(site, (True, bodies == "both"))[body]
            place = (x[:, 0] - x[:, 1], x[:, 2] - x[:, 3]) if site == "interface" else (x[:, body], x[:, 2 + body])
            sign = -1.0 if site == "interface" and body == 0 else 1.0
            expected = sign * acts * mine.torque(*place, t)[0]
            np.testing.assert_allclose(torque.law_torque(law, x, t, body, True, nu), expected, atol=1e-7)


def test_a_law_of_the_right_shape_has_the_cosine_one():
    e = entry(SPRING)
    cubic = [0.0, 0.75, 0.0, 0.25] + [0.0] * 8  # x^3 of the scaled angle
    square = [0.5, 0.0, 0.5] + [0.0] * 9
    sign = math.copysign(1.0, torque.shape_of_law(e, law_of("ground1", [("one", "angle", cubic)])))
    assert torque.shape_of_law(e, law_of("ground1", [("one", "angle", [sign * c for c in cubic])])) > 0.98, (
        "a share of each spring"
    )
    assert abs(torque.shape_of_law(e, law_of("ground1", [("one", "angle", square)]))) < 0.3
