"""A sketch of the rig as SVG: bodies, springs, bearings, faces and sensors with their parameters, and the six sites.

One drawing for each kind of rig (torsional, translational, pendulum), with or without a secondary. A page highlights
the site that a diagnosis names. Lines take the colour of the text around them, so the sketch suits dark pages too.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Literal

from bayes_damper.effects.base import SITE_TITLES
from bayes_damper.rig.units import in_words_of

Kind = Literal["torsional", "translational", "pendulum"]
KINDS: tuple[Kind, ...] = ("torsional", "translational", "pendulum")

_STYLE = (
    ".rig{font:13px system-ui,sans-serif;color:inherit}"
    ".rig .line{fill:none;stroke:currentColor;stroke-width:1.6;stroke-linecap:round;stroke-linejoin:round}"
    ".rig .body{fill:currentColor;fill-opacity:.1;stroke:currentColor;stroke-width:1.6}"
    ".rig text{fill:currentColor;text-anchor:middle}"
    ".rig .site rect{fill:none;stroke:#0072b2;stroke-width:1;stroke-dasharray:4 4}"
    ".rig .site text{fill:#0072b2;font-weight:600}"
    ".rig .named rect{fill:#d55e00;fill-opacity:.16;stroke:#d55e00;stroke-width:2.5;stroke-dasharray:none}"
    ".rig .named text{fill:#d55e00}"
)
_DARK = (
    "@media(prefers-color-scheme:dark){.rig .site rect{stroke:#56b4e9}.rig .site text{fill:#56b4e9}"
    ".rig .named rect{fill:#ff9348;stroke:#ff9348}.rig .named text{fill:#ff9348}}"
)
"""The same on a page that follows the reader's dark scheme; a file of its own is black on white in any."""

Box = tuple[float, float, float, float]  # x, y, width, height


@dataclass(frozen=True)
class _Drawing:
    """Parts as SVG, frames of each site (the first bears the title), height, sites whose title stands below."""

    parts: list[str]
    boxes: dict[str, list[Box]]
    height: float
    below: frozenset[str] = frozenset()
    titles: Mapping[str, str] = field(default_factory=dict)


def sketch(
    kind: Kind = "torsional",
    *,
    coupled: bool = True,
    named: Collection[str] = (),
    magnet: bool = True,
    paper: bool = False,
) -> str:
    """The rig as one `<svg>` element, 760 by at most 330 units.

    Parameters
    ----------
    kind : which rig: discs on a shaft, carts on a rail, or links that hang.
    coupled : whether there is a secondary.
    named : sites to highlight (see `bayes_damper.effects.base.SITES`).
    magnet : whether a magnet presses the faces together; without one they are joined by springs and friction.
    paper : black on white, for a file of its own.

    Raises
    ------
    ValueError
        For a kind or a site that does not exist.
    """
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; give one of {', '.join(KINDS)}")
    if wrong := set(named) - set(SITE_TITLES):
        raise ValueError(f"{sorted(wrong)}: no such site; sites are {', '.join(SITE_TITLES)}")
    draw = {"torsional": _torsional, "translational": _translational, "pendulum": _pendulum}[kind]
    drawn = draw(coupled, magnet)
    titles = {s: in_words_of(t, kind) for s, t in (SITE_TITLES | dict(drawn.titles)).items()}
    sites = [_site(s, boxes, titles[s], s in named, s in drawn.below) for s, boxes in drawn.boxes.items()]
    bodies = "one body" if not coupled else "two bodies"
    label = f"Sketch of a {kind} rig with {bodies}" + (f"; highlighted: {', '.join(sorted(named))}" if named else "")
    sheet = '<rect width="100%" height="100%" fill="#fff"/>' if paper else ""
    inside = f"<style>{_STYLE}{'' if paper else _DARK}</style>" + sheet + "".join(sites) + "".join(drawn.parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="rig" viewBox="0 0 760 {drawn.height:g}" role="img" '
        f'aria-label="{escape(label)}">{inside}</svg>'
    )


def _site(name: str, boxes: list[Box], title: str, named: bool, below: bool) -> str:
    """Frames around the parts of one site, with its title over or below the first."""
    frames = "".join(f'<rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="8"/>' for x, y, w, h in boxes)
    x, y, w, h = boxes[0]
    return (
        f'<g class="site{" named" if named else ""}" data-site="{name}">{frames}'
        f'<text x="{x + w / 2:g}" y="{y + h + 16 if below else y - 6:g}">{title}</text></g>'
    )


def _line(*points: tuple[float, float]) -> str:
    return f'<polyline class="line" points="{" ".join(f"{x:g},{y:g}" for x, y in points)}"/>'


