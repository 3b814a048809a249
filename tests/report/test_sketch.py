"""The sketch of the rig: well-formed, within its frame, and with the sites that a page names."""

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from bayes_damper.effects.base import SITES
from bayes_damper.report.sections.diagnosis import _sketch
from bayes_damper.report.sketch import KINDS, sketch

SVG = "{http://www.w3.org/2000/svg}"


def sites_of(drawn, which="site"):
    groups = ET.fromstring(drawn).iter(f"{SVG}g")
    return {g.get("data-site") for g in groups if which in g.get("class").split()}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("coupled", [True, False])
def test_every_site_that_a_rig_can_have_is_drawn_inside_the_frame(kind, coupled):
    drawn = sketch(kind, coupled=coupled)
    assert sites_of(drawn) == set(SITES) - (set() if coupled else {"interface", "ground2"})
    root = ET.fromstring(drawn)
    _, _, width, height = map(float, root.get("viewBox").split())
    for frame in (r for g in root.iter(f"{SVG}g") for r in g.iter(f"{SVG}rect")):
        x, y, w, h = (float(frame.get(k)) for k in ("x", "y", "width", "height"))
        assert min(x, y) >= 0
        assert x + w <= width
        assert y + h <= height
    assert sites_of(drawn, "named") == set()


def test_named_sites_are_highlighted_and_said_to_those_who_cannot_see():
    drawn = sketch("torsional", named=["bearings", "sensor"])
    assert sites_of(drawn, "named") == {"bearings", "sensor"}
    assert "highlighted: bearings, sensor" in ET.fromstring(drawn).get("aria-label")


def test_what_cannot_be_drawn_is_refused_with_what_can():
    with pytest.raises(ValueError, match="torsional, translational, pendulum"):
        sketch("car")
    with pytest.raises(ValueError, match="no such site"):
        sketch("torsional", named=["gearbox"])


def test_a_page_highlights_the_probable_sites_and_none_where_nothing_is_missing():
    rig = {"kind": "translational", "restoring": "linear", "coupled": True, "magnet": False}
    assert sites_of(_sketch(rig, [("bearings", 0.5), ("interface", 0.4), ("none", 0.1)]), "named") == {
        "bearings",
        "interface",
    }
    assert sites_of(_sketch(rig, [("none", 0.8), ("bearings", 0.2)]), "named") == set()
    assert _sketch(None, [("bearings", 1.0)]) == ""  # a file of an earlier version
    assert "pendulum" in _sketch(rig | {"restoring": "pendulum"}, [("bearings", 1.0)])


@pytest.mark.parametrize("kind", KINDS)
def test_the_sketches_of_the_docs_are_those_that_pages_draw(kind):
    shown = (Path(__file__).resolve().parents[2] / "docs" / f"rig_{kind}.svg").read_text(encoding="utf-8")
    assert shown == sketch(kind, paper=True) + "\n", "write it again: python -m bayes_damper.report.sketch docs"
