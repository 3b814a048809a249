"""One campaign: nominal parameters, constants, trials and noise are drawn, the records written with their key entry.

Easy kind: constants exact, the same friction in all trials, white noise, release angles off by 1 %.
Hard kind: constants off by draws of their declared standard deviations, friction 3 % apart from trial to trial, loggers
that start up to a sample late, noise partly correlated, the second channel noisier, readings rounded to 0.25 rad/s^2.
"""

import gzip
import hashlib
import io
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import codes
from .gap import AR_PHI, AR_SHARE, CHANNEL_2, NOISE, Condition, amplitude_for, gap_of, visible_chi2
from .kinds import KINDS, Kind
from .sensors import FULL_SCALE, Disturbance
from .simulate import FINE_STEP, record

CASES = (("I", 6.2, 5.7), ("II", 6.2, 7.2), ("III", 10.2, 2.7), ("IV", 10.2, 4.7))  # label, k1t N m/rad, theta0 deg
DECLARED = {"J1": 3.015e-3, "J2": 2.474e-3, "R": 0.10, "r": 0.0127, "N0": 100.0}
HARD_SHARES = {"J1": 0.01, "J2": 0.02, "R": 0.02, "r": 0.02}
K1T_SHARE = 0.01
BEYOND_DECLARED = {"stiffness_error": 3.0 * K1T_SHARE, "inertia_error": 3.0 * HARD_SHARES["J2"]}
ANGLE_SHARE = 0.01
TRIALS = 3
QUANTUM = 0.25  # rad/s^2
REDRAWS = 3  # of the nominal parameters, where a kind's limit keeps it too weak on the rig drawn first


@dataclass(frozen=True)
class Order:
    """What to make: kind "easy" or "hard", names of 0 to 2 disturbances, level, seed, s of a record.

    trigger : "late" (the logger starts after the release), "early", or "either" (drawn for the campaign).
    """

    kind: str
    effects: tuple[str, ...]
    level: float
    seed: int
    duration: float = 1.0
    trigger: str = "late"


