"""Data of the interactive charts, packed small: series as 16-bit integers between their extremes, in base64.

A chart holds views, one shown at a time; a view has one x axis and panels below each other; a panel has series of the
kinds points, line and band. `pack` says how numbers travel; templates/report.js unpacks and draws them.
"""

from __future__ import annotations

import base64
import csv
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_damper.campaign import load_campaign
from bayes_damper.errors import InputError
from bayes_damper.report.parts import Chart
from bayes_damper.rig.units import BODIES
from bayes_damper.sampling import arviz_adapter
from bayes_damper.text import COORDINATES

Array = NDArray[np.float64]
MOST_POINTS = 2500
MOST_VIEWS = 24
_MISSING = -32768


def pack(values: ArrayLike) -> dict[str, Any]:
    """Numbers (n,) as 16-bit steps between lowest and highest; missing ones stay missing."""
    x = np.asarray(values, dtype=np.float64).ravel()
    known = np.isfinite(x)
    low, high = (float(x[known].min()), float(x[known].max())) if known.any() else (0.0, 0.0)
    scale = (high - low) / 65534.0 or 1.0
    steps = np.full(x.size, _MISSING, dtype="<i2")
    steps[known] = np.round((x[known] - low) / scale - 32767.0).astype("<i2")
    return {"low": low, "scale": scale, "data": base64.b64encode(steps.tobytes()).decode("ascii")}


def series(name: str, kind: str, colour: int, **values: ArrayLike) -> dict[str, Any]:
    """One series: values are y, or low and high for a band; x where it has an axis of its own."""
    return {"name": name, "kind": kind, "colour": colour} | {key: pack(v) for key, v in values.items()}


def record_chart(file: Path, unit: str = "") -> Chart | None:
    """Records of the trials in a posterior.nc under their posterior band, with residuals; None where it holds none.

    unit : of the readings, as summary.json gives it; "" for one that does not.
    """
    observed, predicted, times, attributes = _trials_of(file)
    shared = [label for label in observed if label in predicted and predicted[label].ndim >= 3]
    if not shared:
        return None
    clock, shown = _clock(attributes)
    shown = (unit or shown).replace("^2", "²") or "SI"
    bodies = BODIES["translational" if shown.startswith("m") else "torsional"]
    views = []
    for label in shared[:MOST_VIEWS]:
        y, model = np.atleast_2d(observed[label]), predicted[label]
        model = model.reshape(-1, *model.shape[-2:])
        if model.shape[1:] != y.shape:
            continue
        t = times.get(label, clock.get(_plain(label)))
        x, x_name = (np.arange(y.shape[1]), "reading number") if t is None or len(t) != y.shape[1] else (t, "time [s]")
        low, middle, high = np.nanquantile(model, [0.05, 0.5, 0.95], axis=0)
        every = -(-y.shape[1] // MOST_POINTS)
        keep = slice(None, None, every)
        panels = []
        for c in range(y.shape[0]):
            panels.append({
                "y": f"{bodies[c].removeprefix('the ')} [{shown}]",
                "height": 2,
                "series": [
                    series("model, 90 %", "band", 0, low=low[c, keep], high=high[c, keep]),
                    series("model, median", "line", 0, y=middle[c, keep]),
                    series("measured", "points", 6, y=y[c, keep]),
                ],
            })  # fmt: skip
            panels.append({
                "y": f"residual [{shown}]",
                "height": 1,
                "series": [series("measured - median", "points", 1, y=(y - middle)[c, keep])],
            })  # fmt: skip
        note = f" (one reading in {every})" if every > 1 else ""
        views.append({"label": label + note, "x": x_name, "at": pack(x[keep]), "panels": panels})
    if not views:
        return None
    left = f" The first {len(views)} of {len(shared)} trials." if len(shared) > len(views) else ""
    return Chart(
        "Measured records under the fitted model",
        "For the chosen trial: measured readings, median and 90 % band of the model without noise, and the "
        f"residuals of each channel.{left}",
        {"views": views},
    )


def _trials_of(file: Path) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array], Mapping[str, Any]]:
    with arviz_adapter.opened(file) as root:
        groups = [
            {} if name not in root.groups else dict(_variables(root[name]))
            for name in ("observed_data", "posterior_predictive", "constant_data")
        ]
        attributes = {key: root.attrs[key] for key in root.attrs}
    times = {name.removeprefix("times/").removeprefix("time/"): x for name, x in groups[2].items()}
    return groups[0], groups[1], times, attributes


def _variables(group: Any, prefix: str = "") -> Sequence[tuple[str, Array]]:
    """Variables of a group and of those below it (a label with a slash makes one), coordinates left out."""
    found = [
        (f"{prefix}{name}", np.asarray(variable[...], dtype=np.float64))
        for name, variable in group.variables.items()
        if name not in group.dimensions and np.issubdtype(variable.dtype, np.number)
    ]
    for name, below in group.groups.items():
        found += _variables(below, f"{prefix}{name}/")
    return found


def _clock(attributes: Mapping[str, Any]) -> tuple[dict[str, Array], str]:
    """Sample times of the campaign's records and the unit of a reading, as long as the campaign is where it was."""
    try:
        plan = json.loads(attributes["plan"])
        campaign = load_campaign(plan["campaign"])
    except (KeyError, TypeError, ValueError, OSError, InputError):
        return {}, ""
    if campaign.sha256 != plan.get("campaign_sha256"):
        return {}, ""
    clock = {_plain(name): np.asarray(t.times) for t in campaign.trials for name in (str(t.file), t.label)}
    return clock, campaign.reading_unit


