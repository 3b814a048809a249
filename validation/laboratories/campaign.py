"""Orders, campaigns on disk in the contract's format, and the sealed key."""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import secrets
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import gap
from .kinds import KINDS, names
from .laboratory import Laboratory, draw
from .motion import Disturbance, record

Array = NDArray[np.float64]
KEY_SCHEMA = "bayes-damper/withheld-key/1"
REDRAWS = 8


@dataclass(frozen=True)
class Order:
    """What to make. causes : names of kinds, or "library" / "foreign" for one drawn for the rig; level 0: drawn.

    strength : of all scatters over the typical ones; repeats, bodies : None leaves them to the draw.
    """

    causes: tuple[str, ...]
    level: float
    seed: int
    strength: float | None = None
    repeats: bool | None = None
    bodies: int | None = None


def folder_name(order: Order, salt: str) -> str:
    """Name of a campaign: a hash that says nothing without the salt."""
    return hashlib.sha256(f"{salt}|{order}".encode()).hexdigest()[:12]


def make(order: Order, folder: Path, salt: str) -> dict[str, Any]:
    """Writes one campaign below `folder`; its entry of the key."""
    rng = np.random.default_rng([order.seed, 20231])
    level = order.level or float(np.random.default_rng([order.seed, 1]).choice([0.3, 1.0, 3.0], p=[0.2, 0.6, 0.2]))
    best: tuple[float, Any] | None = None
    for _ in range(REDRAWS if order.causes else 1):
        found = _candidate(order, level, rng)
        if found is None:
            continue
        short = max(abs(math.log(max(e["level_searched"], 1e-9) / level)) for e in found[3]) if found[3] else 0.0
        if best is None or short < best[0]:
            best = (short, found)
        if short < 0.2:
            break
    if best is None:
        raise ValueError(f"no laboratory of {REDRAWS} can have {' and '.join(order.causes)}")
    lab, seen, owns, entries, wrong, scatter = best[1]
    found_gap = gap.gap_of(lab, seen, wrong, scatter) if wrong else gap.Gap(0.0, 0.0, {})
    visible = gap.visible_chi2(lab, seen, wrong) if wrong else 0.0
    name = folder_name(order, salt)
    home = folder / name
    if home.exists():
        shutil.rmtree(home)
    (home / "trials").mkdir(parents=True)
    trials = _write(home, name, lab, seen, owns, wrong, rng)
    single = entries[0] if len(entries) == 1 else None
    return {
        "kind": "laboratory",
        "effects": [e["effect"] for e in entries],
        "truth": single["effect"] if single else ("none" if not entries else "pair"),
        "site": single["site"] if single else ([e["site"] for e in entries] or "none"),
        "class": single["class"] if single else None,
        "standing": single["standing"] if single else None,
        "level_wanted": level if entries else 0.0,
        "level": found_gap.level,
        "gap_rms_over_noise": found_gap.rms,
        "scatter_rms_over_noise": scatter,
        "visible_chi2": visible,
        "disturbances": entries,
        "nominal": lab.nominal,
        "at_rest": _at_rest(lab, wrong),
        "constants": lab.true | {"k1t": [c.k1 for c in lab.cases]},
        "scatter": lab.scatter,
        "trend": lab.trend,
        "laboratory": lab.facts(),
        "trials": trials,
        "order": asdict(order),
    }


def _candidate(order: Order, level: float, rng: np.random.Generator) -> Any:
    """A laboratory with disturbances of the wanted level; None where its rig cannot have them."""
    lab = draw(rng, order.strength, order.repeats, order.bodies)
    possible = {s: names(s, lab.bodies == 2, lab.normal_force == "linear") for s in ("library", "foreign")}
    chosen: list[str] = []
    for cause in order.causes:
        pool = [n for n in possible.get(cause, [cause]) if not {n, *KINDS[n].twins} & set(chosen)]
        chosen.append(pool[int(rng.integers(len(pool)))])
    if any(n not in possible["library"] + possible["foreign"] for n in chosen):
        return None
    seen = gap.conditions(lab)
    total = sum(c.trials for c in seen)
    owns: list[list[dict[str, float]]] = []
    number = 0
    for c in seen:
        owns.append([])
        for _ in range(c.trials):
            place = 2.0 * number / (total - 1) - 1.0 if total > 1 else 0.0
            owns[-1].append(lab.own_values(rng, place))
            number += 1
    if not chosen:
        return lab, seen, owns, [], [], gap.scatter_rms(lab, seen, owns)
    scatter = gap.scatter_rms(lab, seen, owns)
    entries: list[dict[str, Any]] = []
    wrong: list[Disturbance] = []
    for name in chosen:
        kind = KINDS[name]
        shape, sign = kind.shape(rng), float(rng.choice(kind.signs))
        size, reached = gap.amplitude_for(lab, seen, kind, shape, sign, level, scatter)
        wrong.append(kind.at(sign * size, shape))
        entries.append(
            {
                "effect": name, "site": kind.site, "standing": kind.standing, "class": sorted((name, *kind.twins)),
                "amplitude": sign * size, "shape": list(shape), "meaning": kind.formula, "level_searched": reached,
            }
        )  # fmt: skip
    return lab, seen, owns, entries, wrong, scatter