def nominal_draw(rng: np.random.Generator) -> dict[str, float]:
    """Parameters of a rig like the thesis's."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return {
        "mu": log(0.003, 0.012),
        "k2t": log(0.8, 3.0),
        "c2t": log(0.04, 0.13),
        "drag": log(0.002, 0.012),
        "nu": log(20.0, 150.0),
        "c1t": log(0.005, 0.02),
        "c3t": log(0.005, 0.02),
    }


def at_rest(nominal: dict[str, float], disturbances: list[Disturbance]) -> dict[str, float]:
    """Nominal parameters as a rig near rest shows them: what a disturbance adds there in the same form is counted in.

    No measurement near rest could tell the two apart, so which share has which name is a convention of the formula.
    """
    out = dict(nominal)
    for d in disturbances:
        if d.code == codes.EDDY_OVERLAP:  # full overlap: a damping
            out["c2t"] += d.p[0]
        elif d.code == codes.QUADRATIC_DRAG:  # laminar below the speed p1
            out["c1t"] += d.p[0] * d.p[1]
            out["c3t"] += d.p[0] * d.p[1]
    return out


def noise_draw(rng: np.random.Generator, n: int, hard: bool, channel: int) -> NDArray[np.float64]:
    """Noise of one channel, rad/s^2: white, or (hard) a fifth of the variance an AR(1) process."""
    if not hard:
        return NOISE * rng.standard_normal(n)
    scale = NOISE * (CHANNEL_2 if channel == 1 else 1.0)
    slow = np.empty(n)
    kick = rng.standard_normal(n)
    slow[0] = kick[0]
    gain = np.sqrt(1.0 - AR_PHI**2)
    for i in range(1, n):
        slow[i] = AR_PHI * slow[i - 1] + gain * kick[i]
    white: NDArray[np.float64] = rng.standard_normal(n)
    return scale * (float(np.sqrt(1.0 - AR_SHARE)) * white + float(np.sqrt(AR_SHARE)) * slow)


def folder_name(order: Order, salt: str) -> str:
    """Name of the campaign: a hash that tells nothing without the salt."""
    return hashlib.sha256(f"{salt}|{order}".encode()).hexdigest()[:12]


def make_campaign(order: Order, folder: Path, salt: str) -> dict[str, Any]:
    """Writes one campaign below `folder` and returns its entry of the key.

    The folder's name is a hash of salt and order. ValueError where the order names an unknown kind.
    """
    for name in order.effects:
        if name not in KINDS:
            raise ValueError(f"no disturbance is called {name!r}; known: {', '.join(KINDS)}")
    if order.kind not in ("easy", "hard"):
        raise ValueError(f"kind must be easy or hard, not {order.kind!r}")
    hard = order.kind == "hard"
    rng = np.random.default_rng([order.seed, 7919])
    name = folder_name(order, salt)
    times: NDArray[np.float64] = np.arange(round(order.duration * 1000), dtype=np.float64) * 1e-3
    true = dict(DECLARED)
    k1t = {k: k for _, k, _ in CASES}
    if hard:
        for key, share in HARD_SHARES.items():
            true[key] *= 1.0 + share * rng.standard_normal()
        k1t = {k: k * (1.0 + K1T_SHARE * rng.standard_normal()) for k in k1t}

    offset = 0.5e-3 if hard and order.trigger != "early" else 0.0  # levels refer to a typical late start
    for _ in range(REDRAWS):
        nominal = nominal_draw(rng)
        conditions = [
            Condition(coupled, _constants(true, nominal, k1t[k], degrees), phase=float(i))
            for i, (coupled, (_, k, degrees)) in enumerate((cp, case) for cp in (False, True) for case in CASES)
        ]
        found = [_strong_enough(KINDS[e], order.level, hard, conditions, times, offset, rng) for e in order.effects]
        if all(entry["level_searched"] > 0.7 * order.level for _, entry in found):
            break
    disturbances = [d for d, _ in found]
    entries = [entry for _, entry in found]
    fit = gap_of(conditions, times, disturbances, offset) if disturbances else None

    if fit is None:
        visible = 0.0
    elif hard:
        shares = {**HARD_SHARES, "k1t": K1T_SHARE}
        order_k = sorted(k1t, key=lambda k: k1t[k])
        declared = {**DECLARED, **{f"k1t{i}": k for i, k in enumerate(order_k)}}
        visible = visible_chi2(conditions, times, disturbances, fit, declared, shares, offset, TRIALS)
    else:
        visible = TRIALS * sum(float(r @ r) for r in fit.residuals) / NOISE**2
    late = {"late": True, "early": False}.get(order.trigger, bool(rng.integers(2)))
    home = folder / name
    if home.exists():  # left by a run that was stopped before its entry reached the key
        shutil.rmtree(home)
    (home / "trials").mkdir(parents=True)
    rows = []
    trials = []
    number = 0
    for label, k, degrees in CASES:
        for coupled in (False, True):
            for trial in range(1, TRIALS + 1):
                number += 1
                angle = degrees * (1.0 + ANGLE_SHARE * rng.standard_normal())
                constants = _constants(true, nominal, k1t[k], angle)
                release = 0.0
                if hard:
                    constants["mu"] *= 1.0 + 0.03 * rng.standard_normal()
                    release = round(rng.uniform(0.0, 1e-3) / FINE_STEP) * FINE_STEP * (-1.0 if late else 1.0)
                phase = float(rng.uniform(0.0, 2.0 * np.pi))
                y = record(constants, coupled, times, disturbances, release, phase)
                noisy = np.array([v + noise_draw(rng, v.size, hard, c) for c, v in enumerate(y)])
                noisy = _clip(noisy, disturbances)
                if hard:
                    noisy = QUANTUM * np.round(noisy / QUANTUM)
                file = f"trials/{number:02d}.csv.gz"
                _write_record(home / file, times, noisy, 2 if hard else 1)
                rows.append(
                    (
                        file,
                        label,
                        "coupled" if coupled else "uncoupled",
                        f"{k:g}",
                        *((f"{K1T_SHARE * k:g}",) if hard else ()),
                        f"{degrees:g}",
                        f"{ANGLE_SHARE * degrees:.3g}",
                        str(trial),
                    )
                )
                trials.append(
                    {
                        "file": file,
                        "theta0_rad": constants["theta0"],
                        "mu": constants["mu"],
                        "release_s": release,
                        "phase": phase,
                    }
                )
    _write_toml(home / "campaign.toml", name, hard)
    head = [
        "file",
        "case",
        "configuration",
        "k1t_n_m_per_rad",
        *(["k1t_std_n_m_per_rad"] if hard else []),
        "theta0_deg",
        "theta0_std_deg",
        "trial",
    ]
    (home / "trials.csv").write_text("\n".join(",".join(r) for r in [head, *rows]) + "\n")
    single = order.effects[0] if len(order.effects) == 1 else None
    return {
        "kind": order.kind,
        "effects": list(order.effects),
        "truth": single or ("none" if not order.effects else "pair"),
        "site": entries[0]["site"] if single else ("none" if not entries else [e["site"] for e in entries]),
        "class": entries[0]["class"] if single else None,
        "standing": entries[0]["standing"] if single else None,
        "level_wanted": order.level if entries else 0.0,
        "level": fit.level if fit else 0.0,
        "gap_rms_rad_s2": fit.level * NOISE if fit else 0.0,
        "visible_chi2": visible,
        "disturbances": entries,
        "nominal": nominal,
        "at_rest": at_rest(nominal, disturbances),
        "constants": {**true, "k1t": {f"{k:g}": v for k, v in k1t.items()}},
        "best_nominal": fit.parameters if fit else nominal,
        "trials": trials,
        "seed": order.seed,
        "duration": order.duration,
        "trigger": "late" if late else "early",
    }


def _constants(true: dict[str, float], nominal: dict[str, float], k1t: float, degrees: float) -> dict[str, float]:
    return {**true, **nominal, "k1t": k1t, "theta0": float(np.radians(degrees))}


def _strong_enough(
    kind: Kind,
    level: float,
    hard: bool,
    conditions: list[Condition],
    times: NDArray[np.float64],
    late: float,
    rng: np.random.Generator,
) -> tuple[Disturbance, dict[str, Any]]:
    """A disturbance of that kind with a drawn shape, as strong as the level asks, and its entry of the key."""
    shape = kind.shape(rng)
    sign = float(rng.choice(kind.signs))
    size, reached = amplitude_for(kind, shape, sign, level, conditions, times, late)
    if size == kind.least:  # the wanted level is below what the kind can do: anything near its least
        size *= float(np.exp(rng.uniform(0.0, np.log(4.0))))
    if hard:  # an error is more than its declaration allows
        size = max(size, BEYOND_DECLARED.get(kind.name, 0.0))
    entry = {
        "effect": kind.name,
        "site": kind.site,
        "standing": kind.standing,
        "class": sorted((kind.name, *kind.twins)),
        "amplitude": sign * size,
        "shape": list(shape),
        "unit": kind.unit,
        "meaning": kind.meaning,
        "level_searched": reached,
    }
    return kind.at(sign * size, shape), entry


def _clip(y: NDArray[np.float64], disturbances: list[Disturbance]) -> NDArray[np.float64]:
    """The converter's end stop also holds the noise, where the disturbance says so."""
    for d in disturbances:
        if d.code == codes.SENSOR_CLIPPING and d.p[3] == 1.0:
            limit = FULL_SCALE / d.p[0]
            for c in range(y.shape[0]):
                if int(d.p[1]) in (c, 2):
                    y[c] = np.clip(y[c], -limit, limit)
    return y


