"""Interface of the recursions to flexible bodies: planar beams and bodies of finite elements, by their records.

``numbers`` is Arrays.numbers, where the data of bodies of finite elements are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import inlined, kernel

from . import planar, solid

if TYPE_CHECKING:
    from mbfmu.mechanics.records import BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals

    from .records import FlexibleRecord, NodeRecord


@inlined
def place_section(
    body: BodyRecord, node: NodeRecord, parent: MotionRecord, here: MotionRecord, state: State, numbers: Reals
) -> None:
    """Position r, A of a section and its rows of the motion subspaces; ``parent`` is the body's frame."""
    if node.at < 0:
        planar.place_section(body, node, parent, here, state)
    else:
        solid.place_section(body, node, parent, here, state, numbers)


@inlined
def add_section_bias(
    body: BodyRecord, node: NodeRecord, frame: MotionRecord, state: State, numbers: Reals, beta: Reals
) -> None:
    """Add to the velocity products of a section what the changing of its subspace adds."""
    if node.at >= 0:
        solid.add_section_bias(body, node, frame, state, numbers, beta)
    elif node.shortens > 0:
        planar.add_section_bias(body, node, frame, state, beta)


@inlined
def composite(elastic: FlexibleRecord, here: MotionRecord, q: Reals, numbers: Reals) -> None:
    """Mass, first moment and inertia about the origin of the deformed body, global axes."""
    if elastic.at < 0:
        planar.composite(elastic, here, q)
    else:
        solid.composite(elastic, here, q, numbers)


@inlined
def modal_mass(elastic: FlexibleRecord, k: int, numbers: Reals) -> float:
    """mu_k, kg."""
    return elastic.mu[k] if elastic.at < 0 else solid.modal_mass(elastic, k, numbers)


@inlined
def coupling(elastic: FlexibleRecord, k: int, here: MotionRecord, q: Reals, numbers: Reals, out: Reals) -> None:
    """out = momentum wrench of p'_k = 1 about the origin, global axes."""
    if elastic.at < 0:
        planar.coupling(elastic, k, here, q, out)
    else:
        solid.coupling(elastic, k, here, q, numbers, out)


@inlined
def inertia(elastic: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals) -> None:
    """Add inertia to the wrench W of the frame and to State.tau of the amplitudes."""
    if elastic.at < 0:
        planar.inertia(elastic, here, state)
    else:
        solid.inertia(elastic, here, state, numbers)


@inlined
def momentum(elastic: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals, out: Reals) -> None:
    """out += momentum and angular momentum about the frame's origin, global axes."""
    if elastic.at < 0:
        planar.momentum(elastic, here, state, out)
    else:
        solid.momentum(elastic, here, state, numbers, out)


@inlined
def modal_momentum(elastic: FlexibleRecord, k: int, here: MotionRecord, state: State, numbers: Reals) -> float:
    """dT/dp'_k."""
    if elastic.at < 0:
        return planar.modal_momentum(elastic, k, here, state)
    return solid.modal_momentum(elastic, k, here, state, numbers)


@kernel
def kinetic(elastic: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals, scratch: Reals) -> float:
    """T = (Y . momentum wrench + p' . dT/dp') / 2, J."""
    for i in range(6):
        scratch[i] = 0.0
    momentum(elastic, here, state, numbers, scratch)
    total = 0.0 * scratch[0]
    for i in range(6):
        total += 0.5 * here.Y[i] * scratch[i]
    for k in range(elastic.modes):
        total += 0.5 * state.v[elastic.vi + k] * modal_momentum(elastic, k, here, state, numbers)
    return total


@inlined
def apply_elastic_forces(elastic: FlexibleRecord, state: State, numbers: Reals) -> None:
    """Modal stiffness and damping among the forces along the coordinates."""
    if elastic.at < 0:
        planar.apply_elastic_forces(elastic, state)
    else:
        solid.apply_elastic_forces(elastic, state, numbers)


@inlined
def potential(elastic: FlexibleRecord, state: State, numbers: Reals) -> float:
    """Strain energy, J."""
    return planar.potential(elastic, state) if elastic.at < 0 else solid.potential(elastic, state, numbers)


@inlined
def power(elastic: FlexibleRecord, state: State, numbers: Reals) -> float:
    """Power of the damping, W."""
    return planar.power(elastic, state) if elastic.at < 0 else solid.power(elastic, state, numbers)


@inlined
def gravity_potential(
    elastic: FlexibleRecord, here: MotionRecord, state: State, gravity: Reals, numbers: Reals
) -> float:
    """Energy in the gravity field, zero at the global origin, J."""
    if elastic.at < 0:
        return planar.gravity_potential(elastic, here, state, gravity)
    return solid.gravity_potential(elastic, here, state, gravity, numbers)
