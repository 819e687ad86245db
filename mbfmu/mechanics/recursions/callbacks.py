"""The recursions as solvers take them: callbacks, compiled on first use."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, cast

from mbfmu.mechanics.records import Data, empty_data, to_complex_data, to_complex_state
from solvers.compiled.kernel import COMPILED, callback, types
from solvers.compiled.tuple_pointer import pointer_type
from solvers.system import Terms

from .dynamics import (
    constraints,
    dynamics,
    energy,
    evaluate_energy_bound,
    evaluate_outputs,
    forward,
    inertia_parts,
    inverse,
    longest_load_step,
    mesh_motion,
    mobility,
    motion,
    position,
    power,
    retract,
    solved_power,
)


@cache
def callbacks(scalar: type = float) -> tuple[Callable[..., Any], ...]:
    """Return dynamics, position, motion, retract, energy as a solver takes them; compiled on first use.

    ``scalar`` complex: for the data of :func:`.records.to_complex_data`.
    """
    if not COMPILED:
        return dynamics, position, motion, retract, energy
    example = empty_data() if scalar is float else to_complex_data(empty_data())
    data, terms = pointer_type(example), pointer_type(Terms.allocate(1, 1, 1, scalar))
    real, number = types.float64, types.float64 if scalar is float else types.complex128
    vector = number[::1]
    return (
        callback(types.void(real, vector, vector, data, terms))(dynamics),
        callback(types.void(real, vector, data, terms))(position),
        callback(types.void(real, vector, vector, data, terms))(motion),
        callback(types.void(vector, vector, data))(retract),
        callback(number(real, vector, vector, data))(cast("Any", energy).py_func),
    )


@cache
def outputs_callback() -> Callable[..., Any]:
    """Return :func:`evaluate_outputs` as a solver takes it; compiled on first use."""
    if not COMPILED:
        return evaluate_outputs
    vector = types.float64[::1]
    return callback(types.void(vector, vector, pointer_type(empty_data()), vector))(
        cast("Any", evaluate_outputs).py_func
    )


@cache
def tree_callbacks() -> tuple[Callable[..., Any], ...]:
    """Return inverse, forward, mobility, position, constraints, retract as a solver of large trees takes them;
    compiled on first use.
    """
    if not COMPILED:
        return inverse, forward, mobility, position, constraints, retract
    data, terms = pointer_type(empty_data()), pointer_type(Terms.allocate(1, 1, 1))
    real, vector = types.float64, types.float64[::1]
    return (
        callback(types.void(real, vector, vector, vector, vector, data, vector, vector))(inverse),
        callback(types.int64(real, vector, vector, data, vector, vector))(forward),
        callback(types.void(vector, data, vector))(mobility),
        callback(types.void(real, vector, data, terms))(position),
        callback(types.void(real, vector, vector, data, terms))(constraints),
        callback(types.void(vector, vector, data))(retract),
    )


@cache
def complex_step_callbacks() -> tuple[Callable[..., Any], ...]:
    """Return inverse, position and retract on a complex state with real arrays; compiled on first use."""
    if not COMPILED:
        return inverse, position, retract
    example = empty_data()
    data = pointer_type(Data(example.arrays, to_complex_state(example.state)))
    terms = pointer_type(Terms.allocate(1, 1, 1, complex))
    real, vector = types.float64, types.complex128[::1]
    return (
        callback(types.void(real, vector, vector, vector, vector, data, vector, vector))(inverse),
        callback(types.void(real, vector, data, terms))(position),
        callback(types.void(vector, vector, data))(retract),
    )


@cache
def work_callbacks(tree: bool) -> tuple[Callable[..., Any], ...]:
    """Return the callbacks of power and energy bound of a solver; compiled on first use."""
    if not COMPILED:
        return solved_power if tree else power, evaluate_energy_bound
    data, real, vector = pointer_type(empty_data()), types.float64, types.float64[::1]
    work = callback(types.float64(real, vector, vector, vector, vector, data))
    return work(solved_power if tree else power), callback(types.void(real, vector, vector, data, vector))(
        evaluate_energy_bound
    )


@cache
def mesh_callback() -> Callable[..., Any]:
    """Return :func:`mesh_motion` as a solver takes it; compiled on first use."""
    if not COMPILED:
        return mesh_motion
    vector = types.float64[::1]
    return callback(types.void(vector, vector, pointer_type(empty_data()), vector))(mesh_motion)


@cache
def inertia_callback() -> Callable[..., Any]:
    """Return :func:`inertia_parts` as a solver takes it; compiled on first use."""
    if not COMPILED:
        return inertia_parts
    return callback(types.void(pointer_type(empty_data()), types.float64[::1]))(inertia_parts)


@cache
def step_limit_callback() -> Callable[..., Any]:
    """Return :func:`longest_load_step` as a solver takes it; compiled on first use."""
    if not COMPILED:
        return longest_load_step
    return callback(types.float64(types.float64, pointer_type(empty_data())))(cast("Any", longest_load_step).py_func)
