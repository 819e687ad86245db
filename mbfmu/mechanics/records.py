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

from mbfmu.mechanics.flexible.records import FlexibleRecord, NodeRecord
from solvers.compiled.kernel import records
from solvers.compiled.record import Mat3, Mat6, Record, Table, Vec3, Vec6, f8, i8
from solvers.compiled.record_view import COMPLEX_FACTOR, aligned_bytes, complex_dtype

MAX_KERNELS = 8  # most that a role has

NO_JAM = -np.inf  # time of a jam that has not occurred, s
RIGID, MODAL, SECTION = 0, 1, 2  # roles of a body: moved by its joint; first section of a flexible body, whose
# amplitudes are its coordinates and do not move it; another section, which shares them


class BodyRecord(Record):
    """A body and its joint, constant."""

    role: i8
    parent: i8  # index of the parent; parents come first
    kind: i8  # where the joint's kernels are in Arrays.kernels; of rigid bodies
    at: i8  # where its record is in Arrays.memory
    nq: i8  # positions and velocities of the joint
    nv: i8
    qi: i8  # where they start in State.q and State.v
    vi: i8
    si: i8  # ... in State.S
    qf: i8  # where they start in the solver's free q and v; -1: driven
    vf: i8
    quaternion: i8  # 1: the last four positions are a unit quaternion
    drive: i8  # signal that gives the coordinate; -1: free
    node: i8  # of a section: its node; -1: rigid
    attached: i8  # 1: the joint is reversed, or its frame on this body is not the body's frame; see child_frame
    reversed: i8  # 1: the second frame of the joint is in the parent
    armature: f8  # inertia of a drive's rotor as seen at the joint, kg m^2 or kg
    lever: f8  # of loads with a clearance, see mbfmu.mechanics.recursions.active_loads, m; -1: none depends on the body
    mass: f8  # kg
    com: Vec3  # center of mass from the body's origin, body axes, m
    inertia: Mat3  # about the center of mass, body axes, kg m^2
    s: Vec3  # joint frame in the parent: origin s'_j, m
    R: Mat3  # ... and axes
    child_s: Vec3  # joint frame in the body: origin, m
    child_R: Mat3  # ... and axes


class CutRecord(Record):
    """A cut joint, constant."""

    kind: i8  # where its kernel is
    at: i8  # place of its record
    a: i8  # the two bodies
    b: i8
    row: i8  # first of its rows in State.rows
    end: i8  # the one after its last


class CouplingRecord(Record):
    """A coupling, constant."""

    kind: i8  # where its kernel is
    at: i8  # place of its record
    a: i8  # the two bodies
    b: i8
    qa: i8  # where their coordinates are in State.q
    qb: i8
    va: i8  # ... in State.v
    vb: i8
    fa: i8  # ... in the solver's free v; -1: driven
    fb: i8
    row: i8  # number of its row, in Arrays.kept


class ItemRecord(Record):
    """A load, a signal or a part: where its kernels and its record are."""

    kind: i8
    at: i8


class SensorRecord(Record):
    """A sensor: where its kernel and its record are."""

    kind: i8
    at: i8
    energy: i8


class WorldRecord(Record):
    """What concerns the whole mechanism."""

    gravity: Vec3  # m/s^2
    nonconservative: i8  # 1: there is work that no potential contains
    drives: i8  # 1: a drive does
    states: i8  # number of first-order states: the last entries of State.v and of the solver's free v
    has_clearances: i8  # 1: some loads return a clearance
    search_margin: f8  # m, see mbfmu.mechanics.recursions.active_loads


class Arrays(NamedTuple):
    """A compiled mechanism."""

    world: Table[WorldRecord]  # (1,)
    bodies: Table[BodyRecord]  # (nb,) ground first
    cuts: Table[CutRecord]
    couplings: Table[CouplingRecord]
    loads: Table[ItemRecord]
    signals: Table[ItemRecord]
    parts: Table[ItemRecord]  # what loads and sensors are made of
    sensors: Table[SensorRecord]
    kept: NDArray[np.int64]  # (rows,) number among the constraints, cuts before couplings; -1: trivially satisfied
    residual_scale: NDArray[np.float64]  # (rows,) m: length of the mechanism divided by the unit of the row
    flexibles: Table[FlexibleRecord]
    nodes: Table[NodeRecord]
    kernels: NDArray[np.int64]  # addresses of kernels, MAX_KERNELS for each kind that is there; 0: it has none
    memory: NDArray[np.uint8]  # every record of whatever has a kind
    numbers: NDArray[np.float64]  # of tables and bodies of finite elements, which are of any length


class MotionRecord(Record):
    """A body as it moves, in global axes."""

    r: Vec3  # origin, m
    A: Mat3  # orientation, body to global
    Y: Vec6  # velocity (r', w)
    dY: Vec6  # acceleration (r'', w'), less gravity
    beta: Vec6  # acceleration at q'' = 0 and parent's Y' = 0 (velocity products)
    com: Vec3  # center of mass from the origin, global axes
    Jc: Mat3  # inertia about the center of mass, global axes
    F: Vec6  # applied wrench
    W: Vec6  # wrench the joint transmits from the parent
    mass: f8  # composite body: mass, first and second moment about the origin
    mc: Vec3
    J: Mat3
    IA: Mat6  # articulated inertia
    pA: Vec6  # articulated bias wrench


