"""The benchmark bicycle in large motions, against Newton and Euler's equations of its four bodies by SciPy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.verification.problems.bicycle import FRONT_RADIUS, REAR_RADIUS, TILT, TRAIL, WHEEL_BASE, bicycle

G = 9.81
DOWN = np.array((0.0, 0.0, 1.0))
Y = np.array((0.0, 1.0, 0.0))
STEER = np.array((np.sin(TILT), 0.0, np.cos(TILT)))


class RigidBody(NamedTuple):
    """Mass (kg), inertia about the center of mass (kg m^2), and the center of mass in the frame of the model (m)."""

    mass: float
    inertia: Any
    com: Any


REAR_FRAME = RigidBody(85.0, np.array(((9.2, 0, 2.4), (0, 11.0, 0), (2.4, 0, 2.8))), np.array((0.3, 0.0, -0.6)))
FORK_INERTIA = np.array(((0.05892, 0, -0.00756), (0, 0.06, 0), (-0.00756, 0, 0.00708)))
FORK = RigidBody(4.0, FORK_INERTIA, np.array((0.9 - WHEEL_BASE - TRAIL, 0.0, -0.7)))
REAR = RigidBody(2.0, np.diag((0.0603, 0.12, 0.0603)), np.zeros(3))
FRONT = RigidBody(3.0, np.diag((0.1405, 0.28, 0.1405)), np.zeros(3))
NAMES, BODIES = ("frame", "rear wheel", "fork", "front wheel"), (REAR_FRAME, REAR, FORK, FRONT)
# joints: bodies a and b, point in both frames of the model, axis in both
HINGES = (
    (0, 1, np.zeros(3), np.zeros(3), Y),
    (0, 2, np.array((WHEEL_BASE + TRAIL, 0.0, REAR_RADIUS)), np.zeros(3), STEER),
    (2, 3, np.array((-TRAIL, 0.0, -FRONT_RADIUS)), np.zeros(3), Y),
)
WHEELS = ((1, REAR_RADIUS), (3, FRONT_RADIUS))


def skew(x: Any) -> Any:
    """Return the matrix of the cross product by x."""
    return np.array(((0.0, -x[2], x[1]), (x[2], 0.0, -x[0]), (-x[1], x[0], 0.0)))


def constraints(A: Any, w: Any) -> tuple[Any, Any]:
    """Return J (21, 24) and gamma (21,) of J (v', w') = gamma at rotations A and angular velocities w; v is that of the
    centers of mass.
    """
    J, gamma, row = np.zeros((21, 24)), np.zeros(21), 0
    for a, b, in_a, in_b, axis in HINGES:
        for body, point, sign in ((a, in_a, -1.0), (b, in_b, 1.0)):
            p = A[body] @ (point - BODIES[body].com)
            J[row : row + 3, 6 * body : 6 * body + 3] += sign * np.eye(3)
            J[row : row + 3, 6 * body + 3 : 6 * body + 6] -= sign * skew(p)
            gamma[row : row + 3] -= sign * np.cross(w[body], np.cross(w[body], p))
        for across in np.linalg.svd(axis[None])[2][1:]:
            f = A[a] @ across
            J[row + 3, 6 * b + 3 : 6 * b + 6], J[row + 3, 6 * a + 3 : 6 * a + 6] = f, -f
            gamma[row + 3] = -(w[b] - w[a]) @ np.cross(w[a], f)
            row += 1
        row += 3
    for k, radius in WHEELS:
        e = A[k][:, 1]
        de = np.cross(w[k], e)
        along, d_along = DOWN - (DOWN @ e) * e, -(DOWN @ de) * e - (DOWN @ e) * de
        size = np.linalg.norm(along)
        r = radius * along / size
        dr = radius * (d_along / size - along * (along @ d_along) / size**3)
        J[row : row + 3, 6 * k : 6 * k + 3], J[row : row + 3, 6 * k + 3 : 6 * k + 6] = np.eye(3), -skew(r)
        gamma[row : row + 3] = -np.cross(w[k], dr)
        row += 3
    return J, gamma


def split(x: Any) -> tuple[Any, Any, Any, Any]:
    """Return positions, rotations, velocities and angular velocities of the four bodies from the state (52,)."""
    parts = x.reshape(4, 13)
    A = Rotation.from_quat(parts[:, 3:7], scalar_first=True).as_matrix()
    return parts[:, :3], A, parts[:, 7:10], parts[:, 10:]


def slopes(_: float, x: Any) -> Any:
    """Return the derivative of the state: center of mass, quaternion, velocity, angular velocity of every body."""
    _, A, v, w = split(x)
    J, gamma = constraints(A, w)
    M, force = np.zeros((24, 24)), np.zeros(24)
    for k, body in enumerate(BODIES):
        inertia, i = A[k] @ body.inertia @ A[k].T, 6 * k
        M[i : i + 3, i : i + 3], M[i + 3 : i + 6, i + 3 : i + 6] = body.mass * np.eye(3), inertia
        force[i : i + 3], force[i + 3 : i + 6] = body.mass * G * DOWN, -np.cross(w[k], inertia @ w[k])
    K = np.block([[M, J.T], [J, np.zeros((21, 21))]])
    a = np.linalg.solve(K, np.concatenate((force, gamma)))[:24].reshape(4, 6)
    rates = np.zeros((4, 13))
    e = x.reshape(4, 13)[:, 3:7]
    rates[:, :3], rates[:, 7:10], rates[:, 10:] = v, a[:, :3], a[:, 3:]
    rates[:, 3] = -0.5 * np.sum(w * e[:, 1:], axis=1)
    rates[:, 4:7] = 0.5 * (e[:, :1] * w + np.cross(w, e[:, 1:]))
    return rates.ravel()


def state_of(compiled: CompiledMechanism, q: Any, v: Any) -> Any:
    """Return the state (52,) of the four bodies of the model at positions q and velocities v."""
    compiled.energy(0.0, q, v)
    found = []
    for name, body in zip(NAMES, BODIES, strict=True):
        number = next(b.index for b in compiled.mechanism.bodies if b.name == name)
        here = compiled.data.state.bodies[number]
        at = here["A"] @ body.com
        w = here["Y"][3:]
        turn = Rotation.from_matrix(here["A"]).as_quat(scalar_first=True)
        found.append(np.concatenate((here["r"] + at, turn, here["Y"][:3] + np.cross(w, at), w)))
    return np.concatenate(found)


def test_a_bicycle_that_is_pushed_over_follows_newton_and_euler() -> None:
    """It starts at 4.6 m/s, where it is stable, with a lean rate of 1.5 rad/s, and turns by more than a radian."""
    m = bicycle(4.6, 1.5)
    compiled = CompiledMechanism(m)
    q, v = compiled.assemble(0.0)
    x = state_of(compiled, q, v)
    _, A, _, w = split(x)
    J = constraints(A, w)[0]
    assert np.abs(J @ np.concatenate([part[7:] for part in x.reshape(4, 13)])).max() < 1e-12
    exact = solve_ivp(slopes, (0.0, 2.0), x, "DOP853", rtol=1e-10, atol=1e-11)
    end = split(exact.y[:, -1])
    m = bicycle(4.6, 1.5)
    names = [f"{axis}{k}" for k in range(4) for axis in "xyz"]
    bodies = {body.name: body for body in m.bodies}
    for k, (name, body) in enumerate(zip(NAMES, BODIES, strict=True)):
        for axis in "xyz":
            m.output(f"{axis}{k}", bodies[name].position(axis, body.com))
    for solver in ("adams", "hybrid", "radau", "ida"):
        result = mb.simulate(m, 2.0, solver=solver, tolerance=1e-9)
        assert not result.warning
        found = np.array([result[name][-1] for name in names]).reshape(4, 3)
        np.testing.assert_allclose(found, end[0], atol=1e-6)
    assert np.abs(result["lean"]).max() > 0.3
    assert np.ptp(result["energy"]) < 1e-6 * result["energy"][0]