def _at_rest(lab: Laboratory, wrong: Sequence[Disturbance]) -> dict[str, float]:
    """Nominal parameters with what a disturbance adds near rest in the form of a nominal law."""
    out = dict(lab.nominal)
    for d in wrong:
        if d.code == KINDS["eddy_overlap"].code:
            out["c2t"] += d.p[0] * lab.true["J2"] * lab.W
    return out


def _write(
    home: Path, name: str, lab: Laboratory, seen: Sequence[gap.Condition], owns: Sequence[Sequence[dict[str, float]]],
    wrong: Sequence[Disturbance], rng: np.random.Generator,
) -> list[dict[str, Any]]:  # fmt: skip
    """The records, the table of trials and campaign.toml; what the key holds of each trial."""
    torsional = lab.kind == "torsional"
    k, angle = ("k1t", "theta0") if torsional else ("k1", "theta0")
    unit = {"k": "n_m_per_rad" if torsional else "n_per_m", "a": "deg" if torsional else "mm"}
    spread = max(lab.scatter["theta0"], 1e-3) * math.exp(0.3 * float(rng.standard_normal()))
    head = [
        "file", "case", "configuration", f"{k}_{unit['k']}",
        *([f"{k}_std_{unit['k']}"] if lab.shares["k1t"] > 0.0 else []),
        f"{angle}_{unit['a']}", f"{angle}_std_{unit['a']}", "trial",
    ]  # fmt: skip
    rows, told, number = [head], [], 0
    for c, of_condition in zip(seen, owns, strict=True):
        said = math.degrees(c.case.theta0) if torsional else 1e3 * c.case.theta0
        for trial, own in enumerate(of_condition, 1):
            number += 1
            times = lab.times(rng)
            y = record(lab.rig(c.case, c.coupled, own), times, wrong, own.get("instant", 0.0))
            y = add_noise(gap.add_sensor_scatter(y, times, own), lab, rng)
            file = f"trials/{number:02d}.csv.gz"
            _write_record(home / file, lab, times, y)
            rows.append(
                [
                    file, c.case.label, "coupled" if c.coupled else "uncoupled", f"{c.case.declared:.6g}",
                    *([f"{lab.shares['k1t'] * c.case.declared:.3g}"] if lab.shares["k1t"] > 0.0 else []),
                    f"{said:.6g}", f"{spread * said:.3g}", str(trial),
                ]
            )  # fmt: skip
            told.append({"file": file, **own})
    (home / "trials.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    (home / "campaign.toml").write_text(_toml(name, lab))
    return told


def add_noise(y: Array, lab: Laboratory, rng: np.random.Generator) -> Array:
    """Readings with the laboratory's noise, rounded where its converter is coarse."""
    out = y.copy()
    for c in range(y.shape[0]):
        out[c] += lab.noise_of(rng, y.shape[1], c)
        if step := lab.quantum(c):
            out[c] = step * np.round(out[c] / step)
    return out


def _columns(lab: Laboratory) -> list[str]:
    names_of = {
        ("torsional", "acceleration"): "alpha{}_rad_s2", ("torsional", "velocity"): "omega{}_rad_s",
        ("torsional", "displacement"): "theta{}_rad", ("translational", "acceleration"): "a{}_m_s2",
        ("translational", "velocity"): "v{}_m_s", ("translational", "displacement"): "x{}_m",
    }  # fmt: skip
    form = names_of[lab.kind, lab.quantity]
    return [form.format(1), form.format(2)]


def _write_record(path: Path, lab: Laboratory, times: Array, y: Array) -> None:
    digits = [max(0, math.ceil(-math.log10((lab.quantum(c) or lab.sigma[c]) / 50.0))) for c in range(y.shape[0])]
    fine = max(3, math.ceil(-math.log10(lab.interval / 2000.0)))
    lines = [",".join(["time_s", *_columns(lab)[: y.shape[0]]])]
    for i, t in enumerate(times):
        lines.append(",".join([f"{t:.{fine}f}", *(f"{v:.{d}f}" for v, d in zip(y[:, i], digits, strict=True))]))
    with path.open("wb") as raw, gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0) as out:
        out.write(("\n".join(lines) + "\n").encode())


