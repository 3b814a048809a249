"""Damages good files, by kind, and looks what a command makes of each: a sentence, silence, or a fault of ours.

A `Target` is a folder with a call that reads it; a `Damage` replaces one file of it. Nothing here knows what the call
checks: what counts is that it ends in time, within the memory, with no other error than an `InputError`.
"""

from __future__ import annotations

import gzip
import json
import os
import re
import resource
import shutil
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper.errors import BayesDamperError

SECONDS = 10.0
"""CPU time that reading one damaged folder may take; it takes milliseconds."""
NO_SENTENCE = re.compile(r"\x1b|\b[A-Z]\w*Error\b|object has no|object is not")
"""What no sentence has in it: what steers a terminal, and what Python says to programmers."""
TOML_VALUES = (
    "1" + "0" * 400,
    "9" * 5000,
    "0x" + "F" * 4000,
    "1e308",
    "-1e308",
    "1e-308",
    "1e300",
    "1e31",
    "-1",
    "-1e-9",
    "0",
    "0.0",
    "1_0",
    "nan",
    "inf",
    "-inf",
    "true",
    '""',
    '"text"',
    '"\\u0661\\u0660"',
    '"1.0"',
    '"\\u001b[31m"',
    "[]",
    "{}",
    "[[1]]",
    "[1, 2, 3]",
    '["a"]',
    "[1.0, -1.0]",
    "{ value = 1.0 }",
    '{ value = "x" }',
    "{ value = 1.0, std = -1 }",
    "{ value = 1.0, std = 1e308 }",
    "{ value = nan }",
    "{ valeu = 1.0 }",
    "1979-05-27",
    "07:32:00",
    "[" * 2000 + "]" * 2000,
    "{ a = " * 300 + "1" + " }" * 300,
    "'''\n'''",
    '"' + "x" * 200_000 + '"',
    "",
    "=",
    '"open',
    "1..2",
    "0x",
    "1e",
    "--1",
    "+-1",
)
CELLS = (
    "",
    " ",
    "x",
    "1_0",
    "\u0661\u0660",
    "\uff11\uff10",
    "\u22121",
    "1e400",
    "-1e400",
    "1" * 400,
    "1e308",
    "-1e308",
    "1e-308",
    "1e31",
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1.5",
    "1,5",
    '"1',
    '"1"',
    '""',
    '1"',
    "1\r2",
    "1\n2",
    "1\t2",
    "1;2",
    "x" * 140_000,
    "\0",
    "..",
    ".",
    "/",
    "/etc/passwd",
    "../x",
    "C:\\x",
    "a/../../b",
    "=1+1",
    "<script>",
    "\x1b[31m",
    "true",
    "0x10",
    "1e",
    "+",
    "\U0001f600",
    "a" * 300,
    "COUPLED",
    "1.0.0",
    "1 0",
    "1'000",
)
JSON_VALUES = (
    "null",
    "true",
    '"x"',
    '""',
    "[]",
    "{}",
    "[[]]",
    "-1",
    "0",
    "1e999",
    "1" + "0" * 400,
    "NaN",
    '"\\ud800"',
    "[" * 3000,
    '{"a": 1}',
)


@dataclass(frozen=True)
class Damage:
    """One file replaced: `apply` is called with its path; name : of the kind, then what exactly."""

    file: str
    name: str
    apply: Callable[[Path], None]

    @property
    def case(self) -> str:
        return f"{self.file}: {self.name}"


