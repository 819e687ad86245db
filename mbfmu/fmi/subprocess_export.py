"""``python -m mbfmu.fmi.subprocess_export SCENE ARCHIVE KIND FMI [PLATFORM ...]``: files of an FMU, without a compiler.

Export in a separate process in which kernels are plain Python: assembling the model data calls each kernel a few times
only, and all of these calls together take less time than compiling one kernel. The files have the same bytes. The scene
is given by a scene file. The process writes an archive of all files but the runtimes. It prints the diagnostics of the
export as JSON, one per line, and then the contents and the places of the runtimes.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from mbfmu.modeling.scene import Scene, as_toml, read_scene
from mbfmu.native.contents import Contents
from mbfmu.util.diagnostics import from_saved
from mbfmu.util.errors import UserError
from mbfmu.util.processes import run_program

from .export import Files, FmuKind, native_files, pack
from .native_fmu import Libraries


def files_uncompiled(scene: Scene, kind: str, fmi: int, platforms: Sequence[str]) -> Files:
    """Return the files of the FMU of a scene, made in another process; raises UserError as the export does."""
    own = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        file, archive = Path(folder) / "scene.toml", Path(folder) / "files.zip"
        file.write_text(as_toml(scene), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "mbfmu.fmi.subprocess_export", str(file), str(archive), kind, str(fmi)]
        printed = bytearray()
        code, errors = run_program([*command, *platforms], own, printed=printed.extend)
        if code:
            raise UserError("\n".join(errors))
        *messages, (family, parts, places) = map(json.loads, printed.splitlines())
        with zipfile.ZipFile(archive) as opened:
            content = {name: opened.read(name) for name in opened.namelist()}
    return Files(content, Libraries(Contents(family, tuple(parts)), places), from_saved(messages))


def main(scene_file: str, archive: str, kind: str, fmi: str, *platforms: str) -> int:
    """Write the archive; return the exit code: 2 if the model is wrong, or cannot be exported as a native FMU."""
    try:
        content, libraries, messages = native_files(read_scene(Path(scene_file)), FmuKind(kind), int(fmi), platforms)
    except UserError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    pack(Path(archive), content)
    for line in (*map(asdict, messages), (*libraries.contents, libraries.places)):
        print(json.dumps(line))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
