"""Several runs of the check scored as one.

    python -m validation.proofs.together OUT RUN KEY [RUN KEY ...]

RUN: the folder of a finished `bayes-damper withheld` run; KEY: the key of its campaigns. A large proof is made in parts
this way, each sealed and opened on its own. All must be proofs by the same code: a rehearsal among them, or verdicts
of two versions, are refused. OUT/withheld.json, .txt, .svg and .png are written as for one run.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bayes_damper import figures
from bayes_damper.effects import all_effects, classes
from bayes_damper.errors import InputError
from bayes_damper.runs.contents.withheld import KeyEntry, Verdict, WithheldFile
from bayes_damper.runs.json_files import read_json, write_json, write_text
from bayes_damper.runs.provenance import provenance
from bayes_damper.validation.withheld import scores
from bayes_damper.validation.withheld.check import (
    SCHEMA,
    baseline_scores,
    left_out_scores,
    skipped_baselines,
    table_text,
)
from bayes_damper.validation.withheld.sealing import read_freeze, read_verdict


def together(runs: Sequence[tuple[Path, Path]], seed: int = 1) -> WithheldFile:
    """The content of withheld.json for all runs as one; `runs`: folder and key of each.

    Raises
    ------
    InputError
        if a run is not finished, is a rehearsal, was made by other code, or shares a campaign with another one.
    SelfCheckError
        if the seal of a verdict is broken.
    """
    groups = classes(all_effects())
    rows: list[scores.Scored] = []
    removed: list[scores.Scored] = []
    verdicts: dict[str, Verdict] = {}
    entries: dict[str, KeyEntry] = {}
    parts, codes = [], set()
    for home, key in runs:
        if not (home / "withheld.json").exists():
            raise InputError(f"{home}: is no finished run; give the command `bayes-damper withheld` again until it is")
        result = read_json(home / "withheld.json")
        if result["rehearsal"]:
            raise InputError(f"{home}: is a rehearsal ({'; '.join(result['why_rehearsal'])}), not part of a proof")
        known = read_json(key)["campaigns"]
        for folder, left_out in ((home, False), (home / "leave_one_out", True)):
            if not (folder / "freeze.json").exists():
                continue
            frozen = read_freeze(folder / "freeze.json")
            codes.add(frozen["code_sha256"])
            for name in frozen["campaigns"]:
                sealed = read_verdict(folder / "verdicts" / name / "verdict.json", name, frozen["seal"])["verdict"]
                if left_out:
                    removed.append(scores.score_one(name, sealed, known[name], groups, left_out=True))
                    continue
                if name in verdicts:
                    raise InputError(f"{home}: campaign {name} is in another run too; give each run once")
                verdicts[name], entries[name] = sealed, known[name]
                rows.append(scores.score_one(name, sealed, known[name], groups))
        parts.append({n: result[n] for n in ("chain_head", "freeze", "seed")} | {"folder": Path(result["folder"]).name})
    if len(codes) > 1:
        raise InputError("the runs were made by different versions of the code; score each version by itself")
    scored = scores.all_scores(rows, seed)
    scored["targets"] = [target.judge([*rows, *removed]) for target in scores.TARGETS]
    return {
        "schema": SCHEMA, "rehearsal": False, "why_rehearsal": [], "parts": parts,
        "chain_head": " ".join(part["chain_head"][:16] for part in parts),
        "campaigns": {
            row.name: {
                "verdict": row.verdict, "credible_set": verdicts[row.name]["credible_set"],
                "pair": verdicts[row.name].get("pair"), "seconds": verdicts[row.name].get("seconds"),
                "probability": row.confidence, "score": row.to_json(),
            }
            for row in rows
        },
        "scores": scored, "leave_one_out": left_out_scores(removed),
        "baselines": baseline_scores(rows, verdicts, entries, groups, seed), "baselines_skipped": skipped_baselines(),
        "provenance": provenance(),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    given = [Path(x) for x in (sys.argv[1:] if arguments is None else arguments)]
    if len(given) < 3 or len(given) % 2 == 0:
        sys.stdout.write("give OUT, then RUN KEY, once or more often\n")
        return 2
    out = given[0]
    results = together(list(zip(given[1::2], given[2::2], strict=True)))
    write_json(out / "withheld.json", results)
    text = table_text(results)
    write_text(out / "withheld.txt", text + "\n")
    figures.save(figures.withheld_figure(results["scores"], rehearsal=False), out / "withheld")
    sys.stdout.write(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
