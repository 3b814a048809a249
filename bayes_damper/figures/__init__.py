"""Every figure: numbers in, matplotlib figures out. The only module that imports matplotlib and corner.

Figures are made for reports: readable in grey print and for colour-blind eyes (the palette of Okabe and Ito, with line
styles and markers that differ too), every axis with symbol and unit. Nothing is computed here but what drawing needs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import corner
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from bayes_damper.numerals import interval, number
from bayes_damper.rig.parameters import unit_of
from bayes_damper.runs.execution import whole
from bayes_damper.text import COORDINATES

mpl.use("Agg", force=False)

Array = NDArray[np.float64]
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", "--", "-.", ":")
_RC = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "bayes_damper",
    "figure.dpi": 110,
}
_LOGARITHMIC = ("nu",)
"""Parameters that may be known to a factor at best: their axes are logarithmic where a factor of 10 is seen."""
_SHOWN_HZ = 20.0
"""Up to where frequency responses of the thesis are drawn."""
NOT_CONVERGED = "NOT CONVERGED: do not use these numbers"


def new_figure(width: float = 7.0, height: float = 4.0, converged: bool = True) -> Figure:
    """An empty figure in the house style, width and height in inches, marked when its run did not converge."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height), layout="constrained")
    if not converged:
        mark(figure)
    return figure


def _plain_figure(width: float, height: float, converged: bool) -> Figure:
    """The same for drawings that know their margins: laying a figure out takes as long as drawing it."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height))
    if not converged:
        mark(figure)
    return figure


def mark(figure: Figure) -> None:
    """Write across a figure that its run did not converge: below what is drawn where there is a layout, else above."""
    engine = figure.get_layout_engine()
    if engine is not None:
        strip = 0.28 / figure.get_figheight()
        engine.set(rect=(0.0, strip, 1.0, 1.0 - strip))  # type: ignore[call-arg]
    figure.text(
        *(0.5, 0.995 if engine is None else 0.005, NOT_CONVERGED),
        ha="center",
        va="top" if engine is None else "bottom",
        color="white",
        weight="bold",
        bbox={"facecolor": "#B00020", "edgecolor": "none", "pad": 3.0},
        zorder=100,
    )


def save(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as SVG and PNG beside each other, each whole or not at all; `path` without its suffix.

    The files written.
    """
    written = []
    with mpl.rc_context(_RC):
        for kind, options in (
            ("svg", {"metadata": {"Date": None}}),
            ("png", {"dpi": 150, "pil_kwargs": {"compress_level": 3}}),
        ):
            target = path.with_name(f"{path.name}.{kind}")
            with whole(target) as partial:
                figure.savefig(partial, format=kind, **options)
            figure.set_layout_engine("none")  # laid out once: the second time would be as slow
            written.append(target)
    return written


def label(symbol: str, unit: str) -> str:
    """Axis label: symbol and unit, the unit left out where it is 1."""
    return symbol if unit in ("", "1") else f"{symbol} [{raised(unit)}]"


def raised(unit: str) -> str:
    """A unit with its squares as people write them: rad/s² for rad/s^2."""
    return unit.replace("^2", "²").replace("^3", "³")


