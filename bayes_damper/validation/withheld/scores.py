"""Scores of verdicts whose truth is known: rates with 95 % intervals, matrices, reliability, targets, misses.

Everything here is a function of verdicts (as in diagnosis.json) and entries of a key; nothing is read or written.

Right answers of a campaign:

- an effect of the library: the effect or one of its class; on the hard kind and in laboratories, where the declared
  constants (and what scatters) explain it (`visible_chi2` below 10, 5 nats), `none` too;
- nothing wrong: `none`;
- a foreign effect: `unknown`; where it is not visible (`visible_chi2` of 30 or less), `none` too;
- a pair: both named; either of them as the verdict counts as half and is reported apart. Of three effects, two.

A target is met when the estimate reaches it, and shown when its 95 % interval lies beyond it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from bayes_damper.diagnosis.verdict import credible_set
from bayes_damper.runs.contents.diagnosis import GapEntry, WhereRecords
from bayes_damper.runs.contents.withheld import (
    Bin,
    ClassEntry,
    Judged,
    KeyEntry,
    Laboratory,
    LevelRow,
    Rate,
    Reliability,
    ScoreEntry,
    ScoresEntry,
    SummaryEntry,
    Verdict,
)

Array = NDArray[np.float64]

IDENTIFIABLE_CHI2 = 10.0
FOREIGN_VISIBLE_CHI2 = 30.0
LEAST_PROBABILITY = 1e-6  # below which the log score is not followed
CONFIDENT, LIKELY = 0.9, 0.5
HIDDEN_KINDS = ("hard", "laboratory")
PARAMETERS = ("mu", "k2t", "c2t", "drag", "c1t")
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)
BOOTSTRAPS = 2000
TWINS = 4000
FAILED = "failed"


@dataclass(frozen=True)
class Scored:
    """One verdict beside its truth.

    laboratory : what the key says of the laboratory's class; gap_p : of the test for a gap; bands : shares of held-out
    readings within the 50 and 90 % bands of their forecast; scatter_covered : whether the 90 % interval of each
    scatter holds the true one.
    right : answers that count as right; p_right : their probability; confidence : probability of the verdict's class;
    brier : sum over answers (a class as one) of (p - 1 if right else p)^2; single : only one answer (a class as one) is
    right, so that it enters names' rates; sites : the true site or sites.
    """

    name: str
    kind: str
    level: float
    truth: str
    standing: str
    verdict: str
    right: frozenset[str]
    is_right: bool
    in_set: bool
    set_size: int
    p_right: float
    confidence: float
    brier: float
    single: bool
    sites: tuple[str, ...]
    site: str
    site_right: bool
    site_in_set: bool
    false_and_confident: bool
    closed: float | None
    closed_left_out: float | None
    seconds: float | None
    visible: float
    both_named: bool
    either_named: bool
    covered: Mapping[str, bool]
    event_error_s: float | None
    rms: tuple[float, float, float] | None
    failed: bool
    false_and_likely: bool
    laboratory: Laboratory
    gap_p: float | None
    bands: tuple[float, float] | None
    scatter_covered: Mapping[str, bool]

    @property
    def group(self) -> str:
        """library, none, foreign or pair."""
        if self.truth in ("none", "pair"):
            return self.truth
        return "library" if self.standing == "library" else "foreign"

    def to_json(self) -> ScoreEntry:
        """What withheld.json gives of the campaign beside the sealed verdict."""
        return {
            "kind": self.kind, "truth": self.truth, "standing": self.standing, "level": self.level,
            "true_sites": list(self.sites), "visible_chi2": self.visible, "accepted": sorted(self.right),
            "right": self.is_right, "truth_in_credible_set": self.in_set, "probability_of_truth": self.p_right,
            "brier": self.brier, "site_right": self.site_right,
        }  # fmt: skip


def merged(probabilities: Mapping[str, float], groups: Iterable[frozenset[str]]) -> dict[str, float]:
    """Probabilities with each class as one answer, named by its members joined with " / "."""
    name_of = {member: " / ".join(sorted(group)) for group in groups for member in group}
    out: dict[str, float] = {}
    for name, p in probabilities.items():
        label = name_of.get(name, name)
        out[label] = out.get(label, 0.0) + float(p)
    return out


def right_answers(entry: KeyEntry, groups: Sequence[frozenset[str]], left_out: bool = False) -> frozenset[str]:
    """Answers that are right for an entry of the key; `left_out`: the truth was taken out of the library."""
    truth, visible = entry["truth"], float(entry["visible_chi2"])
    if truth == "none":
        return frozenset({"none"})
    if truth == "pair":
        return frozenset(n for effect in entry["effects"] for n in class_of(effect, groups))
    if entry["standing"] != "library" or left_out:
        return frozenset({"unknown"}) | (frozenset({"none"}) if visible <= FOREIGN_VISIBLE_CHI2 else frozenset())
    hidden = entry["kind"] in HIDDEN_KINDS and visible < IDENTIFIABLE_CHI2
    return class_of(truth, groups) | set(entry.get("class") or ()) | ({"none"} if hidden else set())


def class_of(effect: str, groups: Iterable[frozenset[str]]) -> frozenset[str]:
    """The class of an effect, or the effect alone."""
    return next((group for group in groups if effect in group), frozenset({effect}))


def score_one(
    name: str,
    verdict: Verdict,
    entry: KeyEntry,
    groups: Sequence[frozenset[str]],
    left_out: bool = False,
) -> Scored:
    """One verdict (fields of diagnosis.json) against its entry of the key.

    A diagnosis that failed has the verdict "failed", is wrong everywhere, and gives its truth no probability.
    """
    probabilities = {str(n): float(p) for n, p in verdict.get("probabilities", {}).items()}
    right = right_answers(entry, groups, left_out)
    said = str(verdict["verdict"])
    found = merged(probabilities, groups)
    name_of = {member: " / ".join(sorted(group)) for group in groups for member in group}
    labels = {name_of.get(n, n) for n in right}
    p_right = min(sum(found.get(n, 0.0) for n in labels), 1.0)
    truth_sites = entry["site"] if isinstance(entry["site"], list) else [entry["site"]]
    sites = {str(n): float(p) for n, p in verdict.get("sites", {}).items()}
    site = max(sites, key=lambda n: sites[n]) if sites else FAILED
    accepted_sites = set(truth_sites) | ({"none"} if "none" in right else set())
    named = _named(verdict)
    both = [bool(class_of(e, groups) & named) for e in entry["effects"]]
    is_right = said in right
    effects_said = said not in ("none", "unknown", FAILED)
    confidence = found.get(name_of.get(said, said), 0.0)
    gap = verdict.get("gap")
    library = entry["truth"] not in ("none", "pair") and entry["standing"] == "library"
    sound = "laboratory" in entry and entry["truth"] == "none"
    return Scored(
        name=name,
        kind=entry["kind"],
        level=float(entry["level_wanted"]),
        truth=entry["truth"],
        standing="removed" if left_out else str(entry.get("standing")),
        verdict=said,
        right=frozenset(right),
        is_right=is_right,
        in_set=bool(right & set(verdict.get("credible_set") or credible_set(probabilities))) and bool(probabilities),
        set_size=len(merged(dict.fromkeys(verdict.get("credible_set") or [], 0.0), groups)),
        p_right=p_right,
        confidence=confidence,
        brier=(1.0 - p_right) ** 2 + sum(p**2 for n, p in found.items() if n not in labels),
        single=len(labels) == 1,
        sites=tuple(truth_sites),
        site=site,
        site_right=site in accepted_sites,
        site_in_set=bool(accepted_sites & set(credible_set(sites))),
        false_and_confident=effects_said and not is_right and confidence > CONFIDENT,
        closed=_number(gap.get("closed") if gap else None, "median"),
        closed_left_out=_number(verdict.get("left_out_case"), "closed"),
        seconds=_float(verdict.get("seconds")),
        visible=float(entry["visible_chi2"]),
        both_named=sum(both) >= 2,
        either_named=any(both),
        covered=_covered(verdict, entry) if is_right and (sound or (library and said != "none")) else {},
        event_error_s=_event_error(verdict, entry),
        rms=_rms(gap),
        failed=said == FAILED,
        false_and_likely=effects_said and not is_right and confidence > LIKELY,
        laboratory=entry.get("laboratory") or {},
        gap_p=_float(gap.get("p_value")) if gap else None,
        bands=_bands(verdict),
        scatter_covered=_scatter_covered(verdict, entry),
    )


def _rms(gap: GapEntry | None) -> tuple[float, float, float] | None:
    """Residuals of the nominal model and with the answer, and the noise; None where one of them is not known."""
    found = () if gap is None else (gap.get("nominal_rms"), gap.get("augmented_rms"), gap.get("noise_rms"))
    known = tuple(float(x) for x in found if x is not None)
    return (known[0], known[1], known[2]) if len(known) == 3 else None


def _named(verdict: Verdict) -> set[str]:
    pair = verdict.get("pair")
    return {str(verdict["verdict"]), *(str(n) for n in (pair["effects"] if pair else ()))}


def _float(x: Any) -> float | None:
    return float(x) if isinstance(x, int | float) and math.isfinite(x) else None


def _number(row: Any, name: str) -> float | None:
    return _float(row.get(name)) if isinstance(row, Mapping) else _float(row)


def _covered(verdict: Verdict, entry: KeyEntry) -> dict[str, bool]:
    """Whether the 90 % interval of each nominal parameter, under the winner, holds the true value.

    Where an effect adds, near rest, a term of the form of a nominal law, the true value is that of both together.
    """
    out = {}
    truth = entry.get("at_rest") or entry["nominal"]
    for name in PARAMETERS:
        interval = (verdict.get("intervals90") or {}).get(name)
        if interval is not None and name in truth:
            out[name] = interval[0] <= float(truth[name]) <= interval[1]
    return out


def _scatter_covered(verdict: Verdict, entry: KeyEntry) -> dict[str, bool]:
    """Whether the 90 % interval of each scatter that is reported holds the true one; relative ones only."""
    true = entry.get("scatter") or {}
    out = {}
    for name, row in (verdict.get("scatter") or {}).items():
        if name in true and row.get("unit") == "relative" and (interval := row.get("hdi90")):
            out[name] = interval[0] <= float(true[name]) <= interval[1]
    return out


def _bands(verdict: Verdict) -> tuple[float, float] | None:
    """Shares of held-out readings within the bands over all answers, with the leading one, or of the nominal rig."""
    bands = verdict.get("forecast")
    row = (bands.get("averaged") or bands.get("after") or bands.get("before")) if bands else None
    found = (_float(row.get("coverage50")), _float(row.get("coverage90"))) if row else (None, None)
    return None if found[0] is None or found[1] is None else (found[0], found[1])


def _event_error(verdict: Verdict, entry: KeyEntry) -> float | None:
    """Seconds between the middle of a knock and the instant that the diagnosis names; None where there is no knock."""
    if entry["effects"] != ["knock"]:
        return None
    where = cast("WhereRecords | None", verdict.get("where"))
    event = where.get("event") if where else None
    instant = _float(event.get("instant_s")) if event else None
    start, length, _ = entry["disturbances"][0]["shape"]
    return math.inf if instant is None else abs(instant - (start + 0.5 * length))


# Intervals ------------------------------------------------------------------------------------------------------------


def wilson(hits: int, n: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval of a rate; (0, 1) when n = 0."""
    if n == 0:
        return 0.0, 1.0
    p = hits / n
    middle = (p + z * z / (2 * n)) / (1.0 + z * z / n)
    reach = z * math.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n)) / (1.0 + z * z / n)
    return max(0.0, middle - reach), min(1.0, middle + reach)


