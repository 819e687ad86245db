"""A model as data for the runtime: the file in the resources of a native FMU."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.assembly import free_bodies
from mbfmu.mechanics.arrays.closing import CLOSURE_MESSAGES
from mbfmu.mechanics.cuts.rolling import GRIPS
from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import RowRecord
from mbfmu.modeling.model import Model
from mbfmu.modeling.parameters import declared, span
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import ArrayVariable, Role, ScalarVariable, Type, arrays, list_variables
from mbfmu.session.failure_diagnosis import advise
from mbfmu.session.kernels.event_points import place_of_indicators
from mbfmu.session.simulation import Simulation, UnstartedSimulation
from mbfmu.session.tolerances import COARSE_TOLERANCE, describe_coarse
from mbfmu.session.wheel_monitor import WatchedWheel, watched_wheels
from mbfmu.util.errors import UserError
from solvers.diagnostics import Diagnostic
from solvers.loop_closure import Outcome
from solvers.outcome import CODES, KEYS, MESSAGES, Status
from solvers.steppers import ORDER_LIMITS

from . import layout, start_checks
from .contents import Contents, contents_for
from .curves import Shifted
from .entries import Instance, called_in_fmu, family_of, has_events, image_of, uses_sundials
from .event_memory import event_parameters, refuse_constant_parameters
from .exchange_states import (
    ExchangeState,
    Indicator,
    exchange_states,
    explain_missing_derivatives,
    explain_missing_exchange,
    list_constant_inputs,
    list_indicators,
    list_motion_outputs,
)
from .families import FAMILIES
from .image import MemoryImage
from .kernel_table import user_kernels
from .model_numbers import EVENTS, SAMPLED, Place
from .parameter_map import LENGTH_NAME, Entry, Term
from .parameters import SettableParameters, find_settable
from .steady_export import explain_missing_search, restricted_inputs

FIXED_AT_EXPORT = {  # settings that are decided by the export, and why
    "solver": "it selects the machine code",
    "input_interpolation": "it changes the structure of the model",
    "start_at_equilibrium": "it decides how a run starts",
}


class NativeModel(NamedTuple):
    """A model for the runtime.

    Attributes
    ----------
    variables
        In the order of the value references.
    arrays
        Outputs that are one variable in FMI 3; their value references come after that of the time, which comes after
        those of the variables.
    fixed
        Parameters that are constant, though a model that is built could change them, and why.
    diagnostics
        Notes and warnings on the model and its start.
    states
        Continuous states of model exchange, whose value references come after those of the arrays, followed by those
        of their derivatives; None: the model is for co-simulation only.
    moving_inputs
        Names of the inputs that move joints.
    has_derivatives
        Whether directional derivatives are provided.
    takes_rates
        Whether the derivatives of all inputs by time can be given in co-simulation.
    has_user_kernels
        Whether the FMU needs the library of :mod:`.user_kernels`.
    contents
        What the runtime of the FMU contains.
    indicators
        Event indicators of model exchange, whose value references come after those of the derivatives of the states.
    """

    variables: tuple[ScalarVariable, ...]
    arrays: tuple[ArrayVariable, ...]
    fixed: dict[str, str]
    diagnostics: Sequence[Diagnostic]
    states: tuple[ExchangeState, ...] | None
    moving_inputs: tuple[str, ...]
    has_derivatives: bool
    takes_rates: bool
    data: bytes
    has_user_kernels: bool
    contents: Contents
    indicators: tuple[Indicator, ...]


def native_model(model: Model, settings: Settings, for_one_run: bool = False) -> NativeModel:
    """Return a model for the runtime, which is of no FMU yet: see :func:`.layout.signed`.

    ``for_one_run``: no parameter is settable.

    Raises
    ------
    UserError
        The model cannot be built, or the runtime cannot run it.
    """
    simulation = UnstartedSimulation(model, settings)
    if for_one_run and (events := simulation.compiled.mechanism.events):
        raise UserError(f"native FMUs do not list the events of a run, such as {events[0].name!r}", "not-native")
    exchanges = not for_one_run and not explain_missing_exchange(simulation)
    differentiates = exchanges and not explain_missing_derivatives(simulation)
    instance, image = image_of(simulation, differentiates)
    why = "the FMU is made for one run" if for_one_run else explain_missing_search(simulation)
    settable = _nothing_settable(model, why) if why else find_settable(model)
    refuse_constant_parameters(simulation.compiled.mechanism.events, settable.ranges, settable.fixed)
    frozen = {name: why for name, why in settable.fixed.items() if not _structural(model, name)}
    variables = tuple(
        _native_variable(v, model, settable, settings.solver)
        for v in list_variables(model, settings, simulation.compiled)
    )
    several = arrays(model, variables)
    states, notes = _states(simulation, variables) if not for_one_run else (None, [])
    file = _File(simulation, instance, image, settable, variables, several, states is not None, differentiates)
    messages, family = [*simulation.diagnostics, *notes], family_of(simulation)
    own = user_kernels(called_in_fmu(simulation.compiled, family, differentiates))
    inputs, is_steady = simulation.compiled.inputs, simulation.steady_state is not None
    numbers = (relocation.target for relocation in image.kernels)
    contents = contents_for(
        family,
        numbers,
        exchanges=states is not None,
        is_steady=is_steady,
        has_events=has_events(simulation.compiled),
        has_profiles=any(wheel.surface is not None for wheel in watched_wheels(simulation.compiled)),
    )
    moving = tuple(v.name for k, v in enumerate(inputs.variables) if inputs.moves_support(k))
    provided = states, moving, differentiates, _takes_rates(simulation)
    taken = [v.name for v in variables] + [name for state in states or () for name in (state.name, state.derivative)]
    indicators = list_indicators(simulation, taken)
    return NativeModel(variables, several, frozen, messages, *provided, file.write(), bool(own), contents, indicators)


def _takes_rates(simulation: Simulation) -> bool:
    """Whether a host may give the derivatives of all inputs by time; false if there are none."""
    inputs = simulation.compiled.inputs
    return len(inputs) > 0 and all(inputs.takes_rate(k) for k in range(len(inputs)))


def _states(
    simulation: Simulation, variables: Sequence[ScalarVariable]
) -> tuple[tuple[ExchangeState, ...] | None, list[Diagnostic]]:
    """Return the states of model exchange, or None, and notes on its limits."""
    if why := explain_missing_exchange(simulation):
        text = f"this FMU is for co-simulation only, not for model exchange: {why}"
        return None, [Diagnostic.note("no-model-exchange", text)]
    notes = []
    if names := list_constant_inputs(simulation):
        text = (
            f"in model exchange the inputs {', '.join(map(repr, names))} of joint motions are constant from the end of "
            "the initialization on, since their accelerations, which the equations of motion contain, are no inputs"
        )
        remedy = "Declare such an input with rate_name and acceleration_name, or use co-simulation"
        notes.append(Diagnostic.note("constant-input", text, remedy, subject=names[0]))
    if why := explain_missing_derivatives(simulation):
        notes.append(Diagnostic.note("no-derivatives", f"this FMU has no directional derivatives: {why}"))
    return exchange_states(simulation, [v.name for v in variables]), notes


def _nothing_settable(model: Model, why: str) -> SettableParameters:
    """Return that no parameter of a model stays settable."""
    return SettableParameters((), {p.name: why for p in model.parameters()}, {}, (), {})


def _structural(model: Model, name: str) -> bool:
    return next(p.structural for p in model.parameters() if p.name == name)


def _native_variable(v: ScalarVariable, model: Model, settable: SettableParameters, solver: str) -> ScalarVariable:
    """Return a variable as it is without Python: some are constants, with the reason in the description, and ranges may
    be narrower.
    """
    why = {Role.SETTING: FIXED_AT_EXPORT, Role.PARAMETER: settable.fixed}.get(v.role, {}).get(v.name, "")
    if v.role is Role.SETTING and v.name == "max_order":
        lowest, highest = ORDER_LIMITS[solver]
        if lowest < highest:
            return replace(v, max=highest, allowed=f"0, or {lowest} to {highest} with solver {solver!r}")
        why = "the solver has one order"
    if why:
        text = f"{v.description}; " if v.description else ""
        text += f"constant in this FMU: {why}"
        return replace(v, causality="local", variability="constant", allowed="", description=text)
    if v.role is not Role.PARAMETER or v.name not in settable.ranges or v.type is Type.BOOLEAN:
        return v
    low, high = settable.ranges[v.name]
    if v.type is Type.INTEGER:
        low, high = int(low), int(high)
    own = next(p for p in model.parameters() if p.name == v.name)
    return replace(v, min=low, max=high, allowed=span(replace(own, min=low, max=high)))


class _File:
    """What is to be written, section by section."""

    def __init__(
        self,
        simulation: Simulation,
        instance: Instance,
        image: MemoryImage,
        settable: SettableParameters,
        variables: Sequence[ScalarVariable],
        several: Sequence[ArrayVariable],
        exchanges: bool,
        differentiates: bool,
    ) -> None:
        self._simulation, self._instance, self._image, self._settable = simulation, instance, image, settable
        self._variables, self._arrays, self._text, self._exchanges = variables, several, bytearray(), exchanges
        self._differentiates, self._restricted_inputs = differentiates, restricted_inputs(simulation)
        self._constant_inputs, self._motion_outputs = list_constant_inputs(simulation), list_motion_outputs(simulation)
        self._block = image.block()
        self._references = {v.name: k for k, v in enumerate(variables)}
        self._places = {
            "clock": image.at(instance.clock), "out": image.at(instance.out), "options": image.at(instance.options),
            "counts": image.at(instance.counts), "length": image.at(instance.known) + 16,
            "run_status": image.at(instance.session.status), "worst": image.at(instance.start.scratch.worst),
            "massless": image.at(instance.start.scratch.massless),
            "ida": image.at(instance.given.memory.ida.words) if uses_sundials(instance) else 0,
            "exchange_x": image.at(instance.exchange.x),
            "exchange_derivatives": image.at(instance.exchange.derivatives),
            "exchange_nominal": image.at(instance.exchange.nominal),
            "exchange_times": image.at(instance.exchange.times),
            "direction_states": image.at(instance.linearization.states),
            "direction_inputs": image.at(instance.linearization.inputs),
            "derivative_slopes": image.at(instance.linearization.slopes),
            "derivative_outputs": image.at(instance.linearization.outputs),
            "events": image.at(instance.events.control), "event_values": image.at(instance.events.parameters),
            "indicators": image.at(instance.search.points) + place_of_indicators(instance.search),
        }  # fmt: skip
        control = instance.given.memory.control
        self._places |= {
            "undetermined": image.at(control, "undetermined"),
            "undetermined_time": image.at(control, "undetermined_at"),
            "near_miss_factor": image.at(control, "max_near_miss_factor"),
            "near_miss_gap": image.at(control, "min_gap"),
        }

    def write(self) -> bytes:
        """Return the bytes of the file."""
        rows: dict[str, list[tuple[Any, ...]]] = {name: [] for name in ("members", "sums", "terms", "factors")}
        rows["variables"] = [self._variable(v) for v in self._variables]
        rows["arrays"] = [self._array(a, rows["members"]) for a in self._arrays]
        rows["entries"] = [self._entry(entry, rows) for entry in self._settable.entries]
        rows["relocations"], rows["kernels"] = list(self._image.relocations), list(self._image.kernels)
        rows["sentences"] = [self._message(code) for code in CODES]
        system = self._simulation.compiled.system
        said = CLOSURE_MESSAGES | start_checks.START_MESSAGES
        rows["failures"] = [self._failure(str(said.get(outcome, ""))) for outcome in (*Outcome, *start_checks.Flaw)]
        rows["rows"] = [(self._add_text(name),) for name in system.constraint_names]
        rows["coordinates"] = [(self._add_text(name),) for name in system.coordinate_names]
        rows["cuts"] = [(self._add_text(handle.name),) for handle in self._simulation.compiled.mechanism.cuts]
        rows["loads"] = [
            (self._add_text(acting.place if acting.load.misplacement else ""),)
            for acting in self._simulation.compiled.mechanism.loads()
        ]
        mechanism, inputs = self._simulation.compiled.mechanism, self._simulation.compiled.inputs
        rows["events"] = [(self._add_text(event.name),) for event in self._simulation.compiled.mechanism.events]
        rows["event_parameters"] = [(self._references[name],) for name in event_parameters(mechanism)]
        rows["free_rates"] = [
            (self._add_text(body.name if body.joint.rate is None else ""),)
            for body in free_bodies(mechanism)
            for _ in range(body.joint.nv)
        ]
        units = {v.name: v.unit for v in inputs.variables}
        rows["supports"] = [
            (self._references[name], self._add_text(units[name])) for name, *_ in inputs.supports().values()
        ]
        rows["wheels"] = [self._wheel(wheel) for wheel in watched_wheels(self._simulation.compiled)]
        header = np.zeros(1, layout.HEADER)
        at, parts = layout.HEADER.itemsize, []
        for name, record in layout.SECTIONS.items():
            section = np.frombuffer(self._text, record) if name == "text" else _records(rows[name], record)
            header[name], header[f"{name}_count"] = at, len(section)
            parts.append(_padded(section.tobytes()))
            at += len(parts[-1])
        header["magic"], header["block"] = layout.FILE_MAGIC, at
        header["family"] = list(FAMILIES).index(family_of(self._simulation))
        header["size"], header["saved"], header["root"] = self._image.size, self._image.saved, self._image.root
        compiled, freedom = self._simulation.compiled, self._simulation.stepper.freedom
        called = called_in_fmu(compiled, family_of(self._simulation), self._differentiates)
        header["user_kernels"] = len(user_kernels(called))
        header["saved_alone"] = self._image.at(self._instance.exchange.times)  # the first of model exchange
        header["exchange"], header["positions"], header["velocities"] = self._exchanges, system.nq, system.n
        header["has_events"] = has_events(compiled)
        header["indicators"] = len(self._instance.search.sides)
        header["derivatives"], header["inputs"] = self._differentiates, len(compiled.inputs)
        header["takes_rates"] = _takes_rates(self._simulation)
        header["min_rtol"] = self._simulation.stepper.min_rtol
        header["reports_coarse"] = bool(describe_coarse(compiled, COARSE_TOLERANCE, freedom))
        header["reports_undetermined"] = compiled.has_force_outputs
        header["steady"] = self._simulation.steady_state is not None
        for name, place in self._places.items():
            header[f"{name}_at"] = place
        return b"".join((header.tobytes(), *parts, self._block))

    def _add_text(self, text: str) -> int:
        """Return the place of a text."""
        at = len(self._text)
        self._text += text.encode() + b"\0"
        return at

    def _variable(self, v: ScalarVariable) -> tuple[Any, ...]:
        alike = [other.name for other in self._variables if other.role is v.role]
        number = alike.index(v.name)
        if v.role is Role.SETTING:
            number = [p.name for p in declared(Settings)].index(v.name)
        between = v.role is Role.INPUT or v.variability == "tunable"
        when = "never" if not v.settable else "between" if between else "before"
        low, high = (float(min(v.choices)), float(max(v.choices))) if v.choices else (v.min, v.max)
        if v.type is Type.BOOLEAN:
            low, high = 0.0, 1.0
        unknown = nan if v.type is Type.REAL else 0.0
        start = unknown if v.start is None else float(v.start)
        is_fixed = int(v.name in self._constant_inputs)  # in model exchange
        rests = v.role is Role.INPUT and number in self._restricted_inputs
        rest_scale = max(abs(start), v.nominal or 0.0) if rests else 0.0
        kinds, roles = list(Type).index(v.type), list(Role).index(v.role)
        texts = self._add_text(v.name), self._add_text(v.allowed)
        motion, when_set = int(v.name in self._motion_outputs), layout.SETTABLE.index(when)
        return (*texts, kinds, roles, number, when_set, is_fixed, motion, start, low, high, rest_scale)

    def _wheel(self, wheel: WatchedWheel) -> tuple[int, ...]:
        arrays, lam = self._simulation.compiled.data.arrays, self._image.at(self._instance.lam)
        record = self._image.at(arrays.memory) + int(arrays.cuts["at"][wheel.number])
        places = [lam + 8 * row if row >= 0 else -1 for row in (wheel.normal, *wheel.tangential)]
        fields = record_of(self._simulation.compiled.mechanism.cuts[wheel.number].cut).fields
        assert fields is not None  # it has names
        friction = [record + fields[f"{name}_friction"][1] for name in GRIPS["both"]]
        names = self._add_text(wheel.name), *places, *friction
        if wheel.surface is None:
            return *names, -1, 0, 0, 0, 0, 0
        rows, row_fields = self._simulation.compiled.data.state.rows, RowRecord.dtype.fields
        assert row_fields is not None
        row = self._image.at(rows) + int(arrays.cuts["row"][wheel.number]) * rows.itemsize
        ends = [record + fields[name][1] for name in ("radius", "crown", "lower", "upper")]
        return *names, wheel.number, row + row_fields["Phi"][1], *ends

    def _array(self, array: ArrayVariable, members: list[tuple[Any, ...]]) -> tuple[int, int]:
        first = len(members)
        members += [(self._references[name],) for name in array.elements]
        return first, len(array.elements)

    def _entry(self, entry: Entry, rows: dict[str, list[tuple[Any, ...]]]) -> tuple[Any, ...]:
        first = len(rows["sums"])
        for own in entry.sums:
            begin = len(rows["terms"])
            for term in own:
                rows["terms"].append((len(rows["factors"]), len(term.powers), term.coefficient))
                rows["factors"] += self._factors(term)
            rows["sums"].append((begin, len(own)))
        at = self._place(entry.place)
        inputs = [k for k, v in enumerate(self._variables) if v.role is Role.INPUT]
        owner = -1 if entry.input is None else inputs[entry.input]
        base = float(np.frombuffer(self._block, np.float64, 1, at)[0])
        once = entry.place.array == "size"  # as CompiledMechanism.adopt has it: solvers keep their units
        return at, owner, once, entry.root, first, len(entry.sums), base

    def _factors(self, term: Term) -> list[tuple[int, float, float]]:
        shifted = [(n if isinstance(n, Shifted) else Shifted(n, 0.0), power) for n, power in term.powers]
        return [
            (layout.LENGTH_VARIABLE if own.name == LENGTH_NAME else self._references[own.name], power, own.offset)
            for own, power in shifted
        ]

    def _place(self, place: Place) -> int:
        """Return where a number is in the block."""
        start = self._instance.start
        known = {"rate": 0, "loop_rate": 8, "length": 16}
        if place.array in known:
            return self._image.at(self._instance.known) + known[place.array]
        texts: dict[str, NDArray[Any]] = {"q": start.q, "v": start.v}
        texts |= {EVENTS: self._instance.events.numbers, SAMPLED: self._instance.sampled.numbers}
        texts |= {"size": start.scratch.size, "row_size": start.scratch.row}
        arrays = self._simulation.compiled.data.arrays._asdict()
        array = texts[place.array] if place.array in texts else arrays[place.array]
        return self._image.at(array) + place.offset

    def _message(self, code: Any) -> tuple[int, int]:
        others = tuple(name for name in self._simulation.stepper.fallback_solvers if name != "ida")
        status = Status(code, 0.0, others)
        advice = advise(self._simulation.compiled, status) or status.remedy
        remedy = str(Diagnostic.error(KEYS[code], advice)) if code in KEYS else ""
        return self._add_text(MESSAGES[code][0]), self._add_text(remedy)

    def _failure(self, template: str) -> tuple[int, int, int]:
        """Return the parts of a sentence around a name and a number."""
        parts = re.split(r"\{[^}]*\}", template)
        before, between, after = (self._add_text(part) for part in (*parts, "", "")[:3])
        return before, between, after


def _records(rows: list[tuple[Any, ...]], record: np.dtype[Any]) -> NDArray[Any]:
    if record.names is None:
        return np.array([row[0] for row in rows], record)
    return np.array([tuple(row) for row in rows], record)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 8)
