"""A hundred thousand files damaged at random: a sentence each or silence, no traceback, no hang, little memory.

Beside them command lines, and every damage that is made on purpose, with the reason where silence is right.
"""

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


def of_targets(targets):
    """A mangled file of one of the targets' folders, read by its target's call: (name, kinds of change, outcome)."""
    good = [
        (target, file, (target.folder / file).read_bytes())
        for target in targets
        for file in sorted({d.file for d in target.damages})
    ]

    def one(rng):
        target, file, raw = good[rng.integers(len(good))]
        bad, kinds = mangled(raw, rng)
        outcome = damage.Outcome()
        (target.folder / file).write_bytes(bad)
        damage.tried(target.call, f"{target.name}: {file}", outcome, SECONDS)
        (target.folder / file).write_bytes(raw)
        return f"{target.name}: {file}", kinds, outcome

    return one


def of_the_command_line(home):
    """`init` with one to four options at odd words."""
    good, options = damaged_files.command_line(home), damaged_files.valued_options()
    damaged_files.spoken(good)
    words = [w for w in (*damaged_files.COMMAND_LINE, *damage.CELLS) if "\0" not in w]  # no shell can send that

    def one(rng):
        chosen = [options[k] for k in rng.choice(len(options), rng.integers(1, 5), replace=False)]
        more = [w for option in chosen for w in (option, words[rng.integers(len(words))])]
        outcome = damage.Outcome()
        damage.tried(lambda: damaged_files.spoken([*good, *more]), f"init {ascii(more)[:300]}", outcome, SECONDS)
        return "init: command line", {f"{len(chosen)} odd option{'s'[: len(chosen) - 1]}"}, outcome

    return one


def mangle(one, name, count):
    """So many random inputs, each made and read by `one`."""

    def task(number):
        files, changes, faults = Counter(), Counter(), {}
        for seed in range(number * AT_ONCE, (number + 1) * AT_ONCE):
            what, kinds, outcome = one(np.random.default_rng([seed, 23]))
            how = "sentence" if outcome.told else "silence" if outcome.silent else "fault"
            files[f"{what}|{how}"] += 1
            changes.update(f"{kind}|{how}" for kind in kinds)
            faults |= {f"{case}, seed {seed}": told for case, told in outcome.faults.items()}
        return {"inputs": AT_ONCE, "files": files, "changes": changes, "faults": faults, "peak_kb": peak_kb()}

    results = parts.finish(name, count // AT_ONCE, task)
    pages.damage()
    shown(results, count)
    said = sum(n for r in results for how, n in r["files"].items() if how.endswith("|sentence"))
    assert said > 0.5 * count


def peak_kb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def shown(results, count):
    """No fault, and little memory."""
    faults = {case: told for r in results for case, told in r["faults"].items()}
    some = "\n".join(f"{case}\n{told}" for case, told in list(faults.items())[:5])
    assert not faults, f"{len(faults)} of {count}\n{some}"
    assert max(r["peak_kb"] for r in results) < MOST_KB


@pytest.mark.prove
def test_files_mangled_at_random_are_told(tmp_path):
    targets = [*damaged_files.campaign_targets(tmp_path), *damaged_files.import_targets(tmp_path / "raw")]
    mangle(of_targets([*targets, *damaged_files.logger_targets(tmp_path / "other")]), "damage-files", COUNT)


@pytest.mark.prove
def test_results_mangled_at_random_are_told(tmp_path):
    mangle(of_targets([*damaged_files.results_targets(tmp_path)]), "damage-results", COUNT // 10)


@pytest.mark.prove
def test_command_lines_mangled_at_random_are_told(tmp_path):
    mangle(of_the_command_line(tmp_path / "raw"), "damage-lines", COUNT // 10)


@pytest.mark.prove
def test_each_damage_made_on_purpose_is_counted(tmp_path):
    """All of those of which the quick tests try some: campaigns, imports, logger files, options, command lines."""
    targets = [*damaged_files.campaign_targets(tmp_path), *damaged_files.import_targets(tmp_path / "raw")]
    targets += damaged_files.logger_targets(tmp_path / "other")
    kinds = [(t.name, lambda outcome, t=t: damage.run(t.folder, t.damages, t.call, outcome, SECONDS)) for t in targets]

    def tried(calls, outcome):
        for name, call in calls:
            damage.tried(call, name, outcome, SECONDS)

    for name, calls in (
        ("init: options, from Python", damaged_files.option_calls(tmp_path / "options")),
        ("init: options, command line", damaged_files.command_line_calls(tmp_path / "lines")),
    ):
        kinds.append((name, lambda outcome, calls=calls: tried(calls, outcome)))

    def task(number):
        name, run = kinds[number]
        outcome = damage.Outcome()
        run(outcome)
        reasons = Counter(damage.reason(case, damaged_files.SILENT) for case in outcome.silent)
        return {"name": name, "told": len(outcome.told), "silent": reasons, "faults": outcome.faults} | {
            "peak_kb": peak_kb()
        }

    results = parts.finish("damage-purpose", len(kinds), task)
    pages.damage()
    count = sum(r["told"] + sum(r["silent"].values()) for r in results)
    shown(results, count)
    assert count > 8000
    assert not any("" in r["silent"] for r in results), "silence without a reason"
