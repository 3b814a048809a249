"""From a pile of logger files (CSV, text, MATLAB) to a campaign folder.

What is done to the raw files stands in one table, `import.toml`, so that it can be repeated and checked: which columns,
which units, where the release lies, which stretches become trials. `import_records` carries it out and ends with
the same check as every command; `init_campaign` makes the table from options.

    name, description, source, caveats, [rig], [measurement]     as in campaign.toml
    [reader]                                                     the keys of READER: defaults for all trials
    [[trials]]                                                   the keys of TRIAL, and any of READER
"""

from __future__ import annotations

import csv
import itertools
import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper import campaign as campaigns
from bayes_damper.campaign import Campaign, Constant, Measurement, Rig, Trial
from bayes_damper.campaign import readings as look
from bayes_damper.campaign.importing import units
from bayes_damper.campaign.importing.clocks import (
    refuse_clocks,
    restarted,
    source_of,
    still,
    times_of,
    unnamed_unit,
    window,
)
from bayes_damper.campaign.importing.guesses import LEAST_KNOWN, file_names
from bayes_damper.campaign.importing.logger_columns import LoggerFile
from bayes_damper.campaign.importing.options import FROM_OPTIONS, TrialOptions, gathered, trials_of
from bayes_damper.campaign.importing.table import NOTHING_RUBS, spec_from_options, spec_text
from bayes_damper.campaign.trials_table import inside
from bayes_damper.errors import InputError, UnitFault
from bayes_damper.inputs import file_bytes, resolved, shown, text_of, toml_file
from bayes_damper.rig.parameters import unit_of as unit_of_parameter
from bayes_damper.rig.units import sentence_of, spoken_of

_NAMED = 12  # files that a sentence names one by one
_PLURAL = {"displacement": "displacements", "velocity": "velocities", "acceleration": "accelerations"}
_REST = 0.05  # share of a record; one that rests for longer began before the release
_IDLE = (
    "{}: the secondary rests throughout. If nothing coupled it to the primary, these trials are uncoupled: say so with "
    "--configuration, --pattern or --sheet."
)
_NO_FRICTION = (
    b"# Written by `bayes-damper init`: no magnet_pull was given, so nothing rubs between the bodies.\nmu = 0.0\n"
)


