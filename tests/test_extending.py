"""The examples of docs/extending.md, run as they are printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from mbfmu.cli import main

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text()
BLOCKS = re.findall(r"```(\w+)([^\n]*)\n(.*?)```", PAGE, flags=re.DOTALL)


def test_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    seen = []
    for language, options, text in BLOCKS:
        if "file=" in options:
            Path(options.split("file=")[1].strip()).write_text(text)
        elif language == "python":
            exec(compile(text, "docs/extending.md", "exec"), {})
        elif language == "bash":
            for line in text.splitlines():
                assert main(shlex.split(line)[1:]) == 0, line
        seen.append(language)
    assert seen.count("bash") == 1
    assert (tmp_path / "slider.fmu").is_file()
    assert (tmp_path / "results" / "slider.png").is_file()
