"""Sums over a record that a likelihood needs, taken while the record is still in the block that computed it.

An `Accumulator` is handed to `Model.accumulate`; it turns a record and the data into a few numbers per channel, so that
no array of records is ever filled. Each is a kernel that runs along time in sixteen partial sums, which vectorises
without reassociating anything: the sums of a vector do not depend on who shares its block. Noise models and what the
sums mean as a likelihood live in likelihood.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_damper.rig import vector_math
from bayes_damper.rig.kernels import compiled

_PARTS = 16


@dataclass(frozen=True)
class Accumulator:
    """How to sum.

    `kernel(block, skip, data, weight, directions, options, sums)` fills sums (m, n_channels, n_sums) from the records
    of m vectors, block[v, c, skip : skip + n], from the data and weights (0 where there is no datum), each
    (n_channels, n), from directions (k, n_channels, n), and from options (m, any), numbers of its own for each vector.
    `size(k)` gives n_sums.
    """

    name: str
    kernel: Callable[..., None]
    size: Callable[[int], int]


@compiled(fastmath=vector_math.FASTMATH)
def _gaussian(block: Any, skip: int, data: Any, weight: Any, directions: Any, _options: Any, sums: Any) -> None:
    """Sum w r^2, then sum w r T_k for each direction; r = data - y."""
    n = data.shape[1]
    whole = n - n % _PARTS
    part = np.empty(_PARTS)
    for v in range(sums.shape[0]):
        for c in range(data.shape[0]):
            for k in range(1 + directions.shape[0]):
                part[:] = 0.0
                total = 0.0
                if k == 0:
                    for i in range(0, whole, _PARTS):
                        for j in range(_PARTS):
                            r = data[c, i + j] - block[v, c, skip + i + j]
                            part[j] += weight[c, i + j] * r * r
                    for i in range(whole, n):
                        r = data[c, i] - block[v, c, skip + i]
                        total += weight[c, i] * r * r
                else:
                    for i in range(0, whole, _PARTS):
                        for j in range(_PARTS):
                            r = data[c, i + j] - block[v, c, skip + i + j]
                            part[j] += weight[c, i + j] * r * directions[k - 1, c, i + j]
                    for i in range(whole, n):
                        total += weight[c, i] * (data[c, i] - block[v, c, skip + i]) * directions[k - 1, c, i]
                for j in range(_PARTS):
                    total += part[j]
                sums[v, c, k] = total


@compiled(fastmath=vector_math.FASTMATH)
def _autoregressive(block: Any, skip: int, data: Any, weight: Any, _directions: Any, _options: Any, sums: Any) -> None:
    """Sum w r_i^2, sum over neighbours of r_(i-1)^2, r_i r_(i-1) and r_i^2, where both are data.

    The innovations of an AR(1) noise have sum (r_i - rho r_(i-1))^2 = sums[3] - 2 rho sums[2] + rho^2 sums[1].
    """
    n = data.shape[1]
    whole = n - 1 - (n - 1) % _PARTS
    part = np.empty((4, _PARTS))
    for v in range(sums.shape[0]):
        for c in range(data.shape[0]):
            part[:] = 0.0
            first = data[c, 0] - block[v, c, skip + 0]
            part[0, 0] = weight[c, 0] * first * first
            for i in range(1, 1 + whole, _PARTS):
                for j in range(_PARTS):
                    r = data[c, i + j] - block[v, c, skip + i + j]
                    before = data[c, i + j - 1] - block[v, c, skip + i + j - 1]
                    both = weight[c, i + j] * weight[c, i + j - 1]
                    part[0, j] += weight[c, i + j] * r * r
                    part[1, j] += both * before * before
                    part[2, j] += both * r * before
                    part[3, j] += both * r * r
            for i in range(1 + whole, n):
                r = data[c, i] - block[v, c, skip + i]
                before = data[c, i - 1] - block[v, c, skip + i - 1]
                both = weight[c, i] * weight[c, i - 1]
                part[0, 0] += weight[c, i] * r * r
                part[1, 0] += both * before * before
                part[2, 0] += both * r * before
                part[3, 0] += both * r * r
            for k in range(4):
                total = 0.0
                for j in range(_PARTS):
                    total += part[k, j]
                sums[v, c, k] = total


@compiled(fastmath=vector_math.FASTMATH)
def _student(block: Any, skip: int, data: Any, weight: Any, _directions: Any, options: Any, sums: Any) -> None:
    """Sum w log(1 + r^2 / (dof s_c^2)); options: dof, then the scale s of each channel."""
    n = data.shape[1]
    whole = n - n % _PARTS
    part = np.empty(_PARTS)
    for v in range(sums.shape[0]):
        for c in range(data.shape[0]):
            per = 1.0 / (options[v, 0] * options[v, 1 + c] * options[v, 1 + c])
            part[:] = 0.0
            total = 0.0
            for i in range(0, whole, _PARTS):
                for j in range(_PARTS):
                    r = data[c, i + j] - block[v, c, skip + i + j]
                    part[j] += weight[c, i + j] * vector_math.log(1.0 + r * r * per)
            for i in range(whole, n):
                r = data[c, i] - block[v, c, skip + i]
                total += weight[c, i] * vector_math.log(1.0 + r * r * per)
            for j in range(_PARTS):
                total += part[j]
            sums[v, c, 0] = total


GAUSSIAN = Accumulator("gaussian", _gaussian, lambda k: 1 + k)
AUTOREGRESSIVE = Accumulator("autoregressive", _autoregressive, lambda _k: 4)
STUDENT = Accumulator("student", _student, lambda _k: 1)
