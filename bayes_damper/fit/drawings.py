"""Figures of a fit: each case, its records, and the cases beside each other."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_damper import figures
from bayes_damper.calibration import Experiment
from bayes_damper.calibration.experiment import trial_label
from bayes_damper.fit.entry import Units, thinned_draws
from bayes_damper.rig.parameters import OF_EFFECT, PARAMETERS, unit_of
from bayes_damper.runs.contents.fit import CaseEntry, FitFile, ParameterEntry
from bayes_damper.sampling import Sampling, arviz_adapter
from bayes_damper.sampling.prior_sensitivity import decided_by

Array = NDArray[np.float64]
_TRACED = 2  # of the kept draws, every so many
_CROWDED = 7  # panels each way of a corner figure; beyond, those that say nothing of their own are left out
_MAIN = ("k1t", "mu", "k2t", "c2t", "drag", "nu", "tail", "c1t", "c3t", "friction_torque", "sigma1", "sigma2")
_OVERLAID = 6  # panels each way of the figure of all cases


def _shown(names: Collection[str]) -> list[str]:
    """Parameters that the figures show, those of an effect first."""
    main = [name for main in _MAIN for name in names if name.partition("[")[0] == main]
    return [name for name in names if name.startswith(OF_EFFECT)] + main


def _axis_labels(units: Mapping[str, str]) -> dict[str, str]:
    """Labels from units by parameter."""
    named = {n: PARAMETERS[n].symbol if n.startswith("friction") else n.removeprefix(OF_EFFECT) for n in units}
    return {name: figures.label(named[name], unit) for name, unit in units.items()}


def draw_case(
    folder: Path,
    title: str,
    draws: Mapping[str, Array],
    sampling: Sampling,
    entry: CaseEntry,
    assumed: Mapping[str, Array],
    units: Units = unit_of,
) -> None:
    """Figures of one case: its entry of summary.json is what they show, `assumed` draws of the priors."""
    thinned = thinned_draws(draws, sampling)
    names = _shown(thinned)
    labels = _axis_labels({name: units(name) for name in draws})
    beside = {"friction_torque", "sigma1", "sigma2"} & set(names) if len(names) > _CROWDED else set()
    flat = {name: thinned[name].ravel() for name in names if name not in beside}
    converged = sampling.converged
    intervals = {name: _interval_of(entry["parameters"][name]) for name in flat}
    figure = figures.corner_figure(
        {title: flat}, labels, title=title, converged=converged, intervals=intervals, assumed=assumed
    )
    figures.save(figure, folder / "corner")
    trace = {name: value[:, ::_TRACED] for name, value in thinned.items() if value.std() > 0.0}
    figures.save(figures.trace_figure(trace, labels, title=title, converged=converged), folder / "trace")
    if checks := entry.get("predictive"):
        figures.save(figures.feature_check_figure(checks, title=title, converged=converged), folder / "predictive")


def _interval_of(numbers: ParameterEntry) -> tuple[float, float, float]:
    """Low end, median and high end of a parameter's entry."""
    return numbers["hdi90"][0], numbers["median"], numbers["hdi90"][1]


def draw_overview(folder: Path, summary: FitFile) -> None:
    """Figures that cover all cases: the forest, and their posteriors laid over one another."""
    cases = summary["cases"]
    first, *others = (entry["parameters"] for entry in cases.values())
    names = [name for name in _shown(first) if all(name in other for other in others)]
    groups = dict(cases) | ({"all": summary["joint"]} if summary.get("joint") else {})
    intervals = {
        name: {
            group: _interval_of(p)
            for group, entry in groups.items()
            if (p := entry["parameters"].get(name)) is not None
        }
        for name in names
    }
    assumed = {
        name: [g for g in of if decided_by(groups[g]["parameters"][name].get("prior_share") or 0.0) == "prior"]
        for name, of in intervals.items()
    }
    halves = {
        name: {group: (q[0], q[1]) for group in of if (q := groups[group]["parameters"][name].get("quartiles"))}
        for name, of in intervals.items()
    }
    title = f"{summary['campaign']}: median, middle half and 90 % interval of each case"
    shown = {name: next(iter(cases.values()))["parameters"][name]["unit"] for name in names}
    figure = figures.forest_figure(
        intervals, _axis_labels(shown), title=title, converged=summary["converged"], assumed=assumed, quartiles=halves
    )
    figures.save(figure, folder / "forest")
    if len(cases) > 1:
        draw_overlaid(folder, cases, names, _axis_labels(shown), summary)
    rows = [row for entry in cases.values() for row in entry.get("predictive", [])]
    if rows:
        title = f"{summary['campaign']}: what was measured, and what the fitted model gives"
        figure = figures.feature_check_figure(rows, title=title, converged=summary["converged"])
        figures.save(figure, folder / "predictive")


def draw_overlaid(
    folder: Path, cases: Mapping[str, CaseEntry], names: Sequence[str], labels: Mapping[str, str], summary: FitFile
) -> None:
    """Corner figure of all cases over each other, of the parameters that the data say most about."""
    shares = {n: min(e["parameters"][n].get("prior_share") or 0.0 for e in cases.values()) for n in names}
    chosen = [n for n in names if n in sorted(names, key=lambda n: shares[n])[:_OVERLAID]]
    posterior = arviz_adapter.read(folder / "posterior.nc")["posterior"]
    chosen = [n for n in chosen if n in posterior and "case" in posterior[n].dims]
    if not chosen:
        return
    draws = {f"case {case}": {n: np.asarray(posterior[n].sel(case=case)).ravel() for n in chosen} for case in cases}
    known = {case: {n: x[np.isfinite(x)] for n, x in values.items()} for case, values in draws.items()}
    title = f"{summary['campaign']}: all cases"
    figure = figures.corner_figure(known, labels, title=title, converged=summary["converged"])
    figures.save(figure, folder / "corner")


def draw_records(
    folder: Path, experiment: Experiment, bands: Mapping[int, Array], converged: bool, unit: str, most: int = 4
) -> None:
    """The first trial of each configuration (at most `most`) under the band of the posterior."""
    shown: dict[tuple[str, bool], int] = {}
    for i in bands:
        trial = experiment.trials[i]
        shown.setdefault((trial.case, trial.coupled), i)
    rows = []
    for i in list(shown.values())[:most]:
        low, middle, high = np.nanquantile(bands[i], [0.05, 0.5, 0.95], axis=0)
        trial = experiment.trials[i]
        rows.append(
            {
                "label": trial_label(trial),
                "times": trial.times,
                "measured": trial.y,
                "low": low,
                "median": middle,
                "high": high,
            }
        )
    figure = figures.record_figure(rows, unit, title="measured records and the fitted model", converged=converged)
    figures.save(figure, folder / "records")
