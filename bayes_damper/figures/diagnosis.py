"""Figures of a diagnosis: probabilities of the answers, the gap, where it lies, the missing torque."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from bayes_damper.figures.style import COLOURS, RC, STYLES, new_figure, raised
from bayes_damper.rig.units import BODIES
from bayes_damper.runs.contents.diagnosis import CurveEntry, FeatureEntry
from bayes_damper.text import COORDINATES


def ranking_figure(probabilities: Mapping[str, float], sites: Mapping[str, float], *, title: str) -> Figure:
    """Probabilities of the answers (at most twelve) and of the sites, those above 0.5 %; names may have lines."""
    shown = {name: p for name, p in _leading(probabilities, 12).items() if p > 0.005}
    places = {site: p for site, p in sites.items() if p > 0.005}
    rows = max(len(shown), len(places), 3)
    lines = max((name.count("\n") + 1 for name in (*shown, *places)), default=1)
    figure = new_figure(9.0, (0.28 if lines == 1 else 0.17 * lines + 0.1) * rows + 1.2)
    with mpl.rc_context(RC):
        left, right = figure.subplots(1, 2)
        _draw_probabilities(left, shown, rows, "answer")
        _draw_probabilities(right, places, rows, "site")
        figure.suptitle(title)
    return figure


def _leading(probabilities: Mapping[str, float], most: int) -> dict[str, float]:
    """The most probable answers."""
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])
    return {name: probabilities[name] for name in ranked[:most]}


def _draw_probabilities(axis: Any, values: Mapping[str, float], rows: int, heading: str) -> None:
    """Bars, the longest on top; bars of two figures with as many `rows` are equally thick."""
    names = sorted(values, key=lambda name: -values[name])
    heights = [values[name] for name in names]
    axis.barh(range(len(names)), heights, color=COLOURS[0])
    for y, height in enumerate(heights):
        label = "< 0.01" if height < 0.005 else "> 0.99" if 0.995 <= height < 1.0 else f"{height:.2f}"
        axis.text(height + 0.02, y, label, va="center")
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(max(rows, len(names)) - 0.5, -0.5)
    axis.set_xlim(0.0, 1.2)
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("probability")
    axis.set_title(heading, loc="left")


_TITLE = 64  # characters of a title that fit over the records, beside the answers


def gap_figure(record: Mapping[str, Any], probabilities: Mapping[str, float], *, title: str) -> Figure:
    """One record under the nominal model, what is left of it before and after the answer is added, and the answers.

    record : label, unit, times (n,) s, measured, nominal (n,), augmented (n,) or None where there is nothing to add,
    added: name of what is, noise: standard deviation of the readings.
    """
    augmented = record["augmented"]
    rows = ["record", "before"] + (["after"] if augmented is not None else [])
    figure = new_figure(9.0, 1.2 + 1.2 * len(rows))
    dots: dict[str, Any] = {"color": "#9a9a9a", "ms": 2.0, "rasterized": True}
    times, measured, nominal = record["times"], np.asarray(record["measured"]), np.asarray(record["nominal"])
    reading, noise = f"reading [{raised(record['unit'])}]", record["noise"]
    with mpl.rc_context(RC):
        axes = figure.subplot_mosaic([[row, "answers"] for row in rows], width_ratios=[2.6, 1.0])
        axes["record"].plot(times, measured, ".", label="measured", **dots)
        axes["record"].plot(times, nominal, color=COLOURS[0], lw=1.0, label="fitted nominal model")
        axes["record"].set_title(record["label"], loc="left")
        axes["record"].set_ylabel(reading)
        line = "" if augmented is None else "\n" + textwrap.fill(f"line: the change due to {record['added']}", _TITLE)
        axes["before"].set_title(f"measured minus nominal model{line}", loc="left")
        axes["before"].plot(times, measured - nominal, ".", **dots)
        if augmented is not None:
            axes["before"].plot(times, np.asarray(augmented) - nominal, color=COLOURS[1], lw=1.0)
            axes["after"].set_title(textwrap.fill(f"measured minus model with {record['added']}", _TITLE), loc="left")
            axes["after"].plot(times, measured - augmented, ".", **dots)
            axes["after"].sharey(axes["before"])
        for name in rows:
            if name != "record":
                shade: dict[str, Any] = {"color": "#cccccc", "alpha": 0.5, "lw": 0, "zorder": 0}
                band = axes[name].axhspan(-2.0 * noise, 2.0 * noise, label="noise, ± 2 sd", **shade)
                axes[name].set_ylabel(reading)
            axes[name].sharex(axes["record"])
            axes[name].tick_params(labelbottom=name == rows[-1])
        drawn, _ = axes["record"].get_legend_handles_labels()
        figure.legend(handles=[*drawn, band], loc="outside lower left", ncols=3)
        axes[rows[-1]].set_xlabel("time [s]")
        shown = _leading(probabilities, 6)  # of up to three lines each
        likely = {name: p for name, p in shown.items() if p > 0.005} if len(shown) > 3 else shown
        _draw_probabilities(axes["answers"], likely, 6, "what is missing")
        figure.suptitle(title)
    return figure


def residual_maps_figure(maps: Sequence[Mapping[str, Any]], *, title: str) -> Figure:
    """Where residuals exceed the noise: over time, over frequency, and over a plane of the motion.

    maps : one mapping for each column with its title and three panels time, frequency, plane: x and y (edges of the
    cells), values (cells down, cells across), rms residual over noise, nan where there is nothing; labels (of rows, or
    None), x_label, y_label.
    """
    names = ("time", "frequency", "plane")
    rows = max(len(column[name]["values"]) for column in maps for name in names[:2])
    figure = new_figure(3.6 * len(maps) + 0.9, 4.6 + 2.0 * min(0.17 * rows, 2.6))
    known = np.concatenate([column[name]["values"].ravel() for column in maps for name in names])
    known = known[np.isfinite(known)]
    most = max(3.0, float(np.quantile(known, 0.995))) if known.size else 3.0
    shade = mpl.colors.LogNorm(1.0, most)
    with mpl.rc_context(RC | {"axes.grid": False}):
        heights = [min(0.17 * rows, 2.6) + 0.6, min(0.17 * rows, 2.6) + 0.6, 2.6]
        axes = figure.subplots(3, len(maps), squeeze=False, gridspec_kw={"height_ratios": heights})
        for column, places in zip(maps, axes.T, strict=True):
            for axis, name in zip(places, names, strict=True):
                panel = column[name]
                values = np.ma.masked_invalid(np.maximum(panel["values"], 1.0))
                drawn = axis.pcolormesh(panel["x"], panel["y"], values, cmap="Blues", norm=shade, rasterized=True)
                axis.set_xlabel(panel["x_label"])
                axis.set_ylabel(panel["y_label"])
                axis.set_facecolor("#eeeeee")
                if name == "frequency":
                    axis.set_xscale("log")
                    axis.xaxis.set_major_formatter("{x:g}")
                if panel["labels"] is not None:
                    axis.set_yticks(np.arange(len(panel["labels"])) + 0.5, panel["labels"], fontsize=7)
                    axis.invert_yaxis()
            places[0].set_title(column["title"], loc="left")
        bar = figure.colorbar(drawn, ax=axes, shrink=0.5, aspect=30, extend="max")
        bar.set_label("rms residual / noise (1: noise alone)")
        ticks = [x for x in (1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000) if x <= most]
        bar.set_ticks(ticks, labels=[str(x) for x in ticks])
        bar.minorticks_off()
        figure.suptitle(title)
    return figure


def published_figure(rows: Mapping[str, Sequence[FeatureEntry]], *, title: str) -> Figure:
    """Published numbers beside what each answer predicts for them: a panel for each configuration and feature.

    rows : answer -> entries with case, configuration, feature, unit, measured, standard_error, predicted and
    predicted_hdi90, the same numbers in the same order for each answer.
    """
    first = next(iter(rows.values()))
    panels = list(dict.fromkeys((row["feature"], row["configuration"]) for row in first))
    cases = list(dict.fromkeys(row["case"] for row in first))
    figure = new_figure(8.0, 2.3 * ((len(panels) + 1) // 2) + 0.8)
    with mpl.rc_context(RC):
        axes = figure.subplots((len(panels) + 1) // 2, 2, squeeze=False)
        for axis, (feature, configuration) in zip(axes.flat, panels, strict=False):
            width = 0.7 / (len(rows) + 1)
            for k, (name, entries) in enumerate([("measured", first), *rows.items()]):
                some = [r for r in entries if (r["feature"], r["configuration"]) == (feature, configuration)]
                x = [cases.index(r["case"]) + (k - 0.5 * len(rows)) * width for r in some]
                if k == 0:
                    y, spread = [r["measured"] for r in some], [r["standard_error"] for r in some]
                    axis.errorbar(x, y, spread, fmt="s", color="black", ms=4, capsize=2, label=name)
                    continue
                middle = np.array([r["predicted"] for r in some])
                ends = np.array([r["predicted_hdi90"] for r in some])
                reach = np.maximum(np.abs(ends.T - middle), 0.0)
                mark = {"color": COLOURS[(k - 1) % 6], "marker": "o^vDP"[(k - 1) % 5], "ms": 4, "lw": 2.5}
                axis.errorbar(x, middle, reach, ls="none", label=name.replace("_", " "), **mark)
            axis.set_xticks(range(len(cases)), cases)
            unit = first[[r["feature"] for r in first].index(feature)]["unit"]
            axis.set_ylabel(f"{feature.replace('_', ' ')}" + ("" if unit == "1" else f" / {unit}"))
            axis.set_title(configuration, fontsize=9.0)
        axes.flat[0].legend(fontsize=7.0)
        figure.suptitle(title)
    return figure


_LAW_AXES = {
    "angle": ("angle [rad]", "displacement [m]"), "speed": ("velocity [rad/s]", "velocity [m/s]"),
    "time": ("time [s]", "time [s]"),
}  # fmt: skip
"""Axis labels along which a law's terms run: on a torsional rig, and on a translational one."""
_CARRIERS = {"one": "f", "dry": "f, times tanh(nu v)", "angle": "f, times x/max|x|", "speed": "f, times v/max|v|"}


