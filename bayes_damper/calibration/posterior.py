"""Posterior of the parameters given recorded trials, with the nuisances of each trial integrated out.

Each trial has unknowns of its own: its release angle, its instant of release, its share of friction. Thirty trials
would mean sixty more dimensions. But around the best fit the record is linear in them to well within the noise, so
they are integrated out in closed form. With w the whitened residuals at the best nuisances eta, T their whitened
derivatives by the nuisances, and a unit Gaussian prior of the nuisances (their standard coordinates),

    A = 1 + T'T,   b = eta + T'w,
    log L = -(w'w + eta'eta - b' A^-1 b + log |A|) / 2 - n log s,

where channel c enters with w / s_c and T / s_c; s_c, the noise relative to its estimate, is sampled. With q, J, T0
and eta0 those of the calibration's best fit, eta follows the parameters to where the linearised problem has its best
nuisances, eta = eta0 - (1 + T0'T0)^-1 T0'J (q' - q) at q', so that only their spread given the parameters has to be
small. T is T0, but for the column of a nuisance ln x: that grows in proportion to x. An evaluation costs one simulation
per trial and no more dimensions; tests hold this against sampling the nuisances one by one. Given a draw, a trial's
nuisances are Gaussian with mean eta - A^-1 b and covariance A^-1: `evaluated` draws them.

Under Student's t noise of f degrees of freedom a reading's information in A is (f + 1) / (f + 3) of that under a
Gaussian, its score in b (f + 1) / (f + w^2 / s^2); the nuisances move by -A^-1 b, and the density there is that of
Student's t: one step of Fisher scoring, then Laplace's approximation.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from bayes_damper.calibration import Block, Calibration, Group
from bayes_damper.calibration.correlated_noise import student_log_density
from bayes_damper.calibration.noise_unknowns import NoiseUnknowns
from bayes_damper.priors.distributions import LogNormal, from_standard, to_standard

Array = NDArray[np.float64]
FREEDOM_PRIOR = LogNormal(8.0, 3.0)
"""Prior of the degrees of freedom of Student's t noise; beyond 30 it is all but Gaussian."""
OUTSIDE = 10.0  # nats by which a draw fits worse than one on the floor of its valley, from which it lies outside
MANY = 50  # nuisances of a trial from which their matrix is taken apart once for all that is asked of it
SETTLED = 4  # steps in which nuisances find their place; nearly all need one
READINGS_AT_ONCE = 2_000_000
"""Simulated readings that are held at a time: more points are evaluated in turns, with the same results."""


@dataclass(frozen=True, eq=False)
class _Part:
    """A group of trials with what stays fixed: eta (trials, m) at the best fit and follow (trials, m, size), how it
    moves with q, T (trials, channels, m, n), TT = T T', the weighted number of readings (trials, channels), and scale
    (trials, channels, n), weights over the sd of the innovations.
    """

    group: Group
    eta: Array
    follow: Array
    T: Array
    TT: Array
    readings: Array
    scale: Array

    def turns(self, points: int) -> list[slice]:
        """So few points at a time that their records, and matrices of what each trial has for itself, are held
        together.
        """
        n, m = self.eta.shape
        each = max(READINGS_AT_ONCE // max(self.group.y.size, n * m * m), 1)
        return [slice(k, k + each) for k in range(0, max(points, 1), each)]


def _solve(A: Array, b: Array) -> Array:
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0]) if b.shape[-1] else b


def _log_det(A: Array) -> Array:
    return np.asarray(np.linalg.slogdet(A)[1]) if A.shape[-1] else np.zeros(A.shape[:-2])


def _solved(A: Array, b: Array) -> tuple[Array, Array]:
    """Of symmetric positive A (..., m, m) and b (..., m): A^-1 b and log |A|, large ones by Cholesky one by one."""
    if b.shape[-1] < MANY:
        return _solve(A, b), _log_det(A)
    x, logs = np.empty_like(b), np.empty(b.shape[:-1])
    for k in np.ndindex(logs.shape):
        factor = cho_factor(A[k], lower=True, check_finite=False)
        x[k] = cho_solve(factor, b[k], check_finite=False)
        logs[k] = 2.0 * np.sum(np.log(np.diag(factor[0])))
    return x, logs


