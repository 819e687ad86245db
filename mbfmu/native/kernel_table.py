"""Kernels of element types in the runtime, by their numbers in its tables of addresses.

There are tables for real numbers, and others for a state of complex numbers, by which the structured tangent
(:mod:`mbfmu.mechanics.tangent`) and directional derivatives (:mod:`.derivatives`) are taken. A library has only those
tables that its models call, see :mod:`.contents`; numbers are the same in all libraries.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from types import ModuleType
from typing import NamedTuple

from mbfmu.mechanics import couplings, cuts, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.tables import LINEARIZED, REAL, TANGENT_NUMBERS, CalledKernel, called_kernels, used_type
from mbfmu.mechanics.kind import ElementType, element_types_of
from mbfmu.mechanics.loads.linear_block import LinearBlock
from mbfmu.sheets import elements as sheet_elements
from mbfmu.sheets import joints as sheet_joints
from mbfmu.sheets import sensors as sheet_sensors
from mbfmu.sheets.contact import surfaces
from mbfmu.sheets.contact.nip import RollerNip
from mbfmu.sheets.contact.surface_contact import SurfaceContact
from mbfmu.util.errors import UserError

# Modules of the element types that ship, with their roles, by the part of the runtime that has their kernels: the
# kernels of a sheet take as long to compile as those of all other types together.
COMPONENT_ROLES: dict[str, dict[ModuleType, type[ElementType]]] = {
    "mechanisms": {
        joints: joints.Joint, cuts: cuts.CutJoint, couplings: couplings.Coupling, loads: loads.Load,
        signals: signals.Signal, sensors: sensors.Sensor,
    },
    "sheets": {
        sheet_joints: joints.Joint, sheet_elements: loads.Load, sheet_sensors: sensors.Sensor,
        surfaces: surfaces.Surface,
    },
}  # fmt: skip
OTHER_TYPES: dict[str, tuple[type[ElementType], ...]] = {  # in addition, by the part
    "mechanisms": (LinearBlock,),
    "sheets": (SurfaceContact, RollerNip),
}
USER_LIBRARY = "mbfmu_kernels"  # beginning of the name of the library of user-defined kernels in an FMU
USER_TABLE_SYMBOL = "mb_user_kernels"  # symbol of the addresses of its kernels


class KernelTable(NamedTuple):
    """Kernels that are compiled together, in the order of their addresses."""

    symbol: str  # of their addresses
    kernels: tuple[CalledKernel, ...]


@cache
def kernel_tables() -> dict[str, KernelTable]:
    """Return the tables of all kernels that ship by the names of their parts of the runtime, in the order of numbers.

    Those of a part are for real numbers, those of "PART-derivatives" for a state of complex numbers.
    """
    tables, known = {}, set[CalledKernel]()
    for suffix, state in (("", float), ("-derivatives", complex)):
        for part, roles in COMPONENT_ROLES.items():
            own_kinds = [kind for module, role in roles.items() for kind in element_types_of(module, role)]
            kinds = [kind for own in own_kinds for kind in (own, *own.variants)]
            used = [used_type(kind) for kind in (*kinds, *OTHER_TYPES[part])]
            found = [
                own for kind in used for n in (REAL, TANGENT_NUMBERS, LINEARIZED) for own in called_kernels(kind, n)
            ]
            new = dict.fromkeys(own for own in found if own is not None and own.state is state and own not in known)
            known.update(new)
            name = f"{part}{suffix}"
            tables[name] = KernelTable(f"mb_{name.replace('-', '_')}", tuple(new))
    return tables


def shipped_kernels() -> tuple[CalledKernel, ...]:
    """Return the kernels of all types that ship, in the order of their numbers."""
    return tuple(own for table in kernel_tables().values() for own in table.kernels)


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


def numbers_in_fmu(called: Iterable[CalledKernel | None]) -> dict[CalledKernel, int]:
    """Return the numbers of kernels in an FMU: those of all tables of the runtime, then the user-defined ones."""
    known = *shipped_kernels(), *user_kernels(called)
    return {own: k for k, own in enumerate(known)}


def kernel_numbers(called: Iterable[CalledKernel | None], known: dict[CalledKernel, int]) -> list[int]:
    """Return the numbers of kernels by :func:`numbers_in_fmu`, -1: none; UserError if one is not in the FMU."""
    numbers = []
    for own in called:
        if own is not None and own not in known:
            raise UserError(
                f"kernel {own.function.__module__}.{own.function.__qualname__} is not in the runtime of native FMUs; "
                "export the model with --python",
                "not-native",
            )
        numbers.append(-1 if own is None else known[own])
    return numbers
