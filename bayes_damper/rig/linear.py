"""The linear rig in closed form: one and two degrees of freedom, free and under harmonic torque.

Everything here is exact (no time stepping) and takes scalars or arrays of parameter draws alike. Dry friction and the
drag of the bearings belong to equations.py. Equations and pages are those of Augustine (2013).

    J1 a1 + J12 a2 + c1t w1 + k1t th1 + k2t (th1 - th2) + c2t (w1 - w2) = torque1
    J12 a1 + J2 a2 + c3t w2 + k3t th2 - k2t (th1 - th2) - c2t (w1 - w2) = 0            (eq. 17, p. 19)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from bayes_damper.errors import InputError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_TWO_PI = 2.0 * np.pi
_WORST_CONDITION = 1e8  # of the eigenvectors: beyond it (nearly equal eigenvalues) the exponential is taken directly


def _array(x: ArrayLike) -> Array:
    return np.asarray(x, dtype=np.float64)


# One degree of freedom ----------------------------------------------------------------------------------------------


def transmissibility(ratio: ArrayLike, zeta: ArrayLike) -> Array:
    """Torque passed to ground over torque applied, at `ratio` = frequency / natural frequency (eq. 1, p. 2)."""
    r, z = _array(ratio), _array(zeta)
    return _array(np.sqrt((1.0 + (2.0 * z * r) ** 2) / ((1.0 - r**2) ** 2 + (2.0 * z * r) ** 2)))


def natural_frequency(k1t: ArrayLike, J1: ArrayLike) -> Array:
    """Undamped natural frequency, Hz (eq. 6, p. 7)."""
    return _array(np.sqrt(_array(k1t) / _array(J1)) / _TWO_PI)


def stiffness_for(frequency_hz: ArrayLike, J1: ArrayLike) -> Array:
    """Stiffness that gives an inertia this natural frequency, N m/rad (eq. 8, p. 10)."""
    return _array(J1) * (_TWO_PI * _array(frequency_hz)) ** 2


def damping_ratio(c1t: ArrayLike, k1t: ArrayLike, J1: ArrayLike) -> Array:
    """Damping ratio (eqs. 3 and 7, pp. 2, 7)."""
    return _array(c1t) / (2.0 * np.sqrt(_array(k1t) * _array(J1)))


def damping_coefficient(zeta: ArrayLike, k1t: ArrayLike, J1: ArrayLike) -> Array:
    """Viscous coefficient of a damping ratio, N m s/rad (eq. 12, p. 12)."""
    return _array(2.0 * _array(zeta) * np.sqrt(_array(k1t) * _array(J1)))


def potential_energy(k1t: ArrayLike, theta0: ArrayLike) -> Array:
    """Energy in the spring at the angle `theta0` (rad), J (eq. 9, p. 11)."""
    return _array(0.5 * _array(k1t) * _array(theta0) ** 2)


def log_decrement(first: ArrayLike, second: ArrayLike) -> Array:
    """Logarithm of the ratio of two consecutive peaks of the same sign (eq. 10, p. 12)."""
    return _array(np.log(_array(first) / _array(second)))


def damping_ratio_of_decrement(decrement: ArrayLike) -> Array:
    """Damping ratio of a viscous SDOF with this decrement (eq. 11, p. 12)."""
    delta = _array(decrement)
    return _array(delta / np.hypot(delta, _TWO_PI))


def decrement_of_damping_ratio(zeta: ArrayLike) -> Array:
    """The inverse of eq. 11: decrement of a viscous SDOF, 0 <= zeta < 1."""
    z = _array(zeta)
    return _array(_TWO_PI * z / np.sqrt(1.0 - z**2))


def natural_frequency_of_period(period: ArrayLike, zeta: ArrayLike) -> Array:
    """Undamped natural frequency (Hz) of a damped period (s): what leads from Table 7 to Table 4 (pp. 14, 18)."""
    return _array(1.0 / (_array(period) * np.sqrt(1.0 - _array(zeta) ** 2)))


def percent_difference(predicted: ArrayLike, measured: ArrayLike, relative_to: str = "measured") -> Array:
    """Difference in percent of the measurement (eq. 14, p. 14), or of the prediction as Tables 4 and 5 have it."""
    p, m = _array(predicted), _array(measured)
    return _array(100.0 * (p - m) / (p if relative_to == "predicted" else m))


def acceleration_bound(k1t: ArrayLike, theta0: ArrayLike, J1: ArrayLike) -> Array:
    """Magnitude of the acceleration at release, k1t theta0 / J1, rad/s^2 (eq. 16, p. 15); `theta0` in rad."""
    return _array(k1t) * _array(theta0) / _array(J1)


def sdof_response(
    times: ArrayLike, theta0: float, J1: float, k1t: float, c1t: float, omega0: float = 0.0
) -> tuple[Array, Array, Array]:
    """Free angle (rad), velocity (rad/s) and acceleration (rad/s^2) of the primary alone (eqs. 4 and 15, pp. 7, 15).

    Any damping ratio: with critical and stronger damping the same formula holds with its limit and with hyperbolic
    functions. `times` of any shape, s.
    """
    t = _array(times)
    rate = c1t / (2.0 * J1)
    square = k1t / J1 - rate**2
    decay = np.exp(-rate * t)
    if square > 0.0:
        w = np.sqrt(square)
        cosine, sine = decay * np.cos(w * t), decay * np.sin(w * t) / w
    elif square < 0.0:
        w = np.sqrt(-square)
        cosine = 0.5 * (np.exp((w - rate) * t) + np.exp(-(w + rate) * t))
        sine = 0.5 * (np.exp((w - rate) * t) - np.exp(-(w + rate) * t)) / w
    else:
        cosine, sine = decay, decay * t
    theta = theta0 * cosine + (omega0 + rate * theta0) * sine
    omega = omega0 * cosine - (k1t / J1 * theta0 + rate * omega0) * sine
    return theta, omega, -(k1t * theta + c1t * omega) / J1


# Two degrees of freedom ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinearRig:
    """Parameters of the linear model, each a number or an array of draws (all of one shape, or broadcast); SI."""

    J1: ArrayLike
    J2: ArrayLike
    k1t: ArrayLike
    c1t: ArrayLike
    k2t: ArrayLike
    c2t: ArrayLike
    c3t: ArrayLike
    k3t: ArrayLike = 0.0
    J12: ArrayLike = 0.0

    def arrays(self) -> dict[str, Array]:
        """The parameters by name, each of shape (n,).

        Raises
        ------
        InputError
            if an inertia is not positive, the inertia matrix is not positive definite, or a value is not finite.
        """
        names = tuple(self.__dataclass_fields__)
        columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(getattr(self, name), float)) for name in names))
        values = {name: column.ravel() for name, column in zip(names, columns, strict=True)}
        faults = [
            f"{name}: a value of the linear rig is not a finite number; leave such draws out"
            for name, column in values.items()
            if not np.all(np.isfinite(column))
        ]
        faults += [
            f"{name} = {values[name].min():g}: an inertia must be above zero; give it in kg m^2"
            for name in ("J1", "J2")
            if np.any(values[name] <= 0.0)
        ]
        if not faults and np.any(values["J1"] * values["J2"] <= values["J12"] ** 2):
            faults = ["J12: its square must stay below J1 J2, else the kinetic energy is not positive; lower J12"]
        if faults:
            raise InputError(faults)
        return values


def matrices(rig: LinearRig) -> tuple[Array, Array, Array]:
    """Inertia, damping and stiffness matrices of eq. 17, each (n, 2, 2)."""
    p = rig.arrays()

    def symmetric(first: Array, off: Array, second: Array) -> Array:
        return np.stack([np.stack([first, off], -1), np.stack([off, second], -1)], -2)

    return (
        symmetric(p["J1"], p["J12"], p["J2"]),
        symmetric(p["c1t"] + p["c2t"], -p["c2t"], p["c3t"] + p["c2t"]),
        symmetric(p["k1t"] + p["k2t"], -p["k2t"], p["k3t"] + p["k2t"]),
    )


def state_matrix(rig: LinearRig) -> Array:
    """Matrix A of x' = A x with x = (th1, th2, w1, w2); (n, 4, 4)."""
    inertia, damping, stiffness = matrices(rig)
    a = np.zeros((len(inertia), 4, 4))
    a[:, 0, 2] = a[:, 1, 3] = 1.0
    a[:, 2:, :2] = -np.linalg.solve(inertia, stiffness)
    a[:, 2:, 2:] = -np.linalg.solve(inertia, damping)
    return a


