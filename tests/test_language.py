"""Words that readers of the field do not understand are not in pages, docstrings, comments and messages."""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
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
    r"\b(vanishing|constraint|redundant|cut-joint) rows?\b": "constraint equation",
    r"\brows? of (a |the |its )?(cut|loop|constraint)": "constraint equation",
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


EXCEPTIONS = tomllib.loads((Path(__file__).with_suffix(".toml")).read_text())
SOURCES = [
    path.relative_to(ROOT).as_posix()
    for package in ("mbfmu", "solvers", "fmus")
    for path in sorted((ROOT / package).rglob("*.py"))
]


def prose(page: str) -> list[tuple[int, str]]:
    """Return the lines of a page outside blocks and spans of code, with their numbers."""
    found, code = [], False
    for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code and not line.startswith("    "):
            found.append((number, re.sub(r"`[^`]*`", "", line)))
    return found


def explanations(path: str) -> list[tuple[int, str]]:
    """Return the lines of docstrings and comments of a module without spans of code, with their numbers."""
    text = (ROOT / path).read_text()
    lines, found = text.splitlines(), []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            docstring = node.body[0]
            assert docstring.end_lineno is not None
            inside = [(number, lines[number - 1]) for number in range(docstring.lineno, docstring.end_lineno + 1)]
            found += [(number, line) for number, line in inside if not re.fullmatch(r"\s*\w+(, \w+)*", line)]  # names
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            found.append((token.start[0], token.string))
    return [(number, re.sub(r"`+[^`]*`+", "", line)) for number, line in sorted(found)]


def hits(path: str, lines: list[tuple[int, str]], patterns: dict[str, str]) -> list[str]:
    """Return a message for every line that matches a pattern and is no exception."""
    allowed = EXCEPTIONS.get(path, {})
    return [
        f"{path}:{number}: {match.group()!r}: write {instead}: {line.strip()}"
        for number, line in lines
        for pattern, instead in patterns.items()
        for match in [re.search(pattern, line, re.IGNORECASE)]
        if match and not any(text in line for text in allowed)
    ]


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_in_plain_technical_english(page: str) -> None:
    assert not (found := hits(page, prose(page), PATTERNS)), "\n".join(found)


def test_docstrings_and_comments_are_in_plain_technical_english() -> None:
    patterns = {pattern: instead for pattern, instead in PATTERNS.items() if not pattern.startswith("^#")}
    found = [line for path in SOURCES for line in hits(path, explanations(path), patterns)]
    assert not found, "\n".join(found)


def test_every_exception_is_needed() -> None:
    for path, texts in EXCEPTIONS.items():
        assert (ROOT / path).exists(), path
        for text, reason in texts.items():
            assert text in (ROOT / path).read_text(), f"{path}: {text!r} is not there any more"
            assert reason, f"{path}: {text!r} has no reason"


# ---- messages, help texts and descriptions --------------------------------------------------------------------------

SHORTEST = 3  # words of a text that is checked: shorter ones are names and keys
IN_MESSAGES = {pattern: instead for pattern, instead in PATTERNS.items() if not pattern.startswith("^#")} | {
    r"\bgo on\b": "continue",
    r"\bnot to be trusted\b": "may be wrong",
    r"\blooked at\b": "examined",
    r"\brows? of (its |the )?loops?\b": "constraint",
    r"\bby (its )?matrices\b|\bby its recursions\b": "details of the solver",
    r"\bimbalance\b": "energy error",
    r"\bwhat (varies|matters|is measured|is held|was done|it takes)\b": "a noun",
    r"\bno good\b": "not suitable",
    r"\btakes? (the )?'(ida|adams|radau|esdirk|hybrid)'": "use",
    r"\bturn(s|ed)? (it )?(on|off)\b": "switch on, switch off",
}


def texts(path: str) -> list[tuple[int, str]]:
    """Return the string literals of a module that are texts, with their numbers; values in them are left out."""
    tree = ast.parse((ROOT / path).read_text())
    scopes = ast.Module | ast.ClassDef | ast.FunctionDef
    bodies = [node.body for node in ast.walk(tree) if isinstance(node, scopes)]
    docstrings = {id(body[0].value) for body in bodies if body and isinstance(body[0], ast.Expr)}
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside | docstrings:
            text = node.value
        else:
            continue
        if len(text.split()) >= SHORTEST:
            found.append((node.lineno, re.sub(r"`[^`]*`", "", text)))
    return found


def test_messages_are_in_plain_technical_english() -> None:
    found = [line for path in SOURCES for line in hits(path, texts(path), IN_MESSAGES)]
    assert not found, "\n".join(found)


def test_messages_of_native_fmus_are_in_plain_technical_english() -> None:
    found = []
    for path in sorted((ROOT / "mbfmu" / "native" / "c").glob("*.c")):
        lines = [re.sub(r'"[^"]*$', "", line) for line in path.read_text().splitlines()]
        literals = [(number, text) for number, line in enumerate(lines, 1) for text in re.findall(r'"([^"]*)"', line)]
        found += hits(path.relative_to(ROOT).as_posix(), literals, IN_MESSAGES)
    assert not found, "\n".join(found)


@pytest.mark.parametrize("text", ["loop 'a': 3 of 5 rows vanish", "an imbalance of 1 J", "what is held"])
def test_private_words_in_messages_are_found(text: str) -> None:
    assert hits("x", [(1, text)], IN_MESSAGES)
