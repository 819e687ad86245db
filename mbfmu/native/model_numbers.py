"""Every number that a run of a compiled mechanism starts from, as one row, and where each of them is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.scale import spans
from mbfmu.modeling.model import Model
from mbfmu.util.errors import UserError
from solvers.system import Array

from .event_memory import event_numbers, event_structure
from .sampled_blocks import sampled_numbers, sampled_structure
from .user_kernels import fingerprints

STRUCTURE_REASON = "it changes the structure of the mechanism"
KERNEL_REASON = "it changes a user-defined function, which is compiled into the FMU"

EVENTS, SAMPLED = "events", "sampled"  # names of the numbers of events and of sampled blocks
ESTIMATED = "estimated_"  # begins the names of fields that loads estimate, see Load.fill_estimates

ARRAY_DESCRIPTIONS = {
    "world": "gravity",
    "bodies": "a body",
    "memory": "a joint, a force, a signal or a sensor",
    "numbers": "a table, the path of a rope or a body of finite elements",
    "flexibles": "a flexible body",
    "nodes": "the shape of a flexible body",
    "q": "a start position",
    "v": "a start velocity",
    "size": "the nominal value of a coordinate",
    "row_size": "the nominal value of a constraint",
    "residual_scale": "the nominal value of a constraint",
    "span": "the length of the mechanism",
    "drive size": "the rate of the mechanism",
    "drive rate": "the rate of the mechanism",
    EVENTS: "an event",
    SAMPLED: "a sampled block",
}


class Place(NamedTuple):
    """Where a number is.

    ``array`` is a field of :class:`mbfmu.mechanics.records.Arrays`; or ``events``, ``sampled``: numbers of events and
    of sampled blocks; or ``q``, ``v``: start positions and velocities before loops are closed; or ``size``,
    ``row_size``, ``rate``, ``loop_rate`` of the system; or ``length`` of the compiled mechanism.
    """

    array: str
    offset: int  # bytes


class Reader:
    """Reads the numbers of compiled mechanisms that are built like one model with other parameter values.

    Parameters
    ----------
    model
        The one all others are compared with.

    Attributes
    ----------
    places
        Of every number, in their order. Three more names stand for what lengths and rates are made of: ``span``, the
        squares of what the largest gives the length, m^2; of every drive ``drive size``, the unit of its coordinate,
        and ``drive rate``, the fourth power of its rate in SI units.
    inputs
        Number of the input that owns a place.
    gravity
        Columns of its components.
    guesses
        Which numbers are positions that closing the loops corrects.
    base
        The numbers of the model itself.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._known: dict[tuple[tuple[str, float], ...], Array | UserError] = {}
        compiled = model.compile()
        self._kernels, self._events = fingerprints(compiled.called()), _structure(compiled)
        arrays = compiled.data.arrays
        masks = {name: _real_words(name, array, compiled) for name, array in arrays._asdict().items()}
        self._real = np.concatenate(list(masks.values()))
        self._fixed = ~self._real & ~_estimated_words(compiled)
        self._whole = _words(compiled)[self._fixed]
        self.inputs = _input_places(compiled)
        self._solver_columns = {name: len(values) for name, values in _solver_data(compiled).items()}
        self.places = [Place(name, 8 * int(k)) for name, mask in masks.items() for k in np.flatnonzero(mask)]
        self.places += [Place(name, 8 * k) for name, count in self._solver_columns.items() for k in range(count)]
        arrays_of = np.array([place.array for place in self.places])
        self._columns = {name: np.flatnonzero(arrays_of == name) for name in np.unique(arrays_of).tolist()}
        self.guesses = np.zeros(len(self.places), bool)
        if compiled.system.m and compiled.system.nq == compiled.system.n:
            self.guesses[self.columns("q")] = ~compiled.assembly.held()
        self.gravity = np.array([self.places.index(Place("world", 8 * k)) for k in range(3)])
        self.base = self._numbers(compiled)

    def columns(self, *names: str) -> NDArray[np.int64]:
        """Return the columns of these arrays."""
        return np.concatenate([self._columns.get(name, np.zeros(0, np.int64)) for name in names])

    def describe(self, column: int) -> str:
        """Return what a number belongs to, as text."""
        return ARRAY_DESCRIPTIONS.get(self.places[column].array, "the rate of the mechanism")

    def read(self, values: Mapping[str, float]) -> Array:
        """Return the numbers with other values of some parameters; UserError where there are none.

        Each is built once: building is what a search costs.
        """
        key = tuple(sorted((name, x) for name, x in values.items() if x != getattr(self._model, name)))
        if key not in self._known:
            try:
                self._known[key] = self._read(values)
            except UserError as error:
                self._known[key] = error
        known = self._known[key]
        if isinstance(known, UserError):
            raise known
        return known

    def _read(self, values: Mapping[str, float]) -> Array:
        with np.errstate(all="ignore"):
            compiled = self._model.with_values(self._typed(values)).compile()
            if fingerprints(compiled.called()) != self._kernels:
                raise UserError(KERNEL_REASON)
            words = _words(compiled)
            if _structure(compiled) != self._events:
                raise UserError(STRUCTURE_REASON)
            if len(words) != len(self._real) or np.any(words[self._fixed] != self._whole):
                raise UserError(STRUCTURE_REASON)
            return self._numbers(compiled)

    def _typed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values of parameters with the types of the parameters."""
        return {name: type(getattr(self._model, name))(value) for name, value in values.items()}

    def _numbers(self, compiled: CompiledMechanism) -> Array:
        told = _solver_data(compiled)
        if {name: len(values) for name, values in told.items()} != self._solver_columns:
            raise UserError(STRUCTURE_REASON)
        found = np.concatenate([_words(compiled)[self._real].view(np.float64), *told.values()])
        if not np.isfinite(found).all():
            raise UserError("other values lead to numbers that are not finite")
        return found


def _structure(compiled: CompiledMechanism) -> list[tuple[Any, ...]]:
    """Return what events and sampled blocks are, without their numbers."""
    return [*event_structure(compiled.mechanism), *sampled_structure(compiled.mechanism)]


def _words(compiled: CompiledMechanism) -> NDArray[np.int64]:
    """Return all arrays as consecutive words of eight bytes."""
    return np.concatenate([np.frombuffer(array.tobytes(), np.int64) for array in compiled.data.arrays])


def _real_words(name: str, array: NDArray[Any], compiled: CompiledMechanism) -> NDArray[np.bool_]:
    """Return which words of an array are real numbers that may follow parameters: a bound that is infinite stays so."""
    return _real_or_infinite(name, array, compiled) & np.isfinite(np.frombuffer(array.tobytes(), np.float64))


def _real_or_infinite(name: str, array: NDArray[Any], compiled: CompiledMechanism) -> NDArray[np.bool_]:
    if name != "memory":
        return np.tile(_real_fields(array.dtype), array.size)
    mask = np.zeros(array.nbytes // 8, bool)
    for table in compiled.tables:
        first = (_address(table) - _address(array)) // 8
        mask[first : first + table.nbytes // 8] = np.tile(_real_fields(table.dtype), len(table))
    return mask


def _estimated_words(compiled: CompiledMechanism) -> NDArray[np.bool_]:
    """Return which words of all arrays are estimates of loads, which remain as they are at the export."""
    masks = {name: np.zeros(array.nbytes // 8, bool) for name, array in compiled.data.arrays._asdict().items()}
    memory = compiled.data.arrays.memory
    for table in compiled.tables:
        for name in table.dtype.names or ():
            if name.startswith(ESTIMATED):
                first = (_address(table[name]) - _address(memory)) // 8
                masks["memory"][first : first + table.nbytes // 8 : table.itemsize // 8] = True
    return np.concatenate(list(masks.values()))


def _real_fields(dtype: np.dtype[Any]) -> NDArray[np.bool_]:
    """Return which words of one record, or one number, are real."""
    if dtype.names is None:
        return np.array([dtype == np.float64])
    mask = np.zeros(dtype.itemsize // 8, bool)
    for name in dtype.names:
        field, at = dtype.fields[name][:2]  # type: ignore[index]  # it has names
        mask[at // 8 : (at + field.itemsize) // 8] = field.base == np.float64 and not name.startswith(ESTIMATED)
    return mask


def _solver_data(compiled: CompiledMechanism) -> dict[str, Array]:
    """Return the data of solvers besides the arrays, and the components of lengths and rates."""
    system, drives = compiled.system, compiled.drives
    squares = spans(compiled.mechanism, compiled.data.arrays) ** 2
    time_scales = [(drives.sizes[k], drives.time_scale(k)) for k in drives.signals]
    return {
        EVENTS: event_numbers(compiled.mechanism),
        SAMPLED: sampled_numbers(compiled.mechanism),
        "q": compiled.assembly.start_positions(),
        "v": compiled.assembly.start_velocities(),
        "size": system.size,
        "row_size": system.row_size,
        "rate": np.array([system.rate]),
        "loop_rate": np.array([system.loop_rate] if system.has_matrices else []),
        "length": np.array([compiled.length]),
        "span": squares if squares.any() else np.array([compiled.length**2]),
        "drive size": np.array([size for size, _ in time_scales]),
        "drive rate": np.array([(size / time_scale) ** 4 if time_scale else 0.0 for size, time_scale in time_scales]),
    }


def _input_places(compiled: CompiledMechanism) -> dict[Place, int]:
    """Return the number of the input that owns a place."""
    arrays = compiled.data.arrays
    found = {}
    for number, (vector, index) in enumerate(compiled.inputs.places(arrays, compiled.signals(compiled.data))):
        for name, array in (("world", arrays.world), ("memory", arrays.memory)):
            offset = _address(vector) - _address(array) + 8 * index
            if 0 <= offset < array.nbytes:
                found[Place(name, offset)] = number
    return found


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])
