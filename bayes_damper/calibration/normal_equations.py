"""Residuals linearised at a point, and the normal equations with each trial's nuisances eliminated."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.groups import Group

Array = NDArray[np.float64]
MOST_HELD = 6  # rounds in which a step finds what it must hold
MOST_BYTES = 250_000_000
"""Of linearised problems, and of motions beside them, that are held at a time; beyond, all but the last two problems
are made again when they are needed."""


@dataclass(frozen=True, eq=False)
class Block:
    """Whitened residuals r (trials, data), J (trials, size, data) and T (trials, m, data) of one group."""

    group: Group
    r: Array
    J: Array
    T: Array
    eta: Array

    @property
    def full(self) -> Array:
        """J, T and r in one array (trials, size + m + 1, data): the one in which they lie, or a new one."""
        rows, size = self.J.base, self.J.shape[1]
        if isinstance(rows, np.ndarray) and rows.ndim == 3 and rows.shape[1] == size + self.T.shape[1] + 1:
            first = (self.J.ctypes.data - rows.ctypes.data) // rows.strides[0]
            rows = rows[first : first + len(self.J)]  # of a slice of the trials
            there = (rows[:, :size], rows[:, size:-1], rows[:, -1])
            mine = (self.J, self.T, self.r)
            if all(a.__array_interface__ == b.__array_interface__ for a, b in zip(there, mine, strict=True)):
                return rows
        return np.concatenate([self.J, self.T, self.r[:, None, :]], axis=1)

    @property
    def nbytes(self) -> int:
        """Of the derivatives, which are by far the largest."""
        return self.J.nbytes + self.T.nbytes + self.r.nbytes


class Remade:
    """Blocks that `make` makes, always the same ones: held while few are, and made again when they are asked for.

    A diagnosis compares dozens of fits, each with the derivatives of every reading by every unknown.
    """

    _held: ClassVar[list[weakref.ref[Remade]]] = []  # the one asked for last at the end

    def __init__(self, make: Callable[[], tuple[Block, ...]], known: tuple[Block, ...] = ()) -> None:
        """`known`: the blocks, if they have been made."""
        self._make = make
        self._blocks = known

    def __call__(self) -> tuple[Block, ...]:
        """The blocks."""
        blocks = self._blocks = self._blocks or self._make()
        Remade._held = [*(ref for ref in Remade._held if ref() is not self), weakref.ref(self)]
        self.make_room(spare=2)
        return blocks

    @classmethod
    def make_room(cls, nbytes: int = 0, spare: int = 1) -> None:
        """Let go of what was asked for longest ago, until all that is held leaves room for so many bytes.

        spare : how many, those asked for last, are held in any case.
        """
        held = [other for ref in cls._held if (other := ref()) is not None and other.nbytes]
        beyond = nbytes + sum(other.nbytes for other in held) - MOST_BYTES
        for other in held[:-spare]:
            if beyond > 0:
                beyond -= other.nbytes
                other.let_go()
        cls._held = [weakref.ref(other) for other in held if other.nbytes]

    @property
    def nbytes(self) -> int:
        """Of what is held."""
        return sum(block.nbytes for block in self._blocks)

    def let_go(self) -> None:
        """Hold nothing until the blocks are asked for again."""
        self._blocks = ()


@dataclass(frozen=True, eq=False)
class Linear:
    """A problem linearised at q (size,): what steps, covariance, evidence and screening are computed from.

    central : whether by differences to both sides.
    """

    q: Array
    given: Callable[[], tuple[Block, ...]]
    central: bool = False

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Residuals and derivatives, group by group. Ask once for what is looked at: they may have to be made again."""
        return self.given()

    def with_blocks(self, blocks: tuple[Block, ...]) -> Linear:
        """The same problem with other blocks, which are held."""
        return replace(self, given=lambda: blocks)

    def sliced(self, readings: int) -> Linear:
        """The same with the trials in blocks of at most so many readings, or of one trial: for what takes much more
        memory for each reading.
        """
        parts = []
        for b in self.blocks:
            step = max(readings // max(b.group.y[0].size, 1), 1)
            for k in range(0, len(b.group.trials), step):
                at = slice(k, k + step)
                whole = step >= len(b.group.trials)
                parts.append(b if whole else Block(b.group.only(at), b.r[at], b.J[at], b.T[at], b.eta[at]))
        return self.with_blocks(tuple(parts))

    def normal(self, extra: Sequence[Array] | None = None) -> Normals:
        """Normal equations with the nuisances eliminated.

        extra: for each block further columns (trials, k, data) to carry along, such as an effect to be screened.
        """
        k = 0 if extra is None else extra[0].shape[1]
        size = self.q.size
        S = np.eye(size + k)
        S[size:, size:] = 0.0
        g = np.concatenate([self.q, np.zeros(k)])
        cost = float(self.q @ self.q)
        parts = []
        for b, block in enumerate(self.blocks):
            m = block.eta.shape[1]
            full = block.full
            if extra is not None:
                full = np.concatenate([block.J, extra[b], block.T, block.r[:, None, :]], axis=1)
            gram = np.matmul(full, full.transpose(0, 2, 1))
            p = size + k
            H = gram[:, p : p + m, p : p + m] + np.eye(m)
            TJ = gram[:, p : p + m, :p]
            gT = gram[:, p : p + m, -1] + block.eta
            S += gram[:, :p, :p].sum(axis=0)
            g += gram[:, :p, -1].sum(axis=0)
            cost += float(gram[:, -1, -1].sum() + np.sum(block.eta**2))
            parts.append((block, H, TJ, gT))
        return Normals(self, S, g, cost, tuple(parts), size)

    def pinned(self) -> Linear:
        """The same with nuisances held that are pressed against an end of their range: they can take nothing up."""
        blocks = []
        for b in self.blocks:
            low, high = b.group.lower, b.group.upper
            gradient = np.einsum("jmd,jd->jm", b.T, b.r) + b.eta
            near = 1e-6 * (high - low)
            held = ((b.eta - low < near) & (gradient > 0.0)) | ((high - b.eta < near) & (gradient < 0.0))
            if not held.any():
                blocks.append(b)
                continue
            rows, size = b.full.copy(), b.J.shape[1]  # in one array, for `full` to be that array
            rows[:, size:-1][held] = 0.0
            blocks.append(Block(b.group, rows[:, -1], rows[:, :size], rows[:, size:-1], b.eta))
        return self.with_blocks(tuple(blocks))


def _held_next(
    move: Array, pull: Array, held: NDArray[np.bool_], low: Array, high: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Which moves are to be held, and where: those beyond their bounds; what would go back between them is free again.

    pull : derivative of the cost by each move.
    """
    beyond = ~held & ((move < low) | (move > high))
    back = held & np.where(move <= low, pull < 0.0, pull > 0.0)
    return (held | beyond) & ~back, np.clip(move, low, high)


def step_within(H: Array, g: Array, low: Array, high: Array) -> Array:
    """The moves x (n, m) between low and high that make x' H x / 2 + g' x least, by an active set; H (n, m, m)."""
    held, at = np.zeros(g.shape, dtype=np.bool_), np.zeros(g.shape)
    for _ in range(MOST_HELD):
        free = ~held[:, :, None] & ~held[:, None, :]
        rest = np.where(held, -at, g + np.einsum("jmn,jn->jm", H, np.where(held, at, 0.0)))
        x = -np.linalg.solve(np.where(free, H, np.eye(g.shape[1])), rest[:, :, None])[:, :, 0]
        new, at = _held_next(x, np.einsum("jmn,jn->jm", H, x) + g, held, low, high)
        if np.array_equal(new, held):
            break
        held = new
    return np.clip(x, low, high)


def _eliminated(
    S: Array, g: Array, parts: Sequence[tuple[Array, Array, Array]], damping: Array
) -> tuple[Array, Array, list[Array]]:
    """S (dampings, p, p) and g (dampings, p) with the nuisances of blocks eliminated, and their damped inverses.

    parts : H (trials, m, m), T'J (trials, m, p) and gradient (trials, m) of each block, or one for each damping.
    """
    S, g = np.tile(S, (damping.size, 1, 1)), np.array(np.broadcast_to(g, (damping.size, S.shape[0])))
    inverses = []
    for H, TJ, gT in parts:
        m = H.shape[-1]
        inverse = np.asarray(np.linalg.inv(H + damping[:, None, None, None] * H * np.eye(m)), float)
        S -= np.sum(TJ.swapaxes(-1, -2) @ (inverse @ TJ), axis=1)
        g -= np.sum(TJ.swapaxes(-1, -2) @ (inverse @ gT[..., None]), axis=1)[..., 0]
        inverses.append(inverse)
    return S, g, inverses


@dataclass(frozen=True, eq=False)
class Normals:
    """S and g before the elimination, and each trial's H, T'J and nuisance gradient."""

    linear: Linear
    S: Array
    g: Array
    cost: float
    parts: tuple[tuple[Block, Array, Array, Array], ...]
    size: int

    def reduced(self) -> tuple[Array, Array, list[Array]]:
        """S and g with the nuisances eliminated, and H_j^-1 of each block."""
        S, g, inverses = _eliminated(self.S, self.g, [part[1:] for part in self.parts], np.zeros(1))
        return S[0], g[0], [inverse[0] for inverse in inverses]

    def steps(
        self, dampings: Sequence[float], reach: float = math.inf, bend: Array | None = None, between: bool = False
    ) -> tuple[Array, dict[int, Array]]:
        """Damped Gauss-Newton steps, one for each damping, with every eta within its bounds.

        In q (dampings, size), and in each trial's eta (dampings, m).

        What would leave its bounds goes to them, and the step is taken anew in all others: cut off alone, it would
        leave to nothing what the others were meant to give way for. So does a coordinate of q that would move by more
        than `reach`: what the readings hardly show may be sent anywhere, and must not hold up the rest.

        bend (size,) : further curvature of the cost by each q; between : instants stay between the same readings.
        """
        damping = np.asarray(dampings, float)
        count = damping.size
        curved = np.zeros(self.size) if bend is None else bend
        far = np.full(self.size, reach)
        stuck, fixed = np.zeros((count, self.size), dtype=np.bool_), np.zeros((count, self.size))
        ends = []
        for b, *_ in self.parts:
            low, high = b.group.between_readings(b.eta) if between else (b.group.lower, b.group.upper)
            ends.append((low - b.eta, high - b.eta))
        held = [np.zeros((count, *low.shape), dtype=np.bool_) for low, _ in ends]
        at = [np.zeros(h.shape) for h in held]
        diagonal = np.arange(self.size)
        for _ in range(MOST_HELD):
            given, parts = self._holding(held, at)
            S, g, inverses = _eliminated(self.S, given, parts, damping)
            S[:, diagonal, diagonal] = S[:, diagonal, diagonal] * (1.0 + damping[:, None]) + curved
            dq = np.where(stuck, fixed, 0.0)
            known = (S @ dq[:, :, None])[:, :, 0]
            free = ~stuck[:, :, None] & ~stuck[:, None, :]
            rest = np.where(stuck, 0.0, g + known)
            solved = np.linalg.solve(np.where(free, S, np.eye(self.size)), rest[:, :, None])[:, :, 0]
            dq = np.where(stuck, fixed, -solved)
            moves, pulls = [], []
            for (_, H, TJ, gT), (_, TJ_held, gT_held), inverse, h, a in zip(
                self.parts, parts, inverses, held, at, strict=True
            ):
                along = dq[:, None, :, None]
                x = -(inverse @ (gT_held[..., None] + TJ_held @ along))[..., 0]
                moves.append(np.where(h, a, x))
                pulls.append((H @ moves[-1][..., None] + TJ @ along)[..., 0] + gT)
            renewed = [_held_next(x, p, h, *end) for x, p, h, end in zip(moves, pulls, held, ends, strict=True)]
            caught, fixed = _held_next(dq, (S @ dq[:, :, None])[:, :, 0] + g, stuck, -far, far)
            same = all(np.array_equal(h, new) for h, (new, _) in zip(held, renewed, strict=True))
            if same and np.array_equal(caught, stuck):
                break
            stuck, held, at = caught, [new for new, _ in renewed], [x for _, x in renewed]
        deta = {
            i: move[:, k]
            for (block, _, _, _), move in zip(self.parts, moves, strict=True)
            for k, i in enumerate(block.group.trials)
        }
        return dq, deta

    def _holding(
        self, held: Sequence[NDArray[np.bool_]], at: Sequence[Array]
    ) -> tuple[Array, list[tuple[Array, Array, Array]]]:
        """g, and H, T'J and gradient of each block, with each held eta moved to where it is held."""
        g, parts = self.g, []
        for (_, H, TJ, gT), h, move in zip(self.parts, held, at, strict=True):
            if not h.any():
                parts.append((H, TJ, gT))
                continue
            given = np.where(h, move, 0.0)
            g = g + np.sum((TJ.transpose(0, 2, 1) @ given[..., None])[..., 0], axis=1)
            pulled = np.where(h, 0.0, gT + (H @ given[..., None])[..., 0])
            free = ~h[..., :, None] & ~h[..., None, :]
            parts.append((np.where(free, H, np.eye(H.shape[-1])), np.where(h[..., None], 0.0, TJ), pulled))
        return g, parts

    def log_evidence(self) -> float:
        """Laplace evidence without the constant of the noise; -inf if a matrix is not positive definite."""
        S, _, _ = self.reduced()
        total = -0.5 * self.cost
        sign, log_det = np.linalg.slogdet(S)
        if sign <= 0 or not np.isfinite(log_det):
            return -math.inf
        total -= 0.5 * log_det
        for _, H, _, _ in self.parts:
            if H.shape[1]:
                signs, log_dets = np.linalg.slogdet(H)
                if np.any(signs <= 0):
                    return -math.inf
                total -= 0.5 * float(np.sum(log_dets))
        return total if math.isfinite(total) else -math.inf
