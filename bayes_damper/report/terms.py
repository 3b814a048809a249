"""The words of statistics that a page uses, in a sentence each, for engineers who have not met them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from bayes_damper.report.parts import Headline, Section, Table


@dataclass(frozen=True)
class _Term:
    word: str
    pattern: str
    meaning: str


_TERMS = (
    _Term(
        "prior",
        r"\bpriors?\b|\bassumed\b",
        "What was assumed of a parameter before these data, as a distribution: from drawings, catalogues, handbooks.",
    ),
    _Term(
        "posterior, draws",
        r"\bposterior\b|\bdraws?\b",
        "What is known after the data: a distribution over all parameters together. It is stored as some thousand "
        "draws, each a full set of values.",
    ),
    _Term(
        "90 % interval",
        r"\b90 %",
        "The shortest interval with 90 % of the draws. Given model, data and prior, the value lies in it with a "
        "probability of 0.9.",
    ),
    _Term("sd", r"\bsd\b", "Standard deviation: the typical error of a value."),
    _Term(
        "converged",
        r"\b[Cc]onverge",
        "The draws represent the posterior well enough. This does not mean that the model is right.",
    ),
    _Term(
        "R-hat",
        r"\bR-hat\b",
        "Compares independent runs. 1.00: they agree. Above 1.01: the runs are too short.",
    ),
    _Term(
        "effective sample size (ESS)",
        r"\bESS\b|\beffective sample size\b",
        "How many independent draws a run is worth: bulk for medians, tail for the ends of intervals. 1000 is enough.",
    ),
    _Term(
        "autocorrelation time",
        r"\bautocorrelation time",
        "How many steps until a random walk has forgotten where it was; a run should last many of them.",
    ),
    _Term(
        "evidence",
        r"\bevidence\b",
        "Probability of the data under a model, averaged over its parameters. It rewards a good fit and penalises "
        "needless flexibility. Only differences between models of the same records have a meaning.",
    ),
    _Term(
        "nat",
        r"\bnats?\b",
        "Unit of the logarithm of a ratio of probabilities: 0.69 nats are odds of 2 to 1, 3 nats of 20 to 1.",
    ),
    _Term(
        "p value",
        r"\bp value|\bp below|\bp =",
        "How often noise alone would give a deviation at least as large. Small: noise alone does not explain the "
        "data. It "
        "is not the probability that the model is right.",
    ),
    _Term(
        "innovation, phi",
        r"(?m)^innovation$",
        "Of the noise: what a reading adds to what those before it predict, and the correlation of neighbouring ones.",
    ),
    _Term(
        "temperature",
        r"(?m)^temperature$",
        "Differences of the evidence are divided by it before they become probabilities: above 1 where what the best "
        "answer leaves does not look like noise.",
    ),
    _Term("residual", r"\b[Rr]esiduals?\b", "Measured minus modelled."),
    _Term(
        "held-out trial",
        r"\b[Hh]eld[- ]out\b",
        "A trial that was not used for fitting: it tests whether the model can predict.",
    ),
    _Term("nominal model", r"\b[Nn]ominal model\b", "The equations of the rig with no effect added."),
    _Term(
        "unknown, as an answer",
        r"outside the library|no effect of the library",
        "Something is missing that no effect of the library explains.",
    ),
    _Term(
        "insertion loss",
        r"\b[Ii]nsertion loss\b",
        "By how many dB the highest acceleration per exciting torque (force) falls when the second body is added.",
    ),
    _Term("accelerance", r"\b[Aa]ccelerance\b", "Acceleration per exciting torque (force), over frequency."),
)


def terms(headlines: Iterable[Headline], sections: Iterable[Section]) -> list[tuple[str, str]]:
    """(word, meaning) of the terms that these parts of a page use, in the order in which they build on each other."""
    text = "\n".join([t for h in headlines for t in _of_headline(h)] + [t for s in sections for t in _of_section(s)])
    return [(term.word, term.meaning) for term in _TERMS if re.search(term.pattern, text)]


def _of_headline(headline: Headline) -> Iterator[str]:
    yield from (headline.title, *headline.sentences, *headline.changes)
    if headline.table is not None:
        yield from _of_table(headline.table)


def _of_section(section: Section) -> Iterator[str]:
    yield from (section.title, *section.sentences)
    for table in section.tables:
        yield from _of_table(table)
    yield from (text for chart in section.charts for text in (chart.title, chart.alt))
    yield from (text for picture in section.pictures for text in (picture.title, picture.alt))
    for part in section.parts:
        yield from _of_section(part)


def _of_table(table: Table) -> Iterator[str]:
    yield from (table.caption, table.note, *table.columns)
    for row in table.rows:
        yield from row.cells
