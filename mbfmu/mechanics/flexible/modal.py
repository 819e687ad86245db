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
def composite(flexible: FlexibleRecord, here: MotionRecord, q: Reals, numbers: Reals) -> None:
    """Mass, first moment and inertia about the origin of the deformed body, global axes."""
    if flexible.at < 0:
        planar.composite(flexible, here, q)
    else:
        solid.composite(flexible, here, q, numbers)


@inlined
def modal_mass(flexible: FlexibleRecord, k: int, numbers: Reals) -> float:
    """mu_k, kg."""
    return flexible.mu[k] if flexible.at < 0 else solid.modal_mass(flexible, k, numbers)


@inlined
def coupling(flexible: FlexibleRecord, k: int, here: MotionRecord, q: Reals, numbers: Reals, out: Reals) -> None:
    """out = momentum wrench of p'_k = 1 about the origin, global axes."""
    if flexible.at < 0:
        planar.coupling(flexible, k, here, q, out)
    else:
        solid.coupling(flexible, k, here, q, numbers, out)


@inlined
def inertia(flexible: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals) -> None:
    """Add inertia to the wrench W of the frame and to State.tau of the amplitudes."""
    if flexible.at < 0:
        planar.inertia(flexible, here, state)
    else:
        solid.inertia(flexible, here, state, numbers)


@inlined
def momentum(flexible: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals, out: Reals) -> None:
    """out += momentum and angular momentum about the frame's origin, global axes."""
    if flexible.at < 0:
        planar.momentum(flexible, here, state, out)
    else:
        solid.momentum(flexible, here, state, numbers, out)


@inlined
def modal_momentum(flexible: FlexibleRecord, k: int, here: MotionRecord, state: State, numbers: Reals) -> float:
    """dT/dp'_k."""
    if flexible.at < 0:
        return planar.modal_momentum(flexible, k, here, state)
    return solid.modal_momentum(flexible, k, here, state, numbers)


@kernel
def kinetic(flexible: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals, scratch: Reals) -> float:
    """T = (Y . momentum wrench + p' . dT/dp') / 2, J."""
    for i in range(6):
        scratch[i] = 0.0
    momentum(flexible, here, state, numbers, scratch)
    total = 0.0 * scratch[0]
    for i in range(6):
        total += 0.5 * here.Y[i] * scratch[i]
    for k in range(flexible.modes):
        total += 0.5 * state.v[flexible.vi + k] * modal_momentum(flexible, k, here, state, numbers)
    return total


@inlined
def apply_elastic_forces(flexible: FlexibleRecord, state: State, numbers: Reals) -> None:
    """Modal stiffness and damping among the forces along the coordinates."""
    if flexible.at < 0:
        planar.apply_elastic_forces(flexible, state)
    else:
        solid.apply_elastic_forces(flexible, state, numbers)


@inlined
def potential(flexible: FlexibleRecord, state: State, numbers: Reals) -> float:
    """Strain energy, J."""
    return planar.potential(flexible, state) if flexible.at < 0 else solid.potential(flexible, state, numbers)


@inlined
def power(flexible: FlexibleRecord, state: State, numbers: Reals) -> float:
    """Power of the damping, W."""
    return planar.power(flexible, state) if flexible.at < 0 else solid.power(flexible, state, numbers)


@inlined
def gravity_potential(
    flexible: FlexibleRecord, here: MotionRecord, state: State, gravity: Reals, numbers: Reals
) -> float:
    """Energy in the gravity field, zero at the global origin, J."""
    if flexible.at < 0:
        return planar.gravity_potential(flexible, here, state, gravity)
    return solid.gravity_potential(flexible, here, state, gravity, numbers)
