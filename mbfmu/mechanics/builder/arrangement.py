"""From a mechanism declared as a graph to a tree of bodies and cut joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics.checks import rotation, vector
from mbfmu.mechanics.cuts import (
    CutJoint,
    CylindricalCutJoint,
    PlanarCutJoint,
    RevoluteCutJoint,
    SphericalCutJoint,
    TranslationalCutJoint,
    UniversalCutJoint,
    WeldCutJoint,
)
from mbfmu.mechanics.joints import Cylindrical, Joint, Planar, Revolute, Spherical, Translational, Universal, Weld
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError

from .bodies import UNPLACED, Body
from .handles import CutHandle
from .joint_handle import JointHandle
from .mechanism import Mechanism
from .spanning_tree import Components, Edge, Rank, Tree, choose_tree, orient

CUT_JOINTS: dict[type[Joint], type[CutJoint]] = {
    Cylindrical: CylindricalCutJoint,
    Planar: PlanarCutJoint,
    Revolute: RevoluteCutJoint,
    Spherical: SphericalCutJoint,
    Translational: TranslationalCutJoint,
    Universal: UniversalCutJoint,
    Weld: WeldCutJoint,
}
MAX_NOTED_JOINTS = 8  # names of joints in a note


def arrange(m: Mechanism) -> None:
    """Determine the tree and the cut joints of a mechanism that is declared as a graph; others remain as they are.

    Raises
    ------
    UserError
        A body is not connected to the ground, a loop cannot be opened, or the name of a joint is that of a body that is
        declared with a joint.
    """
    if not m.joints and all(body.parent != UNPLACED for body in m.bodies):
        return
    _check_connections(m)
    placed = [body for body in m.bodies[1:] if body.parent != UNPLACED]
    own = {body.name for body in placed}
    for joint in m.joints:
        if joint.name in own:
            raise UserError(
                f"joint {joint.name!r} has the name of a body that is declared with its joint; allowed: a name that is "
                "no such body's. Rename one of them"
            )
    edges = [Edge(body.parent, body.index, Rank.BODY, 0) for body in placed]
    edges += [Edge(j.a.index, j.b.index, _rank(j), 6 - j.joint.nv) for j in m.joints]
    tree, first = choose_tree(len(m.bodies), edges), len(placed)
    towards = orient(len(m.bodies), edges, tree.inside)
    for e, body in enumerate(placed):
        if towards[body.index] != e:
            raise UserError(
                f"body {body.name!r} is declared with body {m.bodies[body.parent].name!r} as its parent, which is "
                f"connected to the ground only through {body.name!r} in the tree; declare {body.name!r} without a "
                "parent, and its joint with Mechanism.joint"
            )
    divided = [m.joints[e - first] for e in tree.closing if edges[e].rank == Rank.COORDINATE]
    parts = _divide(m, divided)
    moves = [_Move(m.joints[e - first], m.bodies[k]) for k, e in enumerate(towards) if e >= first]
    _place(m, moves, parts)
    _close(m, [m.joints[e - first] for e in tree.closing], parts)
    _adopt(m)
    m.tree_notes += _describe(m, tree, edges, first, parts)


class _Move(NamedTuple):
    """A joint of the tree and the body that it moves."""

    handle: JointHandle
    body: Body


class _Part(NamedTuple):
    """A part of a body that is divided because all joints of a loop are in the tree."""

    handle: JointHandle
    body: Body
    of: Body


def _rank(handle: JointHandle) -> Rank:
    joint = handle.joint
    if handle.needs_coordinates:
        return Rank.COORDINATE
    if joint.nv == 6:
        return Rank.UNCONSTRAINED
    if type(joint) not in CUT_JOINTS:
        return Rank.COORDINATE
    return Rank.START if _has_start(handle) else Rank.FREE


def _has_start(handle: JointHandle) -> bool:
    return handle.joint.start is not None or handle.joint.rate is not None


def _check_connections(m: Mechanism) -> None:
    """Raise UserError if a body is not connected to the ground."""
    parts = Components(len(m.bodies))
    for body in m.bodies[1:]:
        if body.parent != UNPLACED:
            parts.join(body.parent, body.index)
    for handle in m.joints:
        parts.join(handle.a.index, handle.b.index)
    lost = [body for body in m.bodies if parts.find(body.index) != 0]
    if lost:
        part = [body.name for body in lost if parts.find(body.index) == parts.find(lost[0].index)]
        names = f"body {part[0]!r} is" if len(part) == 1 else f"bodies {_listed(part)} are"
        raise UserError(
            f"{names} not connected to the ground; allowed: bodies that joints connect to it. Add the missing joint "
            "with Mechanism.joint; for a body that moves freely: m.joint(name, m.ground, body, Floating())"
        )


def _divide(m: Mechanism, handles: Sequence[JointHandle]) -> list[_Part]:
    """Return a part of a body for every joint that must be in the tree and would close a loop.

    The part is the body that the joint moves. It has a fraction of the mass and is welded to the rest.
    """
    chosen = []
    for handle in handles:
        ends = [end for end in (handle.b, handle.a) if end.index and (end.mass > 0.0 or np.any(end.inertia))]
        if not ends:
            raise UserError(
                f"joint {handle.name!r} and all other joints of its loop have coordinates that are used or no cut "
                "joint, and its bodies have no mass; allowed: a loop with one joint that can be a cut joint. Remove a "
                "drive, a force, an output or fixed start values of one of its joints, or give one of its bodies a mass"
            )
        chosen.append(ends[0])
    count = Counter(body.index for body in chosen)
    parts = []
    for handle, of in zip(handles, chosen, strict=True):
        share = 1.0 / (1 + count[of.index])
        name = f"{of.name}.{handle.name}"
        m._new_name("body", name, m._bodies_named)
        part = Body(name, len(m.bodies), UNPLACED, handle.joint, share * of.mass, of.com, share * of.inertia)
        parts.append(_Part(handle, m._append(part), of))
    for of in {body.index: body for body in chosen}.values():
        of.scale_mass(1.0 / (1 + count[of.index]))
    return parts


def _place(m: Mechanism, moves: Sequence[_Move], parts: Sequence[_Part]) -> None:
    """Give bodies their joints and parents, and number all so that parents come first."""
    parents = {body.index: m.bodies[body.parent] for body in m.bodies if body.parent != UNPLACED}
    joints: dict[int, tuple[Joint, dict[str, Any]]] = {body.index: (body.joint, {}) for body in m.bodies}
    added = [*(_Part(move.handle, move.body, move.body) for move in moves), *parts]
    for handle, body, of in added:
        is_reversed = of is handle.a
        parents[body.index] = handle.b if is_reversed else handle.a
        handle.carrier = body
        joint, own = handle.joint, (handle.at_b, handle.rotation_b)
        if is_reversed:
            joint = replace(joint, at=tuple(handle.at_b), rotation=handle.rotation_b)
            own = (vector("at", handle.joint.at), rotation("rotation", handle.joint.rotation))
        frame = {
            "joint_name": handle.name,
            "reversed": is_reversed,
            "attached": is_reversed or handle.is_placed_on_b,
            "joint_at": own[0],
            "joint_rotation": own[1],
        }
        joints[body.index] = (joint, frame)
    order: list[Body] = []
    done: set[int] = set()
    for body in m.bodies:
        way, at = [], body
        while at.index not in done:
            done.add(at.index)
            way.append(at)
            at = parents[at.index]
        order += reversed(way)
    number = {body.index: k for k, body in enumerate(order)}
    for surface in m.surfaces:
        surface.bodies[:] = np.vectorize(number.__getitem__)(surface.bodies)
    above = {body.index: number[parents[body.index].index] for body in order}
    for body in order:
        joint, frame = joints[body.index]
        body.place(number[body.index], above[body.index], joint, **frame)
    m.bodies[:] = order


def _close(m: Mechanism, handles: Sequence[JointHandle], parts: Sequence[_Part]) -> None:
    """Add the cut joints."""
    for handle in handles:
        joint = handle.joint
        if handle.carrier is not None or joint.nv == 6:
            continue
        axis = {key: getattr(joint, key) for key in ("axis", "second") if hasattr(joint, key)}
        cut = CUT_JOINTS[type(joint)](
            at_a=joint.at, at_b=handle.at_b, rotation_a=joint.rotation, rotation_b=handle.rotation_b, **axis
        )
        handle.cut = len(m.cuts)
        m.cuts.append(CutHandle(handle.name, len(m.cuts), cut, handle.a, handle.b))
    for part in parts:
        m.cuts.append(CutHandle(part.body.name, len(m.cuts), WeldCutJoint(), part.of, part.body))


def _adopt(m: Mechanism) -> None:
    """Let forces and couplings of joints act on the bodies that these move."""

    def owner(given: Body | JointHandle) -> Body:
        if isinstance(given, JointHandle):
            assert given.carrier is not None
            return given.carrier
        return given

    m.forces[:] = [(name, force, owner(a), b) for name, force, a, b in m.forces]
    m.couplings[:] = [replace(handle, a=owner(handle.a), b=owner(handle.b)) for handle in m.couplings]


def _describe(m: Mechanism, tree: Tree, edges: Sequence[Edge], first: int, parts: Sequence[_Part]) -> list[Diagnostic]:
    """Return notes on the cut joints, on divided bodies, and on start values that are not used."""
    cut = [m.joints[e - first] for e in tree.closing if m.joints[e - first].cut >= 0]
    free = [handle.name for handle in (m.joints[e - first] for e in tree.closing) if handle.joint.nv == 6]
    texts = []
    if free:
        plural = len(free) > 1
        texts.append(f"joint{'s' * plural} {_listed(free)} of six coordinates {'have' if plural else 'has'} no effect")
    if cut:
        names, one = _listed([handle.name for handle in cut]), len(cut) == 1
        texts.append(f"joint {names} closes a loop (cut joint)" if one else f"joints {names} close loops (cut joints)")
    for part in parts:
        texts.append(
            f"body {part.of.name!r} is divided into parts that are welded together, because the coordinates of all "
            f"joints of the loop of joint {part.handle.name!r} are used"
        )
    found = []
    if texts:
        found.append(Diagnostic.note("chosen-tree", f"{'; '.join(texts)}; the other joints form the tree"))
    closing = [m.joints[e - first] for e in tree.closing if edges[e].rank != Rank.COORDINATE]
    unused = [handle.name for handle in closing if _has_start(handle)]
    if unused:
        plural = len(unused) > 1
        found.append(
            Diagnostic.note(
                "unused-start",
                f"start values of joint{'s' * plural} {_listed(unused)} are not used: the other joints of "
                f"{'their loops' if plural else 'its loop'}, which form the tree, determine the start",
                "Leave them out, or declare as fixed the start values that must be kept",
                subject=unused[0],
            )
        )
    return found


def _listed(names: Sequence[str]) -> str:
    """Return names as text, of many the first."""
    shown = ", ".join(map(repr, names[:MAX_NOTED_JOINTS]))
    return f"{shown} and {len(names) - MAX_NOTED_JOINTS} more" if len(names) > MAX_NOTED_JOINTS else shown