@dataclass(frozen=True)
class Response:
    """Free motion of both inertias; every array (n, 2, n_times), angles in rad, SI."""

    times: Array
    angle: Array
    velocity: Array
    acceleration: Array


def free_response(
    rig: LinearRig,
    theta0: ArrayLike,
    times: ArrayLike,
    theta2_0: ArrayLike | None = None,
    omega1_0: ArrayLike = 0.0,
    omega2_0: ArrayLike = 0.0,
) -> Response:
    """Exact free motion after release at t = 0, by the modes of the state matrix.

    theta0 : initial angle of the primary, rad, and of the secondary too where `theta2_0` is not given (p. 11);
    times : (n_times,) s. Draws whose modes nearly coincide are propagated by the matrix exponential instead.
    """  # fmt: skip
    t = np.atleast_1d(_array(times))
    a = state_matrix(rig)
    n = len(a)
    angle2 = theta0 if theta2_0 is None else theta2_0
    starts = [np.broadcast_to(_array(x), (n,)) for x in (theta0, angle2, omega1_0, omega2_0)]
    start = np.stack(starts, -1)
    values, vectors = np.linalg.eig(a)
    # The columns of the state differ in scale by a frequency: condition is judged on a scaled state.
    scale = np.maximum(np.abs(values).max(-1), 1e-300)[:, None]
    scaled = vectors / np.concatenate([np.ones((n, 2)), np.repeat(scale, 2, -1)], -1)[:, :, None]
    good = np.linalg.cond(scaled) < _WORST_CONDITION
    state = np.empty((n, 4, len(t)))
    if good.any():
        weights = np.linalg.solve(vectors[good], start[good, :, None])
        motion = weights * np.exp(values[good, :, None] * t)
        state[good] = (vectors[good] @ motion).real
    for i in np.flatnonzero(~good):
        state[i] = (expm(a[i] * t[:, None, None]) @ start[i]).T
    return Response(t, state[:, :2], state[:, 2:], (a[:, 2:] @ state))


