"""The constants of the diagnosis's rule, fitted to sealed verdicts whose key is open.

    python -m validation.proofs.constants RUN KEY [RUN KEY ...]

RUN: the folder of a `bayes-damper withheld` run (verdicts, and leave_one_out where it is there); KEY: the key of its
campaigns. Every verdict holds what the rule made its probabilities from (`weighed` in diagnosis.json), so that other
constants need no new fits: the verdict is weighed again. Campaigns whose verdicts were used here must not be scored as
a proof any more: a proof needs campaigns of other seeds.

What is minimised is the mean log score, the four kinds of truth (nothing, one effect, another cause, two effects)
counted as the rule's own prior probabilities have them, whatever their numbers in the runs are, plus a weak prior: each
constant's logarithm about its present value. The score of constants fitted to one half and tried on the other shows
what the fit is worth.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bayes_damper.diagnosis.verdict import (
    PRIOR_NONE,
    PRIOR_PAIRS,
    PRIOR_UNKNOWN,
    RULE,
    Answers,
    Left,
    Rule,
    borne_by_sets,
    weigh,
)
from bayes_damper.effects import EFFECTS, classes
from bayes_damper.errors import InputError
from bayes_damper.runs.contents.diagnosis import LeftEntry
from bayes_damper.runs.contents.withheld import KeyEntry, Verdict
from bayes_damper.runs.json_files import read_json
from bayes_damper.text import Printable
from bayes_damper.validation.withheld.scores import LEAST_PROBABILITY, Scored, score_one

Array = NDArray[np.float64]

FITTED = (
    "strength", "share_home", "share_away", "tempering", "mismatch", "unseen", "imitated", "least", "few_readings",
)  # fmt: skip
WIDTH = 0.7  # prior sd of a constant's logarithm about its present value
SHARES = {
    "none": PRIOR_NONE, "library": 1.0 - PRIOR_NONE - PRIOR_UNKNOWN - PRIOR_PAIRS, "foreign": PRIOR_UNKNOWN,
    "pair": PRIOR_PAIRS,
}  # fmt: skip


@dataclass(frozen=True)
class Known:
    """A verdict (fields of diagnosis.json) with its entry of the key; left_out: its effect was not in the library."""

    name: str
    verdict: Verdict
    entry: KeyEntry
    left_out: bool = False

    @property
    def group(self) -> str:
        """What the rule's prior probabilities are for: none, library, foreign or pair."""
        truth = str(self.entry["truth"])
        if truth in ("none", "pair"):
            return truth
        return "foreign" if self.left_out or self.entry["standing"] != "library" else "library"


def replay(verdict: Verdict, rule: Rule = RULE) -> Answers:
    """The probabilities of a verdict made again, with these constants.

    Raises
    ------
    InputError
        if the verdict does not hold what the rule weighed.
    """
    weighed = verdict.get("weighed")
    if not weighed or not verdict.get("effects"):
        raise InputError("a verdict does not hold what was `weighed`: it was given by an older version; diagnose again")
    evidence = {str(row["name"]): _number(row["log_evidence"], -math.inf) for row in verdict["effects"]}
    pairs = [
        ((str(p["effects"][0]), str(p["effects"][1])), float(p["log_evidence"]), _left(p["left"]))
        for p in weighed["pairs"]
    ]
    drift = _number(weighed["drift"], -math.inf)
    left = _left(weighed["before"]), _left(weighed["after"])
    usual, late = float(weighed.get("usual", 0.0)), _number(weighed.get("late"), -math.inf)
    definitions = weighed.get("definitions", ())
    answers = weigh(evidence, *left, float(weighed["excess"]), rule, pairs, drift, definitions, usual, late)
    return borne_by_sets(answers, weighed.get("support", {}))


def _number(x: Any, missing: float) -> float:
    return missing if x is None else float(x)


def _left(entry: LeftEntry) -> Left:
    numbers: dict[str, Any] = {name: value for name, value in entry.items() if value is not None}
    return Left(
        **{**numbers, "nats": _number(entry["nats"], 1e6), "readings": _number(entry.get("readings"), math.inf)}
    )


