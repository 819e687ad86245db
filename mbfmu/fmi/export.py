"""From a model to an FMU file: what goes in, and reproducible bytes."""

from __future__ import annotations

import inspect
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mbfmu.mechanics import Mechanism, Plant
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import list_variables, require_xml_text
from mbfmu.session.run import communication_points
from mbfmu.session.simulation import UnstartedSimulation
from mbfmu.util.errors import UserError
from mbfmu.util.files import replacing
from solvers.steppers import describe_refusal
from solvers.steppers.plugins import is_given

from .description import Experiment
from .documentation import licenses, page
from .native_fmu import build_native_fmu as native_files
from .python_fmu import build_python_fmu


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
        constant) and on a start that is singular or unstable.

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
    model = as_model(model)
    settings = settings or Settings(solver=model.default_solver, tolerance=model.tolerance)
    plant = model.plant()
    for text in check_start(model, settings, plant, native):
        report(text)
    variables = list_variables(model, settings, plant)
    require_xml_text(f"the first line of the docstring of model {model.name!r}", model.title())
    experiment = Experiment(
        stop_time=float(model.stop_time if stop_time is None else stop_time),
        step_size=float(model.output_interval if output_interval is None else output_interval),
        tolerance=settings.tolerance,
    )
    communication_points(experiment.stop_time, experiment.step_size)  # refuses what is no time
    path = Path(path)
    if path.suffix != ".fmu":
        raise UserError(f"FMU file is {str(path)!r}; its name must end in .fmu")
    if not path.parent.is_dir():
        raise UserError(f"folder {str(path.parent)!r} does not exist")
    if native:
        content = native_files(model, settings, experiment, fmi=fmi, platforms=platforms, report=report)
    else:
        if fmi != 2 or platforms:
            raise UserError("versions of FMI and platforms can be chosen for machine code alone: native=True")
        content = build_python_fmu(model, settings, experiment)
        content["documentation/index.html"] = page(model, variables, needs_python=True).encode()
    content |= {f"documentation/licenses/{name}": text for name, text in licenses(native=native).items()}
    picture = Path(inspect.getsourcefile(type(model)) or ".").parent / "model.png"
    if picture.is_file():
        content["model.png"] = picture.read_bytes()
    pack(path, content)
    return path


def check_start(model: Model, settings: Settings, plant: Plant, native: bool) -> list[str]:
    """Return remarks on a singular or an unstable start. Those of a native FMU are in :class:`.NativeModel`.

    Raises
    ------
    UserError
        A run with these settings could not start: a solver that does not suit the model, loops that cannot be closed, a
        singular start, or no steady state.
    """
    if native:  # which chooses its own solver, and builds the start
        plant.check_start(0.0, plant.assemble()[0])
        return []
    if is_given(settings.solver):
        raise UserError(
            f"solver {settings.solver!r} is a class of this program, which an FMU cannot import; allowed: an installed "
            "solver. Install it in a package with an entry point of the group 'mbfmu.solvers'"
        )
    if refused := describe_refusal(settings.solver, plant.system):
        raise UserError(f"model {model.name!r}: {refused}")
    if plant.system.m or settings.start_at_equilibrium:
        return UnstartedSimulation(model, settings).start_remarks()
    plant.check_start(0.0, plant.assemble()[0])
    return []


def pack(path: Path, content: Mapping[str, bytes]) -> None:
    """Write an archive of files by their names: sorted, compressed, with fixed dates."""
    with replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content[name], zipfile.ZIP_DEFLATED)
