"""How steps of sequential Monte Carlo are proposed: exchangeable, each with what its acceptance owes to it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayes_damper.sampling.guide import Guide

Array = NDArray[np.float64]
_PROPOSED = tuple[Array, Array]


class Steps(ABC):
    """Proposals for the coordinates x of one block, taken in turn.

    1. `propose` gives new x and the log of the ratio of the densities of proposing back and forth.
    2. What it learns it learns in `learn`, from places before a stage: it is fixed in the stage.
    3. It may use x of the other half of the particles, which are at rest, but of no other particle.
    4. Between two sweeps it may change `size`, the size of its steps, by the share that was accepted.
    """

    size = 0.6

    def learn(self, x: Array, given: Array, most: int) -> None:  # noqa: B027  # learning is optional
        """Learns from places x (n, k) and the coordinates at rest (n, g) there; `most` parts of a mixture."""

    @abstractmethod
    def propose(
        self, turn: int, x: Array, given: Array, others: Callable[[], Array], rng: np.random.Generator
    ) -> _PROPOSED:
        """New x (n, k), and log of the ratio of reverse to forward proposal density, (n,); `others` () -> (m, k)."""

    def heed(self, turn: int, share: float) -> None:  # noqa: B027  # adapting is optional
        """Adapts to the share of steps of a turn that was accepted."""


class Shaped(Steps):
    """In turn steps that keep a Gaussian of the others' mean and covariance, as wide as are accepted, and differential
    evolution.
    """

    def propose(
        self, turn: int, x: Array, given: Array, others: Callable[[], Array], rng: np.random.Generator
    ) -> _PROPOSED:
        del given
        return _about(others(), x, self.size, rng) if turn % 2 == 0 else _along(others(), x, rng)

    def heed(self, turn: int, share: float) -> None:
        if turn % 2 == 0:
            self.size = float(np.clip(self.size * math.exp(0.6 * (share - 0.3)), 0.03, 1.0))


class Guided(Steps):
    """In turn fresh draws of a mixture learnt beforehand and steps within its parts, at times differential evolution.

    On a thin, broad posterior it is fresh draws that lead furthest, few as are taken.
    """

    def learn(self, x: Array, given: Array, most: int) -> None:
        self._guide = Guide(np.concatenate([x, given], axis=1), x.shape[1], most)

    def propose(
        self, turn: int, x: Array, given: Array, others: Callable[[], Array], rng: np.random.Generator
    ) -> _PROPOSED:
        kind = ("draw", "near", "draw", "near", "along")[turn % 5]
        if kind == "along":
            return _along(others(), x, rng)
        return (self._guide.draw if kind == "draw" else self._guide.step)(x, given, rng)


def _along(others: Array, x: Array, rng: np.random.Generator) -> _PROPOSED:
    """Steps from x (n, k) along differences of two others, half of them in some coordinates only, of all sizes.

    What is left of a ridge's bend takes short ones.
    """
    n, k = x.shape
    first, second = (others[rng.integers(len(others), size=n)] for _ in range(2))
    some = rng.random((n, k)) < np.where(rng.random(n) < 0.5, 1.0, rng.random(n))[:, None]
    some[np.arange(n), rng.integers(k, size=n)] = True
    gamma = 2.38 / np.sqrt(2.0 * some.sum(axis=1)) * np.exp(rng.uniform(-3.0, 0.3, n))
    return x + some * (gamma[:, None] * (first - second) + 1e-3 * rng.standard_normal((n, k))), np.zeros(n)


def _about(others: Array, x: Array, size: float, rng: np.random.Generator) -> _PROPOSED:
    """Steps of a size, from 0 to 1, from x (n, k) that keep a Gaussian of the mean and covariance of others (m, k)."""
    mean = others.mean(axis=0)
    m, k = others.shape
    covariance = np.cov(others.T).reshape(k, k)
    # Shrunk towards the diagonal: few particles, many coordinates.
    share = min(0.2, 0.2 * k / m)
    covariance = (1.0 - share) * covariance + share * np.diag(np.diag(covariance)) + 1e-9 * np.eye(k)
    root = np.linalg.cholesky(covariance)
    proposed = mean + math.sqrt(1.0 - size**2) * (x - mean) + size * rng.standard_normal(x.shape) @ root.T
    inverse = np.linalg.inv(root).T
    squares = [np.sum(((z - mean) @ inverse) ** 2, axis=1) for z in (proposed, x)]
    return proposed, 0.5 * (squares[0] - squares[1])