def rate(values: Iterable[bool]) -> Rate:
    """A rate with its 95 % interval (Wilson)."""
    listed = [bool(v) for v in values]
    hits = sum(listed)
    low, high = wilson(hits, len(listed))
    return {
        "value": hits / len(listed) if listed else None,
        "interval95": [low, high],
        "n": len(listed),
        "hits": hits,
    }


def bootstrap(values: Iterable[float], statistic: Callable[..., Any], seed: int = 0) -> Rate:
    """A statistic, called as f(values, axis=-1), with its 95 % interval over campaigns (percentile bootstrap)."""
    x = np.array(list(values), float)
    if x.size == 0:
        return {"value": None, "interval95": [None, None], "n": 0}
    rng = np.random.default_rng(seed)
    again = statistic(x[rng.integers(x.size, size=(BOOTSTRAPS, x.size))], axis=-1)
    low, high = np.quantile(again, [0.025, 0.975])
    return {"value": float(statistic(x, axis=-1)), "interval95": [float(low), float(high)], "n": int(x.size)}


def _tenth(x: Array, axis: int) -> Array:
    return np.asarray(np.quantile(x, 0.1, axis=axis))


def log_scores(rows: Iterable[Scored]) -> list[float]:
    """-ln of the probability given to the right answers, nats."""
    return [-math.log(max(row.p_right, LEAST_PROBABILITY)) for row in rows]


