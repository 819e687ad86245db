"""``python -m mbfmu.fmi.subprocess_export SCENE FMU [FMI PLATFORM ...]``: a scene as a native FMU, without a compiler.

Export in a separate process in which kernels are plain Python: assembling the model data calls each kernel a few times
only, and all of these calls together take less time than compiling one kernel. The result has the same bytes. It is
specified by a scene file. The process prints messages, one per line: of the export, or if no version of FMI is given
and the FMU is for one run, of the loops.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from mbfmu.modeling.scene import Scene, as_toml, read_scene
from mbfmu.modeling.settings import Settings
from mbfmu.native.families import NATIVE_SOLVERS
from mbfmu.native.runtime import cached_library
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.run import loops
from mbfmu.util.errors import UserError
from solvers.compiled.cache import CompilationNeeded, forbid_compilation

from .description import Experiment
from .export import export, pack
from .native_fmu import build_native_fmu


def export_for_run(scene: Scene, path: Path) -> list[str] | None:
    """Write the native FMU of a scene, and return what is redundant in its loops, in sentences; None: there is none.

    There is one where this machine has the runtime and that has the solver, if the model goes into it. No parameter of
    it is settable: it is for one run.
    """
    if not _needs_no_compiler(scene.settings, [host()]):
        return None
    try:
        with forbid_compilation():
            return _make(scene, path)
    except UserError:
        return None
    except CompilationNeeded:
        done = _run_subprocess(scene, path)
        return done.stdout.splitlines() if done.returncode == 0 else None


def export_scene(
    scene: Scene, path: Path, *, fmi: int, platforms: Sequence[str], report: Callable[[str], None]
) -> None:
    """Export a scene as a native FMU, see :func:`mbfmu.fmi.export`; apart, where that saves compiling.

    Raises
    ------
    UserError
        As that does.
    """
    if not _needs_no_compiler(scene.settings, platforms or [host()]):
        _export(scene, path, fmi, platforms, report)
        return
    told: list[str] = []
    try:
        with forbid_compilation():
            _export(scene, path, fmi, platforms, told.append)
    except CompilationNeeded:
        done = _run_subprocess(scene, path, str(fmi), *platforms)
        if done.returncode:
            raise UserError(done.stderr.strip()) from None
        told = done.stdout.splitlines()
    for line in told:
        report(line)


def _needs_no_compiler(settings: Settings, platforms: Sequence[str]) -> bool:
    """Whether the runtimes are there, and nothing is to be found out that takes long in plain Python: which solver to
    take, or a steady state.
    """
    known = settings.solver in NATIVE_SOLVERS and not settings.start_at_equilibrium
    return known and all(name in TARGETS and cached_library(name) is not None for name in platforms)


def _run_subprocess(scene: Scene, path: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """Return how the process has ended."""
    own = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        told = Path(folder) / "scene.toml"
        told.write_text(as_toml(scene), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "mbfmu.fmi.subprocess_export", str(told), str(path), *more]
        return subprocess.run(command, env={**os.environ, **own}, capture_output=True, text=True, check=False)


def _make(scene: Scene, path: Path) -> list[str]:
    experiment = Experiment(
        stop_time=scene.stop_time, step_size=scene.output_interval, tolerance=scene.settings.tolerance
    )
    pack(path, build_native_fmu(scene.model, scene.settings, experiment, fmi=2, platforms=(), for_one_run=True))
    return loops(scene.model)


def _export(scene: Scene, path: Path, fmi: int, platforms: Sequence[str], report: Callable[[str], None]) -> None:
    export(
        scene.model,
        path,
        scene.settings,
        stop_time=scene.stop_time,
        output_interval=scene.output_interval,
        native=True,
        fmi=fmi,
        platforms=platforms,
        report=report,
    )


def main(scene_text: str, path: str, fmi: str = "", *platforms: str) -> int:
    """Write the FMU; return the exit code: 2 where the model is wrong, or does not go into machine code."""
    say: Callable[[str], None] = print
    try:
        scene = read_scene(Path(scene_text))
        if fmi:
            _export(scene, Path(path), int(fmi), platforms, say)
        else:
            for line in _make(scene, Path(path)):
                say(line)
    except UserError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
