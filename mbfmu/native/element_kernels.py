"""The kernels of element types in the runtime, and those of a model that are in a separate library.

Those that ship are compiled for real numbers, and where the structured tangent (:mod:`mbfmu.mechanics.tangent`) calls
them for a state of complex numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import ModuleType

from mbfmu.mechanics import couplings, cuts, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.tables import REAL, TANGENT_NUMBERS, CalledKernel, called_kernels, used_type
from mbfmu.mechanics.kind import ElementType, element_types_of
from mbfmu.sheets import elements as sheet_elements
from mbfmu.sheets import joints as sheet_joints
from mbfmu.sheets import sensors as sheet_sensors
from mbfmu.sheets.contact import surfaces
from mbfmu.sheets.contact.nip import RollerNip
from mbfmu.sheets.contact.surface_contact import SurfaceContact
from mbfmu.util.errors import UserError

COMPONENT_ROLES: dict[ModuleType, type[ElementType]] = {
    joints: joints.Joint, cuts: cuts.CutJoint, couplings: couplings.Coupling, loads: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
    sheet_joints: joints.Joint, sheet_elements: loads.Load, sheet_sensors: sensors.Sensor, surfaces: surfaces.Surface,
}  # fmt: skip
CONTACT_TYPES: tuple[type[ElementType], ...] = SurfaceContact, RollerNip  # in addition


def kernel_numbers(called: Iterable[CalledKernel | None], known: dict[CalledKernel, int]) -> list[int]:
    """Return the numbers of kernels in the runtime, -1 where there is none; UserError if one is not in it."""
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


def shipped_kernels() -> tuple[CalledKernel, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in the runtime."""
    found = [kind for module, role in COMPONENT_ROLES.items() for kind in element_types_of(module, role)]
    return tuple(dict.fromkeys(called for kind in (*found, *CONTACT_TYPES) for called in _kernels(kind)))


def _kernels(kind: type[ElementType]) -> Iterator[CalledKernel]:
    for numbers in (REAL, TANGENT_NUMBERS):
        yield from filter(None, called_kernels(used_type(kind), numbers))
