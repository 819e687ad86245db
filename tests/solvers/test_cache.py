"""Machine code on disk: what is damaged, missing or nobody's to write, and kernels that find each other again."""

from __future__ import annotations

import ast
import json
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from solvers.compiled import cache
from solvers.compiled.kernel import COMPILED, jit_uncached

pytestmark = pytest.mark.skipif(not COMPILED, reason="nothing is compiled")

# `deep` is called by name, as large kernels are, from what is inlined into `outer`.
SCRIPT = """
import json, warnings
import numpy as np
warnings.simplefilter("always")
with warnings.catch_warnings(record=True) as caught:
    from solvers.compiled import cache, symbols
    symbols.MAX_INLINED_LENGTH = 0
    began = []
    from solvers.compiled.kernel import inlined, kernel

    @kernel
    def deep(x, twice):
        total = 0.0
        for i in range(x.shape[0]):
            total += 2.0 * x[i] if twice else x[i]
        return total

    @inlined
    def middle(x):
        return deep(x, True) + deep(x, False)

    @kernel
    def outer(x):
        return 1.0 + middle(x)

    with cache.when_compiling(lambda: began.append(len(outer.overloads) + len(deep.overloads))):
        found = outer(np.arange(4.0))
told = {
    "found": found,
    "began": began,
    "hits": {f.__name__: sum(f.stats.cache_hits.values()) for f in (deep, outer)},
    "misses": {f.__name__: sum(f.stats.cache_misses.values()) for f in (deep, outer)},
    "warned": [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)],
}
print(json.dumps(told))
"""


def start(script: Path, home: Path | str, **variables: str) -> subprocess.Popen[str]:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(home), "PYTHONPATH": os.pathsep.join(sys.path)} | variables
    return subprocess.Popen((sys.executable, script), env=environment, stdout=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen[str]) -> Any:
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    told = json.loads(out)
    assert told["found"] == 19.0
    return told


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "demo.py"
    path.write_text(SCRIPT)
    return path


