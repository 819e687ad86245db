"""Codes of all diagnostics with their titles, what is derived from a list of diagnostics, and how one is printed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from solvers.diagnostics import TITLES as OF_SOLVERS
from solvers.diagnostics import Diagnostic

from .errors import missing_attribute

__all__ = [
    "INACCURATE_CODES",
    "MESSAGE_TITLES",
    "Diagnosed",
    "Diagnostic",
    "from_saved",
    "render",
    "without_details",
    "without_repeats",
]

INACCURATE_CODES = {"energy-balance", "slow-passage"}  # the motion may be wrong: the energy error is too large
SUSPECT_CODES = INACCURATE_CODES | {
    "coarse-mesh",
    "fmu-warning",
    "lifting-wheel",
    "profile-end",
    "second-contact",
    "slipping-wheel",
}  # warnings about an error that was found in the run
OLD_NOTE_CODES = {"changed-start", "redundant-constraints", "slow-solver", "selected-solver"}  # until version 0.2
DETAIL_CODES = {"removed-constraints"}  # notes on every planar loop, which are printed on request only

MESSAGE_TITLES = OF_SOLVERS | {
    "cannot-assemble": "The loops of the mechanism cannot be closed at the start",
    "changed-start": "Given start values are changed by the assembly",
    "chosen-tree": "Joints are chosen to close the loops",
    "unused-start": "Start values of joints that close loops are not used",
    "singular-start": "The start is a singular configuration",
    "unstable-start": "The steady state in which a run starts is unstable",
    "locked-mechanism": "The constraints leave no degree of freedom",
    "redundant-constraints": "Constraints are redundant",
    "removed-constraints": "Constraints are satisfied at all positions and are removed",
    "nearly-parallel-axes": "Constraint equations are left out because axes are nearly parallel",
    "corrected-geometry": "Joint frames are corrected so that redundant constraints close",
    "locked-loop": "Joints cannot move because lengths or axes of their loops have errors",
    "coincident-ends": "The ends of an elastic force coincide",
    "implausible-units": "The matrices of a finite element model are in implausible units",
    "assumed-length": "The size of the mechanism is unknown, and 1 m is assumed",
    "element-at-start": "An element is not usable at the start, such as a sheet that penetrates a contact surface",
    "unreachable-drive": "A drive requires a position that the loops cannot reach",
    "undetermined-forces": "Reaction forces are not determined at a singular configuration",
    "lifting-wheel": "A wheel that rolls without slip would lift from its surface",
    "slipping-wheel": "A wheel that rolls without slip needs more friction than there is",
    "second-contact": "A wheel that rolls on a profile would touch it at a second place",
    "profile-end": "A wheel that rolls on a profile leaves the interval for which it is given",
    "energy-balance": "The energy error is larger than the tolerance explains",
    "slow-passage": "The energy error decides on which side of an unstable equilibrium the motion continues",
    "coarse-mesh": "The mesh of a sheet is too coarse for its deformation",
    "folded-cell": "A mesh cell of a sheet is folded",
    "too-many-events": "Too many events follow each other",
    "run-ended": "An event has ended the run",
    "earlier-event": "Events of times before the start of a run do not occur",
    "singular-event": "The velocities after an event are not unique in a singular configuration",
    "resting-bounce": "A quantity that bounces comes to rest at its stop",
    "not-locked": "An event releases a joint that is not locked",
    "prescribed-lock": "The rate of a joint that an event locks cannot change",
    "prescribed-bounce": "The rate of a quantity that hits a stop cannot change",
    "unresolved-friction": "The tolerance does not resolve the deflection of a joint with friction",
    "jammed-joint": "Friction in proportion to the reaction of a joint has no solution",
    "explicit-friction": "An explicit solver is used for a joint that sticks",
    "loose-tolerance": "The tolerance is too large for an output",
    "coarse-tolerance": "Errors at this tolerance may be large",
    "limited-order": "The solver 'ida' is limited to orders 1 and 2",
    "unstable-order": "An order was set that may be unstable for the model",
    "slow-solver": "Another solver needs far less computation",
    "selected-solver": "The solver was selected by auto",
    "input-jump": "An input changes discontinuously",
    "sampled-input": "An input is set at the outputs only",
    "no-steady-state": "No steady state is found",
    "steady-state": "The steady state differs from the start, or is not unique",
    "periodic-coefficients": "The linearized motion has periodic coefficients",
    "not-examined": "A part of the motion or of the inputs was not examined",
    "reference-solution": "The reference of a comparison",
    "omitted-run": "A run of a comparison was omitted",
    "not-imported": "Elements of an imported file have no counterpart",
    "changed-import": "Elements of an imported file are imported in another form",
    "not-exported": "Elements of a model have no counterpart in the format of an exported file",
    "changed-export": "Elements of a model are exported in another form",
    "not-native": "A model or solver cannot be exported as a native FMU",
    "python-fmu": "An FMU calls Python because a native FMU is not possible",
    "no-front": "An FMU that calls Python is written without its front",
    "no-python": "An FMU that calls Python finds no suitable Python",
    "no-runtime": "The machine code of native FMUs cannot be built",
    "constant-parameter": "A parameter is a constant in a native FMU",
    "no-model-exchange": "An FMU supports co-simulation only",
    "constant-input": "An input is constant in model exchange",
    "no-derivatives": "An FMU has no directional derivatives",
    "discarded-evaluation": "An FMU for model exchange discards an evaluation of its derivatives",
    "left-branch": "A step of model exchange ended on another branch of the motion",
    "fmi-call": "The importing tool calls an FMI function in a wrong state or with a wrong argument",
    "fmu-files": "The files of an FMU are missing, changed or damaged",
    "fmu-warning": "An FMU reports a problem without a code, or returns a value that is not finite",
    "sundials-error": "SUNDIALS reports an error in a step that failed",
    "out-of-memory": "Memory cannot be allocated",
    "saved-state": "A saved state does not belong to the model, or is damaged",
    "file-access": "A file or folder cannot be read or written",
}


class Diagnosed:
    """What has a list of ``diagnostics``, and views of it."""

    if TYPE_CHECKING:  # else a field of a dataclass of this name would have it as its default

        @property
        def diagnostics(self) -> Sequence[Diagnostic]:
            """Notes, warnings and errors."""

    @property
    def failed(self) -> bool:
        """Whether there is an error: no result, or one that ends early."""
        return bool(self.failure)

    @property
    def failure(self) -> str:
        """The first error as text: why there is no result or it ends early, and advice; empty: it does not."""
        return next((str(d) for d in self.diagnostics if d.severity == "error"), "")

    @property
    def warning(self) -> str:
        """The warnings about an error that was found in the run, as text; empty: there is none.

        They are those of the energy error and of a mesh that is too coarse. ``diagnostics`` contains all warnings.
        """
        return ". ".join(str(d) for d in self.problems if d.severity == "warning")

    @property
    def problems(self) -> list[Diagnostic]:
        """Errors, then warnings about an error that was found in the run."""
        found = [d for d in self.diagnostics if d.severity == "error" or d.code in SUSPECT_CODES]
        return sorted(found, key=lambda d: (d.severity != "error", d.code not in INACCURATE_CODES))

    @property
    def inaccurate(self) -> bool:
        """Whether the energy error is larger than the tolerance explains."""
        return any(d.code in INACCURATE_CODES for d in self.diagnostics)

    if not TYPE_CHECKING:  # static checkers shall find misspelled names

        def __getattr__(self, name: str) -> Any:
            raise missing_attribute(type(self).__name__, name)


def render(diagnostics: Iterable[Diagnostic], *, details: bool = False) -> list[str]:
    """Return a line for each diagnostic, as all commands print it; ``details``: those on every planar loop too."""
    return [f"{d.severity}: {d}" for d in (diagnostics if details else without_details(diagnostics))]


def without_details(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return the diagnostics without notes that there are on every planar loop."""
    return [d for d in diagnostics if d.code not in DETAIL_CODES]


def from_saved(saved: Iterable[Mapping[str, Any] | str]) -> tuple[Diagnostic, ...]:
    """Return diagnostics from JSON: dictionaries of their fields, or texts that version 0.2 and earlier saved."""
    return tuple(_from_text(d) if isinstance(d, str) else Diagnostic(**d) for d in saved if d)


def _from_text(text: str) -> Diagnostic:
    found = Diagnostic.parse(text, "warning", "selected-solver")  # the only one that had no code
    return replace(found, severity="note") if found.code in OLD_NOTE_CODES else found


def without_repeats(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return the diagnostics in their order, each once."""
    return tuple(dict.fromkeys(diagnostics))
