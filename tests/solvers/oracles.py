"""Systems written by hand, with exact motions: four-bar, oscillator, free rigid body.

All share one type of data, an array of parameters, so the solver's kernels are compiled once for all of them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import typeof, types
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from solvers.compiled.kernel import callback
from solvers.compiled.tuple_pointer import pointer_type
from solvers.positions import Positions
from solvers.system import Array, System, Terms

G = 9.81  # m/s^2


DATA = typeof(np.zeros(1))  # a plain array: a type of this module would be pickled into the shared compile cache
TERMS = pointer_type(Terms.allocate(1, 1, 1))
VECTOR = types.float64[::1]
DYNAMICS = types.void(types.float64, VECTOR, VECTOR, DATA, TERMS)
POSITION = types.void(types.float64, VECTOR, DATA, TERMS)
RETRACT = types.void(VECTOR, VECTOR, DATA)
ENERGY = types.float64(types.float64, VECTOR, VECTOR, DATA)


@callback(RETRACT)
def add(q, dq, data):
    for i in range(q.shape[0]):
        q[i] += dq[i]


# --- four-bar: planar chain crank, coupler, rocker; uniform bars; cut joint on the second ground pivot
# -------------
# values: l1, l2, l3, m1, m2, m3, x of the second pivot, copies of the closing rows (redundant)


@callback(DYNAMICS)
def fourbar_dynamics(t, q, v, data, terms):
    x = data
    for i in range(3):
        terms.qdot[i] = v[i]
        terms.h[i] = 0.0
        for j in range(3):
            terms.M[i, j] = 0.0
    for row in range(terms.Phi.shape[0]):
        terms.nu[row] = 0.0
        terms.gamma[row] = 0.0
        terms.Phi[row] = -x[6] if row % 2 == 0 else 0.0
        for j in range(3):
            terms.J[row, j] = 0.0
    # bar b has angle phi_b = q_0 + .. + q_b; its center sits at sum over bars c <= b of r_bc (cos, sin) phi_c
    for b in range(3):
        for i in range(b + 1):
            for j in range(b + 1):
                terms.M[i, j] += x[3 + b] * x[b] ** 2 / 12.0
        phi_c = 0.0
        wc = 0.0
        for c in range(b + 1):
            phi_c += q[c]
            wc += v[c]
            rc = 0.5 * x[c] if c == b else x[c]
            for i in range(c + 1):
                terms.h[i] += x[3 + b] * G * rc * np.cos(phi_c)
            phi_d = 0.0
            wd = 0.0
            for d in range(b + 1):
                phi_d += q[d]
                wd += v[d]
                rd = 0.5 * x[d] if d == b else x[d]
                for i in range(c + 1):
                    for j in range(d + 1):
                        terms.M[i, j] += x[3 + b] * rc * rd * np.cos(phi_c - phi_d)
                    terms.h[i] += x[3 + b] * rc * rd * np.sin(phi_c - phi_d) * wd * wd
    phi = 0.0
    w = 0.0
    for b in range(3):
        phi += q[b]
        w += v[b]
        for row in range(terms.Phi.shape[0]):
            along = np.cos(phi) if row % 2 == 0 else np.sin(phi)
            across = -np.sin(phi) if row % 2 == 0 else np.cos(phi)
            terms.Phi[row] += x[b] * along
            terms.gamma[row] += x[b] * along * w * w
            for j in range(b + 1):
                terms.J[row, j] += x[b] * across


@callback(POSITION)
def fourbar_position(t, q, data, terms):
    x = data
    for row in range(terms.Phi.shape[0]):
        terms.Phi[row] = -x[6] if row % 2 == 0 else 0.0
        for j in range(3):
            terms.J[row, j] = 0.0
    phi = 0.0
    for b in range(3):
        phi += q[b]
        for row in range(terms.Phi.shape[0]):
            terms.Phi[row] += x[b] * (np.cos(phi) if row % 2 == 0 else np.sin(phi))
            for j in range(b + 1):
                terms.J[row, j] += x[b] * (-np.sin(phi) if row % 2 == 0 else np.cos(phi))


@callback(ENERGY)
def fourbar_energy(t, q, v, data):
    x = data
    total = 0.0
    py, vx, vy, phi, w = 0.0, 0.0, 0.0, 0.0, 0.0
    for b in range(3):
        phi += q[b]
        w += v[b]
        cx = vx - 0.5 * x[b] * np.sin(phi) * w
        cy = vy + 0.5 * x[b] * np.cos(phi) * w
        total += 0.5 * x[3 + b] * (cx * cx + cy * cy) + x[3 + b] * x[b] ** 2 / 24.0 * w * w
        total += x[3 + b] * G * (py + 0.5 * x[b] * np.sin(phi))
        vx -= x[b] * np.sin(phi) * w
        vy += x[b] * np.cos(phi) * w
        py += x[b] * np.sin(phi)
    return total


def fourbar(rocker_mass: float = 1.0, redundant: bool = False) -> System:
    """Parallelogram: cranks 1 m, coupler 3 m and 3 kg."""
    values = np.array([1.0, 3.0, 1.0, 1.0, 3.0, rocker_mass, 3.0])
    m = 4 if redundant else 2
    return System(
        nq=3, n=3, m=m, data=values, dynamics=fourbar_dynamics, position=fourbar_position, motion=fourbar_dynamics,
        retract=add, energy=fourbar_energy, size=np.ones(3), row_size=np.full(m, 3.0),
    )  # fmt: skip


def fourbar_q(theta: float) -> Array:
    """Relative angles at crank angle theta: coupler horizontal, rocker hanging back to its pivot."""
    return np.array([theta, -theta, theta + np.pi])


def fourbar_v(rate: float) -> Array:
    """Relative velocities at crank rate ``rate``."""
    return np.array([rate, -rate, rate])


@lru_cache
def pendulum(theta: float = np.radians(10.0), rate: float = 0.0, rocker_mass: float = 1.0, end: float = 10.0):
    """Exact crank angle and rate as a function of time: (I1 + I3 + m_c l^2) th'' = -(m1/2 + m3/2 + m_c) g l
    cos th.
    """
    inertia, weight = (1.0 + rocker_mass) / 3.0 + 3.0, (1.0 + rocker_mass) / 2.0 + 3.0

    def slope(t, y):
        return [y[1], -weight * G * np.cos(y[0]) / inertia]

    return solve_ivp(slope, (0.0, end), [theta, rate], method="DOP853", rtol=1e-13, atol=1e-13, dense_output=True).sol


@lru_cache
def singular_times(theta: float = np.radians(10.0), end: float = 10.0) -> tuple[float, ...]:
    """When the crank is horizontal."""
    exact = pendulum(theta, end=end)
    grid = np.linspace(0.0, end, 4001)
    sines = np.sin(exact(grid)[0])
    return tuple(
        brentq(lambda t: np.sin(exact(t)[0]), grid[i], grid[i + 1], xtol=1e-15)
        for i in np.flatnonzero(sines[:-1] * sines[1:] < 0.0)
    )


# --- particle on a line: values are stiffness, time from which forces are NaN, coefficient of a force 6 q^2 ----------


@callback(DYNAMICS)
def particle_dynamics(t, q, v, data, terms):
    x = data
    terms.qdot[0] = v[0]
    terms.M[0, 0] = 1.0
    terms.h[0] = x[0] * q[0] - 6.0 * x[2] * q[0] * q[0]
    if t > x[1]:
        terms.h[0] = np.nan


@callback(POSITION)
def unconstrained(t, q, data, terms):
    pass


@callback(ENERGY)
def particle_energy(t, q, v, data):
    return 0.5 * v[0] * v[0] + 0.5 * data[0] * q[0] * q[0]


def particle(stiffness: float = 0.0, nan_from: float = np.inf, blow_up: float = 0.0) -> System:
    """Oscillator of unit mass; with ``blow_up`` = 1 and q = v/2 = 1 its motion is 1 / (1 - t)^2."""
    return System(
        nq=1,
        n=1,
        m=0,
        data=np.array([stiffness, nan_from, blow_up]),
        dynamics=particle_dynamics,
        position=unconstrained,
        motion=particle_dynamics,
        retract=add,
        energy=particle_energy,
        size=np.ones(1),
        row_size=np.zeros(0),
    )


# --- free rigid body about its center: q a unit quaternion (body to space), v the angular velocity in the body -------


@callback(DYNAMICS)
def body_dynamics(t, q, v, data, terms):
    x = data
    terms.qdot[0] = 0.5 * (-q[1] * v[0] - q[2] * v[1] - q[3] * v[2])
    terms.qdot[1] = 0.5 * (q[0] * v[0] + q[2] * v[2] - q[3] * v[1])
    terms.qdot[2] = 0.5 * (q[0] * v[1] + q[3] * v[0] - q[1] * v[2])
    terms.qdot[3] = 0.5 * (q[0] * v[2] + q[1] * v[1] - q[2] * v[0])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for column in range(3):
            terms.M[i, column] = x[i] if column == i else 0.0
        terms.h[i] = (x[k] - x[j]) * v[j] * v[k]


@callback(RETRACT)
def turn(q, dq, data):
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = 0.5 * dq[0], 0.5 * dq[1], 0.5 * dq[2]
    q[0] = w - x * a - y * b - z * c
    q[1] = x + w * a + y * c - z * b
    q[2] = y + w * b + z * a - x * c
    q[3] = z + w * c + x * b - y * a
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= length


@callback(ENERGY)
def body_energy(t, q, v, data):
    return 0.5 * (data[0] * v[0] ** 2 + data[1] * v[1] ** 2 + data[2] * v[2] ** 2)


INERTIA = np.array([1.0, 2.0, 3.0])  # kg m^2


def rigid_body() -> System:
    """Free rotation of an asymmetric body."""
    return System(
        nq=4,
        n=3,
        m=0,
        data=INERTIA,
        dynamics=body_dynamics,
        position=unconstrained,
        motion=body_dynamics,
        retract=turn,
        energy=body_energy,
        size=np.ones(3),
        row_size=np.zeros(0),
        positions=Positions(*(np.zeros(size, np.int64) for size in (0, 0, (1, 2), 0))),
    )


def angular_momentum(q: Array, v: Array) -> Array:
    """Angular momentum in space, constant."""
    w, r = q[0], q[1:]
    L = INERTIA * v
    return L + 2.0 * w * np.cross(r, L) + 2.0 * np.cross(r, np.cross(r, L))
