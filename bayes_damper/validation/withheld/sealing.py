"""Seals: what is frozen before the first verdict, how verdicts are sealed, and when the key may be opened.

A freeze holds checksums of the code, the library of effects, every campaign and the key (its bytes, unread), with the
seed. Each verdict is written once, with the checksum of its own content and of the freeze. When every verdict is there
they are chained,

    link_0 = sha256 of the freeze,    link_i = sha256(link_(i-1), name_i, seal_i)    (names in alphabetical order),

and only then the key is read. Seals guard against accident and against second thoughts, not against somebody who writes
all files anew; the last link, published beside a result, guards against that too.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

from bayes_damper.effects import Effect, classes
from bayes_damper.errors import InputError, SelfCheckError
from bayes_damper.runs.contents.withheld import Freeze, KeyEntry, SealedVerdict, Verdict
from bayes_damper.runs.json_files import read_json, write_json
from bayes_damper.runs.provenance import code_sha256, commit, package_version

FREEZE_SCHEMA = "bayes-damper/withheld-freeze/1"
VERDICT_SCHEMA = "bayes-damper/withheld-verdict/1"
KEY_SCHEMA = "bayes-damper/withheld-key/1"
JUDGES = ("bayes_damper.diagnosis", "bayes_damper.campaign")
"""What gives a verdict: these, with all that they import, are frozen."""


def digest(data: Any) -> str:
    """SHA-256 of JSON data, the same whatever the order of its names and the white space of its file."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes.

    Raises
    ------
    InputError
        if there is no such file.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name the key's file with --key") from None


def folder_sha256(folder: Path) -> str:
    """SHA-256 of all files below a folder, names and bytes, in alphabetical order."""
    out = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        out.update(path.relative_to(folder).as_posix().encode() + b"\0")
        out.update(hashlib.sha256(path.read_bytes()).digest())
    return out.hexdigest()


def library_sha256(effects: Mapping[str, Effect]) -> str:
    """Checksum of what the library offers: effects, sites, classes, formulas, priors and starts."""
    rows = [
        [e.name, e.site, [[v.name, v.formula, repr(v.starts), [repr(p) for p in v.parameters]] for v in e.variants]]
        for e in (effects[name] for name in sorted(effects))
    ]
    return digest([rows, [sorted(group) for group in classes(effects)]])


