"""Derivatives of x' and of the outputs along one direction of states and inputs, exact by complex steps of the state.

With p = P(x) = (q, v), J+ the pseudoinverse of J in the units of the coordinates, and changes dq, dv of the states and
du of the inputs (see :mod:`.model_exchange` for P and x')::

    xi  = dq - J+ Phi'[dq, du]                                      change of the positions of p
    eta = dv - J+ (J v' - nu)[xi, du],  v' = v + dv                 change of its velocities
    M da + J^T dlam = -(M a + h + J^T lam)'[xi, eta, du]            changes of accelerations and multipliers
    J da            = -(J a - gamma)'[xi, eta, du]
    dy  = h'[xi, eta, da, dlam, du]

The brackets are the recursions of inverse dynamics on a complex state with an imaginary step along the direction; the
matrices are those of p, factored once for all directions. Motions of supports by inputs are such steps of the driven
coordinates. Other inputs are parameters of the recursions, see :mod:`.load_derivatives`.

Off the constraints x and p differ by d = |x - p|, and the derivative of P is that at p: the result has a relative error
O(d).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.dispatch import read_sensor
from mbfmu.mechanics.records import empty_data, to_complex_state
from mbfmu.mechanics.recursions.applied import apply_loads
from mbfmu.mechanics.recursions.constraints import evaluate_constraints
from mbfmu.mechanics.recursions.dynamics import (
    evaluate_position_rate,
    gather_free,
    update_acceleration_level,
)
from mbfmu.mechanics.recursions.energy import kinetic_energy, potential_energy
from mbfmu.mechanics.recursions.kinematics import (
    rotate_inertia,
    scatter_coordinates,
    update_positions,
    update_velocities,
)
from mbfmu.mechanics.spatial import dot6
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, Table, f8, i8
from solvers.positions import as_motion, as_slope
from solvers.projection.products import PRODUCT_STEP_SIZE
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords
    from mbfmu.mechanics.records import Arrays, Data, State
    from solvers.compiled.record import Reals
    from solvers.positions import Positions

    from .exchange_memory import Exchange

CONSTRAINTS, MOTION, OUTPUTS = range(3)  # what is evaluated on complex numbers, each after those before it
LINEAR_LOAD, NONLINEAR_LOAD = -1, -2  # inputs that move no joint: the equations are linear in them, or may not be
NOTHING, INPUTS, TIME = range(3)  # what driven coordinates change with: inputs do so at once in model exchange only
Complex = Any  # an array of complex numbers; the recursions declare real ones


class PointRecord(Record):
    """Where derivatives are taken."""

    t: f8  # s
    driving: i8  # what driven coordinates change with: NOTHING, INPUTS, or TIME
    conservative: i8  # 1: the energy error is the change of the energy
    attraction: f8  # 1/s, kappa of the slope of the states
    fastest: i8  # velocity that decides it; -1: none does


class Linearization(NamedTuple):
    """A point, a direction, and the derivatives along it.

    Attributes
    ----------
    data
        The arrays of the mechanism, with kernels for a complex state, and such a state.
    signals
        (inputs,) number of the signal of each input that moves joints; LINEAR_LOAD or NONLINEAR_LOAD: another input.
    point, q, v, a, lam
        The point: (1,), (nq,), (n,), (n,) accelerations and (m,) multipliers.
    states, inputs
        (nq + n,) and (inputs,) direction.
    slopes, outputs
        (nq + n,) and (outputs,) derivatives of x' and of the outputs along the direction.
    positions, velocities, accelerations, multipliers
        (n,), (n,), (n,) and (m,) changes along the direction: xi, eta, da and dlam.
    loads, before, observed, redundant
        (n,) derivative of M a + h + J^T lam by forces that are inputs; (inputs,) their values; (outputs,) and (m,)
        scratch.
    quotients, previous, estimates, changes
        (n + outputs,) scratch of :mod:`.load_derivatives`.
    qc, vc, ac, lamc, qdotc, tauc, gaps, rates, residuals, outc
        Complex: state, accelerations, multipliers; then q', M a + h + J^T lam, Phi, J v - nu, J a - gamma, outputs.
    """

    data: Any  # mbfmu.mechanics.records.Data, pinned
    signals: NDArray[np.int64]
    point: Table[PointRecord]
    q: Array
    v: Array
    a: Array
    lam: Array
    states: Array
    inputs: Array
    slopes: Array
    outputs: Array
    positions: Array
    velocities: Array
    accelerations: Array
    multipliers: Array
    loads: Array
    before: Array
    observed: Array
    redundant: Array
    quotients: Array
    previous: Array
    estimates: Array
    changes: Array
    qc: Complex
    vc: Complex
    ac: Complex
    lamc: Complex
    qdotc: Complex
    tauc: Complex
    gaps: Complex
    rates: Complex
    residuals: Complex
    outc: Complex

    @staticmethod
    def allocate(data: Any, signals: NDArray[np.int64], nq: int, n: int, m: int, outputs: int) -> Linearization:
        """Return zeroed memory for a mechanism of ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        z, u = np.zeros, len(signals)
        point = z(nq), z(n), z(n), z(m)
        direction = z(nq + n), z(u), z(nq + n), z(outputs), z(n), z(n), z(n), z(m), z(n), z(u), z(outputs), z(m)
        differences = (z(n + outputs) for _ in range(4))
        steps = (z(count, complex) for count in (nq, n, n, m, nq, n, m, m, m, outputs))
        return Linearization._make((data, signals, PointRecord.zeros(1), *point, *direction, *differences, *steps))

    @staticmethod
    def example(data: Data) -> Linearization:
        """Return memory of the types that every mechanism has; ``data`` has a complex state."""
        return Linearization.allocate(data, np.zeros(1, np.int64), 1, 1, 1, 1)