def learnt_law_figure(law: Any, density: Sequence[Any], *, title: str, translational: bool = False) -> Figure:
    """A learnt law: the curve of each term with its 90 % band, and all of it over angle and velocity.

    law : terms (carrier, along), ranges, torque and curve, as effects/_law.py has it; density : readings in cells of
    angle and velocity (n, n), and the edges of the cells (n + 1,), their logarithm in grey below the
    curves.
    """
    count, *edges = (np.asarray(d) for d in density)
    effort = "force [N]" if translational else "torque [N m]"
    figure = new_figure(9.0, 6.0)
    with mpl.rc_context(RC):
        top, bottom = figure.subfigures(2, 1)
        axes = np.atleast_1d(top.subplots(1, len(law.terms)))
        for k, (axis, term) in enumerate(zip(axes, law.terms, strict=True)):
            at, value, sd = law.curve(k)
            axis.plot(at, value, color=COLOURS[k], ls=STYLES[k])
            axis.fill_between(at, value - 1.645 * sd, value + 1.645 * sd, color=COLOURS[k], alpha=0.25, lw=0)
            axis.axhline(0.0, color="0.5", lw=0.6)
            if term.along in ("angle", "speed"):
                along = ("angle", "speed").index(term.along)
                below = axis.twinx()
                seen = np.log1p(count.sum(axis=1 - along))
                below.stairs(seen, edges[along], fill=True, color="0.9")
                below.set_ylim(0.0, 4.0 * seen.max())
                below.set_yticks([])
                axis.set_zorder(below.get_zorder() + 1)
                axis.patch.set_visible(False)
            axis.set_xlabel(_LAW_AXES[term.along][translational])
            axis.set_ylabel(f"{_CARRIERS[term.carrier]}; {effort}" if k else f"{effort}: {_CARRIERS[term.carrier]}")
        whole = bottom.subplots()
        middle = [0.5 * (e[1:] + e[:-1]) for e in edges]
        angle, speed = np.meshgrid(*middle, indexing="ij")
        torque = law.torque(angle.ravel(), speed.ravel(), np.zeros(angle.size))[0].reshape(angle.shape)
        torque = np.where(count > 0, torque, np.nan)
        most = float(np.nanmax(np.abs(torque))) or 1.0
        whole.grid(visible=False)
        whole.patch.set(hatch="////", edgecolor="#c4c4c4", facecolor="white")  # no readings
        drawn = whole.pcolormesh(edges[0], edges[1], torque.T, cmap="PuOr", vmin=-most, vmax=most)
        figure.colorbar(drawn, ax=whole, label=effort)
        if min(torque.shape) > 1:  # signs in grey print: matplotlib draws lines below 0 broken
            levels = most * np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])
            whole.contour(*middle, torque.T, levels, colors="black", linewidths=0.6)
        whole.set_xlabel(_LAW_AXES["angle"][translational])
        whole.set_ylabel(_LAW_AXES["speed"][translational])
        if any(term.along == "time" for term in law.terms):
            whole.set_title("at release", loc="left")
        figure.suptitle(title)
    return figure


