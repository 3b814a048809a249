"""A checksum of what a computation is given."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest
from numba import njit

from bayes_damper.runs.content_hash import content_sha256


@dataclass(frozen=True)
class Held:
    name: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Other:
    name: str
    values: tuple[float, ...]


def scaled_by(factor):
    def scaled(x):
        return factor * x

    return scaled


def shifted(x, by=1.0):
    return x + by


VALUES = [
    None, True, 1, 1.0, 0.1 + 0.2, 0.3, "1", "", [1.0], [[1.0]], [1.0, 2.0], {"a": 1.0}, {"a": 2.0}, {"b": 1.0},
    np.arange(4.0), np.arange(4), np.arange(4.0).reshape(2, 2), Held("a", (1.0,)), Held("a", (2.0,)),
    Other("a", (1.0,)), scaled_by(2.0), scaled_by(3.0), shifted,
]  # fmt: skip


def test_what_differs_has_another_checksum():
    assert len({content_sha256(v) for v in VALUES}) == len(VALUES)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.arange(6.0)[::2], np.array([0.0, 2.0, 4.0])),
        (Held("a", (1.0,)), Held("a", (1.0,))),
        (scaled_by(2.0), scaled_by(2.0)),
        (njit(shifted), njit(shifted)),
    ],
)
def test_what_is_the_same_has_the_same_one(one, other):
    assert content_sha256(one) == content_sha256(other)


def test_what_has_no_known_content_is_refused():
    with pytest.raises(TypeError, match="no checksum of a object"):
        content_sha256([object()])
    assert content_sha256(MappingProxyType({"a": 1})) != content_sha256(MappingProxyType({"a": 2}))