# Reliability ----------------------------------------------------------------------------------------------------------


def reliability(rows: Sequence[Scored], seed: int = 0) -> Reliability:
    """Confidence against success, beside perfectly calibrated twins of the same size.

    A twin gives the same confidences and is right with exactly these probabilities. `error` is the mean over campaigns
    of |success - confidence| of their bin; `p_value` the share of twins whose error is at least as large.
    """
    rows = [row for row in rows if row.single and row.group != "pair" and not row.failed]
    if not rows:
        return {"n": 0, "bins": [], "error": None, "p_value": None}
    p = np.array([row.confidence for row in rows])
    right = np.array([row.is_right for row in rows], float)
    place = np.clip(np.searchsorted(BINS, p, side="left") - 1, 0, len(BINS) - 2)
    rng = np.random.default_rng(seed)
    twins = (rng.random((TWINS, p.size)) < p).astype(float)
    members = (place[:, None] == np.arange(len(BINS) - 1)).astype(float)  # (campaigns, bins)
    count = members.sum(axis=0)

    def error(hits: Array) -> Array:
        return np.asarray(np.abs((hits - p) @ members).sum(axis=-1) / p.size)

    twin_errors = error(twins)
    bins: list[Bin] = []
    for b in np.flatnonzero(count):
        low, high = np.quantile(twins @ members[:, b] / count[b], [0.025, 0.975])
        inside = members[:, b] > 0
        bins.append(
            {
                "from": BINS[b],
                "to": BINS[b + 1],
                "confidence": float(p[inside].mean()),
                "right": rate(right[inside] > 0.5),
                "twin95": [float(low), float(high)],
            }
        )
    return {
        "n": int(p.size),
        "bins": bins,
        "confidence": float(p.mean()),
        "success": float(right.mean()),
        "error": float(error(right)),
        "twin_error": {"mean": float(twin_errors.mean()), "upper95": float(np.quantile(twin_errors, 0.95))},
        "p_value": float((1 + np.sum(twin_errors >= error(right) - 1e-12)) / (1 + TWINS)),
    }


