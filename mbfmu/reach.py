"""Drives and rates that loops cannot follow: unreachable positions, and rates that are not determined."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.codes import coded
from mbfmu.errors import AssemblyError
from mbfmu.mechanics import Plant
from mbfmu.mechanics.arrays.assembly import free_bodies
from solvers.outcome import Code, Status
from solvers.system import Array

MARCH = 100  # intervals of the requested time, in which loops are closed one after the other
EXACT = 1e-9  # of that time, to which the last position they reach is found
BEYOND = (1e-6, 1e-4, 1e-2)  # of that time: where they are tried after it, as a run may pass a singular configuration
OPEN = 1e-10  # singular values below this part of the largest are zero
PART = 1e-6  # of the largest: what a joint has to do with a motion


def why(plant: Plant, status: Status, q: Array, end: float, starts_singular: bool) -> str:
    """Return why a run stopped at q (nq,) on its way to ``end`` (s), and what to do.

    ``starts_singular``: whether the loops do not determine all rates at the start.
    """
    stuck = status.code in (Code.BRANCHES, Code.COLLAPSED, Code.NOT_CLOSED)
    advice = to_choose(plant, status.t, q) if starts_singular else ""
    if advice and status.code in (Code.BRANCHES, Code.UNDECIDABLE):
        return status.explain(advice)
    drives = [body.name for body in plant.mechanism.bodies if body.joint.drive is not None]
    until = 2.0 * end - status.t  # beyond the requested time: it may end right there
    last = _last(plant, status.t, q, until) if stuck and drives and plant.system.has_matrices else until
    if last == until:
        return status.explain()
    whose = f"the drive of {drives[0]!r} requires" if len(drives) == 1 else "the drives require"
    return coded(
        "unreachable-drive",
        f"{whose} a position that the loops cannot reach after t = {last:.6g} s (the run stopped at "
        f"t = {status.t:.9g} s). Shorten the motion of the drive, or change the lengths of the loops.",
    )


def _last(plant: Plant, begin: float, q: Array, end: float) -> float:
    """Return until when loops can be closed, s: ``end`` where nothing ends that."""
    held, whole = np.zeros(plant.system.n, bool), end - begin
    reached, step = begin, whole / MARCH

    def closed(t: float) -> Array | None:
        try:
            return plant.assembly.close(t, q, held)
        except AssemblyError:
            return None

    while reached < end and step > EXACT * whole:
        ahead = min(reached + step, end)
        there = closed(ahead)
        if there is None:
            step *= 0.5
        else:
            reached, q = ahead, there
    opens = reached < end and all(closed(min(reached + part * whole, end)) is None for part in BEYOND)
    return reached if opens else end


def to_choose(plant: Plant, t: float, q: Array) -> str:
    """Return a message on the rates that choose the branch in a singular configuration q (nq,); empty: all given."""
    names = [repr(name) for name in open_rates(plant, t, q)]
    if not names:
        return ""
    joints = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    return f"Give the rate{'s' if len(names) > 1 else ''} of {joints} to choose the branch"


def explain_rates(plant: Plant, t: float, q: Array, v: Array, tolerance: float) -> str:
    """Return why the rates v (n,) belong to no branch of the motion in a singular configuration q (nq,); empty: they
    do.

    An acceleration exists if J v' = gamma has a solution: if u^T gamma = 0 for all u with u^T J = 0. In a singular
    position this is the tangent cone of the constraints. Deviations of the rates from it, relative to them, are
    compared with ``tolerance``.
    """
    system: Any = plant.system
    terms = system.allocate_terms()
    system.fill(t, q, v, terms)
    U, sigma, _ = np.linalg.svd(terms.J * system.size / system.row_size[:, None])
    left = U[:, int(np.sum(sigma > OPEN * sigma[0])) :]
    off = np.abs(left.T @ (terms.gamma / system.row_size)).max(initial=0.0)
    rates = np.square(v / system.size).sum() + np.square(terms.nu / system.row_size).sum()
    if off <= tolerance * rates:
        return ""
    bodies, first, values = free_bodies(plant.mechanism), 0, []
    for body in bodies:
        values += [f"{body.name!r} {x:.6g}" for x in v[first : first + body.joint.nv]]
        first += body.joint.nv
    return (
        "the start is a singular configuration, in which several branches of the motion cross, and the given rates are "
        f"not those of any branch ({', '.join(values)}). {to_choose(plant, t, q) or 'Give other rates'}"
    )


def open_rates(plant: Plant, t: float, q: Array) -> tuple[str, ...]:
    """Return the joints whose rates the loops do not determine at q (nq,), and that were not given one."""
    system: Any = plant.system
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    _, sigma, V = np.linalg.svd(terms.J * system.size / system.row_size[:, None])
    null = V[int(np.sum(sigma > OPEN * sigma[0])) :]
    moved = np.linalg.norm(null, axis=0) > PART
    first, names = 0, []
    for body in free_bodies(plant.mechanism):
        if body.joint.rate is None and moved[first : first + body.joint.nv].any():
            names.append(body.name)
        first += body.joint.nv
    return tuple(names)
