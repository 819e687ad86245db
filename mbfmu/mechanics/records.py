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

from mbfmu.mechanics.flexible.modal import FLEXIBLE, MODES, NODE
from solvers.compiled.kernel import records
from solvers.compiled.record_view import COMPLEX_FACTOR, aligned_bytes, complex_dtype

MAX_KERNELS = 5  # most that a role has

RIGID, MODAL, SECTION = 0, 1, 2  # roles of a body: moved by its joint; first section of a flexible body, whose
# amplitudes are its coordinates and do not move it; another section, which shares them

BODY = np.dtype(
    [
        ("role", np.int64),
        ("parent", np.int64),  # index of the parent; parents come first
        ("kind", np.int64),  # where the joint's kernels are in Arrays.kernels; of rigid bodies
        ("at", np.int64),  # where its record is in Arrays.memory
        ("nq", np.int64),  # positions and velocities of the joint
        ("nv", np.int64),
        ("qi", np.int64),  # where they start in State.q and State.v
        ("vi", np.int64),
        ("si", np.int64),  # ... in State.S
        ("qf", np.int64),  # where they start in the solver's free q and v; -1: driven
        ("vf", np.int64),
        ("quaternion", np.int64),  # 1: the last four positions are a unit quaternion
        ("drive", np.int64),  # signal that gives the coordinate; -1: free
        ("node", np.int64),  # of a section: its node; -1: rigid
        ("mass", np.float64),  # kg
        ("com", np.float64, (3,)),  # center of mass from the body's origin, body axes, m
        ("inertia", np.float64, (3, 3)),  # about the center of mass, body axes, kg m^2
        ("s", np.float64, (3,)),  # joint frame in the parent: origin s'_j, m
        ("R", np.float64, (3, 3)),  # ... and axes
    ],
    align=True,
)

CUT = np.dtype(
    [
        ("kind", np.int64),  # where its kernel is
        ("at", np.int64),  # place of its record
        ("a", np.int64),  # the two bodies
        ("b", np.int64),
        ("row", np.int64),  # first of its rows in State.rows
        ("end", np.int64),  # the one after its last
    ],
    align=True,
)

COUPLING = np.dtype(
    [
        ("kind", np.int64),  # where its kernel is
        ("at", np.int64),  # place of its record
        ("a", np.int64),  # the two bodies
        ("b", np.int64),
        ("qa", np.int64),  # where their coordinates are in State.q
        ("qb", np.int64),
        ("va", np.int64),  # ... in State.v
        ("vb", np.int64),
        ("fa", np.int64),  # ... in the solver's free v; -1: driven
        ("fb", np.int64),
        ("row", np.int64),  # number of its row, in Arrays.kept
    ],
    align=True,
)

ITEM = np.dtype([("kind", np.int64), ("at", np.int64)], align=True)  # a load, a signal, a part: kernels and record
SENSOR = np.dtype([("kind", np.int64), ("at", np.int64), ("energy", np.int64)], align=True)  # 1: it reads State.energy

WORLD = np.dtype(
    [
        ("gravity", np.float64, (3,)),  # m/s^2
        ("nonconservative", np.int64),  # 1: there is work that no potential contains
        ("drives", np.int64),  # 1: a drive does
    ],
    align=True,
)


class Arrays(NamedTuple):
    """A compiled mechanism."""

    world: NDArray[Any]  # (1,) WORLD
    bodies: NDArray[Any]  # (nb,) BODY, ground first
    cuts: NDArray[Any]  # CUT
    couplings: NDArray[Any]  # COUPLING
    loads: NDArray[Any]  # ITEM
    signals: NDArray[Any]  # ITEM
    parts: NDArray[Any]  # ITEM, what loads and sensors are made of
    sensors: NDArray[Any]  # SENSOR
    kept: NDArray[np.int64]  # (rows,) number among the constraints, cuts before couplings; -1: trivially satisfied
    residual_scale: NDArray[np.float64]  # (rows,) m: length of the mechanism divided by the unit of the row
    flexibles: NDArray[Any]  # FLEXIBLE
    nodes: NDArray[Any]  # NODE
    kernels: NDArray[np.int64]  # addresses of kernels, KERNELS for each kind that is there; 0: it has none
    memory: NDArray[np.uint8]  # every record of whatever has a kind
    numbers: NDArray[np.float64]  # of tables, which are of any length


