"""Forces: one file a kind, and this registry."""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.elastic import drag, modal, plate, pressure
from mbfmu.mechanics.signals import value
from solvers.kernel import inlined

from . import beam_element, joint_force, joint_spring, point_force, spring, torque
from .base import Force
from .beam_element import BeamElement
from .joint_force import JointForce
from .joint_spring import JointSpring
from .point_force import PointForce
from .spring import Spring
from .torque import Torque

REGISTRY: tuple[type[Force], ...] = (Spring, JointSpring, JointForce, PointForce, Torque, BeamElement)

_spring, _joint_spring, _joint_force, _point_force, _torque, _beam = (
    spring.apply,
    joint_spring.apply,
    joint_force.apply,
    point_force.apply,
    torque.apply,
    beam_element.apply,
)
_plate, _drag, _pressure, _plate_potential = plate.apply, drag.apply, pressure.apply, plate.potential
_modal, _modal_potential = modal.load, modal.potential
_spring_potential, _joint_spring_potential = spring.potential, joint_spring.potential
_beam_potential = beam_element.potential
_spring_power, _joint_spring_power, _joint_force_power, _point_force_power, _torque_power, _beam_power = (
    spring.power,
    joint_spring.power,
    joint_force.power,
    point_force.power,
    torque.power,
    beam_element.power,
)
_drag_power, _pressure_power, _modal_power = drag.power, pressure.power, modal.power


@inlined
def exert(force: Any, t: float, arrays: Any, state: Any) -> None:
    """Let one force add its own; see :mod:`.base`."""
    if force.kind == 0:
        _spring(force, t, arrays, state)
    elif force.kind == 1:
        _joint_spring(force, t, arrays, state)
    elif force.kind == 2:
        _joint_force(force, t, arrays, state)
    elif force.kind == 3:
        _point_force(force, t, arrays, state)
    elif force.kind == 4:
        _torque(force, t, arrays, state)
    else:
        _beam(force, t, arrays, state)


@inlined
def apply(t: float, arrays: Any, state: Any) -> None:
    """Let every force and elastic element add its own to the applied wrenches and to the coordinate forces, which
    scatter has cleared.
    """
    for i in range(state.bodies.shape[0]):
        F = state.bodies[i].F
        for k in range(6):
            F[k] = 0.0
    for i in range(arrays.forces.shape[0]):
        exert(arrays.forces[i], t, arrays, state)
    damped = 0.0 * state.damped[0]
    for i in range(arrays.plates.shape[0]):
        damped += _plate(arrays.plates[i], state.bodies, state.element[0])
    state.damped[0] = damped
    for i in range(arrays.drags.shape[0]):
        _drag(arrays.drags[i], state.bodies)
    for i in range(arrays.elastics.shape[0]):
        _modal(arrays.elastics[i], state)
    for i in range(arrays.pressures.shape[0]):
        load = arrays.pressures[i]
        _pressure(load, value(arrays.signals[load.signal], t), state.bodies)
    state.time[0] = t


@inlined
def potential(arrays: Any, state: Any) -> float:
    """Energy stored in all forces and elastic elements, J."""
    total = 0.0
    for i in range(arrays.forces.shape[0]):
        force = arrays.forces[i]
        if force.kind == 0:
            total += _spring_potential(force, arrays, state)
        elif force.kind == 1:
            total += _joint_spring_potential(force, arrays, state)
        elif force.kind == 5:
            total += _beam_potential(force, arrays, state)
    for i in range(arrays.plates.shape[0]):
        total += _plate_potential(arrays.plates[i], state.bodies, state.element[0])
    for i in range(arrays.elastics.shape[0]):
        total += _modal_potential(arrays.elastics[i], state)
    return total


@inlined
def power(t: float, arrays: Any, state: Any) -> float:
    """Power of all forces and elastic elements, W, but for what :func:`potential` stores; :func:`apply` was called
    last for this state.
    """
    total = state.damped[0]
    for i in range(arrays.forces.shape[0]):
        force = arrays.forces[i]
        if force.kind == 0:
            total += _spring_power(force, t, arrays, state)
        elif force.kind == 1:
            total += _joint_spring_power(force, t, arrays, state)
        elif force.kind == 2:
            total += _joint_force_power(force, t, arrays, state)
        elif force.kind == 3:
            total += _point_force_power(force, t, arrays, state)
        elif force.kind == 4:
            total += _torque_power(force, t, arrays, state)
        else:
            total += _beam_power(force, t, arrays, state)
    for i in range(arrays.drags.shape[0]):
        total += _drag_power(arrays.drags[i], state.bodies)
    for i in range(arrays.elastics.shape[0]):
        total += _modal_power(arrays.elastics[i], state)
    for i in range(arrays.pressures.shape[0]):
        load = arrays.pressures[i]
        total += _pressure_power(load, value(arrays.signals[load.signal], t), state.bodies)
    return total


__all__ = [
    "REGISTRY",
    "BeamElement",
    "Force",
    "JointForce",
    "JointSpring",
    "PointForce",
    "Spring",
    "Torque",
    "apply",
    "exert",
    "potential",
    "power",
]
