"""Normal scores of draws: each marginal about normal, for proposals that are mixtures of normal distributions."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bayes_damper.sampling.moves import HalvesMove

Array = NDArray[np.float64]
_PARTS = 12  # of a marginal, as likely each
_LEVELS = np.concatenate([[0.2 / _PARTS], (np.arange(_PARTS) + 0.5) / _PARTS, [1.0 - 0.2 / _PARTS]])
_SCORES = ndtri(_LEVELS)
_WORTH = 0.1  # nats per draw that one normal gains by normal scores, from which they are used


class NormalScores:
    """A monotone map of each coordinate, through quantiles and linear between them and beyond.

    knots : (k, ndim) places, ascending, that go to the same k quantiles of the standard normal distribution.
    """

    def __init__(self, knots: Array) -> None:
        self.knots = knots
        self._slopes = np.diff(_SCORES)[:, None] / np.diff(knots, axis=0)

    @classmethod
    def of(cls, draws: Array) -> Self:
        """The map under which the marginals of draws (n, ndim) are about normal."""
        knots = np.quantile(draws, _LEVELS, axis=0)
        least = 1e-6 * np.maximum(np.ptp(draws, axis=0), 1e-300)  # between knots where many draws are the same
        steps = np.arange(len(knots))[:, None] * least
        return cls(np.maximum.accumulate(knots - steps, axis=0) + steps)

    def scores(self, points: Array) -> tuple[Array, Array]:
        """Scores of points (n, ndim), and the log of how much denser points stand there, (n,)."""
        part = (points[:, None] > self.knots[None, 1:-1]).sum(axis=1)
        columns = np.arange(points.shape[1])
        slopes = self._slopes[part, columns]
        return _SCORES[part] + (points - self.knots[part, columns]) * slopes, -np.log(slopes).sum(axis=1)

    def points(self, scores: Array) -> Array:
        """The points (n, ndim) that have these scores."""
        part = np.searchsorted(_SCORES[1:-1], scores)
        columns = np.arange(scores.shape[1])
        return np.asarray(self.knots[part, columns] + (scores - _SCORES[part]) / self._slopes[part, columns])


def normal_scores(draws: Array) -> NormalScores | None:
    """The scores of draws (n, ndim), if a normal fitted to the first half predicts the second better with them."""
    first, second = draws[: len(draws) // 2], draws[len(draws) // 2 :]
    if len(first) < 4 * max(_PARTS, draws.shape[1]):
        return None
    found = NormalScores.of(first)
    (known, _), (asked, denser) = found.scores(first), found.scores(second)
    gained = _predicted(known, asked) - denser.mean() - _predicted(first, second)
    return NormalScores.of(draws) if gained > _WORTH else None


def _predicted(known: Array, asked: Array) -> float:
    """Mean log density, but for a constant, of the normal fitted to known points (n, ndim) at points that are asked."""
    spread = np.maximum(known.std(axis=0), 1e-300)
    root = np.linalg.cholesky(np.cov((known / spread).T).reshape(len(spread), -1) + 1e-6 * np.eye(len(spread)))
    white = np.linalg.solve(root, ((asked - known.mean(axis=0)) / spread).T)
    size = np.log(np.diag(root) * spread).sum()
    return float(-0.5 * np.square(white).sum(axis=0).mean() - size)


class InScores(HalvesMove):
    """A move that is made in normal scores."""

    def __init__(self, move: HalvesMove, through: NormalScores) -> None:
        super().__init__()
        self._move = move
        self._through = through

    def proposal(self, moving: Array, resting: Array, random: np.random.RandomState) -> tuple[Array, Array | float]:
        here, denser_here = self._through.scores(moving)
        there, log_ratio = self._move.proposal(here, self._through.scores(resting)[0], random)
        points = self._through.points(there)
        return points, log_ratio - denser_here + self._through.scores(points)[1]
