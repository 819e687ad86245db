"""What the packages know of each other, beyond the import contracts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHEETS = re.compile(r"(?<!tem)plate|shell|\bnip|sheet|contact", re.IGNORECASE)
ALLOWED = {"solvers/compiled/cache.py": 1}  # the folders of kernels


@pytest.mark.parametrize("package", ["mbfmu/mechanics", "solvers"])
def test_the_core_does_not_mention_sheets(package: str) -> None:
    """Plates, shells, contact and nips use the general hooks of loads, and so may the elements of a user."""
    found = {
        str(path.relative_to(ROOT)): [line for line in path.read_text().splitlines() if SHEETS.search(line)]
        for path in (ROOT / package).rglob("*.py")
    }
    counts = {name: len(lines) for name, lines in found.items() if lines}
    assert counts == {name: count for name, count in ALLOWED.items() if name.startswith(package)}, found


def test_long_tests_exist() -> None:
    """Else one that has been renamed would be a test of every run again."""
    for line in (ROOT / "tests" / "long_tests.txt").read_text().splitlines():
        if not line.startswith("#"):
            path, name = line.split("[")[0].split("::")
            assert f"def {name}(" in (ROOT / "tests" / path).read_text(), line
