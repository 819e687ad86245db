"""Laws of named quantities: functions that users write of time, signals, first-order states and sensors, as kernels.

A law is a function or an expression. Its names are those that its owner defines, such as ``t``, and those that the user
gives with it. Kernels are made for the number of arguments and for what each of them is. As other laws
(:mod:`.law`), these are differentiated by differences of fourth order and not by complex steps.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

import numpy as np
from numba import types
from numba.extending import overload

from mbfmu.mechanics import law
from mbfmu.mechanics.dispatch import READ, part_sensor_value, signal_value
from mbfmu.mechanics.kind import Attachment, ElementType
from mbfmu.mechanics.quantity_kinds import (
    BLOCK,
    LENGTH,
    LENGTH_RATE,
    MAX_QUANTITIES,
    POSITION,
    SENSOR,
    SIGNAL,
    TIME,
    VELOCITY,
)
from mbfmu.mechanics.reading import block_value
from mbfmu.util.errors import UserError, short
from solvers.compiled.indirect_call import call_f
from solvers.compiled.kernel import inlined, is_kernel, jit_uncached

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals

# How a kernel reads quantity number k; places are those in State.q or State.v, or numbers of signals and parts. The
# length x of a line between two points and its rate v are further arguments of the kernel
READERS = {
    TIME: "t",
    POSITION: "state.q[record.places[{k}]]",
    VELOCITY: "state.v[record.places[{k}]]",
    SIGNAL: "signal_value(record.places[{k}], t, arrays)",
    SENSOR: "part_sensor_value(record.places[{k}], arrays, state)",
    BLOCK: "block_value(record.places[{k}], t, arrays, state)",
    LENGTH: "x",
    LENGTH_RATE: "v",
}


# ... where multipliers and accelerations are known
OUTPUT_READERS = {SENSOR: "read_part(record.places[{k}], lam, arrays, state)"}


class StateReference(Protocol):
    """A first-order state of a mechanism, as laws refer to it."""

    name: str

    @property
    def is_state(self) -> bool:
        """True."""


class KinematicSensor(Protocol):
    """A sensor whose value positions, velocities and states determine."""

    is_kinematic: bool


class Quantity(NamedTuple):
    """An argument of a law."""

    name: str
    kind: int
    source: Any  # signal, sensor or state; None: the owner gives its place


def check_names_of_quantities(what: str, uses: Any) -> None:
    """Raise UserError for what is no mapping from names to quantities."""
    if not isinstance(uses, Mapping) or not all(isinstance(name, str) and name.isidentifier() for name in uses):
        raise UserError(f"uses of {what} is {short(uses)}; allowed: quantities by names such as 'angle'")


class QuantityLaw:
    """A law with what its arguments are.

    Parameters
    ----------
    what
        Name in messages, such as ``"rate of state 'filter'"``.
    given
        Function or expression.
    own
        Kinds of the names that the owner of the law defines.
    uses
        Other quantities by name: numbers, signals, inputs, functions of time, states, blocks, expressions, and sensors
        of positions and velocities.
    any_sensor
        Whether sensors of forces and accelerations are allowed, too: the law is read where these are known.

    Attributes
    ----------
    quantities
        Arguments in their order.
    function
        The law as a kernel.

    Raises
    ------
    UserError
        A name is unknown or not used, a quantity is of another kind, or the law cannot be compiled.
    """

    def __init__(
        self, what: str, given: Any, own: Mapping[str, int], uses: Mapping[str, Any], *, any_sensor: bool = False
    ) -> None:
        check_names_of_quantities(what, uses)
        for name in uses:
            if name in own or name in law.FUNCTIONS:
                raise UserError(f"uses of {what} has the name {name!r}, which means something else there; rename it")
        names = names_of(what, given, (*own, *uses))
        for name in uses:
            if name not in names:
                raise UserError(f"uses of {what} has {name!r}, which the law does not contain; remove it or use it")
        if len(names) > MAX_QUANTITIES:
            raise UserError(f"{what} has {len(names)} arguments; allowed: at most {MAX_QUANTITIES}")
        self.what = what
        self._is_along_line = LENGTH in own.values()
        self.quantities = tuple(
            Quantity(name, own[name], None)
            if name in own
            else quantity_of(what, name, uses[name], any_sensor=any_sensor)
            for name in names
        )
        self.function = law.law_of(what, given, names)

    @property
    def kinds(self) -> tuple[int, ...]:
        """Kinds of the arguments."""
        return tuple(quantity.kind for quantity in self.quantities)

    def value_kernel(self) -> Any:
        """Return the kernel (record, t, arrays, state) -> value of a record with the field ``places``.

        If the owner of the law defines the length of a line and its rate, these are two further arguments.
        """
        return kernel_of_value(self.function, self.kinds, is_along_line=self._is_along_line)

    def reading_kernel(self) -> Any:
        """Return the kernel (record, lam, arrays, state) -> value of such a record for outputs, see
        :mod:`.sensors.base`.
        """
        return kernel_of_value(self.function, self.kinds, is_output=True)

    def fill(self, record: Any, site: Attachment, own: Mapping[str, int]) -> None:
        """Write the places of the arguments; ``own`` has those of the names that the owner defines."""
        for k, quantity in enumerate(self.quantities):
            given = quantity.source is not None
            what = f"the law of {site.name}"
            record["places"][k] = place_of(quantity, site, what) if given else own.get(quantity.name, 0)


def place_of(quantity: Quantity, site: Attachment, what: str) -> int:
    """Return the place of a quantity for kernels: in State.v, or the number of a signal or a part."""
    if quantity.kind == SIGNAL:
        return site.signal(quantity.source, f"{quantity.name!r} in {what}")
    if quantity.kind in (SENSOR, BLOCK):
        return site.part(quantity.source)
    return site.state_place(quantity.source)


def names_of(what: str, given: Any, known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the arguments of a law; UserError for one that is not known."""
    if isinstance(given, str):
        law.check_names(what, given, known)
        found = tuple(name for name in known if name in law.names_in(given))
        return found or known[:1]  # a constant gets one argument
    if not callable(given):
        raise UserError(f"{what} is {short(given)}; allowed: a function, or an expression as text")
    law.arguments_of(what, given)  # raises
    found = tuple(inspect.signature(given.py_func if is_kernel(given) else given).parameters)
    for name in found:
        if name not in known:
            raise UserError(
                f"{what} is a function with an argument {name!r}; allowed: {', '.join(map(repr, known))}. Name the "
                "arguments as the quantities, or give the quantity with `uses`"
            )
    return found


