"""Forces of a mechanism in its description: of joints, between points, and against the weight."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import (
    BlockHandle,
    Input,
    JointDamper,
    JointForce,
    JointFriction,
    JointSpring,
    JointStop,
    PointForce,
    Product,
    Spring,
)
from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.builder.bodies import Body

from .description import ImportedDrive, ImportedJoint, ImportedLift, ImportedSpring

if TYPE_CHECKING:
    from .mechanism import Described


def is_number(value: Any) -> bool:
    """Whether a property is a constant number."""
    return isinstance(value, int | float | np.floating | np.integer)


def add_forces(described: Described) -> None:
    """Add all forces, or that they are lost."""
    m = described.mechanism
    for name, force, a, b in m.forces:
        key = a.index, int(getattr(force, "coordinate", 0))
        joint = described.coordinates[key][1] if force.on_joint and key in described.coordinates else None
        if not _add_force(described, name, force, joint, a, b):
            described.losses.add("forces", name)
    for acting in m.blocks:
        if acting.name in described.limiters:
            continue
        described.losses.add("blocks", acting.name or acting.what)
    for event in (own for own in m.events if own.is_listed):
        described.losses.add("events", event.name)


def _add_force(described: Described, name: str, force: Any, joint: ImportedJoint | None, a: Body, b: Body) -> bool:
    """Add a force; return whether it has a counterpart."""
    if isinstance(force, Spring):
        return _add_spring(described, name, force, a, b)
    if isinstance(force, PointForce):
        return _add_point_force(described, name, force, a, b)
    if joint is None:
        return False
    if isinstance(force, JointSpring):
        if not all(map(is_number, (force.stiffness, force.damping, force.free))):
            return False
        torque = joint.stiffness * joint.unloaded + float(force.stiffness) * float(force.free)
        joint.stiffness += float(force.stiffness)
        joint.unloaded = torque / joint.stiffness if joint.stiffness else 0.0
        joint.damping += float(force.damping)
        return True
    if isinstance(force, JointDamper):
        joint.damping += float(force.damping) if is_number(force.damping) else 0.0
        return is_number(force.damping)
    if isinstance(force, JointFriction):
        return _add_friction(described, name, force, joint)
    if isinstance(force, JointStop):
        if not all(end is None or is_number(end) for end in (force.lower, force.upper)):
            return False
        if force.lower is None or force.upper is None or joint.lower is not None:
            described.losses.add("limits", name)
        else:
            joint.lower, joint.upper = float(force.lower), float(force.upper)
            joint.stop_stiffness = float(force.stiffness)
        return True
    return isinstance(force, JointForce) and _add_drive(described, name, force, joint, a)


def _add_friction(described: Described, name: str, force: JointFriction, joint: ImportedJoint) -> bool:
    """Add Coulomb and viscous friction; return whether it has a counterpart."""
    if not is_number(force.coulomb) or (force.normal_force is not None and not is_number(force.normal_force)):
        return False
    normal = 1.0 if force.normal_force is None else float(force.normal_force)
    if force.static is not None and force.static != force.coulomb:
        described.losses.add("friction", name)
    joint.friction += float(force.coulomb) * normal
    joint.damping += float(force.viscous)
    return True


def _add_drive(described: Described, name: str, force: JointForce, joint: ImportedJoint, body: Body) -> bool:
    """Add an input on a joint, with a gain or without; return whether it has a counterpart."""
    signal, gain, limits = force.magnitude, 1.0, None
    if isinstance(signal, BlockHandle) and is_limiter(signal):
        described.limiters.add(signal.name)
        lower, upper = (np.ravel(np.asarray(end, float)) for end in (signal.block.lower, signal.block.upper))
        limits = float(lower[0]), float(upper[0])
        signal = signal.block.inputs[0].source
    if isinstance(signal, Product):
        numbers = [float(part) for part in signal.parts if is_number(part)]
        inputs = [part for part in signal.parts if isinstance(part, Input)]
        if len(numbers) == len(inputs) == 1:
            signal, gain = inputs[0], numbers[0]
    if not isinstance(signal, Input) or force.uses or not gain:
        described.losses.add("signals", name)
        return True
    if signal.start:
        described.losses.add("input starts", signal.name)
    others = [drive.name for drive in described.description.drives if drive.input == signal.name]
    if others:
        described.losses.note(
            f"{others[0]} and {name} have a control each", f"In the model both have the input {signal.name}"
        )
    described.description.drives.append(
        ImportedDrive(
            name=name,
            body=described.name_of(body),
            joint=joint.name,
            input=signal.name,
            unit=signal.unit,
            description=signal.description,
            gain=gain,
            limits=limits,
        )
    )
    return True


def is_limiter(handle: BlockHandle) -> bool:
    """Whether a block only limits its input, at both ends."""
    block = handle.block
    if block.states or len(block.inputs) != 1 or block.lower is None or block.upper is None:
        return False
    return bool(np.array_equal(block.D, [[1.0]]) and np.isfinite(block.lower[0]) and np.isfinite(block.upper[0]))


def _add_spring(described: Described, name: str, force: Spring, a: Body, b: Body) -> bool:
    """Add a spring between two points; return whether it has a counterpart."""
    values = force.stiffness, force.damping, force.free
    if not all(map(is_number, values)):
        return False
    stiffness, damping, free = map(float, values)
    described.description.springs.append(
        ImportedSpring(
            name=name,
            a=described.name_of(a),
            b=described.name_of(b),
            at_a=described.place(a, force.at_a),
            at_b=described.place(b, force.at_b),
            stiffness=stiffness,
            damping=damping,
            unloaded=free,
        )
    )
    return True


def _add_point_force(described: Described, name: str, force: PointForce, a: Body, b: Body) -> bool:
    """Add a constant force that compensates the weight of a body; return whether it has this form."""
    if b.index or not is_number(force.magnitude) or force.fixed_in != "ground":
        return False
    vector = float(force.magnitude) * unit_axis(force.axis, f"axis of force {name!r}")
    gravity = described.mechanism.gravity
    weight = -a.mass * np.asarray(gravity, float)
    size = float(weight @ weight)
    share = float(vector @ weight) / size if size else 0.0
    is_weight = size > 0.0 and np.allclose(vector, share * weight, rtol=0.0, atol=1e-12 * np.sqrt(size))
    if not is_weight or not np.allclose(force.at_a, a.com, rtol=1e-12, atol=0.0):
        return False
    described.description.lifts.append(
        ImportedLift(name=name, body=described.name_of(a), at=described.place(a, a.com), force=vector)
    )
    return True
