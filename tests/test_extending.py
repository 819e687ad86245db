"""The examples of the README and of the pages on models, elements and steady states, run as they are printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import mbfmu
from mbfmu.cli import main
from mbfmu.mechanics import Coupling, CutJoint, Force, Joint, Signal, couplings, cuts, joints, loads, signals
from mbfmu.mechanics.kind import element_types_of
from mbfmu.modeling.variables import arrays, list_variables
from mbfmu.sheets import Surface
from mbfmu.sheets import joints as sheet_joints
from mbfmu.sheets.contact import surfaces
from mbfmu.studies.resolution import resolutions_of

DOCS = Path(__file__).parents[1] / "docs"


def blocks(page: str) -> list[tuple[str, str, str]]:
    """Language, options and text of every block of a page."""
    return re.findall(r"```(\w+)([^\n]*)\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)


def printed(text: str) -> list[str]:
    """Return the comments on the lines of a block that print: what they print, and after a colon what it is."""
    return re.findall(r"^ *print\(.*\)  # (.*)$", text, re.MULTILINE)


MODELLING = ("modelling", "signals", "controllers", "events", "friction", "gears_and_ropes", "sheets_and_beams")


@pytest.mark.parametrize("page", ["extending.md", *(f"{name}.md" for name in MODELLING)])
def test_examples_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for language, options, text in blocks(page):
        if "file=" in options:
            Path(options.split("file=")[1].strip()).write_text(text)
        elif language == "python":
            capsys.readouterr()
            exec(compile(text, page, "exec"), {})
            lines = capsys.readouterr().out.splitlines()
            for line, comment in zip(lines, printed(text), strict=True):
                assert comment == line or comment.startswith(f"{line}: ")
        elif language == "bash":
            for line in text.splitlines():
                assert main(shlex.split(line)[1:]) == 0, line
    if page == "extending.md":
        assert (tmp_path / "slider.fmu").is_file()
        assert (tmp_path / "lamp.fmu").is_file()
        assert (tmp_path / "results" / "slidercrank" / "default-ida-1e-6-crank_length=0.12" / "outputs.png").is_file()
        flap = mbfmu.find("flap.py")
        assert resolutions_of(flap(), None)[0] == {"nx": 5, "nz": 3}
        assert not flap(nx=5, nz=3).compile().system.m
        piston = mbfmu.find("piston.py:Piston")()
        (joints,) = arrays(piston, list_variables(piston, mbfmu.Settings()))
        assert joints.shape == (2, 2)


def test_the_page_of_kinds_has_every_kind_and_no_other() -> None:
    packages = (
        (joints, Joint),
        (sheet_joints, Joint),
        (cuts, CutJoint),
        (couplings, Coupling),
        (loads, Force),
        (signals, Signal),
        (surfaces, Surface),
    )
    kinds = {kind.__name__ for package, role in packages for kind in element_types_of(package, role)} - {"Coefficients"}
    page = (DOCS / "kinds.md").read_text()
    named = set(re.findall(r"`([A-Z]\w+)", page))
    assert kinds - named == set()
    assert {name for name in named if not hasattr(mbfmu, name)} == set()


def test_the_dozen_lines_of_the_readme_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = (text for language, _, text in blocks("../README.md") if language == "python")
    exec(compile(text, "README.md", "exec"), {})
    (number,) = printed(text)
    assert number == f"{capsys.readouterr().out.strip()}: rad"
    assert (tmp_path / "crank.png").stat().st_size > 10_000


def test_steady_states_are_read_as_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["linearize", "governor", "-o", "governor.npz"]) == 0
    for language, _, text in blocks("equilibrium.md"):
        if language == "python":
            exec(compile(text, "docs/equilibrium.md", "exec"), {})
