"""Figures of a fit: corner, traces, intervals, features and records beside what the posterior gives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory

from bayes_damper.figures.style import COLOURS, RC, STYLES, Array, mark, new_figure, plain_figure, raised
from bayes_damper.runs.contents.fit import CheckEntry
from bayes_damper.sampling import arviz_adapter
from bayes_damper.text import interval, number

_LOGARITHMIC = ("nu",)
"""Parameters that may be known to a factor at best: their axes are logarithmic where a factor of 10 is seen."""


def corner_figure(
    draws: Mapping[str, Mapping[str, Array]], labels: Mapping[str, str], *, title: str, converged: bool = True,
    intervals: Mapping[str, tuple[float, float, float]] = MappingProxyType({}),
    assumed: Mapping[str, Array] = MappingProxyType({}),
) -> Figure:  # fmt: skip
    """Corner plot of one posterior, or of several overlaid. The contours hold 50 and 90 % of the draws.

    draws : group (e.g. case) -> parameter -> (n_draws,); all groups have the same parameters.
    labels : parameter -> axis label.
    intervals : parameter -> (low, median, high) of its interval, dashed in its own panel and written above it.
    assumed : parameter -> draws of its prior, (n,); a grey line to the scale of the posterior.
    """
    corner = arviz_adapter.imported("corner")  # here, because it brings ArviZ with it: seconds that only a fit needs
    names = list(next(iter(draws.values())))
    stacked = {group: np.column_stack([values[name] for name in names]) for group, values in draws.items()}
    everything = np.concatenate(list(stacked.values()))
    single = len(draws) == 1
    low, high = np.quantile(everything, [0.002, 0.998] if single else [0.002, 0.985], axis=0)
    span = np.where(high > low, high - low, np.maximum(np.abs(high), 1e-12) * 1e-3)
    ranges = np.stack([low - 0.03 * span, high + 0.03 * span], axis=1)
    wide = np.array([name in _LOGARITHMIC for name in names]) & (everything.min(axis=0) > 0.0) & (high > 10.0 * low)
    ranges[wide] = np.stack([0.9 * low[wide], 1.1 * high[wide]], axis=1)
    with mpl.rc_context(RC | {"axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}):
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
            _mark_interval(axis, ends, labels.get(name, name), intervals.get(name), assumed.get(name))
        margin = 1.05 / figure.get_figwidth()  # room for the labels beside the slanted numbers
        above = (0.6 if intervals else 0.15) / figure.get_figheight()
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


def _mark_interval(
    axis: Axes, ends: Array, label: str, intervals: tuple[float, float, float] | None, assumed: Array | None
) -> None:
    """In the panel of a parameter by itself: its prior in grey, its interval dashed, its name and interval above."""
    logarithmic = axis.get_xscale() == "log"
    edges = (np.geomspace if logarithmic else np.linspace)(float(ends[0]), float(ends[1]), _BINS + 1)
    if assumed is not None:
        # Both are shares of draws in each bar, so that the lines compare as they stand.
        from scipy.ndimage import gaussian_filter  # slow to load, and only fits draw this

        heights = gaussian_filter(np.histogram(assumed, edges)[0] / assumed.size, 1.0)
        middles = np.sqrt(edges[:-1] * edges[1:]) if logarithmic else 0.5 * (edges[:-1] + edges[1:])
        axis.plot(middles, heights, color="#888888", lw=1.2, label="prior")
        axis.set_ylim(0.0, max(axis.get_ylim()[1], 1.1 * float(heights.max())))
    if intervals is not None:
        low, median, high = intervals
        for x in intervals:
            axis.axvline(x, ls="--", lw=0.9, color=COLOURS[0])
        axis.set_title(f"{label}\n{number(median, high - low)}\n({interval(low, high)})", fontsize=8)


def trace_figure(
    draws: Mapping[str, Array], labels: Mapping[str, str], *, title: str, burn_in: int = 0, converged: bool = True
) -> Figure:
    """Trace and rank plot of each parameter.

    draws : parameter -> (ensembles, draws). Left the traces of the ensembles, right the histogram of each ensemble's
    ranks among all draws: flat bars mean that the ensembles agree.
    """
    names = list(draws)
    width, height = 9.0, 1.05 * len(names) + 1.2
    figure = plain_figure(width, height, converged)
    above = 0.75 if converged else 1.0
    place = {"left": 1.05 / width, "right": 1.0 - 0.3 / width, "bottom": 0.45 / height, "top": 1.0 - above / height}
    with mpl.rc_context(RC):
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


def feature_check_figure(rows: Sequence[CheckEntry], *, title: str, converged: bool = True) -> Figure:
    """Measured features against what the posterior predicts for them.

    rows : one mapping each with name, unit, measured, standard_error, median, hdi50, hdi90, percentile. Values are
    drawn as distance from the measurement in its standard errors.
    """
    figure = new_figure(8.0, 0.34 * len(rows) + 1.4, converged)
    with mpl.rc_context(RC):
        axes = figure.subplots()
        for y, row in enumerate(rows):
            scale = max(row["standard_error"], 1e-300)
            axes.plot([-1, 1], [y, y], color="#999999", lw=7, alpha=0.35, solid_capstyle="butt")
            for ends, width in ((row["hdi90"], 1.5), (row["hdi50"], 4.0)):
                low, high = ((edge - row["measured"]) / scale for edge in ends)
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
        axes.set_title(f"{title}\nnumber at each name: percentile of the\nmeasurement in the prediction", loc="left")
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
    figure = plain_figure(width, height, converged)
    beside = 0.3 + 0.075 * max(len(group) for group in groups)
    above = 0.45 if converged else 0.75
    place = {"left": beside / width, "right": 1.0 - 0.15 / width, "bottom": 0.5 / height, "top": 1.0 - above / height}
    gaps = {"wspace": 0.12, "hspace": 0.65 / (0.32 * len(groups) + 0.25)}
    with mpl.rc_context(RC):
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
    figure = plain_figure(width, height, converged)
    above = 0.65 if converged else 0.95
    place = {"left": 0.75 / width, "right": 1.0 - 0.15 / width, "bottom": 0.7 / height, "top": 1.0 - above / height}
    with mpl.rc_context(RC):
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
                for axis in (upper, lower):  # short numbers leave room for the label
                    axis.ticklabel_format(axis="y", scilimits=(-2, 4))
                lower.yaxis.get_offset_text().set_fontsize(7.5)
                upper.set_title(f"{trial['label']}, channel {c + 1}", loc="left")
                if c == 0:
                    upper.set_ylabel(f"reading [{raised(unit)}]")
                    lower.set_ylabel(f"residual\n[{raised(unit)}]", fontsize=7.5)
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
