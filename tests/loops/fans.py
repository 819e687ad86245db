"""Parallelograms on one column, each with its base line tilted by a different angle, so that they become singular one
after the other: as the column passes each tilt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, pi, sin
from typing import Any

import numpy as np
from mechanisms import Case, G, swinging

from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint, rod


def fan(
    tilts: Sequence[float],
    *,
    start: float = 0.5 * pi,
    rate: float = -1.0,
    longer: Mapping[int, float] | None = None,
    drive: Any = None,
    motion: Any = None,
    stop_time: float = 2.0,
) -> Case:
    """Columns of 1 m and 1 kg that stay parallel to the first one, joined to its top by couplers of 1 m and 1 kg.

    ``tilts`` of the couplers (rad); ``start`` and ``rate`` of the columns (rad, rad/s), or the ``drive`` of the first
    one and its ``motion``: a function of time (k,) that gives angle and rate. ``longer`` maps the number of a coupler
    to the length that is added to it: its loop then misses its singular configurations.
    """
    m = Mechanism(gravity=(0.0, -G, 0.0))
    joint = Revolute(start=start, rate=rate, fixed=True) if drive is None else Revolute(drive=drive)
    if drive is not None:
        start, rate = map(float, motion(0.0))
    first, signs = m.body("column0", m.ground, joint, **rod(mass=1.0, length=1.0)), []
    for i, tilt in enumerate(tilts):
        reach, foot = 1.0 + (longer or {}).get(i, 0.0), (cos(tilt), sin(tilt), 0.0)
        pin = Revolute(at=(1.0, 0.0, 0.0), start=tilt - start, rate=-rate)
        coupler = m.body(f"coupler{i}", first, pin, **rod(mass=1.0, length=reach))
        column = m.body(
            f"column{i + 1}", m.ground, Revolute(at=foot, start=start, rate=rate), **rod(mass=1.0, length=1.0)
        )
        m.cut(f"pin{i}", RevoluteCutJoint(at_a=(reach, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, column)
        signs += [-1.0, 1.0]
    N = len(tilts)
    at, way = np.array([x for tilt in tilts for x in (tilt, 0.0)]), np.array(signs)

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        q, v = at + np.outer(a, way), np.outer(b, way)
        return (q, v) if drive is not None else (np.column_stack((a, q)), np.column_stack((b, v)))

    def driven(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        angle, speed = motion(np.asarray(times))
        return embed(angle + nudge, speed + 0.0 * angle)

    free = swinging((N + 1) / 3.0 + N, (0.5 * (N + 1) + N) * G, (start, rate), embed)
    exact = None if longer else driven if drive is not None else free
    return Case(m, exact, stop_time)


def parallel(tilts: Sequence[float], angle: float, folded: Sequence[int] = ()) -> Any:
    """Closed positions with the first column at ``angle`` (rad): loops are parallelograms, or ``folded``: coupler on
    the first column, its own column on the base line. These branches cross at tilt + pi.
    """
    q = [angle]
    for i, tilt in enumerate(tilts):
        q += [-pi, tilt + pi] if i in folded else [tilt - angle, angle]
    return np.array(q)


def turned(tilts: Sequence[float], loops: Sequence[int], turn: float) -> Any:
    """Closed as well: the first column lies on the base line of ``loops`` of one tilt, and their couplers and columns
    have turned about its end by ``turn`` (rad). This branch crosses that of the parallelograms at the tilt.
    """
    angle = tilts[loops[0]]
    q = [angle]
    for i, tilt in enumerate(tilts):
        q += [tilt + turn - angle, tilt + turn] if i in loops else [tilt - angle, angle]
    return np.array(q)
