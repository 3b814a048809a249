"""A move that steps as wide as the target is about the walker, by a mixture that was learnt beforehand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_damper.sampling.moves import HalvesMove, StudentT

Array = NDArray[np.float64]
_SHORTEST = 0.1


class Nearby(HalvesMove):
    """Steps within the part of a Student t mixture q to which a walker belongs.

    A walker at x is given to a part of the mixture with the probability that a draw of q at x would come from there.
    Seen as a normal of centre c and covariance S (a t is one of random width), x' = c + sqrt(1 - b^2) (x - c) + b e, e
    drawn from N(0, S), leaves that normal and therefore q as it is (preconditioned Crank-Nicolson; Cotter et al. 2013,
    Statistical Science 28:424), and is reversible. So x' is accepted with the ratio of target over q there and here,
    whatever the part. b lies between 0.1 and 1: where q is a poor likeness, and draws of it are rarely accepted, short
    steps still are; thin modes are crossed in steps of their own width, not in those of the whole ensemble.

    The mixture must be fixed before the draws that count.
    """

    def __init__(self, shares: Array, centres: Array, covariances: Array, freedom: float = 6.0) -> None:
        super().__init__()
        shapes = [StudentT(c, s, freedom) for c, s in zip(centres, covariances, strict=True)]
        self._freedom = freedom
        self._centres = np.array(centres, dtype=float)
        self._roots = np.linalg.cholesky(np.asarray(covariances, dtype=float))
        inverse = np.linalg.inv(self._roots)
        # One product makes the coordinates white in which every part is round: (ndim, parts * ndim).
        self._across = inverse.reshape(-1, inverse.shape[2]).T.copy()
        self._shift = np.einsum("kij,kj->ki", inverse, self._centres)
        self._heights = np.log(shares) + [float(s.log_density(s.centre[None])[0]) for s in shapes]

    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:  # noqa: ARG002
        count, ndim = moving.shape
        white, terms, here = self._seen(moving)
        chances = np.cumsum(np.exp(terms - here[:, None]), axis=1)
        owner = np.minimum((chances < random.random_sample((count, 1))).sum(axis=1), len(self._centres) - 1)
        own = white[np.arange(count), owner]
        # The width of the normal, given the point: inverse of a gamma variable.
        width = (self._freedom + (own**2).sum(axis=1)) / (
            2.0 * random.standard_gamma(0.5 * (self._freedom + ndim), count)
        )
        step = np.power(_SHORTEST, random.random_sample(count))
        fresh = random.standard_normal((count, ndim))
        own = np.sqrt(1.0 - step**2)[:, None] * own + (step * np.sqrt(width))[:, None] * fresh
        points = self._centres[owner] + np.matmul(self._roots[owner], own[:, :, None])[:, :, 0]
        return points, here - self._seen(points)[2]

    def _seen(self, points: Array) -> tuple[Array, Array, Array]:
        """White coordinates of points (n, ndim) in each part, (n, parts, ndim); log of share times density of each part
        there, (n, parts); log density of the mixture there, (n,).
        """
        parts, ndim = self._centres.shape
        white = (points @ self._across).reshape(len(points), parts, ndim) - self._shift
        power = -0.5 * (self._freedom + ndim)
        terms = self._heights + power * np.log1p(np.square(white).sum(axis=2) / self._freedom)
        highest = terms.max(axis=1)
        return white, terms, highest + np.log(np.exp(terms - highest[:, None]).sum(axis=1))
