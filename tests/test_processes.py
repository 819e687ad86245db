"""Programs that this process starts."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import pytest
from llvmlite import binding as llvm
from numba.core.registry import cpu_target

from mbfmu.session.interrupts import TERMINATED_EXIT_CODE, termination_raised
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


def test_a_request_to_end_while_llvm_calls_python_is_not_lost() -> None:
    """Python discards what is raised in a callback; the request is repeated after it."""
    cpu_target.target_context.codegen()  # prepares LLVM for this processor
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly("define i32 @one() { ret i32 1 }"), machine)
    compiled = list[bytes]()

    def notify(_module: object, code: bytes) -> None:
        signal.raise_signal(signal.SIGTERM)
        compiled.append(code)

    engine.set_object_cache(notify)

    def compile_and_wait() -> None:
        engine.finalize_object()
        assert compiled
        time.sleep(30.0)  # ends with the repeated request

    with pytest.raises(SystemExit) as raised, termination_raised():
        compile_and_wait()
    assert raised.value.code == TERMINATED_EXIT_CODE


class Finalized:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def test_a_request_to_end_in_a_finalizer_is_not_lost() -> None:
    def finalize_and_wait() -> None:
        Finalized()
        time.sleep(30.0)

    with pytest.raises(SystemExit), termination_raised():
        finalize_and_wait()
