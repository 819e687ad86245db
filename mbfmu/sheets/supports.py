"""Supports of a sheet: what holds an edge, and the cut joints where its tree does not grow from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.checks import Matrix, Vector, one_of
from mbfmu.mechanics.cuts import CutJoint, PlanarCutJoint, PlaneCutJoint, RevoluteCutJoint, WeldCutJoint
from mbfmu.util.errors import UserError

SHEET_EDGES = ("x0", "x1", "z0", "z1")
SUPPORT_KINDS = ("clamped", "pinned", "guided", "supported")
NORMAL_FRAME = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # cut frame with z along the sheet's y


@dataclass(frozen=True)
class Support:
    """Support of an edge of a sheet, or of a part of it; a node on two edges has the support that is given first.

    Parameters
    ----------
    edge
        ``x0`` (x = 0), ``x1`` (x = length), ``z0`` (z = 0), ``z1`` (z = width).
    kind
        ``clamped``: no translation and rotation; ``pinned``: rotates about the edge; ``guided`` and ``supported``: the
        same two, but free to slide and rotate in the plane. A flat sheet that is connected to one support cannot deform
        in its plane for a second one: use ``guided`` or ``supported`` there.
    span
        First and last coordinate along the edge, m; nodes between them are held. None: the whole edge.
    body
        Body that holds the edge; a body at the end of driven joints prescribes its motion. None: the ground.
    at, rotation
        Frame of the sheet in the frame of ``body``. None: as given for the sheet.
    """

    edge: str
    kind: str = "clamped"
    span: tuple[float, float] | None = None
    body: Body | None = None
    at: Vector | None = None
    rotation: Any = None


def check_support(what: str, support: Support) -> None:
    """Refuse what no support can be."""
    if not isinstance(support, Support):
        raise UserError(f"support of {what} is {support!r}; it must be a Support")
    one_of(f"edge of a support of {what}", support.edge, SHEET_EDGES)
    one_of(f"kind of the support at {support.edge!r} of {what}", support.kind, SUPPORT_KINDS)


def cut_of(support: Support, first: bool) -> tuple[type[CutJoint], Matrix]:
    """Kind of the cut joint of a held node, and its frame in the sheet's; ``first``: it holds the plane too."""
    if support.kind == "clamped" and first:
        return WeldCutJoint, np.eye(3)
    if support.kind == "pinned" and first:
        return RevoluteCutJoint, np.eye(3) if support.edge[0] == "x" else NORMAL_FRAME.T
    return PlanarCutJoint if support.kind in ("clamped", "guided") else PlaneCutJoint, NORMAL_FRAME
