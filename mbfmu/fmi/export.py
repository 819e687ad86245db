"""From a model to an FMU file: what goes in, and reproducible bytes."""

from __future__ import annotations

import inspect
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import list_variables, require_xml_text
from mbfmu.native.families import NATIVE_SOLVERS
from mbfmu.native.runtime import cached_library
from mbfmu.native.targets import TARGETS, host
from mbfmu.native.user_kernels import user_library
from mbfmu.session.run import communication_points
from mbfmu.session.simulation import UnstartedSimulation
from mbfmu.util.diagnostics import Diagnostic, without_details
from mbfmu.util.errors import UserError
from mbfmu.util.files import replacing
from solvers.compiled.cache import CompilationNeeded, forbid_compilation
from solvers.compiled.kernel import COMPILED
from solvers.steppers import describe_refusal
from solvers.steppers.plugins import is_given

from .description import Experiment
from .documentation import dependencies, licenses, page
from .native_fmu import build_native_fmu
from .python_fmu import build_python_fmu
from .terminals import terminal_files


class FmuKind(StrEnum):
    """What an FMU consists of."""

    PYTHON = "python"  # calls to the installed mbfmu
    NATIVE = "native"  # machine code
    ONE_RUN = "one-run"  # machine code; all parameters are constants, which saves the search for what follows them


def export(
    model: Model,
    path: Path | str,
    settings: Settings | None = None,
    *,
    stop_time: float | None = None,
    output_interval: float | None = None,
    native: bool = False,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    report: Callable[[str], None] = lambda _: None,
) -> Path:
    """Write ``model`` as an FMU; its parameter values become the start values. Equal content gives equal bytes.

    Parameters
    ----------
    model
        Model with the start values of its parameters; structural parameters are fixed at export.
    path
        Path of the file in an existing folder; it must end in ``.fmu``.
    settings
        Start values of the solver's settings; None: the defaults, with the model's tolerance.
    stop_time, output_interval
        Stop time and output interval of the default experiment, s; None: those of the model.
    native
        Whether the FMU is machine code that runs without Python; else it calls the installed mbfmu.
    fmi
        Version of FMI, 2 or 3; version 3 for native FMUs only.
    platforms
        Platforms of a native FMU, by the names in :data:`mbfmu.native.targets.TARGETS`. Empty: this machine.
    report
        Function that receives a message on every decision of the export (another solver, parameters that become
        constant), on redundant constraints, and on a start that is singular or unstable.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    UserError
        The model cannot be built with these parameters, started with these settings or described as an FMU, or the file
        cannot be written.
    """
    if isinstance(model, Mechanism):
        raise UserError("a mechanism cannot be exported as it is: write a Model whose build() returns it")
    scene = default_scene(as_model(model))
    scene = replace(scene, settings=settings or scene.settings)
    scene = scene.changed(stop_time=stop_time, output_interval=output_interval)
    kind = FmuKind.NATIVE if native else FmuKind.PYTHON
    found: list[Diagnostic] = []
    export_scene(scene, Path(path), kind, fmi=fmi, platforms=platforms, report=found.append)
    for diagnostic in without_details(found):
        report(str(diagnostic))
    return Path(path)


def export_scene(
    scene: Scene,
    path: Path,
    kind: FmuKind,
    *,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    report: Callable[[Diagnostic], None] = lambda _: None,
) -> Path:
    """Write a scene as an FMU of a kind; arguments, result and errors are those of :func:`export`, but
    ``report`` receives diagnostics.

    Native FMUs are made in another process if this saves compiling: all runtimes exist, nothing has to be found out
    that takes long in plain Python (which solver to take, or a steady state), and a file contains the model. Of
    ``FmuKind.ONE_RUN`` the diagnostics are those of the model and its start, and UserError is raised if compiling
    would not be saved.
    """
    needs_no_compiler = scene.settings.solver in NATIVE_SOLVERS and not scene.settings.start_at_equilibrium
    needs_no_compiler &= all(name in TARGETS and cached_library(name) is not None for name in platforms or [host()])
    if kind is FmuKind.ONE_RUN and not needs_no_compiler:
        raise UserError(
            f"no native FMU is made for one run: the runtime does not exist, solver {scene.settings.solver!r} is not "
            "supported, or the run starts at an equilibrium",
            "not-native",
        )
    if kind is FmuKind.PYTHON or not needs_no_compiler or not scene.reference or not COMPILED:
        _write(scene, path, kind, fmi, platforms, report)
        return path
    found: list[Diagnostic] = []
    try:
        with forbid_compilation():
            _write(scene, path, kind, fmi, platforms, found.append)
    except CompilationNeeded:
        from .subprocess_export import export_uncompiled  # not before: that process runs it as its main module

        found = export_uncompiled(scene, path, kind, str(fmi), *platforms)
    for diagnostic in found:
        report(diagnostic)
    return path


