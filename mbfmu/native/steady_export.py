"""Whether the FMU can find the steady state of its start for other values, and what it needs for this."""

from __future__ import annotations

import numpy as np

from mbfmu.session.simulation import Simulation
from mbfmu.steady.checks import CHECKED_DRIVE_POSITIONS, STEADY_TOLERANCE, stiffness
from mbfmu.steady.state import Equilibrium
from mbfmu.steady.supports import Supports
from solvers.statics.dense import DenseEquilibriumSolver
from solvers.statics.differences import MIN_PIVOT_RATIO, SteadyScratch
from solvers.statics.newton import Outcome, Solution
from solvers.statics.states import hold_states, with_states_as_positions
from solvers.steppers import eliminates_constraints, eliminates_implicitly, uses_recursions

from .steady_start import SteadyStart


def steady_start(simulation: Simulation) -> SteadyStart:
    """Return what the search for the steady state of a simulation's start needs in its FMU."""
    found, compiled = simulation.steady_state, simulation.compiled
    if found is None or not _uses_matrices(simulation):
        return SteadyStart.empty()
    system, drives = compiled.system, compiled.drives
    sizes_of_rows, can_hold = system.row_size[found.rows], np.asarray(system.held_states, bool)
    search = SteadyScratch.allocate(system.nq, system.size, sizes_of_rows, found.rows, found.cyclic, can_hold)
    terms = system.allocate_terms()
    system.fill(0.0, found.q, found.v, terms)
    scaled = terms.J[found.rows] * system.size / search.newton.row[:, np.newaxis]
    search.newton.largest[:] = np.linalg.norm(scaled, 2) if scaled.size else 1.0
    sizes = np.array([drives.sizes[k] for k in drives.signals])
    return SteadyStart.allocate(system.nq, system.m, search, np.array(drives.signals, np.int64), sizes)


def _uses_matrices(simulation: Simulation) -> bool:
    """Whether the solver of a simulation works with the matrices of the equations of motion."""
    system, solver = simulation.compiled.system, simulation.solver_choice.solver
    others = eliminates_constraints, eliminates_implicitly, uses_recursions
    return system.has_matrices and not any(uses(solver, system) for uses in others)


def restricted_inputs(simulation: Simulation) -> set[int]:
    """Return the numbers of the inputs on which the steady state depends in a way that the FMU does not follow: if it
    searches, those of supports whose position is an input; else all.
    """
    inputs = simulation.compiled.inputs
    if simulation.steady_state is None:
        return set()
    if explain_missing_search(simulation):
        return set(range(len(inputs)))
    supports = [(signal, given) for signal, (_, given, _) in inputs.supports().items() if 0 in given]
    return {inputs.number(signal, derivative) for signal, given in supports for derivative in given}


def explain_missing_search(simulation: Simulation) -> str:
    """Return why the FMU does not find the steady state of its start for other values; empty: it does."""
    found, compiled = simulation.steady_state, simulation.compiled
    if found is None:
        return ""
    text = "the initial steady state depends on it, and the FMU does not compute this state: "
    if not _uses_matrices(simulation):
        return f"{text}the model is large"
    if found.continued:
        return f"{text}it was found by a continuation only"
    if found.cyclic.any() and compiled.mechanism.couplings:
        return f"{text}couplings determine rates of the steady state"
    if np.any(found.cyclic & (found.v != compiled.assembly.start_velocities())):
        return f"{text}there is no steady state with the start rates of coordinates on which nothing depends"
    if len(compiled.system.nonholonomic):
        return f"{text}the model has wheels that roll without slip"
    if compiled.mechanism.sampled:
        return f"{text}the model has sampled blocks"
    if Supports(compiled, finishes=False).beginnings():
        return f"{text}the motion of supports to their start positions may have to be followed"
    supports = compiled.inputs.supports()
    signals = compiled.signals(compiled.data)
    if not all(term.steady()[1] for _, _, term in compiled.drives.terms()):
        return f"{text}a drive changes its speed"
    turning = [k for k in compiled.drives.signals if k not in supports or 0 not in supports[k][1]]
    if turning and not all(own.is_constant for own in signals if own.number not in compiled.drives.signals):
        return f"{text}there are both drives and forces that change with time"
    return f"{text}{why}" if (why := _explain_state(found)) else ""


def _explain_state(found: Equilibrium) -> str:
    """Return why a search in the FMU could end in another state, or would not accept this one; empty: neither."""
    compiled, system = found.compiled, found.compiled.system
    plain, v = compiled.complex_system(), found.v.copy()
    extended, at = with_states_as_positions(plain, 0.0, found.q, found.v[system.n_velocities :])
    if system.n_states:
        hold_states(extended, plain, 0.0, found.q, found.v)
    v[system.n_velocities :] = 0.0
    solver = DenseEquilibriumSolver(extended, 0.0, at, v, system.n_states)
    if len(solver.rows) != len(found.rows):
        return "it is a singular configuration"
    terms, n = system.allocate_terms(), system.n
    system.fill(0.0, found.q, found.v, terms)
    K = solver.jacobian(0.0, at, np.linalg.lstsq(terms.J[solver.rows].T, -terms.h, rcond=None)[0])
    K[:n, :n] /= float(np.abs(K[:n, :n]).max(initial=0.0)) or 1.0
    free = np.concatenate([~found.cyclic, np.ones(len(K) - n, bool)])
    sigma = np.linalg.svd(K[:, free], compute_uv=False)
    if sigma.min(initial=np.inf) <= MIN_PIVOT_RATIO * sigma.max(initial=0.0):
        return "there are other steady states next to it"
    fastest = max(compiled.drives.rates(), default=0.0)
    forces, gaps = solver.residual(0.0, at, found.lam)
    solution = Solution(outcome=Outcome.FOUND, q=at, lam=found.lam, iterations=0, forces=forces, gaps=gaps)
    small = STEADY_TOLERANCE * stiffness(compiled, solver, solution)
    for turn in CHECKED_DRIVE_POSITIONS if fastest else ():
        q = at.copy()
        system.apply(q, turn / fastest * v)
        change = solver.residual(turn / fastest, q, found.lam)[0] - forces
        if np.abs(change * system.size).max(initial=0.0) > small:
            return "the forces of loop-closing joints turn with the drive"
    return ""
