"""Figures as files: whole or not at all."""

from pathlib import Path

import pytest
from matplotlib.lines import Line2D

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
