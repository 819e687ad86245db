"""Kernels of element types in the runtime, by their numbers in its table of addresses.

Every kernel is there for real numbers, and where derivatives are taken also for a state of complex numbers, see
:mod:`.derivatives`. A kernel that is called with nothing of the state is the same for both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import ModuleType
from typing import NamedTuple

from mbfmu.mechanics import couplings, cuts, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.tables import REAL, UNMOVED, CalledKernel, NumberTypes
from mbfmu.mechanics.kind import ElementType, element_types_of, kernel_of, record_of
from mbfmu.sheets import elements as sheet_elements
from mbfmu.sheets import joints as sheet_joints
from mbfmu.sheets import sensors as sheet_sensors

COMPONENT_ROLES: dict[ModuleType, type[ElementType]] = {
    joints: joints.Joint, cuts: cuts.CutJoint, couplings: couplings.Coupling, loads: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
    sheet_joints: joints.Joint, sheet_elements: loads.Load, sheet_sensors: sensors.Sensor,
}  # fmt: skip
KERNEL_TABLE_SYMBOL = "mb_kinds"  # symbol of the addresses of all kernels of kinds for real numbers
DERIVATIVE_TABLE_SYMBOL = "mb_derivative_kinds"  # ... and of those for a complex state
USER_LIBRARY = "mbfmu_kernels"  # beginning of the name of the library of user-defined kernels in an FMU
USER_TABLE_SYMBOL = "mb_user_kernels"  # symbol of the addresses of its kernels
LINEARIZED = NumberTypes(float, complex, UNMOVED | {"tangent"})  # real arrays and a complex state
STATE_WORDS = {"state", "motion", "coordinate", "lam"}  # words of a signature that stand for a part of the state


class TableEntry(NamedTuple):
    """A kernel, and the numbers of the state that it is compiled for."""

    called: CalledKernel
    state: type


def reads_state(called: CalledKernel) -> bool:
    """Whether a kernel is another one for a complex state."""
    words, _, _ = called.signature.partition(" -> ")
    return not (STATE_WORDS | set(dict(called.words))).isdisjoint(words.split(", "))


def shipped_kernels(state: type = float) -> tuple[CalledKernel, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in a table of the runtime.

    ``state`` complex: those that are compiled for a complex state too.
    """
    if state is float:
        return tuple(dict.fromkeys(_kernels(REAL)))
    return tuple(dict.fromkeys(called for called in _kernels(LINEARIZED) if reads_state(called)))


def _kernels(numbers: NumberTypes) -> Iterator[CalledKernel]:
    for module, role in COMPONENT_ROLES.items():
        for kind in element_types_of(module, role):
            for name, signature in kind.kernels.items():
                function = kernel_of(kind, name)
                if function is not None and name not in numbers.left_out:
                    yield CalledKernel(function, record_of(kind), signature, tuple(kind.records.items()))


def user_kernels(called: Iterable[CalledKernel | None]) -> tuple[CalledKernel, ...]:
    """Return the kernels of user-defined elements and functions among those that a mechanism calls, in their order.

    Such a type has a kernel of another package, or one that is made of a function of the model.
    """
    shipped = set(shipped_kernels())
    others = dict.fromkeys(own for own in called if own is not None and own not in shipped)
    types_of_users = [own.record for own in others if _is_user_defined(own)]
    return tuple(own for own in others if own.record in types_of_users)


def _is_user_defined(called: CalledKernel) -> bool:
    function = called.function
    return not function.__module__.startswith("mbfmu.") or "<locals>" in function.__qualname__


def kernel_numbers(called: Iterable[CalledKernel | None]) -> dict[TableEntry, int]:
    """Return the numbers of kernels in an FMU: those of both tables of the runtime, then the user-defined ones."""
    own = ((user_kernels(called), float),)
    tables = *((shipped_kernels(state), state) for state in (float, complex)), *own
    entries = [TableEntry(kernel, state) for kernels, state in tables for kernel in kernels]
    return {entry: k for k, entry in enumerate(entries)}
