"""``python -m mbfmu.fmi.subprocess_export SCENE FMU KIND FMI [PLATFORM ...]``: a scene as an FMU, without a compiler.

Export in a separate process in which kernels are plain Python: assembling the model data calls each kernel a few times
only, and all of these calls together take less time than compiling one kernel. The result has the same bytes. It is
specified by a scene file. The process prints the diagnostics of the export as JSON, one per line.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from mbfmu.modeling.scene import Scene, as_toml, read_scene
from mbfmu.util.diagnostics import Diagnostic, from_saved
from mbfmu.util.errors import UserError

from .export import FmuKind, export_scene


def export_uncompiled(scene: Scene, path: Path, kind: str, fmi: str, *platforms: str) -> list[Diagnostic]:
    """Write the FMU of a scene in another process, and return its diagnostics; raises UserError as the export does."""
    own = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        file = Path(folder) / "scene.toml"
        file.write_text(as_toml(scene), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "mbfmu.fmi.subprocess_export", str(file), str(path), kind, fmi]
        done = subprocess.run(
            [*command, *platforms], env={**os.environ, **own}, capture_output=True, text=True, check=False
        )
    if done.returncode:
        raise UserError(done.stderr.strip())
    return list(from_saved(map(json.loads, done.stdout.splitlines())))


def print_json(found: Diagnostic) -> None:
    """Print a diagnostic as one line of JSON."""
    print(json.dumps(asdict(found)))  # noqa: T201


def main(scene_file: str, path: str, kind: str, fmi: str, *platforms: str) -> int:
    """Write the FMU; return the exit code: 2 where the model is wrong, or does not go into machine code."""
    try:
        export_scene(
            read_scene(Path(scene_file)),
            Path(path),
            FmuKind(kind),
            fmi=int(fmi),
            platforms=platforms,
            report=print_json,
        )
    except UserError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
