"""Figures as files: whole or not at all."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.text import Text

from bayes_damper import figures


class _Stopped(Line2D):
    """A line at which the process ends, in the midst of the file; drawn once before to lay the figure out."""

    drawn = 0

    def draw(self, renderer: object) -> None:
        self.drawn += 1
        if self.drawn == 2:
            raise KeyboardInterrupt


def test_a_figure_that_is_interrupted_leaves_the_former_one(tmp_path: Path) -> None:
    figure = figures.new_figure()
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [0.0, 1.0])
    written = figures.save(figure, tmp_path / "new" / "record")
    assert [p.name for p in written] == ["record.svg", "record.png"]
    before = {p: p.read_bytes() for p in written}
    axes.add_line(_Stopped([0.0, 1.0], [1.0, 0.0]))
    with pytest.raises(KeyboardInterrupt):
        figures.save(figure, tmp_path / "new" / "record")
    assert {p: p.read_bytes() for p in sorted(written[0].parent.iterdir())} == before


def test_a_forest_shows_the_middle_half_inside_the_interval() -> None:
    """Two bars a group, the inner one thicker; a group whose quartiles are not known has the outer one alone."""
    intervals = {"mu": {"I": (0.1, 0.3, 0.8), "II": (0.2, 0.4, 0.5)}}
    figure = figures.forest_figure(intervals, {}, title="", quartiles={"mu": {"I": (0.2, 0.5)}})
    bars = [line for line in figure.axes[0].lines if len(line.get_xdata()) == 2]
    assert [(list(b.get_xdata()), b.get_ydata()[0]) for b in bars] == [
        ([0.1, 0.8], 0),
        ([0.2, 0.5], 0),
        ([0.2, 0.5], 1),
    ]
    assert bars[1].get_linewidth() > 2.0 * bars[0].get_linewidth()


def test_numbers_of_a_narrow_interval_stand_in_full() -> None:
    figure = figures.forest_figure({"k3": {"I": (179.90, 179.97, 180.03)}}, {}, title="")
    FigureCanvasAgg(figure).draw()
    axis = figure.axes[0].xaxis
    assert axis.get_offset_text().get_text() == ""
    assert "179.95" in [tick.get_text() for tick in axis.get_ticklabels()]


@pytest.mark.parametrize(("translational", "body"), [(False, "the primary"), (True, "body 1")])
def test_missing_torque_is_drawn_on_bodies_that_bear_the_names_of_their_rig(translational: bool, body: str) -> None:
    t = np.linspace(0.0, 1.0, 50)
    torque = SimpleNamespace(times=t, torque=np.array([np.sin(t), 0 * t]), sd=np.full((2, 50), 0.1), th1=t, w1=t)
    curve = {name: {"centre": t, "torque_n_m": t, "sd_n_m": 0.1 + 0 * t} for name in ("th1", "w1")}
    figure = figures.missing_torque_figure(torque, curve, body=0, title="", translational=translational)
    words = [text.get_text() for text in figure.findobj(Text)]
    assert f"on {body}" in words
    assert f"{'force [N]' if translational else 'torque [N m]'} on {body}" in words


def test_titles_of_a_gap_with_two_long_named_effects_stay_over_the_records() -> None:
    t = np.linspace(0.0, 1.0, 50)
    added = "play in the spring to ground and friction between the bodies that falls with the speed of sliding"
    record = {
        "label": "A #1", "unit": "m", "times": t, "measured": np.sin(t), "nominal": t,
        "augmented": np.sin(t), "added": added, "noise": 0.1,
    }  # fmt: skip
    figure = figures.gap_figure(record, {"both": 0.9, "nothing": 0.1}, title="")
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    *rows, answers = sorted(figure.axes, key=lambda axes: axes.get_position().x0)
    ends = [axes.title.get_window_extent(renderer).x1 for axes in rows]
    ends += [axes._left_title.get_window_extent(renderer).x1 for axes in rows]
    assert max(ends) < answers.get_tightbbox(renderer).x0 + 1.0


def test_the_gap_names_its_axes_and_only_answers_that_count() -> None:
    t = np.linspace(0.0, 1.0, 50)
    record = {
        "label": "A #1, channel 1", "unit": "m", "times": t, "measured": np.sin(t), "nominal": t,
        "augmented": np.sin(t), "added": "a stop", "noise": 0.1,
    }  # fmt: skip
    answers = {"a stop": 0.9, "nothing": 0.09, "rust": 0.006, "dust": 0.004, "a cause outside the library": 1e-9}
    words = [text.get_text() for text in figures.gap_figure(record, answers, title="").findobj(Text)]
    assert words.count("reading [m]") == 3
    assert {"a stop", "nothing", "rust", "measured minus model with a stop"} <= set(words)
    assert not {"dust", "a cause outside the library"} & set(words)


@pytest.mark.parametrize(("translational", "place"), [(False, "angle [rad]"), (True, "displacement [m]")])
def test_a_learnt_law_is_drawn_in_the_units_of_its_rig_and_with_signs_in_grey(translational: bool, place: str) -> None:
    edges = np.linspace(-1.0, 1.0, 9)
    law = SimpleNamespace(
        terms=(SimpleNamespace(carrier="speed", along="angle"),),
        torque=lambda angle, speed, time: (angle * speed, 0.0 * angle),
        curve=lambda k: (edges, edges, 0.1 + 0.0 * edges),
    )
    figure = figures.learnt_law_figure(law, (np.ones((8, 8)), edges, edges), title="", translational=translational)
    assert [axis.get_xlabel() for axis in figure.axes].count(place) == 2
    lines = [drawn for drawn in figure.findobj(ContourSet) if not drawn.filled]
    assert len(lines) == 1
    assert {dashes is None for _, dashes in lines[0].get_linestyle()} == {True, False}, "broken below 0"


def test_a_plan_speaks_of_effects_by_their_titles_and_of_rivals_by_their_numbers() -> None:
    effects = [{"name": name, "title": title, "chance": 0.5} for name, title in (("grit", "dirt in it"), ("x_y", ""))]
    matrix = {"grit": {"x_y": 4.0}, "x_y": {"grit": 40.0}}
    left, right = figures.plan_figure({"effects": effects, "matrix": matrix}, title="").axes
    assert [t.get_text() for t in left.get_yticklabels()] == ["dirt in it  1", "x y  2"]
    assert [t.get_text() for t in right.get_xticklabels()] == ["1", "2"]


def test_a_matrix_of_answers_has_the_diagonal_first_and_no_column_that_was_never_given() -> None:
    counts = {"grit": {"unknown": 2}, "mass": {"mass": 3, "none": 1}, "stop": {"stop": 2, "grit's twin": 1}}
    empty = {"n": 0, "bins": [], "error": None, "p_value": None}
    scores = {"confusion": counts, "sites": {}, "reliability": {"all": empty}, "by_level": []}
    matrix = figures.withheld_figure(scores).axes[0]
    assert [t.get_text() for t in matrix.get_yticklabels()] == ["mass", "stop", "grit"]
    assert [t.get_text() for t in matrix.get_xticklabels()] == ["mass", "stop", "grit's twin", "none", "unknown"]