# Matrices -------------------------------------------------------------------------------------------------------------


def matrix(pairs: Iterable[tuple[str, str]]) -> dict[str, dict[str, int]]:
    """Counts: truth -> verdict -> number of campaigns."""
    out: dict[str, dict[str, int]] = {}
    for truth, said in pairs:
        row = out.setdefault(truth, {})
        row[said] = row.get(said, 0) + 1
    return {truth: dict(sorted(out[truth].items(), key=lambda item: -item[1])) for truth in sorted(out)}


def confusion(rows: Iterable[Scored]) -> dict[str, dict[str, int]]:
    """What was taken for what; pairs are left to their own row of the scores."""
    return matrix((row.truth, row.verdict) for row in rows if row.group != "pair")


def site_matrix(rows: Iterable[Scored]) -> dict[str, dict[str, int]]:
    """Counts: true site -> most probable site -> number of campaigns; pairs left out."""
    return matrix((row.sites[0], row.site) for row in rows if row.group != "pair")


# Summary --------------------------------------------------------------------------------------------------------------


def summarise(rows: Sequence[Scored]) -> SummaryEntry:
    """All scores of a set of campaigns."""
    named = [r for r in rows if r.group in ("library", "none") and r.single]
    library = [r for r in named if r.group == "library"]
    foreign = [r for r in rows if r.group == "foreign" and r.single]
    pairs = [r for r in rows if r.group == "pair"]
    single = [r for r in rows if r.group != "pair"]
    strong = [r.closed for r in library if r.level >= 0.3 and r.closed is not None]
    return {
        "campaigns": len(rows),
        "failed": sum(r.failed for r in rows),
        "hidden": sum(not r.single for r in rows if r.group in ("library", "foreign")),
        "right_first": rate(r.is_right for r in library),
        "accepted_first": rate(r.is_right for r in single),
        "none_kept": rate(r.is_right for r in rows if r.group == "none"),
        "unknown_first": rate(r.is_right for r in foreign),
        "truth_in_credible_set": rate(r.in_set for r in single if r.group != "foreign"),
        "credible_set_size": bootstrap((r.set_size for r in library), np.median),
        "false_and_confident": rate(r.false_and_confident for r in single),
        "false_and_likely": rate(r.false_and_likely for r in single),
        "site": rate(r.site_right for r in library),
        "site_of_unknown": rate(r.site_right for r in foreign),
        "site_of_unknown_in_set": rate(r.site_in_set for r in foreign),
        "pairs_both_named": rate(r.both_named for r in pairs),
        "pairs_one_named": rate(r.either_named for r in pairs),
        "closed_median": bootstrap(strong, np.median),
        "closed_tenth": bootstrap(strong, _tenth),
        "log_score": bootstrap(log_scores(single), np.mean),
        "brier": bootstrap((r.brier for r in single), np.mean),
        "coverage90": rate(hit for r in rows for hit in r.covered.values()),
        "coverage90_by_parameter": {
            name: rate(r.covered[name] for r in rows if name in r.covered) for name in PARAMETERS
        },
        "scatter90": rate(hit for r in rows for hit in r.scatter_covered.values()),
        "gap_test_5": rate(r.gap_p < 0.05 for r in rows if r.group == "none" and r.gap_p is not None),
        "bands50": bootstrap((r.bands[0] for r in rows if r.bands is not None), np.mean),
        "bands90": bootstrap((r.bands[1] for r in rows if r.bands is not None), np.mean),
        "seconds": bootstrap((r.seconds for r in rows if r.seconds is not None), np.median),
    }


