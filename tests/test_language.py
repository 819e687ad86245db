"""Words that readers of the field do not understand are not in the pages that have been rewritten."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (  # those that follow the naming and language rules of CONTRIBUTING.md; the others are to follow
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "docs/balance.md",
    "docs/choosing.md",
    "docs/cosimulation.md",
    "docs/equilibrium.md",
    "docs/extending.md",
    "docs/fmu.md",
    "docs/glossary.md",
    "docs/index.md",
    "docs/kinds.md",
    "docs/limitations.md",
    "docs/native.md",
    "docs/notation.md",
    "docs/theory/index.md",
    "docs/theory/loops.md",
    "docs/tour.md",
    "docs/transport.md",
    "docs/viewing.md",
)
PATTERNS = {  # what is found, and what to write instead
    r"\b(in|with|without) a sentence\b": "error message, warning",
    r"\brows? (that )?vanish": "trivially satisfied constraint",
    r"\bvanish(es|ed)?\b": "is zero, is trivially satisfied",
    r"\bfreedoms\b": "degrees of freedom",
    r"\bhangs? on\b": "is connected to",
    r"\bof (yours|ours)\b": "user-defined",
    r"\blikewise\b": "repeat the text",
    r"\bhouse\b|\brooms?\b": "package, module",
    r"\bjudges?\b|\bjudged\b": "evaluate, compare",
    r"\btells?\b|\btold\b": "report, return",
    r"\bso many\b": "the number",
    r"\bbeside\b": "in addition to, next to, near",
    r"\btakes? hold\b": "is applied at",
    r"\banew\b": "again, restart",
    r"\bspares?\b|\berrs?\b": "saves; has an error of",
    r"\blest\b": "so that ... not",
    r"\ba platform\b": "per platform",
    r"\bstands? in (a|the|its)\b": "is in",
    r"\bwhere that is (not|missing)\b": "if it is not",
}


def prose(page: str) -> list[tuple[int, str]]:
    """Return the lines of a page outside blocks and spans of code, with their numbers."""
    found, code = [], False
    for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code:
            found.append((number, re.sub(r"`[^`]*`", "", line)))
    return found


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_in_plain_technical_english(page: str) -> None:
    hits = [
        f"{page}:{number}: {match.group()!r}: write {instead}: {line.strip()}"
        for number, line in prose(page)
        for pattern, instead in PATTERNS.items()
        for match in [re.search(pattern, line, re.IGNORECASE)]
        if match
    ]
    assert not hits, "\n".join(hits)
