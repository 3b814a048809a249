"""How far a fit hangs on each trial, and what it would be without some.

The former comes from the linearised problem of a best fit (calibration), at the price of small matrices: with S the
precision of all unknowns and S_j, g_j what trial j (its nuisances eliminated) adds to it and to the gradient, the best
fit without that trial lies (S - S_j)^-1 g_j away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment
from bayes_damper.calibration.correlated_noise import FittedNoise, fit_with_noise
from bayes_damper.runs.contents.fit import Compared

Array = NDArray[np.float64]


def influence(fit: Calibration) -> dict[int, Array]:
    """Shift of the best fit when a trial is left out: trial -> (size,), in posterior standard deviations.

    The rest of the trials is taken as linear in the unknowns, which is good for shifts up to one or two.
    """
    normals = fit.linear.normal()
    S, _, _ = normals.reduced()
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
    out = {}
    for block, H, TJ, gT in normals.parts:
        for k, i in enumerate(block.group.trials):
            J, r = block.J[k], block.r[k]
            own_S, own_g = J @ J.T, J @ r
            if H.shape[1]:
                lever = np.linalg.solve(H[k], TJ[k])
                own_S = own_S - TJ[k].T @ lever
                own_g = own_g - lever.T @ gT[k]
            out[i] = np.linalg.solve(S - own_S, own_g) / sd
    return out


def without(experiment: Experiment, trials: tuple[int, ...], kind: str) -> FittedNoise | None:
    """The best fit when some trials are left out; None where too little is left (a whole configuration would go)."""
    kept = tuple(t for i, t in enumerate(experiment.trials) if i not in trials)
    before = {(t.case, t.coupled) for t in experiment.trials if not t.heldout}
    if {(t.case, t.coupled) for t in kept if not t.heldout} != before:
        return None
    return fit_with_noise(replace(experiment, trials=kept), kind)


def comparison(fit: Calibration, other: Calibration) -> dict[str, Compared]:
    """Unknown -> value and standard deviation with all trials and without some, and the shift in the former's sds."""
    a, b = fit.parameters, other.parameters
    return {
        name: {
            "with": {"value": a[name][0], "sd": a[name][1]},
            "without": {"value": b[name][0], "sd": b[name][1]},
            "shift_sd": (b[name][0] - a[name][0]) / a[name][1] if a[name][1] > 0.0 else 0.0,
        }
        for name in a
        if name in b
    }
