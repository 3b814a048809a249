"""One file that holds a finished run: what was frozen, every sealed verdict, the key with its salt, the scores.

Kept beside a proof's page, it lets anybody hold the seals later, with one command:

    bayes-damper withheld --verify ARCHIVE.zip [CAMPAIGNS]

The members are text: freeze.json, verdicts.jsonl (a verdict a line, by name), chain.json, key.json (byte for byte),
withheld.json; those of a second run without the effects lie below leave_one_out/.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayes_damper.effects import all_effects, classes
from bayes_damper.errors import ExitCode, InputError, SelfCheckError
from bayes_damper.runs.contents.withheld import Freeze, Verdict, VerifiedFile
from bayes_damper.runs.json_files import read_json
from bayes_damper.text import Printable, counted
from bayes_damper.validation.withheld import scores
from bayes_damper.validation.withheld.sealing import (
    chained,
    file_sha256,
    folder_sha256,
    read_freeze,
    read_key,
    verdict_path,
)

NAME = "sealed.zip"
PARTS = ("", "leave_one_out/")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # so that the same run gives the same bytes


def write_archive(run: Path, key: Path, path: Path) -> Path:
    """The archive of the finished run in the folder `run`, whose key is the file `key`; the path written."""
    results = read_json(run / "withheld.json")
    results["folder"] = Path(results["folder"]).name  # where it lay on this machine concerns nobody
    results["provenance"].pop("command", None)
    members = {"key.json": key.read_bytes(), "withheld.json": json.dumps(results, indent=1).encode()}
    for part in PARTS:
        home = run / part
        if not (home / "freeze.json").exists():
            continue
        names = read_freeze(home / "freeze.json")["campaigns"]
        lines = [json.dumps(read_json(verdict_path(home, name)), separators=(",", ":")) for name in sorted(names)]
        members[f"{part}verdicts.jsonl"] = ("\n".join(lines) + "\n").encode()
        for name in ("freeze.json", "chain.json"):
            members[part + name] = (home / name).read_bytes()
    draft = path.with_suffix(".tmp")
    with zipfile.ZipFile(draft, "w", zipfile.ZIP_LZMA) as out:
        for name in sorted(members):
            out.writestr(zipfile.ZipInfo(name, _EPOCH), members[name], zipfile.ZIP_LZMA)
    draft.replace(path)
    return path


@dataclass(frozen=True)
class Verified(Printable):
    """What holding an archive's seals found: sentences, and the facts for programs."""

    results: VerifiedFile
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> VerifiedFile:
        """For programs."""
        return self.results

    def text(self) -> str:
        """For people."""
        return "\n".join(self.results["found"])


def verify(archive: str | Path, folder: str | Path | None = None) -> Verified:
    """Hold every seal of an archive again; `folder`: its campaigns, whose data are then held too.

    Raises
    ------
    InputError
        if the file is no archive of a run, or `folder` lacks a campaign.
    SelfCheckError
        if a seal is broken: freeze, verdict, chain, key or data are not what was sealed.
    """
    path = Path(archive)
    with tempfile.TemporaryDirectory() as scratch:
        home = Path(scratch)
        _unpack(path, home)
        frozen, verdicts, head = _hold(home, path)
        code = f"{frozen['code_sha256'][:12]} (commit {str(frozen['commit'])[:12]})"
        when = f"sealed on {frozen['written'][:10]} by the code {code}, seed {frozen['seed']}, chain {head[:16]}"
        found = [f"{path}: whole; {counted(len(verdicts), 'verdict')} {when}"]
        if (home / "leave_one_out" / "freeze.json").exists():
            _, removed, _ = _hold(home / "leave_one_out", path)
            found.append(f"{counted(len(removed), 'verdict')} without the true effect: whole")
        found.append(_against_the_key(home, frozen, verdicts))
    if folder is None:
        found.append("the campaigns were not held: give their folder too; their key in the archive makes them again")
    else:
        found.append(_against_the_data(Path(folder), frozen))
    return Verified(
        {
            "schema": "bayes-damper/withheld-verified/1", "archive": str(path), "verdicts": len(verdicts),
            "chain_head": head,
            "freeze": {
                "code_sha256": frozen["code_sha256"], "commit": frozen["commit"], "written": frozen["written"],
                "seed": frozen["seed"],
            },
            "data_held": folder is not None, "found": found,
        }
    )  # fmt: skip


