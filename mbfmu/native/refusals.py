"""Models that native FMUs do not support, with the reasons."""

from __future__ import annotations

from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError
from solvers.steppers import drop_unlisted, eliminates_implicitly

from .event_memory import refuse_unsupported
from .families import ELIMINATED_FAMILIES, NATIVE_SOLVERS, TREE_FAMILIES
from .sundials_files import SUNDIALS_SOLVERS


def refuse_model(simulation: Simulation, family: str) -> None:
    """Raise UserError if the runtime has no solver of a simulation, or does not support its events; ``family`` is that
    of its solver, empty if there is none.
    """
    system = simulation.compiled.system
    if not system.has_matrices and system.nonsmooth_reason and simulation.solver_choice.solver in SUNDIALS_SOLVERS:
        raise UserError(
            f"native FMUs do not support solver {simulation.solver_choice.solver!r} for this large model, since "
            f"{system.nonsmooth_reason}; use 'esdirk', or export it with --python",
            "not-native",
        )
    is_large = not system.has_matrices or eliminates_implicitly(simulation.solver_choice.solver, system)
    if is_large and family not in (ELIMINATED_FAMILIES if system.m else TREE_FAMILIES):
        implicit = "'adams', 'hybrid' and 'ida'" if eliminates_implicitly("ida", system) else "'adams' and 'hybrid'"
        allowed = implicit if system.m else "'adams', 'hybrid', 'ida' and 'esdirk'"
        raise UserError(
            f"native FMUs do not support solver {simulation.solver_choice.solver!r} for this large model of {system.n} "
            f"joint coordinates and {system.m} constraint equations; allowed: {allowed}. Use one of these, or export "
            "it with --python",
            "not-native",
        )
    if not family:
        raise UserError(
            f"native FMUs do not support the solver {simulation.solver_choice.solver!r}; allowed: "
            f"{', '.join(drop_unlisted(NATIVE_SOLVERS))}",
            "not-native",
        )
    refuse_unsupported(simulation.compiled)
