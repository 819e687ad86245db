"""Programs that this process starts."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from mbfmu.util.processes import run_program

# it writes a file again and again, in a process that it has started
WRITER = """
import subprocess, sys, time
if len(sys.argv) == 2:
    subprocess.run([sys.executable, "-c", open(sys.argv[1] + "/program").read(), sys.argv[1], "writes"])
while True:
    with open(sys.argv[1] + "/growing", "a") as file:
        file.write("x")
    print("written", flush=True)
    time.sleep(0.001)
"""


def test_an_interrupted_program_and_its_children_write_nothing_more(tmp_path: Path) -> None:
    def interrupted(_new: bytes) -> None:
        raise KeyboardInterrupt

    (tmp_path / "program").write_text(WRITER)
    with pytest.raises(KeyboardInterrupt):
        run_program([sys.executable, "-c", WRITER, str(tmp_path)], printed=interrupted)
    size = (tmp_path / "growing").stat().st_size
    time.sleep(0.2)
    assert (tmp_path / "growing").stat().st_size == size > 0


def test_exit_code_variables_and_both_streams() -> None:
    code = "import os, sys; print(os.environ['GIVEN'] * 9); print('\\nfirst\\n\\nlast\\n', file=sys.stderr); exit(3)"
    printed = bytearray()
    assert run_program([sys.executable, "-c", code], {"GIVEN": "ab"}, printed=printed.extend) == (3, ["first", "last"])
    assert printed.split() == [b"ab" * 9]
