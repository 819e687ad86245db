"""Diagnostics and their codes: one table, one section of the documentation for each, and every use is in the table."""

from __future__ import annotations

import ast
import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.util.diagnostics import MESSAGE_TITLES, Diagnostic, from_saved, render
from mbfmu.util.errors import AssemblyError, UserError
from solvers.outcome import KEYS, Code, Status

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "messages.md").read_text()
C_SOURCES = sorted((ROOT / "mbfmu").glob("*/c/*.c"))
ERRORS = {"UserError", "AssemblyError", "EquilibriumError"}


def used() -> set[str]:
    """Return all codes in the sources: arguments of diagnostics and of user errors, and codes of classes."""
    found = {KEYS[code] for code in KEYS}
    for package in ("mbfmu", "solvers"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Call):
                    found |= {arg.value for arg in _codes(node) if isinstance(arg, ast.Constant)}
    for path in C_SOURCES:
        found |= set(re.findall(r"\[([a-z]+(?:-[a-z]+)+)\]", path.read_text()))
    return found | {"fmu-warning"} | {cls.code for cls in (UserError, AssemblyError, mb.EquilibriumError)}


def _codes(node: ast.Call) -> list[ast.expr]:
    if isinstance(node.func, ast.Name) and node.func.id in ERRORS:
        return node.args[1:2]
    if isinstance(node.func, ast.Attribute) and getattr(node.func.value, "id", "") == "Diagnostic":
        return node.args[2:3] if node.func.attr == "parse" else node.args[:1]
    return []


def test_codes_of_the_sources_are_those_of_the_table() -> None:
    assert used() - {""} == set(MESSAGE_TITLES)


def test_each_code_has_a_section_with_meaning_cause_and_remedy() -> None:
    index, *sections = re.split(r"^### ", PAGE, flags=re.MULTILINE)
    names = [section.partition("\n")[0].strip("`") for section in sections]
    assert sorted(names) == sorted(MESSAGE_TITLES) == re.findall(r"\(#(.+?)\)", index)
    for section in sections:
        for part in ("**Meaning.**", "**Cause.**", "**What to do.**"):
            assert section.count(part) == 1, section


def test_a_message_keeps_the_code_of_the_one_that_it_quotes() -> None:
    inner = UserError("no mass", "no-inertia")
    assert str(inner) == "no mass [no-inertia]"
    error = UserError(f"file 'x': {inner}; give one")
    assert str(error) == "file 'x': no mass; give one [no-inertia]"
    assert error.diagnostic == Diagnostic.error("no-inertia", "file 'x': no mass; give one", subject="x")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize("code", [code for code in Code if code is not Code.OK])
def test_failures_of_solvers_have_a_code(code: Code) -> None:
    found = Status(code, 1.5).explain()
    assert (found.severity, found.code, found.time) == ("error", KEYS[code], 1.5)
    assert str(found).endswith(f" [{KEYS[code]}]")
    assert Diagnostic.parse(str(found), "error", "") == found


def test_a_refused_parameter_and_a_loop_that_cannot_close_have_codes() -> None:
    fourbar = mb.models()["fourbar"]
    with pytest.raises(UserError, match=r"crank_mass.* \[invalid-value\]$"):
        fourbar(crank_mass=-1.0)
    with pytest.raises(UserError, match=r"'pivot\.[xy]'.* \[cannot-assemble\]$"):
        mb.simulate(fourbar(ground_length=9.0), 0.1)


def bar(tolerance: float, end: float = 1.0) -> mb.Result:
    m = mb.Mechanism(gravity=(0, -9.81, 0))
    m.body("bar", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1.0, length=1.0))
    return mb.simulate(m, end, solver="adams", tolerance=tolerance)


def test_a_warning_has_parts_and_a_line() -> None:
    (found,) = bar(1e-2).diagnostics
    assert (found.severity, found.code, found.time, found.subject) == ("warning", "coarse-tolerance", None, "tolerance")
    assert found.text.startswith("the tolerance is 0.01: ")
    assert found.remedy == "Repeat the run with a tenth of the tolerance and compare the results"
    assert render([found]) == [f"warning: {found.text}. {found.remedy} [coarse-tolerance]"]
    assert bar(1e-6).diagnostics == ()


