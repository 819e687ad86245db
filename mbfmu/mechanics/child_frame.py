"""Joints whose frame on the child is not the child's frame, and joints that the tree has in the opposite direction.

The kernels of a joint write the motion of its second frame J_b relative to its first, J_a, into State.rel: R, p and
the columns S_k = (u_k, w_k). If the flag ``attached`` of a body is 0, J_a is fixed in the parent and J_b coincides with
the frame of the child. Otherwise

1. ``reversed`` = 1: J_b is fixed in the parent and J_a in the child. The motion of J_a relative to J_b, axes of J_b, is

       R := R^T,   p := -R^T p,   S_k := -R^T (u_k - w_k x p ;  w_k)

2. the frame of the child has the origin -R_c^T s_c and the axes R_c^T in the joint frame that is fixed in it, s_c and
   R_c being origin and axes of this joint frame in the child. With rho = -R R_c^T s_c

       R := R R_c^T,   p := p + rho,   S_k := (u_k + w_k x rho ;  w_k)

The biases b = sum_k v_k dS_k/dt follow by differentiation, with (u, w) = sum_k v_k S_k.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import BodyRecord, RelativeMotionRecord
    from solvers.compiled.record import Reals


@kernel
def attach_child(body: BodyRecord, rel: RelativeMotionRecord) -> None:
    """Replace the motion of J_b relative to J_a by that of the child relative to the joint frame in its parent."""
    R, S, p, axes = rel.R, rel.S, rel.p, body.child_R
    if body.reversed == 1:
        px, py, pz = p[0], p[1], p[2]
        for k in range(body.nv):
            a, b, c = S[k, 3], S[k, 4], S[k, 5]
            x = S[k, 0] - (b * pz - c * py)
            y = S[k, 1] - (c * px - a * pz)
            z = S[k, 2] - (a * py - b * px)
            for i in range(3):
                S[k, i] = -(R[0, i] * x + R[1, i] * y + R[2, i] * z)
                S[k, 3 + i] = -(R[0, i] * a + R[1, i] * b + R[2, i] * c)
        for i in range(3):
            p[i] = -(R[0, i] * px + R[1, i] * py + R[2, i] * pz)
        for i in range(3):
            for j in range(i):
                R[i, j], R[j, i] = R[j, i], R[i, j]
    for i in range(3):
        x, y, z = R[i, 0], R[i, 1], R[i, 2]
        for j in range(3):
            R[i, j] = x * axes[j, 0] + y * axes[j, 1] + z * axes[j, 2]
    rx, ry, rz = _offset(R, body.child_s, 0), _offset(R, body.child_s, 1), _offset(R, body.child_s, 2)
    p[0] += rx
    p[1] += ry
    p[2] += rz
    for k in range(body.nv):
        a, b, c = S[k, 3], S[k, 4], S[k, 5]
        S[k, 0] += b * rz - c * ry
        S[k, 1] += c * rx - a * rz
        S[k, 2] += a * ry - b * rx


@kernel
def attach_bias(body: BodyRecord, v: Reals, rel: RelativeMotionRecord) -> None:
    """Replace the bias of J_b relative to J_a, whose motion is in ``rel``, by that of :func:`attach_child`, which then
    is in ``rel`` too; the velocities are ``v[body.vi]`` and following.
    """
    R, S, p, b = rel.R, rel.S, rel.p, rel.bias
    if body.reversed == 1:
        ux, uy, uz, wx, wy, wz = _rate(S, v, body.vi, body.nv)
        px, py, pz = p[0], p[1], p[2]
        cx, cy, cz = wy * pz - wz * py - 2.0 * ux, wz * px - wx * pz - 2.0 * uy, wx * py - wy * px - 2.0 * uz
        ax, ay, az = b[3], b[4], b[5]
        x = b[0] - (ay * pz - az * py) + wy * cz - wz * cy
        y = b[1] - (az * px - ax * pz) + wz * cx - wx * cz
        z = b[2] - (ax * py - ay * px) + wx * cy - wy * cx
        for i in range(3):
            b[i] = -(R[0, i] * x + R[1, i] * y + R[2, i] * z)
            b[3 + i] = -(R[0, i] * ax + R[1, i] * ay + R[2, i] * az)
    attach_child(body, rel)
    _, _, _, wx, wy, wz = _rate(S, v, body.vi, body.nv)
    rx, ry, rz = _offset(R, body.child_s, 0), _offset(R, body.child_s, 1), _offset(R, body.child_s, 2)
    cx, cy, cz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    b[0] += b[4] * rz - b[5] * ry + wy * cz - wz * cy
    b[1] += b[5] * rx - b[3] * rz + wz * cx - wx * cz
    b[2] += b[3] * ry - b[4] * rx + wx * cy - wy * cx


@kernel
def _offset(R: Reals, frame: Reals, i: int) -> float:
    """Component i of -R s, s = ``frame``: from the joint frame to the origin of the child whose axes are R."""
    return -(R[i, 0] * frame[0] + R[i, 1] * frame[1] + R[i, 2] * frame[2])


@kernel
def _rate(S: Reals, v: Reals, vi: int, nv: int) -> tuple[float, float, float, float, float, float]:
    """Relative velocity sum_k v_k S_k."""
    ux = uy = uz = wx = wy = wz = 0.0 * S[0, 0]
    for k in range(nv):
        x = v[vi + k]
        ux += x * S[k, 0]
        uy += x * S[k, 1]
        uz += x * S[k, 2]
        wx += x * S[k, 3]
        wy += x * S[k, 4]
        wz += x * S[k, 5]
    return ux, uy, uz, wx, wy, wz