def to_linearized(data: Data, kernels: NDArray[np.int64]) -> Data:
    """Return the same arrays with other addresses of kernels, and a complex state."""
    return data._replace(arrays=data.arrays._replace(kernels=kernels), state=to_complex_state(data.state))


def empty_linearized() -> Data:
    """Return data of the types that every mechanism has."""
    data = empty_data()
    return to_linearized(data, data.arrays.kernels.copy())


@kernel
def set_point(t: float, driving: int, q: Reals, v: Reals, a: Reals, lam: Reals, own: Linearization) -> None:
    """Take derivatives at the solution (q, v, a, lam) of time t, s."""
    own.point[0].t, own.point[0].driving = t, driving
    for i in range(q.shape[0]):
        own.q[i] = q[i]
    for i in range(v.shape[0]):
        own.v[i], own.a[i] = v[i], a[i]
    for i in range(lam.shape[0]):
        own.lam[i] = lam[i]


@inlined
def imaginary(number: Any) -> float:
    """The derivative in the imaginary part of a number."""
    part: float = number.imag / PRODUCT_STEP_SIZE
    return part


@inlined
def step_driven_coordinates(inputs: InputRecords, arrays: Arrays, state: State, own: Linearization) -> None:
    """Add the imaginary step of the inputs, or of time, to the motion of the driven coordinates."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.drive < 0:
            continue
        if own.point[0].driving == TIME:
            state.q[body.qi] += 1j * PRODUCT_STEP_SIZE * state.v[body.vi]
            state.v[body.vi] += 1j * PRODUCT_STEP_SIZE * state.a[body.vi]
            continue
        for k in range(own.signals.shape[0]):
            if own.signals[k] == body.drive:
                step = 1j * PRODUCT_STEP_SIZE * own.inputs[k]
                if inputs.inputs[k].coefficient == 0:
                    state.q[body.qi] += step
                elif inputs.inputs[k].coefficient == 1:
                    state.v[body.vi] += step
                else:
                    state.a[body.vi] += step


@inlined
def fill_constraint_level(arrays: Arrays, state: State, own: Linearization) -> None:
    """Fill Phi and J v - nu."""
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        A, B = state.bodies[cut.a], state.bodies[cut.b]
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                here = state.rows[r]
                own.gaps[row], own.rates[row] = here.Phi, dot6(here.Ga, A.Y) + dot6(here.Gb, B.Y)
    for i in range(arrays.couplings.shape[0]):
        coupling, bent = arrays.couplings[i], state.coupled[i]
        row = arrays.kept[coupling.row]
        if row >= 0:
            own.gaps[row], own.rates[row] = bent.Phi, state.v[coupling.va] - bent.slope * state.v[coupling.vb]


@inlined
def fill_acceleration_level(arrays: Arrays, state: State, own: Linearization) -> None:
    """Fill J a - gamma."""
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        A, B = state.bodies[cut.a], state.bodies[cut.b]
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                here = state.rows[r]
                own.residuals[row] = dot6(here.Ga, A.dY) + dot6(here.Gb, B.dY) + here.bias
    for i in range(arrays.couplings.shape[0]):
        coupling, bent = arrays.couplings[i], state.coupled[i]
        row = arrays.kept[coupling.row]
        if row >= 0:
            v = state.v[coupling.vb]
            own.residuals[row] = state.a[coupling.va] - bent.slope * state.a[coupling.vb] - bent.bend * v * v


@kernel
def evaluate_complex(inputs: InputRecords, level: int, own: Linearization) -> None:
    """Evaluate the equations at the complex state, up to CONSTRAINTS, MOTION or OUTPUTS."""
    arrays, state, t = own.data.arrays, own.data.state, own.point[0].t
    scatter_coordinates(t, own.qc, own.vc, arrays, state)
    if own.point[0].driving != NOTHING:
        step_driven_coordinates(inputs, arrays, state, own)
    update_positions(arrays, state)
    update_velocities(arrays, state)
    evaluate_constraints(arrays, state)
    fill_constraint_level(arrays, state, own)
    if level == CONSTRAINTS:
        return
    rotate_inertia(arrays, state)
    apply_loads(t, arrays, state)
    update_acceleration_level(own.ac, own.lamc, arrays, state)
    gather_free(state.tau, arrays, own.tauc)
    fill_acceleration_level(arrays, state, own)
    evaluate_position_rate(arrays, own.qc, own.vc, own.qdotc)
    if level == MOTION:
        return
    state.energy[0], state.energy[1] = kinetic_energy(arrays, state), potential_energy(arrays, state)
    for i in range(own.outc.shape[0]):
        own.outc[i] = read_sensor(arrays.sensors[i], own.lamc, arrays, state)


@kernel
def step_state(positions: Positions, dq: Reals, dv: Reals, own: Linearization) -> None:
    """The complex state is the point with an imaginary step along dq (n,) and dv (n,)."""
    step = 1j * PRODUCT_STEP_SIZE
    as_slope(own.q, dq, positions, own.slopes)
    for i in range(own.q.shape[0]):
        own.qc[i] = own.q[i] + step * own.slopes[i]
    for i in range(own.v.shape[0]):
        own.vc[i], own.ac[i] = own.v[i] + step * dv[i], own.a[i]
    for i in range(own.lam.shape[0]):
        own.lamc[i] = own.lam[i]


@kernel
def step_solution(positions: Positions, own: Linearization) -> None:
    """As :func:`step_state` along the changes that were found, also of the accelerations and multipliers."""
    step = 1j * PRODUCT_STEP_SIZE
    step_state(positions, own.positions, own.velocities, own)
    for i in range(own.a.shape[0]):
        own.ac[i] = own.a[i] + step * own.accelerations[i]
    for i in range(own.lam.shape[0]):
        own.lamc[i] = own.lam[i] + step * own.multipliers[i]


@kernel
def begin_direction(exchange: Exchange, positions: Positions, own: Linearization) -> None:
    """Turn the direction of the states into motions dq and dv; components along a quaternion have no effect on P."""
    nq = own.q.shape[0]
    for i in range(nq):
        own.slopes[i] = own.states[i]
    for k in range(positions.turning.shape[0]):
        first, norm = positions.turning[k, 0], quaternion_norm(exchange.x, positions.turning[k, 0])
        for i in range(first, first + 4):
            own.slopes[i] /= norm
    as_motion(own.q, own.slopes, positions, own.positions)
    for i in range(own.v.shape[0]):
        own.velocities[i] = own.states[nq + i]


@inlined
def quaternion_norm(x: Reals, first: int) -> float:
    """Length of a quaternion."""
    square = 0.0
    for i in range(first, first + 4):
        square += x[i] * x[i]
    return float(np.sqrt(square))


@kernel
def finish_direction(exchange: Exchange, positions: Positions, own: Linearization) -> None:
    """Fill ``slopes``, and ``outputs`` but for the part of :mod:`.load_derivatives`, from the complex evaluation."""
    nq, x, here = own.q.shape[0], exchange.x, own.point[0]
    kappa, change = here.attraction, 0.0
    if here.fastest >= 0:
        k = here.fastest
        change = kappa / own.v[k] * own.velocities[k]
    for i in range(nq):
        p, dp, slope = own.q[i], imaginary(own.qc[i]), imaginary(own.qdotc[i])
        own.slopes[i] = slope - change * (x[i] - p) - kappa * (own.states[i] - dp)
    for k in range(positions.turning.shape[0]):
        first, norm = positions.turning[k, 0], quaternion_norm(x, positions.turning[k, 0])
        growth = 0.0
        for i in range(first, first + 4):
            growth += x[i] * own.states[i] / norm
        for i in range(first, first + 4):
            p, dp = norm * own.q[i], growth * own.q[i] + norm * imaginary(own.qc[i])
            slope = growth * own.qdotc[i].real + norm * imaginary(own.qdotc[i])
            own.slopes[i] = slope - change * (x[i] - p) - kappa * (own.states[i] - dp)
    for i in range(own.v.shape[0]):
        off = change * (x[nq + i] - own.v[i]) + kappa * (own.states[nq + i] - own.velocities[i])
        own.slopes[nq + i] = own.accelerations[i] - off
    for i in range(own.outputs.shape[0]):
        own.outputs[i] += imaginary(own.outc[i])
    last = own.outputs.shape[0] - 1
    own.outputs[last] = 0.0  # the energy that was exchanged is not known
    if here.conservative == 0:
        own.outputs[last - 1] = 0.0


@kernel
def differentiate_motion(inputs: InputRecords, positions: Positions, own: Linearization) -> None:
    """Fill ``outputs`` with the derivatives by time of outputs that depend on positions and velocities alone."""
    for i in range(own.v.shape[0]):
        own.positions[i], own.velocities[i], own.accelerations[i] = own.v[i], own.a[i], 0.0
    for i in range(own.lam.shape[0]):
        own.multipliers[i] = 0.0
    driving, own.point[0].driving = own.point[0].driving, TIME
    step_solution(positions, own)
    evaluate_complex(inputs, OUTPUTS, own)
    own.point[0].driving = driving
    for i in range(own.outputs.shape[0]):
        own.outputs[i] = imaginary(own.outc[i])