def _student(part: _Part, w: Array, s: Array, freedom: Array, eta: Array, growth: Array) -> tuple[Array, Array, Array]:
    """`_evaluated` under Student's t noise, from whitened residuals w (k, trials, channels, n)."""
    f = freedom[:, None, None, None]
    counted = part.group.weight > 0.0
    w = np.where(counted, w / s[..., None], 0.0)
    score = np.where(counted, (f + 1.0) * w / (f + w**2), 0.0)
    expected = ((freedom + 1.0) / (freedom + 3.0))[:, None, None] * s**-2  # information of a reading
    A = np.einsum("knc,ncij->knij", expected, part.TT) * growth[..., None] * growth[..., None, :]
    A += np.eye(part.T.shape[2])
    b = eta + growth * np.einsum("knc,kncm->knm", 1.0 / s, np.matmul(part.T, score[..., None])[..., 0])
    move = _solve(A, b)
    moved = w - np.einsum("ncms,knm->kncs", part.T, growth * move, optimize=True) / s[..., None]
    each = np.where(counted, student_log_density(moved, f), 0.0).sum(axis=3) - np.log(s) * part.readings
    mean = eta - move
    return each.sum(axis=2) - 0.5 * (np.sum(mean**2, axis=2) + _log_det(A)), mean, A


