"""Statements of the site about the package agree with the package."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

import mbfmu
import solvers
from mbfmu import mechanics, sheets, testing
from mbfmu.cli import main
from mbfmu.mechanics.curve import END_CONDITIONS
from mbfmu.mechanics.law import FUNCTIONS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def documented() -> list[str]:
    """Names of the objects on the pages of the reference."""
    text = "\n".join(page.read_text() for page in (DOCS / "api").glob("*.md"))
    return [name.rpartition(".")[2] for name in re.findall(r"^\.\. (?:auto|py:)\w+:: ([\w.]+)", text, re.MULTILINE)]


def test_the_reference_has_every_public_name_once() -> None:
    named = documented()
    assert sorted(named) == sorted(set(named))
    packages = (mbfmu, mechanics, sheets, solvers, testing)
    assert set(named) == {name for package in packages for name in package.__all__}


def test_the_picture_of_the_choice_is_what_its_script_draws() -> None:
    script = runpy.run_path(str(DOCS / "which_solver.py"))
    assert script["PICTURE"].read_text() == script["picture"]()


def test_the_tables_of_comparisons_are_those_of_their_runs() -> None:
    script = runpy.run_path(str(DOCS / "comparison_tables.py"))
    for page in script["tables"]():
        assert page.read_text() == script["with_tables"](page), page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_files_that_a_page_names_exist(page: Path) -> None:
    named = re.findall(r"`((?:mbfmu|solvers|fmus|tests|benchmarks|examples|docs)/[\w/.]*)`", page.read_text())
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_benchmark_stands_on_its_page() -> None:
    page = (DOCS / "benchmarks.md").read_text()
    assert [path.name for path in (ROOT / "benchmarks").glob("*.py") if f"`{path.name}`" not in page] == []


def test_the_page_of_signals_has_all_functions_of_expressions_and_all_continuations_of_tables() -> None:
    page = (DOCS / "signals.md").read_text()
    listed = page.partition("**Expressions** are texts")[2].partition("\n\n**Functions**")[0]
    constants = re.findall(r"`(\w+)`", listed.partition("the constants ")[2].partition(", the variables")[0])
    functions = re.findall(r"`(\w+)`", listed.partition("- the functions ")[2])
    assert sorted(constants + functions) == sorted(FUNCTIONS)
    continuations = re.findall(r'`"(\w+)"`', page.partition("Its argument `beyond`")[2].partition("\n\n")[0])
    assert sorted(continuations) == sorted(END_CONDITIONS)


def test_the_citation_has_the_version() -> None:
    (version,) = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert version == mbfmu.__version__


def write_and_export(text: str) -> None:
    """Write the files of a page to the present folder, and execute its exports."""
    for name, block in re.findall(r"```python file=(\S+)\n(.*?)```", text, flags=re.DOTALL):
        Path(name).write_text(block)
    for export in re.findall(r"^mbfmu export .*", text, re.MULTILINE):
        assert main(shlex.split(export)[1:]) == 0


def test_the_example_with_fmpy_prints_what_its_comments_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "examples/fmpy.md").read_text()
    write_and_export(text)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        capsys.readouterr()
        exec(compile(block, "docs/examples/fmpy.md", "exec"), names)
        printed = capsys.readouterr().out.splitlines()
        (comment,) = re.findall(r"print\(.*\)  # (.*)", block)
        assert comment.partition(":")[0] == ", ".join(printed)


def test_the_tour_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "tour.md").read_text()
    write_and_export(text)
    capsys.readouterr()
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(compile(block, "docs/tour.md", "exec"), {})
    direct = mbfmu.simulate(mbfmu.find("fourbar")(crank_mass=2.0), 2.0, tolerance=1e-8)
    angle, controlled = capsys.readouterr().out.splitlines()
    assert float(angle) == pytest.approx(direct["crank.angle"][-1], abs=1e-6)
    assert controlled in text
