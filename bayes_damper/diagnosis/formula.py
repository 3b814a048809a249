"""What the formula of an effect, right in kind but not to the last digit, leaves open about the parameters.

An effect of the library is a family: its formula stands for others that differ by a share of their torque. Where such a
difference looks like one of the nominal laws, the records cannot show how much of the torque belongs to which, however
small the residuals are: the tail of a Stribeck hump is a dry friction, a second relaxation time a damping. So a
discrepancy is added where the effect lives (Kennedy and O'Hagan, JRSS B 63 (2001) 425, with what is known of the
physics): generic laws of its site (shapes.py), Gaussian coefficients, of which all together change the records SHARE
times as much as the effect does. They are integrated out in the linearised problem: with A what the parameters give way
to a law, G the Gram matrix of the laws beyond parameters and nuisances, b their product with the residuals,

    c = (G + prior^-1)^-1 b,    covariance = S^-1 + A (G + prior^-1)^-1 A' + A c c' A'.

The last term is the move of the parameters that the residuals ask for: the fit's own values are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_damper.calibration import Calibration
from bayes_damper.diagnosis.response import in_slices, motions, project, whiten
from bayes_damper.diagnosis.shapes import scale_of_motions, shapes_of

SHARE = 0.2
"""Of the change that an effect makes to the records, by which formulas of one family differ: between the two best of a
family it is 0.1 to 0.5, about 0.2 in the middle (seven families of the library, each fitted to a campaign)."""
LAWS = {
    "ground1": ("law", "spring", "memory"),
    "bearings": ("drag", "load"),
    "interface": ("law", "friction", "damping", "magnet", "memory"),
    "ground2": ("law", "weight", "spring", "drag", "memory"),
}
"""Groups of shapes.py that stand for another formula of an effect; at the other sites a formula is a definition."""


def widened(fit: Calibration, sites: Sequence[str], share: float = SHARE) -> Calibration:
    """The fit with the covariance that its effects' inexact formulas leave; sites: those of the effects.

    The fit itself comes back where no torque law is added: errors of constants, sensors, the release.
    """
    laws = {(site, group) for site in sites for group in LAWS.get(site, ())}
    if not laws:
        return fit
    whole, fit = fit, in_slices(fit)
    moved = motions(fit)
    if not any(np.any(m.added) for m in moved):
        return whole
    scale = scale_of_motions(moved)
    coupled = any(m.group.coupled for m in moved)
    columns, size = [], 0.0
    for m in moved:
        own = [s for s in shapes_of(m, scale, coupled) if (s.site, s.group) in laws]
        nothing = np.zeros_like(m.th1)
        q1 = np.stack([m.added[:, 0], *(nothing if s.q1 is None else s.q1 for s in own)], axis=1)
        q2 = np.stack([m.added[:, 1], *(nothing if s.q2 is None else s.q2 for s in own)], axis=1)
        y = whiten(fit, m.group, m.respond(q1, q2))
        size += float(np.sum(y[:, 0] ** 2))
        columns.append(y[:, 1:])
    judged = project(fit, columns)
    alive = judged.raw > 1e-12 * size
    count = int(np.count_nonzero(alive))
    gram = judged.gram[np.ix_(alive, alive)]
    give_way = judged.absorbed[:, alive]
    inside = gram + np.diag(judged.raw[alive]) * count / (share**2 * size)
    solved = np.linalg.solve(inside, np.column_stack([give_way.T, judged.product[alive]]))
    shift = give_way @ solved[:, -1]
    open_ = give_way @ solved[:, :-1] + np.outer(shift, shift)
    covariance = fit.covariance + 0.5 * (open_ + open_.T)
    return replace(whole, covariance=covariance) if np.all(np.isfinite(covariance)) else whole