class RowRecord(Record):
    """A constraint equation of a cut joint."""

    Phi: f8  # constraint residual
    Ga: Vec6  # Phi' = Ga . Y_a + Gb . Y_b
    Gb: Vec6
    bias: f8  # Phi'' = Ga . Y'_a + Gb . Y'_b + bias
    lam: f8  # multiplier that loaded the bodies last


class CoupledRecord(Record):
    """The constraint equation of a coupling."""

    Phi: f8  # q_a - f(q_b)
    slope: f8  # f'
    bend: f8  # f''
    lam: f8  # multiplier that loaded the coordinates last


class BearingRecord(Record):
    """Friction of a joint in proportion to its reaction, see mbfmu.mechanics.recursions.reaction_friction."""

    body: i8  # whose tree joint it is
    v: i8  # place of the coordinate in State.v
    bearing_type: i8  # see mbfmu.mechanics.loads.reaction
    is_on_b: i8  # 1: the bearings are in body b of the joint
    radius: f8  # m
    thrust_radius: f8
    inverse_length: f8  # 1/m
    inverse_width: f8
    preload: f8  # N
    coulomb: f8  # coefficient of friction
    arm: f8  # slip per unit of the coordinate, 1 or m/rad
    z: f8  # state of the bristle
    rate: f8  # its rate, 1/s
    damping: f8  # tau F^(1/2) with the Coulomb force F
    fading: f8  # (tau v / d)^2 F
    axis: Vec3  # global axes
    center: Vec3  # of the bearings, from the origin of the body, m
    tilt: f8  # tangent of the lead angle of a thread; 0: it is none
    resistance: f8  # friction that was determined last, without the viscous part, N or N m
    normal: f8  # ... and the normal force, N or N m
    jam_time: f8  # s, of the last evaluation without a solution in which it had the largest part; NO_JAM: none
    undetermined_time: f8  # s, of the last evaluation in which reactions are not determined; of the first record


class SearchRecord(Record):
    """Lists of loads, see mbfmu.mechanics.recursions.active_loads."""

    active: i8  # number of active loads in the last search
    acting: i8  # number of loads that acted in the last evaluation
    is_searched: i8  # 1: there is a search, with the present records of loads
    is_evaluated: i8  # 1: and an evaluation
    has_acted: i8  # 1: the load that is evaluated acts
    is_repeated: i8  # 1: it is evaluated where it acted in the last evaluation
    parts: i8  # bits of its parts that act there, as it has set them


class PlacementRecord(Record):
    """Where a body was in the last search or evaluation, real numbers in every state."""

    r: Vec3
    A: Mat3


class RelativeMotionRecord(Record):
    """What the kernels of a joint write: the motion of the child relative to the joint frame, in its axes."""

    S: Mat6  # S[0:nv]: columns of the motion subspace, (u, w_rel) = sum_k v_k S[k]
    R: Mat3  # orientation of the child
    p: Vec3  # its origin, m
    bias: Vec6  # sum_k v_k dS[k]/dt


class State(NamedTuple):
    """What the recursions read and write."""

    bodies: Table[MotionRecord]  # (nb,)
    rows: Table[RowRecord]  # (constraint equations of cut joints,)
    coupled: Table[CoupledRecord]  # (couplings,)
    S: NDArray[np.float64]  # (subspaces, 6) joint motion subspaces, columns of B2
    q: NDArray[np.float64]  # (nq,) every joint position, driven ones included
    v: NDArray[np.float64]  # (nv,)
    a: NDArray[np.float64]  # (nv,)
    Q: NDArray[np.float64]  # (nv,) forces applied along joint coordinates
    tau: NDArray[np.float64]  # (nv,) inverse dynamics
    rel: Table[RelativeMotionRecord]  # (1,) of the joint whose kernels were called last
    frame: NDArray[np.float64]  # (3, 3) axes of its frame
    product: NDArray[np.float64]  # (3, 3) a product of matrices on its way
    wrench: NDArray[np.float64]  # (6,) a wrench on its way inward
    U: NDArray[np.float64]  # (nv, 6) articulated body: (IA S)^T, with the joint's Cholesky factor taken out
    D: NDArray[np.float64]  # (nv, largest nv of a joint + 1) articulated body: a joint's Cholesky factor, and last its
    # right-hand side
    scratch: NDArray[np.uint8]  # scratch memory of element types, see mbfmu.mechanics.dispatch.scratch_record
    search: Table[SearchRecord]  # (1,), see mbfmu.mechanics.recursions.active_loads, as the six that follow
    searched: Table[PlacementRecord]  # (nb,)
    evaluated: Table[PlacementRecord]  # (nb,)
    active: NDArray[np.int64]  # (loads,) first the numbers of the active ones, ascending
    acting: NDArray[np.int64]  # (loads,) ... of those that acted
    acting_parts: NDArray[np.int64]  # (loads,) SearchRecord.parts of these
    is_acting: NDArray[np.int64]  # (loads,) 1: it acted
    time: NDArray[np.float64]  # (1,) s, of the coordinates
    cached_power: NDArray[np.float64]  # (1,) W, non-conservative power that loads have evaluated with their forces
    energy: NDArray[np.float64]  # (2,) J, kinetic and potential, where sensors are read
    bearings: Table[BearingRecord]  # (nf,) of joints with friction in proportion to their reaction
    bearing_loads: NDArray[np.float64]  # (nf (nf + 1) + 1, 7) see mbfmu.mechanics.recursions.reaction_friction, as ...
    saddle: NDArray[np.float64]  # (n + m, n + m + nf + 2) without friction, and the responses to it
    friction: NDArray[np.float64]  # (nf, nf + 2) Newton's matrix, right-hand side and solution


