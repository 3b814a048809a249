"""Reading grade of the docs' pages (Flesch and Kincaid, textstat 0.7.4): `python tools/readability.py [PAGE ...]`.

Prose alone counts: tables, code, headings and pictures are left out, and what stands in code marks counts as one word
of one syllable, since names of files and options are read as names. Pages of fewer than 80 words are left out.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FEWEST = 80  # words
_NO_PROSE = (
    (r"```.*?```", ""), (r"^(?: {4}|\t).*$", ""), (r"^\|.*$", ""), (r"^#.*$", ""), (r"<[^>]+>", ""),
    (r"!\[[^\]]*\]\([^)]*\)", ""), (r"\[([^\]]*)\]\([^)]*\)", r"\1"), (r"`[^`]*`", "word"), (r"[*_]", ""),
    (r"^(?:[-*]|\d+\.) ", ""), (r"\n\s*\n", ".\n"), (r"[.:]\s*\.", "."),
)  # fmt: skip


def prose(page: str) -> str:
    """The running text of a page in Markdown, a paragraph's end as the end of a sentence."""
    for pattern, instead in _NO_PROSE:
        page = re.sub(pattern, instead, page, flags=re.DOTALL if "```" in pattern else re.MULTILINE)
    return page


def main(pages: list[Path]) -> None:
    """Print grade, words and words a sentence of each page, the hardest first."""
    import textstat

    rows = []
    for page in pages:
        text = prose(page.read_text(encoding="utf-8"))
        words = textstat.lexicon_count(text)
        if words >= FEWEST:
            name = page.resolve().relative_to(ROOT) if page.resolve().is_relative_to(ROOT) else page
            rows.append((textstat.flesch_kincaid_grade(text), words, words / textstat.sentence_count(text), name))
    for grade, words, length, name in sorted(rows, reverse=True, key=lambda row: row[0]):
        print(f"{grade:5.1f}  {words:5d} words, {length:4.1f} a sentence  {name}")


if __name__ == "__main__":
    main([Path(p) for p in sys.argv[1:]] or [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))])