CLASSES: dict[str, Callable[[Scored], bool]] = {
    "with repeats": lambda r: bool(r.laboratory.get("repeats")),
    "without repeats": lambda r: r.laboratory.get("repeats") is False,
    "two bodies": lambda r: r.laboratory.get("bodies") == 2,
    "one body": lambda r: r.laboratory.get("bodies") == 1,
    "strong scatter": lambda r: r.laboratory.get("scatter_class") == "strong",
    "weak scatter": lambda r: r.laboratory.get("scatter_class") == "weak",
    "no scatter": lambda r: r.laboratory.get("scatter_class") == "none",
}
"""Classes of laboratories; strong: the geometric mean of all scatters is above the typical one."""


def by_class(rows: Sequence[Scored], seed: int = 0) -> dict[str, ClassEntry]:
    """Scores and calibration of each class of laboratories; empty where no campaign is of one."""
    found = {name: [r for r in rows if chosen(r)] for name, chosen in CLASSES.items()}
    return {name: {**summarise(here), "reliability": reliability(here, seed)} for name, here in found.items() if here}


def by_level(rows: Sequence[Scored]) -> list[LevelRow]:
    """Results against strength, library effects: one row for each kind and level."""
    out: list[LevelRow] = []
    for kind, level in sorted({(r.kind, r.level) for r in rows if r.group == "library"}):
        here = [r for r in rows if r.group == "library" and (r.kind, r.level) == (kind, level)]
        rms = [r.rms for r in here if r.rms is not None]
        out.append(
            {
                "kind": kind,
                "level": level,
                "accepted_first": rate(r.is_right for r in here),
                "right_first": rate(r.is_right for r in here if r.single),
                "site": rate(r.site_right for r in here),
                "closed_median": bootstrap((r.closed for r in here if r.closed is not None), np.median),
                "rms_median": dict(
                    zip(("nominal", "augmented", "noise"), np.median(np.array(rms), axis=0).tolist(), strict=True)
                )
                if rms
                else None,
            }
        )
    return out


