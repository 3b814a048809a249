"""The evidence by nested sampling: slow, and independent of any chain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]


def nested(
    log_likelihood: Callable[[Array], Array],
    transform: Callable[[Array], Array],
    ndim: int,
    seed: int,
    *,
    live: int,
    **settings: int,
) -> tuple[float, float]:
    """Log evidence and its error by nautilus, exploration discarded; a test without nautilus is skipped.

    transform : unit cube (n, ndim) -> points (n, ndim) distributed as the prior; settings : of nautilus' sampler.
    """
    nautilus = pytest.importorskip("nautilus")
    sampler = nautilus.Sampler(
        transform, log_likelihood, n_dim=ndim, n_live=live, vectorized=True, seed=seed, **settings
    )
    sampler.run(discard_exploration=True, verbose=False)
    return float(sampler.log_z), float(1.0 / np.sqrt(sampler.n_eff))
