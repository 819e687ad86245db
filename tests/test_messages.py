"""Codes of warnings and errors: one table, one section of the documentation for each, and every use is in the table."""

from __future__ import annotations

import ast
import pickle
import re
from pathlib import Path

import pytest

import mbfmu as mb
from mbfmu.util.codes import MESSAGE_TITLES, code_of, coded
from mbfmu.util.errors import AssemblyError, UserError
from solvers.outcome import KEYS, Code, Status

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "messages.md").read_text()
C_SOURCES = sorted((ROOT / "mbfmu" / "native" / "c").glob("*.c"))


def used() -> set[str]:
    """Return all codes in the sources: arguments of ``coded`` and of user errors, and codes of classes."""
    found = {KEYS[code] for code in KEYS}
    for package in ("mbfmu", "solvers"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    place = {"coded": 0, "UserError": 1, "AssemblyError": 1, "EquilibriumError": 1}.get(node.func.id)
                    given = node.args[place : place + 1] if place is not None else []
                    found |= {arg.value for arg in given if isinstance(arg, ast.Constant)}
    for path in C_SOURCES:
        found |= set(re.findall(r"\[([a-z]+(?:-[a-z]+)+)\]", path.read_text()))
    return found | {cls.code for cls in (UserError, AssemblyError, mb.EquilibriumError)}


def test_codes_of_the_sources_are_those_of_the_table() -> None:
    assert used() == set(MESSAGE_TITLES)


def test_each_code_has_a_section_with_meaning_cause_and_remedy() -> None:
    sections = re.split(r"^### ", PAGE, flags=re.MULTILINE)[1:]
    names = [section.partition("\n")[0].strip("`") for section in sections]
    assert sorted(names) == sorted(MESSAGE_TITLES)
    for section in sections:
        for part in ("**Meaning.**", "**Cause.**", "**What to do.**"):
            assert section.count(part) == 1, section


def test_a_message_keeps_the_code_of_the_one_that_it_quotes() -> None:
    inner = coded("no-inertia", "no mass")
    assert inner == "no mass [no-inertia]"
    assert coded("invalid-value", f"scene 'a': {inner}") == "scene 'a': no mass [no-inertia]"
    assert code_of(inner) == "no-inertia"
    assert not code_of("values[3]")
    error = UserError(f"file 'x': {inner}; give one")
    assert str(error) == "file 'x': no mass; give one [no-inertia]"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize("code", [code for code in Code if code is not Code.OK])
def test_failures_of_solvers_have_a_code(code: Code) -> None:
    assert Status(code, 1.0).explain().endswith(f" [{KEYS[code]}]")


def test_a_refused_parameter_and_a_loop_that_cannot_close_have_codes() -> None:
    fourbar = mb.models()["fourbar"]
    with pytest.raises(UserError, match=r"crank_mass.* \[invalid-value\]$"):
        fourbar(crank_mass=-1.0)
    with pytest.raises(UserError, match=r"'pivot\.[xy]'.* \[cannot-assemble\]$"):
        mb.simulate(fourbar(ground_length=9.0), 0.1)
