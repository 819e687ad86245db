"""What loads estimate from the compiled mechanism: inertia and size of the coordinate they act on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy

from mbfmu.mechanics.builder.loading import Acting
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import NO_JAM
from solvers.system import TreeSystem

from .assembly import start_positions
from .scale import joint_sizes

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Data
    from solvers.system import AnySystem, Array

REDUNDANT_SINGULAR_RATIO = 1e-9  # of singular values, relative to the largest


def sticking_loads(mechanism: Mechanism, data: Data) -> Iterator[tuple[Acting, Any]]:
    """Yield the loads that stick, each with its record."""
    for acting, place in zip(mechanism.loads(), data.arrays.loads["at"], strict=True):
        if acting.load.stick_reason:
            dtype = record_of(acting.load)
            yield acting, data.arrays.memory[place : place + dtype.itemsize].view(dtype)[0]


def fill_estimates(mechanism: Mechanism, system: AnySystem, data: Data, length: float) -> None:
    """Write the estimates of all loads that stick, at the start positions of a mechanism of this length, m."""
    found = list(sticking_loads(mechanism, data))
    if not found:
        return
    dense = system.dense() if isinstance(system, TreeSystem) and system.dense is not None else system
    q = start_positions(mechanism)
    motions = free_motions(dense, q)
    inertias = coordinate_inertias(dense, motions)
    between = [(acting, record) for acting, record in found if not acting.load.on_joint]
    for (acting, record), slips in zip(between, slip_derivatives(dense, between, data, q), strict=True):
        moved = slips * dense.size[: len(slips)]
        if acting.load.slip(record, data.state.bodies) is None:
            acting.load.fill_estimates(record, float(data.arrays.bodies["mass"][acting.bodies[0].index]), length)
        else:
            acting.load.fill_estimates(record, slip_inertia(moved, motions), np.abs(moved).max(initial=0.0) or length)
    for acting, record in found:
        if not acting.load.on_joint:
            continue
        body = acting.bodies[0]
        k = int(data.arrays.bodies["vf"][body.index])
        along, arms = np.array(acting.load.coordinates), np.array(acting.load.arms)
        inertia = float((inertias[k + along] / arms**2).mean()) if k >= 0 else 0.0  # else a drive moves it
        acting.load.fill_estimates(record, inertia, bearing_size(acting, length))
    for name in ("jam_time", "undetermined_time"):
        data.state.bearings[name] = NO_JAM  # evaluations without estimates count for none


def bearing_size(acting: Acting, length: float) -> float:
    """Return the displacement of the bearing of a load along coordinates by the size of these, rad or m: the least."""
    body = acting.bodies[0]
    sizes = joint_sizes(body.name, body.joint, length)[list(acting.load.coordinates)]
    return float((sizes * acting.load.arms).min())


def unresolved_loads(
    mechanism: Mechanism, data: Data, length: float, tolerance: float
) -> list[tuple[str, float, float]]:
    """Return the loads whose displacements the tolerance does not resolve: what messages call them, the displacement
    and the tolerance of their coordinate, rad or m.
    """
    found = []
    for acting, record in sticking_loads(mechanism, data):
        displacement = acting.load.resolved_displacement(record)
        allowed = tolerance * acting.load.nominal_displacement(record, length)
        if displacement < (1.0 - 1e-9) * allowed:
            found.append((acting.what, displacement, allowed))
    return found


def slip_derivatives(system: AnySystem, loads: list[tuple[Acting, Any]], data: Data, q: Array) -> Array:
    """Return the derivatives (loads, n) of the slips of loads, given with their records, by the velocities at positions
    q (nq,); zero for a load without a single slip.
    """
    terms, v, found = system.allocate_terms(), np.zeros(system.n), np.zeros((len(loads), system.n_velocities))

    def slips() -> Array:
        system.fill(0.0, q, v, terms)
        return np.array([acting.load.slip(record, data.state.bodies) or 0.0 for acting, record in loads])

    for k in range(system.n_velocities if loads else 0):
        v[k] = 1.0
        found[:, k], v[k] = slips(), 0.0
    return found - slips()[:, np.newaxis]  # less those of drives


def slip_inertia(moved: Array, motions: FreeMotions) -> float:
    """Return the inertia that a slip moves, kg: 1 / (j M^-1 j) with its derivatives j by the velocities, which are
    given in sizes of the coordinates, for the motions that the constraints allow; 0: they allow none.
    """
    mobility = float(np.sum((motions.directions @ moved) ** 2 / motions.masses))
    return 1.0 / mobility if mobility > 0.0 else 0.0


class FreeMotions(NamedTuple):
    """Orthogonal motions that the constraints allow, scaled by the sizes of the coordinates."""

    masses: Array  # (k,)
    directions: Array  # (k, n)
    diagonal: Array  # (n,) of the mass matrix


def free_motions(system: AnySystem, q: Array) -> FreeMotions:
    """Return the motions that the constraints allow at positions q (nq,)."""
    terms, moving = system.allocate_terms(), system.n_velocities
    system.fill(0.0, q, np.zeros(system.n), terms)
    size, motions = system.size[:moving], np.eye(moving)
    scaled = terms.M[:moving, :moving] * np.outer(size, size)
    found = np.diag(scaled).copy()
    if system.m:
        _, sigma, motions = scipy.linalg.svd(terms.J[:, :moving] * size / system.row_size[:, np.newaxis])
        motions = motions[int(np.sum(sigma > REDUNDANT_SINGULAR_RATIO * sigma.max(initial=0.0))) :]
    values, vectors = scipy.linalg.eigh(motions @ scaled @ motions.T)
    inert = values > REDUNDANT_SINGULAR_RATIO * values.max(initial=0.0)
    return FreeMotions(values[inert], vectors[:, inert].T @ motions, found)


def coordinate_inertias(system: AnySystem, motions: FreeMotions) -> Array:
    """Return the inertia that each coordinate moves, kg m^2 or kg: 1 / (e M^-1 e) for the motions that the constraints
    allow. Its diagonal entry of M if they do not allow any, or if M is singular.
    """
    found = motions.diagonal.copy()
    mobility = np.sum(motions.directions**2 / motions.masses[:, np.newaxis], axis=0)
    allowed = mobility * found > REDUNDANT_SINGULAR_RATIO
    found[allowed] = 1.0 / mobility[allowed]
    return np.asarray(found / system.size[: system.n_velocities] ** 2)