def corner_figure(
    draws: Mapping[str, Mapping[str, Array]], labels: Mapping[str, str], *, title: str, converged: bool = True,
    told: Mapping[str, tuple[float, float, float]] = MappingProxyType({}),
    assumed: Mapping[str, Array] = MappingProxyType({}),
) -> Figure:  # fmt: skip
    """Corner plot of one posterior, or of several overlaid. The contours hold 50 and 90 % of the draws.

    draws : group (e.g. case) -> parameter -> (n_draws,); all groups have the same parameters.
    labels : parameter -> axis label.
    told : parameter -> (low, median, high) of its interval, dashed in its own panel and written above it.
    assumed : parameter -> draws of its prior, (n,); a grey line to the scale of the posterior.
    """
    names = list(next(iter(draws.values())))
    stacked = {group: np.column_stack([values[name] for name in names]) for group, values in draws.items()}
    everything = np.concatenate(list(stacked.values()))
    single = len(draws) == 1
    low, high = np.quantile(everything, [0.002, 0.998] if single else [0.002, 0.985], axis=0)
    span = np.where(high > low, high - low, np.maximum(np.abs(high), 1e-12) * 1e-3)
    ranges = np.stack([low - 0.03 * span, high + 0.03 * span], axis=1)
    wide = np.array([name in _LOGARITHMIC for name in names]) & (everything.min(axis=0) > 0.0) & (high > 10.0 * low)
    ranges[wide] = np.stack([0.9 * low[wide], 1.1 * high[wide]], axis=1)
    with mpl.rc_context(_RC | {"axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}):
        figure = Figure(figsize=(1.35 * len(names) + 0.8,) * 2)
        for k, table in enumerate(stacked.values()):
            colour = COLOURS[k % len(COLOURS)]
            corner.corner(
                *(table,),
                fig=figure,
                range=[tuple(ends) for ends in ranges],
                axes_scale=["log" if x else "linear" for x in wide],
                bins=_BINS,
                smooth=1.0,
                smooth1d=1.0,
                labels=[labels.get(name, name) for name in names],
                label_kwargs={"fontsize": 9},
                labelpad=0.22,
                color=colour,
                levels=(0.5, 0.9),
                plot_datapoints=False,
                plot_density=single,
                fill_contours=single,
                max_n_ticks=3,
                weights=np.full(len(table), 1.0 / len(table)),
                hist_kwargs={"linestyle": STYLES[k % len(STYLES)]},
                contour_kwargs={"linestyles": STYLES[k % len(STYLES)]},
            )
        if not single:  # each group was drawn to its own height
            kinds = [
                Line2D([], [], color=COLOURS[k % len(COLOURS)], linestyle=STYLES[k % len(STYLES)], label=group)
                for k, group in enumerate(stacked)
            ]
            figure.legend(handles=kinds, loc="upper right", bbox_to_anchor=(0.99, 0.96), fontsize=11, handlelength=3.0)
            for axis in figure.axes[:: len(names) + 1]:
                drawn = [np.asarray(line.get_ydata(), float) for line in axis.lines]
                tops = [float(np.max(y)) for y in drawn if y.size > 2]
                axis.set_ylim(0.0, 1.05 * max(tops, default=1.0))
        _keep_numbers_apart(figure)
        for axis, name, ends in zip(figure.axes[:: len(names) + 1], names, ranges, strict=True):
            _tell_of_one(axis, ends, told.get(name), assumed.get(name))
        margin = 1.05 / figure.get_figwidth()  # room for the labels beside the slanted numbers
        above = (0.45 if told else 0.15) / figure.get_figheight()
        figure.subplots_adjust(left=margin, bottom=margin, top=1.0 - above)
        figure.suptitle(title, x=0.98 if single else 0.75, y=0.99, ha="right", va="top", fontsize=12)
    if not converged:
        mark(figure)
    return figure


_BINS = 30
"""Bars of a histogram in a corner figure."""


def _keep_numbers_apart(figure: Figure) -> None:
    """No number at the very end of an axis of a corner figure, where it would run into that of the next panel."""
    for axis in figure.axes:
        for line in (axis.xaxis, axis.yaxis):
            locator = line.get_major_locator()
            if not isinstance(locator, MaxNLocator):
                continue
            low, high = sorted(map(float, line.get_view_interval()))
            inside = [x for x in locator.tick_values(low, high) if 0.1 < (x - low) / (high - low) < 0.9]
            if len(inside) > 1:
                line.set_major_locator(FixedLocator(inside))


def _tell_of_one(axis: Axes, ends: Array, told: tuple[float, float, float] | None, assumed: Array | None) -> None:
    """In the panel of a parameter by itself: its prior in grey, its interval dashed and in numbers."""
    logarithmic = axis.get_xscale() == "log"
    edges = (np.geomspace if logarithmic else np.linspace)(float(ends[0]), float(ends[1]), _BINS + 1)
    if assumed is not None:
        # Both are shares of draws in each bar, so that the lines compare as they stand.
        heights = gaussian_filter(np.histogram(assumed, edges)[0] / assumed.size, 1.0)
        middles = np.sqrt(edges[:-1] * edges[1:]) if logarithmic else 0.5 * (edges[:-1] + edges[1:])
        axis.plot(middles, heights, color="#888888", lw=1.2, label="prior")
        axis.set_ylim(0.0, max(axis.get_ylim()[1], 1.1 * float(heights.max())))
    if told is not None:
        low, median, high = told
        for x in told:
            axis.axvline(x, ls="--", lw=0.9, color=COLOURS[0])
        axis.set_title(f"{number(median, high - low)}\n({interval(low, high)})", fontsize=8)


def trace_figure(
    draws: Mapping[str, Array], labels: Mapping[str, str], *, title: str, burn_in: int = 0, converged: bool = True
) -> Figure:
    """Trace and rank plot of each parameter.

    draws : parameter -> (ensembles, draws). Left the traces of the ensembles, right the histogram of each ensemble's
    ranks among all draws: flat bars mean that the ensembles agree.
    """
    names = list(draws)
    width, height = 9.0, 1.05 * len(names) + 1.2
    figure = _plain_figure(width, height, converged)
    above = 0.75 if converged else 1.0
    place = {"left": 1.05 / width, "right": 1.0 - 0.3 / width, "bottom": 0.45 / height, "top": 1.0 - above / height}
    with mpl.rc_context(_RC):
        axes = figure.subplots(
            len(names),
            2,
            squeeze=False,
            sharex="col",
            width_ratios=[3, 2],
            gridspec_kw=place | {"hspace": 0.3, "wspace": 0.08},
        )
        for row, name in zip(axes, names, strict=True):
            beside = blended_transform_factory(figure.dpi_scale_trans, row[0].transAxes)
            values = np.asarray(draws[name])
            ranks = np.argsort(np.argsort(values.ravel())).reshape(values.shape) / values.size
            for k, (chain, chain_ranks) in enumerate(zip(values, ranks, strict=True)):
                colour = COLOURS[k % len(COLOURS)]
                row[0].plot(np.arange(chain.size) + burn_in, chain, lw=0.4, color=colour, alpha=0.8, rasterized=True)
                heights, edges = np.histogram(chain_ranks, bins=20, range=(0.0, 1.0), density=True)
                row[1].stairs(heights, edges, color=colour, lw=1.2, ls=STYLES[k % len(STYLES)])
            row[0].set_ylabel(labels.get(name, name).replace(" [", "\n["))
            # All at one place: aligning them by what stands beside takes a quarter of the time of drawing.
            row[0].yaxis.set_label_coords(0.36, 0.5, transform=beside)
            row[1].axhline(1.0, color="#888888", lw=0.8)
            row[1].set_ylim(0.0, None)
            row[1].set_yticks([0, 1])
        axes[-1, 0].set_xlabel("draw (thinned)")
        axes[-1, 1].set_xlabel("rank among all draws / number of draws")
        axes[0, 0].set_title("trace of each ensemble")
        axes[0, 1].set_title("ranks of each ensemble (flat: they agree)")
        figure.text(0.5, 1.0 - 0.1 / height, title, ha="center", va="top", fontsize=11)
    return figure


def feature_check_figure(rows: Sequence[Mapping[str, Any]], *, title: str, converged: bool = True) -> Figure:
    """Measured features against what the posterior predicts for them.

    rows : one mapping each with name, unit, measured, standard_error, median, hdi50, hdi90, percentile. Values are
    drawn as distance from the measurement in its standard errors.
    """
    figure = new_figure(8.0, 0.34 * len(rows) + 1.4, converged)
    with mpl.rc_context(_RC):
        axes = figure.subplots()
        for y, row in enumerate(rows):
            scale = max(row["standard_error"], 1e-300)
            axes.plot([-1, 1], [y, y], color="#999999", lw=7, alpha=0.35, solid_capstyle="butt")
            for key, width in (("hdi90", 1.5), ("hdi50", 4.0)):
                low, high = ((edge - row["measured"]) / scale for edge in row[key])
                axes.plot([low, high], [y, y], color=COLOURS[0], lw=width, solid_capstyle="butt")
            axes.plot((row["median"] - row["measured"]) / scale, y, "o", color=COLOURS[1], ms=4)
        axes.axvline(0.0, color="black", lw=0.8)
        axes.set_yticks(
            range(len(rows)), [f"{row['name'].replace('_', ' ')}   {row['percentile']:.0f} %" for row in rows]
        )
        axes.set_xscale("symlog", linthresh=3.0)
        low, high = axes.get_xlim()
        axes.set_xlim(min(1.1 * low, -3.3), max(1.1 * high, 3.3))
        axes.set_xticks([x for x in (-100, -30, -10, -3, -1, 0, 1, 3, 10, 30, 100) if 1.1 * low <= x <= 1.1 * high])
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(
            "(model - measured) / standard error\ngrey: measured ± 1 standard error, blue: 50 and 90 % of the model"
        )
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_title(
            f"{title}\nbeside each name: percentile of the prediction\nat which the measurement falls", loc="left"
        )
    return figure


def forest_figure(
    intervals: Mapping[str, Mapping[str, tuple[float, float, float]]], labels: Mapping[str, str], *, title: str,
    converged: bool = True, assumed: Mapping[str, Collection[str]] = MappingProxyType({}),
    quartiles: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType({}),
) -> Figure:  # fmt: skip
    """Median and 90 % interval of each parameter over groups (cases): parameter -> group -> (low, median, high).

    A group may lack a parameter: the fit of all cases has no single value of one that is each case's own. `assumed`
    holds, by parameter, the groups in which the prior decided: these are drawn hollow and thin. `quartiles` holds, like
    `intervals`, the ends of the middle half: a thicker bar.
    """
    names = list(intervals)
    columns = min(3, len(names))
    lines = -(-len(names) // columns)
    groups = list(dict.fromkeys(group for rows in intervals.values() for group in rows))
    longest = max(len(labels.get(name, name)) for name in names)  # a letter takes about 0.08 inches
    width = max(3.1 * columns, 0.085 * len(title) + 0.3, columns * (0.08 * longest + 0.7))
    height = (0.32 * len(groups) + 0.9) * lines + 0.5
    figure = _plain_figure(width, height, converged)
    beside = 0.3 + 0.075 * max(len(group) for group in groups)
    above = 0.45 if converged else 0.75
    place = {"left": beside / width, "right": 1.0 - 0.15 / width, "bottom": 0.5 / height, "top": 1.0 - above / height}
    gaps = {"wspace": 0.12, "hspace": 0.65 / (0.32 * len(groups) + 0.25)}
    with mpl.rc_context(_RC):
        axes = np.atleast_1d(figure.subplots(lines, columns, squeeze=False, gridspec_kw=place | gaps)).ravel()
        for axis, name in zip(axes, names, strict=False):
            for group, (low, median, high) in intervals[name].items():
                y = groups.index(group)
                only_assumed = group in assumed.get(name, ())
                axis.plot([low, high], [y, y], color=COLOURS[0], lw=0.8 if only_assumed else 1.5)
                if half := quartiles.get(name, {}).get(group):
                    axis.plot(half, [y, y], color=COLOURS[0], lw=2.0 if only_assumed else 4.0, solid_capstyle="butt")
                axis.plot(median, y, "o", color=COLOURS[1], ms=5, mfc="white" if only_assumed else COLOURS[1])
            axis.set_yticks(range(len(groups)), groups if axis in axes[::columns] else [])
            axis.set_ylim(len(groups) - 0.5, -0.5)
            low, high = min(i[0] for i in intervals[name].values()), max(i[2] for i in intervals[name].values())
            if name in _LOGARITHMIC and high > 10.0 * low > 0.0:
                axis.set_xscale("log")
            else:
                axis.locator_params(axis="x", nbins=4)
            axis.set_xlabel(labels.get(name, name))
        for axis in axes[len(names) :]:
            axis.set_visible(False)
        figure.text(0.5, 1.0 - (above - 0.33) / height, title, ha="center", va="top", fontsize=11)
    return figure


def record_figure(trials: Sequence[Mapping[str, Any]], unit: str, *, title: str, converged: bool = True) -> Figure:
    """Measured records under the posterior band, with the residuals below.

    trials : one mapping each with label, times (n,) s, measured, low, median, high (channels, n).
    """
    channels = max(np.shape(t["measured"])[0] for t in trials)
    width, height = 4.6 * channels + 0.2, 2.5 * len(trials) + 1.15
    figure = _plain_figure(width, height, converged)
    above = 0.65 if converged else 0.95
    place = {"left": 0.75 / width, "right": 1.0 - 0.15 / width, "bottom": 0.7 / height, "top": 1.0 - above / height}
    with mpl.rc_context(_RC):
        axes = figure.subplots(
            *(2 * len(trials), channels),
            squeeze=False,
            sharex=True,
            height_ratios=[2.2, 1.0] * len(trials),
            gridspec_kw=place | {"hspace": 0.32, "wspace": 0.16},
        )
        for k, trial in enumerate(trials):
            times = trial["times"]
            for c in range(channels):
                upper, lower = axes[2 * k, c], axes[2 * k + 1, c]
                if c >= np.shape(trial["measured"])[0]:
                    upper.set_visible(False)
                    lower.set_visible(False)
                    continue
                upper.plot(times, trial["measured"][c], ".", color="#555555", ms=1.6, label="measured", rasterized=True)
                upper.plot(times, trial["median"][c], color=COLOURS[0], lw=0.9, label="model, median")
                upper.fill_between(
                    *(times, trial["low"][c], trial["high"][c]), color=COLOURS[0], alpha=0.3, lw=0, label="model, 90 %"
                )
                _draw_residuals(lower, times, np.asarray(trial["measured"][c]) - np.asarray(trial["median"][c]))
                upper.set_title(f"{trial['label']}, channel {c + 1}", loc="left")
                if c == 0:
                    upper.set_ylabel(raised(unit))
                    lower.set_ylabel("residual")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=3, markerscale=4.0)
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        figure.text(0.5, 1.0 - (above - 0.53) / height, title, ha="center", va="top", fontsize=11)
    return figure


def _draw_residuals(axis: Any, times: Array, residuals: Array) -> None:
    """Residuals about zero. The few that lie ten times as far out as nearly all others would hide these: they stand as
    triangles at the edge.
    """
    finite = np.abs(residuals[np.isfinite(residuals)])
    reach = float(np.quantile(finite, 0.98)) if finite.size else 0.0
    far = np.abs(residuals) > 10.0 * reach if reach > 0.0 else np.zeros(residuals.shape, bool)
    axis.plot(times[~far], residuals[~far], ".", color=COLOURS[1], ms=1.4, rasterized=True)
    axis.axhline(0.0, color="black", lw=0.6)
    if far.any():
        low, high = axis.get_ylim()
        edge = np.where(residuals[far] > 0.0, high, low)
        for side, marker in ((high, "^"), (low, "v")):
            axis.plot(times[far][edge == side], edge[edge == side], marker, color=COLOURS[1], ms=5.0, clip_on=False)
        axis.set_ylim(low, high)


def work_precision_figure(curves: Mapping[str, Sequence[tuple[float, float]]], *, title: str) -> Figure:
    """Largest error against CPU time of one record; a curve of (microseconds, share of the peak) for each method."""
    figure = new_figure(6.0, 4.0)
    with mpl.rc_context(_RC):
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


def variability_figure(result: Mapping[str, Any], *, title: str, converged: bool = True) -> Figure:
    """Effective k2t and c2t against initial energy, and where their scatter over the cases comes from.

    result : what variability.json holds. Above: bands of one and the same rig (median, 90 %), each case with its 90 %
    interval, and the values that linear fits to the measurements gave. Below: shares of the scatter, 90 % intervals.
    """
    names = {name: label(name, unit_of(name, result.get("kind", "torsional"))) for name in ("k2t", "c2t")}
    figure = new_figure(9.0, 6.2, converged)
    with mpl.rc_context(_RC):
        axes = figure.subplots(2, 2, height_ratios=[2.4, 1.0])
        for k, (name, axis_label) in enumerate(names.items()):
            upper, lower = axes[0, k], axes[1, k]
            for i, (label_, curve) in enumerate(result["effective"]["curves"].items()):
                energy = 1e3 * np.asarray(curve["energy_j"])
                colour = COLOURS[(2, 4, 5)[i % 3]]
                upper.plot(energy, curve[name]["median"], color=colour, ls=STYLES[i % 4], label=f"one rig, {label_}")
                upper.fill_between(energy, curve[name]["low"], curve[name]["high"], color=colour, alpha=0.18, lw=0)
            for i, (case, row) in enumerate(result["effective"]["cases"].items()):
                energy = 1e3 * row["energy_j"]
                upper.plot([energy] * 2, row[name]["hdi90"], color=COLOURS[0], lw=1.6)
                told = "each case, 90 %" if i == 0 else None
                upper.plot(energy, row[name]["median"], "o", color=COLOURS[0], ms=5, label=told)
                upper.annotate(case, (energy, row[name]["median"]), xytext=(4, 4), textcoords="offset points")
                if "measured" in row:
                    words = "Table 9 (p. 20)" if result["campaign"] == "thesis" else "linear fit to the measurements"
                    told = words if i == 0 else None
                    upper.plot(energy, row["measured"][name], "D", color=COLOURS[1], ms=5, label=told)
            upper.set_yscale("log")
            upper.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            upper.yaxis.set_major_formatter("{x:g}")
            upper.yaxis.set_minor_formatter(NullFormatter())
            upper.set_xlabel("initial energy [mJ]")
            upper.set_ylabel(f"effective {axis_label}")
            pieces = {key: row for key, row in result["decomposition"][name].items() if isinstance(row, Mapping)}
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


def response_figure(result: Mapping[str, Any], *, title: str) -> Figure:
    """Frequency response of the primary without a secondary and with each design: one panel for each way of exciting.

    result : what tune.json holds; bands hold 90 % of the draws.
    """
    panels: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for name, band in result["frequency_response"].items():
        excited, _, design = name.partition(", ")
        panels.setdefault(excited, []).append((design, band))
    designs = list(dict.fromkeys(design for bands in panels.values() for design, _ in bands))
    effort = "force" if result.get("kind") == "translational" else "torque"
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.6 * columns, 2.7 * rows + 0.5, result.get("converged", True))
    with mpl.rc_context(_RC):
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for axis, (excited, bands) in zip(axes, panels.items(), strict=False):
            for design, band in bands:
                k = designs.index(design)
                frequency, low, middle, high = (
                    np.array(band[key], float) for key in ("frequency_hz", "q05", "median", "q95")
                )
                marks: dict[str, Any] = {"color": COLOURS[k % len(COLOURS)]}
                axis.plot(frequency, middle, ls=STYLES[k % len(STYLES)], label=design, **marks)
                axis.fill_between(frequency, low, high, alpha=0.2, lw=0, **marks)
            axis.set_yscale("log")
            axis.set_title("linear model" if excited == "linear" else f"nonlinear, {effort} {excited}", loc="left")
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[: len(panels)]:
            axis.tick_params(labelbottom=True)
        for axis in axes[: len(panels)][-columns:]:
            axis.set_xlabel("frequency [Hz]")
        for axis in axes[::columns]:
            axis.set_ylabel("accelerance [1/kg]" if effort == "force" else "accelerance [1/(kg m²)]")
        axes[0].legend(loc="best", fontsize=8)
        figure.suptitle(title)
    return figure


def tuning_figure(result: Mapping[str, Any], *, title: str) -> Figure:
    """Insertion loss against the exciting torque, and over the inertia and the radius of the secondary.

    result : what tune.json holds. Bars and bands hold 90 % of the draws; the grey line is the target, the
    upright ones are the design and the best design.
    """
    curves = result["curves"]
    driven = {"design": result["nonlinear"], "best design": (result["optimum"] or {}).get("nonlinear", [])}
    first = bool(result["nonlinear"])
    translational = result.get("kind") == "translational"
    columns = len(curves) + first
    figure = new_figure(3.4 * max(columns, 1) + 0.4, 3.3, result.get("converged", True))
    with mpl.rc_context(_RC):
        axes = figure.subplots(1, max(columns, 1), squeeze=False, sharey=True)[0]
        for k, (name, rows) in enumerate(driven.items()):
            told = [r for r in rows if r["insertion_loss_db"]["median"] is not None]
            x = np.array([r["torque_amplitude_n_m"] for r in told]) * (0.97 if k else 1.03)
            for at, row in zip(x, told, strict=True):
                axes[0].plot([at] * 2, row["insertion_loss_db"]["interval90"], color=COLOURS[k], lw=1.5)
            y = [r["insertion_loss_db"]["median"] for r in told]
            axes[0].plot(x, y, color=COLOURS[k], ls=STYLES[k], marker="os"[k], ms=4, label=name)
        if first:
            axes[0].set_xscale("log")
            ticks = [r["torque_amplitude_n_m"] for r in result["nonlinear"]]
            axes[0].set_xticks(ticks, [f"{x:g}" for x in ticks])
            axes[0].minorticks_off()
            axes[0].set_xlabel("exciting force [N]" if translational else "exciting torque [N m]")
            axes[0].legend(loc="best", fontsize=8)
            axes[0].set_title("with dry friction", loc="left")
        labels = {"J2": ("J2 [kg]", 1.0) if translational else ("J2 [g m²]", 1e3), "R": ("R [mm]", 1e3)}
        for axis, (name, curve) in zip(axes[int(first) :], curves.items(), strict=False):
            words, unit = labels.get(name, (name, 1.0))
            x = unit * np.asarray(curve["value"])
            mean, low, high = (np.array(curve[key], float) for key in ("mean", "q05", "q95"))
            axis.plot(x, mean, color=COLOURS[0], label="mean")
            axis.fill_between(x, low, high, color=COLOURS[0], alpha=0.2, lw=0, label="90 %")
            for k, place in enumerate((curve["design"], curve["best_design"])):
                if place is not None:
                    axis.axvline(unit * place, color=COLOURS[k], ls=STYLES[k], lw=1.0)
            axis.set_xlabel(words)
            axis.set_title("linear model", loc="left")
        for axis in axes:
            axis.axhline(result["target_db"], color="#888888", lw=0.9)
        axes[0].set_ylabel("insertion loss [dB]")
        figure.suptitle(title)
    return figure


def thesis_figure(found: Mapping[str, Any]) -> Figure:
    """The figures of the thesis as its equations and constants give them, a panel each.

    found : name -> thesis.Figure (page, x, y, curves, note, printed).
    """
    columns = 2
    rows = -(-len(found) // columns)
    figure = new_figure(10.0, 2.9 * rows + 0.4)
    with mpl.rc_context(_RC):
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (name, told) in zip(axes, found.items(), strict=False):
            response = "frequency" in told.x
            for k, (words, (x, y)) in enumerate(told.curves.items()):
                shown = x <= _SHOWN_HZ if response else np.ones(x.size, dtype=bool)
                axis.plot(
                    *(x[shown], y[shown]), color=COLOURS[k % len(COLOURS)], ls=STYLES[k % len(STYLES)], lw=1.1,
                    label=words,
                )  # fmt: skip
            for k, (words, (x, y)) in enumerate(told.printed.items()):
                axis.plot(x, y, "x^sD"[k % 4], color="#000000", ms=5, mfc="none", label=f"printed: {words}")
            if response:
                axis.set_yscale("log")
                axis.set_ylim(bottom=max(axis.get_ylim()[0], 1e-3 * axis.get_ylim()[1]))
            axis.set_xlabel(told.x.replace("(", "[", 1).replace(")", "]", 1))
            axis.set_ylabel(told.y.replace("(", "[", 1)[::-1].replace(")", "]", 1)[::-1], fontsize=8)
            axis.set_title(f"{name} (p. {told.page})", loc="left")
            axis.legend(loc="lower right" if told.printed else "best", fontsize=7)
        for axis in axes[len(found) :]:
            axis.set_visible(False)
        figure.suptitle("The figures of the thesis, recomputed from its equations and constants")
    return figure


def plan_figure(result: Mapping[str, Any], *, title: str) -> Figure:
    """What a plan could see and tell apart: chance of each effect to be seen, and nats of each beside each rival.

    result : what plan.json holds. The numbers in the right part are expected nats, left out from 10 on (told apart);
    dark cells are pairs that the planned trials cannot tell apart.
    """
    names = [row["name"] for row in result["effects"]]
    figure = new_figure(4.0 + 0.36 * len(names), 1.9 + 0.26 * len(names))
    with mpl.rc_context(_RC | {"axes.grid": False}):
        left, right = figure.subplots(1, 2, width_ratios=[2.2, 0.36 * len(names)])
        left.barh(range(len(names)), [row["chance"] for row in result["effects"]], color=COLOURS[0])
        left.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
        left.set_xlim(0.0, 1.0)
        left.set_ylim(len(names) - 0.5, -0.5)
        left.set_xlabel("share of plausible sizes\nthat would be seen")
        table = np.array([[result["matrix"][a].get(b, np.nan) for b in names] for a in names], float)
        right.imshow(np.clip(table, 0.0, 10.0), cmap="Blues_r", vmin=-4.0, vmax=10.0, aspect="auto")
        for (y, x), nats in np.ndenumerate(table):
            if nats < 10.0:
                right.text(x, y, f"{nats:.0f}", ha="center", va="center", fontsize=7, color="w" if nats < 3.0 else "k")
        right.set_xticks(range(len(names)), [name.replace("_", " ") for name in names], rotation=90)
        right.set_yticks([])
        right.set_ylim(len(names) - 0.5, -0.5)
        right.set_xlabel("rival")
        right.set_title("nats by which a typical effect stands out beside a rival (empty: 10 or more)", loc="left")
        figure.suptitle(title)
    return figure


def withheld_figure(scores: Mapping[str, Any], *, rehearsal: bool = False) -> Figure:
    """The check on withheld data: what was taken for what, sites, reliability beside a calibrated twin, strength.

    scores : the entry `scores` of withheld.json. rehearsal : marked across the top.
    """
    answers = sorted({*scores["confusion"], *(n for row in scores["confusion"].values() for n in row)})
    figure = new_figure(11.0, 4.2 + 0.22 * len(answers))
    with mpl.rc_context(_RC | {"axes.grid": False}):
        parts = figure.subplot_mosaic("ns;nr;nl", width_ratios=[3, 2])
        _draw_counts(parts["n"], scores["confusion"], "what was taken for what")
        _draw_counts(parts["s"], scores["sites"], "true site and most probable site")
        axis, told = parts["r"], scores["reliability"]["all"]
        axis.plot([0, 1], [0, 1], color="#888888", lw=0.8)
        for row in told["bins"]:
            at = row["confidence"]
            axis.plot([at, at], row["twin95"], color=COLOURS[5], lw=7, alpha=0.5, solid_capstyle="butt")
            axis.plot([at, at], row["right"]["interval95"], color=COLOURS[0], lw=1.2)
            axis.plot(at, row["right"]["value"], "o", color=COLOURS[1], ms=5)
        axis.set_xlabel("probability of the verdict")
        axis.set_ylabel("share that is right")
        axis.set_title("reliability (bars: calibrated twin, 95 %)", loc="left")
        axis = parts["l"]
        for k, kind in enumerate(sorted({row["kind"] for row in scores["by_level"]})):
            rows = [row for row in scores["by_level"] if row["kind"] == kind]
            at = [row["level"] * (1.03 if k else 0.97) for row in rows]
            right = [row["accepted_first"] for row in rows]
            reach = np.array([[r["value"] - r["interval95"][0], r["interval95"][1] - r["value"]] for r in right]).T
            marks: dict[str, Any] = {"color": COLOURS[k], "ls": STYLES[k % len(STYLES)], "marker": "os"[k % 2], "ms": 4}
            axis.errorbar(at, [r["value"] for r in right], np.maximum(reach, 0.0), label=kind, **marks)
            axis.legend(loc="lower right")
        levels = sorted({float(row["level"]) for row in scores["by_level"]})
        axis.set_xscale("log")
        axis.set_xticks(levels, [f"{level:g}" for level in levels])
        axis.set_xticks([], minor=True)
        axis.set_ylim(0.0, 1.05)
        axis.set_xlabel("level: gap after the best nominal fit / noise")
        axis.set_ylabel("right answer first")
    if rehearsal:
        told = "REHEARSAL: the code has changed since these campaigns were sealed"
        figure.suptitle(told, color="#B00020", weight="bold")
    return figure


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


def ranking_figure(probabilities: Mapping[str, float], sites: Mapping[str, float], *, title: str) -> Figure:
    """Probabilities of the answers (those above 0.5 %, at most twelve) and of the sites, as bars."""
    shown = {name: p for name, p in _leading(probabilities, 12).items() if p > 0.005}
    rows = max(len(shown), len(sites))
    figure = new_figure(8.0, 0.28 * rows + 1.2)
    with mpl.rc_context(_RC):
        left, right = figure.subplots(1, 2)
        _draw_probabilities(left, shown, rows, "answer")
        _draw_probabilities(right, sites, rows, "site")
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
        told = "< 0.01" if height < 0.005 else "> 0.99" if 0.995 <= height < 1.0 else f"{height:.2f}"
        axis.text(height + 0.02, y, told, va="center")
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(max(rows, len(names)) - 0.5, -0.5)
    axis.set_xlim(0.0, 1.2)
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("probability")
    axis.set_title(heading, loc="left")


def gap_figure(record: Mapping[str, Any], probabilities: Mapping[str, float], *, title: str) -> Figure:
    """One record under the nominal model, what is left of it before and after the answer is added, and the answers.

    record : label, unit, times (n,) s, measured, nominal (n,), augmented (n,) or None where there is nothing to add,
    added: name of what is, noise: standard deviation of the readings.
    """
    augmented = record["augmented"]
    rows = ["record", "before"] + (["after"] if augmented is not None else [])
    figure = new_figure(9.0, 1.2 + 1.2 * len(rows))
    dots: dict[str, Any] = {"color": "#777777", "ms": 2.0, "rasterized": True}
    times, measured, nominal = record["times"], np.asarray(record["measured"]), np.asarray(record["nominal"])
    unit, noise = raised(record["unit"]), record["noise"]
    with mpl.rc_context(_RC):
        axes = figure.subplot_mosaic([[row, "answers"] for row in rows], width_ratios=[2.6, 1.0])
        axes["record"].plot(times, measured, ".", label="measured", **dots)
        axes["record"].plot(times, nominal, color=COLOURS[0], lw=1.0, label="fitted nominal model")
        axes["record"].set_title(record["label"], loc="left")
        axes["record"].legend(loc="upper right", ncols=2)
        axes["record"].set_ylabel(unit)
        axes["before"].set_title("measured minus nominal model (band: two sd of the noise)", loc="left")
        axes["before"].plot(times, measured - nominal, ".", **dots)
        if augmented is not None:
            axes["before"].plot(
                *(times, np.asarray(augmented) - nominal), color=COLOURS[1], lw=1.0, label=f"added by {record['added']}"
            )
            axes["before"].legend(loc="best")
            axes["after"].set_title(f"measured minus model with {record['added']}", loc="left")
            axes["after"].plot(times, measured - augmented, ".", **dots)
            axes["after"].sharey(axes["before"])
        for name in rows:
            if name != "record":
                axes[name].axhspan(-2.0 * noise, 2.0 * noise, color="#cccccc", alpha=0.5, lw=0, zorder=0)
                axes[name].set_ylabel(unit)
            axes[name].sharex(axes["record"])
            axes[name].tick_params(labelbottom=name == rows[-1])
        axes[rows[-1]].set_xlabel("time [s]")
        _draw_probabilities(axes["answers"], _leading(probabilities, 10), 10, "what is missing")
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
    with mpl.rc_context(_RC | {"axes.grid": False}):
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
                if panel["labels"] is not None:
                    axis.set_yticks(np.arange(len(panel["labels"])) + 0.5, panel["labels"], fontsize=7)
                    axis.invert_yaxis()
            places[0].set_title(column["title"], loc="left")
        bar = figure.colorbar(drawn, ax=axes, shrink=0.5, aspect=30, extend="max")
        bar.set_label("rms residual / noise (1: noise alone)")
        told = [x for x in (1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000) if x <= most]
        bar.set_ticks(told, labels=[str(x) for x in told])
        bar.minorticks_off()
        figure.suptitle(title)
    return figure


def published_figure(rows: Mapping[str, Sequence[Mapping[str, Any]]], *, title: str) -> Figure:
    """Published numbers beside what each answer predicts for them: a panel for each configuration and feature.

    rows : answer -> entries with case, configuration, feature, unit, measured, standard_error, predicted and
    predicted_hdi90, the same numbers in the same order for each answer.
    """
    first = next(iter(rows.values()))
    panels = list(dict.fromkeys((row["feature"], row["configuration"]) for row in first))
    cases = list(dict.fromkeys(row["case"] for row in first))
    figure = new_figure(8.0, 2.3 * ((len(panels) + 1) // 2) + 0.8)
    with mpl.rc_context(_RC):
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


def missing_torque_figure(
    torque: Any, curve: Mapping[str, Mapping[str, Any]], *, body: int, title: str, record: str = "",
    translational: bool = False,
) -> Figure:  # fmt: skip
    """Missing torque (force) on each inertia over time with its 90 % band, and against the coordinates of its site.

    torque : of one trial, shown as points where it is known to three times its median sd: times (n,), torque and sd
    (2, n) N m, th1, w1, th2, w2, phi, slip (n,); curve : coordinate -> its bins over all trials (centre, torque_n_m,
    sd_n_m), as `SiteMap.curve` gives them; body : the inertia that the curve is of, 0 or 1;
    record : the name of that trial.
    """
    figure = new_figure(9.0, 6.0)
    names = ("primary", "secondary")
    effort = "force [N]" if translational else "torque [N m]"
    with mpl.rc_context(_RC):
        axes = figure.subplot_mosaic([["time", "time"], ["left", "right"]])
        over_time = axes["time"]
        for k, colour in ((0, COLOURS[0]), (1, COLOURS[1])):
            value, sd = np.asarray(torque.torque[k]), np.asarray(torque.sd[k])
            if not np.any(value):
                continue
            over_time.plot(torque.times, value, color=colour, lw=1.0, ls=STYLES[k], label=f"on the {names[k]}")
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
            axis.set_ylabel(f"{effort} on the {names[body]}")
        axes["left"].legend(loc="best")
        figure.suptitle(title)
    return figure
