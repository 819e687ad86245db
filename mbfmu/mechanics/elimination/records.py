"""The fronts of a mechanism as kernels take them, and the memory they work in.

All unknowns and equations of the elimination are scaled: lengths of motions by the length of the mechanism, coordinates
by their sizes, every constraint equation by its length over the motions it constrains. So parts of an equation can be
compared, whatever the units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.records import MODAL, SECTION, Arrays
from solvers.compiled.record import Record, Table, f8, i8

from .plan import BODY_WIDTH, GROUND, Capacity, Elimination, Front, Variable, find_capacity, motion, width

NONE = -1  # no place: a variable that is known, or a front without a target


class FrontRecord(Record):
    """One front, constant but for the last block.

    Its columns are, in this order: delayed directions of the messages, own coordinates, interface, motion of the body.
    Places of columns count from the first own coordinate, since the number of delayed directions changes.
    """

    body: i8
    parent: i8
    nv: i8  # own coordinates
    ns: i8  # coordinates that move the body relative to its parent: its own, or of a section the amplitudes
    at_joint: i8  # place of these
    is_flexible: i8  # 1: its coordinates are the amplitudes of a flexible body
    vi: i8  # where they start in State.v
    si: i8  # ... in State.S
    vf: i8  # ... in the solver's free v; -1: the joint has none
    np: i8  # components of the interface
    at_parent: i8  # place of the parent's motion; -1: the ground
    first_message: i8  # in EliminationArrays.messages
    end_message: i8
    first_row: i8  # in EliminationArrays.rows
    end_row: i8
    first_variable: i8  # of its interface, in EliminationArrays.variables
    end_variable: i8
    target: i8  # front that gets the message; -1: none
    map: i8  # where the places of its interface in the target's columns start, in EliminationArrays.places
    # where its blocks start in EliminationMemory.values; dimensions in terms of ny: coordinates to eliminate, nz:
    # delayed directions and interface, rows: those that arrive
    Q: i8  # (ny, ny) rotation of the coordinates to eliminate
    shift: i8  # (ny,) rotated coordinates = shift - gain z
    gain: i8  # (ny, nz)
    H: i8  # (nz, nz) message: quadratic form
    g: i8  # (nz,) ... linear form
    R: i8  # (left, nz) ... equations that remain
    r: i8  # (left,) ... their right-hand sides
    unit: i8  # (left,) ... their lengths before scaling, as parts of the original ones
    lam: i8  # (left,) multipliers of the equations that remain
    lost: i8  # (left, nz) what these lose by the restriction: per component of z, see message.py
    known: i8  # (left,) ... and where z is zero
    y: i8  # (ny,) solution
    E: i8  # (rows, rows) operations on the equations that arrive, for the multipliers
    L: i8  # (rank, rank) pivots
    F: i8  # (rank, n) rows of the quadratic form that belong to the pivots, before the substitution
    f: i8  # (rank,) ... of the linear form
    # of the last elimination
    ny: i8
    rank: i8  # equations that are solved here
    delayed: i8  # directions that are eliminated by the target
    rows: i8  # equations that have arrived
    left: i8  # equations that remain
    at_delayed: i8  # where its delayed directions are among the coordinates of the target
    at_rows: i8  # ... its equations among those that arrive at the target


class EquationRecord(Record):
    """A constraint equation in its front: of a cut joint, a pair of wrenches; of a coupling, two coordinates."""

    coupling: i8  # number of the coupling; -1: an equation of a cut joint
    cut: i8  # number of the cut joint; -1: an equation of a coupling
    row: i8  # of State.rows, of an equation of a cut joint
    kept: i8  # number among the constraints
    a: i8  # places of the two motions or coordinates; -1: it is known
    b: i8
    length: f8  # factor that scales it, by the last elimination


class VariableRecord(Record):
    """A variable of an interface."""

    body: i8
    coordinate: i8  # in the solver's free v; -1: the motion of the body


class EliminationArrays(NamedTuple):
    """All fronts, in the order of elimination."""

    fronts: Table[FrontRecord]
    equations: Table[EquationRecord]
    variables: Table[VariableRecord]
    messages: NDArray[np.int64]
    places: NDArray[np.int64]
    size: NDArray[np.float64]  # (n,) units of the coordinates
    row_size: NDArray[np.float64]  # (m,) units of the constraint residuals
    length: NDArray[np.float64]  # (1,) unit of the motions, m


class EliminationMemory(NamedTuple):
    """Results of the fronts, and scratch of one front."""

    values: NDArray[np.float64]  # blocks of all fronts
    motions: NDArray[np.float64]  # (nb, 6) scaled accelerations, or changes, of the bodies
    x: NDArray[np.float64]  # (n,) scaled solution
    H: NDArray[np.float64]  # (columns, columns) front: quadratic form
    g: NDArray[np.float64]  # (columns,)
    R: NDArray[np.float64]  # (rows, columns) equations
    r: NDArray[np.float64]  # (rows,)
    unit: NDArray[np.float64]  # (rows,)
    mu: NDArray[np.float64]  # (rows,) multipliers of the equations that are solved and that remain
    arrived: NDArray[np.float64]  # (rows,) ... of those that have arrived
    E: NDArray[np.float64]  # (rows, rows)
    Q: NDArray[np.float64]  # (coordinates, coordinates)
    U: NDArray[np.float64]  # (coordinates, columns)
    u: NDArray[np.float64]  # (coordinates,)
    W: NDArray[np.float64]  # (columns, columns)
    w: NDArray[np.float64]  # (columns,)
    S: NDArray[np.float64]  # (coordinates of a body, 6) scaled motion subspace of the joint, a row each
    bias: NDArray[np.float64]  # (6,) scaled acceleration of the body at zero unknowns
    taken: NDArray[np.bool_]  # (columns,)
    z: NDArray[np.float64]  # (columns,)

    @staticmethod
    def allocate(size: int, bodies: int, n: int, columns: int, rows: int, ny: int, subspace: int) -> EliminationMemory:
        """Return zeroed memory: ``size`` numbers for the results of all fronts, and scratch for the largest front."""
        z = np.zeros
        return EliminationMemory(
            values=z(size), motions=z((bodies, BODY_WIDTH)), x=z(n), H=z((columns, columns)), g=z(columns),
            R=z((rows, columns)), r=z(rows), unit=z(rows), mu=z(rows), arrived=z(rows), E=z((rows, rows)),
            Q=z((ny, ny)), U=z((ny, columns)), u=z(ny), W=z((columns, columns)), w=z(columns), S=z((subspace, 6)),
            bias=z(6), taken=z(columns, np.bool_), z=z(columns),
        )  # fmt: skip


class Source(NamedTuple):
    """A constraint equation of the mechanism."""

    coupling: int  # its number; NONE: an equation of a cut joint
    cut: int  # the same
    row: int  # of State.rows
    kept: int  # number among the constraints
    a: Variable | None  # what it relates; None: it is known
    b: Variable | None


class Reduced(NamedTuple):
    """Symbolic result: fronts and their capacity, with what their equations are."""

    fronts: list[Front]
    capacity: Capacity
    sources: list[Source]


def find_equations(arrays: Arrays) -> list[Source]:
    """Return the equations that are not trivially satisfied."""
    found: list[Source] = []
    for i, cut in enumerate(arrays.cuts):
        a, b = (motion(int(cut[k])) if cut[k] != GROUND else None for k in "ab")
        for row in range(int(cut["row"]), int(cut["end"])):
            if arrays.kept[row] >= 0:
                found.append(Source(NONE, i, row, int(arrays.kept[row]), a, b))
    for i, coupling in enumerate(arrays.couplings):
        kept = int(arrays.kept[coupling["row"]])
        if kept >= 0:
            ends = [
                (int(coupling[k]), int(coupling[f"v{k}"] - arrays.bodies[int(coupling[k])]["vi"]))
                if coupling[f"f{k}"] >= 0
                else None
                for k in "ab"
            ]
            found.append(Source(i, NONE, NONE, kept, *ends))
    return found


def reduce_graph(arrays: Arrays) -> Reduced:
    """Return the fronts of a mechanism."""
    sources, bodies = find_equations(arrays), arrays.bodies
    related = [[v for v in (source.a, source.b) if v is not None] for source in sources]
    amplitudes = {int(i): int(bodies[i]["nv"]) for i in np.flatnonzero(bodies["role"] == SECTION)}
    fronts = Elimination(bodies["parent"].tolist(), related, amplitudes).order()
    return Reduced(fronts, find_capacity(fronts, own_coordinates(arrays).tolist()), sources)


def own_coordinates(arrays: Arrays) -> NDArray[np.int64]:
    """Return how many free coordinates every body (nb,) eliminates: those of its joint, but none of a section."""
    bodies = arrays.bodies
    found = np.where((bodies["vf"] >= 0) & (bodies["role"] != SECTION), bodies["nv"], 0)
    found[GROUND] = 0
    return found


def local_places(front: Front, own: int) -> dict[Variable, int]:
    """Return the place of every variable among the columns of a front with ``own`` coordinates."""
    places: dict[Variable, int] = {(front.body, k): k for k in range(own)}
    at = own
    for variable in front.interface:
        places[variable] = at
        at += width(variable)
    places[motion(front.body)] = at
    return places


def lay_out(
    arrays: Arrays, size: NDArray[np.float64], row_size: NDArray[np.float64], length: float
) -> tuple[EliminationArrays, EliminationMemory]:
    """Return the fronts of a mechanism and their memory.

    Parameters
    ----------
    arrays
        The mechanism.
    size, row_size
        Units of the free coordinates (n,) and of the constraint residuals (m,).
    length
        Length of the mechanism, m.
    """
    fronts, capacity, sources = reduce_graph(arrays)
    out = FrontRecord.zeros(len(fronts))
    equations: list[tuple[int, ...]] = []
    variables: list[tuple[int, int]] = []
    messages: list[int] = []
    bodies, counts = arrays.bodies, own_coordinates(arrays)
    places = []
    for k, front in enumerate(fronts):
        body, record = bodies[front.body], out[k]
        record["body"], record["parent"] = front.body, body["parent"]
        record["vi"], record["si"], record["vf"] = body["vi"], body["si"], body["vf"]
        record["nv"], record["ns"] = counts[front.body], body["nv"] if body["vf"] >= 0 else 0
        record["is_flexible"] = body["role"] == MODAL
        record["np"], record["target"] = front.interface_width, front.target
        places.append(local_places(front, int(record["nv"])))
        if body["role"] == SECTION:
            record["at_joint"] = places[k][int(body["parent"]), 0]
        record["at_parent"] = places[k].get(motion(int(body["parent"])), NONE)
        record["first_message"], record["end_message"] = len(messages), len(messages) + len(front.messages)
        messages += front.messages
        record["first_row"], record["end_row"] = len(equations), len(equations) + len(front.equations)
        for number in front.equations:
            *numbers, a, b = sources[number]
            equations.append((*numbers, *(NONE if v is None else places[k][v] for v in (a, b))))
        record["first_variable"], record["end_variable"] = len(variables), len(variables) + len(front.interface)
        variables += [(v[0], int(bodies[v[0]]["vf"]) + v[1] if v[1] >= 0 else NONE) for v in front.interface]
    mapped: list[int] = []
    for k, front in enumerate(fronts):
        out[k]["map"] = len(mapped)
        for variable in front.interface:
            at = places[front.target][variable]
            mapped += range(at, at + width(variable))
    total = _assign_blocks(out, capacity)
    table = EquationRecord.zeros(len(equations))
    for equation, values in zip(table, equations, strict=True):
        for name, value in zip(Source._fields, values, strict=True):
            equation[name] = value
    listed = VariableRecord.zeros(len(variables))
    for listing, (number, coordinate) in zip(listed, variables, strict=True):
        listing["body"], listing["coordinate"] = number, coordinate
    own = EliminationArrays(
        out, table, listed, np.array(messages, np.int64), np.array(mapped, np.int64), size, row_size, np.array([length])
    )
    ny, rows = int(capacity.coordinates.max()), int(capacity.rows.max())
    columns = int((capacity.coordinates + out["np"]).max()) + BODY_WIDTH
    memory = EliminationMemory.allocate(total, len(bodies), len(size), columns, rows, ny, int(out["ns"].max(initial=0)))
    return own, memory


def _assign_blocks(fronts: Table[FrontRecord], capacity: Capacity) -> int:
    """Give every block of every front its place in the memory; return the size of all."""
    at = 0
    for k, front in enumerate(fronts):
        ny, rows, nz = int(capacity.coordinates[k]), int(capacity.rows[k]), int(capacity.delayed[k] + front["np"])
        left, rank = min(int(front["np"]), rows), min(ny, rows)
        sizes = {
            "Q": ny * ny, "shift": ny, "gain": ny * nz, "H": nz * nz, "g": nz, "R": left * nz, "r": left, "unit": left,
            "lam": left, "lost": left * nz, "known": left, "y": ny, "E": rows * rows, "L": rank * rank,
            "F": rank * (ny + int(front["np"])), "f": rank,
        }  # fmt: skip
        for name, size in sizes.items():
            front[name] = at
            at += size
    return at


def example() -> tuple[EliminationArrays, EliminationMemory]:
    """Return fronts and memory of a mechanism of one body: an example of the types that all have."""
    whole, z = np.zeros(1, np.int64), np.zeros
    own = EliminationArrays(
        FrontRecord.zeros(1), EquationRecord.zeros(1), VariableRecord.zeros(1), whole, whole, z(1), z(1), z(1)
    )
    return own, EliminationMemory.allocate(1, 1, 1, 1, 1, 1, 1)