def is_motion_quantity(source: Any) -> bool:
    """Whether something is a first-order state, a block or a sensor."""
    return getattr(source, "is_state", False) or getattr(source, "is_block", False) or hasattr(source, "follows")


def quantity_of(what: str, name: str, source: Any, *, any_sensor: bool = False) -> Quantity:
    """Return the quantity that a user gives; raises UserError. ``any_sensor``: it may be one of forces, too."""
    if getattr(source, "is_state", False):
        return Quantity(name, VELOCITY, source)
    if getattr(source, "is_block", False):
        return Quantity(name, BLOCK, source.value())
    if getattr(source, "is_block_output", False):
        return Quantity(name, BLOCK, source)
    if hasattr(source, "follows"):  # a sensor
        if not (any_sensor or source.is_kinematic):
            raise UserError(
                f"{name!r} in {what} is a sensor of class {type(source).__name__}, whose value depends on forces or "
                "accelerations; allowed: sensors of positions, velocities, states and outputs of blocks. Use one of "
                "these"
            )
        return Quantity(name, SENSOR, source)
    if isinstance(source, ElementType | float | int | np.floating | np.integer | str) or callable(source):
        return Quantity(name, SIGNAL, source)  # which is checked when it is numbered
    raise UserError(
        f"{name!r} in {what} is {short(source)}; allowed: a number, a signal, an input, a function of time, a state, "
        "a block, or a sensor of positions and velocities"
    )


