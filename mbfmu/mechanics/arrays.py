"""The flat arrays a mechanism compiles to: what is constant, and what moves.

Two types, passed to every kernel. :class:`Arrays` describes the mechanism and does not change while it moves (inputs
and tunable parameters are written between steps). :class:`State` is scratch and result of the recursions, allocated
once. Body 0 is the ground, so no recursion asks whether a body has a parent, and parents come before children.

Vectors are in global axes unless a name ends in ``_local``; a motion or wrench is one 6-vector, linear part first, and
a body's is taken at that body's origin. SI units throughout.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.kernel import records

from .elastic.modal import MODES

BODY = np.dtype(
    [
        ("parent", np.int64),  # index of the parent; parents come first
        ("joint", np.int64),  # kind of the tree joint to the parent (joints.REGISTRY)
        ("nq", np.int64),  # positions and velocities of the joint
        ("nv", np.int64),
        ("qi", np.int64),  # where they start in State.q and State.v
        ("vi", np.int64),
        ("si", np.int64),  # ... in State.S
        ("qf", np.int64),  # where they start in the solver's free q and v; -1: driven
        ("vf", np.int64),
        ("quaternion", np.int64),  # 1: the last four positions are a unit quaternion
        ("drive", np.int64),  # signal that gives the coordinate; -1: free
        ("node", np.int64),  # node of an elastic body; -1: rigid. Its coordinates are shared by all nodes of that body
        ("mass", np.float64),  # kg
        ("com", np.float64, (3,)),  # centre of mass from the body's origin, body axes, m
        ("inertia", np.float64, (3, 3)),  # about the centre of mass, body axes, kg m^2
        ("s", np.float64, (3,)),  # joint frame in the parent: origin s'_j, m
        ("R", np.float64, (3, 3)),  # ... and axes
        ("axis", np.float64, (3,)),  # axis of the joint in the joint frame (Joint.direction)
    ],
    align=True,
)

CUT = np.dtype(
    [
        ("kind", np.int64),  # cuts.REGISTRY
        ("a", np.int64),  # the two bodies
        ("b", np.int64),
        ("row", np.int64),  # first of its rows in State.rows
        ("Pa", np.float64, (3,)),  # point on body a, body axes, m
        ("Pb", np.float64, (3,)),
        ("Ra", np.float64, (3, 3)),  # axes of the cut frame in body a; columns x, y, z
        ("Rb", np.float64, (3, 3)),
        ("length", np.float64),  # distance joint, m
    ],
    align=True,
)

FORCE = np.dtype(
    [
        ("kind", np.int64),  # forces.REGISTRY
        ("a", np.int64),
        ("b", np.int64),
        ("v", np.int64),  # coordinate a joint force acts on: velocity and position index; -1: it acts on bodies
        ("q", np.int64),
        ("signal", np.int64),  # magnitude of an applied force; -1: none
        ("Pa", np.float64, (3,)),  # points of action, body axes, m
        ("Pb", np.float64, (3,)),
        ("axis", np.float64, (3,)),  # direction of an applied force or torque
        ("stiffness", np.float64),  # N/m or N m/rad
        ("damping", np.float64),  # N s/m or N m s/rad
        ("free", np.float64),  # free length or angle, m or rad
        ("section", np.float64, (4,)),  # of a beam: stretching, N, torsion, bending along y and z, N m^2
    ],
    align=True,
)

SIGNAL = np.dtype(
    [
        ("kind", np.int64),  # signals.POLYNOMIAL, HARMONIC or RUN_UP
        ("t0", np.float64),  # s
        ("c", np.float64, (4,)),  # coefficients, see signals
    ],
    align=True,
)

SENSOR = np.dtype(
    [
        ("kind", np.int64),  # sensors.Kind
        ("index", np.int64),  # body, coordinate or constraint row
        ("component", np.int64),
        ("point", np.float64, (3,)),  # body axes, m
    ],
    align=True,
)

PLATE = np.dtype(
    [
        ("node", np.int64, (4,)),  # bodies at the corners 1 (0, 0), 2 (a, 0), 3 (a, b), 4 (0, b)
        ("membrane", np.int64),  # 1: resists stretching in its plane
        ("damped", np.int64),  # 1: has material damping
        ("a", np.float64),  # sides along x and z of the element, m
        ("b", np.float64),
        ("bending", np.float64, (9,)),  # stiffness by generalised strains 0 ... 8, see elastic.plate
        ("coupling", np.float64),  # ... between the first four pairs
        ("stretching", np.float64, (4,)),  # by E_xx, E_zz, between these two, by gamma; N m
        ("damping", np.float64),  # beta of stress = K (e + beta e'), s
    ],
    align=True,
)

DRAG = np.dtype(
    [
        ("node", np.int64, (4,)),  # bodies at the corners, as those of a plate
        ("coefficient", np.float64),  # rho c a b / 2, kg/m
    ],
    align=True,
)

ELASTIC = np.dtype(  # a slender body by its modes, see elastic.modal; everything about the origin of its frame
    [
        ("body", np.int64),  # its first node: the frame
        ("modes", np.int64),
        ("qi", np.int64),  # the amplitudes in State.q and State.v
        ("vi", np.int64),
        ("shortens", np.int64),  # 0: no geometric stiffening, else the number of modes
        ("mass", np.float64),  # kg
        ("X1", np.float64),  # kg m, first and second moment along the axis
        ("X2", np.float64),  # kg m^2
        ("a", np.float64, (MODES,)),  # kg, momentum of a mode
        ("c", np.float64, (MODES,)),  # kg m, its angular momentum about the origin
        ("mu", np.float64, (MODES,)),  # kg, modal mass
        ("kappa", np.float64, (MODES,)),  # N/m, modal stiffness
        ("beta", np.float64),  # s, damping time of the material
        ("g0", np.float64, (MODES, MODES)),  # kg/m, kg: shortening in the first and second moment
        ("g1", np.float64, (MODES, MODES)),
    ],
    align=True,
)

NODE = np.dtype(  # a cross-section of an elastic body
    [
        ("shortens", np.int64),
        ("x", np.float64),  # place on the axis, m
        ("phi", np.float64, (MODES,)),  # deflection of each mode at amplitude 1
        ("slope", np.float64, (MODES,)),  # 1/m, turn
        ("moment", np.float64, (MODES,)),  # N, bending moment per amplitude
        ("G", np.float64, (MODES, MODES)),  # 1/m, shortening from the frame to here
    ],
    align=True,
)

PRESSURE = np.dtype(
    [
        ("node", np.int64, (4,)),  # bodies at the corners, as those of a plate
        ("signal", np.int64),  # Pa
    ],
    align=True,
)

WORLD = np.dtype(
    [
        ("gravity", np.float64, (3,)),  # m/s^2
        ("works", np.int64),  # 1: something does work that is in no potential
        ("drives", np.int64),  # 1: a drive does
    ],
    align=True,
)


class Arrays(NamedTuple):
    """A compiled mechanism."""

    world: NDArray[Any]  # (1,) WORLD
    bodies: NDArray[Any]  # (nb,) BODY, ground first
    cuts: NDArray[Any]  # CUT
    forces: NDArray[Any]  # FORCE
    signals: NDArray[Any]  # SIGNAL
    kept: NDArray[np.int64]  # (rows,) number of a cut-joint row among the constraints; -1: void in this mechanism
    plates: NDArray[Any]  # PLATE
    drags: NDArray[Any]  # DRAG
    elastics: NDArray[Any]  # ELASTIC
    nodes: NDArray[Any]  # NODE
    pressures: NDArray[Any]  # PRESSURE


MOTION = np.dtype(
    [
        ("r", np.float64, (3,)),  # origin, m
        ("A", np.float64, (3, 3)),  # orientation, body to global
        ("Y", np.float64, (6,)),  # velocity (r', w)
        ("dY", np.float64, (6,)),  # acceleration (r'', w'), less gravity
        ("beta", np.float64, (6,)),  # acceleration at q'' = 0 and parent's Y' = 0 (velocity products)
        ("com", np.float64, (3,)),  # centre of mass from the origin, global axes
        ("Jc", np.float64, (3, 3)),  # inertia about the centre of mass, global axes
        ("F", np.float64, (6,)),  # applied wrench
        ("W", np.float64, (6,)),  # wrench the joint transmits from the parent
        ("mass", np.float64),  # composite body: mass, first and second moment about the origin
        ("mc", np.float64, (3,)),
        ("J", np.float64, (3, 3)),
        ("IA", np.float64, (6, 6)),  # articulated inertia
        ("pA", np.float64, (6,)),  # articulated bias wrench
    ],
    align=True,
)

ROW = np.dtype(
    [
        ("Phi", np.float64),  # constraint residual
        ("Ga", np.float64, (6,)),  # Phi' = Ga . Y_a + Gb . Y_b
        ("Gb", np.float64, (6,)),
        ("bias", np.float64),  # Phi'' = Ga . Y'_a + Gb . Y'_b + bias
        ("lam", np.float64),  # multiplier that loaded the bodies last
    ],
    align=True,
)


ELEMENT = np.dtype(  # a plate element at work, everything in element axes; see elastic.plate
    [
        ("E", np.float64, (3, 3)),  # rows: element axes in global axes
        ("g1x", np.float64),  # g1 = (g1x, 0, 0), g2 = (g2x, 0, g2z), m
        ("g2x", np.float64),
        ("g2z", np.float64),
        ("t", np.float64, (3,)),  # how far the corners are from one plane, m
        ("d", np.float64, (4, 3)),  # normals of the bodies
        ("F", np.float64, (4,)),  # theta / sin theta of each and its derivatives by cos theta
        ("dF", np.float64, (4,)),
        ("ddF", np.float64, (4,)),
        ("w", np.float64, (4, 2)),  # slopes along x and z
        ("strain", np.float64, (12,)),
        ("stress", np.float64, (12,)),
        ("f", np.float64, (4, 2)),  # gradient of the energy by the slopes
        ("m", np.float64, (4, 3)),  # ... by the rotations of the bodies
        ("n", np.float64, (3, 3)),  # ... by g1, g2, t
        ("turn", np.float64, (3,)),  # ... by the spin of the element axes
        ("dg", np.float64, (3, 3)),  # differentials along one motion: of g1, g2, t
        ("phi", np.float64, (4, 3)),  # ... rotations of the bodies
        ("omega", np.float64, (3,)),  # ... rotation of the element axes
        ("dd", np.float64, (4, 3)),
        ("dw", np.float64, (4, 2)),
        ("dstrain", np.float64, (12,)),
        ("dstress", np.float64, (12,)),
        ("df", np.float64, (4, 2)),
        ("dm", np.float64, (4, 3)),
        ("dn", np.float64, (3, 3)),
    ],
    align=True,
)


class State(NamedTuple):
    """What the recursions read and write."""

    bodies: NDArray[Any]  # (nb,) MOTION
    rows: NDArray[Any]  # (rows,) ROW
    element: NDArray[Any]  # (1,) ELEMENT, scratch
    S: NDArray[np.float64]  # (subspaces, 6) joint motion subspaces, columns of B2
    q: NDArray[np.float64]  # (nq,) every joint position, driven ones included
    v: NDArray[np.float64]  # (nv,)
    a: NDArray[np.float64]  # (nv,)
    Q: NDArray[np.float64]  # (nv,) forces applied along joint coordinates
    tau: NDArray[np.float64]  # (nv,) inverse dynamics
    rel: NDArray[np.float64]  # (9, 6) one joint at work: rows 0-5 subspace, 6-8 rotation | offset
    wrench: NDArray[np.float64]  # (6,) a wrench on its way inward
    U: NDArray[np.float64]  # (nv, 6) articulated body: (IA S)^T, with the joint's Cholesky factor taken out
    D: NDArray[np.float64]  # (nv, MODES + 1) articulated body: a joint's Cholesky factor, and last its right-hand side
    time: NDArray[np.float64]  # (1,) s, when the forces were applied last
    damped: NDArray[np.float64]  # (1,) W, power of the plates' damping then


class Data(NamedTuple):
    """What a solver passes through to the mechanics."""

    arrays: Arrays
    state: State


def allocate_state(nb: int, rows: int, nq: int, nv: int, subspaces: int) -> State:
    """Return zeroed scratch for ``nb`` bodies (ground included), with the ground placed."""
    state = State(
        records(nb, MOTION),
        records(rows, ROW),
        records(1, ELEMENT),
        *(np.zeros(shape) for shape in ((subspaces, 6), nq, nv, nv, nv, nv, (9, 6), 6, (nv, 6), (nv, MODES + 1), 1, 1)),
    )
    state.bodies["A"][0] = np.eye(3)
    return state


def complex_twin(data: Data) -> Data:
    """Return a copy whose real numbers are complex: the same recursions on it give derivatives by complex step.

    Kernels are written so that each is an analytic function of every real number it reads.
    """
    return Data(Arrays(*map(_complex, data.arrays)), complex_state(data.state))


def complex_state(state: State) -> State:
    """Return a copy whose real numbers are complex."""
    return State(*map(_complex, state))


def _complex(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.names is None:
        return array.astype(complex) if array.dtype == np.float64 else array.copy()
    twin = complex_records(len(array), array.dtype)
    for name in array.dtype.names:
        twin[name] = array[name]
    return twin


def complex_records(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return zeroed records whose real numbers are complex."""
    fields = [(name, *_complex_field(dtype[name])) for name in dtype.names or ()]
    return records(count, np.dtype(fields, align=True))


def _complex_field(dtype: np.dtype[Any]) -> tuple[type, tuple[int, ...]]:
    return (np.complex128 if dtype.base == np.float64 else np.int64), dtype.shape