def test_a_text_is_read_as_the_diagnostic_that_it_was() -> None:
    found = Diagnostic.warning("input-jump", "input 'u' at t = 0.25 s: off", "Set it. Or not", subject="u", time=0.25)
    assert Diagnostic.parse(str(found), "warning", "fmu-warning") == found
    other = Diagnostic.parse("no code here", "warning", "fmu-warning")
    assert other == Diagnostic.warning("fmu-warning", "no code here")


def test_a_run_that_fails_ends_in_an_error_with_a_time() -> None:
    m = mb.Mechanism(gravity=(0, -9.81, 0))
    m.body("bar", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1.0, length=1.0))
    result = mb.simulate(m, 20.0, interval=10.0, solver="adams", max_steps=5)
    error = result.diagnostics[-1]
    assert (error.severity, error.code) == ("error", "too-many-steps")
    assert error.time is not None
    assert 0.0 < error.time < 10.0
    assert result.failed
    assert result.failure == str(error)
    assert result.problems == [error]


def test_friction_is_named_as_a_cause_of_too_many_steps() -> None:
    for friction in (False, True):
        m = mb.Mechanism(gravity=(0, -9.81, 0))
        arm = m.body("bar", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1.0, length=1.0))
        if friction:
            m.force("bearing", mb.JointFriction(coulomb=0.1), arm)
        error = mb.simulate(m, 20.0, interval=10.0, solver="radau", max_steps=5).diagnostics[-1]
        assert error.code == "too-many-steps"
        assert ("friction" in error.remedy) == friction


# ---- files --------------------------------------------------------------------------------------------------------


def test_diagnostics_are_saved(tmp_path: Path) -> None:
    result = bar(1e-2)
    result.save(tmp_path / "result.npz")
    assert mb.Result.load(tmp_path / "result.npz").diagnostics == result.diagnostics


def test_a_result_of_version_0_2_is_loaded(tmp_path: Path) -> None:
    """Its header as `Result.save` wrote it: texts in four places."""
    new = bar(1e-6)
    new.save(tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as file:
        header, t, values = json.loads(str(file["told"])), file["t"], file["values"]
    del header["diagnostics"]
    header |= {
        "format": 1,
        "failure": "the step has become so small that time does not change (t = 0.5 s). Smooth it [collapsed-step]",
        "verdict": "the energy error is too large at t = 0.25 s: the energy has changed. Reduce it [energy-balance]",
        "coarse": "",
        "remarks": [
            "auto selected 'adams': not stiff",
            "start of body 'bar' is changed from 0 to 1; give consistent values [changed-start]",
            "the tolerance is 0.01: errors may be large. Repeat the run [coarse-tolerance]",
        ],
    }
    np.savez_compressed(tmp_path / "old.npz", t=t, values=values, told=json.dumps(header))
    old = mb.Result.load(tmp_path / "old.npz")
    assert [(d.severity, d.code, d.subject, d.time) for d in old.diagnostics] == [
        ("note", "selected-solver", "adams", None),
        ("note", "changed-start", "bar", None),
        ("warning", "coarse-tolerance", "", None),
        ("warning", "energy-balance", "", 0.25),
        ("error", "collapsed-step", "", 0.5),
    ]
    assert old.failure == header["failure"]
    assert old.warning == header["verdict"]
    assert old.inaccurate
    assert (old["energy_error"] == new["energy_error"]).all()


def test_a_file_as_version_0_2_wrote_it_is_loaded() -> None:
    """Written by version 0.2 itself: `fourbar` for 0.2 s with tolerance 1e-3."""
    old = mb.Result.load(Path(__file__).parent / "data" / "result_0_2.npz")
    assert [(d.severity, d.code) for d in old.diagnostics] == [("warning", "coarse-tolerance")]
    assert not old.failed
    assert not old.warning
    assert old.t[-1] == 0.2


def test_saved_texts_are_read() -> None:
    assert from_saved(["", "no mass [no-inertia]"]) == (Diagnostic.warning("no-inertia", "no mass"),)


@pytest.mark.parametrize(("old", "new"), [("verdict", "warning"), ("remarks", "diagnostics"), ("coarse", "warning")])
def test_earlier_attributes_are_named(old: str, new: str) -> None:
    with pytest.raises(AttributeError, match=f"Result has no attribute '{old}'; it is now called '{new}'"):
        getattr(bar(1e-6, 0.1), old)
