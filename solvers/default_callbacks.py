"""What kernels call of a system: its callbacks, and defaults where it has none."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import COMPILED, callback, types
from solvers.compiled.tuple_pointer import pointer_type

if TYPE_CHECKING:
    from solvers.system import AnySystem, System, TreeSystem


def no_power(t: float, q: Any, v: Any, a: Any, lam: Any, data: Any) -> float:
    """Default of a system without work of forces."""
    return 0.0


def no_energy_bound(rtol: float, place: Any, rate: Any, data: Any, out: Any) -> None:
    """Default of a system without this function: no bound on the error of its energy follows."""
    out[0], out[1] = 0.0, 0.0


def no_outputs(a: Any, lam: Any, data: Any, out: Any) -> None:
    """Default of a system without outputs."""


def energy_callbacks(system: AnySystem) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the callbacks of power and energy bound of a system for kernels."""
    if system.power is not None and system.evaluate_energy_bound is not None:
        return system.power, system.evaluate_energy_bound
    return _nothing(pointer_type(system.data) if COMPILED else None)


def outputs_callback(system: System) -> Callable[..., Any]:
    """Return the output function of a system for kernels."""
    if system.evaluate_outputs is not None:
        return system.evaluate_outputs
    return _no_outputs(pointer_type(system.data) if COMPILED else None)


@cache
def _no_outputs(data: Any) -> Callable[..., Any]:
    if not COMPILED:
        return no_outputs
    vector = types.float64[::1]
    return callback(types.void(vector, vector, data, vector))(no_outputs)


@cache
def _nothing(data: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    if not COMPILED:
        return no_power, no_energy_bound
    real, vector = types.float64, types.float64[::1]
    work = callback(types.float64(real, vector, vector, vector, vector, data))
    return work(no_power), callback(types.void(real, vector, vector, data, vector))(no_energy_bound)


def no_step_bound(taken: float, data: Any) -> float:
    """Default of a system whose state limits no step."""
    return np.inf


def step_limit_callback(system: AnySystem) -> Callable[..., Any]:
    """Return the limit of a system on steps for kernels."""
    if system.longest_load_step is not None:
        return system.longest_load_step
    return _no_step_bound(pointer_type(system.data) if COMPILED else None)


@cache
def _no_step_bound(data: Any) -> Callable[..., Any]:
    return callback(types.float64(types.float64, data))(no_step_bound) if COMPILED else no_step_bound


def no_parts(data: Any, out: Any) -> None:
    """Default of a system that does not compute its inertia."""


@cache
def _no_parts(data: Any) -> Callable[..., Any]:
    return callback(types.void(data, types.float64[::1]))(no_parts) if COMPILED else no_parts


def parts_callback(system: TreeSystem) -> Callable[..., Any]:
    """Return the function of a system that computes its inertia for kernels."""
    if system.inertia_parts is not None:
        return system.inertia_parts
    return _no_parts(pointer_type(system.data) if COMPILED else None)


def no_mesh_motion(dq: Any, mask: Any, data: Any, out: Any) -> None:
    """Default of a system without meshes."""


def mesh_motion_callback(system: TreeSystem) -> Callable[..., Any]:
    """Return the function of a system for the motion of its meshes for kernels."""
    if system.mesh_motion is not None:
        return system.mesh_motion
    return _no_mesh_motion(pointer_type(system.data) if COMPILED else None)


@cache
def _no_mesh_motion(data: Any) -> Callable[..., Any]:
    if not COMPILED:
        return no_mesh_motion
    vector = types.float64[::1]
    return callback(types.void(vector, vector, data, vector))(no_mesh_motion)
