"""What effects cost that are off: ``python benchmarks/without_effects.py``.

The sheet with every optional effect off, against a build whose sources never had them: a copy less every branch and
loop that serves membrane, damping, drag, a grain or curl. Two processes, one a build, evaluate in turn.
"""

from __future__ import annotations

import ast
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("mbfmu", "solvers", "fmus")
EFFECTS = (
    "plate.membrane == 1",
    "plate.damped == 1",
    "plate.grain == 2",
    "plate.curled == 1",
)
SOURCES = ("mbfmu/sheets/elements/plate_energy.py",)
REPEATS = 201
WORKER = """
import sys
from fmus.sheet import Sheet
from mbfmu.mechanics import CompiledMechanism
from mbfmu.studies.effects import evaluations

call = evaluations(CompiledMechanism(Sheet(nx={}, nz={}, membrane=False, gravity_y=0.0).build()))
for _ in sys.stdin:
    print(call(), flush=True)
"""


class Strip(ast.NodeTransformer):
    """Takes branches and loops that only effects need out of a module."""

    def visit_If(self, node: ast.If) -> ast.AST | None:
        """Drop a branch taken where an effect is on."""
        return None if ast.unparse(node.test) in EFFECTS else self.generic_visit(node)

    def visit_For(self, node: ast.For) -> ast.AST | None:
        """Drop a loop over what an effect acts on."""
        return None if ast.unparse(node.iter) in EFFECTS else self.generic_visit(node)


def strip(folder: Path) -> None:
    """Write the packages without the effects into a folder."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in SOURCES:
        path = folder / name
        before = ast.parse(path.read_text(encoding="utf-8"))
        text = ast.unparse(before)
        after = ast.unparse(Strip().visit(before))
        if after == text:
            raise SystemExit(f"{name} has none of {EFFECTS}; this benchmark must learn what the effects look like now")
        path.write_text(after, encoding="utf-8")


def overhead(nx: int, nz: int) -> float:
    """Return the CPU time of an evaluation relative to that of the build without effects, less one."""
    with tempfile.TemporaryDirectory() as name:
        strip(Path(name))
        workers = [
            subprocess.Popen(
                [sys.executable, "-c", WORKER.format(nx, nz)],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": str(folder)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for folder in (ROOT, name)
        ]
        times: list[list[float]] = [[], []]
        for _ in range(REPEATS):
            for own, worker in zip(times, workers, strict=True):
                assert worker.stdin is not None
                assert worker.stdout is not None
                print(file=worker.stdin, flush=True)
                own.append(float(worker.stdout.readline()))
        for worker in workers:
            worker.communicate()
    ours, bare = (statistics.median(own) for own in times)
    return ours / bare - 1.0


def main() -> None:
    """Print the overhead on two grids."""
    for nx, nz in ((7, 5), (15, 11)):
        more = 100.0 * overhead(nx, nz)
        print(f"{nx} x {nz}: effects that are off cost {more:+.1f} % of an evaluation (at most 3)")


if __name__ == "__main__":
    main()