def missing_torque_figure(
    torque: Any, curve: Mapping[str, CurveEntry], *, body: int, title: str, record: str = "",
    translational: bool = False,
) -> Figure:  # fmt: skip
    """Missing torque (force) on each inertia over time with its 90 % band, and against the coordinates of its site.

    torque : of one trial, shown as points where it is known to three times its median sd: times (n,), torque and sd
    (2, n) N m, th1, w1, th2, w2, phi, slip (n,); curve : coordinate -> its bins over all trials (centre, torque_n_m,
    sd_n_m), as `SiteMap.curve` gives them; body : the inertia that the curve is of, 0 or 1;
    record : the name of that trial.
    """
    figure = new_figure(9.0, 6.0)
    names = BODIES["translational" if translational else "torsional"]
    effort = "force [N]" if translational else "torque [N m]"
    with mpl.rc_context(RC):
        axes = figure.subplot_mosaic([["time", "time"], ["left", "right"]])
        over_time = axes["time"]
        for k, colour in ((0, COLOURS[0]), (1, COLOURS[1])):
            value, sd = np.asarray(torque.torque[k]), np.asarray(torque.sd[k])
            if not np.any(value):
                continue
            over_time.plot(torque.times, value, color=colour, lw=1.0, ls=STYLES[k], label=f"on {names[k]}")
            over_time.fill_between(torque.times, value - 1.645 * sd, value + 1.645 * sd, color=colour, alpha=0.25, lw=0)
        over_time.set_xlabel("time since release [s]")
        over_time.set_ylabel(effort)
        over_time.set_title(record, loc="left")
        over_time.legend(loc="upper right")
        known = np.asarray(torque.sd[body]) <= 3.0 * float(np.median(torque.sd[body]))
        for axis, (name, bins) in zip((axes["left"], axes["right"]), curve.items(), strict=False):
            points = np.asarray(getattr(torque, name))
            axis.plot(
                points[known], np.asarray(torque.torque[body])[known], ".", ms=1.5, color="0.6", label="the trial above"
            )
            centre, mean, sd = (np.asarray(bins[key]) for key in ("centre", "torque_n_m", "sd_n_m"))
            axis.plot(centre, mean, color=COLOURS[body], ls=STYLES[body], label="mean of all trials")
            axis.fill_between(centre, mean - 1.645 * sd, mean + 1.645 * sd, color=COLOURS[body], alpha=0.25, lw=0)
            symbol, unit = COORDINATES[name][translational]
            axis.set_xlabel(f"{symbol} [{unit}]")
            axis.locator_params(axis="x", nbins=6)
            axis.set_ylabel(f"{effort} on {names[body]}")
        axes["left"].legend(loc="best")
        figure.suptitle(title)
    return figure
