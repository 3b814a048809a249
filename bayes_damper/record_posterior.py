"""Posterior of the parameters given recorded trials, with the nuisances of each trial integrated out.

Each trial has unknowns of its own: its release angle, its instant of release, its share of friction. Thirty trials
would mean sixty more dimensions. But around the best fit the record is linear in them to well within the noise, so
they are integrated out in closed form. With w the whitened residuals at the best nuisances eta, T their whitened
derivatives by the nuisances, and a unit Gaussian prior of the nuisances (their standard coordinates),

    A = 1 + T'T,   b = eta + T'w,
    log L = -(w'w + eta'eta - b' A^-1 b + log |A|) / 2 - n log s,

where channel c enters with w / s_c and T / s_c; s_c, the noise relative to its estimate, is sampled. eta and T are
those of calibration.py's best fit and stay fixed, so that an evaluation costs one simulation per trial and no more
dimensions; tests hold this against sampling the nuisances one by one. Given a draw, a trial's nuisances are Gaussian
with mean eta - A^-1 b and covariance A^-1: `nuisances` draws them.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Group
from bayes_damper.distributions import Distribution, LogNormal, from_standard

Array = NDArray[np.float64]
NOISE_PRIOR = LogNormal(1.0, 1.5)
"""Prior of each channel's noise relative to the estimate from repeats: thousands of readings decide, not this."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A group of trials with what stays fixed: eta (trials, m), T (trials, channels, m, n), TT = T T', and the number
    of readings (trials, channels).
    """

    group: Group
    eta: Array
    T: Array
    TT: Array
    readings: Array


class RecordPosterior:
    """Log posterior over q (unknowns of calibration.Problem) and the noise of each channel, in standard coordinates.

    names : those of the problem, then noise1 (and noise2); ndim : their number.
    """

    def __init__(self, fit: Calibration, noise_prior: Distribution = NOISE_PRIOR) -> None:
        self.fit = fit
        self.problem = fit.problem
        self.noise_prior = noise_prior
        self.channels = max(group.y.shape[1] for group in self.problem.groups)
        self.names = self.problem.names + tuple(f"noise{c + 1}" for c in range(self.channels))
        self.ndim = len(self.names)
        self.outcomes: Counter[str] = Counter()
        self.parts = tuple(self._part(block.group, block.T, block.eta) for block in fit.linear.blocks)

    @staticmethod
    def _part(group: Group, T: Array, eta: Array) -> _Part:
        n, channels, samples = group.y.shape
        T = T.reshape(n, -1, channels, samples).transpose(0, 2, 1, 3)
        TT = np.matmul(T, T.transpose(0, 1, 3, 2))
        readings = np.count_nonzero(group.weight > 0.0, axis=2).astype(float)
        return _Part(group, eta, np.ascontiguousarray(T), TT, readings)

    @property
    def trials(self) -> tuple[int, ...]:
        """Indices of the trials in the order of `log_likelihood`."""
        return tuple(i for part in self.parts for i in part.group.trials)

    @property
    def start(self) -> Array:
        """The best fit, (ndim,)."""
        return np.concatenate([self.fit.q, np.zeros(self.channels)])

    @property
    def covariance(self) -> Array:
        """Covariance of the best fit's Laplace approximation, (ndim, ndim)."""
        full = np.zeros((self.ndim, self.ndim))
        size = self.problem.size
        full[:size, :size] = self.fit.covariance
        for c in range(self.channels):
            count = sum(p.readings[:, c].sum() for p in self.parts if p.readings.shape[1] > c)
            full[size + c, size + c] = 1.0 / (2.0 * count * math.log(1.5) ** 2 + 1.0)
        return full

    def noise_scale(self, points: Array) -> Array:
        """Noise of each channel relative to its estimate, (n, channels)."""
        return from_standard(self.noise_prior, points[:, self.problem.size :])

    def _sums(self, part: _Part, q: Array) -> tuple[Array, Array]:
        """Sums of squares w'w (k, trials, channels) and T'w (k, trials, channels, m) for each q (k, size)."""
        n, channels, samples = part.group.y.shape
        k = len(q)
        which = np.tile(np.arange(n), k)
        y = self.problem.simulate(part.group, which, np.repeat(q, n, axis=0), np.tile(part.eta, (k, 1)))
        failed = ~np.isfinite(y).all(axis=(1, 2))
        self.outcomes["FAILED"] += int(failed.sum())
        self.outcomes["COMPLETED"] += int((~failed).sum())
        w = self.problem.whitened(y - part.group.y[which], part.group.weight[which]).reshape(k, n, channels, samples)
        return np.einsum("kncs,kncs->knc", w, w), np.einsum("ncms,kncs->kncm", part.T, w, optimize=True)

    def log_likelihood(self, points: Array) -> Array:
        """Log likelihood of each trial, its nuisances integrated out: (n, trials); -inf where a simulation failed.

        Up to a constant that depends on the data and the noise model alone.
        """
        points = np.atleast_2d(points)
        scale = self.noise_scale(points)
        columns = []
        for part in self.parts:
            ww, Tw = self._sums(part, points[:, : self.problem.size])
            s = scale[:, : ww.shape[2]]
            A, b = self._conditional(part, Tw, s)
            quadratic = np.sum(ww / s[:, None] ** 2, axis=2) + np.sum(part.eta**2, axis=1)
            if A.shape[-1]:
                quadratic = quadratic - np.einsum("knm,knm->kn", b, np.linalg.solve(A, b[..., None])[..., 0])
                quadratic = quadratic + np.linalg.slogdet(A)[1]
            columns.append(-0.5 * quadratic - np.log(s) @ part.readings.T)
        value = np.concatenate(columns, axis=1)
        return np.where(np.isfinite(value), value, -np.inf)

    @staticmethod
    def _conditional(part: _Part, Tw: Array, s: Array) -> tuple[Array, Array]:
        """A (k, trials, m, m) and b (k, trials, m) of the nuisances given the parameters."""
        A = np.eye(part.T.shape[2]) + np.einsum("kc,ncij->knij", s**-2, part.TT)
        return A, part.eta + np.einsum("kc,kncm->knm", s**-2, Tw)

    def log_prior(self, points: Array) -> Array:
        """Log prior density in standard coordinates, (n,)."""
        points = np.atleast_2d(points)
        return np.asarray(-0.5 * (np.sum(points**2, axis=1) + self.ndim * math.log(2.0 * math.pi)))

    def __call__(self, points: Array) -> Array:
        """Log posterior density in standard coordinates, (n,)."""
        points = np.atleast_2d(points)
        return np.asarray(self.log_prior(points) + self.log_likelihood(points).sum(axis=1))

    def values(self, points: Array) -> dict[str, Array]:
        """Physical values: name -> (n,), the noise as sigma1, sigma2 in the unit of the readings."""
        points = np.atleast_2d(points)
        named = dict(self.problem.parameters(points[:, : self.problem.size]))
        scale = self.noise_scale(points)
        total = self.problem.noise.total
        return named | {f"sigma{c + 1}": scale[:, c] * total[c] for c in range(self.channels)}

    def nuisances(self, points: Array, rng: np.random.Generator) -> dict[int, Array]:
        """Draws of each trial's nuisances given the parameters: trial -> (n, m) in standard coordinates."""
        points = np.atleast_2d(points)
        scale = self.noise_scale(points)
        drawn: dict[int, Array] = {}
        for part in self.parts:
            _, Tw = self._sums(part, points[:, : self.problem.size])
            A, b = self._conditional(part, Tw, scale[:, : part.group.y.shape[1]])
            m = part.eta.shape[1]
            if m == 0:
                continue
            mean = part.eta - np.linalg.solve(A, b[..., None])[..., 0]
            root = np.linalg.inv(np.linalg.cholesky(A)).transpose(0, 1, 3, 2)
            noise = np.einsum("knij,knj->kni", root, rng.standard_normal(mean.shape))
            for k, i in enumerate(part.group.trials):
                drawn[i] = mean[:, k] + noise[:, k]
        return drawn

    def predictive(self, points: Array, rng: np.random.Generator) -> dict[int, Array]:
        """Noise-free records of each trial under draws of parameters and nuisances: trial -> (n, channels, n_times)."""
        points = np.atleast_2d(points)
        drawn = self.nuisances(points, rng)
        out: dict[int, Array] = {}
        for part in self.parts:
            for k, i in enumerate(part.group.trials):
                eta = drawn.get(i, np.zeros((len(points), 0)))
                out[i] = self.problem.simulate(
                    part.group, np.full(len(points), k), points[:, : self.problem.size], np.atleast_2d(eta)
                )
        return out
