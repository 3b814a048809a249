"""What the figures of a fit show."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from bayes_damper import figures
from bayes_damper.fit.drawings import draw_case, draw_overview
from bayes_damper.rig.parameters import unit_of

UNITS = {"k2t": "N m/rad", "effect.k3": "N m/rad^3", "J2": "kg m^2"}


def entry():
    """Numbers of a case fitted with an effect; J2 was given."""
    numbers = {"median": 1.0, "hdi90": [0.8, 1.2], "prior_share": 0.1}
    return {"parameters": {name: numbers | {"unit": unit} for name, unit in UNITS.items()}}


def test_the_parameters_of_an_effect_are_drawn_first(tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(figures, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    draw_overview(tmp_path, {"campaign": "rig", "cases": {"A": entry()}, "converged": True})
    rng = np.random.default_rng(1)
    sampling = SimpleNamespace(draws=np.zeros((2, 60, 10, 1)), log_prob=np.zeros((2, 60, 10)), converged=True)
    draws = {name: rng.standard_normal((2, 600)) for name in UNITS}
    draw_case(tmp_path, "rig", draws, sampling, entry(), {}, lambda name: UNITS.get(name) or unit_of(name))
    titles = {name: [axis.get_title() or axis.get_xlabel() for axis in drawn[name].axes] for name in drawn}
    assert [title.partition(" ")[0] for title in titles["forest"] if title] == ["k3", "k2t"]
    assert [axis.get_xlabel().partition(" ")[0] for axis in drawn["corner"].axes[-2:]] == ["k3", "k2t"]
