"""Steps in some coordinates, the others at rest, as wide as a posterior is about each particle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_damper.sampling.moves import fit_mixture

Array = NDArray[np.float64]
_FREEDOM = 6.0
_SHORTEST = 0.2


class Guide:
    """Steps in x given y by a Student t mixture q(x, y) that was learnt from places of both.

    As `sampling.nearby`, for a part of the coordinates: a particle is given to a part of the mixture by the
    probability that it came from there, and its t is seen as a normal of random width. Given both, x has a normal
    distribution about a mean that hangs on y, and x' = mean + sqrt(1 - b^2) (x - mean) + b e, e drawn from what that
    normal leaves, keeps it; so q(x | y) is kept, and x' is accepted with the ratio of target over q there and here. b
    is uniform between 0.2 and 1: shorter steps are accepted and lead nowhere. Such steps seldom lead from one part to
    another, which fresh draws of q(x | y) do.

    places : (n, k + g), x before y; k : coordinates of x; most : parts of the mixture. It must be fixed before the
    steps that count.
    """

    def __init__(self, places: Array, k: int, most: int = 12) -> None:
        shares, self._centres, covariances = fit_mixture(places, most)
        self._k, self._size = k, places.shape[1]
        roots = np.linalg.cholesky(covariances)
        self._inverse = np.linalg.inv(roots)
        self._heights = np.log(shares) - np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        within, across, rest = covariances[:, :k, :k], covariances[:, :k, k:], covariances[:, k:, k:]
        self._slopes = np.linalg.solve(rest, across.transpose(0, 2, 1)).transpose(0, 2, 1)  # (parts, k, g)
        self._roots = np.linalg.cholesky(within - self._slopes @ across.transpose(0, 2, 1))
        given = np.linalg.cholesky(rest)
        self._given_inverse = np.linalg.inv(given)
        self._given_heights = np.log(shares) - np.log(np.diagonal(given, axis1=1, axis2=2)).sum(axis=1)

    def draw(self, x: Array, y: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draws of q(x | y), wherever x (n, k) is, and log q at x minus log q there, (n,)."""
        white = np.einsum("pij,npj->npi", self._given_inverse, y[:, None] - self._centres[:, self._k :])
        squares = np.square(white).sum(axis=2)
        freedom = _FREEDOM + y.shape[1]
        owner = _choose(self._given_heights - 0.5 * freedom * np.log1p(squares / _FREEDOM), rng)
        here = self._seen(x, y)[2]
        there = self._about(x, y, owner, squares[np.arange(len(x)), owner], freedom, np.ones(len(x)), rng)
        return there, here - self._seen(there, y)[2]

    def step(self, x: Array, y: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Where steps from x (n, k) with y (n, g) at rest lead, and log q here minus log q there, (n,)."""
        n = len(x)
        squares, terms, here = self._seen(x, y)
        owner, b = _choose(terms, rng), rng.uniform(_SHORTEST, 1.0, n)
        there = self._about(x, y, owner, squares[np.arange(n), owner], _FREEDOM + self._size, b, rng)
        return there, here - self._seen(there, y)[2]

    def _about(
        self, x: Array, y: Array, owner: NDArray[np.intp], squares: Array, freedom: float, b: Array,
        rng: np.random.Generator,
    ) -> Array:  # fmt: skip
        """Steps of size b from x within the normals of given parts; `squares` and `freedom` give their widths."""
        n = len(x)
        width = (_FREEDOM + squares) / (2.0 * rng.standard_gamma(0.5 * freedom, n))
        apart = y - self._centres[owner, self._k :]
        mean = self._centres[owner, : self._k] + np.einsum("nij,nj->ni", self._slopes[owner], apart)
        fresh = np.einsum("nij,nj->ni", self._roots[owner], rng.standard_normal((n, self._k)))
        return np.asarray(mean + np.sqrt(1.0 - b**2)[:, None] * (x - mean) + (b * np.sqrt(width))[:, None] * fresh)

    def _seen(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Squared distance from each part (n, parts), log of its share times density up to a constant, and the sum's
        log (n,).
        """
        places = np.concatenate([x, y], axis=1)
        white = np.einsum("pij,npj->npi", self._inverse, places[:, None] - self._centres)
        squares = np.square(white).sum(axis=2)
        terms = self._heights - 0.5 * (_FREEDOM + self._size) * np.log1p(squares / _FREEDOM)
        highest = terms.max(axis=1)
        return squares, terms, highest + np.log(np.exp(terms - highest[:, None]).sum(axis=1))


def _choose(terms: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """A part for each of n particles, by the logs of what the parts count, (n, parts)."""
    chances = np.exp(terms - terms.max(axis=1, keepdims=True)).cumsum(axis=1)
    drawn = rng.random((len(terms), 1)) * chances[:, -1:]
    return np.asarray(np.minimum((chances < drawn).sum(axis=1), terms.shape[1] - 1), dtype=np.intp)
