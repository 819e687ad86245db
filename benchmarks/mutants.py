"""Which errors in the recursions the tests of identities do not find.

Each mutant is a copy of the sources with one change in one line of ``mbfmu/mechanics/recursions``: a sign, a factor, an
index or a comparison. The tests run on it without compilation; a mutant that passes them has survived. A survivor is a
gap in the tests, or a change without effect (in code that the tests do not take, or that only saves work).

    python benchmarks/mutants.py --count 40            # 40 mutants of all recursions, drawn at random
    python benchmarks/mutants.py --file aba.py --all   # every mutant of one file
    python benchmarks/mutants.py --file aba.py --function unforced --all
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
RECURSIONS = Path("mbfmu/mechanics/recursions")
FILES = ("kinematics.py", "rnea.py", "aba.py", "crba.py", "constraints.py", "energy.py", "applied.py")
TESTS = ("tests/mechanics/test_recursion_identities.py", "tests/mechanics/test_identities.py")  # the short one first
COPIED = ("mbfmu", "solvers", "fmus", "tests", "pyproject.toml")
LIMIT = 900.0  # s, of the tests of one mutant
OPPOSITE: dict[type[ast.operator], type[ast.operator]] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add}


class Mutant(NamedTuple):
    """A changed file."""

    file: str
    function: str
    line: int
    before: str
    after: str
    source: str


def mutants(file: str) -> Iterator[Mutant]:
    """Yield every mutant of one file."""
    text = (ROOT / RECURSIONS / file).read_text(encoding="utf-8")
    tree = ast.parse(text)
    for function in tree.body:
        if not isinstance(function, ast.FunctionDef):
            continue
        for number, node in enumerate(ast.walk(function)):
            for change in range(2):
                changed = copy.deepcopy(tree)
                twin = next(f for f in changed.body if isinstance(f, ast.FunctionDef) and f.name == function.name)
                target = list(ast.walk(twin))[number]
                before = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
                if mutate(target, change):
                    after = ast.unparse(target)
                    yield Mutant(file, function.name, node.lineno, before, after, ast.unparse(changed))  # type: ignore[attr-defined]


def mutate(node: ast.AST, change: int) -> bool:
    """Change a node in place in one of two ways; False if there is no such way."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPPOSITE and change == 0:
        node.op = OPPOSITE[type(node.op)]()
        return True
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and change == 0:
        node.op = ast.UAdd()
        return True
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Lt | ast.GtE) and change == 0:
        node.ops[0] = ast.LtE() if isinstance(node.ops[0], ast.Lt) else ast.Gt()
        return True
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value:
        node.value *= 2.0 if change else -1.0
        return True
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, int):
        if change:
            node.slice.value = max(node.slice.value - 1, 0) if node.slice.value else 1
            return True
        return False
    if (
        isinstance(node, ast.Subscript)
        and isinstance(node.slice, ast.Tuple)
        and len(node.slice.elts) == 2
        and not change
    ):
        node.slice.elts.reverse()
        return ast.dump(node.slice.elts[0]) != ast.dump(node.slice.elts[1])
    return False


def survives(mutant: Mutant | None, folder: Path) -> bool:
    """Return whether the tests pass on a copy of the sources with this change, or without any."""
    if mutant is not None:
        (folder / RECURSIONS / mutant.file).write_text(mutant.source, encoding="utf-8")
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *TESTS]
    try:
        run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return False
    finally:
        if mutant is not None:
            shutil.copy(ROOT / RECURSIONS / mutant.file, folder / RECURSIONS / mutant.file)
    return run.returncode == 0


def main() -> None:
    """Report the mutants that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--file", choices=FILES, help="of this file alone")
    parser.add_argument("--function", help="of this function alone")
    parser.add_argument("--count", type=int, default=20, help="how many, drawn at random")
    parser.add_argument("--all", action="store_true", help="all of them")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    given = parser.parse_args()
    found = [m for file in ([given.file] if given.file else FILES) for m in mutants(file)]
    found = [m for m in found if given.function in (None, m.function)]
    if not given.all:
        found = random.Random(given.seed).sample(found, min(given.count, len(found)))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in COPIED:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
        if not survives(None, folder):
            sys.exit("the tests fail without a mutation")
        count = 0
        for mutant in found:
            alive = survives(mutant, folder)
            count += alive
            said = "SURVIVES" if alive else "found   "
            print(
                f"{said} {mutant.file}:{mutant.line} {mutant.function}: {mutant.before}  ->  {mutant.after}", flush=True
            )
    print(f"{count} of {len(found)} mutants survive")


if __name__ == "__main__":
    main()
