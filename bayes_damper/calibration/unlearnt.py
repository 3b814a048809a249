"""Evidence of a fit whose trials have no repeats, with the sizes of what scatters integrated out.

Without repeats no size of a scatter is learnt. Held at a typical one, own values three times as large cost nine times
as many nats, and an effect that spares some of them gains what it spares, on a rig that only scatters more. So the
evidence is integrated over the sizes with their priors (scatter.py), for every model alike:

    Z = integral p(u) Z(u) du,   u = ln(size / typical size),

by Laplace's method. Z(u) is that of the problem linearised at the fit, in which a size multiplies the columns T of its
own values, so that grams are all that it needs. Of sizes that the trials say nothing of, the integral is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_damper.calibration.free_starts import single_releases
from bayes_damper.calibration.normal_equations import Normals
from bayes_damper.calibration.problem import Problem

Array = NDArray[np.float64]
FREEDOM = 4.0  # of the half Student t that is the prior of a size
SMALLEST, LARGEST = -5.0, 3.5  # of u
STEP = 1e-3  # of u, in differences of slopes


def log_prior(u: Array) -> Array:
    """Log density, up to a constant, of the logarithm u of a size over its typical one."""
    return np.asarray(u - 0.5 * (FREEDOM + 1.0) * np.log1p(np.exp(2.0 * u) / FREEDOM))


def prior_slope(u: Array) -> Array:
    """Derivative of `log_prior`."""
    z = np.exp(2.0 * u) / FREEDOM
    return np.asarray(1.0 - (FREEDOM + 1.0) * z / (1.0 + z))


@dataclass(frozen=True, eq=False)
class Part:
    """Trials with the same own values: products of derivatives, and of residuals, those with all own values at 0.

    place (m,): size of each own value, -1 for none; TT (trials, m, m); TJ (trials, m, size); Tr (trials, m).
    """

    place: NDArray[np.intp]
    TT: Array
    TJ: Array
    Tr: Array


@dataclass(frozen=True, eq=False)
class Unlearnt:
    """The linearised problem as a function of the sizes.

    start (sizes,): u of the fit, without the sizes that single records show; q (size,); JJ (size, size), Jr (size,),
    rr: sums over all trials.
    """

    start: Array
    q: Array
    JJ: Array
    Jr: Array
    rr: float
    parts: tuple[Part, ...]

    @classmethod
    def of(cls, problem: Problem, normals: Normals) -> Unlearnt:
        """From the normal equations of a problem at a fit."""
        sizes = problem.switches.scatter.from_trial_to_trial
        which = {name: k for k, size in enumerate(sizes) for name, _ in size.columns}
        q = normals.linear.q
        Jr, rr, parts = normals.g - q, normals.cost - float(q @ q), []
        for block, H, TJ, gT in normals.parts:
            low, high = block.group.lower, block.group.upper
            near = 1e-6 * (high - low)  # own values pressed against an end of their range can take nothing up
            held = ((block.eta - low < near) & (gT > 0.0)) | ((high - block.eta < near) & (gT < 0.0))
            eta, free = np.where(held, 0.0, block.eta), np.where(held, 0.0, 1.0)
            TT = H - np.eye(H.shape[1])
            Tr = gT - block.eta
            Jr = Jr - np.einsum("jmk,jm->k", TJ, eta)
            rr -= float(np.sum(block.eta**2) + 2.0 * np.sum(Tr * eta) - np.einsum("jm,jmn,jn->", eta, TT, eta))
            place = np.array([which.get(name, -1) for name, _, _ in block.group.nuisances], dtype=np.intp)
            Tr = (Tr - np.einsum("jmn,jn->jm", TT, eta)) * free
            parts.append(Part(place, TT * free[:, :, None] * free[:, None], TJ * free[:, :, None], Tr))
        start = np.log([size.sd / size.typical for size in sizes])
        return cls(start, q, normals.S - np.eye(q.size), Jr, rr, tuple(parts))

    def log_evidence(self, u: Array) -> tuple[float, Array]:
        """Log Z(u), up to a constant, and its slopes by u (sizes,).

        A slope is the sum over own values of <eta^2> - 1 in units of their size, as in the EM algorithm.
        """
        S, g, least, log_det = self.JJ + np.eye(self.q.size), self.q + self.Jr, self.rr + float(self.q @ self.q), 0.0
        made = []
        for part in self.parts:
            factor = np.where(part.place >= 0, np.exp(u - self.start)[part.place], 1.0)
            H = part.TT * np.multiply.outer(factor, factor) + np.eye(factor.size)
            inverse = np.linalg.inv(H)
            TJ, Tr = part.TJ * factor[:, None], part.Tr * factor
            pulled, own = inverse @ TJ, np.einsum("jmn,jn->jm", inverse, Tr)
            S -= np.einsum("jmk,jml->kl", TJ, pulled)
            g = g - np.einsum("jmk,jm->k", TJ, own)
            least -= float(np.sum(Tr * own))
            log_det += float(np.sum(np.linalg.slogdet(H)[1]))
            made.append((part.place, inverse, pulled, own))
        covariance = np.linalg.inv(S)
        dq = -covariance @ g
        slopes = np.zeros(u.size)
        for place, inverse, pulled, own in made:
            eta = -own - pulled @ dq
            square = eta**2 + np.einsum("jmm->jm", inverse) + np.einsum("jmk,kl,jml->jm", pulled, covariance, pulled)
            np.add.at(slopes, place[place >= 0], np.sum(square - 1.0, axis=0)[place >= 0])
        return -0.5 * (least + float(g @ dq) + log_det + float(np.linalg.slogdet(S)[1])), slopes

    def mode(self) -> Array:
        """The likeliest u (sizes,), with the prior."""
        bounds = [(SMALLEST, LARGEST)] * self.start.size
        found = minimize(self._minus_log, np.zeros(self.start.size), jac=True, method="L-BFGS-B", bounds=bounds)
        return np.asarray(found.x)

    def gained(self) -> float:
        """Nats that the evidence gains where the sizes are integrated over, instead of those of the fit."""
        u = self.mode()
        log_det = _log_curvature(lambda at: self._minus_log(at)[1], u)
        value = -self._minus_log(u)[0] - self.log_evidence(self.start)[0]
        return value - 0.5 * log_det - _LOG_PRIOR * self.start.size

    def _minus_log(self, u: Array) -> tuple[float, Array]:
        value, slopes = self.log_evidence(u)
        return -value - float(np.sum(log_prior(u))), -slopes - prior_slope(u)


def _log_curvature(slopes: Callable[[Array], Array], at: Array) -> float:
    """Log determinant of the curvature at a point; along what has less than the prior's least there, of that."""
    rows = [(slopes(at + step) - slopes(at - step)) / (2.0 * STEP) for step in STEP * np.eye(at.size)]
    curvature = np.array(rows)
    return float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(0.5 * (curvature + curvature.T)), LEAST))))


LEAST = 0.1  # curvature
_ORIGIN = np.zeros(1)
_LOG_PRIOR = float(log_prior(_ORIGIN)[0]) - 0.5 * _log_curvature(lambda u: -prior_slope(u), _ORIGIN)
"""Laplace's integral of the prior of a size, whose mode is the typical one."""


def gained_over_sizes(problem: Problem, normals: Normals) -> float:
    """Nats that the evidence of a fit gains by integrating over the sizes of scatters that no repeats show, else 0."""
    differs = problem.switches.scatter.from_trial_to_trial
    if not differs or not single_releases(problem.experiment, problem.trials):
        return 0.0
    with np.errstate(invalid="ignore"):  # where a record fails there is no evidence
        gained = Unlearnt.of(problem, normals).gained()
    return gained if math.isfinite(gained) else 0.0
