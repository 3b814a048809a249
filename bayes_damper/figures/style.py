"""The house style of every figure: colours, sizes, labels with units, marks, saving."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayes_damper.runs.json_files import whole

mpl.use("Agg", force=False)

Array = NDArray[np.float64]
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", "--", "-.", ":")
RC = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "bayes_damper",
    "figure.dpi": 110,
}
NOT_CONVERGED = "NOT CONVERGED: do not use these numbers"


def new_figure(width: float = 7.0, height: float = 4.0, converged: bool = True) -> Figure:
    """An empty figure in the house style, width and height in inches, marked when its run did not converge."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(width, height), layout="constrained")
    if not converged:
        mark(figure)
    return figure


def plain_figure(width: float, height: float, converged: bool) -> Figure:
    """The same for drawings that know their margins: laying a figure out takes as long as drawing it."""
    with mpl.rc_context(RC):
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
    with mpl.rc_context(RC | {"figure.autolayout": False, "figure.constrained_layout.use": False}):
        engine = figure.get_layout_engine()
        if engine is not None and figure.axes:
            engine.execute(figure)
            figure.set_layout_engine(None)  # a figure with one is laid out and drawn twice for each file
        for kind, options in (
            ("svg", {"metadata": {"Date": None}}),
            ("png", {"dpi": 150, "pil_kwargs": {"compress_level": 3}}),
        ):
            target = path.with_name(f"{path.name}.{kind}")
            with whole(target) as partial:
                figure.savefig(partial, format=kind, **options)
            written.append(target)
    return written


def label(symbol: str, unit: str) -> str:
    """Axis label: symbol and unit, the unit left out where it is 1."""
    return symbol if unit in ("", "1") else f"{symbol} [{raised(unit)}]"


def raised(unit: str) -> str:
    """A unit with its squares as people write them: rad/s² for rad/s^2."""
    return unit.replace("^2", "²").replace("^3", "³")
