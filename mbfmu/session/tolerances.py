"""Warnings at the start of a run on what its tolerance means for the results."""

from __future__ import annotations

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.load_estimates import unresolved_loads
from mbfmu.util.diagnostics import Diagnostic
from solvers.steppers import UNCONSTRAINED_SOLVERS

from .run_messages import COARSE_TOLERANCE_WARNING, filled

STIFF_OUTPUT_TOLERANCE = 1e-7  # tolerance at which forces in the plane of a sheet in motion are good to some percents
COARSE_TOLERANCE = 1e-3  # from which on runs report how large their errors may be


def describe_loose(compiled: CompiledMechanism, tolerance: float) -> list[Diagnostic]:
    """Return a warning if outputs need a smaller tolerance."""
    names = compiled.stiff_outputs
    if not names or tolerance <= STIFF_OUTPUT_TOLERANCE:
        return []
    more = f" and {len(names) - 1} more" if names[1:] else ""
    text = (
        f"output {names[0]!r}{more} depends on the in-plane strains of a sheet, whose stiffness amplifies the position "
        f"errors that the tolerance of {tolerance:g} allows"
    )
    remedy = f"Use a tolerance of {STIFF_OUTPUT_TOLERANCE:g} or less"
    return [Diagnostic.warning("loose-tolerance", text, remedy, subject=names[0])]


def describe_coarse(compiled: CompiledMechanism, tolerance: float, freedom: int) -> list[Diagnostic]:
    """Return a warning on how large errors may be at a coarse tolerance, if anything is integrated.

    The growth of errors is not estimated: at 1e-3 a growth of 3, that of a pendulum in a few swings, makes an error of
    0.3 rad possible. Sheets are left out: the solvers report their errors.
    """
    if tolerance < COARSE_TOLERANCE or freedom == 0 or compiled.mechanism.meshes:
        return []
    return [filled(COARSE_TOLERANCE_WARNING, tolerance=tolerance)]


def describe_sticking(compiled: CompiledMechanism, solver: str, tolerance: float) -> list[Diagnostic]:
    """Return a warning if the tolerance does not resolve the deflection of a joint with friction, and a note if the
    solver is explicit.
    """
    found = []
    if unresolved := unresolved_loads(compiled.mechanism, compiled.data, compiled.length, tolerance):
        what, deflection, allowed = unresolved[0]
        text = (
            f"the deflection of {what} is {deflection:.3g} (rad or m), but the tolerance of its coordinate is "
            f"{allowed:.3g}: a step may pass over a short slip"
        )
        remedy = f"Use a tolerance of {tolerance * deflection / allowed:.2g} or less, or a larger `deflection`"
        found.append(Diagnostic.warning("unresolved-friction", text, remedy, subject=what))
    if (reason := compiled.system.stick_reason) and solver in UNCONSTRAINED_SOLVERS:
        text = f"{solver!r} is explicit, and needs very many steps: {reason}"
        remedy = "Use 'ida' or 'radau' if the run is slow"
        found.append(Diagnostic.note("explicit-friction", text, remedy, subject=solver))
    return found