def _plain(label: str) -> str:
    """A trial's name without the marks that files of draws cannot have in names."""
    return re.sub(r"[^A-Za-z0-9]+", " ", label.removesuffix(".gz").removesuffix(".csv")).strip()


def response_chart(
    responses: Mapping[str, Mapping[str, Sequence[float]]], *, translational: bool = False
) -> Chart | None:
    """Frequency responses of tune.json, one view for each way of exciting."""
    effort, unit = ("force", "1/kg") if translational else ("torque", "1/(kg m²)")
    first, second = BODIES["translational" if translational else "torsional"]
    views: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for name, band in responses.items():
        excited, _, design = name.partition(", ")
        views.setdefault(excited, []).append((design or name, band))
    out = []
    for excited, bands in views.items():
        drawn = []
        for i, (design, band) in enumerate(bands):
            x = np.asarray(band["frequency_hz"], dtype=np.float64)
            q05, median, q95 = (np.asarray(band[k], dtype=np.float64) for k in ("q05", "median", "q95"))
            with np.errstate(invalid="ignore", divide="ignore"):
                decibels = [np.where(v > 0.0, 20.0 * np.log10(v), np.nan) for v in (q05, median, q95)]
            drawn.append(series(f"{design}, 90 %", "band", i, x=x, low=decibels[0], high=decibels[2]))
            drawn.append(series(f"{design}, median", "line", i, x=x, y=decibels[1]))
        at = np.asarray(bands[0][1]["frequency_hz"], dtype=np.float64)
        label = "linear model" if excited == "linear" else f"nonlinear model, {effort} {excited}"
        panel = {"y": f"accelerance [dB re {unit}]", "height": 3, "series": drawn}
        out.append({"label": label, "x": "frequency [Hz]", "at": pack(at), "panels": [panel]})
    if not out:
        return None
    text = f"Median and 90 % band of {first}'s acceleration per {effort}, without {second} and with each design."
    return Chart(f"Frequency response of {first}", text, {"views": out})


def torque_chart(file: Path, *, translational: bool = False, accelerations: bool = False) -> Chart | None:
    """The missing torque (force) that a diagnosis wrote as CSV, against time and motion; None if there is none."""
    opener = gzip.open if file.suffix == ".gz" else open
    with opener(file, "rt", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    needed = {"time_s", "torque1_n_m", "torque1_sd_n_m"}
    if not rows or not needed <= set(rows[0]):
        return None
    trials: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        head = f"{row.get('case', '')} {row.get('configuration', '')} #{row.get('trial', '')}"
        trials.setdefault(head.strip(), []).append(row)
    views: list[dict[str, Any]] = []
    bodies = BODIES["translational" if translational else "torsional"]
    for label, part in trials.items():
        if len(views) + 3 > MOST_VIEWS:
            break
        every = -(-len(part) // MOST_POINTS)
        column = {
            k: np.array([_float(r.get(k)) for r in part[::every]]) for k in part[0] if k.endswith(("_s", "_rad", "_m"))
        }
        axes = {"time_s": "time [s]"} | _coordinates(column, translational)
        for axis, name in axes.items():
            if axis not in column or not np.isfinite(column[axis]).any():
                continue
            kind = "line" if axis == "time_s" else "points"
            panels = []
            for i, who in enumerate(bodies, start=1):
                torque, sd = column.get(f"torque{i}_n_m"), column.get(f"torque{i}_sd_n_m")
                if torque is None or sd is None or not np.any(np.nan_to_num(torque)):
                    continue
                drawn = [series("estimate", kind, i - 1, y=torque)]
                if kind == "line":
                    band = series("90 % band", "band", i - 1, low=torque - 1.64 * sd, high=torque + 1.64 * sd)
                    drawn.insert(0, band)
                panels.append({"y": f"on {who} [{'N' if translational else 'N m'}]", "height": 2, "series": drawn})
            if panels:
                view = {"label": f"{label}, against {name}", "x": name, "at": pack(column[axis]), "panels": panels}
                views.append(view)
    if not views:
        return None
    effort = "force" if translational else "torque"
    text = f"The additional {effort} that the nominal model would need to follow the records, with a 90 % band."
    if accelerations:
        text += (
            f" Accelerations hardly show a {effort} that changes more slowly than the rig swings: ignore slow trends."
        )
    return Chart(f"Missing {effort}", text, {"views": views})


def _coordinates(column: dict[str, Array], translational: bool) -> dict[str, str]:
    """Coordinates of the torque's site, column -> label: between the bodies, of the secondary alone, or of the primary.

    The differences between the bodies are added to the columns where they are asked for.
    """
    first, second = (np.nan_to_num(column.get(f"torque{i}_n_m", np.zeros(1))) for i in (1, 2))
    names, keys = ("th1", "w1"), ("theta1_rad", "omega1_rad_s")
    shown = second.any() and {"theta2_rad", "omega2_rad_s"} <= column.keys()
    if shown and first.shape == second.shape and np.allclose(first, -second, rtol=1e-3, atol=1e-9):
        names, keys = ("phi", "slip"), ("phi_rad", "slip_rad_s")
        column["phi_rad"] = column["theta1_rad"] - column["theta2_rad"]
        column["slip_rad_s"] = column["omega1_rad_s"] - column["omega2_rad_s"]
    elif shown and not first.any():
        names, keys = ("th2", "w2"), ("theta2_rad", "omega2_rad_s")
    known = (COORDINATES[name][translational] for name in names)
    return {key: f"{symbol} [{unit}]" for key, (symbol, unit) in zip(keys, known, strict=True)}


def _float(text: str | None) -> float:
    try:
        return float(text) if text else float("nan")
    except ValueError:
        return float("nan")