@inlined
def read_part(k: int, lam: Reals, arrays: Arrays, state: State) -> float:
    """Value of part k, a sensor, where the state holds a solution with the multipliers ``lam`` (m,)."""
    item = arrays.parts[k]
    return call_f(arrays.kernels[item.kind + READ], arrays.memory, item.at, state.time, (lam, arrays, state))


@cache
def kernel_of_value(
    function: Any, kinds: tuple[int, ...], *, is_output: bool = False, is_along_line: bool = False
) -> Any:
    """Return the kernel that reads the arguments of a law and evaluates it.

    That of an output gets the multipliers ``lam`` in place of the time, which is that of the state.
    """
    readers = READERS | OUTPUT_READERS if is_output else READERS
    read = ", ".join(f"{readers[kind].format(k=k)} + zero" for k, kind in enumerate(kinds))
    source = (
        f"def value(record, {'lam' if is_output else 't'}, arrays, state{', x, v' * is_along_line}):\n"
        f"{'    t = state.time[0].real' if is_output else ''}\n"
        "    zero = 0.0 * state.time[0]\n"  # of the type of the state
        f"    return evaluate(function, {read})\n"
    )
    names = {
        "signal_value": signal_value,
        "part_sensor_value": part_sensor_value,
        "read_part": read_part,
        "block_value": block_value,
        "evaluate": evaluator(len(kinds)),
        "function": function,
    }
    return jit_uncached(_defined(source, "value", names))


@cache
def evaluator(count: int) -> Callable[..., Any]:
    """Return evaluate(function, x0, x1, ...) of real or complex arguments for kernels: where they are complex, with the
    derivatives by their imaginary parts.
    """
    arguments = [f"x{k}" for k in range(count)]
    listed = ", ".join(arguments)
    real = f"def real(function, {listed}):\n    return function({listed})\n"
    lines = [f"def along(function, {listed}):", "    change = 0.0"]
    lines += [f"    a{k} = x{k}.real" for k in range(count)]
    for k in range(count):
        moved = [
            f"function({', '.join(f'a{j} + {part} * h' if j == k else f'a{j}' for j in range(count))})"
            for part in (-2.0, -1.0, 1.0, 2.0)
        ]
        lines += [
            f"    if x{k}.imag != 0.0:",
            f"        h = STEP * max(abs(a{k}), LEAST)",
            f"        slope = ({moved[0]} - 8.0 * {moved[1]} + 8.0 * {moved[2]} - {moved[3]}) / (12.0 * h)",
            f"        change += slope * x{k}.imag",
        ]
    lines += [f"    return function({', '.join(f'a{k}' for k in range(count))}) + 1j * change"]
    names = {"STEP": law.LAW_DIFFERENCE_STEP, "LEAST": law.MIN_DIFFERENCE_STEP / law.LAW_DIFFERENCE_STEP}
    by_real = _defined(real, "real", {})
    along = _defined("\n".join(lines) + "\n", "along", names)

    def evaluate(function: Any, *x: Any) -> Any:
        return (along if isinstance(x[0], complex) else by_real)(function, *x)

    source = f"def choose(function, {listed}):\n    return along if isinstance(x0, Complex) else by_real\n"
    choose = _defined(source, "choose", {"along": along, "by_real": by_real, "Complex": types.Complex})
    overload(evaluate, strict=False)(choose)
    return evaluate


def _defined(source: str, name: str, names: dict[str, Any]) -> Any:
    """Return the function that a source of this module defines, with these global names.

    Its qualified name is that of a local function, since several of one name are at work: kernels are known by the
    names of others (:mod:`solvers.compiled.symbols`).
    """
    found: dict[str, Any] = {"__name__": __name__, **names}
    exec(compile(source, f"<{__name__}>", "exec"), found)
    found[name].__qualname__ = f"_defined.<locals>.{name}"
    return cast("Any", found[name])
