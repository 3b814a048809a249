"""Sets of campaigns: which orders a set holds, how they are made in shuffled order, and the key they share."""

import json
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from .campaign import Order, folder_name, make_campaign
from .kinds import KINDS, names

LEVELS = (0.05, 0.1, 0.15, 0.3, 0.5, 1.0, 2.0, 3.0)
GROUPS = ("library", "development", "reserved", "foreign", "none", "pairs")
KEY_SCHEMA = "bayes-damper/withheld-key/1"


def expand(tokens: Sequence[str], pairs: int, rng: np.random.Generator) -> list[tuple[str, ...]]:
    """Effects of each campaign at one level: names, groups of GROUPS, "a+b" for a pair, "name*n" for n of them.

    "pairs" stands for `pairs` pairs of library kinds drawn without twins. ValueError for an unknown name.
    """
    out: list[tuple[str, ...]] = []
    for token in tokens:
        word, _, count = token.partition("*")
        times = int(count) if count else 1
        if word == "none":
            chosen: list[tuple[str, ...]] = [()]
        elif word == "foreign":
            chosen = [(n,) for n in names("development", "reserved")]
        elif word in ("library", "development", "reserved"):
            chosen = [(n,) for n in names(word)]
        elif word == "random":
            chosen = [(str(rng.choice(names("library"))),)]
        elif word == "pairs":
            chosen = [draw_pair(rng) for _ in range(pairs)]
        else:
            chosen = [tuple(word.split("+"))]
        for effects in chosen:
            for name in effects:
                if name not in KINDS:
                    raise ValueError(
                        f"no disturbance or group is called {name!r}; groups: {', '.join(GROUPS)}; "
                        f"disturbances: {', '.join(KINDS)}"
                    )
            out += [effects] * times
    return out


def draw_pair(rng: np.random.Generator) -> tuple[str, str]:
    """Two library kinds that are not twins, any sites."""
    while True:
        a, b = (str(n) for n in rng.choice(names("library"), 2, replace=False))
        if b not in KINDS[a].twins:
            return a, b


def orders(
    kinds: Sequence[str],
    tokens: Sequence[str],
    levels: Sequence[float],
    seed: int,
    pairs: int = 0,
    duration: float = 1.0,
    trigger: str = "late",
) -> list[Order]:
    """Every order of a set, shuffled; each has a seed of its own drawn from `seed`."""
    rng = np.random.default_rng(seed)
    out = []
    for kind in kinds:
        for i, level in enumerate(levels):
            for effects in expand(tokens, pairs, rng):
                if not effects and i > 0:  # nothing wrong has no level: once is enough
                    continue
                own = int(rng.integers(1, 2**53))
                out.append(Order(kind, effects, level if effects else 0.0, own, duration, trigger))
    return [out[i] for i in rng.permutation(len(out))]


def write_set(
    wanted: Sequence[Order],
    folder: Path,
    key_file: Path,
    workers: int = 1,
    salt: str | None = None,
    tell: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Makes every campaign of the set and writes the key after each (existing entries are kept); returns the key."""
    key: dict[str, Any] = {"schema": KEY_SCHEMA, "campaigns": {}}
    if key_file.exists():
        key = json.loads(key_file.read_text())
    salt = str(salt or key.get("salt") or secrets.token_hex(16))
    key["salt"] = salt
    folder.mkdir(parents=True, exist_ok=True)
    key_file.parent.mkdir(parents=True, exist_ok=True)
    todo = [o for o in wanted if folder_name(o, salt) not in key["campaigns"]]

    def keep(order: Order, entry: dict[str, Any]) -> None:
        key["campaigns"][folder_name(order, salt)] = entry
        key["campaigns"] = dict(sorted(key["campaigns"].items()))
        draft = key_file.with_suffix(".tmp")
        draft.write_text(json.dumps(key, indent=1) + "\n")
        draft.replace(key_file)
        if tell is not None:
            tell(f"{len(key['campaigns'])} campaigns, {folder_name(order, salt)}")

    if workers == 1:
        for order in todo:
            keep(order, make_campaign(order, folder, salt))
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            made = pool.map(make_campaign, todo, [folder] * len(todo), [salt] * len(todo))
            for order, entry in zip(todo, made, strict=True):
                keep(order, entry)
    return key
