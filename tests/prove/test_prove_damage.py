"""A hundred thousand files damaged at random: a sentence each or silence, no traceback, no hang, little memory."""

from __future__ import annotations

import re
import resource

import damage
import damaged_files
import numpy as np
import pytest

COUNT = 100_000
MOST_KB = 1_000_000
NUMBER = re.compile(rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
TOKENS = [x.encode() for x in (*damage.TOML_VALUES, *damage.CELLS) if len(x) < 5000]


def mangled(raw: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to four random changes: bytes, slices, lines, numbers."""
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(rng.integers(0, len(raw) + 1, size=2))
        b = min(b, a + int(rng.integers(1, 60)))
        token = TOKENS[rng.integers(len(TOKENS))]
        kind = rng.integers(7)
        if kind == 0:
            raw = raw[:a] + bytes(rng.integers(0, 256, size=b - a, dtype=np.uint8)) + raw[b:]
        elif kind == 1:
            raw = raw[:a] + raw[b:]
        elif kind == 2:
            raw = raw[:a] + raw[a:b] * int(rng.integers(2, 5)) + raw[b:]
        elif kind == 3:
            raw = raw[:a] + token + raw[b:]
        elif kind == 4:
            lines = raw.split(b"\n")
            i, j = rng.integers(len(lines), size=2)
            lines[i], lines[j] = lines[j], lines[i]
            raw = b"\n".join(lines)
        else:
            numbers = list(NUMBER.finditer(raw))
            if numbers:
                found = numbers[rng.integers(len(numbers))]
                scale = float(10.0 ** rng.integers(-40, 41)) * (-1.0) ** int(rng.integers(2))
                number = found[0] + b"e%d" % rng.integers(-400, 400) if rng.random() < 0.5 else repr(scale).encode()
                raw = raw[: found.start()] + (token if rng.random() < 0.3 else number) + raw[found.end() :]
        if not raw:
            return b"x"
    return raw


def mangle(targets, count, outcome):
    """So many mangled files of the targets' folders, one at a time, each read by the call of its target."""
    good = [
        (target, name, (target.folder / name).read_bytes())
        for target in targets
        for name in sorted({d.file for d in target.damages})
    ]
    for seed in range(count):
        rng = np.random.default_rng([seed, 23])
        target, name, raw = good[rng.integers(len(good))]
        (target.folder / name).write_bytes(mangled(raw, rng))
        damage.tried(target.call, f"{name}, seed {seed}", outcome)
        (target.folder / name).write_bytes(raw)
    faults = "\n".join(f"{case}\n{told}" for case, told in list(outcome.faults.items())[:5])
    assert not outcome.faults, f"{len(outcome.faults)} of {outcome.cases}\n{faults}"
    assert outcome.cases == count
    assert len(outcome.told) > 0.5 * count
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < max(MOST_KB, outcome.began_kb + MOST_KB // 2)


@pytest.mark.prove
def test_files_mangled_at_random_are_told(tmp_path):
    outcome = damage.Outcome()
    mangle([*damaged_files.campaign_targets(tmp_path), *damaged_files.import_targets(tmp_path / "raw")], COUNT, outcome)


@pytest.mark.prove
def test_results_mangled_at_random_are_told(tmp_path):
    outcome = damage.Outcome()
    mangle([target for _, target in damaged_files.results_targets(tmp_path)], COUNT // 10, outcome)
