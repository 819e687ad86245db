"""The commands that help texts and pages show are accepted."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from mbfmu.cli import parser
from mbfmu.cli.common import assignments
from mbfmu.modeling.scene import load_scene

ROOT = Path(__file__).parents[1]
PAGES = [path for pattern in ("README.md", "docs/**/*.md", "fmus/*/README.md") for path in sorted(ROOT.glob(pattern))]


def commands() -> dict[str, Any]:
    (found,) = (action for action in parser()._actions if action.choices and "run" in action.choices)
    return dict(found.choices)  # type: ignore[arg-type]


def check_command(line: str) -> None:
    """Parse a command; its parameters must be accepted if it is for an included model."""
    given = parser().parse_args(shlex.split(line, comments=True)[1:])
    assert given.command, line
    scene = getattr(given, "scene", None)
    if isinstance(scene, str) and Path(scene).suffix == "" and ".py:" not in scene:
        load_scene(scene).model.with_values(assignments("--set", getattr(given, "set", [])))


@pytest.mark.parametrize("name", commands())
def test_every_help_has_an_example(name: str) -> None:
    examples = [line for line in commands()[name].epilog.splitlines() if line.startswith("  mbfmu ")]
    assert examples
    for line in examples:
        check_command(re.split(" {3,}", line.strip())[0])  # without its description


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_pages(page: Path) -> None:
    for block in re.findall(r"^```bash\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE):
        for line in block.replace("\\\n", "").splitlines():
            if line.startswith("mbfmu "):
                check_command(line)
