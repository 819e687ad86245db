"""Words that readers of the field do not understand are not in pages, docstrings, comments and messages."""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from functools import cache
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

CHECKS = [
    path.relative_to(ROOT).as_posix()
    for folder in ("tests", "benchmarks", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path != Path(__file__)  # which contains the words
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
    return [(number, without_spans(line)) for number, line in sorted(found)]


def without_spans(text: str) -> str:
    """Return lines without spans of code."""
    return re.sub(r"`+[^`\n]*`+", "", text)


@cache
def any_of(patterns: tuple[str, ...]) -> re.Pattern[str]:
    """Return a pattern that matches if one of these does: most lines match none."""
    return re.compile("|".join(f"(?:{pattern})" for pattern in patterns), re.IGNORECASE)


def hits(path: str, lines: list[tuple[int, str]], patterns: dict[str, str]) -> list[str]:
    """Return a message for every line that matches a pattern and is no exception."""
    allowed, first = EXCEPTIONS.get(path, {}), any_of(tuple(patterns))
    return [
        f"{path}:{number}: {match.group()!r}: write {instead}: {line.strip()}"
        for number, line in lines
        if first.search(line)
        for pattern, instead in patterns.items()
        for match in [re.search(pattern, line, re.IGNORECASE)]
        if match and not any(text in line for text in allowed)
    ]


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_in_plain_technical_english(page: str) -> None:
    assert not (found := hits(page, prose(page), PATTERNS)), "\n".join(found)


def test_docstrings_and_comments_are_in_plain_technical_english() -> None:
    patterns = {pattern: instead for pattern, instead in PATTERNS.items() if not pattern.startswith("^#")}
    found = []
    for path in SOURCES + CHECKS:
        # few modules contain such words at all; to find the comments of all takes much longer
        if any_of(tuple(patterns)).search(without_spans((ROOT / path).read_text())):
            found += hits(path, explanations(path), patterns)
    assert not found, "\n".join(found)


def test_every_exception_is_needed() -> None:
    for path, texts in EXCEPTIONS.items():
        assert (ROOT / path).exists(), path
        for text, reason in texts.items():
            known = identifiers(path) if text.isidentifier() else (ROOT / path).read_text()
            assert text in known, f"{path}: {text!r} is not there any more"
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


# ---- identifiers ----------------------------------------------------------------------------------------------------

PRIVATE_WORDS = frozenset(
    "told tell tells telling felt feeling look looks looked stray strays strayed judge judges judged seek weave weaver "
    "woven fabric meet meets meeting meetings anew deaf trouble pace paces swift swiftest hang hangs unfelt pliancy "
    "entitle rehearse recall depart departs booked books culprits movers baked carried apart beside legible illegible "
    "leeway leap enough sounds misses silent cornered meshed whence lest dear house room rooms "
    "stepped twin twins "
    .split()
)  # fmt: skip
NOT_IN_NAMES_OF_TESTS = frozenset(
    "told tell tells say says said sentence sentences anew beside remarked nobody".split()
)
ADJECTIVES = frozenset(  # no quantity
    "ALIKE ALL ALREADY BEYOND BRIEF BRIEFLY CHANGED CLEAR CLOSE CLOSED COARSE COARSEST COMMON CROWD DEEP ENOUGH "
    "EXACT FAR FEW FINE FINEST FIRST FLAT FRESH GONE GOOD HIGH INSIDE KNOWN LARGE LARGEST LAST LEAST LEFT LIGHT "
    "LONG LONGEST LOOSE LOOSEST LOST LOW MANY MISSED MOST NEAR NEVER NEXT NOISE NOTHING OFTEN OPEN OTHER OTHERS "
    "OWN QUICK RARE REACH ROUND ROUNDING SAFE SAME SHARP SHORT SHORTEST SLIGHT SLOW SLOWER SLOWEST SMALL SMALLEST "
    "SOME SPARE STEADY STRICT THIN TIGHT TIGHTER TIGHTEST TURNS UNKNOWN USUAL WEAK WHOLE WIDE WORST "
    .split()
)  # fmt: skip
SYMBOLS = frozenset(
    "A B C D E F G J K L M N P Q R S T U V W Y Z a b c d e f h i j k l m n p q r t u v w x y z _".split()
)


def identifiers(path: str) -> dict[str, int]:
    """Return the names that a module defines, with the line of each: functions, classes, arguments, constants and
    attributes of ``self``, and its own.
    """
    found = {Path(path).stem: 1}
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.setdefault(node.name, node.lineno)
        elif isinstance(node, ast.arg):
            found.setdefault(node.arg, node.lineno)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id.isupper():
            found.setdefault(node.id, node.lineno)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self":
            found.setdefault(node.attr, node.lineno)
    return found


def parts(name: str) -> list[str]:
    """Return the words of an identifier in lower case, as written between underscores and changes of case."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def arguments(path: str) -> list[tuple[int, str]]:
    """Return the arguments of one letter of the functions of a module, with the line of each."""
    tree = ast.parse((ROOT / path).read_text())
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return [(arg.lineno, arg.arg) for node in functions for arg in ast.walk(node.args)
            if isinstance(arg, ast.arg) and len(arg.arg) == 1]  # fmt: skip


def constants(path: str) -> dict[str, str]:
    """Return the constants of a module with their values, as written; copies of other names are left out."""
    found = {}
    for node in ast.parse((ROOT / path).read_text()).body:
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            pairs = [(node.target, node.value)]
        elif (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
        ):
            pairs = list(zip(node.targets[0].elts, node.value.elts, strict=True))
        elif isinstance(node, ast.Assign):
            pairs = [(target, node.value) for target in node.targets]
        else:
            continue
        for target, value in pairs:
            if isinstance(target, ast.Name) and target.id.isupper() and not isinstance(value, ast.Name | ast.Attribute):
                found[target.id] = ast.unparse(value)
    return found


def test_identifiers_have_no_private_words() -> None:
    found = [
        f"{path}:{line}: {name!r} contains {word!r}, a word that only this project uses"
        for path in SOURCES
        for name, line in identifiers(path).items()
        for word in parts(name)
        if word in PRIVATE_WORDS and name not in EXCEPTIONS.get(path, {})
    ]
    assert not found, "\n".join(found)


def test_names_of_tests_are_in_plain_technical_english() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for name in re.findall(r"^\s*def (test_\w+)", path.read_text(), re.MULTILINE)
        if NOT_IN_NAMES_OF_TESTS.intersection(name.split("_"))
    ]
    assert not found, "\n".join(found)


def test_constants_are_named_by_quantity() -> None:
    found = [
        f"{path}: constant {name} is named by an adjective or an adverb; name its quantity and its role"
        for path in SOURCES
        for name in constants(path)
        if name in ADJECTIVES and name not in EXCEPTIONS.get(path, {})
    ]
    assert not found, "\n".join(found)


def test_a_constant_has_one_value() -> None:
    values: dict[str, dict[str, list[str]]] = {}
    for path in SOURCES:
        for name, value in constants(path).items():
            if name not in EXCEPTIONS.get(path, {}):
                values.setdefault(name, {}).setdefault(value, []).append(path)
    found = [f"{name}: {places}" for name, places in values.items() if len(places) > 1]
    assert not found, "\n".join(found)


def test_arguments_of_one_letter_are_symbols() -> None:
    found = [
        f"{path}:{line}: argument {name!r} is no symbol of docs/notation.md; write a word"
        for path in SOURCES
        for line, name in arguments(path)
        if name not in SYMBOLS and name not in EXCEPTIONS.get(path, {})
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", ["_tell_loops", "TOLD", "SheetWeaver", "startAnew", "is_felt"])
def test_private_words_in_identifiers_are_found(name: str) -> None:
    assert PRIVATE_WORDS.intersection(parts(name))
