"""Figures of the other commands: variability, tuning, thesis, plan, withheld check, bench."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from bayes_damper.figures.style import COLOURS, RC, STYLES, label, new_figure, raised
from bayes_damper.rig.parameters import unit_of
from bayes_damper.rig.units import BODIES, design_in_words
from bayes_damper.runs.contents.plan import PlanFile
from bayes_damper.runs.contents.variability import LINEAR_NAMES, DecompositionEntry, EffectiveEntry, LinearName
from bayes_damper.runs.contents.withheld import Rate, ScoresEntry

_EFFECT = 30  # characters of an effect's title in a line
_SHOWN_HZ = 20.0
"""Up to where frequency responses of the thesis are drawn."""


def work_precision_figure(curves: Mapping[str, Sequence[tuple[float, float]]], *, title: str) -> Figure:
    """Largest error against CPU time of one record; a curve of (microseconds, share of the peak) for each method."""
    figure = new_figure(6.0, 4.0)
    with mpl.rc_context(RC):
        axes = figure.add_subplot()
        for i, (name, points) in enumerate(curves.items()):
            time, error = np.array(points, float).T
            axes.loglog(time, error, marker="os^vD"[i % 5], color=COLOURS[i % 7], linestyle=STYLES[i % 4], label=name)
        axes.axhline(1e-4, color="#888888", linewidth=0.8)
        axes.set_xlabel(label("CPU time of one record", "µs"))
        axes.set_ylabel("largest error, share of the peak")
        axes.set_title(title)
        axes.legend()
    return figure


def variability_figure(
    effective: EffectiveEntry,
    decomposition: Mapping[LinearName, DecompositionEntry],
    *,
    kind: str = "torsional",
    title: str,
    measured: str = "linear fit to the measurements",
    converged: bool = True,
) -> Figure:
    """Effective k2t and c2t against initial energy, and where their scatter over the cases comes from.

    kind : of rig, which decides the units. Above: bands of one and the same rig (median, 90 %), each case with its 90 %
    interval, and the values that linear fits to the measurements gave, in the words of `measured`. Below: shares of the
    scatter, 90 % intervals.
    """
    names = {name: label(name, unit_of(name, kind)) for name in LINEAR_NAMES}
    figure = new_figure(9.0, 6.2, converged)
    with mpl.rc_context(RC):
        axes = figure.subplots(2, 2, height_ratios=[2.4, 1.0])
        for k, (name, axis_label) in enumerate(names.items()):
            upper, lower = axes[0, k], axes[1, k]
            for i, (label_, curve) in enumerate(effective["curves"].items()):
                energy = 1e3 * np.asarray(curve["energy_j"])
                colour = COLOURS[(2, 4, 5)[i % 3]]
                upper.plot(energy, curve[name]["median"], color=colour, ls=STYLES[i % 4], label=f"one rig, {label_}")
                upper.fill_between(energy, curve[name]["low"], curve[name]["high"], color=colour, alpha=0.18, lw=0)
            for i, (case, row) in enumerate(effective["cases"].items()):
                at = 1e3 * row["energy_j"]
                upper.plot([at] * 2, row[name]["hdi90"], color=COLOURS[0], lw=1.6)
                shown = "each case, 90 %" if i == 0 else None
                upper.plot(at, row[name]["median"], "o", color=COLOURS[0], ms=5, label=shown)
                upper.annotate(case, (at, row[name]["median"]), xytext=(4, 4), textcoords="offset points")
                if "measured" in row:
                    shown = measured if i == 0 else None
                    upper.plot(at, row["measured"][name], "D", color=COLOURS[1], ms=5, label=shown)
            upper.set_yscale("log")
            upper.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            upper.yaxis.set_major_formatter("{x:g}")
            upper.yaxis.set_minor_formatter(NullFormatter())
            upper.set_xlabel("initial energy [mJ]")
            upper.set_ylabel(f"effective {axis_label}")
            pieces = {key: row for key, row in decomposition[name].items() if isinstance(row, Mapping)}
            pieces = {key: row["share"] for key, row in pieces.items() if "share" in row}
            for y, share in enumerate(pieces.values()):
                lower.plot(share["hdi90"], [y, y], color=COLOURS[0], lw=2.0)
                lower.plot(share["median"], y, "o", color=COLOURS[1], ms=5)
            lower.set_yticks(range(len(pieces)), [key.replace("_", " ") for key in pieces] if k == 0 else [])
            lower.set_xlim(0.0, 1.0)
            lower.set_ylim(len(pieces) - 0.5, -0.5)
            lower.set_xlabel(f"share of the variance of ln {name} over the cases")
        # Above the axes, where it hides no case; a title of the figure would share its place.
        drawn = axes[0, 0].get_legend_handles_labels()
        figure.legend(*drawn, loc="outside upper center", ncols=5, fontsize=8, title=title, title_fontsize=11)
    return figure


_DESIGNS = ("uncoupled", "present", "design", "best design", "better")
_HUES = dict(zip(_DESIGNS, (COLOURS[6], COLOURS[4], COLOURS[0], COLOURS[1], COLOURS[2]), strict=True))
_LINES = dict(zip(_DESIGNS, ("-", ":", "-.", "--", "none"), strict=True))


def _design_names(result: Mapping[str, Any]) -> dict[str, str]:
    """What the designs of tune.json are called in its figures."""
    kind = str(result.get("kind") or "torsional")
    second = BODIES[kind][1]
    best = raised(design_in_words((result.get("optimum") or {}).get("design", {}), kind))
    own = raised(design_in_words(result["design"], kind))
    return {
        "uncoupled": f"without {second}",
        "present": f"{second} as it is",
        "design": f"your design ({own})" if own else f"{second} as it is",
        "best design": f"best design of the linear model ({best})",
        "better": "another design, better at that " + ("force" if kind == "translational" else "torque"),
    }


def _legend_below(figure: Figure, axes: Iterable[Axes], title: str) -> None:
    """One legend for all panels, below them, and the title."""
    drawn = {name: line for axis in axes for line, name in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(list(drawn.values()), list(drawn), loc="outside lower center", ncols=1, fontsize=8)
    figure.suptitle(title)


def response_figure(result: Mapping[str, Any], *, title: str) -> Figure:
    """Frequency response of the primary without a secondary and with each design: one panel for each way of exciting.

    result : what tune.json holds; bands hold 90 % of the draws.
    """
    panels: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for name, band in result["frequency_response"].items():
        excited, _, design = name.partition(", ")
        panels.setdefault(excited, []).append((design, band))
    names = _design_names(result)
    effort, newton = ("force", "N") if result.get("kind") == "translational" else ("torque", "N m")
    held = {
        f"{row['torque_amplitude_n_m']:g} {newton}"
        for row in result["nonlinear"]
        if row["insertion_loss_db"]["median"] is None
    }
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.6 * columns, 2.7 * rows + 1.0, result.get("converged", True))
    with mpl.rc_context(RC):
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for axis, (excited, bands) in zip(axes, panels.items(), strict=False):
            axis.set_title("linear model" if excited == "linear" else f"nonlinear, {effort} {excited}", loc="left")
            axis.set_yscale("log")
            if excited in held:
                said = "no resonance: dry friction holds the rig,\nor damping leaves no peak"
                axis.text(0.5, 0.5, said, transform=axis.transAxes, ha="center", va="center", color="#555555")
                continue
            for design, band in bands:
                frequency, low, middle, high = (
                    np.array(band[key], float) for key in ("frequency_hz", "q05", "median", "q95")
                )
                axis.plot(frequency, middle, ls=_LINES[design], color=_HUES[design], label=names[design])
                axis.fill_between(frequency, low, high, alpha=0.2, lw=0, color=_HUES[design])
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[: len(panels)]:
            axis.tick_params(labelbottom=True)
        for axis in axes[: len(panels)][-columns:]:
            axis.set_xlabel("frequency [Hz]")
        for axis in axes[::columns]:
            axis.set_ylabel("accelerance [1/kg]" if effort == "force" else "accelerance [1/(kg m²)]")
        _legend_below(figure, list(axes[: len(panels)]), title)
    return figure


def tuning_figure(result: Mapping[str, Any], *, title: str) -> Figure:
    """Insertion loss against the exciting torque, and over the inertia and the radius of the secondary.

    result : what tune.json holds. Bars and bands hold 90 % of the draws; the grey line is the target. Each curve over
    the inertia has all else as in one design, which is the mark on it.
    """
    curves, best = result["curves"], result["optimum"] or {}
    driven = {
        "present": (result.get("present") or {}).get("nonlinear", []),
        "design": result["nonlinear"],
        "best design": best.get("nonlinear", []),
        "better": best.get("better_when_driven", []),
    }
    names = _design_names(result)
    first = bool(result["nonlinear"])
    translational = result.get("kind") == "translational"
    columns = len(curves) + first
    figure = new_figure(3.4 * max(columns, 1) + 0.4, 3.9, result.get("converged", True))
    with mpl.rc_context(RC):
        axes = figure.subplots(1, max(columns, 1), squeeze=False, sharey=True)[0]
        marks: dict[str, Any] = dict(zip(driven, "^osD", strict=True))
        for k, (name, rows) in enumerate(driven.items()):
            finite = [r for r in rows if r["insertion_loss_db"]["median"] is not None]
            x = np.array([r["torque_amplitude_n_m"] for r in finite]) * 1.03 ** (k - 1)
            for at, row in zip(x, finite, strict=True):
                axes[0].plot([at] * 2, row["insertion_loss_db"]["interval90"], color=_HUES[name], lw=1.5)
            y = [r["insertion_loss_db"]["median"] for r in finite]
            if finite:
                axes[0].plot(x, y, color=_HUES[name], ls=_LINES[name], marker=marks[name], ms=4, label=names[name])
        if first:
            axes[0].set_xscale("log")
            ticks = [r["torque_amplitude_n_m"] for r in result["nonlinear"]]
            for row in result["nonlinear"]:
                if row["insertion_loss_db"]["median"] is None:
                    said = {"x": row["torque_amplitude_n_m"], "y": 0.03, "s": "no resonance"}
                    axes[0].text(
                        **said, transform=axes[0].get_xaxis_transform(), rotation=90, ha="center", va="bottom",
                        color="#555555", fontsize=8,
                    )  # fmt: skip
            axes[0].set_xticks(ticks, [f"{x:g}" for x in ticks])
            axes[0].set_xlim(ticks[0] / 1.15, ticks[-1] * 1.15)
            axes[0].minorticks_off()
            axes[0].set_xlabel("exciting force [N]" if translational else "exciting torque [N m]")
            axes[0].set_title("nonlinear rig", loc="left")
        labels = {"J2": ("J2 [kg]", 1.0) if translational else ("J2 [g m²]", 1e3), "R": ("R [mm]", 1e3)}
        for axis, (name, curve) in zip(axes[int(first) :], curves.items(), strict=False):
            words, unit = labels.get(name, (name, 1.0))
            shown = {"design": (curve, curve["design"], result["linear"])}
            if curve.get("of_best_design") is not None:
                shown["best design"] = (curve["of_best_design"], curve["best_design"], best["linear"])
            for design, (drawn, place, found) in shown.items():
                mean, low, high = (np.array(drawn[key], float) for key in ("mean", "q05", "q95"))
                style: dict[str, Any] = {"color": _HUES[design], "ls": _LINES[design]}
                x = unit * np.asarray(drawn["value"])
                axis.plot(x, mean, label=None if first else names[design], **style)
                axis.fill_between(x, low, high, color=_HUES[design], alpha=0.2, lw=0)
                if place is not None and found["insertion_loss_db"]["mean"] is not None:
                    at = unit * place, found["insertion_loss_db"]["mean"]
                    axis.plot(*at, marker=marks[design], color=_HUES[design], ms=6)
            axis.set_xlabel(f"{words}, else as in the marked design")
            axis.set_title("linear model", loc="left")
        for axis in axes:
            axis.axhline(result["target_db"], color="#888888", lw=0.9)
        axes[0].set_ylabel("insertion loss [dB]")
        _legend_below(figure, list(axes), title)
    return figure


def thesis_figure(found: Mapping[str, Any]) -> Figure:
    """The figures of the thesis as its equations and constants give them, a panel each.

    found : name -> thesis.Figure (page, x, y, curves, note, printed).
    """
    columns = 2
    rows = -(-len(found) // columns)
    figure = new_figure(10.0, 2.9 * rows + 0.4)
    with mpl.rc_context(RC):
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (name, curve) in zip(axes, found.items(), strict=False):
            response = "frequency" in curve.x
            for k, (words, (x, y)) in enumerate(curve.curves.items()):
                shown = x <= _SHOWN_HZ if response else np.ones(x.size, dtype=bool)
                axis.plot(
                    *(x[shown], y[shown]), color=COLOURS[k % len(COLOURS)], ls=STYLES[k % len(STYLES)], lw=1.1,
                    label=words,
                )  # fmt: skip
            for k, (words, (x, y)) in enumerate(curve.printed.items()):
                axis.plot(x, y, "x^sD"[k % 4], color="#000000", ms=5, mfc="none", label=f"printed: {words}")
            if response:
                axis.set_yscale("log")
                axis.set_ylim(bottom=max(axis.get_ylim()[0], 1e-3 * axis.get_ylim()[1]))
            axis.set_xlabel(curve.x.replace("(", "[", 1).replace(")", "]", 1))
            axis.set_ylabel(curve.y.replace("(", "[", 1)[::-1].replace(")", "]", 1)[::-1], fontsize=8)
            axis.set_title(f"{name} (p. {curve.page})", loc="left")
            axis.legend(loc="lower right" if curve.printed else "best", fontsize=7)
        for axis in axes[len(found) :]:
            axis.set_visible(False)
        figure.suptitle("The figures of the thesis, recomputed from its equations and constants")
    return figure


def plan_figure(result: PlanFile, *, title: str) -> Figure:
    """What a plan could see and distinguish: chance of each effect to be seen, and nats of each beside each rival.

    result : what plan.json holds. Effects have their plain titles and numbers from the top. The figures in the
    right part are expected nats, left out from 10 on (distinguished); dark cells are pairs that the planned trials
    cannot distinguish.
    """
    names = [row["name"] for row in result["effects"]]
    numbers = range(1, len(names) + 1)
    titles = [row.get("title") or row["name"].replace("_", " ") for row in result["effects"]]
    figure = new_figure(4.8 + 0.3 * len(names), 1.5 + 0.34 * len(names))
    with mpl.rc_context(RC | {"axes.grid": False}):
        left, right = figure.subplots(1, 2, width_ratios=[2.2, 0.3 * len(names)])
        left.barh(range(len(names)), [row["chance"] for row in result["effects"]], color=COLOURS[0])
        said = [f"{fill(title, _EFFECT)}  {n}" for title, n in zip(titles, numbers, strict=True)]
        left.set_yticks(range(len(names)), said, fontsize=8)
        left.set_xlim(0.0, 1.0)
        left.set_ylim(len(names) - 0.5, -0.5)
        left.set_xlabel("share of plausible sizes\nthat would be seen")
        table = np.array([[result["matrix"][a].get(b, np.nan) for b in names] for a in names], float)
        right.imshow(np.clip(table, 0.0, 10.0), cmap="Blues_r", vmin=-4.0, vmax=10.0, aspect="auto")
        for (y, x), nats in np.ndenumerate(table):
            if nats < 10.0:
                right.text(x, y, f"{nats:.0f}", ha="center", va="center", fontsize=7, color="w" if nats < 3.0 else "k")
        right.set_xticks(range(len(names)), [str(n) for n in numbers])
        right.set_yticks([])
        right.set_ylim(len(names) - 0.5, -0.5)
        right.set_xlabel("rival, by its number")
        right.set_title(
            "evidence [nats] that distinguishes a typical\neffect from its rival (empty: 10 or more)", loc="left"
        )
        figure.suptitle(title)
    return figure


def withheld_figure(scores: ScoresEntry, *, rehearsal: bool = False) -> Figure:
    """The check on withheld data: what was taken for what, sites, reliability beside a calibrated twin, strength.

    scores : the entry `scores` of withheld.json. rehearsal : marked across the top.
    """
    answers = sorted({*scores["confusion"], *(n for row in scores["confusion"].values() for n in row)})
    figure = new_figure(11.0, 4.2 + 0.22 * len(answers))
    with mpl.rc_context(RC | {"axes.grid": False}):
        parts = figure.subplot_mosaic("ns;nr;nl", width_ratios=[3, 2])
        _draw_counts(parts["n"], scores["confusion"], "what was taken for what")
        _draw_counts(parts["s"], scores["sites"], "true site and most probable site")
        axis, reliability = parts["r"], scores["reliability"]["all"]
        axis.plot([0, 1], [0, 1], color="#888888", lw=0.8)
        for row in reliability["bins"]:
            at = row["confidence"]
            axis.plot([at, at], row["twin95"], color=COLOURS[5], lw=7, alpha=0.5, solid_capstyle="butt")
            value, low, high = _of_rate(row["right"])
            axis.plot([at, at], [low, high], color=COLOURS[0], lw=1.2)
            axis.plot(at, value, "o", color=COLOURS[1], ms=5)
        axis.set_xlabel("probability of the verdict")
        axis.set_ylabel("share that is right")
        axis.set_title("reliability (bars: calibrated twin, 95 %)", loc="left")
        axis = parts["l"]
        for k, kind in enumerate(sorted({row["kind"] for row in scores["by_level"]})):
            rows = [row for row in scores["by_level"] if row["kind"] == kind]
            levels = [row["level"] * (1.03 if k else 0.97) for row in rows]
            values, lows, highs = np.array([_of_rate(row["accepted_first"]) for row in rows]).T
            reach = np.stack([values - lows, highs - values])
            marks: dict[str, Any] = {"color": COLOURS[k], "ls": STYLES[k % len(STYLES)], "marker": "os"[k % 2], "ms": 4}
            axis.errorbar(levels, values, np.maximum(reach, 0.0), label=kind, **marks)
            axis.legend(loc="lower right")
        levels = sorted({float(row["level"]) for row in scores["by_level"]})
        axis.set_xscale("log")
        axis.set_xticks(levels, [f"{level:g}" for level in levels])
        axis.set_xticks([], minor=True)
        axis.set_ylim(0.0, 1.05)
        axis.set_xlabel("level: gap after the best nominal fit / noise")
        axis.set_ylabel("right answer first")
    if rehearsal:
        warning = "REHEARSAL: the code has changed since these campaigns were sealed"
        figure.suptitle(warning, color="#B00020", weight="bold")
    return figure


def _of_rate(found: Rate) -> tuple[float, float, float]:
    """Value and interval; nan where there is no campaign."""
    value, low, high = (math.nan if x is None else x for x in (found["value"], *found["interval95"]))
    return value, low, high


def _draw_counts(axis: Any, counts: Mapping[str, Mapping[str, int]], title: str) -> None:
    """Counts, shaded by the share of their row: rows true, those that were answered first; columns answered."""
    axis.set_title(title, loc="left")
    if not counts:
        axis.text(0.5, 0.5, "no campaign with a single cause", ha="center", va="center", transform=axis.transAxes)
        axis.set_axis_off()
        return
    given = {name for row in counts.values() for name in row}
    rows = sorted(counts, key=lambda name: name not in given)
    columns = [*(name for name in rows if name in given), *sorted(given - set(rows))]
    table = np.array([[counts[row].get(column, 0) for column in columns] for row in rows], float)
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.4, aspect="auto")
    for (y, x), count in np.ndenumerate(table):
        if count:
            dark = share[y, x] > 0.8
            axis.text(x, y, f"{count:.0f}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axis.set_xlabel("answer")
    axis.set_ylabel("truth")
    axis.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axis.set_yticks(range(len(rows)), rows, fontsize=7)