@dataclass(frozen=True)
class Target:
    """A figure to be reached: `least` or `most`, or both; `counted`: how many campaigns the figure is meant for."""

    what: str
    where: str
    of: Callable[[Sequence[Scored]], Rate]
    chosen: Callable[[Scored], bool]
    least: float | None = None
    most: float | None = None
    counted: int = 20

    def judge(self, rows: Sequence[Scored]) -> Judged:
        """The figure, its interval, and whether the target is shown, met or missed."""
        found = self.of([row for row in rows if self.chosen(row)])
        judged: Judged = {
            "what": self.what, "where": self.where, "least": self.least, "most": self.most, "value": found["value"],
            "interval95": found["interval95"], "n": found["n"], "enough": found["n"] >= self.counted,
        }  # fmt: skip
        return {**judged, "status": status(judged)}


def status(judged: Judged) -> str:
    """Of a target and what came out: "met" when the estimate reaches it, "shown" when the 95 % interval lies beyond it.

    Else "missed"; "not tested" without a campaign.
    """
    least, most = (-math.inf if judged["least"] is None else judged["least"]), judged["most"]
    most = math.inf if most is None else most
    if judged["value"] is None or judged["n"] == 0:
        return "not tested"
    if not least - 1e-12 <= judged["value"] <= most + 1e-12:
        return "missed"
    low, high = judged["interval95"]
    return "shown" if low is not None and high is not None and low >= least - 1e-12 and high <= most + 1e-12 else "met"


def _rate_of(attribute: str) -> Callable[[Sequence[Scored]], Rate]:
    return lambda rows: rate(getattr(row, attribute) for row in rows)


def _closed(statistic: Callable[..., Any]) -> Callable[[Sequence[Scored]], Rate]:
    return lambda rows: bootstrap((r.closed for r in rows if r.closed is not None), statistic)


def _left_out(rows: Sequence[Scored]) -> Rate:
    return bootstrap((r.closed_left_out for r in rows if r.closed_left_out is not None), np.median)


def _log_score(rows: Sequence[Scored]) -> Rate:
    return bootstrap(log_scores(rows), np.mean)


def _brier(rows: Sequence[Scored]) -> Rate:
    return bootstrap((r.brier for r in rows), np.mean)


def _coverage(rows: Sequence[Scored]) -> Rate:
    return rate(hit for r in rows for hit in r.covered.values())


def _event(within_s: float) -> Callable[[Sequence[Scored]], Rate]:
    return lambda rows: rate(r.event_error_s <= within_s for r in rows if r.event_error_s is not None)


def _seconds(rows: Sequence[Scored]) -> Rate:
    return bootstrap((r.seconds for r in rows if r.seconds is not None), np.median)


def _size_of_test(rows: Sequence[Scored]) -> Rate:
    return rate(r.gap_p < 0.05 for r in rows if r.gap_p is not None)


def _scatters(rows: Sequence[Scored]) -> Rate:
    return rate(hit for r in rows for hit in r.scatter_covered.values())


def _inside(band: int) -> Callable[[Sequence[Scored]], Rate]:
    return lambda rows: bootstrap((r.bands[band] for r in rows if r.bands is not None), np.mean)


def _sayable(rows: Sequence[Scored]) -> Rate:
    return rate(r.is_right or r.in_set or r.verdict == "unknown" for r in rows)


