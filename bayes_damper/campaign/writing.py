"""A campaign into a folder, and its files as text."""

from __future__ import annotations

import csv
import gzip
import io
import re
from pathlib import Path

from bayes_damper.campaign.structure import (
    INPUTS,
    MEASUREMENT_NUMBERS,
    MEASUREMENT_SPREADS,
    RIG_NUMBERS,
    TO_SI,
    TRIAL_COLUMNS,
    Campaign,
    Constant,
    record_text,
)
from bayes_damper.errors import InputError
from bayes_damper.rig.units import in_words_of

_BOTH = re.compile(r"(kg m\^2|N m/rad|inertia) \((kg|N/m|mass)\)")
COMMENTS = {
    "kind": "torsional (default), or translational (m, kg, N)",
    "primary_inertia": "J1, inertia (mass) of body 1, kg m^2 (kg); 1 if only ratios to it are known",
    "secondary_inertia": "J2, inertia (mass) of body 2, kg m^2 (kg)",
    "bar_radius": "R, distance of the magnets from the axis, m",
    "magnet_radius": "r, radius of a magnet's face, m",
    "magnet_pull": "N0, force that presses the bodies together, N",
    "ground2_stiffness": "k3t, spring from the secondary to ground, N m/rad (N/m)",
    "inertial_coupling": "J12, inertia (mass) that couples the two accelerations, kg m^2 (kg)",
    "inertial_coupling_law": "constant, or cosine: J12 cos(th1 - th2), as of two links",
    "normal_force": "linear: the pull falls with the offset of the faces; or constant",
    "restoring": "linear spring, or pendulum",
    "quantity": "acceleration, velocity or displacement",
    "start": "rest: released at rest from theta0; free: initial angles and velocities are inferred",
    "frame": "frame of the readings if the ground moves: absolute, or ground",
    "input": "measured inputs between samples: linear, or held until the next",
    "units": "declared: the unit of the readings is known, check does not ask whether they are degrees; or assumed",
    "sample_rate": "nominal, Hz; the time column decides",
    "duration": "length of a planned record, s",
    "noise_std": "expected standard deviation of the noise, one per channel",
    "sensor_range": "largest reading of the sensor, one per channel",
    "sensor_bandwidth": "bandwidth of the sensor, Hz, one per channel",
    "every": "fits use every N-th reading; absent: all, unless there are very many",
    "offset_std": "standard uncertainty of the sensor's zero, one per channel, in SI units",
    "scale_std": "relative standard uncertainty of the sensor's scale, one per channel",
    "lag_std": "standard uncertainty of the time of a reading against its time stamp, s, one per channel",
}


def _comment(key: str, kind: str) -> str:
    """What a key of campaign.toml is, in the units of the rig."""
    text = _BOTH.sub(r"\2" if kind == "translational" else r"\1", COMMENTS[key])
    return text if key == "kind" else in_words_of(text, kind)


def write_campaign(folder: str | Path, campaign: Campaign, overwrite: bool = False) -> Path:
    """Writes campaign.toml, trials.csv and the records so that `load_campaign` gives the same campaign back.

    Raises
    ------
    InputError
        if the folder already holds a campaign and `overwrite` is not set.
    """
    folder = Path(folder)
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(campaign_toml(campaign), encoding="utf-8")
    (folder / "trials.csv").write_text(trials_csv(campaign), encoding="utf-8")
    for trial in campaign.trials:
        path = folder / trial.file
        path.parent.mkdir(parents=True, exist_ok=True)
        given = {key: getattr(trial, key) for key in INPUTS}
        text = record_text(trial.times, trial.channels, campaign.rig.kind, campaign.measurement.quantity, given)
        raw = text.encode()
        path.write_bytes(gzip.compress(raw, mtime=0) if trial.file.endswith(".gz") else raw)
    return folder


def campaign_toml(campaign: Campaign) -> str:
    """campaign.toml as text, each key with what it means."""
    lines = [f"name = {_quoted(campaign.name)}"]
    for key in ("description", "source"):
        if getattr(campaign, key):
            lines.append(f"{key} = {_quoted(getattr(campaign, key))}")
    if campaign.caveats:
        lines.append("caveats = [  # warnings that `check` lists and later commands count")
        lines += [*(f"    {_quoted(c)}," for c in campaign.caveats), "]"]
    lines += ["", "[rig]"]
    for key in ("kind", *RIG_NUMBERS, "normal_force", "restoring", "inertial_coupling_law"):
        value = getattr(campaign.rig, key)
        if key == "inertial_coupling_law" and not campaign.rig.inertial_coupling.value:
            continue
        if value is not None and not (key == "bar_radius" and campaign.rig.kind == "translational"):
            lines.append(f"{key} = {toml_value(value)}  # {_comment(key, campaign.rig.kind)}")
    lines += ["", "[measurement]"]
    needless = {"units"} if campaign.measurement.units == "assumed" else set()
    needless |= set() if any(t.given for t in campaign.trials) else {"frame", "input"}
    for key in ("quantity", "start", "units", "frame", "input", *MEASUREMENT_NUMBERS, *MEASUREMENT_SPREADS):
        value = getattr(campaign.measurement, key)
        if value is not None and key not in needless:
            lines.append(f"{key} = {toml_value(value)}  # {_comment(key, campaign.rig.kind)}")
    if campaign.scatter:
        kind = campaign.rig.kind
        lines += ["", "[scatter]"]
        for key, size in campaign.scatter.items():
            angle = key == "theta0"
            name, value = (TRIAL_COLUMNS[kind][2], _declared(size, TO_SI[kind])) if angle else (key, repr(size))
            lines.append(f"{name} = {value}  # standard deviation from trial to trial")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    for mark, name in (("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t")):
        escaped = escaped.replace(mark, name)
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'


def toml_value(value: object) -> str:
    """A value as TOML: a constant that is uncertain as a table, a sequence as an array."""
    if isinstance(value, Constant):
        return toml_value({"value": value.value, "std": value.std} if value.uncertain else value.value)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml_value(part)}" for key, part in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return _quoted(value) if isinstance(value, str) else repr(value)


def trials_csv(campaign: Campaign) -> str:
    """trials.csv as text; columns that no trial needs are left out."""
    kind = campaign.rig.kind
    k1t, k1t_std, theta0, theta0_std = TRIAL_COLUMNS[kind]
    uncertain = any(t.k1t.uncertain for t in campaign.trials)
    marks = [key for key in ("holdout", "cut") if any(getattr(t, key) for t in campaign.trials)]
    rest = campaign.measurement.start == "rest"
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = ["file", "case", "configuration", k1t, *([k1t_std] if uncertain else [])]
    names += [*([theta0, theta0_std] if rest else []), "trial", *marks]
    writer.writerow(names)
    for t in campaign.trials:
        cells = [t.file, t.case, t.configuration, repr(t.k1t.value), *([repr(t.k1t.std)] if uncertain else [])]
        if rest and t.theta0 is not None:
            cells += [_declared(t.theta0.value, TO_SI[kind]), _declared(t.theta0.std, TO_SI[kind])]
        cells += [str(t.trial), *(str(getattr(t, key)).lower() for key in marks)]
        writer.writerow(cells)
    return out.getvalue()


def _declared(value: float, unit: float) -> str:
    """A number in degrees (mm), as short as reads back to the same SI value."""
    scaled = value / unit
    for digits in range(1, 18):
        short = float(f"{scaled:.{digits}g}")
        if short * unit == value:
            return repr(short).removesuffix(".0")
    return repr(scaled)
