"""From a model to an FMU file: what goes in, and reproducible bytes."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.scene import Scene, default_scene
from mbfmu.modeling.settings import AUTO, Settings
from mbfmu.modeling.variables import list_variables, require_xml_text
from mbfmu.native.targets import host
from mbfmu.native.user_kernels import user_library
from mbfmu.session.run import communication_points
from mbfmu.session.simulation import UnstartedSimulation
from mbfmu.util.diagnostics import Diagnostic, without_details
from mbfmu.util.errors import UserError
from mbfmu.util.files import check_writable, replacing
from solvers.compiled.cache import CompilationNeeded, forbid_compilation
from solvers.compiled.kernel import COMPILED
from solvers.steppers import describe_refusal
from solvers.steppers.plugins import is_given

from .description import Experiment
from .documentation import dependencies, licenses, page
from .native_fmu import Libraries, build_native_fmu
from .python_fmu import build_python_fmu, source_file
from .terminals import terminal_files


class FmuKind(StrEnum):
    """What an FMU consists of."""

    PYTHON = "python"  # calls to the installed mbfmu
    NATIVE = "native"  # machine code
    ONE_RUN = "one-run"  # machine code; all parameters are constants, which saves the search for what follows them


NOT_NATIVE = ("not-native", "no-runtime")  # codes of errors that an FMU that calls Python does not have
PYTHON_FMU = "this FMU calls Python, and requires mbfmu where it runs"


class Files(NamedTuple):
    """What a native FMU is made of."""

    content: dict[str, bytes]  # by names; without the runtimes
    libraries: Libraries  # the runtimes
    diagnostics: Sequence[Diagnostic]


def export(
    model: Model,
    path: Path | str,
    settings: Settings | None = None,
    *,
    stop_time: float | None = None,
    output_interval: float | None = None,
    native: bool | None = None,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    report: Callable[[str], None] | None = None,
) -> Path:
    """Write ``model`` as an FMU. Equal content gives equal bytes.

    Parameters
    ----------
    model
        Model with the start values of its parameters. The importing tool can change them, with these exceptions:
        structural parameters, and in a native FMU parameters whose effect the export cannot represent (``report``
        receives them).
    path
        Path of the file in an existing folder; it must end in ``.fmu``.
    settings
        Start values of the settings; None, or not given in it: the defaults, with the solver and the tolerance of the
        model. In a native FMU ``solver``, ``input_interpolation`` and ``start_at_equilibrium`` are constants.
    stop_time, output_interval
        Stop time and output interval of the default experiment, s; None: those of the model.
    native
        True: the FMU is machine code that runs without Python. False: it calls the installed mbfmu. None: it is machine
        code if this is possible for the model, the solver and this machine, and calls mbfmu otherwise.
    fmi
        Version of FMI, 2 or 3; version 3 for native FMUs only.
    platforms
        Platforms of a native FMU, by the names in :data:`mbfmu.native.targets.TARGETS`. Empty: this machine.
    report
        Function that receives a message on every decision of the export (a solver, parameters that become constant, an
        FMU that calls mbfmu), on redundant constraints, and on a start that is singular or unstable. None: only a
        warning is given if ``native`` is None and the FMU calls mbfmu.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    UserError
        The model cannot be built with these parameters, started with these settings or described as an FMU, or the file
        cannot be written. With ``native=True``, FMI 3 or platforms: the model cannot be exported as a native FMU.
    """
    if isinstance(model, Mechanism):
        raise UserError("a mechanism cannot be exported as it is: write a Model whose build() returns it")
    scene = default_scene(as_model(model))
    scene = replace(scene, settings=settings or scene.settings)
    scene = scene.changed(stop_time=stop_time, output_interval=output_interval)
    kind, found = FmuKind.PYTHON if native is False else FmuKind.NATIVE, list[Diagnostic]()
    export_scene(scene, Path(path), kind, fmi=fmi, platforms=platforms, report=found.append, falls_back=native is None)
    for diagnostic in without_details(found):
        if report is not None:
            report(str(diagnostic))
        elif diagnostic.code == "python-fmu":
            warnings.warn(str(diagnostic), stacklevel=2)
    return Path(path)


def export_scene(
    scene: Scene,
    path: Path,
    kind: FmuKind = FmuKind.NATIVE,
    *,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    report: Callable[[Diagnostic], None] = lambda _: None,
    falls_back: bool = True,
) -> FmuKind:
    """Write a scene as an FMU of a kind, and return the kind; other arguments and errors are those of :func:`export`,
    but ``report`` receives diagnostics.

    ``falls_back``: if a native FMU is not possible, the FMU calls Python, which is reported, unless FMI 3 or other
    platforms are requested. Of ``FmuKind.ONE_RUN`` the diagnostics are those of the model and its start.
    """
    if path.suffix != ".fmu":
        raise UserError(f"FMU file is {str(path)!r}; its name must end in .fmu")
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist")
    check_writable(path)
    if kind is not FmuKind.PYTHON:
        try:
            _write_native(scene, path, kind, fmi, platforms, report)
        except UserError as error:
            if error.diagnostic.code not in NOT_NATIVE or not falls_back or fmi != 2 or {*platforms} - {host()}:
                raise
            which = "the run uses an FMU that calls Python" if kind is FmuKind.ONE_RUN else PYTHON_FMU
            text = f"{which}: {error.diagnostic.text}"
            report(Diagnostic.note("python-fmu", text, subject=error.diagnostic.subject))
        else:
            return kind
    elif fmi != 2 or platforms:
        raise UserError("FMUs that call Python have FMI 2 and one platform; export a native FMU")
    _write_python(scene, path, report)
    return FmuKind.PYTHON


def _write_native(
    scene: Scene,
    path: Path,
    kind: FmuKind,
    fmi: int,
    platforms: Sequence[str],
    report: Callable[[Diagnostic], None],
) -> None:
    """Write a native FMU.

    Its files are made in another process if this saves compiling: nothing has to be found out that takes long in plain
    Python (which solver to select, or a steady state), and a file contains the model.
    """
    needs_compiler = scene.settings.solver == AUTO or scene.settings.start_at_equilibrium
    if needs_compiler or not scene.reference or not COMPILED:
        files = native_files(scene, kind, fmi, platforms)
    else:
        try:
            with forbid_compilation():
                files = native_files(scene, kind, fmi, platforms)
        except CompilationNeeded:
            from .subprocess_export import files_uncompiled  # not before: that process runs it as its main module

            files = files_uncompiled(scene, kind, fmi, platforms)
    pack(path, files.content | files.libraries.read(), is_compressed=kind is not FmuKind.ONE_RUN)
    for diagnostic in files.diagnostics:
        report(diagnostic)


def native_files(scene: Scene, kind: FmuKind, fmi: int, platforms: Sequence[str]) -> Files:
    """Return the files of a native FMU of a scene, made in this process."""
    model, settings, experiment, messages = scene.model, scene.settings, _experiment(scene), list[Diagnostic]()
    for_one_run = kind is FmuKind.ONE_RUN
    if not for_one_run:  # of one run the simulation reports what is wrong
        compiled = model.compile()
        compiled.check_start(0.0, compiled.assemble()[0])
    content, libraries = build_native_fmu(
        model,
        settings,
        experiment,
        fmi=fmi,
        platforms=platforms,
        report=messages.append,
        for_one_run=for_one_run,
        user_library=partial(user_library, scene),
    )
    if for_one_run:
        messages = [diagnostic for diagnostic in messages if diagnostic.code != "constant-parameter"]
    else:
        content |= _licenses(native=True, sundials=any("sundials_core" in name for name in content))
        content |= _pictures(model, fmi)
        messages += without_rest(compiled.mechanism)
    return Files(content, libraries, messages)


def without_rest(mechanism: Mechanism) -> list[Diagnostic]:
    """Return a note on the rigid stops of a mechanism that hold nothing in a native FMU."""
    stops = [event.name for event in mechanism.events if event.bounce and event.holding_joint is None]
    if not stops:
        return []
    names = ", ".join(map(repr, stops))
    text = (
        "native FMUs do not hold what comes to rest at a rigid stop whose sensor is not the coordinate of a joint with "
        f"one coordinate ({names}): they end with an error there"
    )
    remedy = "If something comes to rest there, export an FMU that calls Python (--python), or use an elastic stop"
    return [Diagnostic.note("resting-bounce", text, remedy, subject=stops[0])]


def _write_python(scene: Scene, path: Path, report: Callable[[Diagnostic], None]) -> None:
    """Write an FMU that calls Python."""
    scene.model.require_parameters("the FMU")
    model, settings, experiment = scene.model, scene.settings, _experiment(scene)
    compiled = model.compile()
    messages = check_start(model, settings, compiled)
    variables = list_variables(model, settings, compiled)
    content = build_python_fmu(model, settings, experiment, report) | terminal_files(model, variables) | dependencies()
    content["documentation/index.html"] = page(model, variables, needs_python=True).encode()
    pack(path, content | _licenses(native=False) | _pictures(model, 2))
    for diagnostic in messages:
        report(diagnostic)


def _experiment(scene: Scene) -> Experiment:
    """Return the default experiment of a scene; refuses a title and times that an FMU cannot have."""
    require_xml_text(f"the first line of the docstring of model {scene.model.name!r}", scene.model.title())
    experiment = Experiment(
        stop_time=float(scene.stop_time), step_size=float(scene.output_interval), tolerance=scene.settings.tolerance
    )
    communication_points(experiment.stop_time, experiment.step_size)  # refuses what is no time
    return experiment


def _licenses(*, native: bool, sundials: bool = False) -> dict[str, bytes]:
    texts = licenses(native=native, sundials=sundials)
    return {f"documentation/licenses/{name}": text for name, text in texts.items()}


def _pictures(model: Model, fmi: int) -> dict[str, bytes]:
    """Return the picture of a model, where importing tools look for it."""
    file = source_file(type(model))
    picture = None if file is None else file.parent / "model.png"
    if picture is None or not picture.is_file():
        return {}
    names = ("terminalsAndIcons/icon.png", *(("model.png",) if fmi == 2 else ()))
    return dict.fromkeys(names, picture.read_bytes())


def check_start(model: Model, settings: Settings, compiled: CompiledMechanism) -> Sequence[Diagnostic]:
    """Return notes and warnings on the model and its start. Those of a native FMU are in :class:`.NativeModel`.

    Raises
    ------
    UserError
        A run with these settings could not start: a solver that does not suit the model, loops that cannot be closed, a
        singular start, or no steady state.
    """
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


def pack(path: Path, content: Mapping[str, bytes], *, is_compressed: bool = True) -> None:
    """Write an archive of files by their names: sorted, with fixed dates."""
    compression = zipfile.ZIP_DEFLATED if is_compressed else zipfile.ZIP_STORED
    with replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", compression) as archive:
        for name in sorted(content):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content[name], compression)