def read_run(run: Path, key: Path) -> list[Known]:
    """All verdicts of a run with their entries of the key; those that failed are left out.

    Raises
    ------
    InputError
        if there are no verdicts, or the key does not know one of them.
    """
    entries = read_json(key)["campaigns"]
    out = []
    for folder, left_out in ((run / "verdicts", False), (run / "leave_one_out" / "verdicts", True)):
        for path in sorted(folder.glob("*/verdict.json")):
            name = path.parent.name
            if name not in entries:
                raise InputError(f"{path}: {key} has no entry for it; give each run its own key")
            verdict = json.loads(path.read_text(encoding="utf-8"))["verdict"]
            if verdict.get("effects"):
                out.append(Known(name, verdict, entries[name], left_out))
    if not out:
        raise InputError(f"{run}: holds no verdicts; give the folder that `bayes-damper withheld --out` wrote")
    return out


def scored(known: Known, rule: Rule, groups: Sequence[frozenset[str]]) -> Scored:
    """The score of a verdict under these constants."""
    answers = replay(known.verdict, rule)
    again: Verdict = {
        **known.verdict, "verdict": answers.verdict, "probabilities": answers.probabilities,
        "credible_set": answers.credible_set(),
    }  # fmt: skip
    return score_one(known.name, again, known.entry, groups, known.left_out)


def mean_log_score(rows: Sequence[Known], rule: Rule) -> float:
    """Mean of -ln p(truth), each kind of truth counted as the rule's prior has it."""
    groups = classes(EFFECTS)
    total, weight = 0.0, 0.0
    for group, share in SHARES.items():
        own = [-math.log(max(scored(k, rule, groups).p_right, LEAST_PROBABILITY)) for k in rows if k.group == group]
        if own:
            total += share * float(np.mean(own))
            weight += share
    return total / weight if weight > 0.0 else math.nan


def with_logs(logs: Array) -> Rule:
    """The rule with its constants multiplied by exp(logs)."""
    return replace(RULE, **{n: getattr(RULE, n) * math.exp(x) for n, x in zip(FITTED, logs, strict=True)})


def fit_rule(rows: Sequence[Known], most: int = 400) -> Rule:
    """The constants with the best mean log score on these verdicts, held near the present ones by a weak prior."""

    def cost(logs: Array) -> float:
        return mean_log_score(rows, with_logs(logs)) + 0.5 * float(np.sum((logs / WIDTH) ** 2)) / max(len(rows), 1)

    start = np.zeros(len(FITTED))
    simplex = np.vstack([start, start + 0.4 * np.eye(len(FITTED))])
    found = minimize(
        cost, start, method="Nelder-Mead",
        options={"maxfev": most, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4},
    )  # fmt: skip
    return with_logs(np.asarray(found.x, float))


@dataclass(frozen=True)
class Fitted(Printable):
    """Constants fitted to verdicts; scores: mean log score of the present constants, of the fitted ones on the same
    verdicts, and of constants fitted to one half on the other half (both ways, mean), beside the present ones' there.
    """

    rule: Rule
    count: int
    present: float
    own: float
    crossed: float

    def text(self) -> str:
        """A table for people."""
        lines = [f"{self.count} verdicts", f"{'constant':16s}{'present':>10s}{'fitted':>10s}"]
        lines += [f"{n:16s}{getattr(RULE, n):10.3g}{getattr(self.rule, n):10.3g}" for n in FITTED]
        lines.append(
            f"mean log score, nats: present {self.present:.3f}, fitted {self.own:.3f}, "
            f"fitted to one half and tried on the other {self.crossed:.3f}"
        )
        return "\n".join(lines)


def fit_constants(rows: Sequence[Known], most: int = 400) -> Fitted:
    """Constants fitted to all the verdicts, with what a fit to one half is worth on the other."""
    halves = [rows[::2], rows[1::2]]
    crossed = float(np.mean([mean_log_score(halves[1 - i], fit_rule(halves[i], most)) for i in (0, 1)]))
    rule = fit_rule(rows, most)
    return Fitted(rule, len(rows), mean_log_score(rows, RULE), mean_log_score(rows, rule), crossed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or len(given) % 2:
        sys.stdout.write(
            "give RUN KEY, once or more often: folders of `bayes-damper withheld` and the keys of their campaigns\n"
        )
        return 2
    rows = [known for run, key in zip(given[::2], given[1::2], strict=True) for known in read_run(Path(run), Path(key))]
    sys.stdout.write(fit_constants(rows).text() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
