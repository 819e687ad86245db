"""Mistakes a user can make; the message names the thing, its value and what is allowed."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from solvers.diagnostics import Diagnostic

RENAMED = {  # names of earlier versions, and what each is called now
    "Cut": "mechanics.CutJoint",
    "CylindricalCut": "CylindricalCutJoint",
    "DistanceCut": "DistanceCutJoint",
    "PlanarCut": "PlanarCutJoint",
    "PlaneCut": "PlaneCutJoint",
    "Plant": "mechanics.CompiledMechanism",
    "RevoluteCut": "RevoluteCutJoint",
    "SphericalCut": "SphericalCutJoint",
    "TargetChoice": "Recommendation",
    "Touch": "SurfaceContact",
    "TouchHandle": "SurfaceContactHandle",
    "TranslationalCut": "TranslationalCutJoint",
    "WeldCut": "WeldCutJoint",
    "add_touch": "add_contact",
    "audit": "energy_check",
    "choose": "recommend_solver",
    "coarse": "warning",
    "energy_exchanged": "energy_throughput",
    "energy_imbalance": "energy_error",
    "held_inputs": "diagnostics",
    "imbalance": "energy_error",
    "inputs": "input_interpolation",
    "left_out": "diagnostics",
    "lock": "diagnostics",
    "loops": "diagnostics",
    "mark": "checkpoint",
    "notes": "diagnostics",
    "pick": "solver_choice",
    "plant": "compiled",
    "plate": "element",
    "readout": "show_outputs",
    "remarks": "diagnostics",
    "rewind": "rollback",
    "sheets": "meshes",
    "start_remarks": "diagnostics",
    "tell": "report",
    "turning_damping": "rotational_damping",
    "turning_stiffness": "rotational_stiffness",
    "unseen": "diagnostics",
    "verdict": "warning",
    "work_of_jumps": "discontinuity_work",
}
RENAMED_OF = {("a Model", "plant"): "compile"}  # where the new name is another one than that of other owners
SHEET_NAMES = (  # that were in mbfmu.mechanics
    "Drum", "Geodesic", "Guide", "OutOfPlane", "Plate", "Shell", "Stretching", "Surface", "Trough", "Wall",
)  # fmt: skip
MOVED = {("mbfmu.mechanics", name): "mbfmu.sheets" for name in SHEET_NAMES}
MAX_MESSAGE_LENGTH = 3000  # characters that the command prints of an error
MAX_VALUE_LENGTH = 200  # characters of a value in a message


class UserError(ValueError):
    """Base of every error that the command line prints without a traceback; the message ends in its code.

    Parameters
    ----------
    message
        What is wrong (name, value, time), what is allowed or why, and what to do.
    code
        Key of :data:`mbfmu.util.diagnostics.MESSAGE_TITLES`; by default that of the class. A quoted message keeps its
        own.
    """

    code: ClassVar[str] = "invalid-value"

    def __init__(self, message: str = "", code: str = "") -> None:
        from solvers.diagnostics import Diagnostic  # not before it is needed: it loads the solvers

        super().__init__(str(Diagnostic.parse(message, "error", code or self.code)))

    @property
    def diagnostic(self) -> Diagnostic:
        """The error as a diagnostic."""
        from solvers.diagnostics import Diagnostic

        return Diagnostic.parse(str(self), "error", self.code)


class AssemblyError(UserError):
    """The loops of a mechanism cannot be closed, or its start is not consistent."""

    code = "cannot-assemble"


class EquilibriumError(UserError):
    """No steady state was found, or what was found is none; the message gives the residual."""

    code = "no-steady-state"


@contextmanager
def report_write_errors(path: Path) -> Iterator[None]:
    """Raise UserError if a file, or one in a folder, cannot be written."""
    try:
        yield
    except BrokenPipeError:  # of what is printed meanwhile
        raise
    except OSError as error:
        inside = error.filename is not None and path in Path(error.filename).parents
        where = str(error.filename if inside else path)
        raise UserError(f"{where!r} cannot be written: {error.strerror or error}", "file-access") from error


def short(value: object) -> str:
    """Return a value as Python writes it, or its class if that is long."""
    text = repr(value)
    return text if len(text) <= MAX_VALUE_LENGTH and "\n" not in text else f"a {type(value).__name__}"


def shorten(text: str) -> str:
    """Return a message without its middle if it is long, as one that repeats what was given is."""
    if len(text) <= MAX_MESSAGE_LENGTH:
        return text
    head, tail = 2 * MAX_MESSAGE_LENGTH // 3, MAX_MESSAGE_LENGTH // 3
    return f"{text[:head]} [... {len(text) - head - tail} characters left out ...] {text[-tail:]}"


def suggest(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: its new name, the nearest known one, or all of them."""
    names = list(known)
    if not names:
        return "; there are none"
    if RENAMED.get(name) in names:
        return f"; it is now called {RENAMED[name]!r}"
    near = difflib.get_close_matches(name, names, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; allowed: {', '.join(sorted(names))}"


def missing_attribute(owner: str, name: str) -> AttributeError:
    """Return the error for an attribute that ``owner`` does not have; with the new name or package of an old one."""
    new = RENAMED_OF.get((owner, name)) or RENAMED.get(name)
    now = f"; it is now called {new!r}" if new else ""
    if (owner, name) in MOVED:
        now = f"; it is now in {MOVED[owner, name]}"
    return AttributeError(f"{owner} has no attribute {name!r}{now}")


def require_arguments(cls: type, given: Iterable[str]) -> None:
    """Raise UserError if a class is given a keyword argument that its ``__init__`` does not have."""
    known = _arguments(cls)
    for name in given:
        if known and name not in known:
            raise UserError(f"{cls.__name__} has no argument {name!r}{suggest(name, known)}")


@cache
def _arguments(cls: type) -> tuple[str, ...]:
    """Return the names of the arguments of ``cls.__init__`` without self; empty if it accepts any."""
    arguments: list[Any] = list(inspect.signature(cls.__init__).parameters.values())[1:]  # type: ignore[misc]
    accepts_any = any(a.kind is inspect.Parameter.VAR_KEYWORD for a in arguments)
    return () if accepts_any else tuple(a.name for a in arguments)
