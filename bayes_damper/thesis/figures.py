"""Data of Figures 2, 6, 8, 10-13; nothing is plotted here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayes_damper.rig import linear
from bayes_damper.rig.linear import LinearRig
from bayes_damper.simulation.model import Model
from bayes_damper.thesis.printed import CASE_IV_DAMPING, LAWS, printed_case, table_12
from bayes_damper.thesis.rig import FINE, J1, linear_rig, nonlinear_rig, secondary_inertia

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """The data of one figure: label -> (x, y), with the names of the axes; printed: peaks given in numbers."""

    page: int
    x: str
    y: str
    curves: Mapping[str, tuple[Array, Array]]
    note: str
    printed: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)


def figures() -> dict[str, Figure]:
    """Data of Figures 2, 6, 8, 10-13; measured curves were not published, so they are left out."""
    p = printed_case("IV")
    theta0 = np.deg2rad(float(p.theta0))
    base = linear_rig("IV")
    f = np.linspace(0.05, 50.0, 2000)
    time, acceleration = "time (s)", "angular acceleration (rad/s^2)"
    response = linear.free_response(base, theta0, FINE).acceleration[0]
    alone = linear.sdof_response(FINE, theta0, J1, float(p.k1t), CASE_IV_DAMPING)[2]
    rigs = {
        "with effective stiffness": base,
        "no effective stiffness": linear_rig("IV", k2t=0.0),
        "undamped coupling": linear_rig("IV", c2t=0.0),
        "uncoupled": linear_rig("IV", k2t=0.0, c2t=0.0),
    }
    spectra = {name: linear.accelerance(rig, f)[0, 0] for name, rig in rigs.items()}
    tuned = linear.accelerance(linear_rig("IV", J2=secondary_inertia() / 8), f)[0, 0]
    peaks = {
        name: (np.array([float(f0) for f0, _ in rows]), np.array([float(height) for _, height in rows]))
        for name, rows in table_12().items()
    }
    nonlinear = {}
    for law, mu in LAWS:
        y = Model(normal_force=law).simulate(nonlinear_rig(mu), FINE).y[0]
        for inertia, curve in zip(("primary", "secondary"), y, strict=True):
            nonlinear[f"{inertia}, {law} normal force, mu = {mu}"] = (FINE, curve)
    both = {"primary": (FINE, response[0]), "secondary": (FINE, response[1])}
    return {
        "Figure 2": _transmissibilities(),
        "Figure 6": Figure(
            17, time, acceleration, {"uncoupled": (FINE, alone)} | both, "Models of the two measured records."
        ),
        "Figure 8": Figure(20, time, acceleration, both, "Case IV. The thesis draws it with the opposite sign."),
        "Figure 10": Figure(
            26, time, acceleration, nonlinear, "Without drag, nu = 50 s/rad, R = 0.10 m: none is printed."
        ),
        "Figure 11": Figure(
            *(29, "frequency (Hz)", "accelerance (1/(kg m^2))"),
            {
                "uncoupled": (f, spectra["uncoupled"]),
                "untuned": (f, spectra["with effective stiffness"]),
                "tuned, J2/8": (f, tuned),
            },
            "The thesis's ordinate ends at 800; the uncoupled peak is 5340.",
            {"uncoupled": peaks["uncoupled"], "untuned": peaks["with effective stiffness"]},
        ),
        "Figure 12": Figure(
            *(31, "frequency (Hz)", "accelerance (1/(kg m^2))", {name: (f, a) for name, a in spectra.items()}),
            "The thesis's ordinate ends at 1200.",
            peaks,
        ),
        "Figure 13": Figure(
            *(32, time, acceleration),
            {name: (FINE, linear.free_response(rig, theta0, FINE).acceleration[0, 0]) for name, rig in rigs.items()},
            "Captioned as a frequency response.",
        ),
    }


def _transmissibilities() -> Figure:
    """Figure 2 (p. 2): eq. 1 at zeta = 0.07, and the torque passed to ground by the rig with each secondary."""
    ratio = np.linspace(0.6, 2.0, 701)
    zeta, k1t = 0.07, 10.2
    c1t = float(linear.damping_coefficient(zeta, k1t, J1))
    w = ratio * np.sqrt(k1t / J1)
    j2 = float(secondary_inertia())

    def passed(k2t: float, c2t: float) -> Array:
        h = linear.transfer_function(LinearRig(J1, j2, k1t, c1t, k2t, c2t, 0.0), w / (2 * np.pi))[0, 0]
        return np.array(np.abs(h * (k1t + 1j * w * c1t)))

    return Figure(
        *(2, "frequency / natural frequency", "torque to ground / torque applied"),
        {
            "primary alone": (ratio, linear.transmissibility(ratio, zeta)),
            "with absorber": (ratio, passed(k1t * j2 / J1, 0.0)),
            "inertia damper": (ratio, passed(0.0, 0.08)),
        },
        "k2t of the absorber tunes it to the primary; c2t of the inertia damper is that of case IV: neither is "
        "printed.",
    )
