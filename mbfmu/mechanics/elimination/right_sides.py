"""The elimination with other right-hand sides: for derivatives of corrections and of accelerations.

Inertia, equations and joints are those of the state at which accelerations were evaluated last. What the fronts read as
forces, biases and residuals is replaced in the state of the mechanism, which has to be evaluated again afterwards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.recursions.aba import RHS_COLUMN
from solvers.compiled.kernel import kernel

from .assembly import ACCELERATION, POSITION
from .recursion import eliminate, multipliers, recover

if TYPE_CHECKING:
    from mbfmu.mechanics.elimination.eliminated import EliminationData
    from solvers.compiled.record import Reals


@kernel
def subtract_shortest(elimination: EliminationData, r: Reals, drop: float, change: Reals, report: Reals) -> None:
    """change (n,) = -J^+ r in units of the coordinates; r (m,). Equations shorter than ``drop`` are left out."""
    arrays, state, own, memory = elimination.arrays, elimination.state, elimination.own, elimination.memory
    for e in range(own.equations.shape[0]):
        equation = own.equations[e]
        if equation.coupling >= 0:
            state.coupled[equation.coupling].Phi = r[equation.kept]
        else:
            state.rows[equation.row].Phi = r[equation.kept]
    eliminate(POSITION, drop, arrays, state, own, memory, report)
    recover(POSITION, arrays, state, own, memory, change)


@kernel
def solve_motion(
    elimination: EliminationData, forces: Reals, r: Reals, drop: float, a: Reals, lam: Reals, report: Reals
) -> bool:
    """a (n,) and lam (m,) with M a + J^T lam = -forces and J a = -r; False: a motion has no mass.

    forces (n,); r (m,). Multipliers of equations shorter than ``drop``, which are left out, are zero.
    """
    arrays, state, own, memory = elimination.arrays, elimination.state, elimination.own, elimination.memory
    for k in range(6):
        state.bodies[0].dY[k] = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        for k in range(6):
            here.beta[k], here.pA[k] = 0.0, 0.0
        for k in range(body.nv):
            state.a[body.vi + k], state.D[body.vi + k, RHS_COLUMN] = 0.0, 0.0
            if body.vf >= 0:
                state.Q[body.vi + k] = -forces[body.vf + k]
    for k in range(1, arrays.world[0].states + 1):
        state.Q[state.Q.shape[0] - k] = -forces[forces.shape[0] - k]
    for e in range(own.equations.shape[0]):
        equation = own.equations[e]
        if equation.coupling >= 0:
            state.v[arrays.couplings[equation.coupling].vb] = 1.0
            state.coupled[equation.coupling].bend = -r[equation.kept]  # times the square of this velocity
        else:
            state.rows[equation.row].bias = r[equation.kept]
    if not eliminate(ACCELERATION, drop, arrays, state, own, memory, report):
        return False
    recover(ACCELERATION, arrays, state, own, memory, a)
    multipliers(own, memory, lam)
    return True