class RecordPosterior:
    """Log posterior over q (unknowns of calibration.Problem) and the noise of each channel, in standard coordinates.

    names : those of the problem, then sigma1 (and sigma2), at the level that the priors give them; ndim : their number.
    """

    def __init__(self, fit: Calibration, *, power: Sequence[float] | None = None, freedom: float | None = None) -> None:
        """`power` : mean square innovation of each channel at the best fit, where the noise stands for a misfit that
        repeats share: each reading then counts as so many; freedom : first guess of the degrees of freedom, for
        Student's t noise.
        """
        self.fit = fit
        self.problem = fit.problem
        self.freedom = freedom
        self.parts = tuple(self._part(block, power) for block in fit.linear.blocks)
        self.noise = NoiseUnknowns(fit.problem, [part.group for part in self.parts])
        self.sigmas = self.noise.sigmas
        self.names = self.problem.names + tuple(sigma.name for sigma in self.sigmas)
        self.names += () if freedom is None else ("noise_freedom",)
        self.ndim = len(self.names)
        self.outcomes: Counter[str] = Counter()

    def _part(self, block: Block, power: Sequence[float] | None) -> _Part:
        group = block.group
        n, channels, samples = group.y.shape
        H = np.eye(block.T.shape[1]) + np.matmul(block.T, block.T.transpose(0, 2, 1))
        follow = -np.linalg.solve(H, np.matmul(block.T, block.J.transpose(0, 2, 1)))
        T = block.T.reshape(n, -1, channels, samples).transpose(0, 2, 1, 3)
        TT = np.matmul(T, T.transpose(0, 1, 3, 2))
        # As in Problem.n_data, else the noise would come out too small; but all readings of a trial that counts less
        # because its own residuals are larger.
        own = np.array([float(np.mean(self.problem.factors.get(i, 1.0))) for i in group.trials])
        readings = np.sum(group.trust**2, axis=2) / own[:, None] ** 2
        if power is not None:
            readings = readings * np.array(power[:channels])
        scale = group.weight / np.array(self.problem.noise.innovation[:channels])[:, None]
        return _Part(group, block.eta, follow, np.ascontiguousarray(T), TT, readings, scale)

    @property
    def trials(self) -> tuple[int, ...]:
        """Indices of the trials in the order of `log_likelihood`."""
        return tuple(i for part in self.parts for i in part.group.trials)

    @property
    def start(self) -> Array:
        """The best fit, (ndim,)."""
        tails = [] if self.freedom is None else [float(to_standard(FREEDOM_PRIOR, self.freedom))]
        return np.concatenate([self.fit.q, self.noise.start, tails])

    @property
    def covariance(self) -> Array:
        """Covariance of the best fit's Laplace approximation, (ndim, ndim)."""
        full = np.zeros((self.ndim, self.ndim))
        size = self.problem.size
        full[:size, :size] = self.fit.covariance
        variances = self.noise.variances([part.readings for part in self.parts])
        full[range(size, size + len(variances)), range(size, size + len(variances))] = variances
        if self.freedom is not None:
            full[-1, -1] = 0.01
        return full

    def noise_scale(self, points: Array) -> Array:
        """Noise of each trial and channel relative to its estimate, (n, trials, channels); trials as in `trials`."""
        return self.noise.scale(points[:, self.problem.size :])

    @property
    def constant(self) -> Array:
        """What `log_likelihood` leaves out of each trial's log density of its readings, (trials,)."""
        out = []
        for part in self.parts:
            weight = part.group.weight
            counted = weight > 0.0
            sizes = np.log(np.array(self.problem.noise.innovation[: weight.shape[1]]))
            each = np.where(counted, np.log(np.where(counted, weight, 1.0)) - sizes[None, :, None], 0.0)
            out.append(each.sum(axis=(1, 2)) - 0.5 * math.log(2.0 * math.pi) * counted.sum(axis=(1, 2)))
        return np.concatenate(out)

    def _followed(self, part: _Part, q: Array) -> tuple[Array, Array]:
        """Nuisances eta (k, trials, m) about which those of each q (k, size) are integrated out, and what multiplies
        the columns of T there, (k, trials, m).
        """
        eta = part.eta + np.einsum("nmi,ki->knm", part.follow, q - self.fit.q)
        eta = np.clip(eta, part.group.lower, part.group.upper)
        return eta, self._growth(part, q, eta)

    def _growth(self, part: _Part, q: Array, eta: Array) -> Array:
        """What multiplies the columns of T at nuisances eta (k, trials, m) and each q (k, size); shaped as eta."""
        problem, group = self.problem, part.group
        growth = np.ones_like(eta)
        for m, (name, _, sd) in enumerate(group.nuisances):
            if not name.startswith("ln_"):
                continue
            growth[:, :, m] = np.exp(sd * (eta[:, :, m] - part.eta[:, m]))
            for i, c in enumerate(problem.coordinates):
                if c.parameter == name[3:]:
                    ratio = from_standard(c.prior, q[:, i]) / from_standard(c.prior, self.fit.q[i])
                    growth[:, :, m] *= np.where(problem.touched(c, group), ratio[:, None], 1.0)
        return growth

    def _residuals(self, part: _Part, q: Array, eta: Array) -> Array:
        """Whitened residuals (k, trials, channels, n) for each q (k, size) at nuisances eta (k, trials, m)."""
        n, channels, samples = part.group.y.shape
        k = len(q)
        which = np.tile(np.arange(n), k)
        y = self.problem.simulate(part.group, which, np.repeat(q, n, axis=0), eta.reshape(k * n, -1))
        failed = ~np.isfinite(y).all(axis=(1, 2))
        self.outcomes["FAILED"] += int(failed.sum())
        self.outcomes["COMPLETED"] += int((~failed).sum())
        w = y.reshape(k, n, channels, samples)  # our own: changed in place
        w -= part.group.y
        w *= part.scale
        noise = self.problem.noise
        for c in range(channels):
            if noise.coloured(c):
                w[:, :, c] = noise.whiten(c, w[:, :, c]) * noise.innovation[c]
        return w

    def _evaluated(self, part: _Part, points: Array, s: Array) -> tuple[Array, Array, Array]:
        """Log likelihood (k, trials), mean (k, trials, m) and inverse covariance (k, trials, m, m) of the nuisances, of
        the points of a turn.
        """
        q = points[:, : self.problem.size]
        eta, growth = self._followed(part, q)
        w = self._residuals(part, q, eta)
        if self.freedom is not None:
            return _student(part, w, s, from_standard(FREEDOM_PRIOR, points[:, -1]), eta, growth)
        Tw = np.matmul(part.T, w[..., None])[..., 0]
        A = np.einsum("knc,ncij->knij", s**-2, part.TT) * growth[..., None] * growth[..., None, :]
        A += np.eye(part.T.shape[2])
        b = eta + growth * np.einsum("knc,kncm->knm", s**-2, Tw)
        move, log_det = _solved(A, b)
        quadratic = np.sum(np.einsum("kncs,kncs->knc", w, w) / s**2, axis=2) + np.sum(eta**2, axis=2)
        value = -0.5 * (quadratic - np.sum(b * move, axis=2) + log_det) - np.sum(np.log(s) * part.readings, axis=2)
        return value, eta - move, A

    def log_likelihood(self, points: Array) -> Array:
        """Log likelihood of each trial, its nuisances integrated out: (n, trials); -inf where a simulation failed.

        Up to `constant`, which depends on the data and the noise model alone.
        """
        points = np.atleast_2d(points)
        each = [
            np.concatenate([self._evaluated(part, points[at], s[at])[0] for at in part.turns(len(points))])
            for part, s in self._scaled(points)
        ]
        value = np.concatenate(each, axis=1)
        return np.where(np.isfinite(value), value, -np.inf)

    def _scaled(self, points: Array) -> Iterator[tuple[_Part, Array]]:
        """Each part with the relative noise of its trials and channels, (n, trials, channels)."""
        scale = self.noise_scale(points)
        first = 0
        for part in self.parts:
            n, channels = part.group.y.shape[:2]
            yield part, scale[:, first : first + n, :channels]
            first += n

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
        size = self.problem.size
        named = dict(self.problem.parameters(points[:, :size]))
        named |= {s.name: from_standard(s.prior, points[:, size + k]) for k, s in enumerate(self.sigmas)}
        return named if self.freedom is None else named | {"noise_freedom": from_standard(FREEDOM_PRIOR, points[:, -1])}

    def evaluated(self, points: Array, rng: np.random.Generator) -> tuple[Array, dict[int, Array]]:
        """`log_likelihood` of each trial, (n, trials), and draws of its nuisances given the parameters: trial -> (n, m)
        in standard coordinates.
        """
        points = np.atleast_2d(points)
        values = []
        drawn: dict[int, Array] = {}
        for part, s in self._scaled(points):
            turns = [self._drawn(part, points[at], s[at], rng) for at in part.turns(len(points))]
            value, nuisances = (np.concatenate(x) for x in zip(*turns, strict=True))
            values.append(np.where(np.isfinite(value), value, -np.inf))
            if part.eta.shape[1]:
                drawn |= {i: nuisances[:, k] for k, i in enumerate(part.group.trials)}
        return np.concatenate(values, axis=1), drawn

    def _drawn(self, part: _Part, points: Array, s: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Log likelihood (k, trials) and a draw of the nuisances (k, trials, m) of the points of a turn."""
        value, mean, A = self._evaluated(part, points, s)
        root = np.linalg.inv(np.linalg.cholesky(A)).transpose(0, 1, 3, 2)
        return value, mean + np.einsum("knij,knj->kni", root, rng.standard_normal(mean.shape))

    def _settled(self, part: _Part, points: Array, s: Array, rng: np.random.Generator) -> Array:
        """Nuisances (k, trials, m) of each point that fit disturbed readings and a disturbed prior best.

        Draws of a Gaussian, which `evaluated` gives, leave the readings' valley where it bends: where a gain may be off
        by 5 %, what is released and the gain are known as a product. Those that do are moved to its floor (Bardsley et
        al. 2014, SIAM J. Sci. Comput. 36:A1895, randomise then optimise), so that the readings that they make are those
        of the posterior; along the floor they may spread too little. Noise counts as Gaussian.
        """
        q = points[:, : self.problem.size]
        _, mean, A = self._evaluated(part, points, s)
        own = rng.standard_normal(mean.shape)
        noise = rng.standard_normal((len(points), *part.group.y.shape)) * (part.group.weight > 0.0)
        pull = np.einsum("ncms,kncs->knm", part.T, noise / s[..., None], optimize=True)
        straight = mean + _solve(A, own - self._growth(part, q, mean) * pull)
        free = {name for name, _, _ in part.group.nuisances}
        if "delay" in free and self.problem.experiment.quantity == "acceleration":
            return straight  # a reading jumps as the release passes it: there is no valley to descend in

        def misfit(eta: Array) -> tuple[Array, Array]:
            w = self._residuals(part, q, eta) / s[..., None] + noise
            slope = np.einsum("ncms,kncs->knm", part.T, w / s[..., None], optimize=True)
            onwards = _solve(A, eta - own + self._growth(part, q, eta) * slope)
            return 0.5 * np.sum(w**2, axis=(2, 3)) + 0.5 * np.sum((eta - own) ** 2, axis=2), onwards

        eta, best = mean, np.full(mean.shape[:2], np.inf)
        found, step, reach = mean, np.zeros_like(mean), np.ones(mean.shape[:2])
        for _ in range(SETTLED + 1):
            value, onwards = misfit(eta)
            better = value < best
            best, found = np.where(better, value, best), np.where(better[..., None], eta, found)
            step = np.where(better[..., None], onwards, step)
            reach = np.where(better, 1.0, 0.3 * reach)
            eta = np.clip(found - reach[..., None] * step, part.group.lower, part.group.upper)
        return np.where((misfit(straight)[0] > best + OUTSIDE)[..., None], found, straight)

    def predictive(self, points: Array, rng: np.random.Generator) -> dict[int, Array]:
        """Noise-free records of each trial under draws of parameters and nuisances: trial -> (n, channels, n_times).

        An acceleration jumps at the release, whose instant is known to a fraction of a sample: a reading before the
        release of some draws and after that of others is NaN in the former.
        """
        points = np.atleast_2d(points)
        out: dict[int, Array] = {}
        for part, s in self._scaled(points):
            turns = part.turns(len(points))
            drawn = np.concatenate([self._settled(part, points[at], s[at], rng) for at in turns])
            for k, i in enumerate(part.group.trials):
                out[i] = self.problem.simulate(
                    part.group, np.full(len(points), k), points[:, : self.problem.size], drawn[:, k]
                )
                if self.problem.experiment.quantity == "acceleration":
                    held = np.logical_and.accumulate(np.all(out[i] == 0.0, axis=1), axis=1)
                    out[i][np.broadcast_to((held & ~held.all(axis=0))[:, None], out[i].shape)] = np.nan
        return out
