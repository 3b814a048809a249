"""A campaign from its folder, with records or, as a plan, without."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_damper.campaign.balance import look_at_balance
from bayes_damper.campaign.declarations import frequency_ratios, look_at_declarations, look_at_starts
from bayes_damper.campaign.head import Head, check_rig, per_channel, read_head
from bayes_damper.campaign.magnitudes import check_declared, check_magnitudes
from bayes_damper.campaign.plausibility import look_at_rates, look_at_repeats, look_at_trial, look_for_exchanged_trials
from bayes_damper.campaign.record_files import read_trial
from bayes_damper.campaign.structure import MEASUREMENT_SPREADS, Campaign, Measurement, Trial
from bayes_damper.campaign.trials_table import Row, read_rows
from bayes_damper.errors import InputError
from bayes_damper.rig.units import sentence_of, spoken_of

LOG = logging.getLogger(__name__)
PLANNED_PERIODS = 8.0
"""Natural periods of the slowest case that a planned record lasts where no duration is declared."""


def load_campaign(folder: str | Path) -> Campaign:
    """Reads and checks a campaign.

    Raises
    ------
    InputError
        with one sentence for every fault of every file.
    """
    folder = Path(folder)
    faults: list[str] = []
    digest = hashlib.sha256()
    head, rows = _head_and_rows(folder, faults, digest)
    with spoken_of(head.rig.kind):
        return _loaded(folder, head, rows, faults, digest)


def _loaded(folder: Path, head: Head, rows: Sequence[Row], faults: list[str], digest: hashlib._Hash) -> Campaign:
    """The records of a campaign, read and looked at."""
    trials = tuple(t for row in rows if (t := read_trial(folder, row, head, faults, digest)) is not None)
    check_rig(folder, head.rig, any(row.configuration == "coupled" for row in rows), faults)
    _check_reactions(trials, faults)
    warnings: list[str] = list(head.notes)
    of_records: list[str] = []
    if not head.broken:
        check_declared(head, trials, faults, warnings)
        exchanged = look_for_exchanged_trials(head, trials, warnings)
        known = [t for t in trials if t not in exchanged]
        swings = frequency_ratios(head, known)
        look_at_balance(head, known, swings, faults, warnings)
    for trial in trials:
        if not head.broken:
            check_magnitudes(head, trial, faults, of_records)
            look_at_trial(head, trial, swings.get(trial.case, 1.0), of_records)
    if trials and all(t.holdout for t in trials):
        faults.append(
            "trials.csv: every trial is marked holdout, so nothing is left to fit: mark one of the repeats of each case"
        )
    if faults:
        if rows and not any((folder / row.file).exists() for row in rows):
            faults.append("none of the records is there: `bayes-damper plan` judges a campaign before it is measured")
        raise InputError(faults)
    LOG.info("read %s: %d trials, %d readings", folder, len(trials), sum(t.channels.size for t in trials))
    both, declared = any(t.coupled for t in trials), head.measurement
    spreads = {key: per_channel(getattr(declared, key), both) for key in ("noise_std", *MEASUREMENT_SPREADS)}
    campaign = _campaign(folder, head, replace(declared, **spreads), trials, (), digest)  # type: ignore[arg-type]
    if held := [case for case in campaign.cases if case not in campaign.fitted_cases]:
        warnings.append(f"trials.csv: every trial of case {', '.join(held)} is marked holdout: `fit` leaves it out")
    look_at_declarations(head, known, warnings)
    look_at_starts(head, trials, warnings)
    look_at_repeats(head, trials, warnings)
    look_at_rates(head, trials, of_records)
    # What was written down wrongly first, then what the records show, then what the import assumed.
    said = [sentence_of(warning, head.rig.kind) for warning in (*warnings, *of_records)]
    return replace(campaign, warnings=(*said, *head.caveats))


def _check_reactions(trials: Sequence[Trial], faults: list[str]) -> None:
    """A fault where some trials read a reaction and others a motion: noise and gain of channel 1 are one for all."""
    moved = [t.file for t in trials if t.prescribed]
    if moved and len(moved) < len(trials):
        other = next(t.file for t in trials if not t.prescribed)
        faults.append(
            f"trials.csv: in {moved[0]} the primary's motion is prescribed and its channel reads the reaction, in "
            f"{other} it reads the motion; make a campaign of each, since a campaign has one sensor a channel"
        )


def load_plan(folder: str | Path) -> Campaign:
    """A campaign of which nothing, or only a part, has been measured yet.

    The files that trials.csv names may be missing: such a trial has readings of zero at the sample times that
    [measurement] declares (`sample_rate`, `duration`; by default eight natural periods of the slowest case). Records
    that are there are read and checked as ever.

    Raises
    ------
    InputError
        with one sentence for every fault of every file.
    """
    folder = Path(folder)
    faults: list[str] = []
    digest = hashlib.sha256()
    head, rows = _head_and_rows(folder, faults, digest)
    check_rig(folder, head.rig, any(row.configuration == "coupled" for row in rows), faults)
    missing = [row for row in rows if not (folder / row.file).exists()]
    rate = head.measurement.sample_rate
    if missing and rate is None:
        faults.append("campaign.toml [measurement]: sample_rate is missing; a plan without records needs it, in Hz")
    if faults or head.broken:
        raise InputError(faults)
    planned = []
    slowest = min((row.k1t.value for row in missing), default=1.0)
    period = 2.0 * math.pi * math.sqrt(head.rig.primary_inertia.value / slowest)
    duration = head.measurement.duration or PLANNED_PERIODS * period
    if missing and rate is not None and duration * rate < 16.0:
        raise InputError(
            f"campaign.toml [measurement]: {duration:.3g} s at {rate:g} Hz are fewer than 16 readings; raise "
            "sample_rate or duration"
        )
    for row in rows:
        if row in missing and rate is not None:
            times = np.arange(round(duration * rate) + 1) / rate
            channels = np.zeros((2 if row.configuration == "coupled" else 1, times.size))
            planned.append(
                Trial(row.file, row.case, row.configuration, row.trial, row.k1t, row.theta0, times, channels,
                      holdout=row.holdout, cut=row.cut)
            )  # fmt: skip
            continue
        trial = read_trial(folder, row, head, faults, digest)
        if trial is not None:
            planned.append(trial)
    if faults:
        raise InputError(faults)
    noise = per_channel(head.measurement.noise_std, any(t.coupled for t in planned))
    measurement = replace(head.measurement, noise_std=noise, duration=duration if missing else None)
    return _campaign(folder, head, measurement, planned, (*head.caveats, *head.notes), digest)


def _head_and_rows(folder: Path, faults: list[str], digest: hashlib._Hash) -> tuple[Head, list[Row]]:
    """campaign.toml and trials.csv of a folder; InputError where there is no folder or no head to go on with."""
    if folder.is_file():
        raise InputError(f"{folder}: a file; give the folder that holds it, {folder.parent}")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds campaign.toml")
    head = read_head(folder, faults, digest)
    if head is None:
        raise InputError(faults)
    return head, read_rows(folder, head.rig.kind, head.measurement.start, faults, digest)


def _campaign(
    folder: Path, head: Head, measurement: Measurement, trials: Sequence[Trial], warnings: tuple[str, ...],
    digest: hashlib._Hash,
) -> Campaign:  # fmt: skip
    """The campaign of a folder that has been read."""
    return Campaign(
        head.name, head.rig, measurement, tuple(trials), head.description, head.source, head.caveats, folder, warnings,
        digest.hexdigest(), head.scatter,
    )  # fmt: skip
