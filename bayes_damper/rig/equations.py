"""The nominal rig: two inertias, a spring to ground, bearings, and the magnetic interface between them.

    J1 a1 + J12 a2 + c1t w1 + k1t g(th1) + drag s(nu w1) + T = torque1(t) + Q1
    J12 a1 + J2 a2 + c3t w2 + k3t g(th2) + drag2 s(nu w2) - T = torque2(t) + Q2,    drag2 = drag drag_ratio
    T = k2t phi + c2t (w1 - w2) + mu N R s(nu (w1 - w2)),    phi = th1 - th2
    N = N0 max(0, 1 - R |phi| / (2 r))   or   N = N0,    g(th) = th   or   sin(th)
    s(x) = tanh(x)   or, with `tail`, another curve from -1 to 1 (vector_math.smooth_sign_scaled)

Augustine (2013), eqs. 17-20, where drag_ratio is 1; Q1, Q2 are what an effect adds. The uncoupled rig keeps the first
line without T and J12.
Here live the torques and their Jacobian, as kernels of plain floats; stepping in time is integrator.py's.
"""

from __future__ import annotations

from typing import NamedTuple

from bayes_damper.rig.vector_math import TANH_SCALE, cos, lane, sin, smooth_sign_scaled, tanh_scaled

ROWS = (
    *("J1", "J2", "J12", "k1t", "k3t", "c1t", "c3t", "k2t", "c2t", "mu", "N0", "R", "r", "drag", "drag_ratio"),
    *("nu", "tail", "theta0", "theta2_0", "omega1_0", "omega2_0", "delay", "release_time"),
)
"""What one simulation needs, in the order of the kernel's rows (SI; angles in rad, delay and release_time in s).

While t < release_time, what holds the primary at theta0 still holds by k1t g(theta0) (1 - t / release_time)."""


class Rig(NamedTuple):
    """The rig's constants and parameters as an effect sees them.

    slope : R / (2 r) where the pull falls with the overlap of the faces, 0 where it is constant.
    """

    J1: float
    J2: float
    J12: float
    k1t: float
    k3t: float
    c1t: float
    c3t: float
    k2t: float
    c2t: float
    mu: float
    N0: float
    R: float
    r: float
    drag: float
    nu: float
    tail: float
    theta0: float
    slope: float


@lane
def normal_force_ratio(phi: float, slope: float) -> float:
    """N / N0 (eq. 20, p. 24): 1 at full overlap of the faces, 0 beyond the last; slope = R / (2 r), 0 if constant."""
    return max(0.0, 1.0 - slope * abs(phi))


@lane
def smooth_torques(th1, th2, w1, w2, k1t, k3t, c1t, c3t, k2t, c2t, coupled, pendulum):
    """Torque of springs and dashpots on each inertia, N m."""
    g1 = sin(th1) if pendulum else th1
    tau1 = -c1t * w1 - k1t * g1
    tau2 = 0.0
    if coupled:
        g2 = sin(th2) if pendulum else th2
        interface = k2t * (th1 - th2) + c2t * (w1 - w2)
        tau1 = tau1 - interface
        tau2 = interface - c3t * w2 - k3t * g2
    return tau1, tau2


@lane
def _sign(y, tail, curved):
    """s(x) at x = y / TANH_SCALE and its derivative; `tail` counts where `curved`."""
    if curved:
        return smooth_sign_scaled(y, tail)
    s = tanh_scaled(y)
    return s, 1.0 - s * s


@lane
def friction_torques(th1, th2, w1, w2, friction, slope, drag, drag2, sharpness, tail, curved, coupled):
    """Dry friction that holds each inertia back, N m; friction = mu N0 R, sharpness = TANH_SCALE nu."""
    held1 = drag * _sign(sharpness * w1, tail, curved)[0]
    held2 = 0.0
    if coupled:
        face = friction * normal_force_ratio(th1 - th2, slope) * _sign(sharpness * (w1 - w2), tail, curved)[0]
        held2 = drag2 * _sign(sharpness * w2, tail, curved)[0] - face
        held1 = held1 + face
    return held1, held2


@lane
def linearised(
    th1, th2, w1, w2, k1t, k3t, c1t, c3t, k2t, c2t, friction, slope, drag, drag2, nu, tail, curved, coupled, pendulum
):
    """Nominal torques with their derivatives; friction = mu N0 R.

    Returns tau1, tau2, then d tau1/d th1, d tau2/d th2, d T/d phi, d tau1/d w1, d tau2/d w2, d T/d slip, where the
    diagonal entries leave the interface torque T out: it enters both equations with opposite signs.
    """
    sharpness = TANH_SCALE * nu
    g1 = sin(th1) if pendulum else th1
    slope1 = cos(th1) if pendulum else 1.0
    s1, steep1 = _sign(sharpness * w1, tail, curved)
    tau1 = -c1t * w1 - k1t * g1
    a1 = -k1t * slope1
    b1 = -c1t - drag * nu * steep1
    tau2 = 0.0
    a2 = 0.0
    b2 = 0.0
    t_phi = 0.0
    t_slip = 0.0
    if coupled:
        g2 = sin(th2) if pendulum else th2
        slope2 = cos(th2) if pendulum else 1.0
        s2, steep2 = _sign(sharpness * w2, tail, curved)
        phi = th1 - th2
        slip = w1 - w2
        s, steep = _sign(sharpness * slip, tail, curved)
        ratio = normal_force_ratio(phi, slope)
        smooth = k2t * phi + c2t * slip
        face = friction * ratio * s
        tau1 = (tau1 - smooth) - (drag * s1 + face)
        tau2 = (smooth - c3t * w2 - k3t * g2) - (drag2 * s2 - face)
        a2 = -k3t * slope2
        b2 = -c3t - drag2 * nu * steep2
        side = (slope if phi < 0.0 else -slope) if ratio > 0.0 else 0.0
        t_phi = k2t + friction * side * s
        t_slip = c2t + friction * ratio * nu * steep
    else:
        tau1 = tau1 - drag * s1
    return tau1, tau2, a1, a2, t_phi, b1, b2, t_slip
