"""Whether what Newton found is a steady state: closed, at constant speed, balanced wherever the drives have gone."""

from __future__ import annotations

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import AssemblyError, EquilibriumError
from solvers.statics.newton import EquilibriumSolver, Solution
from solvers.system import Array

# residual and gaps elsewhere on the drive's way, in units of the force of stiffness and of the rows
STEADY_TOLERANCE = 1e-8
CLOSED_TOLERANCE = 1e-8  # largest gap of a steady state, in units of the rows
STIFFNESS_STEP = 1e-6  # in units of the coordinates, for that force
WRENCH_TOLERANCE = 1e-6  # change of a cut joint's force there, relative to the largest
# rad or m of the drive (s where nothing is driven) at which the balance must hold too
CHECKED_DRIVE_POSITIONS = (0.7, 1.9, 3.4)


def check(
    name: str, compiled: CompiledMechanism, solver: EquilibriumSolver, v: Array, solution: Solution, *, lasts: bool
) -> None:
    """Raise EquilibriumError unless a solution is a steady state of the model ``name`` with velocities v (n,).

    ``lasts``: it has to hold at other times even if no drive moves.
    """
    system, speeds = compiled.system, compiled.drives.rates()
    fastest = max(speeds, default=0.0)
    if system.m:
        terms = system.allocate_terms()
        system.fill(0.0, solution.q, v, terms)
        gaps = np.abs(solution.gaps) / system.row_size
        if gaps.max() > CLOSED_TOLERANCE:
            worst = int(gaps.argmax())
            raise EquilibriumError(
                f"the state found for {name!r} leaves {system.constraint_names[worst]!r} open by "
                f"{gaps[worst]:.2g} of its size, allowed is {CLOSED_TOLERANCE:g}: try another start (--from)"
            )
        opening = np.abs(terms.J @ v - terms.nu)
        rates = max(fastest, float(np.abs(v / system.size).max()))
        worst = int(np.argmax(opening / system.row_size))
        if opening[worst] > STEADY_TOLERANCE * rates * system.row_size[worst]:
            raise EquilibriumError(
                f"{name!r} has no steady state: with the free joints at rest the drive violates the constraints "
                f"of a loop, {system.constraint_names[worst]!r} by {opening[worst]:.3g} per second"
            )
        try:
            compiled.assembly.check_frames(0.0, solution.q)
        except AssemblyError as error:
            raise EquilibriumError(f"what was found for {name!r} is not a steady state: {error}") from error
    if lasts or fastest:
        for turn in CHECKED_DRIVE_POSITIONS:
            check_turned(name, compiled, solver, v, solution, turn, turn / (fastest or 1.0))


def check_turned(
    name: str,
    compiled: CompiledMechanism,
    solver: EquilibriumSolver,
    v: Array,
    solution: Solution,
    turn: float,
    t: float,
) -> None:
    """Raise unless the solution holds at time t too, when the fastest drive has moved by ``turn``.

    Forces of cut joints may turn with either body: those of a bearing on the ground turn with the shaft in it.
    """
    lam, q = solution.lam, solution.q.copy()
    compiled.system.apply(q, t * v)
    size, small = compiled.system.size, STEADY_TOLERANCE * stiffness(compiled, solver, solution)
    forces, gaps = solver.residual(t, q, lam)
    forces -= solution.forces  # what rounding leaves there is no change with the drive
    changed = ""
    if len(solver.rows) and np.abs(forces * size).max() > small:
        rows, terms = solver.rows, compiled.system.allocate_terms()
        compiled.system.fill_position(t, q, terms)
        lam = lam.copy()
        lam[rows] -= np.linalg.lstsq(terms.J[rows].T, forces, rcond=None)[0]
        forces = solver.residual(t, q, lam)[0] - solution.forces
        arms = np.repeat((compiled.length, 1.0), 3)  # what makes forces and moments comparable
        before = compiled.cut_wrenches(0.0, solution.q, v, solution.lam) * arms
        after = compiled.cut_wrenches(t, q, v, lam) * arms
        change = np.abs(after - before).max(axis=2).min(axis=1)
        if change.max(initial=0.0) > small + WRENCH_TOLERANCE * np.abs(before).max(initial=0.0):
            worst = int(np.argmax(change))
            changed = f"change by {change[worst]:.3g} N m in cut joint {compiled.mechanism.cuts[worst].name!r}"
        own = compiled.data.arrays.kept[compiled.data.arrays.couplings["row"]]
        own = own[own >= 0]
        sizes = compiled.system.row_size[own]
        change = np.abs(lam - solution.lam)[own] * sizes
        if change.max(initial=0.0) > small + WRENCH_TOLERANCE * np.abs(solution.lam[own] * sizes).max(initial=0.0):
            coupling = compiled.system.constraint_names[own[int(np.argmax(change))]]
            changed = f"change by {change.max():.3g} N m in coupling {coupling!r}"
    if np.abs(forces * size).max() > small:
        worst = int(np.argmax(np.abs(forces * size)))
        changed = f"leave {abs(forces[worst]):.3g} N or N m at {compiled.system.coordinate_names[worst]!r}"
    open_by = (np.abs(gaps - solution.gaps) / compiled.system.row_size).max(initial=0.0)
    if changed or open_by > STEADY_TOLERANCE:
        changed = changed or f"go with a loop that opens by {open_by:.3g} of its size"
        if not any(compiled.drives.rates()):
            raise EquilibriumError(
                f"{name!r} has no steady state: forces that balance at t = 0 {changed} at t = {t:g} s, although no "
                "drive moves; allowed: forces that do not depend on time. Leave the time out of user-defined forces; "
                "a run can start from the balance at t = 0 (start_at_equilibrium)"
            )
        raise EquilibriumError(
            f"{name!r} has no steady state: forces that balance at one position of the drive {changed} "
            f"after it has moved by {turn:g}; a force such as gravity does not turn with it"
        )


def stiffness(compiled: CompiledMechanism, solver: EquilibriumSolver, solution: Solution) -> float:
    """Return what forces change by where all coordinates change by their units, at most, times the unit: J."""
    size = compiled.system.size
    beside = solution.q.copy()
    compiled.system.apply(beside, STIFFNESS_STEP * size * np.random.default_rng(3).uniform(-1.0, 1.0, len(size)))
    change = solver.residual(0.0, beside, solution.lam)[0] - solution.forces
    return float(np.abs(change * size).max()) / STIFFNESS_STEP