def test_a_kernel_is_compiled_once_and_found_again(script: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    first = ended(start(script, home))
    assert first["misses"] == {"deep": 1, "outer": 1}, "constants are no types of their own"
    assert first["began"] == [0], "it is said once, before anything is compiled"
    again = ended(start(script, home))
    assert again["began"] == []
    assert again["hits"] == {"deep": 1, "outer": 1}, "what outer calls is loaded with it"
    assert again["misses"] == {"deep": 0, "outer": 0}


@pytest.mark.parametrize("damage", ["cut", "emptied", "flipped", "gone"])
def test_damaged_files_are_compiled_again(script: Path, tmp_path: Path, damage: str) -> None:
    home = tmp_path / "home"
    ended(start(script, home))
    files = [file for file in home.rglob("*.nbc") if file.name.startswith("demo.")]
    assert len(files) >= 3
    for file in files:
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        if damage == "gone":
            file.unlink()
        else:
            file.write_bytes({"cut": content[:-9], "emptied": b"", "flipped": content}[damage])
    ended(start(script, home))
    assert sum(ended(start(script, home))["misses"].values()) == 0, "and kept well"


def test_code_of_another_signature_is_not_taken(tmp_path: Path) -> None:
    """Files may have been exchanged."""
    script, home = tmp_path / "demo.py", tmp_path / "home"
    script.write_text(
        "import json\n"
        "from solvers.compiled.kernel import kernel\n\n"
        "@kernel\n"
        "def double(x):\n"
        "    return 2 * x\n\n"
        "told = double(3), double(1.5), double(1j)\n"
        "print(json.dumps({'found': 19.0, 'told': [repr(x) for x in told]}))\n"
    )
    first = ended(start(script, home))["told"]
    one, two = sorted(home.rglob("demo.double*.nbc"))[:2]
    swapped = one.read_bytes(), two.read_bytes()
    one.write_bytes(swapped[1])
    two.write_bytes(swapped[0])
    assert ended(start(script, home))["told"] == first == ["6", "3.0", "2j"]


def test_a_kernel_and_a_callback_of_one_function_are_stored_apart(tmp_path: Path) -> None:
    script, home = tmp_path / "demo.py", tmp_path / "home"
    script.write_text(
        "import json, os\n"
        "from solvers.compiled.kernel import callback, kernel, types\n\n"
        "def half(x):\n"
        "    return 0.5 * x\n\n"
        "signature = types.float64(types.float64)\n"
        "makers = {'kernel': lambda: kernel(half), 'callback': lambda: callback(signature)(half).ctypes}\n"
        "told = [makers[name]()(3.0) for name in os.environ['MADE'].split()]\n"
        "print(json.dumps({'found': 19.0, 'told': told}))\n"
    )
    for made in ("kernel", "callback", "kernel callback", "callback kernel"):
        told = ended(start(script, home, MADE=made))["told"]
        assert told == [1.5] * len(made.split())


def test_a_kernel_that_was_compiled_again_is_called(tmp_path: Path) -> None:
    """What calls it from Python is on disk for the symbol of another process."""
    script, home = tmp_path / "demo.py", tmp_path / "home"
    script.write_text(
        "import json, os\n"
        "from solvers.compiled.kernel import kernel\n\n"
        "def other(x):\n"
        "    return x\n\n"
        "for _ in range(int(os.environ['KERNELS_BEFORE'])):\n"
        "    kernel(other)(1)\n\n"
        "@kernel\n"
        "def half(x):\n"
        "    return 0.5 * x\n\n"
        "print(json.dumps({'found': 19.0, 'told': half(3.0)}))\n"
    )
    assert ended(start(script, home, KERNELS_BEFORE="0"))["told"] == 1.5
    kept, gone = (sorted(home.rglob(f"demo.half-*{end}.py*")) for end in ("p", "[0-9]"))
    assert len(kept) == len(gone) == 1
    for file in gone:
        file.unlink()
    for count in ("3", "0", "1"):
        assert ended(start(script, home, KERNELS_BEFORE=count))["told"] == 1.5


def test_threads_that_call_a_new_kernel_at_once() -> None:
    """One of them compiles it, for a call from Python or as a part of another kernel."""

    def twice(x: float) -> float:
        return 2.0 * x

    for _ in range(5):
        double = jit_uncached(twice)

        def outer(x: float, double: Any = double) -> float:
            result: float = double(x) + 1.0
            return result

        calls, together = (double, jit_uncached(outer)) * 4, threading.Barrier(8)

        def call(kernel: Any, together: threading.Barrier = together) -> Any:
            together.wait()
            return kernel(3.0)

        with ThreadPoolExecutor(8) as pool:
            assert list(pool.map(call, calls)) == [6.0, 7.0] * 4


def test_a_process_whose_sources_are_edited_keeps_nothing(tmp_path: Path) -> None:
    """It may have imported some of them before and some after the edit."""
    script, home = tmp_path / "demo.py", tmp_path / "home"
    script.write_text(
        "import json\n"
        "from solvers.compiled import cache\n"
        "from solvers.compiled.kernel import kernel\n\n"
        "@kernel\n"
        "def half(x):\n"
        "    return 0.5 * x\n\n"
        "edited = next(iter(cache.record_source_states()))\n"
        "cache.record_source_states()[edited] = 0, 0\n"
        "print(json.dumps({'found': half(38.0)}))\n"
    )
    ended(start(script, home))
    assert not list(home.rglob("demo.half*"))
    script.write_text(script.read_text().replace("cache.record_source_states()[edited] = 0, 0\n", ""))
    ended(start(script, home))
    assert list(home.rglob("demo.half*.nbc"))


def test_a_caller_sees_that_what_it_calls_was_edited(tmp_path: Path) -> None:
    callee, script = tmp_path / "callee.py", tmp_path / "demo.py"
    body = "from solvers.compiled import symbols\nsymbols.MAX_INLINED_LENGTH = 0\n"
    body += "from solvers.compiled.kernel import kernel\n\n@kernel\ndef big(x):\n"
    script.write_text(
        "import json\nfrom callee import big\nfrom solvers.compiled.kernel import kernel\n\n"
        "@kernel\ndef outer(x):\n    return big(x) + 1.0\n\n"
        "print(json.dumps({'found': 19.0, 'told': outer(3.0)}))\n"
    )
    told = []
    for result in ("2.0 * x", "int(x)", "7.5 * x"):
        callee.write_text(f"{body}    return {result}\n")
        told.append(ended(start(script, tmp_path / "home"))["told"])
    assert told == [7.0, 4.0, 23.5]


def test_a_solver_calls_a_kernel_of_a_system_that_was_edited(tmp_path: Path) -> None:
    """The kernel is short, and the module of the solver does not import it.

    Its lengths differ: Python uses the bytecode of a source with the same length and the same second of its time.
    """
    system, solver, script = (tmp_path / f"{name}.py" for name in ("system", "solver", "demo"))
    solver.write_text(
        "from solvers.compiled.kernel import kernel\n\n@kernel\ndef step(system, x):\n    return system.rate(x) + 1.0\n"
    )
    script.write_text(
        "import json\nfrom typing import Any, NamedTuple\nfrom solver import step\nfrom system import rate\n"
        "from solvers.compiled.tuple_pointer import pin\n\n"
        "class System(NamedTuple):\n    rate: Any\n\n"
        "told = step(pin(System(rate)), 3.0), sum(step.stats.cache_hits.values())\n"
        "print(json.dumps({'found': 19.0, 'told': told}))\n"
    )
    told = []
    for result in ("2.0 * x", "2.0 * x", "17.5 * x"):
        system.write_text(
            f"from solvers.compiled.kernel import system_kernel\n\n@system_kernel\ndef rate(x):\n    return {result}\n"
        )
        told.append(ended(start(script, tmp_path / "home"))["told"])
    assert told == [[7.0, 0], [7.0, 1], [53.5, 0]]


def test_an_unwritable_cache_is_reported_once_and_all_is_compiled(script: Path) -> None:
    told = ended(start(script, "/proc/nowhere"))
    assert told["began"] == [0]
    assert len(told["warned"]) == 1
    assert "NUMBA_CACHE_DIR" in told["warned"][0]


def test_processes_that_start_cold_at_once_share_the_work(script: Path, tmp_path: Path) -> None:
    processes = [start(script, tmp_path / "home") for _ in range(3)]
    misses = [ended(process)["misses"] for process in processes]
    assert {name: sum(found[name] for found in misses) for name in misses[0]} == {"deep": 1, "outer": 1}
    assert sum(ended(start(script, tmp_path / "home"))["misses"].values()) == 0


def test_a_process_that_has_been_killed_stops_no_other(script: Path, tmp_path: Path) -> None:
    killed = start(script, tmp_path / "home")
    for _ in range(600):
        if list(tmp_path.rglob("turns")):
            break
        time.sleep(0.05)
    killed.kill()
    killed.communicate()
    assert ended(start(script, tmp_path / "home"))["found"] == 19.0


def test_another_environment_with_the_same_sources_uses_the_same_code(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import json, numpy as np\n"
        "from solvers.linalg.dense import factor_lu\n"
        "factor_lu(np.eye(2), 2, np.zeros(2, np.int64))\n"
        "print(json.dumps({'found': 19.0, 'hits': sum(factor_lu.stats.cache_hits.values())}))\n"
    )
    hits = []
    for name in ("first", "second"):
        for place in cache.KERNEL_DIRS:
            shutil.copytree(place, tmp_path / name / place.relative_to(cache.SOLVERS_DIR.parent))
        hits.append(ended(start(script, tmp_path / "home", PYTHONPATH=str(tmp_path / name)))["hits"])
    assert hits == [0, 1]


LATE = """
import json
import math
from solvers.compiled import cache
from mbfmu.modeling import find
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation

late, load = [], cache.Cache.load_overload

def counted(self, signature, context):
    late.append(str(self._impl.filename_base))
    return load(self, signature, context)

cache.Cache.load_overload = counted
for name in ("fourbar", "governor", "pendulum", "sheet"):
    run = Simulation(find(name)(), Settings(solver=SOLVER))
    late.clear()
    run.outputs()
    mark = run.checkpoint()
    run.advance(0.01)
    state = run.save()
    for k, variable in enumerate(run.compiled.inputs.variables):
        run.set_input(k, variable.start + 1e-3)
        run.advance(run.t + 0.01)
        run.outputs()
    run.rollback(mark)
    run.advance(0.01)
    run.restore(state)
    run.advance(0.02)
    assert not late, (name, late)
print(json.dumps({"found": 19.0}))
"""


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_no_step_waits_for_the_compiler(tmp_path: Path, solver: str) -> None:
    """All that a run needs is there when it has been started, in a separate process."""
    script = tmp_path / "late.py"
    script.write_text(LATE.replace("SOLVER", repr(solver)))
    ended(start(script, cache.cache_root().parent))


STEADY = """
import json
import math
import mbfmu as mb

m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
bob = m.body("bob", m.ground, mb.Revolute(start=-1.5), **mb.rod(mass=1.0, length=1.0))
m.lag("angle", bob.angle(), time_constant=0.1)
q = mb.equilibrium(m).q
print(json.dumps({"found": 19.0, "angle": q[0]}))
"""


def test_a_process_that_compiles_nothing_finds_a_steady_state(tmp_path: Path) -> None:
    """Types of callbacks are known before numba has compiled anything in a process."""
    script = tmp_path / "steady.py"
    script.write_text(STEADY)
    for _ in range(2):  # the second loads what the first has compiled
        assert ended(start(script, cache.cache_root().parent))["angle"] == pytest.approx(-0.5 * math.pi)


def test_the_imports_of_every_module_are_those_of_its_syntax_tree() -> None:
    sources = cache.kernel_sources()
    for module, source in sources.items():
        expected = set()
        parts = module.split(".")
        is_package = any(name.startswith(f"{module}.") for name in sources)
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                expected |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                package = parts[: len(parts) - node.level + is_package] if node.level else []
                origin = ".".join([*package, *([node.module] if node.module else [])])
                inner = {f"{origin}.{alias.name}" for alias in node.names}
                expected |= inner if inner <= set(sources) else {origin, *inner}
        assert expected & set(sources) <= set(cache.imports_of(module)), module


def test_an_edit_changes_the_folders_of_those_that_import_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    caller, callee, other = "solvers.statics.dense", "solvers.linalg.svd", "mbfmu.mechanics.spatial"
    before = {name: cache.module_cache_dir(name) for name in (caller, callee, other)}
    edited = {**cache.kernel_sources(), callee: cache.kernel_sources()[callee] + "\n# edited"}
    monkeypatch.setattr(cache, "kernel_sources", lambda: edited)
    after = {name: cache.module_cache_dir.__wrapped__(name) for name in before}
    assert after[callee] != before[callee]
    assert after[caller] != before[caller]
    assert after[other] == before[other]
