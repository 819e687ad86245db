"""Kernels of user-defined joints, compared with derivatives of the pose that they write.

A joint whose velocities are not those of its pose, or whose bias is wrong, moves in a wrong way without any other sign.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.records import Arrays, RelativeMotionRecord, State
from mbfmu.util.errors import UserError
from solvers.compiled.record_view import complex_dtype
from solvers.system import Array

from .tables import CalledKernel

EPSILON = 1e-30  # of the complex step
DERIVATIVE_TOLERANCE, POSE_TOLERANCE = 1e-6, 1e-11  # deviation from the derivative, relative to it and to the pose
CHECK_DISTANCE = 0.37  # of a second position, from the start; and velocity, in units of the coordinates
FIXES = {
    "place": "columns of the motion subspace in rel.S (linear velocity of the child's origin, then angular "
    "velocity, in axes of the joint frame) that are the derivatives of the pose in rel.R and rel.p",
    "bias": "sum over k of v_k times the time derivative of rel.S[k]; without a kernel bias it is zero",
}


def check_joints(
    mechanism: Mechanism, called: list[CalledKernel | None], foreign: set[int], arrays: Arrays, state: State
) -> None:
    """Raise UserError if the kernels of a user-defined joint contradict each other at the start or near it.

    Joints with a quaternion are left out: their positions have no derivatives by the velocities alone.
    """
    for body, own in zip(mechanism.bodies[1:], arrays.bodies[1:], strict=True):
        place = called[int(own["kind"])] if int(own["kind"]) in foreign else None
        if place is None or body.joint.quaternion or not body.joint.nv:
            continue
        bias = called[int(own["kind"]) + 1]
        first, count = int(own["qi"]), body.joint.nv
        at = int(own["at"])
        record = arrays.memory[at : at + place.record.itemsize].view(place.record).view(np.recarray)[0]
        joint = _JointProbe(record, place.function, bias.function if bias is not None else None, count)
        near = state.q[first : first + count]
        if left := joint.unwritten(near):
            raise UserError(
                f"joint of body {body.name!r}: kernel 'place' of {type(body.joint).__name__} does not write all of "
                f"{left}; allowed: all entries of rel.R and rel.p, and the first {count} lines of rel.S, are written, "
                "because rel contains what another joint has written"
            )
        wrong = [name for q in (near, near + CHECK_DISTANCE) for name in joint.contradictions(q)]
        if wrong:
            name = max(wrong)  # "place" before "bias"
            raise UserError(
                f"joint of body {body.name!r}: kernel {name!r} of {type(body.joint).__name__} contradicts the pose "
                f"that 'place' writes; allowed: {FIXES[name]}"
            )


class _JointProbe:
    """Kernels of a joint as plain Python in complex numbers."""

    def __init__(self, record: Any, place: Any, bias: Any, count: int) -> None:
        self._record, self._count = record, count
        self._place: Callable[..., None] = getattr(place, "py_func", place)
        self._bias: Callable[..., None] | None = bias and getattr(bias, "py_func", bias)

    def contradictions(self, q: Array) -> list[str]:
        """Return the names of the kernels that are wrong at positions q (nv,); none if they cannot be called there."""
        try:
            with np.errstate(all="ignore"):
                (S, R, p), (dS, dR, dp) = self._written(q.astype(complex)), self._slopes(q)
                given = self._given_bias(q)
        except Exception:  # the run reports it
            return []
        n = self._count
        if not all(np.isfinite(part).all() for part in (S, R, p, dS, dR, dp)):
            return []
        S, R, far = S.real, R.real, np.abs(p.real).max()
        turns = dR @ R.T
        angular = np.stack((turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]), axis=1)
        v = CHECK_DISTANCE * (1.0 + np.arange(n))
        expected = np.einsum("k,j,jkc->c", v, v, dS[:, :n])
        pairs = {
            "place": ((S[:n, :3], dp, far), (S[:n, 3:], angular, 1.0)),
            "bias": (
                (given[:3], expected[:3], far + np.abs(dp).max(initial=0.0)),
                (given[3:], expected[3:], 1.0),
            ),
        }
        return [name for name, parts in pairs.items() if any(_differ(*part) for part in parts)]

    def unwritten(self, q: Array) -> str:
        """Return which part of ``rel`` the kernel ``place`` does not write at positions q (nv,); empty: none."""
        try:
            with np.errstate(all="ignore"):
                before, after = (self._written(q.astype(complex), fill) for fill in (0.0, np.nan))
        except Exception:  # the run reports it
            return ""
        for name, zero, none in zip(("rel.S", "rel.R", "rel.p"), before, after, strict=True):
            count = self._count if name == "rel.S" else len(zero)
            if np.isfinite(zero[:count]).all() and not np.isfinite(none[:count]).all():
                return name
        return ""

    def _written(self, q: Any, fill: float = 0.0) -> tuple[Any, Any, Any]:
        """Return S (6, 6), R (3, 3) and p (3,) at complex positions; what is not written is ``fill``."""
        rel = np.zeros(1, complex_dtype(RelativeMotionRecord.dtype)).view(np.recarray)
        for part in (rel.S, rel.R, rel.p):
            part[:] = fill
        self._place(self._record, 0, SimpleNamespace(q=q, rel=rel))
        return rel.S[0], rel.R[0], rel.p[0]

    def _slopes(self, q: Array) -> list[Array]:
        """Return the derivatives (nv, ...) of S, R and p by the positions."""
        steps = EPSILON * 1j * np.eye(self._count)
        written = [self._written(q + step) for step in steps]
        return [np.array(parts).imag / EPSILON for parts in zip(*written, strict=True)]

    def _given_bias(self, q: Array) -> Array:
        rel = np.zeros(1, RelativeMotionRecord.dtype).view(np.recarray)
        if self._bias is not None:
            state = SimpleNamespace(q=q, v=CHECK_DISTANCE * (1.0 + np.arange(self._count)), rel=rel)
            self._place(self._record, 0, state)
            self._bias(self._record, 0, 0, state)
        return np.asarray(rel.bias[0])


def _differ(given: Array, expected: Array, size: float) -> bool:
    largest = max(np.abs(given).max(initial=0.0), np.abs(expected).max(initial=0.0))
    return bool(np.abs(given - expected).max(initial=0.0) > DERIVATIVE_TOLERANCE * largest + POSE_TOLERANCE * size)