def transfer_function(rig: LinearRig, frequency_hz: ArrayLike) -> ComplexArray:
    """Angle of each inertia over a harmonic torque on the primary, rad/(N m), complex (eq. 23, p. 28).

    frequency_hz : (n_frequencies,), Hz. Returns (n, 2, n_frequencies).
    """
    s = 1j * _TWO_PI * np.atleast_1d(_array(frequency_hz))
    inertia, damping, stiffness = (m[..., None] for m in matrices(rig))
    d: ComplexArray = np.asarray(inertia * s**2 + damping * s + stiffness, dtype=np.complex128)
    determinant = d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] ** 2
    return np.stack([d[:, 1, 1], -d[:, 0, 1]], 1) / determinant[:, None]


def accelerance(rig: LinearRig, frequency_hz: ArrayLike) -> Array:
    """Magnitude of acceleration over torque, 1/(kg m^2), of both inertias: (n, 2, n_frequencies) (p. 29)."""
    w = _TWO_PI * np.atleast_1d(_array(frequency_hz))
    return np.abs(transfer_function(rig, frequency_hz)) * w**2


@dataclass(frozen=True)
class Resonances:
    """Local maxima of the primary's accelerance, by rising frequency; (n, 2) each, NaN where there are fewer."""

    frequency_hz: Array
    accelerance: Array

    @property
    def peak(self) -> Array:
        """The highest accelerance, (n,), 1/(kg m^2); NaN where damping leaves no maximum."""
        return np.where(np.isnan(self.accelerance).all(-1), np.nan, np.fmax(*self.accelerance.T))

    @property
    def peak_frequency_hz(self) -> Array:
        """Where the highest accelerance lies, (n,), Hz."""
        first = ~(self.accelerance[:, 1] > self.accelerance[:, 0])
        return np.where(first, self.frequency_hz[:, 0], self.frequency_hz[:, 1])


