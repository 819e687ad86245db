"""Codes of all warnings and errors, with their titles; see :mod:`solvers.codes`."""

from __future__ import annotations

from solvers.codes import TITLES as OF_SOLVERS
from solvers.codes import code_of, coded

__all__ = ["MESSAGE_TITLES", "NOTES", "code_of", "coded"]

NOTES = {"changed-start", "redundant-constraints", "slow-solver"}  # they do not make a result doubtful

MESSAGE_TITLES = OF_SOLVERS | {
    "cannot-assemble": "The loops of the mechanism cannot be closed at the start",
    "changed-start": "Given start values are changed by the assembly",
    "singular-start": "The start is a singular configuration",
    "unstable-start": "The steady state in which a run starts is unstable",
    "locked-mechanism": "The constraints leave no degree of freedom",
    "redundant-constraints": "Constraints are redundant",
    "nearly-parallel-axes": "Constraint equations are left out because axes are nearly parallel",
    "corrected-geometry": "Joint frames are corrected so that redundant constraints close",
    "locked-loop": "Joints cannot move because lengths or axes of their loops have errors",
    "coincident-ends": "The ends of an elastic force coincide",
    "contact-at-start": "A sheet penetrates or misses a contact surface at the start",
    "unreachable-drive": "A drive requires a position that the loops cannot reach",
    "undetermined-forces": "Reaction forces are not determined at a singular configuration",
    "energy-balance": "The energy error is larger than the tolerance explains",
    "slow-passage": "The energy error decides on which side of an unstable equilibrium the motion continues",
    "coarse-mesh": "The mesh of a sheet is too coarse for its deformation",
    "folded-cell": "A mesh cell of a sheet is folded",
    "loose-tolerance": "The tolerance is too large for an output",
    "coarse-tolerance": "Errors at this tolerance may be large",
    "limited-order": "The solver 'ida' is limited to orders 1 and 2",
    "unstable-order": "An order was set that may be unstable for the model",
    "slow-solver": "Another solver needs far less computation",
    "input-jump": "An input changes discontinuously",
    "sampled-input": "An input is set at the outputs only",
    "no-steady-state": "No steady state is found",
    "not-native": "A model or solver cannot be exported as a native FMU",
    "fmi-call": "The importing tool calls an FMI function in a wrong state or with a wrong argument",
    "fmu-files": "The files of an FMU are missing, changed or damaged",
    "out-of-memory": "Memory cannot be allocated",
    "saved-state": "A saved state does not belong to the model, or is damaged",
    "file-access": "A file or folder cannot be read or written",
}
