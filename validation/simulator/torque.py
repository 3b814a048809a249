# ruff: noqa: T201  (a script of its own, in no package, that talks to the terminal)
"""Is the shape of the missing torque recovered? Sealed verdicts against the torque that the rig's own equations miss.

    python validation/simulator/torque.py RUN KEY [RUN KEY ...] [--out FILE] [--left-out]

RUN: the folder of a finished `bayes-damper withheld` run; KEY: the key of its campaigns; --left-out: the verdicts that
were given without the true effect in the library. A verdict draws the torque it misses against the coordinates of the
site, averaged in bins. Here the true one is worked out: what balances the nominal equations of motion, with the
parameters of the best nominal fit, along the true noise-free motion. Both are averaged in the same bins.

Which part of a missing torque has the form of a nominal law is a matter of convention: a fit gives way to it. So the
nominal laws are taken out of both, and what is compared is the rest, as the cosine between both (1: same shape).
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
if str(HERE) not in sys.path:
    sys.path.insert(0, str(HERE))

from rig.campaign import CASES  # noqa: E402
from rig.equations import accelerations, rig_array  # noqa: E402
from rig.kinds import KINDS  # noqa: E402
from rig.simulate import SEARCH_STEP, motion  # noqa: E402

Array = NDArray[np.float64]

BODY = {"ground1": 0, "bearings": 0, "interface": 1, "ground2": 1}
"""Sites where a torque is missing -> the inertia on which a verdict draws it, 0 the primary."""
COORDINATES = {
    "th1": lambda x: x[:, 0],
    "w1": lambda x: x[:, 2],
    "th2": lambda x: x[:, 1],
    "w2": lambda x: x[:, 3],
    "phi": lambda x: x[:, 0] - x[:, 1],
    "slip": lambda x: x[:, 2] - x[:, 3],
}
SAME = 0.8
"""Cosine from which two shapes are called the same."""


def missing(x: Array, p: dict[str, float], body: int, coupled: bool) -> Array:
    """Torque (n,), N m, that balances the nominal equation of one inertia along a motion (n, 6) of `rig.simulate`.

    p : constants and nominal parameters; positive: it accelerates the inertia.
    """
    constants, none, still = rig_array(p), np.zeros(2, np.int64), np.zeros(4)
    nominal = [
        accelerations(0.0, *state, still, 0.0, none, np.zeros((2, 4)), constants, coupled, still)[body]
        for state in x[:, :4]
    ]
    return np.asarray((p["J1"], p["J2"])[body] * (x[:, 4 + body] - nominal))


def laws(x: Array, p: Mapping[str, float], body: int, coupled: bool) -> Array:
    """Torques (n, 7) of the form of a nominal law: damping, drag and its sharpness; those of the coupling."""
    w = x[:, 2 + body]
    dry = np.tanh(p["nu"] * w)
    out = np.zeros((len(x), 7))
    out[:, 0], out[:, 1], out[:, 2] = w, dry, w * (1.0 - dry**2)
    if coupled:
        phi, slip = COORDINATES["phi"](x), COORDINATES["slip"](x)
        pull, held = np.maximum(0.0, 1.0 - p["R"] * np.abs(phi) / (2.0 * p["r"])), np.tanh(p["nu"] * slip)
        out[:, 3], out[:, 4], out[:, 5], out[:, 6] = phi, slip, pull * held, pull * slip * (1.0 - held**2)
    return out


def true_motion(entry: Mapping[str, Any], body: int) -> list[tuple[Array, dict[str, float], bool]]:
    """Motion (n, 6) every ms in each case and configuration that moves this inertia, noise-free; its constants with
    the parameters of the best nominal fit; whether it is coupled.
    """
    acting = [KINDS[d["effect"]].at(d["amplitude"], tuple(d["shape"])) for d in entry["disturbances"]]
    constants = dict(entry["constants"])
    stiffnesses = constants.pop("k1t")
    out = []
    for _, k1t, degrees in CASES:
        own = {**constants, "k1t": stiffnesses[f"{k1t:g}"], "theta0": float(np.radians(degrees))}
        for coupled in (False, True) if body == 0 else (True,):
            every = round(1e-3 / SEARCH_STEP)
            x = motion({**entry["nominal"], **own}, coupled, acting, entry["duration"], SEARCH_STEP, every)
            out.append((x, {**entry["best_nominal"], **own}, coupled))
    return out


def compared(entry: Mapping[str, Any], curve: Mapping[str, Mapping[str, Any]]) -> tuple[float, float, float]:
    """A curve of a verdict beside the truth: cosine, size over the true one, and the share of the true curve that is
    not of the form of a nominal law (all of root mean squares over the readings).
    """
    body = BODY[entry["site"]]
    pieces = true_motion(entry, body)
    torque = np.concatenate([missing(x, p, body, coupled) for x, p, coupled in pieces])
    form = np.concatenate([laws(x, p, body, coupled) for x, p, coupled in pieces])
    drawn, true, of_laws = [], [], []
    for name, told in curve.items():
        value = np.concatenate([COORDINATES[name](x) for x, _, _ in pieces])
        centre = np.asarray(told["centre"], float)
        place = np.searchsorted(0.5 * (centre[1:] + centre[:-1]), value)
        count = np.bincount(place, minlength=centre.size)
        seen = count > 0
        weight = np.sqrt(np.asarray(told["count"], float)[seen])
        drawn.append(weight * np.asarray(told["torque_n_m"], float)[seen])
        means = [np.bincount(place, y, centre.size)[seen] / count[seen] for y in (torque, *form.T)]
        true.append(weight * means[0])
        of_laws.append(weight[:, None] * np.stack(means[1:], axis=1))
    a, b, m = np.concatenate(drawn), np.concatenate(true), np.concatenate(of_laws)
    m = m[:, np.linalg.norm(m, axis=0) > 0.0]
    basis, _ = np.linalg.qr(m / np.linalg.norm(m, axis=0))
    whole = float(np.linalg.norm(b))
    a, b = a - basis @ (basis.T @ a), b - basis @ (basis.T @ b)
    sizes = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    cosine = float(a @ b) / max(sizes[0] * sizes[1], 1e-300)
    return cosine, sizes[0] / max(sizes[1], 1e-300), sizes[1] / max(whole, 1e-300)


def law_torque(law: Mapping[str, Any], x: Array, t: Array, body: int, coupled: bool, nu: float) -> Array:
    """Torque (n,) of a file of a learnt law (TOML, read by whoever calls) on one inertia along a motion (n, 6)."""
    site = law["site"]
    if site == "interface":
        sign, angle, speed = (-1.0, 1.0)[body] * float(coupled), COORDINATES["phi"](x), COORDINATES["slip"](x)
    else:
        sign = float(body == BODY[site] or (site == "bearings" and law["bodies"] == "both" and coupled))
        angle, speed = x[:, body], x[:, 2 + body]
    values, total = {"angle": angle, "speed": speed, "time": t}, np.zeros(len(x))
    for term in law["term"]:
        low, high = law["ranges"][term["along"]]
        at = np.clip(values[term["along"]], low, high)
        w = at / max(abs(low), abs(high))
        u = 1.2 * w / (0.2 + np.abs(w)) if term["along"] == "speed" else (2.0 * at - low - high) / (high - low)
        curve = np.polynomial.chebyshev.chebval(u, term["coefficients"])
        if term["carrier"] == "dry":
            curve *= np.tanh(nu * speed)
        elif term["carrier"] != "one":
            curve *= np.clip(values[term["carrier"]] / max(map(abs, law["ranges"][term["carrier"]])), -1.0, 1.0)
        total += curve
    return np.asarray(sign * total)


def shape_of_law(entry: Mapping[str, Any], law: Mapping[str, Any]) -> float:
    """Cosine between a learnt law and the torque that is truly missing, instant by instant along the true motions.

    What is missing is what balances the nominal equations with the parameters that go with the law (its table
    `nominal`). Nominal laws are taken out of both, as in `compared`, and of the primary's spring so is a constant: with
    release angles that are not known exactly, it is a release from another angle.
    """
    body = BODY[entry["site"]]
    own = [
        (x, {**p, **{n: v for n, v in law["nominal"].items() if n in p}}, coupled)
        for x, p, coupled in true_motion(entry, body)
    ]
    constant = float("ground1" in (entry["site"], law["site"]))
    b = np.concatenate([missing(x, p, body, coupled) for x, p, coupled in own])
    a = np.concatenate([
        law_torque(law, x, 1e-3 * np.arange(len(x)), body, coupled, p["nu"]) for x, p, coupled in own
    ])  # fmt: skip
    m = np.concatenate(
        [np.column_stack([laws(x, p, body, coupled), constant * np.ones(len(x))]) for x, p, coupled in own]
    )
    m = m[:, np.linalg.norm(m, axis=0) > 0.0]
    basis, _ = np.linalg.qr(m / np.linalg.norm(m, axis=0))
    a, b = a - basis @ (basis.T @ a), b - basis @ (basis.T @ b)
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)


def rows_of(run: Path, key: Path, left_out: bool = False) -> Iterator[dict[str, Any]]:
    """Every campaign of a run whose one cause is a torque: what it is, what the verdict drew and how alike that is."""
    entries = json.loads(key.read_text(encoding="utf-8"))["campaigns"]
    home = run / "leave_one_out" if left_out else run
    found = sorted(home.glob("verdicts/*/verdict.json"))
    if not found:
        raise SystemExit(f"{home}: holds no verdicts; give the folder that `bayes-damper withheld --out` wrote")
    for path in found:
        name = path.parent.name
        if name not in entries:
            raise SystemExit(f"{path}: {key} has no entry for it; give each run its own key")
        entry = entries[name]
        if not isinstance(entry["site"], str) or entry["site"] not in BODY:
            continue
        told = json.loads(path.read_text(encoding="utf-8"))["verdict"]
        placed = told.get("site_map") or {}
        row = {
            "campaign": name, "kind": entry["kind"], "truth": entry["truth"], "standing": entry["standing"],
            "left_out": left_out, "level": entry["level_wanted"], "visible_chi2": entry["visible_chi2"],
            "site": entry["site"], "drawn_at": placed.get("torque_site"), "cosine": None,
        }  # fmt: skip
        curve = placed.get("curve")
        if curve and BODY.get(row["drawn_at"]) == BODY[entry["site"]] == int("th1" not in curve):
            row["cosine"], row["size"], row["beyond_laws"] = compared(entry, curve)
        yield row


def summary(rows: list[dict[str, Any]], seed: int = 1) -> dict[str, Any]:
    """Of these campaigns: how many verdicts drew a torque on the right inertia, and how alike the shapes are."""
    drawn = np.array([row["cosine"] for row in rows if row["cosine"] is not None])
    out: dict[str, Any] = {"campaigns": len(rows), "drawn": int(drawn.size)}
    if drawn.size:
        again = np.median(drawn[np.random.default_rng(seed).integers(drawn.size, size=(2000, drawn.size))], axis=1)
        out["median"] = float(np.median(drawn))
        out["interval95"] = [float(q) for q in np.quantile(again, [0.025, 0.975])]
        out["same"] = int(np.sum(drawn >= SAME))
    return out


def table(told: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown: a line for each group of campaigns."""
    lines = [
        f"| cause | campaigns | torque drawn | cosine, median | from {SAME:g} |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, part in told.items():
        cells = [name, str(part["campaigns"]), str(part["drawn"]), "", ""]
        if part["drawn"]:
            low, high = part["interval95"]
            cells[3:] = [f"{part['median']:.2f} ({low:.2f} .. {high:.2f})", f"{part['same']} of {part['drawn']}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def grouped(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Summaries: effects of the library and causes outside it, each by site, then every cause."""
    out = {}
    for words, own in (
        ("library", [r for r in rows if r["standing"] == "library"]),
        ("outside it", [r for r in rows if r["standing"] != "library"]),
    ):
        out |= {words: summary(own)} if own else {}
        out |= {
            f"{words}, {s}": summary([r for r in own if r["site"] == s])
            for s in BODY
            if any(r["site"] == s for r in own)
        }
    return out | {f"`{t}`": summary([r for r in rows if r["truth"] == t]) for t in sorted({r["truth"] for r in rows})}


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN KEY")
    parser.add_argument("--left-out", action="store_true", help="verdicts without the true effect in the library")
    parser.add_argument("--out", type=Path, help="write the table's numbers and all rows as JSON")
    given = parser.parse_args(arguments)
    if len(given.runs) % 2:
        parser.error("give RUN and KEY, once or more often")
    pairs = zip(given.runs[::2], given.runs[1::2], strict=True)
    rows = [row for run, key in pairs for row in rows_of(run, key, given.left_out)]
    told = grouped(rows)
    print(table(told))
    if given.out is not None:
        given.out.write_text(json.dumps({"summary": told, "campaigns": rows}) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