def resonances(rig: LinearRig) -> Resonances:
    """Every resonance of the accelerance, exactly: as roots of a polynomial, not by search on a grid.

    With w = omega^2 in units of k1t/J1 the squared accelerance is w^2 P(w)/Q(w), P of degree 2 and Q of degree 4; its
    stationary points are the roots of (2 P + w P') Q - w P Q'. Where there are three maxima, the two highest are kept.
    """
    inertia, damping, stiffness = matrices(rig)
    unit = stiffness[:, 0, 0] / inertia[:, 0, 0]
    scale = np.sqrt(unit)[:, None]

    def square_plus_damping(i: int, j: int) -> Array:
        """Coefficients of M s^2 + C s + K, highest power first, in the scaled s: (n, 3)."""
        return np.stack([inertia[:, i, j] * unit, damping[:, i, j] * scale[:, 0], stiffness[:, i, j]], -1)

    second, off = square_plus_damping(1, 1), square_plus_damping(0, 1)
    denominator = _product(square_plus_damping(0, 0), second) - _product(off, off)
    p, q = _squared_magnitude(second), _squared_magnitude(denominator)
    slope = _product(2.0 * p + _times_derivative(p), q) - _product(p, _times_derivative(q))
    # The leading coefficient cancels: the accelerance tends to a constant at high frequency.
    roots = _roots(slope[:, 1:])
    real = (np.abs(roots.imag) < 1e-7 * np.abs(roots)) & (roots.real > 1e-12)
    ratio = np.where(real, roots.real, np.nan)
    frequency = np.sqrt(ratio) * scale / _TWO_PI
    curvature = _evaluate(_derivative(slope[:, 1:]), ratio)
    maximum = real & (curvature < 0.0)
    w = np.where(maximum, ratio, 1.0)
    height = np.sqrt(w**2 * np.abs(_evaluate(p, w) / np.where(maximum, _evaluate(q, w), 1.0))) * scale**2
    height = np.where(maximum, height, -np.inf)
    best = np.argsort(-height, axis=-1)[:, :2]
    height, frequency = np.take_along_axis(height, best, -1), np.take_along_axis(frequency, best, -1)
    frequency = np.where(np.isfinite(height), frequency, np.nan)
    order = np.argsort(frequency, axis=-1)  # NaN last
    height = np.where(np.isfinite(height), height, np.nan)
    return Resonances(np.take_along_axis(frequency, order, -1), np.take_along_axis(height, order, -1))


def uncoupled_resonance(J1: ArrayLike, k1t: ArrayLike, c1t: ArrayLike) -> tuple[Array, Array]:
    """Frequency (Hz) and height (1/(kg m^2)) of the accelerance peak of the primary alone; NaN for zeta > 0.707."""
    zeta = damping_ratio(c1t, k1t, J1)
    square = 1.0 - 2.0 * zeta**2
    with np.errstate(invalid="ignore", divide="ignore"):
        frequency = natural_frequency(k1t, J1) / np.sqrt(np.where(square > 0.0, square, np.nan))
        peak = 1.0 / (_array(J1) * 2.0 * zeta * np.sqrt(1.0 - zeta**2))
    return frequency, np.where(square > 0.0, peak, np.nan)


def insertion_loss(rig: LinearRig) -> Array:
    """20 log10 of the uncoupled over the coupled peak of the primary's accelerance, dB (eq. 24, p. 29); (n,).

    "Peak" is the highest maximum over all frequencies, of each curve by itself; NaN where one of them has none.
    """
    p = rig.arrays()
    _, without = uncoupled_resonance(p["J1"], p["k1t"], p["c1t"])
    return 20.0 * np.log10(without / resonances(rig).peak)


# Polynomials, one per draw: (n, degree + 1) coefficients, highest power first ---------------------------------------


def _product(a: Array, b: Array) -> Array:
    out = np.zeros((len(a), a.shape[1] + b.shape[1] - 1))
    for i in range(a.shape[1]):
        out[:, i : i + b.shape[1]] += a[:, i : i + 1] * b
    return out


def _derivative(a: Array) -> Array:
    return a[:, :-1] * np.arange(a.shape[1] - 1, 0, -1)


def _times_derivative(a: Array) -> Array:
    """The derivative times x, of the same degree."""
    return a * np.arange(a.shape[1] - 1, -1, -1)


def _evaluate(a: Array, x: Array) -> Array:
    """Values (n, m) at the points x (n, m)."""
    out = np.zeros_like(x)
    for i in range(a.shape[1]):
        out = out * x + a[:, i : i + 1]
    return out


def _squared_magnitude(a: Array) -> Array:
    """|a(i omega)|^2 as a polynomial in omega^2; the degree of `a` is even."""
    even, odd = a[:, ::2].copy(), a[:, 1::2].copy()
    even *= (-1.0) ** np.arange(even.shape[1])[::-1]
    odd *= (-1.0) ** np.arange(odd.shape[1])[::-1]
    out = _product(even, even)
    out[:, 1:-1] += _product(odd, odd)  # i omega factored out: times omega^2
    return out


def _roots(a: Array) -> ComplexArray:
    """Roots (n, degree) by companion matrices."""
    n, degree = len(a), a.shape[1] - 1
    companion = np.zeros((n, degree, degree))
    companion[:, 0] = -a[:, 1:] / a[:, :1]
    companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
    return np.linalg.eigvals(companion).astype(complex)