class Data(NamedTuple):
    """What a solver passes through to the mechanics."""

    arrays: Arrays
    state: State


def allocate_state(
    nb: int,
    rows: int,
    couplings: int,
    loads: int,
    nq: int,
    nv: int,
    widest: int,
    subspaces: int,
    scratch: int,
    bearings: int,
) -> State:
    """Return zeroed memory for ``nb`` bodies (ground included), with the ground placed; ``widest`` is the largest
    number of coordinates of a joint, and ``scratch`` is in bytes.
    """
    z = np.zeros
    equations = (nv + rows + couplings) * (bearings > 0)
    state = State(
        bodies=MotionRecord.zeros(nb),
        rows=RowRecord.zeros(rows),
        coupled=CoupledRecord.zeros(couplings),
        S=z((subspaces, 6)),
        q=z(nq),
        v=z(nv),
        a=z(nv),
        Q=z(nv),
        tau=z(nv),
        rel=RelativeMotionRecord.zeros(1),
        frame=z((3, 3)),
        product=z((3, 3)),
        wrench=z(6),
        U=z((nv, 6)),
        D=z((nv, widest + 1)),
        scratch=aligned_bytes(scratch),
        search=SearchRecord.zeros(1),
        searched=PlacementRecord.zeros(nb),
        evaluated=PlacementRecord.zeros(nb),
        active=z(loads, np.int64),
        acting=z(loads, np.int64),
        acting_parts=z(loads, np.int64),
        is_acting=z(loads, np.int64),
        time=z(1),
        cached_power=z(1),
        energy=z(2),
        bearings=BearingRecord.zeros(bearings),
        bearing_loads=z((bearings * (bearings + 1) + 1, 7)),
        saddle=z((equations, equations + bearings + 2)),
        friction=z((bearings, bearings + 2)),
    )
    state.bodies["A"][0] = np.eye(3)
    state.bearings["jam_time"] = state.bearings["undetermined_time"] = NO_JAM
    return state


def empty_data() -> Data:
    """Return data of a mechanism of one body: an example of the types that every mechanism has."""
    whole = np.zeros(1, np.int64)
    arrays = Arrays(
        world=WorldRecord.zeros(1),
        bodies=BodyRecord.zeros(1),
        cuts=CutRecord.zeros(1),
        couplings=CouplingRecord.zeros(1),
        loads=ItemRecord.zeros(1),
        signals=ItemRecord.zeros(1),
        parts=ItemRecord.zeros(1),
        sensors=SensorRecord.zeros(1),
        kept=whole,
        residual_scale=np.zeros(1),
        flexibles=FlexibleRecord.zeros(1),
        nodes=NodeRecord.zeros(1),
        kernels=np.zeros(MAX_KERNELS, np.int64),
        memory=np.zeros(1, np.uint8),
        numbers=np.zeros(1),
    )
    return Data(arrays, allocate_state(1, 1, 1, 1, 1, 1, 1, 1, 0, 1))


def to_complex_data(data: Data) -> Data:
    """Return a copy whose real numbers are complex: the same recursions on it give derivatives by complex step.

    Kernels are written so that each is an analytic function of every real number it reads. Kernels and memory are those
    of the real one still: :class:`.tables.Tables` has the complex ones.
    """
    arrays: Any = [to_complex(array) for array in data.arrays]
    return Data(Arrays(*arrays), to_complex_state(data.state))


def to_complex_state(state: State) -> State:
    """Return a copy whose real numbers are complex."""
    scratch = aligned_bytes(COMPLEX_FACTOR * len(state.scratch))
    arrays: Any = [to_complex(array) for array in state]
    searched: Any = state.searched.copy()
    evaluated: Any = state.evaluated.copy()
    return State(*arrays)._replace(scratch=scratch, searched=searched, evaluated=evaluated)


def share_lists(state: State, moving: State) -> State:
    """Return a state that has the lists of loads of another one at the same real positions."""
    return state._replace(
        search=moving.search, searched=moving.searched, evaluated=moving.evaluated, active=moving.active,
        acting=moving.acting, acting_parts=moving.acting_parts, is_acting=moving.is_acting,
    )  # fmt: skip


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