def _write_record(path: Path, times: NDArray[np.float64], y: NDArray[np.float64], digits: int) -> None:
    text = io.StringIO()
    text.write("time_s,alpha1_rad_s2" + (",alpha2_rad_s2" if len(y) == 2 else "") + "\n")
    for i, t in enumerate(times):
        text.write(f"{t:.3f}," + ",".join(f"{v:.{digits}f}" for v in y[:, i]) + "\n")
    with path.open("wb") as raw, gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0) as packed:
        packed.write(text.getvalue().encode())


def _write_toml(path: Path, name: str, hard: bool) -> None:
    fields = (("primary_inertia", "J1"), ("secondary_inertia", "J2"), ("bar_radius", "R"), ("magnet_radius", "r"))
    lines = [
        f'name = "{name}"',
        'description = "simulated trials, cause withheld"',
        'source = "data/withheld, independent simulator"',
        "",
        "[rig]",
        'kind = "torsional"',
    ]
    for field, key in fields:
        value = DECLARED[key]
        if hard:
            lines.append(f"{field} = {{ value = {value:g}, std = {HARD_SHARES[key] * value:.4g} }}")
        else:
            lines.append(f"{field} = {value:g}")
    lines += ["magnet_pull = 100.0", "", "[measurement]", 'quantity = "acceleration"', "sample_rate = 1000.0"]
    path.write_text("\n".join(lines) + "\n")
