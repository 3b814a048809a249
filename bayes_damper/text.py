"""Numbers and words for people: digits that a number supports, counts, p values, coordinates, sentences said twice."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bayes_damper.runs.contents.diagnosis import BudgetEntry, GapEntry, LawEntry, PairEntry
from bayes_damper.runs.contents.fit import CaseEntry

NOTHING = "\N{EN DASH}"
"""What stands where there is no number."""
SDS_WIDE = 3.29
"""Standard deviations between the ends of a 90 % interval of a normal distribution."""
UNDETERMINED = "these data do not determine it"
"""What is said of a value whose interval is decided by its prior."""
NOTHING_HELD_OUT = "no trial is held out, so no share of the gap is known"
"""What is said of shares of the gap where nothing is held out."""
SMALLEST_P = 1e-12
"""Below this a p value says nothing more: no model of noise holds so far out in its tails."""

_ALIKE = 3  # records or lines of which the same is said, from which on it is said once
_NAMED = 12  # lines that a sentence names one by one

COORDINATES = {
    "th1": (("θ1", "rad"), ("x1", "m")), "th2": (("θ2", "rad"), ("x2", "m")),
    "phi": (("θ1 - θ2", "rad"), ("x1 - x2", "m")), "w1": (("ω1", "rad/s"), ("v1", "m/s")),
    "w2": (("ω2", "rad/s"), ("v2", "m/s")), "slip": (("ω1 - ω2", "rad/s"), ("v1 - v2", "m/s")),
}  # fmt: skip
"""Coordinates of the motion: symbol and unit on a torsional rig, and on a translational one."""


class Printable:
    """What a command gives; `print` shows it as the command line does."""

    def text(self) -> str:
        """For people."""
        raise NotImplementedError

    def __str__(self) -> str:
        return self.text()


def counted(n: int, one: str, many: str = "") -> str:
    """A number with its noun: `1 case`, `3 cases`; `many` where the plural is not made by an s."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def p_value(p: float) -> str:
    """A p value as people write it: `p = 0.03`, and `p below 1e-12` where digits mean nothing."""
    return f"p below {SMALLEST_P:.0e}" if p < SMALLEST_P else f"p = {p:.2g}"