def import_records(
    spec: str | Path | Mapping[str, Any], folder: str | Path, raw: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Writes the campaign that an import table describes; gives its folder.

    spec : path of an import.toml, or its content as a mapping; raw : folder of the raw files, by default that of the
    table; overwrite : replace the campaign that `folder` holds. A priors.toml beside the table goes along. Nothing is
    written unless the result passes the check of every command.

    Raises
    ------
    InputError
        with one sentence for every fault of the table, of the raw files, or of the campaign that comes out.
    """
    table, name, home = _spec_table(spec)
    beside = home / "priors.toml"
    priors = file_bytes(beside) if not isinstance(spec, Mapping) and beside.exists() else None
    return _write(table, name, Path(folder), Path(raw) if raw is not None else home, priors, overwrite)


def init_campaign(
    folder: str | Path, sources: Sequence[str | Path], overwrite: bool = False, raw: str | Path | None = None,
    **options: object,
) -> Path:  # fmt: skip
    """A commented campaign from logger files, one trial a file; gives its folder, which also gets import.toml.

    sources : the logger's files, in the order of the trials; overwrite : replace the campaign that `folder` holds;
    raw : where the files lie that a sheet names, by default beside the sheet.
    options : any key of READER and TRIAL (for all files alike), of [rig] and of [measurement] of campaign.toml, and
    name, description, source_text (where the data come from). What is not given is assumed and noted as a caveat: an
    inertia of 1 (all per unit inertia), k1t from the strongest frequency, no friction between the bodies (mu = 0 in the
    campaign's priors.toml) where coupled trials come without a magnet_pull.

    Raises
    ------
    InputError
        as `import_records`, and for options that do not exist.
    """
    folder = Path(folder)
    paths = [resolved(s) for s in sources]
    with spoken_of(options.get("kind")):
        spec = spec_from_options(resolved(folder).name, paths, options, None if raw is None else resolved(raw))
    text = spec_text(spec)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        line = text[: error.end].splitlines()[-1]
        raise InputError(f"{line}: holds a byte that is no character; name files and give words in UTF-8") from None
    beside = folder / "priors.toml"
    found = file_bytes(beside) if beside.exists() else None
    priors = _NO_FRICTION if NOTHING_RUBS in spec["caveats"] else None
    _write(spec, FROM_OPTIONS, folder, Path(), priors if found in (None, _NO_FRICTION) else found, overwrite)
    if priors is None and found == _NO_FRICTION:  # of an earlier call that knew no magnet
        beside.unlink()
    (folder / "import.toml").write_text(text, encoding="utf-8")
    return folder


def records_in(folder: str | Path) -> tuple[str, ...]:
    """The records that are there of those that a folder's trials.csv names, whatever else is wrong with it."""
    path = Path(folder) / "trials.csv"
    try:
        rows = list(csv.DictReader(text_of(file_bytes(path), str(path)).splitlines()))
    except (OSError, InputError, csv.Error):
        return ()
    named = dict.fromkeys((row.get("file") or "").strip() for row in rows)
    return tuple(name for name in named if name and (Path(folder) / name).is_file())


def left_over(folder: str | Path, before: Sequence[str]) -> list[str]:
    """A sentence on records of the former campaign of a folder (`records_in` it) that the new one does not name.

    They stay: only their owner knows whether they are to be had elsewhere.
    """
    now = {resolved(Path(folder) / name) for name in records_in(folder)}
    stale = [name for name in before if (Path(folder) / name).is_file() and resolved(Path(folder) / name) not in now]
    if not stale:
        return []
    some = ", ".join(stale[:_NAMED]) + (f" and {len(stale) - _NAMED} more" if len(stale) > _NAMED else "")
    them = "them" if len(stale) > 1 else "it"
    remedy = f"no command reads {them} now, remove {them} or keep {them} elsewhere"
    return [f"{some}: left over from the campaign that was here before; {remedy}"]


def _write(
    table: Mapping[str, Any], name: str, folder: Path, raw: Path, priors: bytes | None, overwrite: bool
) -> Path:  # fmt: skip
    """The campaign of an import table with its priors.toml, if it passes the check of every command."""
    if (folder / "campaign.toml").exists() and not overwrite:
        raise InputError(f"{folder}: holds a campaign already; give another folder, or --overwrite to replace it")
    rig = table.get("rig")
    with spoken_of(rig.get("kind") if isinstance(rig, Mapping) else None):
        built, unnamed = _build(table, name, raw)
    with tempfile.TemporaryDirectory() as scratch:
        draft = campaigns.write_campaign(Path(scratch) / "campaign", built)
        text = (draft / "campaign.toml").read_text(encoding="utf-8")
        note = "# Written by `bayes-damper init`; every key may be edited. SI units.\n"
        (draft / "campaign.toml").write_text(note + text, encoding="utf-8")
        if priors is not None:
            (draft / "priors.toml").write_bytes(priors)
        try:
            campaigns.load_campaign(draft)
        except InputError as error:  # what is wrong with the readings may be what they were taken for
            misread = any(isinstance(fault, UnitFault) for fault in error.faults)
            raise InputError([*error.faults, *(unnamed if misread else ())]) from None
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    return folder


def _spec_table(spec: str | Path | Mapping[str, Any]) -> tuple[Mapping[str, Any], str, Path]:
    if isinstance(spec, Mapping):
        return spec, FROM_OPTIONS, Path()
    path = Path(spec)
    try:
        return toml_file(path, "give an import table"), path.name, path.parent
    except FileNotFoundError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an import table") from None


def _build(table: Mapping[str, Any], name: str, raw: Path) -> tuple[Campaign, list[str]]:
    """The campaign in memory, all conversions done, and those of its caveats that say where no unit is known."""
    faults: list[str] = []
    head_keys = {key: value for key, value in table.items() if key not in ("reader", "trials")}
    head = campaigns.head_from_table(head_keys, name, faults)
    options = trials_of(table, name, faults)
    trials: list[Trial] = []
    contradicted: list[str] = []
    unnamed: list[str] = []
    files: dict[Path, LoggerFile] = {}
    for option in options:
        if not inside(option.file):
            faults.append(f"{option.where}: file = {shown(option.file)} leaves the campaign's folder, or is too long")
            continue
        try:
            trials.append(_trial_from(option, head.rig, head.measurement, raw, files, contradicted, unnamed))
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(gathered(faults))
    trials = _with_estimates(trials, head.rig)
    notes = [note for source in files.values() for note in source.notes if note not in head.caveats]
    measurement = _with_declared_units(head.rig, head.measurement, unnamed)
    if "quantity" in table.get("measurement", {}) and not any(t.given for t in trials):
        unnamed = []
    unnamed = [sentence_of(note, head.rig.kind) for note in gathered(unnamed)]
    hints = [sentence_of(hint, head.rig.kind) for hint in (*_resting(trials, options), *_idle(trials))]
    caveats = [sentence_of(note, head.rig.kind) for note in gathered([*notes, *contradicted])]
    campaign = Campaign(
        head.name, head.rig, measurement, tuple(trials), head.description, head.source,
        (*head.caveats, *caveats, *unnamed, *hints), scatter=head.scatter,
    )  # fmt: skip
    return campaign, unnamed


def _trial_from(
    option: TrialOptions, rig: Rig, measurement: Measurement, raw: Path, files: dict[Path, LoggerFile],
    contradicted: list[str], unnamed: list[str],
) -> Trial:  # fmt: skip
    """One trial in SI units; adds to `contradicted` what its file says otherwise than the options, to `unnamed` a
    sentence where neither says what is read.
    """
    source, where, option = source_of(option, raw, files)
    times = times_of(source, option, where)
    contradicted += unnamed_unit(source, option, times, where)
    places = _places_of(source, option, where)
    channels = units.unwrapped(source.table[:, places].T, option)
    if measurement.quantity == "displacement" and option.wrap is None:
        units.refuse_wraps(source.table[:, places].T, where)
    contradicted += units.other_units(source, places, option.units or (), where)
    # Of a rig released from rest the size of the first peak shows what is read.
    released = measurement.start == "rest" and not option.inputs
    named = option.units is not None or option.motion is not None or all(source.unit(place) for place in places)
    if not named and not released:
        slow = "positions" if rig.kind == "translational" else "angles"
        give = f"for {slow} or speeds give --quantity, and" if measurement.quantity == "acceleration" else "give"
        unnamed.append(
            f"{where}: no unit is named, so the readings were taken as {_PLURAL[measurement.quantity]} in "
            f"{unit_of_parameter('sigma1', rig.kind, measurement.quantity)}; {give} --units where they are not in SI."
        )
    if option.units is None:
        reaction = option.motion is not None
        option = replace(option, units=units.named_units(source, places, rig.kind, measurement.quantity, reaction))
    inputs = units.inputs_of(source, option, rig.kind, where)
    known = np.isfinite(times) & np.isfinite(channels).all(axis=0)
    known &= np.all([np.isfinite(x) for x in inputs.values()], axis=0)
    if np.mean(known) < LEAST_KNOWN:
        missing = 100.0 * (1.0 - np.mean(known))
        raise InputError(
            f"{where}: {missing:.0f} % of the readings in the chosen columns are missing; choose other columns, or "
            "export the file again"
        )
    # A line without a reading becomes a gap of the record, which every command allows for.
    times, channels = times[known], channels[:, known]
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        raise InputError(
            f"{where}: the time does not increase after {times[back[0]]:.9g} s; {restarted(times, int(back[-1]) + 1)}"
        )
    keep, zero = window(times, channels[0], option, measurement, where)
    option = units.with_rest(option, channels[:, times < zero - 1e-9], measurement, where)
    times, channels = np.round(times[keep] - zero, 9), channels[:, keep]
    contradicted += units.swinging_tails(times, channels, option, where)
    channels = units.in_si(channels, option, rig.kind, measurement.quantity, where)
    acting = {key: x[known][keep] for key, x in inputs.items()}
    k1t, theta0 = _stiffness(option), _release_angle(option, rig.kind, measurement.start)
    return Trial(
        option.file, option.case, option.configuration, option.trial, k1t, theta0, times, channels,
        holdout=option.holdout, cut=option.start is not None or option.end is not None, **acting,
    )  # fmt: skip


def _places_of(source: LoggerFile, option: TrialOptions, where: str) -> list[int]:
    """Columns (from 0) of a trial's channels."""
    wanted = option.columns
    if option.configuration not in ("uncoupled", "coupled"):
        raise InputError(
            f"{option.where}: configuration = {option.configuration!r} is none of 'uncoupled' and 'coupled'"
        )
    coupled = option.configuration == "coupled"
    if not wanted:
        raise InputError(
            f"{option.where}: 'columns' is missing; name the channels, the primary first (the file has "
            f"{source.described()})"
        )
    if len(wanted) < 1 + coupled:
        raise InputError(f"{option.where}: a coupled trial needs two columns, primary and secondary; 'columns' has one")
    if len(wanted) > 2:
        raise InputError(
            f"{option.where}: 'columns' names {len(wanted)} channels, {', '.join(map(str, wanted))}; a rig has one, "
            "or when coupled two: the primary's, then the secondary's"
        )
    places = [source.index(c, where) for c in wanted[: 1 + coupled]]
    _check_columns(source, places, option, where)
    return places


def _check_columns(source: LoggerFile, places: Sequence[int], option: TrialOptions, where: str) -> None:
    """InputError where one column (from 0) is named for two things, or a clock for a channel."""
    others = option.inputs if option.time is None else {"time": option.time, **option.inputs}
    named = [*(("columns", i) for i in places), *((key, source.index(c, where)) for key, c in others.items())]
    for (one, i), (other, j) in itertools.combinations(named, 2):
        if i == j:
            twice = "twice in 'columns'" if one == other else f"in both '{one}' and '{other}'"
            raise InputError(f"{option.where}: {source.column(i)} is named {twice}; name each column once")
    refuse_clocks(source, places, option)


def _with_declared_units(rig: Rig, measurement: Measurement, unnamed: Sequence[str]) -> Measurement:
    """The measurement, its units declared where no trial's are `unnamed` and `check` would ask whether they are others.

    Angles that start free are compared with no release, so only their size speaks.
    """
    asked = rig.kind == "torsional" and measurement.start == "free"
    return replace(measurement, units="declared") if asked and not unnamed else measurement


def _stiffness(option: TrialOptions) -> Constant:
    k1t = option.k1t
    if k1t == "estimate":
        return Constant(0.0)
    if isinstance(k1t, str) or not 0.0 < k1t < math.inf:
        raise InputError(f"{option.where}: k1t = {k1t!r} must be a positive number or 'estimate'")
    return Constant(float(k1t), float(option.k1t_std))


def _release_angle(option: TrialOptions, kind: str, start: str) -> Constant | None:
    if start == "free":
        return None
    if option.theta0 is None:
        raise InputError(
            f"{option.where}: theta0 is missing; give it in deg (mm), or set start = 'free' in [measurement]"
        )
    unit = units.DEGREE if kind == "torsional" else 1e-3
    theta0 = float(option.theta0)
    std = float(f"{max(0.1, 0.02 * abs(theta0)):.3g}" if option.theta0_std is None else option.theta0_std)
    return Constant(theta0 * unit, std * unit)


def _with_estimates(trials: list[Trial], rig: Rig) -> list[Trial]:
    """Fills k1t where it was to be estimated (marked by 0): median over the case, standard uncertainty 20 %."""
    filled = []
    for trial in trials:
        if trial.k1t.value > 0.0:
            filled.append(trial)
            continue
        alike = [t for t in trials if t.case == trial.case]
        lines = [look.dominant_frequency(t.times, t.channels[0]) for t in alike]
        k1t = float(f"{rig.primary_inertia.value * (2.0 * math.pi * float(np.median(lines))) ** 2:.3g}")
        if k1t <= 0.0:
            raise InputError(f"{trial.file}: no frequency stands out, so k1t cannot be estimated; give it")
        filled.append(replace(trial, k1t=Constant(k1t, float(f"{0.2 * k1t:.2g}"))))
    return filled


def _resting(trials: Sequence[Trial], options: Sequence[TrialOptions]) -> list[str]:
    """A hint where records taken from their first reading on begin at rest."""
    found = []
    for trial, given in zip(trials, options, strict=True):
        t, y = np.asarray(trial.times), np.asarray(trial.channels[0])
        if given.release == "start" and len(t) > 20:
            rest = look.find_release(t, y) - float(t[0])
            if rest > _REST * float(t[-1] - t[0]):
                found.append((str(trial.file), rest, look.release_option(t, y)))
    if not found:
        return []
    name, rest, option = found[0]
    more = "" if len(found) == 1 else f" (and {len(found) - 1} more)"
    zero = {"find": "the release", "first_peak": "the first peak after the hand"}[option]
    return [f"{name}{more} rests for its first {rest:.2g} s: with --release {option}, t = 0 is {zero}."]


def _idle(trials: Sequence[Trial]) -> list[str]:
    """A hint where the secondary of a coupled trial never moves, as it does where nothing couples it."""
    found = []
    for trial in trials:
        if trial.coupled:
            primary, secondary = (np.asarray(y) for y in trial.channels)
            if not still(primary) and still(secondary):
                found.append(str(trial.file))
    return [_IDLE.format(file_names(found))] if found else []
