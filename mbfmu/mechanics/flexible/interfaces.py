"""Interfaces of a body of finite elements: sets of nodes whose motion is that of a frame.

A rigid tie gives the nodes the motion of the frame. An average tie gives the frame the mean motion of the nodes, the
rigid motion (t, theta) with the least sum w_i |u_i - t - theta x r_i|^2; a wrench on the frame is then distributed
over the nodes and leaves them free to deform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.checks import Vector, one_of, vector
from mbfmu.mechanics.numbers import array_of
from mbfmu.util.errors import UserError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

TIES = ("rigid", "average")
CENTER = "center"  # name of the frame in the center of mass, which no interface can have
COLLINEAR_RATIO = 1e-6  # of the second to the first singular value of positions on a line, by rounding of the mesh


@dataclass(frozen=True, kw_only=True)
class Interface:
    """Set of nodes of a finite element model that is connected to a frame.

    Parameters
    ----------
    nodes
        Numbers of the nodes, from 0.
    at
        Origin of the frame, axes and origin of the mesh, m; None: the mean of the positions.
    tie
        ``rigid``: the nodes move with the frame, as a surface that is bolted or pressed to a stiff part. ``average``:
        the frame moves with the (weighted) mean motion of the nodes, which remain free to deform.
    weights
        Weights of the nodes of an average tie, such as areas; None: equal weights.
    """

    nodes: Sequence[int] | NDArray[Any]
    at: Vector | None = None
    tie: str = "rigid"
    weights: Sequence[float] | Array | None = None


class Tie(NamedTuple):
    """An interface as equations between the motions (s, 6) of a frame and its nodes."""

    name: str
    nodes: Integers
    origin: Array  # (3,) axes and origin of the mesh, m
    motion: Array  # (dof s, 6) motion of the nodes by a rigid motion of the frame
    average: Array | None  # (6, dof s) motion of the frame by the motions of the nodes; None: a rigid tie


def tie_of(name: str, given: Any, nodes: Array, dof: int) -> Tie:
    """Return the equations of an interface; ``nodes`` (n, 3) are positions, m, of ``dof`` degrees of freedom each."""
    interface = given if isinstance(given, Interface) else Interface(nodes=given)
    what = f"interface {name!r}"
    one_of(f"tie of {what}", interface.tie, TIES)
    numbers = _node_numbers(what, interface.nodes, len(nodes))
    weights = _weights(what, interface, len(numbers))
    own = nodes[numbers]
    origin = weights @ own / weights.sum() if interface.at is None else vector(f"at of {what}", interface.at)
    motion = np.vstack([rigid_motion(x - origin, dof) for x in own])
    line = np.linalg.svd(own - own.mean(axis=0), compute_uv=False) if len(own) > 1 else np.zeros(2)
    if line[1] <= COLLINEAR_RATIO * line[0] and (dof == 3 or interface.tie == "average"):
        kind = "an average tie" if dof == 6 else "nodes of 3 degrees of freedom"
        raise UserError(
            f"{what} has {len(own)} node{'s' * (len(own) > 1)}{' on a line' * (len(own) > 1)}, which determine no "
            f"rotation about it; allowed for {kind}: at least three nodes that are not on a line"
        )
    if interface.tie == "rigid":
        return Tie(name, numbers, origin, motion, None)
    used = np.arange(len(motion)).reshape(len(own), dof)[:, :3].ravel()
    scale = np.linalg.norm(own - origin, axis=1).max()
    units = np.array([1.0, 1.0, 1.0, scale, scale, scale])  # so that lengths and angles are of one size
    A = motion[used] / units
    average: Array = np.zeros((6, len(motion)))
    average[:, used] = np.linalg.solve(A.T @ (np.repeat(weights, 3)[:, None] * A), A.T * np.repeat(weights, 3))
    return Tie(name, numbers, origin, motion, average / units[:, None])


def _node_numbers(what: str, given: Any, count: int) -> Integers:
    array = np.atleast_1d(np.asarray(given))
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise UserError(f"nodes of {what} are {given!r}; allowed: numbers of nodes, from 0")
    numbers = np.unique(array.astype(np.int64))
    if not len(numbers):
        raise UserError(f"{what} has no node; allowed: at least one. Check the name of the set in the mesh")
    if numbers[0] < 0 or numbers[-1] >= count:
        bad = numbers[0] if numbers[0] < 0 else numbers[-1]
        raise UserError(
            f"{what} has node {bad}, but there are {count} nodes; allowed: 0 to {count - 1}. Numbers of programs "
            "that begin with 1 must be reduced by 1"
        )
    if len(numbers) < len(array):
        raise UserError(f"{what} has {len(array) - len(numbers)} of its nodes twice; give each node once")
    return array.astype(np.int64)


def _weights(what: str, interface: Interface, count: int) -> Array:
    if interface.weights is None:
        return np.ones(count)
    if interface.tie == "rigid":
        raise UserError(f"{what} has weights and a rigid tie; allowed: weights of an average tie only")
    weights = array_of(f"weights of {what}", interface.weights)
    if weights.shape != (count,) or not np.all(np.isfinite(weights)) or np.any(weights <= 0.0):
        raise UserError(f"weights of {what} are {interface.weights!r}; allowed: {count} numbers greater than zero")
    return weights


def rigid_motion(r: Array, dof: int) -> Array:
    """Return the motion (dof, 6) of a node at r (3,) from an origin by a rigid motion (t, theta) of it."""
    x, y, z = r
    motion = np.eye(dof, 6)
    motion[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return motion


def ties_of(interfaces: Mapping[str, Any], nodes: Array, dof: int) -> list[Tie]:
    """Return the equations of all interfaces; UserError for nodes that belong to two."""
    if not isinstance(interfaces, Mapping) or not interfaces:
        raise UserError(
            f"interfaces are {interfaces!r}; a flexible body needs at least one, a name with its nodes, where the "
            "mechanism is connected"
        )
    owner: dict[int, str] = {}
    ties = []
    for name, given in interfaces.items():
        if not isinstance(name, str) or not name or name == CENTER:
            raise UserError(f"name of an interface is {name!r}; allowed: a text other than {CENTER!r}")
        tie = tie_of(name, given, nodes, dof)
        for node in tie.nodes.tolist():
            if node in owner:
                raise UserError(f"node {node} belongs to interfaces {owner[node]!r} and {name!r}; allowed: one of them")
            owner[node] = name
        ties.append(tie)
    return ties


def transformation(ties: list[Tie], count: int, dof: int) -> tuple[Any, int]:
    """Return the matrix (dof count, free + 6 interfaces), sparse, that gives the motion of all nodes by those that are
    free and the motions of the frames, and the number of free ones.

    Of the nodes of an average tie six motions follow from the frame and the other ones: those by which it is best
    determined.
    """
    follows = np.zeros(dof * count, bool)
    blocks: list[tuple[Integers, Integers, Array, Array]] = []
    for tie in ties:
        own = (dof * tie.nodes[:, None] + np.arange(dof)).ravel()
        if tie.average is None:
            dependent, others, onto = own, own[:0], tie.motion
            by_others = np.zeros((len(own), 0))
        else:
            pivots = scipy.linalg.qr(tie.average / np.abs(tie.average).max(axis=1, keepdims=True), pivoting=True)[2]
            six, rest = pivots[:6], np.setdiff1d(np.arange(len(own)), pivots[:6])
            onto = np.asarray(np.linalg.inv(tie.average[:, six]), float)
            dependent, others, by_others = own[six], own[rest], -onto @ tie.average[:, rest]
        follows[dependent] = True
        blocks.append((dependent, others, onto, by_others))
    free = np.flatnonzero(~follows)
    column = np.full(dof * count, -1)
    column[free] = np.arange(len(free))
    rows, columns, values = [free], [np.arange(len(free))], [np.ones(len(free))]
    for k, (dependent, others, onto, by_others) in enumerate(blocks):
        for block, at in ((onto, len(free) + 6 * k + np.arange(6)), (by_others, column[others])):
            i, j = np.meshgrid(dependent, at, indexing="ij")
            rows.append(i.ravel())
            columns.append(j.ravel())
            values.append(block.ravel())
    shape = (dof * count, len(free) + 6 * len(ties))
    matrix = scipy.sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    )
    return matrix.tocsc(), len(free)