def _of_laboratories() -> list[Target]:
    """Targets over drawn laboratories."""

    def of(*groups: str, level: float | None = None, repeats: bool | None = None) -> Callable[[Scored], bool]:
        return lambda r: (
            r.kind == "laboratory" and r.group in groups and (r.single or r.group == "pair")
            and (level is None or abs(r.level - level) < 1e-9)
            and (repeats is None or bool(r.laboratory.get("repeats")) == repeats)
        )  # fmt: skip

    sound, lab = of("none"), "laboratories"
    first, confident, likely = _rate_of("is_right"), _rate_of("false_and_confident"), _rate_of("false_and_likely")
    each, one = of("none", "library", "foreign"), "laboratories, level 1"
    return [
        Target("none where nothing is missing", f"{lab} with repeats", first, of("none", repeats=True), 0.95, None, 60),
        Target("none where nothing is missing", f"{lab} without repeats", first, of("none", repeats=False), 0.9),
        Target("wrong name with p > 0.9, sound rigs", lab, confident, sound, None, 0.0, 100),
        Target("wrong name with p > 0.9", lab, confident, each, None, 0.02, 200),
        Target("wrong name with p > 0.5", lab, likely, each, None, 0.04, 200),
        Target("right effect first", f"{one}, with repeats", first, of("library", level=1.0, repeats=True), 0.92),
        Target("right effect first", f"{one}, without repeats", first, of("library", level=1.0, repeats=False), 0.75),
        Target("right first, in the set, or unknown", f"{one}, without repeats", _sayable,
               of("library", level=1.0, repeats=False), 1.0),
        Target("effect outside the library: unknown first", one, first, of("foreign", level=1.0), 0.85),
        Target("site, effect in the library", lab, _rate_of("site_right"), of("library"), 0.95),
        Target("site of an unknown: right one first", lab, _rate_of("site_right"), of("foreign"), 0.8),
        Target("90 % intervals of parameters cover", lab, _coverage, of("none", "library"), 0.85, 0.95, 100),
        Target("90 % intervals of scatters cover", lab, _scatters, of("none", "library"), 0.85, 0.95, 100),
        Target("size of the gap's test at 5 %", lab, _size_of_test, sound, 0.03, 0.07, 100),
        Target("50 % bands of forecasts hold", lab, _inside(0), of("none", "library", "foreign", "pair"), 0.4, 0.6),
        Target("90 % bands of forecasts hold", lab, _inside(1), of("none", "library", "foreign", "pair"), 0.85, 0.95),
        Target("seconds a campaign, median", lab, _seconds, lambda r: r.kind == "laboratory", None, 20.0),
    ]  # fmt: skip


def _targets_of(kind: str, levels: tuple[float, float], f: Mapping[str, float]) -> list[Target]:
    """Targets of one kind over a range of levels; `f` holds the figures."""
    low, high = levels
    where = f"{kind}, level {low:g}" if low == high else f"{kind}, level {low:g}-{high:g}"

    def here(row: Scored) -> bool:
        return row.kind == kind and low - 1e-9 <= row.level <= high + 1e-9

    def of(*groups: str) -> Callable[[Scored], bool]:
        return lambda row: here(row) and row.group in groups and row.single

    named, foreign, anything = of("library"), of("foreign"), of("library", "foreign")
    strong = (lambda row: named(row) and row.level >= 0.3) if kind == "easy" else named
    rows = [
        Target("right effect first", where, _rate_of("is_right"), named, least=f["first"]),
        Target("truth in the 90 % credible set", where, _rate_of("in_set"), named, least=f["in_set"]),
        Target(
            "effect outside the library: unknown first", where, _rate_of("is_right"), foreign, f["unknown"], None, 10
        ),
        Target("wrong effect with p > 0.9", where, _rate_of("false_and_confident"), anything, most=f["wrong"]),
        Target("site, effect in the library", where, _rate_of("site_right"), named, least=f["site"]),
        Target("site of an unknown: right one first", where, _rate_of("site_right"), foreign, f["site_unknown"]),
        Target("site of an unknown: in the 90 % set", where, _rate_of("site_in_set"), foreign, f["site_set"]),
        Target("log score, nats", where, _log_score, named, None, f["log"]),
        Target("Brier score", where, _brier, named, None, f["brier"]),
    ]
    if "closed" in f:
        rows += [
            Target("share of gap closed, median", where, _closed(np.median), strong, f["closed"]),
            Target("share of gap closed, 10th percentile", where, _closed(_tenth), strong, f["closed_tenth"]),
        ]
    if "left_out" in f:
        rows.append(Target("gap closed on a left-out case, median", where, _left_out, strong, f["left_out"]))
    return rows