MOTION = np.dtype(
    [
        ("r", np.float64, (3,)),  # origin, m
        ("A", np.float64, (3, 3)),  # orientation, body to global
        ("Y", np.float64, (6,)),  # velocity (r', w)
        ("dY", np.float64, (6,)),  # acceleration (r'', w'), less gravity
        ("beta", np.float64, (6,)),  # acceleration at q'' = 0 and parent's Y' = 0 (velocity products)
        ("com", np.float64, (3,)),  # center of mass from the origin, global axes
        ("Jc", np.float64, (3, 3)),  # inertia about the center of mass, global axes
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

COUPLED = np.dtype(
    [
        ("Phi", np.float64),  # q_a - f(q_b)
        ("slope", np.float64),  # f'
        ("bend", np.float64),  # f''
        ("lam", np.float64),  # multiplier that loaded the coordinates last
    ],
    align=True,
)


class State(NamedTuple):
    """What the recursions read and write."""

    bodies: NDArray[Any]  # (nb,) MOTION
    rows: NDArray[Any]  # (constraint equations of cut joints,) ROW
    coupled: NDArray[Any]  # (couplings,) COUPLED
    S: NDArray[np.float64]  # (subspaces, 6) joint motion subspaces, columns of B2
    q: NDArray[np.float64]  # (nq,) every joint position, driven ones included
    v: NDArray[np.float64]  # (nv,)
    a: NDArray[np.float64]  # (nv,)
    Q: NDArray[np.float64]  # (nv,) forces applied along joint coordinates
    tau: NDArray[np.float64]  # (nv,) inverse dynamics
    rel: NDArray[np.float64]  # (9, 6) a joint at work: rows 0-5 subspace, 6-8 rotation | offset
    bias: NDArray[np.float64]  # (6,) what the turning of its subspace adds
    frame: NDArray[np.float64]  # (3, 3) axes of its frame
    product: NDArray[np.float64]  # (3, 3) a product of matrices on its way
    wrench: NDArray[np.float64]  # (6,) a wrench on its way inward
    U: NDArray[np.float64]  # (nv, 6) articulated body: (IA S)^T, with the joint's Cholesky factor taken out
    D: NDArray[np.float64]  # (nv, MODES + 1) articulated body: a joint's Cholesky factor, and last its right-hand side
    scratch: NDArray[np.uint8]  # scratch memory of element types, see mbfmu.mechanics.dispatch.scratch_record
    time: NDArray[np.float64]  # (1,) s, when the forces were applied last
    cached_power: NDArray[np.float64]  # (1,) W, non-conservative power that loads have evaluated with their forces
    energy: NDArray[np.float64]  # (2,) J, kinetic and potential, where sensors are read


class Data(NamedTuple):
    """What a solver passes through to the mechanics."""

    arrays: Arrays
    state: State


def allocate_state(nb: int, rows: int, couplings: int, nq: int, nv: int, subspaces: int, scratch: int) -> State:
    """Return zeroed memory for ``nb`` bodies (ground included), with the ground placed; ``scratch`` is in bytes."""
    z = np.zeros
    state = State(
        bodies=records(nb, MOTION),
        rows=records(rows, ROW),
        coupled=records(couplings, COUPLED),
        S=z((subspaces, 6)),
        q=z(nq),
        v=z(nv),
        a=z(nv),
        Q=z(nv),
        tau=z(nv),
        rel=z((9, 6)),
        bias=z(6),
        frame=z((3, 3)),
        product=z((3, 3)),
        wrench=z(6),
        U=z((nv, 6)),
        D=z((nv, MODES + 1)),
        scratch=aligned_bytes(scratch),
        time=z(1),
        cached_power=z(1),
        energy=z(2),
    )
    state.bodies["A"][0] = np.eye(3)
    return state


def empty_data() -> Data:
    """Return data of a mechanism of one body: an example of the types that every mechanism has."""
    whole = np.zeros(1, np.int64)
    arrays = Arrays(
        world=records(1, WORLD),
        bodies=records(1, BODY),
        cuts=records(1, CUT),
        couplings=records(1, COUPLING),
        loads=records(1, ITEM),
        signals=records(1, ITEM),
        parts=records(1, ITEM),
        sensors=records(1, SENSOR),
        kept=whole,
        residual_scale=np.zeros(1),
        flexibles=records(1, FLEXIBLE),
        nodes=records(1, NODE),
        kernels=np.zeros(MAX_KERNELS, np.int64),
        memory=np.zeros(1, np.uint8),
        numbers=np.zeros(1),
    )
    return Data(arrays, allocate_state(1, 1, 1, 1, 1, 1, 0))


def to_complex_data(data: Data) -> Data:
    """Return a copy whose real numbers are complex: the same recursions on it give derivatives by complex step.

    Kernels are written so that each is an analytic function of every real number it reads. Kernels and memory are those
    of the real one still: :class:`.tables.Tables` has the complex ones.
    """
    return Data(Arrays(*map(to_complex, data.arrays)), to_complex_state(data.state))


def to_complex_state(state: State) -> State:
    """Return a copy whose real numbers are complex."""
    scratch = aligned_bytes(COMPLEX_FACTOR * len(state.scratch))
    arrays: Any = map(to_complex, state)
    return State(*arrays)._replace(scratch=scratch)


def copy_state(state: State) -> State:
    """Return a copy of a state and its arrays."""
    arrays: Any = (array.copy() for array in state)
    return State(*arrays)


def to_complex(array: NDArray[Any]) -> NDArray[Any]:
    """Return a copy whose real numbers are complex."""
    if array.dtype.names is None:
        return array.astype(complex) if array.dtype == np.float64 else array.copy()
    copy = records(len(array), complex_dtype(array.dtype))
    for name in array.dtype.names:
        copy[name] = array[name]
    return copy
