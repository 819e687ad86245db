"""The closed loops of a mechanism, one for every cut joint: through which bodies, how large, and how well closed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.rounded import loop_path
from mbfmu.mechanics.arrays.rows import row_names
from mbfmu.mechanics.builder.handles import CutHandle
from solvers.system import Array


@dataclass(frozen=True, kw_only=True)
class Loop:
    """A loop that a cut joint closes.

    Attributes
    ----------
    name
        Of the cut joint.
    bodies
        Those it goes through, from body a of the cut joint to body b.
    size
        Largest distance between two joints of one of its bodies, m.
    rows
        How many the cut joint has.
    vanishing, redundant
        Names of its rows that no motion works against, and of those that depend on others wherever it is.
    gap
        By how much it was open at most, in units of its size or in rad; not a number where nothing ran.
    """

    name: str
    bodies: tuple[str, ...]
    size: float
    rows: int
    vanishing: tuple[str, ...]
    redundant: tuple[str, ...]
    gap: float


def loops(compiled: CompiledMechanism, redundant: Collection[str], gaps: Array) -> tuple[Loop, ...]:
    """Return every loop; ``redundant`` are names of rows, ``gaps`` (m,) the largest residuals of all, m or rad."""
    names = list(compiled.system.constraint_names)
    found = []
    for handle in compiled.mechanism.cuts:
        rows = row_names([handle])
        path, size = loop_path(compiled.mechanism, handle), loop_size(compiled, handle)
        units = dict(zip(rows, handle.units, strict=True))
        own = [gaps[names.index(r)] / (size if units[r] == "m" else 1.0) for r in rows if r in names]
        found.append(
            Loop(
                name=handle.name,
                bodies=tuple(dict.fromkeys(body_name(compiled.mechanism, k) for k in path)),
                size=size,
                rows=len(rows),
                vanishing=tuple(r for r in rows if r in compiled.vanishing_rows),
                redundant=tuple(r for r in rows if r in redundant),
                gap=float(max(own, default=0.0)),
            )
        )
    return tuple(found)


def body_name(mechanism: Mechanism, k: int) -> str:
    """Return the name of a body, of a part of an elastic one that of the whole."""
    name = mechanism.bodies[k].name
    for whole in (body.name for body in mechanism.flexible_bodies):
        if name.startswith((f"{whole}.", f"{whole}[")):
            return whole
    return name


def loop_size(compiled: CompiledMechanism, handle: CutHandle) -> float:
    """Return the largest distance between two joints of one body of a loop, m; of a loop in one point the compiled
    mechanism's.
    """
    mechanism, bodies = compiled.mechanism, compiled.data.arrays.bodies
    path = loop_path(mechanism, handle)
    points: dict[int, list[Array]] = {k: [] for k in path}
    for k in path:
        parent = int(bodies[k]["parent"])
        if k > 0 and parent in points:
            points[k].append(bodies[k]["child_s"])
            points[parent].append(bodies[k]["s"])
    for on, body in (("a", handle.a.index), ("b", handle.b.index)):
        points[body].append(handle.cut.nearest(on, *points[body][:1]))
    spans = [float(np.linalg.norm(p - q)) for own in points.values() for p in own for q in own]
    return max(spans, default=0.0) or float(compiled.length)


def redundant_rows(compiled: CompiledMechanism, t: float, q: Array) -> tuple[str, ...]:
    """Return the names of the redundant constraint equations about q (nq,), away from singular configurations."""
    found = compiled.assembly.find_redundant(t, compiled.assembly.nearby(t, q))
    return tuple(compiled.system.constraint_names[k] for k in found)