def _write(
    scene: Scene, path: Path, kind: FmuKind, fmi: int, platforms: Sequence[str], report: Callable[[Diagnostic], None]
) -> None:
    """Write the FMU of a scene in this process."""
    model, settings = scene.model, scene.settings
    require_xml_text(f"the first line of the docstring of model {model.name!r}", model.title())
    experiment = Experiment(
        stop_time=float(scene.stop_time), step_size=float(scene.output_interval), tolerance=settings.tolerance
    )
    communication_points(experiment.stop_time, experiment.step_size)  # refuses what is no time
    if path.suffix != ".fmu":
        raise UserError(f"FMU file is {str(path)!r}; its name must end in .fmu")
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist")
    own = partial(user_library, scene)
    if kind is FmuKind.ONE_RUN:
        messages: list[Diagnostic] = []
        content = build_native_fmu(
            model, settings, experiment, report=messages.append, for_one_run=True, user_library=own
        )
        messages = [diagnostic for diagnostic in messages if diagnostic.code != "constant-parameter"]
    else:
        compiled, native = model.compile(), kind is FmuKind.NATIVE
        messages = [*check_start(model, settings, compiled, native)]
        if native:
            content = build_native_fmu(
                model, settings, experiment, fmi=fmi, platforms=platforms, report=messages.append, user_library=own
            )
        elif fmi != 2 or platforms:
            raise UserError("versions of FMI and platforms can be chosen for machine code alone: native=True")
        else:
            variables = list_variables(model, settings, compiled)
            content = build_python_fmu(model, settings, experiment) | terminal_files(model, variables) | dependencies()
            content["documentation/index.html"] = page(model, variables, needs_python=True).encode()
        texts = licenses(native=native, sundials=any("sundials_core" in name for name in content))
        content |= {f"documentation/licenses/{name}": text for name, text in texts.items()}
        picture = Path(inspect.getsourcefile(type(model)) or ".").parent / "model.png"
        if picture.is_file():
            content["terminalsAndIcons/icon.png"] = picture.read_bytes()
            content |= {"model.png": picture.read_bytes()} if fmi == 2 else {}
    pack(path, content)
    for diagnostic in messages:
        report(diagnostic)


def check_start(model: Model, settings: Settings, compiled: CompiledMechanism, native: bool) -> Sequence[Diagnostic]:
    """Return notes and warnings on the model and its start. Those of a native FMU are in :class:`.NativeModel`.

    Raises
    ------
    UserError
        A run with these settings could not start: a solver that does not suit the model, loops that cannot be closed, a
        singular start, or no steady state.
    """
    if native:  # which chooses its own solver, and builds the start
        compiled.check_start(0.0, compiled.assemble()[0])
        return ()
    if is_given(settings.solver):
        raise UserError(
            f"solver {settings.solver!r} is a class of this program, which an FMU cannot import; allowed: an installed "
            "solver. Install it in a package with an entry point of the group 'mbfmu.solvers'"
        )
    if refused := describe_refusal(settings.solver, compiled.system):
        raise UserError(f"model {model.name!r}: {refused}")
    if compiled.system.m or settings.start_at_equilibrium:
        return UnstartedSimulation(model, settings).diagnostics
    return compiled.check_start(0.0, compiled.assemble()[0])


def pack(path: Path, content: Mapping[str, bytes]) -> None:
    """Write an archive of files by their names: sorted, compressed, with fixed dates."""
    with replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content[name], zipfile.ZIP_DEFLATED)