_PLACE = re.compile(r"(.*?)(?:(, line )(\d+))?((?:, column .*|(?<=\d), .*)?)", re.DOTALL)
"""Where something is: a file, the line in it, and the column or field."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])")


def gathered(sentences: Iterable[str]) -> list[str]:
    """Warnings or faults for reading: what is said of three records or lines, alike but for its numbers, is said once.

    sentences : `FILE: sentence`, `FILE, column 'NAME': sentence` or `FILE, line N, ...: sentence`; others stay as they
    are, each in its place.
    """
    alike: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    for whole in sentences:
        place, mark, sentence = whole.partition(": ")
        file, line, number, rest = _PLACE.fullmatch(place).groups("")  # type: ignore[union-attr]
        if mark and ".csv" in file:
            key = (rest, _NUMBER.sub("#", sentence), file if line else "")
            alike.setdefault(key, []).append((number if line else file, place, sentence))
        else:
            alike.setdefault((whole,), []).append(("", "", whole))
    out = []
    for (rest, *of), found in alike.items():
        first, place, sentence = found[0]
        names = list(dict.fromkeys(name for name, _, _ in found))
        if not place:
            out.append(sentence)
        elif len(names) < _ALIKE:
            out += [f"{where}: {said}" for _, where, said in found]
        else:
            same = "" if all(said == sentence for _, _, said in found) else " (numbers of the first)"
            shared = f"{of[1]}, lines {_listed(names)}" if of[1] else f"{first} and {len(names) - 1} others"
            out.append(f"{shared}{rest}: {sentence}{same}")
    return out


def _listed(numbers: Sequence[str]) -> str:
    """Numbers of lines: `2 to 13` where none is left out, else `2, 5, 7`, a dozen at most."""
    if int(numbers[-1]) - int(numbers[0]) == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    more = f" and {len(numbers) - _NAMED} more" if len(numbers) > _NAMED else ""
    return ", ".join(numbers[:_NAMED]) + more


def warning_lines(warnings: Sequence[str], known: int = 0) -> list[str]:
    """Warnings for the terminal; the first `known`, which `check` lists for the campaign, are only counted."""
    lines = [f"warning: {w}" for w in gathered(warnings[known:])]
    if n := len(gathered(warnings[:known])):
        hold = "it holds" if n == 1 else "they hold"
        lines.append(f"`bayes-damper check` lists {counted(n, 'warning')} about these trials; {hold} here too.")
    return lines


def held_out_of(gap: GapEntry) -> bool:
    """Whether any trial tests the verdict: False where each case has one trial only; gap : `gap` of diagnosis.json."""
    nothing = gap.get("p_value") in (None, 1.0) and gap.get("upper_rms_over_noise") is None
    return not (nothing and gap.get("answer") == "cannot tell")


def gap_beside_verdict(verdict: str, share: float, gap: GapEntry) -> str:
    """Why the test of the gap and the verdict point different ways, in a sentence; "" where they agree.

    verdict, share : the most probable answer and its probability; gap : `gap` of diagnosis.json.
    """
    answer, p = gap.get("answer"), gap.get("p_value")
    if answer == "gap" and verdict == "none":
        chance = "" if p is None else f" ({p_value(p)})"
        rare = p is not None and p < 0.1 * gap.get("size", 0.05)
        first = f"The test of the held-out residuals alone says gap{chance}"
        if rare:
            return (
                f"{first}, yet no cause explains it better than no cause at all ({share:.2f}): look at the residuals, "
                "and repeat the trials, before you trust either."
            )
        return (
            f"{first}, as it does for one faultless rig in {1.0 / gap.get('size', 0.05):.0f}. Compared with every "
            f"cause, the complete model is still the most probable answer ({share:.2f}). More repeats would decide."
        )
    if verdict != "none" and answer in ("none", "cannot tell"):
        if not held_out_of(gap):
            return "No trial could be held out, so this answer is not tested on independent trials."
        chance = "" if p is None else f" ({p_value(p)})"
        why = gap.get("why") if answer == "cannot tell" else None
        shown = f"does not decide{chance}: {why}" if why else f"does not show the gap{chance}"
        rests = f"The test of the held-out trials alone {shown}. The answer rests on all trials together."
        if gap.get("taken_up"):  # more trials of the kind leave the test as blind
            return rests
        return f"{rests} More trials under the same conditions would confirm or refute it."
    return ""


def named_answers(probabilities: Mapping[str, float], pair: PairEntry | None) -> dict[str, float]:
    """Answer -> probability, as it is shown: where two effects are the answer, theirs and that of the first one alone.

    pair : as in diagnosis.json: `effects`, the stronger first, and `probability`; None if no pair was considered.
    """
    shown = {name: float(p) for name, p in probabilities.items()}
    if pair and pair["probability"] >= 0.5:
        first = pair["effects"][0]
        both = min(pair["probability"], shown[first])
        shown = {" + ".join(pair["effects"]): both} | shown | {first: shown[first] - both}
    return shown


def effects_to_fit(verdict: str, pair: PairEntry | None) -> list[str]:
    """Effects with which a fit takes a verdict: both of a pair that is the answer, else the one that it names.

    pair : as in diagnosis.json.
    """
    return list(pair["effects"]) if pair and verdict in pair["effects"] else [verdict]


def missed(repeats: bool, effect: str | None = "") -> str:
    """What is said where a fit, with an effect or none, leaves more than the noise, and what to do.

    repeats : whether repeats show the noise; without them slow noise may be the cause too; effect : "A+B" where the fit
    has two.
    """
    doubt = "" if repeats else ", OR THE NOISE IS SLOW"
    if effect:
        beside = effect.replace("+", " AND ")
        return f"THE MODEL MISSES SOMETHING BESIDE {beside}{doubt}: the intervals are wider for it"
    return f"THE MODEL MISSES SOMETHING{doubt}: run `bayes-damper diagnose` before you use these numbers"


def effect_of(entry: CaseEntry) -> str:
    """The effect beside the nominal model of an entry of summary.json, "A+B" of two; "" where there is none."""
    best = entry.get("best_fit")
    return str(best.get("effect") or "") if best else ""


def misses(entry: CaseEntry) -> str:
    """What `missed` says of an entry of summary.json whose model leaves clearly more than the noise; else ""."""
    channels = (entry.get("noise") or {}).get("channels", ())
    left = [c for c in channels if c.get("learnt_from") == "residuals" and c.get("left_over_floor")]
    return missed(any(c.get("repeats") for c in left), effect_of(entry)) if left else ""


def begins_with_budget(verdict: str, held_out: bool) -> bool:
    """Whether an answer begins with its budget: not what is `unknown` and was fitted, but tested by no trial."""
    return verdict != "none" and (held_out or verdict != "unknown")


def budget_sentence(budget: BudgetEntry | None, held_out: bool = True) -> str:
    """The gap by effects in a sentence; "" where no effect is present.

    budget : as in diagnosis.json; held_out : whether any trial tests it. Shares are those of the gap on held-out
    trials; effects that are less than even odds are left to the table.
    """
    parts = [e for e in budget["effects"] if e["present"] >= 0.5] if budget else []
    if budget is None or not parts:
        return ""
    unexplained = budget["unexplained"]["share"]["median"]
    named = [f"{e.get('title') or e['name'].replace('_', ' ')} (probability {_probable(e['present'])})" for e in parts]
    if unexplained is None:
        named[0] = named[0][0].upper() + named[0][1:]
        verb = "is" if len(named) == 1 else "are"
        why = "the gap on held-out trials is too faint to give shares of it"
        return f"{' and '.join(named)} {verb} present; {why if held_out else 'no trial is held out to test that'}."
    shares = [x for e in parts if (x := e["share"]["median"]) is not None]
    each = list(zip(named, shares, strict=True))
    closing = [(name, f"{share_of_gap(x)} %" if x >= 0.005 else "less than 1 %") for name, x in each if x > 0.0]
    harmful = [(name, "nothing") for name, x in each if x <= 0.0]
    # No share of a gap is below none of it, or above all.
    left = round(100.0 * min(unexplained, 1.0)) if harmful else 100 - sum(round(100.0 * x) for x in shares)
    sites = budget["unexplained"].get("sites") or {}
    where = ""
    if left > 0 and sites:
        place = max(sites, key=lambda site: sites[site])
        where = f", most likely at {_AT.get(place, place)}"
    if not closing:
        verb = "closes" if len(harmful) == 1 else "close"
        return f"{left} % of the gap stays unexplained{where}; {' and '.join(named)} {verb} nothing of it."
    rest = f"{left} % stays unexplained{where}" if left > 0 else "nothing stays unexplained"
    (name, share), *others = closing + harmful
    name = name[0].upper() + name[1:]
    return f"{', '.join([f'{name} closes {share} of the gap', *map(' '.join, others)])}; {rest}."


def places_of_rest(sites: Mapping[str, float], budget: BudgetEntry | None) -> dict[str, float]:
    """Where what no effect explains may act, without "none": beside the effects that are present, if any are.

    sites : of the gap of the nominal model, budget : as in diagnosis.json.
    """
    beside = (budget["unexplained"].get("sites") if budget is not None and left_beside(budget) else None) or sites
    return {site: p for site, p in beside.items() if site != "none"}


def left_beside(budget: BudgetEntry | None) -> str:
    """Whose place `places_of_rest` gives, after "place": what the effects that are present leave, "" without any."""
    names = [e["name"].replace("_", " ") for e in budget["effects"] if e["present"] >= 0.5] if budget else []
    return f" of what {' and '.join(names)} leave{'s' if len(names) == 1 else ''} of it" if names else ""


def failed_sentence(budget: BudgetEntry | None) -> str:
    """Effects that were fitted and fail on held-out trials, in a sentence; "" where there are none.

    budget : as in diagnosis.json.
    """
    said = []
    for e in (budget.get("absent") or ()) if budget else ():
        name, share = e["name"].replace("_", " "), e["share"].get("median")
        if share is not None and share <= -1.0:
            name += f" (error {math.sqrt(1.0 - share):.2g} times as large)"
        said.append(name)
    if not said:
        return ""
    return f"Fitted, but rejected, because they do not reduce the gap on held-out trials: {'; '.join(said)}."


def share_of_gap(share: float) -> str:
    """A share of the gap in whole per cent, never -0; what leaves more than twice the gap closes "below -100"."""
    return "below -100" if share < -1.0 else "above 200" if share > 2.0 else f"{round(100.0 * share)}"


def law_sentence(law: LawEntry | None) -> str:
    """What was learnt in place of a cause that has no name, in a sentence; law : as in diagnosis.json, "" for None."""
    if not law:
        return ""
    low, high = (100.0 * min(max(x, 0.0), 1.0) for x in law["closes"]["hdi90"] or (0.0, 1.0))
    share = 100.0 * min(max(law["closes"]["median"] or 0.0, 0.0), 1.0)
    beside = f" beside {' and '.join(e.replace('_', ' ') for e in law['beside'])}" if law["beside"] else ""
    return (
        f"A law learnt at {_AT.get(law['site'], law['site'])}{beside}, Q = {law['formula']}, closes {share:.0f} % "
        f"({low:.0f} to {high:.0f} %) of the gap on held-out trials. Other commands can use it: --effects "
        f"{law['file']}."
    )


def named_sentence(law: LawEntry | None) -> str:
    """Which short formula stands for a learnt law, in a sentence; "" where none was looked for."""
    named = law.get("named") if law else None
    if law is None or named is None or not named["formulas"]:
        return ""
    best, only = named["formulas"][0], named["shape_only"]
    if only >= best["probability"]:
        return (
            f"No short formula describes it (probability {only:.2f}), so only its shape is known; the nearest is "
            f"Q = {best['formula']} ({best['probability']:.2f})."
        )
    others = [f"Q = {f['formula']} ({f['probability']:.2f})" for f in named["formulas"][1:] if f["probability"] >= 0.01]
    more = f"; or {', or '.join(others)}" if others else ""
    first = f"As a formula: Q = {best['formula']} (probability {best['probability']:.2f}){more}; none of these: "
    return f"{first}{only:.2f}. x, v: {_COORDINATES[law['site']]} in SI units; s: the sign of v; t: time since release."


_COORDINATES = {
    "ground1": "angle and velocity of the primary", "bearings": "angle and velocity of each body",
    "interface": "relative angle and velocity", "ground2": "angle and velocity of the secondary",
}  # fmt: skip
_AT = {
    "ground1": "the primary's spring", "bearings": "the bearings", "interface": "the interface",
    "ground2": "the secondary", "release": "the release", "sensor": "the sensors",
}  # fmt: skip
"""Sites within a sentence."""


def _probable(p: float) -> str:
    """A probability with two digits, never 1 unless it is exactly that."""
    return f"{p:.2f}" if p < 0.995 or p == 1.0 else ">0.99"


def number(x: Any, width: float | None = None) -> str:
    """A number as text, else four digits, with those that a 90 % interval of this width supports: two of its standard
    deviation; a dash for nothing.
    """
    if x is None or isinstance(x, bool) or not isinstance(x, int | float) or not math.isfinite(x):
        return NOTHING
    if isinstance(x, int):
        return str(x)
    if width is None or not math.isfinite(width) or width <= 0.0:
        return f"{x:.4g}"
    digits = 1 - math.floor(math.log10(width / SDS_WIDE))
    if x:  # a number far below the width of a lopsided interval keeps a digit of its own
        digits = min(max(digits, -math.floor(math.log10(abs(x)))), digits + 2)
    if -3 <= digits <= 6 and abs(x) < 1e6:
        return f"{round(x, digits):.{max(digits, 0)}f}"
    significant = max(2, math.floor(math.log10(max(abs(x), 1e-300))) + digits + 1)
    return f"{x:.{min(significant, 6)}g}"


def two_digits(x: float) -> str:
    """A number rounded to two digits, without a power of ten up to a billion."""
    return f"{float(f'{x:.2g}'):.9g}"


def plus_minus(x: Any, sd: Any) -> str:
    """A value and its standard deviation, with the digits that this supports."""
    if not isinstance(sd, int | float) or not math.isfinite(sd) or sd <= 0.0:
        return number(x)
    return f"{number(x, SDS_WIDE * sd)} ± {number(sd, SDS_WIDE * sd)}"


def percent(p: Any) -> str:
    """A probability in per cent; never 0 or 100 unless it is exactly that."""
    if p is None:
        return NOTHING
    value = 100.0 * float(p)
    if value in {0.0, 100.0}:
        return f"{value:.0f} %"
    if value > 99.0:
        return f"{min(value, 99.9):.1f} %"
    return "below 0.1 %" if value < 0.1 else f"{value:.1f} %" if value < 1.0 else f"{value:.0f} %"


def interval(low: Any, high: Any) -> str:
    """An interval as text."""
    if low is None or high is None:
        return NOTHING
    width = abs(high - low)
    return f"{number(low, width)} to {number(high, width)}"


def trial_words(proposal: Mapping[str, object]) -> str:
    """A proposed trial in words, in the units of its rig: "coupled trial, k1t 6.2 N m/rad, released at 5 deg"."""
    forms = {"k1t_n_m_per_rad": "k1t {:.3g} N m/rad", "k1_n_per_m": "k1 {:.3g} N/m",
             "theta0_deg": "released at {:.3g} deg", "theta0_mm": "released at {:.3g} mm"}  # fmt: skip
    details = [form.format(proposal[key]) for key, form in forms.items() if proposal.get(key) is not None]
    return ", ".join([f"{proposal['configuration']} trial", *details])
