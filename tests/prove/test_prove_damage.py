"""A hundred thousand files damaged at random: a sentence each or silence, no traceback, no hang, little memory."""

from __future__ import annotations

import re
import resource
from collections import Counter

import damage
import damaged_files
import numpy as np
import pages
import parts
import pytest

COUNT = 100_000
AT_ONCE = 1000  # inputs of a task
SECONDS = 60.0
"""Time that reading one of them may take, beside other work; it takes some 15 ms."""
MOST_KB = 1_000_000
NUMBER = re.compile(rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
TOKENS = [x.encode() for x in (*damage.TOML_VALUES, *damage.CELLS) if len(x) < 5000]


CHANGES = ("random bytes", "bytes left out", "bytes repeated", "a token put in", "lines swapped", "a number replaced")


def mangled(raw: bytes, rng: np.random.Generator) -> tuple[bytes, set[str]]:
    """A file with one to four random changes, and their kinds: bytes, slices, lines, numbers."""
    kinds = set()
    for _ in range(rng.integers(1, 5)):
        a, b = sorted(rng.integers(0, len(raw) + 1, size=2))
        b = min(b, a + int(rng.integers(1, 60)))
        token = TOKENS[rng.integers(len(TOKENS))]
        kind = rng.integers(7)
        kinds.add(CHANGES[min(kind, 5)])
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
            return b"x", kinds
    return raw, kinds


def mangle(targets, name, count):
    """So many mangled files of the targets' folders, one at a time, each read by its target's call."""
    good = [
        (target, file, (target.folder / file).read_bytes())
        for target in targets
        for file in sorted({d.file for d in target.damages})
    ]

    def task(number):
        files, changes, faults = Counter(), Counter(), {}
        for seed in range(number * AT_ONCE, (number + 1) * AT_ONCE):
            rng = np.random.default_rng([seed, 23])
            target, file, raw = good[rng.integers(len(good))]
            bad, kinds = mangled(raw, rng)
            outcome = damage.Outcome()
            (target.folder / file).write_bytes(bad)
            damage.tried(target.call, f"{target.name}: {file}, seed {seed}", outcome, SECONDS)
            (target.folder / file).write_bytes(raw)
            how = "sentence" if outcome.told else "silence" if outcome.silent else "fault"
            files[f"{target.name}: {file}|{how}"] += 1
            changes.update(f"{kind}|{how}" for kind in kinds)
            faults |= outcome.faults
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return {"inputs": AT_ONCE, "files": files, "changes": changes, "faults": faults, "peak_kb": peak}

    results = parts.finish(name, count // AT_ONCE, task)
    pages.damage()
    faults = {case: told for r in results for case, told in r["faults"].items()}
    shown = "\n".join(f"{case}\n{told}" for case, told in list(faults.items())[:5])
    assert not faults, f"{len(faults)} of {count}\n{shown}"
    said = sum(n for r in results for how, n in r["files"].items() if how.endswith("|sentence"))
    assert said > 0.5 * count
    assert max(r["peak_kb"] for r in results) < MOST_KB


@pytest.mark.prove
def test_files_mangled_at_random_are_told(tmp_path):
    targets = [*damaged_files.campaign_targets(tmp_path), *damaged_files.import_targets(tmp_path / "raw")]
    mangle(targets, "damage-files", COUNT)


@pytest.mark.prove
def test_results_mangled_at_random_are_told(tmp_path):
    mangle([*damaged_files.results_targets(tmp_path)], "damage-results", COUNT // 10)