def freeze(campaigns: Mapping[str, Path], key: Path, effects: Mapping[str, Effect], seed: int, call: str) -> Freeze:
    """What a run is bound to: checksums of code, effects, campaigns and key; seed; the function that gives verdicts."""
    return {
        "schema": FREEZE_SCHEMA,
        "bayes_damper": package_version(),
        "commit": commit(),
        "code_sha256": code_sha256(*JUDGES),
        "effects_sha256": library_sha256(effects),
        "effects": sorted(effects),
        "key_sha256": file_sha256(key),
        "campaigns": {name: folder_sha256(campaigns[name]) for name in sorted(campaigns)},
        "seed": seed,
        "call": call,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def differences(old: Freeze, new: Freeze) -> list[str]:
    """What differs between two freezes in code, effects or call, one sentence each: reasons for a rehearsal."""
    hashed = (
        ("the code of the diagnosis", old["code_sha256"], new["code_sha256"]),
        ("the library of effects", old["effects_sha256"], new["effects_sha256"]),
        ("the function that gives the verdicts", old["call"], new["call"]),
    )
    return [
        f"{words} has changed since the seal ({before[:12]}, now {now[:12]})"
        for words, before, now in hashed
        if before != now
    ]


def write_freeze(path: Path, frozen: Freeze) -> Freeze:
    """Write a freeze with its own seal; the content written."""
    content: Freeze = {**frozen, "seal": digest(dict(frozen))}
    write_json(path, content)
    return content


def read_freeze(path: Path) -> Freeze:
    """A freeze whose seal holds.

    Raises
    ------
    SelfCheckError
        if its content does not match its seal.
    """
    content: Freeze = read_json(path)
    if content.get("seal") != digest({k: v for k, v in content.items() if k != "seal"}):
        raise SelfCheckError(f"{path}: broken seal: the freeze was changed after it was written; start a new run")
    return content


def write_verdict(path: Path, name: str, verdict: Verdict, freeze_seal: str) -> SealedVerdict:
    """Write one verdict, bound to the freeze and to the code that gave it, with its seal; the content written."""
    content: dict[str, object] = {
        "schema": VERDICT_SCHEMA,
        "campaign": name,
        "freeze": freeze_seal,
        "code_sha256": code_sha256(*JUDGES),
        "verdict": dict(verdict),
    }
    content["seal"] = digest(content)
    write_json(path, content)
    return cast("SealedVerdict", content)


def read_verdict(path: Path, name: str, freeze_seal: str) -> SealedVerdict:
    """A sealed verdict that is whole and belongs to this run.

    Raises
    ------
    SelfCheckError
        if its content does not match its seal, or it belongs to another campaign or freeze.
    """
    try:
        content: SealedVerdict = read_json(path)
    except InputError as error:
        raise SelfCheckError(f"broken seal: {error}") from None
    if content.get("seal") != digest({k: v for k, v in content.items() if k != "seal"}):
        raise SelfCheckError(f"{path}: broken seal: the verdict was changed after it was sealed; start a new run")
    if content["campaign"] != name or content["freeze"] != freeze_seal:
        raise SelfCheckError(f"{path}: this verdict belongs to another campaign or run; start a new run")
    return content


def chain(freeze_seal: str, seals: Mapping[str, str]) -> list[str]:
    """Links of the chain over all seals, in alphabetical order of the campaigns' names; the last one is its head."""
    links = []
    link = freeze_seal
    for name in sorted(seals):
        link = hashlib.sha256(f"{link}|{name}|{seals[name]}".encode()).hexdigest()
        links.append(link)
    return links


def chained(frozen: Freeze, home: Path) -> tuple[dict[str, SealedVerdict], list[str]]:
    """The sealed verdicts of a run by name, each held against its seal, and the links of the chain over them.

    Raises
    ------
    SelfCheckError
        as `read_verdict`.
    """
    sealed = {name: read_verdict(verdict_path(home, name), name, frozen["seal"]) for name in frozen["campaigns"]}
    return sealed, chain(frozen["seal"], {name: content["seal"] for name, content in sealed.items()})


@dataclass(frozen=True)
class Opened:
    """A key that was opened: name -> entry, with the verdicts, the chain's head, and reasons for a rehearsal."""

    entries: Mapping[str, KeyEntry]
    verdicts: Mapping[str, Verdict]
    head: str
    rehearsal: Sequence[str]


def verdict_path(run: Path, name: str) -> Path:
    """Where the verdict of a campaign lies in a run's folder."""
    return run / "verdicts" / name / "verdict.json"


def open_key(run: Path, key: Path, campaigns: Mapping[str, Path], now: Freeze) -> Opened:
    """The key, read only when every verdict of the run is sealed and every checksum of its freeze still holds.

    now : a freeze of this moment, to see whether code or library have changed since.

    Raises
    ------
    SelfCheckError
        if a verdict is missing, a seal is broken, or campaigns or key are not those that were frozen.
    """
    frozen = read_freeze(run / "freeze.json")
    missing = [name for name in frozen["campaigns"] if not verdict_path(run, name).is_file()]
    if missing:
        raise SelfCheckError(
            f"the key stays closed: {len(missing)} of {len(frozen['campaigns'])} verdicts are not sealed yet "
            f"({', '.join(missing[:3])}{', ...' if len(missing) > 3 else ''}); run the same command again"
        )
    for name, path in campaigns.items():
        if frozen["campaigns"].get(name) != folder_sha256(path):
            raise SelfCheckError(f"{path}: broken seal: the campaign is not what it was when the run was frozen")
    if file_sha256(key) != frozen["key_sha256"]:
        raise SelfCheckError(f"{key}: broken seal: the key is not the one that was there when the run was frozen")
    sealed, links = chained(frozen, run)
    path = run / "chain.json"
    if path.exists() and read_json(path)["links"] != links:
        raise SelfCheckError(f"{path}: broken seal: verdicts were replaced after they were chained")
    seals = {name: content["seal"] for name, content in sealed.items()}
    write_json(path, {"schema": "bayes-damper/withheld-chain/1", "seals": seals, "links": links})
    reasons = differences(frozen, now)
    others = sorted({content["code_sha256"] for content in sealed.values()} - {frozen["code_sha256"]})
    reasons += [f"verdicts were given by other code than was frozen ({code[:12]})" for code in others]
    return Opened(
        read_key(key, frozen["campaigns"]),
        {name: content["verdict"] for name, content in sealed.items()},
        links[-1],
        tuple(reasons),
    )


def read_key(key: Path, names: Iterable[str]) -> dict[str, KeyEntry]:
    """Entries of a key for these campaigns.

    Raises
    ------
    InputError
        if the file is no key, or has no entry for one of them.
    """
    content = read_json(key)
    if not isinstance(content, dict) or content.get("schema") != KEY_SCHEMA:
        raise InputError(f"{key}: this is no key of withheld campaigns (schema {KEY_SCHEMA})")
    absent = [name for name in names if name not in content["campaigns"]]
    if absent:
        raise InputError(f"{key}: has no entry for the campaigns {', '.join(absent)}; give the key they were made with")
    return {name: content["campaigns"][name] for name in names}