def _toml(name: str, lab: Laboratory) -> str:
    fields = [("primary_inertia", "J1")]
    if lab.bodies == 2:
        fields += [("secondary_inertia", "J2"), ("bar_radius", "R"), ("magnet_radius", "r")]
    lines = [
        f'name = "{name}"', 'description = "simulated trials of a drawn laboratory, cause withheld"',
        'source = "validation/laboratories, independent simulator"', "", "[rig]", f'kind = "{lab.kind}"',
    ]  # fmt: skip
    for key, symbol in fields:
        if key == "bar_radius" and lab.kind == "translational":
            continue
        value, share = lab.declared[symbol], lab.shares[symbol]
        lines.append(f"{key} = {{ value = {value:g}, std = {share * value:.3g} }}" if share else f"{key} = {value:g}")
    if lab.bodies == 2:
        lines += [f"magnet_pull = {lab.declared['N0']:g}", f'normal_force = "{lab.normal_force}"']
        lines += [f"ground2_stiffness = {lab.declared['k3t']:g}"] if lab.declared["k3t"] else []
    lines += [f'restoring = "{lab.restoring}"', "", "[measurement]", f'quantity = "{lab.quantity}"']
    return "\n".join(lines) + "\n"


def orders(
    tokens: Sequence[str],
    seed: int,
    level: float = 0.0,
    strength: float | None = None,
    repeats: bool | None = None,
    bodies: int | None = None,
) -> list[Order]:
    """Shuffled orders, each with a seed of its own; a token is a kind, "none", "library", "foreign", joined by "+",
    and "*n" for n of them. ValueError for an unknown name.
    """  # fmt: skip
    rng = np.random.default_rng(seed)
    out = []
    for token in tokens:
        word, _, count = token.partition("*")
        causes = () if word == "none" else tuple(word.split("+"))
        for cause in causes:
            if cause not in (*KINDS, "library", "foreign"):
                raise ValueError(f"no kind is called {cause!r}; known: none, library, foreign, {', '.join(KINDS)}")
        for _ in range(int(count) if count else 1):
            out.append(Order(causes, level if causes else 0.0, int(rng.integers(1, 2**53)), strength, repeats, bodies))
    return [out[i] for i in rng.permutation(len(out))]


def write_set(
    wanted: Sequence[Order], folder: Path, key_file: Path, workers: int = 1, salt: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:  # fmt: skip
    """Makes every campaign of the set that the key does not hold yet; the key, written after each."""
    key: dict[str, Any] = {"schema": KEY_SCHEMA, "campaigns": {}}
    if key_file.exists():
        key = json.loads(key_file.read_text())
    salt = str(salt or key.get("salt") or secrets.token_hex(16))
    key["salt"] = salt
    folder.mkdir(parents=True, exist_ok=True)
    todo = [o for o in wanted if folder_name(o, salt) not in key["campaigns"]]

    def keep(order: Order, entry: dict[str, Any]) -> None:
        key["campaigns"][folder_name(order, salt)] = entry
        key["campaigns"] = dict(sorted(key["campaigns"].items()))
        draft = key_file.with_suffix(".tmp")
        draft.write_text(json.dumps(key, indent=1) + "\n")
        draft.replace(key_file)
        tell(f"{len(key['campaigns'])} campaigns, {folder_name(order, salt)}")

    if workers == 1:
        for order in todo:
            keep(order, make(order, folder, salt))
        return key
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        made = pool.map(make, todo, [folder] * len(todo), [salt] * len(todo))
        for order, entry in zip(todo, made, strict=True):
            keep(order, entry)
    return key


def again(key_file: Path, folder: Path, workers: int = 1) -> None:
    """Makes the campaigns of a key once more, from the orders and the salt that it holds."""
    key = json.loads(key_file.read_text())
    wanted = []
    for entry in (e for e in key["campaigns"].values() if "order" in e):
        told = dict(entry["order"])
        wanted.append(Order(**(told | {"causes": tuple(told["causes"])})))
    write_set(wanted, folder, folder.parent / f"{folder.name}_key.json", workers, key["salt"])
