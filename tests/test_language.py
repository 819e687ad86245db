"""Words that readers of the field do not understand are not in the pages that have been rewritten."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/**/*.md", "fmus/*/README.md")
    for path in sorted(ROOT.glob(pattern))
]
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
    r"\btells?\b(?! \w+ apart)|\btold\b": "report, return",
    r"\bso many\b": "the number",
    r"\bbeside\b": "in addition to, next to, near",
    r"\btakes? hold\b": "is applied at",
    r"\banew\b": "again, restart",
    r"\bspares?\b|\berrs?\b": "saves; has an error of",
    r"\blest\b": "so that ... not",
    r"\ba platform\b": "per platform",
    r"\bstands? in (a|the|its)\b": "is in",
    r"\bwhere that is (not|missing)\b": "if it is not",
    r"\bin words\b": "message",
    r"\bsingular positions?\b": "singular configuration",
    r"\bhangs? (together|from)\b": "is connected to",
    r"\bknows\b": "is independent of, uses",
    r"\bsees\b": "detects",
    r"\b(says|say so|said to be|is said)\b": "reports, states",
    r"\bsurvives?\b": "passes",
    r"\bdear(er|est)\b": "more expensive, slowest",
    r"\bgives? way\b": "deforms",
    r"\basked for\b": "optional, requested",
    r"\b(of|for) (its|their|one's) own\b": "separate, user-defined",
    r"\bfor ever\b": "without limit, periodically",
    r"^#+ What\b": "a title that readers search for",
    r"\b(goes|went) on\b": "continues",
    r"\bas it comes?\b|\bas they come\b|\bas they came\b": "by default",
}


def prose(page: str) -> list[tuple[int, str]]:
    """Return the lines of a page outside blocks and spans of code, with their numbers."""
    found, code = [], False
    for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code and not line.startswith("    "):
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
