"""Errors that are planted in the program are found by the verification suite."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("seeded_errors.py")
FAST = (
    "gear ratio one percent too large",
    "dropped constraint forces of the linear model",
    "dropped gyroscopic term of the linear model",
)


def check(names: list[str]) -> None:
    """Run the script for these errors: the result is right without the error and not right with it."""
    done = subprocess.run([sys.executable, str(SCRIPT), *names], capture_output=True, text=True, check=False)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert sorted(entry["name"] for entry in found) == sorted(names), done.stderr
    for entry in found:
        assert entry["right"] == ["right"], entry
        assert entry["planted"] != ["right"], entry
        assert not entry["planted"][0].startswith("not planted"), entry


def test_a_few_errors_are_found() -> None:
    check(list(FAST))


@pytest.mark.campaign
def test_every_error_is_found() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--list"], capture_output=True, text=True, check=True)
    names = done.stdout.splitlines()
    assert len(names) >= 10
    check(names)