def _text(x: float, y: float, words: str) -> str:
    """A label; `_` begins a subscript that ends with the word: k_1t."""
    out = []
    for word in words.split(" "):
        base, _, below = word.partition("_")
        sub = f'<tspan dy="4" font-size="10">{escape(below)}</tspan><tspan dy="-4">&#8203;</tspan>' if below else ""
        out.append(escape(base) + sub)
    return f'<text x="{x:g}" y="{y:g}">{" ".join(out)}</text>'


def _body(x: float, y: float, w: float, h: float, name: str) -> str:
    return f'<rect class="body" x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="4"/>' + _text(
        x + w / 2, y + h / 2 + 5, name
    )


def _wall(x: float, y: float, h: float, side: int) -> str:
    """Ground: a line with hatching on the side away from the rig (-1 left, 1 right)."""
    hatch = [_line((x, y + d), (x + 9 * side, y + d + 9)) for d in range(0, int(h) - 4, 12)]
    return _line((x, y), (x, y + h)) + "".join(hatch)


def _floor(x0: float, x1: float, y: float) -> str:
    return _line((x0, y), (x1, y)) + "".join(_line((x, y), (x - 8, y + 8)) for x in range(int(x0) + 10, int(x1), 14))


def _spring(x0: float, x1: float, y: float) -> str:
    n, lead = 6, 0.18 * (x1 - x0)
    step = (x1 - x0 - 2 * lead) / n
    teeth = [(x0 + lead + (i + 0.5) * step, y + (9 if i % 2 else -9)) for i in range(n)]
    return _line((x0, y), (x0 + lead, y), *teeth, (x1 - lead, y), (x1, y))


def _dashpot(x0: float, x1: float, y: float) -> str:
    middle = (x0 + x1) / 2
    return (
        _line((x0, y), (middle - 8, y))
        + _line((middle + 12, y - 9), (middle - 8, y - 9), (middle - 8, y + 9), (middle + 12, y + 9))
        + _line((middle + 4, y - 6), (middle + 4, y + 6))
        + _line((middle + 4, y), (x1, y))
    )


def _slider(x0: float, x1: float, y: float) -> str:
    """Two faces that rub."""
    middle = (x0 + x1) / 2
    return _line((x0, y - 3), (middle + 14, y - 3)) + _line((middle - 14, y + 3), (x1, y + 3))


def _bearing(x: float, y: float) -> str:
    """A plain bearing around a shaft at height y."""
    pads = "".join(f'<rect class="body" x="{x - 14:g}" y="{y + d:g}" width="28" height="9"/>' for d in (-16, 7))
    return pads + _floor(x - 20, x + 22, y + 24)


def _sensor(x: float, y: float) -> str:
    return f'<circle class="body" cx="{x:g}" cy="{y:g}" r="6"/>' + _line((x, y - 6), (x, y - 16))


def _turn(x: float, y: float, name: str) -> str:
    """An arrow around the shaft, with the angle it counts."""
    arrow = _line((x + 4, y - 32), (x + 12, y - 28), (x + 13, y - 37))
    return (
        f'<path class="line" d="M {x:g} {y + 16:g} A 9 26 0 1 1 {x + 12:g} {y - 28:g}"/>'
        + arrow
        + _text(x, y + 36, name)
    )


def _torsional(coupled: bool, magnet: bool) -> _Drawing:
    shaft = 150.0
    parts = [
        _wall(40, shaft - 45, 90, -1), _spring(40, 118, shaft), _text(79, shaft + 32, "k_1t"),
        _line((118, shaft), (262, shaft)), _bearing(165, shaft), _text(165, shaft - 24, "c_1t"),
        _text(165, shaft + 50, "drag"), _body(262, 70, 44, 160, "J_1"), _sensor(284, 56), _turn(225, shaft, "θ_1"),
        _text(196, 281, "angle θ_0 held, then let go"),
    ]  # fmt: skip
    boxes: dict[str, list[Box]] = {
        "ground1": [(28, 96, 98, 104)],
        "bearings": [(140, 112, 50, 98)],
        "sensor": [(270, 34, 28, 32)],
        "release": [(98, 262, 196, 28)],
    }
    if coupled:
        faces = "magnet N_0 , Teflon" if magnet else "faces"
        parts += [
            _spring(306, 440, 102), _text(373, 88, "k_2t"), _dashpot(306, 440, 138), _text(373, 164, "c_2t"),
            _slider(306, 440, 184), _text(373, 206, "μ N_0 R" if magnet else "μ"), _text(373, 224, faces),
            _body(440, 70, 44, 160, "J_2"), _sensor(462, 56), _line((484, shaft), (640, shaft)),
            _turn(522, shaft, "θ_2"), _bearing(588, shaft), _text(588, shaft - 24, "c_3t"),
            _text(588, shaft + 50, "drag"),
            _spring(640, 706, shaft), _text(672, shaft + 32, "k_3t"), _wall(706, shaft - 45, 90, 1),
        ]  # fmt: skip
        boxes["bearings"].append((563, 112, 50, 98))
        boxes["sensor"].append((448, 34, 28, 32))
        boxes["interface"] = [(309, 66, 128, 168)]
        boxes["ground2"] = [(632, 96, 88, 104)]
    return _Drawing(parts, boxes, 300.0, frozenset({"interface"}))


