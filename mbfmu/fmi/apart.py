"""``python -m mbfmu.fmi.apart SCENE FMU``: a scene as a native FMU, for a run, without a compiler.

It is a process of its own, in which kernels are plain Python: making the FMU calls each a few times, and all of them
together take less than compiling one. What it makes has the same bytes either way. It is told what to make by a scene
file, and tells what is redundant in the loops, one sentence a line.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mbfmu.direct import loops
from mbfmu.errors import UserError
from mbfmu.native.families import SOLVERS
from mbfmu.native.runtime import there
from mbfmu.native.targets import host
from mbfmu.scene import Scene, as_toml, read_scene

from .description import Experiment
from .export import pack
from .native import native


def made_apart(scene: Scene, path: Path) -> list[str] | None:
    """Write the native FMU of a scene, and return what is redundant in its loops, in sentences; None: there is none.

    There is one where this machine has the runtime and that has the solver, if the model goes into it. No parameter of
    it is settable: it is for one run.
    """
    if scene.settings.solver not in SOLVERS or not host() or there(host()) is None:
        return None
    told = path.with_suffix(".toml")
    told.write_text(as_toml(scene))
    own = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-P", "-m", "mbfmu.fmi.apart", str(told), str(path)]
    done = subprocess.run(command, env={**os.environ, **own}, capture_output=True, text=True, check=False)
    return done.stdout.splitlines() if done.returncode == 0 else None


def main(told: Path, path: Path) -> int:
    """Write the FMU; return the exit code: 2 where the model is wrong, or does not go into machine code."""
    scene = read_scene(told)
    experiment = Experiment(
        stop_time=scene.stop_time, step_size=scene.output_interval, tolerance=scene.settings.tolerance
    )
    try:
        pack(path, native(scene.model, scene.settings, experiment, fmi=2, platforms=(), for_one_run=True))
        for line in loops(scene.model):
            print(line)  # noqa: T201
    except UserError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