@dataclass
class Outcome:
    """What became of all damages: sentences told, cases without one, and our own faults with their tracebacks."""

    told: dict[str, tuple[str, ...]] = field(default_factory=dict)
    silent: list[str] = field(default_factory=list)
    faults: dict[str, str] = field(default_factory=dict)
    began_kb: int = field(default_factory=lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

    @property
    def cases(self) -> int:
        return len(self.told) + len(self.silent) + len(self.faults)


class TooLongError(BaseException):
    """A call did not end in time; not an Exception, so that nothing takes it for an error of the file."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raises TooLongError in the block after so many seconds of work, where there are timers (not on Windows).

    What waits uses none: six times as long by the clock ends it too. A busy machine alone does not.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(*_: Any) -> None:
        raise TooLongError

    timers = ((signal.SIGPROF, signal.ITIMER_PROF, seconds), (signal.SIGALRM, signal.ITIMER_REAL, 6.0 * seconds))
    before = [signal.signal(number, ring) for number, _, _ in timers]
    for _, timer, after in timers:
        signal.setitimer(timer, after)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


def tried(call: Callable[[], Any], case: str, outcome: Outcome, seconds: float = SECONDS) -> None:
    """Calls, and notes in `outcome` how it ended."""
    try:
        with time_limit(seconds):
            call()
    except BayesDamperError as error:
        sentences = getattr(error, "faults", (str(error),))
        if not sentences or any(not s.strip() or len(s) > 5000 or NO_SENTENCE.search(s) for s in sentences):
            outcome.faults[case] = f"no sentence: {sentences!r}"[:400]
        outcome.told[case] = sentences
    except TooLongError:
        outcome.faults[case] = f"no end after {seconds} s"
    except (Exception, SystemExit):  # noqa: BLE001 (whatever else it is, it is our fault)
        outcome.faults[case] = traceback.format_exc(limit=-4)
    else:
        outcome.silent.append(case)


def run(
    folder: Path, damages: Sequence[Damage], call: Callable[[], Any], outcome: Outcome, seconds: float = SECONDS
) -> None:
    """Applies each damage to its file in `folder`, calls, and puts the file back."""
    for damage in damages:
        path = folder / damage.file
        kept = path.read_bytes()
        try:
            damage.apply(path)
            tried(call, damage.case, outcome, seconds)
        finally:
            remove(path)
            path.write_bytes(kept)


def remove(path: Path) -> None:
    """Whatever lies there is gone afterwards."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


# Kinds of damage ------------------------------------------------------------------------------------------------------


def written(content: bytes | str) -> Callable[[Path], None]:
    """A damage that writes this."""
    raw = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(raw) and None


def placed(make: Callable[[Path], Any]) -> Callable[[Path], None]:
    """A damage that puts something else in the place of a file."""

    def apply(path: Path) -> None:
        path.unlink()
        make(path)

    return apply


def of_any_file(file: str, raw: bytes) -> Iterator[Damage]:
    """What can befall every file, whatever it holds."""
    for share in (0.1, 0.35, 0.5, 0.8, 0.95):
        yield Damage(file, f"cut at {share:g}", written(raw[: int(share * len(raw))]))
    for name, content in {
        "empty": b"",
        "blank": b"\n \n",
        "one byte": b"x",
        "bytes of 0": b"\0" * 5000,
        "all bytes": bytes(range(256)) * 20,
        "a byte of 0 in it": raw[: len(raw) // 2] + b"\0" + raw[len(raw) // 2 :],
        "a byte of 0 at its end": raw + b"\0",
        "no UTF-8 in it": raw[: len(raw) // 3] + b"\xff\xfe\xc3" + raw[len(raw) // 3 :],
        "twice": raw + raw,
        "reversed": raw[::-1],
        "a spreadsheet": b"PK\x03\x04" + raw,
        "compressed": gzip.compress(raw),
        "UTF-16": raw.decode("utf-8", "replace").encode("utf-16"),
        "two marks of byte order": b"\xef\xbb\xbf" * 2 + raw,
        "lines of an old Mac": raw.replace(b"\n", b"\r"),
        "lines of Windows": raw.replace(b"\n", b"\r\n"),
        "no line ends": raw.replace(b"\n", b" "),
        "a line of 300 000": raw + b"y" * 300_000 + b"\n",
        "brackets": b"[" * 100_000,
        "quotes": b'"' * 10_001,
        "commas": b"," * 100_000,
        "a lone return": raw.replace(b"\n", b"\n\r", 1),
        "line separators": raw.replace(b"\n", "\u2028".encode()),
        "form feeds": raw.replace(b"\n", b"\x0c\n"),
    }.items():
        yield Damage(file, name, written(content))
    yield Damage(file, "missing", lambda path: path.unlink())
    yield Damage(file, "a folder", placed(Path.mkdir))
    yield Damage(file, "a link to nothing", placed(lambda path: path.symlink_to("nowhere")))
    yield Damage(file, "a link to itself", placed(lambda path: path.symlink_to(path.name)))
    if hasattr(os, "mkfifo"):
        yield Damage(file, "a named pipe", placed(os.mkfifo))
    if Path("/dev/zero").exists():
        yield Damage(file, "a device", placed(lambda path: path.symlink_to("/dev/zero")))
    yield Damage(file, "a terabyte", placed(_terabyte))
    for k in range(8):
        rng = np.random.default_rng([k, len(raw)])
        flipped = bytearray(raw)
        for place in rng.integers(len(raw), size=1 + 2 * k):
            flipped[place] ^= int(rng.integers(1, 256))
        yield Damage(file, f"bytes changed, {k}", written(bytes(flipped)))


def _terabyte(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


def of_toml(file: str, text: str) -> Iterator[Damage]:
    """Every line of a TOML file removed, doubled, misspelt, and every value replaced."""
    lines = text.splitlines()
    for i, line in enumerate(lines):

        def changed(*new: str, at: int = i) -> Callable[[Path], None]:
            return written("\n".join([*lines[:at], *new, *lines[at + 1 :]]) + "\n")

        if not line.strip() or line.startswith("#"):
            continue
        yield Damage(file, f"without line {i + 1}, {line[:30]}", changed())
        yield Damage(file, f"line {i + 1} twice, {line[:30]}", changed(line, line))
        if line.startswith("["):
            yield Damage(file, f"table {line} misspelt", changed(line.replace("[", "[x", 1)))
            continue
        key, _, _ = line.partition(" = ")
        yield Damage(file, f"key {key} misspelt", changed(f"x{line}"))
        yield Damage(file, f"key {key} nested", changed(f"{'.'.join('a' * 300)}.{line}"))
        for value in TOML_VALUES:
            yield Damage(file, f"{key} = {value[:40]!r}", changed(f"{key} = {value}"))


def of_csv(file: str, text: str, rows: Sequence[int] = (1, 2)) -> Iterator[Damage]:
    """Every cell of some rows of a CSV file replaced, every column removed, doubled and renamed."""
    table = [line.split(",") for line in text.splitlines()]

    def changed(new: Sequence[Sequence[str]]) -> Callable[[Path], None]:
        return written("\n".join(",".join(cells) for cells in new) + "\n")

    for j, name in enumerate(table[0]):
        for i in rows:
            for cell in CELLS:
                new = [list(cells) for cells in table]
                new[i][j] = cell
                yield Damage(file, f"row {i}, {name} = {cell[:30]!r}", changed(new))
        yield Damage(file, f"without column {name}", changed([[*c[:j], *c[j + 1 :]] for c in table]))
        yield Damage(file, f"column {name} twice", changed([[*c, c[j]] for c in table]))
        yield Damage(file, f"column {name} renamed", changed([[*table[0][:j], "what", *table[0][j + 1 :]], *table[1:]]))
        yield Damage(file, f"column {name} alone", changed([[c[j]] for c in table]))
    yield Damage(file, "the head alone", changed(table[:1]))
    yield Damage(file, "no head", changed(table[1:]))
    yield Damage(file, "rows reversed", changed([table[0], *table[:0:-1]]))
    yield Damage(file, "each row twice", changed([table[0], *(row for row in table[1:] for _ in range(2))]))
    yield Damage(file, "one row", changed(table[:2]))
    yield Damage(file, "a short row", changed([*table[:2], table[2][:-1], *table[3:]]))
    yield Damage(file, "a long row", changed([*table[:2], [*table[2], "1"], *table[3:]]))
    yield Damage(file, "semicolons", written(text.replace(",", ";")))
    yield Damage(file, "decimal commas", written(text.replace(".", ",")))
    yield Damage(file, "10 000 columns", changed([cells * 2000 for cells in table]))


def of_json(file: str, text: str, most: int = 400) -> Iterator[Damage]:
    """Entries of a JSON file replaced or removed: all of a small one, evenly chosen ones of a large one."""
    content = json.loads(text)
    places = list(_places(content))
    for place in places[:: max(1, len(places) * (len(JSON_VALUES) + 1) // most)]:
        for value in (*JSON_VALUES, None):
            yield Damage(
                file,
                f"{'.'.join(map(str, place))} = {'absent' if value is None else value[:20]}",
                written(_with(content, place, value)),
            )


def _places(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    entries = (
        content.items() if isinstance(content, dict) else enumerate(content[:2]) if isinstance(content, list) else ()
    )
    for key, inner in entries:
        yield (*place, key)
        yield from _places(inner, (*place, key))


def _with(content: Any, place: Sequence[Any], value: str | None) -> str:
    """JSON with one entry replaced by a text that need not be JSON, or left out."""
    copy = json.loads(json.dumps(content))
    holder = copy
    for key in place[:-1]:
        holder = holder[key]
    if value is None:
        del holder[place[-1]]
        return json.dumps(copy)
    holder[place[-1]] = "@@@"
    return json.dumps(copy).replace('"@@@"', value)


def reason(case: str, reasons: Sequence[tuple[str, str]]) -> str:
    """Why silence is right in this case, by `reasons` (pattern, why); "" if no pattern covers it."""
    return next((why for pattern, why in reasons if re.search(pattern, case)), "")


def unexplained(cases: Sequence[str], reasons: Sequence[tuple[str, str]]) -> list[str]:
    """Cases whose silence has no reason."""
    return [case for case in cases if not reason(case, reasons)]