def _translational(coupled: bool, magnet: bool) -> _Drawing:
    rail = 200.0
    wheels = [
        f'<circle class="body" cx="{x}" cy="{rail - 7}" r="7"/>' for x in (250, 310, *((490, 550) if coupled else ()))
    ]
    parts = [
        _wall(40, 90, 110, -1), _floor(40, 720, rail), *wheels,
        _spring(40, 220, 118), _text(130, 104, "k_1"), _body(220, 90, 120, 96, "m_1"), _sensor(280, 76),
        _text(280, 244, "c_1 , drag"), _text(140, 262, "x_0 held, then let go"),
    ]  # fmt: skip
    boxes: dict[str, list[Box]] = {
        "ground1": [(52, 88, 160, 62)],
        "bearings": [(232, 183, 96, 68)],
        "sensor": [(266, 54, 28, 32)],
        "release": [(60, 246, 160, 26)],
    }
    if coupled:
        parts += [
            _spring(340, 460, 104), _text(400, 88, "k_2"), _dashpot(340, 460, 136), _text(434, 128, "c_2"),
            _slider(340, 460, 164), _text(400, 184, "μ N_0" if magnet else "friction μ"),
            _body(460, 90, 120, 96, "m_2"), _sensor(520, 76), _text(520, 244, "c_3 , drag"),
            _spring(580, 706, 118), _text(643, 104, "k_3"), _wall(706, 90, 110, 1),
        ]  # fmt: skip
        boxes["bearings"].append((472, 183, 96, 70))
        boxes["sensor"].append((506, 54, 28, 32))
        boxes["interface"] = [(348, 72, 104, 122)]
        boxes["ground2"] = [(588, 88, 110, 62)]
    return _Drawing(parts, boxes, 288.0, frozenset({"bearings"}))


def _pendulum(coupled: bool, magnet: bool) -> _Drawing:
    del magnet  # links are joined by a bearing
    x, y = 330.0, 60.0
    x1, y1 = x + 70, y + 120
    parts = [
        _floor(x - 26, x + 60, y - 26), f'<circle class="body" cx="{x:g}" cy="{y:g}" r="11"/>',
        _line((x, y - 26), (x, y - 11)), _line((x, y + 11), (x, y + 130)), _line((x + 6, y + 9), (x1 - 10, y1 - 17)),
        f'<circle class="body" cx="{x1:g}" cy="{y1:g}" r="20"/>', _text(x1, y1 + 5, "J_1"),
        _text(x + 22, y + 86, "θ_1"), _text(x - 122, y + 6, "c_1t , drag"),
        _text(x - 118, y + 92, "gravity k_1t sin θ_1"), _text(x + 200, y + 6, "encoder"),
        _text(x - 118, y + 190, "angle θ_0 held, then let go"),
    ]  # fmt: skip
    boxes: dict[str, list[Box]] = {
        "bearings": [(x - 164, y - 14, 184, 30)],
        "ground1": [(x - 190, y + 74, 144, 28)],
        "sensor": [(x + 164, y - 14, 72, 32)],
        "release": [(x - 212, y + 172, 188, 28)],
    }
    if coupled:
        x2, y2 = x1 + 90, y1 + 76
        parts += [
            _line((x1 + 15, y1 + 13), (x2 - 12, y2 - 10)), f'<circle class="body" cx="{x2:g}" cy="{y2:g}" r="16"/>',
            _text(x2, y2 + 5, "J_2"), _text(x1 + 92, y1 + 6, "joint: c_2t , μ"),
            _text(x2 + 118, y2 + 5, "gravity k_3t sin θ_2"),
        ]  # fmt: skip
        boxes["interface"] = [(x1 + 38, y1 - 14, 112, 30)]
        boxes["ground2"] = [(x2 + 42, y2 - 14, 152, 30)]
    return _Drawing(parts, boxes, 290.0, titles={"ground1": "restoring torque"})


if __name__ == "__main__":
    for each in KINDS:
        (Path(sys.argv[1]) / f"rig_{each}.svg").write_text(sketch(each, paper=True) + "\n", encoding="utf-8")
