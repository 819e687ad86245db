"""Variables of model exchange: continuous states, their derivatives, and which models have them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics.arrays.assembly import free_bodies
from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.arrays.numbering import joints_to_hold, states_of
from mbfmu.mechanics.arrays.tables import CalledKernel, has_state
from mbfmu.mechanics.events import SetInput
from mbfmu.mechanics.kind import ElementType, kernel_of
from mbfmu.mechanics.sensors import Follows
from mbfmu.modeling.variables import VARIABLE_NAME_PATTERN
from mbfmu.session.simulation import Simulation
from mbfmu.util.units import rate_unit
from solvers.compiled.tuple_pointer import unpin
from solvers.system import Array

from .entries import family_of
from .families import FAMILIES
from .kernel_table import user_kernels

MAX_STATES = 1000  # continuous states: each is two variables of the model description
MAX_DEPENDENCIES = 200_000  # of outputs on states that a model description lists
ALL_DERIVATIVES = {0, 1, 2}  # of the motion of a support


class ExchangeState(NamedTuple):
    """A continuous state, in the order of the states.

    Attributes
    ----------
    name, derivative
        Names of the state and of its derivative.
    unit, derivative_unit
        Their units.
    nominal
        Unit of the absolute tolerance of the solvers of mbfmu, in ``unit``.
    """

    name: str
    derivative: str
    description: str
    unit: str
    derivative_unit: str
    nominal: float


class Indicator(NamedTuple):
    """An event indicator, in the order of the sensors of events."""

    name: str
    description: str
    unit: str


def explain_missing_exchange(simulation: Simulation) -> str:
    """Return why a model is for co-simulation only; empty: it supports model exchange too."""
    system = simulation.compiled.system
    count, outputs = system.nq + system.n, len(simulation.compiled.outputs)
    if count > MAX_STATES or count * outputs > MAX_DEPENDENCIES:
        return (
            f"it has {count} continuous states and {outputs} outputs, each of which depends on all states; supported: "
            f"{MAX_STATES} states, and a product of the two numbers of {MAX_DEPENDENCIES}"
        )
    if simulation.compiled.histories:
        return "the friction of a sheet that sticks has a history, which the solver updates at the end of its steps"
    constant = list_constant_inputs(simulation)
    for event in simulation.compiled.mechanism.events:
        for action in event.actions:
            if isinstance(action, SetInput) and action.name in constant:
                return f"event {event.name!r} sets input {action.name!r}, which is constant in model exchange"
    return ""


def explain_missing_derivatives(simulation: Simulation) -> str:
    """Return why an FMU with model exchange has no directional derivatives; empty: it has."""
    compiled = simulation.compiled
    if why := describe_real_kernels(compiled):
        return why
    if locked := joints_to_hold(compiled.mechanism):
        others = f" and {len(locked) - 1} more" if len(locked) > 1 else ""
        return f"events or rigid stops lock the joint of body {compiled.mechanism.bodies[locked[0]].name!r}{others}"
    if len(compiled.data.state.bearings):
        return "joint friction follows the reaction of its joint"
    moving = compiled.inputs.supports()
    for what, load in compiled.magnitudes():
        if any(member.number in moving for member in load.members()):
            return f"{what} is given by an input that moves a joint, too"
    return ""


def describe_real_kernels(compiled: CompiledMechanism) -> str:
    """Return which elements have kernels of a model for real numbers only; empty: there are none.

    Kernels that mbfmu makes of functions and expressions are compiled for a complex state, too.
    """
    called = user_kernels(compiled.called())
    real = {own.function for own in called if has_state(own.signature, own.words) and _is_written_by_user(own)}
    if not real:
        return ""
    m = compiled.mechanism
    elements: list[tuple[str, ElementType]] = [
        *((f"the joint of body {body.name!r}", body.joint) for body in m.bodies),
        *((f"cut joint {own.name!r}", own.cut) for own in m.cuts),
        *((f"coupling {own.name!r}", own.coupling) for own in m.couplings),
        *((own.what, own.load) for own in m.loads()),
        *((f"output {name!r}", sensor) for name, sensor, *_ in m.outputs),
    ]
    for what, element in elements:
        if not real.isdisjoint(kernel_of(element, name) for name in element.kernels):
            return f"{what} is a user-defined {type(element).__name__}, whose kernels are of real numbers only"
    return "a user-defined sensor in a law or an event has kernels of real numbers only"


def _is_written_by_user(called: CalledKernel) -> bool:
    return not called.function.__module__.startswith("mbfmu.")


def list_constant_inputs(simulation: Simulation) -> list[str]:
    """Return the names of inputs that move joints without an input for the acceleration: a motion that changes needs
    all derivatives.
    """
    inputs = simulation.compiled.inputs
    moving = [k for k in range(len(inputs)) if inputs.moves_support(k)]
    given: dict[int, set[int]] = {}  # derivatives that are inputs, by the number of the support
    for k in moving:
        given.setdefault(int(inputs.own.inputs["number"][k]), set()).add(int(inputs.own.inputs["coefficient"][k]))
    return [inputs.variables[k].name for k in moving if given[int(inputs.own.inputs["number"][k])] != ALL_DERIVATIVES]


def list_motion_outputs(simulation: Simulation) -> list[str]:
    """Return the names of outputs that depend on positions and velocities alone."""
    outputs = simulation.compiled.mechanism.outputs
    return [
        name
        for name, sensor, *_ in outputs
        if sensor.follows is Follows.MOTION and type(sensor).__module__.startswith("mbfmu.")
    ]


def exchange_states(simulation: Simulation, taken: Iterable[str]) -> tuple[ExchangeState, ...]:
    """Return the states of a model: free positions, free velocities, first-order states; ``taken``: names of other
    variables.
    """
    compiled = simulation.compiled
    system, placed = compiled.system, compiled.system.placed
    units = [unit for body in free_bodies(compiled.mechanism) for unit in body.joint.units]
    nominal, used = find_nominals(simulation), set(taken)
    found: list[ExchangeState | None] = [None] * (system.nq + system.n)
    for i, k in zip(placed.in_q, placed.in_v, strict=True):
        name = system.coordinate_names[k]
        found[i] = _state("position", name, f"joint coordinate {name!r}", units[k], nominal[i], used)
    for i, k in placed.turning:
        body = system.coordinate_names[k].rpartition(".")[0]
        for part in range(4):
            what = f"component {part + 1} of the quaternion of body {body!r}"
            found[i + part] = _state("quaternion", f"{body}[{part + 1}]", what, "1", nominal[i + part], used)
    moving = system.n_velocities
    for k, name in enumerate(system.coordinate_names[:moving]):
        at = system.nq + k
        what = f"velocity of joint coordinate {name!r}"
        found[at] = _state("velocity", name, what, f"{units[k]}/s", nominal[at], used)
    for k, (name, own) in enumerate(states_of(compiled.mechanism), system.nq + moving):
        found[k] = _state("value", name, f"first-order state {name!r}", own.unit, nominal[k], used)
    return tuple(state for state in found if state is not None)


def find_nominals(simulation: Simulation) -> Array:
    """Return the nominal values of the states, as :func:`mbfmu.native.exchange_memory.fill_nominals`."""
    system, given = simulation.compiled.system, unpin(simulation.stepper.integration)  # type: ignore[attr-defined]
    _, work = FAMILIES[family_of(simulation)].formulation(unpin(given.eqs), unpin(given.work))
    return np.concatenate((system.position_sizes(system.size), work.coordinate_rates * system.size))


def list_indicators(simulation: Simulation, taken: Iterable[str]) -> tuple[Indicator, ...]:
    """Return the event indicators of a model; ``taken``: names of other variables."""
    used, found = set(taken), []
    for event in simulation.compiled.mechanism.events:
        if event.sensor is not None:
            name = _unused_name(f"event.{event.name}", "event", event.name, used)
            text = f"Event indicator of event {event.name!r}: its sensor minus the value that it may cross"
            found.append(Indicator(name, text, event.sensor.unit))
    return tuple(found)


def _state(kind: str, name: str, what: str, unit: str, nominal: float, used: set[str]) -> ExchangeState:
    """Return a state under a name that FMI allows and that is not used yet, which is used from then on."""
    own = _unused_name(f"state.{kind}.{name}", f"state.{kind}", name, used)
    return ExchangeState(own, f"der({own})", f"State: {what}", unit, rate_unit(unit), float(nominal))


def _unused_name(wanted: str, group: str, name: str, used: set[str]) -> str:
    """Return a name that FMI allows and that is not used yet, which is used from then on."""
    own = wanted
    if not VARIABLE_NAME_PATTERN.fullmatch(own):
        own = f"{group}.n{re.sub('[^A-Za-z0-9_]', '_', name)}"
    while own in used:
        own += "_"
    used.add(own)
    return own