def _of_kind(kind: str, f: Mapping[str, float]) -> list[Target]:
    """Targets of one kind over all levels."""

    def of(group: str) -> Callable[[Scored], bool]:
        return lambda row: row.kind == kind and row.group == group

    def pair(row: Scored) -> bool:
        return of("pair")(row) and (kind == "easy" or row.level in (0.5, 1.0))

    return [
        Target("none where there is none", kind, _rate_of("is_right"), of("none"), f["none"], None, 100),
        Target("two effects at once: both named", kind, _rate_of("both_named"), pair, f["pairs"], None, 40),
        Target("90 % intervals, right effect, cover", kind, _coverage, of("library"), f["cover"], f["cover_most"]),
        Target(f"instant of an event within {f['event']:g} ms", kind, _event(f["event"] * 1e-3), of("foreign"), 0.9),
        Target("seconds a campaign, median", kind, _seconds, lambda row: row.kind == kind, None, 20.0),
    ]


TARGETS: tuple[Target, ...] = (
    *_targets_of("easy", (0.15, 2.0), {
        "first": 0.98, "in_set": 0.96, "unknown": 0.9, "wrong": 0.02, "site": 0.99, "site_unknown": 0.8,
        "site_set": 0.92, "log": 0.12, "brier": 0.04, "closed": 0.97, "closed_tenth": 0.85, "left_out": 0.9,
    }),
    Target("right effect first", "easy, level 0.05", _rate_of("is_right"),
           lambda r: r.kind == "easy" and abs(r.level - 0.05) < 1e-9 and r.group == "library", 0.9),
    *_of_kind("easy", {"none": 0.97, "pairs": 0.85, "cover": 0.85, "cover_most": 0.95, "event": 3.0}),
    *_targets_of("hard", (1.0, 1.0), {
        "first": 0.97, "in_set": 0.95, "unknown": 0.85, "wrong": 0.03, "site": 0.98, "site_unknown": 0.7,
        "site_set": 0.88, "log": 0.25, "brier": 0.08, "closed": 0.9, "closed_tenth": 0.65,
    }),
    *_targets_of("hard", (0.5, 0.5), {
        "first": 0.95, "in_set": 0.95, "unknown": 0.8, "wrong": 0.04, "site": 0.97, "site_unknown": 0.7,
        "site_set": 0.88, "log": 0.25, "brier": 0.08,
    }),
    *_targets_of("hard", (0.15, 0.15), {
        "first": 0.9, "in_set": 0.9, "unknown": 0.7, "wrong": 0.06, "site": 0.93, "site_unknown": 0.7,
        "site_set": 0.88, "log": 0.5, "brier": 0.2,
    }),
    *_of_kind("hard", {"none": 0.97, "pairs": 0.7, "cover": 0.8, "cover_most": 0.96, "event": 5.0}),
    *_of_laboratories(),
)  # fmt: skip


def misses(rows: Iterable[Scored]) -> list[str]:
    """Every verdict that is wrong, one sentence each."""
    out = []
    for r in rows:
        if r.is_right and (r.group != "pair" or r.both_named):
            continue
        at = f"{r.name} ({r.kind}, level {r.level:g})"
        if r.failed:
            out.append(f"{at}: the diagnosis failed; the truth is {r.truth}.")
        elif r.group == "pair":
            out.append(f"{at}: of a pair ({' / '.join(sorted(r.right))}) the verdict {r.verdict} names "
                       f"{'one' if r.either_named else 'none'}.")  # fmt: skip
        else:
            out.append(
                f"{at}: {r.truth} ({', '.join(r.sites)}) taken for {r.verdict} with p = {r.confidence:.2f}; the right "
                f"answer had {r.p_right:.2g}."
            )
    return out


def all_scores(rows: Sequence[Scored], seed: int = 0) -> ScoresEntry:
    """Everything withheld.json gives of a set of verdicts: together, by kind, by level, matrices, targets, misses."""
    kinds = sorted({row.kind for row in rows})
    return {
        "all": summarise(rows),
        "by_kind": {kind: summarise([r for r in rows if r.kind == kind]) for kind in kinds},
        "by_level": by_level(rows),
        "by_class": by_class(rows, seed),
        "confusion": confusion(rows),
        "sites": site_matrix(rows),
        "reliability": {
            "all": reliability(rows, seed),
            **{kind: reliability([r for r in rows if r.kind == kind], seed) for kind in kinds},
        },
        "targets": [target.judge(rows) for target in TARGETS],
        "misses": misses(rows),
    }