def _unpack(path: Path, home: Path) -> None:
    """Writes the members where the run had them."""
    try:
        with zipfile.ZipFile(path) as zipped:
            members = {name: zipped.read(name) for name in zipped.namelist()}
    except (OSError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an archive ({error}); give the {NAME} of a finished run") from None
    missing = {"freeze.json", "chain.json", "verdicts.jsonl", "key.json", "withheld.json"} - set(members)
    if missing:
        raise InputError(f"{path}: is no archive of a run: it lacks {', '.join(sorted(missing))}")
    for part in PARTS:
        for name in ("freeze.json", "chain.json"):
            if part + name in members:
                (home / part).mkdir(exist_ok=True)
                (home / part / name).write_bytes(members[part + name])
        for line in members.get(f"{part}verdicts.jsonl", b"").splitlines():
            try:
                file = verdict_path(home / part, str(json.loads(line)["campaign"]))
            except (ValueError, KeyError, TypeError):
                raise SelfCheckError(f"{path}: broken seal: {part}verdicts.jsonl is no list of verdicts") from None
            if not file.resolve().is_relative_to(home.resolve()):
                raise SelfCheckError(f"{path}: broken seal: {part}verdicts.jsonl names a file outside the run")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(line)
    for name in ("key.json", "withheld.json"):
        (home / name).write_bytes(members[name])


def _hold(home: Path, path: Path) -> tuple[Freeze, dict[str, Verdict], str]:
    """Freeze, verdicts by name and head of the chain of one part, each against its seal."""
    frozen = read_freeze(home / "freeze.json")
    missing = [name for name in frozen["campaigns"] if not verdict_path(home, name).exists()]
    if missing:
        raise SelfCheckError(f"{path}: broken seal: the verdicts of {', '.join(missing[:3])} are missing")
    sealed, links = chained(frozen, home)
    if read_json(home / "chain.json")["links"] != links:
        raise SelfCheckError(f"{path}: broken seal: verdicts were replaced after they were chained")
    return frozen, {name: content["verdict"] for name, content in sealed.items()}, links[-1]


def _against_the_key(home: Path, frozen: Freeze, verdicts: Mapping[str, Verdict]) -> str:
    """That the key is the frozen one and the chain the published one; how many verdicts are right by it."""
    key, results = home / "key.json", read_json(home / "withheld.json")
    if file_sha256(key) != frozen["key_sha256"]:
        raise SelfCheckError("broken seal: the key in the archive is not the one that was frozen")
    links = read_json(home / "chain.json")["links"]
    if results["chain_head"] != links[-1] or set(results["campaigns"]) != set(verdicts):
        raise SelfCheckError("broken seal: withheld.json in the archive holds other verdicts")
    entries = read_key(key, verdicts)
    groups = classes(all_effects())
    right = {n: scores.score_one(n, verdicts[n], entries[n], groups).is_right for n in verdicts}
    other = [n for n in right if right[n] != results["campaigns"][n]["score"]["right"]]
    said = f"the key is the frozen one; by it {sum(right.values())} of {len(right)} verdicts are right"
    if other:
        said += f", {len(other)} of them counted otherwise when the run was scored ({', '.join(other[:3])})"
    return said


def _against_the_data(folder: Path, frozen: Freeze) -> str:
    """That the campaigns are those that were frozen."""
    absent = [name for name in frozen["campaigns"] if not (folder / name / "campaign.toml").is_file()]
    if absent:
        raise InputError(f"{folder}: lacks the campaigns {', '.join(absent[:3])}; give the folder that holds all")
    changed = [name for name, seal in frozen["campaigns"].items() if folder_sha256(folder / name) != seal]
    if changed:
        raise SelfCheckError(
            f"{folder}: broken seal: {', '.join(changed[:3])} of {counted(len(frozen['campaigns']), 'campaign')} "
            "are not the data that were judged"
        )
    return f"{folder}: the data are those that were judged"
