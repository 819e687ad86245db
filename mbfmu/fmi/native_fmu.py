"""FMUs that need nothing where they run: machine code, and the model as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from typing import NamedTuple

from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import AUTO, Settings
from mbfmu.native.contents import Contents
from mbfmu.native.data import native_model
from mbfmu.native.families import NATIVE_SOLVERS
from mbfmu.native.kernel_table import USER_LIBRARY
from mbfmu.native.layout import signed
from mbfmu.native.runtime import library
from mbfmu.native.sundials_files import SUNDIALS_SOLVERS, libraries
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.solver_selection import select_solver
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.steppers import describe_refusal, drop_unlisted
from solvers.system import AnySystem

from . import description, description3
from .description import LOG_CATEGORIES, Experiment, Identity, xml_bytes
from .documentation import c_sources, page
from .exchange_description import ExchangeInterface, exchange_variables, indicator_variables
from .identity import identify
from .terminals import terminal_files

FMI_VERSIONS = (2, 3)


class Libraries(NamedTuple):
    """The runtimes that an FMU needs: all is known of them before they are built."""

    contents: Contents
    places: dict[str, str]  # names in the FMU by targets

    def read(self) -> dict[str, bytes]:
        """Return the runtimes by their names in the FMU; those that do not exist are built."""
        return {place: library(name, self.contents).read_bytes() for name, place in self.places.items()}


def build_native_fmu(
    model: Model,
    settings: Settings,
    experiment: Experiment,
    *,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    report: Callable[[Diagnostic], None] = lambda _: None,
    for_one_run: bool = False,
    user_library: Callable[[str, str, bool], bytes] = lambda *_: b"",
) -> tuple[dict[str, bytes], Libraries]:
    """Return the files of an FMU that runs by itself, by their names, and its libraries; see :func:`mbfmu.fmi.export`.

    ``for_one_run``: its parameters are constant, which saves the search for what follows them. ``user_library`` returns
    the library of the user-defined kernels for a target and a family.
    """
    names = _targets(fmi, platforms)
    settings = _with_solver(model, settings, report)
    made = native_model(model, settings, for_one_run)
    for found in (*made.diagnostics, *describe_constants(made.fixed)):
        report(found)
    owner = identify(model, settings, experiment, "native", str(fmi), sha256(made.data).hexdigest())
    identity = Identity(name=model.name, identifier=owner.identifier, description=model.title(), guid=owner.guid)
    shown, interface = list(made.variables), None
    if made.states is not None:
        exchanged = exchange_variables(made.states, len(shown) + 1 + len(made.arrays))
        indicators = indicator_variables(made.indicators, len(shown) + 1 + len(made.arrays) + len(exchanged))
        interface = ExchangeInterface(exchanged, made.moving_inputs, made.has_derivatives, indicators)
    if fmi == 2:
        root = description.model_description(identity, experiment, shown, LOG_CATEGORIES, interface, made.takes_rates)
    else:
        root = description3.model_description(identity, experiment, shown, LOG_CATEGORIES, made.arrays, interface)
        shown = [v for _, v in description3.listed(made.variables, made.arrays)]
    places, loaded = {}, {}
    for name in names:
        target = TARGETS[name]
        folder = target.folder if fmi == 2 else name
        places[name] = f"binaries/{folder}/{owner.identifier}{target.suffix}"
        if made.has_user_kernels:
            own = user_library(name, made.contents.family, made.has_derivatives)
            loaded[f"binaries/{folder}/{USER_LIBRARY}{target.suffix}"] = own
        added = libraries(name) if settings.solver in SUNDIALS_SOLVERS else {}
        loaded |= {f"binaries/{folder}/{file}": data for file, data in added.items()}
    content = {
        "modelDescription.xml": xml_bytes(root),
        "resources/model.bin": signed(made.data, owner.guid, loaded.values()),
        "documentation/index.html": page(model, shown, needs_python=False).encode(),
    }
    content |= terminal_files(model, shown) | c_sources() | loaded
    return content, Libraries(made.contents, places)


def describe_constants(frozen: Mapping[str, str]) -> list[Diagnostic]:
    """Return notes on the parameters that are constant, one for each reason; ``frozen``: reasons by name."""
    found = []
    for why in dict.fromkeys(frozen.values()):
        names = [repr(name) for name, own in frozen.items() if own == why]
        what = (
            f"parameter {names[0]} is a constant" if len(names) == 1 else f"parameters {', '.join(names)} are constants"
        )
        text = f"{what} in this FMU: {why}"
        found.append(Diagnostic.note("constant-parameter", text, subject=names[0].strip("'")))
    return found


def _targets(fmi: int, platforms: Sequence[str]) -> list[str]:
    """Return the names of the requested targets; this machine if there are none."""
    if fmi not in FMI_VERSIONS:
        raise UserError(f"fmi is {fmi!r}; allowed: 2 or 3")
    names = list(dict.fromkeys(platforms)) or [host()]
    if names == [""]:
        raise UserError(f"native FMUs are not available for this machine; choose platforms: {_known()}", "not-native")
    for name in names:
        if name not in TARGETS:
            raise UserError(f"unknown platform {name!r}; allowed: {_known()}")
        if fmi == 2 and not TARGETS[name].folder:
            raise UserError(f"FMI 2 has no name for platform {name!r}; export for FMI 3")
    return names


def _known() -> str:
    return ", ".join(TARGETS)


def refuse_solver(solver: str, supported: tuple[str, ...] = NATIVE_SOLVERS) -> None:
    """Raise UserError if a solver that was requested is not in native FMUs; ``auto`` selects one that is."""
    if solver not in (*supported, AUTO):
        raise UserError(
            f"solver is {solver!r}; allowed in a native FMU: {_listed(supported)}, or {AUTO}. Choose one of "
            "these, or export with --python",
            "not-native",
        )


def _with_solver(model: Model, settings: Settings, report: Callable[[Diagnostic], None]) -> Settings:
    """Return settings with a solver that native FMUs support: for ``auto`` the cheapest of these.

    Raises
    ------
    UserError
        Another solver was requested that they do not support, or none of those that they support suits the model.
    """
    given = settings.solver
    if given != AUTO:
        refuse_solver(given)
        if given in SUNDIALS_SOLVERS:
            refuse_solver(given, _supported(model.compile().system))
        return settings
    compiled = model.compile()
    supported = _supported(compiled.system)
    found = select_solver(compiled, [(0.0, *compiled.assemble())], settings.options(model.stop_time))
    implicit = "radau" if compiled.system.has_matrices else "esdirk"
    solver = found.solver if found.solver in supported else implicit
    if refused := describe_refusal(solver, compiled.system):
        why = f", since {compiled.system.stiffness_reason}" if compiled.system.stiffness_reason else f" ({refused})"
        raise UserError(
            f"model {model.name!r} needs the solver 'ida' or 'esdirk'{why}, but native FMUs support "
            f"{_listed(supported)} only for models of this size; export it with --python",
            "not-native",
        )
    why = found.reason if found.solver in supported else f"{found.solver!r} would be better, but is not supported"
    text = f"solver {solver!r} selected: {why}"
    report(Diagnostic.note("selected-solver", text, subject=solver))
    return replace(settings, solver=solver)


def _supported(system: AnySystem) -> tuple[str, ...]:
    """Return the solvers of native FMUs for models of this size."""
    if system.has_matrices:
        return tuple(name for name in NATIVE_SOLVERS if name != "esdirk")
    left_out = ("radau", *(SUNDIALS_SOLVERS if system.nonsmooth_reason else ()))
    return tuple(name for name in NATIVE_SOLVERS if name not in left_out)


def _listed(solvers: tuple[str, ...]) -> str:
    return ", ".join(drop_unlisted(solvers))
