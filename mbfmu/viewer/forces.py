"""Forces of a mechanism at work, for the arrows of a picture: read where its outputs were read last.

A source is one of three: a cut joint, a force of :meth:`mbfmu.mechanics.Mechanism.force`, the joint of a driven body.
It gets the force on one body (of two the first that is not the ground; of a cut joint b, of a force a comes first) and
the moment about the point at which it is applied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.recursions.applied import apply_single_load

Array = NDArray[np.float64]

NEGLIGIBLE_FORCE_RATIO = 1e-9  # of the largest force, or moment: rounding
ARROW_UNITS = ("N", "N.m")
# percentile of the forces that sets the scale: near a singular configuration some are very large
FORCE_SCALE_PERCENTILE = 95
ARROW_LENGTH_RATIO = 0.15  # of the size of what is shown: about as long is an arrow


@dataclass(frozen=True, kw_only=True)
class Arrow:
    """A force or a moment that is shown on a body."""

    name: str
    kind: str  # cut, load or drive
    body: int
    at: tuple[float, ...]  # body axes, m
    unit: str  # N or N.m


@dataclass(frozen=True)
class Source:
    """What exerts a force, and where on which body."""

    name: str
    kind: str
    index: int  # among cut joints, loads or bodies
    body: int
    at: tuple[float, ...]


def sources(mechanism: Mechanism) -> list[Source]:
    """Return what exerts forces: cut joints, then forces, then drives."""
    found = []
    for cut in mechanism.cuts:
        body, at = (cut.b, cut.cut.at_b) if cut.b.index else (cut.a, cut.cut.at_a)
        found.append(Source(cut.name, "cut", cut.index, body.index, point(at)))
    for k, (name, force, a, b) in enumerate(mechanism.forces):
        ends = force.points() or ((0.0, 0.0, 0.0),) * 2
        body, at = (a, ends[0]) if a.index else (b, ends[1])
        found.append(Source(name, "load", k, body.index, point(at)))
    for body in mechanism.bodies:
        if body.joint.drive is not None:
            found.append(Source(body.name, "drive", body.index, body.index, (0.0, 0.0, 0.0)))
    return found


def point(at: Any) -> tuple[float, ...]:
    """Return plain floats."""
    return tuple(float(x) for x in at)


def read(compiled: CompiledMechanism, found: list[Source], t: float) -> Array:
    """Return force and moment (sources, 2, 3), global axes, N and N m, in the state whose outputs were read last."""
    arrays, state = compiled.data
    wrenches = np.zeros((len(found), 6))
    for wrench, source in zip(wrenches, found, strict=True):
        if source.kind == "cut":
            cut = arrays.cuts[source.index]
            rows = state.rows[int(cut["row"]) : int(cut["end"])]
            wrench[:] = -(rows["lam"] @ rows["Gb" if cut["b"] == source.body else "Ga"])
        elif source.kind == "drive":
            wrench[:] = state.bodies["W"][source.body]
    loads = [k for k, source in enumerate(found) if source.kind == "load"]
    if loads:
        wrenches[loads] = load_wrenches(compiled, [found[k] for k in loads], t)
    at = np.array([source.at for source in found]).reshape(-1, 3)
    arms = np.einsum("kij,kj->ki", state.bodies["A"][[source.body for source in found]], at)
    return np.stack((wrenches[:, :3], wrenches[:, 3:] - cross(arms, wrenches[:, :3])), axis=1)


def cross(a: Array, b: Array) -> Array:
    """Return the vector products of the rows of a and b (n, 3); numpy.cross takes ten times as long for a few rows."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def load_wrenches(compiled: CompiledMechanism, found: list[Source], t: float) -> Array:
    """Return what forces exert on their bodies (loads, 6), about the origins: each alone, and the state as it was."""
    state, bodies = compiled.data.state, compiled.data.arrays.bodies
    kept = state.bodies["F"].copy(), state.Q.copy(), state.cached_power.copy()
    wrenches = np.zeros((len(found), 6))
    for k, source in enumerate(found):
        state.bodies["F"][:] = 0.0
        state.Q[:] = 0.0
        apply_single_load(source.index, t, *compiled.kernel_data)
        wrenches[k] = state.bodies["F"][source.body]
        if compiled.mechanism.forces[source.index][1].on_joint:
            own = bodies[source.body]
            wrenches[k] += state.Q[int(own["vi"])] * state.S[int(own["si"])]
    state.bodies["F"][:], state.Q[:], state.cached_power[:] = kept
    return wrenches


def shown(found: list[Source], values: Array, size: float) -> tuple[tuple[Arrow, ...], Array]:
    """Return arrows and their vectors (T, arrows, 3), of ``values`` (T, sources, 2, 3): what is no more than rounding
    of something ``size`` (m) large is left out.
    """
    finite = np.where(np.isfinite(values), values, 0.0)
    largest = np.linalg.norm(finite, axis=-1).max(axis=0, initial=0.0)  # (sources, 2)
    force, moment = largest.max(axis=0, initial=0.0)
    least = NEGLIGIBLE_FORCE_RATIO * np.array((force, max(moment, force * size)))
    arrows, vectors = [], [np.zeros((len(values), 0, 3))]
    for k, source in enumerate(found):
        for which, unit in enumerate(ARROW_UNITS):
            if largest[k, which] > least[which]:
                arrows.append(Arrow(name=source.name, kind=source.kind, body=source.body, at=source.at, unit=unit))
                vectors.append(values[:, k, which][:, None])
    return tuple(arrows), np.concatenate(vectors, axis=1)


def scales(arrows: tuple[Arrow, ...], vectors: NDArray[Any], size: float) -> dict[str, tuple[float, float]]:
    """Return by unit a round force or moment and the length (m) of its arrow, in a picture ``size`` (m) across."""
    found = {}
    for unit in ARROW_UNITS:
        own = np.linalg.norm(vectors[:, [arrow.unit == unit for arrow in arrows]].astype(float), axis=-1)
        own = own[np.isfinite(own) & (own > 0.0)]
        if len(own) and size > 0.0:
            found[unit] = (
                rounded(float(np.percentile(own, FORCE_SCALE_PERCENTILE))),
                rounded(ARROW_LENGTH_RATIO * size),
            )
    return found


def rounded(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above a positive number."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(digit * power for digit in (1.0, 2.0, 5.0) if digit * power <= value * (1.0 + 1e-12)))
